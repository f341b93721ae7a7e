"""Whatever happens to the files of a campaign, the catalog says what its rebuild says."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from labpipe.campaign.decisions import Decision
from labpipe.campaign.running import clear_failures, decide, look, rebuild
from labpipe.errors import LabpipeError
from tests.builders.kept_campaigns import KeptCampaign, content_of

NAMES = [f"T{number}" for number in range(5)]


class Accidents:
    """Things that happen to a campaign, one by one, at random."""

    def __init__(self, kept: KeptCampaign, seed: int) -> None:
        self.kept, self.chance = kept, random.Random(seed)
        self.said: list[str] = []

    def happen(self) -> None:
        happening = self.chance.choice(
            [self.run, self.run, self.export, self.no_export, self.sheet, self.odd_sheet,
             self.no_sheet, self.no_results, self.half_results, self.decision, self.replay,
             self.again]
        )  # fmt: skip
        name = self.chance.choice(NAMES)
        self.said.append(f"{happening.__name__} {name}")
        with suppress(FileNotFoundError):
            happening(name)

    def run(self, _: str) -> None:
        self.kept.run()

    def export(self, name: str) -> None:
        text = self.chance.choice(["60", "61", "doubt", "fail disk_full", "fail process_died"])
        (self.kept.raw / name / "frame.csv").write_text(text, "utf-8")

    def no_export(self, name: str) -> None:
        (self.kept.raw / name / "frame.csv").unlink()

    def sheet(self, name: str) -> None:
        self._write(name, lambda text: f"{text}# {self.chance.random()}\n")

    def odd_sheet(self, name: str) -> None:
        odd = ["test: [", "protocol: corrugated-tube", "\x00"]
        self._write(name, lambda _: self.chance.choice(odd))

    def _write(self, name: str, change: Callable[[str], str]) -> None:
        path = self.kept.raw / name / "test.yaml"
        path.write_text(change(path.read_text("utf-8")), "utf-8")

    def no_sheet(self, name: str) -> None:
        here, away = self.kept.raw / name / "test.yaml", self.kept.home / f"{name}.yaml"
        here.rename(away) if here.exists() else away.rename(here)

    def no_results(self, name: str) -> None:
        shutil.rmtree(self.kept.processed / name)

    def half_results(self, name: str) -> None:
        (self.kept.processed / name / "summary.json").write_text("{", "utf-8")

    def decision(self, name: str) -> None:
        word = self.chance.choice(["accept", "reject"])
        with suppress(LabpipeError):  # it was not processed yet
            decide(self.kept.folders, name, Decision("", "", word, "as it is", "A. Tester"))

    def replay(self, _: str) -> None:
        with suppress(LabpipeError):  # there is none
            clear_failures(self.kept.folders, self.chance.choice(["", "disk_full"]))

    def again(self, name: str) -> None:
        shutil.rmtree(self.kept.raw / name)
        self.kept.add(name, self.chance.choice(["60", "doubt"]))


def follow(home: Path, seed: int, steps: int) -> None:
    kept = KeptCampaign(home)
    for name in NAMES:
        kept.add(name)
    accidents = Accidents(kept, seed)
    for _ in range(steps):
        accidents.happen()
        look(kept.folders)
        before = content_of(kept)
        rebuild(kept.folders)
        assert content_of(kept) == before, accidents.said[-6:]
    kept.run()
    kept.run()
    assert kept.stand_in.processed == []


def test_some_accidents(tmp_path: Path) -> None:
    follow(tmp_path, 1, 25)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 10))
def test_many_accidents(tmp_path: Path, seed: int) -> None:
    follow(tmp_path, seed, 150)
