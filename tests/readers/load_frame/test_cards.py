from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import load_frame, read_export
from labpipe.readers.load_frame.cards import Card, lab_cards, shipped_cards, shipped_names


def test_cards_that_come_with_labpipe() -> None:
    vendors = {name for name, card in shipped_cards().items() if not card.fallback}
    assert vendors == {
        *("mts-testsuite", "mts-793", "testresources", "bluehill", "instron-8800", "nexygen"),
        *("testxpert-tra", "testxpert-xlsx", "trapezium", "dion", "catman", "microtest"),
        "dma-q800",
    }
    assert "No real export was seen" in shipped_cards()["testresources"].about


def test_names_of_labpipe_are_not_taken(tmp_path: Path) -> None:
    (tmp_path / "bluehill.toml").write_text("about = 'a'", encoding="utf-8")
    expected = (
        r"bluehill\.toml: expected a name of its own, found 'bluehill', which is a card of lab"
    )
    with pytest.raises(ReadError, match=expected):
        lab_cards(tmp_path)


def test_a_card_that_is_not_in_utf_8(tmp_path: Path) -> None:
    (tmp_path / "acme.toml").write_bytes("about = 'Prüfung'".encode("cp1252"))
    with pytest.raises(
        ReadError, match=r"expected a card in UTF-8, found a damaged one .*Save it as"
    ):
        lab_cards(tmp_path)


def page(repository: Path) -> str:
    return (repository / "docs" / "how-to" / "new-dialect.md").read_text(encoding="utf-8")


def test_every_key_is_documented_and_no_other(repository: Path) -> None:
    table = page(repository).partition("## 3. The keys")[2]
    assert set(re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE)) == {
        key.name for key in fields(Card)
    } - {
        "name",
        "source",
    }


def test_the_example_of_the_documentation(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert (force.name, force.unit_in_file, force.values.tolist()) == (
        "Kraft",
        "kN",
        [0.5, 1.25, 2.0],
    )
    assert recording.clocks[0].time.tolist() == [0.0, 0.5, 1.0]
    assert recording.metadata["Prüfer"] == "lab"


def test_cards_of_one_kind() -> None:
    texts, workbooks = shipped_cards("text"), shipped_cards("workbook")
    assert sorted([*texts, *workbooks]) == list(shipped_names()) == list(shipped_cards())
    assert {card.kind for card in workbooks.values()} == {"workbook"}
