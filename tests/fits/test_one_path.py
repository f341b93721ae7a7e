"""Forces brought to the displacements of one curve: exact on a line, to first order on a bend."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.one_path import OnePath, known_samples

D = np.linspace(1e-3, 5e-3, 201)
ALL = np.arange(len(D))


def test_a_sample_moved_along_the_curve_keeps_its_place_on_it() -> None:
    moved = D + np.random.default_rng(0).normal(0.0, 2e-5, (3, len(D)))
    bent, curvature = 800.0 * D - 2e4 * D**2, 2 * 2e4
    found = OnePath.of(D, bent, ALL).force(800.0 * moved - 2e4 * moved**2, moved)
    second_order = 0.5 * curvature * (moved - D) ** 2
    assert np.abs(800.0 * (moved - D)).max() > 0.02
    # Slopes at the ends are read from one side: off by the curvature over half of four steps.
    one_sided = curvature * 2 * (D[1] - D[0]) * np.abs(moved - D)
    assert (np.abs(found - bent) <= second_order + one_sided + 1e-12).all()


def test_slopes_are_local() -> None:
    kinked = np.where(D < 3e-3, 900.0, 300.0) * (D - 3e-3)
    slope = OnePath.of(D, kinked, ALL).slope
    assert slope[:90] == pytest.approx(900.0)
    assert slope[110:] == pytest.approx(300.0)
    assert slope[100] == pytest.approx(600.0)


def test_where_the_frame_stands_the_slope_is_that_of_the_stretch() -> None:
    d = np.concatenate([D[:100], np.full(40, D[100]), D[100:]])
    slope = OnePath.of(d, 500.0 * d, np.arange(len(d))).slope
    assert np.isfinite(slope).all()
    assert slope == pytest.approx(500.0)


def test_some_samples_in_another_order() -> None:
    force, d = 900.0 * D, D.copy()
    force[4] = d[9] = np.nan
    assert known_samples(d, force).tolist() == np.delete(ALL, [4, 9]).tolist()
    mixed = np.random.default_rng(0).permutation(known_samples(d, force))
    kinked = np.where(D < 3e-3, 900.0, 300.0) * (D - 3e-3)
    path, plain = OnePath.of(d, kinked, mixed), OnePath.of(D, kinked, ALL)
    assert path.slope[D[mixed] < 2.8e-3] == pytest.approx(900.0)
    assert path.displacement.tolist() == D[mixed].tolist()
    curves = kinked + np.array([[0.0], [2.0]])
    assert path.force(curves, D + 1e-5) == pytest.approx(
        plain.force(curves, D + 1e-5)[:, mixed], abs=2e-3
    )
    assert path.force(curves).tolist() == curves[:, mixed].tolist()


def test_the_same_displacements_change_nothing() -> None:
    path = OnePath.of(D, 900.0 * D, ALL)
    force = np.array([900.0 * D, 5.0 + 0.0 * D])
    assert path.force(force) is force
    assert path.force(force, D) is force
    moved = path.force(force, D + np.where(ALL == 3, 1e-3, 0.0))
    assert (force - moved)[:, [2, 3]] == pytest.approx(np.array([[0.0, 0.9], [0.0, 0.9]]))
