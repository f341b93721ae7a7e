"""Non-negative least squares against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from labpipe.processing.nonnegative import solve_nonnegative


@pytest.mark.parametrize("seed", range(60))
def test_the_same_as_scipy(seed: int) -> None:
    random = np.random.default_rng(seed)
    unknowns = int(random.integers(1, 21))
    matrix = random.normal(size=(60, unknowns)) + random.normal(size=(60, 1))
    matrix /= np.linalg.norm(matrix, axis=0)
    goal = matrix @ random.normal(size=unknowns) + 0.1 * random.normal(size=60)
    expected, _ = nnls(matrix, goal)
    found = solve_nonnegative(matrix.T @ matrix, matrix.T @ goal)
    assert (found >= 0.0).all()
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=1e-10 * np.abs(expected).max(initial=1)
    )


def test_nothing_is_the_best() -> None:
    assert solve_nonnegative(np.eye(3), -np.ones(3)).tolist() == [0.0, 0.0, 0.0]


def test_a_matrix_that_is_not_positive_definite() -> None:
    with pytest.raises(ValueError, match="expected a positive definite matrix of 2 rows, found no"):
        solve_nonnegative(np.array([[1.0, -2.0], [-2.0, 1.0]]), np.ones(2))
