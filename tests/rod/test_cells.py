"""Moments of cells are the derivative of their energy, tangents that of the moments."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.sliders import SliderLaw
from labpipe.records.arrays import Floats
from labpipe.rod.cells import BentCells, bend_cells
from labpipe.rod.line import Section
from labpipe.rod.rotations import from_rotation_vectors, multiply, skew, unit

LAW = SliderLaw(1e-3, np.array([2e-3, 1e-3]), np.array([1.0, 3.0]), 0.0, 50.0)
SECTION = Section(LAW, 8e-4)
ANGLES = np.array([0.01, 0.25, 1.0, 2.0])
STEP = 1e-6


def bent(before: Floats, behind: Floats) -> BentCells:
    """Cells of some frames, turned by a little more, rad, shape (4, 3)."""
    random = np.random.default_rng(1)
    first = from_rotation_vectors(random.normal(size=(4, 3)))
    turn = ANGLES[:, None] * unit(random.normal(size=(4, 3)))
    second = multiply(first, from_rotation_vectors(turn))
    return bend_cells(
        SECTION,
        (
            multiply(first, from_rotation_vectors(before)),
            multiply(second, from_rotation_vectors(behind)),
        ),
        random.uniform(0.05, 0.1, 4),
        random.normal(size=(4, 3)),
        rests=random.normal(size=(4, 2, 2)),
        torques=np.zeros(4),
    )


def numbers(side: int) -> tuple[Floats, Floats]:
    """Derivatives of `before` and `behind` by the turns of one side."""
    columns = []
    for axis in STEP * np.eye(3):
        turn, still = np.tile(axis, (4, 1)), np.zeros((4, 3))
        ahead = bent(turn, still) if side == 0 else bent(still, turn)
        back = bent(-turn, still) if side == 0 else bent(still, -turn)
        columns.append(
            ((ahead.before - back.before) / (2 * STEP), (ahead.behind - back.behind) / (2 * STEP))
        )
    first, second = (np.stack(each, axis=2) for each in zip(*columns, strict=True))
    return first, second


def test_tangents_are_those_of_differences() -> None:
    cells = bent(np.zeros((4, 3)), np.zeros((4, 3)))
    own, other = numbers(0)
    size = np.max(np.abs(own))
    # the derivative of a gradient along turns has a part that is not symmetric and vanishes in sum
    np.testing.assert_allclose(cells.by_before + 0.5 * skew(cells.before), own, atol=1e-8 * size)
    np.testing.assert_allclose(cells.across, other, atol=1e-8 * size)
    other, own = numbers(1)
    np.testing.assert_allclose(cells.by_behind + 0.5 * skew(cells.behind), own, atol=1e-8 * size)
    np.testing.assert_allclose(np.swapaxes(cells.across, 1, 2), other, atol=1e-8 * size)


def test_both_frames_feel_the_same_moment_in_space() -> None:
    cells = bent(np.zeros((4, 3)), np.zeros((4, 3)))
    assert np.linalg.norm(cells.before, axis=1) == pytest.approx(
        np.linalg.norm(cells.behind, axis=1), rel=1e-12
    )


def test_a_cell_bent_in_one_plane_carries_the_moment_of_the_law() -> None:
    turn = from_rotation_vectors(np.array([[0.0, 0.2, 0.0]]))
    start = np.array([[1.0, 0.0, 0.0, 0.0]])
    cells = bend_cells(
        SECTION,
        (start, turn),
        np.array([0.1]),
        np.zeros((1, 3)),
        rests=np.zeros((1, 2, 2)),
        torques=np.zeros(1),
    )
    expected = 1e-3 * 2.0 + 2e-3 * 1.0 + 1e-3 * 2.0
    np.testing.assert_allclose(cells.behind, [[0.0, expected, 0.0]], atol=1e-15)
    np.testing.assert_allclose(cells.before, [[0.0, -expected, 0.0]], atol=1e-15)
