"""Curves from elsewhere: two columns, found by name or number, in units that somebody states."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from labpipe.errors import ReadError
from labpipe.readers.curve_files import CurveColumn, read_curve

ACROSS, UP = CurveColumn("deflection", "m"), CurveColumn("force", "N")
MM, NEWTON = (
    CurveColumn("deflection", "m", "1", "mm"),
    CurveColumn("force", "N", "2", "N"),
)
DEFLECTION, FORCE = [0.0, 0.01, 0.02, 0.0305], [0.0, 0.02, 0.035, 0.05]


def saved(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "curve.csv"
    path.write_text(text, encoding=encoding)
    return path


def refusal(path: Path, across: CurveColumn = ACROSS, up: CurveColumn = UP) -> str:
    with pytest.raises(ReadError) as caught:
        read_curve(path, across, up)
    return str(caught.value).replace(str(path), "curve.csv")


@pytest.mark.parametrize(
    "text",
    [
        "deflection / m,force / N\n0,0\n0.01,0.02\n0.02,0.035\n0.0305,0.05\n",
        "deflection_mm,force [mN]\n0,0\n10,20\n20,35\n30.5,50\n",
        "Deflection (mm);Force (N)\n0;0\n10;0,02\n20;0,035\n30,5;0,05\n",
        "tip displacement, cm\tforce, N\n0\t0\n1\t0,02\n2\t0,035\n3,05\t0,05\n",
        "deflection,force\nmm,N\n0,0\n10,0.02\n20,0.035\n30.5,0.05\n",
        "deflection,force\n[mm],[mN]\n0,0\n10,20\n20,35\n30.5,50\n",
        "# deflection_m force_N\n0 0\n1e-2 2e-2\n2e-2 3.5e-2\n3.05e-2 5e-2\n",
        "a remark\n\nstep,deflection_mm,force_N\n1,0,0\n2,10,0.02\n3,20,.035\n\n4,30.5,0.05\n",
        '"deflection / mm","force / N"\n"0","0"\n"10","0,02"\n"20","0,035"\n"30,5","0,05"\n',
    ],
)
def test_headings_say_column_and_unit(tmp_path: Path, text: str) -> None:
    across, up = read_curve(saved(tmp_path, text), ACROSS, UP)
    np.testing.assert_allclose(across, DEFLECTION, rtol=1e-12)
    np.testing.assert_allclose(up, FORCE, rtol=1e-12)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    text = "deflection / µm;force / N\r\n0;0\r\n10000;0,02\r\n20000;0,035\r\n30500;0,05\r\n"
    across, _ = read_curve(saved(tmp_path, text, encoding), ACROSS, UP)
    np.testing.assert_allclose(across, DEFLECTION, rtol=1e-12)


@pytest.mark.parametrize(
    "text", ["0,0\n10,0.02\n20,0.035\n30.5,0.05\n", "0,0 0,0\n10,0 0,02\n20,0 0,035\n30,5 0,05\n"]
)
def test_numbered_columns_need_no_names(tmp_path: Path, text: str) -> None:
    across, up = read_curve(saved(tmp_path, text), MM, NEWTON)
    np.testing.assert_allclose(across, DEFLECTION, rtol=1e-12)
    np.testing.assert_allclose(up, FORCE, rtol=1e-12)


FIXED = "deflection / mm;force / N\n0.000;0.000\n6.000;10.250\n12.000;20.500"


@pytest.mark.parametrize("cut", range(1, len("12.000;20.500")))
def test_a_file_that_is_cut_off_in_its_last_line_is_refused(tmp_path: Path, cut: int) -> None:
    message = refusal(saved(tmp_path, FIXED[:-cut]))
    assert message.startswith("curve.csv, line 4: expected a last line that does not stop")
    assert repr(FIXED[:-cut].rpartition("\n")[2]) in message


@pytest.mark.parametrize(
    "text",
    [
        FIXED,
        f"{FIXED}\n",
        "deflection / mm,force / N\n0,0\n6,10.25\n12,20.5",  # last zeros are not written
        "deflection / mm,force / N\n0,0,\n6,10.25,\n12,20.5,",
        "0 0\n6 10.25\n12 20.5",
    ],
)
def test_a_last_line_without_a_line_end(tmp_path: Path, text: str) -> None:
    asked = (ACROSS, UP) if "/" in text else (MM, NEWTON)
    across, up = read_curve(saved(tmp_path, text), *asked)
    np.testing.assert_allclose(across, [0.0, 0.006, 0.012])
    np.testing.assert_allclose(up, [0.0, 10.25, 20.5])


def test_a_page_of_blanks_is_read_in_no_time(tmp_path: Path) -> None:
    """By backtracking over pairs of blanks it took minutes."""
    blanks = 200_000 * " "
    for line in (f"x{blanks}", f"x{blanks}(", f"x({blanks}", f"x{blanks}; y{blanks}z"):
        across, _ = read_curve(saved(tmp_path, f"{line}\n{FIXED}\n"), ACROSS, UP)
        np.testing.assert_allclose(across, [0.0, 0.006, 0.012])


def test_named_columns_with_signs(tmp_path: Path) -> None:
    path = saved(tmp_path, "X,U2,RF2\n0,0,-0\n1,-10,-0.02\n2,-20,-0.035\n3,-30.5,-0.05\n")
    across, up = read_curve(
        path,
        CurveColumn("deflection", "m", "u2", "mm", sign=-1),
        CurveColumn("force", "N", "RF2", "N", sign=-1),
    )
    np.testing.assert_allclose(across, DEFLECTION, rtol=1e-12)
    np.testing.assert_allclose(up, FORCE, rtol=1e-12)


def test_curves_side_by_side_end_where_they_end(tmp_path: Path) -> None:
    text = "A,,B,\nX,Y,X,Y\n0,0,0,0\n1,1,2,2\n2,2,4,3\n3,3,,\n"
    across, up = read_curve(
        saved(tmp_path, text),
        CurveColumn("deflection", "m", "3", "mm"),
        CurveColumn("force", "N", "4", "N"),
    )
    np.testing.assert_allclose(across, [0.0, 0.002, 0.004])
    np.testing.assert_allclose(up, [0.0, 2.0, 3.0])


def test_the_first_sheet_of_a_workbook(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    assert book.active is not None
    rows: list[tuple[str | float, ...]] = [
        ("deflection / mm", "force / N"),
        (0, 0),
        (10, 0.02),
        (20, 0.035),
        (30.5, 0.05),
    ]
    for row in rows:
        book.active.append(row)
    path = tmp_path / "curve.xlsx"
    book.save(path)
    across, up = read_curve(path, ACROSS, UP)
    np.testing.assert_allclose(across, DEFLECTION, rtol=1e-12)
    np.testing.assert_allclose(up, FORCE, rtol=1e-12)
    book.active["B4"] = "=1/0"
    book.save(path)
    with pytest.raises(ReadError, match="cell B4: expected a value, found a formula without"):
        read_curve(path, ACROSS, UP)


def test_a_missing_file(tmp_path: Path) -> None:
    said = refusal(tmp_path / "curve.csv")
    assert said == (
        "curve.csv: expected a file, found none of that name. Check the name and the folder."
    )


HEAD = "deflection / mm,force / N\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "curve.csv: expected a file with content, found an empty file (0 bytes)."),
        ("deflection / mm,force / N\n", "curve.csv: expected rows of numbers, found none. Give"),
        (
            "time / s,forse / N\n0,0\n1,1\n2,2\n",
            "curve.csv, line 1: expected a column 'deflection', found 'time / s', 'forse / N'. "
            "Name it in the plan, such as deflection: {column: U2, unit: mm}.",
        ),
        (
            "deflection / mm,forse / N\n0,0\n1,1\n2,2\n",
            "curve.csv, line 1: expected a column 'force', found 'forse / N', 'deflection / mm'. "
            "Name it in the plan, such as force: {column: U2, unit: N}.",
        ),
        (
            "0,0\n1,1\n2,2\n",
            "curve.csv, line 1: expected a row of names above the numbers, with a column "
            "'deflection', found numbers alone. Number it in the plan, such as deflection: "
            "{column: 1, unit: mm}.",
        ),
        (
            "deflection,force / N\n0,0\n1,1\n2,2\n",
            "curve.csv, line 1, column 1: expected a unit of the deflection, found none in "
            "'deflection'. Write it in the heading (deflection / mm) or in the plan.",
        ),
        (
            "deflection / mm,force_mm\n0,0\n1,1\n2,2\n",
            "curve.csv, line 1: expected a column 'force', found 'force_mm', 'deflection / mm'.",
        ),
        (
            "deflection / mm,force / mm\n0,0\n1,1\n2,2\n",
            "curve.csv, line 1, column 2: expected a unit of the force, such as N, found 'mm'. "
            "Correct the heading.",
        ),
        (
            "deflection / mm,deflection / m,force / N\n0,0,0\n1,1,1\n2,2,2\n",
            "curve.csv, line 1: expected one column 'deflection', found 2: columns 1, 2. Give the "
            "number of the one that is meant.",
        ),
        (f"{HEAD}0,0\n1,1\n", "curve.csv: expected 3 points at least, found 2. Give more points"),
        (
            f"{HEAD}0,0\n1,nan\n2,2\n",
            "curve.csv, line 3, column 2: expected a finite number, found 'nan'. Correct the row",
        ),
        (f"{HEAD}0,0\n1,1e999\n2,2\n", "line 3, column 2: expected a finite number, found '1e999'"),
        (f"{HEAD}0,0\n1,\n2,2\n", "line 3, column 2: expected a finite number, found a blank cell"),
        (
            f"{HEAD}0,0\n1,1.234.567\n2,2\n",
            "line 3, column 2: expected a finite number, found '1.234.567'. Write the file anew "
            "without signs between thousands.",
        ),
        (
            f"{HEAD}0,0\n1,1.2.3\n2,2\n",
            "line 3, column 2: expected a finite number, found '1.2.3'.",
        ),
        (f"{HEAD}0,0\n1\n2,2\n", "line 3: expected a finite number, found a blank cell"),
        (f"{HEAD}0,0\n1,1\nx,y\n2,2\n", "line 4, column 1: expected a finite number, found 'x'"),
        (
            f"{HEAD}0,0\n2,2\n1,1\n",
            "curve.csv, line 4, column 1: expected a deflection above the one before (2 mm), found "
            "1 mm. Keep the first loading alone, its points in order, each deflection once.",
        ),
        (f"{HEAD}0,0\n1,1\n1,2\n", "line 4, column 1: expected a deflection above the one before"),
        (
            f"{HEAD}0,0\n-1,1\n-2,2\n",
            "curve.csv, line 3, column 1: expected a deflection above the one before (0 mm), found "
            "-1 mm. If the file counts downwards, write 'sign: -1' for the deflection.",
        ),
        (
            f"{HEAD}0,0\n1,-1\n2,-2\n",
            "curve.csv, line 4, column 2: expected a largest force above zero, found -2 N. If the "
            "file counts downwards, write 'sign: -1' for the force.",
        ),
        (
            "deflection / mm;force / N\n0;0\n1,5;0.1\n2;2\n",
            "curve.csv, line 3, column 1: expected a decimal point, as elsewhere in the file, "
            "found '1,5'. Write the file anew with one decimal sign and no sign for thousands.",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, said: str) -> None:
    assert said in refusal(saved(tmp_path, text))


def test_a_named_column_that_is_not_there(tmp_path: Path) -> None:
    path = saved(tmp_path, "X,U2,RF2\n0,0,0\n1,1,1\n2,2,2\n")
    said = refusal(path, CurveColumn("deflection", "m", "U3", "mm"))
    assert said.startswith("curve.csv, line 1: expected a column 'U3', found 'U2', 'X', 'RF2'. ")
    assert "expected a column '4'" in refusal(path, CurveColumn("deflection", "m", "4", "mm"))
    both = CurveColumn("force", "N", "2", "N")
    said = refusal(path, CurveColumn("deflection", "m", "U2", "mm"), both)
    assert "expected two columns, found column 2 for both. Name another one for the force." in said


def test_plan_and_heading_must_agree(tmp_path: Path) -> None:
    path = saved(tmp_path, "deflection / m,force / N\n0,0\n1,1\n2,2\n")
    assert refusal(path, CurveColumn("deflection", "m", unit="mm")) == (
        "curve.csv, line 1, column 1: expected 'mm', as in the plan, found 'm'. Correct the one "
        "that is wrong."
    )
    across, _ = read_curve(path, CurveColumn("deflection", "m", unit="metre"), UP)
    assert across.tolist() == [0.0, 1.0, 2.0]


def test_other_bytes(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_bytes(b"\x89HDF\r\n\x1a\n\0\0\1\2\3")
    assert "expected a table as text, or an xlsx workbook, found other bytes" in refusal(path)
    path.write_bytes(b"PK\x03\x04" + os.urandom(64))
    assert "expected an xlsx workbook, found a damaged one" in refusal(path)
