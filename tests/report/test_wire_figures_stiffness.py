from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.report.figure_page import style
from labpipe.report.wire_figures import (
    moment_figure,
    moment_parts,
    plot_parts,
    plot_shares,
    plot_stiffness,
    stiffness_figure,
)
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import CUT, troubled


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def labels(page: Figure) -> list[str]:
    return [text.get_text() for legend in page.legends for text in legend.get_texts()]


def line(axes: Axes, number: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = axes.lines[number].get_data()
    return np.asarray(x), np.asarray(y)


def test_secant_and_tangent_on_logarithmic_axes() -> None:
    table = wire_table("A3")
    page = stiffness_figure(table)
    axes = page.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert axes.get_xlabel() == "Curvature (1/m)"
    assert axes.get_ylabel() == "Bending stiffness (N·mm²)"
    np.testing.assert_allclose(line(axes, 1)[1], 1e6 * table.tangent_stiffness[1:])
    np.testing.assert_allclose(line(axes, 2)[1], 1e6 * table.secant_stiffness[1:])
    assert line(axes, 0)[1][-1] == pytest.approx(1e6 * table.slip_stiffness, rel=0.02)
    assert axes.get_xlim() == pytest.approx((table.curvature[1], table.curvature[-1]))
    assert labels(page) == [
        "secant", "tangent", "secant, without yielding", "secant, all orientations",
        "limits without yielding", "a strand begins to slip",
    ]  # fmt: skip


def test_limits_are_named_with_their_numbers() -> None:
    table = wire_table("A3")
    axes = Figure().subplots()
    plot_stiffness(table, axes)
    assert [text.get_text() for text in axes.texts] == ["all stick\n6971", "all slip\n741.9"]
    assert axes.get_ylim()[1] > 1e6 * table.stick_stiffness


def test_limits_that_are_near_each_other_share_a_place() -> None:
    table = wire_table("A1")
    axes = Figure().subplots()
    plot_stiffness(replace(table, slip_stiffness=0.9 * table.stick_stiffness), axes)
    assert [text.get_text() for text in axes.texts] == ["all stick\n1446\nall slip\n1301"]


def test_stiff_wires_are_shown_in_newton_square_metres() -> None:
    table = wire_table("A1")
    stiff = replace(table, stick_stiffness=51.55, secant_stiffness=1e4 * table.secant_stiffness)
    axes = stiffness_figure(stiff).axes[0]
    assert axes.get_ylabel() == "Bending stiffness (N·m²)"
    assert axes.texts[0].get_text() == "all stick\n51.55"
    np.testing.assert_allclose(line(axes, 2)[1], stiff.secant_stiffness[1:])


def test_onsets_within_the_range_are_marked() -> None:
    table = wire_table("A1")
    later = replace(table, slip_onsets=np.concatenate([[0.0], table.slip_onsets, [1e3, np.inf]]))
    axes = Figure().subplots()
    plot_stiffness(later, axes)
    np.testing.assert_array_equal(line(axes, -1)[0], table.slip_onsets)
    never = replace(table, slip_onsets=np.array([np.inf]))
    assert "a strand begins to slip" not in labels(stiffness_figure(never))


def test_spread_over_orientations() -> None:
    table = wire_table("A1")
    axes = Figure().subplots()
    plot_stiffness(table, axes)
    band = np.asarray(axes.collections[0].get_paths()[0].vertices)
    expected = 1e6 * table.highest_moment[1:] / table.curvature[1:]
    assert band[:, 1].max() == pytest.approx(expected.max())


def test_few_decades_have_numbers_between() -> None:
    axes = Figure().subplots()
    plot_stiffness(wire_table("A1"), axes)
    axes.figure.canvas.draw()
    shown = [text.get_text() for text in axes.get_yticklabels()]
    assert {"200", "500", "1000"} <= set(shown)
    assert all("$" not in text for text in shown)
    assert "0.2" not in [text.get_text() for text in axes.get_xticklabels()]


def test_warnings_stand_below() -> None:
    page = stiffness_figure(troubled())
    assert " ".join(page.texts[1].get_text().split()) == CUT.message


def test_stacked_parts_reach_the_moment() -> None:
    table = wire_table("A3")
    axes = Figure().subplots()
    plot_parts(table, axes)
    assert len(axes.collections) == 4
    top = np.asarray(axes.collections[-1].get_paths()[0].vertices)[:, 1].max()
    assert top == pytest.approx(1e3 * table.moment[-1])
    np.testing.assert_allclose(sum(moment_parts(table)), table.moment, rtol=1e-12)
    np.testing.assert_allclose(line(axes, 1)[1], 1e3 * (table.moment - table.plastic))
    assert axes.get_ylim()[1] <= 2.08 * 1e3 * table.moment[-1]
    assert axes.get_ylabel() == "Bending moment (N·mm)"


def test_shares_add_up_to_a_hundred_per_cent() -> None:
    axes = Figure().subplots()
    plot_shares(wire_table("A3"), axes)
    upper = np.asarray(axes.collections[-1].get_paths()[0].vertices)[:, 1]
    assert upper.max() == pytest.approx(100.0)
    assert (axes.get_xscale(), axes.get_ylim()) == ("log", (0.0, 100.0))


def test_moment_figure_has_two_panels() -> None:
    page = moment_figure(wire_table("C4"))
    heads = [axes.get_title(loc="left") for axes in page.axes]
    assert heads == ["(a) moment", "(b) shares of the moment"]
    assert labels(page) == [
        "strands that stick", "strands that slip", "strands' own bending", "insulation",
        "whole moment", "without yielding",
    ]  # fmt: skip
