from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame, read_export
from labpipe.readers.load_frame.cards import shipped_cards
from labpipe.readers.load_frame.recognition import _Heads, chosen_card, recognised
from tests.readers.load_frame.exports import bluehill, mts, written

VENDORS = ("mts", "deben", "hbm_catman", "instron", "lloyd_nexygen", "shimadzu", "walter_bai")
FOLDERS = (*VENDORS, "ta_dma", "zwick")


@pytest.mark.realdata
@pytest.mark.parametrize("folder", FOLDERS)
def test_real_exports_fit_one_card(realdata: Path, folder: str) -> None:
    files = [path for path in sorted((realdata / folder).rglob("*")) if path.is_file()]
    assert files
    for file in files:
        heads = _Heads(file)
        cards = [c for c in shipped_cards().values() if not c.fallback and heads.fit(c)]
        assert len(cards) == 1, (file.name, [card.name for card in cards])


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["motive", "dspace"])
def test_exports_of_other_instruments_fit_none(realdata: Path, folder: str) -> None:
    assert not [path.name for path in (realdata / folder).iterdir() if load_frame.recognise(path)]


def test_the_wrong_dialect(tmp_path: Path) -> None:
    file = mts(tmp_path / "a.txt")
    expected = (
        r"a\.txt: expected an export of the dialect bluehill, found one of the dialect mts-te"
    )
    with pytest.raises(ReadError, match=expected):
        read_export(file, "load-frame", dialect=["bluehill"])
    assert chosen_card(file, ["bluehill", "mts-testsuite"]).name == "mts-testsuite"


def test_a_dialect_that_does_not_exist(tmp_path: Path) -> None:
    file = mts(tmp_path / "a.txt")
    expected = (
        r"dialect 'bluhill': expected one of the 15 cards, found no such card\. Nearest: blueh"
    )
    with pytest.raises(ReadError, match=expected):
        chosen_card(file, "bluhill")


def test_no_card_fits(tmp_path: Path) -> None:
    file = written(tmp_path / "a.txt", "a letter\n")
    assert recognised(file) is None
    with pytest.raises(
        ReadError, match=r"expected an export of .* found one that no card recognises"
    ):
        chosen_card(file, None)


def test_a_dialect_that_is_asked_for_is_tried(tmp_path: Path) -> None:
    """An export that no card recognises is read by the one named, which checks its structure."""
    file = written(tmp_path / "a.txt", "Time,Extension,Load\n0,1,2\n")
    with pytest.raises(
        ReadError, match=r"line 1: expected a row of units in \(\) above the numbers"
    ):
        read_export(file, "load-frame", dialect=["bluehill"])


@pytest.mark.parametrize("dialect", [None, ["table"]])
def test_a_table_without_units_is_told_what_it_lacks(
    tmp_path: Path, dialect: list[str] | None
) -> None:
    file = written(tmp_path / "a.txt", "Time,Extension,Load\n0,1,2\n")
    expected = (
        r"a\.txt, column 'Time': expected a unit of time such as s, found none\. Write it in a row"
        r" below the names, or in brackets as in 'Time \(s\)', or say it in a card of your own"
        r" \(time_unit\); see docs/how-to/new-dialect\.md\."
    )
    with pytest.raises(ReadError, match=expected):
        read_export(file, "load-frame", dialect=dialect)


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
    assert [(c.name, c.unit_in_file) for c in recording.channels] == [
        ("Extension", ""),
        ("Load", ""),
    ]
    assert recording.clocks[0].time.tolist() == [0.0, 1.0]
    assert {"dialect_generic", "units_not_stated"} <= {note.code for note in recording.notes}


@pytest.mark.parametrize("text", ["Time,Room\n0,1\n", "Time,Room\n1,2\nthe force of habit\n"])
def test_a_table_of_something_else_fits_none(tmp_path: Path, text: str) -> None:
    """Without units the names must speak of force or displacement; words elsewhere do not do."""
    assert recognised(written(tmp_path / "a.txt", text)) is None


@pytest.mark.parametrize("hint", ["sep=\t", "sep=;", '"sep=;"'])
def test_a_hint_for_spreadsheets_in_line_1(tmp_path: Path, hint: str) -> None:
    head = "Time (s)\tLoad (N)\tMachine Extension (mm)\r\n"
    text = f"{hint}\r\n{head}0\t1\t2\r\n1\t2\t3\r\n"
    recording = load_frame.read(written(tmp_path / "a.txt", text))
    assert recording.metadata["dialect"] == "nexygen"
    assert "lines" not in recording.metadata
    assert recording.clocks[0].time.tolist() == [0.0, 1.0]


SUITE = "Percorso: {}\nProva: x\nCiclo: 1\nData: {}\n\n\nTime\tLoad\nsec\tN\n0\t1\n1\t2\n"


@pytest.mark.parametrize(
    ("path", "date"),
    [
        ("C:\\lab\\a.txt   ", "7/3/2025 12:23:28 PM"),
        ("\\\\server\\share\\a.txt", "28/07/2025 13.32.19"),
        ("DAQ- Crosshead, … - (Timed).txt", "28.07.2025 13:32:19"),
        ("/exports/pull/a.csv", "2025-07-28T13:32:19"),
        ("a.txt", "28. 7. 2025 9.05.07"),
    ],
)
def test_paths_and_dates_of_testsuite(tmp_path: Path, path: str, date: str) -> None:
    card = recognised(written(tmp_path / "a.txt", SUITE.format(path, date)))
    assert card is not None
    assert card.name == "mts-testsuite"


@pytest.mark.parametrize(
    ("path", "date"), [("a.txt", "28.07.2025"), ("a.pdf", "28.07.2025 13:32:19"), ("", "1 13:32")]
)
def test_what_is_no_testsuite(tmp_path: Path, path: str, date: str) -> None:
    card = recognised(written(tmp_path / "a.txt", SUITE.format(path, date)))
    assert card is None or card.name != "mts-testsuite"


def test_a_path_without_a_drive_needs_the_two_blank_lines(tmp_path: Path) -> None:
    text = SUITE.format("a.txt", "1/2/2025 13:32:19").replace("\n\n\n", "\n")
    card = recognised(written(tmp_path / "a.txt", text))
    assert card is None or card.name != "mts-testsuite"


def test_own_cards_come_first_and_must_not_both_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = 'about = "a"\nrecognise = ["^Time"]\ntime = ["Time"]\n'
    text += 'names = "above units"\nbrackets = "()"\n'
    (tmp_path / "dialects").mkdir()
    monkeypatch.chdir(tmp_path)
    file = bluehill(tmp_path / "a.csv")
    (tmp_path / "dialects" / "own.toml").write_text(text, encoding="utf-8")
    assert load_frame.read(file).metadata["dialect"] == "own"
    (tmp_path / "dialects" / "other.toml").write_text(text, encoding="utf-8")
    with pytest.raises(
        ReadError, match=r"one card recognises, found one that fits other and own\. Na"
    ):
        recognised(file)


def test_binary_data_fits_nothing(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_bytes(bytes(range(256)) * 8)
    assert not load_frame.recognise(file)
    file.write_bytes(b"PK\x03\x04 and then nothing that is a workbook")
    assert not load_frame.recognise(file)
