"""Cyclic tests of a load frame that contradict themselves, as labs make them by accident.

Synthetic. A spring beside sliders is moved to and fro; then one accident happens to the table.
Nothing here is shared with labpipe. `truth` holds the numbers of the sound record without noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.floating]
SEEDS = range(31000, 31006)
"""Of each accident; fixed before the first run."""
PROTOCOL = """\
version: 1
name: cycles
about: Cyclic test of a synthetic specimen
sources:
  frame:
    reader: load-frame
    channels:
      force: {channel: Force, scale_uncertainty: 0.1 %}
      displacement: {channel: Displacement, scale_uncertainty: 0.1 %}
curve: {force: force, displacement: displacementFAILURE}
branches: {channel: displacement, min_stroke: 2 mm}
results: [{result: peak-force}, {result: peak-displacement}, {result: energy}RESULTS]
"""
SHEET = """\
test: T
protocol: ./cycles.yaml
specimen: {type: synthetic, spool: "1", sample: "1"}
files: {frame: table.csv}
"""


@dataclass
class Table:
    """What a machine records: s, mm, N; `turns` are the samples at which the motion turns."""

    time: Array
    travel: Array
    force: Array
    turns: list[int]

    def from_cycle(self, number: int) -> slice:
        """Samples from the begin of a cycle on."""
        return slice(self.turns[2 * number - 2], None)


def sound(rng: np.random.Generator) -> Table:
    """Move a spring beside two sliders through three to five triangles, or pull it to a break."""
    cycles, stroke, steps = (
        int(rng.integers(3, 6)),
        rng.uniform(8.0, 30.0),
        int(rng.integers(150, 500)),
    )
    up = np.linspace(0.0, stroke, steps)
    travel = np.concatenate(
        [
            np.zeros(30),
            *[part for _ in range(cycles) for part in (up[1:], up[-2::-1])],
            np.zeros(30),
        ]
    )
    stiffness, limits = rng.uniform(0.5, 5.0, 3), rng.uniform(0.5, 6.0, 2)
    carried, force = np.zeros(2), np.empty(len(travel))
    moves = np.diff(travel, prepend=0.0)
    for sample, move in enumerate(moves):
        carried = np.clip(carried + stiffness[1:] * move, -limits, limits)
        force[sample] = stiffness[0] * travel[sample] + carried.sum()
    turns = [29 + k * (steps - 1) for k in range(2 * cycles + 1)]
    return Table(0.05 * np.arange(len(travel)), travel, force, turns)


def pull(rng: np.random.Generator) -> Table:
    """Pull a specimen to its break; a third of the record lies behind it."""
    steps = int(rng.integers(200, 600))
    travel = np.concatenate([np.zeros(30), np.linspace(0.0, rng.uniform(10.0, 40.0), steps)])
    force = rng.uniform(50.0, 400.0) * (1.0 - np.exp(-3.0 * travel / travel[-1]))
    force[30 + 2 * steps // 3 :] = 0.0
    return Table(0.05 * np.arange(len(travel)), travel, force, [30, 30 + 2 * steps // 3])


def truth(table: Table) -> dict[str, float]:
    """Largest force and displacement of each cycle (N, m), and the work of its loop (J)."""
    numbers = {}
    if len(table.turns) == 2:
        last = table.turns[1] - 1
        return {
            "failure_force": table.force[last],
            "failure_displacement": 1e-3 * table.travel[last],
        }
    for cycle in range(1, len(table.turns) // 2 + 1):
        part = slice(table.turns[2 * cycle - 2], table.turns[2 * cycle] + 1)
        force, travel = table.force[part], 1e-3 * table.travel[part]
        numbers[f"peak_force.{cycle}"] = float(force.max())
        numbers[f"peak_displacement.{cycle}"] = float(travel.max())
        numbers[f"energy.{cycle}"] = float(np.sum((force[1:] + force[:-1]) * np.diff(travel)) / 2.0)
    return numbers


Accident = Callable[[Table, np.random.Generator], None]


def _later_cycle(table: Table, rng: np.random.Generator) -> slice:
    return table.from_cycle(int(rng.integers(2, len(table.turns) // 2 + 1)))


def _size(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(low), np.log(high))))


def force_zeroed(table: Table, rng: np.random.Generator) -> None:
    table.force[_later_cycle(table, rng)] += _size(rng, 0.03, 0.3) * table.force.max()


def range_switched(table: Table, rng: np.random.Generator) -> None:
    table.force[_later_cycle(table, rng)] *= rng.choice([0.1, 0.5, 1.02, 1.05, 1.2, 2.0, 10.0])


def force_stepped_at_the_top(table: Table, rng: np.random.Generator) -> None:
    top = table.turns[2 * int(rng.integers(0, len(table.turns) // 2)) + 1]
    table.force[top + 1 :] += rng.uniform(0.06, 0.4) * table.force.max()


def travel_stepped_at_a_turn(table: Table, rng: np.random.Generator) -> None:
    table.travel[table.turns[int(rng.integers(1, len(table.turns) - 1))] + 1 :] += _size(
        rng, 0.5, 3.0
    )


def force_stepped_on_the_way_back(table: Table, rng: np.random.Generator) -> None:
    back = table.turns[1] + 20 + int(rng.integers(0, 80))
    table.force[back:] += rng.uniform(0.04, 0.2) * table.force.max()


def travel_stepped_on_the_way(table: Table, rng: np.random.Generator) -> None:
    table.travel[20 + int(rng.integers(40, 120)) :] += 0.04 * table.travel.max()


def travel_reversed(table: Table, rng: np.random.Generator) -> None:
    table.travel[_later_cycle(table, rng)] *= -1.0


def encoder_scaled(table: Table, rng: np.random.Generator) -> None:
    table.travel[_later_cycle(table, rng)] *= 1.0 + _size(rng, 0.015, 0.2)


def encoder_wrapped(table: Table, rng: np.random.Generator) -> None:
    wrap = rng.uniform(0.3, 0.9) * table.travel.max()
    table.travel %= wrap


def travel_stepped_twice(table: Table, rng: np.random.Generator) -> None:
    for start in sorted(rng.integers(60, len(table.time) - 60, 2)):
        table.travel[start:] += _size(rng, 1.0, 4.0)


def rows_of_zeros(table: Table, rng: np.random.Generator) -> None:
    top = table.turns[1] - int(rng.integers(5, 40))
    table.travel[top : top + 5] = table.force[top : top + 5] = 0.0


def force_late(table: Table, rng: np.random.Generator) -> None:
    rows = int(rng.integers(4, 20))
    table.force[rows:] = table.force[:-rows].copy()


def turned_in_time(table: Table, rng: np.random.Generator) -> None:
    table.travel, table.force = table.travel[::-1].copy(), table.force[::-1].copy()


def columns_exchanged(table: Table, rng: np.random.Generator) -> None:
    table.travel, table.force = table.force, table.travel


def rows_copied(table: Table, rng: np.random.Generator) -> None:
    """A stretch of the first cycle is pasted over the same stretch of the second."""
    length, begin = int(rng.integers(60, 120)), table.turns[0] + 20
    later = begin + table.turns[2] - table.turns[0]
    for values in (table.force, table.travel):
        values[later : later + length] = values[begin : begin + length]


def second_specimen(table: Table, rng: np.random.Generator) -> None:
    """Another pull stands below the first one in the same table."""
    share = rng.uniform(0.6, 1.5)
    table.travel = np.concatenate([table.travel, table.travel])
    table.force = np.concatenate([table.force, share * table.force])
    table.time = table.time[1] * np.arange(len(table.travel))


def second_specimen_after_return(table: Table, rng: np.random.Generator) -> None:
    back = table.travel[::-2]
    share = rng.uniform(0.6, 1.5)
    table.travel = np.concatenate([table.travel, back, table.travel])
    table.force = np.concatenate([table.force, np.zeros(len(back)), share * table.force])
    table.time = table.time[1] * np.arange(len(table.travel))


def missing_words(table: Table, rng: np.random.Generator) -> None:
    """Rows of -9999 stand where the instrument had nothing to say."""
    start = int(rng.integers(60, table.turns[1] - 30))
    table.force[start : start + 5] = -9999.0


def force_early(table: Table, rng: np.random.Generator) -> None:
    rows = int(rng.integers(3, 10))
    table.force[:-rows] = table.force[rows:].copy()


def travel_filtered(table: Table, rng: np.random.Generator) -> None:
    """The amplifier of the travel follows with a time constant of 0.3 to 1 s."""
    keep = np.exp(-0.05 / rng.uniform(0.3, 1.0))
    table.travel = lfilter([1.0 - keep], [1.0, -keep], table.travel)


def noise_at_the_top(table: Table, rng: np.random.Generator) -> None:
    """Something disturbs the load cell while the motion turns, for half a second or longer."""
    reach, top = int(rng.integers(5, 20)), table.turns[1]
    noise = rng.normal(0.0, rng.uniform(0.03, 0.1) * table.force.max(), 2 * reach + 1)
    table.force[top - reach : top + reach + 1] += noise


CYCLIC: tuple[Accident, ...] = (
    *(force_zeroed, range_switched, force_stepped_at_the_top, travel_stepped_at_a_turn),
    *(encoder_scaled, encoder_wrapped, travel_stepped_twice, rows_of_zeros, force_late),
    *(turned_in_time, columns_exchanged, rows_copied, force_stepped_on_the_way_back),
    *(travel_stepped_on_the_way, travel_reversed, noise_at_the_top),
    *(force_early, travel_filtered),
)
PULLED = (second_specimen, second_specimen_after_return, missing_words)


def noisy(table: Table, rng: np.random.Generator) -> None:
    """Add noise of the cell and of the encoder, and round as an export does."""
    table.force = np.round(
        table.force + rng.normal(0.0, 0.001 * table.force.max(), len(table.force)), 4
    )
    table.travel = np.round(table.travel + rng.normal(0.0, 2e-4, len(table.travel)), 4)


def export(table: Table) -> str:
    """The table as a csv."""
    rows = [
        f"{t:.3f},{d:.4f},{f:.4f}"
        for t, d, f in zip(table.time, table.travel, table.force, strict=True)
    ]
    return "\n".join(["Time (s),Displacement (mm),Force (N)", *rows, ""])


def made(
    accident: Accident | None,
    seed: int,
    *,
    pulled: bool = False,
) -> tuple[str, str, dict[str, float]]:
    """Make one test.

    Returns
    -------
    Its protocol, its export, and what is true.
    """
    rng = np.random.default_rng(seed)
    table = pull(rng) if pulled else sound(rng)
    right = truth(table)
    noisy(table, rng)
    if accident is not None:
        accident(table, rng)
    results = ", {result: failure}" if pulled else ""
    failure = ", failure: {force_below: 50 %}" if pulled else ""
    return PROTOCOL.replace("FAILURE", failure).replace("RESULTS", results), export(table), right
