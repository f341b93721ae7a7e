"""``labpipe campaign``, ``report``, ``demo`` and ``harness``, as typed."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import openpyxl
import pytest

from labpipe.campaign.reporting import WrittenReport
from labpipe.cli import EXIT_ERROR, EXIT_OK, EXIT_SOME_FAILED
from labpipe.cli.demo import CAMPAIGNS, DEMO_TESTS, WIRE_SECTION
from labpipe.cli.report import print_left_out_tests
from labpipe.records.group import Campaign
from labpipe.virtual_lab import Campaign as VirtualCampaign
from tests.approved import Approve
from tests.builders.campaigns import build_group, six_samples, troubled_samples
from tests.builders.harness_files import EXAMPLES, STIFFNESS, arch, pushed, written
from tests.builders.lab_campaigns import LabCampaign
from tests.builders.pulls import broken, pull
from tests.builders.small_pulls import small_pulls
from tests.builders.small_tests import Run
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def campaign(tmp_path: Path) -> LabCampaign:
    campaign = LabCampaign(tmp_path)
    for name, export in (("T1", "62.5"), ("T2", "doubt"), ("T3", "fail unreadable_export")):
        campaign.add(name, export)
    campaign.run()
    return campaign


@pytest.mark.slow
def test_real_tests_from_run_to_query(run: Run, tmp_path: Path) -> None:
    """Two pulls, of which one lacks its export: processed once, and again when it is there."""
    labs = small_pulls(tmp_path, 2)
    missing = labs[1].export
    export = missing.read_bytes()
    missing.unlink()
    raw = labs[0].raw.parent
    command = ("campaign", "run", raw, "--no-figures", "--jobs", "1")
    ran = run(*command)
    assert ran.status == EXIT_ERROR
    assert "processed 2 of 2" in ran.out
    assert "failed (1)\n  S-0001  missing_export: " in ran.out
    missing.write_bytes(export)
    ran = run(*command)
    assert ran.status in {EXIT_OK, EXIT_SOME_FAILED}
    assert "1/1 S-0001: " in ran.err
    assert "processed 1 of 2" in ran.out
    assert "processed 0 of 2" in run("campaign", "run", raw).out
    shown = run("campaign", "query", raw, "--where", "name = 'peak_force.1'", "--out", "json")
    assert [row["test"] for row in json.loads(shown.out)] == ["S-0000", "S-0001"]
    assert "2 rows" in shown.err
    assert run("campaign", "rebuild", labs[0].processed.parent).out.startswith("c: ")


def test_decide_and_status(run: Run, campaign: LabCampaign) -> None:
    decide = ("campaign", "decide", campaign.raw)
    rejected = ("reject", "--by", "A. Tester", "--because")
    assert run(*decide, "T1", *rejected, " ").status == EXIT_ERROR
    assert run(*decide, "T1", *rejected, "slipped").out == "T1: rejected\n"
    (campaign.raw / "T1" / "frame.csv").write_text("63", "utf-8")
    campaign.run()
    run(*decide, "T2", *rejected, "slipped")
    (campaign.raw / "photo.jpg").write_text("", "utf-8")
    (campaign.raw / "T1" / "frame.csv").write_text("64", "utf-8")
    campaign.add("T4")
    ran = run("campaign", "status", campaign.raw)
    assert ran.status == EXIT_ERROR  # one failed
    lines = ran.out.splitlines()
    assert lines[0].startswith("C: 1 pending, 1 failed, 1 stale, 1 rejected  ->  ")
    assert "  T3  unreadable_export: a unreadable_export of an export" in lines
    assert "  T1  file changed (frame.csv)" in lines
    assert any(line.startswith("  T2  slipped (A. Tester, 20") for line in lines)
    assert "decisions not applied (1)" in lines
    assert "exports, sheet, protocol or labpipe changed" in ran.out
    assert lines[lines.index("unknown files (1)") + 1] == "  photo.jpg"


def test_query_into_files(run: Run, campaign: LabCampaign, tmp_path: Path) -> None:
    query = ("campaign", "query", campaign.raw, "--out")
    ran = run(*query, "xlsx")
    assert ran.status == EXIT_ERROR
    assert "--out xlsx: expected a file to write, found none. Add --file results.xlsx." in ran.err
    for form in ("csv", "xlsx", "json", "table"):
        assert run(*query, form, "--file", tmp_path / f"out.{form}").status == EXIT_OK
    with (tmp_path / "out.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["test"] for row in rows] == ["T1", "T2", "T3"]
    assert openpyxl.load_workbook(tmp_path / "out.xlsx")["results"].max_row == 4
    assert len(json.loads((tmp_path / "out.json").read_text("utf-8"))) == 3
    shown = run(*query, "csv").out
    assert list(csv.DictReader(io.StringIO(shown))) == rows


def reported(*groups: object, **more: object) -> WrittenReport:
    campaign = replace(Campaign("Synthetic", groups), **more)  # type: ignore[arg-type]
    return WrittenReport(Path("report"), campaign, (Path("report/report.html"),))


def pulls(home: Path) -> Path:
    """Write two pulls; gives the folder of their exports."""
    for seed, name in enumerate(("P-1", "P-2")):
        lab = TensileLab(home, name)
        travel, force = pull(slack=0.001, seed=seed)
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    return lab.raw.parent


@pytest.fixture
def processed(tmp_path: Path, run: Run) -> Path:
    command = ("process", pulls(tmp_path), "--out", tmp_path / "out", "--no-figures")
    assert run(*command).status == EXIT_OK
    return tmp_path / "out"


@pytest.mark.slow
def test_options_of_a_report(run: Run, processed: Path, tmp_path: Path) -> None:
    goal = tmp_path / "report"
    texts = ("--title", "Two pulls", "--lab", "Bench <3>", "--order", "42")
    options = (*texts, "--pages", "--figures", "svg,pdf")
    ran = run("report", processed / "P-1", processed, "--out", goal, *options)
    assert (ran.status, ran.err) == (0, "")
    heading, number, *_ = ran.out.splitlines()
    assert heading == "synthetic  (tensile): 2 samples from 1 spool"
    assert (number.split()[0], number.split()[2]) == ("peak_force.1", "N")
    assert ran.out.splitlines()[-1].endswith("report.html")
    page = (goal / "report.html").read_text(encoding="utf-8")
    assert "<title>Two pulls" in page
    assert "<dt>Lab</dt><dd>Bench &lt;3&gt;</dd>" in page
    assert "<dt>Order</dt><dd>42</dd>" in page
    assert sorted(path.name for path in (goal / "tests").iterdir()) == ["P-1.html", "P-2.html"]
    assert {path.suffix for path in (goal / "figures").iterdir()} == {".svg", ".pdf"}


@pytest.fixture
def quick_campaign(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two pulls in place of the first look of the demo."""

    def simulated(_: object, raw: Path) -> list[Path]:
        shutil.copytree(pulls(tmp_path / "pulls"), raw, dirs_exist_ok=True)
        return sorted(raw.glob("*/"))

    monkeypatch.setattr("labpipe.cli.demo.DEMO_TESTS", (None,))
    monkeypatch.setattr("labpipe.cli.demo.simulate_campaigns", simulated)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_campaign")
def test_demo_reports_a_test_of_each_kind(run: Run, tmp_path: Path) -> None:
    ran = run("demo", tmp_path, "--png", "--jobs", 1)
    assert ran.status == 0
    folder = tmp_path / "processed" / "demo" / "one-of-each"
    out = ran.out.replace(f"{tmp_path}{os.sep}", "").replace(os.sep, "/")
    first, _, second = out.partition("P-2  (tensile)")
    numbers = "failure_displacement"
    assert (numbers in first, numbers in second) == (True, False), "numbers of the first test"
    shown = out.partition("open in a browser, the report first:\n")[2].partition("\n\n")[0]
    files = [line.removeprefix("processed/demo/one-of-each/") for line in shown.split()]
    figures = [f"P-{number}/figures/stiffness-lines.svg" for number in (1, 2)]
    assert files == ["report/report.html", *figures]
    assert (folder / "P-2" / "figures" / "stiffness-lines.png").is_file()
    assert (tmp_path / out.partition("labpipe inspect ")[2].splitlines()[0]).is_file()
    page = (folder / "report" / "report.html").read_text(encoding="utf-8")
    assert "Synthetic demo campaign: one-of-each" in page
    assert not (tmp_path / "processed" / "demo" / "wires").exists()


def test_demo_has_a_test_of_each_kind() -> None:
    def kinds(campaigns: Iterable[VirtualCampaign]) -> Counter[str]:
        return Counter(test.protocol for entry in campaigns for test, _ in entry.list_scenarios())

    n_tests = kinds(DEMO_TESTS)
    assert set(n_tests) == set(kinds(x for group in CAMPAIGNS.values() for x in group))
    assert set(n_tests.values()) == {1}


def test_demo_calibrates_the_wire_of_an_example() -> None:
    texts = [path.read_text(encoding="utf-8") for path in EXAMPLES.glob("harness-*.yaml")]
    assert len(texts) == 4
    assert sum(WIRE_SECTION in text for text in texts) == 1


@pytest.mark.slow
def test_harness_prints_results_and_folder(run: Run, tmp_path: Path) -> None:
    file, out = written(tmp_path, pushed()), tmp_path / "out"
    ran = run("harness", file, "--out", out, "--no-figures")
    assert ran.status == EXIT_OK, ran
    lines = ran.out.splitlines()
    assert lines[0] == "line: 3 ok, 6 doubtful; 100 mm of A2, 12 elements, 10 steps"
    assert lines[1].startswith("? smallest_bend_radius ")
    assert any(line.startswith("? springback.gripper ") for line in lines)
    assert (
        "  allowed bend radius 8 mm (assumed: 5 times the outer diameter of 1.6 mm): kept" in lines
    )
    assert lines[-1] == f"results: {out}"
    assert not (out / "figures").exists()
    ran = run("harness", file, "--out", out, "--json", "--no-figures")
    assert json.loads(ran.out) == json.loads((out / "summary.json").read_text(encoding="utf-8"))


def test_statuses_of_a_report() -> None:
    fine, troubled = build_group("tube", six_samples()), build_group("tube", troubled_samples())
    left_out = {"a/result.h5": "a/result.h5: expected this, found that. Do so."}
    assert print_left_out_tests(reported(fine)) == 0
    assert print_left_out_tests(reported(troubled)) == 1
    assert print_left_out_tests(reported(troubled, failures=left_out)) == 2


@pytest.mark.usefixtures("campaign")
def test_bad_input(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, approved: Approve
) -> None:
    monkeypatch.chdir(tmp_path)
    place = Path("raw") / "C"
    (tmp_path / "taken").write_text("mine", "utf-8")
    harnesses = {
        "far": arch().replace("180 mm", "280 mm"),
        "bare": arch().replace("200 mm", "200"),
        "wire": arch("{wire: A22}"),
        "soft": arch(STIFFNESS.replace("150 N", "0 N")),
        "range": arch(STIFFNESS.replace("largest_curvature: 80 1/m, ", "")),
    }
    commands: list[tuple[object, ...]] = [
        ("campaign", "query", place, "--where", "forse > 1"),
        ("campaign", "query", place, "--out", "xlsx"),
        ("campaign", "replay", place, "--failed", "disk_full"),
        ("campaign", "run", place, "--executor", "cloud"),
        *(("campaign", action, "nowhere") for action in ("run", "status", "query", "rebuild")),
        ("report", "processed", "--figures", "svg,jpg"),
        ("report", "processed", "--logo", "taken"),
        ("harness", "none.yaml"),
        *(
            ("harness", written(tmp_path, text, name=f"{name}.yaml"))
            for name, text in harnesses.items()
        ),
    ]
    errors = []
    for command in commands:
        ran = run(*command)
        assert (ran.status, ran.out) == (EXIT_ERROR, ""), command
        assert "Traceback" not in ran.err
        errors.append(ran.err)
    approved(errors)
