"""Measure modulus, proof and yield stress, strength and elongation of tension tests.

Stress is force over the original area, strain is displacement over the gauge length. Elongations
and the strain of a proof stress begin where the elastic line meets zero stress (toe compensation).

**Uncertainty**: each quantity is computed again with each input changed by its standard uncertainty
(JCGM 100:2008, 5.1.3). The interval of the elastic line is that for correlated residuals.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labpipe.records import causes
from labpipe.records.arrays import Floats, Ints, drop_missing
from labpipe.records.curve import Direction, FittedLine
from labpipe.records.declarations import Fraction, Needs, Output, SnakeName
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.records.result import Result
from labpipe.results import kinds
from labpipe.results.curves import make_trace, require_samples
from labpipe.results.cycles import find_noise_doubts
from labpipe.results.kinds import Errors, Kind, MeasuredItem, ReducedTest
from labpipe.results.stiffness import compute_area
from labpipe.uncertainty.autocorrelation import LinearFit, estimate_fast_noise, fit_linear
from labpipe.uncertainty.intervals import MeasuredNumber
from labpipe.uncertainty.noise_model import compute_drift_modes
from labpipe.uncertainty.replicates import Trace

MIN_ELASTIC_SAMPLES = 8
"""Smallest number of samples of an elastic line."""
MIN_ELASTIC_RANGE = 0.1
"""Smallest range of stress of an elastic line, as a fraction of the largest stress."""
MAX_SLOPE_DIFFERENCE = 0.03
"""Largest relative difference of the slopes of both halves of an elastic line without a doubt."""
MAX_HALF_LINE_CHANGE = 0.005
"""Largest relative change of another quantity between the lines of both halves without a doubt."""
MAX_EXTENSION_RATIO = 1.1
"""Largest ratio of the extension of the gauge length to the travel of the machine without a
doubt."""
MAX_YIELD_ONSET_STRAIN = 5e-3
"""Largest plastic strain at an upper yield stress."""
MIN_YIELD_STRAIN = 5e-4
"""Smallest plastic strain of a yield with a falling stress."""
MIN_STRAIN_JUMP = 1e-4
"""Smallest jump of the strain that is reported."""
_CLEAR_DEVIATIONS = 6.0
"""Number of standard deviations of noise above which a change is significant."""


@dataclass(frozen=True, slots=True)
class ElasticWindow:
    """Settings of the part of the curve to which the elastic line is fitted.

    Parameters
    ----------
    start, stop : ends of a stated window; None for the longest straight part
    of : quantity of both ends: ``strain``, or ``strength`` for fractions of the largest stress
    straight : smallest square of the correlation coefficient of the longest straight part
    """

    start: float | None
    stop: float | None
    of: Literal["strain", "strength"]
    straight: float

    @property
    def text(self) -> str:
        """Text on a stated window; empty for the longest straight part."""
        if self.start is None or self.stop is None:
            return ""
        return f" from {self.start:.3%} to {self.stop:.3%} of the {self.of}"


_NO_SLOPE = Estimate(np.nan, np.nan, 0)


@dataclass(frozen=True, slots=True, eq=False)
class TensileCurve:
    """The loading of a tension test in stress and strain.

    Parameters
    ----------
    time : shape (n,), s
    strain, stress : shape (n,), 1 and Pa; strain is counted from the first sample or, if slack was
        subtracted, from the end of the slack; NaN while the extensometer is off
    window : samples of the elastic line
    stated_window : text on the stated window of the line; empty for the longest straight part
    stress_noise, strain_noise : Pa and 1, standard deviations of single samples
    slope_estimate : Pa, slope of the elastic line with its interval
    slope : Pa, slope of the elastic line
    mean_strain, mean_stress : 1 and Pa, means over the samples of the line; a point on the line
    line_failure : reason why there is no elastic line; None if there is one
    """

    time: Floats
    strain: Floats
    stress: Floats
    window: slice
    stated_window: str
    stress_noise: float
    strain_noise: float
    slope_estimate: Estimate = _NO_SLOPE
    slope: float = np.nan
    mean_strain: float = np.nan
    mean_stress: float = np.nan
    line_failure: Failure | None = None

    @property
    def toe(self) -> float:
        """Strain at which the elastic line meets zero stress."""
        return self.mean_strain - self.mean_stress / self.slope

    @property
    def peak(self) -> int:
        """Index of the sample of the largest stress."""
        return int(np.nanargmax(self.stress))

    def scale(self, stress_factor: float, strain_factor: float) -> TensileCurve:
        """Multiply stress and strain by factors, but neither the noise nor `slope_estimate`."""
        return replace(
            self,
            strain=strain_factor * self.strain,
            stress=stress_factor * self.stress,
            slope=self.slope * stress_factor / strain_factor,
            mean_strain=strain_factor * self.mean_strain,
            mean_stress=stress_factor * self.mean_stress,
        )


QuantityFunction: TypeAlias = Callable[[TensileCurve], float]
"""Function that computes a quantity from stress and strain."""


@return_failure
def fit_tensile_curve(test: ReducedTest, settings: ElasticWindow) -> TensileCurve:
    """Compute stress and strain of the loading without unloading loops, and fit the elastic line.

    Parameters
    ----------
    test : reduced test with a curve and the sizes of the specimen
    settings : part of the curve for the elastic line

    Returns
    -------
    The curve, with a reason in `line_failure` if no line can be fitted; a failure without a
    loading, an area or a gauge length.
    """
    trace = make_trace(test)
    samples = _select_loading(trace)
    samples = test.require(samples if len(samples) > 1 else None)
    sizes = test.setup.sizes
    force, displacement = trace.force[samples], trace.displacement[samples]
    stress = kinds.compute_loading_sign(force) * force / compute_area(sizes)
    # If slack was subtracted, the displacement is zero at the end of the slack.
    has_slack = isinstance(test.slack, MeasuredNumber)
    start = 0.0 if has_slack else drop_missing(displacement)[:1].sum()
    sense = kinds.compute_loading_sign(displacement)
    strain = sense * (displacement - start) / get_gauge_length(sizes)
    curve = TensileCurve(
        time=trace.time[samples],
        strain=strain,
        stress=stress,
        window=slice(0, 0),
        stated_window=settings.text,
        stress_noise=_estimate_noise(stress),
        strain_noise=_estimate_noise(strain),
    )
    try:
        window = _choose_elastic_window(curve, settings)
        x, y = _average_blocks(strain[window], stress[window])
        require_samples(len(x), MIN_ELASTIC_SAMPLES, " of the elastic line")
        fit = _fit_line(x, y)
        if fit.coefficients[1] <= 0.0:
            raise UnavailableError.of("results.no_elastic_line", why="its slope is not positive")
    except UnavailableError as error:
        return replace(curve, line_failure=error.failure)
    slope = fit.make_estimate(1)
    curve = replace(curve, window=window, slope_estimate=slope, slope=slope.value)
    return replace(curve, mean_strain=float(x.mean()), mean_stress=float(fit.coefficients[0]))


def _fit_line(strain: Floats, stress: Floats) -> LinearFit:
    """Fit a line, with a cubic in time through the strain as the instrument.

    Noise of the strain would lower the slope of a least-squares line (Durbin, Rev. Int. Stat. Inst.
    22 (1954) 23).
    """
    cubic = np.vander(np.linspace(-1.0, 1.0, len(strain)), 4)
    smooth = cubic @ np.linalg.lstsq(cubic, strain, rcond=None)[0]
    noise, centred = strain - smooth, smooth - smooth.mean()
    slope = centred @ stress / (centred @ centred)
    return fit_linear(np.column_stack([np.ones_like(strain), centred]), stress - slope * noise)


def _select_loading(trace: Trace) -> Ints:
    """Select the samples of the loading up to a failure, without those of unloading loops.

    A loop ends when the displacement exceeds that at which the loop began.
    """
    stop = len(trace.time) if trace.failed_at is None else trace.failed_at + 1
    samples, largest_so_far = [np.empty(0, dtype=np.intp)], -np.inf
    for branch in trace.branches:
        if branch.direction is Direction.UNLOADING or branch.start >= stop:
            continue
        loading = np.arange(branch.start, min(branch.stop, stop))
        displacement = trace.displacement[loading]
        displacement = kinds.compute_loading_sign(displacement) * displacement
        is_new = np.fmax.accumulate(displacement) > largest_so_far
        samples.append(loading[int(np.argmax(is_new)) :] if is_new.any() else loading[:0])
        largest_so_far = max(largest_so_far, float(np.fmax.reduce(displacement)))
    return np.concatenate(samples)


def _estimate_noise(values: Floats) -> float:
    """Estimate the standard deviation of single samples; 0 for too few samples."""
    finite = drop_missing(values)
    return float(estimate_fast_noise(finite)) if len(finite) >= MIN_ELASTIC_SAMPLES else 0.0


def _estimate_rounding(values: Floats) -> float:
    """Estimate the standard deviation of rounding from the step between rounded values."""
    changes = np.abs(np.diff(values[~np.isnan(values)]))
    gaps = np.diff(np.sort(np.append(changes, 0.0)))
    gaps = gaps[gaps > 1e-9 * changes.sum()]
    return float(gaps.min() / np.sqrt(12.0)) if len(gaps) else 0.0


def _average_blocks(strain: Floats, stress: Floats) -> tuple[Floats, Floats]:
    """Average strain and stress over at most 1000 blocks of the samples that have both."""
    is_finite = ~np.isnan(strain) & ~np.isnan(stress)
    strain, stress = strain[is_finite], stress[is_finite]
    width = 1 + len(strain) // 1000
    stop = width * (len(strain) // width)
    x, y = (values[:stop].reshape(-1, width).mean(axis=1) for values in (strain, stress))
    return x, y


def _choose_elastic_window(curve: TensileCurve, settings: ElasticWindow) -> slice:
    """Choose the samples of the elastic line: a stated window, or the longest straight part."""
    if settings.start is None or settings.stop is None:
        return _find_longest_straight_part(curve, settings.straight)
    scale = float(np.nanmax(curve.stress)) if settings.of == "strength" else 1.0
    values = curve.stress if settings.of == "strength" else curve.strain
    is_beyond = values > settings.stop * scale
    if not is_beyond.any():
        raise UnavailableError.of("results.elastic_window_not_reached")
    return slice(int(np.argmax(values >= settings.start * scale)), int(np.argmax(is_beyond)))


def _find_longest_straight_part(curve: TensileCurve, min_correlation: float) -> slice:
    """Find the longest range of stress in which the curve is straight; it is not steeper below it.

    The square of the correlation coefficient in the range is at least `min_correlation`, or that of
    a straight line with the noise of both signals. One minus this square is the normalised residual
    of slope determination by analysis of residuals (ASTM E3076, described by the package sdarr).
    That method uses the window with the smallest residual. The longest window within a limit
    depends less on noise. Its ends are searched in steps of 1 % of the largest stress.

    The elastic range is the steepest part of a curve. The line of a later straight part is far
    above the curve at the first sample, and is rejected.
    """
    strain, stress = curve.strain, curve.stress
    is_finite = ~np.isnan(strain) & ~np.isnan(stress)
    largest = float(np.nanmax(stress[is_finite])) if is_finite.any() else np.nan
    limits = np.arange(0.0, 1.0, 0.01) * largest
    finite_stress = np.where(is_finite, stress, -np.inf)
    ends = np.array([int(np.argmax(finite_stress >= limit)) for limit in limits])
    x, y = np.where(is_finite, strain, 0.0), np.where(is_finite, stress / largest, 0.0)
    x = x / np.abs(x).max(initial=1e-30)
    counts, *sums = (
        np.concatenate([[0.0], np.cumsum(values)])[ends]
        for values in (is_finite.astype(np.float64), x, y, x * x, x * y, y * y)
    )
    # Each sum is over the samples from a start (row) to a stop (column).
    n, sx, sy, sxx, sxy, syy = (np.subtract.outer(x, x).T for x in (counts, *sums))
    is_enough = n >= MIN_ELASTIC_SAMPLES
    n = np.where(is_enough, n, 1.0)
    spread_x, spread_y, product = sxx - sx * sx / n, syy - sy * sy / n, sxy - sx * sy / n
    # Plastic flow makes the upper half of the curve rougher, so noise is taken from the lower half.
    n_low, noise = int(np.argmax(y[is_finite] >= 0.5)), np.zeros_like(n)
    for values, spread in ((x, spread_x), (y, spread_y)):
        low_values = values[is_finite][:n_low]
        deviation = max(_estimate_noise(low_values), _estimate_rounding(low_values))
        noise += n * deviation**2 / np.maximum(spread, 1e-30)
    max_scatter = 1.0 + 1.645 * np.sqrt(2.0 / n)  # of a sum of squares, at 95 %
    max_residual = np.maximum(1.0 - min_correlation, max_scatter * noise)
    is_straight = product**2 >= (1.0 - max_residual) * spread_x * spread_y
    is_straight &= is_enough & (max_residual < 1.0) & (spread_x * spread_y > 0.0)
    # At the first sample, the line is at most `MIN_ELASTIC_RANGE` above the curve.
    x_from_first, y_from_first = sx / n - x[is_finite][:1], sy / n - y[is_finite][:1]
    is_low = (y_from_first - MIN_ELASTIC_RANGE) * spread_x <= product * x_from_first
    ranges = 0.01 * np.subtract.outer(np.arange(len(limits)), np.arange(len(limits))).T
    ranges = np.where(is_straight & is_low, ranges, -1.0)
    start, stop = np.unravel_index(int(np.argmax(ranges)), ranges.shape)
    if ranges[start, stop] < MIN_ELASTIC_RANGE:
        why = f"no part over {MIN_ELASTIC_RANGE:.0%} of the largest stress is straight"
        raise UnavailableError.of("results.no_elastic_line", why=why)
    return slice(int(ends[start]), int(ends[stop]))


def get_gauge_length(sizes: Mapping[str, float]) -> float:
    """Return the gauge length of the extensometer, m, or the length between grips without one.

    Parameters
    ----------
    sizes : sizes of the specimen, m, by the keys of the protocol

    Raises
    ------
    UnavailableError
        ``no_length``.
    """
    length = sizes.get("gauge_length", sizes.get("length"))
    if length is None:
        raise UnavailableError.of("results.no_gauge_length")
    return length


@dataclass(frozen=True, slots=True, eq=False)
class TensileQuantity:
    """A quantity of a tensile curve, with the samples on which it depends, errors and doubts.

    Parameters
    ----------
    compute : function that computes the quantity of a tensile curve
    sample_range : first and last sample on which the quantity depends; the stop of a window may
        replace the last one
    has_line : whether the quantity depends on the elastic line
    errors : further standard errors of the quantity, by cause
    doubts : further reasons to doubt the quantity
    """

    compute: QuantityFunction
    sample_range: tuple[int, int]
    has_line: bool = True
    errors: Errors = field(default_factory=dict)
    doubts: tuple[Reason, ...] = ()


class TensionResult(Kind):
    """A kind of result in stress and strain, which may need an elastic line."""

    needs: ClassVar = Needs(branches=True, correction="elastic_line")
    needs_line: ClassVar = True

    @abstractmethod
    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the quantities of a tensile curve, in the order of the outputs."""

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure each quantity, and its changes with each input."""
        curve = test.require(test.tensile_curve)
        if curve.line_failure is not None and self.needs_line:
            raise UnavailableError(curve.line_failure)
        for output, quantity in enumerate(self.list_quantities(test, curve)):
            value, errors, doubts = quantity.compute(curve), dict[str, float](), quantity.doubts
            for cause, changed_curve in _change_inputs(test, curve):
                change = quantity.compute(changed_curve) - value
                errors[cause] = float(np.hypot(errors.get(cause, 0.0), change))
            errors |= quantity.errors
            outcome = Estimate(value, 0.0, curve.slope_estimate.n)
            if quantity.compute is _get_slope:
                outcome = curve.slope_estimate
            elif quantity.has_line:
                steeper_curve = replace(curve, slope=curve.slope + curve.slope_estimate.error)
                outcome = replace(outcome, error=abs(quantity.compute(steeper_curve) - value))
            if quantity.has_line:
                doubts = (*_list_line_doubts(test, curve, quantity.compute), *doubts)
            ends = np.minimum(quantity.sample_range, len(curve.time) - 1)
            start, stop = curve.time[ends].tolist()
            yield self.make_result(
                test, outcome, errors, output=output, period=(start, stop), doubts=doubts
            )


def _change_inputs(test: ReducedTest, curve: TensileCurve) -> Iterator[tuple[str, TensileCurve]]:
    """Yield the curve with each input changed by its standard uncertainty, by cause."""
    setup, sizes = test.setup, test.setup.sizes
    yield causes.SCALE_OF_FORCE, curve.scale(1.0 + test.raw_force.relative_error, 1.0)
    yield causes.SCALE_OF_DISPLACEMENT, curve.scale(1.0, 1.0 + test.displacement.relative_error)
    zero = test.raw_force.zero_error / compute_area(sizes)
    yield causes.ZERO_OF_FORCE, _add_stress(curve, np.full(len(curve.stress), zero))
    drift = test.raw_force.zero_drift * float(np.nanmax(np.abs(curve.stress)))
    for mode in compute_drift_modes(curve.time - curve.time[0], drift):
        yield causes.DRIFT_OF_ZERO, _add_stress(curve, mode)
    for name, error in setup.uncertainties.items():
        if name not in sizes:
            continue
        larger_sizes = {**sizes, name: sizes[name] + error}
        cause = causes.LENGTH if name in ("length", "gauge_length") else causes.SECTION
        stress_factor = compute_area(sizes) / compute_area(larger_sizes)
        strain_factor = get_gauge_length(sizes) / get_gauge_length(larger_sizes)
        yield cause, curve.scale(stress_factor, strain_factor)
    # This noise affects quantities from single samples; the elastic line has its own error.
    yield causes.NOISE, replace(curve, stress=curve.stress + curve.stress_noise)
    yield causes.NOISE_OF_DISPLACEMENT, replace(curve, strain=curve.strain + curve.strain_noise)


def _add_stress(curve: TensileCurve, stress: Floats) -> TensileCurve:
    """Add a stress to every sample of a tensile curve, and to its elastic line."""
    x, y = _average_blocks(curve.strain[curve.window], stress[curve.window])
    slope_change, mean_change = np.polyfit(x - x.mean(), y, 1) if len(x) else (0.0, 0.0)
    slope, mean_stress = curve.slope + slope_change, curve.mean_stress + mean_change
    return replace(curve, stress=curve.stress + stress, slope=slope, mean_stress=mean_stress)


def _list_line_doubts(
    test: ReducedTest, curve: TensileCurve, compute: QuantityFunction
) -> Iterator[Reason]:
    """Yield doubts about an elastic line, and about the displacement from which it is computed.

    The line is doubtful if it bends, or if the curve later rises above it. Metals do not stiffen,
    so both are signs of an extensometer that slips or jumps, or of a bent specimen. A line in a
    stated window is not examined, because the window defines it. Without an extensometer, the
    displacement may be that of the machine. With an extensometer, the extension cannot exceed the
    travel of the machine, because the gauge length lies between the grips. An extension that does
    may have a wrong unit.
    """
    if not curve.stated_window:
        strain, stress = (values[curve.window] for values in (curve.strain, curve.stress))
        is_upper, half_values = stress > 0.5 * (np.nanmin(stress) + np.nanmax(stress)), []
        for is_in_half in (~is_upper, is_upper):
            x, y = _average_blocks(strain[is_in_half], stress[is_in_half])
            slope, mean_strain, mean_stress = np.polyfit(x, y, 1)[0], x.mean(), y.mean()
            variant = replace(curve, slope=slope, mean_strain=mean_strain, mean_stress=mean_stress)
            half_values.append(compute(variant))
        value, change = compute(curve), half_values[1] - half_values[0]
        max_change = MAX_SLOPE_DIFFERENCE if value == curve.slope else MAX_HALF_LINE_CHANGE
        if abs(change) > max_change * abs(value):
            yield Reason.of("results.elastic_line_bends", change=change / value)
        until_peak = slice(curve.window.stop, max(curve.peak, curve.window.stop) + 1)
        stress_above = _compute_stress_above_line(curve)[until_peak]
        largest = float(np.fmax.reduce(stress_above, initial=-np.inf))
        end_stress = float(curve.stress[curve.window.stop - 1])
        noise = float(np.hypot(curve.stress_noise, curve.slope * curve.strain_noise))
        if largest > max(_CLEAR_DEVIATIONS * noise, 0.01 * end_stress):
            yield Reason.of("results.above_elastic_line", above=1e-6 * largest)
    travel, sizes = test.signals.raw.get("displacement"), test.setup.sizes
    length = get_gauge_length(sizes)
    if "gauge_length" not in sizes:
        yield from kinds.find_compliance_doubts(test, curve.slope * compute_area(sizes) / length)
    elif travel is not None:
        last = int(np.nanargmax(curve.strain))
        extension = 1e3 * length * float(curve.strain[last] - np.nanmin(curve.strain))
        path = np.interp(curve.time[: last + 1], travel.time, travel.values)
        facts = {"extension": extension, "travel": 1e3 * float(np.ptp(path))}
        if extension > MAX_EXTENSION_RATIO * facts["travel"] > 0.0:
            yield Reason.of("results.extension_exceeds_travel", **facts)


def _find_jump_doubts(curve: TensileCurve, stop: int) -> tuple[Reason, ...]:
    """Find a doubt if the strain jumps up to a sample, as in a slip of a knife edge."""
    finite_samples = np.flatnonzero(~np.isnan(curve.strain[: stop + 7]))
    counts = np.diff(finite_samples)
    steps = np.diff(curve.strain[finite_samples]) / counts  # per sample, so that a gap is no jump
    if len(steps) < MIN_ELASTIC_SAMPLES:
        return ()
    # The speed may change at a step, so it is compared with five steps before and five after it.
    medians = np.median(sliding_window_view(np.pad(steps, 6, "reflect"), 5), axis=1)
    usual_steps = np.stack([medians[1 : 1 + len(steps)], medians[7 : 7 + len(steps)]])
    jumps = np.abs(steps - usual_steps).min(axis=0) * counts
    min_jump = max(MIN_STRAIN_JUMP, _CLEAR_DEVIATIONS * curve.strain_noise)
    is_jump = jumps > np.maximum(min_jump, 3.0 * np.abs(usual_steps).max(axis=0))
    is_jump &= finite_samples[1:] <= stop
    if not is_jump.any():
        return ()
    index = int(np.argmax(np.where(is_jump, jumps, 0.0)))
    jump = float(steps[index] * counts[index])
    stress = 1e-6 * float(curve.stress[finite_samples[index]])
    return (Reason.of("results.strain_jumps", jump=jump, stress=stress),)


class ElasticModulus(TensionResult):
    """``elastic_modulus`` (Pa): slope of the elastic line."""

    result: ClassVar = "elastic-modulus"
    outputs: ClassVar = (Output("elastic_modulus", "Pa", "Modulus of elasticity"),)
    method: ClassVar = "slope of the elastic line"

    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the slope of the elastic line, whose residuals may be correlated."""
        del test
        window, doubts = curve.window, _find_jump_doubts(curve, curve.window.stop)
        # Neighbouring values have the same rounding error, so rounding moves both ends of the line.
        strain, sample_range = drop_missing(curve.strain[window]), (window.start, window.stop)
        rounding = np.sqrt(2.0) * curve.slope * _estimate_rounding(strain) / np.ptp(strain)
        errors = {causes.RESOLUTION_OF_DISPLACEMENT: float(rounding)}
        return [TensileQuantity(_get_slope, sample_range, errors=errors, doubts=doubts)]

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the slope, and yield the line for figures."""
        (modulus,) = (x for x in super().measure(test) if isinstance(x, Result))
        curve = test.require(test.tensile_curve)
        low, high = (1e-6 * f(curve.stress[curve.window]) for f in (np.nanmin, np.nanmax))
        method, remark = self.method + curve.stated_window, f"from {low:.4g} to {high:.4g} MPa"
        yield replace(modulus, method=method, remark=remark)
        path = test.required_curve.displacement[_select_loading(make_trace(test))[curve.window]]
        start, stop = float(np.nanmin(path)), float(np.nanmax(path))
        strain = float(np.nanmin(curve.strain[curve.window]))
        area, length = compute_area(test.setup.sizes), get_gauge_length(test.setup.sizes)
        start_force = area * (curve.mean_stress + curve.slope * (strain - curve.mean_strain))
        slope = curve.slope * area / length
        yield FittedLine("elastic_modulus", slope, start_force, start, stop)


def _get_slope(curve: TensileCurve) -> float:
    """Return the slope of the elastic line, Pa."""
    return curve.slope


class ProofStress(TensionResult):
    """``<name>`` (Pa): stress at which the curve meets the elastic line shifted by a strain."""

    result: ClassVar = "proof-stress"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    method: ClassVar = "stress where the curve meets the elastic line shifted by {offset:.2%}"
    offset: Annotated[Fraction, "Plastic strain, such as 0.2 %"]
    name: Annotated[SnakeName, "Such as proof_stress_0_2"] = "proof_stress"

    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the stress at which the curve falls below the shifted elastic line."""
        del test

        def interpolate_stress(curve: TensileCurve) -> float:
            sample = _find_meeting_sample(curve, self.offset)
            above, below = _compute_stress_above_line(curve, self.offset)[sample - 1 : sample + 1]
            return float(np.interp(0.0, [below, above], curve.stress[[sample, sample - 1]]))

        crossing = _find_meeting_sample(curve, self.offset)
        doubts = _find_jump_doubts(curve, crossing)
        return [TensileQuantity(interpolate_stress, (curve.window.start, crossing), doubts=doubts)]


def _compute_stress_above_line(curve: TensileCurve, offset: float = 0.0) -> Floats:
    """Compute how far each stress is above the elastic line shifted by a strain, Pa."""
    return curve.stress - curve.slope * (curve.strain - curve.toe - offset)


def _find_meeting_sample(curve: TensileCurve, offset: float) -> int:
    """Find the first sample after the window that is on or below the line shifted by a strain."""
    is_below = _compute_stress_above_line(curve, offset) <= 0.0
    is_below[: curve.window.stop] = False
    if not is_below.any():
        last = np.nanmax(curve.strain) - curve.toe
        raise UnavailableError.of("results.offset_not_reached", offset=offset, last=last)
    return int(np.argmax(is_below))


class YieldStress(TensionResult):
    """``upper_yield_stress`` and ``lower_yield_stress`` (Pa): stresses at a yield with a fall."""

    result: ClassVar = "yield-stress"
    outputs: ClassVar = (
        Output("upper_yield_stress", "Pa", "Upper yield strength"),
        Output("lower_yield_stress", "Pa", "Lower yield strength"),
    )
    methods: ClassVar = (
        "largest stress before the first fall of the force after the elastic line",
        "smallest stress until the upper yield stress is reached again, first trough left out",
    )

    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the stress at the first fall, and the lowest stress while the specimen yields."""
        del test
        return [
            TensileQuantity(partial(_get_stress, sample=sample), (sample, sample), has_line=False)
            for sample in _find_yield_samples(curve)
        ]


def _get_stress(curve: TensileCurve, sample: int) -> float:
    """Return the stress of a sample, Pa."""
    return float(curve.stress[sample])


def _find_yield_samples(curve: TensileCurve) -> tuple[int, int]:
    """Find the samples of the upper and of the lower yield stress.

    The stress falls if it is below its largest value so far by more than six standard deviations of
    noise and more than a thousandth of the peak. A fall at a large plastic strain is a serration of
    later flow. After a slip of the grips or a pause, the stress before the fall is reached again
    without more plastic strain. Any other fall is a yield.
    """
    stress, peak, upper = curve.stress, curve.peak, curve.window.stop
    clear_fall = max(_CLEAR_DEVIATIONS * curve.stress_noise, 1e-3 * float(stress[peak]))
    plastic_strain = curve.strain - curve.toe - stress / curve.slope
    while upper < peak:
        until_peak = stress[upper : peak + 1]
        is_fallen = np.fmax.accumulate(until_peak) - until_peak > clear_fall
        if not is_fallen.any():
            break
        upper += int(np.nanargmax(until_peak[: int(np.argmax(is_fallen))]))
        higher = np.flatnonzero(stress[upper + 1 : peak + 1] > stress[upper])
        stop = upper + 1 + int(higher[0]) if len(higher) else peak + 1
        if plastic_strain[upper] > MAX_YIELD_ONSET_STRAIN:
            break
        if not len(higher) or plastic_strain[stop] - plastic_strain[upper] > MIN_YIELD_STRAIN:
            return upper, upper + _find_trough(stress[upper:stop], clear_fall)
        upper = stop
    raise UnavailableError.of("results.no_yield_point", clear=1e-6 * clear_fall)


def _find_trough(plateau: Floats, clear_change: float) -> int:
    """Find the index of the lowest stress of a plateau, without a transient first trough.

    A trough is transient if the stress rises by more than `clear_change` after it, and falls again.
    """
    is_risen = plateau - np.fmin.accumulate(plateau) > clear_change
    start = int(np.argmax(is_risen)) if is_risen.any() else 0
    later_stress = plateau[start:]
    if start and np.nanmax(np.fmax.accumulate(later_stress) - later_stress) > clear_change:
        return start + int(np.nanargmin(later_stress))
    return int(np.nanargmin(plateau))


class TensileStrength(TensionResult):
    """``tensile_strength`` (Pa): the largest force over the original area."""

    result: ClassVar = "tensile-strength"
    outputs: ClassVar = (Output("tensile_strength", "Pa", "Tensile strength", ("force",)),)
    method: ClassVar = "largest force over the original area"
    needs_line: ClassVar = False

    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the largest stress."""
        strength, sample_range = partial(_get_stress, sample=curve.peak), (0, curve.peak)
        doubts = _find_peak_doubts(test, curve)
        return [TensileQuantity(strength, sample_range, has_line=False, doubts=doubts)]


def _find_peak_doubts(test: ReducedTest, curve: TensileCurve) -> tuple[Reason, ...]:
    """Find doubts about the peak: noise, or an end of the record while the force may rise again."""
    doubts = find_noise_doubts(curve.stress, "force")
    if isinstance(test.failure, kinds.FailurePoint):
        return doubts
    stress = drop_missing(curve.stress)
    return (*doubts, Reason.of("results.ends_at_peak", share=float(stress[-1] / stress.max())))


def _find_extensometer_doubts(test: ReducedTest, curve: TensileCurve) -> tuple[Reason, ...]:
    """Find a doubt if the strain stays constant before the peak while the machine moves.

    After the peak, a specimen may neck outside of the gauge length.
    """
    min_rate_ratio, last_fraction = 0.1, 0.1  # rate over the mean rate; last part of the travel
    travel, stop = test.signals.raw.get("displacement"), curve.peak + 1
    if travel is None or "gauge_length" not in test.setup.sizes:
        return ()
    path, strain = np.interp(curve.time[:stop], travel.time, travel.values), curve.strain[:stop]
    path = np.abs(path - path[0])
    is_last = (path >= (1.0 - last_fraction) * path[-1]) & ~np.isnan(strain)
    if path[is_last].size < MIN_ELASTIC_SAMPLES or not np.ptp(path[is_last]) > 0.0:
        return ()
    rate = float(np.polyfit(path[is_last], strain[is_last], 1)[0])
    if rate >= min_rate_ratio * (np.nanmax(strain) - curve.toe) / path[-1]:
        return ()
    return (Reason.of("results.extension_stops", last=float(strain[is_last][-1]) - curve.toe),)


def _declare_elongations(event: str) -> tuple[Output, Output]:
    """Declare the total and the plastic elongation at an event, such as ``maximum force``."""
    name = f"elongation_at_{event.replace(' ', '_')}"
    total = Output(name, "1", f"Elongation at {event}")
    return total, Output(
        f"plastic_{name}", "1", f"Plastic elongation at {event}", can_be_negative=True
    )


class MaximumForceElongation(TensionResult):
    """``elongation_at_maximum_force`` and ``plastic_elongation_at_maximum_force`` (1)."""

    result: ClassVar = "elongation-at-maximum-force"
    outputs: ClassVar = _declare_elongations("maximum force")
    methods: ClassVar = (
        "strain from the toe to the sample of the largest force",
        "strain from the toe to the sample of the largest force, less the stress over the modulus",
    )

    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the total and the plastic strain at the largest force.

        Because of noise, the largest sample may be a neighbour of the sample at the true peak.
        """
        noise = _estimate_noise(curve.stress[max(curve.peak - 50, 0) : curve.peak + 50])
        is_near_peak = curve.stress >= curve.stress[curve.peak] - 2.0 * noise
        first, last = np.flatnonzero(is_near_peak)[[0, -1]].tolist()
        if np.isnan(curve.strain[[first, last]]).any():
            raise _make_extensometer_error(curve, "the largest force")
        ends = curve.strain[[first, last]] - curve.strain[curve.peak]
        # All strains between the ends are equally probable. Their spread is the root of the second
        # moment about the strain of the largest sample.
        spread = float(np.sqrt((ends @ ends + ends.prod()) / 3.0))
        sample_range = curve.window.start, last + 1
        doubts = _find_peak_doubts(test, curve) + _find_extensometer_doubts(test, curve)
        return _list_elongations(curve.peak, sample_range, {causes.PEAK: spread}, doubts)


def _list_elongations(
    sample: int, sample_range: tuple[int, int], errors: Errors, doubts: tuple[Reason, ...]
) -> list[TensileQuantity]:
    """List the strain of a sample from the toe, with and without the elastic strain."""

    def compute_strain(curve: TensileCurve) -> float:
        return float(curve.strain[sample]) - curve.toe

    def compute_plastic_strain(curve: TensileCurve) -> float:
        return compute_strain(curve) - float(curve.stress[sample]) / curve.slope

    functions = compute_strain, compute_plastic_strain
    return [TensileQuantity(x, sample_range, errors=errors, doubts=doubts) for x in functions]


def _make_extensometer_error(curve: TensileCurve, event: str) -> UnavailableError:
    """Make the error for an extensometer that comes off before an event."""
    last = float(np.nanmax(curve.strain)) - curve.toe
    return UnavailableError.of("results.extensometer_off", event=event, last=last)


class BreakElongation(TensionResult):
    """``elongation_at_break`` and ``plastic_elongation_at_break`` (1): at the last sample."""

    result: ClassVar = "elongation-at-break"
    outputs: ClassVar = _declare_elongations("break")
    methods: ClassVar = (
        "strain from the toe to the last sample before the specimen parts",
        "strain from the toe to the last sample before the specimen parts, less the stress over "
        "the modulus",
    )

    def list_quantities(self, test: ReducedTest, curve: TensileCurve) -> Sequence[TensileQuantity]:
        """List the total and the plastic strain at the last sample before the force is lost."""
        test.require(test.failure)
        last = len(curve.stress) - 1
        if np.isnan(curve.strain[last]):
            raise _make_extensometer_error(curve, "the break")
        # The break is equally probable anywhere between this sample and the next one. The step is
        # assumed to be as long as the last one.
        error = abs(float(np.diff(curve.strain[-2:])[0])) / np.sqrt(3.0)
        sample_range, doubts = (curve.window.start, last), _find_extensometer_doubts(test, curve)
        return _list_elongations(last, sample_range, {causes.STEP: error}, doubts)
