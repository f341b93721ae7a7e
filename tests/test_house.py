"""The table of sizes goes down, or up with a reason."""

from __future__ import annotations

import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from benchmarks.house import before, faults, lowered

TABLE: dict[str, Any] = {"a lines": 10, "b files": {"most": 3, "because": "A new reader."}}


@pytest.mark.parametrize(
    ("found", "changelog", "earlier", "expected"),
    [
        ({"a lines": 10, "b files": 3}, "- A new reader.", {}, 0),
        ({"a lines": 9, "b files": 2}, "- A new reader.", {}, 0),
        ({"a lines": 11, "b files": 3}, "- A new reader.", {}, 1),
        ({"a lines": 10, "b files": 3}, "", {}, 1),
        ({"a lines": 10, "c files": 1}, "", {}, 1),  # a room that the table has not
        ({"a lines": 10}, "", {"a lines": 12}, 0),
        ({"a lines": 10}, "", {"a lines": 9}, 1),
        ({"b files": 3}, "- A new reader.", {"b files": 2}, 0),
        ({"b files": 3}, "- A new reader.", {"b files": {"most": 2, "because": "Old."}}, 0),
        ({"b files": 3}, "- A new reader.", {"b files": TABLE["b files"] | {"most": 2}}, 1),
    ],
)
def test_what_grew_is_named(
    found: dict[str, int], changelog: str, earlier: dict[str, Any], expected: int
) -> None:
    assert len(faults(found, TABLE, earlier, changelog)) == expected


def test_the_table_before_is_that_of_git(tmp_path: Path) -> None:
    place = tmp_path / "house.toml"

    def git(*arguments: str) -> None:
        who = ("-c", "user.name=t", "-c", "user.email=t@example.org")
        subprocess.run(["git", *who, *arguments], cwd=tmp_path, check=True)

    git("init", "-q")
    place.write_text("a = 1", encoding="utf-8")
    git("add", ".")
    git("commit", "-qm", "first")
    assert before(place) == {}
    place.write_text("a = 2", encoding="utf-8")
    assert before(place) == {"a": 1}
    git("commit", "-qam", "second")
    assert before(place) == {"a": 1}


def test_the_table_only_goes_down() -> None:
    now = tomllib.loads(lowered({"a lines": 12, "b files": 2, "c files": 5}, TABLE))
    assert now == {"a lines": 10, "b files": 2, "c files": 5}
    kept = tomllib.loads(lowered({"a lines": 8, "b files": 3}, TABLE))
    assert kept == {"a lines": 8, "b files": TABLE["b files"]}
