"""Joining the clock of the force to the clock of the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labpipe.fitting.corners import Corner, fit_corner
from labpipe.fitting.estimates import Failure
from labpipe.fitting.repeats import fit_lag
from labpipe.fitting.reversals import Reversal, fit_reversal
from labpipe.pipeline.bench import Bench, Signal
from labpipe.processing.alignment import Repeat, fit_clocks, match_peaks, rough_peaks
from labpipe.processing.strokes import Stroke, goes_down
from labpipe.protocol.rig import AlignTurningPoints
from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit
from labpipe.records.quality import Severity

_TRIM = 1.0
"""s at both ends of a cycle that are left out of a comparison of cycles."""
_SEEN = 0.5
"""s on each side of a turning point in which the motion must have been seen."""
_CONTRADICTED = 4.0
"""Standard errors by which the lag of the repeated cycle may differ from that of the corners."""
_WORST_CORNER = 0.1
"""s; a corner of the force known no better than this says nothing about a clock."""


@dataclass(frozen=True, slots=True)
class Turn:
    """Where a motion turns: at once, or after a dwell.

    Parameters
    ----------
    stroke : number of the stroke that ends there
    arrival, departure : corners of the motion; one and the same where there is no dwell
    """

    stroke: int
    arrival: Corner
    departure: Corner

    @property
    def middle(self) -> float:
        """Time halfway between arrival and departure, s."""
        return 0.5 * (self.arrival.time + self.departure.time)

    @property
    def corners(self) -> tuple[Corner, ...]:
        """The corners, each once."""
        return (self.arrival,) if self.arrival is self.departure else (self.arrival, self.departure)

    def window(self, most: float) -> float:
        """Seconds on each side of a corner that hold no other corner."""
        dwell = self.departure.time - self.arrival.time
        return min(most, 0.95 * dwell) if dwell > 0 else most


def turning_points(motion: Signal, strokes: tuple[Stroke, ...], *, window: float) -> list[Turn]:
    """Find when a motion turns, by straight lines on both sides of each corner.

    Parameters
    ----------
    motion : the travel on its own clock
    strokes : of that motion
    window : s on each side, cut to the length of strokes and dwells

    Returns
    -------
    The turns in order. Those without a clear corner, or not seen themselves, are left out.
    """
    turns = []
    for number, (before, after) in enumerate(pairwise(strokes)):
        ends = motion.time[[before.start, before.stop, after.start, after.stop]]
        spans = np.diff(ends)
        if spans[1] == 0.0:
            arrival = departure = _line_corner(motion, ends[1], window, min(spans[0], spans[2]))
        else:
            arrival = _line_corner(motion, ends[1], window, min(spans[0], spans[1]))
            departure = _line_corner(motion, ends[2], window, min(spans[1], spans[2]))
        if arrival is not None and departure is not None:
            turns.append(Turn(number, arrival, departure))
    return turns


def _line_corner(motion: Signal, near: float, window: float, room: float) -> Corner | None:
    around = np.abs(motion.time - near) <= _SEEN
    if np.isnan(motion.values[around]).mean() > 0.3:
        return None
    reach = min(window, 0.95 * float(room))
    corner = fit_corner(motion.time, motion.values, near=float(near), window=reach, degree=1)
    return corner if corner is not None and np.isfinite(corner.time_error) else None


def align_clocks(
    bench: Bench,
    align: AlignTurningPoints,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> ClockFit | None:
    """Fit the force's clock to the motion's, from the peaks that both have seen.

    Parameters
    ----------
    bench : its raw force is used; gets notes, doubts, and what blocks it
    align : windows and limits of the protocol
    strokes, turns : of the motion

    Returns
    -------
    The fit, or None when there is none to be had; the bench then says why.
    """
    force = bench.raw[align.channel]
    if not np.nanmax(force.values) > np.nanmin(force.values):
        level = float(np.nanmean(force.values))
        message = f"the {align.channel} is constant at {level:.6g} {force.unit}"
        bench.block("constant_channel", message, where=align.channel)
        return None
    if goes_down(force.values):  # a reversed bridge turns when any other does
        force = replace(force, values=-force.values)
    peaks = [turn for turn in turns if strokes[turn.stroke].sign > 0]
    seen = rough_peaks(force.time, force.values, smoothing=0.5, share=0.3)
    pairs, is_ambiguous = match_peaks(np.array([peak.middle for peak in peaks]), seen)
    events = [
        (corner, pulled)
        for first, second in pairs.tolist()
        for corner in peaks[first].corners
        if (
            pulled := force_corner(
                force, peaks[first], corner, seen[second], window=align.force_window
            )
        )
        is not None
    ]
    if not events:
        bench.block("no_common_peak", _why_no_event(force, peaks, seen, len(pairs)), where="align")
        return None
    if is_ambiguous:
        message = "another pairing of the peaks fits as well; the smaller offset was taken"
        bench.doubt("clock", "alignment_ambiguous", message, where="align")
    fit = _fitted(events, None)
    if len(events) > 2:
        fit = _fitted(events, _consistent(bench, _repeat(bench, strokes, force, fit), fit))
    _judge(bench, fit, align)
    return fit


def force_corner(
    force: Signal, turn: Turn, corner: Corner, seen: float, *, window: float
) -> Reversal | None:
    """Find a corner of the force: roughly in a wide window, then in the stated one around it.

    Parameters
    ----------
    force : on its own clock
    turn, corner : of the motion, and one of its corners
    seen : s, where the force was roughly seen to turn
    window : s on each side; cut to the length of a dwell

    Returns
    -------
    The corner, or None where its time is not known to 0.1 s.
    """
    wide, window = turn.window(4.0 * window), turn.window(window)
    near = float(seen) + corner.time - turn.middle
    rough = fit_corner(*_around(force, near, wide), near=near, window=wide, degree=2)
    if rough is None or not rough.time_error < _WORST_CORNER:
        return None
    pulled = fit_reversal(*_around(force, rough.time, window), near=rough.time, window=window)
    if pulled is None or not pulled.corner.time_error < _WORST_CORNER:
        return None
    return pulled


def _around(signal: Signal, at: float, window: float) -> tuple[Floats, Floats]:
    span = slice(*np.searchsorted(signal.time, [at - window, at + window]))
    return signal.time[span], signal.values[span]


def _why_no_event(force: Signal, peaks: list[Turn], seen: Floats, pairs: int) -> str:
    """What to tell a person when no peak was found on both clocks."""
    start = float(np.nanmean(force.values[: max(1, len(force.values) // 100)]))
    if start - np.nanmin(force.values) > 2.0 * (np.nanmax(force.values) - start):
        return "the force falls where the clamp loads: look at the sign of calibration.gain"
    if pairs:
        return (
            f"{pairs} peaks of the motion lie at peaks of the force, but none of these is a "
            f"corner known to {_WORST_CORNER:g} s: noise or mains hum on the force?"
        )
    return f"{len(peaks)} peaks of the motion, {len(seen)} of the force, no pair"


def _repeat(
    bench: Bench, strokes: tuple[Stroke, ...], force: Signal, fit: ClockFit
) -> Repeat | None:
    """Lag from the second cycle to the last, seen on both clocks.

    The first cycle is left out: it is the one that deforms the specimen for the first time.
    """
    motion = bench.raw["travel"]
    cycles = [
        tuple(float(motion.time[index]) for index in (up.start, up.stop, down.stop))
        for up, down in pairwise(strokes)
        if up.sign > 0 > down.sign
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


def _consistent(bench: Bench, repeat: Repeat | None, fit: ClockFit) -> Repeat | None:
    """The lag of the repeated cycle, unless the corners contradict it: cycles need not be alike."""
    if repeat is None:
        return None
    expected = (1.0 + fit.drift) * repeat.motion
    error = float(np.hypot(repeat.error, fit.drift_interval.standard_error * repeat.motion))
    if abs(repeat.force - expected) <= _CONTRADICTED * error:
        return repeat
    message = (
        f"the force of the last cycle lies {repeat.force:.3f} s behind that of the second, the "
        f"turning points {expected:.3f} s: the cycles are not alike, and the turning points alone "
        "join the clocks"
    )
    bench.note("cycles_not_alike", Severity.INFO, "align", message)
    return None


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


def _judge(bench: Bench, fit: ClockFit, align: AlignTurningPoints) -> None:
    if fit.residual > align.max_residual:
        message = (
            f"the clocks agree to {1e3 * fit.residual:.3g} ms rms at the turning points, "
            f"the protocol allows {1e3 * align.max_residual:.3g} ms"
        )
        bench.doubt("clock", "alignment_residual", message, where="align")
    known_to = 0.5 * (fit.drift_interval.upper - fit.drift_interval.lower)
    if abs(fit.drift) - known_to > align.max_drift:  # more than chance would have it
        message = (
            f"the clocks drift by {1e6 * fit.drift:.4g} ppm, known to {1e6 * known_to:.3g} ppm, "
            f"the protocol allows {1e6 * align.max_drift:.4g} ppm"
        )
        bench.doubt("clock", "alignment_drift", message, where="align")
    if len(fit.event_times_motion) == 1:
        message = "only one turning point was seen by both: the drift is taken as zero"
        bench.doubt("clock", "alignment_one_event", message, where="align")
