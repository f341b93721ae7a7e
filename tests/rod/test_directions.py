"""Directions of elements beside clamps."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.directions import directions_of, lent_directions
from labpipe.rod.line import line_along
from labpipe.rod.rotations import from_rotation_vectors, matrices, multiply
from labpipe.rod.supports import END_SHARE, supports_of
from tests.builders.rods import linear_section

ANGLES = np.linspace(0.0, 1.2, 7)
ARC = np.stack([np.sin(ANGLES), 1.0 - np.cos(ANGLES), 0.0 * ANGLES], axis=1)


def test_clamps_that_leave_a_formed_line_as_it_is_lend_it_nothing_new() -> None:
    line = line_along(ARC, linear_section(), is_formed=True)
    supports = supports_of(line, ((0, True), (3, True), (6, True)))
    clamps = np.array([line.frame_at(node) for node in (0, 3, 6)])
    frames = matrices(line.frames)
    lent = lent_directions(supports, clamps)
    way = directions_of(supports, frames, lent, np.zeros((6, 3)))
    np.testing.assert_allclose(way.along, frames[:, :, 2], atol=1e-12)


def test_directions_turn_with_the_frame_by_its_share() -> None:
    line = line_along(ARC, linear_section())
    supports = supports_of(line, ((0, True),))
    clamps = multiply(line.frames[:1], from_rotation_vectors(np.array([[0.1, 0.0, 0.0]])))
    lent = lent_directions(supports, clamps)
    way = directions_of(supports, matrices(line.frames), lent, np.zeros((6, 3)))
    turned = np.arccos(way.along[0] @ matrices(line.frames)[0, :, 2])
    assert turned == pytest.approx(0.1 * END_SHARE, rel=2e-3)
    np.testing.assert_allclose(np.linalg.norm(way.along, axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(way.along[1:], matrices(line.frames)[1:, :, 2], atol=1e-15)


def test_pull_and_stiffness_are_derivatives() -> None:
    line = line_along(ARC, linear_section())
    supports = supports_of(line, ((0, True), (6, True)))
    random = np.random.default_rng(4)
    clamps = multiply(line.frames[[0, -1]], from_rotation_vectors(random.normal(size=(2, 3)) * 0.3))
    pulls = random.normal(size=(6, 3))
    lent = lent_directions(supports, clamps)
    plain = directions_of(supports, matrices(line.frames), lent, pulls)
    for axis in np.eye(3):
        values = []
        for step in (1e-4, 0.0, -1e-4):
            frames = multiply(line.frames, from_rotation_vectors(step * axis[None]))
            way = directions_of(supports, matrices(frames), lent, pulls)
            values.append(-np.einsum("nk,nk->n", way.along, pulls))
        first = (values[0] - values[2]) / 2e-4
        second = (values[0] - 2.0 * values[1] + values[2]) / 1e-8
        np.testing.assert_allclose(plain.pull @ axis, first, atol=1e-7)
        np.testing.assert_allclose(plain.stiff @ axis @ axis, second, atol=1e-6)
