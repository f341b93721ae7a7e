"""Planes and strings, node by node."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.boundaries import Plane
from labpipe.rod.touching import added_at, pull_strings, touch_plane

PLANE = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.5)
STIFF = 1e4
START = np.array([[0.0, 0.0, 0.0]])


def test_a_node_above_the_plane_feels_nothing() -> None:
    touch = touch_plane(PLANE, STIFF, np.array([[1.0, 2.0, 1e-6]]), START, close=1e-9)
    assert not np.any(touch.forces)
    assert not np.any(touch.stiffness)
    np.testing.assert_array_equal(touch.contacts, [[1.0, 2.0, 1e-6]])


def test_a_node_sticks_until_friction_is_reached_and_drags_its_contact_along() -> None:
    sticking = touch_plane(PLANE, STIFF, np.array([[4e-4, 0.0, -1e-3]]), START, close=0.0)
    np.testing.assert_allclose(sticking.forces, [[-4.0, 0.0, 10.0]])
    assert sticking.rubbed == 0.0
    sliding = touch_plane(PLANE, STIFF, np.array([[9e-4, 0.0, -1e-3]]), START, close=0.0)
    np.testing.assert_allclose(sliding.forces, [[-5.0, 0.0, 10.0]])
    np.testing.assert_allclose(sliding.contacts[:, :2], [[4e-4, 0.0]])
    assert sliding.rubbed == pytest.approx(5.0 * 4e-4)
    back = touch_plane(PLANE, STIFF, np.array([[8e-4, 0.0, -1e-3]]), sliding.contacts, close=0.0)
    np.testing.assert_allclose(back.forces, [[-4.0, 0.0, 10.0]])


@pytest.mark.parametrize("aside", [3e-4, 9e-4])
def test_stiffness_of_a_plane_is_that_of_differences(aside: float) -> None:
    plane = Plane(np.zeros(3), np.array([0.2, -0.1, 1.0]), 0.5)
    at = np.array([[aside, 0.5 * aside, -1.2e-3]])
    touch = touch_plane(plane, STIFF, at, START, close=0.0)
    for k in range(3):
        step = 1e-9 * np.eye(3)[k]
        ahead = touch_plane(plane, STIFF, at + step, START, close=0.0).forces
        back = touch_plane(plane, STIFF, at - step, START, close=0.0).forces
        np.testing.assert_allclose(touch.stiffness[0, :, k], -(ahead - back)[0] / 2e-9, atol=1e-2)
    even = touch.stiffness - touch.pressing
    np.testing.assert_allclose(even, np.swapaxes(even, 1, 2), atol=1e-9)


def test_strings_pull_and_do_not_push() -> None:
    anchors = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    nodes = np.array([[0.0, 0.0, -0.01], [0.0, 0.0, 0.01]])
    forces, stiffness = pull_strings(anchors, np.ones(2), 100.0, nodes)
    np.testing.assert_allclose(forces, [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(stiffness[0], np.diag([1.0 / 1.01, 1.0 / 1.01, 100.0]), atol=1e-9)
    assert not np.any(stiffness[1])


def test_values_add_up_at_their_nodes() -> None:
    out = added_at(np.array([1, 1, 2]), np.array([1.0, 2.0, 4.0]), 4)
    assert out.tolist() == [0.0, 3.0, 4.0, 0.0]
