"""Tables of many tests and of one: their columns, types and units are promised."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from labpipe.api import data_frames
from labpipe.api.data_frames import LeftOutWarning, Recordings, Units, groups, table
from labpipe.api.one_test import Test
from labpipe.errors import UsageError
from labpipe.records.curve import Interval
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.recording import Channel, Clock, Recording
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


TEXTS = (
    *("test", "type", "spool", "sample", "composition", "arrangement", "tape", "taping"),
    *("conduit", "conduit_bore", "cured", "label_value", "protocol", "operator", "folder"),
    *("result", "unit", "status", "code", "reason"),
)
NUMBERS = ("value", "estimate", "lower", "upper")
KINDS = {
    **dict.fromkeys(TEXTS, "str"),
    **dict.fromkeys(("length", "number", *NUMBERS), "float64"),
    "date": "datetime64[s]",
}


def test_a_row_per_test_and_result(campaign: Path) -> None:
    frame = table([campaign])
    assert kinds(frame) == KINDS
    assert (len(frame), frame.attrs["left_out"]) == (7, {})
    rows_of_test = frame[frame["test"] == "A2-085-1"]
    assert rows_of_test["result"].tolist() == [result.name for result in MADE.results]
    peak, _, failed = (row for _, row in rows_of_test.iterrows())
    assert peak[[*NUMBERS]].tolist() == [0.62, 0.6, 0.59, 0.61]
    assert (peak["date"], peak["operator"]) == (pd.Timestamp("2026-03-04"), "lab")
    assert peak["folder"] == str(campaign / "A2-085-1")
    assert failed[["value", "lower", "cured", "tape"]].isna().all()
    assert (failed["status"], failed["code"]) == ("failed", "not_reached")
    taped = frame[frame["type"] == "TWB"].iloc[0]
    assert (taped["tape"], taped["number"], taped["length"]) == ("PVC", 3.0, 0.1143)
    assert pd.isna(taped["date"])


def test_fields_of_by_come_first_and_sort_the_rows(campaign: Path) -> None:
    assert list(table(campaign, by="taping"))[:2] == ["test", "taping"]
    frame = table(campaign, by=["length", "type"])
    assert list(frame)[:3] == ["test", "length", "type"]
    assert frame["length"].tolist() == [*[0.085] * 3, *[0.1] * 3, 0.1143]
    assert {str(name) for name in frame} == {*KINDS}


DAMAGED = {
    "empty": ("", "a damaged one"),
    "list": ("[]", "a file of another kind"),
    "newer": ('{"schema": 3}', "one of a newer labpipe, schema 3. Update labpipe."),
    "bare": ('{"schema": 2}', "a damaged one ('test')"),
    "deep": ("[" * 200_000, "a damaged one"),
    "no number": (
        '{"schema": 2, "test": "a", "specimen": {}, "protocol": "", '
        '"results": [{"name": "a", "value": "x", "unit": "N", "status": "ok"}]}',
        "a damaged one",
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_summary_is_left_out_with_warning(name: str, campaign: Path) -> None:
    content, content_found = DAMAGED[name]
    damaged = put(campaign, replace(MADE, test="bad"))
    damaged.write_text(content, encoding="utf-8")
    with pytest.warns(LeftOutWarning, match="summary.json: expected a") as warned:
        frame = table(campaign)
    assert content_found in str(warned[0].message)
    assert len(frame) == 7
    assert list(frame.attrs["left_out"]) == [str(damaged.parent)]


@pytest.mark.parametrize(
    ("name", "found"), [("raw", "none"), ("nowhere", "nothing there"), ("file", "a file")]
)
def test_no_processed_tests(name: str, found: str, tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "file").touch()
    message = rf"{name}: expected a folder with processed tests, found {found}\. `labpipe process`"
    with pytest.raises(UsageError, match=message):
        table(tmp_path / name)


def test_results_that_are_being_replaced_are_left_out(campaign: Path) -> None:
    (campaign / "T" / ".labpipe.commit").mkdir()
    with pytest.warns(LeftOutWarning, match="files are being replaced"):
        assert "T" not in set(table(campaign)["test"])


@pytest.mark.slow
def test_groups_are_those_of_a_report(pristine: Lab, run: Run, tmp_path: Path) -> None:
    lab = pristine.copy(tmp_path / "lab")
    for number in (2, 3):
        copied = replace(lab, name=f"T{number}")
        shutil.copytree(lab.raw, copied.raw)
        copied.edit("test.yaml", "test: T1", f"test: T{number}")
        copied.edit("test.yaml", "sample: 1", f"sample: {number}")
        take = copied.raw / "take.csv"  # the same samples would be one recording
        take.write_text("\n".join(take.read_text().splitlines()[:-number]) + "\n")
    run("process", lab.raw.parent, "--no-figures")
    frame = groups(lab.processed.parent)
    assert kinds(frame) == {
        **dict.fromkeys(("group", "protocol", "result", "unit", "how", "reason"), "str"),
        **dict.fromkeys(("mean", "estimate", "lower", "upper", "deviation"), "float64"),
        **dict.fromkeys(("n", "tests"), "int64"),
    }
    peak = frame[frame["result"] == "peak_force.1"].iloc[0]
    (value,) = set(table(lab.processed.parent).query("result == 'peak_force.1'")["value"])
    assert peak["mean"] == pytest.approx(value)
    assert (peak["tests"], peak["n"], peak["unit"]) == (3, 3, "N")
    assert peak["lower"] <= peak["estimate"] <= peak["upper"]
    assert peak["how"]


SI, SHOWN = Units(), Units({"displacement": "mm", "force": "mN", "energy": "mJ"})


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=1.0)


def kinds(frame: pd.DataFrame) -> dict[str, str]:
    return {str(name): str(kind) for name, kind in frame.dtypes.items()}


def test_values_of_results(result: TestResult) -> None:
    frame = data_frames.make_results_frame(result.results, SI)
    texts = dict.fromkeys(("unit", "status", "code", "reason"), "str")
    assert kinds(frame) == dict.fromkeys(NUMBERS, "float64") | texts
    assert kinds(data_frames.make_results_frame((), SI)) == kinds(frame)
    assert (frame.index.name, str(frame.index.dtype), len(frame)) == ("name", "str", 3)
    assert list(frame.loc["peak_force.1"]) == [0.62, 0.6, 0.59, 0.61, "N", "ok", "", ""]
    failed = frame.loc["initial_stiffness"]
    assert failed[[*NUMBERS]].isna().all()
    assert (failed["status"], failed["code"]) == ("failed", "not_reached")
    assert failed["reason"] == "not_reached: too short"
    assert frame.loc["residual_displacement.1", "estimate"] == 0.0031


def test_results_in_display_units() -> None:
    results = [
        Result("energy.1", 0.02, "J", Interval(0.01, 0.03), estimate=0.021),
        Result("clock_drift", 5e-5, "1"),
        Result("twist", 0.1, "rad"),
    ]
    frame = data_frames.make_results_frame(results, SHOWN)
    assert frame["unit"].tolist() == ["mJ", "ppm", "rad"]
    np.testing.assert_allclose(frame["value"], [20.0, 50.0, 0.1])
    np.testing.assert_allclose(frame.loc["energy.1", ["estimate", "lower", "upper"]], [21, 10, 30])


def test_budgets(result: TestResult) -> None:
    frame = data_frames.make_budget_frame(result.results[0], SHOWN)
    assert kinds(frame) == {"change": "float64", "share": "float64", "is_common": "bool"}
    assert frame.index.tolist() == ["noise", "scale of the force"]
    np.testing.assert_allclose(frame["change"], [3.0, -4.0])
    np.testing.assert_allclose(frame["share"], [0.36, 0.64])
    assert frame["is_common"].tolist() == [False, True]
    assert frame.attrs["units"] == {"change": "mN", "share": "1"}
    empty = data_frames.make_budget_frame(result.results[2], SI)
    assert (len(empty), kinds(empty), empty.index.name) == (0, kinds(frame), "cause")


def test_curves(result: TestResult) -> None:
    curve = result.curve
    assert curve is not None
    frame = data_frames.make_curve_frame(curve, SI)
    numbers = dict.fromkeys(("time", "displacement", "force"), "float64")
    assert kinds(frame) == numbers | {"branch": "int64", "cycle": "int64"}
    assert frame.attrs["units"] == {"time": "s", "displacement": "m", "force": "N"}
    arrays = (curve.time, curve.displacement, curve.force, *curve.assign_samples())
    for name, array in zip(frame.columns, arrays, strict=True):
        np.testing.assert_array_equal(frame[name], array)
    shown = data_frames.make_curve_frame(replace(curve, time_unit="1"), SHOWN)
    assert shown.attrs["units"] == {"time": "1", "displacement": "mm", "force": "mN"}
    np.testing.assert_allclose(shown["displacement"], 1e3 * curve.displacement)


def test_shapes(result: TestResult) -> None:
    shape = result.shape
    assert shape is not None
    frame = Test(result).shape
    assert frame.columns.names == ["point", "axis"]
    np.testing.assert_array_equal(frame["pull"]["y"], shape.positions[:, -1, 1])
    np.testing.assert_array_equal(frame.index, shape.time)
    assert frame.attrs["units"] == {"time": "s", "position": "m"}
    shown = Test(result).display.shape
    np.testing.assert_allclose(shown["pull"]["x"], 1e3 * shape.positions[:, -1, 0])
    assert shown.attrs["units"]["position"] == "mm"


def test_recordings_have_a_table_for_each_clock_and_body(result: TestResult) -> None:
    raw = Recordings(result.recordings)
    names = ["markers", "markers/Clamp", "markers/Table/1"]
    names += ["force/HostService", "force/slow raster"]
    assert (list(raw), len(raw)) == (names, len(names))
    assert "markers" in raw
    assert raw.get("force") is None
    cell = raw["force/HostService"]
    assert (list(cell), cell.index.name) == (["Out1"], "time")
    assert cell.attrs["units"] == {"time": "s", "Out1": "V"}
    assert raw["force/slow raster"].attrs["units"] == {"time": "s", "Out1": "unknown"}
    body = raw["markers/Clamp"]
    assert list(body) == ["x", "y", "z", "qx", "qy", "qz", "qw", "error"]
    assert (body["qw"] == 1.0).all()
    tracks = result.recordings["markers"].markers
    assert tracks is not None
    np.testing.assert_array_equal(body["error"], tracks.bodies[0].error)
    assert raw["markers"].columns.names == ["marker", "axis"]
    values = np.arange(3.0)
    channels = tuple(Channel("Out1", f"{place}/Out1", values) for place in "ab")
    one = Recordings({"frame": Recording("r", clocks=(Clock("time", values),), channels=channels)})
    assert (list(one), list(one["frame"])) == (["frame"], ["a/Out1", "b/Out1"])
    assert repr(raw) == f"<labpipe recordings: {', '.join(names)}>"


def test_unknown_recording_is_refused(result: TestResult) -> None:
    with pytest.raises(UsageError, match=r"raw: expected one of .*markers, .*found 'marker'\. `li"):
        Recordings(result.recordings)["marker"]
    with pytest.raises(UsageError, match=r"raw: expected recordings, found none\. Process the"):
        Recordings({})["force"]
