"""Make the figures of a calibration of the wire model, and of its predictions with tests."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.group import Band
from labpipe.records.wire import (
    CalibratedParameter,
    Calibration,
    CurveMatch,
    ExternalCurveComparison,
    Prediction,
    Profile,
)
from labpipe.report import calibration_summary as summary
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import choose_dash, split_pages
from labpipe.report.issues import join_sentences
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, make_line, make_thinned_line
from labpipe.report.wording import write_count

MAX_PANELS = 6
"""Largest number of panels on a page of predictions or of external curves."""
_HEADROOM = 1.08
"""Ratio of the top of an axis to the largest value."""


def list_calibration_figures(report: summary.CalibrationReport) -> Iterator[Page]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : calibration, predictions, tests and external curves

    Yields
    ------
    ``calibration``; ``validation-1``, ``validation-2`` and so on with up to six panels each;
    ``external-curves``, ``external-curves-2`` and so on if external curves are compared;
    ``shapes-1`` and so on, one for each test with shapes.
    """
    yield make_calibration_page(report.calibration, predictions=report.predictions)
    for number, groups in enumerate(split_pages(report.groups, MAX_PANELS), start=1):
        yield make_validation_page(f"validation-{number}", groups)
    for number, panels in enumerate(group_external_curves(report), start=1):
        name = "external-curves" if number == 1 else f"external-curves-{number}"
        yield make_external_page(name, panels)
    for number, (name, shapes) in enumerate(report.shapes.items(), start=1):
        yield make_bent_shapes_page(f"shapes-{number}", name, shapes)


def make_bent_shapes_page(name: str, test: str, shapes: Sequence[summary.BentShape]) -> Page:
    """Make the page of the shapes of a test at several deflections, with one scale on both axes.

    Parameters
    ----------
    name : file name without the ending
    test : name of the test
    shapes : shape at each deflection; without any, the page says so
    """
    frame_mm = 14.0  # room for the tick labels and the axis label beside the panel
    margin = 0.06  # fraction of the longer side of the shapes
    min_aspect, max_aspect = 0.35, 1.1
    title = f"{test}  \u00b7  shapes at {len(shapes)} deflections of the tip"
    if not shapes:
        panels = [Plot(reason="There is no shape to draw.")]
        return Page(name, title, panels, height=40.0, width=plots.SINGLE_COLUMN)
    lines, labels, point_sets = [], [], [np.zeros((1, 2))]
    for shape in shapes:
        curves = {
            "shape_markers": shape.markers,
            "shape_fit": shape.fit,
            "shape_model": shape.model,
        }
        lines += [make_line(look, *points.T) for look, points in curves.items() if len(points)]
        finite_curves = [points[np.isfinite(points).all(axis=1)] for points in curves.values()]
        point_sets += finite_curves
        ends = [points[-1] for points in finite_curves if len(points)]
        if ends:  # the label is at the largest x and the largest y of the ends
            x, y = np.max(ends, axis=0).tolist()
            labels.append(Label(summary.write_length(shape.deflection), x, y, (5.0, 0.0)))
    points = np.concatenate(point_sets)
    low, high = points.min(axis=0), points.max(axis=0)
    margin_length = margin * max(float(np.max(high - low)), 1.0 / summary.DEFLECTION.factor)
    left, bottom = low - margin_length
    right, top = high + np.array([2.5 * margin_length, margin_length])
    x_axis = Axis("Along the undeformed wire, x", summary.DEFLECTION, left, right)
    y_axis = Axis("Towards the pull, y", summary.DEFLECTION, bottom, top)
    aspect = min(max((top - bottom) / (right - left), min_aspect), max_aspect)
    height = frame_mm + (plots.SINGLE_COLUMN - frame_mm) * aspect
    note = "Markers are on the surface of the wire; the curves are its axis."
    panels = [Plot(x_axis, y_axis, lines, labels=labels, is_to_scale=True)]
    return Page(name, title, panels, note, height, plots.SINGLE_COLUMN)


MIN_RESIDUAL_BLOCKS = 25
"""Smallest number of blocks of points whose residuals are averaged."""
_DEFLECTIONS = Axis("Tip deflection", summary.DEFLECTION, low=0.0)


def make_calibration_page(
    calibration: Calibration, *, predictions: Mapping[float, Prediction] | None = None
) -> Page:
    """Make the page of a calibration, for A4 in portrait format.

    Parameters
    ----------
    calibration : calibration of one wire
    predictions : predictions of the model, keyed by the length of the tests in m, for the band of
        the model; None for no band

    Returns
    -------
    A page with (a) the first loadings and the model, (b) the residuals, (c) the residuals with a
    factor for each sample, (d) to (f) the profiles of the parameters. The footnote gives the values
    and verdicts.
    """
    row_heights = (58.0, 34.0, 32.0)  # mm
    frame_mm = 16.5  # room for the headings and labels of a row
    factor_heading = "residuals with each sample's own factor"
    panels = [
        _make_loading_plot(calibration, predictions or {}),
        make_residual_plot(calibration, "residuals"),
        make_residual_plot(calibration, factor_heading, has_sample_factors=True),
        *map(make_profile_plot, calibration.parameters, ("friction", "insulation", "copper")),
    ]
    parameters = map(summary.write_parameter, calibration.parameters)
    numbers = [
        f"{name}: {value}{f' {unit}'.removesuffix(' 1')} (95 %: {interval}), {verdict}."
        for name, value, interval, unit, verdict in parameters
    ]
    residual_note = "Residuals: points faint, means of neighbouring points as lines."
    residual_note += "" if predictions else " The band of the model is not drawn."
    note = "\n".join([*numbers, *summary.describe_calibration(calibration), residual_note])
    count = write_count(calibration.n_samples, "sample")
    title = f"{calibration.wire}  ·  calibration of the wire model  ·  {count}"
    layout, height = "aaaaaa;bbbccc;ddeeff", sum(row_heights) + frame_mm * len(row_heights)
    return Page("calibration", title, panels, note, height, layout=layout, heights=row_heights)


def _choose_length_looks(calibration: Calibration) -> dict[float, dict[str, Any]]:
    """Choose a colour and a dash for each length of samples; the colours differ in brightness."""
    colours = ("#555555", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#D55E00")
    lengths = sorted({curve.length for curve in calibration.curves})
    return {
        length: {"color": colours[number % len(colours)], "linestyle": choose_dash(number)}
        for number, length in enumerate(lengths)
    }


def _make_loading_plot(calibration: Calibration, predictions: Mapping[float, Prediction]) -> Plot:
    """Make the panel of the first loadings, and of the model with its band for each length."""
    lines, labels = [], []
    for length, settings in _choose_length_looks(calibration).items():
        curves = [curve for curve in calibration.curves if curve.length == length]
        label = f"measured, {summary.write_length(length)} ({len(curves)})"
        for curve in curves:
            x, y = curve.deflection, curve.force
            look = {"label": label, **settings}
            lines.append(make_thinned_line("measured_loading", x, y, n_bins=120, **look))
        longest_curve = max(curves, key=lambda curve: float(np.max(curve.deflection)))
        order = np.argsort(longest_curve.deflection)
        deflection, force = longest_curve.deflection[order], longest_curve.model[order]
        lines.append(make_line("model_of_sample", deflection, force))
        labels.append(Label(summary.write_length(length), deflection[-1], force[-1], (3.0, 0.0)))
        if length in predictions:
            model = predictions[length]
            is_measured = model.deflection <= deflection[-1]
            band = model.deflection, model.lower_mean, model.upper_mean
            measured_band = (values[is_measured] for values in band)
            lines.append(plots.make_area("band_of_mean_sample", *measured_band))
    y_axis = Axis("Force", summary.FORCE, min([0.0, *(float(np.nanmin(line.y)) for line in lines)]))
    return Plot(_DEFLECTIONS, y_axis, lines, "first loadings", labels)


def make_residual_plot(
    calibration: Calibration, heading: str, *, has_sample_factors: bool = False
) -> Plot:
    """Make the panel of the measured force minus the force of the model against deflection.

    Parameters
    ----------
    calibration : curves of the tests and of the model
    heading : heading of the panel
    has_sample_factors : whether the model is multiplied by the factor of each sample; the residuals
        are then noise and errors of the shape of the curve

    Notes
    -----
    All points are drawn faintly. A line shows the means of blocks of neighbouring points. There are
    at least `MIN_RESIDUAL_BLOCKS` blocks, if there are as many points.
    """
    settings_by_length = _choose_length_looks(calibration)
    lines = [plots.make_horizontal_line("no_residual", 0.0)]
    for curve in calibration.curves:
        factor = curve.sample_factor if has_sample_factors else 1.0
        settings = settings_by_length[curve.length]
        x, y = curve.deflection, curve.force - factor * curve.model
        means = (average_blocks(values, MIN_RESIDUAL_BLOCKS) for values in (x, y))
        lines.append(make_thinned_line("residual", x, y, n_bins=120, **settings))
        lines.append(make_line("mean_residual", *means, **settings))
    return Plot(_DEFLECTIONS, Axis("Measured \u2212 model", summary.SMALL_FORCE), lines, heading)


def make_profile_plot(parameter: CalibratedParameter, heading: str = "") -> Plot:
    """Make the panel of the deviance of a parameter against its value on a logarithmic axis.

    Parameters
    ----------
    parameter : parameter of the calibration; without profiles, the panel explains why it was not
        fitted
    heading : heading of the panel

    Notes
    -----
    Dashed lines are the thresholds on both sides of each solution. The 95 % interval is grey; an
    open interval extends to the end of the panel. A filled triangle is the value, an open triangle
    another solution. If the parameter has a prior, the deviance from the centre of the prior is
    also drawn.
    """
    normal_quantile = 1.959963984540054  # of the probability 0.975, for a 95 % interval
    if not parameter.profiles:
        return Plot(heading=heading, reason=summary.typeset(parameter.explanation))
    low, high = find_panel_range(parameter)
    lines, last_number = [], len(parameter.intervals) - 1
    for number, interval in enumerate(parameter.intervals):
        start = low if number == 0 and parameter.is_open_below else interval.lower
        stop = high if number == last_number and parameter.is_open_above else interval.upper
        lines.append(plots.make_span("interval_of_parameter", start, stop))
    minima = sorted(_find_minimum(profile)[0] for profile in parameter.profiles)
    borders = [low, *np.sqrt(np.array(minima[1:]) * np.array(minima[:-1])).tolist(), high]
    for profile in parameter.profiles:
        best, height = _find_minimum(profile)
        solution = minima.index(best)
        lines.append(make_line("profile", *interpolate_profile(profile)))
        lines.append(make_line("profile_point", profile.value, profile.deviance))
        lines.append(make_line("threshold", [borders[solution], best], profile.threshold_below))
        lines.append(make_line("threshold", [best, borders[solution + 1]], profile.threshold_above))
        if height > 0.0:
            lines.append(make_line("best_value", best, height, markerfacecolor="white"))
    lines.append(make_line("best_value", parameter.value, 0.0))
    if parameter.conflict is not None:
        values: Floats = np.geomspace(low, high, 200)
        standard_error = np.log(parameter.conflict.factor) / normal_quantile
        deviation = np.log(values / parameter.conflict.centre) / standard_error
        lines.append(make_line("prior", values, deviation**2))
    label, scale = summary.LABELS[parameter.name], summary.SCALES[parameter.name]
    x_axis = Axis(label, scale, low, high, is_log=True)
    return Plot(x_axis, Axis("Deviance", low=0.0, high=_find_panel_top(parameter)), lines, heading)


def _find_panel_top(parameter: CalibratedParameter) -> float:
    """Return the deviance at the top of the panel of a parameter."""
    threshold_factor = 2.6  # shows the profiles well above their thresholds
    ends = (max(profile.threshold_below, profile.threshold_above) for profile in parameter.profiles)
    return threshold_factor * max(ends)


def _find_minimum(profile: Profile) -> tuple[float, float]:
    """Return value and deviance of the solution from which a profile was traced."""
    number = int(np.argmin(profile.deviance))
    return float(profile.value[number]), float(profile.deviance[number])


def find_panel_range(parameter: CalibratedParameter) -> tuple[float, float]:
    """Return the range of values that the panel of a parameter shows, SI.

    Parameters
    ----------
    parameter : parameter with at least one profile

    Returns
    -------
    Lower and upper end. The range includes the value, the points of the profiles below the top of
    the panel, the ends of the interval within the profiles, and the centre of the prior.
    """
    margin_fraction = 0.12  # of the range of the logarithms of the values
    min_range = 0.02  # of the logarithms
    top, profiles = _find_panel_top(parameter), parameter.profiles
    values = [value for profile in profiles for value in profile.value[profile.deviance <= top]]
    values.append(parameter.value)
    lowest = min(profile.value[0] for profile in profiles)
    highest = max(profile.value[-1] for profile in profiles)
    ends = [end for interval in parameter.intervals for end in (interval.lower, interval.upper)]
    values += [end for end in ends if lowest <= end <= highest]
    if parameter.conflict is not None:
        values.append(parameter.conflict.centre)
    low, high = float(np.log(min(values))), float(np.log(max(values)))
    margin = margin_fraction * max(high - low, min_range)
    return float(np.exp(low - margin)), float(np.exp(high + margin))


def interpolate_profile(profile: Profile) -> tuple[Floats, Floats]:
    """Interpolate a profile between its points.

    Parameters
    ----------
    profile : profile of at least one point

    Returns
    -------
    Values and deviances. The signed square root of the deviance above its minimum is interpolated
    linearly over the logarithm of the value. If this logarithm is normally distributed, the root is
    a straight line.
    """
    n_fine_points = 200
    logs, (best, height) = np.log(profile.value), _find_minimum(profile)
    sign = np.sign(logs - np.log(best))
    fine_logs: Floats = np.union1d(np.linspace(logs[0], logs[-1], n_fine_points), logs)
    root = np.interp(fine_logs, logs, sign * np.sqrt(np.maximum(profile.deviance - height, 0.0)))
    return np.exp(fine_logs), root**2 + height


def make_validation_page(name: str, groups: Sequence[summary.ValidationGroup]) -> Page:
    """Make the page of measured and modelled force against deflection, a panel per group.

    Parameters
    ----------
    name : name of the files, without the ending
    groups : 1 to `MAX_PANELS` groups of tests, each of one wire and one length
    """
    row_mm, columns = 66.0, 2
    height, panels = row_mm * math.ceil(len(groups) / columns), list(map(_make_group_plot, groups))
    title = "Measured and predicted first loadings"
    return Page(name, title, panels, _describe_bands(groups), height)


def _make_group_plot(group: summary.ValidationGroup) -> Plot:
    """Make the panel of samples, mean and model with their bands and a label on the agreement.

    The model is drawn lighter where it is doubtful.
    """
    samples, lines = group.samples.values(), list[Line]()
    for sample in samples:
        x, y = sample.displacement, sample.force
        lines.append(make_thinned_line("measured_sample", x, y, n_bins=100))
    lines += _plot_mean(group.band)
    model = group.prediction
    for part, opacity in plots.split_doubtful(group.is_reliable):
        if model is None:
            break
        x, low, high = (values[part] for values in (model.deflection, model.lower, model.upper))
        lines.append(make_line("model", x, model.force[part], alpha=opacity))
        lines.append(plots.make_area("band_of_model", x, low, high, alpha=_BAND_OPACITY * opacity))
        lines += [make_line("edge_of_band", x, edge, alpha=opacity) for edge in (low, high)]
    label = Label(_wrap(describe_agreement(group)), -np.inf, np.inf, (4.0, -2.0), {"va": "top"})
    use = "calibrated" if group.is_calibrated else "predicted"
    heading = f"{group.wire}, {summary.write_length(group.length)}: {use}"
    forces = [group.band.mean, *(sample.force for sample in samples)]
    force = _make_force_axis(lines, forces, _HEADROOM)
    return Plot(_DEFLECTIONS, force, lines, heading, [label])


def _make_force_axis(lines: Sequence[Line], forces: Sequence[Floats], headroom: float) -> Axis:
    """Make the axis of force from the lowest force, at most zero, to above all lines.

    Parameters
    ----------
    lines : lines of the panel
    forces : arrays of forces, N, that are shown completely
    headroom : ratio of the top of the axis to the largest value of the lines
    """
    shown_forces = np.concatenate([np.zeros(1), *forces])
    heights = np.concatenate([np.zeros(1), *(line.y for line in lines)])
    lowest = np.min(shown_forces[np.isfinite(shown_forces)])
    highest = np.max(heights[np.isfinite(heights)])
    return Axis("Force", summary.FORCE, float(lowest), headroom * float(highest))


def describe_agreement(group: summary.ValidationGroup) -> list[str]:
    """Describe the agreement of the model with a group of tests in short texts.

    Parameters
    ----------
    group : samples and prediction; without a prediction, the texts give the reason
    """
    texts = [write_count(len(group.samples), "sample")]
    if not np.isfinite(group.band.lower).any():
        texts[0] += ", no band of the mean"
    errors = group.errors
    if errors is None:
        return [*texts, f"No prediction. {join_sentences([group.reason])}".strip()]
    rmse = summary.SMALL_FORCE.factor * errors.rmse
    percentage = summary.write_percent(errors.rmse_share)
    texts.append(f"RMSE {rmse:.3g} {summary.SMALL_FORCE.unit}, {percentage} of the largest force")
    if math.isfinite(errors.inside):
        texts.append(f"{summary.write_percent(errors.inside)} of the points inside the band")
    return texts


def _plot_mean(band: Band) -> list[Line]:
    """Plot the mean of the samples and its 95 % band, if any."""
    lines = [make_line("mean_of_samples", band.displacement, band.mean)]
    if np.isfinite(band.lower).any():
        lines.append(plots.make_area("band_of_mean", band.displacement, band.lower, band.upper))
    return lines


_BAND_OPACITY = 0.5


def _describe_bands(groups: Sequence[summary.ValidationGroup]) -> str:
    """Describe the bands in the panels of groups, and join the notes on the predictions."""
    sentences = ["Grey band: mean of the samples, Student's t with n - 1 degrees of freedom."]
    if any(len(group.samples) < 2 for group in groups):
        sentences.append("One sample has no band.")
    if any(group.prediction is not None for group in groups):
        sentences.append("Blue band: model, for one more sample.")
    if not all(group.is_reliable.all() for group in groups):
        sentences.append(format_sentence("report.doubtful_model"))
    predictions = (group.prediction for group in groups if group.prediction is not None)
    sentences.append(join_sentences(note for model in predictions for note in model.notes))
    return " ".join(filter(None, sentences))


_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
_MARKS = ("o", "s", "^", "D", "v")


class ExternalPanel(NamedTuple):
    """External curves of one wire, length and kind of load, in one panel.

    Parameters
    ----------
    wire : name of the wire
    length : length of the specimen, m
    is_normal : whether the load stays normal to the undeformed axis, in the curves and in the model
    group : tests of that wire and length; None if there are none
    comparisons : comparisons of the external curves with tests and model
    """

    wire: str
    length: float
    is_normal: bool
    group: summary.ValidationGroup | None
    comparisons: tuple[ExternalCurveComparison, ...]

    @property
    def prediction(self) -> Prediction | None:
        """Prediction up to the largest deflection; None if no curve has one."""
        models = filter(None, (comparison.prediction for comparison in self.comparisons))
        return max(models, key=lambda model: float(model.deflection[-1]), default=None)


def group_external_curves(report: summary.CalibrationReport) -> list[Sequence[ExternalPanel]]:
    """Group external curves by wire, length and kind of load; split the panels into pages.

    Parameters
    ----------
    report : calibration, tests and external curves

    Returns
    -------
    Panels of each page.
    """
    comparisons: dict[tuple[str, float, bool], list[ExternalCurveComparison]] = {}
    for comparison in report.comparisons:
        curve = comparison.curve
        key = (curve.wire, round(curve.length, 6), curve.is_normal)
        comparisons.setdefault(key, []).append(comparison)
    groups = {(group.wire, round(group.length, 6)): group for group in report.groups}
    items = comparisons.items()
    panels = [ExternalPanel(*key, groups.get(key[:2]), tuple(curves)) for key, curves in items]
    return split_pages(panels, MAX_PANELS)


def make_external_page(name: str, panels: Sequence[ExternalPanel]) -> Page:
    """Make the page of external curves, tests and model, a panel per wire, length and load.

    Parameters
    ----------
    name : name of the files, without the ending
    panels : 1 to `MAX_PANELS` panels
    """
    row_mm, columns = 70.0, 2
    spare_key_rows = 4  # rows of a key for which a panel has room above the curves
    key_rows = [sum(1 + label.count("\n") for label in _label_curves(panel)) for panel in panels]
    extra_rows = [max(0, rows - spare_key_rows) for rows in key_rows]
    height = (row_mm + 4.0 * max(extra_rows)) * math.ceil(len(panels) / columns)
    plots_of_panels = [
        _make_external_plot(panel, _HEADROOM + 0.06 * n_rows)
        for panel, n_rows in zip(panels, extra_rows, strict=True)
    ]
    title, note = "External curves, tests and model", _describe_external_bands(panels)
    return Page(name, title, plots_of_panels, note, height)


def _make_external_plot(panel: ExternalPanel, headroom: float) -> Plot:
    """Make the panel of tests and model with their bands, and of external curves.

    The key in the panel gives the RMSE of each external curve to the tests and to the model.
    """
    lines = [] if panel.group is None else _plot_mean(panel.group.band)
    model = panel.prediction
    if model is not None:
        edges = model.deflection, model.lower_mean, model.upper_mean
        lines.append(make_line("model", model.deflection, model.force))
        lines.append(plots.make_area("band_of_model", *edges, alpha=_BAND_OPACITY))
    for number, comparison in enumerate(panel.comparisons):
        curve = comparison.curve
        colour, mark = _COLOURS[number % len(_COLOURS)], _MARKS[number % len(_MARKS)]
        mark_spacing = max(1, len(curve.force) // 14)
        settings: dict[str, Any] = {"color": colour, "marker": mark, "markevery": mark_spacing}
        lines.append(make_line("external_curve", curve.deflection, curve.force, **settings))
    load = ", load normal to the axis" if panel.is_normal else ""
    heading = f"{panel.wire}, {summary.write_length(panel.length)}{load}"
    force = _make_force_axis(lines, [line.y for line in lines], headroom)
    return Plot(_DEFLECTIONS, force, lines, heading, inner_key=_label_curves(panel))


def _label_curves(panel: ExternalPanel) -> list[str]:
    return [_wrap(describe_match(comparison)) for comparison in panel.comparisons]


def _wrap(texts: Sequence[str]) -> str:
    max_length = 48
    return "\n".join(line for text in texts for line in textwrap.wrap(text, max_length))


def describe_match(comparison: ExternalCurveComparison) -> list[str]:
    """Name an external curve and write its RMSE against the tests and the model.

    Parameters
    ----------
    comparison : comparison of the external curve with tests and model
    """
    tests = comparison.tests
    tests_text = "no tests to compare" if tests is None else _describe_rmse("tests", tests)
    return [comparison.curve.name, tests_text, _describe_rmse("model", comparison.model)]


def _describe_rmse(reference: str, match: CurveMatch) -> str:
    if match.errors is None:
        return f"{reference}: not compared"
    rmse = summary.SMALL_FORCE.factor * match.errors.rmse
    percentage = summary.write_percent(match.errors.rmse_share)
    return f"{reference}: RMSE {rmse:.3g} {summary.SMALL_FORCE.unit}, {percentage} of peak"


def _describe_external_bands(panels: Sequence[ExternalPanel]) -> str:
    """Describe the bands in the panels of external curves, and join the notes on the curves."""
    sentences = []
    if any(panel.group is not None for panel in panels):
        sentences.append("Grey band: mean of the tests, Student's t with n - 1 degrees of freedom.")
    if any(panel.prediction is not None for panel in panels):
        sentences.append("Blue band: model, for the mean sample.")
    sentences.append("Peak: largest reference force at the compared points.")
    comparisons = [comparison for panel in panels for comparison in panel.comparisons]
    notes = [note for comparison in comparisons for note in comparison.notes]
    if any(note.code == "external_curve_load" for note in notes):
        sentences.append("Where the load is normal to the axis, the load of the tests is not.")
    for comparison in comparisons:
        other_notes = [note for note in comparison.notes if note.code != "external_curve_load"]
        sentences += [f"'{comparison.curve.name}': {note.message}." for note in other_notes]
    return " ".join(sentences)
