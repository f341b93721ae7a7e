"""What the library's own calls make is what h5py would make, and h5py reads it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from labpipe.store.hdf5_objects import (
    LEVEL,
    get_text,
    make_dataset,
    open_dataset,
    set_number,
    set_text,
    set_texts,
)


@pytest.mark.parametrize("values", [np.zeros((5, 3)), np.arange(4), np.zeros((0, 2), np.uint8)])
def test_datasets_are_those_of_h5py(values: np.ndarray, tmp_path: Path) -> None:
    chunk = tuple(max(size, 1) for size in values.shape)
    with h5py.File(tmp_path / "a.h5", "w") as root:
        made = make_dataset(root, "made", values, chunk)
        wanted = root.create_dataset(
            "wanted",
            shape=values.shape,
            maxshape=tuple(size or None for size in values.shape),
            dtype=values.dtype,
            chunks=chunk,
            shuffle=True,
            compression="gzip",
            compression_opts=LEVEL,
            fletcher32=True,
            track_times=False,
        )
        assert made.id.get_create_plist() == wanted.id.get_create_plist()
        assert made.id.get_type() == wanted.id.get_type()
        assert (made.shape, made.maxshape) == (wanted.shape, wanted.maxshape)
        assert open_dataset(root, "made") == made


def test_texts_end_in_a_zero_and_are_declared_ascii(tmp_path: Path) -> None:
    texts = np.array(["µ".encode(), b"abc"], dtype="S4")
    with h5py.File(tmp_path / "a.h5", "w") as root:
        made = make_dataset(root, "texts", texts, (2,))
        made[...] = texts
        kind = made.id.get_type()
        assert (kind.get_strpad(), kind.get_cset()) == (h5py.h5t.STR_NULLTERM, h5py.h5t.CSET_ASCII)
        assert [text.decode() for text in made[()]] == ["µ", "abc"]


def test_texts_are_read_as_h5py_reads_them(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root.attrs["text"] = "Größe"
        root.attrs["nothing"] = ""
        root.attrs["number"] = 3
        root.attrs["texts"] = ["a", "b"]
        root.attrs["fixed"] = np.bytes_(b"abc")
        root.attrs.create("bad", np.array(b"A2\xff", dtype=h5py.string_dtype()))
        assert [get_text(root, name) for name in ("text", "nothing")] == ["Größe", ""]
        assert (get_text(root, "number"), get_text(root, "fixed")) == (3, b"abc")
        assert list(get_text(root, "texts")) == ["a", "b"]
        with pytest.raises(UnicodeDecodeError):
            get_text(root, "bad")
        with pytest.raises(KeyError):
            get_text(root, "none")


def test_attributes_come_back(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        set_text(root, "text", "Größe\n" * 20_000)
        set_text(root, "nothing", "")
        set_texts(root, "texts", ("a", "", "線"))
        set_texts(root, "none", ())
        set_number(root, "whole", 3)
        set_number(root, "broken", np.nan)
    with h5py.File(tmp_path / "a.h5") as root:
        found = root.attrs
        assert (found["text"], found["nothing"]) == ("Größe\n" * 20_000, "")
        assert (list(found["texts"]), list(found["none"])) == (["a", "", "線"], [])
        assert (found["whole"], found["whole"].dtype) == (3, np.int64)
        assert np.isnan(found["broken"])
