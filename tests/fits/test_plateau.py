"""The end of a loading curve: how steep it is, where it got flat, and when it did not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.fits.plateau import EndSlope, Onset, find_onset, fit_end_slope
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure
from tests.builders.loading_tests import memory_noise

D = np.linspace(0.0, 0.05, 1500)
OVER = 5e-3
SCALE = 0.012
SOFT: Floats = 10.0 * (1.0 - np.exp(-D / SCALE))
"""Initial slope 10 / SCALE; the tangent is a tenth of it at SCALE ln 10."""
INITIAL = Estimate(10.0 / SCALE, 0.01 * 10.0 / SCALE, 50)
ONSET = SCALE * np.log(10.0)


def onset(force: Floats, initial: Estimate = INITIAL, below: float = 0.1) -> Onset | Failure:
    return find_onset(D, force, initial=initial, over=OVER, slope_below=below)


def end(force: Floats, initial: Estimate = INITIAL) -> EndSlope | Failure:
    return fit_end_slope(D, force, initial=initial, over=OVER)


def holds(found: Estimate, true: float) -> bool:
    assert found.interval is not None
    return found.interval.lower <= true <= found.interval.upper


def test_smooth_curve_without_noise() -> None:
    found = onset(SOFT)
    assert isinstance(found, Onset)
    assert found.displacement.value == pytest.approx(ONSET, abs=1e-4)
    assert found.force.value == pytest.approx(9.0, abs=0.02)
    last = end(SOFT)
    assert isinstance(last, EndSlope)
    assert last.share.value == pytest.approx(np.exp(-0.0475 / SCALE), rel=0.02)
    assert last.start == pytest.approx(0.045, abs=4e-5)
    assert last.stop == 0.05
    assert last.level == pytest.approx(np.interp(last.start, D, SOFT), abs=0.02)
    assert last.slope == pytest.approx(last.share.value * INITIAL.value)


def test_a_kink_is_held_by_the_interval() -> None:
    force = np.where(D < 0.03, 400.0 * D - 5000.0 * D**2, 7.5 + 8.0 * (D - 0.03))
    found = onset(force, Estimate(400.0, 2.0, 50))
    assert isinstance(found, Onset)
    assert holds(found.displacement, 0.03)
    assert found.displacement.value == pytest.approx(0.03, abs=0.5 * OVER)


def test_force_at_a_corner_is_not_cut_off() -> None:
    """A parabola over the whole stretch would lie below the corner."""
    force = np.where(D < 0.03, 4.5 + 100.0 * (D - 0.03), 4.5 - 10.0 * (D - 0.03))
    found = onset(force, Estimate(450.0, 2.0, 50))
    assert isinstance(found, Onset)
    at = found.displacement.value
    stretch = np.abs(D - at) <= 0.5 * OVER
    whole = float(np.polynomial.Polynomial.fit(D[stretch], force[stretch], 2)(at))
    cut = float(np.interp(at, D, force)) - whole
    assert cut > 0.01
    assert found.force.value - whole > 0.3 * cut
    assert holds(found.force, 4.5)


def test_flat_from_the_last_time_on() -> None:
    """A flat stretch halfway is no plateau, if the curve gets steep again."""
    force = np.interp(D, [0.0, 0.01, 0.02, 0.03, 0.05], [0.0, 4.0, 4.1, 8.0, 8.1])
    found = onset(force, Estimate(400.0, 2.0, 50))
    assert isinstance(found, Onset)
    assert holds(found.displacement, 0.03)
    assert found.displacement.value == pytest.approx(0.03, abs=0.5 * OVER)


def test_no_plateau_where_the_end_is_steep_or_not_surely_flat() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.02, len(D))
    for below in (0.01, 0.0192):
        found = onset(SOFT + noise, below=below)
        assert isinstance(found, Failure)
        assert found.code == "no_plateau"
        assert found.message.endswith(" % of the initial slope")


def test_no_plateau_in_a_curve_that_is_nowhere_steep() -> None:
    found = onset(10.0 * D)
    assert found == Failure("no_plateau", "the curve is nowhere steeper than at its end")


def test_says_why_not() -> None:
    assert end(SOFT, Estimate(-3.0, 1.0, 9)) == Failure(
        "no_stiffness", "the slope at the start is -3 N/m"
    )
    short = fit_end_slope(D[:200], SOFT[:200], initial=INITIAL, over=OVER)
    assert short == Failure("not_reached", "the branch is 6.638 mm long, twice 5 mm is needed")
    assert isinstance(onset(np.full(len(D), np.nan)), Failure)
    sparse = fit_end_slope(D[::100], SOFT[::100], initial=INITIAL, over=OVER)
    assert sparse == Failure("too_few_samples", "2 samples in the stretch, 8 are needed")
    jump = np.concatenate([np.linspace(0.0, 0.04, 100), np.linspace(0.0499, 0.05, 100)])
    stuck = fit_end_slope(jump, 400.0 * jump, initial=INITIAL, over=OVER)
    assert stuck == Failure("no_travel", "the displacement jumps over the stretch")


@pytest.mark.parametrize("memory", [0.0, 0.8])
@pytest.mark.parametrize("runs", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_intervals_cover(memory: float, runs: int) -> None:
    """No less often than 95 %; how much more is told in the explanation."""
    share = (SOFT[-1] - np.interp(0.045, D, SOFT)) / OVER / INITIAL.value
    hits = np.zeros(3, dtype=int)
    for seed in range(runs):
        generator = np.random.default_rng(seed)
        force = SOFT + 0.02 * memory_noise(generator, len(D), memory)
        value = INITIAL.value * (1.0 + 0.01 * generator.normal())
        initial = Estimate(value, 0.01 * value, 50)
        last, found = end(force, initial), onset(force, initial)
        assert isinstance(last, EndSlope)
        assert isinstance(found, Onset)
        hits += [
            holds(last.share, share),
            holds(found.displacement, ONSET),
            holds(found.force, 9.0),
        ]
    for count in hits.tolist():
        assert binomtest(count, runs, 0.95, alternative="less").pvalue > 0.005
