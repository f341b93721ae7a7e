from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.io import loadmat, savemat

from labpipe.readers.mat5 import parse_mat5


def written(variables: dict[str, Any], *, compress: bool = False) -> bytes:
    stream: Any = io.BytesIO()
    savemat(stream, variables, do_compression=compress)
    content: bytes = stream.getvalue()
    return content


@given(
    array=hnp.arrays(
        st.sampled_from(["f8", "f4", "i4", "i2", "i1", "u1", "u2", "u4", "i8", "u8"]),
        st.tuples(st.integers(0, 5), st.integers(0, 5)),
        elements={"allow_nan": False},
    ),
    compress=st.booleans(),
)
def test_numbers_are_those_of_scipy(array: np.ndarray, compress: bool) -> None:
    content = written({"a": array}, compress=compress)
    found = parse_mat5(content)["a"]
    stream: Any = io.BytesIO(content)
    wanted = loadmat(stream)["a"]
    np.testing.assert_array_equal(found, wanted.ravel(order="F"))


@given(
    text=st.text(st.characters(min_codepoint=32, max_codepoint=0xFFFF, exclude_categories=["C"]))
)
def test_text(text: str) -> None:
    assert parse_mat5(written({"a": text}))["a"] == text


@pytest.mark.parametrize("compress", [False, True])
def test_structs_struct_arrays_and_cells(compress: bool) -> None:
    pair = np.empty((1, 2), dtype=[("Name", object), ("Data", object)])
    pair[0, 0], pair[0, 1] = ("one", 1.0), ("two", np.arange(3))
    cells = np.empty((1, 2), dtype=object)
    cells[0, 0], cells[0, 1] = "text", 7.0
    variables = {"s": {"inner": {"x": 5}, "pair": pair, "cells": cells}, "t": "second"}
    found = parse_mat5(written(variables, compress=compress))
    (outer,) = found["s"]
    assert outer["inner"][0]["x"].tolist() == [5]
    assert [item["Name"] for item in outer["pair"]] == ["one", "two"]
    assert outer["pair"][1]["Data"].tolist() == [0, 1, 2]
    assert outer["cells"][0] == "text"
    assert found["t"] == "second"


def test_what_has_no_use_here_is_stepped_over() -> None:
    from scipy.sparse import csc_array

    found = parse_mat5(written({"z": np.array([1j]), "s": csc_array(np.eye(3)), "a": 1.0}))
    assert found["z"] is None
    assert found["s"] is None
    assert found["a"].tolist() == [1.0]


def test_big_endian_files() -> None:
    name, values = b"a", np.array([1.5, -2.0], dtype=">f8").tobytes()
    flags = np.array([6, 8, 6, 0], dtype=">u4").tobytes()
    dims = np.array([5, 8, 1, 2], dtype=">u4").tobytes()
    label = np.array([1, 1], dtype=">u4").tobytes() + name.ljust(8, b"\0")
    data = np.array([9, 16], dtype=">u4").tobytes() + values
    body = flags + dims + label + data
    element = np.array([14, len(body)], dtype=">u4").tobytes() + body
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    assert parse_mat5(header + element)["a"].tolist() == [1.5, -2.0]


CONTENT = written({"a": np.arange(100.0), "s": {"b": np.arange(3.0), "c": "text"}})


@pytest.mark.parametrize(
    ("at", "new", "message"),
    [
        (128, (14).to_bytes(4, "little") + (10**6).to_bytes(4, "little"), "1000000 bytes stands"),
        (len(CONTENT) - 4, None, "stands where"),
        (132 + 4, (99).to_bytes(4, "little"), "type 99 stands where numbers are due"),
        (160, (7).to_bytes(4, "little"), "100 numbers stand where 700 are promised"),
    ],
)
def test_damage_is_told(at: int, new: bytes | None, message: str) -> None:
    damaged = CONTENT[:at] if new is None else CONTENT[:at] + new + CONTENT[at + len(new) :]
    with pytest.raises(ValueError, match=message):
        parse_mat5(damaged)


def test_an_absurd_number_of_structs_is_refused_at_once() -> None:
    content = written({"s": {"b": 1.0}})
    at = content.index(np.array([1, 1], dtype="<i4").tobytes(), 128)
    many = np.array([1, 2**30], dtype="<i4").tobytes()
    with pytest.raises(ValueError, match="1073741824 parts are promised in"):
        parse_mat5(content[:at] + many + content[at + 8 :])
