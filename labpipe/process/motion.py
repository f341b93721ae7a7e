"""Find the turning points of the motion, and align the clock of the force with that of the motion.

A stroke of the motion ends at a turn, which is a corner, or two corners with a dwell of the machine
between them. At the same time the force has a peak with a corner. A corner of the motion and the
simultaneous corner of the force are an event. Offset and drift of the clock of the force are fitted
to the events.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np

from labpipe.errors import format_overrides
from labpipe.protocol import schema
from labpipe.protocol.schema import Branches
from labpipe.records.arrays import Floats, average_blocks, compute_median_step, drop_missing, median
from labpipe.records.curve import Branch, ClockFit
from labpipe.records.estimates import Failure
from labpipe.records.quality import Doubt, Finding
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal import clock_alignment, turning_points
from labpipe.signal.clock_alignment import (
    CycleLag,
    find_rough_peaks,
    make_clock_fit,
    match_peaks,
    solve_weighted,
)
from labpipe.signal.corners import Corner, fit_corner, fit_reversal, fit_stop
from labpipe.signal.turning_points import Stroke, estimate_noise_level, find_sharpest_turn
from labpipe.uncertainty.noise_model import compute_drift_modes

CORNER_WIDTHS = (0.05, 0.25)
"""Widths of the stretches beside a turn in which deviations from straight lines are tested, s."""
MAX_CORNER_CUT = 5e-6
"""Largest distance by which a motion may round a corner, m."""
MAX_CORNER_TIME_ERROR = 0.1
"""Limit of the standard error of the time of a force corner that is used to align clocks, s."""


@dataclass(frozen=True, slots=True)
class Turn:
    """Turn of a motion, which is a corner, or two corners with a dwell between them.

    Parameters
    ----------
    stroke_index : index of the stroke that ends at the turn
    arrival, departure : corners at which the motion stops and starts again; the same corner if
        there is no dwell
    """

    stroke_index: int
    arrival: Corner
    departure: Corner

    @property
    def middle_time(self) -> float:
        """Return the mean of arrival and departure times, s."""
        return 0.5 * (self.arrival.time + self.departure.time)

    @property
    def dwell(self) -> float:
        """Return the time between arrival and departure, s."""
        return self.departure.time - self.arrival.time


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a test; fields of later stages are empty until they are found.

    Parameters
    ----------
    signal : channel whose turning points separate the branches
    branches : branches of the motion
    clocks : relations of the clocks of the recordings
    strokes : strokes of the motion
    turns : fitted turns between the strokes; empty if no clocks are aligned
    """

    signal: Signal
    branches: tuple[Branch, ...] = ()
    clocks: Clocks = field(default_factory=Clocks)
    strokes: tuple[Stroke, ...] = ()
    turns: tuple[Turn, ...] = ()


def find_motion_strokes(signal: Signal, settings: Branches) -> tuple[Motion, list[Finding]]:
    """Find the strokes of a motion.

    Parameters
    ----------
    signal : channel whose turning points separate the branches
    settings : name of the channel, and minimum stroke (m)

    Returns
    -------
    The motion with its strokes, and at most one finding, which blocks the curve. The finding
    reports that there are no strokes, or that noise hides them.
    """
    noise_factor = 5.0  # smallest allowed minimum stroke, in standard deviations of the noise
    time, values, min_stroke = signal.time, signal.values, settings.min_stroke
    noise = estimate_noise_level(values)
    if noise_factor * noise > min_stroke:
        facts: dict[str, Any] = {"noise": 1e3 * noise, "min_stroke": 1e3 * min_stroke}
        finding = Finding.of("process.motion_is_noise", settings.channel, is_blocking=True, **facts)
        return Motion(signal), [finding]
    strokes = turning_points.find_strokes(time, values, min_stroke=min_stroke)
    if strokes:
        return Motion(signal, strokes=strokes), []
    facts = {"range": 1e3 * float(np.nanmax(values) - np.nanmin(values))}
    finding = Finding.of("process.no_motion", settings.channel, is_blocking=True, **facts)
    return Motion(signal), [finding]


def find_motion_turns(motion: Motion, *, window: float) -> tuple[Turn, ...]:
    """Find the turns of a motion by fits of straight lines on both sides of each corner.

    Parameters
    ----------
    motion : motion with its strokes
    window : width of the fitted stretch on each side of a turn, s; at most 95 % of the shorter of
        the two strokes is fitted

    Returns
    -------
    The turns in order of time. Turns without a clear corner are omitted, as are turns around which
    more than 30 % of the samples within 0.5 s are missing.

    Notes
    -----
    At 1 mm/s, with 10 um of noise and 50 frames per second, a dwell of 80 ms is found at a single
    turn, and one of 50 ms in some tests with five turns. A dwell of up to three samples is treated
    as a corner, unless the machine dwells at every turn or the dwell separates the strokes.
    """
    # Noise causes an apparent dwell. A fitted dwell is real if its ratio to the apparent dwell is
    # above the first factor. The machine dwells at every turn if the median ratio of at least three
    # turns is above the second factor.
    min_dwell_factor, min_median_factor, min_turns = 2.4, 1.5, 3
    min_dwell_samples, min_apparent_dwell = 3, 1e-6  # s
    signal, time = motion.signal, motion.signal.time
    candidates = []
    for index, (stroke, next_stroke) in enumerate(pairwise(motion.strokes)):
        start, stop = time[[stroke.start, stroke.stop]].tolist()
        next_start, next_stop = time[[next_stroke.start, next_stroke.stop]].tolist()
        fit_width = min(window, 0.95 * min(stop - start, next_stop - next_start))
        turn_fit = _fit_turn(signal, index, (stop, next_start), fit_width)
        if turn_fit is not None:
            dwell_turn = turn_fit[1]
            apparent_dwell = _estimate_apparent_dwell(signal, dwell_turn) if dwell_turn else 0.0
            candidates.append((*turn_fit, apparent_dwell))
    ratios = [
        turn.dwell / max(apparent_dwell, min_apparent_dwell) if turn else 0.0
        for _, turn, apparent_dwell in candidates
    ]
    is_dwell_regular = len(ratios) >= min_turns and median(np.array(ratios)) > min_median_factor
    min_dwell = min_dwell_samples * compute_median_step(time)
    turns = []
    for sharp_turn, dwell_turn, apparent_dwell in candidates:
        limit = max(min_dwell_factor * apparent_dwell, min_dwell)
        if dwell_turn and (not sharp_turn or is_dwell_regular or dwell_turn.dwell > limit):
            turns.append(dwell_turn)
        elif sharp_turn:
            turns.append(sharp_turn)
    return tuple(turns)


def split_at_turns(motion: Motion) -> tuple[Branch, ...]:
    """Split a motion into branches, which end at the fitted times of its turns if it has any."""
    times = np.full((len(motion.strokes), 2), np.nan)
    for turn in motion.turns:
        times[turn.stroke_index, 1] = turn.arrival.time
        times[turn.stroke_index + 1, 0] = turn.departure.time
    return turning_points.make_branches(motion.signal.time, motion.strokes, turning_times=times)


def orient_force(force: Signal) -> Signal:
    """Reverse the sign of a force that falls in loading, so that its turns are peaks."""
    is_falling = turning_points.goes_down(force.values)
    return replace(force, values=-force.values) if is_falling else force


def _fit_turn(
    signal: Signal, stroke_index: int, turn_times: tuple[float, float], window: float
) -> tuple[Turn | None, Turn | None] | None:
    """Fit a turn as one corner, and as two corners with a dwell between them.

    Parameters
    ----------
    signal : channel of the motion
    stroke_index : index of the stroke that ends at the turn
    turn_times : times of the end of this stroke and of the start of the next one, s
    window : width of the fitted stretch on each side, s

    Returns
    -------
    The turn with one corner, and the turn with a dwell; each is None if it is not found. One corner
    is fitted only if the next stroke begins at the sample at which the stroke ends. If this fit
    fails, or too many samples are missing at the turn, the result is None.
    """
    half_width, max_missing_fraction = 0.5, 0.3  # s, on each side of a turn; of the samples there
    assumed_dwell = 0.2  # s, first guess if the next stroke begins at once
    for turn_time in turn_times:
        values_at_turn = signal.values[np.abs(signal.time - turn_time) <= half_width]
        if not np.isnan(values_at_turn).mean() <= max_missing_fraction:
            return None
    sharp_turn = None
    if turn_times[0] == turn_times[1]:
        corner = fit_corner(signal.time, signal.values, guess=turn_times[0], window=window)
        if corner is None or not np.isfinite(corner.time_error):
            return None
        sharp_turn = Turn(stroke_index, corner, corner)
        turn_times = corner.time - 0.5 * assumed_dwell, corner.time + 0.5 * assumed_dwell
    corners = fit_stop(signal.time, signal.values, guesses=turn_times, window=window)
    return sharp_turn, None if corners is None else Turn(stroke_index, *corners)


def _estimate_apparent_dwell(signal: Signal, turn: Turn) -> float:
    """Estimate the apparent dwell that noise causes at a corner, s.

    The mean of the n = rate dwell samples around a corner has the error noise / sqrt(n), and a
    dwell changes this mean by speed dwell / 4. The error and the change are equal for a dwell of
    (16 noise^2 / (speed^2 rate))^(1/3), which is the apparent dwell.
    """
    speed = float(np.min(np.abs(_measure_speeds(signal, turn))))
    step, noise = compute_median_step(signal.time), estimate_noise_level(signal.values)
    return float(np.cbrt(16.0 * noise**2 * step / speed**2)) if speed > 0.0 else 0.0


def check_turns(motion: Motion, *, is_clock_fitted: bool = True) -> Iterator[Finding]:
    """Report turns that were not recorded, or that are rounded.

    Parameters
    ----------
    motion : motion with its turns
    is_clock_fitted : whether the clocks were aligned at these turns; the findings then also mark
        the clock as doubtful
    """
    signal, fitted_indices = motion.signal, {turn.stroke_index for turn in motion.turns}
    recorded_times = signal.time[~np.isnan(signal.values)]
    quantities = ("displacement", "force", *(("clock",) if is_clock_fitted else ()))
    for index, stroke in enumerate(motion.strokes[:-1]):
        if index not in fitted_indices:
            time = float(signal.time[stroke.stop])
            start = max(recorded_times[recorded_times < time][-1:], default=time)
            stop = min(recorded_times[recorded_times > time][:1], default=time)
            facts: dict[str, Any] = {"clock": signal.clock, "time": time}
            facts |= {"period": (float(start), float(stop))}
            yield Finding.of("process.turn_not_seen", "travel", *quantities, **facts)
    for turn in motion.turns:
        finding = _find_rounded_corner(signal, turn)
        if finding is not None:
            yield finding
            if is_clock_fitted:
                yield Finding(finding.note, (Doubt("clock", finding.doubts[0].reason),))


def _find_rounded_corner(signal: Signal, turn: Turn) -> Finding | None:
    """Report a turn that deviates from straight lines by more than noise explains, or None."""
    noise_factor = 6.0  # standard errors of the mean of the deviations, and of their variance
    noise, speeds = estimate_noise_level(signal.values), _measure_speeds(signal, turn)
    time_from_arrival = signal.time - turn.arrival.time
    time_from_departure = signal.time - turn.departure.time
    line_before = speeds[0] * np.minimum(time_from_arrival, 0.0)
    line_after = speeds[1] * np.maximum(time_from_departure, 0.0)
    deviations = signal.values - turn.arrival.value - (line_before + line_after)
    for width in CORNER_WIDTHS:
        deviations_at_turn = deviations[
            (time_from_arrival >= -width)
            & (time_from_departure <= width)
            & ~np.isnan(signal.values)
        ]
        if not len(deviations_at_turn):
            continue
        if turn.dwell == 0.0:
            cut = abs(float(deviations_at_turn.mean()))
            limit = noise_factor * noise / np.sqrt(len(deviations_at_turn)) + MAX_CORNER_CUT
        else:
            cut = float(np.sqrt(np.mean(deviations_at_turn**2)))
            variance_error = np.sqrt(2.0 / len(deviations_at_turn))  # relative
            scatter = noise * np.sqrt(1.0 + noise_factor * variance_error)
            limit = np.hypot(scatter, 2.0 * MAX_CORNER_CUT)
        if cut > limit:
            period = turn.arrival.time - width, turn.departure.time + width
            facts: dict[str, Any] = {"clock": signal.clock, "time": turn.middle_time}
            facts |= {"cut": 1e6 * cut, "period": period}
            return Finding.of("process.turn_rounded", "travel", "displacement", **facts)
    return None


def _measure_speeds(signal: Signal, turn: Turn) -> tuple[float, float]:
    """Measure the speeds before arrival and after departure, m/s; NaN if samples are missing.

    Each speed is computed from two mean positions, each over half a second. The middles of these
    stretches are 0.5 s and 1 s from the turn.
    """
    half_width, first_distance, last_distance = 0.25, 0.5, 1.0  # s
    samples = np.stack([signal.time, signal.values])[:, ~np.isnan(signal.values)]

    def measure_speed(*middle_times: float) -> float:
        stretches = [samples[:, np.abs(samples[0] - time) <= half_width] for time in middle_times]
        if not all(stretch.size for stretch in stretches):
            return float("nan")
        duration, travel = (stretches[1].mean(axis=1) - stretches[0].mean(axis=1)).tolist()
        return float(travel / duration) if duration > 0.0 else float("nan")

    arrival, departure = turn.arrival.time, turn.departure.time
    speed_before = measure_speed(arrival - last_distance, arrival - first_distance)
    return speed_before, measure_speed(departure + first_distance, departure + last_distance)


def match_strokes(
    motion: Motion, force: Signal, *, sign: int
) -> tuple[list[tuple[int, float]], bool, str]:
    """Pair the turns that end the loading strokes of a motion with the peaks of a force.

    Parameters
    ----------
    motion : motion with its strokes, on its own clock
    force : force on its own clock, rising in loading
    sign : sign of the strokes in which the specimen is loaded

    Returns
    -------
    pairs : for each pair, the index of the stroke that ends at the turn, and the rough time of the
        peak, s
    is_ambiguous : whether another pairing fits as well, or may fit because a record does not
        contain the whole test and the lag is longer than half a cycle
    peak_counts : text with the numbers of peaks of the motion and of the force
    """
    time = motion.signal.time
    turn_times = {
        index: 0.5 * float(time[stroke.stop] + time[next_stroke.start])
        for index, (stroke, next_stroke) in enumerate(pairwise(motion.strokes))
        if stroke.sign == sign
    }
    stroke_indices, motion_times = list(turn_times), np.array([*turn_times.values()])
    peak_times = _find_peak_times(force)
    matches, is_ambiguous = match_peaks(motion_times, peak_times)
    are_complete = all(_begins_and_ends_at_rest(signal) for signal in (motion.signal, force))
    if len(matches) and len(motion_times) > 1 and not are_complete:
        lag = float(np.median(peak_times[matches[:, 1]] - motion_times[matches[:, 0]]))
        is_ambiguous |= abs(lag) > 0.5 * float(np.diff(motion_times).min())
    pairs = [(stroke_indices[turn], float(peak_times[peak])) for turn, peak in matches.tolist()]
    peak_counts = f"{len(turn_times)} peaks of the motion, {len(peak_times)} of the force"
    return pairs, is_ambiguous, peak_counts


def _find_peak_times(force: Signal) -> Floats:
    """Find the times of the peaks of a force, s, accurate to half a second."""
    smoothing, min_fall = 0.5, 0.3  # s; smallest fall after a peak as a fraction of the range
    return find_rough_peaks(force.time, force.values, smoothing=smoothing, fall=min_fall)


def _begins_and_ends_at_rest(signal: Signal) -> bool:
    """Return whether both ends of a record are near its smallest value, far below its peaks."""
    max_rest_level = 0.2  # above the smallest value, as a fraction of the range
    values = drop_missing(signal.values)
    n_end_samples = max(1, len(values) // 200)
    end_levels = float(values[:n_end_samples].mean()), float(values[-n_end_samples:].mean())
    return max(end_levels) < float(values.min()) + max_rest_level * float(np.ptp(values))


def find_turn_events(
    force: Signal, pairs: list[tuple[int, float]], motion: Motion, window: float
) -> Floats:
    """Find the events, at each of which the motion turns and the force has a corner.

    Parameters
    ----------
    force : force on its own clock, rising in loading
    pairs : index of the stroke and rough time of the peak (s) of each pair, from `match_strokes`
    motion : motion with its turns
    window : width of the fitted stretch on each side of a corner, s

    Returns
    -------
    Shape (4, events), s. The rows are the time on the clock of the motion, the time on the clock of
    the force, the standard error of their difference, and the component of this error from the
    unknown shape of the force after the corner. This component is common to all events of a
    specimen and does not average out.

    Notes
    -----
    A corner of the force with a standard error of 0.1 s or more is left out. With a dwell, both
    corners of the force give one event, because their distance is known from the motion. If the
    dwell is longer than two windows, the corners are fitted separately. Otherwise they are fitted
    together, because separate fits may confuse them.
    """
    turns = {turn.stroke_index: turn for turn in motion.turns}
    corners_by_turn = (
        _fit_corners(force, turns[index], rough_time, window)
        for index, rough_time in pairs
        if index in turns
    )
    events = [_average_corners(corners) for corners in corners_by_turn if len(corners)]
    return np.array(events, dtype=np.float64).reshape(-1, 4).T


def _fit_corners(force: Signal, turn: Turn, rough_time: float, window: float) -> Floats:
    """Fit the corners of a force at a turn of the motion, shape (corners, 5), s.

    The columns are the times on the clocks of motion and force, their standard errors, and the
    component of the latter error from the unknown shape of the force. A dwell longer than two
    windows has two rows, one for each of its corners.
    """
    search_reach = 1.0  # s, on each side of the rough time of the peak
    arrival, departure, dwell = turn.arrival, turn.departure, turn.dwell
    reach = dwell + search_reach  # because the rough time may be that of either corner
    first_corner_time = turning_points.find_dwell_turn(
        force.time, force.values, middle=rough_time, reach=reach, width=window, dwell=dwell
    )
    if first_corner_time is None:
        return np.zeros((0, 5))
    max_error = max(arrival.time_error, departure.time_error)
    guesses = [(arrival.time, max_error, first_corner_time, dwell)]
    if dwell > 2.0 * window:
        guesses = [(arrival.time, arrival.time_error, first_corner_time, 0.0)]
        guesses.append((departure.time, departure.time_error, first_corner_time + dwell, 0.0))
    record, rows = (force.time, force.values), []
    for motion_time, motion_error, guess, fitted_dwell in guesses:
        corner = fit_reversal(*record, guess=guess, window=window, dwell=fitted_dwell)
        if corner is not None and corner.time_error < MAX_CORNER_TIME_ERROR:
            errors = motion_error, corner.time_error, corner.shape_error
            rows.append([motion_time, corner.time, *errors])
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


def _average_corners(corners: Floats) -> list[float]:
    """Average the corners of a turn, weighted by their errors, to an event of four values, s."""
    lags, lag_errors = corners[:, 1] - corners[:, 0], np.hypot(corners[:, 2], corners[:, 3])
    weights = lag_errors**-2.0 / (lag_errors**-2.0).sum()
    error_factor = max(1.0, float(np.ptp(lags)) / float(np.linalg.norm(lag_errors)))
    errors = error_factor * np.sqrt(weights**2 @ corners[:, 2:4] ** 2)
    mean = weights @ corners
    return [float(mean[0]), float(mean[1]), float(np.hypot(*errors)), float(mean[4])]


def align_clocks(
    signals: Signals, align: schema.Align, motion: Motion
) -> tuple[ClockFit | None, Motion, list[Finding]]:
    """Align the clock of the force with that of the motion by the method of the protocol.

    Parameters
    ----------
    signals : signals of the test
    align : method of the protocol, with its settings
    motion : motion with its strokes

    Returns
    -------
    fit : relation of the clocks; None if nothing is aligned, or if the fit fails
    motion : motion with its turns; unchanged if nothing is aligned
    findings : findings of the fit and of the turns

    Notes
    -----
    Nothing is aligned without strokes, with the method ``none``, or if force and displacement have
    one clock and the method is not ``turning-points``.
    """
    if not motion.strokes or isinstance(align, schema.AlignNone):
        return None, motion, []
    force = signals.raw[align.channel or signals.force]
    uses_turns = isinstance(align, schema.AlignTurningPoints)
    if not uses_turns and force.clock == signals.raw[signals.displacement].clock:
        return None, motion, []
    motion = replace(motion, turns=find_motion_turns(motion, window=align.motion_window))
    fit: ClockFit | None
    if isinstance(align, schema.AlignStated):
        fit, findings = make_stated_fit(force, align, motion)
    elif isinstance(align, schema.AlignCommonStart):
        fit, findings = fit_common_start(force, align, motion)
    else:
        fit, findings = fit_turning_points(force, align, motion)
    is_clock_fitted = not isinstance(align, schema.AlignStated)
    return fit, motion, [*findings, *check_turns(motion, is_clock_fitted=is_clock_fitted)]


def fit_turning_points(
    force: Signal, align: schema.AlignTurningPoints, motion: Motion
) -> tuple[ClockFit | None, list[Finding]]:
    """Fit the relation of the clocks to the turning points and to the lag of a repeated cycle.

    Parameters
    ----------
    force : raw channel that shows the turning points, usually the force
    align : windows and limits of the protocol
    motion : motion with its strokes and turns

    Returns
    -------
    The fit and the findings. The fit is None if the force is constant or no corner is common to
    both records; a finding then blocks the curve.

    Notes
    -----
    The lag of the repeated cycle is used if there are more than two events, the force does not
    relax in the dwells, and the lag agrees with the turning points.
    """
    if findings := _check_constant(force, align.channel):
        return None, findings
    force = orient_force(force)
    pairs, is_ambiguous, peak_counts = match_strokes(motion, force, sign=1)
    events = find_turn_events(force, pairs, motion, align.force_window)
    facts: dict[str, Any] = {"peak_counts": peak_counts}
    if not events.size:
        if pairs:
            return None, [Finding.of("process.no_common_peak", "align", is_blocking=True, **facts)]
        return None, [Finding.of("process.no_pair_of_peaks", "align", is_blocking=True, **facts)]
    if is_ambiguous:
        facts |= {"override": format_overrides("align", "{method: stated, offset: ...}")}
        findings.append(Finding.of("process.alignment_ambiguous", "align", "clock", **facts))
    fit = _fit_events(events, None)
    if events.shape[1] > 2 and not _has_relaxation(force, motion, fit):
        cycle_lag = _measure_cycle_lag(motion, force, fit)
        if contradictions := [*_check_cycle_lag(cycle_lag, fit)]:
            findings += contradictions
        else:
            fit = _fit_events(events, cycle_lag)
    return fit, [*findings, *_check_fit(fit, align)]


def _check_constant(force: Signal, channel: str) -> list[Finding]:
    """Report a constant force, which has no turning point."""
    if np.nanmax(force.values) > np.nanmin(force.values):
        return []
    facts: dict[str, Any] = {"channel": channel, "level": float(np.nanmean(force.values))}
    return [Finding.of("process.constant_channel", channel, is_blocking=True, force=force, **facts)]


def _measure_cycle_lag(motion: Motion, force: Signal, fit: ClockFit) -> CycleLag | None:
    """Measure the lag from the second cycle to the last one on both clocks.

    The first cycle is not used, because it deforms the specimen for the first time. The result is
    None if there are fewer than three cycles or a lag cannot be fitted.
    """
    trim, min_blocks = 1.0, 50_000  # s, omitted at both ends of a cycle; blocks of the force
    travel = motion.signal
    turn_times = {turn.stroke_index: turn.middle_time for turn in motion.turns}
    cycles = [
        (travel.time[loading.start] + trim, turn_times[index], travel.time[unloading.stop] - trim)
        for index, (loading, unloading) in enumerate(pairwise(motion.strokes))
        if loading.sign > 0 > unloading.sign and index in turn_times
    ]
    if len(cycles) < 3:
        return None
    start, turn, stop = cycle = cycles[1]
    fit_lag, guess = clock_alignment.fit_lag, cycles[-1][1] - turn
    motion_lag = fit_lag(travel.time, travel.values, cycle, guess=guess, hysteresis=False)
    force_cycle = fit.to_force_time(start), fit.to_force_time(turn), fit.to_force_time(stop)
    force_guess = guess * (1.0 + fit.drift)
    fit_force_lag = partial(fit_lag, cycle=force_cycle, guess=force_guess, hysteresis=True)
    force_lag = fit_force_lag(force.time, force.values)
    if isinstance(motion_lag, Failure) or isinstance(force_lag, Failure):
        return None
    zero_drift = force.zero_drift * float(np.nanmax(np.abs(force.values)))  # N
    time = average_blocks(force.time, min_blocks, has_remainder=False)
    values = average_blocks(force.values, min_blocks, has_remainder=False)
    drift_modes = compute_drift_modes(time - time[0], zero_drift)
    modes = [np.zeros(1), *drift_modes] if drift_modes else []
    mode_fits = [fit_force_lag(time, values + mode) for mode in modes]
    mode_lags = [x.value for x in mode_fits if not isinstance(x, Failure)]
    lag_changes = np.subtract(mode_lags[1:], mode_lags[0]) if mode_lags else np.zeros(0)
    drift_error = float(np.linalg.norm(lag_changes))
    error = float(np.hypot(motion_lag.error, force_lag.error))
    return CycleLag(motion_lag.value, force_lag.value, error, drift_error)


def _has_relaxation(force: Signal, motion: Motion, fit: ClockFit) -> bool:
    """Return whether the force relaxes in the dwells, so that its cycles are not comparable."""
    # The force may lose this fraction of its range in a dwell. If it loses 0.04, the fitted drift
    # of the clocks is wrong by two standard errors.
    max_loss_fraction = 0.01
    compared_stretches = np.array([[0.1, 0.35], [0.65, 0.9]])  # fractions of the dwell
    losses = [0.0]
    for turn in motion.turns:
        start, stop = map(fit.to_force_time, (turn.arrival.time, turn.departure.time))
        samples = np.searchsorted(force.time, start + compared_stretches * (stop - start))
        early_force, late_force = (force.values[slice(*stretch)] for stretch in samples)
        if np.isfinite(early_force).any() and np.isfinite(late_force).any():
            losses.append(abs(float(np.nanmean(early_force)) - float(np.nanmean(late_force))))
    force_range = float(np.nanmax(force.values) - np.nanmin(force.values))
    return max(losses) > max_loss_fraction * force_range


def _check_cycle_lag(lag: CycleLag | None, fit: ClockFit) -> Iterator[Finding]:
    """Report a lag of the repeated cycle that contradicts the turning points."""
    max_lag_difference = 4.0  # in standard errors
    if lag is None:
        return
    expected_lag = (1.0 + fit.drift) * lag.motion_lag
    error = float(np.hypot(lag.error, fit.drift_interval.standard_error * lag.motion_lag))
    if not abs(lag.force_lag - expected_lag) <= max_lag_difference * error:
        facts: dict[str, Any] = {"lag": lag.force_lag, "expected": expected_lag}
        yield Finding.of("process.cycles_not_alike", "align", **facts)


def _fit_events(events: Floats, cycle_lag: CycleLag | None) -> ClockFit:
    """Fit the relation of the clocks to events and to the lag of a repeated cycle, if any."""
    motion_times, force_times, errors, shape_errors = events
    # Each error contains the shape error once. The shape error is common to all n events, and with
    # the factor sqrt(n - 1) it does not average out.
    errors = np.hypot(errors, sqrt(len(errors) - 1) * shape_errors)
    method = "turning points: lines through the travel, smooth pieces of the force"
    method = method if cycle_lag is None else f"{method}; lag of the repeated cycle"
    return clock_alignment.fit_clocks(
        motion_times, force_times, errors, method=method, cycle_lag=cycle_lag
    )


def _check_fit(fit: ClockFit, align: schema.AlignTurningPoints) -> Iterator[Finding]:
    """Report a residual or a drift above the limits of the protocol, or a fit to one event only."""
    # The rms residual may be this multiple of the rms error of the turning points, because noise at
    # the turns only widens the interval of the offset.
    residual_factor = 2.0
    noise_limit = residual_factor * float(np.sqrt(np.mean(fit.event_errors**2)))
    if fit.residual > max(align.max_residual, noise_limit):
        facts: dict[str, Any] = {"residual": 1e3 * fit.residual}
        facts |= {"allowed": 1e3 * align.max_residual}
        yield Finding.of("process.alignment_residual", "align", "clock", **facts)
    half_width = 0.5 * (fit.drift_interval.upper - fit.drift_interval.lower)
    if abs(fit.drift) - half_width > align.max_drift:
        # Clocks drift by a few parts per million. A larger drift suggests recordings of two tests.
        facts = {"drift": 1e6 * fit.drift, "half_width": 1e6 * half_width}
        facts |= {"allowed": 1e6 * align.max_drift}
        quantities = "clock", "displacement", "force"
        yield Finding.of("process.alignment_drift", "align", *quantities, **facts)
    if len(fit.event_times_motion) == 1:
        yield Finding.of("process.alignment_one_event", "align", "clock")


def make_stated_fit(
    force: Signal, align: schema.AlignStated, motion: Motion
) -> tuple[ClockFit, list[Finding]]:
    """Make the relation of the clocks from an offset that the protocol states.

    Parameters
    ----------
    force : raw channel whose peaks should be at the turns, usually the force
    align : offset, drift, uncertainty and reason of the protocol
    motion : motion with its strokes

    Returns
    -------
    The relation, with the stated offset as its only event, and the findings: a note on the offset
    and, if the peaks of the force are not at the turns, a finding that the offset is doubtful.

    Notes
    -----
    If the protocol states no uncertainty of the offset, it is one sample of the slower recorder.
    The uncertainty of the drift is always 100 ppm / sqrt(3), a rectangular distribution (GUM, JCGM
    100:2008, sec. 4.3.7).
    """
    max_drift = 1e-4  # of two recorders that were never compared
    error, error_basis = align.uncertainty, ""
    if error is None:
        error = max(compute_median_step(signal.time) for signal in (motion.signal, force))
        error_basis = " (one sample, as none is stated)"
    events = np.array([[0.0], [align.offset], [error]])
    drift_error, method = max_drift / sqrt(3.0), f"stated: {align.because}"
    fit = make_clock_fit((align.offset, error), (align.drift, drift_error), events, method)
    facts: dict[str, Any] = {"error": error, "ppm": 1e6 * align.drift, "basis": error_basis}
    finding = Finding.of("process.clocks_stated", "align", align=align, **facts)
    return fit, [finding, *_check_stated_offset(force, fit, motion)]


def _check_stated_offset(force: Signal, fit: ClockFit, motion: Motion) -> Iterator[Finding]:
    """Report a stated offset with which the force peaks far from the turns of the motion."""
    max_peak_lag, lag_error_factor = 1.0, 3.0  # s, plus this many standard errors of the offset
    force, time = orient_force(force), motion.signal.time
    peak_times = _find_peak_times(force)
    lags = []
    for stroke, next_stroke in [*pairwise(motion.strokes)][::2]:  # each loading with its unloading
        start, stop = fit.to_force_time(time[[stroke.stop, next_stroke.start]]).tolist()
        if len(peak_times) and force.time[0] <= start and stop <= force.time[-1]:
            distance = float(np.abs(peak_times - 0.5 * (start + stop)).min())
            lags.append(max(0.0, distance - 0.5 * (stop - start)))
    lag, error = median(np.array(lags)) if lags else 0.0, float(fit.event_errors[0])
    if lag > max_peak_lag + lag_error_factor * error:
        yield Finding.of("process.clocks_stated_wrong", "align", "clock", "force", lag=lag)


def fit_common_start(
    force: Signal, align: schema.AlignCommonStart, motion: Motion
) -> tuple[ClockFit, list[Finding]]:
    """Fit the relation of the clocks of two recorders that one trigger started.

    Parameters
    ----------
    force : raw channel that shows the turning points, usually the force
    align : channel and limits of the protocol
    motion : motion with its strokes and turns

    Returns
    -------
    The fit and the findings. The findings mark clocks and force as doubtful if the recorders did
    not start together, and block the curve if the force is constant.

    Notes
    -----
    Offset and drift are fitted by weighted least squares to three kinds of equations. The first is
    offset = 0 with the standard uncertainty max_offset / sqrt(3) of a rectangular distribution. The
    second is drift = 0 with the standard uncertainty max_drift / sqrt(3) (GUM, JCGM 100:2008,
    4.3.7). The third kind is one equation for each turn, the difference of its times on the two
    clocks. If the turns contradict a start within max_offset by more than their own 95 % interval,
    the first equation is left out.
    """
    findings, force = _check_constant(force, align.channel), orient_force(force)
    pairs = _match_rough_turns(motion, force, align)
    events = find_turn_events(force, pairs, motion, align.force_window)[:3]
    lags, weights = events[1] - events[0], events[2] ** -2.0
    lag = float(np.average(lags, weights=weights)) if len(lags) else 0.0
    lag_error = float(weights.sum() ** -0.5) if len(lags) else 0.0
    has_common_start = abs(lag) - 1.96 * lag_error <= align.max_offset
    fit = _fit_common_start_clock(events, align, has_common_start)
    facts: dict[str, Any] = {"channel": align.channel, "max_lag": 1e3 * align.max_offset}
    if not len(lags):
        return fit, [*findings, Finding.of("process.start_unchecked", "align", **facts)]
    facts |= {"lag": 1e3 * lag, "half_width": 1.96e3 * lag_error, "offset": 1e3 * fit.offset}
    if has_common_start:
        return fit, [*findings, Finding.of("process.common_start", "align", **facts)]
    finding = Finding.of("process.not_started_together", "align", "clock", "force", **facts)
    return fit, [*findings, finding]


def _match_rough_turns(
    motion: Motion, force: Signal, align: schema.AlignCommonStart
) -> list[tuple[int, float]]:
    """Pair the strokes in the direction of the first one with the rough times of peaks, s."""
    strokes = motion.strokes
    if sum(stroke.sign == strokes[0].sign for stroke in strokes[:-1]) == 1:
        turn_time = find_sharpest_turn(force.time, force.values, width=align.force_window)
        return [] if turn_time is None else [(0, turn_time)]
    return match_strokes(motion, force, sign=strokes[0].sign)[0]


def _fit_common_start_clock(
    events: Floats, align: schema.AlignCommonStart, has_common_start: bool
) -> ClockFit:
    """Fit offset and drift to events, shape (3, events), s, and to the bounds of the protocol."""
    motion_times, force_times, event_errors = events
    n_bounds = 1 + has_common_start
    start_error = align.max_offset / sqrt(3.0)
    bound_errors = np.array([align.max_drift / sqrt(3.0), start_error])[:n_bounds]
    bound_rows = np.array([[0.0, 1.0], [1.0, 0.0]])[:n_bounds]  # drift = 0, and offset = 0
    event_rows = np.column_stack([np.ones_like(motion_times), motion_times])
    design, errors = np.vstack([event_rows, bound_rows]), np.append(event_errors, bound_errors)
    differences = np.append(force_times - motion_times, np.zeros(n_bounds))
    (offset, drift), covariance = solve_weighted(design, differences, errors)
    offset_error, drift_error = np.sqrt(np.diag(covariance)).tolist()
    if not len(event_errors):  # the common start is the only event
        events = np.array([[0.0], [0.0], [start_error]])
    basis = "the force's corner at the turn"
    basis = f"common start and {basis}" if has_common_start else f"{basis} alone"
    method = f"{basis}, drift taken as zero within a bound"
    return make_clock_fit((offset, offset_error), (drift, drift_error), events, method)
