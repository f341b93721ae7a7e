"""The banded matrix against a dense one."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.banded import Band, entries, places_of


def test_places_follow_one_another() -> None:
    places = places_of(3)
    assert places.positions.tolist() == [0, 10, 20, 30]
    assert places.total == 33
    every = np.concatenate(
        [
            *(places.positions + k for k in range(3)),
            places.stretches,
            *(places.turns + k for k in range(3)),
            *(places.forces + k for k in range(3)),
        ]
    )
    assert sorted(every.tolist()) == list(range(33))


def test_entries_are_in_the_order_of_the_blocks() -> None:
    rows, columns = entries(np.array([0, 5]), 2, np.array([3, 7]), 1)
    assert rows.tolist() == [0, 1, 5, 6]
    assert columns.tolist() == [3, 3, 7, 7]


def some_band() -> tuple[Band, np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    rows = np.concatenate([np.arange(12), np.arange(10), np.arange(2, 12), np.array([4, 4])])
    columns = np.concatenate([np.arange(12), np.arange(2, 12), np.arange(10), np.array([4, 5])])
    values = random.normal(size=len(rows)) + 3.0 * (rows == columns)
    fixed = np.zeros(12, dtype=bool)
    fixed[[3, 7]] = True
    scale = 10.0 ** random.uniform(-2, 2, 12)
    dense = np.zeros((12, 12))
    np.add.at(dense, (rows, columns), values)
    dense[fixed] = np.eye(12)[fixed]
    return Band(rows, columns, scale, fixed), values, dense


def test_solutions_are_those_of_the_dense_matrix() -> None:
    band, values, dense = some_band()
    right = np.random.default_rng(1).normal(size=12)
    found = band.solve(values, right)
    assert found is not None
    np.testing.assert_allclose(found, np.linalg.solve(dense, right), rtol=1e-10)
    assert found[3] == pytest.approx(right[3])


def test_a_singular_matrix_has_no_solution() -> None:
    band, values, _ = some_band()
    assert band.solve(np.zeros_like(values), np.ones(12)) is None
