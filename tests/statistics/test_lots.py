"""Verdicts on samples and lots: tolerance factors, answers, and samples that would pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import integrate, stats

from labpipe.records.curve import Interval
from labpipe.records.group import Lot, Sample
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Specimen, Status
from labpipe.statistics.lots import (
    FORCE_LIMIT,
    MAX_SAMPLES,
    PEAK_OVER_LIMIT,
    compute_tolerance_factor,
    count_samples_to_pass,
    judge_lot,
    judge_sample,
)

RULE = {"coverage": 0.99, "confidence": 0.95}
PUBLISHED = [
    (10, 0.90, 0.95, 2.355),
    (5, 0.90, 0.95, 3.407),
    (10, 0.99, 0.95, 3.981),
    (20, 0.95, 0.95, 2.396),
]


@pytest.mark.parametrize(("n", "coverage", "confidence", "factor"), PUBLISHED)
def test_factors_are_those_of_the_tables(
    n: int, coverage: float, confidence: float, factor: float
) -> None:
    """ISO 16269-6 and the NIST handbook print them with four digits."""
    assert round(compute_tolerance_factor(n, coverage, confidence), 3) == factor


@pytest.mark.parametrize("n", [2, 3, 7, 30, 1000])
@pytest.mark.parametrize(("coverage", "confidence"), [(0.99, 0.95), (0.9, 0.5), (0.99, 0.05)])
def test_a_bound_holds_with_its_confidence(n: int, coverage: float, confidence: float) -> None:
    """Integrated over the distribution of s, without the noncentral t distribution."""
    factor, z = compute_tolerance_factor(n, coverage, confidence), stats.norm.ppf(coverage)
    spread = stats.chi(n - 1)

    def holds(chi: float) -> float:
        bound = np.sqrt(n) * (factor * chi / np.sqrt(n - 1) - z)
        return float(stats.norm.cdf(bound) * spread.pdf(chi))

    middle = np.sqrt(n - 1)
    probability, _ = integrate.quad(holds, max(middle - 8.0, 0.0), middle + 8.0, limit=400)
    assert probability == pytest.approx(confidence, abs=1e-6)


def share(value: float | None, half: float = 0.01, *, is_doubtful: bool = False) -> Result:
    if value is None:
        why = (Reason("no_conductor", "none"),)
        return Result(PEAK_OVER_LIMIT, None, "1", status=Status.FAILED, reasons=why)
    reasons = (Reason("question_open", "none"),) if is_doubtful else ()
    status = Status.DOUBTFUL if is_doubtful else Status.OK
    ends = Interval(value - half, value + half)
    return Result(PEAK_OVER_LIMIT, value, "1", ends, status, reasons)


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (share(1.2), "pass"),
        (share(1.0, 0.0), "pass"),
        (share(1.005), "pass (cannot tell with its interval)"),
        (share(0.995), "fail (cannot tell with its interval)"),
        (share(0.9), "fail"),
        (share(1.2, is_doubtful=True), "pass (cannot tell with its interval)"),
        (share(None), "cannot tell"),
    ],
)
def test_a_sample_is_judged_by_its_number_and_with_its_interval(result: Result, text: str) -> None:
    assert judge_sample(result).text == text


def lot_of(shares: Sequence[Result], limits: Sequence[float] = (89.0,)) -> Lot:
    samples = [
        Sample(f"c-{number}", Specimen("c", "r", str(number)), "crimp-pull", (), (), (
            share_result, Result(FORCE_LIMIT, limits[number % len(limits)], "N")
        ))
        for number, share_result in enumerate(shares)
    ]  # fmt: skip
    lot = judge_lot(samples, **RULE)
    assert lot is not None
    return lot


def spread(mean: float, deviation: float, n: int) -> list[Result]:
    """Shares with exactly this mean and standard deviation."""
    values = np.linspace(-1.0, 1.0, n)
    return [share(float(mean + deviation * x)) for x in values / values.std(ddof=1)]


@pytest.mark.parametrize(
    ("shares", "answer", "said"),
    [
        ([share(1.5)], "cannot tell", "one sample"),
        ([share(0.9)], "fail", "below the limit: c-0"),
        (spread(1.5, 0.01, 2), "pass", "99 % of the lot reaches 100.5 N"),
        (spread(1.5, 0.02, 2), "cannot tell", "3 samples"),
        (spread(1.5, 0.04, 3), "pass", "95 % confidence"),
        (spread(1.5, 0.1, 7), "pass", "all samples"),
        (spread(1.3, 0.1, 7), "cannot tell", "35 samples"),
        (spread(1.2, 0.1, 7), "cannot tell", "no number of samples"),
        ([share(1.02)] * 25 + [share(1.5)] * 5, "fail", "less than 99 %"),
        ([*spread(1.5, 0.1, 7), share(0.98)], "fail", "c-7"),
        ([*spread(1.5, 0.1, 7), share(0.98, is_doubtful=True)], "cannot tell", "no verdict on c-7"),
        ([*spread(1.5, 0.1, 7), share(None)], "cannot tell", "no verdict on c-7"),
        ([*spread(1.5, 0.05, 7), share(1.5, is_doubtful=True)], "pass", "doubtful: c-7"),
        ([share(1.5)] * 3, "pass", "133.5 N"),
    ],
)
def test_answers_of_lots(shares: list[Result], answer: str, said: str) -> None:
    lot = lot_of(shares)
    assert str(lot.answer) == answer
    assert said in "; ".join(reason.message for reason in lot.reasons)


def test_numbers_of_a_lot() -> None:
    lot = lot_of(spread(1.3, 0.1, 7))
    assert lot.cpk == pytest.approx(1.0)
    assert lot.limit == 89.0
    assert lot.tolerance_bound == pytest.approx(1.3 - 4.642 * 0.1, abs=1e-4)
    assert lot.n_needed is not None
    factors = [compute_tolerance_factor(lot.n_needed - k, 0.99, 0.95) for k in (0, 1)]
    assert factors[0] <= 3.0 < factors[1]


def test_samples_with_several_limits_have_no_answer() -> None:
    lot = lot_of(spread(1.5, 0.1, 7), (89.0, 53.4))
    assert str(lot.answer) == "cannot tell"
    assert lot.limit is None
    assert judge_lot([], **RULE) is None


def test_the_search_for_a_number_of_samples_ends_at_its_limit() -> None:
    for n, wanted in ((MAX_SAMPLES, MAX_SAMPLES), (MAX_SAMPLES + 20_000, None)):
        factor = compute_tolerance_factor(n, **RULE)
        assert count_samples_to_pass(1.0 + factor * (1.0 + 1e-12), 1.0, **RULE) == wanted
