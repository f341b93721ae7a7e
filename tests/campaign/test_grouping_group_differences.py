from __future__ import annotations

from dataclasses import replace

from labpipe.campaign.grouping import OTHERS, QUESTIONS, TYPES, find_differences
from labpipe.protocol.schema import Groups
from labpipe.records.group import Verdict
from tests.builders.bundle_campaigns import (
    MAIN,
    PROTOCOL,
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    grouped,
    three_of,
)

NONE = bundle_of("19 B2", conduit="corrugated-tube", tape="none", taping="none")
HALF_LAP = bundle_of("19 B2", conduit="corrugated-tube")


def test_questions_come_first_and_count_from_less_to_more() -> None:
    found = bundle_campaign(conduit_cases()).differences
    asked = [each.question for each in found]
    assert list(dict.fromkeys(asked)) == ["wire", "number", "taping", "conduit", ""]
    assert {each.family for each in found if not each.question} == {""}
    assert {each.verdict for each in found if not each.question} == {Verdict.NOT_ASKED}
    first = [each for each in found if each.family == QUESTIONS]
    assert {each.name for each in first} == {MAIN[0]}
    assert {each.name for each in found if each.family == OTHERS} == {MAIN[1]}
    assert {each.tests for each in first} == {len(first)}
    assert asked == sorted(asked, key=list(dict.fromkeys(asked)).index)
    taping = [each.fields["taping"] for each in found if each.question == "taping"]
    assert set(taping) == {("none", "coarse"), ("none", "half-lap"), ("coarse", "half-lap")}
    (number,) = {each.fields["number"] for each in found if each.question == "number"}
    assert number == ("12", "19")
    assert all(each.difference.mean > 0 for each in found if each.question == "number")


def test_half_lap_against_none_that_are_equal_within_two_percent() -> None:
    """Truly 1.5 % apart, scatter 1 %, margin 10 %: equivalent, and said with numbers."""
    for seed in range(20):
        samples = [
            *three_of(NONE, seed=seed),
            *(bundle_sample(HALF_LAP, at, scale=1.015, seed=seed) for at in (1, 2, 3)),
        ]
        (stiffness, _) = bundle_campaign(samples).differences
        assert stiffness.fields == {"taping": ("none", "half-lap")}
        assert stiffness.verdict is Verdict.EQUIVALENT
        assert "within 10 %: p = " in stiffness.why
        assert stiffness.p_equivalent < 0.05


def test_twenty_percent_apart_is_different() -> None:
    samples = [*three_of(NONE), *three_of(HALF_LAP, scale=1.2)]
    (stiffness, _) = bundle_campaign(samples).differences
    assert stiffness.verdict is Verdict.DIFFERENT
    assert stiffness.difference.interval is not None
    truth = 0.2 * 19 * 1.4e-3
    assert stiffness.difference.interval.lower < truth < stiffness.difference.interval.upper


def test_only_one_question() -> None:
    groups = grouped(conduit_cases())
    wishes = {PROTOCOL: Groups(main=MAIN)}
    settings: dict[str, dict[str, str]] = {
        sample.source: {} for group in groups for sample in group.samples
    }
    found = find_differences(groups, wishes, settings, by=("type",), alone="taping")
    assert {each.question for each in found.shown} == {"taping"}
    assert (len(found.shown), found.pairs_not_shown) == (6, 25)


def test_tests_that_were_processed_otherwise_are_told() -> None:
    samples = [*three_of(NONE), *three_of(HALF_LAP)]
    groups = grouped(samples)
    wishes = {PROTOCOL: Groups(main=MAIN)}
    settings = {each.source: {"results.kink.to": "5 mm"} for each in samples}
    settings[samples[0].source] = {"results.kink.to": "4 mm"}
    found = find_differences(groups, wishes, settings, by=("type",))
    assert found.shown[0].words.endswith(
        "; the tests were processed otherwise: results.kink.to differ"
    )


def test_types_are_a_family_of_their_own() -> None:
    tubes = [bundle_sample(None, at) for at in (1, 2, 3)]
    hoses = [
        replace(each, specimen=replace(each.specimen, type="hose"), source=f"{each.source}-hose")
        for each in (bundle_sample(None, at, scale=2.0) for at in (4, 5, 6))
    ]
    first, other = bundle_campaign([*tubes, *hoses]).differences
    assert (first.family, other.family) == (TYPES, OTHERS)
    assert first.question == "type"
    assert first.verdict is Verdict.DIFFERENT
