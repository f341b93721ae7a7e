"""A watch with a clock of its own, on real files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from labpipe.campaign.executors import Outcome
from labpipe.campaign.pairing import pair_test
from labpipe.campaign.standing_files import StandingFiles
from labpipe.campaign.watching import Watcher
from labpipe.errors import ProtocolError, StoreError
from tests.builders.small_tests import Lab

PLAN = """\
version: 1
protocol: wire-cantilever
pair: {name: "{type}-{length mm}-{sample}"}
specimen: {spool: s}
"""


@dataclass
class Campaign:
    """A campaign whose tests are processed by saying so."""

    home: Path
    asked: list[str] = field(default_factory=list)
    done: list[str] = field(default_factory=list)
    fails: dict[str, str] = field(default_factory=dict)
    trouble: list[Exception] = field(default_factory=list)

    @property
    def raw(self) -> Path:
        return self.home / "raw" / "c"

    def unprocessed(self, sheets: Iterable[Path]) -> list[Path]:
        return [sheet for sheet in sheets if sheet.parent.name not in self.done]

    def process(self, sheet: Path, *, again: bool = False) -> Outcome | None:
        name = sheet.parent.name
        self.asked.append(name)
        if self.trouble:
            raise self.trouble.pop()
        folder = self.home / "processed" / "c" / name
        if name in self.fails:
            return Outcome(sheet, folder, "failed", self.fails[name], "x.mat: expected a. Do.")
        if name in self.done and not again:
            return None
        folder.mkdir(parents=True, exist_ok=True)
        peak = {"name": "peak_force.1", "value": 1.0, "unit": "N", "status": "ok", "reasons": []}
        said = {"protocol": "p", "specimen": {"type": "A2"}, "results": [peak], "quality": []}
        (folder / "summary.json").write_text(json.dumps(said), encoding="utf-8")
        self.done.append(name)
        return Outcome(sheet, folder, "ok")

    def results(self) -> dict[Path, str]:
        folder = self.home / "processed" / "c"
        return {each: each.name for each in folder.iterdir()} if folder.is_dir() else {}


@dataclass
class Bench:
    """A watch, what it said, and a clock that goes when it is told to."""

    campaign: Campaign
    now: float = 1000.0
    said: list[str] = field(default_factory=list)
    drawn: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.watcher = self.begin()

    def begin(self) -> Watcher:
        return Watcher(
            self.campaign,
            pair=lambda candidate, plan, waited: pair_test(candidate, plan, waited=waited),
            draw=lambda folder: self.drawn.append(folder.name),
            say=self.said.append,
            clock=lambda: self.now,
        )

    def go(self, seconds: float, step: float = 0.5) -> str:
        """Look every half second; what was said meanwhile."""
        before, end = len(self.said), self.now + seconds
        while self.now < end:
            while self.watcher.look():
                pass
            self.now += step
        return "\n".join(self.said[before:])


@pytest.fixture(scope="module")
def exports(pristine: Lab) -> dict[str, bytes]:
    return {name: (pristine.raw / name).read_bytes() for name in ("force.mat", "take.csv")}


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    campaign = Campaign(tmp_path)
    campaign.raw.mkdir(parents=True)
    (campaign.raw / "campaign.yaml").write_text(PLAN, encoding="utf-8")
    return Bench(campaign)


def put(bench: Bench, test: str, exports: dict[str, bytes], *names: str) -> Path:
    folder = bench.campaign.raw / test
    folder.mkdir(exist_ok=True)
    for name in names or exports:
        (folder / name).write_bytes(exports[name])
    return folder


def test_a_test_is_paired_processed_and_judged_once(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    assert bench.go(5) == ""
    put(bench, "A2-085-1", exports)
    said = bench.go(3).splitlines()
    assert said[0] == "A2-085-1: wrote A2-085-1/test.yaml"
    assert said[-3:] == [
        "A2-085-1: WELL, 1 ok",
        "  peak_force.1 1 N; the first of its group",
        "  nothing to look at: the specimen can come off",
    ]
    assert bench.drawn == ["A2-085-1"]
    assert bench.go(20) == ""
    assert bench.campaign.asked == ["A2-085-1"]
    put(bench, "A2-085-2", exports)
    assert "(so far 1); n = 1 so far, too few to judge" in bench.go(3)


def test_a_growing_file_is_waited_for(bench: Bench, exports: dict[str, bytes]) -> None:
    folder = put(bench, "A2-085-1", exports, "take.csv")
    whole = exports["force.mat"]
    for end in range(0, len(whole), len(whole) // 6):
        (folder / "force.mat").write_bytes(whole[:end])
        assert bench.go(1.5) == ""
    (folder / "force.mat").write_bytes(whole)
    assert "WELL" in bench.go(3)


def test_a_role_that_is_missing_is_said_and_does_not_delay(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    put(bench, "A2-085-1", exports, "force.mat")
    assert bench.go(60) == "A2-085-1: waits for markers"
    put(bench, "A2-085-1", exports, "take.csv")
    began = bench.now
    while not bench.campaign.done:
        bench.go(0.5)
    assert bench.now - began <= 3.0


@pytest.mark.slow
def test_a_file_that_cannot_be_read_yet_is_said_after_a_while_and_read_once_it_can_be(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    folder = put(bench, "A2-085-1", exports)
    (folder / "force.mat").write_bytes(exports["force.mat"][:5000])
    assert bench.go(50, step=5) == ""
    said = bench.go(30, step=5)
    assert said.startswith("A2-085-1: force.mat cannot be read yet (expected a whole MAT v5 file")
    assert bench.go(3600, step=30) == "A2-085-1: force.mat cannot be read after an hour; waited for"
    assert bench.go(3600, step=30) == ""
    (folder / "force.mat").write_bytes(exports["force.mat"])
    assert "WELL" in bench.go(3)


def test_a_file_that_grows_for_an_hour_is_said_once(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    folder = put(bench, "A2-085-1", exports, "take.csv")
    said = []
    for minute in range(130):
        (folder / "force.mat").write_bytes(bytes(minute + 1))
        said.append(bench.go(60, step=60))
    assert [each for each in said if each] == [
        "A2-085-1: force.mat is still being written after an hour; waited for"
    ]
    (folder / "force.mat").write_bytes(exports["force.mat"])
    assert "WELL" in bench.go(3)


def test_a_locked_file_is_waited_for(
    bench: Bench, exports: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(bench, "A2-085-1", exports)
    with monkeypatch.context() as patch:
        patch.setattr("labpipe.campaign.standing_files._opens", lambda path: path.suffix != ".mat")
        assert bench.go(59, step=1) == ""
        assert bench.go(10, step=1) == (
            "A2-085-1: force.mat cannot be opened, another program holds it; waited for"
        )
        assert "still cannot be opened after an hour" in bench.go(3600, step=30)
    assert "WELL" in bench.go(3)


def test_a_folder_that_goes_away_is_said_once_and_waited_for(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    put(bench, "A2-085-1", exports)
    bench.go(3)
    away = bench.campaign.home / "away"
    bench.campaign.raw.rename(away)
    assert bench.go(30) == f"{bench.campaign.raw}: no such file or directory; waited for"
    away.rename(bench.campaign.raw)
    put(bench, "A2-085-2", exports)
    said = bench.go(6)
    assert said.startswith(f"{bench.campaign.raw}: is there again\n")
    assert "A2-085-2: WELL" in said
    assert bench.campaign.asked == ["A2-085-1", "A2-085-2"]


def test_exports_that_vanish_while_they_are_processed_are_no_failure(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    folder = put(bench, "A2-085-1", exports)
    take, away = folder / "take.csv", bench.campaign.home / "take.csv"
    process = bench.campaign.process

    def gone(sheet: Path, *, again: bool = False) -> Outcome:
        assert not again
        take.rename(away)
        bench.campaign.done.append("A2-085-1")  # nothing changed since, as the catalog sees it
        bench.campaign.process = process  # type: ignore[method-assign]
        return Outcome(sheet, None, "failed", "unreadable_export", "gone")

    bench.campaign.process = gone  # type: ignore[method-assign]
    assert "FAILED" not in bench.go(10)
    away.rename(take)
    assert "A2-085-1: WELL" in bench.go(10)


def test_trouble_with_the_catalog_is_tried_again(bench: Bench, exports: dict[str, bytes]) -> None:
    bench.campaign.trouble = [StoreError("catalog.sqlite: locked.")]
    put(bench, "A2-085-1", exports)
    said = bench.go(10)
    assert "A2-085-1: catalog.sqlite: locked." in said
    assert "A2-085-1: WELL" in said


def test_a_test_that_fails_is_said_and_processed_again_once_it_changed(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    bench.campaign.fails = {"A2-085-1": "cannot_process"}
    folder = put(bench, "A2-085-1", exports)
    assert bench.go(20).splitlines()[-3:] == [
        "A2-085-1: FAILED (cannot_process)",
        "  x.mat: expected a. Do.",
        "  while it is mounted: correct the test sheet; it is processed as soon as you have",
    ]
    bench.campaign.fails = {}
    sheet = folder / "test.yaml"
    sheet.write_text(sheet.read_text("utf-8") + "# corrected\n", "utf-8")
    assert "A2-085-1: WELL" in bench.go(4)


def test_what_is_to_be_filled_in_is_waited_for(bench: Bench, exports: dict[str, bytes]) -> None:
    (bench.campaign.raw / "campaign.yaml").write_text(
        PLAN.replace("specimen: {spool: s}\n", ""), encoding="utf-8"
    )
    folder = put(bench, "A2-085-1", exports)
    said = bench.go(20)
    assert said.startswith("campaign.yaml was read again")
    assert said.splitlines()[-1] == "  to be filled in: spool; it is processed then"
    assert bench.campaign.asked == []
    sheet = folder / "test.yaml"
    text = sheet.read_text("utf-8").replace("spool:   # to be filled in", "spool: s")
    sheet.write_text(text, "utf-8")
    assert "A2-085-1: WELL" in bench.go(4)


def test_a_campaign_yaml_that_became_wrong_does_not_count(
    bench: Bench, exports: dict[str, bytes]
) -> None:
    bench.go(1)
    (bench.campaign.raw / "campaign.yaml").write_text("version: 1\nprotocl: x\n", encoding="utf-8")
    said = bench.go(10)
    assert "Did you mean 'protocol'?" in said
    assert said.count("the last campaign.yaml that was right still counts") == 1
    put(bench, "A2-085-1", exports)
    assert "A2-085-1: WELL" in bench.go(4)


def test_a_campaign_yaml_that_is_wrong_at_the_start_is_refused(bench: Bench) -> None:
    (bench.campaign.raw / "campaign.yaml").write_text("version: 2\n", encoding="utf-8")
    with pytest.raises(ProtocolError):
        bench.begin()


def test_a_restart_does_nothing_twice(bench: Bench, exports: dict[str, bytes]) -> None:
    for number in (1, 2):
        put(bench, f"A2-085-{number}", exports)
    bench.go(10)
    put(bench, "A2-085-3", exports)  # while no watch was there
    before = len(bench.said)
    bench.watcher = bench.begin()
    bench.go(10)
    assert sorted(bench.campaign.asked) == ["A2-085-1", "A2-085-2", "A2-085-3"]
    verdicts = [each for each in bench.said[before:] if "WELL" in each]
    assert len(verdicts) == 1


def test_what_is_not_used_is_said_once(bench: Bench, exports: dict[str, bytes]) -> None:
    raw = bench.campaign.raw
    (raw / "loose.csv").write_bytes(b"x")
    folder = put(bench, "A2-085-1", exports)
    (folder / "a\nb\x1b[2J.csv").write_bytes(exports["take.csv"])
    said = bench.go(200, step=2)
    assert "loose.csv: not used, it is in no folder of a test" in said
    assert "A2-085-1/a\\nb\\x1b[2J.csv: not used, its name has control characters" in said
    assert "\x1b" not in said
    assert "A2-085-1: WELL" in said
    assert bench.go(200, step=2) == ""
    assert (folder / "a\nb\x1b[2J.csv").read_bytes() == exports["take.csv"]


def test_the_newest_test_comes_first(bench: Bench, exports: dict[str, bytes]) -> None:
    for number in (1, 3, 2):
        put(bench, f"A2-085-{number}", exports)
        bench.watcher.look()
        bench.now += 0.1
    bench.now += 10.0
    while bench.watcher.look():
        pass
    assert bench.campaign.asked == ["A2-085-2", "A2-085-3", "A2-085-1"]


def test_tests_of_long_ago_are_looked_at_now_and_then(
    bench: Bench, exports: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(5):
        put(bench, f"A2-085-{number}", exports)
    bench.go(120)
    looks: list[Path] = []
    look = StandingFiles.look

    def counted(files: StandingFiles, path: Path) -> str:
        looks.append(path)
        return look(files, path)

    monkeypatch.setattr(StandingFiles, "look", counted)
    assert bench.go(40 * 0.5) == ""
    assert len(looks) == 5 * 3  # each file once in 40 looks
    sheet = bench.campaign.raw / "A2-085-3" / "test.yaml"
    sheet.write_text(sheet.read_text("utf-8") + "# later\n", "utf-8")
    bench.go(40 * 0.5 + 2.0)
    assert bench.campaign.asked[5:] == ["A2-085-3"]


def test_a_test_that_is_taken_away_is_forgotten(bench: Bench, exports: dict[str, bytes]) -> None:
    folder = put(bench, "A2-085-1", exports, "force.mat")
    bench.go(3)
    shutil.rmtree(folder)
    assert bench.go(10) == ""
