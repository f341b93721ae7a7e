"""The figures of a sheet of wires: stiffness, moment, cantilever, comparison, and saving them."""

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
    in_pages,
    keyed_page,
    line_key,
    line_looks,
    number_log,
    panel_letter,
    require_room,
    say,
)
from labpipe.report.plot_thinning import sure_and_doubtful
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wire_sections import (
    CURVATURE,
    FORCE,
    LENGTH,
    MOMENT,
    MOST_WIRES,
    bent,
    section_figure,
    set_log,
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


_HEIGHT, _PAIR_HEIGHT = 76.0, 62.0
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
"""Laid over what is beyond the range of the insulation's straight line: doubtful."""
_HEADROOM, _TOO_CLOSE = 1.4, 1.35
_MOST_ELASTIC = 2.0
"""How far a panel goes for the line without yielding, in largest moments."""
_PARTS = (
    ("insulation", "#c8c8c8", ""),
    ("strands' own bending", "#E69F00", "\\\\\\\\"),
    ("strands that slip", "#56B4E9", "////"),
    ("strands that stick", "#0072B2", ""),
)
"""What a moment is made of from the bottom of the stack: name, colour, hatch."""


def stiffness_figure(table: WireTable) -> Figure:
    """Draw secant and tangent stiffness against curvature, both axes logarithmic.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with the limits when all strands stick and when all slip without friction, the
    curvatures at which strands begin to slip, and the spread of the secant stiffness over all
    orientations of the section.
    """
    words = PageTexts(wire_title(table), warnings_of(table), _stiffness_keys(table))
    page = keyed_page(words, height_mm=_HEIGHT)
    plot_stiffness(table, page.subplots())
    return page


def plot_stiffness(table: WireTable, axes: Axes) -> None:
    """Draw the stiffnesses of one wire.

    Parameters
    ----------
    table : the point at zero curvature is left out, as it has no place on the axis
    axes : to draw on
    """
    use = bent(table)
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
    set_log(axes, across)
    axes.set_ylabel(unit.label("Bending stiffness"))
    _mark_onsets(table, axes)
    _lighten(table, axes)


def _lighten(table: WireTable, axes: Axes) -> None:
    if table.is_doubtful.any():
        _lay_over(axes, table.doubtful_curvature, float(table.curvature[-1]))


def _lay_over(axes: Axes, start: float, stop: float) -> None:
    """Make lighter what is doubtful, but not the frame."""
    axes.axvspan(start, stop, **_LIGHTER)
    for spine in axes.spines.values():
        spine.set_zorder(_LIGHTER["zorder"] + 1)


def _mark_limits(table: WireTable, axes: Axes, unit: Scale) -> None:
    """Both limits as lines across the panel, named beside it, where no curve can be."""
    stick, slip = (unit.factor * value for value in (table.stick_stiffness, table.slip_stiffness))
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, _HEADROOM * stick))
    names = {stick: f"all stick\n{_digits(stick)}", slip: f"all slip\n{_digits(slip)}"}
    for level in (stick, slip):
        axes.axhline(level, **_LIMIT)
    if stick < _TOO_CLOSE * slip:
        names = {slip: f"all stick\n{_digits(stick)}\nall slip\n{_digits(slip)}"}
    beside = axes.get_yaxis_transform()
    for level, words in names.items():
        axes.text(1.01, level, words, transform=beside, va="center")


def _digits(value: float) -> str:
    return write_number(value, None, digits=4).value


def _mark_onsets(table: WireTable, axes: Axes) -> None:
    seen = _shown_onsets(table)
    level = np.full(len(seen), 0.035)
    axes.plot(seen, level, transform=axes.get_xaxis_transform(), **_ONSET)


def _shown_onsets(table: WireTable) -> Floats:
    """Onsets of slip within the range; zero has no place on the axis."""
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
    """Draw the moment against curvature with what it is made of, and the shares of each part.

    Parameters
    ----------
    table : of the wire

    Returns
    -------
    A page with two panels: moments stacked against curvature; shares of the moment against
    curvature on a logarithmic axis, where the change from stick to slip is seen.
    """
    words = PageTexts(wire_title(table), warnings_of(table), _moment_keys())
    page = keyed_page(words, height_mm=_PAIR_HEIGHT)
    left, right = page.subplots(1, 2)
    plot_parts(table, left)
    plot_shares(table, right)
    panel_letter(left, "a", "moment")
    panel_letter(right, "b", "shares of the moment")
    return page


def plot_parts(table: WireTable, axes: Axes) -> None:
    """Stack the parts of the moment; a dotted line is the moment if no strand yielded.

    Parameters
    ----------
    table : of the wire; what yielding takes away is taken from the strands' own bending
    axes : to draw on
    """
    across, up = table.curvature, MOMENT.factor
    _stack(axes, across, [up * part for part in moment_parts(table)])
    axes.plot(across, up * table.moment, **_WHOLE)
    elastic = up * (table.moment - table.plastic)
    axes.plot(across, elastic, **_ELASTIC)
    top = 1.04 * min(float(elastic.max()), _MOST_ELASTIC * up * float(table.moment.max()))
    axes.set_xlim(0.0, across[-1])
    axes.set_ylim(0.0, top)
    axes.set_xlabel(CURVATURE.label("Curvature"))
    axes.set_ylabel(MOMENT.label("Bending moment"))
    _lighten(table, axes)


def plot_shares(table: WireTable, axes: Axes) -> None:
    """Stack the parts as percentages of the moment against the logarithm of the curvature.

    Parameters
    ----------
    table : the point at zero curvature is left out
    axes : to draw on
    """
    use = bent(table)
    across = table.curvature[use]
    _stack(axes, across, [100.0 * part[use] / table.moment[use] for part in moment_parts(table)])
    axes.set_xscale("log")
    axes.set_xlim(across[0], across[-1])
    number_log(axes.xaxis)
    axes.set_ylim(0.0, 100.0)
    axes.set_xlabel(CURVATURE.label("Curvature"))
    axes.set_ylabel("Share of the moment (%)")
    _lighten(table, axes)


def moment_parts(table: WireTable) -> tuple[Floats, Floats, Floats, Floats]:
    """Insulation, strands' own bending as they yield, strands that slip, that stick; each N m."""
    return table.insulation, table.bending + table.plastic, table.slip, table.stick


def _stack(axes: Axes, across: Floats, parts: Sequence[Floats]) -> None:
    floor = np.zeros(len(across))
    for part, (_, colour, hatch) in zip(parts, _PARTS, strict=True):
        axes.fill_between(across, floor, floor + part, **_fill(colour, hatch))
        floor = floor + part


def _fill(colour: str, hatch: str) -> dict[str, Any]:
    return {"facecolor": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0.0}


def _moment_keys() -> list[Artist]:
    return [
        *(area_key(name, **_fill(colour, hatch)) for name, colour, hatch in reversed(_PARTS)),
        line_key("whole moment", **_WHOLE),
        line_key("without yielding", **_ELASTIC),
    ]


_CANTILEVER_HEIGHT = 70.0
_CURVE: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.5, "zorder": 3}
_STICK: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.4))}
_SLIP: dict[str, Any] = {"color": "black", "linewidth": 0.6, "linestyle": (0, (5, 1.5, 1.2, 1.5))}
_ROOM = 1.08


def cantilever_figure(table: WireTable) -> Figure:
    """Draw the end load against the deflection of the tip.

    Parameters
    ----------
    table : one without a cantilever curve gets a page that says so

    Returns
    -------
    A page with the curve and the two straight lines of small deflections: all strands stick, all
    slip without friction.
    """
    note = " ".join([*_setting(table), warnings_of(table)]).strip()
    if len(table.tip_deflection) < 2:  # rest alone
        page = keyed_page(PageTexts(wire_title(table), note), height_mm=40.0)
        say(page.subplots(), "There is no cantilever curve to draw.")
        return page
    page = keyed_page(PageTexts(wire_title(table), note, _keys()), height_mm=_CANTILEVER_HEIGHT)
    plot_cantilever(table, page.subplots())
    return page


def plot_cantilever(table: WireTable, axes: Axes) -> None:
    """Draw the curve, and the straight lines of small deflections as far as the panel goes.

    Parameters
    ----------
    table : with a cantilever curve
    axes : to draw on

    Notes
    -----
    The straight lines are force = 3 EI deflection / length^3.
    """
    across, up = LENGTH.factor * table.tip_deflection, FORCE.factor * table.tip_force
    ends = np.array([0.0, table.tip_deflection[-1]])
    for stiffness, look in ((table.stick_stiffness, _STICK), (table.slip_stiffness, _SLIP)):
        force = 3.0 * stiffness / table.spec.length**3 * ends
        axes.plot(LENGTH.factor * ends, FORCE.factor * force, **look)
    axes.plot(across, up, **_CURVE)
    axes.set_xlim(0.0, across[-1])
    axes.set_ylim(0.0, _ROOM * float(np.max(up)))
    axes.set_xlabel(LENGTH.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("End load"))
    if table.doubtful_deflection < table.tip_deflection[-1]:
        _lay_over(axes, LENGTH.factor * table.doubtful_deflection, float(across[-1]))


def _setting(table: WireTable) -> list[str]:
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


_COMPARISON_HEIGHT = 76.0
_RANGES = (
    "Each line ends where the range of its law ends, and is lighter where the rim of the insulation"
    " is strained beyond what its straight line is taken to hold for."
)


def comparison_figure(tables: Sequence[WireTable]) -> Figure:
    """Draw secant stiffness and moment of several wires against curvature, one line each.

    Parameters
    ----------
    tables : 1 to 12 wires

    Raises
    ------
    ValueError
        If there is no wire, or there are more than can be told apart.
    """
    require_room(len(tables), MOST_WIRES, "wires")
    words = PageTexts("Wires compared  ·  wire model", _RANGES, _wire_keys(tables))
    page = keyed_page(words, height_mm=_COMPARISON_HEIGHT)
    left, right = page.subplots(1, 2)
    unit = stiffness_scale(tables)
    for table, look in zip(tables, line_looks(len(tables)), strict=True):
        style: dict[str, Any] = {"color": look.colour, "linestyle": look.dash}
        secant, moment = unit.factor * table.secant_stiffness, MOMENT.factor * table.moment
        sure = table.curvature <= table.doubtful_curvature
        for use, fade in sure_and_doubtful(sure):
            shown = use & bent(table)
            left.plot(table.curvature[shown], secant[shown], **style, alpha=fade)
            right.plot(table.curvature[use], moment[use], **style, alpha=fade)
    set_log(left, _shared_range(tables))
    left.set_ylabel(unit.label("Secant bending stiffness"))
    right.set_xlim(left=0.0)
    right.set_ylim(bottom=0.0)
    right.set_xlabel(CURVATURE.label("Curvature"))
    right.set_ylabel(MOMENT.label("Bending moment"))
    panel_letter(left, "a", "secant stiffness")
    panel_letter(right, "b", "moment")
    return page


def _shared_range(tables: Sequence[WireTable]) -> Floats:
    """Smallest and largest curvature that any of the wires has, 1/m."""
    curvatures = [table.curvature[bent(table)] for table in tables]
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


_NOT_IN_A_FILE = re.compile(r'[\\/:*?"<>|\x00-\x1f]')
_OF_ONE_WIRE: dict[str, Callable[[WireTable], Figure]] = {
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
    ``sections-1`` and ``comparison-1`` with the first dozen of wires, ``sections-2`` ...; then
    of each wire ``NAME.stiffness``, ``NAME.moment`` and ``NAME.cantilever``. There is no comparison
    with one wire alone.
    """
    for number, some in enumerate(in_pages(tables, MOST_WIRES), start=1):
        yield FigureToSave(f"sections-{number}", partial(section_figure, some))
        if len(some) > 1:
            yield FigureToSave(f"comparison-{number}", partial(comparison_figure, some))
    for table in tables:
        names = own_figures(table.name)
        for name, draw in zip(names, _OF_ONE_WIRE.values(), strict=True):
            yield FigureToSave(name, partial(draw, table))


def own_figures(name: str) -> list[str]:
    """Names of the figures of one wire alone, without endings.

    Parameters
    ----------
    name : of the wire
    """
    stem = _NOT_IN_A_FILE.sub("-", name)
    return [f"{stem}.{kind}" for kind in _OF_ONE_WIRE]


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
    say : told the name of each figure as it is drawn
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
