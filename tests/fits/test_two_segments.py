"""The two-segment fit: exact, global, and honest where there is no bend."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.two_segments import TwoSegments, fit_two_segments
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Failure

D = np.linspace(0.002, 0.02, 120)
F = 45.0 + np.where(D < 0.0093, 5000.0, 2700.0) * (D - 0.0093)


def noisy(seed: int) -> Floats:
    return F + np.random.default_rng(seed).normal(0, 0.5, len(D))


def test_exact_between_samples() -> None:
    found = fit_two_segments(D, F)
    assert isinstance(found, TwoSegments)
    assert found.break_point.value == pytest.approx(0.0093, rel=1e-9)
    assert found.first.value == pytest.approx(5000.0, rel=1e-9)
    assert found.second.value == pytest.approx(2700.0, rel=1e-9)
    assert found.level == pytest.approx(45.0, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_no_break_on_a_fine_grid_does_better(seed: int) -> None:
    force = noisy(seed)
    found = fit_two_segments(D, force)
    assert isinstance(found, TwoSegments)
    for at in np.linspace(D[4], D[-5], 3001):
        design = np.column_stack([np.ones_like(D), np.minimum(D - at, 0), np.maximum(D - at, 0)])
        left = np.linalg.lstsq(design, force, rcond=None)[1][0]
        assert found.squares <= left * (1.0 + 1e-10)


def test_order_and_missing_samples_do_not_matter() -> None:
    force = noisy(7)
    force[50] = np.nan
    found, without = (
        fit_two_segments(D, force),
        fit_two_segments(np.delete(D, 50), np.delete(force, 50)),
    )
    assert isinstance(found, TwoSegments)
    assert isinstance(without, TwoSegments)
    assert found.break_point == without.break_point


def test_interval_of_the_break_holds_it() -> None:
    found = fit_two_segments(D, noisy(1))
    assert isinstance(found, TwoSegments)
    assert found.break_point.interval is not None
    assert found.break_point.interval.lower < 0.0093 < found.break_point.interval.upper


def test_says_why_not() -> None:
    assert fit_two_segments(D[:15], F[:15]) == Failure(
        "too_few_samples", "15 samples in the stretch, 16 are needed"
    )
    back = fit_two_segments(D[::-1], F[::-1])
    assert back == Failure("not_increasing", "the displacement goes from 0.02 m to 0.002 m")
    straight = fit_two_segments(D, 5000.0 * D + np.random.default_rng(2).normal(0, 0.5, len(D)))
    assert isinstance(straight, Failure)
    assert straight.code == "no_bend"
    assert "4.0 standard errors" in straight.message


def test_a_break_at_the_end_is_none() -> None:
    rng = np.random.default_rng(0)
    force = np.where(D[-4] > D, 5000.0 * D, 5000.0 * D[-4] + 60000.0 * (D - D[-4]))
    found = fit_two_segments(D, force + rng.normal(0, 0.2, len(D)))
    assert isinstance(found, Failure)
    assert found.code == "no_bend"
