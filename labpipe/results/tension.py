"""Tension tests by stress and strain: modulus, proof and yield stress, strength, elongation.

Stress is force over the original area, strain is displacement over the gauge length. All numbers
refer to the elastic line: strain begins where that line meets zero stress (toe compensation).

**Uncertainty**: each number is computed again with every input changed by its standard uncertainty
(JCGM 100:2008, 5.1.3); the elastic line has an interval for correlated residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labpipe.records.arrays import Floats, Ints
from labpipe.records.causes import (
    LENGTH,
    NOISE,
    NOISE_OF_DISPLACEMENT,
    PEAK,
    SCALE_OF_DISPLACEMENT,
    SCALE_OF_FORCE,
    SECTION,
    STEP,
)
from labpipe.records.curve import Direction, FittedLine
from labpipe.records.declarations import CURVE, Needs, Output, Share, Snake
from labpipe.records.estimates import Estimate, Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.records.signals import Stretch
from labpipe.results.curve_replicates import make_trace
from labpipe.results.kinds import Computed, Kind
from labpipe.results.least_squares import require_samples
from labpipe.results.reduced_test import NO_LOADING, FailurePoint, ReducedTest, compute_loading_sign
from labpipe.uncertainty.autocorrelation import estimate_fast_noise
from labpipe.uncertainty.extractors import Trace
from labpipe.uncertainty.intervals import Measured
from labpipe.uncertainty.linear_fits import fit_linear

MIN_ELASTIC_SAMPLES = 8
MIN_ELASTIC_SHARE = 0.1
"""Least range of stress of an elastic line, as a share of the largest stress."""
MAX_BEND = 0.03
"""Difference of the slopes of both halves of an elastic line, beyond which it is doubtful."""
MAX_EXTENSION = 1.1
"""Extension of the gauge length over the travel of the machine, beyond which both are doubtful."""
MAX_YIELD_ONSET = 5e-3
"""Largest plastic strain at an upper yield stress."""
MIN_YIELD_STRAIN = 5e-4
"""Least plastic strain of a yield with a falling stress."""
MIN_STRAIN_JUMP = 1e-4
"""Smaller jumps of the strain are ignored."""
MAX_CHANGE_BY_BEND = 0.005
"""Difference of another number with the lines of both halves, beyond which it is doubtful."""


@dataclass(frozen=True, slots=True)
class ElasticWindow:
    """Part of the curve that the elastic line is fitted to.

    Parameters
    ----------
    start, stop : ends of a stated window; None for the longest straight part
    of : what a stated window is counted in: strain, or share of the largest stress
    straight : least square of the correlation coefficient of the longest straight part
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
    without_line : why there is no elastic line; None with one
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
        """Return the pull with stress and strain multiplied by factors."""
        return replace(
            self,
            strain=strain * self.strain,
            stress=stress * self.stress,
            slope=self.slope * stress / strain,
            centre=strain * self.centre,
            level=stress * self.level,
        )


Number: TypeAlias = Callable[[Pull], float]


def fit_pull(test: ReducedTest, choice: ElasticWindow) -> Pull | Failure:
    """Compute stress and strain of the first loading, and fit the elastic line.

    Parameters
    ----------
    test : with a curve, and the sizes of the specimen
    choice : the part of the elastic line

    Returns
    -------
    The pull; a failure without a loading, an area, a gauge length or a straight part.
    """
    return return_failure(_pull)(test, choice)


def _pull(test: ReducedTest, choice: ElasticWindow) -> Pull:
    trace = make_trace(test)
    part = _select_new_strains(trace)
    if len(part) < 2:
        raise test.make_error(NO_LOADING)
    sizes = test.setup.sizes
    force, displacement = trace.force[part], trace.displacement[part]
    stress = compute_loading_sign(force) * force / compute_area(sizes)
    first = displacement[~np.isnan(displacement)][:1].sum()
    if isinstance(test.slack, Measured):
        first = 0.0  # the displacement is counted from where the specimen is taut
    strain = compute_loading_sign(displacement) * (displacement - first) / find_gauge_length(sizes)
    pull = Pull(
        time=trace.time[part],
        strain=strain,
        stress=stress,
        window=slice(0, 0),
        is_straight=choice.start is None,
        noise=_noise(stress),
        strain_noise=_noise(strain),
    )
    line = return_failure(_add_elastic_line)(pull, choice)
    return replace(pull, without_line=line) if isinstance(line, Failure) else line


def _add_elastic_line(pull: Pull, choice: ElasticWindow) -> Pull:
    window = _straight_part(pull.strain, pull.stress, choice)
    x, y = _few_samples(pull.strain[window], pull.stress[window])
    require_samples(len(x), MIN_ELASTIC_SAMPLES, " of the elastic line")
    fit = fit_linear(np.column_stack([np.ones_like(x), x - x.mean()]), y)
    slope = fit.estimate(1)
    if slope.value <= 0.0:
        raise UnavailableError.of("results.no_elastic_line", why="its slope is not positive")
    return replace(
        pull,
        slope_estimate=slope,
        slope=slope.value,
        centre=float(x.mean()),
        level=float(fit.coefficients[0]),
        window=window,
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
        displacement = compute_loading_sign(displacement) * displacement
        is_new = np.fmax.accumulate(displacement) > farthest
        samples.append(loading[int(np.argmax(is_new)) :] if is_new.any() else loading[:0])
        farthest = max(farthest, float(np.fmax.reduce(displacement)))
    return np.concatenate(samples)


def _noise(values: Floats) -> float:
    finite = values[~np.isnan(values)]
    return float(estimate_fast_noise(finite)) if len(finite) >= MIN_ELASTIC_SAMPLES else 0.0


def _few_samples(strain: Floats, stress: Floats) -> tuple[Floats, Floats]:
    """Return means over blocks of samples, at most 1000 of them."""
    is_finite = ~np.isnan(strain) & ~np.isnan(stress)
    strain, stress = strain[is_finite], stress[is_finite]
    size = 1 + len(strain) // 1000
    count = size * (len(strain) // size)
    x, y = (values[:count].reshape(-1, size).mean(axis=1) for values in (strain, stress))
    return x, y


def _straight_part(strain: Floats, stress: Floats, choice: ElasticWindow) -> slice:
    """Find the samples of the elastic line."""
    largest = float(np.nanmax(stress))
    if choice.start is None or choice.stop is None:
        return _longest_straight(strain, stress, choice.straight)
    if choice.of == "strength":
        return _between(stress, choice.start * largest, choice.stop * largest)
    return _between(strain, choice.start, choice.stop)


def _between(values: Floats, low: float, high: float) -> slice:
    """Return the samples from the first one at `low` to the first one above `high`."""
    above = values > high
    if not above.any():
        raise UnavailableError.of("results.elastic_window_not_reached")
    return slice(int(np.argmax(values >= low)), int(np.argmax(above)))


def _longest_straight(strain: Floats, stress: Floats, straight: float) -> slice:
    """Find the longest range of stress whose least-squares line has a correlation of `straight`.

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
    n, sx, sy, sxx, sxy, syy = (
        np.subtract.outer(total, total).T for total in (count, *sums)
    )  # [start, stop]
    enough = n >= MIN_ELASTIC_SAMPLES
    n = np.where(enough, n, 1.0)
    spread = (sxx - sx * sx / n) * (syy - sy * sy / n)
    correlated = (sxy - sx * sy / n) ** 2 >= straight * spread
    shares = 0.01 * np.subtract.outer(np.arange(len(levels)), np.arange(len(levels))).T
    shares = np.where(enough & correlated & (spread > 0.0), shares, -1.0)
    start, stop = np.unravel_index(int(np.argmax(shares)), shares.shape)
    if shares[start, stop] < MIN_ELASTIC_SHARE:
        why = f"no part over {MIN_ELASTIC_SHARE:.0%} of the largest stress is straight"
        raise UnavailableError.of("results.no_elastic_line", why=why)
    return slice(int(ends[start]), int(ends[stop]))


def compute_area(sizes: Mapping[str, float]) -> float:
    """Return the original area of a specimen from the sizes that are stated, m^2.

    Parameters
    ----------
    sizes : m (the area m^2), by the keys of the protocol; of several, a stated area counts, then
        width and thickness, then the diameters

    Raises
    ------
    UnavailableError
        ``no_area`` without a complete set of sizes.
    """
    match sizes:
        case {"area": area}:
            return area
        case {"width": width, "thickness": thickness}:
            return width * thickness
        case {"outer_diameter": outer, "inner_diameter": inner}:
            return 0.25 * np.pi * (outer**2 - inner**2)
        case {"outer_diameter": outer, "wall": wall}:
            return np.pi * (outer - wall) * wall
        case {"outer_diameter": outer}:
            return 0.25 * np.pi * outer**2
    missing = "specimen.section.area, or its width and thickness, or outer_diameter"
    raise UnavailableError.of("results.no_area", missing=missing)


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


def _changed_inputs(test: ReducedTest, pull: Pull) -> Iterator[tuple[str, Pull]]:
    """Yield the pull with each input changed by its standard uncertainty, by cause."""
    setup, sizes = test.setup, test.setup.sizes
    yield SCALE_OF_FORCE, pull.scaled(stress=1.0 + test.raw_force.relative_error)
    yield SCALE_OF_DISPLACEMENT, pull.scaled(strain=1.0 + test.displacement.relative_error)
    for name, by in setup.uncertainties.items():
        if name not in sizes:
            continue
        larger = {**sizes, name: sizes[name] + by}
        cause = LENGTH if name in ("length", "gauge_length") else SECTION
        area, length = compute_area(sizes) / compute_area(larger), find_gauge_length(sizes)
        yield cause, pull.scaled(area, length / find_gauge_length(larger))
    # Of the read-out; the elastic line has its own error.
    yield NOISE, replace(pull, stress=pull.stress + pull.noise)
    yield NOISE_OF_DISPLACEMENT, replace(pull, strain=pull.strain + pull.strain_noise)


def _measured(
    test: ReducedTest, pull: Pull, number: Number, *, error: float | None = None
) -> tuple[Estimate, dict[str, float]]:
    """Measure a number of a pull, with its standard error by cause.

    Parameters
    ----------
    error : of the number by the elastic line; None if it is computed with another slope
    """
    value, errors = number(pull), dict[str, float]()
    for cause, changed in _changed_inputs(test, pull):
        errors[cause] = float(np.hypot(errors.get(cause, 0.0), number(changed) - value))
    if error is None:
        steeper = replace(pull, slope=pull.slope + pull.slope_estimate.error)
        error = abs(number(steeper) - value)
    return Estimate(value, error, pull.slope_estimate.n), errors


@dataclass(frozen=True, slots=True, kw_only=True)
class TensionResult(Kind):
    """A kind of result in stress and strain, of a curve with an elastic line."""

    needs: ClassVar = Needs(branches=True, correction="elastic_line")
    needs_line: ClassVar = True

    def pull(self, test: ReducedTest) -> Pull:
        """Return the pull of a test.

        Raises
        ------
        UnavailableError
            If the test has none.
        """
        if isinstance(test.pull, Failure):
            raise UnavailableError(test.pull)
        if test.pull is None:
            raise test.make_error(NO_LOADING)
        if test.pull.without_line is not None and self.needs_line:
            raise UnavailableError(test.pull.without_line)
        return test.pull

    def list_doubts(self, test: ReducedTest, pull: Pull, number: Number) -> tuple[Reason, ...]:
        """Return doubts about a number by the elastic line, or by a displacement of the machine."""
        doubts = *_doubts_of_line(pull, number), *_doubts_of_extension(test, pull)
        return doubts + self._doubts_of_machine(test, pull)

    def _doubts_of_machine(self, test: ReducedTest, pull: Pull) -> tuple[Reason, ...]:
        """Return a doubt about a displacement that may be that of frame and grips."""
        limits, sizes = test.setup.limits, test.setup.sizes
        stiffness = pull.slope * compute_area(sizes) / find_gauge_length(sizes)
        share = limits.machine_compliance * stiffness
        if "gauge_length" in sizes or test.setup.compliance_stated or share <= limits.machine_share:
            return ()
        usual = 1e6 * limits.machine_compliance
        return (Reason.of("results.machine_compliance", usual=usual, share=share),)


def _doubts_of_line(pull: Pull, number: Number) -> Iterator[Reason]:
    """Yield doubts about an elastic line that bends, or that the curve later rises above.

    Both occur if an extensometer slips or jumps, or if the specimen is bent: metals do not stiffen.
    A line in a stated window is right by definition.
    """
    if not pull.is_straight:
        return
    lower, upper = (number(half) for half in _with_half_lines(pull))
    value, change = number(pull), upper - lower
    limit = MAX_BEND if value == pull.slope else MAX_CHANGE_BY_BEND
    if abs(change) > limit * abs(value):
        yield Reason.of("results.elastic_line_bends", change=change / value)
    later = slice(pull.window.stop, max(pull.peak, pull.window.stop) + 1)
    above = pull.stress[later] - pull.slope * (pull.strain[later] - pull.toe)
    largest = float(np.fmax.reduce(above, initial=-np.inf))
    if largest > max(6.0 * pull.noise, 0.01 * float(pull.stress[pull.window.stop - 1])):
        yield Reason.of("results.above_elastic_line", above=1e-6 * largest)


def _doubts_of_extension(test: ReducedTest, pull: Pull) -> Iterator[Reason]:
    """Yield a doubt about an extension that is larger than the travel of the machine.

    The gauge length lies between the grips: one of both channels, or a unit, is wrong.
    """
    travel, sizes = test.signals.raw.get("displacement"), test.setup.sizes
    if travel is None or "gauge_length" not in sizes:
        return
    last = int(np.nanargmax(pull.strain))
    extension = find_gauge_length(sizes) * float(pull.strain[last] - np.nanmin(pull.strain))
    moved = float(np.ptp(np.interp(pull.time[: last + 1], travel.time, travel.values)))
    if extension > MAX_EXTENSION * moved > 0.0:
        extension, moved = 1e3 * extension, 1e3 * moved
        yield Reason.of("results.extension_exceeds_travel", extension=extension, travel=moved)


def _jump_of_strain(pull: Pull, stop: int) -> tuple[Reason, ...]:
    """Return a doubt about a jump of the strain before a sample, as of a knife edge that slips."""
    strain = pull.strain[: stop + 1]
    steps = np.diff(strain[~np.isnan(strain)])
    if len(steps) < MIN_ELASTIC_SAMPLES:
        return ()
    # Medians of the five steps before and after each: the speed may change there.
    medians = np.median(sliding_window_view(np.pad(steps, 6, "edge"), 5), axis=1)
    usual = np.stack([medians[1 : 1 + len(steps)], medians[7 : 7 + len(steps)]])
    jumps = np.abs(steps - usual).min(axis=0)
    clear = max(MIN_STRAIN_JUMP, 6.0 * pull.strain_noise)
    is_jump = jumps > np.maximum(clear, 3.0 * np.abs(usual).max(axis=0))
    if not is_jump.any():
        return ()
    place = int(np.argmax(np.where(is_jump, jumps, 0.0)))
    facts = float(steps[place]), 1e-6 * float(pull.stress[place])
    return (Reason.of("results.strain_jumps", jump=facts[0], stress=facts[1]),)


def _with_half_lines(pull: Pull) -> Iterator[Pull]:
    """Yield the pull with the line of the lower and of the upper half of its elastic line."""
    strain, stress = (values[pull.window] for values in (pull.strain, pull.stress))
    is_upper = stress > 0.5 * (np.nanmin(stress) + np.nanmax(stress))
    for half in (~is_upper, is_upper):
        x, y = _few_samples(strain[half], stress[half])
        slope = float(np.polyfit(x, y, 1)[0])
        yield replace(pull, slope=slope, centre=float(x.mean()), level=float(y.mean()))


def _during(pull: Pull, start: int, stop: int) -> Stretch:
    return float(pull.time[start]), float(pull.time[min(stop, len(pull.time) - 1)])


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

    def measure(self, test: ReducedTest) -> Computed:
        """Return the slope of the elastic line, whose residuals may be correlated."""
        pull = self.pull(test)
        _, errors = _measured(test, pull, _slope, error=0.0)
        window = pull.window
        number = self.make_result(
            test,
            pull.slope_estimate,
            errors,
            during=_during(pull, window.start, window.stop),
            doubts=self.list_doubts(test, pull, _slope) + _jump_of_strain(pull, window.stop),
        )
        return Computed((number,), lines=(_drawn_line(test, pull),))


def _slope(pull: Pull) -> float:
    return pull.slope


def _drawn_line(test: ReducedTest, pull: Pull) -> FittedLine:
    sizes, curve = test.setup.sizes, test.required_curve
    part = _select_new_strains(make_trace(test))
    window = curve.displacement[part][pull.window]
    low, high = float(np.nanmin(window)), float(np.nanmax(window))
    strain = float(np.nanmin(pull.strain[pull.window]))
    level = compute_area(sizes) * (pull.level + pull.slope * (strain - pull.centre))
    slope = pull.slope * compute_area(sizes) / find_gauge_length(sizes)
    return FittedLine("elastic_modulus", slope, level, low, high)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofStress(TensionResult):
    """``<name>`` (Pa): stress where the curve meets the elastic line shifted by a strain."""

    result: ClassVar = "proof-stress"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    method: ClassVar = "stress where the curve meets the elastic line shifted by {offset:.2%}"
    offset: Annotated[Share, "Plastic strain, such as 0.2 %"]
    name: Annotated[Snake, "Such as proof_stress_0_2"] = "proof_stress"

    def measure(self, test: ReducedTest) -> Computed:
        """Find where the curve falls below the shifted elastic line."""
        pull = self.pull(test)
        number = partial(_crossing, offset=self.offset)
        crossing = _meeting_sample(pull, self.offset)
        outcome, errors = _measured(test, pull, number)
        during = _during(pull, pull.window.start, crossing)
        doubts = self.list_doubts(test, pull, number) + _jump_of_strain(pull, crossing)
        return Computed((self.make_result(test, outcome, errors, during=during, doubts=doubts),))


def _above_shifted_line(pull: Pull, offset: float) -> Floats:
    return pull.stress - pull.slope * (pull.strain - pull.toe - offset)


def _meeting_sample(pull: Pull, offset: float) -> int:
    """Find the first sample on or below the elastic line shifted by a strain."""
    below = _above_shifted_line(pull, offset) <= 0.0
    below[: pull.window.stop] = False
    if not below.any():
        last = np.nanmax(pull.strain) - pull.toe
        raise UnavailableError.of("results.offset_not_reached", offset=offset, last=last)
    return int(np.argmax(below))


def _crossing(pull: Pull, offset: float) -> float:
    """Interpolate the stress on the elastic line shifted by a strain."""
    after = _meeting_sample(pull, offset)
    above = _above_shifted_line(pull, offset)
    share = float(above[after - 1] / (above[after - 1] - above[after]))
    return float(pull.stress[after - 1] + share * (pull.stress[after] - pull.stress[after - 1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class YieldStress(TensionResult):
    """``upper_yield_stress`` and ``lower_yield_stress`` (Pa): of a curve that falls at yield."""

    result: ClassVar = "yield-stress"
    outputs: ClassVar = (
        Output("upper_yield_stress", "Pa", "Upper yield strength"),
        Output("lower_yield_stress", "Pa", "Lower yield strength"),
    )

    def list_methods(self, test: ReducedTest) -> tuple[str, str]:
        """State the definitions."""
        del test
        return (
            "largest stress before the first fall of the force after the elastic line",
            "smallest stress until the upper yield stress is reached again, first trough left out",
        )

    def measure(self, test: ReducedTest) -> Computed:
        """Find the first fall of the stress, and the lowest stress while it yields."""
        pull = self.pull(test)
        upper, lower = _yield_samples(pull)
        numbers = []
        for place, sample in enumerate((upper, lower)):
            number = partial(_stress_at, sample=sample)
            outcome, errors = _measured(test, pull, number, error=0.0)
            numbers.append(
                self.make_result(
                    test,
                    outcome,
                    errors,
                    output=place,
                    during=_during(pull, sample, sample),
                )
            )
        return Computed(tuple(numbers))


def _stress_at(pull: Pull, sample: int) -> float:
    return float(pull.stress[sample])


def _yield_samples(pull: Pull) -> tuple[int, int]:
    """Find the samples of the upper and of the lower yield stress.

    The stress falls if it is below its largest value so far by more than noise and a thousandth.
    It is a yield if it begins with little plastic strain, other than serrations of later flow, and
    if the stress is reached again with more: after a slip of the grips or a pause it is not.
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

    def measure(self, test: ReducedTest) -> Computed:
        """Return the largest stress."""
        pull = self.pull(test)
        number: Number = lambda pull: float(np.nanmax(pull.stress))  # noqa: E731
        outcome, errors = _measured(test, pull, number, error=0.0)
        during, doubts = _during(pull, 0, pull.peak), _ends_at_peak(test, pull)
        return Computed((self.make_result(test, outcome, errors, during=during, doubts=doubts),))


def _ends_at_peak(test: ReducedTest, pull: Pull) -> tuple[Reason, ...]:
    """Return a doubt if the record ends without a break: the force may rise again."""
    if isinstance(test.failure, FailurePoint):
        return ()
    stress = pull.stress[~np.isnan(pull.stress)]
    return (Reason.of("results.ends_at_peak", share=float(stress[-1] / stress.max())),)


@dataclass(frozen=True, slots=True, kw_only=True)
class MaximumForceElongation(TensionResult):
    """``elongation_at_maximum_force`` and ``plastic_elongation_at_maximum_force`` (1)."""

    result: ClassVar = "elongation-at-maximum-force"
    outputs: ClassVar = (
        Output("elongation_at_maximum_force", "1", "Elongation at maximum force", CURVE),
        Output(
            "plastic_elongation_at_maximum_force",
            "1",
            "Plastic elongation at maximum force",
            CURVE,
            can_be_negative=True,
        ),
    )

    def list_methods(self, test: ReducedTest) -> tuple[str, str]:
        """State the definitions."""
        del test
        total = "strain from the toe to the sample of the largest force"
        return total, f"{total}, less the stress over the modulus"

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the strain at the largest force; noise may have chosen a neighbour of it."""
        pull = self.pull(test)
        peak, top = pull.peak, _flat_top(pull)
        if np.isnan(pull.strain[[top.start, top.stop - 1]]).any():
            raise _off_before(pull, "the largest force")
        ends = pull.strain[[top.start, top.stop - 1]] - pull.strain[peak]
        # The second moment about the sample, if every strain between the ends is as likely.
        spread = float(np.sqrt((ends @ ends + ends.prod()) / 3.0))
        numbers = []
        for place, is_plastic in enumerate((False, True)):
            number = partial(_strain_at, sample=peak, is_plastic=is_plastic)
            outcome, errors = _measured(test, pull, number)
            numbers.append(
                self.make_result(
                    test,
                    outcome,
                    errors | {PEAK: spread},
                    output=place,
                    during=_during(pull, pull.window.start, top.stop),
                    doubts=self.list_doubts(test, pull, number) + _ends_at_peak(test, pull),
                )
            )
        return Computed(tuple(numbers))


def _flat_top(pull: Pull) -> slice:
    """Return the samples, from the first to the last, that noise may have made the largest."""
    around = slice(max(pull.peak - 50, 0), pull.peak + 50)
    is_near_peak = pull.stress >= pull.stress[pull.peak] - 2.0 * _noise(pull.stress[around])
    near_peak = np.flatnonzero(is_near_peak)
    return slice(int(near_peak[0]), int(near_peak[-1]) + 1)


def _strain_at(pull: Pull, sample: int, *, is_plastic: bool) -> float:
    """Return the strain of a sample from the toe, with or without the elastic strain."""
    strain = float(pull.strain[sample]) - pull.toe
    return strain - float(pull.stress[sample]) / pull.slope if is_plastic else strain


def _off_before(pull: Pull, what: str) -> UnavailableError:
    """Return the error for an extensometer that comes off before an event."""
    last = float(np.nanmax(pull.strain)) - pull.toe
    return UnavailableError.of("results.extensometer_off", what=what, last=last)


@dataclass(frozen=True, slots=True, kw_only=True)
class BreakElongation(TensionResult):
    """``elongation_at_break`` and ``plastic_elongation_at_break`` (1): at the last sample."""

    result: ClassVar = "elongation-at-break"
    outputs: ClassVar = (
        Output("elongation_at_break", "1", "Elongation at break", CURVE),
        Output(
            "plastic_elongation_at_break",
            "1",
            "Plastic elongation at break",
            CURVE,
            can_be_negative=True,
        ),
    )

    def list_methods(self, test: ReducedTest) -> tuple[str, str]:
        """State the definitions."""
        del test
        total = "strain from the toe to the last sample before the specimen parts"
        return total, f"{total}, less the stress over the modulus"

    def measure(self, test: ReducedTest) -> Computed:
        """Measure the strain at the last sample before the force is lost."""
        pull = self.pull(test)
        if isinstance(test.failure, Failure):
            raise UnavailableError(test.failure)
        if not isinstance(test.failure, FailurePoint):
            raise test.make_error(NO_LOADING)
        last = len(pull.stress) - 1
        if np.isnan(pull.strain[last]):
            raise _off_before(pull, "the break")
        # The break is as likely anywhere between this sample and the next one.
        step, numbers = float(np.diff(pull.strain[-2:])[0]), []
        for place, is_plastic in enumerate((False, True)):
            number = partial(_strain_at, sample=last, is_plastic=is_plastic)
            outcome, errors = _measured(test, pull, number)
            numbers.append(
                self.make_result(
                    test,
                    outcome,
                    errors | {STEP: abs(step) / np.sqrt(3.0)},
                    output=place,
                    during=_during(pull, pull.window.start, last),
                    doubts=self.list_doubts(test, pull, number),
                )
            )
        return Computed(tuple(numbers))
