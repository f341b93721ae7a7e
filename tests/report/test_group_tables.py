from __future__ import annotations

from dataclasses import replace

from labpipe.records.group import Decision
from labpipe.records.quality import Reason
from labpipe.report.group_tables import (
    Cell,
    Table,
    means_of,
    sample_tables,
    slip_table,
    spool_means,
)
from tests.builders.campaigns import (
    build_group,
    build_sample,
    six_samples,
    troubled_samples,
)


def row(table: Table, head: str) -> tuple[Cell, ...]:
    return next(cells for cells in table.rows if cells[0].text.startswith(head))


def test_means_say_what_was_averaged() -> None:
    table = means_of(build_group("A", troubled_samples()))
    first = row(table, "Stiffness, first region (N/mm)")
    assert first[0].small == "stiffness_first"
    assert first[3] == Cell("2 spool means", "without tt-s2b")
    assert row(table, "Stiffness, second region (N/mm)")[3].text == "5 samples"
    assert " to " in first[2].text


def test_reasons_without_interval_stand_once() -> None:
    table = means_of(build_group("A", [build_sample("s1", "a")]))
    assert len(table.notes) == 1
    assert table.notes[0].startswith("No interval: One value has no spread to make an interval of.")
    assert all(cells[2].text == "\u2013" and cells[4].text == "\u2013" for cells in table.rows)


def test_a_number_that_no_sample_has() -> None:
    group = build_group("A", [troubled_samples()[4]])
    assert [cell.text for cell in means_of(group).rows[0][1:]] == [
        "\u2013", "\u2013", "no sample has it", "\u2013",
    ]  # fmt: skip
    assert spool_means(group).rows == ()


def test_spool_means_with_the_decision() -> None:
    table = spool_means(build_group("A", six_samples()))
    assert table.heads == ("Number", "Spool s1", "Spool s2", "Decision")
    assert table.notes == ()
    cells = row(table, "Stiffness, first region (N/mm)")
    assert cells[1].small.endswith("n = 3")
    assert cells[3].text.startswith("Not pooled: the spools differ")


def test_samples_with_marks_for_doubtful_and_reasons_for_failed() -> None:
    first, second = sample_tables(build_group("A", troubled_samples()))
    assert len(first.heads) == 5
    assert second.caption == "A: every sample, part 2 of 2"
    doubtful, failed = row(first, "tt-s1a"), row(first, "tt-s2b")
    assert [cell.mark for cell in doubtful] == ["", "", "?", "", ""]
    assert failed[1] == Cell("\u2013", "too few samples")
    assert first.notes == (
        "? tt-s1a: A slip at 5.2 mm.",
        "\u2013 tt-s2b: 3 samples where 8 are needed.",
    )


def test_a_result_that_a_sample_was_not_asked_for() -> None:
    samples = six_samples()
    samples[1] = replace(samples[1], results=samples[1].results[1:])
    group = build_group("A", six_samples())
    table = sample_tables(replace(group, samples=tuple(samples)))[0]
    assert row(table, "tt-s1b")[1] == Cell("\u2013", "not asked for")


def test_slips() -> None:
    table = slip_table(build_group("A", six_samples()))
    assert table is not None
    assert table.heads[1:3] == ("Displacement (mm)", "Force lost (N)")
    assert table.rows[0][1] == Cell("12.000", "11.990 to 12.010")
    assert slip_table(build_group("A", six_samples(slips=0))) is None


def test_tests_that_are_not_in_a_mean_are_named_beside_it() -> None:
    group = build_group("A", six_samples())
    first = group.numbers[1]
    left_out = {group.samples[0].test: (Reason("made_otherwise", "over 1 mm to 9 mm"),)}
    numbers = (group.numbers[0], replace(first, left_out=left_out), *group.numbers[2:])
    table = means_of(replace(group, numbers=numbers))
    without = row(table, "Stiffness, first region (N/mm)")[3].small
    assert without == f"without {group.samples[0].test}"
    assert row(table, "Stiffness, second region (N/mm)")[3].small == ""


def with_decisions(*decisions: Decision) -> Table:
    group = build_group("A", six_samples())
    numbers = [
        replace(number, mean=replace(number.mean, decision=decision))
        for number, decision in zip(group.numbers, decisions, strict=False)
        if number.mean is not None
    ]
    return spool_means(replace(group, numbers=tuple(numbers)))


def test_a_decision_that_holds_for_all_numbers_stands_once() -> None:
    table = with_decisions(
        *[Decision("Over 3 samples of one spool", ("the type is not known",))] * 2
    )
    assert table.heads == ("Number", "Spool s1", "Spool s2")
    assert len(table.rows[0]) == 3
    assert table.notes == ("Over 3 samples of one spool: the type is not known.",)


def test_what_decisions_share_stands_below_the_table() -> None:
    table = with_decisions(
        Decision("Over 2 spool means", ("90 % lies between", "the test cannot tell")),
        Decision("Over 2 spool means", ("80 % lies between", "the test cannot tell")),
    )
    assert [cells[3].text for cells in table.rows] == ["90 % lies between.", "80 % lies between."]
    assert table.notes == ("Every number: over 2 spool means; the test cannot tell.",)
    table = with_decisions(
        Decision("Over 2 spool means", ("no scatter", "no test")),
        Decision("Over 2 spool means", ("no test",)),
    )
    assert [cells[3].text for cells in table.rows] == ["No scatter.", "As below."]


def test_wide_intervals_over_two_spools_are_explained_once() -> None:
    (note,) = means_of(build_group("A", six_samples())).notes
    assert "one degree of freedom, where Student's t is 12.7" in note
    assert "a third spool brings t down to 4.3" in note
    one_spool = build_group("A", six_samples()[:3])
    assert not means_of(one_spool).notes
