"""Plain numbers of a whole test, by the names that results have in summary.json."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tests.judges.plain.definitions import (
    HALF,
    Break,
    Cycle,
    Plain,
    Record,
    cycles,
    energy,
    failure,
    peak_displacement,
    peak_force,
    sense,
    slack,
    stiffness,
    trapezoid,
    two_segments,
    window,
)

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
        found |= {name: Plain.of(each) for name, each in zip(SEGMENTS, values, strict=True)}
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
        name: plain and Plain.of(*(end for each in (first, *others) for end in _ends(each[name])))
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
    """Results that may be refused, with the code: too few samples, no unloading, hardly a break."""
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
