"""Wires in figures: units, names, styles and cross-sections."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.quality import Severity
from labpipe.records.wire import WireLayout, WireTable
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    PageTexts,
    area_key,
    keyed_page,
    label_log_axis,
    line_key,
    panel_grid,
    require_room,
    style_colours,
)
from labpipe.report.wording import Scale, write_number

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch


CURVATURE = Scale(1.0, "1/m")
LENGTH = Scale(1e3, "mm")
MOMENT = Scale(1e3, "N·mm")
STIFFNESS = Scale(1e6, "N·mm²")
_LARGE_STIFFNESS = Scale(1.0, "N·m²")
FORCE = Scale(1.0, "N")

MAX_WIRES = 12
"""Wires on one page: more could not be distinguished."""


def stiffness_scale(tables: Sequence[WireTable]) -> Scale:
    """Return the unit for the stiffnesses of a page: N·mm², or N·m² from 1 N·m²."""
    largest = max(table.stick_stiffness for table in tables)
    return STIFFNESS if largest < 1.0 else _LARGE_STIFFNESS


def short_name(table: WireTable) -> str:
    """Shorten the name of a wire for a line with other texts."""
    max_name_length = 24
    name = " ".join(table.name.split())
    return name if len(name) <= max_name_length else name[: max_name_length - 1] + "…"


def strand_words(table: WireTable) -> str:
    """Describe strands, such as ``19 × 0.24 mm``; different ones layer by layer.

    Examples
    --------
    Layers of one strand of 0.3 mm and six of 0.25 mm are ``1 × 0.3 + 6 × 0.25 mm``.
    """
    groups: list[tuple[int, str]] = []
    for count, diameter in zip(table.spec.layer_counts, table.spec.strand_diameters, strict=True):
        size = f"{LENGTH.factor * diameter:.3g}"
        if groups and groups[-1][1] == size:
            groups[-1] = (groups[-1][0] + count, size)
        else:
            groups.append((count, size))
    return " + ".join(f"{count} \u00d7 {size}" for count, size in groups) + f" {LENGTH.unit}"


def wire_title(table: WireTable) -> str:
    """Write name, strands, layout and diameter of a wire in one line."""
    diameter = 2.0 * LENGTH.factor * table.layout.wire_radius
    return (
        f"{short_name(table)}  ·  wire model  ·  {strand_words(table)}, {table.layout.kind}"
        f"  ·  wire {diameter:.3g} {LENGTH.unit}"
    )


def warnings_of(table: WireTable) -> str:
    """Join the warnings and errors of the notes as sentences."""
    messages = [note.message for note in table.notes if note.severity is not Severity.INFO]
    return " ".join(f"{note[0].upper()}{note[1:].rstrip('.')}." for note in messages)


def is_bent(table: WireTable) -> Flags:
    """Return which points of a table have a positive curvature, for a logarithmic axis."""
    return np.asarray(table.curvature > 0.0)


def set_log_axes(axes: Axes, across: Floats) -> None:
    """Set two logarithmic axes with plain numbers, against curvature.

    Parameters
    ----------
    axes : with all its lines
    across : shape (n,), 1/m; its first and last are the ends of the axis
    """
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(across[0], across[-1])
    axes.set_xlabel(CURVATURE.label("Curvature"))
    for axis in (axes.xaxis, axes.yaxis):
        label_log_axis(axis)


_INSULATION: dict[str, Any] = {"facecolor": "#dedede", "edgecolor": GREY, "linewidth": 0.6}
_BORE: dict[str, Any] = {
    "fill": False, "edgecolor": "black", "linewidth": 0.6, "linestyle": (0, (4, 2))
}  # fmt: skip
_AXIS: dict[str, Any] = {"color": "black", "linewidth": 0.5, "linestyle": (0, (8, 2, 1.5, 2))}


def section_figure(tables: Sequence[WireTable]) -> Figure:
    """Draw the sections of several wires side by side.

    Parameters
    ----------
    tables : 1 to 12 wires

    Returns
    -------
    A page with a panel per wire: all to the same scale if the largest wire is at most 2.5 times
    the smallest, else each to its own; each with a scale bar, its strands and its two limits of
    stiffness. The neutral axis is that of the model.

    Raises
    ------
    ValueError
        If there is no wire, or there are more than fit on a page.
    """
    sections_per_row = 4
    cell_mm = 45.0
    text_mm = 19.0
    require_room(len(tables), MAX_WIRES, "wires")
    columns = min(sections_per_row, len(tables))
    rows = math.ceil(len(tables) / columns)
    width = DOUBLE_COLUMN if columns > 2 else DOUBLE_COLUMN * 2 / 3
    page = keyed_page(
        _page_texts(tables), height_mm=rows * (cell_mm + text_mm) + 8.0, width_mm=width
    )
    panels = panel_grid(page, len(tables), columns=columns)
    unit = stiffness_scale(tables)
    for table, axes, reach in zip(tables, panels, _panel_reaches(tables), strict=True):
        plot_section(table, axes, reach=reach, unit=unit)
    return page


def plot_section(
    table: WireTable, axes: Axes, *, reach: float | None = None, unit: Scale | None = None
) -> None:
    """Draw one section, with a scale bar below it and its name and numbers above.

    Parameters
    ----------
    table : of the wire
    axes : to draw on
    reach : m, from the wire's axis to the edge of the panel; None to fit the wire
    unit : of the stiffnesses; None to fit the wire
    """
    layout = table.layout
    edge = LENGTH.factor * 1.06 * (reach or layout.wire_radius)
    for patch in [*_wall_patches(layout), *strand_patches(layout, table.spec.orientation)]:
        axes.add_patch(patch)
    if layout.kind == "compressed":
        x, y = _rotated_centres(layout, table.spec.orientation)
        axes.plot(x, y, ".", color="black", markersize=2.0)
    axes.plot([-edge, edge], [0.0, 0.0], **_AXIS)
    axes.set_aspect("equal", anchor="S")  # free room is between key and titles
    axes.set_xlim(-edge, edge)
    axes.set_ylim(-1.22 * edge, edge)
    axes.set_axis_off()
    axes.set_title(_section_title(table, unit or stiffness_scale([table])), linespacing=1.25)
    _draw_bar(axes, edge)


def strand_patches(layout: WireLayout, orientation: float = 0.0) -> list[Patch]:
    """Return the outlines of the strands in mm, with the neutral axis as x axis.

    Parameters
    ----------
    layout : of the strands
    orientation : rad, rotation of the section

    Returns
    -------
    A circle per strand; for compressed strands, sectors of rings with the areas of the strands,
    without gaps.
    """
    from matplotlib.patches import Circle, Wedge

    colours = style_colours()
    looks = [{"facecolor": colours[layer % len(colours)], **_OUTLINE} for layer in layout.layer]
    x, y = _rotated_centres(layout, orientation)
    if layout.kind != "compressed":
        radii = LENGTH.factor * layout.diameter / 2.0
        return [
            Circle((across, up), radius, **look)
            for across, up, radius, look in zip(x, y, radii, looks, strict=True)
        ]
    outer = _ring_edges(layout)
    angle = np.degrees(np.arctan2(y, x))
    half = 180.0 / np.bincount(layout.layer)[layout.layer]
    return [
        Wedge((0.0, 0.0), outer[ring + 1], turn - wide, turn + wide, width=thick, **look)
        for ring, turn, wide, thick, look in zip(
            layout.layer, angle, half, np.diff(outer)[layout.layer], looks, strict=True
        )
    ]


_OUTLINE: dict[str, Any] = {"edgecolor": "black", "linewidth": 0.4}


def _rotated_centres(layout: WireLayout, orientation: float) -> tuple[Floats, Floats]:
    """Return centres in mm, rotated so that the neutral axis is the x axis."""
    cosine, sine = math.cos(orientation), math.sin(orientation)
    x = LENGTH.factor * (cosine * layout.x - sine * layout.y)
    y = LENGTH.factor * (sine * layout.x + cosine * layout.y)
    return x, y


def _ring_edges(layout: WireLayout) -> Floats:
    """Return the radii of rings with the areas of their strands without gaps, mm, from 0."""
    areas = np.bincount(layout.layer, weights=layout.diameter**2)
    return np.asarray(LENGTH.factor * np.sqrt(np.concatenate([[0.0], np.cumsum(areas)])) / 2.0)


def _wall_patches(layout: WireLayout) -> list[Patch]:
    from matplotlib.patches import Annulus, Circle

    outer, bore = LENGTH.factor * layout.wire_radius, LENGTH.factor * layout.bore_radius
    wall = Annulus((0.0, 0.0), outer, outer - bore, **_INSULATION)
    return [wall, Circle((0.0, 0.0), bore, **_BORE)]


def _section_title(table: WireTable, unit: Scale) -> str:
    diameter = 2.0 * LENGTH.factor * table.layout.wire_radius
    stick, slip = (
        write_number(value, None, unit.factor, digits=3).value
        for value in (table.stick_stiffness, table.slip_stiffness)
    )
    return (
        f"{short_name(table)}\n{strand_words(table)}\n"
        f"{table.layout.kind}, wire {diameter:.3g} {LENGTH.unit}\n"
        f"stick {stick}, slip {slip} {unit.unit}"
    )


def _draw_bar(axes: Axes, edge: float) -> None:
    """Draw a scale bar of a round length, with the length beside it."""
    bar_share = 0.5
    power = 10.0 ** math.floor(math.log10(bar_share * 2.0 * edge))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= edge)
    level = -1.1 * edge
    axes.plot([-edge, length - edge], [level, level], color="black", solid_capstyle="butt")
    axes.text(length - edge + 0.05 * edge, level, f"{length:g} {LENGTH.unit}", va="center")


def _panel_reaches(tables: Sequence[WireTable]) -> list[float]:
    """Return the half widths of the panels: one for all if the wires have similar sizes."""
    radii = [table.layout.wire_radius for table in tables]
    return [max(radii)] * len(radii) if _is_one_scale(tables) else radii


def _is_one_scale(tables: Sequence[WireTable]) -> bool:
    # Largest over smallest wire of a page up to which all are drawn to the same scale.
    max_size_ratio = 2.5
    radii = [table.layout.wire_radius for table in tables]
    return max(radii) <= max_size_ratio * min(radii)


def _page_texts(tables: Sequence[WireTable]) -> PageTexts:
    scale = ""
    if len(tables) > 1:
        scale = ", all to the same scale" if _is_one_scale(tables) else ", each to its own scale"
    note = ""
    if any(table.layout.kind == "compressed" for table in tables):
        note = (
            "Compressed strands: sectors of rings with the area of each strand, without gaps; dots:"
            " centroids used by the model."
        )
    return PageTexts(f"Cross-sections of the wire model{scale}", note, _keys(tables))


def _keys(tables: Sequence[WireTable]) -> list[Artist]:
    has_core = any(np.sum(table.layout.layer == 0) == 1 for table in tables)
    layers = max(int(table.layout.layer.max()) for table in tables) + 1
    keys: list[Artist] = [
        area_key(_layer_name(number, has_core=has_core), facecolor=colour, **_OUTLINE)
        for number, colour in zip(range(layers), style_colours(), strict=False)
    ]
    bore = {"color": _BORE["edgecolor"], "linestyle": _BORE["linestyle"], "linewidth": 0.6}
    return [
        *keys,
        area_key("insulation", **_INSULATION),
        line_key("bore", **bore),
        line_key("neutral axis", **_AXIS),
    ]


def _layer_name(number: int, *, has_core: bool) -> str:
    if has_core:
        return "core" if number == 0 else f"ring {number}"
    return f"ring {number + 1}"
