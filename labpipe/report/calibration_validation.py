"""What the model foretells of wires and lengths, beside what was measured."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.agreement import Prediction
from labpipe.records.arrays import Floats
from labpipe.report.calibration_look import (
    BAND,
    DEFLECTION,
    FORCE,
    MODEL,
    SMALL_FORCE,
    length_words,
    percent,
)
from labpipe.report.calibration_shown import ValidationGroup
from labpipe.report.concerns import sentences
from labpipe.report.page import (
    DOUBLE_COLUMN,
    GREY,
    Words,
    keyed_page,
    panel_grid,
    panel_letter,
    require_room,
)
from labpipe.report.thinning import extremes
from labpipe.report.wording import count_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_GROUPS = 6
"""Panels on a page."""
_COLUMNS, _ROW = 2, 66.0
_SAMPLE: dict[str, Any] = {"color": GREY, "linewidth": 0.45, "alpha": 0.75, "zorder": 2}
MEAN_LOOK: dict[str, Any] = {"color": "black", "linewidth": 1.3, "zorder": 4}
MEASURED_LOOK: dict[str, Any] = {"color": "#bbbbbb", "alpha": 0.7, "linewidth": 0, "zorder": 1}
MODEL_LOOK: dict[str, Any] = {
    "color": MODEL, "linewidth": 1.4, "linestyle": (0, (5, 1.4)), "zorder": 5
}  # fmt: skip
FORETOLD_LOOK: dict[str, Any] = {"color": BAND, "alpha": 0.5, "linewidth": 0, "zorder": 1.5}
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
    require_room(len(groups), MOST_GROUPS, "groups")
    words = Words("Measured and foretold first loadings", _note(groups), _keys(groups))
    page = keyed_page(
        words, height_mm=_ROW * math.ceil(len(groups) / _COLUMNS), width_mm=DOUBLE_COLUMN
    )
    panels = panel_grid(page, len(groups), columns=_COLUMNS)
    for letter, group, axes in zip("abcdef", groups, panels, strict=False):
        plot_group(group, axes)
        use = "calibrated" if group.is_calibrated else "foretold"
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
    band, x = group.band, DEFLECTION.factor * group.band.displacement
    if np.isfinite(band.lower).any():
        axes.fill_between(x, FORCE.factor * band.lower, FORCE.factor * band.upper, **MEASURED_LOOK)
    axes.plot(x, FORCE.factor * band.mean, **MEAN_LOOK)
    if group.prediction is not None:
        _draw_prediction(group.prediction, axes)
    axes.text(
        0.03, 0.98, agreement_words(group), transform=axes.transAxes, va="top", size=8, zorder=6,
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


def _draw_prediction(prediction: Prediction, axes: Axes) -> None:
    x = DEFLECTION.factor * prediction.deflection
    lower, upper = FORCE.factor * prediction.lower, FORCE.factor * prediction.upper
    axes.fill_between(x, lower, upper, **FORETOLD_LOOK)
    for edge in (lower, upper):
        axes.plot(x, edge, **_EDGE)
    axes.plot(x, FORCE.factor * prediction.force, **MODEL_LOOK)


def _lowest(group: ValidationGroup) -> float:
    """Lowest force of the mean and of the samples, in the display unit: noise is seen whole."""
    forces: list[Floats] = [group.band.mean, *(each.force for each in group.samples.values())]
    known = [each[np.isfinite(each)] for each in forces]
    return FORCE.factor * min((float(each.min()) for each in known if len(each)), default=0.0)


def _note(groups: Sequence[ValidationGroup]) -> str:
    """What the bands are of."""
    said = ["Grey band: the mean of all such samples by Student's t, n - 1 degrees of freedom."]
    if any(len(group.samples) < 2 for group in groups):
        said.append("One sample has no band.")
    foretold = sorted({group.foretold for group in groups if group.prediction is not None})
    for number in foretold:
        what = "one more sample" if number == 1 else f"the mean of {number} samples"
        of = ""
        if len(foretold) > 1:
            of = f" ({', '.join(_names(groups, number))})"
        said.append(f"Blue band: the model's for {what}{of}.")
    notes = {
        note.message: None
        for group in groups
        if group.prediction is not None
        for note in group.prediction.notes
    }
    return " ".join([*said, *(f"{text[:1].upper()}{text[1:]}." for text in notes)])


def _names(groups: Sequence[ValidationGroup], foretold: int) -> list[str]:
    return [
        f"{group.wire} {length_words(group.length)}"
        for group in groups
        if group.foretold == foretold and group.prediction is not None
    ]


def _keys(groups: Sequence[ValidationGroup]) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Artist] = [
        Line2D([], [], label="sample", **_SAMPLE),
        Line2D([], [], label="mean of samples", **MEAN_LOOK),
    ]
    if any(np.isfinite(group.band.lower).any() for group in groups):
        keys.append(Patch(label="95 % band of the mean", **MEASURED_LOOK))
    if any(group.prediction is not None for group in groups):
        keys.append(Line2D([], [], label="model", **MODEL_LOOK))
        keys.append(Patch(label="95 % band of the model", **FORETOLD_LOOK))
    return keys
