"""Bad input of tensile tests through the command: refused in one message, or told as doubtful."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest

from labpipe.virtual_lab.tensile_scenarios import twist_tube
from tests.builders import bad_input
from tests.builders.reasons import why
from tests.builders.small_tests import Run, state
from tests.builders.tensile_tests import TensileLab, make_tensile

Change = Callable[[TensileLab], object]
Refused: TypeAlias = bad_input.Refused[TensileLab]
Told: TypeAlias = bad_input.Told[TensileLab]
HEAD = 8
"""Lines above the numbers in the export."""


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> TensileLab:
    """A twist tube with earlier results."""
    from labpipe.process.run import process_test

    lab = make_tensile(tmp_path_factory.mktemp("done"), twist_tube("1b"))
    process_test(lab.sheet, figures=False)
    assert len(state(lab.home / "processed")) == 2
    return lab


@pytest.fixture
def lab(done: TensileLab, tmp_path: Path) -> TensileLab:
    return done.copy(tmp_path)


@pytest.fixture
def refused(lab: TensileLab, run: Run) -> Refused:
    return bad_input.Refused(lab, run)


@pytest.fixture
def told(lab: TensileLab, run: Run) -> Told:
    return bad_input.Told(lab, run)


def change_lines(change: Callable[[list[str]], list[str]]) -> Change:
    def changed(lab: TensileLab) -> None:
        lines = change(lab.export.read_bytes().decode("utf-8-sig").split("\r\n"))
        lab.export.write_bytes("\r\n".join(lines).encode("utf-8-sig"))

    return changed


def swap(old: str, new: str) -> Change:
    return lambda lab: lab.edit(lab.export.name, old, new)


def statuses(lab: TensileLab) -> dict[str, str]:
    return {name: each["status"] for name, each in lab.results.items()}


# Refused


def test_wrong_dialect(refused: Refused) -> None:
    message = refused(lambda lab: lab.override("sources.frame.dialect", "bluehill"))
    assert "(Timed).txt: expected an export of the dialect bluehill, found one of the" in message
    assert "dialect mts-testsuite. Name the right file, or change `dialect`" in message


def test_unknown_dialect(refused: Refused) -> None:
    message = refused(lambda lab: lab.override("sources.frame.dialect", "testsuit"))
    assert "dialect 'testsuit': expected one of the " in message
    assert "found no such card. Nearest: mts-testsuite, " in message


def test_mixed_decimal_signs(refused: Refused) -> None:
    def mixed(lines: list[str]) -> list[str]:
        lines[60] = lines[60].replace(".", ",")
        return lines

    message = refused(change_lines(mixed))
    assert "line 61, column 'Crosshead': expected a number with a decimal point, found '" in message
    assert "with a decimal comma. Export the test again with one decimal sign" in message


def test_missing_row_of_units(refused: Refused) -> None:
    message = refused(change_lines(lambda lines: lines[: HEAD - 1] + lines[HEAD:]))
    assert (
        "line 7: expected a row of units above the numbers, found 'Crosshead, Load, Ti" in message
    )


def test_columns_swapped_beside_their_units(refused: Refused) -> None:
    message = refused(swap("Crosshead \tLoad ", "Load \tCrosshead "))
    assert "channel 'Load': expected a unit of the dimension of N, found 'mm'" in message


def test_a_channel_that_is_not_there(refused: Refused) -> None:
    message = refused(swap("Crosshead \tLoad ", "Crosshead \tLast "))
    assert "(Timed).txt" in message
    assert "'Last'" in message


def test_aborted_after_three_rows(refused: Refused) -> None:
    message = refused(change_lines(lambda lines: [*lines[: HEAD + 3], ""]))
    assert "twist-tube-1b, frame, time: expected at least 8 samples, found 3" in message


def test_nothing_but_a_byte_order_mark(refused: Refused) -> None:
    message = refused(lambda lab: lab.export.write_bytes(b"\xef\xbb\xbf"))
    assert "(Timed).txt: expected samples, found none in this file. The test was" in message


def test_a_part_given_twice(refused: Refused) -> None:
    def twice(lab: TensileLab) -> None:
        other = lab.raw / "again.txt"
        other.write_bytes(lab.export.read_bytes())
        text = lab.sheet.read_text("utf-8")
        start = text.index("files:")
        names = "[again.txt, 'DAQ- Crosshead, … - (Timed).txt']"
        lab.sheet.write_text(f"{text[:start]}files: {{frame: {names}}}\n", "utf-8")

    message = refused(twice)
    assert "time: expected a start after " in message
    assert "Parts of one recording share one clock. If these are two tests, give each" in message


def test_a_part_that_is_missing(refused: Refused) -> None:
    message = refused(lambda lab: lab.export.unlink())
    assert "(files.frame): expected a file, found none of that name" in message


# Doubtful


def test_kilonewtons_taken_for_newtons(told: Told) -> None:
    lab = told(swap("mm\tkN\tsec", "mm\tN\tsec"), 0)
    assert lab.notes["implausible_peak"].startswith("the largest value is 0.42")
    assert lab.notes["implausible_peak"].endswith(
        "N, plausible are 20 to 5000 N: is the unit right, and is it this channel?"
    )
    found = statuses(lab)
    # Where it broke does not rest on the force.
    assert {name for name, each in found.items() if each == "ok"} == {"failure_displacement"}
    assert set(found.values()) == {"ok", "doubtful"}


def test_a_unit_that_contradicts_the_export(refused: Refused) -> None:
    message = refused(lambda lab: lab.override("sources.frame.channels.force.unit", "N"))
    assert "expected the unit that the export states, 'kN', found " in message
    assert "'sources.frame.channels.force.unit: N'. Write kN there. Only if the export's" in message


def test_a_unit_in_the_export_that_is_said_to_be_wrong(told: Told) -> None:
    def change(lab: TensileLab) -> None:
        lab.override("sources.frame.channels.force.unit", "lbf")
        lab.override("sources.frame.channels.force.wrong_unit_in_file", "kN")

    usual = told(lambda _: None, 0).results["peak_force.1"]["value"]
    lab = told(change)
    pounds = lab.results["peak_force.1"]["value"]
    assert pounds == pytest.approx(usual * 4.4482216152605 / 1e3, rel=0.01)
    assert lab.notes["unit_overridden"].startswith("the export says 'kN', the protocol 'lbf'")


def without_units(lab: TensileLab) -> None:
    """A table of three columns whose names do not belong to the numbers below them."""
    lines = lab.export.read_text("utf-8-sig").splitlines()[HEAD:]
    rows = [[float(cell) for cell in line.split("\t")] for line in lines]
    lab.export.unlink()
    body = [f"{time},{travel},{1e3 * load}" for travel, load, time in rows]
    (lab.raw / "pull.csv").write_text("\n".join(["Time (s),Load,Crosshead", *body, ""]), "utf-8")
    text = lab.sheet.read_text("utf-8")
    lab.sheet.write_text(text[: text.index("files:")] + "files: {frame: pull.csv}\n", "utf-8")
    lab.override("sources.frame.channels.force.unit", "N")
    lab.override("sources.frame.channels.displacement.unit", "mm")


def test_columns_swapped_without_units(told: Told) -> None:
    lab = told(without_units, 1)
    assert re.match(
        r"8\d\.\d+ mm/s measured over the first branch, 5 mm/s expected: look at rig.crosshead_spe",
        lab.notes["speed_unexpected"],
    )
    assert "ok" not in statuses(lab).values()


def test_a_test_that_never_failed(told: Told) -> None:
    lab = told(change_lines(lambda lines: [*lines[:480], ""]), 1)
    for name in ("failure_displacement", "failure_force", "energy_to_break"):
        assert lab.results[name]["value"] is None
        assert re.fullmatch(
            r"no_break: the force ends at 400\.\d N, 100% of its peak 400\.\d N; below 50% "
            r"counts as lost; if this test cannot give it, write 'results\.failure: .*",
            why(lab.results[name]),
        )
    for name in ("peak_force.1", "stiffness_first_per_peak_force"):
        assert lab.results[name]["status"] == "doubtful"
        assert why(lab.results[name]).endswith("while still loading")
    assert lab.results["stiffness_first"]["status"] == "ok"


def test_a_window_beyond_the_travel(told: Told) -> None:
    lab = told(lambda lab: lab.override("results.stiffness_second.to", "80 mm"), 1)
    found = lab.results["stiffness_second"]
    assert (found["value"], found["status"]) == (None, "failed")
    assert why(found).startswith("not_reached: the branch reaches 24.9 mm, 80 mm is asked; ")
    assert "'results.stiffness_second.to: {value: 24.9 mm, because: ...}'" in why(found)
    found = lab.results["stiffness_second_per_peak_force"]
    assert why(found) == "no_stiffness: stiffness_second is not available"
    assert lab.results["stiffness_first"]["status"] == "ok"


def test_a_modulus_without_sizes(told: Told) -> None:
    def asked(lab: TensileLab) -> None:
        lab.override("results.8", "{result: modulus, of: stiffness_first, area: stated}")

    found = told(asked, 1).results["modulus"]
    assert why(found) == "no_area: specimen.section.area not given"


def test_nothing_moves(told: Told) -> None:
    lab = told(lambda lab: lab.override("branches.min_stroke", "200 mm"), 1)
    assert set(statuses(lab).values()) == {"failed"}
    reasons = {why(each) for each in lab.results.values()}
    assert all(
        re.match(r"no_motion: the motion spans 2\d(\.\d)? mm, less", each)
        or each.startswith("no_stiffness")
        for each in reasons
    )
