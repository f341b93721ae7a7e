from __future__ import annotations

import os
from pathlib import Path

import pytest

from labpipe.campaign.standing_files import StandingFiles


class Clock:
    """A clock that goes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_file_stands_still_once_it_did_not_change_for_long_enough(
    tmp_path: Path, clock: Clock
) -> None:
    files, path = StandingFiles(clock, 2.0), tmp_path / "x"
    assert files.look(path) == "gone"
    path.write_bytes(b"1")
    assert files.look(path) == "growing"
    clock.now += 1.9
    assert files.look(path) == "growing"
    path.write_bytes(b"12")
    assert files.look(path) == "growing"
    clock.now += 1.9
    assert files.look(path) == "growing"
    assert files.moving_for(path) == pytest.approx(3.8)
    clock.now += 0.1
    assert files.look(path) == "still"
    assert clock.now - files.since([path]) == pytest.approx(2.0)
    path.unlink()
    assert files.look(path) == "gone"
    assert files.mark(path) is None


def test_a_file_that_changes_at_the_same_size_grows(tmp_path: Path, clock: Clock) -> None:
    files, path = StandingFiles(clock, 2.0), tmp_path / "x"
    path.write_bytes(b"1")
    files.look(path)
    clock.now += 5.0
    assert files.look(path) == "still"
    os.utime(path, (1.0, 1.0))
    assert files.look(path) == "growing"
    assert files.moving_for(path) == 0.0  # it stood still before


def test_the_clock_of_the_drive_does_not_count(tmp_path: Path, clock: Clock) -> None:
    files, path = StandingFiles(clock, 2.0), tmp_path / "x"
    path.write_bytes(b"1")
    os.utime(path, (4e9, 4e9))
    files.look(path)
    clock.now += 2.0
    assert files.look(path) == "still"


def test_a_file_that_cannot_be_opened_is_locked(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, path = StandingFiles(clock, 2.0), tmp_path / "x"
    path.write_bytes(b"1")
    files.look(path)
    clock.now += 2.0

    def refused(*_: object, **__: object) -> None:
        raise PermissionError

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refused)
        assert files.look(path) == "locked"
    assert files.look(path) == "still"
