"""Figures of a wire sheet: cross-sections, stiffness, moment, cantilever and comparison."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.quality import Severity
from labpipe.records.wire import WireLayout, WireTable
from labpipe.report.figure_page import (
    DOTTED,
    DOUBLE_COLUMN,
    GREY,
    FigureToSave,
    add_key,
    add_title,
    choose_line_looks,
    label_log_axis,
    list_style_colours,
    make_empty_page,
    make_page,
    make_panels,
    require_room,
    split_pages,
)
from labpipe.report.plot_records import split_doubtful
from labpipe.report.wording import Scale, write_number

if TYPE_CHECKING:
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


def choose_stiffness_unit(tables: Sequence[WireTable]) -> Scale:
    """Return the unit for the stiffnesses of a page: N·mm², or N·m² from 1 N·m²."""
    largest = max(table.stick_stiffness for table in tables)
    return STIFFNESS if largest < 1.0 else _LARGE_STIFFNESS


def shorten_name(table: WireTable) -> str:
    """Shorten the name of a wire for a line with other texts."""
    max_name_length = 24
    name = " ".join(table.name.split())
    return name if len(name) <= max_name_length else name[: max_name_length - 1] + "…"


def describe_strands(table: WireTable) -> str:
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


def write_wire_title(table: WireTable) -> str:
    """Write name, strands, layout and diameter of a wire in one line."""
    diameter = 2.0 * LENGTH.factor * table.layout.wire_radius
    return (
        f"{shorten_name(table)}  ·  wire model  ·  {describe_strands(table)}, {table.layout.kind}"
        f"  ·  wire {diameter:.3g} {LENGTH.unit}"
    )


def join_warnings(table: WireTable) -> str:
    """Join the warnings and errors of the notes as sentences."""
    messages = [note.message for note in table.notes if note.severity is not Severity.INFO]
    return " ".join(f"{note[0].upper()}{note[1:].rstrip('.')}." for note in messages)


def is_curved(table: WireTable) -> Flags:
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


_MAX_SIZE_RATIO = 2.5
"""Largest over smallest wire of a page up to which all are drawn to the same scale."""
_OUTLINE_STYLE: dict[str, Any] = {"edgecolor": "black", "linewidth": 0.4}


def draw_sections(tables: Sequence[WireTable]) -> Figure:
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
    page = make_page(height_mm=rows * (cell_mm + text_mm) + 8.0, width_mm=width)
    panels = make_panels(page, len(tables), columns=columns)
    unit = choose_stiffness_unit(tables)
    radii = [table.layout.wire_radius for table in tables]
    reaches = [max(radii)] * len(radii) if _has_common_scale(tables) else radii
    for table, axes, reach in zip(tables, panels, reaches, strict=True):
        plot_section(table, axes, reach=reach, unit=unit)
    scale = ""
    if len(tables) > 1:
        scale = (
            ", all to the same scale" if _has_common_scale(tables) else ", each to its own scale"
        )
    note = ""
    if any(table.layout.kind == "compressed" for table in tables):
        note = (
            "Compressed strands: sectors of rings with the area of each strand, without gaps; dots:"
            " centroids used by the model."
        )
    return add_title(page, f"Cross-sections of the wire model{scale}", note)


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
    for patch in [
        *make_strand_patches(layout, table.spec.orientation),
        *_make_wall_patches(layout),
    ]:
        axes.add_patch(patch)
    if layout.kind == "compressed":
        x, y = _rotate_centres(layout, table.spec.orientation)
        axes.plot(x, y, ".", color="black", markersize=2.0)
    look: dict[str, Any] = {"color": "black", "linewidth": 0.5, "linestyle": (0, (8, 2, 1.5, 2))}
    axes.plot([-edge, edge], [0.0, 0.0], label="neutral axis", **look)
    for label, style in _choose_layer_styles(layout).items():
        add_key(axes, label, is_area=True, **style)
    axes.set_aspect("equal", anchor="S")  # free room is between key and titles
    axes.set(xlim=(-edge, edge), ylim=(-1.22 * edge, edge))
    axes.set_axis_off()
    axes.set_title(
        _write_section_title(table, unit or choose_stiffness_unit([table])), linespacing=1.25
    )
    _draw_scale_bar(axes, edge)


def make_strand_patches(layout: WireLayout, orientation: float = 0.0) -> list[Patch]:
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

    colours = list_style_colours()
    looks = [
        {"facecolor": colours[layer % len(colours)], **_OUTLINE_STYLE} for layer in layout.layer
    ]
    x, y = _rotate_centres(layout, orientation)
    if layout.kind != "compressed":
        radii = LENGTH.factor * layout.diameter / 2.0
        return [
            Circle((across, up), radius, **look)
            for across, up, radius, look in zip(x, y, radii, looks, strict=True)
        ]
    outer = _compute_ring_radii(layout)
    angle = np.degrees(np.arctan2(y, x))
    half = 180.0 / np.bincount(layout.layer)[layout.layer]
    return [
        Wedge((0.0, 0.0), outer[at + 1], turn - wide, turn + wide, width=thick, **look)
        for at, turn, wide, thick, look in zip(
            layout.layer, angle, half, np.diff(outer)[layout.layer], looks, strict=True
        )
    ]


def _rotate_centres(layout: WireLayout, orientation: float) -> tuple[Floats, Floats]:
    """Return centres in mm, rotated so that the neutral axis is the x axis."""
    cosine, sine = math.cos(orientation), math.sin(orientation)
    x = LENGTH.factor * (cosine * layout.x - sine * layout.y)
    y = LENGTH.factor * (sine * layout.x + cosine * layout.y)
    return x, y


def _compute_ring_radii(layout: WireLayout) -> Floats:
    """Return the radii of rings with the areas of their strands without gaps, mm, from 0."""
    areas = np.bincount(layout.layer, weights=layout.diameter**2)
    return np.asarray(LENGTH.factor * np.sqrt(np.concatenate([[0.0], np.cumsum(areas)])) / 2.0)


def _make_wall_patches(layout: WireLayout) -> list[Patch]:
    from matplotlib.patches import Annulus, Circle

    outer, bore = LENGTH.factor * layout.wire_radius, LENGTH.factor * layout.bore_radius
    wall: dict[str, Any] = {"facecolor": "#dedede", "edgecolor": GREY, "linewidth": 0.6}
    inside: dict[str, Any] = {"fill": False, "linewidth": 0.6, "linestyle": (0, (4, 2))}
    return [
        Annulus((0.0, 0.0), outer, outer - bore, zorder=0.5, label="insulation", **wall),
        Circle((0.0, 0.0), bore, label="bore", **inside),
    ]


def _write_section_title(table: WireTable, unit: Scale) -> str:
    diameter = 2.0 * LENGTH.factor * table.layout.wire_radius
    stick, slip = (
        write_number(value, None, unit.factor, digits=3).value
        for value in (table.stick_stiffness, table.slip_stiffness)
    )
    return (
        f"{shorten_name(table)}\n{describe_strands(table)}\n"
        f"{table.layout.kind}, wire {diameter:.3g} {LENGTH.unit}\n"
        f"stick {stick}, slip {slip} {unit.unit}"
    )


def _draw_scale_bar(axes: Axes, edge: float) -> None:
    """Draw a scale bar of a round length, with the length beside it."""
    bar_share = 0.5
    power = 10.0 ** math.floor(math.log10(bar_share * 2.0 * edge))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= edge)
    level = -1.1 * edge
    axes.plot([-edge, length - edge], [level, level], color="black", solid_capstyle="butt")
    axes.text(length - edge + 0.05 * edge, level, f"{length:g} {LENGTH.unit}", va="center")


def _has_common_scale(tables: Sequence[WireTable]) -> bool:
    radii = [table.layout.wire_radius for table in tables]
    return max(radii) <= _MAX_SIZE_RATIO * min(radii)


def _choose_layer_styles(layout: WireLayout) -> dict[str, dict[str, Any]]:
    """Return the style of each layer of strands by its name."""
    has_core = np.sum(layout.layer == 0) == 1
    colours = list_style_colours()
    names = [f"ring {number + (not has_core)}" for number in range(int(layout.layer.max()) + 1)]
    if has_core:
        names[0] = "core"
    return {
        name: {"facecolor": colours[number % len(colours)], **_OUTLINE_STYLE}
        for number, name in enumerate(names)
    }


_LIMIT_LINE_STYLE: dict[str, Any] = {
    "color": "black",
    "linewidth": 0.6,
    "linestyle": (0, (5, 1.5, 1.2, 1.5)),
}
_MOMENT_PART_STYLES = (
    ("insulation", "#c8c8c8", ""),
    ("strands' own bending", "#E69F00", "\\\\\\\\"),
    ("slipping strands", "#56B4E9", "////"),
    ("sticking strands", "#0072B2", ""),
)
"""Parts of a moment from the bottom of the stack: name, colour, hatch."""


def draw_stiffness(table: WireTable) -> Figure:
    """Draw secant and tangent stiffness against curvature, both axes logarithmic.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with the limits for sticking strands and for slip without friction, the curvatures at
    which strands begin to slip, and the spread of the secant stiffness over all orientations.
    """
    page = make_page(height_mm=76.0)
    axes = page.subplots()
    use = is_curved(table)
    across, unit = table.curvature[use], choose_stiffness_unit([table])
    up = unit.factor
    lowest, highest = (
        up * moment[use] / across for moment in (table.lowest_moment, table.highest_moment)
    )
    colour, dashed = list_style_colours()[0], (0, (5, 1.5))
    secant, elastic = table.secant_stiffness[use], (table.moment - table.plastic)[use] / across
    axes.plot(across, up * secant, color=colour, linewidth=1.5, zorder=4, label="secant")
    axes.plot(across, up * table.tangent_stiffness[use], "C1", linestyle=dashed, label="tangent")
    look: dict[str, Any] = {"color": colour, "linewidth": 0.8, "linestyle": DOTTED}
    axes.plot(across, up * elastic, label="secant, without yielding", **look)
    area: dict[str, Any] = {"color": "#56B4E9", "alpha": 0.45, "linewidth": 0, "zorder": 1}
    axes.fill_between(across, lowest, highest, label="secant, all orientations", **area)
    axes.set_yscale("log")
    _mark_limits(table, axes, unit)
    set_log_axes(axes, across)
    axes.set_ylabel(unit.label("Bending stiffness"))
    onsets = table.slip_onsets
    onsets = onsets[(onsets > 0.0) & (onsets <= table.curvature[-1])]
    if len(onsets):
        sign: dict[str, Any] = {"color": "black", "marker": "|", "markersize": 8.0}
        place: dict[str, Any] = {
            "transform": axes.get_xaxis_transform(),
            "linestyle": "",
            "zorder": 5,
        }
        label = "a strand begins to slip"
        axes.plot(onsets, np.full(len(onsets), 0.035), label=label, **sign, **place)
    _shade_doubtful(table, axes)
    return add_title(page, write_wire_title(table), join_warnings(table))


def _shade_doubtful(table: WireTable, axes: Axes) -> None:
    if table.is_doubtful.any():
        _fade_range(axes, table.doubtful_curvature, float(table.curvature[-1]))


def _fade_range(axes: Axes, start: float, stop: float) -> None:
    """Fade a doubtful range of a panel, but not its frame."""
    zorder = 6
    axes.axvspan(start, stop, facecolor="white", alpha=0.6, linewidth=0, zorder=zorder)
    for spine in axes.spines.values():
        spine.set_zorder(zorder + 1)


def _mark_limits(table: WireTable, axes: Axes, unit: Scale) -> None:
    """Draw both limits as lines across the panel, with labels beside it."""
    headroom, label_ratio = 1.4, 1.35
    stick, slip = (unit.factor * value for value in (table.stick_stiffness, table.slip_stiffness))
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, headroom * stick))
    names = {
        stick: f"all stick\n{_write_four_digits(stick)}",
        slip: f"all slip\n{_write_four_digits(slip)}",
    }
    for level in (stick, slip):
        axes.axhline(level, label="limits without yielding", **_LIMIT_LINE_STYLE)
    if stick < label_ratio * slip:
        names = {
            slip: f"all stick\n{_write_four_digits(stick)}\nall slip\n{_write_four_digits(slip)}"
        }
    beside = axes.get_yaxis_transform()
    for level, label in names.items():
        axes.text(1.01, level, label, transform=beside, va="center")


def _write_four_digits(value: float) -> str:
    return write_number(value, None, digits=4).value


def draw_moment(table: WireTable) -> Figure:
    """Draw the moment against curvature with its parts, and the shares of the parts.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with two panels: stacked moments against curvature; shares of the moment against
    curvature on a logarithmic axis, which shows the change from stick to slip.
    """
    page = make_page(height_mm=62.0)
    left, right = page.subplots(1, 2)
    left.set_title("moment", loc="left")
    right.set_title("shares of the moment", loc="left")
    _plot_parts(table, left)
    use = is_curved(table)
    across = table.curvature[use]
    _stack(right, across, [100.0 * part[use] / table.moment[use] for part in split_moment(table)])
    right.set_xscale("log")
    right.set_xlim(across[0], across[-1])
    label_log_axis(right.xaxis)
    right.set_ylim(0.0, 100.0)
    right.set(xlabel=CURVATURE.label("Curvature"), ylabel="Share of the moment (%)")
    _shade_doubtful(table, right)
    return add_title(page, write_wire_title(table), join_warnings(table))


def _plot_parts(table: WireTable, axes: Axes) -> None:
    """Stack the parts of the moment; a dotted line is the moment without yielding."""
    max_elastic_moments = 2.0  # top of the panel, in largest moments
    across, up = table.curvature, MOMENT.factor
    _stack(axes, across, [up * part for part in split_moment(table)])
    axes.plot(across, up * table.moment, "k", linewidth=1.2, zorder=4, label="total moment")
    elastic = up * (table.moment - table.plastic)
    look: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": DOTTED}
    axes.plot(across, elastic, label="without yielding", **look)
    top = 1.04 * min(float(elastic.max()), max_elastic_moments * up * float(table.moment.max()))
    axes.set(xlim=(0.0, across[-1]), ylim=(0.0, top))
    axes.set(xlabel=CURVATURE.label("Curvature"), ylabel=MOMENT.label("Bending moment"))
    _shade_doubtful(table, axes)


def split_moment(table: WireTable) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the moments of insulation, yielding strands, slipping and sticking strands, N m."""
    return table.insulation, table.bending + table.plastic, table.slip, table.stick


def _stack(axes: Axes, across: Floats, parts: Sequence[Floats]) -> None:
    floor = np.zeros(len(across))
    for part, (label, colour, hatch) in zip(parts, _MOMENT_PART_STYLES, strict=True):
        look: dict[str, Any] = {"facecolor": colour, "hatch": hatch, "edgecolor": "white"}
        axes.fill_between(across, floor, floor + part, label=label, linewidth=0.0, **look)
        floor = floor + part


def draw_cantilever(table: WireTable) -> Figure:
    """Draw the end load against the deflection of the tip.

    Parameters
    ----------
    table : without a cantilever curve the page says so

    Returns
    -------
    A page with the curve and the two straight lines of small deflections, force = 3 EI deflection
    / length^3: all strands stick, all slip without friction.
    """
    margin_factor = 1.08
    note = " ".join([_describe_cantilever(table), join_warnings(table)]).strip()
    if len(table.tip_deflection) < 2:  # rest alone
        return make_empty_page(
            write_wire_title(table), "There is no cantilever curve to draw.", note
        )
    page = make_page(height_mm=70.0)
    axes = page.subplots()
    across, up = LENGTH.factor * table.tip_deflection, FORCE.factor * table.tip_force
    axes.plot(across, up, color="C0", linewidth=1.5, zorder=3, label="wire model")
    ends = np.array([0.0, table.tip_deflection[-1]])
    dotted: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": DOTTED}
    for stiffness, label, look in (
        (table.stick_stiffness, "straight line, all stick", dotted),
        (table.slip_stiffness, "straight line, all slip", _LIMIT_LINE_STYLE),
    ):
        force = FORCE.factor * 3.0 * stiffness / table.spec.length**3 * ends
        axes.plot(LENGTH.factor * ends, force, label=label, **look)
    axes.set(xlim=(0.0, across[-1]), ylim=(0.0, margin_factor * float(np.max(up))))
    axes.set(xlabel=LENGTH.label("Tip deflection"), ylabel=FORCE.label("End load"))
    if table.doubtful_deflection < table.tip_deflection[-1]:
        _fade_range(axes, LENGTH.factor * table.doubtful_deflection, float(across[-1]))
    return add_title(page, write_wire_title(table), note)


def _describe_cantilever(table: WireTable) -> str:
    length, rest = LENGTH.factor * table.spec.length, table.rest
    held = ""
    if rest is not None:
        held = f"From rest: tip held by {1e3 * rest.force:.3g} mN, sag {1e6 * rest.sag:.3g} µm. "
    return (
        f"Free length {length:.4g} {LENGTH.unit}, first loading; the load stays normal to the"
        f" clamped axis. {held}Straight lines: the limits without yielding,"
        " 3\u00a0EI\u00a0/\u00a0length³."
    )


_COMPARISON_NOTE = (
    "Each line ends with the range of its law, and is lighter where the strain at the rim of the"
    " insulation exceeds its assumed linear range."
)


def draw_wire_comparison(tables: Sequence[WireTable]) -> Figure:
    """Draw secant stiffness and moment of several wires against curvature, one line each.

    Parameters
    ----------
    tables : 1 to 12 wires

    Raises
    ------
    ValueError
        If there is no wire, or more than fit in one figure.
    """
    require_room(len(tables), MAX_WIRES, "wires")
    page = make_page(height_mm=76.0)
    left, right = page.subplots(1, 2)
    unit = choose_stiffness_unit(tables)
    for table, look in zip(tables, choose_line_looks(len(tables)), strict=True):
        style: dict[str, Any] = {**look._asdict(), "label": shorten_name(table)}
        secant, moment = unit.factor * table.secant_stiffness, MOMENT.factor * table.moment
        sure = table.curvature <= table.doubtful_curvature
        for use, fade in split_doubtful(sure):
            drawn = use & is_curved(table)
            left.plot(table.curvature[drawn], secant[drawn], **style, alpha=fade)
            right.plot(table.curvature[use], moment[use], **style, alpha=fade)
    curvatures = np.concatenate([table.curvature[is_curved(table)] for table in tables])
    set_log_axes(left, np.array([curvatures.min(), curvatures.max()]))
    left.set_ylabel(unit.label("Secant bending stiffness"))
    right.set_xlim(left=0.0)
    right.set_ylim(bottom=0.0)
    right.set(xlabel=CURVATURE.label("Curvature"), ylabel=MOMENT.label("Bending moment"))
    left.set_title("secant stiffness", loc="left")
    right.set_title("moment", loc="left")
    return add_title(page, "Wires compared  ·  wire model", _COMPARISON_NOTE)


_INVALID_IN_FILE_NAME = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
_WIRE_FIGURES: dict[str, Callable[[WireTable], Figure]] = {
    "stiffness": draw_stiffness,
    "moment": draw_moment,
    "cantilever": draw_cantilever,
}


def list_wire_figures(tables: Sequence[WireTable]) -> Iterator[FigureToSave]:
    """List the figures of a sheet of wires.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet

    Yields
    ------
    ``sections-1`` and ``comparison-1`` with the first twelve wires, ``sections-2`` ...; then of
    each wire ``NAME.stiffness``, ``NAME.moment`` and ``NAME.cantilever``. There is no comparison
    of a single wire.
    """
    for number, page_tables in enumerate(split_pages(tables, MAX_WIRES), start=1):
        yield FigureToSave(f"sections-{number}", partial(draw_sections, page_tables))
        if len(page_tables) > 1:
            yield FigureToSave(f"comparison-{number}", partial(draw_wire_comparison, page_tables))
    for table in tables:
        names = list_figure_names(table.name)
        for name, draw in zip(names, _WIRE_FIGURES.values(), strict=True):
            yield FigureToSave(name, partial(draw, table))


def list_figure_names(name: str) -> list[str]:
    """Return the names of the figures of one wire, without endings.

    Parameters
    ----------
    name : of the wire
    """
    stem = _INVALID_IN_FILE_NAME.sub("-", name)
    return [f"{stem}.{kind}" for kind in _WIRE_FIGURES]
