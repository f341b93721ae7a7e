"""Stiffness and moment of several wires beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from labpipe.report.page import Words, keyed_page, line_looks, panel_letter, require_room
from labpipe.report.wire_look import (
    CURVATURE,
    MOMENT,
    MOST_WIRES,
    bent,
    set_log,
    short_name,
    stiffness_scale,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

_COMPARISON_HEIGHT = 76.0
_RANGES = "Each line ends where the range of its law ends."


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
    words = Words("Wires compared  ·  wire model", _RANGES, _wire_keys(tables))
    page = keyed_page(words, height_mm=_COMPARISON_HEIGHT)
    left, right = page.subplots(1, 2)
    unit = stiffness_scale(tables)
    for table, look in zip(tables, line_looks(len(tables)), strict=True):
        style: dict[str, Any] = {"color": look.colour, "linestyle": look.dash}
        use = bent(table)
        left.plot(table.curvature[use], unit.factor * table.secant_stiffness[use], **style)
        right.plot(table.curvature, MOMENT.factor * table.moment, **style)
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
    return np.array([min(each[0] for each in curvatures), max(each[-1] for each in curvatures)])


def _wire_keys(tables: Sequence[WireTable]) -> list[Artist]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=look.colour, linestyle=look.dash, label=short_name(table))
        for table, look in zip(tables, line_looks(len(tables)), strict=True)
    ]
