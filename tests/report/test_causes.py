"""What needs a look: concerns, and a line per cause, ranked by what it does to a number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, sqrt

import pytest
from scipy import stats

from labpipe.records.curve import SlipDecision
from labpipe.records.group import Campaign, Group, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report.group_tables import cause_lines, method_tables, note_table
from labpipe.report.issue_ranking import find_causes, find_notes
from labpipe.report.issues import (
    Issue,
    Kind,
    decision_words,
    find_issues,
    sentence,
    sentences,
)
from labpipe.statistics import groups
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_sample
from tests.builders.campaigns import build_campaign, build_group, build_sample, troubled_samples
from tests.report.figure_words import table_words


def only(concerns: tuple[Issue, ...], kind: Kind) -> list[Issue]:
    return [concern for concern in concerns if concern.kind is kind]


def test_numbers_without_interval_and_samples_left_out() -> None:
    sample = build_sample("s1", "a")
    bare = replace(
        sample.results[0], interval=None, reasons=(Reason("one_point", "a single point."),)
    )
    sample = replace(sample, results=(bare, *sample.results[1:]))
    group = build_group("A", [sample])
    number = replace(
        group.numbers[1], left_out={"tt-s1a": (Reason("no_result", "no such result."),)}
    )
    note = QualityNote("short_overlap", Severity.WARNING, "curves", "They share 2 mm only.")
    group = replace(group, numbers=(number,), notes=(note,))
    concerns = find_issues(Campaign("Synthetic", (group,)))
    assert [(concern.kind, concern.test, concern.what) for concern in concerns] == [
        (Kind.LEFT_OUT, "tt-s1a", "Stiffness, first region"),
        (Kind.WARNING, "", "curves"),
        (Kind.NO_INTERVAL, "tt-s1a", "Peak force, cycle 1"),
    ]


def test_tests_that_were_not_processed_alike_come_before_all_numbers() -> None:
    notes = [
        QualityNote("protocols_differ", Severity.WARNING, "align", "another method"),
    ]
    notes += [
        QualityNote("protocols_differ", Severity.WARNING, where, "line to 8 mm (a) and 9 mm (b)")
        for where in ("stiffness_first", "stiffness_first_per_peak_force", "curve.failure.from")
    ]
    group = replace(build_group("A", troubled_samples()), notes=tuple(notes))
    first = find_issues(Campaign("Synthetic", (group,)))[0]
    assert first.kind is Kind.UNLIKE
    stiffness = "Stiffness, first region"
    assert first.what == f"align; {stiffness}; {stiffness}, per peak force; curve.failure.from"
    assert first.reason == "Another method. Line to 8 mm (a) and 9 mm (b)."
    assert first.code == "protocols_differ"


DRIFT = (Reason("drift", "the zero drifts"),)
BASE = bundle_sample(None, 1)


def group_of(
    values: Mapping[str, float | None],
    *,
    doubtful: Sequence[str] = (),
    notes: tuple[QualityNote, ...] = (),
    quality: Mapping[str, tuple[QualityNote, ...]] | None = None,
    name: str = "A",
) -> Group:
    """A group whose stiffness has these values."""
    samples: list[Sample] = []
    for test, value in values.items():
        status = Status.DOUBTFUL if test in doubtful else Status.OK
        if value is None:
            status = Status.FAILED
        reasons = () if status is Status.OK else DRIFT
        result = Result("stiffness", value, "N/m", None, status, reasons, method="m")
        own = (quality or {}).get(test, ())
        samples.append(replace(BASE, test=test, results=(result,), quality=own, loading=()))
    built = groups.build_group(name, "p", samples, signed={"stiffness"})
    return replace(built, notes=notes)


def campaign_of(*groups: Group) -> Campaign:
    return Campaign("Synthetic", groups)


def test_one_cause_in_many_tests_is_one_line() -> None:
    first = group_of({"a": 10, "b": 11, "c": 15}, doubtful=["a", "c"])
    second = group_of({"d": 10, "e": 11, "f": 12}, doubtful=["f"], name="B")
    (cause,) = find_causes(campaign_of(first, second))
    assert cause.subject == "3 tests in 2 groups"
    assert len(cause.concerns) == 3
    assert find_causes(campaign_of(first))[0].subject == "2 tests of A"


def test_reasons_that_share_a_code_are_one_cause() -> None:
    own = group_of({"a": 10, "b": 11, "c": 12}, doubtful=["a", "b"])
    both = (Reason("switch", "two labels"), *DRIFT)
    samples = list(own.samples)
    other = replace(samples[0].results[0], reasons=both)
    samples[0] = replace(samples[0], results=(other,))
    (cause,) = find_causes(campaign_of(replace(own, samples=tuple(samples))))
    assert [concern.code for concern in cause.concerns] == ["switch, drift", "drift"]


def test_a_rejected_test_is_named_and_ranked_as_decided() -> None:
    own = group_of({"a": 10, "b": 11, "c": 15}, doubtful=["c"])
    first, last = find_causes(replace(campaign_of(own), rejected={"x/result.h5": "it slipped"}))
    assert first.kind is Kind.DOUBTFUL
    assert (last.kind, last.subject, last.sentence) == (Kind.REJECTED, "x/result.h5", "it slipped")
    assert last.effect is not None
    assert last.effect.words == "in no mean, as was decided"


def test_the_largest_effect_comes_first_and_the_unknown_last() -> None:
    note = QualityNote("dimensions_differ", Severity.WARNING, "group", "the samples differ")
    small = group_of({"a": 10, "b": 11, "c": 15, "d": 12}, doubtful=["d"], name="A", notes=(note,))
    lost = group_of({"e": None, "f": None}, name="B")
    found = find_causes(replace(campaign_of(small, lost), left_out={"x.h5": "x.h5: no result"}))
    assert [finding.kind for finding in found] == [
        Kind.UNREADABLE, Kind.FAILED, Kind.DOUBTFUL, Kind.WARNING
    ]  # fmt: skip
    assert found[-1].effect is None
    assert found[-1].subject == "A"


def test_tests_that_a_note_of_the_group_names_are_left_out_for_its_effect() -> None:
    message = "set otherwise from test to test"
    note = QualityNote("protocols_differ", Severity.WARNING, "align", message, tests=("c",))
    (cause,) = find_causes(campaign_of(group_of({"a": 10, "b": 11, "c": 15}, notes=(note,))))
    assert cause.effect is not None
    assert cause.effect.words.startswith("without it, Stiffness of A would be 12 % lower")
    assert cause.subject == "c (A)"
    assert cause.sentence == "Processed otherwise than the other tests of their group: align."


def test_a_note_that_no_number_rests_on_is_no_cause() -> None:
    gap = QualityNote("gap_left", Severity.WARNING, "Marker5", "30 frames")
    drift = QualityNote("drift", Severity.WARNING, "force", "the zero drifts")
    own = group_of(
        {"a": 10, "b": 11, "c": 15}, doubtful=["c"], quality={"a": (gap,), "c": (gap, drift)}
    )
    (cause,) = find_causes(campaign_of(own))
    assert (cause.kind, len(cause.concerns)) == (Kind.DOUBTFUL, 1)
    (note,) = find_notes(campaign_of(own))
    assert (note.code, note.subject, note.effect) == ("gap_left", "2 tests of A", None)


def test_notes_of_which_nothing_follows_are_one_table() -> None:
    note = QualityNote("gap_left", Severity.WARNING, "Marker5", "no position, 30 frames")
    samples = [replace(build_sample("s1", name), quality=(note,)) for name in "abc"]
    campaign = Campaign("Synthetic", (build_group("A", samples),))
    assert not cause_lines(find_causes(campaign))
    table = note_table(campaign)
    assert table is not None
    assert [[cell.text for cell in row] for row in table.rows] == [
        ["No position, 30 frames.", "3", "3 tests of A"]
    ]
    assert table.rows[0][0].tip == "gap_left"
    assert note_table(Campaign("Synthetic", ())) is None


HALF = 4.302653 * 2.645751 / sqrt(3)
"""Half of the interval of the mean of 10, 11 and 15: t(2) s / sqrt 3."""
WIDER = (stats.t.ppf(0.975, 2) / sqrt(3)) / (stats.t.ppf(0.975, 3) / 2)
"""Three of four: t(2) / sqrt 3 over t(3) / sqrt 4 = 2.484 / 1.591."""


@pytest.mark.parametrize(
    ("values", "doubtful", "size", "words"),
    [
        # mean 12; without 15 it is 10.5, 12.5 % lower
        ((10, 11, 15), "c", 1.5 / HALF,
         "without it, Stiffness of A would be 12 % lower, 0.23 of half its interval"),
        ((10, 11), "ab", None, "all values of Stiffness of A"),
        ((10, 11, 12, None), "", WIDER - 1.0,
         "Stiffness of A over 3 of 4 values, its interval about 1.6 times as wide"),
        ((10, None), "", None, "Stiffness of A over one value, without an interval"),
        ((None, None), "", inf, "no value of Stiffness of A"),
    ],
)  # fmt: skip
def test_what_a_cause_does_to_a_mean(
    values: tuple[float | None, ...], doubtful: str, size: float | None, words: str
) -> None:
    own = group_of(dict(zip("abcd", values, strict=False)), doubtful=list(doubtful))
    (cause,) = find_causes(campaign_of(own))
    assert cause.effect is not None
    assert cause.effect.words == words
    assert cause.effect.size > 1.0 if size is None else cause.effect.size == pytest.approx(size)
    assert cause.kind is (Kind.DOUBTFUL if doubtful else Kind.FAILED)
    set_by_rig = [replace(number, is_set_by_rig=True) for number in own.numbers]
    (cause,) = find_causes(campaign_of(replace(own, numbers=tuple(set_by_rig))))
    assert cause.effect is None


def test_sentences() -> None:
    for said, expected in (
        ("the end.", "The end."), ("no stop here", "No stop here."), ("", ""),
        ("stiffness_second is not available", "Stiffness, second region is not available."),
        ("doubtful: peak_force.1 (tt-a)", "Doubtful: peak force, cycle 1 (tt-a)."),
    ):  # fmt: skip
        assert sentence(said) == expected
    reasons = (Reason("not_reached", "the end"), None, Reason("gap", "3 samples are missing"))
    assert sentences(reasons) == "The end. 3 samples are missing."
    assert all(decision_words(decision).endswith(".") for decision in SlipDecision)


def test_lines_of_causes(approved: Approve) -> None:
    lines = cause_lines(find_causes(build_campaign()))
    heads = [f"{line.head}: {line.said} {line.subject}: {line.effect}" for line in lines]
    tables = [words for line in lines for words in table_words(line.details)]
    (methods,) = method_tables(build_campaign())
    approved([*heads, *tables, *table_words(methods)])
