"""Fit two straight lines that meet: their slopes, and the break point between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import FittedLine, Interval
from labpipe.records.declarations import Output
from labpipe.records.estimates import UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.results.curve_replicates import make_trace, select_first_loading
from labpipe.results.kinds import Computed, find_marked_slips
from labpipe.results.least_squares import CommonPath, find_finite_samples, require_samples
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.results.stiffness import Window
from labpipe.uncertainty.extractors import Reading, Trace
from labpipe.uncertainty.intervals import Measured

_Position = TypeVar("_Position", float, Floats)


_MIN_SEGMENT_SAMPLES = 4


def _sort_samples(displacement: Floats, finite: Ints) -> Ints:
    """Sort the samples of a stretch of increasing displacement."""
    min_samples = 16
    d = displacement[finite]
    require_samples(len(d), min_samples)
    if d[-1] <= d[0] or (np.arange(len(d)) - 0.5 * (len(d) - 1)) @ d <= 0.0:
        raise UnavailableError.of("results.not_increasing", begin=d[0], end=d[-1])
    return finite[np.argsort(d, kind="stable")]


@dataclass(frozen=True, slots=True, eq=False)
class _BreakScan:
    """Sums of squares of all two-segment lines through sorted samples, from running sums.

    d, y : shape (n,), as measured; x : d centred and scaled; r : residuals of one straight line, so
    that the sums do not cancel; sums : shape (5, n + 1), running sums of 1, x, x^2, r, x r.
    """

    d: Floats
    y: Floats
    x: Floats
    r: Floats
    sums: Floats

    @classmethod
    def of(cls, d: Floats, y: Floats) -> _BreakScan:
        x = (d - 0.5 * (d[0] + d[-1])) * (2.0 / (d[-1] - d[0]))
        lever = x - x.mean()
        r = y - y.mean() - lever * ((lever @ y) / (lever @ lever))
        sums = np.zeros((5, len(x) + 1))
        np.cumsum([np.ones_like(x), x, x * x, r, x * r], axis=1, out=sums[:, 1:])
        return cls(d, y, x, r, sums)

    def to_displacement(self, x: _Position) -> _Position:
        """Return the displacement of a scaled place, m."""
        first, last = float(self.d[0]), float(self.d[-1])
        return 0.5 * (first + last) + 0.5 * (last - first) * x

    def compute_squares(self, breaks: Floats) -> Floats:
        """Return the smallest sum of squares for given breaks, shape of `breaks`."""
        _, _, _, sr, sxr = self._above(breaks)
        _, _, norms = self.sum_hinges(breaks)
        shr = sxr - breaks * sr
        gain = np.where(norms > 0.0, shr * shr / np.where(norms > 0.0, norms, 1.0), 0.0)
        squares: Floats = float(self.r @ self.r) - gain
        return squares

    def _above(self, places: Floats) -> Floats:
        """Return sums over the samples beyond each place, shape (5, ...)."""
        above: Floats = self.sums[:, -1:] - self.sums[:, np.searchsorted(self.x, places, "right")]
        return above

    def sum_hinges(self, c: Floats) -> tuple[Floats, Floats, Floats]:
        """Return sums of h = max(x - c, 0) for each place c.

        Returns
        -------
        Sum of h; sum of h (x - mean x); sum of squares of h less its straight line, 0 within
        rounding.
        """
        n, sx, sxx, _, _ = self._above(c)
        count, mx, mxx = self.sums[0, -1], *self.spread
        sh, sxh, shh = sx - c * n, sxx - c * sx, sxx - 2.0 * c * sx + c * c * n
        cross = sxh - mx * sh
        norms = shh - sh * sh / count - cross * cross / mxx
        return sh, cross, np.where(norms > 1e-14 * count, norms, 0.0)

    @property
    def spread(self) -> tuple[float, float]:
        """Return the mean of x, and sum of squares about it."""
        count, sx, sxx = self.sums[:3, -1]
        return float(sx / count), float(sxx - sx * sx / count)

    def find_crossings(self) -> Floats:
        """Return where separate lines before and after a gap between samples meet inside it."""
        below = self.sums[:, _MIN_SEGMENT_SAMPLES : len(self.x) - _MIN_SEGMENT_SAMPLES + 1]
        first, second = _fit_lines(below), _fit_lines(self.sums[:, -1:] - below)
        with np.errstate(divide="ignore", invalid="ignore"):
            meet = (second[0] - first[0]) / (first[1] - second[1])
        low = self.x[_MIN_SEGMENT_SAMPLES - 1 : len(self.x) - _MIN_SEGMENT_SAMPLES]
        high = self.x[_MIN_SEGMENT_SAMPLES : len(self.x) - _MIN_SEGMENT_SAMPLES + 1]
        crossings: Floats = meet[(meet >= low) & (meet <= high)]
        return crossings

    def find_best_break(self) -> float:
        """Return the break of the global optimum."""
        inside = self.x[_MIN_SEGMENT_SAMPLES - 1 : len(self.x) - _MIN_SEGMENT_SAMPLES + 1]
        places = np.concatenate([inside, self.find_crossings()])
        return float(places[int(np.argmin(self.compute_squares(places)))])


def _fit_lines(sums: Floats) -> tuple[Floats, Floats]:
    """Return level and slope of the least-squares line of each column of sums."""
    n, sx, sxx, sr, sxr = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (n * sxr - sx * sr) / (n * sxx - sx * sx)
        return (sr - slope * sx) / n, slope


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
    path : of the samples with both quantities, sorted by displacement
    scan : of the reference curve
    places : shape (300,), on the scale of the scan
    moved : on that scale, from the optimum over the places to the global optimum of that curve
    """

    path: CommonPath
    scan: _BreakScan
    places: Floats
    moved: float = 0.0

    @classmethod
    def of(cls, displacement: Floats, force: Floats) -> Hinges:
        """Choose the places between which a curve may bend.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time; NaN
            are ignored

        Returns
        -------
        Equidistant places, the first and the last with eight samples beyond (an eighth of fewer
        than 64 samples, at least four).

        Raises
        ------
        UnavailableError
            ``too_few_samples`` (fewer than 16), ``not_increasing`` if the displacement does not
            increase over the stretch.
        """
        order = _sort_samples(displacement, find_finite_samples(displacement, force))
        scan = _BreakScan.of(displacement[order], force[order])
        margin = min(8, max(_MIN_SEGMENT_SAMPLES, len(order) // 8)) - 1
        places = np.linspace(scan.x[margin], scan.x[-1 - margin], 300)
        hinges = cls(CommonPath.of(displacement, force, order), scan, places)
        return replace(
            hinges, moved=scan.find_best_break() - float(hinges._find_best_breaks(scan.y[None])[0])
        )

    @property
    def ends(self) -> tuple[float, float]:
        """Return the first and last sample of the stretch, m."""
        return float(self.scan.d[0]), float(self.scan.d[-1])

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
        For the reference curve it is the global least-squares optimum over all breaks, from a scan
        of all gaps between samples (Hudson, J. Am. Stat. Assoc. 61 (1966) 1097). For all others 300
        places are tried. A hinge max(x - c, 0) reduces the sum of squares about one straight line
        by (y'u)^2, with u the hinge less its own line, of length 1; the largest is refined by the
        parabola through it and its neighbours, and shifted by the error of that for the reference
        curve. The lines are the least-squares ones with this break. Products with hinges are exact,
        from sums of y and x y between places. Noise of the displacement counts as noise of the
        force (`CommonPath`).
        """
        y = self.path.move_force(force, displacement)
        shape, y = y.shape[:-1], np.atleast_2d(y).reshape(-1, y.shape[-1])
        scan, (mean, spread) = self.scan, self.scan.spread
        inside = scan.x[_MIN_SEGMENT_SAMPLES - 1], scan.x[-_MIN_SEGMENT_SAMPLES]
        breaks = np.clip(self._find_best_breaks(y) + self.moved, *inside)
        sh, cross, norms = scan.sum_hinges(breaks)
        level, along = y.mean(axis=1), y @ (scan.x - mean)
        product = np.einsum("rn,rn->r", y, np.maximum(scan.x - breaks[:, None], 0.0))
        norms = np.where(norms > 0.0, norms, np.nan)
        bend = (product - sh * level - cross * along / spread) / norms
        slope = (along - bend * cross) / spread
        level += slope * (breaks - mean) - bend * sh / y.shape[1]
        scale = 2.0 / (scan.d[-1] - scan.d[0])
        numbers = (scan.to_displacement(breaks), scale * slope, scale * (slope + bend), level)
        return Segments(*(number.reshape(shape) for number in numbers))

    def _find_best_breaks(self, y: Floats) -> Floats:
        """Return the breaks (R,) from the places and the parabola, of sorted curves (R, k)."""
        x, places, (mean, spread) = self.scan.x, self.places, self.scan.spread
        starts = np.concatenate([[0], np.searchsorted(x, places)])
        is_empty = np.diff(starts, append=len(x)) == 0
        beyond = []
        for values in (y, y * x):
            sums = np.add.reduceat(values, starts, axis=1)
            sums[:, is_empty] = 0.0  # `reduceat` returns the first sample of an empty stretch
            beyond.append(np.cumsum(sums[:, :0:-1], axis=1)[:, ::-1])
        sh, cross, norms = self.scan.sum_hinges(places)
        product = beyond[1] - places * beyond[0]
        product -= np.outer(y.mean(axis=1), sh) + np.outer(y @ (x - mean), cross / spread)
        gain = product**2 / np.where(norms > 0.0, norms, np.inf)
        top = np.clip(np.argmax(gain, axis=1), 1, len(places) - 2)
        gain_before, top_gain, gain_behind = np.take_along_axis(
            gain, top[:, None] + [-1, 0, 1], axis=1
        ).T
        gain_curvature = 2.0 * top_gain - gain_before - gain_behind
        off = (
            0.5
            * (gain_behind - gain_before)
            / np.where(gain_curvature > 0.0, gain_curvature, np.inf)
        )
        best: Floats = places[top] + np.clip(off, -1.0, 1.0) * (places[1] - places[0])
        return best


def require_bend(fit: Segments, smooth: Segments, drawn: Segments, hinges: Hinges) -> None:
    """Require that a curve bends, by its replicates.

    Parameters
    ----------
    fit : of the curve itself, shape ()
    smooth : of the smooth curve of the replicates, shape ()
    drawn : of the replicates, shape (R,); NaN for those without a number
    hinges : of the curve itself

    Raises
    ------
    UnavailableError
        ``no_bend`` if the slopes differ by at most four standard errors, or if 2.5 % of the
        replicates have their break within two places of an end, or the interval of the break has
        an end there.

    Notes
    -----
    The break is chosen for the largest difference of the slopes. By chance, the difference on a
    straight line therefore exceeds two standard errors much more often than once in twenty. The
    standard error comes from the 2.5 % quantile of the replicates that bend less than the median:
    replicates whose break moves towards an end have steeper slopes beyond it, which is no evidence
    against a bend.
    """
    min_bend_errors = 4.0
    first, second = float(fit.first), float(fit.second)
    bend, bends = second - first, drawn.second - drawn.first
    middle, straighter = np.nanquantile(bends, [0.5, 0.975 if bend < 0.0 else 0.025]).tolist()
    error = abs(straighter - middle) / Interval.normal_95(0.0, 1.0).upper
    if not abs(bend) > min_bend_errors * error:
        raise UnavailableError.of(
            "results.no_bend",
            first=first,
            second=second,
            bend=abs(bend),
            needed=min_bend_errors,
            error=error,
        )
    low, high = (hinges.scan.to_displacement(float(hinges.places[place])) for place in (2, -3))
    drawn_breaks = drawn.break_point[~np.isnan(drawn.break_point)]
    likely = fit.break_point - (drawn_breaks - smooth.break_point)
    for breaks in (drawn_breaks, likely):
        if np.mean((breaks <= low) | (breaks >= high)) >= 0.025:
            start, stop = hinges.ends
            raise UnavailableError.of("results.bends_at_end", start=start, stop=stop)


def require_kink(fit: Segments, smooth: Segments, drawn: Segments, hinges: Hinges) -> None:
    """Require that the slope of a curve decreases at a kink, by its replicates.

    Parameters
    ----------
    fit, smooth, drawn, hinges : as for `require_bend`

    Raises
    ------
    UnavailableError
        ``no_kink`` if the curve does not bend, or bends upwards; ``kink_at_end`` if the lines meet
        in the first or the last twentieth of the stretch.
    """
    straight = return_failure(require_bend)(fit, smooth, drawn, hinges)
    if straight is not None:
        residuals, (start, stop) = hinges.scan.r, (1e3 * end for end in hinges.ends)
        rms = float(np.sqrt(residuals @ residuals / (len(residuals) - 2)))
        raise UnavailableError.of(
            "results.no_kink", rms=rms, start=start, stop=stop, why=straight.message
        )
    first, second, place = float(fit.first), float(fit.second), 1e3 * float(fit.break_point)
    if second >= first:
        raise UnavailableError.of("results.slope_rises", first=first, second=second, place=place)
    start, stop = (1e3 * end for end in hinges.ends)
    margin = 0.05 * (stop - start)
    if not start + margin <= place <= stop - margin:
        raise UnavailableError.of("results.kink_at_end", place=place, start=start, stop=stop)


def find_break_doubts(interval: Interval, hinges: Hinges) -> tuple[Reason, ...]:
    """Return a doubt ``wide_break`` if an interval is longer than a quarter of the stretch.

    Parameters
    ----------
    interval : m, of the break
    hinges : of its fit
    """
    start, stop = hinges.ends
    width = interval.upper - interval.lower
    if width <= 0.25 * (stop - start):
        return ()
    start, stop, width = 1e3 * start, 1e3 * stop, 1e3 * width
    return (Reason.of("results.wide_break", width=width, start=start, stop=stop),)


@dataclass(frozen=True, slots=True)
class _TwoLineFit:
    """Two lines of a test: break, slopes and force at the break, as `Segments` has them."""

    numbers: tuple[Measured, ...]
    hinges: Hinges

    @property
    def find_break_doubts(self) -> tuple[Reason, ...]:
        """Return the doubts about the break."""
        return find_break_doubts(self.numbers[0].interval, self.hinges)

    def make_lines(self, before: str, behind: str) -> tuple[FittedLine, ...]:
        """Return both lines with their names."""
        break_point, first, second, level = (number.value for number in self.numbers)
        start, stop = self.hinges.ends
        return (
            FittedLine(before, first, level - first * (break_point - start), start, break_point),
            FittedLine(behind, second, level, break_point, stop),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _TwoLines(Window):
    """A kind of result from two lines through a range of the first loading."""

    method: ClassVar = (
        "two segments that meet, from {start_mm:g} mm to {stop_mm:g} mm, all breaks tried"
    )

    def fit(
        self, test: ReducedTest, require: Callable[[Segments, Segments, Segments, Hinges], None]
    ) -> _TwoLineFit:
        """Fit two lines to the curve of a test.

        Parameters
        ----------
        test : the test
        require : requires such a break of the curve, as `require_bend`
        """
        numbers = test.measure(self.decide)
        _, hinges = self._choose_places(make_trace(test))
        measured = smooth = Segments(*(np.asarray(number.value) for number in numbers))
        if test.replicates is not None:
            reading = return_failure(self.decide)(test.replicates.smooth)
            if isinstance(reading, Reading):
                smooth = Segments(*reading.numbers(test.replicates.smooth))
        drawn = Segments(
            *(value + number.deviations for value, number in zip(smooth, numbers, strict=True))
        )
        require(measured, smooth, drawn, hinges)
        return _TwoLineFit(numbers, hinges)

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

        return Reading(numbers, len(hinges.scan.d), ends_at_samples=True, depends_on_corners=True)

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
        stretch = select_first_loading(trace)
        window = self.inside(trace.displacement[stretch])
        stop = stretch.stop if window.stop is None else stretch.start + window.stop
        part = slice(stretch.start + window.start, stop)
        return part, Hinges.of(trace.displacement[part], trace.force[part])


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSegments(_TwoLines):
    """``segment_stiffness_first``, ``segment_stiffness_second``, ``break_point``: two lines."""

    result: ClassVar = "two-segments"
    outputs: ClassVar = (
        Output("segment_stiffness_first", "N/m", "Stiffness, first fitted segment"),
        Output("segment_stiffness_second", "N/m", "Stiffness, second fitted segment"),
        Output("break_point", "m", "Break point of the two segments"),
    )

    def measure(self, test: ReducedTest) -> Computed:
        """Fit the best two segments that meet."""
        fit = self.fit(test, require_bend)
        place, first, second, _ = fit.numbers
        start, stop = read = fit.hinges.ends
        bend, during = place.value, test.find_loading_interval(*read)
        slips = find_marked_slips(test, read)  # one bends both
        first_name, second_name = (output.name for output in self.outputs[:2])
        numbers = ((first, slips), (second, slips), (place, slips + fit.find_break_doubts))
        sides = ((first_name, 1, (max(start, 0.0), bend)), (second_name, 2, (max(bend, 0.0), stop)))
        return Computed(
            tuple(
                self.make_result(test, number, output=output, during=during, doubts=doubts)
                for output, (number, doubts) in enumerate(numbers)
            ),
            {
                name: Stiffness(
                    partial(self.choose_one, number=number),
                    fit.numbers[number].as_estimate,
                    during,
                    window,
                    read,
                )
                for name, number, window in sides
            },
            fit.make_lines(first_name, second_name),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Kink(_TwoLines):
    """``kink_displacement`` (m) and ``kink_force`` (N): where the first loading gets less steep."""

    result: ClassVar = "kink"
    outputs: ClassVar = (
        Output("kink_displacement", "m", "Displacement at the kink"),
        Output("kink_force", "N", "Kink force"),
    )

    def measure(self, test: ReducedTest) -> Computed:
        """Find the decrease of the slope of the first loading."""
        fit = self.fit(test, require_kink)
        place, _, _, level = fit.numbers
        doubts = find_marked_slips(test, fit.hinges.ends) + fit.find_break_doubts
        during = test.find_loading_interval(*fit.hinges.ends)
        return Computed(
            self.make_results(test, (place, level), during=during, doubts=doubts),
            lines=fit.make_lines("before_kink", "behind_kink"),
        )
