from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from openpyxl import load_workbook
from openpyxl.workbook import Workbook
from python_calamine import CalamineWorkbook

from labpipe.errors import StoreError
from labpipe.records.wire import WireTable
from labpipe.report.wire_workbook import MOST_ROWS, save_wire_workbook
from labpipe.wire.cantilever_curve import force_at
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import CUT, troubled

REFUSED = {"Z1": "wires.xlsx, row 4: expected a wire that can be built, found this: no room."}


def saved(tables: Sequence[WireTable], folder: Path) -> Workbook:
    save_wire_workbook(tables, folder / "wires.xlsx", refused=REFUSED)
    return load_workbook(folder / "wires.xlsx")


def rows(book: Workbook, name: str) -> list[dict[str, Any]]:
    heads, *below = book[name].iter_rows(values_only=True)
    return [dict(zip(map(str, heads), row, strict=True)) for row in below]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("book")


@pytest.fixture(scope="module")
def book(folder: Path) -> Workbook:
    return saved([wire_table("A1"), troubled()], folder)


SHEETS = ["read me", "wires", "laws", "cantilevers", "onsets of slip", "strands", "notes"]


def of_wire(book: Workbook, name: str, wire: str) -> list[dict[str, Any]]:
    return [row for row in rows(book, name) if row["wire"] == wire]


def test_one_sheet_for_each_question(book: Workbook) -> None:
    assert book.sheetnames == SHEETS
    assert book.active is not None
    assert book.active.title == "wires"
    assert [sheet.freeze_panes for sheet in book.worksheets[1:4]] == ["B2", "C2", "B2"]
    for sheet in book.worksheets[1:]:
        assert len(sheet.tables) == 1
        assert sheet["A1"].font.bold
        assert sheet["A1"].alignment.wrap_text


def test_summary_has_refused_wires_first_and_numbers_as_numbers(book: Workbook) -> None:
    refused, first, second = rows(book, "wires")
    assert refused["wire"] == "Z1"
    assert refused["warnings"] == f"not modelled: {REFUSED['Z1']}"
    assert refused["strands"] is None
    table = wire_table("A1")
    assert first["stick stiffness (N·mm²)"] == pytest.approx(1e6 * table.stick_stiffness)
    assert first["rows of the law"] == first["rows shown"] == len(table.curvature)
    assert first["error between the rows shown, largest (% of moment)"] == 0.0
    force = force_at(table, 20e-3)
    assert first["end load at 20 mm (N)"] == pytest.approx(force)
    assert (second["wire"], second["end load at 20 mm (N)"]) == ("A3", None)
    assert second["warnings"] == CUT.message


def test_names_lead_to_their_laws(book: Workbook) -> None:
    links = [book["wires"][f"A{row}"].hyperlink for row in (2, 3, 4)]
    assert links[0] is None
    places = [link.location for link in links[1:]]
    assert places == ["'laws'!A2", f"'laws'!A{len(wire_table('A1').curvature) + 2}"]
    assert book["laws"][places[1].partition("!")[2]].value == "A3"


def test_notes_with_what_is_worst_first(book: Workbook) -> None:
    assert [(row["wire"], row["kind"], row["code"]) for row in rows(book, "notes")] == [
        ("Z1", "not modelled", "refused"),
        ("A1", "warning", "insulation_doubtful"),
        ("A3", "warning", "cantilever_cut"),
        ("A3", "info", "defaults_taken"),
    ]


def test_law_of_a_wire_and_what_belongs_to_it(book: Workbook) -> None:
    table = wire_table("A1")
    law = of_wire(book, "laws", "A1")
    assert len(law) == len(table.curvature)
    for head, values in {
        "curvature (1/m)": table.curvature,
        "moment (N·mm)": 1e3 * table.moment,
        "lost to yielding (N·mm)": 1e3 * table.plastic,
        "secant stiffness (N·mm²)": 1e6 * table.secant_stiffness,
        "highest moment of all orientations (N·mm)": 1e3 * table.highest_moment,
    }.items():
        np.testing.assert_allclose([row[head] for row in law], values, rtol=1e-14)
    loads = [row["end load (N)"] for row in of_wire(book, "cantilevers", "A1")]
    np.testing.assert_allclose(loads, table.tip_force, rtol=1e-14)
    limit = 1e3 * table.doubtful_deflection
    [summary] = of_wire(book, "wires", "A1")
    assert summary["doubtful beyond, deflection (mm)"] == pytest.approx(limit)
    doubt = [row["doubtful"] for row in of_wire(book, "cantilevers", "A1")]
    assert doubt == [
        "yes" if each > table.doubtful_deflection else None for each in table.tip_deflection
    ]
    assert None in doubt
    assert "yes" in doubt
    found = of_wire(book, "onsets of slip", "A1")
    onsets = [row["strands begin to slip (1/m)"] for row in found]
    np.testing.assert_allclose(onsets, table.slip_onsets)
    strands = of_wire(book, "strands", "A1")
    assert [row["layer"] for row in strands] == [0, 1, 1, 1, 1, 1, 1]
    assert strands[1]["x (mm)"] == pytest.approx(0.26)


def test_laws_are_drawn_on_logarithmic_axes(book: Workbook, folder: Path) -> None:
    laws: Any = book["laws"]
    assert len(laws._charts) == 2
    with zipfile.ZipFile(folder / "wires.xlsx") as parts:
        chart = parts.read("xl/charts/chart1.xml")
    assert chart.count(b"<c:logBase") == 2
    assert b"laws!$B$3:$B$" in chart  # not the zero of the first row


def test_other_programs_read_the_same(book: Workbook, folder: Path) -> None:
    other = CalamineWorkbook.from_path(folder / "wires.xlsx")
    assert other.sheet_names == book.sheetnames
    for name in book.sheetnames:
        own = [[value or 0 for value in row] for row in book[name].iter_rows(values_only=True)]
        read = [[value or 0 for value in row] for row in other.get_sheet_by_name(name).to_python()]
        assert read == own


def test_values_that_are_not_finite_are_empty_cells(tmp_path: Path) -> None:
    never = replace(wire_table("A1"), slip_onsets=np.array([0.03, np.inf]))
    found = rows(saved([never], tmp_path), "onsets of slip")
    assert [row["strands begin to slip (1/m)"] for row in found] == [0.03, None]


def test_any_name_of_a_wire(tmp_path: Path) -> None:
    names = ["x" * 40, "x" * 41, "a/b", "wires", "Notes"]
    book = saved([replace(wire_table("A1"), name=name) for name in names], tmp_path)
    assert book.sheetnames == SHEETS
    assert [row["wire"] for row in rows(book, "wires")] == ["Z1", *names]
    place = book["wires"]["A5"].hyperlink.location.partition("!")[2]
    assert book["laws"][place].value == "a/b"


@pytest.mark.parametrize("name", ["=1+1", "#N/A", "+2", "@SUM(A1)", "a\x07b"])
def test_text_stays_text(name: str, tmp_path: Path) -> None:
    book = saved([replace(wire_table("A1"), name=name)], tmp_path)
    cell = book["wires"]["A3"]
    assert (cell.data_type, cell.value) == ("s", name.replace("\x07", "\ufffd"))
    with zipfile.ZipFile(tmp_path / "wires.xlsx") as parts:
        for part in parts.namelist():
            assert b"<f>" not in parts.read(part)


@pytest.mark.slow
def test_hundreds_of_wires_share_the_rows(tmp_path: Path) -> None:
    table = wire_table("A1")
    count = 100
    tables = [replace(table, name=f"w{number}") for number in range(count)]
    book = saved(tables, tmp_path)
    last = rows(book, "wires")[-1]
    assert last["rows shown"] == MOST_ROWS // count < last["rows of the law"]
    assert 0.0 < last["error between the rows shown, largest (% of moment)"] < 0.5
    law = of_wire(book, "laws", "w99")
    assert len(law) == last["rows shown"]
    assert law[-1]["curvature (1/m)"] == pytest.approx(table.curvature[-1])


def test_no_wire_at_all(tmp_path: Path) -> None:
    book = saved([], tmp_path)
    assert book.sheetnames == SHEETS
    assert [row["wire"] for row in rows(book, "wires")] == ["Z1"]


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"expected a workbook that can be written, found .*Make"):
        save_wire_workbook([wire_table("A1")], tmp_path / "none" / "wires.xlsx")
