"""Means with t-based intervals, nested in spools, on a log scale, and with what a rig shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import exp, hypot

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binomtest

from labpipe.records.group import MeanInterval, NestedMean
from labpipe.records.result import Contribution, Result
from labpipe.statistics.groups import average_result
from labpipe.statistics.means import (
    PoolingLimits,
    add_common_causes,
    are_positive,
    compute_mean,
    compute_nested_mean,
    compute_smallest_p,
    compute_spools_p,
    convert_to_log_scale,
    estimate_spool_scatter,
)
from labpipe.statistics.significance import (
    compute_contrast,
    compute_difference_p,
    compute_equivalence_p,
    subtract_means,
)
from tests.builders.bundle_campaigns import bundle_sample


def test_no_samples_and_one_sample_say_so() -> None:
    empty, single = compute_mean([], "sample"), compute_mean([3.0], "spool")
    assert np.isnan(empty.mean)
    assert empty.interval is None
    assert str(empty.reason).startswith("no_samples: ")
    assert averaged({}).chosen.estimate is None
    assert (single.mean, single.interval, single.n) == (3.0, None, 1)
    assert str(single.reason).endswith("needs two values, there is one spool")
    scatter = estimate_spool_scatter([np.array([1.0]), np.array([2.0])], 0.95)
    assert np.isnan([scatter.within, scatter.between_spools, scatter.spool_share]).all()
    assert scatter.max_spool_share == 1.0


def test_spools_count_alike() -> None:
    mean = compute_nested_mean({"a": [1.0, 1.0, 1.0, 2.0], "b": [9.0, 10.0]})
    assert mean.chosen.mean == pytest.approx((1.25 + 9.5) / 2)
    assert mean.chosen.n == 2
    assert mean.n_samples == 6


def test_many_alike_spools_are_pooled() -> None:
    rng = np.random.default_rng(3)
    spools = {f"s{number}": rng.normal(5.0, 1.0, 20) for number in range(40)}
    mean = compute_nested_mean(spools, PoolingLimits(confidence=0.95))
    assert mean.is_pooled
    assert mean.chosen.n == 800
    assert str(mean.decision).startswith("Pooled over 800 samples of 40 spools")


def test_every_limit_can_forbid_pooling() -> None:
    spools = {"a": [1.0, 2.0, 3.0], "b": [2.5, 3.5, 4.5]}
    loose = PoolingLimits(min_p=0.0, max_spool_share=1.0)
    assert compute_nested_mean(spools, loose).is_pooled
    assert not compute_nested_mean(spools, PoolingLimits(min_p=1.0, max_spool_share=1.0)).is_pooled
    assert not compute_nested_mean(spools, PoolingLimits(min_p=0.0, max_spool_share=0.5)).is_pooled


@pytest.mark.parametrize("counts", [(3, 3), (2, 3)])
@pytest.mark.parametrize("share", [0.1, 0.9])
def test_upper_limit_of_the_share_holds(counts: tuple[int, ...], share: float) -> None:
    rng, runs = np.random.default_rng(2), 1000
    spread = np.sqrt(share / (1.0 - share))
    hits = 0
    for _ in range(runs):
        spools = [rng.normal(rng.normal(0.0, spread), 1.0, count) for count in counts]
        hits += estimate_spool_scatter(spools, 0.95).max_spool_share >= share
    assert binomtest(hits, runs, 0.95).pvalue > 0.01, hits


def test_smallest_p_of_few_samples() -> None:
    """2 of the 20 ways to deal six samples out to two spools keep them apart."""
    assert compute_spools_p([np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])]) == 0.1
    chances = {(3, 3): 0.1, (2, 3): 0.2, (2, 2): 1 / 3, (2, 2, 2): 1 / 15, (9, 9): 0.001}
    assert {counts: compute_smallest_p(counts) for counts in chances} == pytest.approx(chances)


def ends(mean: MeanInterval) -> tuple[float, float]:
    """Of the interval of a mean."""
    assert mean.interval is not None
    return mean.interval.lower, mean.interval.upper


def test_an_interval_as_a_spreadsheet_gives_it() -> None:
    """9, 10, 14: mean 11, s = 2.6458; t(2) = 4.3027, h = 6.5724; factor exp(h / 11) = 1.8176."""
    mean = convert_to_log_scale(compute_nested_mean({"a": [9.0, 10.0, 14.0]})).chosen
    assert mean.mean == 11.0
    assert ends(mean) == pytest.approx((11.0 / 1.8176, 11.0 * 1.8176), rel=1e-4)
    assert mean.is_log
    assert mean.half_width == pytest.approx(6.5724, rel=1e-4)


def test_nothing_is_put_where_there_is_no_interval_or_no_positive_middle() -> None:
    single = compute_nested_mean({"a": [3.0]})
    assert convert_to_log_scale(single) == single
    negative = compute_nested_mean({"a": [-3.0, 1.0]})
    assert convert_to_log_scale(negative) == negative


def test_what_a_rig_shares_is_in_it() -> None:
    base = bundle_sample(None, 1)
    common = (Contribution("scale of the force", 0.5, is_common=True),)
    samples = [
        replace(base, test=f"{value}", results=(Result("k", value, "N/m", budget=common),))
        for value in (9.0, 10.0, 14.0)
    ]
    half = np.hypot(stats.t.ppf(0.975, 2) * np.sqrt(7.0 / 3.0), stats.norm.ppf(0.975) * 0.5)
    on_a_log_scale = (11 / exp(half / 11), 11 * exp(half / 11))
    for is_signed, expected in ((False, on_a_log_scale), (True, (11.0 - half, 11.0 + half))):
        number = average_result("k", samples, is_signed=is_signed)
        assert number.mean is not None
        assert ends(number.mean.chosen) == pytest.approx(expected)


def test_a_value_that_is_not_positive_keeps_the_scale_linear() -> None:
    base = Result("k", 1.0, "N", method="m")
    assert are_positive([base, replace(base, estimate=0.9)])
    assert not are_positive([base, replace(base, value=0.0)])
    assert not are_positive([replace(base, estimate=-0.1)])


T_1, NORMAL = 12.7062047362, 1.9599639845
"""97.5 % quantiles of Student's t with one degree of freedom and of the normal distribution."""


def measured(value: float, *, off: float = 0.0, **changes: float) -> Result:
    """A result with noise, and with common causes by the first word of their names."""
    names = {"force": "scale of the force", "frame": "compliance of the frame"}
    common = [Contribution(names[key], change, is_common=True) for key, change in changes.items()]
    budget = (Contribution("noise", 5.0), *common)
    return Result("stiffness", value, "N/m", estimate=value - off, budget=budget)


def averaged(spools: Mapping[str, list[Result]]) -> NestedMean:
    values = {name: [result.value or 0.0 for result in results] for name, results in spools.items()}
    return add_common_causes(compute_nested_mean(values), spools)


def test_a_cause_that_all_share_is_added_in_quadrature() -> None:
    """10 and 12: s / sqrt(n) = 1, so 11 -+ 12.7 of the scatter; 0.3 and 0.5 have the mean 0.4.

    Changes keep their signs: +0.3 and -0.1 of the frame leave 0.1, and 0.4 of the force with them
    sqrt(0.17).
    """
    mean = averaged({"a": [measured(10.0, force=3.0), measured(12.0, force=5.0)]})
    assert mean.chosen.common == (Contribution("scale of the force", 4.0, is_common=True),)
    half = hypot(T_1, 4.0 * NORMAL)
    assert ends(mean.chosen) == pytest.approx((11.0 - half, 11.0 + half))
    assert (mean.chosen.mean, mean.chosen.estimate) == (11.0, None)
    assert mean.chosen.deviation == pytest.approx(np.sqrt(2.0))
    assert mean.decision.grounds[-1].endswith("what all tests of a rig share: scale of the force")
    spool = [measured(10.0, force=0.4, frame=0.3), measured(12.0, force=0.4, frame=-0.1)]
    half = hypot(T_1, NORMAL * np.sqrt(0.17))
    assert ends(averaged({"a": spool}).chosen) == pytest.approx((11.0 - half, 11.0 + half))


def test_the_interval_lies_about_the_estimates() -> None:
    """Noise adds 1 and 3 to the largest samples: 2 on average."""
    mean = averaged({"a": [measured(10.0, off=1.0), measured(12.0, off=3.0)]})
    assert (mean.chosen.mean, mean.chosen.estimate) == (11.0, 9.0)
    assert ends(mean.chosen) == pytest.approx((9.0 - T_1, 9.0 + T_1))
    assert not mean.chosen.common
    assert "share" not in str(mean.decision)


def group(mean: float, change: float, off: float = 0.0) -> MeanInterval:
    spool = [measured(mean - 1.0, force=change, off=off), measured(mean + 1.0, force=change)]
    return averaged({"a": spool}).chosen


def test_a_gain_acts_on_both_groups_alike() -> None:
    """0.3 % of 100 and of 110: the difference of 10 changes by 0.3 %, 0.03, and not by 0.45."""
    first, second = group(100.0, 0.30), group(110.0, 0.33)
    difference = subtract_means(first, second)
    assert difference.common[0].change == pytest.approx(0.03)
    without_gain = subtract_means(compute_mean([99.0, 101.0]), compute_mean([109.0, 111.0]))
    half = hypot(ends(without_gain)[1] - 10.0, 0.03 * NORMAL)
    assert ends(difference) == pytest.approx((10.0 - half, 10.0 + half))


def test_the_middle_of_a_difference_is_that_of_the_estimates() -> None:
    """Estimates are off the means by 1 and by 3; the means differ by 10."""
    first, second = compute_mean([99.0, 101.0]), compute_mean([109.0, 111.0])
    difference = subtract_means(replace(first, estimate=101.0), replace(second, estimate=113.0))
    low, high = ends(difference)
    assert (difference.mean, difference.middle) == (10.0, 12.0)
    assert 0.5 * (low + high) == pytest.approx(12.0)


@pytest.mark.parametrize("change", [0.0, 2.0])
def test_equivalence_where_the_interval_ends(change: float) -> None:
    """At p = 5 % the margin is the end of the 90 % interval; it grows with what is shared."""
    first, second = group(100.0, 0.0), group(101.0, change)
    contrast = compute_contrast(first, second)
    assert contrast is not None
    degrees, error = 2.0, np.sqrt(2.0)
    half = hypot(2.9199855804 * error, 1.6448536270 * change)  # 95 % quantiles, t with 2 degrees
    for margin, p in [(1.0 + half, 0.05), (1.0 - half, 0.95)]:
        assert compute_equivalence_p(replace(contrast, margin=margin)) == pytest.approx(p)
    assert compute_equivalence_p(replace(contrast, margin=1e9)) < 1e-6
    assert contrast.freedom == degrees
    assert compute_difference_p(replace(contrast, difference=half)) == pytest.approx(0.1)
