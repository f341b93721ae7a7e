"""Tops and ends of curves: only the smooth stretch there counts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.fitting.estimates import Estimate
from labpipe.fitting.summits import height_at_end, height_of_top, short_median
from labpipe.records.arrays import Floats

D = np.arange(0.0, 0.035, 5e-5)


def rise(d: Floats) -> Floats:
    return np.asarray(np.interp(d, [0.0, 0.009, 0.025], [0.0, 180.0, 356.0]), dtype=np.float64)


def beyond(d: Floats) -> Floats:
    return np.maximum(d - 0.025, 0.0)


CASES: dict[str, Callable[[Floats], Floats]] = {
    "falls by 5 N/mm": lambda d: rise(d) - 5e3 * beyond(d),
    "falls by 2 N/mm": lambda d: rise(d) - 2e3 * beyond(d),
    "flat": rise,
    "5 % lost, then flat": lambda d: rise(d) - 18.0 * (d > 0.025),
    "one strand gone": lambda d: np.where(d <= 0.025, rise(d), 200.0 + 3500.0 * beyond(d)),
    "round": lambda d: 356.0 - 4e5 * (d - 0.025) ** 2,
}


def holds(estimate: Estimate, truth: float) -> bool:
    assert estimate.interval is not None
    return estimate.interval.lower <= truth <= estimate.interval.upper


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("step", [5e-5, 2.5e-4])
def test_intervals_hold_the_truth(case: str, step: float) -> None:
    """The curve is sampled, and ends, anywhere in a step."""
    force, tops, ends, widths = CASES[case], 0, 0, []
    for seed in range(60):
        random = np.random.default_rng(seed)
        d = np.arange(random.uniform(0.0, step), 0.035, step)
        noisy = force(d) + random.normal(0.0, 0.5, len(d))
        top = height_of_top(d, noisy, share=0.1, step=step)
        end = height_at_end(d, noisy, step=step)
        tops += holds(top, 356.0)
        ends += holds(end, float(force(np.array([0.035]))[0]))
        widths += [top.error, end.error]
    for hits in (tops, ends):
        assert binomtest(hits, 60, 0.95, alternative="less").pvalue > 0.01, hits
    assert np.median(widths) < 1.3


def test_a_corner_is_not_rounded() -> None:
    top = height_of_top(D, CASES["falls by 5 N/mm"](D) + quiet(), share=0.1, step=5e-5)
    assert top.value == pytest.approx(356.0, abs=0.05)


def quiet() -> Floats:
    return np.random.default_rng(1).normal(0.0, 0.01, len(D))


def test_no_smooth_stretch_gives_the_median_of_a_few() -> None:
    stairs = 20.0 * (np.arange(200) // 8) + np.random.default_rng(2).normal(0.0, 0.1, 200)
    d = np.linspace(0.0, 0.02, 200)
    top, end = height_of_top(d, stairs, share=0.02, step=1e-4), height_at_end(d, stairs, step=1e-4)
    for estimate in (top, end):
        assert estimate.n <= 5
        assert holds(estimate, 480.0)


def test_short_median() -> None:
    assert short_median(np.array([1.0, 9.0, 2.0])).tolist() == [1.0, 2.0, 2.0]
    assert short_median(np.array([1.0, 2.0, 90.0, 4.0, 5.0, 0.0])).tolist()[2] == 4.0
