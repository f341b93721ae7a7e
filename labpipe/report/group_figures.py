"""Figures of groups and of their comparisons as files, and the plots of comparisons."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.group import Band, Campaign, Group
from labpipe.report.comparisons import (
    Family,
    describe_context,
    describe_equal_fields,
    find_families,
    name_field,
)
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    WIDTH,
    FigureToSave,
    add_key,
    add_title,
    choose_dash,
    list_style_colours,
    make_empty_page,
    make_page,
    make_panels,
    read_look,
)
from labpipe.report.group_plots import (
    N_COLOURS,
    DotRow,
    make_band_lines,
    make_clipped_axis,
    make_dot_lines,
    make_file_plots,
    make_mean_lines,
)
from labpipe.report.page_facts import make_stems
from labpipe.report.plot_records import Axis, LegendEntry, Line, Plot, clip_range, make_axis
from labpipe.report.wording import (
    Scale,
    find_display,
    find_display_unit,
    find_units,
    shorten,
    write_count,
    write_group_title,
    write_label,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_plots(title: str, plots: Sequence[Plot], *, columns: int = 2) -> Figure:
    """Draw plots of the page as a figure of a file.

    Parameters
    ----------
    title : of the figure
    plots : at least one, a panel each; their captions are the footnote
    columns : largest number of panels side by side
    """
    frame_mm, mm_per_point, single_mm = 14.0, 0.3, 68.0
    plot = plots[0]
    rows = math.ceil(len(plots) / columns)
    height = mm_per_point * plot.size[1] if len(plots) > 1 else single_mm
    width = WIDTH if len(plots) <= 2 else DOUBLE_COLUMN
    if plot.kind == "shapes":
        height = (width - frame_mm) * plot.size[1] / plot.size[0]
    page = make_page(height_mm=rows * (frame_mm + height), width_mm=width)
    for drawn, axes in zip(plots, make_panels(page, len(plots), columns=columns), strict=True):
        plot_lines(drawn, axes)
    return add_title(page, title, " ".join(dict.fromkeys(drawn.caption for drawn in plots)))


def plot_lines(plot: Plot, axes: Axes) -> None:
    """Draw the lines of a plot, its axes and its key.

    Parameters
    ----------
    plot : of the page
    axes : to draw on
    """
    for line in plot.lines:
        draw: Any = axes.fill if line.is_closed else axes.plot
        draw(line.x, line.y, **_look(line.css_class))
    for entry in plot.legend:
        is_area = entry.css_class.startswith("band")
        add_key(axes, shorten(entry.label, 100), is_area=is_area, **_look(entry.css_class))
    axes.set(xlim=(plot.x.low, plot.x.high), ylim=(plot.y.low, plot.y.high))
    axes.set(xlabel=plot.x.label, ylabel=plot.y.label)
    axes.locator_params(axis="x", nbins=6)
    if plot.heading:
        axes.set_title(shorten(plot.heading, 40), loc="left")
    if plot.kind == "shapes":
        axes.set_aspect("equal", adjustable="box", anchor="W")
    if plot.y.row_names:
        axes.set_yticks(range(0, -len(plot.y.row_names), -1), plot.y.row_names)
        axes.tick_params(axis="y", length=0)


def _look(classes: str) -> dict[str, Any]:
    """Return the look of a line by its classes on the page."""
    kind, _, colour = classes.partition(" ")
    look = {"color": "black", **read_look(kind)}
    if colour:
        number, colours = int(colour[1:]), list_style_colours()
        look["color"] = colours[number % len(colours)]
        if kind in {"curve", "mean"}:
            look["linestyle"] = choose_dash(number)
    return look


def list_group_figures(group: Group) -> Iterator[FigureToSave]:
    """List the figures for which a group has data.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    The figures of `make_file_plots`, and ``budgets`` of the intervals, by names without the group.
    Without curves, the figure ``curves`` says why it is empty.
    """
    title = write_group_title(group)
    figures = make_file_plots(group)
    if "curves" not in figures:
        what = "No sample in this group." if not group.samples else "No sample has a curve."
        yield FigureToSave("curves", partial(make_empty_page, title, what), what, what)
    for name, plots in figures.items():
        yield FigureToSave(
            name, partial(draw_plots, title, plots), plots[0].caption, plots[0].title
        )


def list_family_figures(campaign: Campaign) -> Iterator[FigureToSave]:
    """List a figure for each family of groups that differ in one field alone.

    Parameters
    ----------
    campaign : with its differences
    """
    drawn = find_families(campaign)
    names = make_stems(
        f"difference {x.field}: {describe_context(x.groups, x.field)}" for x in drawn
    )
    for family, name in zip(drawn, names, strict=True):
        plots = make_family_plots(family, has_scaled=True)
        if not plots:
            continue
        field, alike = name_field(family.field), describe_equal_fields(family.groups, family.field)
        title = f"{field}  \u00b7  {describe_context(family.groups, family.field)}"
        labels, protocol = ", ".join(family.labels), family.groups[0].protocol
        caption = f"{field}: {labels}; {alike}. Protocol: {protocol}."
        yield FigureToSave(
            name, partial(draw_plots, title, plots, columns=3), caption, plots[0].title
        )


def make_family_plots(
    family: Family, stems: Mapping[str, str] | None = None, *, has_scaled: bool = False
) -> list[Plot]:
    """Make the plots of a family: mean curves, and the main number of each group.

    Parameters
    ----------
    family : of groups
    stems : names of groups in links, by name; None for files
    has_scaled : include force over peak force
    """
    names = stems or {group.name: group.name for group in family.groups}
    plots = [
        _curve_plot(family, names),
        _curve_plot(family, names, is_scaled=True) if has_scaled else None,
        _mean_plot(family, names),
    ]
    return [plot for plot in plots if plot is not None]


def _curve_plot(
    family: Family, stems: Mapping[str, str], *, is_scaled: bool = False
) -> Plot | None:
    """Return the plot of the mean first loading of each group with its band."""
    first = family.groups[0]
    x_unit, y_unit = find_units(find_display(first), "displacement", "force")
    if is_scaled:
        y_unit = Scale(1.0, "")
    lines, keys, bands = [], [], []
    for at, (group, label) in enumerate(zip(family.groups, family.labels, strict=True)):
        band = group.band_scaled if is_scaled else group.band
        if band is None:
            continue
        look, stem = f"c{at % N_COLOURS}", stems[group.name]
        bands.append(band)
        lines += [
            *make_band_lines(band, x_unit.factor, y_unit.factor, look, stem),
            *make_mean_lines(band, x_unit.factor, y_unit.factor, look, stem),
        ]
        keys.append(LegendEntry(f"mean {look}", f"{label} (n = {group.band.n})", "group", stem))
    if not lines:
        return None
    kinds = {line.css_class.partition(" ")[0] for line in lines}
    keys += [LegendEntry(kind, label) for kind, label in _SIGNS.items() if kind in kinds]
    x = make_axis("Displacement", x_unit.unit, [line.x for line in lines])
    y = _force_axis("Force / peak force" if is_scaled else "Force", bands, y_unit)
    title = f"Mean force against displacement of {write_count(len(family.groups), 'group')}."
    heading = "Force / peak force" if is_scaled else "First loading"
    return Plot("means", "", title, "", x, y, lines, keys, (392, 200), heading)


_SIGNS = {"interval": "95 % interval of the mean", "band": "95 % band, pointwise"}


def _force_axis(name: str, bands: Sequence[Band], scale: Scale) -> Axis:
    """Return an axis with full means, and intervals only as far as the means stay apart."""
    means = np.concatenate([band.mean for band in bands])
    edges = np.concatenate([edge for band in bands for edge in (band.lower, band.upper)])
    low, high = clip_range(scale.factor * means, scale.factor * edges, 0.4)
    room = 0.03 * ((high - low) or 1.0)
    return Axis(name, scale.unit, low - room, high + room)


def find_main_number(family: Family) -> str:
    """Find the number by which groups are compared: bending stiffness, or the first common one.

    Parameters
    ----------
    family : of groups

    Returns
    -------
    Name of the number; empty if the groups have none in common.
    """
    has = [{number.name for number in group.numbers if number.mean} for group in family.groups]
    shared = [
        number.name
        for number in family.groups[0].numbers
        if all(number.name in names for names in has)
    ]
    return "bending_stiffness" if "bending_stiffness" in shared else next(iter(shared), "")


def _mean_plot(family: Family, stems: Mapping[str, str]) -> Plot | None:
    """Return the plot of the main number: a row per group with mean, interval and samples."""
    name = find_main_number(family)
    if not name:
        return None
    numbers = [
        next(number for number in group.numbers if number.name == name) for group in family.groups
    ]
    scale = find_display_unit(name, numbers[0].unit, find_display(family.groups[0]))
    lines: list[Line] = []
    for row, (number, group) in enumerate(zip(numbers, family.groups, strict=True)):
        values = [value.value for value in number.values.values() if value.value is not None]
        x = np.array([part for value in values for part in (scale.factor * value, np.nan)])
        look, stem = f"c{row % N_COLOURS}", stems[group.name]
        lines.append(Line(f"sample {look}", x, np.full(len(x), -row - 0.22), group=stem))
        if number.mean is not None:
            mean = number.mean.chosen
            place = DotRow(-row, scale.factor, look, stem)
            lines += make_dot_lines("dot", mean.mean, mean.interval, place)
    shown = [line.x for line in lines if not line.css_class.startswith("interval")]
    x_axis = make_clipped_axis(write_label(name), scale, lines, shown)
    y_axis = Axis("", "", 0.5 - len(numbers), 0.5, family.labels)
    title = f"{write_label(name)} of {write_count(len(numbers), 'group')}, with 95 % intervals."
    keys = [LegendEntry("sample", "sample"), LegendEntry("dot", "mean")]
    heading = write_label(name)
    return Plot("numbers", "", title, "", x_axis, y_axis, lines, keys, (180, 200), heading)
