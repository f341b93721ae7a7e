"""Force against tip deflection of a clamped wire, as the wire model has it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.wire import WireTable
from labpipe.report.page import Words, keyed_page, say
from labpipe.report.wire_look import FORCE, LENGTH, warnings_of, wire_title

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    if not len(table.tip_deflection):
        page = keyed_page(Words(wire_title(table), note), height_mm=40.0)
        say(page.subplots(), "There is no cantilever curve to draw.")
        return page
    page = keyed_page(Words(wire_title(table), note, _keys()), height_mm=_CANTILEVER_HEIGHT)
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


def _setting(table: WireTable) -> list[str]:
    length = LENGTH.factor * table.spec.length
    return [
        f"Free length {length:.4g} {LENGTH.unit}, first loading; the load stays normal to the"
        " clamped axis. Straight lines: the limits without yielding,"
        " 3\u00a0EI\u00a0/\u00a0length³."
    ]


def _keys() -> list[Artist]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], label="wire model", **_CURVE),
        Line2D([], [], label="straight line, all stick", **_STICK),
        Line2D([], [], label="straight line, all slip", **_SLIP),
    ]
