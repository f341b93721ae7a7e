"""Make the plots and figures of a group: curves, shapes, measured laws, numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import FittedLine, Interval, SlipDecision
from labpipe.records.group import Band, Group, GroupNumber, Sample, SampleCurve
from labpipe.records.result import Status, find_result
from labpipe.report import plot_records as plots
from labpipe.report import wording
from labpipe.report.figure_page import N_COLOURS, read_looks
from labpipe.report.issues import join_sentences
from labpipe.report.page_tables import PageTests, make_key
from labpipe.report.plot_records import Axis, LegendEntry, Line, Page, Plot, join_with_gaps
from labpipe.statistics.lots import FORCE_LIMIT, PEAK_OVER_LIMIT

MAX_DOT_NUMBERS, MAX_DOT_ROWS = 6, 24
"""Largest number of panels of numbers, and of samples with a row each in a panel."""


class _Points(NamedTuple):
    """Largest numbers of points and shapes that are drawn for a test.

    Parameters
    ----------
    first : points of the first loading
    later : points of all other branches together, but at least 8 of each
    scaled : points of the curve over its peak force
    shapes : number of shapes
    """

    first: int
    later: int
    scaled: int
    shapes: int


_FEW, _MANY = _Points(90, 40, 24, 6), _Points(43, 16, 10, 2)
"""Limits on the page for few samples and for many samples: a test takes less than 3 kB."""
_IN_FILES = _Points(120, 80, 120, 6)
_MAX_DETAILED_SAMPLES = 6
_SMALL_PLOT = (262, 150)


class _PlottedSample(NamedTuple):
    """A sample with its first loading, the colour of its lines and its number on the page."""

    sample: Sample
    first: SampleCurve | None
    colour: str
    number: int | None

    def find_value(self, name: str) -> float | None:
        result = find_result(self.sample.results, name)
        return None if result is None else result.value


@dataclass(frozen=True, eq=False)
class _GroupView:
    """A group with the data of its plots.

    Parameters
    ----------
    group : group of samples; may be empty
    stem : stem of the addresses of its links
    tests : tests of the page; None for a figure in a file, with more points in a line
    """

    group: Group
    stem: str = ""
    tests: PageTests | None = None

    def find_scale(self, quantity: str) -> wording.Scale:
        return wording.find_unit(wording.find_display(self.group), quantity)

    @property
    def is_detailed(self) -> bool:
        return len(self.group.samples) <= _MAX_DETAILED_SAMPLES

    @property
    def points(self) -> _Points:
        return _IN_FILES if self.tests is None else _FEW if self.is_detailed else _MANY

    def make_plot(
        self, kind: str, axes: tuple[Axis, Axis], lines: Sequence[Line], title: str, **settings: Any
    ) -> Plot:
        """Make a plot of lines with their key; the setting `mean` is the label of the mean."""
        legend = _make_legend(self, lines, settings.pop("mean", "mean"))
        all_settings = {"legend": legend, "group": self.stem, "size": _SMALL_PLOT, **settings}
        return Plot(*axes, lines, kind=kind, title=f"{title} {self.group.name}.", **all_settings)

    @cached_property
    def shown(self) -> list[_PlottedSample]:
        """Return the samples with a colour per spool, or per sample for few of one spool."""
        samples = self.group.samples
        names = [sample.specimen.spool for sample in samples]
        if len(set(names)) == 1 and self.is_detailed:
            names = list(map(make_key, samples))
        colours = {key: f"c{n % N_COLOURS}" for n, key in enumerate(dict.fromkeys(names))}
        numbers = {} if self.tests is None else self.tests.numbers_by_key
        return [
            _PlottedSample(
                sample, find_first_loading(sample), colours[name], numbers.get(make_key(sample))
            )
            for sample, name in zip(samples, names, strict=True)
        ]


def make_group_plots(group: Group, stem: str = "", tests: PageTests | None = None) -> list[Plot]:
    """Make the plots for which a group has data, for the page.

    Parameters
    ----------
    group : group of samples; may be empty
    stem : stem of the addresses of its links
    tests : tests of the page; None for plots in files, with more points in a line

    Returns
    -------
    The plot of force against displacement, if any sample has a curve; then smaller plots.
    """
    view = _GroupView(group, stem, tests)
    makers = (_make_curve_plots, _make_shape_plots, _make_moment_plots, _make_scaled_plots)
    return [plot for make in makers for plot in make(view)]


def make_file_plots(group: Group) -> dict[str, list[Plot]]:
    """Make the plots for which a group has data, for files.

    Parameters
    ----------
    group : group of samples; may be empty

    Returns
    -------
    Plots by the name of their figure: ``curves``, ``scaled`` (force over peak force), ``shapes``,
    ``moment`` and ``numbers``.
    """
    all_plots = [*make_group_plots(group), *_make_number_plots(group)]
    plots_by_kind = groupby(all_plots, key=lambda plot: plot.kind)
    return {kind: list(members) for kind, members in plots_by_kind}


def make_page(name: str, title: str, panels: Sequence[Plot], columns: int, caption: str) -> Page:
    """Make a page of plots of groups; their captions are the footnote.

    Parameters
    ----------
    name : file name without the ending
    title, columns, caption : see `Page`
    panels : plots with a size, at least one
    """
    frame_mm, mm_per_point, single_mm = 14.0, 0.3, 68.0
    first = panels[0]
    height = mm_per_point * first.size[1] if len(panels) > 1 else single_mm
    width = plots.SINGLE_COLUMN if len(panels) <= 2 else plots.DOUBLE_COLUMN
    if first.is_to_scale:
        height = (width - frame_mm) * first.size[1] / first.size[0]
    note = " ".join(dict.fromkeys(panel.caption for panel in panels))
    height, alt = math.ceil(len(panels) / columns) * (frame_mm + height), first.title
    return Page(name, title, panels, note, height, width, columns, caption=caption, alt=alt)


def list_group_figures(group: Group) -> Iterator[Page]:
    """List the figures for which a group has data.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    The figures of `make_file_plots`; their names are without the group. Without curves, the figure
    ``curves`` states the reason.
    """
    title, figures = wording.write_group_title(group), make_file_plots(group)
    if "curves" not in figures:
        reason = "No sample has a curve." if group.samples else "No sample in this group."
        panels, width = [plots.make_empty_plot(reason)], plots.SINGLE_COLUMN
        yield Page("curves", title, panels, height=40.0, width=width, caption=reason, alt=reason)
    for name, panels in figures.items():
        yield make_page(name, title, panels, 2, panels[0].caption)


def find_first_loading(sample: Sample) -> SampleCurve | None:
    """Find the first loading curve of a sample that has points; None without one."""
    return next((curve for curve in sample.loading if len(curve.displacement)), None)


def _make_curve_plots(view: _GroupView) -> Iterator[Plot]:
    """Yield the plot of force against displacement, if any sample has a curve."""
    group, band = view.group, view.group.band
    if all(plotted.first is None for plotted in view.shown):
        return
    rejected = [] if view.tests is None else view.tests.list_rejected(view.stem)
    lines = list(make_band_lines(band))
    for test in rejected:
        first = find_first_loading(test.sample)
        if first is not None:
            lines.append(_thin("rejected", first, first.force, test.number, view.points.later))
    lines += [line for plotted in view.shown for line in _plot_sample(view, plotted)]
    lines += [line for plotted in view.shown for line in _plot_windows(plotted)]
    lines += make_mean_lines(band)
    lines += [line for plotted in view.shown for line in _plot_events(plotted)]
    x = plots.make_axis("Displacement", view.find_scale("displacement"), [line.x for line in lines])
    limits = {plotted.find_value(FORCE_LIMIT) for plotted in view.shown} - {None}
    lines += [plots.make_horizontal_line("limit", limit) for limit in sorted(filter(None, limits))]
    forces = [
        curve.force for sample in group.samples for curve in (*sample.loading, *sample.unloading)
    ]
    forces.append(np.array(sorted(filter(None, limits))))
    y = _make_force_axis("Force", view.find_scale("force"), forces, band)
    title = f"Force against displacement of {wording.write_count(len(group.samples), 'sample')}:"
    mean, caption = f"mean of {band.n} {band.members}", join_sentences([band.reason])
    size = 660, 240
    yield view.make_plot("curves", (x, y), lines, title, mean=mean, caption=caption, size=size)


def _make_force_axis(name: str, scale: wording.Scale, forces: Sequence[Floats], band: Band) -> Axis:
    """Make the axis of force, which includes all curves and clips wide bands.

    The axis extends beyond the curves by at most half their range for the pointwise band. It
    includes the whole simultaneous band if this extends the axis by at most a quarter.
    """
    joined = np.concatenate([np.zeros(0), *forces])
    low, high = plots.clip_range(joined, [*band.lower, *band.upper], 0.5)
    whole = plots.clip_range([low, high], [*band.lower_all, *band.upper_all], inf)
    if whole[1] - whole[0] <= 1.25 * (high - low):
        low, high = whole
    return plots.make_axis(name, scale, [np.array([low, high])], margin=0.04)


def _plot_sample(view: _GroupView, plotted: _PlottedSample) -> Iterator[Line]:
    """Yield the later branches and the first loading, also as measured if slips were repaired."""
    sample, first, colour, number = plotted
    branches = [branch for branch in (*sample.loading, *sample.unloading) if branch is not first]
    later_branches = [branch for branch in branches if len(branch.displacement)]
    for later_branch in later_branches:
        points = max(view.points.later // len(later_branches), 8)
        yield _thin(f"unloading {colour}", later_branch, later_branch.force, number, points)
    if first is None:
        return
    if any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips):
        yield _thin("measured", first, first.as_measured, number, view.points.later)
    yield _thin(f"curve {colour}", first, first.force, number, view.points.first)


def _thin(look: str, branch: SampleCurve | Band, y: Floats, test: int | None, points: int) -> Line:
    """Make a line over the displacement of a curve, thinned to a number of points."""
    x = branch.displacement
    rows = plots.simplify_line(x, y, max_points=points, tolerance=0.001)
    return Line(look, x[rows], y[rows], test)


def _plot_windows(plotted: _PlottedSample) -> Iterator[Line]:
    """Yield the fitted lines over their windows."""
    parts: dict[str, list[FittedLine]] = {}
    for fit in plotted.sample.lines:
        kind = "segment" if fit.result.startswith("segment") else "window"
        parts.setdefault(kind, []).append(fit)
    for kind, fits in parts.items():
        start, stop, slope, height = np.array(
            [(fit.start, fit.stop, fit.slope, fit.level) for fit in fits]
        ).T
        heights = join_with_gaps(height, height + slope * (stop - start))
        yield Line(kind, join_with_gaps(start, stop), heights, plotted.number)


def _plot_events(plotted: _PlottedSample) -> Iterator[Line]:
    """Yield slips and failure of a test as dots on its curve."""
    sample, first, _, number = plotted
    if first is None:
        return
    finite = np.isfinite(first.displacement) & np.isfinite(first.force)
    places = np.array([slip.position for slip in sample.slips])
    if len(places) and finite.any():
        heights = np.interp(places, first.displacement[finite], first.force[finite])
        yield Line("slip", join_with_gaps(places), join_with_gaps(heights), number)
    position, force = (plotted.find_value(f"failure_{name}") for name in ("displacement", "force"))
    if position is not None and force is not None:
        yield Line("failure", np.array([position, nan]), np.array([force, nan]), number)


def make_band_lines(band: Band, look: str = "", group: str = "") -> Iterator[Line]:
    """Yield the pointwise band of a mean curve as an area, and the edges of the simultaneous band.

    Parameters
    ----------
    band : a band of fewer than two curves, or without an area, is not drawn
    look : class of its colour
    group : stem of the group in a plot of several groups, which shows only the pointwise band
    """
    if band.n < 2 or not band.has_area:
        return
    rows = _find_band_rows(band, band.upper)
    x = band.displacement[rows]
    pointwise = plots.make_area(f"band {look}".strip(), x, band.lower[rows], band.upper[rows])
    yield replace(pointwise, group=group)
    for edge in () if group else (band.lower_all, band.upper_all):
        if np.isfinite(edge).any():
            yield Line("whole", x, edge[rows])


def _find_band_rows(band: Band, values: Floats) -> Ints:
    """Find the points of a simplified band or mean."""
    return plots.simplify_line(band.displacement, values, max_points=28, tolerance=0.001)


def make_mean_lines(band: Band, look: str = "", group: str = "") -> Iterator[Line]:
    """Yield a mean curve, and its intervals at single displacements if the band has no area.

    Parameters
    ----------
    band, look, group : as for `make_band_lines`
    """
    if not len(band.displacement) or (band.n < 2 and not group):
        return  # the mean of one sample is that sample
    rows, marks = _find_band_rows(band, band.mean), band.marks
    yield Line(f"mean {look}".strip(), band.displacement[rows], band.mean[rows], group=group)
    if len(marks):
        x = join_with_gaps(band.displacement[marks], band.displacement[marks])
        ends = join_with_gaps(band.lower[marks], band.upper[marks])
        yield Line(f"interval {look}".strip(), x, ends, group=group)


def _make_legend(view: _GroupView, lines: Sequence[Line], mean: str = "mean") -> list[LegendEntry]:
    """Make the key of a plot: few tests (in files, of one spool) or spools; then other entries."""
    spools = {plotted.sample.specimen.spool: plotted.colour for plotted in view.shown}
    if view.is_detailed and (view.tests is not None or len(spools) == 1):  # each can be hidden
        entries = [
            LegendEntry(f"curve {plotted.colour}", plotted.sample.test, "t", str(plotted.number))
            for plotted in view.shown
        ]
    else:
        entries = [
            LegendEntry(f"curve {colour}", f"spool {spool}", "class", colour)
            for spool, colour in spools.items()
        ]
    return entries + list_signs(lines, "class", mean=mean)


def list_signs(
    lines: Sequence[Line], attribute: str = "", hidden: Sequence[str] = (), **labels: str
) -> list[LegendEntry]:
    """List the entries of a key for the looks of lines, in the order of ``looks.toml``.

    Parameters
    ----------
    lines : of the plot
    attribute : of the entries
    hidden : looks without an entry
    labels : of looks, in place of those in ``looks.toml``
    """
    kinds = {line.look.partition(" ")[0] for line in lines}.difference(hidden)
    signs = {
        look: settings["sign"] for look, settings in read_looks().items() if "sign" in settings
    }
    return [
        LegendEntry(look, label, attribute, look if attribute else "")
        for look, label in (signs | labels).items()
        if look in kinds
    ]


def _make_shape_plots(view: _GroupView) -> Iterator[Plot]:
    """Yield the plot of the markers at equal steps of the first loading, with equal axis scales."""
    min_height, max_height = 88, 190
    lines, steps = [], np.zeros(0)
    for plotted in view.shown:
        shapes = plotted.sample.shapes
        if shapes is not None and np.isfinite(shapes.positions).any():
            positions = shapes.positions[-view.points.shapes :]
            x, y = (join_with_gaps(*positions[:, :, axis].T) for axis in (0, 1))
            lines.append(Line(f"shape {plotted.colour}", x, y, plotted.number))
            steps = max(steps, shapes.deflection, key=len)
    if not lines:
        return
    scale, width = view.find_scale("displacement"), _SMALL_PLOT[0]
    x_axis = plots.make_axis("Along the specimen", scale, [line.x for line in lines])
    y_axis = plots.make_axis("Deflection", scale, [line.y for line in lines], margin=0.06)
    spans = x_axis.high - x_axis.low, y_axis.high - y_axis.low
    height = min(max(round(width * spans[1] / spans[0]), min_height), max_height)
    step = max(spans[0] / width, spans[1] / height)
    plotted_steps = np.round(steps[-view.points.shapes :], 4) + 0.0
    deflections = ", ".join(f"{deflection * scale.factor:.2g}" for deflection in plotted_steps)
    axes = _widen(x_axis, step * width), _widen(y_axis, step * height)
    caption = f"Markers at {deflections} {scale.unit} of the first loading, at equal axis scale."
    title = f"Shapes of {wording.write_count(len(lines), 'sample')} of"
    layout: dict[str, Any] = {"size": (width, height), "is_to_scale": True}
    yield view.make_plot("shapes", axes, lines, title, caption=caption, **layout)


def _widen(axis: Axis, width: float) -> Axis:
    middle = 0.5 * (axis.low + axis.high)
    return replace(axis, low=middle - 0.5 * width, high=middle + 0.5 * width)


def _make_moment_plots(view: _GroupView) -> Iterator[Plot]:
    """Yield the plot of the measured laws; with few samples, areas show their 95 % intervals."""
    areas, lines = [], []
    laws = [
        (plotted, plotted.sample.law) for plotted in view.shown if plotted.sample.law is not None
    ]
    for plotted, law in laws:
        x, colour = law.curvature, plotted.colour
        lines.append(Line(f"curve {colour}", x, law.moment, plotted.number))
        if len(laws) <= _MAX_DETAILED_SAMPLES:
            band = plots.make_area(f"band {colour}", x, law.moment_lower, law.moment_upper)
            areas.append(replace(band, test=plotted.number))
    if not lines:
        return
    drawn = [*areas, *lines]
    x_axis = plots.make_axis("Curvature", view.find_scale("curvature"), [line.x for line in lines])
    y_axis = plots.make_axis(
        "Bending moment", view.find_scale("moment"), [line.y for line in drawn]
    )
    title, legend = "Bending moment against curvature of", _make_legend(view, lines)
    caption = "Measured from the shapes, first loading."
    caption += " Area: 95 % interval of each sample." if areas else ""
    yield view.make_plot("moment", (x_axis, y_axis), drawn, title, legend=legend, caption=caption)


def _make_scaled_plots(view: _GroupView) -> Iterator[Plot]:
    """Yield the plot of force over the peak force of each sample."""
    band, curves = view.group.band_scaled, []
    if band is None:
        return
    for plotted in view.shown:
        peak = plotted.find_value("peak_force.1")
        if plotted.first is not None and peak:
            share, points = plotted.first.force / peak, view.points.scaled
            curves.append(
                _thin(f"curve {plotted.colour}", plotted.first, share, plotted.number, points)
            )
    lines = [*list(make_band_lines(band))[:1], *curves, *make_mean_lines(band)]
    if not lines:
        return
    x = plots.make_axis("Displacement", view.find_scale("displacement"), [line.x for line in lines])
    shares = [line.y for line in curves]
    y = _make_force_axis("Force / peak force", plots.PLAIN_NUMBER, shares, band)
    mean, caption = f"mean of {band.n} {band.members}", format_sentence("report.scaled_caption")
    title = "Force over peak force against displacement of"
    yield view.make_plot("scaled", (x, y), lines, title, mean=mean, caption=caption)


def _make_number_plots(group: Group) -> Iterator[Plot]:
    """Yield a plot for each of the first numbers with two or more samples, without later cycles.

    The rows of a plot are the samples, the mean of each of several spools, and the mean.
    """
    first_cycle = [number for number in group.numbers if wording.is_first_cycle(number.name)]
    numbers = [number for number in first_cycle if number.mean.n_samples > 1][:MAX_DOT_NUMBERS]
    plotted_names = {number.name for number in numbers}
    table_only_names = [number.name for number in first_cycle if number.name not in plotted_names]
    caption = f"In the tables only: {'; '.join(map(wording.write_label, table_only_names))}."
    for number in numbers:
        names: dict[str, int] = {}
        lines = list(_plot_dots(group, number, names))
        if group.lot is not None and number.name in (PEAK_OVER_LIMIT, "peak_force.1"):
            limit = 1.0 if number.name == PEAK_OVER_LIMIT else group.lot.limit
            lines.append(plots.make_vertical_line("limit", nan if limit is None else limit))
        yield Plot(
            make_dot_axis(number.name, wording.find_number_scale(group, number), lines),
            Axis(low=0.5 - len(names), high=0.5, row_names=tuple(names)),
            lines,
            legend=list_signs(lines, hidden=("interval",)),
            kind="numbers",
            title=f"Each sample's numbers, with 95 % intervals: {group.name}.",
            caption=caption if table_only_names else "",
            size=(262, 20 + 11 * len(names)),
        )


def make_dot_axis(name: str, scale: wording.Scale, lines: Sequence[Line]) -> Axis:
    """Make an axis that includes all dots, and clips wide intervals so that the dots differ."""
    values = [line.x for line in lines if not line.look.startswith("interval")]
    ends = np.concatenate([line.x for line in lines])
    low, high = plots.clip_range(np.concatenate(values), ends, 1.0)
    return plots.make_axis(wording.write_label(name), scale, [np.array([low, high])])


def make_dot_lines(
    look: str, value: float, interval: Interval | None, row: float, group: str = ""
) -> Iterator[Line]:
    """Yield the bar of the interval of a number, if any, and its dot.

    Parameters
    ----------
    look : class of the dot with its colour
    value, interval : in SI
    row : vertical position
    group : stem of the group in a plot of several groups
    """
    if interval is not None and np.isfinite(interval.upper - interval.lower):
        bar = " ".join(["interval", *look.split()[1:]])
        yield Line(bar, np.array([interval.lower, interval.upper]), np.full(2, row), group=group)
    yield Line(look, np.array([value]), np.array([row]), group=group)


def _plot_dots(group: Group, number: GroupNumber, names: dict[str, int]) -> Iterator[Line]:
    """Yield the dots and bars of samples and means; add row names and row numbers to `names`."""
    spools = list(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    is_crowded = len(group.samples) > MAX_DOT_ROWS
    means = number.mean.spool_means
    for index, spool in enumerate(spools):
        tests = [sample.test for sample in group.samples if sample.specimen.spool == spool]
        colour = f"c{index % N_COLOURS}"
        for index_in_spool, test in enumerate(tests):
            name = f"{len(tests)} samples of {spool}" if is_crowded else test
            shift = (index_in_spool / len(tests) - 0.5) * 0.7 if is_crowded else 0.0
            row = -names.setdefault(name, len(names)) - shift
            yield from _plot_sample_dot(number, test, colour, row, has_bar=not is_crowded)
        if len(spools) > 1 and spool in means:
            row = -names.setdefault(f"mean of {spool}", len(names))
            mean = means[spool]
            yield from make_dot_lines(f"dot {colour}", mean.mean, mean.interval, row)
    if number.values:
        chosen, row = number.mean.chosen, -names.setdefault("mean", len(names))
        yield from make_dot_lines("dot", chosen.mean, chosen.interval, row)


def _plot_sample_dot(
    number: GroupNumber, test: str, colour: str, row: float, *, has_bar: bool
) -> Iterator[Line]:
    result = number.values.get(test)
    if result is None or result.value is None:
        return
    look = "doubtful" if result.status is Status.DOUBTFUL else "sample"
    interval = result.interval if has_bar else None
    yield from make_dot_lines(f"{look} {colour}", result.value, interval, row)
    if any(outlier.sample == test for outlier in number.outliers):
        yield Line("ring", np.array([result.value]), np.array([row]))
