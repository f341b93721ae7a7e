from __future__ import annotations

from dataclasses import replace

from labpipe.records.group import Campaign
from labpipe.records.quality import QualityNote, Severity
from labpipe.report.concerns import Kind, find_concerns
from labpipe.report.group_tables import (
    cause_lines,
    method_tables,
    note_table,
)
from labpipe.report.ranked_causes import Cause, find_causes
from tests.builders.campaigns import build_campaign, build_group, build_sample


def test_a_line_for_each_cause_with_all_that_share_it() -> None:
    lines = cause_lines(find_causes(build_campaign()))
    assert {line.head: line.details.caption for line in lines} == {
        "Not read": "Tests that could not be read (1)",
        "Failed": "Failed: numbers that could not be computed (1)",
        "Doubtful": "Doubtful: numbers to be checked (1)",
        "Outlier": "Marked as outliers (they stay in every mean) (1)",
        "Slips": "Slips in the grips (1)",
        "Warning": "Warnings (1)",
    }
    assert lines[0].head == "Not read"
    assert lines[0].effect == "the test is missing from all numbers"
    assert all(line.said and line.whom for line in lines)


def test_every_kind_of_concern_has_a_line() -> None:
    concern = find_concerns(build_campaign())[0]
    causes = [Cause(kind, "", (replace(concern, kind=kind),), None) for kind in Kind]
    assert len({line.head for line in cause_lines(causes)}) == len(Kind)


def test_notes_of_which_nothing_follows_are_one_table() -> None:
    note = QualityNote("gap_left", Severity.WARNING, "Marker5", "no position, 30 frames")
    samples = [replace(build_sample("s1", name), quality=(note,)) for name in "abc"]
    campaign = Campaign("Synthetic", (build_group("A", samples),))
    assert not cause_lines(find_causes(campaign))
    table = note_table(campaign)
    assert table is not None
    assert [[cell.text for cell in row] for row in table.rows] == [
        ["No position, 30 frames.", "3", "3 tests of A"]
    ]
    assert table.rows[0][0].tip == "gap_left"
    assert note_table(Campaign("Synthetic", ())) is None


def test_methods() -> None:
    campaign = build_campaign()
    (methods,) = method_tables(campaign)
    assert methods.caption == "Protocol twist-tube: how each number was made"
    ways = {cells[0].text: cells[1].text for cells in methods.rows}
    assert ways["Peak force, cycle 1"] == "parabola through the top of the curve"
