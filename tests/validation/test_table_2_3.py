"""Table 2.3 of the source: normalised stiffness of the twist tube, two spools of three samples."""

from __future__ import annotations

import pytest

from labpipe.statistics.means import nested_mean

FIRST = {"1": [58.33, 57.71, 56.28], "2": [47.09, 48.19, 46.08]}
SECOND = {"1": [31.78, 33.98, 32.98], "2": [27.38, 28.81, 30.50]}
"""1/m, by spool."""


def test_spool_means() -> None:
    means = nested_mean(FIRST).spool_means
    assert means["1"].mean == pytest.approx(57.44, abs=0.005)
    assert means["2"].mean == pytest.approx(47.12, abs=0.005)


def test_scatter_within_and_between_spools() -> None:
    found = nested_mean(FIRST)
    assert found.within == pytest.approx(1.05, abs=0.005)
    assert found.between == pytest.approx(7.27, abs=0.005)


def test_pooled_and_over_spools() -> None:
    found = nested_mean(FIRST)
    pooled, over_spools = found.over_samples, found.over_spools
    assert over_spools is not None
    assert pooled.interval is not None
    assert over_spools.interval is not None
    assert pooled.mean == pytest.approx(52.28, abs=0.005)
    assert pooled.interval.upper - pooled.mean == pytest.approx(6.01, abs=0.005)
    assert over_spools.interval.upper - over_spools.mean == pytest.approx(65.6, abs=0.05)


def test_not_pooled_and_why() -> None:
    found = nested_mean(FIRST)
    assert not found.is_pooled
    assert found.chosen == found.over_spools
    assert str(found.decision) == (
        "Over 2 spool means, not pooled over 6 samples: 97.9 % of the variance lies between spools "
        "(spools scatter 6.9 times as much as samples), and it may be up to 100 %; pooling needs "
        "that share below 10 % with 99.9 % confidence; with 3 and 3 samples the Anderson-Darling "
        "test of equal spools cannot tell, as its p is never below 0.1."
    )


def test_second_region_is_not_pooled_either() -> None:
    found = nested_mean(SECOND)
    assert not found.is_pooled
    assert found.chosen.mean == pytest.approx(30.905, abs=0.005)
