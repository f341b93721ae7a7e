"""Budgets of the intervals of a group: of its tests, and of the mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import GroupNumber, MeanInterval
from labpipe.statistics.shared_causes import standard_uncertainty

SCATTER = "scatter of the tests"
"""Contribution to the mean besides the causes of its tests: their differences, for any reason."""


@dataclass(frozen=True, slots=True)
class GroupBudget:
    """Contributions to the intervals of one number, as shares that add to one.

    Parameters
    ----------
    of_tests : by cause, median share of the variance over the tests; empty without budgets
    of_mean : by `SCATTER` and common cause, share of the squared half width; empty without an
        interval
    """

    of_tests: Mapping[str, float]
    of_mean: Mapping[str, float]


def group_budget(number: GroupNumber) -> GroupBudget:
    """Summarise the budgets of the tests of a group, and compute that of their mean.

    Parameters
    ----------
    number : of a group; tests without a budget do not count

    Returns
    -------
    Causes in the order of `IS_COMMON`. Medians are scaled to add to one; a test without a cause has
    a share of zero.
    """
    tests = [
        {row.cause: share for row, share in zip(value.budget, value.shares, strict=True)}
        for value in number.values.values()
        if value.largest_share is not None
    ]
    causes = in_order({cause for test in tests for cause in test})
    medians = {cause: median(test.get(cause, 0.0) for test in tests) for cause in causes}
    total = sum(medians.values())
    shares = {cause: share / total for cause, share in medians.items() if share > 0.0}
    return GroupBudget(shares, {} if number.mean is None else _of_mean(number.mean.chosen))


def in_order(causes: set[str]) -> list[str]:
    """Sort causes in the order of budgets and figures; unknown ones come last."""
    return [*(cause for cause in IS_COMMON if cause in causes), *sorted(causes - set(IS_COMMON))]


def _of_mean(mean: MeanInterval) -> dict[str, float]:
    if mean.interval is None or not mean.interval.upper > mean.interval.lower:
        return {}
    normal = Interval.normal_95(0.0, 1.0).upper / mean.half
    common = {
        contribution.cause: (normal * contribution.change) ** 2
        for contribution in mean.common
        if contribution.change
    }
    scatter = 1.0 - (normal * standard_uncertainty(mean.common)) ** 2
    return {SCATTER: scatter, **{cause: common[cause] for cause in in_order(set(common))}}
