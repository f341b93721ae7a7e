"""The figures of a group: slips, which figures there are, and saving them."""

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
    draw_lines,
    draw_scaled,
    finite_end,
    first_loading,
    group_page,
    group_scale,
    has_lines,
    label_axes,
    seen,
    spool_looks,
    thin,
)
from labpipe.report.group_shapes import (
    draw_group_laws,
    draw_group_shapes,
    has_laws,
    has_shapes,
)
from labpipe.report.saving import FigureToSave
from labpipe.report.wording import in_words, shortened

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_PANELS = 8
_SLIP_COLUMNS = 2
_HEIGHT = 62.0
_LONGEST = 40
_MEASURED: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": (0, (4, 1.6))}
_CUT: dict[str, Any] = {"color": GREY, "linewidth": 0.6, "linestyle": ":"}


def with_slips(group: Group) -> list[Sample]:
    """Samples of a group that slipped and have a curve."""
    return [
        sample for sample in group.samples if sample.slips and first_loading(sample) is not None
    ]


def draw_slips(group: Group) -> Figure:
    """Draw a panel for each sample that slipped, at the most `MOST_PANELS`.

    Parameters
    ----------
    group : one with slips; samples beyond the last panel are named in the footnote
    """
    samples = with_slips(group)
    shown, rest = samples[:MOST_PANELS], samples[MOST_PANELS:]
    rows = math.ceil(len(shown) / _SLIP_COLUMNS)
    note = (
        f"Not drawn, but in the list of slips: {', '.join(s.test for s in rest)}." if rest else ""
    )
    page = group_page(group, _slip_keys(shown), height_mm=_HEIGHT * rows, note=note)
    panels = panel_grid(page, len(shown), columns=_SLIP_COLUMNS, sharey=True)
    for sample, axes in zip(shown, panels, strict=True):
        plot_slips(group, sample, axes)
        axes.set_title(shortened(sample.test, _LONGEST), loc="left")
        axes.label_outer(remove_inner_ticks=True)
    return page


def plot_slips(group: Group, sample: Sample, axes: Axes) -> None:
    """Draw the first loading of one sample: as measured dashed, as processed solid, slips marked.

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
    """Force of the curve at a slip, N; NaN outside of it."""
    known = np.isfinite(curve.force) & np.isfinite(curve.displacement)
    x, y = curve.displacement[known], curve.force[known]
    return float(np.interp(position, x, y, left=np.nan, right=np.nan)) if len(x) else math.nan


def _is_repaired(sample: Sample) -> bool:
    return any(slip.decision is SlipDecision.REPAIRED for slip in sample.slips)


def _slip_keys(samples: list[Sample]) -> list[Artist]:
    keys: list[Artist] = [line_key("as processed")]
    if any(_is_repaired(sample) for sample in samples):
        keys.append(line_key("as measured", **_MEASURED))
    keys.append(line_key("slip", color=RED, marker="v", linestyle=""))
    return keys


def drawings(group: Group) -> Iterator[FigureToSave]:
    """List the figures that a group has data for; the curves are always there.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    Curves, normalised curves, shapes, measured laws, slips, fitted lines, numbers, budgets, by
    names without
    that of the group.
    """
    about = f"{group.name}, {count_words(group)}"
    yield FigureToSave(
        "curves", partial(draw_curves, group), _curve_caption(group, group.band), _curve_alt(group)
    )
    if group.band_scaled is not None:
        caption = (
            "Force over the peak force of the same sample. What is left of the scatter is not"
            " a matter of strength. " + _curve_caption(group, group.band_scaled, is_scaled=True)
        )
        alt = f"Force over peak force against displacement of {about}."
        yield FigureToSave("scaled", partial(draw_scaled, group), caption, alt)
    if has_shapes(group):
        alt = f"Shapes of {about} at equal steps of deflection."
        yield FigureToSave("shapes", partial(draw_group_shapes, group), _SHAPES, alt)
    if has_laws(group):
        alt = f"Measured bending moment against curvature of {about}."
        yield FigureToSave("moment", partial(draw_group_laws, group), _LAWS, alt)
    if with_slips(group):
        caption = (
            "Samples that slid in their grips, first loading. Grey and dashed: the force as it was"
            " measured. In colour: the force that the numbers were taken from. Each triangle is a"
            " slip of the list above."
        )
        slipped = ", ".join(sample.test for sample in with_slips(group))
        yield FigureToSave(
            "slips", partial(draw_slips, group), caption, f"Slips of {slipped} on their curves."
        )
    if has_lines(group):
        yield FigureToSave("lines", partial(draw_lines, group), _LINES, _line_alt(group))
    numbers = numbers_to_draw(group)
    if numbers:
        names = "; ".join(in_words(number.name) for number in numbers)
        yield FigureToSave(
            "numbers", partial(draw_dots, group), _DOTS, f"Each sample's {names}: {about}."
        )
    if budgets_to_draw(group):
        alt = f"Shares of the causes of the intervals of {about}."
        yield FigureToSave("budgets", partial(draw_group_budgets, group), _BUDGETS, alt)


_SHAPES = (
    "Where cameras saw the samples at equal steps of the first loading, at equal axis scale; a"
    " colour is a deflection. Dots are markers, which lie beside the axis, or sections of markers;"
    " of a clamped sample the first and the last dot are on the axis. Lines only join them."
)
_LAWS = (
    "Bending moment against curvature on first loading, as measured by load cell and cameras, a"
    " line for each sample."
)
_LINES = (
    "Straight lines over the windows that they were fitted in, on the first loading of each"
    " sample (grey). The slopes in the key are those of the table of means. Broad and pale: the"
    " windows that the protocol sets. Dotted: the two segments whose break point was fitted too."
    " The curves go on beyond the right edge."
)
_BUDGETS = (
    "What the intervals are made of; of numbers of cycles, those of the first. (a) Of one test:"
    " medians of the shares of its variance over the samples, scaled to 100 %. (b) Of the mean of"
    " the group, with half the width of its interval: more samples make the scatter smaller, and"
    " not what is hatched."
)
_DOTS = (
    "A dot and its 95 % interval for each sample, for the mean of each spool and for the mean that"
    " holds (the last row). In large groups the samples of a spool share a row, without intervals."
    " Intervals that are wider than the panel are cut by its edge; the tables have their ends."
)


def _curve_caption(group: Group, band: Band, *, is_scaled: bool = False) -> str:
    words = (
        "Thin: the first loading of each sample, up to its failure where it failed. Faint:"
        " unloading and later cycles, where there are any."
    )
    mean = f" Thick: the mean of {band.n} {band.over}, drawn only where all of them have data."
    if len(band.marks):
        cut = _cut_words(group, band, is_scaled=is_scaled)
        return f"{words}{mean} Vertical: 95 % intervals of the mean at three displacements.{cut}"
    if not band.has_area:
        return f"{words} There is no band; the figure says why."
    return (
        f"{words}{mean} Grey area: holds the mean at any one displacement with 95 %."
        + _whole_words(group, band, is_scaled=is_scaled)
        + _cut_words(group, band, is_scaled=is_scaled)
    )


def _whole_words(group: Group, band: Band, *, is_scaled: bool) -> str:
    """Of the band for the whole curve, and how far it goes where the panel does not show it."""
    if not np.isfinite(band.lower_all).any():
        return ""
    words = " Dashed edges: hold the whole mean curve with 95 %."
    low, high = seen(group, band, is_scaled=is_scaled)
    if low <= np.nanmin(band.lower_all) and np.nanmax(band.upper_all) <= high:
        return words
    at = int(np.nanargmax(band.upper_all - band.lower_all))
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    force, unit = (1.0, "") if is_scaled else (up.factor, f" {up.unit}")
    return (
        f"{words} They leave the panel, as {band.n} curves say little about a whole one:"
        f" at {across.factor * band.displacement[at]:.3g} {across.unit}, where they are furthest"
        f" apart, they are at {force * band.lower_all[at]:.3g} and"
        f" {force * band.upper_all[at]:.3g}{unit}."
    )


def _cut_words(group: Group, band: Band, *, is_scaled: bool) -> str:
    low, high = seen(group, band, is_scaled=is_scaled)
    is_cut = np.nanmin(band.lower) < low or np.nanmax(band.upper) > high
    what = "The grey area is" if band.has_area else "Intervals are"
    return f" {what} wider than the panel and cut by its edge." if is_cut else ""


def _curve_alt(group: Group) -> str:
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    words = f"Force against displacement: {group.name}, {count_words(group)}."
    if not len(group.band.displacement):
        return words
    far = across.factor * finite_end(group.band.displacement)
    top = up.factor * finite_end(group.band.mean)
    return (
        f"{words} The mean reaches {top:.3g} {up.unit}; it is known up to {far:.3g} {across.unit}."
    )


def _line_alt(group: Group) -> str:
    names = dict.fromkeys(line.result for sample in group.samples for line in sample.lines)
    words = "; ".join(in_words(name) for name in names)
    return f"Fitted lines on the curves of {group.name}: {words}."


def stems(names: Iterable[str]) -> list[str]:
    """Turn names of groups into beginnings of file names: ASCII, lower case, each its own.

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
