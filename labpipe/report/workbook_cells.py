"""Cells of a workbook: numbers that keep all digits and show those that mean something; names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple, TypeAlias

from labpipe.records.curve import Interval
from labpipe.report.wording import place_of

"""Excel's own sheet of tracked changes, in any case of letters."""
_DIGITS, _DIGITS_OF_SMALL = 5, 3
"""Digits of the largest number of a column, and of one that would have few of these."""
_PLAIN, _FINEST = 1e7, -6
"""Size from which, and last place beyond which, a number is seen with a power of ten."""


class Shown(NamedTuple):
    """A number as a cell holds it, with all its digits, and the form in which it is seen.

    Parameters
    ----------
    value : in the unit of its column or row
    form : number format of Excel
    """

    value: float
    form: str


Value: TypeAlias = str | float | Shown | None
Row: TypeAlias = Sequence[Value]


def shown(value: float | None, interval: Interval | None, factor: float = 1.0) -> Shown | None:
    """Show a number to the second digit of half its interval; the cell has all of it.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit of the cell

    Returns
    -------
    None where there is no number.
    """
    if value is None or not math.isfinite(value):
        return None
    return Shown(factor * value, number_form(factor * value, place_of(value, interval, factor)))


def shown_with_ends(
    value: float | None, interval: Interval | None, factor: float = 1.0
) -> tuple[Shown | None, Shown | None, Shown | None]:
    """Show a number and the ends of its interval to the same digit.

    Parameters
    ----------
    value, interval : in SI
    factor : from SI to the unit of the cells

    Returns
    -------
    Value, lower, upper; None where there is no such number.
    """
    if interval is None:
        return shown(value, None, factor), None, None
    lower, upper = sorted((factor * interval.lower, factor * interval.upper))
    about = interval.lower if value is None else value
    place = place_of(about, interval, factor)
    low, high = (Shown(each, number_form(each, place)) for each in (lower, upper))
    return shown(value, interval, factor), low, high


def percent(share: float | None) -> Shown | None:
    """A share as per cent, such as 38.2% for 0.382."""
    return None if share is None or not math.isfinite(share) else Shown(share, "0.0%")


def number_form(value: float, place: int) -> str:
    """Make the number format in which a number is seen down to a power of ten.

    Parameters
    ----------
    value : of the cell
    place : power of ten of the last digit

    Examples
    --------
    >>> number_form(52.284, -1)
    '0.0'
    >>> number_form(3.1e-5, -6)
    '0.000000'
    >>> number_form(3.1e-7, -8)
    '0.0E+00'
    """
    if value and (abs(value) >= _PLAIN or place < _FINEST):
        behind = math.floor(math.log10(abs(value))) - place
        return _decimals(behind) + "E+00"
    return _decimals(-place)


@cache
def _decimals(count: int) -> str:
    return f"0.{'0' * min(count, 15)}" if count > 0 else "0"


def begin_of(text: str, most: int) -> str:
    """Take as much of a text as there is room for, as Excel counts: in units of UTF-16."""
    return text.encode("utf-16-le")[: 2 * most].decode("utf-16-le", "ignore")


def column_place(column: Sequence[Value]) -> int | None:
    """Place of the last digit of the plain numbers of a column; None if all are whole."""
    plain = [abs(v) for v in column if isinstance(v, float) and math.isfinite(v)]
    if not any(plain):
        return None
    return place_of(max(plain), None, digits=_DIGITS)


def form_in_column(value: float, place: int | None) -> str:
    """Form of a plain number: as its column has it, unless it is too small to be seen so."""
    if isinstance(value, int) or place is None:
        return "0"
    is_small = 0.0 < abs(value) < _smallest(place)
    own = place_of(value, None, digits=_DIGITS_OF_SMALL) if is_small else place
    return number_form(value, own)


@cache
def _smallest(place: int) -> float:
    """Number that has as few digits down to a power of ten as a small one may."""
    return float(10.0 ** (place + _DIGITS_OF_SMALL - 1))
