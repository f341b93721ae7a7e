"""Two recorders that were started together: their clocks, checked at the turn of the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.clocks import match_strokes, turn_event
from labpipe.pipeline.turns import Turn
from labpipe.protocol.schema import AlignCommonStart
from labpipe.records.arrays import Floats
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.quality import Severity
from labpipe.signal.corners import Corner
from labpipe.signal.reversals import Reversal
from labpipe.signal.turning_points import Stroke, goes_down, sharpest_turn


@dataclass(frozen=True, slots=True)
class Seen:
    """A turning point that both recorders have seen: their times, s, and the difference's error."""

    motion: float
    force: float
    error: float


def start_together(
    bench: Bench,
    align: AlignCommonStart,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> ClockFit:
    """Fit the force's clock to the motion's, both started by one trigger.

    Parameters
    ----------
    bench : its raw force is used; gets notes, and a doubt where the two did not start together
    align : channel and limits of the protocol
    motion, strokes, turns : the travel, its strokes, and the turns that were found between them

    Returns
    -------
    The fit.

    Notes
    -----
    Three kinds of evidence in one weighted least-squares fit of offset and drift: the common start
    says offset = 0 with the standard uncertainty max_offset / sqrt(3) of a rectangle, instruments
    say drift = 0 with that of max_drift (GUM, JCGM 100:2008, sec. 4.3.7), every corner of the force
    says what its difference to the turn of the motion is. A sharp corner so decides within the
    limits of the start, a blurred one leaves what the start says. Where the corner contradicts the
    start by more than its own 95 % interval, the start is left out and the clocks are doubtful.
    """
    level = bench.raw[align.channel].values
    if not np.nanmax(level) > np.nanmin(level):
        message = (
            f"the {align.channel} is constant at {float(np.nanmean(level)):.6g} "
            f"{bench.raw[align.channel].unit}: is it the right channel, and is the cell connected?"
        )
        bench.block("constant_channel", message, where=align.channel)
    seen = _seen(bench.raw[align.channel], align, motion, strokes, turns)
    at_turn = _weighted(seen)
    together = at_turn is None or abs(at_turn[0]) - 1.96 * at_turn[1] <= align.max_offset
    fit = _fitted(seen, align, together=together)
    _tell(bench, fit, align, at_turn, together=together)
    return fit


def _seen(
    force: Signal,
    align: AlignCommonStart,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> list[Seen]:
    """Turns at the top of loading that the force has seen as well."""
    if goes_down(force.values):  # a reversed bridge turns when any other does
        force = replace(force, values=-force.values)
    found = {turn.stroke: turn for turn in turns}
    return [
        _event(*event)
        for stroke, near in _paired(motion, force, strokes, align)
        if stroke in found
        and (event := turn_event(force, found[stroke], near, window=align.force_window)) is not None
    ]


def _paired(
    motion: Signal, force: Signal, strokes: tuple[Stroke, ...], align: AlignCommonStart
) -> list[tuple[int, float]]:
    """Strokes that end at the top of loading, and where the force roughly turns there."""
    loads = [each.sign == strokes[0].sign for each in strokes[:-1]]
    if sum(loads) == 1:
        near = sharpest_turn(force.time, force.values, width=align.force_window)
        return [] if near is None else [(0, near)]
    return match_strokes(motion, force, strokes, sign=strokes[0].sign)[0]


def _event(corner: Corner, pulled: Reversal) -> Seen:
    error = float(np.hypot(corner.time_error, pulled.corner.time_error))
    return Seen(corner.time, pulled.corner.time, error)


def _weighted(seen: list[Seen]) -> tuple[float, float] | None:
    """Mean difference at the turns and its standard error, s."""
    if not seen:
        return None
    weights = np.array([each.error for each in seen]) ** -2.0
    differences = np.array([each.force - each.motion for each in seen])
    return float(np.average(differences, weights=weights)), float(weights.sum() ** -0.5)


def _fitted(seen: list[Seen], align: AlignCommonStart, *, together: bool) -> ClockFit:
    design: Floats = np.array([[1.0, each.motion] for each in seen] + [[0.0, 1.0]])
    says = np.array([each.force - each.motion for each in seen] + [0.0])
    errors = np.array([each.error for each in seen] + [align.max_drift / sqrt(3.0)])
    if together:
        design = np.vstack([design, [1.0, 0.0]])
        says = np.append(says, 0.0)
        errors = np.append(errors, align.max_offset / sqrt(3.0))
    weighted = design / errors[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    offset, drift = (float(each) for each in covariance @ weighted.T @ (says / errors))
    offset_error, drift_error = (float(each) for each in np.sqrt(np.diag(covariance)))
    events = seen or [Seen(0.0, 0.0, align.max_offset / sqrt(3.0))]  # the trigger itself
    motion, force, spread = np.array([[e.motion, e.force, e.error] for e in events]).T
    left = force - offset - (1.0 + drift) * motion
    return ClockFit(
        offset=offset,
        drift=drift,
        offset_interval=Interval.normal_95(offset, offset_error),
        drift_interval=Interval.normal_95(drift, drift_error),
        residual=float(np.sqrt(np.mean(left**2))),
        event_times_motion=motion,
        event_times_force=force,
        event_errors=spread,
        method=_METHOD if together else _NOT_TOGETHER,
    )


_METHOD = "common start and the force's corner at the turn, drift taken as zero within a bound"
_NOT_TOGETHER = "the force's corner at the turn alone, drift taken as zero within a bound"


def _tell(
    bench: Bench,
    fit: ClockFit,
    align: AlignCommonStart,
    at_turn: tuple[float, float] | None,
    *,
    together: bool,
) -> None:
    if at_turn is None:
        message = (
            f"the {align.channel} shows no corner at a turn of the motion: the common start, "
            f"within {1e3 * align.max_offset:.3g} ms, is taken as it is"
        )
        bench.note("start_unchecked", Severity.INFO, "align", message)
        return
    known, apart = 1.96e3 * at_turn[1], abs(at_turn[0])
    far = f"{apart:.2f} s" if apart > 1.0 else f"{1e3 * apart:.4g} ms"
    said = (
        f"the {align.channel} turns {far} "
        f"{'after' if at_turn[0] >= 0.0 else 'before'} the motion, known to {known:.2g} ms"
    )
    if together:
        message = f"{said}; started together, so {1e3 * fit.offset:.4g} ms is taken at the start"
        bench.note("common_start", Severity.INFO, "align", message)
        return
    message = (
        f"{said}: the recorders did not start within {1e3 * align.max_offset:.3g} ms of each "
        "other; the difference at the turn is taken"
    )
    for quantity in ("clock", "force"):
        bench.doubt(quantity, "not_started_together", message, where="align")
