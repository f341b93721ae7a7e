"""The tests whose numbers are kept: of the full demo, and every real export that is a test."""

from __future__ import annotations

import contextlib
import io
import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from labpipe.cli import main
from tests.golden.documents import report_rows
from tests.golden.rows import Row, rows
from tests.judges.plain.judge import process
from tests.judges.plain.test_real_exports import CASES

CAMPAIGNS = ("wires", "tensile", "harness")
"""Of the full demo."""
JOBS = min(os.cpu_count() or 1, 4)


def made_demo(folder: Path) -> Path:
    """Run the full demo without figures; the folder of its processed campaigns."""
    with contextlib.redirect_stdout(io.StringIO()):
        main(["demo", "--full", str(folder), "--no-figures"])
    return folder / "processed" / "demo"


def campaign_rows(folder: Path) -> list[Row]:
    """Rows of every test of a processed campaign."""
    tests = sorted(path.parent for path in folder.glob("*/result.h5"))
    return [row for test in tests for row in rows(test.name, test)]


def all_report_rows(processed: Path) -> list[Row]:
    """Rows of the reports of all campaigns."""
    return [
        row
        for name in CAMPAIGNS
        for row in report_rows(processed / name / "report" / "tables.xlsx", name)
    ]


def real_rows(realdata: Path, folder: Path) -> list[Row]:
    """Process every real export that is a test, a folder each, and take its rows."""
    of_one = partial(_of_export, realdata, folder)
    with ProcessPoolExecutor(JOBS, mp_context=get_context("forkserver")) as pool:
        return [row for case in pool.map(of_one, sorted(CASES)) for row in case]


def _of_export(realdata: Path, folder: Path, name: str) -> list[Row]:
    case = CASES[name]
    ran = process(folder / name, case.sheet(), case.files(realdata))
    return rows(name, folder / name / "processed" / "c" / "T", status=f"exit {ran.status}")


def real_folder(repository: Path) -> Path:
    """Where the real exports lie, if they do."""
    named = os.environ.get("LABPIPE_REALDATA")
    return Path(named) if named else repository.parent / "shared" / "realdata"
