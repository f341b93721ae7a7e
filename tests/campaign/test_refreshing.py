from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.campaign import outcome_rows
from labpipe.campaign.catalog import OK, PENDING, RUNNING
from labpipe.campaign.refreshing import opened_campaign
from labpipe.campaign.running import clear_failures, look, rebuild
from tests.builders.kept_campaigns import KeptCampaign, content_of


@pytest.fixture
def kept(tmp_path: Path) -> KeptCampaign:
    kept = KeptCampaign(tmp_path)
    for name in ("T1", "T2"):
        kept.add(name)
    kept.run()
    return kept


def test_what_looks_the_same_is_not_opened(
    kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened_campaign(kept.folders) as keeper:
        keeper.refresh()

        def refuse(*_: object) -> None:
            raise AssertionError

        monkeypatch.setattr("labpipe.campaign.refreshing.read_outcome_files", refuse)
        assert keeper.refresh().counts == {OK: 2}


def test_results_that_labpipe_process_wrote_are_seen(kept: KeptCampaign) -> None:
    path = kept.processed / "T1" / "summary.json"
    said = json.loads(path.read_text("utf-8"))
    said["results"][0]["value"] = 77.0
    path.write_text(json.dumps(said), "utf-8")
    look(kept.folders)
    assert 77.0 in {row[3] for row in content_of(kept)["results"]}


def test_a_failure_takes_the_place_of_the_state_and_leaves_the_results(kept: KeptCampaign) -> None:
    (kept.raw / "T1" / "frame.csv").write_text("fail disk_full", "utf-8")
    kept.run()
    row = look(kept.folders).rows["T1"]
    assert (row.state, row.code) == ("failed", "disk_full")
    assert row.run != row.failed_run != ""
    assert len(content_of(kept)["results"]) == 2


def test_the_sheet_tells_of_tests_without_results(kept: KeptCampaign) -> None:
    kept.add("T3", "fail disk_full")
    assert look(kept.folders).rows["T3"].state == PENDING
    kept.run()
    row = look(kept.folders).rows["T3"]
    assert (row.type, row.spool, row.sample, row.date) == ("CT-7", "CT-7-s1", "1", "2026-03-09")
    assert row.protocol == "corrugated-tube"


def test_a_test_that_is_being_processed_is_running(kept: KeptCampaign) -> None:
    with opened_campaign(kept.folders) as keeper:
        keeper.catalog.claim("T1")
        overview = keeper.refresh()
    assert overview.counts == {OK: 1, RUNNING: 1}
    assert overview.state_of("T1") == RUNNING


def test_odd_names_are_kept(kept: KeptCampaign) -> None:
    """Names of folders with every printable character that a system takes, and some others."""
    odd = [
        "a b",
        "a'b\"c",
        "%;--",
        "T[1]{2}",
        "\x07bell\x1b[31m",
        "new\nline",
        "ü ½ 漢字 😀",
        "~$x",
        "C:x",
    ]
    for name in odd:
        kept.add(f"x{name}")
    sheet = kept.raw / "x\x07bell\x1b[31m" / "test.yaml"
    for name in odd:
        sheet = kept.raw / f"x{name}" / "test.yaml"
        sheet.write_text(
            sheet.read_text("utf-8").replace(f"test: x{name}\n", "test: odd\n"), "utf-8"
        )
    kept.run()
    assert sorted(kept.stand_in.processed) == sorted(f"x{name}" for name in odd)
    assert look(kept.folders).counts == {OK: 2 + len(odd)}
    kept.run()
    assert kept.stand_in.processed == []


def test_rows_come_from_files_alone(kept: KeptCampaign, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rebuild that would read something else than the files would not be equal."""
    assert outcome_rows.read_outcome_files(None).results == ()
    before = content_of(kept)
    for file in kept.processed.glob("catalog*"):
        file.unlink()
    look(kept.folders)
    assert content_of(kept) == before


def test_rows_are_those_of_a_rebuild_whatever_came_before(kept: KeptCampaign) -> None:
    """What changed more than once, went away, or came back."""

    def as_rebuilt() -> bool:
        look(kept.folders)
        before = content_of(kept)
        rebuild(kept.folders)
        return content_of(kept) == before

    kept.add("T3", "fail disk_full")
    kept.run()
    export, sheet = kept.raw / "T1" / "frame.csv", kept.raw / "T1" / "test.yaml"
    export.write_text("63", "utf-8")
    look(kept.folders)
    sheet.write_text(f"{sheet.read_text('utf-8')}operator: somebody\n", "utf-8")
    assert as_rebuilt()
    assert look(kept.folders).rows["T1"].why == "export changed (frame.csv), sheet changed"
    aside = [(kept.raw / name, kept.home / f"aside-{name}") for name in ("T1", "T2", "T3")]
    for there, away in aside:
        there.rename(away)
    assert as_rebuilt()
    assert look(kept.folders).rows["T3"].type == ""
    for there, away in aside:
        away.rename(there)
    assert as_rebuilt()
    clear_failures(kept.folders)
    assert as_rebuilt()
    (kept.processed / "T2" / "summary.json").write_text("{", "utf-8")
    assert as_rebuilt()
