"""The end of a loading curve: how steep it is, where it got flat, and when it did not."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.plateau import Tangents
from labpipe.records.arrays import Floats

D = np.linspace(0.0, 0.05, 1500)
OVER = 5e-3
SCALE = 0.012
SOFT: Floats = 10.0 * (1.0 - np.exp(-D / SCALE))
"""Initial slope 10 / SCALE; the tangent is a tenth of it at SCALE ln 10."""
INITIAL = 10.0 / SCALE
ONSET = SCALE * np.log(10.0)


def tangents_of(force: Floats) -> Tangents:
    found = Tangents.of(D, force, over=OVER)
    assert isinstance(found, Tangents)
    return found


def onset(force: Floats, initial: float = INITIAL, below: float = 0.1) -> tuple[float, float]:
    place, level = tangents_of(force).onset(force, np.array(initial), slope_below=below)
    return float(place), float(level)


def test_smooth_curve_without_noise() -> None:
    place, level = onset(SOFT)
    assert place == pytest.approx(ONSET, abs=1e-4)
    assert level == pytest.approx(9.0, abs=0.02)
    tangents = tangents_of(SOFT)
    slope = float(tangents.slope_at_end(SOFT))
    assert slope / INITIAL == pytest.approx(np.exp(-0.0475 / SCALE), rel=0.02)
    start, stop = tangents.ends
    assert start == pytest.approx(0.045, abs=4e-5)
    assert stop == 0.05
    assert tangents.level_at(start, SOFT) == pytest.approx(np.interp(start, D, SOFT), abs=0.02)
    assert len(tangents.last) == np.count_nonzero(start <= D)


def test_samples_on_the_ends_of_a_stretch_do_not_depend_on_rounding() -> None:
    """Speed by time at even rates: every 25 th sample lies on an end, within its last bits."""
    even = np.arange(1001) * 5e-5
    last_bits = 2e-16 * np.random.default_rng(2).choice([-1.0, 1.0], len(even))
    force = 10.0 * (1.0 - np.exp(-even / SCALE))
    found = []
    for off in (0.0, 1.0, -1.0):
        path: Floats = even * (1.0 + off * last_bits)
        tangents = Tangents.of(path, force, over=OVER)
        assert isinstance(tangents, Tangents)
        place, level = tangents.onset(force, np.array(INITIAL), slope_below=0.1)
        found.append([float(tangents.slope_at_end(force)), float(place), float(level)])
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-10)


def test_a_kink_is_near_and_late() -> None:
    force = np.where(D < 0.03, 400.0 * D - 5000.0 * D**2, 7.5 + 8.0 * (D - 0.03))
    place, _ = onset(force, 400.0)
    assert 0.03 < place < 0.03 + 0.5 * OVER


def test_force_at_a_corner_is_not_cut_off() -> None:
    """A parabola over the whole stretch would lie below the corner."""
    force = np.where(D < 0.03, 4.5 + 100.0 * (D - 0.03), 4.5 - 10.0 * (D - 0.03))
    at, level = onset(force, 450.0)
    stretch = np.abs(D - at) <= 0.5 * OVER
    whole = float(np.polynomial.Polynomial.fit(D[stretch], force[stretch], 2)(at))
    cut = float(np.interp(at, D, force)) - whole
    assert cut > 0.01
    assert level - whole > 0.3 * cut
    change = tangents_of(force).corners(force, at, 45.0)
    assert change[1] == pytest.approx(level - whole, rel=0.02)


def test_flat_from_the_last_time_on() -> None:
    """A flat stretch halfway is no plateau, if the curve gets steep again."""
    force = np.interp(D, [0.0, 0.01, 0.02, 0.03, 0.05], [0.0, 4.0, 4.1, 8.0, 8.1])
    place, _ = onset(force, 400.0)
    assert place == pytest.approx(0.03, abs=0.5 * OVER)


def test_no_onset_in_a_curve_that_is_nowhere_steep() -> None:
    assert np.isnan(onset(10.0 * D)).all()
