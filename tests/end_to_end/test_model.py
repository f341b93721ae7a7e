"""``labpipe model``: from a sheet of wires to tables, decks, figures and a workbook."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from openpyxl import load_workbook

from tests.builders.small_tests import Run

HEADING = (
    "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm,"
    "layout,stress_table"
)
A1 = "A1,1.4,7,0.26,12,0.3,,"
A3 = "A3,1.8,19,0.24,12;-15,0.3,,"
TIGHT = "X1,1.78,19,0.24,12;-15,0.3,hexagonal,"
"""A hexagon of 19 strands that is 10 um too large for its bore, though the copper would fit."""
DECKS = (
    *("csv", "json", "abaqus.inp", "ansys.inp", "calculix.inp", "mujoco.xml"),
    *("mujoco-plane.xml", "mujoco-space.xml", "sliders.csv", "sliders.json"),
)


def sheet(folder: Path, *rows: str) -> Path:
    path = folder / "sheet.csv"
    path.write_text("\n".join((HEADING, *rows)) + "\n", encoding="utf-8")
    return path


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_the_example_of_the_project(repository: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    done = run(
        "model", str(repository / "examples" / "wires.xlsx"), "--out", str(out), "--no-figures"
    )
    assert done.status == 0, done.err
    model = json.loads((out / "model.json").read_text("utf-8"))
    names = ["A1", "A2", "A3", "B1", "B2", "C1", "C2", "C3", "C4", "C5"]
    assert list(model["wires"]) == names
    assert [line.split()[0] for line in done.out.splitlines()[2:12]] == names
    assert {path.name for path in (out / "decks").iterdir()} == {
        f"{name}.{ending}" for name in names for ending in DECKS
    }
    laws = load_workbook(out / "wires.xlsx")["laws"]
    assert list(dict.fromkeys(cell.value for cell in laws["A"][1:])) == names
    assert not (out / "figures").exists()


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What --json prints for two wires."""
    from contextlib import redirect_stdout
    from io import StringIO

    from labpipe.cli import main

    folder = tmp_path_factory.mktemp("wires")
    text = StringIO()
    with redirect_stdout(text):
        status = main(
            ["model", str(sheet(folder, A1, A3)), "--out", str(folder), "--no-figures", "--json"]
        )
    assert status == 0
    found: dict[str, Any] = json.loads(text.getvalue())
    assert found == json.loads((folder / "model.json").read_text("utf-8"))
    return found


@pytest.mark.parametrize("name", ["A1", "A3"])
def test_json_holds_the_law(printed: dict[str, Any], name: str) -> None:
    wire = printed["wires"][name]
    curvature, moment = np.array(wire["curvature"]), np.array(wire["moment"])
    assert curvature[0] == 0.0
    assert np.all(np.diff(curvature) > 0.0)
    assert np.all(np.diff(moment) > 0.0)
    assert np.allclose(moment[1:] / curvature[1:], wire["secant_stiffness"][1:], rtol=1e-12)
    parts = sum(
        np.array(wire[part]) for part in ("stick", "slip", "bending", "plastic", "insulation")
    )
    assert np.allclose(parts, moment, rtol=1e-9, atol=1e-15)
    assert np.isclose(wire["tangent_stiffness"][0], wire["stick_stiffness"], rtol=1e-6)
    assert wire["tangent_stiffness"][-1] < wire["slip_stiffness"] < wire["stick_stiffness"]
    tip = np.array(wire["cantilever"]["tip_deflection"])
    assert tip[0] == 0.0
    assert np.all(np.diff(wire["cantilever"]["force"]) > 0.0)
    assert tip[-1] >= 0.8 * wire["cantilever"]["length"] * (1.0 - 1e-9)
    strands = len(wire["layout"]["x"])
    assert strands == {"A1": 7, "A3": 19}[name]
    assert len(wire["layout"]["y"]) == len(wire["layout"]["layer"]) == strands
    assert wire["layout"]["kind"] == "hexagonal"


def test_notes_say_what_the_sheet_did_not(printed: dict[str, Any]) -> None:
    (note,) = [note for note in printed["wires"]["A1"]["notes"] if note["code"] == "defaults_taken"]
    for said in ("insulation modulus 1000 MPa", "poisson 0.34", "length 85 mm", "0.15 N"):
        assert said in note["message"]


def test_table_is_what_the_json_says(tmp_path: Path, run: Run) -> None:
    assert (
        run("model", str(sheet(tmp_path, A1)), "--out", str(tmp_path), "--no-figures").status == 0
    )
    model = json.loads((tmp_path / "model.json").read_text("utf-8"))["wires"]["A1"]
    lines = (tmp_path / "decks" / "A1.csv").read_text("utf-8").splitlines()
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    assert np.allclose([float(row[0]) for row in rows[1:]], model["curvature"], rtol=1e-9)
    assert np.allclose([float(row[1]) for row in rows[1:]], model["moment"], rtol=1e-9)


@pytest.mark.slow
def test_figures_are_drawn_and_stay_without_them(tmp_path: Path, run: Run) -> None:
    path = sheet(tmp_path, A1)
    assert run("model", str(path), "--out", str(tmp_path), "--png").status == 0
    own = {f"A1.{kind}" for kind in ("stiffness", "moment", "cantilever")}
    drawn = {file.name for file in (tmp_path / "figures").iterdir()}
    assert {f"{each}.png" for each in own} < drawn
    (tmp_path / "figures" / "mine.png").write_bytes(b"")
    assert run("model", str(path), "--out", str(tmp_path)).status == 0
    drawn = {file.name for file in (tmp_path / "figures").iterdir()}
    assert drawn == {"sections-1.svg", "mine.png", *(f"{each}.svg" for each in own)}
    assert run("model", str(path), "--out", str(tmp_path), "--no-figures").status == 0
    assert {file.name for file in (tmp_path / "figures").iterdir()} == drawn


def test_results_go_below_processed_unless_told(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run("model", str(sheet(tmp_path, A1)), "--no-figures")
    assert done.status == 0
    assert (tmp_path / "processed" / "sheet" / "wires.xlsx").is_file()
    assert done.out.splitlines()[-1] == f"results: {Path('processed') / 'sheet'}"


def test_an_impossible_wire_is_told_and_the_others_are_done(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    path = sheet(tmp_path, A1, TIGHT.replace(",1.78,", ",1.82,"))
    assert run("model", str(path), "--out", str(out), "--no-figures").status == 0
    assert (out / "decks" / "X1.csv").is_file()
    done = run("model", str(sheet(tmp_path, A1, TIGHT)), "--out", str(out), "--no-figures")
    assert done.status == 1
    assert "line 3, wire 'X1': expected a wire that can be built and bent, found this:" in done.err
    assert "strands overlap the bore of radius 0.00059 m by 1e-05 m" in done.err
    assert "  not modelled: X1 (reasons below)" in done.out
    assert (out / "decks" / "A1.csv").is_file()
    assert not (out / "decks" / "X1.csv").exists()
    model = json.loads((out / "model.json").read_text("utf-8"))
    assert list(model["wires"]) == ["A1"]
    assert list(model["refused"]) == ["X1"]


def test_files_of_a_wire_whose_name_begins_alike_stay(tmp_path: Path, run: Run) -> None:
    other = A1.replace("A1,", "X1.5,")
    path = sheet(tmp_path, other, TIGHT)
    assert run("model", str(path), "--out", str(tmp_path), "--no-figures").status == 1
    assert {file.name for file in (tmp_path / "decks").iterdir()} == {
        f"X1.5.{ending}" for ending in DECKS
    }


def test_a_sheet_of_impossible_wires_leaves_earlier_results(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    assert run("model", str(sheet(tmp_path, A1)), "--out", str(out), "--no-figures").status == 0
    before = contents(out)
    done = run("model", str(sheet(tmp_path, TIGHT)), "--out", str(out), "--no-figures")
    assert done.status == 2
    assert "strands overlap the bore" in done.err
    assert "Traceback" not in done.err
    assert contents(out) == before


def test_faults_of_the_sheet_leave_earlier_results(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    assert run("model", str(sheet(tmp_path, A1)), "--out", str(out), "--no-figures").status == 0
    before = contents(out)
    path = sheet(tmp_path, A1.replace("1.4", "wide"), A3.replace("19", "18"))
    done = run("model", str(path), "--out", str(out))
    assert done.status == 2
    assert "found 'wide'" in done.err
    assert "1 + 6 + 12" in done.err or "19" in done.err
    assert contents(out) == before


def test_no_sheet(tmp_path: Path, run: Run) -> None:
    done = run("model", str(tmp_path / "none.xlsx"))
    assert done.status == 2
    assert "none.xlsx" in done.err


def test_a_folder_in_the_way_of_results(tmp_path: Path, run: Run) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file", encoding="utf-8")
    done = run("model", str(sheet(tmp_path, A1)), "--out", str(taken), "--no-figures")
    assert done.status == 2
    assert str(taken) in done.err
    assert taken.read_text("utf-8") == "a file"


@pytest.mark.slow
def test_many_wires_in_two_processes_are_what_one_says(tmp_path: Path, run: Run) -> None:
    rows = [A1.replace("A1,", f"W{number},") for number in range(26)]
    assert (
        run("model", str(sheet(tmp_path, *rows)), "--out", str(tmp_path), "--no-figures").status
        == 0
    )
    wires = json.loads((tmp_path / "model.json").read_text("utf-8"))["wires"]
    assert list(wires) == [f"W{number}" for number in range(26)]
    alone = tmp_path / "alone"
    alone.mkdir()
    assert run("model", str(sheet(alone, A1)), "--out", str(alone), "--no-figures").status == 0
    one = json.loads((alone / "model.json").read_text("utf-8"))["wires"]["A1"]
    assert wires["W25"]["moment"] == one["moment"]


def test_same_sheet_same_files(tmp_path: Path, run: Run) -> None:
    for number in (1, 2):
        out = tmp_path / str(number)
        assert run("model", str(sheet(tmp_path, A1)), "--out", str(out), "--no-figures").status == 0
    first, second = (
        {path.name: data for path, data in contents(tmp_path / number).items()}
        for number in ("1", "2")
    )
    for name in first:
        assert first[name] == second[name]


def test_the_sheet_itself_is_never_written_over(repository: Path, tmp_path: Path, run: Run) -> None:
    path = tmp_path / "wires.xlsx"
    path.write_bytes((repository / "examples" / "wires.xlsx").read_bytes())
    before = path.read_bytes()
    done = run("model", str(path), "--out", str(tmp_path), "--no-figures")
    assert done.status == 2
    assert "expected a folder for the results in which this sheet is not one of them" in done.err
    assert "Choose another folder with --out." in done.err
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_files_of_wires_that_left_the_sheet_are_taken_away(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    assert run("model", str(sheet(tmp_path, A1, A3)), "--out", str(out), "--no-figures").status == 0
    (out / "decks" / "mine.txt").write_text("a note of the lab", encoding="utf-8")
    done = run("model", str(sheet(tmp_path, A1)), "--out", str(out), "--no-figures")
    assert done.status == 0
    assert "  no longer in the sheet, files taken away: A3" in done.out
    assert {file.name for file in (out / "decks").iterdir()} == {
        "mine.txt",
        *(f"A1.{ending}" for ending in DECKS),
    }
