"""Figures that compare groups that differ in one field, and causes of an interval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.records.curve import Interval
from labpipe.records.group import Contrast, MeanInterval
from labpipe.records.quality import Reason
from labpipe.report.comparisons import (
    MAX_COMPARED_GROUPS,
    Pair,
    list_family_figures,
    list_field_comparisons,
    list_pair_remarks,
    list_single_field_pairs,
    make_pair_table,
)
from labpipe.report.figures import make_budget_page
from labpipe.report.plot_records import Page
from tests.approved import Approve
from tests.builders.bundle_campaigns import (
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    three_of,
)
from tests.builders.campaigns import build_campaign, build_difference
from tests.report.figure_words import all_words, cell_text, table_words
from tests.store.builders_result import build_result

TAPING = list_field_comparisons(bundle_campaign(conduit_cases(), alone="taping"))[0].families[0]


def pieces(page: Page) -> list[tuple[float, float, bool]]:
    """Where each piece of a bar begins and ends, and whether it is hatched."""
    return [
        (round(np.nanmin(line.x), 6), round(np.nanmax(line.x), 6), line.look == "common_cause")
        for line in page.plots[0].lines
        if np.isfinite(line.x).any()
    ]


def test_figures_of_families(approved: Approve) -> None:
    drawn = list(list_family_figures(bundle_campaign(conduit_cases())))
    assert list(list_family_figures(build_campaign())) == []
    samples = [bundle_sample(bundle_of("7 B1"), 1), *three_of(bundle_of("7 B2"))]
    blank = [replace(sample, loading=()) for sample in three_of(bundle_of("7 B3"))]
    (lacking,) = list_family_figures(bundle_campaign([*samples, *blank]))
    pages = {"taping": drawn[3], "a curve is missing": lacking}
    captions = [f"{figure.name}: {figure.caption} {figure.alt}" for figure in (*drawn, lacking)]
    approved([*captions, *all_words(pages)])


def test_a_bar_for_each_number_of_the_first_cycle(approved: Approve) -> None:
    """0.003 and 0.004: 36 and 64 %; the interval of 0.02 N is written as half of it."""
    result = build_result(half_cycle=1.0)
    later = replace(result.results[0], name="peak_force.2")
    clock = replace(result.results[0], name="clock_offset", unit="s")
    bare = replace(result, results=tuple(replace(result, budget=()) for result in result.results))
    page = make_budget_page(replace(result, results=(*result.results, later, clock)))
    pages = {"one test": page, "no budget": make_budget_page(bare)}
    assert pieces(page) == [(0.0, 0.36, False), (0.36, 1.0, True)]
    approved(all_words(pages))


def test_the_largest_difference_is_relative_on_a_linear_scale_too() -> None:
    question = list_field_comparisons(bundle_campaign(conduit_cases()))[0]
    relative, linear = question.pairs[0], question.pairs[1]
    number = linear.first.find_number("bending_stiffness")
    assert number is not None
    doubled = replace(linear.differences[0].difference, mean=number.mean.chosen.mean)
    shown = replace(linear.differences[0], contrast=None, difference=doubled, interval=None)
    linear = replace(linear, differences=(replace(shown, verdict=relative.differences[0].verdict),))
    difference = question._replace(pairs=(relative, linear)).summary[2]
    assert difference.endswith("N·mm², largest of 2 pairs")


def test_families_hold_all_that_differ_in_one_field() -> None:
    cases = list_field_comparisons(bundle_campaign(conduit_cases()))
    families = [family for question in cases for family in question.families]
    assert [(family.field, family.labels) for family in families] == [
        ("wire", ("B1", "B1 & B2", "B2")),
        ("wire", ("B1", "B2")),
        ("number", ("12", "19")),
        ("taping", ("none", "coarse", "half-lap")),
        ("conduit", ("corrugated-tube", "twist-tube")),
        ("conduit", ("corrugated-tube", "twist-tube")),
    ]


def test_a_large_family_is_cut_and_keeps_its_first_group() -> None:
    counts = (3, 4, 5, 6, 7, 8, 9, 12)
    samples = [sample for count in counts for sample in three_of(bundle_of(f"{count} B1"))]
    first, second = list_field_comparisons(bundle_campaign(samples))[0].families
    assert len(first.groups) == MAX_COMPARED_GROUPS
    assert first.labels == ("3", "4", "5", "6", "7", "8")
    assert second.labels == ("3", "9", "12")


def test_types_are_a_question_too_and_two_fields_at_once_are_not() -> None:
    tubes = three_of(None)
    hoses = [
        replace(tube, specimen=replace(tube.specimen, type="hose"), source=f"{tube.source}-hose")
        for tube in tubes
    ]
    (pair,) = list_single_field_pairs(bundle_campaign([*tubes, *hoses]))
    assert (
        make_pair_table(pair).title == "Type: tube against hose, all else equal (length 114.3 mm)"
    )
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("12 B2", tape="PET"))]
    campaign = bundle_campaign(samples)
    assert not list_field_comparisons(campaign)
    assert list_pair_remarks(campaign)[0].startswith("1 pair is not judged")


def test_tables_of_questions(approved: Approve) -> None:
    """A share, a number that can be negative, no interval, no bounds, a mean of zero, a caveat."""
    contrast = Contrast(-1423.4, (60.0, 60.0), (6, 3))
    first, second, _ = build_campaign().groups
    difference = build_difference()
    usual = Pair(first, second, (difference,))
    in_newtons = replace(difference, contrast=contrast, interval=Interval(-1650.0, -1200.0))
    lone = MeanInterval(-1423.4, None, 120.0, 7, Reason("one_sample", "there is one sample"))
    without = replace(difference, contrast=None, interval=None, margin=None, difference=lone)
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (pair,) = list_single_field_pairs(bundle_campaign(samples))
    main, second_number = pair.differences
    odd = replace(main, caveats=(*main.caveats, "different methods: this against that"))
    zero = [*three_of(bundle_of("7 B1"), scale=0.0), *three_of(bundle_of("7 B2"))]
    pairs = [
        usual,
        replace(usual, differences=(in_newtons,)),
        replace(usual, differences=(without,)),
        replace(usual, differences=(replace(difference, interval=Interval(-0.99, 5e8)),)),
        pair,
        replace(pair, differences=(odd, second_number)),
        *list_single_field_pairs(bundle_campaign(zero)),
    ]
    approved(line for pair in pairs for line in table_words(make_pair_table(pair)))
    share = cell_text(make_pair_table(pair).rows[0][1]).partition(" ")[0]
    assert 50.0 < float(share) < 60.0  # 1.4 / 0.9
