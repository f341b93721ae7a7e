"""Names, units and times above the numbers of a load frame's export."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.column_titles import find_header
from labpipe.readers.load_frame.frame_recording import (
    Export,
    Table,
    assemble,
    choose_part,
    preamble,
    time_column,
    without_codes,
)


@pytest.mark.parametrize(
    ("card", "lines", "said"),
    [
        (
            "bluehill",
            ["a", "b"],
            r"a\.csv, lines 1 to 2: expected a row of names and rows of numbers",
        ),
        (
            "dion",
            ["S/No;Time", "1;2"],
            r"line 1: expected names with their units in \[\] above the num",
        ),
        (
            "trapezium",
            ["a,b", "1,2"],
            r"line 1: expected a row of units above the numbers, found 'a, b'\. ",
        ),
        (
            "trapezium",
            ["s,N", "1,2"],
            r"line 1: expected a row of names, then a row of units, .* found no",
        ),
        (
            "testxpert-tra",
            ['"a","a"', '"s","s"', "1,2"],
            r"found 'a, a' above 's, s'\. Export the test",
        ),
        (
            "table",
            ["1,2", "3,4"],
            r"line 1: expected a row of names above the numbers, found nothing",
        ),
    ],
)
def test_faults(card: str, lines: list[str], said: str) -> None:
    with pytest.raises(ReadError, match=said):
        find_header(lines, shipped_cards()[card], "a.csv")


def test_a_list_of_names() -> None:
    lines = ["Nsig\t2", "Sig1\tTime (min)", "Sig2\tStrain", "StartOfData", "1\t2"]
    found = find_header(lines, shipped_cards()["dma-q800"], "a")
    assert (found.names, found.units, found.first) == (("Time", "Strain"), ("min", ""), 4)
    with pytest.raises(
        ReadError, match=r"a: expected a line '\^StartOfData.* found none in 3 line"
    ):
        find_header(lines[:3], shipped_cards()["dma-q800"], "a")
    with pytest.raises(
        ReadError, match=r"a, lines 1 to 1: expected names in lines '\^Sig.*found no"
    ):
        find_header(["Nsig\t2", *lines[3:]], shipped_cards()["dma-q800"], "a")


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
    header = find_header(whole, shipped_cards()[card], "a.csv")
    assert [name.rstrip() for name in header.names] == [
        cell.strip('"') for cell in lines[1].split(",")
    ]
    assert header.units == ("s", "N")
    assert header.first == 5


BLANKS = "mts-793"


def together(names: str, width: int) -> tuple[str, ...]:
    """Names of so many columns, of a line in which blanks part them."""
    lines = [names, " ".join(["mm"] * width), " ".join(["1.5"] * width)]
    return find_header(lines, shipped_cards()[BLANKS], "a.dat", 4).names


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
    ("names", "found"),
    [
        ("Ch 1 Displacement Deflectometer Ch 1 Force Time", r"3 in 'Ch 1 Displacement Deflectome"),
        ("Odd words that tell nothing", r"1 in 'Odd words"),
    ],
)
def test_names_that_cannot_be_told_apart(names: str, found: str) -> None:
    expected = (
        rf"a\.dat, line 4: expected 4 names, as there are columns, found {found}.*'\. Say in a card"
        r" of your own how names begin \(name_starts\); see docs/how-to/new-dialect\.md\."
    )
    with pytest.raises(ReadError, match=expected):
        together(names, 4)


def test_names_anyhow() -> None:
    card = shipped_cards()["table"]
    assert find_header(["Time,Force", "1,2"], card, "a").units == ("", "")
    assert find_header(["Time (s),Force [kN]", "1,2"], card, "a").units == ("s", "kN")
    assert find_header(["Time,Force", "(s),(kN)", "1,2"], card, "a").names == ("Time", "Force")
    assert find_header(["Time, s;Force, N", "1;2"], card, "a").units == ("s", "N")


def test_specimens_above_the_names() -> None:
    rows = ["x,", '"A",,"B",', "Time,Force,Time,Force", "s,N,s,N", "1,2,3,4"]
    found = find_header(rows, shipped_cards()["trapezium"], "a")
    assert found.specimens == ("A", "", "B", "")
    assert list(found.above) == [["x", ""]]


def test_preamble() -> None:
    rows = [
        ["Date: 7/3/2025 12:23"],
        ["General : Label", "a b", "mm", ""],
        ["C:\\x"],
        [""],
        ["Form:"],
    ]
    rows += [["Method", "1"], ["Method", "2"]]
    assert preamble(rows) == {
        "Date": "7/3/2025 12:23",
        "General : Label": "a b mm",
        "lines": ["C:\\x"],
        "Form": "",
        "Method": ["1", "2"],
    }


def test_the_most_wanted_time_counts() -> None:
    card = shipped_cards()["mts-testsuite"]
    assert time_column(["Video Time", "Running Time", "Time"], ["sec"] * 3, card) == 2
    assert time_column(["Video Time", "Load"], ["", "N"], card) is None
    dated = replace(card, words=("Time",))
    assert time_column(["Time", "Running Time"], ["", "sec"], dated) == 1
    assert time_column(["Time", "Load"], ["sec", "N"], dated) is None


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
    assert time_column(names, units, shipped_cards()["mts-testsuite"]) == found


def test_codes_of_missing_values() -> None:
    table = Table("", ("F",), ("N",), {0: np.array([1.0, -1e6])})
    values = without_codes(table, shipped_cards()["catman"]).columns[0]
    np.testing.assert_array_equal(values, [1.0, np.nan])
    assert without_codes(table, shipped_cards()["dion"]) is table


def test_parts() -> None:
    tables = [Table(part, (), (), {}, also=f"Values {part}") for part in ("A", "B")]
    assert choose_part(tables, None, "a") == tuple(tables)
    assert choose_part(tables, "Values B", "a") == (tables[1],)
    with pytest.raises(
        ReadError, match=r"a, part 'C': .* Leave `part` out: the export does not na"
    ):
        choose_part([Table("", (), (), {})], "C", "a")


N = 12


COUNT = np.arange(float(N))


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("s", 1.0), ("Sec", 1.0), ("SEC", 1.0), ("min", 60.0), ("ms", 1e-3), ("d", 86400.0)],
)
def test_time_is_in_seconds(unit: str, factor: float) -> None:
    table = Table("", ("Time", "F"), (unit, "N"), {0: COUNT, 1: COUNT})
    recording = assemble(Export((table,)), shipped_cards()["nexygen"], "a")
    np.testing.assert_allclose(recording.clocks[0].time, factor * COUNT)
    assert recording.metadata["clocks"] == {"time": {"time": "Time", "unit_in_file": unit}}


def test_notes_on_channels() -> None:
    names, units = ("Time", "F", "F", "still"), ("s", "N", "", "mm")
    gone = np.where(COUNT == 3, np.nan, COUNT)
    table = Table("", names, units, {0: COUNT, 1: COUNT, 2: gone, 3: 0.0 * COUNT})
    recording = assemble(Export((table,)), shipped_cards()["nexygen"], "a")
    assert [(note.code, note.where, note.message) for note in recording.notes] == [
        ("missing_values", "F [2]", "1 of 12 values are missing, the first in row 4"),
        ("constant_channel", "channels", "1 of 3 channels never change: 'still'"),
        ("units_not_stated", "channels", "no unit is stated for 1 of 3 channels: 'F [2]'"),
        ("names_not_unique", "channels", "of 3 channels 2 are called 'F': tell them apart by path"),
    ]
