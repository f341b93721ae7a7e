"""Result files are read whole or refused, those of earlier schemas, too."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labpipe.errors import StoreError
from labpipe.records.curve import SlipDecision
from labpipe.records.quality import Reason
from labpipe.records.result import Status
from labpipe.store import layout
from labpipe.store.read import (
    RawTest,
    read_drawable,
    read_outcome,
    read_raw,
    read_result,
    read_stages,
)
from labpipe.store.write import write_result
from tests.builders.measured_bending import some_bending
from tests.store.builders_result import build_result, differences, with_slips


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "result.h5"
    write_result(with_slips(build_result(half_cycle=1.0)), path)
    return path


@pytest.fixture
def path(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path / "result.h5"))


def test_raw_holds_all_that_processing_starts_from(written: Path) -> None:
    raw, result = read_raw(written), build_result(half_cycle=1.0)
    for field in fields(RawTest):
        assert differences(getattr(result, field.name), getattr(raw, field.name)) == []


@pytest.mark.parametrize("decision", SlipDecision)
def test_outcome_is_the_result_without_what_only_processing_needs(
    decision: SlipDecision, tmp_path: Path
) -> None:
    path, result = tmp_path / "result.h5", with_slips(build_result(half_cycle=1.0), decision)
    write_result(result, path)
    assert differences(replace(result, recordings={}), read_stages(path)) == []
    aligned = result.aligned if decision is SlipDecision.REPAIRED else None
    wanted = replace(result, recordings={}, shape=None, aligned=aligned)
    with h5py.File(path, "a") as root:
        del root["raw/force/Out1"]
    assert differences(wanted, read_outcome(path)) == []
    with pytest.raises(StoreError, match="expected a whole result file, found a damaged one"):
        read_result(path)
    with h5py.File(path, "a") as root:
        root["results/peak_force.1"].attrs["value"] = 0.63
    with pytest.raises(StoreError, match=r"peak_force\.1: its numbers were changed"):
        read_outcome(path)


def test_what_a_report_draws_is_part_of_the_result(tmp_path: Path) -> None:
    path, frames = tmp_path / "result.h5", np.array([0, 3, 5])
    whole = replace(build_result(half_cycle=1.0), bending=some_bending())
    write_result(whole, path)
    drawable = read_drawable(path, lambda _, time: (frames, time[frames]))
    assert differences(read_outcome(path), drawable.result) == []
    assert drawable.shapes is not None
    assert whole.shape is not None
    np.testing.assert_array_equal(drawable.shapes.deflection, whole.shape.time[frames])
    np.testing.assert_array_equal(
        drawable.shapes.positions, whole.shape.positions[frames][:, :, :2]
    )
    law = some_bending().law
    assert law is not None
    assert drawable.law is not None
    np.testing.assert_array_equal(drawable.law.moment_upper, law.moment_upper)


TABLES = {
    "curve/branches": layout.BRANCH_TABLE,
    "curve/slips": layout.SLIP_TABLE,
    "curve/lines": layout.LINE_TABLE,
}


def before_columns(root: h5py.File) -> None:
    """Make compounds of the columns of tables."""
    for name, table in TABLES.items():
        columns = {column: root[name][column][()] for column in table.columns}
        kinds = [(column, values.dtype.str) for column, values in columns.items()]
        rows = np.array(list(zip(*columns.values(), strict=True)), dtype=kinds)
        del root[name]
        root[name] = rows
        root[name].attrs["axes"] = table.axis
    del root["results/table"], root.attrs["date"], root.attrs["operator"]


def foreign(path: Path) -> None:
    with h5py.File(path, "w") as root:
        root["x"] = 1


def with_attribute(name: str, value: object) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with h5py.File(path, "a") as root:
            root.attrs[name] = value

    return change


def with_damaged_chunk(path: Path) -> None:
    with h5py.File(path) as root:
        chunk = root["raw/force/Out1"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 0x10
    path.write_bytes(content)


NO_UTF_8 = np.array(b"A2\xff", dtype=h5py.string_dtype())
REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (Path.unlink, r"result\.h5: expected a result file, found nothing"),
    "a text": (lambda path: path.write_text("time,force"), "found a file that is not HDF5. Proc"),
    "empty": (lambda path: path.write_bytes(b""), "found an empty file. Proc"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:-1000]), "a whole .*truncated"),
    "foreign": (foreign, "found an HDF5 file that labpipe did not make"),
    "newer": (
        with_attribute("labpipe_schema", 3),
        r"labpipe_schema: expected 2, the schema that this version reads, "
        r"found a file made by a newer labpipe, schema 3\. Update labpipe\.",
    ),
    "no UTF-8": (with_attribute("specimen_type", NO_UTF_8), "found a damaged one"),
    "a flipped bit": (with_damaged_chunk, r"found a damaged one \(.*(checksum|filter|read)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_whole_result_file_is_refused(case: str, path: Path) -> None:
    change, message = REFUSED[case]
    change(path)
    with pytest.raises(StoreError, match=message):
        read_result(path)


def as_in_schema_1(root: h5py.File) -> None:
    """Turn a result file into one of schema 1.

    Reasons are one text, remarks are in methods, tables are compounds, and there are no budgets.
    """
    root.attrs["labpipe_schema"] = 1
    results = [name for name in root["results"] if name != "table"]
    for name in (*(f"results/{result}" for result in results), "bending", "bending/law"):
        attributes = root[name].attrs
        pairs = zip(attributes["reason_codes"], attributes["reason_messages"], strict=True)
        attributes["reason"] = "; ".join(f"{code}: {message}" for code, message in pairs)
        del attributes["reason_codes"], attributes["reason_messages"]
    for result in (root["results"][result].attrs for result in results):
        if result["remark"]:
            result["method"] += f"; {result['remark']}"
        for name in ("made_of", "remark", "estimate", "seal"):
            result.pop(name, None)
    before_columns(root)
    del root["budgets"]


def test_a_file_of_schema_1_is_read(tmp_path: Path) -> None:
    result = with_slips(replace(build_result(cycles=1, half_cycle=4.0), bending=some_bending()))
    several = (
        Reason("frozen_channel", "the force stands still; for 3 s: from 1 s; is it connected?"),
        Reason("gap", "4 samples are missing"),
    )
    first, *rest = result.results
    doubtful = replace(
        first, status=Status.DOUBTFUL, reasons=several, remark="3 N of slips added back"
    )
    how = f"{first.name} / peak force; errors independent"
    share = replace(first, name="share", method=how, made_of=first.name)
    result = replace(result, results=(doubtful, share, *rest))
    write_result(result, tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5", "a") as root:
        as_in_schema_1(root)
    bare = tuple(replace(one, budget=(), estimate=None) for one in result.results)
    assert not differences(read_result(tmp_path / "result.h5"), replace(result, results=bare))
    assert read_outcome(tmp_path / "result.h5").results == bare


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("curve/force.unit", r"/curve/force: expected unit 'N', found 'mN'"),
        ("shape/positions.axes", r"/shape/positions: expected axes 'frame, point, xyz', found"),
        ("curve/slips/drop.unit", r"/curve/slips/drop: expected unit 'N', found 'mN'"),
        ("curve/lines/slope.axes", r"/curve/lines/slope: expected axes 'line', found 'mN'"),
        ("curve/time.unit", r"/curve/branches/start_time: expected unit 'mN', found 's'"),
    ],
)
def test_wrong_label(name: str, message: str, path: Path) -> None:
    dataset, _, attribute = name.partition(".")
    with h5py.File(path, "a") as root:
        root[dataset].attrs[attribute] = "mN"
    with pytest.raises(StoreError, match=message):
        read_result(path)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), cut=st.booleans())
def test_damage_anywhere_is_said_or_harmless(
    where: float, bit: int, cut: bool, written: Path, tmp_path: Path
) -> None:
    content = bytearray(written.read_bytes())
    place = int(where * len(content))
    content[place] ^= 1 << bit
    (tmp_path / "x.h5").write_bytes(content[:place] if cut else content)
    with suppress(StoreError):  # and no other
        read_result(tmp_path / "x.h5")


def replaced(
    path: Path, name: str, make: Callable[[h5py.Group, str, h5py.Dataset], object]
) -> None:
    """Put another dataset in the place of one, with its attributes."""
    with h5py.File(path, "a") as root:
        old = root[name]
        labels = dict(old.attrs)
        folder, _, last = name.rpartition("/")
        root.move(name, "kept")
        made = make(root[folder], last, root["kept"])
        if isinstance(made, h5py.Dataset):
            made.attrs.update(labels)
        del root["kept"]


def by_link(group: h5py.Group, name: str, _: h5py.Dataset) -> None:
    group[name] = h5py.ExternalLink("other.h5", "secret")


def by_virtual_dataset(group: h5py.Group, name: str, old: h5py.Dataset) -> h5py.Dataset:
    layout = h5py.VirtualLayout(shape=old.shape, dtype=old.dtype)
    layout[:] = h5py.VirtualSource("other.h5", "secret", shape=old.shape)
    return group.create_virtual_dataset(name, layout)


def by_external_storage(group: h5py.Group, name: str, old: h5py.Dataset) -> h5py.Dataset:
    where = [("/etc/hostname", 0, old.nbytes)]
    return group.create_dataset(name, shape=old.shape, dtype=old.dtype, external=where)


def too_large(group: h5py.Group, name: str, old: h5py.Dataset, **more: object) -> h5py.Dataset:
    return group.create_dataset(name, shape=(10**13,), dtype=old.dtype, **more)


ELSEWHERE = "expected all of the result in its own file, found (a link|samples that)"
CLAIMED = "expected the 10000000000000 numbers that it claims, found a part of them"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (by_link, ELSEWHERE),
        (by_virtual_dataset, ELSEWHERE),
        (by_external_storage, ELSEWHERE),
        (too_large, CLAIMED),
        (partial(too_large, chunks=(1 << 15,)), CLAIMED),
    ],
)
@pytest.mark.parametrize("name", ["curve/force", "raw/force/Out1"])
def test_samples_elsewhere_or_nowhere_are_not_read(
    path: Path, name: str, make: Callable[..., object], message: str
) -> None:
    with h5py.File(path.with_name("other.h5"), "w") as other:
        other["secret"] = np.zeros(5)
    replaced(path, name, make)
    with pytest.raises(StoreError, match=f"/?{name}: {message}"):
        read_result(path)


def test_more_than_goes_into_the_memory(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def empty(*_: object) -> None:
        message = "Unable to allocate 9 TiB"
        raise MemoryError(message)

    monkeypatch.setattr("labpipe.store.datasets.np.empty", empty)
    said = r"expected a result file that fits into the memory, found one that needs more \(Unable"
    with pytest.raises(StoreError, match=said):
        read_outcome(path)
