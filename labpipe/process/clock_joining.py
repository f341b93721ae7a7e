"""Join the clock of the force to that of the motion: by turns, by a common start, or as stated."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from math import sqrt
from typing import assert_never

import numpy as np

from labpipe.errors import format_overrides
from labpipe.process.motion import (
    Turn,
    check_turns,
    find_motion_turns,
    find_turn_events,
    match_strokes,
    orient_force,
)
from labpipe.process.zeros import average_whole_blocks
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
from labpipe.records.quality import Finding
from labpipe.records.signals import Signal, Signals
from labpipe.signal.clock_alignment import Repeat, find_rough_peaks, fit_clocks, fit_lag
from labpipe.signal.corners import Corner
from labpipe.signal.reversals import Reversal
from labpipe.signal.turning_points import Stroke, find_sharpest_turn
from labpipe.uncertainty.noise_model import compute_drift_modes


def join_clocks(
    signals: Signals, align: Align, motion: Signal, strokes: tuple[Stroke, ...]
) -> tuple[ClockFit | None, list[Turn], list[Finding]]:
    """Join the clock of the force to that of the motion by the method of the protocol.

    Parameters
    ----------
    signals : raw, with the channel that shows the turns
    align : of the protocol
    motion, strokes : the travel and its strokes

    Returns
    -------
    The fit, None if there is none; the turns of the motion; the findings.
    """
    if not strokes or isinstance(align, AlignNone):
        return None, [], []
    force = signals.raw[align.channel or signals.force]
    is_by_turns = isinstance(align, AlignTurningPoints)
    if not is_by_turns and force.clock == signals.raw[signals.displacement].clock:
        return None, [], []
    turns = find_motion_turns(motion, strokes, window=align.motion_window)
    fit: ClockFit | None
    match align:
        case AlignStated():
            fit, findings = use_stated_clocks(force, align, motion, strokes)
        case AlignCommonStart():
            fit, findings = fit_common_start(force, align, motion, strokes, turns)
        case AlignTurningPoints():
            fit, findings = fit_turning_points(force, align, motion, strokes, turns)
        case _ as never:
            assert_never(never)
    for_clock = not isinstance(align, AlignStated)
    return fit, turns, [*findings, *check_turns(motion, strokes, turns, for_clock=for_clock)]


def fit_turning_points(
    force: Signal,
    align: AlignTurningPoints,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> tuple[ClockFit | None, list[Finding]]:
    """Fit the clock of the force to that of the motion at the peaks in both records.

    Parameters
    ----------
    force : the raw channel that joins the clocks
    align : windows and limits of the protocol
    motion, strokes, turns : the travel, its strokes, and the turns between them

    Returns
    -------
    The fit, or None if there is none, and the findings.
    """
    if _is_constant(force):
        return None, [_report_constant_force(force, align.channel)]
    force, findings = orient_force(force), list[Finding]()
    pairs, is_ambiguous, counted = match_strokes(motion, force, strokes, sign=1)
    events = find_turn_events(force, pairs, turns, align.force_window)
    if not events:
        error = Finding.of(
            "process.no_common_peak" if pairs else "process.no_pair_of_peaks",
            "align",
            blocks=True,
            counted=counted,
        )
        return None, [error]
    if is_ambiguous:
        state = format_overrides("align", "{method: stated, offset: ...}")
        findings.append(
            Finding.of(
                "process.alignment_ambiguous", "align", "clock", counted=counted, state=state
            )
        )
    fit = _fit_events(events, None)
    if len(events) > 2 and not _has_relaxation(force, turns, fit):
        repeat, repeat_findings = _check_repeat(
            _measure_repeat(motion, strokes, turns, force, fit), fit
        )
        fit, findings = _fit_events(events, repeat), [*findings, *repeat_findings]
    return fit, [*findings, *_check_fit(fit, align)]


def _is_constant(force: Signal) -> bool:
    return not np.nanmax(force.values) > np.nanmin(force.values)


def _report_constant_force(force: Signal, channel: str) -> Finding:
    level = float(np.nanmean(force.values))
    return Finding.of(
        "process.constant_channel",
        channel,
        blocks=True,
        channel=channel,
        level=level,
        unit=force.unit,
    )


def _measure_repeat(
    motion: Signal, strokes: tuple[Stroke, ...], turns: list[Turn], force: Signal, fit: ClockFit
) -> Repeat | None:
    """Measure the lag from the second cycle to the last on both clocks.

    The first cycle is omitted, because it deforms the specimen for the first time.
    """
    trim = 1.0  # s, omitted at both ends of a cycle
    top_times = {turn.stroke: turn.middle for turn in turns}
    cycles = [
        (float(motion.time[up.start]), top_times[number], float(motion.time[down.stop]))
        for number, (up, down) in enumerate(pairwise(strokes))
        if up.sign > 0 > down.sign and number in top_times
    ]
    if len(cycles) < 3:
        return None
    (start, turn, stop), last = cycles[1], cycles[-1]
    start, stop, guess = start + trim, stop - trim, last[1] - turn
    moved = fit_lag(
        motion.time,
        motion.values,
        start=start,
        turn=turn,
        stop=stop,
        guess=guess,
        hysteresis=False,
    )
    begin, top, end = (fit.to_force_time(time) for time in (start, turn, stop))
    fit_force_lag = partial(
        fit_lag,
        start=begin,
        turn=top,
        stop=end,
        guess=guess * (1.0 + fit.drift),
        hysteresis=True,
    )
    force_lag = fit_force_lag(force.time, force.values)
    if isinstance(moved, Failure) or isinstance(force_lag, Failure):
        return None
    error = float(np.hypot(moved.error, force_lag.error))
    drift = force.zero_drift * float(np.nanmax(np.abs(force.values)))
    time, values = (average_whole_blocks(x, 50_000) for x in (force.time, force.values))
    waves = compute_drift_modes(time - time[0], drift)
    lags = (
        [fit_force_lag(time, values + wave) for wave in (np.zeros_like(time), *waves)]
        if waves
        else []
    )
    lag_values = [lag.value for lag in lags if not isinstance(lag, Failure)]
    drift_error = (
        float(np.linalg.norm(np.subtract(lag_values[1:], lag_values[0]))) if lag_values else 0.0
    )
    return Repeat(moved.value, force_lag.value, error, drift_error)


def _has_relaxation(force: Signal, turns: list[Turn], fit: ClockFit) -> bool:
    """Check whether the force relaxes in the dwells; cycles are then not comparable."""
    # Share of the range that the force may lose in a dwell: at 0.04 the fitted drift of the clocks
    # was wrong by two standard errors.
    max_relaxation_share = 0.01
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
    return max(abs(before - after) for before, after in levels) > max_relaxation_share * span


def _check_repeat(repeat: Repeat | None, fit: ClockFit) -> tuple[Repeat | None, list[Finding]]:
    """Return the lag of the repeated cycle, unless the turning points contradict it."""
    max_lag_difference = 4.0  # standard errors
    if repeat is None:
        return None, []
    expected = (1.0 + fit.drift) * repeat.motion
    error = float(np.hypot(repeat.error, fit.drift_interval.standard_error * repeat.motion))
    if abs(repeat.force - expected) <= max_lag_difference * error:
        return repeat, []
    later = repeat.force
    return None, [Finding.of("process.cycles_not_alike", "align", later=later, expected=expected)]


def _fit_events(events: list[tuple[Corner, Reversal]], repeat: Repeat | None) -> ClockFit:
    method = "turning points: lines through the travel, smooth pieces of the force"
    return fit_clocks(
        *_tabulate_events(events, shape_errors=len(events) - 1),
        method=method if repeat is None else f"{method}; lag of the repeated cycle",
        repeat=repeat,
    )


def _tabulate_events(events: list[tuple[Corner, Reversal]], *, shape_errors: int) -> Floats:
    """Return times on both clocks and the errors of their differences: shape (3, events), s.

    The shape error is common to all events of a specimen and does not average out; it is therefore
    multiplied by the square root of `shape_errors`.
    """
    rows = [
        (
            motion_event.time,
            force_event.corner.time,
            np.hypot(
                np.hypot(motion_event.time_error, force_event.corner.time_error),
                np.sqrt(shape_errors) * force_event.shape_error if shape_errors else 0.0,
            ),
        )
        for motion_event, force_event in events
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 3).T


def _check_fit(fit: ClockFit, align: AlignTurningPoints) -> Iterator[Finding]:
    # Allowed rms residual over the rms error of the turning points: a noisy turn only widens the
    # interval of the offset.
    chance_factor = 2.0
    chance = chance_factor * float(np.sqrt(np.mean(fit.event_errors**2)))
    if fit.residual > max(align.max_residual, chance):
        yield Finding.of(
            "process.alignment_residual",
            "align",
            "clock",
            residual=1e3 * fit.residual,
            allowed=1e3 * align.max_residual,
        )
    half_width = 0.5 * (fit.drift_interval.upper - fit.drift_interval.lower)
    if abs(fit.drift) - half_width > align.max_drift:  # beyond its uncertainty
        # clocks are accurate to parts per million: these may be recordings of two tests
        yield Finding.of(
            "process.alignment_drift",
            "align",
            "clock",
            "displacement",
            "force",
            drift=1e6 * fit.drift,
            half_width=1e6 * half_width,
            allowed=1e6 * align.max_drift,
        )
    if len(fit.event_times_motion) == 1:
        yield Finding.of("process.alignment_one_event", "align", "clock")


def use_stated_clocks(
    force: Signal, align: AlignStated, motion: Signal, strokes: tuple[Stroke, ...]
) -> tuple[ClockFit, list[Finding]]:
    """Use the stated offset between the clocks of force and motion.

    Parameters
    ----------
    force : the raw channel, whose peaks should be at the turns
    align : offset, drift, uncertainty and reason of the protocol
    motion, strokes : on the clock of the motion

    Returns
    -------
    The fit, with the stated offset as its only event; a note, and a doubt if the force peaks
    elsewhere.

    Notes
    -----
    The default uncertainty of the offset is one sample of the slower recorder. That of the drift
    is 100 ppm / sqrt(3), a rectangular distribution (GUM, JCGM 100:2008, sec. 4.3.7).
    """
    max_rate_difference = 1e-4  # between two recorders that were never compared
    error = align.uncertainty
    if error is None:
        error = max(median(np.diff(motion.time)), median(np.diff(force.time)))
    fit = ClockFit(
        offset=align.offset,
        drift=align.drift,
        offset_interval=Interval.normal_95(align.offset, error),
        drift_interval=Interval.normal_95(align.drift, max_rate_difference / sqrt(3.0)),
        residual=0.0,
        event_times_motion=np.zeros(1),
        event_times_force=np.full(1, align.offset),
        event_errors=np.full(1, error),
        method=f"stated: {align.because}",
    )
    note = Finding.of(
        "process.clocks_stated",
        "align",
        offset=align.offset,
        error=error,
        drift=1e6 * align.drift,
        because=align.because,
        assumed="" if align.uncertainty is not None else " (one sample, as none is stated)",
    )
    return fit, [note, *_check_stated_offset(force, fit, motion, strokes)]


def _check_stated_offset(
    force: Signal, fit: ClockFit, motion: Signal, strokes: tuple[Stroke, ...]
) -> Iterator[Finding]:
    """Report a stated offset with which the force peaks long before or after the motion turns."""
    smoothing, peak_share = 0.5, 0.3  # s; share of the largest peak
    max_peak_lag, lag_error_factor = 1.0, 3.0  # s; standard errors of the stated offset
    if not strokes or _is_constant(force):
        return
    force = orient_force(force)
    peaks = find_rough_peaks(force.time, force.values, smoothing=smoothing, share=peak_share)
    if not len(peaks):
        return
    ends = [motion.time[[before.stop, after.start]] for before, after in pairwise(strokes)]
    top_times = [fit.to_force_time(end) for end in ends[::2]]  # of the strokes that load
    lags = [
        max(0.0, float(np.abs(peaks - top.mean()).min()) - 0.5 * float(np.ptp(top)))
        for top in top_times
        if force.time[0] <= top[0] and top[1] <= force.time[-1]
    ]
    error = float(fit.event_errors[0])
    lag = median(np.array(lags)) if lags else 0.0
    if lag > max_peak_lag + lag_error_factor * error:
        yield Finding.of("process.clocks_stated_wrong", "align", "clock", "force", lag=lag)


def fit_common_start(
    force: Signal,
    align: AlignCommonStart,
    motion: Signal,
    strokes: tuple[Stroke, ...],
    turns: list[Turn],
) -> tuple[ClockFit, list[Finding]]:
    """Fit the clock of the force to that of the motion if one trigger started both recorders.

    Parameters
    ----------
    force : the raw channel that shows the turns
    align : channel and limits of the protocol
    motion, strokes, turns : the travel, its strokes, and the turns between them

    Returns
    -------
    The fit and the findings; the clocks are doubtful if the recorders did not start together.

    Notes
    -----
    Offset and drift are a weighted least-squares fit to three kinds of equations: offset = 0 with
    the standard uncertainty max_offset / sqrt(3) of a rectangular distribution; drift = 0 with that
    of max_drift (GUM, JCGM 100:2008, sec. 4.3.7); and the difference of times at every turn. If the
    turns contradict the common start by more than their own 95 % interval, the start is left out
    and the clocks are doubtful.
    """
    findings: list[Finding] = []
    if _is_constant(force):
        findings.append(_report_constant_force(force, align.channel))
    force = orient_force(force)
    pairs = _find_rough_turns(motion, force, strokes, align)
    events = find_turn_events(force, pairs, turns, align.force_window)
    shared_turns = _tabulate_events(events, shape_errors=0)
    lag_at_turns = _average_lag(shared_turns)
    started_together = (
        lag_at_turns is None or abs(lag_at_turns[0]) - 1.96 * lag_at_turns[1] <= align.max_offset
    )
    fit = _fit_common_start_clock(shared_turns, align, started_together=started_together)
    return fit, [
        *findings,
        _report_start(fit, align, lag_at_turns, started_together=started_together),
    ]


def _find_rough_turns(
    motion: Signal, force: Signal, strokes: tuple[Stroke, ...], align: AlignCommonStart
) -> list[tuple[int, float]]:
    """Pair the strokes that load with the rough times at which the force turns."""
    loads = [stroke.sign == strokes[0].sign for stroke in strokes[:-1]]
    if sum(loads) == 1:
        turn_time = find_sharpest_turn(force.time, force.values, width=align.force_window)
        return [] if turn_time is None else [(0, turn_time)]
    return match_strokes(motion, force, strokes, sign=strokes[0].sign)[0]


def _average_lag(shared_turns: Floats) -> tuple[float, float] | None:
    """Return the mean difference at the turns and its standard error, s."""
    motion, force, errors = shared_turns
    if not len(errors):
        return None
    weights = errors**-2.0
    return float(np.average(force - motion, weights=weights)), float(weights.sum() ** -0.5)


def _fit_common_start_clock(
    shared_turns: Floats, align: AlignCommonStart, *, started_together: bool
) -> ClockFit:
    motion, force, spread = shared_turns
    design: Floats = np.vstack([np.column_stack([np.ones_like(motion), motion]), [0.0, 1.0]])
    differences = np.append(force - motion, 0.0)
    errors = np.append(spread, align.max_drift / sqrt(3.0))
    start_error = align.max_offset / sqrt(3.0)
    if started_together:
        design = np.vstack([design, [1.0, 0.0]])
        differences, errors = np.append(differences, 0.0), np.append(errors, start_error)
    weighted = design / errors[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    offset, drift = (float(value) for value in covariance @ weighted.T @ (differences / errors))
    offset_error, drift_error = (float(error) for error in np.sqrt(np.diag(covariance)))
    if not len(spread):  # the trigger
        motion, force, spread = np.zeros(1), np.zeros(1), np.array([start_error])
    residuals = force - offset - (1.0 + drift) * motion
    basis = "the force's corner at the turn"
    basis = f"common start and {basis}" if started_together else f"{basis} alone"
    return ClockFit(
        offset=offset,
        drift=drift,
        offset_interval=Interval.normal_95(offset, offset_error),
        drift_interval=Interval.normal_95(drift, drift_error),
        residual=float(np.sqrt(np.mean(residuals**2))),
        event_times_motion=motion,
        event_times_force=force,
        event_errors=spread,
        method=f"{basis}, drift taken as zero within a bound",
    )


def _report_start(
    fit: ClockFit,
    align: AlignCommonStart,
    lag_at_turns: tuple[float, float] | None,
    *,
    started_together: bool,
) -> Finding:
    channel, within = align.channel, 1e3 * align.max_offset
    if lag_at_turns is None:
        return Finding.of("process.start_unchecked", "align", channel=channel, within=within)
    return Finding.of(
        "process.common_start" if started_together else "process.not_started_together",
        "align",
        *(() if started_together else ("clock", "force")),
        channel=channel,
        later=1e3 * lag_at_turns[0],
        known_to=1.96e3 * lag_at_turns[1],
        within=within,
        offset=1e3 * fit.offset,
    )
