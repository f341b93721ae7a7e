"""Results of a campaign that fit a condition, row by row, as table, CSV, JSON or workbook."""

from __future__ import annotations

import csv
import json
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
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
"""Columns of a query, and what each is in the tables; dimensions and labels of the tests follow."""
_MOST_FIELDS = 200
_MOST_ROWS: Final = 1_048_575
"""Rows that a sheet of a workbook takes below its heading."""
_ALLOWED: Final = frozenset(
    {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE}
)
_SAMPLED = 500
"""Rows by which the widths of a table are chosen."""
_WIDEST = 60
_UNSHOWN = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Characters that would do something to a terminal, or to a cell."""

_FORMULA = re.compile(r"(?![-+]\d+(?:\.\d*)?\Z)[=+\-@\t\r\n]")
"""How text begins that a spreadsheet takes for a formula (OWASP); a number with a sign is none."""
_STEPS = 1_000_000
_MOST_STEPS, _STEPS_A_ROW = 200, 0.05
"""Steps of SQLite, in millions, that a condition may take: in any case, and for each result."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Rows of a query; they are read as they are asked for.

    Parameters
    ----------
    columns : names
    rows : text, numbers or None
    count : counts all of them, without reading any
    """

    columns: tuple[str, ...]
    rows: Iterator[Sequence[Any]]
    count: Callable[[], int]


@contextmanager
def answered(catalog: Catalog, where: str) -> Iterator[Answer]:
    """Ask for results that fit a condition.

    Parameters
    ----------
    catalog : of the campaign
    where : condition in SQL over the columns; empty for all. A test without results, such as one
        that failed, is one row without them

    Yields
    ------
    The rows, sorted by test, in the order of its results.

    Raises
    ------
    UsageError
        If the condition is none, or does not come to an end.
    """
    with catalog.reading() as connection:
        fields = _fields(connection)
        (results,) = connection.execute("select count(*) from results").fetchone()
        most, passed = _MOST_STEPS + _STEPS_A_ROW * results, count(1)
        connection.set_authorizer(_only_reads)
        connection.set_progress_handler(lambda: next(passed) > most, _STEPS)
        try:
            yield _asked(connection, where, fields)
        finally:
            connection.set_progress_handler(None, 0)
            connection.set_authorizer(None)


def _asked(connection: sqlite3.Connection, where: str, fields: dict[str, str]) -> Answer:
    columns = COLUMNS | fields
    said = ", ".join(f'{what} as "{name}"' for name, what in columns.items())
    # The condition is a line of its own, so that a comment in it ends.
    condition = f"where (\n{where}\n)" if where.strip() else ""
    sql = (
        f"select * from (select {said} from tests left join results"
        " on results.folder = tests.folder order by tests.folder, results.place) "
        f"{condition}"
    )
    try:
        rows = connection.execute(sql)
        first = list(islice(rows, 1))  # what is wrong may show with the first row only
    except (sqlite3.Error, sqlite3.Warning, ValueError) as error:
        raise _no_condition(where, error, list(columns)) from error
    names = tuple(row[0] for row in rows.description)

    def counted() -> int:
        counts = connection.execute(f"select count(*) from ({sql})")
        return int(next(_reading(counts, where))[0])

    return Answer(names, _reading(chain(first, rows), where), counted)


def _reading(rows: Iterable[Sequence[Any]], where: str) -> Iterator[Sequence[Any]]:
    try:
        yield from rows
    except sqlite3.Error as error:
        raise _no_condition(where, error, []) from error


def _no_condition(where: str, error: Exception, columns: list[str]) -> UsageError:
    said = str(error)
    remedy = "See the columns in docs/how-to/run-a-campaign.md."
    missing = re.match(r"no such column: \"?([^\"]*?)\"?(?: - .*)?$", said)
    if missing:
        close = ", ".join(nearest(missing[1], columns, most=3))
        remedy = f"Nearest: {close}. Text stands in single quotes: type = 'A1'."
    elif "interrupted" in said:
        said, remedy = "one without an end", "A recursive part needs a limit."
    elif "not authorized" in said or "prohibited" in said:
        remedy = "A condition can only look at the columns."
    return UsageError(
        error_text("--where", repr(where), expected="a condition in SQL", found=said, remedy=remedy)
    )


def _only_reads(action: int, *_: str | None) -> int:
    """Let SQLite do what looks at the tables, and nothing else."""
    return sqlite3.SQLITE_OK if action in _ALLOWED else sqlite3.SQLITE_DENY


def _fields(connection: sqlite3.Connection) -> dict[str, str]:
    """Columns for the dimensions and labels that the tests have, by name."""
    numbers = (
        "select distinct key from tests, json_each(tests.specimen)"
        " where json_each.type in ('real', 'integer', 'text') order by key"
    )
    labels = "select distinct key from tests, json_each(tests.specimen, '$.labels') order by key"
    fields: dict[str, str] = {}
    for sql, place in ((numbers, ""), (labels, "labels")):
        for (key,) in connection.execute(sql):
            name = str(key).casefold()
            if name in COLUMNS or name in fields or len(fields) >= _MOST_FIELDS or '"' in name:
                continue
            path = ".".join(filter(None, ("$", place, json.dumps(key, ensure_ascii=False))))
            quoted = path.replace("'", "''")
            fields[name] = f"json_extract(tests.specimen, '{quoted}')"
    return fields


def write_answer(answer: Answer, form: str, out: IO[str]) -> int:
    """Write rows as they come.

    Parameters
    ----------
    answer : the rows
    form : ``table``, ``csv`` or ``json``
    out : takes text

    Returns
    -------
    Number of rows.
    """
    return {"table": _table, "csv": _csv, "json": _json}[form](answer, out)


def _table(answer: Answer, out: IO[str]) -> int:
    """Keys, and columns that hold nothing in the first rows or repeat the first, are left out."""
    head = [[_cell(cell) for cell in row] for row in islice(answer.rows, _SAMPLED)]
    shown = [
        n
        for n, name in enumerate(answer.columns)
        if name != "run" and any(row[n] and (n == 0 or row[n] != row[0]) for row in head)
    ]
    names = {n: escaped(answer.columns[n]) for n in shown}
    widths = {n: max(len(names[n]), *(len(row[n]) for row in head)) for n in shown}
    if shown:
        out.write("  ".join(f"{names[n]:<{widths[n]}}" for n in shown).rstrip() + "\n")
    count = 0
    for row in chain(head, ([_cell(cell) for cell in row] for row in answer.rows)):
        out.write("  ".join(f"{row[n]:<{widths[n]}}" for n in shown).rstrip() + "\n")
        count += 1
    return count


def _cell(said: object) -> str:
    """A value on a terminal: what would do something to it is written out."""
    if said is None:
        return ""
    text = f"{said:.6g}" if isinstance(said, float) else escaped(str(said))
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."


def escaped(text: str) -> str:
    """Write control characters out, so that a terminal shows them instead of obeying.

    Parameters
    ----------
    text : any
    """
    return _UNSHOWN.sub(lambda sign: sign[0].encode("unicode_escape").decode(), text)


def _csv(answer: Answer, out: IO[str]) -> int:
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(_no_formula, answer.columns))
    count = 0
    for row in answer.rows:
        writer.writerow(map(_no_formula, row))
        count += 1
    return count


def _no_formula(said: object) -> object:
    """A value of a csv: text that a spreadsheet would work out has an apostrophe before it."""
    return f"'{said}" if isinstance(said, str) and _FORMULA.match(said) else said


def _json(answer: Answer, out: IO[str]) -> int:
    count = 0
    out.write("[")
    for row in answer.rows:
        said = dict(zip(answer.columns, row, strict=True))
        out.write(f"{',' if count else ''}\n{json.dumps(said, ensure_ascii=False)}")
        count += 1
    out.write("\n]\n")
    return count


def write_workbook(answer: Answer, path: Path) -> int:
    """Write rows as a workbook, as they come.

    Parameters
    ----------
    answer : the rows
    path : of the file; what stood there before stays until all is written

    Returns
    -------
    Number of rows.

    Raises
    ------
    UsageError
        If there are more than a sheet takes.
    StoreError
        If the file cannot be written.
    """
    from openpyxl import Workbook
    from openpyxl.cell import WriteOnlyCell

    count = answer.count()
    if count > _MOST_ROWS:
        remedy = "Ask for less with --where, or take --out csv."
        expected = f"{_MOST_ROWS} rows at the most"
        raise UsageError(error_text(path, "", expected=expected, found=f"{count}", remedy=remedy))
    book = Workbook(write_only=True)
    sheet = book.create_sheet("results")
    for row in chain([answer.columns], answer.rows):
        cells = []
        for said in row:
            cell = WriteOnlyCell(sheet, escaped(said) if isinstance(said, str) else said)
            if isinstance(said, str):
                cell.data_type = "s"  # text that begins with = is no formula
            cells.append(cell)
        sheet.append(cells)
    with replacing(path) as temporary:
        book.save(temporary)
    return count
