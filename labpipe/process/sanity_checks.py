"""Whether a test went as its protocol takes for granted, and its record holds all of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from labpipe.bending.bent_frames import held_at_rest
from labpipe.errors import in_test_sheet
from labpipe.process.calibrated_signals import Prepared
from labpipe.process.motion import Motion
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Branch, Direction, Shape
from labpipe.records.estimates import Failure
from labpipe.records.limits import LIMITS, Limits
from labpipe.records.quality import (
    Finding,
    Findings,
    doubtful,
    info_note,
    not_available,
    warning,
)
from labpipe.records.signals import Signal, Signals
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
    """Compare what the rig and the sheet say with what was measured.

    Parameters
    ----------
    signals, shape : of the test
    protocol : resolved; cycles, stroke, the specimen's length and mass, counterweight where it has
        them
    branches : of the motion
    is_blocked : whether there is no curve
    """
    if branches and protocol.branches is not None:
        yield from _motion(signals.raw[protocol.branches.channel], protocol, branches)
    force = signals.filtered.get(signals.force)
    if force is None or protocol.curve is None:
        return
    if protocol.rig.string is not None:  # by what the string holds the force can fall, no further
        weight = protocol.rig.string.counterweight * GRAVITY
        self_weight = GRAVITY * (protocol.specimen.mass_per_length or 0.0)
        weight += held_at_rest(self_weight, protocol.specimen.length or 0.0)
        yield from _negative(_per_second(force), -1.2 * weight - 2e-3, "a string cannot push")
    if protocol.specimen.span is not None and force.has_time and not is_blocked:
        why = "what presses on a specimen between supports cannot pull at it"
        smooth = _per_second(force)
        yield from _negative(smooth, -protocol.limits.pulling_force * float(np.nanmax(smooth)), why)
    length, words = protocol.specimen.length, protocol.markers
    if length is not None and words is not None and words.clamp is not None and shape is not None:
        yield from _length(shape, length)


def _motion(motion: Signal, protocol: Protocol, branches: tuple[Branch, ...]) -> Iterator[Finding]:
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
        yield from _speed(motion, rig.crosshead_speed, branches[0], protocol.limits.speed_deviation)


def is_full_stroke(motion: Signal, expected: float | None) -> bool:
    """Whether the motion went as far as the rig was set to; False where that is unknown.

    Parameters
    ----------
    motion : that the branches were split by
    expected : m
    """
    stroke = float(np.nanmax(motion.values) - np.nanmin(motion.values))
    return expected is not None and abs(stroke - expected) <= 0.02 * expected


def _speed(motion: Signal, expected: float, first: Branch, deviation: float) -> Iterator[Finding]:
    """Another speed than the rig was set to: another unit, another column, another test."""
    part = slice(first.start, first.stop)
    moved = np.nanmax(motion.values[part]) - np.nanmin(motion.values[part])
    speed = float(moved) / max(first.stop_time - first.start_time, 1e-9)
    if abs(speed - expected) > deviation * expected:
        message = (
            f"{1e3 * speed:.4g} mm/s measured over the first branch, {1e3 * expected:.4g} mm/s "
            "expected: look at rig.crosshead_speed, and at unit and name of the displacement"
        )
        yield doubtful("speed_unexpected", "rig.crosshead_speed", message, "displacement", "force")


def _negative(smooth: Floats, least: float, why: str) -> Iterator[Finding]:
    """Doubt a force whose means over a second fall below the least that its load can give."""
    lowest = float(np.nanmin(smooth))
    if lowest < least - 5.0 * noise_level(smooth):
        message = f"the force falls to {lowest:.4g} N, but {why}: the zero is wrong or drifts"
        yield doubtful("force_negative", "force", message, "force")


def _per_second(force: Signal) -> Floats:
    """Means over a second, moving by a tenth of it."""
    size = max(1, seconds_to_window(0.1, force.time))  # a tenth of a second says it as well
    blocks = force.values[: len(force.values) // size * size].reshape(-1, size).mean(axis=1)
    window = max(1, seconds_to_window(1.0, force.time[::size]))
    return moving_average(blocks, window=min(window, len(blocks) - 1 + len(blocks) % 2))


def _length(shape: Shape, expected: float) -> Iterator[Finding]:
    """The arc length from clamped end to pull point is the specimen's free length."""
    if abs(shape.length - expected) > max(2e-3, 0.02 * expected):
        message = (
            f"{1e3 * shape.length:.4g} mm from clamped end to pull point, the sheet says "
            f"{1e3 * expected:.4g} mm: look at specimen.length, grip_offset, pull_offset and at "
            "the outermost marker"
        )
        yield doubtful("length_unexpected", "specimen.length", message, "displacement")


def check_rest(signals: Signals, motion: Motion, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Doubt a zero that was taken while the clamp was already moving.

    Parameters
    ----------
    signals : with the stretches that they were zeroed over
    motion : with clocks that are joined
    limits : of the lab
    """
    branches, clocks = motion.branches, motion.clocks
    if not branches:
        return
    begins, ends = branches[0].start_time, branches[-1].stop_time
    for name, stretch in signals.zeroed.items():
        start, stop = (clocks.to_curve(at, signals.raw[name].clock) for at in stretch)
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
    """Give up cameras that began under load; doubt a displacement that is not what they see.

    Parameters
    ----------
    prepared : its ``mid_span`` is used, where there is one
    motion : the displacement, with clocks that are joined
    limits : of the lab. Round rollers alone make up to a tenth: the specimen rolls up on them, and
        lies below them at the nominal supports.
    """
    seen, span = prepared.signals.raw.get("mid_span"), prepared.span
    if seen is None or span is None or isinstance(span, Failure) or not motion.branches:
        return prepared, []
    fit, rested = motion.clocks.others.get(seen.clock), span.time[span.rest]
    begins = motion.branches[0].start_time
    late = (rested if fit is None else fit.to_marker_time(rested))[-1] - begins
    if late > limits.zero_overlap:
        message = (
            f"the shape at rest was taken up to {late:.2f} s after loading began: look at the "
            "cameras' start, and at 'over' of the step three-point-shape"
        )
        given_up = replace(prepared, span=Failure("no_rest", message))
        return given_up, [not_available("no_rest", "markers", message)]
    sunk, moved = (
        float(np.nanmax(value) - np.nanmin(value)) for value in (seen.values, motion.signal.values)
    )
    if abs(sunk - moved) <= limits.mid_span_deviation * moved:
        return prepared, []
    message = (
        f"cameras see mid-span sink by {1e3 * sunk:.4g} mm, the displacement is {1e3 * moved:.4g} "
        "mm: look at specimen.span, at markers that are not on the specimen, at the units of both "
        "exports, at rig.crosshead_speed and rig.stroke where no frame measured it, and at how far "
        "the load was from the specimen"
    )
    return prepared, [doubtful("mid_span_differs", "mid_span", message, "displacement")]


_BLOCKS = 200
"""Means that a force is looked at in, to tell a load from noise."""
_OTHER_SIDE = 0.2
"""Share of its largest size that a force has the other way round if it is one of both ways."""
_SURE = 10.0
"""Standard errors of a mean by which a force changes."""


def check_signs(signals: Signals, motion: Motion, protocol: Protocol) -> list[Finding]:
    """Doubt what goes down while the specimen is loaded, unless the protocol says that it may.

    Parameters
    ----------
    signals : of the test
    motion : with clocks that are joined
    protocol : its ``curve.reverse`` says what was turned; an empty list, that the signs are meant

    Notes
    -----
    The specimen is loaded in the branch in which the force grows most in size, if that goes the way
    of the first one. If both go down, as where compression is negative, numbers without a sign
    (energy, stiffness) are as good as ever.
    A force that goes both ways, up and down by a fifth, has no wrong sign, nor has its motion.
    """
    curve, branches, clocks = protocol.curve, motion.branches, motion.clocks
    if curve is None or not branches:
        return []
    displacement = signals.raw[signals.displacement]
    time = displacement.time
    force = clocks.sampled(signals.raw[signals.force], time)
    loading = _loading(time, force, branches)
    lowest = _largest(force)
    if loading is None or lowest is None:
        return []
    wrong = {"force": lowest} if lowest < 0.0 else {}
    first = displacement.values[(time >= branches[0].start_time) & (time <= branches[0].stop_time)]
    if signals.displacement in protocol.channels and _goes_down(
        displacement.values[loading], first
    ):
        wrong["displacement"] = float(np.nanmin(displacement.values))
    if curve.reverse is not None:
        wrong = {name: value for name, value in wrong.items() if name in curve.reverse}
    joined = clocks.force is not None
    return list(_reversed(signals, wrong, curve.reverse or (), joined=joined)) if wrong else []


def _loading(time: Floats, force: Floats, branches: tuple[Branch, ...]) -> Flags | None:
    """Samples of the branch in which the size of the force grows most; None where it never does."""
    most, found = 0.0, None
    for branch in branches:
        inside = (time >= branch.start_time) & (time <= branch.stop_time)
        sizes = np.abs(_means(force[inside]))
        grown = float(sizes.max() - sizes[0]) if len(sizes) else 0.0
        if grown > most:
            most, found = grown, inside
    return found


def _largest(force: Floats) -> float | None:
    """The force that is largest in size, N; None where it goes both ways, or is noise."""
    means = _means(force)
    if len(means) < 2:
        return None
    noise = noise_level(force) / np.sqrt(max(1.0, len(force) / len(means)))
    top = float(means[int(np.argmax(np.abs(means)))])
    other = float((-np.sign(top) * means).max())
    if float(np.ptp(means)) <= _SURE * noise or other > _OTHER_SIDE * abs(top) + _SURE * noise:
        return None
    return top


def _means(values: Floats) -> Floats:
    """Means over blocks of what is known."""
    known = values[~np.isnan(values)]
    if not len(known):
        return known
    blocks = np.array_split(known, min(_BLOCKS, len(known)))
    return np.array([block.mean() for block in blocks])


def _goes_down(*branches: Floats) -> bool:
    """Whether a displacement is lower at the end of each of some branches than at its begin."""
    known = [branch[~np.isnan(branch)] for branch in branches]
    return all(len(each) > 1 and bool(each[-1] < each[0]) for each in known)


def _reversed(
    signals: Signals, wrong: dict[str, float], turned: tuple[str, ...], *, joined: bool
) -> Iterator[Finding]:
    units = {"force": ("N", 1.0), "displacement": ("mm", 1e3)}
    goes = " and ".join(
        f"the {name} goes to {units[name][1] * value:.3g} {units[name][0]}"
        for name, value in wrong.items()
    )
    if set(turned) & set(wrong):
        remedy = f"'curve.reverse' turns {' and '.join(wrong)}, which counts the right way without"
    else:
        line = in_test_sheet("curve.reverse", f"[{', '.join(wrong)}]")
        remedy = f"write {line} to turn it, or [] there if the sign is meant"
    message = f"{goes} while the specimen is loaded: {remedy}"
    names = {"force": signals.force, "displacement": signals.displacement}
    for name in wrong:
        quantity = f"{name}_sign" if len(wrong) > 1 else name
        yield doubtful(f"{name}_reversed", names[name], message, quantity)
    if joined and "force" in wrong:  # clocks are joined at its peaks
        yield doubtful("force_reversed", signals.force, message, "clock")


_CUT_FILES = {"truncated", "rows_differ"}
"""Notes of readers after which rows may be missing at the end."""
_PARTS = 40
"""Parts of a branch that a motion is averaged over, to see where it stands."""
_BACK = 0.1
"""Share of the stroke within which a motion is back where it began; of a hold between two."""
_AT_HOME = 0.02
"""Share of the stroke within which a motion has not left yet, or has come home."""
_HOLD_ROWS = 5.0
"""Rows that a motion without times stands at least to be noted."""


def cut_at(
    signals: Signals,
    motion: Motion,
    *,
    is_full_stroke: bool,
    is_cut_file: bool,
    limits: Limits = LIMITS,
) -> dict[str, float]:
    """Find where the record ends in the middle of a branch.

    Parameters
    ----------
    signals : of the test
    motion : with clocks that are joined
    is_full_stroke : whether the motion went as far as the rig was set to
    is_cut_file : whether a reader saw that the end of an export may be missing
    limits : of the lab

    Returns
    -------
    By quantity, s on the clock of the curve; nothing where the record goes on to its end.
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
    known = force.time[~np.isnan(force.values)]
    until = motion.clocks.to_curve(float(known[-1]), force.clock)
    apart = float(moved.time[-1] - moved.time[0]) / max(1, len(moved.time) - 1)
    missing = max(limits.force_shortfall * (last.stop_time - last.start_time), 2.0 * apart)
    return ends | {"force": until} if until < last.stop_time - missing else ends


def file_is_cut(findings: Findings) -> bool:
    """Whether a reader saw that rows may be missing at the end of an export."""
    return any(finding.code in _CUT_FILES for finding in findings.found)


def holds(where: str, motion: Motion, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Say where the motion stands in the middle of the test, and for how long.

    Parameters
    ----------
    where : name of the displacement
    motion : the rests before its first branch and where it began are no part of it
    limits : of the lab
    """
    moved = motion.signal
    unit, least = ("s", limits.hold_time) if moved.has_time else ("rows", _HOLD_ROWS)
    seen = _holds(moved, motion.branches) if motion.branches else []
    held = [each for each in seen if each[1] - each[0] >= least]
    if not held:
        return
    lasts = sorted({f"{stop - start:.4g}" for start, stop in held}, key=float)
    how_long = lasts[0] if len(lasts) == 1 else f"{lasts[0]} to {lasts[-1]}"
    often = "once" if len(held) == 1 else f"{len(held)} times"
    place = float(np.interp(sum(held[0]) / 2.0, moved.time, moved.values))
    message = (
        f"the motion stands {often} in the middle of the test, for {how_long} {unit}; first at "
        f"{1e3 * place:.4g} mm, from {held[0][0]:.4g} {unit} on"
    )
    yield info_note("hold", where, message)


def _holds(motion: Signal, branches: tuple[Branch, ...]) -> list[tuple[float, float]]:
    """Begin and end, s, of what stands between branches, on their way, and behind the last one."""
    found = [(before.stop_time, after.start_time) for before, after in pairwise(branches)]
    size = max(1, int(np.median([branch.stop - branch.start for branch in branches])) // _PARTS)
    speed = float(np.median([_branch_speed(motion, branch) for branch in branches]))
    stroke, began = np.ptp(motion.values[~np.isnan(motion.values)]), branches[0].start
    ended = motion.values[~np.isnan(motion.values)][-1]
    is_back = abs(float(ended - motion.values[began])) <= _BACK * stroke
    for branch in branches:
        goes_on = branch is branches[-1] and not is_back
        part = slice(branch.start, None if goes_on else branch.stop)
        outer = branch in (branches[0], branches[-1])
        known = ~np.isnan(motion.values[part])
        time, values = motion.time[part][known], motion.values[part][known]
        for start, stop in standing_stretches(time, values, size=size, speed=speed):
            away = abs(float(np.median(values[start:stop]) - motion.values[began]))
            if not outer or away > _AT_HOME * stroke:  # a rest before or behind the test is none
                found.append((float(time[start]), float(time[stop - 1])))
    return _merged(found)


def _branch_speed(motion: Signal, branch: Branch) -> float:
    """Speed over the faster half of a branch, m/s."""
    part = motion.values[branch.start : branch.stop : max(1, (branch.stop - branch.start) // 10)]
    lasts = (branch.stop_time - branch.start_time) / max(1, len(part) - 1)
    steps = np.abs(np.diff(part))
    steps = np.sort(steps[~np.isnan(steps)])
    return float(np.median(steps[len(steps) // 2 :])) / lasts if len(steps) and lasts else 0.0


def _merged(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Stretches in order; those that nearly touch are one."""
    merged: list[tuple[float, float]] = []
    for start, stop in sorted(found):
        if merged and start - merged[-1][1] <= _BACK * (stop - start):
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
    """Whether the motion goes on at the last sample, and is not where it was to go."""
    last = branches[-1]
    known = ~np.isnan(motion.values[last.start :])
    time, values = motion.time[last.start :][known], motion.values[last.start :][known]
    if not moves_at_end(time, values):
        return False
    if is_cut_file:
        return True
    if len(branches) == 1:
        return not is_full_stroke
    return not _arrived(motion, branches, float(values[-1]), limits)


def _arrived(motion: Signal, branches: tuple[Branch, ...], end: float, limits: Limits) -> bool:
    """Whether the last branch ends where the one before it did, or beyond."""
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
    # near the peak the force is steep, at the end of unloading it is small
    is_loading = last.direction is Direction.LOADING
    shortfall = limits.loading_shortfall if is_loading else limits.unloading_shortfall
    near = max(shortfall * stroke, step, 5.0 * noise_level(motion.values))
    return sense * end >= turns[-1] - near
