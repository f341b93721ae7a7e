from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from labpipe.campaign.executors import Outcome, Task, executor_of, local
from labpipe.errors import UsageError
from tests.builders.other_processes import Spoiled, spoil
from tests.builders.pulls import broken, pull
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def labs(tmp_path: Path) -> list[TensileLab]:
    """Four pulls."""
    labs = [TensileLab(tmp_path, f"P-{number}") for number in range(1, 5)]
    for seed, lab in enumerate(labs):
        travel, force = pull(slack=0.001, seed=seed)
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    return labs


def outcomes_of(labs: list[TensileLab], *, jobs: int, limit: float | None = None) -> list[Outcome]:
    tasks = [Spoiled(lab.sheet, lab.processed, figures=False, run="0a") for lab in labs]
    found = {each.sheet: each for each in local(jobs, limit=limit)(tasks)}
    return [found[lab.sheet] for lab in labs]


@pytest.mark.slow
def test_each_test_has_an_outcome(labs: list[TensileLab]) -> None:
    labs[1].export.unlink()
    first, second, third, _ = outcomes_of(labs, jobs=2)
    assert first.folder == labs[0].processed
    assert first.run == labs[0].summary["run"]
    assert first.seconds > 0.0
    doubted = [each for each in labs[2].results.values() if each["status"] != "ok"]
    assert third.state == ("doubtful" if doubted else "ok")
    assert third.code == (doubted[0]["reasons"][0]["code"] if doubted else "")
    assert (second.state, second.code) == ("failed", "missing_export")
    assert "expected a file, found none of that name" in second.reason


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
@pytest.mark.parametrize(
    ("end", "how"),
    [
        ("abort", "by the signal SIGABRT"),
        ("segfault", "by the signal SIGSEGV"),
        ("kill", "by the signal SIGKILL"),
        ("exit", "with exit code 3"),
    ],
)
def test_a_crash_costs_that_test(labs: list[TensileLab], end: str, how: str) -> None:
    spoil(labs[0].sheet, end)
    spoil(labs[2].sheet, end)
    found = outcomes_of(labs, jobs=2)
    assert [each.state == "failed" for each in found] == [True, False, True, False]
    assert (found[0].code, found[0].run) == ("process_died", "0a")
    assert f"found that it was ended {how}." in found[0].reason
    said = json.loads((labs[2].processed / "failure.json").read_text("utf-8"))
    assert (said["code"], said["reason"], said["run"]) == ("process_died", found[2].reason, "0a")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
def test_a_test_that_takes_too_long_is_given_up(labs: list[TensileLab]) -> None:
    spoil(labs[1].sheet, "hang")
    found = outcomes_of(labs[1:], jobs=2, limit=10.0)
    assert [each.state == "failed" for each in found] == [True, False, False]
    assert found[0].code == "time_limit"
    assert "expected an end within 0.166667 minutes, found none" in found[0].reason


@pytest.mark.slow
def test_tasks_are_taken_as_processes_become_free(labs: list[TensileLab]) -> None:
    taken: list[str] = []

    def tasks() -> Iterator[Task]:
        for lab in labs:
            taken.append(lab.name)
            yield Task(lab.sheet, lab.processed, figures=False)

    outcomes = local(1)(tasks())
    assert not taken
    next(outcomes)
    assert taken == ["P-1", "P-2"]
    outcomes.close()
    assert taken == ["P-1", "P-2"]
    assert labs[1].result.is_file()  # what was begun is brought to its end


@pytest.mark.parametrize("text", ["dask", "dask://", "dask://host", "dask://:8786", "slurm", ""])
def test_no_executor_of_that_name(text: str) -> None:
    said = rf"--executor: expected local, or dask://HOST:PORT, found '{text}'. `dask scheduler`"
    with pytest.raises(UsageError, match=said):
        executor_of(text)


@pytest.mark.slow
def test_executors_by_name(labs: list[TensileLab]) -> None:
    (done,) = executor_of("local")([Task(labs[0].sheet, labs[0].processed, figures=False)])
    assert done.state != "failed"
    assert not list(executor_of("dask://nowhere:1")([]))  # it does not connect for nothing
