"""Outliers are marked by a named test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.records.group import Group, Outlier, Sample
from labpipe.records.result import Result
from labpipe.statistics.group_notes import too_few_for_outliers
from labpipe.statistics.groups import build_group
from labpipe.statistics.outliers import find_suspects, with_outliers
from tests.builders.bundle_campaigns import bundle_sample


def mark_outliers(
    values: Mapping[str, float], spools: Mapping[str, str], *, level: float = 0.05
) -> tuple[Outlier, ...]:
    """Of one number alone."""
    return find_suspects(values, spools).below(level)


def one_spool(values: list[float]) -> tuple[dict[str, float], dict[str, str]]:
    names = [f"t{number}" for number in range(len(values))]
    return dict(zip(names, values, strict=True)), dict.fromkeys(names, "a")


def test_marks_what_lies_far_out() -> None:
    (found,) = mark_outliers(*one_spool([1.0, 1.1, 0.9, 1.05, 5.0]))
    assert (found.sample, found.value, found.method) == ("t4", 5.0, "Grubbs' test")
    assert found.p < 1e-3


def test_grubbs_of_a_table() -> None:
    # Two-sided 5 % point for n = 5 is 1.715 (Grubbs and Beck, Technometrics 14 (1972) 847).
    base = np.array([-1.0, -0.5, 0.0, 0.5])
    chances = {}
    for far in np.linspace(1.0, 10.0, 2000):
        values = np.append(base, far)
        ratio = (far - values.mean()) / values.std(ddof=1)
        found = mark_outliers(*one_spool(values.tolist()), level=1.1)
        chances[float(ratio)] = found[0].p
    at = min(chances, key=lambda ratio: abs(ratio - 1.715))
    assert chances[at] == pytest.approx(0.05, abs=0.002)


def test_spools_that_differ_hold_no_outliers() -> None:
    values = {"a1": 1.0, "a2": 1.1, "a3": 0.9, "b1": 9.0, "b2": 9.1, "b3": 8.9}
    assert not mark_outliers(values, {name: name[0] for name in values})
    values["b3"] = 5.0
    (found,) = mark_outliers(values, {name: name[0] for name in values})
    assert found.method == "Grubbs' test within spools"


@pytest.mark.parametrize("shift", [0.0, 7.0, 1e6])
def test_neither_of_a_spool_of_two_is_blamed_alone(shift: float) -> None:
    pair = {"c1": 4.0 + shift, "c2": 9.0 + shift}
    values = {"a1": 1.0, "a2": 1.1, "a3": 0.9, "b1": 9.0, "b2": 9.1, "b3": 8.9, **pair}
    found = mark_outliers(values, {name: name[0] for name in values})
    assert {each.sample for each in found} == {"c1", "c2"}
    assert found[0].p == found[1].p
    assert {each.method for each in found} == {
        "Grubbs' test within spools, which cannot tell it from c1",
        "Grubbs' test within spools, which cannot tell it from c2",
    }


def test_two_extremes_that_lie_equally_far_out_are_both_named() -> None:
    found = mark_outliers(*one_spool([-5.0, *[-0.01, 0.0, 0.01] * 5, 5.0]), level=1.1)
    assert [each.sample for each in found] == ["t0", "t16"]
    assert found[0].method == "Grubbs' test, which cannot tell it from t16"


def test_too_few_samples_are_said() -> None:
    assert not mark_outliers(*one_spool([1.0, 100.0]))
    assert not mark_outliers({}, {})
    assert too_few_for_outliers(["a", "a", "a"]) == ""
    assert too_few_for_outliers(["a", "a", "b"]) == (
        "too_few_samples: 3 samples of 2 spools, outliers are found from 4 on"
    )


def test_equal_values_and_nan() -> None:
    assert not mark_outliers(*one_spool([2.0, 2.0, 2.0, 2.0]))
    assert not mark_outliers(*one_spool([1.0, 2.0, 3.0, float("nan")]))


def test_an_exact_fit_but_for_one() -> None:
    (found,) = mark_outliers(*one_spool([2.0, 2.0, 2.0, 2.0, 3.0]))
    assert found.sample == "t4"


@pytest.mark.parametrize("counts", [(3,), (6,), (3, 3), (20,)])
def test_false_marks_are_as_rare_as_said(counts: tuple[int, ...]) -> None:
    rng, runs, marked = np.random.default_rng(4), 2000, 0
    names = [f"{spool}-{each}" for spool, count in enumerate(counts) for each in range(count)]
    spools = {name: name.partition("-")[0] for name in names}
    for _ in range(runs):
        marked += bool(
            mark_outliers(dict(zip(names, rng.normal(size=len(names)), strict=True)), spools)
        )
    # Bonferroni's bound: at most 5 %.
    assert binomtest(marked, runs, 0.05, alternative="greater").pvalue > 0.01, marked


BASE = bundle_sample(None, 1)


def group_of(name: str, numbers: Mapping[str, list[float]]) -> Group:
    """A group of one spool whose tests have these numbers."""
    count = len(next(iter(numbers.values())))
    samples: list[Sample] = []
    for at in range(count):
        results = tuple(Result(each, own[at], "N", method="m") for each, own in numbers.items())
        samples.append(replace(BASE, test=f"{name}-{at}", results=results, loading=()))
    return build_group(name, "p", samples)


def marks(groups: list[Group]) -> list[tuple[str, str]]:
    return [
        (number.name, each.sample)
        for group in groups
        for number in group.numbers
        for each in number.outliers
    ]


def test_a_report_of_many_numbers_marks_what_is_sure_among_all() -> None:
    """p of 1, 1.1, 0.9, 1.05, 1.7 is 0.02: below 5 % alone, and not among ten numbers."""
    odd, plain = [1.0, 1.1, 0.9, 1.05, 1.7], [1.0, 1.4, 0.7, 1.2, 0.9]
    (suspect,) = find_suspects(*one_spool(odd)).below(0.05)
    assert 0.01 < suspect.p < 0.04
    alone = with_outliers([group_of("A", {"k": odd})])
    assert marks(alone) == [("k", "A-4")]
    more = {"k": odd, **{f"n{at}": plain for at in range(9)}}
    assert not marks(with_outliers([group_of("A", more)]))
    surer = {**more, "k": [1.0, 1.1, 0.9, 1.05, 9.0]}
    found = with_outliers([group_of("A", surer)])
    assert marks(found) == [("k", "A-4")]


def test_what_the_rig_sets_is_not_tested() -> None:
    group = group_of("A", {"k": [1.0, 1.1, 0.9, 1.05, 9.0]})
    is_set = [replace(each, is_set_by_rig=True) for each in group.numbers]
    assert not marks(with_outliers([replace(group, numbers=tuple(is_set))]))
    assert marks(with_outliers([group]))


@pytest.mark.slow
@pytest.mark.parametrize(("groups", "numbers", "count"), [(10, 8, 3), (3, 12, 20)])
def test_campaigns_of_normal_data_with_any_mark(groups: int, numbers: int, count: int) -> None:
    """At most 5 % of campaigns have a mark; numbers of a test hang together."""
    rng, runs, marked = np.random.default_rng(11), 300, 0
    for _ in range(runs):
        campaign = []
        for group in range(groups):
            own = rng.normal(size=count)
            several = {
                f"n{at}": (10.0 + own + rng.normal(size=count)).tolist() for at in range(numbers)
            }
            campaign.append(group_of(str(group), several))
        marked += bool(marks(with_outliers(campaign)))
    assert binomtest(marked, runs, 0.05, alternative="greater").pvalue > 0.01, marked
