"""Joining the clock of the force to that of the motion: by turns, by a common start, as stated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import sqrt
from typing import assert_never

import numpy as np

from labpipe.errors import in_test_sheet
from labpipe.process.motion import (
    WORST_CORNER,
    Turn,
    check_turns,
    match_strokes,
    turn_events,
    turning_points,
    upright,
)
from labpipe.protocol.schema import (
    Align,
    AlignCommonStart,
    AlignNone,
    AlignStated,
    AlignTurningPoints,
)
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, blocking, doubtful, info_note
from labpipe.records.signals import Signal, Signals
from labpipe.signal.clock_alignment import Repeat, fit_clocks, fit_lag, rough_peaks
from labpipe.signal.corners import Corner
from labpipe.signal.reversals import Reversal
from labpipe.signal.turning_points import Stroke, sharpest_turn
from labpipe.uncertainty.zero_drift import drift_modes

_TRIM = 1.0
"""s at both ends of a cycle that are left out of a comparison of cycles."""
_CONTRADICTED = 4.0
"""Standard errors by which the lag of the repeated cycle may differ from that of the corners."""
_RELAXES = 0.01
"""Share of its range that a force loses in a dwell before the lag of the repeated cycle is doubted;
with 0.04 the drift was off by two standard errors."""


def join_clocks(
    signals: Signals, align: Align, motion: Signal, strokes: tuple[Stroke, ...]
) -> tuple[ClockFit | None, list[Turn], list[Finding]]:
    """Join the clock of the force to that of the motion as the protocol says.

    Parameters
    ----------
    signals : raw, with the channel that is to show the turns
    align : of the protocol
    motion, strokes : the travel and its strokes

    Returns
    -------
    The fit, None where there is none; the turns of the motion that it was looked for at, and what
    was found.
    """
    if not strokes or isinstance(align, AlignNone):
        return None, [], []
    force = signals.raw[align.channel or signals.force]
    by_turns = isinstance(align, AlignTurningPoints)
    if not by_turns and force.clock == signals.raw[signals.displacement].clock:
        return None, [], []
    turns = turning_points(motion, strokes, window=align.motion_window)
    fit: ClockFit | None
    match align:
        case AlignStated():
            fit, found = stated_clocks(force, align, motion, strokes)
        case AlignCommonStart():
            fit, found = start_together(force, align, motion, strokes, turns)
        case AlignTurningPoints():
            fit, found = align_clocks(force, align, motion, strokes, turns)
        case _ as never:
            assert_never(never)
    for_clock = not isinstance(align, AlignStated)
    return fit, turns, [*found, *check_turns(motion, strokes, turns, for_clock=for_clock)]


def align_clocks(
    force: Signal,
    align: AlignTurningPoints,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> tuple[ClockFit | None, list[Finding]]:
    """Fit the force's clock to the motion's, from the peaks that both have seen.

    Parameters
    ----------
    force : the raw channel that joins the clocks
    align : windows and limits of the protocol
    motion, strokes, turns : the travel, its strokes, and the turns that were found between them

    Returns
    -------
    The fit, or None where there is none, and what was found on the way.
    """
    if _is_constant(force):
        level = float(np.nanmean(force.values))
        message = f"the {align.channel} is constant at {level:.6g} {force.unit}"
        return None, [blocking("constant_channel", align.channel, message)]
    force = upright(force)
    pairs, is_ambiguous, counted = match_strokes(motion, force, strokes, sign=1)
    events = turn_events(force, pairs, turns, align.force_window)
    if not events:
        why = _why_no_event(force, len(pairs), counted)
        return None, [blocking("no_common_peak", "align", why)]
    fit, found = _fitted(events, None), _ambiguous(counted) if is_ambiguous else []
    if len(events) > 2 and not _relaxes(force, turns, fit):
        repeat, more = _consistent(_repeat(motion, strokes, turns, force, fit), fit)
        fit, found = _fitted(events, repeat), [*found, *more]
    return fit, [*found, *_judged(fit, align)]


def _is_constant(force: Signal) -> bool:
    return not np.nanmax(force.values) > np.nanmin(force.values)


def _ambiguous(counted: str) -> list[Finding]:
    message = (
        "another pairing of the peaks may be the right one, as not all of the test is in both "
        f"records ({counted}); if you know the offset, state it: "
        f"{in_test_sheet('align', '{method: stated, offset: ...}')}"
    )
    return [doubtful("alignment_ambiguous", "align", message, "clock")]


def _why_no_event(force: Signal, pairs: int, counted: str) -> str:
    """What to tell a person when no peak was found on both clocks."""
    start = float(np.nanmean(force.values[: max(1, len(force.values) // 100)]))
    if start - np.nanmin(force.values) > 2.0 * (np.nanmax(force.values) - start):
        return "the force falls where the clamp loads: look at the sign of calibration.gain"
    if pairs:
        return (
            f"{pairs} peaks of the motion lie at peaks of the force, but none of these is a "
            f"corner known to {WORST_CORNER:g} s: noise or mains hum on the force?"
        )
    return f"{counted}, no pair"


def _repeat(
    motion: Signal, strokes: tuple[Stroke, ...], turns: list[Turn], force: Signal, fit: ClockFit
) -> Repeat | None:
    """Lag from the second cycle to the last, seen on both clocks.

    The first cycle is left out: it is the one that deforms the specimen for the first time.
    """
    tops = {turn.stroke: turn.middle for turn in turns}
    cycles = [
        (float(motion.time[up.start]), tops[number], float(motion.time[down.stop]))
        for number, (up, down) in enumerate(pairwise(strokes))
        if up.sign > 0 > down.sign and number in tops
    ]
    if len(cycles) < 3:
        return None
    (start, turn, stop), last = cycles[1], cycles[-1]
    start, stop, guess = start + _TRIM, stop - _TRIM, last[1] - turn
    moved = fit_lag(
        motion.time,
        motion.values,
        start=start,
        turn=turn,
        stop=stop,
        guess=guess,
        hysteresis=False,
    )
    begin, top, end = (fit.to_force_seconds(at) for at in (start, turn, stop))
    lag_of = partial(
        fit_lag,
        force.time,
        start=begin,
        turn=top,
        stop=end,
        guess=guess * (1.0 + fit.drift),
        hysteresis=True,
    )
    pulled = lag_of(force.values)
    if isinstance(moved, Failure) or isinstance(pulled, Failure):
        return None
    error = float(np.hypot(moved.error, pulled.error))
    by = force.zero_drift * float(np.nanmax(np.abs(force.values)))
    lags = [lag_of(force.values + wave) for wave in drift_modes(force.time - force.time[0], by)]
    steps = [lag.value - pulled.value for lag in lags if not isinstance(lag, Failure)]
    return Repeat(moved.value, pulled.value, error, wander=float(np.linalg.norm(steps)))


def _relaxes(force: Signal, turns: list[Turn], fit: ClockFit) -> bool:
    """Whether a force is lost while the machine waits, so that no cycle is quite like another."""
    levels = []
    for turn in turns:
        ends = np.array([turn.arrival.time, turn.departure.time])
        start, stop = fit.to_force_time(ends).tolist()
        inside = start + np.array([[0.1, 0.35], [0.65, 0.9]]) * (stop - start)
        parts = [force.values[slice(*np.searchsorted(force.time, part))] for part in inside]
        if all(np.isfinite(part).any() for part in parts):
            levels.append([float(np.nanmean(part)) for part in parts])
    if not levels:
        return False
    span = float(np.nanmax(force.values) - np.nanmin(force.values))
    return max(abs(before - after) for before, after in levels) > _RELAXES * span


def _consistent(repeat: Repeat | None, fit: ClockFit) -> tuple[Repeat | None, list[Finding]]:
    """The lag of the repeated cycle, unless the corners contradict it: cycles need not be alike."""
    if repeat is None:
        return None, []
    expected = (1.0 + fit.drift) * repeat.motion
    error = float(np.hypot(repeat.error, fit.drift_interval.standard_error * repeat.motion))
    if abs(repeat.force - expected) <= _CONTRADICTED * error:
        return repeat, []
    message = (
        f"the force of the last cycle lies {repeat.force:.3f} s behind that of the second, the "
        f"turning points {expected:.3f} s: the cycles are not alike, and the turning points alone "
        "join the clocks"
    )
    return None, [info_note("cycles_not_alike", "align", message)]


def _fitted(events: list[tuple[Corner, Reversal]], repeat: Repeat | None) -> ClockFit:
    method = "turning points: lines through the travel, smooth pieces of the force"
    columns = [
        [seen.time, felt.corner.time, _event_error(seen, felt, len(events))]
        for seen, felt in events
    ]
    return fit_clocks(
        *np.array(columns, dtype=np.float64).T,
        method=method if repeat is None else f"{method}; lag of the repeated cycle",
        repeat=repeat,
    )


def _event_error(motion: Corner, force: Reversal, count: int) -> float:
    """Standard error of an event; what is alike in all of them counts as often as they are many.

    The same specimen turns in the same way, so that what its force hides does not average out.
    """
    common = float(np.sqrt(count - 1)) * force.shape_error
    return float(np.hypot(np.hypot(motion.time_error, force.corner.time_error), common))


_BY_CHANCE = 2.0
"""Times the error of a turning point that clocks may disagree by before it is no chance: what a
noisy turn leaves open is in the offset's interval, and in those of all that rests on it."""


def _judged(fit: ClockFit, align: AlignTurningPoints) -> Iterator[Finding]:
    chance = _BY_CHANCE * float(np.sqrt(np.mean(fit.event_errors**2)))
    if fit.residual > max(align.max_residual, chance):
        message = (
            f"the clocks agree to {1e3 * fit.residual:.3g} ms rms at the turning points, "
            f"the protocol allows {1e3 * align.max_residual:.3g} ms"
        )
        yield doubtful("alignment_residual", "align", message, "clock")
    known_to = 0.5 * (fit.drift_interval.upper - fit.drift_interval.lower)
    if abs(fit.drift) - known_to > align.max_drift:  # more than chance would have it
        message = (
            f"the clocks drift by {1e6 * fit.drift:.4g} ppm, known to {1e6 * known_to:.3g} ppm, "
            f"the protocol allows {1e6 * align.max_drift:.4g} ppm"
        )
        # instruments keep time to parts in a million: these may be recordings of two tests
        yield doubtful("alignment_drift", "align", message, "clock", "displacement", "force")
    if len(fit.event_times_motion) == 1:
        message = "only one turning point was seen by both: the drift is taken as zero"
        yield doubtful("alignment_one_event", "align", message, "clock")


_RATE = 1e-4
"""How far two recorders may differ in rate that were never compared."""
_SMOOTH, _SHARE = 0.5, 0.3
"""As for `rough_peaks`: s, and share of the range."""
_FAR, _SURELY = 1.0, 3.0
"""s by which a peak of the force may be off its turn by a rough look at it; and standard errors."""


def stated_clocks(
    force: Signal, align: AlignStated, motion: Signal, strokes: tuple[Stroke, ...]
) -> tuple[ClockFit, list[Finding]]:
    """Take an offset between the clocks of force and motion as it is stated.

    Parameters
    ----------
    force : the raw channel whose peaks are to lie at the turns
    align : offset, drift, uncertainty and reason of the protocol
    motion, strokes : on the clock of the motion

    Returns
    -------
    The fit, with the statement in place of an event; a note, and a doubt where the force peaks
    elsewhere.

    Notes
    -----
    Without a stated uncertainty the offset is taken as known to one sample of the slower recorder.
    The drift is known to 100 ppm / sqrt(3), a rectangle (GUM, JCGM 100:2008, sec. 4.3.7).
    """
    known_to = align.uncertainty
    if known_to is None:
        known_to = max(median(np.diff(motion.time)), median(np.diff(force.time)))
    fit = ClockFit(
        offset=align.offset,
        drift=align.drift,
        offset_interval=Interval.normal_95(align.offset, known_to),
        drift_interval=Interval.normal_95(align.drift, _RATE / sqrt(3.0)),
        residual=0.0,
        event_times_motion=np.zeros(1),
        event_times_force=np.full(1, align.offset),
        event_errors=np.full(1, known_to),
        method=f"stated: {align.because}",
    )
    message = (
        f"the offset of the clocks is stated, not measured: {align.offset:.6g} s, standard "
        f"uncertainty {known_to:.3g} s"
        f"{'' if align.uncertainty is not None else ' (one sample, as none is stated)'}, drift "
        f"{1e6 * align.drift:.4g} ppm, because: {align.because}"
    )
    note = info_note("clocks_stated", "align", message)
    return fit, [note, *_contradicted(force, fit, motion, strokes)]


def _contradicted(
    force: Signal, fit: ClockFit, motion: Signal, strokes: tuple[Stroke, ...]
) -> Iterator[Finding]:
    """Doubt a statement by which the force peaks long before or after the motion turns."""
    if not strokes or _is_constant(force):
        return
    force = upright(force)
    peaks = rough_peaks(force.time, force.values, smoothing=_SMOOTH, share=_SHARE)
    if not len(peaks):
        return
    ends = [motion.time[[before.stop, after.start]] for before, after in pairwise(strokes)]
    tops = [fit.to_force_time(end) for end in ends[::2]]  # of the strokes that load
    lags = [
        max(0.0, float(np.abs(peaks - top.mean()).min()) - 0.5 * float(np.ptp(top)))
        for top in tops
        if force.time[0] <= top[0] and top[1] <= force.time[-1]
    ]
    known_to = float(fit.event_errors[0])
    off = median(np.array(lags)) if lags else 0.0
    if off <= _FAR + _SURELY * known_to:
        return
    message = (
        f"by the stated offset the force peaks {off:.2f} s away from where the "
        "motion turns: look at its sign (time of the force less time of the motion) and at the "
        "files"
    )
    yield doubtful("clocks_stated_wrong", "align", message, "clock", "force")


@dataclass(frozen=True, slots=True)
class Seen:
    """A turning point that both recorders have seen: their times, s, and the difference's error."""

    motion: float
    force: float
    error: float


def start_together(
    force: Signal,
    align: AlignCommonStart,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> tuple[ClockFit, list[Finding]]:
    """Fit the force's clock to the motion's, both started by one trigger.

    Parameters
    ----------
    force : the raw channel that is to show the turns
    align : channel and limits of the protocol
    motion, strokes, turns : the travel, its strokes, and the turns that were found between them

    Returns
    -------
    The fit, and a doubt where the two did not start together.

    Notes
    -----
    Three kinds of evidence in one weighted least-squares fit of offset and drift: the common start
    says offset = 0 with the standard uncertainty max_offset / sqrt(3) of a rectangle, instruments
    say drift = 0 with that of max_drift (GUM, JCGM 100:2008, sec. 4.3.7), every corner of the force
    says what its difference to the turn of the motion is. A sharp corner so decides within the
    limits of the start, a blurred one leaves what the start says. Where the corner contradicts the
    start by more than its own 95 % interval, the start is left out and the clocks are doubtful.
    """
    found: list[Finding] = []
    if _is_constant(force):
        message = (
            f"the {align.channel} is constant at {float(np.nanmean(force.values)):.6g} "
            f"{force.unit}: is it the right channel, and is the cell connected?"
        )
        found.append(blocking("constant_channel", align.channel, message))
    seen = _seen(force, align, motion, strokes, turns)
    at_turn = _weighted(seen)
    together = at_turn is None or abs(at_turn[0]) - 1.96 * at_turn[1] <= align.max_offset
    fit = _fit_together(seen, align, together=together)
    return fit, [*found, _finding(fit, align, at_turn, together=together)]


def _seen(
    force: Signal,
    align: AlignCommonStart,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> list[Seen]:
    """Turns at the top of loading that the force has seen as well."""
    force = upright(force)
    pairs = _paired(motion, force, strokes, align)
    return [
        Seen(seen.time, felt.corner.time, float(np.hypot(seen.time_error, felt.corner.time_error)))
        for seen, felt in turn_events(force, pairs, turns, align.force_window)
    ]


def _paired(
    motion: Signal, force: Signal, strokes: tuple[Stroke, ...], align: AlignCommonStart
) -> list[tuple[int, float]]:
    """Strokes that end at the top of loading, and where the force roughly turns there."""
    loads = [stroke.sign == strokes[0].sign for stroke in strokes[:-1]]
    if sum(loads) == 1:
        near = sharpest_turn(force.time, force.values, width=align.force_window)
        return [] if near is None else [(0, near)]
    return match_strokes(motion, force, strokes, sign=strokes[0].sign)[0]


def _weighted(seen: list[Seen]) -> tuple[float, float] | None:
    """Mean difference at the turns and its standard error, s."""
    if not seen:
        return None
    weights = np.array([seen.error for seen in seen]) ** -2.0
    differences = np.array([seen.force - seen.motion for seen in seen])
    return float(np.average(differences, weights=weights)), float(weights.sum() ** -0.5)


def _fit_together(seen: list[Seen], align: AlignCommonStart, *, together: bool) -> ClockFit:
    design: Floats = np.array([[1.0, seen.motion] for seen in seen] + [[0.0, 1.0]])
    says = np.array([seen.force - seen.motion for seen in seen] + [0.0])
    errors = np.array([seen.error for seen in seen] + [align.max_drift / sqrt(3.0)])
    if together:
        design = np.vstack([design, [1.0, 0.0]])
        says = np.append(says, 0.0)
        errors = np.append(errors, align.max_offset / sqrt(3.0))
    weighted = design / errors[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    offset, drift = (float(say) for say in covariance @ weighted.T @ (says / errors))
    offset_error, drift_error = (float(each) for each in np.sqrt(np.diag(covariance)))
    events = seen or [Seen(0.0, 0.0, align.max_offset / sqrt(3.0))]  # the trigger itself
    motion, force, spread = np.array([[e.motion, e.force, e.error] for e in events]).T
    left = force - offset - (1.0 + drift) * motion
    how = "the force's corner at the turn"
    how = f"common start and {how}" if together else f"{how} alone"
    return ClockFit(
        offset=offset,
        drift=drift,
        offset_interval=Interval.normal_95(offset, offset_error),
        drift_interval=Interval.normal_95(drift, drift_error),
        residual=float(np.sqrt(np.mean(left**2))),
        event_times_motion=motion,
        event_times_force=force,
        event_errors=spread,
        method=f"{how}, drift taken as zero within a bound",
    )


def _finding(
    fit: ClockFit,
    align: AlignCommonStart,
    at_turn: tuple[float, float] | None,
    *,
    together: bool,
) -> Finding:
    if at_turn is None:
        message = (
            f"the {align.channel} shows no corner at a turn of the motion: the common start, "
            f"within {1e3 * align.max_offset:.3g} ms, is taken as it is"
        )
        return info_note("start_unchecked", "align", message)
    known, apart = 1.96e3 * at_turn[1], abs(at_turn[0])
    far = f"{apart:.2f} s" if apart > 1.0 else f"{1e3 * apart:.4g} ms"
    said = (
        f"the {align.channel} turns {far} "
        f"{'after' if at_turn[0] >= 0.0 else 'before'} the motion, known to {known:.2g} ms"
    )
    if together:
        message = f"{said}; started together, so {1e3 * fit.offset:.4g} ms is taken at the start"
        return info_note("common_start", "align", message)
    message = (
        f"{said}: the recorders did not start within {1e3 * align.max_offset:.3g} ms of each "
        "other; the difference at the turn is taken"
    )
    return doubtful("not_started_together", "align", message, "clock", "force")
