"""Compare the numbers of the full demo and of the real exports with those that are kept.

``python -m tests.golden`` processes both afresh. ``--processed DIR`` takes the campaigns of a demo
that has just been run. ``--update`` keeps the new numbers and prints what changed. Names of
campaigns, such as ``real``, leave the others out. What intervals are made of is not kept.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.golden.campaigns import (
    CAMPAIGNS,
    all_report_rows,
    campaign_rows,
    made_demo,
    real_folder,
    real_rows,
)
from tests.golden.differences import differences
from tests.golden.documents import made_model, study_rows
from tests.golden.rows import Row, read, write

REPORTS, STUDIES, REAL = "reports", "studies", "real"
NAMES = (*CAMPAIGNS, REPORTS, STUDIES, REAL)
HERE = Path(__file__).resolve().parent


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    parser.add_argument(
        "--processed", type=Path, metavar="DIR", help="a full demo's processed/demo"
    )
    parser.add_argument("--update", action="store_true", help="keep the new numbers")
    options = parser.parse_args()
    if unknown := set(options.names) - set(NAMES):
        parser.error(f"expected some of {', '.join(NAMES)}, found {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory() as folder:
        tables = taken(Path(folder), options.processed, options.names or NAMES)
    changed = sum(compared(name, new, update=options.update) for name, new in tables.items())
    return 0 if options.update or not changed else 1


def taken(folder: Path, processed: Path | None, names: Sequence[str]) -> dict[str, list[Row]]:
    """Rows of what was asked for; real exports only where they are."""
    tables: dict[str, list[Row]] = {}
    if set(names) - {REAL}:
        tables = demo_rows(processed or made_demo(folder / "demo"), folder, names)
    real = real_folder(HERE.parents[1])
    if REAL in names and real.is_dir():
        tables[REAL] = real_rows(real, folder / REAL)
    elif REAL in names:
        print(f"{REAL}: skipped, no folder of real exports (set LABPIPE_REALDATA)")
    return tables


def demo_rows(demo: Path, folder: Path, names: Sequence[str]) -> dict[str, list[Row]]:
    """Rows of what was asked for of a processed demo; models are made in a folder."""
    tables = {name: campaign_rows(demo / name) for name in CAMPAIGNS if name in names}
    if REPORTS in names:
        tables[REPORTS] = all_report_rows(demo)
    if STUDIES in names:
        calibration = demo / "wires" / "calibration" / "calibration.json"
        tables[STUDIES] = study_rows(calibration, made_model(folder / "model"))
    return tables


def compared(name: str, new: list[Row], *, update: bool) -> int:
    """Print the differences of a campaign, and keep the new numbers if asked; how many."""
    path = HERE / f"{name}.csv"
    changes = differences(read(path), new)
    print("".join(f"{finding}\n" for finding in changes), end="")
    tests = len({row.test for row in new})
    changed = len({finding.row.test for finding in changes})
    print(f"{name}: {tests} tests, {len(new)} rows, {len(changes)} differences in {changed} tests")
    if update:
        write(path, new)
    return len(changes)


if __name__ == "__main__":
    sys.exit(main())
