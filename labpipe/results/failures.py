"""Events of a tensile test: failure, energy up to it, slips, slack.

Failure and energy are read from the loading branch of the failure, all else from the first one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from labpipe.fits.failure_point import FailurePoint, last_above
from labpipe.records.arrays import Floats
from labpipe.records.causes import SCALE_OF_DISPLACEMENT, SLACK
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import CURVE, Needs, Output
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Reason
from labpipe.records.signals import Stretch
from labpipe.results.cycles import sense_of, work_over
from labpipe.results.kinds import (
    NO_LOADING,
    Computed,
    Kind,
    blocked_or,
    force_scale,
)
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.slack_correction import doubts_of_slack
from labpipe.uncertainty.autocorrelation import fast_noise
from labpipe.uncertainty.extractors import Reading, Trace
from labpipe.uncertainty.intervals import Measured


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureResult(Kind):
    """``failure_displacement`` (m) and ``failure_force`` (N): where the specimen fails."""

    result: ClassVar = "failure"
    outputs: ClassVar = (
        Output("failure_displacement", "m", "Displacement at failure", ("displacement", "force")),
        Output("failure_force", "N", "Force at failure", ("force",), is_raised_by_slips=True),
    )
    needs: ClassVar = Needs(branches=True, correction="failure")

    def compute(self, test: ReducedTest) -> Computed:
        """Compute displacement and force at the last sample before the final loss of force."""
        failure = _failure(test)
        methods = (
            "first sample of the final loss of force; the interval reaches to the next one",
            "force at the first sample of the final loss",
        )
        if isinstance(failure, FailurePoint) and failure.slow_below is not None:
            share = f"{failure.slow_below:.0%} of the peak, which is lost slowly"
            methods = f"last sample with {share}", f"force at the last sample with {share}"
        if isinstance(failure, Failure):
            return self.not_available(failure, *methods)
        outcome = test.measure(partial(_at_failure, test))
        if isinstance(outcome, Failure):
            return self.not_available(outcome, *methods)
        doubts, during = _doubts_of_steps(failure), _until_failure(test, failure)
        at_end = (during[1], during[1])
        place = self.number(outcome[0], methods[0], during=at_end, doubts=doubts)
        force = self.number(outcome[1], methods[1], output=1, during=during, doubts=doubts)
        return Computed((place, force))


def _at_failure(test: ReducedTest, trace: Trace) -> Reading | Failure:
    """Choose the samples for displacement and force at the failure, up to a step after its sample.

    If that sample has already lost force, the specimen failed in the step before it: the force was
    that of the sample before, or up to a step more.
    """
    sample = trace.failed_at
    if sample is None:
        return blocked_or(test, NO_LOADING)
    if isinstance(test.failure, FailurePoint) and test.failure.slow_below is not None:
        return _at_slow_loss(test.failure.slow_below, trace)
    step, rise = _next_step(trace, sample)
    fall, is_clear = _loss_before(test)
    ahead, lost = (rise, fall) if is_clear else (rise + fall, 0.0)

    def numbers(trace: Trace) -> tuple[Floats, Floats]:
        place = trace.displacement[..., sample] + trace.beyond * step
        return place, trace.force[..., sample] + trace.beyond * ahead

    def in_noise(trace: Trace) -> tuple[Floats, Floats]:
        place, force = numbers(trace)
        return place, force - lost

    return Reading(numbers, 1, in_noise)


def _at_slow_loss(share: float, trace: Trace) -> Reading:
    """Choose the sample at which each curve falls below a share of its peak."""
    sense = sense_of(trace, trace.force)

    def numbers(trace: Trace) -> tuple[Floats, Floats]:
        finite = np.flatnonzero(~np.isnan(trace.force.reshape(-1, trace.force.shape[-1])[0]))
        force, place = trace.force[..., finite], trace.displacement[..., finite]
        last = last_above(sense * force, share)[..., np.newaxis]
        ends = (np.take_along_axis(values, last, axis=-1)[..., 0] for values in (place, force))
        step = np.gradient(place, axis=-1)
        more = trace.beyond * np.take_along_axis(step, last, axis=-1)[..., 0]
        here, there = ends
        return here + more, there

    return Reading(numbers, 1)


def _loss_before(test: ReducedTest) -> tuple[float, bool]:
    """Return the force lost in the step before the failure, N, and whether it is above noise.

    A loss above noise is the start of a loss over several samples.
    """
    failure, curve = test.failure, test.known_curve
    if not isinstance(failure, FailurePoint) or failure.sample == 0:
        return 0.0, False
    sense = sense_of(curve, curve.force)
    fall = sense * float(curve.force[failure.sample - 1] - curve.force[failure.sample])
    if not fall > 0.0:
        return 0.0, False
    before = curve.force[: failure.sample]
    before = before[~np.isnan(before)]
    is_clear = len(before) >= 8 and fall > 6.0 * float(fast_noise(before))
    return sense * fall, bool(is_clear)


def _next_step(trace: Trace, sample: int) -> tuple[float, float]:
    """Return the changes of displacement (m) and force (N) in one step after a sample."""
    ahead = trace.displacement[sample + 1 :]
    ahead = ahead[~np.isnan(ahead)]
    step = max(float(ahead[0] - trace.displacement[sample]), 0.0) if len(ahead) else 0.0
    before = trace.force[:sample]
    before = before[~np.isnan(before)]
    return step, float(trace.force[sample] - before[-1]) if len(before) else 0.0


def _failure(test: ReducedTest) -> FailurePoint | Failure:
    return test.failure or blocked_or(test, NO_LOADING)


def _until_failure(test: ReducedTest, failure: FailurePoint) -> Stretch:
    """Return the time from the start of the loading of the failure to the failure, s."""
    curve = test.known_curve
    start = loading_before(curve, failure.sample).start
    return float(curve.time[start]), float(curve.time[failure.sample])


def loading_before(curve: Curve | Trace, sample: int) -> Branch:
    """Return the last loading branch that begins by a sample, or else the first one."""
    loading = [branch for branch in curve.branches if branch.direction is Direction.LOADING]
    return [part for part in loading if part.start <= sample or part is loading[0]][-1]


def _doubts_of_steps(failure: FailurePoint) -> tuple[Reason, ...]:
    """Return a doubt if the failure was not the first sudden loss of force."""
    if failure.lost_before == 0.0:
        return ()
    message = "a part of the force was suddenly lost before, and never recovered"
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

    def compute(self, test: ReducedTest) -> Computed:
        """Integrate the force up to the failure."""
        method = "integral of force up to the failure, trapezoids"
        failure = _failure(test)
        if isinstance(failure, Failure):
            return self.not_available(failure, method)
        outcome = test.measure(partial(_work, test))
        if isinstance(outcome, Failure):
            return self.not_available(outcome, method)
        doubts, during = _doubts_of_steps(failure), _until_failure(test, failure)
        return Computed((self.number(outcome[0], method, during=during, doubts=doubts),))


def _work(test: ReducedTest, trace: Trace) -> Reading | Failure:
    """Choose the samples for the work up to the failure."""
    sample = trace.failed_at
    if sample is None:
        return blocked_or(test, NO_LOADING)
    work = work_over(trace, slice(loading_before(trace, sample).start, sample + 1))
    if isinstance(work, Failure):
        return work
    step, _ = _next_step(trace, sample)

    def numbers(trace: Trace) -> tuple[Floats]:
        more = trace.beyond * step * trace.force[..., sample]
        return (np.asarray(work.numbers(trace)[0] + more, dtype=np.float64),)

    return Reading(numbers, work.n)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipResults(Kind):
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N): of each slip; there may be none."""

    result: ClassVar = "slips"
    outputs: ClassVar = (
        Output("slip_position", "m", "Position of slip", ("displacement",), first=1),
        Output("slip_drop", "N", "Force lost in slip", ("force",), first=1),
    )
    needs: ClassVar = Needs(branches=True, correction="slips")

    def compute(self, test: ReducedTest) -> Computed:
        """Return position and drop of each slip of the ledger."""
        numbers = []
        for count, slip in enumerate(test.slips, start=1):
            method = f"two parallel lines around a sudden fall of the force; {slip.decision}"
            time, at, drop = test.known_curve.time, slip.position_interval, slip.drop_interval
            place = Estimate(slip.position, at.standard_error, 1, at)
            lost = Estimate(slip.drop, drop.standard_error, 1, drop)
            during = (float(time[slip.start]), float(time[slip.stop]))
            part, scale = f".{count}", force_scale(test, lost)
            travelled = test.displacement.relative_error * abs(place.value)
            slack = {SLACK: test.slack_error, SCALE_OF_DISPLACEMENT: travelled}
            doubts = doubts_of_slack(test.slack) if isinstance(test.slack, Measured) else ()
            numbers += [
                self.number(place, method, slack, during=during, doubts=doubts, part=part),
                self.number(lost, method, scale, output=1, during=during, part=part),
            ]
        return Computed(tuple(numbers))


@dataclass(frozen=True, slots=True, kw_only=True)
class SlackResult(Kind):
    """``slack`` (m): displacement before the specimen is taut."""

    result: ClassVar = "slack"
    outputs: ClassVar = (Output("slack", "m", "Slack", ("displacement",), can_be_negative=True),)
    needs: ClassVar = Needs(branches=True, correction="slack")

    def compute(self, test: ReducedTest) -> Computed:
        """Return the displacement at which the line of the linear region meets zero force."""
        number = self.number(
            test.slack or blocked_or(test, NO_LOADING),
            "toe compensation, ASTM D638 annex A1",
            during=test.while_loading(),
        )
        return Computed((number,))


KINDS = (FailureResult, EnergyToBreak, SlipResults, SlackResult)
