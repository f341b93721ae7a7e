"""Mean curves of groups and their bands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.statistics.groups import (
    _describe_gaps,
    compute_band,
    compute_simultaneous_quantile,
    interpolate_curves,
)
from tests.builders.campaigns import built, make, said, samples, stiffness

Curve = tuple[Floats, Floats]


def line(slope: float, start: float = 0.0, stop: float = 0.02, n: int = 50) -> Curve:
    path = np.linspace(start, stop, n)
    return path, slope * path


def test_only_where_every_curve_has_data() -> None:
    shared = interpolate_curves([line(1e3, 0.001, 0.02), line(2e3, 0.0, 0.015, 37)])
    assert (shared.displacement[0], shared.displacement[-1]) == (0.001, 0.015)
    np.testing.assert_allclose(shared.force[0], 1e3 * shared.displacement, rtol=1e-12)
    np.testing.assert_allclose(shared.force[1], 2e3 * shared.displacement, rtol=1e-12)


def test_bands_of_two_and_of_three_curves() -> None:
    """Pointwise of two; curves of different slope depend on one number, with one band."""
    band = compute_band(interpolate_curves([line(1e3), line(1.2e3)]), members="spool means")
    np.testing.assert_allclose(band.upper - band.mean, 12.7062 * 100 * band.displacement, rtol=1e-5)
    assert np.isnan(band.upper_all).all()
    assert str(band.reason).startswith("two_curves: no simultaneous band over two spool means")
    band = compute_band(interpolate_curves([line(slope, 0.001) for slope in (1e3, 1.1e3, 1.3e3)]))
    np.testing.assert_allclose(band.upper_all, band.upper, rtol=1e-4)


def test_simultaneous_is_never_narrower_and_never_beyond_bonferroni() -> None:
    rng = np.random.default_rng(0)
    rough = compute_simultaneous_quantile(rng.normal(size=(5, 200)))
    smooth = compute_simultaneous_quantile(np.outer(rng.normal(size=5), np.linspace(1.0, 2.0, 200)))
    assert smooth == pytest.approx(2.7764, abs=1e-3)
    # t with 4 degrees of freedom that leaves 0.05 / 200 outside, two-sided
    assert rough == pytest.approx(12.27, abs=0.05)


@pytest.mark.parametrize("angle", [0.5, 1.0, 2.0])
def test_simultaneous_in_closed_form(angle: float) -> None:
    """Three curves whose residuals turn by an angle; P(t > c) = (1 - c / sqrt(2 + c^2)) / 2."""
    turn = np.linspace(0.0, angle, 1000)
    one, other = np.array([1.0, -1.0, 0.0]) / 2**0.5, np.array([1.0, 1.0, -2.0]) / 6**0.5
    c = compute_simultaneous_quantile(np.outer(one, np.cos(turn)) + np.outer(other, np.sin(turn)))
    outside = 1.0 - c / (2.0 + c**2) ** 0.5 + angle / np.pi * (1.0 + c**2 / 2.0) ** -0.5
    assert outside == pytest.approx(0.05, rel=1e-9)


@given(st.integers(3, 6), st.integers(0, 500), st.floats(-50.0, 50.0), st.floats(0.1, 10.0))
def test_moves_scales_and_does_not_mind_the_order(
    n: int, seed: int, shift: float, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    curves = [(line(1.0)[0], np.cumsum(rng.normal(0.5, 1.0, 50))) for _ in range(n)]
    band = compute_band(interpolate_curves(curves))
    moved = compute_band(
        interpolate_curves([(path, scale * force + shift) for path, force in curves[::-1]])
    )
    for name in ("mean", "lower", "upper", "lower_all", "upper_all"):
        expected = scale * getattr(band, name) + shift
        np.testing.assert_allclose(getattr(moved, name), expected, rtol=1e-6, atol=1e-6 * scale)
    assert moved.n == n


def test_block_means() -> None:
    assert average_blocks(np.arange(6.0), 3).tolist() == [0.5, 2.5, 4.5]
    assert average_blocks(np.arange(7.0), 3).tolist() == [0.5, 2.5, 5.0]
    assert average_blocks(np.arange(4.0), 9).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert average_blocks(np.zeros(0), 9).tolist() == []
    assert np.isnan(average_blocks(np.array([1.0, np.nan, 2.0, 4.0]), 2)).tolist() == [True, False]


def test_three_curves_have_intervals_at_three_displacements() -> None:
    """A quarter, half, all of 20 mm; over three t is 4.303."""
    group = built(samples()[:3])
    band = group.band
    assert (band.n, band.has_band) == (3, False)
    shown = 1e3 * band.displacement[band.interval_indices]
    assert shown.tolist() == pytest.approx([5.0, 10.0, 20.0])
    force = np.array([sample.loading[0].force for sample in group.samples])
    rows = [int(np.argmin(abs(group.samples[0].loading[0].displacement - x))) for x in (0.01,)]
    half = 4.302653 * force[:, rows].std(axis=0, ddof=1) / np.sqrt(3)
    middle = band.interval_indices[1]
    assert 0.5 * (band.upper - band.lower)[middle] == pytest.approx(float(half[0]), rel=0.05)
    assert np.isnan(band.lower_all).all()
    band = built([make("s1", rows, 50.0 + rows) for rows in range(6)]).band
    assert (band.reason, band.has_band, len(band.interval_indices)) == (None, True, 0)
    assert np.isfinite(band.upper_all).all()


def test_one_missing_point_of_a_grid_is_a_gap() -> None:
    grid = 1e-3 * np.array([0.0, 1.0, 2.0, 4.0, 5.0, 8.0])
    assert _describe_gaps(grid) == ["2 mm to 4 mm", "5 mm to 8 mm"]
    assert _describe_gaps(grid[:3]) == _describe_gaps(grid[:1]) == []


def test_scaled_band_without_a_peak_force() -> None:
    members = samples()[:3]
    failed = Result(
        "peak_force.1", None, "N", status=Status.FAILED, reasons=(Reason("no_curve", "none"),)
    )
    members[1] = replace(members[1], results=(stiffness(50.0), failed))
    members[2] = replace(members[2], results=(stiffness(50.0),))
    group = built(members, scaled=True)
    assert group.scaled_band is not None
    # The third has no such result, so the largest force of its curve stands in.
    assert group.scaled_band.n == 2
    assert said(group)["no_peak_force"] == (
        "not in the mean of force / peak force, without a peak force: s1-2"
    )
