from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.text_layouts import Place, decimal_of
from labpipe.records.recording import Recording
from tests.readers.load_frame.exports import ROWS, lines, written

TIME, TRAVEL, FORCE = (list(column) for column in zip(*ROWS, strict=True))


def holds(recording: Recording, *named: tuple[str, str, list[float]]) -> None:
    """Check names, units and values of all channels on one clock."""
    assert [(c.name, c.unit_in_file) for c in recording.channels] == [n[:2] for n in named]
    for channel, (_, _, values) in zip(recording.channels, named, strict=True):
        np.testing.assert_allclose(channel.values, values, rtol=1e-15)


def codes(recording: Recording) -> set[str]:
    return {note.code for note in recording.notes} - {"few_samples", "time_start_not_zero"}


BLOCK = "Datenerfassung\t\t\tZeit:\t1,5\ts\t28.01.2015 10:35:28\n"
COLUMNS = "Laufzeit\tCh 1 Weg\tCh 1 Kraft\ns\tmm\tkN\n"


@pytest.mark.parametrize(
    "line", ["MTS793|MPT|DEU|1|2|,|.|:|49|1|1|A", "MTS793|MPT|DEU|x|x|,|.|:|49|1|1|A"]
)
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8"])
def test_blocks_of_793(tmp_path: Path, line: str, encoding: str) -> None:
    """Two blocks of samples are one recording; a summary between them is none."""
    mark = "ü" if encoding == "cp1252" else "\ufffd"
    form = f"Bediener Information\nPr{mark}fer:\tKh\nBediener Information Ende\n"
    first, second = lines(ROWS[:2], "\t", comma=True), lines(ROWS[2:], "\t", comma=True)
    summary = BLOCK + "Ch 1 Kraft\tCh 1 Weg\nkN\tmm\n99,5\t0\n-1\t2\n"
    parts = [line, form, BLOCK + COLUMNS + first, summary, BLOCK + COLUMNS + second]
    recording = load_frame.read(written(tmp_path / "a.dat", "\n\n".join(parts), encoding))
    holds(recording, ("Ch 1 Weg", "mm", TRAVEL), ("Ch 1 Kraft", "kN", FORCE))
    assert recording.program == "MTS 793 MPT"
    assert codes(recording) == {"summary_rows_left_out", "blocks_joined"}
    assert recording.metadata["summaries"] == [{"Ch 1 Kraft": [99.5, -1.0], "Ch 1 Weg": [0.0, 2.0]}]
    assert recording.metadata[f"Pr{mark}fer"] == "Kh"


def test_blocks_with_other_columns_are_parts(tmp_path: Path) -> None:
    other = BLOCK + "Laufzeit\tCh 2 Weg\ns\tmm\n1,5\t2,5\n2,5\t3,5\n"
    parts = ["MTS793|MPT|DEU|1|2|,|.", BLOCK + COLUMNS + lines(ROWS, "\t", comma=True), other]
    recording = load_frame.read(written(tmp_path / "a.dat", "\n\n".join(parts)))
    assert [channel.path for channel in recording.channels] == [
        "block 1/Ch 1 Weg",
        "block 1/Ch 1 Kraft",
        "block 2/Ch 2 Weg",
    ]


def test_names_and_columns_parted_by_blanks(tmp_path: Path) -> None:
    names = "Ch 1 Displacement Ch 1 Force Time"
    block = f"Data Acquisition: Timed\nStation Name: a\n{names}\nmm        kN        Sec\n"
    body = lines([(travel, force, time) for time, travel, force in ROWS], " ")
    text = f"MTS793|BTW|ENG|1|0|.|/|:|44|1|1|A\n\nData Header:   Time: 1 Sec\n{block}{body}\n"
    recording = load_frame.read(written(tmp_path / "a.dat", text.replace("\n", "\r\n")))
    assert [channel.name for channel in recording.channels] == ["Ch 1 Displacement", "Ch 1 Force"]
    assert recording.metadata["Station Name"] == "a"


def test_a_decimal_sign_that_is_not_stated(tmp_path: Path) -> None:
    file = written(tmp_path / "a.dat", f"MTS793|MPT\n\n{BLOCK}{COLUMNS}{lines(ROWS)}")
    expected = r"a\.dat, line 1: expected the decimal sign that this program states, found 'MTS793"
    with pytest.raises(ReadError, match=expected):
        load_frame.read(file)


def test_blocks_without_samples(tmp_path: Path) -> None:
    file = written(tmp_path / "a.dat", "MTS793|MPT|DEU|1|2|,|.\n\nBediener Information\n")
    with pytest.raises(ReadError, match=r"lines 1 to 4: expected a block of names, units and num"):
        load_frame.read(file)


EXTREMES = "Ch 1 Kraft\tCh 1 Weg\nkN\tmm\n99,5\t2\n-1\t0\n"


def test_nothing_but_extremes(tmp_path: Path) -> None:
    text = f"MTS793|MPT|DEU|1|2|,|.\n\n{BLOCK}{EXTREMES}"
    recording = load_frame.read(written(tmp_path / "a.dat", text))
    assert (recording.clocks, recording.channels) == ((), ())
    assert codes(recording) == {"summary_rows_left_out", "no_samples"}
    assert recording.metadata["summaries"] == [{"Ch 1 Kraft": [99.5, -1.0], "Ch 1 Weg": [2.0, 0.0]}]
    (note,) = (note for note in recording.notes if note.code == "no_samples")
    assert note.message == "all rows are a summary: the test took no samples"


@pytest.mark.parametrize("rows", ["99,5\t2\n-1\t3\n", "99,5\t2\n-1\t0\n-2\t0\n"])
def test_rows_without_time_that_are_no_extremes(tmp_path: Path, rows: str) -> None:
    text = f"MTS793|MPT|DEU|1|2|,|.\n\n{BLOCK}Ch 1 Kraft\tCh 1 Weg\nkN\tmm\n{rows}"
    recording = load_frame.read(written(tmp_path / "a.dat", text))
    assert len(recording.channels) == 2
    assert codes(recording) == {"no_time"}


def test_the_decimal_sign_of_the_card_or_of_the_export() -> None:
    path = Path("a.dat")
    assert decimal_of("", Place(path, shipped_cards()["microtest"])) == "."
    stating = Place(path, shipped_cards()["mts-793"])
    assert decimal_of("MTS793|MPT|DEU|1|2|,|.", stating) == ","
    expected = r"a\.dat, line 1: expected the decimal sign that this program states, found 'MTS793'"
    with pytest.raises(ReadError, match=expected):
        decimal_of("MTS793\nrest", stating)
