"""Cells of text exports: how they are parted, and what number or unit one holds.

A spreadsheet may take the decimal sign of numbers for a sign between thousands, and leave it out:
1.063, 1.110797 and 1.162 become 1063, 1110797 and 1162: whole numbers of which those with
more decimals are a thousand times too large. The digits cannot be given back their places.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from labpipe.errors import error_text
from labpipe.records.arrays import Flags, Floats
from labpipe.units import si_factor

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}([.,]\d{3})+)([eE][+-]?\d+)?")
MISSING = frozenset(
    (
        *("nan", "na", "n/a", "n.a.", "null", "none", "nil", "-", "--", "---"),
        *("#n/a", "#na", "#nv", "#div/0!", "#value!", "#num!", "#ref!", "#null!"),
        *("-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"),
    )
)
"""Words for a missing value in small letters: of people, spreadsheets and programs."""
_STAMP = re.compile(
    r"(?=\d)(\d{1,4}([-./ ])(\d{1,2}|[a-z]{3})\2\d{1,4}[T ,]*)?"  # day
    r"(\d{1,2}:\d{2}(:\d{2})?([.,:]\d+)?)?(\s*[ap]\.?\s?m\.?)?(Z|[+-]\d{2}:?\d{2})?",
    re.IGNORECASE,
)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([,.' \u2019\u00a0\u202f])\d{3})(?:\1\d{3})*([.,]\d+)?")
_WORD = re.compile(r"\W*[^\W\d_]{2}")
_BRACKETED = {
    "()": re.compile(r"(.*?)\(([^()]*(?:\([^()]*\)[^()]*)?)\)"),
    "[]": re.compile(r"(.*?)\[([^\[\]]*)\]"),
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
_SHOWN, _SHOWN_CELL = 60, 40
SIGNS = {".": "a decimal point", ",": "a decimal comma"}
PLAIN = {sign: re.compile(rf"[+-]?(\d+(\{sign}\d*)?|\{sign}\d+)([eE][+-]?\d+)?") for sign in SIGNS}
"""A number by its decimal sign."""
LOST = (
    "A spreadsheet took the decimal sign for a sign between thousands and the digits are lost:"
    " export the test again and do not save it from a spreadsheet."
)
AGAIN = "Export the test again; the file may have been cut off or edited."
_ONE_SIGN = (
    "Export the test again with one decimal sign in the whole file and no sign between thousands."
)
_NO_STAMP = (
    "Export the time in seconds since the start of the test, or name the column under `words` in a"
    " card of your own; see docs/how-to/new-dialect.md."
)
_NO_WORD = (
    "Export the test again with a blank cell where a value is missing, and without rows of words"
    " between the samples."
)
INFINITE = frozenset({"inf", "infinity"})
_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3}){2,}|[+-]?\d{1,3}(\.\d{3}){2,}")
_FACTORS = (1e3, 1e6)
_NEAR = 1.5
"""Two jumps count as of one thousand if both are so up to this factor."""
_WITHIN = 10
"""Samples between the jump and the one back."""
_LEAST = 100.0
"""Smaller whole numbers are counters and codes."""
_SPREAD = 0.01
"""Beside the step between the two neighbours, a number may lie so far from them."""
_LOOK = 1000


def is_number(cell: str) -> bool:
    """Check whether a cell holds a number, whatever its decimal sign."""
    return _NUMBER.fullmatch(cell.strip()) is not None


def is_missing(cell: str) -> bool:
    """Check whether a cell holds a word for a missing value, such as ``nan``, ``N/A`` or ``-``."""
    return cell.strip().casefold() in MISSING


def is_sample(row: Sequence[str]) -> bool:
    """Check whether a row holds samples: numbers, and beside them only what stands in their place.

    Words for missing values, time stamps and numbers with signs between thousands do not hide the
    row; which of them can be read is said where it is read.
    """
    filled = [cell.strip() for cell in row if cell.strip()]
    numbers = [cell for cell in filled if is_number(cell)]
    others = (cell for cell in filled if cell not in numbers)
    return bool(numbers) and all(
        is_missing(cell) or _STAMP.fullmatch(cell) or _THOUSANDS.fullmatch(cell) for cell in others
    )


def is_closing(row: Sequence[str]) -> bool:
    """Check whether a row begins with a word: below samples a statistic or a remark."""
    first = next((cell.strip() for cell in row if cell.strip()), "")
    is_infinite = first.strip("+-").casefold() in INFINITE
    return bool(_WORD.match(first)) and not is_infinite and not is_missing(first)


def describe_cell(cell: str, decimal: str) -> tuple[str, str, str]:
    """Describe a cell that cannot be read as a number.

    Parameters
    ----------
    cell : without blanks around it
    decimal : sign of the numbers in the file

    Returns
    -------
    What was expected, what was found, and what to do, as `labpipe.errors.error_text` takes them.

    Examples
    --------
    >>> describe_cell("10:00:00.5", ".")[1], describe_cell("1.020,5", ",")[1]
    ("'10:00:00.5', a time stamp", "'1.020,5', with a sign between thousands")
    """
    expected, shown = f"a number with {SIGNS[decimal]}", quoted([cell[:_SHOWN_CELL]])
    if PLAIN[decimal].fullmatch(cell):
        return "a number below 1.8e308", f"{shown}, which is too large", AGAIN
    if is_grouped(cell):
        return expected, shown, LOST
    if _STAMP.fullmatch(cell):
        return expected, f"{shown}, a time stamp", _NO_STAMP
    other = "," if decimal == "." else "."
    signs = [SIGNS[other]] if PLAIN[other].fullmatch(cell) else []
    signs += ["a sign between thousands"] if _THOUSANDS.fullmatch(cell) else []
    if signs:
        return expected, f"{shown}, with {' or '.join(signs)}", _ONE_SIGN
    return expected, shown, _NO_WORD if is_closing([cell]) else AGAIN


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
    """Check whether labpipe knows a text as a unit."""
    known = text in _COMMON or text in _NO_DIMENSION
    return known or any(is_like(text, unit) for unit in _SI)


def hold_units(cells: Sequence[str]) -> bool:
    """Check whether one at least of some cells is a unit; the quick ones are tried first."""
    return any(cell in _COMMON for cell in cells) or any(is_unit(cell) for cell in cells if cell)


def is_like(text: str, unit: str) -> bool:
    """Check whether a text is a unit of the dimension of another."""
    try:
        si_factor(text, unit)
    except ValueError:
        return False
    return True


def are_units(cells: Sequence[str]) -> bool:
    """Check whether all filled cells, and one at least, hold units, in brackets or not."""
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
    """Split a cell into a name and a unit.

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


def is_grouped(cell: str) -> bool:
    """Check whether a cell has two signs between thousands: no number is written so."""
    return _GROUPED.fullmatch(cell) is not None


def lost_signs(path: object, place: str, before: str, after: str) -> str:
    """Word the error for a column that jumps a thousandfold and back.

    Parameters
    ----------
    path, place : of the first number behind the jump
    before, after : the numbers on both sides of it
    """
    return error_text(
        path,
        place,
        expected="numbers that do not jump a thousandfold and back",
        found=f"'{after}' after '{before}'",
        remedy=LOST,
    )


def thousandfold_jump(values: Floats) -> tuple[int, int] | None:
    """Find where a column of whole numbers jumps a thousandfold and back.

    Parameters
    ----------
    values : one column, shape (rows,); NaN is passed over

    Returns
    -------
    Rows of the numbers before and behind the first such jump; None for a column of which more than
    half of the numbers have decimals, and for whole numbers without such jumps.

    Notes
    -----
    A jump counts if what lies between it and the one back, divided (or multiplied) by the thousand,
    falls among the two numbers beside it, as it does for a curve that lost its decimal signs. A
    spike or an overflow of a counter lies anywhere, and a multiple of a thousand lost no sign.
    Numbers with decimals in between are passed over: 0.5 and 1.25 have no group of three digits,
    and a spreadsheet leaves them as they are.
    """
    if not _are_mostly_whole(values[:_LOOK]) or not _are_mostly_whole(values):
        return None
    rows = np.flatnonzero(values == np.rint(values))
    found = (_first_jump(values[rows], factor) for factor in _FACTORS)
    firsts = [at for at in found if at is not None]
    return (int(rows[min(firsts)]), int(rows[min(firsts) + 1])) if firsts else None


def _are_mostly_whole(values: Floats) -> bool:
    whole = int(np.count_nonzero(values == np.rint(values)))
    return whole > 0 and 2 * whole >= int(np.count_nonzero(~np.isnan(values)))


def _first_jump(values: Floats, factor: float) -> int | None:
    size = np.abs(values)
    smaller, larger = np.minimum(size[:-1], size[1:]), np.maximum(size[:-1], size[1:])
    same_sign = values[:-1] * values[1:] > 0.0
    ratio = larger / np.maximum(smaller, _LEAST)
    near: Flags = (ratio > factor / _NEAR) & (ratio < factor * _NEAR) & (smaller >= _LEAST)
    jumps = np.flatnonzero(near & same_sign & (larger % 1000.0 != 0.0))
    for up, down in pairwise(jumps):
        if down - up <= _WITHIN and _returns(size[up : down + 2], factor):
            return int(up)
    return None


def _returns(run: Floats, factor: float) -> bool:
    """Check whether the inner numbers, once scaled, fall among the first and the last one."""
    ends, inner = run[[0, -1]], run[1:-1]
    scaled = inner / factor if inner[0] > ends[0] else inner * factor
    spread = abs(ends[1] - ends[0]) + _SPREAD * ends.max()
    return bool(np.all((scaled >= ends.min() - spread) & (scaled <= ends.max() + spread)))
