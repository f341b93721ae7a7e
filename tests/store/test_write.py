"""Writing and reading belong together: what is written is what is read, or nothing is written."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path

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
from labpipe.store import layout, result_files
from labpipe.store.result_files import read_outcome, read_raw, read_result, write_result
from tests.approved import Approve
from tests.builders.measured_bending import some_bending, some_cloud
from tests.store.builders_result import build_result, counted_in_rows, differences, with_slips


@pytest.fixture(scope="module")
def result() -> TestResult:
    return with_slips(build_result(half_cycle=1.0))


def label_of(dataset: h5py.Dataset) -> str:
    assert dataset.chunks, dataset.name
    filters = (dataset.compression, dataset.shuffle, dataset.fletcher32)
    assert filters == ("gzip", True, True), dataset.name
    unit, axes = dataset.attrs["unit"], dataset.attrs["axes"]
    assert len(axes.split(", ")) == dataset.ndim
    return f"{dataset.name} [{unit}] by {axes}: {dataset.dtype.kind}{dataset.shape}"


LABELLED = (
    *("raw/force", "raw/force/Out1_2", "raw/markers/rigid_bodies/Table_1", "aligned"),
    *("results/peak_force.1", "results/initial_stiffness"),
)


def test_layout_is_the_documented_one(
    result: TestResult, tmp_path: Path, approved: Approve
) -> None:
    """Units, axes and shapes of all datasets, values of some, and attributes of some groups.

    The same result gives the same bytes; rows without time are not called seconds.
    """
    write_result(result, tmp_path / "result.h5")
    lines = list[str]()
    with h5py.File(tmp_path / "result.h5") as root:
        root.visititems(
            lambda _, item: lines.append(label_of(item)) if isinstance(item, h5py.Dataset) else None
        )
        for name in LABELLED:
            lines += [f"{name}.{key} = {value}" for key, value in sorted(root[name].attrs.items())]
        assert root["raw/markers/time"] == root["raw/markers/markers/time"]
        assert list(root["results/table"]) == sorted(layout.list_columns(layout.ResultRow))
        for name in ("results/table", "budgets"):
            lines += [f"{name}/{key} = {column[()].tolist()}" for key, column in root[name].items()]
    approved(lines)
    write_result(with_slips(build_result(half_cycle=1.0)), tmp_path / "other.h5")
    assert (tmp_path / "result.h5").read_bytes() == (tmp_path / "other.h5").read_bytes()
    write_result(counted_in_rows(result), tmp_path / "rows.h5")
    with h5py.File(tmp_path / "rows.h5") as root:
        for name in ("raw/frame/time", "aligned/time", "curve/time", "curve/branches/start_time"):
            assert root[name].attrs["unit"] == "1"


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def raising(error: BaseException) -> Callable[..., None]:
    def stop(*_: object, **__: object) -> None:
        raise error

    return stop


@pytest.mark.parametrize(
    ("owner", "step", "instead", "error", "message"),
    [
        (Path, "write_bytes", raising(FULL), StoreError, "expected room on the disk, found a full"),
        (os, "fsync", raising(FULL), StoreError, "expected room on the disk, found a full"),
        (result_files, "_verify_file", raising(KeyboardInterrupt()), KeyboardInterrupt, None),
        (
            Path,
            "read_bytes",
            lambda _: b"other",
            StoreError,
            "found other content when it was read back",
        ),
    ],
)
def test_what_goes_wrong_leaves_the_earlier_result(
    owner: object,
    step: str,
    instead: Callable[..., object],
    error: type[BaseException],
    message: str | None,
    result: TestResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "result.h5"
    path.write_bytes(b"earlier")
    with monkeypatch.context() as patch:
        patch.setattr(owner, step, instead)
        with pytest.raises(error, match=message):
            write_result(result, path)
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]


def bare(result: TestResult) -> TestResult:
    assert result.aligned is not None
    aligned = replace(result.aligned, clock_fit=None, series={})
    specimen = replace(result.specimen, dimensions={})
    nothing = dict.fromkeys(("slips", "lines", "results", "quality", "inputs", "figures"), ())
    staged = replace(result, aligned=aligned, curve=None, shape=None, specimen=specimen)
    return replace(staged, recordings={}, display={}, **nothing)  # type: ignore[arg-type]


def with_empty_take(result: TestResult) -> TestResult:
    take = result.recordings["markers"]
    assert take.markers is not None
    none, positions = np.empty(0), np.empty((0, 0, 3))
    tracks = replace(take.markers, time=none, frames=none, positions=positions, names=(), bodies=())
    tracks = replace(tracks, rate=float("nan"))
    return replace(result, recordings={"markers": replace(take, markers=tracks)})


def with_unfitted_shape(result: TestResult) -> TestResult:
    assert result.shape is not None
    unfitted = np.empty((len(result.shape.time), 3, 0))
    return replace(result, shape=replace(result.shape, coefficients=unfitted))


def with_instruments(result: TestResult) -> TestResult:
    calibrated, due = date(2026, 1, 2), date(2027, 1, 2)
    instruments = (
        Instrument("force", ("force", "energy"), "LC-7", calibrated, None, None, 2.0),
        Instrument("markers", ("mid_span",), "µ", calibrated, due, 5e-3, 3.0),
    )
    return replace(result, date=date(2026, 3, 4), operator="Zoë", instruments=instruments)


def with_bundle(result: TestResult) -> TestResult:
    bundle = Bundle(
        (BundleWire("B1", 2, 0.0011), BundleWire("B2", 1)),
        "asymmetric",
        ((0.0, 0.0), (0.002, 0.0), (0.0, -0.003)),
        tape="PVC",
        taping="half-lap",
        conduit="Wellrohr, geschlitzt (ø 10)",
        conduit_bore=0.0107,
    )
    labels = {"cured": "24 h", "lot": "07"}
    return replace(result, specimen=Specimen("TWB", "s1", "1", {"length": 0.1143}, bundle, labels))


NO_LAW = Bending(some_cloud(), None, Reason("no_law", "expected at least 24"))
VARIANTS: dict[str, Callable[[TestResult], TestResult]] = {
    "whole": lambda result: result,
    "bare": bare,
    "not aligned": lambda result: replace(bare(result), aligned=None),
    "empty take": with_empty_take,
    "unfitted shape": with_unfitted_shape,
    "instruments": with_instruments,
    "bundle": with_bundle,
    "rows without time": counted_in_rows,
    "bending": lambda result: replace(result, bending=some_bending()),
    "bending without a law": lambda result: replace(result, bending=NO_LAW),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_what_is_written_is_read(variant: str, result: TestResult, tmp_path: Path) -> None:
    expected, path = VARIANTS[variant](result), tmp_path / "result.h5"
    write_result(expected, path)
    assert differences(expected, read_result(path)) == []
    assert differences(expected.specimen, read_raw(path).specimen) == []
    outcome = read_outcome(path)
    assert differences(expected.specimen, outcome.specimen) == []
    assert outcome.bending is None
    assert [file.name for file in tmp_path.iterdir()] == ["result.h5"]


_NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)


_TINY = build_result(half_cycle=0.1, cycles=1, force_rate=50.0)


@settings(max_examples=8)
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
    clocks = tuple(Clock(name, array) for name in names)
    channels = tuple(Channel(name, name, array, name, name, name) for name in names)
    recording = Recording("dspace-csv", clocks=clocks, channels=channels, metadata=texts)
    aligned, sheet = Aligned(array, {}), "".join(names)
    result = replace(_TINY, recordings={"force": recording}, aligned=aligned, display=texts)
    write_result(replace(result, test_yaml=sheet), path)
    assert differences(replace(result, test_yaml=sheet), read_result(path)) == []
