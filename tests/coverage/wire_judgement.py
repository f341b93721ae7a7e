"""Whether calibrations say too much: counts by kind of campaign, judged together after Holm."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from tests.coverage.judgement import ENOUGH, LEAST, LEVEL, Held, Row, holm
from tests.coverage.page import table

NAMES = {
    "radial_friction": "phi",
    "insulation_modulus": "E_ins",
    "copper_scale": "copper",
}
IDENTIFIED = "identified"


def by_kind(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Campaigns with a calibration, by their kind, in order."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row["rows"]:
            found.setdefault(row["kind"], []).append(row)
    return found


def counted(rows: Iterable[Row], name: str, *, identified: bool) -> Held:
    """Intervals of a parameter, all or those that were called identified."""
    said = [cell for row in rows for cell in row["rows"] if cell["name"] == name]
    return Held.of(
        sentence for sentence in said if not identified or sentence["status"] == IDENTIFIED
    )


def bands(rows: Iterable[Row]) -> Held:
    """Bands of the mean sample on another length."""
    return Held.of(cell for row in rows for cell in row["rows"] if cell["name"] not in NAMES)


def too_seldom(rows: Iterable[Row]) -> dict[tuple[str, str], tuple[Held, bool]]:
    """By kind and parameter: what was called identified, and whether it holds too seldom.

    Significantly less often than in 95 % (Holm's family has all that were asked `LEAST` times).
    """
    every = {
        (kind, name): counted(own, name, identified=True)
        for kind, own in by_kind(rows).items()
        for name in NAMES
    }
    family = {key: held for key, held in every.items() if held.asked >= LEAST}
    seldom = holm([held.chance for held in family.values()], LEVEL)
    return {key: (family[key], each) for key, each in zip(family, seldom, strict=True)}


def tables(rows: Sequence[Row]) -> str:
    """Everything that was counted, in markdown."""
    return "\n".join([_summary(rows), "", *_table(rows)])


def _summary(rows: Sequence[Row]) -> str:
    judged = too_seldom(rows)
    below = {key: held for key, (held, _) in judged.items() if held.share < ENOUGH}
    total = sum((held for held, _ in judged.values()), Held(0, 0))
    said = "; ".join(f"{NAMES[name]} of {kind}: {held}" for (kind, name), held in below.items())
    return (
        f"{sum(not row['rows'] for row in rows)} ended without a calibration. Parameters that were"
        f" called identified in {LEAST} campaigns of a kind or more: {len(judged)}. Together their"
        f" intervals hold in {total} ({total.percent});"
        f" {sum(is_seldom for _, is_seldom in judged.values())} hold significantly less often than"
        f" in 95 % (Holm, 1 %), {len(below)} in less than 90 %"
        f"{said and f' ({said})'}."
    )


def _table(rows: Sequence[Row]) -> Iterator[str]:
    heads = ("campaigns", "n", *NAMES.values(), "identified", "bands", "more than one solution")
    return table("l" + "r" * (len(heads) - 1), heads, _lines(rows))


def _lines(rows: Sequence[Row]) -> Iterator[tuple[object, ...]]:
    """Yield a line for each wire and noise, all lengths together."""
    judged = {key[0] for key, (_, is_seldom) in too_seldom(rows).items() if is_seldom}
    kinds: dict[str, list[str]] = {}
    for kind in by_kind(rows):
        kinds.setdefault(re.sub(r" \d+ mm", "", kind), []).append(kind)
    for group, members in kinds.items():
        own = [row for kind in members for row in by_kind(rows)[kind]]
        plain = [counted(own, name, identified=False).held for name in NAMES]
        total = sum((counted(own, name, identified=True) for name in NAMES), Held(0, 0))
        cell = f"**{total}**" if judged & set(members) else str(total)
        several = sum(row["about"]["solutions"] > 1 for row in own)
        yield group, len(own), *plain, cell, f"{100.0 * bands(own).share:.0f} %", several
