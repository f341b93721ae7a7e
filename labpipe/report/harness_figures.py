"""Figures of a harness: its line from three sides, its bend radius, and lengths compared."""

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
    read_look,
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
_KINDS_OF_MARKS = ("clip", "pin", "grip", "ring", "string", "load")
"""Kinds of boundaries in the order of the key."""
_VIEWS = (("side", 0, 2), ("end", 1, 2), ("top", 0, 1))
_AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShape:
    """Shape of the line of a harness at one step.

    Parameters
    ----------
    step : number
    positions : shape (n + 1, 3), m
    radius : bend radius, shape (n + 1,), m; infinite where the line is straight
    band : lower and upper ends of the positions, shape (n + 1, 3) each, m; None without a band
    radius_band : lower and upper ends of the radius, shape (n + 1,) each, m; None without a band
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
    path : shape (steps + 1, 3), m, of a grip or of a string; empty for other kinds
    direction : shape (3,), of the line or of the force at the boundary; None if it has none
    is_holding : at the last step
    """

    name: str
    kind: str
    position: Floats
    path: Floats
    direction: Floats | None = None
    is_holding: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class DrawnHarness:
    """Contents of the figure of a harness.

    Parameters
    ----------
    name : of the harness, in the title
    note : footnote
    along : distance from the start along the line, shape (n + 1,), m
    shapes : by step; the last one is drawn with its band and colours, the others as thin lines
    marks : clips, grips and other boundaries
    planes : a point (m) and the normal of each plane that the line may touch
    allowed : smallest allowed bend radius, m
    """

    name: str
    note: str
    along: Floats
    shapes: tuple[DrawnShape, ...]
    marks: tuple[DrawnMark, ...]
    planes: tuple[tuple[Floats, Floats], ...]
    allowed: float


def list_harness_figures(drawn: DrawnHarness, sweep: DrawnSweep | None) -> list[FigureToSave]:
    """List the figures of a harness: its shape, and its lengths compared.

    Parameters
    ----------
    drawn : the harness
    sweep : several lengths of it; None without a sweep
    """
    pages = [FigureToSave(FIGURE, partial(draw_harness, drawn))]
    if sweep is not None:
        pages.append(FigureToSave(SWEEP_FIGURE, partial(draw_sweep, sweep)))
    return pages


def draw_harness(drawn: DrawnHarness) -> Figure:
    """Draw the line of a harness from three sides, and its bend radius along the line.

    Parameters
    ----------
    drawn : the harness
    """
    page = make_page(height_mm=118.0, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(2, 2, width_ratios=(1.35, 1.0)).ravel()
    lines: list[LineCollection] = []
    for panel, (view, x_index, y_index) in zip(panels, _VIEWS, strict=False):
        lines.append(plot_view(drawn, x_index, y_index, panel))
        panel.set_title(f"From the {view}", loc="left")
    bar = page.colorbar(lines[0], ax=list(panels[1:2]), label=LENGTH.label("Bend radius"))
    label_log_axis(bar.ax.yaxis)
    _plot_radius(drawn, panels[3])
    panels[3].set_title("Along the line", loc="left")
    return add_title(page, f"{drawn.name}  ·  shape", drawn.note)


def plot_view(drawn: DrawnHarness, x_index: int, y_index: int, axes: Axes) -> LineCollection:
    """Draw the line of a harness, its planes and its boundaries from one side.

    Parameters
    ----------
    drawn : the harness
    x_index, y_index : numbers of the coordinates drawn to the right and upwards
    axes : to draw on

    Returns
    -------
    The line of the last step, coloured by its bend radius.
    """
    import matplotlib as mpl
    from matplotlib.collections import LineCollection, PolyCollection

    last, pair = drawn.shapes[-1], [x_index, y_index]
    for plane in drawn.planes:
        _plot_plane(drawn, plane, pair, axes)
    steps = f"step {', '.join(str(shape.step) for shape in drawn.shapes[:-1])}"
    for shape in drawn.shapes[:-1]:
        _draw_line(
            axes, shape.positions[:, pair], **read_look("earlier_step", zorder=2, label=steps)
        )
    if last.band is not None:
        low, high = (LENGTH.factor * end[:, pair] for end in last.band)
        band = PolyCollection(_make_band_outlines(low, high), **read_look("harness_band", zorder=1))
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
    for mark in sorted(drawn.marks, key=lambda mark: _KINDS_OF_MARKS.index(mark.kind)):
        names = ", ".join(other.name for other in drawn.marks if other.kind == mark.kind)
        _plot_mark(mark, _extent(drawn), pair, axes, label=f"{mark.kind} {names}")
    _set_view(drawn, pair, axes)
    return line


def _colour_norm(drawn: DrawnHarness) -> Any:
    """Return the logarithmic scale of colours, which starts at the allowed bend radius."""
    straight_radius_factor = 40.0  # of the allowed radius: straighter lines have one colour
    from matplotlib.colors import LogNorm

    allowed = LENGTH.factor * drawn.allowed
    return LogNorm(allowed, straight_radius_factor * allowed, clip=False)


def _make_band_outlines(low: Floats, high: Floats) -> list[Floats]:
    """Return the outlines of a band between neighbouring nodes; none where it has no width."""
    from scipy.spatial import ConvexHull, QhullError

    outlines = []
    corners = [np.stack([a[:, 0], b[:, 1]], axis=1) for a in (low, high) for b in (low, high)]
    for node in range(len(low) - 1):
        points = np.vstack([corner[node : node + 2] for corner in corners])
        try:
            outlines.append(points[ConvexHull(points).vertices])
        except QhullError:
            continue
    return outlines


def _extent(drawn: DrawnHarness) -> float:
    """Return the longest side of the box around all drawn lines, m."""
    positions = np.vstack([shape.positions for shape in drawn.shapes])
    return float(np.max(np.ptp(positions, axis=0)))


def _plot_plane(
    drawn: DrawnHarness, plane: tuple[Floats, Floats], pair: list[int], axes: Axes
) -> None:
    point, normal = plane
    normal_x, normal_y = normal[pair]
    size = np.hypot(normal_x, normal_y)
    if size < 0.5:  # seen from above, the plane is no line
        return
    reach = 10.0 * _extent(drawn) / size * np.array([-normal_y, normal_x])
    ends = np.array([point[pair] - reach, point[pair] + reach])
    _draw_line(axes, ends, color=GREY, linewidth=1.2, zorder=0)


def _plot_mark(mark: DrawnMark, extent: float, pair: list[int], axes: Axes, *, label: str) -> None:
    place = mark.position[pair]
    colour = "black" if mark.is_holding else "#bbbbbb"
    look = read_look(f"mark_{mark.kind}", color=colour, label=label)
    _draw_line(axes, place[None], **look)
    path_label = "path of a grip" if mark.kind == "grip" and len(mark.path) > 1 else None
    path = {"color": "#bbbbbb", "linewidth": 0.5, "zorder": 0, "label": path_label}
    _draw_line(axes, mark.path[:, pair], **path)
    if mark.direction is not None:
        reach = 0.06 * extent * mark.direction[pair]
        ends = np.array([place - reach, place + reach])
        _draw_line(axes, ends, color=colour, linewidth=0.8, zorder=4)


def _draw_line(axes: Axes, points: Floats, **look: Any) -> None:
    """Draw a line through points, shape (k, 2), m, and keep the limits of the axes."""
    from matplotlib.lines import Line2D

    axes.add_artist(Line2D(*(LENGTH.factor * points.T), **look))


def _set_view(drawn: DrawnHarness, pair: list[int], axes: Axes) -> None:
    """Show all lines, boundaries and paths with one scale on both axes."""
    min_side_share = 0.12  # smallest side of the view, of the longest side of the lines
    every = np.vstack(
        [
            *(shape.positions for shape in drawn.shapes),
            *(mark.position[None] for mark in drawn.marks),
            *(mark.path for mark in drawn.marks),
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
        axes.plot(along, _finite_radius(shape.radius), **read_look("earlier_step"))
    if last.radius_band is not None:
        low, high = map(_finite_radius, last.radius_band)
        axes.fill_between(along, low, high, **read_look("harness_band"))
    axes.plot(along, _finite_radius(last.radius), color="black", linewidth=1.0)
    allowed = LENGTH.factor * drawn.allowed
    axes.axhline(allowed, **read_look("allowed_radius"))
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
    name : of the harness, in the title
    note : footnote
    length : shape (k,), m
    radius : smallest bend radius at the last step, shape (k,), m; NaN if not available
    radius_over_steps : smallest bend radius over all steps, shape (k,), m
    radius_band : lower and upper ends of `radius`, shape (k,) each, m; None without a band
    shapes : of each length at the last step, shape (n + 1, 3), m; empty if it failed
    allowed : smallest allowed bend radius, m
    is_doubtful : of each length, shape (k,)
    """

    name: str
    note: str
    length: Floats
    radius: Floats
    radius_over_steps: Floats
    radius_band: tuple[Floats, Floats] | None
    shapes: tuple[Floats, ...]
    allowed: float
    is_doubtful: Flags


def draw_sweep(sweep: DrawnSweep) -> Figure:
    """Draw (a) the lines of several lengths and (b) their smallest bend radius.

    Parameters
    ----------
    sweep : of one harness
    """
    page = make_page(height_mm=76.0, width_mm=DOUBLE_COLUMN)
    shapes, radii = page.subplots(1, 2, width_ratios=(1.2, 1.0))
    positions = np.vstack(sweep.shapes)
    side, _, top = _VIEWS
    is_wide = np.ptp(positions[:, 1]) > np.ptp(positions[:, 2])
    view, x_index, y_index = top if is_wide else side
    _plot_lengths(sweep, [x_index, y_index], shapes)
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
    earlier, last = read_look("earlier_step"), {"color": "black", "linewidth": 1.0}
    lines = (
        ("during installation", sweep.radius_over_steps, earlier),
        ("installed", sweep.radius, last),
    )
    for label, radii, look in lines:
        radius = _finite_radius(radii)
        axes.plot(length, radius, marker="o", markersize=3.0, label=label, **look)
        dots: dict[str, Any] = {**look, "markerfacecolor": "white", "markersize": 3.0}
        if doubtful.any():
            axes.plot(length[doubtful], radius[doubtful], "o", label="doubtful", **dots)
    axes.axhline(LENGTH.factor * sweep.allowed, **read_look("allowed_radius"))
    if sweep.radius_band is not None:
        low, high = map(_finite_radius, sweep.radius_band)
        axes.fill_between(length, low, high, **read_look("harness_band", zorder=0))
    axes.set_ylim(bottom=0.0)
    axes.set(xlabel=LENGTH.label("Length of the line"), ylabel=LENGTH.label("Smallest bend radius"))
