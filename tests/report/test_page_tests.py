from __future__ import annotations

from dataclasses import replace
from datetime import date

from labpipe.records.group import Campaign
from labpipe.records.result import InputFile
from labpipe.report.page_facts import PageTests
from labpipe.report.page_tests import export_table, page_file, test_rows
from tests.builders.campaigns import build_campaign, build_group, six_samples

test_rows.__test__ = False  # type: ignore[attr-defined] # a function of the page, no test


def test_rows_say_state_day_first_number_and_decision() -> None:
    campaign = build_campaign()
    tests = PageTests(campaign, ["a", "b", "c"])
    rows = test_rows(campaign, tests, {"a": "twist-tube-10", "b": "twist-tube-7", "c": "x"})
    assert [row.test.state for row in rows] == [
        "doubtful", "ok", "ok", "ok", "failed", "ok", "ok",
    ]  # fmt: skip
    assert rows[0].why == "A slip at 5.2 mm."
    assert rows[0].first.small == "Peak force, cycle 1 (N)"
    assert rows[4].first.text == "\u2013"
    assert (rows[6].group, rows[6].day, rows[6].operator) == ("twist-tube-7", "", "")


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


def test_exports_with_their_fingerprints() -> None:
    sample = replace(six_samples()[0], inputs=(InputFile("frame", "a.txt", "ab" * 32, 9),))
    tests = PageTests(Campaign("S", (build_group("A", [sample]),)), ["a"])
    ((name, files),) = export_table(tests).rows
    assert (name.text, files.text) == (sample.test, f"a.txt: {'ab' * 32}")
