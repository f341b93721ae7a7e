"""Every 95 % interval and band of a group covers the truth as often as it says.

Seeded simulations of groups whose true mean is known; hits are compared with 95 % by an exact
binomial test, at 1 % shared out over the cases of each study, so that sound intervals fail a study
once in a hundred. Intervals must agree with 95 %; a simultaneous band, whose chance is bounded from
one side, and a difference after Welch must not cover less.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.records.arrays import Floats
from labpipe.statistics.groups import CommonCurves, compute_band
from labpipe.statistics.means import compute_mean, compute_nested_mean
from labpipe.statistics.significance import subtract_means

pytestmark = pytest.mark.slow
RUNS = 1000
SHARES = [0.0, 0.05, 0.1, 0.3, 0.5, 0.8, 0.98]
NESTED = [(3, 3), (2, 2, 2), (2, 3), (1, 2, 3)]
PATH = np.linspace(0.0, 1.0, 101)


def nested_hits(counts: tuple[int, ...], share: float) -> int:
    """How often the chosen interval holds a true mean of 50; samples scatter by 1."""
    rng, spread, hits = np.random.default_rng(sum(counts)), np.sqrt(share / (1.0 - share)), 0
    for _ in range(RUNS):
        spools = {
            f"s{spool}": rng.normal(rng.normal(50.0, spread), 1.0, count)
            for spool, count in enumerate(counts)
        }
        found = compute_nested_mean(spools).chosen.interval
        assert found is not None
        hits += found.lower <= 50.0 <= found.upper
    return hits


@pytest.mark.parametrize(
    ("counts", "share"), [*product(NESTED, SHARES), *(((n,), 0.0) for n in (3, 5, 6))]
)
def test_nested(counts: tuple[int, ...], share: float) -> None:
    """An interval over one spool is about that one, and all its samples share what it adds."""
    hits = nested_hits(counts, share)
    cases = len(NESTED) * len(SHARES) if len(counts) > 1 else 1
    assert binomtest(hits, RUNS, 0.95).pvalue > 0.01 / cases, hits


SIZES, POINTS = (3, 5, 6), len(PATH)
SMOOTH = np.exp(-0.5 * ((PATH[:, None] - PATH) / 0.2) ** 2) + 1e-9 * np.eye(POINTS)
MODES: dict[str, Floats] = {
    "slope": PATH[None] + 0.05,
    "slope and zero": np.array([PATH, np.full(POINTS, 0.2)]),
    "slope, zero, bend": np.array([PATH, np.full(POINTS, 0.1), 0.3 * np.maximum(PATH - 0.5, 0)]),
    "slope and noise": np.vstack([PATH, 0.02 * np.eye(POINTS)]),
    "slow waves": np.asarray(np.linalg.cholesky(SMOOTH).T, dtype=np.float64),
    "random walk": np.tril(np.ones((POINTS, POINTS))).T / 10.0,
}
"""Shapes whose random sum is the scatter of a curve, shape (modes, points)."""


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("kind", MODES)
def test_bands(kind: str, n: int) -> None:
    level = 0.01 / (len(MODES) * len(SIZES))
    rng, shapes, truth = np.random.default_rng(n), MODES[kind], 20.0 * PATH
    held = held_all = 0
    for _ in range(RUNS):
        curves = truth + rng.normal(size=(n, len(shapes))) @ shapes
        band = compute_band(CommonCurves(PATH, curves))
        held += bool(band.lower[50] <= truth[50] <= band.upper[50])
        held_all += bool(np.all((band.lower_all <= truth) & (truth <= band.upper_all)))
    assert binomtest(held, RUNS, 0.95).pvalue > level, held
    assert binomtest(held_all, RUNS, 0.95, alternative="less").pvalue > level, held_all


@pytest.mark.parametrize("ratio", [1.0, 2.0])
@pytest.mark.parametrize("counts", [(3, 3), (5, 5), (6, 6), (3, 6)])
def test_differences(counts: tuple[int, int], ratio: float) -> None:
    rng, hits = np.random.default_rng(sum(counts)), 0
    for _ in range(RUNS):
        first = compute_mean(rng.normal(10.0, 1.0, counts[0]))
        second = compute_mean(rng.normal(12.0, ratio, counts[1]))
        found = subtract_means(first, second).interval
        assert found is not None
        hits += found.lower <= 2.0 <= found.upper
    # Welch's degrees of freedom are approximate: at n = 3 the interval may cover a little more.
    assert binomtest(hits, RUNS, 0.95, alternative="less").pvalue > 0.01, hits
