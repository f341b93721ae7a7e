"""Curves, fitted lines, shapes and laws of a group's samples, with mean and 95 % bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Band, DrawnShapes, Group, Sample, SampleCurve
from labpipe.report.figure_page import (
    GREY,
    Look,
    PageTexts,
    area_key,
    keyed_page,
    line_key,
    line_looks,
    line_looks_of_fits,
    step_colours,
    write_reason,
)
from labpipe.report.issues import sentence
from labpipe.report.plot_thinning import simplify_line
from labpipe.report.wording import (
    Scale,
    as_label,
    count_of,
    display_of,
    place_of,
    rounded,
    shown_in,
    unit_words,
    write_number,
)
from labpipe.units import si_factor

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


RED = "#b2182b"
POINTS, FAINT_POINTS = 120, 40
"""Largest numbers of points of a curve, so that a page of thirty tests is below 1 MB."""


def spool_looks(group: Group) -> dict[str, Look]:
    """Give each spool a colour and a dash that also differ in grey."""
    spools = dict.fromkeys(sample.specimen.spool for sample in group.samples)
    return dict(zip(spools, line_looks(len(spools)), strict=True))


def group_scale(group: Group, quantity: str) -> Scale:
    """Return the display unit of displacement or force in a group."""
    return shown_in("", {"displacement": "m", "force": "N"}[quantity], display_of(group))


def count_words(group: Group) -> str:
    """Count samples and spools of a group, such as ``6 samples from 2 spools``."""
    spools = {sample.specimen.spool for sample in group.samples}
    return f"{count_of(len(group.samples), 'sample')} from {count_of(len(spools), 'spool')}"


def group_page(
    group: Group, keys: Sequence[Artist], *, height_mm: float, note: str = "", columns: int = 3
) -> Figure:
    """Make the empty page of a group's figure, with the key below its title.

    Parameters
    ----------
    group : names the page
    keys : lines and signs to explain
    height_mm : mm, without the lines of the key and of the footnote
    note : footnote, broken into lines here
    columns : of the key; as many as fit if 0
    """
    title = f"{group.name}  \u00b7  {group.protocol}  \u00b7  {count_words(group)}"
    return keyed_page(PageTexts(title, note, keys), height_mm=height_mm, columns=columns)


def thin(curve: SampleCurve, values: Floats, *, points: int = POINTS) -> tuple[Floats, Floats]:
    """Return displacement and values of a curve at the drawn points.

    Parameters
    ----------
    curve : of a sample
    values : shape (n,), along it
    points : at most; corners and steps are included
    """
    rows = simplify_line(curve.displacement, values, points=points)
    x: Floats = curve.displacement[rows]
    y: Floats = values[rows]
    return x, y


def first_loading(sample: Sample) -> SampleCurve | None:
    """Return the loading curve of the first cycle; None for a sample without curves."""
    return next((curve for curve in sample.loading if len(curve.displacement)), None)


def value_of(sample: Sample, name: str) -> float | None:
    """Return a result of a sample by its name, in SI; None if it is missing or failed."""
    return next((result.value for result in sample.results if result.name == name), None)


def label_axes(group: Group, axes: Axes) -> None:
    """Write displacement and force with their display units at the axes."""
    axes.set_xlabel(group_scale(group, "displacement").label("Displacement"))
    axes.set_ylabel(group_scale(group, "force").label("Force"))


def finite_end(values: Floats) -> float:
    """Return the largest finite value; 0 without finite values."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0


_MEAN: dict[str, Any] = {"color": "black", "linewidth": 1.5, "zorder": 4}
_POINTWISE: dict[str, Any] = {"color": "black", "alpha": 0.16, "linewidth": 0, "zorder": 1}
_ALL: dict[str, Any] = {
    "color": "black", "linewidth": 0.6, "linestyle": (0, (3, 1.5)), "zorder": 3
}  # fmt: skip
_FAINT = 0.28
_PEAK = "peak_force.1"
_BAND_POINTS = 80
MARK: dict[str, Any] = {
    "linewidth": 1.0, "marker": "_", "markersize": 6, "markeredgewidth": 1.0, "zorder": 4
}  # fmt: skip
"""Style of an interval at one displacement."""


def draw_curves(group: Group) -> Figure:
    """Draw force against displacement of all samples, with mean and bands.

    Parameters
    ----------
    group : an empty group, or one without curves, gets a page that says so
    """
    return _draw_page(group, group.band, is_scaled=False)


def draw_scaled(group: Group) -> Figure:
    """Draw force / peak force of each sample against displacement, with mean and bands."""
    band = group.band if group.band_scaled is None else group.band_scaled
    return _draw_page(group, band, is_scaled=True)


def _draw_page(group: Group, band: Band, *, is_scaled: bool) -> Figure:
    if all(first_loading(sample) is None for sample in group.samples):
        page = group_page(group, [], height_mm=40.0)
        what = "No sample in this group." if not group.samples else "No sample has a curve."
        write_reason(page.subplots(), what)
        return page
    note = _band_note(band)
    page = group_page(group, _keys(group, band, is_scaled=is_scaled), height_mm=82.0, note=note)
    axes = page.subplots()
    plot_samples(group, axes, is_scaled=is_scaled)
    plot_band(group, band, axes, is_scaled=is_scaled)
    label_axes(group, axes)
    if is_scaled:
        axes.set_ylabel("Force / peak force")
    return page


def plot_samples(group: Group, axes: Axes, *, is_scaled: bool = False) -> None:
    """Draw the samples: loading of the first cycle thin, unloading and later cycles faint.

    Parameters
    ----------
    group : its spools differ in colour and dash
    axes : to draw on
    is_scaled : divide the force of each sample by its peak force, first loading only
    """
    looks = spool_looks(group)
    across = group_scale(group, "displacement").factor
    for sample in group.samples:
        look = looks[sample.specimen.spool]
        up = _factor(group, sample, is_scaled=is_scaled)
        for curve in () if is_scaled else _other_curves(sample):
            x, y = thin(curve, curve.force, points=FAINT_POINTS)
            axes.plot(x * across, y * up, color=look.colour, alpha=_FAINT, linewidth=0.5)
        first = first_loading(sample)
        if first is not None:
            x, y = thin(first, first.force)
            axes.plot(x * across, y * up, color=look.colour, linestyle=look.dash, linewidth=0.7)
        _mark_failure(sample, axes, across, up, size=4.5 if len(group.samples) <= 12 else 2.5)


def plot_band(group: Group, band: Band, axes: Axes, *, is_scaled: bool = False) -> None:
    """Draw the mean curve, the pointwise band as an area, the simultaneous one as thin lines.

    Parameters
    ----------
    group : gives the display units
    band : of few curves with intervals instead; nothing is drawn without a mean
    axes : to draw on
    is_scaled : the forces are shares of the peak force
    """
    if band.n < 2 or not len(band.displacement):
        return  # the mean of one sample is that sample
    rows = np.unique(
        np.linspace(0, len(band.displacement) - 1, _BAND_POINTS).round().astype(np.int64)
    )
    across = group_scale(group, "displacement").factor
    x = band.displacement[rows] * across
    up = 1.0 if is_scaled else group_scale(group, "force").factor
    axes.plot(x, band.mean[rows] * up, **_MEAN)
    plot_marks(band, axes, across, up, color="black")
    if band.has_area:
        axes.fill_between(x, band.lower[rows] * up, band.upper[rows] * up, **_POINTWISE)
        for edge in (band.lower_all, band.upper_all):
            if _has_values(edge):
                axes.plot(x, edge[rows] * up, **_ALL)
    if _has_values(band.lower):
        low, high = force_limits(group, band, is_scaled=is_scaled)
        axes.set_ylim(low * up, high * up)


def plot_marks(
    band: Band, axes: Axes, across: float, up: float, *, color: str, shift: float = 0.0
) -> None:
    """Draw the intervals of the mean of few curves.

    Parameters
    ----------
    band : with or without intervals
    axes : to draw on
    across, up : from SI to the units of the axes
    color : of the lines
    shift : m, to the right, so that groups do not overlap
    """
    for at in band.marks:
        x = across * (band.displacement[at] + shift)
        axes.plot([x, x], [up * band.lower[at], up * band.upper[at]], color=color, **MARK)


def interval_key(label: str, *, color: str) -> Artist:
    """Return an entry of a key: an upright interval with two ends."""
    from matplotlib.path import Path

    ends = [(-0.5, -1.0), (0.5, -1.0), (0.0, -1.0), (0.0, 1.0), (-0.5, 1.0), (0.5, 1.0)]
    beam = Path(ends, [1, 2, 1, 2, 1, 2])
    look = {"marker": beam, "markersize": 8, "linestyle": "", "markeredgewidth": 1.0}
    return line_key(label, color=color, markerfacecolor="none", **look)


def force_limits(group: Group, band: Band, *, is_scaled: bool = False) -> tuple[float, float]:
    """Return the limits of force of the curves' figure, in N or as a share of the peak force.

    Parameters
    ----------
    group : its curves are shown in full
    band : its pointwise band is shown up to half the height of the curves beyond them, its
        simultaneous band in full if a quarter of the height is enough, else clipped
    is_scaled : forces are shares of the peak force
    """
    forces = [
        float(edge) * (_force_factor(sample) if is_scaled else 1.0)
        for sample in group.samples
        for curve in (sample.loading[:1] if is_scaled else (*sample.loading, *sample.unloading))
        if np.isfinite(curve.force).any()
        for edge in (np.nanmin(curve.force), np.nanmax(curve.force))
    ]
    finite = [force for force in forces if np.isfinite(force)] or [0.0, 1.0]
    low, high = _widened(min(finite), max(finite), band.lower, band.upper, 0.5)
    whole = _widened(low, high, band.lower_all, band.upper_all, np.inf)
    if whole[1] - whole[0] <= 1.25 * (high - low):
        low, high = whole
    margin = 0.04 * (high - low) or 1.0
    return low - margin, high + margin


def _widened(
    low: float, high: float, lower: Floats, upper: Floats, most: float
) -> tuple[float, float]:
    """Widen a range for a band, at most by a share of itself."""
    if not _has_values(lower) or high == low:
        return low, high
    room = most * (high - low)
    return (
        max(min(low, float(np.nanmin(lower))), low - room),
        min(max(high, float(np.nanmax(upper))), high + room),
    )


def _factor(group: Group, sample: Sample, *, is_scaled: bool) -> float:
    if not is_scaled:
        return group_scale(group, "force").factor
    return _force_factor(sample)


def _force_factor(sample: Sample) -> float:
    """Return the factor from force to share of the peak force; NaN without a peak force."""
    peak = value_of(sample, _PEAK)
    return 1.0 / peak if peak else float("nan")


def _mark_failure(sample: Sample, axes: Axes, across: float, up: float, *, size: float) -> None:
    at, force = value_of(sample, "failure_displacement"), value_of(sample, "failure_force")
    if at is not None and force is not None:
        axes.plot(at * across, force * up, "x", color=RED, markersize=size, zorder=5)


def _has_values(edge: Floats) -> bool:
    return bool(np.isfinite(edge).any())


def _band_note(band: Band) -> str:
    if not band.reason:
        return ""
    why = sentence(band.reason.message)
    if band.reason.code in {"few_curves", "two_curves"}:
        return why
    return f"No {'band' if len(band.displacement) else 'mean curve'}: {why}"


def _keys(group: Group, band: Band, *, is_scaled: bool) -> list[Artist]:
    keys: list[Artist] = [
        line_key(f"spool {spool}", color=look.colour, linestyle=look.dash)
        for spool, look in spool_looks(group).items()
    ]
    if band.n >= 2 and len(band.displacement):
        keys.append(line_key(f"mean of {band.n} {band.over}", **_MEAN))
        if band.has_area:
            keys.append(area_key("95 % band, pointwise", **_POINTWISE))
        elif len(band.marks):
            keys.append(interval_key("95 % interval of the mean", color="black"))
        if _has_values(band.lower_all):
            keys.append(line_key("95 % band, whole curve", **_ALL))
    faint = "" if is_scaled else _faint_words(group)
    if faint:
        keys.append(line_key(faint, color=GREY, alpha=_FAINT))
    if any(value_of(sample, "failure_force") is not None for sample in group.samples):
        keys.append(line_key("failure", color=RED, marker="x", linestyle=""))
    return keys


def _faint_words(group: Group) -> str:
    """Name the branches drawn besides the first loading."""
    unloading = any(sample.unloading for sample in group.samples)
    later = any(len(sample.loading) > 1 for sample in group.samples)
    return ", ".join(["unloading"] * unloading + ["later cycles"] * later)


def _other_curves(sample: Sample) -> list[SampleCurve]:
    first = first_loading(sample)
    return [curve for curve in (*sample.loading, *sample.unloading) if curve is not first]


def draw_lines(group: Group) -> Figure:
    """Draw grey curves with their fitted lines, and the slopes in the key.

    Parameters
    ----------
    group : one with lines
    """
    page = group_page(group, _line_keys(group), height_mm=82.0, columns=1)
    axes = page.subplots()
    plot_lines(group, axes)
    label_axes(group, axes)
    return page


def has_lines(group: Group) -> bool:
    """Tell whether any sample has a fitted line to draw."""
    return any(sample.lines for sample in group.samples)


def plot_lines(group: Group, axes: Axes) -> None:
    """Draw each sample to just beyond its windows, and its lines.

    Parameters
    ----------
    group : lines of one result have the same style
    axes : to draw on
    """
    looks = line_looks_of_fits(_names_of_lines(group))
    across = group_scale(group, "displacement").factor
    up = group_scale(group, "force").factor
    # of the end of the last window
    end = 1.5 * max(line.stop for sample in group.samples for line in sample.lines)
    for sample in group.samples:
        curve = first_loading(sample)
        if curve is not None:
            force = np.where(curve.displacement <= end, curve.force, np.nan)
            x, y = thin(curve, force)
            axes.plot(x * across, y * up, color="#9a9a9a", linewidth=0.5, zorder=3)
        for line in sample.lines:
            ends = np.array([line.start, line.stop])
            height = line.level + line.slope * (ends - line.start)
            axes.plot(ends * across, height * up, **looks[line.result])


def _names_of_lines(group: Group) -> list[str]:
    return [line.result for sample in group.samples for line in sample.lines]


def _line_keys(group: Group) -> list[Artist]:
    looks = line_looks_of_fits(_names_of_lines(group))
    return [line_key(_slope_label(group, name), **look) for name, look in looks.items()]


def _slope_label(group: Group, name: str) -> str:
    """Write the name of a line and its mean slope with the interval."""
    number = next((number for number in group.numbers if number.name == name), None)
    if number is None or number.mean is None:
        return as_label(name)
    unit = shown_in(name, number.unit, display_of(group))
    mean = number.mean.chosen
    slope = write_number(mean.mean, mean.interval, unit.factor, apart=mean.apart).text
    over = "samples" if number.mean.is_pooled else "spool means"
    of = f", mean of {mean.n} {over}" if mean.n > 1 else ""
    return f"{as_label(name)}: {slope} {unit_words(unit.unit)}{of}"


def has_shapes(group: Group) -> bool:
    """Return whether cameras tracked the shape of any sample."""
    return any(_is_tracked(sample.shapes) for sample in group.samples)


def _is_tracked(shapes: DrawnShapes | None) -> bool:
    return shapes is not None and bool(np.isfinite(shapes.positions).any())


def draw_group_shapes(group: Group) -> Figure:
    """Draw the shapes of all samples at their steps of deflection, at equal axis scale.

    Parameters
    ----------
    group : one with shapes; else the page says so
    """
    width_mm, min_height_mm, max_height_mm = 96.0, 26.0, 110.0
    margin = 0.05
    shapes = [sample.shapes for sample in group.samples if sample.shapes is not None]
    points = [shape.positions.reshape(-1, 2) for shape in shapes if _is_tracked(shape)]
    if not points:
        page = group_page(group, [], height_mm=40.0)
        write_reason(page.subplots(), "No sample has a shape measured by cameras.")
        return page
    every = np.concatenate(points)
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    edge = margin * float(high[0] - low[0])
    wide, tall = (high - low + 2.0 * edge).tolist()
    height = float(np.clip(width_mm * tall / wide, min_height_mm, max_height_mm)) + 14.0
    longest = max(shapes, key=lambda shape: len(shape.deflection))
    page = group_page(group, _step_keys(group, longest), height_mm=height, columns=0)
    axes = page.subplots()
    plot_group_shapes(group, axes)
    along = group_scale(group, "displacement")
    axes.set_xlim(*(along.factor * end for end in (low[0] - edge, high[0] + edge)))
    axes.set_ylim(*(along.factor * end for end in (low[1] - edge, high[1] + edge)))
    return page


def plot_group_shapes(group: Group, axes: Axes) -> None:
    """Draw a line with dots for each sample and step, coloured by step.

    Parameters
    ----------
    group : its spools differ in dash
    axes : to draw on
    """
    along = group_scale(group, "displacement")
    looks = spool_looks(group)
    for sample in group.samples:
        shapes = sample.shapes
        if shapes is None:
            continue
        dash = looks[sample.specimen.spool].dash
        for points, colour in zip(
            shapes.positions, step_colours(len(shapes.deflection)), strict=True
        ):
            x, y = points[np.isfinite(points).all(axis=1)].T * along.factor
            axes.plot(x, y, color=colour, linestyle=dash, linewidth=0.4, alpha=0.6)
            axes.plot(x, y, color=colour, linestyle="", marker="o", markersize=2.0)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlabel(along.label("Along the undeformed axis"))
    axes.set_ylabel(along.label("Deflection"))


def _step_keys(group: Group, shapes: DrawnShapes) -> list[Artist]:
    along = group_scale(group, "displacement")
    place = place_of(float(np.max(shapes.deflection, initial=0.0)), None, along.factor, digits=3)
    steps = [
        line_key(
            f"{rounded(along.factor * deflection, place)} {along.unit}", color=colour, marker="o"
        )
        for deflection, colour in zip(
            shapes.deflection.tolist(), step_colours(len(shapes.deflection)), strict=True
        )
    ]
    looks = spool_looks(group)
    spools = [
        line_key(f"spool {spool}", color=GREY, linestyle=look.dash) for spool, look in looks.items()
    ]
    return [*steps, *(spools if len(spools) > 1 else [])]


def has_laws(group: Group) -> bool:
    """Return whether moment against curvature was measured for any sample."""
    return any(sample.law is not None for sample in group.samples)


def draw_group_laws(group: Group) -> Figure:
    """Draw the measured moment-curvature laws of all samples, on first loading.

    Parameters
    ----------
    group : one with laws; else the page says so
    """
    if not has_laws(group):
        page = group_page(group, [], height_mm=40.0)
        write_reason(page.subplots(), "No sample has a measured moment-curvature law.")
        return page
    keys: list[Artist] = [
        line_key(f"spool {spool}", color=look.colour, linestyle=look.dash)
        for spool, look in spool_looks(group).items()
    ]
    if _with_bands(group):
        keys.append(area_key("95 % interval of one sample", color=GREY, **_BAND))
    page = group_page(group, keys, height_mm=82.0)
    plot_laws(group, page.subplots())
    return page


_BAND: dict[str, Any] = {"alpha": 0.18, "lw": 0}


def _with_bands(group: Group) -> bool:
    return sum(sample.law is not None for sample in group.samples) <= 3


def plot_laws(group: Group, axes: Axes) -> None:
    """Draw a line per sample, for few samples with its 95 % interval.

    Parameters
    ----------
    group : its spools differ in colour and dash
    axes : to draw on
    """
    display = display_of(group)
    across, up = (
        display_scale("1/m", display.get("curvature", "1/m")),
        display_scale("N*m", display.get("moment", "N*m")),
    )
    looks = spool_looks(group)
    for sample in group.samples:
        law, look = sample.law, looks[sample.specimen.spool]
        if law is None:
            continue
        x = across.factor * law.curvature
        if _with_bands(group):
            ends = [up.factor * end for end in (law.moment_lower, law.moment_upper)]
            axes.fill_between(x, ends[0], ends[1], color=look.colour, **_BAND)
        axes.plot(x, up.factor * law.moment, color=look.colour, linestyle=look.dash, linewidth=0.8)
    axes.set_xlabel(across.label("Curvature"))
    axes.set_ylabel(up.label("Bending moment"))


def display_scale(si_unit: str, unit: str) -> Scale:
    """Return the factor from an SI unit to a display unit, and that unit typeset."""
    return Scale(1.0 / si_factor(unit, si_unit), unit_words(unit))
