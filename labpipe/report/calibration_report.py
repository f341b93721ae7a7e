"""Describe a calibration of the wire model in sentences, and make its figures and workbook."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats, average_blocks
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.wire import (
    COPPER_SCALE,
    DISPLAY_UNITS,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibratedParameter,
    Calibration,
    CurveAgreement,
    CurveErrors,
    CurveMatch,
    ExternalCurveComparison,
    Prediction,
    Profile,
)
from labpipe.report import plot_records as plots
from labpipe.report import table_records as tables
from labpipe.report import wording
from labpipe.report.figure_page import N_COLOURS, choose_line_look, split_pages
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, make_line, make_thinned_line
from labpipe.report.wording import FORCE_SCALE, LENGTH_SCALE, Scale, format_count, format_number

SMALL_FORCE_SCALE = Scale(1e3, "mN")
_GREEK_LETTERS = {"phi": "\u03c6", "mu": "\u03bc"}
_POWER_OF_TEN = re.compile(r"(?<=\d)e([+-])0*(\d+)")
_LENGTH_HEADING = LENGTH_SCALE.label("length")

PARAMETER_LABELS: Mapping[str, str] = {
    RADIAL_FRICTION: "Friction \u03c6",
    INSULATION_MODULUS: "Insulation modulus",
    COPPER_SCALE: "Factor on copper strength",
}
PARAMETER_SCALES: Mapping[str, Scale] = {name: Scale(*unit) for name, unit in DISPLAY_UNITS.items()}
_PARAMETER_NAMES: Mapping[str, str] = {
    RADIAL_FRICTION: "phi",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
}


def typeset(sentence: str) -> str:
    """Typeset a sentence of a calibration.

    Parameters
    ----------
    sentence : sentence that names parameters by their keys

    Returns
    -------
    The sentence with a full stop. It starts with a capital letter unless it starts with a symbol.
    Names replace the keys of parameters; powers of ten and Greek letters are typeset.

    Examples
    --------
    >>> typeset("copper_scale was held")
    'The strength of the copper was held.'
    """

    def typeset_power(match: re.Match[str]) -> str:
        exponent = f"{match[1]}{match[2]}".removeprefix("+")
        return f" \u00d7 10{exponent.translate(wording.SUPERSCRIPTS)}"

    for key, parameter_name in _PARAMETER_NAMES.items():
        sentence = re.sub(rf"\b{key}\b", parameter_name, sentence)
    sentence = _POWER_OF_TEN.sub(typeset_power, sentence.strip().rstrip("."))
    starts_with_symbol = sentence.startswith(("phi", "mu_"))
    for letter_name, letter in _GREEK_LETTERS.items():
        sentence = re.sub(rf"\b{letter_name}(?=\b|_)", letter, sentence)
    return f"{sentence if starts_with_symbol else sentence[:1].upper() + sentence[1:]}."


def format_percent(ratio: float) -> str:
    """Format a ratio in per cent.

    The text has two significant digits below 10 % and three from 10 %, without trailing zeros in
    the fraction. A ratio that is not finite gives an empty text.

    Examples
    --------
    >>> format_percent(0.0193), format_percent(12.34), format_percent(math.nan)
    ('1.9 %', '1230 %', '')
    """
    digits = 3 if ratio >= 0.1 else 2
    return wording.format_percent(ratio, digits) if math.isfinite(ratio) else ""


def format_length(length: float) -> str:
    """Format a length in m as millimetres, such as ``85 mm``."""
    return f"{LENGTH_SCALE.factor * length:.4g} {LENGTH_SCALE.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class ValidationGroup:
    """Samples of one wire at one free length, and the prediction of the model.

    Parameters
    ----------
    wire : name of the wire
    length : free length, m
    is_calibrated : whether the model was calibrated with these samples
    samples : first loading of each sample, keyed by the name of its test
    band : mean of the samples with its 95 % bands, which are NaN for a single sample
    prediction : prediction of the model, with a band for one more sample; None if there is none
    errors : errors of the model at all points of the samples; None without a prediction
    reason : reason why there is no prediction; None with a prediction
    doubtful_deflection : deflection of the tip, m, beyond which the prediction is doubtful because
        the strain at the rim of the insulation exceeds the linear range; infinite if the whole
        prediction is reliable
    """

    wire: str
    length: float
    is_calibrated: bool
    samples: Mapping[str, SampleCurve]
    band: Band
    prediction: Prediction | None = None
    errors: CurveErrors | None = None
    reason: Reason | None = None
    doubtful_deflection: float = math.inf

    @property
    def heading(self) -> str:
        """Wire, length, and whether the model was calibrated, such as ``A2, 85 mm: predicted``."""
        model_use = "calibrated" if self.is_calibrated else "predicted"
        return f"{self.wire}, {format_length(self.length)}: {model_use}"

    @property
    def is_reliable(self) -> Flags:
        """Whether each predicted point is within `doubtful_deflection`; empty without one."""
        deflection = np.zeros(0) if self.prediction is None else self.prediction.deflection
        return np.asarray(deflection <= self.doubtful_deflection)


@dataclass(frozen=True, slots=True, eq=False)
class BentShape(ArrayRecord):
    """Shape of a sample at one deflection of its tip.

    The columns of each array, in m, are x, along the undeformed wire, and y, in the direction of
    the pull.

    Parameters
    ----------
    deflection : deflection of the tip, m
    markers : measured positions of the markers, shape (n_markers, 2); NaN where not tracked
    fit : points of the curve fitted to the markers, shape (n, 2); empty without a fit
    model : points of the axis of the wire in the model, shape (n, 2); empty without a model
    """

    deflection: float
    markers: Annotated[Floats, "marker", 2]
    fit: Annotated[Floats, "point of the fit", 2]
    model: Annotated[Floats, "point of the model", 2]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """Contents of the figures and the workbook of a calibration.

    Parameters
    ----------
    calibration : calibration of one wire
    groups : tests of each wire and length with which the model is compared, including those of the
        calibration
    shapes : shapes of a test at several deflections, keyed by the name of the test
    comparisons : comparisons of the external curves with tests and model
    """

    calibration: Calibration
    groups: tuple[ValidationGroup, ...] = ()
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    comparisons: tuple[ExternalCurveComparison, ...] = ()

    @property
    def predictions(self) -> dict[float, Prediction]:
        """Predictions for the tests of the calibration, keyed by free length in m."""
        return {
            group.length: group.prediction
            for group in self.groups
            if group.is_calibrated and group.prediction is not None
        }


_PARAMETER_CODES = frozenset({"at_bound", "not_identified", "prior_contradicts_data"})
"""Codes of the notes that repeat a sentence on a parameter."""


def format_parameter(parameter: CalibratedParameter) -> str:
    """Format the name, value, unit, 95 % interval and verdict of a parameter in one line.

    The value has two significant digits if its interval is open on either side.

    Parameters
    ----------
    parameter : parameter of a calibration
    """
    factor, unit = PARAMETER_SCALES[parameter.name]
    value, intervals = parameter.value, parameter.intervals
    candidates = (interval for interval in intervals if interval.lower <= value <= interval.upper)
    number = format_number(value, next(candidates, parameter.interval), factor)
    if parameter.is_open_below or parameter.is_open_above:
        number = format_number(value, None, factor, digits=2)
    quantity = f"{PARAMETER_LABELS[parameter.name]}: {number.value} {unit}".strip()
    return f"{quantity} (95 %: {format_intervals(parameter)}), {parameter.verdict}"


def format_intervals(parameter: CalibratedParameter) -> str:
    """Format the 95 % interval of a parameter, with the digits that its width supports.

    Parameters
    ----------
    parameter : parameter of a calibration

    Returns
    -------
    ``lower to upper``, ``below upper``, ``above lower`` or ``open on both sides``. Separate
    intervals are joined by ``or``. Without an interval, the text is a dash.
    """
    interval_texts, last_index = [], len(parameter.intervals) - 1
    for index, interval in enumerate(parameter.intervals):
        nearest_value = min(max(parameter.value, interval.lower), interval.upper)
        number = format_number(nearest_value, interval, PARAMETER_SCALES[parameter.name].factor)
        text_by_openness = {
            (False, False): number.interval,
            (True, False): f"below {number.upper}",
            (False, True): f"above {number.lower}",
            (True, True): "open on both sides",
        }
        is_open_below = index == 0 and parameter.is_open_below
        is_open_above = index == last_index and parameter.is_open_above
        interval_texts.append(text_by_openness[is_open_below, is_open_above])
    return " or ".join(interval_texts) or "\u2013"


def describe_calibration(calibration: Calibration) -> list[str]:
    """Describe the results of a calibration in sentences.

    Parameters
    ----------
    calibration : results of the calibration

    Returns
    -------
    Sentences on each parameter and its prior, on the agreement with the tests, the noise and the
    parameters that are not identified separately. Warnings and errors follow, except those that
    repeat a sentence on a parameter.
    """
    sentences = []
    for parameter in calibration.parameters:
        sentences.append(typeset(parameter.explanation))
        if parameter.conflict is not None:
            sentences.append(typeset(parameter.conflict.message))
    counts = {
        "point": calibration.n_points,
        "curve": len(calibration.curves),
        "sample": calibration.n_samples,
    }
    agreement = format_sentence(
        "report.agreement_with_curves",
        rmse=SMALL_FORCE_SCALE.factor * calibration.rmse,
        share=format_percent(calibration.rmse_share),
        counts=" of ".join(format_count(count, noun) for noun, count in counts.items()),
    )
    levels = calibration.levels
    scatter_text = f"The force scatters by {format_percent(levels.scatter)} between samples"
    if levels.scatter_freedom == 0.0:
        scatter_text = "The scatter of the samples is not known"
    facts = {"scatter": scatter_text, "gain": format_percent(levels.gain), "levels": levels}
    sentences.append(agreement)
    sentences.append(format_sentence("report.noise_of_calibration", **facts))
    if np.isfinite(calibration.get_parameter(RADIAL_FRICTION).value):
        sentences.append(typeset("mu_s, mu_p and F_rad are not identified separately, only phi"))
    if not all(calibration.separability.are_identified.values()):
        sentences.append(typeset(calibration.separability.explanation))
    return sentences + [
        f"Note: {typeset(note.message)}"
        for note in calibration.notes
        if note.code not in _PARAMETER_CODES and note.severity is not Severity.INFO
    ]


MAX_PANELS = 6
"""Largest number of panels on a page of the validation or of external curves."""


def list_calibration_figures(report: CalibrationReport) -> Iterator[Page]:
    """List the figures of a calibration.

    Parameters
    ----------
    report : contents of the figures

    Yields
    ------
    ``calibration``; ``validation-1``, ``validation-2`` and so on, with up to `MAX_PANELS` panels
    each; ``external-curves``, ``external-curves-2`` and so on if external curves are compared;
    ``shapes-1`` and so on, one for each test in `report.shapes`.
    """
    yield make_calibration_page(report.calibration, predictions=report.predictions)
    for index, groups in enumerate(split_pages(report.groups, MAX_PANELS), start=1):
        yield make_validation_page(f"validation-{index}", groups)
    for index, panels in enumerate(group_external_curves(report), start=1):
        name = "external-curves" if index == 1 else f"external-curves-{index}"
        yield make_external_page(name, panels)
    for index, (test, shapes) in enumerate(report.shapes.items(), start=1):
        yield make_bent_shapes_page(f"shapes-{index}", test, shapes)


def make_bent_shapes_page(name: str, test: str, shapes: Sequence[BentShape]) -> Page:
    """Make the page of the shapes of a test at several deflections, with one scale on both axes.

    Parameters
    ----------
    name : file name without its extension
    test : name of the test
    shapes : shape at each deflection; if there are none, the page states this
    """
    margins_mm = 14.0  # width and height of the tick labels and the axis labels beside the panel
    title = f"{test}  \u00b7  shapes at {len(shapes)} deflections of the tip"
    if not shapes:
        panels = [Plot(reason="There is no shape to draw.")]
        return Page(name, title, panels, height=40.0, width=plots.SINGLE_COLUMN)
    lines, labels, point_arrays = [], [], [np.zeros((1, 2))]
    for shape in shapes:
        curves = {
            "shape_markers": shape.markers,
            "shape_fit": shape.fit,
            "shape_model": shape.model,
        }
        lines += [make_line(look, *points.T) for look, points in curves.items() if len(points)]
        finite_curves = [points[np.isfinite(points).all(axis=1)] for points in curves.values()]
        point_arrays += finite_curves
        end_points = [points[-1] for points in finite_curves if len(points)]
        if end_points:  # the label is at the largest x and the largest y of the end points
            x, y = np.max(end_points, axis=0).tolist()
            labels.append(Label(format_length(shape.deflection), x, y, (5.0, 0.0)))
    axis_names = "Along the undeformed wire, x", "Towards the pull, y"
    all_points = np.concatenate(point_arrays)
    x_axis, y_axis = plots.make_axes_to_scale(axis_names, LENGTH_SCALE, all_points, min_aspect=0.35)
    aspect = (y_axis.high - y_axis.low) / (x_axis.high - x_axis.low)
    height = margins_mm + (plots.SINGLE_COLUMN - margins_mm) * aspect
    note = "Markers are on the surface of the wire; the curves are its axis."
    panels = [Plot(x_axis, y_axis, lines, labels=labels, is_to_scale=True)]
    return Page(name, title, panels, note=note, height=height, width=plots.SINGLE_COLUMN)


MIN_RESIDUAL_BLOCKS = 25
"""Smallest number of blocks of neighbouring points over which residuals are averaged."""
_DEFLECTION_AXIS = Axis("Tip deflection", LENGTH_SCALE, low=0.0)


def make_calibration_page(
    calibration: Calibration, *, predictions: Mapping[float, Prediction] | None = None
) -> Page:
    """Make the page of a calibration, for A4 in portrait format.

    Parameters
    ----------
    calibration : calibration of one wire
    predictions : predictions whose bands are drawn, keyed by free length in m; None for no bands

    Returns
    -------
    A page with (a) the first loadings and the model, (b) the residuals, (c) the residuals with a
    factor for each sample on the model, (d) to (f) the profiles of the parameters. The footnote
    gives the parameters with their intervals, and describes the calibration.
    """
    row_heights = (58.0, 34.0, 32.0)  # mm
    label_height = 16.5  # mm, of the headings and the axis labels of a row
    factor_heading = "residuals with each sample's own factor"
    panels = [
        _make_loading_plot(calibration, predictions or {}),
        make_residual_plot(calibration, "residuals"),
        make_residual_plot(calibration, factor_heading, has_sample_factors=True),
        *map(make_profile_plot, calibration.parameters, ("friction", "insulation", "copper")),
    ]
    parameter_texts = [f"{format_parameter(parameter)}." for parameter in calibration.parameters]
    residual_note = "Residuals: points are faint, lines are means of neighbouring points."
    residual_note += "" if predictions else " The band of the model is not drawn."
    sample_count = format_count(calibration.n_samples, "sample")
    title = f"{calibration.wire}  ·  calibration of the wire model  ·  {sample_count}"
    note = "\n".join([*parameter_texts, *describe_calibration(calibration), residual_note])
    layout: dict[str, Any] = {"layout": "aaaaaa;bbbccc;ddeeff", "heights": row_heights}
    layout["height"] = sum(row_heights) + label_height * len(row_heights)
    return Page("calibration", title, panels, note, **layout)


def _choose_length_looks(calibration: Calibration) -> dict[float, dict[str, Any]]:
    """Choose a colour and a dash for each free length that differ from those of the model."""
    lengths = sorted({curve.length for curve in calibration.curves})
    return {length: choose_line_look(index) for index, length in enumerate(lengths, start=1)}


def _make_loading_plot(calibration: Calibration, predictions: Mapping[float, Prediction]) -> Plot:
    """Make the panel of the first loadings, and of the model with its band for each length.

    The model is drawn at the points of the curve that reaches the largest deflection.
    """
    lines, labels = [], []
    for length, line_look in _choose_length_looks(calibration).items():
        curves = [curve for curve in calibration.curves if curve.length == length]
        key_text = f"measured, {format_length(length)} ({len(curves)})"
        for curve in curves:
            x, y = curve.deflection, curve.force
            line_settings = {"label": key_text, **line_look}
            lines.append(make_thinned_line("measured_loading", x, y, n_bins=120, **line_settings))
        widest_curve = max(curves, key=lambda curve: float(np.max(curve.deflection)))
        order = np.argsort(widest_curve.deflection)
        deflection, force = widest_curve.deflection[order], widest_curve.model[order]
        lines.append(make_line("model_of_sample", deflection, force))
        labels.append(Label(format_length(length), deflection[-1], force[-1], (3.0, 0.0)))
        if length in predictions:
            prediction = predictions[length]
            is_drawn = prediction.deflection <= deflection[-1]
            band = prediction.deflection, prediction.lower_mean, prediction.upper_mean
            drawn_band = (values[is_drawn] for values in band)
            lines.append(plots.make_area("band_of_mean_sample", *drawn_band))
    lowest_force = min([0.0, *(float(np.nanmin(line.y)) for line in lines)])
    y_axis = Axis("Force", FORCE_SCALE, low=lowest_force)
    return Plot(_DEFLECTION_AXIS, y_axis, lines, heading="first loadings", labels=labels)


def make_residual_plot(
    calibration: Calibration, heading: str, *, has_sample_factors: bool = False
) -> Plot:
    """Make the panel of the residuals, measured force minus force of the model, over deflection.

    Parameters
    ----------
    calibration : curves of the tests and of the model
    heading : heading of the panel
    has_sample_factors : whether the model is multiplied by the factor of each sample. The residuals
        then consist of noise and of errors in the shape of the curve

    Notes
    -----
    Points are drawn faintly and thinned. A line shows the means of blocks of neighbouring points.
    There are at least `MIN_RESIDUAL_BLOCKS` blocks if there are at least as many points.
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
    return Plot(_DEFLECTION_AXIS, Axis("Measured \u2212 model", SMALL_FORCE_SCALE), lines, heading)


def make_profile_plot(parameter: CalibratedParameter, heading: str = "") -> Plot:
    """Make the panel of the deviance against the value of a parameter, on a logarithmic axis.

    Parameters
    ----------
    parameter : parameter of the calibration; if it has no profile, the panel gives its explanation
    heading : heading of the panel

    Notes
    -----
    Dashed lines are the thresholds on both sides of each solution. The 95 % interval is grey; an
    open interval extends to the end of the panel. A filled triangle marks the value, an open
    triangle another solution. If the parameter has a prior, the deviance due to the prior is also
    drawn.
    """
    normal_quantile = 1.959963984540054  # standard normal, at probability 0.975
    if not parameter.profiles:
        return Plot(heading=heading, reason=typeset(parameter.explanation))
    low, high = compute_panel_range(parameter)
    lines, last_index = [], len(parameter.intervals) - 1
    for index, interval in enumerate(parameter.intervals):
        start = low if index == 0 and parameter.is_open_below else interval.lower
        stop = high if index == last_index and parameter.is_open_above else interval.upper
        lines.append(plots.make_span("interval_of_parameter", start, stop))
    solutions = sorted(_get_minimum(profile)[0] for profile in parameter.profiles)
    middles = np.sqrt(np.array(solutions[1:]) * np.array(solutions[:-1])).tolist()
    borders = [low, *middles, high]
    for profile in parameter.profiles:
        solution, min_deviance = _get_minimum(profile)
        index = solutions.index(solution)
        lines.append(make_line("profile", *interpolate_profile(profile)))
        lines.append(make_line("profile_point", profile.value, profile.deviance))
        lines.append(make_line("threshold", [borders[index], solution], profile.threshold_below))
        lines.append(
            make_line("threshold", [solution, borders[index + 1]], profile.threshold_above)
        )
        if min_deviance > 0.0:
            lines.append(make_line("best_value", solution, min_deviance, markerfacecolor="white"))
    lines.append(make_line("best_value", parameter.value, 0.0))
    if parameter.conflict is not None:
        values: Floats = np.geomspace(low, high, 200)
        log_standard_error = np.log(parameter.conflict.factor) / normal_quantile
        deviation = np.log(values / parameter.conflict.centre) / log_standard_error
        lines.append(make_line("prior", values, deviation**2))
    label, scale = PARAMETER_LABELS[parameter.name], PARAMETER_SCALES[parameter.name]
    x_axis = Axis(label, scale, low, high, is_log=True)
    y_axis = Axis("Deviance", low=0.0, high=_compute_panel_top(parameter))
    return Plot(x_axis, y_axis, lines, heading)


def _compute_panel_top(parameter: CalibratedParameter) -> float:
    """Compute the deviance at the top of the panel of a parameter."""
    threshold_factor = 2.6  # top of the panel, relative to the highest threshold
    profiles = parameter.profiles
    return threshold_factor * max(max(p.threshold_below, p.threshold_above) for p in profiles)


def _get_minimum(profile: Profile) -> tuple[float, float]:
    """Get the value of the parameter and the deviance at the minimum of a profile."""
    index = int(np.argmin(profile.deviance))
    return float(profile.value[index]), float(profile.deviance[index])


def compute_panel_range(parameter: CalibratedParameter) -> tuple[float, float]:
    """Compute the range of values that the panel of a parameter shows.

    Parameters
    ----------
    parameter : parameter with at least one profile

    Returns
    -------
    Lower and upper end, SI. The range includes, with a margin, the value, the profiles up to the
    top of the panel, and the centre of the prior.
    """
    margin_fraction = 0.12  # margin at each end, relative to the range of the logarithms
    min_log_range = 0.02  # a narrower range has the margin of this range
    values, top = [parameter.value], _compute_panel_top(parameter)
    for profile in parameter.profiles:
        profile_values, deviance = interpolate_profile(profile)
        values += profile_values[deviance <= top].tolist()
    if parameter.conflict is not None:
        values.append(parameter.conflict.centre)
    low, high = math.log(min(values)), math.log(max(values))
    margin = margin_fraction * max(high - low, min_log_range)
    return math.exp(low - margin), math.exp(high + margin)


def interpolate_profile(profile: Profile) -> tuple[Floats, Floats]:
    """Interpolate a profile between its points.

    Parameters
    ----------
    profile : profile of at least one point

    Returns
    -------
    Values, SI, and deviances, shape (n_points,). The signed square root of the deviance above its
    minimum is interpolated linearly over the logarithm of the value. If this logarithm is normally
    distributed, the root is a straight line.
    """
    n_fine_points = 200
    logs, (best_value, min_deviance) = np.log(profile.value), _get_minimum(profile)
    sign = np.sign(logs - np.log(best_value))
    roots = sign * np.sqrt(np.maximum(profile.deviance - min_deviance, 0.0))
    fine_logs: Floats = np.union1d(np.linspace(logs[0], logs[-1], n_fine_points), logs)
    return np.exp(fine_logs), np.interp(fine_logs, logs, roots) ** 2 + min_deviance


def make_validation_page(name: str, groups: Sequence[ValidationGroup]) -> Page:
    """Make the page of measured and predicted force against deflection, one panel per group.

    Parameters
    ----------
    name : file name without its extension
    groups : 1 to `MAX_PANELS` groups of tests
    """
    title, panels = "Measured and predicted first loadings", list(map(_make_group_plot, groups))
    height = _ROW_HEIGHT * math.ceil(len(groups) / 2)
    return Page(name, title, panels, note=_describe_bands(groups), height=height)


_ROW_HEIGHT = 66.0
"""Height of a row of two panels of force against deflection, mm."""


def _make_group_plot(group: ValidationGroup) -> Plot:
    """Make the panel of samples, mean and model with their bands, and a label on the agreement.

    The model is drawn lighter where it is doubtful.
    """
    max_line_length = 48  # characters in a line of the label
    samples, lines = group.samples.values(), list[Line]()
    for sample in samples:
        x, y = sample.displacement, sample.force
        lines.append(make_thinned_line("measured_sample", x, y, n_bins=100))
    lines += _make_mean_lines(group.band)
    if group.prediction is not None:
        lines += _make_model_lines(group.prediction, group.is_reliable)
    wrapped_texts = (textwrap.wrap(text, max_line_length) for text in describe_agreement(group))
    label_text = "\n".join(line for text_lines in wrapped_texts for line in text_lines)
    label = Label(label_text, -np.inf, np.inf, (4.0, -2.0), {"va": "top"})
    force_axis = _make_force_axis(lines, [group.band.mean, *(sample.force for sample in samples)])
    return Plot(_DEFLECTION_AXIS, force_axis, lines, heading=group.heading, labels=[label])


def _make_model_lines(model: Prediction, is_reliable: Flags) -> Iterator[Line]:
    """Yield the curve of the model and its band for one more sample, lighter where doubtful."""
    for rows, opacity in plots.split_doubtful(is_reliable):
        x, lower, upper = (values[rows] for values in (model.deflection, model.lower, model.upper))
        band_opacity = _MODEL_BAND_OPACITY * opacity
        yield make_line("model", x, model.force[rows], alpha=opacity)
        yield plots.make_area("band_of_model", x, lower, upper, alpha=band_opacity)
        yield make_line("edge_of_band", x, lower, alpha=opacity)
        yield make_line("edge_of_band", x, upper, alpha=opacity)


def _make_force_axis(lines: Sequence[Line], forces: Sequence[Floats]) -> Axis:
    """Make the axis of force, which includes zero and extends above all lines.

    Parameters
    ----------
    lines : lines of the panel; the axis may end above their lowest point
    forces : arrays of forces, N, whose lowest value the axis includes
    """
    headroom = 1.08  # ratio of the top of the axis to the largest force
    included_forces = np.concatenate([np.zeros(1), *forces])
    line_forces = np.concatenate([np.zeros(1), *(line.y for line in lines)])
    lowest = np.min(included_forces[np.isfinite(included_forces)])
    highest = np.max(line_forces[np.isfinite(line_forces)])
    return Axis("Force", FORCE_SCALE, float(lowest), headroom * float(highest))


def describe_agreement(group: ValidationGroup) -> list[str]:
    """Describe the agreement of the model with a group of tests in short texts.

    Parameters
    ----------
    group : samples and prediction

    Returns
    -------
    Texts on the number of samples, the root mean square error and, if it is finite, the fraction of
    points inside the band. Without a prediction, texts on the number of samples and the reason.
    """
    texts = [format_count(len(group.samples), "sample")]
    if not np.isfinite(group.band.lower).any():
        texts[0] += ", no band of the mean"
    errors = group.errors
    if errors is None:
        return [*texts, f"No prediction. {wording.join_sentences([group.reason])}".strip()]
    rmse = SMALL_FORCE_SCALE.factor * errors.rmse
    percentage = format_percent(errors.rmse_share)
    texts.append(f"RMSE {rmse:.3g} {SMALL_FORCE_SCALE.unit}, {percentage} of the largest force")
    if math.isfinite(errors.coverage):
        texts.append(f"{format_percent(errors.coverage)} of the points inside the band")
    return texts


def _make_mean_lines(band: Band) -> list[Line]:
    """Make the line of the mean of the samples, and the area of its 95 % band if there is one."""
    lines = [make_line("mean_of_samples", band.displacement, band.mean)]
    if np.isfinite(band.lower).any():
        lines.append(plots.make_area("band_of_mean", band.displacement, band.lower, band.upper))
    return lines


_MODEL_BAND_OPACITY = 0.5
"""Opacity of the band of the model where the model is reliable."""


def _describe_bands(groups: Sequence[ValidationGroup]) -> str:
    """Describe the bands in the panels of groups, and append the notes on the predictions."""
    sentences = ["Grey band: mean of the samples, Student's t with n - 1 degrees of freedom."]
    if any(len(group.samples) < 2 for group in groups):
        sentences.append("One sample has no band.")
    if any(group.prediction is not None for group in groups):
        sentences.append("Blue band: model, for one more sample.")
    if not all(group.is_reliable.all() for group in groups):
        sentences.append(format_sentence("report.doubtful_model"))
    predictions = (group.prediction for group in groups if group.prediction is not None)
    notes = (note for prediction in predictions for note in prediction.notes)
    sentences.append(wording.join_sentences(notes))
    return " ".join(filter(None, sentences))


_CURVE_SYMBOLS = ("o", "s", "^", "D", "v")


class ExternalPanel(NamedTuple):
    """External curves of one wire, length and direction of the load, in one panel.

    Parameters
    ----------
    group : tests of that wire and length; None if there are none
    comparisons : one or more comparisons of external curves with tests and model
    """

    group: ValidationGroup | None
    comparisons: tuple[ExternalCurveComparison, ...]

    @property
    def heading(self) -> str:
        """Wire, length, and the direction of the load if it is not that of the tests."""
        curve = self.comparisons[0].curve
        load_text = ", load normal to the axis" if curve.is_normal else ""
        return f"{curve.wire}, {format_length(curve.length)}{load_text}"

    @property
    def prediction(self) -> Prediction | None:
        """Prediction that reaches the largest deflection; None if there is no prediction."""
        predictions = filter(None, (comparison.prediction for comparison in self.comparisons))
        return max(predictions, key=lambda p: float(p.deflection[-1]), default=None)


def group_external_curves(report: CalibrationReport) -> list[Sequence[ExternalPanel]]:
    """Group external curves by wire, length and direction of the load, and split them into pages.

    Parameters
    ----------
    report : external curves and tests

    Returns
    -------
    Panels of each page, at most `MAX_PANELS`. Lengths are rounded to 1 µm before they are compared.
    """
    n_decimals = 6  # of a length in m
    comparisons_by_key: dict[tuple[str, float, bool], list[ExternalCurveComparison]] = {}
    for comparison in report.comparisons:
        curve = comparison.curve
        key = (curve.wire, round(curve.length, n_decimals), curve.is_normal)
        comparisons_by_key.setdefault(key, []).append(comparison)
    groups = {(group.wire, round(group.length, n_decimals)): group for group in report.groups}
    panels = [
        ExternalPanel(groups.get(key[:2]), tuple(comparisons))
        for key, comparisons in comparisons_by_key.items()
    ]
    return split_pages(panels, MAX_PANELS)


def make_external_page(name: str, panels: Sequence[ExternalPanel]) -> Page:
    """Make the page of the force of external curves, tests and model against deflection.

    Parameters
    ----------
    name : file name without its extension
    panels : contents of 1 to `MAX_PANELS` panels
    """
    title, panel_plots = "External curves, tests and model", list(map(_make_external_plot, panels))
    note, height = _describe_external_curves(panels), _ROW_HEIGHT * math.ceil(len(panels) / 2)
    return Page(name, title, panel_plots, note=note, height=height)


def _make_external_plot(panel: ExternalPanel) -> Plot:
    """Make the panel of tests and model with their bands, and of external curves."""
    min_symbols = 14  # on an external curve with at least as many points
    lines = [] if panel.group is None else _make_mean_lines(panel.group.band)
    prediction = panel.prediction
    if prediction is not None:
        band = prediction.deflection, prediction.lower_mean, prediction.upper_mean
        lines.append(make_line("model", prediction.deflection, prediction.force))
        lines.append(plots.make_area("band_of_model", *band, alpha=_MODEL_BAND_OPACITY))
    for index, comparison in enumerate(panel.comparisons):
        curve = comparison.curve
        settings: dict[str, Any] = {
            "label": f"external: {curve.name}",
            "color": f"C{1 + index % (N_COLOURS - 1)}",  # the first colour is that of the model
            "marker": _CURVE_SYMBOLS[index % len(_CURVE_SYMBOLS)],
            "markevery": max(1, len(curve.force) // min_symbols),
        }
        lines.append(make_line("external_curve", curve.deflection, curve.force, **settings))
    force_axis = _make_force_axis(lines, [line.y for line in lines])
    return Plot(_DEFLECTION_AXIS, force_axis, lines, panel.heading)


def describe_match(comparison: ExternalCurveComparison) -> list[str]:
    """Describe the agreement of an external curve with the tests and with the model.

    Parameters
    ----------
    comparison : comparison of the external curve with tests and model

    Returns
    -------
    Name of the curve, its RMSE against the tests, and its RMSE against the model.
    """
    match = comparison.tests
    tests_text = "no tests to compare" if match is None else _describe_rmse("tests", match)
    return [comparison.curve.name, tests_text, _describe_rmse("model", comparison.model)]


def _describe_rmse(reference: str, match: CurveMatch) -> str:
    """Describe the RMSE of a curve against a reference, in mN and relative to the peak force."""
    if match.errors is None:
        return f"{reference}: not compared"
    rmse = SMALL_FORCE_SCALE.factor * match.errors.rmse
    percentage = format_percent(match.errors.rmse_share)
    return f"{reference}: RMSE {rmse:.3g} {SMALL_FORCE_SCALE.unit}, {percentage} of peak"


def _describe_external_curves(panels: Sequence[ExternalPanel]) -> str:
    """Describe the bands in the panels, and the RMSE and the notes of each external curve."""
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
    for panel in panels:
        for comparison in panel.comparisons:
            name, tests_text, model_text = describe_match(comparison)
            sentences.append(f"{name} ({panel.heading}), {tests_text}; {model_text}.")
    for comparison in comparisons:
        other_notes = [note for note in comparison.notes if note.code != "external_curve_load"]
        sentences += [f"'{comparison.curve.name}': {note.message}." for note in other_notes]
    return " ".join(sentences)


def make_tables(report: CalibrationReport) -> list[tables.Table]:
    """Make the sheets of the workbook of a calibration.

    Parameters
    ----------
    report : contents of the workbook

    Returns
    -------
    ``summary``, ``solutions``, ``fit``, ``agreement``, ``external curves`` if there are any,
    ``curves``, ``forces`` and ``notes``.
    """
    calibration = report.calibration
    external_records = (
        record for comparison in report.comparisons for record in _list_match_records(comparison)
    )
    titles = (f"{group.wire}, {format_length(group.length)}" for group in report.groups)
    force_charts = zip(titles, map(_make_force_records, report.groups), strict=True)
    axis_headings = LENGTH_SCALE.label("deflection"), FORCE_SCALE.label("force")
    return [
        tables.tabulate("summary", map(_make_parameter_record, calibration.parameters)),
        tables.tabulate("solutions", _list_solution_records(calibration)),
        tables.tabulate("fit", _list_fit_records(calibration)),
        tables.tabulate("agreement", map(_make_agreement_record, report.groups)),
        *([tables.tabulate("external curves", external_records)] if report.comparisons else []),
        tables.tabulate("curves", map(_make_curve_record, calibration.curves)),
        tables.tabulate_curves("forces", force_charts, *axis_headings),
        tables.tabulate("notes", _list_note_records(report)),
    ]


def _list_match_records(comparison: ExternalCurveComparison) -> Iterator[tables.Record]:
    """Yield the records of an external curve: its match with the tests, then with the model."""
    curve = comparison.curve
    for reference, match in (("tests", comparison.tests), ("model", comparison.model)):
        errors = None if match is None else match.errors
        yield {
            "name": curve.name,
            "wire": curve.wire,
            _LENGTH_HEADING: LENGTH_SCALE.factor * curve.length,
            "load": "normal" if curve.is_normal else "as tested",
            "compared with": reference,
            "points compared": 0 if errors is None else errors.n,
            "points left out": None if match is None else match.n_excluded,
            **_make_error_cells(errors),
            "reason": "no tests of this wire and length" if match is None else match.explanation,
            "file": curve.file,
            "from": curve.source,
        }


def _make_error_cells(errors: CurveErrors | None) -> tables.Record:
    """Make the cells of the errors of a curve; they are empty without errors."""
    return {
        FORCE_SCALE.label("RMSE"): None if errors is None else FORCE_SCALE.factor * errors.rmse,
        "RMSE over the largest force (%)": None if errors is None else 100.0 * errors.rmse_share,
        "points inside the band (%)": None if errors is None else 100.0 * errors.coverage,
    }


def _format_flag(flag: bool) -> str:
    return "yes" if flag else "no"


def _make_parameter_record(parameter: CalibratedParameter) -> tables.Record:
    """Make the record of a parameter, its interval and its prior."""
    factor, unit = PARAMETER_SCALES[parameter.name]
    interval, conflict = parameter.interval, parameter.conflict
    has_interval = interval is not None
    return {
        "parameter": PARAMETER_LABELS[parameter.name],
        "name": parameter.name,
        "unit": unit or "1",
        "value": factor * parameter.value,
        "lower": None if interval is None else factor * interval.lower,
        "upper": None if interval is None else factor * interval.upper,
        "parts of the interval": format_intervals(parameter) if has_interval else "",
        "open below": _format_flag(parameter.is_open_below) if has_interval else "",
        "open above": _format_flag(parameter.is_open_above) if has_interval else "",
        "standard error of its logarithm": parameter.log_error if has_interval else None,
        "degrees of freedom": parameter.freedom if has_interval else None,
        "verdict": parameter.verdict.value,
        "at bound": parameter.at_bound,
        "prior, centre": None if conflict is None else factor * conflict.centre,
        "prior, factor": None if conflict is None else conflict.factor,
        "without the prior": None if conflict is None else factor * conflict.estimate,
        "conflict (standard errors)": None if conflict is None else conflict.size,
        "contradicts": "" if conflict is None else _format_flag(conflict.contradicts),
        "source of prior or fixed value": (conflict or parameter).source,
        "in words": typeset(parameter.explanation),
        "prior in words": "" if conflict is None else typeset(conflict.message),
    }


def _list_solution_records(calibration: Calibration) -> Iterator[tables.Record]:
    """Yield a record per solution, which is a local minimum of the objective."""
    for index, solution in enumerate(calibration.solutions, start=1):
        values = {
            PARAMETER_SCALES[name].label(PARAMETER_LABELS[name]): PARAMETER_SCALES[name].factor
            * value
            for name, value in zip(PARAMETERS, solution.values.tolist(), strict=True)
        }
        yield {
            "solution": index,
            **values,
            "RMSE (N)": solution.rmse,
            "rise of the objective": solution.rise,
            "likelihood relative to the best": solution.likelihood,
            "in the 95 % set": _format_flag(solution.is_allowed),
        }


def _list_fit_records(calibration: Calibration) -> list[tables.Record]:
    """List the records of the numbers that describe the fit and its noise."""
    levels = calibration.levels
    rows: tuple[tuple[str, tables.Value, str], ...] = (
        ("wire", calibration.wire, ""),
        ("curves", len(calibration.curves), "1"),
        ("samples", calibration.n_samples, "1"),
        ("points", calibration.n_points, "1"),
        ("SSE", calibration.sse, "N²"),
        ("RMSE", calibration.rmse, "N"),
        ("RMSE over the largest force", calibration.rmse_share, "1"),
        ("noise relative to the stated noise", levels.noise_factor, "1"),
        ("degrees of freedom of the noise", levels.noise_freedom, "1"),
        ("correlation of neighbouring points", levels.correlation, "1"),
        ("scatter of samples, of the logarithm of the force", levels.scatter, "1"),
        ("degrees of freedom of the scatter", levels.scatter_freedom, "1"),
        ("uncertainty of the load cell's gain, of its logarithm", levels.gain, "1"),
        ("factor on intervals for nonlinearity of the model", calibration.widening, "1"),
        ("method", calibration.method, ""),
    )
    return [{"number": name, "value": value, "unit": unit} for name, value, unit in rows]


def _make_agreement_record(group: ValidationGroup) -> tables.Record:
    """Make the record of the errors of the model, or of the reason why there are none."""
    errors, reason = group.errors, group.reason
    if errors is not None:
        reason = None if np.isfinite(group.band.lower).any() else group.band.reason
    return {
        "wire": group.wire,
        _LENGTH_HEADING: LENGTH_SCALE.factor * group.length,
        "samples": len(group.samples),
        "model is": "calibrated by these samples" if group.is_calibrated else "predicted",
        "points": None if errors is None else errors.n,
        "SSE (N²)": None if errors is None else errors.sse,
        **_make_error_cells(errors),
        "reason": str(reason or ""),
    }


def _make_curve_record(curve: CurveAgreement) -> tables.Record:
    """Make the record of the errors of the model on one curve."""
    return {
        "test": curve.test,
        "sample": curve.sample,
        _LENGTH_HEADING: LENGTH_SCALE.factor * curve.length,
        "points": len(curve.force),
        "factor of the sample": curve.sample_factor,
        "SSE (N²)": curve.sse,
        FORCE_SCALE.label("RMSE"): FORCE_SCALE.factor * curve.rmse,
        "RMSE over the largest force (%)": 100.0 * curve.rmse_share,
        "correlation of neighbours": curve.lag_one_correlation,
        "runs test, p": curve.runs_p,
    }


def _list_note_records(report: CalibrationReport) -> list[tables.Record]:
    """List the records of all notes, the most severe first, and of one on separability.

    A message that several predictions repeat is listed once.
    """
    sources = [("calibration", report.calibration.notes)]
    predictions = [group.prediction for group in report.groups if group.prediction]
    sources += [("prediction", prediction.notes) for prediction in predictions]
    for comparison in report.comparisons:
        sources.append((f"external curve '{comparison.curve.name}'", comparison.notes))
    notes = {
        (source, note.message): (source, note)
        for source, source_notes in sources
        for note in source_notes
    }
    separability = report.calibration.separability
    names, text = ", ".join(separability.names), typeset(separability.explanation)
    separability_note = QualityNote("told_apart", Severity.INFO, names, text)
    return tables.make_note_records("of", [*notes.values(), ("calibration", separability_note)])


def _make_force_records(group: ValidationGroup) -> dict[str, list[tables.Record]]:
    """Make the records of the points of each curve, keyed by the curve's name.

    The curves are the mean of the samples, the model if there is a prediction, and each sample.
    """
    force_headings = [
        *(FORCE_SCALE.label(f"force{suffix}") for suffix in ("", ", lower", ", upper")),
        *(FORCE_SCALE.label(f"mean sample, {edge}") for edge in ("lower", "upper")),
    ]
    band, model = group.band, group.prediction
    mean_curve = band.displacement, band.mean, band.lower, band.upper
    curves: dict[str, tuple[Floats, ...]] = {"mean of the samples": mean_curve}
    if model is not None:
        edges = (model.lower, model.upper, model.lower_mean, model.upper_mean)
        curves["model"] = (model.deflection, model.force, *edges)
    for test, sample in group.samples.items():
        curves[test] = (sample.displacement, sample.force)
    records, length = {}, LENGTH_SCALE.factor * group.length
    for name, (x, *forces) in curves.items():
        common_cells: tables.Record = {"wire": group.wire, _LENGTH_HEADING: length, "what": name}
        columns = {LENGTH_SCALE.label("deflection"): LENGTH_SCALE.factor * x}
        for heading, force in zip(force_headings, forces, strict=False):
            columns[heading] = FORCE_SCALE.factor * force
        records[name] = tables.make_records(common_cells, columns)
    return records


def save_calibration_workbook(report: CalibrationReport, path: Path) -> None:
    """Write the workbook of a calibration as an xlsx file.

    Parameters
    ----------
    report : contents of the workbook
    path : path of the file

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    title = f"Calibration of {report.calibration.wire}"
    tables.save_tables(make_tables(report), path, book="calibration", title=title)
