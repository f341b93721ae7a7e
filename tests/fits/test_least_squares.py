"""Lines and polynomials of many rows, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.least_squares import polynomial_weights, slope_of_line, zero_of_line


def test_slope_by_hand() -> None:
    """Levers -1, 0, 1: (6 - 1) / 2."""
    x, y = np.array([4.0, 5.0, 6.0]), np.array([1.0, 2.0, 6.0])
    assert slope_of_line(x, y) == pytest.approx(2.5)
    assert slope_of_line(x + 1e3, y - 7.0) == pytest.approx(2.5)


def test_every_row_has_its_own_line() -> None:
    x = np.array([[0.0, 1.0, 2.0], [0.0, 2.0, 4.0]])
    y = np.array([[1.0, 2.0, 6.0], [1.0, 2.0, 6.0]])
    np.testing.assert_allclose(slope_of_line(x, y), [2.5, 1.25])
    np.testing.assert_allclose(slope_of_line(x, y[0]), [2.5, 1.25])
    np.testing.assert_allclose(slope_of_line(x[0], y[np.newaxis]), [[2.5, 2.5]])
    # means 1 and 3 of x and y: 1 - 3 / 2.5, and 2 - 3 / 1.25
    np.testing.assert_allclose(zero_of_line(x, y), [-0.2, -0.4])


def test_no_travel_and_no_rise_are_no_number() -> None:
    x, y = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]]), np.array([3.0, 2.0, 1.0])
    np.testing.assert_array_equal(slope_of_line(x, y), [np.nan, -1.0])
    assert np.isnan(zero_of_line(x, y)).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_weights_give_the_polynomial_of_numpy(degree: int) -> None:
    rng = np.random.default_rng(degree)
    x, rows = np.sort(rng.uniform(-0.3, 1.1, 40)), rng.normal(size=(3, 40))
    expected = np.polynomial.polynomial.polyfit(x, rows.T, degree)
    np.testing.assert_allclose(polynomial_weights(x, degree=degree) @ rows.T, expected, rtol=1e-9)
