"""Judge samples, and the lot from which they were taken, by the smallest allowed peak force.

The limit is the smallest allowed peak force. Peak forces are stated as fractions of the limit.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np
import scipy

from labpipe.records.group import Answer, Lot, Sample, SampleVerdict
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status, find_result

FORCE_LIMIT, PEAK_OVER_LIMIT = "force_limit", "peak_over_limit"
"""Names of the results on which a verdict is based."""
MIN_SAMPLES = 2
"""Smallest number of samples from which a standard deviation can be computed."""
MAX_SAMPLES = 100_000
"""Largest number of samples that `count_samples_to_pass` tries."""


def judge_sample(peak_over_limit: Result) -> SampleVerdict:
    """Judge a sample by its value, as standards do, and by its 95 % interval.

    Parameters
    ----------
    peak_over_limit : result of a test: peak force divided by the limit

    Returns
    -------
    Both verdicts. By its value, a sample passes at or above 1. By its interval, the verdict is the
    same if the value is not doubtful and the whole interval is at or above 1 or below 1, and
    ``cannot tell`` otherwise. Without a value both verdicts are ``cannot tell``.
    """
    if peak_over_limit.value is None:
        return SampleVerdict(Answer.CANNOT_TELL, Answer.CANNOT_TELL)
    value_answer = Answer.PASS if peak_over_limit.value >= 1.0 else Answer.FAIL
    interval = peak_over_limit.interval
    excludes_limit = interval is not None and (interval.lower >= 1.0 or interval.upper < 1.0)
    is_certain = excludes_limit and peak_over_limit.status is Status.OK
    return SampleVerdict(value_answer, value_answer if is_certain else Answer.CANNOT_TELL)


def judge_results(results: Iterable[Result]) -> SampleVerdict | None:
    """Judge a sample by the results of its test; return None if the protocol states no limit."""
    peak_over_limit = find_result(results, PEAK_OVER_LIMIT)
    return None if peak_over_limit is None else judge_sample(peak_over_limit)


def compute_tolerance_factor(n: int, coverage: float, confidence: float) -> float:
    """Compute the factor k of the one-sided tolerance bound mean - k s of normal values.

    Parameters
    ----------
    n : number of samples, at least 2
    coverage : smallest fraction of the lot that is above the bound
    confidence : probability that at least this fraction is above the bound

    Notes
    -----
    The factor is k = t'(confidence; n - 1, z sqrt(n)) / sqrt(n), with the quantile t' of the
    noncentral t-distribution and the normal quantile z of the coverage (ISO 16269-6; NIST/SEMATECH
    e-Handbook of Statistical Methods, 7.2.6.3).

    Examples
    --------
    >>> round(compute_tolerance_factor(10, 0.90, 0.95), 3)
    2.355
    """
    noncentrality = float(scipy.special.ndtri(coverage)) * sqrt(n)
    return float(scipy.special.nctdtrit(n - 1, noncentrality, confidence)) / sqrt(n)


def count_samples_to_pass(
    mean: float, deviation: float, coverage: float, confidence: float
) -> int | None:
    """Count the samples that a lot of given mean and standard deviation needs to pass.

    Parameters
    ----------
    mean, deviation : mean and standard deviation of the forces, as fractions of the limit
    coverage : required fraction of the lot that reaches the limit
    confidence : probability with which this fraction must be demonstrated

    Returns
    -------
    The smallest number of samples; None if `MAX_SAMPLES` samples are not enough.
    """

    def reaches_limit(n: int) -> bool:
        factor = compute_tolerance_factor(n, coverage, confidence)
        return mean - factor * deviation >= 1.0

    n = MIN_SAMPLES + bisect_left(range(MIN_SAMPLES, MAX_SAMPLES + 1), True, key=reaches_limit)
    return n if n <= MAX_SAMPLES else None


def judge_lot(samples: Sequence[Sample], *, coverage: float, confidence: float) -> Lot | None:
    """Judge the lot from which samples were taken.

    Parameters
    ----------
    samples : samples of one group
    coverage : required fraction of the lot that reaches the limit
    confidence : probability with which this fraction must be demonstrated

    Returns
    -------
    The answer with its numbers; None if the protocol of the samples states no limit.

    Notes
    -----
    The lot fails if a sample fails by its value and is not doubtful. The scatter is judged if all
    samples pass by their values, there are at least two samples, and their limits are equal. The
    lot then passes if the one-sided lower tolerance bound reaches the limit. It fails if, at the
    required confidence, a smaller fraction of the lot than the coverage reaches the limit.
    Otherwise the answer is ``cannot tell``. Peak forces are assumed to be normally distributed. The
    bound does not include errors that are common to all tests of a rig.
    """
    fractions = {
        sample.test: fraction
        for sample in samples
        if (fraction := find_result(sample.results, PEAK_OVER_LIMIT)) is not None
    }
    if not fractions:
        return None
    limits = {
        result.value
        for sample in samples
        if (result := find_result(sample.results, FORCE_LIMIT)) and result.value is not None
    }
    results = fractions.values()
    values = np.array([result.value for result in results if result.value is not None])
    n = len(values)
    mean = float(values.mean()) if n else np.nan
    deviation = float(values.std(ddof=1)) if n >= MIN_SAMPLES else np.nan
    has_scatter = deviation > 0.0
    factor = compute_tolerance_factor(n, coverage, confidence) if n >= MIN_SAMPLES else np.nan
    n_needed = count_samples_to_pass(mean, deviation, coverage, confidence) if has_scatter else None
    lot = Lot(
        answer=Answer.CANNOT_TELL,
        limit=limits.pop() if len(limits) == 1 else None,
        verdicts={test: judge_sample(fraction) for test, fraction in fractions.items()},
        coverage=coverage,
        confidence=confidence,
        n=n,
        mean=mean,
        deviation=deviation,
        minimum=float(values.min()) if n else np.nan,
        tolerance_bound=mean - factor * deviation,
        cpk=(mean - 1.0) / (3.0 * deviation) if has_scatter else np.nan,
        n_needed=n_needed,
    )
    return _add_answer(lot, fractions, limits)


def _add_answer(lot: Lot, fractions: Mapping[str, Result], limits: Collection[float | None]) -> Lot:
    """Add the answer and its reasons to a lot.

    Parameters
    ----------
    lot : lot with its verdicts and numbers
    fractions : result of each test, keyed by test: peak force divided by the limit
    limits : distinct limits of the tests, N
    """
    is_ok = {test: fraction.status is Status.OK for test, fraction in fractions.items()}
    verdicts = lot.verdicts.items()
    failing_tests = [test for test, verdict in verdicts if verdict.value_answer is Answer.FAIL]
    certain_failures = [test for test in failing_tests if is_ok[test]]
    unknown_tests = [test for test, fraction in fractions.items() if fraction.value is None]
    unknown_tests += [test for test in failing_tests if not is_ok[test]]
    answer = Answer.CANNOT_TELL
    if certain_failures:
        answer, tests = Answer.FAIL, ", ".join(certain_failures)
        reason = Reason.of("statistics.lot_sample_fails", tests=tests)
    elif len(limits) > 1:
        reason = Reason.of("statistics.lot_limits_differ")
    elif unknown_tests:
        reason = Reason.of("statistics.lot_sample_unknown", tests=", ".join(unknown_tests))
    elif lot.n < MIN_SAMPLES:
        reason = Reason.of("statistics.lot_of_one")
    else:
        answer, reason = _judge_scatter(lot)
    doubtful_tests = [test for test in fractions if not is_ok[test] and test not in unknown_tests]
    caveat = Reason.of("statistics.lot_doubtful", tests=", ".join(doubtful_tests))
    return replace(lot, answer=answer, reasons=(reason, caveat) if doubtful_tests else (reason,))


def _judge_scatter(lot: Lot) -> tuple[Answer, Reason]:
    """Judge a lot of which all samples pass, by its tolerance bounds."""
    bound, coverage = lot.format_fraction(lot.tolerance_bound), format_percent(lot.coverage)
    requirements = {"coverage": coverage, "confidence": format_percent(lot.confidence)}
    if lot.tolerance_bound >= 1.0:
        return Answer.PASS, Reason.of("statistics.lot_passes", bound=bound, **requirements)
    upper_factor = compute_tolerance_factor(lot.n, lot.coverage, 1.0 - lot.confidence)
    if lot.mean - upper_factor * lot.deviation < 1.0:
        return Answer.FAIL, Reason.of("statistics.lot_fails", **requirements)
    bound_facts = {"bound": bound, "coverage": coverage}
    if lot.n_needed is None:
        return Answer.CANNOT_TELL, Reason.of("statistics.lot_never_passes", **bound_facts)
    needed = lot.n_needed
    return Answer.CANNOT_TELL, Reason.of("statistics.lot_needs_more", **bound_facts, needed=needed)


def format_percent(fraction: float) -> str:
    """Format a fraction as a percentage, such as ``99.9 %``."""
    return f"{100.0 * fraction:.6g} %"
