from __future__ import annotations

from dataclasses import replace

from labpipe.records.group import Decision
from labpipe.report.group_tables import (
    Cell,
    Table,
    slip_table,
    spool_means,
)
from tests.builders.campaigns import (
    build_group,
    six_samples,
)


def row(table: Table, head: str) -> tuple[Cell, ...]:
    return next(cells for cells in table.rows if cells[0].text.startswith(head))


def test_spool_means_with_the_decision() -> None:
    table = spool_means(build_group("A", six_samples()))
    assert table.heads == ("Number", "Spool s1", "Spool s2", "Decision")
    assert table.notes == ()
    cells = row(table, "Stiffness, first region (N/mm)")
    assert cells[1].small.endswith("n = 3")
    assert cells[3].text.startswith("Not pooled: the spools differ")


def test_slips() -> None:
    table = slip_table(build_group("A", six_samples()))
    assert table is not None
    assert table.heads[1:3] == ("Displacement (mm)", "Force lost (N)")
    assert table.rows[0][1] == Cell("12.000", "11.990 to 12.010")
    assert slip_table(build_group("A", six_samples(slips=0))) is None


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
