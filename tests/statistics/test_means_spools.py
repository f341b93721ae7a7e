"""Scatter between spools against what the samples were made from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.statistics.means import equal_spools_p, smallest_p, spool_scatter


@pytest.mark.parametrize("counts", [(3, 3), (2, 2, 2), (4, 3, 6, 5)])
def test_components_are_those_of_the_samples(counts: tuple[int, ...]) -> None:
    rng, found = np.random.default_rng(1), []
    for _ in range(3000):
        spools = [rng.normal(rng.normal(0.0, 2.0), 1.0, count) for count in counts]
        scatter = spool_scatter(spools, 0.95)
        found.append((scatter.within**2, scatter.between**2))
    within, between = np.mean(found, axis=0)
    assert within == pytest.approx(1.0, rel=0.05)
    # Cut off at zero, so a little above 4.
    assert 3.8 < between < 4.5


@pytest.mark.parametrize("counts", [(3, 3), (2, 2, 2), (2, 3)])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_upper_limit_of_the_share_holds(counts: tuple[int, ...], share: float) -> None:
    rng, runs = np.random.default_rng(2), 1000
    spread = np.sqrt(share / (1.0 - share))
    hits = 0
    for _ in range(runs):
        spools = [rng.normal(rng.normal(0.0, spread), 1.0, count) for count in counts]
        hits += spool_scatter(spools, 0.95).share_upper >= share
    assert binomtest(hits, runs, 0.95).pvalue > 0.01, hits


def test_no_spool_with_two_samples() -> None:
    scatter = spool_scatter([np.array([1.0]), np.array([2.0])], 0.95)
    assert np.isnan([scatter.within, scatter.between, scatter.share]).all()
    assert scatter.share_upper == 1.0


def test_spools_as_alike_as_samples_have_no_scatter_of_their_own() -> None:
    scatter = spool_scatter([np.array([1.0, 3.0]), np.array([3.0, 1.0])], 0.95)
    assert scatter.between == scatter.share == scatter.share_upper == 0.0


def test_few_samples_give_an_exact_p() -> None:
    # 2 of the 20 ways to deal six samples out to two spools keep them apart like this.
    assert equal_spools_p([np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])]) == 0.1


def test_many_samples_give_a_p_from_the_table() -> None:
    low, high = np.arange(9.0), np.arange(9.0) + 50.0
    assert equal_spools_p([low, high]) == pytest.approx(0.001)
    assert equal_spools_p([low, low + 0.5]) == pytest.approx(0.25)


def test_without_p() -> None:
    one, two, same = np.array([1.0]), np.array([1.0, 2.0]), np.array([1.0, 1.0])
    assert np.isnan(equal_spools_p([two]))
    assert np.isnan(equal_spools_p([one, two]))
    assert np.isnan(equal_spools_p([same, same]))


@pytest.mark.parametrize(
    ("counts", "expected"),
    [((3, 3), 0.1), ((2, 3), 0.2), ((2, 2), 1 / 3), ((2, 2, 2), 1 / 15), ((9, 9), 0.001)],
)
def test_smallest_p_of_few_samples(counts: tuple[int, ...], expected: float) -> None:
    assert smallest_p(counts) == pytest.approx(expected)


def test_smallest_p_without_a_test() -> None:
    assert np.isnan([smallest_p((1, 5)), smallest_p((4,))]).all()
