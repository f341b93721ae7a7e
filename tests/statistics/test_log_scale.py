"""Intervals of positive numbers on a log scale."""

from __future__ import annotations

from dataclasses import replace
from math import exp

import numpy as np
import pytest
from scipy import stats

from labpipe.records.group import MeanInterval, NestedMean
from labpipe.records.result import Contribution, Result
from labpipe.statistics.groups import group_number
from labpipe.statistics.log_scale import can_be_on_a_log_scale, on_log_scale
from labpipe.statistics.means import nested_mean
from tests.builders.bundle_campaigns import bundle_sample


def ends(mean: MeanInterval) -> tuple[float, float]:
    assert mean.interval is not None
    return mean.interval.lower, mean.interval.upper


def test_an_interval_as_a_spreadsheet_gives_it() -> None:
    """9, 10, 14: mean 11, s = 2.6458; t(2) = 4.3027, h = 6.5724; factor exp(h / 11) = 1.8176."""
    found = on_log_scale(nested_mean({"a": [9.0, 10.0, 14.0]})).chosen
    assert found.mean == 11.0
    assert ends(found) == pytest.approx((11.0 / 1.8176, 11.0 * 1.8176), rel=1e-4)
    assert found.is_log
    assert found.half == pytest.approx(6.5724, rel=1e-4)


def test_two_spools_of_a_table_do_not_reach_below_zero() -> None:
    spools = {"1": [58.33, 57.71, 56.28], "2": [47.09, 48.19, 46.08]}
    plain, found = nested_mean(spools), on_log_scale(nested_mean(spools))
    assert ends(plain.chosen)[0] < -13.0
    assert ends(found.chosen) == pytest.approx((14.9, 183.3), rel=2e-3)
    for of, before in zip(found.spool_means.values(), plain.spool_means.values(), strict=True):
        low, high = ends(of)
        assert low * high == pytest.approx(before.mean**2)
    assert found.chosen == found.over_spools
    assert (found.decision, found.within) == (plain.decision, plain.within)


def test_nothing_is_put_where_there_is_no_interval_or_no_positive_middle() -> None:
    alone = nested_mean({"a": [3.0]})
    assert on_log_scale(alone) == alone
    below = nested_mean({"a": [-3.0, 1.0]})
    assert on_log_scale(below) == below


def test_hardly_known_means_keep_finite_ends() -> None:
    low, high = ends(on_log_scale(nested_mean({"a": [1e-12, 1e-3], "b": [1e-12, 1e-12]})).chosen)
    assert 0.0 < low < high < np.inf


def test_what_a_rig_shares_is_in_it() -> None:
    results = [
        Result(
            "k",
            value,
            "N/m",
            method="m",
            budget=(Contribution("scale of the force", 0.5, is_common=True),),
            reasons=(),
        )
        for value in (9.0, 10.0, 14.0)
    ]
    base = bundle_sample(None, 1)
    samples = [replace(base, test=str(at), results=(each,)) for at, each in enumerate(results)]
    number = group_number("k", samples)
    assert number.mean is not None
    half = np.hypot(stats.t.ppf(0.975, 2) * np.sqrt(7.0 / 3.0), stats.norm.ppf(0.975) * 0.5)
    assert ends(number.mean.chosen) == pytest.approx((11 / exp(half / 11), 11 * exp(half / 11)))
    signed = group_number("k", samples, is_signed=True)
    assert signed.mean is not None
    assert ends(signed.mean.chosen) == pytest.approx((11.0 - half, 11.0 + half))


def test_a_value_that_is_not_positive_keeps_the_scale_linear() -> None:
    base = Result("k", 1.0, "N", method="m")
    assert can_be_on_a_log_scale([base, replace(base, estimate=0.9)])
    assert not can_be_on_a_log_scale([base, replace(base, value=0.0)])
    assert not can_be_on_a_log_scale([replace(base, estimate=-0.1)])


@pytest.mark.slow
@pytest.mark.parametrize(("n", "scatter"), [(2, 0.2), (3, 0.3), (6, 0.2)])
def test_how_often_it_holds_the_arithmetic_mean(n: int, scatter: float) -> None:
    """3000 groups know 0.4 %; log-normal values whose arithmetic mean is 1."""
    spread = np.sqrt(np.log1p(scatter**2))
    rng = np.random.default_rng(7)
    held = 0
    for values in np.exp(rng.normal(-(spread**2) / 2.0, spread, (3000, n))):
        low, high = ends(_mean(values.tolist()).chosen)
        held += low <= 1.0 <= high
    assert 0.935 <= held / 3000 <= 0.965


def _mean(values: list[float]) -> NestedMean:
    return on_log_scale(nested_mean({"a": values}))


def test_it_lies_about_the_estimate() -> None:
    """Noise adds 1 to each of 9, 10, 14: the middle is 10."""
    base = bundle_sample(None, 1)
    samples = [
        replace(
            base,
            test=str(value),
            results=(Result("k", value, "N", method="m", estimate=value - 1.0),),
        )
        for value in (9.0, 10.0, 14.0)
    ]
    mean = group_number("k", samples).mean
    assert mean is not None
    low, high = ends(mean.chosen)
    assert mean.chosen.mean == 11.0
    assert low * high == pytest.approx(100.0)
    assert high / low == pytest.approx(exp(2.0 * 6.5724 / 10.0), rel=1e-4)
