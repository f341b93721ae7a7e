"""A lab's folder with one test in it, and what the program made of that test."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import pytest

from labpipe.cli import main
from labpipe.virtual_lab import simulate_test
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.instruments import NO_MISHAPS


@dataclass(frozen=True, slots=True)
class LabFolder:
    """One test in ``raw/c/<name>`` of a lab's folder, and where its results come."""

    home: Path
    name: str

    @property
    def raw(self) -> Path:
        return self.home / "raw" / "c" / self.name

    @property
    def sheet(self) -> Path:
        return self.raw / "test.yaml"

    @property
    def processed(self) -> Path:
        return self.home / "processed" / "c" / self.name

    @property
    def result(self) -> Path:
        return self.processed / "result.h5"

    @property
    def summary(self) -> dict[str, Any]:
        return _json(self.processed / "summary.json")

    @property
    def results(self) -> dict[str, dict[str, Any]]:
        return {entry["name"]: entry for entry in self.summary["results"]}

    @property
    def notes(self) -> dict[str, str]:
        return {entry["code"]: entry["message"] for entry in self.summary["quality"]}

    @property
    def truth(self) -> dict[str, Any]:
        return _json(self.raw / "truth.json")

    def override(self, key: str, value: str) -> None:
        """Add an override to the test sheet."""
        text = self.sheet.read_text(encoding="utf-8")
        text += "" if "overrides:" in text else "overrides:\n"
        self.sheet.write_text(
            f"{text}  {key}: {{value: {value}, because: a test of the software}}\n", "utf-8"
        )

    def edit(self, name: str, old: str, new: str) -> None:
        """Replace the one occurrence of a text in a file of the test."""
        content = (self.raw / name).read_bytes()
        assert content.count(old.encode()) == 1, (old, content.count(old.encode()))
        (self.raw / name).write_bytes(content.replace(old.encode(), new.encode()))

    def copy(self, home: Path) -> Self:
        shutil.copytree(self.home, home, dirs_exist_ok=True)
        return replace(self, home=home)


def _json(path: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return loaded


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
class RunSummary:
    """How a command ended and what it said."""

    status: int
    out: str
    err: str


Run = Callable[..., RunSummary]


def runner(capsys: pytest.CaptureFixture[str]) -> Run:
    """Give a function that runs a command in-process."""

    def run(*arguments: object) -> RunSummary:
        capsys.readouterr()
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as end:
            status = int(end.code or 0)
        output = capsys.readouterr()
        return RunSummary(status, output.out, output.err)

    return run
