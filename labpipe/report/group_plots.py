"""Plots of a group, for the page and for files: curves, shapes, measured laws, numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from typing import NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import FittedLine, Interval, SlipDecision
from labpipe.records.group import Band, Group, GroupNumber, Sample, SampleCurve
from labpipe.records.result import Status
from labpipe.report.issues import write_sentence
from labpipe.report.page_facts import PageTest, PageTests, make_key
from labpipe.report.plot_records import (
    Axis,
    LegendEntry,
    Line,
    Plot,
    clip_range,
    make_axis,
    simplify_line,
)
from labpipe.report.wording import (
    Scale,
    find_display,
    find_number_unit,
    find_unit,
    find_units,
    is_first_cycle,
    typeset_unit,
    write_count,
    write_label,
)
from labpipe.statistics.lots import FORCE_LIMIT, PEAK_OVER_LIMIT

_BAND_POINTS = 28
"""Largest number of points of a mean, or of one edge of a band."""
N_COLOURS = 8
"""Number of colours of the page for spools and groups."""
MAX_DOT_NUMBERS, MAX_DOT_ROWS = 6, 24
"""Largest number of panels of numbers, and of samples that have a row each in a panel."""


class _Points(NamedTuple):
    """Largest numbers of points of the lines of a test, and of its shapes.

    Parameters
    ----------
    first : of the first loading
    others : of all other branches together
    scaled : of the curve over its peak force
    shapes : number of shapes
    """

    first: int
    others: int
    scaled: int
    shapes: int


_FEW, _MANY = _Points(90, 40, 24, 6), _Points(43, 16, 10, 2)
"""On the page for few samples, and for many: a test takes less than 3 kB."""
_IN_FILES = _Points(120, 80, 120, 6)
_MAX_OFFSET_SHARE = 0.001
_MAX_DETAILED_SAMPLES = 6
_SMALL_PLOT = (262, 150)


@dataclass(frozen=True, eq=False)
class _GroupView:
    """A group with the data of its plots.

    Parameters
    ----------
    group : with or without samples
    stem : of its links
    tests : all of the page; None for a figure in a file, whose lines have more points
    """

    group: Group
    stem: str = ""
    tests: PageTests | None = None

    @cached_property
    def x_unit(self) -> Scale:
        """Return the display unit of displacement."""
        return find_unit(find_display(self.group), "displacement")

    @cached_property
    def y_unit(self) -> Scale:
        """Return the display unit of force."""
        return find_unit(find_display(self.group), "force")

    @property
    def rejected(self) -> list[PageTest]:
        """Return the rejected tests of the group on the page; none for a file."""
        return [] if self.tests is None else self.tests.rejected(self.stem)

    def number(self, sample: Sample) -> int | None:
        """Return the number of a test on the page; None for a file."""
        return None if self.tests is None else self.tests.number[make_key(sample)]

    @property
    def points(self) -> _Points:
        """Return the largest numbers of points of its lines."""
        if self.tests is None:
            return _IN_FILES
        return _FEW if len(self.group.samples) <= _MAX_DETAILED_SAMPLES else _MANY

    @cached_property
    def colours(self) -> dict[str, str]:
        """Return the class of the colour of each sample: its spool's, or its own for one spool."""
        samples = self.group.samples
        spools = {sample.specimen.spool: None for sample in samples}
        names = [sample.specimen.spool for sample in samples]
        if len(spools) == 1 and len(samples) <= _MAX_DETAILED_SAMPLES:
            names = list(map(make_key, samples))
        numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
        return {
            make_key(sample): f"c{numbers[name] % N_COLOURS}"
            for sample, name in zip(samples, names, strict=True)
        }

    def colour(self, sample: Sample) -> str:
        """Return the class of the colour of a sample."""
        return self.colours[make_key(sample)]


def make_group_plots(group: Group, stem: str, tests: PageTests) -> list[Plot]:
    """Make the plots of a group for the page, as far as it has data for them.

    Parameters
    ----------
    group : with or without samples
    stem : of its links
    tests : all of the page

    Returns
    -------
    Force against displacement first, if any sample has a curve; then smaller plots.
    """
    view = _GroupView(group, stem, tests)
    makers = (_curve_plot, _shape_plot, _moment_plot, _scaled_plot)
    return [plot for make in makers if (plot := make(view)) is not None]


def make_file_plots(group: Group) -> dict[str, list[Plot]]:
    """Make the plots of a group for files, as far as it has data for them.

    Parameters
    ----------
    group : with or without samples

    Returns
    -------
    Plots by the name of their figure: ``curves``, ``scaled`` (force over peak force), ``shapes``,
    ``moment`` and ``numbers``.
    """
    view = _GroupView(group)
    figures: dict[str, list[Plot | None]] = {
        "curves": [_curve_plot(view)],
        "scaled": [_scaled_plot(view)],
        "shapes": [_shape_plot(view)],
        "moment": [_moment_plot(view)],
        "numbers": [*_number_plots(group)],
    }
    drawn = {name: [plot for plot in plots if plot is not None] for name, plots in figures.items()}
    return {name: plots for name, plots in drawn.items() if plots}


def find_first_loading(sample: Sample) -> SampleCurve | None:
    """Find the first loading curve of a sample that has points; None without one."""
    return next((curve for curve in sample.loading if len(curve.displacement)), None)


def _value(sample: Sample, name: str) -> float | None:
    return next((result.value for result in sample.results if result.name == name), None)


def _curve_plot(view: _GroupView) -> Plot | None:
    group, band = view.group, view.group.band
    if all(find_first_loading(sample) is None for sample in group.samples):
        return None
    lines = [
        *make_band_lines(band, view.x_unit.factor, view.y_unit.factor),
        *_rejected_lines(view),
        *(line for sample in group.samples for line in _sample_lines(view, sample)),
        *_window_lines(view),
        *make_mean_lines(band, view.x_unit.factor, view.y_unit.factor),
        *(line for sample in group.samples for line in _event_lines(view, sample)),
    ]
    x = make_axis("Displacement", view.x_unit.unit, [line.x for line in lines])
    lines += _limit_lines(view, x)
    y = _force_axis(view, band)
    title = (
        f"Force against displacement of {write_count(len(group.samples), 'sample')}: {group.name}."
    )
    caption = write_sentence(band.reason.message) if band.reason else ""
    keys = _keys(view, lines, f"mean of {band.n} {band.members}")
    return Plot("curves", view.stem, title, caption, x, y, lines, keys, (660, 240))


def _limits(view: _GroupView) -> list[float]:
    """Return the smallest forces allowed of the samples, N, each once."""
    limits = (_value(sample, FORCE_LIMIT) for sample in view.group.samples)
    return sorted({limit for limit in limits if limit is not None})


def _limit_lines(view: _GroupView, x: Axis) -> Iterator[Line]:
    """Yield a line for each smallest force allowed."""
    for limit in _limits(view):
        yield Line("limit", np.array([x.low, x.high]), np.full(2, limit * view.y_unit.factor))


def _force_axis(view: _GroupView, band: Band, *, is_scaled: bool = False) -> Axis:
    """Return the axis of force: all curves, and of bands as much as leaves the curves readable.

    Beyond the curves, the axis shows the pointwise band up to half their height. It shows the
    simultaneous band in full if that needs at most a quarter more, else clipped.
    """
    factor = 1.0 if is_scaled else view.y_unit.factor
    forces = [
        edge * (1.0 / (_value(sample, "peak_force.1") or nan) if is_scaled else 1.0)
        for sample in view.group.samples
        for curve in (sample.loading[:1] if is_scaled else (*sample.loading, *sample.unloading))
        if np.isfinite(curve.force).any()
        for edge in (float(np.nanmin(curve.force)), float(np.nanmax(curve.force)))
    ]
    forces += [] if is_scaled else _limits(view)
    low, high = clip_range(forces, [*band.lower, *band.upper], 0.5)
    whole = clip_range([low, high], [*band.lower_all, *band.upper_all], np.inf)
    if whole[1] - whole[0] <= 1.25 * (high - low):
        low, high = whole
    margin = 0.04 * (high - low) or 1.0
    name, unit = ("Force / peak force", "") if is_scaled else ("Force", view.y_unit.unit)
    return Axis(name, unit, factor * (low - margin), factor * (high + margin))


def _sample_lines(view: _GroupView, sample: Sample) -> Iterator[Line]:
    """Yield the other branches, the force as measured if slips were repaired, the first loading."""
    test, colour = view.number(sample), view.colour(sample)
    first = find_first_loading(sample)
    others = [
        curve
        for curve in (*sample.loading, *sample.unloading)
        if curve is not first and len(curve.displacement)
    ]
    for other in others:
        points = max(view.points.others // len(others), 8)
        yield _line(view, f"unloading {colour}", test, (other, other.force), points=points)
    if first is None:
        return
    if any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips):
        yield _line(view, "measured", test, (first, first.as_measured), points=view.points.others)
    yield _line(view, f"curve {colour}", test, (first, first.force), points=view.points.first)


def _line(
    view: _GroupView, look: str, test: int | None, curve: tuple[SampleCurve, Floats], *, points: int
) -> Line:
    """Return the line of a branch and its force, thinned to a number of points."""
    branch, force = curve
    rows = simplify_line(branch.displacement, force, max_points=points, tolerance=_MAX_OFFSET_SHARE)
    x, y = branch.displacement[rows] * view.x_unit.factor, force[rows] * view.y_unit.factor
    return Line(look, x, y, test)


def _rejected_lines(view: _GroupView) -> Iterator[Line]:
    for test in view.rejected:
        first = find_first_loading(test.sample)
        if first is not None:
            points = view.points.others
            yield _line(view, "rejected", test.number, (first, first.force), points=points)


def _window_lines(view: _GroupView) -> Iterator[Line]:
    """Yield the fitted lines over their windows."""
    for sample in view.group.samples:
        parts: dict[str, list[FittedLine]] = {}
        for line in sample.lines:
            look = "segment" if line.result.startswith("segment") else "window"
            parts.setdefault(look, []).append(line)
        for look, lines in parts.items():
            start, stop, slope, level = np.array(
                [(line.start, line.stop, line.slope, line.level) for line in lines]
            ).T
            x, y = _with_gaps(start, stop), _with_gaps(level, level + slope * (stop - start))
            factors = view.x_unit.factor, view.y_unit.factor
            yield Line(look, x * factors[0], y * factors[1], view.number(sample))


def _event_lines(view: _GroupView, sample: Sample) -> Iterator[Line]:
    """Yield slips and failure of a test as dots on its curve."""
    first = find_first_loading(sample)
    if first is None:
        return
    finite = np.isfinite(first.displacement) & np.isfinite(first.force)
    places = np.array([slip.position for slip in sample.slips])
    if len(places) and finite.any():
        height = np.interp(places, first.displacement[finite], first.force[finite])
        yield _dot_line("slip", places, height, view, sample)
    at, force = _value(sample, "failure_displacement"), _value(sample, "failure_force")
    if at is not None and force is not None:
        yield _dot_line("failure", np.array([at]), np.array([force]), view, sample)


def _dot_line(look: str, places: Floats, heights: Floats, view: _GroupView, sample: Sample) -> Line:
    x, y = _with_gaps(places) * view.x_unit.factor, _with_gaps(heights) * view.y_unit.factor
    return Line(look, x, y, view.number(sample))


def _with_gaps(*columns: Floats) -> Floats:
    """Join the columns row by row with NaN after each row, which interrupts a line."""
    return np.column_stack([*columns, np.full(len(columns[0]), np.nan)]).ravel()


def make_band_lines(
    band: Band, x_factor: float, y_factor: float, look: str = "", group: str = ""
) -> Iterator[Line]:
    """Yield the pointwise band of a mean curve as an area, and the edges of the simultaneous band.

    Parameters
    ----------
    band : one of fewer than two curves, or one without an area, is not drawn
    x_factor, y_factor : factors from SI to the units of the axes
    look : class of its colour
    group : stem, if several groups are in one plot: only the pointwise band is then drawn
    """
    if band.n < 2 or not band.has_area:
        return
    rows = _band_rows(band, band.upper)
    x = band.displacement[rows] * x_factor
    lower, upper = band.lower[rows] * y_factor, band.upper[rows] * y_factor
    finite = np.isfinite(lower) & np.isfinite(upper)
    outline = np.concatenate([x[finite], x[finite][::-1]])
    edge = np.concatenate([upper[finite], lower[finite][::-1]])
    yield Line(f"band {look}".strip(), outline, edge, group=group, is_closed=True)
    if group:
        return
    for edge_all in (band.lower_all, band.upper_all):
        if np.isfinite(edge_all).any():
            yield Line("whole", x, edge_all[rows] * y_factor)


def _band_rows(band: Band, values: Floats) -> Ints:
    """Find the points with which a band or a mean is drawn."""
    return simplify_line(
        band.displacement, values, max_points=_BAND_POINTS, tolerance=_MAX_OFFSET_SHARE
    )


def make_mean_lines(
    band: Band, x_factor: float, y_factor: float, look: str = "", group: str = ""
) -> Iterator[Line]:
    """Yield a mean curve, and its intervals at single displacements if it has no area.

    Parameters
    ----------
    band, x_factor, y_factor, look, group : as for `make_band_lines`
    """
    if not len(band.displacement) or (band.n < 2 and not group):
        return  # the mean of one sample is that sample
    rows = _band_rows(band, band.mean)
    x, y = band.displacement[rows] * x_factor, band.mean[rows] * y_factor
    yield Line(f"mean {look}".strip(), x, y, group=group)
    marks = band.marks
    if len(marks):
        mark_places = band.displacement[marks] * x_factor
        ends = _with_gaps(band.lower[marks] * y_factor, band.upper[marks] * y_factor)
        x = _with_gaps(mark_places, mark_places)
        yield Line(f"interval {look}".strip(), x, ends, group=group)


def _keys(view: _GroupView, lines: Sequence[Line], mean: str = "mean") -> list[LegendEntry]:
    """Make the key of a plot: its tests if they are few, else its spools; then the other signs."""
    group, looks = view.group, {line.css_class.partition(" ")[0] for line in lines}
    spools = {sample.specimen.spool for sample in group.samples}
    is_few = len(group.samples) <= _MAX_DETAILED_SAMPLES
    if is_few and (view.tests is not None or len(spools) == 1):  # the page shows or hides each
        keys = [
            LegendEntry(f"curve {view.colour(sample)}", sample.test, "t", str(view.number(sample)))
            for sample in group.samples
        ]
    else:
        keys = [
            LegendEntry(f"curve {colour}", f"spool {spool}", "class", colour)
            for spool, colour in {
                sample.specimen.spool: view.colour(sample) for sample in group.samples
            }.items()
        ]
    labels = {"mean": mean, **_KEY_LABELS}
    return keys + [
        LegendEntry(look, label, "class", look) for look, label in labels.items() if look in looks
    ]


_KEY_LABELS = {
    "interval": "95 % interval of the mean",
    "band": "95 % band, pointwise",
    "whole": "95 % band, whole curve",
    "unloading": "unloading, later cycles",
    "window": "window of a stiffness fit",
    "segment": "fitted segments",
    "measured": "measured, before repair of slips",
    "limit": "smallest force allowed",
    "slip": "slip",
    "failure": "failure",
    "rejected": "rejected: not in any mean",
}


def _shape_plot(view: _GroupView) -> Plot | None:
    """Make the plot of the markers at equal steps of the first loading, with one scale."""
    min_height, max_height = 88, 190
    lines, steps = [], np.zeros(0)
    for sample in view.group.samples:
        shapes = sample.shapes
        if shapes is None or not np.isfinite(shapes.positions).any():
            continue
        places = shapes.positions[-view.points.shapes :]
        x, y = (_with_gaps(*places[:, :, way].T) * view.x_unit.factor for way in (0, 1))
        lines.append(Line(f"shape {view.colour(sample)}", x, y, view.number(sample)))
        steps = max(steps, shapes.deflection, key=len)
    if not lines:
        return None
    unit, width = view.x_unit.unit, _SMALL_PLOT[0]
    x_axis = make_axis("Along the specimen", unit, [line.x for line in lines])
    y_axis = make_axis("Deflection", unit, [line.y for line in lines], margin=0.06)
    ratio = (y_axis.high - y_axis.low) / (x_axis.high - x_axis.low)
    height = min(max(round(width * ratio), min_height), max_height)
    scale = max((x_axis.high - x_axis.low) / width, (y_axis.high - y_axis.low) / height)
    x_axis, y_axis = _spread(x_axis, scale * width), _spread(y_axis, scale * height)
    shown = np.round(steps[-view.points.shapes :], 4) + 0.0
    deflections = ", ".join(f"{way * view.x_unit.factor:.2g}" for way in shown)
    caption = f"Markers at {deflections} {unit} of the first loading, at equal axis scale."
    title = f"Shapes of {write_count(len(lines), 'sample')} of {view.group.name}."
    keys = _keys(view, lines)
    return Plot("shapes", view.stem, title, caption, x_axis, y_axis, lines, keys, (width, height))


def _spread(axis: Axis, span: float) -> Axis:
    middle = 0.5 * (axis.low + axis.high)
    return replace(axis, low=middle - 0.5 * span, high=middle + 0.5 * span)


def _moment_plot(view: _GroupView) -> Plot | None:
    """Make the plot of the measured laws, for few samples with 95 % intervals as areas."""
    x_unit, y_unit = find_units(find_display(view.group), "curvature", "moment")
    samples_with_laws = [
        (sample, sample.law) for sample in view.group.samples if sample.law is not None
    ]
    if not samples_with_laws:
        return None
    areas, lines = [], []
    for sample, law in samples_with_laws:
        colour, test = view.colour(sample), view.number(sample)
        x = law.curvature * x_unit.factor
        if len(samples_with_laws) <= _MAX_DETAILED_SAMPLES:
            outline = np.concatenate([x, x[::-1]])
            edge = np.concatenate([law.moment_upper, law.moment_lower[::-1]]) * y_unit.factor
            areas.append(Line(f"band {colour}", outline, edge, test, is_closed=True))
        lines.append(Line(f"curve {colour}", x, law.moment * y_unit.factor, test))
    x_axis = make_axis("Curvature", x_unit.unit, [line.x for line in lines])
    y_axis = make_axis("Bending moment", y_unit.unit, [line.y for line in (*areas, *lines)])
    caption = "Measured from the shapes, first loading."
    caption += " Area: 95 % interval of each sample." if areas else ""
    title = f"Bending moment against curvature of {view.group.name}."
    keys = _keys(view, lines)
    every = [*areas, *lines]
    return Plot("moment", view.stem, title, caption, x_axis, y_axis, every, keys, _SMALL_PLOT)


def _scaled_plot(view: _GroupView) -> Plot | None:
    """Make the plot of force over the peak force of each sample."""
    band = view.group.band_scaled
    if band is None:
        return None
    lines = [
        *list(make_band_lines(band, view.x_unit.factor, 1.0))[:1],
        *(line for sample in view.group.samples for line in _scaled_lines(view, sample)),
        *make_mean_lines(band, view.x_unit.factor, 1.0),
    ]
    if not lines:
        return None
    x = make_axis("Displacement", view.x_unit.unit, [line.x for line in lines])
    y = _force_axis(view, band, is_scaled=True)
    title = f"Force over peak force against displacement of {view.group.name}."
    caption = format_sentence("report.scaled_caption")
    keys = _keys(view, lines, f"mean of {band.n} {band.members}")
    return Plot("scaled", view.stem, title, caption, x, y, lines, keys, _SMALL_PLOT)


def _scaled_lines(view: _GroupView, sample: Sample) -> Iterator[Line]:
    first, peak = find_first_loading(sample), _value(sample, "peak_force.1")
    if first is None or not peak:
        return
    points = view.points.scaled
    line = _line(view, f"curve {view.colour(sample)}", view.number(sample),
                 (first, first.force), points=points)  # fmt: skip
    yield replace(line, y=line.y / (peak * view.y_unit.factor))


def _number_plots(group: Group) -> Iterator[Plot]:
    """Yield a plot for each of the first numbers with two or more samples; no later cycles.

    Its rows are the samples and the mean of each spool, and the mean.
    """
    first_cycle = [number for number in group.numbers if is_first_cycle(number.name)]
    numbers = [
        number
        for number in first_cycle
        if number.mean is not None and number.mean.over_samples.n > 1
    ][:MAX_DOT_NUMBERS]
    drawn = {number.name for number in numbers}
    others = "; ".join(
        write_label(number.name) for number in first_cycle if number.name not in drawn
    )
    for number in numbers:
        scale = find_number_unit(group, number)
        names: dict[str, int] = {}
        lines = list(_dot_rows(group, number, scale.factor, names))
        if group.lot is not None and number.name in (PEAK_OVER_LIMIT, "peak_force.1"):
            limit = 1.0 if number.name == PEAK_OVER_LIMIT else group.lot.limit
            places = np.full(2, scale.factor * (np.nan if limit is None else limit))
            lines.append(Line("limit", places, np.array([0.5, 0.5 - len(names)])))
        values = [line.x for line in lines if not line.css_class.startswith("interval")]
        x = make_clipped_axis(write_label(number.name), scale, lines, values)
        y = Axis("", "", 0.5 - len(names), 0.5, tuple(names))
        looks = {line.css_class.partition(" ")[0] for line in lines}
        keys = [LegendEntry(look, label) for look, label in _DOT_LABELS.items() if look in looks]
        title = f"Each sample's numbers, with 95 % intervals: {group.name}."
        caption = f"In the tables only: {others}." if others else ""
        size = (262, 20 + 11 * len(names))
        yield Plot("numbers", "", title, caption, x, y, lines, keys, size)


_DOT_LABELS = {
    "sample": "sample, 95 %",
    "doubtful": "doubtful",
    "dot": "mean, 95 %",
    "ring": "marked as outlier",
    "limit": "smallest allowed",
}


def make_clipped_axis(
    name: str, scale: Scale, lines: Sequence[Line], values: Sequence[Floats]
) -> Axis:
    """Make an axis that includes all values, and of wide intervals as much as keeps them apart."""
    margin = 0.03
    ends = np.concatenate([line.x for line in lines])
    low, high = clip_range(np.concatenate(values), ends, 1.0)
    room = margin * ((high - low) or abs(high) or 1.0)
    return Axis(name, typeset_unit(scale.unit), low - room, high + room)


class DotRow(NamedTuple):
    """Place of a dot in a plot of numbers.

    Parameters
    ----------
    height : of the row
    factor : from SI to the unit of the axis
    colour : class; empty for black
    group : stem, if several groups are in one plot
    """

    height: float
    factor: float
    colour: str = ""
    group: str = ""


def make_dot_lines(
    look: str, value: float, interval: Interval | None, row: DotRow
) -> Iterator[Line]:
    """Yield the bar of the interval of a number, if any, and its dot.

    Parameters
    ----------
    look : class of the dot
    value, interval : in SI
    row : of the plot
    """
    if interval is not None and np.isfinite(interval.upper - interval.lower):
        ends = row.factor * np.array([interval.lower, interval.upper])
        bar = f"interval {row.colour}".strip()
        yield Line(bar, ends, np.full(2, row.height), group=row.group)
    point = np.array([row.factor * value]), np.array([row.height])
    yield Line(f"{look} {row.colour}".strip(), *point, group=row.group)


def _dot_rows(
    group: Group, number: GroupNumber, factor: float, names: dict[str, int]
) -> Iterator[Line]:
    """Yield the dots and bars of samples and means; add the names of the rows to `names`."""
    spools = list(dict.fromkeys(sample.specimen.spool for sample in group.samples))
    is_crowded = len(group.samples) > MAX_DOT_ROWS
    for at, spool in enumerate(spools):
        tests = [sample.test for sample in group.samples if sample.specimen.spool == spool]
        colour = f"c{at % N_COLOURS}"
        for place, test in enumerate(tests):
            name = f"{len(tests)} samples of {spool}" if is_crowded else test
            shift = (place / len(tests) - 0.5) * 0.7 if is_crowded else 0.0
            height = -names.setdefault(name, len(names)) - shift
            row = DotRow(height, factor, colour)
            yield from _sample_dots(number, test, row, has_bar=not is_crowded)
        mean = number.mean.spool_means.get(spool) if number.mean is not None else None
        if len(spools) > 1 and mean is not None:
            row = DotRow(-names.setdefault(f"mean of {spool}", len(names)), factor, colour)
            yield from make_dot_lines("dot", mean.mean, mean.interval, row)
    if number.mean is not None:
        mean = number.mean.chosen
        row = DotRow(-names.setdefault("mean", len(names)), factor)
        yield from make_dot_lines("dot", mean.mean, mean.interval, row)


def _sample_dots(number: GroupNumber, test: str, row: DotRow, *, has_bar: bool) -> Iterator[Line]:
    result = number.values.get(test)
    if result is None or result.value is None:
        return
    look = "doubtful" if result.status is Status.DOUBTFUL else "sample"
    yield from make_dot_lines(look, result.value, result.interval if has_bar else None, row)
    if any(outlier.sample == test for outlier in number.outliers):
        yield Line("ring", np.array([row.factor * result.value]), np.array([row.height]))
