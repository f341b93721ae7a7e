"""Twist that buckles rods and rings: Greenhill (1883) and Michell (1889)."""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders.judged_rods import (
    off_plane,
    shares_near_one,
    torque_that_buckles,
    twist_that_buckles_a_ring,
    twisted_ring,
)


def test_torque_that_buckles_a_clamped_rod() -> None:
    """M L / B = 8.9868; both ends held, the rod free to stretch by next to nothing."""
    assert torque_that_buckles(20) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("torsion", [0.3, 1.0, 3.0])
def test_torque_that_buckles_does_not_ask_for_torsional_stiffness(torsion: float) -> None:
    assert torque_that_buckles(40, torsion=torsion) == pytest.approx(1.0, abs=1.5e-3)


def test_twist_that_buckles_a_ring() -> None:
    """2 pi sqrt(3) B / C: with B = C the ring jumps, within steps of a thousandth."""
    assert twist_that_buckles_a_ring(40) == pytest.approx(1.0, abs=4e-3)


@pytest.mark.slow
def test_twist_that_buckles_a_ring_is_of_second_order() -> None:
    errors = [1.0 - twist_that_buckles_a_ring(elements, step=2.5e-4) for elements in (10, 20, 40)]
    assert errors[1] == pytest.approx(0.25 * errors[0], rel=0.15)
    assert errors[2] == pytest.approx(0.25 * errors[1], rel=0.15)


def test_a_ring_that_twists_harder_leaves_its_plane_gently() -> None:
    """With C = 2 B there is no jump: what it is off its plane grows as a root, from Michell's."""
    shares = shares_near_one(4e-3)
    off = off_plane(twisted_ring(60, shares, torsion=2.0))
    assert np.all(off[shares < 0.98] < 1e-4)
    late = shares > 1.01
    slope, offset = np.polyfit(shares[late], off[late] ** 2, 1)
    assert -offset / slope == pytest.approx(1.0, abs=4e-3)
