"""What the figures of a group share: looks of spools, display units, words, thinning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.group import Group, Sample, SampleCurve
from labpipe.report.numbers import display_of, shown_in
from labpipe.report.page import Look, Words, keyed_page, line_looks
from labpipe.report.thinning import bends
from labpipe.report.wording import Scale, count_of

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
    columns : of the key
    """
    title = f"{group.name}  \u00b7  {group.protocol}  \u00b7  {count_words(group)}"
    return keyed_page(Words(title, note, keys), height_mm=height_mm, columns=columns)


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
    return next((each.value for each in sample.results if each.name == name), None)


def label_axes(group: Group, axes: Axes) -> None:
    """Write displacement and force with their display units at the axes."""
    axes.set_xlabel(group_scale(group, "displacement").label("Displacement"))
    axes.set_ylabel(group_scale(group, "force").label("Force"))


def finite_end(values: Floats) -> float:
    """Largest finite value; 0 where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0
