"""Make the figures of a test that show shapes, marker tracking and uncertainty budgets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor, log10
from typing import Any, NamedTuple

import numpy as np

from labpipe.errors import ProtocolError
from labpipe.messages import format_sentence
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats, Ints
from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval, PointFlag, Shape
from labpipe.records.group import Group
from labpipe.records.result import TestResult
from labpipe.report import plot_records as plots
from labpipe.report import wording
from labpipe.report.figure_page import GREY, read_looks, sample_colour_map
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, make_key_entry, make_line
from labpipe.report.wording import Scale, explain_missing, find_unit
from labpipe.statistics.means import sort_causes, summarise_budget

_FLAG_MARKS: dict[PointFlag, Any] = {
    PointFlag.MEASURED: {"marker": "o"},
    PointFlag.RELABELLED: {"marker": "s"},
    PointFlag.FILLED: {"marker": "o", "markerfacecolor": "white"},
    PointFlag.CONSTRUCTED: {"marker": "D", "markerfacecolor": "white"},
}
"""Symbol of a marker, keyed by the origin of its position."""

_EXCURSION = "tip excursion"
"""Name of the distance of the tip from its first position, used without a loading branch."""


@dataclass(frozen=True, slots=True)
class FrameSelection:
    """Frames whose shapes are drawn.

    Parameters
    ----------
    frames : shape (n,), numbers of the frames, in order
    deflections : shape (n,), nominal deflection of the tip in each frame, m
    deflection_name : name of the deflection in the key
    """

    frames: Ints
    deflections: Floats
    deflection_name: str


def make_wire_shapes_page(result: TestResult) -> Page:
    """Make the page of shapes in the plane of bending; in two planes without a loading branch."""
    panel_width_mm, frame_mm, gap_mm = 144.0, 17.0, 14.0
    shape = result.shape
    if shape is None or not len(shape.time):
        empty_plot = plots.make_empty_plot(explain_missing(result, "shape"))
        return plots.make_test_page(result, "wire-shapes", [empty_plot])
    selection = choose_shape_frames(result, shape)
    scale = find_unit(result.display, "displacement")
    names = "xyz" if selection.deflection_name == _EXCURSION else "xy"
    x_axis, *side_axes = [_make_axis(shape, selection, scale, name) for name in names]
    panels, heights = [], []
    for side_axis in side_axes:
        lines = list(draw_shapes(shape, selection, scale, axis="xyz".index(side_axis.name)))
        heading = f"x-{side_axis.name} view" if len(side_axes) > 1 else ""
        panels.append(Plot(x_axis, side_axis, lines, heading, is_to_scale=True))
        aspect = (side_axis.high - side_axis.low) / (x_axis.high - x_axis.low)
        heights.append(panel_width_mm * aspect)
    height = sum(heights) + frame_mm + gap_mm * (len(side_axes) - 1)
    layout: dict[str, Any] = {"height": height, "heights": heights, "columns": 1}
    note = _describe_offset(result, shape)
    return plots.make_test_page(result, "wire-shapes", panels, note, **layout)


def choose_shape_frames(result: TestResult, shape: Shape) -> FrameSelection:
    """Choose frames at equal, round steps of the deflection of the tip.

    Parameters
    ----------
    result : result of the test. The deflection is that of its first loading branch; without a
        loading branch, it is the distance of the tip from its first position
    shape : shape of at least one frame

    Returns
    -------
    At most seven frames from deflection zero upwards. If no deflection is known, only the first
    frame is chosen.
    """
    deflection, name = _find_tip_deflection(result, shape)
    if np.isnan(deflection).all():
        return FrameSelection(np.zeros(1, dtype=np.int64), np.zeros(1), name)
    scale = find_unit(result.display, "displacement")
    return FrameSelection(*choose_frames_at_steps(deflection, scale.factor), name)


def choose_frames_at_steps(deflection: Floats, factor: float = 1.0) -> tuple[Ints, Floats]:
    """Choose frames at equal, round steps of a deflection.

    Parameters
    ----------
    deflection : shape (n_frames,), m; NaN in frames that are left out
    factor : factor from m to the unit in which the steps are round

    Returns
    -------
    frames : shape (n,), first frame at or beyond each step, because later frames may belong to
        another motion
    deflections : shape (n,), deflection of each step, m; at most seven, from zero upwards
    """
    max_steps = 6
    largest = factor * float(np.max(deflection, initial=0.0, where=~np.isnan(deflection)))
    decade = 10.0 ** floor(log10(largest / max_steps)) if largest > 0.0 else 1.0
    step = next(n * decade for n in (1.0, 2.0, 5.0, 10.0) if n * decade * max_steps >= largest)
    deflections = np.linspace(0.0, max_steps * step / factor, max_steps + 1)
    frames_beyond = [np.flatnonzero(deflection >= level - 1e-12) for level in deflections]
    frames = np.array([beyond[0] for beyond in frames_beyond if len(beyond)], dtype=np.int64)
    return frames, deflections[: len(frames)]


def _find_tip_deflection(result: TestResult, shape: Shape) -> tuple[Floats, str]:
    """Return the deflection of the tip in every frame, m, and its name.

    The deflection is NaN outside the first loading branch. Without a loading branch, it is the
    distance of the tip from its first position. The tip is the last point that has a position in
    at least one frame.
    """
    deflection = find_loading_deflection(result, shape.time)
    if deflection is None:
        tracked_points = np.flatnonzero(~np.isnan(shape.positions).any(axis=2).all(axis=0))
        tip = shape.positions[:, tracked_points[-1] if len(tracked_points) else -1]
        tracked_frames = np.flatnonzero(~np.isnan(tip).any(axis=1))
        start = tip[tracked_frames[0]] if len(tracked_frames) else np.full(3, np.nan)
        distance: Floats = np.linalg.norm(tip - start, axis=1)
        return distance, _EXCURSION
    return deflection, "tip deflection" if _is_clamped(shape) else "deflection"


def find_loading_deflection(result: TestResult, time: Floats) -> Floats | None:
    """Interpolate the displacement of the curve at the frames of its first loading branch.

    Parameters
    ----------
    result : result of the test, with or without a curve
    time : shape (n_frames,), time of the frames on the clock of the curve, s

    Returns
    -------
    Displacement, shape (n_frames,), m; NaN outside the branch. None without a loading branch.
    """
    curve = result.curve
    loading = None if curve is None else curve.first_loading
    if curve is None or loading is None:
        return None
    deflection: Floats = np.interp(time, curve.time, curve.displacement)
    deflection[(time < loading.start_time) | (time > loading.stop_time)] = np.nan
    return deflection


def _is_clamped(shape: Shape) -> bool:
    """Return whether the first point of a shape is constructed: the specimen is then clamped."""
    return bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())


def _make_axis(shape: Shape, selection: FrameSelection, scale: Scale, name: str) -> Axis:
    """Make an axis that includes all drawn points and fitted curves, with a margin."""
    margin = 0.04  # fraction of the length of the specimen
    min_aspect = 0.1  # smallest height of a panel, as a fraction of the length of the specimen
    axis_index = "xyz".index(name)
    curves = [_compute_fitted_curve(shape, int(frame))[axis_index] for frame in selection.frames]
    values = np.concatenate([shape.positions[selection.frames, :, axis_index].ravel(), *curves])
    values = values[np.isfinite(values)] if np.isfinite(values).any() else np.zeros(1)
    middle, half_range = float(values.max() + values.min()) / 2, float(np.ptp(values)) / 2
    half_range = max(half_range, min_aspect * shape.length / 2) + margin * shape.length
    return Axis(name, scale, middle - half_range, middle + half_range)


def _describe_offset(result: TestResult, shape: Shape) -> str:
    """State the offset of the markers from the axis of a clamped specimen; empty if negligible."""
    min_offset = 1e-5  # m; a smaller offset is not visible in the figure
    has_curve = bool(shape.coefficients.shape[2])
    centre_offset = abs(read_centre_offset(result))
    if not _is_clamped(shape) or centre_offset < min_offset or not has_curve:
        return ""
    scale = find_unit(result.display, "displacement")
    offset = centre_offset * scale.factor
    return format_sentence("report.markers_beside_axis", offset=offset, unit=scale.unit)


def draw_shapes(
    shape: Shape, selection: FrameSelection, scale: Scale, *, axis: int
) -> Iterator[Line]:
    """Yield the points and fitted curves of selected frames, and their entries in the key.

    Parameters
    ----------
    shape : points and fitted curves of all frames
    selection : frames that are drawn
    scale : display unit of displacements, for the key
    axis : vertical axis: 1 for y, in the plane of bending; 2 for z, out of plane
    """
    colours, frames = sample_colour_map(len(selection.frames)), selection.frames.tolist()
    for frame, deflection, colour in zip(frames, selection.deflections, colours, strict=True):
        curve = _compute_fitted_curve(shape, frame)[[0, axis]]
        yield make_line("fitted_curve", *curve, color=colour)
        for flag, mark in _FLAG_MARKS.items():
            rows = shape.flags[frame] == flag
            if rows.any():
                x, y = shape.positions[frame][rows][:, [0, axis]].T
                yield make_line("marker", x, y, color=colour, **mark)
        text = f"{deflection * scale.factor:g} {scale.unit}"
        label = f"{selection.deflection_name} {text}" if frame == frames[0] else text
        yield make_key_entry("fitted_curve", label=label, color=colour, linewidth=1.6)
    drawn_flags = set(np.unique(shape.flags[frames]))
    for flag, mark in _FLAG_MARKS.items():
        if flag in drawn_flags:
            yield make_key_entry("marker", label=flag.name.lower(), **mark)
    if shape.coefficients.shape[2]:
        yield make_key_entry("fitted_curve", label="fitted curve")


def _compute_fitted_curve(shape: Shape, frame: int) -> Floats:
    """Compute points on the fitted curve, shape (3, n_points), m; no points without a curve."""
    n_terms = shape.coefficients.shape[2]
    parameter = np.linspace(0, 1, 81 if n_terms else 0)  # arc length over the total length
    curve: Floats = shape.coefficients[frame] @ parameter[None, :] ** np.arange(n_terms)[:, None]
    return curve


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
"""Flags of points in order of severity; the worst is last."""
_TIME_BINS = 900
"""Largest number of bins in time, about one per pixel."""


def make_marker_quality_page(result: TestResult) -> Page:
    """Make the page of the flags of each marker and of the error of each body against time."""
    row_mm, min_panel_mm, frame_mm = 4.2, 25.0, 30.0
    times = [take.markers.time for take in result.recordings.values() if take.markers]
    times = times if result.shape is None else [result.shape.time, *times]
    time = plots.make_axis("Time", find_unit(result.display, "time"), times, margin=0.01)
    flags, tracking = make_flag_plot(result, time), _make_tracking_plot(result, time)
    heights = [max(row_mm * len(flags.y.row_names), min_panel_mm), min_panel_mm]
    return plots.make_test_page(
        result, "marker-quality", [flags, tracking], columns=1, shared_axes="x",
        height=sum(heights) + frame_mm, heights=heights,
    )  # fmt: skip


def make_flag_plot(result: TestResult, time: Axis) -> Plot:
    """Make the panel with a row for each marker, coloured by the origin of its position.

    Parameters
    ----------
    result : result of the test; constructed points have no row. Without a shape, the panel states
        the reason
    time : horizontal axis

    Notes
    -----
    Each bin in time shows the worst flag of its frames, so that short gaps are visible.
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        return Plot(time, Axis(), reason=explain_missing(result, "shape"))
    is_marker = ~(shape.flags == PointFlag.CONSTRUCTED).all(axis=0)
    names = tuple(name for name, drawn in zip(shape.names, is_marker, strict=True) if drawn)
    flags = plots.thin_flags(shape.flags[:, is_marker], _FLAGS_BY_RANK, n_bins=_TIME_BINS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    bars = []
    for flag, colour in FLAG_COLOURS.items():
        is_flagged = (flags == flag).T.astype(np.int8)
        # along a row, each run of flagged bins has one change where it begins and one where it ends
        rows, bins = np.nonzero(np.diff(is_flagged, axis=1, prepend=0, append=0))
        if len(rows):
            ends = edges[bins[::2]], edges[bins[1::2]]
            look: dict[str, Any] = {"height": 0.72, "label": flag.name.lower(), "color": colour}
            bars.append(plots.make_bars("flag", *ends, rows[::2], **look))
    return Plot(time, Axis(low=0.5 - len(names), high=0.5, row_names=names), bars)


def _make_tracking_plot(result: TestResult, time: Axis) -> Plot:
    """Make the panel of the mean marker error of each body, or of the number of visible markers.

    The first recording with marker tracks is drawn; without any, the panel states the reason.
    """
    takes = (recording.markers for recording in result.recordings.values())
    tracks = next(filter(None, takes), None)
    if tracks is None or not len(tracks.time):
        return Plot(time, Axis(), reason=explain_missing(result, "take"))
    errors = []
    for number, body in enumerate(tracks.bodies):
        if np.isfinite(body.error).any():
            settings = {"label": body.name, "color": f"C{number}"}
            error = plots.make_thinned_line(
                "body_error", tracks.time, body.error, n_bins=_TIME_BINS, **settings
            )
            errors.append(error)
    if errors:
        scale = find_unit(result.display, "displacement")
        return Plot(time, Axis("Body error", scale, low=0.0), errors)
    counts = (~np.isnan(tracks.positions).any(axis=2)).sum(axis=1).astype(np.float64)
    line = plots.make_thinned_line("visible_markers", tracks.time, counts, n_bins=_TIME_BINS)
    return Plot(time, Axis("Visible markers", low=0.0, high=len(tracks.names) + 0.5), [line])


def read_centre_offset(result: TestResult) -> float:
    """Read the distance of the markers from the axis in the protocol of a test, m; 0 if unknown."""
    try:
        markers = parse_protocol(result.protocol_yaml, result.test).markers
    except ProtocolError:
        return 0.0
    return 0.0 if markers is None else markers.centre_offset


MAX_BARS = 20
"""Largest number of bars in a panel."""
SMALL_CAUSES = "causes under 2 % in every bar"
"""Name of the sum of the shares of small causes."""


class BudgetBar(NamedTuple):
    """The uncertainty budget of one number, drawn as a bar.

    Parameters
    ----------
    name : text left of the bar
    shares : share of the variance that each cause contributes, keyed by cause; the sum is one.
        Empty for a row without a bar
    text : text right of the bar
    """

    name: str
    shares: Mapping[str, float]
    text: str = ""


def make_budget_page(result: TestResult) -> Page:
    """Make the page of the uncertainty budgets of a test: a bar of shares for each number.

    Parameters
    ----------
    result : result of the test. The first `MAX_BARS` numbers with a budget have a bar, except those
        of later cycles, of single slips, of the clocks and of the force limit

    Returns
    -------
    A page; without any bar, a page that gives the reason.
    """
    row_mm, frame_mm = 6.0, 26.0
    results = (entry for entry in result.results if _has_bar(entry.name))
    numbers = [number for number in results if number.largest_share is not None][:MAX_BARS]
    bars = []
    for number in numbers:
        scale = wording.find_scale(number.name, number.unit, result.display)
        causes = [contribution.cause for contribution in number.budget]
        shares = dict(zip(causes, number.shares, strict=True))
        half_width = write_half_width(number.interval, scale)
        bars.append(BudgetBar(_write_bar_label(number.name), shares, half_width))
    panel = make_budget_plot(bars)
    if not bars:
        panel = plots.make_empty_plot(format_sentence("report.no_budget"))
    has_cycles = any("." in number.name for number in numbers)
    note = "Numbers per cycle: first cycle only." if has_cycles else ""
    height = frame_mm + row_mm * len(bars)
    return plots.make_test_page(result, "uncertainty-budget", [panel], note, height=height)


def _has_bar(name: str) -> bool:
    return wording.is_main(name) and wording.is_first_cycle(name)


def _write_bar_label(name: str) -> str:
    """Write the label of a number without its cycle, because all bars show the first cycle."""
    return wording.write_label(name.partition(".")[0])


def write_half_width(interval: Interval | None, scale: wording.Scale) -> str:
    """Write the half-width of an interval, such as ``± 0.11 mm``; empty without an interval."""
    if interval is None:
        return ""
    half_width = 0.5 * abs(scale.factor) * (interval.upper - interval.lower)
    text = wording.write_number(half_width, None, digits=2).value
    return f"\u00b1 {text} {scale.unit}".strip()


def make_budget_plot(bars: Sequence[BudgetBar]) -> Plot:
    """Make the plot of bars, the first on top; causes common to all tests of a rig are hatched.

    Parameters
    ----------
    bars : budgets of the numbers; a bar without shares leaves its row empty
    """
    sorted_shares = sort_shares([bar.shares for bar in bars])
    causes = list_drawn_causes(sorted_shares)
    parts: dict[str, list[tuple[float, float, int]]] = {cause: [] for cause in causes}
    labels = [Label("95 %", np.inf, 0.8, (6.0, 0.0), {"color": GREY})]
    for row, (bar, shares) in enumerate(zip(bars, sorted_shares, strict=True)):
        labels.append(Label(bar.text, np.inf, -row, (6.0, 0.0)))
        ends = np.cumsum([0.0, *shares.values()])
        for cause, start, stop in zip(shares, ends[:-1], ends[1:], strict=True):
            parts[cause].append((start, stop, row))
            labels += _label_share(cause, start, stop, row)
    lines = [_make_share_bars(cause, *np.array(parts[cause]).T) for cause in causes]
    if any(IS_COMMON.get(cause, False) for cause in causes):
        lines.append(plots.make_key_entry("common_cause", is_closed=True))
    row_axis = Axis(low=0.5 - len(bars), high=0.5, row_names=tuple(bar.name for bar in bars))
    share_axis = Axis("Share of the variance", wording.Scale(100.0, "%"), 0.0, 1.0)
    return Plot(share_axis, row_axis, lines, labels=labels)


def _make_share_bars(cause: str, left: Floats, right: Floats, rows: Floats) -> Line:
    """Make the segments of all bars that show one cause."""
    look = "common_cause" if IS_COMMON.get(cause, False) else "cause"
    settings = {"label": cause, "facecolor": find_cause_colour(cause)}
    return plots.make_bars(look, left, right, rows, height=0.74, **settings)


def _label_share(cause: str, start: float, stop: float, row: int) -> Iterator[Label]:
    """Label a segment of a bar with its share; on a hatched segment, with a plain background."""
    min_labelled_share = 0.10  # a smaller segment is too narrow for its number
    max_dark_brightness = 0.45  # on a darker segment, white text is easier to read than black
    if stop - start < min_labelled_share:
        return
    colour = find_cause_colour(cause)
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    is_dark = 0.3 * red + 0.59 * green + 0.11 * blue < 255 * max_dark_brightness
    settings: dict[str, Any] = {"ha": "center", "color": "white" if is_dark else "black"}
    if IS_COMMON.get(cause, False):
        settings["bbox"] = {"facecolor": colour, "edgecolor": "none", "pad": 1.0}
    yield Label(f"{100 * (stop - start):.0f}", (start + stop) / 2, -row, settings=settings)


def find_cause_colour(cause: str) -> str:
    """Find the colour of a cause in all figures; light grey for an unknown cause."""
    colour: str = read_looks()["colours_of_causes"].get(cause, "#ededed")
    return colour


def sort_shares(bar_shares: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Sort the shares of bars in the order of the key, and add up those of small causes.

    Parameters
    ----------
    bar_shares : shares of each bar, keyed by cause

    Returns
    -------
    Sorted shares of each bar. The last one, `SMALL_CAUSES`, is the sum of the causes that have less
    than 2 % in every bar.
    """
    min_share = 0.02
    items = (item for shares in bar_shares for item in shares.items())
    large_causes = {cause for cause, share in items if share >= min_share}
    all_sorted_shares = []
    for shares in bar_shares:
        sorted_shares = {cause: shares[cause] for cause in sort_causes(large_causes & set(shares))}
        small_share = sum(share for cause, share in shares.items() if cause not in large_causes)
        if small_share > 0.0:
            sorted_shares[SMALL_CAUSES] = small_share
        all_sorted_shares.append(sorted_shares)
    return all_sorted_shares


def list_drawn_causes(bar_shares: Sequence[Mapping[str, float]]) -> list[str]:
    """List the causes that bars show, in the order of the key; `SMALL_CAUSES` is last.

    Parameters
    ----------
    bar_shares : shares of each bar, from `sort_shares`
    """
    causes = {cause for shares in bar_shares for cause in shares}
    small_causes = [SMALL_CAUSES] if SMALL_CAUSES in causes else []
    return [*sort_causes(causes - {SMALL_CAUSES}), *small_causes]


def make_group_bars(group: Group, *, of_means: bool) -> list[BudgetBar]:
    """Make the bars of the budgets of a group.

    Parameters
    ----------
    group : group of samples; may be empty
    of_means : true for the shares of the means, with the half-widths of their intervals; false for
        the medians of the shares of the tests, without half-widths

    Returns
    -------
    At most `MAX_BARS` bars, of the numbers that have a budget in a test. Numbers of later cycles,
    of single slips, of the clocks and of the force limit have none. A mean without an interval has
    a bar without shares.
    """
    bars = []
    for number in group.numbers:
        budget, scale = summarise_budget(number), wording.find_number_scale(group, number)
        if budget.test_shares and _has_bar(number.name):
            shares, interval = budget.test_shares, None
            if of_means:
                shares, interval = budget.mean_shares, number.mean.chosen.interval
            half_width = write_half_width(interval, scale)
            bars.append(BudgetBar(_write_bar_label(number.name), shares, half_width))
    return bars[:MAX_BARS]
