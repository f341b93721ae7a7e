from __future__ import annotations

from labpipe.report.group_tables import (
    concern_tables,
    method_tables,
    table_of_tests,
)
from tests.builders.campaigns import build_campaign


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
