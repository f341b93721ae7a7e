"""Which intervals hold too seldom: exact binomial chances, judged together after Holm (1979)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.stats import binom

from tests.coverage.study import KINDS, Kind, Line

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
class Count:
    """How a result fared in the tests without a fault.

    Parameters
    ----------
    kind, name : of which test, which result
    ok, doubtful, failed : in how many tests
    held, doubtful_held : of the first two, those whose interval holds the truth
    width : median half width over 1.96 standard deviations of the estimate in tests with the same
        kind of noise; 1 is ideal
    """

    kind: Kind
    name: str
    ok: int
    doubtful: int
    failed: int
    held: int
    doubtful_held: int
    width: float

    @property
    def share(self) -> float:
        """Of the `ok` ones that hold; NaN if there are none."""
        return self.held / self.ok if self.ok else float("nan")

    @property
    def chance(self) -> float:
        """Of so few, if each of them held in `STATED` of all tests."""
        return float(binom.cdf(self.held, self.ok, STATED))


def holds(row: Line) -> bool:
    """Whether an interval holds its truth; one that is not there does not."""
    ends = row["lower"], row["upper"]
    return None not in ends and bool(ends[0] <= row["truth"] <= ends[1])


def is_empty(row: Line) -> bool:
    """Whether a result that is `ok` has no interval, or one of no width."""
    ends = row["lower"], row["upper"]
    return row["status"] == "ok" and (None in ends or not ends[0] < ends[1])


def counted(lines: Iterable[Line]) -> list[Count]:
    """Counts by kind and result, in the order of the kinds."""
    rows: dict[tuple[Kind, str], list[tuple[str, Line]]] = {}
    for line in lines:
        for row in line["rows"] if not line["fault"] else ():
            key = Kind(line["simulator"], line["kind"]), row["name"]
            rows.setdefault(key, []).append((line["noise"], row))
    order = sorted(rows, key=lambda key: KINDS.index(key[0]))
    return [_count(*key, rows[key]) for key in order]


def _count(kind: Kind, name: str, rows: list[tuple[str, Line]]) -> Count:
    ok = [row for _, row in rows if row["status"] == "ok"]
    doubtful = [row for _, row in rows if row["status"] == "doubtful"]
    return Count(
        kind=kind,
        name=name,
        ok=len(ok),
        doubtful=len(doubtful),
        failed=len(rows) - len(ok) - len(doubtful),
        held=sum(map(holds, ok)),
        doubtful_held=sum(map(holds, doubtful)),
        width=_width(rows),
    )


def _width(rows: list[tuple[str, Line]]) -> float:
    """As `Count` says; NaN where no kind of noise has five tests."""
    ratios: list[float] = []
    for noise in {noise for noise, _ in rows}:
        ok = [row for each, row in rows if each == noise and row["status"] == "ok"]
        ok = [row for row in ok if row["lower"] is not None]
        if len(ok) >= 5:
            off = np.array([_middle(row) - row["truth"] for row in ok])
            half = np.array([0.5 * (row["upper"] - row["lower"]) for row in ok])
            scatter = 1.96 * float(off.std(ddof=1))
            ratios += (half / scatter if scatter > 0.0 else np.full(len(ok), np.inf)).tolist()
    return float(np.median(ratios)) if ratios else float("nan")


def _middle(row: Line) -> float:
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


def judged(counts: Sequence[Count]) -> list[Verdict]:
    """On each result, in their order."""
    family = [each for each in counts if each.ok >= LEAST]
    seldom = dict(zip(map(id, family), holm([each.chance for each in family], LEVEL), strict=True))
    return [_verdict(each, is_seldom=seldom.get(id(each), False)) for each in counts]


def _verdict(count: Count, *, is_seldom: bool) -> Verdict:
    if count.ok < LEAST:
        return Verdict.FEW
    if is_seldom or (count.ok >= MANY and count.share < ENOUGH):
        return Verdict.SELDOM
    return Verdict.WIDE if count.share > WIDE else Verdict.HOLDS


def pooled(counts: Iterable[Count]) -> dict[Kind, tuple[int, int, Verdict]]:
    """By kind: how many of all its intervals hold, of how many, and the verdict."""
    sums: dict[Kind, tuple[int, int]] = {}
    for each in counts:
        held, ok = sums.get(each.kind, (0, 0))
        sums[each.kind] = held + each.held, ok + each.ok
    return {kind: (held, ok, _of_all(held, ok)) for kind, (held, ok) in sums.items()}


def _of_all(held: int, ok: int) -> Verdict:
    if ok < LEAST:
        return Verdict.FEW
    share = held / ok
    if share < POOLED[0]:
        return Verdict.SELDOM
    return Verdict.WIDE if share > POOLED[1] else Verdict.HOLDS
