"""Machine compliance from a stiff bar, and its correction."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.least_squares import slope_of_line
from labpipe.fits.straight_lines import compliance_window, correct_displacement
from labpipe.records.estimates import Failure

F = np.linspace(0.0, 1000.0, 201)
D = 1e-4 * (1.0 - np.exp(-F / 30.0)) + 2e-7 * F


def test_slope_over_the_window() -> None:
    window = compliance_window(D, F, start=300.0, stop=900.0)
    assert not isinstance(window, Failure)
    assert slope_of_line(F[window], D[window]) == pytest.approx(2e-7, rel=1e-3)
    assert len(F[window]) == 121


def test_missing_samples_are_left_out() -> None:
    holes = D.copy()
    holes[100] = np.nan
    window = compliance_window(holes, F, start=300.0, stop=900.0)
    assert isinstance(window, np.ndarray)
    assert window.tolist() == [each for each in range(60, 181) if each != 100]


def test_says_why_not() -> None:
    assert compliance_window(D, F, start=300.0, stop=2000.0) == Failure(
        "not_reached", "the force reaches 1000 N, the window ends at 2000 N"
    )
    assert compliance_window(D[:0], F[:0], start=1.0, stop=2.0) == Failure(
        "not_reached", "the force reaches 0 N, the window ends at 2 N"
    )
    few = compliance_window(D[::50], F[::50], start=300.0, stop=900.0)
    assert few == Failure("too_few_samples", "3 samples in the stretch, 8 are needed")
    flat = compliance_window(np.linspace(0.0, 1.0, 20), np.ones(20), start=0.5, stop=1.0)
    assert isinstance(flat, Failure)
    assert flat.code == "too_few_samples"


def test_correction_takes_the_machine_off() -> None:
    force = np.array([0.0, 100.0, np.nan])
    corrected = correct_displacement(np.array([0.0, 1e-3, 2e-3]), force, compliance=1e-6)
    assert corrected[:2] == pytest.approx([0.0, 0.9e-3])
    assert np.isnan(corrected[2])


def test_compliance_of_many_rows() -> None:
    """Steps of 5 N: 300 N are in sample 60, 900 N in 180."""
    window = compliance_window(D, F, start=300.0, stop=900.0)
    assert window == slice(60, 181)
    straight = 2e-7 * F
    rows = slope_of_line(F[window], np.array([straight, 3.0 * straight + 1e-4])[:, window])
    np.testing.assert_allclose(rows, [2e-7, 6e-7])
    held = compliance_window(D, np.repeat([0.0, 500.0], [100, 101]), start=400.0, stop=450.0)
    assert isinstance(held, Failure)
    assert held.code == "too_few_samples"
