from __future__ import annotations

from labpipe.records.quality import QualityNote, Severity


def test_notes_are_values() -> None:
    note = QualityNote("time_holes", Severity.WARNING, "force", "2 holes")
    assert note == QualityNote("time_holes", Severity("warning"), "force", "2 holes")
    assert len({note, QualityNote("time_holes", Severity.WARNING, "force", "2 holes")}) == 1
    assert f"{note.severity}" == "warning"
