"""The numbers of a group as dots: samples, means of spools and the mean, with intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.curve import Interval
from labpipe.records.group import Group, GroupNumber, MeanInterval
from labpipe.records.result import Status
from labpipe.report.figure_page import GREY, keep_in_view, line_key, panel_grid
from labpipe.report.group_plots import (
    RED,
    group_page,
    spool_looks,
)
from labpipe.report.wording import display_of, in_words, shown_in, unit_words

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_NUMBERS = 6
MOST_ROWS = 24
"""Samples that get a row each; in larger groups those of a spool share one."""
_ROW = 3.7
_PANEL = 17.0
_COLUMNS = 2
_RING: dict[str, Any] = {
    "marker": "o", "color": RED, "markerfacecolor": "none", "markersize": 8, "linestyle": ""
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the figure.

    Parameters
    ----------
    height : of the row, counted from 0 at the top
    label : at its left
    value : in SI; NaN for none
    interval : 95 %
    colour, marker : of its dot
    is_open : an open dot: the result is doubtful
    is_marked : a ring around it: marked as an outlier
    note : written where there is no dot
    """

    height: float
    label: str
    value: float
    interval: Interval | None
    colour: str
    marker: str
    is_open: bool = False
    is_marked: bool = False
    note: str = ""


def numbers_to_draw(group: Group) -> list[GroupNumber]:
    """Pick numbers with at least two samples, no later cycles, and `MOST_NUMBERS` at the most."""
    own = [
        number
        for number in group.numbers
        if _is_first(number.name) and number.mean is not None and number.mean.over_samples.n > 1
    ]
    return own[:MOST_NUMBERS]


def draw_dots(group: Group) -> Figure:
    """Draw a panel per number; its rows are samples, spool means and the mean.

    Parameters
    ----------
    group : one that has `numbers_to_draw`
    """
    numbers = numbers_to_draw(group)
    drawn = {number.name for number in numbers}
    left_out = [
        number.name
        for number in group.numbers
        if _is_first(number.name) and number.name not in drawn
    ]
    rows = math.ceil(len(numbers) / _COLUMNS)
    lines = _next(rows_of(group, numbers[0]))
    note = f"In the tables only: {'; '.join(map(in_words, left_out))}." if left_out else ""
    page = group_page(
        group, _keys(numbers), columns=4, height_mm=rows * (_PANEL + _ROW * lines), note=note
    )
    panels = panel_grid(page, len(numbers), columns=_COLUMNS, sharey=True)
    for number, axes in zip(numbers, panels, strict=True):
        plot_dots(group, number, axes)
    return page


def plot_dots(group: Group, number: GroupNumber, axes: Axes) -> None:
    """Draw one number: a dot and its interval per row, the mean's interval as a grey stripe.

    Parameters
    ----------
    group : gives looks and display units
    number : one with a mean
    axes : to draw on
    """
    shown = shown_in(number.name, number.unit, display_of(group))
    rows = rows_of(group, number)
    for row in rows:
        _plot_row(row, shown.factor, axes)
    labels = {math.floor(row.height + 0.5): row.label for row in rows}
    axes.set_yticks(list(labels), list(labels.values()))
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.set_title(in_words(number.name), loc="left")
    axes.set_xlabel(unit_words(shown.unit))
    keep_in_view([shown.factor * row.value for row in rows], axes, _least_width(rows, shown.factor))
    axes.locator_params(axis="x", nbins=5)


def rows_of(group: Group, number: GroupNumber) -> list[Row]:
    """Lay out the rows of a panel: each spool's samples and its mean, then the mean of all.

    Parameters
    ----------
    group, number : what to lay out; a sample without the number keeps its row, with a word in it

    Returns
    -------
    The same heights for every number of a group. In a group of more than `MOST_ROWS` samples those
    of a spool share a row, beside each other and without intervals.
    """
    rows: list[Row] = []
    looks = spool_looks(group)
    for spool, look in looks.items():
        own = [sample.test for sample in group.samples if sample.specimen.spool == spool]
        rows += _sample_rows(number, own, _next(rows), look.colour, len(group.samples) > MOST_ROWS)
        if len(looks) == 1:
            break  # its mean is that of all
        mean = number.mean.spool_means.get(spool) if number.mean is not None else None
        label = f"mean of {spool}"
        rows.append(_mean_row(_next(rows), label, mean, look.colour))
    chosen = number.mean.chosen if number.mean is not None else None
    return [*rows, _mean_row(_next(rows), "mean", chosen, "black")]


def _least_width(rows: list[Row], factor: float) -> float:
    """Width of the narrowest interval: with less in view, dots would seem to differ that do not."""
    widths = [row.interval.upper - row.interval.lower for row in rows if row.interval is not None]
    return abs(factor) * min(widths, default=0.0)


def _next(rows: list[Row]) -> float:
    return math.floor(rows[-1].height + 0.5) + 1.0 if rows else 0.0


def _sample_rows(
    number: GroupNumber, tests: list[str], top: float, colour: str, is_crowded: bool
) -> list[Row]:
    if not is_crowded:
        return [_sample_row(number, test, top + at, colour) for at, test in enumerate(tests)]
    label = f"{len(tests)} samples"
    return [
        replace(_sample_row(number, test, top + step, colour), label=label, interval=None, note="")
        for test, step in zip(tests, np.linspace(-0.35, 0.35, len(tests)), strict=True)
    ]


def _mean_row(height: float, label: str, mean: MeanInterval | None, colour: str) -> Row:
    if mean is None:
        return Row(height, label, math.nan, None, colour, "D")
    return Row(height, label, mean.mean, mean.interval, colour, "D")


def _sample_row(number: GroupNumber, test: str, height: float, colour: str) -> Row:
    result = number.values.get(test)
    if result is None or result.value is None:
        return Row(height, test, math.nan, None, colour, "o", note="no number")
    is_marked = any(outlier.sample == test for outlier in number.outliers)
    is_open = result.status is Status.DOUBTFUL
    return Row(height, test, result.value, result.interval, colour, "o", is_open, is_marked)


def _plot_row(row: Row, factor: float, axes: Axes) -> None:
    if math.isnan(row.value):
        axes.text(
            0.5, row.height, row.note, transform=axes.get_yaxis_transform(), ha="center",
            va="center", color=GREY,
        )  # fmt: skip
        return
    if row.interval is not None:
        ends = [factor * row.interval.lower, factor * row.interval.upper]
        width = 1.6 if row.marker == "D" else 0.9
        axes.plot(ends, [row.height] * 2, color=row.colour, linewidth=width)
    face = "white" if row.is_open else row.colour
    axes.plot(factor * row.value, row.height, row.marker, color=row.colour, markerfacecolor=face)
    if row.is_marked:
        axes.plot(factor * row.value, row.height, **_RING)


def _is_first(name: str) -> bool:
    """Tell numbers of the specimen as a whole, or of its first cycle, from those of later ones."""
    return name.partition(".")[2] in {"", "1"}


def _keys(numbers: list[GroupNumber]) -> list[Artist]:
    rings = [line_key("marked as outlier", **_RING)]
    doubts = [line_key("doubtful", color=GREY, marker="o", markerfacecolor="white")]
    results = [result for number in numbers for result in number.values.values()]
    return [
        line_key("sample, 95 %", color=GREY, marker="o"),
        *(doubts if any(result.status is Status.DOUBTFUL for result in results) else []),
        line_key("mean, 95 %", color=GREY, marker="D", linewidth=1.6),
        *(rings if any(number.outliers for number in numbers) else []),
    ]
