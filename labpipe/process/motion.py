"""The motion of a test: its strokes, where it turns, and where the force turns with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from labpipe.protocol.schema import Branches
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch
from labpipe.records.quality import (
    Finding,
    blocking,
    doubtful,
)
from labpipe.records.signals import Clocks, Signal, Stretch
from labpipe.signal.clock_alignment import match_peaks, rough_peaks
from labpipe.signal.corners import Corner, fit_corner, fit_stop
from labpipe.signal.reversals import Reversal, fit_reversal
from labpipe.signal.turning_points import (
    Stroke,
    find_strokes,
    goes_down,
    noise_level,
    split_branches,
    turn_near,
)

_SEEN = 0.5
"""s on each side of a turning point in which the motion must have been seen."""
_UNSEEN = 0.3
"""Share of the samples there that may be missing."""
_FIRST_WAIT = 0.2
"""s; how long a wait is looked for where the strokes show none."""
_WAITED, _TOGETHER = (2.4, 1.5), 3
"""A wait is longer than so many times what noise makes of a corner: one alone, and where the median
of so many turns at least is."""
_SAMPLES = 3
"""Samples that a wait at a single turn takes at least."""
_NO_WAIT = 1e-6
"""s; a wait as short as that is none."""
_ROUNDED = (0.05, 0.25)
"""s on each side of a turn that are compared with straight lines that meet there."""
_SURELY_WAITS = 9.0
"""Difference of chi-squares above which a machine waits, and does not slow down."""
_SLOWS, _TRIED = (0.4, 1.5), 23
"""Half lengths of slowing down that are tried, in waits, and how many."""
_CUT = 5e-6
"""m that a corner may be cut by."""


_FAR_OFF = 5.0
"""Standard deviations that noise alone may reach."""


def strokes_of(motion: Signal, block: Branches) -> tuple[tuple[Stroke, ...], list[Finding]]:
    """Find the strokes of a motion; what blocks the test where it shows none.

    Parameters
    ----------
    motion : the channel that branches are split by
    block : of the protocol: its name, and how long a stroke is at least
    """
    least, noise = block.min_stroke, noise_level(motion.values)
    strokes = find_strokes(motion.time, motion.values, min_stroke=least)
    if _FAR_OFF * noise > least:
        message = (
            f"the motion scatters by {1e3 * noise:.3g} mm from sample to sample, too much to tell "
            f"strokes of min_stroke, {1e3 * least:.3g} mm: is it the right channel?"
        )
        return (), [blocking("no_motion", block.channel, message)]
    if not strokes:
        span = float(np.nanmax(motion.values) - np.nanmin(motion.values))
        message = f"the motion spans {1e3 * span:.3g} mm, less than min_stroke"
        return (), [blocking("no_motion", block.channel, message)]
    return strokes, []


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of a test, split where it turns.

    Parameters
    ----------
    signal : the channel that the branches are split by
    branches : of it
    clocks : joined where it turns
    """

    signal: Signal
    branches: tuple[Branch, ...]
    clocks: Clocks


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
    def dwell(self) -> float:
        """Time between arrival and departure, s."""
        return self.departure.time - self.arrival.time

    @property
    def corners(self) -> tuple[Corner, ...]:
        """The corners, each once."""
        return (self.arrival,) if self.arrival is self.departure else (self.arrival, self.departure)


def turning_points(motion: Signal, strokes: tuple[Stroke, ...], *, window: float) -> list[Turn]:
    """Find when a motion turns, by straight lines on both sides of each corner.

    Parameters
    ----------
    motion : the travel on its own clock
    strokes : of that motion
    window : s on each side, cut to the length of the strokes

    Returns
    -------
    The turns in order. Those without a clear corner, or not seen themselves, are left out.

    Notes
    -----
    At 1 mm/s, with 10 um of noise and 50 frames per second, a wait of 80 ms is seen at a single
    turn, and one of 50 ms at times where five turns are looked at together. What lasts for fewer
    than three samples passes for a corner.
    """
    found = []
    for number, (before, after) in enumerate(pairwise(strokes)):
        ends = motion.time[[before.start, before.stop, after.start, after.stop]]
        reach = min(window, 0.95 * float(min(ends[1] - ends[0], ends[3] - ends[2])))
        one = _seen_turn(motion, number, (float(ends[1]), float(ends[2])), reach)
        if one is not None:
            found.append(one)
    all_wait = _all_wait(motion, [wait for _, wait in found])
    shortest = _SAMPLES * median(np.diff(motion.time))
    turns = []
    for turn, wait in found:
        waits = wait is not None and (
            all_wait or wait.dwell > max(_WAITED[0] * _from_noise(motion, wait), shortest)
        )
        chosen = wait if waits or turn is None else turn
        if chosen is not None:
            turns.append(chosen)
    return turns


def branches_between(
    motion: Signal, strokes: tuple[Stroke, ...], turns: list[Turn]
) -> tuple[Branch, ...]:
    """Split a motion into branches, at its turns where these are known better than to a sample."""
    times = np.full((len(strokes), 2), np.nan)
    for turn in turns:
        times[turn.stroke, 1] = turn.arrival.time
        times[turn.stroke + 1, 0] = turn.departure.time
    return split_branches(motion.time, strokes, turning_times=times)


def upright(force: Signal) -> Signal:
    """Turn a force that falls where others rise: a reversed bridge turns when any other does."""
    return replace(force, values=-force.values) if goes_down(force.values) else force


def _seen_turn(
    motion: Signal, number: int, near: tuple[float, float], window: float
) -> tuple[Turn | None, Turn | None] | None:
    """A turn without a wait, where the strokes show none, and with one; None where unseen."""
    around = (np.abs(motion.time - at) <= _SEEN for at in near)
    if not all(np.isnan(motion.values[each]).mean() <= _UNSEEN for each in around):
        return None
    at_once = None
    if near[0] == near[1]:
        corner = fit_corner(motion.time, motion.values, near=near[0], window=window, degree=1)
        if corner is None or not np.isfinite(corner.time_error):
            return None
        at_once = Turn(number, corner, corner)
        near = corner.time - 0.5 * _FIRST_WAIT, corner.time + 0.5 * _FIRST_WAIT
    stop = fit_stop(motion.time, motion.values, near=near, window=window)
    return at_once, None if stop is None else Turn(number, *stop)


def _from_noise(motion: Signal, turn: Turn) -> float:
    """How long a wait noise makes of a corner, s.

    A level of n samples is known to noise / sqrt(n), and lies a quarter of the wait times the speed
    below the mean of a corner: the two are alike for (16 noise^2 / (speed^2 rate))^(1/3).
    """
    speed = float(np.min(np.abs(_speeds(motion, turn))))
    if not speed > 0.0:
        return 0.0
    step = median(np.diff(motion.time))
    return float(np.cbrt(16.0 * noise_level(motion.values) ** 2 * step / speed**2))


def _all_wait(motion: Signal, waits: list[Turn | None]) -> bool:
    """Whether the machine waits at every turn, by the median of all: short waits show together."""
    shares = [
        0.0 if wait is None else wait.dwell / max(_from_noise(motion, wait), _NO_WAIT)
        for wait in waits
    ]
    return len(waits) >= _TOGETHER and median(np.array(shares)) > _WAITED[1]


def check_turns(
    motion: Signal, strokes: tuple[Stroke, ...], turns: list[Turn], *, for_clock: bool = True
) -> Iterator[Finding]:
    """Doubt turning points that were not seen, or that are no corners.

    Parameters
    ----------
    motion, strokes, turns : the travel, its strokes, and the turns that were found between them
    for_clock : whether clocks were joined at these turns, and are doubtful as well
    """
    clock = ("clock",) if for_clock else ()
    found = {turn.stroke: turn for turn in turns}
    for number, (before, _) in enumerate(pairwise(strokes)):
        if number not in found:
            at = float(motion.time[before.stop])
            yield doubtful(
                "turn_not_seen",
                "travel",
                f"the motion was not seen to turn near {at:.2f} s",
                "displacement",
                "force",
                *clock,
                during=_unseen(motion, at),
                clock=motion.clock,
            )
    rounded = [corner for turn in turns for corner in _corners(motion, turn)]
    rounded += _waits(motion, [turn for turn in turns if turn.dwell > 0.0])
    for (start, stop), message in rounded:
        for quantity, during in (
            ("displacement", (start, stop)),
            *((each, None) for each in clock),
        ):
            yield doubtful(
                "turn_rounded",
                "travel",
                message,
                quantity,
                during=during,
                clock=motion.clock if during else "",
            )


def _unseen(motion: Signal, at: float) -> tuple[float, float]:
    """From the last sample before a turn to the first behind it, s."""
    known = motion.time[~np.isnan(motion.values)]
    before, after = known[known < at], known[known > at]
    return float(before[-1] if len(before) else at), float(after[0] if len(after) else at)


Rounded: TypeAlias = tuple[Stretch, str]
"""When a motion is off a corner, and why that matters."""


def _corners(motion: Signal, turn: Turn) -> Iterator[Rounded]:
    """A machine that slows down, or waits for too short a time to tell, cuts the corner."""
    noise, speeds = noise_level(motion.values), _speeds(motion, turn)
    for width in _ROUNDED:
        off = _off_corners(motion, turn, speeds, width)
        if not len(off):
            continue
        if turn.dwell == 0.0:
            cut = abs(float(off.mean()))
            limit = 6.0 * noise / np.sqrt(len(off)) + _CUT
        else:
            cut = float(np.sqrt(np.mean(off**2)))
            limit = float(
                np.hypot(noise * np.sqrt(1.0 + 6.0 * np.sqrt(2.0 / len(off))), 2.0 * _CUT)
            )
        if cut > limit:
            message = (
                f"the travel turns {1e6 * cut:.0f} um off a corner at {turn.middle:.2f} s: the "
                "machine slows down or waits there, so that the moment of turning is less sure "
                "than stated"
            )
            yield _around(turn, width), message
            return


def _waits(motion: Signal, turns: list[Turn]) -> list[Rounded]:
    """Short waits that a machine which slows down evenly would show as well."""
    if not turns or sum(_more_than_slow(motion, turn) for turn in turns) > _SURELY_WAITS:
        return []
    dwell = median(np.array([turn.dwell for turn in turns]))
    message = (
        f"the machine waits for {dwell:.2f} s where it turns, or slows down there for longer: the "
        "travel does not tell which, so that the moment of turning is less sure than stated"
    )
    return [(_around(turn, _ROUNDED[0]), message) for turn in turns]


def _around(turn: Turn, width: float) -> Stretch:
    return turn.arrival.time - width, turn.departure.time + width


def _more_than_slow(motion: Signal, turn: Turn) -> float:
    """By how much a wait is likelier than even slowing down: difference of chi-squares.

    A motion whose speed changes evenly is a parabola that touches the lines before and after, as
    long before as after they meet; how long is fitted.
    """
    first, last = _speeds(motion, turn)
    met = (first * turn.arrival.time - last * turn.departure.time) / (first - last)
    near = (np.abs(motion.time - met) <= _SLOWS[1] * turn.dwell) & ~np.isnan(motion.values)
    since = motion.time[near] - met
    off = motion.values[near] - turn.arrival.value - first * (met - turn.arrival.time)
    off -= np.where(since < 0.0, first, last) * since
    waited = first * (turn.arrival.time - met) + np.where(since < 0.0, -first, -last) * since
    waits = np.minimum(waited, 0.0) if first > 0.0 else np.maximum(waited, 0.0)
    halves = np.linspace(*_SLOWS, _TRIED)[:, None] * turn.dwell
    slow = (last - first) / (4.0 * halves) * np.maximum(halves - np.abs(since), 0.0) ** 2
    best = float(((off - slow) ** 2).sum(axis=1).min())
    noise = max(noise_level(motion.values), 1e-3 * _CUT)
    return (best - float(((off - waits) ** 2).sum())) / noise**2


def _off_corners(motion: Signal, turn: Turn, speeds: tuple[float, float], width: float) -> Floats:
    """How far the motion is off straight lines that meet in the corners, near these, m."""
    since, until = motion.time - turn.arrival.time, motion.time - turn.departure.time
    near = (since >= -width) & (until <= width) & ~np.isnan(motion.values)
    lines = speeds[0] * np.minimum(since, 0.0) + speeds[1] * np.maximum(until, 0.0)
    return np.asarray((motion.values - turn.arrival.value - lines)[near], dtype=np.float64)


def _speeds(motion: Signal, turn: Turn) -> tuple[float, float]:
    """Speeds before the arrival and after the departure, by means half a second apart, m/s."""
    before = [_mean_near(motion, turn.arrival.time - shift) for shift in (1.0, 0.5)]
    after = [_mean_near(motion, turn.departure.time + shift) for shift in (0.5, 1.0)]
    speeds = [
        (b[1] - a[1]) / (b[0] - a[0]) if b[0] > a[0] else float("nan") for a, b in (before, after)
    ]
    return speeds[0], speeds[1]


def _mean_near(motion: Signal, at: float) -> tuple[float, float]:
    """Mean time and value of the samples that are known within a quarter of a second of a time."""
    near = (np.abs(motion.time - at) <= 0.25) & ~np.isnan(motion.values)
    if not near.any():
        return float("nan"), float("nan")
    return float(motion.time[near].mean()), float(motion.values[near].mean())


_RESTS = 0.2
"""Share of its range above its lowest value below which a signal rests."""
_ROUGH = 1.0
"""s on each side of what a force was roughly seen to turn at, in which its corner is looked for."""
WORST_CORNER = 0.1
"""s; a corner of the force known no better than this says nothing about a clock."""


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
        reach = window + wait
        part = slice(*np.searchsorted(force.time, [at - reach, at + reach]))
        inside = force.time[part], force.values[part]
        pulled = fit_reversal(*inside, near=at, window=window, dwell=wait)
        if pulled is not None and pulled.corner.time_error < WORST_CORNER:
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


def turn_events(
    force: Signal, pairs: list[tuple[int, float]], turns: list[Turn], window: float
) -> list[tuple[Corner, Reversal]]:
    """Find what a force shows of the turns of a motion that are paired with its peaks.

    Parameters
    ----------
    force : on its own clock, upright
    pairs : from `match_strokes`
    turns : of the motion
    window : s on each side of a corner
    """
    seen = {turn.stroke: turn for turn in turns}
    events = (
        turn_event(force, seen[stroke], near, window=window)
        for stroke, near in pairs
        if stroke in seen
    )
    return [event for event in events if event is not None]
