"""Dates that ControlDesk writes in the language of the computer."""

from __future__ import annotations

import re
from datetime import date

_SAVED = re.compile(r"Created on: \w{3} (\w{3}) +(\d{1,2}) [\d:]+ (\d{4})")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_LONGEST = 4
"""Digits of a day, a month or a year."""
_CLOSE = 7
"""Days between recording and saving that are still believed."""


def day_of_saving(header: str) -> date | None:
    """Find the day in the header text of a MAT file, which is always in English.

    Parameters
    ----------
    header : ``MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: Thu May 04 17:31:15 2023``

    Returns
    -------
    The day, None if the text holds none.
    """
    match = _SAVED.search(header)
    if match is None or match.group(1) not in _MONTHS:
        return None
    return _day(int(match.group(3)), _MONTHS.index(match.group(1)) + 1, int(match.group(2)))


def written_date(text: str, near: date | None) -> str:
    """Settle whether day or month comes first in a date, by a day that is known to be close.

    Parameters
    ----------
    text : as ControlDesk wrote it
    near : the day of saving, at most a few days later; None if it is not known

    Returns
    -------
    ISO date, empty if no reading of the text lies within a week of `near`.

    Examples
    --------
    >>> written_date("4-5-2023 17:30:33", date(2023, 5, 4))
    '2023-05-04'
    """
    words = re.findall(r"\d+", text)[:3]
    if len(words) < 3 or near is None or max(map(len, words)) > _LONGEST:
        return ""
    a, b, c = map(int, words)
    orders = [(a, b, c)] if a > 31 else [(c, a, b), (c, b, a)]
    days = [day for order in orders if (day := _day(*order)) is not None]
    days.sort(key=lambda day: abs((day - near).days))
    return days[0].isoformat() if days and abs((days[0] - near).days) <= _CLOSE else ""


def _day(year: int, month: int, day: int) -> date | None:
    try:
        return date(year, month, day)
    except ValueError:
        return None
