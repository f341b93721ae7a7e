"""The reduced test: the corrected curve of a test, and all else from which its results follow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, median
from labpipe.records.curve import Aligned, Bending, Branch, Curve, Direction, Shape, Slip
from labpipe.records.declarations import LIMITS, Limits
from labpipe.records.estimates import Estimate, Failure, UnavailableError
from labpipe.records.quality import Doubt, Findings, Reason
from labpipe.records.signals import Clocks, Signal, Signals, Stretch
from labpipe.uncertainty.extractors import Decide
from labpipe.uncertainty.intervals import Measured, measure_numbers
from labpipe.uncertainty.replicates import Replicates

if TYPE_CHECKING:
    from labpipe.markers.three_point_axis import SpanShape
    from labpipe.results.tension import Pull


@dataclass(frozen=True, slots=True)
class FailurePoint:
    """The last sample before the final loss of force.

    Parameters
    ----------
    sample : its number; the specimen broke between it and the next one
    lost_before : largest share of the peak that was suddenly and permanently lost earlier, by a
        specimen that failed in steps; else 0
    slow_below : for a slow loss, share of the peak that the force finally falls below; None for a
        sudden loss
    """

    sample: int
    lost_before: float = 0.0
    slow_below: float | None = None


NO_LOADING = Failure.of("results.no_cycle")
_Part = TypeVar("_Part")


@dataclass(frozen=True, slots=True, eq=False)
class SpanBend:
    """The bent axis between two supports, from cameras.

    Parameters
    ----------
    shape : in every frame
    time : shape (frames,), s, on the clock of the cameras
    rest : shape (frames,), frames before the loading
    """

    shape: SpanShape
    time: Floats
    rest: Flags


@dataclass(frozen=True, slots=True)
class LoadString:
    """The string between specimen and load cell.

    Parameters
    ----------
    length : m
    counterweight : kg, at the tip
    at_rest : whether it carried the counterweight before the test
    """

    length: float
    counterweight: float
    at_rest: Literal["by-data", "taut", "slack"]


@dataclass(frozen=True, slots=True)
class Setup:
    """Facts of protocol and test sheet on specimen and rig.

    Parameters
    ----------
    sizes : m (the area m^2), stated ones of specimen and rig by the keys of the protocol: length,
        span between the supports, and those of the cross-section
    mass_per_length : kg/m; None if not stated
    uncertainties : m (of the area m^2), standard uncertainties of sizes; others are exact
    string : that loads the specimen, or None
    has_markers : whether the specimen carries markers
    centre_offset, offset_uncertainty, centre_uncertainty : m, of the markers
    free_tip : whether the shape may bend up to its tip
    compliance_stated : whether the protocol states the compliance of frame and grips
    limits : of the lab
    labels : of the test sheet, by name
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
    compliance_stated: bool = False
    limits: Limits = LIMITS
    labels: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Stiffness:
    """A stiffness from which other results are computed.

    Parameters
    ----------
    decide : chooses its samples on a curve
    estimate : N/m
    during : s, time interval of its samples
    window : m, displacements between which it was measured
    bends_with : m, range of displacement in which a slip affects it; None if no slip does
    """

    decide: Decide
    estimate: Estimate
    during: Stretch | None
    window: tuple[float, float]
    bends_with: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ReducedTest:
    """A test with all data for its results.

    Parameters
    ----------
    signals, clocks : of the test
    setup : facts on specimen and rig
    aligned : the raw signals at the times of the displacement; None without a curve
    curve : corrected, or None
    replicates : of the curve, or None
    unfiltered : the force of the curve, outliers bridged, before any filter
    shape : of the specimen; None if no step fits one
    span : the bent axis between two supports, or why there is none; None if not requested
    bending : measured moment-curvature, or why there is none; None if not requested
    failure : where the specimen broke; None if it did not, or if not requested
    slips : the slip ledger
    compliance : m/N, of frame and grips; times the force, it is subtracted from the displacement
    slack : displacement before the specimen was taut, m; None if not requested
    pull : stress and strain with the elastic line, or why there are none; None if not requested
    cut_at : by quantity, s on the clock of the curve, where its record ends within a branch
    stiffnesses : by name, of earlier results
    findings : so far
    seed : of draws, from the recorded data
    """

    signals: Signals
    clocks: Clocks = field(default_factory=Clocks)
    setup: Setup = Setup()
    aligned: Aligned | None = None
    curve: Curve | None = None
    replicates: Replicates | None = None
    unfiltered: Signal | None = None
    shape: Shape | None = None
    span: SpanBend | Failure | None = None
    bending: Bending | Failure | None = None
    failure: FailurePoint | Failure | None = None
    slips: tuple[Slip, ...] = ()
    compliance: float = 0.0
    slack: Measured | Failure | None = None
    pull: Pull | Failure | None = None
    cut_at: Mapping[str, float] = field(default_factory=dict)
    stiffnesses: Mapping[str, Stiffness] = field(default_factory=dict)
    findings: Findings = field(default_factory=Findings)
    seed: bytes = b""

    @property
    def force(self) -> Signal:
        """Return the force of the curve, filtered."""
        return self.signals.filtered[self.signals.force]

    @property
    def displacement(self) -> Signal:
        """Return the displacement of the curve, filtered."""
        return self.signals.filtered[self.signals.displacement]

    @property
    def raw_force(self) -> Signal:
        """Return the force of the curve, calibrated and zeroed but not filtered."""
        return self.signals.raw[self.signals.force]

    @property
    def required_curve(self) -> Curve:
        """Return the curve of a test with cycles.

        Raises
        ------
        ValueError
            If there is none.
        """
        if self.curve is None:
            raise ValueError(format_sentence("results.no_curve"))
        return self.curve

    def measure(
        self, decide: Decide, values: Sequence[float] | None = None
    ) -> tuple[Measured, ...]:
        """Measure numbers of the curve with their uncertainty.

        Parameters
        ----------
        decide, values : as for `labpipe.uncertainty.intervals.measure_numbers`

        Raises
        ------
        UnavailableError
            If there are no such numbers, or no curve.
        """
        return measure_numbers(self.require(self.replicates), decide, values)

    def measure_one(self, decide: Decide, values: Sequence[float] | None = None) -> Measured:
        """Measure the first number of a reading, as `measure_numbers`."""
        return self.measure(decide, values)[0]

    def make_error(self, reason: Failure) -> UnavailableError:
        """Return an error with the finding that blocked the test, or else with another reason."""
        return UnavailableError(self.findings.blocked or reason)

    def require(self, part: _Part | Failure | None, missing: Failure = NO_LOADING) -> _Part:
        """Return a part of the test.

        Parameters
        ----------
        part : of the test, or why there is none
        missing : reason if it is None and nothing blocked the test

        Raises
        ------
        UnavailableError
            If there is none.
        """
        if isinstance(part, Failure):
            raise UnavailableError(part)
        if part is None:
            raise self.make_error(missing)
        return part

    @property
    def cycles(self) -> list[list[Branch]]:
        """Return the branches of the curve by cycle."""
        branches = self.curve.branches if self.curve else ()
        numbers = sorted({branch.cycle for branch in branches})
        return [[branch for branch in branches if branch.cycle == number] for number in numbers]

    @property
    def first_loading(self) -> Branch | None:
        """Return the first loading branch of the curve, or None."""
        branches = self.curve.branches if self.curve is not None else ()
        return next((branch for branch in branches if branch.direction is Direction.LOADING), None)

    @property
    def slack_error(self) -> float:
        """Return the standard error of the subtracted slack, m; 0 without slack."""
        return self.slack.error if isinstance(self.slack, Measured) else 0.0

    def find_loading_interval(self, low: float = -np.inf, high: float = np.inf) -> Stretch | None:
        """Find when the first loading went from one displacement to another.

        Parameters
        ----------
        low, high : m

        Returns
        -------
        s, on the clock of the curve: when it first reached `low`, and when it first exceeded
        `high`, or its end. None without a curve or a branch.
        """
        curve = self.curve
        if curve is None or not curve.branches:
            return None
        branch = curve.branches[0]
        path = curve.displacement[branch.start : branch.stop]
        reached, beyond = (np.flatnonzero(mask) for mask in (path >= low, path > high))
        start = curve.time[branch.start + int(reached[0])] if len(reached) else branch.start_time
        stop = curve.time[branch.start + int(beyond[0])] if len(beyond) else branch.stop_time
        return float(start), float(stop)

    def find_doubts(self, quantity: str, during: Stretch | None = None) -> tuple[Reason, ...]:
        """Return the doubts about a number that depends on a quantity in a time interval.

        Parameters
        ----------
        quantity : as for `Doubt`
        during : s, on the clock of the curve; None for the whole record

        Returns
        -------
        The first reason of each code whose time overlaps the interval, or the stretch in which the
        quantity was zeroed.
        """
        reasons: dict[str, Reason] = {}
        for doubt in self.findings.doubts:
            if doubt.quantity == quantity and self._overlaps(doubt, during):
                reasons.setdefault(doubt.reason.code, doubt.reason)
        return tuple(reasons.values())

    def collect_doubts(self, quantities: Iterable[str], during: Stretch | None) -> list[Reason]:
        """Return the doubts about a number that depends on several quantities."""
        return [why for quantity in quantities for why in self.find_doubts(quantity, during)]

    def _overlaps(self, doubt: Doubt, during: Stretch | None) -> bool:
        if doubt.during is None or during is None:
            return True
        start, stop = (self.clocks.to_curve(edge, doubt.clock) for edge in doubt.during)
        signals, stretches = self.signals, [during]
        name = {"force": signals.force, "displacement": signals.displacement}.get(
            doubt.quantity, ""
        )
        if name in signals.zero_stretches or name in signals.moving_zero_stretches:
            zero = signals.zero_stretches.get(name) or signals.moving_zero_stretches[name]
            first, last = (self.clocks.to_curve(edge, signals.raw[name].clock) for edge in zero)
            stretches.append((first, last))
        return any(start <= end and begin <= stop for begin, end in stretches)


def compute_loading_sign(values: Floats) -> float:
    """Find the sign in which a quantity changes in loading.

    Parameters
    ----------
    values : shape (n,), over the first loading branch; NaN are ignored

    Returns
    -------
    -1.0 if the quantity falls further below its first value than it rises above it, else 1.0. If
    neither is more than twice the other, the sign of the largest absolute value.
    """
    finite = values[~np.isnan(values)]
    if not len(finite):
        return 1.0
    first = median(finite[: max(1, len(finite) // 100)])
    up, down = float(finite.max()) - first, first - float(finite.min())
    if max(up, down) > 2.0 * min(up, down):
        return 1.0 if up > down else -1.0
    return 1.0 if finite.max() >= -finite.min() else -1.0
