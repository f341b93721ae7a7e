"""What happened in a tensile test: failure, energy up to it, slips, slack; what the frame gives.

Each function gives the results of one entry of a protocol's list. Failure and energy are read from
the loading branch in which it broke, all else from the first one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.fits.failure_point import FailurePoint, energy_to_break
from labpipe.fits.straight_lines import fit_compliance
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import loading_before, loading_stretch
from labpipe.pipeline.cycle_numbers import curve_of
from labpipe.pipeline.outcomes import (
    CURVE,
    NO_BRANCH,
    Asked,
    blocked_or,
    slack_error,
    to_result,
    while_loading,
    with_force_scale,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import SlipDecision
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Reason
from labpipe.records.result import Result


def failure_results(bench: Bench) -> list[Result]:
    """``failure_displacement`` (m) and ``failure_force`` (N): the last point before the loss."""
    method = "first sample of the final loss of force; the interval reaches to the next one"
    asked = Asked("failure_displacement", "m", ("displacement",), method)
    by_force = Asked(
        "failure_force", "N", ("force",), "force at the first sample of the final loss"
    )
    failure = _failure(bench)
    if isinstance(failure, Failure):
        return [to_result(bench, each, failure) for each in (asked, by_force)]
    zero = bench.signals[bench.displacement].zero_error
    place = widened(failure.displacement, zero, slack_error(bench))
    force = widened(failure.force, bench.raw[bench.force].zero_error)
    doubts, during = [_in_steps(failure)], _up_to(bench, failure)
    return [
        to_result(bench, asked, place, doubts=doubts, during=(during[1], during[1])),
        to_result(bench, by_force, with_force_scale(bench, force), doubts=doubts, during=during),
    ]


def _up_to(bench: Bench, failure: FailurePoint) -> tuple[float, float]:
    """From the begin of the loading in which it broke to the failure, s."""
    curve = curve_of(bench)
    start = loading_before(curve, failure.sample).start
    return float(curve.time[start]), float(curve.time[failure.sample])


def _in_steps(failure: FailurePoint) -> Reason | None:
    """Why a failure is doubtful that was not the first sudden loss of force."""
    if failure.lost_before == 0.0:
        return None
    return Reason(
        "lost_in_steps",
        "some of the force was suddenly lost before, and it never came back to where it had been",
    )


def energy_to_break_result(bench: Bench) -> list[Result]:
    """``energy_to_break`` (J): work done on the specimen up to its failure."""
    method = "integral of force up to the failure, trapezoids"
    asked = Asked("energy_to_break", "J", (*CURVE, "start"), method)
    failure = _failure(bench)
    if isinstance(failure, Failure):
        return [to_result(bench, asked, failure)]
    curve = curve_of(bench)
    branch = loading_before(curve, failure.sample)
    stretch = slice(branch.start, failure.sample + 1)
    point = replace(failure, sample=failure.sample - branch.start)
    found = energy_to_break(curve.displacement[stretch], curve.force[stretch], point)
    if isinstance(found, Failure):
        return [to_result(bench, asked, found)]
    way = curve.displacement[failure.sample] - curve.displacement[branch.start]
    zero = bench.raw[bench.force].zero_error * float(way)
    added = _repaired_work(bench, curve.displacement, failure.sample)
    energy = with_force_scale(bench, widened(found, zero, added))
    during = _up_to(bench, failure)
    return [to_result(bench, asked, energy, doubts=[_in_steps(failure)], during=during)]


def _repaired_work(bench: Bench, displacement: Floats, last: int) -> float:
    """Standard error of the work, J, that drops added back have done up to a sample."""
    ways = [
        slip.drop_interval.standard_error * float(displacement[last] - slip.position)
        for slip in bench.slips
        if slip.decision is SlipDecision.REPAIRED and slip.start < last
    ]
    return float(np.linalg.norm(ways))


def _failure(bench: Bench) -> FailurePoint | Failure:
    return bench.failure or blocked_or(bench, NO_BRANCH)


def slip_results(bench: Bench) -> list[Result]:
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N) of the slip ledger."""
    results: list[Result] = []
    for number, slip in enumerate(bench.slips, start=1):
        method = "two parallel lines around a sudden fall of the force"
        at = Asked("slip_position", "m", ("displacement",), f"{method}; {slip.decision}")
        drop = Asked("slip_drop", "N", ("force",), f"{method}; {slip.decision}")
        interval = slip.position_interval
        place = Estimate(slip.position, interval.standard_error, 1, interval)
        lost = Estimate(slip.drop, slip.drop_interval.standard_error, 1, slip.drop_interval)
        place = widened(place, slack_error(bench))
        part, time = f".{number}", curve_of(bench).time
        during = (float(time[slip.start]), float(time[slip.stop]))
        results += [
            to_result(bench, at, place, part=part, during=during),
            to_result(bench, drop, with_force_scale(bench, lost), part=part, during=during),
        ]
    return results


def slack_result(bench: Bench) -> list[Result]:
    """``slack`` (m): displacement at which the line of the linear region meets zero force."""
    asked = Asked("slack", "m", ("displacement",), "toe compensation, ASTM D638 annex A1")
    slack = bench.slack or blocked_or(bench, NO_BRANCH)
    if isinstance(slack, Estimate):
        slack = widened(slack, bench.signals[bench.displacement].zero_error)
    return [to_result(bench, asked, slack, during=while_loading(bench))]


def compliance_result(bench: Bench, *, low: float, high: float) -> list[Result]:
    """``compliance`` (m/N) of frame and grips, the bar taken for rigid."""
    method = f"displacement against force from {low:g} N to {high:g} N, the bar taken for rigid"
    asked = Asked("compliance", "m/N", CURVE, method)
    if not bench.cycles():
        return [to_result(bench, asked, blocked_or(bench, NO_BRANCH))]
    curve, stretch = curve_of(bench), loading_stretch(bench)
    found = fit_compliance(curve.displacement[stretch], curve.force[stretch], start=low, stop=high)
    outcome = found if isinstance(found, Failure) else with_force_scale(bench, found)
    return [to_result(bench, asked, outcome, during=while_loading(bench))]
