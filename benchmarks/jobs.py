"""What people wait for, each as one command, with what it needs made beforehand.

A job costs what its process costs, start-up included. *Next* is one more test of a campaign, in a
process that has already processed another. Exports are synthetic and the same for all jobs and
trees; what is read from ``result.h5`` has been processed by the tree that is timed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import load_frames, wire_model
from benchmarks.timing import REPOSITORY, Cost, labpipe, timed
from labpipe.virtual_lab import (
    Campaign,
    TensileCampaign,
    WireCampaign,
    simulate_test,
    write_wire_sheet,
)

HERE = Path(__file__).resolve().parent
CANTILEVERS = ("A2-085-1", "A2-085-2", "A2-085-3")
TUBES = ("CT-10-1", "CT-10-2", "CT-10-3", "CT-7-1", "CT-7-2", "CT-7-3")
FULL, CSV, XLSX = "full", "csv", "xlsx"
REPORTS = (100, 300)
WAYS = ("gzip", "isal", "none")
OPENING = ("opening them",)
PLAN = "version: 1\nwire: A2\n"
NO_FIGURES = "--no-figures"


@dataclass(frozen=True)
class Place:
    """Exports that all trees share, and a folder for what one tree makes of them."""

    tree: Path
    raw: Path
    out: Path

    def tests(self, names: Sequence[str]) -> list[str]:
        return [str(self.raw / name) for name in names]

    def process(self, name: str, *options: str) -> list[str]:
        return labpipe("process", self.raw / name, *options, "--out", self.out)


@dataclass(frozen=True)
class Job:
    """One thing to wait for.

    `floor` makes the command of the least that it can cost, for each of `floors`, which are ways to
    write (see `benchmarks.floor`). A job with `writes_cost` tells its own cost, as JSON.
    """

    name: str
    command: Callable[[Place], list[str]]
    floor: Callable[[Place, str], list[str]] | None = None
    floors: tuple[str, ...] = ()
    writes_cost: bool = False
    runs: int = 5


def cost(job: Job, place: Place) -> Cost:
    """One run."""
    return _cost(job.command(place), place, writes_cost=job.writes_cost)


def cost_of_floor(job: Job, place: Place, filtering: str) -> Cost:
    """One run of the least that a job can cost."""
    if job.floor is None:
        message = f"{job.name} has no floor"
        raise ValueError(message)
    return _cost(job.floor(place, filtering), place, writes_cost=job.writes_cost)


def _cost(command: list[str], place: Place, *, writes_cost: bool) -> Cost:
    spent = timed(command, tree=place.tree)
    if not writes_cost:
        return spent
    record = json.loads((place.out / "cost.json").read_text(encoding="utf-8"))
    return Cost(record["wall"], record["cpu"], spent.memory)


def _next(names: Sequence[str]) -> Callable[[Place], list[str]]:
    script = [sys.executable, "-P", str(HERE / "next_test.py")]
    return lambda at: [*script, str(at.out / "cost.json"), *at.tests(names)]


def _floor(*names: str) -> Callable[[Place, str], list[str]]:
    script = [sys.executable, "-P", str(HERE / "floor.py")]
    return lambda at, filtering: [*script, filtering, str(at.out / "cost.json"), *at.tests(names)]


def _floor_again(at: Place, filtering: str) -> list[str]:
    script = [sys.executable, "-P", str(HERE / "floor.py"), filtering, str(at.out / "cost.json")]
    return [*script, str(at.out / FULL / "result.h5")]


def _opened(count: int) -> Callable[[Place, str], list[str]]:
    def command(at: Place, _: str) -> list[str]:
        results = sorted(map(str, (at.out / f"many-{count}").glob("*/result.h5")))
        return [sys.executable, "-c", load_frames.OPEN_ALL, *results]

    return command


def _report(count: int) -> Callable[[Place], list[str]]:
    return lambda at: labpipe("report", at.out / f"many-{count}", "--out", at.out / "report")


def _calibrate(at: Place) -> list[str]:
    tests = [at.out / name for name in CANTILEVERS]
    sheet, plan = at.raw / "wires.csv", at.raw / "plan.yaml"
    where = ["--wire", sheet, "--plan", plan, NO_FIGURES, "--out", at.out / "calibration"]
    return labpipe("calibrate", *tests, *where)


JOBS = (
    Job("--help", lambda _: labpipe("--help"), runs=15),
    Job(
        "cantilever",
        lambda at: at.process(CANTILEVERS[0], NO_FIGURES),
        _floor(CANTILEVERS[0]),
        WAYS,
    ),
    Job("cantilever with figures", lambda at: at.process(CANTILEVERS[0])),
    Job("tensile test", lambda at: at.process(TUBES[0], NO_FIGURES)),
    Job("full-size cantilever", lambda at: at.process(FULL, NO_FIGURES), _floor(FULL), WAYS),
    Job("tensile csv of 18 MB", lambda at: at.process(CSV, NO_FIGURES)),
    Job("next cantilever", _next(CANTILEVERS), _floor(*CANTILEVERS), WAYS, writes_cost=True),
    Job(
        "next full-size cantilever",
        _next((FULL, FULL)),
        _floor(FULL, FULL),
        WAYS,
        writes_cost=True,
    ),
    Job("next tensile test", _next(TUBES), writes_cost=True),
    Job(
        "full-size test again, from result.h5",
        lambda at: labpipe("process", at.out / FULL / "result.h5", NO_FIGURES),
        _floor_again,
        WAYS,
    ),
    *(
        Job(f"report of {count} tensile tests", _report(count), _opened(count), OPENING, runs=3)
        for count in REPORTS
    ),
    Job("calibration by three cantilevers", _calibrate),
    Job(
        f"model of {10 * wire_model.COPIES} wires",
        lambda at: labpipe("model", at.raw / "many.xlsx", NO_FIGURES, "--out", at.out / "model"),
        runs=3,
    ),
)


def simulated(names: Sequence[str], folder: Path) -> dict[str, Path]:
    """Tests of the demo by their names, the same as there."""
    campaigns: Sequence[Campaign] = (WireCampaign(cycles=2, fps=25.0), TensileCampaign())
    return {
        scenario.name: simulate_test(scenario, folder / scenario.name, seed=seed)
        for campaign in campaigns
        for scenario, seed in campaign.list_scenarios()
        if scenario.name in names
    }


def write_raw(folder: Path) -> Path:
    """Exports of all jobs, as the virtual lab of this tree writes them."""
    simulated((*CANTILEVERS, *TUBES), folder)
    timed(labpipe("simulate", "--out", folder, "--name", FULL))
    load_frames.write_csv_test(folder / CSV)
    load_frames.write_xlsx_test(folder / XLSX)
    write_wire_sheet(folder)
    wire_model.write_sheet(folder / "many.xlsx")
    (folder / "plan.yaml").write_text(PLAN, encoding="utf-8")
    return folder


def prepared(raw: Path, out: Path, tree: Path = REPOSITORY) -> Place:
    """Process with a tree what its jobs read, and copy a test for the reports."""
    place = Place(tree, raw, out)
    out.mkdir(parents=True)
    for name in (*CANTILEVERS, TUBES[0], FULL):
        timed(place.process(name, NO_FIGURES), tree=tree)
    for count in REPORTS:
        load_frames.copies(out / TUBES[0] / "result.h5", out / f"many-{count}", count)
    return place
