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
    with pytest.raises(ReadError, match=r"expected an export of a known format"):
        read_export(file, "load-frame")


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
