"""Whether a test went as its protocol takes for granted; what did not makes numbers doubtful."""

from __future__ import annotations

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch
from labpipe.records.estimates import Failure
from labpipe.records.quality import Severity
from labpipe.signal.filters import moving_average, seconds_to_window
from labpipe.signal.turning_points import noise_level

GRAVITY = 9.80665
_SPEED = 0.2
"""Share by which the mean speed of a branch may differ from that of the rig."""
_SETTLED = 0.25
"""s by which a zero may reach into the motion before it is doubted."""
_PULLED = 0.02
"""Share of the largest force below zero that is taken for the zero of a load that only presses."""
_SUNK = 0.2
"""Share by which mid-span may sink otherwise than the displacement says. Round rollers alone make
up to a tenth: the specimen rolls up on them, and lies below them at the nominal supports."""


def check_rig(bench: Bench, protocol: Protocol, branches: tuple[Branch, ...]) -> None:
    """Compare what the rig and the sheet say with what was measured.

    Parameters
    ----------
    bench : gets the notes and doubts
    protocol : resolved; cycles, stroke, specimen length, counterweight where it has them
    branches : of the motion
    """
    rig, cycles = protocol.rig, len({branch.cycle for branch in branches})
    if rig.cycles is not None and branches and cycles != rig.cycles:
        message = f"{cycles} cycles measured, the protocol expects {rig.cycles}"
        bench.note("cycles_unexpected", Severity.WARNING, "rig.cycles", message)
    if branches and protocol.branches is not None:
        motion = bench.raw[protocol.branches.channel]
        if rig.stroke is not None:
            _check_stroke(bench, motion, rig.stroke)
        if rig.crosshead_speed is not None and motion.has_time:
            _check_speed(bench, motion, rig.crosshead_speed, branches[0])
    if rig.string is not None and protocol.curve is not None:
        weight = rig.string.counterweight * GRAVITY
        _check_pull(bench, bench.signals[protocol.curve.force], weight)
    if protocol.specimen.span is not None and protocol.curve is not None:
        _check_push(bench, bench.signals[protocol.curve.force])
    if protocol.specimen.length is not None and protocol.markers is not None:
        _check_length(bench, protocol.specimen.length, has_clamp=protocol.markers.clamp is not None)


def _check_stroke(bench: Bench, motion: Signal, expected: float) -> None:
    stroke = float(np.nanmax(motion.values) - np.nanmin(motion.values))
    bench.is_full_stroke = abs(stroke - expected) <= 0.02 * expected
    if not bench.is_full_stroke:
        message = f"a stroke of {1e3 * stroke:.4g} mm measured, {1e3 * expected:.4g} mm expected"
        bench.note("stroke_unexpected", Severity.WARNING, "rig.stroke", message)


def _check_speed(bench: Bench, motion: Signal, expected: float, first: Branch) -> None:
    """Another speed than the rig was set to: another unit, another column, another test."""
    part = slice(first.start, first.stop)
    moved = np.nanmax(motion.values[part]) - np.nanmin(motion.values[part])
    speed = float(moved) / max(first.stop_time - first.start_time, 1e-9)
    if abs(speed - expected) > _SPEED * expected:
        message = (
            f"{1e3 * speed:.4g} mm/s measured over the first branch, {1e3 * expected:.4g} mm/s "
            "expected: look at rig.crosshead_speed, and at unit and name of the displacement"
        )
        for quantity in ("displacement", "force"):  # it may be the other one's column
            bench.doubt(quantity, "speed_unexpected", message, where="rig.crosshead_speed")


def _check_pull(bench: Bench, force: Signal, weight: float) -> None:
    """A string does not push: below zero the force can fall by the counterweight, no further."""
    smooth = _per_second(force)
    lowest = float(np.nanmin(smooth))
    if lowest < -1.2 * weight - 5.0 * noise_level(smooth) - 2e-3:
        message = (
            f"the force falls to {lowest:.4g} N, but a string cannot push: the zero is wrong or "
            "drifts"
        )
        bench.doubt("force", "force_negative", message, where="force")


def _check_push(bench: Bench, force: Signal) -> None:
    """What presses on a specimen between two supports does not pull at it."""
    if not force.has_time or bench.blocked:
        return
    smooth = _per_second(force)
    lowest, highest = float(np.nanmin(smooth)), float(np.nanmax(smooth))
    if lowest < -_PULLED * highest - 5.0 * noise_level(smooth):
        message = (
            f"the force falls to {lowest:.4g} N, but what presses on a specimen between supports "
            "cannot pull at it: the zero is wrong or drifts"
        )
        bench.doubt("force", "force_negative", message, where="force")


def _per_second(force: Signal) -> Floats:
    """Means over a second, moving by a tenth of it."""
    size = max(1, seconds_to_window(0.1, force.time))  # a tenth of a second says it as well
    blocks = force.values[: len(force.values) // size * size].reshape(-1, size).mean(axis=1)
    window = max(1, seconds_to_window(1.0, force.time[::size]))
    return moving_average(blocks, window=min(window, len(blocks) - 1 + len(blocks) % 2))


def _check_length(bench: Bench, expected: float, *, has_clamp: bool) -> None:
    """The arc length from clamped end to pull point is the specimen's free length."""
    if bench.shape is None or not has_clamp:
        return
    if abs(bench.shape.length - expected) > max(2e-3, 0.02 * expected):
        message = (
            f"{1e3 * bench.shape.length:.4g} mm from clamped end to pull point, the sheet says "
            f"{1e3 * expected:.4g} mm: look at specimen.length, grip_offset, pull_offset and at "
            "the outermost marker"
        )
        bench.doubt("displacement", "length_unexpected", message, where="specimen.length")


def check_rest(bench: Bench, branches: tuple[Branch, ...]) -> None:
    """Doubt a zero that was taken while the clamp was already moving.

    Parameters
    ----------
    bench : knows over which stretches it was zeroed
    branches : of the motion
    """
    if not branches:
        return
    begins, ends = branches[0].start_time, branches[-1].stop_time
    for name, stretch in bench.zeroed.items():
        start, stop = (bench.on_curve_clock(at, bench.raw[name].clock) for at in stretch)
        if stop > begins + _SETTLED and start < ends - _SETTLED:
            message = (
                f"zeroed from {start:.2f} s to {stop:.2f} s of the motion's clock, but the clamp "
                f"moves from {begins:.2f} s to {ends:.2f} s"
            )
            quantity = "force" if name == bench.force else "displacement"
            bench.doubt(quantity, "zero_not_at_rest", message, where=name)


def check_mid_span(bench: Bench, motion: Signal, branches: tuple[Branch, ...]) -> None:
    """Give up cameras that began under load; doubt a displacement that is not what they see.

    Parameters
    ----------
    bench : its ``mid_span`` is used, where there is one and its clock is known
    motion : the displacement
    branches : of the motion
    """
    seen, span = bench.raw.get("mid_span"), bench.span
    if seen is None or span is None or isinstance(span, Failure) or not branches:
        return
    fit, rested = bench.other_clocks.get(seen.clock), span.time[span.rest]
    late = (rested if fit is None else fit.to_marker_time(rested))[-1] - branches[0].start_time
    if late > _SETTLED:
        message = (
            f"the shape at rest was taken up to {late:.2f} s after loading began: look at the "
            "cameras' start, and at 'over' of the step three-point-shape"
        )
        bench.span = Failure("no_rest", message)
        bench.note("no_rest", Severity.ERROR, "markers", message)
        return
    sunk, moved = (
        float(np.nanmax(each) - np.nanmin(each)) for each in (seen.values, motion.values)
    )
    if abs(sunk - moved) <= _SUNK * moved:
        return
    message = (
        f"cameras see mid-span sink by {1e3 * sunk:.4g} mm, the displacement is {1e3 * moved:.4g} "
        "mm: look at specimen.span, at markers that are not on the specimen, at the units of both "
        "exports, at rig.crosshead_speed and rig.stroke where no frame measured it, and at how far "
        "the load was from the specimen"
    )
    bench.doubt("displacement", "mid_span_differs", message, where="mid_span")
