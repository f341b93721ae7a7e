"""Compare the numbers of the demo and of the real exports with those that are kept.

``python -m tests.golden`` processes both afresh. ``--processed DIR`` takes the campaigns of a demo
that has just been run. ``--update`` keeps the new numbers and prints what changed. Names of
campaigns, such as ``real``, leave the others out.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.golden.campaigns import (
    CAMPAIGNS,
    REAL,
    campaign_rows,
    made_demo,
    real_folder,
    real_rows,
)
from tests.golden.differences import differences
from tests.golden.rows import Row, read, write

HERE = Path(__file__).resolve().parent


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join((*CAMPAIGNS, REAL)))
    parser.add_argument("--processed", type=Path, metavar="DIR", help="a demo's processed/demo")
    parser.add_argument("--update", action="store_true", help="keep the new numbers")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        campaigns = taken(Path(folder), options.processed, options.names or (*CAMPAIGNS, REAL))
    changed = sum(compared(name, new, update=options.update) for name, new in campaigns.items())
    return 0 if options.update or not changed else 1


def taken(folder: Path, processed: Path | None, names: Sequence[str]) -> dict[str, list[Row]]:
    """Rows of the campaigns asked for; real exports only where they are."""
    campaigns: dict[str, list[Row]] = {}
    if set(names) - {REAL}:
        demo = processed or made_demo(folder / "demo")
        campaigns = {name: campaign_rows(demo / name) for name in names if name != REAL}
    if REAL in names:
        real = real_folder(HERE.parents[1])
        if real.is_dir():
            campaigns[REAL] = real_rows(real, folder / REAL)
        else:
            print(f"{REAL}: skipped, no folder of real exports (set LABPIPE_REALDATA)")
    return campaigns


def compared(name: str, new: list[Row], *, update: bool) -> int:
    """Print the differences of a campaign, and keep the new numbers if asked; how many."""
    path = HERE / f"{name}.csv"
    found = differences(read(path), new)
    print("".join(f"{each}\n" for each in found), end="")
    tests = len({row.test for row in new})
    changed = len({each.row.test for each in found})
    print(f"{name}: {tests} tests, {len(new)} rows, {len(found)} differences in {changed} tests")
    if update:
        write(path, new)
    return len(found)


if __name__ == "__main__":
    sys.exit(main())
