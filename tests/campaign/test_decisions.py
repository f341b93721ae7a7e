"""Decisions on tests: what counts, what is carried over, what a page saved."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import pytest

from labpipe.campaign.catalog import OK, REJECTED, STALE
from labpipe.campaign.decisions import (
    Decision,
    add_decisions,
    find_decision_folder,
    import_decision_file,
    import_decisions,
    read_decisions,
    read_decisions_by_file,
)
from labpipe.campaign.running import read_overview, rebuild_catalog, record_decision
from labpipe.errors import StoreError, UsageError
from tests.builders.lab_campaigns import LabCampaign, content_of
from tests.builders.pulled_campaigns import decision_on, make_pulls
from tests.builders.small_tests import Run

REJECT = Decision("", "", "reject", "slipped in the grip", "A. Tester")
ACCEPT = Decision("", "", "accept", "looks right", "A. Tester")


@pytest.fixture
def campaign(tmp_path: Path) -> LabCampaign:
    campaign = LabCampaign(tmp_path)
    campaign.add("T1")
    campaign.add("T2", "doubt")
    campaign.run()
    return campaign


def written(campaign: LabCampaign) -> dict[str, Any]:
    text = (campaign.processed / "decisions.json").read_text("utf-8")
    return cast("dict[str, Any]", json.loads(text))


NASTY = "<script>alert(1)</script> \x1b[31m =cmd() \u202e ü \\ ' \" \n\t"


@pytest.mark.parametrize("because", ["slipped in the grip", NASTY])
def test_rejection_states_person_reason_and_time(campaign: LabCampaign, because: str) -> None:
    row = record_decision(campaign.folders, "T1", replace(REJECT, because=because))
    assert (row.state, row.why, row.decided_by) == (REJECTED, because, "A. Tester")
    assert row.decided.endswith("+00:00")
    (entry,) = written(campaign)["decisions"]
    assert entry == {
        **{"test": "T1", "run": row.run, "decision": "reject"},
        **{"because": because, "by": "A. Tester", "when": row.decided},
    }
    campaign.run()
    assert campaign.stand_in.processed == []
    content = content_of(campaign)
    rebuild_catalog(campaign.folders)
    assert content_of(campaign) == content


def test_changed_rejected_test_needs_a_new_decision(campaign: LabCampaign) -> None:
    record_decision(campaign.folders, "T1", REJECT)
    export = campaign.raw / "T1" / "frame.csv"
    export.write_text("99", "utf-8")
    assert read_overview(campaign.folders).rows["T1"].state == STALE
    campaign.run()
    overview = read_overview(campaign.folders)
    assert overview.rows["T1"].state == REJECTED
    assert "slipped in the grip (needs a new decision: " in overview.rows["T1"].why
    ((decision, why),) = overview.unapplied_decisions
    assert decision.because == "slipped in the grip"
    assert why.startswith("exports, sheet, protocol or labpipe changed")
    record_decision(campaign.folders, "T1", replace(REJECT, decision="accept"))
    assert read_overview(campaign.folders).rows["T1"].state == OK
    export.write_text("62.5", "utf-8")
    campaign.run()
    assert read_overview(campaign.folders).rows["T1"].state == REJECTED


def test_decision_on_unknown_or_unprocessed_test_is_refused(campaign: LabCampaign) -> None:
    with pytest.raises(
        UsageError, match=r"T9: expected a test of 'C', found none with that name\."
    ):
        record_decision(campaign.folders, "T9", REJECT)
    campaign.add("new")
    with pytest.raises(UsageError, match="expected a processed test, found one that is not"):
        record_decision(campaign.folders, "new", REJECT)


def test_two_tests_of_one_name_are_reported(campaign: LabCampaign) -> None:
    sheet = campaign.raw / "T2" / "test.yaml"
    sheet.write_text(sheet.read_text("utf-8").replace("T2", "t1"), "utf-8")
    overview = campaign.run().overview
    assert overview.has_bad_input
    assert "expected one test for each name, found a second for 't1'" in overview.notes[0]


BROKEN = {
    "": "line 1, column 1: expected decisions in JSON, found Expecting value",
    '{"schema": 1, "decisions": [}': "line 1, column 29",
    "[]": "found JSON without a list 'decisions'",
    '{"schema": 1, "decisions": {}}': "found JSON without a list 'decisions'",
    '{"schema": 2, "decisions": []}': "schema: expected decisions in JSON, found 2; this",
    "[" * 100_000: "expected decisions in JSON, found text that is not JSON",
}


@pytest.mark.parametrize("text", BROKEN, ids=range(len(BROKEN)))
def test_unreadable_decisions_are_reported_and_kept(campaign: LabCampaign, text: str) -> None:
    path = campaign.processed / "decisions.json"
    path.write_text(text, "utf-8")
    overview = read_overview(campaign.folders)
    assert overview.has_bad_input
    assert BROKEN[text] in overview.notes[0]
    with pytest.raises(UsageError, match="Repair the file, or move it away and decide again"):
        record_decision(campaign.folders, "T1", REJECT)
    assert path.read_text("utf-8") == text
    results = [campaign.processed / "T1" / "result.h5"]
    with pytest.raises(StoreError, match="expected decisions in JSON"):
        read_decisions_by_file(results)
    path.unlink()
    path.symlink_to(path.name)
    with pytest.raises(StoreError, match="found a folder, a pipe or a broken link"):
        read_decisions_by_file(results)


def test_invalid_decisions_are_reported_and_stay_in_the_file(campaign: LabCampaign) -> None:
    record_decision(campaign.folders, "T1", REJECT)
    path = campaign.processed / "decisions.json"
    document = written(campaign)
    (stored,) = document["decisions"]
    others = [stored | {"decision": "perhaps"}, stored | {"decision": {"a": 1}, "by": 5}]
    faulty = ["a word", {"test": "T1"}, *others, *98 * ["a word"]]
    path.write_text(json.dumps(document | {"remark": "by hand", "decisions": [
        *faulty, stored
    ]}), "utf-8-sig")  # fmt: skip
    overview = read_overview(campaign.folders)
    assert overview.rows["T1"].state == REJECTED
    found = [note.partition(": expected ")[2].partition(". ")[0] for note in overview.notes]
    assert found[-1] == "valid decisions, found 2 more faulty ones"
    assert found[:4] == [
        "a decision, found 'a word'",
        "test, run, decision, because and by, found missing or empty: run, decision, because, by",
        "accept or reject, found 'perhaps'",
        "text, found another value of decision, by",
    ]
    record_decision(campaign.folders, "T1", ACCEPT)
    decided = written(campaign)
    assert decided["remark"] == "by hand"
    assert decided["decisions"][:-2] == faulty


@pytest.fixture(scope="module")
def pulls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_pulls(tmp_path_factory.mktemp("done"))


@pytest.fixture
def processed(pulls: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "lab" / "processed" / pulls.name
    shutil.copytree(pulls, folder)
    return folder


def saved(path: Path, *decisions: Decision, campaign: str = "c") -> Path:
    entries = [
        {key: value for key, value in asdict(decision).items() if value} for decision in decisions
    ]
    path.write_text(json.dumps({"schema": 1, "campaign": campaign, "decisions": entries}), "utf-8")
    return path


def test_import_adds_new_applicable_decisions_only(processed: Path, tmp_path: Path) -> None:
    stored, accepted = decision_on(processed, "T-1"), decision_on(processed, "T-2", "accept")
    add_decisions(processed, "c", [stored])
    other_key = replace(stored, run="0" * 64)
    no_test = replace(stored, test="../c/T-1")
    file = saved(tmp_path / "decisions (1).json", stored, accepted, accepted, other_key, no_test)
    imported = import_decision_file(processed, "c", file)
    assert imported.added == [accepted]
    assert imported.n_stored_before == 1
    assert [(decision.test, why.split(":")[0]) for decision, why in imported.not_imported] == [
        ("T-1", "exports, sheet, protocol or labpipe changed since the decision"),
        ("../c/T-1", "there is no such test"),
    ]
    assert imported.faults == ()
    assert read_decisions(processed).decisions == (stored, accepted)
    assert import_decision_file(processed, "c", file).added == []


def test_test_in_a_linked_folder_has_the_label_of_the_link(tmp_path: Path) -> None:
    (tmp_path / "away").mkdir()
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "T").symlink_to(tmp_path / "away")
    file = tmp_path / "c" / "T" / "result.h5"
    assert find_decision_folder(file, tmp_path / "c") == ((tmp_path / "c").resolve(), "T")


def test_import_uses_the_nearest_decision_file(processed: Path) -> None:
    inner = processed / "inner"
    inner.mkdir()
    (processed / "T-3").rename(inner / "T-3")
    add_decisions(inner, "c/inner", [])
    decision = decision_on(processed, "inner/T-3")
    assert import_decisions(processed, "c", [decision]).added == [decision]
    assert read_decisions(inner).decisions == (replace(decision, test="T-3"),)
    assert not (processed / "decisions.json").exists()
    later = replace(decision, test="T-3", when="2026-03-11")  # as the page names it from now on
    assert import_decisions(processed, "c", [decision, later]).n_stored_before == 1
    assert len(read_decisions(inner).decisions) == 2


def test_files_that_cannot_be_imported(run: Run, processed: Path, tmp_path: Path) -> None:
    file, broken = tmp_path / "saved.json", tmp_path / "broken.json"
    broken.write_text("{", "utf-8")
    own = saved(processed / "decisions.json", decision_on(processed, "T-1"))
    for bad_file, message in (
        (file, "expected a file saved by a report page, found no such file"),
        (broken, "line 1, column 2: expected decisions in JSON"),
        (own, r"found the file of decisions of the campaign itself\. Its decisions are applied"),
    ):
        with pytest.raises(UsageError, match=message):
            import_decision_file(processed, "c", bad_file)
    saved(file, decision_on(processed, "T-2"), campaign="other")
    ran = run("campaign", "decide", processed, "--from", file)
    assert "campaign: expected decisions of 'c', found those of 'other'" in ran.err
    assert "1 decision imported" in ran.out
    ran = run("campaign", "decide", processed, "T-2", "accept", "--from", file)
    assert (
        "--from: expected either a test or a file of decisions, found both, with the test 'T-2'"
        in ran.err
    )
    ran = run("campaign", "decide", processed)
    assert "expected a test and accept or reject, found none. Name both, or import" in ran.err
