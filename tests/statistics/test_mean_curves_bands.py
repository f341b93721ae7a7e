"""Mean curves and their bands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats
from labpipe.statistics.mean_curves import (
    common_curves,
    mean_band,
    simultaneous_quantile,
)

Curve = tuple[Floats, Floats]


def line(slope: float, start: float = 0.0, stop: float = 0.02, n: int = 50) -> Curve:
    path = np.linspace(start, stop, n)
    return path, slope * path


def test_only_where_every_curve_has_data() -> None:
    shared = common_curves([line(1e3, 0.001, 0.02), line(2e3, 0.0, 0.015, 37)])
    assert (shared.displacement[0], shared.displacement[-1]) == (0.001, 0.015)
    np.testing.assert_allclose(shared.force[0], 1e3 * shared.displacement, rtol=1e-12)
    np.testing.assert_allclose(shared.force[1], 2e3 * shared.displacement, rtol=1e-12)


def test_a_gap_is_not_bridged() -> None:
    path, force = line(1e3, n=41)
    force = force.copy()
    force[10:13] = np.nan
    shared = common_curves([(path, force), line(1e3)])
    inside = (shared.displacement > path[9]) & (shared.displacement < path[13])
    assert not inside.any()
    assert shared.displacement[-1] == path[-1]


def test_a_point_of_unknown_displacement_is_a_gap() -> None:
    path, force = (values.copy() for values in line(1e3, n=41))
    path[20] = np.nan
    shared = common_curves([(path, force), line(1e3)])
    assert not ((shared.displacement > path[19]) & (shared.displacement < path[21])).any()


def test_blank_ends_shorten_the_range() -> None:
    path, force = line(1e3, n=41)
    force = np.where((path < 0.002) | (path > 0.018), np.nan, force)
    shared = common_curves([(path, force), line(1e3)])
    assert 0.002 <= shared.displacement[0] < shared.displacement[-1] <= 0.018


def test_no_overlap_names_the_ranges() -> None:
    shared = common_curves([line(1.0, 0.0, 0.01), line(1.0, 0.012, 0.02)], ["T1", "T2"])
    assert str(shared.reason) == (
        "no_overlap: no displacement that every curve has: T2 begins at 12 mm, T1 ends at 10 mm"
    )
    band = mean_band(shared)
    assert (len(band.displacement), band.reason) == (0, shared.reason)


def test_nothing_to_average() -> None:
    assert str(common_curves([]).reason) == "empty_group: there is no curve to average"
    blank = (np.array([0.0, 0.01]), np.array([np.nan, np.nan]))
    unknown = (np.array([np.nan]), np.array([1.0]))
    shared = common_curves([blank, line(1.0), unknown])
    assert str(shared.reason) == "no_data: no curve to average in curve 1, curve 3"


def test_one_curve_has_no_band() -> None:
    band = mean_band(common_curves([line(1e3)]))
    np.testing.assert_allclose(band.mean, 1e3 * band.displacement)
    assert str(band.reason) == "one_curve: a band needs the scatter of two curves, there is one"
    for edge in (band.lower, band.upper, band.lower_all, band.upper_all):
        assert np.isnan(edge).all()


def test_two_curves_have_a_pointwise_band_only() -> None:
    band = mean_band(common_curves([line(1e3), line(1.2e3)]), over="spool means")
    np.testing.assert_allclose(band.upper - band.mean, 12.7062 * 100 * band.displacement, rtol=1e-5)
    assert np.isnan(band.upper_all).all()
    assert str(band.reason) == (
        "two_curves: no simultaneous band over two spool means, which may cross and then show no "
        "scatter at all"
    )


def test_curves_that_differ_in_slope_alone_have_one_band() -> None:
    # The whole curve hangs on one number, so both bands are that of t with 2 degrees of freedom.
    band = mean_band(common_curves([line(slope, 0.001) for slope in (1e3, 1.1e3, 1.3e3)]))
    np.testing.assert_allclose(band.upper_all, band.upper, rtol=1e-4)


def test_identical_curves_have_a_band_without_width() -> None:
    band = mean_band(common_curves([line(1e3)] * 4))
    np.testing.assert_allclose(band.lower_all, band.mean)
    np.testing.assert_allclose(band.upper_all, band.mean)
    assert band.n == 4


def test_simultaneous_is_never_narrower_and_never_beyond_bonferroni() -> None:
    rng = np.random.default_rng(0)
    rough = simultaneous_quantile(rng.normal(size=(5, 200)))
    smooth = simultaneous_quantile(np.outer(rng.normal(size=5), np.linspace(1.0, 2.0, 200)))
    assert smooth == pytest.approx(2.7764, abs=1e-3)
    # t with 4 degrees of freedom that leaves 0.05 / 200 outside, two-sided
    assert rough == pytest.approx(12.27, abs=0.05)


@given(st.integers(3, 6), st.integers(0, 500), st.floats(-50.0, 50.0), st.floats(0.1, 10.0))
def test_moves_scales_and_does_not_mind_the_order(
    n: int, seed: int, shift: float, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    curves = [(line(1.0)[0], np.cumsum(rng.normal(0.5, 1.0, 50))) for _ in range(n)]
    first = mean_band(common_curves(curves))
    moved = mean_band(
        common_curves([(path, scale * force + shift) for path, force in curves[::-1]])
    )
    for name in ("mean", "lower", "upper", "lower_all", "upper_all"):
        expected = scale * getattr(first, name) + shift
        np.testing.assert_allclose(getattr(moved, name), expected, rtol=1e-6, atol=1e-6 * scale)
    assert moved.n == n
