"""Kinks: exact on two lines, no kink where there is none, intervals that cover."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.fits.two_segments import Kink, fit_kink
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure
from tests.builders.loading_tests import memory_noise

D = np.linspace(2e-4, 5e-3, 240)


def bent(at: float = 2e-3, first: float = 900.0, second: float = 350.0) -> Floats:
    force: Floats = first * np.minimum(D, at) + second * np.maximum(D - at, 0.0)
    return force


def white(seed: int, deviation: float = 0.02) -> Floats:
    return np.random.default_rng(seed).normal(0.0, deviation, len(D))


def failed(force: Floats) -> Failure:
    found = fit_kink(D, force)
    assert isinstance(found, Failure)
    return found


def holds(found: Estimate, true: float) -> bool:
    assert found.interval is not None
    return found.interval.lower <= true <= found.interval.upper


def test_exact_with_missing_samples() -> None:
    force = bent()
    force[[5, 100]] = np.nan
    found = fit_kink(D, force)
    assert isinstance(found, Kink)
    assert found.displacement.value == pytest.approx(2e-3, rel=1e-9)
    assert found.force.value == pytest.approx(1.8, rel=1e-9)
    assert (found.first.value, found.second.value) == pytest.approx((900.0, 350.0))
    assert (found.start, found.stop) == (D[0], D[-1])


def test_a_straight_line_has_no_kink() -> None:
    codes = [failed(500.0 * D + white(seed)).code for seed in range(20)]
    assert codes == ["no_kink"] * 20
    message = failed(500.0 * D + white(0)).message
    assert message.startswith("one straight line does as well, to within 0.02")
    assert "N from 0.2 to 5 mm: " in message
    assert "standard errors" in message or "may be at an end" in message


def test_a_slope_that_rises_is_no_kink() -> None:
    message = failed(bent(first=350.0, second=900.0) + white(1)).message
    assert message.startswith("the slope rises from 3")
    assert message.endswith(" mm")


def test_next_to_an_end_it_is_not_one_of_the_specimen() -> None:
    found = failed(bent(at=3.5e-4, first=3000.0) + white(0, 1e-3))
    assert found.code == "kink_at_end"
    assert found.message.startswith("the slope falls at 0.3")
    assert found.message.endswith("next to an end of the stretch from 0.2 to 5 mm")


def test_says_why_not() -> None:
    assert fit_kink(D[:9], D[:9]) == Failure(
        "too_few_samples", "9 samples in the stretch, 16 are needed"
    )


@pytest.mark.parametrize("memory", [0.0, 0.8])
@pytest.mark.parametrize("runs", [60, pytest.param(600, marks=pytest.mark.slow)])
def test_intervals_cover(memory: float, runs: int) -> None:
    hits = np.zeros(2, dtype=int)
    for seed in range(runs):
        noise = 0.02 * memory_noise(np.random.default_rng(seed), len(D), memory)
        found = fit_kink(D, bent() + noise)
        assert isinstance(found, Kink)
        hits += [holds(found.displacement, 2e-3), holds(found.force, 1.8)]
    for count in hits.tolist():
        # No less than 95 %; noise that remembers is allowed a little more (see fit_linear).
        assert binomtest(count, runs, 0.95, alternative="less").pvalue > 0.005
        assert binomtest(count, runs, 0.98, alternative="greater").pvalue > 0.005


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
