"""From the bench to results: every number with interval, status and reasons.

Each function gives the results of one entry of a protocol's list. The numbers come from
`cycle_numbers`; here they get their names, their uncertainty from the shape, and their status.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.cycle_numbers import (
    curve_of,
    energy_of,
    gap_at_top,
    loading_stiffness_of,
    peak_displacement_of,
    peak_force_of,
    residual_of,
    sense_over,
    stretch_of_cycle,
    unloading_stiffness_of,
)
from labpipe.pipeline.outcomes import (
    Asked,
    blocked_or,
    to_result,
    while_loading,
    with_force_scale,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Reason
from labpipe.records.result import Result

_ALL = ("force", "displacement", "clock")
_PAST = 0.9
"""Share of its largest value that a force has fallen below when its peak is over."""


def clock_results(bench: Bench) -> list[Result]:
    """``clock_offset`` (s) and ``clock_drift`` (1): force time against marker time."""
    fit = bench.clock_fit
    method = "how the clocks of force and motion were joined" if fit is None else fit.method
    offset: Estimate | Failure = blocked_or(bench, Failure("one_clock", "there is only one clock"))
    drift = offset
    if fit is not None:
        events = len(fit.event_times_motion)
        offset = Estimate(fit.offset, fit.offset_interval.standard_error, events)
        drift = Estimate(fit.drift, fit.drift_interval.standard_error, events)
        if np.isnan(fit.drift_interval.lower):
            drift = Failure("one_event", "one turning point gives an offset but no drift")
    return [
        to_result(bench, Asked("clock_offset", "s", ("clock",), method), offset),
        to_result(bench, Asked("clock_drift", "1", ("clock",), method), drift),
    ]


def peak_force(bench: Bench) -> list[Result]:
    """``peak_force.<cycle>`` (N): the largest force of the cycle."""
    method = "largest force of the cycle after the filter, in the sense of loading"
    asked = Asked("peak_force", "N", ("force",), method, needs=1, reads=(0, 1.25))
    return per_cycle(bench, asked, peak_force_of, seen=_gap_in_force)


def peak_displacement(bench: Bench) -> list[Result]:
    """``peak_displacement.<cycle>`` (m): the largest displacement of the cycle."""
    method = "largest displacement of the cycle, in the sense of loading"
    asked = Asked("peak_displacement", "m", ("displacement",), method, needs=1, reads=(0.9, 1.1))
    return per_cycle(bench, asked, peak_displacement_of, seen=_gap_in_displacement)


def energy(bench: Bench) -> list[Result]:
    """``energy.<cycle>`` (J): work dissipated over one cycle."""
    asked = Asked("energy", "J", (*_ALL, "start"), "integral of force, trapezoids", needs=2)
    return per_cycle(bench, asked, energy_of)


def residual_displacement(bench: Bench, *, force_below: float) -> list[Result]:
    """``residual_displacement.<cycle>`` (m): displacement left at zero force after unloading."""
    method = f"displacement once the force is back at zero, within {force_below:g} N or less"
    asked = Asked("residual_displacement", "m", _ALL, method, reads=(1, 2))
    return per_cycle(bench, asked, partial(residual_of, force_below=force_below))


def loading_stiffness(bench: Bench, *, name: str, low: float, high: float) -> list[Result]:
    """Stiffness (N/m) between two displacements of the first loading branch."""
    method = f"line from {low:g} m to {high:g} m of the first loading, time as instrument"
    number = partial(loading_stiffness_of, low=low, high=high)
    asked, first, during = Asked(name, "N/m", _ALL, method), bench.cycles()[:1], None
    outcome: Estimate | Failure = blocked_or(bench, Failure("no_cycle", "the motion has no branch"))
    if first:
        outcome = with_shape_error(bench, first[0], number)
        during = while_loading(bench, low, high)
    if isinstance(outcome, Estimate):
        bench.stiffnesses[name] = outcome
        bench.windows[name] = during
        outcome = with_force_scale(bench, outcome)
    return [to_result(bench, asked, outcome, during=during)]


def tip_travel_result(bench: Bench) -> list[Result]:
    """``tip_travel`` (m): the largest distance of the last point from where it began."""
    from labpipe.pipeline.marker_steps import tip_travel  # loaded by tests with markers alone

    method = "largest distance of the last point of the shape from its mean over five frames"
    return [
        to_result(bench, Asked("tip_travel", "m", ("displacement",), method), tip_travel(bench))
    ]


def unloading_stiffness(bench: Bench, *, over: float) -> list[Result]:
    """``unloading_stiffness.<cycle>`` (N/m) over the first stretch of the unloading branch."""
    method = f"line from {0.1 * over:g} m to {over:g} m off the peak, time as instrument"
    asked = Asked("unloading_stiffness", "N/m", _ALL, method, reads=(1, 2))
    return per_cycle(bench, asked, partial(unloading_stiffness_of, low=0.1 * over, high=over))


Numbers = Callable[[Bench, list[Branch], Floats], Estimate | Failure]
"""A number of one cycle, from the bench, the branches of the cycle and a displacement."""


Seen = Callable[[Bench, list[Branch]], Reason | None]
"""Why a number of one cycle is doubtful; None where it is not."""


def per_cycle(
    bench: Bench, asked: Asked, of_cycle: Numbers, *, seen: Seen | None = None
) -> list[Result]:
    """Results of one kind for all cycles; one failure where there is no cycle.

    Parameters
    ----------
    bench : with its stages
    asked : what is asked for; the name gets the number of the cycle
    of_cycle : the number of one cycle
    seen : what else makes it doubtful
    """
    cycles = bench.cycles()
    if not cycles:
        failure = blocked_or(bench, Failure("no_cycle", "the motion has no branch"))
        return [to_result(bench, asked, failure, part=".1")]
    return [
        to_result(
            bench,
            asked,
            with_shape_error(bench, branches, of_cycle),
            part=f".{branches[0].cycle}",
            doubts=[
                broken_off(bench, branches[: asked.needs], asked.quantities),
                seen(bench, branches) if seen else None,
            ],
            during=_when(branches, asked.reads),
        )
        for branches in cycles
    ]


def _gap_in_force(bench: Bench, branches: list[Branch]) -> Reason | None:
    return _gap(bench, branches, curve_of(bench).force, "force")


def _gap_in_displacement(bench: Bench, branches: list[Branch]) -> Reason | None:
    return _gap(bench, branches, curve_of(bench).displacement, "displacement")


def _gap(bench: Bench, branches: list[Branch], values: Floats, what: str) -> Reason | None:
    """Why the largest sample of a cycle is doubtful: those beside it are missing."""
    over = values[stretch_of_cycle(bench, branches)]
    if not gap_at_top(sense_over(bench, values) * over):
        return None
    message = f"samples beside the largest {what} of the cycle are missing"
    return Reason("gap_at_peak", message)


def _when(branches: list[Branch], reads: tuple[float, float]) -> tuple[float, float] | None:
    """Stretch of time of a part of a cycle, counted in branches; None where there is none."""
    if reads[0] >= len(branches):
        return None
    ends = []
    for at, number in ((reads[0], int(reads[0])), (reads[1], math.ceil(reads[1]) - 1)):
        part = branches[min(number, len(branches) - 1)]
        share = min(at - number, 1.0) if number < len(branches) else 1.0
        ends.append(part.start_time + share * (part.stop_time - part.start_time))
    return ends[0], ends[1]


def broken_off(
    bench: Bench, branches: list[Branch], quantities: tuple[str, ...] = ("force",)
) -> Reason | None:
    """Why a number is doubtful whose branches the record does not hold to their end.

    Parameters
    ----------
    bench : knows where the record was cut
    branches : that the number needs, to their end
    quantities : that it rests on
    """
    cut_at = min((bench.cut_at.get(each, np.inf) for each in quantities), default=np.inf)
    if not branches or cut_at == np.inf:
        return None
    part, failure = branches[-1], bench.failure
    if cut_at >= part.stop_time and part is not curve_of(bench).branches[-1]:
        return None
    if isinstance(failure, FailurePoint) and part.start <= failure.sample < part.stop:
        return None  # it broke, so there is no more to come
    if quantities == ("force",) and _is_past_its_peak(bench, part):
        return None
    has_time = curve_of(bench).time_unit == "s"
    at = f"{cut_at:.3f} s" if has_time else f"sample {round(cut_at) + 1}"
    return Reason("partial_cycle", f"the record ends at {at}, while still {part.direction}")


def _is_past_its_peak(bench: Bench, part: Branch) -> bool:
    """Whether the force had surely fallen again when the record ended."""
    force = curve_of(bench).force
    known = (sense_over(bench, force) * force)[part.start : part.stop]
    known = known[~np.isnan(known)]
    return len(known) > 0 and bool(known[-3:].max() < _PAST * known.max())


def with_shape_error(bench: Bench, branches: list[Branch], of_cycle: Numbers) -> Estimate | Failure:
    """Estimate, its error widened by what another shape would have given.

    Parameters
    ----------
    bench : with a curve
    branches : of the cycle
    of_cycle : the number of it
    """
    displacement = bench.signals[bench.displacement]
    estimate = of_cycle(bench, branches, displacement.values)
    if displacement.alternative is None or isinstance(estimate, Failure):
        return estimate
    other = of_cycle(bench, branches, displacement.alternative)
    if isinstance(other, Failure):
        return estimate
    change = abs(other.value - estimate.value) / np.sqrt(3.0)  # a rectangle of that half width
    return widened(estimate, change)
