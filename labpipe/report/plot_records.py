"""Describe plots independently of the program that draws them, and thin their lines.

A plot consists of axes and lines in SI units, with the names of their looks. The template
``plots.html`` draws a `Plot` as SVG on the page of a report. `figure_page` draws a `Page` of plots
with matplotlib in a file. On the page of a report, the coordinates of a line are integers from 0
to 65535 between the ends of an axis. The script of the page computes the values from them.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, inf, isfinite, log10, nan
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Interval
from labpipe.report.wording import Scale

GRID_SIZE = 65535
"""Largest integer coordinate between the ends of an axis on the page of a report."""
PLAIN_NUMBER = Scale(1.0, "")
"""Scale of a number without a unit."""


@dataclass(frozen=True, slots=True)
class Axis:
    """Axis of a plot.

    Parameters
    ----------
    name : typeset name of the quantity
    scale : unit in which the quantity is shown
    low, high : values at the ends of the axis, SI; NaN for a range that includes all lines
    row_names : names of the rows at 0, -1, -2 and so on, instead of numbers. Files show them; the
        page does not
    is_log : whether the axis is logarithmic; not on the page of a report
    """

    name: str = ""
    scale: Scale = PLAIN_NUMBER
    low: float = nan
    high: float = nan
    row_names: tuple[str, ...] = ()
    is_log: bool = False

    @property
    def label(self) -> str:
        """Name of the quantity and its unit, such as ``Force (N)``."""
        return self.scale.label(self.name) if self.name else ""

    @property
    def ends(self) -> tuple[float, float]:
        """Values at the ends, in the unit of the axis."""
        return self.scale.factor * self.low, self.scale.factor * self.high

    def choose_ticks(self, max_steps: int) -> list[tuple[float, str]]:
        """Choose round numbers for the ticks of the axis.

        Parameters
        ----------
        max_steps : largest number of steps between the ends of the axis

        Returns
        -------
        Position of each tick, from 0 at the low end to 1 at the high end, and its text. The list is
        empty for an axis with row names.

        Raises
        ------
        ValueError
            If the low end is not below the high end.

        Examples
        --------
        >>> [text for _, text in Axis("Force", Scale(1.0, "N"), -0.4, 10.4).choose_ticks(6)]
        ['0', '2', '4', '6', '8', '10']
        """
        tolerance = 1e-12  # in steps; without it, rounding could omit a tick at an end
        if self.row_names:
            return []
        low, high = self.ends
        decade = 10.0 ** floor(log10((high - low) / max_steps))
        steps = (multiple * decade for multiple in (1.0, 2.0, 2.5, 5.0, 10.0))
        step = next(step for step in steps if step * max_steps >= high - low)
        first, last = np.ceil(low / step - tolerance), np.floor(high / step + tolerance)
        values = [multiple * step for multiple in range(int(first), int(last) + 1)]
        texts = [f"{value:.6g}".replace("-", "\u2212") for value in values]
        return [
            ((value - low) / (high - low), text) for value, text in zip(values, texts, strict=True)
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Line, area or sequence of points of a plot.

    Parameters
    ----------
    look : name of the look in ``looks.toml`` and of the class on the page, such as ``curve``, or
        ``curve c2`` with the number of a colour
    x, y : shape (n,), SI; NaN interrupts the line, an infinite value is at an end of the axis
    test : row of the test in the table of tests of the page, from 0; None if the line does not
        belong to a single test
    group : stem of the file names of the group; empty if the plot shows a single group
    is_closed : whether each part is the outline of an area
    settings : settings of matplotlib that override those of the look
    values : shape (n,), SI, values that the colours of the line represent; None for a single colour
    """

    look: str
    x: Floats
    y: Floats
    test: int | None = None
    group: str = ""
    is_closed: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    values: Floats | None = None

    def format_path(self, x: Axis, y: Axis) -> str:
        """Format the line as an SVG path in integer coordinates, interrupted at gaps.

        Parameters
        ----------
        x, y : axes of the plot. A point that is further beyond an axis than the length of the axis
            is moved to this distance

        Examples
        --------
        >>> axis = Axis("", PLAIN_NUMBER, 0.0, 65535.0)
        >>> make_line("curve", [0.0, 9.0, 10.0], [5.0, 5.0, 9.0]).format_path(axis, axis)
        'M0 65530l9 0 1-4'
        """
        closing = "z" if self.is_closed else ""
        grid = _convert_to_grid(self.x, x), GRID_SIZE - _convert_to_grid(self.y, y)
        segments = split_at_gaps(*grid)
        return "".join(_format_segment(segment) + closing for segment in segments)


_GAP = np.full((1, 2), nan)
"""Point that interrupts a line."""


def split_at_gaps(x: Floats, y: Floats) -> list[Floats]:
    """Split a line at NaN into segments, shape (n_points, 2) each."""
    points = np.column_stack([x, y])
    is_missing = np.isnan(points).any(axis=1)
    segments = np.split(points, np.flatnonzero(np.diff(is_missing)) + 1)
    return [segment for segment in segments if len(segment) and not np.isnan(segment).any()]


def _convert_to_grid(values: Floats, axis: Axis) -> Floats:
    """Convert values, SI, to integer coordinates, at most one axis length beyond the axis."""
    coordinates: Floats = GRID_SIZE * (values - axis.low) / (axis.high - axis.low)
    return np.clip(np.rint(coordinates), -GRID_SIZE, 2 * GRID_SIZE)


def _format_segment(points: Floats) -> str:
    """Format grid points, shape (n, 2), as an SVG path: the first point, then relative steps."""
    start = "M{:.0f} {:.0f}".format(*points[0])
    steps = np.diff(points, axis=0).astype(np.int64).ravel().tolist()
    return f"{start}l{' '.join(map(str, steps))}".replace(" -", "-") if steps else f"{start}h0"


def make_line(
    look: str, x: ArrayLike, y: ArrayLike, *, is_closed: bool = False, **settings: Any
) -> Line:
    """Make a line of a figure; a single number for `x` or `y` applies to all points."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    return Line(look, x.ravel(), y.ravel(), is_closed=is_closed, settings=settings)


def make_thinned_line(
    look: str, x: Floats, y: Floats, *, n_bins: int = 350, **settings: Any
) -> Line:
    """Make a line of a figure from the extremes of `y` in bins of samples; see `find_extremes`."""
    rows = find_extremes(y, n_bins=n_bins)
    return make_line(look, x[rows], y[rows], **settings)


def make_horizontal_line(look: str, y: float, **settings: Any) -> Line:
    """Make a horizontal line across the plot."""
    return make_line(look, [-inf, inf], y, **settings)


def make_vertical_line(look: str, x: float, **settings: Any) -> Line:
    """Make a vertical line across the plot."""
    return make_line(look, x, [-inf, inf], **settings)


def make_area(look: str, x: Floats, lower: Floats, upper: Floats, **settings: Any) -> Line:
    """Make the area between two curves, with a gap wherever one of them is NaN."""
    # 0 * NaN gives both curves the same gaps
    lower_edges = split_at_gaps(x, lower + 0.0 * upper)
    upper_edges = split_at_gaps(x, upper + 0.0 * lower)
    outlines = [_GAP]
    for lower_edge, upper_edge in zip(lower_edges, upper_edges, strict=True):
        outlines += [lower_edge, upper_edge[::-1], _GAP]
    return make_line(look, *np.concatenate(outlines).T, is_closed=True, **settings)


def make_span(look: str, low: float, high: float, **settings: Any) -> Line:
    """Make the area between two values of the horizontal axis over the height of the plot."""
    outline = [low, high, high, low], [-inf, -inf, inf, inf]
    return make_line(look, *outline, is_closed=True, **settings)


def make_bars(
    look: str, left: Floats, right: Floats, rows: NDArray[Any], *, height: float, **settings: Any
) -> Line:
    """Make horizontal bars in rows of a plot.

    Parameters
    ----------
    look : look of the bars
    left, right : shape (n,), values of the horizontal axis at the ends of each bar, SI
    rows : shape (n,), index of the row of each bar, from 0; row 1 is at -1
    height : height of a bar, relative to the height of a row
    settings : settings of matplotlib that override those of the look
    """
    bottom, top = -rows - 0.5 * height, -rows + 0.5 * height
    outlines = join_with_gaps(left, left, right, right), join_with_gaps(bottom, top, top, bottom)
    return make_line(look, *outlines, is_closed=True, **settings)


def make_circles(look: str, x: ArrayLike, y: ArrayLike, radius: ArrayLike, **settings: Any) -> Line:
    """Make circular areas from their centres and radii, SI."""
    n_points = 90  # of each circle
    angle = np.append(np.linspace(0.0, 2.0 * np.pi, n_points), nan)
    centre_x, centre_y, radii = (np.atleast_1d(values)[:, None] for values in (x, y, radius))
    outlines = centre_x + radii * np.cos(angle), centre_y + radii * np.sin(angle)
    return make_line(look, *outlines, is_closed=True, **settings)


def make_legend_line(look: str, **settings: Any) -> Line:
    """Make a line that has an entry in the legend and draws nothing in the plot."""
    return make_line(look, [], [], **settings)


def join_with_gaps(*columns: ArrayLike) -> Floats:
    """Join columns row by row, with NaN after each row, which interrupts a line."""
    return np.column_stack([*columns, np.full(np.size(columns[0]), nan)]).ravel()


class Label(NamedTuple):
    """Text in a plot of a figure.

    Parameters
    ----------
    text : text of one or several lines
    x, y : position, SI; an infinite value is at an end of the axis
    offset : horizontal and vertical distance of the text from the position, points
    settings : settings of matplotlib for the text
    """

    text: str
    x: float
    y: float
    offset: tuple[float, float] = (0.0, 0.0)
    settings: Mapping[str, Any] = {}


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """Entry of the legend of a plot.

    Parameters
    ----------
    look : look of the line that is drawn in the entry
    label : text of the entry
    attribute : attribute by which the page finds the lines that the entry shows and hides: ``t``
        (test), ``class`` or ``group``; empty if the entry does not switch lines
    value : value of this attribute
    """

    look: str
    label: str
    attribute: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Plot on the page of a report, or panel of a figure.

    Parameters
    ----------
    x, y : horizontal and vertical axis
    lines : lines in the order of drawing; the last is on top
    heading : heading of the panel, for a figure of several panels
    labels : texts in the panel of a figure
    legend : entries of the legend; if there are none, a figure lists the labels of its lines
    reason : reason why there are no lines, which a figure shows instead of them
    is_to_scale : whether both axes of a figure have the same scale
    has_frame : whether a figure shows axes and labels
    kind : on a report: ``curves`` (force over displacement), ``means`` (mean curves of groups),
        ``moment`` (moment over curvature), ``numbers`` (one dot per result), ``scaled`` (force over
        peak force) or ``shapes`` (shapes of specimens)
    group : stem of the file names of the group; empty if the plot shows several groups
    title : alternative text of the plot
    caption : explanation below the plot on the page
    size : width and height of the area between the axes, points
    """

    x: Axis = Axis()
    y: Axis = Axis()
    lines: Sequence[Line] = ()
    heading: str = ""
    labels: Sequence[Label] = ()
    legend: Sequence[LegendEntry] = ()
    reason: str = ""
    is_to_scale: bool = False
    has_frame: bool = True
    kind: str = ""
    group: str = ""
    title: str = ""
    caption: str = ""
    size: tuple[int, int] = (640, 280)


SINGLE_COLUMN, DOUBLE_COLUMN = 120.0, 180.0
"""Widths of pages, mm. A narrow page is reduced to a column of 90 mm: text of 9 pt becomes 6.7 pt.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """Figure: plots with a title, a footnote and a common legend.

    Parameters
    ----------
    name : name of its files, without extension
    title : title of one line
    plots : panels, row by row
    note : footnote; may be empty
    height, width : size of title and panels on paper, mm; legend and footnote add to the height
    columns : largest number of panels side by side
    layout : arrangement of the panels ``a``, ``b`` and so on, row by row, instead of `columns`
    widths, heights : widths of columns and heights of rows, relative to each other; equal if empty
    shared_axes : axes that all panels have in common: ``x``, ``y``, ``xy`` or none
    legend_columns : number of columns of the legend; 0 for as many as fit
    colour_axis : axis of the values that the colours of lines represent; None if there are none
    caption, alt : description and alternative text in its files
    """

    name: str
    title: str
    plots: Sequence[Plot]
    note: str = ""
    height: float = 80.0
    width: float = DOUBLE_COLUMN
    columns: int = 2
    layout: str = ""
    widths: Sequence[float] = ()
    heights: Sequence[float] = ()
    shared_axes: str = ""
    legend_columns: int = 0
    colour_axis: Axis | None = None
    caption: str = ""
    alt: str = ""


def make_axis(name: str, scale: Scale, values: Iterable[Floats], *, margin: float = 0.03) -> Axis:
    """Make an axis that shows all values, with a margin at both ends.

    Parameters
    ----------
    name, scale : typeset name and unit of the quantity
    values : arrays in SI; values that are not finite are ignored. Without finite values, the axis
        shows 0 to 1
    margin : margin at each end, as a fraction of the range of the values
    """
    low, high = _compute_range(np.concatenate([np.zeros(0), *values]))
    margin_width = margin * ((high - low) or abs(high) or 1.0)
    return Axis(name, scale, low - margin_width, high + margin_width)


def make_axes_to_scale(
    names: Sequence[str], scale: Scale, points: Floats, *, min_aspect: float, margin: float = 0.06
) -> tuple[Axis, ...]:
    """Make axes that show all points at one scale.

    Parameters
    ----------
    names : typeset name of each axis
    scale : unit of the axes
    points : shape (n, n_axes), m; points that are not finite are ignored
    min_aspect : smallest length of an axis before the margin, relative to the longest axis
    margin : margin at each end, as a fraction of the longest axis
    """
    ends = np.array([_compute_range(column) for column in points.T])
    half_ranges = 0.5 * np.ptp(ends, axis=1)
    largest = float(half_ranges.max()) or 0.5 / scale.factor  # one display unit for equal points
    half_ranges = np.maximum(half_ranges, min_aspect * largest) + 2.0 * margin * largest
    middles = ends.mean(axis=1)
    limits = (middles - half_ranges).tolist(), (middles + half_ranges).tolist()
    return tuple(
        Axis(name, scale, low, high) for name, low, high in zip(names, *limits, strict=True)
    )


def _compute_range(values: ArrayLike) -> tuple[float, float]:
    """Compute the lowest and the highest finite value; 0 and 1 if no value is finite."""
    finite = np.extract(np.isfinite(values), values)
    return (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)


def clip_range(
    values: ArrayLike, interval_ends: ArrayLike, max_extension: float
) -> tuple[float, float]:
    """Compute a range that includes all values, and intervals up to a limit beyond the values.

    Wide intervals are cut off, so that the values remain distinguishable.

    Parameters
    ----------
    values : values to show; without finite values, the range includes 0 and 1. Numbers that are
        not finite are ignored here and in `interval_ends`
    interval_ends : ends of intervals or bands
    max_extension : largest extension of the range beyond the values at each end, as a fraction of
        the range of the values. It does not apply if all values are equal
    """
    low, high = _compute_range(values)
    extension = max_extension * (high - low) if high > low else inf
    lowest, highest = _compute_range(np.append(interval_ends, [low, high]))
    return max(lowest, low - extension), min(highest, high + extension)


class MeanStrip(NamedTuple):
    """Positions for the drawing of a mean in a cell of a table, pixels.

    The scale of the drawing extends from 0 to 120.

    Parameters
    ----------
    mean : position of the mean; None without a mean
    bar : positions of the ends of the interval of the mean; empty without an interval
    dots : positions of the samples
    """

    mean: int | None
    bar: tuple[int, ...]
    dots: tuple[int, ...]


def make_mean_strip(
    ends: tuple[float, float], interval: Interval | None, mean: float, samples: Sequence[float] = ()
) -> MeanStrip:
    """Make the drawing of a mean, its interval and its samples.

    Parameters
    ----------
    ends : values at the ends of the scale; a value outside is drawn at most 2 % beyond the end
    interval : interval of the mean; None without an interval
    mean : mean; NaN without a mean
    samples : values of the samples; values that are not finite are ignored
    """
    strip_width = 120

    def convert_to_pixel(value: float) -> int:
        fraction = (value - ends[0]) / ((ends[1] - ends[0]) or 1.0)
        return round(strip_width * min(max(fraction, -0.02), 1.02))

    bar: tuple[int, ...] = ()
    if interval is not None and isfinite(interval.lower + interval.upper):
        bar = convert_to_pixel(interval.lower), convert_to_pixel(interval.upper)
    dots = tuple(convert_to_pixel(value) for value in samples if isfinite(value))
    return MeanStrip(convert_to_pixel(mean) if isfinite(mean) else None, bar, dots)


def format_sparkline(x: Floats, y: Floats) -> str:
    """Format a small curve without axes as an SVG path that fills its drawing area."""
    x_axis = make_axis("", PLAIN_NUMBER, [x], margin=0.0)
    y_axis = make_axis("", PLAIN_NUMBER, [y], margin=0.05)
    return Line("", x, y).format_path(x_axis, y_axis)


_Segment: TypeAlias = tuple[float, int, int, int]
"""Segment of a line in a heap.

Minus the largest distance of a sample from the chord; the indices of the first sample, of the
sample at this distance, and of the last sample.
"""


def find_extremes(values: Floats, *, n_bins: int) -> Ints:
    """Find the samples that preserve the extremes and gaps of a thinned line.

    Parameters
    ----------
    values : shape (n,), in the order of drawing
    n_bins : largest number of bins, which have equal numbers of samples

    Returns
    -------
    Sorted indices of the lowest and the highest sample of each bin, of the first NaN of each bin,
    and of both ends of the line. All indices are returned if there are at most four samples per
    bin.
    """
    n_samples = len(values)
    if n_samples <= 4 * n_bins:
        return np.arange(n_samples, dtype=np.int64)
    bin_size = -(-n_samples // n_bins)
    padding = np.repeat(values[-1:], -n_samples % bin_size)
    bins = np.append(values, padding).reshape(-1, bin_size)
    is_missing, starts = np.isnan(bins), bin_size * np.arange(len(bins))
    lowest = starts + np.where(is_missing, inf, bins).argmin(axis=1)
    highest = starts + np.where(is_missing, -inf, bins).argmax(axis=1)
    first_missing = (starts + is_missing.argmax(axis=1))[is_missing.any(axis=1)]
    rows = np.concatenate([lowest, highest, first_missing, [0, n_samples - 1]])
    return np.unique(np.minimum(rows, n_samples - 1))


def find_shape_samples(
    positions: Floats, values: Floats, *, max_points: int, tolerance: float = 0.002
) -> Ints:
    """Find the samples that preserve the shape of a line.

    Parameters
    ----------
    positions, values : shape (n,), coordinates in the order of drawing; NaN interrupts the line
    max_points : largest number of samples; the ends of gaps are kept even if there are more
    tolerance : largest difference of a value from the line through the kept samples, as a fraction
        of the range of the values; it may be exceeded if `max_points` is reached

    Returns
    -------
    Sorted indices of the kept samples. If no sample is finite, only the first sample, if any, is
    kept.

    Notes
    -----
    The algorithm is that of [1]_, with distances along the axis of the values. The first and the
    last finite sample, both neighbours of each gap and the first sample of the gap are kept. The
    segment with the furthest sample is then split at this sample, until all samples are within the
    tolerance.

    References
    ----------
    .. [1] Douglas, Peucker, Cartographica 10 (1973) 112.
    """
    finite_rows = np.flatnonzero(np.isfinite(positions) & np.isfinite(values))
    if not len(finite_rows):
        return np.arange(min(len(values), 1), dtype=np.int64)
    before_gaps = np.flatnonzero(np.diff(finite_rows) > 1)
    starts = np.concatenate([finite_rows[:1], finite_rows[before_gaps + 1]])
    stops = np.concatenate([finite_rows[before_gaps], finite_rows[-1:]])
    kept_rows = {*starts.tolist(), *stops.tolist(), *(finite_rows[before_gaps] + 1).tolist()}
    max_distance = tolerance * float(np.ptp(values[finite_rows]))
    segments = [
        _make_segment(positions, values, int(start), int(stop))
        for start, stop in zip(starts, stops, strict=True)
    ]
    heapq.heapify(segments)
    while segments and len(kept_rows) < max_points:
        distance, start, furthest, stop = heapq.heappop(segments)
        if -distance <= max_distance:
            break
        kept_rows.add(furthest)
        heapq.heappush(segments, _make_segment(positions, values, start, furthest))
        heapq.heappush(segments, _make_segment(positions, values, furthest, stop))
    return np.array(sorted(kept_rows), dtype=np.int64)


def _make_segment(positions: Floats, values: Floats, start: int, stop: int) -> _Segment:
    """Make the segment between two samples, with the sample that is furthest from its chord."""
    if stop - start < 2:
        return (0.0, start, start, stop)
    x, y = positions[start : stop + 1], values[start : stop + 1]
    width = x[-1] - x[0]
    # a vertical segment has no width: interpolate by the index of the sample
    fraction = (x - x[0]) / width if width != 0.0 else np.linspace(0.0, 1.0, len(x))
    # two ufuncs take half as long as np.clip, and this runs 100 times per curve
    fraction = np.minimum(np.maximum(fraction, 0.0), 1.0)
    distance = np.abs(y - y[0] - (y[-1] - y[0]) * fraction)
    furthest = int(np.argmax(distance))
    return (-float(distance[furthest]), start, start + furthest, stop)


def thin_flags(
    flags: NDArray[np.uint8], flags_by_severity: Sequence[int], *, n_bins: int
) -> NDArray[np.uint8]:
    """Thin flags along time; keep the worst flag of each bin of frames.

    Parameters
    ----------
    flags : shape (n_frames, n_points), flag of each point in each frame
    flags_by_severity : all possible flags, 0 to n - 1, in order of severity; the worst is last
    n_bins : largest number of bins

    Returns
    -------
    Worst flag of each point within each bin, shape (at most `n_bins`, n_points).
    """
    n_frames, sorted_flags = len(flags), np.array(flags_by_severity, dtype=np.uint8)
    severities = np.argsort(sorted_flags).astype(np.uint8)[flags]
    edges = np.linspace(0, n_frames, min(n_bins, n_frames), endpoint=False)
    starts = np.unique(edges.astype(np.int64))
    worst = np.maximum.reduceat(severities, starts, axis=0) if n_frames else severities
    thinned_flags: NDArray[np.uint8] = sorted_flags[worst]
    return thinned_flags


def split_doubtful(is_reliable: Flags) -> Iterator[tuple[Flags, float]]:
    """Split a line into a reliable part and a doubtful part, which is drawn lighter.

    Parameters
    ----------
    is_reliable : shape (n,), whether each point is reliable; the first point must be, and no
        reliable point may follow a doubtful one

    Yields
    ------
    For each part, whether each point belongs to it, shape (n,), and the opacity of the part. The
    doubtful part starts at the last reliable point, so that the line has no gap. If all points are
    reliable, only one part is yielded.
    """
    doubtful_opacity = 0.35
    yield is_reliable, 1.0
    if not is_reliable.all():
        is_doubtful = ~is_reliable
        is_doubtful[int(is_reliable.sum()) - 1] = True
        yield is_doubtful, doubtful_opacity
