from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from labpipe.report.figure_page import style
from labpipe.report.question_figures import (
    caption,
    draw_family,
    figures_of_families,
    main_number,
    plot_bands,
    plot_means,
)
from labpipe.report.questions import Family, families
from tests.builders.bundle_campaigns import (
    bundle_campaign,
    bundle_of,
    bundle_sample,
    conduit_cases,
    three_of,
)
from tests.builders.campaigns import build_campaign

TAPING = families(bundle_campaign(conduit_cases(), alone="taping"))[0]


def test_one_figure_per_family() -> None:
    found = list(figures_of_families(bundle_campaign(conduit_cases())))
    assert [name for name, _ in found] == [
        "wire", "wire", "number", "taping", "conduit", "conduit"
    ]  # fmt: skip
    names = [figure.name for _, figure in found]
    assert names[3] == "difference-taping-19-b2-corrugated-tube-length-114-3-mm"
    assert len(set(names)) == len(names)
    assert found[3][1].alt == (
        "Mean force against displacement of 3 groups that differ in taping: none, coarse, half-lap."
    )
    assert list(figures_of_families(build_campaign())) == []


def test_the_curves_are_the_means_with_their_bands() -> None:
    with style():
        axes = Figure().subplots()
        plot_bands(TAPING, axes)
        assert not axes.collections
        means = mean_lines(axes)
        assert len(means) == 3
        for line, group in zip(means, TAPING.groups, strict=True):
            x, y = (np.asarray(each, float) for each in (line.get_xdata(), line.get_ydata()))
            np.testing.assert_allclose(
                y, np.interp(x, 1e3 * group.band.displacement, group.band.mean)
            )
        assert len({line.get_color() for line in means}) == 3
        assert [line.is_dashed() for line in means] == [False, True, True]
        assert len(axes.lines) == 3 + 3 * 3
        assert axes.get_ylabel() == "Force (N)"


def mean_lines(axes: Axes) -> list[Line2D]:
    """Intervals at one displacement have two points."""
    return [line for line in axes.lines if len(np.asarray(line.get_xdata())) > 2]


def test_means_of_six_curves_have_a_band_and_of_three_intervals_side_by_side() -> None:
    six = [bundle_sample(bundle_of("7 B1"), at) for at in range(6)]
    (family,) = families(bundle_campaign([*six, *three_of(bundle_of("7 B2"))]))
    with style():
        axes = Figure().subplots()
        plot_bands(family, axes)
    assert len(axes.collections) == 1
    marks = [line for line in axes.lines if len(np.asarray(line.get_xdata())) == 2]
    assert len(marks) == 3
    assert "pale: holds" in caption(family)
    assert "vertical: 95 % intervals" in caption(family)


def test_force_over_peak_force() -> None:
    with style():
        axes = Figure().subplots()
        plot_bands(TAPING, axes, is_scaled=True)
        tops = [float(np.asarray(line.get_ydata()).max()) for line in mean_lines(axes)]
        assert tops == pytest.approx([1.0] * 3)
        assert axes.get_ylabel() == "Force / peak force"


def test_a_wide_band_does_not_press_the_means_together() -> None:
    wide = replace(TAPING.groups[0].band, upper=TAPING.groups[0].band.upper + 100.0)
    family = Family("taping", (replace(TAPING.groups[0], band=wide), *TAPING.groups[1:]))
    with style():
        axes = Figure().subplots()
        plot_bands(family, axes)
        assert axes.get_ylim()[1] < 2.0


def test_the_main_number_with_its_samples() -> None:
    assert main_number(TAPING) == "bending_stiffness"
    with style():
        axes = Figure().subplots()
        plot_means(TAPING, "bending_stiffness", axes)
        assert [label.get_text() for label in axes.get_yticklabels()] == list(TAPING.words)
        means = [float(np.asarray(line.get_xdata())[0]) for line in axes.lines[2::3]]
        for mean, group in zip(means, TAPING.groups, strict=True):
            assert group.numbers[0].mean is not None
            assert mean == pytest.approx(1e6 * group.numbers[0].mean.chosen.mean)
        assert axes.get_xlabel() == "Bending stiffness (N\u00b7mm\u00b2)"


def test_another_number_where_one_group_has_no_bending_stiffness() -> None:
    first = TAPING.groups[0]
    lacking = replace(first, numbers=first.numbers[1:])
    assert main_number(Family("taping", (lacking, *TAPING.groups[1:]))) == "peak_force.1"
    none = replace(first, numbers=())
    assert main_number(Family("taping", (none, *TAPING.groups[1:]))) == ""


def test_panels_that_there_are() -> None:
    bare = tuple(replace(group, band_scaled=None, numbers=()) for group in TAPING.groups)
    with style():
        assert len(draw_family(TAPING).axes) == 3
        assert len(draw_family(Family("taping", bare)).axes) == 1
    assert "(b)" not in caption(Family("taping", bare))


def test_the_caption_says_what_is_not_there() -> None:
    samples = [bundle_sample(bundle_of("7 B1"), 1), *three_of(bundle_of("7 B2"))]
    blank = [replace(each, loading=()) for each in three_of(bundle_of("7 B3"))]
    (family,) = families(bundle_campaign([*samples, *blank]))
    words = caption(family)
    assert words.startswith(
        "Wire: B1, B2, B3; all else equal (7 wires, half-lap PVC, length 114.3 mm). (a) "
    )
    assert "One sample, no band: B1. No mean curve: B3." in words
    with style():
        axes = draw_family(family).axes[0]
        assert (len(mean_lines(axes)), len(axes.collections)) == (2, 0)
        nothing = tuple(replace(group, band=family.groups[2].band) for group in family.groups)
        empty = draw_family(Family("wire", nothing)).axes[0]
        assert empty.texts[0].get_text() == "No group has a mean curve."
