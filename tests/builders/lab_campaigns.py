"""Campaigns of many small tests, and an executor that stands in for the real one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

from labpipe.campaign.campaign_files import CampaignFolders, find_campaign
from labpipe.campaign.catalog import open_catalog
from labpipe.campaign.executors import Outcome, Outcomes
from labpipe.campaign.running import RunSummary, run_campaign
from labpipe.errors import LabpipeError
from labpipe.process.run import ProcessedTest, RefusedTest, Task
from labpipe.protocol.load import format_protocol, list_protocols, load_test_sheet, resolve_protocol
from labpipe.records.result import TestResult

SHEET = """\
test: {name}
protocol: {protocol}
specimen: {{type: CT-7, spool: CT-7-s1, sample: {sample}, length: 114.3 mm}}
date: 2026-03-09
files: {{frame: frame.csv}}
"""


@dataclass(slots=True)
class StandIn:
    """An executor that writes outcomes at once, of tests whose export says what they are.

    An export begins with ``fail CODE``, ``doubt``, or a number, which is the peak force (plus
    `shift`), in an interval of 1 N.
    """

    processed: list[str] = field(default_factory=list)
    before: Callable[[str], None] = lambda _: None
    shift: float = 0.0

    def __call__(self, tasks: Iterable[Task]) -> Outcomes:
        for task in tasks:
            name = task.sheet.parent.name
            self.before(name)
            self.processed.append(name)
            assert task.results_folder is not None
            yield task, attempt_of(task, task.results_folder, self.shift)


def attempt_of(task: Task, goal: Path, shift: float) -> Outcome:
    goal.mkdir(parents=True, exist_ok=True)
    export = task.sheet.parent / "frame.csv"
    outcome = (
        export.read_text(encoding="utf-8").split() if export.is_file() else ["fail", "missing"]
    )
    try:
        load_test_sheet(task.sheet)
    except LabpipeError as error:
        outcome = ["fail", error.code]
    if outcome[0] != "fail" and load_test_sheet(task.sheet).protocol not in list_protocols():
        outcome = ["fail", "bad_sheet"]
    if outcome[0] == "fail":
        failure = {"code": outcome[1], "reason": f"a {outcome[1]} of an export", "run": task.run}
        if outcome[1] != "in_use":
            (goal / "failure.json").write_text(json.dumps(failure), encoding="utf-8")
        return RefusedTest(task.sheet, outcome[1], failure["reason"], goal, task.run)
    doubts = outcome[0] == "doubt"
    peak = shift + (1.0 if doubts else float(outcome[0]))
    text = json.dumps(summary_of(task, peak, doubts=doubts))
    (goal / "result.h5").write_text("results", encoding="utf-8")
    (goal / "summary.json").write_text(text, encoding="utf-8")
    (goal / "failure.json").unlink(missing_ok=True)
    return ProcessedTest(goal, NO_RESULT, ())


NO_RESULT = cast("TestResult", None)
"""Campaigns read results from the files of a test."""


_RESOLVED: dict[tuple[str, str], str] = {}


def _resolved(name: str, text: str, task: Task) -> str:
    """The resolved protocol: the sheets of these campaigns all change the same in it."""
    if (name, text) not in _RESOLVED:
        protocol = resolve_protocol(load_test_sheet(task.sheet), task.sheet)
        _RESOLVED[name, text] = format_protocol(protocol)
    return _RESOLVED[name, text]


def summary_of(task: Task, peak: float, *, doubts: bool = False) -> dict[str, object]:
    sheet = load_test_sheet(task.sheet)
    protocol = _resolved(sheet.protocol, list_protocols()[sheet.protocol].read_text("utf-8"), task)
    export = (task.sheet.parent / "frame.csv").read_bytes()
    texts = {"sheet": task.sheet.read_text(encoding="utf-8"), "protocol": protocol}
    reasons = [{"code": "noisy", "message": "much noise"}] if doubts else []
    return {
        "schema": 2,
        "test": sheet.test,
        "specimen": {"type": "CT-7", "spool": "CT-7-s1", "sample": "1", "length": 0.1143},
        "protocol": sheet.protocol,
        "labpipe": "0.1.0",
        "inputs": [{"role": "frame", "file": "frame.csv", "sha256": sha256(export).hexdigest()}],
        "run": task.run,
        "made_of": {key: sha256(text.encode()).hexdigest() for key, text in texts.items()},
        "date": "2026-03-09",
        "results": [
            {
                "name": "peak_force.1",
                "value": peak,
                "unit": "N",
                "lower": peak - 0.5,
                "upper": peak + 0.5,
                "level": 0.95,
                "estimate": peak,
                "status": "doubtful" if doubts else "ok",
                "reasons": reasons,
            }
        ],
        "quality": [],
    }


@dataclass(slots=True)
class LabCampaign:
    """A campaign ``raw/C`` in a folder."""

    home: Path
    stand_in: StandIn = field(default_factory=StandIn)

    @property
    def raw(self) -> Path:
        return self.home / "raw" / "C"

    @property
    def processed(self) -> Path:
        return self.home / "processed" / "C"

    @property
    def folders(self) -> CampaignFolders:
        return find_campaign(self.raw)

    def add(self, name: str, export: str = "62.5", protocol: str = "corrugated-tube") -> Path:
        folder = self.raw / name
        folder.mkdir(parents=True)
        (folder / "frame.csv").write_text(export, encoding="utf-8")
        sheet = SHEET.format(name=folder.name, protocol=protocol, sample=1)
        (folder / "test.yaml").write_text(sheet, encoding="utf-8")
        return folder

    def run(self, **options: object) -> RunSummary:
        """Run the campaign; `stand_in.processed` has the tests of this run alone."""
        self.stand_in.processed.clear()
        return run_campaign(self.folders, self.stand_in, **options)  # type: ignore[arg-type]


def content_of(campaign: LabCampaign) -> dict[str, list[Any]]:
    """Rows of the catalog as it lies, without looking at the files of the tests."""
    catalog = open_catalog(campaign.processed, [])
    try:
        tables = ("tests", "results")
        return {
            name: sorted(catalog._fetch_all(f"select * from {name}"), key=repr) for name in tables
        }
    finally:
        catalog.close()
