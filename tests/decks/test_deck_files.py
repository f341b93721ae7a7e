from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.decks import deck_texts, write_decks
from labpipe.decks.deck_files import DECKS
from tests.builders.wire_tables import wire_table


def test_every_deck_of_every_wire(tmp_path: Path) -> None:
    tables = [wire_table("A1"), wire_table("A2")]
    written = write_decks(tables, tmp_path)
    names = [path.relative_to(tmp_path).as_posix() for path in written]
    assert names == [f"decks/{wire}.{ending}" for wire in ("A1", "A2") for ending in DECKS]
    for path, make in zip(written[len(DECKS) :], DECKS.values(), strict=True):
        assert path.read_bytes() == make(tables[1]).encode()


def test_decks_are_written_again_in_place(tmp_path: Path) -> None:
    first = write_decks([wire_table("A1")], tmp_path)
    content = [path.read_bytes() for path in first]
    assert [path.read_bytes() for path in write_decks([wire_table("A1")], tmp_path)] == content


def test_a_name_cannot_leave_the_folder(tmp_path: Path) -> None:
    written = write_decks([replace(wire_table(), name="../../up")], tmp_path)
    assert {path.parent for path in written} == {tmp_path / "decks"}
    assert all(path.is_file() for path in written)


def test_a_law_that_no_deck_can_hold_is_told_with_the_deck() -> None:
    table = wire_table("A1")
    with pytest.raises(ValueError, match=r"^its deck abaqus.inp cannot be made: the law does not"):
        deck_texts(replace(table, moment=table.moment[::-1]))
