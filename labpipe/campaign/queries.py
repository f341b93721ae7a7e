"""Query results of a campaign by a condition; write a table, CSV, JSON or workbook."""

from __future__ import annotations

import csv
import json
import re
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, count, islice
from pathlib import Path
from typing import IO, Any, Final

from labpipe.campaign.catalog import Catalog
from labpipe.errors import UsageError, error_text, nearest
from labpipe.store.replace import replacing

COLUMNS: Final = {
    "test": "tests.test",
    "folder": "tests.folder",
    "state": "coalesce((select 'running' from running where running.folder = tests.folder),"
    " tests.state)",
    "type": "tests.type",
    "spool": "tests.spool",
    "sample": "tests.sample",
    "name": "results.name",
    "value": "results.value",
    "unit": "results.unit",
    "lower": "results.lower",
    "upper": "results.upper",
    "level": "results.level",
    "estimate": "results.estimate",
    "status": "results.status",
    "code": "coalesce(results.code, tests.code)",
    "reason": "coalesce(results.reason, tests.reason)",
    "why": "tests.why",
    "protocol": "tests.protocol",
    "date": "tests.date",
    "operator": "tests.operator",
    "labpipe": "tests.labpipe",
    "run": "tests.run",
}
"""SQL expression of each column; dimensions and labels of the tests follow."""
_MAX_SHEET_ROWS: Final = 1_048_575
"""Rows of a worksheet below its heading."""
_ALLOWED: Final = frozenset(
    {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE}
)
_CONTROL_CHARACTERS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Characters that control a terminal or a cell."""

_FORMULA = re.compile(r"(?![-+]\d+(?:\.\d*)?\Z)[=+\-@\t\r\n]")
"""Start of text that a spreadsheet evaluates (OWASP); a signed number is no formula."""
_STEPS_PER_CHECK = 1_000_000


@dataclass(frozen=True, slots=True)
class Answer:
    """Rows of a query, read lazily.

    Parameters
    ----------
    columns : names
    rows : text, numbers or None
    """

    columns: tuple[str, ...]
    rows: Iterator[Sequence[Any]]


@contextmanager
def query_results(catalog: Catalog, where: str) -> Iterator[Answer]:
    """Query results that fit a condition.

    Parameters
    ----------
    catalog : of the campaign
    where : SQL condition on the columns; empty for all. A test without results, such as a failed
        one, is one row

    Yields
    ------
    The rows, sorted by test, in the order of its results.

    Raises
    ------
    UsageError
        If the condition is invalid or takes too long.
    """
    # SQLite steps in millions: for any condition, and added for each result
    base_steps, steps_per_result = 200, 0.05
    with catalog.copy() as connection:
        fields = _fields(connection)
        (results,) = connection.execute("select count(*) from results").fetchone()
        max_steps, passed = base_steps + steps_per_result * results, count(1)
        connection.set_authorizer(_authorize_reads)
        connection.set_progress_handler(lambda: next(passed) > max_steps, _STEPS_PER_CHECK)
        try:
            yield _answer(connection, where, fields)
        finally:
            connection.set_progress_handler(None, 0)
            connection.set_authorizer(None)


def _answer(connection: sqlite3.Connection, where: str, fields: dict[str, str]) -> Answer:
    columns = COLUMNS | fields
    selection = ", ".join(f'{what} as "{name}"' for name, what in columns.items())
    # The condition is on its own line, so that a comment in it ends there.
    condition = f"where (\n{where}\n)" if where.strip() else ""
    sql = (
        f"select * from (select {selection} from tests left join results"
        " on results.folder = tests.folder order by tests.folder, results.place) "
        f"{condition}"
    )
    try:
        rows = connection.execute(sql)
        first = list(islice(rows, 1))  # some errors appear with the first row only
    except (sqlite3.Error, sqlite3.Warning, ValueError) as error:
        raise _condition_error(where, error, list(columns)) from error
    names = tuple(row[0] for row in rows.description)
    return Answer(names, _read_rows(chain(first, rows), where))


def _read_rows(rows: Iterable[Sequence[Any]], where: str) -> Iterator[Sequence[Any]]:
    try:
        yield from rows
    except sqlite3.Error as error:
        raise _condition_error(where, error, []) from error


def _condition_error(where: str, error: Exception, columns: list[str]) -> UsageError:
    message = str(error)
    remedy = "See the columns in docs/how-to/run-a-campaign.md."
    missing = re.match(r"no such column: \"?([^\"]*?)\"?(?: - .*)?$", message)
    if missing:
        close = ", ".join(nearest(missing[1], columns, limit=3))
        remedy = f"Nearest: {close}. Write text in single quotes: type = 'A1'."
    elif "interrupted" in message:
        message, remedy = "one that takes too long", "Limit its recursive part."
    elif "not authorized" in message or "prohibited" in message:
        remedy = "A condition can only read the columns."
    return UsageError(
        error_text(
            "--where", repr(where), expected="a condition in SQL", found=message, remedy=remedy
        )
    )


def _authorize_reads(action: int, *_: str | None) -> int:
    """Allow SQLite to read the tables, and nothing else."""
    return sqlite3.SQLITE_OK if action in _ALLOWED else sqlite3.SQLITE_DENY


def _fields(connection: sqlite3.Connection) -> dict[str, str]:
    """Return SQL expressions for the dimensions and labels of the tests by name."""
    max_fields = 200
    numbers = (
        "select distinct key from tests, json_each(tests.specimen)"
        " where json_each.type in ('real', 'integer', 'text') order by key"
    )
    labels = "select distinct key from tests, json_each(tests.specimen, '$.labels') order by key"
    fields: dict[str, str] = {}
    for sql, place in ((numbers, ""), (labels, "labels")):
        for (key,) in connection.execute(sql):
            name = str(key).casefold()
            if name in COLUMNS or name in fields or len(fields) >= max_fields or '"' in name:
                continue
            path = ".".join(filter(None, ("$", place, json.dumps(key, ensure_ascii=False))))
            quoted = path.replace("'", "''")
            fields[name] = f"json_extract(tests.specimen, '{quoted}')"
    return fields


def write_answer(answer: Answer, form: str, out: IO[str]) -> int:
    """Write rows one by one.

    Parameters
    ----------
    answer : the rows
    form : ``table``, ``csv`` or ``json``
    out : text stream

    Returns
    -------
    Number of rows.
    """
    return {"table": _table, "csv": _csv, "json": _json}[form](answer, out)


def _table(answer: Answer, out: IO[str]) -> int:
    """Write a table without keys, and without columns that are empty or repeat the first one."""
    # rows that set the column widths
    sampled_rows = 500
    head = [[_cell(cell) for cell in row] for row in islice(answer.rows, sampled_rows)]
    visible = [
        n
        for n, name in enumerate(answer.columns)
        if name != "run" and any(row[n] and (n == 0 or row[n] != row[0]) for row in head)
    ]
    names = {n: escaped(answer.columns[n]) for n in visible}
    widths = {n: max(len(names[n]), *(len(row[n]) for row in head)) for n in visible}
    if visible:
        out.write("  ".join(f"{names[n]:<{widths[n]}}" for n in visible).rstrip() + "\n")
    count = 0
    for row in chain(head, ([_cell(cell) for cell in row] for row in answer.rows)):
        out.write("  ".join(f"{row[n]:<{widths[n]}}" for n in visible).rstrip() + "\n")
        count += 1
    return count


def _cell(value: object) -> str:
    """Format a value for a terminal, with control characters escaped."""
    if value is None:
        return ""
    text = f"{value:.6g}" if isinstance(value, float) else escaped(str(value))
    max_width = 60
    return text if len(text) <= max_width else f"{text[: max_width - 3]}..."


def escaped(text: str) -> str:
    """Escape control characters for a terminal.

    Parameters
    ----------
    text : any
    """
    return _CONTROL_CHARACTERS.sub(lambda sign: sign[0].encode("unicode_escape").decode(), text)


def _csv(answer: Answer, out: IO[str]) -> int:
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(_quote_formula, answer.columns))
    count = 0
    for row in answer.rows:
        writer.writerow(map(_quote_formula, row))
        count += 1
    return count


def _quote_formula(value: object) -> object:
    """Put an apostrophe before text that a spreadsheet would evaluate."""
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def _json(answer: Answer, out: IO[str]) -> int:
    count = 0
    out.write("[")
    for row in answer.rows:
        entry = dict(zip(answer.columns, row, strict=True))
        out.write(f"{',' if count else ''}\n{json.dumps(entry, ensure_ascii=False)}")
        count += 1
    out.write("\n]\n")
    return count


def write_workbook(answer: Answer, path: Path) -> int:
    """Write rows as a workbook.

    Parameters
    ----------
    answer : the rows
    path : of the file; an existing file is replaced at the end

    Returns
    -------
    Number of rows.

    Raises
    ------
    UsageError
        If there are too many rows for a worksheet.
    StoreError
        If the file cannot be written.
    """
    from openpyxl import Workbook
    from openpyxl.cell import WriteOnlyCell

    book = Workbook(write_only=True)
    sheet = book.create_sheet("results")
    for n_rows, row in enumerate(chain([answer.columns], answer.rows)):
        if n_rows > _MAX_SHEET_ROWS:
            sheet.close()
            remedy = "Select fewer with --where, or use --out csv."
            expected = f"{_MAX_SHEET_ROWS} rows at most"
            raise UsageError(error_text(path, "", expected=expected, found="more", remedy=remedy))
        cells = []
        for value in row:
            cell = WriteOnlyCell(sheet, escaped(value) if isinstance(value, str) else value)
            if isinstance(value, str):
                cell.data_type = "s"  # not a formula, even with a leading =
            cells.append(cell)
        sheet.append(cells)
    with replacing(path) as temporary:
        book.save(temporary)
    return n_rows
