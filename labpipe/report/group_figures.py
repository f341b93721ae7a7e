"""Figures of a group: slips, and the list of all figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.curve import SlipDecision
from labpipe.records.group import Band, Group, Sample, SampleCurve
from labpipe.report.budget_figures import budgets_to_draw, draw_group_budgets
from labpipe.report.figure_page import GREY, line_key, panel_grid
from labpipe.report.group_dots import draw_dots, numbers_to_draw
from labpipe.report.group_plots import (
    RED,
    count_words,
    draw_curves,
    draw_group_laws,
    draw_group_shapes,
    draw_lines,
    draw_scaled,
    finite_end,
    first_loading,
    force_limits,
    group_page,
    group_scale,
    has_laws,
    has_lines,
    has_shapes,
    label_axes,
    spool_looks,
    thin,
)
from labpipe.report.saving import FigureToSave
from labpipe.report.wording import as_label, shortened

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_SLIP_PANELS = 8
_MEASURED: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (4, 1.6))}
_CUT: dict[str, Any] = {"color": GREY, "linewidth": 0.6, "linestyle": ":"}


def samples_with_slips(group: Group) -> list[Sample]:
    """Return the samples of a group that slipped and have a curve."""
    return [
        sample for sample in group.samples if sample.slips and first_loading(sample) is not None
    ]


def draw_slips(group: Group) -> Figure:
    """Draw a panel per sample that slipped, at most `MAX_SLIP_PANELS`.

    Parameters
    ----------
    group : one with slips; samples beyond the last panel are named in the footnote
    """
    max_title_length = 40
    height = 62.0
    panel_columns = 2
    samples = samples_with_slips(group)
    drawn, rest = samples[:MAX_SLIP_PANELS], samples[MAX_SLIP_PANELS:]
    rows = math.ceil(len(drawn) / panel_columns)
    note = (
        f"Not drawn, but in the list of slips: {', '.join(s.test for s in rest)}." if rest else ""
    )
    page = group_page(group, _slip_keys(drawn), height_mm=height * rows, note=note)
    panels = panel_grid(page, len(drawn), columns=panel_columns, sharey=True)
    for sample, axes in zip(drawn, panels, strict=True):
        plot_slips(group, sample, axes)
        axes.set_title(shortened(sample.test, max_title_length), loc="left")
        axes.label_outer(remove_inner_ticks=True)
    return page


def plot_slips(group: Group, sample: Sample, axes: Axes) -> None:
    """Draw the first loading of one sample, measured and processed, with its slips.

    Parameters
    ----------
    group : gives looks and display units
    sample : one with a curve
    axes : to draw on
    """
    curve = first_loading(sample)
    if curve is None:
        return
    across = group_scale(group, "displacement").factor
    up = group_scale(group, "force").factor
    if _is_repaired(sample):
        x, y = thin(curve, curve.as_measured)
        axes.plot(x * across, y * up, **_MEASURED)
    x, y = thin(curve, curve.force)
    axes.plot(x * across, y * up, color=spool_looks(group)[sample.specimen.spool].colour)
    for slip in sample.slips:
        height = _height(curve, slip.position)
        axes.axvline(slip.position * across, **_CUT)
        axes.plot(slip.position * across, height * up, "v", color=RED, zorder=5)
    label_axes(group, axes)


def _height(curve: SampleCurve, position: float) -> float:
    """Return the force of the curve at a slip, N; NaN outside the curve."""
    finite = np.isfinite(curve.force) & np.isfinite(curve.displacement)
    x, y = curve.displacement[finite], curve.force[finite]
    return float(np.interp(position, x, y, left=np.nan, right=np.nan)) if len(x) else math.nan


def _is_repaired(sample: Sample) -> bool:
    return any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips)


def _slip_keys(samples: list[Sample]) -> list[Artist]:
    keys: list[Artist] = [line_key("as processed")]
    if any(_is_repaired(sample) for sample in samples):
        keys.append(line_key("as measured", **_MEASURED))
    keys.append(line_key("slip", color=RED, marker="v", linestyle=""))
    return keys


def group_drawings(group: Group) -> Iterator[FigureToSave]:
    """List the figures for which a group has data; curves are always included.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    Curves, normalised curves, shapes, measured laws, slips, fitted lines, numbers and budgets, by
    names without that of the group.
    """
    about = f"{group.name}, {count_words(group)}"
    yield FigureToSave(
        "curves", partial(draw_curves, group), _curve_caption(group, group.band), _curve_alt(group)
    )
    if group.band_scaled is not None:
        caption = (
            "Force over the peak force of the same sample. The remaining scatter is not a scatter"
            " of strength. " + _curve_caption(group, group.band_scaled, is_scaled=True)
        )
        alt = f"Force over peak force against displacement of {about}."
        yield FigureToSave("scaled", partial(draw_scaled, group), caption, alt)
    if has_shapes(group):
        alt = f"Shapes of {about} at equal steps of deflection."
        yield FigureToSave("shapes", partial(draw_group_shapes, group), _SHAPES, alt)
    if has_laws(group):
        alt = f"Measured bending moment against curvature of {about}."
        yield FigureToSave("moment", partial(draw_group_laws, group), _LAWS, alt)
    if samples_with_slips(group):
        caption = (
            "Samples that slipped in their grips, first loading. Grey, dashed: measured force. In"
            " colour: force used for the numbers. Each triangle is a slip of the list above."
        )
        slipped = ", ".join(sample.test for sample in samples_with_slips(group))
        yield FigureToSave(
            "slips", partial(draw_slips, group), caption, f"Slips of {slipped} on their curves."
        )
    if has_lines(group):
        yield FigureToSave("lines", partial(draw_lines, group), _LINES, _line_alt(group))
    numbers = numbers_to_draw(group)
    if numbers:
        names = "; ".join(as_label(number.name) for number in numbers)
        yield FigureToSave(
            "numbers", partial(draw_dots, group), _DOTS, f"Each sample's {names}: {about}."
        )
    if budgets_to_draw(group):
        alt = f"Shares of the causes of the intervals of {about}."
        yield FigureToSave("budgets", partial(draw_group_budgets, group), _BUDGETS, alt)


_SHAPES = (
    "Shapes of the samples, measured by cameras at equal steps of the first loading, at equal axis"
    " scale; each colour is a deflection. Dots are markers, beside the axis of the sample, or"
    " sections of markers; for a clamped sample the first and the last dot are on the axis. Lines"
    " only connect the dots."
)
_LAWS = (
    "Bending moment against curvature on first loading, measured by load cell and cameras, one line"
    " per sample."
)
_LINES = (
    "Fitted straight lines over their windows, on the first loading of each sample (grey). The"
    " slopes in the key are those of the table of means. Broad and pale: windows set by the"
    " protocol. Dotted: two segments with a fitted break point. The curves continue beyond the"
    " right edge."
)
_BUDGETS = (
    "Contributions to the intervals; numbers per cycle: first cycle only. (a) One test: medians"
    " over the samples of the shares of its variance, scaled to 100 %. (b) Mean of the group, with"
    " half the width of its interval: more samples reduce the scatter, but not the hatched causes."
)
_DOTS = (
    "A dot and its 95 % interval for each sample, for the mean of each spool and for the reported"
    " mean (last row). In large groups the samples of a spool share a row, without intervals."
    " Intervals wider than the panel are clipped; the tables give their ends."
)


def _curve_caption(group: Group, band: Band, *, is_scaled: bool = False) -> str:
    text = (
        "Thin: first loading of each sample, up to failure if it failed. Faint: unloading and later"
        " cycles, if any."
    )
    mean = f" Thick: mean of {band.n} {band.members}, drawn only where all of them have data."
    if len(band.marks):
        cut = _clipping_text(group, band, is_scaled=is_scaled)
        return f"{text}{mean} Vertical: 95 % intervals of the mean at three displacements.{cut}"
    if not band.has_area:
        return f"{text} There is no band; the figure gives the reason."
    return (
        f"{text}{mean} Grey area: pointwise 95 % band of the mean."
        + _simultaneous_band_text(group, band, is_scaled=is_scaled)
        + _clipping_text(group, band, is_scaled=is_scaled)
    )


def _simultaneous_band_text(group: Group, band: Band, *, is_scaled: bool) -> str:
    """Describe the band of the whole curve, with its ends if the panel clips it."""
    if not np.isfinite(band.lower_all).any():
        return ""
    text = " Dashed: 95 % band of the whole mean curve."
    low, high = force_limits(group, band, is_scaled=is_scaled)
    if low <= np.nanmin(band.lower_all) and np.nanmax(band.upper_all) <= high:
        return text
    widest = int(np.nanargmax(band.upper_all - band.lower_all))
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    force, unit = (1.0, "") if is_scaled else (up.factor, f" {up.unit}")
    return (
        f"{text} It exceeds the panel because there are only {band.n} curves: at its widest, at"
        f" {across.factor * band.displacement[widest]:.3g} {across.unit}, it extends from"
        f" {force * band.lower_all[widest]:.3g} to {force * band.upper_all[widest]:.3g}{unit}."
    )


def _clipping_text(group: Group, band: Band, *, is_scaled: bool) -> str:
    low, high = force_limits(group, band, is_scaled=is_scaled)
    is_cut = np.nanmin(band.lower) < low or np.nanmax(band.upper) > high
    subject = "The grey area is" if band.has_area else "Intervals are"
    return f" {subject} wider than the panel and clipped." if is_cut else ""


def _curve_alt(group: Group) -> str:
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    text = f"Force against displacement: {group.name}, {count_words(group)}."
    if not len(group.band.displacement):
        return text
    far = across.factor * finite_end(group.band.displacement)
    top = up.factor * finite_end(group.band.mean)
    return f"{text} The mean reaches {top:.3g} {up.unit} and ends at {far:.3g} {across.unit}."


def _line_alt(group: Group) -> str:
    names = dict.fromkeys(line.result for sample in group.samples for line in sample.lines)
    names_text = "; ".join(as_label(name) for name in names)
    return f"Fitted lines on the curves of {group.name}: {names_text}."


def stems(names: Iterable[str]) -> list[str]:
    """Turn names of groups into stems of file names: ASCII, lower case, unique.

    Examples
    --------
    >>> stems(["A2, wire cantilever", "A2-wire-cantilever", "°"])
    ['a2-wire-cantilever', 'a2-wire-cantilever-2', 'group']
    """
    stems: list[str] = []
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "group"
        stem, number = plain, 1
        while stem in stems:
            number += 1
            stem = f"{plain}-{number}"
        stems.append(stem)
    return stems
