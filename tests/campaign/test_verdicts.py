from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.verdicts import (
    GroupsSoFar,
    Shown,
    actions,
    actions_for,
    read_summary,
    refused,
    shown_by,
    verdict,
)
from labpipe.errors import CODES
from labpipe.protocol.reference import kinds_of_notes
from labpipe.records.quality import Severity
from tests.builders.small_tests import Lab

Summary = dict[str, Any]
MM = Shown({"force": "mN"}, ("peak_force.1",))


def summary(
    peak: float = 1.0, *, status: str = "ok", codes: Sequence[str] = (), length: float = 0.085
) -> Summary:
    reasons = [{"code": code, "message": "x"} for code in codes]
    energy = {"name": "energy.1", "value": 2.0, "unit": "J", "status": "ok", "reasons": []}
    force = {
        "name": "peak_force.1",
        "value": None if status == "failed" else peak,
        "unit": "N",
        "status": status,
        "reasons": reasons,
    }
    specimen = {"type": "A", "spool": "s", "sample": str(peak), "length": length}
    return {
        "protocol": "p",
        "specimen": specimen,
        "results": [energy, force, force | {"name": "peak_force.2"}],
        "quality": [],
    }


def put(folder: Path, said: Summary) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "summary.json").write_text(json.dumps(said), encoding="utf-8")
    return folder


def lines(tmp_path: Path, said: Summary, before: Sequence[Summary] = ()) -> list[str]:
    groups = GroupsSoFar()
    groups.read({put(tmp_path / f"T{i}", each): "run" for i, each in enumerate(before)})
    return verdict("T", tmp_path / "T", said, groups.group_of(said), MM)


def test_a_test_that_went_well(tmp_path: Path) -> None:
    assert lines(tmp_path, summary()) == [
        "T: WELL, 3 ok",
        "  peak_force.1 1000 mN; energy.1 2 J; the first of its group",
        "  nothing to look at: the specimen can come off",
    ]


def test_doubtful_and_failed_numbers_are_named_with_what_to_do(tmp_path: Path) -> None:
    said = summary(status="doubtful", codes=["zero_not_at_rest", "slip_in_window"])
    assert lines(tmp_path, said) == [
        "T: LOOK, 1 ok, 2 doubtful (peak_force.1, peak_force.2)",
        "  peak_force.1 1000 mN; energy.1 2 J; the first of its group",
        "  while it is mounted: let the machine stand for 5 s before it moves: the zero was not"
        " taken at rest; tighten the grips: the specimen slipped",
    ]
    failed = lines(tmp_path, summary(status="failed", codes=["no_cycle"]))
    assert failed[0] == "T: LOOK, 1 ok, 2 failed (peak_force.1, peak_force.2)"
    assert "peak_force" not in failed[1]
    assert "check the program of the machine" in failed[2]


def test_few_tests_give_a_range_and_no_judgement(tmp_path: Path) -> None:
    before = [summary(peak) for peak in (1.0, 1.1, 0.9)]
    head, numbers, _ = lines(tmp_path, summary(5.0), before)
    assert head == "T: WELL, 3 ok"
    assert numbers == (
        "  peak_force.1 5000 mN (so far 900 to 1100); energy.1 2 J (so far 2 to 2);"
        " n = 3 so far, too few to judge"
    )


def test_a_number_outside_the_spread_so_far(tmp_path: Path) -> None:
    before = [summary(1.0 + 0.01 * i) for i in range(-3, 4)]
    head, numbers, last = lines(tmp_path, summary(1.2), before)
    assert head == "T: LOOK, 3 ok, outside the group: peak_force.1"
    # 1 +- t(6 degrees, 1 - 0.05 / 6) * 0.0216 * sqrt(1 + 1 / 7), with t = 3.2875
    assert "peak_force.1 1200 mN (OUTSIDE 924.1 to 1076); " in numbers
    assert numbers.endswith("; n = 7 so far")
    assert last.startswith("  while it is mounted: compare the set-up with that of the other tests")
    assert "(within 924.1 to 1076)" in lines(tmp_path, summary(1.07), before)[1]


def test_numbers_with_groups_of_unlike_size_say_so_each(tmp_path: Path) -> None:
    before = [summary(), summary(status="doubtful", codes=["gap"])]
    numbers = lines(tmp_path, summary(), before)[1]
    assert numbers == (
        "  peak_force.1 1000 mN (so far 1000), n = 1 so far, too few to judge;"
        " energy.1 2 J (so far 2 to 2), n = 2 so far, too few to judge"
    )


def test_a_group_is_of_alike_specimens_without_the_test_itself(tmp_path: Path) -> None:
    groups = GroupsSoFar()
    folders = [put(tmp_path / f"T{i}", summary(i)) for i in range(3)]
    put(tmp_path / "L", summary(9.0, length=0.1))
    put(tmp_path / "D", summary(9.0, status="doubtful", codes=["gap"]))
    others = dict.fromkeys([tmp_path / "L", tmp_path / "D", tmp_path / "none"], "1")
    groups.read(dict.fromkeys(folders, "1") | others)

    group = groups.group_of(summary())
    assert sorted(group.of("peak_force.1", but=folders[1])) == [0.0, 2.0]

    put(folders[0], summary(7.0))  # processed again
    groups.read(dict.fromkeys(folders, "1"))
    assert sorted(group.of("peak_force.1", but=folders[1])) == [0.0, 2.0]
    groups.read({folders[0]: "2", folders[1]: "1"})  # the third is rejected
    assert sorted(group.of("peak_force.1", but=folders[1])) == [7.0]
    groups.read({folders[0]: "2", folders[1]: "1", folders[2]: "1"})
    assert sorted(group.of("peak_force.1", but=folders[1])) == [2.0, 7.0]


@pytest.mark.parametrize("text", ["", "[]", '{"results": 1}', "\x00"])
def test_a_summary_that_cannot_be_read_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "summary.json").write_text(text, encoding="utf-8")
    assert read_summary(tmp_path) is None
    GroupsSoFar().read({tmp_path: "1"})


def test_a_refused_test() -> None:
    assert refused("T", "unreadable_export", "f.mat: expected a, found b. Do.\nmore") == [
        "T: FAILED (unreadable_export)",
        "  f.mat: expected a, found b. Do.",
        "  while it is mounted: export the recording again: it cannot be read as it is",
    ]


def test_of_many_actions_the_first_are_said() -> None:
    many = ["slack_unknown", "no_break", "gap", "saturation", "cut", "gap"]
    said = actions_for(many)
    assert said.endswith("; and 2 more in summary.json")
    assert said.count(";") == 3 + actions()["no_break"].count(";") + 0


def test_every_code_that_doubts_or_fails_has_an_action(repository: Path) -> None:
    doubting = {
        each.code
        for each in kinds_of_notes()
        if each.origin == "processing" and (each.doubts or Severity.ERROR in each.severities)
    }
    page = (repository / "docs" / "reference" / "results.md").read_text(encoding="utf-8")
    table = page.partition("## Reason codes of failed results")[2].partition("In a [report]")[0]
    failing = set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE))
    said = set(re.findall(r"`(\w+)`", table))

    missing = (doubting | failing | set(CODES)) - set(actions()) - {"mid_span", "code"}
    assert not missing
    known = {each.code for each in kinds_of_notes()} | said | set(CODES)
    assert not set(actions()) - known  # no action for a code that there is not


def test_numbers_are_shown_as_the_protocol_says(lab: Lab) -> None:
    shown = shown_by(lab.sheet)
    assert shown.display["displacement"] == "mm"
    lab.sheet.write_text("test: x", encoding="utf-8")
    assert shown_by(lab.sheet) == Shown()
