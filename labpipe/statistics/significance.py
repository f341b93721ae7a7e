"""Test the difference and the equivalence of two groups, and find the outliers of a report.

The false-alarm rate of outliers applies to the whole report. Outliers are marked, not removed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import expm1, hypot, isnan, log, log1p, nan, sqrt

import numpy as np
import scipy
from numpy.typing import NDArray

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, divide
from labpipe.records.curve import Interval
from labpipe.records.group import (
    Contrast,
    Difference,
    Group,
    GroupNumber,
    MeanInterval,
    NestedMean,
    Outlier,
    Verdict,
)
from labpipe.statistics.group_samples import name_samples
from labpipe.statistics.means import ALPHA, combine_changes, compute_t_quantile, subtract_changes


def subtract_means(first: MeanInterval, second: MeanInterval) -> MeanInterval:
    """Compute the second mean minus the first with its 95 % interval.

    Parameters
    ----------
    first, second : means of independent values; their standard deviations may differ

    Returns
    -------
    The difference, with the number of values of both means together and a deviation of NaN. If one
    of the means has no interval, the difference has none, for the same reason. The middle of the
    interval is the difference of the estimates. The interval includes the effect of common causes.

    Notes
    -----
    The squared standard error is s1^2/n1 + s2^2/n2 (Welch, Biometrika 34 (1947) 28), with the
    degrees of freedom of Satterthwaite.
    """
    difference, n = second.mean - first.mean, first.n + second.n
    common = subtract_changes(first.common, second.common)
    contrast = compute_contrast(first, second, is_log=False)
    if contrast is None:
        reason = first.reason or second.reason
        return MeanInterval(difference, None, np.nan, n, reason, common=common)
    middle, half_width = contrast.difference, compute_half_width(contrast)
    interval = Interval(middle - half_width, middle + half_width)
    estimate = None if middle == difference else middle
    return MeanInterval(difference, interval, np.nan, n, estimate=estimate, common=common)


def compute_contrast(
    first: MeanInterval,
    second: MeanInterval,
    margin: float | None = None,
    *,
    is_log: bool | None = None,
) -> Contrast | None:
    """Compute the contrast of two means, which is their difference on the scale of the tests.

    Parameters
    ----------
    first, second : means of independent values; their standard deviations may differ
    margin : largest difference without practical importance, as a fraction of the first mean
    is_log : whether the scale is logarithmic; None for a log scale if both intervals are on a log
        scale

    Returns
    -------
    The contrast; None if a mean has no interval. On a log scale, standard errors and common causes
    are relative to the means, so that an error of the gain cancels. A margin m then allows a ratio
    of the means from 1 / (1 + m) to 1 + m.
    """
    if first.interval is None or second.interval is None:
        return None
    is_log = first.is_log and second.is_log if is_log is None else is_log
    first_scale, second_scale = (first.middle, second.middle) if is_log else (1.0, 1.0)
    common = [
        [replace(row, change=row.change / scale) for row in mean.common]
        for mean, scale in ((first, first_scale), (second, second_scale))
    ]
    log_or_absolute_margin = None
    if margin is not None:
        log_or_absolute_margin = log1p(margin) if is_log else margin * abs(first.mean)
    return Contrast(
        difference=log(second_scale / first_scale) if is_log else second.middle - first.middle,
        errors=(
            first.deviation / sqrt(first.n) / first_scale,
            second.deviation / sqrt(second.n) / second_scale,
        ),
        counts=(first.n, second.n),
        common_error=combine_changes(subtract_changes(*common)),
        margin=log_or_absolute_margin or None,
        is_log=is_log,
    )


def compute_half_width(contrast: Contrast, tail_probability: float = ALPHA) -> float:
    """Compute the half width of the interval of a difference.

    Parameters
    ----------
    contrast : contrast of two means
    tail_probability : probability outside the interval, half of it on each side

    Returns
    -------
    The root of the sum of squares of the half widths from scatter and from common causes, on the
    scale of the contrast. The interval of a mean is computed in the same way.
    """
    quantile = compute_t_quantile(contrast.freedom, tail_probability) if contrast.error else 0.0
    common_half_width = scipy.special.ndtri(1.0 - 0.5 * tail_probability) * contrast.common_error
    return hypot(quantile * contrast.error, common_half_width)


def compute_difference_p(contrast: Contrast) -> float:
    """Compute the p-value of the test that two means are equal.

    Parameters
    ----------
    contrast : contrast of two means

    Returns
    -------
    The tail probability for which the interval of the difference ends at zero.
    """
    return min(1.0, 2.0 * _compute_tail_probability(abs(contrast.difference), contrast))


def compute_equivalence_p(contrast: Contrast) -> float:
    """Compute the p-value of the two one-sided tests of a difference within the margin.

    Parameters
    ----------
    contrast : contrast of two means

    Returns
    -------
    The larger of the two p-values; NaN without a margin. It is below 0.05, and the groups are
    equivalent, if the 90 % interval of the difference is within the margin.

    Notes
    -----
    The tests are those of Schuirmann, J. Pharmacokinetics and Biopharmaceutics 15 (1987) 657, with
    Welch's degrees of freedom. Common causes are added as in the interval. At the tail probability
    p, the root of the sum of squares of both half widths equals the distance to the margin.
    """
    if contrast.margin is None:
        return nan
    distance = contrast.margin - abs(contrast.difference)
    p = _compute_tail_probability(abs(distance), contrast)
    return p if distance > 0 else 1.0 - p


def _compute_tail_probability(distance: float, contrast: Contrast) -> float:
    """Compute the one-sided probability that scatter and common causes exceed a distance."""
    max_deviations = 8.0  # standard deviations; a probability below 1e-15 is returned as zero
    degrees, error, common_error = contrast.freedom, contrast.error, contrast.common_error
    if common_error == 0.0 and error == 0.0:
        return 0.0 if distance else 0.5
    if common_error == 0.0:
        return float(scipy.special.stdtr(degrees, -distance / error))

    def compute_excess(n_deviations: float) -> float:
        quantile = scipy.special.stdtrit(degrees, float(scipy.special.ndtr(-n_deviations)))
        return float(np.hypot(quantile * error, n_deviations * common_error)) - distance

    if compute_excess(max_deviations) <= 0.0:
        return 0.0
    from scipy.optimize import brentq  # slow import, needed for common causes only

    return float(scipy.special.ndtr(-brentq(compute_excess, 0.0, max_deviations)))


def compare_means(
    name: str,
    unit: str,
    first: tuple[str, NestedMean],
    second: tuple[str, NestedMean],
    margin: float | None = None,
) -> Difference:
    """Compare the means of one result in two groups.

    Parameters
    ----------
    name, unit : name and unit of the result
    first, second : name and mean of each group. The chosen means are compared; they are means of
        spool means if the spools were not pooled
    margin : largest difference without practical importance, as a fraction of the first mean

    Returns
    -------
    The difference with its own p-values, but without a verdict, which `judge_family` adds.
    """
    (first_name, first_nested), (second_name, second_nested) = first, second
    first_mean, second_mean = first_nested.chosen, second_nested.chosen
    difference = subtract_means(first_mean, second_mean)
    contrast = compute_contrast(first_mean, second_mean, margin)
    caveats = []
    single_spool_groups = [group for group, mean in (first, second) if len(mean.spool_means) == 1]
    if groups := " and ".join(single_spool_groups):
        caveats.append(format_sentence("statistics.single_spool", groups=groups))
    if causes := ", ".join(contribution.cause for contribution in difference.common):
        caveats.append(format_sentence("statistics.shared_causes", causes=causes))
    return Difference(
        name=name,
        unit=unit,
        first=first_name,
        second=second_name,
        difference=difference,
        margin=None if margin is None or first_mean.mean == 0.0 else margin * abs(first_mean.mean),
        contrast=contrast,
        p=nan if contrast is None else compute_difference_p(contrast),
        p_equivalent=nan if contrast is None else compute_equivalence_p(contrast),
        caveats=tuple(caveats),
    )


def judge_family(family: str, differences: Sequence[Difference]) -> list[Difference]:
    """Judge a family of comparisons.

    Parameters
    ----------
    family : name of the family
    differences : differences from `compare_means`

    Returns
    -------
    The differences with verdicts, in the same order. At most 5 % of reports have a wrong verdict
    *different* in the family, and at most 5 % a wrong *equivalent*, since `correct_p_values`
    corrects both for the number of tests. The verdict is

    - ``equivalent`` if the two one-sided tests find the difference within the margin, even if zero
      is outside the corrected interval;
    - otherwise ``different`` if zero is outside the corrected interval;
    - ``cannot tell`` otherwise.
    """
    difference_tests = correct_p_values([difference.p for difference in differences])
    equivalence_tests = correct_p_values([difference.p_equivalent for difference in differences])
    tests = zip(differences, difference_tests, equivalence_tests, strict=True)
    return [_judge_difference(family, *test) for test in tests]


def _judge_difference(
    family: str, difference: Difference, difference_test: CorrectedP, equivalence_test: CorrectedP
) -> Difference:
    """Add the verdict to a difference, given its corrected p-values."""
    max_log_ratio = 20.0  # keeps the ends of an interval finite
    contrast = difference.contrast
    if contrast is None:
        reason = difference.difference.reason
        text = reason.message if reason else format_sentence("statistics.no_interval")
        return replace(difference, family=family, verdict=Verdict.CANNOT_TELL, verdict_reason=text)
    tail_probability = ALPHA / difference_test.divisor
    middle, half_width = contrast.difference, compute_half_width(contrast, tail_probability)
    interval = Interval(middle - half_width, middle + half_width, 1.0 - tail_probability)
    if contrast.is_log:
        upper = expm1(min(interval.upper, max_log_ratio))
        interval = Interval(expm1(interval.lower), upper, interval.level)
    is_different, is_equivalent = difference_test.p < ALPHA, equivalence_test.p < ALPHA
    verdict = Verdict.DIFFERENT if is_different else Verdict.CANNOT_TELL
    verdict_reason = format_sentence(
        "statistics.p_value",
        p=_format_p(difference_test.p),
        corrected=_describe_correction(difference_test.n_tests),
    )
    if is_equivalent:
        verdict = Verdict.EQUIVALENT
        verdict_reason = format_sentence(
            "statistics.within_margin",
            real=format_sentence("statistics.real_but") if is_different else "",
            margin=_describe_margin(contrast),
            p=_format_p(equivalence_test.p),
            corrected=_describe_correction(equivalence_test.n_tests),
        )
    elif not is_different and contrast.margin is None:
        verdict_reason = format_sentence("statistics.zero_no_margin")
    elif not is_different:
        n = count_needed_samples(contrast, tail_probability)
        verdict_reason = format_sentence(
            "statistics.zero_beyond_margin",
            margin=_describe_margin(contrast),
            needed=format_sentence("statistics.more_samples", n=n) if n else "",
        )
    return replace(
        difference,
        family=family,
        n_comparisons=difference_test.n_tests,
        interval=interval,
        verdict=verdict,
        verdict_reason=verdict_reason,
    )


def _describe_correction(n_tests: int) -> str:
    """Return a clause on the correction for the number of tests; empty for a single test."""
    return format_sentence("statistics.corrected", tests=n_tests) if n_tests > 1 else ""


def _format_p(p: float) -> str:
    """Format a p-value with two digits."""
    return "0.0001 or less" if p < 1e-4 else f"{p:.2g}"


def _describe_margin(contrast: Contrast) -> str:
    """Return the margin as a percentage of the first mean, or ``the margin`` on a linear scale."""
    is_percentage = contrast.is_log and contrast.margin is not None
    return f"{100 * expm1(contrast.margin or 0.0):.3g} %" if is_percentage else "the margin"


def count_needed_samples(contrast: Contrast, tail_probability: float = ALPHA) -> int | None:
    """Count the values per group that are needed to distinguish different from equivalent.

    Parameters
    ----------
    contrast : contrast with a margin; its scatter is assumed to be known
    tail_probability : probability outside the interval, half of it on each side

    Returns
    -------
    The smallest count, above the present counts, for which the interval is not wider than the
    margin, so that it excludes zero or is within the margin. None for more than 50 values per
    group, without a margin, or without scatter.
    """
    max_advised_count = 50  # more values per group are rarely affordable
    if contrast.margin is None or not contrast.error:
        return None
    deviations = [e * sqrt(n) for e, n in zip(contrast.errors, contrast.counts, strict=True)]
    for n in range(max(contrast.counts) + 1, max_advised_count + 1):
        errors = deviations[0] / sqrt(n), deviations[1] / sqrt(n)
        larger_contrast = replace(contrast, errors=errors, counts=(n, n))
        if compute_half_width(larger_contrast, tail_probability) <= 0.5 * contrast.margin:
            return n
    return None


@dataclass(frozen=True, slots=True)
class CorrectedP:
    """p-value that is corrected for the number of tests in its family.

    Parameters
    ----------
    p : adjusted p-value, below the level of the family if the test is significant; NaN without a
        test
    divisor : level of the family divided by the level of this test
    n_tests : number of tests in the family
    """

    p: float
    divisor: int
    n_tests: int


def correct_p_values(p_values: Sequence[float], level: float = 0.05) -> list[CorrectedP]:
    """Correct the p-values of a family.

    Parameters
    ----------
    p_values : p-values of the tests; NaN without a test
    level : largest probability that at least one test of the family is a false positive

    Returns
    -------
    The corrected p-values, in the same order. In the order of increasing p-values, all tests from
    the first that is not significant have the divisor of that test. An interval at the level of a
    test therefore excludes zero exactly if the test is significant.

    Notes
    -----
    The method is that of Holm, Scandinavian Journal of Statistics 6 (1979) 65: the smallest of m
    p-values is compared with level / m, the next with level / (m - 1), and so on up to the first
    that is larger.

    Examples
    --------
    >>> [corrected.p for corrected in correct_p_values([0.04, 0.01, 0.03])]
    [0.06, 0.03, 0.06]
    """
    indices = sorted((i for i, p in enumerate(p_values) if not isnan(p)), key=p_values.__getitem__)
    n_tests = len(indices)
    corrected_p_values = [CorrectedP(nan, max(1, n_tests), n_tests)] * len(p_values)
    adjusted_p, divisor, is_significant = 0.0, max(1, n_tests), True
    for rank, i in enumerate(indices):
        n_remaining = n_tests - rank
        adjusted_p = max(adjusted_p, min(1.0, n_remaining * p_values[i]))
        divisor = n_remaining if is_significant else divisor
        is_significant = is_significant and adjusted_p < level
        corrected_p_values[i] = CorrectedP(adjusted_p, divisor, n_tests)
    return corrected_p_values


@dataclass(frozen=True, slots=True)
class _TestStep:
    """Step of an outlier test, which tests the most extreme of the remaining values.

    Parameters
    ----------
    index : index of the most extreme value among all tested values
    p_value : p-value of this value
    tied_indices : indices of other values with the same p-value
    """

    index: int
    p_value: float
    tied_indices: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OutlierTest:
    """Outlier test of one result of a group, before the correction for all results of a report.

    Parameters
    ----------
    names : names of the samples that have a value
    values : value of each of these samples, in the unit of the result
    steps : steps of the test, the most extreme value first; empty if no test is possible
    method : name of the test
    """

    names: Sequence[str] = ()
    values: Sequence[float] = ()
    steps: Sequence[_TestStep] = ()
    method: str = ""

    def select_outliers(self, max_p_value: float) -> tuple[Outlier, ...]:
        """Select the outliers of the steps up to the last significant step, most extreme first.

        Parameters
        ----------
        max_p_value : p-value below which a step is significant
        """
        # A significant step marks all earlier steps. Each step therefore gets the smallest p-value
        # of itself and all later steps.
        p_values = np.minimum.accumulate([step.p_value for step in self.steps[::-1]])[::-1]
        steps = zip(self.steps, p_values.tolist(), strict=True)
        significant_steps = [(step, p_value) for step, p_value in steps if p_value < max_p_value]
        step_indices = {step.index for step, _ in significant_steps}
        outliers = []
        for step, p_value in significant_steps:
            # Tied values with a step of their own are omitted.
            indices = [step.index, *(i for i in step.tied_indices if i not in step_indices)]
            for index in indices:
                names = " and ".join(self.names[i] for i in indices if i != index)
                note = format_sentence("statistics.equally_suspect", tests=names) if names else ""
                method = self.method + note
                outliers.append(Outlier(self.names[index], self.values[index], method, p_value))
        return tuple(outliers)


def run_outlier_test(
    values: Mapping[str, float], spools: Mapping[str, str], *, max_outliers: int | None = None
) -> OutlierTest:
    """Test whether the most extreme values are too far from the mean of their spool for chance.

    Parameters
    ----------
    values : value of each sample, keyed by name of the sample; NaNs are ignored
    spools : spool of each sample, keyed by the name of the sample
    max_outliers : largest number of outliers; if None, a tenth of the samples, but at least one

    Returns
    -------
    The test. It has no steps if the number of samples is less than the number of spools plus two,
    or if all samples of each spool are equal within rounding. Values with equal p-values are all
    marked, and the method of each outlier names the others. The two values of a spool of two
    samples always have equal p-values.

    Notes
    -----
    The residual of each sample from the mean of its spool is compared with the scatter of the
    other samples within their spools by Student's t with N - spools - 1 degrees of freedom. The
    p-value is N, the number of values, times the two-sided tail probability, but at most 1. In one
    spool this is Grubbs' test (Technometrics 11 (1969) 1). For several outliers, the test is
    repeated without the most extreme value, and all values up to the last significant value are
    marked, so that two outliers cannot mask each other. This is the generalised ESD test (Rosner,
    Technometrics 25 (1983) 165), which is meant for 15 samples or more.
    """
    names = [name for name, value in values.items() if not np.isnan(value)]
    tested_values = np.array([values[name] for name in names])
    spool_ids = np.unique([spools[name] for name in names], return_inverse=True)[1]
    max_steps = max(1, len(names) // 10) if max_outliers is None else max_outliers
    method = "generalised ESD test" if max_steps > 1 else "Grubbs' test"
    method += " within spools" if len(set(spool_ids.tolist())) > 1 else ""
    steps = _list_steps(tested_values, spool_ids, max_steps)
    return OutlierTest(names, tested_values.tolist(), steps, method)


def mark_outliers(groups: Sequence[Group], level: float = 0.05) -> list[Group]:
    """Mark the outliers among all results of a report.

    Parameters
    ----------
    groups : groups of the report. Earlier outliers of the groups are replaced. Results that the rig
        sets are not tested
    level : false-alarm rate for the whole report

    Returns
    -------
    The groups with the outliers of their results.

    Notes
    -----
    The smallest p-values of all results form one family. `correct_p_values` corrects them, which is
    also valid for dependent results of one test. Each step of the ESD test counts as one test,
    since its false-alarm rate exceeds its level (1.14 times for two steps at 5 % and 20 samples).
    """
    outlier_tests = [[_test_result(group, number) for number in group.numbers] for group in groups]
    p_values = [
        len(test.steps) * min((step.p_value for step in test.steps), default=nan)
        for test in chain(*outlier_tests)
    ]
    family, marked_groups = iter(correct_p_values(p_values, level)), list[Group]()
    for group, tests in zip(groups, outlier_tests, strict=True):
        max_p_values = [level / next(family).divisor / max(1, len(test.steps)) for test in tests]
        numbers = tuple(
            replace(number, outliers=test.select_outliers(max_p_value))
            for number, test, max_p_value in zip(group.numbers, tests, max_p_values, strict=True)
        )
        marked_groups.append(replace(group, numbers=numbers))
    return marked_groups


def _test_result(group: Group, number: GroupNumber) -> OutlierTest:
    """Test a result of a group for outliers, unless the rig sets it."""
    if number.is_set_by_rig:
        return OutlierTest()
    spools = [sample.specimen.spool for sample in group.samples]
    # Results without a value are never averaged.
    values = {name: result.value or 0.0 for name, result in number.values.items()}
    return run_outlier_test(values, dict(zip(name_samples(group.samples), spools, strict=True)))


def _list_steps(values: Floats, spool_ids: NDArray[np.intp], max_steps: int) -> list[_TestStep]:
    """List the steps of an outlier test; each step removes the most extreme remaining value."""
    max_tied_ratio = 1.001  # p-values of equally extreme values differ by rounding
    indices = np.arange(len(values))
    steps: list[_TestStep] = []
    for _ in range(max_steps):
        p_values = _compute_p_values(values[indices], spool_ids[indices])
        if p_values is None:
            break
        min_row = int(np.argmin(p_values))
        tied_rows = np.flatnonzero(p_values <= max_tied_ratio * p_values[min_row])
        tied_indices = tuple(int(indices[row]) for row in tied_rows if row != min_row)
        steps.append(_TestStep(int(indices[min_row]), float(p_values[min_row]), tied_indices))
        indices = np.delete(indices, min_row)
    return steps


def _compute_p_values(values: Floats, spool_ids: NDArray[np.intp]) -> Floats | None:
    """Compute the p-value of each value with Bonferroni's correction for the number of values.

    Return None if there are too few values, or if the values within each spool are equal.
    """
    rounding_error = 1e-12  # of a sum of values, relative to the largest value
    min_remaining_fraction = 1e-15  # prevents a division by zero
    spools, spool_ids = np.unique(spool_ids, return_inverse=True)
    degrees_of_freedom = len(values) - len(spools) - 1
    if degrees_of_freedom < 1:
        return None
    counts = np.bincount(spool_ids)
    means = np.bincount(spool_ids, weights=values) / counts
    residual = values - means[spool_ids]
    sum_of_squares = float(residual @ residual)
    if sum_of_squares <= (rounding_error * float(np.abs(values).max())) ** 2:
        return None
    # Removing a value from a spool of n reduces the sum of squares by residual^2 / (1 - 1 / n).
    variance_factor = 1.0 - 1.0 / counts[spool_ids]
    reduction = np.nan_to_num(divide(residual**2, variance_factor))
    remaining_fraction = np.maximum(1.0 - reduction / sum_of_squares, min_remaining_fraction)
    t = np.sqrt(reduction * degrees_of_freedom / (remaining_fraction * sum_of_squares))
    return np.minimum(1.0, 2.0 * len(values) * scipy.special.stdtr(degrees_of_freedom, -t))
