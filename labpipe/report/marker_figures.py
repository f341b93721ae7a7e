"""Figures of the markers of a test: their shapes in the rig, and how each position was obtained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labpipe.errors import ProtocolError
from labpipe.messages import format_sentence
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Direction, PointFlag, Shape
from labpipe.records.recording import RigidBody
from labpipe.records.result import TestResult
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    add_key,
    add_title,
    make_page,
    make_reason_page,
    sample_colour_map,
    write_reason,
)
from labpipe.report.plot_records import find_extremes, thin_flags
from labpipe.report.wording import (
    explain_missing,
    find_unit,
    write_footnote,
    write_title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LOOKS = {
    PointFlag.MEASURED: ("o", True),
    PointFlag.RELABELLED: ("s", True),
    PointFlag.FILLED: ("o", False),
    PointFlag.CONSTRUCTED: ("D", False),
}
"""Sign of a marker, and whether it is filled, by how its position was obtained."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Frames at which shapes are drawn.

    Parameters
    ----------
    frames : numbers, in order
    levels : deflection of the tip at each, m
    name : of the deflection, for the key
    """

    frames: Ints
    levels: Floats
    name: str


def draw_wire_shapes(result: TestResult) -> Figure:
    """Draw shapes in the plane of bending, or in two planes if the curve has no loading branch."""
    panel_width_mm, frame_mm, gap_mm = 144.0, 17.0, 14.0
    shape = result.shape
    if shape is None or not len(shape.time):
        return make_reason_page(result, explain_missing(result, "shape"))
    steps = choose_frames(result, shape)
    planes = [1] if _find_first_loading(result) is not None else [1, 2]
    length, *sides = (np.ptp(_limits(shape, steps, axis)) for axis in (0, *planes))
    heights = [panel_width_mm * float(side / length) for side in sides]
    height = sum(heights) + frame_mm + gap_mm * (len(planes) - 1)
    page = make_page(height_mm=height, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(len(planes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for axes, plane in zip(panels, planes, strict=True):
        plot_shapes(result, axes, plane=plane)
        if len(planes) > 1:
            axes.set_title(f"x-{'xyz'[plane]} view", loc="left")
    note = " ".join(filter(None, (_describe_offset(result, shape), write_footnote(result))))
    return add_title(page, write_title(result), note)


def choose_frames(result: TestResult, shape: Shape) -> Steps:
    """Choose frames at equal, round steps of the deflection of the tip.

    Parameters
    ----------
    result : the deflection is that of its first loading branch; without one, the distance of the
        tip from its first position
    shape : with at least one frame

    Returns
    -------
    About six frames from deflection zero upwards; the first frame alone without a deflection.
    """
    n_steps = 6
    from matplotlib.ticker import MaxNLocator

    deflection, name = _find_tip_deflection(result, shape)
    if np.isnan(deflection).all():
        return Steps(np.zeros(1, dtype=np.int64), np.zeros(1), name)
    factor = find_unit(result.display, "displacement").factor
    locator = MaxNLocator(n_steps, steps=[1, 2, 5, 10])
    levels = np.asarray(locator.tick_values(0.0, factor * float(np.nanmax(deflection)))) / factor
    # the first frame at a level: later ones may belong to another motion
    reached = [np.flatnonzero(deflection >= level - 1e-12) for level in levels]
    frames = np.array([rows[0] for rows in reached if len(rows)], dtype=np.int64)
    return Steps(frames, levels[: len(frames)], name)


def _find_first_loading(result: TestResult) -> tuple[float, float] | None:
    """Return start and end of the first loading branch, s; None without one."""
    branches = result.curve.branches if result.curve is not None else ()
    loadings = (branch for branch in branches if branch.direction is Direction.LOADING)
    return next(((branch.start_time, branch.stop_time) for branch in loadings), None)


def _find_tip_deflection(result: TestResult, shape: Shape) -> tuple[Floats, str]:
    """Return the deflection of the tip in every frame, m, and its name.

    It is NaN outside the first loading branch. Without such a branch, it is the distance of the
    last tracked point from its first position.
    """
    loading = _find_first_loading(result)
    if loading is None or result.curve is None:
        tracked_points = np.flatnonzero(~np.isnan(shape.positions).any(axis=2).all(axis=0))
        tip = shape.positions[:, tracked_points[-1] if len(tracked_points) else -1]
        tracked = np.flatnonzero(~np.isnan(tip).any(axis=1))
        start = tip[tracked[0]] if len(tracked) else np.full(3, np.nan)
        distance: Floats = np.linalg.norm(tip - start, axis=1)
        return distance, "tip excursion"
    curve = result.curve
    deflection: Floats = np.interp(shape.time, curve.time, curve.displacement)
    deflection[(shape.time < loading[0]) | (shape.time > loading[1])] = np.nan
    return deflection, "tip deflection" if _is_clamped(shape) else "deflection"


def _is_clamped(shape: Shape) -> bool:
    """Return whether the first point of a shape is constructed, as that of a clamped specimen."""
    return bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())


def _limits(shape: Shape, steps: Steps, axis: int) -> tuple[float, float]:
    """Return the ends of an axis, m, around everything drawn, with a margin."""
    margin = 0.04
    min_aspect = 0.1  # height of a panel over the length of the specimen
    curves = [_fitted_curve(shape, int(frame))[axis] for frame in steps.frames]
    drawn = np.concatenate([shape.positions[steps.frames, :, axis].ravel(), *curves])
    drawn = drawn[np.isfinite(drawn)] if np.isfinite(drawn).any() else np.zeros(1)
    middle, half = (drawn.max() + drawn.min()) / 2, np.ptp(drawn) / 2
    half = max(half, min_aspect * shape.length / 2) + margin * shape.length
    return float(middle - half), float(middle + half)


def _describe_offset(result: TestResult, shape: Shape) -> str:
    """State the offset of the markers from the axis of a clamped specimen, if any."""
    min_offset = 1e-5  # m
    has_curve = bool(shape.coefficients.shape[2])
    centre_offset = abs(read_centre_offset(result))
    if not _is_clamped(shape) or centre_offset < min_offset or not has_curve:
        return ""
    x_unit = find_unit(result.display, "displacement")
    offset = centre_offset * x_unit.factor
    return format_sentence("report.markers_beside_axis", offset=offset, unit=x_unit.unit)


def plot_shapes(result: TestResult, axes: Axes, *, plane: int = 1) -> None:
    """Draw markers and fitted curves at equal steps of the tip, with one scale on both axes.

    Parameters
    ----------
    result : with a shape; without one, nothing is drawn
    axes : to draw on
    plane : vertical axis: 1 for y, in the plane of bending; 2 for z, out of plane
    """
    shape = result.shape
    if shape is None:
        return
    steps = choose_frames(result, shape)
    unit = find_unit(result.display, "displacement")
    colours = sample_colour_map(len(steps.frames))
    for at, (frame, colour) in enumerate(zip(steps.frames, colours, strict=True)):
        x, y = _fitted_curve(shape, int(frame))[[0, plane]] * unit.factor
        axes.plot(x, y, color=colour, linewidth=0.9, zorder=1)
        for flag in _LOOKS:
            rows = shape.flags[frame] == flag
            if rows.any():
                x, y = shape.positions[frame][rows][:, [0, plane]].T * unit.factor
                axes.plot(x, y, color=colour, **_marker_style(flag, colour))
        level = f"{steps.levels[at] * unit.factor:g} {unit.unit}"
        label = level if at else f"{steps.name} {level}"
        add_key(axes, label, color=colour, linewidth=1.6)
    present = set(np.unique(shape.flags[steps.frames]))
    for flag in [flag for flag in _LOOKS if flag in present]:
        add_key(axes, flag.name.lower(), color=GREY, **_marker_style(flag, GREY))
    if shape.coefficients.shape[2]:
        add_key(axes, "fitted curve", color=GREY, linewidth=0.9)
    axes.set_xlim(*(end * unit.factor for end in _limits(shape, steps, 0)))
    axes.set_ylim(*(end * unit.factor for end in _limits(shape, steps, plane)))
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set(xlabel=unit.label("x"), ylabel=unit.label("xyz"[plane]))


def _fitted_curve(shape: Shape, frame: int) -> Floats:
    """Return points on the fitted curve, shape (3, points), m; no points without a curve."""
    terms = shape.coefficients.shape[2]
    along = np.linspace(0, 1, 81 if terms else 0)
    curve: Floats = shape.coefficients[frame] @ along[None, :] ** np.arange(terms)[:, None]
    return curve


def _marker_style(flag: PointFlag, colour: str) -> dict[str, Any]:
    sign, full = _LOOKS[flag]
    face = colour if full else "white"
    return {"marker": sign, "linestyle": "", "markersize": 3.4, "markerfacecolor": face}


FLAG_COLOURS = {
    PointFlag.MEASURED: "#c3d3e0",
    PointFlag.RELABELLED: "#0072b2",
    PointFlag.FILLED: "#e69f00",
    PointFlag.MISSING: "#1a1a1a",
}
_FLAGS_BY_RANK = (
    PointFlag.CONSTRUCTED, PointFlag.MEASURED, PointFlag.RELABELLED, PointFlag.FILLED,
    PointFlag.MISSING,
)  # fmt: skip
"""Flags of points, the worst last."""
_PIXEL_BINS = 900
"""Bins in time, about one per pixel."""


def draw_marker_quality(result: TestResult) -> Figure:
    """Draw a row per marker against time, and below them the error of each rigid body."""
    row_mm, lower_mm, frames_mm = 4.2, 25.0, 30.0
    rows = 0 if result.shape is None else int(_are_markers(result.shape).sum())
    upper = max(rows * row_mm, lower_mm)
    page = make_page(width_mm=DOUBLE_COLUMN, height_mm=upper + lower_mm + frames_mm)
    flags, lower = page.subplots(2, 1, sharex=True, height_ratios=[upper, lower_mm])
    plot_flags(result, flags)
    plot_tracking(result, lower)
    lower.set_xlabel(find_unit(result.display, "time").label("Time"))
    return add_title(page, write_title(result), write_footnote(result))


def plot_flags(result: TestResult, axes: Axes) -> None:
    """Draw a row per marker, coloured by how its position was obtained.

    Parameters
    ----------
    result : with a shape; constructed points have no row
    axes : to draw on; without a shape, a sentence says so

    Notes
    -----
    Each pixel shows the worst of its frames, so that short gaps are visible.
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        write_reason(axes, explain_missing(result, "shape"))
        return
    from matplotlib.collections import PolyCollection

    mine = _are_markers(shape)
    names = [name for name, is_marker in zip(shape.names, mine, strict=True) if is_marker]
    flags = thin_flags(shape.flags[:, mine], _FLAGS_BY_RANK, n_bins=_PIXEL_BINS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    edges *= find_unit(result.display, "time").factor
    for flag, colour in FLAG_COLOURS.items():
        if (flags == flag).any():
            bars = list(_bar_corners(flags == flag, edges))
            look: dict[str, Any] = {"color": colour, "linewidth": 0, "label": flag.name.lower()}
            axes.add_collection(PolyCollection(bars, **look))
    axes.autoscale_view()
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.margins(x=0.01)


def plot_tracking(result: TestResult, axes: Axes) -> None:
    """Draw the mean marker error of each rigid body, or the number of visible markers.

    Parameters
    ----------
    result : its first recording with marker tracks is drawn
    axes : to draw on; without marker tracks, a sentence says so
    """
    tracks = next((one.markers for one in result.recordings.values() if one.markers), None)
    if tracks is None or not len(tracks.time):
        write_reason(axes, explain_missing(result, "take"))
        return
    time = tracks.time * find_unit(result.display, "time").factor
    bodies = [body for body in tracks.bodies if np.isfinite(body.error).any()]
    if bodies:
        _plot_errors(result, axes, time, bodies)
    else:
        visible = (~np.isnan(tracks.positions).any(axis=2)).sum(axis=1).astype(np.float64)
        rows = find_extremes(visible, n_bins=_PIXEL_BINS)
        axes.plot(time[rows], visible[rows], drawstyle="steps-post")
        axes.set_ylabel("Visible markers")
        axes.set_ylim(0, len(tracks.names) + 0.5)
        axes.locator_params(axis="y", integer=True)
    axes.margins(x=0.01)


def _plot_errors(result: TestResult, axes: Axes, time: Floats, bodies: list[RigidBody]) -> None:
    y_unit = find_unit(result.display, "displacement")
    for body in bodies:
        error = body.error * y_unit.factor
        rows = find_extremes(error, n_bins=_PIXEL_BINS)
        axes.plot(time[rows], error[rows], linewidth=0.7, label=body.name)
    axes.set_ylabel(y_unit.label("Body error"))
    axes.set_ylim(bottom=0.0)


def _are_markers(shape: Shape) -> NDArray[np.bool_]:
    constructed: NDArray[np.bool_] = (shape.flags == PointFlag.CONSTRUCTED).all(axis=0)
    return ~constructed


def _bar_corners(inside: NDArray[np.bool_], edges: Floats) -> Floats:
    """Return the corners of a bar for each run of columns, row by row, shape (bars, 4, 2)."""
    half_row = 0.36
    rows, steps = np.nonzero(np.diff(inside.T.astype(np.int8), axis=1, prepend=0, append=0))
    left, right = edges[steps[::2]], edges[steps[1::2]]
    low, high = rows[::2] - half_row, rows[::2] + half_row
    corners = ((left, low), (left, high), (right, high), (right, low))
    return np.stack([np.column_stack(corner) for corner in corners], axis=1)


def read_centre_offset(result: TestResult) -> float:
    """Read the offset of the markers from the axis from the protocol of a test, m; 0 if unknown."""
    try:
        markers = parse_protocol(result.protocol_yaml, result.test).markers
    except ProtocolError:
        return 0.0
    return 0.0 if markers is None else markers.centre_offset
