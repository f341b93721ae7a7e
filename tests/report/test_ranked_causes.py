"""A line per cause, ranked by what it does to a number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, sqrt

import pytest
from scipy import stats

from labpipe.records.group import Campaign, Group, Sample
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Result, Status
from labpipe.report.concerns import Kind
from labpipe.report.ranked_causes import find_causes, find_notes
from labpipe.statistics.groups import build_group
from tests.builders.bundle_campaigns import bundle_sample

DRIFT = (Reason("drift", "the zero drifts"),)
BASE = bundle_sample(None, 1)


def group(
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
    built = build_group(name, "p", samples, signed={"stiffness"})
    return replace(built, notes=notes)


def campaign(*groups: Group) -> Campaign:
    return Campaign("Synthetic", groups)


def test_a_mean_without_the_doubtful_test() -> None:
    """10, 11, 15: mean 12, s = 2.6458; without 15 the mean is 10.5, 12.5 % lower."""
    (cause,) = find_causes(campaign(group({"a": 10, "b": 11, "c": 15}, doubtful=["c"])))
    half = 4.302653 * 2.645751 / sqrt(3)
    assert cause.effect is not None
    assert cause.effect.size == pytest.approx(1.5 / half, rel=1e-5)
    assert cause.effect.words == (
        "without it, Stiffness of A would be 12 % lower, 0.23 of half its interval"
    )
    assert (cause.kind, cause.code, cause.whom) == (Kind.DOUBTFUL, "drift", "c (A)")
    assert cause.sentence == "The zero drifts."


def test_one_cause_in_many_tests_is_one_line() -> None:
    first = group({"a": 10, "b": 11, "c": 15}, doubtful=["a", "c"])
    second = group({"d": 10, "e": 11, "f": 12}, doubtful=["f"], name="B")
    (cause,) = find_causes(campaign(first, second))
    assert cause.whom == "3 tests in 2 groups"
    assert len(cause.concerns) == 3
    assert find_causes(campaign(first))[0].whom == "2 tests of A"


def test_reasons_that_share_a_code_are_one_cause() -> None:
    own = group({"a": 10, "b": 11, "c": 12}, doubtful=["a", "b"])
    both = (Reason("switch", "two labels"), *DRIFT)
    samples = list(own.samples)
    other = replace(samples[0].results[0], reasons=both)
    samples[0] = replace(samples[0], results=(other,))
    (cause,) = find_causes(campaign(replace(own, samples=tuple(samples))))
    assert [each.code for each in cause.concerns] == ["switch, drift", "drift"]


def test_a_rejected_test_is_named_and_ranked_as_decided() -> None:
    own = group({"a": 10, "b": 11, "c": 15}, doubtful=["c"])
    first, last = find_causes(replace(campaign(own), rejected={"x/result.h5": "it slipped"}))
    assert first.kind is Kind.DOUBTFUL
    assert (last.kind, last.whom, last.sentence) == (Kind.REJECTED, "x/result.h5", "it slipped")
    assert last.effect is not None
    assert last.effect.words == "in no mean, as was decided"


def test_a_number_that_rests_on_doubtful_values_alone() -> None:
    (cause,) = find_causes(campaign(group({"a": 10, "b": 11}, doubtful=["a", "b"])))
    assert cause.effect is not None
    assert cause.effect.words == "all values of Stiffness of A"
    assert cause.effect.size > 1.0


def test_what_a_failed_test_costs() -> None:
    """Three of four: t(2) / sqrt 3 over t(3) / sqrt 4 = 2.484 / 1.591."""
    (cause,) = find_causes(campaign(group({"a": 10, "b": 11, "c": 12, "d": None})))
    wider = (stats.t.ppf(0.975, 2) / sqrt(3)) / (stats.t.ppf(0.975, 3) / 2)
    assert cause.effect is not None
    assert cause.effect.size == pytest.approx(wider - 1.0)
    assert cause.effect.words == (
        "Stiffness of A over 3 of 4 values, its interval about 1.6 times as wide"
    )
    (alone,) = find_causes(campaign(group({"a": 10, "b": None})))
    assert alone.effect is not None
    assert alone.effect.words == "Stiffness of A over one value, without an interval"
    (nothing,) = find_causes(campaign(group({"a": None, "b": None})))
    assert nothing.effect is not None
    assert (nothing.effect.size, nothing.effect.words) == (inf, "no value of Stiffness of A")


def test_the_largest_effect_comes_first_and_the_unknown_last() -> None:
    note = QualityNote("dimensions_differ", Severity.WARNING, "group", "the samples differ")
    small = group({"a": 10, "b": 11, "c": 15, "d": 12}, doubtful=["d"], name="A", notes=(note,))
    lost = group({"e": None, "f": None}, name="B")
    found = find_causes(replace(campaign(small, lost), left_out={"x.h5": "x.h5: no result"}))
    assert [each.kind for each in found] == [
        Kind.UNREADABLE, Kind.FAILED, Kind.DOUBTFUL, Kind.WARNING
    ]  # fmt: skip
    assert found[-1].effect is None
    assert found[-1].whom == "A"


def test_tests_that_a_note_of_the_group_names_are_left_out_for_its_effect() -> None:
    message = "set otherwise from test to test"
    note = QualityNote("protocols_differ", Severity.WARNING, "align", message, tests=("c",))
    (cause,) = find_causes(campaign(group({"a": 10, "b": 11, "c": 15}, notes=(note,))))
    assert cause.effect is not None
    assert cause.effect.words.startswith("without it, Stiffness of A would be 12 % lower")
    assert cause.whom == "c (A)"
    assert cause.sentence == "Processed otherwise than the other tests of their group: align."


def test_what_the_rig_sets_has_no_effect() -> None:
    own = group({"a": 10, "b": 11, "c": 15}, doubtful=["c"])
    is_set = [replace(each, is_set_by_rig=True) for each in own.numbers]
    (cause,) = find_causes(campaign(replace(own, numbers=tuple(is_set))))
    assert cause.effect is None


def test_a_note_that_no_number_rests_on_is_no_cause() -> None:
    gap = QualityNote("gap_left", Severity.WARNING, "Marker5", "30 frames")
    drift = QualityNote("drift", Severity.WARNING, "force", "the zero drifts")
    own = group(
        {"a": 10, "b": 11, "c": 15}, doubtful=["c"], quality={"a": (gap,), "c": (gap, drift)}
    )
    (cause,) = find_causes(campaign(own))
    assert (cause.kind, len(cause.concerns)) == (Kind.DOUBTFUL, 1)
    (note,) = find_notes(campaign(own))
    assert (note.code, note.whom, note.effect) == ("gap_left", "2 tests of A", None)


def test_more_reasons_are_counted() -> None:
    many = group({"a": 10, "b": 11, "c": 12}, doubtful=["a", "b"])
    samples = list(many.samples)
    other = replace(samples[1].results[0], reasons=(Reason("drift", "it drifts more"),))
    samples[1] = replace(samples[1], results=(other,))
    (cause,) = find_causes(campaign(replace(many, samples=tuple(samples))))
    assert cause.sentence == "The zero drifts. And 1 more."
