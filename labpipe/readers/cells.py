"""Cells of a line: how they are parted, and whether one holds a number or a unit."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence

from labpipe.units import si_factor

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}([.,]\d{3})+)([eE][+-]?\d+)?")
_BRACKETED = {
    "()": re.compile(r"(.*?)\s*\(([^()]*(?:\([^()]*\))?[^()]*)\)"),
    "[]": re.compile(r"(.*?)\s*\[([^\[\]]*)\]"),
}
_MARKED = re.compile(r"(.*\S)(?:\s*,\s*|\s+/\s+)([^\W\d]\S*|%|°\S*)")
"""A unit behind a comma, ``Force, N``, or as ISO 80000 writes it, ``Force / N``."""
_SI = ("s", "m", "N", "Pa", "1", "V", "N*m", "rad", "K", "Hz", "m/s", "kg")
_NO_DIMENSION = frozenset({"-", "count", "°C"})
_COMMON = frozenset(
    (
        *("s", "ms", "sec", "min", "h", "mm", "µm", "cm", "m", "in", "mm/s"),
        *("N", "kN", "mN", "lbf", "MPa", "GPa", "kPa", "%", "mm/mm", "V"),
    )
)
"""Told at once; whatever else could be a unit is looked up with pint, which is slow to load."""
_SHOWN = 60


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number, whatever its decimal sign."""
    return _NUMBER.fullmatch(cell.strip()) is not None


def split_line(line: str, separator: str) -> list[str]:
    """Cut a line into its cells."""
    line = line.rstrip("\r\n")
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return line.split(separator)


def is_unit(text: str) -> bool:
    """Tell whether labpipe knows a text as a unit."""
    known = text in _COMMON or text in _NO_DIMENSION
    return known or any(is_like(text, unit) for unit in _SI)


def hold_units(cells: Sequence[str]) -> bool:
    """Tell whether one at least of some cells is a unit; the quick ones are tried first."""
    return any(cell in _COMMON for cell in cells) or any(is_unit(cell) for cell in cells if cell)


def is_like(text: str, unit: str) -> bool:
    """Tell whether a text is a unit of the dimension of another."""
    try:
        si_factor(text, unit)
    except ValueError:
        return False
    return True


def are_units(cells: Sequence[str]) -> bool:
    """Tell whether all filled cells, and one at least, hold units, in brackets or not."""
    bare = [without_brackets(cell) for cell in cells if cell]
    return bool(bare) and all(is_unit(cell) for cell in bare)


def bare_unit(cell: str, brackets: str) -> str | None:
    """Take a unit out of its brackets; None if it should have some and has none."""
    if not brackets:
        return cell
    whole = len(cell) > 1 and cell[0] == brackets[0] and cell[-1] == brackets[1]
    return cell[1:-1].strip() if whole else None


def without_brackets(cell: str) -> str:
    """Take a unit out of its brackets, if it has any."""
    bare = (bare_unit(cell, brackets) for brackets in _BRACKETED)
    return next((text for text in bare if text is not None), cell)


def name_and_unit(cell: str, brackets: str = "") -> tuple[str, str] | None:
    """Part a cell into a name and a unit.

    Parameters
    ----------
    cell : such as ``Force (N)``
    brackets : that the unit must stand in; if empty any, or a comma or slash before a known unit

    Returns
    -------
    Both; None if there is no unit.
    """
    kinds = [_BRACKETED[brackets]] if brackets else list(_BRACKETED.values())
    match = next((found for kind in kinds if (found := kind.fullmatch(cell))), None)
    if match is None and not brackets:
        match = _MARKED.fullmatch(cell)
        match = match if match is not None and is_unit(match[2]) else None
    return None if match is None else (match[1].strip(), match[2].strip())


def quoted(cells: Sequence[str]) -> str:
    """Show cells in a message."""
    text = ", ".join(cell for cell in cells if cell)
    return f"'{text[:_SHOWN]}'" if text else "nothing"
