from __future__ import annotations

import csv
import io
import json
import re
import string
from collections.abc import Iterator
from pathlib import Path

import openpyxl
import pytest

from labpipe.campaign.catalog import (
    OK,
    Catalog,
    Entry,
    TestRow,
    open_catalog,
    write_json,
)
from labpipe.campaign.queries import (
    QueryResult,
    format_query_result,
    query_results,
    write_workbook,
)
from labpipe.errors import UsageError
from labpipe.report.wording import replace_unprintable
from labpipe.store.layout import ResultRow

NASTY = "=1+1 " + string.printable + "\x00\x1b[31m\u202eü"


def result(name: str, value: float | None, **more: object) -> ResultRow:
    texts = {"status": "ok", "code": "", "reason": ""} | more
    return ResultRow(name, value, value, None, None, "N", 0.95, **texts)  # type: ignore[arg-type]


def test_row(folder: str, kind: str, **specimen: object) -> TestRow:
    fields = {"type": kind, "spool": "s", "sample": "1", **specimen}
    return TestRow(folder, test=folder, state=OK, type=kind, spool="s", sample="1",
                   specimen=write_json(fields), date="2026-03-09", run="r")  # fmt: skip


test_row.__test__ = False  # type: ignore[attr-defined]


@pytest.fixture
def catalog(tmp_path: Path) -> Iterator[Catalog]:
    catalog = open_catalog(tmp_path, [])
    peaks = (result("peak_force.1", 1.5), result("energy.1", None, status="failed", code="no_end",
                                                  reason="it has no end"))  # fmt: skip
    first = test_row("T1", "A1", length=0.085, labels={"room temperature": "23", "cured": "24 h"})
    second = test_row(
        "T2", "A2", length=0.1, labels={"cured": NASTY.replace("\x00", "")}, **{"=odd\x07": "x"}
    )
    catalog.write_entries([
        Entry(first, results=peaks),
        Entry(second, results=(result("peak_force.1", 2.5),)),
        Entry(TestRow("T3", test="T3", state="failed", code="process_died")),
    ])  # fmt: skip
    yield catalog
    catalog.close()


def query(catalog: Catalog, where: str) -> list[dict[str, object]]:
    result = query_results(catalog, where)
    return [dict(zip(result.columns, row, strict=True)) for row in result.rows]


@pytest.mark.parametrize(
    ("where", "tests"),
    [
        ("", ["T1", "T1", "T2", "T3"]),
        ("name = 'peak_force.1' and type = 'A1'", ["T1"]),
        ("value > 2", ["T2"]),
        ("length between 0.08 and 0.09 and value is not null", ["T1"]),
        ("status = 'failed' and code = 'no_end'", ["T1"]),
        ("\"room temperature\" = '23' -- and a remark", ["T1", "T1"]),
        ("date >= '2026-03-01' and name like 'peak%'", ["T1", "T2"]),
        ("test in (select test from tests where state = 'failed')", ["T3"]),
    ],
)
def test_conditions(catalog: Catalog, where: str, tests: list[str]) -> None:
    assert [row["test"] for row in query(catalog, where)] == tests


ENDLESS = "(with recursive n(i) as (select 1 union all select i + 1 from n) select max(i) from n)"


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("forse > 1", r"found no such column: forse\. Nearest: "),
        ("type = A1 or nam = 2", r"found no such column: A1\. Nearest: .*Write text in single"),
        ("name = 'x", "found unrecognized token"),
        ("1; drop table tests", "found near"),
        ("1) ; drop table tests; --", "one statement at a time"),
        ("(select count(*) from pragma_table_info('tests')) > 0", "A condition can only read"),
        (f"{'(' * 5000}1{')' * 5000}", "found "),
        ("'\ud800' = name", "found "),
        (f"{ENDLESS} > 0", r"found a condition that takes too long\. Limit its recursive part"),
    ],
)
def test_invalid_conditions_are_refused(
    catalog: Catalog, where: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.campaign.queries._STEPS_PER_CHECK", 1000)
    with pytest.raises(
        UsageError, match=r"(?s)^--where, .*: expected a condition in SQL"
    ) as caught:
        query(catalog, where)
    assert re.search(message, str(caught.value))
    assert len(query(catalog, "")) == 4


def written(catalog: Catalog, form: str, where: str = "") -> str:
    return format_query_result(query_results(catalog, where), form)


def test_csv_and_json_keep_every_character(catalog: Catalog) -> None:
    nasty = NASTY.replace("\x00", "")
    rows = list(csv.DictReader(io.StringIO(written(catalog, "csv"), newline="")))
    assert [row["cured"] for row in rows] == ["24 h", "24 h", f"'{nasty}", ""]  # no formula
    assert [row["value"] for row in rows] == ["1.5", "", "2.5", ""]
    entries = json.loads(written(catalog, "json"))
    assert [row["cured"] for row in entries] == ["24 h", "24 h", nasty, None]
    assert entries == query(catalog, "")
    assert json.loads(written(catalog, "json", "0")) == []


@pytest.mark.parametrize(
    "cell",
    ["'=HYPERLINK(1)", "'+1+1", "'-A1", "'@SUM(1)", "'\t=1", "-1.5", "+49", "2 mm = 1"],
)
def test_formulas_in_csv_are_quoted(cell: str) -> None:
    """A quote stands before what a spreadsheet would take for a formula."""
    text = cell.removeprefix("'")
    content = format_query_result(QueryResult((text, "value"), [(text, -1.5)]), "csv")
    rows = list(csv.reader(io.StringIO(content, newline="")))
    assert rows == [[cell, "value"], [cell, "-1.5"]]


def test_a_workbook_holds_text_as_text(catalog: Catalog, tmp_path: Path) -> None:
    write_workbook(query_results(catalog, ""), tmp_path / "out.xlsx")
    sheet = openpyxl.load_workbook(tmp_path / "out.xlsx")["results"]
    rows = list(sheet.iter_rows())
    assert ("s", "=odd\ufffd") in [(cell.data_type, cell.value) for cell in rows[0]]
    place = [cell.value for cell in rows[0]].index("cured")
    cell = rows[3][place]
    assert (cell.data_type, str(cell.value)[:5]) == ("s", "=1+1 ")
    text = replace_unprintable(NASTY.replace("\x00", ""))
    assert cell.value == text.replace("\r", "_x000D_")
    assert [row[7].value for row in rows[1:]] == [1.5, None, 2.5, None]


def test_too_many_rows_for_a_worksheet_are_refused(
    catalog: Catalog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.campaign.queries._MAX_SHEET_ROWS", 3)
    message = "expected at most 3 rows, found more. Select fewer with --where, or use"
    with pytest.raises(UsageError, match=message):
        write_workbook(query_results(catalog, ""), tmp_path / "out.xlsx")
    assert not (tmp_path / "out.xlsx").exists()
