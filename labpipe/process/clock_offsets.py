"""Two recorders whose offset is known beforehand: started together, or stated by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.process.clock_joining import match_strokes, turn_event
from labpipe.process.motion_turns import Turn
from labpipe.protocol.schema import AlignCommonStart, AlignStated
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.quality import Finding, blocking, doubtful, worth_knowing
from labpipe.records.signals import Signal
from labpipe.signal.clock_alignment import rough_peaks
from labpipe.signal.corners import Corner
from labpipe.signal.reversals import Reversal
from labpipe.signal.turning_points import Stroke, goes_down, sharpest_turn

_RATE = 1e-4
"""How far two recorders may differ in rate that nobody has compared."""
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
    note = worth_knowing("clocks_stated", "align", message)
    return fit, [note, *_contradicted(force, fit, motion, strokes)]


def _contradicted(
    force: Signal, fit: ClockFit, motion: Signal, strokes: tuple[Stroke, ...]
) -> Iterator[Finding]:
    """Doubt a statement by which the force peaks long before or after the motion turns."""
    if not strokes or not np.nanmax(force.values) > np.nanmin(force.values):
        return
    if goes_down(force.values):  # a reversed bridge turns when any other does
        force = replace(force, values=-force.values)
    peaks = rough_peaks(force.time, force.values, smoothing=_SMOOTH, share=_SHARE)
    if not len(peaks):
        return
    ends = [motion.time[[before.stop, after.start]] for before, after in pairwise(strokes)]
    tops = [fit.to_force_time(end) for end in ends[::2]]  # of the strokes that load
    off = [
        max(0.0, float(np.abs(peaks - top.mean()).min()) - 0.5 * float(np.ptp(top)))
        for top in tops
        if force.time[0] <= top[0] and top[1] <= force.time[-1]
    ]
    known_to = float(fit.event_errors[0])
    if not off or median(np.array(off)) <= _FAR + _SURELY * known_to:
        return
    message = (
        f"by the stated offset the force peaks {median(np.array(off)):.2f} s away from where the "
        "motion turns: look at its sign (time of the force less time of the motion) and at the "
        "files"
    )
    yield doubtful(*("clock", "force"), code="clocks_stated_wrong", message=message, where="align")


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
    if not np.nanmax(force.values) > np.nanmin(force.values):
        message = (
            f"the {align.channel} is constant at {float(np.nanmean(force.values)):.6g} "
            f"{force.unit}: is it the right channel, and is the cell connected?"
        )
        found.append(blocking("constant_channel", align.channel, message))
    seen = _seen(force, align, motion, strokes, turns)
    at_turn = _weighted(seen)
    together = at_turn is None or abs(at_turn[0]) - 1.96 * at_turn[1] <= align.max_offset
    fit = _fitted(seen, align, together=together)
    return fit, [*found, _finding(fit, align, at_turn, together=together)]


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
        return worth_knowing("start_unchecked", "align", message)
    known, apart = 1.96e3 * at_turn[1], abs(at_turn[0])
    far = f"{apart:.2f} s" if apart > 1.0 else f"{1e3 * apart:.4g} ms"
    said = (
        f"the {align.channel} turns {far} "
        f"{'after' if at_turn[0] >= 0.0 else 'before'} the motion, known to {known:.2g} ms"
    )
    if together:
        message = f"{said}; started together, so {1e3 * fit.offset:.4g} ms is taken at the start"
        return worth_knowing("common_start", "align", message)
    message = (
        f"{said}: the recorders did not start within {1e3 * align.max_offset:.3g} ms of each "
        "other; the difference at the turn is taken"
    )
    return doubtful(
        *("clock", "force"), code="not_started_together", message=message, where="align"
    )
