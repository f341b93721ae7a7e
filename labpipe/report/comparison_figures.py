"""Figures over groups that differ in one field: mean curves and the main number of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.group import Band, Campaign, GroupNumber
from labpipe.report.comparisons import Family, context_words, equal_words, families, field_words
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    Look,
    PageTexts,
    area_key,
    keyed_page,
    limit_to_values,
    line_key,
    panel_letter,
    style_colours,
    write_reason,
)
from labpipe.report.group_figures import stems
from labpipe.report.group_plots import group_scale, interval_key, plot_marks
from labpipe.report.plot_thinning import simplify_line
from labpipe.report.saving import FigureToSave
from labpipe.report.wording import as_label, display_of, heading, shortened, shown_in

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAIN_NUMBER = "bending_stiffness"
_BAND_LOOK: dict[str, Any] = {"alpha": 0.16, "linewidth": 0, "zorder": 1}
_DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)), (0, (9, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip
_SIGNS = "osD^vP"
_MAX_LABEL_LENGTH = 34


def figures_of_families(campaign: Campaign) -> Iterator[tuple[str, FigureToSave]]:
    """List the figures of the groups that differ in one field alone.

    Parameters
    ----------
    campaign : with its differences

    Yields
    ------
    The field and its figure, in the order of the questions.
    """
    drawn = families(campaign)
    names = stems(f"difference {x.field}: {context_words(x.groups, x.field)}" for x in drawn)
    for family, name in zip(drawn, names, strict=True):
        yield (
            family.field,
            FigureToSave(name, partial(draw_family, family), caption(family), _alt(family)),
        )


def caption(family: Family) -> str:
    """Describe the figure of a family and what it does not show."""
    first = family.groups[0]
    above = f"{field_words(family.field)}: {', '.join(family.labels)}; "
    text = (
        f"{above}{equal_words(family.groups, family.field)}. (a) Mean force on first loading, only"
        f" where all samples of a group have data{_interval_words(family)}."
    )
    if _is_scaled(family):
        text += " (b) The same for force / peak force of each sample."
    number = main_number(family)
    if number:
        text += (
            f" ({'c' if _is_scaled(family) else 'b'}) {as_label(number)}: mean of each group"
            " with its 95 % interval, clipped to the panel; small dots: samples."
        )
    lone = [
        word for word, group in zip(family.labels, family.groups, strict=True) if group.band.n == 1
    ]
    lacking = [
        word
        for word, group in zip(family.labels, family.groups, strict=True)
        if not len(group.band.displacement)
    ]
    return " ".join(
        [
            text,
            *([f"One sample, no band: {', '.join(lone)}."] if lone else []),
            *([f"No mean curve: {', '.join(lacking)}."] if lacking else []),
            *(["Protocol: " + first.protocol + "."]),
        ]
    )


def _interval_words(family: Family) -> str:
    bands = [group.band for group in family.groups]
    band_text = "; pale: pointwise 95 % band of the mean"
    marks = "; vertical: 95 % intervals of means of fewer than six curves, side by side"
    return band_text * any(band.has_area for band in bands) + marks * any(
        len(band.marks) for band in bands
    )


def _alt(family: Family) -> str:
    return (
        f"Mean force against displacement of {len(family.groups)} groups that differ in"
        f" {family.field.replace('_', ' ')}: {', '.join(family.labels)}."
    )


def main_number(family: Family) -> str:
    """Return the number by which groups are compared: bending stiffness or the first common one.

    Parameters
    ----------
    family : of groups

    Returns
    -------
    Empty without a common number.
    """
    has = [{number.name for number in group.numbers if number.mean} for group in family.groups]
    shared = [
        number.name
        for number in family.groups[0].numbers
        if all(number.name in names for names in has)
    ]
    return MAIN_NUMBER if MAIN_NUMBER in shared else next(iter(shared), "")


def draw_family(family: Family) -> Figure:
    """Draw force, force / peak force, if available, and the main number of the groups.

    Parameters
    ----------
    family : at most six groups
    """
    scaled = _is_scaled(family)
    number = main_number(family)
    title = f"{field_words(family.field)}  \u00b7  {context_words(family.groups, family.field)}"
    page = keyed_page(PageTexts(title, keys=_keys(family)), height_mm=66.0, width_mm=DOUBLE_COLUMN)
    count = 1 + scaled + bool(number)
    panels = iter(page.subplots(1, count, squeeze=False).ravel())
    letters = iter("abc")
    axes = next(panels)
    plot_bands(family, axes)
    panel_letter(axes, next(letters), "First loading")
    if scaled:
        axes = next(panels)
        plot_bands(family, axes, is_scaled=True)
        panel_letter(axes, next(letters), "Force / peak force")
    if number:
        axes = next(panels)
        plot_means(family, number, axes)
        panel_letter(axes, next(letters), as_label(number))
    return page


def plot_bands(family: Family, axes: Axes, *, is_scaled: bool = False) -> None:
    """Draw the mean curve of each group with its pointwise band.

    Parameters
    ----------
    family : of groups; a group without a mean curve is left out
    axes : to draw on
    is_scaled : draw force / peak force
    """
    first = family.groups[0]
    across = group_scale(first, "displacement")
    up = 1.0 if is_scaled else group_scale(first, "force").factor
    drawn = [
        (look, band)
        for look, group in zip(_looks(family), family.groups, strict=True)
        if (band := group.band_scaled if is_scaled else group.band) is not None
        and len(band.displacement)
    ]
    if not drawn:
        write_reason(axes, "No group has a mean curve.")
        return
    places = [number - 0.5 * (len(drawn) - 1) for number in range(len(drawn))]
    for look, band in drawn:
        x, rows = across.factor * band.displacement, _line_points(band, band.mean)
        axes.plot(x[rows], up * band.mean[rows], color=look.colour, linestyle=look.dash, zorder=3)
        # between intervals of two groups, of the largest displacement
        shift = 0.008 * band.displacement[-1] * places.pop(0)
        plot_marks(band, axes, across.factor, up, color=look.colour, shift=shift)
        if band.has_area:
            rows = np.union1d(_line_points(band, band.lower), _line_points(band, band.upper))
            edges = (up * band.lower[rows], up * band.upper[rows])
            axes.fill_between(x[rows], *edges, color=look.colour, **_BAND_LOOK)
    axes.set_ylim(*_force_limits([band for _, band in drawn], up))
    axes.set_xlabel(across.label("Displacement"))
    axes.set_ylabel(
        "Force / peak force" if is_scaled else group_scale(first, "force").label("Force")
    )


def _line_points(band: Band, values: Floats) -> Ints:
    """Return the points with which a line of a band is drawn, few enough for a small file."""
    return simplify_line(band.displacement, values, points=40, tolerance=0.003)


def _force_limits(bands: Sequence[Band], up: float) -> tuple[float, float]:
    """Return the limits of the axis: full means, and bands only as far as the means stay apart."""
    low = min(float(np.nanmin(band.mean)) for band in bands)
    high = max(float(np.nanmax(band.mean)) for band in bands)
    room = 0.4 * (high - low)  # for bands, above and below the means
    edges = [edge for band in bands for edge in (band.lower, band.upper) if np.isfinite(edge).any()]
    least = min([low, *(float(np.nanmin(edge)) for edge in edges)])
    highest = max([high, *(float(np.nanmax(edge)) for edge in edges)])
    margin = 0.04 * (high - low) or 1.0
    return up * (max(least, low - room) - margin), up * (min(highest, high + room) + margin)


def plot_means(family: Family, name: str, axes: Axes) -> None:
    """Draw one number: a row per group, its mean and interval, and its samples.

    Parameters
    ----------
    family : of groups that all have the number
    name : of the number
    axes : to draw on
    """
    numbers = [
        next(number for number in group.numbers if number.name == name) for group in family.groups
    ]
    unit = shown_in(name, numbers[0].unit, display_of(family.groups[0]))
    every: list[float] = []
    for row, (number, look, sign) in enumerate(
        zip(numbers, _looks(family), _SIGNS[: len(numbers)], strict=True)
    ):
        values = [
            unit.factor * value.value for value in number.values.values() if value.value is not None
        ]
        axes.plot(values, [row + 0.22] * len(values), ".", color=look.colour, markersize=3)
        every += [*values, unit.factor * _plot_mean(number, row, (look, sign), unit.factor, axes)]
    axes.set_yticks(
        range(len(numbers)), [shortened(word, _MAX_LABEL_LENGTH) for word in family.labels]
    )
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(numbers) - 0.4, -0.6)
    axes.set_xlabel(heading(name, unit.unit))
    axes.locator_params(axis="x", nbins=4)
    limit_to_values(every, axes)


def _plot_mean(
    number: GroupNumber, row: int, look: tuple[Look, str], factor: float, axes: Axes
) -> float:
    if number.mean is None:
        return float("nan")
    chosen, colour = number.mean.chosen, look[0].colour
    if chosen.interval is not None:
        ends = [factor * chosen.interval.lower, factor * chosen.interval.upper]
        axes.plot(ends, [row, row], color=colour, linewidth=1.4)
    axes.plot([factor * chosen.mean], [row], marker=look[1], color=colour, markersize=5)
    return chosen.mean


def _is_scaled(family: Family) -> bool:
    bands = [group.band_scaled for group in family.groups]
    return any(band is not None and len(band.displacement) for band in bands)


def _looks(family: Family) -> list[Look]:
    """Give each group a colour and a dash that also differ in grey."""
    colours = style_colours()
    return [Look(colours[i % len(colours)], _DASHES[i]) for i in range(len(family.groups))]


def _keys(family: Family) -> list[Artist]:
    keys: list[Artist] = [
        line_key(
            f"{shortened(word, _MAX_LABEL_LENGTH)} (n = {group.band.n})",
            color=look.colour,
            linestyle=look.dash,
        )
        for look, word, group in zip(_looks(family), family.labels, family.groups, strict=True)
    ]
    if any(len(group.band.marks) for group in family.groups):
        keys.append(interval_key("95 % interval of the mean", color=GREY))
    keys.append(line_key("sample", color=GREY, marker=".", markersize=3, linestyle=""))
    if any(group.band.has_area for group in family.groups):
        keys.append(area_key("95 % band, pointwise", color=GREY, **_BAND_LOOK))
    return keys
