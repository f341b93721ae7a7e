"""``labpipe model`` and ``labpipe report``: from a sheet or processed tests to files; refusals."""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.virtual_lab.observations import simulate_test
from labpipe.virtual_lab.tensile_scenarios import (
    TABLE_2_3,
    GripSlip,
    TensileScenario,
    corrugated_tube,
    twist_tube,
)
from tests.approved import Approve
from tests.builders.small_tests import Run, state

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


def test_files_of_wires_that_left_the_sheet_are_taken_away(tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    assert run("model", str(sheet(tmp_path, A1, A3)), "--out", str(out), "--no-figures").status == 0
    (out / "decks" / "mine.txt").write_text("a note of the lab", encoding="utf-8")
    done = run("model", str(sheet(tmp_path, A1)), "--out", str(out), "--no-figures")
    assert done.status == 0
    assert "  no longer in the sheet, files removed: A3" in done.out
    assert {file.name for file in (out / "decks").iterdir()} == {
        "mine.txt",
        *(f"A1.{ending}" for ending in DECKS),
    }


TUBES = ("1a", "1b", "1c", "2a", "2b", "2c")


def simulated(raw: Path, *scenarios: TensileScenario) -> None:
    for seed, scenario in enumerate(scenarios, start=1):
        simulate_test(scenario, raw / scenario.name, seed)


def processed(raw: Path, out: Path) -> Path:
    assert main(["process", str(raw), "--out", str(out), "--no-figures"]) in (0, 1)
    return out


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six twist tubes of two spools, and two corrugated tubes, one of which slipped."""
    home = tmp_path_factory.mktemp("campaign")
    slipped = replace(corrugated_tube("CT-10-2"), slips=(GripSlip(24e-3, 0.8),))
    simulated(home / "raw", *map(twist_tube, TUBES), corrugated_tube("CT-10-1"), slipped)
    return processed(home / "raw", home / "processed")


class Reported:
    """A report made once by the command, and what the folder held before."""

    def __init__(self, tests: Path) -> None:
        self.tests, self.before = tests, state(tests)
        said, complained = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
            self.status = main(["report", str(tests)])
        self.out, self.err = said.getvalue(), complained.getvalue()
        self.folder = tests / "report"


@pytest.fixture(scope="module")
def reported(campaign: Path) -> Reported:
    return Reported(campaign)


@pytest.fixture
def tests(campaign: Path, tmp_path: Path) -> Path:
    """Three tests of the campaign, to be changed."""
    copied = tmp_path / "processed"
    for name in ("twist-tube-1a", "twist-tube-1b", "twist-tube-2a"):
        shutil.copytree(campaign / name, copied / name)
    return copied


def page(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def words(folder: Path) -> str:
    """The page without its marks, blanks made one."""
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page(folder)))


def test_a_campaign(reported: Reported) -> None:
    assert (reported.status, reported.err) == (0, "")
    assert "twist-tube-10  (twist-tube): 6 samples from 2 spools\n" in reported.out
    assert "CT-10  (corrugated-tube): 2 samples from 1 spool\n" in reported.out
    assert reported.out.endswith(f"report: {reported.folder / 'report.html'}\n")
    after = state(reported.tests)
    assert {name: after[name] for name in reported.before} == reported.before
    written = {Path(name).suffix for name in set(after) - set(reported.before)}
    assert written == {".html", ".json", ".xlsx"}
    assert (reported.folder / "report.html").stat().st_size < 1_000_000


def test_table_2_3_and_the_decision_not_to_pool(reported: Reported) -> None:
    first = [table[0] for table in TABLE_2_3.values()]
    (line,) = (line for line in reported.out.splitlines() if "stiffness_first_per_peak" in line)
    assert float(line.split()[1]) == pytest.approx(sum(first) / len(first), rel=0.01)
    low, high = re.findall(r"95 %: (\S+) to (\S+)", line)[0]
    # Over two spools: one degree of freedom.
    factor = math.exp(65.6 / 52.28)  # on a log scale
    assert float(low) == pytest.approx(52.28 / factor, rel=0.05)
    assert float(high) == pytest.approx(52.28 * factor, rel=0.05)
    assert "Over 2 spool means" in words(reported.folder)


def test_a_damaged_result_among_good_ones(tests: Path, run: Run) -> None:
    damaged = tests / "twist-tube-1a" / "result.h5"
    damaged.write_bytes(damaged.read_bytes()[:3000])
    ran = run("report", tests)
    assert ran.status == 2
    assert ran.err.startswith(f"labpipe report: left out: {damaged}: expected a whole result file,")
    assert ran.err.endswith("Process the test again from its exports.\n")
    assert "twist-tube-10  (twist-tube): 2 samples from 2 spools\n" in ran.out
    assert "twist-tube-1a" in words(tests / "report")
    assert "expected a whole result file" in words(tests / "report")


def test_sheets_that_are_refused_leave_earlier_results(
    repository: Path, tmp_path: Path, run: Run, approved: Approve
) -> None:
    out, taken = tmp_path / "out", tmp_path / "taken"
    assert run("model", sheet(tmp_path, A1), "--out", out, "--no-figures").status == 0
    taken.write_text("a file", encoding="utf-8")
    own = out / "wires.xlsx"
    own.write_bytes((repository / "examples" / "wires.xlsx").read_bytes())
    before, told = contents(out), []
    wide = A1.replace("1.4", "wide"), A3.replace("19", "18")
    for rows, where in (((TIGHT,), out), (wide, out), ((A1,), taken)):
        done = run("model", sheet(tmp_path, *rows), "--out", where, "--no-figures")
        told.append((done.status, done.err))
    for file in (own, tmp_path / "none.xlsx"):
        done = run("model", file, "--out", out, "--no-figures")
        told.append((done.status, done.err))
    assert [status for status, _ in told] == [2] * 5
    assert contents(out) == before
    assert taken.read_text("utf-8") == "a file"
    approved(message for _, message in told)


def test_folders_without_a_report(tests: Path, tmp_path: Path, run: Run, approved: Approve) -> None:
    (tmp_path / "empty").mkdir()
    (tests / "taken").write_text("a file", encoding="utf-8")
    places = [
        (tmp_path / "empty",), (tmp_path / "nowhere",), (tests / "twist-tube-1a" / "summary.json",),
        (tests, "--out", tests / "taken"), (tests, "--out", tests / "taken" / "report"),
    ]  # fmt: skip
    told = []
    for place in places:
        done = run("report", *place)
        assert (done.status, done.out) == (2, "")
        told.append(done.err)
    for file in tests.rglob("result.h5"):
        file.write_bytes(b"no result")
    done = run("report", tests)
    assert (done.status, done.out, (tests / "report").exists()) == (2, "", False)
    approved([*told, done.err])
