"""Figures of groups and of their comparisons as files, and the plots of comparisons."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from labpipe.records.group import Campaign, Group
from labpipe.report import comparisons, group_plots, wording
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import N_COLOURS
from labpipe.report.page_facts import make_stems
from labpipe.report.plot_records import Axis, LegendEntry, Line, Page, Plot


def _make_page(name: str, title: str, panels: Sequence[Plot], columns: int, caption: str) -> Page:
    """Make a page of plots; their captions are the footnote."""
    frame_mm, mm_per_point, single_mm = 14.0, 0.3, 68.0
    first = panels[0]
    height = mm_per_point * first.size[1] if len(panels) > 1 else single_mm
    width = plots.SINGLE_COLUMN if len(panels) <= 2 else plots.DOUBLE_COLUMN
    if first.is_to_scale:
        height = (width - frame_mm) * first.size[1] / first.size[0]
    return Page(
        name,
        title,
        panels,
        " ".join(dict.fromkeys(panel.caption for panel in panels)),
        math.ceil(len(panels) / columns) * (frame_mm + height),
        width,
        columns,
        caption=caption,
        alt=first.title,
    )


def list_group_figures(group: Group) -> Iterator[Page]:
    """List the figures for which a group has data.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    The figures of `make_file_plots` by names without the group. Without curves, the figure
    ``curves`` says why it is empty.
    """
    title, figures = wording.write_group_title(group), group_plots.make_file_plots(group)
    if "curves" not in figures:
        reason = "No sample has a curve." if group.samples else "No sample in this group."
        panels, width = [plots.make_empty_plot(reason)], plots.SINGLE_COLUMN
        yield Page("curves", title, panels, height=40.0, width=width, caption=reason, alt=reason)
    for name, panels in figures.items():
        yield _make_page(name, title, panels, 2, panels[0].caption)


def list_family_figures(campaign: Campaign) -> Iterator[Page]:
    """List a figure for each family of groups that differ in one field alone.

    Parameters
    ----------
    campaign : with its differences
    """
    drawn = comparisons.find_families(campaign)
    contexts = [comparisons.describe_context(family.groups, family.field) for family in drawn]
    names = make_stems(
        f"difference {family.field}: {context}"
        for family, context in zip(drawn, contexts, strict=True)
    )
    for family, context, name in zip(drawn, contexts, names, strict=True):
        panels = make_family_plots(family, has_scaled=True)
        if panels:
            field, labels = comparisons.name_field(family.field), ", ".join(family.labels)
            alike = comparisons.describe_equal_fields(family.groups, family.field)
            caption = f"{field}: {labels}; {alike}. Protocol: {family.groups[0].protocol}."
            yield _make_page(name, f"{field}  \u00b7  {context}", panels, 3, caption)


def make_family_plots(
    family: comparisons.Family, stems: Mapping[str, str] | None = None, *, has_scaled: bool = False
) -> list[Plot]:
    """Make the plots of a family: mean curves, and the main number of each group.

    Parameters
    ----------
    family : of groups
    stems : names of groups in links, by name; None for files
    has_scaled : include force over peak force
    """
    names = stems or {group.name: group.name for group in family.groups}
    scaled = _make_curve_plots(family, names, is_scaled=True) if has_scaled else ()
    return [*_make_curve_plots(family, names), *scaled, *_make_mean_plots(family, names)]


def _make_curve_plots(
    family: comparisons.Family, stems: Mapping[str, str], *, is_scaled: bool = False
) -> Iterator[Plot]:
    """Yield the plot of the mean first loading of each group with its band."""
    display = wording.find_display(family.groups[0])
    x_scale, y_scale = wording.find_units(display, "displacement", "force")
    name, heading = "Force", "First loading"
    if is_scaled:
        y_scale, name, heading = plots.NUMBER, "Force / peak force", "Force / peak force"
    lines, legend, bands = [], [], []
    count = wording.write_count(len(family.groups), "group")
    for at, (group, label) in enumerate(zip(family.groups, family.labels, strict=True)):
        band = group.band_scaled if is_scaled else group.band
        if band is not None:
            look, stem = f"c{at % N_COLOURS}", stems[group.name]
            bands.append(band)
            lines += [
                *group_plots.make_band_lines(band, look, stem),
                *group_plots.make_mean_lines(band, look, stem),
            ]
            text = f"{label} (n = {group.band.n})"
            legend.append(LegendEntry(f"mean {look}", text, "group", stem))
    if not lines:
        return
    # full means, and intervals only as far as the means stay apart
    means = np.concatenate([band.mean for band in bands])
    edges = np.concatenate([edge for band in bands for edge in (band.lower, band.upper)])
    ends = np.array(plots.clip_range(means, edges, 0.4))
    yield Plot(
        plots.make_axis("Displacement", x_scale, [line.x for line in lines]),
        plots.make_axis(name, y_scale, [ends]),
        lines,
        heading,
        legend=legend + group_plots.list_signs(lines, _SIGNS),
        kind="means",
        title=f"Mean force against displacement of {count}.",
        size=(392, 200),
    )


_SIGNS = {"interval": "95 % interval of the mean", "band": "95 % band, pointwise"}


def find_main_number(family: comparisons.Family) -> str:
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


def _make_mean_plots(family: comparisons.Family, stems: Mapping[str, str]) -> Iterator[Plot]:
    """Yield the plot of the main number: a row per group with mean, interval and samples."""
    name, groups = find_main_number(family), family.groups
    if not name:
        return
    numbers = [next(number for number in group.numbers if number.name == name) for group in groups]
    scale = wording.find_display_unit(name, numbers[0].unit, wording.find_display(groups[0]))
    lines: list[Line] = []
    for row, (number, group) in enumerate(zip(numbers, groups, strict=True)):
        values = [value.value for value in number.values.values() if value.value is not None]
        x = plots.join_with_gaps(np.array(values))
        look, stem = f"c{row % N_COLOURS}", stems[group.name]
        lines.append(Line(f"sample {look}", x, np.full(len(x), -row - 0.22), group=stem))
        if number.mean is not None:
            mean = number.mean.chosen
            lines += group_plots.make_dot_lines(f"dot {look}", mean.mean, mean.interval, -row, stem)
    label, count = wording.write_label(name), wording.write_count(len(numbers), "group")
    yield Plot(
        group_plots.make_dot_axis(name, scale, lines),
        Axis(low=0.5 - len(numbers), high=0.5, row_names=family.labels),
        lines,
        wording.shorten(label, 40),
        legend=[LegendEntry("sample", "sample"), LegendEntry("dot", "mean")],
        kind="numbers",
        title=f"{label} of {count}, with 95 % intervals.",
        size=(180, 200),
    )
