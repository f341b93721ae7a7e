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
from labpipe.results.kinds import (
    Kind,
    Outcome,
    Part,
    ReducedTest,
    Stiffness,
    find_marked_slips,
    find_pause,
)
from labpipe.results.stiffness import RangeKind
from labpipe.uncertainty.intervals import Measured, measure_numbers
from labpipe.uncertainty.replicates import Decide, Input, Reading, Replicates, Trace

_MIN_SEGMENT_SAMPLES = 4


class Segments(NamedTuple):
    """Two lines that meet, for each of many curves.

    Parameters
    ----------
    break_point : shape (...), m, displacement at which the lines meet
    first_slope, second_slope : shape (...), N/m, slopes of the lines before and after the break
    break_force : shape (...), N, force at which the lines meet
    """

    break_point: Floats
    first_slope: Floats
    second_slope: Floats
    break_force: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Hinges:
    """Candidate breaks between two lines, chosen on one curve, the reference curve.

    Parameters
    ----------
    path : samples with force and displacement, sorted by displacement
    x : shape (k,), displacements of these samples, scaled to -1 to 1
    candidates : shape (300,), candidate breaks on the scale of `x`
    line_residual : N, standard deviation of the reference curve about one straight line
    grid_correction : distance from the best candidate to the globally best break of the reference
        curve, on the scale of `x`
    """

    path: curves.CommonPath
    x: Floats
    candidates: Floats
    line_residual: float
    grid_correction: float = 0.0

    @classmethod
    def of(cls, displacement: Floats, force: Floats) -> Hinges:
        """Choose the candidate breaks of a curve.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time; NaN
            are ignored

        Returns
        -------
        Equidistant candidates, from the eighth sample to the eighth last one. With fewer than 64
        samples, they begin after an eighth of the samples, but at least at the fourth one.

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
        candidates = np.linspace(x[margin], x[-1 - margin], 300)
        residuals = y - y.mean() - curves.compute_slope(x, y) * (x - x.mean())
        line_residual = float(np.sqrt(residuals @ residuals / (len(x) - 2)))
        hinges = cls(curves.CommonPath.of(displacement, force, order), x, candidates, line_residual)
        best = hinges._find_global_break(residuals)
        return replace(hinges, grid_correction=best - float(hinges._find_breaks(y[None])[0]))

    @property
    def ends(self) -> tuple[float, float]:
        """First and last displacement of the stretch, m."""
        return float(self.path.displacement[0]), float(self.path.displacement[-1])

    def to_displacement(self, x: Floats | float) -> Floats:
        """Convert positions on the scale of `x` to displacements, m."""
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
        Breaks, slopes and forces of shape (...); NaN for a curve with NaN among the samples.

        Notes
        -----
        The break of the reference curve is the global least-squares optimum between its fourth
        sample and its fourth last one. It is found by a scan of all samples and of the gaps between
        them (Hudson, J. Am. Stat. Assoc. 61 (1966) 1097). For all other curves the 300 candidates
        are tried. A hinge max(x - c, 0) reduces the sum of squares about one straight line by
        (y'u)^2, where u is the hinge less its own line, scaled to length 1. The candidate with the
        largest reduction is refined by the parabola through it and its neighbours, and shifted by
        the error that this refinement has for the reference curve. The lines are the least-squares
        lines with this break. Noise of the displacement counts as noise of the force
        (`CommonPath`).
        """
        y = self.path.move_force(force, displacement)
        shape, y, x = y.shape[:-1], y.reshape(-1, y.shape[-1]), self.x
        break_range = x[_MIN_SEGMENT_SAMPLES - 1], x[-_MIN_SEGMENT_SAMPLES]
        breaks = np.clip(self._find_breaks(y) + self.grid_correction, *break_range)
        hinge, lever = np.maximum(x - breaks[:, None], 0.0), x - x.mean()
        spread, hinge_mean = lever @ lever, hinge.mean(axis=1)
        hinge_slope, curve_slope = hinge @ lever / spread, y @ lever / spread
        hinge -= hinge_mean[:, None] + np.outer(hinge_slope, lever)
        norm = np.vecdot(hinge, hinge)
        bend = np.vecdot(y, hinge) / np.where(norm > 1e-14 * len(x), norm, np.nan)
        first_slope = curve_slope - bend * hinge_slope
        force_at_break = y.mean(axis=1) + first_slope * (breaks - x.mean()) - bend * hinge_mean
        scale = 2.0 / (self.ends[1] - self.ends[0])
        slopes = scale * first_slope, scale * (first_slope + bend)
        numbers = self.to_displacement(breaks), *slopes, force_at_break
        return Segments(*(number.reshape(shape) for number in numbers))

    def _find_breaks(self, y: Floats) -> Floats:
        """Find the best breaks (R,) of curves (R, k), between candidates by a parabola."""
        candidates = self.candidates
        gain = self._compute_gain(y, candidates)
        best = np.clip(np.argmax(gain, axis=1), 1, len(candidates) - 2)
        neighbours = np.take_along_axis(gain, best[:, None] + [-1, 0, 1], axis=1)
        previous, largest, following = neighbours.T
        curvature = 2.0 * largest - previous - following
        offset = 0.5 * (following - previous) / np.where(curvature > 0.0, curvature, np.inf)
        breaks: Floats = candidates[best] + np.clip(offset, -1.0, 1.0) * np.diff(candidates)[0]
        return breaks

    def _compute_gain(self, y: Floats, breaks: Floats) -> Floats:
        """Compute how much a hinge at each break reduces the sum of squares of curves (R, k)."""
        x, lever = self.x, self.x - self.x.mean()
        starts = np.append(0, np.searchsorted(x, breaks))
        is_empty = np.diff(starts, append=len(x)) == 0
        sums_beyond = []
        for values in (np.stack([np.ones_like(x), x, x * x]), y, y * x):
            sums = np.add.reduceat(values, starts, axis=1)
            sums[:, is_empty] = 0.0  # `reduceat` returns the first sample of an empty stretch
            sums_beyond.append(np.cumsum(sums[:, :0:-1], axis=1)[:, ::-1])
        (n, sx, sxx), sy, sxy = sums_beyond
        spread, sh = lever @ lever, sx - breaks * n
        cross = sxx - breaks * sx - x.mean() * sh
        norms = sxx - 2.0 * breaks * sx + breaks**2 * n - sh**2 / len(x) - cross**2 / spread
        product = sxy - breaks * sy - np.outer(y.mean(axis=1), sh)
        product -= np.outer(y @ lever, cross / spread)
        return np.asarray(product**2 / np.where(norms > 1e-14 * len(x), norms, np.inf))

    def _find_global_break(self, residuals: Floats) -> float:
        """Find the best break of a curve, at a sample or where lines meet inside a gap.

        The residuals (k,), N, are those about one straight line, so that their sums do not cancel.
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


def require_bend(segments: tuple[Measured, ...], hinges: Hinges) -> None:
    """Require that a curve bends, by its replicates.

    Parameters
    ----------
    segments : fields of `Segments` for the curve, with their replicates
    hinges : candidate breaks of the curve

    Raises
    ------
    UnavailableError
        ``no_bend`` if the slopes differ by at most four standard errors, or if at least 2.5 % of
        the replicates have their break within the first or last three candidates, or would have it
        there with their deviation reversed.

    Notes
    -----
    The break is chosen for the largest difference of the slopes. By chance, the difference on a
    straight line therefore exceeds two standard errors much more often than once in twenty. The
    standard error is the distance between the median of all replicates and their 2.5 % quantile on
    the side of less bend, over 1.96. The other side does not count, because replicates whose break
    moves towards an end have steeper slopes beyond it, which is no evidence against a bend.
    """
    min_bend_errors = 4.0
    break_point, first, second, _ = segments
    bend, deviations = second.value - first.value, second.deviations - first.deviations
    middle, smallest = np.nanquantile(deviations, [0.5, 0.975 if bend < 0.0 else 0.025]).tolist()
    error = abs(smallest - middle) / NORMAL_95
    if not abs(bend) > min_bend_errors * error:
        slopes = {"first": first.value, "second": second.value, "bend": abs(bend)}
        raise UnavailableError.of("results.no_bend", **slopes, needed=min_bend_errors, error=error)
    low, high = hinges.to_displacement(hinges.candidates[[2, -3]])
    errors = break_point.deviations[~np.isnan(break_point.deviations)]
    for breaks in (break_point.value + errors, break_point.value - errors):
        if np.mean((breaks <= low) | (breaks >= high)) >= 0.025:
            start, stop = hinges.ends
            raise UnavailableError.of("results.bends_at_end", start=start, stop=stop)


def require_kink(segments: tuple[Measured, ...], hinges: Hinges) -> None:
    """Require that the slope of a curve decreases at a kink, by its replicates.

    Parameters
    ----------
    segments : fields of `Segments` for the curve, with their replicates
    hinges : candidate breaks of the curve

    Raises
    ------
    UnavailableError
        ``no_kink`` if the curve does not bend, or bends upwards; ``kink_at_end`` if the lines meet
        in the first or the last twentieth of the stretch.
    """
    start, stop = (1e3 * end for end in hinges.ends)
    no_bend, rms = return_failure(require_bend)(segments, hinges), hinges.line_residual
    if no_bend is not None:
        why = no_bend.message
        raise UnavailableError.of("results.no_kink", rms=rms, start=start, stop=stop, why=why)
    break_mm, first, second = 1e3 * segments[0].value, segments[1].value, segments[2].value
    if second >= first:
        raise UnavailableError.of("results.slope_rises", first=first, second=second, place=break_mm)
    margin = 0.05 * (stop - start)  # a break closer to an end may be that of the end itself
    if not start + margin <= break_mm <= stop - margin:
        raise UnavailableError.of("results.kink_at_end", place=break_mm, start=start, stop=stop)


def find_break_doubts(interval: Interval, hinges: Hinges) -> tuple[Reason, ...]:
    """Return a doubt ``wide_break`` if an interval is longer than a quarter of the stretch.

    Parameters
    ----------
    interval : m, 95 % interval of the break
    hinges : candidate breaks of the curve
    """
    start, stop, low, high = (1e3 * end for end in (*hinges.ends, interval.lower, interval.upper))
    if high - low <= 0.25 * (stop - start):
        return ()
    return (Reason.of("results.wide_break", width=high - low, start=start, stop=stop),)


def find_contact_doubts(segments: tuple[Measured, ...], hinges: Hinges) -> tuple[Reason, ...]:
    """Return a doubt ``late_contact`` if the specimen is not loaded where the first line begins.

    Parameters
    ----------
    segments : fields of `Segments` for the curve, with their replicates
    hinges : candidate breaks of the curve

    Notes
    -----
    The specimen is not loaded if the first line begins at a force of the opposite sign, of at least
    a twentieth of the force at the end of the stretch. Nor is it if the slope of the first line and
    the force at the break are almost zero.
    """
    min_force_fraction, min_slope_ratio = 0.05, 0.02
    break_point, first, second, level = (x.value for x in segments)
    start, stop = hinges.ends
    start_force, end_force = (
        level - first * (break_point - start),
        level + second * (stop - break_point),
    )
    is_flat = abs(first) < min_slope_ratio * abs(second)
    is_unloaded = is_flat and abs(level) < abs(min_force_fraction * end_force)
    if start_force / end_force >= -min_force_fraction and not is_unloaded:
        return ()
    return (Reason.of("results.late_contact", start=1e3 * start),)


class _TwoLineKind(RangeKind):
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
        test : reduced test
        require : function that raises an error without such a break, as `require_bend`

        Returns
        -------
        segments : fields of `Segments`, with their replicates
        hinges : candidate breaks of the curve
        """
        segments = test.measure(self.decide)
        _, hinges = self._choose_hinges(curves.make_trace(test))
        require(segments, hinges)
        return segments, hinges

    def decide(self, trace: Trace) -> Reading:
        """Choose the samples and candidate breaks for two lines.

        Parameters
        ----------
        trace : one curve

        Returns
        -------
        The reading of the fields of `Segments`.
        """
        samples, hinges = self._choose_hinges(trace)

        def fit_segments(trace: Trace) -> Segments:
            return hinges.fit(trace.force[..., samples], trace.displacement[..., samples])

        return Reading(fit_segments, len(hinges.x), ends_at_samples=True, depends_on_corners=True)

    def decide_field(self, trace: Trace, *, index: int) -> Reading:
        """Choose the samples and candidate breaks for one field of `Segments`.

        Parameters
        ----------
        trace : one curve
        index : index of the field
        """
        reading = self.decide(trace)
        return replace(reading, numbers=lambda trace: (reading.numbers(trace)[index],))

    def _choose_hinges(self, trace: Trace) -> tuple[slice, Hinges]:
        """Return the samples of the range, and the candidate breaks in it."""
        samples = self.select_samples(trace)
        return samples, Hinges.of(trace.displacement[samples], trace.force[samples])


def _make_lines(
    segments: tuple[Measured, ...], hinges: Hinges, names: tuple[str, str]
) -> tuple[FittedLine, ...]:
    """Make the named lines before and after a break."""
    (break_point, first, second, level), (start, stop) = (x.value for x in segments), hinges.ends
    return (
        FittedLine(names[0], first, level - first * (break_point - start), start, break_point),
        FittedLine(names[1], second, level, break_point, stop),
    )


class TwoSegments(_TwoLineKind):
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
        segments, hinges = self.fit(test, require_bend)
        break_point, (start, stop) = segments[0], hinges.ends
        period = test.find_loading_interval(start, stop)
        sample_doubts = find_contact_doubts(segments, hinges) + find_pause(test, hinges.ends)
        doubts = find_marked_slips(test, hinges.ends) + sample_doubts
        yield from self.make_results(test, segments[1:3], period=period, doubts=doubts)
        doubts += find_break_doubts(break_point.interval, hinges)
        yield self.make_result(test, break_point, output=2, period=period, doubts=doubts)
        windows = (max(start, 0.0), break_point.value), (max(break_point.value, 0.0), stop)
        names = self.outputs[0].name, self.outputs[1].name
        for index, (name, window) in enumerate(zip(names, windows, strict=True), start=1):
            decide, slope = partial(self.decide_field, index=index), segments[index].value
            # A slip anywhere in the stretch affects both slopes.
            yield Stiffness(name, decide, slope, period, window, hinges.ends, sample_doubts)
        yield from _make_lines(segments, hinges, names)


class Kink(_TwoLineKind):
    """``kink_displacement`` (m) and ``kink_force`` (N): where the first loading gets less steep."""

    result: ClassVar = "kink"
    outputs: ClassVar = (
        Output("kink_displacement", "m", "Displacement at the kink"),
        Output("kink_force", "N", "Kink force"),
    )

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Find the decrease of the slope of the first loading."""
        segments, hinges = self.fit(test, require_kink)
        displacement, _, _, force = segments
        slips = find_marked_slips(test, hinges.ends) + find_pause(test, hinges.ends)
        doubts = slips + find_break_doubts(displacement.interval, hinges)
        period = test.find_loading_interval(*hinges.ends)
        yield from self.make_results(test, (displacement, force), period=period, doubts=doubts)
        yield from _make_lines(segments, hinges, ("before_kink", "behind_kink"))


_TANGENTS_PER_LENGTH = 8
"""Number of tangents whose midpoints lie within the length of one tangent."""
_MIN_TANGENT_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Tangents of a loading curve, from its end backwards, whose samples are chosen on one curve.

    Parameters
    ----------
    path : samples with force and displacement, in order of time
    length : length of a tangent, m
    midpoints : shape (p,), m, displacements at the middle of the tangents, an eighth of `length`
        apart, from the end backwards
    slope_weights : shape (p, k), 1/m, weights of the forces in the slope of each tangent
    end_force_weights : shape (k,), weights of the forces in the force of the tangent at the end of
        the curve, at its midpoint
    end_samples : shape (m,), indices in `path` of the samples of the tangent at the end
    """

    path: curves.CommonPath
    length: float
    midpoints: Floats
    slope_weights: Floats
    end_force_weights: Floats
    end_samples: Ints

    @classmethod
    def of(cls, displacement: Floats, force: Floats, *, length: float) -> Tangents:
        """Choose the samples of the tangents of a curve.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled;
            NaN are ignored
        length : length of a tangent, m

        Returns
        -------
        The tangents from the end up to the first gap without one.

        Raises
        ------
        UnavailableError
            Without a tangent at the end: ``not_reached`` (the curve is shorter than twice
            `length`), ``too_few_samples`` (fewer than 8), ``no_travel`` (the displacement jumps).

        Notes
        -----
        The slope of a tangent is that of a least-squares parabola in the middle of its stretch, so
        that the curvature of the curve is not taken for noise. The samples of a stretch are those
        from the time at which the curve first reaches its start to that at which it first reaches
        its end.
        """
        samples = curves.find_finite_samples(displacement, force)
        d = displacement[samples]
        if not len(d) or np.ptp(d) < 2.0 * length:
            reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
            raise UnavailableError.of("results.too_short", reached=reached, length=1e3 * length)
        low, high = float(d.min()) + 0.5 * length, float(d.max()) - 0.5 * length
        midpoints = np.arange(high, low, -length / _TANGENTS_PER_LENGTH)
        inside, force_weights, slope_weights, counts = _weigh_parabolas(d, midpoints, length)
        curves.require_samples(int(counts[0]), _MIN_TANGENT_SAMPLES)
        is_determined = np.isfinite(force_weights[:, 0])
        if not is_determined[0]:
            raise UnavailableError.of("results.displacement_jumps")
        up_to_gap = slice(int(np.argmin([*is_determined, False])))
        slope_weights = _expand_weights(inside, slope_weights, len(d))[up_to_gap]
        end_force_weights = _expand_weights(inside, force_weights, len(d))[0]
        path, end_samples = curves.CommonPath.of(displacement, force, samples), inside[0]
        end_samples, midpoints = end_samples[end_samples < len(d)], midpoints[up_to_gap]
        return cls(path, length, midpoints, slope_weights, end_force_weights, end_samples)

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest displacement of the tangent at the end, m."""
        d = self.path.displacement[self.end_samples]
        return float(d.min()), float(d.max())

    def fit_end_slope(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Compute the slope of the tangent at the end of each curve.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        shape (...), N/m.
        """
        slope: Floats = self.path.move_force(force, displacement) @ self.slope_weights[0]
        return slope

    def compute_end_tangent(self, displacement: float, force: Floats) -> float:
        """Compute the force of the tangent at the end of a curve, N, at a displacement.

        Parameters
        ----------
        displacement : m
        force : shape (n,), N, of the curve
        """
        path_force = self.path.move_force(force)
        distance = displacement - self.midpoints[0]
        weights = self.end_force_weights + self.slope_weights[0] * distance
        return float(path_force @ weights)

    def find_onset(
        self,
        force: Floats,
        initial_slope: Floats,
        displacement: Floats | None = None,
        *,
        slope_below: float,
    ) -> tuple[Floats, Floats]:
        """Find the point beyond which tangents stay below a fraction of the initial slope.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        initial_slope : shape (...), N/m, slope at the start of each curve
        displacement : shape (..., n), m; None for that of the reference curve
        slope_below : the fraction of `initial_slope`

        Returns
        -------
        onset : shape (...), m, displacement at which the tangent first reaches the fraction, from
            the end backwards, interpolated; NaN for a curve that is never so steep
        onset_force : shape (...), N, force there, of the parabola over half of `length`, since a
            parabola cuts a corner in proportion to its length

        Examples
        --------
        >>> d = np.linspace(0.0, 0.05, 501)
        >>> f = np.where(d < 0.03, 400.0 * d - 6500.0 * d**2, 6.15)
        >>> tangents = Tangents.of(d, f, length=2e-3)
        >>> onset, onset_force = tangents.find_onset(f, np.array(400.0), slope_below=0.1)
        >>> round(1e3 * float(onset), 1), round(float(onset_force), 2)
        (27.7, 6.09)
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        required = slope_below * np.broadcast_to(initial_slope, shape).reshape(-1)
        onset = _interpolate_first_crossing(self.midpoints, f @ self.slope_weights.T, required)
        onset_force = _fit_forces(self.path.displacement, f, onset, 0.5 * self.length)
        return onset.reshape(shape), onset_force.reshape(shape)

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
        force : shape (..., n), N, with the samples of the reference curve
        onset : shape (...), m, displacement at the onset
        slope : shape (...), N/m, slope of the tangent at the onset
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        onset_change : shape (...), m; zero if the shorter tangents do not reach `slope` within half
            a tangent of the onset
        force_change : shape (...), N, change of the force at the mean onset of all curves
        slope_beyond : shape (...), N/m, slope half a tangent beyond the mean onset

        Notes
        -----
        A tangent smears a corner over its length, which moves the onset. The parabola for the force
        cuts the corner.
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        onset, slope = (np.broadcast_to(values, shape).reshape(-1) for values in (onset, slope))
        # All curves share one mean onset, since noise moves it by a small part of a tangent.
        d, half, middle = self.path.displacement, 0.5 * self.length, float(np.nanmean(onset))
        midpoints = middle + self.length * np.linspace(0.5, -0.5, 2 * _TANGENTS_PER_LENGTH + 1)
        is_inside = (midpoints <= d.max() - 0.5 * half) & (midpoints >= d.min() + 0.5 * half)
        midpoints = midpoints[is_inside]
        samples, _, weights, _ = _weigh_parabolas(d, midpoints, half)
        is_determined = np.isfinite(weights[:, 0])
        weights = _expand_weights(samples[is_determined], weights[is_determined], len(d))
        crossing = _interpolate_first_crossing(midpoints[is_determined], f @ weights.T, slope)
        at = np.full(len(f), middle)
        full_fit, half_fit = (_fit_forces(d, f, at, length) for length in (self.length, half))
        midpoints, slopes = self.midpoints[::-1], (f @ self.slope_weights.T)[:, ::-1]
        slope_beyond = np.array([np.interp(middle + half, midpoints, row) for row in slopes])
        change = np.where(np.isnan(crossing), 0.0, crossing - onset)
        changes = change.reshape(shape), (half_fit - full_fit).reshape(shape)
        return *changes, slope_beyond.reshape(shape)


def _interpolate_first_crossing(positions: Floats, slopes: Floats, required: Floats) -> Floats:
    """Interpolate where slopes (R, p) at positions (p,) first reach the required (R,), or NaN."""
    is_steep = slopes >= required[:, None]
    index, rows = np.argmax(is_steep, axis=1), np.arange(len(slopes))
    previous = np.maximum(index - 1, 0)
    rise = slopes[rows, index] - slopes[rows, previous]
    fraction = (required - slopes[rows, previous]) / np.where(index > 0, rise, np.inf)
    position = positions[previous] + fraction * (positions[index] - positions[previous])
    crossing: Floats = np.where(is_steep[rows, index], position, np.nan)
    return crossing


def _fit_forces(d: Floats, f: Floats, positions: Floats, length: float) -> Floats:
    """Fit the forces of curves (R, k) at positions (R,) by parabolas around them."""
    is_finite = np.isfinite(positions)
    forces = np.full(len(positions), np.nan)
    if is_finite.any():
        samples, weights, _, _ = _weigh_parabolas(d, positions[is_finite], length)
        rows = np.minimum(samples, len(d) - 1)  # padding has zero weight
        forces[is_finite] = np.vecdot(weights, np.take_along_axis(f[is_finite], rows, axis=1))
    return forces


def _weigh_parabolas(
    d: Floats, positions: Floats, length: float
) -> tuple[Ints, Floats, Floats, Floats]:
    """Compute least-squares parabolas through the samples of a path around positions.

    Parameters
    ----------
    d : shape (k,), m, displacements of the path in order of time
    positions : shape (p,), m, displacements at which force and slope are wanted
    length : m, length of the stretch around each position

    Returns
    -------
    samples : shape (p, m), indices of the samples of each stretch, padded with k
    force_weights, slope_weights : shape (p, m), 1 and 1/m, weights of the forces in force and slope
        at the position; NaN for a stretch with fewer than 8 samples, with samples over less than
        half of `length`, or with samples that do not determine a parabola
    counts : shape (p,), number of samples of each stretch
    """
    edge_tolerance = 1e-9  # a sample this close to an end counts as on it, despite rounding
    # The determinant is that of the mean products of 1, x, x^2 over the samples. Samples at only
    # two displacements have one of the order of rounding, evenly spaced samples one of 5e-4.
    min_determinant = 1e-9
    largest_so_far = np.maximum.accumulate(d)
    start = np.searchsorted(largest_so_far, positions - (0.5 + edge_tolerance) * length)
    stop = np.searchsorted(largest_so_far, positions + (0.5 - edge_tolerance) * length) + 1
    stop = np.minimum(stop, len(d))
    samples = start[:, None] + np.arange(int((stop - start).max()))
    is_inside = samples < stop[:, None]
    samples = np.where(is_inside, samples, len(d))
    x = np.where(is_inside, (np.append(d, 0.0)[samples] - positions[:, None]) / length, 0.0)
    travel = np.ptp(np.where(is_inside, x, x[:, :1]), axis=1)
    powers = np.stack([is_inside * x**power for power in range(3)], axis=1)
    products = powers @ powers.transpose(0, 2, 1)
    counts = products[:, 0, 0]
    is_determined = (travel >= 0.5) & (np.linalg.det(products) > min_determinant * counts**3)
    is_enough = ((counts >= _MIN_TANGENT_SAMPLES) & is_determined)[:, None, None]
    weights = np.linalg.solve(np.where(is_enough, products, np.eye(3)), powers)
    force_weights, slope_weights, _ = np.moveaxis(np.where(is_enough, weights, np.nan), 1, 0)
    return samples, force_weights, slope_weights / length, counts


def _expand_weights(samples: Ints, weights: Floats, count: int) -> Floats:
    """Expand weights (p, m) of the samples of each stretch to all samples (p, count)."""
    columns = np.zeros((len(samples), count + 1))
    np.put_along_axis(columns, samples, weights, axis=1)
    return columns[:, :-1]


@dataclass(frozen=True, slots=True, eq=False)
class _Corner:
    """Largest error of the onset from the length of tangents, and the noise of this error.

    Half of it corrects the estimate, so half of its noise is in the interval. The two rows are
    those of displacement (m) and force (N) at the onset.

    Parameters
    ----------
    error : shape (2,), m and N, the error without the effect of noise
    remaining_ratio : shape (2,), ratio of `error` to the measured error less the mean effect of
        noise; zero if the effect of noise is unknown
    noisy_base : shape (2,), m and N, error on the smooth curve, plus the mean effect of noise
    """

    error: Floats
    remaining_ratio: Floats
    noisy_base: Floats

    @classmethod
    def of(cls, measured: Floats, smooth: Floats, noise: Floats) -> _Corner:
        """Remove the effect of noise from the error of an onset.

        Parameters
        ----------
        measured, smooth : shape (2,), m and N, errors on the measured and on the smooth curve
        noise : shape (2, replicates), m and N, effect of noise on the error

        Notes
        -----
        On average, noise adds its variance v to the square of an error c. This is subtracted, so
        that the ratio sqrt(1 - v / c^2) of the error remains, or none if noise explains all of it.
        """
        average, variance = np.nanmean(noise, axis=1), np.nanvar(noise, axis=1)
        error = measured - average
        # An error of zero gives NaN, which `fmax` replaces: noise explains all of it.
        ratio = np.sqrt(np.fmax(1.0 - divide(variance, error**2), 0.0))
        return cls(ratio * error, ratio, smooth + average)

    def compute_noise_effect(self, errors: Floats) -> Floats:
        """Compute the effect of noise on the estimate from errors (2, ...) of noisy curves."""
        return 0.5 * self.remaining_ratio[:, None] * (errors - self.noisy_base[:, None])


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
        """Measure the plateau, whose onset is left out if the slope at the end is not available."""
        end_slope, *onset = super().compute(test)
        has_end_slope = isinstance(end_slope, Result) and end_slope.value is not None
        return [end_slope, *onset] if has_end_slope else [end_slope]

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure the slope at the end of the first loading, and the onset of a plateau."""
        missing = Failure.of("results.no_stiffness", name=self.of)
        initial = test.require(test.stiffnesses.get(self.of), missing)
        outcome = test.measure_one(partial(self._decide_end_slope, initial=initial.decide))
        loading, period = test.cycles[0][:1], test.find_loading_interval()
        slips, gap = find_marked_slips(test, initial.slip_range), _find_gap_at_end(test, loading[0])
        doubts = slips or find_truncation(test, loading, CURVE_QUANTITIES) or gap
        end_slope = self.make_result(test, outcome, period=period, doubts=doubts)
        yield end_slope
        onset, trace = self._measure_onset(test, initial, end_slope), curves.make_trace(test)
        (d, f), (tangents, _) = _read_loading(trace), self._choose_tangents(trace, initial.decide)
        if not onset and (interval := end_slope.interval) is not None:
            yield Finding.of(
                "results.no_plateau",
                test.signals.force,
                over=1e3 * self.over,
                slope=1e2 * outcome.value,
                of=self.of,
                low=1e2 * interval.lower,
                high=1e2 * interval.upper,
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
        slope, force = float(tangents.fit_end_slope(f)), tangents.compute_end_tangent(start, f)
        yield FittedLine("slope_at_end", slope, force, start, stop)

    def _choose_tangents(self, trace: Trace, initial: Decide) -> tuple[Tangents, Reading]:
        """Choose the tangents of the first loading, and the samples of the slope at its start."""
        reading = initial(trace)
        value = float(reading.numbers(trace)[0])
        if value <= 0.0:
            raise UnavailableError.of("results.no_initial_slope", value=value)
        return Tangents.of(*_read_loading(trace), length=self.over), reading

    def _decide_end_slope(self, trace: Trace, *, initial: Decide) -> Reading:
        """Choose the samples for the slope at the end over that at the start."""
        tangents, reading = self._choose_tangents(trace, initial)
        change_per_step = self._compute_change_per_step(trace, tangents)

        def compute_ratio(trace: Trace) -> tuple[Floats]:
            d, f = _read_loading(trace)
            end_slope = tangents.fit_end_slope(f, d) + trace.steps_beyond * change_per_step
            return (np.asarray(end_slope / reading.numbers(trace)[0], dtype=np.float64),)

        n, ends_at_samples = len(tangents.end_samples), reading.ends_at_samples
        return Reading(compute_ratio, n, ends_at_samples=ends_at_samples)

    def _compute_change_per_step(self, trace: Trace, tangents: Tangents) -> float:
        """Compute the change of the slope at the end with the last sampling step, N/m.

        The machine turned somewhere between two samples, up to one such step later.
        """
        d, f = _read_loading(trace)
        earlier_tangents = return_failure(Tangents.of)(d[:-1], f[:-1], length=self.over)
        if isinstance(earlier_tangents, Failure):
            return 0.0
        return float(tangents.fit_end_slope(f) - earlier_tangents.fit_end_slope(f[:-1]))

    def _find_onset(
        self, trace: Trace, choice: tuple[Tangents, Reading]
    ) -> tuple[Floats, Floats, Floats]:
        """Find displacement (m) and force (N) at the onset, and the initial slope (N/m)."""
        (tangents, reading), (d, f) = choice, _read_loading(trace)
        initial_slope = reading.numbers(trace)[0]
        onset = tangents.find_onset(f, initial_slope, d, slope_below=self.slope_below)
        return *onset, initial_slope

    def _decide_onset(self, trace: Trace, *, initial: Decide, corner: _Corner) -> Reading:
        """Choose the samples for the onset of the plateau and its force."""
        choice = self._choose_tangents(trace, initial)

        def compute_onset(trace: Trace) -> tuple[Floats, Floats]:
            onset, force, _ = self._find_onset(trace, choice)
            correction = trace.sizes.get(TANGENT, 0.0) * corner.error
            return onset + correction[0], force + correction[1]

        def compute_noisy_onset(trace: Trace) -> tuple[Floats, Floats]:
            onset, force, _ = self._find_onset(trace, choice)
            effect = corner.compute_noise_effect(self._measure_corners(trace, choice))
            return onset + effect[0], force + effect[1]

        if np.isnan(compute_onset(trace)[1]):
            raise UnavailableError.of("results.no_onset")
        return Reading(compute_onset, len(choice[0].end_samples), compute_noisy_onset)

    def _measure_corners(self, trace: Trace, choice: tuple[Tangents, Reading]) -> Floats:
        """Measure the largest error of the onset from the length of tangents, m and N, (2, ...)."""
        # The factors are multiples of the change with tangents of half the length. A corner is
        # smeared in proportion to the length, so it is twice that change away. A smooth bend is
        # smeared in proportion to the square, so it is 4/3 of that change away. The range from zero
        # to the factor contains both.
        smearing_factor = 3.0
        cut_factor = 2.0  # the force from half the length loses once or a third of its change
        (d, f), (onset, _, initial_slope) = _read_loading(trace), self._find_onset(trace, choice)
        required = self.slope_below * initial_slope
        onset_change, force_change, slope = choice[0].measure_corner_changes(f, onset, required, d)
        onset_error = smearing_factor * onset_change
        return np.stack([onset_error, cut_factor * force_change + onset_error * slope])

    def _estimate_corner(self, replicates: Replicates, initial: Decide) -> _Corner:
        """Estimate the error of the onset of the measured curve, less noise.

        The smooth curve may have no corners of this size, so noise is counted from its own error.
        If it has no tangents or no initial slope, noise is not removed.
        """
        choice = self._choose_tangents(replicates.measured, initial)
        measured = self._measure_corners(replicates.measured, choice)
        tangents = return_failure(self._choose_tangents)(replicates.smooth, initial)
        if isinstance(tangents, Failure):
            return _Corner(measured, np.zeros(2), np.zeros(2))
        smooth = self._measure_corners(replicates.smooth, tangents)
        noisy = [self._measure_corners(trace, tangents) for trace in replicates.iterate_traces()]
        return _Corner.of(measured, smooth, np.concatenate(noisy, axis=1) - smooth[:, None])

    def _measure_onset(
        self, test: ReducedTest, initial: Stiffness, end_slope: Result
    ) -> Sequence[Outcome]:
        """Measure displacement and force at the onset, with the length of tangents as an input.

        Without a plateau, which is not a failure, there are no outcomes.
        """
        if end_slope.interval is None or not end_slope.interval.upper < self.slope_below:
            return ()

        def set_correction(trace: Trace, x: float) -> Trace:
            return replace(trace, sizes={**trace.sizes, TANGENT: x})

        replicates = test.require(test.replicates)
        choice = self._choose_tangents(replicates.measured, initial.decide)
        if np.isnan(self._find_onset(replicates.measured, choice)[1]):
            return 2 * (Failure.of("results.no_onset"),)
        inputs = (*replicates.inputs, Input(TANGENT, set_correction, distribution="ends"))
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
    # Up to two samples are lost when two clocks are joined.
    if not len(finite) or finite[-1] >= len(d) - 3:
        return ()
    end, missing = 1e3 * float(d[finite[-1]]), len(d) - 1 - finite[-1]
    return (Reason.of("results.gap_at_end", end=end, missing=missing),)
