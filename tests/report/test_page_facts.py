from __future__ import annotations

from dataclasses import replace
from datetime import date

from labpipe.records.group import Campaign
from labpipe.records.result import Instrument, Status
from labpipe.report.page_facts import (
    PageTests,
    days_words,
    home_of,
    instrument_lines,
    operators_words,
    report_id,
    state_of,
)
from tests.builders.campaigns import build_group, build_sample, six_samples, troubled_samples

CELL = Instrument("force", ("force",), "LC-500", date(2025, 1, 1), date(2026, 1, 1))


def test_tests_are_numbered_group_by_group_and_rejected_ones_last() -> None:
    samples = six_samples(slips=0)
    made = (build_group("A", samples[:2]), build_group("B", samples[3:]))
    groups = tuple(replace(each, fields={"type": "twist-tube-10"}) for each in made)
    out = samples[2]
    campaign = Campaign("S", groups, rejected={out.source: "bent"}, rejected_samples=(out,))
    tests = PageTests(campaign, ["a", "b"])
    assert [(each.number, each.stem, each.state) for each in tests.every] == [
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


def test_the_worst_number_is_the_state_of_a_test() -> None:
    states = [state_of(sample) for sample in troubled_samples()]
    assert states == [Status.DOUBTFUL, "ok", "ok", "ok", Status.FAILED, "ok"]


def test_days_and_operators_and_what_is_missing_of_them() -> None:
    one, two, three = six_samples()[:3]
    assert days_words([one]) == "on an unknown day (no sheet states one)"
    assert operators_words([one]) == "operator not stated"
    one = replace(one, date=date(2026, 3, 6), operator="A. Tester")
    two = replace(two, date=date(2026, 3, 2), operator="A. Tester")
    assert days_words([one, two]) == "2026-03-02 to 2026-03-06"
    assert days_words([one, three]) == "2026-03-06, 1 test of unknown day"
    assert operators_words([one, two, three]) == "A. Tester (1 test without operator)"


def test_an_overdue_calibration_is_said_with_its_tests() -> None:
    one, two, three = (replace(each, instruments=(CELL,)) for each in six_samples()[:3])
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
