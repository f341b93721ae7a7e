"""Differences of groups and equivalence."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from labpipe.statistics.means import mean_interval, nested_mean
from labpipe.statistics.two_groups import compare, difference_of_means, equivalence_p

FIRST, SECOND = [10.0, 10.4, 9.8, 10.1], [10.9, 11.8, 11.1]


def verdict(
    first: dict[str, list[float]], second: dict[str, list[float]], margin: float | None
) -> str:
    one, two = ("one", nested_mean(first)), ("two", nested_mean(second))
    return compare("stiffness", "N/m", one, two, margin).words


def test_interval_is_that_of_welch() -> None:
    found = difference_of_means(mean_interval(FIRST), mean_interval(SECOND))
    expected = stats.ttest_ind(SECOND, FIRST, equal_var=False).confidence_interval()
    assert found.interval is not None
    assert found.interval.lower == pytest.approx(expected.low, rel=1e-12)
    assert found.interval.upper == pytest.approx(expected.high, rel=1e-12)
    assert found.n == 7


@pytest.mark.parametrize("margin", [0.5, 1.5, 3.0])
def test_equivalence_is_two_tests_of_scipy(margin: float) -> None:
    shifted = np.array(SECOND)
    below = stats.ttest_ind(shifted + margin, FIRST, equal_var=False, alternative="greater")
    above = stats.ttest_ind(shifted - margin, FIRST, equal_var=False, alternative="less")
    found = equivalence_p(mean_interval(FIRST), mean_interval(SECOND), margin)
    assert found == pytest.approx(max(below.pvalue, above.pvalue), rel=1e-9)


def test_no_interval_no_verdict() -> None:
    found = difference_of_means(mean_interval(FIRST), mean_interval([1.0], "sample"))
    assert found.interval is None
    assert str(found.reason).startswith("one_sample: ")
    assert np.isnan(equivalence_p(mean_interval(FIRST), mean_interval([1.0]), 1.0))
    assert verdict({"a": FIRST}, {"a": [1.0]}, None).startswith(
        "cannot tell: an interval needs the scatter of two values, there is one sample"
    )


def test_nothing_scatters() -> None:
    one, two = mean_interval([1.0, 1.0]), mean_interval([2.0, 2.0])
    found = difference_of_means(one, two)
    assert found.interval is not None
    assert (found.interval.lower, found.interval.upper) == (1.0, 1.0)
    assert equivalence_p(one, two, 2.0) == 0.0
    assert equivalence_p(one, two, 0.5) == 1.0


def test_verdicts() -> None:
    near = [10.02, 10.38, 9.83, 10.08]
    said = verdict({"a": FIRST}, {"a": SECOND}, None)
    assert said == (
        "different: the 95 % interval of the difference leaves zero out; one and two: one spool, "
        "so how spools differ is not in it"
    )
    assert verdict({"a": FIRST}, {"a": near}, 1.0).startswith(
        "equivalent within the margin (9.93 % of the first mean): p = "
    )
    assert verdict({"a": FIRST}, {"a": SECOND}, 4.0).startswith("different, but equivalent within")
    assert verdict({"a": FIRST}, {"a": near}, None).startswith(
        "cannot tell: the 95 % interval of the difference holds zero, no margin is stated"
    )
    assert "and it is not shown to lie within the margin" in verdict({"a": FIRST}, {"a": near}, 0.1)


def test_nested_groups_compare_spool_means() -> None:
    first = {"a": [57.0, 58.0, 57.5], "b": [47.0, 46.0, 47.5]}
    said = compare("k", "1/m", ("one", nested_mean(first)), ("two", nested_mean(first)))
    assert said.difference.n == 4
    assert "one spool" not in said.words
