"""Check a test against its protocol, and whether its record is complete."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from itertools import pairwise

import numpy as np

from labpipe.errors import in_test_sheet
from labpipe.process.calibrated_signals import Prepared
from labpipe.process.motion import Motion
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Certificate
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Branch, Direction, Shape
from labpipe.records.declarations import LIMITS, Limits, TravelFromSpeed
from labpipe.records.estimates import Failure
from labpipe.records.quality import (
    Finding,
    Findings,
    doubtful,
    info_note,
    not_available,
    warning,
)
from labpipe.records.result import Instrument
from labpipe.records.signals import Signal, Signals
from labpipe.results.beam import held_at_rest
from labpipe.signal.filters import moving_average, seconds_to_window
from labpipe.signal.rests_and_jumps import moves_at_end, standing_stretches
from labpipe.signal.turning_points import noise_level
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
    force = signals.filtered.get(signals.force)
    if force is None or protocol.curve is None:
        return
    if protocol.rig.string is not None:  # the force can fall by the weight on the string only
        weight = protocol.rig.string.counterweight * GRAVITY
        self_weight = GRAVITY * (protocol.specimen.mass_per_length or 0.0)
        weight += held_at_rest(self_weight, protocol.specimen.length or 0.0)
        yield from _check_negative(_per_second(force), -1.2 * weight - 2e-3, "a string cannot push")
    if protocol.specimen.span is not None and force.has_time and not is_blocked:
        reason = "a load that presses on a specimen cannot pull it"
        means = _per_second(force)
        yield from _check_negative(
            means, -protocol.limits.pulling_force * float(np.nanmax(means)), reason
        )
    length, block = protocol.specimen.length, protocol.markers
    if length is not None and block is not None and block.clamp is not None and shape is not None:
        yield from _check_length(shape, length)


def _check_motion(
    motion: Signal, protocol: Protocol, branches: tuple[Branch, ...]
) -> Iterator[Finding]:
    rig = protocol.rig
    cycles = len({branch.cycle for branch in branches})
    if rig.cycles is not None and cycles != rig.cycles:
        message = f"{cycles} cycles measured, the protocol expects {rig.cycles}"
        yield warning("cycles_unexpected", "rig.cycles", message)
    if rig.stroke is not None and not is_full_stroke(motion, rig.stroke):
        stroke = 1e3 * float(np.nanmax(motion.values) - np.nanmin(motion.values))
        message = f"a stroke of {stroke:.4g} mm measured, {1e3 * rig.stroke:.4g} mm expected"
        yield warning("stroke_unexpected", "rig.stroke", message)
    if rig.crosshead_speed is not None and motion.has_time:
        yield from _check_speed(
            motion, rig.crosshead_speed, branches[0], protocol.limits.speed_deviation
        )


def is_full_stroke(motion: Signal, expected: float | None) -> bool:
    """Check whether the motion has the stroke of the rig; False if that is unknown.

    Parameters
    ----------
    motion : the channel that splits the branches
    expected : m
    """
    stroke = float(np.nanmax(motion.values) - np.nanmin(motion.values))
    return expected is not None and abs(stroke - expected) <= 0.02 * expected


def _check_speed(
    motion: Signal, expected: float, first: Branch, deviation: float
) -> Iterator[Finding]:
    """Report a speed that differs from that of the rig: a wrong unit, column or test."""
    part = slice(first.start, first.stop)
    moved = np.nanmax(motion.values[part]) - np.nanmin(motion.values[part])
    speed = float(moved) / max(first.stop_time - first.start_time, 1e-9)
    if abs(speed - expected) > deviation * expected:
        message = (
            f"{1e3 * speed:.4g} mm/s measured over the first branch, {1e3 * expected:.4g} mm/s "
            "expected: look at rig.crosshead_speed, and at unit and name of the displacement"
        )
        yield doubtful("speed_unexpected", "rig.crosshead_speed", message, "displacement", "force")


def _check_negative(smooth: Floats, least: float, why: str) -> Iterator[Finding]:
    """Report a force whose means over a second fall below the minimum of its load."""
    lowest = float(np.nanmin(smooth))
    if lowest < least - 5.0 * noise_level(smooth):
        message = f"the force falls to {lowest:.4g} N, but {why}: the zero is wrong or drifts"
        yield doubtful("force_negative", "force", message, "force")


def _per_second(force: Signal) -> Floats:
    """Return moving means over a second, every tenth of a second."""
    size = max(1, seconds_to_window(0.1, force.time))
    blocks = force.values[: len(force.values) // size * size].reshape(-1, size).mean(axis=1)
    window = max(1, seconds_to_window(1.0, force.time[::size]))
    return moving_average(blocks, window=min(window, len(blocks) - 1 + len(blocks) % 2))


def _check_length(shape: Shape, expected: float) -> Iterator[Finding]:
    """Compare the arc length from clamped end to pull point with the free length."""
    if abs(shape.length - expected) > max(2e-3, 0.02 * expected):
        message = (
            f"{1e3 * shape.length:.4g} mm from clamped end to pull point, the sheet says "
            f"{1e3 * expected:.4g} mm: look at specimen.length, grip_offset, pull_offset and at "
            "the outermost marker"
        )
        yield doubtful("length_unexpected", "specimen.length", message, "displacement")


def check_rest(signals: Signals, motion: Motion, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Report a zero whose stretch overlaps the motion.

    Parameters
    ----------
    signals : with the stretches of their zeros
    motion : with clocks that are joined
    limits : of the lab
    """
    branches, clocks = motion.branches, motion.clocks
    if not branches:
        return
    begins, ends = branches[0].start_time, branches[-1].stop_time
    for name, stretch in signals.zeroed.items():
        start, stop = (clocks.to_curve(end, signals.raw[name].clock) for end in stretch)
        if stop > begins + limits.zero_overlap and start < ends - limits.zero_overlap:
            message = (
                f"zeroed from {start:.2f} s to {stop:.2f} s of the motion's clock, but the clamp "
                f"moves from {begins:.2f} s to {ends:.2f} s"
            )
            quantity = "force" if name == signals.force else "displacement"
            yield doubtful("zero_not_at_rest", name, message, quantity)


def check_mid_span(
    prepared: Prepared, motion: Motion, limits: Limits = LIMITS
) -> tuple[Prepared, list[Finding]]:
    """Discard cameras that began under load; doubt a displacement that differs from theirs.

    Parameters
    ----------
    prepared : its ``mid_span`` is used if there is one
    motion : the displacement, with clocks that are joined
    limits : of the lab. Round rollers alone cause up to a tenth: the specimen rolls up on them, and
        is below them at the nominal supports.
    """
    mid_span, span = prepared.signals.raw.get("mid_span"), prepared.span
    if mid_span is None or span is None or isinstance(span, Failure) or not motion.branches:
        return prepared, []
    fit, rest_times = motion.clocks.others.get(mid_span.clock), span.time[span.rest]
    begins = motion.branches[0].start_time
    delay = (rest_times if fit is None else fit.to_marker_time(rest_times))[-1] - begins
    if delay > limits.zero_overlap:
        message = (
            f"the shape at rest was taken up to {delay:.2f} s after loading began: check the start "
            "of the cameras, and 'over' of the step three-point-shape"
        )
        without_span = replace(prepared, span=Failure("no_rest", message))
        return without_span, [not_available("no_rest", "markers", message)]
    seen_travel, measured_travel = (
        float(np.nanmax(value) - np.nanmin(value))
        for value in (mid_span.values, motion.signal.values)
    )
    if abs(seen_travel - measured_travel) <= limits.mid_span_deviation * measured_travel:
        return prepared, []
    message = (
        f"cameras see mid-span sink by {1e3 * seen_travel:.4g} mm, the displacement is "
        f"{1e3 * measured_travel:.4g} mm: check specimen.span, markers that are not on the "
        "specimen, the units of both exports, rig.crosshead_speed and rig.stroke if no frame "
        "measured it, and the distance of the load from the specimen"
    )
    return prepared, [doubtful("mid_span_differs", "mid_span", message, "displacement")]


def check_signs(signals: Signals, motion: Motion, protocol: Protocol) -> list[Finding]:
    """Report signals that fall while the specimen is loaded, unless the protocol allows it.

    Parameters
    ----------
    signals : of the test
    motion : with clocks that are joined
    protocol : its ``curve.reverse`` lists reversed signals; an empty list allows the signs

    Notes
    -----
    The specimen is loaded in the branch with the largest growth of the absolute force, if it has
    the direction of the first one. If both signals fall, as in compression, numbers without a sign
    (energy, stiffness) are not affected. A force that has both signs, with more than a fifth of the
    largest in each, has no wrong sign, nor has its motion.
    """
    curve, branches, clocks = protocol.curve, motion.branches, motion.clocks
    if curve is None or not branches:
        return []
    displacement = signals.raw[signals.displacement]
    time = displacement.time
    force = clocks.sampled(signals.raw[signals.force], time)
    loading = _loading_flags(time, force, branches)
    lowest = _largest(force)
    if loading is None or lowest is None:
        return []
    wrong = {"force": lowest} if lowest < 0.0 else {}
    first = displacement.values[(time >= branches[0].start_time) & (time <= branches[0].stop_time)]
    if signals.displacement in protocol.channels and _is_falling(
        displacement.values[loading], first
    ):
        wrong["displacement"] = float(np.nanmin(displacement.values))
    if curve.reverse is not None:
        wrong = {name: value for name, value in wrong.items() if name in curve.reverse}
    joined = clocks.force is not None
    return list(_sign_doubts(signals, wrong, curve.reverse or (), joined=joined)) if wrong else []


def _loading_flags(time: Floats, force: Floats, branches: tuple[Branch, ...]) -> Flags | None:
    """Flag samples of the branch in which the absolute force grows most; None if it never does."""
    largest, loading = 0.0, None
    for branch in branches:
        inside = (time >= branch.start_time) & (time <= branch.stop_time)
        sizes = np.abs(_means(force[inside]))
        grown = float(sizes.max() - sizes[0]) if len(sizes) else 0.0
        if grown > largest:
            largest, loading = grown, inside
    return loading


def _largest(force: Floats) -> float | None:
    """Return the force of largest absolute value, N; None if it has both signs, or is noise."""
    # Share of the largest force above which the force goes both ways.
    max_opposite_share = 0.2
    # Standard errors of a block mean.
    error_factor = 10.0
    means = _means(force)
    if len(means) < 2:
        return None
    noise = noise_level(force) / np.sqrt(max(1.0, len(force) / len(means)))
    top = float(means[int(np.argmax(np.abs(means)))])
    other = float((-np.sign(top) * means).max())
    if (
        float(np.ptp(means)) <= error_factor * noise
        or other > max_opposite_share * abs(top) + error_factor * noise
    ):
        return None
    return top


def _means(values: Floats) -> Floats:
    """Return means of the finite values over blocks."""
    block_count = 200
    finite = values[~np.isnan(values)]
    if not len(finite):
        return finite
    blocks = np.array_split(finite, min(block_count, len(finite)))
    return np.array([block.mean() for block in blocks])


def _is_falling(*branches: Floats) -> bool:
    """Check whether a displacement falls in every one of some branches."""
    finite = [branch[~np.isnan(branch)] for branch in branches]
    return all(len(values) > 1 and bool(values[-1] < values[0]) for values in finite)


def _sign_doubts(
    signals: Signals, wrong: dict[str, float], reversed_names: tuple[str, ...], *, joined: bool
) -> Iterator[Finding]:
    units = {"force": ("N", 1.0), "displacement": ("mm", 1e3)}
    description = " and ".join(
        f"the {name} goes to {units[name][1] * value:.3g} {units[name][0]}"
        for name, value in wrong.items()
    )
    if set(reversed_names) & set(wrong):
        remedy = (
            f"'curve.reverse' turns {' and '.join(wrong)}, which have the right sign without it"
        )
    else:
        line = in_test_sheet("curve.reverse", f"[{', '.join(wrong)}]")
        remedy = f"write {line} to reverse it, or [] there if the sign is correct"
    message = f"{description} while the specimen is loaded: {remedy}"
    names = {"force": signals.force, "displacement": signals.displacement}
    for name in wrong:
        quantity = f"{name}_sign" if len(wrong) > 1 else name
        yield doubtful(f"{name}_reversed", names[name], message, quantity)
    if joined and "force" in wrong:  # clocks are joined at its peaks
        yield doubtful("force_reversed", signals.force, message, "clock")


_CUT_FILES = {"truncated", "rows_differ"}
"""Notes of readers of exports whose last rows may be missing."""
RETURN_SHARE = 0.1
"""Of the stroke, within which a motion has returned; of a hold, within which two are merged."""


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


def file_is_cut(findings: Findings) -> bool:
    """Check the notes of readers for exports whose last rows may be missing."""
    return any(finding.code in _CUT_FILES for finding in findings.entries)


def find_holds(where: str, motion: Motion, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Report holds of the motion in the middle of the test.

    Parameters
    ----------
    where : name of the displacement
    motion : rests before its first branch and at its first position are not holds
    limits : of the lab
    """
    # Without times, a hold is noted from this number of rows.
    min_hold_rows = 5.0
    moved = motion.signal
    unit, least = ("s", limits.hold_time) if moved.has_time else ("rows", min_hold_rows)
    stretches = _holds(moved, motion.branches) if motion.branches else []
    long_holds = [hold for hold in stretches if hold[1] - hold[0] >= least]
    if not long_holds:
        return
    durations = sorted({f"{stop - start:.4g}" for start, stop in long_holds}, key=float)
    how_long = durations[0] if len(durations) == 1 else f"{durations[0]} to {durations[-1]}"
    frequency = "once" if len(long_holds) == 1 else f"{len(long_holds)} times"
    place = float(np.interp(sum(long_holds[0]) / 2.0, moved.time, moved.values))
    message = (
        f"the motion stands {frequency} in the middle of the test, for {how_long} {unit}; first at "
        f"{1e3 * place:.4g} mm, from {long_holds[0][0]:.4g} {unit} on"
    )
    yield info_note("hold", where, message)


def _holds(motion: Signal, branches: tuple[Branch, ...]) -> list[tuple[float, float]]:
    """Return begin and end, s, of holds between, in and after the branches."""
    # Parts of a branch over which the motion is averaged.
    part_count = 40
    # Share of the stroke within which the motion has not left the start, or is back.
    home_share = 0.02
    stretches = [(before.stop_time, after.start_time) for before, after in pairwise(branches)]
    size = max(1, int(np.median([branch.stop - branch.start for branch in branches])) // part_count)
    speed = float(np.median([_branch_speed(motion, branch) for branch in branches]))
    stroke, began = np.ptp(motion.values[~np.isnan(motion.values)]), branches[0].start
    ended = motion.values[~np.isnan(motion.values)][-1]
    is_back = abs(float(ended - motion.values[began])) <= RETURN_SHARE * stroke
    for branch in branches:
        goes_on = branch is branches[-1] and not is_back
        part = slice(branch.start, None if goes_on else branch.stop)
        is_outer = branch in (branches[0], branches[-1])
        is_finite = ~np.isnan(motion.values[part])
        time, values = motion.time[part][is_finite], motion.values[part][is_finite]
        for start, stop in standing_stretches(time, values, size=size, speed=speed):
            distance = abs(float(np.median(values[start:stop]) - motion.values[began]))
            if (
                not is_outer or distance > home_share * stroke
            ):  # not a rest before or after the test
                stretches.append((float(time[start]), float(time[stop - 1])))
    return _merge_stretches(stretches)


def _branch_speed(motion: Signal, branch: Branch) -> float:
    """Return the median speed of the faster half of a branch, m/s."""
    values = motion.values[branch.start : branch.stop : max(1, (branch.stop - branch.start) // 10)]
    duration = (branch.stop_time - branch.start_time) / max(1, len(values) - 1)
    steps = np.abs(np.diff(values))
    steps = np.sort(steps[~np.isnan(steps)])
    return float(np.median(steps[len(steps) // 2 :])) / duration if len(steps) and duration else 0.0


def _merge_stretches(stretches: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Sort stretches and merge those that nearly touch."""
    merged: list[tuple[float, float]] = []
    for start, stop in sorted(stretches):
        if merged and start - merged[-1][1] <= RETURN_SHARE * (stop - start):
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return merged


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
    near = max(shortfall * stroke, step, 5.0 * noise_level(motion.values))
    return sense * end >= turns[-1] - near


def instruments_of(protocol: Protocol) -> tuple[Instrument, ...]:
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


def check_due(protocol: Protocol, tested: date | None) -> Iterator[Finding]:
    """Doubt quantities of instruments whose calibration was overdue.

    Parameters
    ----------
    protocol : with certificates
    tested : day of the test; None if it is not known; then nothing is doubted
    """
    for where, certificate, quantities in _certificates(protocol):
        due = certificate.due
        if due is not None and tested is not None and tested > due:
            message = (
                f"calibration {certificate.number} of {certificate.date} expired on {due}, "
                f"before the test on {tested}: have the instrument calibrated"
            )
            yield doubtful("calibration_overdue", where, message, *quantities)


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
        yield "markers", cameras.certificate, tuple(_camera_quantities(protocol))


def _camera_quantities(protocol: Protocol) -> Iterator[str]:
    """Yield the quantities that cameras measure; the displacement only if nothing else does."""
    yield "mid_span"
    curve = protocol.curve
    step_channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    if curve is None or curve.displacement not in {*protocol.channels, *step_channels}:
        yield "displacement"
