"""The numbers of a test as a technician would take them from a table of samples, with a ruler.

Nothing here is fitted but straight lines. Where two ways to take a number are equally plain, such
as a dwell that may count for the branch before or behind it, the number is the stretch between
both (`Plain`), and any value in it is right.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Samples = npt.NDArray[np.float64]
FAST = 0.05
"""s, in which a final loss falls by a tenth of the peak (one sample step where that is longer)."""
TENTH = 0.1
HALF = 0.5
STANDING = 1e-3
"""Share of the stroke within which the motion stands at its turn."""


@dataclass(frozen=True)
class Record:
    """One test as its file has it, in s, m and N; `time` is None where the file has none."""

    time: Samples | None
    travel: Samples
    force: Samples
    shaken: float | None = None
    """Noise of the travel before a filter, m."""

    def seen(self) -> Record:
        """The rows in which both channels have a number."""
        rows = np.isfinite(self.travel) & np.isfinite(self.force)
        time = None if self.time is None else self.time[rows]
        return Record(time, self.travel[rows], self.force[rows])


@dataclass(frozen=True)
class Plain:
    """A number between `low` and `high`; both the same where there is only one way to take it."""

    low: float
    high: float

    @classmethod
    def of(cls, *values: float) -> Plain:
        return cls(float(min(values)), float(max(values)))

    def scaled(self, by: float) -> Plain:
        return Plain.of(by * self.low, by * self.high)


@dataclass(frozen=True)
class Cycle:
    """Samples of a cycle: where loading begins, where it turns, and the last one of unloading.

    A motion that stands at its turn does so from `turn` to `stands`. `end` is None if nothing
    follows.
    """

    begin: int
    turn: int
    stands: int
    end: int | None


def turning_points(travel: Samples, stroke: float) -> list[int]:
    """Samples of the first extreme, of each that the motion comes back from, and of the last."""
    low = high = 0
    way = 0
    found: list[int] = []
    for i, value in enumerate(travel):
        low = i if value < travel[low] else low
        high = i if value > travel[high] else high
        if way >= 0 and travel[high] - value >= stroke:
            found.append(high)
            way, low = -1, i
        elif way <= 0 and value - travel[low] >= stroke:
            found.append(low)
            way, high = 1, i
    return [*found, high if way > 0 else low] if way else []


def cycles(travel: Samples, stroke: float) -> list[Cycle]:
    """Loading is the direction of the first stroke that is at least `stroke` long."""
    at = turning_points(travel, stroke)
    found = []
    for k in range(0, len(at) - 1, 2):
        begin, turn = at[k], at[k + 1]
        end = at[k + 2] if k + 2 < len(at) else None
        near = STANDING * abs(travel[turn] - travel[begin])
        still = np.flatnonzero(np.abs(travel[turn:end] - travel[turn]) <= near)
        found.append(Cycle(begin, turn, turn + int(still[-1]), end))
    return found


def sense(values: Samples) -> float:
    """1 if values grow from the first one on, as told by the one farthest off it; else -1."""
    away = values - values[0]
    return 1.0 if away[int(np.argmax(np.abs(away)))] >= 0 else -1.0


def peak_force(record: Record, cycle: Cycle, way: float) -> Plain:
    """Largest force of the loading branch in the sense of loading; a dwell may count for it."""
    first = np.max(way * record.force[cycle.begin : cycle.turn + 1])
    last = np.max(way * record.force[cycle.begin : cycle.stands + 1])
    return Plain.of(way * first, way * last)


def peak_displacement(record: Record, cycle: Cycle) -> Plain:
    return Plain.of(record.travel[cycle.turn])


def line(x: Samples, y: Samples) -> tuple[float, float]:
    """Slope and height at x = 0 of the straight line by least squares."""
    slope = float(np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2))
    return slope, float(y.mean() - slope * x.mean())


def window(record: Record, cycle: Cycle, low: float, high: float) -> tuple[Samples, Samples]:
    """Displacement and force of the loading branch from `low` until `high` is passed, m."""
    travel = record.travel[cycle.begin : cycle.turn + 1]
    way = 1.0 if travel[-1] >= travel[0] else -1.0
    inside = (way * travel >= low) & (way * travel <= high)
    return travel[inside], record.force[cycle.begin : cycle.turn + 1][inside]


def stiffness(record: Record, cycle: Cycle, low: float, high: float) -> Plain:
    return Plain.of(line(*window(record, cycle, low, high))[0])


def two_segments(x: Samples, y: Samples, tries: int = 4000) -> tuple[float, float, float]:
    """Both slopes and the break of the two lines that meet and leave the least squares."""

    def fitted(at: float) -> tuple[float, Samples]:
        design = np.column_stack([np.ones_like(x), np.minimum(x - at, 0), np.maximum(x - at, 0)])
        found, *_ = np.linalg.lstsq(design, y, rcond=None)
        return float(np.sum((y - design @ found) ** 2)), found

    places = np.linspace(float(x[2]), float(x[-3]), tries)
    best = float(min(places, key=lambda at: fitted(at)[0]))
    _, first, second = fitted(best)[1]
    return float(first), float(second), best


def trapezoid(travel: Samples, force: Samples) -> float:
    """Work, J."""
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(travel)))


def noise(values: Samples) -> float:
    """Standard deviation from sample to sample, by the median of the second differences."""
    bends = np.abs(np.diff(values, 2))
    return float(np.median(bends)) / 0.6745 / np.sqrt(6.0) if len(bends) else 0.0


def may_be_turns(record: Record, at: int) -> range:
    """Samples around a turn that noise does not tell from it; mostly the turn alone.

    Within six standard deviations: noise of a laser wanders by more than it differs from sample to
    sample.
    """
    shaken = noise(record.travel) if record.shaken is None else record.shaken
    near = np.abs(record.travel - record.travel[at]) <= 6.0 * shaken
    near[at] = True
    others = np.flatnonzero(~near)
    first = others[others < at]
    last = others[others > at]
    return range(int(first[-1]) + 1 if len(first) else 0, int(last[0]) if len(last) else len(near))


def energy(record: Record, cycle: Cycle) -> Plain | None:
    """Trapezoids from turn to turn, whichever of the samples there is called the turn."""
    if cycle.end is None:
        return None
    steps = 0.5 * (record.force[1:] + record.force[:-1]) * np.diff(record.travel)
    work = np.concatenate([[0.0], np.cumsum(steps)])
    begins = work[list(may_be_turns(record, cycle.begin))]
    ends = work[list(may_be_turns(record, cycle.end))]
    own = work[cycle.end] - work[cycle.begin]
    return Plain.of(own, ends.max() - begins.min(), ends.min() - begins.max())


def fall(record: Record, at: int, force: Samples) -> float:
    """By how much the force is lower at most within 50 ms behind a sample, or one step behind."""
    stop = at + 2
    if record.time is not None:
        stop = max(stop, int(np.searchsorted(record.time, record.time[at] + FAST, "right")))
    return float(force[at] - np.min(force[at:stop]))


@dataclass(frozen=True)
class Break:
    """First and last sample that may be called the one before the final loss.

    `sure` is False where a ruler may as well say that there is none.
    """

    first: int
    last: int
    sure: bool = True


def failure(record: Record, cycle: Cycle) -> Break | None:
    """The break in the loading branch of a cycle, None without.

    From the last sample with half of the peak that the force does not come back to, back as long as
    the force falls by a tenth of the peak within 50 ms. "Within 50 ms behind the sample" and "as
    fast as that from this sample to the next" are equally plain; the one gives the first sample,
    the other the last, at most 50 ms or a step apart.

    Where the force is lost fast enough only below half of the peak, the specimen tore slowly or
    broke; where it is never lost fast enough although the motion goes on, it tore slowly from the
    last sample with half of the peak on, or did not fail. Both may be said.
    """
    force = sense(record.force[cycle.begin : cycle.turn + 1]) * record.force
    tenth = TENTH * float(np.max(force))
    held = int(np.flatnonzero(force >= HALF * np.max(force))[-1])
    if held >= cycle.stands or held < cycle.begin:
        return None
    if fall(record, held, force) < tenth:
        late = [i for i in range(held, cycle.stands) if fall(record, i, force) >= tenth]
        if not late and not goes_on(
            record.travel[cycle.begin : cycle.turn + 1], held - cycle.begin
        ):
            return None
        return Break(held, late[0] if late else held, sure=False)
    first = last = held
    while first > cycle.begin and fall(record, first - 1, force) >= tenth:
        first -= 1
    while last > first and force[last - 1] - force[last] >= _step(record, last) * tenth:
        last -= 1
    return Break(first, last)


def goes_on(travel: Samples, at: int) -> bool:
    """Whether the motion behind a sample is at least a hundredth of the way to it."""
    return bool(abs(travel[-1] - travel[at]) >= 0.01 * abs(travel[at] - travel[0]))


def _step(record: Record, at: int) -> float:
    """The step to a sample as a share of 50 ms; 1 where it is longer."""
    if record.time is None:
        return 1.0
    return min(float(record.time[at] - record.time[at - 1]) / FAST, 1.0)


def slack(record: Record, cycle: Cycle, low: float = 0.1, high: float = 0.3) -> float:
    """Where the line through the force between two shares of its largest meets zero force, m."""
    branch = slice(cycle.begin, cycle.turn + 1)
    force, travel = record.force[branch], record.travel[branch]
    top = int(np.argmax(force))
    first = int(np.flatnonzero(force >= low * force[top])[0])
    stop = int(np.flatnonzero(force > high * force[top])[0])
    slope, height = line(travel[first:stop], force[first:stop])
    return -height / slope


def moving_average(
    values: Samples, samples: int, pieces: list[int], *, centred: bool = True
) -> Samples:
    """Mean over a window of an odd number of samples, which ends where a piece does.

    Pieces run from each of the samples `pieces` to the next. At the ends of a piece the window is
    as wide to the left as to the right of its sample (`centred`), or one-sided.
    """
    found = values.copy()
    for begin, end in pairwise([0, *pieces, len(values) - 1]):
        for i in range(begin, end + 1):
            left = right = samples // 2
            if centred:
                left = right = min(samples // 2, i - begin, end - i)
            found[i] = np.mean(values[max(i - left, begin) : min(i + right, end) + 1])
    return found


def straight_ends(values: Samples, samples: int, pieces: list[int]) -> Samples:
    """The moving average, with FORECAST over the last window in the last half window of a piece.

    As the reference page of protocols has it: the line stays within what was measured there.
    """
    found = moving_average(values, samples, pieces)
    number = np.arange(samples, dtype=np.float64)
    for begin, end in pairwise([0, *pieces, len(values) - 1]):
        for first, inside in (
            (begin, slice(samples // 2)),
            (end + 1 - samples, slice(-(samples // 2), None)),
        ):
            if end + 1 - begin >= samples:
                seen = values[first : first + samples]
                slope, height = line(number, seen)
                ruled = np.clip(height + slope * number, seen.min(), seen.max())
                found[first : first + samples][inside] = ruled[inside]
    return found


def filtered(record: Record, samples: int, stroke: float) -> list[Record]:
    """Both channels after a moving average that acts from turn to turn.

    There are three records, since a window may stay centred at a turn, become one-sided, or give
    way to a line: the first keeps the corner and its noise, the second lowers it by a quarter of
    what the window spans, the third is what the reference page says.
    """
    if samples < 2:
        return [record]
    parts = cycles(record.travel, stroke)
    pieces = [i for cycle in parts for i in (cycle.begin, cycle.turn)]
    return [
        Record(record.time, way(record.travel), way(record.force), noise(record.travel))
        for way in (
            partial(moving_average, samples=samples, pieces=pieces),
            partial(moving_average, samples=samples, pieces=pieces, centred=False),
            partial(straight_ends, samples=samples, pieces=pieces),
        )
    ]


SEGMENTS = ("segment_stiffness_first", "segment_stiffness_second", "break_point")
AT_BREAK = ("failure_displacement", "failure_force", "energy_to_break")
FEWEST = {"stiffness": 8, "energy.*": 16}
"""Samples that the reference page of the results asks for; with fewer a result may be refused."""


@dataclass(frozen=True)
class Asked:
    """What the protocol of a test asks for; lengths in mm."""

    window: tuple[float, float] | None = (2.0, 8.0)
    min_stroke: float = 1.0
    slack: bool = False
    failure: bool = True
    segments: bool = False
    """Whether two straight segments are asked for over the window."""


USUAL = Asked()


def plain_numbers(record: Record, asked: Asked) -> dict[str, Plain | None]:
    """Every number that the record has; None for those that it cannot have."""
    found: dict[str, Plain | None] = {}
    parts = cycles(record.travel, 1e-3 * asked.min_stroke)
    if asked.slack and parts:
        found["slack"] = Plain.of(taken := slack(record, parts[0]))
        record = Record(record.time, record.travel - taken, record.force)
    if asked.window is not None:
        found["stiffness"] = _stiffness(record, parts, asked.window)
    if asked.segments and asked.window is not None:
        low, high = 1e-3 * asked.window[0], 1e-3 * asked.window[1]
        values = two_segments(*window(record, parts[0], low, high))
        found |= {name: Plain.of(value) for name, value in zip(SEGMENTS, values, strict=True)}
    for number, cycle in enumerate(parts, start=1):
        way = sense(record.force[parts[0].begin : parts[0].turn + 1])
        found[f"peak_force.{number}"] = peak_force(record, cycle, way)
        found[f"peak_displacement.{number}"] = peak_displacement(record, cycle)
        found[f"energy.{number}"] = energy(record, cycle)
    return found | (_failure(record, parts) if asked.failure else {})


def either(found: Iterable[dict[str, Plain | None]]) -> dict[str, Plain | None]:
    """Numbers that were taken in several ways: from the lowest to the highest."""
    first, *others = found
    return {
        name: plain and Plain.of(*(end for other in (first, *others) for end in _ends(other[name])))
        for name, plain in first.items()
    }


def _ends(plain: Plain | None) -> tuple[float, ...]:
    return () if plain is None else (plain.low, plain.high)


def _stiffness(record: Record, parts: list[Cycle], limits: tuple[float, float]) -> Plain | None:
    low, high = 1e-3 * limits[0], 1e-3 * limits[1]
    if not parts or len(window(record, parts[0], low, high)[0]) < 3:
        return None
    return stiffness(record, parts[0], low, high)


def broken(record: Record, parts: list[Cycle]) -> Break | None:
    """The break in the branch that holds the largest force."""
    if not parts:
        return None
    force = sense(record.force[parts[0].begin : parts[0].turn + 1]) * record.force
    top = int(np.argmax(force))
    inside = [cycle for cycle in parts if cycle.begin <= top <= cycle.stands]
    return failure(record, inside[-1]) if inside else None


def _failure(record: Record, parts: list[Cycle]) -> dict[str, Plain | None]:
    found = broken(record, parts)
    if found is None:
        return dict.fromkeys(AT_BREAK)
    between = slice(found.first, found.last + 1)
    works = (
        trapezoid(record.travel[: i + 1], record.force[: i + 1]) for i in (found.first, found.last)
    )
    return {
        "failure_displacement": Plain.of(*record.travel[between]),
        "failure_force": Plain.of(*record.force[between]),
        "energy_to_break": Plain.of(*works),
    }


def excused(record: Record, asked: Asked) -> dict[str, str]:
    """Results that may be refused, with the code: few samples, no unloading, no break, a hole.

    A hole of five ordinary steps within five samples of a turn may hide the peak.
    """
    parts = cycles(record.travel, 1e-3 * asked.min_stroke)
    found = dict.fromkeys(SEGMENTS, "no_bend") if asked.segments else {}
    torn = broken(record, parts)
    if torn is not None and not torn.sure:
        found |= dict.fromkeys(AT_BREAK, "no_break|no_failure")
    if parts and asked.window is not None:
        limits = 1e-3 * asked.window[0], 1e-3 * asked.window[1]
        if len(window(record, parts[0], *limits)[0]) < FEWEST["stiffness"]:
            found["stiffness"] = "too_few_samples|not_reached"
    for number, cycle in enumerate(parts, start=1):
        if cycle.end is not None and cycle.end + 1 - cycle.begin <= FEWEST["energy.*"]:
            found[f"energy.{number}"] = "too_few_samples"
        if record.time is not None:
            steps = np.diff(record.time)
            if np.max(steps[max(cycle.turn - 5, 0) : cycle.turn + 5]) > 5.0 * np.median(steps):
                found[f"peak_*.{number}"] = "turn_not_seen"
    return found | (_open(record, parts[-1], len(parts)) if parts else {})


def _open(record: Record, cycle: Cycle, number: int) -> dict[str, str]:
    """What of the last cycle may go on behind the record: it may be said, and need not.

    A motion that ends within two samples of its farthest may go farther, and a force that is not
    lost by then may grow; a motion that is not back within 2 % of its stroke has not unloaded.
    """
    last = len(record.travel) - 1
    found = {} if cycle.end is not None else {f"energy.{number}": "partial_cycle"}
    if cycle.end is None and last - cycle.turn <= 2:
        found[f"peak_displacement.{number}"] = "partial_cycle"
        if abs(record.force[last]) >= HALF * np.max(np.abs(record.force[cycle.begin :])):
            found[f"peak_force.{number}"] = "partial_cycle"
    stroke = abs(record.travel[cycle.turn] - record.travel[cycle.begin])
    if abs(record.travel[last] - record.travel[cycle.begin]) > 0.02 * stroke:
        found[f"energy.{number}"] = "partial_cycle"
    return found
