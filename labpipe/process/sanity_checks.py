"""Check a test against its protocol: sizes, signs, zeros, start and end of its record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import date
from itertools import pairwise

import numpy as np

from labpipe.errors import format_overrides
from labpipe.messages import format_sentence
from labpipe.process.calibrated_signals import Prepared
from labpipe.process.motion import Motion
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Certificate
from labpipe.records.arrays import Flags, Floats, average_between
from labpipe.records.curve import Branch, Direction, Shape
from labpipe.records.declarations import LIMITS, Limits, TravelFromSpeed
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, Findings
from labpipe.records.result import Instrument
from labpipe.records.signals import Signal, Signals
from labpipe.results.beam import compute_prop_force
from labpipe.signal.filters import moving_average, seconds_to_window
from labpipe.signal.rests_and_jumps import moves_at_end
from labpipe.signal.turning_points import estimate_noise_level
from labpipe.units import GRAVITY


def check_rig(
    signals: Signals,
    shape: Shape | None,
    protocol: Protocol,
    branches: tuple[Branch, ...],
    *,
    is_blocked: bool,
) -> Iterator[Finding]:
    """Compare rig and specimen of the protocol with the measurement.

    Parameters
    ----------
    signals, shape : of the test
    protocol : resolved; with cycles, stroke, length and mass of the specimen, counterweight
    branches : of the motion
    is_blocked : whether there is no curve
    """
    if branches and protocol.branches is not None:
        yield from _check_motion(signals.raw[protocol.branches.channel], protocol, branches)
    force, specimen, block = (
        signals.filtered.get(signals.force),
        protocol.specimen,
        protocol.markers,
    )
    if force is None or protocol.curve is None:
        return
    if protocol.rig.string is not None:  # the force can fall by the weight on the string only
        weight = protocol.rig.string.counterweight * GRAVITY
        weight += compute_prop_force(
            GRAVITY * (specimen.mass_per_length or 0.0), specimen.length or 0.0
        )
        yield from _check_negative(
            _average_per_second(force), -1.2 * weight - 2e-3, "a string cannot push"
        )
    if specimen.span is not None and force.has_time and not is_blocked:
        means, reason = (
            _average_per_second(force),
            "a load that presses on a specimen cannot pull it",
        )
        lower_limit = -protocol.limits.pulling_force * float(np.nanmax(means))
        yield from _check_negative(means, lower_limit, reason)
    if specimen.length is None or block is None or block.clamp is None or shape is None:
        return
    measured_length, stated_length = shape.length, specimen.length
    if abs(measured_length - stated_length) > max(2e-3, 0.02 * stated_length):
        yield Finding.of(
            "process.length_unexpected",
            "specimen.length",
            "displacement",
            seen=1e3 * measured_length,
            stated=1e3 * stated_length,
        )


def _check_motion(
    motion: Signal, protocol: Protocol, branches: tuple[Branch, ...]
) -> Iterator[Finding]:
    rig, first = protocol.rig, branches[0]
    cycles, speed = len({branch.cycle for branch in branches}), rig.crosshead_speed
    if rig.cycles is not None and cycles != rig.cycles:
        yield Finding.of(
            "process.cycles_unexpected", "rig.cycles", measured=cycles, expected=rig.cycles
        )
    if rig.stroke is not None and not is_full_stroke(motion, rig.stroke):
        measured, expected = 1e3 * _measure_travel(motion.values), 1e3 * rig.stroke
        yield Finding.of(
            "process.stroke_unexpected", "rig.stroke", measured=measured, expected=expected
        )
    if speed is not None and motion.has_time:
        moved = _measure_travel(motion.values[first.start : first.stop])
        measured = moved / max(first.stop_time - first.start_time, 1e-9)
        if abs(measured - speed) > protocol.limits.speed_deviation * speed:
            yield Finding.of(
                "process.speed_unexpected",
                "rig.crosshead_speed",
                "displacement",
                "force",
                measured=1e3 * measured,
                expected=1e3 * speed,
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
    return (
        expected is not None and abs(_measure_travel(motion.values) - expected) <= 0.02 * expected
    )


def _check_negative(smooth: Floats, lower_limit: float, why: str) -> Iterator[Finding]:
    """Report a force whose means over a second fall below the minimum of its load."""
    lowest = float(np.nanmin(smooth))
    if lowest < lower_limit - 5.0 * estimate_noise_level(smooth):
        yield Finding.of("process.force_negative", "force", "force", lowest=lowest, why=why)


def _average_per_second(force: Signal) -> Floats:
    """Return moving averages over a second, every tenth of a second."""
    size = max(1, seconds_to_window(0.1, force.time))
    blocks = force.values[: len(force.values) // size * size].reshape(-1, size).mean(axis=1)
    window = max(1, seconds_to_window(1.0, force.time[::size]))
    return moving_average(blocks, window=min(window, len(blocks) - 1 + len(blocks) % 2))


def check_rest(signals: Signals, motion: Motion, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Report a zero whose stretch overlaps the motion.

    Parameters
    ----------
    signals : with the stretches of their zeros
    motion : with clocks that are joined
    limits : of the lab
    """
    if not motion.branches:
        return
    begins, ends = motion.branches[0].start_time, motion.branches[-1].stop_time
    for name, stretch in signals.zero_stretches.items():
        start, stop = (motion.clocks.to_curve(end, signals.raw[name].clock) for end in stretch)
        if stop > begins + limits.zero_overlap and start < ends - limits.zero_overlap:
            yield Finding.of(
                "process.zero_not_at_rest",
                name,
                "force" if name == signals.force else "displacement",
                start=start,
                stop=stop,
                begins=begins,
                ends=ends,
            )


def check_mid_span(
    prepared: Prepared, motion: Motion, limits: Limits = LIMITS
) -> tuple[Prepared, list[Finding]]:
    """Reject cameras that began under load, and report a displacement that differs from theirs.

    Parameters
    ----------
    prepared : its ``mid_span`` is used if there is one
    motion : the displacement, with clocks that are joined
    limits : of the lab. Round rollers alone cause a difference of up to a tenth, because the
        specimen rolls on them and is below the nominal supports.
    """
    mid_span, span = prepared.signals.raw.get("mid_span"), prepared.span
    if mid_span is None or span is None or isinstance(span, Failure) or not motion.branches:
        return prepared, []
    fit, rest_times = motion.clocks.others.get(mid_span.clock), span.time[span.rest]
    begins = motion.branches[0].start_time
    delay = (rest_times if fit is None else fit.to_marker_time(rest_times))[-1] - begins
    if delay > limits.zero_overlap:
        note = Finding.of("process.no_rest", "markers", delay=delay)
        return replace(prepared, span=Failure("no_rest", note.note.message)), [note]
    camera_travel, motion_travel = (
        _measure_travel(mid_span.values),
        _measure_travel(motion.signal.values),
    )
    if abs(camera_travel - motion_travel) <= limits.mid_span_deviation * motion_travel:
        return prepared, []
    facts = Finding.of(
        "process.mid_span_differs",
        "mid_span",
        "displacement",
        seen=1e3 * camera_travel,
        measured=1e3 * motion_travel,
    )
    return prepared, [facts]


def check_signs(signals: Signals, motion: Motion, protocol: Protocol) -> list[Finding]:
    """Report signals that fall while the specimen is loaded, unless the protocol allows it.

    Parameters
    ----------
    signals : of the test
    motion : with clocks that are joined
    protocol : its ``curve.reverse`` lists reversed signals; an empty list allows the signs

    Notes
    -----
    Loading is the branch in which the absolute force grows most. The displacement is reversed only
    if it falls in that branch and in the first one. If both signals fall, as in compression,
    numbers without a sign (energy, stiffness) are not affected. A force with both signs, each with
    more than a fifth of the largest force, has no wrong sign, and neither has its displacement.
    """
    max_opposite_share, error_factor = 0.2, 10.0  # of the largest force; of a block mean
    curve, displacement = protocol.curve, signals.raw[signals.displacement]
    if curve is None or not motion.branches:
        return []
    time = displacement.time
    force = motion.clocks.interpolate(signals.raw[signals.force], time)
    parts = [(time >= x.start_time) & (time <= x.stop_time) for x in motion.branches]
    sizes = [np.abs(_average_blocks(force[part])) for part in parts]
    growths = [float(np.max(size - size[:1], initial=0.0)) for size in sizes]
    means = _average_blocks(force)
    if len(means) < 2 or not max(growths) > 0.0:
        return []
    noise = error_factor * estimate_noise_level(force) / np.sqrt(max(1.0, len(force) / len(means)))
    top = float(means[int(np.argmax(np.abs(means)))])
    opposite = float((-np.sign(top) * means).max())
    if np.ptp(means) <= noise or opposite > max_opposite_share * abs(top) + noise:
        return []
    reversed_texts = {"force": f"the force goes to {top:.3g} N"} if top < 0.0 else {}
    loading, first = parts[int(np.argmax(growths))], parts[0]
    if signals.displacement in protocol.channels and all(
        _is_falling(displacement.values[part]) for part in (loading, first)
    ):
        lowest = 1e3 * float(np.nanmin(displacement.values))
        reversed_texts["displacement"] = f"the displacement goes to {lowest:.3g} mm"
    if curve.reverse is not None:
        reversed_texts = {
            name: text for name, text in reversed_texts.items() if name in curve.reverse
        }
    is_reversed, names = bool(curve.reverse), ", ".join(reversed_texts)
    remedy = format_sentence(
        "process.signs_reversed" if is_reversed else "process.signs_to_reverse",
        names=names if is_reversed else format_overrides("curve.reverse", f"[{names}]"),
    )
    clock = ("clock",) if motion.clocks.force is not None else ()  # joined at peaks of the force
    return [
        Finding.of(
            "process.force_reversed" if name == "force" else "process.displacement_reversed",
            getattr(signals, name),
            f"{name}_sign" if len(reversed_texts) > 1 else name,
            *(clock if name == "force" else ()),
            signs=" and ".join(reversed_texts.values()),
            remedy=remedy,
        )
        for name in reversed_texts
    ]


def _average_blocks(values: Floats) -> Floats:
    """Return means of the finite values over at most 200 blocks."""
    finite = values[~np.isnan(values)]
    starts = np.linspace(0, len(finite), min(200, len(finite)), endpoint=False).astype(np.int64)
    return average_between(finite, starts) if len(finite) else finite


def _is_falling(values: Floats) -> bool:
    finite = values[~np.isnan(values)]
    return len(finite) > 1 and bool(finite[-1] < finite[0])


def check_start(signals: Signals, motion: Motion, *, has_slack: bool) -> Iterator[Finding]:
    """Report a record that begins under load, and doubt the results that depend on its start.

    Parameters
    ----------
    signals : of the test, with the levels that zeros subtracted
    motion : with clocks that are joined
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
    branch_data = _read_first_branch(signals, motion) if motion.branches else None
    if branch_data is None:
        return
    time, force, path, inside = branch_data
    load, share = float(force[inside][0]), float(force[inside][0] / np.ptp(force))
    if share > 0.5 and force[inside][-1] < 0.5 * load:
        yield Finding.of(
            "process.begins_with_unloading",
            signals.force,
            "force",
            "displacement",
            "start",
            load=load,
        )
        return
    ends = np.interp([branch.stop_time for branch in motion.branches[1::2]], time, force)
    returns = len(ends) > 0 and (np.abs(ends - load) <= 0.5 * load).all()
    if returns or not _is_loaded(force[inside], path[inside], float(np.ptp(path)), share):
        return
    # The slack correction restores the zero of displacement if the zero of the force is correct.
    zeroed_in_motion = [
        name for name in signals.quantities if name in signals.moving_zero_stretches
    ]
    restored = () if signals.force in zeroed_in_motion or not has_slack else (signals.displacement,)
    doubtful = [signals.quantities[name] for name in zeroed_in_motion if name not in restored]
    first = float(time[0]), max(float(time[0]), motion.branches[0].start_time)
    for quantities, during in ((["start"], first), (doubtful, None)):
        if quantities:
            yield Finding.of(
                "process.begins_under_load",
                signals.force,
                *quantities,
                during=during,
                load=load,
                share=share,
                place=1e3 * float(path[0]),
                zeroed=f"; {' and '.join(zeroed_in_motion)} zeroed there"
                if zeroed_in_motion
                else "",
            )


def _read_first_branch(
    signals: Signals, motion: Motion
) -> tuple[Floats, Floats, Floats, Flags] | None:
    """Return time, force and path as exported, positive in loading, and flags of the first branch.

    None if force or path is constant, or if the record begins at rest or within the noise of the
    force.
    """
    noise_factor, min_samples = 5.0, 4
    time = signals.raw[signals.displacement].time
    force, path = (
        motion.clocks.interpolate(signals.raw[name], time)
        + signals.subtracted_levels.get(name, 0.0)
        for name in (signals.force, signals.displacement)
    )
    is_finite = np.isfinite(force) & np.isfinite(path)
    time, force, path = time[is_finite], force[is_finite], path[is_finite]
    start, stop = motion.branches[0].start_time, motion.branches[0].stop_time
    inside = (time >= start) & (time <= stop)
    if inside.sum() < min_samples or not np.ptp(force) > 0.0 or not np.ptp(path) > 0.0:
        return None
    force = force * np.sign(force[int(np.argmax(np.abs(force)))])
    path = path * (np.sign(path[inside][-1] - path[inside][0]) or 1.0)
    begins_at_rest = start - time[0] > 3.0 * (time[-1] - time[0]) / len(time)
    is_zero = not force[inside][0] > noise_factor * estimate_noise_level(force)
    return None if begins_at_rest or is_zero else (time, force, path, inside)


def _is_loaded(force: Floats, path: Floats, path_range: float, share: float) -> bool:
    """Check whether the first force of a branch is a load, not an offset of the load cell."""
    min_load_share, min_path_share, sure_share = 0.02, 0.01, 0.1  # of the ranges
    line_factor, near_share, min_samples = 3.0, 0.05, 4
    size = max(min_samples, int(np.sum(np.abs(path - path[0]) <= near_share * path_range)))
    steps = path[:size] - path[:size].mean()
    on_line = float(steps @ force[:size]) / max(float(steps @ steps), 1e-300) * path[0]
    is_on_line = force[0] / line_factor <= on_line <= line_factor * force[0]
    has_moved = path[0] >= min_path_share * path_range
    return share >= sure_share or bool(share >= min_load_share and has_moved and is_on_line)


_CUT_FILE_CODES = {"truncated", "rows_differ"}
"""Codes of readers' notes on exports whose last rows may be missing."""


def find_cut_ends(
    signals: Signals,
    motion: Motion,
    *,
    is_full_stroke: bool,
    is_cut_file: bool,
    limits: Limits = LIMITS,
) -> dict[str, float]:
    """Find the ends of a record that stops in the middle of a branch.

    Parameters
    ----------
    signals : of the test
    motion : with clocks that are joined
    is_full_stroke : whether the motion has the stroke of the rig
    is_cut_file : whether the end of an export may be missing
    limits : of the lab

    Returns
    -------
    End by quantity, s on the clock of the curve; empty for a complete record.
    """
    moved, branches = motion.signal, motion.branches
    if not branches:
        return {}
    last, ends = branches[-1], dict[str, float]()
    if _is_unfinished(
        moved, branches, limits, is_full_stroke=is_full_stroke, is_cut_file=is_cut_file
    ):
        end = float(moved.time[~np.isnan(moved.values)][-1])
        ends = {"force": end, "displacement": end}
    force = signals.raw[signals.force]
    finite_times = force.time[~np.isnan(force.values)]
    force_end = motion.clocks.to_curve(float(finite_times[-1]), force.clock)
    time_step = float(moved.time[-1] - moved.time[0]) / max(1, len(moved.time) - 1)
    missing = max(limits.force_shortfall * (last.stop_time - last.start_time), 2.0 * time_step)
    return ends | {"force": force_end} if force_end < last.stop_time - missing else ends


def is_file_cut(findings: Findings) -> bool:
    """Check the notes of readers for exports whose last rows may be missing."""
    return any(finding.code in _CUT_FILE_CODES for finding in findings.entries)


def find_holds(where: str, motion: Motion, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Report holds of the motion at its turns, and at its end away from the start.

    Parameters
    ----------
    where : name of the displacement
    motion : rests before its first branch and at its first position are not holds
    limits : of the lab
    """
    min_rows, return_share, still_share = 5.0, 0.1, 0.01  # without times; of the stroke
    moved, branches = motion.signal, motion.branches
    if not branches:
        return
    unit, lower_limit = ("s", limits.hold_time) if moved.has_time else ("rows", min_rows)
    is_finite = ~np.isnan(moved.values)
    time, values = moved.time[is_finite], moved.values[is_finite]
    ends = [(before.stop_time, after.start_time) for before, after in pairwise(branches)]
    last, stroke = values[time >= branches[-1].stop_time], np.ptp(values)
    is_away = abs(values[-1] - moved.values[branches[0].start]) > return_share * stroke
    if is_away and len(last) and np.ptp(last) <= still_share * stroke:
        ends.append((branches[-1].stop_time, float(time[-1])))
    holds = [(start, stop) for start, stop in ends if stop - start >= lower_limit]
    if holds:
        yield Finding.of(
            "process.hold",
            where,
            count=len(holds),
            longest=max(stop - start for start, stop in holds),
            unit=unit,
            place=1e3 * float(np.interp(sum(holds[0]) / 2.0, time, values)),
            start=holds[0][0],
        )


def _is_unfinished(
    motion: Signal,
    branches: tuple[Branch, ...],
    limits: Limits,
    *,
    is_full_stroke: bool,
    is_cut_file: bool,
) -> bool:
    """Check whether the motion continues at the last sample, before its target."""
    last = branches[-1]
    is_finite = ~np.isnan(motion.values[last.start :])
    time, values = motion.time[last.start :][is_finite], motion.values[last.start :][is_finite]
    if not moves_at_end(time, values):
        return False
    if is_cut_file:
        return True
    if len(branches) == 1:
        return not is_full_stroke
    return not _has_arrived(motion, branches, float(values[-1]), limits)


def _has_arrived(motion: Signal, branches: tuple[Branch, ...], end: float, limits: Limits) -> bool:
    """Check whether the last branch reaches the end of the one before it."""
    last = branches[-1]
    sense = 1.0 if end > motion.values[last.start] else -1.0
    path = sense * motion.values
    turns = [
        float(np.nanmax(path[branch.start : branch.stop + 1]))
        for branch in branches[:-1]
        if branch.direction is last.direction
    ]
    if last.direction is Direction.UNLOADING:
        turns.insert(0, float(path[branches[0].start]))
    if not turns:
        return False
    step = abs(end - float(motion.values[last.start])) / max(1, last.stop - last.start)
    stroke = float(np.nanmax(path) - np.nanmin(path))
    # the force is steep near the peak, and small at the end of unloading
    is_loading = last.direction is Direction.LOADING
    shortfall = limits.loading_shortfall if is_loading else limits.unloading_shortfall
    tolerance = max(shortfall * stroke, step, 5.0 * estimate_noise_level(motion.values))
    return sense * end >= turns[-1] - tolerance


def list_certified_instruments(protocol: Protocol) -> tuple[Instrument, ...]:
    """List the instruments whose certificates a protocol states.

    Parameters
    ----------
    protocol : with or without certificates
    """
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
        for name, certificate, quantities in _certificates(protocol)
    )


def check_answers(protocol: Protocol, observed: Mapping[str, str]) -> Iterator[Finding]:
    """Note the questions of the protocol that the test sheet does not answer.

    Parameters
    ----------
    protocol : with its questions
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
    protocol : with certificates
    tested : day of the test; None if it is not known; then nothing is doubted
    """
    for where, certificate, quantities in _certificates(protocol):
        due = certificate.due
        if due is not None and tested is not None and tested > due:
            yield Finding.of(
                "process.calibration_overdue",
                where,
                *quantities,
                number=certificate.number,
                date=certificate.date,
                due=due,
                tested=tested,
            )


def _certificates(protocol: Protocol) -> Iterator[tuple[str, Certificate, tuple[str, ...]]]:
    """Yield each certificate with its channel or role and the quantities measured."""
    curve = protocol.curve
    quantity_of = (
        {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    )
    for name, channel in protocol.channels.items():
        if channel.certificate is not None:
            yield name, channel.certificate, (quantity_of.get(name, name),)
    cameras = protocol.sources.get("markers")
    if cameras is not None and cameras.certificate is not None:
        steps = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
        is_only = curve is None or curve.displacement not in {*protocol.channels, *steps}
        quantities = ("mid_span", "displacement") if is_only else ("mid_span",)
        yield "markers", cameras.certificate, quantities
