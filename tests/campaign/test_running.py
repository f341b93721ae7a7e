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

from labpipe.campaign.campaign_files import SourceHashes, find_outcome
from labpipe.campaign.catalog import DOUBTFUL, FAILED, OK, PENDING, STALE, Entry, read_outcome
from labpipe.campaign.decisions import Decision
from labpipe.campaign.running import (
    clear_failures,
    find_unknown_files,
    open_campaign,
    read_overview,
    rebuild_catalog,
    record_decision,
    run_test,
)
from labpipe.errors import LabpipeError, StoreError, UsageError
from labpipe.process.run import ProcessedTest
from labpipe.store.summaries import FailedTest, write_failure
from tests.builders.lab_campaigns import LabCampaign, content_of


@pytest.fixture
def campaign(tmp_path: Path) -> LabCampaign:
    """Three tests: one good, one doubtful, one that fails."""
    campaign = LabCampaign(tmp_path)
    for name, export in (("T1", "62.5"), ("T2", "doubt"), ("T3", "fail unreadable_export")):
        campaign.add(name, export)
    return campaign


def states(campaign: LabCampaign) -> dict[str, str]:
    return {folder: row.state for folder, row in read_overview(campaign.folders).rows.items()}


def test_run_processes_new_and_changed_tests_only(campaign: LabCampaign) -> None:
    expected = {"T1": OK, "T2": DOUBTFUL, "T3": FAILED}
    assert set(states(campaign).values()) == {PENDING}
    ran = campaign.run()
    assert campaign.stand_in.processed == ["T1", "T2", "T3"]
    assert ran.processed_folders == ["T1", "T2", "T3"]
    rows = read_overview(campaign.folders).rows
    assert {name: row.state for name, row in rows.items()} == expected
    assert (rows["T3"].code, rows["T3"].reason[:5]) == ("unreadable_export", "a unr")
    campaign.run()
    assert campaign.stand_in.processed == []
    (campaign.raw / "T2" / "frame.csv").write_text("63.5", encoding="utf-8")
    sheet = campaign.raw / "T1" / "test.yaml"
    sheet.write_text(sheet.read_text("utf-8") + "operator: somebody\n", "utf-8")
    campaign.add("T4")
    rows = read_overview(campaign.folders).rows
    assert {name: (row.state, row.why) for name, row in rows.items() if row.why} == {
        "T1": (STALE, "sheet changed"),
        "T2": (STALE, "file changed (frame.csv)"),
    }
    campaign.run()
    assert campaign.stand_in.processed == ["T1", "T2", "T4"]


def test_a_changed_protocol_runs_its_tests_again(
    campaign: LabCampaign, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(campaign.home)
    (campaign.home / "protocols").mkdir()
    protocol = campaign.home / "protocols" / "own.yaml"
    text = (repository / "protocols" / "corrugated-tube.yaml").read_text("utf-8")
    protocol.write_text(text, "utf-8")
    campaign.add("P", protocol="own")
    campaign.run()
    protocol.write_text(f"{text}# nothing but a remark\n", "utf-8")
    campaign.run()
    assert campaign.stand_in.processed == []
    protocol.write_text(text.replace("crosshead_speed: 0.423", "crosshead_speed: 0.5"), "utf-8")
    assert read_overview(campaign.folders).rows["P"].why == "protocol changed"
    campaign.run()
    assert campaign.stand_in.processed == ["P"]


def test_results_remain_without_exports(campaign: LabCampaign) -> None:
    campaign.run()
    shutil.rmtree(campaign.raw)
    campaign.raw.mkdir()
    assert states(campaign) == {"T1": OK, "T2": DOUBTFUL, "T3": FAILED}
    campaign.run()
    assert campaign.stand_in.processed == []
    shutil.rmtree(campaign.processed / "T2")
    assert set(states(campaign)) == {"T1", "T3"}


def test_failures_are_cleared_by_code(campaign: LabCampaign) -> None:
    campaign.add("T4", "fail process_died")
    campaign.run()
    message = "expected failures with the code 'proces', found process_died, unreadable_export"
    with pytest.raises(UsageError, match=message):
        clear_failures(campaign.folders, "proces")
    for code, names in (("process_died", ["T4"]), ("", ["T3", "T4"])):
        assert clear_failures(campaign.folders, code) == names
        assert states(campaign)["T4"] == PENDING
        campaign.run()
        assert campaign.stand_in.processed == names


def test_newer_results_are_kept_until_cleared(campaign: LabCampaign) -> None:
    campaign.run()
    path = campaign.processed / "T1" / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "schema": 99}), "utf-8")
    row = read_overview(campaign.folders).rows["T1"]
    assert (row.state, row.code) == (FAILED, "newer_result")
    assert "found one of a newer labpipe, schema 99. Update labpipe." in row.reason
    campaign.run()
    assert campaign.stand_in.processed == []
    campaign.run(forced_folders=clear_failures(campaign.folders, "newer_result"))
    assert campaign.stand_in.processed == ["T1"]


@pytest.mark.parametrize(
    "damage",
    [
        *("", "{", "[]", '{"test": 1}'),
        {"specimen": None},
        {"inputs": [1]},
        {"results": [{"name": "x", "value": "many"}]},
        {"results": [{"name": "x", "unit": "", "status": "", "seal": "x", "value": 10**400}]},
    ],
)
def test_test_with_damaged_summary_is_processed_again(
    campaign: LabCampaign, damage: str | dict[str, Any]
) -> None:
    campaign.run()
    path = campaign.processed / "T1" / "summary.json"
    summary = json.loads(path.read_text("utf-8"))
    path.write_text(damage if isinstance(damage, str) else json.dumps(summary | damage), "utf-8")
    row = read_overview(campaign.folders).rows["T1"]
    assert row.state == PENDING
    assert row.why.startswith("summary.json ")
    campaign.run()
    assert (campaign.stand_in.processed, states(campaign)["T1"]) == (["T1"], OK)


def test_two_simultaneous_runs_share_the_tests(campaign: LabCampaign) -> None:
    """Two runs at a time: no test is processed twice, none is forgotten, nothing is rebuilt."""
    second_campaign = LabCampaign(campaign.home)
    summaries = []

    def meanwhile(name: str) -> None:
        with pytest.raises(
            StoreError, match="expected no process that works on the campaign, found process"
        ):
            rebuild_catalog(campaign.folders)
        summaries.append(second_campaign.run())

    campaign.stand_in.before = meanwhile
    summary = campaign.run()
    assert campaign.stand_in.processed == ["T1"]
    assert second_campaign.stand_in.processed == ["T2", "T3"]
    assert summaries[0].skipped_folders == ["T1"]
    assert summary.overview.counts == {OK: 1, DOUBTFUL: 1, FAILED: 1}


@pytest.mark.parametrize("error", [KeyboardInterrupt(), StoreError("the scheduler is gone")])
def test_interrupted_run_releases_its_claims(campaign: LabCampaign, error: BaseException) -> None:
    def interrupt(name: str) -> None:
        if name == "T2":
            raise error

    campaign.stand_in.before = interrupt
    with pytest.raises(type(error)):
        campaign.run()
    overview = read_overview(campaign.folders)
    assert (overview.claims, overview.counts) == ({}, {OK: 1, PENDING: 2})


def test_read_only_folder(campaign: LabCampaign, monkeypatch: pytest.MonkeyPatch) -> None:
    run_test(campaign.folders, campaign.stand_in, "T1")
    read_overview(campaign.folders)
    content = content_of(campaign)
    catalog_file = campaign.processed / "catalog.sqlite"
    monkeypatch.setattr("labpipe.campaign.catalog.os.access", lambda *_: False)
    assert states(campaign) == {"T1": OK, "T2": PENDING, "T3": PENDING}
    with pytest.raises(StoreError, match="expected a writable folder, found a read-only"):
        campaign.run()
    catalog_file.unlink()
    overview = read_overview(campaign.folders)
    (note,) = overview.notes
    assert note == f"{catalog_file}: the folder is read-only: the catalog was made in memory"
    monkeypatch.undo()
    read_overview(campaign.folders)
    assert content_of(campaign) == content


KILLED = """
import sys, time
sys.path.insert(0, {tree!r})
from pathlib import Path
from tests.builders.lab_campaigns import LabCampaign
campaign = LabCampaign(Path({home!r}))
campaign.stand_in.before = lambda _: time.sleep(0.01)
print("begun", flush=True)
campaign.run()
"""


@pytest.mark.parametrize(
    "moments",
    [[0.05], pytest.param([0.03 * n for n in range(16)], marks=pytest.mark.slow)],
)
def test_killed_runs_are_completed_by_the_next(
    campaign: LabCampaign, repository: Path, moments: list[float]
) -> None:
    for number in range(20):
        campaign.add(f"K{number:02d}", f"{60 + number / 10}")
    program = KILLED.format(tree=str(repository), home=str(campaign.home))
    for number, seconds in enumerate(moments):
        with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(seconds)
            process.kill()
        (campaign.raw / f"K{number % 20:02d}" / "frame.csv").write_text(f"{70 + number}", "utf-8")
    campaign.run()
    overview = read_overview(campaign.folders)
    assert (overview.counts[OK], overview.claims) == (21, {})
    content = content_of(campaign)
    assert len(content["results"]) == 22
    rebuild_catalog(campaign.folders)
    assert content_of(campaign) == content
    campaign.run()
    assert campaign.stand_in.processed == []


def test_run_test_processes_a_single_test(campaign: LabCampaign) -> None:
    row, attempted = run_test(campaign.folders, campaign.stand_in, "T2")
    assert campaign.stand_in.processed == ["T2"]
    assert row is not None
    assert isinstance(attempted, ProcessedTest)
    assert row.state == DOUBTFUL
    assert states(campaign) == {"T1": PENDING, "T2": DOUBTFUL, "T3": PENDING}

    assert run_test(campaign.folders, campaign.stand_in, "T2") == (row, None)
    assert campaign.stand_in.processed == ["T2"]  # not again


ODD = ("a b", "a'b\"c", "%;--", "T[1]{2}", "\x07\x1b[31m", "new\nline", "ü ½ 漢字 😀", "~$x", "C:x")


def test_special_characters_in_names(tmp_path: Path) -> None:
    """Names of folders with characters that mean something to a shell, to SQL or to a terminal."""
    campaign = LabCampaign(tmp_path)
    for name in ODD:
        sheet = campaign.add(f"x{name}") / "test.yaml"
        text = sheet.read_text("utf-8").replace(f"test: x{name}\n", "test: odd\n")
        sheet.write_text(text, "utf-8")
    campaign.run()
    assert sorted(campaign.stand_in.processed) == sorted(f"x{name}" for name in ODD)
    assert read_overview(campaign.folders).counts == {OK: len(ODD)}
    campaign.run()
    assert campaign.stand_in.processed == []


NAMES = [f"T{number}" for number in range(5)]


class Accidents:
    """Things that happen to a campaign, one by one, at random."""

    def __init__(self, campaign: LabCampaign, seed: int) -> None:
        self.campaign, self.chance = campaign, random.Random(seed)
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
        self.campaign.run()

    def export(self, name: str) -> None:
        text = self.chance.choice(["60", "61", "doubt", "fail disk_full", "fail process_died"])
        (self.campaign.raw / name / "frame.csv").write_text(text, "utf-8")

    def no_export(self, name: str) -> None:
        (self.campaign.raw / name / "frame.csv").unlink()

    def sheet(self, name: str) -> None:
        self._write(name, lambda text: f"{text}# {self.chance.random()}\n")

    def irregular_sheet(self, name: str) -> None:
        texts = ["test: [", "protocol: corrugated-tube", "\x00"]
        self._write(name, lambda _: self.chance.choice(texts))

    def _write(self, name: str, change: Callable[[str], str]) -> None:
        path = self.campaign.raw / name / "test.yaml"
        path.write_text(change(path.read_text("utf-8")), "utf-8")

    def no_sheet(self, name: str) -> None:
        sheet, moved = self.campaign.raw / name / "test.yaml", self.campaign.home / f"{name}.yaml"
        sheet.rename(moved) if sheet.exists() else moved.rename(sheet)

    def no_results(self, name: str) -> None:
        shutil.rmtree(self.campaign.processed / name)

    def half_results(self, name: str) -> None:
        (self.campaign.processed / name / "summary.json").write_text("{", "utf-8")

    def decision(self, name: str) -> None:
        word = self.chance.choice(["accept", "reject"])
        with suppress(LabpipeError):  # it was not processed yet
            decision = Decision("", "", word, "as it is", "A. Tester")
            record_decision(self.campaign.folders, name, decision)

    def replay(self, _: str) -> None:
        with suppress(LabpipeError):  # there is none
            clear_failures(self.campaign.folders, self.chance.choice(["", "disk_full"]))

    def again(self, name: str) -> None:
        shutil.rmtree(self.campaign.raw / name)
        self.campaign.add(name, self.chance.choice(["60", "doubt"]))


LONG = [pytest.param(seed, 150, marks=pytest.mark.slow) for seed in range(2, 10)]


@pytest.mark.parametrize(("seed", "steps"), [(1, 15), *LONG])
def test_catalog_equals_a_rebuild_after_random_changes(
    tmp_path: Path, seed: int, steps: int
) -> None:
    """Whatever happens, the catalog is what a rebuild makes of the files."""
    campaign = LabCampaign(tmp_path)
    for name in NAMES:
        campaign.add(name)
    accidents = Accidents(campaign, seed)
    for _ in range(steps):
        accidents.happen()
        read_overview(campaign.folders)
        content = content_of(campaign)
        rebuild_catalog(campaign.folders)
        assert content_of(campaign) == content, accidents.said[-6:]
    campaign.run()
    campaign.run()
    assert campaign.stand_in.processed == []


PAIRED = """\
version: 1
pair: {by: name, from: incoming, exports: {frame: "{test}_frame.csv"}}
"""


def test_find_unknown_files(tmp_path: Path) -> None:
    campaign = LabCampaign(tmp_path)
    campaign.add("T1")
    campaign.add("T2", "fail bad_sheet")
    campaign.run()
    campaign.add("more/T3")
    (campaign.add("T4") / "test.yaml").write_text("test: [", "utf-8")
    (campaign.raw / "campaign.yaml").write_text(PAIRED, "utf-8")
    (campaign.raw / "incoming").mkdir()
    incoming = [f"incoming/{name}.csv" for name in ("T1_frame", "T9_frame", "x")]
    for name in (*incoming, "T1/photo.jpg", "notes \x07.txt"):
        (campaign.raw / name).write_text("", "utf-8")
    with open_campaign(campaign.folders) as sync:
        files = find_unknown_files(sync, sync.refresh())
    assert files == ["T1/photo.jpg", "T4/frame.csv", incoming[2], "notes \x07.txt"]


@pytest.fixture
def one_test(tmp_path: Path) -> LabCampaign:
    one_test = LabCampaign(tmp_path)
    one_test.add("T1")
    one_test.run()
    return one_test


def outcome(one_test: LabCampaign) -> Entry:
    return read_outcome("T1", find_outcome(one_test.folders, "T1"))


def test_a_failure_beside_earlier_results(one_test: LabCampaign) -> None:
    """It counts with its own key or without one, and is over where the results have its key."""
    entry, folder = outcome(one_test), one_test.processed / "T1"
    write_failure(FailedTest("T1", "process_died", "it was ended", entry.row.run), folder)
    assert outcome(one_test) == entry
    failure = FailedTest("T1", "process_died", "it was ended", "f" * 64, made_of={"sheet": "5e"})
    write_failure(failure, folder)
    failed = outcome(one_test)
    row = failed.row
    assert (row.state, row.code, row.reason) == (FAILED, "process_died", "it was ended")
    assert (row.run, row.failed_run, row.attempt_key) == (entry.row.run, "f" * 64, "f" * 64)
    assert failed.source_hashes == SourceHashes(sheet="5e")
    assert failed.results == entry.results
    for text in ("", "[]", '{"made_of": 1, "inputs": [1]}', '{"inputs": {}}'):
        (folder / "failure.json").write_text(text, "utf-8")
        row = outcome(one_test).row
        assert (row.state, row.code) == (FAILED, "unknown")


def test_test_in_use_is_tried_again(campaign: LabCampaign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labpipe.campaign.running._RETRY_DELAY", 0.01)
    (campaign.raw / "T1" / "frame.csv").write_text("fail in_use", "utf-8")
    tries: list[str] = []

    def change_export(name: str) -> None:
        tries.append(name)
        if tries.count("T1") == 3:
            (campaign.raw / "T1" / "frame.csv").write_text("60.5", "utf-8")

    campaign.stand_in.before = change_export
    ran = campaign.run()
    assert (tries.count("T1"), ran.skipped_folders, states(campaign)["T1"]) == (3, [], STALE)
