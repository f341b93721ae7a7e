"""Corrections of the curve: what frame, grips and slack add to it, and where the specimen broke.

They follow one another in the order of the protocol's keys, on the curve as it was split into
branches; the aligned signals stay as measured.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import hypot

import numpy as np

from labpipe.errors import ProcessingError, complaint
from labpipe.fits.failure_point import FailurePoint, LossOfForce, failure_point, final_loss
from labpipe.fits.grip_slips import add_back, find_slips, samples_before
from labpipe.fits.loops import sense_of_loading
from labpipe.fits.slack import fit_slack
from labpipe.fits.straight_lines import correct_displacement
from labpipe.pipeline.bench import Bench, Signal, at_times_of_curve
from labpipe.protocol.schema import CurveBlock, MachineCompliance
from labpipe.protocol.schema import Slack as SlackBlock
from labpipe.protocol.schema import Slips as SlipsBlock
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction, Slip, SlipDecision
from labpipe.records.estimates import Estimate, Failure, scaled, widened
from labpipe.records.quality import Severity
from labpipe.signal.bad_samples import bridged, stray_samples
from labpipe.signal.filters import in_pieces


def correct_curve(bench: Bench, block: CurveBlock) -> None:
    """Correct the curve as the protocol says.

    Parameters
    ----------
    bench : its curve and displacement are replaced; gets failure, slips and slack
    block : of the protocol
    """
    rule = None
    if block.failure is not None:
        failure = block.failure
        rule = LossOfForce(failure.force_below, failure.loss, failure.within)
    lost = _final_loss(bench, rule)  # seen on the unfiltered force, which no filter has blurred
    _filter_pieces(bench, lost)
    if block.compliance is not None:
        _take_off_give(bench, block.compliance)
    if rule is not None and bench.curve is not None:
        bench.failure = _failure(bench.curve, lost, rule)
    if block.slips is not None:
        _treat_slips(bench, block.slips)
    if block.slack is not None:
        _take_off_slack(bench, block.slack)
    for slip in bench.slips:  # told last: slack moves the place that displacement counts from
        bench.note(f"slip_{slip.decision}", Severity.WARNING, bench.force, _told(slip))


def loading_branch(bench: Bench) -> Branch | None:
    """The first loading branch of the curve; None where there is none."""
    branches = bench.curve.branches if bench.curve is not None else ()
    return next((each for each in branches if each.direction is Direction.LOADING), None)


def loading_stretch(bench: Bench) -> slice:
    """Samples of the first loading branch, up to the failure if it lies there; may be empty."""
    branch = loading_branch(bench)
    if branch is None:
        return slice(0, 0)
    if isinstance(bench.failure, FailurePoint) and bench.failure.sample < branch.stop:
        return slice(branch.start, max(bench.failure.sample + 1, branch.start))
    return slice(branch.start, branch.stop)


def repair_error(bench: Bench, *, before: int) -> float:
    """Standard error of a repaired force at a sample, N: that of all drops added back before it."""
    repaired = [slip for slip in bench.slips if slip.decision is SlipDecision.REPAIRED]
    errors = [slip.drop_interval.standard_error for slip in repaired if slip.start < before]
    return hypot(*errors)


def without_strays(bench: Bench) -> Signal:
    """Put single bad samples of the force on the line between their neighbours.

    Parameters
    ----------
    bench : its raw force is used, and stays; gets a note

    Returns
    -------
    The unfiltered force on its own clock.
    """
    signal = bench.raw[bench.force]
    strays = stray_samples(signal.values)
    if not len(strays):
        return signal
    first = int(strays[0])
    at = f"at {signal.time[first]:.3f} s" if signal.has_time else f"in sample {first + 1}"
    message = (
        f"{len(strays)} samples far off their neighbours, the first {signal.values[first]:.4g} N "
        f"{at}: put on the line between them"
    )
    bench.note("stray_samples", Severity.WARNING, bench.force, message)
    return replace(signal, values=bridged(signal.values, strays))


def _take_off_give(bench: Bench, compliance: MachineCompliance) -> None:
    """Displacement of the specimen alone; the other assumption is a compliance wrong by 1 sigma."""
    curve = bench.curve
    if curve is None:
        return
    value = compliance.value
    # What another assumption changes is divided by sqrt(3) later; a standard error must not be.
    other = value * (1.0 + np.sqrt(3.0) * compliance.uncertainty)
    taken = [
        correct_displacement(curve.displacement, curve.force, compliance=each)
        for each in (value, other)
    ]
    _refuse_backwards(bench, curve, taken[0], value)
    _set_displacement(bench, curve, taken[0], taken[1] if compliance.uncertainty else None)
    most = 1e6 * value * float(np.nanmax(np.abs(curve.force)))
    message = (
        f"{1e6 * value:.4g} um/N x force taken off the displacement, {most:.4g} um at the most"
    )
    bench.note("compliance_removed", Severity.INFO, bench.displacement, message)


def _refuse_backwards(bench: Bench, curve: Curve, corrected: Floats, value: float) -> None:
    """Refuse a compliance that is more than frame and specimen give way together."""
    branch = loading_branch(bench)
    if branch is None:
        return
    top = branch.start + int(np.nanargmax(curve.force[branch.start : branch.stop]))
    loading = slice(branch.start, top + 1)
    blocks = np.array_split(corrected[loading], min(20, top + 1 - branch.start))
    if np.all(np.diff([np.nanmean(each) for each in blocks]) > 0.0):
        return
    way = float(curve.displacement[top] - curve.displacement[branch.start])
    pull = float(curve.force[top] - curve.force[branch.start])
    message = complaint(
        "curve.compliance",
        "",
        expected=f"a compliance below that of this test, {1e6 * way / pull:.4g} um/N on the way up",
        found=f"{1e6 * value:.4g} um/N, with which the specimen would get shorter",
        remedy="Look at its unit, and at the test of the stiff bar it comes from.",
    )
    raise ProcessingError(message)


def _final_loss(bench: Bench, rule: LossOfForce | None) -> int | Failure | None:
    """Sample of the curve at which the force begins to be lost; None where nobody asked."""
    curve, branch = bench.curve, loading_branch(bench)
    if curve is None or branch is None or rule is None:
        return None
    after = slice(branch.start, None)
    is_back = np.zeros(len(curve.time), dtype=np.bool_)
    for each in curve.branches:
        is_back[each.start : each.stop] = each.direction is Direction.UNLOADING
    force = _sense(curve) * curve.force[after]
    found = final_loss(curve.time[after], force, rule, is_back[after])
    return found if isinstance(found, Failure) else found + branch.start


def _failure(
    curve: Curve, lost: int | Failure | None, rule: LossOfForce
) -> FailurePoint | Failure | None:
    if lost is None or isinstance(lost, Failure):
        return lost
    start = loading_before(curve, lost).start
    d, f = curve.displacement[start:], curve.force[start:]
    sense = _sense(curve)
    found = failure_point(curve.time[start:], d, sense * f, lost - start, rule)
    return replace(found, sample=lost, force=scaled(found.force, sense))


def _sense(curve: Curve) -> float:
    """Which way the force goes when the specimen is loaded for the first time."""
    first = curve.branches[0]
    return sense_of_loading(curve.force[first.start : first.stop])


def loading_before(curve: Curve, sample: int) -> Branch:
    """The last loading branch that begins at a sample or before it; the first one before all."""
    loading = [each for each in curve.branches if each.direction is Direction.LOADING]
    return [each for each in loading if each.start <= sample or each is loading[0]][-1]


def _filter_pieces(bench: Bench, lost: int | Failure | None) -> None:
    """Filter force and displacement anew, each branch by itself: their corners are known now."""
    curve = bench.curve
    if curve is None or not {bench.force, bench.displacement} & bench.filters.keys():
        return
    ends = [at for each in curve.branches for at in (each.start_time, each.stop_time)]
    ends += [float(curve.time[lost])] if isinstance(lost, int) else []
    raw = bench.raw[bench.displacement]
    signals = {bench.force: bench.unfiltered or bench.raw[bench.force], bench.displacement: raw}
    changed = {
        name: _in_pieces(bench, name, signal, ends)
        for name, signal in signals.items()
        if name in bench.filters
    }
    bench.curve = replace(
        curve,
        displacement=changed.get(bench.displacement, curve.displacement),
        force=changed.get(bench.force, curve.force),
    )


def _in_pieces(bench: Bench, name: str, raw: Signal, ends: list[float]) -> Floats:
    """A signal filtered between its corners, at the times of the curve; the bench keeps all."""
    at = [bench.from_curve_clock(end, raw.clock) for end in ends]
    cuts = np.searchsorted(raw.time, at, side="right").tolist()
    values = in_pieces(raw.values, cuts, bench.filters[name])
    filtered = replace(bench.signals[name], values=values)
    bench.signals[name] = filtered
    return at_times_of_curve(bench, filtered, bench.signals[bench.displacement].time)


def _treat_slips(bench: Bench, block: SlipsBlock) -> None:
    curve, stretch = bench.curve, loading_stretch(bench)
    if curve is None or stretch.stop <= stretch.start:
        return
    decision = SlipDecision(block.decision)
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    found = find_slips(displacement, force, min_drop=block.min_drop, decision=decision)
    if isinstance(found, Failure):
        bench.note("slips_not_looked_for", Severity.WARNING, bench.force, found.message)
        return
    bench.slips = tuple(
        replace(slip, start=slip.start + stretch.start, stop=slip.stop + stretch.start)
        for slip in found
    )
    if bench.slips and decision is SlipDecision.REPAIRED:
        _repair(bench, curve)
    elif bench.slips and decision is SlipDecision.CUT:
        _cut(bench, curve)


def _told(slip: Slip) -> str:
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


def _repair(bench: Bench, curve: Curve) -> None:
    """Add the drops back; what is left once the specimen broke is not raised."""
    force = add_back(curve.force, bench.slips)
    if isinstance(bench.failure, FailurePoint):
        broken = slice(bench.failure.sample + 1, None)
        force[broken] = curve.force[broken]
        raised = float(force[bench.failure.sample] - curve.force[bench.failure.sample])
        before = bench.failure.force
        moved = replace(before, value=before.value + raised)
        error = repair_error(bench, before=bench.failure.sample)
        bench.failure = replace(bench.failure, force=widened(moved, error))
    bench.curve = replace(curve, force=force)


def _cut(bench: Bench, curve: Curve) -> None:
    """Nothing counts from the first slip on."""
    kept = samples_before(bench.slips, len(curve.force))
    force = np.where(np.arange(len(curve.force)) < kept, curve.force, np.nan)
    branches = tuple(
        replace(each, stop=min(each.stop, kept), stop_time=float(curve.time[kept - 1]))
        if each.stop > kept
        else each
        for each in curve.branches
        if each.start < kept
    )
    bench.slips = bench.slips[:1]
    bench.curve = replace(curve, force=force, branches=branches)
    bench.failure = None if bench.failure is None else Failure("cut", "the curve ends at a slip")


def _take_off_slack(bench: Bench, block: SlackBlock) -> None:
    curve, stretch = bench.curve, loading_stretch(bench)
    if curve is None:
        return
    bench.slack = _slack(bench, curve, stretch, block)
    if isinstance(bench.slack, Failure) and bench.slack.code == "no_toe":
        bench.note("no_toe", Severity.WARNING, bench.displacement, bench.slack.message)
        return
    if isinstance(bench.slack, Failure):
        message = f"slack not found, so not taken off ({bench.slack.message})"
        bench.doubt("displacement", "slack_unknown", message, where=bench.displacement)
        return
    slack, alternative = bench.slack.value, bench.signals[bench.displacement].alternative
    other = None if alternative is None else alternative - slack
    _set_displacement(bench, curve, curve.displacement - slack, other)
    bench.slips = tuple(_moved(slip, slack) for slip in bench.slips)
    if isinstance(bench.failure, FailurePoint):
        at = bench.failure.displacement
        interval = at.interval and replace(
            at.interval, lower=at.interval.lower - slack, upper=at.interval.upper - slack
        )
        moved = replace(at, value=at.value - slack, interval=interval)
        bench.failure = replace(bench.failure, displacement=moved)
    message = f"{1e3 * slack:.4g} mm of slack taken off: displacement counts from where it is taut"
    bench.note("slack_removed", Severity.INFO, bench.displacement, message)


def _slack(bench: Bench, curve: Curve, stretch: slice, block: SlackBlock) -> Estimate | Failure:
    """Slack with the error from the zero of the force: a line too high meets zero early."""
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    fit = partial(fit_slack, displacement, start_share=block.start, stop_share=block.stop)
    found = fit(force)
    if isinstance(found, Failure):
        return found
    first = float(displacement[0])
    if found.value < first and not _preload_explains(found, fit(force - force[0]), first):
        return Failure(
            "no_toe",
            f"the line meets zero force at {1e3 * found.value:.4g} mm, before the first sample at "
            f"{1e3 * first:.4g} mm and {force[0]:.4g} N: the curve is steepest where it begins",
        )
    off = bench.raw[bench.force].zero_error
    raised = fit(force + off) if off else found
    change = 0.0 if isinstance(raised, Failure) else abs(raised.value - found.value)
    return widened(found, change)


def _preload_explains(slack: Estimate, above: Estimate | Failure, first: float) -> bool:
    """Whether a line back to zero force goes below the first sample because that one has a load.

    `above` is where the line reaches the force of the first sample: near that sample if the curve
    is straight from there on, close to `slack` if the curve was steeper than the line.
    """
    if slack.interval is not None and slack.interval.upper >= first:
        return True
    return isinstance(above, Estimate) and above.value - slack.value >= 0.5 * (first - slack.value)


def _moved(slip: Slip, slack: float) -> Slip:
    interval = slip.position_interval
    moved = replace(interval, lower=interval.lower - slack, upper=interval.upper - slack)
    return replace(slip, position=slip.position - slack, position_interval=moved)


def _set_displacement(
    bench: Bench, curve: Curve, displacement: Floats, alternative: Floats | None
) -> None:
    signal = bench.signals[bench.displacement]
    signal = replace(signal, values=displacement, alternative=alternative)
    bench.signals[bench.displacement] = signal
    bench.curve = replace(curve, displacement=displacement)
