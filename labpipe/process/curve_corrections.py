"""The curve: force and displacement on one clock, and what frame, grips and slack add to it.

They follow one another in the order of the protocol's keys, on the curve as it was split into
branches; the aligned signals stay as measured.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from labpipe.errors import ProcessingError, error_text
from labpipe.fits.failure_point import (
    FailurePoint,
    LossOfForce,
    final_loss,
    lost_earlier,
    slow_loss,
)
from labpipe.fits.grip_slips import add_back, find_slips, samples_before
from labpipe.fits.loops import sense_of_loading
from labpipe.fits.straight_lines import correct_displacement
from labpipe.process.motion import Motion
from labpipe.protocol.schema import CurveBlock, MachineCompliance
from labpipe.protocol.schema import Slack as SlackBlock
from labpipe.protocol.schema import Slips as SlipsBlock
from labpipe.records.arrays import Floats
from labpipe.records.causes import COMPLIANCE
from labpipe.records.curve import Aligned, Branch, Curve, Direction, Series, Slip, SlipDecision
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, blocking, doubtful, info_note, warning
from labpipe.records.signals import Signal, Signals
from labpipe.results.curve_replicates import loading_of, replicate_curves, traced
from labpipe.results.failures import loading_before
from labpipe.results.load_cell_noise import cuts_of
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.slack_correction import counted_from_taut, slack_of
from labpipe.signal.bad_samples import bridge_spikes, find_spikes
from labpipe.signal.filters import in_pieces
from labpipe.signal.turning_points import branch_numbers
from labpipe.uncertainty.extractors import Decide, Trace
from labpipe.uncertainty.intervals import Measured

_MAY_FALL = 0.025
"""Share of the curves with such noise in which a force that surely rises may fall."""
Corrected: TypeAlias = tuple[ReducedTest, list[Finding]]


def aligned(test: ReducedTest) -> Aligned:
    """Sample all raw signals at the times of the displacement; the curve's own by its words."""
    time = test.displacement.time
    series = {
        test.signals.quantities.get(name, name): Series(
            test.clocks.sampled(signal, time), signal.unit
        )
        for name, signal in test.signals.raw.items()
    }
    return Aligned(time, series, test.clocks.force, test.displacement.time_unit)


def put_together(
    test: ReducedTest, unfiltered: Signal, motion: Motion
) -> tuple[Curve | None, list[Finding]]:
    """Put force and displacement on one clock: the curve; none where the records do not overlap.

    Parameters
    ----------
    test : with clocks that are joined
    unfiltered : the force, outliers bridged
    motion : its branches
    """
    displacement = test.displacement
    time = displacement.time
    force = test.clocks.sampled(unfiltered, time)  # filtered once its corners are known
    if np.isnan(force).all():
        force_time = test.force.time
        message = (
            f"force from {force_time[0]:.3f} s to {force_time[-1]:.3f} s and motion from "
            f"{time[0]:.3f} s to {time[-1]:.3f} s do not overlap"
        )
        return None, [blocking("no_overlap", "align", message)]
    moved = tuple(_on_clock(branch, motion.signal.time, time) for branch in motion.branches)
    branch, cycle = branch_numbers(len(time), moved)
    return Curve(time, displacement.values, force, branch, cycle, moved, displacement.time_unit), []


def _on_clock(branch: Branch, motion_time: Floats, time: Floats) -> Branch:
    """Count a branch in samples of another time axis on the same clock."""
    if len(motion_time) == len(time):
        return branch
    last = min(branch.stop, len(motion_time)) - 1
    start, stop = np.searchsorted(time, [motion_time[branch.start], motion_time[last]])
    return Branch(
        int(start), int(stop), branch.cycle, branch.direction, branch.start_time, branch.stop_time
    )


def correct_curve(test: ReducedTest, block: CurveBlock) -> Corrected:
    """Correct the curve as the protocol says.

    Parameters
    ----------
    test : with a curve of unfiltered force
    block : of the protocol

    Returns
    -------
    With another curve and displacement, with failure, slips and slack; and what was done.
    """
    rule = None
    if block.failure is not None:
        failure = block.failure
        rule = LossOfForce(failure.force_below, failure.loss, failure.within)
    lost = (
        None if rule is None else final_loss_of(test, rule)
    )  # seen on the unfiltered force, which no filter has blurred
    test, found = _filtered_in_pieces(test, lost), list[Finding]()
    if block.compliance is not None and block.compliance.value > 0.0:
        test, found = _without_compliance(test, block.compliance)
    if rule is not None and test.curve is not None:
        test = replace(test, failure=_failure(test.curve, lost, rule))
    if block.slips is not None:
        test, more = _with_slips(test, block.slips)
        found += more
    test = replace(test, replicates=replicate_curves(test))
    if block.slack is not None:
        test, more = _without_slack(test, block.slack)
        found += more
    # Reported last: slack moves the place that displacement counts from.
    where = test.signals.force
    return test, [*found, *(warning(f"slip_{x.decision}", where, _said(x)) for x in test.slips)]


def without_outliers(signals: Signals) -> tuple[Signal, list[Finding]]:
    """Put single bad samples of the force on the line between their neighbours.

    Parameters
    ----------
    signals : the raw force is used, and stays

    Returns
    -------
    The unfiltered force on its own clock, and a note.
    """
    signal = signals.raw[signals.force]
    outliers = find_spikes(signal.values)
    if not len(outliers):
        return signal, []
    first = int(outliers[0])
    at = f"at {signal.time[first]:.3f} s" if signal.has_time else f"in sample {first + 1}"
    message = (
        f"{len(outliers)} samples far off their neighbours, the first {signal.values[first]:.4g} N "
        f"{at}: put on the line between them"
    )
    bridge = replace(signal, values=bridge_spikes(signal.values, outliers))
    return bridge, [warning("stray_samples", signals.force, message)]


def _without_compliance(test: ReducedTest, compliance: MachineCompliance) -> Corrected:
    """Displacement of the specimen alone, and what it is with another compliance."""
    curve = test.curve
    if curve is None:
        return test, []
    value = compliance.value
    less = partial(correct_displacement, force=curve.force, compliance=value)
    signal = test.displacement.changed(less)
    _refuse_backwards(test, curve, signal.values, value)
    if compliance.uncertainty:
        higher = value * (1.0 + compliance.uncertainty)
        other = correct_displacement(curve.displacement, curve.force, compliance=higher)
        signal = replace(signal, moved={**signal.moved, COMPLIANCE: other})
    most = 1e6 * value * float(np.nanmax(np.abs(curve.force)))
    message = (
        f"{1e6 * value:.4g} um/N x force taken off the displacement, {most:.4g} um at the most"
    )
    made = replace(_with_displacement(test, curve, signal), compliance=value)
    return made, [info_note("compliance_removed", test.signals.displacement, message)]


def _refuse_backwards(test: ReducedTest, curve: Curve, corrected: Floats, value: float) -> None:
    """Refuse a compliance that is more than frame and specimen give way together."""
    branch = test.first_loading
    if branch is None:
        return
    top = branch.start + int(np.nanargmax(curve.force[branch.start : branch.stop]))
    loading = slice(branch.start, top + 1)
    blocks = np.array_split(corrected[loading], min(20, top + 1 - branch.start))
    if np.all(np.diff([np.nanmean(block) for block in blocks]) > 0.0):
        return
    way = float(curve.displacement[top] - curve.displacement[branch.start])
    pull = float(curve.force[top] - curve.force[branch.start])
    message = error_text(
        "curve.compliance",
        "",
        expected=f"a compliance below that of this test, {1e6 * way / pull:.4g} um/N on the way up",
        found=f"{1e6 * value:.4g} um/N, with which the specimen would get shorter",
        remedy="Look at its unit, and at the test of the stiff bar it comes from.",
    )
    raise ProcessingError(message)


def final_loss_of(test: ReducedTest, rule: LossOfForce) -> int | Failure | None:
    """Find the sample of the curve at which the force begins to be lost.

    Parameters
    ----------
    test : with a curve
    rule : by which it is lost

    Returns
    -------
    Its number, or why it is lost nowhere; None without a loading.
    """
    curve, branch = test.curve, test.first_loading
    if curve is None or branch is None:
        return None
    after = slice(branch.start, None)
    is_back = np.zeros(len(curve.time), dtype=np.bool_)
    for point in curve.branches:
        is_back[point.start : point.stop] = point.direction is Direction.UNLOADING
    force = _sense(curve) * curve.force[after]
    found = final_loss(curve.time[after], force, rule, is_back[after])
    return found if isinstance(found, Failure) else found + branch.start


def _failure(
    curve: Curve, lost: int | Failure | None, rule: LossOfForce
) -> FailurePoint | Failure | None:
    if isinstance(lost, Failure) and lost.code == "no_break":
        up = slice(curve.branches[0].start, None)
        sense = sense_of_loading(curve.displacement[up])
        at = slow_loss(sense * curve.displacement[up], _sense(curve) * curve.force[up], rule)
        return lost if at is None else FailurePoint(up.start + at, slow_below=rule.force_below)
    if lost is None or isinstance(lost, Failure):
        return lost
    up = slice(loading_before(curve, lost).start, lost + 1)
    return FailurePoint(lost, lost_earlier(curve.time[up], _sense(curve) * curve.force[up], rule))


def _sense(curve: Curve) -> float:
    """Which way the force goes when the specimen is loaded for the first time."""
    first = curve.branches[0]
    return sense_of_loading(curve.force[first.start : first.stop])


def _filtered_in_pieces(test: ReducedTest, lost: int | Failure | None) -> ReducedTest:
    """Filter force and displacement anew, each branch by itself: their corners are known now."""
    curve, signals = test.curve, test.signals
    names = {"force": signals.force, "displacement": signals.displacement}
    if curve is None or not set(names.values()) & signals.filters.keys():
        return test
    ends = [at for branch in curve.branches for at in (branch.start_time, branch.stop_time)]
    ends += [float(curve.time[lost])] if isinstance(lost, int) else []
    raw = {**signals.raw, signals.force: test.unfiltered or test.raw_force}
    changed = {"force": curve.force, "displacement": curve.displacement}
    for quantity, name in names.items():
        if name in signals.filters:
            cuts = cuts_of(test.clocks, ends, raw[name])
            made = raw[name].changed(partial(in_pieces, cuts=cuts, filters=signals.filters[name]))
            filtered = replace(signals.filtered[name], values=made.values, moved=made.moved)
            signals = signals.with_filtered(name, filtered)
            time = signals.filtered[signals.displacement].time
            changed[quantity] = test.clocks.sampled(filtered, time)
    corrected = replace(curve, force=changed["force"], displacement=changed["displacement"])
    return replace(test, signals=signals, curve=corrected)


def _with_slips(test: ReducedTest, block: SlipsBlock) -> Corrected:
    curve, stretch = test.curve, test.loading_stretch
    if curve is None or stretch.stop <= stretch.start:
        return test, []
    decision = SlipDecision(block.decision)
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    found = find_slips(displacement, force, min_drop=block.min_drop, decision=decision)
    if isinstance(found, Failure):
        return test, [warning("slips_not_looked_for", test.signals.force, found.message)]
    slips = tuple(
        replace(slip, start=slip.start + stretch.start, stop=slip.stop + stretch.start)
        for slip in found
    )
    test = replace(test, slips=slips)
    if slips and decision is SlipDecision.REPAIRED:
        return _repaired(test, curve), []
    return _cut(test, curve) if slips and decision is SlipDecision.CUT else test, []


def _said(slip: Slip) -> str:
    done = {
        SlipDecision.MARKED: "the curve stays as measured",
        SlipDecision.REPAIRED: "added back to all that follows",
        SlipDecision.CUT: "the curve ends before it",
    }
    where = f"{1e3 * slip.position:.4g} mm"
    return (
        f"the force falls suddenly by {slip.drop:.3g} N at {where}, as when a specimen slips in "
        f"the grips: {done[slip.decision]}"
    )


def _repaired(test: ReducedTest, curve: Curve) -> ReducedTest:
    """Add the drops back; what is left once the specimen broke is not raised."""
    force = add_back(curve.force, test.slips)
    if isinstance(test.failure, FailurePoint):
        broken = slice(test.failure.sample + 1, None)
        force[broken] = curve.force[broken]
    return replace(test, curve=replace(curve, force=force))


def _cut(test: ReducedTest, curve: Curve) -> ReducedTest:
    """Nothing counts from the first slip on."""
    kept = samples_before(test.slips, len(curve.force))
    force = np.where(np.arange(len(curve.force)) < kept, curve.force, np.nan)
    branches = tuple(
        replace(branch, stop=min(branch.stop, kept), stop_time=float(curve.time[kept - 1]))
        if branch.stop > kept
        else branch
        for branch in curve.branches
        if branch.start < kept
    )
    return replace(
        test,
        slips=test.slips[:1],
        curve=replace(curve, force=force, branches=branches),
        failure=None if test.failure is None else Failure("cut", "the curve ends at a slip"),
    )


def _without_slack(test: ReducedTest, block: SlackBlock) -> Corrected:
    curve, where = test.curve, test.signals.displacement
    if curve is None:
        return test, []
    decide = partial(slack_of, start_share=block.start, stop_share=block.stop)
    slack = slack_by(test, decide)
    test = replace(test, slack=slack)
    if isinstance(slack, Failure):
        if slack.code == "no_toe":
            return test, [warning("no_toe", where, slack.message)]
        message = f"slack not found, so not taken off ({slack.message})"
        return test, [doubtful("slack_unknown", where, message, "displacement")]
    off = slack.value
    made = replace(
        _with_displacement(test, curve, test.displacement.changed(lambda values: values - off)),
        replicates=test.replicates and counted_from_taut(test.replicates, decide, slack),
        slips=tuple(_moved(slip, off) for slip in test.slips),
    )
    message = f"{1e3 * off:.4g} mm of slack taken off: displacement counts from where it is taut"
    return made, [info_note("slack_removed", where, message)]


def slack_by(test: ReducedTest, decide: Decide) -> Measured | Failure:
    """Measure the slack, where the force surely rises and the curve has a toe.

    Parameters
    ----------
    test : with a curve
    decide : on the linear region

    Returns
    -------
    The slack (m), or a failure ``not_rising``, ``no_toe`` or one of `decide`.
    """
    found = test.measure(decide)
    if isinstance(found, Failure):
        return found
    slack, trace = found[0], traced(test)
    if np.isnan(slack.off).mean() > _MAY_FALL:
        message = "in some curves with such noise the force does not rise in the linear region"
        return Failure("not_rising", message)
    at = loading_of(trace).start
    first, load = float(trace.displacement[at]), float(trace.force[at])
    if slack.value < first and not _preload_explains(slack, decide, trace, at):
        return Failure(
            "no_toe",
            f"the line meets zero force at {1e3 * slack.value:.4g} mm, before the first sample at "
            f"{1e3 * first:.4g} mm and {load:.4g} N: the curve is steepest where it begins",
        )
    return slack


def _preload_explains(slack: Measured, decide: Decide, trace: Trace, at: int) -> bool:
    """Whether a line back to zero force goes below a first sample because that one has a load.

    Where the line reaches the force of the first sample is near that sample if the curve is
    straight from there on, close to the slack if the curve was steeper than the line.
    """
    first = float(trace.displacement[at])
    if slack.interval.upper >= first:
        return True
    preloaded = replace(trace, force=trace.force - trace.force[at])
    above = decide(preloaded)
    if isinstance(above, Failure):
        return False
    place = float(above.numbers(preloaded)[0])
    return place - slack.value >= 0.5 * (first - slack.value)


def _moved(slip: Slip, slack: float) -> Slip:
    interval = slip.position_interval
    moved = replace(interval, lower=interval.lower - slack, upper=interval.upper - slack)
    return replace(slip, position=slip.position - slack, position_interval=moved)


def _with_displacement(test: ReducedTest, curve: Curve, displacement: Signal) -> ReducedTest:
    return replace(
        test,
        signals=test.signals.with_filtered(test.signals.displacement, displacement),
        curve=replace(curve, displacement=displacement.values),
    )
