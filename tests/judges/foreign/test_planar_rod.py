"""The second rod against closed forms and the tables of the elastica."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from tests.judges.foreign.planar_rod import PlanarRod, Stops, stops_through

SPRING = Stops(1e-3, np.zeros(0), np.zeros(0))
LENGTH = 0.1


def along_circle(angle: float, length: float = LENGTH) -> np.ndarray:
    return np.array([np.sin(angle), 1.0 - np.cos(angle)]) * length / angle


def test_a_line_turned_by_half_a_turn_is_half_a_circle() -> None:
    rod = PlanarRod(LENGTH, 60, SPRING)
    for angle in np.linspace(0.0, np.pi, 12)[1:]:
        rod.hold(along_circle(float(angle)), float(angle))
    shape = rod.shape()
    assert shape.curvature == pytest.approx(np.full(61, np.pi / LENGTH), rel=1e-3)
    assert np.abs(shape.force).max() < 1e-2
    assert rod.far_moment == pytest.approx(1e-3 * np.pi / LENGTH, rel=1e-3)


def test_elastica_under_an_end_load() -> None:
    """P L^2 / EI = 2: deflection 0.493457, shortening 0.160642 of the length (PHYSICS 5)."""
    rod = PlanarRod(LENGTH, 80, SPRING, has_far_clamp=False)
    for share in (0.3, 0.6, 1.0):
        rod.hold(LENGTH * np.array([1.0 - 0.160642 * share**2, 0.493457 * share]))
    assert rod.force * LENGTH**2 / 1e-3 == pytest.approx([0.0, 2.0], abs=0.01)


def test_free_curvature_is_all_that_is_left_of_a_line_without_weight() -> None:
    rod = PlanarRod(LENGTH, 40, SPRING, natural=3.0)
    rod.hold(along_circle(0.6), 0.6)
    rod.let_go()
    assert rod.shape().curvature[:-1] == pytest.approx(np.full(40, 3.0))
    assert rod.shape().places[-1] == pytest.approx(along_circle(0.3), abs=2e-5)


def test_stops_keep_what_they_slid() -> None:
    """Bent evenly to 20 1/m and let go: the spring and the stop balance, 20 - M / (EI + K)."""
    rod = PlanarRod(LENGTH, 40, stops_through(np.array([0.0, 5.0, 50.0]), np.array([0.0, 5.0, 14])))
    for angle in np.linspace(0.2, 2.0, 10):
        rod.hold(along_circle(float(angle)), float(angle))
    assert rod.far_moment == pytest.approx(0.2 * 20.0 + 0.8 * 5.0, rel=1e-3)
    rod.let_go()
    assert rod.shape().curvature[:-1] == pytest.approx(np.full(40, 20.0 - 8.0), rel=3e-3)


def test_weight_is_carried() -> None:
    rod = PlanarRod(LENGTH, 60, SPRING, weight=2.0, has_far_clamp=False)
    rod.hold(LENGTH * np.array([0.95, -0.2]))
    assert rod.shape().start_force[1] + rod.force[1] == pytest.approx(2.0 * LENGTH)
    rod.let_go()
    fallen = solve_bvp(
        lambda s, y: np.stack([y[1], 2.0 * (LENGTH - s) * np.cos(y[0]) / 1e-3, np.sin(y[0])]),
        lambda clamp, tip: np.array([clamp[0], tip[1], clamp[2]]),
        *(np.linspace(0.0, LENGTH, 50), np.zeros((3, 50))),
        tol=1e-8,
    )
    assert -rod.shape().places[-1, 1] == pytest.approx(-fallen.y[2, -1], rel=1e-3)
