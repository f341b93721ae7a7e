"""What the study counts, and its page: docs/explanations/coverage.md."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.foreign.noise import KINDS as NOISES
from tests.foreign.study import KINDS, Row

LEAST = 20
"""Results `ok` in fewer tests are not judged."""
ENOUGH = 0.9
BEGIN, END = "<!-- counted: begin -->", "<!-- counted: end -->"


@dataclass(frozen=True)
class Count:
    """How one result fared in the tests without a fault.

    Parameters
    ----------
    kind, name : of which test, which result
    ok, doubtful, failed : how many
    held : of the `ok` ones, those whose interval holds the truth
    width : median half width over 1.96 standard deviations of value - truth; 1 is ideal
    bias : mean of value - truth over the median half width
    """

    kind: str
    name: str
    ok: int
    doubtful: int
    failed: int
    held: int
    width: float
    bias: float

    @property
    def share(self) -> float:
        """Of the `ok` ones that hold."""
        return self.held / self.ok if self.ok else float("nan")

    @property
    def below(self) -> bool:
        """Whether intervals hold in fewer than nine of ten."""
        return self.ok >= LEAST and self.share < ENOUGH


def holds(row: Row) -> bool:
    """Whether an interval holds its truth."""
    return bool(row["lower"] <= row["truth"] <= row["upper"])


def counted(lines: Iterable[Row]) -> list[Count]:
    """Counts by kind and result, in the order of the kinds."""
    rows: dict[tuple[str, str], list[Row]] = {}
    for line in lines:
        if not line["fault"]:
            for row in line["rows"]:
                rows.setdefault((line["kind"], row["name"]), []).append(row)
    order = sorted(rows, key=lambda key: KINDS.index(key[0]))
    return [_count(kind, name, rows[kind, name]) for kind, name in order]


def _count(kind: str, name: str, rows: list[Row]) -> Count:
    ok = [row for row in rows if row["status"] == "ok"]
    doubtful = sum(row["status"] == "doubtful" for row in rows)
    failed = len(rows) - len(ok) - doubtful
    width = bias = float("nan")
    if len(ok) >= 3:
        off = np.array([row["value"] - row["truth"] for row in ok])
        half = float(np.median([0.5 * (row["upper"] - row["lower"]) for row in ok]))
        scatter = 1.96 * float(off.std(ddof=1))
        width = half / scatter if scatter > 0.0 else float("inf")
        bias = float(off.mean()) / half if half > 0.0 else float("inf")
    return Count(kind, name, len(ok), doubtful, failed, sum(map(holds, ok)), width, bias)


def by_noise(lines: Iterable[Row]) -> dict[tuple[str, str], tuple[int, int]]:
    """By kind of test and of noise: intervals that hold, of the `ok` ones without a fault."""
    found: dict[tuple[str, str], tuple[int, int]] = {}
    for line in lines:
        for row in line["rows"] if not line["fault"] else ():
            if row["status"] == "ok":
                held, n = found.get((line["kind"], line["noise"]), (0, 0))
                found[line["kind"], line["noise"]] = held + holds(row), n + 1
    return found


def by_fault(lines: Iterable[Row]) -> dict[tuple[str, str], tuple[int, int, int]]:
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
            found[key] = (
                tests + 1,
                n + len(ok),
                wrong + sum(_wrong(row, line["fault"]) for row in ok),
            )
    return found


def _wrong(row: Row, fault: str) -> bool:
    plain = abs if fault == "counts-down" else float
    half, off = 0.5 * (row["upper"] - row["lower"]), plain(row["value"]) - plain(row["truth"])
    return bool(abs(off) > max(3.0 * half, 0.02 * abs(row["truth"])))


def tables(lines: list[Row], commit: str) -> str:
    """Three tables in markdown."""
    tests = sum(not line["fault"] for line in lines)
    counts = counted(lines)
    judged, few = sum(each.ok >= LEAST for each in counts), sum(each.below for each in counts)
    sound = [row for line in lines if not line["fault"] for row in line["rows"]]
    sound = [row for row in sound if row["status"] == "ok"]
    rows = [
        f"Measured at commit `{commit}`: {len(lines)} tests, {tests} of them without a fault. Of"
        f" {judged} results that were `ok` {LEAST} times or more, {few} hold too seldom. Of all"
        f" {len(sound)} numbers that were `ok`, {sum(_wrong(row, '') for row in sound)} are wrong:"
        " farther off than 2 % and than three half widths.\n"
    ]
    rows += ["| test | result | ok | doubtful | failed | held | % | width |", _rule("llrrrrrr")]
    for each in counts:
        share = f"{100.0 * each.share:.0f}" if each.ok else ""
        shown = f"**{share}**" if each.below else share
        width = f"{each.width:.2g}" if np.isfinite(each.width) else ""
        cells = (each.kind, f"`{each.name}`", each.ok, each.doubtful, each.failed, each.held)
        rows.append(_row(*cells, shown, width))
    rows += ["", _row("test", *NOISES), _rule("l" + "r" * len(NOISES))]
    held = by_noise(lines)
    for kind in KINDS:
        pairs = [held.get((kind, noise), (0, 0)) for noise in NOISES]
        rows.append(_row(kind, *(f"{h} of {n}" if n else "" for h, n in pairs)))
    rows += ["", "| test | fault | tests | ok | of these wrong |", _rule("llrrr")]
    rows += [_row(*key, *counts) for key, counts in sorted(by_fault(lines).items())]
    return "\n".join(rows)


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _rule(sides: str) -> str:
    return "|" + "|".join("---:" if side == "r" else "---" for side in sides) + "|"


def publish(lines: list[Row], page: Path, commit: str) -> None:
    """Put the tables between their marks on the page."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    text = f"{before}{BEGIN}\n\n{tables(lines, commit)}\n\n{END}{after}"
    page.write_text(text, encoding="utf-8")


def published(page: str) -> set[tuple[str, str]]:
    """Results that the page has as holding too seldom: those in bold."""
    found = re.findall(r"^\| ([\w-]+) \| `([\w.]+)` \|.*\*\*\d+\*\*", page, flags=re.MULTILINE)
    return {(kind, name) for kind, name in found}
