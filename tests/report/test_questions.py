from __future__ import annotations

from dataclasses import replace

from labpipe.report.questions import (
    MOST_TOGETHER,
    answering_pairs,
    context_words,
    equal_words,
    families,
    field_words,
    not_asked,
    question_words,
)
from tests.builders.bundle_campaigns import (
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    grouped,
    three_of,
)
from tests.builders.campaigns import build_campaign


def test_the_questions_of_a_conduit_campaign() -> None:
    pairs = answering_pairs(bundle_campaign(conduit_cases()))
    said = [question_words(pair) for pair in pairs]
    assert [pair.field for pair in pairs] == [
        *["wire"] * 4, "number", *["taping"] * 3, *["conduit"] * 2
    ]  # fmt: skip
    assert said[4] == (
        "Number: 19 against 12, all else equal (B2, no tape, corrugated-tube, length 114.3 mm)"
    )
    assert (
        "Taping: half-lap against none, all else equal (19 B2, corrugated-tube, length 114.3 mm)"
    ) in said
    assert said[-1] == (
        "Conduit: twist-tube against corrugated-tube, all else equal"
        " (19 B2, no tape, length 114.3 mm)"
    )


def test_families_hold_all_that_differ_in_one_field() -> None:
    found = families(bundle_campaign(conduit_cases()))
    assert [(each.field, each.words) for each in found] == [
        ("wire", ("B1", "B1 & B2", "B2")),
        ("wire", ("B1", "B2")),
        ("number", ("12", "19")),
        ("taping", ("none", "coarse", "half-lap")),
        ("conduit", ("corrugated-tube", "twist-tube")),
        ("conduit", ("corrugated-tube", "twist-tube")),
    ]


def test_two_tapes_and_none_are_three_families() -> None:
    """No tape differs from either tape in the taping alone, they from each other in the tape."""
    bundles = [
        bundle_of("7 B1", tape="none", taping="none"),
        bundle_of("7 B1"),
        bundle_of("7 B1", tape="PET"),
    ]
    campaign = bundle_campaign([each for bundle in bundles for each in three_of(bundle)])
    assert [(each.field, each.words) for each in families(campaign)] == [
        ("taping", ("none", "half-lap")),
        ("taping", ("none", "half-lap")),
        ("tape", ("PET", "PVC")),
    ]


def test_a_large_family_is_cut_and_keeps_its_first_group() -> None:
    counts = (3, 4, 5, 6, 7, 8, 9, 12)
    samples = [each for count in counts for each in three_of(bundle_of(f"{count} B1"))]
    first, second = families(bundle_campaign(samples))
    assert len(first.groups) == MOST_TOGETHER
    assert first.words == ("3", "4", "5", "6", "7", "8")
    assert second.words == ("3", "9", "12")


def test_what_varies_within_groups_is_said() -> None:
    samples = [
        *three_of(bundle_of("7 B1")), *three_of(bundle_of("12 B1")),
        *three_of(bundle_of("7 B2")), *three_of(bundle_of("12 B2")),
    ]  # fmt: skip
    groups = grouped(samples, "wire")
    assert equal_words(groups, "wire") == (
        "all else equal (half-lap PVC, length 114.3 mm) but for composition, which varies within"
        " the groups"
    )


def test_labels_and_mixes_in_words() -> None:
    mixed = bundle_of("10 B1 + 9 B2", arrangement="symmetric")
    groups = [*grouped([bundle_sample(mixed, 1, labels={"cured": "24 h"})])]
    assert context_words(groups, "tape") == (
        "10 B1 + 9 B2, symmetric, half-lap, cured 24 h, length 114.3 mm"
    )
    wires = bundle_of("19 B1")
    one, other = (
        [*grouped([bundle_sample(wires, 1)]), *grouped([bundle_sample(how, 1)])]
        for how in (mixed, bundle_of("10 B1 + 9 B2", arrangement="asymmetric"))
    )
    assert context_words(one, "wire") != context_words(other, "wire")
    assert context_words(grouped([bundle_sample(None, 1)]), "x") == "tube, length 114.3 mm"
    assert field_words("conduit_bore") == "Conduit bore"


def test_types_are_a_question_too() -> None:
    tubes = [bundle_sample(None, at) for at in (1, 2, 3)]
    hoses = [
        replace(each, specimen=replace(each.specimen, type="hose"), source=f"{each.source}-hose")
        for each in tubes
    ]
    (pair,) = answering_pairs(bundle_campaign([*tubes, *hoses]))
    assert question_words(pair) == "Type: tube against hose, all else equal (length 114.3 mm)"
    assert len(not_asked(build_campaign())) == 1


def test_what_differs_in_several_fields_is_not_asked() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("12 B2", tape="PET"))]
    campaign = bundle_campaign(samples)
    assert not answering_pairs(campaign)
    assert not families(campaign)
    assert len(not_asked(campaign)) == 2
