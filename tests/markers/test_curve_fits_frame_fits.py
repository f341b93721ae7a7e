"""Curves of many frames at once."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.curve_fits import EndConditions, fit_frames
from labpipe.records.arrays import Floats

S = np.linspace(0.01, 0.08, 8)
X = np.array([1.0, 0.0, 0.0])
ENDS = EndConditions(length=0.085, direction=X, free_tip=False)


def parabolas(frames: int) -> Floats:
    """Markers on y = a s^2, z = s^2, x = s, with a from 0 to 1."""
    a = np.linspace(0, 1, frames)[:, None]
    return np.stack([S + 0 * a, a * S**2, S**2 + 0 * a], axis=2)


def test_a_curve_of_the_basis_is_met_exactly() -> None:
    fits = fit_frames(parabolas(5), S, 0.0, ENDS, terms=4)
    expected = np.zeros((5, 3, 4))
    expected[:, 0, 1], expected[:, 2, 2] = 0.085, 0.085**2
    expected[:, 1, 2] = np.linspace(0, 1, 5) * 0.085**2
    np.testing.assert_allclose(fits.coefficients, expected, atol=1e-14)
    np.testing.assert_allclose(fits.residual, 0.0, atol=1e-14)
    assert fits.needed == 2
    assert fits.spare == 6
    assert fits.freedom.tolist() == 5 * [6]


def test_frames_that_miss_markers_give_what_they_would_alone() -> None:
    rng = np.random.default_rng(1)
    markers = parabolas(40) + 1e-5 * rng.standard_normal((40, 8, 3))
    markers[rng.random((40, 8)) < 0.3] = np.nan
    together = fit_frames(markers, S, 0.001, ENDS, terms=5)
    for frame in range(40):
        alone = fit_frames(markers[frame : frame + 1], S, 0.001, ENDS, terms=5)
        np.testing.assert_allclose(
            together.coefficients[frame], alone.coefficients[0], rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(together.gain[frame], alone.gain[0])


def test_noise_is_found_whatever_the_curve_cannot_follow() -> None:
    rng = np.random.default_rng(2)
    markers = np.repeat(parabolas(1), 2000, axis=0)
    markers[:, 3, 1] += 0.001
    markers += 3e-5 * rng.standard_normal(markers.shape)
    fits = fit_frames(markers, S, 0.0, ENDS, terms=4)
    assert fits.noise(slice(0, 2000)) == pytest.approx(3e-5, rel=0.03)
    assert fits.residual[0] > 1e-4
    assert np.isnan(fits.noise(slice(0, 1)))


def test_more_unknowns_than_markers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"terms=7: expected at most 5 for 3 markers"):
        fit_frames(parabolas(2)[:, :3], S[:3], 0.0, ENDS, terms=7)
