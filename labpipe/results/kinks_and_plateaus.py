"""Find the kink of a loading curve by two lines that meet, and the onset of its plateau."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from labpipe.records.arrays import Floats, Ints, divide
from labpipe.records.causes import TANGENT
from labpipe.records.curve import NORMAL_95, Branch, FittedLine, Interval
from labpipe.records.declarations import CURVE_QUANTITIES, Fraction, Length, Output, StiffnessName
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Finding, Reason
from labpipe.records.result import Result
from labpipe.results import curves, kinds
from labpipe.results.cycles import find_truncation_doubts
from labpipe.results.kinds import Kind, MeasuredItem, Outcome, ReducedTest, Stiffness
from labpipe.results.stiffness import RangeKind
from labpipe.uncertainty.intervals import MeasuredNumber, measure_numbers
from labpipe.uncertainty.replicates import Choice, Extractor, Input, Replicates, Trace

_MIN_SEGMENT_SAMPLES = 4
"""Smallest number of samples on each side of a break."""


class Segments(NamedTuple):
    """Two lines that meet at a break, for each of many curves.

    Parameters
    ----------
    break_point : shape (...), m, displacement at the break
    first_slope, second_slope : shape (...), N/m, slopes of the lines before and after the break
    break_force : shape (...), N, force at the break
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
    x : shape (k,), displacements of these samples, scaled to the range from -1 to 1
    candidates : shape (300,), candidate breaks on the scale of `x`
    line_residual : N, standard deviation of the reference curve about one straight line
    grid_correction : globally best break of the reference curve, less the break interpolated
        between its candidates, on the scale of `x`
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
        Equidistant candidates, from the eighth sample to the eighth from the end. For fewer than 64
        samples, an eighth of their number, but at least four, replaces the eight.

        Raises
        ------
        UnavailableError
            ``too_few_samples`` (fewer than 16); ``not_increasing`` if the displacement does not
            increase over the stretch.
        """
        min_samples = 16
        finite_samples = curves.find_finite_samples(displacement, force)
        d = displacement[finite_samples]
        curves.require_samples(len(d), min_samples)
        if d[-1] <= d[0] or (np.arange(len(d)) - 0.5 * (len(d) - 1)) @ d <= 0.0:
            raise UnavailableError.of("results.not_increasing", begin=d[0], end=d[-1])
        order = finite_samples[np.argsort(d, kind="stable")]
        d, y = displacement[order], force[order]
        x = (d - 0.5 * (d[0] + d[-1])) * (2.0 / (d[-1] - d[0]))
        margin = min(8, max(_MIN_SEGMENT_SAMPLES, len(x) // 8)) - 1
        candidates = np.linspace(x[margin], x[-1 - margin], 300)
        residuals = y - y.mean() - curves.compute_slope(x, y) * (x - x.mean())
        line_residual = float(np.sqrt(residuals @ residuals / (len(x) - 2)))
        hinges = cls(curves.CommonPath.of(displacement, force, order), x, candidates, line_residual)
        grid_break = float(hinges._find_breaks(y[None])[0])
        return replace(hinges, grid_correction=hinges._find_global_break(residuals) - grid_break)

    @property
    def ends(self) -> tuple[float, float]:
        """First and last displacement of the stretch, m."""
        return float(self.path.displacement[0]), float(self.path.displacement[-1])

    def convert_to_displacement(self, x: Floats | float) -> Floats:
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
        sample and the fourth from the end. It is found by a scan of all samples and of the gaps
        between them (Hudson, J. Am. Stat. Assoc. 61 (1966) 1097). For all other curves, the 300
        candidates are tried. A hinge max(x - c, 0) at the candidate c reduces the sum of squares
        about one straight line by (y'u)^2. Here y are the forces, and u is the hinge less its own
        least-squares line, scaled to length 1. The break is the maximum of the parabola through the
        largest reduction and its neighbours, shifted by the error of this parabola for the
        reference curve. The lines are the least-squares lines with this break. Noise of the
        displacement counts as noise of the force (`CommonPath`).
        """
        y = self.path.move_force(force, displacement)
        shape, y, x = y.shape[:-1], y.reshape(-1, y.shape[-1]), self.x
        break_range = x[_MIN_SEGMENT_SAMPLES - 1], x[-_MIN_SEGMENT_SAMPLES]
        breaks = np.clip(self._find_breaks(y) + self.grid_correction, *break_range)
        hinge, centred_x = np.maximum(x - breaks[:, None], 0.0), x - x.mean()
        spread, hinge_mean = centred_x @ centred_x, hinge.mean(axis=1)
        hinge_slope, curve_slope = hinge @ centred_x / spread, y @ centred_x / spread
        hinge -= hinge_mean[:, None] + np.outer(hinge_slope, centred_x)
        norm = np.vecdot(hinge, hinge)
        bend = np.vecdot(y, hinge) / np.where(norm > 1e-14 * len(x), norm, np.nan)
        first_slope = curve_slope - bend * hinge_slope
        force_at_break = y.mean(axis=1) + first_slope * (breaks - x.mean()) - bend * hinge_mean
        scale = 2.0 / (self.ends[1] - self.ends[0])
        slopes = scale * first_slope, scale * (first_slope + bend)
        values = self.convert_to_displacement(breaks), *slopes, force_at_break
        return Segments(*(value.reshape(shape) for value in values))

    def _find_breaks(self, y: Floats) -> Floats:
        """Find the best breaks (R,) of curves (R, k), interpolated between candidates."""
        candidates = self.candidates
        reductions = self._compute_reductions(y, candidates)
        best_index = np.clip(np.argmax(reductions, axis=1), 1, len(candidates) - 2)
        neighbours = np.take_along_axis(reductions, best_index[:, None] + [-1, 0, 1], axis=1)
        before, largest, after = neighbours.T  # reductions on a parabola
        curvature = 2.0 * largest - before - after
        offset = 0.5 * (after - before) / np.where(curvature > 0.0, curvature, np.inf)
        step = np.diff(candidates)[0]
        return np.asarray(candidates[best_index] + np.clip(offset, -1.0, 1.0) * step)

    def _compute_reductions(self, y: Floats, breaks: Floats) -> Floats:
        """Compute the reduction of the sum of squares of curves (R, k) by a hinge at each break."""
        x, centred_x = self.x, self.x - self.x.mean()
        starts = np.append(0, np.searchsorted(x, breaks))
        is_empty = np.diff(starts, append=len(x)) == 0
        sums_beyond = []
        for values in (np.stack([np.ones_like(x), x, x * x]), y, y * x):
            sums = np.add.reduceat(values, starts, axis=1)
            sums[:, is_empty] = 0.0  # `reduceat` returns the first sample of an empty stretch
            sums_beyond.append(np.cumsum(sums[:, :0:-1], axis=1)[:, ::-1])
        (n, sx, sxx), sy, sxy = sums_beyond
        spread, hinge_sum = centred_x @ centred_x, sx - breaks * n
        cross = sxx - breaks * sx - x.mean() * hinge_sum
        norms = sxx - 2.0 * breaks * sx + breaks**2 * n - hinge_sum**2 / len(x) - cross**2 / spread
        product = sxy - breaks * sy - np.outer(y.mean(axis=1), hinge_sum)
        product -= np.outer(y @ centred_x, cross / spread)
        return np.asarray(product**2 / np.where(norms > 1e-14 * len(x), norms, np.inf))

    def _find_global_break(self, residuals: Floats) -> float:
        """Find the best break of a curve, at a sample or at a crossing of lines between samples.

        The residuals (k,), N, of the curve about one straight line are used, because their sums
        have smaller rounding errors than those of the forces.
        """
        x, margin = self.x, _MIN_SEGMENT_SAMPLES
        columns = [np.ones_like(x), x, x * x, residuals, x * residuals]
        sums_before = np.cumsum(columns, axis=1)[:, margin - 1 : len(x) - margin]
        sums_after = np.sum(columns, axis=1)[:, None] - sums_before
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes, levels = [], []
            for n, sx, sxx, sr, sxr in (sums_before, sums_after):
                slopes.append((n * sxr - sx * sr) / (n * sxx - sx * sx))
                levels.append((sr - slopes[-1] * sx) / n)
            crossings = (levels[1] - levels[0]) / (slopes[0] - slopes[1])
        inner_x = x[margin - 1 : len(x) - margin + 1]
        is_in_gap = (crossings >= inner_x[:-1]) & (crossings <= inner_x[1:])
        candidates = np.sort(np.concatenate([inner_x, crossings[is_in_gap]]))
        reductions = self._compute_reductions(residuals[None], candidates)
        return float(candidates[int(np.argmax(reductions))])


def require_bend(segments: tuple[MeasuredNumber, ...], hinges: Hinges) -> None:
    """Raise an error if a curve does not bend significantly.

    Parameters
    ----------
    segments : fields of `Segments` for the curve, with their replicates
    hinges : candidate breaks of the curve

    Raises
    ------
    UnavailableError
        ``no_bend`` if the slopes differ by at most four standard errors, or if the break is within
        the first or last three candidates in at least 2.5 % of the replicates, with the deviations
        as they are or with their signs reversed.

    Notes
    -----
    The choice of the break for the best fit makes the difference of the slopes large. For a
    straight line, the difference therefore exceeds two standard errors much more often than once in
    twenty. The standard error is the distance from the median of all replicates to their 2.5 %
    quantile on the side of the smaller bend, divided by 1.96. The other side is not used: slopes
    beyond a break near an end of the stretch may be steep, but are no evidence against a bend.
    """
    min_bend_errors = 4.0
    break_point, slope, next_slope, _ = segments
    bend, deviations = next_slope.value - slope.value, next_slope.deviations - slope.deviations
    median, limit = np.nanquantile(deviations, [0.5, 0.975 if bend < 0.0 else 0.025]).tolist()
    error = abs(limit - median) / NORMAL_95
    if not abs(bend) > min_bend_errors * error:
        slopes = {"first": slope.value, "second": next_slope.value, "bend": abs(bend)}
        raise UnavailableError.of("results.no_bend", **slopes, needed=min_bend_errors, error=error)
    low, high = hinges.convert_to_displacement(hinges.candidates[[2, -3]])
    errors = break_point.deviations[~np.isnan(break_point.deviations)]
    for breaks in (break_point.value + errors, break_point.value - errors):
        if np.mean((breaks <= low) | (breaks >= high)) >= 0.025:
            start, stop = hinges.ends
            raise UnavailableError.of("results.bends_at_end", start=start, stop=stop)


def require_kink(segments: tuple[MeasuredNumber, ...], hinges: Hinges) -> None:
    """Raise an error if the slope of a curve does not decrease significantly at a kink.

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
    failure, rms = return_failure(require_bend)(segments, hinges), hinges.line_residual
    if failure is not None:
        why = failure.message
        raise UnavailableError.of("results.no_kink", rms=rms, start=start, stop=stop, why=why)
    break_mm, first, second = 1e3 * segments[0].value, segments[1].value, segments[2].value
    if second >= first:
        raise UnavailableError.of("results.slope_rises", first=first, second=second, place=break_mm)
    margin = 0.05 * (stop - start)  # closer to an end, the break may be an effect of that end
    if not start + margin <= break_mm <= stop - margin:
        raise UnavailableError.of("results.kink_at_end", place=break_mm, start=start, stop=stop)


def find_break_doubts(interval: Interval, hinges: Hinges) -> tuple[Reason, ...]:
    """Find a doubt ``wide_break`` if the interval of the break exceeds a quarter of the stretch.

    Parameters
    ----------
    interval : m, 95 % interval of the break
    hinges : candidate breaks of the curve
    """
    start, stop, low, high = (1e3 * end for end in (*hinges.ends, interval.lower, interval.upper))
    if high - low <= 0.25 * (stop - start):
        return ()
    return (Reason.of("results.wide_break", width=high - low, start=start, stop=stop),)


def find_contact_doubts(segments: tuple[MeasuredNumber, ...], hinges: Hinges) -> tuple[Reason, ...]:
    """Find a doubt ``late_contact`` if the specimen is not loaded where the first line begins.

    Parameters
    ----------
    segments : fields of `Segments` for the curve, with their replicates
    hinges : candidate breaks of the curve

    Notes
    -----
    The specimen is not loaded there in two cases. Either the first line begins at a force of the
    opposite sign, of more than a twentieth of the force at the end of the stretch. Or both the
    slope of the first line and the force at the break are almost zero.
    """
    min_force_fraction, min_slope_ratio = 0.05, 0.02
    break_point, first_slope, second_slope, break_force = (x.value for x in segments)
    start, stop = hinges.ends
    start_force = break_force - first_slope * (break_point - start)
    end_force = break_force + second_slope * (stop - break_point)
    is_flat = abs(first_slope) < min_slope_ratio * abs(second_slope)
    is_unloaded = is_flat and abs(break_force) < abs(min_force_fraction * end_force)
    if start_force / end_force >= -min_force_fraction and not is_unloaded:
        return ()
    return (Reason.of("results.late_contact", start=1e3 * start),)


class _TwoLineKind(RangeKind):
    """A kind of result from two lines that meet, fitted to a range of the first loading."""

    method: ClassVar = (
        "two segments that meet, from {start_mm:g} mm to {stop_mm:g} mm, all breaks tried"
    )

    def fit(
        self, test: ReducedTest, require: Callable[[tuple[MeasuredNumber, ...], Hinges], None]
    ) -> tuple[tuple[MeasuredNumber, ...], Hinges]:
        """Fit two lines to the curve of a test, or raise an error if they do not meet at a break.

        Parameters
        ----------
        test : reduced test
        require : function that raises the error, such as `require_bend`

        Returns
        -------
        segments : fields of `Segments`, with their replicates
        hinges : candidate breaks of the curve
        """
        segments = test.measure_numbers(self.choose_samples)
        _, hinges = self._choose_hinges(curves.make_trace(test))
        require(segments, hinges)
        return segments, hinges

    def choose_samples(self, trace: Trace) -> Extractor:
        """Choose the samples and candidate breaks for two lines.

        Parameters
        ----------
        trace : one curve

        Returns
        -------
        The extractor of the fields of `Segments`.
        """
        samples, hinges = self._choose_hinges(trace)

        def fit_segments(trace: Trace) -> Segments:
            return hinges.fit(trace.force[..., samples], trace.displacement[..., samples])

        return Extractor(fit_segments, len(hinges.x), ends_at_samples=True, depends_on_corners=True)

    def choose_field_samples(self, trace: Trace, *, index: int) -> Extractor:
        """Choose the samples and candidate breaks for one field of `Segments`.

        Parameters
        ----------
        trace : one curve
        index : index of the field in `Segments`
        """
        extractor = self.choose_samples(trace)
        return replace(extractor, compute_numbers=lambda x: (extractor.compute_numbers(x)[index],))

    def _choose_hinges(self, trace: Trace) -> tuple[slice, Hinges]:
        """Return the samples of the range, and the candidate breaks in it."""
        samples = self.select_samples(trace)
        return samples, Hinges.of(trace.displacement[samples], trace.force[samples])


def _make_lines(
    segments: tuple[MeasuredNumber, ...], hinges: Hinges, names: tuple[str, str]
) -> tuple[FittedLine, ...]:
    """Make the lines before and after a break, with their names."""
    break_point, first_slope, second_slope, break_force = (x.value for x in segments)
    start, stop = hinges.ends
    start_force = break_force - first_slope * (break_point - start)
    return (
        FittedLine(names[0], first_slope, start_force, start, break_point),
        FittedLine(names[1], second_slope, break_force, break_point, stop),
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

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the slopes of the two lines that meet, and their break."""
        segments, hinges = self.fit(test, require_bend)
        break_point, (start, stop) = segments[0], hinges.ends
        period = test.find_loading_period(start, stop)
        sample_doubts = find_contact_doubts(segments, hinges)
        sample_doubts += kinds.find_pause_doubts(test, hinges.ends)
        doubts = kinds.find_slip_doubts(test, hinges.ends) + sample_doubts
        yield from self.make_results(test, segments[1:3], period=period, doubts=doubts)
        doubts += find_break_doubts(break_point.interval, hinges)
        yield self.make_result(test, break_point, output=2, period=period, doubts=doubts)
        windows = (max(start, 0.0), break_point.value), (max(break_point.value, 0.0), stop)
        names = self.outputs[0].name, self.outputs[1].name
        for index, (name, window) in enumerate(zip(names, windows, strict=True), start=1):
            choose_samples = partial(self.choose_field_samples, index=index)
            slope = segments[index].value
            # A slip anywhere in the stretch affects both slopes.
            yield Stiffness(name, choose_samples, slope, period, window, hinges.ends, sample_doubts)
        yield from _make_lines(segments, hinges, names)


class Kink(_TwoLineKind):
    """``kink_displacement`` (m) and ``kink_force`` (N): point at which the slope decreases."""

    result: ClassVar = "kink"
    outputs: ClassVar = (
        Output("kink_displacement", "m", "Displacement at the kink"),
        Output("kink_force", "N", "Kink force"),
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the point at which the slope of the first loading decreases."""
        segments, hinges = self.fit(test, require_kink)
        displacement, _, _, force = segments
        doubts = kinds.find_slip_doubts(test, hinges.ends)
        doubts += kinds.find_pause_doubts(test, hinges.ends)
        doubts += find_break_doubts(displacement.interval, hinges)
        period = test.find_loading_period(*hinges.ends)
        yield from self.make_results(test, (displacement, force), period=period, doubts=doubts)
        yield from _make_lines(segments, hinges, ("before_kink", "behind_kink"))


_TANGENTS_PER_LENGTH = 8
"""Number of tangents whose midpoints lie within the length of one tangent."""
_MIN_TANGENT_SAMPLES = 8
"""Smallest number of samples of a tangent."""


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Tangents of loading curves, from the end backwards, with samples chosen on a reference curve.

    Parameters
    ----------
    path : samples with force and displacement, in order of time
    length : m, length of a tangent
    midpoints : shape (p,), m, displacements at the middle of the tangents, at distances of an
        eighth of `length`, from the end of the curve backwards
    slope_weights : shape (p, k), 1/m, weights of the k forces in the slope of each tangent
    end_force_weights : shape (k,), weights of the forces in the force at the midpoint of the
        tangent at the end of the curve
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
        length : m, length of a tangent

        Returns
        -------
        The tangents from the end of the curve backwards, up to the first one that cannot be fitted.

        Raises
        ------
        UnavailableError
            If there is no tangent at the end: ``not_reached`` (the curve is shorter than twice
            `length`), ``too_few_samples`` (fewer than 8), ``no_travel`` (the displacement jumps).

        Notes
        -----
        The slope of a tangent is that of a least-squares parabola at the middle of its stretch, so
        that curvature does not count as noise. A stretch begins when the curve first reaches its
        lower displacement, and ends when the curve first reaches its higher displacement.
        """
        samples = curves.find_finite_samples(displacement, force)
        d = displacement[samples]
        if not len(d) or np.ptp(d) < 2.0 * length:
            reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
            raise UnavailableError.of("results.too_short", reached=reached, length=1e3 * length)
        low, high = float(d.min()) + 0.5 * length, float(d.max()) - 0.5 * length
        midpoints = np.arange(high, low, -length / _TANGENTS_PER_LENGTH)
        indices, force_weights, slope_weights, counts = _weigh_parabolas(d, midpoints, length)
        curves.require_samples(int(counts[0]), _MIN_TANGENT_SAMPLES)
        is_determined = np.isfinite(force_weights[:, 0])
        if not is_determined[0]:
            raise UnavailableError.of("results.displacement_jumps")
        n_tangents = int(np.argmin([*is_determined, False]))
        return cls(
            path=curves.CommonPath.of(displacement, force, samples),
            length=length,
            midpoints=midpoints[:n_tangents],
            slope_weights=_expand_weights(indices, slope_weights, len(d))[:n_tangents],
            end_force_weights=_expand_weights(indices, force_weights, len(d))[0],
            end_samples=indices[0][indices[0] < len(d)],
        )

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest displacement of the tangent at the end, m."""
        d = self.path.displacement[self.end_samples]
        return float(d.min()), float(d.max())

    def compute_end_slope(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Compute the slope of the tangent at the end of each curve.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        Shape (...), N/m.
        """
        return np.asarray(self.path.move_force(force, displacement) @ self.slope_weights[0])

    def compute_end_force(self, displacement: float, force: Floats) -> float:
        """Compute the force of the tangent at the end of a curve at a displacement, N.

        Parameters
        ----------
        displacement : m, displacement at which the force is computed
        force : shape (n,), N, forces of the curve
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
        """Find the point beyond which all tangents are below a fraction of the initial slope.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        initial_slope : shape (...), N/m, slope at the start of each curve
        displacement : shape (..., n), m; None for that of the reference curve
        slope_below : the fraction of `initial_slope`

        Returns
        -------
        onset : shape (...), m, interpolated displacement at which the slope of the tangent, from
            the end backwards, first reaches the fraction; NaN for a curve that is never so steep
        onset_force : shape (...), N, force at the onset by a parabola over half of `length`. The
            error of a parabola at a corner is in proportion to its length

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
        limits = slope_below * np.broadcast_to(initial_slope, shape).reshape(-1)
        onset = _interpolate_first_crossing(self.midpoints, f @ self.slope_weights.T, limits)
        onset_force = _fit_forces(self.path.displacement, f, onset, 0.5 * self.length)
        return onset.reshape(shape), onset_force.reshape(shape)

    def measure_corner_changes(
        self,
        force: Floats,
        onset: Floats | float,
        slope: Floats | float,
        displacement: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Measure changes of an onset with tangents of half the length, and the slope beyond it.

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
        A tangent smooths a corner over its length, which moves the onset. The parabola for the
        force rounds the corner off.
        """
        f = self.path.move_force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        onset, slope = (np.broadcast_to(values, shape).reshape(-1) for values in (onset, slope))
        # All curves have one mean onset, as noise moves the onset by a small fraction of a tangent.
        d, half_length, mean_onset = self.path.displacement, 0.5 * self.length, np.nanmean(onset)
        positions = mean_onset + self.length * np.linspace(0.5, -0.5, 2 * _TANGENTS_PER_LENGTH + 1)
        first, last = d.min() + 0.5 * half_length, d.max() - 0.5 * half_length
        positions = positions[(positions <= last) & (positions >= first)]
        samples, _, weights, _ = _weigh_parabolas(d, positions, half_length)
        is_determined = np.isfinite(weights[:, 0])
        weights = _expand_weights(samples[is_determined], weights[is_determined], len(d))
        half_onset = _interpolate_first_crossing(positions[is_determined], f @ weights.T, slope)
        onset_change = np.where(np.isnan(half_onset), 0.0, half_onset - onset)
        mean_onsets = np.full(len(f), mean_onset)
        force_change = _fit_forces(d, f, mean_onsets, half_length)
        force_change -= _fit_forces(d, f, mean_onsets, self.length)
        midpoints, slopes = self.midpoints[::-1], (f @ self.slope_weights.T)[:, ::-1]
        slope_beyond = np.array([np.interp(mean_onset + half_length, midpoints, x) for x in slopes])
        changes = onset_change.reshape(shape), force_change.reshape(shape)
        return *changes, slope_beyond.reshape(shape)


def _interpolate_first_crossing(positions: Floats, slopes: Floats, limits: Floats) -> Floats:
    """Interpolate the positions at which slopes (R, p) first reach limits (R,); NaN if never.

    The slopes belong to `positions`, of shape (p,).
    """
    is_steep = slopes >= limits[:, None]
    index, rows = np.argmax(is_steep, axis=1), np.arange(len(slopes))
    previous = np.maximum(index - 1, 0)
    rise = slopes[rows, index] - slopes[rows, previous]
    fraction = (limits - slopes[rows, previous]) / np.where(index > 0, rise, np.inf)
    position = positions[previous] + fraction * (positions[index] - positions[previous])
    return np.asarray(np.where(is_steep[rows, index], position, np.nan))


def _fit_forces(d: Floats, f: Floats, positions: Floats, length: float) -> Floats:
    """Fit the forces of curves (R, k) at positions (R,), by parabolas around the positions."""
    is_finite = np.isfinite(positions)
    forces = np.full(len(positions), np.nan)
    if is_finite.any():
        samples, weights, _, _ = _weigh_parabolas(d, positions[is_finite], length)
        samples = np.minimum(samples, len(d) - 1)  # padding has zero weight
        forces[is_finite] = np.vecdot(weights, np.take_along_axis(f[is_finite], samples, axis=1))
    return forces


def _weigh_parabolas(
    d: Floats, positions: Floats, length: float
) -> tuple[Ints, Floats, Floats, Floats]:
    """Compute the weights of forces in least-squares parabolas around positions of a path.

    Parameters
    ----------
    d : shape (k,), m, displacements of the path in order of time
    positions : shape (p,), m, displacements at which force and slope are computed
    length : m, length of the stretch around each position

    Returns
    -------
    samples : shape (p, m), indices of the samples of each stretch, padded with k
    force_weights, slope_weights : shape (p, m), 1 and 1/m, weights of the forces in force and slope
        at the position; NaN for a stretch with fewer than 8 samples, with samples over less than
        half of `length`, or with samples that do not determine a parabola
    counts : shape (p,), number of samples of each stretch
    """
    edge_tolerance = 1e-9  # of the length; a sample so close to an end counts as at the end
    # The determinant of the mean products of 1, x, x^2 over the samples is of the order of rounding
    # for samples at only two displacements, and 5e-4 for evenly spaced samples.
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
    """Expand weights (p, m) of the samples of each stretch to weights (p, count) of all samples."""
    all_weights = np.zeros((len(samples), count + 1))
    np.put_along_axis(all_weights, samples, weights, axis=1)
    return all_weights[:, :-1]


@dataclass(frozen=True, slots=True, eq=False)
class _CornerError:
    """Largest error of the onset from the length of tangents, and the effect of noise on it.

    Half of the error corrects the estimate, so half of its noise is included in the interval. The
    two elements are those of displacement (m) and force (N) at the onset.

    Parameters
    ----------
    error : shape (2,), m and N, the error without the effect of noise
    noise_free_ratio : shape (2,), ratio of `error` to the measured error less the mean effect of
        noise; zero if the effect of noise is unknown
    mean_noisy_error : shape (2,), m and N, error on the smooth curve, plus the mean effect of noise
    """

    error: Floats
    noise_free_ratio: Floats
    mean_noisy_error: Floats

    @classmethod
    def of(cls, measured: Floats, smooth: Floats, noise: Floats) -> _CornerError:
        """Remove the effect of noise from the error of an onset.

        Parameters
        ----------
        measured, smooth : shape (2,), m and N, errors on the measured and on the smooth curve
        noise : shape (2, replicates), m and N, effect of noise on the error

        Notes
        -----
        On average, noise adds its variance v to the square of an error c. The error is therefore
        multiplied by sqrt(1 - v / c^2), or by zero if v exceeds c^2.
        """
        mean_effect, variance = np.nanmean(noise, axis=1), np.nanvar(noise, axis=1)
        error = measured - mean_effect
        # An error of zero gives NaN, which `fmax` replaces by zero.
        ratio = np.sqrt(np.fmax(1.0 - divide(variance, error**2), 0.0))
        return cls(ratio * error, ratio, smooth + mean_effect)

    def compute_noise_effect(self, errors: Floats) -> Floats:
        """Compute the effect of noise on the estimate from errors (2, ...) of noisy curves."""
        return 0.5 * self.noise_free_ratio[:, None] * (errors - self.mean_noisy_error[:, None])


class Plateau(Kind):
    """``end_slope`` (1), ``plateau_displacement`` (m), ``plateau_force`` (N): end of a loading."""

    result: ClassVar = "plateau"
    outputs: ClassVar = (
        Output("end_slope", "1", "End slope", can_be_negative=True),
        Output("plateau_displacement", "m", "Displacement at the plateau"),
        Output("plateau_force", "N", "Plateau force"),
    )
    method: ClassVar = "slope over the last {over_mm:g} mm of first loading / {of}"
    slope_below: Annotated[Fraction, "Fraction of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Length of a tangent"] = 0.005

    def compute(self, test: ReducedTest) -> list[MeasuredItem]:
        """Measure the plateau; without a slope at the end, omit its onset."""
        end_slope, *onset = super().compute(test)
        has_end_slope = isinstance(end_slope, Result) and end_slope.value is not None
        return [end_slope, *onset] if has_end_slope else [end_slope]

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the slope at the end of the first loading, and the onset of a plateau."""
        missing = Failure.of("results.no_stiffness", name=self.of)
        stiffness = test.require(test.stiffnesses.get(self.of), missing)
        choose_samples = partial(self._choose_end_samples, choose_initial=stiffness.choose_samples)
        outcome = test.measure_number(choose_samples)
        loading, period = test.cycles[0][:1], test.find_loading_period()
        slip_doubts = kinds.find_slip_doubts(test, stiffness.slip_range)
        gap_doubts = _find_gap_doubts(test, loading[0])
        doubts = (
            slip_doubts or find_truncation_doubts(test, loading, CURVE_QUANTITIES) or gap_doubts
        )
        end_slope = self.make_result(test, outcome, period=period, doubts=doubts)
        yield end_slope
        onset, trace = self._measure_onset(test, stiffness, end_slope), curves.make_trace(test)
        tangents, _ = self._choose_tangents(trace, stiffness.choose_samples)
        d, f = _cut_loading(trace)
        if not onset and (interval := end_slope.interval) is not None:
            facts: dict[str, Any] = {"slope": 1e2 * outcome.value, "low": 1e2 * interval.lower}
            facts |= {"high": 1e2 * interval.upper, "slope_below": 1e2 * self.slope_below}
            facts |= {"over": 1e3 * self.over, "reached": 1e3 * float(np.nanmax(d))}
            yield Finding.of("results.no_plateau", test.signals.force, of=self.of, **facts)
        method = (
            f"tangents over {1e3 * self.over:g} mm, below {1e2 * self.slope_below:g} % of "
            f"{self.of} up to the end of first loading"
        )
        context = {"method": method, "period": period, "doubts": slip_doubts or gap_doubts}
        yield from self.make_results(test, onset, first=1, **context)
        start, stop = tangents.ends
        slope, force = float(tangents.compute_end_slope(f)), tangents.compute_end_force(start, f)
        yield FittedLine("slope_at_end", slope, force, start, stop)

    def _choose_tangents(self, trace: Trace, choose_initial: Choice) -> tuple[Tangents, Extractor]:
        """Choose the tangents of the first loading, and the samples for the initial slope."""
        initial = choose_initial(trace)
        initial_slope = float(initial.compute_numbers(trace)[0])
        if initial_slope <= 0.0:
            raise UnavailableError.of("results.no_initial_slope", value=initial_slope)
        return Tangents.of(*_cut_loading(trace), length=self.over), initial

    def _choose_end_samples(self, trace: Trace, *, choose_initial: Choice) -> Extractor:
        """Choose the samples for the ratio of the slope at the end to that at the start."""
        tangents, initial = self._choose_tangents(trace, choose_initial)
        change_per_step = self._compute_change_per_step(trace, tangents)

        def compute_ratio(trace: Trace) -> tuple[Floats]:
            d, f = _cut_loading(trace)
            end_slope = tangents.compute_end_slope(f, d) + trace.steps_to_event * change_per_step
            return (np.asarray(end_slope / initial.compute_numbers(trace)[0], dtype=np.float64),)

        n_samples, ends_at_samples = len(tangents.end_samples), initial.ends_at_samples
        return Extractor(compute_ratio, n_samples, ends_at_samples=ends_at_samples)

    def _compute_change_per_step(self, trace: Trace, tangents: Tangents) -> float:
        """Compute the change of the slope at the end over the last sampling step, N/m.

        The machine turns at an unknown time, up to one step after the last sample.
        """
        d, f = _cut_loading(trace)
        earlier_tangents = return_failure(Tangents.of)(d[:-1], f[:-1], length=self.over)
        if isinstance(earlier_tangents, Failure):
            return 0.0
        return float(tangents.compute_end_slope(f) - earlier_tangents.compute_end_slope(f[:-1]))

    def _find_onset(
        self, trace: Trace, tangents: Tangents, initial: Extractor
    ) -> tuple[Floats, Floats, Floats]:
        """Find displacement (m) and force (N) at the onset, and the initial slope (N/m)."""
        (d, f), initial_slope = _cut_loading(trace), initial.compute_numbers(trace)[0]
        onset = tangents.find_onset(f, initial_slope, d, slope_below=self.slope_below)
        return *onset, initial_slope

    def _choose_onset(
        self, trace: Trace, choose_initial: Choice, corner: _CornerError
    ) -> Extractor:
        """Choose the samples for displacement and force at the onset of the plateau."""
        tangents, initial = self._choose_tangents(trace, choose_initial)

        def compute_onset(trace: Trace) -> tuple[Floats, Floats]:
            onset, force, _ = self._find_onset(trace, tangents, initial)
            correction = trace.sizes.get(TANGENT, 0.0) * corner.error
            return onset + correction[0], force + correction[1]

        def compute_noisy_onset(trace: Trace) -> tuple[Floats, Floats]:
            onset, force, _ = self._find_onset(trace, tangents, initial)
            errors = self._measure_corners(trace, tangents, initial)
            effect = corner.compute_noise_effect(errors)
            return onset + effect[0], force + effect[1]

        if np.isnan(compute_onset(trace)[1]):
            raise UnavailableError.of("results.no_onset")
        return Extractor(compute_onset, len(tangents.end_samples), compute_noisy_onset)

    def _measure_corners(self, trace: Trace, tangents: Tangents, initial: Extractor) -> Floats:
        """Measure the largest error of the onset from the length of tangents, m and N, (2, ...)."""
        # The factors are multiples of the change with tangents of half the length. At a corner, the
        # error of the onset is in proportion to the length, and thus twice that change. In a smooth
        # bend, it is in proportion to the square of the length, and thus 4/3 of that change. The
        # range from zero to the factor contains both.
        onset_factor = 3.0
        force_factor = (
            2.0  # for a parabola over half the length, the error is 1 or 1/3 of the change
        )
        d, f = _cut_loading(trace)
        onset, _, initial_slope = self._find_onset(trace, tangents, initial)
        limit = self.slope_below * initial_slope
        onset_change, force_change, slope = tangents.measure_corner_changes(f, onset, limit, d)
        onset_error = onset_factor * onset_change
        return np.stack([onset_error, force_factor * force_change + onset_error * slope])

    def _estimate_corner(self, replicates: Replicates, choose_initial: Choice) -> _CornerError:
        """Estimate the error of the onset of the measured curve, without the effect of noise.

        The effect of noise is the error of a replicate less that of the smooth curve, because the
        smooth curve may have other corners. If the smooth curve has no tangents or no initial
        slope, the effect is not removed.
        """
        measured, smooth = replicates.measured_trace, replicates.smooth_trace
        error = self._measure_corners(measured, *self._choose_tangents(measured, choose_initial))
        smooth_choice = return_failure(self._choose_tangents)(smooth, choose_initial)
        if isinstance(smooth_choice, Failure):
            return _CornerError(error, np.zeros(2), np.zeros(2))
        smooth_error = self._measure_corners(smooth, *smooth_choice)
        traces = replicates.iterate_traces()
        noisy_errors = [self._measure_corners(trace, *smooth_choice) for trace in traces]
        noise = np.concatenate(noisy_errors, axis=1) - smooth_error[:, None]
        return _CornerError.of(error, smooth_error, noise)

    def _measure_onset(
        self, test: ReducedTest, stiffness: Stiffness, end_slope: Result
    ) -> Sequence[Outcome]:
        """Measure displacement and force at the onset; the length of tangents is one more input.

        The outcomes are empty without a plateau, which is not a failure.
        """
        if end_slope.interval is None or not end_slope.interval.upper < self.slope_below:
            return ()

        def set_correction(trace: Trace, n_units: float) -> Trace:
            return replace(trace, sizes={**trace.sizes, TANGENT: n_units})

        replicates, choose_initial = test.require(test.replicates), stiffness.choose_samples
        measured = replicates.measured_trace
        tangents, initial = self._choose_tangents(measured, choose_initial)
        if np.isnan(self._find_onset(measured, tangents, initial)[1]):
            return 2 * (Failure.of("results.no_onset"),)
        correction = Input(TANGENT, set_correction, distribution="ends")
        replicates = replace(replicates, inputs=(*replicates.inputs, correction))
        corner = self._estimate_corner(replicates, choose_initial)
        choose_samples = partial(self._choose_onset, choose_initial=choose_initial, corner=corner)
        outcome = return_failure(measure_numbers)(replicates, choose_samples)
        return 2 * (outcome,) if isinstance(outcome, Failure) else outcome


def _cut_loading(trace: Trace) -> tuple[Floats, Floats]:
    """Cut displacement (m) and force (N) of the first loading from one or many curves."""
    loading = curves.select_first_loading(trace)
    return trace.displacement[..., loading], trace.force[..., loading]


def _find_gap_doubts(test: ReducedTest, branch: Branch) -> tuple[Reason, ...]:
    """Find a doubt if the force or the displacement at the end of a loading branch is missing."""
    curve = test.required_curve
    d, f = (values[branch.start : branch.stop] for values in (curve.displacement, curve.force))
    finite_samples = np.flatnonzero(np.isfinite(f) & np.isfinite(d))
    # Up to two samples are lost when two clocks are joined.
    if not len(finite_samples) or finite_samples[-1] >= len(d) - 3:
        return ()
    last = finite_samples[-1]
    return (Reason.of("results.gap_at_end", end=1e3 * float(d[last]), missing=len(d) - 1 - last),)
