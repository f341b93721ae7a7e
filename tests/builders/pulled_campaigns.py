"""A small campaign of synthetic pulls, processed, and decisions on its tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from labpipe.campaign.decisions import Decision
from labpipe.process.run import Task, process
from labpipe.store.result_files import read_run
from tests.builders.pulls import pull
from tests.builders.tensile_tests import TensileLab, write_pull

WHEN = "2026-03-10T08:00:00+00:00"
WHY = "slipped <b>twice</b>"


def make_pulls(home: Path, names: Sequence[str] = ("T-1", "T-2", "T-3")) -> Path:
    """Pull and process a tube of each name; gives the folder of the results."""
    folder = home
    for seed, name in enumerate(names):
        lab = TensileLab(home, name)
        travel, force = pull(stiffness=5e3, slack=0.001, seed=seed)
        write_pull(lab, "tensile", force, travel)
        folder = process(Task(lab.sheet, figures=False)).folder.parent
    return folder


def decision_on(processed: Path, name: str, decision: str = "reject") -> Decision:
    """A decision on the results of a test as they stand."""
    run = read_run(processed / name / "result.h5")
    return Decision(name, run, decision, WHY, "A. Tester", WHEN)
