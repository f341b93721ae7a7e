"""What intervals of a group are made of, by hand."""

from __future__ import annotations

import pytest

from labpipe.records.group import GroupNumber
from labpipe.records.result import Contribution, Result
from labpipe.statistics.group_budgets import SCATTER, group_budget, in_order
from labpipe.statistics.means import nested_mean
from labpipe.statistics.shared_causes import with_shared

FORCE = "scale of the force"


def measured(value: float, **changes: float) -> Result:
    names = {"noise": "noise", "force": FORCE, "pull": "pull offset"}
    budget = tuple(
        Contribution(names[key], change, is_common=key == "force")
        for key, change in changes.items()
    )
    return Result("k", value, "N/m", budget=budget)


def number(*results: Result) -> GroupNumber:
    values = {f"T{place}": each for place, each in enumerate(results)}
    mean = with_shared(
        nested_mean({"s1": [each.value or 0.0 for each in results]}), {"s1": list(results)}
    )
    return GroupNumber("k", "N/m", mean, values, {})


def test_medians_of_the_shares() -> None:
    """Noise 0.2, 0.5, 0.8 and force 0.8, 0.5, 0.2: both have the median 0.5."""
    found = group_budget(
        number(
            measured(1.0, noise=1.0, force=2.0),
            measured(2.0, noise=1.0, force=1.0),
            measured(3.0, noise=2.0, force=1.0),
        )
    )
    assert found.of_tests == pytest.approx({"noise": 0.5, FORCE: 0.5})


def test_medians_are_scaled_to_one_and_a_missing_cause_is_none() -> None:
    """Shares of noise 1, 0.8, 0.9 and of the force 0, 0.2, 0.1: 0.9 and 0.1; of one alone, none."""
    found = group_budget(
        number(
            measured(1.0, noise=1.0),
            measured(2.0, noise=2.0, force=1.0),
            measured(3.0, noise=3.0, force=1.0),
            measured(9.0),
        )
    )
    assert found.of_tests == pytest.approx({"noise": 0.9, FORCE: 0.1})
    once = number(*(measured(1.0, noise=1.0, pull=by) for by in (0.0, 0.0, 1.0)))
    assert group_budget(once).of_tests == {"noise": 1.0}


def test_the_mean_is_made_of_scatter_and_what_is_common() -> None:
    """1 and 3: half width 12.706; a common change of 3 adds 5.880: (5.880 / 14.001)^2 = 0.1764."""
    found = group_budget(number(measured(1.0, noise=1.0, force=3.0), measured(3.0, force=3.0)))
    assert list(found.of_mean) == [SCATTER, FORCE]
    assert found.of_mean[FORCE] == pytest.approx(0.17637, abs=1e-5)
    assert sum(found.of_mean.values()) == pytest.approx(1.0)


def test_nothing_to_tell() -> None:
    alone = group_budget(number(measured(1.0)))
    assert (alone.of_tests, alone.of_mean) == ({}, {})
    none = GroupNumber("k", "N/m", None, {}, {})
    assert group_budget(none).of_mean == {}
    assert group_budget(number(measured(2.0), measured(2.0))).of_mean == {}


def test_causes_in_their_order() -> None:
    assert in_order({"the moon", "pull offset", "noise"}) == ["noise", "pull offset", "the moon"]
