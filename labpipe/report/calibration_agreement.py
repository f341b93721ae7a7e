"""Measured and external curves compared with predictions of the calibrated model."""

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
    keyed_page,
    line_key,
    panel_grid,
    panel_letter,
    require_room,
    split_pages,
)
from labpipe.report.issues import sentences
from labpipe.report.plot_thinning import extremes, split_doubtful
from labpipe.report.wording import count_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_PANELS = 6
"""Panels per page."""
_COLUMNS = 2
_SAMPLE: dict[str, Any] = {"color": GREY, "linewidth": 0.45, "alpha": 0.75, "zorder": 2}
MEAN_LOOK: dict[str, Any] = {"color": "black", "linewidth": 1.3, "zorder": 4}
MEASURED_LOOK: dict[str, Any] = {"color": "#bbbbbb", "alpha": 0.7, "linewidth": 0, "zorder": 1}
MODEL_LOOK: dict[str, Any] = {
    "color": MODEL, "linewidth": 1.4, "linestyle": (0, (5, 1.4)), "zorder": 5
}  # fmt: skip
PREDICTED_LOOK: dict[str, Any] = {"color": BAND, "alpha": 0.5, "linewidth": 0, "zorder": 1.5}
"""The mean of samples, its band, the model, and its band."""
_EDGE: dict[str, Any] = {"color": MODEL, "linewidth": 0.5, "zorder": 3}
_HEADROOM = 1.08
"""Top of an axis, of the largest value."""


def validation_figure(groups: Sequence[ValidationGroup]) -> Figure:
    """Draw measured and modelled force against deflection, a panel per group.

    Parameters
    ----------
    groups : 1 to 6, each of one wire and one length

    Raises
    ------
    ValueError
        If there is no group, or there are more than fit on a page.
    """
    require_room(len(groups), MAX_PANELS, "groups")
    has_model = any(group.prediction is not None for group in groups)
    keys = [line_key("sample", **_SAMPLE), *_keys(groups, has_model=has_model)]
    texts = PageTexts("Measured and predicted first loadings", _note(groups), keys)
    page = keyed_page(
        texts, height_mm=66.0 * math.ceil(len(groups) / _COLUMNS), width_mm=DOUBLE_COLUMN
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
    axes : to draw on, with the agreement, or the reason for no prediction, in the upper left corner
    """
    for sample in group.samples.values():
        rows = extremes(sample.force, bins=100)
        across = DEFLECTION.factor * sample.displacement[rows]
        axes.plot(across, FORCE.factor * sample.force[rows], **_SAMPLE)
    _draw_measured(group.band, axes)
    if group.prediction is not None:
        _draw_prediction(group.prediction, group.is_sure, axes)
    axes.text(
        0.03, 0.98, agreement_words(group), transform=axes.transAxes, va="top", zorder=6,
        linespacing=1.25,
    )  # fmt: skip
    axes.set_xlim(left=0.0)
    axes.set_ylim(min(0.0, _lowest(group)), _HEADROOM * axes.get_ylim()[1])
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def agreement_words(group: ValidationGroup) -> str:
    """Describe in a few lines how well the model agrees with a group.

    Parameters
    ----------
    group : if the model has no errors, the text gives the reason for no prediction
    """
    lines = [count_of(len(group.samples), "sample")]
    if not np.isfinite(group.band.lower).any():
        lines[0] += ", no band of the mean"
    errors = group.errors
    if errors is None:
        why = f"No prediction. {sentences([group.reason])}".strip()
        return "\n".join([*lines, *textwrap.wrap(why, 48)])
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
    for use, fade in split_doubtful(is_sure):
        look = PREDICTED_LOOK | {"alpha": fade * band_alpha}
        axes.fill_between(x[use], lower[use], upper[use], **look)
        for edge in (lower, upper):
            axes.plot(x[use], edge[use], **_EDGE, alpha=fade)
        axes.plot(x[use], FORCE.factor * prediction.force[use], **MODEL_LOOK, alpha=fade)


def _lowest(group: ValidationGroup) -> float:
    """Return the lowest force of the mean and the samples, in the display unit."""
    forces: list[Floats] = [group.band.mean, *(sample.force for sample in group.samples.values())]
    finite = [force[np.isfinite(force)] for force in forces]
    return FORCE.factor * min(
        (float(values.min()) for values in finite if len(values)), default=0.0
    )


_LIGHTER = (
    "The model is drawn lighter where it is doubtful: there the strain at the rim of the insulation"
    " exceeds its assumed linear range."
)


def _note(groups: Sequence[ValidationGroup]) -> str:
    """Describe the bands."""
    lines = ["Grey band: mean of the samples, Student's t with n - 1 degrees of freedom."]
    if any(len(group.samples) < 2 for group in groups):
        lines.append("One sample has no band.")
    counts = sorted({group.mean_of for group in groups if group.prediction is not None})
    for number in counts:
        what = "one more sample" if number == 1 else f"the mean of {number} samples"
        of = ""
        if len(counts) > 1:
            of = f" ({', '.join(_names(groups, number))})"
        lines.append(f"Blue band: model, for {what}{of}.")
    if not all(group.is_sure.all() for group in groups):
        lines.append(_LIGHTER)
    notes = {
        note.message: None
        for group in groups
        if group.prediction is not None
        for note in group.prediction.notes
    }
    return " ".join([*lines, *(f"{text[:1].upper()}{text[1:]}." for text in notes)])


def _names(groups: Sequence[ValidationGroup], mean_of: int) -> list[str]:
    return [
        f"{group.wire} {length_words(group.length)}"
        for group in groups
        if group.mean_of == mean_of and group.prediction is not None
    ]


def _keys(groups: Sequence[ValidationGroup], *, has_model: bool) -> list[Artist]:
    """Return the keys of the mean, its band, the model and its band, where drawn."""
    keys = [line_key("mean of samples", **MEAN_LOOK)] if groups else []
    if any(np.isfinite(group.band.lower).any() for group in groups):
        keys.append(area_key("95 % band of the mean", **MEASURED_LOOK))
    if has_model:
        keys.append(line_key("model", **MODEL_LOOK))
        keys.append(area_key("95 % band of the model", **PREDICTED_LOOK))
    return keys


_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
_MARKS = ("o", "s", "^", "D", "v")
_FREE_KEY_ROWS = 4
"""Rows of a key that fit above most curves without more room."""


class ExternalPanel(NamedTuple):
    """Contents of one pair of axes.

    Parameters
    ----------
    wire, length : name, m
    is_normal : the load stays normal to the undeformed axis, also in the model
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
        """Return the prediction up to the end of the longest curve."""
        predictions = [
            comparison.prediction
            for comparison in self.comparisons
            if comparison.prediction is not None
        ]
        return max(predictions, key=lambda one: float(one.deflection[-1]), default=None)


def external_pages(report: CalibrationReport) -> list[Sequence[ExternalPanel]]:
    """Group external curves by wire, length and load, in pages of `MAX_PANELS` panels.

    Parameters
    ----------
    report : of a calibration
    """
    comparisons: dict[tuple[str, float, bool], list[ExternalCurveComparison]] = {}
    for comparison in report.comparisons:
        curve = comparison.curve
        key = (curve.wire, round(curve.length, 6), curve.is_normal)
        comparisons.setdefault(key, []).append(comparison)
    groups = {(group.wire, round(group.length, 6)): group for group in report.groups}
    panels = [
        ExternalPanel(*key, groups.get(key[:2]), tuple(curves))
        for key, curves in comparisons.items()
    ]
    return split_pages(panels, MAX_PANELS)


def external_figure(panels: Sequence[ExternalPanel]) -> Figure:
    """Draw external curves, tests and model, a panel per wire, length and kind of load.

    Parameters
    ----------
    panels : 1 to 6

    Raises
    ------
    ValueError
        If there is no panel, or there are more than fit on a page.
    """
    row_mm = 70.0
    require_room(len(panels), MAX_PANELS, "panels")
    rows = math.ceil(len(panels) / _COLUMNS)
    groups = [panel.group for panel in panels if panel.group is not None]
    keys = _keys(groups, has_model=any(panel.prediction is not None for panel in panels))
    texts = PageTexts("External curves, tests and model", _external_note(panels), keys)
    row = row_mm + 4.0 * max(0, max(map(_key_rows, panels)) - _FREE_KEY_ROWS)
    page = keyed_page(texts, height_mm=row * rows, width_mm=DOUBLE_COLUMN)
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
    lines = [_draw_comparison(one, number, axes) for number, one in enumerate(panel.comparisons)]
    axes.set_xlim(left=0.0)
    room = _HEADROOM + 0.06 * max(0, _key_rows(panel) - _FREE_KEY_ROWS)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]), top=room * axes.get_ylim()[1])
    axes.legend(handles=lines, loc="upper left", handlelength=2.2, borderaxespad=0.4)
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def _key_rows(panel: ExternalPanel) -> int:
    """Count the lines of text in the key of a panel."""
    return sum(1 + match_words(comparison).count("\n") for comparison in panel.comparisons)


def _draw_comparison(comparison: ExternalCurveComparison, number: int, axes: Axes) -> Artist:
    curve = comparison.curve
    (line,) = axes.plot(
        DEFLECTION.factor * curve.deflection,
        FORCE.factor * curve.force,
        color=_COLOURS[number % len(_COLOURS)],
        linewidth=0.9,
        marker=_MARKS[number % len(_MARKS)],
        markersize=3.0,
        markevery=max(1, len(curve.force) // 14),
        zorder=6,
        label=match_words(comparison),
    )
    return line


def match_words(match: ExternalCurveComparison) -> str:
    """Name an external curve and write its RMSE to the tests and to the model.

    Parameters
    ----------
    comparison : with tests and model
    """
    lines = textwrap.wrap(match.curve.name, 44)
    lines.append("no tests to compare" if match.tests is None else _rmse("tests", match.tests))
    label = "\n".join([*lines, _rmse("model", match.model)])
    return f" {label}" if label.startswith("_") else label  # matplotlib hides such a label


def _rmse(other: str, match: CurveMatch) -> str:
    if match.errors is None:
        return f"{other}: not compared"
    rmse = SMALL_FORCE.factor * match.errors.rmse
    return (
        f"{other}: RMSE {rmse:.3g} {SMALL_FORCE.unit}, {percent(match.errors.rmse_share)} of peak"
    )


def _external_note(panels: Sequence[ExternalPanel]) -> str:
    """Describe the bands and list points that were not compared."""
    lines = []
    if any(panel.group is not None for panel in panels):
        lines.append("Grey band: mean of the tests, Student's t with n - 1 degrees of freedom.")
    if any(panel.prediction is not None for panel in panels):
        lines.append("Blue band: model, for the mean sample.")
    lines.append("Peak: largest reference force at the compared points.")
    notes = [
        note for panel in panels for comparison in panel.comparisons for note in comparison.notes
    ]
    if any(note.code == "external_curve_load" for note in notes):
        lines.append("Where the load is normal to the axis, the load of the tests is not.")
    for panel in panels:
        for comparison in panel.comparisons:
            other_notes = [note for note in comparison.notes if note.code != "external_curve_load"]
            lines += [f"'{comparison.curve.name}': {note.message}." for note in other_notes]
    return " ".join(lines)
