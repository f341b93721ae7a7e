"""Find the kink of a loading curve by two lines that meet, and the onset of its plateau."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from labpipe.records.arrays import Floats, Ints, divide
from labpipe.records.causes import TANGENT
from labpipe.records.curve import NORMAL_95, Branch, FittedLine, Interval
from labpipe.records.declarations import CURVE_QUANTITIES, Fraction, Length, Output, StiffnessName
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Finding, Reason
from labpipe.records.result import Result
from labpipe.results import curves
from labpipe.results.cycles import find_truncation
from labpipe.results.kinds import Kind, Outcome, Part, ReducedTest, Stiffness, find_marked_slips
from labpipe.results.stiffness import Window
from labpipe.uncertainty.intervals import Measured, measure_numbers
from labpipe.uncertainty.replicates import Decide, Input, Reading, Replicates, Trace

_MIN_SEGMENT_SAMPLES = 4


class Segments(NamedTuple):
    """Two lines that meet, for each of many curves.

    Parameters
    ----------
    break_point : shape (...), m
    first, second : shape (...), N/m, slopes before and after it
    level : shape (...), N, force at the break
    """

    break_point: Floats
    first: Floats
    second: Floats
    level: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Hinges:
    """Places at which two lines may meet, chosen on one curve.

    Parameters
    ----------
    path : samples with both quantities, sorted by displacement
    x : shape (k,), their displacements, scaled to -1 to 1
    places : shape (300,), on that scale
    residual : N, standard deviation of that curve about one straight line
    grid_correction : on that scale, from the optimum over the places to the global optimum of that
        curve
    """

    path: curves.CommonPath
    x: Floats
    places: Floats
    residual: float
    grid_correction: float = 0.0

    @classmethod
    def of(cls, displacement: Floats, force: Floats) -> Hinges:
        """Choose the places between which a curve may bend.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time; NaN
            are ignored

        Returns
        -------
        Equidistant places, from the eighth sample to the eighth last one. With fewer than 64
        samples, an eighth of their number takes the place of eight, but at least four.

        Raises
        ------
        UnavailableError
            ``too_few_samples`` (fewer than 16), ``not_increasing`` if the displacement does not
            increase over the stretch.
        """
        min_samples = 16
        finite = curves.find_finite_samples(displacement, force)
        d = displacement[finite]
        curves.require_samples(len(d), min_samples)
        if d[-1] <= d[0] or (np.arange(len(d)) - 0.5 * (len(d) - 1)) @ d <= 0.0:
            raise UnavailableError.of("results.not_increasing", begin=d[0], end=d[-1])
        order = finite[np.argsort(d, kind="stable")]
        d, y = displacement[order], force[order]
        x = (d - 0.5 * (d[0] + d[-1])) * (2.0 / (d[-1] - d[0]))
        margin = min(8, max(_MIN_SEGMENT_SAMPLES, len(x) // 8)) - 1
        places = np.linspace(x[margin], x[-1 - margin], 300)
        residuals = y - y.mean() - curves.compute_slope(x, y) * (x - x.mean())
        residual = float(np.sqrt(residuals @ residuals / (len(x) - 2)))
        hinges = cls(curves.CommonPath.of(displacement, force, order), x, places, residual)
        best = hinges._find_global_break(residuals)
        return replace(hinges, grid_correction=best - float(hinges._find_breaks(y[None])[0]))

    @property
    def ends(self) -> tuple[float, float]:
        """Return the first and last sample of the stretch, m."""
        return float(self.path.displacement[0]), float(self.path.displacement[-1])

    def to_displacement(self, x: Floats | float) -> Floats:
        """Return the displacement of scaled places, m."""
        first, last = self.ends
        return np.asarray(0.5 * (first + last) + 0.5 * (last - first) * x)

    def fit(self, force: Floats, displacement: Floats | None = None) -> Segments:
        """Fit two lines that meet to each of many curves.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        Numbers of shape (...); NaN for a curve with NaN among these samples.

        Notes
        -----
        For the reference curve it is the global least-squares optimum over all breaks from the
        fourth sample to the fourth last one, from a scan of all samples and gaps between them
        (Hudson, J. Am. Stat. Assoc. 61 (1966) 1097). For all others 300 places are tried. A hinge
        max(x - c, 0) reduces the sum of squares about one straight line by (y'u)^2, with u the
        hinge less its own line, of length 1; the largest is refined by the parabola through it and
        its neighbours, and shifted by the error of that for the reference curve. The lines are the
        least-squares ones with this break. Noise of the displacement counts as noise of the force
        (`CommonPath`).
        """
        y = self.path.move_force(force, displacement)
        shape, y, x = y.shape[:-1], y.reshape(-1, y.shape[-1]), self.x
        hinge_range = x[_MIN_SEGMENT_SAMPLES - 1], x[-_MIN_SEGMENT_SAMPLES]
        hinge_positions = np.clip(self._find_breaks(y) + self.grid_correction, *hinge_range)
        hinge, lever = np.maximum(x - hinge_positions[:, None], 0.0), x - x.mean()
        spread, mean = lever @ lever, hinge.mean(axis=1)
        cross, along = hinge @ lever / spread, y @ lever / spread
        hinge -= mean[:, None] + np.outer(cross, lever)
        norm = np.vecdot(hinge, hinge)
        bend = np.vecdot(y, hinge) / np.where(norm > 1e-14 * len(x), norm, np.nan)
        slope = along - bend * cross
        level = y.mean(axis=1) + slope * (hinge_positions - x.mean()) - bend * mean
        scale = 2.0 / (self.ends[1] - self.ends[0])
        position = self.to_displacement(hinge_positions)
        numbers = position, scale * slope, scale * (slope + bend), level
        return Segments(*(number.reshape(shape) for number in numbers))

    def _find_breaks(self, y: Floats) -> Floats:
        """Return the breaks (R,) of curves (R, k) from the places and the parabola."""
        places = self.places
        gain = self._compute_gain(y, places)
        top = np.clip(np.argmax(gain, axis=1), 1, len(places) - 2)
        neighbours = np.take_along_axis(gain, top[:, None] + [-1, 0, 1], axis=1)
        previous, largest, following = neighbours.T
        curvature = 2.0 * largest - previous - following
        offset = 0.5 * (following - previous) / np.where(curvature > 0.0, curvature, np.inf)
        best_positions: Floats = places[top] + np.clip(offset, -1.0, 1.0) * (places[1] - places[0])
        return best_positions

    def _compute_gain(self, y: Floats, places: Floats) -> Floats:
        """Return the reduction of the sum of squares of curves (R, k) by a hinge at each place."""
        x, lever = self.x, self.x - self.x.mean()
        starts = np.append(0, np.searchsorted(x, places))
        is_empty = np.diff(starts, append=len(x)) == 0
        beyond = []
        for values in (np.stack([np.ones_like(x), x, x * x]), y, y * x):
            sums = np.add.reduceat(values, starts, axis=1)
            sums[:, is_empty] = 0.0  # `reduceat` returns the first sample of an empty stretch
            beyond.append(np.cumsum(sums[:, :0:-1], axis=1)[:, ::-1])
        (n, sx, sxx), sy, sxy = beyond
        spread, sh = lever @ lever, sx - places * n
        cross = sxx - places * sx - x.mean() * sh
        norms = sxx - 2.0 * places * sx + places**2 * n - sh**2 / len(x) - cross**2 / spread
        product = sxy - places * sy - np.outer(y.mean(axis=1), sh)
        product -= np.outer(y @ lever, cross / spread)
        return np.asarray(product**2 / np.where(norms > 1e-14 * len(x), norms, np.inf))

    def _find_global_break(self, residuals: Floats) -> float:
        """Return the best break of a curve: at a sample, or where lines meet inside a gap.

        residuals : shape (k,), N, about one straight line, so that their sums do not cancel
        """
        x, margin = self.x, _MIN_SEGMENT_SAMPLES
        columns = [np.ones_like(x), x, x * x, residuals, x * residuals]
        below = np.cumsum(columns, axis=1)[:, margin - 1 : len(x) - margin]
        above = np.sum(columns, axis=1)[:, None] - below
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes, levels = [], []
            for n, sx, sxx, sr, sxr in (below, above):
                slopes.append((n * sxr - sx * sr) / (n * sxx - sx * sx))
                levels.append((sr - slopes[-1] * sx) / n)
            meet = (levels[1] - levels[0]) / (slopes[0] - slopes[1])
        inner = x[margin - 1 : len(x) - margin + 1]
        in_gap = (meet >= inner[:-1]) & (meet <= inner[1:])
        candidates = np.sort(np.concatenate([inner, meet[in_gap]]))
        return float(candidates[int(np.argmax(self._compute_gain(residuals[None], candidates)))])


def require_bend(numbers: tuple[Measured, ...], hinges: Hinges) -> None:
    """Require that a curve bends, by its replicates.

    Parameters
    ----------
    numbers : those of `Segments`, of the curve
    hinges : hinges of the curve

    Raises
    ------
    UnavailableError
        ``no_bend`` if the slopes differ by at most four standard errors, or if at least 2.5 % of
        the replicates have their break no farther than the third place from an end, or would have
        it there with their deviation reversed.

    Notes
    -----
    The break is chosen for the largest difference of the slopes. By chance, the difference on a
    straight line therefore exceeds two standard errors much more often than once in twenty. The
    standard error is the distance between the median of all replicates and their 2.5 % quantile on
    the side of less bend, over 1.96: replicates whose break moves towards an end have steeper
    slopes beyond it, which is no evidence against a bend.
    """
    min_bend_errors = 4.0
    place, first, second, _ = numbers
    bend, deviations = second.value - first.value, second.deviations - first.deviations
    middle, smallest = np.nanquantile(deviations, [0.5, 0.975 if bend < 0.0 else 0.025]).tolist()
    error = abs(smallest - middle) / NORMAL_95
    if not abs(bend) > min_bend_errors * error:
        raise UnavailableError.of(
            "results.no_bend",
            first=first.value,
            second=second.value,
            bend=abs(bend),
            needed=min_bend_errors,
            error=error,
        )
    low, high = hinges.to_displacement(hinges.places[[2, -3]])
    errors = place.deviations[~np.isnan(place.deviations)]
    for hinge_positions in (place.value + errors, place.value - errors):
        if np.mean((hinge_positions <= low) | (hinge_positions >= high)) >= 0.025:
            start, stop = hinges.ends
            raise UnavailableError.of("results.bends_at_end", start=start, stop=stop)


def require_kink(numbers: tuple[Measured, ...], hinges: Hinges) -> None:
    """Require that the slope of a curve decreases at a kink, by its replicates.

    Parameters
    ----------
    numbers, hinges : as for `require_bend`

    Raises
    ------
    UnavailableError
        ``no_kink`` if the curve does not bend, or bends upwards; ``kink_at_end`` if the lines meet
        in the first or the last twentieth of the stretch.
    """
    start, stop = (1e3 * end for end in hinges.ends)
    no_bend, rms = return_failure(require_bend)(numbers, hinges), hinges.residual
    if no_bend is not None:
        why = no_bend.message
        raise UnavailableError.of("results.no_kink", rms=rms, start=start, stop=stop, why=why)
    place, first, second = 1e3 * numbers[0].value, numbers[1].value, numbers[2].value
    if second >= first:
        raise UnavailableError.of("results.slope_rises", first=first, second=second, place=place)
    margin = 0.05 * (stop - start)
    if not start + margin <= place <= stop - margin:
        raise UnavailableError.of("results.kink_at_end", place=place, start=start, stop=stop)


def find_break_doubts(interval: Interval, hinges: Hinges) -> tuple[Reason, ...]:
    """Return a doubt ``wide_break`` if an interval is longer than a quarter of the stretch.

    Parameters
    ----------
    interval : m, of the break
    hinges : hinges of its fit
    """
    start, stop, low, high = (1e3 * end for end in (*hinges.ends, interval.lower, interval.upper))
    if high - low <= 0.25 * (stop - start):
        return ()
    return (Reason.of("results.wide_break", width=high - low, start=start, stop=stop),)


def find_contact_doubts(numbers: tuple[Measured, ...], hinges: Hinges) -> tuple[Reason, ...]:
    """Return a doubt ``late_contact`` if the specimen is not loaded where the first line begins.

    Parameters
    ----------
    numbers, hinges : as for `require_bend`

    Notes
    -----
    The line then begins at a force of the opposite sign, of at least a twentieth of the force at
    the end of the stretch; or the line and the force at the break are almost zero.
    """
    min_share, min_slope_share = 0.05, 0.02
    place, first, second, level = (number.value for number in numbers)
    start, stop = hinges.ends
    end_force = level + second * (stop - place)
    share = (level - first * (place - start)) / end_force
    is_unloaded = abs(first) < min_slope_share * abs(second) and abs(level) < abs(
        min_share * end_force
    )
    if share >= -min_share and not is_unloaded:
        return ()
    return (Reason.of("results.late_contact", start=1e3 * start),)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TwoLines(Window):
    """A kind of result from two lines through a range of the first loading."""

    method: ClassVar = (
        "two segments that meet, from {start_mm:g} mm to {stop_mm:g} mm, all breaks tried"
    )

    def fit(
        self, test: ReducedTest, require: Callable[[tuple[Measured, ...], Hinges], None]
    ) -> tuple[tuple[Measured, ...], Hinges]:
        """Fit two lines to the curve of a test, and require a break between them.

        Parameters
        ----------
        test : the test
        require : raises an error without such a break, as `require_bend`

        Returns
        -------
        The numbers of `Segments`, and the places at which the lines may meet.
        """
        numbers = test.measure(self.decide)
        _, hinges = self._choose_places(curves.make_trace(test))
        require(numbers, hinges)
        return numbers, hinges

    def decide(self, trace: Trace) -> Reading:
        """Choose the places at which the lines may meet.

        Parameters
        ----------
        trace : one curve

        Returns
        -------
        A reading of the numbers of `Segments`.
        """
        part, hinges = self._choose_places(trace)

        def numbers(trace: Trace) -> Segments:
            return hinges.fit(trace.force[..., part], trace.displacement[..., part])

        return Reading(numbers, len(hinges.x), ends_at_samples=True, depends_on_corners=True)

    def choose_one(self, trace: Trace, *, number: int) -> Reading:
        """Choose the places for one of the numbers.

        Parameters
        ----------
        trace : one curve
        number : place in the reading of `decide`
        """
        reading = self.decide(trace)
        return replace(reading, numbers=lambda trace: (reading.numbers(trace)[number],))

    def _choose_places(self, trace: Trace) -> tuple[slice, Hinges]:
        """Return the samples of the range, and the places in it."""
        part = self.select_samples(trace)
        return part, Hinges.of(trace.displacement[part], trace.force[part])


def _make_lines(
    numbers: tuple[Measured, ...], hinges: Hinges, names: tuple[str, str]
) -> tuple[FittedLine, ...]:
    """Return the named lines before and after a break."""
    (place, first, second, level), (start, stop) = (number.value for number in numbers), hinges.ends
    return (
        FittedLine(names[0], first, level - first * (place - start), start, place),
        FittedLine(names[1], second, level, place, stop),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSegments(_TwoLines):
    """``segment_stiffness_first``, ``segment_stiffness_second``, ``break_point``: two lines."""

    result: ClassVar = "two-segments"
    outputs: ClassVar = (
        Output("segment_stiffness_first", "N/m", "Stiffness, first fitted segment", is_slope=True),
        Output(
            "segment_stiffness_second", "N/m", "Stiffness, second fitted segment", is_slope=True
        ),
        Output("break_point", "m", "Break point of the two segments"),
    )

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Fit the best two segments that meet."""
        numbers, hinges = self.fit(test, require_bend)
        place, first, second, _ = numbers
        start, stop = hinges.ends
        period = test.find_loading_interval(start, stop)
        contact = find_contact_doubts(numbers, hinges)
        doubts = find_marked_slips(test, hinges.ends) + contact
        yield from self.make_results(test, (first, second), period=period, doubts=doubts)
        doubts += find_break_doubts(place.interval, hinges)
        yield self.make_result(test, place, output=2, period=period, doubts=doubts)
        windows = (max(start, 0.0), place.value), (max(place.value, 0.0), stop)
        names = self.outputs[0].name, self.outputs[1].name
        for number, (name, window) in enumerate(zip(names, windows, strict=True), start=1):
            decide, slope = partial(self.choose_one, number=number), numbers[number].value
            # A slip bends both lines.
            yield Stiffness(name, decide, slope, period, window, hinges.ends, contact)
        yield from _make_lines(numbers, hinges, names)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kink(_TwoLines):
    """``kink_displacement`` (m) and ``kink_force`` (N): where the first loading gets less steep."""

    result: ClassVar = "kink"
    outputs: ClassVar = (
        Output("kink_displacement", "m", "Displacement at the kink"),
        Output("kink_force", "N", "Kink force"),
    )

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Find the decrease of the slope of the first loading."""
        numbers, hinges = self.fit(test, require_kink)
        place, _, _, level = numbers
        slips = find_marked_slips(test, hinges.ends)
        doubts = slips + find_break_doubts(place.interval, hinges)
        period = test.find_loading_interval(*hinges.ends)
        yield from self.make_results(test, (place, level), period=period, doubts=doubts)
        yield from _make_lines(numbers, hinges, ("before_kink", "behind_kink"))


_TANGENTS_PER_LENGTH = 8
"""Tangents per length of a tangent."""


_MIN_TANGENT_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Tangents of a loading curve, from its end backwards; their samples are chosen on one curve.

    Parameters
    ----------
    path : samples with both quantities, in order of time
    length : length of a tangent, m
    places : shape (p,), m, middles of the tangents, an eighth of `length` apart, from the end
        backwards
    rows : shape (p, k), 1/m, weights of the forces in each slope
    first : shape (k,), weights of the forces in the level of the first tangent (that at the end of
        the curve) in its middle
    last : shape (m,), positions in `path` of the samples of that tangent
    """

    path: curves.CommonPath
    length: float
    places: Floats
    rows: Floats
    first: Floats
    last: Ints

    @classmethod
    def of(cls, displacement: Floats, force: Floats, *, length: float) -> Tangents:
        """Decide the samples of the tangents of a curve.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled;
            NaN are ignored
        length : length of a tangent, m

        Returns
        -------
        Tangents up to the first place without one.

        Raises
        ------
        UnavailableError
            Without a tangent at the end: ``not_reached`` (the curve is shorter than twice
            `length`), ``too_few_samples`` (fewer than 8), ``no_travel`` (the displacement jumps).

        Notes
        -----
        The slope of a tangent is that of a least-squares parabola in the middle of its stretch, so
        that the curvature of the curve is not taken for noise. A stretch contains the samples from
        when the curve first reached its start to when it first reached its end.
        """
        samples = curves.find_finite_samples(displacement, force)
        d = displacement[samples]
        if not len(d) or np.ptp(d) < 2.0 * length:
            reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
            raise UnavailableError.of("results.too_short", reached=reached, length=1e3 * length)
        low, high = float(d.min()) + 0.5 * length, float(d.max()) - 0.5 * length
        places = np.arange(high, low, -length / _TANGENTS_PER_LENGTH)
        inside, levels, slopes, counts = _weigh_parabolas(d, places, length)
        curves.require_samples(int(counts[0]), _MIN_TANGENT_SAMPLES)
        is_known = np.isfinite(levels[:, 0])
        if not is_known[0]:
            raise UnavailableError.of("results.displacement_jumps")
        usable = slice(int(np.argmin([*is_known, False])))
        rows, first = _expand(inside, slopes, len(d))[usable], _expand(inside, levels, len(d))[0]
        path = curves.CommonPath.of(displacement, force, samples)
        return cls(path, length, places[usable], rows, first, inside[0][inside[0] < len(d)])

    @property
    def ends(self) -> tuple[float, float]:
        """Return the smallest and largest displacement over the last stretch, m."""
        d = self.path.displacement[self.last]
        return float(d.min()), float(d.max())

    def fit_end_slope(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Return the slope over the last stretch of each curve.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        N/m, shape (...).
        """
        slope: Floats = self.path.move_force(force, displacement) @ self.rows[0]
        return slope

    def compute_level(self, place: float, force: Floats) -> float:
        """Return the force of the tangent over the last stretch at a place, N.

        Parameters
        ----------
        place : m
        force : shape (n,), N
        """
        path_force = self.path.move_force(force)
        return float(path_force @ self.first + path_force @ self.rows[0] * (place - self.places[0]))

    def find_onset(
        self,
        force: Floats,
        initial: Floats,
        displacement: Floats | None = None,
        *,
        slope_below: float,
    ) -> tuple[Floats, Floats]:
        """Find the place beyond which tangents stay below a share of the initial slope.

        Parameters
        ----------
        force, displacement : as for `fit_end_slope`
        initial : shape (...), N/m, slope at the start of each curve
        slope_below : share of `initial`

        Returns
        -------
        m, N, each of shape (...): from the end backwards, where the tangent first reaches the
        share, interpolated. NaN for a curve that is never so steep. The force is that of the
        parabola over half of `length` around the place: a parabola cuts a corner in proportion to
        its length.

        Examples
        --------
        >>> d = np.linspace(0.0, 0.05, 501)
        >>> f = np.where(d < 0.03, 400.0 * d - 6500.0 * d**2, 6.15)
        >>> tangents = Tangents.of(d, f, length=2e-3)
        >>> place, force = tangents.find_onset(f, np.array(400.0), slope_below=0.1)
        >>> round(1e3 * float(place), 1), round(float(force), 2)
        (27.7, 6.09)
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        share = slope_below * np.broadcast_to(initial, shape).reshape(-1)
        place = _find_first_place(self.places, f @ self.rows.T, share)
        levels = _fit_levels(self.path.displacement, f, place, 0.5 * self.length)
        return place.reshape(shape), levels.reshape(shape)

    def measure_corner_changes(
        self,
        force: Floats,
        onset: Floats | float,
        slope: Floats | float,
        displacement: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Measure the change of an onset with tangents of half the length, and the slope beyond it.

        Parameters
        ----------
        force, displacement : as for `fit_end_slope`
        onset : shape (...), m, the onset
        slope : shape (...), N/m, of the tangent there

        Returns
        -------
        Each of shape (...): change of the place, m, and of the force there, N; and the slope half a
        tangent beyond the place, N/m. The change of the place is zero if the shorter tangents do
        not reach `slope` within half a tangent of it. Force and slope beyond are those at the mean
        onset of all curves. A tangent smears a corner over its length, which moves the onset; the
        parabola for the force cuts it.
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        onset, slope = (np.broadcast_to(values, shape).reshape(-1) for values in (onset, slope))
        # One place for all curves: noise moves it by a small part of a tangent.
        d, half, middle = self.path.displacement, 0.5 * self.length, float(np.nanmean(onset))
        shorter = middle + self.length * np.linspace(0.5, -0.5, 2 * _TANGENTS_PER_LENGTH + 1)
        is_inside = (shorter <= d.max() - 0.5 * half) & (shorter >= d.min() + 0.5 * half)
        shorter = shorter[is_inside]
        inside, _, weights, _ = _weigh_parabolas(d, shorter, half)
        usable = np.isfinite(weights[:, 0])
        rows = _expand(inside[usable], weights[usable], len(d))
        reached = _find_first_place(shorter[usable], f @ rows.T, slope)
        at = np.full(len(f), middle)
        full_fit, half_fit = (_fit_levels(d, f, at, length) for length in (self.length, half))
        places, slopes = self.places[::-1], (f @ self.rows.T)[:, ::-1]
        beyond = np.array([np.interp(middle + half, places, slope) for slope in slopes])
        shifts = np.where(np.isnan(reached), 0.0, reached - onset)
        return (shifts.reshape(shape), (half_fit - full_fit).reshape(shape), beyond.reshape(shape))


def _find_first_place(places: Floats, slopes: Floats, required: Floats) -> Floats:
    """Return where slopes (R, p) at places (p,) first reach required ones (R,), or NaN.

    Between two places, the slope is interpolated.
    """
    is_steep = slopes >= required[:, None]
    number, rows = np.argmax(is_steep, axis=1), np.arange(len(slopes))
    previous = np.maximum(number - 1, 0)
    rise = slopes[rows, number] - slopes[rows, previous]
    share = (required - slopes[rows, previous]) / np.where(number > 0, rise, np.inf)
    place = places[previous] + share * (places[number] - places[previous])
    reached: Floats = np.where(is_steep[rows, number], place, np.nan)
    return reached


def _fit_levels(d: Floats, f: Floats, places: Floats, length: float) -> Floats:
    """Return forces of curves (R, k) at places (R,), from parabolas around them."""
    is_finite = np.isfinite(places)
    levels = np.full(len(places), np.nan)
    if is_finite.any():
        samples, weights, _, _ = _weigh_parabolas(d, places[is_finite], length)
        rows = np.minimum(samples, len(d) - 1)  # padding has zero weight
        levels[is_finite] = np.vecdot(weights, np.take_along_axis(f[is_finite], rows, axis=1))
    return levels


def _weigh_parabolas(
    d: Floats, places: Floats, length: float
) -> tuple[Ints, Floats, Floats, Floats]:
    """Compute least-squares parabolas through the samples of a path around places.

    Parameters
    ----------
    d : shape (k,), m
    places : shape (p,), m
    length : m, of the stretch around each place

    Returns
    -------
    samples : shape (p, m), padded with k
    levels, slopes : shape (p, m), weights of the forces in level and slope at the place, 1 and 1/m;
        NaN for a place with fewer than 8 samples, with samples over less than half of `length`, or
        with samples that do not determine a parabola
    counts : shape (p,), of the samples
    """
    edge_share = 1e-9  # a sample this close to an end counts as on it, despite rounding
    # Of the mean products of 1, x, x^2 over the samples. Samples at only two places have a
    # determinant of the order of rounding, evenly spaced samples one of 5e-4.
    min_determinant = 1e-9
    reached = np.maximum.accumulate(d)
    start = np.searchsorted(reached, places - (0.5 + edge_share) * length)
    stop = np.searchsorted(reached, places + (0.5 - edge_share) * length) + 1
    stop = np.minimum(stop, len(d))
    samples = start[:, None] + np.arange(int((stop - start).max()))
    is_inside = samples < stop[:, None]
    samples = np.where(is_inside, samples, len(d))
    x = np.where(is_inside, (np.append(d, 0.0)[samples] - places[:, None]) / length, 0.0)
    travel = np.ptp(np.where(is_inside, x, x[:, :1]), axis=1)
    powers = np.stack([is_inside * x**power for power in range(3)], axis=1)
    products = powers @ powers.transpose(0, 2, 1)
    counts = products[:, 0, 0]
    is_wide = (travel >= 0.5) & (np.linalg.det(products) > min_determinant * counts**3)
    is_enough = ((counts >= _MIN_TANGENT_SAMPLES) & is_wide)[:, None, None]
    weights = np.linalg.solve(np.where(is_enough, products, np.eye(3)), powers)
    level, slope, _ = np.moveaxis(np.where(is_enough, weights, np.nan), 1, 0)
    return samples, level, slope / length, counts


def _expand(samples: Ints, weights: Floats, count: int) -> Floats:
    """Expand weights (p, m) of the samples of each stretch to all samples (p, count)."""
    columns = np.zeros((len(samples), count + 1))
    np.put_along_axis(columns, samples, weights, axis=1)
    return columns[:, :-1]


@dataclass(frozen=True, slots=True, eq=False)
class _Corner:
    """Change of the onset with shorter tangents, and the noise of this change.

    Half of the change is in the estimate, so half of its noise is in the interval.

    Parameters
    ----------
    size : shape (2,), m and N, the change without the effect of noise
    share : shape (2,), ratio of `size` to the observed change less the mean effect of noise; zero
        if the effect of noise is unknown
    base : shape (2,), change on the smooth curve, plus the mean effect of noise
    """

    size: Floats
    share: Floats
    base: Floats

    @classmethod
    def of(cls, change: Floats, base: Floats, noise: Floats) -> _Corner:
        """Remove noise from a corner.

        Parameters
        ----------
        change, base : shape (2,), of the measured and of the smooth curve
        noise : shape (2, replicates), effect of noise on the change

        Notes
        -----
        On average noise adds its variance to the square of a corner, which is subtracted: a share
        s = sqrt(1 - v / c^2) of a corner c remains, or none if noise explains all of it.
        """
        average, variance = np.nanmean(noise, axis=1), np.nanvar(noise, axis=1)
        corner = change - average
        # NaN without a corner: noise explains all of it.
        share = np.sqrt(np.fmax(1.0 - divide(variance, corner**2), 0.0))
        return cls(share * corner, share, base + average)

    def in_noise(self, corners: Floats) -> Floats:
        """Return the effect of noise on the estimate through the corner, shape (2, ...)."""
        return 0.5 * self.share[:, None] * (corners - self.base[:, None])


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau(Kind):
    """``end_slope`` (1), ``plateau_displacement`` (m), ``plateau_force`` (N): end of a loading."""

    result: ClassVar = "plateau"
    outputs: ClassVar = (
        Output("end_slope", "1", "End slope", can_be_negative=True),
        Output("plateau_displacement", "m", "Displacement at the plateau"),
        Output("plateau_force", "N", "Plateau force"),
    )
    method: ClassVar = "slope over the last {over_mm:g} mm of first loading / {of}"
    slope_below: Annotated[Fraction, "Share of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Stretch that a tangent is read from"] = 0.005

    def compute(self, test: ReducedTest) -> list[Part]:
        """Measure the plateau; without the slope at the end, the onset is left out."""
        end, *other_numbers = super(Plateau, self).compute(test)
        return [end, *other_numbers] if isinstance(end, Result) and end.value is not None else [end]

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure the slope at the end of the first loading, and the onset of a plateau."""
        missing = Failure.of("results.no_stiffness", name=self.of)
        initial = test.require(test.stiffnesses.get(self.of), missing)
        outcome = test.measure_one(partial(self._decide_end, initial=initial.decide))
        first, period = test.cycles[0][:1], test.find_loading_interval()
        slips, gap = find_marked_slips(test, initial.slip_range), _find_gap_at_end(test, first[0])
        doubts = slips or find_truncation(test, first, CURVE_QUANTITIES) or gap
        end = self.make_result(test, outcome, period=period, doubts=doubts)
        yield end
        onset, trace = self._measure_onset(test, initial, end), curves.make_trace(test)
        (d, f), (tangents, _) = _read_loading(trace), self._choose_tangents(trace, initial.decide)
        if not onset and end.interval is not None:
            yield Finding.of(
                "results.no_plateau",
                test.signals.force,
                over=1e3 * self.over,
                slope=1e2 * outcome.value,
                of=self.of,
                low=1e2 * end.interval.lower,
                high=1e2 * end.interval.upper,
                slope_below=1e2 * self.slope_below,
                reached=1e3 * float(np.nanmax(d)),
            )
        method = (
            f"tangents over {1e3 * self.over:g} mm, below {1e2 * self.slope_below:g} % of "
            f"{self.of} up to the end of first loading"
        )
        common = {"method": method, "period": period, "doubts": slips or gap}
        yield from self.make_results(test, onset, first=1, **common)
        start, stop = tangents.ends
        slope, level = float(tangents.fit_end_slope(f)), tangents.compute_level(start, f)
        yield FittedLine("slope_at_end", slope, level, start, stop)

    def _choose_tangents(self, trace: Trace, initial: Decide) -> tuple[Tangents, Reading]:
        """Return the tangents of the first loading, and the slope at its start."""
        slope = initial(trace)
        value = float(slope.numbers(trace)[0])
        if value <= 0.0:
            raise UnavailableError.of("results.no_initial_slope", value=value)
        return Tangents.of(*_read_loading(trace), length=self.over), slope

    def _decide_end(self, trace: Trace, *, initial: Decide) -> Reading:
        """Decide the samples for the slope at the end over that at the start."""
        tangents, slope = self._choose_tangents(trace, initial)
        steeper = self._change_per_step(trace, tangents)

        def numbers(trace: Trace) -> tuple[Floats]:
            d, f = _read_loading(trace)
            end = tangents.fit_end_slope(f, d) + trace.steps_beyond * steeper
            return (np.asarray(end / slope.numbers(trace)[0], dtype=np.float64),)

        return Reading(numbers, len(tangents.last), ends_at_samples=slope.ends_at_samples)

    def _change_per_step(self, trace: Trace, tangents: Tangents) -> float:
        """Return the change of the slope at the end with one more sampling step, N/m.

        From the step before: the machine turned somewhere between two samples.
        """
        d, f = _read_loading(trace)
        earlier_tangents = return_failure(Tangents.of)(d[:-1], f[:-1], length=self.over)
        if isinstance(earlier_tangents, Failure):
            return 0.0
        return float(tangents.fit_end_slope(f) - earlier_tangents.fit_end_slope(f[:-1]))

    def _find_onset(
        self, trace: Trace, choice: tuple[Tangents, Reading]
    ) -> tuple[Floats, Floats, Floats]:
        """Return place and force of the onset of each curve, and its initial slope."""
        (tangents, slope), (d, f) = choice, _read_loading(trace)
        initial = slope.numbers(trace)[0]
        return *tangents.find_onset(f, initial, d, slope_below=self.slope_below), initial

    def _decide_onset(self, trace: Trace, *, initial: Decide, corner: _Corner) -> Reading:
        """Decide the samples for the onset of the plateau and its force."""
        choice = self._choose_tangents(trace, initial)

        def numbers(trace: Trace) -> tuple[Floats, Floats]:
            place, level, _ = self._find_onset(trace, choice)
            shorter = trace.sizes.get(TANGENT, 0.0)
            return place + shorter * corner.size[0], level + shorter * corner.size[1]

        def in_noise(trace: Trace) -> tuple[Floats, Floats]:
            place, level, _ = self._find_onset(trace, choice)
            place_error, level_error = corner.in_noise(self._measure_corners(trace, choice))
            return place + place_error, level + level_error

        if np.isnan(numbers(trace)[1]):
            raise UnavailableError.of("results.no_onset")
        return Reading(numbers, len(choice[0].last), in_noise)

    def _measure_corners(self, trace: Trace, choice: tuple[Tangents, Reading]) -> Floats:
        """Return the largest error of the onset from the length of tangents, m and N, (2, ...)."""
        # In multiples of the change with tangents of half the length. A corner is smeared in
        # proportion to the length, so it is twice that change away; a smooth bend in proportion to
        # its square, so it is 4/3 of that change away. From zero to the factor contains both.
        smearing_factor = 3.0
        cut_factor = 2.0  # the force from half the length loses once or a third of its change
        (d, f), (place, _, initial) = _read_loading(trace), self._find_onset(trace, choice)
        slope = self.slope_below * initial
        smeared, cut, beyond = choice[0].measure_corner_changes(f, place, slope, d)
        corner_shift = smearing_factor * smeared
        return np.stack([corner_shift, cut_factor * cut + corner_shift * beyond])

    def _estimate_corner(self, replicates: Replicates, initial: Decide) -> _Corner:
        """Return the error of the onset for the measured curve, less noise.

        The smooth curve may have no corners of this size, so noise is counted from its own change.
        If it has no tangents or no initial slope, noise is not removed.
        """
        measured = self._choose_tangents(replicates.measured, initial)
        change = self._measure_corners(replicates.measured, measured)
        smooth = return_failure(self._choose_tangents)(replicates.smooth, initial)
        if isinstance(smooth, Failure):
            return _Corner(change, np.zeros(2), np.zeros(2))
        base = self._measure_corners(replicates.smooth, smooth)
        corners = [self._measure_corners(trace, smooth) for trace in replicates.iterate_traces()]
        return _Corner.of(change, base, np.concatenate(corners, axis=1) - base[:, None])

    def _measure_onset(
        self, test: ReducedTest, initial: Stiffness, end: Result
    ) -> Sequence[Outcome]:
        """Measure place and force of the onset, with the length of the tangents as an input.

        Empty without a plateau, which is not a failure.
        """
        if end.interval is None or not end.interval.upper < self.slope_below:
            return ()

        def shorten(trace: Trace, x: float) -> Trace:
            return replace(trace, sizes={**trace.sizes, TANGENT: x})

        replicates = test.require(test.replicates)
        choice = self._choose_tangents(replicates.measured, initial.decide)
        if np.isnan(self._find_onset(replicates.measured, choice)[1]):
            return 2 * (Failure.of("results.no_onset"),)
        inputs = (*replicates.inputs, Input(TANGENT, shorten, distribution="ends"))
        corner = self._estimate_corner(replicates, initial.decide)
        decide = partial(self._decide_onset, initial=initial.decide, corner=corner)
        outcome = return_failure(measure_numbers)(replace(replicates, inputs=inputs), decide)
        return 2 * (outcome,) if isinstance(outcome, Failure) else outcome


def _read_loading(trace: Trace) -> tuple[Floats, Floats]:
    """Return displacement and force of the first loading."""
    stretch = curves.select_first_loading(trace)
    return trace.displacement[..., stretch], trace.force[..., stretch]


def _find_gap_at_end(test: ReducedTest, branch: Branch) -> tuple[Reason, ...]:
    """Return a doubt if force or displacement is missing from the end of a loading branch."""
    curve = test.required_curve
    d, f = (values[branch.start : branch.stop] for values in (curve.displacement, curve.force))
    finite = np.flatnonzero(np.isfinite(f) & np.isfinite(d))
    if not len(finite) or finite[-1] >= len(d) - 3:  # lost when two clocks are joined
        return ()
    end, missing = 1e3 * float(d[finite[-1]]), len(d) - 1 - finite[-1]
    return (Reason.of("results.gap_at_end", end=end, missing=missing),)
