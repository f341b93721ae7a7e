"""The two-segment fit: exact, and the global optimum of brute force."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.two_segments import Hinges, Segments
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure

D = np.linspace(0.002, 0.02, 120)
F = 45.0 + np.where(D < 0.0093, 5000.0, 2700.0) * (D - 0.0093)


def noisy(seed: int) -> Floats:
    return F + np.random.default_rng(seed).normal(0, 0.5, len(D))


def fitted(d: Floats, f: Floats) -> Segments:
    hinges = Hinges.of(d, f)
    assert isinstance(hinges, Hinges)
    return hinges.fitted(f)


def test_exact_between_samples() -> None:
    found = fitted(D, F)
    assert float(found.break_point) == pytest.approx(0.0093, rel=1e-9)
    assert float(found.first) == pytest.approx(5000.0, rel=1e-9)
    assert float(found.second) == pytest.approx(2700.0, rel=1e-9)
    assert float(found.level) == pytest.approx(45.0, rel=1e-9)


def test_exact_where_a_sample_stands_in_the_corner() -> None:
    f = 45.0 + np.where(D[47] > D, 5000.0, 2700.0) * (D - D[47])
    found = fitted(D, f)
    assert float(found.break_point) == pytest.approx(D[47], rel=1e-9)
    assert float(found.second) == pytest.approx(2700.0, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_no_break_on_a_fine_grid_does_better(seed: int) -> None:
    force = noisy(seed)
    found = fitted(D, force)
    ahead = D - found.break_point
    left = force - found.level - np.where(ahead < 0.0, found.first, found.second) * ahead
    for at in np.linspace(D[4], D[-5], 3001):
        design = np.column_stack([np.ones_like(D), np.minimum(D - at, 0), np.maximum(D - at, 0)])
        squares = np.linalg.lstsq(design, force, rcond=None)[1][0]
        assert left @ left <= squares * (1.0 + 1e-10)


def test_order_and_missing_samples_do_not_matter() -> None:
    force = noisy(7)
    force[50] = np.nan
    found, without = fitted(D, force), fitted(np.delete(D, 50), np.delete(force, 50))
    assert float(found.break_point) == float(without.break_point)
    mixed = np.argsort(D + np.random.default_rng(1).normal(0.0, 2e-4, len(D)))
    again = fitted(D[mixed], force[mixed])
    assert float(again.break_point) == pytest.approx(float(found.break_point), rel=1e-12)


def test_says_why_not() -> None:
    assert Hinges.of(D[:15], F[:15]) == Failure(
        "too_few_samples", "15 samples in the stretch, 16 are needed"
    )
    back = Hinges.of(D[::-1], F[::-1])
    assert back == Failure("not_increasing", "the displacement goes from 0.02 m to 0.002 m")


def test_asymptotes_of_a_cantilever_meet_at_three_halves_of_the_first_slip() -> None:
    """Bilinear moment-curvature law; deflection by double integration of the curvature."""
    stick, slip, knee, length = 0.2, 0.05, 0.06, 0.1143
    s = np.linspace(0.0, length, 4001)
    load = np.linspace(0.0, 60.0 * knee / length, 400)
    moment = load[:, None] * (length - s)
    curvature = moment / stick + np.maximum(moment - knee, 0.0) * (1.0 / slip - 1.0 / stick)
    steps = curvature * (length - s)
    tip = 0.5 * (steps[:, 1:] + steps[:, :-1]).sum(axis=1) * (s[1] - s[0])
    first, last = length**3 / (3.0 * stick), np.gradient(tip, load)[-1]
    meet = (tip[-1] - last * load[-1]) / (first - last)
    assert meet == pytest.approx(1.5 * knee / length, rel=0.01)
