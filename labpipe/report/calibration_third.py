"""Curves from elsewhere beside the mean of the tests and the model: Fig. 3.12 of the source."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from labpipe.records.agreement import Prediction
from labpipe.records.comparison import CurveMatch, ThirdCurveComparison
from labpipe.report.calibration_look import (
    DEFLECTION,
    FORCE,
    SMALL_FORCE,
    length_words,
    percent,
)
from labpipe.report.calibration_shown import CalibrationReport, ValidationGroup
from labpipe.report.calibration_validation import (
    FORETOLD_LOOK,
    MEAN_LOOK,
    MEASURED_LOOK,
    MODEL_LOOK,
)
from labpipe.report.page import (
    DOUBLE_COLUMN,
    Words,
    in_pages,
    keyed_page,
    panel_grid,
    panel_letter,
    require_room,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PANELS = 6
"""Panels on a page."""
_THIRD_COLUMNS, _THIRD_ROW = 2, 70.0
_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
_MARKS = ("o", "s", "^", "D", "v")
_THIRD_ROOM, _KEY_LETTERS, _MARKED = 1.08, 44, 14
_FREE_ROWS, _ROOM_PER_ROW, _ROW_PER_ROW = 4, 0.06, 4.0
"""Rows of a key that fit above most curves, and the room that each further one takes."""


class ThirdPanel(NamedTuple):
    """What one pair of axes shows.

    Parameters
    ----------
    wire, length : name, m
    is_normal : the load stays normal to the undeformed axis, in the model too
    group : tests of that wire and length; None where there are none
    comparisons : third curves
    """

    wire: str
    length: float
    is_normal: bool
    group: ValidationGroup | None
    comparisons: tuple[ThirdCurveComparison, ...]

    @property
    def prediction(self) -> Prediction | None:
        """The model as far as the longest of the curves goes."""
        known = [each.prediction for each in self.comparisons if each.prediction is not None]
        return max(known, key=lambda found: float(found.deflection[-1]), default=None)


def third_pages(report: CalibrationReport) -> list[Sequence[ThirdPanel]]:
    """Sort third curves by wire, length and load, and share them out to pages of `MOST_PANELS`.

    Parameters
    ----------
    report : of a calibration
    """
    found: dict[tuple[str, float, bool], list[ThirdCurveComparison]] = {}
    for each in report.comparisons:
        curve = each.curve
        key = (curve.wire, round(curve.length, 6), curve.is_normal)
        found.setdefault(key, []).append(each)
    groups = {(group.wire, round(group.length, 6)): group for group in report.groups}
    panels = [ThirdPanel(*key, groups.get(key[:2]), tuple(curves)) for key, curves in found.items()]
    return in_pages(panels, MOST_PANELS)


def third_figure(panels: Sequence[ThirdPanel]) -> Figure:
    """Draw third curves beside tests and model, a panel for each wire, length and kind of load.

    Parameters
    ----------
    panels : 1 to 6

    Raises
    ------
    ValueError
        If there is no panel, or there are more than fit on a page.
    """
    require_room(len(panels), MOST_PANELS, "panels")
    rows = math.ceil(len(panels) / _THIRD_COLUMNS)
    words = Words(
        "Curves from elsewhere, tests and model", _third_note(panels), _third_keys(panels)
    )
    row = _THIRD_ROW + _ROW_PER_ROW * max(0, max(map(_key_rows, panels)) - _FREE_ROWS)
    page = keyed_page(words, height_mm=row * rows, width_mm=DOUBLE_COLUMN)
    drawn = panel_grid(page, len(panels), columns=_THIRD_COLUMNS)
    for letter, panel, axes in zip("abcdef", panels, drawn, strict=False):
        plot_third(panel, axes)
        load = ", load normal to the axis" if panel.is_normal else ""
        panel_letter(axes, letter, f"{panel.wire}, {length_words(panel.length)}{load}")
    return page


def plot_third(panel: ThirdPanel, axes: Axes) -> None:
    """Draw the mean of the tests and the model with their bands, and third curves on top.

    Parameters
    ----------
    panel : of one wire, length and kind of load
    axes : to draw on; its key gives the RMSE of each third curve to the tests and to the model
    """
    if panel.group is not None:
        band = panel.group.band
        across = DEFLECTION.factor * band.displacement
        if np.isfinite(band.lower).any():
            axes.fill_between(across, band.lower, band.upper, **MEASURED_LOOK)
        axes.plot(across, FORCE.factor * band.mean, **MEAN_LOOK)
    model = panel.prediction
    if model is not None:
        across = DEFLECTION.factor * model.deflection
        axes.fill_between(across, model.lower_mean, model.upper_mean, **FORETOLD_LOOK)
        axes.plot(across, FORCE.factor * model.force, **MODEL_LOOK)
    lines = [_draw(each, number, axes) for number, each in enumerate(panel.comparisons)]
    axes.set_xlim(left=0.0)
    room = _THIRD_ROOM + _ROOM_PER_ROW * max(0, _key_rows(panel) - _FREE_ROWS)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]), top=room * axes.get_ylim()[1])
    axes.legend(handles=lines, loc="upper left", fontsize=7, handlelength=2.2, borderaxespad=0.4)
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def _key_rows(panel: ThirdPanel) -> int:
    """Lines of text in the key of a panel."""
    return sum(1 + match_words(each).count("\n") for each in panel.comparisons)


def _draw(each: ThirdCurveComparison, number: int, axes: Axes) -> Artist:
    curve = each.curve
    (line,) = axes.plot(
        DEFLECTION.factor * curve.deflection,
        FORCE.factor * curve.force,
        color=_COLOURS[number % len(_COLOURS)],
        linewidth=0.9,
        marker=_MARKS[number % len(_MARKS)],
        markersize=3.0,
        markevery=max(1, len(curve.force) // _MARKED),
        zorder=6,
        label=match_words(each),
    )
    return line


def match_words(each: ThirdCurveComparison) -> str:
    """Name a third curve and say in a line each how far it is from tests and from the model.

    Parameters
    ----------
    each : held against both
    """
    lines = textwrap.wrap(each.curve.name, _KEY_LETTERS)
    lines.append("no tests to compare" if each.tests is None else _rmse("tests", each.tests))
    words = "\n".join([*lines, _rmse("model", each.model)])
    return f" {words}" if words.startswith("_") else words  # matplotlib hides such a label


def _rmse(other: str, found: CurveMatch) -> str:
    if found.errors is None:
        return f"{other}: not compared"
    rmse = SMALL_FORCE.factor * found.errors.rmse
    return (
        f"{other}: RMSE {rmse:.3g} {SMALL_FORCE.unit}, {percent(found.errors.rmse_share)} of peak"
    )


def _third_note(panels: Sequence[ThirdPanel]) -> str:
    """What the bands are of, and which points were not compared."""
    said = []
    if any(panel.group is not None for panel in panels):
        said.append("Grey band: the mean of the tests by Student's t, n - 1 degrees of freedom.")
    if any(panel.prediction is not None for panel in panels):
        said.append("Blue band: the model's for the mean sample.")
    said.append("Peak: the largest force of what a curve is compared with, at the points compared.")
    notes = [note for panel in panels for each in panel.comparisons for note in each.notes]
    if any(note.code == "third_curve_load" for note in notes):
        said.append("Where the load is normal to the axis, that of the tests is not.")
    for panel in panels:
        for each in panel.comparisons:
            told = [note for note in each.notes if note.code != "third_curve_load"]
            said += [f"'{each.curve.name}': {note.message}." for note in told]
    return " ".join(said)


def _third_keys(panels: Sequence[ThirdPanel]) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Artist] = []
    groups = [panel.group for panel in panels if panel.group is not None]
    if groups:
        keys.append(Line2D([], [], label="mean of tests", **MEAN_LOOK))
    if any(np.isfinite(group.band.lower).any() for group in groups):
        keys.append(Patch(label="95 % band of the mean", **MEASURED_LOOK))
    if any(panel.prediction is not None for panel in panels):
        keys.append(Line2D([], [], label="model", **MODEL_LOOK))
        keys.append(Patch(label="95 % band of the model", **FORETOLD_LOOK))
    return keys
