"""Numbers of a group as dots: samples, means of spools and the mean, with intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.curve import Interval
from labpipe.records.group import Group, GroupNumber, MeanInterval
from labpipe.records.result import Status
from labpipe.report.figure_page import GREY, limit_to_values, line_key, panel_grid
from labpipe.report.group_plots import RED, group_page, spool_looks
from labpipe.report.wording import as_label, display_of, is_first_cycle, shown_in, unit_words

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    note : text if there is no dot
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
    """Return at most six numbers with two or more samples, no later cycles."""
    max_dot_numbers = 6
    numbers = [
        number
        for number in group.numbers
        if is_first_cycle(number.name)
        and number.mean is not None
        and number.mean.over_samples.n > 1
    ]
    return numbers[:max_dot_numbers]


def draw_dots(group: Group) -> Figure:
    """Draw a panel per number; its rows are samples, spool means and the mean.

    Parameters
    ----------
    group : one that has `numbers_to_draw`
    """
    row_mm = 3.7
    panel_mm = 17.0
    panel_columns = 2
    numbers = numbers_to_draw(group)
    drawn = {number.name for number in numbers}
    left_out = [
        number.name
        for number in group.numbers
        if is_first_cycle(number.name) and number.name not in drawn
    ]
    rows = math.ceil(len(numbers) / panel_columns)
    lines = _next_height(dot_rows(group, numbers[0]))
    note = f"In the tables only: {'; '.join(map(as_label, left_out))}." if left_out else ""
    page = group_page(
        group, _keys(numbers), columns=4, height_mm=rows * (panel_mm + row_mm * lines), note=note
    )
    panels = panel_grid(page, len(numbers), columns=panel_columns, sharey=True)
    for number, axes in zip(numbers, panels, strict=True):
        plot_dots(group, number, axes)
    return page


def plot_dots(group: Group, number: GroupNumber, axes: Axes) -> None:
    """Draw one number: a dot and its interval per row.

    Parameters
    ----------
    group : gives looks and display units
    number : one with a mean
    axes : to draw on
    """
    unit = shown_in(number.name, number.unit, display_of(group))
    rows = dot_rows(group, number)
    for row in rows:
        _plot_row(row, unit.factor, axes)
    labels = {math.floor(row.height + 0.5): row.label for row in rows}
    axes.set_yticks(list(labels), list(labels.values()))
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.set_title(as_label(number.name), loc="left")
    axes.set_xlabel(unit_words(unit.unit))
    limit_to_values(
        [unit.factor * row.value for row in rows], axes, _least_width(rows, unit.factor)
    )
    axes.locator_params(axis="x", nbins=5)


def dot_rows(group: Group, number: GroupNumber) -> list[Row]:
    """Return the rows of a panel: samples and mean of each spool, then the mean of all.

    Parameters
    ----------
    group, number : a sample without the number keeps its row, with a note

    Returns
    -------
    Rows at the same heights for every number of a group. In a group of more than 24
    samples those of a spool share a row, side by side, without intervals.
    """
    # Samples with a row each; in larger groups the samples of a spool share a row.
    max_dot_rows = 24
    rows: list[Row] = []
    looks = spool_looks(group)
    for spool, look in looks.items():
        tests = [sample.test for sample in group.samples if sample.specimen.spool == spool]
        rows += _sample_rows(
            number, tests, _next_height(rows), look.colour, len(group.samples) > max_dot_rows
        )
        if len(looks) == 1:
            break  # its mean is that of all
        mean = number.mean.spool_means.get(spool) if number.mean is not None else None
        label = f"mean of {spool}"
        rows.append(_mean_row(_next_height(rows), label, mean, look.colour))
    chosen = number.mean.chosen if number.mean is not None else None
    return [*rows, _mean_row(_next_height(rows), "mean", chosen, "black")]


def _least_width(rows: list[Row], factor: float) -> float:
    """Return the width of the narrowest interval, below which dots would falsely seem to differ."""
    widths = [row.interval.upper - row.interval.lower for row in rows if row.interval is not None]
    return abs(factor) * min(widths, default=0.0)


def _next_height(rows: list[Row]) -> float:
    return math.floor(rows[-1].height + 0.5) + 1.0 if rows else 0.0


def _sample_rows(
    number: GroupNumber, tests: list[str], top: float, colour: str, is_crowded: bool
) -> list[Row]:
    if not is_crowded:
        return [_sample_row(number, test, top + place, colour) for place, test in enumerate(tests)]
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
