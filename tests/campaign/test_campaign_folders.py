from __future__ import annotations

import os
from pathlib import Path

import pytest

from labpipe.campaign.campaign_folders import (
    CampaignFolders,
    find_campaign,
    list_processed,
    list_raw,
    look_at_outcome,
)
from labpipe.errors import UsageError


@pytest.fixture
def campaign(tmp_path: Path) -> CampaignFolders:
    for name in ("T1", "more/T2", "figures", ".hidden/T3"):
        folder = tmp_path / "raw" / "C" / name
        folder.mkdir(parents=True)
        (folder / "test.yaml").write_text("", "utf-8")
        (folder / "force.mat").write_text("", "utf-8")
    (tmp_path / "raw" / "C" / "notes.txt").write_text("", "utf-8")
    (tmp_path / "processed" / "C").mkdir(parents=True)
    return find_campaign(tmp_path / "raw" / "C")


def test_both_folders_by_either(campaign: CampaignFolders) -> None:
    assert campaign.name == "C"
    assert campaign.processed.relative_to(campaign.raw.parents[1]) == Path("processed/C")
    assert find_campaign(campaign.processed) == campaign
    deeper = find_campaign(campaign.raw / "more")
    assert (deeper.name, deeper.processed) == ("C/more", campaign.processed / "more")


def test_paths_are_those_that_a_person_would_type(
    campaign: CampaignFolders, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(campaign.raw.parents[1])
    found = find_campaign(Path("raw/../raw/C"))
    assert (found.raw, found.processed) == (Path("raw/C"), Path("processed/C"))
    monkeypatch.chdir(campaign.raw)
    assert find_campaign(Path()).raw == Path()
    assert list_raw(find_campaign(Path())).sheets["T1"] == Path("T1/test.yaml")


def test_folders_that_are_no_campaign(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    for place, found in (("nowhere", "nothing of that name"), ("file", "a file")):
        with pytest.raises(UsageError, match=f"expected the folder of a campaign, found {found}"):
            find_campaign(tmp_path / place)
    with pytest.raises(UsageError, match="a folder below 'raw' or 'processed', found one that"):
        find_campaign(tmp_path)
    (tmp_path / "raw" / "T1").mkdir(parents=True)
    (tmp_path / "raw" / "T1" / "test.yaml").write_text("", "utf-8")
    with pytest.raises(UsageError, match=r"a campaign, found that of a single test\. Put the"):
        find_campaign(tmp_path / "raw" / "T1")


def test_tests_and_files_but_hidden_ones_and_links(campaign: CampaignFolders) -> None:
    (campaign.raw / "linked").symlink_to(campaign.raw / "T1")
    found = list_raw(campaign)
    assert found.sheets == {
        name: campaign.raw / name / "test.yaml" for name in ("T1", "figures", "more/T2")
    }
    assert sorted(found.files) == [
        "T1/force.mat", "T1/test.yaml", "figures/force.mat", "figures/test.yaml", "linked",
        "more/T2/force.mat", "more/T2/test.yaml", "notes.txt",
    ]  # fmt: skip
    assert found.refused == []


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_a_name_of_other_bytes_is_said(campaign: CampaignFolders) -> None:
    Path(os.fsdecode(os.fsencode(campaign.raw) + b"/\xff")).mkdir()
    found = list_raw(campaign)
    assert len(found.refused) == 1
    assert found.refused[0].endswith(
        "\\udcff: expected a name in UTF-8, found other bytes. Rename it; it was left out."
    )


def test_a_test_sheet_that_is_no_file_is_said(campaign: CampaignFolders) -> None:
    sheet = campaign.raw / "T1" / "test.yaml"
    sheet.unlink()
    sheet.symlink_to("nowhere")
    found = list_raw(campaign)
    assert "T1" not in found.sheets
    assert found.refused == [
        f"{sheet}: expected a file, found a pipe, or a link to nowhere. Put the test sheet there."
    ]


def test_a_campaign_whose_exports_are_gone(tmp_path: Path) -> None:
    (tmp_path / "processed" / "C").mkdir(parents=True)
    found = list_raw(find_campaign(tmp_path / "processed" / "C"))
    assert (found.sheets, found.files, found.refused) == ({}, [], [])


def test_outcomes_and_what_changes_their_marks(campaign: CampaignFolders) -> None:
    folder = campaign.processed / "T1"
    (folder / "figures").mkdir(parents=True)
    assert list_processed(campaign) == {}
    (folder / "summary.json").write_text("{}", "utf-8")
    half = list_processed(campaign)["T1"]
    assert (half.has_results, half.has_failure) == (False, False)
    (folder / "result.h5").write_text("", "utf-8")
    whole = list_processed(campaign)["T1"]
    assert whole == look_at_outcome(campaign, "T1")
    assert (whole.has_results, whole.has_failure) == (True, False)
    (folder / "failure.json").write_text("{}", "utf-8")
    assert list_processed(campaign)["T1"].has_failure
    (folder / "failure.json").unlink()
    assert list_processed(campaign)["T1"] == whole
    (folder / "summary.json").write_text("{ }", "utf-8")
    assert list_processed(campaign)["T1"] != whole


def test_what_a_killed_process_left_half_replaced_is_finished(campaign: CampaignFolders) -> None:
    folder = campaign.processed / "T1"
    files = folder / ".labpipe.commit" / "files"
    files.mkdir(parents=True)
    (files.parent / "gone").write_text("", "utf-8")
    for name in ("summary.json", "result.h5"):
        (files / name).write_text("{}", "utf-8")
    assert list_processed(campaign)["T1"].has_results
    assert sorted(path.name for path in folder.iterdir()) == ["result.h5", "summary.json"]
