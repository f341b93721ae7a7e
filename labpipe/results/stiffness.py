"""Stiffnesses of the first loading and of every cycle, and what is made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np

from labpipe.fits.cycle_stiffness import (
    LoadingSlope,
    loading_slope,
    unloading_slope,
    window_slope,
)
from labpipe.fits.least_squares import slope_of_line
from labpipe.fits.straight_lines import (
    MIN_LINE_SAMPLES,
    annulus_area,
    compliance_window,
    rectangle_area,
    thin_wall_area,
)
from labpipe.records.arrays import Floats, Ints, ratio, samples_of
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.declarations import (
    CURVE,
    Distance,
    Force,
    Key,
    LargerThan,
    Length,
    Needs,
    Output,
    Snake,
    StiffnessName,
)
from labpipe.records.estimates import Failure
from labpipe.records.quality import Reason
from labpipe.results.curve_replicates import loading_of, traced
from labpipe.results.cycles import (
    NO_UNLOADING,
    OfCycle,
    cut_short,
    cycle_of,
    on_branch,
    peak_of,
    sense_of,
)
from labpipe.results.kinds import (
    NO_CYCLE,
    NO_LOADING,
    CalibrationFit,
    Computed,
    Kind,
    blocked_or,
    marked_slips,
)
from labpipe.results.reduced_test import ReducedTest, Stiffness
from labpipe.uncertainty.extractors import Decide, Reading, Trace, combine
from labpipe.uncertainty.intervals import Measured


@dataclass(frozen=True, slots=True, kw_only=True)
class UnloadingStiffness(OfCycle):
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    outputs: ClassVar = (
        Output("unloading_stiffness", "N/m", "Unloading stiffness", CURVE, first=1),
    )
    over: Length
    reads: ClassVar = (1.0, 2.0)

    @property
    def method(self) -> str:
        """With its range."""
        return (
            f"line from {0.1 * self.over:g} m to {self.over:g} m off the peak, time as instrument"
        )

    def read(self, test: ReducedTest, trace: Trace, number: int) -> Reading | Failure:
        """Choose the samples at the start of the unloading branch, without its first tenth."""
        del test
        branches, d = cycle_of(trace, number), trace.displacement
        if len(branches) < 2:
            return NO_UNLOADING
        sense = sense_of(trace, d)
        fit = unloading_slope(trace.time, d, trace.force, branches[1], over=self.over, sense=sense)
        if isinstance(fit, Failure):
            return fit

        def numbers(trace: Trace) -> tuple[Floats]:
            return (fit.of(trace.displacement, trace.force),)

        return Reading(numbers, fit.slope.n)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadingStiffness(OfCycle):
    """``loading_stiffness.<cycle>`` (N/m): slope just after the force takes up."""

    result: ClassVar = "loading-stiffness"
    outputs: ClassVar = (Output("loading_stiffness", "N/m", "Loading stiffness", CURVE, first=1),)
    over: Length
    reads: ClassVar = (0.0, 1.0)

    @property
    def method(self) -> str:
        """With its range."""
        return f"line over {1e3 * self.over:g} mm from where the force takes up, time as instrument"

    def decide_cycle(self, test: ReducedTest, number: int) -> Decide:
        """Use the limit of zero force of the measured curve."""
        return partial(self.read, test, number=number, like=self._measured(test, number))

    def plain(self, test: ReducedTest, branches: list[Branch]) -> list[float] | None:
        """Return the number of the measured curve, taut from the first sample above noise."""
        fit = self._measured(test, branches[0].cycle)
        if fit is None:
            return None
        _, d, f = on_branch(traced(test), branches[0])
        return [float(fit.of(d, f))]

    def doubts(self, test: ReducedTest, number: int) -> tuple[Reason, ...]:
        """Return a doubt about samples at rest in the window, more than 10 %."""
        fit = self._measured(test, number)
        if fit is None or fit.share_at_rest <= 0.1:
            return ()
        message = (
            f"{fit.share_at_rest:.0%} of the samples were taken before the motion, as the force "
            f"at rest is further from zero than its noise of {fit.take_up.limit:.2g} N"
        )
        return (Reason("rest_in_window", message),)

    def _measured(self, test: ReducedTest, number: int) -> LoadingSlope | None:
        curve = traced(test)
        fit = loading_slope(*on_branch(curve, cycle_of(curve, number)[0]), over=self.over)
        return None if isinstance(fit, Failure) else fit

    def read(
        self, test: ReducedTest, trace: Trace, number: int, like: LoadingSlope | None = None
    ) -> Reading | Failure:
        """Choose the samples of the range after the take-up."""
        del test
        part = cycle_of(trace, number)[0]
        parts, steps = on_branch(trace, part), trace.steps
        fit = loading_slope(*parts, over=self.over, like=like, steps=steps)
        if isinstance(fit, Failure):
            return fit
        branch = slice(part.start, part.stop)

        def numbers(trace: Trace) -> tuple[Floats]:
            return (fit.of(trace.displacement[..., branch], trace.force[..., branch]),)

        def in_noise(trace: Trace) -> tuple[Floats]:
            return (fit.of_each(trace.displacement[..., branch], trace.force[..., branch]),)

        return Reading(numbers, fit.slope.n, in_noise, is_cut=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardening(Kind):
    """``hardening.<cycle>`` (1): ``loading_stiffness`` of a later cycle over that of the first."""

    result: ClassVar = "hardening"
    outputs: ClassVar = (Output("hardening", "1", "Hardening", CURVE, first=2),)
    over: Length

    def compute(self, test: ReducedTest) -> Computed:
        """Compute the ratio to the first cycle; the scale cancels."""
        method = (
            f"slope over {1e3 * self.over:g} mm from the take-up / that of cycle 1, scale cancelled"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        stiffness, numbers = LoadingStiffness(over=self.over), []
        before = stiffness.decide_cycle(test, 1)
        first = test.measure(before)
        for later in test.cycles[1:]:
            number = later[0].cycle
            after = stiffness.decide_cycle(test, number)
            plain = [stiffness.plain(test, cycle) for cycle in (later, test.cycles[0])]
            values = [plain[0][0] / plain[1][0]] if plain[0] and plain[1] else None
            outcome = test.measure(combine(_hardened, after, partial(_first, before)), values)
            numbers.append(
                self.number(
                    _above_noise(first, outcome),
                    method,
                    doubts=(*stiffness.doubts(test, 1), *stiffness.doubts(test, number)),
                    during=(test.cycles[0][0].start_time, later[0].stop_time),
                    part=f".{number}",
                )
            )
        return Computed(tuple(numbers))


def _hardened(trace: Trace, after: Floats, before: Floats) -> Floats:
    del trace
    return ratio(after, before)


def _first(before: Decide, trace: Trace) -> Reading | Failure:
    """Choose the samples for the stiffness of the first cycle, or name it as missing."""
    reading = before(trace)
    if isinstance(reading, Failure):
        message = f"that of cycle 1 is not available: {reading.message}"
        return Failure("no_stiffness", message)
    return reading


def _above_noise(
    first: tuple[Measured, ...] | Failure, outcome: tuple[Measured, ...] | Failure
) -> Measured | Failure:
    """Return a ratio if the stiffness of the first cycle is above noise."""
    if isinstance(outcome, Failure):
        return outcome
    if isinstance(first, Failure):
        return first
    if first[0].value <= 3.0 * first[0].error:
        message = f"{first[0].value:.4g} N/m in cycle 1 is no more than noise"
        return Failure("no_stiffness", message)
    return outcome[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Window(Kind):
    """A kind of result from a range of displacement."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), LargerThan("start")]

    @property
    def in_words(self) -> str:
        """The range in millimetres."""
        return f"from {1e3 * self.start:g} mm to {1e3 * self.stop:g} mm"

    def inside(self, displacement: Floats) -> slice | Failure:
        """Return the samples from the first one at `start` to the last one before `stop`.

        Parameters
        ----------
        displacement : shape (n,), m, of a loading branch

        Returns
        -------
        The samples, or a failure ``not_reached``.
        """
        low, high = self.start, self.stop
        finite = displacement[~np.isnan(displacement)]
        if not len(finite) or finite.max() < high:
            reached = float(finite.max()) if len(finite) else float("nan")
            message = f"the branch reaches {1e3 * reached:.4g} mm, {1e3 * high:.4g} mm is needed"
            return Failure("not_reached", message)
        if finite[0] > low + 0.02 * (high - low):
            message = f"the branch begins at {1e3 * finite[0]:.4g} mm, {1e3 * low:.4g} mm is needed"
            return Failure("not_reached", message)
        stop = int(np.argmax(displacement > high)) or None
        return slice(int(np.argmax(displacement >= low)), stop)


def _secant_from_shape(kind: Window, test: ReducedTest, name: str) -> Computed:
    """Compute the slope between two displacements of a shape, with time as instrument."""
    method = (
        f"line from {kind.start:g} m to {kind.stop:g} m of the first loading, time as instrument"
    )
    if not test.cycles:
        return kind.not_available(blocked_or(test, NO_CYCLE), method)

    def decide(trace: Trace) -> Reading | Failure:
        return _secant(trace, kind.start, kind.stop)

    outcome = test.measure(decide)
    if isinstance(outcome, Failure):
        return kind.not_available(outcome, method)
    during, window = test.while_loading(kind.start, kind.stop), (kind.start, kind.stop)
    number = kind.number(outcome[0], method, during=during)
    return Computed((number,), {name: Stiffness(decide, outcome[0].as_estimate, during, window)})


def _secant(trace: Trace, low: float, high: float) -> Reading | Failure:
    """Choose the samples for the stiffness between two displacements of the first loading."""
    part = trace.branches[0]
    branch, (time, path, force) = slice(part.start, part.stop), on_branch(trace, part)
    fit = window_slope(time, path, force, path, low=low, high=high)
    if isinstance(fit, Failure):
        return fit

    def numbers(trace: Trace) -> tuple[Floats]:
        return (fit.of(trace.displacement[..., branch], trace.force[..., branch]),)

    middle = path[fit.window].mean()

    def in_noise(trace: Trace) -> tuple[Floats]:
        path, force = trace.displacement[..., branch], trace.force[..., branch]
        later = middle - path[..., fit.window].mean(axis=-1)
        return (fit.of(path, force, later),)

    return Reading(numbers, fit.n, in_noise, is_cut=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialStiffness(Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"
    outputs: ClassVar = (Output("initial_stiffness", "N/m", "Initial stiffness"),)

    def compute(self, test: ReducedTest) -> Computed:
        """Compute the slope between two displacements, with time as instrument."""
        return _secant_from_shape(self, test, "initial_stiffness")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStiffness(Window):
    """``<name>`` (N/m): straight line over a window of the first loading."""

    result: ClassVar = "stiffness"
    outputs: ClassVar = (Output("{name}", "N/m"),)
    name: Annotated[Snake, "Such as stiffness_first"] = "stiffness"

    def compute(self, test: ReducedTest) -> Computed:
        """Fit a least-squares line, with an interval for correlated noise."""
        if test.shape is not None:
            return _secant_from_shape(self, test, self.name)
        method = (
            f"straight line {self.in_words} of the first loading, interval for correlated noise"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        outcome, curve = test.measure(self.decide), traced(test)
        window = self.samples(curve)
        if isinstance(outcome, Failure):
            return self.not_available(outcome, method)
        if isinstance(window, Failure):
            return self.not_available(window, method)
        slope, d = outcome[0], curve.displacement[window]
        low, high = float(d.min()), float(d.max())
        level = float(curve.force[window].mean()) + slope.value * (low - float(d.mean()))
        during, doubts = test.while_loading(low, high), marked_slips(test, (low, high))
        if slope.value <= 0.0:
            falls = Reason("negative_slope", "the force falls where the frame pulls")
            doubts = (falls, *doubts)
        number = self.number(slope, method, during=during, doubts=doubts)
        made_of = Stiffness(
            self.decide, slope.as_estimate, during, (max(low, 0.0), high), (low, high)
        )
        drawn = FittedLine(self.name, slope.value, level, low, high)
        return Computed((number,), {self.name: made_of}, (drawn,))

    def samples(self, trace: Trace) -> Ints | Failure:
        """Return the samples in the window of the first loading, up to the failure.

        Parameters
        ----------
        trace : one curve
        """
        stretch = loading_of(trace)
        window = self.inside(trace.displacement[stretch])
        if isinstance(window, Failure):
            return window
        part = np.arange(stretch.start, stretch.stop)[window]
        is_finite = ~np.isnan(trace.displacement[part]) & ~np.isnan(trace.force[part])
        return part[is_finite]

    def decide(self, trace: Trace) -> Reading | Failure:
        """Choose the samples for the slope of the line over the window.

        Parameters
        ----------
        trace : one curve
        """
        chosen = self.samples(trace)
        if isinstance(chosen, Failure):
            return chosen
        if len(chosen) < MIN_LINE_SAMPLES:
            message = f"{len(chosen)} samples in the stretch, {MIN_LINE_SAMPLES} are needed"
            return Failure("too_few_samples", message)
        if np.ptp(trace.displacement[chosen]) == 0.0:
            return Failure("no_travel", "the displacement does not change over the stretch")
        part = samples_of(chosen)

        def numbers(trace: Trace) -> tuple[Floats]:
            return (slope_of_line(trace.displacement[..., part], trace.force[..., part]),)

        return Reading(numbers, len(chosen), is_cut=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class OfStiffness(Kind):
    """A kind of result that depends on a stiffness above it in the list."""

    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]

    def missing(self, test: ReducedTest) -> Failure:
        """Return the failure for a missing stiffness."""
        return blocked_or(test, Failure("no_stiffness", f"{self.of} is not available"))


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedStiffness(OfStiffness):
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: ClassVar = "normalised-stiffness"
    outputs: ClassVar = (Output("{of}_per_peak_force", "1/m"),)
    needs: ClassVar = Needs()

    def compute(self, test: ReducedTest) -> Computed:
        """Compute the ratio, in which a gain error cancels."""
        method = (
            f"{self.of} / peak force of the same sample, errors independent, scale error cancelled"
        )
        stiffness, cycles = test.stiffnesses.get(self.of), test.cycles
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        window = stiffness.during
        during = (window[0], max(window[1], cycles[-1][0].stop_time)) if window else None
        doubts = marked_slips(test, stiffness.bends_with) + cut_short(test, cycles[-1][:1])
        outcome = _per_peak(test, stiffness)
        return Computed((self.number(outcome, method, during=during, doubts=doubts),))


def _per_peak(test: ReducedTest, stiffness: Stiffness) -> CalibrationFit:
    """Measure a stiffness over the largest force of all cycles."""
    trace = traced(test)
    peaks = {cycle[0].cycle: peak_of(test, trace, cycle[0].cycle) for cycle in test.cycles}
    readings = {key: peak for key, peak in peaks.items() if isinstance(peak, Reading)}
    if not readings:
        return next(peak for peak in peaks.values() if isinstance(peak, Failure))
    values = {key: float(reading.numbers(trace)[0]) for key, reading in readings.items()}
    largest = max(values, key=lambda key: values[key])
    outcome = test.measure(lambda trace: peak_of(test, trace, largest))
    peak = outcome if isinstance(outcome, Failure) else outcome[0]
    if isinstance(peak, Failure):
        return peak
    if peak.value <= 3.0 * peak.error:
        return Failure("no_peak_force", f"a peak of {peak.value:.3g} N is no more than its noise")
    share = combine(_quotient, stiffness.decide, lambda trace: peak_of(test, trace, largest))
    ratio = test.measure(share)
    return ratio if isinstance(ratio, Failure) else ratio[0]


def _quotient(trace: Trace, one: Floats, other: Floats) -> Floats:
    del trace
    return np.asarray(one / other, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulus(OfStiffness):
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    needs: ClassVar = Needs()
    area: Annotated[
        Literal["stated", "rectangle", "annulus", "thin-wall"],
        "Which area of specimen.section it refers to",
    ]
    name: Annotated[Snake, "Such as modulus_annulus"] = "modulus"

    def compute(self, test: ReducedTest) -> Computed:
        """Compute the modulus with the uncertainties of stiffness, gauge length and area."""
        method = f"{self.of} x specimen.length / area ({self.area})"
        stiffness, area = test.stiffnesses.get(self.of), _area(self.area, test.setup.section)
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        outcome: CalibrationFit
        if test.setup.length is None:
            outcome = Failure("no_length", "specimen.length, the gauge length, is not given")
        elif isinstance(area, Failure):
            outcome = area
        else:
            measured = test.measure(combine(self._modulus, stiffness.decide))
            outcome = measured if isinstance(measured, Failure) else measured[0]
        doubts = marked_slips(test, stiffness.bends_with) + _of_the_machine(test, stiffness)
        return Computed((self.number(outcome, method, during=stiffness.during, doubts=doubts),))

    def _modulus(self, trace: Trace, stiffness: Floats) -> Floats:
        area = _area(self.area, trace.sizes)
        area = np.nan if isinstance(area, Failure) else area
        return np.asarray(stiffness * trace.sizes["length"] / area, dtype=np.float64)


def _of_the_machine(test: ReducedTest, stiffness: Stiffness) -> tuple[Reason, ...]:
    """Return a doubt if the displacement may be that of frame and grips."""
    limits = test.setup.limits
    share = limits.machine_compliance * stiffness.estimate.value
    if test.setup.compliance_stated or not share > limits.machine_share:
        return ()
    message = (
        f"curve.compliance is not stated: {1e6 * limits.machine_compliance:g} um/N, as frames and "
        f"grips often have, would be {share:.0%} of the displacement; measure it with a stiff bar "
        "(protocol stiff-bar), or state 0 um/N where an extensometer measured"
    )
    return (Reason("machine_compliance", message),)


def _area(kind: str, section: Mapping[str, float]) -> float | Failure:
    """Compute an area from its sizes."""
    needs = {
        "stated": ("area",),
        "rectangle": ("width", "thickness"),
        "annulus": ("outer_diameter", "inner_diameter"),
        "thin-wall": ("outer_diameter", "wall"),
    }[kind]
    sizes = [section[name] for name in needs if name in section]
    if len(sizes) < len(needs):
        wanted = " and ".join(f"specimen.section.{name}" for name in needs)
        return Failure("no_area", f"{wanted} not given")
    areas = {"rectangle": rectangle_area, "annulus": annulus_area, "thin-wall": thin_wall_area}
    area = sizes[0] if kind == "stated" else areas[kind](*sizes)
    if not area > 0.0:
        return Failure("no_area", f"the {kind} area comes out as {area:.4g} m^2")
    return area


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceResult(Kind):
    """``compliance`` (m/N): of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    outputs: ClassVar = (Output("compliance", "m/N", "Compliance of frame and grips"),)
    start: Annotated[Force, Key("from")]
    stop: Annotated[Force, Key("to"), LargerThan("start")]

    def compute(self, test: ReducedTest) -> Computed:
        """Fit displacement against force, with a rigid bar."""
        method = (
            f"displacement against force from {self.start:g} N to {self.stop:g} N, the bar taken "
            "for rigid"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        outcome = test.measure(self.decide)
        if isinstance(outcome, Failure):
            return self.not_available(outcome, method)
        return Computed((self.number(outcome[0], method, during=test.while_loading()),))

    def decide(self, trace: Trace) -> Reading | Failure:
        """Choose the samples for the slope of displacement against force over the window.

        Parameters
        ----------
        trace : one curve
        """
        stretch = loading_of(trace)
        d, f = trace.displacement[stretch], trace.force[stretch]
        window = compliance_window(d, f, start=self.start, stop=self.stop)
        if isinstance(window, Failure):
            return window
        slope = float(slope_of_line(f[window], d[window]))
        if slope <= 0.0:
            return Failure("not_positive", f"slope {slope:.4g} m/N")

        def numbers(trace: Trace) -> tuple[Floats]:
            x, y = (
                values[..., stretch][..., window] for values in (trace.force, trace.displacement)
            )
            return (slope_of_line(x, y),)

        return Reading(numbers, len(d[window]), is_cut=True)


KINDS = (
    UnloadingStiffness,
    LoadingStiffness,
    Hardening,
    InitialStiffness,
    LineStiffness,
    NormalisedStiffness,
    Modulus,
    ComplianceResult,
)
