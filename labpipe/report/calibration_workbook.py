"""Workbook of a calibration: one sheet per question."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire_calibration import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CurveMatch,
    ExternalCurveComparison,
    Separability,
)
from labpipe.report.calibration_summary import (
    DEFLECTION,
    DISPLAYS,
    FORCE,
    CalibrationReport,
    ParameterDisplay,
    ValidationGroup,
    length_words,
    parameter_row,
    typeset,
)
from labpipe.report.workbook_file import About, Chart, Line, Row, Sheet, Value, save_book

EXTERNAL_CURVES, EXTERNAL_POINTS = "external curves", "external curves, points"


def comparison_tables(comparisons: Sequence[ExternalCurveComparison]) -> list[Sheet]:
    """Return the sheets of external curves.

    Parameters
    ----------
    comparisons : external curves compared with tests and model

    Returns
    -------
    ``external curves``, two rows per curve, and ``external curves, points``; empty without curves.
    """
    if not comparisons:
        return []
    heads = (
        "name", "wire", DEFLECTION.label("length"), "load", "compared with", "points compared",
        "points left out", FORCE.label("RMSE"), "RMSE over the largest force (%)",
        "points inside the band (%)", "reason", "file", "from",
    )  # fmt: skip
    rows = [row for comparison in comparisons for row in _external_agreement(comparison)]
    points = [row for comparison in comparisons for row in _external_points(comparison)]
    across, up = DEFLECTION.label("deflection"), FORCE.label("force")
    columns = ("name", across, up, FORCE.label("mean of the tests"), FORCE.label("model"))
    return [
        Sheet(
            EXTERNAL_CURVES, heads, rows, 1,
            question="How well do external curves agree with tests and model?",
        ),
        Sheet(
            EXTERNAL_POINTS, columns, points, 1,
            question="Where do they differ? Force at the deflections of the external curves.",
        ),
    ]  # fmt: skip


def _external_agreement(comparison: ExternalCurveComparison) -> Iterator[tuple[Value, ...]]:
    curve = comparison.curve
    load = "normal" if curve.is_normal else "as tested"
    head = (curve.name, curve.wire, DEFLECTION.factor * curve.length, load)
    tail = (curve.file, curve.source)
    if comparison.tests is None:
        yield (*head, "tests", 0, *[None] * 4, "no tests of this wire and length", *tail)
    else:
        yield (*head, "tests", *_errors(comparison.tests), *tail)
    yield (*head, "model", *_errors(comparison.model), *tail)


def _errors(match: CurveMatch) -> tuple[Value, ...]:
    errors = match.errors
    if errors is None:
        return (0, match.left_out, None, None, None, match.explanation)
    inside = 100.0 * errors.inside if math.isfinite(errors.inside) else None
    rmse = FORCE.factor * errors.rmse
    return (errors.n, match.left_out, rmse, 100.0 * errors.rmse_share, inside, match.explanation)


def _external_points(comparison: ExternalCurveComparison) -> Iterator[tuple[Value, ...]]:
    curve, nothing = comparison.curve, [math.nan] * len(comparison.curve.force)
    tests = nothing if comparison.tests is None else comparison.tests.reference.tolist()
    columns = (curve.deflection.tolist(), curve.force.tolist(), tests, comparison.model.reference)
    for across, *forces in zip(*columns, strict=True):
        values = (FORCE.factor * float(v) if math.isfinite(v) else None for v in forces)
        yield (curve.name, DEFLECTION.factor * across, *values)


def yes(value: bool) -> str:
    """Write a truth value for a cell."""
    return "yes" if value else "no"


SUMMARY, SOLUTIONS, FIT = "summary", "solutions", "fit"
IDENTIFIED, CURVES = "identified", "curves"
AGREEMENT, NOTES = "agreement", "notes"
_FRICTION = ("strand_friction", "insulation_friction", "radial_force")


def tables_of(report: CalibrationReport) -> list[Sheet]:
    """Return all sheets of a calibration.

    Parameters
    ----------
    report : of a calibration

    Returns
    -------
    ``summary``, ``solutions``, ``fit``, ``identified``, ``agreement`` (Table 3.3 of the
    dissertation), those of external curves, ``curves``, ``forces`` and ``notes``.
    """
    calibration = report.calibration
    return [
        _summary_sheet(calibration),
        _solutions_sheet(calibration),
        _fit_sheet(calibration),
        _identified_sheet(calibration),
        _agreement_sheet(report.groups),
        *comparison_tables(report.comparisons),
        _curves_sheet(calibration),
        _forces_sheet(report.groups),
        _notes_sheet(report),
    ]


def _summary_sheet(calibration: Calibration) -> Sheet:
    heads = (
        "parameter", "name", "unit", "value", "lower", "upper", "parts of the interval",
        "open below", "open above",
        "standard error of its logarithm", "degrees of freedom", "verdict", "at bound",
        "prior, centre", "prior, factor", "without the prior", "conflict (standard errors)",
        "contradicts", "source of prior or fixed value", "in words", "prior in words",
    )  # fmt: skip
    rows = [_parameter_row(parameter) for parameter in calibration.parameters]
    question = "What are the parameters of the model, and do the tests determine them?"
    last = ("in words", "prior in words")
    return Sheet(SUMMARY, heads, rows, 2, question=question, wrapped=last)


def _parameter_row(parameter: CalibratedParameter) -> tuple[Value, ...]:
    display, interval, conflict = (DISPLAYS[parameter.name], parameter.interval, parameter.conflict)
    up = display.scale.factor
    ends: tuple[Value, ...] = (None, None, "", "", "", None, None)
    if interval is not None:
        ends = (
            up * interval.lower, up * interval.upper, parameter_row(parameter)[2],
            yes(parameter.is_open_below), yes(parameter.is_open_above), parameter.log_error,
            parameter.freedom,
        )  # fmt: skip
    prior: tuple[Value, ...] = (None, None, None, None, "", parameter.source)
    if conflict is not None:
        prior = (
            up * conflict.centre, conflict.factor, up * conflict.alone, conflict.size,
            yes(conflict.contradicts), conflict.source,
        )  # fmt: skip
    texts = (typeset(parameter.explanation), "" if conflict is None else typeset(conflict.message))
    named = (typeset(display.name).rstrip("."), parameter.name, display.scale.unit or "1")
    verdict = (parameter.verdict.value, parameter.at_bound)
    return (*named, up * parameter.value, *ends, *verdict, *prior, *texts)


def _solutions_sheet(calibration: Calibration) -> Sheet:
    """List the local minima of the objective that are not very unlikely, the best first."""
    displays = [DISPLAYS[name] for name in PARAMETERS]
    heads = (
        "solution", *(f"{display.name} ({display.scale.unit or '1'})" for display in displays),
        "RMSE (N)", "rise of the objective", "likelihood relative to the best",
        "in the 95 % set",
    )  # fmt: skip
    rows = [
        (
            number,
            *map(_scaled, displays, solution.values.tolist()),
            solution.rmse, solution.rise, solution.likelihood, yes(solution.is_allowed),
        )
        for number, solution in enumerate(calibration.solutions, start=1)
    ]  # fmt: skip
    return Sheet(SOLUTIONS, heads, rows, 1, question="What else fits the tests?")


def _scaled(display: ParameterDisplay, value: float) -> float | None:
    return display.scale.factor * value if math.isfinite(value) else None


def _fit_sheet(calibration: Calibration) -> Sheet:
    levels = calibration.levels
    rows: list[tuple[Value, ...]] = [
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
    ]
    question = "Which data and which noise is the calibration based on?"
    return Sheet(FIT, ("number", "value", "unit"), rows, 1, question=question)


def _identified_sheet(calibration: Calibration) -> Sheet:
    """List correlations, and singular values with the weights of their combinations."""
    rows: list[tuple[Value, ...]] = [
        (
            "correlation of the logarithms with",
            name,
            *_by_name(dict(zip(PARAMETERS, row, strict=True))),
        )
        for name, row in zip(PARAMETERS, calibration.correlations.tolist(), strict=True)
    ]
    rows += _singular_rows("singular value of the parameters", calibration.separability)
    if calibration.friction_separability is not None:
        rows += _singular_rows("singular value of friction", calibration.friction_separability)
    heads = (
        "quantity",
        "of",
        *(f"weight or correlation, {name}" for name in (*PARAMETERS, *_FRICTION)),
    )
    question = (
        "Which combinations of parameters are identified? With the singular value s the standard"
        " error of the logarithm is 1 / s; below 1 the tests do not determine the combination."
    )
    return Sheet(IDENTIFIED, heads, rows, 2, question=question)


def _singular_rows(what: str, separability: Separability) -> Iterator[tuple[Value, ...]]:
    for value, weights in zip(
        separability.singular_values.tolist(), separability.combinations, strict=True
    ):
        named = dict(zip(separability.names, weights.tolist(), strict=True))
        yield (what, value, *_by_name(named))
    for name, is_known in separability.are_identified.items():
        yield ("identified separately", name, *_by_name({name: yes(is_known)}))


def _by_name(values: Mapping[str, Value]) -> tuple[Value, ...]:
    return tuple(values.get(name) for name in (*PARAMETERS, *_FRICTION))


def _agreement_sheet(groups: Sequence[ValidationGroup]) -> Sheet:
    heads = (
        "wire", DEFLECTION.label("length"), "samples", "model is", "points", "SSE (N²)",
        FORCE.label("RMSE"), "RMSE over the largest force (%)", "points inside the band (%)",
        "band predicts the mean of (samples)", "reason",
    )  # fmt: skip
    question = (
        "How well does the model agree with samples of the calibration and with others? The band is"
        " for one more sample; SSE grows with the number of points."
    )
    return Sheet(
        AGREEMENT, heads, [_agreement_row(group) for group in groups], 2, question=question
    )


def _agreement_row(group: ValidationGroup) -> tuple[Value, ...]:
    use = "calibrated by these samples" if group.is_calibrated else "predicted"
    head = (group.wire, DEFLECTION.factor * group.length, len(group.samples), use)
    errors = group.errors
    if errors is None:
        return (*head, *[None] * 6, str(group.reason or ""))
    shares = (100.0 * errors.rmse_share, 100.0 * errors.inside)
    rmse = FORCE.factor * errors.rmse
    has_band = bool(np.isfinite(group.band.lower).any())
    why = "" if has_band else str(group.band.reason or "")
    return (*head, errors.n, errors.sse, rmse, *shares, group.mean_of, why)


def _curves_sheet(calibration: Calibration) -> Sheet:
    heads = (
        "test", "sample", DEFLECTION.label("length"), "points", "factor of the sample", "SSE (N²)",
        FORCE.label("RMSE"), "RMSE over the largest force (%)", "correlation of neighbours",
        "runs test, p",
    )  # fmt: skip
    rows = [
        (
            curve.test, curve.sample, DEFLECTION.factor * curve.length, len(curve.force),
            curve.sample_factor, curve.sse, FORCE.factor * curve.rmse, 100.0 * curve.rmse_share,
            curve.lag_one_correlation, curve.runs_p,
        )
        for curve in calibration.curves
    ]  # fmt: skip
    question = "How well does each test agree with the model, without the sample's own factor?"
    return Sheet(CURVES, heads, rows, 1, question=question)


def _notes_sheet(report: CalibrationReport) -> Sheet:
    """List the notes of the calibration and its predictions, each wording once, worst first."""
    notes: dict[tuple[str, str], QualityNote] = {}
    for note in report.calibration.notes:
        notes["calibration", note.message] = note
    for group in report.groups:
        for note in group.prediction.notes if group.prediction is not None else ():
            notes["prediction", note.message] = note
    for comparison in report.comparisons:
        for note in comparison.notes:
            notes[f"external curve '{comparison.curve.name}'", note.message] = note
    rows = [
        (of, note.severity.value, note.where, note.message, note.code)
        for severity in reversed(Severity)
        for (of, _), note in notes.items()
        if note.severity is severity
    ]
    separabilities = (report.calibration.friction_separability, report.calibration.separability)
    rows += [
        (
            "calibration",
            Severity.INFO.value,
            ", ".join(separability.names),
            typeset(separability.explanation),
            "told_apart",
        )
        for separability in separabilities
        if separability is not None
    ]
    question = "Which notes apply to the calibration?"
    heads = ("of", "kind", "where", "what", "code")
    return Sheet(NOTES, heads, rows, 1, question=question, wrapped=("what",))


def _forces_sheet(groups: Sequence[ValidationGroup]) -> Sheet:
    """List mean, model and samples of all groups, each at its own deflections."""
    heads = (
        "wire", DEFLECTION.label("length"), "what", DEFLECTION.label("deflection"),
        *(FORCE.label(f"force{end}") for end in ("", ", lower", ", upper")),
        *(FORCE.label(f"mean sample, {end}") for end in ("lower", "upper")),
    )  # fmt: skip
    rows: list[Row] = []
    charts = []
    for group in groups:
        lines = []
        for what, block in _blocks(group).items():
            head = (group.wire, DEFLECTION.factor * group.length, what)
            if block:
                lines.append(Line(what, (len(rows), len(rows) + len(block) - 1), 3, 4))
            rows += [(*head, *row) for row in block]
        title = f"{group.wire}, {length_words(group.length)}"
        charts.append(Chart(title, DEFLECTION.label("Deflection"), FORCE.label("Force"), lines))
    question = "What are the forces of samples and model? 'lower' and 'upper' are 95 % bands."
    drawn = [chart for chart in charts if chart.lines]
    return Sheet("forces", heads, rows, 3, question=question, charts=drawn)


def _blocks(group: ValidationGroup) -> dict[str, list[Row]]:
    """Return the rows of the mean, of the model, if any, and of each sample."""
    band, prediction = group.band, group.prediction
    mean = _columns(band.displacement, band.mean, band.lower, band.upper)
    forces = ("force", "lower", "upper", "lower_mean", "upper_mean")
    model = [] if prediction is None else _columns(
        prediction.deflection, *(getattr(prediction, name) for name in forces)
    )  # fmt: skip
    samples = {
        test: _columns(sample.displacement, sample.force) for test, sample in group.samples.items()
    }
    return {"mean of the samples": mean, "model": model, **samples}


def _columns(across: Floats, *forces: Floats) -> list[Row]:
    """Return rows of deflection and forces in the units of the headings, padded with None."""
    max_forces = 5
    x = (DEFLECTION.factor * across).tolist()
    up = [(FORCE.factor * force).tolist() for force in forces]
    missing = [None] * (max_forces - len(up))
    return [(*row, *missing) for row in zip(x, *up, strict=True)]


_ABOUT = (
    "Calibration of the wire model by first loadings of cantilevers. Cells hold all digits of a"
    " number. An empty cell: not available. Every table has filters.",
    "Sheet 'summary': lower and upper are the ends of 95 % intervals by profile likelihood; for an"
    " open interval, the end of the search. If an interval has several parts, they are listed.",
    "Sheet 'solutions': the values of the summary belong to the first solution, intervals and bands"
    " to all solutions in the 95 % set.",
    "Sheet 'forces': lower and upper of the mean are its 95 % band by Student's t with n - 1"
    " degrees of freedom; those of the model cover one more sample, those of the mean sample the"
    " mean.",
    "Sheets 'external curves': the curves of the plan, compared with the mean of the tests and with"
    " the model at their own deflections, within the range of both.",
)


def save_calibration_workbook(report: CalibrationReport, path: Path) -> None:
    """Write a calibration as an xlsx file.

    Parameters
    ----------
    report : of a calibration
    path : of the file

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    title = f"Calibration of {report.calibration.wire}"
    save_book(About(title, _ABOUT), tables_of(report), path, again="calibrate")
