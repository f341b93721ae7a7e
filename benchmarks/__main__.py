"""Run every benchmark and print its ratio beside its bound.

A ratio compares two commands, or two functions, that ran in turn in this one run, so that it holds
on a noisy machine. The median of the paired ratios is printed, of the time on the clock and of that
of all processors. Nothing here fails: benchmarks are not tests.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import calibration, growth, house, load_frames, rods, two_segments, wire_model
from benchmarks.jobs import FULL, JOBS, NO_FIGURES, Place, cost, cost_of_floor, prepared, write_raw
from benchmarks.timing import in_turn, labpipe, median, paired, timed
from labpipe.signal.filters import compute_moving_average

RUNS = 5
FLOORS = {"gzip": "HDF5's gzip", "isal": "ISA-L", "none": "unfiltered"}


def clocked(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def people_wait_for(place: Place) -> None:
    """Every job by itself, and against the least that it can cost."""
    print(f"\n{'job':<44}{'wall, s':>8} {'cpu, s':>8}{'MB':>6}")
    for job in JOBS:
        spent = median([cost(job, place) for _ in range(min(job.runs, 3))])
        print(f"{job.name:<44}{spent.wall:>8.3f} {spent.cpu:>8.3f}{spent.memory:>6.0f}", flush=True)
        for how in job.floors:
            ratios = in_turn(
                partial(cost, job, place),
                partial(cost_of_floor, job, place, how),
                runs=min(job.runs, RUNS),
            )
            remark = f"  / {FLOORS.get(how, how)}"
            print(f"{remark:<44}{ratios.wall:>8.2f} {ratios.cpu:>8.2f}", flush=True)


def full_size_test(place: Place) -> None:
    """What the figures of a 10 kHz test add, and what its memory is."""
    process = place.process(FULL)
    extra = [timed(process).wall - timed([*process, NO_FIGURES]).wall for _ in range(RUNS)]
    show("figures of a full-size test, seconds more", statistics.median(extra), "at most 3")


def start_up() -> None:
    """Help against an empty interpreter."""
    ratios = paired(labpipe("--help"), [sys.executable, "-c", "pass"], runs=15)
    remark = f"{1e3 * ratios.one.wall:.0f} ms"
    show("labpipe --help / python -c pass", ratios.wall, "at most 4", remark)


def filters() -> None:
    """Moving average against a plain cumulative sum."""
    values = np.random.default_rng(0).normal(size=3_180_000)
    compute_moving_average(values, window=1001)
    ratios = [
        clocked(lambda: compute_moving_average(values, window=1001))
        / clocked(lambda: np.cumsum(values))
        for _ in range(21)
    ]
    show("moving average / cumulative sum, 3.18 M", statistics.median(ratios), "at most 3")


def load_frame_exports(place: Place) -> None:
    """A large csv end to end, and a workbook read, against the library alone."""
    csv, xlsx = (place.raw / name / f"pull.{name}" for name in ("csv", "xlsx"))
    pandas = [sys.executable, "-c", load_frames.READ_CSV, str(csv)]
    ratios = paired(place.process(csv.parent.name, NO_FIGURES), pandas)
    remark = f"{ratios.one.wall:.2f} s; cpu {ratios.cpu:.2f}"
    show("process 18 MB csv / pandas.read_csv", ratios.wall, "at most 2", remark)
    show("  peak memory, MB", ratios.one.memory, "")
    calamine = [sys.executable, "-c", load_frames.READ_XLSX, str(xlsx)]
    ratios = paired(labpipe("inspect", xlsx), calamine)
    remark = f"{ratios.one.wall:.2f} s; cpu {ratios.cpu:.2f}"
    show("inspect xlsx of 60 000 rows / calamine", ratios.wall, "at most 1.5", remark)


def lab_report(place: Place) -> None:
    """A report over 100 large tests against opening their files, its memory against that of 25."""
    result, out = place.out / "csv" / "result.h5", place.out / "report"
    tests = load_frames.copies(result, place.out / "large", 100)
    opened = [sys.executable, "-c", load_frames.OPEN_ALL, *map(str, tests)]
    ratios = paired(labpipe("report", place.out / "large", "--out", out), opened, runs=3)
    remark = f"{ratios.one.wall:.2f} s; cpu {ratios.cpu:.2f}"
    show("report of 100 large tests / opening them", ratios.wall, "under 10", remark)
    load_frames.copies(result, place.out / "few", 25)
    few_cost = timed(labpipe("report", place.out / "few", "--out", out)).memory
    peak_memory = ratios.one.memory
    show("  memory of 100 tests / of 25", peak_memory / few_cost, "flat", f"{peak_memory:.0f} MB")


def show(name: str, value: float, bound: str, remark: str = "") -> None:
    print(f"{name:<44}{value:>8.2f}   ({bound})  {remark}", flush=True)


def main() -> None:
    house.main([])
    start_up()
    with tempfile.TemporaryDirectory() as folder:
        place = prepared(write_raw(Path(folder) / "raw"), Path(folder) / "out")
        people_wait_for(place)
        full_size_test(place)
        load_frame_exports(place)
        lab_report(place)
    filters()
    growth.main()
    two_segments.main()
    wire_model.main()
    calibration.main()
    rods.main()


if __name__ == "__main__":
    main()
