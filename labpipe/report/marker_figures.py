"""A test's markers: the shapes that they give, and where each position comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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
    say,
    side_key,
)
from labpipe.report.plot_thinning import extremes, worst
from labpipe.report.rig_drawing import Rig, rig_of
from labpipe.report.wording import footnote, scale, title, why_missing

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_STEPS = 5
_WIDTH_MM = 144.0
_MARGIN = 0.04
_FLATTEST = 0.1
"""Width of a panel on paper; margin and least height of a panel over the specimen's length."""
_LOOKS = {
    PointFlag.MEASURED: ("o", True),
    PointFlag.RELABELLED: ("s", True),
    PointFlag.FILLED: ("o", False),
    PointFlag.CONSTRUCTED: ("D", False),
}
"""Sign of a point, and whether it is filled with colour, by where its position comes from."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Frames to draw, the tip's way at each of them (m), and the word for that way."""

    frames: Ints
    levels: Floats
    word: str


def draw_wire_shapes(result: TestResult) -> Figure:
    """Draw shapes in the plane of bending; without branches in two planes."""
    shape = result.shape
    if shape is None or not len(shape.time):
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=60)
        say(page.subplots(), why_missing(result, "shape"))
        return page
    steps, rig = choose_frames(result, shape), rig_of(result)
    planes = [1] if _first_loading(result) is not None else [1, 2]
    heights = [_WIDTH_MM * _proportion(shape, steps, plane, rig) for plane in planes]
    total = sum(heights) + 17.0 + 14.0 * (len(planes) - 1)
    note = " ".join(filter(None, (_beside_words(result, shape, rig), footnote(result))))
    words = PageTexts(title(result), note, _sign_keys(shape, steps, rig))
    page = keyed_page(words, height_mm=total, width_mm=DOUBLE_COLUMN)
    panels = page.subplots(len(planes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for letter, axes, plane in zip("ab", panels, planes, strict=False):
        plot_shapes(result, axes, plane=plane)
        if len(planes) > 1:
            panel_letter(axes, letter, f"x-{'xyz'[plane]} view")
    _name_steps(result, panels[0], steps)
    return page


def choose_frames(result: TestResult, shape: Shape) -> Steps:
    """Choose frames at equal, round steps of the tip.

    Parameters
    ----------
    result : its first loading branch is used where it has one: steps of tip deflection; else steps
        of the tip's distance from where it was at first
    shape : at least one frame

    Returns
    -------
    About six frames, the first at rest.
    """
    way, word = _way(result, shape)
    if np.isnan(way).all():
        return Steps(np.zeros(1, dtype=np.int64), np.zeros(1), word)
    factor = scale(result, "displacement", "m").factor
    step = _round_step(float(np.nanmax(way)) * factor / _STEPS) / factor
    levels = np.arange(0.0, np.nanmax(way) * (1 + 1e-9), step)
    # the first frame at a level, not the nearest of all: later ones may belong to another motion
    reached = [np.flatnonzero(way >= level - 1e-12) for level in levels]
    frames = np.array([hits[0] for hits in reached if len(hits)], dtype=np.int64)
    return Steps(frames, levels[: len(frames)], word)


def _first_loading(result: TestResult) -> tuple[float, float] | None:
    branches = result.curve.branches if result.curve is not None else ()
    times = ((one.start_time, one.stop_time) for one in branches if one.direction is _LOADING)
    return next(times, None)


_LOADING = Direction.LOADING


def _way(result: TestResult, shape: Shape) -> tuple[Floats, str]:
    """The tip's way in every frame, m; NaN outside the first loading."""
    loading = _first_loading(result)
    if loading is None or result.curve is None:
        tip = shape.positions[:, _last_seen(shape)]
        seen = np.flatnonzero(~np.isnan(tip).any(axis=1))
        start = tip[seen[0]] if len(seen) else np.full(3, np.nan)
        far: Floats = np.linalg.norm(tip - start, axis=1)
        return far, "tip excursion"
    curve = result.curve
    way: Floats = np.interp(shape.time, curve.time, curve.displacement)
    way[(shape.time < loading[0]) | (shape.time > loading[1])] = np.nan
    is_clamped = bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())
    return way, "tip deflection" if is_clamped else "deflection"


def _last_seen(shape: Shape) -> int:
    """The point nearest the free end that has a position at all."""
    seen = np.flatnonzero(~np.isnan(shape.positions).any(axis=2).all(axis=0))
    return int(seen[-1]) if len(seen) else len(shape.names) - 1


def _round_step(step: float) -> float:
    """The number 1, 2 or 5 times a power of ten nearest to a step, by ratio."""
    if step <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(step))
    candidates = power * np.array([1.0, 2.0, 5.0, 10.0])
    return float(candidates[np.argmin(np.abs(np.log(candidates / step)))])


def _limits(shape: Shape, steps: Steps, axis: int, rig: Rig) -> tuple[float, float]:
    """Ends of an axis, m: all that is drawn with a margin, and never less than a flat strip."""
    curves = [_fitted(shape, int(frame))[axis] for frame in steps.frames]
    rollers = [
        centre[axis] + side * rig.roller_radius
        for centre in (*_supports(rig), *_loads(shape, steps, rig))
        for side in (-1.0, 1.0)
        if axis < len(centre)
    ]
    drawn = np.concatenate([shape.positions[steps.frames, :, axis].ravel(), *curves, rollers])
    drawn = drawn[np.isfinite(drawn)] if np.isfinite(drawn).any() else np.zeros(1)
    middle, half = (drawn.max() + drawn.min()) / 2, np.ptp(drawn) / 2
    half = max(half, _FLATTEST * shape.length / 2) + _MARGIN * shape.length
    return float(middle - half), float(middle + half)


def _proportion(shape: Shape, steps: Steps, plane: int, rig: Rig) -> float:
    """Height of a panel over its width, at equal axis scale."""
    (left, right), (low, high) = (_limits(shape, steps, axis, rig) for axis in (0, plane))
    return (high - low) / (right - left)


def _supports(rig: Rig) -> list[tuple[float, float]]:
    """Centres of the rollers that hold a specimen, m: on the side to which it is pushed."""
    if not rig.span or not rig.roller_radius:
        return []
    return [(-0.5 * rig.span, rig.reach), (0.5 * rig.span, rig.reach)]


def _loads(shape: Shape, steps: Steps, rig: Rig) -> list[tuple[float, float]]:
    """Centres of the roller that pushes at mid-span, m, at each step where a curve is known."""
    if not _supports(rig):
        return []
    loads = []
    for frame in steps.frames:
        x, y = _fitted(shape, int(frame))[:2]
        if len(x) and np.isfinite(y).all():
            loads.append((0.0, float(np.interp(0.0, x, y)) - rig.reach))
    return loads


def _draw_rollers(axes: Axes, shape: Shape, steps: Steps, rig: Rig, factor: float) -> None:
    from matplotlib.patches import Circle

    load = _loads(shape, steps, rig)
    for centres, look in ((_supports(rig), _SUPPORT), ([*load[:1], *load[-1:]], _LOAD)):
        for x, y in centres:
            place = (x * factor, y * factor)
            axes.add_patch(Circle(place, rig.roller_radius * factor, zorder=0.5, **look))


_SUPPORT: dict[str, Any] = {"facecolor": "#d9d9d9", "edgecolor": GREY, "linewidth": 0.6}
_LOAD: dict[str, Any] = {
    "facecolor": "none", "edgecolor": GREY, "linewidth": 0.8, "linestyle": (0, (3, 1.5))
}  # fmt: skip
_LEAST_BESIDE = 1e-5
"""Distance of markers from the axis that is worth a word, m."""


def _beside_words(result: TestResult, shape: Shape, rig: Rig) -> str:
    """Say that markers lie beside the curve, which is the axis of a clamped specimen."""
    is_clamped = bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())
    if not is_clamped or abs(rig.centre_offset) < _LEAST_BESIDE or not shape.coefficients.shape[2]:
        return ""
    way = scale(result, "displacement", "m")
    return (
        f"Centres of markers lie {abs(rig.centre_offset) * way.factor:.3g} {way.unit} beside the"
        " axis, which is the curve."
    )


def plot_shapes(result: TestResult, axes: Axes, *, plane: int = 1) -> None:
    """Draw markers and fitted curves at equal steps of the tip, at equal axis scale.

    Parameters
    ----------
    result : its shape is drawn
    axes : to draw on; an explaining sentence if there is no shape
    plane : axis that is drawn upwards: 1 for y, in the plane of bending; 2 for z, out of it
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        say(axes, why_missing(result, "shape"))
        return
    steps, rig = choose_frames(result, shape), rig_of(result)
    way = scale(result, "displacement", "m")
    if plane == 1:
        _draw_rollers(axes, shape, steps, rig, way.factor)
    for frame, colour in zip(steps.frames, _colours(len(steps.frames)), strict=True):
        x, up = _fitted(shape, int(frame))[[0, plane]] * way.factor
        axes.plot(x, up, color=colour, linewidth=0.9, zorder=1)
        for flag in _LOOKS:
            mine = shape.flags[frame] == flag
            if not mine.any():
                continue
            x, up = shape.positions[frame][mine][:, [0, plane]].T * way.factor
            axes.plot(x, up, color=colour, **_look(flag, colour))
    axes.set_xlim(*(end * way.factor for end in _limits(shape, steps, 0, rig)))
    axes.set_ylim(*(end * way.factor for end in _limits(shape, steps, plane, rig)))
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlabel(way.label("x"))
    axes.set_ylabel(way.label("xyz"[plane]))


def _fitted(shape: Shape, frame: int) -> Floats:
    """Points on the fitted curve, shape (3, points), m; none where no curve was fitted."""
    terms = shape.coefficients.shape[2]
    along = np.linspace(0, 1, 81 if terms else 0)
    curve: Floats = shape.coefficients[frame] @ along[None, :] ** np.arange(terms)[:, None]
    return curve


def _look(flag: PointFlag, colour: str) -> dict[str, Any]:
    sign, full = _LOOKS[flag]
    return {
        "marker": sign,
        "linestyle": "",
        "markersize": 3.4,
        "markerfacecolor": colour if full else "white",
        "label": flag.name.lower(),
    }


def _colours(count: int) -> list[str]:
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    colour_map = mpl.colormaps[mpl.rcParams["image.cmap"]]
    return [to_hex(colour_map(0.85 * place)) for place in np.linspace(0, 1, count)]


def _sign_keys(shape: Shape, steps: Steps, rig: Rig) -> list[Artist]:
    """Name the signs that are drawn."""
    from matplotlib.lines import Line2D

    present = set(np.unique(shape.flags[steps.frames]))
    handles: list[Artist] = [
        Line2D([], [], color=GREY, **_look(flag, GREY)) for flag in _LOOKS if flag in present
    ]
    if shape.coefficients.shape[2]:
        handles.append(line_key("fitted curve", color=GREY, linewidth=0.9))
    if _supports(rig):
        handles.append(area_key("supports", **_SUPPORT))
        handles.append(area_key("load, first and last", **_LOAD))
    return handles


def _name_steps(result: TestResult, axes: Axes, steps: Steps) -> None:
    """Say beside the panel how far the tip had come at each shape."""
    way = scale(result, "displacement", "m")
    levels = [
        line_key(f"{level * way.factor:g} {way.unit}", color=colour, linewidth=1.6)
        for level, colour in zip(steps.levels, _colours(len(steps.levels)), strict=True)
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
_COLUMNS = 900
_MM_PER_ROW = 4.2
_HALF_ROW = 0.36


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
    from matplotlib.collections import PolyCollection

    mine = _is_marker(shape)
    names = [name for name, is_marker in zip(shape.names, mine, strict=True) if is_marker]
    flags = worst(shape.flags[:, mine], _rank(), bins=_COLUMNS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    edges *= scale(result, "time", "s").factor
    for flag, colour in FLAG_COLOURS.items():
        axes.add_collection(
            PolyCollection(list(_bars(flags == flag, edges)), color=colour, linewidth=0)
        )
    axes.autoscale_view()
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.margins(x=0.01)
    _name_flags(axes, set(np.unique(flags)))


def _name_flags(axes: Axes, present: set[int]) -> None:
    handles = [
        area_key(flag.name.lower(), color=colour)
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


def _bars(inside: NDArray[np.bool_], edges: Floats) -> Floats:
    """Corners of a bar for each stretch of columns, row by row, shape (bars, 4, 2)."""
    rows, steps = np.nonzero(np.diff(inside.T.astype(np.int8), axis=1, prepend=0, append=0))
    left, right = edges[steps[::2]], edges[steps[1::2]]
    low, high = rows[::2] - _HALF_ROW, rows[::2] + _HALF_ROW
    corners = ((left, low), (left, high), (right, high), (right, low))
    return np.stack([np.column_stack(corner) for corner in corners], axis=1)
