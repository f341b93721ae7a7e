from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.campaign.reporting import Reported
from labpipe.cli.report import status_of
from labpipe.records.group import Campaign
from tests.builders.campaigns import build_group, six_samples, troubled_samples
from tests.builders.pulls import broken, pull
from tests.builders.small_tests import Run
from tests.builders.tensile_tests import TensileLab, write_pull


def reported(*groups: object, **more: object) -> Reported:
    campaign = replace(Campaign("Synthetic", groups), **more)  # type: ignore[arg-type]
    return Reported(Path("report"), campaign, (Path("report/report.html"),))


def test_status_0_when_all_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(reported(build_group("tube", six_samples()))) == 0
    assert capsys.readouterr().err == ""


def test_status_1_when_a_result_failed() -> None:
    assert status_of(reported(build_group("tube", troubled_samples()))) == 1


def test_status_2_when_a_test_was_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    left_out = {"a/result.h5": "a/result.h5: expected this, found that. Do so."}
    assert status_of(reported(build_group("tube", troubled_samples()), left_out=left_out)) == 2
    assert capsys.readouterr().err == (
        "labpipe report: left out: a/result.h5: expected this, found that. Do so.\n"
    )


@pytest.fixture
def processed(tmp_path: Path, run: Run) -> Path:
    for seed, name in enumerate(("P-1", "P-2")):
        lab = TensileLab(tmp_path, name)
        travel, force = pull(slack=0.001, seed=seed)
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    assert run("process", tmp_path / "raw", "--out", tmp_path / "out", "--no-figures").status == 0
    return tmp_path / "out"


@pytest.mark.slow
def test_options_and_what_is_said(run: Run, processed: Path, tmp_path: Path) -> None:
    goal = tmp_path / "told"
    ran = run("report", processed / "P-1", processed, "--out", goal, "--title", "Two pulls")
    assert (ran.status, ran.err) == (0, "")
    heading, first, *_ = ran.out.splitlines()
    assert heading == "synthetic  (tensile): 2 samples from 1 spool"
    assert first.split()[0] == "peak_force.1"
    assert first.split()[2] == "N"
    assert "95 %:" in first
    assert ran.out.splitlines()[-1].endswith("report.html")
    assert "<title>Two pulls" in (goal / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_file_where_the_folder_should_be(run: Run, processed: Path, tmp_path: Path) -> None:
    (tmp_path / "told").write_text("mine")
    ran = run("report", processed, "--out", tmp_path / "told")
    assert (ran.status, ran.out) == (2, "")
    assert ran.err == (
        f"labpipe report: {tmp_path / 'told'}: expected a folder to write in, found a file in its"
        " place. Choose another folder.\n"
    )
    assert (tmp_path / "told").read_text() == "mine"


def test_no_path(run: Run) -> None:
    ran = run("report")
    assert ran.status == 2
    assert "PATH" in ran.err


@pytest.mark.slow
def test_groups_by_a_field(run: Run, processed: Path, tmp_path: Path) -> None:
    goal = tmp_path / "told"
    ran = run("report", processed, "--out", goal, "--by", "spool, length")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.splitlines()[0].startswith("spool 1, length 75 mm  (tensile): 2 samples")


@pytest.mark.slow
def test_a_field_that_no_sheet_has(run: Run, processed: Path) -> None:
    ran = run("report", processed, "--by", "lenth")
    assert (ran.status, ran.out) == (2, "")
    assert ran.err == (
        "labpipe report: --by: expected fields of these test sheets, which are type, spool, length,"
        " found 'lenth'. Write length, or another of them.\n"
    )


@pytest.mark.slow
def test_letterhead_figures_and_pages_as_they_are_asked_for(
    run: Run, processed: Path, tmp_path: Path
) -> None:
    goal = tmp_path / "told"
    words = ("--lab", "Bench <3>", "--customer", "Somebody", "--order", "42")
    ran = run("report", processed, "--out", goal, *words, "--pages", "--figures", "svg,pdf")
    assert (ran.status, ran.err) == (0, "")
    page = (goal / "report.html").read_text(encoding="utf-8")
    assert "<dt>Lab</dt><dd>Bench &lt;3&gt;</dd>" in page
    assert "<dt>Order</dt><dd>42</dd>" in page
    assert sorted(each.name for each in (goal / "tests").iterdir()) == ["P-1.html", "P-2.html"]
    assert {each.suffix for each in (goal / "figures").iterdir()} == {".svg", ".pdf"}


@pytest.mark.slow
def test_a_logo_that_is_no_picture_is_one_message(run: Run, processed: Path) -> None:
    sheet = next(processed.rglob("summary.json"))
    ran = run("report", processed, "--logo", sheet)
    assert ran.status == 2
    assert "expected a picture, PNG or JPEG, of at most 200 kB" in ran.err
    assert not (processed / "report").exists()


@pytest.mark.slow
def test_a_format_that_figures_do_not_have(run: Run, processed: Path) -> None:
    ran = run("report", processed, "--figures", "svg,jpg")
    assert ran.status == 2
    assert "--figures: expected some of svg, png, pdf, found 'jpg'. Write " in ran.err
