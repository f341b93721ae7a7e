from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.bending.fitted_law import (
    LawBasis,
    LawShapes,
    Line,
    Loaded,
    fit_law,
    law_knots,
    refine_law,
)
from labpipe.records.arrays import Floats

LENGTH, FRAMES = 0.1, 60


PLACES: Floats = np.linspace(0.01, 0.095, 7)


BASIS = law_knots(0.06, 5)


LAW: Floats = np.array([180.0, 200.0, 240.0, 300.0, 340.0])


def loading(
    basis: LawBasis = BASIS, law: Floats = LAW, *, noise: float = 0.0, seed: int = 0
) -> Loaded:
    """Moments that grow and fall linearly towards the tip, and markers where a law has them."""
    line = Line.through(PLACES, LENGTH)
    shape = 1.0 - line.arc_length / LENGTH
    blank = Loaded(
        line=line,
        moment=0.06 * np.linspace(0.02, 1.0, FRAMES)[:, None] * shape,
        moment_at_rest=-0.002 * shape,
        angle_at_rest=-0.01 * line.arc_length / LENGTH,
        markers=np.zeros((FRAMES, len(PLACES), 2)),
        markers_at_rest=np.zeros((len(PLACES), 2)),
        rest_weight=5.0,
        centre_offset=0.0008,
    )
    moved = LawShapes.of(blank, basis).movement(law)
    rng = np.random.default_rng(seed)
    markers = np.stack(np.split(moved, 2, axis=1), axis=2)
    at_rest = noise / np.sqrt(5.0) * rng.standard_normal((len(PLACES), 2))
    markers = markers + noise * rng.standard_normal(markers.shape)
    return replace(blank, markers=markers, markers_at_rest=at_rest)


def test_an_exact_law_is_found() -> None:
    fit = fit_law(loading(), BASIS)
    assert fit.compliance == pytest.approx(LAW, rel=1e-6)
    assert fit.residual < 1e-9


def test_markers_that_are_missing_are_left_out() -> None:
    test = loading()
    markers = test.markers.copy()
    markers[::3, 2] = np.nan
    fit = fit_law(replace(test, markers=markers), BASIS)
    assert fit.compliance == pytest.approx(LAW, rel=1e-6)
    assert fit.n == 2 * (FRAMES * 7 - 20)


def test_a_marker_that_stands_off_matters_only_by_its_movement() -> None:
    test = loading()
    aside = test.markers + np.array([1e-3, -2e-3])
    fit = fit_law(
        replace(test, markers=aside, markers_at_rest=np.full((7, 2), [1e-3, -2e-3])), BASIS
    )
    assert fit.compliance == pytest.approx(LAW, rel=1e-6)


def test_scatter_is_as_stated() -> None:
    fits = [fit_law(loading(noise=2e-5, seed=seed), BASIS) for seed in range(60)]
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
    other = replace(test, moment=1.001 * test.moment)
    before, after = (LawShapes.of(each, BASIS).movement(fit.compliance) for each in (test, other))
    again = fit_law(other, BASIS)
    change = again.compliance - fit.compliance
    assert fit.shift(after - before) == pytest.approx(change, abs=0.02 * np.abs(change).max())


def test_no_more_knots_than_the_markers_tell_of() -> None:
    smooth = refine_law(loading(noise=2e-5))
    assert len(smooth.fit.compliance) <= 13
    kinked = law_knots(0.06, 25)
    law = np.where(kinked.knots < 0.025, 150.0, 900.0)
    sharp = refine_law(loading(kinked, law, noise=2e-5))
    assert len(sharp.fit.compliance) == 25
    assert np.abs(sharp.change).max() > np.abs(smooth.change).max()


def test_a_test_without_moments_is_told() -> None:
    test = loading()
    still = np.broadcast_to(test.moment_at_rest, test.moment.shape)
    with pytest.raises(ValueError, match="expected moments other than those at rest, found none"):
        fit_law(replace(test, moment=still), BASIS)


def test_moments_that_do_not_fix_the_law_are_told() -> None:
    test = loading()
    with pytest.raises(ValueError, match="expected markers that fix the law at every knot"):
        fit_law(replace(test, moment=0.01 * test.moment), BASIS)


BASIS_BASIS = law_knots(0.06, 7)


amounts = st.lists(st.floats(0.0, 500.0), min_size=7, max_size=7)


@given(amounts, st.lists(st.floats(-0.08, 0.08), min_size=2, max_size=20))
def test_laws_are_odd_and_never_fall(compliance: list[float], moment: list[float]) -> None:
    at, weights = np.sort(np.array(moment)), np.array(compliance)
    curvature = BASIS_BASIS.values(at) @ weights
    assert BASIS_BASIS.values(-at) @ weights == pytest.approx(-curvature)
    assert (np.diff(curvature) >= -1e-9).all()


@given(amounts, st.floats(1e-4, 0.08))
def test_slopes_are_those_of_the_values(compliance: list[float], moment: float) -> None:
    weights, step = np.array(compliance), 1e-7
    ends = BASIS_BASIS.values(np.array([moment - step, moment + step])) @ weights
    slope = float((ends[1] - ends[0]) / (2.0 * step))
    near = BASIS_BASIS.slopes(np.array([moment - step, moment, moment + step])) @ weights
    assert near.min() - 1e-3 <= slope <= near.max() + 1e-3


def test_a_law_goes_on_straight_beyond_its_last_knot() -> None:
    basis = LawBasis(np.array([0.0, 1.0, 2.0]))
    assert basis.values(np.array([2.0, 3.0])) @ np.array([1.0, 1.0, 4.0]) == pytest.approx(
        [3.5, 7.5]
    )


def test_equal_compliances_are_a_straight_law() -> None:
    moment = np.linspace(-0.06, 0.06, 11)
    assert BASIS_BASIS.values(moment) @ np.full(7, 200.0) == pytest.approx(200.0 * moment)


def test_knots_of_twice_as_many_hold_those_of_half() -> None:
    assert law_knots(0.06, 13).knots[::2] == pytest.approx(BASIS_BASIS.knots)
    assert (np.diff(BASIS_BASIS.knots, 2) > 0.0).all()


LENGTH_SHAPES = 0.1


PLACES_SHAPES: Floats = np.array([0.02, 0.05, 0.1])


def loaded(moment: float, *, height: float = 0.0) -> Loaded:
    line = Line.through(PLACES_SHAPES, LENGTH_SHAPES)
    points = len(line.arc_length)
    return Loaded(
        line=line,
        moment=np.full((1, points), moment),
        moment_at_rest=np.zeros(points),
        angle_at_rest=np.zeros(points),
        markers=np.full((1, 3, 2), np.nan),
        markers_at_rest=np.zeros((3, 2)),
        rest_weight=1.0,
        centre_offset=height,
    )


def test_points_fall_on_markers_and_tip() -> None:
    line = Line.through(PLACES_SHAPES, LENGTH_SHAPES)
    assert line.arc_length[line.markers] == pytest.approx(PLACES_SHAPES)
    assert (line.arc_length[0], line.arc_length[-1]) == (0.0, LENGTH_SHAPES)
    assert np.diff(line.arc_length).max() <= 0.0015 + 1e-12


@pytest.mark.parametrize("height", [0.0, 0.0008])
def test_a_constant_moment_bends_into_a_circle(height: float) -> None:
    compliance, moment = 200.0, 0.05
    basis = law_knots(0.06, 5)
    shapes = LawShapes.of(loaded(moment, height=height), basis)
    moved = shapes.movement(np.full(5, compliance))
    curvature = compliance * moment
    turn, radius = curvature * PLACES_SHAPES, 1.0 / curvature - height
    x = radius * np.sin(turn) - PLACES_SHAPES
    y = 1.0 / curvature - radius * np.cos(turn) - height
    assert moved[0] == pytest.approx(np.concatenate([x, y]), abs=2e-6)


def test_derivatives_are_those_of_the_movement() -> None:
    basis, compliance = law_knots(0.06, 5), np.array([180.0, 200.0, 240.0, 300.0, 280.0])
    shapes = LawShapes.of(loaded(0.05, height=0.0008), basis)
    moved, slopes = shapes.predict(compliance)
    assert moved.tolist() == shapes.movement(compliance).tolist()
    for knot in range(5):
        step = np.zeros(5)
        step[knot] = 1e-3
        more, less = (shapes.movement(compliance + sign * step) for sign in (1.0, -1.0))
        assert slopes[..., knot] == pytest.approx((more - less) / 2e-3, abs=1e-9)
