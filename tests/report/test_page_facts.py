"""What a report's page says of tests, groups and the whole campaign, before it is markup."""

from __future__ import annotations

from dataclasses import replace
from datetime import date

from labpipe.records.group import Campaign, Decision, Outlier
from labpipe.records.quality import Reason
from labpipe.records.result import Instrument, Status
from labpipe.report.group_tables import Table, slip_table, spool_means
from labpipe.report.issue_ranking import find_causes
from labpipe.report.page_facts import (
    PageTests,
    days_words,
    home_of,
    instrument_lines,
    operators_words,
    report_id,
    state_of,
)
from labpipe.report.page_groups import (
    about_group,
    number_table,
    result_cell,
    samples_tables,
)
from labpipe.report.page_tests import page_file, test_rows
from labpipe.report.summary_page import answers, count_words, key_blocks, to_decide
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import (
    build_campaign,
    build_group,
    build_sample,
    six_samples,
    troubled_samples,
)
from tests.report.figure_words import table_words

CELL = Instrument("force", ("force",), "LC-500", date(2025, 1, 1), date(2026, 1, 1))


def test_tests_are_numbered_group_by_group_and_rejected_ones_last() -> None:
    samples = six_samples(slips=0)
    made = (build_group("A", samples[:2]), build_group("B", samples[3:]))
    groups = tuple(replace(each, fields={"type": "twist-tube-10"}) for each in made)
    out = samples[2]
    campaign = Campaign("S", groups, rejected={out.source: "bent"}, rejected_samples=(out,))
    tests = PageTests(campaign, ["a", "b"])
    assert [(test.number, test.stem, test.state) for test in tests.every] == [
        (0, "a", "ok"), (1, "a", "ok"), (2, "b", "ok"), (3, "b", "ok"), (4, "b", "ok"),
        (5, "a", "rejected"),
    ]  # fmt: skip
    assert [each.why for each in tests.rejected("a")] == ["bent"]
    assert tests.by_name[samples[4].test].number == 3


def test_a_rejected_test_goes_where_it_fits_best() -> None:
    sample = build_sample("s1", "a")
    a = replace(build_group("A", [sample]), fields={"type": "twist-tube-10", "spool": "s0"})
    b = replace(a, name="B", fields={"type": "twist-tube-10", "spool": "s1"})
    c = replace(a, name="C", fields={"type": "other", "spool": "s1", "length": "75 mm"})
    assert home_of(sample, Campaign("S", (a, b, c))) == "B"
    assert home_of(sample, Campaign("S", (c,))) == ""
    assert home_of(replace(sample, protocol="other"), Campaign("S", (a, b))) == ""




def test_an_overdue_calibration_is_said_with_its_tests() -> None:
    one, two, three = (replace(six_sample, instruments=(CELL,)) for six_sample in six_samples()[:3])
    one, two = replace(one, date=date(2025, 12, 31)), replace(two, date=date(2026, 1, 2))
    (fine,) = instrument_lines([one, three])
    assert (fine.due, fine.is_overdue) == ("calibration due 2026-01-01", False)
    (late,) = instrument_lines([one, two, three])
    assert (late.due, late.is_overdue) == (
        "calibration OVERDUE since 2026-01-01 in 1 test", True,
    )  # fmt: skip
    (silent,) = instrument_lines([replace(one, instruments=(replace(CELL, due=None),))])
    assert silent.due == "no due date stated"


def test_the_id_of_a_report_changes_with_its_tests_and_decisions() -> None:
    group = build_group("A", six_samples())
    campaign = Campaign("S", (group,))
    known = report_id(campaign)
    assert known == report_id(Campaign("S", (group,)))
    fewer = replace(group, samples=group.samples[1:])
    other = [
        replace(campaign, groups=(fewer,)), replace(campaign, rejected={"x": "bent"}),
        replace(campaign, title="T"),
    ]  # fmt: skip
    assert len({known, *map(report_id, other)}) == 4


test_rows.__test__ = False  # type: ignore[attr-defined] # a function of the page, no test




def test_decided_and_rejected() -> None:
    samples = six_samples(slips=0)
    kept = replace(samples[0], decided="fine (me)", date=date(2026, 3, 2), operator="me")
    out = replace(samples[1], label="c/x")
    group = build_group("A", [kept])
    campaign = Campaign("S", (group,), rejected={out.source: "bent (me)"}, rejected_samples=(out,))
    tests = PageTests(campaign, ["a"])
    one, two = test_rows(campaign, tests, {"a": "A"})
    assert (one.decided, one.said, one.day) == ("accept", "fine (me)", "2026-03-02")
    assert (two.decided, two.said, two.why) == ("reject", "bent (me)", "Rejected: bent (me)")
    assert two.page == "tests/c__x.html" == page_file("c/x")
    odd = replace(two, page=page_file("a#1 50 %?"))
    assert odd.address == "tests/a%231%2050%20%25%3F.html"




def test_pairs_are_folded_by_their_question() -> None:
    found = {answer.field: answer for answer in answers(bundle_campaign(conduit_cases()))}
    number = found["wire"]
    assert number.question == "Wire: B1, B1 & B2, B2"
    assert number.verdict.startswith("DIFFERENT ")
    assert number.difference.startswith("Bending stiffness +")
    assert number.difference.endswith(f", largest of {len(number.pairs.rows)} pairs")
    assert number.counts == "3 v 3"
    assert not answers(Campaign("S", ()))


def test_key_numbers_of_each_protocol() -> None:
    campaign = build_campaign()
    (block,) = key_blocks(campaign, ["a", "b", "c"])
    assert block.heads == (
        "Peak force, cycle 1 (N)", "Stiffness, first region (N/mm)",
        "Stiffness, second region (N/mm)",
    )  # fmt: skip
    assert [(row.name, row.n) for row in block.rows] == [
        ("twist-tube-10", 6), ("twist-tube-7", 1), ("twist-tube-5", 0),
    ]  # fmt: skip
    first, lone, empty = block.rows
    assert "\u00b1" in first.numbers[0].text
    assert "\u00b1" in lone.numbers[0].text  # how well the one test was measured
    assert "one test" in lone.numbers[0].tip
    assert [cell.text for cell in empty.numbers] == ["\u2013"] * 3
    assert first.sparkline is not None
    assert (empty.sparkline, empty.strip) == (None, None)
    other = replace(campaign.groups[1], protocol="another")
    two = key_blocks(replace(campaign, groups=(campaign.groups[0], other)), ["a", "b"])
    assert [len(side.rows) for side in two] == [1, 1]


def test_what_is_to_be_decided_until_somebody_did() -> None:
    campaign = build_campaign()
    tests = PageTests(campaign, ["a", "b", "c"])
    open_ones = to_decide(find_causes(campaign), tests)
    assert {open_one.line.head for open_one in open_ones} == {"Failed", "Doubtful", "Outlier"}
    assert count_words(campaign, open_ones).endswith(" 3 to decide")
    first = campaign.groups[0]
    decided = [replace(sample, decided="fine (me)") for sample in first.samples]
    settled = replace(campaign, groups=(replace(first, samples=tuple(decided)),))
    assert not to_decide(find_causes(settled), PageTests(settled, ["a"]))
    assert count_words(settled, []).endswith(" 0 to decide")


def with_decisions(*decisions: Decision) -> Table:
    group = build_group("A", six_samples())
    numbers = [
        replace(number, mean=replace(number.mean, decision=decision))
        for number, decision in zip(group.numbers, decisions, strict=False)
        if number.mean is not None
    ]
    return spool_means(replace(group, numbers=tuple(numbers)))


def test_days_operators_and_calibrations_in_words(approved: Approve) -> None:
    one, two, three = six_samples()[:3]
    march = replace(one, date=date(2026, 3, 6), operator="A. Tester")
    later = replace(two, date=date(2026, 3, 2), operator="A. Tester")
    tests = ([one], [march, later], [march, three], [march, later, three])
    approved([
        *(f"{days_words(some)} by {operators_words(some)}" for some in tests),
        about_group(build_group("A", six_samples())),
    ])  # fmt: skip


def test_tables_of_a_group(approved: Approve) -> None:
    """Columns and rows of samples, means of spools, reasons, outliers, slips."""
    few, sample = build_group("A", six_samples()[:3]), troubled_samples()[4]
    odd = Outlier("tt-s1b", 1.0, "Grubbs' test", 0.01)
    marked = (replace(few.numbers[0], outliers=(odd,)), *few.numbers[1:])
    reason = Reason("x", "the corner is at the end")
    failed = tuple(replace(result, reasons=(reason,)) for result in sample.results)
    assert not samples_tables(few, PageTests(build_campaign(), ["a", "b", "c"]))
    assert slip_table(build_group("A", six_samples(slips=0))) is None
    six = build_group("A", six_samples())
    slips = slip_table(six)
    assert slips is not None
    tables = [
        number_table(few),
        number_table(build_group("A", troubled_samples())),
        number_table(build_group("A", [build_sample("s1", "a")])),
        number_table(replace(few, numbers=marked)),
        number_table(build_group("A", [sample])),
        number_table(build_group("A", [replace(sample, results=failed)])),
        spool_means(six),
        slips,
    ]
    approved(line for table in tables for line in table_words(table))
    assert result_cell(None, 1.0).tip == "not asked for"


def test_decisions_how_spools_are_averaged(approved: Approve) -> None:
    """One that holds for all numbers stands once, and what they share below the table."""
    one, over_two = "Over 3 samples of one spool", "Over 2 spool means"
    tables = [
        with_decisions(*[Decision(one, ("the type is not known",))] * 2),
        with_decisions(
            Decision(over_two, ("90 % lies between", "the test cannot tell")),
            Decision(over_two, ("80 % lies between", "the test cannot tell")),
        ),
        with_decisions(
            Decision(over_two, ("no scatter", "no test")), Decision(over_two, ("no test",))
        ),
    ]
    approved(line for table in tables for line in table_words(table))
