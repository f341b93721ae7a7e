from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, time
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame
from tests.approved import Approve
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
    written = [("Strain", "mm"), ("Standard force", "N")]
    assert [(c.path, c.unit_in_file) for c in recording.channels] == written
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


PLACES: list[list[list[object]]] = [
    [*specimen_sheet("A"), [0.5, 1.0, "broken"]],
    [["A", "A"], ["Time", "Force"], [1.0, 2.0], [2.0, 3.0]],
    [["Strain", "Force"], ["mm", "N"], [1.0, 2.0]],
    [["nothing"]],
]
CELLS: list[object] = ["inf", "1_000", True, "1e999", "1,110,797"]
STAMPS = [datetime(2026, 3, 4, 10), time(10, 0, 0)]


def test_sheets_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    sheets = [
        *PLACES,
        *(specimen_sheet("A", [ROWS[0], (0.2, cell, 4.5), *ROWS[2:]]) for cell in CELLS),
        *(specimen_sheet("A", [(stamp, 1.5, 2.5)] * 2) for stamp in STAMPS),
    ]
    messages = []
    for rows in sheets:
        file = workbook(tmp_path / "a.xlsx", {"v": rows})
        with pytest.raises(ReadError) as refused:
            load_frame.read(file, dialect="testxpert-xlsx")
        messages.append(refused.value)
    approved(messages)


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
    tables: dict[str, Sheet] = {"Sheet1": [], "Results S1": NUMBERS, "Values S1": values}
    file = workbook(tmp_path / "a.xlsx", tables)
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
    assert noted["missing_values"] == "2 of 20 values are missing, the first in row 3"
    assert noted["summary_rows_left_out"].startswith("2 rows from sheet 'v', row 25 on")
