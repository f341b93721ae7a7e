"""Laws found again from shapes that they made, and how far they scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
