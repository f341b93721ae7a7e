"""Decisions that a page saved, taken into those of a campaign."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from labpipe.campaign.decisions import Decision, add_decisions, read_decisions
from labpipe.campaign.reporting import report_tests
from labpipe.campaign.saved_decisions import take_in, take_in_file
from labpipe.errors import UsageError
from tests.builders.pulled_campaigns import WHEN, decision_on, make_pulls
from tests.builders.small_tests import Run


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_pulls(tmp_path_factory.mktemp("done"))


@pytest.fixture
def processed(done: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "lab" / "processed" / done.name
    shutil.copytree(done, folder)
    return folder


def saved(path: Path, *decisions: Decision, campaign: str = "c") -> Path:
    entries = [{key: value for key, value in asdict(each).items() if value} for each in decisions]
    path.write_text(json.dumps({"schema": 1, "campaign": campaign, "decisions": entries}), "utf-8")
    return path


def test_only_what_is_new_and_counts_is_added(processed: Path, tmp_path: Path) -> None:
    mine, accepted = decision_on(processed, "T-1"), decision_on(processed, "T-2", "accept")
    add_decisions(processed, "c", [mine])
    other = replace(mine, run="0" * 64)
    stray = replace(mine, test="../c/T-1")
    file = saved(tmp_path / "decisions (1).json", mine, accepted, accepted, other, stray)
    taken, faults = take_in_file(processed, "c", file)
    assert taken.added == [accepted]
    assert taken.known == 1
    assert [(each.test, why.split(":")[0]) for each, why in taken.left] == [
        ("T-1", "it was made on another key"),
        ("../c/T-1", "there is no such test"),
    ]
    assert faults == ()
    assert read_decisions(processed).decisions == (mine, accepted)
    assert take_in_file(processed, "c", file)[0].added == []


def test_a_page_saves_and_the_next_report_leaves_out(
    run: Run, processed: Path, tmp_path: Path
) -> None:
    file = saved(tmp_path / "decisions.json", decision_on(processed, "T-2"))
    ran = run("campaign", "decide", processed, "--from", file)
    assert ran.status == 0
    assert ran.out.splitlines() == [
        f"T-2: reject: slipped <b>twice</b> (A. Tester, {WHEN})",
        "1 decision taken in, 0 known before",
    ]
    campaign = report_tests([processed]).campaign
    assert [each.test for group in campaign.groups for each in group.samples] == ["T-1", "T-3"]
    assert list(campaign.rejected.values()) == [f"slipped <b>twice</b> (A. Tester, {WHEN})"]


def test_a_test_below_a_nearer_file_is_decided_on_there(processed: Path) -> None:
    inner = processed / "inner"
    inner.mkdir()
    (processed / "T-3").rename(inner / "T-3")
    add_decisions(inner, "c/inner", [])
    said = decision_on(processed, "inner/T-3")
    assert take_in(processed, "c", [said]).added == [said]
    assert read_decisions(inner).decisions == (replace(said, test="T-3"),)
    assert not (processed / "decisions.json").exists()
    later = replace(said, test="T-3", when="2026-03-11")  # as the page names it from now on
    assert take_in(processed, "c", [said, later]).known == 1
    assert len(read_decisions(inner).decisions) == 2


def test_files_that_cannot_be_taken_in(run: Run, processed: Path, tmp_path: Path) -> None:
    file = tmp_path / "saved.json"
    with pytest.raises(
        UsageError, match="expected a file that a page saved, found nothing of that name"
    ):
        take_in_file(processed, "c", file)
    file.write_text("{", "utf-8")
    with pytest.raises(UsageError, match="line 1, column 2: expected decisions in JSON"):
        take_in_file(processed, "c", file)
    own = saved(processed / "decisions.json", decision_on(processed, "T-1"))
    with pytest.raises(UsageError, match=r"found the campaign's own\. What stands in it counts"):
        take_in_file(processed, "c", own)
    saved(file, decision_on(processed, "T-2"), campaign="other")
    ran = run("campaign", "decide", processed, "--from", file)
    assert "campaign: expected decisions of 'c', found those of 'other'" in ran.err
    assert "1 decision taken in" in ran.out
    ran = run("campaign", "decide", processed, "T-2", "accept", "--from", file)
    assert "--from: expected nothing but the folder beside it, found T-2" in ran.err
    ran = run("campaign", "decide", processed)
    assert "expected a test and accept or reject, found none. Or name a file that a page" in ran.err


def test_a_result_that_cannot_be_read_is_said(processed: Path) -> None:
    said = decision_on(processed, "T-1")
    (processed / "T-1" / "result.h5").write_bytes(b"nothing")
    ((left, why),) = take_in(processed, "c", [said]).left
    assert left == said
    assert "result.h5" in why
