"""``labpipe model`` and ``labpipe report``: from a sheet or processed tests to files; refusals."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.virtual_lab import simulate_test
from labpipe.virtual_lab.tensile import TABLE_2_3, GripSlip, build_corrugated_tube, build_twist_tube
from tests.approved import Approve
from tests.builders.small_tests import Run, RunSummary, state

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


def test_json_holds_the_law(tmp_path: Path, run: Run) -> None:
    out = ("--out", tmp_path / "out", "--no-figures", "--json")
    printed = json.loads(run("model", sheet(tmp_path, A1, A3), *out).out)
    assert printed == json.loads((tmp_path / "out" / "model.json").read_text("utf-8"))
    for name, strands in (("A1", 7), ("A3", 19)):
        wire = printed["wires"][name]
        curvature, moment = np.array(wire["curvature"]), np.array(wire["moment"])
        assert curvature[0] == 0.0
        assert np.all(np.diff(curvature) > 0.0)
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
        layout = wire["layout"]
        assert layout["kind"] == "hexagonal"
        assert [len(layout[part]) for part in ("x", "y", "layer")] == [strands] * 3


def test_files_follow_the_sheet(tmp_path: Path, run: Run) -> None:
    """Those of a wire that cannot be built, or that left the sheet, are taken away; no others."""
    decks = tmp_path / "out" / "decks"

    def modelled(*rows: str) -> tuple[RunSummary, set[str]]:
        done = run("model", sheet(tmp_path, *rows), "--out", tmp_path / "out", "--no-figures")
        return done, {file.name for file in decks.iterdir()}

    own = {f"A1.{ending}" for ending in DECKS}
    done, files = modelled(A1, TIGHT.replace(",1.78,", ",1.82,"))
    assert (done.status, files) == (0, own | {f"X1.{ending}" for ending in DECKS})
    done, files = modelled(A1, TIGHT)
    assert (done.status, files) == (1, own)
    assert "line 3, wire 'X1': expected a wire that can be built and bent, found this:" in done.err
    assert "  not modelled: X1 (reasons below)" in done.out
    printed = json.loads((tmp_path / "out" / "model.json").read_text("utf-8"))
    assert (list(printed["wires"]), list(printed["refused"])) == (["A1"], ["X1"])
    assert modelled(A1, A3)[0].status == 0
    (decks / "mine.txt").write_text("a note of the lab", encoding="utf-8")
    done, files = modelled(A1)
    assert (done.status, files) == (0, own | {"mine.txt"})
    assert "  no longer in the sheet, files removed: A3" in done.out


TUBES = ("1a", "1b", "1c", "2a", "2b", "2c")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six twist tubes of two spools, and two corrugated tubes, one of which slipped."""
    home = tmp_path_factory.mktemp("campaign")
    slipped = replace(build_corrugated_tube("CT-10-2"), slips=(GripSlip(24e-3, 0.8),))
    scenarios = [*map(build_twist_tube, TUBES), build_corrugated_tube("CT-10-1"), slipped]
    for seed, scenario in enumerate(scenarios, start=1):
        simulate_test(scenario, home / "raw" / scenario.name, seed)
    assert main(["process", str(home / "raw"), "--no-figures"]) in (0, 1)
    return home / "processed"


@pytest.fixture
def tests(campaign: Path, tmp_path: Path) -> Path:
    """Three tests of the campaign, to be changed."""
    copied = tmp_path / "processed"
    for name in ("twist-tube-1a", "twist-tube-1b", "twist-tube-2a"):
        shutil.copytree(campaign / name, copied / name)
    return copied


def words(folder: Path) -> str:
    """The page without its marks, blanks made one."""
    page = (folder / "report.html").read_text(encoding="utf-8")
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))


def test_a_campaign(campaign: Path, tmp_path: Path, run: Run) -> None:
    """Table 2.3 comes back, with an interval over two spools: one degree of freedom."""
    before, out = state(campaign), tmp_path / "report"
    done = run("report", campaign, "--out", out)
    assert (done.status, done.err, state(campaign)) == (0, "", before)
    assert "twist-tube-10  (twist-tube): 6 samples from 2 spools\n" in done.out
    assert "CT-10  (corrugated-tube): 2 samples from 1 spool\n" in done.out
    assert done.out.endswith(f"report: {out / 'report.html'}\n")
    assert {path.suffix for path in out.rglob("*") if path.is_file()} == {".html", ".json", ".xlsx"}
    assert (out / "report.html").stat().st_size < 1_000_000
    first = [table[0] for table in TABLE_2_3.values()]
    (line,) = (line for line in done.out.splitlines() if "stiffness_first_per_peak" in line)
    assert float(line.split()[1]) == pytest.approx(sum(first) / len(first), rel=0.01)
    low, high = re.findall(r"95 %: (\S+) to (\S+)", line)[0]
    factor = math.exp(65.6 / 52.28)  # on a log scale
    assert float(low) == pytest.approx(52.28 / factor, rel=0.05)
    assert float(high) == pytest.approx(52.28 * factor, rel=0.05)
    assert "Over 2 spool means" in words(out)


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
    before, told = state(out), []
    wide = A1.replace("1.4", "wide"), A3.replace("19", "18")
    for rows, where in (((TIGHT,), out), (wide, out), ((A1,), taken)):
        done = run("model", sheet(tmp_path, *rows), "--out", where, "--no-figures")
        told.append((done.status, done.err))
    for file in (own, tmp_path / "none.xlsx"):
        done = run("model", file, "--out", out, "--no-figures")
        told.append((done.status, done.err))
    assert [status for status, _ in told] == [2] * 5
    assert state(out) == before
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
