"""Joining the clock of the force to the clock of the motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from labpipe.fitting.corners import Corner, fit_corner
from labpipe.fitting.estimates import Failure
from labpipe.fitting.repeats import fit_lag
from labpipe.pipeline.bench import Bench, Signal
from labpipe.processing.alignment import Repeat, fit_clocks, match_peaks, rough_peaks
from labpipe.processing.strokes import Stroke
from labpipe.protocol.rig import AlignTurningPoints
from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit

_TRIM = 1.0
"""s at both ends of a cycle that are left out of a comparison of cycles."""
_WORST_CORNER = 0.1
"""s; a corner of the force known no better than this says nothing about a clock."""


def turning_corners(
    motion: Signal, strokes: tuple[Stroke, ...], *, window: float
) -> dict[int, Corner]:
    """Find when a motion turns, by straight lines on both sides.

    Parameters
    ----------
    motion : the travel on its own clock
    strokes : of that motion
    window : s on each side, cut to the length of the strokes

    Returns
    -------
    By the number of the stroke that ends there. Turns with a dwell, or without a clear corner, are
    left out.
    """
    corners = {}
    for number, (before, after) in enumerate(pairwise(strokes)):
        if before.stop != after.start:
            continue
        ends = motion.time[[before.start, before.stop, after.stop]]
        reach = min(window, 0.95 * float(np.diff(ends).min()))
        near = float(ends[1])
        corner = fit_corner(motion.time, motion.values, near=near, window=reach, degree=1)
        if corner is not None and np.isfinite(corner.time_error):
            corners[number] = corner
    return corners


def align_clocks(
    bench: Bench,
    align: AlignTurningPoints,
    strokes: tuple[Stroke, ...],
    corners: dict[int, Corner],
) -> ClockFit | None:
    """Fit the force's clock to the motion's, from the peaks that both have seen.

    Parameters
    ----------
    bench : its raw force is used; gets notes, doubts, and what blocks it
    align : windows and limits of the protocol
    strokes, corners : of the motion

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
    peaks = [corner for number, corner in corners.items() if strokes[number].sign > 0]
    seen = rough_peaks(force.time, force.values, smoothing=0.5, share=0.3)
    pairs, is_ambiguous = match_peaks(np.array([peak.time for peak in peaks]), seen)
    events = [
        (peaks[first], corner)
        for first, second in pairs.tolist()
        if (corner := _force_corner(force, float(seen[second]), align.force_window)) is not None
    ]
    if not events:
        message = f"{len(peaks)} peaks of the motion, {len(seen)} of the {align.channel}, no pair"
        bench.block("no_common_peak", message, where="align")
        return None
    if is_ambiguous:
        message = "another pairing of the peaks fits as well; the smaller offset was taken"
        bench.doubt("clock", "alignment_ambiguous", message, where="align")
    fit = _fitted(events, None)
    if len(events) > 2:
        fit = _fitted(events, _repeat(bench, strokes, force, fit))
    _judge(bench, fit, align)
    return fit


def _force_corner(force: Signal, near: float, window: float) -> Corner | None:
    """Corner of the force near a rough guess, then again in a window that lies around it."""
    corner = None
    for _ in range(2):
        span = slice(*np.searchsorted(force.time, [near - window, near + window]))
        time, values = force.time[span], force.values[span]
        corner = fit_corner(time, values, near=near, window=window, degree=2)
        if corner is None or not corner.time_error < _WORST_CORNER:
            return None
        near = corner.time
    return corner


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
        if up.sign > 0 and up.stop == down.start
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


def _fitted(events: list[tuple[Corner, Corner]], repeat: Repeat | None) -> ClockFit:
    def column(values: list[float]) -> Floats:
        return np.array(values, dtype=np.float64)

    method = "turning points: lines through the travel, parabolas through the force"
    return fit_clocks(
        column([motion.time for motion, _ in events]),
        column([force.time for _, force in events]),
        column([float(np.hypot(a.time_error, b.time_error)) for a, b in events]),
        method=method if repeat is None else f"{method}; lag of the repeated cycle",
        repeat=repeat,
    )


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
