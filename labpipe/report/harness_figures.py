"""A harness from three sides with its bend radius as colour, and the radius along the line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.report.figure_page import (
    DASHED,
    DOUBLE_COLUMN,
    GREY,
    FigureToSave,
    add_title,
    label_log_axis,
    make_page,
    sample_colour_map,
)
from labpipe.report.wire_figures import LENGTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

FIGURE, SWEEP_FIGURE = "harness", "harness-sweep"
"""Names of the files, without the ending."""

_COLOURS = "viridis"
_BELOW = "#d62728"
_BAND: dict[str, Any] = {"color": "#9ecae1", "linewidth": 0.0}
_EARLIER: dict[str, Any] = {"color": "#999999", "linewidth": 0.7}
_LIMIT: dict[str, Any] = {"color": _BELOW, "linewidth": 0.8, "linestyle": (0, (5, 2))}
_SIGNS: dict[str, dict[str, Any]] = {
    "clip": {"marker": "s", "markersize": 4.5},
    "pin": {"marker": "o", "markersize": 4.5},
    "grip": {"marker": "D", "markersize": 4.2},
    "ring": {"marker": "o", "markersize": 6.5, "markerfacecolor": "none"},
    "string": {"marker": "^", "markersize": 4.5},
    "load": {"marker": "v", "markersize": 4.5},
}
_POINTWISE = "95 % band, pointwise"
_VIEWS = (("side", 0, 2), ("end", 1, 2), ("top", 0, 1))
_AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShape:
    """A line at one step.

    Parameters
    ----------
    step : number
    positions : shape (n + 1, 3), m
    radius : shape (n + 1,), m; infinite where the line is straight
    band : lower and upper ends of the positions, shape (n + 1, 3) each; None without
    radius_band : lower and upper ends of the radius, shape (n + 1,) each; None without
    """

    step: int
    positions: Floats
    radius: Floats
    band: tuple[Floats, Floats] | None = None
    radius_band: tuple[Floats, Floats] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DrawnMark:
    """A boundary that holds or pulls the line.

    Parameters
    ----------
    name, kind : of the boundary
    position : shape (3,), m, at the last step
    way : shape (steps + 1, 3), m, path of a grip or of a string; empty for others
    direction : shape (3,), of the line or of the force there; None without
    holds : whether it still holds
    """

    name: str
    kind: str
    position: Floats
    way: Floats
    direction: Floats | None = None
    holds: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class DrawnHarness:
    """Contents of the figure of a harness.

    Parameters
    ----------
    name, note : title and footnote
    along : shape (n + 1,), m, along the line
    shapes : by step; the last one is drawn in full
    marks : clips, grips and others
    planes : point and normal of each, m
    allowed : bend radius, m
    """

    name: str
    note: str
    along: Floats
    shapes: tuple[DrawnShape, ...]
    marks: tuple[DrawnMark, ...]
    planes: tuple[tuple[Floats, Floats], ...]
    allowed: float


def list_harness_figures(drawn: DrawnHarness, sweep: DrawnSweep | None) -> list[FigureToSave]:
    """List the figures of a harness: its shape, and its sweep, if any.

    Parameters
    ----------
    drawn : the harness
    sweep : several lengths of it
    """
    pages = [FigureToSave(FIGURE, partial(draw_harness, drawn))]
    if sweep is not None:
        pages.append(FigureToSave(SWEEP_FIGURE, partial(draw_sweep, sweep)))
    return pages


def draw_harness(drawn: DrawnHarness) -> Figure:
    """Draw a line from three sides, and its bend radius along it.

    Parameters
    ----------
    drawn : the harness
    """
    page = make_page(height_mm=118.0, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(2, 2, width_ratios=(1.35, 1.0)).ravel()
    lines: list[LineCollection] = []
    for panel, (view, across, up) in zip(panels, _VIEWS, strict=False):
        lines.append(plot_view(drawn, across, up, panel))
        panel.set_title(f"From the {view}", loc="left")
    bar = page.colorbar(lines[0], ax=list(panels[1:2]), label=LENGTH.label("Bend radius"))
    label_log_axis(bar.ax.yaxis)
    _plot_radius(drawn, panels[3])
    panels[3].set_title("Along the line", loc="left")
    return add_title(page, f"{drawn.name}  ·  shape", drawn.note)


def plot_view(drawn: DrawnHarness, across: int, up: int, axes: Axes) -> LineCollection:
    """Draw a line and its boundaries from one side.

    Parameters
    ----------
    drawn : the harness
    across, up : numbers of the coordinates to the right and upwards
    axes : to draw on

    Returns
    -------
    The coloured line of the last step.
    """
    import matplotlib as mpl
    from matplotlib.collections import LineCollection, PolyCollection

    last, pair = drawn.shapes[-1], [across, up]
    for plane in drawn.planes:
        _plot_plane(drawn, plane, pair, axes)
    steps = f"step {', '.join(str(shape.step) for shape in drawn.shapes[:-1])}"
    for shape in drawn.shapes[:-1]:
        _draw_line(axes, shape.positions[:, pair], **_EARLIER, zorder=2, label=steps)
    if last.band is not None:
        low, high = (LENGTH.factor * end[:, pair] for end in last.band)
        band = PolyCollection(_outlines(low, high), label=_POINTWISE, **_BAND, zorder=1)
        axes.add_collection(band, autolim=False)
    points = LENGTH.factor * last.positions[:, pair]
    ends = np.stack([points[:-1], points[1:]], axis=1)
    colours = mpl.colormaps[_COLOURS].with_extremes(under=_BELOW)
    line = LineCollection(
        list(ends),
        cmap=colours,
        norm=_colour_norm(drawn),
        linewidth=2.2,
        capstyle="round",
        zorder=3,
    )
    line.set_array(LENGTH.factor * np.minimum(last.radius[:-1], last.radius[1:]))
    axes.add_collection(line, autolim=False)
    for mark in sorted(drawn.marks, key=lambda mark: list(_SIGNS).index(mark.kind)):
        names = ", ".join(other.name for other in drawn.marks if other.kind == mark.kind)
        _plot_mark(mark, _extent(drawn), pair, axes, label=f"{mark.kind} {names}")
    _set_view(drawn, pair, axes)
    return line


def _colour_norm(drawn: DrawnHarness) -> Any:
    """Return the scale of colours from the allowed radius upwards."""
    straight_radius_factor = 40.0  # of the allowed radius: straighter lines have one colour
    from matplotlib.colors import LogNorm

    allowed = LENGTH.factor * drawn.allowed
    return LogNorm(allowed, straight_radius_factor * allowed, clip=False)


def _outlines(low: Floats, high: Floats) -> list[Floats]:
    """Return the outlines of a band between neighbouring nodes."""
    from scipy.spatial import ConvexHull, QhullError

    outlines = []
    corners = [np.stack([a[:, 0], b[:, 1]], axis=1) for a in (low, high) for b in (low, high)]
    for one in range(len(low) - 1):
        points = np.vstack([corner[one : one + 2] for corner in corners])
        try:
            outlines.append(points[ConvexHull(points).vertices])
        except QhullError:  # a band without width
            continue
    return outlines


def _extent(drawn: DrawnHarness) -> float:
    """Return the widest side of all drawn lines, m."""
    every = np.vstack([shape.positions for shape in drawn.shapes])
    return float(np.max(np.ptp(every, axis=0)))


def _plot_plane(
    drawn: DrawnHarness, plane: tuple[Floats, Floats], pair: list[int], axes: Axes
) -> None:
    point, normal = plane
    flat = normal[pair]
    if np.linalg.norm(flat) < 0.5:  # seen from above
        return
    reach = 10.0 * _extent(drawn) / np.linalg.norm(flat) * np.array([-flat[1], flat[0]])
    ends = np.array([point[pair] - reach, point[pair] + reach])
    _draw_line(axes, ends, color=GREY, linewidth=1.2, zorder=0)


def _plot_mark(mark: DrawnMark, extent: float, pair: list[int], axes: Axes, *, label: str) -> None:
    place = mark.position[pair]
    colour = "black" if mark.holds else "#bbbbbb"
    look: dict[str, Any] = {"linestyle": "", "zorder": 4, **_SIGNS[mark.kind]}
    _draw_line(axes, place[None], color=colour, label=label, **look)
    path = {"label": "path of a grip"} if mark.kind == "grip" and len(mark.way) > 1 else {}
    _draw_line(axes, mark.way[:, pair], color="#bbbbbb", linewidth=0.5, zorder=0, **path)
    if mark.direction is not None:
        reach = 0.06 * extent * mark.direction[pair]
        ends = np.array([place - reach, place + reach])
        _draw_line(axes, ends, color=colour, linewidth=0.8, zorder=4)


def _draw_line(axes: Axes, points: Floats, **look: Any) -> None:
    """Draw a line through points, shape (k, 2), m, without changing the limits."""
    from matplotlib.lines import Line2D

    axes.add_artist(Line2D(*(LENGTH.factor * points.T), **look))


def _set_view(drawn: DrawnHarness, pair: list[int], axes: Axes) -> None:
    min_side_share = 0.12  # smallest side of the view, of the widest side of the line
    every = np.vstack(
        [
            *(shape.positions for shape in drawn.shapes),
            *(mark.position[None] for mark in drawn.marks),
            *(mark.way for mark in drawn.marks),
        ]
    )[:, pair]
    middle = 0.5 * (every.max(axis=0) + every.min(axis=0))
    half = np.maximum(0.55 * np.ptp(every, axis=0), min_side_share * _extent(drawn))
    axes.update_datalim(LENGTH.factor * np.array([middle - half, middle + half]))
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=LENGTH.label(_AXES[pair[0]]), ylabel=LENGTH.label(_AXES[pair[1]]))


def _plot_radius(drawn: DrawnHarness, axes: Axes) -> None:
    """Draw the bend radius along the line, with the allowed radius."""
    along, last = LENGTH.factor * drawn.along, drawn.shapes[-1]
    axes.set_yscale("log")
    for shape in drawn.shapes[:-1]:
        axes.plot(along, _finite_radius(shape.radius), **_EARLIER)
    if last.radius_band is not None:
        low, high = map(_finite_radius, last.radius_band)
        axes.fill_between(along, low, high, **_BAND)
    axes.plot(along, _finite_radius(last.radius), color="black", linewidth=1.0)
    allowed = LENGTH.factor * drawn.allowed
    axes.axhline(allowed, label="allowed bend radius", **_LIMIT)
    sharpest = [np.nanmin(_finite_radius(shape.radius), initial=np.inf) for shape in drawn.shapes]
    highest = max([100.0 * allowed, *(3.0 * radius for radius in sharpest if np.isfinite(radius))])
    axes.set_ylim(0.7 * min(*sharpest, allowed), highest)
    axes.set_xlim(along[0], along[-1])
    axes.set(xlabel=LENGTH.label("From the start"), ylabel=LENGTH.label("Bend radius"))
    label_log_axis(axes.yaxis)


def _finite_radius(radius: Floats) -> Floats:
    """Return radii in mm; NaN where the line is straight."""
    return np.asarray(np.where(np.isfinite(radius), LENGTH.factor * radius, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSweep:
    """Several lengths of one harness.

    Parameters
    ----------
    name, note : title and footnote
    length : shape (k,), m
    radius : shape (k,), m, smallest bend radius at the last step; NaN if not available
    way : shape (k,), m, smallest bend radius over all steps
    radius_band : lower and upper ends, shape (k,) each; None without
    shapes : shape (n + 1, 3), m, of each length at the last step; empty for a failed one
    allowed : bend radius, m
    is_doubtful : shape (k,)
    """

    name: str
    note: str
    length: Floats
    radius: Floats
    way: Floats
    radius_band: tuple[Floats, Floats] | None
    shapes: tuple[Floats, ...]
    allowed: float
    is_doubtful: Flags


def draw_sweep(sweep: DrawnSweep) -> Figure:
    """Draw (a) the lines of several lengths and (b) their smallest bend radius.

    Parameters
    ----------
    sweep : the lengths
    """
    page = make_page(height_mm=76.0, width_mm=DOUBLE_COLUMN)
    shapes, radii = page.subplots(1, 2, width_ratios=(1.2, 1.0))
    every = np.vstack(sweep.shapes)
    side, _, top = _VIEWS  # that shows most of the lines
    view, across, up = top if np.ptp(every[:, 1]) > np.ptp(every[:, 2]) else side
    _plot_lengths(sweep, [across, up], shapes)
    _plot_sweep(sweep, radii)
    shapes.set_title(f"From the {view}, by length", loc="left")
    radii.set_title("Smallest bend radius", loc="left")
    return add_title(page, f"{sweep.name}  ·  length against bend radius", sweep.note)


def _plot_lengths(sweep: DrawnSweep, pair: list[int], axes: Axes) -> None:
    """Draw the lines of a sweep from one side; a doubtful one is dashed."""
    for positions, length, colour, is_doubtful in zip(
        sweep.shapes,
        sweep.length,
        sample_colour_map(len(sweep.shapes)),
        sweep.is_doubtful,
        strict=True,
    ):
        if len(positions):
            label = f"{LENGTH.factor * length:.6g} {LENGTH.unit}"
            dash: Any = DASHED if is_doubtful else "-"
            points = LENGTH.factor * positions[:, pair]
            axes.plot(*points.T, color=colour, linewidth=1.1, linestyle=dash, label=label)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=LENGTH.label(_AXES[pair[0]]), ylabel=LENGTH.label(_AXES[pair[1]]))


def _plot_sweep(sweep: DrawnSweep, axes: Axes) -> None:
    """Draw the smallest bend radius over the length."""
    length, doubtful = LENGTH.factor * sweep.length, sweep.is_doubtful
    black: dict[str, Any] = {"color": "black", "linewidth": 1.0}
    lines = (("during installation", sweep.way, _EARLIER), ("installed", sweep.radius, black))
    for label, radii, look in lines:
        radius = _finite_radius(radii)
        axes.plot(length, radius, marker="o", markersize=3.0, label=label, **look)
        dots: dict[str, Any] = {**look, "markerfacecolor": "white", "markersize": 3.0}
        if doubtful.any():
            axes.plot(length[doubtful], radius[doubtful], "o", label="doubtful", **dots)
    axes.axhline(LENGTH.factor * sweep.allowed, label="allowed bend radius", **_LIMIT)
    if sweep.radius_band is not None:
        low, high = map(_finite_radius, sweep.radius_band)
        axes.fill_between(length, low, high, label=_POINTWISE, **_BAND, zorder=0)
    axes.set_ylim(bottom=0.0)
    axes.set(xlabel=LENGTH.label("Length of the line"), ylabel=LENGTH.label("Smallest bend radius"))
