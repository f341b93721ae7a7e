"""``labpipe harness``, as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.cli import BAD_INPUT, DONE, SOME_FAILED
from tests.builders.harness_files import STIFFNESS, arch, pushed, written
from tests.builders.small_tests import Run

NO_WAY = """\
version: 1
line: {length: 100 mm, elements: 8, section: %s}
boundaries:
  - {kind: clip, name: one, at: start, position: [0 mm, 0 mm, 0 mm], direction: [1, 0, 0]}
  - kind: grip
    name: knot
    at: 1 mm
    path: [{step: 4, direction: [-1, 0, 0]}]
steps: 4
"""
"""A grip that turns a millimetre of a line right round."""


@pytest.mark.slow
def test_numbers_and_where_they_are(run: Run, tmp_path: Path) -> None:
    file, out = written(tmp_path, pushed()), tmp_path / "out"
    ran = run("harness", file, "--out", out, "--no-figures")
    assert ran.status == DONE, ran
    lines = ran.out.splitlines()
    assert lines[0] == "line: 3 ok, 6 doubtful; 100 mm of A2, 12 elements, 10 steps"
    assert lines[1].startswith("  smallest_bend_radius ")
    assert any(line.startswith("  springback.gripper ") for line in lines)
    assert (
        "  allowed bend radius 8 mm (assumed: 5 times the outer diameter of 1.6 mm): kept" in lines
    )
    assert lines[-1] == f"results: {out}"
    assert not (out / "figures").exists()
    ran = run("harness", file, "--out", out, "--json", "--no-figures")
    assert json.loads(ran.out) == json.loads((out / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_what_is_not_kept_and_doubtful_is_said(run: Run, tmp_path: Path) -> None:
    text = arch(STIFFNESS.replace("80 1/m", "5 1/m"), more="allowed_bend_radius: 200 mm\n")
    ran = run("harness", written(tmp_path, text), "--out", tmp_path / "out", "--no-figures")
    assert ran.status == SOME_FAILED, "the file states a radius"
    assert "  doubtful: beyond_law: step " in ran.out
    assert "allowed bend radius 200 mm (stated in the file): NOT KEPT" in ran.err
    assert (tmp_path / "out" / "summary.json").exists()


@pytest.mark.slow
def test_a_radius_that_is_assumed_is_said_but_no_failure(run: Run, tmp_path: Path) -> None:
    text = arch(STIFFNESS.replace("2 mm", "20 mm"))
    ran = run("harness", written(tmp_path, text), "--out", tmp_path / "out", "--no-figures")
    assert ran.status == DONE
    assert "(assumed: 5 times the outer diameter of 20 mm): NOT KEPT" in ran.out
    assert ran.err == ""


@pytest.mark.slow
def test_intervals_and_lengths_are_shown(run: Run, tmp_path: Path) -> None:
    section = STIFFNESS.replace("}", ", stiffness_uncertainty: 10 %}")
    text = arch(section, more="sweep: {length: [190 mm, 240 mm]}\n")
    ran = run("harness", written(tmp_path, text), "--out", tmp_path / "out", "--no-figures")
    assert ran.status == DONE
    (force,) = (line for line in ran.out.splitlines() if line.startswith("  force.left "))
    assert " N      95 %: " in force
    assert "  length of the line    smallest bend radius    on the way" in ran.out
    assert ran.out.count(" mm of stiffness 150 N mm^2") == 1


@pytest.mark.slow
def test_several_files_have_folders_of_their_own(run: Run, tmp_path: Path) -> None:
    files = [written(tmp_path, arch(), name=f"{name}.yaml") for name in ("one", "other")]
    ran = run("harness", *files, "--out", tmp_path / "out", "--no-figures")
    assert ran.status == DONE
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"one", "other"}


@pytest.mark.slow
def test_a_line_that_cannot_follow_is_a_failure(run: Run, tmp_path: Path) -> None:
    file, out = written(tmp_path, NO_WAY % STIFFNESS), tmp_path / "out"
    ran = run("harness", file, "--out", out)
    assert ran.status == SOME_FAILED
    assert ran.out.startswith("line: failed; 100 mm of stiffness 150 N mm^2, ")
    assert "earlier results stay" in ran.out
    assert ran.err.startswith(f"labpipe harness: {file}: ")
    assert ": step " in ran.err
    assert [path.name for path in out.iterdir()] == ["failure.json"]


def test_bad_input_is_one_message(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for wrong, said in (
        (arch().replace("180 mm", "280 mm"), "(boundaries.1): expected at most the 200 mm that "),
        (arch().replace("200 mm", "200"), "line.length): expected a quantity with a unit such as"),
        (arch("{wire: A22}"), "line.section.wire: expected a wire of "),
        (
            arch(STIFFNESS.replace("150 N", "0 N")),
            "expected a quantity with a unit such as N*mm",
        ),
        (arch(STIFFNESS.replace("largest_curvature: 80 1/m, ", "")), "A law needs a range"),
    ):
        ran = run("harness", written(tmp_path, wrong), "--out", out)
        assert ran.status == BAD_INPUT
        assert said in ran.err
        assert "Traceback" not in ran.err
    assert not out.exists()
    assert run("harness", tmp_path / "none.yaml").status == BAD_INPUT
