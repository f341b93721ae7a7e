"""Make the figures of a wire sheet: sections, stiffness, moment and end load of modelled wires."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats
from labpipe.records.quality import Severity
from labpipe.records.wire import WireLayout, WireTable
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import choose_line_look, split_pages
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, line
from labpipe.report.wording import Scale, shorten, write_number

CURVATURE = Scale(1.0, "1/m")
LENGTH_SCALE = Scale(1e3, "mm")
MOMENT = Scale(1e3, "N·mm")
STIFFNESS_SCALE = Scale(1e6, "N·mm²")
_LARGE_STIFFNESS = Scale(1.0, "N·m²")
FORCE = Scale(1.0, "N")

MAX_WIRES = 12
"""Largest number of wires on a page that a reader can distinguish."""


def choose_stiffness_unit(tables: Sequence[WireTable]) -> Scale:
    """Choose the unit of bending stiffness of a figure: N·mm², or N·m² from 1 N·m² upwards."""
    largest = max(table.stick_stiffness for table in tables)
    return STIFFNESS_SCALE if largest < 1.0 else _LARGE_STIFFNESS


def _shorten_name(table: WireTable) -> str:
    """Shorten the name of a wire for a line with other texts."""
    return shorten(" ".join(table.name.split()), 24)


def describe_strands(table: WireTable) -> str:
    """Write the number and the diameter of the strands, such as ``19 × 0.24 mm``.

    Neighbouring layers of one diameter are counted together: a core of 0.3 mm with six strands of
    0.25 mm is ``1 × 0.3 + 6 × 0.25 mm``.
    """
    spec = table.spec
    sizes = [f"{LENGTH_SCALE.factor * diameter:.3g}" for diameter in spec.strand_diameters]
    layers = groupby(zip(sizes, spec.layer_counts, strict=True), key=lambda layer: layer[0])
    parts = [f"{sum(count for _, count in group)} \u00d7 {size}" for size, group in layers]
    return f"{' + '.join(parts)} {LENGTH_SCALE.unit}"


def join_warnings(table: WireTable) -> str:
    """Join the warnings and errors among the notes of a wire as sentences."""
    messages = [note.message for note in table.notes if note.severity is not Severity.INFO]
    return " ".join(f"{note[0].upper()}{note[1:].rstrip('.')}." for note in messages)


def is_curved(table: WireTable) -> Flags:
    """Return whether each curvature of a table is positive, as on a logarithmic axis, (n,)."""
    return np.asarray(table.curvature > 0.0)


def make_curvature_axis(curvatures: Floats) -> Axis:
    """Make a logarithmic axis between the smallest and the largest curvature, 1/m."""
    low, high = float(np.min(curvatures)), float(np.max(curvatures))
    return Axis("Curvature", CURVATURE, low, high, is_log=True)


def make_sections_page(name: str, tables: Sequence[WireTable]) -> Page:
    """Make the page of the cross-sections of up to `MAX_WIRES` wires side by side.

    Parameters
    ----------
    name : file name without the ending
    tables : laws of the wires

    Returns
    -------
    A panel per wire with its strands, a scale bar, the neutral axis of the model and the bending
    stiffness with all strands sticking and all slipping. All panels have one scale if the largest
    wire is at most 2.5 times the smallest, else each has its own.
    """
    sections_per_row, cell_mm, text_mm, max_size_ratio = 4, 45.0, 19.0, 2.5
    radii = [table.layout.wire_radius for table in tables]
    has_common_scale = max(radii) <= max_size_ratio * min(radii)
    unit = choose_stiffness_unit(tables)
    panels = [
        make_section_plot(table, max(radii) if has_common_scale else radius, unit)
        for table, radius in zip(tables, radii, strict=True)
    ]
    scale = ""
    if len(tables) > 1:
        scale = ", all to the same scale" if has_common_scale else ", each to its own scale"
    is_compressed = any(table.layout.kind == "compressed" for table in tables)
    return Page(
        name,
        f"Cross-sections of the wire model{scale}",
        panels,
        format_sentence("report.compressed_strands") if is_compressed else "",
        math.ceil(len(tables) / sections_per_row) * (cell_mm + text_mm) + 8.0,
        plots.DOUBLE_COLUMN if len(tables) > 2 else plots.SINGLE_COLUMN,
        sections_per_row,
    )


def make_section_plot(table: WireTable, reach: float, unit: Scale) -> Plot:
    """Make a panel of one cross-section with a scale bar, and its name and numbers as heading.

    Parameters
    ----------
    table : law of the wire
    reach : m, from the axis of the wire to the edge of the panel
    unit : of the bending stiffness
    """
    layout, edge = table.layout, 1.06 * reach
    power = 10.0 ** math.floor(math.log10(LENGTH_SCALE.factor * edge)) / LENGTH_SCALE.factor
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= edge)
    bar_height = -1.1 * edge
    lines = [
        plots.circles("insulation_wall", 0.0, 0.0, layout.wire_radius),
        plots.circles("bore", 0.0, 0.0, layout.bore_radius),
        *plot_strands(layout, table.spec.orientation),
        line("neutral_axis", [-edge, edge], 0.0),
        line("scale_bar", [-edge, length - edge], bar_height),
    ]
    if layout.kind == "compressed":
        lines.append(line("centroid", *_rotate_centres(layout, table.spec.orientation)))
    bar_text = f"{LENGTH_SCALE.factor * length:g} {LENGTH_SCALE.unit}"
    stick, slip = (
        write_number(value, None, unit.factor, digits=3).value
        for value in (table.stick_stiffness, table.slip_stiffness)
    )
    diameter = 2.0 * LENGTH_SCALE.factor * layout.wire_radius
    heading = (
        f"{_shorten_name(table)}\n{describe_strands(table)}\n"
        f"{layout.kind}, wire {diameter:.3g} {LENGTH_SCALE.unit}\n"
        f"stick {stick}, slip {slip} {unit.unit}"
    )
    return Plot(
        Axis(scale=LENGTH_SCALE, low=-edge, high=edge),
        Axis(scale=LENGTH_SCALE, low=-1.22 * edge, high=edge),
        lines,
        heading,
        [Label(bar_text, length - 0.95 * edge, bar_height)],
        is_to_scale=True,
        has_frame=False,
    )


def plot_strands(layout: WireLayout, orientation: float = 0.0) -> Iterator[Line]:
    """Yield the outlines of the strands of each layer; the neutral axis is the x axis.

    Parameters
    ----------
    layout : of the strands
    orientation : rad, by which the section is rotated

    Yields
    ------
    A line per layer, with a circle per strand. Compressed strands are sectors of rings without
    gaps; each sector has the area of its strand.
    """
    x, y = _rotate_centres(layout, orientation)
    areas = np.bincount(layout.layer, weights=layout.diameter**2)
    edges = np.sqrt(np.concatenate([[0.0], np.cumsum(areas)])) / 2.0
    has_core = np.sum(layout.layer == 0) == 1
    for number in range(int(layout.layer.max()) + 1):
        label = "core" if has_core and number == 0 else f"ring {number + (not has_core)}"
        settings: dict[str, Any] = {"facecolor": f"C{number}", "label": label}
        rows = layout.layer == number
        if layout.kind != "compressed":
            yield plots.circles("strand", x[rows], y[rows], layout.diameter[rows] / 2.0, **settings)
            continue
        outlines = []
        for angle in np.arctan2(y, x)[rows]:
            angles = angle + np.linspace(-np.pi, np.pi, 91) / rows.sum()
            radii = np.concatenate([np.full(91, edges[number + 1]), np.full(91, edges[number])])
            angles = np.concatenate([angles, angles[::-1]])
            outlines += [np.stack([radii * np.cos(angles), radii * np.sin(angles)])]
            outlines += [np.full((2, 1), np.nan)]
        yield line("strand", *np.hstack(outlines), is_closed=True, **settings)


def _rotate_centres(layout: WireLayout, orientation: float) -> tuple[Floats, Floats]:
    """Return x and y of the centres of the strands in the rotated section."""
    cosine, sine = math.cos(orientation), math.sin(orientation)
    return cosine * layout.x - sine * layout.y, sine * layout.x + cosine * layout.y


def _make_wire_page(
    table: WireTable, kind: str, panels: Sequence[Plot], height: float, note: str = ""
) -> Page:
    diameter = 2.0 * LENGTH_SCALE.factor * table.layout.wire_radius
    title = (
        f"{_shorten_name(table)}  ·  wire model  ·  {describe_strands(table)}, {table.layout.kind}"
        f"  ·  wire {diameter:.3g} {LENGTH_SCALE.unit}"
    )
    name = f"{_INVALID_IN_FILE_NAME.sub('-', table.name)}.{kind}"
    notes = " ".join(filter(None, [note, join_warnings(table)]))
    return Page(name, title, panels, notes, height, plots.SINGLE_COLUMN)


def _mark_doubtful_range(limit: float, end: float) -> list[Line]:
    """Return a pale area from a limit to the end of a panel, where the model is doubtful."""
    return [plots.span("doubtful_range", limit, end)] if limit < end else []


def make_stiffness_page(table: WireTable) -> Page:
    """Make the page of secant and tangent stiffness against curvature on logarithmic axes.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    A page that also shows the stiffness of all strands sticking and of all slipping without
    friction, the curvatures at which strands begin to slip, and the range of the secant stiffness
    over all orientations of the section.
    """
    headroom = 1.4  # top of the panel over the higher limit
    label_ratio = 1.35  # below this ratio of the limits, their labels would overlap
    is_curved_row, unit = is_curved(table), choose_stiffness_unit([table])
    x, stick, slip = table.curvature[is_curved_row], table.stick_stiffness, table.slip_stiffness
    lowest, highest, elastic = (
        moment[is_curved_row] / x
        for moment in (table.lowest_moment, table.highest_moment, table.moment - table.plastic)
    )
    onsets = table.slip_onsets
    onsets = onsets[(onsets > 0.0) & (onsets <= table.curvature[-1])]
    low = 0.9 * float(np.nanmin([lowest, elastic, table.tangent_stiffness[is_curved_row]]))
    high = headroom * max(stick, float(np.nanmax(highest)) / 1.3)
    lines = [
        line("secant", x, table.secant_stiffness[is_curved_row]),
        line("tangent", x, table.tangent_stiffness[is_curved_row]),
        line("secant_without_yielding", x, elastic),
        plots.area("secant_of_orientations", x, lowest, highest),
        plots.level("stiffness_limit", stick),
        plots.level("stiffness_limit", slip),
        *([line("onset_of_slip", onsets, 1.06 * low)] if len(onsets) else []),
        *_mark_doubtful_range(table.doubtful_curvature, table.curvature[-1]),
    ]
    stick_text, slip_text = (
        f"all {state}\n{write_number(unit.factor * stiffness, None, digits=4).value}"
        for state, stiffness in (("stick", stick), ("slip", slip))
    )
    texts = {stick: stick_text, slip: slip_text}
    if stick < label_ratio * slip:
        texts = {slip: f"{stick_text}\n{slip_text}"}
    labels = [Label(text, np.inf, place, (3.0, 0.0)) for place, text in texts.items()]
    y = Axis("Bending stiffness", unit, low, high, is_log=True)
    panel = Plot(make_curvature_axis(x), y, lines, labels=labels)
    return _make_wire_page(table, "stiffness", [panel], 76.0)


def make_moment_page(table: WireTable) -> Page:
    """Make the page of the moment with its parts against curvature, and the shares of the parts.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    A page with two panels: the stacked parts of the moment, and their shares against curvature on
    a logarithmic axis, which shows how sticking strands begin to slip.
    """
    max_elastic_ratio = 2.0  # top of the panel over the largest moment
    is_curved_row, moment = is_curved(table), table.moment
    parts = {
        "moment_of_insulation": table.insulation,
        "moment_of_bent_strands": table.bending + table.plastic,
        "moment_of_slipping_strands": table.slip,
        "moment_of_sticking_strands": table.stick,
    }
    shares = {name: part[is_curved_row] / moment[is_curved_row] for name, part in parts.items()}
    x, elastic, end = table.curvature, moment - table.plastic, float(table.curvature[-1])
    top = 1.04 * min(float(elastic.max()), max_elastic_ratio * float(moment.max()))
    lines = [line("total_moment", x, moment), line("without_yielding", x, elastic)]
    doubtful_range = _mark_doubtful_range(table.doubtful_curvature, end)
    panels = [
        Plot(
            Axis("Curvature", CURVATURE, 0.0, end),
            Axis("Bending moment", MOMENT, 0.0, top),
            [*_stack(x, parts), *lines, *doubtful_range],
            "moment",
        ),
        Plot(
            make_curvature_axis(x[is_curved_row]),
            Axis("Share of the moment", Scale(100.0, "%"), 0.0, 1.0),
            [*_stack(x[is_curved_row], shares), *doubtful_range],
            "shares of the moment",
        ),
    ]
    return _make_wire_page(table, "moment", panels, 62.0)


def _stack(x: Floats, parts: Mapping[str, Floats]) -> Iterator[Line]:
    """Yield an area for each part, from the bottom up, by the names of their looks."""
    floor = np.zeros(len(x))
    for name, part in parts.items():
        yield plots.area(name, x, floor, floor + part)
        floor = floor + part


def make_cantilever_page(table: WireTable) -> Page:
    """Make the page of the end load of a cantilever against the deflection of its tip.

    Parameters
    ----------
    table : law of the wire; without a curve of end loads, the page states the reason

    Returns
    -------
    A page with the curve and two straight lines, force = 3 EI deflection / length^3, with the
    stiffness of all strands sticking and of all slipping without friction.
    """
    headroom, length, rest = 1.08, table.spec.length, table.rest
    note = format_sentence("report.cantilever", length=LENGTH_SCALE.factor * length)
    if rest is not None:
        force, sag = 1e3 * rest.force, 1e6 * rest.sag
        at_rest = format_sentence("report.cantilever_at_rest", force=force, sag=sag)
        note = f"{at_rest} {note}"
    if len(table.tip_deflection) < 2:  # the state at rest alone
        panel = plots.make_empty_plot(format_sentence("report.no_end_loads"))
        return _make_wire_page(table, "cantilever", [panel], 40.0, note)
    x = table.tip_deflection
    end, slope = float(x[-1]), 3.0 * x[-1] / length**3
    lines = [
        line("cantilever", x, table.tip_force),
        line("cantilever_all_stick", [0.0, end], [0.0, slope * table.stick_stiffness]),
        line("cantilever_all_slip", [0.0, end], [0.0, slope * table.slip_stiffness]),
        *_mark_doubtful_range(table.doubtful_deflection, end),
    ]
    panel = Plot(
        Axis("Tip deflection", LENGTH_SCALE, 0.0, end),
        Axis("End load", FORCE, 0.0, headroom * float(np.max(table.tip_force))),
        lines,
    )
    return _make_wire_page(table, "cantilever", [panel], 70.0, note)


def make_comparison_page(name: str, tables: Sequence[WireTable]) -> Page:
    """Make the page of secant stiffness and moment of several wires, a line per wire.

    Parameters
    ----------
    name : file name without the ending
    tables : laws of at most `MAX_WIRES` wires
    """
    secants, moments = [], []
    for number, table in enumerate(tables):
        settings = {**choose_line_look(number), "label": _shorten_name(table)}
        for part, opacity in plots.split_doubtful(table.curvature <= table.doubtful_curvature):
            is_drawn, settings["alpha"] = part & is_curved(table), opacity
            curvature, secant = table.curvature[is_drawn], table.secant_stiffness[is_drawn]
            secants.append(line("wire", curvature, secant, **settings))
            moments.append(line("wire", table.curvature[part], table.moment[part], **settings))
    x = make_curvature_axis(np.concatenate([secant_line.x for secant_line in secants]))
    stiffness = Axis("Secant bending stiffness", choose_stiffness_unit(tables), is_log=True)
    moment = Axis("Bending moment", MOMENT, low=0.0)
    panels = [
        Plot(x, stiffness, secants, "secant stiffness"),
        Plot(Axis("Curvature", CURVATURE, low=0.0), moment, moments, "moment"),
    ]
    title, note = "Wires compared  ·  wire model", format_sentence("report.wires_compared")
    return Page(name, title, panels, note, 76.0, plots.SINGLE_COLUMN)


_INVALID_IN_FILE_NAME = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
_WIRE_FIGURES = {
    "stiffness": make_stiffness_page,
    "moment": make_moment_page,
    "cantilever": make_cantilever_page,
}


def list_wire_figures(tables: Sequence[WireTable]) -> Iterator[Page]:
    """List the figures of a sheet of wires.

    Parameters
    ----------
    tables : laws of the wires, in the order of the sheet

    Yields
    ------
    ``sections-1`` and ``comparison-1`` with the first twelve wires, ``sections-2`` and so on; then
    ``NAME.stiffness``, ``NAME.moment`` and ``NAME.cantilever`` of each wire. A page of a single
    wire has no comparison.
    """
    for number, page_tables in enumerate(split_pages(tables, MAX_WIRES), start=1):
        yield make_sections_page(f"sections-{number}", page_tables)
        if len(page_tables) > 1:
            yield make_comparison_page(f"comparison-{number}", page_tables)
    for table in tables:
        yield from (make(table) for make in _WIRE_FIGURES.values())


def list_figure_names(name: str) -> list[str]:
    """List the names of the figures of one wire, without file endings.

    Parameters
    ----------
    name : name of the wire; characters that are invalid in file names become ``-``
    """
    stem = _INVALID_IN_FILE_NAME.sub("-", name)
    return [f"{stem}.{kind}" for kind in _WIRE_FIGURES]
