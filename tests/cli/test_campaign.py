from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import openpyxl
import pytest

from labpipe.cli import BAD_INPUT, DONE
from tests.builders.kept_campaigns import KeptCampaign
from tests.builders.pulls import broken, pull
from tests.builders.small_tests import Run, runner
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return runner(capsys)


@pytest.fixture
def kept(tmp_path: Path) -> KeptCampaign:
    kept = KeptCampaign(tmp_path)
    for name, export in (("T1", "62.5"), ("T2", "doubt"), ("T3", "fail unreadable_export")):
        kept.add(name, export)
    kept.run()
    return kept


@pytest.mark.parametrize("action", ["run", "status", "query", "rebuild"])
def test_a_folder_that_is_not_there(run: Run, action: str) -> None:
    ran = run("campaign", action, "nowhere")
    assert ran.status == BAD_INPUT
    assert ran.err.startswith(
        "labpipe campaign: nowhere: expected the folder of a campaign, found nothing of that name."
    )


@pytest.mark.slow
def test_real_tests_from_run_to_query(run: Run, tmp_path: Path) -> None:
    """Two pulls, of which one lacks its export: processed once, and again when it is there."""
    labs = [TensileLab(tmp_path, name) for name in ("P-1", "P-2")]
    for seed, lab in enumerate(labs):
        travel, force = pull(slack=0.001, seed=seed)
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    missing = labs[1].export
    export = missing.read_bytes()
    missing.unlink()
    raw = labs[0].raw.parent
    ran = run("campaign", "run", raw, "--no-figures", "--jobs", "1")
    assert ran.status == BAD_INPUT
    assert "processed 2 of 2" in ran.out
    assert "failed  P-2  missing_export: " in ran.out
    missing.write_bytes(export)
    ran = run("campaign", "run", raw, "--no-figures", "--jobs", "1")
    assert ran.status in {DONE, 1}
    assert "1/1 P-2: " in ran.err
    assert "processed 1 of 2" in ran.out
    assert "processed 0 of 2" in run("campaign", "run", raw).out
    shown = run("campaign", "query", raw, "--where", "name = 'peak_force.1'", "--out", "json")
    assert [row["test"] for row in json.loads(shown.out)] == ["P-1", "P-2"]
    assert "2 rows" in shown.err
    said = run("campaign", "rebuild", labs[0].processed.parent).out
    assert said.startswith("c: ")


def test_status_lists_what_needs_a_look(run: Run, kept: KeptCampaign) -> None:
    (kept.raw / "photo.jpg").write_text("", "utf-8")
    run("campaign", "decide", kept.raw, "T2", "reject", "--because", "slipped", "--by", "A. Tester")
    (kept.raw / "T1" / "frame.csv").write_text("63", "utf-8")
    kept.add("T4")
    ran = run("campaign", "status", kept.raw)
    assert ran.status == BAD_INPUT  # one failed
    lines = ran.out.splitlines()
    assert lines[0].startswith("C: 1 pending, 1 failed, 1 stale, 1 rejected  ->  ")
    assert "  T3  unreadable_export: a unreadable_export of an export" in lines
    assert "  T1  export changed (frame.csv)" in lines
    assert any(line.startswith("  T2  slipped (A. Tester, 20") for line in lines)
    assert lines[-2:] == ["unknown files (1)", "  photo.jpg"]


def test_status_as_json(run: Run, kept: KeptCampaign) -> None:
    said = json.loads(run("campaign", "status", kept.processed, "--json").out)
    assert said["counts"] == {
        "pending": 0, "running": 0, "ok": 1, "doubtful": 1, "failed": 1, "stale": 0, "rejected": 0,
    }  # fmt: skip
    assert said["tests"]["T3"]["code"] == "unreadable_export"
    assert set(said["files"]) == {"used", "waiting", "failed", "unknown"}
    assert said["decisions_not_applied"] == []


def test_query_into_files(run: Run, kept: KeptCampaign, tmp_path: Path) -> None:
    ran = run("campaign", "query", kept.raw, "--out", "xlsx")
    assert ran.status == BAD_INPUT
    assert "--out xlsx: expected a file to write, found none. Add --file results.xlsx." in ran.err
    for form in ("csv", "xlsx", "json", "table"):
        file = tmp_path / f"out.{form}"
        assert run("campaign", "query", kept.raw, "--out", form, "--file", file).status == DONE
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["test"] for row in rows] == ["T1", "T2", "T3"]
    assert openpyxl.load_workbook(tmp_path / "out.xlsx")["results"].max_row == 4
    assert len(json.loads((tmp_path / "out.json").read_text("utf-8"))) == 3
    shown = run("campaign", "query", kept.raw, "--out", "csv").out
    assert list(csv.DictReader(io.StringIO(shown))) == rows


def test_a_condition_that_is_none(run: Run, kept: KeptCampaign) -> None:
    ran = run("campaign", "query", kept.raw, "--where", "forse > 1")
    assert ran.status == BAD_INPUT
    assert "--where, 'forse > 1': expected a condition in SQL, found no such column" in ran.err


def test_decide_and_a_decision_that_does_not_count(run: Run, kept: KeptCampaign) -> None:
    command = ("campaign", "decide", kept.raw, "T1", "reject", "--by", "A. Tester", "--because")
    assert run(*command, " ").status == BAD_INPUT
    assert run(*command, "slipped").out == "T1: rejected\n"
    (kept.raw / "T1" / "frame.csv").write_text("63", "utf-8")
    kept.run()
    out = run("campaign", "status", kept.raw).out
    assert "decisions that do not count (1)" in out
    assert "it was made on another key" in out


@pytest.mark.slow
def test_replay_clears_failures_and_runs(run: Run, kept: KeptCampaign) -> None:
    ran = run("campaign", "replay", kept.raw, "--failed", "disk_full", "--no-figures")
    assert ran.status == BAD_INPUT
    assert "expected failures of the code 'disk_full', found unreadable_export." in ran.err
    ran = run("campaign", "replay", kept.raw, "--failed", "--no-figures", "--jobs", "1")
    assert "1 failures cleared" in ran.err
    assert "1/1 T3: failed" in ran.err  # the export is nothing that can be read


def test_where_tests_can_be_processed(run: Run, kept: KeptCampaign) -> None:
    ran = run("campaign", "run", kept.raw, "--executor", "cloud")
    assert ran.status == BAD_INPUT
    assert "'cloud'" in ran.err
