"""Recordings come back from the file as they went in, whatever their names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.records.curve import Aligned
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.store.read import read_result
from labpipe.store.write import write_result
from tests.store.builders_result import (
    build_result,
    differences,
)

_NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)
_SMALL = build_result(half_cycle=0.1, cycles=1, force_rate=50.0)


def test_one_clock_is_called_time(tmp_path: Path) -> None:
    one = Recording(
        "dspace-csv",
        clocks=(Clock("raster 1", np.arange(3.0)),),
        channels=(Channel("F/x", "p", np.arange(3.0), "raster 1", ""),),
    )
    given_result = replace(_SMALL, recordings={"frame": one})
    write_result(given_result, tmp_path / "result.h5")
    assert differences(given_result, read_result(tmp_path / "result.h5")) == []
    with h5py.File(tmp_path / "result.h5") as root:
        assert root["raw/frame/time"].attrs["clock"] == "raster 1"
        assert root["raw/frame/F_x"].attrs["name"] == "F/x"


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
        _SMALL,
        recordings={"force": recording},
        aligned=Aligned(array, {}),
        display=texts,
        test_yaml="".join(names),
    )
    write_result(given_result, path)
    assert differences(given_result, read_result(path)) == []
