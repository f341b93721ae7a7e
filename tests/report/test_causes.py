"""What needs a look: issues, and a line per cause, ranked by what it does to a number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from math import inf, sqrt

import pytest
from scipy import stats

from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Group, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report.issues import Kind, find_causes, find_issues
from labpipe.report.page_tables import make_note_table
from labpipe.statistics import groups
from tests.builders.bundle_campaigns import bundle_sample
from tests.builders.campaigns import build_group, build_sample, troubled_samples
from tests.report.figure_words import cell_text


def warning(code: str, where: str, message: str = "odd", *tests: str) -> QualityNote:
    return QualityNote(code, Severity.WARNING, where, message, tests=tests)


def campaign_of(*members: Group) -> Campaign:
    return Campaign("Synthetic", members)


def test_numbers_without_interval_and_samples_left_out() -> None:
    sample = build_sample("s1", "a")
    bare = replace(sample.results[0], interval=None, reasons=(Reason("one_point", "a point."),))
    group = build_group("A", [replace(sample, results=(bare, *sample.results[1:]))])
    left_out = {"tt-s1a": (Reason("no_result", "no such result."),)}
    number = replace(group.numbers[1], exclusions=left_out)
    group = replace(group, numbers=(number,), notes=(warning("short_overlap", "curves"),))
    issues = find_issues(campaign_of(group))
    assert [(issue.kind, issue.tests, issue.topic) for issue in issues] == [
        (Kind.LEFT_OUT, ("tt-s1a",), "Stiffness, first region"),
        (Kind.WARNING, (), "curves"),
        (Kind.NO_INTERVAL, ("tt-s1a",), "Peak force, cycle 1"),
    ]


def test_tests_that_were_not_processed_alike_come_before_all_numbers() -> None:
    notes = [warning("protocols_differ", "align", "another method")]
    notes += [
        warning("protocols_differ", where, "line to 8 mm (a) and 9 mm (b)")
        for where in ("stiffness_first", "stiffness_first_per_peak_force", "curve.failure.from")
    ]
    group = replace(build_group("A", troubled_samples()), notes=tuple(notes))
    first = find_issues(campaign_of(group))[0]
    stiffness = "Stiffness, first region"
    assert first.kind is Kind.PROCESSING
    assert first.topic == f"align; {stiffness}; {stiffness}, per peak force; curve.failure.from"
    assert first.reason == "Another method. Line to 8 mm (a) and 9 mm (b)."
    assert first.code == "protocols_differ"


DRIFT = (Reason("drift", "the zero drifts"),)
BASE = bundle_sample(None, 1)
TEN = {"a": 10, "b": 11, "c": 15}


def group_of(
    values: Mapping[str, float | None],
    doubtful: Sequence[str] = (),
    *notes: QualityNote,
    quality: Mapping[str, tuple[QualityNote, ...]] | None = None,
    name: str = "A",
    spools: str = "",
) -> Group:
    """A group whose stiffness has these values; a letter of `spools` is the spool of a test."""
    samples: list[Sample] = []
    for test, value in values.items():
        status = Status.DOUBTFUL if test in doubtful else Status.OK
        status = Status.FAILED if value is None else status
        reasons = () if status is Status.OK else DRIFT
        result = Result("stiffness", value, "N/m", None, status, reasons, method="m")
        test_notes = (quality or {}).get(test, ())
        spool = spools[len(samples)] if spools else BASE.specimen.spool
        specimen = replace(BASE.specimen, spool=spool, sample=test)
        sample = replace(BASE, test=test, specimen=specimen, results=(result,), loading=())
        samples.append(replace(sample, quality=test_notes))
    return replace(groups.build_group(name, "p", samples, signed_names={"stiffness"}), notes=notes)


def test_one_cause_in_many_tests_is_one_line() -> None:
    first, second = group_of(TEN, "ac"), group_of({"d": 10, "e": 11, "f": 12}, "f", name="B")
    reasons = (Reason("switch", "two labels"), *DRIFT)
    samples = list(first.samples)
    samples[0] = replace(samples[0], results=(replace(samples[0].results[0], reasons=reasons),))
    (cause,) = find_causes(campaign_of(replace(first, samples=tuple(samples)), second))[0]
    assert cause.subject == "3 tests in 2 groups"
    assert [issue.code for issue in cause.issues] == ["switch, drift", "drift", "drift"]
    assert find_causes(campaign_of(first))[0][0].subject == "2 tests of A"


@pytest.mark.parametrize("codes", [*permutations(["drift", "switch", "drift, switch"])])
def test_the_order_of_tests_does_not_change_their_causes(codes: Sequence[str]) -> None:
    group = group_of(TEN, "abc")
    samples = []
    for sample, text in zip(group.samples, codes, strict=True):
        reasons = tuple(Reason(code, code) for code in text.split(", "))
        samples.append(replace(sample, results=(replace(sample.results[0], reasons=reasons),)))
    (cause,) = find_causes(campaign_of(replace(group, samples=tuple(samples))))[0]
    assert [issue.tests for issue in cause.issues] == [("a",), ("b",), ("c",)]


def test_a_rejected_test_is_named_and_ranked_as_decided() -> None:
    campaign = campaign_of(group_of(TEN, "c"))
    doubtful, cause = find_causes(replace(campaign, rejected={"x/result.h5": "it slipped"}))[0]
    assert (doubtful.kind, cause.kind) == (Kind.DOUBTFUL, Kind.REJECTED)
    assert (cause.subject, cause.sentence) == ("x/result.h5", "it slipped")
    assert cause.effect is not None
    assert cause.effect.text == "A decision excludes it from all means"


def test_the_largest_effect_comes_first_and_the_unknown_last() -> None:
    small = group_of({**TEN, "d": 12}, "d", warning("dimensions_differ", "group"))
    failed = group_of({"e": None, "f": None}, name="B")
    causes = find_causes(replace(campaign_of(small, failed), failures={"x.h5": "x.h5: no result"}))[
        0
    ]
    kinds = [Kind.UNREADABLE, Kind.FAILED, Kind.DOUBTFUL, Kind.WARNING]
    assert [cause.kind for cause in causes] == kinds
    assert (causes[-1].effect, causes[-1].subject) == (None, "A")


def test_tests_that_a_note_of_the_group_names_are_left_out_for_its_effect() -> None:
    note = warning("protocols_differ", "align", "set otherwise from test to test", "c")
    (cause,) = find_causes(campaign_of(group_of(TEN, (), note)))[0]
    assert cause.effect is not None
    assert cause.effect.text.startswith("Stiffness of A would be 12 % lower without this test")
    assert cause.subject == "c (A)"
    assert cause.sentence == "Processed differently from other tests of their group: align."


def test_a_note_that_no_number_rests_on_is_no_cause() -> None:
    gap, drift = warning("gap_left", "Marker5", "no position, 30 frames"), warning("drift", "force")
    campaign = campaign_of(group_of(TEN, "c", quality={"a": (gap,), "c": (gap, drift)}))
    (cause,) = find_causes(campaign)[0]
    assert (cause.kind, len(cause.issues)) == (Kind.DOUBTFUL, 1)
    (note,) = notes = find_causes(campaign)[1]
    assert (note.code, note.subject, note.effect) == ("gap_left", "2 tests of A", None)
    table = make_note_table(notes)
    assert table is not None
    assert list(map(cell_text, table.rows[0])) == ["No position, 30 frames.", "2", "2 tests of A"]
    assert make_note_table([]) is None


HALF = 4.302653 * 2.645751 / sqrt(3)
"""Half of the interval of the mean of 10, 11 and 15: t(2) s / sqrt 3."""
WIDER = (stats.t.ppf(0.975, 2) / sqrt(3)) / (stats.t.ppf(0.975, 3) / 2)
"""Three of four: t(2) / sqrt 3 over t(3) / sqrt 4 = 2.484 / 1.591."""


@pytest.mark.parametrize(
    ("values", "doubtful", "size", "text"),
    [
        # mean 12; without 15 it is 10.5, 12.5 % lower
        ((10, 11, 15), "c", 1.5 / HALF,
         "Stiffness of A would be 12 % lower without this test, 0.23 times half its interval"),
        ((10, 11), "ab", None, "All values of Stiffness of A are affected"),
        ((10, 11, 12, None), "", WIDER - 1.0,
         "Stiffness of A is the mean of 3 of 4 values, with an interval about 1.6 times as wide"),
        ((10, None), "", None, "One value of Stiffness of A remains, without an interval"),
        ((None, None), "", inf, "No value of Stiffness of A remains"),
    ],
)  # fmt: skip
def test_what_a_cause_does_to_a_mean(
    values: tuple[float | None, ...], doubtful: str, size: float | None, text: str
) -> None:
    group = group_of(dict(zip("abcd", values, strict=False)), doubtful)
    (cause,) = find_causes(campaign_of(group))[0]
    assert cause.effect is not None
    assert cause.effect.text == text
    assert cause.effect.size > 1.0 if size is None else cause.effect.size == pytest.approx(size)
    assert cause.kind is (Kind.DOUBTFUL if doubtful else Kind.FAILED)
    set_by_rig = tuple(replace(number, is_set_by_rig=True) for number in group.numbers)
    (cause,) = find_causes(campaign_of(replace(group, numbers=set_by_rig)))[0]
    assert cause.effect is None


@pytest.mark.parametrize(
    ("spools", "text"),
    [
        ("xxyyzzv", "Stiffness of A is the mean of 3 of 4 values"),  # of spools
        ("xxyyzzz", "Stiffness of A is a mean of spools with 6 of 7 tests"),
    ],
)
def test_a_mean_over_spools_loses_spools(spools: str, text: str) -> None:
    values = dict(zip("abcdefg", (10, 10.1, 15, 15.1, 20, 20.1, None), strict=True))
    group = group_of(values, spools=spools)
    assert not group.numbers[0].mean.is_pooled
    (cause,) = find_causes(campaign_of(group))[0]
    assert cause.effect is not None
    assert cause.effect.text.startswith(text)


def test_tests_of_one_name_are_members_of_a_mean_by_their_files() -> None:
    group = group_of({"a": 10, "b": 11, "c": None})
    samples = [replace(sample, test="a", source=f"{sample.test}.h5") for sample in group.samples]
    group = groups.build_group("A", "p", samples, signed_names={"stiffness"})
    assert list(group.numbers[0].values) == ["a (a.h5)", "a (b.h5)"]
    failed = next(
        cause for cause in find_causes(campaign_of(group))[0] if cause.kind is Kind.FAILED
    )
    assert failed.subject == "a (c.h5) (A)"
    assert failed.effect is not None
    assert failed.effect.text.startswith("Stiffness of A is the mean of 2 of 3 values")


def test_a_shift_of_a_mean_whose_interval_has_no_width_comes_first() -> None:
    group = group_of(TEN, "a")
    nested = group.numbers[0].mean
    narrow = replace(nested.chosen, interval=Interval(12.0, 12.0), is_log=False)
    number = replace(group.numbers[0], mean=replace(nested, chosen=narrow))
    (cause,) = find_causes(campaign_of(replace(group, numbers=(number,))))[0]
    assert cause.effect == (inf, "Stiffness of A would be 8.3 % higher without this test")
