"""The plots of a group on the page: curves, shapes, moment-curvature, force over peak force."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import FittedLine, SlipDecision
from labpipe.records.group import Band, Group, Sample, SampleCurve
from labpipe.report.group_plots import first_loading, group_scale, seen, value_of
from labpipe.report.issues import sentence
from labpipe.report.page_facts import PageTests, key_of
from labpipe.report.page_plots import Axis, Key, Line, Plot, axis_over, even
from labpipe.report.plot_thinning import bends
from labpipe.report.wording import Scale, count_of, display_of, shown_in, unit_words

COLOURS = 8
"""Colours of the page for spools and groups; they begin anew after so many."""


class _Points(NamedTuple):
    """Points of a first loading, of all else of a test, and over the peak force; shapes."""

    first: int
    others: int
    scaled: int
    shapes: int


_FEW, _MANY = _Points(90, 40, 24, 6), _Points(43, 16, 10, 2)
"""Of few samples, and of so many that their lines lie upon each other: a test is below 3 kB."""
_UNSEEN = 0.001
_BAND_POINTS = 28
_MOST_WITH_INTERVALS = 6
_SMALL = (262, 150)
_FLATTEST, _HIGHEST = 88, 190


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """A group with what its plots need.

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
        """Number of a test on the page."""
        return self.tests.number[key_of(sample)]

    @property
    def points(self) -> _Points:
        """How many points its lines have."""
        return _FEW if len(self.group.samples) <= _MOST_WITH_INTERVALS else _MANY

    def colour(self, sample: Sample) -> str:
        """Class of the colour of a sample: that of its spool; of one spool, its own."""
        spools = list(dict.fromkeys(sample.specimen.spool for sample in self.group.samples))
        at = spools.index(sample.specimen.spool)
        if len(spools) == 1 and len(self.group.samples) <= _MOST_WITH_INTERVALS:
            at = [key_of(sample) for sample in self.group.samples].index(key_of(sample))
        return f"c{at % COLOURS}"


def group_panels(group: Group, stem: str, tests: PageTests) -> list[Plot]:
    """Make the plots of a group, as far as it has data for them.

    Parameters
    ----------
    group : with or without samples
    stem : its name in links
    tests : all of the page

    Returns
    -------
    Force against displacement first, if any sample has a curve; then the smaller ones.
    """
    drawn = _Drawn(
        group, stem, tests, group_scale(group, "displacement"), group_scale(group, "force")
    )
    makers = (_curves, _shapes, _moments, _scaled)
    return [plot for make in makers if (plot := make(drawn)) is not None]


def _curves(drawn: _Drawn) -> Plot | None:
    group, band = drawn.group, drawn.group.band
    if all(first_loading(sample) is None for sample in group.samples):
        return None
    low, high = seen(group, band)
    lines = [
        *band_lines(band, drawn.across.factor, drawn.up.factor),
        *_rejected(drawn),
        *(line for sample in group.samples for line in _sample_lines(drawn, sample)),
        *_windows(drawn),
        *mean_lines(band, drawn.across.factor, drawn.up.factor),
        *(line for sample in group.samples for line in _events(drawn, sample)),
    ]
    x = axis_over("Displacement", unit_words(drawn.across.unit), [line.x for line in lines])
    y = Axis("Force", unit_words(drawn.up.unit), low * drawn.up.factor, high * drawn.up.factor)
    title = f"Force against displacement of {count_of(len(group.samples), 'sample')}: {group.name}."
    return Plot(
        "curves", drawn.stem, title, _caption(group), x, y, lines, _keys(drawn, lines), (660, 240)
    )


def _sample_lines(drawn: _Drawn, sample: Sample) -> Iterator[Line]:
    """First loading, all else fainter, and the force as measured where slips were repaired."""
    test, colour = drawn.number(sample), drawn.colour(sample)
    first = first_loading(sample)
    others = [
        each
        for each in (*sample.loading, *sample.unloading)
        if each is not first and len(each.displacement)
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
    drawn: _Drawn, look: str, test: int, curve: tuple[SampleCurve, Floats], *, points: int
) -> Line:
    """A branch, with the force that is drawn of it, at so many points at the most."""
    branch, force = curve
    kept = bends(branch.displacement, force, points=points, tolerance=_UNSEEN)
    x, y = branch.displacement[kept] * drawn.across.factor, force[kept] * drawn.up.factor
    return Line(look, x, y, test)


def _rejected(drawn: _Drawn) -> Iterator[Line]:
    for test in drawn.tests.rejected(drawn.stem):
        first = first_loading(test.sample)
        if first is not None:
            yield _line(
                drawn, "rejected", test.number, (first, first.force), points=drawn.points.others
            )


def _windows(drawn: _Drawn) -> Iterator[Line]:
    """Straight lines over the windows that stiffnesses were read from."""
    for sample in drawn.group.samples:
        test = drawn.number(sample)
        parts: dict[str, list[FittedLine]] = {}
        for line in sample.lines:
            look = "segment" if line.result.startswith("segment") else "window"
            parts.setdefault(look, []).append(line)
        for look, lines in parts.items():
            x = np.array([part for line in lines for part in (line.start, line.stop, np.nan)])
            y = np.array([part for line in lines for part in (*_heights(line), np.nan)])
            yield Line(look, x * drawn.across.factor, y * drawn.up.factor, test)


def _heights(line: FittedLine) -> tuple[float, float]:
    return line.level, line.level + line.slope * (line.stop - line.start)


def _events(drawn: _Drawn, sample: Sample) -> Iterator[Line]:
    """Slips and failure of a test, each a dot on its curve."""
    first, test = first_loading(sample), drawn.number(sample)
    if first is None:
        return
    known = np.isfinite(first.displacement) & np.isfinite(first.force)
    places = np.array([slip.position for slip in sample.slips])
    if len(places) and known.any():
        height = np.interp(places, first.displacement[known], first.force[known])
        yield _dots("slip", places, height, drawn, test)
    at, force = value_of(sample, "failure_displacement"), value_of(sample, "failure_force")
    if at is not None and force is not None:
        yield _dots("failure", np.array([at]), np.array([force]), drawn, test)


def _dots(look: str, places: Floats, heights: Floats, drawn: _Drawn, test: int) -> Line:
    gaps = np.full(len(places), np.nan)
    x = np.column_stack([places, gaps]).ravel() * drawn.across.factor
    y = np.column_stack([heights, gaps]).ravel() * drawn.up.factor
    return Line(look, x, y, test)


def band_lines(
    band: Band, across: float, up: float, look: str = "", group: str = ""
) -> Iterator[Line]:
    """Draw the band of a mean curve as an area, and the edges of that for the whole curve.

    Parameters
    ----------
    band : without a band, nothing is drawn
    across, up : from SI to the units of the axes
    look : class of its colour
    group : stem, where several groups are in one plot
    """
    if band.n < 2 or not band.has_area:
        return
    kept = _thinned(band)
    x = band.displacement[kept] * across
    lower, upper = band.lower[kept] * up, band.upper[kept] * up
    known = np.isfinite(lower) & np.isfinite(upper)
    outline = np.concatenate([x[known], x[known][::-1]])
    edge = np.concatenate([upper[known], lower[known][::-1]])
    yield Line(f"band {look}".strip(), outline, edge, group=group, is_closed=True)
    if group:
        return
    for all_of_it in (band.lower_all, band.upper_all):
        if np.isfinite(all_of_it).any():
            yield Line("whole", x, all_of_it[kept] * up)


def _thinned(band: Band) -> Ints:
    """Points that all edges of a band are drawn with."""
    return bends(band.displacement, band.upper, points=_BAND_POINTS, tolerance=_UNSEEN)


def mean_lines(
    band: Band, across: float, up: float, look: str = "", group: str = ""
) -> Iterator[Line]:
    """Draw a mean curve, and of few curves its intervals at single displacements.

    Parameters
    ----------
    band, across, up, look, group : as for `band_lines`
    """
    if not len(band.displacement) or (band.n < 2 and not group):
        return  # the mean of one sample is that sample
    kept = bends(band.displacement, band.mean, points=_BAND_POINTS, tolerance=_UNSEEN)
    x, y = band.displacement[kept] * across, band.mean[kept] * up
    yield Line(f"mean {look}".strip(), x, y, group=group)
    marks = band.marks
    if len(marks):
        gaps = np.full(len(marks), np.nan)
        at = band.displacement[marks] * across
        ends = np.column_stack([band.lower[marks] * up, band.upper[marks] * up, gaps]).ravel()
        x = np.column_stack([at, at, gaps]).ravel()
        yield Line(f"interval {look}".strip(), x, ends, group=group)


def _keys(drawn: _Drawn, lines: Sequence[Line]) -> list[Key]:
    """What the plot shows: its tests one by one where they are few, else its spools."""
    group, looks = drawn.group, {line.look.partition(" ")[0] for line in lines}
    if len(group.samples) <= _MOST_WITH_INTERVALS:
        keys = [
            Key(
                f"curve {drawn.colour(sample)}",
                sample.test,
                "t",
                str(drawn.number(sample)),
            )
            for sample in group.samples
        ]
    else:
        keys = [
            Key(f"curve {colour}", f"spool {spool}", "class", colour)
            for spool, colour in {
                sample.specimen.spool: drawn.colour(sample) for sample in group.samples
            }.items()
        ]
    over = f"mean of {group.band.n} {group.band.over}"
    words = {"mean": over, **_WORDS}
    return keys + [Key(look, said, "class", look) for look, said in words.items() if look in looks]


_WORDS = {
    "interval": "95 % interval of the mean",
    "band": "95 % band, at one displacement",
    "whole": "95 % band, whole curve",
    "unloading": "unloading, later cycles",
    "window": "window of a stiffness",
    "segment": "fitted segments",
    "measured": "as measured, before repair of slips",
    "slip": "slip",
    "failure": "failure",
    "rejected": "rejected: in no mean",
}


def _caption(group: Group) -> str:
    """Why there is no band, if there is none."""
    return sentence(group.band.reason.message) if group.band.reason else ""


def _shapes(drawn: _Drawn) -> Plot | None:
    """Markers along the specimen at equal steps of the first loading, at equal scale."""
    own = [sample for sample in drawn.group.samples if sample.shapes is not None]
    lines = []
    for sample in own:
        shapes = sample.shapes
        if shapes is None or not len(shapes.deflection):
            continue
        places = shapes.positions[-drawn.points.shapes :]
        gaps = np.full((len(places), 1), np.nan)
        x = np.column_stack([places[:, :, 0], gaps]).ravel() * drawn.across.factor
        y = np.column_stack([places[:, :, 1], gaps]).ravel() * drawn.across.factor
        look = f"shape {drawn.colour(sample)}"
        lines.append(Line(look, x, y, drawn.number(sample)))
    if not lines:
        return None
    unit = unit_words(drawn.across.unit)
    x_axis = axis_over("Along the specimen", unit, [line.x for line in lines])
    y_axis = axis_over("Deflection", unit, [line.y for line in lines], room=0.06)
    width = _SMALL[0]
    height = min(max(even(width, x_axis, y_axis), _FLATTEST), _HIGHEST)
    x_axis, y_axis = _alike(x_axis, y_axis, width, height)
    steps = ", ".join(
        f"{way * drawn.across.factor:.2g}" for way in _steps(own)[-drawn.points.shapes :]
    )
    caption = f"Markers at {steps} {unit} of the first loading, both axes at one scale."
    title = f"Shapes of {count_of(len(lines), 'sample')} of {drawn.group.name}."
    size = (width, height)
    return Plot("shapes", drawn.stem, title, caption, x_axis, y_axis, lines, (), size)


def _steps(samples: Sequence[Sample]) -> Floats:
    most = max(
        (sample.shapes for sample in samples if sample.shapes), key=lambda own: len(own.deflection)
    )
    return np.round(most.deflection, 4) + 0.0


def _alike(x: Axis, y: Axis, width: int, height: int) -> tuple[Axis, Axis]:
    """Widen one of two axes until both have one scale."""
    scale = max((x.high - x.low) / width, (y.high - y.low) / height)
    return _widened(x, scale * width), _widened(y, scale * height)


def _widened(axis: Axis, span: float) -> Axis:
    middle = 0.5 * (axis.low + axis.high)
    return Axis(axis.name, axis.unit, middle - 0.5 * span, middle + 0.5 * span)


def _moments(drawn: _Drawn) -> Plot | None:
    """The measured law of each sample; of few its 95 % interval as an area."""
    display = display_of(drawn.group)
    across, up = shown_in("", "1/m", display), _moment_scale(display)
    own = [(sample, sample.law) for sample in drawn.group.samples if sample.law is not None]
    if not own:
        return None
    areas, lines = [], []
    for sample, law in own:
        colour, test = drawn.colour(sample), drawn.number(sample)
        x = law.curvature * across.factor
        if len(own) <= _MOST_WITH_INTERVALS:
            outline = np.concatenate([x, x[::-1]])
            edge = np.concatenate([law.moment_upper, law.moment_lower[::-1]]) * up.factor
            areas.append(Line(f"band {colour}", outline, edge, test, is_closed=True))
        lines.append(Line(f"curve {colour}", x, law.moment * up.factor, test))
    x_axis = axis_over("Curvature", unit_words(across.unit), [line.x for line in lines])
    y_axis = axis_over("Bending moment", unit_words(up.unit), [line.y for line in (*areas, *lines)])
    words = "Measured from the shapes, first loading."
    words += " Area: 95 % interval of each sample." if areas else ""
    title = f"Bending moment against curvature of {drawn.group.name}."
    every = [*areas, *lines]
    return Plot("moment", drawn.stem, title, words, x_axis, y_axis, every, (), _SMALL)


def _moment_scale(display: Mapping[str, str]) -> Scale:
    wanted = display.get("moment", "N*m")
    from labpipe.units import si_factor

    return Scale(1.0 / si_factor(wanted, "N*m"), wanted)


def _scaled(drawn: _Drawn) -> Plot | None:
    """Force over the peak force of each sample: what is left is no matter of strength."""
    band = drawn.group.band_scaled
    if band is None:
        return None
    lines = [
        *list(band_lines(band, drawn.across.factor, 1.0))[:1],
        *(line for sample in drawn.group.samples for line in _share(drawn, sample)),
        *mean_lines(band, drawn.across.factor, 1.0),
    ]
    if not lines:
        return None
    unit = unit_words(drawn.across.unit)
    x = axis_over("Displacement", unit, [line.x for line in lines])
    low, high = seen(drawn.group, band, is_scaled=True)
    y = Axis("Force / peak force", "", low, high)
    title = f"Force over peak force against displacement of {drawn.group.name}."
    words = "Force over the peak force of the same sample: what scatters here is not strength."
    return Plot("scaled", drawn.stem, title, words, x, y, lines, (), _SMALL)


def _share(drawn: _Drawn, sample: Sample) -> Iterator[Line]:
    first, peak = first_loading(sample), value_of(sample, "peak_force.1")
    if first is None or not peak:
        return
    kept = bends(first.displacement, first.force, points=drawn.points.scaled, tolerance=_UNSEEN)
    x, y = first.displacement[kept] * drawn.across.factor, first.force[kept] / peak
    yield Line(f"curve {drawn.colour(sample)}", x, y, drawn.number(sample))
