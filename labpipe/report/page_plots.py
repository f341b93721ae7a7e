"""What is drawn, as records: plots with axes, lines and keys, strips and sparklines of the page.

A page draws them with the template ``plots.html``, complete without a script, and files with
`group_figures`. The curves of a plot are its data: an inner drawing with whole coordinates from 0
to 65535 and the ends of both axes, from which the page's script enlarges the plot.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import floor, inf, isfinite, log10
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Floats
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

    def marks(self, most: int) -> list[tuple[float, str]]:
        """Return places along the axis from 0 to 1, and round numbers there; at most so many.

        Examples
        --------
        >>> [text for _, text in Axis("Force", "N", -0.4, 10.4).marks(6)]
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

    def steps(self, x: Axis, y: Axis) -> str:
        """Write the line as its first point and whole steps, with a new start after each gap.

        Parameters
        ----------
        x, y : axes

        Examples
        --------
        >>> axis = Axis("", "", 0.0, 65535.0)
        >>> Line("curve", np.array([0.0, 9.0, 10.0]), np.array([5.0, 5.0, 9.0])).steps(axis, axis)
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


def axis_over(name: str, unit: str, values: Iterable[Floats], *, room: float = 0.03) -> Axis:
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


def mean_strip(
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


def sparkline(x: Floats, y: Floats) -> str:
    """Write a small curve without axes, which fills its frame."""
    axes = axis_over("", "", [x], room=0.0), axis_over("", "", [y], room=0.05)
    return Line("", x, y).steps(*axes)
