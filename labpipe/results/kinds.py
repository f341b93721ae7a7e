"""Define the base class of kinds of results, and the record of a test that they measure.

A kind of result is a class. Its fields are the settings of its entry in a protocol, and its class
variables are its name, outputs, needs and methods. `Kind.measure` yields the numbers of a test,
stiffnesses for later entries, lines and notes. Grammar, cross-checks, JSON Schema, descriptions and
the reference page derive from `labpipe.results.KINDS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias, TypeVar, dataclass_transform

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, drop_missing, median
from labpipe.records.causes import FIT, SCALE_OF_FORCE, make_contribution
from labpipe.records.curve import (
    Aligned,
    Bending,
    Branch,
    Curve,
    FittedLine,
    Interval,
    Shape,
    Slip,
    SlipDecision,
)
from labpipe.records.declarations import LIMITS, Limits, Needs, Output
from labpipe.records.estimates import Estimate, Failure, UnavailableError, add_errors
from labpipe.records.quality import Doubt, Finding, Findings, Reason
from labpipe.records.result import Contribution, Result, Status
from labpipe.records.signals import Clocks, Signal, Signals, Stretch
from labpipe.signal.turning_points import estimate_noise_level
from labpipe.uncertainty.intervals import MeasuredNumber, measure_numbers
from labpipe.uncertainty.replicates import Choice, Replicates

if TYPE_CHECKING:
    from labpipe.markers.three_point_axis import SpanShape
    from labpipe.results.tension import TensileCurve


@dataclass(frozen=True, slots=True)
class FailurePoint:
    """The last sample before the final loss of force.

    Parameters
    ----------
    sample : index of the last sample before a sudden loss, or above `slow_loss_limit` in a slow
        loss; if only the end of the record shows the loss, of the last sample with a force
    earlier_loss : largest sudden and permanent loss of force before the failure, as a fraction of
        the peak, for a specimen that failed in steps; else 0
    slow_loss_limit : fraction of the peak below which the force finally falls in a slow loss; None
        for a sudden loss
    """

    sample: int
    earlier_loss: float = 0.0
    slow_loss_limit: float | None = None


NO_LOADING = Failure.of("results.no_cycle")
"""Reason why a test without a loading has no results."""
_Stage = TypeVar("_Stage")


@dataclass(frozen=True, slots=True, eq=False)
class SpanBend:
    """The bent axis between two supports, from cameras.

    Parameters
    ----------
    shape : shape of the specimen in every frame
    time : shape (frames,), s, times on the clock of the cameras
    is_at_rest : shape (frames,), whether the frame was taken before the loading
    """

    shape: SpanShape
    time: Floats
    is_at_rest: Flags


@dataclass(frozen=True, slots=True)
class LoadString:
    """The string between specimen and load cell.

    Parameters
    ----------
    length : m, length from the specimen to the load cell
    counterweight : kg, mass that hangs at the tip
    at_rest : state of the string before the test. A taut string carries the counterweight. For
        ``by-data``, the state is inferred from the data
    """

    length: float
    counterweight: float
    at_rest: Literal["by-data", "taut", "slack"]


@dataclass(frozen=True, slots=True)
class Setup:
    """Facts about specimen and rig, from protocol and test sheet.

    Parameters
    ----------
    sizes : stated sizes of specimen and rig, m (area: m^2), by the keys of the protocol: length,
        span between the supports, and sizes of the cross-section
    mass_per_length : kg/m, mass of the specimen per length; None if not stated
    uncertainties : standard uncertainties of sizes, m (area: m^2), by the keys of the sizes; a size
        without an uncertainty is assumed exact
    string : string that loads the specimen, or None
    has_markers : whether the protocol describes markers on the specimen
    centre_offset : m, distance from the axis to the marker centres
    offset_uncertainty : m, standard uncertainty of positions along the specimen
    centre_uncertainty : m, standard uncertainty of `centre_offset`
    free_tip : whether the shapes are fitted without a moment at the tip
    is_compliance_stated : whether the protocol states the compliance of load frame and grips
    limits : limits of the lab
    labels : labels of the test sheet by name
    """

    sizes: Mapping[str, float] = field(default_factory=dict)
    mass_per_length: float | None = None
    uncertainties: Mapping[str, float] = field(default_factory=dict)
    string: LoadString | None = None
    has_markers: bool = False
    centre_offset: float = 0.0
    offset_uncertainty: float = 0.0
    centre_uncertainty: float = 0.0
    free_tip: bool = False
    is_compliance_stated: bool = False
    limits: Limits = LIMITS
    labels: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Stiffness:
    """A stiffness from which other results are computed.

    Parameters
    ----------
    name : name of the result
    choose_samples : function that chooses the samples of the stiffness on a curve
    value : N/m, stiffness of the measured curve
    period : s on the clock of the curve, first and last time of the samples; None for the whole
        record
    window : m, displacements between which the stiffness was measured
    slip_range : m, range of displacement in which a slip affects the stiffness; None if no slip
        affects it
    doubts : doubts about the samples
    """

    name: str
    choose_samples: Choice
    value: float
    period: Stretch | None
    window: tuple[float, float]
    slip_range: tuple[float, float] | None = None
    doubts: tuple[Reason, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ReducedTest:
    """A test at any stage of its reduction, with all data from which results are computed.

    Parameters
    ----------
    signals, clocks : signals and clocks of the test
    setup : facts about specimen and rig
    aligned : the raw signals at the times of the displacement; None without a curve
    curve : corrected curve, or None
    replicates : replicates of the curve, or None
    unfiltered_force : force of the curve before any filter, with outliers replaced by
        interpolation; None without a curve
    shape : shape of the specimen; None if no step fits one
    span : the bent axis between two supports, or why there is none; None if not requested
    bending : measured moment-curvature, or why there is none; None if not requested
    failure : point at which the specimen failed, or why it did not; None if not requested
    slips : the slip ledger
    compliance : m/N, compliance of load frame and grips, negative if force and displacement have
        opposite signs in loading; the compliance times the force is subtracted from the
        displacement
    slack : m, displacement before the specimen was taut, or why it is unknown; None if not
        requested
    tensile_curve : stress and strain with the elastic line, or why there are none; None if not
        requested
    cut_times : s on the clock of the curve, time at which a record ends within a branch, by
        quantity
    stiffnesses : stiffnesses of earlier results by name
    findings : findings up to this stage
    seed : seed of random draws, computed from the recorded data
    """

    signals: Signals
    clocks: Clocks = field(default_factory=Clocks)
    setup: Setup = Setup()
    aligned: Aligned | None = None
    curve: Curve | None = None
    replicates: Replicates | None = None
    unfiltered_force: Signal | None = None
    shape: Shape | None = None
    span: SpanBend | Failure | None = None
    bending: Bending | Failure | None = None
    failure: FailurePoint | Failure | None = None
    slips: tuple[Slip, ...] = ()
    compliance: float = 0.0
    slack: MeasuredNumber | Failure | None = None
    tensile_curve: TensileCurve | Failure | None = None
    cut_times: Mapping[str, float] = field(default_factory=dict)
    stiffnesses: Mapping[str, Stiffness] = field(default_factory=dict)
    findings: Findings = field(default_factory=Findings)
    seed: bytes = b""

    @property
    def force(self) -> Signal:
        """Force of the curve, filtered."""
        return self.signals.filtered[self.signals.force]

    @property
    def displacement(self) -> Signal:
        """Displacement of the curve, filtered."""
        return self.signals.filtered[self.signals.displacement]

    @property
    def raw_force(self) -> Signal:
        """Force of the curve, calibrated and zeroed but not filtered."""
        return self.signals.raw[self.signals.force]

    @property
    def required_curve(self) -> Curve:
        """Curve of a test that has one.

        Raises
        ------
        ValueError
            If the test has no curve.
        """
        if self.curve is None:
            raise ValueError(format_sentence("results.no_curve"))
        return self.curve

    def measure_numbers(self, choose: Choice) -> tuple[MeasuredNumber, ...]:
        """Measure numbers of the curve with their uncertainty.

        Parameters
        ----------
        choose : function that chooses the samples of the numbers on a curve

        Raises
        ------
        UnavailableError
            If the test has no curve, or as `labpipe.uncertainty.intervals.measure_numbers`.
        """
        return measure_numbers(self.require(self.replicates), choose)

    def measure_number(self, choose: Choice) -> MeasuredNumber:
        """Measure the first of the numbers that `measure_numbers` returns."""
        return self.measure_numbers(choose)[0]

    def require(self, stage: _Stage | Failure | None, missing: Failure = NO_LOADING) -> _Stage:
        """Return a stage of the test, or raise the reason why it is not available.

        Parameters
        ----------
        stage : stage of the test, or the reason why it is not available; None if it was not reached
        missing : reason for a stage that is None although no finding blocks the test

        Raises
        ------
        UnavailableError
            If the stage is not available.
        """
        if stage is None:
            raise UnavailableError(self.findings.blocking_reason or missing)
        if isinstance(stage, Failure):
            raise UnavailableError(stage)
        return stage

    @property
    def cycles(self) -> list[list[Branch]]:
        """Branches of the curve by cycle."""
        branches = self.curve.branches if self.curve else ()
        cycles = sorted({branch.cycle for branch in branches})
        return [[branch for branch in branches if branch.cycle == cycle] for cycle in cycles]

    @property
    def first_loading(self) -> Branch | None:
        """First loading branch of the curve, or None."""
        return None if self.curve is None else self.curve.first_loading

    def find_loading_period(self, start: float = -np.inf, stop: float = np.inf) -> Stretch | None:
        """Find the times at which the first loading passed two displacements.

        Parameters
        ----------
        start, stop : m, displacements at both ends of the period

        Returns
        -------
        Times at which the branch first reached `start` and first exceeded `stop`, s on the clock of
        the curve; those of the ends of the branch if it did not. None without a curve or a branch.
        """
        curve = self.curve
        if curve is None or not curve.branches:
            return None
        branch = curve.branches[0]
        samples = slice(branch.start, branch.stop)
        time, d = curve.time[samples], curve.displacement[samples]
        first_time = time[np.argmax(d >= start)] if (d >= start).any() else branch.start_time
        last_time = time[np.argmax(d > stop)] if (d > stop).any() else branch.stop_time
        return float(first_time), float(last_time)

    def collect_doubts(self, quantities: Iterable[str], period: Stretch | None) -> list[Reason]:
        """Collect the doubts about a number that depends on quantities in a period.

        Parameters
        ----------
        quantities : names of quantities, see `Doubt`
        period : first and last time, s on the clock of the curve; None for the whole record

        Returns
        -------
        The first reason of each code and quantity whose doubt overlaps the period, or the stretch
        over which the quantity was zeroed. A doubt without a period overlaps every period.
        """
        reasons: dict[tuple[str, str], Reason] = {}
        for quantity in quantities:
            for doubt in self.findings.doubts:
                if doubt.quantity == quantity and self._overlaps(doubt, period):
                    reasons.setdefault((quantity, doubt.reason.code), doubt.reason)
        return list(reasons.values())

    def _overlaps(self, doubt: Doubt, period: Stretch | None) -> bool:
        """Return whether a doubt overlaps a period, or the stretch of the zero of its quantity.

        A period of None is that of the whole record.
        """
        if doubt.period is None or period is None:
            return True
        stretches, signals = [(*period, self.clocks.curve_clock)], self.signals
        for name, zero in {**signals.moving_zero_stretches, **signals.zero_stretches}.items():
            if signals.quantities.get(name) == doubt.quantity:
                stretches.append((*zero, signals.raw[name].clock))
        start, stop = (self.clocks.to_curve(edge, doubt.clock) for edge in doubt.period)
        return any(
            start <= self.clocks.to_curve(last, clock)
            and self.clocks.to_curve(first, clock) <= stop
            for first, last, clock in stretches
        )


def compute_loading_sign(values: Floats) -> float:
    """Compute the sign of the change of a quantity in loading.

    Parameters
    ----------
    values : shape (n,), over a branch or a record that begins with loading; NaN are ignored

    Returns
    -------
    The sign of the larger of rise and fall, if it is more than twice the other one; otherwise the
    sign of the value with the largest magnitude. Rise and fall are measured from the median of the
    first 1 % of the values. The sign is 1.0 if there are no values.
    """
    finite_values = drop_missing(values)
    if not len(finite_values):
        return 1.0
    first_level = median(finite_values[: max(1, len(finite_values) // 100)])
    rise, fall = float(finite_values.max()) - first_level, first_level - float(finite_values.min())
    if max(rise, fall) > 2.0 * min(rise, fall):
        return 1.0 if rise > fall else -1.0
    return 1.0 if finite_values.max() >= -finite_values.min() else -1.0


Outcome: TypeAlias = MeasuredNumber | Estimate | Failure
"""Number with its uncertainty, or the reason why it is not available."""
MeasuredItem: TypeAlias = Result | Stiffness | FittedLine | Finding
"""Item that a kind of result measures: a number, a stiffness for later entries, a line for figures,
or a note on the test."""
Errors: TypeAlias = Mapping[str, float]
"""Standard errors that are not among the errors of the fit, in the unit of the number, by cause."""


@dataclass_transform(frozen_default=True, kw_only_default=True)
@dataclass(frozen=True, kw_only=True)
class Kind(ABC):
    """A kind of result; its fields are the settings of an entry in a protocol.

    Subclasses become frozen dataclasses without a decorator.

    ``result`` is the name of the kind in a protocol. ``method`` describes how all outputs are
    measured; ``methods`` describes each output if the methods differ. Both may have settings as
    replacement fields. The field ``over_mm`` is the setting ``over`` in millimetres.
    """

    result: ClassVar[str]
    outputs: ClassVar[tuple[Output, ...]]
    needs: ClassVar[Needs] = Needs(branches=True)
    method: ClassVar[str] = ""
    methods: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """Make the subclass a frozen dataclass."""
        dataclass(frozen=True, kw_only=True)(cls)

    @abstractmethod
    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure a test; yield its numbers, with stiffnesses, lines and notes.

        Parameters
        ----------
        test : the test, with the stiffnesses of earlier entries

        Raises
        ------
        UnavailableError
            If the test has none of the outputs.
        """

    def compute(self, test: ReducedTest) -> list[MeasuredItem]:
        """Measure a test, or return all outputs as not available.

        Parameters
        ----------
        test : the test, with the stiffnesses of earlier entries
        """
        try:
            return list(self.measure(test))
        except UnavailableError as error:
            suffixes = ["" if x.first is None else f".{x.first}" for x in self.outputs]
            return [
                self.make_result(test, error.failure, output=index, suffix=suffix)
                for index, suffix in enumerate(suffixes)
            ]

    def compute_results(self, test: ReducedTest) -> list[Result]:
        """Compute the results that `compute` returns, without stiffnesses, lines and notes."""
        return [item for item in self.compute(test) if isinstance(item, Result)]

    def make_results(
        self, test: ReducedTest, outcomes: Iterable[Outcome], *, first: int = 0, **common: Any
    ) -> Iterator[Result]:
        """Make the results of consecutive outputs from the index `first` on, as `make_result`."""
        for index, outcome in enumerate(outcomes, start=first):
            yield self.make_result(test, outcome, output=index, **common)

    def make_result(
        self,
        test: ReducedTest,
        outcome: Outcome,
        errors: Errors | None = None,
        *,
        output: int = 0,
        method: str = "",
        period: Stretch | None = None,
        doubts: tuple[Reason, ...] = (),
        suffix: str = "",
        remark: str = "",
    ) -> Result:
        """Make the result of one output: name, interval, status and reasons.

        Parameters
        ----------
        test : reduced test with its doubts
        outcome : number with its uncertainty, or why it is not available; an `Estimate` without an
            interval gets the normal interval of its error
        errors : further standard errors, added to an `Estimate`; ignored for other outcomes
        output : index of the output in `outputs`; settings are filled into the name of the output
        method : method of the number, with settings as replacement fields; if empty, that of the
            class
        period : s on the clock of the curve, first and last time of the samples; None for the whole
            record
        doubts : further reasons to doubt the number
        suffix : last part of the name, such as ``.1``
        remark : remark on the number of this test
        """
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        lengths = {f"{name}_mm": 1e3 * x for name, x in settings.items() if isinstance(x, float)}
        declaration = self.outputs[output]
        name, made_of = declaration.name.format_map(settings) + suffix, settings.get("of", "")
        method = method or (self.methods[output] if self.methods else self.method)
        method = method.format_map(settings | lengths)
        outcome, budget = _widen_estimate(outcome, errors or {})
        if isinstance(outcome, Failure):
            test_doubts = test.collect_doubts((*declaration.depends_on, *_SIGN_QUANTITIES), period)
            curve_doubts = [doubt for doubt in test_doubts if doubt.code in _CURVE_ERRORS]
            is_explained = outcome.code in _EXPLAINED_FAILURES
            all_reasons = [*curve_doubts, outcome] if is_explained else [outcome, *curve_doubts]
            reasons, unit = tuple(dict.fromkeys(all_reasons)), declaration.unit
            return Result(name, None, unit, None, Status.FAILED, reasons, method, made_of=made_of)
        number_doubts = outcome.doubts if isinstance(outcome, MeasuredNumber) else ()
        quantities = "", *declaration.depends_on
        noise_doubts = [reason for quantity, reason in number_doubts if quantity in quantities]
        test_doubts = test.collect_doubts(_list_quantities(declaration, test), period)
        reasons = tuple(dict.fromkeys([*test_doubts, *doubts, *noise_doubts]))
        drops = [slip.drop for slip in test.slips if slip.decision is SlipDecision.REPAIRED]
        slip_remark = f"{sum(drops):.3g} N of slips added back"
        remarks = remark, slip_remark if drops and declaration.is_raised_by_slips else ""
        return Result(
            name,
            value=outcome.value,
            unit=declaration.unit,
            interval=outcome.interval or Interval.make_normal(outcome.value, outcome.error),
            status=Status.DOUBTFUL if reasons else Status.OK,
            reasons=reasons,
            method=method,
            n=outcome.n,
            made_of=made_of,
            remark="; ".join(filter(None, remarks)),
            estimate=outcome.estimate if isinstance(outcome, MeasuredNumber) else None,
            budget=budget,
        )


def _list_quantities(declaration: Output, test: ReducedTest) -> tuple[str, ...]:
    """List the quantities whose doubts apply to a number, with its sign and the zero of the force.

    A slope depends on the zero only if slack was subtracted, because the end of the slack depends
    on the force.
    """
    signs = {"N": _SIGN_QUANTITIES[:1], "m": _SIGN_QUANTITIES[1:]}.get(declaration.unit, ())
    needs_zero = not declaration.is_slope or isinstance(test.slack, MeasuredNumber)
    zeros = ("force_zero",) if "force" in declaration.depends_on and needs_zero else ()
    return (*declaration.depends_on, *zeros, *signs)


def compute_scale_error(test: ReducedTest, outcome: Outcome) -> Errors:
    """Compute the scale error of a number proportional to the force; none for a failure."""
    if isinstance(outcome, Failure):
        return {}
    return {SCALE_OF_FORCE: test.raw_force.relative_error * abs(outcome.value)}


_SIGN_QUANTITIES: tuple[str, ...] = ("force_sign", "displacement_sign")
"""Quantities of doubts about signs: the first for numbers in newtons, the second for those in
metres."""
_CURVE_ERRORS = frozenset(
    ["frozen_channel", "saturation", "force_reversed", "displacement_reversed", "begins_under_load"]
)
"""Codes of doubts that may explain a failure, because the curve itself is wrong."""
_EXPLAINED_FAILURES = frozenset({"not_reached", "no_travel"})
"""Codes of failures that a doubt of `_CURVE_ERRORS` explains; the doubt is then listed first."""


def _widen_estimate(outcome: Outcome, errors: Errors) -> tuple[Outcome, tuple[Contribution, ...]]:
    """Add errors to an `Estimate`, and make the budget; fail for a number that is not finite."""
    budget = outcome.budget if isinstance(outcome, MeasuredNumber) else ()
    if isinstance(outcome, Estimate):
        fit_error = outcome.error if outcome.interval is None else outcome.interval.standard_error
        changes = {FIT: fit_error, **errors}
        if np.isfinite(list(changes.values())).all():
            budget = tuple(make_contribution(*change) for change in changes.items() if change[1])
        outcome = add_errors(outcome, *errors.values())
    if not isinstance(outcome, Failure) and not np.isfinite([outcome.value, outcome.error]).all():
        reason = Failure.of("results.not_finite", value=outcome.value, error=outcome.error)
        return reason, ()
    return outcome, budget


def find_pause_doubts(test: ReducedTest, window: tuple[float, float]) -> tuple[Reason, ...]:
    """Find a doubt about a range of the first loading with a pause in which the force falls.

    Parameters
    ----------
    test : reduced test with its curve
    window : m, displacements at both ends of the range

    Notes
    -----
    The range is divided into 20 equal parts. A pause is in the parts that take more than five times
    the median duration; noise may spread it over several parts. The force falls if it decreases by
    more than 1 % of its change over the range, and by more than four standard errors.
    """
    n_parts, min_duration_ratio, min_fall, min_errors = 20, 5.0, 0.01, 4.0
    curve = test.required_curve
    branch = curve.first_loading
    if branch is None:
        return ()
    loading = slice(branch.start, branch.stop)
    time, force = curve.time[loading], curve.force[loading]
    largest_so_far = np.fmax.accumulate(curve.displacement[loading])
    edges = np.searchsorted(largest_so_far, np.linspace(*window, n_parts + 1))
    edges = np.minimum(edges, len(time) - 1)
    durations = np.diff(time[edges])
    long_parts = np.flatnonzero(durations > min_duration_ratio * np.median(durations))
    if not len(long_parts) or edges[long_parts[-1] + 1] - edges[long_parts[0]] < n_parts:
        return ()
    start, stop = edges[long_parts[0]], edges[long_parts[-1] + 1]
    tenth = (stop - start) // 10  # samples
    change = float(force[edges[-1]] - force[edges[0]]) or np.inf
    start_force, end_force = force[start : start + tenth], force[stop - 2 * tenth : stop - tenth]
    fall = float(np.nanmean(start_force) - np.nanmean(end_force)) / change
    error = estimate_noise_level(force) / np.sqrt(tenth) / abs(change)
    if not fall > max(min_fall, min_errors * error):
        return ()
    place, duration = 1e3 * float(largest_so_far[start]), float(time[stop] - time[start])
    return (Reason.of("results.pause_in_window", place=place, duration=duration, fall=fall),)


def find_slip_doubts(test: ReducedTest, window: tuple[float, float] | None) -> tuple[Reason, ...]:
    """Find a doubt about a range of displacement with a slip that is marked but not repaired.

    Parameters
    ----------
    test : reduced test with its slip ledger
    window : m, displacements at both ends of the range; None if slips have no effect
    """
    start, stop = window or (np.inf, -np.inf)
    slips = [slip for slip in test.slips if slip.decision is SlipDecision.MARKED]
    places = [f"{1e3 * x.position:.4g} mm" for x in slips if start <= x.position <= stop]
    return (Reason.of("results.slip_in_window", places=", ".join(places)),) if places else ()


def find_compliance_doubts(test: ReducedTest, stiffness: float) -> tuple[Reason, ...]:
    """Find a doubt if a large part of the displacement may be that of load frame and grips.

    Parameters
    ----------
    test : reduced test with the limits of the lab
    stiffness : N/m, measured stiffness
    """
    limits = test.setup.limits
    machine_fraction = limits.machine_compliance * stiffness  # of the displacement
    if test.setup.is_compliance_stated or not machine_fraction > limits.machine_share:
        return ()
    usual = 1e6 * limits.machine_compliance
    return (Reason.of("results.machine_compliance", usual=usual, share=machine_fraction),)


class ClockResult(Kind):
    """``clock_offset`` (s), ``clock_drift`` (1): clock of the force against that of the motion."""

    result: ClassVar = "clock"
    outputs: ClassVar = (
        Output("clock_offset", "s", "Offset of the clocks", ("clock",), can_be_negative=True),
        Output("clock_drift", "1", "Drift of the clocks", ("clock",), can_be_negative=True),
    )
    needs: ClassVar = Needs(clocks=True)
    method: ClassVar = "method by which the clocks of force and motion were joined"

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Yield offset and drift of force time against marker time; one event gives no drift."""
        fit = test.require(test.clocks.force_fit, Failure.of("results.one_clock"))
        n_events = len(fit.event_times_motion)
        offset = Estimate(fit.offset, fit.offset_interval.standard_error, n_events)
        drift: Outcome = Estimate(fit.drift, fit.drift_interval.standard_error, n_events)
        if np.isnan(fit.drift_interval.lower):
            drift = Failure.of("results.one_event")
        yield from self.make_results(test, (offset, drift), method=fit.method)
