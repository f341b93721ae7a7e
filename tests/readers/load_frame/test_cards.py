"""Cards of dialects, and how an export finds its card."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame, read_export
from labpipe.readers.load_frame import choose_card, recognise_card
from labpipe.readers.load_frame.cards import (
    Card,
    load_lab_cards,
    parse_card,
)
from tests.approved import Approve
from tests.builders import load_frames as frames


def written(path: Path, text: str) -> Path:
    path.write_bytes(text.encode())
    return path


def page(repository: Path) -> str:
    return (repository / "docs" / "how-to" / "new-dialect.md").read_text(encoding="utf-8")


def test_the_keys_and_the_example_of_the_documentation(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = page(repository).partition("## 3. The keys")[2]
    documented = set(re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE))
    assert documented | {"name", "source"} == {*Card.model_fields}
    fenced = re.findall(r"^```(\w+)\n(.*?)^```$", page(repository), flags=re.MULTILINE | re.DOTALL)
    export, card = (next(text for kind, text in fenced if kind == k) for k in ("text", "toml"))
    file = tmp_path / "test-7.acme"
    file.write_text(export, encoding="cp1252")
    monkeypatch.chdir(tmp_path)
    assert load_frame.read(file).metadata["dialect"] == "table"
    (tmp_path / "dialects").mkdir()
    (tmp_path / "dialects" / "acme.toml").write_text(card, encoding="utf-8")
    recording = read_export(file, "load-frame", dialect=["acme"])
    assert recording.metadata["dialect"] == "acme"
    assert (recording.program, recording.program_version) == ("Acme Bench", "3.1")
    travel, force = recording.channels
    assert (travel.name, travel.unit_in_file) == ("Weg", "mm")
    np.testing.assert_array_equal(travel.values, [0.0, 0.125, np.nan])
    kraft = ("Kraft", "kN", [0.5, 1.25, 2.0])
    assert (force.name, force.unit_in_file, force.values.tolist()) == kraft
    assert recording.clocks[0].time.tolist() == [0.0, 0.5, 1.0]
    assert recording.metadata["Prüfer"] == "lab"
    (tmp_path / "dialects" / "acme.toml").write_bytes("about = 'Prüfung'".encode("cp1252"))
    expected = r"expected a card in UTF-8, found a damaged one .*Save it as"
    with pytest.raises(ReadError, match=expected):
        load_lab_cards()


GOOD = """
about = "a card"
recognise = ["^ACME"]
names = "above units"
time = ["time"]
"""


FAULTS = [
    "names =",
    GOOD + "seperators = []",
    'about = "a"',
    GOOD + 'separators = ["=="]',
    GOOD + "separators = ','",
    GOOD + "layout = 'blocs'",
    GOOD + "version = '(a)(b)'",
    GOOD + "start = '('",
    GOOD + "blank = 1",
    GOOD + "missing = ['a']",
    GOOD + f"missing = [{'9' * 400}]",
    GOOD + f"missing = [{'9' * 5000}]",
    GOOD + "a = " + 4000 * "[",
    GOOD + "start = 'a{99999999999999}'",
    GOOD + "program = ''",
    GOOD + "encodings = ['utf-9']",
    GOOD + "units = 'N'",
    GOOD + "[units]\nF = 1",
    GOOD.replace("above units", "alone"),
    GOOD.replace("above units", "listed"),
    GOOD.replace("above units", "with units"),
    GOOD.replace('["^ACME"]', "[]"),
    "about = 1\nseperators = []\nnames = 'x'",
]
"""The last one has five faults, which are all named."""


def test_cards_that_are_refused(approved: Approve) -> None:
    whole = GOOD + 'separators = ["blanks", ","]\n[units]\nF = "N"'
    card = parse_card(whole, name="acme", source="x")
    assert (card.name, card.separators, card.units["F"]) == ("acme", (" ", ","), "N")
    assert card.time[0].fullmatch("TIME")
    messages = [refusal(text) for text in FAULTS]
    assert messages[-1].count(", key ") == 5
    # what Python says of text that is no TOML is its own affair
    short = [message.partition(" other text (")[0][:200] for message in messages]
    approved([*short, refusal(GOOD, "Acme Frame")])


def refusal(text: str, name: str = "acme") -> str:
    with pytest.raises(ReadError) as refused:
        parse_card(text, name=name, source=f"{name}.toml")
    return str(refused.value)


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["motive", "dspace"])
def test_exports_of_other_instruments_fit_none(realdata: Path, folder: str) -> None:
    assert not [path.name for path in (realdata / folder).iterdir() if load_frame.recognise(path)]


def test_the_wrong_dialect(tmp_path: Path) -> None:
    file = written(tmp_path / "a.txt", frames.mts_suite().decode())
    expected = (
        r"a\.txt: expected an export of the dialect bluehill, found one of the dialect mts-te"
    )
    with pytest.raises(ReadError, match=expected):
        read_export(file, "load-frame", dialect=["bluehill"])
    assert choose_card(file, ["bluehill", "mts-testsuite"]).name == "mts-testsuite"
    expected = (
        r"dialect 'bluhill': expected one of the 15 cards, found no such card\. Nearest: blueh"
    )
    with pytest.raises(ReadError, match=expected):
        choose_card(file, "bluhill")


@pytest.mark.parametrize(
    "text",
    [
        "Time (s),Extension,Load\n0,1,2\n1,2,3\n",
        "Time;Extension;Load\ns;;\n0;1;2\n1;2;3\n",
        "sep=;\nTime, s;Extension;Load\n0;1;2\n1;2;3\n",
    ],
)
def test_units_of_channels_may_be_left_to_the_protocol(tmp_path: Path, text: str) -> None:
    recording = load_frame.read(written(tmp_path / "a.txt", text))
    expected = [("Extension", ""), ("Load", "")]
    assert [(c.name, c.unit_in_file) for c in recording.channels] == expected
    assert recording.clocks[0].time.tolist() == [0.0, 1.0]
    assert {"dialect_generic", "units_not_stated"} <= {note.code for note in recording.notes}


@pytest.mark.parametrize("text", ["Time,Room\n0,1\n", "Time,Room\n1,2\nthe force of habit\n"])
def test_a_table_of_something_else_fits_none(tmp_path: Path, text: str) -> None:
    """Without units the names must speak of force or displacement; words elsewhere do not do."""
    assert recognise_card(written(tmp_path / "a.txt", text)) is None


SUITE = "Percorso: {}\nProva: x\nCiclo: 1\nData: {}\n\n\nTime\tLoad\nsec\tN\n0\t1\n1\t2\n"


@pytest.mark.parametrize(
    ("path", "date", "is_suite"),
    [
        ("C:\\lab\\a.txt   ", "7/3/2025 12:23:28 PM", True),
        ("\\\\server\\share\\a.txt", "28/07/2025 13.32.19", True),
        ("DAQ- Crosshead, … - (Timed).txt", "28.07.2025 13:32:19", True),
        ("/exports/pull/a.csv", "2025-07-28T13:32:19", True),
        ("a.txt", "28. 7. 2025 9.05.07", True),
        ("a.txt", "28.07.2025", False),
        ("a.pdf", "28.07.2025 13:32:19", False),
        ("", "1 13:32", False),
    ],
)
def test_paths_and_dates_of_testsuite(tmp_path: Path, path: str, date: str, is_suite: bool) -> None:
    card = recognise_card(written(tmp_path / "a.txt", SUITE.format(path, date)))
    assert (card is not None and card.name == "mts-testsuite") == is_suite


def test_own_cards_come_first_and_must_not_both_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = 'about = "a"\nrecognise = ["^Time"]\ntime = ["Time"]\n'
    text += 'names = "above units"\nbrackets = "()"\n'
    (tmp_path / "dialects").mkdir()
    monkeypatch.chdir(tmp_path)
    file = written(tmp_path / "a.csv", frames.bluehill(preamble=0).decode())
    (tmp_path / "dialects" / "own.toml").write_text(text, encoding="utf-8")
    assert load_frame.read(file).metadata["dialect"] == "own"
    (tmp_path / "dialects" / "other.toml").write_text(text, encoding="utf-8")
    with pytest.raises(
        ReadError, match=r"one card recognises, found one that fits other and own\. Na"
    ):
        recognise_card(file)
    assert [*load_lab_cards()] == ["other", "own"]
    (tmp_path / "dialects" / "own.toml").rename(tmp_path / "dialects" / "catman.toml")
    expected = r"catman\.toml: expected a unique name, found 'catman', the name of a card of labp"
    with pytest.raises(ReadError, match=expected):
        load_frame.read(file)
