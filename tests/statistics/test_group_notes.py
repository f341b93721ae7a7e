"""What is said of a group whose samples or numbers need a word."""

from __future__ import annotations

from dataclasses import replace

from labpipe.records.quality import Reason, Severity
from labpipe.records.result import Status
from labpipe.statistics.group_notes import grouping_notes, sample_notes
from tests.builders.bundle_campaigns import bundle_of, bundle_sample
from tests.builders.sloped_samples import built, said, samples, stiffness


def test_doubtful_values_enter_and_are_listed() -> None:
    doubted = stiffness(60.0, status=Status.DOUBTFUL, reasons=(Reason("slip", "0.5 N at 3 mm"),))
    members = samples()
    members[0] = replace(members[0], results=(doubted,))
    group = built(members)
    assert group.numbers[0].values["s1-1"].status is Status.DOUBTFUL
    assert said(group)["doubtful_in_mean"] == (
        "doubtful values are in the means of: stiffness (s1-1)"
    )


def test_too_few_samples_for_outliers() -> None:
    group = built(samples()[2:4])
    assert said(group)["outliers_not_tested"] == (
        "too few samples for a test of outliers: stiffness; peak_force.1"
    )


def test_empty_group() -> None:
    group = built([], scaled=True)
    assert said(group) == {"empty_group": "there is no sample in this group"}
    assert str(group.band.reason).startswith("empty_group: ")
    assert group.band_scaled is not None
    assert str(group.band_scaled.reason).startswith("empty_group: ")
    assert group.numbers == ()


def test_one_sample() -> None:
    group = built(samples()[:1])
    assert said(group)["one_sample"] == "one sample (s1-1): no interval and no band"
    assert str(group.band.reason).startswith("one_curve: ")
    assert group.numbers[0].mean is not None
    assert group.numbers[0].mean.chosen.interval is None


def test_tests_of_one_name_are_both_kept() -> None:
    one, two = samples()[:2]
    group = built([replace(one, source="a/result.h5"), replace(two, test=one.test, source="b")])
    assert list(group.numbers[0].values) == ["s1-1 (a/result.h5)", "s1-1 (b)"]


def test_a_sample_tested_twice_is_said() -> None:
    one = samples()[0]
    group = built([one, replace(one, test="again")])
    assert said(group)["sample_repeated"] == (
        "sample 1 of spool s1 was tested 2 times; the means count it as 2 samples"
    )


def test_samples_of_other_size_are_said() -> None:
    one, two = samples()[:2]
    longer = replace(two, specimen=replace(two.specimen, dimensions={"length": 0.4}))
    assert said(built([one, longer]))["dimensions_differ"].startswith(
        "the samples differ in length: 300 mm to 400 mm"
    )


def test_bundles_and_labels_that_differ_are_said() -> None:
    members = [
        bundle_sample(bundle_of("7 B1"), 1, labels={"cured": "24 h"}),
        bundle_sample(bundle_of("12 B1"), 2, labels={"cured": "48 h"}),
        bundle_sample(bundle_of("12 B1"), 3, labels={"cured": "48 h"}),
    ]
    notes = {note.code: note for note in sample_notes(members)}
    first, second, third = (sample.test for sample in members)
    assert notes["bundles_differ"].message == (
        f"the samples differ in composition: 7 B1 ({first}) and 12 B1 ({second}, {third});"
        " a mean over them mixes what this changes with scatter"
    )
    assert notes["bundles_differ"].severity is Severity.WARNING
    assert notes["labels_differ"].message == (
        f"the samples differ in cured: 24 h ({first}) and 48 h ({second}, {third})"
    )
    alike = [note.code for note in sample_notes(members[1:])]
    assert not {"bundles_differ", "labels_differ"} & set(alike)


def test_a_bundle_among_other_specimens_is_said() -> None:
    members = [bundle_sample(bundle_of("7 B1"), 1), bundle_sample(None, 2)]
    told = [note.message for note in sample_notes(members) if note.code == "bundles_differ"]
    assert any("composition: 7 B1" in each and "not said (tube-2)" in each for each in told)


def test_how_groups_were_made_is_said() -> None:
    one, two = grouping_notes(["taping"], ["s1"])
    assert (one.code, one.severity, one.message) == (
        "field_not_said", Severity.WARNING, "the test sheets of these samples do not say taping"
    )  # fmt: skip
    assert two.message == (
        "several types have a spool of the name s1: spools belong to a type, so they count as"
        " several spools"
    )
    assert grouping_notes([], []) == []
