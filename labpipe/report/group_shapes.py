"""Camera results of a group: shapes of its samples, and measured moment against curvature."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.figure_data import DrawnShapes
from labpipe.records.group import Group
from labpipe.report.figure_page import GREY, area_key, line_key, step_colours, write_reason
from labpipe.report.group_plots import group_page, group_scale, spool_looks
from labpipe.report.wording import Scale, display_of, place_of, rounded, unit_words
from labpipe.units import si_factor

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
        _display_scale("1/m", display.get("curvature", "1/m")),
        _display_scale("N*m", display.get("moment", "N*m")),
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


def _display_scale(si_unit: str, unit: str) -> Scale:
    return Scale(1.0 / si_factor(unit, si_unit), unit_words(unit))
