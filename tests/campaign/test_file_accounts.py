from __future__ import annotations

from pathlib import Path

from labpipe.campaign.file_accounts import account_for
from labpipe.campaign.refreshing import opened_campaign
from tests.builders.kept_campaigns import KeptCampaign


def test_every_file_is_used_waiting_failed_or_unknown(tmp_path: Path) -> None:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    kept.add("T2", "fail bad_sheet")
    kept.run()
    kept.add("more/T3")
    (kept.add("T4") / "test.yaml").write_text("test: [", "utf-8")
    (kept.raw / "campaign.yaml").write_text("", "utf-8")
    (kept.raw / "T1" / "photo.jpg").write_text("", "utf-8")
    (kept.raw / "notes \x07.txt").write_text("", "utf-8")
    with opened_campaign(kept.folders) as keeper:
        files = account_for(keeper, keeper.refresh())
    assert files == {
        "used": ["T1/frame.csv", "T1/test.yaml", "campaign.yaml"],
        "waiting": ["T4/test.yaml", "more/T3/frame.csv", "more/T3/test.yaml"],
        "failed": ["T2/frame.csv", "T2/test.yaml"],
        "unknown": ["T1/photo.jpg", "T4/frame.csv", "notes \x07.txt"],
    }


PLAN = """\
version: 1
pair: {by: name, from: incoming, exports: {frame: "{test}_frame.csv"}}
"""


def test_files_that_a_campaign_yaml_pairs(tmp_path: Path) -> None:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    kept.run()
    (kept.raw / "campaign.yaml").write_text(PLAN, "utf-8")
    (kept.raw / "incoming").mkdir()
    for name in ("T1_frame.csv", "T2_frame.csv", "x.csv"):
        (kept.raw / "incoming" / name).write_text("", "utf-8")

    with opened_campaign(kept.folders) as keeper:
        files = account_for(keeper, keeper.refresh())

    assert "campaign.yaml" in files["used"]
    assert "incoming/T1_frame.csv" in files["used"]
    assert files["waiting"] == ["incoming/T2_frame.csv"]
    assert files["unknown"] == ["incoming/x.csv"]


def test_a_campaign_yaml_that_is_wrong_pairs_nothing(tmp_path: Path) -> None:
    kept = KeptCampaign(tmp_path)
    kept.add("T1")
    (kept.raw / "campaign.yaml").write_text("version: 2", "utf-8")
    with opened_campaign(kept.folders) as keeper:
        files = account_for(keeper, keeper.refresh())
    assert files["used"] == ["campaign.yaml"]
