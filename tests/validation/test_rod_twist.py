"""Twist that buckles rods and rings: Greenhill (1883), Michell (1889) and Ziegler (1968)."""

from __future__ import annotations

import numpy as np
import pytest

from tests.judges.judged_rods import (
    STRETCH,
    moment_that_buckles,
    off_plane,
    shares_near_one,
    torque_that_buckles,
    turned_on_joints,
    twist_that_buckles_a_ring,
    twisted_ring,
)


def test_torque_that_buckles_a_clamped_rod() -> None:
    """M L / B = 8.9868; both ends held, the rod free to stretch by next to nothing."""
    assert torque_that_buckles(20) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("torsion", [0.3, 1.0, 3.0])
def test_torque_that_buckles_does_not_ask_for_torsional_stiffness(torsion: float) -> None:
    """Of second order in its difference to B; it is looked for in steps of a thousandth."""
    errors = [torque_that_buckles(elements, torsion=torsion) - 1.0 for elements in (40, 80, 160)]
    assert abs(errors[2]) < 2e-3
    assert errors[1] == pytest.approx(0.25 * errors[0], abs=1e-3)
    assert errors[2] == pytest.approx(0.25 * errors[1], abs=1e-3)


@pytest.mark.parametrize("torsion", [0.5, 2.0, 10.0])
def test_moment_that_buckles_a_rod_on_universal_joints(torsion: float) -> None:
    """M L / B = 2 pi whatever the torsional stiffness, of second order in its difference to B."""
    errors = [moment_that_buckles(elements, torsion=torsion) - 1.0 for elements in (20, 40, 80)]
    assert abs(errors[2]) < 1e-3
    assert errors[1] == pytest.approx(0.25 * errors[0], rel=0.06)
    assert errors[2] == pytest.approx(0.25 * errors[1], rel=0.06)


def test_with_both_stiffnesses_alike_it_buckles_as_in_theory_with_few_elements() -> None:
    assert moment_that_buckles(10, torsion=1.0) == pytest.approx(1.0, abs=2e-6)


def test_tension_holds_a_rod_on_universal_joints() -> None:
    """M^2 = 4 pi^2 + 4 T, in units of B and L."""
    assert moment_that_buckles(40, tension=20.0) == pytest.approx(1.0, abs=2e-3)


def test_a_rod_on_universal_joints_leaves_its_line_to_a_turn_of_a_helix() -> None:
    """Held at both ends it pulls itself taut: T = (M^2 - (2 pi)^2) / 4, the shortening T / EA.

    Across: A (exp(i p s) - exp(i q s)) turned about the line through the ends, p and q = M / 2 +-
    pi, so that the shortening is A^2 (p^2 + q^2) / 2, and it is 2 A aside at its middle.
    """
    shares = np.array([0.0, 0.5, 0.99, 1.2])
    path = turned_on_joints(40, shares)
    assert path.status == "ok", path.reasons
    assert path.snapped == (3,)
    assert np.max(np.abs(path.states[2].positions[:, 1:])) < 1e-9
    moment, pull = 2.4 * np.pi, 0.44 * np.pi**2
    squares = 2.0 * ((0.5 * moment) ** 2 + np.pi**2)
    aside = 2.0 * np.sqrt(2.0 * pull / STRETCH / squares)
    assert path.last.forces[20, 0] == pytest.approx(pull, rel=0.02)
    assert np.linalg.norm(path.last.positions[20, 1:]) == pytest.approx(aside, rel=0.02)


@pytest.mark.slow
def test_twist_that_buckles_a_ring() -> None:
    """2 pi sqrt(3) B / C: with B = C the ring jumps, within steps of a thousandth."""
    assert twist_that_buckles_a_ring(40) == pytest.approx(1.0, abs=4e-3)


@pytest.mark.slow
def test_twist_that_buckles_a_ring_is_of_second_order() -> None:
    errors = [1.0 - twist_that_buckles_a_ring(elements, step=2.5e-4) for elements in (10, 20, 40)]
    assert errors[1] == pytest.approx(0.25 * errors[0], rel=0.15)
    assert errors[2] == pytest.approx(0.25 * errors[1], rel=0.15)


@pytest.mark.slow
def test_a_ring_that_twists_harder_leaves_its_plane_gently() -> None:
    """With C = 2 B there is no jump: what it is off its plane grows as a root, from Michell's."""
    shares = shares_near_one(4e-3)
    off = off_plane(twisted_ring(60, shares, torsion=2.0))
    assert np.all(off[shares < 0.98] < 1e-4)
    late = shares > 1.01
    slope, offset = np.polyfit(shares[late], off[late] ** 2, 1)
    assert -offset / slope == pytest.approx(1.0, abs=4e-3)
