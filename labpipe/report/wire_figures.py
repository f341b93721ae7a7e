"""Figures of a sheet of wires: stiffness, moment, cantilever and comparison."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from labpipe.report.figure_page import (
    PageTexts,
    area_key,
    keyed_page,
    label_log_axis,
    line_key,
    line_looks,
    panel_letter,
    require_room,
    split_pages,
    write_reason,
)
from labpipe.report.plot_thinning import split_doubtful
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wire_sections import (
    CURVATURE,
    FORCE,
    LENGTH,
    MAX_WIRES,
    MOMENT,
    is_bent,
    section_figure,
    set_log_axes,
    short_name,
    stiffness_scale,
    warnings_of,
    wire_title,
)
from labpipe.report.wording import Scale, write_number

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SECANT: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.5, "zorder": 4}
_TANGENT: dict[str, Any] = {
    "color": "#D55E00", "linewidth": 1.2, "linestyle": (0, (5, 1.5)), "zorder": 3
}  # fmt: skip
_UNYIELDING: dict[str, Any] = {
    "color": "#0072B2", "linewidth": 0.8, "linestyle": (0, (1, 1.4)), "zorder": 3
}  # fmt: skip
_SPREAD: dict[str, Any] = {"color": "#56B4E9", "alpha": 0.45, "linewidth": 0, "zorder": 1}
_LIMIT: dict[str, Any] = {
    "color": "black", "linewidth": 0.6, "linestyle": (0, (5, 1.5, 1.2, 1.5)), "zorder": 2
}  # fmt: skip
_ONSET: dict[str, Any] = {
    "color": "black", "marker": "|", "markersize": 8.0, "linestyle": "", "zorder": 5
}  # fmt: skip
_WHOLE: dict[str, Any] = {"color": "black", "linewidth": 1.2, "zorder": 4}
_ELASTIC: dict[str, Any] = {
    "color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.4)), "zorder": 3
}  # fmt: skip
_LIGHTER: dict[str, Any] = {"facecolor": "white", "alpha": 0.6, "linewidth": 0, "zorder": 6}
"""Drawn over doubtful parts, beyond the linear range of the insulation."""
_PARTS = (
    ("insulation", "#c8c8c8", ""),
    ("strands' own bending", "#E69F00", "\\\\\\\\"),
    ("slipping strands", "#56B4E9", "////"),
    ("sticking strands", "#0072B2", ""),
)
"""Parts of a moment from the bottom of the stack: name, colour, hatch."""


def stiffness_figure(table: WireTable) -> Figure:
    """Draw secant and tangent stiffness against curvature, both axes logarithmic.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with the limits for sticking strands and for slip without friction, the curvatures at
    which strands begin to slip, and the spread of the secant stiffness over all orientations.
    """
    texts = PageTexts(wire_title(table), warnings_of(table), _stiffness_keys(table))
    page = keyed_page(texts, height_mm=76.0)
    plot_stiffness(table, page.subplots())
    return page


def plot_stiffness(table: WireTable, axes: Axes) -> None:
    """Draw the stiffnesses of one wire.

    Parameters
    ----------
    table : without the point at zero curvature
    axes : to draw on
    """
    use = is_bent(table)
    across, unit = table.curvature[use], stiffness_scale([table])
    up = unit.factor
    lowest, highest = (
        up * moment[use] / across for moment in (table.lowest_moment, table.highest_moment)
    )
    axes.fill_between(across, lowest, highest, **_SPREAD)
    axes.plot(across, up * (table.moment - table.plastic)[use] / across, **_UNYIELDING)
    axes.plot(across, up * table.tangent_stiffness[use], **_TANGENT)
    axes.plot(across, up * table.secant_stiffness[use], **_SECANT)
    axes.set_yscale("log")
    _mark_limits(table, axes, unit)
    set_log_axes(axes, across)
    axes.set_ylabel(unit.label("Bending stiffness"))
    _mark_onsets(table, axes)
    _shade_doubtful(table, axes)


def _shade_doubtful(table: WireTable, axes: Axes) -> None:
    if table.is_doubtful.any():
        _shade(axes, table.doubtful_curvature, float(table.curvature[-1]))


def _shade(axes: Axes, start: float, stop: float) -> None:
    """Draw a doubtful range lighter, but not the frame."""
    axes.axvspan(start, stop, **_LIGHTER)
    for spine in axes.spines.values():
        spine.set_zorder(_LIGHTER["zorder"] + 1)


def _mark_limits(table: WireTable, axes: Axes, unit: Scale) -> None:
    """Draw both limits as lines across the panel, with labels beside it."""
    headroom, label_ratio = 1.4, 1.35
    stick, slip = (unit.factor * value for value in (table.stick_stiffness, table.slip_stiffness))
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, headroom * stick))
    names = {stick: f"all stick\n{_digits(stick)}", slip: f"all slip\n{_digits(slip)}"}
    for level in (stick, slip):
        axes.axhline(level, **_LIMIT)
    if stick < label_ratio * slip:
        names = {slip: f"all stick\n{_digits(stick)}\nall slip\n{_digits(slip)}"}
    beside = axes.get_yaxis_transform()
    for level, label in names.items():
        axes.text(1.01, level, label, transform=beside, va="center")


def _digits(value: float) -> str:
    return write_number(value, None, digits=4).value


def _mark_onsets(table: WireTable, axes: Axes) -> None:
    onsets = _shown_onsets(table)
    level = np.full(len(onsets), 0.035)
    axes.plot(onsets, level, transform=axes.get_xaxis_transform(), **_ONSET)


def _shown_onsets(table: WireTable) -> Floats:
    """Return the positive onsets of slip within the range."""
    onsets = table.slip_onsets
    return np.asarray(onsets[(onsets > 0.0) & (onsets <= table.curvature[-1])])


def _stiffness_keys(table: WireTable) -> list[Artist]:
    return [
        line_key("secant", **_SECANT),
        line_key("tangent", **_TANGENT),
        line_key("secant, without yielding", **_UNYIELDING),
        area_key("secant, all orientations", **_SPREAD),
        line_key("limits without yielding", **_LIMIT),
        *([line_key("a strand begins to slip", **_ONSET)] if len(_shown_onsets(table)) else []),
    ]


def moment_figure(table: WireTable) -> Figure:
    """Draw the moment against curvature with its parts, and the shares of the parts.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with two panels: stacked moments against curvature; shares of the moment against
    curvature on a logarithmic axis, which shows the change from stick to slip.
    """
    texts = PageTexts(wire_title(table), warnings_of(table), _moment_keys())
    page = keyed_page(texts, height_mm=62.0)
    left, right = page.subplots(1, 2)
    plot_parts(table, left)
    plot_shares(table, right)
    panel_letter(left, "a", "moment")
    panel_letter(right, "b", "shares of the moment")
    return page


def plot_parts(table: WireTable, axes: Axes) -> None:
    """Stack the parts of the moment; a dotted line is the moment without yielding.

    Parameters
    ----------
    table : of the wire; the loss by yielding is subtracted from the strands' own bending
    axes : to draw on
    """
    max_elastic_moments = 2.0  # top of the panel, in largest moments
    across, up = table.curvature, MOMENT.factor
    _stack(axes, across, [up * part for part in moment_parts(table)])
    axes.plot(across, up * table.moment, **_WHOLE)
    elastic = up * (table.moment - table.plastic)
    axes.plot(across, elastic, **_ELASTIC)
    top = 1.04 * min(float(elastic.max()), max_elastic_moments * up * float(table.moment.max()))
    axes.set_xlim(0.0, across[-1])
    axes.set_ylim(0.0, top)
    axes.set_xlabel(CURVATURE.label("Curvature"))
    axes.set_ylabel(MOMENT.label("Bending moment"))
    _shade_doubtful(table, axes)


def plot_shares(table: WireTable, axes: Axes) -> None:
    """Stack the parts as percentages of the moment against the logarithm of the curvature.

    Parameters
    ----------
    table : the point at zero curvature is left out
    axes : to draw on
    """
    use = is_bent(table)
    across = table.curvature[use]
    _stack(axes, across, [100.0 * part[use] / table.moment[use] for part in moment_parts(table)])
    axes.set_xscale("log")
    axes.set_xlim(across[0], across[-1])
    label_log_axis(axes.xaxis)
    axes.set_ylim(0.0, 100.0)
    axes.set_xlabel(CURVATURE.label("Curvature"))
    axes.set_ylabel("Share of the moment (%)")
    _shade_doubtful(table, axes)


def moment_parts(table: WireTable) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the moments of insulation, yielding strands, slipping and sticking strands, N m."""
    return table.insulation, table.bending + table.plastic, table.slip, table.stick


def _stack(axes: Axes, across: Floats, parts: Sequence[Floats]) -> None:
    floor = np.zeros(len(across))
    for part, (_, colour, hatch) in zip(parts, _PARTS, strict=True):
        axes.fill_between(across, floor, floor + part, **_part_style(colour, hatch))
        floor = floor + part


def _part_style(colour: str, hatch: str) -> dict[str, Any]:
    return {"facecolor": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0.0}


def _moment_keys() -> list[Artist]:
    return [
        *(area_key(name, **_part_style(colour, hatch)) for name, colour, hatch in reversed(_PARTS)),
        line_key("total moment", **_WHOLE),
        line_key("without yielding", **_ELASTIC),
    ]


_CURVE: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.5, "zorder": 3}
_STICK: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.4))}
_SLIP: dict[str, Any] = {"color": "black", "linewidth": 0.6, "linestyle": (0, (5, 1.5, 1.2, 1.5))}


def cantilever_figure(table: WireTable) -> Figure:
    """Draw the end load against the deflection of the tip.

    Parameters
    ----------
    table : without a cantilever curve the page says so

    Returns
    -------
    A page with the curve and the two straight lines of small deflections: all strands stick, all
    slip without friction.
    """
    note = " ".join([*_setting_note(table), warnings_of(table)]).strip()
    if len(table.tip_deflection) < 2:  # rest alone
        page = keyed_page(PageTexts(wire_title(table), note), height_mm=40.0)
        write_reason(page.subplots(), "There is no cantilever curve to draw.")
        return page
    page = keyed_page(PageTexts(wire_title(table), note, _keys()), height_mm=70.0)
    plot_cantilever(table, page.subplots())
    return page


def plot_cantilever(table: WireTable, axes: Axes) -> None:
    """Draw the curve, and the straight lines of small deflections.

    Parameters
    ----------
    table : with a cantilever curve
    axes : to draw on

    Notes
    -----
    The straight lines are force = 3 EI deflection / length^3.
    """
    margin_factor = 1.08
    across, up = LENGTH.factor * table.tip_deflection, FORCE.factor * table.tip_force
    ends = np.array([0.0, table.tip_deflection[-1]])
    for stiffness, look in ((table.stick_stiffness, _STICK), (table.slip_stiffness, _SLIP)):
        force = 3.0 * stiffness / table.spec.length**3 * ends
        axes.plot(LENGTH.factor * ends, FORCE.factor * force, **look)
    axes.plot(across, up, **_CURVE)
    axes.set_xlim(0.0, across[-1])
    axes.set_ylim(0.0, margin_factor * float(np.max(up)))
    axes.set_xlabel(LENGTH.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("End load"))
    if table.doubtful_deflection < table.tip_deflection[-1]:
        _shade(axes, LENGTH.factor * table.doubtful_deflection, float(across[-1]))


def _setting_note(table: WireTable) -> list[str]:
    length = LENGTH.factor * table.spec.length
    return [
        f"Free length {length:.4g} {LENGTH.unit}, first loading; the load stays normal to the"
        f" clamped axis. {_rest_words(table)}Straight lines: the limits without yielding,"
        " 3\u00a0EI\u00a0/\u00a0length³."
    ]


def _rest_words(table: WireTable) -> str:
    rest = table.rest
    if rest is None:
        return ""
    return f"From rest: tip held by {1e3 * rest.force:.3g} mN, sag {1e6 * rest.sag:.3g} µm. "


def _keys() -> list[Artist]:
    return [
        line_key("wire model", **_CURVE),
        line_key("straight line, all stick", **_STICK),
        line_key("straight line, all slip", **_SLIP),
    ]


_RANGES = (
    "Each line ends with the range of its law, and is lighter where the strain at the rim of the"
    " insulation exceeds its assumed linear range."
)


def comparison_figure(tables: Sequence[WireTable]) -> Figure:
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
    texts = PageTexts("Wires compared  ·  wire model", _RANGES, _wire_keys(tables))
    page = keyed_page(texts, height_mm=76.0)
    left, right = page.subplots(1, 2)
    unit = stiffness_scale(tables)
    for table, look in zip(tables, line_looks(len(tables)), strict=True):
        style: dict[str, Any] = {"color": look.colour, "linestyle": look.dash}
        secant, moment = unit.factor * table.secant_stiffness, MOMENT.factor * table.moment
        sure = table.curvature <= table.doubtful_curvature
        for use, fade in split_doubtful(sure):
            drawn = use & is_bent(table)
            left.plot(table.curvature[drawn], secant[drawn], **style, alpha=fade)
            right.plot(table.curvature[use], moment[use], **style, alpha=fade)
    set_log_axes(left, _shared_range(tables))
    left.set_ylabel(unit.label("Secant bending stiffness"))
    right.set_xlim(left=0.0)
    right.set_ylim(bottom=0.0)
    right.set_xlabel(CURVATURE.label("Curvature"))
    right.set_ylabel(MOMENT.label("Bending moment"))
    panel_letter(left, "a", "secant stiffness")
    panel_letter(right, "b", "moment")
    return page


def _shared_range(tables: Sequence[WireTable]) -> Floats:
    """Return the smallest and the largest curvature of all wires, 1/m."""
    curvatures = [table.curvature[is_bent(table)] for table in tables]
    return np.array(
        [
            min(curvature[0] for curvature in curvatures),
            max(curvature[-1] for curvature in curvatures),
        ]
    )


def _wire_keys(tables: Sequence[WireTable]) -> list[Artist]:
    return [
        line_key(short_name(table), color=look.colour, linestyle=look.dash)
        for table, look in zip(tables, line_looks(len(tables)), strict=True)
    ]


_INVALID_IN_FILE_NAME = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
_WIRE_FIGURES: dict[str, Callable[[WireTable], Figure]] = {
    "stiffness": stiffness_figure,
    "moment": moment_figure,
    "cantilever": cantilever_figure,
}


def wire_drawings(tables: Sequence[WireTable]) -> Iterator[FigureToSave]:
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
        yield FigureToSave(f"sections-{number}", partial(section_figure, page_tables))
        if len(page_tables) > 1:
            yield FigureToSave(f"comparison-{number}", partial(comparison_figure, page_tables))
    for table in tables:
        names = figure_names(table.name)
        for name, draw in zip(names, _WIRE_FIGURES.values(), strict=True):
            yield FigureToSave(name, partial(draw, table))


def figure_names(name: str) -> list[str]:
    """Return the names of the figures of one wire, without endings.

    Parameters
    ----------
    name : of the wire
    """
    stem = _INVALID_IN_FILE_NAME.sub("-", name)
    return [f"{stem}.{figure_kind}" for figure_kind in _WIRE_FIGURES]


def save_wire_figures(
    tables: Sequence[WireTable],
    folder: Path,
    *,
    say: Callable[[str], None] = lambda _: None,
    png: bool = False,
) -> list[Path]:
    """Draw the figures of a sheet of wires, each as SVG.

    Parameters
    ----------
    tables : of the wires, in the order of the sheet
    folder : made if it is not there
    say : called with the name of each figure as it is drawn
    png : each as PNG, too

    Returns
    -------
    The files, in the order of `wire_drawings`.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same tables give the same bytes with the same version of matplotlib.
    """
    return save_pages(
        wire_drawings(tables),
        folder,
        what="figures of wires",
        again="run the model",
        say=say,
        png=png,
    )
