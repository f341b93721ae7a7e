from __future__ import annotations

from dataclasses import replace

from labpipe.records.curve import Interval
from labpipe.records.group import Contrast, Difference, MeanInterval
from labpipe.records.quality import Reason
from labpipe.report.questions import (
    Pair,
    answering_pairs,
    question_table,
    remarks_on_pairs,
)
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_difference


def test_a_difference_of_a_number_that_can_be_negative_is_in_its_unit() -> None:
    contrast = Contrast(-1423.4, (60.0, 60.0), (6, 3))
    signed = replace(build_difference(), contrast=contrast, interval=Interval(-1650.0, -1200.0))
    (row,) = question_table(pair_of(signed)).rows
    assert [cell.text for cell in row[:3]] == [
        "Stiffness, first region (N/mm)", "-1.42 N/mm (-1.65 N/mm to -1.20 N/mm)", "0.500",
    ]  # fmt: skip


def test_a_share_with_its_interval() -> None:
    (row,) = question_table(pair_of(build_difference())).rows
    assert [cell.text for cell in row] == [
        "Stiffness, first region (N/mm)", "-28.0 % (-31.0 % to -25.0 %)", "0.500", "different",
    ]  # fmt: skip


def test_no_interval_and_no_margin_are_dashes() -> None:
    found = MeanInterval(-1423.4, None, 120.0, 7, Reason("one_sample", "there is one sample"))
    none = replace(build_difference(), contrast=None, interval=None, margin=None, difference=found)
    (row,) = question_table(pair_of(none)).rows
    assert row[1].text.endswith(" There is one sample.")
    assert row[2].text == "\u2013"


def test_beyond_all_bounds_there_are_no_digits() -> None:
    wide = replace(build_difference(), interval=Interval(-0.99, 5e8))
    (row,) = question_table(pair_of(wide)).rows
    assert row[1].text.endswith(" to more than +1000 %)")


def pair_of(difference: Difference) -> Pair:
    first, second, _ = build_campaign().groups
    return Pair(first, second, (difference,))


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
    assert 50.0 < float(table.rows[0][1].text.partition(" ")[0]) < 60.0  # 1.4 / 0.9
    assert all(row[3].text == "different" for row in table.rows)
    (note,) = table.notes
    assert note.startswith("7B1-packed-PVC-half-lap-none and 7B2-packed-PVC")
    assert note.endswith(": one spool, so how spools differ is not in it.")


def test_a_mean_of_zero_has_no_share() -> None:
    samples = [*three_of(bundle_of("7 B1"), scale=0.0), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    assert " N\u00b7mm\u00b2" in question_table(pair).rows[0][1].text


def test_many_are_counted_and_found_elsewhere() -> None:
    campaign = bundle_campaign(conduit_cases())
    assert remarks_on_pairs(campaign) == [
        "18 pairs are not judged, as the groups differ in several fields at once, which answers no"
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


def test_what_speaks_against_comparing_stands_once_below() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    first, second = pair.differences
    odd = replace(first, caveats=(*first.caveats, "not made alike: this against that"))
    table = question_table(replace(pair, differences=(odd, second)))
    assert len(table.notes) == 2
    assert table.notes[1] == "not made alike: this against that."
