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
    (kept.raw / "T1" / "photo.jpg").write_text("", "utf-8")
    (kept.raw / "notes \x07.txt").write_text("", "utf-8")
    with opened_campaign(kept.folders) as keeper:
        files = account_for(keeper, keeper.refresh())
    assert files == {
        "used": ["T1/frame.csv", "T1/test.yaml"],
        "waiting": ["T4/test.yaml", "more/T3/frame.csv", "more/T3/test.yaml"],
        "failed": ["T2/frame.csv", "T2/test.yaml"],
        "unknown": ["T1/photo.jpg", "T4/frame.csv", "notes \x07.txt"],
    }
