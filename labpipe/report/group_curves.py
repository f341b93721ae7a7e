"""Curves of all samples of a group, their mean and its two 95 % bands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Band, Group, Sample, SampleCurve
from labpipe.report.concerns import sentence
from labpipe.report.group_look import (
    FAINT_POINTS,
    RED,
    first_loading,
    group_page,
    group_scale,
    label_axes,
    spool_looks,
    thin,
    value_of,
)
from labpipe.report.page import GREY, say

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHT = 82.0
_MEAN: dict[str, Any] = {"color": "black", "linewidth": 1.5, "zorder": 4}
_POINTWISE: dict[str, Any] = {"color": "black", "alpha": 0.16, "linewidth": 0, "zorder": 1}
_ALL: dict[str, Any] = {
    "color": "black", "linewidth": 0.6, "linestyle": (0, (3, 1.5)), "zorder": 3
}  # fmt: skip
_FAINT = 0.28
_PEAK = "peak_force.1"
_BAND_POINTS = 80
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
    band : without bands only its mean is drawn, without a mean nothing
    axes : to draw on
    is_scaled : its forces are shares of the peak force
    """
    if band.n < 2 or not len(band.displacement):
        return  # the mean of one sample is that sample
    kept = np.unique(
        np.linspace(0, len(band.displacement) - 1, _BAND_POINTS).round().astype(np.int64)
    )
    x = band.displacement[kept] * group_scale(group, "displacement").factor
    up = 1.0 if is_scaled else group_scale(group, "force").factor
    axes.plot(x, band.mean[kept] * up, **_MEAN)
    if _is_known(band.lower):
        axes.fill_between(x, band.lower[kept] * up, band.upper[kept] * up, **_POINTWISE)
        for edge in (band.lower_all, band.upper_all):
            if _is_known(edge):
                axes.plot(x, edge[kept] * up, **_ALL)
        low, high = seen(group, band, is_scaled=is_scaled)
        axes.set_ylim(low * up, high * up)


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
    if _is_known(band.lower):
        return why
    return f"No {'band' if len(band.displacement) else 'mean curve'}: {why}"


def _keys(group: Group, band: Band, *, is_scaled: bool) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Artist] = [
        Line2D([], [], color=look.colour, linestyle=look.dash, label=f"spool {spool}")
        for spool, look in spool_looks(group).items()
    ]
    if band.n >= 2 and len(band.displacement):
        keys.append(Line2D([], [], label=f"mean of {band.n} {band.over}", **_MEAN))
        if _is_known(band.lower):
            keys.append(Patch(label="95 % band, point by point", **_POINTWISE))
        if _is_known(band.lower_all):
            keys.append(Line2D([], [], label="95 % band, whole curve", **_ALL))
    faint = "" if is_scaled else _faint_words(group)
    if faint:
        keys.append(Line2D([], [], color=GREY, alpha=_FAINT, label=faint))
    if any(value_of(sample, "failure_force") is not None for sample in group.samples):
        keys.append(Line2D([], [], color=RED, marker="x", linestyle="", label="failure"))
    return keys


def _faint_words(group: Group) -> str:
    """What is drawn of the samples beside their first loading."""
    unloading = any(sample.unloading for sample in group.samples)
    later = any(len(sample.loading) > 1 for sample in group.samples)
    return ", ".join(["unloading"] * unloading + ["later cycles"] * later)


def _others(sample: Sample) -> list[SampleCurve]:
    first = first_loading(sample)
    return [curve for curve in (*sample.loading, *sample.unloading) if curve is not first]
