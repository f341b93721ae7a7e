"""Arrays, texts and attributes in HDF5, as the library and h5py make them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labpipe.store.datasets import (
    GroupWriter,
    fletcher32,
    has_same_content,
    read_number,
    read_text,
    read_texts,
)
from labpipe.store.layout import DatasetSpec, make_link_name


def _hdf5_checksum(data: bytes, path: Path) -> int:
    """The checksum that the HDF5 library itself puts behind these bytes."""
    values = np.frombuffer(data, dtype=np.uint8)
    with h5py.File(path, "w") as root:
        dataset = root.create_dataset("x", data=values, chunks=values.shape, fletcher32=True)
        return int.from_bytes(dataset.id.read_direct_chunk((0,))[1][-4:], "little")


@given(st.one_of(st.binary(min_size=1, max_size=3000), st.just(b"\xff" * 2000), st.just(b"\0\0")))
def test_checksum_is_that_of_the_library(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "checksum.h5"
    assert fletcher32(data) == _hdf5_checksum(data, path)


SIDES = hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=7)


@given(hnp.arrays(st.sampled_from([np.float64, np.int64, np.uint8]), SIDES))
def test_any_array_comes_back(
    tmp_path_factory: pytest.TempPathFactory, array: np.ndarray[tuple[int, ...], np.dtype[np.void]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "array.h5"
    axes = tuple("abc"[: array.ndim])
    with h5py.File(path, "w") as root, ThreadPoolExecutor(2) as pool:
        GroupWriter(root, pool).write_array("x", array, DatasetSpec(axes, "m"))
    with h5py.File(path) as root:
        assert root["x"][()].tobytes() == array.tobytes()
        assert root["x"].attrs["axes"] == ", ".join(axes)
        assert has_same_content(root["x"], array)


def test_many_chunks_and_a_part_of_one(tmp_path: Path) -> None:
    array = np.random.default_rng(0).normal(size=(30_011, 8, 3))
    with h5py.File(tmp_path / "a.h5", "w") as root, ThreadPoolExecutor(2) as pool:
        dataset = GroupWriter(root, pool).write_array("x", array, DatasetSpec(("a", "b", "c"), "m"))
        assert dataset.id.get_num_chunks() > 20
        np.testing.assert_array_equal(dataset[()], array)
        changed = array.copy()
        changed[-1, -1, -1] += 1e-9
        assert not has_same_content(dataset, changed)
        assert not has_same_content(dataset, array[:-1])


def test_attributes_are_read_as_h5py_reads_them(tmp_path: Path) -> None:
    texts = {"text": "Größe", "nothing": ""}
    numbers = {"value": -1.5, "count": np.int64(7), "single": np.float32(0.5)}
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root.attrs.update(texts | numbers | {"texts": ["a", "ü", ""], "list": np.array([1.0, 2.0])})
        root.attrs["fixed"] = np.bytes_(b"abc")
        root.attrs.create("bad", np.array(b"A2\xff", dtype=h5py.string_dtype()))
        root.attrs.create("none", np.empty(0), dtype=h5py.string_dtype())
        assert {name: read_text(root, name) for name in texts} == texts
        assert {name: read_number(root, name) for name in numbers} == numbers
        assert (read_texts(root, "texts"), read_texts(root, "none")) == (("a", "ü", ""), ())
        for reader, name, error in (
            (read_text, "bad", UnicodeDecodeError),
            *((read_text, name, OSError) for name in ("value", "fixed")),
            (read_text, "texts", ValueError),
            (read_number, "text", TypeError),
            (read_number, "list", ValueError),
            *((reader, "gone", KeyError) for reader in (read_text, read_number, read_texts)),
        ):
            with pytest.raises(error):
                reader(root, name)


@given(st.lists(st.text(max_size=8), max_size=8))
def test_link_names_are_free_and_plain(names: list[str]) -> None:
    link_names: list[str] = ["time"]
    for name in names:
        link_names.append(make_link_name(name, link_names))
    assert len(set(link_names)) == len(link_names)
    assert not any("/" in name or " " in name or name in {"", "."} for name in link_names)
