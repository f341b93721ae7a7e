from __future__ import annotations

import pickle
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.campaign.outcomes import Outcome, outcome_of, settled
from labpipe.campaign.workers import Died, Raised
from labpipe.errors import CODES
from labpipe.process.attempts import Task
from tests.builders.small_pulls import small_pulls


def test_the_first_result_that_is_not_ok_counts(tmp_path: Path) -> None:
    lab = small_pulls(tmp_path, 1)[0]
    said = outcome_of(Task(lab.sheet, figures=False))
    assert (said.folder, said.run) == (lab.processed, lab.summary["run"])
    first = next(each for each in lab.results.values() if each["status"] != "ok")
    reason = first["reasons"][0]
    assert said.state == "doubtful"
    assert said.code == reason["code"]
    assert said.reason == f"{first['name']}: {reason['message']}"
    assert said.seconds > 0.0


def test_all_is_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.process.run import Processed, process_test

    def without_doubt(sheet: Path, **more: object) -> Processed:
        done = process_test(sheet, figures=False)
        sure = tuple(each for each in done.result.results if each.status == "ok")
        return replace(done, result=replace(done.result, results=sure))

    monkeypatch.setattr("labpipe.process.attempts.process_test", without_doubt)
    said = outcome_of(Task(small_pulls(tmp_path, 1)[0].sheet))
    assert (said.state, said.code, said.reason) == ("ok", "", "")


def test_what_came_of_a_process(tmp_path: Path) -> None:
    task = Task(small_pulls(tmp_path, 1)[0].sheet, run="0a")
    died = settled(task, Died(-signal.SIGTERM))
    assert (died.state, died.code, died.run) == ("failed", "process_died", "0a")
    late = settled(task, Died(-signal.SIGTERM, 120.0))
    assert late.code == "time_limit"
    assert "expected an end within 2 minutes, found none" in late.reason
    assert {died.code, late.code} <= CODES.keys()
    done = Outcome(task.sheet, None, "ok")
    assert settled(task, done) is done
    with pytest.raises(ZeroDivisionError):
        settled(task, Raised(ZeroDivisionError()))


def test_an_outcome_is_small() -> None:
    said = Outcome(Path("/raw/c/t/test.yaml"), Path("/processed/c/t"), "ok", run="0" * 64)
    assert len(pickle.dumps(said)) < 400
