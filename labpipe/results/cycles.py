"""Numbers of every cycle: its peaks, its energy, its residual displacement."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.fits.loops import largest_sample, loop_energy, noise_power, residual_after_unloading
from labpipe.records.arrays import Floats
from labpipe.records.causes import SHAPE
from labpipe.records.curve import Branch, Direction
from labpipe.records.declarations import CURVE, Force, Output
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Reason
from labpipe.records.signals import Stretch
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import (
    NO_CYCLE,
    Computed,
    Errors,
    Kind,
    Number,
    Outcome,
    blocked_or,
    force_scale,
)
from labpipe.signal.filters import power_passed
from labpipe.signal.turning_points import noise_level

_PAST = 0.9
"""Share of its largest value that a force has fallen below when its peak is over."""
NumberOfCycle: TypeAlias = Callable[[Evidence, list[Branch], Floats], Outcome]
"""A number of one cycle, from a displacement that may be that of another shape."""
NO_UNLOADING = Failure("partial_cycle", "the cycle has no unloading branch")


@dataclass(frozen=True, slots=True, kw_only=True)
class PerCycle(Kind):
    """A kind of result of one number for every cycle: `value`, its `errors`, its `method`."""

    whole: ClassVar[int] = 0
    """Branches of a cycle that must have been recorded to their end."""
    reads: ClassVar[tuple[float, float]] = (0.0, 2.0)
    """What of a cycle the number is read from, from and to, counted in branches: 0.9 is when nine
    tenths of the loading are over, 1 its end, 2 the end of unloading."""
    gap: ClassVar[str] = ""
    """Quantity whose samples beside its largest one must be known; empty for none."""

    @property
    @abstractmethod
    def method(self) -> str:
        """How the number is made, in words."""

    @abstractmethod
    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Compute the number of a cycle with the standard error of its fit, or say why not.

        Parameters
        ----------
        test : with a curve
        branches : of the cycle
        displacement : shape (n,), m, of the curve, or what it is under another assumption
        """

    def errors(self, test: Evidence, branches: list[Branch], found: Estimate) -> Errors:
        """Tell the standard errors of the number of a cycle from outside its fit."""
        del branches
        return force_scale(test, found)

    def compute(self, test: Evidence) -> Computed:
        """A number for every cycle; one failure where there is no cycle."""
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_CYCLE), self.method)
        return Computed(tuple(self._of_cycle(test, branches) for branches in test.cycles))

    def _of_cycle(self, test: Evidence, branches: list[Branch]) -> Number:
        found = self.value(test, branches, test.displacement.values)
        errors = {} if isinstance(found, Failure) else self.errors(test, branches, found)
        doubts = cut_short(test, branches[: self.whole], self.outputs[0].rests_on)
        if self.gap:
            doubts += gap_at_peak(test, branches, self.gap)
        return self.number(
            found,
            self.method,
            {**errors, **other_shape(test, branches, self.value, found)},
            during=_when(branches, self.reads),
            doubts=doubts,
            part=f".{branches[0].cycle}",
        )


def other_shape(
    test: Evidence, branches: list[Branch], value: NumberOfCycle, found: Outcome
) -> Errors:
    """Error from what a displacement under another assumption changes: a rectangle.

    Parameters
    ----------
    test, branches : the cycle
    value : of one cycle, such as `PerCycle.value`
    found : with the displacement as it is taken
    """
    other = test.displacement.alternative
    if other is None or isinstance(found, Failure):
        return {}
    moved = value(test, branches, other)
    return {} if isinstance(moved, Failure) else rectangle(found, moved)


def rectangle(found: Estimate, other: Estimate) -> Errors:
    """Error of a rectangle whose half width is what another assumption changes."""
    return {SHAPE: abs(other.value - found.value) / math.sqrt(3.0)}


def gap_at_peak(test: Evidence, branches: list[Branch], what: str) -> tuple[Reason, ...]:
    """Why the largest sample of a cycle is doubtful: those beside it are missing.

    Parameters
    ----------
    test, branches : the cycle
    what : ``force`` or ``displacement`` of the curve
    """
    curve = test.known_curve
    values = curve.force if what == "force" else curve.displacement
    over = test.sense_of(values) * values[stretch_of_cycle(test, branches)]
    if np.isnan(over).all():
        return ()
    top = int(np.nanargmax(over))
    if not np.isnan(over[max(top - 1, 0) : top + 2]).any():
        return ()
    message = f"samples beside the largest {what} of the cycle are missing"
    return (Reason("gap_at_peak", message),)


def _when(branches: list[Branch], reads: tuple[float, float]) -> Stretch | None:
    """Stretch of time of a part of a cycle, counted in branches; None where there is none."""
    if reads[0] >= len(branches):
        return None
    ends = []
    for at, number in ((reads[0], int(reads[0])), (reads[1], math.ceil(reads[1]) - 1)):
        part = branches[min(number, len(branches) - 1)]
        share = min(at - number, 1.0) if number < len(branches) else 1.0
        ends.append(part.start_time + share * (part.stop_time - part.start_time))
    return ends[0], ends[1]


def cut_short(
    test: Evidence, branches: list[Branch], quantities: tuple[str, ...] = ("force",)
) -> tuple[Reason, ...]:
    """Why a number is doubtful whose branches the record does not hold to their end.

    Parameters
    ----------
    test : knows where the record was cut
    branches : that the number needs, to their end
    quantities : that it rests on
    """
    ends = min((test.cut_at.get(each, np.inf) for each in quantities), default=np.inf)
    if not branches or ends == np.inf:
        return ()
    part, failure, curve = branches[-1], test.failure, test.known_curve
    if ends >= part.stop_time and part is not curve.branches[-1]:
        return ()
    if isinstance(failure, FailurePoint) and part.start <= failure.sample < part.stop:
        return ()  # it broke, so there is no more to come
    if quantities == ("force",) and _is_past_its_peak(test, part):
        return ()
    at = f"{ends:.3f} s" if curve.time_unit == "s" else f"sample {round(ends) + 1}"
    return (Reason("partial_cycle", f"the record ends at {at}, while still {part.direction}"),)


def _is_past_its_peak(test: Evidence, part: Branch) -> bool:
    """Whether the force had surely fallen again when the record ended."""
    force = test.known_curve.force
    known = (test.sense_of(force) * force)[part.start : part.stop]
    known = known[~np.isnan(known)]
    return len(known) > 0 and bool(known[-3:].max() < _PAST * known.max())


def stretch_of_cycle(test: Evidence, branches: list[Branch]) -> slice:
    """Samples of the curve from the turn where a cycle begins to that where it ends, both included.

    Where the motion rests between two cycles, they part at its extreme. A last loading without an
    unloading lasts as long as force is known: what is held belongs to it.
    """
    curve, last = test.known_curve, branches[-1]
    first, behind = (curve.branches.index(each) for each in (branches[0], last))
    start = _turn_before(test, first) if first else branches[0].start
    if behind + 1 < len(curve.branches):
        return slice(start, _turn_before(test, behind + 1) + 1)
    if last.direction is Direction.UNLOADING:
        return slice(start, last.stop)
    known = int(np.flatnonzero(~np.isnan(curve.force)).max(initial=0)) + 1
    return slice(start, max(known, last.stop))


def _turn_before(test: Evidence, number: int) -> int:
    """Sample at which the motion turns before a branch that is not the first one."""
    curve = test.known_curve
    rest = slice(curve.branches[number - 1].stop, curve.branches[number].start + 1)
    seen = test.sense_of(curve.displacement) * curve.displacement[rest]
    if np.isnan(seen).all():
        return rest.stop - 1
    is_top = curve.branches[number - 1].direction is Direction.LOADING
    return rest.start + int(np.nanargmax(seen) if is_top else np.nanargmin(seen))


@dataclass(frozen=True, slots=True, kw_only=True)
class Energy(PerCycle):
    """``energy.<cycle>`` (J): dissipated over one cycle."""

    result: ClassVar = "energy"
    outputs: ClassVar = (
        Output(
            "energy",
            "J",
            "Energy dissipated",
            (*CURVE, "start"),
            first=1,
            is_raised_by_slips=True,
        ),
    )
    whole: ClassVar = 2

    @property
    def method(self) -> str:
        """Of all cycles."""
        return "integral of force, trapezoids"

    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Integral of the force over a cycle."""
        if len(branches) < 2:
            return NO_UNLOADING
        curve, stretch = test.known_curve, stretch_of_cycle(test, branches)
        return loop_energy(
            curve.time[stretch],
            displacement[stretch],
            curve.force[stretch],
            clock_error=test.clocks.error,
        )

    def errors(self, test: Evidence, branches: list[Branch], found: Estimate) -> Errors:
        """Zero of the force, where the loop does not close, and its scale."""
        over = test.displacement.values[stretch_of_cycle(test, branches)]
        opened = test.raw_force.zero_error * float(over[-1] - over[0])
        return {"zero of the force": opened, **force_scale(test, found)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualDisplacement(PerCycle):
    """``residual_displacement.<cycle>`` (m): what is left when the force is gone."""

    result: ClassVar = "residual-displacement"
    outputs: ClassVar = (
        Output("residual_displacement", "m", "Residual displacement", CURVE, first=1),
    )
    force_below: Force
    reads: ClassVar = (1.0, 2.0)

    @property
    def method(self) -> str:
        """With the force below which it is read."""
        return f"displacement once the force is back at zero, within {self.force_below:g} N or less"

    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Displacement at zero force after unloading."""
        if len(branches) < 2:
            return NO_UNLOADING
        curve = test.known_curve
        unloading = slice(branches[1].start, branches[1].stop)
        return residual_after_unloading(
            curve.time[unloading],
            displacement[unloading],
            curve.force[unloading],
            force_below=self.force_below,
            zero_error=test.raw_force.zero_error,
            clock_error=test.clocks.error,
        )

    def errors(self, test: Evidence, branches: list[Branch], found: Estimate) -> Errors:
        """Zero of the displacement."""
        del branches, found
        return {"zero of the displacement": test.displacement.zero_error}


_FEW = 16
"""Samples below which it is unknown how far the noise remembers."""
_NOISE = 100_000
"""Samples before a turn that say what the noise of the force is like."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakForce(PerCycle):
    """``peak_force.<cycle>`` (N): the largest force of a cycle."""

    result: ClassVar = "peak-force"
    outputs: ClassVar = (
        Output("peak_force", "N", "Peak force", ("force",), first=1, is_raised_by_slips=True),
    )
    whole: ClassVar = 1
    reads: ClassVar = (0.0, 1.25)
    gap: ClassVar = "force"

    @property
    def method(self) -> str:
        """Of all cycles."""
        return "largest force of the cycle after the filter, in the sense of loading"

    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Largest sample of the force."""
        del displacement
        return peak_of_cycle(test, branches)

    def errors(self, test: Evidence, branches: list[Branch], found: Estimate) -> Errors:
        """Zero and scale of the force."""
        del branches
        return {"zero of the force": test.raw_force.zero_error, **force_scale(test, found)}


def peak_of_cycle(test: Evidence, branches: list[Branch]) -> Outcome:
    """Largest force of a cycle, N, without the uncertainty of zero and scale.

    Parameters
    ----------
    test : with its curve
    branches : of the cycle
    """
    sense = test.sense_of(test.known_curve.force)
    values = sense * _force_of_cycle(test, branches)
    peak = largest_sample(values, noise=_force_noise(test, branches[0]))
    if isinstance(peak, Failure):
        return peak
    peak = widened(peak, test.repair_error(before=branches[0].stop))
    return replace(peak, value=sense * peak.value)


def _force_of_cycle(test: Evidence, branches: list[Branch]) -> Floats:
    """All samples of the force over a cycle: on its own clock where that is another one."""
    curve, signal = test.known_curve, test.force
    stretch = stretch_of_cycle(test, branches)
    if signal.clock == test.clocks.curve:
        return curve.force[stretch]
    ends = curve.time[[stretch.start, min(stretch.stop, len(curve.time)) - 1]]
    first, last = (test.clocks.from_curve(float(at), signal.clock) for at in ends)
    return signal.values[slice(*np.searchsorted(signal.time, [first, last]))]


def _force_noise(test: Evidence, loading: Branch) -> float:
    """Standard deviation that the noise of the force has left after its filters, N."""
    raw = test.unfiltered or test.raw_force
    ends = (loading.start_time, loading.stop_time)
    first, last = (test.clocks.from_curve(at, raw.clock) for at in ends)
    start, stop = np.searchsorted(raw.time, [first, last])
    values = raw.values[max(int(start), int(stop) - _NOISE) : int(stop)]
    values = values[~np.isnan(values)]
    filters = test.signals.filters.get(test.signals.force, ())
    if not filters or len(values) < _FEW:
        return noise_level(values)
    passed = min(power_passed(act, len(values)) for act, _ in filters)
    return float(min(np.sqrt(passed * noise_power(values)), noise_level(values)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakDisplacement(PerCycle):
    """``peak_displacement.<cycle>`` (m): the largest displacement of a cycle."""

    result: ClassVar = "peak-displacement"
    outputs: ClassVar = (
        Output("peak_displacement", "m", "Displacement at the peak", ("displacement",), first=1),
    )
    whole: ClassVar = 1
    reads: ClassVar = (0.9, 1.1)
    gap: ClassVar = "displacement"

    @property
    def method(self) -> str:
        """Of all cycles."""
        return "largest displacement of the cycle, in the sense of loading"

    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Largest sample of the displacement."""
        sense = test.sense_of(displacement)
        values = sense * displacement[stretch_of_cycle(test, branches)]
        found = largest_sample(values, noise=noise_level(values))
        return found if isinstance(found, Failure) else replace(found, value=sense * found.value)

    def errors(self, test: Evidence, branches: list[Branch], found: Estimate) -> Errors:
        """Zero and scale of the displacement."""
        del branches
        signal = test.displacement
        return {
            "zero of the displacement": signal.zero_error,
            "scale of the displacement": signal.relative_error * found.value,
        }


KINDS = (PeakForce, PeakDisplacement, Energy, ResidualDisplacement)
