"""Tables of the study of tests, and how tables of any study come onto their page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from tests.coverage.judgement import (
    LEAST,
    Count,
    Held,
    Row,
    Verdict,
    counted,
    is_empty,
    judged,
    pooled,
)
from tests.judges.foreign.rig import KINDS as NOISES

TITLES = {"foreign": "Second simulator", "lab": "Virtual lab"}
NOTABLE = 0.93
"""Share of intervals below which a result is listed on the page."""
HEADS = (
    *("test", "result", "ok", "doubtful", "doubtful held", "ok held", "percent held", "width"),
    *("failed", "verdict"),
)


def put(text: str, name: str, file: Path) -> None:
    """Put text on a page, between the marks of that name."""
    begin, end = (f"<!-- {name}: {side} -->" for side in ("begin", "end"))
    before, _, rest = file.read_text(encoding="utf-8").partition(begin)
    after = rest.partition(end)[2]
    file.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")


def table(sides: str, heads: Iterable[object], rows: Iterable[Iterable[object]]) -> Iterator[str]:
    """Lines of a table in markdown; ``r`` and ``l`` are the sides of its columns."""
    rule = "|" + "|".join("---:" if side == "r" else "---" for side in sides) + "|"
    yield from (_line(heads), rule, *map(_line, rows))


def _line(cells: Iterable[object]) -> str:
    return "| " + " | ".join(map(str, cells)) + " |"


def by_noise(rows: Iterable[Row]) -> dict[tuple[str, str], Held]:
    """By kind of test and of noise: intervals of `ok` results without a fault."""
    found: dict[tuple[str, str], Held] = {}
    for row in rows:
        about = row["about"]
        if about.get("noise") and not about.get("fault"):
            key = row["kind"], about["noise"]
            held = Held.of(cell for cell in row["rows"] if cell["status"] == "ok")
            found[key] = found.get(key, Held(0, 0)) + held
    return found


def by_fault(rows: Iterable[Row]) -> dict[tuple[str, str], tuple[int, int, int]]:
    """By kind of test and fault: tests, results that are `ok`, and of these those that are wrong.

    Wrong is farther off than 2 % and than three half widths; where a crosshead counts down,
    whatever the sign.
    """
    found: dict[tuple[str, str], tuple[int, int, int]] = {}
    for row in rows:
        if fault := row["about"].get("fault"):
            key = row["kind"], fault
            tests, n, wrong = found.get(key, (0, 0, 0))
            ok = [cell for cell in row["rows"] if cell["status"] == "ok"]
            found[key] = tests + 1, n + len(ok), wrong + sum(_wrong(each, fault) for each in ok)
    return found


def _wrong(row: Row, fault: str) -> bool:
    if row.get("lower") is None:
        return False
    plain = abs if fault == "counts-down" else float
    half, off = 0.5 * (row["upper"] - row["lower"]), plain(row["value"]) - plain(row["truth"])
    return bool(abs(off) > max(3.0 * half, 0.02 * abs(row["truth"])))


def tables(rows: Sequence[Row]) -> str:
    """Everything that was counted of tests, in markdown."""
    counts = counted(rows)
    verdicts = judged([count.ok for count in counts])
    parts = [_summary(rows, verdicts)]
    for simulator, title in TITLES.items():
        own = [
            count
            for count in zip(counts, verdicts, strict=True)
            if count[0].kind.startswith(simulator)
        ]
        parts += ["", f"### {title}", "", *_pooled([count for count, _ in own]), ""]
        parts += ["Of its results, those that are wide or hold in less than 93 %:", ""]
        parts += _results([each for each in own if _is_notable(*each)])
    parts += ["", "### Kinds of noise", "", *_noises(rows)]
    parts += ["", "### Faults of the rig", "", *_faults(rows)]
    return "\n".join(parts)


def _summary(rows: Sequence[Row], verdicts: Sequence[Verdict]) -> str:
    sound = [cell for row in rows if not row["about"].get("fault") for cell in row["rows"]]
    sound = [each for each in sound if each["status"] == "ok"]
    numbers = Counter(verdicts)
    return (
        f"Of {len(verdicts) - numbers[Verdict.FEW]} results that were judged"
        f" {numbers[Verdict.SELDOM]} hold too seldom and {numbers[Verdict.WIDE]} are wide. Of"
        f" {len(sound)} numbers that were `ok`, {sum(_wrong(each, '') for each in sound)} are"
        f" wrong, farther off than 2 % and than three half widths, and"
        f" {sum(map(is_empty, sound))} have an interval without width."
        f" {sum(bool(row['error']) for row in rows)} tests ended in an error."
    )


def _name(kind: str) -> str:
    return kind.partition("/")[2]


def _pooled(counts: list[Count]) -> Iterator[str]:
    rows = [
        (_name(kind), held.asked, held.held, held.percent.removesuffix(" %"), _bold(verdict))
        for kind, (held, verdict) in pooled(counts).items()
    ]
    return table("lrrrl", ("test", "intervals", "held", "%", ""), rows)


def _is_notable(count: Count, verdict: Verdict) -> bool:
    """Whether a result is wide, holds too seldom, or holds in less than `NOTABLE`."""
    return verdict in (Verdict.SELDOM, Verdict.WIDE) or (
        count.ok.asked >= LEAST and count.ok.share < NOTABLE
    )


def _results(judged_counts: list[tuple[Count, Verdict]]) -> Iterator[str]:
    rows = [(*cells[:3], *cells[6:8], *cells[9:]) for cells in _cells(judged_counts)]
    return table("llrrrl", ("test", "result", "ok", "held, %", "width", ""), rows)


def _cells(judged_counts: list[tuple[Count, Verdict]]) -> Iterator[tuple[object, ...]]:
    for each, verdict in judged_counts:
        share = f"{100.0 * each.ok.share:.0f}" if each.ok.asked else ""
        width = f"{each.width:.2g}" if np.isfinite(each.width) else ""
        cells = _name(each.kind), f"`{each.name}`", each.ok.asked, each.doubtful.asked
        more = each.doubtful.held, each.ok.held, share, width, each.failed, _bold(verdict)
        yield *cells, *more


def every_result(rows: Sequence[Row]) -> Iterator[tuple[object, ...]]:
    """List every result that was counted: cells of a table for a spreadsheet."""
    counts = counted(rows)
    verdicts = judged([count.ok for count in counts])
    yield "simulator", *HEADS
    for count, cells in zip(counts, _cells(list(zip(counts, verdicts, strict=True))), strict=True):
        yield count.kind.partition("/")[0], *(str(cell).strip("`*") for cell in cells)


def _noises(rows: Sequence[Row]) -> Iterator[str]:
    held = by_noise(rows)
    lines = [
        (_name(kind), *(_share(held.get((kind, noise), Held(0, 0))) for noise in NOISES))
        for kind in dict.fromkeys(kind for kind, _ in held)
    ]
    return table("l" + "r" * len(NOISES), ("held, %", *NOISES), lines)


def _share(held: Held) -> str:
    return f"{100.0 * held.share:.0f}" if held.asked else ""


def _faults(rows: Sequence[Row]) -> Iterator[str]:
    total: dict[str, list[int]] = {}
    for (_, fault), n in sorted(by_fault(rows).items()):
        total[fault] = [a + b for a, b in zip(total.get(fault, [0, 0, 0]), n, strict=True)]
    lines = [(fault, *n) for fault, n in total.items()]
    return table("lrrr", ("fault", "tests", "ok", "of these wrong"), lines)


def _bold(verdict: Verdict) -> str:
    return f"**{verdict}**" if verdict is Verdict.SELDOM else str(verdict)
