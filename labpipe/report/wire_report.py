"""Make the figures and the workbook of a wire sheet: sections, laws and end loads of wires."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.mechanics.wire.first_loading import interpolate_end_load
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.quality import Severity
from labpipe.records.wire import WireLayout, WireTable
from labpipe.report import plot_records as plots
from labpipe.report import table_records, wording
from labpipe.report.figure_page import choose_line_look, split_pages
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, make_line
from labpipe.report.table_records import Record, Table
from labpipe.report.wording import FORCE_SCALE, LENGTH_SCALE, Scale, format_number

CURVATURE_SCALE = Scale(1.0, "1/m")
MOMENT_SCALE = Scale(1e3, "N·mm")
STIFFNESS_SCALE = Scale(1e6, "N·mm²")
LARGE_STIFFNESS_SCALE = Scale(1.0, "N·m²")

MAX_WIRES = 12
"""Largest number of wires on a page; a reader could not distinguish more lines."""


def choose_stiffness_scale(tables: Sequence[WireTable]) -> Scale:
    """Choose the unit of bending stiffness of a figure: N·mm², or N·m² from 1 N·m² upwards."""
    largest = max(table.stick_stiffness for table in tables)
    return STIFFNESS_SCALE if largest < 1.0 else LARGE_STIFFNESS_SCALE


def _shorten_name(table: WireTable) -> str:
    """Shorten the name of a wire so that other texts fit into the same line."""
    return wording.shorten(" ".join(table.name.split()), 24)


def describe_strands(table: WireTable) -> str:
    """Describe the number and the diameter of the strands, such as ``19 × 0.24 mm``.

    Neighbouring layers of equal diameter are counted together: a core of 0.3 mm with six strands of
    0.25 mm is ``1 × 0.3 + 6 × 0.25 mm``.
    """
    spec = table.spec
    diameters = [f"{LENGTH_SCALE.factor * diameter:.3g}" for diameter in spec.strand_diameters]
    layers = zip(diameters, spec.layer_counts, strict=True)
    runs = groupby(layers, key=lambda layer: layer[0])
    texts = [f"{sum(count for _, count in run)} \u00d7 {diameter}" for diameter, run in runs]
    return f"{' + '.join(texts)} {LENGTH_SCALE.unit}"


def join_warnings(table: WireTable) -> str:
    """Join the warnings and errors among the notes of a wire as sentences."""
    return wording.join_sentences(
        note for note in table.notes if note.severity is not Severity.INFO
    )


def flag_bent_rows(table: WireTable) -> Flags:
    """Flag the positive curvatures of a table, which a logarithmic axis can show, shape (n,)."""
    return np.asarray(table.curvature > 0.0)


def make_curvature_axis(curvatures: Floats) -> Axis:
    """Make a logarithmic axis between the smallest and the largest curvature, 1/m."""
    low, high = float(np.min(curvatures)), float(np.max(curvatures))
    return Axis("Curvature", CURVATURE_SCALE, low, high, is_log=True)


def make_sections_page(name: str, tables: Sequence[WireTable]) -> Page:
    """Make the page of the cross-sections of up to `MAX_WIRES` wires side by side.

    Parameters
    ----------
    name : file name without its extension
    tables : laws of the wires

    Returns
    -------
    A page with a panel per wire, which shows its strands, a scale bar, the neutral axis of the
    model and the bending stiffness with all strands sticking and all slipping. All panels have the
    same scale if the largest wire is at most 2.5 times as large as the smallest.
    """
    max_size_ratio = 2.5  # with a larger ratio, the smallest section would be hard to read
    sections_per_row, section_mm, text_mm, note_mm = 4, 45.0, 19.0, 8.0
    radii = [table.layout.wire_radius for table in tables]
    has_common_scale = max(radii) <= max_size_ratio * min(radii)
    scale = choose_stiffness_scale(tables)
    panels = [
        make_section_plot(table, max(radii) if has_common_scale else radius, scale)
        for table, radius in zip(tables, radii, strict=True)
    ]
    scale_text = ""
    if len(tables) > 1:
        scale_text = ", all to the same scale" if has_common_scale else ", each to its own scale"
    is_compressed = any(table.layout.kind == "compressed" for table in tables)
    note = format_sentence("report.compressed_strands") if is_compressed else ""
    height = math.ceil(len(tables) / sections_per_row) * (section_mm + text_mm) + note_mm
    width = plots.DOUBLE_COLUMN if len(tables) > 2 else plots.SINGLE_COLUMN
    title = f"Cross-sections of the wire model{scale_text}"
    size: dict[str, Any] = {"height": height, "width": width, "columns": sections_per_row}
    return Page(name, title, panels, note, **size)


def make_section_plot(table: WireTable, max_radius: float, scale: Scale) -> Plot:
    """Make a panel of one cross-section with a scale bar.

    The heading gives the name of the wire, its strands and its bending stiffness.

    Parameters
    ----------
    table : law of the wire
    max_radius : radius of the largest wire that would fit into the panel, m
    scale : display unit of the bending stiffness
    """
    layout, half_width = table.layout, 1.06 * max_radius
    decade = 10.0 ** math.floor(math.log10(LENGTH_SCALE.factor * half_width)) / LENGTH_SCALE.factor
    bar_length = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= half_width)
    bar_height = -1.1 * half_width
    lines = [
        plots.make_circles("insulation_wall", 0.0, 0.0, layout.wire_radius),
        plots.make_circles("bore", 0.0, 0.0, layout.bore_radius),
        *make_strand_lines(layout, table.spec.orientation),
        make_line("neutral_axis", [-half_width, half_width], 0.0),
        make_line("scale_bar", [-half_width, bar_length - half_width], bar_height),
    ]
    if layout.kind == "compressed":
        lines.append(make_line("centroid", *_rotate_centres(layout, table.spec.orientation)))
    bar_text = f"{LENGTH_SCALE.factor * bar_length:g} {LENGTH_SCALE.unit}"
    stick_text = format_number(table.stick_stiffness, None, scale.factor, digits=3).value
    slip_text = format_number(table.slip_stiffness, None, scale.factor, digits=3).value
    diameter = 2.0 * LENGTH_SCALE.factor * layout.wire_radius
    heading = (
        f"{_shorten_name(table)}\n{describe_strands(table)}\n"
        f"{layout.kind}, wire {diameter:.3g} {LENGTH_SCALE.unit}\n"
        f"stick {stick_text}, slip {slip_text} {scale.unit}"
    )
    x = Axis(scale=LENGTH_SCALE, low=-half_width, high=half_width)
    y = Axis(scale=LENGTH_SCALE, low=-1.22 * half_width, high=half_width)
    labels = [Label(bar_text, bar_length - 0.95 * half_width, bar_height)]
    return Plot(x, y, lines, heading, labels, is_to_scale=True, has_frame=False)


def make_strand_lines(layout: WireLayout, orientation: float = 0.0) -> Iterator[Line]:
    """Yield the outlines of the strands of each layer; the neutral axis is the x axis.

    Parameters
    ----------
    layout : layout of the strands
    orientation : angle by which the section is rotated, rad

    Yields
    ------
    A line per layer, with a circle per strand. Compressed strands are sectors of rings without
    gaps; each sector has the area of its strand.
    """
    n_points = 91  # on each arc of a sector
    x, y = _rotate_centres(layout, orientation)
    squared_diameters = np.bincount(layout.layer, weights=layout.diameter**2)
    ring_radii = np.sqrt(np.concatenate([[0.0], np.cumsum(squared_diameters)])) / 2.0
    has_core = np.sum(layout.layer == 0) == 1
    for index in range(int(layout.layer.max()) + 1):
        label = "core" if has_core and index == 0 else f"ring {index + (not has_core)}"
        settings: dict[str, Any] = {"facecolor": f"C{index}", "label": label}
        rows = layout.layer == index
        if layout.kind != "compressed":
            radii = layout.diameter[rows] / 2.0
            yield plots.make_circles("strand", x[rows], y[rows], radii, **settings)
            continue
        outlines, radii = [], np.repeat(ring_radii[[index + 1, index]], n_points)
        for angle in np.arctan2(y, x)[rows]:
            arc = angle + np.linspace(-np.pi, np.pi, n_points) / rows.sum()
            angles = np.concatenate([arc, arc[::-1]])
            outlines += [np.stack([radii * np.cos(angles), radii * np.sin(angles)])]
            outlines += [np.full((2, 1), np.nan)]
        yield make_line("strand", *np.hstack(outlines), is_closed=True, **settings)


def _rotate_centres(layout: WireLayout, orientation: float) -> tuple[Floats, Floats]:
    """Compute x and y of the centres of the strands in the rotated section, m."""
    cosine, sine = math.cos(orientation), math.sin(orientation)
    return cosine * layout.x - sine * layout.y, sine * layout.x + cosine * layout.y


def _make_wire_page(
    table: WireTable, kind: str, panels: Sequence[Plot], height: float, note: str = ""
) -> Page:
    """Make a page of one wire, `height` mm high, with its warnings in the footnote."""
    diameter = 2.0 * LENGTH_SCALE.factor * table.layout.wire_radius
    title = (
        f"{_shorten_name(table)}  ·  wire model  ·  {describe_strands(table)}, {table.layout.kind}"
        f"  ·  wire {diameter:.3g} {LENGTH_SCALE.unit}"
    )
    name = f"{_INVALID_IN_FILE_NAME.sub('-', table.name)}.{kind}"
    notes = " ".join(filter(None, [note, join_warnings(table)]))
    return Page(name, title, panels, notes, height=height, width=plots.SINGLE_COLUMN)


def _make_doubtful_areas(limit: float, axis_end: float) -> list[Line]:
    """Make the pale area from a limit of the model to the end of the axis; none beyond the end."""
    return [plots.make_span("doubtful_range", limit, axis_end)] if limit < axis_end else []


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
    headroom = 1.4  # ratio of the top of the panel to the higher limit of the stiffness
    max_overlap = 1.3  # ratio by which secants may exceed this limit without more headroom
    min_label_ratio = 1.35  # below this ratio of the limits, their labels would overlap
    is_bent, scale = flag_bent_rows(table), choose_stiffness_scale([table])
    x, stick, slip = table.curvature[is_bent], table.stick_stiffness, table.slip_stiffness
    moments = (table.lowest_moment, table.highest_moment, table.moment - table.plastic)
    lowest, highest, elastic = (moment[is_bent] / x for moment in moments)
    is_shown = (table.slip_onsets > 0.0) & (table.slip_onsets <= table.curvature[-1])
    onsets = table.slip_onsets[is_shown]
    low = 0.9 * float(np.nanmin([lowest, elastic, table.tangent_stiffness[is_bent]]))
    high = headroom * max(stick, float(np.nanmax(highest)) / max_overlap)
    lines = [
        make_line("secant", x, table.secant_stiffness[is_bent]),
        make_line("tangent", x, table.tangent_stiffness[is_bent]),
        make_line("secant_without_yielding", x, elastic),
        plots.make_area("secant_of_orientations", x, lowest, highest),
        plots.make_horizontal_line("stiffness_limit", stick),
        plots.make_horizontal_line("stiffness_limit", slip),
        *([make_line("onset_of_slip", onsets, 1.06 * low)] if len(onsets) else []),
        *_make_doubtful_areas(table.doubtful_curvature, table.curvature[-1]),
    ]
    stick_text, slip_text = (
        f"all {state}\n{format_number(scale.factor * stiffness, None, digits=4).value}"
        for state, stiffness in (("stick", stick), ("slip", slip))
    )
    label_texts = {stick: stick_text, slip: slip_text}
    if stick < min_label_ratio * slip:
        label_texts = {slip: f"{stick_text}\n{slip_text}"}
    labels = [Label(text, np.inf, y_value, (3.0, 0.0)) for y_value, text in label_texts.items()]
    y = Axis("Bending stiffness", scale, low, high, is_log=True)
    panel = Plot(make_curvature_axis(x), y, lines, labels=labels)
    return _make_wire_page(table, "stiffness", [panel], 76.0)


def make_moment_page(table: WireTable) -> Page:
    """Make the page of the components of the moment against curvature.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    A page with two panels: the stacked components of the moment, and their shares of the moment.
    The curvature of the second panel is logarithmic, which shows how strands begin to slip.
    """
    max_top_ratio = 2.0  # largest ratio of the top of the panel to the largest moment
    is_bent, moment = flag_bent_rows(table), table.moment
    components = {
        "moment_of_insulation": table.insulation,
        "moment_of_bent_strands": table.bending + table.plastic,
        "moment_of_slipping_strands": table.slip,
        "moment_of_sticking_strands": table.stick,
    }
    shares = {look: component[is_bent] / moment[is_bent] for look, component in components.items()}
    x, elastic, end = table.curvature, moment - table.plastic, float(table.curvature[-1])
    top = 1.04 * min(float(elastic.max()), max_top_ratio * float(moment.max()))
    curves = [make_line("total_moment", x, moment), make_line("without_yielding", x, elastic)]
    doubtful_areas = _make_doubtful_areas(table.doubtful_curvature, end)
    x_axis, log_axis = Axis("Curvature", CURVATURE_SCALE, 0.0, end), make_curvature_axis(x[is_bent])
    moment_axis = Axis("Bending moment", MOMENT_SCALE, 0.0, top)
    share_axis = Axis("Share of the moment", Scale(100.0, "%"), 0.0, 1.0)
    moment_lines = [*_stack_areas(x, components), *curves, *doubtful_areas]
    share_lines = [*_stack_areas(x[is_bent], shares), *doubtful_areas]
    moment_plot = Plot(x_axis, moment_axis, moment_lines, "moment")
    share_plot = Plot(log_axis, share_axis, share_lines, "shares of the moment")
    return _make_wire_page(table, "moment", [moment_plot, share_plot], 62.0)


def _stack_areas(x: Floats, heights: Mapping[str, Floats]) -> Iterator[Line]:
    """Yield areas that are stacked from zero upwards; `heights` is keyed by their looks."""
    bottom = np.zeros(len(x))
    for look, height in heights.items():
        yield plots.make_area(look, x, bottom, bottom + height)
        bottom = bottom + height


def make_cantilever_page(table: WireTable) -> Page:
    """Make the page of the end load of a cantilever against the deflection of its tip.

    Parameters
    ----------
    table : law of the wire; without a curve of end loads, the page states the reason

    Returns
    -------
    A page with the curve and two straight lines, force = 3 EI deflection / length^3. EI is the
    stiffness with all strands sticking, or with all slipping without friction.
    """
    headroom = 1.08  # ratio of the top of the panel to the largest end load
    length, state_at_rest = table.spec.length, table.rest
    note = format_sentence("report.cantilever", length=LENGTH_SCALE.factor * length)
    if state_at_rest is not None:
        facts = {"force": 1e3 * state_at_rest.force, "sag": 1e6 * state_at_rest.sag}  # mN, µm
        note = f"{format_sentence('report.cantilever_at_rest', **facts)} {note}"
    if len(table.tip_deflection) < 2:  # the curve has no point but that at rest
        panel = Plot(reason=format_sentence("report.no_end_loads"))
        return _make_wire_page(table, "cantilever", [panel], 40.0, note)
    x, end = table.tip_deflection, float(table.tip_deflection[-1])
    stick_force = 3.0 * end / length**3 * table.stick_stiffness
    slip_force = 3.0 * end / length**3 * table.slip_stiffness
    lines = [
        make_line("cantilever", x, table.tip_force),
        make_line("cantilever_all_stick", [0.0, end], [0.0, stick_force]),
        make_line("cantilever_all_slip", [0.0, end], [0.0, slip_force]),
        *_make_doubtful_areas(table.doubtful_deflection, end),
    ]
    x_axis = Axis("Tip deflection", LENGTH_SCALE, 0.0, end)
    y_axis = Axis("End load", FORCE_SCALE, 0.0, headroom * float(np.max(table.tip_force)))
    return _make_wire_page(table, "cantilever", [Plot(x_axis, y_axis, lines)], 70.0, note)


def make_comparison_page(name: str, tables: Sequence[WireTable]) -> Page:
    """Make the page of the secant stiffness and the moment of several wires, a line per wire.

    Parameters
    ----------
    name : file name without its extension
    tables : laws of at most `MAX_WIRES` wires
    """
    secant_lines, moment_lines = [], []
    for index, table in enumerate(tables):
        settings = {**choose_line_look(index), "label": _shorten_name(table)}
        for rows, opacity in plots.split_doubtful(table.curvature <= table.doubtful_curvature):
            settings["alpha"] = opacity
            x, moment = table.curvature[rows], table.moment[rows]
            moment_lines.append(make_line("wire", x, moment, **settings))
            bent_rows = rows & flag_bent_rows(table)
            x, secant = table.curvature[bent_rows], table.secant_stiffness[bent_rows]
            secant_lines.append(make_line("wire", x, secant, **settings))
    log_axis = make_curvature_axis(np.concatenate([line.x for line in secant_lines]))
    stiffness_axis = Axis("Secant bending stiffness", choose_stiffness_scale(tables), is_log=True)
    x_axis = Axis("Curvature", CURVATURE_SCALE, low=0.0)
    moment_axis = Axis("Bending moment", MOMENT_SCALE, low=0.0)
    panels = [
        Plot(log_axis, stiffness_axis, secant_lines, "secant stiffness"),
        Plot(x_axis, moment_axis, moment_lines, "moment"),
    ]
    title, note = "Wires compared  ·  wire model", format_sentence("report.wires_compared")
    return Page(name, title, panels, note, height=76.0, width=plots.SINGLE_COLUMN)


_INVALID_IN_FILE_NAME = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
"""Pattern of a character that is not valid in the name of a file."""
_WIRE_FIGURES = {
    "stiffness": make_stiffness_page,
    "moment": make_moment_page,
    "cantilever": make_cantilever_page,
}
"""Function that makes a figure of a single wire, keyed by the end of the figure's name."""


def list_wire_figures(tables: Sequence[WireTable]) -> Iterator[Page]:
    """Yield the figures of a wire sheet.

    Parameters
    ----------
    tables : laws of the wires, in the order of the sheet

    Yields
    ------
    ``sections-1`` and ``comparison-1`` of the first `MAX_WIRES` wires, ``sections-2`` and so on of
    further wires; then ``NAME.stiffness``, ``NAME.moment`` and ``NAME.cantilever`` of each wire. A
    single wire has no comparison.
    """
    for index, page_tables in enumerate(split_pages(tables, MAX_WIRES), start=1):
        yield make_sections_page(f"sections-{index}", page_tables)
        if len(page_tables) > 1:
            yield make_comparison_page(f"comparison-{index}", page_tables)
    for table in tables:
        yield from (make_page(table) for make_page in _WIRE_FIGURES.values())


def list_figure_names(name: str) -> list[str]:
    """List the file names of the figures of one wire, without extensions.

    Parameters
    ----------
    name : name of the wire; characters that are invalid in file names become ``-``
    """
    stem = _INVALID_IN_FILE_NAME.sub("-", name)
    return [f"{stem}.{kind}" for kind in _WIRE_FIGURES]


REPORTED_DEFLECTIONS = (5e-3, 10e-3, 20e-3, 30e-3, 40e-3, 50e-3)
"""Deflections of the tip, m, at which the summary gives the end load."""


def compute_orientation_spread(table: WireTable) -> float | None:
    """Compute the largest difference of the moment between orientations of a wire.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    Difference in per cent of the moment at the same curvature; None if all curvatures of the table
    are zero.
    """
    rows = flag_bent_rows(table)
    if not rows.any():
        return None
    spread = (table.highest_moment - table.lowest_moment)[rows] / table.moment[rows]
    return 100.0 * float(np.max(spread))


def choose_law_rows(table: WireTable, max_rows: int) -> Ints:
    """Choose the rows of the law of a wire that the sheet of laws shows.

    Parameters
    ----------
    table : law of the wire
    max_rows : largest number of rows, at least 2

    Returns
    -------
    Sorted indices of rows. All rows are chosen if there are at most `max_rows`, or if no moment is
    positive. Otherwise, the first row, of zero curvature, and those that preserve the shape of the
    law are chosen with `find_shape_samples`. The shape is that of the logarithms, so that the first
    slips have as much weight as the end of the law.
    """
    n_rows = len(table.curvature)
    usable_rows = np.flatnonzero(flag_bent_rows(table) & (table.moment > 0.0))
    if n_rows <= max_rows or not len(usable_rows):
        return np.arange(n_rows, dtype=np.int64)
    x, y = np.log(table.curvature[usable_rows]), np.log(table.moment[usable_rows])
    rows = usable_rows[plots.find_shape_samples(x, y, max_points=max_rows - 1, tolerance=0.0)]
    return np.union1d([0], rows).astype(np.int64)


def compute_row_error(table: WireTable, rows: Ints) -> float:
    """Compute the largest error of linear interpolation between rows of a law.

    Parameters
    ----------
    table : law of the wire
    rows : shape (n,), indices of the rows

    Returns
    -------
    Error in per cent of the moment at the same curvature.
    """
    is_bent = flag_bent_rows(table)
    interpolated = np.interp(table.curvature, table.curvature[rows], table.moment[rows])
    error = np.abs(interpolated - table.moment)[is_bent] / np.abs(table.moment[is_bent])
    return 100.0 * float(np.max(error, initial=0.0))


def make_summary_record(table: WireTable) -> Record:
    """Make the cells of a wire in the summary, except its name; a cell without a value is None."""
    spec, layout, curvature = table.spec, table.layout, float(table.curvature[-1])
    area = LENGTH_SCALE.factor**2 * float(np.sum(np.pi / 4.0 * layout.diameter**2))
    factor, rest, deflection = STIFFNESS_SCALE.factor, table.rest, table.tip_deflection
    doubtful_curvature, doubtful_share = None, None
    if table.is_doubtful.any():
        doubtful_curvature = table.doubtful_curvature
        share = np.interp(doubtful_curvature, table.curvature, table.insulation_share)
        doubtful_share = 100.0 * float(share)
    tip_texts = (f"{LENGTH_SCALE.factor * tip:g}" for tip in REPORTED_DEFLECTIONS)
    end_load_headings = [FORCE_SCALE.label(f"end load at {text} mm") for text in tip_texts]
    end_loads = FORCE_SCALE.factor * interpolate_end_load(table, np.array(REPORTED_DEFLECTIONS))
    is_end_doubtful = len(deflection) > 0 and table.doubtful_deflection < deflection[-1]
    return {
        "strands": len(layout.layer),
        "layers": " + ".join(map(str, spec.layer_counts)),
        "lay angles (deg)": "; ".join(f"{angle:.4g}" for angle in np.degrees(spec.lay_angles)),
        "layout": layout.kind,
        "wire diameter (mm)": 2.0 * LENGTH_SCALE.factor * layout.wire_radius,
        "bore diameter (mm)": 2.0 * LENGTH_SCALE.factor * layout.bore_radius,
        "thinnest strand (mm)": LENGTH_SCALE.factor * min(layout.diameter),
        "thickest strand (mm)": LENGTH_SCALE.factor * max(layout.diameter),
        "conductor area (mm²)": area,
        "stick stiffness (N·mm²)": factor * table.stick_stiffness,
        "slip stiffness (N·mm²)": factor * table.slip_stiffness,
        "first slip (1/m)": table.find_slip_onset(0),
        "last slip (1/m)": table.find_slip_onset(-1),
        "range, curvature (1/m)": curvature,
        "range, bending radius (mm)": LENGTH_SCALE.factor / curvature,
        "doubtful beyond, curvature (1/m)": doubtful_curvature,
        "insulation's share there (%)": doubtful_share,
        "insulation's share at the end (%)": 100.0 * float(table.insulation_share[-1]),
        "moment at the end (N·mm)": MOMENT_SCALE.factor * float(table.moment[-1]),
        "secant stiffness at the end (N·mm²)": factor * float(table.secant_stiffness[-1]),
        "tangent stiffness at the end (N·mm²)": factor * float(table.tangent_stiffness[-1]),
        "spread over orientations, largest (%)": compute_orientation_spread(table),
        "axial stiffness, without rotation (N)": table.axial_stiffness,
        "torsional stiffness, fixed length (N·mm²)": factor * table.torsional_stiffness,
        "torsional stiffness, free length (N·mm²)": factor * table.free_torsional_stiffness,
        "coupling of stretch and twist (N·mm)": MOMENT_SCALE.factor * table.stretch_twist_coupling,
        "mass per length (g/m)": 1e3 * table.mass_per_length,
        "sag at rest (mm)": None if rest is None else LENGTH_SCALE.factor * rest.sag,
        "force at the tip at rest (mN)": None if rest is None else 1e3 * rest.force,
        "cantilever length (mm)": LENGTH_SCALE.factor * spec.length,
        "doubtful beyond, deflection (mm)": (
            LENGTH_SCALE.factor * table.doubtful_deflection if is_end_doubtful else None
        ),
        **dict(zip(end_load_headings, end_loads.tolist(), strict=True)),
        "warnings": join_warnings(table),
        "defaults used": "; ".join(spec.defaults.values()),
    }


_LAW_COLUMNS: tuple[tuple[str, str, Scale], ...] = (
    ("curvature", "curvature", CURVATURE_SCALE),
    ("moment", "moment", MOMENT_SCALE),
    ("of sticking strands", "stick", MOMENT_SCALE),
    ("of slipping strands", "slip", MOMENT_SCALE),
    ("of the strands' own bending", "bending", MOMENT_SCALE),
    ("lost to yielding", "plastic", MOMENT_SCALE),
    ("of the insulation", "insulation", MOMENT_SCALE),
    ("secant stiffness", "secant_stiffness", STIFFNESS_SCALE),
    ("tangent stiffness", "tangent_stiffness", STIFFNESS_SCALE),
    ("lowest moment of all orientations", "lowest_moment", MOMENT_SCALE),
    ("highest moment of all orientations", "highest_moment", MOMENT_SCALE),
    ("share of the insulation", "insulation_share", Scale(100.0, "%")),
)
"""Heading without a unit, field of `WireTable`, and scale of each column of the laws."""


def save_wire_workbook(
    tables: Sequence[WireTable],
    path: Path,
    *,
    refusals: Mapping[str, str] | None = None,
    stress_tables: Mapping[str, str] | None = None,
) -> None:
    """Write the workbook of a wire sheet as an xlsx file.

    Parameters
    ----------
    tables : laws of the wires, in the order of the wire sheet
    path : path of the file
    refusals : reason why a wire has no law, keyed by the name of the wire
    stress_tables : description of the stress tables of a wire, keyed by the name of the wire

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    With many wires, the sheet of laws shows only some rows of each law: 12 000 rows in total, but
    at least 40 rows of each law. The summary gives the number of rows shown and the error of linear
    interpolation between them.
    """
    sheets = _list_tables(tables, refusals or {}, stress_tables or {})
    table_records.save_tables(sheets, path, book="wires", title="Laws of wires")


def _list_tables(
    tables: Sequence[WireTable], refusals: Mapping[str, str], stress_tables: Mapping[str, str]
) -> Iterator[Table]:
    """Yield the sheets of a workbook; see `save_wire_workbook`."""
    max_law_rows = 12_000  # for all wires; writing more rows takes longer than the computation
    min_law_rows = 40  # for each wire; the error of linear interpolation is then below 1 %
    max_rows = max(max_law_rows // max(len(tables), 1), min_law_rows)
    law_rows = [choose_law_rows(table, max_rows) for table in tables]
    laws = _tabulate_laws(tables, law_rows)
    law_wires = [row[0] for row in laws.rows]
    warnings = {name: f"not modelled: {reason}" for name, reason in refusals.items()}
    records: list[Record] = [{"wire": name, "warnings": text} for name, text in warnings.items()]
    for table, rows in zip(tables, law_rows, strict=True):
        link = f"'laws'!A{law_wires.index(table.name) + 2}"
        records.append({
            "wire": table_records.Cell(table.name, link=link),
            **make_summary_record(table),
            "rows of the law": len(table.curvature),
            "rows shown": len(rows),
            "error between the rows shown, largest (% of moment)": compute_row_error(table, rows),
            "stress tables": stress_tables.get(table.name),
        })  # fmt: skip
    # only the records of wires with a law, which are last, have all headings
    headings = dict.fromkeys(heading for record in reversed(records) for heading in record)
    yield table_records.tabulate("wires", records, headings)
    yield laws
    yield _tabulate_cantilevers(tables)
    yield table_records.tabulate("notes", _list_notes(tables, refusals))


def _tabulate_laws(tables: Sequence[WireTable], law_rows: Sequence[Ints]) -> Table:
    """Make the sheet of the laws of all wires; its charts omit the point at zero curvature."""
    records_by_wire = {}
    for table, rows in zip(tables, law_rows, strict=True):
        columns = {
            scale.label(label): scale.factor * getattr(table, field)[rows]
            for label, field, scale in _LAW_COLUMNS
        }
        records_by_wire[table.name] = _make_law_records(table, columns, table.is_doubtful[rows])
    names = [scale.label(label) for label, _, scale in _LAW_COLUMNS]
    charted_columns = names[0], STIFFNESS_SCALE.label("secant stiffness"), names[1]
    headings = ["wire", *names, "doubtful"]
    return table_records.tabulate_curves(
        "laws", [("", records_by_wire)], *charted_columns, headings=headings, start=1, is_log=True
    )


def _tabulate_cantilevers(tables: Sequence[WireTable]) -> Table:
    """Make the sheet of end loads against deflection, with a chart."""
    headings = LENGTH_SCALE.label("tip deflection"), FORCE_SCALE.label("end load")
    records_by_wire = {}
    for table in tables:
        x, y = LENGTH_SCALE.factor * table.tip_deflection, FORCE_SCALE.factor * table.tip_force
        is_doubtful = table.tip_deflection > table.doubtful_deflection
        columns = dict(zip(headings, (x, y), strict=True))
        records_by_wire[table.name] = _make_law_records(table, columns, is_doubtful)
    return table_records.tabulate_curves("cantilevers", [("", records_by_wire)], *headings)


def _make_law_records(
    table: WireTable, columns: Mapping[str, Floats], is_doubtful: Flags
) -> list[Record]:
    """Make the records of a curve of a wire, with the mark ``yes`` where the model is doubtful."""
    records = table_records.make_records({"wire": table.name}, columns)
    marks = ("yes" if flag else None for flag in is_doubtful.tolist())
    return [record | {"doubtful": mark} for record, mark in zip(records, marks, strict=True)]


def _list_notes(tables: Sequence[WireTable], refusals: Mapping[str, str]) -> list[Record]:
    """List the records of the refusals and of the notes of all wires."""
    records: list[Record] = [
        {"wire": name, "kind": "not modelled", "where": "", "what": reason, "code": "refused"}
        for name, reason in refusals.items()
    ]
    notes = ((table.name, note) for table in tables for note in table.notes)
    return records + table_records.make_note_records("wire", notes)
