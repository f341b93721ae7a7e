"""The tube of Hotelling against closed forms and against chance itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from labpipe.records.wire_calibration import Calibration
from labpipe.wire.calibration.bent_family import swept, tube_quantile
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.loading_tests import measured, wire_of


def test_a_straight_family_has_the_normal_quantile() -> None:
    assert tube_quantile(0.0) == pytest.approx(1.959964, abs=1e-6)
    q = tube_quantile(2.0)
    assert 2.0 * ndtr(-q) + np.exp(-0.5 * q * q) / np.pi == pytest.approx(0.05)


def test_angle_of_a_polygon() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 9.0], [9.0, 9.0]])
    products = points @ points.T
    assert swept(products, range(1, 6)) == pytest.approx(0.5 * np.pi)  # the next is too far
    line = np.outer(np.arange(5.0), [1.0, 2.0])
    assert swept(line @ line.T, range(1, 5)) == pytest.approx(0.0, abs=1e-6)


def test_the_tube_of_a_cone_in_white_noise() -> None:
    """Curves in every direction between two, at every distance: a quarter of the plane.

    One end is that of a straight family whose other half is missing, so that only half of its
    chance counts.
    """
    noise = np.random.default_rng(5).normal(size=(200_000, 2))
    turn = np.linspace(0.0, 0.5 * np.pi, 91)
    directions = np.stack([np.cos(turn), np.sin(turn)])
    rise = np.maximum((noise @ directions).max(axis=1), 0.0) ** 2
    for q in (1.5, 2.0, 2.5):
        expected = ndtr(-q) + 0.25 * np.exp(-0.5 * q * q)
        assert np.mean(rise > q * q) == pytest.approx(expected, rel=0.04)
    arc = 2.0 * np.stack([np.sin(2.0 * turn), 1.0 - np.cos(2.0 * turn)])  # one distance for each
    bent = (2.0 * noise @ arc - np.sum(arc**2, axis=0)).max(axis=1)
    assert np.mean(bent > 4.0) < np.mean(rise > 4.0)


@pytest.mark.slow
def test_two_valleys_widen_and_a_prior_does_not() -> None:
    curves = measured("A3", (0.12,), seed=1)
    found = calibrate(wire_of("A3"), curves, Settings(gain=0.005))
    assert isinstance(found, Calibration)
    assert found.widening == pytest.approx(1.2, abs=0.03)
    quiet = calibrate(wire_of("A2"), measured(seed=1, noise=1e-4), Settings(gain=0.005))
    assert isinstance(quiet, Calibration)
    assert quiet.widening < 1.05
