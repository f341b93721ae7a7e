"""Check a test against its protocol.

The checks concern sizes, signs, zeros, holds, the start and end of the record, and instruments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import date
from itertools import pairwise
from typing import Any

import numpy as np

from labpipe.errors import format_overrides
from labpipe.messages import format_sentence
from labpipe.process.motion import Motion, orient_force
from labpipe.process.steps import PreparedTest
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Certificate
from labpipe.records.arrays import Flags, Floats, average_blocks, compute_median_step, drop_missing
from labpipe.records.curve import Branch, Direction
from labpipe.records.declarations import Limits, TravelFromSpeed
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, Findings
from labpipe.records.result import Instrument
from labpipe.records.signals import Signal, Signals
from labpipe.results.bending import compute_prop_force
from labpipe.signal.filters import compute_moving_average, convert_seconds_to_window
from labpipe.signal.turning_points import (
    compute_step_quantile,
    estimate_noise_level,
    find_level_jumps,
    moves_at_end,
)
from labpipe.units import GRAVITY


def check_signals(
    prepared: PreparedTest, motion: Motion, protocol: Protocol, findings: Findings
) -> Findings:
    """Run all checks of the signals, and add their findings.

    Parameters
    ----------
    prepared : test after all steps
    motion : motion of the test with its branches and clocks
    protocol : resolved protocol
    findings : findings of earlier checks

    Returns
    -------
    The earlier findings and the new ones.
    """
    for check in (check_rig, check_lost_samples, check_lowest_force, check_holds, check_zeros):
        findings += check(prepared, motion, protocol)
    if findings.blocking_reason is not None:
        return findings
    reversed_signs = check_signs(prepared, motion, protocol)
    if any(finding.code == "force_reversed" for finding in reversed_signs):
        findings = findings.remove_code("force_negative")  # the reversed sign explains this finding
    return findings + reversed_signs


def check_rig(prepared: PreparedTest, motion: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report cycles, stroke, speed and specimen length that differ from those of the protocol."""
    max_length_difference, max_length_deviation = 2e-3, 0.02  # m; fraction of the length
    rig, signal, branches = protocol.rig, motion.signal, motion.branches
    if branches and rig.cycles not in (None, branches[-1].cycle):
        facts: dict[str, Any] = {"measured": branches[-1].cycle, "expected": rig.cycles}
        yield Finding.of("process.cycles_unexpected", "rig.cycles", **facts)
    if branches and rig.stroke is not None and not is_full_stroke(signal, rig.stroke):
        facts = {"measured": 1e3 * _compute_range(signal.values), "expected": 1e3 * rig.stroke}
        yield Finding.of("process.stroke_unexpected", "rig.stroke", **facts)
    if branches and rig.crosshead_speed is not None and signal.has_time:
        speed, rig_speed = _measure_speed(signal, branches[0]), rig.crosshead_speed
        if abs(speed - rig_speed) > protocol.limits.speed_deviation * rig_speed:
            facts = {"measured": 1e3 * speed, "expected": 1e3 * rig_speed}
            where = "rig.crosshead_speed"
            yield Finding.of("process.speed_unexpected", where, "displacement", "force", **facts)
    length, markers, shape = protocol.specimen.length, protocol.markers, prepared.shape
    if length is None or markers is None or markers.clamp is None or shape is None:
        return
    if abs(shape.length - length) > max(max_length_difference, max_length_deviation * length):
        facts = {"measured": 1e3 * shape.length, "stated": 1e3 * length}
        yield Finding.of("process.length_unexpected", "specimen.length", "displacement", **facts)


def _measure_speed(signal: Signal, branch: Branch) -> float:
    """Measure the speed of a motion in a branch, m/s, as the median over equal parts of the travel.

    A pause hardly changes the median.
    """
    n_parts, min_duration = 20, 1e-9  # s, prevents a division by zero
    samples = slice(branch.start, branch.stop)
    is_valid = ~np.isnan(signal.values[samples])
    time, values = signal.time[samples][is_valid], signal.values[samples][is_valid]
    travel = np.maximum.accumulate(np.abs(values - values[0]))
    distances = np.linspace(0.0, travel[-1], n_parts + 1)
    durations = np.diff(np.interp(distances, travel, time))
    return float(distances[1] / max(np.median(durations), min_duration))


def check_lost_samples(
    prepared: PreparedTest, motion: Motion, protocol: Protocol
) -> Iterator[Finding]:
    """Report jumps of the motion or the force, if the two are recorded on two clocks.

    A machine cannot jump, and the force of a specimen in loading cannot rise much at once. Such a
    jump shows that samples were lost, and that the times after it are wrong. With one clock, lost
    samples do not matter, because each displacement still has its force. Jumps are searched in
    medians over 0.1 s, which noise hardly changes.
    """
    min_ratio, quantile = 1.5, 0.99  # jump divided by this quantile of the changes between blocks
    duration = 0.1  # duration of a block, s
    signals, branches = prepared.signals, protocol.branches
    force = orient_force(signals.raw[signals.force])
    if not motion.branches or branches is None or motion.signal.clock == force.clock:
        return
    for quantity, channel, signal in (
        ("displacement", branches.channel, motion.signal),
        ("force", signals.force, force),
    ):
        block_size = max(1, round(duration / compute_median_step(signal.time)))
        samples = drop_missing(signal.values)
        n_blocks = len(samples) // block_size
        medians = np.median(samples[: n_blocks * block_size].reshape(n_blocks, block_size), axis=1)
        middle_samples = np.flatnonzero(~np.isnan(signal.values))[block_size // 2 :: block_size]
        time = signal.time[middle_samples[:n_blocks]]
        usual_change = compute_step_quantile(medians, quantile)
        jumps = [
            (block, size)
            for block, size in find_level_jumps(time, medians, min_fraction=0.0)
            if abs(size) > min_ratio * usual_change
            and (quantity != "force" or (size > 0.0 and _is_rising(medians, block)))
        ]
        if jumps:
            block, size = max(jumps, key=lambda jump: abs(jump[1]))
            size_text = f"{1e3 * size:.4g} mm" if signal.unit == "m" else f"{size:.4g} N"
            facts: dict[str, Any] = {"channel": channel, "size": size_text, "duration": duration}
            facts |= {"at": time[block], "count": len(jumps), "ratio": abs(size) / usual_change}
            yield Finding.of("process.samples_lost", channel, quantity, "clock", **facts)


def _is_rising(values: Floats, jump_end: int) -> bool:
    """Return whether values rise both before and after a jump, which ends at an index."""
    reach = 20  # number of values on each side
    first, last = max(jump_end - reach, 0), min(jump_end + reach, len(values) - 1)
    return bool(values[first] < values[jump_end - 1] and values[jump_end] < values[last])


def _compute_range(values: Floats) -> float:
    """Compute the difference between the largest and the smallest finite value."""
    return float(np.nanmax(values) - np.nanmin(values))


def is_full_stroke(signal: Signal, rig_stroke: float | None) -> bool:
    """Return whether the stroke of a motion is that of the rig; False if the latter is not stated.

    Parameters
    ----------
    signal : channel whose turning points separate the branches
    rig_stroke : stroke of the rig, m; None if it is not stated
    """
    max_deviation = 0.02  # fraction of the stroke of the rig
    if rig_stroke is None:
        return False
    return abs(_compute_range(signal.values) - rig_stroke) <= max_deviation * rig_stroke


def check_lowest_force(prepared: PreparedTest, _: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report a force whose one-second means are below the lowest possible force."""
    block_duration, mean_duration, noise_factor = 0.1, 1.0, 5.0  # s; s; standard deviations
    weight_factor, force_margin = 1.2, 2e-3  # factor of the weight that the string carries; N
    string, specimen = protocol.rig.string, protocol.specimen
    force = prepared.signals.filtered.get(prepared.signals.force)
    if force is None or (string is None and specimen.span is None):
        return
    block_size = convert_seconds_to_window(block_duration, force.time)
    blocks = average_blocks(force.values, len(force.values) // block_size)
    window = convert_seconds_to_window(mean_duration, force.time[::block_size])
    window = min(window, len(blocks) - 1 + len(blocks) % 2)
    means = compute_moving_average(blocks, window=window)
    limits = list[tuple[float, str]]()
    if string is not None:
        # The force can fall below zero only by the weight that the string carries.
        mass, length = specimen.mass_per_length or 0.0, specimen.length or 0.0
        weight = string.counterweight * GRAVITY + compute_prop_force(GRAVITY * mass, length)
        limits.append((-weight_factor * weight - force_margin, "a string cannot push"))
    if specimen.span is not None and force.has_time:
        limit = -protocol.limits.pulling_force * float(np.nanmax(means))
        limits.append((limit, "a load that presses on a specimen cannot pull it"))
    lowest, noise_margin = float(np.nanmin(means)), noise_factor * estimate_noise_level(means)
    for limit, cause in limits:
        if lowest < limit - noise_margin:
            yield Finding.of("process.force_negative", "force", "force", lowest=lowest, cause=cause)


def check_zeros(prepared: PreparedTest, motion: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report a zero whose stretch overlaps the motion."""
    if not motion.branches:
        return
    signals, overlap = prepared.signals, protocol.limits.zero_overlap
    start, stop = motion.branches[0].start_time, motion.branches[-1].stop_time
    for name, stretch in signals.zero_stretches.items():
        ends = [motion.clocks.to_curve(end, signals.raw[name].clock) for end in stretch]
        if ends[1] > start + overlap and ends[0] < stop - overlap:
            quantity = "force" if name == signals.force else "displacement"
            facts: dict[str, Any] = {"ends": ends, "start": start, "stop": stop}
            yield Finding.of("process.zero_not_at_rest", name, quantity, **facts)


def check_mid_span(
    prepared: PreparedTest, motion: Motion, limits: Limits
) -> tuple[PreparedTest, list[Finding]]:
    """Compare the deflection of mid-span with the displacement.

    Parameters
    ----------
    prepared : test after all steps, with the signal ``mid_span`` if cameras recorded it
    motion : motion of the displacement with its branches and clocks
    limits : limits of the protocol. Round rollers cause a difference of up to a tenth, because the
        specimen rolls on them and is below the nominal supports

    Returns
    -------
    The test, and at most one finding. The finding reports that deflection and displacement differ,
    or that the cameras started under load. In the latter case the returned test has no bent axis.
    """
    mid_span, span = prepared.signals.raw.get("mid_span"), prepared.span
    if mid_span is None or span is None or isinstance(span, Failure) or not motion.branches:
        return prepared, []
    rest_end = motion.clocks.to_curve(span.time[span.is_at_rest], mid_span.clock)[-1]
    delay = rest_end - motion.branches[0].start_time
    if delay > limits.zero_overlap:
        finding = Finding.of("process.no_rest", "markers", delay=delay)
        return replace(prepared, span=Failure("no_rest", finding.note.message)), [finding]
    deflection, travel = (1e3 * _compute_range(x.values) for x in (mid_span, motion.signal))  # mm
    if abs(deflection - travel) <= limits.mid_span_deviation * travel:
        return prepared, []
    facts: dict[str, Any] = {"deflection": deflection, "travel": travel}
    finding = Finding.of("process.mid_span_differs", "mid_span", "displacement", **facts)
    return prepared, [finding]


def check_signs(prepared: PreparedTest, motion: Motion, protocol: Protocol) -> list[Finding]:
    """Report signals that fall while the specimen is loaded, unless the protocol allows them to.

    Parameters
    ----------
    prepared : test after all steps
    motion : motion of the test with its branches and clocks
    protocol : protocol, whose ``curve.reverse`` lists the reversed signals; an empty list allows
        any sign

    Notes
    -----
    Loading is the branch in which the absolute force grows most. The displacement is reversed only
    if it falls in that branch and in the first one. If both signals fall, as in compression,
    results without a sign (energy, stiffness) are not affected. A force with both signs, each with
    more than a fifth of the largest force, has no wrong sign, and neither has its displacement.
    """
    max_opposite_fraction = 0.2  # opposite force as a fraction of the largest force
    error_factor, n_blocks = 10.0, 200  # standard errors of a block mean; blocks of the record
    signals, curve, branches = prepared.signals, protocol.curve, motion.branches
    displacement = signals.raw[signals.displacement]
    if curve is None or not branches:
        return []
    time, force_signal = displacement.time, signals.raw[signals.force]
    force = motion.clocks.interpolate(force_signal, time)
    masks = [(time >= x.start_time) & (time <= x.stop_time) for x in branches]
    means = average_blocks(drop_missing(force), n_blocks)
    branch_means = [np.abs(average_blocks(drop_missing(force[x]), n_blocks)) for x in masks]
    growths = [float(np.max(values - values[:1], initial=0.0)) for values in branch_means]
    if len(means) < 2 or not max(growths) > 0.0:
        return []
    noise_margin = error_factor * estimate_noise_level(force) * np.sqrt(len(means) / len(force))
    largest_force = float(means[int(np.argmax(np.abs(means)))])  # with its sign
    opposite_force = float((-np.sign(largest_force) * means).max())
    max_opposite_force = max_opposite_fraction * abs(largest_force) + noise_margin
    if np.ptp(means) <= noise_margin or opposite_force > max_opposite_force:
        return []
    loading_masks = masks[np.argmax(growths)], masks[0]
    travels = [drop_missing(displacement.values[mask]) for mask in loading_masks]
    is_measured = signals.displacement in protocol.channels and all(map(len, travels))
    is_falling = {
        "force": largest_force < 0.0,
        "displacement": is_measured and all(travel[-1] < travel[0] for travel in travels),
    }
    lowest = 1e3 * float(np.nanmin(displacement.values))
    lowest_values = {"force": f"{largest_force:.3g} N", "displacement": f"{lowest:.3g} mm"}
    reported_names = lowest_values if curve.reverse is None else curve.reverse
    names = [name for name in lowest_values if is_falling[name] and name in reported_names]
    signs = " and ".join(f"the {name} goes to {lowest_values[name]}" for name in names)
    name_list = ", ".join(names)
    if curve.reverse:
        remedy = format_sentence("process.signs_reversed", names=name_list)
    else:
        override = format_overrides("curve.reverse", f"[{name_list}]")
        remedy = format_sentence("process.signs_to_reverse", names=override)
    facts: dict[str, Any] = {"signs": signs, "remedy": remedy}
    suffix = "_sign" if len(names) > 1 else ""
    findings = []
    if "force" in names:
        # The clocks are aligned at peaks of the force.
        quantities = [f"force{suffix}", *([] if motion.clocks.force_fit is None else ["clock"])]
        findings.append(Finding.of("process.force_reversed", signals.force, *quantities, **facts))
    if "displacement" in names:
        name, quantity = signals.displacement, f"displacement{suffix}"
        findings.append(Finding.of("process.displacement_reversed", name, quantity, **facts))
    return findings


def check_start(signals: Signals, motion: Motion, *, has_slack: bool) -> Iterator[Finding]:
    """Report a record that begins under load.

    Parameters
    ----------
    signals : signals of the test with the levels that were subtracted from them
    motion : motion of the test with its branches and clocks
    has_slack : whether slack was subtracted from the displacement

    Yields
    ------
    Findings that the work done before the record is unknown (quantity ``start``), and that signals
    were zeroed by a line through their first samples.

    Notes
    -----
    A record that begins at rest is not doubtful, because its load cell may have an offset. A test
    is also not doubtful if its cycles return to the load at its beginning, within half of that
    load. A force below a tenth of the range counts as a load only if the displacement begins above
    a hundredth of its range. A record begins with an unloading if its first force is above half of
    the range of the force, and falls below half of its value in the first branch.
    """
    noise_factor = 5.0  # standard deviations of the force
    # A force between the first two limits (fractions of its range) is a load only if the
    # displacement is above the third limit (a fraction of its range). Otherwise it is an offset of
    # the load cell.
    min_load, certain_load, min_travel = 0.02, 0.1, 0.01
    oriented_record = _orient_record(signals, motion) if motion.branches else None
    if oriented_record is None:
        return
    time, force, travel, is_in_branch = oriented_record
    branch_force, where = force[is_in_branch], signals.force
    load, relative_load = float(branch_force[0]), float(branch_force[0] / np.ptp(force))
    if relative_load > 0.5 and branch_force[-1] < 0.5 * load:
        quantities = "force", "displacement", "start"
        yield Finding.of("process.begins_with_unloading", where, *quantities, load=load)
        return
    end_forces = np.interp([branch.stop_time for branch in motion.branches[1::2]], time, force)
    returns_to_load = len(end_forces) > 0 and (np.abs(end_forces - load) <= 0.5 * load).all()
    is_zero = not load > noise_factor * estimate_noise_level(force)
    is_displaced = travel[is_in_branch][0] >= min_travel * np.ptp(travel)
    is_loaded = relative_load >= (min_load if is_displaced else certain_load)
    if is_zero or returns_to_load or not is_loaded:
        yield from _check_first_sample(signals.displacement, force, travel)
        return
    zeroed_names = [name for name in signals.quantities if name in signals.moving_zero_stretches]
    zeroed_quantities = [signals.quantities[name] for name in zeroed_names]
    if has_slack and zeroed_quantities == ["displacement"]:
        zeroed_quantities = []  # because the slack correction restores this zero
    start_period = float(time[0]), max(float(time[0]), motion.branches[0].start_time)
    zeros = f"; {' and '.join(zeroed_names)} zeroed there" if zeroed_names else ""
    facts: dict[str, Any] = {"load": load, "relative_load": relative_load, "zeros": zeros}
    facts |= {"position": 1e3 * float(travel[0])}
    for affected, period in ((["start"], start_period), (zeroed_quantities, None)):
        if affected:
            yield Finding.of("process.begins_under_load", where, *affected, period=period, **facts)


def _orient_record(signals: Signals, motion: Motion) -> tuple[Floats, Floats, Floats, Flags] | None:
    """Return time (s), force (N) and travel (m), and flag the samples in the first branch.

    Force and travel are positive in loading and have the zeros of the export. The result is None if
    force or travel is constant, if the first branch is too short, or if the record begins at rest.
    """
    min_samples, max_rest_samples = 4, 3.0  # samples of the branch; samples before the branch
    time = signals.raw[signals.displacement].time
    force, travel = (
        motion.clocks.interpolate(signals.raw[name], time)
        + signals.subtracted_levels.get(name, 0.0)
        for name in (signals.force, signals.displacement)
    )
    is_finite = np.isfinite(force) & np.isfinite(travel)
    time, force, travel = time[is_finite], force[is_finite], travel[is_finite]
    start, stop = motion.branches[0].start_time, motion.branches[0].stop_time
    is_in_branch = (time >= start) & (time <= stop)
    if is_in_branch.sum() < min_samples or not np.ptp(force) > 0.0 or not np.ptp(travel) > 0.0:
        return None
    force = force * np.sign(force[int(np.argmax(np.abs(force)))])
    travel = travel * (np.sign(travel[is_in_branch][-1] - travel[is_in_branch][0]) or 1.0)
    begins_at_rest = start - time[0] > max_rest_samples * (time[-1] - time[0]) / len(time)
    return None if begins_at_rest else (time, force, travel, is_in_branch)


def _check_first_sample(channel: str, force: Floats, travel: Floats) -> Iterator[Finding]:
    """Report a record that was zeroed in mid-stroke, so that the machine later moves below zero.

    Parameters
    ----------
    channel : name of the channel of the displacement
    force, travel : shape (n,), force (N) and displacement (m) with the zeros of the export
    """
    max_zero_fraction = 0.01  # absolute value of the first sample as a fraction of the range
    # Travel (or force) below zero divided by travel (or force) above zero. A test that moves to
    # both sides travels as far below as above.
    min_ratio, max_ratio = 0.05, 0.8
    is_zeroed = all(abs(x[0]) <= max_zero_fraction * np.ptp(x) for x in (force, travel))
    force_below, force_above = -force.min(), force.max()
    travel_below, travel_above = -travel.min(), travel.max()
    is_below = min_ratio * travel_above < travel_below < max_ratio * travel_above
    if is_zeroed and is_below and force_below > min_ratio * force_above:
        facts: dict[str, Any] = {"travel": 1e3 * travel_below, "force": force_below}
        quantities = "displacement", "force", "start"
        yield Finding.of("process.zeroed_in_mid_stroke", channel, *quantities, **facts)


_CUT_FILE_CODES = {"truncated", "rows_differ"}
"""Codes of readers' notes on exports whose last rows may be missing."""


def find_cut_ends(
    signals: Signals, motion: Motion, protocol: Protocol, findings: Findings
) -> dict[str, float]:
    """Find the times at which the records of force and displacement stop within a branch.

    Parameters
    ----------
    signals : signals of the test
    motion : motion of the test with its branches and clocks
    protocol : protocol with the stroke of the rig
    findings : findings with the notes of the readers on exports that may be cut off

    Returns
    -------
    Last time (s on the clock of the curve) of each quantity whose record is cut off; empty if both
    records are complete.
    """
    max_missing_samples = 2.0  # samples that may be missing at the end of the force
    signal, limits, end_times = motion.signal, protocol.limits, dict[str, float]()
    if not motion.branches:
        return {}
    last_branch = motion.branches[-1]
    rows = slice(last_branch.start, None)
    is_finite = ~np.isnan(signal.values[rows])
    time, values = signal.time[rows][is_finite], signal.values[rows][is_finite]
    if moves_at_end(time, values):
        is_single, stroke = len(motion.branches) == 1, protocol.rig.stroke
        is_complete = is_full_stroke(signal, stroke) if is_single else _has_arrived(motion, limits)
        if not is_complete or any(note.code in _CUT_FILE_CODES for note in findings.notes):
            end_times = dict.fromkeys(("force", "displacement"), float(time[-1]))
    force = signals.raw[signals.force]
    last_sample = int(np.flatnonzero(~np.isnan(force.values))[-1])
    force_end = motion.clocks.to_curve(float(force.time[last_sample]), force.clock)
    time_step = float(signal.time[-1] - signal.time[0]) / max(1, len(signal.time) - 1)
    duration = last_branch.stop_time - last_branch.start_time
    max_missing_time = max(limits.force_shortfall * duration, max_missing_samples * time_step)
    is_cut = force_end < last_branch.stop_time - max_missing_time
    return end_times | {"force": force_end} if is_cut else end_times


def _has_arrived(motion: Motion, limits: Limits) -> bool:
    """Return whether the last branch ends where the previous branch in the same direction ended.

    An unloading without a previous one must end at the initial position.
    """
    noise_factor = 5.0  # standard deviations of the motion
    values, branches, last_branch = motion.signal.values, motion.branches, motion.branches[-1]
    travel = float(drop_missing(values)[-1] - values[last_branch.start])
    rising_values = values if travel > 0.0 else -values  # rising in the last branch
    is_loading = last_branch.direction is Direction.LOADING
    turn_positions = [] if is_loading else [float(rising_values[branches[0].start])]
    turn_positions += [
        float(np.nanmax(rising_values[branch.start : branch.stop + 1]))
        for branch in branches[:-1]
        if branch.direction is last_branch.direction
    ]
    # Near the peak the force depends strongly on the displacement. At the end of unloading the
    # force is small.
    shortfall = limits.loading_shortfall if is_loading else limits.unloading_shortfall
    step = abs(travel) / max(1, last_branch.stop - last_branch.start)  # mean per sample
    noise_margin = noise_factor * estimate_noise_level(values)
    tolerance = max(shortfall * _compute_range(values), step, noise_margin)
    end_position = float(drop_missing(rising_values)[-1])
    return bool(turn_positions) and end_position >= turn_positions[-1] - tolerance


def check_holds(prepared: PreparedTest, motion: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report holds of the motion at its turns, and at its end away from the initial position.

    Rests before the first branch and at the initial position are not holds.
    """
    min_rows = 5.0  # shortest hold in rows, if the export has no times
    max_return_distance, max_hold_motion = 0.1, 0.01  # fractions of the stroke
    signal, branches = motion.signal, motion.branches
    if not branches:
        return
    unit, min_duration = ("s", protocol.limits.hold_time) if signal.has_time else ("rows", min_rows)
    is_finite = ~np.isnan(signal.values)
    time, values = signal.time[is_finite], signal.values[is_finite]
    pauses = [(first.stop_time, second.start_time) for first, second in pairwise(branches)]
    final_values, stroke = values[time >= branches[-1].stop_time], np.ptp(values)
    is_away = abs(values[-1] - signal.values[branches[0].start]) > max_return_distance * stroke
    if is_away and len(final_values) and np.ptp(final_values) <= max_hold_motion * stroke:
        pauses.append((branches[-1].stop_time, float(time[-1])))
    holds = [pause for pause in pauses if pause[1] - pause[0] >= min_duration]
    if holds:
        longest = max(stop - start for start, stop in holds)
        position = 1e3 * float(np.interp(sum(holds[0]) / 2.0, time, values))
        facts: dict[str, Any] = {"count": len(holds), "longest": longest, "unit": unit}
        facts |= {"start": holds[0][0], "position": position}
        yield Finding.of("process.hold", prepared.signals.displacement, **facts)


def list_certified_instruments(protocol: Protocol) -> tuple[Instrument, ...]:
    """List the instruments with certificates, and the quantities that they measure.

    Parameters
    ----------
    protocol : protocol with certificates of its channels and cameras
    """
    curve, cameras = protocol.curve, protocol.sources.get("markers")
    quantities = {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    instruments: list[tuple[str, Certificate | None, tuple[str, ...]]] = [
        (name, channel.certificate, (quantities.get(name, name),))
        for name, channel in protocol.channels.items()
    ]
    if cameras is not None:
        channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
        is_camera_only = curve is None or curve.displacement not in channels | {*protocol.channels}
        camera_quantities = ("mid_span", "displacement") if is_camera_only else ("mid_span",)
        instruments.append(("markers", cameras.certificate, camera_quantities))
    return tuple(
        Instrument(
            channel=name,
            measures=measured_quantities,
            certificate=certificate.number,
            calibrated=certificate.date,
            due=certificate.due,
            uncertainty=certificate.uncertainty,
            k=certificate.k,
        )
        for name, certificate, measured_quantities in instruments
        if certificate is not None
    )


def check_answers(protocol: Protocol, observed: Mapping[str, str]) -> Iterator[Finding]:
    """Report the questions of the protocol that the test sheet does not answer.

    Parameters
    ----------
    protocol : protocol with its questions
    observed : answers of the test sheet, keyed by question
    """
    for name, answers in protocol.questions.items():
        if name not in observed:
            facts: dict[str, Any] = {"name": name, "answers": ", ".join(answers)}
            yield Finding.of("process.question_open", name, "observation", **facts)


def check_calibration_due(protocol: Protocol, test_date: date | None) -> Iterator[Finding]:
    """Report instruments whose calibration expired before the test.

    Parameters
    ----------
    protocol : protocol with certificates of its channels and cameras
    test_date : day of the test; if it is not known (None), nothing is reported
    """
    for instrument in list_certified_instruments(protocol):
        if instrument.due is not None and test_date is not None and test_date > instrument.due:
            facts: dict[str, Any] = {"instrument": instrument, "tested": test_date}
            where, quantities = instrument.channel, instrument.measures
            yield Finding.of("process.calibration_overdue", where, *quantities, **facts)
