"""Boundaries refuse what they cannot mean."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.boundaries import Gravity, Held, Load, Moment, Plane, Ring, String

FRAME = np.array([1.0, 0.0, 0.0, 0.0])


def test_one_row_stands_for_what_does_not_move() -> None:
    held = Held(0, np.array([1.0, 2.0, 3.0]), FRAME)
    assert held.position.shape == (1, 3)
    assert held.frame is not None
    assert held.frame.shape == (1, 4)
    with pytest.raises(ValueError, match="read-only"):
        held.position[0, 0] = 0.0


def test_directions_are_of_length_one() -> None:
    assert Plane(np.zeros(3), np.array([0.0, 3.0, 4.0])).normal == pytest.approx([0.0, 0.6, 0.8])
    assert Ring(np.zeros(3), np.array([0.0, 0.0, 2.0])).direction == pytest.approx([0.0, 0.0, 1.0])
    assert Gravity().vector == pytest.approx(np.array([[0.0, 0.0, -9.81]]))


def test_a_plane_is_raised_along_its_normal() -> None:
    table = Plane(np.array([1.0, 0.0, 0.0]), np.array([0.0, 3.0, 4.0]), 0.3, "table").raised(0.5)
    assert table.point == pytest.approx([1.0, 0.3, 0.4])
    assert (table.friction, table.name) == (0.3, "table")
    assert table.normal == pytest.approx([0.0, 0.6, 0.8])


def test_faults_are_said() -> None:
    with pytest.raises(ValueError, match=r"position of shape \(2, 2\): allowed is \(steps \+ 1, 3"):
        Held(0, np.zeros((2, 2)))
    with pytest.raises(ValueError, match="force, row 1: allowed are finite"):
        Load(0, np.array([[0.0, 0, 0], [np.nan, 0, 0]]))
    with pytest.raises(ValueError, match="moment, row 0"):
        Moment(0, np.array([np.inf, 0.0, 0.0]))
    with pytest.raises(ValueError, match="frame: allowed are quaternions"):
        Held(0, np.zeros(3), 2.0 * FRAME)
    with pytest.raises(ValueError, match="release=0: allowed are steps from 1"):
        Held(0, np.zeros(3), release=0)
    with pytest.raises(ValueError, match=r"length=0\.0"):
        String(0, np.zeros(3), 0.0)
    with pytest.raises(ValueError, match=r"friction=-0\.1"):
        Plane(np.zeros(3), friction=-0.1)
    with pytest.raises(ValueError, match=r"normal=\[0.0, 0.0, 0.0\]: allowed is one direction"):
        Plane(np.zeros(3), np.zeros(3))
