"""What figures say in words: axis labels with display units, titles, footnotes, missing data."""

from __future__ import annotations

import re
from typing import NamedTuple

from labpipe.records.quality import Severity
from labpipe.records.result import Status, TestResult
from labpipe.units import si_factor


class Scale(NamedTuple):
    """How a quantity is shown: multiply SI numbers by `factor`, and write `unit`."""

    factor: float
    unit: str

    def label(self, quantity: str) -> str:
        """Word an axis label, such as ``Displacement (mm)``."""
        return f"{quantity} ({self.unit})"


def scale(result: TestResult, quantity: str, si_unit: str) -> Scale:
    """Find the display unit of a quantity; SI where the protocol names none.

    Parameters
    ----------
    result : holds the display units
    quantity : ``displacement``, ``force``, ``time`` ...
    si_unit : its SI unit

    Returns
    -------
    Factor from SI to the display unit, and the unit's name.
    """
    unit = result.display.get(quantity, si_unit)
    return Scale(1.0 / si_factor(unit, si_unit), unit)


def title(result: TestResult) -> str:
    """Test, specimen and protocol in one line."""
    specimen = result.specimen
    what = f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"
    return f"{result.test}  ·  {what}  ·  {result.protocol}"


def footnote(result: TestResult) -> str:
    """How many results are doubtful or failed; empty when all are fine."""
    counts = {
        status: sum(entry.status is status for entry in result.results)
        for status in (Status.DOUBTFUL, Status.FAILED)
    }
    parts = [f"{count} {status}" for status, count in counts.items() if count]
    return f"Of {len(result.results)} results: {', '.join(parts)}." if parts else ""


_NOT_SHOWN = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def printable(text: str) -> str:
    """Show what no page, workbook or drawing can hold as U+FFFD: control characters and the like.

    Parameters
    ----------
    text : any; tabs and ends of lines stay
    """
    return _NOT_SHOWN.sub("\ufffd", text)


def shortened(word: str, most: int) -> str:
    """Take the middle out of a name that is too long for its place in a figure.

    Parameters
    ----------
    word : any text
    most : characters that there is room for, 3 at least

    Examples
    --------
    >>> shortened("TWB-B1-19-PVC-half-lap", 12)
    'TWB-B1…f-lap'
    """
    if len(word) <= most:
        return word
    end = (most - 1) // 2
    return f"{word[: most - 1 - end]}…{word[len(word) - end :]}"


def count_of(number: int, noun: str) -> str:
    """A number of things, such as ``1 sample`` or ``3 samples``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def why_missing(result: TestResult, what: str) -> str:
    """Say that a stage of the test is not there, with the first error that the test notes."""
    errors = (note.message for note in result.quality if note.severity is Severity.ERROR)
    return " ".join([f"There is no {what} to draw.", *list(errors)[:1]])
