from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats
from labpipe.results.measured_law import (
    LawBasis,
    LawData,
    choose_knots,
    divide_wire,
    fit_law,
    refine_law,
)

LENGTH, FRAMES = 0.1, 60


PLACES: Floats = np.linspace(0.01, 0.095, 7)


BASIS = choose_knots(0.06, 5)


LAW: Floats = np.array([180.0, 200.0, 240.0, 300.0, 340.0])


def loading(
    basis: LawBasis = BASIS, law: Floats = LAW, *, noise: float = 0.0, seed: int = 0
) -> LawData:
    """Moments that grow and fall linearly towards the tip, and markers where a law has them."""
    points, marker_points = divide_wire(PLACES, LENGTH)
    shape = 1.0 - points / LENGTH
    blank = LawData(
        arc_length=points,
        marker_points=marker_points,
        moment=0.06 * np.linspace(0.02, 1.0, FRAMES)[:, None] * shape,
        moment_at_rest=-0.002 * shape,
        angle_at_rest=-0.01 * points / LENGTH,
        markers=np.zeros((FRAMES, len(PLACES), 2)),
        markers_at_rest=np.zeros((len(PLACES), 2)),
        rest_weight=5.0,
        centre_offset=0.0008,
    )
    moved = blank.compute_displacement(blank.compute_rotations(basis) @ law)
    rng = np.random.default_rng(seed)
    markers = np.stack(np.split(moved, 2, axis=1), axis=2)
    at_rest = noise / np.sqrt(5.0) * rng.standard_normal((len(PLACES), 2))
    markers = markers + noise * rng.standard_normal(markers.shape)
    return replace(blank, markers=markers, markers_at_rest=at_rest)


@pytest.mark.parametrize(
    ("markers", "length", "points"),
    [([1.0], 2.0, [0.0, 1.0, 2.0]), ([3.0], 4.0, [0.0, 1.5, 3.0, 4.0]), ([], 1.0, [0.0, 1.0])],
)
def test_a_wire_is_divided_into_steps_of_at_most_1_5_mm(
    markers: list[float], length: float, points: list[float]
) -> None:
    divided, numbers = divide_wire(1e-3 * np.array(markers), 1e-3 * length)
    assert 1e3 * divided == pytest.approx(points)
    assert 1e3 * divided[numbers] == pytest.approx(markers)


def test_an_exact_law_is_found() -> None:
    """Also where markers are missing, and where they stand off: only their movement matters."""
    test, off = loading(), np.array([1e-3, -2e-3])
    gaps = test.markers.copy()
    gaps[::3, 2] = np.nan
    fit = fit_law(test, BASIS)
    assert fit.residual < 1e-9
    lost = fit_law(replace(test, markers=gaps), BASIS)
    assert lost.n_coordinates == 2 * (FRAMES * 7 - 20)
    aside = replace(test, markers=test.markers + off, markers_at_rest=test.markers_at_rest + off)
    for compliance in (fit.compliance, lost.compliance, fit_law(aside, BASIS).compliance):
        assert compliance == pytest.approx(LAW, rel=1e-6)


def test_scatter_is_as_stated() -> None:
    fits = [fit_law(loading(noise=2e-5, seed=seed), BASIS) for seed in range(40)]
    spread = np.std([fit.compliance for fit in fits], axis=0)
    stated = np.sqrt(np.mean([np.diag(fit.covariance) for fit in fits], axis=0))
    assert stated / spread == pytest.approx(np.ones(5), abs=0.35)
    assert np.mean([fit.compliance for fit in fits], axis=0) == pytest.approx(LAW, rel=0.02)


def test_a_law_never_falls() -> None:
    rigid = np.array([0.0, 0.0, 0.0, 300.0, 300.0])
    fit = fit_law(loading(law=rigid, noise=2e-5), BASIS)
    assert (fit.compliance >= 0.0).all()
    assert fit.compliance == pytest.approx(rigid, abs=12.0)


def test_a_shift_is_what_another_fit_finds() -> None:
    test = loading()
    fit = fit_law(test, BASIS)
    scaled = replace(test, moment=1.001 * test.moment)
    first, second = (fit.compute_displacement(data) for data in (test, scaled))
    again = fit_law(scaled, BASIS)
    change = again.compliance - fit.compliance
    to_first_order = fit.compute_compliance_change(second - first)
    assert to_first_order == pytest.approx(change, abs=0.02 * np.abs(change).max())


def test_no_more_knots_than_the_markers_tell_of() -> None:
    smooth, smooth_change = refine_law(loading(noise=2e-5))
    assert len(smooth.compliance) <= 13
    kinked = choose_knots(0.06, 25)
    law = np.where(kinked.knots < 0.025, 150.0, 900.0)
    sharp, sharp_change = refine_law(loading(kinked, law, noise=2e-5))
    assert len(sharp.compliance) == 25
    assert np.abs(sharp_change).max() > np.abs(smooth_change).max()


def test_moments_that_do_not_fix_the_law_are_told() -> None:
    test = loading()
    still = np.broadcast_to(test.moment_at_rest, test.moment.shape)
    for moment, message in (
        (still, "expected moments other than those at rest, found none"),
        (0.01 * test.moment, "expected markers that fix the law at every knot"),
    ):
        with pytest.raises(ValueError, match=message):
            fit_law(replace(test, moment=moment), BASIS)


BASIS_BASIS = choose_knots(0.06, 7)


amounts = st.lists(st.floats(0.0, 500.0), min_size=7, max_size=7)


@given(amounts, st.lists(st.floats(-0.08, 0.08), min_size=2, max_size=20))
def test_laws_are_odd_and_never_fall(compliance: list[float], moment: list[float]) -> None:
    at, weights = np.sort(np.array(moment)), np.array(compliance)
    curvature = BASIS_BASIS.compute_curvatures(at) @ weights
    assert BASIS_BASIS.compute_curvatures(-at) @ weights == pytest.approx(-curvature)
    assert (np.diff(curvature) >= -1e-9).all()


@given(amounts, st.floats(1e-4, 0.08))
def test_slopes_are_those_of_the_values(compliance: list[float], moment: float) -> None:
    weights, step = np.array(compliance), 1e-7
    ends = BASIS_BASIS.compute_curvatures(np.array([moment - step, moment + step])) @ weights
    slope = float((ends[1] - ends[0]) / (2.0 * step))
    moments = np.array([moment - step, moment, moment + step])
    near = BASIS_BASIS.compute_compliances(moments) @ weights
    assert near.min() - 1e-3 <= slope <= near.max() + 1e-3


def test_a_law_goes_on_straight_beyond_its_last_knot() -> None:
    basis = LawBasis(np.array([0.0, 1.0, 2.0]))
    assert basis.compute_curvatures(np.array([2.0, 3.0])) @ np.array(
        [1.0, 1.0, 4.0]
    ) == pytest.approx([3.5, 7.5])


def bent_evenly(moment: float, *, height: float) -> LawData:
    """A line along which the moment is the same everywhere."""
    points, marker_points = divide_wire(PLACES, LENGTH)
    blank = np.zeros(len(points))
    return LawData(
        arc_length=points,
        marker_points=marker_points,
        moment=(blank + moment)[None],
        moment_at_rest=blank,
        angle_at_rest=blank,
        markers=np.full((1, len(PLACES), 2), np.nan),
        markers_at_rest=np.zeros((len(PLACES), 2)),
        rest_weight=1.0,
        centre_offset=height,
    )


@pytest.mark.parametrize("height", [0.0, 0.0008])
def test_a_constant_moment_bends_into_a_circle(height: float) -> None:
    compliance, moment = 200.0, 0.05
    data = bent_evenly(moment, height=height)
    moved = data.compute_displacement(data.compute_rotations(BASIS) @ np.full(5, compliance))
    curvature = compliance * moment
    turn, radius = curvature * PLACES, 1.0 / curvature - height
    x = radius * np.sin(turn) - PLACES
    y = 1.0 / curvature - radius * np.cos(turn) - height
    assert moved[0] == pytest.approx(np.concatenate([x, y]), abs=2e-6)


def test_derivatives_are_those_of_the_movement() -> None:
    compliance = np.array([180.0, 200.0, 240.0, 300.0, 280.0])
    data = bent_evenly(0.05, height=0.0008)
    turns = data.compute_rotations(BASIS)
    slopes = data.compute_derivatives(turns, compliance)
    for knot, step in enumerate(1e-3 * np.eye(5)):
        more, less = (
            data.compute_displacement(turns @ (compliance + sign * step)) for sign in (1.0, -1.0)
        )
        assert slopes[..., knot] == pytest.approx((more - less) / 2e-3, abs=1e-9)
