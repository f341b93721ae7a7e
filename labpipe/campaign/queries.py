"""Query the results of a campaign by an SQL condition; write a table, CSV, JSON or a workbook."""

from __future__ import annotations

import csv
import io
import json
import re
import sqlite3
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from sqlite3 import SQLITE_DENY, SQLITE_OK
from typing import Any, Final

from labpipe.campaign.catalog import RESULT_COLUMNS, Catalog
from labpipe.errors import UsageError, sort_by_likeness
from labpipe.statistics.lots import PEAK_OVER_LIMIT

_COMPUTED_COLUMNS: Final = {
    "state": "coalesce((select 'running' from running where running.folder = tests.folder),"
    " tests.state)",
    "code": "coalesce(results.code, tests.code)",
    "verdict": f"case when results.name = '{PEAK_OVER_LIMIT}' then"
    " case when results.value >= 1 then 'pass' when results.value < 1 then 'fail' end end",
    "reason": "coalesce(results.reason, tests.reason)",
}
"""SQL expressions of columns that no table has, keyed by column."""
QUERY_COLUMNS: Final = {
    name: _COMPUTED_COLUMNS.get(name)
    or (f"results.{name}" if name in RESULT_COLUMNS else f"tests.{name}")
    for name in (
        *("test", "folder", "state", "type", "spool", "sample", "name", "value", "unit", "lower"),
        *("upper", "level", "estimate", "status", "code", "verdict", "reason", "why", "protocol"),
        *("date", "operator", "labpipe", "run"),
    )
}
"""SQL expressions, keyed by column; a query adds dimensions, labels and observations."""
_MAX_SHEET_ROWS: Final = 1_048_575
"""Largest number of rows of a worksheet below its header row."""
_ALLOWED_ACTIONS: Final = frozenset(
    {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE}
)
"""Actions that SQLite allows a condition: to select, to read and to call functions."""
_CONTROL_CHARACTERS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Characters that control a terminal or change the direction of text."""

_FORMULA_START = re.compile(r"(?![-+]\d+(?:\.\d*)?\Z)[=+\-@\t\r\n]")
"""First character of text that a spreadsheet evaluates, as listed by OWASP.

Signed numbers are excluded.
"""
_STEPS_PER_CHECK = 1_000_000
"""Number of SQLite steps between two checks of the duration of a query."""


@dataclass(frozen=True, slots=True)
class QueryResult:
    """Rows of a query.

    Parameters
    ----------
    columns : names of the columns
    rows : cells of each row in the order of the columns; a cell is a text, a number or None
    """

    columns: tuple[str, ...]
    rows: Sequence[Sequence[Any]]


def query_results(catalog: Catalog, condition: str) -> QueryResult:
    """Query the results that match a condition.

    Parameters
    ----------
    catalog : catalog of the campaign
    condition : SQL condition on the columns; empty for all results

    Returns
    -------
    One row for each result, sorted by folder of the test. A test without results, such as a pending
    test, has one row.

    Raises
    ------
    UsageError
        If the condition is invalid or takes too long.
    """
    base_checks, checks_per_result = 200, 0.05  # a query with more checks is stopped
    with catalog.open_copy() as connection:
        columns = QUERY_COLUMNS | _list_specimen_columns(connection)
        (n_results,) = connection.execute("select count(*) from results").fetchone()
        max_checks, check_numbers = base_checks + checks_per_result * n_results, count(1)
        connection.set_authorizer(
            lambda action, *_: SQLITE_OK if action in _ALLOWED_ACTIONS else SQLITE_DENY
        )
        connection.set_progress_handler(lambda: next(check_numbers) > max_checks, _STEPS_PER_CHECK)
        selection = ", ".join(f'{sql} as "{name}"' for name, sql in columns.items())
        # The condition is on its own line, so that a comment in it ends there.
        clause = f"where (\n{condition}\n)" if condition.strip() else ""
        sql = (
            f"select * from (select {selection} from tests left join results"
            " on results.folder = tests.folder order by tests.folder, results.place) "
            f"{clause}"
        )
        try:
            return QueryResult(tuple(columns), connection.execute(sql).fetchall())
        except (sqlite3.Error, sqlite3.Warning, ValueError) as error:
            raise _make_condition_error(condition, str(error), list(columns)) from error


def _make_condition_error(condition: str, message: str, columns: list[str]) -> UsageError:
    """Make the error of a condition from the message of SQLite."""
    place = repr(condition)
    if match := re.match(r"no such column: \"?([^\"]*?)\"?(?: - .*)?$", message):
        near = ", ".join(sort_by_likeness(match[1], columns, limit=3))
        return UsageError.about(
            "campaign.unknown_column", "--where", place, message=message, near=near
        )
    if "interrupted" in message:
        return UsageError.about("campaign.slow_condition", "--where", place)
    if "not authorized" in message or "prohibited" in message:
        return UsageError.about("campaign.forbidden_condition", "--where", place, message=message)
    return UsageError.about("campaign.bad_condition", "--where", place, message=message)


def _list_specimen_columns(connection: sqlite3.Connection) -> dict[str, str]:
    """List the SQL expressions of dimensions, labels and observations, keyed by column."""
    max_columns = 200
    scalar_clause = "where json_each.type in ('real', 'integer', 'text')"
    columns: dict[str, str] = {}
    for block, clause in (("$", scalar_clause), ("$.labels", ""), ("$.observed", "")):
        table = f"tests, json_each(tests.specimen, '{block}')"
        sql = f"select distinct key from {table} {clause} order by key"
        for (key,) in connection.execute(sql):
            name = str(key).casefold()
            is_taken = name in QUERY_COLUMNS or name in columns
            if is_taken or len(columns) >= max_columns or '"' in name:
                continue
            path = f"{block}.{json.dumps(key, ensure_ascii=False)}".replace("'", "''")
            columns[name] = f"json_extract(tests.specimen, '{path}')"
    return columns


def format_query_result(query_result: QueryResult, output_format: str) -> str:
    """Format rows as text.

    Parameters
    ----------
    query_result : rows to format
    output_format : ``table``, ``csv`` or ``json``. A table is for a terminal: it has no column
        ``run``, no empty columns, and no columns that are equal to the first one
    """
    names, rows = query_result.columns, query_result.rows
    if output_format == "csv":
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows(
            map(_quote_formula, row) for row in (names, *rows)
        )
        return buffer.getvalue()
    if output_format == "json":
        entries = (dict(zip(names, row, strict=True)) for row in rows)
        lines = ",".join(f"\n{json.dumps(entry, ensure_ascii=False)}" for entry in entries)
        return f"[{lines}\n]\n"
    first_column, *other_columns = [
        [*map(_format_cell, cells)] for cells in zip(names, *rows, strict=True)
    ]
    columns = [first_column, *(cells for cells in other_columns if cells[1:] != first_column[1:])]
    shown_columns = [cells for cells in columns if cells[0] != "run" and any(cells[1:])]
    return "".join(f"{line}\n" for line in align_columns(shown_columns))


def align_columns(columns: Iterable[Sequence[str]], n_left_aligned: int | None = None) -> list[str]:
    """Align the columns of a table for a terminal, and return its lines.

    Parameters
    ----------
    columns : cells of each column; all columns have the same number of cells
    n_left_aligned : number of first columns that are aligned at the left; the other columns are
        aligned at the right. None to align all columns at the left
    """
    aligned_columns = []
    for index, column in enumerate(columns):
        side = "<" if n_left_aligned is None or index < n_left_aligned else ">"
        aligned_columns.append([f"{cell:{side}{max(map(len, column))}}" for cell in column])
    return ["  ".join(row).rstrip() for row in zip(*aligned_columns, strict=True)]


def join_names(names: Sequence[str], max_names: int = 4) -> str:
    """Join the first names by commas, and state how many more there are.

    Parameters
    ----------
    names : names in order
    max_names : largest number of names in the text
    """
    suffix = f" and {len(names) - max_names} more" if len(names) > max_names else ""
    return ", ".join(names[:max_names]) + suffix


def _format_cell(value: object) -> str:
    """Format a value for a terminal; control characters are escaped, long text is shortened."""
    if value is None:
        return ""
    text = f"{value:.6g}" if isinstance(value, float) else escape_controls(str(value))
    max_width = 60
    return text if len(text) <= max_width else f"{text[: max_width - 3]}..."


def escape_controls(text: str) -> str:
    """Escape characters that control a terminal or change the direction of text.

    Parameters
    ----------
    text : any text
    """
    return _CONTROL_CHARACTERS.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def _quote_formula(value: object) -> object:
    """Return a value; text that a spreadsheet would evaluate gets an apostrophe before it."""
    return f"'{value}" if isinstance(value, str) and _FORMULA_START.match(value) else value


def write_workbook(query_result: QueryResult, path: Path) -> None:
    """Write rows as a workbook.

    Parameters
    ----------
    query_result : rows to write
    path : path of the file; an existing file is replaced after the new one is complete

    Raises
    ------
    UsageError
        If there are too many rows for a worksheet.
    StoreError
        If the file cannot be written.
    """
    from labpipe.report.table_records import Table, save_tables

    if len(query_result.rows) > _MAX_SHEET_ROWS:
        raise UsageError.about("campaign.too_many_rows", path, limit=_MAX_SHEET_ROWS)
    table = Table("results", query_result.columns, query_result.rows)
    save_tables([table], path, book="query", title="Results of a campaign")
