"""In what two sets of rows differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import inf

from tests.golden.rows import COLUMNS, NUMBERS, Row

RELATIVE = 1e-9
OF_FITS = 1e-6
"""Relative: means of groups, calibrations and models, whose searches stop within about that."""
FLOORS = {"m": 1e-15, "N": 1e-12, "J": 1e-15, "s": 1e-9, "N/m": 1e-9, "Pa": 1e-3, "N*m^2": 1e-15}
"""In the unit: numbers closer than this are the same, however small they are.

A bound, or an offset, may lie at zero, where no relative difference means anything: rounding of the
numbers that it is made of is all that is left. Offsets of clocks differ by 1e-10 s, their drifts by
1e-12, from one kind of processor to the next. Each floor is at least four digits below what the
best instrument of the lab resolves (1 um, 1 mN, 10 us) and what follows from it.
"""
FLOOR = 1e-11
"""Of pure numbers, and of every unit that is not named above."""


@dataclass(frozen=True)
class Difference:
    """One field of one row, or a row that only one side has."""

    row: Row
    field: str
    old: str
    new: str

    def __str__(self) -> str:
        where = f"{self.row.test:<20} {self.row.name:<28} {self.field:<7}"
        told = f"{where} {self.old or '-':>24} -> {self.new or '-':<24}"
        return f"{told} {self.relative:.2g}" if self.relative is not None else told.rstrip()

    @property
    def relative(self) -> float | None:
        """Change over the old number; None where there are no two numbers."""
        if self.field not in NUMBERS or not (self.old and self.new):
            return None
        old, new = float(self.old), float(self.new)
        return abs(new - old) / abs(old) if old else inf


def differences(old: Iterable[Row], new: Iterable[Row]) -> list[Difference]:
    """Every difference, in the order of the old rows, then what is new."""
    old_rows, new_rows = ({row.key: row for row in rows} for rows in (old, new))
    changes: list[Difference] = []
    for key, row in old_rows.items():
        new_row = new_rows.get(key)
        changes += between(row, new_row) if new_row else [Difference(row, "row", "there", "")]
    changes += [
        Difference(row, "row", "", "there") for key, row in new_rows.items() if key not in old_rows
    ]
    return changes


def between(old: Row, new: Row) -> Iterator[Difference]:
    """The fields in which two rows of one name differ."""
    for field in COLUMNS:
        old_text, new_text = getattr(old, field), getattr(new, field)
        if old_text != new_text and not (field in NUMBERS and same(old_text, new_text, old)):
            yield Difference(new, field, old_text, new_text)


def same(old: str, new: str, row: Row) -> bool:
    """Whether two numbers of a row differ by nothing but rounding."""
    if not (old and new):
        return False
    old_number, new_number = float(old), float(new)
    relative = RELATIVE if row.kind == "result" else OF_FITS
    return abs(new_number - old_number) <= relative * abs(old_number) + FLOORS.get(row.unit, FLOOR)
