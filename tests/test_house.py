"""The table of sizes goes down, or up with a reason."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from benchmarks.house import faults, lowered

TABLE: dict[str, Any] = {"a lines": 10, "b files": {"most": 3, "because": "A new reader."}}


@pytest.mark.parametrize(
    ("found", "changelog", "expected"),
    [
        ({"a lines": 10, "b files": 3}, "- A new reader.", 0),
        ({"a lines": 9, "b files": 2}, "- A new reader.", 0),
        ({"a lines": 11, "b files": 3}, "- A new reader.", 1),
        ({"a lines": 10, "b files": 3}, "", 1),
        ({"a lines": 10, "c files": 1}, "- A new reader.", 1),  # a room that the table has not
    ],
)
def test_what_grew_is_named(found: dict[str, int], changelog: str, expected: int) -> None:
    assert len(faults(found, TABLE, changelog)) == expected


def test_the_table_only_goes_down() -> None:
    now = tomllib.loads(lowered({"a lines": 12, "b files": 2, "c files": 5}, TABLE))
    assert now == {"a lines": 10, "b files": 2, "c files": 5}
    kept = tomllib.loads(lowered({"a lines": 8, "b files": 3}, TABLE))
    assert kept == {"a lines": 8, "b files": TABLE["b files"]}
