from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe import __version__
from labpipe.campaign import batches
from labpipe.campaign.batches import Batch, Unseen, do_here, versions
from labpipe.campaign.outcomes import Outcome
from labpipe.campaign.workers import Crew
from labpipe.process.attempts import Task
from tests.builders.small_pulls import small_pulls


@pytest.fixture
def batch(tmp_path: Path) -> Batch:
    """Three tests by relative paths, of which the second is not there."""
    labs = small_pulls(tmp_path, 3)
    sheets = [lab.sheet.relative_to(tmp_path) for lab in labs]
    labs[1].sheet.unlink()
    tasks = [Task(sheet, Path("out", sheet.parent.name), figures=False) for sheet in sheets]
    return Batch(("run", "1"), tuple(tasks), tmp_path, None, versions())


@pytest.mark.slow
def test_tests_of_a_batch_in_their_order(batch: Batch) -> None:
    first, second, third = do_here(batch)
    assert isinstance(first, Outcome)
    assert isinstance(third, Outcome)
    assert second == Unseen()
    assert [first.sheet, third.sheet] == [batch.tasks[0].sheet, batch.tasks[2].sheet]
    assert (batch.home / "out" / "S-0002" / "result.h5").is_file()


def test_a_folder_that_is_not_there(batch: Batch) -> None:
    assert do_here(replace(batch, home=batch.home / "none")) == [Unseen()] * 3


@pytest.mark.slow
def test_the_process_is_kept_for_a_while(batch: Batch, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batches, "_IDLE", 1.0)
    made: list[Counted] = []

    class Counted(Crew[tuple[Path, Task], Outcome]):
        def __init__(self, *more: object, **others: object) -> None:
            super().__init__(*more, **others)  # type: ignore[arg-type]
            made.append(self)
            self.has_left = threading.Event()

        def leave(self) -> None:
            super().leave()
            self.has_left.set()

    monkeypatch.setattr(batches, "Crew", Counted)

    def in_a_thread_of_a_worker() -> None:
        do_here(batch)
        do_here(batch)
        assert len(made) == 1
        made[0].has_left.wait()
        do_here(batch)

    thread = threading.Thread(target=in_a_thread_of_a_worker)
    thread.start()
    thread.join()
    assert len(made) == 2
    made[1].has_left.wait()
    assert not any(worker.process for crew in made for worker in crew._workers)


def test_versions() -> None:
    assert versions()[0] == __version__
