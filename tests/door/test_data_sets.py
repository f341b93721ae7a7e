from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from labpipe.door.data_sets import PARTS, dataset_of
from labpipe.errors import UsageError
from labpipe.records.result import TestResult
from tests.builders.measured_bending import some_bending
from tests.store.builders_result import build_result

pytest.importorskip("xarray")


@pytest.fixture(scope="module")
def result() -> TestResult:
    return replace(build_result(half_cycle=1.0), bending=some_bending())


SIZES = {
    "curve": {"time"},
    "aligned": {"time"},
    "shape": {"time", "names", "xyz", "term", "specimen", "lab"},
    "bending": {"time", "arc_length"},
    "law": {"curvature", "knots", "knots_2"},
    "markers": {"time", "marker", "xyz"},
    "force": {"time_HostService", "time_slow raster"},
}


@pytest.mark.parametrize("part", SIZES)
def test_parts_have_their_axes_as_in_the_file(part: str, result: TestResult) -> None:
    found = dataset_of(result, part)
    assert found is not None
    assert set(found.sizes) == SIZES[part]
    assert set(found.coords) == SIZES[part] - {"term"}
    for name, variable in found.data_vars.items():
        assert isinstance(variable.attrs["units"], str), name


def test_values_are_found_by_their_axes(result: TestResult) -> None:
    shape, curve = dataset_of(result, "shape"), dataset_of(result, "curve")
    assert shape is not None
    assert curve is not None
    assert result.shape is not None
    tip = shape.positions.sel(names="pull", xyz="y")
    np.testing.assert_array_equal(tip, result.shape.positions[:, -1, 1])
    assert curve.force.attrs["units"] == "N"
    assert set(curve.data_vars) == {"displacement", "force", "branch", "cycle"}


def test_channels_of_one_name_are_told_apart(result: TestResult) -> None:
    force = dataset_of(result, "force")
    assert force is not None
    assert force["Out1"].attrs == {"units": "V", "name_in_file": "Model Root/Load Cell/Out1"}
    assert force["Out1_2"].attrs["units"] == "unknown"
    assert force["Out1_2"].dims == ("time_slow raster",)


def test_parts_that_a_test_lacks(result: TestResult) -> None:
    bare = replace(result, curve=None, aligned=None, shape=None, bending=None)
    assert [dataset_of(bare, part) for part in PARTS] == [None] * len(PARTS)


def test_without_xarray(result: TestResult, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(UsageError, match=r"expected the package, found none\. Install it: pip ins"):
        dataset_of(result, "curve")
