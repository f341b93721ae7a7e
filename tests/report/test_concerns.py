from __future__ import annotations

from dataclasses import replace

from labpipe.records.curve import SlipDecision
from labpipe.records.group import Campaign
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Status
from labpipe.report.concerns import (
    Concern,
    Kind,
    decision_words,
    find_concerns,
    sentence,
    sentences,
)
from tests.builders.campaigns import (
    build_campaign,
    build_group,
    build_sample,
    six_samples,
    troubled_samples,
)


def only(concerns: tuple[Concern, ...], kind: Kind) -> list[Concern]:
    return [each for each in concerns if each.kind is kind]


def test_everything_that_is_not_fine_is_found_worst_first() -> None:
    concerns = find_concerns(build_campaign())
    assert [each.kind for each in concerns] == sorted(
        (each.kind for each in concerns), key=list(Kind).index
    )
    assert only(concerns, Kind.UNREADABLE)[0].reason.startswith("result.h5: expected an HDF5 file")
    failed = only(concerns, Kind.FAILED)
    assert [(each.test, each.code) for each in failed] == [("tt-s2b", "too_few_samples")]
    assert failed[0].what.startswith("Peak force, cycle 1; Stiffness, first region; ")
    assert failed[0].reason == "3 samples where 8 are needed."
    doubtful = only(concerns, Kind.DOUBTFUL)
    assert [(each.test, each.what) for each in doubtful] == [("tt-s1a", "Stiffness, first region")]
    assert only(concerns, Kind.OUTLIER)[0].reason == (
        "5.400 N/mm stands apart from the other samples by Grubbs' test (p = 0.013)."
    )
    assert [each.what for each in only(concerns, Kind.SLIP)] == [
        "6.00 N (5.50 to 6.50) lost at 12.000 mm (11.990 to 12.010)"
    ]
    warnings = only(concerns, Kind.WARNING)
    assert [(each.test, each.what) for each in warnings] == [
        ("tt-s2b", "frame"),
        ("", "empty group"),
    ]


def test_nothing_to_look_at() -> None:
    group = build_group("A", six_samples(slips=0))
    assert find_concerns(Campaign("Synthetic", (group,))) == ()


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
    concerns = find_concerns(Campaign("Synthetic", (group,)))
    assert [(each.kind, each.test, each.what) for each in concerns] == [
        (Kind.LEFT_OUT, "tt-s1a", "Stiffness, first region"),
        (Kind.WARNING, "", "curves"),
        (Kind.NO_INTERVAL, "tt-s1a", "Peak force, cycle 1"),
    ]


def test_a_failed_result_is_told_once() -> None:
    concerns = find_concerns(build_campaign())
    assert not only(concerns, Kind.LEFT_OUT)
    campaign = build_campaign()
    first = campaign.groups[0]
    assert first.numbers[0].left_out.keys() == {"tt-s2b"}
    assert any(each.status is Status.FAILED for each in first.samples[4].results)


def test_reasons() -> None:
    assert sentence("the end.") == "The end."
    assert sentence("no stop here") == "No stop here."
    assert sentence("") == ""
    reasons = (Reason("not_reached", "the end"), None, Reason("gap", "3 samples are missing"))
    assert sentences(reasons) == "The end. 3 samples are missing."
    assert all(decision_words(each).endswith(".") for each in SlipDecision)


def test_tests_that_were_not_processed_alike_come_before_all_numbers() -> None:
    notes = [
        QualityNote("protocols_differ", Severity.WARNING, "align", "another method"),
    ]
    notes += [
        QualityNote("protocols_differ", Severity.WARNING, where, "line to 8 mm (a) and 9 mm (b)")
        for where in ("stiffness_first", "stiffness_first_per_peak_force", "curve.failure.from")
    ]
    group = replace(build_group("A", troubled_samples()), notes=tuple(notes))
    first = find_concerns(Campaign("Synthetic", (group,)))[0]
    assert first.kind is Kind.UNLIKE
    stiffness = "Stiffness, first region"
    assert first.what == f"align; {stiffness}; {stiffness}, per peak force; curve.failure.from"
    assert first.reason == "Another method. Line to 8 mm (a) and 9 mm (b)."
    assert first.code == "protocols_differ"


def test_names_of_results_in_a_sentence_are_words() -> None:
    assert sentence("stiffness_second is not available") == (
        "Stiffness, second region is not available."
    )
    assert sentence("doubtful values are in the means of: peak_force.1 (tt-a)") == (
        "Doubtful values are in the means of: peak force, cycle 1 (tt-a)."
    )
