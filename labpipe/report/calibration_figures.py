"""Figures of a calibration: its result on one page, tests and external curves beside the model."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, average_blocks
from labpipe.records.group import Band
from labpipe.records.wire_calibration import (
    CalibratedParameter,
    Calibration,
    CurveMatch,
    ExternalCurveComparison,
    Prediction,
    Profile,
)
from labpipe.report import figure_page
from labpipe.report.calibration_summary import (
    DEFLECTION,
    DISPLAYS,
    FORCE,
    SMALL_FORCE,
    BentShape,
    CalibrationReport,
    ValidationGroup,
    describe_calibration,
    typeset,
    write_length,
    write_parameter,
    write_percent,
)
from labpipe.report.issues import join_sentences
from labpipe.report.plot_records import find_extremes, split_doubtful
from labpipe.report.wording import write_count

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw_bent_shapes(name: str, shapes: Sequence[BentShape]) -> Figure:
    """Draw the shapes of a sample at several deflections, with one scale on both axes.

    Parameters
    ----------
    name : of the sample with its length, such as ``A2, 85 mm``
    shapes : one for each deflection; if there is none, the page says so
    """
    frame_mm = 14.0  # of the panel, for tick labels and axis labels
    min_aspect, max_aspect = 0.35, 1.1
    title = f"{name}  \u00b7  shapes at {len(shapes)} deflections of the tip"
    if not shapes:
        return figure_page.make_empty_page(title, "There is no shape to draw.")
    low, high = _bounds(shapes)
    width, height = (high - low).tolist()
    share = min(max(height / width, min_aspect), max_aspect)
    page = figure_page.make_page(height_mm=frame_mm + (figure_page.WIDTH - frame_mm) * share)
    _plot_shapes(shapes, page.subplots())
    return figure_page.add_title(
        page, title, "Markers are on the surface of the wire; the curves are its axis."
    )


def _plot_shapes(shapes: Sequence[BentShape], axes: Axes) -> None:
    """Draw shapes with one scale on both axes, each labelled with its deflection at its end."""
    for shape in shapes:
        looks = ("shape_markers", "shape_fit", "shape_model")
        for points, look in zip(_lines(shape), looks, strict=True):
            if len(points):
                axes.plot(*(DEFLECTION.factor * points.T), **figure_page.read_look(look))
        _label_end(shape, axes)
    low, high = _bounds(shapes)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_xlabel(DEFLECTION.label("Along the undeformed wire, x"))
    axes.set_ylabel(DEFLECTION.label("Towards the pull, y"))


def _label_end(shape: BentShape, axes: Axes) -> None:
    """Write the deflection beside the end furthest from the clamp."""
    ends = [line[-1] for line in map(_finite_rows, _lines(shape)) if len(line)]
    if not ends:
        return
    end_place = DEFLECTION.factor * np.max(ends, axis=0)
    axes.annotate(
        write_length(shape.deflection), (float(end_place[0]), float(end_place[1])), (5, 0),
        textcoords="offset points", va="center",
    )  # fmt: skip


def _bounds(shapes: Sequence[BentShape]) -> tuple[Floats, Floats]:
    """Return the lower and upper corner of all shapes and the clamp with a margin, mm."""
    margin = 0.06
    points = np.concatenate([_finite_rows(line) for shape in shapes for line in _lines(shape)])
    points = DEFLECTION.factor * np.concatenate([points, np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    room = margin * max(float(np.max(high - low)), 1.0)
    return low - room, high + np.array([2.5 * room, room])


def _lines(shape: BentShape) -> tuple[Floats, Floats, Floats]:
    return shape.markers, shape.fit, shape.model


def _finite_rows(points: Floats) -> Floats:
    rows: Floats = points[np.isfinite(points).all(axis=1)]
    return rows


def list_calibration_figures(report: CalibrationReport) -> Iterator[figure_page.FigureToSave]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : of the calibration

    Yields
    ------
    ``calibration``; ``validation-1``, ``validation-2`` and so on with six panels each;
    ``external-curves``, ``external-curves-2`` and so on if external curves are compared;
    ``shapes-1`` and so on, one for each sample with shapes.
    """
    draw = partial(draw_calibration, report.calibration, predictions=report.predictions)
    yield figure_page.FigureToSave("calibration", draw)
    for number, groups in enumerate(figure_page.split_pages(report.groups, MAX_PANELS), start=1):
        yield figure_page.FigureToSave(f"validation-{number}", partial(draw_validation, groups))
    for number, panels in enumerate(group_external_curves(report), start=1):
        name = "external-curves" if number == 1 else f"external-curves-{number}"
        yield figure_page.FigureToSave(name, partial(draw_external_curves, panels))
    for number, (name, shapes) in enumerate(report.shapes.items(), start=1):
        yield figure_page.FigureToSave(f"shapes-{number}", partial(draw_bent_shapes, name, shapes))


MIN_RESIDUAL_BLOCKS = 25
"""Least number of blocks over which residuals are averaged."""


def _plot_loadings(
    calibration: Calibration, axes: Axes, predictions: Mapping[float, Prediction]
) -> None:
    """Draw the first loadings of all samples, and the model with its band for each length."""
    looks = _choose_length_looks(calibration)
    for curve in calibration.curves:
        count = sum(other.length == curve.length for other in calibration.curves)
        label = f"measured, {write_length(curve.length)} ({count})"
        force = FORCE.factor * curve.force
        _plot_thinned(axes, curve.deflection, force, looks[curve.length], label=label)
    for length in looks:
        deepest = max(
            (curve for curve in calibration.curves if curve.length == length),
            key=lambda curve: float(np.max(curve.deflection)),
        )
        order = np.argsort(deepest.deflection)
        deflection, force = deepest.deflection[order], deepest.model[order]
        _plot_force(axes, deflection, force, "model_of_sample")
        end = DEFLECTION.factor * deflection[-1], FORCE.factor * force[-1]
        axes.annotate(
            write_length(length), end, (3, 0), textcoords="offset points",
            va="center", annotation_clip=False,
        )  # fmt: skip
        if length in predictions:
            model = predictions[length]
            use = model.deflection <= deflection[-1]
            edges = model.lower_mean[use], model.upper_mean[use]
            _fill_force(axes, model.deflection[use], edges, "band_of_mean_sample")
    _set_force_axes(axes)


def _set_force_axes(axes: Axes, *, lowest: float = math.inf, headroom: float = 1.0) -> None:
    """Start both axes at zero, or that of force below at the lowest force; label both."""
    low, high = axes.get_ylim()
    bottom = min(0.0, low if math.isinf(lowest) else lowest)
    axes.set(xlim=(0.0, axes.get_xlim()[1]), ylim=(bottom, headroom * high))
    axes.set(xlabel=DEFLECTION.label("Tip deflection"), ylabel=FORCE.label("Force"))


def plot_residuals(calibration: Calibration, axes: Axes, *, has_own_factor: bool = False) -> None:
    """Draw the measured force less the force of the model against deflection.

    Parameters
    ----------
    calibration : its curves are drawn
    axes : to draw on
    has_own_factor : multiply the model by the factor of each sample first; the residuals are then
        noise and an error of the shape of the curve

    Notes
    -----
    Every point is drawn faint. A line shows the means of blocks of neighbouring points: at least
    `MIN_RESIDUAL_BLOCKS`, if there are as many points.
    """
    looks = _choose_length_looks(calibration)
    axes.axhline(0.0, color="black", linewidth=0.6, zorder=1)
    for curve in calibration.curves:
        factor = curve.sample_factor if has_own_factor else 1.0
        residual, look = (
            SMALL_FORCE.factor * (curve.force - factor * curve.model),
            looks[curve.length],
        )
        _plot_thinned(axes, curve.deflection, residual, look, alpha=0.2, linewidth=0.4)
        x = DEFLECTION.factor * average_blocks(curve.deflection, MIN_RESIDUAL_BLOCKS)
        means = average_blocks(residual, MIN_RESIDUAL_BLOCKS)
        axes.plot(x, means, linewidth=0.9, zorder=3, **look._asdict())
    axes.set_xlim(left=0.0)
    axes.set_xlabel(DEFLECTION.label("Tip deflection"))
    axes.set_ylabel(SMALL_FORCE.label("Measured \u2212 model"))


def _choose_length_looks(calibration: Calibration) -> dict[float, figure_page.Look]:
    """Choose a colour and a dash for each length of the samples, which also differ in grey."""
    colours = ("#555555", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#D55E00")
    lengths = sorted({curve.length for curve in calibration.curves})
    return {
        length: figure_page.Look(colours[number % len(colours)], figure_page.choose_dash(number))
        for number, length in enumerate(lengths)
    }


def _plot_force(axes: Axes, deflection: Floats, force: Floats, look: str, **settings: Any) -> None:
    x, y = DEFLECTION.factor * deflection, FORCE.factor * force
    axes.plot(x, y, **figure_page.read_look(look, **settings))


def _fill_force(
    axes: Axes, deflection: Floats, edges: tuple[Floats, Floats], look: str, **settings: Any
) -> None:
    lower, upper = (FORCE.factor * edge for edge in edges)
    axes.fill_between(
        DEFLECTION.factor * deflection, lower, upper, **figure_page.read_look(look, **settings)
    )


def _plot_thinned(
    axes: Axes, deflection: Floats, values: Floats, look: figure_page.Look, **more: Any
) -> None:
    rows = find_extremes(values, n_bins=120)
    style = {**look._asdict(), "linewidth": 0.6, "zorder": 2, **more}
    axes.plot(DEFLECTION.factor * deflection[rows], values[rows], **style)


def plot_profile(parameter: CalibratedParameter, axes: Axes) -> None:
    """Draw the deviance of a parameter against its value on a logarithmic axis.

    Parameters
    ----------
    parameter : if it was not fitted, the panel says so
    axes : to draw on

    Notes
    -----
    A dashed line is the threshold on either side of each solution. The 95 % interval is grey; an
    open interval ends with the panel. A triangle is the value, an open triangle another solution.
    If there is a prior, its deviance from its own centre is drawn, too.
    """
    if not parameter.profiles:
        figure_page.write_reason(axes, typeset(parameter.explanation), line_length=30)
        return
    axis = DISPLAYS[parameter.name]
    low, high = find_panel_range(parameter)
    axes.set_xscale("log")
    _draw_interval(parameter, axes, (low, high))
    minima = sorted(_minimum(profile)[0] for profile in parameter.profiles)
    borders = [low, *np.sqrt(np.array(minima[1:]) * np.array(minima[:-1])).tolist(), high]
    for profile in parameter.profiles:
        side = minima.index(_minimum(profile)[0])
        _draw_solution(profile, axes, axis.scale.factor, (borders[side], borders[side + 1]))
    axes.plot(axis.scale.factor * parameter.value, 0.0, **figure_page.read_look("best_value"))
    _draw_prior(parameter, axes, (low, high))
    axes.set_xlim(axis.scale.factor * low, axis.scale.factor * high)
    axes.set_ylim(0.0, _panel_top(parameter))
    axes.set_xlabel(axis.label)
    _set_ticks(axes)


def _panel_top(parameter: CalibratedParameter) -> float:
    """Return the deviance at the top of a panel."""
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
        axes.axvspan(factor * low, factor * high, **figure_page.read_look("interval_of_parameter"))


def _draw_solution(profile: Profile, axes: Axes, factor: float, ends: tuple[float, float]) -> None:
    """Draw one profile, its thresholds, and a triangle if it is not the best solution."""
    values, deviance = interpolate_profile(profile)
    best, height = _minimum(profile)
    axes.plot(factor * values, deviance, **figure_page.read_look("profile"))
    axes.plot(factor * profile.value, profile.deviance, **figure_page.read_look("profile_point"))
    thresholds = profile.threshold_below, profile.threshold_above
    for end, threshold in zip(ends, thresholds, strict=True):
        x = np.sort([factor * end, factor * best])
        axes.plot(x, [threshold] * 2, **figure_page.read_look("threshold"))
    if height > 0.0:
        axes.plot(
            factor * best, height, **figure_page.read_look("best_value", markerfacecolor="white")
        )


def find_panel_range(parameter: CalibratedParameter) -> tuple[float, float]:
    """Return the range of values that the panel of a parameter shows, SI.

    Parameters
    ----------
    parameter : with profiles

    Returns
    -------
    Both ends: the panel shows the value, the points of the profiles below its top, the ends of the
    interval that the profiles reach, and the centre of the prior.
    """
    margin_share = 0.12  # beside the shown values, of their logarithmic range
    top, profiles = _panel_top(parameter), parameter.profiles
    shown = [value for profile in profiles for value in profile.value[profile.deviance <= top]]
    shown.append(parameter.value)
    first = min(profile.value[0] for profile in profiles)
    last = max(profile.value[-1] for profile in profiles)
    ends = [end for part in parameter.intervals for end in (part.lower, part.upper)]
    shown += [end for end in ends if first <= end <= last]
    if parameter.conflict is not None:
        shown.append(parameter.conflict.centre)
    low, high = float(np.log(min(shown))), float(np.log(max(shown)))
    margin = margin_share * max(high - low, 0.02)
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
    away = np.log(values / parameter.conflict.centre) / error
    x = DISPLAYS[parameter.name].scale.factor * values
    axes.plot(x, away**2, **figure_page.read_look("prior"))


def _set_ticks(axes: Axes) -> None:
    linear_below, few_decades_above = 6.0, 500.0  # ratio of the ends of an axis
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    low, high = axes.get_xlim()
    figure_page.label_log_axis(axes.xaxis)
    if high < linear_below * low:
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.xaxis.set_minor_locator(NullLocator())
    elif high > few_decades_above * low:
        axes.xaxis.set_major_locator(LogLocator(numticks=4))
        axes.xaxis.set_minor_locator(NullLocator())


def draw_calibration(
    calibration: Calibration, *, predictions: Mapping[float, Prediction] | None = None
) -> Figure:
    """Draw a calibration on one page, to be printed upright on A4.

    Parameters
    ----------
    calibration : of one wire
    predictions : of the model by length of the tests (m), for its band; None for no band

    Returns
    -------
    A page with (a) the first loadings and the model, (b) the residuals, (c) the residuals with the
    own factor of each sample, (d) to (f) the profiles of the parameters, and in words the values
    and verdicts.
    """
    panel_heights, frame_mm = (58.0, 34.0, 32.0), 16.5  # of each row; for headings and labels
    height = sum(panel_heights) + frame_mm * len(panel_heights)
    page = figure_page.make_page(height_mm=height, width_mm=figure_page.DOUBLE_COLUMN)
    panels = page.subplot_mosaic("aaaaaa;bbbccc;ddeeff", height_ratios=panel_heights)
    _plot_loadings(calibration, panels["a"], predictions or {})
    plot_residuals(calibration, panels["b"])
    plot_residuals(calibration, panels["c"], has_own_factor=True)
    for letter, parameter in zip("def", calibration.parameters, strict=True):
        plot_profile(parameter, panels[letter])
    panels["d"].set_ylabel("Deviance")
    for letter, heading in zip("abcdef", _HEADINGS, strict=True):
        panels[letter].set_title(heading, loc="left")
    numbers = [
        f"{name}: {value} {unit.removesuffix('1')} (95 %: {interval}), {verdict}."
        for name, value, interval, unit, verdict in map(write_parameter, calibration.parameters)
    ]
    about = "Residuals: points faint, means of neighbouring points as lines."
    about += "" if predictions else " The band of the model is not drawn."
    note = "\n".join([*numbers, *describe_calibration(calibration), about])
    count = write_count(calibration.n_samples, "sample")
    return figure_page.add_title(
        page, f"{calibration.wire}  ·  calibration of the wire model  ·  {count}", note
    )


_HEADINGS = (
    "first loadings", "residuals", "residuals with each sample's own factor", "friction",
    "insulation", "copper",
)  # fmt: skip


MAX_PANELS = 6
"""Panels on a page of wires and lengths, or of external curves."""
_N_COLUMNS = 2
_HEADROOM = 1.08
"""Top of an axis, of the largest value."""


def draw_validation(groups: Sequence[ValidationGroup]) -> Figure:
    """Draw measured and modelled force against deflection, a panel per group.

    Parameters
    ----------
    groups : 1 to 6, each of one wire and one length

    Raises
    ------
    ValueError
        If there is no group, or more than `MAX_PANELS`.
    """
    figure_page.require_room(len(groups), MAX_PANELS, "groups")
    row_mm = 66.0
    height = row_mm * math.ceil(len(groups) / _N_COLUMNS)
    page = figure_page.make_page(height_mm=height, width_mm=figure_page.DOUBLE_COLUMN)
    panels = figure_page.make_panels(page, len(groups), columns=_N_COLUMNS)
    for group, axes in zip(groups, panels, strict=True):
        _plot_group(group, axes)
        use = "calibrated" if group.is_calibrated else "predicted"
        axes.set_title(f"{group.wire}, {write_length(group.length)}: {use}", loc="left")
    return figure_page.add_title(page, "Measured and predicted first loadings", _note(groups))


def _plot_group(group: ValidationGroup, axes: Axes) -> None:
    """Draw samples, their mean with its band, the model with its band; describe the agreement."""
    for sample in group.samples.values():
        rows = find_extremes(sample.force, n_bins=100)
        _plot_force(axes, sample.displacement[rows], sample.force[rows], "measured_sample")
    _draw_measured(group.band, axes)
    if group.prediction is not None:
        _draw_prediction(group.prediction, group.is_sure, axes)
    axes.text(
        0.03, 0.98, _wrap(describe_agreement(group)), transform=axes.transAxes, va="top", zorder=6,
        linespacing=1.25,
    )  # fmt: skip
    _set_force_axes(axes, lowest=_lowest(group), headroom=_HEADROOM)


def describe_agreement(group: ValidationGroup) -> list[str]:
    """Describe in a few texts how well the model agrees with a group.

    Parameters
    ----------
    group : without a prediction, the texts give the reason
    """
    lines = [write_count(len(group.samples), "sample")]
    if not np.isfinite(group.band.lower).any():
        lines[0] += ", no band of the mean"
    errors = group.errors
    if errors is None:
        return [*lines, f"No prediction. {join_sentences([group.reason])}".strip()]
    rmse = SMALL_FORCE.factor * errors.rmse
    share = write_percent(errors.rmse_share)
    lines.append(f"RMSE {rmse:.3g} {SMALL_FORCE.unit}, {share} of the largest force")
    if math.isfinite(errors.inside):
        lines.append(f"{write_percent(errors.inside)} of the points inside the band")
    return lines


def _draw_measured(band: Band, axes: Axes) -> None:
    """Draw the mean of the samples and its 95 % band, if any."""
    _plot_force(axes, band.displacement, band.mean, "mean_of_samples")
    if np.isfinite(band.lower).any():
        _fill_force(axes, band.displacement, (band.lower, band.upper), "band_of_mean")


_BAND_OPACITY = 0.5


def _draw_prediction(prediction: Prediction, is_sure: Flags, axes: Axes) -> None:
    """Draw the model and its band, lighter where they are doubtful."""
    for part, opacity in split_doubtful(is_sure):
        deflection = prediction.deflection[part]
        edges = prediction.lower[part], prediction.upper[part]
        _plot_force(axes, deflection, prediction.force[part], "model", alpha=opacity)
        _fill_force(axes, deflection, edges, "band_of_model", alpha=_BAND_OPACITY * opacity)
        for edge in edges:
            _plot_force(axes, deflection, edge, "edge_of_band", alpha=opacity)


def _lowest(group: ValidationGroup) -> float:
    """Return the lowest force of the mean and the samples, in the display unit."""
    forces: list[Floats] = [group.band.mean, *(sample.force for sample in group.samples.values())]
    finite = [force[np.isfinite(force)] for force in forces]
    return FORCE.factor * min(
        (float(values.min()) for values in finite if len(values)), default=0.0
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
        lines.append(format_sentence("report.doubtful_model"))
    notes = {
        note.message: None
        for group in groups
        if group.prediction is not None
        for note in group.prediction.notes
    }
    return " ".join([*lines, *(f"{text[:1].upper()}{text[1:]}." for text in notes)])


def _names(groups: Sequence[ValidationGroup], mean_of: int) -> list[str]:
    return [
        f"{group.wire} {write_length(group.length)}"
        for group in groups
        if group.mean_of == mean_of and group.prediction is not None
    ]


_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
_MARKS = ("o", "s", "^", "D", "v")
_FREE_KEY_ROWS = 4
"""Rows of a key that fit above most curves without more room."""


class ExternalPanel(NamedTuple):
    """External curves of one wire, length and kind of load, in one panel.

    Parameters
    ----------
    wire : name
    length : m
    is_normal : the load stays normal to the undeformed axis, in the curves and in the model
    group : tests of that wire and length; None if there are none
    comparisons : the curves, compared with tests and model
    """

    wire: str
    length: float
    is_normal: bool
    group: ValidationGroup | None
    comparisons: tuple[ExternalCurveComparison, ...]

    @property
    def prediction(self) -> Prediction | None:
        """Return the prediction that reaches furthest; None if no curve has one."""
        predictions = [
            comparison.prediction
            for comparison in self.comparisons
            if comparison.prediction is not None
        ]
        return max(predictions, key=lambda model: float(model.deflection[-1]), default=None)


def group_external_curves(report: CalibrationReport) -> list[Sequence[ExternalPanel]]:
    """Group external curves by wire, length and kind of load, in pages of `MAX_PANELS` panels.

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
    return figure_page.split_pages(panels, MAX_PANELS)


def draw_external_curves(panels: Sequence[ExternalPanel]) -> Figure:
    """Draw external curves, tests and model, a panel per wire, length and kind of load.

    Parameters
    ----------
    panels : 1 to 6

    Raises
    ------
    ValueError
        If there is no panel, or more than `MAX_PANELS`.
    """
    row_mm = 70.0
    figure_page.require_room(len(panels), MAX_PANELS, "panels")
    rows = math.ceil(len(panels) / _N_COLUMNS)
    row = row_mm + 4.0 * max(0, max(map(_key_rows, panels)) - _FREE_KEY_ROWS)
    page = figure_page.make_page(height_mm=row * rows, width_mm=figure_page.DOUBLE_COLUMN)
    drawn = figure_page.make_panels(page, len(panels), columns=_N_COLUMNS)
    for panel, axes in zip(panels, drawn, strict=True):
        _plot_external(panel, axes)
        load = ", load normal to the axis" if panel.is_normal else ""
        axes.set_title(f"{panel.wire}, {write_length(panel.length)}{load}", loc="left")
    return figure_page.add_title(page, "External curves, tests and model", _external_note(panels))


def _plot_external(panel: ExternalPanel, axes: Axes) -> None:
    """Draw the mean of the tests and the model with their bands, and external curves on top.

    The text in the panel gives the RMSE of each external curve to the tests and to the model.
    """
    from matplotlib.legend import Legend

    if panel.group is not None:
        _draw_measured(panel.group.band, axes)
    model = panel.prediction
    if model is not None:
        _plot_force(axes, model.deflection, model.force, "model")
        edges = model.lower_mean, model.upper_mean
        _fill_force(axes, model.deflection, edges, "band_of_model", alpha=_BAND_OPACITY)
    lines = [
        _draw_comparison(comparison, number, axes)
        for number, comparison in enumerate(panel.comparisons)
    ]
    extra_rows = max(0, _key_rows(panel) - _FREE_KEY_ROWS)
    _set_force_axes(axes, headroom=_HEADROOM + 0.06 * extra_rows)
    labels = [_wrap(describe_match(comparison)) for comparison in panel.comparisons]
    # `axes.legend` would take the labels of the other lines out of the key of the page
    key = Legend(axes, lines, labels, loc="upper left", handlelength=2.2, borderaxespad=0.4)
    axes.add_artist(key)


def _key_rows(panel: ExternalPanel) -> int:
    """Count the lines of text in the key of a panel."""
    labels = (_wrap(describe_match(comparison)) for comparison in panel.comparisons)
    return sum(1 + label.count("\n") for label in labels)


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
    )
    return line


def _wrap(texts: Sequence[str]) -> str:
    max_length = 48
    return "\n".join(line for text in texts for line in textwrap.wrap(text, max_length))


def describe_match(comparison: ExternalCurveComparison) -> list[str]:
    """Name an external curve and write its RMSE against the tests and the model.

    Parameters
    ----------
    comparison : with tests and model
    """
    tests = comparison.tests
    by_tests = "no tests to compare" if tests is None else _describe_rmse("tests", tests)
    return [comparison.curve.name, by_tests, _describe_rmse("model", comparison.model)]


def _describe_rmse(other: str, match: CurveMatch) -> str:
    if match.errors is None:
        return f"{other}: not compared"
    rmse = SMALL_FORCE.factor * match.errors.rmse
    share = write_percent(match.errors.rmse_share)
    return f"{other}: RMSE {rmse:.3g} {SMALL_FORCE.unit}, {share} of peak"


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
