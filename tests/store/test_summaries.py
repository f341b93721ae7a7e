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
from labpipe.store.failure_file import FAILURE_FILE, FailedTest, write_failure
from labpipe.store.replace import locked
from labpipe.store.summaries import check_summary, sealed, summary, write_summary
from tests.store.builders_result import build_result


def test_summary_is_the_documented_one(tmp_path: Path) -> None:
    result = build_result(half_cycle=0.5)
    write_summary(result, tmp_path / "summary.json")
    read = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert read == summary(result)
    assert list(read) == [
        "schema", "test", "specimen", "protocol", "labpipe", "inputs", "date", "operator",
        "instruments", "run", "made_of", "results", "quality",
    ]  # fmt: skip
    assert read["specimen"] == {"type": "A2", "spool": "A2-s1", "sample": "1", "length": 0.085}
    assert read["run"] == result.run
    assert read["inputs"][0] == {"role": "markers", "file": "take.csv", "sha256": "ab" * 32}
    assert read["results"][0] == {
        "name": "peak_force.1",
        "value": 0.62,
        "unit": "N",
        "lower": 0.59,
        "upper": 0.61,
        "level": 0.95,
        "estimate": 0.6,
        "status": "ok",
        "seal": result.results[0].seal,
        "code": "",
        "reason": "",
        "reasons": [],
        "method": "highest",
        "budget": [
            {"cause": "noise", "change": 0.003, "share": pytest.approx(0.36), "common": False},
            {
                "cause": "scale of the force",
                "change": -0.004,
                "share": pytest.approx(0.64),
                "common": True,
            },
        ],
    }
    assert [sealed(entry) for entry in read["results"]] == [
        result.seal for result in result.results
    ]
    assert read["results"][1]["lower"] is None
    assert (read["results"][1]["estimate"], read["results"][1]["budget"]) == (0.0031, [])
    assert (read["results"][2]["value"], read["results"][2]["estimate"]) == (None, None)
    assert read["results"][2]["status"] == "failed"
    assert read["results"][2]["reasons"] == [{"code": "not_reached", "message": "too short"}]
    assert read["results"][2]["code"] == "not_reached"
    assert read["results"][2]["reason"] == "not_reached: too short"
    assert (read["date"], read["operator"], read["instruments"]) == (None, "", [])
    assert read["quality"][0] == {
        "code": "marker_filled", "severity": "warning", "message": "26 frames were filled."
    }  # fmt: skip


def test_summary_of_a_bundle_with_labels() -> None:
    wires = (BundleWire("B1", 1, 0.0011), BundleWire("B2", 1))
    bundle = Bundle(
        wires, positions=((0.0, 0.0), (0.002, 0.0)), conduit="tube", conduit_bore=0.0107
    )
    specimen = Specimen("CWB", "s1", "1", {"span": 0.1524}, bundle, {"cured": "24 h"})

    said = summary(replace(build_result(half_cycle=0.5), specimen=specimen))["specimen"]

    assert json.loads(json.dumps(said)) == {
        "type": "CWB",
        "spool": "s1",
        "sample": "1",
        "span": 0.1524,
        "bundle": {
            "composition": "1 B1 + 1 B2",
            "number": 2,
            "wires": [
                {"type": "B1", "number": 1, "diameter": 0.0011},
                {"type": "B2", "number": 1, "diameter": None},
            ],
            "arrangement": "packed",
            "positions": [[0.0, 0.0], [0.002, 0.0]],
            "tape": "none",
            "taping": "none",
            "conduit": "tube",
            "conduit_bore": 0.0107,
        },
        "labels": {"cured": "24 h"},
    }


def test_no_number_that_json_cannot_say(tmp_path: Path) -> None:
    nan, infinite = float("nan"), float("inf")
    odd = Result("energy.1", nan, "J", Interval(-infinite, infinite))
    result = replace(build_result(half_cycle=0.5), results=(odd,))
    write_summary(result, tmp_path / "summary.json")
    text = (tmp_path / "summary.json").read_text(encoding="utf-8")
    entry = json.loads(text, parse_constant=pytest.fail)["results"][0]
    assert [entry[key] for key in ("value", "lower", "upper")] == [None] * 3


FAILED = FailedTest("T\udce9", "time_limit", "a \u20ac", "0a", (InputFile("force", "f", "1b", 7),))


def test_what_is_known_of_a_failure(tmp_path: Path) -> None:
    write_failure(FAILED, tmp_path / "p" / "T")
    (file,) = (tmp_path / "p" / "T").iterdir()
    assert file.name == FAILURE_FILE
    said = json.loads(file.read_text("utf-8"))
    assert list(said) == [
        "schema", "labpipe", "test", "code", "reason", "run", "inputs", "made_of",
    ]  # fmt: skip
    assert said["test"] == "T\udce9"  # a name that no UTF-8 can say
    assert said["reason"] == "a \u20ac"
    assert said["inputs"] == [{"role": "force", "file": "f", "sha256": "1b"}]
    assert said["made_of"] == {}


def test_the_last_failure_counts(tmp_path: Path) -> None:
    write_failure(FAILED, tmp_path)
    write_failure(FailedTest("T", "in_time", ""), tmp_path)
    assert json.loads((tmp_path / FAILURE_FILE).read_text("utf-8"))["code"] == "in_time"


def test_none_while_another_process_writes(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(StoreError, match="another labpipe process"):
        write_failure(FAILED, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("key", "other"), [("value", 0.63), ("upper", 0.7), ("status", "doubtful")]
)
def test_numbers_that_were_changed_are_refused(tmp_path: Path, key: str, other: object) -> None:
    result, file = build_result(half_cycle=0.5), tmp_path / "summary.json"
    check_summary(result, file)  # there is none
    write_summary(result, file)
    check_summary(result, file)
    said = json.loads(file.read_text(encoding="utf-8"))
    said["results"][0][key] = other
    file.write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(StoreError, match=r"summary\.json.*peak_force\.1.*Process the test again"):
        check_summary(result, file)
    said["results"][0]["seal"] = sealed(said["results"][0])
    file.write_text(json.dumps(said), encoding="utf-8")
    with pytest.raises(StoreError, match="the numbers of result"):
        check_summary(result, file)
