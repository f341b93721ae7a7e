"""What is drawn, as records: plots with axes, lines and keys, strips and sparklines of the page.

A page draws them with the template ``plots.html``, complete without a script, and files with
`group_figures`. The curves of a plot are its data: an inner drawing with whole coordinates from 0
to 65535 and the ends of both axes, from which the page's script enlarges the plot.
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
"""Width and height of the inner drawing: 16 bit."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a plot.

    Parameters
    ----------
    name, unit : as they are written; an empty unit for a pure number
    low, high : ends, in `unit`
    names : of rows at 0, -1, -2 ..., in place of numbers; not written on the page
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

    def find_ticks(self, most: int) -> list[tuple[float, str]]:
        """Return places along the axis from 0 to 1, and round numbers there; at most so many.

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
        power = 10.0 ** floor(log10(span / most))
        step = next(power * step for step in nice_steps if power * step * most >= span)
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
    look : class of its style, with the number of its colour
    x, y : shape (n,), in the units of the axes; NaN interrupts it
    test : number of its test on the page, if any
    group : stem of its group, if several groups are in one plot
    is_closed : an area
    """

    look: str
    x: Floats
    y: Floats
    test: int | None = None
    group: str = ""
    is_closed: bool = False

    def write_path(self, x: Axis, y: Axis) -> str:
        """Write the line as its first point and whole steps, with a new start after each gap.

        Parameters
        ----------
        x, y : axes

        Examples
        --------
        >>> axis = Axis("", "", 0.0, 65535.0)
        >>> line = Line("curve", np.array([0.0, 9.0, 10.0]), np.array([5.0, 5.0, 9.0]))
        >>> line.write_path(axis, axis)
        'M0 65530l9 0 1-4'
        """
        finite = np.isfinite(self.x) & np.isfinite(self.y)
        across = _grid_numbers(self.x, x)
        up = FULL - _grid_numbers(self.y, y)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], finite, [False]]).astype(np.int8)))
        strokes = [
            _stroke(across[start:stop], up[start:stop])
            for start, stop in zip(edges[::2], edges[1::2], strict=True)
        ]
        return "".join(strokes) + ("z" if self.is_closed and strokes else "")


def _grid_numbers(values: Floats, axis: Axis) -> Floats:
    scaled: Floats = np.rint(FULL * (np.nan_to_num(values) - axis.low) / (axis.high - axis.low))
    return np.clip(scaled, -FULL, 2 * FULL)


def _stroke(across: Floats, up: Floats) -> str:
    first = f"M{across[0]:.0f} {up[0]:.0f}"
    if len(across) == 1:
        return f"{first}h0"
    steps = np.column_stack([np.diff(across), np.diff(up)]).astype(np.int64).ravel().tolist()
    return f"{first}l{' '.join(map(str, steps))}".replace(" -", "-")


@dataclass(frozen=True, slots=True)
class Key:
    """An entry of the key below a plot.

    Parameters
    ----------
    look : class of the sign
    label : of the sign
    attribute, value : of the lines of that entry: ``t``, ``class`` or ``group``
    """

    look: str
    label: str
    attribute: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """A figure of the page, or a panel of a figure in a file.

    Parameters
    ----------
    kind : ``curves``, ``shapes``, ``moment`` ...
    group : stem of its group; empty for several groups
    title : alternative text
    caption : how to read it
    x, y : axes
    lines : later ones are drawn over earlier ones
    keys : entries below the plot
    size : width and height in points of the drawing, without its frame
    heading : above it, where a figure has several plots
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
    """Return an axis that shows all values, with a margin at both ends.

    Parameters
    ----------
    name, unit : of the axis
    values : in `unit`; values that are not finite are ignored
    room : at each end, as a share of the range
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
    """Return a range with all values, and of wide intervals as much as leaves the values apart.

    Parameters
    ----------
    values : shown in full
    wide : ends of intervals or bands, shown up to `room`; numbers that are not finite are ignored
    room : beyond the values, as a share of their range; a single value has all of it
    """
    shown = [float(value) for value in values if isfinite(value)] or [0.0, 1.0]
    low, high = min(shown), max(shown)
    reach = room * (high - low) if high > low else inf
    every = [*shown, *(float(end) for end in wide if isfinite(end))]
    return max(min(every), low - reach), min(max(every), high + reach)


class Strip(NamedTuple):
    """A mean with its interval and its samples in a line of a table; places from 0 to 120.

    Parameters
    ----------
    mean : None without a mean
    bar : ends of its interval; empty without one
    dots : samples
    """

    mean: int | None
    bar: tuple[int, ...]
    dots: tuple[int, ...]


def make_strip(
    ends: tuple[float, float], interval: Interval | None, mean: float, samples: Sequence[float] = ()
) -> Strip:
    """Place a mean, its interval and its samples on a scale.

    Parameters
    ----------
    ends : of the scale
    interval : of the mean, if any
    mean : in the unit of the ends; NaN without a mean
    samples : dots
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
    """Write a small curve without axes, which fills its frame."""
    axes = make_axis("", "", [x], room=0.0), make_axis("", "", [y], room=0.05)
    return Line("", x, y).write_path(*axes)


_Segment: TypeAlias = tuple[float, int, int, int]
"""Negative distance of the furthest sample; first, furthest and last sample."""


def find_extremes(values: Floats, *, bins: int) -> Ints:
    """Return the samples of a thinned line that keeps its extremes.

    Parameters
    ----------
    values : shape (n,), in order of drawing
    bins : of equal length, at least 1

    Returns
    -------
    Sorted sample numbers: the lowest and the highest sample of each bin, which keeps the width of
    noise, its first NaN, which keeps gaps, and the two ends. All samples if there are at most
    four per bin.

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


def simplify_line(across: Floats, values: Floats, *, points: int, tolerance: float = 0.002) -> Ints:
    """Return the samples of a simplified line that keeps its shape.

    Parameters
    ----------
    across, values : shape (n,), in order of drawing
    points : at most, besides the ends of gaps, which are always kept
    tolerance : invisible distance from the line, as a share of the range of the values

    Returns
    -------
    Sorted sample numbers: the two ends, then repeatedly the sample furthest, along the values, from
    the line through those kept so far, until none is further than the tolerance. Corners, steps
    and the largest excursions of noise are kept; of a gap, its ends and its first NaN.

    Notes
    -----
    Douglas and Peucker, Cartographica 10 (1973) 112, the furthest of all segments first.
    """
    finite = np.flatnonzero(np.isfinite(across) & np.isfinite(values))
    if not len(finite):
        return np.arange(min(len(values), 1), dtype=np.int64)
    broken = np.flatnonzero(np.diff(finite) > 1)
    starts = np.concatenate([finite[:1], finite[broken + 1]])
    stops = np.concatenate([finite[broken], finite[-1:]])
    rows = {*starts.tolist(), *stops.tolist(), *(finite[broken] + 1).tolist()}
    max_distance = tolerance * float(np.ptp(values[finite]))
    segments = [
        _furthest_sample(across, values, int(start), int(stop))
        for start, stop in zip(starts, stops, strict=True)
    ]
    heapq.heapify(segments)
    while segments and len(rows) < points:
        distance, start, furthest, stop = heapq.heappop(segments)
        if -distance <= max_distance:
            break
        rows.add(furthest)
        heapq.heappush(segments, _furthest_sample(across, values, start, furthest))
        heapq.heappush(segments, _furthest_sample(across, values, furthest, stop))
    return np.array(sorted(rows), dtype=np.int64)


def _furthest_sample(across: Floats, values: Floats, start: int, stop: int) -> _Segment:
    """Return the sample between two that is furthest from the line through them."""
    if stop - start < 2:
        return (0.0, start, start, stop)
    x, y = across[start : stop + 1], values[start : stop + 1]
    width = x[-1] - x[0]
    # a vertical part is drawn sample by sample
    share = (x - x[0]) / width if width != 0.0 else np.linspace(0.0, 1.0, len(x))
    # two ufuncs take half as long as np.clip, and this runs 100 times a curve
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    distance = np.abs(y - y[0] - (y[-1] - y[0]) * share)
    furthest = int(np.argmax(distance))
    return (-float(distance[furthest]), start, start + furthest, stop)


def thin_flags(
    flags: NDArray[np.uint8], rank: NDArray[np.uint8], *, bins: int
) -> NDArray[np.uint8]:
    """Thin flags along time, keeping the worst.

    Parameters
    ----------
    flags : shape (frames, points)
    rank : badness of each flag, by its number
    bins : columns, at most

    Returns
    -------
    Shape (columns, points): the flag of highest rank within each bin of frames.
    """
    frames = len(flags)
    starts = np.unique(np.linspace(0, frames, min(bins, frames), endpoint=False).astype(np.int64))
    badness = np.maximum.reduceat(rank[flags], starts, axis=0) if frames else rank[flags]
    by_rank = np.argsort(rank).astype(np.uint8)
    columns: NDArray[np.uint8] = by_rank[badness]
    return columns


def split_doubtful(sure: Flags) -> Iterator[tuple[Flags, float]]:
    """Split a line into its sure part and its doubtful part, which is drawn lighter.

    Parameters
    ----------
    sure : shape (n,), true up to some point, and at the first

    Yields
    ------
    The points of a part, shape (n,), and its opacity.
    """
    yield sure, 1.0
    if not sure.all():
        doubtful = ~sure
        doubtful[int(sure.sum()) - 1] = True
        yield doubtful, 0.35
