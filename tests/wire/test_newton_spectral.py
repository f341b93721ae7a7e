"""Integration and interpolation on Chebyshev-Lobatto stations."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.newton import chebyshev_stations, interpolation_matrix


@pytest.mark.parametrize("power", range(8))
def test_integrals_of_polynomials_are_exact(power: int) -> None:
    stations = chebyshev_stations(9)
    s = stations.position
    integral = s ** (power + 1) / (power + 1)
    np.testing.assert_allclose(stations.from_clamp @ s**power, integral, atol=1e-14)
    np.testing.assert_allclose(stations.to_tip @ s**power, 1 / (power + 1) - integral, atol=1e-14)
    assert stations.weights @ s**power == pytest.approx(1 / (power + 1))


def test_ends_are_stations() -> None:
    position = chebyshev_stations(16).position
    assert (position[0], position[-1]) == (0.0, 1.0)
    assert np.all(np.diff(position) > 0)


def test_interpolation_of_a_smooth_function() -> None:
    wanted = np.linspace(0.0, 1.0, 33)
    s = chebyshev_stations(24).position
    np.testing.assert_allclose(interpolation_matrix(24, wanted) @ np.sin(3 * s), np.sin(3 * wanted))


def test_interpolation_outside_is_refused() -> None:
    with pytest.raises(ValueError, match=r"positions=.*between 0 and 1"):
        interpolation_matrix(8, np.array([1.01]))


def test_too_few_stations_are_refused() -> None:
    with pytest.raises(ValueError, match=r"count=3: allowed are numbers >= 4"):
        chebyshev_stations(3)
