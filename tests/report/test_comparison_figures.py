"""Figures that compare groups that differ in one field, and causes of an interval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from labpipe.records.group import Group
from labpipe.records.result import Contribution, Result
from labpipe.report.budget_figures import (
    budgets_to_draw,
    draw_budget,
    draw_group_budgets,
)
from labpipe.report.comparison_figures import (
    caption,
    draw_family,
    figures_of_families,
    main_number,
    plot_means,
)
from labpipe.report.comparisons import Family, families
from labpipe.report.figure_page import style
from labpipe.report.page_comparisons import questions
from labpipe.statistics.groups import build_group
from tests.approved import Approve
from tests.builders.bundle_campaigns import (
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    three_of,
)
from tests.builders.campaigns import build_campaign, six_samples
from tests.report.figure_words import all_words
from tests.store.builders_result import build_result

TAPING = families(bundle_campaign(conduit_cases(), alone="taping"))[0]


def test_the_main_number_with_its_samples() -> None:
    assert main_number(TAPING) == "bending_stiffness"
    with style():
        axes = Figure().subplots()
        plot_means(TAPING, "bending_stiffness", axes)
        means = [float(np.asarray(line.get_xdata())[0]) for line in axes.lines[2::3]]
        for mean, group in zip(means, TAPING.groups, strict=True):
            assert group.numbers[0].mean is not None
            assert mean == pytest.approx(1e6 * group.numbers[0].mean.chosen.mean)
    first = TAPING.groups[0]
    lacking = replace(first, numbers=first.numbers[1:])
    assert main_number(Family("taping", (lacking, *TAPING.groups[1:]))) == "peak_force.1"


def pieces(axes: Axes) -> list[tuple[float, float, bool]]:
    """Where each piece begins, how long it is, and whether it is hatched."""
    return [
        (round(child.get_x(), 6), round(child.get_width(), 6), bool(child.get_hatch()))
        for child in axes.get_children()
        if isinstance(child, Rectangle) and child is not axes.patch
    ]


def group_with_budgets(count: int = 6) -> Group:
    def with_budget(result: Result) -> Result:
        size = 0.003 * (result.value or 0.0)
        shared = Contribution("scale of the force", size, is_common=True)
        return replace(result, budget=(Contribution("noise", size), shared))

    samples = [
        replace(sample, results=tuple(map(with_budget, sample.results)))
        for sample in six_samples()[:count]
    ]
    return build_group("tube", "twist-tube", samples)


def test_a_group_shows_its_tests_and_its_means() -> None:
    own = group_with_budgets()
    count = len(budgets_to_draw(own))
    assert count >= 3
    with style():
        left, right = draw_group_budgets(own).axes
    assert pieces(left) == [(0.0, 50.0, False), (50.0, 50.0, True)] * count
    assert len(pieces(right)) == 2 * count
    assert sum(width for _, width, _ in pieces(right)) == pytest.approx(100.0 * count)
    assert budgets_to_draw(build_group("tube", "twist-tube", six_samples())) == []


def test_groups_that_differ_in_one_field_are_drawn_together() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    campaign = bundle_campaign(samples)
    stems = {group.name: f"g{at}" for at, group in enumerate(campaign.groups)}
    (question,) = questions(campaign, stems)
    assert (question.field, question.name) == ("wire", "Wire")
    assert [row[0].text for row in question.answers.rows] == ["Wire: B2 against B1"]
    (comparison,) = question.comparisons
    means, numbers = comparison.plots
    assert {line.group for line in means.lines} == {"g0", "g1"}
    assert [key.label for key in means.keys] == ["B1 (n = 3)", "B2 (n = 3)"]
    dots = [line for line in numbers.lines if line.look.startswith("dot")]
    group = campaign.groups[0]
    mean = next(number.mean for number in group.numbers if number.name == "bending_stiffness")
    assert mean is not None
    np.testing.assert_allclose(dots[0].x, 1e6 * mean.chosen.mean)
    assert [float(line.y[0]) for line in dots] == [0.0, -1.0]
    assert numbers.y.is_bare


def test_figures_of_families(approved: Approve) -> None:
    drawn = list(figures_of_families(bundle_campaign(conduit_cases())))
    assert list(figures_of_families(build_campaign())) == []
    samples = [bundle_sample(bundle_of("7 B1"), 1), *three_of(bundle_of("7 B2"))]
    blank = [replace(sample, loading=()) for sample in three_of(bundle_of("7 B3"))]
    (family,) = families(bundle_campaign([*samples, *blank]))
    nothing = tuple(replace(group, band=family.groups[2].band) for group in family.groups)
    bare = tuple(replace(group, band_scaled=None, numbers=()) for group in TAPING.groups)
    with style():
        pages = {
            "taping": draw_family(TAPING),
            "curves alone": draw_family(Family("taping", bare)),
            "a curve is missing": draw_family(family),
            "no curve": draw_family(Family("wire", nothing)),
        }
    approved([
        *(f"{field}: {figure.name}: {figure.alt}" for field, figure in drawn),
        caption(family), caption(Family("taping", bare)), *all_words(pages),
    ])  # fmt: skip


def test_a_bar_for_each_number_of_the_first_cycle(approved: Approve) -> None:
    """0.003 and 0.004: 36 and 64 %; the interval of 0.02 N is written as half of it."""
    result = build_result(half_cycle=1.0)
    later = replace(result.results[0], name="peak_force.2")
    clock = replace(result.results[0], name="clock_offset", unit="s")
    bare = replace(result, results=tuple(replace(result, budget=()) for result in result.results))
    with style():
        page = draw_budget(replace(result, results=(*result.results, later, clock)))
        pages = {
            "one test": page,
            "no budget": draw_budget(bare),
            "group": draw_group_budgets(group_with_budgets()),
            "group of one test": draw_group_budgets(group_with_budgets(1)),
        }
    assert pieces(page.axes[0]) == [(0.0, 36.0, False), (36.0, 64.0, True)]
    approved(all_words(pages))
