from __future__ import annotations

from dataclasses import replace

from labpipe.records.group import Outlier
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution
from labpipe.report.group_tables import Cell, Table
from labpipe.report.page_facts import PageTests
from labpipe.report.page_groups import (
    about_group,
    budget_causes,
    budget_drawing,
    number_table,
    result_cell,
    samples_tables,
)
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples
from tests.builders.campaigns import troubled_samples as troubled


def row(table: Table, head: str) -> tuple[Cell, ...]:
    return next(cells for cells in table.rows if cells[0].text.startswith(head))


def test_few_samples_are_columns() -> None:
    group = build_group("A", six_samples()[:3])
    table = number_table(group)
    assert table.heads[2:] == ("Mean, 95 %", "n", "s", "tt-s1a", "tt-s1b", "tt-s1c")
    cells = row(table, "Stiffness, first region (N/mm)")
    assert cells[0].tip == "stiffness_first"
    assert "\u00b1" in cells[5].text
    assert cells[3].text == "3"
    assert not samples_tables(group, PageTests(build_campaign(), ["a", "b", "c"]))


def test_many_samples_are_rows() -> None:
    campaign = build_campaign()
    tests = PageTests(campaign, ["a", "b", "c"])
    (first,) = samples_tables(campaign.groups[0], tests)
    assert len(first.heads) == 2 + 7
    assert [cells[0].text for cells in first.rows] == [f"tt-s{n}{x}" for n in "12" for x in "abc"]
    assert first.rows[3][0].link == "#t3"
    assert first.rows[0][3].mark == "?"


def test_what_is_averaged_is_said() -> None:
    table = number_table(build_group("A", troubled()))
    assert row(table, "Stiffness, first region (N/mm)")[3].text == "2 spools"
    assert row(table, "Stiffness, second region (N/mm)")[3].text == "5 of 6"
    assert any("each of which counts once" in note for note in table.notes)
    assert any("Student's t is 12.7" in note for note in table.notes)


def test_reasons_stand_once_with_their_tests() -> None:
    notes = number_table(build_group("A", troubled())).notes
    assert "? A slip at 5.2 mm. (tt-s1a)" in notes
    assert "\u2013 3 samples where 8 are needed. (tt-s2b)" in notes
    lone = number_table(build_group("A", [build_sample("s1", "a")])).notes
    assert any("One value has no spread" in note and "(all numbers)" in note for note in lone)


def test_an_outlier_is_marked_and_named() -> None:
    group = build_group("A", six_samples()[:3])
    odd = Outlier("tt-s1b", 1.0, "Grubbs' test", 0.01)
    numbers = (replace(group.numbers[0], outliers=(odd,)), *group.numbers[1:])
    table = number_table(replace(group, numbers=numbers))
    assert [cell.mark for cell in table.rows[0]] == ["", "", "", "", "", "", "!", ""]
    assert "! tt-s1b stands apart in peak force, cycle 1. It stays in every mean." in table.notes


def test_a_number_that_no_sample_has() -> None:
    table = number_table(build_group("A", [troubled()[4]]))
    assert [cell.text for cell in table.rows[0][2:]] == ["\u2013", "0", "\u2013", "\u2013"]
    assert result_cell(None, 1.0).tip == "not asked for"


def test_what_is_said_of_a_group() -> None:
    assert about_group(build_group("A", six_samples())) == (
        "6 samples from 2 spools, protocol twist-tube, tested on an unknown day (no sheet states"
        " one) by operator not stated."
    )


def test_the_budget_is_drawn_with_its_causes() -> None:
    parts = (Contribution("noise", 3.0, False), Contribution("scale of the force", 4.0, True))
    samples = [
        replace(each, results=tuple(replace(one, budget=parts) for one in each.results))
        for each in six_samples()[:1]
    ]
    group = build_group("A <b>", samples)
    drawing = str(budget_drawing(group))
    assert "A &lt;b&gt;" in drawing
    assert ">36<" in drawing
    assert ">64<" in drawing
    assert [(cause, shared) for cause, _, shared in budget_causes(group)] == [
        ("noise", False), ("scale of the force", True),
    ]  # fmt: skip
    bare = replace(group, numbers=())
    assert budget_drawing(bare) is None


def test_a_failed_number_has_its_reason_in_the_notes() -> None:
    reason = Reason("x", "the corner is at the end")
    sample = troubled()[4]
    results = tuple(replace(each, reasons=(reason,)) for each in sample.results)
    notes = number_table(build_group("A", [replace(sample, results=results)])).notes
    assert notes[-1] == f"\u2013 The corner is at the end. ({sample.test})"
