"""Questions that pairs of groups answer: pairs, families, tables, remarks."""

from __future__ import annotations

from dataclasses import replace

from labpipe.records.curve import Interval
from labpipe.records.group import Contrast, MeanInterval
from labpipe.records.quality import Reason
from labpipe.report.comparisons import (
    MAX_COMPARED_GROUPS,
    Pair,
    context_words,
    equal_words,
    families,
    field_words,
    multi_field_differences,
    question_table,
    question_words,
    remarks_on_pairs,
    single_field_pairs,
)
from tests.approved import Approve
from tests.builders.bundle_campaigns import (
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    grouped,
    three_of,
)
from tests.builders.campaigns import build_campaign, build_difference
from tests.report.figure_words import table_words


def test_families_hold_all_that_differ_in_one_field() -> None:
    cases = families(bundle_campaign(conduit_cases()))
    assert [(family.field, family.labels) for family in cases] == [
        ("wire", ("B1", "B1 & B2", "B2")),
        ("wire", ("B1", "B2")),
        ("number", ("12", "19")),
        ("taping", ("none", "coarse", "half-lap")),
        ("conduit", ("corrugated-tube", "twist-tube")),
        ("conduit", ("corrugated-tube", "twist-tube")),
    ]


def test_two_tapes_and_none_are_three_families() -> None:
    """No tape differs from either tape in the taping alone, they from each other in the tape."""
    samples = three_of(bundle_of("7 B1", tape="none", taping="none"))
    samples += [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B1", tape="PET"))]
    campaign = bundle_campaign(samples)
    assert [(family.field, family.labels) for family in families(campaign)] == [
        ("taping", ("none", "half-lap")),
        ("taping", ("none", "half-lap")),
        ("tape", ("PET", "PVC")),
    ]


def test_a_large_family_is_cut_and_keeps_its_first_group() -> None:
    counts = (3, 4, 5, 6, 7, 8, 9, 12)
    samples = [sample for count in counts for sample in three_of(bundle_of(f"{count} B1"))]
    first, second = families(bundle_campaign(samples))
    assert len(first.groups) == MAX_COMPARED_GROUPS
    assert first.labels == ("3", "4", "5", "6", "7", "8")
    assert second.labels == ("3", "9", "12")


def test_types_are_a_question_too_and_two_fields_at_once_are_not() -> None:
    tubes = three_of(None)
    hoses = [
        replace(tube, specimen=replace(tube.specimen, type="hose"), source=f"{tube.source}-hose")
        for tube in tubes
    ]
    (pair,) = single_field_pairs(bundle_campaign([*tubes, *hoses]))
    assert question_words(pair) == "Type: tube against hose, all else equal (length 114.3 mm)"
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("12 B2", tape="PET"))]
    campaign = bundle_campaign(samples)
    assert not single_field_pairs(campaign)
    assert not families(campaign)
    assert len(multi_field_differences(campaign)) == 2


def test_words_of_questions(approved: Approve) -> None:
    pairs = single_field_pairs(bundle_campaign(conduit_cases()))
    varied = [
        sample for count in ("7", "12") for wire in ("B1", "B2")
        for sample in three_of(bundle_of(f"{count} {wire}"))
    ]  # fmt: skip
    mixed = bundle_of("10 B1 + 9 B2", arrangement="symmetric")
    labelled = grouped([bundle_sample(mixed, 1, labels={"cured": "24 h"})])
    taping = bundle_campaign(conduit_cases(), alone="taping")
    assert {difference.question for difference in taping.differences} == {"taping"}
    approved([
        *(f"{pair.field}: {question_words(pair)}" for pair in pairs),
        equal_words(grouped(varied, "wire"), "wire"),
        context_words([*labelled], "tape"),
        context_words(grouped([bundle_sample(None, 1)]), "x"),
        field_words("conduit_bore"),
        *remarks_on_pairs(bundle_campaign(conduit_cases())),
        *remarks_on_pairs(taping),
        *remarks_on_pairs(bundle_campaign([*three_of(bundle_of("7 B1"))], alone="taping")),
    ])  # fmt: skip


def test_tables_of_questions(approved: Approve) -> None:
    """A share, a number that can be negative, no interval, no bounds, a mean of zero, a caveat."""
    contrast = Contrast(-1423.4, (60.0, 60.0), (6, 3))
    first, second, _ = build_campaign().groups
    known = build_difference()
    usual = Pair(first, second, (known,))
    in_newtons = replace(known, contrast=contrast, interval=Interval(-1650.0, -1200.0))
    lone = MeanInterval(-1423.4, None, 120.0, 7, Reason("one_sample", "there is one sample"))
    without = replace(known, contrast=None, interval=None, margin=None, difference=lone)
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (pair,) = single_field_pairs(bundle_campaign(samples))
    number, other = pair.differences
    odd = replace(number, caveats=(*number.caveats, "not made alike: this against that"))
    zero = [*three_of(bundle_of("7 B1"), scale=0.0), *three_of(bundle_of("7 B2"))]
    pairs = [
        usual,
        replace(usual, differences=(in_newtons,)),
        replace(usual, differences=(without,)),
        replace(usual, differences=(replace(known, interval=Interval(-0.99, 5e8)),)),
        pair,
        replace(pair, differences=(odd, other)),
        *single_field_pairs(bundle_campaign(zero)),
    ]
    approved(line for pair in pairs for line in table_words(question_table(pair)))
    share = question_table(pair).rows[0][1].text.partition(" ")[0]
    assert 50.0 < float(share) < 60.0  # 1.4 / 0.9
