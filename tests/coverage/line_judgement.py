"""Whether bands of lines say too much: counts by number asked, judged together after Holm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from tests.coverage.drawn_lines import KINDS
from tests.coverage.judgement import ENOUGH, LEVEL, Held, Row, holm
from tests.coverage.page import table

ASKED = ("shape", "moment", "bend radius", "shape on the way back")
"""Numbers of a line, one of each sort, chosen with the line before it is made."""


def predicted(rows: Sequence[Row], *, doubtful: bool = False) -> list[Row]:
    """Lines with bands that nothing makes doubtful, or those that something does."""
    return [row for row in rows if row["rows"] and bool(row["about"]["notes"]) is doubtful]


def counted(rows: Sequence[Row], name: str) -> Held:
    """How often the band of a number holds."""
    return Held.of(cell for row in rows for cell in row["rows"] if cell["name"] == name)


def judged(rows: Sequence[Row]) -> dict[str, bool]:
    """By number asked: whether its bands hold too seldom, over all kinds.

    Significantly less often than in 95 % (Holm, one family of all numbers), or in less than 90 %.
    """
    counts = {name: counted(rows, name) for name in ASKED}
    seldom = holm([count.chance for count in counts.values()], LEVEL)
    return {
        name: is_seldom or held.share < ENOUGH
        for (name, held), is_seldom in zip(counts.items(), seldom, strict=True)
    }


def tables(rows: Sequence[Row]) -> str:
    """Everything that was counted, in markdown."""
    return "\n".join([*_summary(rows), "", *_table(rows), "", *_shares(rows)])


def _summary(rows: Sequence[Row]) -> Iterator[str]:
    sure, doubtful = predicted(rows), predicted(rows, doubtful=True)
    codes = Counter(code for row in doubtful for code in dict.fromkeys(row["about"]["notes"]))
    why = ", ".join(f"{number} x `{code}`" for code, number in codes.most_common())
    errors = sum(bool(row["error"]) for row in rows)
    failed = sum("failed" in row["about"] for row in rows)
    yield (
        f"{len(sure)} lines have bands that nothing makes doubtful, {len(doubtful)} have doubtful"
        f" ones ({why or 'none'}), {failed} failed, {errors} ended in an error."
    )
    yield ""
    seldom = [name for name, is_seldom in judged(sure).items() if is_seldom]
    said = "too seldom: " + ", ".join(seldom) if seldom else "none of the four holds too seldom"
    yield (
        "By the rule (at least 90 %, and not significantly less often than in 95 %, exact binomial,"
        f" Holm at 1 %) {said}."
    )


def _table(rows: Sequence[Row]) -> Iterator[str]:
    sure, doubtful = predicted(rows), predicted(rows, doubtful=True)
    every = {name: counted(sure, name) for name in ASKED}
    shown = (
        f"**{every[name]}** ({every[name].percent})" if seldom else _percent(every[name])
        for name, seldom in judged(sure).items()
    )
    own = {kind.name: [row for row in sure if row["kind"] == kind.name] for kind in KINDS}
    lines = [
        *(_counts(name, each) for name, each in own.items()),
        ("**all**", len(sure), *shown),
        _counts("doubtful", doubtful),
    ]
    return table("l" + "r" * (len(ASKED) + 1), ("lines", "n", *ASKED), lines)


def _counts(name: str, rows: Sequence[Row]) -> tuple[object, ...]:
    return name, len(rows), *(counted(rows, asked) for asked in ASKED)


def _percent(held: Held) -> str:
    return f"{held} ({held.percent})" if held.asked else ""


def _shares(rows: Sequence[Row]) -> Iterator[str]:
    sure = [row["about"] for row in predicted(rows)]
    if not sure:
        return
    inside = np.array([[about["inside"][name] for name in (ASKED[0], ASKED[3])] for about in sure])
    (here, back), (all_here, all_back) = 100.0 * inside.mean(0), 100.0 * (inside == 1.0).mean(0)
    yield (
        f"Of all nodes and components of a line, {here:.0f} % lie inside ({back:.0f} % on the way"
        f" back), and all of them together in {all_here:.0f} % of the lines ({all_back:.0f} %):"
        " the bands are pointwise."
    )
    yield ""
    causes: dict[str, float] = {}
    for about in sure:
        for cause, share in about["shares"].items():
            causes[cause] = causes.get(cause, 0.0) + 100.0 * share / len(sure)
    means = sorted(causes.items(), key=lambda cause: cause[1], reverse=True)
    said = ", ".join(f"{name} {share:.0f} %" for name, share in means)
    yield (
        "What the band of the smallest bend radius comes from, mean share of the variance of the"
        f" curvature: {said}."
    )
