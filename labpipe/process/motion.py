"""Find strokes, turns and branches of the motion, and the corners of the force at the turns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from labpipe.protocol.schema import Branches
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch
from labpipe.records.quality import Doubt, Finding
from labpipe.records.signals import Clocks, Signal
from labpipe.signal import turning_points
from labpipe.signal.clock_alignment import find_rough_peaks, match_peaks
from labpipe.signal.corners import Corner, fit_corner, fit_stop
from labpipe.signal.reversals import fit_reversal
from labpipe.signal.turning_points import Stroke, estimate_noise_level

CORNER_WIDTHS = (0.05, 0.25)
"""s on each side of a turn in which the motion is compared with straight lines."""
MAX_CORNER_CUT = 5e-6
"""m by which a motion may round a corner."""
MAX_CORNER_ERROR = 0.1
"""s, standard error below which a corner of the force may join clocks."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of a test, at each stage from its strokes to its branches.

    Parameters
    ----------
    signal : the channel that splits the branches
    branches : of the motion
    clocks : joined at its turns
    strokes, turns : of the motion; turns only where clocks are joined
    """

    signal: Signal
    branches: tuple[Branch, ...] = ()
    clocks: Clocks = field(default_factory=Clocks)
    strokes: tuple[Stroke, ...] = ()
    turns: tuple[Turn, ...] = ()


def find_motion_strokes(motion: Signal, block: Branches) -> tuple[Motion, list[Finding]]:
    """Find the strokes of a motion; without any, return a finding that blocks the curve.

    Parameters
    ----------
    motion : the channel that splits the branches
    block : of the protocol, with channel name and minimum stroke
    """
    noise_factor = 5.0  # standard deviations that noise alone may reach
    where, least, noise = block.channel, block.min_stroke, estimate_noise_level(motion.values)
    if noise_factor * noise > least:
        noise, least = 1e3 * noise, 1e3 * least
        return Motion(motion), [
            Finding.of("process.motion_is_noise", where, blocks=True, noise=noise, min_stroke=least)
        ]
    strokes = turning_points.find_strokes(motion.time, motion.values, min_stroke=least)
    if not strokes:
        span = 1e3 * float(np.nanmax(motion.values) - np.nanmin(motion.values))
        return Motion(motion), [Finding.of("process.no_motion", where, blocks=True, span=span)]
    return Motion(motion, strokes=strokes), []


def find_motion_turns(motion: Motion, *, window: float) -> tuple[Turn, ...]:
    """Find the times at which a motion turns, by straight lines on both sides of each corner.

    Parameters
    ----------
    motion : with its strokes
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
    # Multiple of the apparent dwell that noise causes, from which a single dwell is real, and from
    # which the median over at least three turns is: the machine then dwells at every turn.
    min_dwell_factor, min_median_factor, min_turns = 2.4, 1.5, 3
    min_dwell_samples, min_apparent_dwell = 3, 1e-6  # s
    signal, time = motion.signal, motion.signal.time
    candidates = []
    for number, (before, after) in enumerate(pairwise(motion.strokes)):
        ends = time[[before.start, before.stop, after.start, after.stop]].tolist()
        fit_width = min(window, 0.95 * min(ends[1] - ends[0], ends[3] - ends[2]))
        candidates += _fit_turn(signal, number, (ends[1], ends[2]), fit_width)
    apparent = [0.0 if x is None else _estimate_apparent_dwell(signal, x) for _, x in candidates]
    ratios = [
        0.0 if wait is None else wait.dwell / max(by_noise, min_apparent_dwell)
        for (_, wait), by_noise in zip(candidates, apparent, strict=True)
    ]
    everywhere = len(ratios) >= min_turns and median(np.array(ratios)) > min_median_factor
    shortest = min_dwell_samples * median(np.diff(time))
    turns = []
    for (turn, wait), by_noise in zip(candidates, apparent, strict=True):
        is_real = wait is not None and wait.dwell > max(min_dwell_factor * by_noise, shortest)
        waits = wait is not None and (everywhere or is_real)
        turns.append(wait if waits or turn is None else turn)
    return tuple(turn for turn in turns if turn is not None)


def split_at_turns(motion: Motion) -> tuple[Branch, ...]:
    """Split a motion into branches; known turns give their ends between samples."""
    times = np.full((len(motion.strokes), 2), np.nan)
    for turn in motion.turns:
        times[turn.stroke, 1] = turn.arrival.time
        times[turn.stroke + 1, 0] = turn.departure.time
    strokes = motion.strokes
    return turning_points.split_branches(motion.signal.time, strokes, turning_times=times)


def orient_force(force: Signal) -> Signal:
    """Reverse a force that falls in loading, so that its turns are peaks."""
    goes_down = turning_points.goes_down(force.values)
    return replace(force, values=-force.values) if goes_down else force


def _fit_turn(
    motion: Signal, number: int, near: tuple[float, float], window: float
) -> list[tuple[Turn | None, Turn | None]]:
    """Fit a turn as one corner and as a dwell; no fit if samples are missing there."""
    half_window, max_missing_share = 0.5, 0.3  # s on each side of a turn; of samples in it
    assumed_dwell = 0.2  # s, start of the fit if the strokes show no dwell
    nearby = (np.abs(motion.time - turn_time) <= half_window for turn_time in near)
    if not all(np.isnan(motion.values[is_near]).mean() <= max_missing_share for is_near in nearby):
        return []
    corner_turn = None
    if near[0] == near[1]:
        corner = fit_corner(motion.time, motion.values, near=near[0], window=window)
        if corner is None or not np.isfinite(corner.time_error):
            return []
        corner_turn = Turn(number, corner, corner)
        near = corner.time - 0.5 * assumed_dwell, corner.time + 0.5 * assumed_dwell
    stop = fit_stop(motion.time, motion.values, near=near, window=window)
    return [(corner_turn, None if stop is None else Turn(number, *stop))]


def _estimate_apparent_dwell(motion: Signal, turn: Turn) -> float:
    """Estimate the apparent dwell that noise causes at a corner, s.

    The mean of n samples has the error noise / sqrt(n). A dwell lowers the mean around a corner by
    a quarter of the dwell times the speed. Both are equal for a dwell of
    (16 noise^2 / (speed^2 rate))^(1/3).
    """
    speed = float(np.min(np.abs(_measure_speeds(motion, turn))))
    step, noise = median(np.diff(motion.time)), estimate_noise_level(motion.values)
    return float(np.cbrt(16.0 * noise**2 * step / speed**2)) if speed > 0.0 else 0.0


def check_turns(motion: Motion, *, for_clock: bool = True) -> Iterator[Finding]:
    """Report turning points that were not recorded, or that are rounded.

    Parameters
    ----------
    motion : with its turns
    for_clock : whether clocks were joined at these turns, so that they are doubtful as well
    """
    signal, seen_turns = motion.signal, {turn.stroke for turn in motion.turns}
    seen_times = signal.time[~np.isnan(signal.values)]
    quantities = ("displacement", "force", *(("clock",) if for_clock else ()))
    for number, before in enumerate(motion.strokes[:-1]):
        if number not in seen_turns:
            time = float(signal.time[before.stop])
            earlier, later = seen_times[seen_times < time], seen_times[seen_times > time]
            during = float([time, *earlier[-1:]][-1]), float([*later[:1], time][0])
            where, clock = "travel", signal.clock
            yield Finding.of(
                "process.turn_not_seen", where, *quantities, during=during, clock=clock, time=time
            )
    for finding in (x for turn in motion.turns for x in _find_rounded_corners(signal, turn)):
        yield finding
        if for_clock:
            yield Finding(finding.note, (Doubt("clock", finding.doubts[0].reason),))


def _find_rounded_corners(motion: Signal, turn: Turn) -> Iterator[Finding]:
    """Find a turn at which the motion rounds the corner; report it once."""
    noise, speeds = estimate_noise_level(motion.values), _measure_speeds(motion, turn)
    since, until = motion.time - turn.arrival.time, motion.time - turn.departure.time
    lines = speeds[0] * np.minimum(since, 0.0) + speeds[1] * np.maximum(until, 0.0)
    deviations = motion.values - turn.arrival.value - lines
    for width in CORNER_WIDTHS:
        near = deviations[(since >= -width) & (until <= width) & ~np.isnan(motion.values)]
        if not len(near):
            continue
        if turn.dwell == 0.0:
            cut = abs(float(near.mean()))
            limit = 6.0 * noise / np.sqrt(len(near)) + MAX_CORNER_CUT
        else:
            cut = float(np.sqrt(np.mean(near**2)))
            scatter = noise * np.sqrt(1.0 + 6.0 * np.sqrt(2.0 / len(near)))
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


def _measure_speeds(motion: Signal, turn: Turn) -> tuple[float, float]:
    """Return the speeds before arrival and after departure, by means half a second apart, m/s."""

    def speed_between(*places: float) -> float:
        is_valid, samples = ~np.isnan(motion.values), np.stack([motion.time, motion.values])
        parts = [samples[:, (np.abs(motion.time - x) <= 0.25) & is_valid] for x in places]
        if not all(part.size for part in parts):
            return float("nan")
        time, values = (parts[1].mean(axis=1) - parts[0].mean(axis=1)).tolist()
        return float(values / time) if time > 0.0 else float("nan")

    stop, start = turn.arrival.time, turn.departure.time
    return speed_between(stop - 1.0, stop - 0.5), speed_between(start + 0.5, start + 1.0)


def match_strokes(
    motion: Motion, force: Signal, *, sign: int
) -> tuple[list[tuple[int, float]], bool, str]:
    """Pair the upper turns of a motion with the peaks of a force.

    Parameters
    ----------
    motion, force : each on its own clock
    sign : of the strokes that load

    Returns
    -------
    pairs : number of the stroke that ends at the turn, and rough time of the peak, s
    is_ambiguous : whether another pairing fits as well, perhaps beyond a record that begins or ends
        in mid-test
    counted : text with the numbers of peaks
    """
    time = motion.signal.time
    tops = {
        number: 0.5 * float(time[before.stop] + time[after.start])
        for number, (before, after) in enumerate(pairwise(motion.strokes))
        if before.sign == sign
    }
    numbers, times = list(tops), np.array([*tops.values()])
    peaks = find_rough_peaks(force.time, force.values, smoothing=0.5, share=0.3)
    pairs, is_ambiguous = match_peaks(times, peaks)
    is_whole = all(_begins_and_ends_at_rest(signal) for signal in (motion.signal, force))
    if len(pairs) and len(times) > 1 and not is_whole:
        lag = float(np.median(peaks[pairs[:, 1]] - times[pairs[:, 0]]))
        is_ambiguous |= abs(lag) > 0.5 * float(np.diff(times).min())
    matched = [(numbers[first], float(peaks[second])) for first, second in pairs.tolist()]
    return matched, is_ambiguous, f"{len(tops)} peaks of the motion, {len(peaks)} of the force"


def _begins_and_ends_at_rest(signal: Signal) -> bool:
    """Check whether a record begins and ends at rest, far below its peaks."""
    max_rest_share = 0.2  # of the range of the signal
    finite = signal.values[~np.isnan(signal.values)]
    size = max(1, len(finite) // 200)
    ends = float(finite[:size].mean()), float(finite[-size:].mean())
    return max(ends) < float(finite.min()) + max_rest_share * float(np.ptp(finite))


def find_turn_events(
    force: Signal, pairs: list[tuple[int, float]], motion: Motion, window: float
) -> Floats:
    """Find the corners of a force at the turns of a motion that are paired with its peaks.

    Parameters
    ----------
    force : on its own clock, rising in loading
    pairs : from `match_strokes`
    motion : with its turns
    window : s on each side of a corner

    Returns
    -------
    Shape (4, events), s: times on the clocks of motion and force, standard error of their
    difference, and the part of its error from the unknown shape of the fall, which is common to all
    events of a specimen and does not average out.

    Notes
    -----
    A corner of the force with an error of 0.1 s or more is left out. With a dwell, both corners of
    the force give one event, because their distance is known from the motion. They are fitted
    together in a dwell of up to two windows, so that they cannot be confused, and separately in a
    longer one.
    """
    turns = {turn.stroke: turn for turn in motion.turns}
    found = (
        _find_corners(force, turns[number], near, window)
        for number, near in pairs
        if number in turns
    )
    events = [_average_corners(corners) for corners in found if len(corners)]
    return np.array(events, dtype=np.float64).reshape(-1, 4).T


def _find_corners(force: Signal, turn: Turn, near: float, window: float) -> Floats:
    """Return a row per corner: both times and their errors, and the error from shape, s."""
    search_reach = 1.0  # s around the rough turn of the force
    arrival, departure, dwell = turn.arrival, turn.departure, turn.dwell
    reach = dwell + search_reach  # the rough turn may be at either corner
    first = turning_points.find_turn_near(
        force.time, force.values, near=near, reach=reach, width=window, dwell=dwell
    )
    if first is None:
        return np.zeros((0, 5))
    error = max(arrival.time_error, departure.time_error)
    guesses = [(arrival.time, error, first, dwell)]
    if dwell > 2.0 * window:
        guesses = [(arrival.time, arrival.time_error, first, 0.0)]
        guesses.append((departure.time, departure.time_error, first + dwell, 0.0))
    rows = []
    for time, error, guess, wait in guesses:
        reach = window + wait
        part = slice(*np.searchsorted(force.time, [guess - reach, guess + reach]))
        inside = force.time[part], force.values[part]
        reversal = fit_reversal(*inside, near=guess, window=window, dwell=wait)
        if reversal is not None and reversal.corner.time_error < MAX_CORNER_ERROR:
            corner = reversal.corner
            rows.append([time, corner.time, error, corner.time_error, reversal.shape_error])
    return np.array(rows, dtype=np.float64).reshape(-1, 5)


def _average_corners(corners: Floats) -> list[float]:
    """Combine the corners of a turn into one event, weighted by their errors."""
    lags, lag_errors = corners[:, 1] - corners[:, 0], np.hypot(corners[:, 2], corners[:, 3])
    weights = lag_errors**-2.0 / (lag_errors**-2.0).sum()
    scatter = max(1.0, float(np.ptp(lags)) / float(np.linalg.norm(lag_errors)))
    errors = scatter * np.sqrt(weights**2 @ corners[:, 2:4] ** 2)
    mean = weights @ corners
    return [float(mean[0]), float(mean[1]), float(np.hypot(*errors)), float(mean[4])]
