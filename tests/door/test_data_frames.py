"""Tables of one test: their columns, types and units are promised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from labpipe.door.data_frames import (
    Recordings,
    Units,
    budget_frame,
    curve_frame,
    quality_frame,
    results_frame,
    shape_frame,
)
from labpipe.errors import UsageError
from labpipe.records.curve import Interval
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result, TestResult
from tests.store.builders_result import build_result

SI, SHOWN = Units(), Units({"displacement": "mm", "force": "mN", "energy": "mJ"})


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=1.0)


def kinds(frame: pd.DataFrame) -> dict[str, str]:
    return {str(name): str(kind) for name, kind in frame.dtypes.items()}


@pytest.mark.parametrize("count", [0, 3])
def test_results(count: int, result: TestResult) -> None:
    frame = results_frame(result.results[:count], SI)
    numbers = dict.fromkeys(("value", "estimate", "lower", "upper"), "float64")
    assert kinds(frame) == numbers | dict.fromkeys(("unit", "status", "code", "reason"), "str")
    assert (frame.index.name, str(frame.index.dtype), len(frame)) == ("name", "str", count)


def test_values_of_results(result: TestResult) -> None:
    frame = results_frame(result.results, SI)
    assert list(frame.loc["peak_force.1"]) == [0.62, 0.6, 0.59, 0.61, "N", "ok", "", ""]
    failed = frame.loc["initial_stiffness"]
    assert failed[["value", "estimate", "lower", "upper"]].isna().all()
    assert (failed["status"], failed["code"]) == ("failed", "not_reached")
    assert failed["reason"] == "not_reached: too short"
    assert frame.loc["residual_displacement.1", "estimate"] == 0.0031


def test_results_as_they_are_shown() -> None:
    results = [
        Result("energy.1", 0.02, "J", Interval(0.01, 0.03), estimate=0.021),
        Result("clock_drift", 5e-5, "1"),
        Result("twist", 0.1, "rad"),
    ]
    frame = results_frame(results, SHOWN)
    assert frame["unit"].tolist() == ["mJ", "ppm", "rad"]
    np.testing.assert_allclose(frame["value"], [20.0, 50.0, 0.1])
    np.testing.assert_allclose(frame.loc["energy.1", ["estimate", "lower", "upper"]], [21, 10, 30])


def test_budgets(result: TestResult) -> None:
    frame = budget_frame(result.results[0], SHOWN)
    assert kinds(frame) == {"change": "float64", "share": "float64", "is_common": "bool"}
    assert frame.index.tolist() == ["noise", "scale of the force"]
    np.testing.assert_allclose(frame["change"], [3.0, -4.0])
    np.testing.assert_allclose(frame["share"], [0.36, 0.64])
    assert frame["is_common"].tolist() == [False, True]
    assert frame.attrs["units"] == {"change": "mN", "share": "1"}
    none = budget_frame(result.results[2], SI)
    assert (len(none), kinds(none), none.index.name) == (0, kinds(frame), "cause")


def test_curves(result: TestResult) -> None:
    curve = result.curve
    assert curve is not None
    frame = curve_frame(curve, SI)
    numbers = dict.fromkeys(("time", "displacement", "force"), "float64")
    assert kinds(frame) == numbers | {"branch": "int64", "cycle": "int64"}
    assert frame.attrs["units"] == {"time": "s", "displacement": "m", "force": "N"}
    for name in frame.columns:
        np.testing.assert_array_equal(frame[name], getattr(curve, str(name)))
    shown = curve_frame(replace(curve, time_unit="1"), SHOWN)
    assert shown.attrs["units"] == {"time": "1", "displacement": "mm", "force": "mN"}
    np.testing.assert_allclose(shown["displacement"], 1e3 * curve.displacement)


def test_shapes(result: TestResult) -> None:
    shape = result.shape
    assert shape is not None
    frame = shape_frame(shape, SI)
    assert frame.columns.names == ["point", "axis"]
    np.testing.assert_array_equal(frame["pull"]["y"], shape.positions[:, -1, 1])
    np.testing.assert_array_equal(frame.index, shape.time)
    assert frame.attrs["units"] == {"time": "s", "position": "m"}
    shown = shape_frame(shape, SHOWN)
    np.testing.assert_allclose(shown["pull"]["x"], 1e3 * shape.positions[:, -1, 0])
    assert shown.attrs["units"]["position"] == "mm"


def test_notes(result: TestResult) -> None:
    frame = quality_frame(result.quality)
    assert kinds(frame) == dict.fromkeys(("code", "severity", "where", "message"), "str")
    assert list(frame.loc[0]) == [
        *("marker_filled", "warning", "wire:Marker3", "26 frames were filled.")
    ]
    assert kinds(quality_frame([])) == kinds(frame)


def test_recordings_have_a_table_for_each_clock_and_body(result: TestResult) -> None:
    raw = Recordings(result.recordings)
    names = ["markers", "markers/Clamp", "markers/Table/1"]
    names += ["force/HostService", "force/slow raster"]
    assert (list(raw), len(raw)) == (names, len(names))
    assert "markers" in raw
    assert "force" not in raw
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
    assert repr(raw) == f"<labpipe recordings: {', '.join(names)}>"


def test_one_clock_goes_by_the_role_and_repeated_channels_by_their_paths() -> None:
    values = np.arange(3.0)
    channels = tuple(Channel("Out1", f"{place}/Out1", values) for place in "ab")
    raw = Recordings({"frame": Recording("r", clocks=(Clock("time", values),), channels=channels)})
    assert list(raw) == ["frame"]
    assert list(raw["frame"]) == ["a/Out1", "b/Out1"]


def test_a_recording_that_is_not_there(result: TestResult) -> None:
    with pytest.raises(UsageError, match=r"raw: expected one of .*markers, .*found 'marker'\. `li"):
        Recordings(result.recordings)["marker"]
    with pytest.raises(UsageError, match=r"raw: expected recordings, found none\. Process the"):
        Recordings({})["force"]
