"""Student's t against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from labpipe.fitting.student import density, half_width, share_within

FREEDOM = [1, 2, 3, 4, 5, 8, 15, 16, 17, 18, 19, 50, 123, 124, 125, 126, 1000]


@pytest.mark.parametrize("freedom", FREEDOM)
def test_share_within(freedom: int) -> None:
    t = np.linspace(-40.0, 40.0, 801)
    expected = stats.t.cdf(t, freedom) - stats.t.cdf(-t, freedom)
    # Rounding of as many terms as half the degrees of freedom.
    np.testing.assert_allclose(share_within(t, freedom), expected, rtol=0, atol=2e-14)


@pytest.mark.parametrize("freedom", FREEDOM)
def test_density(freedom: int) -> None:
    t = np.linspace(-9.0, 9.0, 181)
    np.testing.assert_allclose(density(t, freedom), stats.t.pdf(t, freedom), rtol=1e-11)


@pytest.mark.parametrize("freedom", FREEDOM)
@pytest.mark.parametrize("share", [0.5, 0.9, 0.95, 0.99])
def test_half_width(freedom: int, share: float) -> None:
    expected = stats.t.ppf(0.5 * (1.0 + share), freedom)
    assert half_width(share, freedom) == pytest.approx(expected, rel=1e-12)


def test_any_shape_and_nan() -> None:
    share = share_within(np.array([[0.0, np.inf], [-np.inf, np.nan]]), 7)
    np.testing.assert_array_equal(share, [[0.0, 1.0], [-1.0, np.nan]])
    assert share_within(np.array(0.0), 4).shape == ()


def test_at_least_one_degree_of_freedom() -> None:
    with pytest.raises(ValueError, match="expected at least one degree of freedom, found 0"):
        share_within(np.ones(3), 0)
