"""Means of nested samples, and the decision about pooling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.statistics.means import PoolingLimits, nested_mean

COUNTS = st.lists(st.integers(1, 4), min_size=1, max_size=4)


def draw(counts: list[int], seed: int) -> dict[str, list[float]]:
    rng = np.random.default_rng(seed)
    return {f"s{at}": rng.normal(50.0, 3.0, count).tolist() for at, count in enumerate(counts)}


def test_one_spool_is_over_samples_with_its_caveat() -> None:
    found = nested_mean({"a": [1.0, 2.0, 4.0]})
    assert found.chosen == found.over_samples
    assert found.over_spools is None
    assert found.within == pytest.approx(np.std([1, 2, 4], ddof=1))
    assert np.isnan([found.between, found.spool_p]).all()
    assert str(found.decision) == (
        "Over 3 samples of one spool: how spools differ is not known, so the interval holds for "
        "this spool, not for the type."
    )


def test_nothing_and_one_sample() -> None:
    assert str(nested_mean({}).chosen.reason).startswith("no_samples: ")
    assert str(nested_mean({"a": [np.nan]}).chosen.reason).startswith("no_samples: ")
    alone = nested_mean({"a": [1.0]})
    assert str(alone.chosen.reason).startswith("one_sample: ")
    assert "Over 1 sample of one spool" in str(alone.decision)


def test_spools_count_alike() -> None:
    found = nested_mean({"a": [1.0, 1.0, 1.0, 2.0], "b": [9.0, 10.0]})
    assert found.chosen.mean == pytest.approx((1.25 + 9.5) / 2)
    assert found.chosen.n == 2
    assert found.over_samples.n == 6


def test_one_sample_a_spool() -> None:
    found = nested_mean({"a": [1.0], "b": [2.0], "c": [4.0]})
    assert not found.is_pooled
    assert found.chosen == found.over_spools
    assert "no spool has two samples, so the scatter within spools is not known" in str(
        found.decision
    )
    assert found.spool_means["a"].interval is None


def test_equal_values_are_not_pooled() -> None:
    found = nested_mean({"a": [1.0, 1.0], "b": [1.0, 1.0]})
    assert not found.is_pooled
    assert str(found.decision) == (
        "Over 2 spool means, not pooled over 4 samples: "
        "all values are equal, so there is no scatter to tell spools apart by."
    )


def test_equal_values_of_one_sample_each_tell_nothing_of_samples() -> None:
    found = nested_mean({"a": [1.0], "b": [1.0]})
    assert "no spool has two samples" in str(found.decision)
    assert "all values are equal" not in str(found.decision)


def test_two_spools_are_not_pooled_for_want_of_evidence() -> None:
    found = nested_mean({"a": [1.0, 2.0, 3.0], "b": [1.1, 2.1, 2.9]})
    assert found.spool_p > 0.5
    assert not found.is_pooled
    assert str(found.decision) == (
        "Over 2 spool means, not pooled over 6 samples: the spools differ no more than their "
        "samples explain, yet up to 99.7 % of the variance may lie between them; pooling needs "
        "that share below 10 % with 99.9 % confidence; with 3 and 3 samples the Anderson-Darling "
        "test of equal spools cannot tell, as its p is never below 0.1."
    )


def test_samples_enough_for_the_test() -> None:
    near = nested_mean({"a": [1.0, 2.0, 3.0, 4.0], "b": [1.1, 2.1, 2.9, 4.2]})
    assert "the Anderson-Darling test of equal spools does not tell them apart" in str(
        near.decision
    )
    far = nested_mean({"a": [1.0, 2.0, 3.0, 4.0], "b": [11.1, 12.1, 12.9, 14.2]})
    assert "tells them apart (p = 0.029, pooling needs 0.05)" in str(far.decision)


def test_many_alike_spools_are_pooled() -> None:
    rng = np.random.default_rng(3)
    spools = {f"s{at}": rng.normal(5.0, 1.0, 20) for at in range(40)}
    found = nested_mean(spools, PoolingLimits(confidence=0.95))
    assert found.is_pooled
    assert found.chosen.n == 800
    assert str(found.decision).startswith("Pooled over 800 samples of 40 spools")


def test_every_limit_can_forbid_pooling() -> None:
    spools = {"a": [1.0, 2.0, 3.0], "b": [2.5, 3.5, 4.5]}
    loose = PoolingLimits(min_p=0.0, max_spool_share=1.0)
    assert nested_mean(spools, loose).is_pooled
    assert not nested_mean(spools, PoolingLimits(min_p=1.0, max_spool_share=1.0)).is_pooled
    assert not nested_mean(spools, PoolingLimits(min_p=0.0, max_spool_share=0.5)).is_pooled


@given(COUNTS, st.integers(0, 1000), st.floats(-100.0, 100.0), st.floats(0.01, 100.0))
def test_moves_scales_and_does_not_mind_the_order(
    counts: list[int], seed: int, shift: float, scale: float
) -> None:
    spools = draw(counts, seed)
    moved = {
        name: [scale * value + shift for value in values[::-1]]
        for name, values in reversed(spools.items())
    }
    first, second = nested_mean(spools), nested_mean(moved)
    assert second.chosen.n == first.chosen.n
    assert second.is_pooled == first.is_pooled
    assert second.chosen.mean == pytest.approx(scale * first.chosen.mean + shift, abs=1e-6)
    assert second.within == pytest.approx(scale * first.within, rel=1e-6, nan_ok=True)
    assert second.spool_p == pytest.approx(first.spool_p, nan_ok=True)


@given(st.integers(1, 6))
def test_one_sample_more_is_said(count: int) -> None:
    values = [float(value) for value in range(count)]
    assert nested_mean({"a": [*values, 7.0]}).chosen.n == count + 1
