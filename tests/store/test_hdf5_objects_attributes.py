from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from labpipe.store.hdf5_objects import get_number, has_attribute, is_empty


def test_numbers_lists_and_what_is_none(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as root:
        root.attrs["value"] = -1.5
        root.attrs["count"] = np.int64(7)
        root.attrs["single"] = np.float32(0.5)
        root.attrs["words"] = "x"
        root.attrs["list"] = np.array([1.0, 2.0])
        root.attrs.create("none", np.empty(0), dtype="f8")
        assert [get_number(root, name) for name in ("value", "count", "single")] == [-1.5, 7.0, 0.5]
        assert (is_empty(root, "none"), is_empty(root, "list")) == (True, False)
        assert (has_attribute(root, "list"), has_attribute(root, "gone")) == (True, False)
        with pytest.raises(ValueError, match="could not convert string"):
            get_number(root, "words")
        with pytest.raises(TypeError, match="only"):
            get_number(root, "list")
        for read in (get_number, is_empty):
            with pytest.raises(KeyError):
                read(root, "gone")
