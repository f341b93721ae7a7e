"""Moduli with a named area, stiffness per peak force."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.straight_lines import (
    annulus_area,
    modulus,
    rectangle_area,
    stiffness_per_peak_force,
    thin_wall_area,
)
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate


def test_areas() -> None:
    assert rectangle_area(0.01879, 0.28e-3) == pytest.approx(5.2612e-6)
    assert annulus_area(0.0141, 0.0107) == pytest.approx(np.pi * 0.0062 * 2 * 0.0017)
    assert thin_wall_area(0.0141, 0.00027) == pytest.approx(np.pi * 0.01383 * 0.00027)


def test_modulus_adds_relative_variances() -> None:
    stiffness = Estimate(1000.0, 30.0, 100, Interval(940.0, 1060.0))
    found = modulus(stiffness, gauge_length=0.1, area=1e-5, area_uncertainty=0.04)
    assert found.value == pytest.approx(1e7)
    assert found.error == pytest.approx(0.05e7)
    assert found.interval is not None
    assert found.interval.lower == pytest.approx(0.9e7)
    assert found.interval.upper == pytest.approx(1.1e7)


def test_stiffness_per_peak_force() -> None:
    found = stiffness_per_peak_force(Estimate(5000.0, 0.0, 9), Estimate(100.0, 2.0, 9))
    assert (found.value, found.error) == pytest.approx((50.0, 1.0))
