from __future__ import annotations

from pathlib import Path

import pytest
from openpyxl import Workbook

from labpipe.readers.sheet_cells import Cell
from labpipe.readers.wire_columns import Faults
from labpipe.readers.wire_stress import read_stress_table

Rows = list[list[object]]
HEADING: list[object] = ["strain", "stress_mpa"]


def told(path: Path, name: str) -> tuple[object, list[str]]:
    faults = Faults(path)
    found = read_stress_table(Cell(name, "cell S2"), "cell S2 (stress_table)", faults)
    return found, [each.removeprefix(f"{path}, ") for each in faults.told]


def workbook(tmp_path: Path, rows: Rows) -> Path:
    book = Workbook()
    book.create_sheet("soft")
    for row in rows:
        book["soft"].append(row)
    book.save(tmp_path / "w.xlsx")
    return tmp_path / "w.xlsx"


def refused(tmp_path: Path, *rows: list[object]) -> str:
    found, messages = told(workbook(tmp_path, [HEADING, *rows]), "soft")
    assert found is None
    [message] = messages
    return message.removeprefix("sheet 'soft', ")


def test_a_table_of_the_workbook(tmp_path: Path) -> None:
    path = workbook(tmp_path, [HEADING, [0, 0], [0.001, 110], [0.01, 150], [0.1, 150]])
    assert told(path, "soft") == (((0.001, 0.01, 0.1), (110e6, 150e6, 150e6)), [])


def test_a_sheet_in_other_letters(tmp_path: Path) -> None:
    path = workbook(tmp_path, [HEADING, [0.001, 110]])
    assert told(path, "SOFT") == (((0.001,), (110e6,)), [])


def test_a_table_beside_a_csv(tmp_path: Path) -> None:
    (tmp_path / "soft.csv").write_text("Strain,stress_MPa,from\n0.001,110,us\n", encoding="utf-8")
    (tmp_path / "w.csv").write_text("wire\nA\n", encoding="utf-8")
    assert told(tmp_path / "w.csv", "soft.csv") == (((0.001,), (110e6,)), [])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            [[0.002, 110], [0.001, 120]],
            "cell A3: expected a strain above 0.002, found 0.001."
            " Put the rows in order and correct them.",
        ),
        (
            [[0.001, 110], [0.002, 100]],
            "cell A3: expected a stress of 110 MPa or more, and more than zero, found 100 MPa."
            " Put the rows in order and correct them.",
        ),
        (
            [[0.001, 50], [0.002, 150]],
            "cell A3: expected a slope up to the first, 50 GPa, found 100 GPa."
            " Put the rows in order and correct them.",
        ),
        ([[0, 0]], "cell A1: expected a point beyond zero, found none. Fill in the table."),
        (
            [[0.001, 110], [5, 150]],
            "cell A3: expected a strain up to 0.6, found 5."
            " Give the strain as a plain number, not in per cent.",
        ),
        (
            [[0, 0], [0.2, 110]],
            "cell A3: expected a first slope of 1 to 1000 GPa, found 0.55 GPa."
            " Give the strain as a plain number, not in per cent, and the stress in MPa.",
        ),
        (
            [[0.001, 110e6]],
            "cell A2: expected a first slope of 1 to 1000 GPa, found 1.1e+08 GPa."
            " Give the strain as a plain number, not in per cent, and the stress in MPa.",
        ),
        (
            [[0.001, "x"]],
            "cell B2 (stress_mpa): expected a number >= 0 in MPa, found 'x'. Correct the cell.",
        ),
        (
            [[0.001, None]],
            "cell B2 (stress_mpa): expected a number >= 0 in MPa, found a blank cell. Fill it in.",
        ),
        (
            [[-0.001, 5]],
            "cell A2 (strain): expected a number >= 0, found '-0.001'. Correct the cell.",
        ),
    ],
)
def test_points_that_make_no_curve(tmp_path: Path, rows: Rows, message: str) -> None:
    assert refused(tmp_path, *rows).endswith(message)


def test_columns_of_other_names(tmp_path: Path) -> None:
    found, messages = told(workbook(tmp_path, [["strain", "stress"], [0.001, 110]]), "soft")
    assert found is None
    assert messages == [
        "sheet 'soft', cell A1: expected a column 'stress_mpa', found 'strain', 'stress'."
        " Name the columns strain and stress_mpa."
    ]


def test_a_table_that_is_not_there(tmp_path: Path) -> None:
    path = workbook(tmp_path, [HEADING])
    assert told(path, "sofd")[1] == [
        "cell S2 (stress_table): expected the name of a sheet ('soft', 'Sheet'), found 'sofd'."
        " Add the sheet or correct its name."
    ]
    assert told(path, "soft")[1] == [
        "sheet 'soft': expected a heading and one row per point of the curve, found 1 rows."
        " Fill in the table."
    ]
    sheet = tmp_path / "w.csv"
    sheet.write_text("wire\nA\n", encoding="utf-8")
    assert told(sheet, "none.csv")[1][0].startswith(f"{tmp_path / 'none.csv'}: expected a file")
    assert told(sheet, "../soft.csv")[1] == [
        "cell S2 (stress_table): expected the name of a csv in the folder of the wire sheet,"
        " found '../soft.csv'. Put the table beside the sheet and give its name."
    ]
