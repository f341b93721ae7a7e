"""Small synthetic cantilever tests on disk, and the commands run on them in-process."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from labpipe.cli import main
from labpipe.virtual_lab import NO_MISHAPS, CantileverScenario, simulate_test

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
class Lab:
    """One test in ``raw/c/T1`` of a lab's folder, and where its results come."""

    home: Path

    @property
    def raw(self) -> Path:
        return self.home / "raw" / "c" / TEST

    @property
    def processed(self) -> Path:
        return self.home / "processed" / "c" / TEST

    @property
    def result(self) -> Path:
        return self.processed / "result.h5"

    @property
    def summary(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.processed / "summary.json").read_text("utf-8"))
        return found

    @property
    def results(self) -> dict[str, dict[str, Any]]:
        return {each["name"]: each for each in self.summary["results"]}

    @property
    def truth(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.raw / "truth.json").read_text("utf-8"))
        return found

    def edit(self, name: str, old: str, new: str) -> None:
        """Replace the one occurrence of a text in a file of the test."""
        path = self.raw / name
        text = path.read_bytes().decode()
        assert text.count(old) == 1, (old, text.count(old))
        path.write_bytes(text.replace(old, new).encode())

    def override(self, key: str, value: str) -> None:
        """Add an override to the test sheet."""
        with (self.raw / "test.yaml").open("a", encoding="utf-8") as sheet:
            sheet.write(f"  {key}: {{value: {value}, because: a test of the software}}\n")

    def copy(self, home: Path) -> Lab:
        shutil.copytree(self.home, home, dirs_exist_ok=True)
        return Lab(home)


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
