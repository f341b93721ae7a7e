"""The figures of a group: slips, dots of each number, which figures there are, and saving them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.curve import Interval, SlipDecision
from labpipe.records.group import Band, Group, GroupNumber, MeanInterval, Sample, SampleCurve
from labpipe.records.result import Status
from labpipe.report.budget_figures import budgets_to_draw, draw_group_budgets
from labpipe.report.figure_page import GREY, keep_in_view, line_key, panel_grid
from labpipe.report.group_plots import (
    RED,
    count_words,
    draw_curves,
    draw_lines,
    draw_scaled,
    finite_end,
    first_loading,
    group_page,
    group_scale,
    has_lines,
    label_axes,
    seen,
    spool_looks,
    thin,
)
from labpipe.report.group_shapes import (
    draw_group_laws,
    draw_group_shapes,
    has_laws,
    has_shapes,
)
from labpipe.report.saving import FigureToSave, SavedFigure, save_report_figures
from labpipe.report.wording import display_of, in_words, shortened, shown_in, unit_words

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_PANELS = 8
_SLIP_COLUMNS = 2
_HEIGHT = 62.0
_LONGEST = 40
_MEASURED: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (4, 1.6))}
_CUT: dict[str, Any] = {"color": GREY, "linewidth": 0.6, "linestyle": ":"}


def with_slips(group: Group) -> list[Sample]:
    """Samples of a group that slipped and have a curve."""
    return [
        sample for sample in group.samples if sample.slips and first_loading(sample) is not None
    ]


def draw_slips(group: Group) -> Figure:
    """Draw a panel for each sample that slipped, at the most `MOST_PANELS`.

    Parameters
    ----------
    group : one with slips; samples beyond the last panel are named in the footnote
    """
    samples = with_slips(group)
    shown, rest = samples[:MOST_PANELS], samples[MOST_PANELS:]
    rows = math.ceil(len(shown) / _SLIP_COLUMNS)
    note = (
        f"Not drawn, but in the list of slips: {', '.join(s.test for s in rest)}." if rest else ""
    )
    page = group_page(group, _slip_keys(shown), height_mm=_HEIGHT * rows, note=note)
    panels = panel_grid(page, len(shown), columns=_SLIP_COLUMNS, sharey=True)
    for sample, axes in zip(shown, panels, strict=True):
        plot_slips(group, sample, axes)
        axes.set_title(shortened(sample.test, _LONGEST), loc="left")
        axes.label_outer(remove_inner_ticks=True)
    return page


def plot_slips(group: Group, sample: Sample, axes: Axes) -> None:
    """Draw the first loading of one sample: as measured dashed, as processed solid, slips marked.

    Parameters
    ----------
    group : gives looks and display units
    sample : one with a curve
    axes : to draw on
    """
    curve = first_loading(sample)
    if curve is None:
        return
    across = group_scale(group, "displacement").factor
    up = group_scale(group, "force").factor
    if _is_repaired(sample):
        x, y = thin(curve, curve.as_measured)
        axes.plot(x * across, y * up, **_MEASURED)
    x, y = thin(curve, curve.force)
    axes.plot(x * across, y * up, color=spool_looks(group)[sample.specimen.spool].colour)
    for slip in sample.slips:
        height = _height(curve, slip.position)
        axes.axvline(slip.position * across, **_CUT)
        axes.plot(slip.position * across, height * up, "v", color=RED, zorder=5)
    label_axes(group, axes)


def _height(curve: SampleCurve, position: float) -> float:
    """Force of the curve at a slip, N; NaN outside of it."""
    known = np.isfinite(curve.force) & np.isfinite(curve.displacement)
    x, y = curve.displacement[known], curve.force[known]
    return float(np.interp(position, x, y, left=np.nan, right=np.nan)) if len(x) else math.nan


def _is_repaired(sample: Sample) -> bool:
    return any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips)


def _slip_keys(samples: list[Sample]) -> list[Artist]:
    keys: list[Artist] = [line_key("as processed")]
    if any(_is_repaired(sample) for sample in samples):
        keys.append(line_key("as measured", **_MEASURED))
    keys.append(line_key("slip", color=RED, marker="v", linestyle=""))
    return keys


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
        each
        for each in group.numbers
        if _is_first(each.name) and each.mean is not None and each.mean.over_samples.n > 1
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
        each.name for each in group.numbers if _is_first(each.name) and each.name not in drawn
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
        *(doubts if any(each.status is Status.DOUBTFUL for each in results) else []),
        line_key("mean, 95 %", color=GREY, marker="D", linewidth=1.6),
        *(rings if any(number.outliers for number in numbers) else []),
    ]


def drawings(group: Group) -> Iterator[FigureToSave]:
    """List the figures that a group has data for; the curves are always there.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    Curves, normalised curves, shapes, measured laws, slips, fitted lines, numbers, budgets, by
    names without
    that of the group.
    """
    about = f"{group.name}, {count_words(group)}"
    yield FigureToSave(
        "curves", partial(draw_curves, group), _curve_caption(group, group.band), _curve_alt(group)
    )
    if group.band_scaled is not None:
        caption = (
            "Force over the peak force of the same sample. What is left of the scatter is not"
            " a matter of strength. " + _curve_caption(group, group.band_scaled, is_scaled=True)
        )
        alt = f"Force over peak force against displacement of {about}."
        yield FigureToSave("scaled", partial(draw_scaled, group), caption, alt)
    if has_shapes(group):
        alt = f"Shapes of {about} at equal steps of deflection."
        yield FigureToSave("shapes", partial(draw_group_shapes, group), _SHAPES, alt)
    if has_laws(group):
        alt = f"Measured bending moment against curvature of {about}."
        yield FigureToSave("moment", partial(draw_group_laws, group), _LAWS, alt)
    if with_slips(group):
        caption = (
            "Samples that slid in their grips, first loading. Grey and dashed: the force as it was"
            " measured. In colour: the force that the numbers were taken from. Each triangle is a"
            " slip of the list above."
        )
        slipped = ", ".join(sample.test for sample in with_slips(group))
        yield FigureToSave(
            "slips", partial(draw_slips, group), caption, f"Slips of {slipped} on their curves."
        )
    if has_lines(group):
        yield FigureToSave("lines", partial(draw_lines, group), _LINES, _line_alt(group))
    numbers = numbers_to_draw(group)
    if numbers:
        names = "; ".join(in_words(number.name) for number in numbers)
        yield FigureToSave(
            "numbers", partial(draw_dots, group), _DOTS, f"Each sample's {names}: {about}."
        )
    if budgets_to_draw(group):
        alt = f"Shares of the causes of the intervals of {about}."
        yield FigureToSave("budgets", partial(draw_group_budgets, group), _BUDGETS, alt)


_SHAPES = (
    "Where cameras saw the samples at equal steps of the first loading, at equal axis scale; a"
    " colour is a deflection. Dots are markers, which lie beside the axis, or sections of markers;"
    " of a clamped sample the first and the last dot are on the axis. Lines only join them."
)
_LAWS = (
    "Bending moment against curvature on first loading, as measured by load cell and cameras, a"
    " line for each sample."
)
_LINES = (
    "Straight lines over the windows that they were fitted in, on the first loading of each"
    " sample (grey). The slopes in the key are those of the table of means. Broad and pale: the"
    " windows that the protocol sets. Dotted: the two segments whose break point was fitted too."
    " The curves go on beyond the right edge."
)
_BUDGETS = (
    "What the intervals are made of; of numbers of cycles, those of the first. (a) Of one test:"
    " medians of the shares of its variance over the samples, scaled to 100 %. (b) Of the mean of"
    " the group, with half the width of its interval: more samples make the scatter smaller, and"
    " not what is hatched."
)
_DOTS = (
    "A dot and its 95 % interval for each sample, for the mean of each spool and for the mean that"
    " holds (the last row). In large groups the samples of a spool share a row, without intervals."
    " Intervals that are wider than the panel are cut by its edge; the tables have their ends."
)


def _curve_caption(group: Group, band: Band, *, is_scaled: bool = False) -> str:
    words = (
        "Thin: the first loading of each sample, up to its failure where it failed. Faint:"
        " unloading and later cycles, where there are any."
    )
    mean = f" Thick: the mean of {band.n} {band.over}, drawn only where all of them have data."
    if len(band.marks):
        cut = _cut_words(group, band, is_scaled=is_scaled)
        return f"{words}{mean} Vertical: 95 % intervals of the mean at three displacements.{cut}"
    if not band.has_area:
        return f"{words} There is no band; the figure says why."
    return (
        f"{words}{mean} Grey area: holds the mean at any one displacement with 95 %."
        + _whole_words(group, band, is_scaled=is_scaled)
        + _cut_words(group, band, is_scaled=is_scaled)
    )


def _whole_words(group: Group, band: Band, *, is_scaled: bool) -> str:
    """Of the band for the whole curve, and how far it goes where the panel does not show it."""
    if not np.isfinite(band.lower_all).any():
        return ""
    words = " Dashed edges: hold the whole mean curve with 95 %."
    low, high = seen(group, band, is_scaled=is_scaled)
    if low <= np.nanmin(band.lower_all) and np.nanmax(band.upper_all) <= high:
        return words
    at = int(np.nanargmax(band.upper_all - band.lower_all))
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    force, unit = (1.0, "") if is_scaled else (up.factor, f" {up.unit}")
    return (
        f"{words} They leave the panel, as {band.n} curves say little about a whole one:"
        f" at {across.factor * band.displacement[at]:.3g} {across.unit}, where they are furthest"
        f" apart, they are at {force * band.lower_all[at]:.3g} and"
        f" {force * band.upper_all[at]:.3g}{unit}."
    )


def _cut_words(group: Group, band: Band, *, is_scaled: bool) -> str:
    low, high = seen(group, band, is_scaled=is_scaled)
    is_cut = np.nanmin(band.lower) < low or np.nanmax(band.upper) > high
    what = "The grey area is" if band.has_area else "Intervals are"
    return f" {what} wider than the panel and cut by its edge." if is_cut else ""


def _curve_alt(group: Group) -> str:
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    words = f"Force against displacement: {group.name}, {count_words(group)}."
    if not len(group.band.displacement):
        return words
    far = across.factor * finite_end(group.band.displacement)
    top = up.factor * finite_end(group.band.mean)
    return (
        f"{words} The mean reaches {top:.3g} {up.unit}; it is known up to {far:.3g} {across.unit}."
    )


def _line_alt(group: Group) -> str:
    names = dict.fromkeys(line.result for sample in group.samples for line in sample.lines)
    words = "; ".join(in_words(name) for name in names)
    return f"Fitted lines on the curves of {group.name}: {words}."


def save_drawings(group: Group, folder: Path, *, stem: str) -> list[SavedFigure]:
    """Draw the figures of a group and save each as SVG, PNG and PDF.

    Parameters
    ----------
    group : to draw
    folder : there already
    stem : begins the names of the files, and the ids of the drawings in a page

    Returns
    -------
    In the order of `drawings`.
    """
    wanted = [each._replace(name=f"{stem}-{each.name}") for each in drawings(group)]
    return save_report_figures(wanted, folder)


def stems(names: Iterable[str]) -> list[str]:
    """Turn names of groups into beginnings of file names: ASCII, lower case, each its own.

    Examples
    --------
    >>> stems(["A2, wire cantilever", "A2-wire-cantilever", "°"])
    ['a2-wire-cantilever', 'a2-wire-cantilever-2', 'group']
    """
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "group"
        stem, number = plain, 1
        while stem in found:
            number += 1
            stem = f"{plain}-{number}"
        found.append(stem)
    return found
