"""Tension tests by stress and strain: modulus, proof and yield stress, strength, elongation.

Stress is force over the original area, strain is displacement over the gauge length. Elongations
and the strain of a proof stress begin where the elastic line meets zero stress (toe compensation).

**Uncertainty**: each number is computed again with every input changed by its standard uncertainty
(JCGM 100:2008, 5.1.3); the elastic line has an interval for correlated residuals.
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
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Direction, FittedLine
from labpipe.records.declarations import Fraction, Needs, Output, Snake
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.records.result import Result
from labpipe.results import kinds
from labpipe.results.curves import make_trace, require_samples
from labpipe.results.kinds import Kind, Part, ReducedTest
from labpipe.results.stiffness import compute_area
from labpipe.uncertainty.autocorrelation import estimate_fast_noise, fit_linear
from labpipe.uncertainty.intervals import Measured
from labpipe.uncertainty.noise_model import compute_drift_modes
from labpipe.uncertainty.replicates import Trace

MIN_ELASTIC_SAMPLES = 8
MIN_ELASTIC_SHARE = 0.1
"""Smallest range of stress of an elastic line, as a share of the largest stress."""
MAX_BEND = 0.03
"""Relative difference of the slopes of both halves of an elastic line that makes it doubtful."""
MAX_EXTENSION = 1.1
"""Extension of the gauge length over the travel of the machine, beyond which both are doubtful."""
MAX_YIELD_ONSET = 5e-3
"""Largest plastic strain at an upper yield stress."""
MIN_YIELD_STRAIN = 5e-4
"""Smallest plastic strain of a yield with a falling stress."""
MIN_STRAIN_JUMP = 1e-4
"""Smaller jumps of the strain are ignored."""
MAX_CHANGE_BY_BEND = 0.005
"""Relative difference of another number with the lines of both halves that makes it doubtful."""


@dataclass(frozen=True, slots=True)
class ElasticWindow:
    """Part of the curve to which the elastic line is fitted.

    Parameters
    ----------
    start, stop : ends of a stated window; None for the longest straight part
    of : quantity of the ends of a stated window: strain, or share of the largest stress
    straight : smallest square of the correlation coefficient of the longest straight part
    """

    start: float | None
    stop: float | None
    of: Literal["strain", "strength"]
    straight: float


_NO_SLOPE = Estimate(np.nan, np.nan, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """The loading of a tension test in stress and strain.

    Parameters
    ----------
    time : shape (n,), s
    strain, stress : shape (n,), 1 and Pa; strain is counted from the first sample, or from where
        slack ends, and is NaN where the extensometer is off
    window : samples of the elastic line
    is_straight : whether the line was sought as the longest straight part, not in a stated window
    noise : Pa, standard deviation of single samples of the stress
    strain_noise : 1, the same of the strain
    slope : Pa, of the elastic line; ``slope_estimate`` has its interval
    centre, level : 1 and Pa, a point of the elastic line: the mean of its samples
    without_line : reason why there is no elastic line; None if there is one
    """

    time: Floats
    strain: Floats
    stress: Floats
    window: slice
    is_straight: bool
    noise: float
    strain_noise: float
    slope_estimate: Estimate = _NO_SLOPE
    slope: float = np.nan
    centre: float = np.nan
    level: float = np.nan
    without_line: Failure | None = None

    @property
    def toe(self) -> float:
        """Return the strain at which the elastic line meets zero stress."""
        return self.centre - self.level / self.slope

    @property
    def peak(self) -> int:
        """Return the sample of the largest stress."""
        return int(np.nanargmax(self.stress))

    def scaled(self, stress: float = 1.0, strain: float = 1.0) -> Pull:
        """Return the pull with stress and strain multiplied by factors.

        The noise and `slope_estimate` remain as they are.
        """
        return replace(
            self,
            strain=strain * self.strain,
            stress=stress * self.stress,
            slope=self.slope * stress / strain,
            centre=strain * self.centre,
            level=stress * self.level,
        )


Number: TypeAlias = Callable[[Pull], float]


@return_failure
def fit_pull(test: ReducedTest, choice: ElasticWindow) -> Pull:
    """Compute stress and strain of the loading without unloading loops, and fit the elastic line.

    Parameters
    ----------
    test : reduced test with a curve and the sizes of the specimen
    choice : the part of the elastic line

    Returns
    -------
    The pull, with a reason in `without_line` if no line can be fitted; a failure without a loading,
    an area or a gauge length.
    """
    trace = make_trace(test)
    samples = _select_new_strains(trace)
    part = test.require(samples if len(samples) > 1 else None)
    sizes = test.setup.sizes
    force, displacement = trace.force[part], trace.displacement[part]
    stress = kinds.compute_loading_sign(force) * force / compute_area(sizes)
    first = displacement[~np.isnan(displacement)][:1].sum()
    if isinstance(test.slack, Measured):
        first = 0.0  # the displacement is counted from where the specimen is taut
    sense = kinds.compute_loading_sign(displacement)
    strain = sense * (displacement - first) / find_gauge_length(sizes)
    pull = Pull(
        time=trace.time[part],
        strain=strain,
        stress=stress,
        window=slice(0, 0),
        is_straight=choice.start is None,
        noise=_estimate_noise(stress),
        strain_noise=_estimate_noise(strain),
    )
    try:
        window = _choose_elastic_part(strain, stress, choice)
        x, y = _average_blocks(strain[window], stress[window])
        require_samples(len(x), MIN_ELASTIC_SAMPLES, " of the elastic line")
        fit = fit_linear(np.column_stack([np.ones_like(x), x - x.mean()]), y)
        if fit.coefficients[1] <= 0.0:
            raise UnavailableError.of("results.no_elastic_line", why="its slope is not positive")
    except UnavailableError as error:
        return replace(pull, without_line=error.failure)
    slope, level = fit.estimate(1), float(fit.coefficients[0])
    return replace(
        pull,
        window=window,
        slope_estimate=slope,
        slope=slope.value,
        centre=float(x.mean()),
        level=level,
    )


def _select_new_strains(trace: Trace) -> Ints:
    """Return the samples of the loading up to a failure, without those of unloading loops.

    A loop ends where the displacement goes beyond that at which it began.
    """
    end = len(trace.time) if trace.failed_at is None else trace.failed_at + 1
    samples, farthest = [np.empty(0, dtype=np.intp)], -np.inf
    for branch in trace.branches:
        if branch.direction is Direction.UNLOADING or branch.start >= end:
            continue
        loading = np.arange(branch.start, min(branch.stop, end))
        displacement = trace.displacement[loading]
        displacement = kinds.compute_loading_sign(displacement) * displacement
        is_new = np.fmax.accumulate(displacement) > farthest
        samples.append(loading[int(np.argmax(is_new)) :] if is_new.any() else loading[:0])
        farthest = max(farthest, float(np.fmax.reduce(displacement)))
    return np.concatenate(samples)


def _estimate_noise(values: Floats) -> float:
    finite = values[~np.isnan(values)]
    return float(estimate_fast_noise(finite)) if len(finite) >= MIN_ELASTIC_SAMPLES else 0.0


def _average_blocks(strain: Floats, stress: Floats) -> tuple[Floats, Floats]:
    """Return means over at most 1000 blocks of the samples that have both strain and stress."""
    is_finite = ~np.isnan(strain) & ~np.isnan(stress)
    strain, stress = strain[is_finite], stress[is_finite]
    size = 1 + len(strain) // 1000
    count = size * (len(strain) // size)
    x, y = (values[:count].reshape(-1, size).mean(axis=1) for values in (strain, stress))
    return x, y


def _choose_elastic_part(strain: Floats, stress: Floats, choice: ElasticWindow) -> slice:
    """Choose the samples of the elastic line: a stated window, or the longest straight part."""
    if choice.start is None or choice.stop is None:
        return _find_longest_straight_part(strain, stress, choice.straight)
    scale = float(np.nanmax(stress)) if choice.of == "strength" else 1.0
    values = stress if choice.of == "strength" else strain
    above = values > choice.stop * scale
    if not above.any():
        raise UnavailableError.of("results.elastic_window_not_reached")
    return slice(int(np.argmax(values >= choice.start * scale)), int(np.argmax(above)))


def _find_longest_straight_part(strain: Floats, stress: Floats, min_correlation: float) -> slice:
    """Find the longest range of stress in which the curve is straight.

    The square of its correlation coefficient is at least `min_correlation`.

    One minus the square of the correlation coefficient is the normalised residual of slope
    determination by analysis of residuals (ASTM E3076; described by the package sdarr), which takes
    the window where it is smallest; the longest window within a limit depends less on noise. Ends
    are sought in steps of 1 % of the largest stress.
    """
    is_finite = ~np.isnan(strain) & ~np.isnan(stress)
    largest = float(np.nanmax(stress[is_finite])) if is_finite.any() else np.nan
    levels = np.arange(0.0, 1.0, 0.01) * largest
    reached = np.where(is_finite, stress, -np.inf)
    ends = np.array([int(np.argmax(reached >= level)) for level in levels])
    x, y = np.where(is_finite, strain, 0.0), np.where(is_finite, stress / largest, 0.0)
    x = x / np.abs(x).max(initial=1e-30)
    count, *sums = (
        np.concatenate([[0.0], np.cumsum(values)])[ends]
        for values in (is_finite.astype(np.float64), x, y, x * x, x * y, y * y)
    )
    # Over the samples from each start (rows) to each stop (columns).
    n, sx, sy, sxx, sxy, syy = (np.subtract.outer(x, x).T for x in (count, *sums))
    is_enough = n >= MIN_ELASTIC_SAMPLES
    n = np.where(is_enough, n, 1.0)
    spread = (sxx - sx * sx / n) * (syy - sy * sy / n)
    is_straight = (sxy - sx * sy / n) ** 2 >= min_correlation * spread
    shares = 0.01 * np.subtract.outer(np.arange(len(levels)), np.arange(len(levels))).T
    shares = np.where(is_enough & is_straight & (spread > 0.0), shares, -1.0)
    start, stop = np.unravel_index(int(np.argmax(shares)), shares.shape)
    if shares[start, stop] < MIN_ELASTIC_SHARE:
        why = f"no part over {MIN_ELASTIC_SHARE:.0%} of the largest stress is straight"
        raise UnavailableError.of("results.no_elastic_line", why=why)
    return slice(int(ends[start]), int(ends[stop]))


def find_gauge_length(sizes: Mapping[str, float]) -> float:
    """Return the gauge length that strain refers to, m: of an extensometer, or else between grips.

    Parameters
    ----------
    sizes : m, by the keys of the protocol

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
class TensionNumber:
    """A number of a pull, and the samples and errors on which it depends.

    Parameters
    ----------
    compute : the number of a pull
    period : first sample that it depends on, and the last one or the one after that
    has_line : whether it depends on the elastic line
    errors : further standard errors, by cause
    doubts : further reasons to doubt it
    """

    compute: Callable[[Pull], float]
    period: tuple[int, int]
    has_line: bool = True
    errors: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[Reason, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TensionResult(Kind):
    """A kind of result in stress and strain; without `needs_line`, also without an elastic line."""

    needs: ClassVar = Needs(branches=True, correction="elastic_line")
    needs_line: ClassVar = True

    @abstractmethod
    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the numbers of a pull, in the order of the outputs."""

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure each number, also with every input changed by its standard uncertainty."""
        pull = test.require(test.pull)
        if pull.without_line is not None and self.needs_line:
            raise UnavailableError(pull.without_line)
        for output, number in enumerate(self.list_numbers(test, pull)):
            yield self._measure_number(test, pull, number, output)

    def _measure_number(
        self, test: ReducedTest, pull: Pull, number: TensionNumber, output: int
    ) -> Result:
        value, errors, doubts = number.compute(pull), dict[str, float](), number.doubts
        for cause, changed_pull in _change_inputs(test, pull):
            change = number.compute(changed_pull) - value
            errors[cause] = float(np.hypot(errors.get(cause, 0.0), change))
        outcome = Estimate(value, 0.0, pull.slope_estimate.n)
        if number.compute is _read_slope:
            outcome = pull.slope_estimate
        elif number.has_line:
            steeper = replace(pull, slope=pull.slope + pull.slope_estimate.error)
            outcome = replace(outcome, error=abs(number.compute(steeper) - value))
        if number.has_line:
            doubts = (*_list_line_doubts(test, pull, number.compute), *doubts)
        start, stop = pull.time[np.minimum(number.period, len(pull.time) - 1)].tolist()
        errors |= number.errors
        period = start, stop
        return self.make_result(test, outcome, errors, output=output, period=period, doubts=doubts)


def _change_inputs(test: ReducedTest, pull: Pull) -> Iterator[tuple[str, Pull]]:
    """Yield the pull with each input changed by its standard uncertainty, by cause."""
    setup, sizes = test.setup, test.setup.sizes
    yield causes.SCALE_OF_FORCE, pull.scaled(stress=1.0 + test.raw_force.relative_error)
    yield causes.SCALE_OF_DISPLACEMENT, pull.scaled(strain=1.0 + test.displacement.relative_error)
    zero = test.raw_force.zero_error / compute_area(sizes)
    yield causes.ZERO_OF_FORCE, _add_stress(pull, np.full(len(pull.stress), zero))
    drift = test.raw_force.zero_drift * float(np.nanmax(np.abs(pull.stress)))
    for mode in compute_drift_modes(pull.time - pull.time[0], drift):
        yield causes.DRIFT_OF_ZERO, _add_stress(pull, mode)
    for name, by in setup.uncertainties.items():
        if name not in sizes:
            continue
        larger = {**sizes, name: sizes[name] + by}
        cause = causes.LENGTH if name in ("length", "gauge_length") else causes.SECTION
        area, length = compute_area(sizes) / compute_area(larger), find_gauge_length(sizes)
        yield cause, pull.scaled(area, length / find_gauge_length(larger))
    # Of the read-out; the elastic line has its own error.
    yield causes.NOISE, replace(pull, stress=pull.stress + pull.noise)
    yield causes.NOISE_OF_DISPLACEMENT, replace(pull, strain=pull.strain + pull.strain_noise)


def _add_stress(pull: Pull, by: Floats) -> Pull:
    """Return the pull with a stress added to every sample, and the elastic line of its window."""
    x, y = _average_blocks(pull.strain[pull.window], by[pull.window])
    change, shift = np.polyfit(x - x.mean(), y, 1) if len(x) else (0.0, 0.0)
    stress, slope, level = pull.stress + by, pull.slope + change, pull.level + shift
    return replace(pull, stress=stress, slope=slope, level=level)


def _list_line_doubts(test: ReducedTest, pull: Pull, number: Number) -> Iterator[Reason]:
    """Yield doubts about an elastic line, and about the displacement from which it is computed.

    The line is doubtful if it bends, or if the curve later rises above it. Both occur if an
    extensometer slips or jumps, or if the specimen is bent: metals do not stiffen. A line in a
    stated window is right by definition, and is not examined. Without an extensometer, the
    displacement may be that of the machine. With one, the extension must not exceed the travel of
    the machine, as the gauge length lies between the grips: else a unit may be wrong.
    """
    if pull.is_straight:
        strain, stress = (values[pull.window] for values in (pull.strain, pull.stress))
        is_upper, halves = stress > 0.5 * (np.nanmin(stress) + np.nanmax(stress)), list[float]()
        for half_mask in (~is_upper, is_upper):
            x, y = _average_blocks(strain[half_mask], stress[half_mask])
            slope, centre, level = float(np.polyfit(x, y, 1)[0]), float(x.mean()), float(y.mean())
            halves.append(number(replace(pull, slope=slope, centre=centre, level=level)))
        value, change = number(pull), halves[1] - halves[0]
        limit = MAX_BEND if value == pull.slope else MAX_CHANGE_BY_BEND
        if abs(change) > limit * abs(value):
            yield Reason.of("results.elastic_line_bends", change=change / value)
        tail = slice(pull.window.stop, max(pull.peak, pull.window.stop) + 1)
        largest = float(np.fmax.reduce(_compute_stress_above_line(pull)[tail], initial=-np.inf))
        if largest > max(6.0 * pull.noise, 0.01 * float(pull.stress[pull.window.stop - 1])):
            yield Reason.of("results.above_elastic_line", above=1e-6 * largest)
    travel, sizes = test.signals.raw.get("displacement"), test.setup.sizes
    length = find_gauge_length(sizes)
    if "gauge_length" not in sizes:
        yield from kinds.find_machine_compliance(test, pull.slope * compute_area(sizes) / length)
    elif travel is not None:
        last = int(np.nanargmax(pull.strain))
        extension = 1e3 * length * float(pull.strain[last] - np.nanmin(pull.strain))
        path = np.interp(pull.time[: last + 1], travel.time, travel.values)
        range_mm = 1e3 * float(np.ptp(path))
        if extension > MAX_EXTENSION * range_mm > 0.0:
            yield Reason.of(
                "results.extension_exceeds_travel", extension=extension, travel=range_mm
            )


def _find_strain_jump(pull: Pull, stop: int) -> tuple[Reason, ...]:
    """Return a doubt about a jump of the strain before a sample, as of a knife edge that slips."""
    known_samples = np.flatnonzero(~np.isnan(pull.strain[: stop + 1]))
    samples = np.diff(known_samples)
    steps = np.diff(pull.strain[known_samples]) / samples  # per sample, so that a gap is no jump
    if len(steps) < MIN_ELASTIC_SAMPLES:
        return ()
    # Medians of the five steps before and after each: the speed may change there.
    medians = np.median(sliding_window_view(np.pad(steps, 6, "edge"), 5), axis=1)
    usual = np.stack([medians[1 : 1 + len(steps)], medians[7 : 7 + len(steps)]])
    jumps = np.abs(steps - usual).min(axis=0) * samples
    clear = max(MIN_STRAIN_JUMP, 6.0 * pull.strain_noise)
    is_jump = jumps > np.maximum(clear, 3.0 * np.abs(usual).max(axis=0))
    if not is_jump.any():
        return ()
    place = int(np.argmax(np.where(is_jump, jumps, 0.0)))
    jump = float(steps[place] * samples[place])
    stress = 1e-6 * float(pull.stress[known_samples[place]])
    return (Reason.of("results.strain_jumps", jump=jump, stress=stress),)


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticModulus(TensionResult):
    """``elastic_modulus`` (Pa): slope of the elastic line."""

    result: ClassVar = "elastic-modulus"
    outputs: ClassVar = (Output("elastic_modulus", "Pa", "Modulus of elasticity"),)

    def list_methods(self, test: ReducedTest) -> tuple[str]:
        """State the range of stress of the elastic line."""
        if not isinstance(test.pull, Pull) or test.pull.without_line is not None:
            return ("slope of the elastic line",)
        stress = test.pull.stress[test.pull.window]
        low, high = 1e-6 * float(np.nanmin(stress)), 1e-6 * float(np.nanmax(stress))
        return (f"slope of the elastic line from {low:.4g} to {high:.4g} MPa",)

    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the slope of the elastic line, whose residuals may be correlated."""
        del test
        window, doubts = pull.window, _find_strain_jump(pull, pull.window.stop)
        return [TensionNumber(_read_slope, (window.start, window.stop), doubts=doubts)]

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure the slope, and return the line for figures."""
        yield from super(ElasticModulus, self).measure(test)
        pull = test.require(test.pull)
        path = test.required_curve.displacement[_select_new_strains(make_trace(test))[pull.window]]
        low, high = (float(end(path)) for end in (np.nanmin, np.nanmax))
        strain = float(np.nanmin(pull.strain[pull.window]))
        area, length = compute_area(test.setup.sizes), find_gauge_length(test.setup.sizes)
        level = area * (pull.level + pull.slope * (strain - pull.centre))
        slope = pull.slope * area / length
        yield FittedLine("elastic_modulus", slope, level, low, high)


def _read_slope(pull: Pull) -> float:
    return pull.slope


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofStress(TensionResult):
    """``<name>`` (Pa): stress where the curve meets the elastic line shifted by a strain."""

    result: ClassVar = "proof-stress"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    method: ClassVar = "stress where the curve meets the elastic line shifted by {offset:.2%}"
    offset: Annotated[Fraction, "Plastic strain, such as 0.2 %"]
    name: Annotated[Snake, "Such as proof_stress_0_2"] = "proof_stress"

    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the stress at which the curve falls below the shifted elastic line."""
        del test

        def interpolate(pull: Pull) -> float:
            sample = _find_meeting_sample(pull, self.offset)
            above, below = _compute_stress_above_line(pull, self.offset)[sample - 1 : sample + 1]
            return float(np.interp(0.0, [below, above], pull.stress[[sample, sample - 1]]))

        crossing = _find_meeting_sample(pull, self.offset)
        doubts = _find_strain_jump(pull, crossing)
        return [TensionNumber(interpolate, (pull.window.start, crossing), doubts=doubts)]


def _compute_stress_above_line(pull: Pull, offset: float = 0.0) -> Floats:
    """Return the stress above the elastic line shifted by a strain, Pa, of every sample."""
    return pull.stress - pull.slope * (pull.strain - pull.toe - offset)


def _find_meeting_sample(pull: Pull, offset: float) -> int:
    """Find the first sample after the window that is on or below the line shifted by a strain."""
    below = _compute_stress_above_line(pull, offset) <= 0.0
    below[: pull.window.stop] = False
    if not below.any():
        last = np.nanmax(pull.strain) - pull.toe
        raise UnavailableError.of("results.offset_not_reached", offset=offset, last=last)
    return int(np.argmax(below))


@dataclass(frozen=True, slots=True, kw_only=True)
class YieldStress(TensionResult):
    """``upper_yield_stress`` and ``lower_yield_stress`` (Pa): of a curve that falls at yield."""

    result: ClassVar = "yield-stress"
    outputs: ClassVar = (
        Output("upper_yield_stress", "Pa", "Upper yield strength"),
        Output("lower_yield_stress", "Pa", "Lower yield strength"),
    )
    methods: ClassVar = (
        "largest stress before the first fall of the force after the elastic line",
        "smallest stress until the upper yield stress is reached again, first trough left out",
    )

    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the stress at the first fall, and the lowest stress while it yields."""
        del test
        return [
            TensionNumber(partial(_read_stress, sample=sample), (sample, sample), has_line=False)
            for sample in _find_yield_samples(pull)
        ]


def _read_stress(pull: Pull, sample: int) -> float:
    return float(pull.stress[sample])


def _find_yield_samples(pull: Pull) -> tuple[int, int]:
    """Find the samples of the upper and of the lower yield stress.

    The stress falls if it is below its largest value so far by more than six standard deviations of
    noise and a thousandth of the peak. The fall is a yield if it begins with little plastic strain,
    other than serrations of later flow, and if the stress before it is never reached again, or only
    with more plastic strain. After a slip of the grips or a pause, it is reached again without.
    """
    stress, peak, upper = pull.stress, pull.peak, pull.window.stop
    clear = max(6.0 * pull.noise, 1e-3 * float(stress[peak]))
    plastic = pull.strain - pull.toe - stress / pull.slope
    while upper < peak:
        until_peak = stress[upper : peak + 1]
        fallen = np.fmax.accumulate(until_peak) - until_peak > clear
        if not fallen.any():
            break
        upper += int(np.nanargmax(until_peak[: int(np.argmax(fallen))]))
        again = np.flatnonzero(stress[upper + 1 : peak + 1] > stress[upper])
        stop = upper + 1 + int(again[0]) if len(again) else peak + 1
        if plastic[upper] > MAX_YIELD_ONSET:
            break
        if not len(again) or plastic[stop] - plastic[upper] > MIN_YIELD_STRAIN:
            return upper, upper + _find_trough(stress[upper:stop], clear)
        upper = stop
    raise UnavailableError.of("results.no_yield_point", clear=1e-6 * clear)


def _find_trough(plateau: Floats, clear: float) -> int:
    """Find the lowest stress of a plateau; a first trough is left out as a transient.

    It is one if the stress rises clearly after it, and falls again.
    """
    risen = plateau - np.fmin.accumulate(plateau) > clear
    start = int(np.argmax(risen)) if risen.any() else 0
    later_stress = plateau[start:]
    if start and np.nanmax(np.fmax.accumulate(later_stress) - later_stress) > clear:
        return start + int(np.nanargmin(later_stress))
    return int(np.nanargmin(plateau))


@dataclass(frozen=True, slots=True, kw_only=True)
class TensileStrength(TensionResult):
    """``tensile_strength`` (Pa): the largest force over the original area."""

    result: ClassVar = "tensile-strength"
    outputs: ClassVar = (Output("tensile_strength", "Pa", "Tensile strength", ("force",)),)
    method: ClassVar = "largest force over the original area"
    needs_line: ClassVar = False

    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the largest stress."""
        strength, period = partial(_read_stress, sample=pull.peak), (0, pull.peak)
        doubts = _find_end_at_peak(test, pull)
        return [TensionNumber(strength, period, has_line=False, doubts=doubts)]


def _find_end_at_peak(test: ReducedTest, pull: Pull) -> tuple[Reason, ...]:
    """Return a doubt if the record ends without a break: the force may rise again."""
    if isinstance(test.failure, kinds.FailurePoint):
        return ()
    stress = pull.stress[~np.isnan(pull.stress)]
    return (Reason.of("results.ends_at_peak", share=float(stress[-1] / stress.max())),)


def _find_extensometer_end(test: ReducedTest, pull: Pull) -> tuple[Reason, ...]:
    """Return a doubt if the strain stops before the peak while the machine moves on.

    After the peak, a specimen may neck outside of the gauge length.
    """
    min_rate, part = 0.1, 0.1  # share of the mean rate, in the last part of the travel
    travel, stop = test.signals.raw.get("displacement"), pull.peak + 1
    if travel is None or "gauge_length" not in test.setup.sizes:
        return ()
    path, strain = np.interp(pull.time[:stop], travel.time, travel.values), pull.strain[:stop]
    path = np.abs(path - path[0])
    is_last = (path >= (1.0 - part) * path[-1]) & ~np.isnan(strain)
    if path[is_last].size < MIN_ELASTIC_SAMPLES or not np.ptp(path[is_last]) > 0.0:
        return ()
    rate = float(np.polyfit(path[is_last], strain[is_last], 1)[0])
    if rate >= min_rate * (np.nanmax(strain) - pull.toe) / path[-1]:
        return ()
    return (Reason.of("results.extension_stops", last=float(strain[is_last][-1]) - pull.toe),)


@dataclass(frozen=True, slots=True, kw_only=True)
class MaximumForceElongation(TensionResult):
    """``elongation_at_maximum_force`` and ``plastic_elongation_at_maximum_force`` (1)."""

    result: ClassVar = "elongation-at-maximum-force"
    outputs: ClassVar = (
        Output("elongation_at_maximum_force", "1", "Elongation at maximum force"),
        Output(
            "plastic_elongation_at_maximum_force",
            "1",
            "Plastic elongation at maximum force",
            can_be_negative=True,
        ),
    )
    methods: ClassVar = (
        "strain from the toe to the sample of the largest force",
        "strain from the toe to the sample of the largest force, less the stress over the modulus",
    )

    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the total and the plastic strain at the largest force.

        Noise may have made a neighbour of that sample the largest.
        """
        noise = _estimate_noise(pull.stress[max(pull.peak - 50, 0) : pull.peak + 50])
        is_near_peak = pull.stress >= pull.stress[pull.peak] - 2.0 * noise
        # The samples, from the first to the last, that noise may have made the largest.
        first, last = np.flatnonzero(is_near_peak)[[0, -1]].tolist()
        if np.isnan(pull.strain[[first, last]]).any():
            raise _make_extensometer_error(pull, "the largest force")
        ends = pull.strain[[first, last]] - pull.strain[pull.peak]
        # Root of the second moment about the sample, if every strain between the ends is as likely.
        spread = float(np.sqrt((ends @ ends + ends.prod()) / 3.0))
        period = pull.window.start, last + 1
        doubts = _find_end_at_peak(test, pull) + _find_extensometer_end(test, pull)
        return _list_elongations(pull.peak, period, {causes.PEAK: spread}, doubts)


def _list_elongations(
    sample: int,
    period: tuple[int, int],
    errors: Mapping[str, float],
    doubts: tuple[Reason, ...] = (),
) -> list[TensionNumber]:
    """Return the strain of a sample from the toe, with and without the elastic strain."""

    def strain(pull: Pull) -> float:
        return float(pull.strain[sample]) - pull.toe

    def plastic_strain(pull: Pull) -> float:
        return strain(pull) - float(pull.stress[sample]) / pull.slope

    numbers = strain, plastic_strain
    return [TensionNumber(number, period, errors=errors, doubts=doubts) for number in numbers]


def _make_extensometer_error(pull: Pull, what: str) -> UnavailableError:
    """Return the error for an extensometer that comes off before an event."""
    last = float(np.nanmax(pull.strain)) - pull.toe
    return UnavailableError.of("results.extensometer_off", what=what, last=last)


@dataclass(frozen=True, slots=True, kw_only=True)
class BreakElongation(TensionResult):
    """``elongation_at_break`` and ``plastic_elongation_at_break`` (1): at the last sample."""

    result: ClassVar = "elongation-at-break"
    outputs: ClassVar = (
        Output("elongation_at_break", "1", "Elongation at break"),
        Output(
            "plastic_elongation_at_break", "1", "Plastic elongation at break", can_be_negative=True
        ),
    )
    methods: ClassVar = (
        "strain from the toe to the last sample before the specimen parts",
        "strain from the toe to the last sample before the specimen parts, less the stress over "
        "the modulus",
    )

    def list_numbers(self, test: ReducedTest, pull: Pull) -> Sequence[TensionNumber]:
        """Return the total and the plastic strain at the last sample before the force is lost."""
        test.require(test.failure)
        last = len(pull.stress) - 1
        if np.isnan(pull.strain[last]):
            raise _make_extensometer_error(pull, "the break")
        # The break is as likely anywhere between this sample and the next one. That step is taken
        # to be as long as the one before.
        error = abs(float(np.diff(pull.strain[-2:])[0])) / np.sqrt(3.0)
        period, doubts = (pull.window.start, last), _find_extensometer_end(test, pull)
        return _list_elongations(last, period, {causes.STEP: error}, doubts)
