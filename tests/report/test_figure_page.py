"""Pages of figures, and the points, lines and rigs that are drawn on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labpipe.records.arrays import Floats
from labpipe.report.figures import make_wire_shapes_page
from labpipe.report.plot_records import find_extremes, find_shape_samples, thin_flags
from tests.store.builders_result import build_result


@given(
    hnp.arrays(np.float64, st.integers(0, 400), elements=st.floats(-5, 5) | st.just(np.nan)),
    st.integers(1, 20),
)
def test_thinned_line_is_as_wide_and_as_broken_as_the_samples(values: Floats, bins: int) -> None:
    rows = find_extremes(values, n_bins=bins)
    assert (np.diff(rows) > 0).all()
    if len(values):
        assert rows[0] == 0
        assert rows[-1] == len(values) - 1
    if np.isfinite(values).any():
        assert np.nanmin(values[rows]) == np.nanmin(values)
        assert np.nanmax(values[rows]) == np.nanmax(values)
    assert np.isnan(values[rows]).any() == np.isnan(values).any()
    assert len(rows) <= max(4 * bins, 3 * bins + 2)


def test_worst_flag_of_a_stretch_wins() -> None:
    flags = np.ones((1000, 2), dtype=np.uint8)
    flags[503, 1] = 0
    flags[504, 1] = 2
    by_rank = (1, 2, 0)
    thin = thin_flags(flags, by_rank, n_bins=10)
    assert thin[:, 0].tolist() == [1] * 10
    assert thin[:, 1].tolist() == [1] * 5 + [0] + [1] * 4
    np.testing.assert_array_equal(thin_flags(flags[:7], by_rank, n_bins=10), flags[:7])
    assert thin_flags(flags[:0], by_rank, n_bins=10).shape == (0, 2)


def test_a_corner_stays_a_corner_and_a_step_a_step() -> None:
    x = np.linspace(0.0, 50.0, 2001)
    force = np.minimum(5.0 * x, 30.0 + 2.0 * x) - np.where(x > 30.0, 4.0, 0.0)
    rows = find_shape_samples(x, force, max_points=60)
    assert len(rows) < 10
    assert 10.0 in x[rows]
    assert {30.0, 30.025} <= set(x[rows].round(3).tolist())
    drawn = np.interp(x, x[rows], force[rows])
    assert np.abs(drawn - force).max() <= 0.002 * np.ptp(force)


def test_gaps_standstill_and_noise_in_bends() -> None:
    force = np.arange(100.0)
    force[40:45] = np.nan
    assert list(find_shape_samples(np.arange(100.0), force, max_points=10)) == [0, 39, 40, 45, 99]
    up = np.concatenate([np.zeros(50), np.linspace(0.0, 1.0, 50), np.zeros(50)])
    assert {50, 99, 100} <= set(find_shape_samples(np.zeros(150), up, max_points=20).tolist())
    assert find_shape_samples(np.zeros(3), np.full(3, np.nan), max_points=5).tolist() == [0]
    assert find_shape_samples(np.zeros(0), np.zeros(0), max_points=5).tolist() == []
    noise = np.random.default_rng(1).normal(size=3000)
    rows = find_shape_samples(np.arange(3000.0), noise, max_points=50)
    assert len(rows) == 50
    assert {int(noise.argmax()), int(noise.argmin()), 0, 2999} <= set(rows.tolist())


def note_on_shapes(text: str) -> str:
    result = build_result(cycles=1, half_cycle=1.0)
    return make_wire_shapes_page(replace(result, protocol_yaml=text)).note


def test_offset_of_the_markers_of_a_conduit(repository: Path) -> None:
    text = (repository / "protocols" / "conduit-bundle.yaml").read_text(encoding="utf-8")
    assert note_on_shapes(text).startswith("The centres of the markers are 8.55 mm from the axis")


@pytest.mark.parametrize("text", ["", "version: 0\nname: of an earlier grammar\n"])
def test_without_a_sound_protocol_nothing_is_known(text: str) -> None:
    assert "axis" not in note_on_shapes(text)
