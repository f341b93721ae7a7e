"""The path: energy, symmetry, what is left behind, scaling."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from labpipe.virtual_lab.conduit_scenarios import CONDUIT_TYPES, ThreePointTest
from labpipe.virtual_lab.specimens import ElasticModel
from labpipe.virtual_lab.three_point_path import BentHalf, ThreePointPath, solve_three_point

BUNDLE, _ = CONDUIT_TYPES["CWB-1"]
SMOOTH = ThreePointTest(BUNDLE, friction=0.0)
ROUGH = ThreePointTest(BUNDLE, friction=0.2)


def positions(path: ThreePointPath) -> list[BentHalf]:
    return [*path.loading, *path.unloading[1:]]


def outer_work(path: ThreePointPath) -> float:
    halves = positions(path)
    return float(
        np.trapezoid([half.force for half in halves], [half.displacement for half in halves])
    )


def inner_work(path: ThreePointPath) -> float:
    """What bending took up: twice the integral over half the bundle of M d(curvature)."""
    weights = np.full(len(path.arc_length), path.arc_length[1])
    weights[[0, -1]] *= 0.5
    halves = positions(path)
    return 2.0 * sum(
        float(weights @ (0.5 * (a.moment + b.moment) * (b.curvature - a.curvature)))
        for a, b in pairwise(halves)
    )


def test_work_is_stored_or_dissipated_in_bending() -> None:
    path = solve_three_point(SMOOTH)
    assert outer_work(path) == pytest.approx(inner_work(path), rel=1e-3)
    assert outer_work(path) > 0.05


def test_friction_on_the_rollers_takes_more() -> None:
    path = solve_three_point(ROUGH)
    assert outer_work(path) > 1.03 * inner_work(path)
    forces = [solve_three_point(test).loading[-1].force for test in (SMOOTH, ROUGH)]
    assert forces[1] > forces[0]


def test_an_elastic_bar_gives_everything_back() -> None:
    path = solve_three_point(ThreePointTest(ElasticModel(0.1), friction=0.0))
    assert path.residual == pytest.approx(0.0, abs=1e-9)
    down = [half.displacement for half in path.loading]
    stored = np.trapezoid([half.force for half in path.loading], down)
    assert abs(outer_work(path)) < 1e-4 * stored  # what the trapezoidal rule leaves
    progress = np.linspace(0.0, 0.0294, 50)
    assert path.force(progress) == pytest.approx(path.force(0.0588 - progress), abs=1e-4)


@pytest.mark.slow
def test_steps_and_stations_are_fine_enough() -> None:
    path = solve_three_point(ROUGH)
    finer = solve_three_point(replace(ROUGH, steps_per_branch=180, n_stations=193))
    progress = np.linspace(0.0, 0.0588, 800)
    assert path.force(progress) == pytest.approx(finer.force(progress), abs=0.01)
    assert path.residual == pytest.approx(finer.residual, abs=2e-5)


def test_the_roller_leaves_a_bent_bundle() -> None:
    path = solve_three_point(ROUGH)
    assert 5e-3 < path.residual < 0.015
    after = np.linspace(0.0588 - 0.9 * path.residual, 0.0588, 20)
    assert path.force(after) == pytest.approx(0.0, abs=1e-12)
    way, moment, _ = path.middle(after)
    assert way == pytest.approx(path.residual, abs=1e-12)
    assert moment == pytest.approx(0.0, abs=1e-12)
    assert path.displacement(after)[-1] == 0.0


def test_shapes_are_symmetric_and_keep_their_length() -> None:
    path = solve_three_point(ROUGH)
    arc = np.linspace(-0.1, 0.1, 401)
    progress = np.array([0.0, 0.01, 0.0294, 0.05])
    x, y, angle = path.points(progress, arc)
    np.testing.assert_allclose(x, -x[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(y, y[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(angle, -angle[:, ::-1], atol=1e-12)
    lengths = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)).sum(axis=1)
    np.testing.assert_allclose(lengths, 0.2, rtol=2e-4)
    middle = y[:, 200]
    assert middle[:3] == pytest.approx([0.0, -0.01, -0.0294], abs=1e-9)


def test_samples_scale() -> None:
    path = solve_three_point(ROUGH)
    other = solve_three_point(replace(ROUGH, bundle=BUNDLE.scaled(1.2)))
    progress = np.linspace(0.0, 0.0588, 100)
    assert other.force(progress) == pytest.approx(1.2 * path.force(progress), abs=1e-6)
    assert other.residual == pytest.approx(path.residual, abs=1e-9)


def test_what_cannot_be_reached() -> None:
    with pytest.raises(ValueError, match=r"displacement=.*: no equilibrium beyond 0\.0"):
        solve_three_point(ThreePointTest(ElasticModel(0.1), stroke=0.3))
