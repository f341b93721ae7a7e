"""Build the curve, force and displacement on one clock, and correct it: frame, grips, slack.

Corrections are made in the order of the keys of the protocol, after the split into branches; the
aligned signals stay as measured.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from labpipe.errors import ProcessingError
from labpipe.process.motion import Motion
from labpipe.protocol.schema import CurveBlock, MachineCompliance
from labpipe.protocol.schema import Slack as SlackBlock
from labpipe.protocol.schema import Slips as SlipsBlock
from labpipe.records.arrays import Floats
from labpipe.records.causes import COMPLIANCE
from labpipe.records.curve import Aligned, Curve, Direction, Series, Slip, SlipDecision
from labpipe.records.estimates import Failure, return_failure
from labpipe.records.quality import Finding
from labpipe.records.signals import Signal, Signals
from labpipe.results.curves import (
    add_slips_back,
    find_piece_starts,
    make_trace,
    replicate_curves,
    select_first_loading,
)
from labpipe.results.failures import (
    LossOfForce,
    find_loading_before,
    find_loss_start,
    find_slow_loss,
    measure_earlier_loss,
)
from labpipe.results.kinds import FailurePoint, ReducedTest, compute_loading_sign
from labpipe.results.slack_and_slips import (
    choose_slack_samples,
    count_samples_before,
    find_slips,
    subtract_slack,
)
from labpipe.results.tension import ElasticWindow, fit_pull
from labpipe.signal.bad_samples import bridge_spikes, find_spikes
from labpipe.signal.filters import filter_pieces
from labpipe.signal.turning_points import number_branches
from labpipe.uncertainty.extractors import Decide, Trace
from labpipe.uncertainty.intervals import Measured

CorrectionOutcome: TypeAlias = tuple[ReducedTest, list[Finding]]


def align_signals(test: ReducedTest) -> Aligned:
    """Sample all raw signals at the times of the displacement."""
    time = test.displacement.time
    series = {
        test.signals.quantities.get(name, name): Series(
            test.clocks.interpolate(signal, time), signal.unit
        )
        for name, signal in test.signals.raw.items()
    }
    return Aligned(time, series, test.clocks.force, test.displacement.time_unit)


def build_curve(
    test: ReducedTest, unfiltered: Signal, motion: Motion
) -> tuple[Curve | None, list[Finding]]:
    """Build the curve, force and displacement on one clock; None if the records do not overlap.

    Parameters
    ----------
    test : with clocks that are joined
    unfiltered : the force, outliers bridged
    motion : its branches
    """
    displacement = test.displacement
    time = displacement.time
    force = test.clocks.interpolate(unfiltered, time)  # filtered after its corners are known
    if np.isnan(force).all():
        force_time = test.force.time
        note = Finding.of(
            "process.no_overlap",
            "align",
            blocks=True,
            force=force_time[0],
            force_end=force_time[-1],
            motion=time[0],
            motion_end=time[-1],
        )
        return None, [note]
    branches, motion_time = motion.branches, motion.signal.time
    if len(motion_time) != len(time):  # sample numbers on the other time axis of the same clock
        last_samples = [min(branch.stop, len(motion_time)) - 1 for branch in branches]
        starts = np.searchsorted(time, motion_time[[branch.start for branch in branches]]).tolist()
        stops = np.searchsorted(time, motion_time[last_samples]).tolist()
        ends = zip(branches, starts, stops, strict=True)
        branches = tuple(replace(branch, start=start, stop=stop) for branch, start, stop in ends)
    branch, cycle = number_branches(len(time), branches)
    return Curve(
        time, displacement.values, force, branch, cycle, branches, displacement.time_unit
    ), []


def correct_curve(test: ReducedTest, block: CurveBlock) -> CorrectionOutcome:
    """Correct the curve as the protocol says.

    Parameters
    ----------
    test : with a curve of unfiltered force
    block : of the protocol

    Returns
    -------
    The test with corrected curve, failure, slips and slack; and the findings.
    """
    rule = loss_start = None
    if block.failure is not None:
        failure = block.failure
        rule = LossOfForce(failure.force_below, failure.loss, failure.within, failure.at_end_below)
        loss_start = find_final_loss(test, rule)  # in the unfiltered force
    test, findings = _filter_branches(test, loss_start), list[Finding]()
    curve = test.curve
    if curve is None:
        return test, []
    if block.compliance is not None and block.compliance.value > 0.0:
        test, curve, findings = _subtract_compliance(test, curve, block.compliance)
    if rule is not None:
        test = replace(test, failure=_find_failure(curve, loss_start, rule))
    if block.slips is not None:
        test, curve, slip_findings = _correct_slips(test, curve, block.slips)
        findings += slip_findings
    test = replace(test, replicates=replicate_curves(test))
    if block.slack is not None:
        test, slack_findings = _subtract_slack(test, curve, block.slack)
        findings += slack_findings
    if (line := block.elastic_line) is not None:
        choice = ElasticWindow(line.start, line.stop, line.of, line.straight)
        test = replace(test, pull=fit_pull(test, choice))
    # Reported last, because slack shifts the origin of the displacement.
    return test, [*findings, *(_make_slip_note(test.signals.force, slip) for slip in test.slips)]


def bridge_outliers(signals: Signals) -> tuple[Signal, list[Finding]]:
    """Interpolate single outliers of the force.

    Parameters
    ----------
    signals : with the raw force, which is not changed

    Returns
    -------
    The unfiltered force without outliers on its own clock, and a note.
    """
    signal = signals.raw[signals.force]
    outliers = find_spikes(signal.values)
    if not len(outliers):
        return signal, []
    sample = int(outliers[0])
    note = Finding.of(
        "process.stray_samples",
        signals.force,
        count=len(outliers),
        first=float(signal.values[sample]),
        place=f"at {signal.time[sample]:.3f} s" if signal.has_time else f"in sample {sample + 1}",
    )
    return replace(signal, values=bridge_spikes(signal.values, outliers)), [note]


def _subtract_compliance(
    test: ReducedTest, curve: Curve, compliance: MachineCompliance
) -> tuple[ReducedTest, Curve, list[Finding]]:
    """Subtract the displacement of the frame, and add the change with a higher compliance."""
    value, force = compliance.value, curve.force
    signal = test.displacement.map_values(lambda displacement: displacement - value * force)
    _check_compliance(test, curve, signal.values, value)
    if compliance.uncertainty:
        higher_compliance = value * (1.0 + compliance.uncertainty)
        perturbed_displacement = curve.displacement - higher_compliance * force
        signal = replace(signal, perturbed={**signal.perturbed, COMPLIANCE: perturbed_displacement})
    largest = 1e6 * value * float(np.nanmax(np.abs(force)))
    where, size = test.signals.displacement, 1e6 * value
    note = Finding.of("process.compliance_removed", where, size=size, largest=largest)
    test = replace(test, compliance=value)
    return *_replace_displacement(test, curve, signal), [note]


def _check_compliance(test: ReducedTest, curve: Curve, corrected: Floats, value: float) -> None:
    """Refuse a compliance with which the specimen would get shorter in loading."""
    branch = test.first_loading
    if branch is None:
        return
    top = branch.start + int(np.nanargmax(curve.force[branch.start : branch.stop]))
    loading = slice(branch.start, top + 1)
    blocks = np.array_split(corrected[loading], min(20, top + 1 - branch.start))
    if np.all(np.diff([np.nanmean(block) for block in blocks]) > 0.0):
        return
    displacement_change = float(curve.displacement[top] - curve.displacement[branch.start])
    force_change = float(curve.force[top] - curve.force[branch.start])
    most, stated = 1e6 * displacement_change / force_change, 1e6 * value
    raise ProcessingError.about(
        "process.too_compliant", "curve.compliance", most=most, stated=stated
    )


def find_final_loss(test: ReducedTest, rule: LossOfForce) -> int | Failure | None:
    """Find the sample at which the final loss of force begins.

    Parameters
    ----------
    test : with a curve
    rule : definition of the loss

    Returns
    -------
    Number of the sample, or why there is no loss; None without a curve or a loading.
    """
    curve, branch = test.curve, test.first_loading
    if curve is None or branch is None:
        return None
    from_loading = slice(branch.start, None)
    is_unloading = np.zeros(len(curve.time), dtype=np.bool_)
    for part in curve.branches:
        is_unloading[part.start : part.stop] = part.direction is Direction.UNLOADING
    force = _find_force_sign(curve) * curve.force[from_loading]
    sample = find_loss_start(curve.time[from_loading], force, rule, is_unloading[from_loading])
    return sample if isinstance(sample, Failure) else sample + branch.start


def _find_failure(
    curve: Curve, loss_start: int | Failure | None, rule: LossOfForce
) -> FailurePoint | Failure | None:
    if loss_start is None:
        return None
    force = _find_force_sign(curve) * curve.force
    if not isinstance(loss_start, Failure):
        loading = slice(find_loading_before(curve, loss_start).start, loss_start + 1)
        earlier = measure_earlier_loss(curve.time[loading], force[loading], rule)
        return FailurePoint(loss_start, earlier)
    if loss_start.code != "no_break":
        return loss_start
    start = curve.branches[0].start
    loading, finite = slice(start, None), np.flatnonzero(~np.isnan(force[start:]))
    last, largest = start + int(finite[-1]), np.nanmax(force[loading])
    if rule.at_end_below and force[last] < rule.at_end_below * largest:
        return FailurePoint(last)
    path = compute_loading_sign(curve.displacement[loading]) * curve.displacement[loading]
    sample = find_slow_loss(path, force[loading], rule)
    if sample is None:
        return loss_start
    return FailurePoint(start + sample, slow_below=rule.force_below)


def _find_force_sign(curve: Curve) -> float:
    """Return the sign of the force in the first loading."""
    first = curve.branches[0]
    return compute_loading_sign(curve.force[first.start : first.stop])


def _filter_branches(test: ReducedTest, loss_start: int | Failure | None) -> ReducedTest:
    """Filter force and displacement again, each branch separately, as the turns are now known."""
    curve, signals = test.curve, test.signals
    if curve is None:
        return test
    ends = [end for branch in curve.branches for end in (branch.start_time, branch.stop_time)]
    ends += [float(curve.time[loss_start])] if isinstance(loss_start, int) else []
    raw = {**signals.raw, signals.force: test.unfiltered or test.raw_force}
    on_curve = {"force": curve.force, "displacement": curve.displacement}
    for name, quantity in signals.quantities.items():
        if name not in signals.filters:
            continue
        cuts = find_piece_starts(test.clocks, ends, raw[name])
        in_pieces = partial(filter_pieces, cuts=cuts, filters=signals.filters[name])
        values = raw[name].map_values(in_pieces)
        filtered = signals.filtered[name]
        filtered = replace(filtered, values=values.values, perturbed=values.perturbed)
        signals = signals.with_filtered(name, filtered)
        time = signals.filtered[signals.displacement].time
        on_curve[quantity] = test.clocks.interpolate(filtered, time)
    curve = replace(curve, force=on_curve["force"], displacement=on_curve["displacement"])
    return replace(test, signals=signals, curve=curve)


def _correct_slips(
    test: ReducedTest, curve: Curve, block: SlipsBlock
) -> tuple[ReducedTest, Curve, list[Finding]]:
    """Find slips in the first loading, and add them back or cut the curve there."""
    stretch = select_first_loading(make_trace(test))
    if not stretch.stop > stretch.start:
        return test, curve, []
    decision, start = SlipDecision(block.decision), stretch.start
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    outcome = find_slips(displacement, force, min_drop=block.min_drop, decision=decision)
    if isinstance(outcome, Failure):
        where, reason = test.signals.force, outcome.message
        return test, curve, [Finding.of("process.slips_not_looked_for", where, reason=reason)]
    slips = tuple(replace(x, start=x.start + start, stop=x.stop + start) for x in outcome)
    test = replace(test, slips=slips)
    if slips and decision is SlipDecision.REPAIRED:
        force = add_slips_back(curve.force, slips)
        if isinstance(test.failure, FailurePoint):  # the broken specimen does not slip
            broken = slice(test.failure.sample + 1, None)
            force[broken] = curve.force[broken]
        curve = replace(curve, force=force)
    if slips and decision is SlipDecision.CUT:
        curve = _cut_curve(curve, count_samples_before(slips, len(curve.force)))
        failure = test.failure and Failure("cut", "the curve ends at a slip")
        test = replace(test, slips=slips[:1], failure=failure)
    return replace(test, curve=curve), curve, []


def _cut_curve(curve: Curve, stop: int) -> Curve:
    """Discard the force of a curve and its branches from a sample on."""
    force = np.where(np.arange(len(curve.force)) < stop, curve.force, np.nan)
    end = float(curve.time[stop - 1])
    branches = tuple(
        replace(branch, stop=stop, stop_time=end) if branch.stop > stop else branch
        for branch in curve.branches
        if branch.start < stop
    )
    return replace(curve, force=force, branches=branches)


def _make_slip_note(where: str, slip: Slip) -> Finding:
    return Finding.of(
        "process.slip_marked"
        if slip.decision is SlipDecision.MARKED
        else "process.slip_repaired"
        if slip.decision is SlipDecision.REPAIRED
        else "process.slip_cut",
        where,
        drop=slip.drop,
        position=1e3 * slip.position,
    )


def _subtract_slack(test: ReducedTest, curve: Curve, block: SlackBlock) -> CorrectionOutcome:
    decide = partial(choose_slack_samples, start_share=block.start, stop_share=block.stop)
    where, slack = test.signals.displacement, measure_slack(test, decide)
    test = replace(test, slack=slack)
    if isinstance(slack, Failure):
        is_steep = slack.code == "no_toe"
        note = Finding.of(
            "process.no_toe" if is_steep else "process.slack_unknown",
            where,
            *(() if is_steep else ("displacement",)),
            reason=slack.message,
        )
        return test, [note]
    offset = slack.value
    signal = test.displacement.map_values(lambda values: values - offset)
    test, _ = _replace_displacement(test, curve, signal)
    replicates = test.replicates and subtract_slack(test.replicates, decide, slack)
    slips = tuple(_shift_slip(slip, offset) for slip in test.slips)
    note = Finding.of("process.slack_removed", where, slack=1e3 * offset)
    return replace(test, replicates=replicates, slips=slips), [note]


def measure_slack(test: ReducedTest, decide: Decide) -> Measured | Failure:
    """Measure the slack of a curve that has a toe.

    Parameters
    ----------
    test : with a curve
    decide : finds the linear region

    Returns
    -------
    The slack (m), or a failure ``not_rising``, ``no_toe`` or one of `decide`.
    """
    max_falling_share = 0.025  # of the replicate curves
    measured = return_failure(test.measure)(decide)
    if isinstance(measured, Failure):
        return measured
    slack, trace = measured[0], make_trace(test)
    if np.isnan(slack.deviations).mean() > max_falling_share:
        return Failure.of("process.not_rising")
    start = select_first_loading(trace).start
    first, load = float(trace.displacement[start]), float(trace.force[start])
    if slack.value < first and not _is_preloaded(slack, decide, trace, start):
        zero, first = 1e3 * slack.value, 1e3 * first
        return Failure.of("process.steepest_at_begin", zero=zero, first=first, load=load)
    return slack


def _is_preloaded(slack: Measured, decide: Decide, trace: Trace, start: int) -> bool:
    """Check whether a preload explains that the line meets zero force before the first sample.

    The force less that of the first sample is extrapolated to zero as well. If the curve is
    straight from the first sample on, this zero lies near that sample, as after a preload. If the
    curve is steeper there than the line, this zero lies closer to the slack.
    """
    first_displacement = float(trace.displacement[start])
    if slack.interval.upper >= first_displacement:
        return True
    preloaded = replace(trace, force=trace.force - trace.force[start])
    region = return_failure(decide)(preloaded)
    if isinstance(region, Failure):
        return False
    preloaded_zero = float(region.numbers(preloaded)[0])
    return preloaded_zero - slack.value >= 0.5 * (first_displacement - slack.value)


def _shift_slip(slip: Slip, slack: float) -> Slip:
    interval = slip.position_interval
    shifted_interval = replace(interval, lower=interval.lower - slack, upper=interval.upper - slack)
    return replace(slip, position=slip.position - slack, position_interval=shifted_interval)


def _replace_displacement(
    test: ReducedTest, curve: Curve, displacement: Signal
) -> tuple[ReducedTest, Curve]:
    curve = replace(curve, displacement=displacement.values)
    signals = test.signals.with_filtered(test.signals.displacement, displacement)
    return replace(test, signals=signals, curve=curve), curve
