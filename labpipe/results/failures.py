"""What happened in a tensile test: failure, energy up to it, slips, slack.

Failure and energy are read from the loading branch in which it broke, all else from the first one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from labpipe.fits.failure_point import FailurePoint, energy_to_break
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction, SlipDecision
from labpipe.records.declarations import CURVE, Needs, Output
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Reason
from labpipe.records.signals import Stretch
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import (
    NO_LOADING,
    Computed,
    Kind,
    blocked_or,
    force_scale,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureResult(Kind):
    """``failure_displacement`` (m) and ``failure_force`` (N): where the specimen fails."""

    result: ClassVar = "failure"
    outputs: ClassVar = (
        Output("failure_displacement", "m", "Displacement at failure", ("displacement",)),
        Output("failure_force", "N", "Force at failure", ("force",), is_raised_by_slips=True),
    )
    needs: ClassVar = Needs(branches=True, correction="failure")

    def compute(self, test: Evidence) -> Computed:
        """The last point before the final loss of force."""
        methods = (
            "first sample of the final loss of force; the interval reaches to the next one",
            "force at the first sample of the final loss",
        )
        failure = _failure(test)
        if isinstance(failure, Failure):
            return self.not_available(failure, *methods)
        zero = {"zero of the displacement": test.displacement.zero_error, "slack": test.slack_error}
        zero_of_force = {"zero of the force": test.raw_force.zero_error}
        doubts, during = _in_steps(failure), _up_to(test, failure)
        place = self.number(
            failure.displacement,
            methods[0],
            zero,
            during=(during[1], during[1]),
            doubts=doubts,
        )
        force = self.number(
            failure.force,
            methods[1],
            {**zero_of_force, **force_scale(test, failure.force)},
            output=1,
            during=during,
            doubts=doubts,
        )
        return Computed((place, force))


def _failure(test: Evidence) -> FailurePoint | Failure:
    return test.failure or blocked_or(test, NO_LOADING)


def _up_to(test: Evidence, failure: FailurePoint) -> Stretch:
    """From the begin of the loading in which it broke to the failure, s."""
    curve = test.known_curve
    start = loading_before(curve, failure.sample).start
    return float(curve.time[start]), float(curve.time[failure.sample])


def loading_before(curve: Curve, sample: int) -> Branch:
    """The last loading branch that begins at a sample or before it; the first one before all."""
    loading = [each for each in curve.branches if each.direction is Direction.LOADING]
    return [each for each in loading if each.start <= sample or each is loading[0]][-1]


def _in_steps(failure: FailurePoint) -> tuple[Reason, ...]:
    """Why a failure is doubtful that was not the first sudden loss of force."""
    if failure.lost_before == 0.0:
        return ()
    message = (
        "some of the force was suddenly lost before, and it never came back to where it had been"
    )
    return (Reason("lost_in_steps", message),)


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyToBreak(Kind):
    """``energy_to_break`` (J): work done up to the failure."""

    result: ClassVar = "energy-to-break"
    outputs: ClassVar = (
        Output(
            "energy_to_break", "J", "Energy to break", (*CURVE, "start"), is_raised_by_slips=True
        ),
    )
    needs: ClassVar = Needs(branches=True, correction="failure")

    def compute(self, test: Evidence) -> Computed:
        """Integral of the force up to the failure."""
        method = "integral of force up to the failure, trapezoids"
        failure = _failure(test)
        if isinstance(failure, Failure):
            return self.not_available(failure, method)
        curve = test.known_curve
        branch = loading_before(curve, failure.sample)
        stretch = slice(branch.start, failure.sample + 1)
        point = replace(failure, sample=failure.sample - branch.start)
        found = energy_to_break(curve.displacement[stretch], curve.force[stretch], point)
        if isinstance(found, Failure):
            return self.not_available(found, method)
        way = curve.displacement[failure.sample] - curve.displacement[branch.start]
        errors = {
            "zero of the force": test.raw_force.zero_error * float(way),
            "slips added back": _repaired_work(test, curve.displacement, failure.sample),
            **force_scale(test, found),
        }
        doubts, during = _in_steps(failure), _up_to(test, failure)
        number = self.number(found, method, errors, during=during, doubts=doubts)
        return Computed((number,))


def _repaired_work(test: Evidence, displacement: Floats, last: int) -> float:
    """Standard error of the work, J, that drops added back have done up to a sample."""
    ways = [
        slip.drop_interval.standard_error * float(displacement[last] - slip.position)
        for slip in test.slips
        if slip.decision is SlipDecision.REPAIRED and slip.start < last
    ]
    return float(np.linalg.norm(ways))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipResults(Kind):
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N): of each slip; there may be none."""

    result: ClassVar = "slips"
    outputs: ClassVar = (
        Output("slip_position", "m", "Position of slip", ("displacement",), first=1),
        Output("slip_drop", "N", "Force lost in slip", ("force",), first=1),
    )
    needs: ClassVar = Needs(branches=True, correction="slips")

    def compute(self, test: Evidence) -> Computed:
        """Two parallel lines around each sudden fall of the force, from the slip ledger."""
        numbers = []
        for count, slip in enumerate(test.slips, start=1):
            method = f"two parallel lines around a sudden fall of the force; {slip.decision}"
            time, at, drop = test.known_curve.time, slip.position_interval, slip.drop_interval
            place = Estimate(slip.position, at.standard_error, 1, at)
            lost = Estimate(slip.drop, drop.standard_error, 1, drop)
            during = (float(time[slip.start]), float(time[slip.stop]))
            part, slack, scale = f".{count}", {"slack": test.slack_error}, force_scale(test, lost)
            numbers += [
                self.number(place, method, slack, during=during, part=part),
                self.number(lost, method, scale, output=1, during=during, part=part),
            ]
        return Computed(tuple(numbers))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlackResult(Kind):
    """``slack`` (m): displacement before the specimen is taut."""

    result: ClassVar = "slack"
    outputs: ClassVar = (Output("slack", "m", "Slack", ("displacement",)),)
    needs: ClassVar = Needs(branches=True, correction="slack")

    def compute(self, test: Evidence) -> Computed:
        """Displacement at which the line of the linear region meets zero force."""
        number = self.number(
            test.slack or blocked_or(test, NO_LOADING),
            "toe compensation, ASTM D638 annex A1",
            {"zero of the displacement": test.displacement.zero_error},
            during=test.while_loading(),
        )
        return Computed((number,))


KINDS = (FailureResult, EnergyToBreak, SlipResults, SlackResult)
