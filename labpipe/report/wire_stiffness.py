"""Stiffness and moment of a wire against its curvature, and what they are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from labpipe.report.numbers import write_number
from labpipe.report.page import Words, keyed_page, number_log, panel_letter
from labpipe.report.wire_look import (
    CURVATURE,
    MOMENT,
    bent,
    set_log,
    stiffness_scale,
    warnings_of,
    wire_title,
)
from labpipe.report.wording import Scale

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
    words = Words(wire_title(table), warnings_of(table), _stiffness_keys(table))
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
        axes.text(1.01, level, words, transform=beside, va="center", fontsize=8)


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
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Line2D([], [], label="secant", **_SECANT),
        Line2D([], [], label="tangent", **_TANGENT),
        Line2D([], [], label="secant, without yielding", **_UNYIELDING),
        Patch(label="secant, all orientations", **_SPREAD),
        Line2D([], [], label="limits without yielding", **_LIMIT),
        *(
            [Line2D([], [], label="a strand begins to slip", **_ONSET)]
            if len(_shown_onsets(table))
            else []
        ),
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
    words = Words(wire_title(table), warnings_of(table), _moment_keys())
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
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        *(Patch(label=name, **_fill(colour, hatch)) for name, colour, hatch in reversed(_PARTS)),
        Line2D([], [], label="whole moment", **_WHOLE),
        Line2D([], [], label="without yielding", **_ELASTIC),
    ]
