from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from labpipe.campaign.catalog import DOUBTFUL, FAILED, OK, PENDING, STALE
from labpipe.campaign.claims import own_claim
from labpipe.campaign.refreshing import opened_campaign
from labpipe.campaign.running import clear_failures, look, rebuild, run_some
from labpipe.errors import StoreError, UsageError
from tests.builders.kept_campaigns import KeptCampaign, content_of


@pytest.fixture
def kept(tmp_path: Path) -> KeptCampaign:
    """Three tests: one good, one doubtful, one that fails."""
    kept = KeptCampaign(tmp_path)
    for name, export in (("T1", "62.5"), ("T2", "doubt"), ("T3", "fail unreadable_export")):
        kept.add(name, export)
    return kept


def states(kept: KeptCampaign) -> dict[str, str]:
    return {folder: row.state for folder, row in look(kept.folders).rows.items()}


def test_new_tests_are_processed_once(kept: KeptCampaign) -> None:
    assert set(states(kept).values()) == {PENDING}
    ran = kept.run()
    assert kept.stand_in.processed == ["T1", "T2", "T3"]
    assert {name: each.state for name, each in ran.processed.items()} == {
        "T1": OK, "T2": DOUBTFUL, "T3": FAILED,
    }  # fmt: skip
    assert states(kept) == {"T1": OK, "T2": DOUBTFUL, "T3": FAILED}
    row = look(kept.folders).rows["T3"]
    assert (row.code, row.reason) == ("unreadable_export", "a unreadable_export of an export")
    kept.run()
    assert kept.stand_in.processed == []


def test_touched_files_are_not_processed(kept: KeptCampaign) -> None:
    kept.run()
    for file in kept.raw.rglob("*.*"):
        os.utime(file)
    kept.run()
    assert kept.stand_in.processed == []


def test_what_changed_is_processed_and_nothing_else(kept: KeptCampaign) -> None:
    kept.run()
    (kept.raw / "T2" / "frame.csv").write_text("63.5", encoding="utf-8")
    overview = look(kept.folders)
    assert (overview.rows["T2"].state, overview.rows["T2"].why) == (
        STALE,
        "export changed (frame.csv)",
    )
    kept.run()
    assert kept.stand_in.processed == ["T2"]
    sheet = kept.raw / "T1" / "test.yaml"
    sheet.write_text(sheet.read_text("utf-8") + "operator: somebody\n", "utf-8")
    assert look(kept.folders).rows["T1"].why == "sheet changed"
    kept.add("T4")
    kept.run()
    assert kept.stand_in.processed == ["T1", "T4"]


def test_a_failed_test_is_processed_again_when_its_export_is_another(kept: KeptCampaign) -> None:
    kept.run()
    (kept.raw / "T3" / "frame.csv").write_text("61.5", encoding="utf-8")
    kept.run()
    assert kept.stand_in.processed == ["T3"]
    assert states(kept)["T3"] == OK
    assert not (kept.processed / "T3" / "failure.json").exists()


def test_a_missing_export_fails_until_it_is_there(kept: KeptCampaign) -> None:
    kept.run()
    export = kept.add("T4") / "frame.csv"
    export.unlink()
    kept.run()
    assert states(kept)["T4"] == FAILED
    kept.run()
    assert kept.stand_in.processed == []
    export.write_text("60", encoding="utf-8")
    kept.run()
    assert (kept.stand_in.processed, states(kept)["T4"]) == (["T4"], OK)


def test_a_changed_protocol_runs_its_tests_again(
    kept: KeptCampaign, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(kept.home)
    own = kept.home / "protocols"
    own.mkdir()
    text = (repository / "protocols" / "corrugated-tube.yaml").read_text("utf-8")
    for name in ("a", "b"):
        (own / f"{name}.yaml").write_text(text, "utf-8")
        kept.add(f"P-{name}", protocol=name)
    kept.run()
    (own / "a.yaml").write_text(f"{text}# nothing but a remark\n", "utf-8")
    kept.run()
    assert kept.stand_in.processed == []
    changed = text.replace("crosshead_speed: 0.423 mm/s", "crosshead_speed: 0.5 mm/s")
    assert changed != text
    (own / "a.yaml").write_text(changed, "utf-8")
    assert look(kept.folders).rows["P-a"].why == "protocol changed"
    kept.run()
    assert kept.stand_in.processed == ["P-a"]


def test_results_that_were_taken_away(kept: KeptCampaign) -> None:
    kept.run()
    shutil.rmtree(kept.processed / "T1")
    (kept.processed / "T2" / "result.h5").unlink()
    assert look(kept.folders).rows["T2"].why == "result.h5 is gone"
    kept.run()
    assert kept.stand_in.processed == ["T1", "T2"]


def test_exports_that_were_taken_away(kept: KeptCampaign) -> None:
    kept.run()
    shutil.rmtree(kept.raw)
    kept.raw.mkdir()
    assert states(kept) == {"T1": OK, "T2": DOUBTFUL, "T3": FAILED}
    kept.run()
    assert kept.stand_in.processed == []
    shutil.rmtree(kept.processed / "T2")
    assert set(states(kept)) == {"T1", "T3"}


def test_only_some(kept: KeptCampaign) -> None:
    kept.run(only=["T2"])
    assert kept.stand_in.processed == ["T2"]


def test_failures_are_cleared_by_code(kept: KeptCampaign) -> None:
    kept.add("T4", "fail process_died")
    kept.run()
    message = "expected failures of the code 'proces', found process_died, unreadable_export"
    with pytest.raises(UsageError, match=message):
        clear_failures(kept.folders, "proces")
    assert clear_failures(kept.folders, "process_died") == ["T4"]
    assert states(kept)["T4"] == PENDING
    kept.run()
    assert kept.stand_in.processed == ["T4"]
    assert clear_failures(kept.folders) == ["T3", "T4"]
    kept.run()
    assert kept.stand_in.processed == ["T3", "T4"]


def test_a_result_of_a_newer_labpipe_is_left_alone_until_it_is_cleared(kept: KeptCampaign) -> None:
    kept.run()
    path = kept.processed / "T1" / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "schema": 99}), "utf-8")
    row = look(kept.folders).rows["T1"]
    assert (row.state, row.code) == (FAILED, "newer_result")
    assert "expected 2, or one before it, found 99. A newer labpipe made it" in row.reason
    kept.run()
    assert kept.stand_in.processed == []
    kept.run(again=clear_failures(kept.folders, "newer_result"))
    assert kept.stand_in.processed == ["T1"]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"test": 1}', '{"results": {}}', "\x00"])
def test_a_damaged_summary_is_made_again(kept: KeptCampaign, text: str) -> None:
    kept.run()
    (kept.processed / "T1" / "summary.json").write_text(text, "utf-8")
    row = look(kept.folders).rows["T1"]
    assert row.state == PENDING
    assert row.why.startswith("summary.json ")
    kept.run()
    assert (kept.stand_in.processed, states(kept)["T1"]) == (["T1"], OK)


def test_an_export_that_changes_while_its_test_is_processed(kept: KeptCampaign) -> None:
    def before(name: str) -> None:
        if name == "T1":
            (kept.raw / name / "frame.csv").write_text("60.5", "utf-8")

    kept.stand_in.before = before
    kept.run()
    kept.stand_in.before = lambda _: None
    assert states(kept)["T1"] == STALE  # the stand-in wrote the key that it was given
    kept.run()
    assert kept.stand_in.processed == ["T1"]


def test_another_run_meanwhile(kept: KeptCampaign) -> None:
    """Two runs at a time: none of the tests is processed twice, none is forgotten."""
    other = KeptCampaign(kept.home)
    second = []

    def meanwhile(name: str) -> None:
        if name == "T1":
            second.append(other.run())

    kept.stand_in.before = meanwhile
    first = kept.run()
    assert kept.stand_in.processed == ["T1"]
    assert other.stand_in.processed == ["T2", "T3"]
    assert second[0].elsewhere == ["T1"]
    assert first.overview.counts == {OK: 1, DOUBTFUL: 1, FAILED: 1}


def test_a_test_that_an_orphan_still_writes_is_tried_again(
    kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.campaign.running._PAUSE", 0.01)
    (kept.raw / "T1" / "frame.csv").write_text("fail in_use", "utf-8")
    tries: list[str] = []

    def before(name: str) -> None:
        tries.append(name)
        if tries.count("T1") == 3:
            (kept.raw / "T1" / "frame.csv").write_text("60.5", "utf-8")

    kept.stand_in.before = before
    ran = kept.run()
    assert (tries.count("T1"), ran.elsewhere, states(kept)["T1"]) == (3, [], STALE)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), StoreError("the scheduler is gone")])
def test_what_ends_a_run_gives_its_claims_back(kept: KeptCampaign, error: BaseException) -> None:
    def before(name: str) -> None:
        if name == "T2":
            raise error

    kept.stand_in.before = before
    with pytest.raises(type(error)):
        kept.run()
    overview = look(kept.folders)
    assert overview.claims == {}
    assert overview.counts == {OK: 1, PENDING: 2}
    kept.stand_in.before = lambda _: None
    kept.run()
    assert kept.stand_in.processed == ["T2", "T3"]


def test_a_claim_of_a_process_that_died(kept: KeptCampaign) -> None:
    kept.run()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    with opened_campaign(kept.folders) as keeper:
        sql = "insert into running values ('T1', ?, ?, '', ?)"
        host = own_claim().host
        keeper.catalog._connection.execute(sql, (host, ended.pid, time.time()))
        assert keeper.catalog.claims() == {}
    kept.run(again=["T1"])
    assert kept.stand_in.processed == ["T1"]


def test_a_rebuild_gives_the_same_rows(kept: KeptCampaign) -> None:
    kept.run()
    before = content_of(kept)
    assert {len(rows) for rows in before.values()} == {0, 2, 3}
    overview = rebuild(kept.folders)
    assert overview.notes == []
    assert content_of(kept) == before
    assert not list(kept.processed.glob("catalog.sqlite.*"))


def test_no_rebuild_while_a_process_is_at_work(kept: KeptCampaign) -> None:
    refused = []

    def meanwhile(_: str) -> None:
        with pytest.raises(StoreError, match="expected no process at work, found process"):
            rebuild(kept.folders)
        refused.append(True)

    kept.stand_in.before = meanwhile
    kept.run()
    assert len(refused) == 3


def test_a_folder_that_cannot_be_written(
    kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept.run(only=["T1"])
    before = content_of(kept)
    monkeypatch.setattr("labpipe.campaign.catalog.os.access", lambda *_: False)
    assert states(kept) == {"T1": OK, "T2": PENDING, "T3": PENDING}
    with pytest.raises(StoreError, match="expected a folder to write in, found one that cannot"):
        kept.run()
    (kept.processed / "catalog.sqlite").unlink()
    overview = look(kept.folders)
    assert overview.rows["T1"].state == OK
    assert overview.notes == [
        f"{kept.processed / 'catalog.sqlite'}: the folder cannot be written: a catalog was made in"
        " memory"
    ]
    monkeypatch.undo()
    look(kept.folders)
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


def killed_after(kept: KeptCampaign, seconds: float, tree: Path) -> None:
    """Begin a run in a process of its own, and kill it."""
    program = KILLED.format(tree=str(tree), home=str(kept.home))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(seconds)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()


@pytest.mark.slow
def test_two_processes_at_a_time_share_the_tests(kept: KeptCampaign, repository: Path) -> None:
    for number in range(20):
        kept.add(f"K{number:02d}")
    program = KILLED.format(tree=str(repository), home=str(kept.home))
    program += "print(*kept.stand_in.processed)\n"
    both = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    processed = [each.communicate()[0].split()[1:] for each in both]
    assert [each.returncode for each in both] == [0, 0]
    assert sorted(processed[0] + processed[1]) == sorted(look(kept.folders).rows)


def kill_again_and_again(kept: KeptCampaign, times: list[float], tree: Path) -> None:
    for number in range(20):
        kept.add(f"K{number:02d}", f"{60 + number / 10}")
    for number, seconds in enumerate(times):
        killed_after(kept, seconds, tree)
        (kept.raw / f"K{number % 20:02d}" / "frame.csv").write_text(f"{70 + number}", "utf-8")
    kept.run()
    overview = look(kept.folders)
    assert overview.counts[OK] == 21
    assert not overview.claims
    before = content_of(kept)
    assert len(before["results"]) == 22
    rebuild(kept.folders)
    assert content_of(kept) == before
    kept.run()
    assert kept.stand_in.processed == []


@pytest.mark.slow
def test_killed_now_and_then(kept: KeptCampaign, repository: Path) -> None:
    kill_again_and_again(kept, [0.01, 0.2, 0.35], repository)


@pytest.mark.slow
def test_killed_at_fifty_moments(kept: KeptCampaign, repository: Path) -> None:
    kill_again_and_again(kept, [0.02 * (n % 25) for n in range(50)], repository)


def test_some_tests_alone(kept: KeptCampaign) -> None:
    told: list[str] = []
    ran = run_some(kept.folders, kept.stand_in, ["T2"], told=lambda folder, _: told.append(folder))
    assert told == kept.stand_in.processed == ["T2"]
    assert {folder: row.state for folder, row in ran.items() if row} == {"T2": DOUBTFUL}
    assert states(kept) == {"T1": PENDING, "T2": DOUBTFUL, "T3": PENDING}

    assert run_some(kept.folders, kept.stand_in, ["T2"]) == ran
    assert kept.stand_in.processed == ["T2"]  # not again


def test_a_failure_is_tried_again_once_the_export_is_another(kept: KeptCampaign) -> None:
    run_some(kept.folders, kept.stand_in, ["T3"])
    export = kept.raw / "T3" / "frame.csv"
    export.write_text(export.read_text("utf-8").replace("fail unreadable_export", "62.5"), "utf-8")
    (row,) = run_some(kept.folders, kept.stand_in, ["T3"]).values()
    assert row is not None
    assert row.state == OK


SECOND_RUN = """
import resource, sys
from labpipe.cli import main
status = main(["campaign", "run", sys.argv[1]])
used = resource.getrusage(resource.RUSAGE_SELF)
print("cpu", used.ru_utime + used.ru_stime)
sys.exit(status)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the time of the processor is asked of POSIX")
def test_ten_thousand_tests_that_are_done_take_three_seconds(
    tmp_path: Path, repository: Path
) -> None:
    """Of the processor, from start to end of the process; and again when all are touched."""
    kept = KeptCampaign(tmp_path)
    for number in range(10_000):
        kept.add(f"T{number:05d}", f"{60 + number % 7}.{number:05d} {'x' * 300}")
    kept.run()
    assert len(kept.stand_in.processed) == 10_000
    environment = {**os.environ, "PYTHONPATH": str(repository), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", SECOND_RUN, str(kept.raw)]

    def again() -> float:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True, cwd=repository
        )
        assert "processed 0 of 10000" in done.stdout
        return float(done.stdout.rpartition("cpu ")[2])

    again()  # hashes of files that were young when they were taken
    assert again() < 3.0
    for file in kept.raw.rglob("*.*"):
        os.utime(file)
    again()
    assert again() < 3.0
