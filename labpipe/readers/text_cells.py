"""Cells of text exports and sheets: separation, numbers, words for missing values, and units."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from datetime import date, time, timedelta

from labpipe.errors import ReadError
from labpipe.units import find_si_factor

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}([.,]\d{3})+)([eE][+-]?\d+)?")
MISSING_WORDS = frozenset(
    (
        *("nan", "na", "n/a", "n.a.", "null", "none", "nil", "-", "--", "---"),
        *("#n/a", "#na", "#nv", "#div/0!", "#value!", "#num!", "#ref!", "#null!"),
        *("-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"),
    )
)
"""Words for a missing value, in lower case."""
_TIME_STAMP = re.compile(
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
_UNIT_AFTER_MARK = re.compile(r"(.*\S)(?:\s*,\s*|\s+/\s+)([^\W\d]\S*|%|°\S*)")
"""A unit after a comma, ``Force, N``, or as in ISO 80000, ``Force / N``."""
_READABLE_DIMENSIONS = ("s", "m", "N", "Pa", "1", "V", "N*m", "rad", "K", "Hz", "m/s", "kg")
"""A unit of one of these dimensions counts as the unit of a column."""
_NO_DIMENSION = frozenset({"-", "count", "°C"})
_COMMON_UNITS = frozenset(
    (
        *("s", "ms", "sec", "min", "h", "mm", "µm", "cm", "m", "in", "mm/s"),
        *("N", "kN", "mN", "lbf", "MPa", "GPa", "kPa", "%", "mm/mm", "V"),
    )
)
"""Recognised quickly; other units are looked up with pint, which is slow to import."""
DECIMAL_SIGNS = {".": "a decimal point", ",": "a decimal comma"}
NUMERAL = {
    sign: re.compile(rf"[+-]?(\d+(\{sign}\d*)?|\{sign}\d+)([eE][+-]?\d+)?")
    for sign in DECIMAL_SIGNS
}
"""Pattern of a number, by its decimal sign."""
INFINITE_WORDS = frozenset({"inf", "infinity"})
_GROUPED_DIGITS = re.compile(r"[+-]?\d{1,3}(,\d{3}){2,}|[+-]?\d{1,3}(\.\d{3}){2,}")


def as_text(cell: object) -> str:
    """Format the value of a cell of a sheet as text; durations become seconds."""
    if isinstance(cell, timedelta):
        cell = cell.total_seconds()
    if isinstance(cell, float):
        return f"{cell:.15g}"
    if isinstance(cell, date | time):
        return cell.isoformat()
    return str(cell).strip()


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with any decimal sign."""
    return _NUMBER.fullmatch(cell.strip()) is not None


def is_missing(cell: str) -> bool:
    """Return whether a cell is a word for a missing value, such as ``nan``, ``N/A`` or ``-``."""
    return cell.strip().casefold() in MISSING_WORDS


def is_sample(row: Sequence[str]) -> bool:
    """Return whether a row is a sample.

    It has at least one number. Other cells are words for missing values, time stamps or numbers
    with thousands separators; reading reports those that it cannot parse.
    """
    filled = [cell.strip() for cell in row if cell.strip()]
    numbers = [cell for cell in filled if is_number(cell)]
    others = (cell for cell in filled if cell not in numbers)
    return bool(numbers) and all(
        is_missing(cell) or _TIME_STAMP.fullmatch(cell) or _THOUSANDS.fullmatch(cell)
        for cell in others
    )


def is_summary_row(row: Sequence[str]) -> bool:
    """Return whether a row begins with a word, as statistics and remarks below samples do."""
    first = next((cell.strip() for cell in row if cell.strip()), "")
    is_infinite = first.strip("+-").casefold() in INFINITE_WORDS
    return bool(_WORD.match(first)) and not is_infinite and not is_missing(first)


def build_cell_error(cell: str, decimal: str, path: object, place: str) -> ReadError:
    """Build the error on a cell that is no number in the decimal format of the file.

    Parameters
    ----------
    cell : without surrounding blanks
    decimal : decimal sign of the file
    path, place : of the cell

    Examples
    --------
    >>> build_cell_error("10:00:00.5", ".", "a.csv", "line 3").args[0][:65]
    "a.csv, line 3: expected a number with a decimal point, found '10:"
    """
    other = NUMERAL["," if decimal == "." else "."]
    return ReadError.about(
        "readers.number_too_large"
        if NUMERAL[decimal].fullmatch(cell)
        else "readers.lost_decimals"
        if _GROUPED_DIGITS.fullmatch(cell)
        else "readers.time_stamp"
        if _TIME_STAMP.fullmatch(cell)
        else "readers.other_signs"
        if other.fullmatch(cell) or _THOUSANDS.fullmatch(cell)
        else "readers.word_among_numbers"
        if is_summary_row([cell])
        else "readers.no_number",
        path,
        place,
        sign=DECIMAL_SIGNS[decimal],
        cell=cell[:40],
    )


def split_line(line: str, separator: str) -> list[str]:
    """Split a line into its cells."""
    line = line.rstrip("\r\n")
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return line.split(separator)


def is_unit(text: str) -> bool:
    """Return whether a text is a known unit."""
    is_known = text in _COMMON_UNITS or text in _NO_DIMENSION
    return is_known or any(has_dimension_of(text, unit) for unit in _READABLE_DIMENSIONS)


def hold_units(cells: Sequence[str]) -> bool:
    """Return whether at least one cell is a unit; common units are tried first."""
    filled = [cell for cell in cells if cell]
    return any(cell in _COMMON_UNITS for cell in filled) or any(map(is_unit, filled))


def has_dimension_of(text: str, unit: str) -> bool:
    """Return whether a text is a unit with the dimension of another."""
    try:
        find_si_factor(text, unit)
    except ValueError:
        return False
    return True


def are_units(cells: Sequence[str]) -> bool:
    """Return whether all filled cells, at least one, are units, with or without brackets."""
    units = [strip_brackets(cell) for cell in cells if cell]
    return bool(units) and all(map(is_unit, units))


def strip_brackets(cell: str) -> str:
    """Remove the brackets of a unit, if any."""
    return cell[1:-1].strip() if len(cell) > 1 and cell[0] + cell[-1] in _BRACKETED else cell


def split_name_and_unit(cell: str, brackets: str = "") -> tuple[str, str] | None:
    """Split a cell into a name and a unit.

    Parameters
    ----------
    cell : such as ``Force (N)``
    brackets : required around the unit; if empty any, or a comma or slash before a known unit

    Returns
    -------
    Name and unit; None if there is no unit.
    """
    patterns = [_BRACKETED[brackets]] if brackets else [*_BRACKETED.values(), _UNIT_AFTER_MARK]
    for pattern in patterns:
        match = pattern.fullmatch(cell)
        if match and (pattern is not _UNIT_AFTER_MARK or is_unit(match[2])):
            return match[1].strip(), match[2].strip()
    return None


def quoted(cells: Sequence[str]) -> str:
    """Quote cells in a message."""
    text = ", ".join(cell for cell in cells if cell)
    return f"'{text[:60]}'" if text else "nothing"
