"""The tests whose numbers are kept: of the full demo, and of real exports."""

from __future__ import annotations

import contextlib
import io
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Standard:
    """A real export, processed by a protocol that labpipe ships."""

    export: str
    protocol: str
    specimen: str

    def sheet(self) -> str:
        return (
            f"test: T\nprotocol: {self.protocol}\n"
            f'specimen: {{type: real, spool: "1", sample: "1", {self.specimen}}}\n'
            f"files: {{frame: {Path(self.export).name}}}\n"
        )

    def files(self, root: Path) -> dict[str, bytes]:
        return {Path(self.export).name: (root / self.export).read_bytes()}


REAL_CASES = CASES | {
    "standard-steel-46NT71": Standard(
        "iso6892/46NT71.csv", "iso-6892", "gauge_length: 25 mm, section: {area: 19.6585 mm^2}"
    ),
    "standard-steel-Zx2": Standard(
        "bam_s355/Zx2.csv", "iso-6892", "gauge_length: 50 mm, section: {area: 120.444 mm^2}"
    ),
}
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
        return [row for case in pool.map(of_one, sorted(REAL_CASES)) for row in case]


def _of_export(realdata: Path, folder: Path, name: str) -> list[Row]:
    case = REAL_CASES[name]
    ran = process(folder / name, case.sheet(), case.files(realdata))
    return rows(name, folder / name / "processed" / "c" / "T", status=f"exit {ran.status}")


def real_folder(repository: Path) -> Path:
    """Where the real exports lie, if they do."""
    named = os.environ.get("LABPIPE_REALDATA")
    return Path(named) if named else repository.parent / "shared" / "realdata"
