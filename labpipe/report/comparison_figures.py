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
    keep_in_view,
    keyed_page,
    line_key,
    panel_letter,
    say,
    style_colours,
)
from labpipe.report.group_figures import stems
from labpipe.report.group_plots import group_scale, interval_key, plot_marks
from labpipe.report.plot_thinning import bends
from labpipe.report.saving import FigureToSave
from labpipe.report.wording import display_of, heading, in_words, shortened, shown_in

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAIN = "bending_stiffness"
_HEIGHT = 66.0
_POINTS, _UNSEEN = 40, 0.003
"""Points of a curve at the most, and the share of its height by which it may be off, so that a
page of eighteen groups is below 2 MB."""
_SHIFT = 0.008
"""How far apart intervals of two groups at one displacement are drawn, as a share of it all."""
_ROOM = 0.4
"""Height left for bands above and below the mean curves, as a share of theirs."""
_BAND_LOOK: dict[str, Any] = {"alpha": 0.16, "linewidth": 0, "zorder": 1}
_DASHES: tuple[Any, ...] = (
    "-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)), (0, (9, 2)),
    (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip
_SIGNS = "osD^vP"
_LONGEST = 34


def figures_of_families(campaign: Campaign) -> Iterator[tuple[str, FigureToSave]]:
    """List the figures of the groups that differ in one field alone.

    Parameters
    ----------
    campaign : with its differences

    Yields
    ------
    The field and its figure, in the order of the questions.
    """
    own = families(campaign)
    every = [f"{each.field}: {context_words(each.groups, each.field)}" for each in own]
    for family, name in zip(own, stems(f"difference {each}" for each in every), strict=True):
        yield (
            family.field,
            FigureToSave(name, partial(draw_family, family), caption(family), _alt(family)),
        )


def caption(family: Family) -> str:
    """Say how to read the figure of a family, and what it cannot show."""
    first = family.groups[0]
    above = f"{field_words(family.field)}: {', '.join(family.words)}; "
    words = (
        f"{above}{equal_words(family.groups, family.field)}. (a) Mean force on first loading, only"
        f" where all samples of a group have data{_interval_words(family)}."
    )
    if _is_scaled(family):
        words += " (b) The same for force / peak force of each sample."
    number = main_number(family)
    if number:
        words += (
            f" ({'c' if _is_scaled(family) else 'b'}) {in_words(number)}: mean of each group with"
            " its 95 % interval, cut where it is wider than the panel; small dots are samples."
        )
    lone = [
        word for word, group in zip(family.words, family.groups, strict=True) if group.band.n == 1
    ]
    lacking = [
        word
        for word, group in zip(family.words, family.groups, strict=True)
        if not len(group.band.displacement)
    ]
    return " ".join(
        [
            words,
            *([f"One sample, no band: {', '.join(lone)}."] if lone else []),
            *([f"No mean curve: {', '.join(lacking)}."] if lacking else []),
            *(["Protocol: " + first.protocol + "."]),
        ]
    )


def _interval_words(family: Family) -> str:
    bands = [group.band for group in family.groups]
    words = "; pale: holds the mean at any one displacement with 95 %"
    marks = "; vertical: 95 % intervals of means over fewer than six curves, side by side"
    return words * any(band.has_area for band in bands) + marks * any(
        len(band.marks) for band in bands
    )


def _alt(family: Family) -> str:
    return (
        f"Mean force against displacement of {len(family.groups)} groups that differ in"
        f" {family.field.replace('_', ' ')}: {', '.join(family.words)}."
    )


def main_number(family: Family) -> str:
    """Name the number that groups are compared by: bending stiffness, else the first that all have.

    Parameters
    ----------
    family : of groups

    Returns
    -------
    Empty where there is none.
    """
    has = [{number.name for number in group.numbers if number.mean} for group in family.groups]
    shared = [
        number.name for number in family.groups[0].numbers if all(number.name in own for own in has)
    ]
    return MAIN if MAIN in shared else next(iter(shared), "")


def draw_family(family: Family) -> Figure:
    """Draw groups over each other: force, force / peak force where there is one, the main number.

    Parameters
    ----------
    family : six groups at the most
    """
    scaled = _is_scaled(family)
    number = main_number(family)
    title = f"{field_words(family.field)}  \u00b7  {context_words(family.groups, family.field)}"
    page = keyed_page(
        PageTexts(title, keys=_keys(family)), height_mm=_HEIGHT, width_mm=DOUBLE_COLUMN
    )
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
        panel_letter(axes, next(letters), in_words(number))
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
        say(axes, "No group has a mean curve.")
        return
    places = [at - 0.5 * (len(drawn) - 1) for at in range(len(drawn))]
    for look, band in drawn:
        x, kept = across.factor * band.displacement, _drawn(band, band.mean)
        axes.plot(x[kept], up * band.mean[kept], color=look.colour, linestyle=look.dash, zorder=3)
        shift = _SHIFT * band.displacement[-1] * places.pop(0)
        plot_marks(band, axes, across.factor, up, color=look.colour, shift=shift)
        if band.has_area:
            kept = np.union1d(_drawn(band, band.lower), _drawn(band, band.upper))
            edges = (up * band.lower[kept], up * band.upper[kept])
            axes.fill_between(x[kept], *edges, color=look.colour, **_BAND_LOOK)
    axes.set_ylim(*_seen([band for _, band in drawn], up))
    axes.set_xlabel(across.label("Displacement"))
    axes.set_ylabel(
        "Force / peak force" if is_scaled else group_scale(first, "force").label("Force")
    )


def _drawn(band: Band, values: Floats) -> Ints:
    """Points that a line through values of a band is drawn with."""
    return bends(band.displacement, values, points=_POINTS, tolerance=_UNSEEN)


def _seen(bands: Sequence[Band], up: float) -> tuple[float, float]:
    """Means in full, and as much of their bands as leaves the means apart."""
    low = min(float(np.nanmin(band.mean)) for band in bands)
    high = max(float(np.nanmax(band.mean)) for band in bands)
    room = _ROOM * (high - low)
    edges = [edge for band in bands for edge in (band.lower, band.upper) if np.isfinite(edge).any()]
    least = min([low, *(float(np.nanmin(edge)) for edge in edges)])
    most = max([high, *(float(np.nanmax(edge)) for edge in edges)])
    margin = 0.04 * (high - low) or 1.0
    return up * (max(least, low - room) - margin), up * (min(most, high + room) + margin)


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
    shown = shown_in(name, numbers[0].unit, display_of(family.groups[0]))
    every: list[float] = []
    for row, (number, look, sign) in enumerate(
        zip(numbers, _looks(family), _SIGNS[: len(numbers)], strict=True)
    ):
        values = [
            shown.factor * value.value
            for value in number.values.values()
            if value.value is not None
        ]
        axes.plot(values, [row + 0.22] * len(values), ".", color=look.colour, markersize=3)
        every += [*values, shown.factor * _plot_mean(number, row, (look, sign), shown.factor, axes)]
    axes.set_yticks(range(len(numbers)), [shortened(word, _LONGEST) for word in family.words])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(numbers) - 0.4, -0.6)
    axes.set_xlabel(heading(name, shown.unit))
    axes.locator_params(axis="x", nbins=4)
    keep_in_view(every, axes)


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
    """A colour and a dash of its own for each group, to be told apart in grey too."""
    own = style_colours()
    return [Look(own[at % len(own)], _DASHES[at]) for at in range(len(family.groups))]


def _keys(family: Family) -> list[Artist]:
    keys: list[Artist] = [
        line_key(
            f"{shortened(word, _LONGEST)} (n = {group.band.n})",
            color=look.colour,
            linestyle=look.dash,
        )
        for look, word, group in zip(_looks(family), family.words, family.groups, strict=True)
    ]
    if any(len(group.band.marks) for group in family.groups):
        keys.append(interval_key("95 % interval of the mean", color=GREY))
    keys.append(line_key("one sample", color=GREY, marker=".", markersize=3, linestyle=""))
    if any(group.band.has_area for group in family.groups):
        keys.append(area_key("95 % band, point by point", color=GREY, **_BAND_LOOK))
    return keys
