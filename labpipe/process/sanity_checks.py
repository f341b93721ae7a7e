"""Check a test against its protocol: sizes, signs, zeros, start and end of its record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import date
from itertools import pairwise

import numpy as np

from labpipe.errors import format_overrides
from labpipe.messages import format_sentence
from labpipe.process.motion import Motion
from labpipe.process.steps import Prepared
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Certificate
from labpipe.records.arrays import Flags, Floats, average_between
from labpipe.records.curve import Direction
from labpipe.records.declarations import Limits, TravelFromSpeed
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, Findings
from labpipe.records.result import Instrument
from labpipe.records.signals import Signal, Signals
from labpipe.results.bending import compute_prop_force
from labpipe.signal.filters import compute_moving_average, convert_seconds_to_window
from labpipe.signal.turning_points import estimate_noise_level, moves_at_end
from labpipe.units import GRAVITY


def check_signals(
    prepared: Prepared, motion: Motion, protocol: Protocol, findings: Findings
) -> Findings:
    """Add the findings of all checks before the curve is built.

    Parameters
    ----------
    prepared : test after all steps
    motion : motion of the test, with joined clocks
    protocol : resolved protocol
    findings : findings of the checks before
    """
    for check in (check_rig, check_force, find_holds, check_rest):
        findings += check(prepared, motion, protocol)
    if findings.blocked is not None:
        return findings
    reversed_signs = check_signs(prepared, motion, protocol)
    if any(finding.code == "force_reversed" for finding in reversed_signs):
        findings = findings.remove_code("force_negative")  # the reversed sign is its cause
    return findings + reversed_signs


def check_rig(prepared: Prepared, motion: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report cycles, stroke, speed and specimen length that differ from those stated."""
    rig, travel, branches, shape = protocol.rig, motion.signal, motion.branches, prepared.shape
    if branches and rig.cycles not in (None, len({branch.cycle for branch in branches})):
        cycles, expected = branches[-1].cycle, rig.cycles
        yield Finding.of(
            "process.cycles_unexpected", "rig.cycles", measured=cycles, expected=expected
        )
    if branches and rig.stroke is not None and not is_full_stroke(motion.signal, rig.stroke):
        measured, expected_stroke = 1e3 * _measure_travel(travel.values), 1e3 * rig.stroke
        yield Finding.of(
            "process.stroke_unexpected", "rig.stroke", measured=measured, expected=expected_stroke
        )
    if branches and rig.crosshead_speed is not None and travel.has_time:
        first, speed = branches[0], rig.crosshead_speed
        duration = max(first.stop_time - first.start_time, 1e-9)
        measured = _measure_travel(travel.values[first.start : first.stop]) / duration
        if abs(measured - speed) > protocol.limits.speed_deviation * speed:
            where, measured, speed = "rig.crosshead_speed", 1e3 * measured, 1e3 * speed
            doubtful = "displacement", "force"
            yield Finding.of(
                "process.speed_unexpected", where, *doubtful, measured=measured, expected=speed
            )
    length, markers = protocol.specimen.length, protocol.markers
    if length is None or markers is None or markers.clamp is None or shape is None:
        return
    if abs(shape.length - length) > max(2e-3, 0.02 * length):
        where, measured_length, stated = "specimen.length", 1e3 * shape.length, 1e3 * length
        yield Finding.of(
            "process.length_unexpected", where, "displacement", seen=measured_length, stated=stated
        )


def _measure_travel(values: Floats) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def is_full_stroke(motion: Signal, expected: float | None) -> bool:
    """Check whether the motion has the stroke of the rig; False if that is unknown.

    Parameters
    ----------
    motion : the channel that splits the branches
    expected : m
    """
    if expected is None:
        return False
    return abs(_measure_travel(motion.values) - expected) <= 0.02 * expected


def check_force(prepared: Prepared, _: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report a force whose one-second means are below the lowest force that its load can cause."""
    string, specimen = protocol.rig.string, protocol.specimen
    force = prepared.signals.filtered.get(prepared.signals.force)
    if force is None or (string is None and specimen.span is None):
        return
    size = max(1, convert_seconds_to_window(0.1, force.time))
    blocks = force.values[: len(force.values) // size * size].reshape(-1, size).mean(axis=1)
    window = max(1, convert_seconds_to_window(1.0, force.time[::size]))
    means = compute_moving_average(blocks, window=min(window, len(blocks) - 1 + len(blocks) % 2))
    limits = list[tuple[float, str]]()
    if string is not None:  # the force can fall by the weight on the string only
        mass, length = specimen.mass_per_length or 0.0, specimen.length or 0.0
        weight = string.counterweight * GRAVITY + compute_prop_force(GRAVITY * mass, length)
        limits.append((-1.2 * weight - 2e-3, "a string cannot push"))
    if specimen.span is not None and force.has_time:
        lowest = -protocol.limits.pulling_force * float(np.nanmax(means))
        limits.append((lowest, "a load that presses on a specimen cannot pull it"))
    lowest, noise = float(np.nanmin(means)), estimate_noise_level(means)
    for limit, why in limits:
        if lowest < limit - 5.0 * noise:
            yield Finding.of("process.force_negative", "force", "force", lowest=lowest, why=why)


def check_rest(prepared: Prepared, motion: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report a zero whose stretch overlaps the motion."""
    if not motion.branches:
        return
    signals, overlap = prepared.signals, protocol.limits.zero_overlap
    moves = motion.branches[0].start_time, motion.branches[-1].stop_time
    for name, stretch in signals.zero_stretches.items():
        ends = [motion.clocks.to_curve(end, signals.raw[name].clock) for end in stretch]
        if ends[1] > moves[0] + overlap and ends[0] < moves[1] - overlap:
            quantity = "force" if name == signals.force else "displacement"
            yield Finding.of("process.zero_not_at_rest", name, quantity, rest=ends, moves=moves)


def check_mid_span(
    prepared: Prepared, motion: Motion, limits: Limits
) -> tuple[Prepared, list[Finding]]:
    """Reject cameras that began under load, and report a displacement that differs from theirs.

    Parameters
    ----------
    prepared : its ``mid_span`` is used if there is one
    motion : motion of the displacement, with joined clocks
    limits : limits of the lab. Round rollers cause a difference of up to a tenth, because the
        specimen rolls on them and is below the nominal supports.
    """
    mid_span, span = prepared.signals.raw.get("mid_span"), prepared.span
    if mid_span is None or span is None or isinstance(span, Failure) or not motion.branches:
        return prepared, []
    rest_end = motion.clocks.to_curve(span.time[span.rest], mid_span.clock)[-1]
    delay = rest_end - motion.branches[0].start_time
    if delay > limits.zero_overlap:
        note = Finding.of("process.no_rest", "markers", delay=delay)
        return replace(prepared, span=Failure("no_rest", note.note.message)), [note]
    seen = _measure_travel(mid_span.values)
    measured = _measure_travel(motion.signal.values)
    if abs(seen - measured) <= limits.mid_span_deviation * measured:
        return prepared, []
    seen, measured, doubtful = 1e3 * seen, 1e3 * measured, "displacement"
    return prepared, [
        Finding.of("process.mid_span_differs", "mid_span", doubtful, seen=seen, measured=measured)
    ]


def check_signs(prepared: Prepared, motion: Motion, protocol: Protocol) -> list[Finding]:
    """Report signals that fall while the specimen is loaded, unless the protocol allows it.

    Parameters
    ----------
    prepared, motion : test after all steps, and its motion with joined clocks
    protocol : its ``curve.reverse`` lists reversed signals; an empty list allows the signs

    Notes
    -----
    Loading is the branch in which the absolute force grows most. The displacement is reversed only
    if it falls in that branch and in the first one. If both signals fall, as in compression,
    numbers without a sign (energy, stiffness) are not affected. A force with both signs, each with
    more than a fifth of the largest force, has no wrong sign, and neither has its displacement.
    """
    max_opposite_share, error_factor = 0.2, 10.0  # of the largest force; of a block mean
    signals, curve = prepared.signals, protocol.curve
    displacement, time = signals.raw[signals.displacement], signals.raw[signals.displacement].time
    if curve is None or not motion.branches:
        return []
    force = motion.clocks.interpolate(signals.raw[signals.force], time)
    parts = [(time >= x.start_time) & (time <= x.stop_time) for x in motion.branches]
    sizes, means = [np.abs(_average_blocks(force[part])) for part in parts], _average_blocks(force)
    growths = [float(np.max(size - size[:1], initial=0.0)) for size in sizes]
    if len(means) < 2 or not max(growths) > 0.0:
        return []
    noise = error_factor * estimate_noise_level(force) / np.sqrt(max(1.0, len(force) / len(means)))
    top = float(means[int(np.argmax(np.abs(means)))])
    opposite = float((-np.sign(top) * means).max())
    if np.ptp(means) <= noise or opposite > max_opposite_share * abs(top) + noise:
        return []
    loading = parts[int(np.argmax(growths))], parts[0]
    paths = [values[~np.isnan(values)] for values in (displacement.values[x] for x in loading)]
    is_measured = signals.displacement in protocol.channels and all(map(len, paths))
    is_falling = {
        "force": top < 0.0,
        "displacement": is_measured and all(values[-1] < values[0] for values in paths),
    }
    lowest = 1e3 * float(np.nanmin(displacement.values))
    texts = {"force": f"{top:.3g} N", "displacement": f"{lowest:.3g} mm"}
    names = [x for x in texts if is_falling[x] and (curve.reverse is None or x in curve.reverse)]
    name_list, signs = ", ".join(names), " and ".join(f"the {x} goes to {texts[x]}" for x in names)
    remedy = format_sentence(
        "process.signs_reversed" if curve.reverse else "process.signs_to_reverse",
        names=name_list if curve.reverse else format_overrides("curve.reverse", f"[{name_list}]"),
    )
    # clocks are joined at peaks of the force
    clock = ("clock",) if motion.clocks.force is not None else ()
    return [
        Finding.of(
            "process.force_reversed" if name == "force" else "process.displacement_reversed",
            getattr(signals, name),
            f"{name}_sign" if len(names) > 1 else name,
            *(clock if name == "force" else ()),
            signs=signs,
            remedy=remedy,
        )
        for name in names
    ]


def _average_blocks(values: Floats) -> Floats:
    """Return means of the finite values over at most 200 blocks."""
    finite = values[~np.isnan(values)]
    starts = np.linspace(0, len(finite), min(200, len(finite)), endpoint=False).astype(np.int64)
    return average_between(finite, starts) if len(finite) else finite


def check_start(signals: Signals, motion: Motion, *, has_slack: bool) -> Iterator[Finding]:
    """Report a record that begins under load, and doubt the results that depend on its start.

    Parameters
    ----------
    signals : signals of the test, with the levels that zeros subtracted
    motion : motion of the test, with joined clocks
    has_slack : whether slack was subtracted from the displacement

    Yields
    ------
    Doubts of signals that were zeroed by a line through the first rows, and of the work done before
    (quantity ``start``).

    Notes
    -----
    A record that begins at rest is not doubted, because its load cell may have an offset. Nor is a
    test whose cycles return to the load at its beginning. A small force counts as a load if it is
    proportional to the displacement within a factor of three.
    """
    noise_factor = 5.0
    branch_data = _read_first_branch(signals, motion) if motion.branches else None
    if branch_data is None:
        return
    time, force, path, is_in_branch = branch_data
    load, share = float(force[is_in_branch][0]), float(force[is_in_branch][0] / np.ptp(force))
    where = signals.force
    zeroed = [name for name in signals.quantities if name in signals.moving_zero_stretches]
    if share > 0.5 and force[is_in_branch][-1] < 0.5 * load:
        doubtful = "force", "displacement", "start"
        yield Finding.of("process.begins_with_unloading", where, *doubtful, load=load)
        return
    ends = np.interp([branch.stop_time for branch in motion.branches[1::2]], time, force)
    returns = len(ends) > 0 and (np.abs(ends - load) <= 0.5 * load).all()
    is_zero = not load > noise_factor * estimate_noise_level(force)
    is_loaded = _is_loaded(force[is_in_branch], path[is_in_branch], float(np.ptp(path)), share)
    if is_zero or returns or not is_loaded:
        yield from _check_zero(signals.displacement, force, path)
        return
    # The slack correction restores the zero of displacement if the zero of the force is correct.
    is_restored = has_slack and signals.force not in zeroed
    doubts = [x for x in zeroed if not (is_restored and x == signals.displacement)]
    first = float(time[0]), max(float(time[0]), motion.branches[0].start_time)
    for names, period in ((["start"], first), ([signals.quantities[x] for x in doubts], None)):
        if names:
            yield Finding.of(
                "process.begins_under_load",
                where,
                *names,
                period=period,
                load=load,
                share=share,
                place=1e3 * float(path[0]),
                zeroed=f"; {' and '.join(zeroed)} zeroed there" if zeroed else "",
            )


def _read_first_branch(
    signals: Signals, motion: Motion
) -> tuple[Floats, Floats, Floats, Flags] | None:
    """Return time, force and path as exported, positive in loading, and flags of the first branch.

    None if force or path is constant, or if the record begins at rest.
    """
    min_samples = 4
    time = signals.raw[signals.displacement].time
    force, path = (
        motion.clocks.interpolate(signals.raw[name], time)
        + signals.subtracted_levels.get(name, 0.0)
        for name in (signals.force, signals.displacement)
    )
    is_finite = np.isfinite(force) & np.isfinite(path)
    time, force, path = time[is_finite], force[is_finite], path[is_finite]
    start, stop = motion.branches[0].start_time, motion.branches[0].stop_time
    is_in_branch = (time >= start) & (time <= stop)
    if is_in_branch.sum() < min_samples or not np.ptp(force) > 0.0 or not np.ptp(path) > 0.0:
        return None
    force = force * np.sign(force[int(np.argmax(np.abs(force)))])
    path = path * (np.sign(path[is_in_branch][-1] - path[is_in_branch][0]) or 1.0)
    begins_at_rest = start - time[0] > 3.0 * (time[-1] - time[0]) / len(time)
    return None if begins_at_rest else (time, force, path, is_in_branch)


def _check_zero(where: str, force: Floats, path: Floats) -> Iterator[Finding]:
    """Report a first sample at zero below which the machine returns and unloads.

    Parameters
    ----------
    where : channel of the displacement
    force, path : shape (n,), N, m, as exported
    """
    max_zero_share = 0.01  # of the range
    # Travel below the first sample over travel above. A test to both sides begins in the middle.
    min_ratio, max_ratio = 0.05, 0.8
    is_zeroed = all(abs(x[0]) <= max_zero_share * np.ptp(x) for x in (force, path))
    force_below, force_above = -force.min(), force.max()
    travel_below, travel_above = -path.min(), path.max()
    is_below = min_ratio * travel_above < travel_below < max_ratio * travel_above
    if is_zeroed and is_below and force_below > min_ratio * force_above:
        yield Finding.of(
            "process.zeroed_in_mid_stroke",
            where,
            *("displacement", "force", "start"),
            travel=1e3 * travel_below,
            force=force_below,
        )


def _is_loaded(force: Floats, path: Floats, path_range: float, share: float) -> bool:
    """Check whether the first force of a branch is a load, not an offset of the load cell."""
    min_load_share, min_path_share, certain_load_share = 0.02, 0.01, 0.1  # of the ranges
    line_factor, start_share, min_samples = 3.0, 0.05, 4
    size = max(min_samples, int(np.sum(np.abs(path - path[0]) <= start_share * path_range)))
    steps = path[:size] - path[:size].mean()
    line_force = float(steps @ force[:size]) / max(float(steps @ steps), 1e-300) * path[0]
    is_on_line = force[0] / line_factor <= line_force <= line_factor * force[0]
    has_moved = path[0] >= min_path_share * path_range
    return share >= certain_load_share or bool(share >= min_load_share and has_moved and is_on_line)


_CUT_FILE_CODES = {"truncated", "rows_differ"}
"""Codes of readers' notes on exports whose last rows may be missing."""


def find_cut_ends(
    signals: Signals, motion: Motion, protocol: Protocol, findings: Findings
) -> dict[str, float]:
    """Find the ends of a record that stops in the middle of a branch.

    Parameters
    ----------
    signals, motion : signals of the test, and its motion with joined clocks
    protocol : protocol with the stroke of the rig
    findings : findings with the notes of the readers on exports that may be cut off

    Returns
    -------
    End by quantity, s on the clock of the curve; empty for a complete record.
    """
    travel, limits, ends = motion.signal, protocol.limits, dict[str, float]()
    if not motion.branches:
        return {}
    last = motion.branches[-1]
    is_finite = ~np.isnan(travel.values[last.start :])
    time = travel.time[last.start :][is_finite]
    values = travel.values[last.start :][is_finite]
    if moves_at_end(time, values):
        is_cut = any(finding.code in _CUT_FILE_CODES for finding in findings.entries)
        is_single, stroke = len(motion.branches) == 1, protocol.rig.stroke
        arrives = is_full_stroke(travel, stroke) if is_single else _has_arrived(motion, limits)
        if is_cut or not arrives:
            ends = dict.fromkeys(("force", "displacement"), float(time[-1]))
    force = signals.raw[signals.force]
    last_sample = len(force.values) - 1 - int(np.argmin(np.isnan(force.values[::-1])))
    force_end = motion.clocks.to_curve(float(force.time[last_sample]), force.clock)
    time_step = float(travel.time[-1] - travel.time[0]) / max(1, len(travel.time) - 1)
    missing = max(limits.force_shortfall * (last.stop_time - last.start_time), 2.0 * time_step)
    return ends | {"force": force_end} if force_end < last.stop_time - missing else ends


def _has_arrived(motion: Motion, limits: Limits) -> bool:
    """Check whether the last branch reaches the end of the one before it."""
    values, branches, last = motion.signal.values, motion.branches, motion.branches[-1]
    start, end = float(values[last.start]), float(values[~np.isnan(values)][-1])
    path = values if end > start else -values
    is_loading = last.direction is Direction.LOADING
    turn_positions = [] if is_loading else [float(path[branches[0].start])]
    turn_positions += [
        float(np.nanmax(path[branch.start : branch.stop + 1]))
        for branch in branches[:-1]
        if branch.direction is last.direction
    ]
    # the force is steep near the peak, and small at the end of unloading
    shortfall = limits.loading_shortfall if is_loading else limits.unloading_shortfall
    step = abs(end - start) / max(1, last.stop - last.start)
    noise = estimate_noise_level(values)
    tolerance = max(shortfall * _measure_travel(values), step, 5.0 * noise)
    return bool(turn_positions) and (end if end > start else -end) >= turn_positions[-1] - tolerance


def find_holds(prepared: Prepared, motion: Motion, protocol: Protocol) -> Iterator[Finding]:
    """Report holds of the motion at its turns, and at its end away from the start.

    Rests before the first branch and at the first position are not holds.
    """
    min_rows, return_share, still_share = 5.0, 0.1, 0.01  # without times; of the stroke
    travel, branches = motion.signal, motion.branches
    if not branches:
        return
    unit, lower_limit = ("s", protocol.limits.hold_time) if travel.has_time else ("rows", min_rows)
    is_finite = ~np.isnan(travel.values)
    time, values = travel.time[is_finite], travel.values[is_finite]
    ends = [(before.stop_time, after.start_time) for before, after in pairwise(branches)]
    last, stroke = values[time >= branches[-1].stop_time], np.ptp(values)
    is_away = abs(values[-1] - travel.values[branches[0].start]) > return_share * stroke
    if is_away and len(last) and np.ptp(last) <= still_share * stroke:
        ends.append((branches[-1].stop_time, float(time[-1])))
    holds = [(start, stop) for start, stop in ends if stop - start >= lower_limit]
    if holds:
        yield Finding.of(
            "process.hold",
            prepared.signals.displacement,
            count=len(holds),
            longest=max(stop - start for start, stop in holds),
            unit=unit,
            place=1e3 * float(np.interp(sum(holds[0]) / 2.0, time, values)),
            start=holds[0][0],
        )


def list_certified_instruments(protocol: Protocol) -> tuple[Instrument, ...]:
    """List the instruments whose certificates a protocol states, with the quantities they measure.

    Parameters
    ----------
    protocol : protocol, whose channels may have certificates
    """
    curve, cameras = protocol.curve, protocol.sources.get("markers")
    names = {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    certified: list[tuple[str, Certificate | None, tuple[str, ...]]] = [
        (name, channel.certificate, (names.get(name, name),))
        for name, channel in protocol.channels.items()
    ]
    if cameras is not None:
        steps = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
        is_only = curve is None or curve.displacement not in {*protocol.channels, *steps}
        camera_quantities = ("mid_span", "displacement") if is_only else ("mid_span",)
        certified.append(("markers", cameras.certificate, camera_quantities))
    return tuple(
        Instrument(
            channel=name,
            measures=quantities,
            certificate=certificate.number,
            calibrated=certificate.date,
            due=certificate.due,
            uncertainty=certificate.uncertainty,
            k=certificate.k,
        )
        for name, certificate, quantities in certified
        if certificate is not None
    )


def check_answers(protocol: Protocol, observed: Mapping[str, str]) -> Iterator[Finding]:
    """Note the questions of the protocol that the test sheet does not answer.

    Parameters
    ----------
    protocol : protocol with its questions
    observed : answers of the test sheet, by question
    """
    for name, answers in protocol.questions.items():
        if name not in observed:
            yield Finding.of(
                "process.question_open", name, "observation", name=name, answers=", ".join(answers)
            )


def check_calibration_due(protocol: Protocol, tested: date | None) -> Iterator[Finding]:
    """Doubt quantities of instruments whose calibration was overdue.

    Parameters
    ----------
    protocol : protocol, whose channels may have certificates
    tested : day of the test; None if it is not known; then nothing is doubted
    """
    for instrument in list_certified_instruments(protocol):
        if instrument.due is not None and tested is not None and tested > instrument.due:
            where, doubtful = instrument.channel, instrument.measures
            yield Finding.of(
                "process.calibration_overdue",
                where,
                *doubtful,
                instrument=instrument,
                tested=tested,
            )
