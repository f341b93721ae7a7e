"""Plots of a group on the page: curves, shapes, moment-curvature, force over peak force."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import FittedLine, SlipDecision
from labpipe.records.group import Band, Group, Sample, SampleCurve
from labpipe.report.group_plots import (
    display_scale,
    first_loading,
    force_limits,
    group_scale,
    value_of,
)
from labpipe.report.issues import sentence
from labpipe.report.page_facts import PageTests, key_of
from labpipe.report.page_plots import Axis, Key, Line, Plot, axis_over, equal_scale_height
from labpipe.report.plot_thinning import simplify_line
from labpipe.report.wording import Scale, count_of, display_of, shown_in, unit_words

COLOURS = 8
"""Colours of the page for spools and groups; they repeat after this number."""


class _Points(NamedTuple):
    """Points of a first loading, of all other branches of a test and of a scaled curve; shapes."""

    first: int
    others: int
    scaled: int
    shapes: int


_FEW, _MANY = _Points(90, 40, 24, 6), _Points(43, 16, 10, 2)
"""For few samples, and for many, with overlapping lines: a test is below 3 kB."""
_MAX_OFFSET_SHARE = 0.001
_BAND_OUTLINE_POINTS = 28
_MAX_DETAILED_SAMPLES = 6
_SMALL_PLOT = (262, 150)


@dataclass(frozen=True, slots=True, eq=False)
class _GroupView:
    """A group with the data of its plots.

    Parameters
    ----------
    group, stem : and its name in links
    tests : all of the page
    across, up : display units of displacement and force
    """

    group: Group
    stem: str
    tests: PageTests
    across: Scale
    up: Scale

    def number(self, sample: Sample) -> int:
        """Return the number of a test on the page."""
        return self.tests.number[key_of(sample)]

    @property
    def points(self) -> _Points:
        """Return the numbers of points of its lines."""
        return _FEW if len(self.group.samples) <= _MAX_DETAILED_SAMPLES else _MANY

    def colour(self, sample: Sample) -> str:
        """Return the class of a sample's colour: of its spool, or its own for one spool."""
        spools = list(dict.fromkeys(sample.specimen.spool for sample in self.group.samples))
        number = spools.index(sample.specimen.spool)
        if len(spools) == 1 and len(self.group.samples) <= _MAX_DETAILED_SAMPLES:
            number = [key_of(sample) for sample in self.group.samples].index(key_of(sample))
        return f"c{number % COLOURS}"


def group_panels(group: Group, stem: str, tests: PageTests) -> list[Plot]:
    """Return the plots of a group for which it has data.

    Parameters
    ----------
    group : with or without samples
    stem : its name in links
    tests : all of the page

    Returns
    -------
    Force against displacement first, if any sample has a curve; then smaller plots.
    """
    drawn = _GroupView(
        group, stem, tests, group_scale(group, "displacement"), group_scale(group, "force")
    )
    makers = (_curve_plot, _shape_plot, _moment_plot, _scaled_plot)
    return [plot for make in makers if (plot := make(drawn)) is not None]


def _curve_plot(drawn: _GroupView) -> Plot | None:
    group, band = drawn.group, drawn.group.band
    if all(first_loading(sample) is None for sample in group.samples):
        return None
    low, high = force_limits(group, band)
    lines = [
        *band_lines(band, drawn.across.factor, drawn.up.factor),
        *_rejected_lines(drawn),
        *(line for sample in group.samples for line in _sample_lines(drawn, sample)),
        *_window_lines(drawn),
        *mean_lines(band, drawn.across.factor, drawn.up.factor),
        *(line for sample in group.samples for line in _event_lines(drawn, sample)),
    ]
    x = axis_over("Displacement", unit_words(drawn.across.unit), [line.x for line in lines])
    y = Axis("Force", unit_words(drawn.up.unit), low * drawn.up.factor, high * drawn.up.factor)
    title = f"Force against displacement of {count_of(len(group.samples), 'sample')}: {group.name}."
    return Plot(
        "curves", drawn.stem, title, _caption(group), x, y, lines, _keys(drawn, lines), (660, 240)
    )


def _sample_lines(drawn: _GroupView, sample: Sample) -> Iterator[Line]:
    """Yield first loading, other branches, and the measured force if slips were repaired."""
    test, colour = drawn.number(sample), drawn.colour(sample)
    first = first_loading(sample)
    others = [
        curve
        for curve in (*sample.loading, *sample.unloading)
        if curve is not first and len(curve.displacement)
    ]
    for other in others:
        points = max(drawn.points.others // len(others), 8)
        yield _line(drawn, f"unloading {colour}", test, (other, other.force), points=points)
    if first is None:
        return
    if any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips):
        yield _line(drawn, "measured", test, (first, first.as_measured), points=drawn.points.others)
    yield _line(drawn, f"curve {colour}", test, (first, first.force), points=drawn.points.first)


def _line(
    drawn: _GroupView, look: str, test: int, curve: tuple[SampleCurve, Floats], *, points: int
) -> Line:
    """Return the line of a branch and its force, thinned to a number of points."""
    branch, force = curve
    rows = simplify_line(branch.displacement, force, points=points, tolerance=_MAX_OFFSET_SHARE)
    x, y = branch.displacement[rows] * drawn.across.factor, force[rows] * drawn.up.factor
    return Line(look, x, y, test)


def _rejected_lines(drawn: _GroupView) -> Iterator[Line]:
    for test in drawn.tests.rejected(drawn.stem):
        first = first_loading(test.sample)
        if first is not None:
            yield _line(
                drawn, "rejected", test.number, (first, first.force), points=drawn.points.others
            )


def _window_lines(drawn: _GroupView) -> Iterator[Line]:
    """Yield the fitted lines over their windows."""
    for sample in drawn.group.samples:
        test = drawn.number(sample)
        parts: dict[str, list[FittedLine]] = {}
        for line in sample.lines:
            look = "segment" if line.result.startswith("segment") else "window"
            parts.setdefault(look, []).append(line)
        for look, lines in parts.items():
            start, stop, slope, level = np.array(
                [(line.start, line.stop, line.slope, line.level) for line in lines]
            ).T
            x, y = _with_gaps(start, stop), _with_gaps(level, level + slope * (stop - start))
            yield Line(look, x * drawn.across.factor, y * drawn.up.factor, test)


def _event_lines(drawn: _GroupView, sample: Sample) -> Iterator[Line]:
    """Yield slips and failure of a test as dots on its curve."""
    first, test = first_loading(sample), drawn.number(sample)
    if first is None:
        return
    finite = np.isfinite(first.displacement) & np.isfinite(first.force)
    places = np.array([slip.position for slip in sample.slips])
    if len(places) and finite.any():
        height = np.interp(places, first.displacement[finite], first.force[finite])
        yield _dot_line("slip", places, height, drawn, test)
    displacement = value_of(sample, "failure_displacement")
    force = value_of(sample, "failure_force")
    if displacement is not None and force is not None:
        yield _dot_line("failure", np.array([displacement]), np.array([force]), drawn, test)


def _dot_line(look: str, places: Floats, heights: Floats, drawn: _GroupView, test: int) -> Line:
    x, y = _with_gaps(places) * drawn.across.factor, _with_gaps(heights) * drawn.up.factor
    return Line(look, x, y, test)


def _with_gaps(*columns: Floats) -> Floats:
    """Return points row by row, with NaN after each row, which interrupts a line."""
    return np.column_stack([*columns, np.full(len(columns[0]), np.nan)]).ravel()


def band_lines(
    band: Band, across: float, up: float, look: str = "", group: str = ""
) -> Iterator[Line]:
    """Yield the pointwise band of a mean curve as an area and the edges of the simultaneous band.

    Parameters
    ----------
    band : of few curves without an area, nothing is drawn
    across, up : from SI to the units of the axes
    look : class of its colour
    group : stem, if several groups are in one plot
    """
    if band.n < 2 or not band.has_area:
        return
    rows = _band_rows(band)
    x = band.displacement[rows] * across
    lower, upper = band.lower[rows] * up, band.upper[rows] * up
    finite = np.isfinite(lower) & np.isfinite(upper)
    outline = np.concatenate([x[finite], x[finite][::-1]])
    edge = np.concatenate([upper[finite], lower[finite][::-1]])
    yield Line(f"band {look}".strip(), outline, edge, group=group, is_closed=True)
    if group:
        return
    for edge_all in (band.lower_all, band.upper_all):
        if np.isfinite(edge_all).any():
            yield Line("whole", x, edge_all[rows] * up)


def _band_rows(band: Band) -> Ints:
    """Return the points with which all edges of a band are drawn."""
    return simplify_line(
        band.displacement, band.upper, points=_BAND_OUTLINE_POINTS, tolerance=_MAX_OFFSET_SHARE
    )


def mean_lines(
    band: Band, across: float, up: float, look: str = "", group: str = ""
) -> Iterator[Line]:
    """Yield a mean curve and, for few curves, its intervals at single displacements.

    Parameters
    ----------
    band, across, up, look, group : as for `band_lines`
    """
    if not len(band.displacement) or (band.n < 2 and not group):
        return  # the mean of one sample is that sample
    rows = simplify_line(
        band.displacement, band.mean, points=_BAND_OUTLINE_POINTS, tolerance=_MAX_OFFSET_SHARE
    )
    x, y = band.displacement[rows] * across, band.mean[rows] * up
    yield Line(f"mean {look}".strip(), x, y, group=group)
    marks = band.marks
    if len(marks):
        mark_places = band.displacement[marks] * across
        ends = _with_gaps(band.lower[marks] * up, band.upper[marks] * up)
        x = _with_gaps(mark_places, mark_places)
        yield Line(f"interval {look}".strip(), x, ends, group=group)


def _keys(drawn: _GroupView, lines: Sequence[Line]) -> list[Key]:
    """Return the key of a plot: its tests if they are few, else its spools."""
    group, looks = drawn.group, {line.look.partition(" ")[0] for line in lines}
    if len(group.samples) <= _MAX_DETAILED_SAMPLES:
        keys = [
            Key(f"curve {drawn.colour(sample)}", sample.test, "t", str(drawn.number(sample)))
            for sample in group.samples
        ]
    else:
        keys = [
            Key(f"curve {colour}", f"spool {spool}", "class", colour)
            for spool, colour in {
                sample.specimen.spool: drawn.colour(sample) for sample in group.samples
            }.items()
        ]
    mean_text = f"mean of {group.band.n} {group.band.members}"
    labels = {"mean": mean_text, **_KEY_LABELS}
    return keys + [
        Key(look, label, "class", look) for look, label in labels.items() if look in looks
    ]


_KEY_LABELS = {
    "interval": "95 % interval of the mean",
    "band": "95 % band, pointwise",
    "whole": "95 % band, whole curve",
    "unloading": "unloading, later cycles",
    "window": "window of a stiffness fit",
    "segment": "fitted segments",
    "measured": "measured, before repair of slips",
    "slip": "slip",
    "failure": "failure",
    "rejected": "rejected: not in any mean",
}


def _caption(group: Group) -> str:
    """Return why there is no band; empty with a band."""
    return sentence(group.band.reason.message) if group.band.reason else ""


def _shape_plot(drawn: _GroupView) -> Plot | None:
    """Return the plot of markers at equal steps of the first loading, at equal scale."""
    min_height, max_height = 88, 190
    samples = [sample for sample in drawn.group.samples if sample.shapes is not None]
    lines = []
    for sample in samples:
        shapes = sample.shapes
        if shapes is None or not len(shapes.deflection):
            continue
        places = shapes.positions[-drawn.points.shapes :]
        x, y = (_with_gaps(*places[:, :, axis].T) * drawn.across.factor for axis in (0, 1))
        look = f"shape {drawn.colour(sample)}"
        lines.append(Line(look, x, y, drawn.number(sample)))
    if not lines:
        return None
    unit = unit_words(drawn.across.unit)
    x_axis = axis_over("Along the specimen", unit, [line.x for line in lines])
    y_axis = axis_over("Deflection", unit, [line.y for line in lines], room=0.06)
    width = _SMALL_PLOT[0]
    height = min(max(equal_scale_height(width, x_axis, y_axis), min_height), max_height)
    x_axis, y_axis = _equal_scale(x_axis, y_axis, width, height)
    steps = ", ".join(
        f"{step * drawn.across.factor:.2g}" for step in _steps(samples)[-drawn.points.shapes :]
    )
    caption = f"Markers at {steps} {unit} of the first loading, at equal axis scale."
    title = f"Shapes of {count_of(len(lines), 'sample')} of {drawn.group.name}."
    size = (width, height)
    return Plot("shapes", drawn.stem, title, caption, x_axis, y_axis, lines, (), size)


def _steps(samples: Sequence[Sample]) -> Floats:
    max_step = max(
        (sample.shapes for sample in samples if sample.shapes),
        key=lambda shapes: len(shapes.deflection),
    )
    return np.round(max_step.deflection, 4) + 0.0


def _equal_scale(x: Axis, y: Axis, width: int, height: int) -> tuple[Axis, Axis]:
    """Widen one of two axes so that both have the same scale."""
    scale = max((x.high - x.low) / width, (y.high - y.low) / height)
    return _widened(x, scale * width), _widened(y, scale * height)


def _widened(axis: Axis, span: float) -> Axis:
    middle = 0.5 * (axis.low + axis.high)
    return Axis(axis.name, axis.unit, middle - 0.5 * span, middle + 0.5 * span)


def _moment_plot(drawn: _GroupView) -> Plot | None:
    """Return the plot of measured laws, for few samples with 95 % intervals as areas."""
    display = display_of(drawn.group)
    across, up = shown_in("", "1/m", display), display_scale("N*m", display.get("moment", "N*m"))
    samples_with_laws = [
        (sample, sample.law) for sample in drawn.group.samples if sample.law is not None
    ]
    if not samples_with_laws:
        return None
    areas, lines = [], []
    for sample, law in samples_with_laws:
        colour, test = drawn.colour(sample), drawn.number(sample)
        x = law.curvature * across.factor
        if len(samples_with_laws) <= _MAX_DETAILED_SAMPLES:
            outline = np.concatenate([x, x[::-1]])
            edge = np.concatenate([law.moment_upper, law.moment_lower[::-1]]) * up.factor
            areas.append(Line(f"band {colour}", outline, edge, test, is_closed=True))
        lines.append(Line(f"curve {colour}", x, law.moment * up.factor, test))
    x_axis = axis_over("Curvature", unit_words(across.unit), [line.x for line in lines])
    y_axis = axis_over("Bending moment", unit_words(up.unit), [line.y for line in (*areas, *lines)])
    caption = "Measured from the shapes, first loading."
    caption += " Area: 95 % interval of each sample." if areas else ""
    title = f"Bending moment against curvature of {drawn.group.name}."
    every = [*areas, *lines]
    return Plot("moment", drawn.stem, title, caption, x_axis, y_axis, every, (), _SMALL_PLOT)


def _scaled_plot(drawn: _GroupView) -> Plot | None:
    """Return the plot of force over the peak force of each sample."""
    band = drawn.group.band_scaled
    if band is None:
        return None
    lines = [
        *list(band_lines(band, drawn.across.factor, 1.0))[:1],
        *(line for sample in drawn.group.samples for line in _scaled_lines(drawn, sample)),
        *mean_lines(band, drawn.across.factor, 1.0),
    ]
    if not lines:
        return None
    unit = unit_words(drawn.across.unit)
    x = axis_over("Displacement", unit, [line.x for line in lines])
    low, high = force_limits(drawn.group, band, is_scaled=True)
    y = Axis("Force / peak force", "", low, high)
    title = f"Force over peak force against displacement of {drawn.group.name}."
    caption = "Force over the peak force of the same sample: the scatter shown is not of strength."
    return Plot("scaled", drawn.stem, title, caption, x, y, lines, (), _SMALL_PLOT)


def _scaled_lines(drawn: _GroupView, sample: Sample) -> Iterator[Line]:
    first, peak = first_loading(sample), value_of(sample, "peak_force.1")
    if first is None or not peak:
        return
    rows = simplify_line(
        first.displacement, first.force, points=drawn.points.scaled, tolerance=_MAX_OFFSET_SHARE
    )
    x, y = first.displacement[rows] * drawn.across.factor, first.force[rows] / peak
    yield Line(f"curve {drawn.colour(sample)}", x, y, drawn.number(sample))
