"""Figures of a wire sheet: sections, stiffness, moment and end load of wires, as modelled."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats
from labpipe.records.quality import Severity
from labpipe.records.wire import WireLayout, WireTable
from labpipe.report import figure_page
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
    """Choose the unit of bending stiffness of a figure: N·mm², or N·m² from 1 N·m² upwards."""
    largest = max(table.stick_stiffness for table in tables)
    return STIFFNESS if largest < 1.0 else _LARGE_STIFFNESS


def shorten_name(table: WireTable) -> str:
    """Shorten the name of a wire to 24 characters, for a line that holds other texts."""
    max_name_length = 24
    name = " ".join(table.name.split())
    return name if len(name) <= max_name_length else name[: max_name_length - 1] + "…"


def describe_strands(table: WireTable) -> str:
    """Write the number and the diameter of the strands, such as ``19 × 0.24 mm``.

    Neighbouring layers of one diameter are counted together: a core of 0.3 mm with six strands of
    0.25 mm is ``1 × 0.3 + 6 × 0.25 mm``.
    """
    spec = table.spec
    sizes = [f"{LENGTH.factor * diameter:.3g}" for diameter in spec.strand_diameters]
    layers = groupby(zip(sizes, spec.layer_counts, strict=True), key=lambda layer: layer[0])
    parts = [f"{sum(count for _, count in same)} \u00d7 {size}" for size, same in layers]
    return f"{' + '.join(parts)} {LENGTH.unit}"


def write_wire_title(table: WireTable) -> str:
    """Write the name, strands, layout and diameter of a wire in one line."""
    diameter = 2.0 * LENGTH.factor * table.layout.wire_radius
    return (
        f"{shorten_name(table)}  ·  wire model  ·  {describe_strands(table)}, {table.layout.kind}"
        f"  ·  wire {diameter:.3g} {LENGTH.unit}"
    )


def join_warnings(table: WireTable) -> str:
    """Join the warnings and errors among the notes of a wire as sentences."""
    messages = [note.message for note in table.notes if note.severity is not Severity.INFO]
    return " ".join(f"{note[0].upper()}{note[1:].rstrip('.')}." for note in messages)


def is_curved(table: WireTable) -> Flags:
    """Return whether each curvature of a table is positive and fits a logarithmic axis, (n,)."""
    return np.asarray(table.curvature > 0.0)


def set_log_axes(axes: Axes, x: Floats) -> None:
    """Make both axes logarithmic, with plain numbers, and label the horizontal one.

    Parameters
    ----------
    axes : with everything drawn
    x : shape (n,), 1/m, rising curvatures; the first and the last end the horizontal axis
    """
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(x[0], x[-1])
    axes.set_xlabel(CURVATURE.label("Curvature"))
    for axis in (axes.xaxis, axes.yaxis):
        figure_page.label_log_axis(axis)


_MAX_SIZE_RATIO = 2.5
"""Diameter of the largest wire over the smallest, up to which all have one scale on a page."""


def draw_sections(tables: Sequence[WireTable]) -> Figure:
    """Draw the cross-sections of several wires side by side.

    Parameters
    ----------
    tables : 1 to 12 wires

    Returns
    -------
    A panel per wire with its strands, a scale bar, the neutral axis of the model and the bending
    stiffness with all strands sticking and all slipping. All panels have one scale if the largest
    wire is at most 2.5 times the smallest, else each has its own.

    Raises
    ------
    ValueError
        If there is no wire, or more than `MAX_WIRES`.
    """
    sections_per_row, cell_mm, text_mm = 4, 45.0, 19.0
    figure_page.require_room(len(tables), MAX_WIRES, "wires")
    columns = min(sections_per_row, len(tables))
    rows = math.ceil(len(tables) / columns)
    width = figure_page.DOUBLE_COLUMN if columns > 2 else figure_page.DOUBLE_COLUMN * 2 / 3
    page = figure_page.make_page(height_mm=rows * (cell_mm + text_mm) + 8.0, width_mm=width)
    panels = figure_page.make_panels(page, len(tables), columns=columns)
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
        note = format_sentence("report.compressed_strands")
    return figure_page.add_title(page, f"Cross-sections of the wire model{scale}", note)


def plot_section(
    table: WireTable, axes: Axes, *, reach: float | None = None, unit: Scale | None = None
) -> None:
    """Draw one cross-section with a scale bar, and its name and numbers as the title.

    Parameters
    ----------
    table : of the wire
    axes : to draw on
    reach : m, from the axis of the wire to the edge of the panel; None for the radius of the wire
    unit : of the bending stiffness; None to choose it for this wire
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
    axes.plot([-edge, edge], [0.0, 0.0], **figure_page.read_look("neutral_axis"))
    for label, colour in _choose_layer_colours(layout).items():
        figure_page.add_key(
            axes, label, is_area=True, **figure_page.read_look("strand_outline", facecolor=colour)
        )
    axes.set_aspect("equal", anchor="S")  # leaves free room below the titles
    axes.set(xlim=(-edge, edge), ylim=(-1.22 * edge, edge))
    axes.set_axis_off()
    axes.set_title(
        _write_section_title(table, unit or choose_stiffness_unit([table])), linespacing=1.25
    )
    _draw_scale_bar(axes, edge)


def make_strand_patches(layout: WireLayout, orientation: float = 0.0) -> list[Patch]:
    """Make the outlines of the strands in mm; the neutral axis is the x axis.

    Parameters
    ----------
    layout : of the strands
    orientation : rad, by which the section is rotated

    Returns
    -------
    A circle per strand, coloured by layer. Compressed strands are sectors of rings without gaps;
    each sector has the area of its strand.
    """
    from matplotlib.patches import Circle, Wedge

    colours = figure_page.list_style_colours()
    looks = [
        figure_page.read_look("strand_outline", facecolor=colours[layer % len(colours)])
        for layer in layout.layer
    ]
    x, y = _rotate_centres(layout, orientation)
    if layout.kind != "compressed":
        radii = LENGTH.factor * layout.diameter / 2.0
        return [
            Circle(centre, radius, **look)
            for centre, radius, look in zip(zip(x, y, strict=True), radii, looks, strict=True)
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
    """Return x and y of the centres of the strands in the rotated section, mm."""
    cosine, sine = math.cos(orientation), math.sin(orientation)
    x = LENGTH.factor * (cosine * layout.x - sine * layout.y)
    y = LENGTH.factor * (sine * layout.x + cosine * layout.y)
    return x, y


def _compute_ring_radii(layout: WireLayout) -> Floats:
    """Return the edges of rings that have the areas of their layers without gaps, mm, from 0."""
    areas = np.bincount(layout.layer, weights=layout.diameter**2)
    return np.asarray(LENGTH.factor * np.sqrt(np.concatenate([[0.0], np.cumsum(areas)])) / 2.0)


def _make_wall_patches(layout: WireLayout) -> list[Patch]:
    from matplotlib.patches import Annulus, Circle

    outer, bore = LENGTH.factor * layout.wire_radius, LENGTH.factor * layout.bore_radius
    return [
        Annulus((0.0, 0.0), outer, outer - bore, **figure_page.read_look("insulation_wall")),
        Circle((0.0, 0.0), bore, **figure_page.read_look("bore")),
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
    """Draw a scale bar of a round length up to half the width of the panel, with its length."""
    power = 10.0 ** math.floor(math.log10(edge))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= edge)
    level = -1.1 * edge
    axes.plot([-edge, length - edge], [level, level], color="black", solid_capstyle="butt")
    axes.text(length - edge + 0.05 * edge, level, f"{length:g} {LENGTH.unit}", va="center")


def _has_common_scale(tables: Sequence[WireTable]) -> bool:
    radii = [table.layout.wire_radius for table in tables]
    return max(radii) <= _MAX_SIZE_RATIO * min(radii)


def _choose_layer_colours(layout: WireLayout) -> dict[str, str]:
    """Choose the colour of each layer of strands by its name."""
    has_core = np.sum(layout.layer == 0) == 1
    colours = figure_page.list_style_colours()
    names = [f"ring {number + (not has_core)}" for number in range(int(layout.layer.max()) + 1)]
    if has_core:
        names[0] = "core"
    return {name: colours[number % len(colours)] for number, name in enumerate(names)}


def draw_stiffness(table: WireTable) -> Figure:
    """Draw secant and tangent stiffness against curvature on logarithmic axes.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page that also shows the stiffness of all strands sticking and of all slipping without
    friction, the curvatures at which strands begin to slip, and the range of the secant stiffness
    over all orientations of the section.
    """
    page = figure_page.make_page(height_mm=76.0)
    axes = page.subplots()
    use = is_curved(table)
    x, unit = table.curvature[use], choose_stiffness_unit([table])
    factor = unit.factor
    lowest, highest = (
        factor * moment[use] / x for moment in (table.lowest_moment, table.highest_moment)
    )
    elastic = (table.moment - table.plastic)[use] / x
    axes.plot(x, factor * table.secant_stiffness[use], **figure_page.read_look("secant"))
    axes.plot(x, factor * table.tangent_stiffness[use], **figure_page.read_look("tangent"))
    axes.plot(x, factor * elastic, **figure_page.read_look("secant_without_yielding"))
    axes.fill_between(x, lowest, highest, **figure_page.read_look("secant_of_orientations"))
    axes.set_yscale("log")
    _mark_limits(table, axes, unit)
    set_log_axes(axes, x)
    axes.set_ylabel(unit.label("Bending stiffness"))
    onsets = table.slip_onsets
    onsets = onsets[(onsets > 0.0) & (onsets <= table.curvature[-1])]
    if len(onsets):
        above_axis = axes.get_xaxis_transform()
        heights = np.full(len(onsets), 0.035)
        axes.plot(onsets, heights, transform=above_axis, **figure_page.read_look("onset_of_slip"))
    _fade_beyond(axes, table.doubtful_curvature, table.curvature[-1])
    return figure_page.add_title(page, write_wire_title(table), join_warnings(table))


def _fade_beyond(axes: Axes, limit: float, end: float) -> None:
    """Fade what a panel shows beyond a limit up to its end, where the model is doubtful."""
    if limit >= end:
        return
    zorder = 6
    axes.axvspan(limit, end, facecolor="white", alpha=0.6, linewidth=0, zorder=zorder)
    for spine in axes.spines.values():  # the frame is not faded
        spine.set_zorder(zorder + 1)


def _mark_limits(table: WireTable, axes: Axes, unit: Scale) -> None:
    """Draw the stiffness of sticking and of slipping strands across the panel, with labels."""
    headroom, label_ratio = 1.4, 1.35  # of the higher limit; of limits whose labels would overlap
    stick, slip = (unit.factor * value for value in (table.stick_stiffness, table.slip_stiffness))
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, headroom * stick))
    for level in (stick, slip):
        axes.axhline(level, **figure_page.read_look("stiffness_limit"))
    stick_label, slip_label = (
        f"all {state}\n{write_number(level, None, digits=4).value}"
        for state, level in (("stick", stick), ("slip", slip))
    )
    labels = {stick: stick_label, slip: slip_label}
    if stick < label_ratio * slip:
        labels = {slip: f"{stick_label}\n{slip_label}"}
    beside = axes.get_yaxis_transform()
    for level, label in labels.items():
        axes.text(1.01, level, label, transform=beside, va="center")


def draw_moment(table: WireTable) -> Figure:
    """Draw the moment with its parts against curvature, and the shares of the parts.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with two panels: the stacked parts of the moment, and their shares against curvature on
    a logarithmic axis, which shows how sticking strands begin to slip.
    """
    page = figure_page.make_page(height_mm=62.0)
    left, right = page.subplots(1, 2)
    left.set_title("moment", loc="left")
    right.set_title("shares of the moment", loc="left")
    _plot_moment(table, left)
    use = is_curved(table)
    x = table.curvature[use]
    shares = {
        name: 100.0 * part[use] / table.moment[use] for name, part in _split_moment(table).items()
    }
    _stack(right, x, shares)
    right.set_xscale("log")
    right.set_xlim(x[0], x[-1])
    figure_page.label_log_axis(right.xaxis)
    right.set_ylim(0.0, 100.0)
    right.set(xlabel=CURVATURE.label("Curvature"), ylabel="Share of the moment (%)")
    _fade_beyond(right, table.doubtful_curvature, table.curvature[-1])
    return figure_page.add_title(page, write_wire_title(table), join_warnings(table))


def _plot_moment(table: WireTable, axes: Axes) -> None:
    """Draw the stacked parts of the moment, the moment, and the moment without yielding."""
    max_elastic_moments = 2.0  # top of the panel, in largest moments
    x, factor = table.curvature, MOMENT.factor
    _stack(axes, x, {name: factor * part for name, part in _split_moment(table).items()})
    elastic = factor * (table.moment - table.plastic)
    axes.plot(x, factor * table.moment, **figure_page.read_look("total_moment"))
    axes.plot(x, elastic, **figure_page.read_look("without_yielding"))
    top = 1.04 * min(float(elastic.max()), max_elastic_moments * factor * float(table.moment.max()))
    axes.set(xlim=(0.0, x[-1]), ylim=(0.0, top))
    axes.set(xlabel=CURVATURE.label("Curvature"), ylabel=MOMENT.label("Bending moment"))
    _fade_beyond(axes, table.doubtful_curvature, table.curvature[-1])


def _split_moment(table: WireTable) -> dict[str, Floats]:
    """Return the parts of the moment in N m by the name of their look, from the bottom up."""
    return {
        "moment_of_insulation": table.insulation,
        "moment_of_bent_strands": table.bending + table.plastic,
        "moment_of_slipping_strands": table.slip,
        "moment_of_sticking_strands": table.stick,
    }


def _stack(axes: Axes, x: Floats, parts: Mapping[str, Floats]) -> None:
    floor = np.zeros(len(x))
    for name, part in parts.items():
        axes.fill_between(x, floor, floor + part, **figure_page.read_look(name))
        floor = floor + part


def draw_cantilever(table: WireTable) -> Figure:
    """Draw the end load of a cantilever against the deflection of its tip.

    Parameters
    ----------
    table : of the wire; without a curve of end loads the page says so

    Returns
    -------
    A page with the curve and two straight lines, force = 3 EI deflection / length^3, with the
    stiffness of all strands sticking and of all slipping without friction.
    """
    headroom = 1.08
    note = " ".join([_describe_cantilever(table), join_warnings(table)]).strip()
    if len(table.tip_deflection) < 2:  # the state at rest alone
        return figure_page.make_empty_page(
            write_wire_title(table), format_sentence("report.no_end_loads"), note
        )
    page = figure_page.make_page(height_mm=70.0)
    axes = page.subplots()
    x, y = LENGTH.factor * table.tip_deflection, FORCE.factor * table.tip_force
    axes.plot(x, y, **figure_page.read_look("cantilever"))
    ends = np.array([0.0, table.tip_deflection[-1]])
    for stiffness, name in (
        (table.stick_stiffness, "cantilever_all_stick"),
        (table.slip_stiffness, "cantilever_all_slip"),
    ):
        force = FORCE.factor * 3.0 * stiffness / table.spec.length**3 * ends
        axes.plot(LENGTH.factor * ends, force, **figure_page.read_look(name))
    axes.set(xlim=(0.0, x[-1]), ylim=(0.0, headroom * float(np.max(y))))
    axes.set(xlabel=LENGTH.label("Tip deflection"), ylabel=FORCE.label("End load"))
    _fade_beyond(axes, LENGTH.factor * table.doubtful_deflection, float(x[-1]))
    return figure_page.add_title(page, write_wire_title(table), note)


def _describe_cantilever(table: WireTable) -> str:
    length, rest = LENGTH.factor * table.spec.length, table.rest
    setting = format_sentence("report.cantilever", length=length)
    if rest is None:
        return setting
    sag = format_sentence("report.cantilever_at_rest", force=1e3 * rest.force, sag=1e6 * rest.sag)
    return f"{sag} {setting}"


def draw_wire_comparison(tables: Sequence[WireTable]) -> Figure:
    """Draw secant stiffness and moment of several wires against curvature, a line per wire.

    Parameters
    ----------
    tables : 1 to 12 wires

    Raises
    ------
    ValueError
        If there is no wire, or more than `MAX_WIRES`.
    """
    figure_page.require_room(len(tables), MAX_WIRES, "wires")
    page = figure_page.make_page(height_mm=76.0)
    left, right = page.subplots(1, 2)
    unit = choose_stiffness_unit(tables)
    for table, look in zip(tables, figure_page.choose_line_looks(len(tables)), strict=True):
        style: dict[str, Any] = {**look._asdict(), "label": shorten_name(table)}
        secant, moment = unit.factor * table.secant_stiffness, MOMENT.factor * table.moment
        sure = table.curvature <= table.doubtful_curvature
        for part, opacity in split_doubtful(sure):
            drawn = part & is_curved(table)
            left.plot(table.curvature[drawn], secant[drawn], **style, alpha=opacity)
            right.plot(table.curvature[part], moment[part], **style, alpha=opacity)
    curvatures = np.concatenate([table.curvature[is_curved(table)] for table in tables])
    set_log_axes(left, np.array([curvatures.min(), curvatures.max()]))
    left.set_ylabel(unit.label("Secant bending stiffness"))
    right.set_xlim(left=0.0)
    right.set_ylim(bottom=0.0)
    right.set(xlabel=CURVATURE.label("Curvature"), ylabel=MOMENT.label("Bending moment"))
    left.set_title("secant stiffness", loc="left")
    right.set_title("moment", loc="left")
    return figure_page.add_title(
        page, "Wires compared  ·  wire model", format_sentence("report.wires_compared")
    )


_INVALID_IN_FILE_NAME = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
_WIRE_FIGURES: dict[str, Callable[[WireTable], Figure]] = {
    "stiffness": draw_stiffness,
    "moment": draw_moment,
    "cantilever": draw_cantilever,
}


def list_wire_figures(tables: Sequence[WireTable]) -> Iterator[figure_page.FigureToSave]:
    """List the figures of a sheet of wires.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet

    Yields
    ------
    ``sections-1`` and ``comparison-1`` with the first twelve wires, ``sections-2`` and so on; then
    ``NAME.stiffness``, ``NAME.moment`` and ``NAME.cantilever`` of each wire. A page of a single
    wire has no comparison.
    """
    for number, page_tables in enumerate(figure_page.split_pages(tables, MAX_WIRES), start=1):
        yield figure_page.FigureToSave(f"sections-{number}", partial(draw_sections, page_tables))
        if len(page_tables) > 1:
            yield figure_page.FigureToSave(
                f"comparison-{number}", partial(draw_wire_comparison, page_tables)
            )
    for table in tables:
        names = list_figure_names(table.name)
        for name, draw in zip(names, _WIRE_FIGURES.values(), strict=True):
            yield figure_page.FigureToSave(name, partial(draw, table))


def list_figure_names(name: str) -> list[str]:
    """List the names of the figures of one wire, without file endings.

    Parameters
    ----------
    name : of the wire; letters that file names forbid become ``-``
    """
    stem = _INVALID_IN_FILE_NAME.sub("-", name)
    return [f"{stem}.{kind}" for kind in _WIRE_FIGURES]
