"""What all tests of a rig share does not average out: cases by hand, and how often it holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import hypot

import numpy as np
import pytest

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval, NestedMean
from labpipe.records.result import Contribution, Result
from labpipe.statistics.means import mean_interval, nested_mean
from labpipe.statistics.shared_causes import difference_of, widened_by, with_shared
from labpipe.statistics.two_groups import (
    contrast_of,
    difference_of_means,
    difference_p,
    equivalence_p,
)

T_1, NORMAL = 12.7062047362, 1.9599639845
"""97.5 % quantiles of Student's t with one degree of freedom and of the normal distribution."""


def measured(value: float, *, off: float = 0.0, **changes: float) -> Result:
    """A result with noise, and with common causes by the first word of their names."""
    names = {"force": "scale of the force", "frame": "compliance of the frame"}
    common = [Contribution(names[key], each, is_common=True) for key, each in changes.items()]
    budget = (Contribution("noise", 5.0), *common)
    return Result("stiffness", value, "N/m", estimate=value - off, budget=budget)


def averaged(spools: Mapping[str, list[Result]]) -> NestedMean:
    values = {name: [each.value or 0.0 for each in own] for name, own in spools.items()}
    return with_shared(nested_mean(values), spools)


def ends(mean: MeanInterval | None) -> tuple[float, float]:
    assert mean is not None
    assert mean.interval is not None
    return mean.interval.lower, mean.interval.upper


def test_a_cause_that_all_share_is_added_in_quadrature() -> None:
    """10 and 12: s / sqrt(n) = 1, so 11 -+ 12.7 of the scatter; 0.3 and 0.5 have the mean 0.4."""
    found = averaged({"a": [measured(10.0, force=3.0), measured(12.0, force=5.0)]})
    assert found.chosen.common == (Contribution("scale of the force", 4.0, is_common=True),)
    half = hypot(T_1, 4.0 * NORMAL)
    assert ends(found.chosen) == pytest.approx((11.0 - half, 11.0 + half))
    assert (found.chosen.mean, found.chosen.estimate) == (11.0, None)
    assert found.chosen.deviation == pytest.approx(np.sqrt(2.0))
    assert found.decision.because[-1].endswith("what all tests of a rig share: scale of the force")


def test_changes_keep_their_signs_and_causes_are_independent() -> None:
    """Of the frame +0.3 and -0.1 leave 0.1; with 0.4 of the force sqrt(0.17)."""
    spool = [measured(10.0, force=0.4, frame=0.3), measured(12.0, force=0.4, frame=-0.1)]
    found = averaged({"a": spool}).chosen
    half = hypot(T_1, NORMAL * np.sqrt(0.17))
    assert ends(found) == pytest.approx((11.0 - half, 11.0 + half))


def test_a_test_without_the_cause_counts_as_unmoved() -> None:
    found = averaged({"a": [measured(10.0, force=3.0), measured(12.0)]}).chosen
    assert found.common[0].change == pytest.approx(1.5)


def test_spools_count_alike() -> None:
    """Spool means of the changes are 1 and 4: 2.5 over spools, 2 over the three samples."""
    found = averaged(
        {"a": [measured(1.0, force=1.0), measured(2.0, force=1.0)], "b": [measured(9.0, force=4.0)]}
    )
    assert not found.is_pooled
    assert found.chosen.common[0].change == pytest.approx(2.5)
    assert found.over_samples.common[0].change == pytest.approx(2.0)
    assert found.chosen == found.over_spools
    half = hypot(T_1 * 0.5, NORMAL * 1.0)  # 1 and 2: s / sqrt(2) = 0.5
    assert ends(found.spool_means["a"]) == pytest.approx((1.5 - half, 1.5 + half))
    assert found.spool_means["b"].interval is None


def test_the_interval_lies_about_the_estimates() -> None:
    """Noise adds 1 and 3 to the largest samples: 2 on average."""
    found = averaged({"a": [measured(10.0, off=1.0), measured(12.0, off=3.0)]})
    assert (found.chosen.mean, found.chosen.estimate) == (11.0, 9.0)
    assert ends(found.chosen) == pytest.approx((9.0 - T_1, 9.0 + T_1))
    assert not found.chosen.common
    assert "share" not in str(found.decision)


def test_no_value_no_interval() -> None:
    assert averaged({}).chosen.interval is None
    alone = averaged({"a": [measured(10.0, force=3.0)]}).chosen
    assert alone.interval is None
    assert alone.common[0].change == 3.0


def group(mean: float, change: float, off: float = 0.0) -> MeanInterval:
    spool = [measured(mean - 1.0, force=change, off=off), measured(mean + 1.0, force=change)]
    return averaged({"a": spool}).chosen


def test_a_gain_acts_on_both_groups_alike() -> None:
    """0.3 % of 100 and of 110: the difference of 10 changes by 0.3 %, 0.03, and not by 0.45."""
    one, two = group(100.0, 0.30), group(110.0, 0.33)
    found = difference_of_means(one, two)
    assert found.common[0].change == pytest.approx(0.03)
    plain = difference_of_means(mean_interval([99.0, 101.0]), mean_interval([109.0, 111.0]))
    half = hypot(ends(plain)[1] - 10.0, 0.03 * NORMAL)
    assert ends(found) == pytest.approx((10.0 - half, 10.0 + half))


def test_a_cause_of_one_group_alone_does_not_cancel() -> None:
    one, two = (Contribution("speed of the drive", 0.2, is_common=True),), ()
    assert [each.change for each in difference_of(one, two)] == [-0.2]
    assert [each.change for each in difference_of(two, one)] == [0.2]


def test_the_difference_is_that_of_the_estimates() -> None:
    found = difference_of_means(group(100.0, 0.3), group(110.0, 0.3, off=4.0))
    assert found.mean == 10.0
    assert found.estimate == pytest.approx(8.0)
    assert sum(ends(found)) == pytest.approx(16.0)


@pytest.mark.parametrize("change", [0.0, 2.0])
def test_equivalence_where_the_interval_ends(change: float) -> None:
    """At p = 5 % the margin is the end of the 90 % interval; it grows with what is shared."""
    one, two = group(100.0, 0.0), group(101.0, change)
    contrast = contrast_of(one, two)
    assert contrast is not None
    degrees, error = 2.0, np.sqrt(2.0)
    half = hypot(2.9199855804 * error, 1.6448536270 * change)  # 95 % quantiles, t with 2 degrees
    for margin, p in [(1.0 + half, 0.05), (1.0 - half, 0.95)]:
        assert equivalence_p(replace(contrast, margin=margin)) == pytest.approx(p)
    assert equivalence_p(replace(contrast, margin=1e9)) < 1e-6
    assert contrast.degrees == degrees
    assert difference_p(replace(contrast, between=half)) == pytest.approx(0.1)


def test_an_interval_without_common_causes_stays() -> None:
    given = Interval(1.0, 3.0)
    assert widened_by(given, ()) is given


@pytest.mark.parametrize(("n", "shared"), [(2, 1.0), (3, 3.0), (6, 0.3), (6, 1.0)])
def test_how_often_the_widened_interval_holds_the_mean(n: int, shared: float) -> None:
    """Values scatter by 1 and are off together by `shared` / sqrt(n); 4000 groups know 0.4 %."""
    rng = np.random.default_rng(1729)
    together = shared / np.sqrt(n)
    held = 0
    for values in rng.normal(0.0, 1.0, (4000, n)) + rng.normal(0.0, together, (4000, 1)):
        interval = mean_interval(values).interval
        assert interval is not None
        wide = widened_by(interval, [Contribution("scale of the force", together)])
        held += wide.lower <= 0.0 <= wide.upper
    assert 0.94 <= held / 4000 <= 0.99
