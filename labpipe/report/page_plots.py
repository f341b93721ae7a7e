"""Plots as elements of a page: small, sharp on paper, complete without a script.

The curves of a plot are its data. They stand in an inner drawing whose coordinates are whole
numbers from 0 to 65535, with the ends of both axes beside them, so that the page's script can
enlarge the plot and read values from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import floor, isfinite, log10
from typing import TYPE_CHECKING

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval

if TYPE_CHECKING:
    from markupsafe import Markup

FULL = 65535
"""Width and height of the inner drawing: 16 bit."""
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_FLAT = 1e-12


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a plot.

    Parameters
    ----------
    name, unit : as they are written; an empty unit for a pure number
    low, high : ends, in `unit`
    is_bare : without ticks
    """

    name: str
    unit: str
    low: float
    high: float
    is_bare: bool = False

    @property
    def label(self) -> str:
        """Name and unit, such as ``Force (N)``."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One line of a plot.

    Parameters
    ----------
    look : class that it is drawn by, with the number of its colour
    x, y : shape (n,), in the units of the axes; NaN interrupts it
    test : number of its test on the page; None where it is of none
    group : stem of its group, where several groups are in one plot
    is_closed : an area
    """

    look: str
    x: Floats
    y: Floats
    test: int | None = None
    group: str = ""
    is_closed: bool = False


@dataclass(frozen=True, slots=True)
class Key:
    """An entry below a plot: a sign and what it means.

    Parameters
    ----------
    look : class of the sign
    words : what it means
    attribute, value : what the lines of that entry have: ``t``, ``class`` or ``group``
    """

    look: str
    words: str
    attribute: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """A figure of the page.

    Parameters
    ----------
    kind : ``curves``, ``shapes``, ``moment`` ...
    group : stem of its group; empty for one of several
    title : what a person reads who cannot see it
    caption : how to read it
    x, y : axes
    lines : later ones lie upon earlier ones
    keys : signs that are explained below it
    size : width and height in points of the drawing, without its frame
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


LEFT, TOP, RIGHT, BELOW = 52, 8, 12, 38
"""Room for the words around a plot, in points."""


def axis_over(name: str, unit: str, values: Iterable[Floats], *, room: float = 0.03) -> Axis:
    """Make an axis that shows all values, with a little room at both ends.

    Parameters
    ----------
    name, unit : of the axis
    values : in `unit`; what is not finite does not count
    room : at each end, as a share of the range
    """
    ends = [
        end
        for value in values
        if (known := value[np.isfinite(value)]).size
        for end in (float(known.min()), float(known.max()))
    ] or [0.0, 1.0]
    low, high = min(ends), max(ends)
    span = (high - low) or abs(high) or 1.0
    return Axis(name, unit, low - room * span, high + room * span)


def ticks(axis: Axis, most: int) -> list[float]:
    """Find round values along an axis.

    Parameters
    ----------
    axis : with its ends
    most : how many at the most

    Examples
    --------
    >>> ticks(Axis("Force", "N", -0.4, 10.4), 6)
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    span = axis.high - axis.low
    power = 10.0 ** floor(log10(span / most))
    step = next(power * step for step in _STEPS if power * step * most >= span)
    first = int(np.ceil(axis.low / step - _FLAT))
    last = int(np.floor(axis.high / step + _FLAT))
    return [number * step for number in range(first, last + 1)]


def tick_words(values: Sequence[float]) -> list[str]:
    """Write the values of ticks with as many decimals as tell them apart.

    Examples
    --------
    >>> tick_words([0.0, 0.25, 0.5])
    ['0', '0.25', '0.5']
    """
    return [f"{value:.6g}".replace("-", "\u2212") for value in values]


def svg(plot: Plot) -> Markup:
    """Draw a plot as one ``svg`` element; every word in it is escaped.

    Parameters
    ----------
    plot : any
    """
    from markupsafe import Markup, escape

    width, height = plot.size
    parts = [
        f'<svg class="frame" role="img" viewBox="0 0 {LEFT + width + RIGHT} {TOP + height + BELOW}"'
        f' aria-label="{escape(plot.title)}">',
        *_x_axis(plot.x, width, height),
        *_y_axis(plot.y, width, height),
        f'<svg class="area" x="{LEFT}" y="{TOP}" width="{width}" height="{height}"'
        f' viewBox="0 0 {FULL} {FULL}" preserveAspectRatio="none"{_ends(plot)}>',
        *(_path(line, plot.x, plot.y) for line in plot.lines),
        "</svg></svg>",
    ]
    return Markup("".join(parts))


def _ends(plot: Plot) -> str:
    from markupsafe import escape

    numbers = {"x0": plot.x.low, "x1": plot.x.high, "y0": plot.y.low, "y1": plot.y.high}
    words = {
        "x-unit": plot.x.unit,
        "y-unit": plot.y.unit,
        "x-name": plot.x.name,
        "y-name": plot.y.name,
    }
    return "".join(
        [f' data-{name}="{value:.7g}"' for name, value in numbers.items()]
        + [f' data-{name}="{escape(word)}"' for name, word in words.items()]
    )


def _x_axis(axis: Axis, width: int, height: int) -> Iterator[str]:
    from markupsafe import escape

    values = ticks(axis, max(2, width // 80))
    yield f'<g class="x-axis" transform="translate(0 {TOP + height})">'
    for value, words in zip(values, tick_words(values), strict=True):
        at = LEFT + width * (value - axis.low) / (axis.high - axis.low)
        yield f'<g class="tick" transform="translate({at:.1f} 0)">'
        yield f'<path d="M0 0V{-height}"/><text y="14">{words}</text></g>'
    yield f'<text class="label" x="{LEFT + width / 2:.0f}" y="31">{escape(axis.label)}</text></g>'


def _y_axis(axis: Axis, width: int, height: int) -> Iterator[str]:
    from markupsafe import escape

    values = [] if axis.is_bare else ticks(axis, max(2, height // 46))
    yield f'<g class="y-axis" transform="translate({LEFT} 0)">'
    for value, words in zip(values, tick_words(values), strict=True):
        at = TOP + height * (axis.high - value) / (axis.high - axis.low)
        yield f'<g class="tick" transform="translate(0 {at:.1f})">'
        yield f'<path d="M0 0H{width}"/><text x="-5" y="4">{words}</text></g>'
    middle = TOP + height / 2
    yield f'<text class="label" transform="translate({13 - LEFT} {middle:.0f}) rotate(-90)">'
    yield f"{escape(axis.label)}</text></g>"


def _path(line: Line, x: Axis, y: Axis) -> str:
    from markupsafe import escape

    test = "" if line.test is None else f' data-t="{line.test}"'
    group = f' data-group="{escape(line.group)}"' if line.group else ""
    return f'<path class="{line.look}"{test}{group} d="{steps_of(line, x, y)}"/>'


def steps_of(line: Line, x: Axis, y: Axis) -> str:
    """Write a line as its first point and whole steps, anew after each gap.

    Parameters
    ----------
    line : in the units of the axes
    x, y : axes

    Examples
    --------
    >>> axis = Axis("", "", 0.0, 65535.0)
    >>> steps_of(Line("curve", np.array([0.0, 9.0, 10.0]), np.array([5.0, 5.0, 9.0])), axis, axis)
    'M0 65530l9 0 1-4'
    """
    known = np.isfinite(line.x) & np.isfinite(line.y)
    across = _scaled(line.x, x.low, x.high)
    up = FULL - _scaled(line.y, y.low, y.high)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    strokes = [
        _stroke(across[start:stop], up[start:stop])
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
    ]
    return "".join(strokes) + ("z" if line.is_closed and strokes else "")


def _scaled(values: Floats, low: float, high: float) -> Floats:
    scaled: Floats = np.rint(FULL * (np.nan_to_num(values) - low) / (high - low))
    return np.clip(scaled, -FULL, 2 * FULL)


def _stroke(across: Floats, up: Floats) -> str:
    first = f"M{across[0]:.0f} {up[0]:.0f}"
    if len(across) == 1:
        return f"{first}h0"
    steps = np.column_stack([np.diff(across), np.diff(up)]).astype(np.int64).ravel().tolist()
    return f"{first}l{' '.join(map(str, steps))}".replace(" -", "-")


def strip(
    ends: tuple[float, float], interval: Interval | None, mean: float, samples: Sequence[float] = ()
) -> Markup:
    """Draw a mean with its interval in a line of a table, with its samples below it.

    Parameters
    ----------
    ends : of the scale, which all strips of a column or a row share
    interval : of the mean; None for none
    mean : in the unit of the ends; NaN for none
    samples : dots
    """
    from markupsafe import Markup

    def place(value: float) -> str:
        share = (value - ends[0]) / ((ends[1] - ends[0]) or 1.0)
        return f"{_STRIP * min(max(share, -0.02), 1.02):.0f}"

    dots = "".join(f"M{place(value)} 12h0" for value in samples if isfinite(value))
    marks = f'<path class="dots" d="{dots}"/>' if dots else ""
    if interval is not None and isfinite(interval.lower + interval.upper):
        marks += f'<path class="bar" d="M{place(interval.lower)} 6H{place(interval.upper)}"/>'
    if isfinite(mean):
        marks += f'<path class="dot" d="M{place(mean)} 6h0"/>'
    return Markup(f'<svg class="strip" viewBox="-4 0 {_STRIP + 8} 16">{marks}</svg>')


_STRIP = 120


def sparkline(curves: Sequence[tuple[Floats, Floats]]) -> Markup:
    """Draw curves as small as a word: what they look like, without axes.

    Parameters
    ----------
    curves : shape (n,) each, of one unit; all of them fill the height
    """
    from markupsafe import Markup

    x = axis_over("", "", [each for each, _ in curves], room=0.0)
    y = axis_over("", "", [each for _, each in curves], room=0.05)
    paths = "".join(f'<path d="{steps_of(Line("", *curve), x, y)}"/>' for curve in curves)
    box = f'viewBox="0 0 {FULL} {FULL}" preserveAspectRatio="none"'
    return Markup(f'<svg class="spark" {box}>{paths}</svg>')


def even(plot_width: int, x: Axis, y: Axis) -> int:
    """Height of a plot whose two axes have one scale, in points.

    Parameters
    ----------
    plot_width : points
    x, y : axes of one unit
    """
    ratio = (y.high - y.low) / (x.high - x.low)
    return round(plot_width * ratio) if isfinite(ratio) else plot_width
