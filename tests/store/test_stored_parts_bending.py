from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import pytest

from labpipe.errors import StoreError
from labpipe.records.curve import Bending
from labpipe.records.quality import Reason
from labpipe.store.read import read_outcome, read_result
from labpipe.store.write import write_result
from tests.builders.measured_bending import some_bending, some_cloud
from tests.store.builders_result import build_result, differences


@pytest.mark.parametrize(
    "bending",
    [some_bending(), Bending(some_cloud(), None, Reason("no_law", "expected at least 24")), None],
    ids=["with a law", "without a law", "not asked for"],
)
def test_what_is_written_is_read(bending: Bending | None, tmp_path: Path) -> None:
    result = replace(build_result(cycles=1, half_cycle=4.0, force_rate=50.0), bending=bending)
    write_result(result, tmp_path / "result.h5")
    assert not differences(read_result(tmp_path / "result.h5"), result)
    assert read_outcome(tmp_path / "result.h5").bending is None


def test_an_array_of_another_unit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "result.h5"
    result = replace(
        build_result(cycles=1, half_cycle=4.0, force_rate=50.0), bending=some_bending()
    )
    write_result(result, path)
    with h5py.File(path, "r+") as file:
        file["bending/law/secant"].attrs["unit"] = "N*mm^2"
    with pytest.raises(StoreError, match=r"/bending/law/secant: expected unit 'N\*m\^2'"):
        read_result(path)
