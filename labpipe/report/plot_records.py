"""Records of plots, which the page draws as SVG and files by matplotlib; thinning of their lines.

The page draws a plot with the template ``plots.html``, files with `group_figures`. On the page,
the lines of a plot are also its data: they have whole coordinates from 0 to 65535 between the ends
of both axes, from which the script of the page enlarges the plot.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import floor, inf, isfinite, log10
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Interval

FULL = 65535
"""Width and height of the area of a plot, in its own coordinates of 16 bits."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a plot.

    Parameters
    ----------
    name, unit : typeset; the unit of a pure number is empty
    low, high : ends, in `unit`
    names : of rows at 0, -1, -2 and so on, which replace the numbers; the page does not write them
    """

    name: str
    unit: str
    low: float
    high: float
    names: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Return name and unit, such as ``Force (N)``."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    def find_ticks(self, max_count: int) -> list[tuple[float, str]]:
        """Find round numbers along the axis.

        Parameters
        ----------
        max_count : number of steps, at most

        Returns
        -------
        The place of each from 0 to 1, and its text; none for an axis with names.

        Examples
        --------
        >>> [text for _, text in Axis("Force", "N", -0.4, 10.4).find_ticks(6)]
        ['0', '2', '4', '6', '8', '10']
        """
        nice_steps = (1.0, 2.0, 2.5, 5.0, 10.0)
        flat_span = 1e-12
        if self.names:
            return []
        span = self.high - self.low
        power = 10.0 ** floor(log10(span / max_count))
        step = next(power * step for step in nice_steps if power * step * max_count >= span)
        first = int(np.ceil(self.low / step - flat_span))
        last = int(np.floor(self.high / step + flat_span))
        return [
            ((number * step - self.low) / span, f"{number * step:.6g}".replace("-", "\u2212"))
            for number in range(first, last + 1)
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of a plot.

    Parameters
    ----------
    look : its class on the page, such as ``curve c2`` with the number of its colour
    x, y : shape (n,), in the units of the axes; NaN interrupts the line
    test : number of its test on the page; None for no single test
    group : stem of its group if the plot shows several groups; else empty
    is_closed : fill the area within the line
    """

    look: str
    x: Floats
    y: Floats
    test: int | None = None
    group: str = ""
    is_closed: bool = False

    def write_path(self, x: Axis, y: Axis) -> str:
        """Write the line as a path of SVG: its first point, then whole steps; again after a gap.

        Parameters
        ----------
        x, y : axes of the plot

        Examples
        --------
        >>> axis = Axis("", "", 0.0, 65535.0)
        >>> line = Line("curve", np.array([0.0, 9.0, 10.0]), np.array([5.0, 5.0, 9.0]))
        >>> line.write_path(axis, axis)
        'M0 65530l9 0 1-4'
        """
        finite = np.isfinite(self.x) & np.isfinite(self.y)
        x_grid = _grid_numbers(self.x, x)
        y_grid = FULL - _grid_numbers(self.y, y)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], finite, [False]]).astype(np.int8)))
        strokes = [
            _stroke(x_grid[start:stop], y_grid[start:stop])
            for start, stop in zip(edges[::2], edges[1::2], strict=True)
        ]
        return "".join(strokes) + ("z" if self.is_closed and strokes else "")


def _grid_numbers(values: Floats, axis: Axis) -> Floats:
    scaled: Floats = np.rint(FULL * (np.nan_to_num(values) - axis.low) / (axis.high - axis.low))
    return np.clip(scaled, -FULL, 2 * FULL)


def _stroke(x_grid: Floats, y_grid: Floats) -> str:
    first = f"M{x_grid[0]:.0f} {y_grid[0]:.0f}"
    if len(x_grid) == 1:
        return f"{first}h0"
    steps = np.column_stack([np.diff(x_grid), np.diff(y_grid)]).astype(np.int64).ravel().tolist()
    return f"{first}l{' '.join(map(str, steps))}".replace(" -", "-")


@dataclass(frozen=True, slots=True)
class Key:
    """Entry of the key below a plot.

    Parameters
    ----------
    look : class of its sign
    label : beside the sign
    attribute, value : by which the page finds the lines of the entry: ``t``, ``class`` or
        ``group``, and its value; empty if the entry switches no lines
    """

    look: str
    label: str
    attribute: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """A plot on the page, or a panel of a figure in a file.

    Parameters
    ----------
    kind : ``curves``, ``means``, ``moment``, ``numbers``, ``scaled`` or ``shapes``
    group : stem of its group; empty for several groups
    title : alternative text
    caption : how to read the plot
    x, y : axes
    lines : from the lowest to the topmost
    keys : entries of the key
    size : width and height of the area of the lines, points
    heading : above the plot if a figure has several plots
    """

    kind: str
    group: str
    title: str
    caption: str
    x: Axis
    y: Axis
    lines: Sequence[Line]
    keys: Sequence[Key] = field(default=())
    size: tuple[int, int] = (640, 280)
    heading: str = ""


def make_axis(name: str, unit: str, values: Iterable[Floats], *, room: float = 0.03) -> Axis:
    """Make an axis that shows all values, with a margin at both ends.

    Parameters
    ----------
    name, unit : of the axis
    values : in `unit`; values that are not finite are ignored
    room : margin at each end, as a share of the range of the values
    """
    ends = [
        end
        for value in values
        if (finite := value[np.isfinite(value)]).size
        for end in (float(finite.min()), float(finite.max()))
    ] or [0.0, 1.0]
    low, high = min(ends), max(ends)
    span = (high - low) or abs(high) or 1.0
    return Axis(name, unit, low - room * span, high + room * span)


def clip_range(values: Iterable[float], wide: Iterable[float], room: float) -> tuple[float, float]:
    """Return a range that includes all values, and of wide intervals as much as keeps values apart.

    Parameters
    ----------
    values : to be shown; without any, 0 and 1
    wide : ends of intervals or bands; numbers that are not finite are ignored here and in `values`
    room : limit of the range beyond the values, as a share of their range; none for a single value
    """
    shown = [float(value) for value in values if isfinite(value)] or [0.0, 1.0]
    low, high = min(shown), max(shown)
    reach = room * (high - low) if high > low else inf
    every = [*shown, *(float(end) for end in wide if isfinite(end))]
    return max(min(every), low - reach), min(max(every), high + reach)


class Strip(NamedTuple):
    """Drawing of a mean in a cell of a table; places are from 0 to 120.

    Parameters
    ----------
    mean : place; None without a mean
    bar : places of the ends of its interval; empty without one
    dots : places of samples
    """

    mean: int | None
    bar: tuple[int, ...]
    dots: tuple[int, ...]


def make_strip(
    ends: tuple[float, float], interval: Interval | None, mean: float, samples: Sequence[float] = ()
) -> Strip:
    """Make the drawing of a mean, its interval and its samples on a scale.

    Parameters
    ----------
    ends : of the scale
    interval : of the mean, if any; in the unit of the ends
    mean : in the unit of the ends; NaN without a mean
    samples : in the unit of the ends
    """
    strip_width = 120

    def place(value: float) -> int:
        share = (value - ends[0]) / ((ends[1] - ends[0]) or 1.0)
        return round(strip_width * min(max(share, -0.02), 1.02))

    bar: tuple[int, ...] = ()
    if interval is not None and isfinite(interval.lower + interval.upper):
        bar = place(interval.lower), place(interval.upper)
    dots = tuple(place(value) for value in samples if isfinite(value))
    return Strip(place(mean) if isfinite(mean) else None, bar, dots)


def write_sparkline(x: Floats, y: Floats) -> str:
    """Write a small curve without axes as a path of SVG that fills its frame."""
    axes = make_axis("", "", [x], room=0.0), make_axis("", "", [y], room=0.05)
    return Line("", x, y).write_path(*axes)


_Segment: TypeAlias = tuple[float, int, int, int]
"""Negative distance of the furthest sample; first, furthest and last sample."""


def find_extremes(values: Floats, *, bins: int) -> Ints:
    """Find the samples of a thinned line that keeps its extremes.

    Parameters
    ----------
    values : shape (n,), in order of drawing
    bins : of equal length, at least 1

    Returns
    -------
    Sorted sample numbers: the lowest and the highest sample of each bin, which keep the width of
    noise, the first NaN of each bin, which keeps gaps, and both ends of the line. All samples if
    there are at most four per bin.

    Raises
    ------
    ValueError
        If `bins` is less than 1.
    """
    if bins < 1:
        message = f"bins: expected at least 1, found {bins}"
        raise ValueError(message)
    count = len(values)
    if count <= 4 * bins:
        return np.arange(count, dtype=np.int64)
    starts = np.linspace(0, count, bins + 1).astype(np.int64)
    bin_number = np.repeat(np.arange(bins), np.diff(starts))
    # sorted by bin, then by value: NaN is last within each bin
    order = np.lexsort((values, bin_number))
    blank = np.isnan(values)
    n_finite = np.add.reduceat(~blank, starts[:-1])
    highest = order[starts[:-1] + np.maximum(n_finite - 1, 0)]
    gaps = np.flatnonzero(blank)
    first_gaps = gaps[np.unique(bin_number[gaps], return_index=True)[1]]
    ends = [0, count - 1]
    return np.unique(np.concatenate([order[starts[:-1]], highest, first_gaps, ends]))


def simplify_line(
    positions: Floats, values: Floats, *, points: int, tolerance: float = 0.002
) -> Ints:
    """Find the samples of a simplified line that keeps its shape.

    Parameters
    ----------
    positions, values : shape (n,), in order of drawing
    points : largest number of samples; the ends of gaps are kept even beyond it
    tolerance : distance from the line that cannot be seen, as a share of the range of the values

    Returns
    -------
    Sorted sample numbers: both ends, then one after another the sample whose value is furthest
    from the line through the samples so far, until all are within the tolerance. Corners, steps
    and the largest excursions of noise remain; of a gap, its ends and its first NaN. Without finite
    samples, the first one.

    Notes
    -----
    Douglas and Peucker, Cartographica 10 (1973) 112; of all segments, the one with the furthest
    sample is split first.
    """
    finite = np.flatnonzero(np.isfinite(positions) & np.isfinite(values))
    if not len(finite):
        return np.arange(min(len(values), 1), dtype=np.int64)
    broken = np.flatnonzero(np.diff(finite) > 1)
    starts = np.concatenate([finite[:1], finite[broken + 1]])
    stops = np.concatenate([finite[broken], finite[-1:]])
    rows = {*starts.tolist(), *stops.tolist(), *(finite[broken] + 1).tolist()}
    max_distance = tolerance * float(np.ptp(values[finite]))
    segments = [
        _furthest_sample(positions, values, int(start), int(stop))
        for start, stop in zip(starts, stops, strict=True)
    ]
    heapq.heapify(segments)
    while segments and len(rows) < points:
        distance, start, furthest, stop = heapq.heappop(segments)
        if -distance <= max_distance:
            break
        rows.add(furthest)
        heapq.heappush(segments, _furthest_sample(positions, values, start, furthest))
        heapq.heappush(segments, _furthest_sample(positions, values, furthest, stop))
    return np.array(sorted(rows), dtype=np.int64)


def _furthest_sample(positions: Floats, values: Floats, start: int, stop: int) -> _Segment:
    """Find the sample between two that is furthest from the line through them."""
    if stop - start < 2:
        return (0.0, start, start, stop)
    x, y = positions[start : stop + 1], values[start : stop + 1]
    width = x[-1] - x[0]
    # along a vertical segment, the samples count instead of their places
    share = (x - x[0]) / width if width != 0.0 else np.linspace(0.0, 1.0, len(x))
    # two ufuncs take half as long as np.clip, and this runs 100 times a curve
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    distance = np.abs(y - y[0] - (y[-1] - y[0]) * share)
    furthest = int(np.argmax(distance))
    return (-float(distance[furthest]), start, start + furthest, stop)


def thin_flags(
    flags: NDArray[np.uint8], flags_by_rank: Sequence[int], *, bins: int
) -> NDArray[np.uint8]:
    """Thin flags along time and keep the worst.

    Parameters
    ----------
    flags : shape (frames, points)
    flags_by_rank : all flags, the worst last
    bins : largest number of columns

    Returns
    -------
    Shape (columns, points): the worst flag within each bin of frames.
    """
    frames, order = len(flags), np.array(flags_by_rank, dtype=np.uint8)
    ranks = np.argsort(order).astype(np.uint8)[flags]
    starts = np.unique(np.linspace(0, frames, min(bins, frames), endpoint=False).astype(np.int64))
    thinned: NDArray[np.uint8] = order[
        np.maximum.reduceat(ranks, starts, axis=0) if frames else ranks
    ]
    return thinned


def split_doubtful(sure: Flags) -> Iterator[tuple[Flags, float]]:
    """Split a line into its sure part and its doubtful part, which is drawn lighter.

    Parameters
    ----------
    sure : shape (n,); true up to some point, at least at the first

    Yields
    ------
    Whether each point belongs to the part, shape (n,), and the opacity of the part. The doubtful
    part starts with the last sure point; there is none if all points are sure.
    """
    yield sure, 1.0
    if not sure.all():
        doubtful = ~sure
        doubtful[int(sure.sum()) - 1] = True
        yield doubtful, 0.35
