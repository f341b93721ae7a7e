"""Plots as elements of a page: small, sharp on paper, complete without a script.

The curves of a plot are its data: an inner drawing with whole coordinates from 0 to 65535 and the
ends of both axes, from which the page's script enlarges the plot and reads values.
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
        """Return name and unit, such as ``Force (N)``."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


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
    """A figure of the page.

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
"""Room for texts around a plot, points."""


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


def ticks(axis: Axis, max_ticks: int) -> list[float]:
    """Find round values along an axis.

    Parameters
    ----------
    axis : with its ends
    max_ticks : at most

    Examples
    --------
    >>> ticks(Axis("Force", "N", -0.4, 10.4), 6)
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    nice_steps = (1.0, 2.0, 2.5, 5.0, 10.0)
    flat_span = 1e-12
    span = axis.high - axis.low
    power = 10.0 ** floor(log10(span / max_ticks))
    step = next(power * step for step in nice_steps if power * step * max_ticks >= span)
    first = int(np.ceil(axis.low / step - flat_span))
    last = int(np.floor(axis.high / step + flat_span))
    return [number * step for number in range(first, last + 1)]


def tick_words(values: Sequence[float]) -> list[str]:
    """Write the values of ticks with as many decimals as they need.

    Examples
    --------
    >>> tick_words([0.0, 0.25, 0.5])
    ['0', '0.25', '0.5']
    """
    return [f"{value:.6g}".replace("-", "\u2212") for value in values]


def svg(plot: Plot) -> Markup:
    """Draw a plot as one ``svg`` element; all texts are escaped.

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
        f' viewBox="0 0 {FULL} {FULL}" preserveAspectRatio="none"{_data_attributes(plot)}>',
        *(_path(line, plot.x, plot.y) for line in plot.lines),
        "</svg></svg>",
    ]
    return Markup("".join(parts))


def _data_attributes(plot: Plot) -> str:
    from markupsafe import escape

    numbers = {"x0": plot.x.low, "x1": plot.x.high, "y0": plot.y.low, "y1": plot.y.high}
    texts = {
        "x-unit": plot.x.unit,
        "y-unit": plot.y.unit,
        "x-name": plot.x.name,
        "y-name": plot.y.name,
    }
    return "".join(
        [f' data-{name}="{value:.7g}"' for name, value in numbers.items()]
        + [f' data-{name}="{escape(word)}"' for name, word in texts.items()]
    )


def _x_axis(axis: Axis, width: int, height: int) -> Iterator[str]:
    from markupsafe import escape

    values = ticks(axis, max(2, width // 80))
    yield f'<g class="x-axis" transform="translate(0 {TOP + height})">'
    for value, label in zip(values, tick_words(values), strict=True):
        place = LEFT + width * (value - axis.low) / (axis.high - axis.low)
        yield f'<g class="tick" transform="translate({place:.1f} 0)">'
        yield f'<path d="M0 0V{-height}"/><text y="14">{label}</text></g>'
    yield f'<text class="label" x="{LEFT + width / 2:.0f}" y="31">{escape(axis.label)}</text></g>'


def _y_axis(axis: Axis, width: int, height: int) -> Iterator[str]:
    from markupsafe import escape

    values = [] if axis.is_bare else ticks(axis, max(2, height // 46))
    yield f'<g class="y-axis" transform="translate({LEFT} 0)">'
    for value, label in zip(values, tick_words(values), strict=True):
        place = TOP + height * (axis.high - value) / (axis.high - axis.low)
        yield f'<g class="tick" transform="translate(0 {place:.1f})">'
        yield f'<path d="M0 0H{width}"/><text x="-5" y="4">{label}</text></g>'
    middle = TOP + height / 2
    yield f'<text class="label" transform="translate({13 - LEFT} {middle:.0f}) rotate(-90)">'
    yield f"{escape(axis.label)}</text></g>"


def _path(line: Line, x: Axis, y: Axis) -> str:
    from markupsafe import escape

    test = "" if line.test is None else f' data-t="{line.test}"'
    group = f' data-group="{escape(line.group)}"' if line.group else ""
    return f'<path class="{line.look}"{test}{group} d="{path_steps(line, x, y)}"/>'


def path_steps(line: Line, x: Axis, y: Axis) -> str:
    """Write a line as its first point and whole steps, with a new start after each gap.

    Parameters
    ----------
    line : in the units of the axes
    x, y : axes

    Examples
    --------
    >>> axis = Axis("", "", 0.0, 65535.0)
    >>> path_steps(Line("curve", np.array([0.0, 9.0, 10.0]), np.array([5.0, 5.0, 9.0])), axis, axis)
    'M0 65530l9 0 1-4'
    """
    finite = np.isfinite(line.x) & np.isfinite(line.y)
    across = _grid_numbers(line.x, x.low, x.high)
    up = FULL - _grid_numbers(line.y, y.low, y.high)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], finite, [False]]).astype(np.int8)))
    strokes = [
        _stroke(across[start:stop], up[start:stop])
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
    ]
    return "".join(strokes) + ("z" if line.is_closed and strokes else "")


def _grid_numbers(values: Floats, low: float, high: float) -> Floats:
    scaled: Floats = np.rint(FULL * (np.nan_to_num(values) - low) / (high - low))
    return np.clip(scaled, -FULL, 2 * FULL)


def _stroke(across: Floats, up: Floats) -> str:
    first = f"M{across[0]:.0f} {up[0]:.0f}"
    if len(across) == 1:
        return f"{first}h0"
    steps = np.column_stack([np.diff(across), np.diff(up)]).astype(np.int64).ravel().tolist()
    return f"{first}l{' '.join(map(str, steps))}".replace(" -", "-")


def mean_strip(
    ends: tuple[float, float], interval: Interval | None, mean: float, samples: Sequence[float] = ()
) -> Markup:
    """Draw a mean with its interval in a line of a table, with its samples below it.

    Parameters
    ----------
    ends : of the scale
    interval : of the mean, if any
    mean : in the unit of the ends; NaN without a mean
    samples : dots
    """
    strip_width = 120
    from markupsafe import Markup

    def place(value: float) -> str:
        share = (value - ends[0]) / ((ends[1] - ends[0]) or 1.0)
        return f"{strip_width * min(max(share, -0.02), 1.02):.0f}"

    dots = "".join(f"M{place(value)} 12h0" for value in samples if isfinite(value))
    marks = f'<path class="dots" d="{dots}"/>' if dots else ""
    if interval is not None and isfinite(interval.lower + interval.upper):
        marks += f'<path class="bar" d="M{place(interval.lower)} 6H{place(interval.upper)}"/>'
    if isfinite(mean):
        marks += f'<path class="dot" d="M{place(mean)} 6h0"/>'
    return Markup(f'<svg class="strip" viewBox="-4 0 {strip_width + 8} 16">{marks}</svg>')


def sparkline(curves: Sequence[tuple[Floats, Floats]]) -> Markup:
    """Draw small curves without axes.

    Parameters
    ----------
    curves : shape (n,) each, of one unit; all of them fill the height
    """
    from markupsafe import Markup

    x = axis_over("", "", [values for values, _ in curves], room=0.0)
    y = axis_over("", "", [values for _, values in curves], room=0.05)
    paths = "".join(f'<path d="{path_steps(Line("", *curve), x, y)}"/>' for curve in curves)
    box = f'viewBox="0 0 {FULL} {FULL}" preserveAspectRatio="none"'
    return Markup(f'<svg class="spark" {box}>{paths}</svg>')


def equal_scale_height(plot_width: int, x: Axis, y: Axis) -> int:
    """Return the height of a plot with equal axis scale, points.

    Parameters
    ----------
    plot_width : points
    x, y : axes of one unit
    """
    ratio = (y.high - y.low) / (x.high - x.low)
    return round(plot_width * ratio) if isfinite(ratio) else plot_width
