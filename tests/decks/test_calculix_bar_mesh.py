from __future__ import annotations

import numpy as np
import pytest

from labpipe.decks.calculix import BarMesh, half_bar
from labpipe.records.arrays import Floats

RADIUS, LENGTH = 0.8e-3, 85e-3
NATURAL = np.array(
    [
        *[(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)],
        *[(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
        *[(0, -1, -1), (1, 0, -1), (0, 1, -1), (-1, 0, -1)],
        *[(0, -1, 1), (1, 0, 1), (0, 1, 1), (-1, 0, 1)],
        *[(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)],
    ]
)
"""Places of the twenty nodes in a brick from -1 to 1 (CalculiX CrunchiX User's Manual)."""


def shapes(at: Floats) -> tuple[Floats, Floats]:
    """Shape functions of the twenty-node brick at a point, (20,), and their slopes, (20, 3)."""
    powers = np.array(
        [(i, j, k) for i in range(3) for j in range(3) for k in range(3) if (i, j, k).count(2) < 2]
    )

    def terms(points: Floats) -> Floats:
        values: Floats = np.prod(points[:, np.newaxis, :] ** powers, axis=2)
        return values

    to_nodes = np.linalg.inv(terms(NATURAL.astype(float)))
    step = 1e-6 * np.eye(3)
    slopes = (terms(at + step) - terms(at - step)) / 2e-6
    return (terms(at[np.newaxis]) @ to_nodes)[0], (slopes @ to_nodes).T


def integrals(mesh: BarMesh) -> Floats:
    """Volume and integral of y^2, with the eight points at which C3D20R is integrated."""
    total = np.zeros(2)
    for point in NATURAL[:8] / np.sqrt(3.0):
        values, slopes = shapes(point)
        for brick in mesh.bricks:
            corners = mesh.nodes[brick - 1]
            volume = np.linalg.det(corners.T @ slopes)
            assert volume > 0.0
            total += volume * np.array([1.0, (values @ corners)[1] ** 2])
    return total


def test_every_brick_is_right_way_round_and_the_section_is_a_half_circle() -> None:
    volume, second = integrals(half_bar(RADIUS, LENGTH, n_along=2))
    assert volume == pytest.approx(0.5 * np.pi * RADIUS**2 * LENGTH, rel=1e-3)
    assert second == pytest.approx(0.5 * np.pi / 4.0 * RADIUS**4 * LENGTH, rel=2e-3)


def test_every_node_is_used_and_has_a_place_of_its_own() -> None:
    mesh = half_bar(RADIUS, LENGTH, n_along=3)
    assert sorted(set(mesh.bricks.ravel().tolist())) == list(range(1, len(mesh.nodes) + 1))
    assert len(np.unique(mesh.nodes.round(12), axis=0)) == len(mesh.nodes)
    assert mesh.bricks.shape == (18, 20)


def test_mid_sides_are_between_their_corners() -> None:
    mesh = half_bar(RADIUS, LENGTH, n_along=1)
    ends = [
        (0, 1),
        (1, 2),
        (2, 3),
        (3, 0),
        (4, 5),
        (5, 6),
        (6, 7),
        (7, 4),
        *((i, i + 4) for i in range(4)),
    ]
    for brick in mesh.bricks:
        at = mesh.nodes[brick - 1]
        for middle, (one, other) in enumerate(ends, start=8):
            apart = np.linalg.norm(at[middle] - 0.5 * (at[one] + at[other]))
            assert apart < 0.1 * RADIUS


def test_the_planes() -> None:
    mesh = half_bar(RADIUS, LENGTH, n_along=4)
    assert np.ptp(mesh.nodes[mesh.clamp, 0]) == 0.0
    assert mesh.nodes[mesh.tip, 0] == pytest.approx(LENGTH)
    assert np.count_nonzero(mesh.tip & mesh.middle) == 5
    assert (mesh.nodes[:, 2] >= -1e-12).all()
    assert mesh.nodes[mesh.cut, 1].min() == pytest.approx(-RADIUS)
    on_circle = np.hypot(*mesh.nodes[:, 1:].T) > 0.999 * RADIUS
    assert np.count_nonzero(on_circle & mesh.tip) == 9


def test_a_bar_without_bricks_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^n_along=0: allowed are whole numbers >= 1$"):
        half_bar(RADIUS, LENGTH, n_along=0)
