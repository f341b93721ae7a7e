"""Build the force-displacement curve of a test and correct it for compliance, slips and slack.

The curve consists of the force and the displacement at the same times. After the split into
branches, its branches are filtered. The curve is then corrected for the compliance, for slips and
for slack, in this order. The failure is found after the correction for the compliance.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

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
from labpipe.results.cycles import find_loading_sign
from labpipe.results.failures import (
    LossOfForce,
    find_loading_before,
    find_loss_start,
    find_slow_loss,
    measure_earlier_loss,
)
from labpipe.results.kinds import FailurePoint, ReducedTest, compute_loading_sign
from labpipe.results.slack_and_slips import choose_slack_samples, find_slips, subtract_slack
from labpipe.results.tension import ElasticWindow, fit_tensile_curve
from labpipe.signal.bad_samples import bridge_spikes, find_spikes
from labpipe.signal.filters import filter_pieces
from labpipe.uncertainty.intervals import MeasuredNumber
from labpipe.uncertainty.replicates import Choice, Trace

CorrectionOutcome: TypeAlias = tuple[ReducedTest, list[Finding]]
"""The corrected test, and the findings of the correction."""


def align_signals(test: ReducedTest) -> Aligned:
    """Interpolate all raw signals of a test at the times of its displacement."""
    time = test.displacement.time
    series = {
        test.signals.quantities.get(name, name): Series(
            test.clocks.interpolate(signal, time), signal.unit
        )
        for name, signal in test.signals.raw.items()
    }
    return Aligned(time, series, test.clocks.force_fit, test.displacement.time_unit)


def build_curve(
    test: ReducedTest, unfiltered_force: Signal, motion: Motion
) -> tuple[Curve | None, list[Finding]]:
    """Build the curve of the unfiltered force against the displacement.

    Parameters
    ----------
    test : test with aligned clocks
    unfiltered_force : force without outliers
    motion : motion of the test with its branches

    Returns
    -------
    The curve and no findings; or None and a finding if force and motion do not overlap in time.
    """
    displacement = test.displacement
    time = displacement.time
    force = test.clocks.interpolate(unfiltered_force, time)  # `correct_curve` filters it
    if np.isnan(force).all():
        facts: dict[str, Any] = {"force": test.force.time[[0, -1]], "motion": time[[0, -1]]}
        return None, [Finding.of("process.no_overlap", "align", is_blocking=True, **facts)]
    branches, motion_time = motion.branches, motion.signal.time
    if len(motion_time) != len(time):
        # The indices of the branches refer to the samples of the motion; convert them to the curve.
        last_samples = [min(branch.stop, len(motion_time)) - 1 for branch in branches]
        starts = np.searchsorted(time, motion_time[[branch.start for branch in branches]]).tolist()
        stops = np.searchsorted(time, motion_time[last_samples]).tolist()
        ranges = zip(branches, starts, stops, strict=True)
        branches = tuple(replace(branch, start=start, stop=stop) for branch, start, stop in ranges)
    curve = Curve(time, displacement.values, force, branches, displacement.time_unit)
    return curve, []


def correct_curve(test: ReducedTest, settings: CurveBlock) -> CorrectionOutcome:
    """Filter and correct the curve of a test, and find its failure.

    Parameters
    ----------
    test : test with a curve of the unfiltered force
    settings : block ``curve`` of the protocol

    Returns
    -------
    The test with its corrected curve, failure, slips, slack and elastic line, and the findings.
    """
    criteria = loss_start = None
    if settings.failure is not None:
        criteria = LossOfForce(**dict(settings.failure))
        # The unfiltered force is used, because a filter would smooth the loss.
        loss_start = find_final_loss(test, criteria)
    findings = list[Finding]()
    test = _filter_branches(test, loss_start)
    if settings.compliance is not None and settings.compliance.value > 0.0:
        test, findings = _subtract_compliance(test, settings.compliance)
    if criteria is not None:
        test = replace(test, failure=_find_failure(test.required_curve, loss_start, criteria))
    if settings.slips is not None:
        test, slip_findings = _correct_slips(test, settings.slips)
        findings += slip_findings
    test = replace(test, replicates=replicate_curves(test))
    if settings.slack is not None:
        test, slack_findings = _subtract_slack(test, settings.slack)
        findings += slack_findings
    if settings.elastic_line is not None:
        window = ElasticWindow(**dict(settings.elastic_line))
        test = replace(test, tensile_curve=fit_tensile_curve(test, window))
    # Slips are reported last, because the slack correction changes their positions.
    return test, [*findings, *(_report_slip(test.signals.force, slip) for slip in test.slips)]


def _report_slip(channel: str, slip: Slip) -> Finding:
    """Report a slip as a finding, which states how the slip was treated."""
    facts: dict[str, Any] = {"drop": slip.drop, "position": 1e3 * slip.position}
    if slip.decision is SlipDecision.MARKED:
        return Finding.of("process.slip_marked", channel, **facts)
    if slip.decision is SlipDecision.REPAIRED:
        return Finding.of("process.slip_repaired", channel, **facts)
    return Finding.of("process.slip_cut", channel, **facts)


def bridge_outliers(signals: Signals) -> tuple[Signal, list[Finding]]:
    """Replace outliers of the raw force by linear interpolation.

    Parameters
    ----------
    signals : signals of a test, which are not changed

    Returns
    -------
    The raw force without outliers, and a list with a finding if there are outliers.
    """
    raw_force = signals.raw[signals.force]
    outliers = find_spikes(raw_force.values)
    if not len(outliers):
        return raw_force, []
    sample = int(outliers[0])
    time, first_outlier = raw_force.time[sample], float(raw_force.values[sample])
    place = f"at {time:.3f} s" if raw_force.has_time else f"in sample {sample + 1}"
    facts: dict[str, Any] = {"count": len(outliers), "first": first_outlier, "at": place}
    finding = Finding.of("process.stray_samples", signals.force, **facts)
    return replace(raw_force, values=bridge_spikes(raw_force.values, outliers)), [finding]


def _subtract_compliance(test: ReducedTest, settings: MachineCompliance) -> CorrectionOutcome:
    """Subtract the deformation of the machine from the displacement.

    The displacement that is perturbed by `COMPLIANCE` is corrected with the compliance plus its
    standard uncertainty. The stored compliance is negative if force and displacement have opposite
    signs in loading.
    """
    curve = test.required_curve
    sign = find_loading_sign(curve, curve.displacement) * find_loading_sign(curve, curve.force)
    compliance, force = sign * settings.value, curve.force
    corrected = test.displacement.map_values(lambda values: values - compliance * force)
    _check_compliance(test, curve, corrected.values, settings.value)
    if settings.uncertainty:
        higher_compliance = compliance * (1.0 + settings.uncertainty)
        perturbed_values = {COMPLIANCE: curve.displacement - higher_compliance * force}
        corrected = replace(corrected, variants={**corrected.variants, **perturbed_values})
    facts: dict[str, Any] = {"compliance": 1e6 * settings.value}  # um/N
    facts |= {"largest": facts["compliance"] * float(np.nanmax(np.abs(force)))}  # um
    finding = Finding.of("process.compliance_removed", test.signals.displacement, **facts)
    return replace(_replace_displacement(test, corrected), compliance=compliance), [finding]


def _check_compliance(
    test: ReducedTest, curve: Curve, corrected_displacement: Floats, compliance: float
) -> None:
    """Raise an error if block means of the displacement do not increase up to the peak force.

    Parameters
    ----------
    test : test whose first loading is checked
    curve : curve before the correction
    corrected_displacement : shape (n,), m, displacement after the correction
    compliance : compliance of the machine, m/N
    """
    max_blocks = 20  # largest number of blocks; means are compared, because samples scatter
    branch, sign = test.first_loading, find_loading_sign(curve, curve.displacement)
    if branch is None:
        return
    start = branch.start
    force = find_loading_sign(curve, curve.force) * curve.force[start : branch.stop]
    peak = start + int(np.nanargmax(force))
    displacement = sign * corrected_displacement[start : peak + 1]
    blocks = np.array_split(displacement, min(max_blocks, len(displacement)))
    if np.all(np.diff([np.nanmean(block) for block in blocks]) > 0.0):
        return
    travel, force_change = (x[peak] - x[start] for x in (curve.displacement, curve.force))
    facts = {"limit": 1e6 * abs(float(travel / force_change)), "stated": 1e6 * compliance}
    raise ProcessingError.about("process.too_compliant", "curve.compliance", **facts)


def find_final_loss(test: ReducedTest, criteria: LossOfForce) -> int | Failure | None:
    """Find the sample at which the final loss of force begins.

    Parameters
    ----------
    test : test with or without a curve
    criteria : criteria of a loss of force

    Returns
    -------
    The index of the sample, or the reason why there is none; None if the test has no curve or no
    loading.
    """
    curve, first_loading = test.curve, test.first_loading
    if curve is None or first_loading is None:
        return None
    start = first_loading.start
    is_unloading = np.zeros(len(curve.time), dtype=np.bool_)
    for branch in curve.branches:
        is_unloading[branch.start : branch.stop] = branch.direction is Direction.UNLOADING
    force = find_loading_sign(curve, curve.force) * curve.force[start:]
    loss_start = find_loss_start(curve.time[start:], force, criteria, is_unloading[start:])
    return loss_start if isinstance(loss_start, Failure) else loss_start + start


def _find_failure(
    curve: Curve, loss_start: int | Failure | None, criteria: LossOfForce
) -> FailurePoint | Failure | None:
    """Find the failure of the specimen, or the reason why there is none; None without a loss.

    A failure is a sudden loss of force, a low force at the end of the record, or a slow loss.
    """
    if loss_start is None:
        return None
    force = find_loading_sign(curve, curve.force) * curve.force
    if not isinstance(loss_start, Failure):
        loading = slice(find_loading_before(curve, loss_start).start, loss_start + 1)
        earlier_loss = measure_earlier_loss(curve.time[loading], force[loading], criteria)
        return FailurePoint(loss_start, earlier_loss)
    if loss_start.code != "no_break":
        return loss_start
    start = curve.branches[0].start
    force, displacement = force[start:], curve.displacement[start:]
    last_sample = int(np.flatnonzero(~np.isnan(force))[-1])
    if criteria.at_end_below and force[last_sample] < criteria.at_end_below * np.nanmax(force):
        return FailurePoint(start + last_sample)
    slow_loss = find_slow_loss(compute_loading_sign(displacement) * displacement, force, criteria)
    if slow_loss is None:
        return loss_start
    return FailurePoint(start + slow_loss, slow_loss_limit=criteria.force_below)


def _filter_branches(test: ReducedTest, loss_start: int | Failure | None) -> ReducedTest:
    """Filter force and displacement separately in each branch.

    A branch with a loss of force is filtered separately before and after the start of the loss.
    """
    curve, signals = test.required_curve, test.signals
    cut_times = [branch.start_time for branch in curve.branches]
    cut_times += [branch.stop_time for branch in curve.branches]
    cut_times += [float(curve.time[loss_start])] if isinstance(loss_start, int) else []
    unfiltered_signals = {**signals.raw, signals.force: test.unfiltered_force or test.raw_force}
    curve_values = {"force": curve.force, "displacement": curve.displacement}
    for name, quantity in signals.quantities.items():
        if name not in signals.filters:
            continue
        cuts = find_piece_starts(test.clocks, cut_times, unfiltered_signals[name])
        filter_branches = partial(filter_pieces, cuts=cuts, filters=signals.filters[name])
        result = unfiltered_signals[name].map_values(filter_branches)
        signal = replace(signals.filtered[name], values=result.values, variants=result.variants)
        signals = signals.replace_filtered(name, signal)
        curve_time = signals.filtered[signals.displacement].time
        curve_values[quantity] = test.clocks.interpolate(signal, curve_time)
    curve = replace(curve, force=curve_values["force"], displacement=curve_values["displacement"])
    return replace(test, signals=signals, curve=curve)


def _correct_slips(test: ReducedTest, settings: SlipsBlock) -> CorrectionOutcome:
    """Find the slips of the first loading, and treat them as the protocol states.

    Slips are only marked, or the lost force is also added back, or the curve is cut at the first
    slip.
    """
    curve, loading = test.required_curve, select_first_loading(make_trace(test))
    start = loading.start
    if not loading.stop > start:
        return test, []
    if -1.0 in (find_loading_sign(curve, values) for values in (curve.displacement, curve.force)):
        return test, [Finding.of("process.slips_of_falling_signals", test.signals.force)]
    decision = SlipDecision(settings.decision)
    displacement, force = curve.displacement[loading], curve.force[loading]
    slips = find_slips(displacement, force, min_drop=settings.min_drop, decision=decision)
    if isinstance(slips, Failure):
        channel, reason = test.signals.force, slips.message
        return test, [Finding.of("process.slips_not_looked_for", channel, reason=reason)]
    slips = tuple(replace(slip, start=slip.start + start, stop=slip.stop + start) for slip in slips)
    test = replace(test, slips=slips)
    if slips and decision is SlipDecision.REPAIRED:
        repaired_force = add_slips_back(curve.force, slips)
        if isinstance(test.failure, FailurePoint):  # no force is added to a broken specimen
            after_failure = slice(test.failure.sample + 1, None)
            repaired_force[after_failure] = curve.force[after_failure]
        curve = replace(curve, force=repaired_force)
    if slips and decision is SlipDecision.CUT:
        curve = _cut_curve(curve, slips[0].start + 1)
        failure = test.failure and Failure("cut", "the curve ends at a slip")
        test = replace(test, slips=slips[:1], failure=failure)
    return replace(test, curve=curve), []


def _cut_curve(curve: Curve, stop: int) -> Curve:
    """Replace the force by NaN from sample `stop` on, where branches end; drop later ones."""
    force = np.where(np.arange(len(curve.force)) < stop, curve.force, np.nan)
    stop_time = float(curve.time[stop - 1])
    branches = tuple(
        replace(branch, stop=stop, stop_time=stop_time) if branch.stop > stop else branch
        for branch in curve.branches
        if branch.start < stop
    )
    return replace(curve, force=force, branches=branches)


def _subtract_slack(test: ReducedTest, settings: SlackBlock) -> CorrectionOutcome:
    """Subtract the slack from the displacement, the replicate curves and the slip positions."""
    start, stop = settings.start, settings.stop
    read_slack = partial(choose_slack_samples, start_fraction=start, stop_fraction=stop)
    channel, slack = test.signals.displacement, measure_slack(test, read_slack)
    test = replace(test, slack=slack)
    if isinstance(slack, Failure):
        reason = slack.message
        if slack.code == "no_toe":
            return test, [Finding.of("process.no_toe", channel, reason=reason)]
        return test, [Finding.of("process.slack_unknown", channel, "displacement", reason=reason)]
    shift = slack.value
    corrected = test.displacement.map_values(lambda displacement: displacement - shift)
    test = _replace_displacement(test, corrected)
    replicates = test.replicates and subtract_slack(test.replicates, read_slack, slack)
    slips = tuple(_shift_slip(slip, shift) for slip in test.slips)
    finding = Finding.of("process.slack_removed", channel, slack=1e3 * shift)
    return replace(test, replicates=replicates, slips=slips), [finding]


def measure_slack(test: ReducedTest, read_slack: Choice) -> MeasuredNumber | Failure:
    """Measure the slack of a curve, or return the reason why it cannot be subtracted.

    Parameters
    ----------
    test : test with a curve
    read_slack : function that chooses the samples of the linear region; its extractor computes the
        displacement at which the line through them meets zero force

    Returns
    -------
    The slack (m), or a failure with the code ``not_rising``, ``no_toe`` or one of the measurement.
    """
    max_missing_fraction = 0.025  # largest fraction of replicates whose lines do not rise
    # The line may meet zero force before the curve begins, by this fraction of the travel.
    max_early_fraction = 1e-3
    slack, trace = return_failure(test.measure_number)(read_slack), make_trace(test)
    if isinstance(slack, Failure):
        return slack
    if np.isnan(slack.deviations).mean() > max_missing_fraction:
        return Failure.of("process.not_rising")
    start = select_first_loading(trace).start
    first_displacement, first_force = float(trace.displacement[start]), float(trace.force[start])
    first_zero = first_displacement - max_early_fraction * float(np.ptp(trace.displacement))
    if not slack.value >= first_zero and not _is_preloaded(slack, read_slack, trace, start):
        facts = {"zero": 1e3 * slack.value, "first": 1e3 * first_displacement, "load": first_force}
        return Failure.of("process.steepest_at_begin", **facts)
    return slack


def _is_preloaded(slack: MeasuredNumber, read_slack: Choice, trace: Trace, start: int) -> bool:
    """Return whether a preload explains a slack that is less than the first displacement.

    It does if the interval of the slack reaches the first displacement. Otherwise, the force at the
    first sample is subtracted from the curve, and the slack of this shifted curve is measured. If
    the curve is straight from its first sample, as after a preload, the slack of the shifted curve
    is near the first displacement. If the curve is steepest at its first sample, the slack of the
    shifted curve is near the measured slack. The limit is halfway between these two displacements.
    """
    first_displacement = float(trace.displacement[start])
    if slack.interval.upper >= first_displacement:
        return True
    shifted_trace = replace(trace, force=trace.force - trace.force[start])
    extractor = return_failure(read_slack)(shifted_trace)
    if isinstance(extractor, Failure):
        return False
    shifted_slack = float(extractor.compute_numbers(shifted_trace)[0])
    return shifted_slack - slack.value >= 0.5 * (first_displacement - slack.value)


def _shift_slip(slip: Slip, slack: float) -> Slip:
    """Subtract a slack (m) from the position of a slip."""
    interval = slip.position_interval
    shifted_interval = replace(interval, lower=interval.lower - slack, upper=interval.upper - slack)
    return replace(slip, position=slip.position - slack, position_interval=shifted_interval)


def _replace_displacement(test: ReducedTest, displacement: Signal) -> ReducedTest:
    """Replace the displacement in the curve and in the signals of a test."""
    curve = replace(test.required_curve, displacement=displacement.values)
    signals = test.signals.replace_filtered(test.signals.displacement, displacement)
    return replace(test, signals=signals, curve=curve)
