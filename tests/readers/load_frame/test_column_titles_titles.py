from __future__ import annotations

import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.column_titles import find_header

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
