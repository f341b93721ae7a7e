"""Describe a calibration of the wire model in sentences, and write its workbook."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.wire import (
    COPPER_SCALE,
    DISPLAYED,
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
)
from labpipe.report import table_records as tables
from labpipe.report.wording import SUPERSCRIPTS, Scale, write_count, write_number

DEFLECTION = Scale(1e3, "mm")
FORCE = Scale(1.0, "N")
SMALL_FORCE = Scale(1e3, "mN")
_LETTERS = {"phi": "\u03c6", "mu": "\u03bc"}
_POWER = re.compile(r"(?<=\d)e([+-])0*(\d+)")
_LENGTH = DEFLECTION.label("length")

LABELS: Mapping[str, str] = {
    RADIAL_FRICTION: "Friction \u03c6",
    INSULATION_MODULUS: "Insulation modulus",
    COPPER_SCALE: "Factor on copper strength",
}
SCALES: Mapping[str, Scale] = {name: Scale(*unit) for name, unit in DISPLAYED.items()}
_NAMES_IN_SENTENCES: Mapping[str, str] = {
    RADIAL_FRICTION: "phi",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
}


def typeset(sentence: str) -> str:
    """Typeset a sentence of a calibration.

    Parameters
    ----------
    sentence : sentence of a record, which names parameters by their keys

    Returns
    -------
    The sentence with a capital, unless it starts with a symbol, and a full stop. Names replace the
    keys of parameters; powers of ten and Greek letters are typeset.

    Examples
    --------
    >>> typeset("copper_scale was held")
    'The strength of the copper was held.'
    """

    def typeset_power(match: re.Match[str]) -> str:
        exponent = f"{match[1]}{match[2]}".removeprefix("+")
        return f" \u00d7 10{exponent.translate(SUPERSCRIPTS)}"

    for parameter, name in _NAMES_IN_SENTENCES.items():
        sentence = re.sub(rf"\b{parameter}\b", name, sentence)
    sentence = _POWER.sub(typeset_power, sentence.strip().rstrip("."))
    starts_with_symbol = sentence.startswith(("phi", "mu_"))
    for name, letter in _LETTERS.items():
        sentence = re.sub(rf"\b{name}(?=\b|_)", letter, sentence)
    return f"{sentence if starts_with_symbol else sentence[:1].upper() + sentence[1:]}."


def write_percent(ratio: float) -> str:
    """Write a ratio in per cent.

    Two significant digits are written below 10 % and three from 10 %. The text is empty if the
    ratio is not finite.

    Examples
    --------
    >>> write_percent(0.0193), write_percent(1.0), write_percent(math.nan)
    ('1.9 %', '100 %', '')
    """
    if not math.isfinite(ratio):
        return ""
    return f"{100.0 * ratio:.3g} %" if ratio >= 0.1 else f"{100.0 * ratio:.2g} %"


def write_length(length: float) -> str:
    """Write a length, given in m, in millimetres, such as ``85 mm``."""
    return f"{DEFLECTION.factor * length:.4g} {DEFLECTION.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class ValidationGroup:
    """Samples of one wire at one length, and the prediction of the model.

    Parameters
    ----------
    wire : name of the wire
    length : free length, m
    is_calibrated : whether the samples were used for the calibration; the model predicts others
    samples : first loading of each sample, keyed by the name of its test
    band : mean of the samples with its 95 % bands; one sample has no bands
    prediction : prediction of the model, with a band for one more sample; None if there is none
    errors : errors of the model at all points of the samples; None without a prediction
    reason : reason why there is no prediction; None with a prediction
    doubtful_deflection : deflection beyond which the prediction is doubtful, because the strain at
        the rim of the insulation exceeds the linear range, m; infinite if it never does
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
    def is_reliable(self) -> Flags:
        """Whether each point of the prediction is within `doubtful_deflection`, shape (n,)."""
        deflection = np.zeros(0) if self.prediction is None else self.prediction.deflection
        return np.asarray(deflection <= self.doubtful_deflection)


@dataclass(frozen=True, slots=True, eq=False)
class BentShape(ArrayRecord):
    """Shape of a sample at one deflection of its tip; the columns of the arrays are x and y, m.

    Parameters
    ----------
    deflection : deflection of the tip, m
    markers : measured markers, shape (n_markers, 2); NaN where a marker was not tracked
    fit : curve fitted to the markers, shape (n, 2); empty without a fit
    model : axis of the wire in the model, shape (n, 2); empty without a model
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
    shapes : shapes of each test at several deflections, keyed by the name of the test
    comparisons : comparisons of the external curves with tests and model
    """

    calibration: Calibration
    groups: tuple[ValidationGroup, ...] = ()
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    comparisons: tuple[ExternalCurveComparison, ...] = ()

    @property
    def predictions(self) -> dict[float, Prediction]:
        """Predictions for the tests of the calibration, keyed by the length in m."""
        return {
            group.length: group.prediction
            for group in self.groups
            if group.is_calibrated and group.prediction is not None
        }


_REPEATED_CODES = frozenset({"at_bound", "not_identified", "prior_contradicts_data"})
"""Codes of the notes that repeat sentences on the parameters."""


def write_parameter(parameter: CalibratedParameter) -> tuple[str, ...]:
    """Write the name, value, 95 % interval, unit and verdict of a parameter.

    Parameters
    ----------
    parameter : parameter of a calibration

    Returns
    -------
    Name, value, interval, unit and verdict as texts. An interval that is open on one side
    is ``below ...`` or ``above ...``; one that is open on both sides is ``open on both sides``.
    Separate intervals are joined by ``or``. A missing interval is a dash. The unit of a ratio is
    ``1``.
    """
    factor, unit = SCALES[parameter.name]
    is_open = parameter.is_open_below or parameter.is_open_above
    interval = next(
        (part for part in parameter.intervals if part.lower <= parameter.value <= part.upper),
        parameter.interval,
    )
    number_text = write_number(parameter.value, interval, factor)
    value_text = write_number(parameter.value, None, factor, digits=2) if is_open else number_text
    interval_text = " or ".join(_write_intervals(parameter, factor))
    verdict = parameter.verdict.value
    return LABELS[parameter.name], value_text.value, interval_text or "\u2013", unit or "1", verdict


def _write_intervals(parameter: CalibratedParameter, factor: float) -> Iterator[str]:
    """Write each interval of a parameter with the digits that its width supports."""
    last_number = len(parameter.intervals) - 1
    for number, interval in enumerate(parameter.intervals):
        nearest_value = min(max(parameter.value, interval.lower), interval.upper)
        written = write_number(nearest_value, interval, factor)
        texts = {
            (False, False): written.interval,
            (True, False): f"below {written.upper}",
            (False, True): f"above {written.lower}",
            (True, True): "open on both sides",
        }
        is_open_below = number == 0 and parameter.is_open_below
        is_open_above = number == last_number and parameter.is_open_above
        yield texts[is_open_below, is_open_above]


def describe_calibration(calibration: Calibration) -> list[str]:
    """Describe the results of a calibration in sentences.

    Parameters
    ----------
    calibration : results of the calibration

    Returns
    -------
    Sentences on each parameter and its prior, on the agreement with the tests, the noise, the
    parameters that are not identified separately, and the warnings.
    """
    sentences = []
    for parameter in calibration.parameters:
        sentences.append(typeset(parameter.explanation))
        if parameter.conflict is not None:
            sentences.append(typeset(parameter.conflict.message))
    sentences += [_describe_agreement(calibration), _describe_noise(calibration)]
    if np.isfinite(calibration.get_parameter(RADIAL_FRICTION).value):
        sentences.append(typeset("mu_s, mu_p and F_rad are not identified separately, only phi"))
    if not all(calibration.separability.are_identified.values()):
        sentences.append(typeset(calibration.separability.explanation))
    return sentences + [
        f"Note: {typeset(note.message)}"
        for note in calibration.notes
        if note.code not in _REPEATED_CODES and note.severity is not Severity.INFO
    ]


def _describe_agreement(calibration: Calibration) -> str:
    n_points = write_count(calibration.n_points, "point")
    n_curves = write_count(len(calibration.curves), "curve")
    n_samples = write_count(calibration.n_samples, "sample")
    return format_sentence(
        "report.agreement_with_curves",
        rmse=SMALL_FORCE.factor * calibration.rmse,
        share=write_percent(calibration.rmse_share),
        counts=f"{n_points} of {n_curves} of {n_samples}",
    )


def _describe_noise(calibration: Calibration) -> str:
    levels = calibration.levels
    scatter = f"The force scatters by {write_percent(levels.scatter)} between samples"
    if levels.scatter_freedom == 0.0:
        scatter = "The scatter of the samples is not known"
    gain = write_percent(levels.gain)
    return format_sentence("report.noise_of_calibration", scatter=scatter, gain=gain, levels=levels)


def make_tables(report: CalibrationReport) -> list[tables.Table]:
    """Make all sheets of the workbook of a calibration.

    Parameters
    ----------
    report : calibration, predictions, tests and external curves

    Returns
    -------
    ``summary``, ``solutions``, ``fit``, ``agreement``, ``external curves`` if there are any,
    ``curves``, ``forces`` and ``notes``.
    """
    calibration = report.calibration
    external_records = (
        record for comparison in report.comparisons for record in _list_match_records(comparison)
    )
    titles = (f"{group.wire}, {write_length(group.length)}" for group in report.groups)
    force_charts = zip(titles, map(_make_force_blocks, report.groups), strict=True)
    axis_heads = DEFLECTION.label("deflection"), FORCE.label("force")
    return [
        tables.tabulate("summary", map(_make_parameter_record, calibration.parameters)),
        tables.tabulate("solutions", _list_solution_records(calibration)),
        tables.tabulate("fit", _list_fit_records(calibration)),
        tables.tabulate("agreement", map(_make_agreement_record, report.groups)),
        *([tables.tabulate("external curves", external_records)] if report.comparisons else []),
        tables.tabulate("curves", map(_make_curve_record, calibration.curves)),
        tables.tabulate_curves("forces", force_charts, *axis_heads),
        tables.tabulate("notes", _list_note_records(report)),
    ]


def _list_match_records(comparison: ExternalCurveComparison) -> Iterator[tables.Record]:
    curve = comparison.curve
    for reference, match in (("tests", comparison.tests), ("model", comparison.model)):
        yield {
            "name": curve.name,
            "wire": curve.wire,
            _LENGTH: DEFLECTION.factor * curve.length,
            "load": "normal" if curve.is_normal else "as tested",
            "compared with": reference,
            **_make_match_record(match),
            "file": curve.file,
            "from": curve.source,
        }


def _make_match_record(match: CurveMatch | None) -> tables.Record:
    errors = None if match is None else match.errors
    return {
        "points compared": 0 if errors is None else errors.n,
        "points left out": None if match is None else match.left_out,
        FORCE.label("RMSE"): None if errors is None else FORCE.factor * errors.rmse,
        "RMSE over the largest force (%)": None if errors is None else 100.0 * errors.rmse_share,
        "points inside the band (%)": None if errors is None else 100.0 * errors.inside,
        "reason": "no tests of this wire and length" if match is None else match.explanation,
    }


def _write_flag(value: bool) -> str:
    return "yes" if value else "no"


def _make_parameter_record(parameter: CalibratedParameter) -> tables.Record:
    (factor, unit), interval = SCALES[parameter.name], parameter.interval
    conflict, has_interval = parameter.conflict, interval is not None
    return {
        "parameter": LABELS[parameter.name],
        "name": parameter.name,
        "unit": unit or "1",
        "value": factor * parameter.value,
        "lower": None if interval is None else factor * interval.lower,
        "upper": None if interval is None else factor * interval.upper,
        "parts of the interval": write_parameter(parameter)[2] if has_interval else "",
        "open below": _write_flag(parameter.is_open_below) if has_interval else "",
        "open above": _write_flag(parameter.is_open_above) if has_interval else "",
        "standard error of its logarithm": parameter.log_error if has_interval else None,
        "degrees of freedom": parameter.freedom if has_interval else None,
        "verdict": parameter.verdict.value,
        "at bound": parameter.at_bound,
        "prior, centre": None if conflict is None else factor * conflict.centre,
        "prior, factor": None if conflict is None else conflict.factor,
        "without the prior": None if conflict is None else factor * conflict.estimate,
        "conflict (standard errors)": None if conflict is None else conflict.size,
        "contradicts": "" if conflict is None else _write_flag(conflict.contradicts),
        "source of prior or fixed value": (conflict or parameter).source,
        "in words": typeset(parameter.explanation),
        "prior in words": "" if conflict is None else typeset(conflict.message),
    }


def _list_solution_records(calibration: Calibration) -> Iterator[tables.Record]:
    """Yield a record per solution, a local minimum of the objective; the best is first."""
    for number, solution in enumerate(calibration.solutions, start=1):
        values = {
            SCALES[name].label(LABELS[name]): SCALES[name].factor * value
            for name, value in zip(PARAMETERS, solution.values.tolist(), strict=True)
        }
        yield {
            "solution": number,
            **values,
            "RMSE (N)": solution.rmse,
            "rise of the objective": solution.rise,
            "likelihood relative to the best": solution.likelihood,
            "in the 95 % set": _write_flag(solution.is_allowed),
        }


def _list_fit_records(calibration: Calibration) -> list[tables.Record]:
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
    return [{"number": number, "value": value, "unit": unit} for number, value, unit in rows]


def _make_agreement_record(group: ValidationGroup) -> tables.Record:
    errors, reason = group.errors, group.reason
    if errors is not None:
        reason = None if np.isfinite(group.band.lower).any() else group.band.reason
    return {
        "wire": group.wire,
        _LENGTH: DEFLECTION.factor * group.length,
        "samples": len(group.samples),
        "model is": "calibrated by these samples" if group.is_calibrated else "predicted",
        "points": None if errors is None else errors.n,
        "SSE (N²)": None if errors is None else errors.sse,
        FORCE.label("RMSE"): None if errors is None else FORCE.factor * errors.rmse,
        "RMSE over the largest force (%)": None if errors is None else 100.0 * errors.rmse_share,
        "points inside the band (%)": None if errors is None else 100.0 * errors.inside,
        "reason": str(reason or ""),
    }


def _make_curve_record(curve: CurveAgreement) -> tables.Record:
    return {
        "test": curve.test,
        "sample": curve.sample,
        _LENGTH: DEFLECTION.factor * curve.length,
        "points": len(curve.force),
        "factor of the sample": curve.sample_factor,
        "SSE (N²)": curve.sse,
        FORCE.label("RMSE"): FORCE.factor * curve.rmse,
        "RMSE over the largest force (%)": 100.0 * curve.rmse_share,
        "correlation of neighbours": curve.lag_one_correlation,
        "runs test, p": curve.runs_p,
    }


def _list_note_records(report: CalibrationReport) -> list[tables.Record]:
    """List the records of all notes, the most severe first, and one on separability.

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
    last_note = "calibration", QualityNote("told_apart", Severity.INFO, names, text)
    return tables.make_note_records("of", [*notes.values(), last_note])


def _make_force_blocks(group: ValidationGroup) -> dict[str, list[tables.Record]]:
    """Make the records of the mean, of the model, if any, and of each sample, by name."""
    heads = [
        *(FORCE.label(f"force{end}") for end in ("", ", lower", ", upper")),
        *(FORCE.label(f"mean sample, {end}") for end in ("lower", "upper")),
    ]
    band, model = group.band, group.prediction
    mean_curve = band.displacement, band.mean, band.lower, band.upper
    curves: dict[str, tuple[Floats, ...]] = {"mean of the samples": mean_curve}
    if model is not None:
        edges = (model.lower, model.upper, model.lower_mean, model.upper_mean)
        curves["model"] = (model.deflection, model.force, *edges)
    for test, sample in group.samples.items():
        curves[test] = (sample.displacement, sample.force)
    blocks = {}
    for name, (x, *forces) in curves.items():
        head: tables.Record = {
            "wire": group.wire, _LENGTH: DEFLECTION.factor * group.length, "what": name
        }  # fmt: skip
        columns = {DEFLECTION.label("deflection"): DEFLECTION.factor * x}
        columns |= {key: FORCE.factor * force for key, force in zip(heads, forces, strict=False)}
        blocks[name] = tables.make_records(head, columns)
    return blocks


def save_calibration_workbook(report: CalibrationReport, path: Path) -> None:
    """Write the workbook of a calibration as an xlsx file.

    Parameters
    ----------
    report : calibration, predictions, tests and external curves
    path : path of the file

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    title = f"Calibration of {report.calibration.wire}"
    tables.save_tables(make_tables(report), path, book="calibration", title=title)
