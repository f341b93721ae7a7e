"""Chances, Holm's rule and verdicts, against numbers made by hand."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np
import pytest

from tests.coverage.judgement import (
    Count,
    Held,
    Verdict,
    counted,
    holds,
    holm,
    is_empty,
    judged,
    pooled,
)

KIND = "foreign/tensile"


def result(truth: float, *, half: float = 0.1, value: float = 1.0, **more: Any) -> dict[str, Any]:
    ends = {"lower": value - half, "upper": value + half}
    return {"name": "slack", "status": "ok", "value": value, "truth": truth, **ends, **more}


def row(*results: dict[str, Any], noise: str = "white", fault: str = "") -> dict[str, Any]:
    return {"kind": KIND, "about": {"noise": noise, "fault": fault}, "rows": list(results)}


def test_chance_of_so_few() -> None:
    """Of 30, 26 or fewer: one less the chance of 27 and more."""
    more = sum(comb(30, k) * 0.95**k * 0.05 ** (30 - k) for k in range(27, 31))
    assert Held(26, 30).chance == pytest.approx(1.0 - more)


def test_holm_by_the_usual_example() -> None:
    """Four hypotheses at 5 %: 0.005 < 0.0125, 0.01 < 0.0167, but 0.03 > 0.025 ends it."""
    assert holm([0.01, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]


def test_holm_rejects_all_where_all_are_small() -> None:
    assert holm([0.016, 0.024, 0.049], 0.05) == [True, True, True]
    assert holm([0.017, 0.001, 0.06], 0.05) == [True, True, False]
    assert holm([], 0.05) == []


def test_nine_of_ten_are_not_enough_alone() -> None:
    """164 of 182 are 90 %, but so few come by chance once in 200 studies of that result alone."""
    assert Held(164, 182).chance == pytest.approx(0.00473, abs=1e-5)  # summed with exact numbers
    assert judged([Held(163, 182)]) == [Verdict.SELDOM]
    assert judged([Held(164, 182)]) == [Verdict.SELDOM]
    assert judged([Held(164, 182), *[Held(173, 182)] * 50]) == [Verdict.HOLDS] * 51
    assert judged([Held(163, 182), *[Held(173, 182)] * 50])[0] is Verdict.SELDOM


def test_too_few_for_nine_of_ten() -> None:
    """88 of 99 come by chance once in 93 studies of that result alone."""
    assert judged([Held(88, 99), *[Held(95, 99)] * 50]) == [Verdict.HOLDS] * 51
    assert judged([Held(89, 100), *[Held(95, 100)] * 50])[0] is Verdict.SELDOM


def test_wide_and_few() -> None:
    assert judged([Held(182, 182), Held(180, 182)]) == [Verdict.WIDE, Verdict.HOLDS]
    assert judged([Held(5, 19)]) == [Verdict.FEW]


def test_all_of_a_kind_together() -> None:
    counts = [
        Count(kind, "slack", Held(held, asked), Held(0, 0), 0, 1.0)
        for kind, held, asked in ((KIND, 180, 200), (KIND, 190, 200), ("lab/tensile", 100, 100))
    ]
    assert pooled(counts) == {
        KIND: (Held(370, 400), Verdict.SELDOM),
        "lab/tensile": (Held(100, 100), Verdict.WIDE),
    }


def test_what_is_counted() -> None:
    doubtful, failed = result(1.05, status="doubtful"), result(1.0, status="failed")
    rows = [row(result(1.05)), row(result(1.2)), row(doubtful), row(failed)]
    rows += [row(result(1.2), fault="slip"), row({**result(1.0), "lower": None, "upper": None})]
    (found,) = counted(rows)
    assert (found.ok, found.doubtful, found.failed) == (Held(1, 3), Held(1, 1), 1)


def test_width_is_that_of_the_same_noise() -> None:
    """Errors of 1 and 10 in two noises, intervals of twice the ideal in each."""
    random = np.random.default_rng(3)
    rows = []
    for noise, size in (("white", 1.0), ("pink", 10.0)):
        for off in size * random.standard_normal(4000):
            made = result(0.0, half=2.0 * 1.96 * size, value=9.0, estimate=float(off))
            rows.append(row(made, noise=noise))
    assert counted(rows)[0].width == pytest.approx(2.0, rel=0.03)


def test_intervals_without_width() -> None:
    assert is_empty(result(1.0, half=0.0))
    assert is_empty({**result(1.0), "lower": None})
    assert is_empty(result(1.0, half=float("nan")))
    assert not is_empty(result(1.0))


def test_any_part_of_an_interval_may_hold_the_truth() -> None:
    parts = [[0.5, 0.9], [3.0, 4.0]]
    assert holds(result(3.5, parts=parts))
    assert not holds(result(1.0, parts=parts))
