"""Shapes of a bent wire: markers, the curve fitted to them, and the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.report.calibration_look import DEFLECTION, MODEL, length_words
from labpipe.report.calibration_shown import BentShape
from labpipe.report.page import WIDTH, Words, keyed_page, say

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKERS: dict[str, Any] = {
    "color": "black", "linestyle": "", "marker": "o", "markersize": 3.2, "zorder": 4
}  # fmt: skip
_FIT: dict[str, Any] = {
    "color": "black", "linewidth": 0.9, "linestyle": (0, (4, 1.6)), "zorder": 3
}  # fmt: skip
_MODEL: dict[str, Any] = {"color": MODEL, "linewidth": 1.3, "zorder": 2}
_AROUND = 14.0
"""mm, of the numbers and labels of the panel."""
_MARGIN = 0.06
_NOTE = "Markers sit on the surface of the wire; the curves are its axis."
_FLATTEST, _STEEPEST = 0.35, 1.1


def shapes_figure(name: str, shapes: Sequence[BentShape]) -> Figure:
    """Draw the shapes of a sample at several deflections on axes of one scale.

    Parameters
    ----------
    name : of what was bent, such as ``A2, 85 mm``
    shapes : one for each deflection; without any, the page says so
    """
    title = f"{name}  \u00b7  shapes at {len(shapes)} deflections of the tip"
    if not shapes:
        page = keyed_page(Words(title), height_mm=40.0)
        say(page.subplots(), "There is no shape to draw.")
        return page
    low, high = _box(shapes)
    across, up = (high - low).tolist()
    share = min(max(up / across, _FLATTEST), _STEEPEST)
    page = keyed_page(
        Words(title, _NOTE, _keys(shapes)), height_mm=_AROUND + (WIDTH - _AROUND) * share
    )
    plot_shapes(shapes, page.subplots())
    return page


def plot_shapes(shapes: Sequence[BentShape], axes: Axes) -> None:
    """Draw shapes: markers as dots, fitted curves dashed, the model solid.

    Parameters
    ----------
    shapes : each is named by its deflection beside its end
    axes : to draw on, with equal scales
    """
    for shape in shapes:
        for points, look in ((shape.model, _MODEL), (shape.fit, _FIT), (shape.markers, _MARKERS)):
            x, y = DEFLECTION.factor * points.T
            axes.plot(x, y, **look)
        _name(shape, axes)
    low, high = _box(shapes)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel(DEFLECTION.label("Along the undeformed wire, x"))
    axes.set_ylabel(DEFLECTION.label("Towards the pull, y"))


def _name(shape: BentShape, axes: Axes) -> None:
    """Write the deflection beside the end that is furthest from the clamp."""
    ends = [known[-1] for known in map(_known, _lines(shape)) if len(known)]
    if not ends:
        return
    at = DEFLECTION.factor * np.max(ends, axis=0)
    axes.annotate(
        length_words(shape.deflection), (float(at[0]), float(at[1])), (5, 0),
        textcoords="offset points", va="center", size=8,
    )  # fmt: skip


def _box(shapes: Sequence[BentShape]) -> tuple[Floats, Floats]:
    """Corners of all that is drawn with some room, in the display unit."""
    points = np.concatenate([_known(line) for shape in shapes for line in _lines(shape)])
    points = DEFLECTION.factor * np.concatenate([points, np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    room = _MARGIN * max(float(np.max(high - low)), 1.0)
    return low - room, high + np.array([2.5 * room, room])


def _lines(shape: BentShape) -> tuple[Floats, Floats, Floats]:
    return shape.model, shape.fit, shape.markers


def _known(points: Floats) -> Floats:
    rows: Floats = points[np.isfinite(points).all(axis=1)]
    return rows


def _keys(shapes: Sequence[BentShape]) -> list[Artist]:
    from matplotlib.lines import Line2D

    keys: list[Artist] = [Line2D([], [], label="markers", **_MARKERS)]
    if any(len(shape.fit) for shape in shapes):
        keys.append(Line2D([], [], label="fitted curve", **_FIT))
    if any(len(shape.model) for shape in shapes):
        keys.append(Line2D([], [], label="model", **_MODEL))
    return keys
