"""Figures of a calibration: its card on one page, agreement, shapes of a bent wire."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import (
    CalibratedParameter,
    Calibration,
    CurveAgreement,
    Identifiability,
    Prediction,
    Profile,
)
from labpipe.report.calibration_agreement import (
    MAX_PANELS,
    external_figure,
    external_pages,
    validation_figure,
)
from labpipe.report.calibration_summary import (
    BAND,
    DEFLECTION,
    DISPLAYS,
    FORCE,
    HEADS,
    MODEL,
    SMALL_FORCE,
    BentShape,
    CalibrationReport,
    length_looks,
    length_words,
    parameter_row,
    sentences,
    typeset,
)
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    WIDTH,
    Look,
    PageTexts,
    area_key,
    keyed_page,
    label_log_axis,
    line_key,
    panel_letter,
    split_pages,
    write_reason,
)
from labpipe.report.plot_thinning import extremes
from labpipe.report.saving import FigureToSave, save_pages
from labpipe.report.wording import count_of
from labpipe.statistics.mean_curves import block_means

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS: dict[str, Any] = {
    "color": "black", "linestyle": "", "marker": "o", "markersize": 3.2, "zorder": 4
}  # fmt: skip
_FIT: dict[str, Any] = {
    "color": "black", "linewidth": 0.9, "linestyle": (0, (4, 1.6)), "zorder": 3
}  # fmt: skip
_MODEL: dict[str, Any] = {"color": MODEL, "linewidth": 1.3, "zorder": 2}
_NOTE = "Markers are on the surface of the wire; the curves are its axis."


def shapes_figure(name: str, shapes: Sequence[BentShape]) -> Figure:
    """Draw the shapes of a sample at several deflections on axes of one scale.

    Parameters
    ----------
    name : of what was bent, such as ``A2, 85 mm``
    shapes : one for each deflection; without any, the page says so
    """
    frame_mm = 14.0  # numbers and labels of the panel
    min_aspect, max_aspect = 0.35, 1.1
    title = f"{name}  \u00b7  shapes at {len(shapes)} deflections of the tip"
    if not shapes:
        page = keyed_page(PageTexts(title), height_mm=40.0)
        write_reason(page.subplots(), "There is no shape to draw.")
        return page
    low, high = _bounds(shapes)
    across, up = (high - low).tolist()
    share = min(max(up / across, min_aspect), max_aspect)
    page = keyed_page(
        PageTexts(title, _NOTE, _keys(shapes)), height_mm=frame_mm + (WIDTH - frame_mm) * share
    )
    plot_shapes(shapes, page.subplots())
    return page


def plot_shapes(shapes: Sequence[BentShape], axes: Axes) -> None:
    """Draw shapes: markers as dots, fitted curves dashed, the model solid.

    Parameters
    ----------
    shapes : each is named by its deflection beside its end
    axes : to draw on, with equal scales
    """
    for shape in shapes:
        for points, look in ((shape.model, _MODEL), (shape.fit, _FIT), (shape.markers, _MARKERS)):
            x, y = DEFLECTION.factor * points.T
            axes.plot(x, y, **look)
        _label_end(shape, axes)
    low, high = _bounds(shapes)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel(DEFLECTION.label("Along the undeformed wire, x"))
    axes.set_ylabel(DEFLECTION.label("Towards the pull, y"))


def _label_end(shape: BentShape, axes: Axes) -> None:
    """Write the deflection beside the end furthest from the clamp."""
    ends = [line[-1] for line in map(_finite_rows, _lines(shape)) if len(line)]
    if not ends:
        return
    end_place = DEFLECTION.factor * np.max(ends, axis=0)
    axes.annotate(
        length_words(shape.deflection), (float(end_place[0]), float(end_place[1])), (5, 0),
        textcoords="offset points", va="center",
    )  # fmt: skip


def _bounds(shapes: Sequence[BentShape]) -> tuple[Floats, Floats]:
    """Return the corners of everything drawn with a margin, in the display unit."""
    margin = 0.06
    points = np.concatenate([_finite_rows(line) for shape in shapes for line in _lines(shape)])
    points = DEFLECTION.factor * np.concatenate([points, np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    room = margin * max(float(np.max(high - low)), 1.0)
    return low - room, high + np.array([2.5 * room, room])


def _lines(shape: BentShape) -> tuple[Floats, Floats, Floats]:
    return shape.model, shape.fit, shape.markers


def _finite_rows(points: Floats) -> Floats:
    rows: Floats = points[np.isfinite(points).all(axis=1)]
    return rows


def _keys(shapes: Sequence[BentShape]) -> list[Artist]:
    keys: list[Artist] = [line_key("markers", **_MARKERS)]
    if any(len(shape.fit) for shape in shapes):
        keys.append(line_key("fitted curve", **_FIT))
    if any(len(shape.model) for shape in shapes):
        keys.append(line_key("model", **_MODEL))
    return keys


def calibration_drawings(report: CalibrationReport) -> Iterator[FigureToSave]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : all that they show

    Yields
    ------
    ``calibration``, the card; ``validation-1``, ``validation-2`` ... with six wires and lengths
    each; ``external-curves``, ``external-curves-2`` ... if curves from elsewhere are compared;
    ``shapes-1`` ... for each sample whose shapes are there.
    """
    card = partial(calibration_card, report.calibration, predictions=report.predictions)
    yield FigureToSave("calibration", card)
    for number, groups in enumerate(split_pages(report.groups, MAX_PANELS), start=1):
        yield FigureToSave(f"validation-{number}", partial(validation_figure, groups))
    for number, panels in enumerate(external_pages(report), start=1):
        name = "external-curves" if number == 1 else f"external-curves-{number}"
        yield FigureToSave(name, partial(external_figure, panels))
    for number, (name, shapes) in enumerate(report.shapes.items(), start=1):
        yield FigureToSave(f"shapes-{number}", partial(shapes_figure, name, shapes))


def save_calibration_figures(
    report: CalibrationReport,
    folder: Path,
    *,
    say: Callable[[str], None] = lambda _: None,
    png: bool = False,
) -> list[Path]:
    """Draw the figures of a calibration, each as SVG.

    Parameters
    ----------
    report : all that they show
    folder : made if it is not there
    say : called with the name of each figure as it is drawn
    png : each as PNG, too

    Returns
    -------
    The files, in the order of `calibration_drawings`.

    Raises
    ------
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same report gives the same bytes with the same version of matplotlib.
    """
    return save_pages(
        calibration_drawings(report),
        folder,
        what="figures of a calibration",
        again="calibrate",
        say=say,
        png=png,
    )


SAMPLE: dict[str, Any] = {"linewidth": 0.6, "zorder": 2}
MODEL_LINE: dict[str, Any] = {"color": MODEL, "linewidth": 1.5, "zorder": 4}
MODEL_BAND: dict[str, Any] = {"color": BAND, "alpha": 0.55, "linewidth": 0, "zorder": 1}
_FAINT: dict[str, Any] = {"alpha": 0.2, "linewidth": 0.4}
_MEANS: dict[str, Any] = {"linewidth": 0.9, "zorder": 3}
_ZERO: dict[str, Any] = {"color": "black", "linewidth": 0.6, "zorder": 1}
N_BLOCKS = 25
"""Least number of blocks over which residuals are averaged."""


def sample_looks(calibration: Calibration) -> dict[float, Look]:
    """Return the style of the samples of each length."""
    return length_looks([curve.length for curve in calibration.curves])


def plot_loadings(
    calibration: Calibration, axes: Axes, *, predictions: Mapping[float, Prediction] | None = None
) -> None:
    """Draw the first loadings of all samples, and the model once for each length.

    Parameters
    ----------
    calibration : its curves are drawn
    axes : to draw on
    predictions : of the model with its band, by length, m; without one there is no band
    """
    looks = sample_looks(calibration)
    for curve in calibration.curves:
        look = looks[curve.length]
        _plot(axes, curve.deflection, FORCE.factor * curve.force, look)
    for length in looks:
        deepest = _deepest(calibration, length)
        order = np.argsort(deepest.deflection)
        x = DEFLECTION.factor * deepest.deflection[order]
        y = FORCE.factor * deepest.model[order]
        axes.plot(x, y, **MODEL_LINE)
        axes.annotate(
            length_words(length), (x[-1], y[-1]), (3, 0), textcoords="offset points",
            va="center", annotation_clip=False,
        )  # fmt: skip
        if predictions and length in predictions:
            _draw_band(axes, predictions[length], deepest)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(FORCE.label("Force"))


def plot_residuals(calibration: Calibration, axes: Axes, *, has_own_factor: bool = False) -> None:
    """Draw measured force less that of the model against deflection.

    Parameters
    ----------
    calibration : its curves are drawn
    axes : to draw on
    has_own_factor : multiply the model by each sample's own factor first, which leaves noise and
        misfit of shape

    Notes
    -----
    Every point is drawn faint; a line shows the means of at least `N_BLOCKS` blocks of neighbouring
    points, if there are as many points.
    """
    looks = sample_looks(calibration)
    axes.axhline(0.0, **_ZERO)
    for curve in calibration.curves:
        factor = curve.sample_factor if has_own_factor else 1.0
        residual = SMALL_FORCE.factor * (curve.force - factor * curve.model)
        _plot(axes, curve.deflection, residual, looks[curve.length], **_FAINT)
        across, up = (block_means(values, N_BLOCKS) for values in (curve.deflection, residual))
        look = looks[curve.length]
        axes.plot(DEFLECTION.factor * across, up, color=look.colour, linestyle=look.dash, **_MEANS)
    axes.set_xlim(left=0.0)
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(SMALL_FORCE.label("Measured \u2212 model"))


def _draw_band(axes: Axes, prediction: Prediction, curve: CurveAgreement) -> None:
    """Draw the band of the mean sample up to the largest deflection of the tests."""
    use = prediction.deflection <= np.max(curve.deflection)
    axes.fill_between(
        DEFLECTION.factor * prediction.deflection[use],
        FORCE.factor * prediction.lower_mean[use],
        FORCE.factor * prediction.upper_mean[use],
        **MODEL_BAND,
    )


def _deepest(calibration: Calibration, length: float) -> CurveAgreement:
    curves = [curve for curve in calibration.curves if curve.length == length]
    return max(curves, key=lambda curve: float(np.max(curve.deflection)))


def _plot(axes: Axes, deflection: Floats, values: Floats, look: Look, **more: Any) -> None:
    rows = extremes(values, bins=120)
    across = DEFLECTION.factor * deflection[rows]
    style = {"color": look.colour, "linestyle": look.dash, **SAMPLE, **more}
    axes.plot(across, values[rows], **style)


THRESHOLD: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 1.6))}
INTERVAL: dict[str, Any] = {"color": "#dddddd", "linewidth": 0, "zorder": 0}
PRIOR: dict[str, Any] = {"color": "#009E73", "linewidth": 1.0, "linestyle": (0, (1.4, 1.2))}
_CURVE: dict[str, Any] = {"color": MODEL, "linewidth": 1.2}
_DOTS: dict[str, Any] = {"color": MODEL, "linestyle": "", "marker": "o", "markersize": 2.2}
_VALUE: dict[str, Any] = {"color": "black", "marker": "^", "markersize": 4.5, "clip_on": False}
_MARGIN = 0.12
"""Margin beside the shown values, as a share of their logarithmic range."""


def plot_profile(parameter: CalibratedParameter, axes: Axes) -> None:
    """Draw the deviance of a parameter on a logarithmic axis.

    Parameters
    ----------
    parameter : if it was not fitted, the panel says so
    axes : to draw on; with the threshold on either side of each solution, the parts of the 95 %
        interval in grey, up to the end of the panel where it is open, the value as a triangle,
        open ones for other solutions, and the deviance of the prior from its own centre where
        there is one
    """
    if not parameter.profiles:
        write_reason(axes, typeset(parameter.explanation), line_length=30)
        return
    axis = DISPLAYS[parameter.name]
    low, high = panel_range(parameter)
    axes.set_xscale("log")
    _draw_interval(parameter, axes, (low, high))
    minima = sorted(_minimum(profile)[0] for profile in parameter.profiles)
    borders = [low, *np.sqrt(np.array(minima[1:]) * np.array(minima[:-1])).tolist(), high]
    for profile in parameter.profiles:
        side = minima.index(_minimum(profile)[0])
        _draw_solution(profile, axes, axis.scale.factor, (borders[side], borders[side + 1]))
    axes.plot(axis.scale.factor * parameter.value, 0.0, **_VALUE)
    _draw_prior(parameter, axes, (low, high))
    axes.set_xlim(axis.scale.factor * low, axis.scale.factor * high)
    axes.set_ylim(0.0, _panel_top(parameter))
    axes.set_xlabel(axis.label)
    _set_ticks(axes)


def _panel_top(parameter: CalibratedParameter) -> float:
    """Return the largest deviance that a panel shows."""
    height_over_threshold = 2.6
    ends = [max(profile.threshold_below, profile.threshold_above) for profile in parameter.profiles]
    return height_over_threshold * max(ends)


def _minimum(profile: Profile) -> tuple[float, float]:
    """Return value and deviance of the solution from which a profile was traced."""
    number = int(np.argmin(profile.deviance))
    return float(profile.value[number]), float(profile.deviance[number])


def _draw_interval(parameter: CalibratedParameter, axes: Axes, ends: tuple[float, float]) -> None:
    factor, last = DISPLAYS[parameter.name].scale.factor, len(parameter.intervals) - 1
    for number, part in enumerate(parameter.intervals):
        low = ends[0] if number == 0 and parameter.is_open_below else part.lower
        high = ends[1] if number == last and parameter.is_open_above else part.upper
        axes.axvspan(factor * low, factor * high, **INTERVAL)


def _draw_solution(profile: Profile, axes: Axes, factor: float, ends: tuple[float, float]) -> None:
    """Draw one profile, its thresholds, and a triangle if it is not the best solution."""
    values, deviance = interpolate_profile(profile)
    least, height = _minimum(profile)
    axes.plot(factor * values, deviance, **_CURVE)
    axes.plot(factor * profile.value, profile.deviance, **_DOTS)
    axes.plot([factor * ends[0], factor * least], [profile.threshold_below] * 2, **THRESHOLD)
    axes.plot([factor * least, factor * ends[1]], [profile.threshold_above] * 2, **THRESHOLD)
    if height > 0.0:
        axes.plot(factor * least, height, **_VALUE, markerfacecolor="white")


def panel_range(parameter: CalibratedParameter) -> tuple[float, float]:
    """Return the range of values that the panel of a parameter shows, SI.

    Parameters
    ----------
    parameter : its interval, or the traced range of its profile, is shown
    """
    if not parameter.profiles:
        return parameter.value, parameter.value
    highest = _panel_top(parameter)
    traced = [
        value
        for profile in parameter.profiles
        for value in profile.value[profile.deviance <= highest]
    ]
    wanted = [*traced, parameter.value]
    first, last = (
        end([profile.value[place] for profile in parameter.profiles])
        for end, place in ((min, 0), (max, -1))
    )
    ends = [end for part in parameter.intervals for end in (part.lower, part.upper)]
    wanted += [end for end in ends if first <= end <= last]
    if parameter.conflict is not None:
        wanted.append(parameter.conflict.centre)
    low, high = float(np.log(min(wanted))), float(np.log(max(wanted)))
    margin = _MARGIN * max(high - low, 0.02)
    return float(np.exp(low - margin)), float(np.exp(high + margin))


def interpolate_profile(profile: Profile) -> tuple[Floats, Floats]:
    """Interpolate a profile between its points.

    Parameters
    ----------
    profile : of at least one point

    Returns
    -------
    Values and deviances. The signed square root of the deviance is interpolated linearly over the
    logarithm of the value: for a normal parameter that root is a straight line.
    """
    fine_points = 200
    logs, (least, height) = np.log(profile.value), _minimum(profile)
    side = np.sign(logs - np.log(least))
    fine: Floats = np.union1d(np.linspace(logs[0], logs[-1], fine_points), logs)
    root = np.interp(fine, logs, side * np.sqrt(np.maximum(profile.deviance - height, 0.0)))
    return np.exp(fine), root**2 + height


def _draw_prior(parameter: CalibratedParameter, axes: Axes, ends: tuple[float, float]) -> None:
    """Draw the deviance of the prior: its squared distance in standard deviations."""
    normal_quantile = 1.959963984540054
    if parameter.conflict is None:
        return
    values: Floats = np.geomspace(*ends, 200)
    error = np.log(parameter.conflict.factor) / normal_quantile
    deviations = np.log(values / parameter.conflict.centre) / error
    axes.plot(DISPLAYS[parameter.name].scale.factor * values, deviations**2, **PRIOR)


def _set_ticks(axes: Axes) -> None:
    linear_below, few_decades_above = 6.0, 500.0  # ratio of the ends of an axis
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    low, high = axes.get_xlim()
    label_log_axis(axes.xaxis)
    if high < linear_below * low:
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_minor_locator(NullLocator())
    elif high > few_decades_above * low:
        axes.xaxis.set_major_locator(LogLocator(numticks=4))
        axes.xaxis.set_minor_locator(NullLocator())


_PANEL_HEIGHTS = (58.0, 34.0, 32.0)
"""mm, rows of panels without their headings, numbers and labels."""
_FRAME_MM = 16.5
"""Heading, numbers and label of a panel."""
_LINE_MM = 3.7
"""Height of a line of text."""
_DOUBTFUL = {
    Identifiability.NOT,
    Identifiability.TWO,
    Identifiability.AT_BOUND,
    Identifiability.BY_PRIOR,
    Identifiability.AGAINST_PRIOR,
}
_NO_BAND = "The band of the model is not drawn."
_RESIDUALS = "Residuals: points faint, means of neighbouring points as lines."


def calibration_card(
    calibration: Calibration, *, predictions: Mapping[float, Prediction] | None = None
) -> Figure:
    """Draw a calibration on one page, to be printed upright on A4.

    Parameters
    ----------
    calibration : of one wire
    predictions : of the model at each length (m) of the tests, for its band

    Returns
    -------
    A page with (a) the first loadings and the model, (b) residuals, (c) residuals with the factor
    of each sample taken out, (d) to (f) profiles of the parameters, and numbers and verdicts in
    words.
    """
    letters_per_line = 145
    rows = [HEADS, *(parameter_row(parameter) for parameter in calibration.parameters)]
    lines = [
        line
        for sentence in sentences(calibration)
        for line in textwrap.wrap(sentence, letters_per_line, subsequent_indent="   ")
    ]
    heights = _heights(len(rows) + len(lines) + 1.3)
    note = _RESIDUALS if predictions else f"{_RESIDUALS} {_NO_BAND}"
    page = keyed_page(
        PageTexts(_title(calibration), note, _card_keys(calibration, predictions)),
        height_mm=sum(heights) + _FRAME_MM * len(_PANEL_HEIGHTS),
        width_mm=DOUBLE_COLUMN,
    )
    panels = page.subplot_mosaic("aaaaaa;bbbccc;ddeeff;wwwwww", height_ratios=heights)
    plot_loadings(calibration, panels["a"], predictions=predictions)
    plot_residuals(calibration, panels["b"])
    plot_residuals(calibration, panels["c"], has_own_factor=True)
    _draw_profiles(calibration, [panels[letter] for letter in "def"])
    _write_table(panels["w"], rows, lines)
    for letter, heading in zip("abc", _HEADINGS, strict=True):
        panel_letter(panels[letter], letter, heading)
    return page


_HEADINGS = ("first loadings", "residuals", "residuals with each sample's own factor")
_OF_PARAMETERS = ("friction", "insulation", "copper")


def _title(calibration: Calibration) -> str:
    count = count_of(calibration.n_samples, "sample")
    return f"{calibration.wire}  ·  calibration of the wire model  ·  {count}"


def _heights(lines: float) -> tuple[float, ...]:
    """Return the heights of the panels and of a number of lines of text, mm."""
    max_height_mm = 255.0  # of an upright A4 page
    min_panel_share = 0.7  # of the panels' full heights, above much text
    text_height = _LINE_MM * lines
    room = max_height_mm - _FRAME_MM * len(_PANEL_HEIGHTS) - text_height
    share = min(max(room / sum(_PANEL_HEIGHTS), min_panel_share), 1.0)
    return *(share * height for height in _PANEL_HEIGHTS), text_height


def _draw_profiles(calibration: Calibration, panels: Sequence[Axes]) -> None:
    for number, (parameter, axes) in enumerate(zip(calibration.parameters, panels, strict=True)):
        plot_profile(parameter, axes)
        panel_letter(axes, "def"[number], _OF_PARAMETERS[number])
    panels[0].set_ylabel("Deviance")


def _write_table(axes: Axes, rows: Sequence[Sequence[str]], lines: Sequence[str]) -> None:
    """Write a table and lines below one another, from the top of a panel."""
    column_edges = (0.0, 0.24, 0.34, 0.53, 0.60)
    axes.set_axis_off()
    for number, row in enumerate(rows):
        for x_place, text in zip(column_edges, row, strict=True):
            is_bold = number == 0 or text in _DOUBTFUL
            _put_text(axes, text, x_place, number, weight="bold" if is_bold else "normal")
    for number, line in enumerate(lines, start=len(rows)):
        _put_text(axes, line, 0.0, number + 0.5)


def _put_text(axes: Axes, text: str, x: float, line: float, **look: Any) -> None:
    padding = 0.012
    points_per_mm = 72.0 / 25.4
    axes.annotate(
        text, (padding + x, 1.0), (0.0, -line * _LINE_MM * points_per_mm),
        textcoords="offset points",
        xycoords=("figure fraction", "axes fraction"), va="top", annotation_clip=False,
        **look,
    ).set_in_layout(False)  # fmt: skip


def _card_keys(
    calibration: Calibration, predictions: Mapping[float, Prediction] | None
) -> list[Artist]:
    keys: list[Artist] = [
        line_key(_samples(calibration, length), color=look.colour, linestyle=look.dash, **SAMPLE)
        for length, look in sample_looks(calibration).items()
    ]  # fmt: skip
    keys.append(line_key("model", **MODEL_LINE))
    if predictions:
        keys.append(area_key("95 % band of the model, mean sample", **MODEL_BAND))
    if any(parameter.profiles for parameter in calibration.parameters):
        keys.append(line_key("95 % threshold", **THRESHOLD))
        keys.append(area_key("95 % interval", **INTERVAL))
    if any(parameter.conflict is not None for parameter in calibration.parameters):
        keys.append(line_key("prior alone", **PRIOR))
    return keys


def _samples(calibration: Calibration, length: float) -> str:
    count = sum(curve.length == length for curve in calibration.curves)
    return f"measured, {length_words(length)} ({count})"
