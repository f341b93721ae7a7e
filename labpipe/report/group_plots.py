"""Make the plots and figures of a group of tests: curves, shapes, measured laws, numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from math import inf, nan
from typing import Any

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import FittedLine, Interval, SlipDecision
from labpipe.records.group import Band, Group, GroupNumber, SampleCurve
from labpipe.records.result import Status
from labpipe.report import plot_records as plots
from labpipe.report import wording
from labpipe.report.figure_page import N_COLOURS, read_looks
from labpipe.report.page_tables import GroupView, PageTest, make_figure_view
from labpipe.report.plot_records import Axis, LegendEntry, Line, Page, Plot, join_with_gaps
from labpipe.statistics.lots import FORCE_LIMIT, PEAK_OVER_LIMIT

MAX_DOT_NUMBERS, MAX_DOT_ROWS = 6, 24
"""Largest number of panels with dots, one panel per number, and of samples with rows of their own.
"""
_SMALL_PLOT_SIZE = (262, 150)
"""Width and height of the area between the axes of a small plot, points."""


def make_group_plots(view: GroupView) -> list[Plot]:
    """Make the plots for which a group has data, for the page or for figures.

    Parameters
    ----------
    view : group of samples; may be empty

    Returns
    -------
    The plot of force against displacement, if any sample has a curve; then smaller plots.
    """
    makers = (_make_curve_plots, _make_shape_plots, _make_moment_plots, _make_scaled_plots)
    return [plot for make_plots in makers for plot in make_plots(view)]


def _choose_point_count(view: GroupView) -> int:
    """Choose the number of points of a first loading; on the page, a test takes less than 3 kB.

    The other branches together have a third of this number, but at least eight points each.
    """
    if not view.stem:
        return 240
    return 90 if view.is_detailed else 43


def _make_plot(
    view: GroupView,
    kind: str,
    axes: Sequence[Axis],
    lines: Sequence[Line],
    title: str,
    *,
    band: Band | None = None,
    unlisted: Sequence[str] = (),
    **settings: Any,
) -> Plot:
    """Make a plot of the lines of a group with their legend.

    The legend lists spools, or tests if they are few, and then the other kinds of lines. In files,
    tests are listed only if all are of one spool. On the page, an entry hides a test.

    Parameters
    ----------
    view : group of the lines
    kind, title : see `Plot`; the name of the group is appended to the title
    axes : horizontal and vertical axis
    lines : lines in the order of drawing
    band : mean curve that the plot shows; None without a mean
    unlisted : looks without an entry in the legend
    settings : other fields of `Plot`
    """
    spools = {test.sample.specimen.spool: test.colour for test in view.tests}
    entries = [
        LegendEntry(f"curve {colour}", f"spool {spool}", "class", colour)
        for spool, colour in spools.items()
    ]
    if view.is_detailed and (view.stem or len(spools) == 1):
        entries = [
            LegendEntry(f"curve {test.colour}", test.sample.test, "t", str(test.row_index))
            for test in view.tests
        ]
    labels = {} if band is None else {"mean": f"mean of {band.n} {band.members}"}
    legend = [*entries, *list_legend_entries(lines, "class", unlisted, **labels)]
    all_settings = {"legend": legend, "group": view.stem, "size": _SMALL_PLOT_SIZE, **settings}
    x, y = axes
    return Plot(x, y, lines, kind=kind, title=f"{title} {view.group.name}.", **all_settings)


def make_file_plots(group: Group) -> dict[str, list[Plot]]:
    """Make the plots for which a group has data, for files.

    Parameters
    ----------
    group : group of samples; may be empty

    Returns
    -------
    Plots of each figure, keyed by its name: ``curves``, ``shapes``, ``moment``, ``scaled`` (force
    over peak force) and ``numbers``.
    """
    all_plots = [*make_group_plots(make_figure_view(group)), *_make_number_plots(group)]
    plots_by_kind = groupby(all_plots, key=lambda plot: plot.kind)
    return {kind: list(plots_of_kind) for kind, plots_of_kind in plots_by_kind}


def make_group_page(
    name: str, title: str, panels: Sequence[Plot], columns: int, caption: str
) -> Page:
    """Make a page of plots of groups; their captions are the footnote.

    Parameters
    ----------
    name : file name without its extension
    title, columns, caption : see `Page`
    panels : plots with a size, at least one
    """
    margins_mm, mm_per_point, single_panel_mm = 14.0, 0.3, 68.0
    panel = panels[0]
    panel_height = mm_per_point * panel.size[1] if len(panels) > 1 else single_panel_mm
    width = plots.SINGLE_COLUMN if len(panels) <= 2 else plots.DOUBLE_COLUMN
    if panel.is_to_scale:
        panel_height = (width - margins_mm) * panel.size[1] / panel.size[0]
    note = " ".join(dict.fromkeys(panel.caption for panel in panels))
    height = math.ceil(len(panels) / columns) * (margins_mm + panel_height)
    size: dict[str, Any] = {"height": height, "width": width, "columns": columns}
    return Page(name, title, panels, note, caption=caption, alt=panel.title, **size)


def list_group_figures(group: Group) -> Iterator[Page]:
    """Yield the figures for which a group has data.

    Parameters
    ----------
    group : group of samples; may be empty

    Yields
    ------
    A page for each figure of `make_file_plots`; its name does not include the group. If there is no
    curve, the page ``curves`` states the reason.
    """
    figures, counts = make_file_plots(group), wording.describe_counts(group)
    title = f"{group.name}  \u00b7  {group.protocol}  \u00b7  {counts}"
    if "curves" not in figures:
        reason = "No sample has a curve." if group.samples else "No sample in this group."
        panels, width = [Plot(reason=reason)], plots.SINGLE_COLUMN
        yield Page("curves", title, panels, height=40.0, width=width, caption=reason, alt=reason)
    for name, panels in figures.items():
        yield make_group_page(name, title, panels, 2, panels[0].caption)


def _make_curve_plots(view: GroupView) -> Iterator[Plot]:
    """Yield the plot of force against displacement, if any sample has a curve."""
    group, band, lines = view.group, view.group.band, list(make_band_lines(view.group.band))
    if all(test.first_loading is None for test in view.tests):
        return
    n_points = _choose_point_count(view)
    for test in view.rejected:
        if (curve := test.first_loading) is not None:
            lines.append(_make_curve_line("rejected", curve, curve.force, test, n_points // 3))
    lines += [line for test in view.tests for line in _make_sample_lines(test, n_points)]
    lines += [line for test in view.tests for line in _make_fit_lines(test)]
    lines += make_mean_lines(band)
    lines += [line for test in view.tests for line in _make_event_lines(test)]
    x = plots.make_axis("Displacement", view.get_scale("displacement"), [line.x for line in lines])
    limit_values = (test.find_value(FORCE_LIMIT) for test in view.tests)
    limits = sorted(set(filter(None, limit_values)))
    lines += [plots.make_horizontal_line("limit", limit) for limit in limits]
    curves = (curve for sample in group.samples for curve in (*sample.loading, *sample.unloading))
    forces = [*(curve.force for curve in curves), np.array(limits)]
    y = _make_force_axis("Force", view.get_scale("force"), forces, band)
    title = f"Force against displacement of {wording.format_count(len(group.samples), 'sample')}:"
    caption, size = wording.join_sentences([band.reason]), (660, 240)
    yield _make_plot(view, "curves", (x, y), lines, title, band=band, caption=caption, size=size)


def _make_force_axis(name: str, scale: wording.Scale, forces: Sequence[Floats], band: Band) -> Axis:
    """Make the axis of force, which includes all curves and clips wide bands.

    For the pointwise band, the axis extends beyond the curves by at most half their range. It
    includes the whole simultaneous band if this extends the axis by at most a quarter.
    """
    max_extension, max_widening = 0.5, 1.25
    all_forces = np.concatenate([np.zeros(0), *forces])
    low, high = plots.clip_range(all_forces, [*band.lower, *band.upper], max_extension)
    wide_low, wide_high = plots.clip_range([low, high], [*band.lower_all, *band.upper_all], inf)
    if wide_high - wide_low <= max_widening * (high - low):
        low, high = wide_low, wide_high
    return plots.make_axis(name, scale, [np.array([low, high])], margin=0.04)


def _make_sample_lines(test: PageTest, n_points: int) -> Iterator[Line]:
    """Yield the branches of a test; the first loading is the last, and on top.

    The first loading before the repair of slips is also yielded if any slip was repaired.
    """
    sample, curve, colour = test.sample, test.first_loading, test.colour
    branches = [branch for branch in (*sample.loading, *sample.unloading) if branch is not curve]
    other_branches = [branch for branch in branches if len(branch.displacement)]
    for branch in other_branches:
        max_points = max(n_points // 3 // len(other_branches), 8)
        yield _make_curve_line(f"unloading {colour}", branch, branch.force, test, max_points)
    if curve is None:
        return
    if any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips):
        yield _make_curve_line("measured", curve, curve.measured_force, test, n_points // 3)
    yield _make_curve_line(f"curve {colour}", curve, curve.force, test, n_points)


def _make_curve_line(
    look: str, curve: SampleCurve, y: Floats, test: PageTest, max_points: int
) -> Line:
    """Make a line of `y` over the displacement of a curve, thinned to at most `max_points`."""
    x = curve.displacement
    rows = plots.find_shape_samples(x, y, max_points=max_points, tolerance=0.001)
    return Line(look, x[rows], y[rows], test.row_index)


def _make_fit_lines(test: PageTest) -> Iterator[Line]:
    """Yield the fitted lines over their windows."""
    fits_by_look: dict[str, list[FittedLine]] = {}
    for fit in test.sample.lines:
        look = "segment" if fit.result.startswith("segment") else "window"
        fits_by_look.setdefault(look, []).append(fit)
    for look, fits in fits_by_look.items():
        parameters = np.array([(fit.start, fit.stop, fit.slope, fit.level) for fit in fits])
        start, stop, slope, level = parameters.T
        y = join_with_gaps(level, level + slope * (stop - start))
        yield Line(look, join_with_gaps(start, stop), y, test.row_index)


def _make_event_lines(test: PageTest) -> Iterator[Line]:
    """Yield slips and failure of a test as dots on its curve."""
    sample, curve = test.sample, test.first_loading
    if curve is None:
        return
    is_finite = np.isfinite(curve.displacement) & np.isfinite(curve.force)
    positions = np.array([slip.position for slip in sample.slips])
    if len(positions) and is_finite.any():
        forces = np.interp(positions, curve.displacement[is_finite], curve.force[is_finite])
        yield Line("slip", join_with_gaps(positions), join_with_gaps(forces), test.row_index)
    position, force = (test.find_value(f"failure_{name}") for name in ("displacement", "force"))
    if position is not None and force is not None:
        yield Line("failure", np.array([position, nan]), np.array([force, nan]), test.row_index)


def make_band_lines(band: Band, colour: str = "", group: str = "") -> Iterator[Line]:
    """Yield the pointwise band of a mean curve as an area, and the edges of the simultaneous band.

    Parameters
    ----------
    band : mean curve with its bands; no line is yielded for fewer than two curves or without a band
    colour : class of the colour of the band, such as ``c2``; empty for black
    group : stem of the group in a plot of several groups, which shows only the pointwise band;
        otherwise empty
    """
    if band.n < 2 or not band.has_band:
        return
    rows = _choose_band_rows(band, band.upper)
    x = band.displacement[rows]
    area = plots.make_area(f"band {colour}".strip(), x, band.lower[rows], band.upper[rows])
    yield replace(area, group=group)
    for edge in () if group else (band.lower_all, band.upper_all):
        if np.isfinite(edge).any():
            yield Line("whole", x, edge[rows])


def _choose_band_rows(band: Band, values: Floats) -> Ints:
    """Choose the indices of points that preserve the shape of a band or a mean."""
    return plots.find_shape_samples(band.displacement, values, max_points=28, tolerance=0.001)


def make_mean_lines(band: Band, colour: str = "", group: str = "") -> Iterator[Line]:
    """Yield a mean curve, and its intervals at single displacements if the band has no area.

    Parameters
    ----------
    band, colour, group : see `make_band_lines`. The mean of a single sample, which is this sample,
        is yielded only in a plot of several groups
    """
    if not len(band.displacement) or (band.n < 2 and not group):
        return
    rows, interval_rows = _choose_band_rows(band, band.mean), band.interval_indices
    yield Line(f"mean {colour}".strip(), band.displacement[rows], band.mean[rows], group=group)
    if len(interval_rows):
        x = join_with_gaps(band.displacement[interval_rows], band.displacement[interval_rows])
        ends = join_with_gaps(band.lower[interval_rows], band.upper[interval_rows])
        yield Line(f"interval {colour}".strip(), x, ends, group=group)


def list_legend_entries(
    lines: Sequence[Line], attribute: str = "", unlisted: Sequence[str] = (), **labels: str
) -> list[LegendEntry]:
    """List the legend entries for the looks of lines, in the order of ``looks.toml``.

    Parameters
    ----------
    lines : lines of the plot
    attribute : attribute by which the entries show and hide lines; empty for none
    unlisted : looks without an entry
    labels : labels of looks, instead of their `group_label` in ``looks.toml``
    """
    drawn_looks = {line.look.partition(" ")[0] for line in lines}.difference(unlisted)
    default_labels = {look: settings.get("group_label") for look, settings in read_looks().items()}
    return [
        LegendEntry(look, label, attribute, look if attribute else "")
        for look, label in (default_labels | labels).items()
        if label and look in drawn_looks
    ]


def _make_shape_plots(view: GroupView) -> Iterator[Plot]:
    """Yield the plot of the markers at equal steps of the first loading, with equal axis scales."""
    lines, point_arrays, steps = [], [], np.zeros(0)
    n_shapes = 6 if view.is_detailed or not view.stem else 2  # of each test
    for test in view.tests:
        shapes = test.sample.shapes
        if shapes is not None and np.isfinite(shapes.positions).any():
            positions = shapes.positions[-n_shapes:]
            x, y = (join_with_gaps(*positions[:, :, axis].T) for axis in (0, 1))
            lines.append(Line(f"shape {test.colour}", x, y, test.row_index))
            point_arrays.append(np.column_stack([x, y]))
            steps = max(steps, shapes.deflection, key=len)
    if not lines:
        return
    scale, width = view.get_scale("displacement"), _SMALL_PLOT_SIZE[0]
    names, points = ("Along the specimen", "Deflection"), np.vstack(point_arrays)
    x_axis, y_axis = plots.make_axes_to_scale(names, scale, points, min_aspect=0.3, margin=0.03)
    metres_per_point = (x_axis.high - x_axis.low) / width
    height = math.ceil((y_axis.high - y_axis.low) / metres_per_point)
    axes = x_axis, replace(y_axis, high=y_axis.low + metres_per_point * height)
    rounded_steps = np.round(steps[-n_shapes:], 4) + 0.0  # + 0.0 removes the sign of a zero
    deflections = ", ".join(f"{deflection * scale.factor:.2g}" for deflection in rounded_steps)
    caption = f"Markers at {deflections} {scale.unit} of the first loading, at equal axis scale."
    title = f"Shapes of {wording.format_count(len(lines), 'sample')} of"
    layout: dict[str, Any] = {"size": (width, height), "is_to_scale": True}
    yield _make_plot(view, "shapes", axes, lines, title, caption=caption, **layout)


def _make_moment_plots(view: GroupView) -> Iterator[Plot]:
    """Yield the plot of the measured laws; for few laws, with their 95 % intervals as areas."""
    areas, lines, max_detailed_laws = [], [], 6
    n_laws = sum(test.sample.law is not None for test in view.tests)
    for test in view.tests:
        law = test.sample.law
        if law is None:
            continue
        x, colour = law.curvature, test.colour
        lines.append(Line(f"curve {colour}", x, law.moment, test.row_index))
        if n_laws <= max_detailed_laws:
            band = plots.make_area(f"band {colour}", x, law.moment_lower, law.moment_upper)
            areas.append(replace(band, test=test.row_index))
    if not lines:
        return
    all_lines = [*areas, *lines]
    x_axis = plots.make_axis("Curvature", view.get_scale("curvature"), [line.x for line in lines])
    moments = [line.y for line in all_lines]
    y_axis = plots.make_axis("Bending moment", view.get_scale("moment"), moments)
    title = "Bending moment against curvature of"
    caption = "Measured from the shapes, first loading."
    caption += " Area: 95 % interval of each sample." if areas else ""
    axes = x_axis, y_axis
    yield _make_plot(view, "moment", axes, all_lines, title, unlisted=("band",), caption=caption)


def _make_scaled_plots(view: GroupView) -> Iterator[Plot]:
    """Yield the plot of force over the peak force of each sample."""
    band, curves = view.group.scaled_band, []
    if band is None:
        return
    for test in view.tests:
        peak, curve = test.find_value("peak_force.1"), test.first_loading
        if curve is not None and peak:
            look, force_ratio = f"curve {test.colour}", curve.force / peak
            n_points = _choose_point_count(view) // 4
            curves.append(_make_curve_line(look, curve, force_ratio, test, n_points))
    lines = [*list(make_band_lines(band))[:1], *curves, *make_mean_lines(band)]
    if not lines:
        return
    x = plots.make_axis("Displacement", view.get_scale("displacement"), [line.x for line in lines])
    force_ratios = [line.y for line in curves]
    y = _make_force_axis("Force / peak force", plots.PLAIN_NUMBER, force_ratios, band)
    title = "Force over peak force against displacement of"
    caption = format_sentence("report.scaled_caption")
    yield _make_plot(view, "scaled", (x, y), lines, title, band=band, caption=caption)


def _make_number_plots(group: Group) -> Iterator[Plot]:
    """Yield a plot for each of the first numbers of the first cycle with two or more samples.

    The rows of a plot are the samples, the mean of each of several spools, and the mean.
    """
    all_numbers = [number for number in group.numbers if wording.is_first_cycle(number.name)]
    numbers = [number for number in all_numbers if number.mean.n_samples > 1][:MAX_DOT_NUMBERS]
    plotted_names = {number.name for number in numbers}
    table_only_names = [number.name for number in all_numbers if number.name not in plotted_names]
    caption = f"In the tables only: {'; '.join(map(wording.format_label, table_only_names))}."
    for number in numbers:
        rows: dict[str, int] = {}
        lines = list(_make_row_lines(group, number, rows))
        if group.lot is not None and number.name in (PEAK_OVER_LIMIT, "peak_force.1"):
            limit = 1.0 if number.name == PEAK_OVER_LIMIT else group.lot.limit
            lines.append(plots.make_vertical_line("limit", nan if limit is None else limit))
        yield Plot(
            make_dot_axis(number.name, wording.choose_number_scale(group, number), lines),
            Axis(low=0.5 - len(rows), high=0.5, row_names=tuple(rows)),
            lines,
            legend=list_legend_entries(lines, unlisted=("interval",)),
            kind="numbers",
            title=f"Each sample's numbers, with 95 % intervals: {group.name}.",
            caption=caption if table_only_names else "",
            size=(_SMALL_PLOT_SIZE[0], 20 + 11 * len(rows)),
        )


def make_dot_axis(name: str, scale: wording.Scale, lines: Sequence[Line]) -> Axis:
    """Make an axis that includes all dots; clip wide intervals so that the dots remain distinct.

    Parameters
    ----------
    name : name of the result that the axis shows
    scale : display unit of the result
    lines : dots, and bars of intervals, from `make_dot_lines`
    """
    values = [line.x for line in lines if not line.look.startswith("interval")]
    ends = np.concatenate([line.x for line in lines])
    low, high = plots.clip_range(np.concatenate(values), ends, max_extension=1.0)
    return plots.make_axis(wording.format_label(name), scale, [np.array([low, high])])


def make_dot_lines(
    look: str, value: float, interval: Interval | None, row: float, group: str = ""
) -> Iterator[Line]:
    """Yield the bar of the interval of a value, if any, and the dot of the value.

    Parameters
    ----------
    look : look of the dot and class of its colour, such as ``sample c2``
    value : value, SI
    interval : 95 % interval of the value, SI; None without an interval
    row : vertical position; row 1 is at -1
    group : stem of the group in a plot of several groups; otherwise empty
    """
    if interval is not None and np.isfinite(interval.upper - interval.lower):
        bar_look = " ".join(["interval", *look.split()[1:]])
        ends = np.array([interval.lower, interval.upper])
        yield Line(bar_look, ends, np.full(2, row), group=group)
    yield Line(look, np.array([value]), np.array([row]), group=group)


def _make_row_lines(group: Group, number: GroupNumber, rows: dict[str, int]) -> Iterator[Line]:
    """Yield dots and bars of samples and means; add the index of each row to `rows`, by name."""
    used_height = 0.7  # of a row that many samples share
    spools = list(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    is_crowded = len(group.samples) > MAX_DOT_ROWS
    means = number.mean.spool_means
    for index, spool in enumerate(spools):
        tests = [sample.test for sample in group.samples if sample.specimen.spool == spool]
        colour = f"c{index % N_COLOURS}"
        for index_in_spool, test in enumerate(tests):
            name = f"{len(tests)} samples of {spool}" if is_crowded else test
            shift = (index_in_spool / len(tests) - 0.5) * used_height if is_crowded else 0.0
            row = -rows.setdefault(name, len(rows)) - shift
            yield from _make_sample_dot(number, test, colour, row, has_bar=not is_crowded)
        if len(spools) > 1 and spool in means:
            row = -rows.setdefault(f"mean of {spool}", len(rows))
            mean = means[spool]
            yield from make_dot_lines(f"dot {colour}", mean.mean, mean.interval, row)
    if number.values:
        chosen, row = number.mean.chosen, -rows.setdefault("mean", len(rows))
        yield from make_dot_lines("dot", chosen.mean, chosen.interval, row)


def _make_sample_dot(
    number: GroupNumber, test: str, colour: str, row: float, *, has_bar: bool
) -> Iterator[Line]:
    """Yield the dot of a test, if it has a value, and a ring around it if it is an outlier."""
    result = number.values.get(test)
    if result is None or result.value is None:
        return
    look = "doubtful" if result.status is Status.DOUBTFUL else "sample"
    interval = result.interval if has_bar else None
    yield from make_dot_lines(f"{look} {colour}", result.value, interval, row)
    if any(outlier.sample == test for outlier in number.outliers):
        yield Line("ring", np.array([result.value]), np.array([row]))
