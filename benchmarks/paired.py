"""Two trees in one run: ``python -m benchmarks.paired OLD_TREE``, run from the new one.

Every job runs with the package of the one and of the other in turn. Printed are the medians over
pairs of new / old, on the clock and of all processors, and the median seconds of the new tree.
Words after the tree pick the jobs whose names hold one of them.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.jobs import JOBS, Job, Place, cost, prepared, write_raw
from benchmarks.timing import REPOSITORY, in_turn

SLOWER = 1.05


def compare(job: Job, new: Place, old: Place, runs: int) -> None:
    """Print a line for a job; one that a twentieth more is asked for is marked."""
    ratio = in_turn(lambda: cost(job, new), lambda: cost(job, old), runs=runs)
    mark = "  slower" if max(ratio.wall, ratio.cpu) > SLOWER else ""
    ratios = f"{ratio.wall:>7.3f} {ratio.cpu:>7.3f}"
    seconds = f"{ratio.one.wall:>9.3f} {ratio.one.cpu:>9.3f}"
    print(f"{job.name:<40}{ratios} {seconds}{mark}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paired")
    parser.add_argument("old", type=Path, metavar="OLD_TREE", help="a checkout to compare with")
    parser.add_argument("words", nargs="*", metavar="WORD", help="jobs whose name holds it")
    parser.add_argument("--runs", type=int, help="pairs of each job (default: 3 to 15)")
    options = parser.parse_args()
    chosen = [job for job in JOBS if any(word in job.name for word in options.words or [""])]
    with tempfile.TemporaryDirectory() as folder:
        raw = write_raw(Path(folder) / "raw")
        new = prepared(raw, Path(folder) / "new", REPOSITORY)
        old = prepared(raw, Path(folder) / "old", options.old.resolve())
        print(f"{'new / old':<40}{'wall':>7} {'cpu':>7} {'wall, s':>9} {'cpu, s':>9}")
        for job in chosen:
            compare(job, new, old, options.runs or job.runs)


if __name__ == "__main__":
    main()
