from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.campaign_folders import find_campaign, look_at_outcome
from labpipe.campaign.outcome_rows import StoredOutcome, plain, read_outcome_files
from labpipe.process.run import process_test
from labpipe.store.failure_file import FailedTest, write_failure
from tests.builders.kept_campaigns import KeptCampaign
from tests.builders.small_tests import Lab


@pytest.fixture
def kept(tmp_path: Path) -> KeptCampaign:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    kept.run()
    return kept


def outcome(kept: KeptCampaign) -> StoredOutcome:
    return read_outcome_files(look_at_outcome(kept.folders, "T1"))


def changed(kept: KeptCampaign, **values: Any) -> StoredOutcome:
    path = kept.processed / "T1" / "summary.json"
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | values), "utf-8")
    return outcome(kept)


def test_of_a_real_test(lab: Lab) -> None:
    made = process_test(lab.sheet, figures=False).result
    found = read_outcome_files(look_at_outcome(find_campaign(lab.raw.parent), lab.name))
    assert (found.test, found.run, found.protocol) == (made.test, made.run, made.protocol)
    assert found.specimen["length"] == 0.085
    assert found.date == str(made.date)
    assert [each.name for each in found.results] == [each.name for each in made.results]
    for mine, its in zip(found.results, made.results, strict=True):
        assert (mine.value, mine.unit, mine.status) == (its.value, its.unit, its.status)
    assert found.inputs == tuple((i.role, i.file, i.sha256) for i in made.inputs)
    assert not found.has_failed


def test_of_nothing() -> None:
    assert read_outcome_files(None) == StoredOutcome()


def test_a_failure_beside_earlier_results(kept: KeptCampaign) -> None:
    before = outcome(kept)
    failure = FailedTest("T1", "process_died", "it was ended", "f" * 64, made_of={"sheet": "5e"})
    write_failure(failure, kept.processed / "T1")
    found = outcome(kept)
    assert (found.has_failed, found.code, found.reason) == (True, "process_died", "it was ended")
    assert (found.run, found.failed_run, found.attempt) == (before.run, "f" * 64, "f" * 64)
    assert (found.sheet, found.protocol_text, found.inputs) == ("5e", "", ())
    assert found.results == before.results


def test_a_failure_of_the_key_that_the_results_have_is_over(kept: KeptCampaign) -> None:
    before = outcome(kept)
    write_failure(
        FailedTest("T1", "process_died", "it was ended", before.run), kept.processed / "T1"
    )
    assert outcome(kept) == before


@pytest.mark.parametrize("text", ["", "[]", '{"made_of": 1, "inputs": [1]}', '{"inputs": {}}'])
def test_a_failure_that_cannot_be_read_is_one(kept: KeptCampaign, text: str) -> None:
    (kept.processed / "T1" / "failure.json").write_text(text, "utf-8")
    found = outcome(kept)
    assert (found.has_failed, found.code) == (True, "unknown")


@pytest.mark.parametrize(
    "values",
    [
        {"results": [{"name": "x"}]},
        {"results": 5},
        {"specimen": None},
        {"inputs": [1]},
        {"results": [{"name": "x", "value": "many"}]},
    ],
)
def test_a_summary_that_lacks_something(kept: KeptCampaign, values: dict[str, Any]) -> None:
    found = changed(kept, **values)
    assert found.unreadable.startswith("summary.json lacks something (")
    assert (found.run, found.results) == ("", ())


def test_half_characters_are_written_out(kept: KeptCampaign) -> None:
    assert plain("a\ud800b ü") == "a\\ud800b ü"
    found = changed(kept, test="a\ud800", operator="\udfff")
    assert (found.test, found.operator) == ("a\\ud800", "\\udfff")


def test_a_summary_from_before_there_was_made_of(kept: KeptCampaign) -> None:
    assert changed(kept, made_of=None).sheet == ""
