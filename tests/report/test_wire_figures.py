"""Figures of modelled wires: stiffness, moments, cantilevers, comparisons, sections."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle, Rectangle, Wedge

from labpipe.records.wire import WireTable
from labpipe.report.figure_page import style
from labpipe.report.wire_figures import (
    cantilever_figure,
    comparison_figure,
    moment_figure,
    moment_parts,
    plot_cantilever,
    plot_parts,
    plot_shares,
    plot_stiffness,
    stiffness_figure,
    wire_drawings,
)
from labpipe.report.wire_sections import plot_section, section_figure, strand_patches
from tests.approved import Approve
from tests.builders.wire_tables import wire_table
from tests.report.builders_wires import compressed_wire, troubled
from tests.report.figure_words import all_words


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


@pytest.mark.parametrize(
    ("count", "start"),
    [
        (0, []),
        (1, ["sections-1", "w0.stiffness", "w0.moment", "w0.cantilever"]),
        (2, ["sections-1", "comparison-1", "w0.stiffness"]),
        (13, ["sections-1", "comparison-1", "sections-2", "w0.stiffness"]),
    ],
)
def test_names_of_figures(count: int, start: list[str]) -> None:
    tables = [replace(wire_table("A1"), name=f"w{number}") for number in range(count)]
    names = [drawing.name for drawing in wire_drawings(tables)]
    assert names[: len(start)] == start
    assert len([name for name in names if name.startswith("w")]) == 3 * count


def test_what_is_doubtful_is_lighter() -> None:
    """White is laid over curves beyond the range of the insulation, and over no others."""
    table = wire_table("A2")
    sure = replace(table, doubtful_curvature=float("inf"), doubtful_deflection=float("inf"))
    for draw, start in (
        (plot_stiffness, table.doubtful_curvature),
        (plot_parts, table.doubtful_curvature),
        (plot_shares, table.doubtful_curvature),
        (plot_cantilever, 1e3 * table.doubtful_deflection),
    ):
        doubtful, plain = Figure().subplots(2)
        draw(table, doubtful)
        draw(sure, plain)
        (cover,) = (patch for patch in doubtful.patches if isinstance(patch, Rectangle))
        assert cover.get_x() == pytest.approx(start)
        assert cover.get_facecolor() == (1.0, 1.0, 1.0, 0.6)
        assert not [patch for patch in plain.patches if isinstance(patch, Rectangle)]


def test_stacked_parts_reach_the_moment() -> None:
    table = wire_table("A3")
    axes = Figure().subplots()
    plot_parts(table, axes)
    assert len(axes.collections) == 4
    top = np.asarray(axes.collections[-1].get_paths()[0].vertices)[:, 1].max()
    assert top == pytest.approx(1e3 * table.moment[-1])
    np.testing.assert_allclose(sum(moment_parts(table)), table.moment, rtol=1e-12)


def scaled(table: WireTable, factor: float) -> WireTable:
    own = table.layout
    layout = replace(
        own, x=factor * own.x, y=factor * own.y, diameter=factor * own.diameter,
        bore_radius=factor * own.bore_radius, wire_radius=factor * own.wire_radius,
    )  # fmt: skip
    return replace(table, layout=layout)


def test_compressed_strands_fill_their_circle_with_their_areas() -> None:
    table, areas = compressed_wire(), []
    wedges = [patch for patch in strand_patches(table.layout) if isinstance(patch, Wedge)]
    for wedge in wedges:
        assert wedge.width is not None
        ring = wedge.r**2 - (wedge.r - wedge.width) ** 2
        areas.append(np.radians(wedge.theta2 - wedge.theta1) / 2.0 * ring)
    assert areas == pytest.approx([0.35 / 7] * 7, rel=1e-9)
    assert wedges[1].theta1 == pytest.approx(-30.0)
    page = section_figure([table])
    assert page.texts[1].get_text().startswith("Compressed strands: sectors of rings with the ar")


def test_strands_wall_bore_and_bar_to_scale() -> None:
    table = wire_table("A3")
    layout = table.layout
    circles = [patch for patch in strand_patches(layout) if isinstance(patch, Circle)]
    assert [circle.radius for circle in circles] == pytest.approx([0.12] * 19)
    centres = np.array([circle.center for circle in circles])
    np.testing.assert_allclose(centres, 1e3 * np.column_stack([layout.x, layout.y]))
    axes = Figure().subplots()
    plot_section(table, axes)
    (wall,) = (patch for patch in axes.patches if isinstance(patch, Annulus))
    assert (wall.get_radii()[0], wall.get_width()) == pytest.approx((0.9, 0.3))
    bore = next(patch for patch in axes.patches if isinstance(patch, Circle) and not patch.fill)
    assert bore.radius == pytest.approx(0.6)
    assert np.ptp(np.asarray(axes.lines[1].get_xdata())) == pytest.approx(0.5)


def test_sections_on_a_page_have_one_scale() -> None:
    tables = [wire_table("A1"), wire_table("C5"), scaled(wire_table("A1"), 5.0)]
    for shown, factor in ((tables[:2], 1.0), (tables[::2], 5.0)):
        one, other = (float(np.ptp(axes.get_xlim())) for axes in section_figure(shown).axes)
        assert other == pytest.approx(factor * one)


def test_words(approved: Approve) -> None:
    a1, a3 = wire_table("A1"), wire_table("A3")
    own = a1.layout
    coreless = replace(
        own, x=own.x[1:4], y=own.y[1:4], layer=own.layer[1:4] - 1, diameter=own.diameter[1:4]
    )
    mixed = replace(a3.spec, layer_counts=(1, 6, 12), strand_diameters=(0.3e-3, 0.25e-3, 0.25e-3))
    stiff = replace(a1, stick_stiffness=51.57, name="a long  name " + "x" * 40)
    at_rest = replace(a3, tip_deflection=np.zeros(1), tip_force=np.zeros(1))
    near = replace(a1, slip_stiffness=0.9 * a1.stick_stiffness)
    pages = {
        "stiffness": stiffness_figure(a3),
        "limits near each other": stiffness_figure(near),
        "a stiff wire": stiffness_figure(stiff),
        "no slip": stiffness_figure(replace(a1, slip_onsets=np.array([np.inf]))),
        "warnings": stiffness_figure(troubled()),
        "moment": moment_figure(wire_table("C4")),
        "cantilever": cantilever_figure(a3),
        "cantilever at rest": cantilever_figure(at_rest),
        "no cantilever": cantilever_figure(troubled()),
        "comparison": comparison_figure([a1, wire_table("A2"), a3]),
        "comparison with a stiff wire": comparison_figure([a1, stiff]),
        "sections": section_figure([a1, replace(a3, spec=mixed), stiff]),
        "sections unlike in size": section_figure([a1, scaled(a1, 5.0)]),
        "section without core": section_figure([replace(a1, layout=coreless)]),
    }
    approved(all_words(pages))
