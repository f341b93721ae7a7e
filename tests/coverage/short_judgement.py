"""Short records: how often their intervals hold, and how wide they are beside the scatter."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.coverage.judgement import Row
from tests.coverage.page import table
from tests.judges.plain.judge import process
from tests.judges.short_records import COUNTS, SEEDS, SHAPES, SHEET, made

NUMBERS = range(SEEDS.start, SEEDS.start + len(COUNTS) * len(SEEDS))
"""Of the records of a shape: count after count."""


def rows(shape: str, number: int, folder: Path) -> Row:
    """Samples a branch, and of each result truth, value, interval and status."""
    place, seed = divmod(number - SEEDS.start, len(SEEDS))
    record = made(shape, COUNTS[place], SEEDS[seed])
    files = {"short.yaml": record.protocol.encode(), "table.csv": record.table.encode()}
    ran = process(folder, SHEET, files)
    found = []
    for name, truth in record.truth.items():
        result = ran.results.get(name, {"status": "failed"})
        keys = ("value", "lower", "upper", "status")
        found.append({"name": name, "truth": truth, **{key: result.get(key) for key in keys}})
    error = ran.err if "Traceback" in ran.err else ""
    return {"about": {"samples": COUNTS[place]}, "rows": found, "error": error}


def tables(made: Sequence[Row]) -> str:
    """Of each shape, result and count: percent held, half width over scatter, percent ok."""
    cells: dict[tuple[str, str, int], list[Row]] = defaultdict(list)
    for row in made:
        shape, results = row["kind"].partition("/")[2], row["rows"]
        largest = max(x["truth"] for x in results if x["name"].startswith("peak_force"))
        for result in results:
            name = result["name"].partition(".")[0]
            cells[shape, name, row["about"]["samples"]].append({**result, "largest": largest})
    results = sorted({key[:2] for key in cells}, key=lambda key: (SHAPES.index(key[0]), key[1]))
    lines = [
        [shape, f"`{name}`", *(_cell(cells[shape, name, count]) for count in COUNTS)]
        for shape, name in results
    ]
    heads = ["shape", "result", *map(str, COUNTS)]
    return "\n".join(table("ll" + "r" * len(COUNTS), heads, lines))


def _cell(results: Sequence[Row]) -> str:
    """Write a cell; errors and half widths are per newton of the largest force of their record."""
    sure = [result for result in results if result["status"] == "ok"]
    if not sure:
        return "none"
    truth, value, low, high, largest = (
        np.array([result[key] for result in sure])
        for key in ("truth", "value", "lower", "upper", "largest")
    )
    held = float(np.mean((low <= truth) & (truth <= high)))
    half = float(np.median((high - low) / (2.0 * largest)))
    scatter = float(np.std((value - truth) / largest))
    share = len(sure) / len(results)
    return f"{held:.1%}, {half / scatter:.1f}" + (f" ({share:.0%})" if share < 1.0 else "")
