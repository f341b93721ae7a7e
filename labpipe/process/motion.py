"""Find strokes, turns and branches of the motion, and the corners of the force at the turns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labpipe.protocol.schema import Branches
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch
from labpipe.records.quality import Doubt, Finding
from labpipe.records.signals import Clocks, Signal
from labpipe.signal.clock_alignment import find_rough_peaks, match_peaks
from labpipe.signal.corners import Corner, fit_corner, fit_stop
from labpipe.signal.reversals import Reversal, fit_reversal
from labpipe.signal.turning_points import (
    Stroke,
    estimate_noise_level,
    find_strokes,
    find_turn_near,
    goes_down,
    split_branches,
)

CORNER_WIDTHS = (0.05, 0.25)
"""s on each side of a turn in which the motion is compared with straight lines."""
MAX_CORNER_CUT = 5e-6
"""m by which a motion may round a corner."""


def find_motion_strokes(
    motion: Signal, block: Branches
) -> tuple[tuple[Stroke, ...], list[Finding]]:
    """Find the strokes of a motion; without any, return a finding that blocks the curve.

    Parameters
    ----------
    motion : the channel that splits the branches
    block : of the protocol, with channel name and minimum stroke
    """
    noise_factor = 5.0  # standard deviations that noise alone may reach
    min_stroke, noise = block.min_stroke, estimate_noise_level(motion.values)
    strokes = find_strokes(motion.time, motion.values, min_stroke=min_stroke)
    where = block.channel
    if noise_factor * noise > min_stroke:
        noise, min_stroke = 1e3 * noise, 1e3 * min_stroke
        return (), [
            Finding.of(
                "process.motion_is_noise", where, blocks=True, noise=noise, min_stroke=min_stroke
            )
        ]
    if not strokes:
        span = 1e3 * float(np.nanmax(motion.values) - np.nanmin(motion.values))
        return (), [Finding.of("process.no_motion", where, blocks=True, span=span)]
    return strokes, []


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of a test, split at its turns.

    Parameters
    ----------
    signal : the channel that splits the branches
    branches : of the motion
    clocks : joined at its turns
    """

    signal: Signal
    branches: tuple[Branch, ...]
    clocks: Clocks


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn of a motion: a corner, or two with a dwell between them.

    Parameters
    ----------
    stroke : number of the stroke that ends there
    arrival, departure : corners of the motion; the same object if there is no dwell
    """

    stroke: int
    arrival: Corner
    departure: Corner

    @property
    def middle(self) -> float:
        """Return the mean of arrival and departure times, s."""
        return 0.5 * (self.arrival.time + self.departure.time)

    @property
    def dwell(self) -> float:
        """Return the time between arrival and departure, s."""
        return self.departure.time - self.arrival.time

    @property
    def corners(self) -> tuple[Corner, ...]:
        """Return the one or two corners."""
        return (self.arrival,) if self.arrival is self.departure else (self.arrival, self.departure)


def find_motion_turns(motion: Signal, strokes: tuple[Stroke, ...], *, window: float) -> list[Turn]:
    """Find the times at which a motion turns, by straight lines on both sides of each corner.

    Parameters
    ----------
    motion : the travel on its own clock
    strokes : of that motion
    window : s on each side, cut to the length of the strokes

    Returns
    -------
    The turns in order; those without a clear corner or with missing samples are omitted.

    Notes
    -----
    At 1 mm/s, with 10 um of noise and 50 frames per second, a dwell of 80 ms is found at a single
    turn; one of 50 ms is found in some tests with five turns. A dwell of fewer than three samples
    is treated as a corner.
    """
    # Multiple of the apparent dwell that noise causes, from which a single dwell is real.
    min_dwell_factor = 2.4
    min_dwell_samples = 3
    candidates = []
    for number, (before, after) in enumerate(pairwise(strokes)):
        ends = motion.time[[before.start, before.stop, after.start, after.stop]]
        fit_width = min(window, 0.95 * float(min(ends[1] - ends[0], ends[3] - ends[2])))
        candidate = _fit_turn(motion, number, (float(ends[1]), float(ends[2])), fit_width)
        if candidate is not None:
            candidates.append(candidate)
    dwells_everywhere = _dwells_everywhere(motion, [wait for _, wait in candidates])
    shortest = min_dwell_samples * median(np.diff(motion.time))
    turns = []
    for turn, wait in candidates:
        waits = wait is not None and (
            dwells_everywhere
            or wait.dwell > max(min_dwell_factor * _estimate_apparent_dwell(motion, wait), shortest)
        )
        chosen = wait if waits or turn is None else turn
        if chosen is not None:
            turns.append(chosen)
    return turns


def split_at_turns(
    motion: Signal, strokes: tuple[Stroke, ...], turns: list[Turn]
) -> tuple[Branch, ...]:
    """Split a motion into branches; known turns give their ends between samples."""
    times = np.full((len(strokes), 2), np.nan)
    for turn in turns:
        times[turn.stroke, 1] = turn.arrival.time
        times[turn.stroke + 1, 0] = turn.departure.time
    return split_branches(motion.time, strokes, turning_times=times)


def orient_force(force: Signal) -> Signal:
    """Reverse a force that falls in loading, so that its turns are peaks."""
    return replace(force, values=-force.values) if goes_down(force.values) else force


def _fit_turn(
    motion: Signal, number: int, near: tuple[float, float], window: float
) -> tuple[Turn | None, Turn | None] | None:
    """Fit a turn as one corner and as a dwell; None if samples are missing there."""
    half_window, max_missing_share = 0.5, 0.3  # s on each side of a turn; of samples in it
    assumed_dwell = 0.2  # s, start of the fit if the strokes show no dwell
    nearby = (np.abs(motion.time - turn_time) <= half_window for turn_time in near)
    if not all(np.isnan(motion.values[is_near]).mean() <= max_missing_share for is_near in nearby):
        return None
    corner_turn = None
    if near[0] == near[1]:
        corner = fit_corner(motion.time, motion.values, near=near[0], window=window)
        if corner is None or not np.isfinite(corner.time_error):
            return None
        corner_turn = Turn(number, corner, corner)
        near = corner.time - 0.5 * assumed_dwell, corner.time + 0.5 * assumed_dwell
    stop = fit_stop(motion.time, motion.values, near=near, window=window)
    return corner_turn, None if stop is None else Turn(number, *stop)


def _estimate_apparent_dwell(motion: Signal, turn: Turn) -> float:
    """Estimate the apparent dwell that noise causes at a corner, s.

    The mean of n samples has the error noise / sqrt(n). A dwell lowers the mean around a corner by
    a quarter of the dwell times the speed. Both are equal for a dwell of
    (16 noise^2 / (speed^2 rate))^(1/3).
    """
    speed = float(np.min(np.abs(_measure_speeds(motion, turn))))
    if not speed > 0.0:
        return 0.0
    step = median(np.diff(motion.time))
    return float(np.cbrt(16.0 * estimate_noise_level(motion.values) ** 2 * step / speed**2))


def _dwells_everywhere(motion: Signal, waits: list[Turn | None]) -> bool:
    """Check whether the machine dwells at every turn, by the median over all turns."""
    min_apparent_dwell = 1e-6  # s
    min_turns, min_median_ratio = 3, 1.5
    shares = [
        0.0
        if wait is None
        else wait.dwell / max(_estimate_apparent_dwell(motion, wait), min_apparent_dwell)
        for wait in waits
    ]
    return len(waits) >= min_turns and median(np.array(shares)) > min_median_ratio


def check_turns(
    motion: Signal, strokes: tuple[Stroke, ...], turns: list[Turn], *, for_clock: bool = True
) -> Iterator[Finding]:
    """Report turning points that were not recorded, or that are rounded.

    Parameters
    ----------
    motion, strokes, turns : the travel, its strokes, and the turns between them
    for_clock : whether clocks were joined at these turns, so that they are doubtful as well
    """
    clock = ("clock",) if for_clock else ()
    seen_turns = {turn.stroke: turn for turn in turns}
    seen_times = motion.time[~np.isnan(motion.values)]
    for number, (before, _) in enumerate(pairwise(strokes)):
        if number not in seen_turns:
            turn_time = float(motion.time[before.stop])
            earlier, later = seen_times[seen_times < turn_time], seen_times[seen_times > turn_time]
            quantities = "displacement", "force", *clock
            during = (
                float(earlier[-1] if len(earlier) else turn_time),
                float(later[0] if len(later) else turn_time),
            )
            yield Finding.of(
                "process.turn_not_seen",
                "travel",
                *quantities,
                during=during,
                clock=motion.clock,
                time=turn_time,
            )
    for finding in (corner for turn in turns for corner in _find_rounded_corners(motion, turn)):
        yield finding
        if for_clock:
            yield Finding(finding.note, (Doubt("clock", finding.doubts[0].reason),))


def _find_rounded_corners(motion: Signal, turn: Turn) -> Iterator[Finding]:
    """Find a turn at which the motion rounds the corner; report it once."""
    noise, speeds = estimate_noise_level(motion.values), _measure_speeds(motion, turn)
    for width in CORNER_WIDTHS:
        deviations = _measure_corner_deviations(motion, turn, speeds, width)
        if not len(deviations):
            continue
        if turn.dwell == 0.0:
            cut = abs(float(deviations.mean()))
            limit = 6.0 * noise / np.sqrt(len(deviations)) + MAX_CORNER_CUT
        else:
            cut = float(np.sqrt(np.mean(deviations**2)))
            scatter = noise * np.sqrt(1.0 + 6.0 * np.sqrt(2.0 / len(deviations)))
            limit = np.hypot(scatter, 2.0 * MAX_CORNER_CUT)
        if cut > limit:
            yield Finding.of(
                "process.turn_rounded",
                "travel",
                "displacement",
                during=(turn.arrival.time - width, turn.departure.time + width),
                clock=motion.clock,
                time=turn.middle,
                cut=1e6 * cut,
            )
            return


def _measure_corner_deviations(
    motion: Signal, turn: Turn, speeds: tuple[float, float], width: float
) -> Floats:
    """Return the deviations of the motion from straight lines near the corners, m."""
    since, until = motion.time - turn.arrival.time, motion.time - turn.departure.time
    is_near = (since >= -width) & (until <= width) & ~np.isnan(motion.values)
    lines = speeds[0] * np.minimum(since, 0.0) + speeds[1] * np.maximum(until, 0.0)
    return np.asarray((motion.values - turn.arrival.value - lines)[is_near], dtype=np.float64)


def _measure_speeds(motion: Signal, turn: Turn) -> tuple[float, float]:
    """Return the speeds before arrival and after departure, by means half a second apart, m/s."""
    before = [_mean_near(motion, turn.arrival.time - shift) for shift in (1.0, 0.5)]
    after = [_mean_near(motion, turn.departure.time + shift) for shift in (0.5, 1.0)]
    speeds = [
        (b[1] - a[1]) / (b[0] - a[0]) if b[0] > a[0] else float("nan") for a, b in (before, after)
    ]
    return speeds[0], speeds[1]


def _mean_near(motion: Signal, centre: float) -> tuple[float, float]:
    """Return mean time and value of the finite samples within a quarter of a second of a time."""
    is_near = (np.abs(motion.time - centre) <= 0.25) & ~np.isnan(motion.values)
    if not is_near.any():
        return float("nan"), float("nan")
    return float(motion.time[is_near].mean()), float(motion.values[is_near].mean())


MAX_CORNER_ERROR = 0.1
"""s, standard error below which a corner of the force may join clocks."""


def match_strokes(
    motion: Signal, force: Signal, strokes: tuple[Stroke, ...], *, sign: int
) -> tuple[list[tuple[int, float]], bool, str]:
    """Pair the upper turns of a motion with the peaks of a force.

    Parameters
    ----------
    motion, force : each on its own clock
    strokes : of the motion
    sign : of the strokes that load

    Returns
    -------
    pairs : number of the stroke that ends at the turn, and rough time of the peak, s
    is_ambiguous : whether another pairing fits as well, perhaps beyond a record that begins or ends
        in mid-test
    counted : text with the numbers of peaks
    """
    turn_times = [
        (number, 0.5 * float(motion.time[before.stop] + motion.time[after.start]))
        for number, (before, after) in enumerate(pairwise(strokes))
        if before.sign == sign
    ]
    peaks = find_rough_peaks(force.time, force.values, smoothing=0.5, share=0.3)
    times = np.array([top for _, top in turn_times])
    pairs, is_ambiguous = match_peaks(times, peaks)
    if (
        len(pairs)
        and len(times) > 1
        and not (_begins_and_ends_at_rest(motion) and _begins_and_ends_at_rest(force))
    ):
        lag = float(np.median(peaks[pairs[:, 1]] - times[pairs[:, 0]]))
        is_ambiguous |= abs(lag) > 0.5 * float(np.diff(times).min())
    matched = [(turn_times[first][0], float(peaks[second])) for first, second in pairs.tolist()]
    return (
        matched,
        is_ambiguous,
        f"{len(turn_times)} peaks of the motion, {len(peaks)} of the force",
    )


def _begins_and_ends_at_rest(signal: Signal) -> bool:
    """Check whether a record begins and ends at rest, far below its peaks."""
    max_rest_share = 0.2  # of the range of the signal
    finite = signal.values[~np.isnan(signal.values)]
    size = max(1, len(finite) // 200)
    ends = float(finite[:size].mean()), float(finite[-size:].mean())
    return max(ends) < float(finite.min()) + max_rest_share * float(np.ptp(finite))


def find_turn_event(
    force: Signal, turn: Turn, near: float, *, window: float
) -> tuple[Corner, Reversal] | None:
    """Find the corner of the force at a turn of the motion.

    Parameters
    ----------
    force : on its own clock
    turn : of the motion
    near : rough time at which the force turns, anywhere in the dwell, s
    window : s on each side of a corner

    Returns
    -------
    The corner of the motion and that of the force; None if the error of the latter is 0.1 s or
    more. With a dwell, both corners of the force give one event, because their distance is known
    from the motion. They are fitted together in a dwell of up to two windows, so that they cannot
    be confused, and separately in a longer one.
    """
    search_reach = 1.0  # s around the rough turn of the force
    dwell = turn.dwell
    reach = dwell + search_reach  # the rough turn may be at either corner
    first = find_turn_near(
        force.time, force.values, near=near, reach=reach, width=window, dwell=dwell
    )
    if first is None:
        return None
    if dwell <= 2.0 * window:
        error = max(corner.time_error for corner in turn.corners)
        corners = [(replace(turn.arrival, time_error=error), first, dwell)]
    else:
        corners = [(turn.arrival, first, 0.0), (turn.departure, first + dwell, 0.0)]
    events = []
    for corner, time, wait in corners:
        reach = window + wait
        part = slice(*np.searchsorted(force.time, [time - reach, time + reach]))
        inside = force.time[part], force.values[part]
        reversal = fit_reversal(*inside, near=time, window=window, dwell=wait)
        if reversal is not None and reversal.corner.time_error < MAX_CORNER_ERROR:
            events.append((corner, reversal))
    return _average_events(events)


def _average_events(events: list[tuple[Corner, Reversal]]) -> tuple[Corner, Reversal] | None:
    """Combine the corners of a turn into one event, weighted by their errors."""
    if len(events) < 2:
        return events[0] if events else None
    motion_events, force_events = [event[0] for event in events], [event[1] for event in events]
    times = np.array(
        [[motion_event.time, force_event.corner.time] for motion_event, force_event in events]
    )
    errors = np.array(
        [
            [motion_event.time_error, force_event.corner.time_error]
            for motion_event, force_event in events
        ]
    )
    lag_errors = np.hypot(errors[:, 0], errors[:, 1])
    weights = lag_errors**-2.0 / (lag_errors**-2.0).sum()
    lags = times[:, 1] - times[:, 0]
    scatter_factor = max(1.0, abs(float(lags[1] - lags[0])) / float(np.hypot(*lag_errors)))
    mean_time, error = weights @ times, scatter_factor * np.sqrt(weights**2 @ errors**2)
    shape_error = float(weights @ [reversal.shape_error for reversal in force_events])
    corner = replace(force_events[0].corner, time=float(mean_time[1]), time_error=float(error[1]))
    return (
        replace(motion_events[0], time=float(mean_time[0]), time_error=float(error[0])),
        Reversal(corner, shape_error),
    )


def find_turn_events(
    force: Signal, pairs: list[tuple[int, float]], turns: list[Turn], window: float
) -> list[tuple[Corner, Reversal]]:
    """Find the corners of a force at the turns of a motion that are paired with its peaks.

    Parameters
    ----------
    force : on its own clock, rising in loading
    pairs : from `match_strokes`
    turns : of the motion
    window : s on each side of a corner
    """
    turn_of_stroke = {turn.stroke: turn for turn in turns}
    events = (
        find_turn_event(force, turn_of_stroke[stroke], near, window=window)
        for stroke, near in pairs
        if stroke in turn_of_stroke
    )
    return [event for event in events if event is not None]
