"""Numbers of every cycle: where it is in the curve, its energy and residual displacement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.fits.loops import loop_energy, residual_after_unloading
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.records.declarations import CURVE, Force, Output
from labpipe.records.estimates import Estimate, Failure
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

_PAST = 0.9
"""Share of its largest value that a force has fallen below when its peak is over."""
NO_UNLOADING = Failure("partial_cycle", "the cycle has no unloading branch")


class NumberOfCycle(Protocol):
    """A number of one cycle, from a displacement that may be that of another shape."""

    def __call__(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Compute the number with the standard error of its fit, or say why not."""


class ErrorsOfCycle(Protocol):
    """Standard errors of a number of one cycle from outside its fit."""

    def __call__(self, test: Evidence, branches: list[Branch], value: float) -> Errors:
        """Tell the errors by what they come from."""


@dataclass(frozen=True, slots=True)
class CycleNumber:
    """How a number of every cycle is made.

    Parameters
    ----------
    value, errors : of one cycle
    method : in words
    needs : branches of a cycle that must have been recorded to their end
    reads : what of a cycle it is read from, from and to, counted in branches: 0.9 is when nine
        tenths of the loading are over, 1 its end, 2 the end of unloading
    gap : quantity whose samples beside its largest one must be known; empty for none
    """

    value: NumberOfCycle
    errors: ErrorsOfCycle
    method: str
    needs: int = 0
    reads: tuple[float, float] = (0.0, 2.0)
    gap: str = ""


def per_cycle(kind: Kind, test: Evidence, made: CycleNumber) -> Computed:
    """Compute a number for all cycles; one failure where there is no cycle.

    Parameters
    ----------
    kind : with one output
    test : with its curve
    made : how one cycle gives its number
    """
    if not test.cycles:
        return kind.not_available(blocked_or(test, NO_CYCLE), made.method)
    return Computed(tuple(_of_cycle(kind, test, made, branches) for branches in test.cycles))


def _of_cycle(kind: Kind, test: Evidence, made: CycleNumber, branches: list[Branch]) -> Number:
    (output,) = kind.outputs
    found = made.value(test, branches, test.displacement.values)
    errors = {} if isinstance(found, Failure) else made.errors(test, branches, found.value)
    doubts = cut_short(test, branches[: made.needs], output.rests_on)
    if made.gap:
        doubts += gap_at_peak(test, branches, made.gap)
    return kind.number(
        output,
        found,
        made.method,
        {**errors, **other_shape(test, branches, made.value, found)},
        during=_when(branches, made.reads),
        doubts=doubts,
        part=f".{branches[0].cycle}",
    )


def other_shape(
    test: Evidence, branches: list[Branch], value: NumberOfCycle, found: Outcome
) -> Errors:
    """Error from what a displacement under another assumption changes: a rectangle.

    Parameters
    ----------
    test, branches : as for `value`
    value : of one cycle
    found : with the displacement as it is taken
    """
    other = test.displacement.alternative
    if other is None or isinstance(found, Failure):
        return {}
    moved = value(test, branches, other)
    return {} if isinstance(moved, Failure) else rectangle(found, moved)


def rectangle(found: Estimate, other: Estimate) -> Errors:
    """Error of a rectangle whose half width is what another assumption changes."""
    return {"another displacement": abs(other.value - found.value) / math.sqrt(3.0)}


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
class Energy(Kind):
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

    def compute(self, test: Evidence) -> Computed:
        """Integral of the force over a cycle."""
        how = CycleNumber(_energy, _energy_errors, "integral of force, trapezoids", needs=2)
        return per_cycle(self, test, how)


def _energy(test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
    if len(branches) < 2:
        return NO_UNLOADING
    curve, stretch = test.known_curve, stretch_of_cycle(test, branches)
    return loop_energy(
        curve.time[stretch],
        displacement[stretch],
        curve.force[stretch],
        clock_error=test.clocks.error,
    )


def _energy_errors(test: Evidence, branches: list[Branch], value: float) -> Errors:
    over = test.displacement.values[stretch_of_cycle(test, branches)]
    opened = test.raw_force.zero_error * float(over[-1] - over[0])
    return {"zero of the force": opened, **force_scale(test, value)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualDisplacement(Kind):
    """``residual_displacement.<cycle>`` (m): what is left when the force is gone."""

    result: ClassVar = "residual-displacement"
    outputs: ClassVar = (
        Output("residual_displacement", "m", "Residual displacement", CURVE, first=1),
    )
    force_below: Force

    def compute(self, test: Evidence) -> Computed:
        """Displacement at zero force after unloading."""
        method = (
            f"displacement once the force is back at zero, within {self.force_below:g} N or less"
        )
        how = CycleNumber(self._value, _zero_of_displacement, method, reads=(1, 2))
        return per_cycle(self, test, how)

    def _value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
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


def _zero_of_displacement(test: Evidence, branches: list[Branch], value: float) -> Errors:
    del branches, value
    return {"zero of the displacement": test.displacement.zero_error}


KINDS = (Energy, ResidualDisplacement)
