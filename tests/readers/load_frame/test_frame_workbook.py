from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, time
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame
from tests.readers.load_frame.exports import ROWS, specimen_sheet, workbook

RESULTS: list[list[object]] = [["", "Specimen", "Fmax"], ["", "", "N"], ["", "", 9.5]]


FORCE = [row[2] for row in ROWS]


def codes(recording: object) -> set[str]:
    return {note.code for note in recording.notes} - {"few_samples", "time_start_not_zero"}  # type: ignore[attr-defined]


def test_one_specimen(tmp_path: Path) -> None:
    sheets: dict[str, list[list[object]]] = {
        "Results A": RESULTS,
        "Values A-1": specimen_sheet("A-1"),
    }
    recording = load_frame.read(workbook(tmp_path / "a.dat", sheets))
    assert [(c.path, c.unit_in_file) for c in recording.channels] == [
        ("Strain", "mm"),
        ("Standard force", "N"),
    ]
    np.testing.assert_array_equal(recording.channels[1].values, FORCE)
    assert recording.clocks[0].name == "time"
    assert recording.metadata["sheets"] == {
        "Results A": [["", "Specimen", "Fmax"], ["", "", "N"], ["", "", "9.5"]]
    }
    assert codes(recording) == {"sheets_left_out"}


def test_a_sheet_for_each_specimen(tmp_path: Path) -> None:
    rows = [*ROWS[:2], (0.3, "", 5.0)]
    sheets = {"one": specimen_sheet("A-1"), "two": specimen_sheet("A-2", rows)}
    file = workbook(tmp_path / "a.xlsx", sheets)
    recording = load_frame.read(file, channels=["A-2/Strain"])
    assert [channel.path for channel in recording.channels] == ["A-2/Strain"]
    assert [clock.name for clock in recording.clocks] == ["A-2"]
    assert np.isnan(recording.channels[0].values[2])
    for name in ("A-1", "one"):
        assert load_frame.read(file, part=name).channels[1].values.tolist() == FORCE
    with pytest.raises(ReadError, match=r"part 'A-3': .* Nearest: 'A-1', 'A-2'\."):
        load_frame.read(file, part="A-3")


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([*specimen_sheet("A"), [0.5, 1.0, "broken"]], r"sheet 'v', row 8, column 'Standard force"),
        ([["A", "A"], ["Time", "Force"], [1.0, 2.0], [2.0, 3.0]], r"sheet 'v', row 2: expected a "),
        ([["Strain", "Force"], ["mm", "N"], [1.0, 2.0]], r"sheet 'v', row 1: expected the specim"),
        ([["nothing"]], r"a\.xlsx: expected a sheet with names, units and numbers, found 1 sheets"),
    ],
)  # fmt: skip
def test_faults(tmp_path: Path, rows: list[list[object]], said: str) -> None:
    file = workbook(tmp_path / "a.xlsx", {"v": rows})
    with pytest.raises(ReadError, match=said):
        load_frame.read(file, dialect="testxpert-xlsx")


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        (
            "inf",
            r"row 5, column 'Strain': expected a number with .*, found 'inf'\. Export",
        ),
        ("1_000", r"expected a number with .*, found '1_000'\. Export"),
        (True, r"expected a number with .*, found 'True'\. Export"),
        ("1e999", r"expected a number below 1\.8e308, found '1e999', which is too large\. Export"),
        (
            "1,110,797",
            r"expected a number with .*, found '1,110,797'\. A spreadsheet took the decimal sign",
        ),
    ],
)
def test_cells_that_hold_no_number(tmp_path: Path, cell: object, said: str) -> None:
    rows = [ROWS[0], (0.2, cell, 4.5), *ROWS[2:]]
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", rows)})
    with pytest.raises(ReadError, match=said):
        load_frame.read(file)


def test_numbers_that_lost_their_signs(tmp_path: Path) -> None:
    rows = [(0.1 * i, cell, 1.5) for i, cell in enumerate([999, 1063, 1110797, 1162])]
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", rows)})
    expected = (
        r"sheet 'v', row 6, column 'Strain': expected numbers that do not jump a thousandfold and"
        r" back, found '1110797' after '1063'\. A spreadsheet took"
    )
    with pytest.raises(ReadError, match=expected):
        load_frame.read(file)


LONG = [(0.1 * i, 0.25 * i, 4.5 * i) for i in range(1, 21)]


NUMBERS: list[list[object]] = [["Fmax", "Time at break"], ["N", "s"], [90.0, 2.0]]
"""One row for each specimen, as testXpert writes them."""


Sheet = list[list[object]]


EDITS: dict[str, Callable[[Sheet], Sheet]] = {
    "none": lambda rows: rows,
    "row of the specimen deleted": lambda rows: rows[1:],
    "blank row above the names": lambda rows: [rows[0], [], *rows[1:]],
    "blank row above the numbers": lambda rows: [*rows[:3], [], *rows[3:]],
    "specimen in one cell": lambda rows: [["S1"], *rows[1:]],
    "a remark beside it": lambda rows: [[*rows[0], "checked"], *rows[1:]],
    "a title": lambda rows: [["Campaign 7"], [], *rows],
}


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_an_edited_workbook_of_testxpert(tmp_path: Path, edit: Callable[[Sheet], Sheet]) -> None:
    """It stays one of testXpert, and its results are no test of one sample."""
    values = edit(specimen_sheet("S1", LONG))
    file = workbook(tmp_path / "a.xlsx", {"Results S1": NUMBERS, "Values S1": values})
    recording = load_frame.read(file)
    assert recording.metadata["dialect"] == "testxpert-xlsx"
    assert [len(clock.time) for clock in recording.clocks] == [20]
    assert [channel.path for channel in recording.channels] == ["Strain", "Standard force"]
    assert [channel.unit_in_file for channel in recording.channels] == ["mm", "N"]
    assert "sheets_left_out" in codes(recording)
    sheets = recording.metadata["sheets"]
    assert isinstance(sheets, dict)
    assert sheets["Results S1"][0] == ["Fmax", "Time at break"]


def test_words_and_statistics_of_a_sheet(tmp_path: Path) -> None:
    rows: list[tuple[object, ...]] = list(LONG)
    rows[2], rows[5] = (0.3, "nan", 4.5), (0.6, "N/A", 9.0)
    below: Sheet = [[], ["Mean", 1.5, 2.5], ["SD", 0.5]]
    sheet = [*specimen_sheet("A", rows), *below]
    recording = load_frame.read(workbook(tmp_path / "a.xlsx", {"v": sheet}))
    strain = recording.channels[0]
    assert np.flatnonzero(np.isnan(strain.values)).tolist() == [2, 5]
    assert len(strain.values) == len(rows)
    noted = {note.code: note.message for note in recording.notes}
    assert noted["missing_words"].startswith("2 cells hold 'nan', 'N/A', the first in sheet 'v', r")
    assert noted["summary_rows_left_out"].startswith("2 rows from sheet 'v', row 25 on")


@pytest.mark.parametrize(
    ("stamp", "place"),
    [(datetime(2026, 3, 4, 10), "2026-03-04T10:00:00"), (time(10, 0, 0), "10:00:00")],
)
def test_time_stamps_of_a_sheet(tmp_path: Path, stamp: object, place: str) -> None:
    rows = [(stamp, 1.5, 2.5), (stamp, 1.5, 2.5)]
    file = workbook(tmp_path / "a.xlsx", {"v": specimen_sheet("A", rows)})
    with pytest.raises(ReadError, match=rf"row 4, column '.*': .*'{place}', a time stamp"):
        load_frame.read(file)
