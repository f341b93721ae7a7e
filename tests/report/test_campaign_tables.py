from __future__ import annotations

from dataclasses import replace

from labpipe.records.group import Campaign
from labpipe.report.campaign_tables import (
    concern_tables,
    difference_table,
    method_tables,
    table_of_tests,
)
from tests.builders.campaigns import build_campaign, build_difference


def test_concerns_are_counted_in_their_captions() -> None:
    tables = concern_tables(build_campaign())
    assert [table.caption for table in tables] == [
        "Tests that could not be read (1)",
        "Failed: numbers that could not be computed (1)",
        "Doubtful: numbers to be checked (1)",
        "Marked as outliers (they stay in every mean) (1)",
        "Slips in the grips (1)",
        "Warnings (2)",
    ]


def test_differences() -> None:
    table = difference_table(build_campaign())
    assert table is not None
    assert [cell.text for cell in table.rows[0]] == [
        "Stiffness, first region (N/mm)", "-1.42", "-1.60 to -1.24", "0.500",
        "They differ by more than the margin of 10 %.",
    ]  # fmt: skip
    unknown = replace(build_difference(), margin=None)
    unknown = replace(unknown, difference=replace(unknown.difference, interval=None))
    table = difference_table(Campaign("Synthetic", (), (unknown,)))
    assert table is not None
    assert [cell.text for cell in table.rows[0][2:4]] == ["\u2013", "\u2013"]
    assert difference_table(Campaign("Synthetic", ())) is None


def test_methods_and_tests() -> None:
    campaign = build_campaign()
    (methods,) = method_tables(campaign)
    assert methods.caption == "Protocol twist-tube: how each number was made"
    ways = {cells[0].text: cells[1].text for cells in methods.rows}
    assert ways["Peak force, cycle 1"] == "parabola through the top of the curve"
    tests = table_of_tests(campaign)
    assert len(tests.rows) == 7
    assert [cell.text for cell in tests.rows[0]] == [
        "tt-s1a", "twist-tube-10", "length 75 mm", "twist-tube",
        "processed/synthetic/tt-s1a/result.h5",
    ]  # fmt: skip
