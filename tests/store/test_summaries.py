"""Summaries and failures as JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.records.curve import Interval
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.result import InputFile, Result, Specimen
from labpipe.store.replace import lock
from labpipe.store.summaries import (
    FAILURE_FILE,
    FailedTest,
    build_summary,
    check_summary,
    compute_entry_seal,
    write_failure,
    write_summary,
)
from tests.approved import Approve
from tests.store.builders_result import build_result


def test_summary_is_the_documented_one(tmp_path: Path, approved: Approve) -> None:
    """Without numbers that JSON cannot say."""
    wires = (BundleWire("B1", 1, 0.0011), BundleWire("B2", 1))
    places = ((0.0, 0.0), (0.002, 0.0))
    bundle = Bundle(wires, positions=places, conduit="tube", conduit_bore=0.0107)
    specimen = Specimen("CWB", "s1", "1", {"span": 0.1524}, bundle, {"cured": "24 h"})
    result = replace(build_result(half_cycle=0.5), specimen=specimen)
    infinite = Result("energy.1", float("nan"), "J", Interval(-float("inf"), float("inf")))
    result = replace(result, results=(*result.results, infinite))
    write_summary(result, tmp_path / "summary.json")
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"), parse_constant=pytest.fail)
    assert summary == json.loads(json.dumps(build_summary(result)))
    assert summary["run"] == result.run
    seals = [entry.pop("seal") for entry in summary["results"]]
    assert seals == [entry_result.seal for entry_result in result.results]
    assert seals == [compute_entry_seal(entry) for entry in summary["results"]]
    for share in summary["results"][0]["budget"]:
        share["share"] = round(share["share"], 9)
    approved(json.dumps(summary | {"run": "", "labpipe": "", "made_of": {}}, indent=1))


FAILURE = {
    "test": "T\udce9",  # a name that no UTF-8 can say
    "code": "time_limit",
    "reason": "a \u20ac",
    "run": "0a",
    "inputs": [{"role": "force", "file": "f", "sha256": "1b"}],
    "made_of": {},
}
FAILED = FailedTest("T\udce9", "time_limit", "a \u20ac", "0a", (InputFile("force", "f", "1b", 7),))


def test_the_last_failure_counts_but_for_one_while_another_process_writes(tmp_path: Path) -> None:
    folder = tmp_path / "p" / "T"
    write_failure(FailedTest("T", "in_time", ""), folder)
    write_failure(FAILED, folder)
    with lock(folder), pytest.raises(StoreError, match="another labpipe process"):
        write_failure(FailedTest("T", "in_time", ""), folder)
    assert [file.name for file in folder.iterdir()] == [FAILURE_FILE]
    failure = json.loads((folder / FAILURE_FILE).read_text("utf-8"))
    assert set(failure) == {"schema", "labpipe", *FAILURE}
    assert {key: failure[key] for key in FAILURE} == FAILURE


@pytest.mark.parametrize(
    ("key", "other"), [("value", 0.63), ("upper", 0.7), ("status", "doubtful")]
)
def test_numbers_that_were_changed_are_refused(tmp_path: Path, key: str, other: object) -> None:
    result, file = build_result(half_cycle=0.5), tmp_path / "summary.json"
    check_summary(result, file)  # there is none
    write_summary(result, file)
    check_summary(result, file)
    summary = json.loads(file.read_text(encoding="utf-8"))
    entry = summary["results"][0]

    def assert_refused(match: str) -> None:
        file.write_text(json.dumps(summary), encoding="utf-8")
        with pytest.raises(StoreError, match=match):
            check_summary(result, file)

    entry[key] = other
    assert_refused(r"summary\.json.*peak_force\.1.*Process the test again")
    entry["seal"] = compute_entry_seal(entry)
    assert_refused("the numbers of result")
    del entry["seal"]
    assert_refused(r"a damaged one \('seal'\)")
    entry["seal"], entry["value"] = "", 10**400
    assert_refused("the numbers of result")
