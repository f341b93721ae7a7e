from __future__ import annotations

from dataclasses import replace

from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Contrast, Difference, MeanInterval
from labpipe.records.quality import Reason
from labpipe.report.questions import (
    Pair,
    answer_table,
    answering_pairs,
    question_table,
    remarks_on_pairs,
)
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_difference


def test_answers_at_the_top_of_a_page() -> None:
    table = answer_table(bundle_campaign(conduit_cases()))
    assert table is not None
    assert table.heads == ("Question", "Answer", "Difference, 95 % interval", "n")
    asked = {row[0].text for row in table.rows}
    assert {"Taping: half-lap against none", "Number: 19 against 12"} <= asked
    number = next(row for row in table.rows if row[0].text == "Number: 19 against 12")
    assert number[0].small == "B2, no tape, corrugated-tube, length 114.3 mm"
    assert number[1].text == "DIFFERENT"
    assert number[1].small.endswith(", corrected for 10 comparisons")
    assert number[2].text.startswith("Bending stiffness +")
    low, high = (float(end.removesuffix(" %")) for end in number[2].small.split(" to "))
    assert low < 100.0 * (19 / 12 - 1.0) < high
    assert number[3].text == "3 v 3"
    assert answer_table(Campaign("Synthetic", ())) is None


def test_many_types_are_counted_in_the_answers() -> None:
    base = three_of(bundle_of("7 B1"))
    kinds = [
        replace(
            each,
            test=f"{kind}-{each.test}",
            specimen=replace(each.specimen, type=kind, bundle=None),
            source=f"{kind}-{each.source}",
        )
        for kind in "ABCDEF"
        for each in base
    ]
    table = answer_table(bundle_campaign(kinds))
    assert table is not None
    assert not table.rows
    assert table.notes[0] == "15 pairs of types stand in 'Differences' alone."
    few = answer_table(bundle_campaign(kinds[:9]))
    assert few is not None
    assert [row[0].text for row in few.rows] == [
        "Type: B against A", "Type: C against A", "Type: C against B"
    ]  # fmt: skip


def test_a_difference_of_a_number_that_can_be_negative_is_in_its_unit() -> None:
    contrast = Contrast(-1423.4, (60.0, 60.0), (6, 3))
    signed = replace(build_difference(), contrast=contrast, interval=Interval(-1650.0, -1200.0))
    (row,) = question_table(pair_of(signed)).rows
    assert [cell.text for cell in row[:4]] == [
        "Stiffness, first region (N/mm)", "-1.42 N/mm", "-1.65 N/mm to -1.20 N/mm", "0.500",
    ]  # fmt: skip
    assert row[1].small == ""


def test_a_share_with_its_difference_below() -> None:
    (row,) = question_table(pair_of(build_difference())).rows
    assert [cell.text for cell in row] == [
        "Stiffness, first region (N/mm)", "-28.0 %", "-31.0 % to -25.0 %", "0.500",
        "different: p = 0.001",
    ]  # fmt: skip
    assert row[1].small == "-1.423"


def test_no_interval_and_no_margin_are_dashes() -> None:
    found = MeanInterval(-1423.4, None, 120.0, 7, Reason("one_sample", "there is one sample"))
    none = replace(build_difference(), contrast=None, interval=None, margin=None, difference=found)
    (row,) = question_table(pair_of(none)).rows
    assert [cell.text for cell in row[2:4]] == ["There is one sample.", "\u2013"]


def test_beyond_all_bounds_there_are_no_digits() -> None:
    wide = replace(build_difference(), interval=Interval(-0.99, 5e8))
    (row,) = question_table(pair_of(wide)).rows
    assert row[2].text.endswith(" to more than +1000 %")


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
    assert 50.0 < float(table.rows[0][1].text.removesuffix(" %")) < 60.0  # 1.4 / 0.9
    assert all(row[4].text.startswith("different: p = 0.0001 or less") for row in table.rows)
    (note,) = table.notes
    assert note.startswith("Every number: 7B1-packed-PVC-half-lap-none and 7B2-packed-PVC")
    assert note.endswith(": one spool, so how spools differ is not in it.")


def test_a_mean_of_zero_has_no_share() -> None:
    samples = [*three_of(bundle_of("7 B1"), scale=0.0), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    assert question_table(pair).rows[0][1].text.endswith(" N\u00b7mm\u00b2")


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


def test_what_is_said_of_one_number_stays_with_it() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (pair,) = answering_pairs(bundle_campaign(samples))
    first, second = pair.differences
    odd = replace(first, caveats=(*first.caveats, "not made alike: this against that"))
    table = question_table(replace(pair, differences=(odd, second)))
    assert table.rows[0][4].text.endswith("; not made alike: this against that")
    assert "not made alike" not in table.notes[0]
