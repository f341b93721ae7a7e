"""Chances, Holm's rule and verdicts, against numbers made by hand."""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np
import pytest

from tests.coverage.judgement import Count, Verdict, counted, holm, is_empty, judged, pooled
from tests.coverage.study import Kind

KIND = Kind("foreign", "tensile")


def count(held: int, ok: int, name: str = "slack", kind: Kind = KIND) -> Count:
    return Count(kind, name, ok, 0, 0, held, 0, 1.0)


def row(truth: float, *, half: float = 0.1, value: float = 1.0, **more: Any) -> dict[str, Any]:
    ends = {"lower": value - half, "upper": value + half}
    return {"name": "slack", "status": "ok", "value": value, "truth": truth, **ends, **more}


def line(*rows: dict[str, Any], noise: str = "white", fault: str = "") -> dict[str, Any]:
    about = {"simulator": KIND.simulator, "kind": KIND.name, "noise": noise, "fault": fault}
    return {**about, "rows": list(rows)}


def test_chance_of_so_few() -> None:
    """Of 30, 26 or fewer: one less the chance of 27 and more."""
    more = sum(comb(30, k) * 0.95**k * 0.05 ** (30 - k) for k in range(27, 31))
    assert count(26, 30).chance == pytest.approx(1.0 - more)


def test_holm_by_the_usual_example() -> None:
    """Four hypotheses at 5 %: 0.005 < 0.0125, 0.01 < 0.0167, but 0.03 > 0.025 ends it."""
    assert holm([0.01, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]


def test_holm_rejects_all_where_all_are_small() -> None:
    assert holm([0.016, 0.024, 0.049], 0.05) == [True, True, True]
    assert holm([0.017, 0.001, 0.06], 0.05) == [True, True, False]
    assert holm([], 0.05) == []


def test_nine_of_ten_are_not_enough_alone() -> None:
    """164 of 182 are 90 %, but so few come by chance once in 200 studies of that result alone."""
    assert count(164, 182).chance == pytest.approx(0.00473, abs=1e-5)  # summed with exact numbers
    assert judged([count(163, 182)]) == [Verdict.SELDOM]
    assert judged([count(164, 182)]) == [Verdict.SELDOM]
    assert judged([count(164, 182), *[count(173, 182)] * 50]) == [Verdict.HOLDS] * 51
    assert judged([count(163, 182), *[count(173, 182)] * 50])[0] is Verdict.SELDOM


def test_too_few_for_nine_of_ten() -> None:
    """88 of 99 come by chance once in 93 studies of that result alone."""
    assert judged([count(88, 99), *[count(95, 99)] * 50]) == [Verdict.HOLDS] * 51
    assert judged([count(89, 100), *[count(95, 100)] * 50])[0] is Verdict.SELDOM


def test_wide_and_few() -> None:
    assert judged([count(182, 182), count(180, 182)]) == [Verdict.WIDE, Verdict.HOLDS]
    assert judged([count(5, 19)]) == [Verdict.FEW]


def test_all_of_a_kind_together() -> None:
    other = Kind("lab", "tensile")
    found = pooled([count(180, 200), count(190, 200), count(100, 100, kind=other)])
    assert found == {KIND: (370, 400, Verdict.SELDOM), other: (100, 100, Verdict.WIDE)}


def test_what_is_counted() -> None:
    doubtful, failed = row(1.05, status="doubtful"), row(1.0, status="failed")
    lines = [line(row(1.05)), line(row(1.2)), line(doubtful), line(failed)]
    lines += [line(row(1.2), fault="slip"), line({**row(1.0), "lower": None, "upper": None})]
    (found,) = counted(lines)
    assert (found.ok, found.doubtful, found.failed) == (3, 1, 1)
    assert (found.held, found.doubtful_held) == (1, 1)


def test_width_is_that_of_the_same_noise() -> None:
    """Errors of 1 and 10 in two noises, intervals of twice the ideal in each."""
    random = np.random.default_rng(3)
    lines = []
    for noise, size in (("white", 1.0), ("pink", 10.0)):
        for off in size * random.standard_normal(4000):
            made = row(0.0, half=2.0 * 1.96 * size, value=9.0, estimate=float(off))
            lines.append(line(made, noise=noise))
    assert counted(lines)[0].width == pytest.approx(2.0, rel=0.03)


def test_intervals_without_width() -> None:
    assert is_empty(row(1.0, half=0.0))
    assert is_empty({**row(1.0), "lower": None})
    assert is_empty(row(1.0, half=float("nan")))
    assert not is_empty(row(1.0))
