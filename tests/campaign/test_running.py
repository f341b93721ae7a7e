"""Runs of a campaign: what is processed, what comes of it, and a catalog that a rebuild repeats."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.campaign_files import find_outcome
from labpipe.campaign.catalog import DOUBTFUL, FAILED, OK, PENDING, STALE, Entry, read_outcome
from labpipe.campaign.decisions import Decision
from labpipe.campaign.running import (
    clear_failures,
    decide,
    find_unknown_files,
    open_campaign,
    read_overview,
    rebuild,
    run_test,
)
from labpipe.errors import LabpipeError, StoreError, UsageError
from labpipe.process.run import Processed
from labpipe.store.summaries import FailedTest, write_failure
from tests.builders.kept_campaigns import KeptCampaign, content_of


@pytest.fixture
def kept(tmp_path: Path) -> KeptCampaign:
    """Three tests: one good, one doubtful, one that fails."""
    kept = KeptCampaign(tmp_path)
    for name, export in (("T1", "62.5"), ("T2", "doubt"), ("T3", "fail unreadable_export")):
        kept.add(name, export)
    return kept


def states(kept: KeptCampaign) -> dict[str, str]:
    return {folder: row.state for folder, row in read_overview(kept.folders).rows.items()}


def test_run_processes_new_and_changed_tests_only(kept: KeptCampaign) -> None:
    expected = {"T1": OK, "T2": DOUBTFUL, "T3": FAILED}
    assert set(states(kept).values()) == {PENDING}
    ran = kept.run()
    assert kept.stand_in.processed == ["T1", "T2", "T3"]
    assert ran.processed == ["T1", "T2", "T3"]
    rows = read_overview(kept.folders).rows
    assert {name: row.state for name, row in rows.items()} == expected
    assert (rows["T3"].code, rows["T3"].reason[:5]) == ("unreadable_export", "a unr")
    kept.run()
    assert kept.stand_in.processed == []
    (kept.raw / "T2" / "frame.csv").write_text("63.5", encoding="utf-8")
    sheet = kept.raw / "T1" / "test.yaml"
    sheet.write_text(sheet.read_text("utf-8") + "operator: somebody\n", "utf-8")
    kept.add("T4")
    rows = read_overview(kept.folders).rows
    assert {name: (row.state, row.why) for name, row in rows.items() if row.why} == {
        "T1": (STALE, "sheet changed"),
        "T2": (STALE, "file changed (frame.csv)"),
    }
    kept.run()
    assert kept.stand_in.processed == ["T1", "T2", "T4"]


def test_a_changed_protocol_runs_its_tests_again(
    kept: KeptCampaign, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(kept.home)
    (kept.home / "protocols").mkdir()
    own = kept.home / "protocols" / "own.yaml"
    text = (repository / "protocols" / "corrugated-tube.yaml").read_text("utf-8")
    own.write_text(text, "utf-8")
    kept.add("P", protocol="own")
    kept.run()
    own.write_text(f"{text}# nothing but a remark\n", "utf-8")
    kept.run()
    assert kept.stand_in.processed == []
    own.write_text(text.replace("crosshead_speed: 0.423", "crosshead_speed: 0.5"), "utf-8")
    assert read_overview(kept.folders).rows["P"].why == "protocol changed"
    kept.run()
    assert kept.stand_in.processed == ["P"]


def test_results_remain_without_exports(kept: KeptCampaign) -> None:
    kept.run()
    shutil.rmtree(kept.raw)
    kept.raw.mkdir()
    assert states(kept) == {"T1": OK, "T2": DOUBTFUL, "T3": FAILED}
    kept.run()
    assert kept.stand_in.processed == []
    shutil.rmtree(kept.processed / "T2")
    assert set(states(kept)) == {"T1", "T3"}


def test_failures_are_cleared_by_code(kept: KeptCampaign) -> None:
    kept.add("T4", "fail process_died")
    kept.run()
    message = "expected failures with the code 'proces', found process_died, unreadable_export"
    with pytest.raises(UsageError, match=message):
        clear_failures(kept.folders, "proces")
    for code, names in (("process_died", ["T4"]), ("", ["T3", "T4"])):
        assert clear_failures(kept.folders, code) == names
        assert states(kept)["T4"] == PENDING
        kept.run()
        assert kept.stand_in.processed == names


def test_newer_results_are_kept_until_cleared(kept: KeptCampaign) -> None:
    kept.run()
    path = kept.processed / "T1" / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "schema": 99}), "utf-8")
    row = read_overview(kept.folders).rows["T1"]
    assert (row.state, row.code) == (FAILED, "newer_result")
    assert "expected version 2 or less, found version 99. A newer labpipe made it" in row.reason
    kept.run()
    assert kept.stand_in.processed == []
    kept.run(forced=clear_failures(kept.folders, "newer_result"))
    assert kept.stand_in.processed == ["T1"]


@pytest.mark.parametrize(
    "damage",
    [
        *("", "{", "[]", '{"test": 1}'),
        {"specimen": None},
        {"inputs": [1]},
        {"results": [{"name": "x", "value": "many"}]},
    ],
)
def test_test_with_damaged_summary_is_processed_again(
    kept: KeptCampaign, damage: str | dict[str, Any]
) -> None:
    kept.run()
    path = kept.processed / "T1" / "summary.json"
    before = json.loads(path.read_text("utf-8"))
    path.write_text(damage if isinstance(damage, str) else json.dumps(before | damage), "utf-8")
    row = read_overview(kept.folders).rows["T1"]
    assert row.state == PENDING
    assert row.why.startswith("summary.json ")
    kept.run()
    assert (kept.stand_in.processed, states(kept)["T1"]) == (["T1"], OK)


def test_two_simultaneous_runs_share_the_tests(kept: KeptCampaign) -> None:
    """Two runs at a time: no test is processed twice, none is forgotten, nothing is rebuilt."""
    other = KeptCampaign(kept.home)
    second = []

    def meanwhile(name: str) -> None:
        with pytest.raises(
            StoreError, match="expected no process that works on the campaign, found process"
        ):
            rebuild(kept.folders)
        second.append(other.run())

    kept.stand_in.before = meanwhile
    first = kept.run()
    assert kept.stand_in.processed == ["T1"]
    assert other.stand_in.processed == ["T2", "T3"]
    assert second[0].elsewhere == ["T1"]
    assert first.overview.counts == {OK: 1, DOUBTFUL: 1, FAILED: 1}


@pytest.mark.parametrize("error", [KeyboardInterrupt(), StoreError("the scheduler is gone")])
def test_interrupted_run_releases_its_claims(kept: KeptCampaign, error: BaseException) -> None:
    def before(name: str) -> None:
        if name == "T2":
            raise error

    kept.stand_in.before = before
    with pytest.raises(type(error)):
        kept.run()
    overview = read_overview(kept.folders)
    assert (overview.claims, overview.counts) == ({}, {OK: 1, PENDING: 2})


def test_read_only_folder(kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch) -> None:
    run_test(kept.folders, kept.stand_in, "T1")
    read_overview(kept.folders)
    before = content_of(kept)
    monkeypatch.setattr("labpipe.campaign.catalog.os.access", lambda *_: False)
    assert states(kept) == {"T1": OK, "T2": PENDING, "T3": PENDING}
    with pytest.raises(StoreError, match="expected a writable folder, found a read-only"):
        kept.run()
    (kept.processed / "catalog.sqlite").unlink()
    overview = read_overview(kept.folders)
    assert overview.rows["T1"].state == OK
    assert overview.notes == [
        f"{kept.processed / 'catalog.sqlite'}: the folder is read-only: the catalog was made in"
        " memory"
    ]
    monkeypatch.undo()
    read_overview(kept.folders)
    assert content_of(kept) == before


KILLED = """
import sys, time
sys.path.insert(0, {tree!r})
from pathlib import Path
from tests.builders.kept_campaigns import KeptCampaign
kept = KeptCampaign(Path({home!r}))
kept.stand_in.before = lambda _: time.sleep(0.01)
print("begun", flush=True)
kept.run()
"""


@pytest.mark.parametrize(
    "moments",
    [[0.05], pytest.param([0.03 * n for n in range(16)], marks=pytest.mark.slow)],
)
def test_killed_runs_are_completed_by_the_next(
    kept: KeptCampaign, repository: Path, moments: list[float]
) -> None:
    for number in range(20):
        kept.add(f"K{number:02d}", f"{60 + number / 10}")
    program = KILLED.format(tree=str(repository), home=str(kept.home))
    for number, seconds in enumerate(moments):
        with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(seconds)
            process.kill()
        (kept.raw / f"K{number % 20:02d}" / "frame.csv").write_text(f"{70 + number}", "utf-8")
    kept.run()
    overview = read_overview(kept.folders)
    assert (overview.counts[OK], overview.claims) == (21, {})
    before = content_of(kept)
    assert len(before["results"]) == 22
    rebuild(kept.folders)
    assert content_of(kept) == before
    kept.run()
    assert kept.stand_in.processed == []


def test_run_test_processes_a_single_test(kept: KeptCampaign) -> None:
    row, attempted = run_test(kept.folders, kept.stand_in, "T2")
    assert kept.stand_in.processed == ["T2"]
    assert row is not None
    assert isinstance(attempted, Processed)
    assert row.state == DOUBTFUL
    assert states(kept) == {"T1": PENDING, "T2": DOUBTFUL, "T3": PENDING}

    assert run_test(kept.folders, kept.stand_in, "T2") == (row, None)
    assert kept.stand_in.processed == ["T2"]  # not again


ODD = ("a b", "a'b\"c", "%;--", "T[1]{2}", "\x07\x1b[31m", "new\nline", "ü ½ 漢字 😀", "~$x", "C:x")


def test_special_characters_in_names(tmp_path: Path) -> None:
    """Names of folders with characters that mean something to a shell, to SQL or to a terminal."""
    kept = KeptCampaign(tmp_path)
    for name in ODD:
        sheet = kept.add(f"x{name}") / "test.yaml"
        text = sheet.read_text("utf-8").replace(f"test: x{name}\n", "test: odd\n")
        sheet.write_text(text, "utf-8")
    kept.run()
    assert sorted(kept.stand_in.processed) == sorted(f"x{name}" for name in ODD)
    assert read_overview(kept.folders).counts == {OK: len(ODD)}
    kept.run()
    assert kept.stand_in.processed == []


NAMES = [f"T{number}" for number in range(5)]


class Accidents:
    """Things that happen to a campaign, one by one, at random."""

    def __init__(self, kept: KeptCampaign, seed: int) -> None:
        self.kept, self.chance = kept, random.Random(seed)
        self.said: list[str] = []

    def happen(self) -> None:
        happening = self.chance.choice(
            [self.run, self.run, self.export, self.no_export, self.sheet, self.irregular_sheet,
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

    def irregular_sheet(self, name: str) -> None:
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


LONG = [pytest.param(seed, 150, marks=pytest.mark.slow) for seed in range(2, 10)]


@pytest.mark.parametrize(("seed", "steps"), [(1, 15), *LONG])
def test_catalog_equals_a_rebuild_after_random_changes(
    tmp_path: Path, seed: int, steps: int
) -> None:
    """Whatever happens, the catalog is what a rebuild makes of the files."""
    kept = KeptCampaign(tmp_path)
    for name in NAMES:
        kept.add(name)
    accidents = Accidents(kept, seed)
    for _ in range(steps):
        accidents.happen()
        read_overview(kept.folders)
        before = content_of(kept)
        rebuild(kept.folders)
        assert content_of(kept) == before, accidents.said[-6:]
    kept.run()
    kept.run()
    assert kept.stand_in.processed == []


PAIRED = """\
version: 1
pair: {by: name, from: incoming, exports: {frame: "{test}_frame.csv"}}
"""


def test_find_unknown_files(tmp_path: Path) -> None:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    kept.add("T2", "fail bad_sheet")
    kept.run()
    kept.add("more/T3")
    (kept.add("T4") / "test.yaml").write_text("test: [", "utf-8")
    (kept.raw / "campaign.yaml").write_text(PAIRED, "utf-8")
    (kept.raw / "incoming").mkdir()
    odd = [f"incoming/{name}.csv" for name in ("T1_frame", "T9_frame", "x")]
    for name in (*odd, "T1/photo.jpg", "notes \x07.txt"):
        (kept.raw / name).write_text("", "utf-8")
    with open_campaign(kept.folders) as sync:
        files = find_unknown_files(sync, sync.refresh())
    assert files == ["T1/photo.jpg", "T4/frame.csv", odd[2], "notes \x07.txt"]


@pytest.fixture
def one_test(tmp_path: Path) -> KeptCampaign:
    one_test = KeptCampaign(tmp_path)
    one_test.add("T1")
    one_test.run()
    return one_test


def outcome(one_test: KeptCampaign) -> Entry:
    return read_outcome("T1", find_outcome(one_test.folders, "T1"))


def test_a_failure_beside_earlier_results(one_test: KeptCampaign) -> None:
    """It counts with its own key or without one, and is over where the results have its key."""
    before, folder = outcome(one_test), one_test.processed / "T1"
    write_failure(FailedTest("T1", "process_died", "it was ended", before.row.run), folder)
    assert outcome(one_test) == before
    failure = FailedTest("T1", "process_died", "it was ended", "f" * 64, made_of={"sheet": "5e"})
    write_failure(failure, folder)
    failed = outcome(one_test)
    row = failed.row
    assert (row.state, row.code, row.reason) == (FAILED, "process_died", "it was ended")
    assert (row.run, row.failed_run, row.attempt_key) == (before.row.run, "f" * 64, "f" * 64)
    assert (row.sheet, row.resolved, failed.inputs) == ("5e", "", ())
    assert failed.results == before.results
    for text in ("", "[]", '{"made_of": 1, "inputs": [1]}', '{"inputs": {}}'):
        (folder / "failure.json").write_text(text, "utf-8")
        row = outcome(one_test).row
        assert (row.state, row.code) == (FAILED, "unknown")


def test_test_in_use_is_tried_again(kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labpipe.campaign.running._RETRY_DELAY", 0.01)
    (kept.raw / "T1" / "frame.csv").write_text("fail in_use", "utf-8")
    tries: list[str] = []

    def before(name: str) -> None:
        tries.append(name)
        if tries.count("T1") == 3:
            (kept.raw / "T1" / "frame.csv").write_text("60.5", "utf-8")

    kept.stand_in.before = before
    ran = kept.run()
    assert (tries.count("T1"), ran.elsewhere, states(kept)["T1"]) == (3, [], STALE)
