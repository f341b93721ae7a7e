"""Cells of a workbook: numbers with all digits that display the significant ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple, TypeAlias

from labpipe.records.curve import Interval
from labpipe.report.wording import place_of

_COLUMN_DIGITS = 5
"""Digits of the largest number of a column."""
_MIN_DIGITS = 3
"""Digits of a small number that would have fewer in its column."""


class NumberCell(NamedTuple):
    """A number with all digits, and its number format.

    Parameters
    ----------
    value : in the unit of its column or row
    form : number format of Excel
    """

    value: float
    form: str


Value: TypeAlias = str | float | NumberCell | None
Row: TypeAlias = Sequence[Value]


def number_cell(
    value: float | None, interval: Interval | None, factor: float = 1.0
) -> NumberCell | None:
    """Return a cell that displays a number to the second digit of half its interval.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit of the cell

    Returns
    -------
    None without a number.
    """
    if value is None or not math.isfinite(value):
        return None
    return NumberCell(
        factor * value, number_format(factor * value, place_of(value, interval, factor))
    )


def interval_cells(
    value: float | None, interval: Interval | None, factor: float = 1.0
) -> tuple[NumberCell | None, NumberCell | None, NumberCell | None]:
    """Return cells that display a number and the ends of its interval to the same digit.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit of the cells

    Returns
    -------
    Value, lower, upper; None for missing ones.
    """
    if interval is None:
        return number_cell(value, None, factor), None, None
    lower, upper = sorted((factor * interval.lower, factor * interval.upper))
    about = interval.lower if value is None else value
    place = place_of(about, interval, factor)
    low, high = (NumberCell(end, number_format(end, place)) for end in (lower, upper))
    return number_cell(value, interval, factor), low, high


def percent_cell(share: float | None) -> NumberCell | None:
    """Return the cell of a share in per cent, such as 38.2% for 0.382."""
    return None if share is None or not math.isfinite(share) else NumberCell(share, "0.0%")


def number_format(value: float, place: int) -> str:
    """Return the number format that displays a number down to a power of ten.

    Parameters
    ----------
    value : of the cell
    place : power of ten of the last digit

    Examples
    --------
    >>> number_format(52.284, -1)
    '0.0'
    >>> number_format(3.1e-5, -6)
    '0.000000'
    >>> number_format(3.1e-7, -8)
    '0.0E+00'
    """
    plain_below, last_plain_place = 1e7, -6  # beyond these, with a power of ten
    if value and (abs(value) >= plain_below or place < last_plain_place):
        behind = math.floor(math.log10(abs(value))) - place
        return _decimals(behind) + "E+00"
    return _decimals(-place)


@cache
def _decimals(count: int) -> str:
    return f"0.{'0' * min(count, 15)}" if count > 0 else "0"


def truncate_text(text: str, most: int) -> str:
    """Truncate a text to a number of UTF-16 units, as Excel counts."""
    return text.encode("utf-16-le")[: 2 * most].decode("utf-16-le", "ignore")


def column_place(column: Sequence[Value]) -> int | None:
    """Return the place of the last digit of the plain numbers of a column; None for integers."""
    plain = [abs(v) for v in column if isinstance(v, float) and math.isfinite(v)]
    if not any(plain):
        return None
    return place_of(max(plain), None, digits=_COLUMN_DIGITS)


def format_in_column(value: float, place: int | None) -> str:
    """Return the format of a plain number: that of its column, or its own if it is too small."""
    if isinstance(value, int) or place is None:
        return "0"
    is_small = 0.0 < abs(value) < _smallest_plain(place)
    last_place = place_of(value, None, digits=_MIN_DIGITS) if is_small else place
    return number_format(value, last_place)


@cache
def _smallest_plain(place: int) -> float:
    """Return the smallest number with enough digits down to a power of ten."""
    return float(10.0 ** (place + _MIN_DIGITS - 1))
