"""Measured curves, and curves from elsewhere, beside what the calibrated model predicts."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.group import Band
from labpipe.records.wire_calibration import CurveMatch, ExternalCurveComparison, Prediction
from labpipe.report.calibration_summary import (
    BAND,
    DEFLECTION,
    FORCE,
    MODEL,
    SMALL_FORCE,
    CalibrationReport,
    ValidationGroup,
    length_words,
    percent,
)
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    PageTexts,
    area_key,
    in_pages,
    keyed_page,
    line_key,
    panel_grid,
    panel_letter,
    require_room,
)
from labpipe.report.issues import sentences
from labpipe.report.plot_thinning import extremes, sure_and_doubtful
from labpipe.report.wording import count_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_PANELS = 6
"""Panels on a page."""
_COLUMNS, _ROW = 2, 66.0
_SAMPLE: dict[str, Any] = {"color": GREY, "linewidth": 0.45, "alpha": 0.75, "zorder": 2}
MEAN_LOOK: dict[str, Any] = {"color": "black", "linewidth": 1.3, "zorder": 4}
MEASURED_LOOK: dict[str, Any] = {"color": "#bbbbbb", "alpha": 0.7, "linewidth": 0, "zorder": 1}
MODEL_LOOK: dict[str, Any] = {
    "color": MODEL, "linewidth": 1.4, "linestyle": (0, (5, 1.4)), "zorder": 5
}  # fmt: skip
PREDICTED_LOOK: dict[str, Any] = {"color": BAND, "alpha": 0.5, "linewidth": 0, "zorder": 1.5}
"""The mean of samples, its band, the model, and its band."""
_EDGE: dict[str, Any] = {"color": MODEL, "linewidth": 0.5, "zorder": 3}
_BINS, _ROOM, _LINE = 100, 1.08, 48


def validation_figure(groups: Sequence[ValidationGroup]) -> Figure:
    """Draw force against deflection as measured and as the model has it, a panel for each group.

    Parameters
    ----------
    groups : 1 to 6, each of one wire and one length

    Raises
    ------
    ValueError
        If there is no group, or there are more than fit on a page.
    """
    require_room(len(groups), MOST_PANELS, "groups")
    has_model = any(group.prediction is not None for group in groups)
    keys = [line_key("sample", **_SAMPLE), *_keys(groups, has_model=has_model)]
    words = PageTexts("Measured and predicted first loadings", _note(groups), keys)
    page = keyed_page(
        words, height_mm=_ROW * math.ceil(len(groups) / _COLUMNS), width_mm=DOUBLE_COLUMN
    )
    panels = panel_grid(page, len(groups), columns=_COLUMNS)
    for letter, group, axes in zip("abcdef", groups, panels, strict=False):
        plot_group(group, axes)
        use = "calibrated" if group.is_calibrated else "predicted"
        panel_letter(axes, letter, f"{group.wire}, {length_words(group.length)}: {use}")
    return page


def plot_group(group: ValidationGroup, axes: Axes) -> None:
    """Draw samples, their mean with its band, and the model with its band.

    Parameters
    ----------
    group : of one wire and one length
    axes : to draw on; numbers of the agreement stand in its upper left corner, or why there is no
        prediction
    """
    for sample in group.samples.values():
        kept = extremes(sample.force, bins=_BINS)
        across = DEFLECTION.factor * sample.displacement[kept]
        axes.plot(across, FORCE.factor * sample.force[kept], **_SAMPLE)
    _draw_measured(group.band, axes)
    if group.prediction is not None:
        _draw_prediction(group.prediction, group.is_sure, axes)
    axes.text(
        0.03, 0.98, agreement_words(group), transform=axes.transAxes, va="top", zorder=6,
        linespacing=1.25,
    )  # fmt: skip
    axes.set_xlim(left=0.0)
    axes.set_ylim(min(0.0, _lowest(group)), _ROOM * axes.get_ylim()[1])
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def agreement_words(group: ValidationGroup) -> str:
    """Say in a few lines how well the model agrees with a group.

    Parameters
    ----------
    group : without errors of the model, what is measured and why there is no prediction
    """
    lines = [count_of(len(group.samples), "sample")]
    if not np.isfinite(group.band.lower).any():
        lines[0] += ", no band of the mean"
    errors = group.errors
    if errors is None:
        why = f"No prediction. {sentences([group.reason])}".strip()
        return "\n".join([*lines, *textwrap.wrap(why, _LINE)])
    rmse = SMALL_FORCE.factor * errors.rmse
    lines.append(
        f"RMSE {rmse:.3g} {SMALL_FORCE.unit}, {percent(errors.rmse_share)} of the largest force"
    )
    if math.isfinite(errors.inside):
        lines.append(f"{percent(errors.inside)} of the points inside the band")
    return "\n".join(lines)


def _draw_measured(band: Band, axes: Axes) -> None:
    x = DEFLECTION.factor * band.displacement
    if np.isfinite(band.lower).any():
        axes.fill_between(x, FORCE.factor * band.lower, FORCE.factor * band.upper, **MEASURED_LOOK)
    axes.plot(x, FORCE.factor * band.mean, **MEAN_LOOK)


def _draw_prediction(prediction: Prediction, is_sure: Flags, axes: Axes) -> None:
    x = DEFLECTION.factor * prediction.deflection
    lower, upper = FORCE.factor * prediction.lower, FORCE.factor * prediction.upper
    band_alpha = PREDICTED_LOOK["alpha"]
    for use, fade in sure_and_doubtful(is_sure):
        look = PREDICTED_LOOK | {"alpha": fade * band_alpha}
        axes.fill_between(x[use], lower[use], upper[use], **look)
        for edge in (lower, upper):
            axes.plot(x[use], edge[use], **_EDGE, alpha=fade)
        axes.plot(x[use], FORCE.factor * prediction.force[use], **MODEL_LOOK, alpha=fade)


def _lowest(group: ValidationGroup) -> float:
    """Lowest force of the mean and of the samples, in the display unit: noise is seen whole."""
    forces: list[Floats] = [group.band.mean, *(sample.force for sample in group.samples.values())]
    known = [force[np.isfinite(force)] for force in forces]
    return FORCE.factor * min((float(each.min()) for each in known if len(each)), default=0.0)


_LIGHTER = (
    "The model is lighter where the rim of the insulation is strained beyond what its straight line"
    " is taken to hold for: it is doubtful there."
)


def _note(groups: Sequence[ValidationGroup]) -> str:
    """What the bands are of."""
    said = ["Grey band: the mean of all such samples by Student's t, n - 1 degrees of freedom."]
    if any(len(group.samples) < 2 for group in groups):
        said.append("One sample has no band.")
    counts = sorted({group.mean_of for group in groups if group.prediction is not None})
    for number in counts:
        what = "one more sample" if number == 1 else f"the mean of {number} samples"
        of = ""
        if len(counts) > 1:
            of = f" ({', '.join(_names(groups, number))})"
        said.append(f"Blue band: the model's for {what}{of}.")
    if not all(group.is_sure.all() for group in groups):
        said.append(_LIGHTER)
    notes = {
        note.message: None
        for group in groups
        if group.prediction is not None
        for note in group.prediction.notes
    }
    return " ".join([*said, *(f"{text[:1].upper()}{text[1:]}." for text in notes)])


def _names(groups: Sequence[ValidationGroup], mean_of: int) -> list[str]:
    return [
        f"{group.wire} {length_words(group.length)}"
        for group in groups
        if group.mean_of == mean_of and group.prediction is not None
    ]


def _keys(groups: Sequence[ValidationGroup], *, has_model: bool) -> list[Artist]:
    """What there is of the mean of samples, its band, the model, and its band."""
    keys = [line_key("mean of samples", **MEAN_LOOK)] if groups else []
    if any(np.isfinite(group.band.lower).any() for group in groups):
        keys.append(area_key("95 % band of the mean", **MEASURED_LOOK))
    if has_model:
        keys.append(line_key("model", **MODEL_LOOK))
        keys.append(area_key("95 % band of the model", **PREDICTED_LOOK))
    return keys


_EXTERNAL_ROW = 70.0
_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
_MARKS = ("o", "s", "^", "D", "v")
_KEY_LETTERS, _MARKED = 44, 14
_FREE_ROWS, _ROOM_PER_ROW, _ROW_PER_ROW = 4, 0.06, 4.0
"""Rows of a key that fit above most curves, and the room that each further one takes."""


class ExternalPanel(NamedTuple):
    """What one pair of axes shows.

    Parameters
    ----------
    wire, length : name, m
    is_normal : the load stays normal to the undeformed axis, in the model too
    group : tests of that wire and length; None where there are none
    comparisons : external curves
    """

    wire: str
    length: float
    is_normal: bool
    group: ValidationGroup | None
    comparisons: tuple[ExternalCurveComparison, ...]

    @property
    def prediction(self) -> Prediction | None:
        """The model as far as the longest of the curves goes."""
        known = [
            comparison.prediction
            for comparison in self.comparisons
            if comparison.prediction is not None
        ]
        return max(known, key=lambda found: float(found.deflection[-1]), default=None)


def external_pages(report: CalibrationReport) -> list[Sequence[ExternalPanel]]:
    """Sort external curves by wire, length and load, and share them out to pages of `MOST_PANELS`.

    Parameters
    ----------
    report : of a calibration
    """
    found: dict[tuple[str, float, bool], list[ExternalCurveComparison]] = {}
    for comparison in report.comparisons:
        curve = comparison.curve
        key = (curve.wire, round(curve.length, 6), curve.is_normal)
        found.setdefault(key, []).append(comparison)
    groups = {(group.wire, round(group.length, 6)): group for group in report.groups}
    panels = [
        ExternalPanel(*key, groups.get(key[:2]), tuple(curves)) for key, curves in found.items()
    ]
    return in_pages(panels, MOST_PANELS)


def external_figure(panels: Sequence[ExternalPanel]) -> Figure:
    """Draw external curves beside tests and model, a panel for each wire, length and kind of load.

    Parameters
    ----------
    panels : 1 to 6

    Raises
    ------
    ValueError
        If there is no panel, or there are more than fit on a page.
    """
    require_room(len(panels), MOST_PANELS, "panels")
    rows = math.ceil(len(panels) / _COLUMNS)
    groups = [panel.group for panel in panels if panel.group is not None]
    keys = _keys(groups, has_model=any(panel.prediction is not None for panel in panels))
    words = PageTexts("External curves, tests and model", _external_note(panels), keys)
    row = _EXTERNAL_ROW + _ROW_PER_ROW * max(0, max(map(_key_rows, panels)) - _FREE_ROWS)
    page = keyed_page(words, height_mm=row * rows, width_mm=DOUBLE_COLUMN)
    drawn = panel_grid(page, len(panels), columns=_COLUMNS)
    for letter, panel, axes in zip("abcdef", panels, drawn, strict=False):
        plot_external(panel, axes)
        load = ", load normal to the axis" if panel.is_normal else ""
        panel_letter(axes, letter, f"{panel.wire}, {length_words(panel.length)}{load}")
    return page


def plot_external(panel: ExternalPanel, axes: Axes) -> None:
    """Draw the mean of the tests and the model with their bands, and external curves on top.

    Parameters
    ----------
    panel : of one wire, length and kind of load
    axes : to draw on; its key gives the RMSE of each external curve to the tests and to the model
    """
    if panel.group is not None:
        _draw_measured(panel.group.band, axes)
    model = panel.prediction
    if model is not None:
        across = DEFLECTION.factor * model.deflection
        edges = (FORCE.factor * model.lower_mean, FORCE.factor * model.upper_mean)
        axes.fill_between(across, *edges, **PREDICTED_LOOK)
        axes.plot(across, FORCE.factor * model.force, **MODEL_LOOK)
    lines = [_draw(comparison, number, axes) for number, comparison in enumerate(panel.comparisons)]
    axes.set_xlim(left=0.0)
    room = _ROOM + _ROOM_PER_ROW * max(0, _key_rows(panel) - _FREE_ROWS)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]), top=room * axes.get_ylim()[1])
    axes.legend(handles=lines, loc="upper left", handlelength=2.2, borderaxespad=0.4)
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def _key_rows(panel: ExternalPanel) -> int:
    """Lines of text in the key of a panel."""
    return sum(1 + match_words(comparison).count("\n") for comparison in panel.comparisons)


def _draw(each: ExternalCurveComparison, number: int, axes: Axes) -> Artist:
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


def match_words(each: ExternalCurveComparison) -> str:
    """Name an external curve and say in a line each how far it is from tests and from the model.

    Parameters
    ----------
    each : compared with both
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


def _external_note(panels: Sequence[ExternalPanel]) -> str:
    """What the bands are of, and which points were not compared."""
    said = []
    if any(panel.group is not None for panel in panels):
        said.append("Grey band: the mean of the tests by Student's t, n - 1 degrees of freedom.")
    if any(panel.prediction is not None for panel in panels):
        said.append("Blue band: the model's for the mean sample.")
    said.append("Peak: the largest force of what a curve is compared with, at the points compared.")
    notes = [
        note for panel in panels for comparison in panel.comparisons for note in comparison.notes
    ]
    if any(note.code == "external_curve_load" for note in notes):
        said.append("Where the load is normal to the axis, that of the tests is not.")
    for panel in panels:
        for comparison in panel.comparisons:
            told = [note for note in comparison.notes if note.code != "external_curve_load"]
            said += [f"'{comparison.curve.name}': {note.message}." for note in told]
    return " ".join(said)
