"""Show a test in a notebook as a few lines of HTML, with all text escaped."""

from __future__ import annotations

from collections import Counter
from html import escape

from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult
from labpipe.report.wording import (
    as_label,
    count_of,
    is_main,
    printable,
    shown_in,
    unit_words,
    write_number,
)

_CELL = "text-align:left;padding:1px 12px 1px 0"


def page_of(result: TestResult) -> str:
    """Return the HTML of a test for a notebook.

    Parameters
    ----------
    result : the processed test

    Returns
    -------
    A heading, the first results in display units with intervals, and counts of problems.
    """
    # Results that are shown; the rest are counted.
    max_rows = 10
    main = [result for result in result.results if is_main(result.name)] or list(result.results)
    rows = [_row(shown, result) for shown in main[:max_rows]]
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


def _row(result: Result, test: TestResult) -> str:
    factor, unit = shown_in(result.name, result.unit, test.display)
    value = float("nan") if result.value is None else result.value
    written = write_number(value, result.interval, factor, estimate=result.distinct_estimate)
    number = f"{written.value} {unit_words(unit)}" if result.value is not None else written.value
    state = "" if result.status is Status.OK else f"{result.status}: {result.why}"
    cells = [as_label(result.name), number, written.interval, state]
    inner = "".join(f'<td style="{_CELL}">{_safe(cell)}</td>' for cell in cells)
    return f"<tr>{inner}</tr>"


def _rest(result: TestResult, more: int) -> str:
    severities = Counter(note.severity for note in result.quality)
    parts = [f"95 % intervals; {more} more in .results" if more > 0 else "95 % intervals"]
    parts += [
        count_of(severities[severity], severity.value)
        for severity in (Severity.ERROR, Severity.WARNING)
        if severities[severity]
    ]
    return ", ".join(parts) + (" in .quality" if len(parts) > 1 else "")
