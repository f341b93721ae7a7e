from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.campaign.executors import Outcome, Task, local
from tests.builders.pulls import broken, pull
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def labs(tmp_path: Path) -> list[TensileLab]:
    """Three pulls, of which the second lacks its export."""
    labs = [TensileLab(tmp_path, name) for name in ("P-1", "P-2", "P-3")]
    for seed, lab in enumerate(labs):
        travel, force = pull(slack=0.001, seed=seed)
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    labs[1].export.unlink()
    return labs


def test_each_test_has_an_outcome(labs: list[TensileLab], tmp_path: Path) -> None:
    tasks = [Task(lab.sheet, tmp_path / "out" / lab.name, figures=False) for lab in labs]
    outcomes = {each.sheet: each for each in local(2)(tasks)}
    first, second, third = (outcomes[lab.sheet] for lab in labs)
    assert isinstance(first, Outcome)
    assert first.folder == tmp_path / "out" / "P-1"
    said = json.loads((first.folder / "summary.json").read_text("utf-8"))
    assert first.run == said["run"]
    assert first.seconds > 0.0
    assert third.state in ("ok", "doubtful")
    assert (second.state, second.code) == ("failed", "unreadable_export")
    assert "expected a file, found none of that name" in second.reason
