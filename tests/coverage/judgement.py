"""Which intervals hold too seldom: exact binomial chances, judged together after Holm (1979)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.stats import binom

Row = dict[str, Any]
"""As `study` keeps them, and of their results."""
STATED = 0.95
LEAST = 20
"""Results that are `ok` in fewer tests are not judged."""
ENOUGH, MANY = 0.9, 100
"""A result fails below this share of so many; in fewer that is chance too often."""
LEVEL = 0.01
"""Of the family, at which a result fails that holds significantly below `STATED`."""
WIDE = 0.99
POOLED = (0.93, 0.98)
"""All results of a kind together."""


class Verdict(StrEnum):
    """On a result, or on all of a kind."""

    HOLDS = ""
    SELDOM = "too seldom"
    WIDE = "wide"
    FEW = "few"


@dataclass(frozen=True, slots=True)
class Held:
    """How often something held, of how often it was asked."""

    held: int
    asked: int

    @classmethod
    def of(cls, rows: Iterable[Row]) -> Held:
        """Intervals of results."""
        held = [holds(row) for row in rows]
        return cls(sum(held), len(held))

    def __add__(self, other: Held) -> Held:
        return Held(self.held + other.held, self.asked + other.asked)

    @property
    def share(self) -> float:
        """NaN if it was never asked."""
        return self.held / self.asked if self.asked else float("nan")

    @property
    def percent(self) -> str:
        """Empty if it was never asked."""
        return f"{100.0 * self.share:.1f} %" if self.asked else ""

    @property
    def chance(self) -> float:
        """Of so few, if each held in `STATED` of all cases."""
        return float(binom.cdf(self.held, self.asked, STATED))

    def __str__(self) -> str:
        return f"{self.held} of {self.asked}" if self.asked else ""


@dataclass(frozen=True, slots=True)
class Count:
    """How a result fared in the tests without a fault.

    Parameters
    ----------
    kind, name : of which test, which result
    ok, doubtful : intervals of results of that status
    failed : how many results
    width : median half width over 1.96 standard deviations of the estimate in tests with the same
        kind of noise; 1 is ideal
    """

    kind: str
    name: str
    ok: Held
    doubtful: Held
    failed: int
    width: float


def holds(row: Row) -> bool:
    """Whether an interval, or a part of it, holds its truth; one that is not there does not."""
    parts = row.get("parts", [[row.get("lower"), row.get("upper")]])
    return any(None not in part and part[0] <= row["truth"] <= part[1] for part in parts)


def is_empty(row: Row) -> bool:
    """Whether a result that is `ok` has no interval, or one of no width."""
    is_wide = row.get("lower") is not None and row["lower"] < row["upper"]
    return row["status"] == "ok" and not is_wide


def counted(rows: Iterable[Row]) -> list[Count]:
    """Counts by kind and result of tests, in their order."""
    found: dict[tuple[str, str], list[tuple[str, Row]]] = {}
    for row in rows:
        for result in row["rows"] if not row["about"].get("fault") else ():
            noise = row["about"].get("noise", "")
            found.setdefault((row["kind"], result["name"]), []).append((noise, result))
    return [_count(*key, results) for key, results in found.items()]


def _count(kind: str, name: str, results: list[tuple[str, Row]]) -> Count:
    ok, doubtful = (
        Held.of(row for _, row in results if row["status"] == status)
        for status in ("ok", "doubtful")
    )
    failed = len(results) - ok.asked - doubtful.asked
    return Count(kind, name, ok, doubtful, failed, _width(results))


def _width(results: list[tuple[str, Row]]) -> float:
    """As `Count` says; NaN where no kind of noise has five tests."""
    ratios: list[float] = []
    for noise in {noise for noise, _ in results}:
        ok = [row for each, row in results if each == noise and row["status"] == "ok"]
        ok = [row for row in ok if row.get("lower") is not None]
        if len(ok) >= 5:
            off = np.array([_middle(row) - row["truth"] for row in ok])
            half = np.array([0.5 * (row["upper"] - row["lower"]) for row in ok])
            scatter = 1.96 * float(off.std(ddof=1))
            ratios += (half / scatter if scatter > 0.0 else np.full(len(ok), np.inf)).tolist()
    return float(np.median(ratios)) if ratios else float("nan")


def _middle(row: Row) -> float:
    """What the interval lies around."""
    estimate = row.get("estimate")
    return float(row["value"] if estimate is None else estimate)


def holm(chances: Sequence[float], level: float) -> list[bool]:
    """Which hypotheses are rejected if no true one may be, but once in 1/level families.

    Parameters
    ----------
    chances : of each hypothesis
    level : of the family

    Notes
    -----
    Holm (1979): from the smallest chance on, each is compared with the level over the number of
    those that are left; the first that is larger ends it.
    """
    rejected = [False] * len(chances)
    for left, place in zip(range(len(chances), 0, -1), np.argsort(chances), strict=True):
        if chances[place] > level / left:
            break
        rejected[place] = True
    return rejected


def judged(counts: Sequence[Held]) -> list[Verdict]:
    """On each result, in their order."""
    family = [count for count in counts if count.asked >= LEAST]
    seldom = iter(holm([each.chance for each in family], LEVEL))
    return [_verdict(count, is_seldom=count.asked >= LEAST and next(seldom)) for count in counts]


def _verdict(count: Held, *, is_seldom: bool) -> Verdict:
    if count.asked < LEAST:
        return Verdict.FEW
    if is_seldom or (count.asked >= MANY and count.share < ENOUGH):
        return Verdict.SELDOM
    return Verdict.WIDE if count.share > WIDE else Verdict.HOLDS


def pooled(counts: Iterable[Count]) -> dict[str, tuple[Held, Verdict]]:
    """By kind: all its intervals that are `ok`, and the verdict."""
    sums: dict[str, Held] = {}
    for count in counts:
        sums[count.kind] = sums.get(count.kind, Held(0, 0)) + count.ok
    return {kind: (held, _of_all(held)) for kind, held in sums.items()}


def _of_all(held: Held) -> Verdict:
    if held.asked < LEAST:
        return Verdict.FEW
    if held.share < POOLED[0]:
        return Verdict.SELDOM
    return Verdict.WIDE if held.share > POOLED[1] else Verdict.HOLDS
