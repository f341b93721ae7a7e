"""Joining the clock of the force to the clock of the motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from labpipe.errors import in_test_sheet
from labpipe.process.motion_turns import Turn
from labpipe.protocol.schema import AlignTurningPoints
from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, blocking, doubtful, worth_knowing
from labpipe.records.signals import Signal
from labpipe.signal.clock_alignment import Repeat, fit_clocks, fit_lag, match_peaks, rough_peaks
from labpipe.signal.corners import Corner
from labpipe.signal.reversals import Reversal, fit_reversal
from labpipe.signal.turning_points import Stroke, goes_down, turn_near

_TRIM = 1.0
"""s at both ends of a cycle that are left out of a comparison of cycles."""
_CONTRADICTED = 4.0
"""Standard errors by which the lag of the repeated cycle may differ from that of the corners."""
_RELAXES = 0.01
"""Share of its range that a force loses in a dwell before the lag of the repeated cycle is doubted;
with 0.04 the drift was off by two standard errors."""
_RESTS = 0.2
"""Share of its range above its lowest value below which a signal rests."""
_ROUGH = 1.0
"""s on each side of what a force was roughly seen to turn at, in which its corner is looked for."""
_WORST_CORNER = 0.1
"""s; a corner of the force known no better than this says nothing about a clock."""


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
    if not np.nanmax(force.values) > np.nanmin(force.values):
        level = float(np.nanmean(force.values))
        message = f"the {align.channel} is constant at {level:.6g} {force.unit}"
        return None, [blocking("constant_channel", align.channel, message)]
    if goes_down(force.values):  # a reversed bridge turns when any other does
        force = replace(force, values=-force.values)
    pairs, is_ambiguous, counted = match_strokes(motion, force, strokes, sign=1)
    seen = {turn.stroke: turn for turn in turns}
    events = [
        event
        for stroke, near in pairs
        if stroke in seen
        and (event := turn_event(force, seen[stroke], near, window=align.force_window)) is not None
    ]
    if not events:
        why = _why_no_event(force, len(pairs), counted)
        return None, [blocking("no_common_peak", "align", why)]
    fit, found = _fitted(events, None), _ambiguous(counted) if is_ambiguous else []
    if len(events) > 2 and not _relaxes(force, turns, fit):
        repeat, more = _consistent(_repeat(motion, strokes, turns, force, fit), fit)
        fit, found = _fitted(events, repeat), [*found, *more]
    return fit, [*found, *_judged(fit, align)]


def _ambiguous(counted: str) -> list[Finding]:
    message = (
        "another pairing of the peaks may be the right one, as not all of the test is in both "
        f"records ({counted}); if you know the offset, state it: "
        f"{in_test_sheet('align', '{method: stated, offset: ...}')}"
    )
    return [doubtful("clock", code="alignment_ambiguous", message=message, where="align")]


def match_strokes(
    motion: Signal, force: Signal, strokes: tuple[Stroke, ...], *, sign: int
) -> tuple[list[tuple[int, float]], bool, str]:
    """Pair the upper turns of a motion with the peaks of a force: all of them, before any is used.

    Parameters
    ----------
    motion, force : each on its own clock
    strokes : of the motion
    sign : of the strokes that load

    Returns
    -------
    pairs : number of the stroke that ends at the turn, and s, where the force roughly turns
    is_ambiguous : whether another pairing fits as well, or would have to be looked for beyond a
        record that begins or ends in mid-test
    counted : in words, how many peaks of each there are
    """
    tops = [
        (number, 0.5 * float(motion.time[before.stop] + motion.time[after.start]))
        for number, (before, after) in enumerate(pairwise(strokes))
        if before.sign == sign
    ]
    seen = rough_peaks(force.time, force.values, smoothing=0.5, share=0.3)
    times = np.array([top for _, top in tops])
    pairs, is_ambiguous = match_peaks(times, seen)
    if len(pairs) and len(times) > 1 and not (_is_whole(motion) and _is_whole(force)):
        lag = float(np.median(seen[pairs[:, 1]] - times[pairs[:, 0]]))
        is_ambiguous |= abs(lag) > 0.5 * float(np.diff(times).min())
    matched = [(tops[first][0], float(seen[second])) for first, second in pairs.tolist()]
    return matched, is_ambiguous, f"{len(tops)} peaks of the motion, {len(seen)} of the force"


def _is_whole(signal: Signal) -> bool:
    """Whether a record begins and ends at rest, far below its peaks."""
    known = signal.values[~np.isnan(signal.values)]
    size = max(1, len(known) // 200)
    ends = float(known[:size].mean()), float(known[-size:].mean())
    return max(ends) < float(known.min()) + _RESTS * float(np.ptp(known))


def turn_event(
    force: Signal, turn: Turn, near: float, *, window: float
) -> tuple[Corner, Reversal] | None:
    """Find where the force turns when a motion does.

    Parameters
    ----------
    force : on its own clock
    turn : of the motion
    near : s, where the force was roughly seen to turn: anywhere in the dwell
    window : s on each side of a corner

    Returns
    -------
    The corner of the motion, and that of the force; None where that is not known to 0.1 s. With a
    dwell both corners of the force make one event, for the motion says how far they are apart: of
    two windows or less in one fit, so that none is taken for the other, else each for itself.
    """
    dwell = turn.dwell
    reach = dwell + _ROUGH  # the force may have been seen to turn at either corner
    first = turn_near(force.time, force.values, near=near, reach=reach, width=window, dwell=dwell)
    if first is None:
        return None
    if dwell <= 2.0 * window:
        known_to = max(corner.time_error for corner in turn.corners)
        found = [(replace(turn.arrival, time_error=known_to), first, dwell)]
    else:
        found = [(turn.arrival, first, 0.0), (turn.departure, first + dwell, 0.0)]
    events = []
    for corner, at, wait in found:
        inside = _around(force, at, window + wait)
        pulled = fit_reversal(*inside, near=at, window=window, dwell=wait)
        if pulled is not None and pulled.corner.time_error < _WORST_CORNER:
            events.append((corner, pulled))
    return _mean_event(events)


def _mean_event(events: list[tuple[Corner, Reversal]]) -> tuple[Corner, Reversal] | None:
    """One event of the corners of a turn, weighted by what is known of each."""
    if len(events) < 2:
        return events[0] if events else None
    seen, felt = [each for each, _ in events], [each for _, each in events]
    times = np.array([[one.time, two.corner.time] for one, two in events])
    errors = np.array([[one.time_error, two.corner.time_error] for one, two in events])
    together = np.hypot(errors[:, 0], errors[:, 1])
    weights = together**-2.0 / (together**-2.0).sum()
    lags = times[:, 1] - times[:, 0]
    apart = max(1.0, abs(float(lags[1] - lags[0])) / float(np.hypot(*together)))
    at, error = weights @ times, apart * np.sqrt(weights**2 @ errors**2)
    shape_error = float(weights @ [each.shape_error for each in felt])
    corner = replace(felt[0].corner, time=float(at[1]), time_error=float(error[1]))
    return (
        replace(seen[0], time=float(at[0]), time_error=float(error[0])),
        Reversal(corner, shape_error),
    )


def _around(signal: Signal, at: float, window: float) -> tuple[Floats, Floats]:
    span = slice(*np.searchsorted(signal.time, [at - window, at + window]))
    return signal.time[span], signal.values[span]


def _why_no_event(force: Signal, pairs: int, counted: str) -> str:
    """What to tell a person when no peak was found on both clocks."""
    start = float(np.nanmean(force.values[: max(1, len(force.values) // 100)]))
    if start - np.nanmin(force.values) > 2.0 * (np.nanmax(force.values) - start):
        return "the force falls where the clamp loads: look at the sign of calibration.gain"
    if pairs:
        return (
            f"{pairs} peaks of the motion lie at peaks of the force, but none of these is a "
            f"corner known to {_WORST_CORNER:g} s: noise or mains hum on the force?"
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
    pulled = fit_lag(
        force.time,
        force.values,
        start=begin,
        turn=top,
        stop=end,
        guess=guess * (1.0 + fit.drift),
        hysteresis=True,
    )
    if isinstance(moved, Failure) or isinstance(pulled, Failure):
        return None
    return Repeat(moved.value, pulled.value, float(np.hypot(moved.error, pulled.error)))


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
    return None, [worth_knowing("cycles_not_alike", "align", message)]


def _fitted(events: list[tuple[Corner, Reversal]], repeat: Repeat | None) -> ClockFit:
    def column(values: list[float]) -> Floats:
        return np.array(values, dtype=np.float64)

    method = "turning points: lines through the travel, smooth pieces of the force"
    return fit_clocks(
        column([motion.time for motion, _ in events]),
        column([force.corner.time for _, force in events]),
        column([_event_error(motion, force, len(events)) for motion, force in events]),
        method=method if repeat is None else f"{method}; lag of the repeated cycle",
        repeat=repeat,
    )


def _event_error(motion: Corner, force: Reversal, count: int) -> float:
    """Standard error of an event; what is alike in all of them counts as often as they are many.

    The same specimen turns in the same way, so that what its force hides does not average out.
    """
    common = float(np.sqrt(count - 1)) * force.shape_error
    return float(np.hypot(np.hypot(motion.time_error, force.corner.time_error), common))


def _judged(fit: ClockFit, align: AlignTurningPoints) -> Iterator[Finding]:
    if fit.residual > align.max_residual:
        message = (
            f"the clocks agree to {1e3 * fit.residual:.3g} ms rms at the turning points, "
            f"the protocol allows {1e3 * align.max_residual:.3g} ms"
        )
        yield doubtful("clock", code="alignment_residual", message=message, where="align")
    known_to = 0.5 * (fit.drift_interval.upper - fit.drift_interval.lower)
    if abs(fit.drift) - known_to > align.max_drift:  # more than chance would have it
        message = (
            f"the clocks drift by {1e6 * fit.drift:.4g} ppm, known to {1e6 * known_to:.3g} ppm, "
            f"the protocol allows {1e6 * align.max_drift:.4g} ppm"
        )
        yield doubtful("clock", code="alignment_drift", message=message, where="align")
    if len(fit.event_times_motion) == 1:
        message = "only one turning point was seen by both: the drift is taken as zero"
        yield doubtful("clock", code="alignment_one_event", message=message, where="align")
