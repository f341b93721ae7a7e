"""The story of one test: from recordings to results, without touching a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias, TypeGuard, assert_never

import numpy as np

from labpipe.pipeline.beginnings import check_begin
from labpipe.pipeline.bench import Bench, Signal, at_times_of_curve
from labpipe.pipeline.bundle_results import (
    beam_results,
    hardening_results,
    kink_results,
    loading_stiffness_results,
    plateau_results,
)
from labpipe.pipeline.clocks import align_clocks
from labpipe.pipeline.common_start import start_together
from labpipe.pipeline.corrections import correct_curve, without_strays
from labpipe.pipeline.cycle_results import (
    clock_results,
    energy,
    loading_stiffness,
    peak_displacement,
    peak_force,
    residual_displacement,
    tip_travel_result,
    unloading_stiffness,
)
from labpipe.pipeline.layout import lay_out
from labpipe.pipeline.plausibility import (
    check_mid_span,
    check_rest,
    check_rig,
)
from labpipe.pipeline.recording_checks import check_channels, check_end, note_holds
from labpipe.pipeline.signs import check_signs
from labpipe.pipeline.stated_clocks import take_stated_clocks
from labpipe.pipeline.steps import step_or_refuse
from labpipe.pipeline.stiffness_results import (
    line_stiffness,
    modulus_result,
    normalised_stiffness,
    two_segments,
)
from labpipe.pipeline.tensile_results import (
    compliance_result,
    energy_to_break_result,
    failure_results,
    slack_result,
    slip_results,
)
from labpipe.pipeline.turns import Turn, check_turns, turning_points
from labpipe.pipeline.zero_changes import check_break, check_zeros
from labpipe.pipeline.zeros import use_rest_there_is
from labpipe.protocol.results import (
    BendingStiffness,
    ClockResult,
    ComplianceResult,
    Energy,
    EnergyToBreak,
    FailureResult,
    Hardening,
    InitialStiffness,
    Kink,
    LoadingStiffness,
    MidSpan,
    Modulus,
    MomentCurvature,
    NormalisedStiffness,
    PeakDisplacement,
    PeakForce,
    Plateau,
    ResidualDisplacement,
    ResultEntry,
    SlackResult,
    SlipResults,
    Stiffness,
    TipTravel,
    Twist,
    TwoSegments,
    UnloadingStiffness,
)
from labpipe.protocol.schema import (
    Align,
    AlignCommonStart,
    AlignStated,
    AlignTurningPoints,
    Protocol,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import Aligned, Branch, ClockFit, Curve, Series
from labpipe.records.recording import Recording
from labpipe.records.result import Result
from labpipe.signal.turning_points import (
    Stroke,
    branch_numbers,
    find_strokes,
    noise_level,
    split_branches,
)

_FAR_OFF = 5.0
"""Standard deviations that noise alone may reach."""


def reduce_recordings(
    recordings: Mapping[str, Recording], protocol: Protocol
) -> tuple[Bench, tuple[Result, ...]]:
    """Reduce the recordings of one test to stages and results.

    Parameters
    ----------
    recordings : by role, their channels named and in SI units as the protocol says
    protocol : resolved

    Returns
    -------
    The bench with every stage that could be reached, and the results in the protocol's order.

    Raises
    ------
    ProcessingError
        If a recording lacks what a step cannot do without, such as the clamp's rigid body.
    """
    bench, markers = lay_out(recordings, protocol)
    check_channels(bench, protocol)
    for step in protocol.steps:
        step_or_refuse(bench, markers, step, protocol)
    if protocol.curve is not None:
        _make_curve(bench, protocol)
    results = [result for entry in protocol.results for result in _results(bench, entry, protocol)]
    return bench, tuple(results)


def _make_curve(bench: Bench, protocol: Protocol) -> None:
    """Put force and displacement on one clock and split them where the motion turns."""
    if protocol.curve is None or protocol.branches is None:
        return
    bench.force, bench.displacement = protocol.curve.force, protocol.curve.displacement
    motion = bench.raw[protocol.branches.channel]
    least, noise = protocol.branches.min_stroke, noise_level(motion.values)
    strokes = find_strokes(motion.time, motion.values, min_stroke=least)
    if _FAR_OFF * noise > least:
        message = (
            f"the motion scatters by {1e3 * noise:.3g} mm from sample to sample, too much to tell "
            f"strokes of min_stroke, {1e3 * least:.3g} mm: is it the right channel?"
        )
        bench.block("no_motion", message, where=protocol.branches.channel)
        strokes = ()
    elif not strokes:
        span = float(np.nanmax(motion.values) - np.nanmin(motion.values))
        message = f"the motion spans {1e3 * span:.3g} mm, less than min_stroke"
        bench.block("no_motion", message, where=protocol.branches.channel)
    times = np.full((len(strokes), 2), np.nan)
    if strokes and _joins_clocks(protocol.align, bench):
        turns = turning_points(motion, strokes, window=protocol.align.motion_window)
        for turn in turns:
            times[turn.stroke, 1] = turn.arrival.time
            times[turn.stroke + 1, 0] = turn.departure.time
        bench.clock_fit = _joined(bench, protocol.align, motion, strokes, turns)
        check_turns(bench, motion, strokes, turns, for_clock=protocol.align.method != "stated")
    branches = split_branches(motion.time, strokes, turning_times=times)
    if bench.span is not None:
        from labpipe.pipeline.three_point import align_cameras  # loaded by these tests alone

        align_cameras(bench, motion, strokes, min_stroke=protocol.branches.min_stroke)
        check_mid_span(bench, motion, branches)
    use_rest_there_is(bench, branches)
    check_rig(bench, protocol, branches)
    check_end(bench, motion, branches)
    note_holds(bench, motion, branches)
    check_rest(bench, branches)
    check_signs(bench, protocol, branches)
    if not bench.blocked:
        bench.aligned = _aligned(bench)
        bench.curve = _curve(bench, motion.time, branches)
        check_zeros(bench)
        correct_curve(bench, protocol.curve)
        check_begin(bench, branches)
        check_break(bench)


Joined: TypeAlias = AlignTurningPoints | AlignCommonStart | AlignStated


def _joins_clocks(align: Align, bench: Bench) -> TypeGuard[Joined]:
    """Whether force and displacement have clocks that are to be joined."""
    if isinstance(align, AlignCommonStart | AlignStated):
        channel = bench.raw[align.channel or bench.force]
        return channel.clock != bench.raw[bench.displacement].clock
    return isinstance(align, AlignTurningPoints)


def _joined(
    bench: Bench,
    align: Joined,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> ClockFit | None:
    match align:
        case AlignStated():
            return take_stated_clocks(bench, align, motion, strokes)
        case AlignCommonStart():
            return start_together(bench, align, motion, strokes, turns)
        case AlignTurningPoints():
            return align_clocks(bench, align, motion, strokes, turns)
        case _ as never:
            assert_never(never)


def _aligned(bench: Bench) -> Aligned:
    """All raw signals at the times of the displacement; the curve's own under the words for it."""
    time = bench.signals[bench.displacement].time
    words = {bench.force: "force", bench.displacement: "displacement"}
    series = {
        words.get(name, name): Series(at_times_of_curve(bench, signal, time), signal.unit)
        for name, signal in bench.raw.items()
    }
    return Aligned(time, series, bench.clock_fit, bench.signals[bench.displacement].time_unit)


def _curve(bench: Bench, motion_time: Floats, branches: tuple[Branch, ...]) -> Curve | None:
    displacement = bench.signals[bench.displacement]
    time = displacement.time
    bench.unfiltered = without_strays(bench)  # filtered once its corners are known
    force = at_times_of_curve(bench, bench.unfiltered, time)
    if np.isnan(force).all():
        force_time = bench.signals[bench.force].time
        message = (
            f"force from {force_time[0]:.3f} s to {force_time[-1]:.3f} s and motion from "
            f"{time[0]:.3f} s to {time[-1]:.3f} s do not overlap"
        )
        bench.block("no_overlap", message, where="align")
        return None
    moved = tuple(_on_clock(branch, motion_time, time) for branch in branches)
    branch, cycle = branch_numbers(len(time), moved)
    return Curve(time, displacement.values, force, branch, cycle, moved, displacement.time_unit)


def _on_clock(branch: Branch, motion_time: Floats, time: Floats) -> Branch:
    """Count a branch in samples of another time axis on the same clock."""
    if len(motion_time) == len(time):
        return branch
    last = min(branch.stop, len(motion_time)) - 1
    start, stop = np.searchsorted(time, [motion_time[branch.start], motion_time[last]])
    return Branch(
        int(start), int(stop), branch.cycle, branch.direction, branch.start_time, branch.stop_time
    )


def _results(  # noqa: C901, PLR0911, PLR0912  one case per entry of the union
    bench: Bench, entry: ResultEntry, protocol: Protocol
) -> list[Result]:
    match entry:
        case ClockResult():
            return clock_results(bench)
        case PeakForce():
            return peak_force(bench)
        case PeakDisplacement():
            return peak_displacement(bench)
        case InitialStiffness():
            name = "initial_stiffness"
            return loading_stiffness(bench, name=name, low=entry.start, high=entry.stop)
        case Stiffness():
            seen_by_cameras = bench.shape is not None
            stiffness = loading_stiffness if seen_by_cameras else line_stiffness
            return stiffness(bench, name=entry.name, low=entry.start, high=entry.stop)
        case TwoSegments():
            return two_segments(bench, low=entry.start, high=entry.stop)
        case NormalisedStiffness():
            return normalised_stiffness(bench, of=entry.of)
        case Modulus():
            return modulus_result(bench, entry, protocol.specimen)
        case FailureResult():
            return failure_results(bench)
        case EnergyToBreak():
            return energy_to_break_result(bench)
        case SlipResults():
            return slip_results(bench)
        case SlackResult():
            return slack_result(bench)
        case ComplianceResult():
            return compliance_result(bench, low=entry.start, high=entry.stop)
        case Kink():
            return kink_results(bench, low=entry.start, high=entry.stop)
        case Plateau():
            return plateau_results(bench, entry)
        case LoadingStiffness():
            return loading_stiffness_results(bench, over=entry.over)
        case Hardening():
            return hardening_results(bench, over=entry.over)
        case BendingStiffness():
            return beam_results(bench, entry, protocol)
        case UnloadingStiffness():
            return unloading_stiffness(bench, over=entry.over)
        case Energy():
            return energy(bench)
        case ResidualDisplacement():
            return residual_displacement(bench, force_below=entry.force_below)
        case MomentCurvature():
            from labpipe.pipeline.bending import bending_stiffness  # loaded by these tests alone

            return bending_stiffness(bench, entry, protocol)
        case TipTravel():
            return tip_travel_result(bench)
        case MidSpan():
            from labpipe.pipeline.three_point import mid_span_results

            return mid_span_results(bench, entry)
        case Twist():
            from labpipe.pipeline.three_point import twist_result

            return twist_result(bench)
        case _ as never:
            assert_never(never)
