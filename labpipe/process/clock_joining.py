"""Join the clock of the force to that of the motion: by turns, by a common start, or as stated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.errors import format_overrides
from labpipe.process.motion import (
    Motion,
    check_turns,
    find_motion_turns,
    find_turn_events,
    match_strokes,
    orient_force,
)
from labpipe.process.zeros import average_whole_blocks
from labpipe.protocol import schema
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import ClockFit
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding
from labpipe.records.signals import Signal, Signals
from labpipe.signal import clock_alignment
from labpipe.signal.clock_alignment import Repeat, make_clock_fit, solve_weighted
from labpipe.signal.turning_points import find_sharpest_turn
from labpipe.uncertainty.noise_model import compute_drift_modes


def join_clocks(
    signals: Signals, align: schema.Align, motion: Motion
) -> tuple[ClockFit | None, Motion, list[Finding]]:
    """Join the clock of the force to that of the motion by the method of the protocol.

    Parameters
    ----------
    signals : raw, with the channel that shows the turns
    align : of the protocol
    motion : with its strokes

    Returns
    -------
    The fit, None if there is none; the motion with its turns; the findings.
    """
    if not motion.strokes or isinstance(align, schema.AlignNone):
        return None, motion, []
    force = signals.raw[align.channel or signals.force]
    is_by_turns = isinstance(align, schema.AlignTurningPoints)
    if not is_by_turns and force.clock == signals.raw[signals.displacement].clock:
        return None, motion, []
    motion = replace(motion, turns=find_motion_turns(motion, window=align.motion_window))
    fit: ClockFit | None
    if isinstance(align, schema.AlignStated):
        fit, findings = use_stated_clocks(force, align, motion)
    elif isinstance(align, schema.AlignCommonStart):
        fit, findings = fit_common_start(force, align, motion)
    else:
        fit, findings = fit_turning_points(force, align, motion)
    for_clock = not isinstance(align, schema.AlignStated)
    return fit, motion, [*findings, *check_turns(motion, for_clock=for_clock)]


def fit_turning_points(
    force: Signal, align: schema.AlignTurningPoints, motion: Motion
) -> tuple[ClockFit | None, list[Finding]]:
    """Fit the clock of the force to that of the motion at the peaks in both records.

    Parameters
    ----------
    force : the raw channel that joins the clocks
    align : windows and limits of the protocol
    motion : with its turns

    Returns
    -------
    The fit, or None if there is none, and the findings.
    """
    if findings := _check_constant(force, align.channel):
        return None, findings
    force = orient_force(force)
    pairs, is_ambiguous, counted = match_strokes(motion, force, sign=1)
    events = find_turn_events(force, pairs, motion, align.force_window)
    if not events.size:
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
    if events.shape[1] > 2 and not _has_relaxation(force, motion, fit):
        repeat, repeat_findings = _check_repeat(_measure_repeat(motion, force, fit), fit)
        fit, findings = _fit_events(events, repeat), [*findings, *repeat_findings]
    return fit, [*findings, *_check_fit(fit, align)]


def _check_constant(force: Signal, channel: str) -> list[Finding]:
    """Report a constant force, which has no turn."""
    if np.nanmax(force.values) > np.nanmin(force.values):
        return []
    level, unit = float(np.nanmean(force.values)), force.unit
    return [
        Finding.of(
            "process.constant_channel",
            channel,
            blocks=True,
            channel=channel,
            level=level,
            unit=unit,
        )
    ]


def _measure_repeat(motion: Motion, force: Signal, fit: ClockFit) -> Repeat | None:
    """Measure the lag from the second cycle to the last on both clocks.

    The first cycle is omitted, because it deforms the specimen for the first time.
    """
    trim = 1.0  # s, omitted at both ends of a cycle
    moved, tops = motion.signal, {turn.stroke: turn.middle for turn in motion.turns}
    cycles = [
        (float(moved.time[up.start]) + trim, tops[number], float(moved.time[down.stop]) - trim)
        for number, (up, down) in enumerate(pairwise(motion.strokes))
        if up.sign > 0 > down.sign and number in tops
    ]
    if len(cycles) < 3:
        return None
    start, turn, stop = cycle = cycles[1]
    guess = cycles[-1][1] - turn
    lag = clock_alignment.fit_lag(moved.time, moved.values, cycle, guess=guess, hysteresis=False)
    cycle = fit.to_force_time(start), fit.to_force_time(turn), fit.to_force_time(stop)
    guess = guess * (1.0 + fit.drift)
    fit_force = partial(clock_alignment.fit_lag, cycle=cycle, guess=guess, hysteresis=True)
    force_lag = fit_force(force.time, force.values)
    if isinstance(lag, Failure) or isinstance(force_lag, Failure):
        return None
    drift = force.zero_drift * float(np.nanmax(np.abs(force.values)))
    time, values = (average_whole_blocks(x, 50_000) for x in (force.time, force.values))
    waves = compute_drift_modes(time - time[0], drift)
    shifts = [values, *(values + wave for wave in waves)] if waves else []
    shifted = [fit_force(time, shift) for shift in shifts]
    lags = [x.value for x in shifted if not isinstance(x, Failure)]
    drift_error = float(np.linalg.norm(np.subtract(lags[1:], lags[0]))) if lags else 0.0
    error = float(np.hypot(lag.error, force_lag.error))
    return Repeat(lag.value, force_lag.value, error, drift_error)


def _has_relaxation(force: Signal, motion: Motion, fit: ClockFit) -> bool:
    """Check whether the force relaxes in the dwells; cycles are then not comparable."""
    # Share of the range that the force may lose in a dwell: at 0.04 the fitted drift of the clocks
    # was wrong by two standard errors.
    max_relaxation_share = 0.01
    losses = [0.0]
    for turn in motion.turns:
        start, stop = (fit.to_force_time(x.time) for x in (turn.arrival, turn.departure))
        inside = start + np.array([[0.1, 0.35], [0.65, 0.9]]) * (stop - start)
        parts = [force.values[slice(*np.searchsorted(force.time, part))] for part in inside]
        if all(np.isfinite(part).any() for part in parts):
            losses.append(abs(float(np.nanmean(parts[0])) - float(np.nanmean(parts[1]))))
    span = float(np.nanmax(force.values) - np.nanmin(force.values))
    return max(losses) > max_relaxation_share * span


def _check_repeat(repeat: Repeat | None, fit: ClockFit) -> tuple[Repeat | None, list[Finding]]:
    """Return the lag of the repeated cycle, unless the turning points contradict it."""
    max_lag_difference = 4.0  # standard errors
    if repeat is None:
        return None, []
    later, expected = repeat.force, (1.0 + fit.drift) * repeat.motion
    error = float(np.hypot(repeat.error, fit.drift_interval.standard_error * repeat.motion))
    if abs(later - expected) <= max_lag_difference * error:
        return repeat, []
    return None, [Finding.of("process.cycles_not_alike", "align", later=later, expected=expected)]


def _fit_events(events: Floats, repeat: Repeat | None) -> ClockFit:
    """Fit clocks to events; their common error of shape is multiplied, as it does not average."""
    motion, force, errors, shape_errors = events
    errors = np.hypot(errors, sqrt(len(errors) - 1) * shape_errors)
    method = "turning points: lines through the travel, smooth pieces of the force"
    method = method if repeat is None else f"{method}; lag of the repeated cycle"
    return clock_alignment.fit_clocks(motion, force, errors, method=method, repeat=repeat)


def _check_fit(fit: ClockFit, align: schema.AlignTurningPoints) -> Iterator[Finding]:
    # Allowed rms residual over the rms error of the turning points: a noisy turn only widens the
    # interval of the offset.
    chance_factor = 2.0
    chance = chance_factor * float(np.sqrt(np.mean(fit.event_errors**2)))
    if fit.residual > max(align.max_residual, chance):
        residual, allowed = 1e3 * fit.residual, 1e3 * align.max_residual
        yield Finding.of(
            "process.alignment_residual", "align", "clock", residual=residual, allowed=allowed
        )
    half_width = 0.5 * (fit.drift_interval.upper - fit.drift_interval.lower)
    if abs(fit.drift) - half_width > align.max_drift:  # beyond its uncertainty
        # clocks are accurate to parts per million: these may be recordings of two tests
        yield Finding.of(
            "process.alignment_drift",
            "align",
            *("clock", "displacement", "force"),
            drift=1e6 * fit.drift,
            half_width=1e6 * half_width,
            allowed=1e6 * align.max_drift,
        )
    if len(fit.event_times_motion) == 1:
        yield Finding.of("process.alignment_one_event", "align", "clock")


def use_stated_clocks(
    force: Signal, align: schema.AlignStated, motion: Motion
) -> tuple[ClockFit, list[Finding]]:
    """Use the stated offset between the clocks of force and motion.

    Parameters
    ----------
    force : the raw channel, whose peaks should be at the turns
    align : offset, drift, uncertainty and reason of the protocol
    motion : with its strokes

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
    error, assumed = align.uncertainty, ""
    if error is None:
        error = max(median(np.diff(signal.time)) for signal in (motion.signal, force))
        assumed = " (one sample, as none is stated)"
    events = np.array([[0.0], [align.offset], [error]])
    drift, method = (align.drift, max_rate_difference / sqrt(3.0)), f"stated: {align.because}"
    fit = make_clock_fit((align.offset, error), drift, events, method)
    note = Finding.of(
        "process.clocks_stated",
        "align",
        offset=align.offset,
        error=error,
        drift=1e6 * align.drift,
        because=align.because,
        assumed=assumed,
    )
    return fit, [note, *_check_stated_offset(force, fit, motion)]


def _check_stated_offset(force: Signal, fit: ClockFit, motion: Motion) -> Iterator[Finding]:
    """Report a stated offset with which the force peaks long before or after the motion turns."""
    smoothing, peak_share = 0.5, 0.3  # s; share of the largest peak
    max_peak_lag, lag_error_factor = 1.0, 3.0  # s; standard errors of the stated offset
    force, time = orient_force(force), motion.signal.time
    peaks = clock_alignment.find_rough_peaks(
        force.time, force.values, smoothing=smoothing, share=peak_share
    )
    ends = [time[[before.stop, after.start]] for before, after in pairwise(motion.strokes)]
    tops = [fit.to_force_time(end) for end in ends[::2]]  # of the strokes that load
    lags = [
        max(0.0, float(np.abs(peaks - top.mean()).min()) - 0.5 * float(np.ptp(top)))
        for top in (tops if len(peaks) else ())
        if force.time[0] <= top[0] and top[1] <= force.time[-1]
    ]
    lag, error = median(np.array(lags)) if lags else 0.0, float(fit.event_errors[0])
    if lag > max_peak_lag + lag_error_factor * error:
        yield Finding.of("process.clocks_stated_wrong", "align", "clock", "force", lag=lag)


def fit_common_start(
    force: Signal, align: schema.AlignCommonStart, motion: Motion
) -> tuple[ClockFit, list[Finding]]:
    """Fit the clock of the force to that of the motion if one trigger started both recorders.

    Parameters
    ----------
    force : the raw channel that shows the turns
    align : channel and limits of the protocol
    motion : with its turns

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
    findings, force = _check_constant(force, align.channel), orient_force(force)
    pairs = _find_rough_turns(motion, force, align)
    events = find_turn_events(force, pairs, motion, align.force_window)[:3]
    lags, weights = events[1] - events[0], events[2] ** -2.0
    lag = float(np.average(lags, weights=weights)) if len(lags) else 0.0
    lag_error = float(weights.sum() ** -0.5) if len(lags) else 0.0
    is_together = abs(lag) - 1.96 * lag_error <= align.max_offset
    fit, channel = _fit_common_start_clock(events, align, is_together), align.channel
    within = 1e3 * align.max_offset
    if not len(lags):
        note = Finding.of("process.start_unchecked", "align", channel=channel, within=within)
        return fit, [*findings, note]
    note = Finding.of(
        "process.common_start" if is_together else "process.not_started_together",
        "align",
        *(() if is_together else ("clock", "force")),
        channel=channel,
        later=1e3 * lag,
        known_to=1.96e3 * lag_error,
        within=within,
        offset=1e3 * fit.offset,
    )
    return fit, [*findings, note]


def _find_rough_turns(
    motion: Motion, force: Signal, align: schema.AlignCommonStart
) -> list[tuple[int, float]]:
    """Pair the strokes that load with the rough times at which the force turns."""
    strokes = motion.strokes
    if sum(stroke.sign == strokes[0].sign for stroke in strokes[:-1]) == 1:
        turn_time = find_sharpest_turn(force.time, force.values, width=align.force_window)
        return [] if turn_time is None else [(0, turn_time)]
    return match_strokes(motion, force, sign=strokes[0].sign)[0]


def _fit_common_start_clock(
    events: Floats, align: schema.AlignCommonStart, is_together: bool
) -> ClockFit:
    motion, force, errors = events
    start_error, drift_error = align.max_offset / sqrt(3.0), align.max_drift / sqrt(3.0)
    design = np.column_stack([np.ones_like(motion), motion])
    bounds = [([0.0, 1.0], drift_error)]
    bounds += [([1.0, 0.0], start_error)] if is_together else []
    design = np.vstack([design, *(row for row, _ in bounds)])
    differences = np.append(force - motion, np.zeros(len(bounds)))
    spread = np.append(errors, [error for _, error in bounds])
    (offset, drift), covariance = solve_weighted(design, differences, spread)
    offset_error, drift_error = np.sqrt(np.diag(covariance)).tolist()
    if not len(errors):  # the trigger
        events = np.array([[0.0], [0.0], [start_error]])
    basis = "the force's corner at the turn"
    basis = f"common start and {basis}" if is_together else f"{basis} alone"
    method = f"{basis}, drift taken as zero within a bound"
    return make_clock_fit((offset, offset_error), (drift, drift_error), events, method)
