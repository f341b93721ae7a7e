"""Differences of groups, equivalence, and verdicts of many."""

from __future__ import annotations

from math import exp, log, log1p

import numpy as np
import pytest
from scipy import stats

from labpipe.records.group import Contrast, Difference, NestedMean, Verdict
from labpipe.records.result import Contribution, Result
from labpipe.statistics.log_scale import on_log_scale
from labpipe.statistics.means import mean_interval, nested_mean
from labpipe.statistics.shared_causes import with_shared
from labpipe.statistics.two_groups import (
    compare,
    contrast_of,
    difference_of_means,
    difference_p,
    equivalence_p,
    half_of,
    judged,
    samples_needed,
)

FIRST, SECOND = [10.0, 10.4, 9.8, 10.1], [10.9, 11.8, 11.1]
NEAR = [10.02, 10.38, 9.83, 10.08]


def linear(first: list[float], second: list[float], margin: float | None = None) -> Contrast:
    """Margin in the unit of the values."""
    share = None if margin is None else margin / float(np.mean(first))
    found = contrast_of(mean_interval(first), mean_interval(second), share)
    assert found is not None
    return found


def positive(values: list[float]) -> NestedMean:
    return on_log_scale(nested_mean({"a": values}))


def compared(first: list[float], second: list[float], margin: float | None = None) -> Difference:
    return compare("k", "N/m", ("one", positive(first)), ("two", positive(second)), margin)


def alone(difference: Difference) -> Difference:
    (found,) = judged("family", [difference])
    return found


def test_interval_is_that_of_welch() -> None:
    found = difference_of_means(mean_interval(FIRST), mean_interval(SECOND))
    expected = stats.ttest_ind(SECOND, FIRST, equal_var=False)
    ends = expected.confidence_interval()
    assert found.interval is not None
    assert found.interval.lower == pytest.approx(ends.low, rel=1e-12)
    assert found.interval.upper == pytest.approx(ends.high, rel=1e-12)
    assert found.n == 7
    assert difference_p(linear(FIRST, SECOND)) == pytest.approx(expected.pvalue, rel=1e-9)


@pytest.mark.parametrize("margin", [0.5, 1.5, 3.0])
def test_equivalence_is_two_tests_of_scipy(margin: float) -> None:
    shifted = np.array(SECOND)
    below = stats.ttest_ind(shifted + margin, FIRST, equal_var=False, alternative="greater")
    above = stats.ttest_ind(shifted - margin, FIRST, equal_var=False, alternative="less")
    found = equivalence_p(linear(FIRST, SECOND, margin))
    assert found == pytest.approx(max(below.pvalue, above.pvalue), rel=1e-9)
    assert np.isnan(equivalence_p(linear(FIRST, SECOND)))


def test_a_ratio_by_hand() -> None:
    """Means 10 and 12, both s = 1 of 3: errors 0.05774 and 0.04811 of the means."""
    found = compared([9.0, 10.0, 11.0], [11.0, 12.0, 13.0], 0.1)
    contrast = found.contrast
    assert contrast is not None
    assert contrast.is_log
    assert contrast.between == pytest.approx(log(1.2))
    assert contrast.errors == pytest.approx((0.057735, 0.048113), rel=1e-4)
    assert contrast.margin == pytest.approx(log1p(0.1))
    squares = 0.057735**2, 0.048113**2
    degrees = sum(squares) ** 2 / sum(each**2 / 2.0 for each in squares)
    assert contrast.degrees == pytest.approx(degrees, rel=1e-4)
    assert found.share == pytest.approx(0.2)
    half = float(stats.t.ppf(0.975, degrees)) * 0.075154
    said = alone(found)
    assert said.interval is not None
    assert said.interval.lower == pytest.approx(1.2 * exp(-half) - 1.0, rel=1e-3)
    assert said.interval.upper == pytest.approx(1.2 * exp(half) - 1.0, rel=1e-3)


def test_a_gain_that_is_off_cancels_in_a_ratio() -> None:
    def mean(values: list[float]) -> NestedMean:
        results = [
            Result("k", x, "N", method="m", budget=(Contribution("gain", 0.01 * x, True),))
            for x in values
        ]
        return on_log_scale(with_shared(positive(values), {"a": results}))

    contrast = contrast_of(mean([9.0, 10.0, 11.0]).chosen, mean([19.0, 20.0, 21.5]).chosen)
    assert contrast is not None
    assert contrast.shared == pytest.approx(0.0, abs=1e-12)


def test_no_interval_no_verdict() -> None:
    found = difference_of_means(mean_interval(FIRST), mean_interval([1.0], "sample"))
    assert found.interval is None
    assert str(found.reason).startswith("one_sample: ")
    assert contrast_of(mean_interval(FIRST), mean_interval([1.0])) is None
    said = alone(compared(FIRST, [1.0]))
    assert said.verdict is Verdict.CANNOT_TELL
    assert said.why == "an interval needs the scatter of two values, there is one sample"


def test_nothing_scatters() -> None:
    same = linear([1.0, 1.0], [2.0, 2.0])
    assert (half_of(same), difference_p(same)) == (0.0, 0.0)
    assert equivalence_p(linear([1.0, 1.0], [2.0, 2.0], 2.0)) == 0.0
    assert equivalence_p(linear([1.0, 1.0], [2.0, 2.0], 0.5)) == 1.0
    assert difference_p(linear([1.0, 1.0], [1.0, 1.0])) == 1.0


def test_verdicts_of_one_comparison() -> None:
    said = alone(compared(FIRST, SECOND))
    assert said.verdict is Verdict.DIFFERENT
    assert said.words == (
        "different: p = 0.025; one and two: one spool, so how spools differ is not in it"
    )
    assert alone(compared(FIRST, NEAR, 0.1)).why.startswith("within 10 %: p = ")
    assert alone(compared(FIRST, NEAR, 0.1)).verdict is Verdict.EQUIVALENT
    both = alone(compared(FIRST, SECOND, 0.5))
    assert both.verdict is Verdict.EQUIVALENT
    assert both.why.startswith("a real difference, but within 50 %: p = ")
    none = alone(compared(FIRST, NEAR))
    assert none.words.startswith("cannot tell: the interval holds zero, and no margin is stated;")
    close = alone(compared(FIRST, NEAR, 0.01))
    assert close.verdict is Verdict.CANNOT_TELL
    assert close.why == "the interval holds zero, not shown to be within 1 %"
    wider = alone(compared(FIRST, NEAR, 0.03))
    assert wider.why.endswith("within 3 %; with this scatter n = 22 in each group would tell")


def test_many_comparisons_are_corrected() -> None:
    """p = 0.025 holds alone, and not among ten."""
    one = compared(FIRST, SECOND)
    assert one.p == pytest.approx(0.0253, abs=0.0001)
    assert one.verdict is Verdict.NOT_ASKED
    family = judged("family", [one, *[compared(FIRST, NEAR)] * 9])
    assert family[0].verdict is Verdict.CANNOT_TELL
    assert (family[0].tests, family[0].family) == (10, "family")
    assert family[0].interval is not None
    assert family[0].interval.level == pytest.approx(0.995)
    assert family[0].interval.lower < 0.0 < family[0].interval.upper
    sure = judged("family", [compared(FIRST, [20.0, 21.0, 20.5])] * 10)
    assert {each.verdict for each in sure} == {Verdict.DIFFERENT}
    assert sure[0].why.endswith(", corrected for 10 comparisons")


def test_the_interval_agrees_with_the_verdict() -> None:
    rng = np.random.default_rng(2)
    groups = [(10.0 + shift + rng.normal(0, 0.5, 3)).tolist() for shift in np.linspace(0, 4, 12)]
    found = judged("family", [compared(groups[0], each) for each in groups[1:]])
    verdicts = [each.verdict for each in found]
    assert Verdict.DIFFERENT in verdicts
    assert Verdict.CANNOT_TELL in verdicts
    for each in found:
        assert each.interval is not None
        holds_zero = each.interval.lower <= 0.0 <= each.interval.upper
        assert holds_zero == (each.verdict is Verdict.CANNOT_TELL)
        assert each.interval.level >= 0.95


def test_how_many_samples_would_tell() -> None:
    """s = 3 % of both, margin 10 %: t(2n - 2) 0.03 sqrt(2 / n) is at most 0.0477 from n = 5 on."""
    contrast = Contrast(0.0, (0.03 / 3**0.5,) * 2, (3, 3), margin=log1p(0.1), is_log=True)
    assert float(stats.t.ppf(0.975, 8)) * 0.03 * (2 / 5) ** 0.5 < log1p(0.1) / 2
    assert float(stats.t.ppf(0.975, 6)) * 0.03 * (2 / 4) ** 0.5 > log1p(0.1) / 2
    assert samples_needed(contrast) == 5
    assert samples_needed(contrast, 0.05 / 28) == 11  # t(20) of 0.05 / 28: 3.60
    assert samples_needed(Contrast(0.0, (1.0, 1.0), (3, 3), margin=0.1)) is None
    assert samples_needed(Contrast(0.0, (1.0, 1.0), (3, 3))) is None


def test_families_without_differences_are_wrong_in_a_twentieth() -> None:
    rng, runs, wrong = np.random.default_rng(8), 400, 0
    for _ in range(runs):
        pairs = [rng.normal(10.0, 0.5, (2, 3)).tolist() for _ in range(12)]
        found = judged("family", [compared(*pair) for pair in pairs])
        wrong += any(each.verdict is Verdict.DIFFERENT for each in found)
    assert stats.binomtest(wrong, runs, 0.05, alternative="greater").pvalue > 0.01, wrong


def test_nested_groups_compare_spool_means() -> None:
    first = {"a": [57.0, 58.0, 57.5], "b": [47.0, 46.0, 47.5]}
    said = compare("k", "1/m", ("one", nested_mean(first)), ("two", nested_mean(first)))
    assert said.difference.n == 4
    assert "one spool" not in said.words


@pytest.mark.parametrize(("sigmas", "chance"), [(5.0, 2.0 * stats.norm.sf(5.0)), (9.0, 0.0)])
def test_beyond_eight_standard_errors_there_is_no_chance(sigmas: float, chance: float) -> None:
    """Of a doubt of 1000 that dwarfs the scatter."""
    contrast = Contrast(1000.0 * sigmas, errors=(1.0, 1.0), counts=(8, 8), shared=1000.0)
    assert difference_p(contrast) == pytest.approx(chance, rel=0.01, abs=0.0)
