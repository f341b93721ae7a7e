from __future__ import annotations

from dataclasses import replace

from labpipe.records.group import Campaign
from labpipe.report.questions import (
    answering_pairs,
    difference_table,
    question_table,
    remarks_on_pairs,
)
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_difference


def test_differences() -> None:
    table = difference_table(build_campaign())
    assert table is not None
    assert [cell.text for cell in table.rows[0]] == [
        "Stiffness, first region (N/mm)", "-1.42", "-1.60 to -1.24", "0.500",
        "They differ by more than the margin of 10 %.",
    ]  # fmt: skip
    unknown = replace(build_difference(), margin=None)
    unknown = replace(unknown, difference=replace(unknown.difference, interval=None))
    table = difference_table(Campaign("Synthetic", (), (unknown,)))
    assert table is not None
    assert [cell.text for cell in table.rows[0][2:4]] == ["\u2013", "\u2013"]
    assert difference_table(Campaign("Synthetic", ())) is None


def test_a_question_with_its_numbers() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    table = question_table(pair)
    assert table.caption == (
        "Wire: B2 against B1, all else equal (7 wires, half-lap PVC, length 114.3 mm)"
    )
    assert [row[0].text for row in table.rows] == [
        "Bending stiffness (N\u00b7mm\u00b2)", "Peak force, cycle 1 (N)",
    ]  # fmt: skip
    assert 50.0 < float(table.rows[0][0].small.removesuffix(" %")) < 60.0  # 1.4 / 0.9
    assert [row[4].text for row in table.rows] == [
        "different: the 95 % interval of the difference leaves zero out"
    ] * 2
    (note,) = table.notes
    assert note.startswith("Every number: 7B1-packed-PVC-half-lap-none and 7B2-packed-PVC")
    assert note.endswith(": one spool, so how spools differ is not in it.")
    assert difference_table(bundle_campaign(samples)) is None


def test_a_mean_of_zero_has_no_share() -> None:
    samples = [*three_of(bundle_of("7 B1"), scale=0.0), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    assert question_table(pair).rows[0][0].small == ""


def test_few_pairs_in_several_fields_are_shown() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("12 B2", tape="PET"))]
    table = difference_table(bundle_campaign(samples))
    assert table is not None
    assert table.caption == "Groups that differ in several fields at once"
    assert table.rows[0][0].small.endswith(
        ": wire: B2 against B1; number: 12 against 7; tape: PET against PVC"
    ) or table.rows[0][0].small.endswith(
        ": wire: B1 against B2; number: 7 against 12; tape: PVC against PET"
    )


def test_many_are_counted_and_found_elsewhere() -> None:
    campaign = bundle_campaign(conduit_cases())
    assert difference_table(campaign) is None
    assert remarks_on_pairs(campaign) == [
        "18 pairs are not shown, as the groups differ in several fields at once, which answers no"
        " question: see the sheet 'comparisons' of tables.xlsx."
    ]


def test_what_compare_leaves_out_is_told() -> None:
    shown = bundle_campaign(conduit_cases(), alone="taping")
    assert {each.question for each in shown.differences} == {"taping"}
    assert remarks_on_pairs(shown) == [
        "Only pairs of groups that differ in taping alone are shown (--compare taping);"
        " 25 pairs are left out."
    ]
    none = bundle_campaign([*three_of(bundle_of("7 B1"))], alone="taping")
    assert remarks_on_pairs(none) == [
        "No two groups differ in taping alone.",
        "Only pairs of groups that differ in taping alone are shown (--compare taping);"
        " 0 pairs are left out.",
    ]


def test_what_is_said_of_one_number_stays_with_it() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    first, second = pair.differences
    odd = replace(first, caveats=(*first.caveats, "not made alike: this against that"))
    table = question_table(replace(pair, differences=(odd, second)))
    assert table.rows[0][4].text.endswith("leaves zero out; not made alike: this against that")
    assert "not made alike" not in table.notes[0]
