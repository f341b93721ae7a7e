"""Curves with slips: as measured against repaired, every slip marked."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.group import Group, Sample, SampleCurve
from labpipe.records.slips import SlipDecision
from labpipe.report.group_look import (
    RED,
    first_loading,
    group_page,
    group_scale,
    label_axes,
    spool_looks,
    thin,
)
from labpipe.report.page import GREY, panel_grid
from labpipe.report.wording import shortened

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
    from matplotlib.lines import Line2D

    keys: list[Artist] = [Line2D([], [], label="as processed")]
    if any(_is_repaired(sample) for sample in samples):
        keys.append(Line2D([], [], label="as measured", **_MEASURED))
    keys.append(Line2D([], [], color=RED, marker="v", linestyle="", label="slip"))
    return keys
