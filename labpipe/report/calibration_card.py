"""The card of a calibration: data, model, residuals, profiles and verdicts on one page."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from labpipe.records.agreement import Prediction
from labpipe.records.calibration import Calibration, Identified, SourceCalibration
from labpipe.report.calibration_curves import (
    MODEL_BAND,
    MODEL_LINE,
    SAMPLE,
    looks_of,
    plot_loadings,
    plot_residuals,
)
from labpipe.report.calibration_look import SOURCE, length_words
from labpipe.report.calibration_profiles import INTERVAL, PRIOR, THRESHOLD, plot_profile
from labpipe.report.calibration_words import HEADS, parameter_row, sentences
from labpipe.report.page import DOUBLE_COLUMN, Words, keyed_page, panel_letter
from labpipe.report.wording import count_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHTS = (58.0, 34.0, 32.0)
"""mm, of the rows of panels without what is around them."""
_AROUND = 16.5
"""mm, of heading, numbers and label of a panel."""
_TALLEST, _LOWEST = 255.0, 0.7
"""mm, of panels and words upright on A4; share of `_HEIGHTS` left to panels above many words."""
_LINE = 3.7
"""mm, of the words."""
_LETTERS = 145
_LEFT = 0.012
_COLUMNS = (0.0, 0.24, 0.34, 0.53, 0.60)
_DOUBTFUL = {
    Identified.NOT,
    Identified.AT_BOUND,
    Identified.BY_PRIOR,
    Identified.AGAINST_PRIOR,
}
_POINTS_PER_MM = 72.0 / 25.4
_NO_BAND = "Drawn without the band of the model."
_RESIDUALS = "Residuals: every point faint, means over neighbouring points as lines."


def calibration_card(
    calibration: Calibration,
    source: SourceCalibration | None = None,
    *,
    predictions: Mapping[float, Prediction] | None = None,
) -> Figure:
    """Draw a calibration on one page, to be printed upright on A4.

    Parameters
    ----------
    calibration : of one wire
    source : what `method: source` makes of the same tests; left away if None
    predictions : what the model says at each length (m) of the tests, for its band

    Returns
    -------
    A page with (a) the first loadings and the model, (b) residuals, (c) residuals with the factor
    of each sample taken out, (d) to (f) profiles of the parameters, and numbers and verdicts in
    words.
    """
    rows = [HEADS, *(parameter_row(parameter) for parameter in calibration.parameters)]
    lines = [line for each in sentences(calibration, source) for line in _wrapped(each)]
    heights = _heights(len(rows) + len(lines) + 1.3)
    note = _RESIDUALS if predictions else f"{_RESIDUALS} {_NO_BAND}"
    page = keyed_page(
        Words(_title(calibration), note, _keys(calibration, source, predictions)),
        height_mm=sum(heights) + _AROUND * len(_HEIGHTS),
        width_mm=DOUBLE_COLUMN,
    )
    panels = page.subplot_mosaic("aaaaaa;bbbccc;ddeeff;wwwwww", height_ratios=heights)
    plot_loadings(calibration, panels["a"], predictions=predictions, source=source)
    plot_residuals(calibration, panels["b"])
    plot_residuals(calibration, panels["c"], has_own_factor=True)
    _draw_profiles(calibration, source, [panels[letter] for letter in "def"])
    _write(panels["w"], rows, lines)
    for letter, heading in zip("abc", _HEADINGS, strict=True):
        panel_letter(panels[letter], letter, heading)
    return page


_HEADINGS = (
    "first loadings",
    "residuals",
    "residuals, each sample by its own factor",
)
_OF_PARAMETERS = ("friction", "insulation", "copper")


def _title(calibration: Calibration) -> str:
    count = count_of(calibration.n_samples, "sample")
    return f"{calibration.wire}  ·  calibration of the wire model  ·  {count}"


def _heights(lines: float) -> tuple[float, ...]:
    """Heights of the panels and of so many lines of words, mm."""
    words = _LINE * lines
    room = _TALLEST - _AROUND * len(_HEIGHTS) - words
    share = min(max(room / sum(_HEIGHTS), _LOWEST), 1.0)
    return *(share * height for height in _HEIGHTS), words


def _draw_profiles(
    calibration: Calibration, source: SourceCalibration | None, panels: Sequence[Axes]
) -> None:
    elsewhere = None if source is None else source.radial_friction
    for number, (parameter, axes) in enumerate(zip(calibration.parameters, panels, strict=True)):
        plot_profile(parameter, axes, elsewhere=None if number else elsewhere)
        panel_letter(axes, "def"[number], _OF_PARAMETERS[number])
    panels[0].set_ylabel("Deviance")


def _wrapped(sentence: str) -> list[str]:
    return textwrap.wrap(sentence, _LETTERS, subsequent_indent="   ")


def _write(axes: Axes, rows: Sequence[Sequence[str]], lines: Sequence[str]) -> None:
    """Write a table and lines below one another, from the top of a panel."""
    axes.set_axis_off()
    for number, row in enumerate(rows):
        for at, text in zip(_COLUMNS, row, strict=True):
            is_bold = number == 0 or text in _DOUBTFUL
            _put(axes, text, at, number, weight="bold" if is_bold else "normal")
    for number, line in enumerate(lines, start=len(rows)):
        _put(axes, line, 0.0, number + 0.5)


def _put(axes: Axes, text: str, at: float, line: float, **look: Any) -> None:
    axes.annotate(
        text, (_LEFT + at, 1.0), (0.0, -line * _LINE * _POINTS_PER_MM), textcoords="offset points",
        xycoords=("figure fraction", "axes fraction"), va="top", size=8, annotation_clip=False,
        **look,
    ).set_in_layout(False)  # fmt: skip


def _keys(
    calibration: Calibration,
    source: SourceCalibration | None,
    predictions: Mapping[float, Prediction] | None,
) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Artist] = [
        Line2D(
            [], [], color=look.colour, linestyle=look.dash, label=_samples(calibration, length),
            **SAMPLE,
        )
        for length, look in looks_of(calibration).items()
    ]  # fmt: skip
    keys.append(Line2D([], [], label="model", **MODEL_LINE))
    if predictions:
        keys.append(Patch(label="its 95 % band, mean sample", **MODEL_BAND))
    if source is not None:
        keys.append(Line2D([], [], label="method: source", **SOURCE))
    if any(parameter.profile is not None for parameter in calibration.parameters):
        keys.append(Line2D([], [], label="95 % threshold", **THRESHOLD))
        keys.append(Patch(label="95 % interval", **INTERVAL))
    if any(parameter.conflict is not None for parameter in calibration.parameters):
        keys.append(Line2D([], [], label="prior alone", **PRIOR))
    return keys


def _samples(calibration: Calibration, length: float) -> str:
    count = sum(curve.length == length for curve in calibration.curves)
    return f"measured, {length_words(length)} ({count})"
