from __future__ import annotations

import pytest

from tests.builders.small_tests import Lab, Run


def test_table_and_progress(run: Run, lab: Lab) -> None:
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 0
    assert ran.err == "1/1 T1\n"
    heading, first, *rest = ran.out.splitlines()
    assert heading == f"T1  (wire-cantilever): 15 ok  ->  {lab.processed}"
    assert first.split()[:1] == ["clock_offset"]
    assert first.split()[2:4] == ["s", "95"]
    assert len(rest) == 14
    assert not (lab.processed / "figures").exists()


def test_failed_results_are_status_1_and_listed(run: Run, lab: Lab) -> None:
    lab.override("branches.min_stroke", "500 mm")
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 1
    assert "! peak_force.1 " in ran.out
    assert "failed: no_motion: the motion spans " in ran.out


def test_doubtful_results_are_status_0_and_told(run: Run, lab: Lab) -> None:
    lab.override("markers.along", "all")
    lab.override("steps.specimen-frame.max_out_of_plane", "1 um")
    ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 0
    assert "? peak_displacement.1 " in ran.out
    assert "doubtful: out_of_plane: " in ran.out
    assert "warning: markers leave their plane by " in ran.out


def test_out(run: Run, lab: Lab) -> None:
    assert run("process", lab.raw, "--no-figures", "--out", lab.home / "x").status == 0
    assert sorted(path.name for path in (lab.home / "x" / "T1").iterdir()) == [
        "result.h5",
        "summary.json",
    ]
    assert not lab.processed.exists()


def test_progress_counts_all_tests(run: Run, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    (lab.raw / "force.mat").unlink()
    ran = run("process", lab.raw, lab.raw / "test.yaml", lab.raw.parent)
    assert ran.err.startswith("1/1 T1\n")
