"""The straight lines that stiffnesses were read from, over the curves of a group."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.group import Group
from labpipe.report.group_look import first_loading, group_page, group_scale, label_axes, thin
from labpipe.report.numbers import display_of, in_words, shown_in, unit_words, write_mean
from labpipe.report.page import style_colours

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINES_HEIGHT = 82.0
_CURVES = "#9a9a9a"
_WINDOW: dict[str, Any] = {
    "linewidth": 4.0, "alpha": 0.4, "solid_capstyle": "butt", "zorder": 2
}  # fmt: skip
_SEGMENT: dict[str, Any] = {
    "color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.6)), "zorder": 4
}  # fmt: skip
_BEYOND = 1.5
"""How far the axis goes on behind the last window, in lengths up to its end."""


def draw_lines(group: Group) -> Figure:
    """Draw curves in grey on their windows in colour, segments dotted, with the slopes in the key.

    Parameters
    ----------
    group : one with lines
    """
    page = group_page(group, _line_keys(group), height_mm=_LINES_HEIGHT, columns=1)
    axes = page.subplots()
    plot_lines(group, axes)
    label_axes(group, axes)
    return page


def has_lines(group: Group) -> bool:
    """Tell whether any sample has a fitted line to draw."""
    return any(sample.lines for sample in group.samples)


def plot_lines(group: Group, axes: Axes) -> None:
    """Draw each sample up to a little beyond its windows, and its lines.

    Parameters
    ----------
    group : lines of one result have one look
    axes : to draw on
    """
    looks = _looks(group)
    across = group_scale(group, "displacement").factor
    up = group_scale(group, "force").factor
    end = _BEYOND * max(line.stop for sample in group.samples for line in sample.lines)
    for sample in group.samples:
        curve = first_loading(sample)
        if curve is not None:
            seen = np.where(curve.displacement <= end, curve.force, np.nan)
            x, y = thin(curve, seen)
            axes.plot(x * across, y * up, color=_CURVES, linewidth=0.5, zorder=3)
        for line in sample.lines:
            ends = np.array([line.start, line.stop])
            height = line.level + line.slope * (ends - line.start)
            axes.plot(ends * across, height * up, **looks[line.result])


def _looks(group: Group) -> dict[str, dict[str, Any]]:
    """Broad and pale for lines over set windows, thin and dotted upon them for fitted segments."""
    own = style_colours()
    names = dict.fromkeys(line.result for sample in group.samples for line in sample.lines)
    windows = [name for name in names if not name.startswith("segment")]
    looks: dict[str, dict[str, Any]] = dict.fromkeys(names, _SEGMENT)
    return looks | {
        name: {**_WINDOW, "color": own[number % len(own)]} for number, name in enumerate(windows)
    }


def _line_keys(group: Group) -> list[Artist]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], label=_slope(group, name), **look) for name, look in _looks(group).items()
    ]


def _slope(group: Group, name: str) -> str:
    """Name of a line and its mean slope with the interval."""
    number = next((each for each in group.numbers if each.name == name), None)
    if number is None or number.mean is None:
        return in_words(name)
    shown = shown_in(name, number.unit, display_of(group))
    mean = number.mean.chosen
    words = write_mean(mean, shown.factor, number.mean.spool_means.values()).text
    over = "samples" if number.mean.is_pooled else "spool means"
    of = f", mean of {mean.n} {over}" if mean.n > 1 else ""
    return f"{in_words(name)}: {words} {unit_words(shown.unit)}{of}"
