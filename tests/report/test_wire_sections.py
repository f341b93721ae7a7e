from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle, Patch, Wedge

from labpipe.records.wire import WireTable
from labpipe.report.figure_page import style, style_colours
from labpipe.report.wire_sections import (
    plot_section,
    section_figure,
    strand_patches,
)
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import compressed_wire


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def colours(patches: list[Patch]) -> list[str]:
    return [to_hex(patch.get_facecolor()).upper() for patch in patches]


def scaled(table: WireTable, factor: float) -> WireTable:
    own = table.layout
    layout = replace(
        own, x=factor * own.x, y=factor * own.y, diameter=factor * own.diameter,
        bore_radius=factor * own.bore_radius, wire_radius=factor * own.wire_radius,
    )  # fmt: skip
    return replace(table, layout=layout)


def test_strands_to_scale_in_the_colours_of_their_layers() -> None:
    layout = wire_table("A3").layout
    patches = strand_patches(layout)
    circles = [patch for patch in patches if isinstance(patch, Circle)]
    assert len(circles) == 19
    assert [circle.radius for circle in circles] == pytest.approx([0.12] * 19)
    centres = np.array([circle.center for circle in circles])
    np.testing.assert_allclose(centres, 1e3 * np.column_stack([layout.x, layout.y]))
    own = [colour.upper() for colour in style_colours()]
    assert colours(patches) == [own[layer] for layer in layout.layer]
    assert len(set(own)) >= 6


def test_section_is_turned_against_the_neutral_axis() -> None:
    layout = wire_table("A1").layout
    turned = strand_patches(layout, np.pi / 2.0)[1]
    assert isinstance(turned, Circle)
    np.testing.assert_allclose(turned.center, (0.0, 0.26), atol=1e-12)


def test_compressed_strands_fill_their_circle_with_their_areas() -> None:
    table = compressed_wire()
    wedges = [each for each in strand_patches(table.layout) if isinstance(each, Wedge)]
    assert len(wedges) == 7
    areas = []
    for each in wedges:
        assert each.width is not None
        ring = each.r**2 - (each.r - each.width) ** 2
        areas.append(np.radians(each.theta2 - each.theta1) / 2.0 * ring)
    np.testing.assert_allclose(areas, 0.35 / 7, rtol=1e-9)
    assert wedges[1].theta1 == pytest.approx(-30.0)
    page = section_figure([table])
    assert page.texts[1].get_text().startswith("Compressed strands: sectors of rings with the ar")


def test_insulation_bore_axis_and_bar() -> None:
    axes = Figure().subplots()
    table = wire_table("A3")
    plot_section(table, axes)
    walls = [patch for patch in axes.patches if isinstance(patch, Annulus)]
    assert [wall.get_radii()[0] for wall in walls] == pytest.approx([0.9])
    assert walls[0].get_width() == pytest.approx(0.3)
    bore = next(each for each in axes.patches if isinstance(each, Circle) and not each.fill)
    assert bore.radius == pytest.approx(0.6)
    assert bore.get_linestyle() != "solid"
    axis, bar = axes.lines
    assert np.asarray(axis.get_ydata()).tolist() == [0.0, 0.0]
    assert np.ptp(np.asarray(bar.get_xdata())) == pytest.approx(0.5)
    assert axes.texts[0].get_text() == "0.5 mm"
    assert axes.get_title() == (
        "A3\n19 \u00d7 0.24 mm\nhexagonal, wire 1.8 mm\nstick 6970, slip 742 N·mm²"
    )


def wide(axes: Axes) -> float:
    return float(np.ptp(axes.get_xlim()))


def test_wires_of_like_size_are_drawn_to_one_scale() -> None:
    page = section_figure([wire_table(name) for name in ("A1", "A3", "C5")])
    assert len({wide(axes) for axes in page.axes}) == 1
    assert page.texts[0].get_text().endswith("all to one scale")
    labels = [text.get_text() for text in page.legends[0].get_texts()]
    assert labels == [
        "core", "ring 1", "ring 2", "ring 3", "insulation", "bore", "neutral axis"
    ]  # fmt: skip


def test_wires_of_unlike_size_each_have_their_own_scale() -> None:
    small = wire_table("A1")
    page = section_figure([small, scaled(small, 5.0)])
    assert wide(page.axes[1]) == pytest.approx(5.0 * wide(page.axes[0]))
    assert page.texts[0].get_text().endswith("each to its own scale")
    assert [axes.texts[0].get_text() for axes in page.axes] == ["0.5 mm", "2 mm"]


def test_a_wire_without_core_begins_with_ring_1() -> None:
    table = wire_table("A1")
    own = table.layout
    layout = replace(
        own, x=own.x[1:4], y=own.y[1:4], layer=own.layer[1:4] - 1, diameter=own.diameter[1:4]
    )
    page = section_figure([replace(table, layout=layout)])
    assert page.legends[0].get_texts()[0].get_text() == "ring 1"


def test_a_dozen_on_a_page_and_no_more() -> None:
    table = wire_table("A1")
    page = section_figure([table] * 12)
    assert sum(axes.axison or bool(axes.patches) for axes in page.axes) == 12
    with pytest.raises(ValueError, match="13 wires: allowed are 1 to 12 on a page"):
        section_figure([table] * 13)
    with pytest.raises(ValueError, match="0 wires: allowed are 1 to 12 on a page"):
        section_figure([])


@pytest.mark.parametrize(
    ("stick", "words"),
    [
        (1.2345e-3, "stick 1230, slip 337 N·mm²"),
        (51.57, "stick 51.6, slip 3.37 \u00d7 10⁻⁴ N·m²"),
    ],
)
def test_numbers_have_three_digits_in_a_unit_that_suits(stick: float, words: str) -> None:
    axes = Figure().subplots()
    plot_section(replace(wire_table("A1"), stick_stiffness=stick), axes)
    assert axes.get_title().splitlines()[-1] == words
