from __future__ import annotations

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from labpipe.door.many_tests import LeftOutWarning, groups, table
from labpipe.errors import StoreError, UsageError
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.result import Result, Specimen, TestResult
from labpipe.store.summaries import write_summary
from tests.builders.small_tests import Lab, Run
from tests.store.builders_result import build_result

MADE = build_result(half_cycle=0.5)
BUNDLE = Bundle((BundleWire("B1", 3, 0.001),), tape="PVC", taping="half-lap")


def put(folder: Path, result: TestResult) -> Path:
    """A test as a table reads it: the summary counts, the result only has to be there."""
    place = folder / result.test
    place.mkdir(parents=True)
    write_summary(result, place / "summary.json")
    (place / "result.h5").touch()
    return place / "summary.json"


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    long = Specimen("A2", "A2-s2", "1", {"length": 0.1}, labels={"cured": "24 h", "value": "x"})
    bundle = Specimen("TWB", "s1", "1", {"length": 0.1143}, BUNDLE)
    put(tmp_path, replace(MADE, date=date(2026, 3, 4), operator="lab"))
    put(tmp_path / "deep", replace(MADE, test="A2-100-1", specimen=long))
    put(tmp_path, replace(MADE, test="T", specimen=bundle, results=MADE.results[:1]))
    return tmp_path


KINDS = {
    **dict.fromkeys(("test", "type", "spool", "sample"), "str"),
    "length": "float64",
    **dict.fromkeys(("composition", "number", "arrangement", "tape", "taping"), "str"),
    "number": "float64",
    "conduit": "str",
    "conduit_bore": "str",
    **dict.fromkeys(("cured", "label_value", "protocol"), "str"),
    "date": "datetime64[s]",
    **dict.fromkeys(("operator", "folder", "result"), "str"),
    **dict.fromkeys(("value", "estimate", "lower", "upper"), "float64"),
    **dict.fromkeys(("unit", "status", "code", "reason"), "str"),
}


def test_columns_and_their_types(campaign: Path) -> None:
    frame = table(campaign)
    assert {str(name): str(kind) for name, kind in frame.dtypes.items()} == KINDS
    assert len(frame) == 7
    assert frame.attrs["left_out"] == {}


def test_a_row_per_test_and_result(campaign: Path) -> None:
    frame = table([campaign])
    own = frame[frame["test"] == "A2-085-1"]
    assert own["result"].tolist() == [each.name for each in MADE.results]
    first = own.iloc[0]
    assert first[["value", "estimate", "lower", "upper"]].tolist() == [0.62, 0.6, 0.59, 0.61]
    assert (first["date"], first["operator"]) == (pd.Timestamp("2026-03-04"), "lab")
    assert first["folder"] == str(campaign / "A2-085-1")
    failed = own.iloc[2]
    assert failed[["value", "lower", "cured", "tape"]].isna().all()
    assert (failed["status"], failed["code"]) == ("failed", "not_reached")
    taped = frame[frame["type"] == "TWB"].iloc[0]
    assert (taped["tape"], taped["number"], taped["length"]) == ("PVC", 3.0, 0.1143)
    assert pd.isna(taped["date"])


def test_fields_that_are_asked_for_come_first_and_sort(campaign: Path) -> None:
    assert list(table(campaign, by="taping"))[:2] == ["test", "taping"]
    frame = table(campaign, by=["length", "type"])
    assert list(frame)[:3] == ["test", "length", "type"]
    assert frame["length"].tolist() == [*[0.085] * 3, *[0.1] * 3, 0.1143]
    assert {str(name) for name in frame} == {*KINDS}


def test_a_field_that_no_sheet_has(campaign: Path) -> None:
    said = r"by: expected a field of the test sheets: length, .*found 'lenght'\. Choose one of th"
    with pytest.raises(UsageError, match=said):
        table(campaign, by=["lenght"])


def test_summaries_of_earlier_versions(tmp_path: Path) -> None:
    path = put(tmp_path, MADE)
    said = json.loads(path.read_text(encoding="utf-8"))
    for key in ("date", "operator", "instruments", "run"):
        del said[key]
    for each in said["results"]:
        del each["code"], each["reason"], each["estimate"]
    path.write_text(json.dumps(said | {"schema": 1}), encoding="utf-8")
    frame = table(tmp_path).set_index("result")
    assert frame.loc["peak_force.1", "estimate"] == 0.62
    assert frame.loc["initial_stiffness", "code"] == "not_reached"
    assert frame.loc["initial_stiffness", "reason"] == "not_reached: too short"
    assert frame["date"].isna().all()


DAMAGED = {
    "empty": ("", "a damaged one"),
    "half": ('{"schema": 2, "te', "a damaged one"),
    "list": ("[]", "something else"),
    "newer": ('{"schema": 3}', "one of a newer labpipe, schema 3. Update labpipe."),
    "bare": ('{"schema": 2}', "a damaged one ('test')"),
    "deep": ("[" * 200_000, "a damaged one"),
    "word": ('{"schema": 2, "test": "a", "specimen": {}, "results": 3, "protocol": ""}', "damaged"),
    "no number": (
        '{"schema": 2, "test": "a", "specimen": {}, "protocol": "", '
        '"results": [{"name": "a", "value": "x", "unit": "N", "status": "ok"}]}',
        "a damaged one",
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_summary_is_left_out_and_said(name: str, campaign: Path) -> None:
    content, found = DAMAGED[name]
    bad = put(campaign, replace(MADE, test="bad"))
    bad.write_text(content, encoding="utf-8")
    with pytest.warns(LeftOutWarning, match="summary.json: expected a") as said:
        frame = table(campaign)
    assert found in str(said[0].message)
    assert len(frame) == 7
    assert list(frame.attrs["left_out"]) == [str(bad.parent)]


def test_nothing_but_damaged_summaries(tmp_path: Path) -> None:
    put(tmp_path, MADE).write_text("", encoding="utf-8")
    with pytest.raises(StoreError, match=r"summary\.json: expected a summary of a processed test"):
        table(tmp_path)


@pytest.mark.parametrize(
    ("name", "found"), [("raw", "none"), ("nowhere", "nothing there"), ("file", "a file")]
)
def test_no_processed_tests(name: str, found: str, tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "file").touch()
    said = rf"{name}: expected a folder with processed tests, found {found}\. `labpipe process`"
    with pytest.raises(UsageError, match=said):
        table(tmp_path / name)


def test_results_that_are_being_replaced_are_left_out(campaign: Path) -> None:
    (campaign / "T" / ".labpipe.commit").mkdir()
    with pytest.warns(LeftOutWarning, match="files are being replaced"):
        assert "T" not in set(table(campaign)["test"])


def test_a_test_without_results_has_no_rows(tmp_path: Path) -> None:
    put(tmp_path, replace(MADE, results=()))
    frame = table(tmp_path)
    assert len(frame) == 0
    assert frame.dtypes["value"] == "float64"


def test_infinite_and_absent_numbers_are_nan(tmp_path: Path) -> None:
    put(tmp_path, replace(MADE, results=(Result("energy.1", float("inf"), "J"),)))
    assert np.isnan(table(tmp_path)["value"][0])


@pytest.mark.slow
def test_groups_are_those_of_a_report(pristine: Lab, run: Run, tmp_path: Path) -> None:
    sheet = pristine.sheet.read_text(encoding="utf-8")
    home = pristine.copy(tmp_path / "lab")
    for number in (2, 3):
        other = home.raw.with_name(f"T{number}")
        other.mkdir()
        for export in home.raw.iterdir():
            (other / export.name).write_bytes(export.read_bytes())
        text = sheet.replace("test: T1", f"test: T{number}").replace(
            "sample: 1", f"sample: {number}"
        )
        (other / "test.yaml").write_text(text, encoding="utf-8")
        take = (other / "take.csv").read_bytes()  # the same exports would be one recording
        (other / "take.csv").write_bytes(take + b"\n" * number)
    run("process", home.raw.parent, "--no-figures")
    frame = groups(home.processed.parent)
    assert {str(name): str(kind) for name, kind in frame.dtypes.items()} == {
        **dict.fromkeys(("group", "protocol", "result"), "str"),
        **dict.fromkeys(("mean", "estimate", "lower", "upper", "deviation"), "float64"),
        **dict.fromkeys(("n", "tests"), "int64"),
        **dict.fromkeys(("unit", "how", "reason"), "str"),
    }
    peak = frame[frame["result"] == "peak_force.1"].iloc[0]
    (value,) = set(table(home.processed.parent).query("result == 'peak_force.1'")["value"])
    assert peak["mean"] == pytest.approx(value)
    assert (peak["tests"], peak["n"], peak["unit"]) == (3, 3, "N")
    assert peak["lower"] <= peak["estimate"] <= peak["upper"]
    assert peak["how"]
