"""How wide the intervals are now against those that are kept, and whose status changed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan
from statistics import median

from tests.golden.rows import Row

HEADS = ("protocol", "result", "unit", "n", "old width", "new width", "new / old", "least to most")
NOT_THERE = "none"


@dataclass(frozen=True)
class Pair:
    """A result as it is kept, and as it came out; either may be missing."""

    protocol: str
    old: Row | None
    new: Row | None

    @property
    def row(self) -> Row:
        found = self.old or self.new
        if found is None:
            message = "a pair of nothing"
            raise ValueError(message)
        return found

    @property
    def result(self) -> str:
        """Its name without the cycle."""
        return self.row.name.partition(".")[0]

    @property
    def widths(self) -> tuple[float, float] | None:
        """Old and new width; None where one of the two has no interval."""
        if self.old is None or self.new is None:
            return None
        both = (width(self.old), width(self.new))
        return both if all(map(isfinite, both)) else None

    @property
    def statuses(self) -> tuple[str, str]:
        """Old and new status with the codes."""
        return status(self.old), status(self.new)


def width(row: Row) -> float:
    """Of the interval, in the unit of the row; NaN without one."""
    return float(row.upper) - float(row.lower) if row.lower and row.upper else nan


def status(row: Row | None) -> str:
    """Status and codes in one word for a table."""
    return NOT_THERE if row is None else f"{row.status} {row.codes}".strip()


def paired(old: Iterable[Row], new: Iterable[Row]) -> list[Pair]:
    """Results of both sides by test and name, in the order of the old ones, then what is new."""
    before, after = ({row.key: row for row in each} for each in (old, new))
    rows = {**after, **before}
    protocols = {row.test: row.name for row in rows.values() if row.kind == "test"}
    return [
        Pair(protocols.get(rows[key].test, ""), before.get(key), after.get(key))
        for key in dict.fromkeys([*before, *after])
        if rows[key].kind == "result"
    ]


def table(pairs: Sequence[Pair]) -> Iterator[str]:
    """Lines of a table in Markdown, a row for each protocol and result: medians of the tests."""
    yield f"| {' | '.join(HEADS)} |"
    yield f"|{'---|' * len(HEADS)}"
    kinds = dict.fromkeys((each.protocol, each.result) for each in pairs)
    for protocol, result in kinds:
        own = [each for each in pairs if (each.protocol, each.result) == (protocol, result)]
        widths = [both for each in own if (both := each.widths) is not None]
        if widths:
            cells = (protocol, result, own[0].row.unit, str(len(widths)), *_cells(widths))
            yield f"| {' | '.join(cells)} |"


def _cells(widths: Sequence[tuple[float, float]]) -> Iterator[str]:
    for side in zip(*widths, strict=True):
        yield f"{median(side):.3g}"
    ratios = [new / old if old else (inf if new else 1.0) for old, new in widths]
    yield f"{median(ratios):.2f}"
    yield f"{min(ratios):.2f} to {max(ratios):.2f}"


def changed_statuses(pairs: Sequence[Pair]) -> Iterator[str]:
    """Lines that count the changes of status, and name the tests of each."""
    changed = [each for each in pairs if each.statuses[0] != each.statuses[1]]
    yield f"{len(changed)} of {len(pairs)} results have another status or other codes"
    kinds: dict[tuple[str, ...], dict[str, None]] = {}
    for each in changed:
        key = (each.protocol, each.result, *each.statuses)
        kinds.setdefault(key, {})[each.row.test] = None
    for (protocol, result, old, new), tests in sorted(
        kinds.items(), key=lambda each: -len(each[1])
    ):
        yield f"{len(tests):>4}  {protocol} {result}: {old} -> {new}  [{', '.join(tests)}]"
