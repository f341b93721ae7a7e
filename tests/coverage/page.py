"""The page of the study: docs/explanations/coverage.md, with what was counted between marks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from tests.coverage.judgement import Count, Verdict, counted, holds, is_empty, judged, pooled
from tests.coverage.rests_on import ROOT
from tests.coverage.study import KINDS, SEEDS, Kind, Line, rests_on
from tests.judges.foreign.noise import KINDS as NOISES

PAGE = ROOT / "docs" / "explanations" / "coverage.md"
BEGIN, END = "<!-- counted: begin -->", "<!-- counted: end -->"
TITLES = {"foreign": "Second simulator", "lab": "Virtual lab"}


def by_noise(lines: Iterable[Line]) -> dict[tuple[Kind, str], tuple[int, int]]:
    """By kind of test and of noise: intervals that hold, of the `ok` ones without a fault."""
    found: dict[tuple[Kind, str], tuple[int, int]] = {}
    for line in lines:
        for row in line["rows"] if not line["fault"] else ():
            if row["status"] == "ok":
                key = Kind(line["simulator"], line["kind"]), line["noise"]
                held, n = found.get(key, (0, 0))
                found[key] = held + holds(row), n + 1
    return found


def by_fault(lines: Iterable[Line]) -> dict[tuple[str, str], tuple[int, int, int]]:
    """By kind of test and fault: tests, results that are `ok`, and of these those that are wrong.

    Wrong is farther off than 2 % and than three half widths; where a crosshead counts down,
    whatever the sign.
    """
    found: dict[tuple[str, str], tuple[int, int, int]] = {}
    for line in lines:
        if line["fault"]:
            key = line["kind"], line["fault"]
            tests, n, wrong = found.get(key, (0, 0, 0))
            ok = [row for row in line["rows"] if row["status"] == "ok"]
            wrong += sum(_wrong(row, line["fault"]) for row in ok)
            found[key] = tests + 1, n + len(ok), wrong
    return found


def _wrong(row: Line, fault: str) -> bool:
    if row["lower"] is None:
        return False
    plain = abs if fault == "counts-down" else float
    half, off = 0.5 * (row["upper"] - row["lower"]), plain(row["value"]) - plain(row["truth"])
    return bool(abs(off) > max(3.0 * half, 0.02 * abs(row["truth"])))


def tables(lines: Sequence[Line]) -> str:
    """Everything that was counted, in markdown."""
    counts = counted(lines)
    parts = [_summary(lines, counts)]
    for simulator, title in TITLES.items():
        parts += ["", f"### {title}", "", *_pooled(counts, simulator), ""]
        parts += _results(counts, simulator)
    parts += ["", "### Kinds of noise", "", *_noises(lines)]
    parts += ["", "### Faults of the rig", "", *_faults(lines)]
    return "\n".join(parts)


def _summary(lines: Sequence[Line], counts: list[Count]) -> str:
    sound = [row for line in lines if not line["fault"] for row in line["rows"]]
    sound = [row for row in sound if row["status"] == "ok"]
    verdicts = Counter(judged(counts))
    commits = ", ".join(f"`{each}`" for each in dict.fromkeys(line["commit"] for line in lines))
    seeds = Counter(Kind(line["simulator"], line["kind"]) for line in lines)
    fewest, most = min(seeds.values(), default=0), max(seeds.values(), default=0)
    each = f"{fewest}" if fewest == most else f"{fewest} to {most}"
    return (
        f"{len(lines)} tests, {each} of {len(SEEDS['lab'])} seeds of each kind, measured at"
        f" {commits}; holds while what the numbers rest on is unchanged (`{rests_on()}`).\n\n"
        f"Of {sum(verdicts.values()) - verdicts[Verdict.FEW]} results that were judged"
        f" {verdicts[Verdict.SELDOM]} hold too seldom and {verdicts[Verdict.WIDE]} are wide. Of"
        f" {len(sound)} numbers that were `ok`, {sum(_wrong(row, '') for row in sound)} are wrong,"
        f" farther off than 2 % and than three half widths, and {sum(map(is_empty, sound))} have an"
        f" interval without width. {sum(bool(line['error']) for line in lines)} tests ended in an"
        " error."
    )


def _pooled(counts: list[Count], simulator: str) -> Iterator[str]:
    yield _row("test", "intervals", "held", "%", "")
    yield _rule("lrrrl")
    for kind, (held, ok, verdict) in pooled(counts).items():
        if kind.simulator == simulator:
            share = f"{100.0 * held / ok:.1f}" if ok else ""
            yield _row(kind.name, ok, held, share, _bold(verdict))


def _results(counts: list[Count], simulator: str) -> Iterator[str]:
    yield _row("test", "result", "ok", "doubtful (held)", "failed", "held", "%", "width", "")
    yield _rule("llrrrrrrl")
    for each, verdict in zip(counts, judged(counts), strict=True):
        if each.kind.simulator == simulator:
            share = f"{100.0 * each.share:.0f}" if each.ok else ""
            width = f"{each.width:.2g}" if np.isfinite(each.width) else ""
            doubtful = f"{each.doubtful} ({each.doubtful_held})" if each.doubtful else 0
            cells = (each.kind.name, f"`{each.name}`", each.ok, doubtful, each.failed, each.held)
            yield _row(*cells, share, width, _bold(verdict))


def _noises(lines: Sequence[Line]) -> Iterator[str]:
    yield _row("test", *NOISES)
    yield _rule("l" + "r" * len(NOISES))
    held = by_noise(lines)
    for kind in KINDS:
        pairs = [held.get((kind, noise), (0, 0)) for noise in NOISES]
        if any(n for _, n in pairs):
            yield _row(kind.name, *(f"{100 * h / n:.0f} % of {n}" if n else "" for h, n in pairs))


def _faults(lines: Sequence[Line]) -> Iterator[str]:
    yield _row("test", "fault", "tests", "ok", "of these wrong")
    yield _rule("llrrr")
    yield from (_row(*key, *counts) for key, counts in sorted(by_fault(lines).items()))


def _bold(verdict: Verdict) -> str:
    return f"**{verdict}**" if verdict is Verdict.SELDOM else str(verdict)


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _rule(sides: str) -> str:
    return "|" + "|".join("---:" if side == "r" else "---" for side in sides) + "|"


def publish(lines: Sequence[Line], page: Path = PAGE) -> None:
    """Put the tables between their marks on the page."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    text = f"{before}{BEGIN}\n\n{tables(lines)}\n\n{END}{after}"
    page.write_text(text, encoding="utf-8")


def published_digest(text: str) -> str:
    """What the numbers of the page rest on; empty if it does not say."""
    found = re.search(r"rest on is unchanged \(`(\w+)`\)", text)
    return found[1] if found else ""


def published_failures(text: str) -> list[str]:
    """Rows of the page that hold too seldom."""
    return [line for line in text.splitlines() if line.startswith("|") and "**" in line]
