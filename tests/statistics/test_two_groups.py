"""Differences of groups, equivalence, verdicts of many (Holm), and outliers by named tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import exp, isnan, log, log1p, nan

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binomtest

from labpipe.records.group import Contrast, Difference, Group, NestedMean, Outlier, Sample, Verdict
from labpipe.records.result import Result
from labpipe.statistics.groups import build_group
from labpipe.statistics.means import compute_mean, compute_nested_mean, convert_to_log_scale
from labpipe.statistics.significance import (
    compare_means,
    compute_contrast,
    compute_difference_p,
    compute_equivalence_p,
    compute_half_width,
    correct_p_values,
    count_needed_samples,
    judge_family,
    mark_outliers,
    run_outlier_test,
    subtract_means,
)
from tests.builders.bundle_campaigns import bundle_sample

FIRST, SECOND = [10.0, 10.4, 9.8, 10.1], [10.9, 11.8, 11.1]
NEAR = [10.02, 10.38, 9.83, 10.08]


def linear(first: list[float], second: list[float], margin: float | None = None) -> Contrast:
    """Margin in the unit of the values."""
    share = None if margin is None else margin / float(np.mean(first))
    contrast = compute_contrast(compute_mean(first), compute_mean(second), share)
    assert contrast is not None
    return contrast


def positive(values: list[float]) -> NestedMean:
    return convert_to_log_scale(compute_nested_mean({"a": values}))


def compared(first: list[float], second: list[float], margin: float | None = None) -> Difference:
    return compare_means("k", "N/m", ("one", positive(first)), ("two", positive(second)), margin)


def alone(difference: Difference) -> Difference:
    (judged,) = judge_family("family", [difference])
    return judged


def test_interval_is_that_of_welch() -> None:
    difference = subtract_means(compute_mean(FIRST), compute_mean(SECOND))
    expected = stats.ttest_ind(SECOND, FIRST, equal_var=False)
    ends = expected.confidence_interval()
    assert difference.interval is not None
    assert difference.interval.lower == pytest.approx(ends.low, rel=1e-12)
    assert difference.interval.upper == pytest.approx(ends.high, rel=1e-12)
    assert difference.n == 7
    single = subtract_means(compute_mean(FIRST), compute_mean([1.0], "sample"))
    assert single.interval is None
    assert str(single.reason).startswith("one_sample: ")
    assert compute_difference_p(linear(FIRST, SECOND)) == pytest.approx(expected.pvalue, rel=1e-9)


@pytest.mark.parametrize("margin", [0.5, 1.5, 3.0])
def test_equivalence_is_two_tests_of_scipy(margin: float) -> None:
    shifted = np.array(SECOND)
    below = stats.ttest_ind(shifted + margin, FIRST, equal_var=False, alternative="greater")
    above = stats.ttest_ind(shifted - margin, FIRST, equal_var=False, alternative="less")
    p = compute_equivalence_p(linear(FIRST, SECOND, margin))
    assert p == pytest.approx(max(below.pvalue, above.pvalue), rel=1e-9)
    assert np.isnan(compute_equivalence_p(linear(FIRST, SECOND)))


def test_a_ratio_by_hand() -> None:
    """Means 10 and 12, both s = 1 of 3: errors 0.05774 and 0.04811 of the means."""
    difference = compared([9.0, 10.0, 11.0], [11.0, 12.0, 13.0], 0.1)
    contrast = difference.contrast
    assert contrast is not None
    assert contrast.is_log
    assert contrast.difference == pytest.approx(log(1.2))
    assert contrast.errors == pytest.approx((0.057735, 0.048113), rel=1e-4)
    assert contrast.margin == pytest.approx(log1p(0.1))
    squares = 0.057735**2, 0.048113**2
    degrees = sum(squares) ** 2 / sum(square**2 / 2.0 for square in squares)
    assert contrast.freedom == pytest.approx(degrees, rel=1e-4)
    assert difference.change == pytest.approx(0.2)
    half = float(stats.t.ppf(0.975, degrees)) * 0.075154
    judged = alone(difference)
    assert judged.interval is not None
    assert judged.interval.lower == pytest.approx(1.2 * exp(-half) - 1.0, rel=1e-3)
    assert judged.interval.upper == pytest.approx(1.2 * exp(half) - 1.0, rel=1e-3)


def test_nothing_scatters() -> None:
    equal = [1.0, 1.0], [2.0, 2.0]
    assert (compute_half_width(linear(*equal)), compute_difference_p(linear(*equal))) == (0.0, 0.0)
    assert (
        compute_equivalence_p(linear(*equal, 2.0)),
        compute_equivalence_p(linear(*equal, 0.5)),
    ) == (0.0, 1.0)
    assert compute_difference_p(linear([1.0, 1.0], [1.0, 1.0])) == 1.0


@pytest.mark.parametrize(
    ("second", "margin", "verdict", "message"),
    [
        (SECOND, None, Verdict.DIFFERENT, "p = 0.025; one and two: one spool, so the scatter"),
        (NEAR, 0.1, Verdict.EQUIVALENT, ": within 10 %: p = "),
        (SECOND, 0.5, Verdict.EQUIVALENT, "a real difference, but within 50 %: p = "),
        (NEAR, None, Verdict.CANNOT_TELL, "the interval contains zero, and no margin is stated;"),
        (NEAR, 0.01, Verdict.CANNOT_TELL, "the interval contains zero, not shown to be within 1 %"),
        (NEAR, 0.03, Verdict.CANNOT_TELL, "with this scatter n = 22 in each group would decide"),
        ([1.0], None, Verdict.CANNOT_TELL, "an interval needs two values, there"),
    ],
)
def test_verdicts_of_one_comparison(
    second: list[float], margin: float | None, verdict: Verdict, message: str
) -> None:
    difference = alone(compared(FIRST, second, margin))
    assert difference.verdict is verdict
    text = f"{difference.verdict}: {difference.verdict_reason}"
    assert message in "; ".join([text, *difference.caveats])


def test_many_comparisons_are_corrected() -> None:
    """p = 0.025 holds alone, and not among ten."""
    single = compared(FIRST, SECOND)
    assert single.p == pytest.approx(0.0253, abs=0.0001)
    assert single.verdict is Verdict.NOT_ASKED
    family = judge_family("family", [single, *[compared(FIRST, NEAR)] * 9])
    assert family[0].verdict is Verdict.CANNOT_TELL
    assert (family[0].n_comparisons, family[0].family) == (10, "family")
    assert family[0].interval is not None
    assert family[0].interval.level == pytest.approx(0.995)
    assert family[0].interval.lower < 0.0 < family[0].interval.upper
    different = judge_family("family", [compared(FIRST, [20.0, 21.0, 20.5])] * 10)
    assert {difference.verdict for difference in different} == {Verdict.DIFFERENT}
    assert different[0].verdict_reason.endswith(", corrected for 10 comparisons")


def test_how_many_samples_would_tell() -> None:
    """s = 3 % of both, margin 10 %: t(2n - 2) 0.03 sqrt(2 / n) is at most 0.0477 from n = 5 on."""
    contrast = Contrast(0.0, (0.03 / 3**0.5,) * 2, (3, 3), margin=log1p(0.1), is_log=True)
    assert float(stats.t.ppf(0.975, 8)) * 0.03 * (2 / 5) ** 0.5 < log1p(0.1) / 2
    assert float(stats.t.ppf(0.975, 6)) * 0.03 * (2 / 4) ** 0.5 > log1p(0.1) / 2
    assert count_needed_samples(contrast) == 5
    assert count_needed_samples(contrast, 0.05 / 28) == 11  # t(20) of 0.05 / 28: 3.60
    assert count_needed_samples(Contrast(0.0, (1.0, 1.0), (3, 3), margin=0.1)) is None
    assert count_needed_samples(Contrast(0.0, (1.0, 1.0), (3, 3))) is None


@pytest.mark.parametrize(("sigmas", "chance"), [(5.0, 2.0 * stats.norm.sf(5.0)), (9.0, 0.0)])
def test_beyond_eight_standard_errors_there_is_no_chance(sigmas: float, chance: float) -> None:
    """Of a doubt of 1000 that dwarfs the scatter."""
    contrast = Contrast(1000.0 * sigmas, errors=(1.0, 1.0), counts=(8, 8), common_error=1000.0)
    assert compute_difference_p(contrast) == pytest.approx(chance, rel=0.01, abs=0.0)


def test_an_example_by_hand() -> None:
    """0.01 x 4, 0.015 x 3 = 0.045, 0.03 x 2 = 0.06: the third and all that follow do not hold.

    What has no test does not count.
    """
    *corrected, untested = correct_p_values([0.03, 0.01, 0.2, 0.015, nan])
    assert [finding.p for finding in corrected] == pytest.approx([0.06, 0.04, 0.2, 0.045])
    assert [finding.divisor for finding in corrected] == [2, 4, 2, 3]
    assert {finding.n_tests for finding in [*corrected, untested]} == {4}
    assert isnan(untested.p)
    smaller, larger = correct_p_values([0.02, 0.03])
    assert (smaller.p, larger.p) == (0.04, 0.04)
    assert correct_p_values([]) == []
    assert correct_p_values([nan])[0].divisor == 1


def outliers_of(
    values: Mapping[str, float], spools: Mapping[str, str], *, level: float = 0.05
) -> tuple[Outlier, ...]:
    """Of one number alone."""
    return run_outlier_test(values, spools).select_outliers(level)


def one_spool(values: list[float]) -> tuple[dict[str, float], dict[str, str]]:
    names = [f"t{number}" for number in range(len(values))]
    return dict(zip(names, values, strict=True)), dict.fromkeys(names, "a")


def test_grubbs_of_a_table() -> None:
    # Two-sided 5 % point for n = 5 is 1.715 (Grubbs and Beck, Technometrics 14 (1972) 847).
    base = np.array([-1.0, -0.5, 0.0, 0.5])
    chances = {}
    for far in np.linspace(1.0, 10.0, 2000):
        values = np.append(base, far)
        ratio = (far - values.mean()) / values.std(ddof=1)
        outliers = outliers_of(*one_spool(values.tolist()), level=1.1)
        chances[float(ratio)] = outliers[0].p
    nearest_ratio = min(chances, key=lambda ratio: abs(ratio - 1.715))
    assert chances[nearest_ratio] == pytest.approx(0.05, abs=0.002)


def test_spools_that_differ_hold_no_outliers() -> None:
    values = {"a1": 1.0, "a2": 1.1, "a3": 0.9, "b1": 9.0, "b2": 9.1, "b3": 8.9}
    assert not outliers_of(values, {name: name[0] for name in values})
    values["b3"] = 5.0
    (outlier,) = outliers_of(values, {name: name[0] for name in values})
    assert outlier.method == "Grubbs' test within spools"


@pytest.mark.parametrize("shift", [0.0, 7.0, 1e6])
def test_neither_of_a_spool_of_two_is_blamed_alone(shift: float) -> None:
    pair = {"c1": 4.0 + shift, "c2": 9.0 + shift}
    values = {"a1": 1.0, "a2": 1.1, "a3": 0.9, "b1": 9.0, "b2": 9.1, "b3": 8.9, **pair}
    outliers = outliers_of(values, {name: name[0] for name in values})
    assert {outlier.sample for outlier in outliers} == {"c1", "c2"}
    assert outliers[0].p == outliers[1].p
    assert {outlier.method for outlier in outliers} == {
        "Grubbs' test within spools, which cannot distinguish it from c1",
        "Grubbs' test within spools, which cannot distinguish it from c2",
    }


def test_neither_is_blamed_alone_where_a_double_holds_no_p_value() -> None:
    values = {f"a{at}": 1.0 + 1e-5 * (at % 2) for at in range(100)} | {"c1": 4.0, "c2": 9.0}
    outliers = outliers_of(values, {name: name[0] for name in values})
    assert {outlier.sample: outlier.p for outlier in outliers} == {"c1": 0.0, "c2": 0.0}


def test_what_has_no_outliers() -> None:
    """Too few samples, equal values and NaN; of an exact fit the one that is off is one."""
    for values in ([1.0, 100.0], [], [2.0] * 4, [1.0, 2.0, 3.0, nan]):
        assert not outliers_of(*one_spool(values))
    assert [outlier.sample for outlier in outliers_of(*one_spool([2.0] * 4 + [3.0]))] == ["t4"]


@pytest.mark.parametrize("counts", [(3,), (6,), (3, 3)])
def test_false_marks_are_as_rare_as_said(counts: tuple[int, ...]) -> None:
    rng, runs, marked = np.random.default_rng(4), 1000, 0
    names = [f"{spool}-{index}" for spool, count in enumerate(counts) for index in range(count)]
    spools = {name: name.partition("-")[0] for name in names}
    for _ in range(runs):
        marked += bool(
            outliers_of(dict(zip(names, rng.normal(size=len(names)), strict=True)), spools)
        )
    # Bonferroni's bound: at most 5 %.
    assert binomtest(marked, runs, 0.05, alternative="greater").pvalue > 0.01, marked


BASE = bundle_sample(None, 1)


def group_of(name: str, numbers: Mapping[str, list[float]]) -> Group:
    """A group of one spool whose tests have these numbers."""
    count = len(next(iter(numbers.values())))
    samples: list[Sample] = []
    for index in range(count):
        results = tuple(Result(key, own[index], "N", method="m") for key, own in numbers.items())
        samples.append(replace(BASE, test=f"{name}-{index}", results=results, loading=()))
    return build_group(name, "p", samples)


def marks(groups: list[Group]) -> list[tuple[str, str]]:
    return [
        (number.name, outlier.sample)
        for group in groups
        for number in group.numbers
        for outlier in number.outliers
    ]


def test_a_report_of_many_numbers_marks_what_is_sure_among_all() -> None:
    """p of 1, 1.1, 0.9, 1.05, 1.7 is 0.02: below 5 % alone, and not among ten numbers."""
    values_with_outlier, plain_values = [1.0, 1.1, 0.9, 1.05, 1.7], [1.0, 1.4, 0.7, 1.2, 0.9]
    (suspect,) = run_outlier_test(*one_spool(values_with_outlier)).select_outliers(0.05)
    assert 0.01 < suspect.p < 0.04
    groups = mark_outliers([group_of("A", {"k": values_with_outlier})])
    assert marks(groups) == [("k", "A-4")]
    is_set = [replace(number, is_set_by_rig=True) for number in groups[0].numbers]
    unmarked = [replace(number, outliers=()) for number in is_set]
    assert not marks(mark_outliers([replace(groups[0], numbers=tuple(unmarked))]))
    ten_numbers = {"k": values_with_outlier, **{f"n{at}": plain_values for at in range(9)}}
    assert not marks(mark_outliers([group_of("A", ten_numbers)]))
    surer = {"k": values_with_outlier, "n": [1.0, 1.1, 0.9, 1.05, 9.0]}  # 2 p is 0.04 beside it
    assert marks(mark_outliers([group_of("A", surer)])) == [("k", "A-4"), ("n", "A-4")]
    with_surer_outlier = {**ten_numbers, "k": [1.0, 1.1, 0.9, 1.05, 9.0]}
    marked_groups = mark_outliers([group_of("A", with_surer_outlier)])
    assert marks(marked_groups) == [("k", "A-4")]
