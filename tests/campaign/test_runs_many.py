from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.runs import process_tests, run_jobs
from labpipe.errors import ProcessingError, UsageError
from labpipe.process.attempts import Refused
from labpipe.process.run import Processed
from labpipe.virtual_lab.sheet_texts import write_wire_sheet
from tests.builders.other_processes import Spoiled, spoil
from tests.builders.pulls import broken, pull
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def tests(tmp_path: Path) -> list[Path]:
    """Three pulls, of which the second lacks its export."""
    labs = [TensileLab(tmp_path, name) for name in ("P-1", "P-2", "P-3")]
    for seed, lab in enumerate(labs):
        travel, force = pull(slack=0.001, seed=seed)
        write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    labs[1].export.unlink()
    return [lab.sheet for lab in labs]


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_in_order_and_a_bad_one_does_not_stop_the_others(tests: list[Path], jobs: int) -> None:
    told: list[tuple[str, str]] = []

    def begin(test: Path) -> partial[None]:
        def say(name: str, stage: str) -> None:
            told.append((name, stage))

        return partial(say, test.parent.name)

    done = list(process_tests(tests, figures=lambda _: False, jobs=jobs, begin=begin))
    first, second, third = done
    assert isinstance(first, Processed)
    assert isinstance(third, Processed)
    assert (first.result.test, third.result.test) == ("P-1", "P-3")
    assert isinstance(second, Refused)
    assert second.test == tests[1]
    assert "expected a file, found none of that name" in second.reason
    assert told == [("P-1", "wait"), ("P-2", "wait"), ("P-3", "wait")]
    assert not first.result.recordings
    assert first.result.curve is None
    assert (first.folder / "result.h5").is_file()


@pytest.mark.slow
def test_several_at_a_time_give_the_same(tests: list[Path], tmp_path: Path) -> None:
    told: list[str] = []
    said = {}
    for many in (tests[:1], tests):
        out = tmp_path / f"of-{len(many)}"
        list(process_tests(many, out=out, figures=lambda _: False, begin=lambda _: told.append))
        said[len(many)] = (out / "P-1" / "result.h5").read_bytes()
    assert said[1] == said[3]
    assert told == ["read", "process", "write", "wait", "wait", "wait"]


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_jobs_are_run_and_their_errors_raised(tmp_path: Path, jobs: int) -> None:
    run_jobs([partial(write_wire_sheet, tmp_path / name) for name in "ab"], jobs=jobs)
    assert [(tmp_path / name / "wires.csv").is_file() for name in "ab"] == [True, True]
    (tmp_path / "c").write_text("a file", encoding="utf-8")
    with pytest.raises(FileExistsError):
        run_jobs([partial(write_wire_sheet, tmp_path / "c")], jobs=jobs)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_two_tests_that_would_go_to_one_folder(
    tests: list[Path], tmp_path: Path, jobs: int
) -> None:
    text = tests[2].read_text("utf-8").replace("test: P-3", "test: p-1")
    tests[2].write_text(text, "utf-8")
    out = tmp_path / "out"
    said = (
        "P-3.test.yaml: expected one test for each folder of results, found a second for .*out.p-1"
    )
    with pytest.raises(UsageError, match=said):
        list(process_tests(tests, out=out, jobs=jobs))
    assert not out.exists()
    done = list(process_tests(tests[:1] + tests[2:], figures=lambda _: False, jobs=jobs))
    assert [type(each) for each in done] == [Processed, Processed]  # each beside its exports


def test_a_test_and_its_own_result(tests: list[Path]) -> None:
    (done,) = process_tests(tests[:1], figures=lambda _: False)
    assert isinstance(done, Processed)
    with pytest.raises(
        UsageError, match=r"result\.h5: expected one test for each folder of results"
    ):
        list(process_tests([tests[0], done.folder / "result.h5"]))


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_that_is_killed_costs_one_test(
    tests: list[Path], monkeypatch: pytest.MonkeyPatch, jobs: int
) -> None:
    monkeypatch.setattr("labpipe.campaign.runs.Task", Spoiled)
    spoil(tests[0], "kill")
    first, second, third = process_tests(tests, figures=lambda _: False, jobs=jobs)
    assert isinstance(first, Refused)
    assert (first.code, first.reason) == (
        "process_died",
        f"{tests[0]}: expected a process that comes to its end, found that it was ended by the"
        " signal SIGKILL. Often the memory was used up: close other programs, or choose fewer"
        " --jobs.",
    )
    assert isinstance(second, Refused)
    assert "found none of that name" in second.reason
    assert isinstance(third, Processed)
    assert third.result.test == "P-3"


@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
def test_a_job_that_is_killed_is_told() -> None:
    killed = partial(signal.raise_signal, signal.SIGKILL)
    calls: list[Callable[[], Any]] = [partial(int, "1"), killed]
    with pytest.raises(ProcessingError, match=r"labpipe: expected a process .* by the signal"):
        run_jobs(calls, jobs=2)
