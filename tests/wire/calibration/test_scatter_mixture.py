"""The mixture over scatters: Student's t of few samples where all rests on their mean."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import CalibrationFailure, ParameterChoice, ScatterMixture
from labpipe.wire.calibration.fit import Found, Settings, find
from labpipe.wire.calibration.scatter_mixture import quantiles
from labpipe.wire.calibration.variances import quantile
from tests.builders.loading_tests import measured, wire_of

FIXED = ParameterChoice(is_fixed=True)
MEAN = np.eye(4)[[3]]


def found_of(samples: int, settings: Settings, seed: int = 1) -> Found:
    found = find(wire_of("A2"), measured(samples=samples, n=60, seed=seed), settings)
    assert not isinstance(found, CalibrationFailure)
    return found


@pytest.mark.parametrize("samples", [2, 3, 6])
def test_t_with_one_degree_less_than_samples(samples: int) -> None:
    """The mean factor, all parameters known: it rests on the samples' factors alone."""
    names = ("radial_friction", "insulation_modulus", "copper_scale")
    found = found_of(samples, Settings(dict.fromkeys(names, FIXED), gain=0.9))
    low, high = quantiles(found.mixture, MEAN)
    error = np.sqrt(found.spread.covariance[3, 3])
    # The gain is not quite free, which shows in the far tail of two samples.
    close = 0.15 if samples == 2 else 0.03
    half = 0.5 * (high[0] - low[0])
    assert half / error == pytest.approx(quantile(samples - 1.0), rel=close)


def test_a_given_scatter_is_one_distribution() -> None:
    found = found_of(3, Settings(scatter=0.03))
    assert found.mixture.chance.tolist() == [1.0]
    assert found.mixture.scatter == pytest.approx([0.03], rel=1e-3)
    low, high = quantiles(found.mixture, np.eye(4)[:3])
    errors = np.sqrt(np.diag(found.spread.covariance)[:3])
    assert 0.5 * (high - low) == pytest.approx(quantile(found.mixture.freedom) * errors, rel=1e-3)


def test_two_distributions() -> None:
    mixture = ScatterMixture(
        np.array([0.5, 0.5]),
        np.array([1.0, 3.0]),
        np.zeros((2, 4)),
        np.zeros((2, 4, 4)),
        1e9,
    )
    low, high = quantiles(mixture, np.zeros((1, 4)), np.ones(1))
    # Half N(0, 1), half N(0, 9): 0.5 (1 - Phi(x)) + 0.5 (1 - Phi(x / 3)) = 0.025 at x = 4.941.
    assert high[0] == pytest.approx(4.935, abs=0.01)
    assert low[0] == pytest.approx(-high[0], rel=1e-6)
    nothing = quantiles(mixture, np.zeros((1, 4)))
    assert nothing[0][0] == pytest.approx(0.0, abs=1e-200)
