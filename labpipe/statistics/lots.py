"""Judge samples, and the lot they were taken from, against the smallest allowed force.

Forces are given as shares of the limit: peak force over the smallest force allowed.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np
from scipy import special

from labpipe.records.group import Answer, Lot, LotRule, Sample, SampleVerdict
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status, find_result

FORCE_LIMIT, PEAK_OVER_LIMIT = "force_limit", "peak_over_limit"
"""Results that determine a verdict."""
MIN_SAMPLES = 2
"""Fewer have no scatter."""
MAX_SAMPLES = 100_000
"""The search for a number of samples ends here."""


def judge_sample(peak_over_limit: Result) -> SampleVerdict:
    """Judge a sample by its number, as standards do, and by its 95 % interval.

    Parameters
    ----------
    peak_over_limit : peak force over its limit

    Returns
    -------
    By the number, a sample passes at or above 1. By the interval the verdict is the same if the
    number is not doubtful and the whole interval is at or above 1 or below 1. Otherwise it is
    ``cannot tell``. Without a number both are ``cannot tell``.
    """
    if peak_over_limit.value is None:
        return SampleVerdict(Answer.CANNOT_TELL, Answer.CANNOT_TELL)
    by_number = Answer.PASS if peak_over_limit.value >= 1.0 else Answer.FAIL
    interval = peak_over_limit.interval
    excludes_limit = interval is not None and (interval.lower >= 1.0 or interval.upper < 1.0)
    is_certain = excludes_limit and peak_over_limit.status is Status.OK
    return SampleVerdict(by_number, by_number if is_certain else Answer.CANNOT_TELL)


def find_verdict(results: Iterable[Result]) -> SampleVerdict | None:
    """Judge a sample by the results of its test; None if its protocol states no limit."""
    peak_over_limit = find_result(results, PEAK_OVER_LIMIT)
    return None if peak_over_limit is None else judge_sample(peak_over_limit)


def compute_tolerance_factor(n: int, coverage: float, confidence: float) -> float:
    """Compute the factor k of a one-sided tolerance bound of normal numbers, mean - k s.

    Parameters
    ----------
    n : samples, at least 2
    coverage : share of the lot above the bound
    confidence : probability that the bound holds

    Notes
    -----
    k = t'(confidence; n - 1, z sqrt(n)) / sqrt(n), with the quantile of the noncentral t
    distribution and the normal quantile z of the coverage (ISO 16269-6; NIST/SEMATECH e-Handbook
    of Statistical Methods, 7.2.6.3).

    Examples
    --------
    >>> round(compute_tolerance_factor(10, 0.90, 0.95), 3)
    2.355
    """
    shift = float(special.ndtri(coverage)) * sqrt(n)
    return float(special.nctdtrit(n - 1, shift, confidence)) / sqrt(n)


def count_samples_to_pass(mean: float, deviation: float, rule: LotRule) -> int | None:
    """Compute how many samples a lot of this mean and standard deviation needs to pass.

    Parameters
    ----------
    mean, deviation : mean and deviation of shares of the limit
    rule : coverage and confidence

    Returns
    -------
    The smallest number; None if `MAX_SAMPLES` do not suffice.
    """

    def passes(n: int) -> bool:
        factor = compute_tolerance_factor(n, rule.coverage, rule.confidence)
        return mean - factor * deviation >= 1.0

    n = 2 + bisect_left(range(2, MAX_SAMPLES + 1), True, key=passes)
    return n if n <= MAX_SAMPLES else None


def judge_lot(samples: Sequence[Sample], rule: LotRule) -> Lot | None:
    """Judge the lot that samples were taken from.

    Parameters
    ----------
    samples : samples of one group
    rule : coverage and confidence

    Returns
    -------
    The answer with its numbers; None if the protocol of the samples states no limit.

    Notes
    -----
    The lot fails if a sample fails by its number and is not doubtful. The scatter is judged if all
    samples pass by their numbers, there are at least two, and their limits are equal. The lot then
    passes if the one-sided lower tolerance bound reaches the limit. It fails if, at the confidence
    of the rule, a smaller share of the lot than the coverage reaches the limit. Otherwise the
    answer is ``cannot tell``. Strengths are assumed to be normally distributed; the bound excludes
    errors common to all tests of a rig.
    """
    shares = {
        sample.test: share
        for sample in samples
        if (share := find_result(sample.results, PEAK_OVER_LIMIT)) is not None
    }
    if not shares:
        return None
    limits = {
        result.value
        for sample in samples
        if (result := find_result(sample.results, FORCE_LIMIT)) and result.value is not None
    }
    values = np.array([share.value for share in shares.values() if share.value is not None])
    n = len(values)
    mean = float(values.mean()) if n else np.nan
    deviation = float(values.std(ddof=1)) if n >= MIN_SAMPLES else np.nan
    has_scatter = deviation > 0.0
    factor = (
        compute_tolerance_factor(n, rule.coverage, rule.confidence) if n >= MIN_SAMPLES else np.nan
    )
    lot = Lot(
        answer=Answer.CANNOT_TELL,
        limit=limits.pop() if len(limits) == 1 else None,
        verdicts={test: judge_sample(share) for test, share in shares.items()},
        rule=rule,
        n=n,
        mean=mean,
        deviation=deviation,
        smallest=float(values.min()) if n else np.nan,
        bound=mean - factor * deviation,
        cpk=(mean - 1.0) / (3.0 * deviation) if has_scatter else np.nan,
        n_needed=count_samples_to_pass(mean, deviation, rule) if has_scatter else None,
    )
    return _add_answer(lot, shares, limits)


def _add_answer(lot: Lot, shares: Mapping[str, Result], limits: Collection[float | None]) -> Lot:
    """Complete a lot with its answer and the reasons for it."""
    is_clear = {test: share.status is Status.OK for test, share in shares.items()}
    failing = [test for test, verdict in lot.verdicts.items() if verdict.by_number is Answer.FAIL]
    failing_clear = [test for test in failing if is_clear[test]]
    unjudged = [test for test, share in shares.items() if share.value is None]
    unjudged += [test for test in failing if not is_clear[test]]
    if failing_clear:
        tests = ", ".join(failing_clear)
        answer = Answer.FAIL
        reason = Reason.of("statistics.lot_sample_fails", tests=tests)
    elif unjudged or len(limits) > 1 or lot.n < MIN_SAMPLES:
        answer, tests = Answer.CANNOT_TELL, ", ".join(unjudged)
        reason = Reason.of("statistics.lot_of_one")
        if len(limits) > 1:
            reason = Reason.of("statistics.lot_limits_differ")
        elif unjudged:
            reason = Reason.of("statistics.lot_sample_unknown", tests=tests)
    else:
        answer, reason = _judge_scatter(lot)
    doubtful = [test for test in shares if not is_clear[test] and test not in unjudged]
    caveat = Reason.of("statistics.lot_doubtful", tests=", ".join(doubtful))
    return replace(lot, answer=answer, reasons=(reason, caveat) if doubtful else (reason,))


def _judge_scatter(lot: Lot) -> tuple[Answer, Reason]:
    """Judge a lot, all of whose samples pass, by its tolerance bound."""
    bound, needed = lot.describe_share(lot.bound), lot.n_needed
    coverage, confidence = map(write_percent, (lot.rule.coverage, lot.rule.confidence))
    if lot.bound >= 1.0:
        return Answer.PASS, Reason.of(
            "statistics.lot_passes", bound=bound, coverage=coverage, confidence=confidence
        )
    upper_factor = compute_tolerance_factor(lot.n, lot.rule.coverage, 1.0 - lot.rule.confidence)
    if lot.mean - upper_factor * lot.deviation < 1.0:
        return Answer.FAIL, Reason.of(
            "statistics.lot_fails", coverage=coverage, confidence=confidence
        )
    if needed is None:
        return Answer.CANNOT_TELL, Reason.of(
            "statistics.lot_never_passes", bound=bound, coverage=coverage
        )
    return Answer.CANNOT_TELL, Reason.of(
        "statistics.lot_needs_more", bound=bound, coverage=coverage, needed=needed
    )


def write_percent(fraction: float) -> str:
    """Write a share in percent, such as ``99.9 %``."""
    return f"{100.0 * fraction:.6g} %"
