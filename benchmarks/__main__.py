"""Run every benchmark and print its ratio beside its bound.

A ratio compares two commands, or two functions, that ran in turn in this one run, so that it holds
on a noisy machine. The median of the paired ratios is printed. Nothing here fails: benchmarks are
not tests.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks import calibration, house, load_frames, two_segments, wire_model
from labpipe.signal.filters import moving_average

LABPIPE = str(Path(sys.executable).with_name("labpipe"))
RUNS = 5


def timed(command: list[str]) -> tuple[float, float]:
    """Wall seconds and peak memory (MB) of one process."""
    start = time.perf_counter()
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=_as_installed()
    )
    _, status, usage = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in {0, 1}:
        message = f"{command} ended with {os.waitstatus_to_exitcode(status)}"
        raise RuntimeError(message)
    return time.perf_counter() - start, usage.ru_maxrss / 1024.0


@cache
def _as_installed() -> dict[str, str]:
    """The environment of a user, whose modules were compiled when they were first imported."""
    kept = Path(tempfile.gettempdir()) / "labpipe-bench-bytecode"
    asked = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(kept)}
    return os.environ | asked


def paired(one: list[str], other: list[str], *, runs: int = RUNS) -> tuple[float, float, float]:
    """Median ratio of two commands run in turn, median seconds of the first, its peak memory."""
    timed(one), timed(other)
    pairs = [(timed(one), timed(other)) for _ in range(runs)]
    ratio = statistics.median(a[0] / b[0] for a, b in pairs)
    return ratio, statistics.median(a[0] for a, _ in pairs), max(a[1] for a, _ in pairs)


def clocked(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def full_size_test(folder: Path) -> None:
    """Process of a 10 kHz test against its floor, and what the figures add."""
    subprocess.run(
        [LABPIPE, "simulate", "--out", str(folder), "--name", "full"],
        check=True,
        capture_output=True,
    )
    test, out = folder / "full", str(folder / "out")
    exports = [str(test / "force.mat"), str(test / "take.csv")]
    process = [LABPIPE, "process", str(test), "--out", out]
    floor = [sys.executable, "-m", "benchmarks.floor", *exports, str(folder / "floor.h5")]
    ratio, seconds, memory = paired([*process, "--no-figures"], floor)
    show("process --no-figures / floor", ratio, "at most 1.5", f"{seconds:.2f} s")
    show("  peak memory, MB", memory, "under 600")
    timed(process)
    extra = [timed(process)[0] - timed([*process, "--no-figures"])[0] for _ in range(RUNS)]
    show("  figures, seconds more", statistics.median(extra), "at most 3")


def start_up() -> None:
    """Help against an empty interpreter."""
    ratio, seconds, _ = paired([LABPIPE, "--help"], [sys.executable, "-c", "pass"], runs=15)
    show("labpipe --help / python -c pass", ratio, "at most 4", f"{1e3 * seconds:.0f} ms")


def filters() -> None:
    """Moving average against a plain cumulative sum."""
    values = np.random.default_rng(0).normal(size=3_180_000)
    moving_average(values, window=1001)
    ratios = [
        clocked(lambda: moving_average(values, window=1001)) / clocked(lambda: np.cumsum(values))
        for _ in range(21)
    ]
    show("moving average / cumulative sum, 3.18 M", statistics.median(ratios), "at most 3")


def load_frame_exports(folder: Path) -> None:
    """A large csv end to end, and a workbook read, against the library alone."""
    csv = load_frames.write_csv_test(folder / "csv")
    command = [LABPIPE, "process", str(csv.parent), "--no-figures", "--out", str(folder / "out")]
    ratio, seconds, memory = paired(command, [sys.executable, "-c", load_frames.READ_CSV, str(csv)])
    show("process 18 MB csv / pandas.read_csv", ratio, "at most 2", f"{seconds:.2f} s")
    show("  peak memory, MB", memory, "")
    xlsx = load_frames.write_xlsx_test(folder / "xlsx")
    inspect = [LABPIPE, "inspect", str(xlsx)]
    ratio, seconds, _ = paired(inspect, [sys.executable, "-c", load_frames.READ_XLSX, str(xlsx)])
    show("inspect xlsx of 60 000 rows / calamine", ratio, "at most 1.5", f"{seconds:.2f} s")


def lab_report(folder: Path) -> None:
    """A report over 100 tests against opening their files, and its memory against that of 25."""
    result = folder / "out" / "csv" / "result.h5"
    tests = load_frames.copies(result, folder / "many", 100)
    command = [LABPIPE, "report", str(folder / "many"), "--out", str(folder / "report")]
    opened = [sys.executable, "-c", load_frames.OPEN_ALL, *map(str, tests)]
    ratio, seconds, memory = paired(command, opened, runs=3)
    show("report of 100 tests / opening them", ratio, "under 10", f"{seconds:.2f} s")
    few = load_frames.copies(result, folder / "few", 25)
    _, least = timed([LABPIPE, "report", str(few[0].parents[1]), "--out", str(folder / "report")])
    show("  memory of 100 tests / of 25", memory / least, "flat", f"{memory:.0f} MB")


def show(what: str, value: float, bound: str, remark: str = "") -> None:
    print(f"{what:<44}{value:>8.2f}   ({bound})  {remark}", flush=True)


def main() -> None:
    house.main([])
    start_up()
    filters()
    two_segments.main()
    wire_model.main()
    calibration.main()
    with tempfile.TemporaryDirectory() as folder:
        load_frame_exports(Path(folder))
        lab_report(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        full_size_test(Path(folder))


if __name__ == "__main__":
    main()
