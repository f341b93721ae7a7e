"""Compute means of samples nested in spools, and budgets of their uncertainty.

The intervals of the means include the causes that are common to all tests of a rig.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, permutations
from math import exp, factorial, hypot, prod
from statistics import median

import numpy as np
import scipy

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import AveragingDecision, GroupNumber, MeanInterval, NestedMean
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution, Result

ALPHA = 1.0 - 0.95
"""Significance level of tests, and probability outside two-sided 95 % intervals.

It is divided if several results are compared.
"""
_MAX_PARTITIONS = 100
"""Largest number of assignments of samples to spools for which the Anderson-Darling test is exact.

The statistic is computed for each of the assignments.
"""


@dataclass(frozen=True, slots=True)
class PoolingLimits:
    """Conditions under which samples of several spools count as independent.

    Parameters
    ----------
    min_p : smallest p-value of the k-sample Anderson-Darling test for pooling; usually 0.05
    max_spool_share : largest fraction of the variance that may be between spools. With 0.1 and
        three samples per spool, the pooled interval is at most 9 % too short
    confidence : confidence level of the upper limit of this fraction. With 0.999, wrong pooling is
        so rare that the interval still covers 95 %
    """

    min_p: float = 0.05
    max_spool_share: float = 0.1
    confidence: float = 0.999


DEFAULT_LIMITS = PoolingLimits()


def compute_nested_mean(
    spools: Mapping[str, Sequence[float] | Floats], limits: PoolingLimits = DEFAULT_LIMITS
) -> NestedMean:
    """Compute the mean of samples nested in spools, with an interval for the type of wire.

    Parameters
    ----------
    spools : values of the samples, keyed by spool; NaNs and empty spools are ignored
    limits : conditions under which spools are pooled

    Returns
    -------
    The mean, in the unit of the values. `chosen` is the mean of the samples if the Anderson-Darling
    test finds no difference between the spools *and* the upper confidence limit of the fraction of
    the variance between spools is below its limit. Otherwise `chosen` is the mean of the spool
    means with equal weights. For one spool, `chosen` is the mean of the samples, and `decision`
    states the limitation.

    Notes
    -----
    A test has little power for two or three spools, so the upper limit decides. The explanation
    docs/explanations/statistics.md has the measured coverage of the chosen interval.
    """
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in spools.items()}
    finite_arrays = {name: array[~np.isnan(array)] for name, array in arrays.items()}
    values_by_spool = {name: array for name, array in finite_arrays.items() if len(array)}
    values = list(values_by_spool.values())
    sample_mean = compute_mean(np.concatenate([np.zeros(0), *values]), "sample")
    means = {name: compute_mean(array, "sample") for name, array in values_by_spool.items()}
    if len(values_by_spool) < 2:
        decision = _describe_one_spool(sample_mean.n)
        return NestedMean(sample_mean, True, decision, means, within_spools=sample_mean.deviation)
    scatter = estimate_spool_scatter(values, limits.confidence)
    p = compute_spools_p(values)
    is_pooled = bool(p >= limits.min_p and scatter.max_spool_share < limits.max_spool_share)
    mean_of_spools = compute_mean([mean.mean for mean in means.values()], "spool")
    return NestedMean(
        chosen=sample_mean if is_pooled else mean_of_spools,
        is_pooled=is_pooled,
        decision=_describe_decision(values, scatter, p, limits, is_pooled=is_pooled),
        spool_means=means,
        within_spools=scatter.within,
        between_spools=scatter.between_spools,
        spool_p=p,
    )


def _describe_one_spool(n_samples: int) -> AveragingDecision:
    """Return the decision for values of one spool, or for no values."""
    if not n_samples:
        return AveragingDecision(format_sentence("statistics.no_values"))
    samples_text = "1 sample" if n_samples == 1 else f"{n_samples} samples"
    summary = format_sentence("statistics.over_one_spool", samples=samples_text)
    return AveragingDecision(summary, (format_sentence("statistics.one_spool"),))


def _describe_decision(
    spools: Sequence[Floats],
    scatter: SpoolScatter,
    p: float,
    limits: PoolingLimits,
    *,
    is_pooled: bool,
) -> AveragingDecision:
    """Describe what was averaged, and on which results the decision is based."""
    counts = tuple(len(values) for values in spools)
    totals = {"samples": sum(counts), "spools": len(counts)}
    summary = format_sentence(
        "statistics.pooled" if is_pooled else "statistics.not_pooled", **totals
    )
    grounds = (*_describe_spool_variance(scatter, limits), _describe_test(p, counts, limits))
    if max(counts) > 1 and np.ptp(np.concatenate(spools)) == 0.0:
        grounds = (format_sentence("statistics.values_equal"),)
    return AveragingDecision(summary, grounds)


def _describe_spool_variance(scatter: SpoolScatter, limits: PoolingLimits) -> tuple[str, ...]:
    """Describe the fraction of the variance that is between spools, and its limit for pooling."""
    if np.isnan(scatter.within):
        return (format_sentence("statistics.scatter_unknown"),)
    max_percent, ratio_text = 100.0 * scatter.max_spool_share, ""
    if scatter.within > 0.0:
        ratio = scatter.between_spools / scatter.within
        ratio_text = format_sentence("statistics.scatter_ratio", ratio=ratio)
    facts = {"percent": 100.0 * scatter.spool_share, "ratio": ratio_text}
    sentence = format_sentence("statistics.share", **facts, max_percent=max_percent)
    if scatter.between_spools == 0.0:
        sentence = format_sentence("statistics.spools_alike", max_percent=max_percent)
    limit, confidence = 100.0 * limits.max_spool_share, 100.0 * limits.confidence
    limit_facts = {"limit_percent": limit, "confidence_percent": confidence}
    return sentence, format_sentence("statistics.share_needed", **limit_facts)


def _describe_test(p: float, counts: tuple[int, ...], limits: PoolingLimits) -> str:
    """Describe the result of the Anderson-Darling test, or why there is none."""
    if np.isnan(p):
        return format_sentence("statistics.no_test")
    smallest_p = compute_smallest_p(counts)
    if smallest_p >= limits.min_p:
        sizes = f"{', '.join(map(str, counts[:-1]))} and {counts[-1]}"
        return format_sentence("statistics.test_without_power", sizes=sizes, smallest_p=smallest_p)
    min_p = limits.min_p
    return format_sentence(
        "statistics.equal" if p >= min_p else "statistics.unequal", p=p, min_p=min_p
    )


def compute_t_quantile(degrees: float, tail_probability: float = ALPHA) -> float:
    """Compute the two-sided quantile of Student's t-distribution.

    Parameters
    ----------
    degrees : degrees of freedom, above 0
    tail_probability : probability outside the interval, half of it on each side; 0.05 for a 95 %
        interval

    Notes
    -----
    For 95 % the quantile is 12.706, 4.303, 2.776 and 2.571 for 1, 2, 4 and 5 degrees of freedom, as
    for the mean of 2, 3, 5 and 6 values. Equation (2.1) of [1]_ prints another quantile; this one
    has the stated coverage.

    References
    ----------
    .. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
           dissertation.
    """
    return float(scipy.special.stdtrit(degrees, 1.0 - 0.5 * tail_probability))


def compute_mean(values: Iterable[float], value_name: str = "value") -> MeanInterval:
    """Compute the mean of independent values with its 95 % interval.

    Parameters
    ----------
    values : values in any unit; NaNs are ignored
    value_name : noun for one value, such as ``sample``, for the reason of a missing interval

    Returns
    -------
    The mean with the interval mean -+ t s / sqrt(n), with n - 1 degrees of freedom. Without values,
    the mean is NaN, and the reason is ``no_samples``. With one value, there is no interval, and the
    reason is ``one_sample``.
    """
    array = np.array(list(values), dtype=np.float64)
    finite_values = array[~np.isnan(array)]
    n = len(finite_values)
    if n == 0:
        reason = Reason.of("statistics.no_samples", what=value_name)
        return MeanInterval(np.nan, None, np.nan, 0, reason)
    mean = float(finite_values.mean())
    if n == 1:
        reason = Reason.of("statistics.one_value", what=value_name)
        return MeanInterval(mean, None, np.nan, 1, reason)
    deviation = float(finite_values.std(ddof=1))
    half_width = compute_t_quantile(n - 1) * deviation / np.sqrt(n)
    interval = Interval(float(mean - half_width), float(mean + half_width))
    return MeanInterval(mean, interval, deviation, n)


@dataclass(frozen=True, slots=True)
class SpoolScatter:
    """Scatter of samples within spools, and scatter between spools.

    Parameters
    ----------
    within : standard deviation of samples of one spool; NaN if no spool has two samples
    between_spools : standard deviation of the true means of spools; 0 if the scatter of the samples
        explains the scatter of the spool means; NaN if `within` is NaN
    spool_share : fraction of the variance that is between spools, between_spools^2 /
        (between_spools^2 + within^2); NaN if both are 0 or NaN
    max_spool_share : upper confidence limit of `spool_share`; 1 if not available
    """

    within: float
    between_spools: float
    spool_share: float
    max_spool_share: float


def estimate_spool_scatter(spools: Sequence[Floats], confidence: float) -> SpoolScatter:
    """Estimate the scatter between spools and within spools.

    Parameters
    ----------
    spools : values of the samples of each spool, two spools or more, none empty, without NaN
    confidence : one-sided confidence level of `SpoolScatter.max_spool_share`

    Returns
    -------
    The scatter, with standard deviations in the unit of the values.

    Notes
    -----
    This is the one-way analysis of variance of unweighted spool means. With the harmonic mean h of
    the numbers of samples and the variance S^2 of the spool means, between_spools^2 = S^2 -
    within^2 / h. The upper limit of the fraction inverts the F distribution of h S^2 / within^2
    [1]_. It is exact for equal numbers of samples.

    References
    ----------
    .. [1] Thomas and Hultquist, Annals of Statistics 6 (1978) 582.
    """
    counts = np.array([len(values) for values in spools])
    degrees = int(np.sum(counts - 1))
    if degrees == 0:
        return SpoolScatter(np.nan, np.nan, np.nan, 1.0)
    sum_of_squares = float(sum(np.sum((values - values.mean()) ** 2) for values in spools))
    within_variance = sum_of_squares / degrees
    harmonic_mean = len(spools) / float(np.sum(1.0 / counts))
    mean_variance = float(np.var([values.mean() for values in spools], ddof=1))
    spool_variance = max(mean_variance - within_variance / harmonic_mean, 0.0)
    variance = spool_variance + within_variance
    share = spool_variance / variance if variance > 0.0 else np.nan
    f_quantile = float(scipy.special.fdtri(len(spools) - 1, degrees, 1.0 - confidence))
    max_share = 1.0
    if within_variance * f_quantile != 0.0:
        # The limit is the fraction for which the observed ratio of variances is the quantile.
        excess = max(harmonic_mean * mean_variance / (within_variance * f_quantile) - 1.0, 0.0)
        max_share = excess / (excess + harmonic_mean)
    deviations = float(np.sqrt(within_variance)), float(np.sqrt(spool_variance))
    return SpoolScatter(*deviations, share, max_share)


def compute_spools_p(spools: Sequence[Floats]) -> float:
    """Compute the p-value of the k-sample Anderson-Darling test that spools are equal.

    Parameters
    ----------
    spools : values of the samples of each spool, without NaN

    Returns
    -------
    The p-value; NaN for fewer than two spools, for a spool of one sample, or if all values are
    equal.

    Notes
    -----
    The test is that of [1]_ with midranks. If there are few assignments of samples to spools (20
    for two spools of three), the statistic is computed for all of them, and p is exact. Otherwise p
    is interpolated in the table of [1]_, which ends at 0.001 and 0.25.

    References
    ----------
    .. [1] Scholz and Stephens, J. Am. Stat. Assoc. 82 (1987) 918.
    """
    from scipy import stats  # imported here, because the import takes a third of a second

    counts = [len(values) for values in spools]
    if len(counts) < 2 or min(counts) < 2 or np.ptp(np.concatenate(spools)) == 0.0:
        return float("nan")
    exact_method = stats.PermutationMethod(n_resamples=_MAX_PARTITIONS)
    with warnings.catch_warnings():
        # SciPy warns at the ends of the table, which the docstring states.
        warnings.filterwarnings("ignore", message="p-value (capped|floored)", category=UserWarning)
        outcome = stats.anderson_ksamp(
            spools,
            variant="midrank",
            method=exact_method if _count_partitions(counts) <= _MAX_PARTITIONS else None,
        )
    return float(outcome.pvalue)


def _count_partitions(counts: Sequence[int]) -> int:
    """Count the assignments of samples to spools, given the number of samples of each spool."""
    return factorial(sum(counts)) // prod(factorial(count) for count in counts)


@lru_cache(maxsize=64)
def compute_smallest_p(counts: tuple[int, ...]) -> float:
    """Compute the smallest possible p-value of `compute_spools_p`, for spools without overlap.

    Parameters
    ----------
    counts : number of samples of each spool

    Returns
    -------
    The p-value, such as 0.1 for 3 and 3 samples, since 2 of the 20 assignments have no overlap. If
    the test is not exact, the p-value is 0.001, the end of the table. Without a test, it is NaN.
    """
    if len(counts) < 2 or min(counts) < 2:
        return float("nan")
    if _count_partitions(counts) > _MAX_PARTITIONS:
        return 0.001
    orders = set(permutations(sorted(counts)))
    ranks = np.arange(sum(counts), dtype=np.float64)
    return min(compute_spools_p(np.split(ranks, np.cumsum(order)[:-1])) for order in orders)


SCATTER = "scatter of the tests"
"""Name of the contribution of the scatter of the tests to the uncertainty of their mean."""


@dataclass(frozen=True, slots=True)
class GroupBudget:
    """Contributions of causes to the uncertainty of one result of a group.

    Parameters
    ----------
    test_shares : fraction of the variance of a test that each cause contributes, as the median over
        the tests, keyed by cause; the fractions sum to one; empty without budgets
    mean_shares : fraction of the squared half width of the mean that `SCATTER` and each common
        cause contribute, keyed by cause; the fractions sum to one; empty without an interval
    """

    test_shares: Mapping[str, float]
    mean_shares: Mapping[str, float]


def summarise_budget(group_result: GroupNumber) -> GroupBudget:
    """Summarise the budgets of the tests of a group, and compute the budget of their mean.

    Parameters
    ----------
    group_result : result of a group; tests without a budget are ignored

    Returns
    -------
    The budget, with causes in the order of `IS_COMMON`. Medians are scaled so that they sum to one.
    The fraction of a cause that a test does not have is zero.
    """
    shares_by_test = [
        {row.cause: share for row, share in zip(result.budget, result.fractions, strict=True)}
        for result in group_result.values.values()
        if result.largest_cause is not None
    ]
    causes = sort_causes(chain(*shares_by_test))
    medians = {cause: median(item.get(cause, 0.0) for item in shares_by_test) for cause in causes}
    total = sum(medians.values())
    test_shares = {cause: share / total for cause, share in medians.items() if share > 0.0}
    mean = group_result.mean.chosen
    if mean.interval is None or not mean.interval.upper > mean.interval.lower:
        return GroupBudget(test_shares, {})
    factor = Interval.make_normal(0.0, 1.0).upper / mean.half_width
    common_shares = {row.cause: (factor * row.change) ** 2 for row in mean.common if row.change}
    scatter = 1.0 - (factor * combine_changes(mean.common)) ** 2
    sorted_shares = {cause: common_shares[cause] for cause in sort_causes(common_shares)}
    return GroupBudget(test_shares, {SCATTER: scatter, **sorted_shares})


def sort_causes(causes: Iterable[str]) -> list[str]:
    """Sort causes in the order of budgets and figures: `SCATTER` first, unknown causes last."""
    all_causes, known_causes = set(causes), (SCATTER, *IS_COMMON)
    return [
        *(cause for cause in known_causes if cause in all_causes),
        *sorted(all_causes.difference(known_causes)),
    ]


_BIAS = ""
"""Key of the value minus the estimate in `_Errors`."""
_Errors = Mapping[str, float]
"""Errors of a result or a mean that do not contribute to the scatter, in the unit of the result.

The errors are the change by each common cause, keyed by cause, and the value minus the estimate.
"""


def add_common_causes(mean: NestedMean, spools: Mapping[str, Sequence[Result]]) -> NestedMean:
    """Include the common causes of all tests in the intervals of a mean.

    Parameters
    ----------
    mean : mean of the results, with intervals from the scatter alone
    spools : results that are averaged, keyed by spool

    Returns
    -------
    The same means and scatter. The middle of every interval is the mean of the estimates, and the
    intervals are widened by the common causes (`widen_interval`), which the decision names.

    Notes
    -----
    A common cause changes all results at the same time, each by its own signed change, and their
    mean by the mean of the changes. This is the linear sum for correlation coefficients of +1
    (GUM, JCGM 100:2008, 5.2.2, note 1). Different causes are independent of each other.
    """
    errors = {name: [_list_errors(result) for result in spools[name]] for name in mean.spool_means}
    spool_errors = {name: _average_errors(rows) for name, rows in errors.items()}
    # The error of the mean is averaged as the mean: over samples or over spools.
    terms = [*chain(*errors.values())] if mean.is_pooled else [*spool_errors.values()]
    chosen = _shift_interval(mean.chosen, _average_errors(terms))
    decision = mean.decision
    if causes := ", ".join(contribution.cause for contribution in chosen.common):
        clause = format_sentence("statistics.common_causes", causes=causes)
        decision = replace(decision, grounds=(*decision.grounds, clause))
    spool_means = {
        name: _shift_interval(spool_mean, spool_errors[name])
        for name, spool_mean in mean.spool_means.items()
    }
    return replace(mean, chosen=chosen, spool_means=spool_means, decision=decision)


def _list_errors(result: Result) -> _Errors:
    """Return the errors of a result that do not contribute to the scatter, keyed by cause."""
    value = 0.0 if result.value is None else result.value
    estimate = value if result.estimate is None else result.estimate
    common_changes = {row.cause: row.change for row in result.budget if row.is_common}
    return {_BIAS: value - estimate, **common_changes}


def _average_errors(rows: Sequence[_Errors]) -> _Errors:
    """Average the errors of results or spools; the change by a missing cause is zero."""
    causes, count = dict.fromkeys([_BIAS, *chain(*rows)]), max(len(rows), 1)
    return {cause: sum(row.get(cause, 0.0) for row in rows) / count for cause in causes}


def _shift_interval(mean: MeanInterval, errors: _Errors) -> MeanInterval:
    """Shift the interval of a mean to its estimate, and widen it by the common causes."""
    bias, interval = errors[_BIAS], mean.interval
    common = tuple(
        Contribution(cause, change, is_common=True)
        for cause, change in errors.items()
        if cause != _BIAS
    )
    if interval is not None:
        interval = widen_interval(Interval(interval.lower - bias, interval.upper - bias), common)
    estimate = mean.mean - bias if bias else None
    return replace(mean, interval=interval, estimate=estimate, common=common)


def combine_changes(contributions: Sequence[Contribution]) -> float:
    """Combine the changes by independent causes into one standard uncertainty."""
    return hypot(*(contribution.change for contribution in contributions))


def widen_interval(interval: Interval, contributions: Sequence[Contribution]) -> Interval:
    """Widen the t interval of a mean by common causes.

    Parameters
    ----------
    interval : interval from Student's t-distribution
    contributions : change of the mean by each common cause

    Returns
    -------
    The interval about the same middle. Its half width is the root of the sum of squares of the half
    width of `interval` and the normal 95 % half width of the common causes. The interval is
    unchanged without common causes.

    Notes
    -----
    With effective degrees of freedom (GUM, G.4.1), a common cause would make the interval of two
    values *shorter*, since t decreases from 12.7 faster than the uncertainty increases. The root of
    the sum of squares never shortens the interval. docs/explanations/statistics.md states the
    coverage.
    """
    middle = 0.5 * (interval.lower + interval.upper)
    common_half_width = Interval.make_normal(0.0, combine_changes(contributions)).upper
    if not common_half_width:
        return interval
    half_width = hypot(0.5 * (interval.upper - interval.lower), common_half_width)
    return Interval(middle - half_width, middle + half_width, interval.level)


def subtract_changes(
    first: Sequence[Contribution], second: Sequence[Contribution]
) -> tuple[Contribution, ...]:
    """Compute the changes of the difference of two means, second minus first, by common causes.

    Parameters
    ----------
    first, second : changes of two means of tests on one rig, by causes that act on both means
    """
    changes = {row.cause: 0.0 - row.change for row in first}
    for row in second:
        changes[row.cause] = row.change + changes.get(row.cause, 0.0)
    return tuple(Contribution(cause, change, is_common=True) for cause, change in changes.items())


def are_positive(results: Iterable[Result]) -> bool:
    """Return whether the values and estimates of all results are above zero.

    Parameters
    ----------
    results : results that are averaged
    """
    return all(
        result.value is not None
        and result.value > 0.0
        and (result.estimate is None or result.estimate > 0.0)
        for result in results
    )


def convert_to_log_scale(mean: NestedMean) -> NestedMean:
    """Make the intervals of the mean of a positive result symmetric on a log scale.

    Parameters
    ----------
    mean : mean with intervals from Student's t and the common causes of a rig

    Returns
    -------
    The same means and scatters. An interval with a positive middle m and half width w becomes
    m exp(-w / m) to m exp(w / m); other intervals are unchanged.

    Notes
    -----
    The standard error of log(mean) is, to first order, the standard error of the mean divided by
    the mean. The interval is therefore that of the arithmetic mean, not of the geometric mean. A
    spreadsheet computes its upper end, without common causes, by
    ``AVERAGE(x)*EXP(T.INV.2T(0.05;n-1)*STDEV.S(x)/SQRT(n)/AVERAGE(x))``. The explanation
    docs/explanations/statistics.md states the coverage.
    """
    spool_means = {name: _convert_interval(item) for name, item in mean.spool_means.items()}
    return replace(mean, chosen=_convert_interval(mean.chosen), spool_means=spool_means)


def _convert_interval(mean: MeanInterval) -> MeanInterval:
    """Make the interval of a mean with a positive middle symmetric on a log scale."""
    max_exponent = 300.0  # keeps the ends finite and above zero
    if mean.interval is None or not mean.middle > 0.0:
        return mean
    factor = exp(min(mean.half_width / mean.middle, max_exponent))
    interval = Interval(mean.middle / factor, mean.middle * factor, mean.interval.level)
    return replace(mean, interval=interval, is_log=True)
