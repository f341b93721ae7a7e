"""Quaternions and rotation vectors against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from labpipe.records.arrays import Floats
from labpipe.rod.rotations import (
    conjugate,
    cross,
    frame_from_axes,
    from_rotation_vectors,
    matrices,
    multiply,
    rotation_vectors,
    shortest_turns,
    skew,
    tangent_factors,
    unit,
)


def some_vectors(number: int = 40) -> Floats:
    """Rotation vectors from nothing to nearly a half turn, rad."""
    random = np.random.default_rng(3)
    directions = unit(random.normal(size=(number, 3)))
    return np.asarray(np.linspace(0.0, 3.1, number)[:, None] * directions)


def other(frames: Floats) -> Rotation:
    return Rotation.from_quat(np.roll(frames, -1, axis=1))


def test_rotation_vectors_there_and_back() -> None:
    vectors = some_vectors()
    frames = from_rotation_vectors(vectors)
    np.testing.assert_allclose(rotation_vectors(frames), vectors, atol=1e-14)
    np.testing.assert_allclose(rotation_vectors(-frames), vectors, atol=1e-14)
    np.testing.assert_allclose(other(frames).as_rotvec(), vectors, atol=1e-14)


def test_products_and_matrices_are_those_of_scipy() -> None:
    first, second = (
        from_rotation_vectors(some_vectors()),
        from_rotation_vectors(some_vectors()[::-1]),
    )
    product = multiply(first, conjugate(second))
    np.testing.assert_allclose(
        matrices(product), (other(first) * other(second).inv()).as_matrix(), atol=1e-14
    )


def test_vector_products() -> None:
    u, v = some_vectors(), some_vectors()[::-1]
    np.testing.assert_allclose(cross(u, v), np.cross(u, v), atol=1e-15)
    np.testing.assert_allclose(np.einsum("nxy,ny->nx", skew(u), v), np.cross(u, v), atol=1e-15)


@pytest.mark.parametrize("seed", range(20))
def test_a_frame_points_along_and_its_first_axis_up(seed: int) -> None:
    direction, up = np.random.default_rng(seed).normal(size=(2, 3))
    axes = matrices(frame_from_axes(direction, up))
    np.testing.assert_allclose(axes[:, 2], unit(direction), atol=1e-14)
    assert axes[:, 0] @ up > 0.0
    assert axes[:, 1] @ up == pytest.approx(0.0, abs=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_up_along_the_direction_is_refused() -> None:
    with pytest.raises(ValueError, match="not along one line"):
        frame_from_axes(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -1.0]))


def test_shortest_turns_turn_one_into_the_other_opposites_too() -> None:
    before = unit(np.random.default_rng(1).normal(size=(5, 3)))
    behind = np.concatenate([unit(np.random.default_rng(2).normal(size=(4, 3))), -before[4:]])
    turns = shortest_turns(before, behind)
    turned = np.einsum("nxy,ny->nx", matrices(turns), before)
    np.testing.assert_allclose(turned, behind, atol=1e-14)
    along = np.einsum("nk,nk->n", rotation_vectors(turns), before)
    np.testing.assert_allclose(along, 0.0, atol=1e-14)


def test_tangent_map_is_the_derivative_of_the_rotation_vector() -> None:
    psi = some_vectors()[1:]
    angles = np.linalg.norm(psi, axis=1)
    factor = tangent_factors(angles)[0][:, None, None]
    tangent = np.eye(3) + 0.5 * skew(psi) + factor * skew(psi) @ skew(psi)
    step = 1e-6
    for axis in np.eye(3):
        ahead = multiply(from_rotation_vectors(psi), from_rotation_vectors(step * axis[None]))
        back = multiply(from_rotation_vectors(psi), from_rotation_vectors(-step * axis[None]))
        found = (rotation_vectors(ahead) - rotation_vectors(back)) / (2.0 * step)
        np.testing.assert_allclose(found[:-2], (tangent @ axis)[:-2], rtol=1e-7, atol=1e-8)


def test_series_and_closed_forms_of_the_tangent_meet() -> None:
    first, second = tangent_factors(np.array([0.3 - 1e-9, 0.3 + 1e-9]))
    assert first[0] == pytest.approx(first[1], rel=1e-10)
    assert second[0] == pytest.approx(second[1], rel=1e-9)
