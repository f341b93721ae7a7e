"""Markers of a test: their shapes in the rig, and the source of each position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Direction, PointFlag, Shape
from labpipe.records.recording import RigidBody
from labpipe.records.result import TestResult
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    PageTexts,
    area_key,
    keyed_page,
    line_key,
    new_page,
    panel_letter,
    side_key,
    step_colours,
    write_reason,
)
from labpipe.report.plot_thinning import extremes, worst
from labpipe.report.wording import footnote, scale, title, why_missing
from labpipe.results.beam import BendingStiffness

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LOOKS = {
    PointFlag.MEASURED: ("o", True),
    PointFlag.RELABELLED: ("s", True),
    PointFlag.FILLED: ("o", False),
    PointFlag.CONSTRUCTED: ("D", False),
}
"""Marker of a point, and whether it is filled, by the source of its position."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Frames to draw, the deflection of the tip at each (m), and its name."""

    frames: Ints
    levels: Floats
    word: str


def draw_wire_shapes(result: TestResult) -> Figure:
    """Draw shapes in the plane of bending; without branches in two planes."""
    width_mm = 144.0
    shape = result.shape
    if shape is None or not len(shape.time):
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=60)
        write_reason(page.subplots(), why_missing(result, "shape"))
        return page
    steps, rig = choose_frames(result, shape), rig_of(result)
    planes = [1] if _first_loading(result) is not None else [1, 2]
    heights = [width_mm * _aspect_ratio(shape, steps, plane, rig) for plane in planes]
    total = sum(heights) + 17.0 + 14.0 * (len(planes) - 1)
    note = " ".join(filter(None, (_offset_note(result, shape, rig), footnote(result))))
    texts = PageTexts(title(result), note, _sign_keys(shape, steps, rig))
    page = keyed_page(texts, height_mm=total, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(len(planes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for letter, axes, plane in zip("ab", panels, planes, strict=False):
        plot_shapes(result, axes, plane=plane)
        if len(planes) > 1:
            panel_letter(axes, letter, f"x-{'xyz'[plane]} view")
    _draw_step_key(result, panels[0], steps)
    return page


def choose_frames(result: TestResult, shape: Shape) -> Steps:
    """Choose frames at equal, round steps of the tip.

    Parameters
    ----------
    result : steps of tip deflection on its first loading branch, else steps of the distance of the
        tip from its first position
    shape : at least one frame

    Returns
    -------
    About six frames, the first at rest.
    """
    n_steps = 5
    travel, word = _tip_path(result, shape)
    if np.isnan(travel).all():
        return Steps(np.zeros(1, dtype=np.int64), np.zeros(1), word)
    factor = scale(result, "displacement", "m").factor
    step = _round_step(float(np.nanmax(travel)) * factor / n_steps) / factor
    levels = np.arange(0.0, np.nanmax(travel) * (1 + 1e-9), step)
    # the first frame at a level: later ones may belong to another motion
    reached = [np.flatnonzero(travel >= level - 1e-12) for level in levels]
    frames = np.array([hits[0] for hits in reached if len(hits)], dtype=np.int64)
    return Steps(frames, levels[: len(frames)], word)


def _first_loading(result: TestResult) -> tuple[float, float] | None:
    branches = result.curve.branches if result.curve is not None else ()
    times = ((one.start_time, one.stop_time) for one in branches if one.direction is _LOADING)
    return next(times, None)


_LOADING = Direction.LOADING


def _tip_path(result: TestResult, shape: Shape) -> tuple[Floats, str]:
    """Return the deflection of the tip in every frame, m; NaN outside the first loading."""
    loading = _first_loading(result)
    if loading is None or result.curve is None:
        tip = shape.positions[:, _last_tracked(shape)]
        tracked = np.flatnonzero(~np.isnan(tip).any(axis=1))
        start = tip[tracked[0]] if len(tracked) else np.full(3, np.nan)
        far: Floats = np.linalg.norm(tip - start, axis=1)
        return far, "tip excursion"
    curve = result.curve
    travel: Floats = np.interp(shape.time, curve.time, curve.displacement)
    travel[(shape.time < loading[0]) | (shape.time > loading[1])] = np.nan
    is_clamped = bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())
    return travel, "tip deflection" if is_clamped else "deflection"


def _last_tracked(shape: Shape) -> int:
    """Return the tracked point nearest to the free end."""
    tracked = np.flatnonzero(~np.isnan(shape.positions).any(axis=2).all(axis=0))
    return int(tracked[-1]) if len(tracked) else len(shape.names) - 1


def _round_step(step: float) -> float:
    """Round a step to 1, 2 or 5 times a power of ten."""
    if step <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(step))
    candidates = power * np.array([1.0, 2.0, 5.0, 10.0])
    return float(candidates[np.argmin(np.abs(np.log(candidates / step)))])


def _limits(shape: Shape, steps: Steps, axis: int, rig: Rig) -> tuple[float, float]:
    """Return the ends of an axis, m: everything drawn with a margin, at least a flat strip."""
    margin = 0.04
    min_aspect = 0.1  # height of a panel over the length of the specimen
    curves = [_fitted_curve(shape, int(frame))[axis] for frame in steps.frames]
    rollers = [
        centre[axis] + side * rig.roller_radius
        for centre in (*_support_centres(rig), *_load_centres(shape, steps, rig))
        for side in (-1.0, 1.0)
        if axis < len(centre)
    ]
    drawn = np.concatenate([shape.positions[steps.frames, :, axis].ravel(), *curves, rollers])
    drawn = drawn[np.isfinite(drawn)] if np.isfinite(drawn).any() else np.zeros(1)
    middle, half = (drawn.max() + drawn.min()) / 2, np.ptp(drawn) / 2
    half = max(half, min_aspect * shape.length / 2) + margin * shape.length
    return float(middle - half), float(middle + half)


def _aspect_ratio(shape: Shape, steps: Steps, plane: int, rig: Rig) -> float:
    """Return the height of a panel over its width, at equal axis scale."""
    (left, right), (low, high) = (_limits(shape, steps, axis, rig) for axis in (0, plane))
    return (high - low) / (right - left)


def _support_centres(rig: Rig) -> list[tuple[float, float]]:
    """Return the centres of the rollers that support a specimen, m."""
    if not rig.span or not rig.roller_radius:
        return []
    return [(-0.5 * rig.span, rig.reach), (0.5 * rig.span, rig.reach)]


def _load_centres(shape: Shape, steps: Steps, rig: Rig) -> list[tuple[float, float]]:
    """Return the centres of the loading roller at mid-span, m, at each step with a curve."""
    if not _support_centres(rig):
        return []
    loads = []
    for frame in steps.frames:
        x, y = _fitted_curve(shape, int(frame))[:2]
        if len(x) and np.isfinite(y).all():
            loads.append((0.0, float(np.interp(0.0, x, y)) - rig.reach))
    return loads


def _draw_rollers(axes: Axes, shape: Shape, steps: Steps, rig: Rig, factor: float) -> None:
    from matplotlib.patches import Circle

    load = _load_centres(shape, steps, rig)
    for centres, look in ((_support_centres(rig), _SUPPORT), ([*load[:1], *load[-1:]], _LOAD)):
        for x, y in centres:
            place = (x * factor, y * factor)
            axes.add_patch(Circle(place, rig.roller_radius * factor, zorder=0.5, **look))


_SUPPORT: dict[str, Any] = {"facecolor": "#d9d9d9", "edgecolor": GREY, "linewidth": 0.6}
_LOAD: dict[str, Any] = {
    "facecolor": "none", "edgecolor": GREY, "linewidth": 0.8, "linestyle": (0, (3, 1.5))
}  # fmt: skip


def _offset_note(result: TestResult, shape: Shape, rig: Rig) -> str:
    """Note the offset of markers from the axis of a clamped specimen."""
    min_offset = 1e-5  # m
    is_clamped = bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())
    if not is_clamped or abs(rig.centre_offset) < min_offset or not shape.coefficients.shape[2]:
        return ""
    across = scale(result, "displacement", "m")
    return (
        f"Centres of markers are {abs(rig.centre_offset) * across.factor:.3g} {across.unit} beside "
        "the axis, which is the curve."
    )


def plot_shapes(result: TestResult, axes: Axes, *, plane: int = 1) -> None:
    """Draw markers and fitted curves at equal steps of the tip, at equal axis scale.

    Parameters
    ----------
    result : its shape is drawn
    axes : to draw on; an explaining sentence if there is no shape
    plane : vertical axis: 1 for y, in the plane of bending; 2 for z, out of plane
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        write_reason(axes, why_missing(result, "shape"))
        return
    steps, rig = choose_frames(result, shape), rig_of(result)
    across = scale(result, "displacement", "m")
    if plane == 1:
        _draw_rollers(axes, shape, steps, rig, across.factor)
    for frame, colour in zip(steps.frames, step_colours(len(steps.frames)), strict=True):
        x, up = _fitted_curve(shape, int(frame))[[0, plane]] * across.factor
        axes.plot(x, up, color=colour, linewidth=0.9, zorder=1)
        for flag in _LOOKS:
            mine = shape.flags[frame] == flag
            if not mine.any():
                continue
            x, up = shape.positions[frame][mine][:, [0, plane]].T * across.factor
            axes.plot(x, up, color=colour, **_marker_style(flag, colour))
    axes.set_xlim(*(end * across.factor for end in _limits(shape, steps, 0, rig)))
    axes.set_ylim(*(end * across.factor for end in _limits(shape, steps, plane, rig)))
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlabel(across.label("x"))
    axes.set_ylabel(across.label("xyz"[plane]))


def _fitted_curve(shape: Shape, frame: int) -> Floats:
    """Return points on the fitted curve, shape (3, points), m; none without a curve."""
    terms = shape.coefficients.shape[2]
    along = np.linspace(0, 1, 81 if terms else 0)
    curve: Floats = shape.coefficients[frame] @ along[None, :] ** np.arange(terms)[:, None]
    return curve


def _marker_style(flag: PointFlag, colour: str) -> dict[str, Any]:
    sign, full = _LOOKS[flag]
    return {
        "marker": sign,
        "linestyle": "",
        "markersize": 3.4,
        "markerfacecolor": colour if full else "white",
        "label": flag.name.lower(),
    }


def _sign_keys(shape: Shape, steps: Steps, rig: Rig) -> list[Artist]:
    """Return the key of the drawn points and rollers."""
    from matplotlib.lines import Line2D

    present = set(np.unique(shape.flags[steps.frames]))
    handles: list[Artist] = [
        Line2D([], [], color=GREY, **_marker_style(flag, GREY))
        for flag in _LOOKS
        if flag in present
    ]
    if shape.coefficients.shape[2]:
        handles.append(line_key("fitted curve", color=GREY, linewidth=0.9))
    if _support_centres(rig):
        handles.append(area_key("supports", **_SUPPORT))
        handles.append(area_key("load, first and last", **_LOAD))
    return handles


def _draw_step_key(result: TestResult, axes: Axes, steps: Steps) -> None:
    """Draw the key of the deflections of the tip beside the panel."""
    across = scale(result, "displacement", "m")
    levels = [
        line_key(f"{level * across.factor:g} {across.unit}", color=colour, linewidth=1.6)
        for level, colour in zip(steps.levels, step_colours(len(steps.levels)), strict=True)
    ]
    axes.legend(
        handles=levels,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        title=steps.word,
        alignment="left",
    )


FLAG_COLOURS = {
    PointFlag.MEASURED: "#c3d3e0",
    PointFlag.RELABELLED: "#0072b2",
    PointFlag.FILLED: "#e69f00",
    PointFlag.MISSING: "#1a1a1a",
}
_PIXEL_BINS = 900
"""Bins in time, about one per pixel."""


def draw_marker_quality(result: TestResult) -> Figure:
    """Draw a row per marker against time, and below them the errors of the rigid bodies."""
    row_mm = 4.2
    rows = 0 if result.shape is None else int(_is_marker(result.shape).sum())
    upper = max(rows * row_mm, 25.0)
    page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=upper + 55.0)
    flags, lower = page.subplots(2, 1, sharex=True, height_ratios=[upper, 25.0])
    plot_flags(result, flags)
    plot_tracking(result, lower)
    lower.set_xlabel(scale(result, "time", "s").label("Time"))
    return page


def plot_flags(result: TestResult, axes: Axes) -> None:
    """Draw a row per marker, coloured by the source of its position.

    Parameters
    ----------
    result : its shape is drawn without constructed points. Each pixel shows the worst of its
        frames, so that short gaps are visible
    axes : to draw on; an explaining sentence if there is no shape
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        write_reason(axes, why_missing(result, "shape"))
        return
    from matplotlib.collections import PolyCollection

    mine = _is_marker(shape)
    names = [name for name, is_marker in zip(shape.names, mine, strict=True) if is_marker]
    flags = worst(shape.flags[:, mine], _rank(), bins=_PIXEL_BINS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    edges *= scale(result, "time", "s").factor
    for flag, colour in FLAG_COLOURS.items():
        axes.add_collection(
            PolyCollection(list(_bar_corners(flags == flag, edges)), color=colour, linewidth=0)
        )
    axes.autoscale_view()
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.margins(x=0.01)
    _draw_flag_key(axes, set(np.unique(flags)))


def _draw_flag_key(axes: Axes, present: set[int]) -> None:
    handles = [
        area_key(flag.name.lower(), color=colour)
        for flag, colour in FLAG_COLOURS.items()
        if flag in present
    ]
    side_key(axes, handles)


def plot_tracking(result: TestResult, axes: Axes) -> None:
    """Draw the mean marker error of each rigid body, or the number of visible markers.

    Parameters
    ----------
    result : the first recording with marker tracks is drawn
    axes : to draw on; an explaining sentence if there are no marker tracks
    """
    tracks = next((one.markers for one in result.recordings.values() if one.markers), None)
    if tracks is None or not len(tracks.time):
        write_reason(axes, why_missing(result, "take"))
        return
    time = tracks.time * scale(result, "time", "s").factor
    bodies = [body for body in tracks.bodies if np.isfinite(body.error).any()]
    if bodies:
        _plot_errors(result, axes, time, bodies)
    else:
        visible = (~np.isnan(tracks.positions).any(axis=2)).sum(axis=1).astype(np.float64)
        rows = extremes(visible, bins=_PIXEL_BINS)
        axes.plot(time[rows], visible[rows], drawstyle="steps-post")
        axes.set_ylabel("Visible markers")
        axes.set_ylim(0, len(tracks.names) + 0.5)
        axes.locator_params(axis="y", integer=True)
    axes.margins(x=0.01)


def _plot_errors(result: TestResult, axes: Axes, time: Floats, bodies: list[RigidBody]) -> None:
    up = scale(result, "displacement", "m")
    for body in bodies:
        error = body.error * up.factor
        rows = extremes(error, bins=_PIXEL_BINS)
        axes.plot(time[rows], error[rows], linewidth=0.7, label=body.name)
    axes.set_ylabel(up.label("Body error"))
    axes.set_ylim(bottom=0.0)
    side_key(axes, axes.lines)


def _is_marker(shape: Shape) -> NDArray[np.bool_]:
    constructed: NDArray[np.bool_] = (shape.flags == PointFlag.CONSTRUCTED).all(axis=0)
    return ~constructed


def _rank() -> NDArray[np.uint8]:
    """Return the rank of each flag, the worst highest."""
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


def _bar_corners(inside: NDArray[np.bool_], edges: Floats) -> Floats:
    """Return the corners of a bar for each run of columns, row by row, shape (bars, 4, 2)."""
    half_row = 0.36
    rows, steps = np.nonzero(np.diff(inside.T.astype(np.int8), axis=1, prepend=0, append=0))
    left, right = edges[steps[::2]], edges[steps[1::2]]
    low, high = rows[::2] - half_row, rows[::2] + half_row
    corners = ((left, low), (left, high), (right, high), (right, low))
    return np.stack([np.column_stack(corner) for corner in corners], axis=1)


class Rig(NamedTuple):
    """Support of a specimen.

    Parameters
    ----------
    span : m, between supports; 0 for a clamped specimen
    roller_radius : m; 0 if not stated
    section_radius : m, half the outer diameter of the specimen; 0 if not stated
    centre_offset : m, from the axis to the centres of the markers, positive towards the pull
    """

    span: float = 0.0
    roller_radius: float = 0.0
    section_radius: float = 0.0
    centre_offset: float = 0.0

    @property
    def reach(self) -> float:
        """Return the distance from the axis of the specimen to the axis of a roller, m."""
        return self.roller_radius + self.section_radius


def rig_of(result: TestResult) -> Rig:
    """Return the rig of a test from its protocol.

    Parameters
    ----------
    result : with its resolved protocol; without one, or with one of an earlier grammar that is no
        longer valid, the rig is empty
    """
    try:
        protocol = parse_protocol(result.protocol_yaml, result.test)
    except ProtocolError:
        return Rig()
    sizes, section = protocol.specimen, protocol.specimen.section
    rollers = [
        result.roller.diameter or 0.0
        for result in protocol.results
        if isinstance(result, BendingStiffness) and result.roller is not None
    ]
    depth = section.outer_diameter if section is not None else None
    beside = protocol.markers.centre_offset if protocol.markers is not None else 0.0
    return Rig(sizes.span or 0.0, 0.5 * max(rollers, default=0.0), 0.5 * (depth or 0.0), beside)
