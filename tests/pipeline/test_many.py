from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from labpipe.errors import UsageError
from labpipe.pipeline.many import Refused, process_tests, run_jobs
from labpipe.pipeline.process import Processed
from labpipe.virtual_lab.wire_sheet import write_wire_sheet
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
    assert list(dict.fromkeys(name for name, _ in told)) == ["P-1", "P-2", "P-3"]
    assert not first.result.recordings
    assert first.result.curve is None
    assert (first.folder / "result.h5").is_file()


def test_several_at_a_time_give_the_same(tests: list[Path], tmp_path: Path) -> None:
    said = {}
    for jobs in (1, 3):
        out = tmp_path / f"by-{jobs}"
        list(process_tests(tests[:1], out=out, figures=lambda _: False, jobs=jobs))
        said[jobs] = json.loads((out / "P-1" / "summary.json").read_text(encoding="utf-8"))
    assert said[1] == said[3]


@pytest.mark.parametrize("jobs", [1, 2])
def test_jobs_are_run_and_their_errors_raised(tmp_path: Path, jobs: int) -> None:
    run_jobs([partial(write_wire_sheet, tmp_path / name) for name in "ab"], jobs=jobs)
    assert [(tmp_path / name / "wires.csv").is_file() for name in "ab"] == [True, True]
    (tmp_path / "c").write_text("a file", encoding="utf-8")
    with pytest.raises(FileExistsError):
        run_jobs([partial(write_wire_sheet, tmp_path / "c")], jobs=jobs)


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
    with pytest.raises(UsageError, match=r"result\.h5: expected one test for each folder of results"):
        list(process_tests([tests[0], done.folder / "result.h5"]))
