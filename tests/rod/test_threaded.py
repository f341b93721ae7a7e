"""Where a line goes through a ring."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.threaded import nearest_place, point_at, thread

ANGLES = np.linspace(0.0, 2.0, 21)
NODES = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0.2 * ANGLES], axis=1)


def test_the_curve_touches_every_element_in_its_middle() -> None:
    for element in range(20):
        middle = 0.5 * (NODES[element] + NODES[element + 1])
        np.testing.assert_allclose(point_at(NODES, element + 0.5), middle, atol=1e-15)
        ahead, back = (point_at(NODES, element + 0.5 + d) for d in (1e-6, -1e-6))
        along = (ahead - back) / 2e-6
        np.testing.assert_allclose(along, NODES[element + 1] - NODES[element], atol=1e-6)
    np.testing.assert_array_equal(point_at(NODES, 0.0), NODES[0])
    np.testing.assert_array_equal(point_at(NODES, 20.0), NODES[-1])


@pytest.mark.parametrize("place", [0.2, 3.3, 7.5, 12.0, 19.8])
def test_the_nearest_place_is_found_across_the_curve(place: float) -> None:
    along = point_at(NODES, place + 1e-6) - point_at(NODES, place - 1e-6)
    across = np.cross(along, [0.3, 0.1, 1.0])
    ring = point_at(NODES, place) + 0.02 * across / np.linalg.norm(across)
    assert nearest_place(NODES, ring, place + 0.9) == pytest.approx(place, abs=1e-6)


@pytest.mark.parametrize("place", [0.2, 3.3, 7.6, 19.8])
def test_a_ring_pulls_across_and_its_stiffness_is_that_of_differences(place: float) -> None:
    ring = point_at(NODES, place) + np.array([1e-3, -2e-3, 1.5e-3])
    plain = thread(NODES, ring, place, 50.0)
    along = point_at(NODES, plain.place + 1e-6) - point_at(NODES, plain.place - 1e-6)
    assert plain.force @ along == pytest.approx(0.0, abs=1e-12)
    assert plain.weights.sum() == pytest.approx(1.0)
    step = 1e-6
    for j in range(3):
        for k in range(3):
            forces = []
            for sign in (1.0, -1.0):
                moved = NODES.copy()
                moved[plain.first + j, k] += sign * step
                near = thread(moved, ring, place, 50.0)
                forces.append(near.weights[:, None] * near.force)
            found = -(forces[0] - forces[1]) / (2.0 * step)
            np.testing.assert_allclose(plain.stiffness[:, :, j, k], found, atol=2e-4)
