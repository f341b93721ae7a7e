"""Wires of a sheet to tables and refusals; the files are looked at end to end."""

from __future__ import annotations

import json
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.decks import deck_texts
from labpipe.errors import ProcessingError, StoreError
from labpipe.records.wire import WireSpec, WireTable
from labpipe.studies import wire_models as modelling
from labpipe.studies.wire_models import Modelled, as_json, make_tables, model_wires
from labpipe.wire import wire_table as making
from tests.builders.wire_tables import wire_table

SHEET = Path("wires.csv")
GOOD = wire_table("A2").spec
TIGHT = replace(GOOD, name="X1", wire_diameter=1.5e-3, layout="hexagonal", place="line 7")


def test_wires_come_in_the_order_of_the_sheet() -> None:
    told: list[str] = []
    made, refused = make_tables([replace(GOOD, name="B"), GOOD], SHEET, told.append)
    assert [wire.table.name for wire in made] == told == ["B", "A2"]
    assert made[1].decks == deck_texts(made[1].table)
    assert not refused


def test_what_is_refused_is_told_with_its_row() -> None:
    made, refused = make_tables([TIGHT, GOOD], SHEET)
    assert [wire.table.name for wire in made] == ["A2"]
    assert list(refused) == ["X1"]
    assert refused["X1"].startswith(
        "wires.csv, line 7, wire 'X1': expected a wire that can be built and bent, found this: "
    )
    assert refused["X1"].endswith("Check its row against the wire.")
    assert "overlap the bore" in refused["X1"]


def test_a_deck_that_cannot_be_made_refuses_its_wire(monkeypatch: pytest.MonkeyPatch) -> None:
    def softening(spec: WireSpec) -> WireTable:
        table = making.wire_table(spec)
        return replace(table, moment=table.moment[::-1]) if spec.name == "B" else table

    monkeypatch.setattr(modelling, "wire_table", softening)
    made, refused = make_tables([replace(GOOD, name="B", place="line 3"), GOOD], SHEET)
    assert [wire.table.name for wire in made] == ["A2"]
    assert refused["B"].startswith("wires.csv, line 3, wire 'B': expected a wire that can be")
    assert (
        "found this: its deck abaqus.inp cannot be made: the law does not go from" in refused["B"]
    )


def test_two_processes_say_what_one_says() -> None:
    specs = [replace(GOOD, name=f"W{number}") for number in range(5)] + [TIGHT]
    with ProcessPoolExecutor(2) as pool:
        made, refused = make_tables(specs, SHEET, pool=pool)
    assert [wire.table.name for wire in made] == [spec.name for spec in specs[:-1]]
    assert list(refused) == ["X1"]
    assert (made[4].table.moment == making.wire_table(GOOD).moment).all()


HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"


@pytest.fixture
def many(tmp_path: Path) -> Path:
    """A sheet that is worth two processes, beside results of it."""
    rows = [f"W{number},1.4,7,0.26,12,0.3" for number in range(26)]
    sheet = tmp_path / "many.csv"
    sheet.write_text("\n".join((HEADING, *rows)) + "\n", encoding="utf-8")
    (tmp_path / "out" / "decks").mkdir(parents=True)
    (tmp_path / "out" / "decks" / "W0.csv").write_text("earlier", encoding="utf-8")
    return sheet


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_process_that_is_killed_is_told(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modelling, "wire_table", lambda _: os._exit(9))
    out = many.parent / "out"
    with pytest.raises(ProcessingError) as told:
        model_wires(many, out=out, figures=False)
    assert str(told.value) == (
        f"{many}: expected processes that model its wires to the end, found that one of them was "
        f"ended from outside, as for want of memory. Close other programs, or split the sheet, and "
        f"run the model again."
    )
    assert contents(out) == {"W0.csv": b"earlier"}


def test_an_interrupt_leaves_earlier_results(many: Path) -> None:
    def say(name: str) -> None:
        if name == "W3":
            raise KeyboardInterrupt

    out = many.parent / "out"
    with pytest.raises(KeyboardInterrupt):
        model_wires(many, out=out, figures=False, say=say)
    assert contents(out) == {"W0.csv": b"earlier"}


def test_an_error_in_a_process_comes_through(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        message = "no room for the workbook"
        raise StoreError(message)

    monkeypatch.setattr("labpipe.report.wire_workbook._sheets", fails)
    out = many.parent / "out"
    with pytest.raises(StoreError, match=r"^no room for the workbook$"):
        model_wires(many, out=out, figures=False)
    assert contents(out) == {"W0.csv": b"earlier"}


def test_a_bug_in_a_process_shows_itself(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modelling, "wire_table", lambda _: [].pop())
    with pytest.raises(IndexError, match="pop from empty list"):
        model_wires(many, out=many.parent / "out", figures=False)


@pytest.mark.slow
def test_a_disk_that_refuses_is_told(many: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> list[Path]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(modelling, "write_texts", full)
    out = many.parent / "out"
    with pytest.raises(StoreError, match=r"expected room on the disk, found a full disk\."):
        model_wires(many, out=out, figures=False)
    assert contents(out) == {"W0.csv": b"earlier"}


def test_json_is_plain_and_whole() -> None:
    table: WireTable = wire_table("A2")
    modelled = Modelled(SHEET, Path("out"), (table,), {"X1": "why"}, ())
    found = json.loads(json.dumps(as_json(modelled), allow_nan=False))
    assert found["sheet"] == "wires.csv"
    assert found["refused"] == {"X1": "why"}
    wire = found["wires"]["A2"]
    assert wire["moment"] == table.moment.tolist()
    assert wire["cantilever"]["force"] == table.tip_force.tolist()
    assert wire["layout"]["layer"] == [0, 1, 1, 1, 1, 1, 1]
