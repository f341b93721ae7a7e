"""A test in a notebook: a few lines of HTML, every text escaped."""

from __future__ import annotations

from collections import Counter
from html import escape

from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.wording import (
    count_of,
    in_words,
    is_main,
    printable,
    shown_in,
    unit_words,
    write_number,
)

_MOST = 10
"""Results that are shown; the rest are counted."""
_CELL = "text-align:left;padding:1px 12px 1px 0"


def page_of(result: TestResult) -> str:
    """Show a test in a notebook.

    Parameters
    ----------
    result : its outcome

    Returns
    -------
    HTML: a heading, the first results in display units with intervals, and what needs a look.
    """
    main = [result for result in result.results if is_main(result.name)] or list(result.results)
    rows = [_row(each, result) for each in main[:_MOST]]
    more = len(result.results) - len(rows)
    lines = [
        f"<strong>{_safe(result.test)}</strong> {_safe(_what(result))}",
        f'<table style="border-collapse:collapse">{"".join(rows)}</table>' if rows else "",
        f"<small>{_safe(_rest(result, more))}</small>",
    ]
    return f"<div>{''.join(f'<div>{line}</div>' for line in lines if line)}</div>"


def _safe(text: str) -> str:
    return escape(printable(text))


def _what(result: TestResult) -> str:
    specimen = result.specimen
    parts = [result.protocol, f"{specimen.type}, spool {specimen.spool}, sample {specimen.sample}"]
    parts += [str(result.date)] if result.date else []
    return " · ".join([*parts, *filter(None, [result.operator])])


def _row(each: Result, result: TestResult) -> str:
    factor, unit = shown_in(each.name, each.unit, result.display)
    value = float("nan") if each.value is None else each.value
    written = write_number(value, each.interval, factor, apart=each.apart)
    number = f"{written.value} {unit_words(unit)}" if each.value is not None else written.value
    state = "" if each.status is Status.OK else f"{each.status}: {each.why}"
    cells = [in_words(each.name), number, written.interval, state]
    inner = "".join(f'<td style="{_CELL}">{_safe(cell)}</td>' for cell in cells)
    return f"<tr>{inner}</tr>"


def _rest(result: TestResult, more: int) -> str:
    severities = Counter(note.severity for note in result.quality)
    parts = [f"95 % intervals; {more} more in .results" if more > 0 else "95 % intervals"]
    parts += [
        count_of(severities[each], each.value)
        for each in (Severity.ERROR, Severity.WARNING)
        if severities[each]
    ]
    return ", ".join(parts) + (" in .quality" if len(parts) > 1 else "")
