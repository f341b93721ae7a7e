"""Result files are read whole or refused, those of earlier schemas, too."""

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
from labpipe.store.stored_parts import method_parts
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


@pytest.mark.parametrize("decision", [None, *SlipDecision])
def test_outcome_is_the_result_without_what_only_processing_needs(
    decision: SlipDecision | None, tmp_path: Path
) -> None:
    result = build_result(half_cycle=1.0)
    result = result if decision is None else with_slips(result, decision)
    write_result(result, tmp_path / "result.h5")
    kept = result.aligned if decision is SlipDecision.REPAIRED else None
    wanted = replace(result, recordings={}, shape=None, aligned=kept)
    assert differences(wanted, read_outcome(tmp_path / "result.h5")) == []


def test_stages_are_the_result_without_recordings(written: Path) -> None:
    wanted = replace(read_result(written), recordings={}, bending=None)
    assert differences(wanted, read_stages(written)) == []


def test_what_a_report_draws_is_part_of_the_result(written: Path, tmp_path: Path) -> None:
    whole, wanted = read_result(written), np.array([0, 3, 5])
    found = read_drawable(written, lambda _, time: (wanted, time[wanted]))
    assert differences(read_outcome(written), found.result) == []
    assert found.shapes is not None
    assert whole.shape is not None
    np.testing.assert_array_equal(found.shapes.deflection, whole.shape.time[wanted])
    np.testing.assert_array_equal(found.shapes.positions, whole.shape.positions[wanted][:, :, :2])
    assert found.law is None
    bent = replace(build_result(cycles=1, half_cycle=4.0), bending=some_bending())
    law = some_bending().law
    write_result(bent, tmp_path / "result.h5")
    found = read_drawable(tmp_path / "result.h5", lambda _, time: (wanted, time[wanted]))
    assert found.law is not None
    assert law is not None
    np.testing.assert_array_equal(found.law.moment_upper, law.moment_upper)


def test_outcome_is_read_with_the_recordings_damaged(path: Path) -> None:
    with h5py.File(path, "a") as root:
        del root["raw/force/Out1"]
    assert read_outcome(path).curve is not None
    with pytest.raises(StoreError, match="expected a whole result file, found a damaged one"):
        read_result(path)


def test_a_file_from_before_there_were_budgets(tmp_path: Path) -> None:
    made = build_result(half_cycle=1.0)
    write_result(made, tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5", "a") as root:
        assert {name: column[1] for name, column in root["budgets"].items()} == {
            "result": b"peak_force.1",
            "cause": b"scale of the force",
            "change": -0.004,
            "unit": b"N",
            "share": pytest.approx(0.64),
            "is_common": 1,
        }
        del root["budgets"]
        for name in ("estimate", "seal"):
            del root["results/peak_force.1"].attrs[name]
    found = read_outcome(tmp_path / "result.h5").results
    assert found == tuple(replace(result, budget=(), estimate=None) for result in made.results)


def test_a_number_that_was_changed_is_refused(tmp_path: Path) -> None:
    write_result(build_result(half_cycle=1.0), tmp_path / "result.h5")
    with h5py.File(tmp_path / "result.h5", "a") as root:
        root["results/peak_force.1"].attrs["value"] = 0.63
    with pytest.raises(StoreError, match=r"peak_force\.1: its numbers were changed"):
        read_outcome(tmp_path / "result.h5")


TABLES = {
    "budgets": layout.BUDGET_TABLE,
    "curve/branches": layout.BRANCH_TABLE,
    "curve/slips": layout.SLIP_TABLE,
    "curve/lines": layout.LINE_TABLE,
}


def before_columns(root: h5py.File) -> None:
    """Turn a result file into one from before tables were columns: compounds, UTF-8, no scales."""
    for name, table in TABLES.items():
        columns = {column: root[name][column][()] for column in table.columns}
        kinds = [(each, values.dtype.str) for each, values in columns.items()]
        rows = np.array(list(zip(*columns.values(), strict=True)), dtype=kinds)
        del root[name]
        root[name] = rows
        root[name].attrs["axes"] = table.axis
    for name in layout.NOTE_COLUMNS:
        found = root["quality"][name]
        labels = {label: found.attrs[label] for label in ("unit", "axes")}
        texts = found[()]
        del root["quality"][name]
        kind = h5py.string_dtype("utf-8", texts.dtype.itemsize)
        root["quality"].create_dataset(name, data=texts.astype(kind)).attrs.update(labels)
    del root["results/table"], root.attrs["date"], root.attrs["operator"]


def test_a_file_from_before_tables_were_columns(path: Path, written: Path) -> None:
    with h5py.File(path, "a") as root:
        before_columns(root)
        assert root["curve/slips"].dtype.names[0] == "position"
    assert differences(read_result(written), read_result(path)) == []


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"none\.h5: expected a result file, found nothing"):
        read_result(tmp_path / "none.h5")


@pytest.mark.parametrize(
    ("content", "found"), [(b"time,force\n", "a file that is not HDF5"), (b"", "an empty file")]
)
def test_not_hdf5(content: bytes, found: str, tmp_path: Path) -> None:
    (tmp_path / "x.h5").write_bytes(content)
    with pytest.raises(StoreError, match=rf"x\.h5: expected a result file, found {found}\. Proc"):
        read_result(tmp_path / "x.h5")


def test_truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(StoreError, match=r"expected a whole result file, found .*truncated"):
        read_raw(path)


def test_foreign_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "x.h5", "w") as root:
        root["x"] = 1
    with pytest.raises(StoreError, match="found an HDF5 file that labpipe did not make"):
        read_result(tmp_path / "x.h5")


def test_newer_schema(path: Path) -> None:
    with h5py.File(path, "a") as root:
        root.attrs["labpipe_schema"] = 3
    message = (
        r"result\.h5, labpipe_schema: expected 2, the schema that this version reads, "
        r"found a file made by a newer labpipe, schema 3\. Update labpipe\."
    )
    with pytest.raises(StoreError, match=message):
        read_result(path)


def glued(root: h5py.File) -> None:
    """Turn a result file into one of schema 1: reasons are one text, remarks are in methods."""
    root.attrs["labpipe_schema"] = 1
    results = [each for each in root["results"] if each != "table"]
    for name in (*(f"results/{result}" for result in results), "bending", "bending/law"):
        if name in root:
            attributes = root[name].attrs
            told = zip(attributes["reason_codes"], attributes["reason_messages"], strict=True)
            attributes["reason"] = "; ".join(f"{code}: {message}" for code, message in told)
            del attributes["reason_codes"], attributes["reason_messages"]
    for result in (root["results"][result].attrs for result in results):
        if result["remark"]:
            result["method"] += f"; {result['remark']}"
        del result["made_of"], result["remark"]


def test_a_file_of_schema_1_is_read(tmp_path: Path) -> None:
    result = replace(build_result(cycles=1, half_cycle=4.0), bending=some_bending())
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
        glued(root)
    assert not differences(read_result(tmp_path / "result.h5"), result)
    assert read_outcome(tmp_path / "result.h5").results == result.results


@pytest.mark.parametrize(
    ("name", "attribute", "text"),
    [
        ("curve/force", "unit", r"/curve/force: expected unit 'N', found 'mN'"),
        ("shape/positions", "axes", r"/shape/positions: expected axes 'frame, point, xyz', found"),
        ("curve/slips/drop", "unit", r"/curve/slips/drop: expected unit 'N', found 'mN'"),
        ("curve/lines/slope", "axes", r"/curve/lines/slope: expected axes 'line', found 'mN'"),
        ("curve/time", "unit", r"/curve/branches/start_time: expected unit 'mN', found 's'"),
    ],
)
def test_wrong_label(name: str, attribute: str, text: str, path: Path) -> None:
    with h5py.File(path, "a") as root:
        root[name].attrs[attribute] = "mN"
    with pytest.raises(StoreError, match=text):
        read_result(path)


def test_damaged_chunk(path: Path) -> None:
    with h5py.File(path) as root:
        chunk = root["raw/force/Out1"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 0x10
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"found a damaged one \(.*(checksum|filter|read)"):
        read_result(path)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
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


@pytest.mark.parametrize("make", [by_link, by_virtual_dataset, by_external_storage])
@pytest.mark.parametrize("name", ["curve/force", "raw/force/Out1"])
def test_other_files_are_not_read(path: Path, name: str, make: Callable[..., object]) -> None:
    with h5py.File(path.with_name("other.h5"), "w") as other:
        other["secret"] = np.zeros(5)
    replaced(path, name, make)
    said = rf"/?{name}: expected all of the result in its own file, found (a link|samples that)"
    with pytest.raises(StoreError, match=said):
        read_result(path)


def too_large(group: h5py.Group, name: str, old: h5py.Dataset) -> h5py.Dataset:
    return group.create_dataset(name, shape=(10**13,), dtype=old.dtype, chunks=(1 << 15,))


def too_large_in_one_piece(group: h5py.Group, name: str, old: h5py.Dataset) -> h5py.Dataset:
    return group.create_dataset(name, shape=(10**13,), dtype=old.dtype)


@pytest.mark.parametrize("make", [too_large, too_large_in_one_piece])
def test_more_numbers_than_the_file_can_hold(path: Path, make: Callable[..., object]) -> None:
    replaced(path, "curve/force", make)
    said = "/curve/force: expected the 10000000000000 numbers that it claims, found a part of them"
    with pytest.raises(StoreError, match=said):
        read_outcome(path)


def test_more_than_goes_into_the_memory(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def empty(*_: object) -> None:
        message = "Unable to allocate 9 TiB"
        raise MemoryError(message)

    monkeypatch.setattr("labpipe.store.datasets.np.empty", empty)
    said = r"expected a result file that goes into the memory, found one that needs more \(Unable"
    with pytest.raises(StoreError, match=said):
        read_outcome(path)


@pytest.mark.parametrize("name", ["test", "specimen_type"])
def test_text_that_is_none(path: Path, name: str) -> None:
    with h5py.File(path, "a") as root:
        root.attrs.create(name, np.array(b"A2\xff", dtype=h5py.string_dtype()))
    with pytest.raises(StoreError, match="expected a whole result file, found a damaged one"):
        read_outcome(path)


@pytest.mark.parametrize(
    ("method", "parts"),
    [
        ("by a line", ("by a line", "", "")),
        ("stiffness / peak force", ("stiffness / peak force", "stiffness", "")),
        (
            "largest force; 3 N of slips added back",
            ("largest force", "", "3 N of slips added back"),
        ),
    ],
)
def test_what_a_method_says_beside(method: str, parts: tuple[str, str, str]) -> None:
    found = method_parts(method, ["stiffness", "energy.1"])
    assert (found["method"], found["made_of"], found["remark"]) == parts
