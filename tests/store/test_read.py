"""Result files are read whole or refused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labpipe.errors import StoreError
from labpipe.records.curve import SlipDecision
from labpipe.store.parts import RawTest
from labpipe.store.result_files import (
    read_outcome,
    read_raw,
    read_report_parts,
    read_result,
    read_stages,
    write_result,
)
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
    expected = replace(result, recordings={}, shape=None, aligned=aligned)
    with h5py.File(path, "a") as root:
        del root["raw/force/Out1"]
    assert differences(expected, read_outcome(path)) == []
    with pytest.raises(StoreError, match="expected a whole result file, found a damaged one"):
        read_result(path)
    with h5py.File(path, "a") as root:
        root["results/peak_force.1"].attrs["value"] = 0.63
    with pytest.raises(StoreError, match=r"peak_force\.1: its numbers were changed"):
        read_outcome(path)


def test_what_a_report_draws_is_part_of_the_result(tmp_path: Path) -> None:
    path, frames = tmp_path / "result.h5", np.array([0, 3, 5])
    result = replace(build_result(half_cycle=1.0), bending=some_bending())
    write_result(result, path)
    outcome, shapes, drawn_law = read_report_parts(path, lambda _, time: (frames, time[frames]))
    assert differences(read_outcome(path), outcome) == []
    assert shapes is not None
    assert result.shape is not None
    np.testing.assert_array_equal(shapes.deflection, result.shape.time[frames])
    np.testing.assert_array_equal(shapes.positions, result.shape.positions[frames][:, :, :2])
    law = some_bending().law
    assert law is not None
    assert drawn_law is not None
    np.testing.assert_array_equal(drawn_law.moment_upper, law.moment_upper)


def foreign(path: Path) -> None:
    with h5py.File(path, "w") as root:
        root["x"] = 1


def with_attribute(name: str, value: object) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with h5py.File(path, "a") as root:
            root.attrs[name] = value

    return change


def shortened(path: Path) -> None:
    with h5py.File(path, "a") as root:
        (name, *_) = root["aligned"].attrs["series"]
        root[f"aligned/{name}"].resize(3, axis=0)


def with_cycle_zero(path: Path) -> None:
    with h5py.File(path, "a") as root:
        root["curve/branches/cycle"][:] = 0


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
    "short signal": (shortened, r"found a damaged one \(\w+ has 3 values at"),
    "no cycle": (with_cycle_zero, r"found a damaged one \(a branch of cycle 0: "),
    "a flipped bit": (with_damaged_chunk, r"found a damaged one \(.*(checksum|filter|read)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_whole_result_file_is_refused(case: str, path: Path) -> None:
    change, message = REFUSED[case]
    change(path)
    with pytest.raises(StoreError, match=message):
        read_result(path)


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


WAYS = ("link", "virtual", "external", "sparse", "sparse in chunks")


def move_elsewhere(group: h5py.Group, name: str, how: str) -> None:
    """Put another data set in the place of one, with its attributes."""
    dataset = group[name]
    labels, shape, kind = dict(dataset.attrs), dataset.shape, dataset.dtype
    other_file = Path(group.file.filename).with_name("other.h5")
    with h5py.File(other_file, "w") as file:
        file["secret"] = np.zeros(shape)
    del group[name]
    if how == "link":
        group[name] = h5py.ExternalLink(str(other_file), "secret")
        return
    if how == "virtual":
        layout = h5py.VirtualLayout(shape=shape, dtype=kind)
        layout[:] = h5py.VirtualSource(str(other_file), "secret", shape=shape)
        group.create_virtual_dataset(name, layout)
    elif how == "external":
        group.create_dataset(name, shape=shape, dtype=kind, external=[(other_file, 0, 10**6)])
    else:
        claimed_shape = (*(1 for _ in shape[1:]), 10**13)
        chunks = (*(1 for _ in shape[1:]), 1 << 15) if "chunks" in how else None
        group.create_dataset(name, shape=claimed_shape, dtype=kind, chunks=chunks)
    group[name].attrs.update(labels)


ELSEWHERE = "expected all of the result in its own file, found (a link|samples that)"
CLAIMED = "expected the 10000000000000 numbers that the file states, found fewer"


@pytest.mark.parametrize("how", WAYS)
@pytest.mark.parametrize("name", ["curve/force", "raw/force/Out1"])
def test_samples_elsewhere_or_nowhere_are_not_read(path: Path, name: str, how: str) -> None:
    with h5py.File(path, "a") as root:
        move_elsewhere(root[name].parent, name.rpartition("/")[2], how)
    message = CLAIMED if "sparse" in how else ELSEWHERE
    with pytest.raises(StoreError, match=f"/?{name}: {message}"):
        read_result(path)


def test_more_than_goes_into_the_memory(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def empty(*_: object, **__: object) -> None:
        message = "Unable to allocate 9 TiB"
        raise MemoryError(message)

    monkeypatch.setattr("labpipe.store.datasets.np.empty", empty)
    expected = (
        r"expected a result file that fits into memory, found one that needs more memory \(Unable"
    )
    with pytest.raises(StoreError, match=expected):
        read_outcome(path)
