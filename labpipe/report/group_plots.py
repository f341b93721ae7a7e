"""Curves of a group: of all samples with mean and 95 % bands, and with their fitted lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Band, Group, Sample, SampleCurve
from labpipe.report.figure_page import (
    GREY,
    Look,
    PageTexts,
    area_key,
    keyed_page,
    line_key,
    line_looks,
    line_looks_of_fits,
    say,
)
from labpipe.report.issues import sentence
from labpipe.report.plot_thinning import bends
from labpipe.report.wording import (
    Scale,
    count_of,
    display_of,
    in_words,
    shown_in,
    unit_words,
    write_number,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


RED = "#b2182b"
POINTS, FAINT_POINTS = 120, 40
"""Points that a curve is drawn with at the most, so that a page of thirty tests is below 1 MB."""


def spool_looks(group: Group) -> dict[str, Look]:
    """Give each spool a colour, and a dash so that they differ on a grey print too."""
    spools = dict.fromkeys(sample.specimen.spool for sample in group.samples)
    return dict(zip(spools, line_looks(len(spools)), strict=True))


def group_scale(group: Group, quantity: str) -> Scale:
    """Display unit of displacement or force in a group."""
    return shown_in("", {"displacement": "m", "force": "N"}[quantity], display_of(group))


def count_words(group: Group) -> str:
    """Count what a group holds, such as ``6 samples from 2 spools``."""
    spools = {sample.specimen.spool for sample in group.samples}
    return f"{count_of(len(group.samples), 'sample')} from {count_of(len(spools), 'spool')}"


def group_page(
    group: Group, keys: Sequence[Artist], *, height_mm: float, note: str = "", columns: int = 3
) -> Figure:
    """Make the empty page of a group's figure, with the key below its title.

    Parameters
    ----------
    group : names the page
    keys : signs to explain
    height_mm : mm, without the lines of the key and of the footnote
    note : footnote, broken into lines here
    columns : of the key; as many as have room if 0
    """
    title = f"{group.name}  \u00b7  {group.protocol}  \u00b7  {count_words(group)}"
    return keyed_page(PageTexts(title, note, keys), height_mm=height_mm, columns=columns)


def thin(curve: SampleCurve, values: Floats, *, points: int = POINTS) -> tuple[Floats, Floats]:
    """Displacement and values of a curve at the points that are drawn.

    Parameters
    ----------
    curve : of a sample
    values : shape (n,), along it
    points : how many at the most; corners and steps are among them
    """
    kept = bends(curve.displacement, values, points=points)
    x: Floats = curve.displacement[kept]
    y: Floats = values[kept]
    return x, y


def first_loading(sample: Sample) -> SampleCurve | None:
    """The loading curve of the first cycle; None for a sample without any."""
    return next((curve for curve in sample.loading if len(curve.displacement)), None)


def value_of(sample: Sample, name: str) -> float | None:
    """A result of a sample by its name, in SI; None where it failed or was not asked for."""
    return next((result.value for result in sample.results if result.name == name), None)


def label_axes(group: Group, axes: Axes) -> None:
    """Write displacement and force with their display units at the axes."""
    axes.set_xlabel(group_scale(group, "displacement").label("Displacement"))
    axes.set_ylabel(group_scale(group, "force").label("Force"))


def finite_end(values: Floats) -> float:
    """Largest finite value; 0 where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0


_HEIGHT = 82.0
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
"""Look of an interval at one displacement."""
_ROOM = 0.5
"""Height left for a band above and below the curves, as a share of theirs."""
_ROOM_FOR_ALL, _MARGIN = 0.25, 0.04


def draw_curves(group: Group) -> Figure:
    """Draw force against displacement of all samples, with mean and bands.

    Parameters
    ----------
    group : an empty group, or one without curves, gets a page that says so
    """
    return _draw(group, group.band, is_scaled=False)


def draw_scaled(group: Group) -> Figure:
    """Draw force / peak force of each sample against displacement, with mean and bands."""
    band = group.band if group.band_scaled is None else group.band_scaled
    return _draw(group, band, is_scaled=True)


def _draw(group: Group, band: Band, *, is_scaled: bool) -> Figure:
    if all(first_loading(sample) is None for sample in group.samples):
        page = group_page(group, [], height_mm=40.0)
        what = "No sample in this group." if not group.samples else "No sample has a curve."
        say(page.subplots(), what)
        return page
    note = _reason(band)
    page = group_page(group, _keys(group, band, is_scaled=is_scaled), height_mm=_HEIGHT, note=note)
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
    group : colour and dash tell its spools apart
    axes : to draw on
    is_scaled : divide the force of each sample by its peak force, first loading only
    """
    looks = spool_looks(group)
    across = group_scale(group, "displacement").factor
    for sample in group.samples:
        look = looks[sample.specimen.spool]
        up = _factor(group, sample, is_scaled=is_scaled)
        for curve in () if is_scaled else _others(sample):
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
    band : of few curves its intervals are drawn where it has them; without bands only its mean,
        without a mean nothing
    axes : to draw on
    is_scaled : its forces are shares of the peak force
    """
    if band.n < 2 or not len(band.displacement):
        return  # the mean of one sample is that sample
    kept = np.unique(
        np.linspace(0, len(band.displacement) - 1, _BAND_POINTS).round().astype(np.int64)
    )
    across = group_scale(group, "displacement").factor
    x = band.displacement[kept] * across
    up = 1.0 if is_scaled else group_scale(group, "force").factor
    axes.plot(x, band.mean[kept] * up, **_MEAN)
    plot_marks(band, axes, across, up, color="black")
    if band.has_area:
        axes.fill_between(x, band.lower[kept] * up, band.upper[kept] * up, **_POINTWISE)
        for edge in (band.lower_all, band.upper_all):
            if _is_known(edge):
                axes.plot(x, edge[kept] * up, **_ALL)
    if _is_known(band.lower):
        low, high = seen(group, band, is_scaled=is_scaled)
        axes.set_ylim(low * up, high * up)


def plot_marks(
    band: Band, axes: Axes, across: float, up: float, *, color: str, shift: float = 0.0
) -> None:
    """Draw the intervals of the mean of few curves, where it has them.

    Parameters
    ----------
    band : with or without intervals
    axes : to draw on
    across, up : from SI to the units of the axes
    color : of the lines
    shift : m, to the right, so that groups do not lie upon each other
    """
    for at in band.marks:
        x = across * (band.displacement[at] + shift)
        axes.plot([x, x], [up * band.lower[at], up * band.upper[at]], color=color, **MARK)


def interval_key(words: str, *, color: str) -> Artist:
    """Sample of an interval as it is drawn, upright with two ends, for a key."""
    from matplotlib.path import Path

    ends = [(-0.5, -1.0), (0.5, -1.0), (0.0, -1.0), (0.0, 1.0), (-0.5, 1.0), (0.5, 1.0)]
    beam = Path(ends, [1, 2, 1, 2, 1, 2])
    look = {"marker": beam, "markersize": 8, "linestyle": "", "markeredgewidth": 1.0}
    return line_key(words, color=color, markerfacecolor="none", **look)


def seen(group: Group, band: Band, *, is_scaled: bool = False) -> tuple[float, float]:
    """Find the forces that the figure of the curves shows, in N or as a share of the peak force.

    Parameters
    ----------
    group : its curves are seen in full
    band : its pointwise band is seen, up to half the height of the curves beyond them; its
        simultaneous band is seen in full where a quarter is enough, and else as far as it is there
    is_scaled : forces are shares of the peak force
    """
    forces = [
        float(edge) * (_share(sample) if is_scaled else 1.0)
        for sample in group.samples
        for curve in (sample.loading[:1] if is_scaled else (*sample.loading, *sample.unloading))
        if np.isfinite(curve.force).any()
        for edge in (np.nanmin(curve.force), np.nanmax(curve.force))
    ]
    known = [force for force in forces if np.isfinite(force)] or [0.0, 1.0]
    low, high = _widened(min(known), max(known), band.lower, band.upper, _ROOM)
    whole = _widened(low, high, band.lower_all, band.upper_all, np.inf)
    if whole[1] - whole[0] <= (1.0 + _ROOM_FOR_ALL) * (high - low):
        low, high = whole
    margin = _MARGIN * (high - low) or 1.0
    return low - margin, high + margin


def _widened(
    low: float, high: float, lower: Floats, upper: Floats, most: float
) -> tuple[float, float]:
    """A range made wide enough for a band, by a share of itself at the most."""
    if not _is_known(lower) or high == low:
        return low, high
    room = most * (high - low)
    return (
        max(min(low, float(np.nanmin(lower))), low - room),
        min(max(high, float(np.nanmax(upper))), high + room),
    )


def _factor(group: Group, sample: Sample, *, is_scaled: bool) -> float:
    if not is_scaled:
        return group_scale(group, "force").factor
    return _share(sample)


def _share(sample: Sample) -> float:
    """What a force is multiplied with to be a share of the peak force; NaN without one."""
    peak = value_of(sample, _PEAK)
    return 1.0 / peak if peak else float("nan")


def _mark_failure(sample: Sample, axes: Axes, across: float, up: float, *, size: float) -> None:
    at, force = value_of(sample, "failure_displacement"), value_of(sample, "failure_force")
    if at is not None and force is not None:
        axes.plot(at * across, force * up, "x", color=RED, markersize=size, zorder=5)


def _is_known(edge: Floats) -> bool:
    return bool(np.isfinite(edge).any())


def _reason(band: Band) -> str:
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
            keys.append(area_key("95 % band, point by point", **_POINTWISE))
        elif len(band.marks):
            keys.append(interval_key("95 % interval of the mean", color="black"))
        if _is_known(band.lower_all):
            keys.append(line_key("95 % band, whole curve", **_ALL))
    faint = "" if is_scaled else _faint_words(group)
    if faint:
        keys.append(line_key(faint, color=GREY, alpha=_FAINT))
    if any(value_of(sample, "failure_force") is not None for sample in group.samples):
        keys.append(line_key("failure", color=RED, marker="x", linestyle=""))
    return keys


def _faint_words(group: Group) -> str:
    """What is drawn of the samples beside their first loading."""
    unloading = any(sample.unloading for sample in group.samples)
    later = any(len(sample.loading) > 1 for sample in group.samples)
    return ", ".join(["unloading"] * unloading + ["later cycles"] * later)


def _others(sample: Sample) -> list[SampleCurve]:
    first = first_loading(sample)
    return [curve for curve in (*sample.loading, *sample.unloading) if curve is not first]


_LINES_HEIGHT = 82.0
_CURVES = "#9a9a9a"
_BEYOND = 1.5
"""How far the axis goes on behind the last window, in lengths up to its end."""


def draw_lines(group: Group) -> Figure:
    """Draw curves in grey on their windows in colour, segments dotted, with the slopes in the key.

    Parameters
    ----------
    group : one with lines
    """
    page = group_page(group, _line_keys(group), height_mm=_LINES_HEIGHT, columns=1)
    axes = page.subplots()
    plot_lines(group, axes)
    label_axes(group, axes)
    return page


def has_lines(group: Group) -> bool:
    """Tell whether any sample has a fitted line to draw."""
    return any(sample.lines for sample in group.samples)


def plot_lines(group: Group, axes: Axes) -> None:
    """Draw each sample up to a little beyond its windows, and its lines.

    Parameters
    ----------
    group : lines of one result have one look
    axes : to draw on
    """
    looks = line_looks_of_fits(_names_of_lines(group))
    across = group_scale(group, "displacement").factor
    up = group_scale(group, "force").factor
    end = _BEYOND * max(line.stop for sample in group.samples for line in sample.lines)
    for sample in group.samples:
        curve = first_loading(sample)
        if curve is not None:
            seen = np.where(curve.displacement <= end, curve.force, np.nan)
            x, y = thin(curve, seen)
            axes.plot(x * across, y * up, color=_CURVES, linewidth=0.5, zorder=3)
        for line in sample.lines:
            ends = np.array([line.start, line.stop])
            height = line.level + line.slope * (ends - line.start)
            axes.plot(ends * across, height * up, **looks[line.result])


def _names_of_lines(group: Group) -> list[str]:
    return [line.result for sample in group.samples for line in sample.lines]


def _line_keys(group: Group) -> list[Artist]:
    looks = line_looks_of_fits(_names_of_lines(group))
    return [line_key(_slope(group, name), **look) for name, look in looks.items()]


def _slope(group: Group, name: str) -> str:
    """Name of a line and its mean slope with the interval."""
    number = next((number for number in group.numbers if number.name == name), None)
    if number is None or number.mean is None:
        return in_words(name)
    shown = shown_in(name, number.unit, display_of(group))
    mean = number.mean.chosen
    words = write_number(mean.mean, mean.interval, shown.factor, apart=mean.apart).text
    over = "samples" if number.mean.is_pooled else "spool means"
    of = f", mean of {mean.n} {over}" if mean.n > 1 else ""
    return f"{in_words(name)}: {words} {unit_words(shown.unit)}{of}"
