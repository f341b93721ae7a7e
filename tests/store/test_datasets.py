from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labpipe.store.datasets import (
    Target,
    chunk_shape,
    fletcher32,
    same_content,
    string_array,
)
from labpipe.store.hdf5_objects import LEVEL
from labpipe.store.layout import Field


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


@given(
    hnp.arrays(
        st.sampled_from([np.float64, np.int64, np.uint8]),
        hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=7),
    )
)
def test_any_array_comes_back(
    tmp_path_factory: pytest.TempPathFactory, array: np.ndarray[tuple[int, ...], np.dtype[np.void]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "array.h5"
    axes = tuple("abc"[: array.ndim])
    with h5py.File(path, "w") as root, ThreadPoolExecutor(2) as pool:
        Target(root, pool).array("x", array, Field(axes, "m"))
    with h5py.File(path) as root:
        assert root["x"][()].tobytes() == array.tobytes()
        assert root["x"].attrs["axes"] == ", ".join(axes)
        assert same_content(root["x"], array)


def test_many_chunks_and_a_part_of_one(tmp_path: Path) -> None:
    array = np.random.default_rng(0).normal(size=(30_011, 8, 3))
    with h5py.File(tmp_path / "a.h5", "w") as root, ThreadPoolExecutor(2) as pool:
        dataset = Target(root, pool).array("x", array, Field(("a", "b", "c"), "m"))
        assert dataset.id.get_num_chunks() > 20
        np.testing.assert_array_equal(dataset[()], array)
        other = array.copy()
        other[-1, -1, -1] += 1e-9
        assert not same_content(dataset, other)
        assert not same_content(dataset, array[:-1])


def test_the_same_array_is_deflated_once(tmp_path: Path) -> None:
    array = np.random.default_rng(0).normal(size=40_000)
    seen = {"one": array, "again": array.view(), "part": array[:30_000], "turned": array[::-1]}
    with h5py.File(tmp_path / "a.h5", "w") as root, ThreadPoolExecutor(2) as pool:
        target = Target(root, pool)
        for name, each in seen.items():
            target.array(name, each, Field(("a",), "m"))
        assert len(target.packed) == 3
        for name, each in seen.items():
            np.testing.assert_array_equal(root[name][()], each)


PACKS = """
import random, sys, threading
from isal import isal_zlib
different = []
for size in (41, 150, 280, 400, 1000, 20_000):
    drawn = random.Random(size)
    data = bytes(drawn.choice([0, 0, 0, 1]) for _ in range(size))
    begin, made = threading.Barrier(8), []
    def pack(data=data, begin=begin, made=made):
        begin.wait()
        made.append(isal_zlib.compress(data, int(sys.argv[1])))
    threads = [threading.Thread(target=pack) for _ in range(8)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    different += [size] if len(set(made)) > 1 else []
print(different)
"""


@pytest.mark.slow
def test_threads_pack_the_same_bytes_alike() -> None:
    """The first time counts: at level 1 one process in twelve packed them otherwise."""
    for _ in range(20):
        command = [sys.executable, "-c", PACKS, str(LEVEL)]
        ran = subprocess.run(command, capture_output=True, text=True, check=True)
        assert ran.stdout == "[]\n"


def test_chunks_are_whole_rows_of_a_quarter_megabyte() -> None:
    assert chunk_shape((3_180_000,), 8) == (32_768,)
    assert chunk_shape((15_900, 8, 3), 8) == (1365, 8, 3)
    assert chunk_shape((5,), 8) == (5,)
    assert chunk_shape((0, 3), 8) == (1, 3)
    assert chunk_shape((4, 1_000_000), 8) == (1, 1_000_000)


def test_strings_are_as_long_as_their_bytes() -> None:
    array = string_array(("ü", "", "abc"))
    assert array.dtype.itemsize == 4
    assert [bytes(text).decode() for text in array] == ["ü", "", "abc"]
    assert string_array(()).dtype.itemsize == string_array(("x",)).dtype.itemsize == 2
