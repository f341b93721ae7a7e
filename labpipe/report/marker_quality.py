"""Where the position of every marker comes from, over time, and how well bodies were tracked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag, Shape
from labpipe.records.recording import RigidBody
from labpipe.records.result import TestResult
from labpipe.report.page import DOUBLE_COLUMN, new_page, say, side_key
from labpipe.report.thinning import extremes, worst
from labpipe.report.wording import scale, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLAG_COLOURS = {
    PointFlag.MEASURED: "#c3d3e0",
    PointFlag.RELABELLED: "#0072b2",
    PointFlag.FILLED: "#e69f00",
    PointFlag.MISSING: "#1a1a1a",
}
_COLUMNS = 900
_MM_PER_ROW = 4.2


def draw_marker_quality(result: TestResult) -> Figure:
    """Draw markers as rows against time, and below them the error of the rigid bodies."""
    rows = 0 if result.shape is None else int(_is_marker(result.shape).sum())
    upper = max(rows * _MM_PER_ROW, 25.0)
    page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=upper + 55.0)
    flags, lower = page.subplots(2, 1, sharex=True, height_ratios=[upper, 25.0])
    plot_flags(result, flags)
    plot_tracking(result, lower)
    lower.set_xlabel(scale(result, "time", "s").label("Time"))
    return page


def plot_flags(result: TestResult, axes: Axes) -> None:
    """Draw a row per marker, coloured by where its position comes from.

    Parameters
    ----------
    result : its shape is drawn; constructed points are left out, as they were never markers. Of
        the frames that share a pixel the worst is shown, so that no gap is too short to see
    axes : to draw on; an explaining sentence if there is no shape
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        say(axes, why_missing(result, "shape"))
        return
    mine = _is_marker(shape)
    names = [name for name, is_marker in zip(shape.names, mine, strict=True) if is_marker]
    flags = worst(shape.flags[:, mine], _rank(), bins=_COLUMNS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    edges *= scale(result, "time", "s").factor
    for row in range(len(names)):
        for flag, colour in FLAG_COLOURS.items():
            if spans := _spans(flags[:, row] == flag, edges):
                axes.broken_barh(spans, (row - 0.36, 0.72), color=colour, linewidth=0)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.margins(x=0.01)
    _name_flags(axes, set(np.unique(flags)))


def _name_flags(axes: Axes, present: set[int]) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(color=colour, label=flag.name.lower())
        for flag, colour in FLAG_COLOURS.items()
        if flag in present
    ]
    side_key(axes, handles)


def plot_tracking(result: TestResult, axes: Axes) -> None:
    """Draw the mean marker error of each rigid body; without one, the number of visible markers.

    Parameters
    ----------
    result : the first recording with marker tracks is drawn
    axes : to draw on; an explaining sentence if there are no marker tracks
    """
    tracks = next((one.markers for one in result.recordings.values() if one.markers), None)
    if tracks is None or not len(tracks.time):
        say(axes, why_missing(result, "take"))
        return
    time = tracks.time * scale(result, "time", "s").factor
    bodies = [body for body in tracks.bodies if np.isfinite(body.error).any()]
    if bodies:
        _plot_errors(result, axes, time, bodies)
    else:
        visible = (~np.isnan(tracks.positions).any(axis=2)).sum(axis=1).astype(np.float64)
        kept = extremes(visible, bins=_COLUMNS)
        axes.plot(time[kept], visible[kept], drawstyle="steps-post")
        axes.set_ylabel("Visible markers")
        axes.set_ylim(0, len(tracks.names) + 0.5)
        axes.locator_params(axis="y", integer=True)
    axes.margins(x=0.01)


def _plot_errors(result: TestResult, axes: Axes, time: Floats, bodies: list[RigidBody]) -> None:
    up = scale(result, "displacement", "m")
    for body in bodies:
        error = body.error * up.factor
        kept = extremes(error, bins=_COLUMNS)
        axes.plot(time[kept], error[kept], linewidth=0.7, label=body.name)
    axes.set_ylabel(up.label("Body error"))
    axes.set_ylim(bottom=0.0)
    side_key(axes, axes.lines)


def _is_marker(shape: Shape) -> NDArray[np.bool_]:
    constructed: NDArray[np.bool_] = (shape.flags == PointFlag.CONSTRUCTED).all(axis=0)
    return ~constructed


def _rank() -> NDArray[np.uint8]:
    """Rank of each flag: missing is worse than filled, filled than relabelled."""
    order = [
        PointFlag.CONSTRUCTED,
        PointFlag.MEASURED,
        PointFlag.RELABELLED,
        PointFlag.FILLED,
        PointFlag.MISSING,
    ]
    rank = np.empty(len(order), dtype=np.uint8)
    rank[order] = np.arange(len(order))
    return rank


def _spans(inside: NDArray[np.bool_], edges: Floats) -> list[tuple[float, float]]:
    """Start and width of each stretch of columns."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]])))
    starts, stops = edges[steps[::2]], edges[steps[1::2]]
    return [(float(a), float(b - a)) for a, b in zip(starts, stops, strict=True)]
