"""Names, units and times above the numbers of a load frame's export."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import read_export
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.load_frame import assemble_recording
from labpipe.readers.load_frame.cards import load_shipped_cards
from labpipe.readers.load_frame.tables import Export, Table, find_header, find_time_column
from labpipe.readers.raw_files import add_file_name
from tests.approved import Approve


def together(names: str, width: int) -> tuple[str, ...]:
    """Names of so many columns, of a line in which blanks part them."""
    lines = [names, " ".join(["mm"] * width), " ".join(["1.5"] * width)]
    return find_header(lines, load_shipped_cards()["mts-793"], 4).names


FAULTS = [
    ("bluehill", ["a", "b"]),
    ("dion", ["S/No;Time", "1;2"]),
    ("trapezium", ["a,b", "1,2"]),
    ("trapezium", ["s,N", "1,2"]),
    ("testxpert-tra", ['"a","a"', '"s","s"', "1,2"]),
    ("table", ["1,2", "3,4"]),
    ("dma-q800", ["Nsig\t2", "Sig1\tTime (min)"]),
    ("dma-q800", ["Nsig\t2", "StartOfData", "1\t2"]),
]
PARTED = ["Ch 1 Displacement Deflectometer Ch 1 Force Time", "Odd words that tell nothing"]


def test_headers_that_are_refused(approved: Approve) -> None:
    cards = load_shipped_cards()
    calls: list[Callable[[], object]] = [
        partial(find_header, lines, cards[c]) for c, lines in FAULTS
    ]
    messages = []
    calls += [partial(together, names, 4) for names in PARTED]
    for find in calls:
        with pytest.raises(ReadError) as refused, add_file_name(Path("a.csv")):
            find()
        messages.append(refused.value)
    approved(messages)


def test_a_list_of_names() -> None:
    lines = ["Nsig\t2", "Sig1\tTime (min)", "Sig2\tStrain", "StartOfData", "1\t2"]
    header = find_header(lines, load_shipped_cards()["dma-q800"])
    assert (header.names, header.units, header.first_row) == (("Time", "Strain"), ("min", ""), 4)


@pytest.mark.parametrize("after", [0, 1, 2])
@pytest.mark.parametrize(
    ("card", "lines"),
    [
        ("bluehill", ["Specimen,1", "Time,Load", "(s),(N)", "0.1,2.5", "0.2,3.5"]),
        ("table", ["Pull of a wire", "Time,Load", "s,N", "0.1,2.5", "0.2,3.5"]),
        ("testxpert-tra", ['"Pull"', '"Zeit","Kraft"', '"s","N"', "0.1,2.5", "0.2,3.5"]),
    ],
)
def test_a_blank_row_is_no_header(card: str, lines: list[str], after: int) -> None:
    """Between title and names, names and units, units and numbers."""
    whole = [*lines[: after + 1], ",", "", *lines[after + 1 :]]
    header = find_header(whole, load_shipped_cards()[card])
    assert [name.rstrip() for name in header.names] == [
        cell.strip('"') for cell in lines[1].split(",")
    ]
    assert header.units == ("s", "N")
    assert header.first_row == 5


@pytest.mark.parametrize(
    "names",
    [
        ("Ch 1 Displacement", "Ch 1 Force", "Time"),
        ("Ch 1 Count", "Ch 1 Displacement", "Ch 1 Force", "Time"),
        ("Axial Count", "Axial Displacement", "Axial Force", "Running Time"),
        ("Axial Segment Count", "Axial Force", "Time of Day"),
        ("Running Time", "Segments", "Count", "Channel 12 Force"),
        ("Aux Input 5", "Torsional Rotation", "Laufzeit"),
        ("Axial Force", "Axial Displacement", "Elapsed Time"),
        ("Deflectometer", "Ch 1 Force", "Time"),
    ],
)
def test_names_that_hold_blanks(names: tuple[str, ...]) -> None:
    assert together(" ".join(names), len(names)) == names


@pytest.mark.parametrize(
    ("names", "units", "found"),
    [
        (["_Load", "_Time"], ["N", "sec"], 1),
        (["_Video Time", "_Time", "_Load"], ["sec", "sec", "N"], 1),
        (["Load", "Ch 1 Time"], ["N", "sec"], 1),
        (["Load", "C_1_Temps"], ["N", "s"], 1),
        (["Load", "Tempo di prova"], ["N", "s"], 1),
        (["Load", "Prüfzeit bis Bruch"], ["N", "s"], 1),
        (["Load", "Time to break"], ["N", "mm"], None),
        (["Load", "Hold Time", "Dwell Time"], ["N", "s", "s"], None),
        (["Load", "Temperature"], ["N", "s"], None),
    ],
)
def test_time_under_other_names(names: list[str], units: list[str], found: int | None) -> None:
    assert find_time_column(names, units, load_shipped_cards()["mts-testsuite"]) == found


N = 12


COUNT = np.arange(float(N))


def test_time_is_in_seconds() -> None:
    units = {"s": 1.0, "Ms": 1e-3, "Sec": 1.0, "SEC": 1.0, "min": 60.0, "ms": 1e-3, "d": 86400.0}
    for unit, factor in units.items():
        table = Table("", ("Time", "F"), (unit, "N"), {0: COUNT, 1: COUNT})
        recording = assemble_recording(Export((table,)), load_shipped_cards()["nexygen"], "a")
        np.testing.assert_allclose(recording.clocks[0].time, factor * COUNT)
        clocks = {"time": {"time": "Time", "unit_in_file": unit}}
        assert recording.metadata["clocks"] == clocks


@pytest.mark.parametrize(
    ("names", "is_refused"),
    [
        ("Time (s);Force (kN)\ns;N", True),
        ("Time (ms);Force (N)\ns;N", True),
        ("Time (s);Force (mm)\ns;N", True),
        ("Time (s);Force [kN] (N)", True),
        ("Time (sec);Force (left)\ns;N", False),
        ("Time (s);Force (N)\n(s);(N)", False),
    ],
)
def test_two_units_of_one_column(tmp_path: Path, names: str, is_refused: bool) -> None:
    file = tmp_path / "a.csv"
    file.write_text("\n".join([names, *(f"{i};{i}" for i in range(N)), ""]), "utf-8")
    with pytest.raises(ReadError, match="the unit in its name") if is_refused else nullcontext():
        assert len(read_export(file).channels) == 1


def test_notes_on_channels() -> None:
    names, units = ("Time", "F", "F", "still"), ("s", "N", "", "mm")
    gone = np.where(COUNT == 3, np.nan, COUNT)
    table = Table("", names, units, {0: COUNT, 1: COUNT, 2: gone, 3: 0.0 * COUNT})
    recording = assemble_recording(Export((table,)), load_shipped_cards()["nexygen"], "a")
    assert [(note.code, note.where, note.message) for note in recording.notes] == [
        ("missing_values", "F [2]", "1 of 12 values are missing, the first in row 4"),
        ("constant_channel", "channels", "values never change in 1 of 3 channels: 'still'"),
        (
            "units_not_stated",
            "channels",
            "no unit is stated for 1 of 3 channels: 'F [2]'; the protocol must state it",
        ),
        (
            "names_not_unique",
            "channels",
            "of 3 channels 2 are called 'F': distinguish them by path",
        ),
    ]


@pytest.mark.parametrize(
    ("row", "is_apart"),
    [
        ("99.0,10.0,158.2", True),
        ("99.0,1.9,19.1", False),
        ("2.0,10.0,0.0", False),
        ("2.0,2.0,-150.0", False),
    ],
)
def test_a_row_of_statistics_without_a_label(tmp_path: Path, row: str, is_apart: bool) -> None:
    """Not a late sample near the last one, and not a break or an outlier in its time."""
    rows = [f"{0.1 * i:.1f},{0.1 * i:.1f},{i:.1f}" for i in range(20)]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["Time (s),Travel (mm),Force (N)", *rows, row, ""]), "utf-8")
    recording = read_export(file)
    assert len(recording.clocks[0].time) == (20 if is_apart else 21)
    assert ("rows_apart" in {note.code for note in recording.notes}) == is_apart


@pytest.mark.parametrize(
    ("head", "scale", "offset", "choice", "other"),
    [
        ("Force (N)", 2.0, 0.0, ("Load", "Force"), "Force"),
        ("Force (N)", 1.001, 5.0, ("Load", "Force"), ""),
        ("Force (kN)", 0.001, 0.0, ("Load", "Force"), ""),
        ("Force (mm)", 2.0, 0.0, ("Load", "Force"), ""),
        ("Force (N)", 2.0, 0.0, "Load", ""),
    ],
)
def test_two_columns_that_fit_one_channel(
    tmp_path: Path, head: str, scale: float, offset: float, choice: ChannelChoice, other: str
) -> None:
    """Not for other units, zeros and noise, or a protocol that names one of them."""
    rows = [f"{i},{2 * i},{scale * 2 * i + offset}" for i in range(20)]
    file = tmp_path / "a.csv"
    file.write_text("\n".join([f"Time (s),Load (N),{head}", *rows, ""]), "utf-8")
    recording = read_export(file, channels=[choice])
    assert [channel.name for channel in recording.channels] == ["Load"]
    notes = [note.message for note in recording.notes if note.code == "columns_disagree"]
    assert [f"'Load' is used, but '{other}' fits" in note for note in notes] == [True] * bool(other)
