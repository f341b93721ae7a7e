"""Writing and reading belong together: what is written is what is read, or nothing is written."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.errors import StoreError
from labpipe.records.curve import Aligned, Bending
from labpipe.records.harness_bundle import Bundle, BundleWire
from labpipe.records.quality import Reason
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Instrument, Specimen, TestResult
from labpipe.store import layout, write
from labpipe.store.read import read_outcome, read_raw, read_result
from labpipe.store.write import write_result
from tests.builders.measured_bending import some_bending, some_cloud
from tests.store.builders_result import (
    build_result,
    counted_in_rows,
    differences,
    with_slips,
)


@pytest.fixture(scope="module")
def result() -> TestResult:
    return with_slips(build_result(half_cycle=4.0))


def test_round_trip_is_exact(result: TestResult, tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    write_result(result, path)
    assert differences(result, read_result(path)) == []
    assert [found.name for found in tmp_path.iterdir()] == ["result.h5"]


def test_stages_that_are_not_there_stay_away(result: TestResult, tmp_path: Path) -> None:
    assert result.aligned is not None
    bare = replace(
        result,
        aligned=replace(result.aligned, clock_fit=None, series={}),
        curve=None,
        shape=None,
        slips=(),
        lines=(),
        results=(),
        quality=(),
        recordings={},
        inputs=(),
        display={},
        figures=(),
        specimen=replace(result.specimen, dimensions={}),
    )
    for given_result in (bare, replace(bare, aligned=None)):
        write_result(given_result, tmp_path / "result.h5")
        assert differences(given_result, read_result(tmp_path / "result.h5")) == []


def test_empty_take_and_unfitted_shape(result: TestResult, tmp_path: Path) -> None:
    assert result.shape is not None
    frames = len(result.shape.time)
    tracks = result.recordings["markers"].markers
    assert tracks is not None
    empty = replace(
        tracks,
        time=np.empty(0),
        frames=np.empty(0),
        names=(),
        positions=np.empty((0, 0, 3)),
        bodies=(),
        rate=float("nan"),
    )
    given_result = replace(
        result,
        shape=replace(result.shape, coefficients=np.empty((frames, 3, 0))),
        recordings={"markers": replace(result.recordings["markers"], markers=empty)},
    )
    write_result(given_result, tmp_path / "result.h5")
    assert differences(given_result, read_result(tmp_path / "result.h5")) == []


def test_same_result_gives_same_bytes(result: TestResult, tmp_path: Path) -> None:
    write_result(result, tmp_path / "one.h5")
    write_result(with_slips(build_result(half_cycle=4.0)), tmp_path / "other.h5")
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "other.h5").read_bytes()


def test_every_dataset_is_chunked_filtered_and_labelled(result: TestResult, tmp_path: Path) -> None:
    write_result(result, tmp_path / "result.h5")
    datasets: list[Any] = []
    with h5py.File(tmp_path / "result.h5") as root:
        root.visititems(
            lambda _, found: datasets.append(found) if isinstance(found, h5py.Dataset) else None
        )
        assert len(datasets) > 40
        for dataset in datasets:
            assert dataset.chunks, dataset.name
            assert (dataset.compression, dataset.shuffle, dataset.fletcher32) == (
                "gzip",
                True,
                True,
            )
            assert isinstance(dataset.attrs["unit"], str)
            assert len(dataset.attrs["axes"].split(", ")) == dataset.ndim


def test_layout_is_the_documented_one(result: TestResult, tmp_path: Path) -> None:
    write_result(result, tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5") as root:
        assert root.attrs["labpipe_schema"] == 2
        assert root.attrs["specimen_type"] == "A2"
        assert root.attrs["protocol_yaml"] == result.protocol_yaml
        raw = root["raw"]
        assert raw["force"].attrs["reader"] == "dspace-mat"
        assert list(raw["force"].attrs["file"]) == ["force_1.mat", "force_2.mat"]
        assert raw["force/Out1"].attrs["name_in_file"] == "Model Root/Load Cell/Out1"
        assert raw["force/Out1"].attrs["unit"] == "V"
        assert raw["force/Out1_2"].attrs["unit"] == "unknown"
        assert raw["force/time_2"].attrs["name"] == "time"
        assert raw["markers/time"] == raw["markers/markers/time"]
        assert raw["markers/markers/positions"].attrs["unit"] == "m"
        assert raw["markers/rigid_bodies/Table_1"].attrs["name"] == "Table/1"
        assert root["aligned"].attrs["offset_unit"] == "s"
        assert root["curve/branches/direction"][1] == b"unloading"
        assert root["results/peak_force.1"].attrs["lower"] == 0.59
        assert np.isnan(root["results/initial_stiffness"].attrs["value"])
        assert root["quality/code"][0] == b"marker_filled"


def test_the_table_of_results_says_what_the_results_say(result: TestResult, tmp_path: Path) -> None:
    write_result(result, tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5") as root:
        rows = {name: each[()].tolist() for name, each in root["results/table"].items()}
    assert list(rows) == sorted(layout.RESULT_COLUMNS.columns)
    assert rows["name"] == [b"peak_force.1", b"residual_displacement.1", b"initial_stiffness"]
    assert rows["unit"] == [b"N", b"m", b"N/m"]
    assert rows["status"] == [b"ok", b"doubtful", b"failed"]
    assert rows["code"] == [b"", b"extrapolated", b"not_reached"]
    assert rows["reason"][2] == b"not_reached: too short"
    for name, wanted in {
        "value": [0.62, 0.0031, np.nan],
        "estimate": [0.6, 0.0031, np.nan],
        "lower": [0.59, np.nan, np.nan],
        "upper": [0.61, np.nan, np.nan],
        "level": [0.95, np.nan, np.nan],
    }.items():
        np.testing.assert_array_equal(rows[name], wanted)


def test_who_when_and_with_what_come_back(result: TestResult, tmp_path: Path) -> None:
    instruments = (
        Instrument("force", ("force", "energy"), "LC-7", date(2026, 1, 2), None, None, 2.0),
        Instrument("markers", ("mid_span",), "µ", date(2026, 1, 2), date(2027, 1, 2), 5e-3, 3.0),
    )
    said = replace(result, date=date(2026, 3, 4), operator="Zoë", instruments=instruments)
    write_result(said, tmp_path / "result.h5")
    assert differences(said, read_result(tmp_path / "result.h5")) == []
    with h5py.File(tmp_path / "result.h5") as root:
        assert (root.attrs["date"], root.attrs["operator"]) == ("2026-03-04", "Zoë")
        assert root["instruments/due"][()].tolist() == [b"", b"2027-01-02"]


def test_rows_without_time_are_not_called_seconds(result: TestResult, tmp_path: Path) -> None:
    rows = counted_in_rows(result)
    write_result(rows, tmp_path / "result.h5")
    assert differences(rows, read_result(tmp_path / "result.h5")) == []
    with h5py.File(tmp_path / "result.h5") as root:
        for name in ("raw/frame/time", "aligned/time", "curve/time"):
            assert root[name].attrs["unit"] == "1"
        assert root["curve/branches/start_time"].attrs["unit"] == "1"
        assert root["curve/branches/start"].attrs["unit"] == "sample"


def _full_disk(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(("owner", "step"), [(Path, "write_bytes"), (os, "fsync")])
def test_full_disk_leaves_the_earlier_result(
    owner: object, step: str, result: TestResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "result.h5"
    path.write_bytes(b"earlier")
    monkeypatch.setattr(owner, step, _full_disk)
    with pytest.raises(StoreError, match=r"result\.h5: expected room on the disk, found a full"):
        write_result(result, path)
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_interrupt_leaves_the_earlier_result(
    result: TestResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "result.h5"
    path.write_bytes(b"earlier")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(write, "_verify", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_result(result, path)
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_bytes_that_change_on_the_way_are_found(
    result: TestResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "read_bytes", lambda _: b"other")
    with pytest.raises(StoreError, match="expected to read back what was written"):
        write_result(result, tmp_path / "result.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "bending",
    [some_bending(), Bending(some_cloud(), None, Reason("no_law", "expected at least 24")), None],
    ids=["with a law", "without a law", "not asked for"],
)
def test_a_bending_that_is_written_is_read(bending: Bending | None, tmp_path: Path) -> None:
    result = replace(build_result(cycles=1, half_cycle=4.0, force_rate=50.0), bending=bending)
    write_result(result, tmp_path / "result.h5")
    assert not differences(read_result(tmp_path / "result.h5"), result)
    assert read_outcome(tmp_path / "result.h5").bending is None


_NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)


_TINY = build_result(half_cycle=0.1, cycles=1, force_rate=50.0)


@settings(max_examples=15)
@given(
    names=st.lists(_NAMES, max_size=5),
    values=st.lists(st.floats(width=64), max_size=30),
    texts=st.dictionaries(_NAMES, _NAMES, max_size=3),
)
def test_any_names_and_numbers_come_back(
    names: list[str],
    values: list[float],
    texts: dict[str, str],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path = tmp_path_factory.mktemp("any") / "result.h5"
    array = np.array(values, dtype=float)
    recording = Recording(
        "dspace-csv",
        clocks=tuple(Clock(name, array) for name in names),
        channels=tuple(Channel(name, name, array, name, name, name) for name in names),
        metadata=texts,
    )
    given_result = replace(
        _TINY,
        recordings={"force": recording},
        aligned=Aligned(array, {}),
        display=texts,
        test_yaml="".join(names),
    )
    write_result(given_result, path)
    assert differences(given_result, read_result(path)) == []


BUNDLE = Bundle(
    wires=(BundleWire("B1", 2, 0.0011), BundleWire("B2", 1)),
    arrangement="asymmetric",
    positions=((0.0, 0.0), (0.002, 0.0), (0.0, -0.003)),
    tape="PVC",
    taping="half-lap",
    conduit="Wellrohr, geschlitzt (ø 10)",
    conduit_bore=0.0107,
)


TAPED = Specimen("TWB", "s1", "1", {"length": 0.1143}, BUNDLE, {"cured": "24 h", "lot": "07"})


def write_specimen(specimen: Specimen, folder: Path) -> Path:
    write_result(replace(build_result(half_cycle=0.5), specimen=specimen), folder / "result.h5")
    return folder / "result.h5"


def test_a_bundle_and_labels_come_back_as_they_were(tmp_path: Path) -> None:
    path = write_specimen(TAPED, tmp_path)

    for read in (read_raw, read_outcome, read_result):
        assert differences(TAPED, read(path).specimen) == []
