"""Small synthetic cantilever tests on disk, and the commands run on them in-process."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from labpipe.cli import main
from labpipe.virtual_lab import NO_MISHAPS, CantileverScenario, simulate_test
from tests.builders.lab_folders import LabFolder

TEST = "T1"


def small_scenario(*, cycles: int = 2, rate: float = 200.0) -> CantileverScenario:
    """A test of half a minute: short and quick strokes, no mishaps."""
    usual = CantileverScenario()
    return replace(
        usual,
        name=TEST,
        speed=4e-3,
        rest=2.5,
        mechanics=replace(
            usual.mechanics, cycles=cycles, stroke=0.012, steps_per_branch=60, n_stations=24
        ),
        clocks=replace(usual.clocks, rate=rate),
        mishaps=NO_MISHAPS,
    )


@dataclass(frozen=True, slots=True)
class Lab(LabFolder):
    """One cantilever test."""

    name: str = TEST


def make_lab(home: Path, scenario: CantileverScenario, seed: int = 1) -> Lab:
    lab = Lab(home)
    simulate_test(scenario, lab.raw, seed)
    return lab


State = dict[str, tuple[str, int]]


def state(folder: Path) -> State:
    """Content and time of change of every file below a folder."""
    return {
        str(path.relative_to(folder)): (
            hashlib.sha256(path.read_bytes()).hexdigest(),
            path.stat().st_mtime_ns,
        )
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@dataclass(frozen=True, slots=True)
class Ran:
    """How a command ended and what it said."""

    status: int
    out: str
    err: str


Run = Callable[..., Ran]


def runner(capsys: pytest.CaptureFixture[str]) -> Run:
    """Give a function that runs a command in-process."""

    def run(*arguments: object) -> Ran:
        capsys.readouterr()
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as end:
            status = int(end.code or 0)
        said = capsys.readouterr()
        return Ran(status, said.out, said.err)

    return run
