"""Whether bands of lines say too much: counts by number asked, judged together after Holm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.coverage.judgement import ENOUGH, LEVEL, holm
from tests.coverage.rests_on import ROOT
from tests.coverage.wire_judgement import Held
from tests.line_coverage.drawn_lines import KINDS

PAGE = ROOT / "docs" / "explanations" / "rod-bands.md"
BEGIN, END = "<!-- lines: begin -->", "<!-- lines: end -->"
DRAWS = "<!-- draws: begin -->", "<!-- draws: end -->"
SECOND = "<!-- second: begin -->", "<!-- second: end -->"
ASKED = ("shape", "moment", "bend radius", "shape on the way back")
"""Numbers of a line, one of each sort, chosen with the line before it is made."""

Line = dict[str, Any]


def is_held(row: Line) -> bool:
    """Whether a band has its truth."""
    return bool(row["lower"] <= row["truth"] <= row["upper"])


def predicted(lines: Sequence[Line], *, doubtful: bool = False) -> list[Line]:
    """Lines with bands that nothing makes doubtful, or those that something does."""
    return [line for line in lines if line.get("rows") and bool(line["notes"]) is doubtful]


def counted(lines: Sequence[Line], name: str, kind: str | None = None) -> Held:
    """How often the band of a number holds; of one kind, or of all."""
    own = [line for line in lines if kind in (None, line["kind"])]
    held = [is_held(row) for line in own for row in line["rows"] if row["name"] == name]
    return Held(sum(held), len(held))


def judged(lines: Sequence[Line]) -> dict[str, bool]:
    """By number asked: whether its bands hold too seldom, over all kinds.

    Significantly less often than in 95 % (Holm, one family of all numbers), or in less than 90 %.
    """
    counts = {name: counted(lines, name) for name in ASKED}
    seldom = holm([each.chance for each in counts.values()], LEVEL)
    return {
        name: is_seldom or held.share < ENOUGH
        for (name, held), is_seldom in zip(counts.items(), seldom, strict=True)
    }


def tables(lines: Sequence[Line], rests_on: str, missing: int) -> str:
    """Everything that was counted, in markdown."""
    return "\n".join([*_summary(lines, rests_on, missing), "", *_table(lines), "", *_shares(lines)])


def _summary(lines: Sequence[Line], rests_on: str, missing: int) -> Iterator[str]:
    commits = ", ".join(f"`{name}`" for name in dict.fromkeys(line["commit"] for line in lines))
    minutes = sum(line["seconds"] for line in lines) / 60.0
    left = f"; {missing} are still to be made" if missing else ""
    yield (
        f"{len(lines)} lines{left}, made by {commits or 'nothing yet'} in {minutes:.0f} min CPU;"
        f" holds while what the numbers rest on is unchanged (`{rests_on}`:"
        " `tests/line_coverage/predicted_lines.py` with all that it imports)."
    )
    yield ""
    sure, doubtful = predicted(lines), predicted(lines, doubtful=True)
    codes = Counter(code for line in doubtful for code in dict.fromkeys(line["notes"]))
    why = ", ".join(f"{number} x `{code}`" for code, number in codes.most_common())
    errors = sum(bool(line["error"]) for line in lines)
    failed = sum("failed" in line for line in lines)
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


def _table(lines: Sequence[Line]) -> Iterator[str]:
    sure, doubtful = predicted(lines), predicted(lines, doubtful=True)
    yield _row("lines", "n", *ASKED)
    yield "|---|" + "---:|" * (len(ASKED) + 1)
    for kind in KINDS:
        own = [line for line in sure if line["kind"] == kind.name]
        yield _row(kind.name, len(own), *(counted(own, name) for name in ASKED))
    marks = judged(sure)
    every = {name: counted(sure, name) for name in ASKED}
    shown = (
        f"**{held}** ({100.0 * held.share:.1f} %)" if marks[name] else _percent(held)
        for name, held in every.items()
    )
    yield _row("**all**", len(sure), *shown)
    yield _row("doubtful", len(doubtful), *(counted(doubtful, name) for name in ASKED))


def _percent(held: Held) -> str:
    return f"{held} ({100.0 * held.share:.1f} %)" if held.asked else ""


def _shares(lines: Sequence[Line]) -> Iterator[str]:
    sure = predicted(lines)
    if not sure:
        return
    inside = np.array([[line["inside"][name] for name in (ASKED[0], ASKED[3])] for line in sure])
    (here, back), (all_here, all_back) = 100.0 * inside.mean(0), 100.0 * (inside == 1.0).mean(0)
    yield (
        f"Of all nodes and components of a line, {here:.0f} % lie inside ({back:.0f} % on the way"
        f" back), and all of them together in {all_here:.0f} % of the lines ({all_back:.0f} %):"
        " the bands are pointwise."
    )
    yield ""
    causes: dict[str, float] = {}
    for line in sure:
        for cause, share in line["shares"].items():
            causes[cause] = causes.get(cause, 0.0) + 100.0 * share / len(sure)
    means = sorted(causes.items(), key=lambda each: each[1], reverse=True)
    said = ", ".join(f"{name} {share:.0f} %" for name, share in means)
    yield (
        "What the band of the smallest bend radius comes from, mean share of the variance of the"
        f" curvature: {said}."
    )


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def publish(lines: Sequence[Line], rests_on: str, missing: int, page: Path = PAGE) -> None:
    """Put the tables between their marks on the page."""
    put(tables(lines, rests_on, missing), (BEGIN, END), page)


def put(text: str, marks: tuple[str, str], page: Path = PAGE) -> None:
    """Put words between marks on the page."""
    begin, end = marks
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    after = rest.partition(end)[2]
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")
