"""The results of a calibration as a workbook: one sheet for each question."""

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
    FORCE,
    SHOWN,
    CalibrationReport,
    Shown,
    ValidationGroup,
    length_words,
    parameter_row,
    typeset,
)
from labpipe.report.workbook_cells import Row, Value
from labpipe.report.workbook_file import About, Chart, Line, Sheet, save_book

EXTERNAL_CURVES, EXTERNAL_POINTS = "external curves", "external curves, points"


def comparison_tables(comparisons: Sequence[ExternalCurveComparison]) -> list[Sheet]:
    """Make the tables of external curves.

    Parameters
    ----------
    comparisons : external curves compared with tests and model

    Returns
    -------
    ``external curves``, two rows for each, and ``external curves, points``; none without any.
    """
    if not comparisons:
        return []
    heads = (
        "name", "wire", DEFLECTION.label("length"), "load", "compared with", "points compared",
        "points left out", FORCE.label("RMSE"), "RMSE over the largest force (%)",
        "points inside the band (%)", "reason", "file", "from",
    )  # fmt: skip
    rows = [row for comparison in comparisons for row in _external_agreement(comparison)]
    points = [row for comparison in comparisons for row in _points(comparison)]
    across, up = DEFLECTION.label("deflection"), FORCE.label("force")
    columns = ("name", across, up, FORCE.label("mean of the tests"), FORCE.label("model"))
    return [
        Sheet(
            EXTERNAL_CURVES, heads, rows, 1,
            asks="How far are external curves from tests and model?",
        ),
        Sheet(
            EXTERNAL_POINTS, columns, points, 1,
            asks="Where are they apart? Force at the deflections of the external curves.",
        ),
    ]  # fmt: skip


def _external_agreement(each: ExternalCurveComparison) -> Iterator[tuple[Value, ...]]:
    curve = each.curve
    load = "normal" if curve.is_normal else "as tested"
    head = (curve.name, curve.wire, DEFLECTION.factor * curve.length, load)
    tail = (curve.file, curve.source)
    if each.tests is None:
        yield (*head, "tests", 0, *[None] * 4, "no tests of this wire and length", *tail)
    else:
        yield (*head, "tests", *_errors(each.tests), *tail)
    yield (*head, "model", *_errors(each.model), *tail)


def _errors(found: CurveMatch) -> tuple[Value, ...]:
    errors = found.errors
    if errors is None:
        return (0, found.left_out, None, None, None, found.words)
    inside = 100.0 * errors.inside if math.isfinite(errors.inside) else None
    rmse = FORCE.factor * errors.rmse
    return (errors.n, found.left_out, rmse, 100.0 * errors.rmse_share, inside, found.words)


def _points(each: ExternalCurveComparison) -> Iterator[tuple[Value, ...]]:
    curve, nothing = each.curve, [math.nan] * len(each.curve.force)
    tests = nothing if each.tests is None else each.tests.reference.tolist()
    columns = (curve.deflection.tolist(), curve.force.tolist(), tests, each.model.reference)
    for across, *forces in zip(*columns, strict=True):
        known = (FORCE.factor * float(v) if math.isfinite(v) else None for v in forces)
        yield (curve.name, DEFLECTION.factor * across, *known)


def yes(value: bool) -> str:
    """Word a truth value for a cell."""
    return "yes" if value else "no"


SUMMARY, SOLUTIONS, FIT = "summary", "solutions", "fit"
IDENTIFIED, CURVES = "identified", "curves"
AGREEMENT, NOTES = "agreement", "notes"
_FRICTION = ("strand_friction", "insulation_friction", "radial_force")


def tables_of(report: CalibrationReport) -> list[Sheet]:
    """Make all tables of a calibration.

    Parameters
    ----------
    report : what they hold

    Returns
    -------
    ``summary``, ``solutions``, ``fit``, ``identified``, ``agreement`` (Table 3.3 of the source),
    those of external curves, ``curves``, ``forces`` and ``notes``.
    """
    calibration = report.calibration
    return [
        _summary(calibration),
        _solutions(calibration),
        _fit(calibration),
        _identified(calibration),
        _agreement(report.groups),
        *comparison_tables(report.comparisons),
        _curves(calibration),
        _forces(report.groups),
        _notes(report),
    ]


def _summary(calibration: Calibration) -> Sheet:
    heads = (
        "parameter", "name", "unit", "value", "lower", "upper", "parts of the interval",
        "open below", "open above",
        "standard error of its logarithm", "degrees of freedom", "verdict", "at bound",
        "prior, centre", "prior, factor", "without the prior", "conflict (standard errors)",
        "contradicts", "source of prior or fixed value", "in words", "prior in words",
    )  # fmt: skip
    rows = [_parameter(parameter) for parameter in calibration.parameters]
    asks = "What are the parameters of the model, and do the tests determine them?"
    last = ("in words", "prior in words")
    return Sheet(SUMMARY, heads, rows, 2, asks=asks, wrapped=last)


def _parameter(parameter: CalibratedParameter) -> tuple[Value, ...]:
    shown, interval, conflict = SHOWN[parameter.name], parameter.interval, parameter.conflict
    up = shown.scale.factor
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
    words = (typeset(parameter.words), "" if conflict is None else typeset(conflict.message))
    named = (typeset(shown.words).rstrip("."), parameter.name, shown.scale.unit or "1")
    verdict = (parameter.verdict.value, parameter.at_bound)
    return (*named, up * parameter.value, *ends, *verdict, *prior, *words)


def _solutions(calibration: Calibration) -> Sheet:
    """Every least of the objective that is not quite unlikely, the best first."""
    shown = [SHOWN[name] for name in PARAMETERS]
    heads = (
        "solution", *(f"{each.words} ({each.scale.unit or '1'})" for each in shown),
        "RMSE (N)", "rise of the objective", "likelihood over that of the best",
        "in the 95 % set",
    )  # fmt: skip
    rows = [
        (
            number,
            *(_scaled(each, v) for each, v in zip(shown, solution.values.tolist(), strict=True)),
            solution.rmse, solution.rise, solution.likelihood, yes(solution.is_allowed),
        )
        for number, solution in enumerate(calibration.solutions, start=1)
    ]  # fmt: skip
    return Sheet(SOLUTIONS, heads, rows, 1, asks="What else fits the tests?")


def _scaled(shown: Shown, value: float) -> float | None:
    return shown.scale.factor * value if math.isfinite(value) else None


def _fit(calibration: Calibration) -> Sheet:
    levels = calibration.levels
    rows: list[tuple[Value, ...]] = [
        ("wire", calibration.wire, ""),
        ("curves", len(calibration.curves), "1"),
        ("samples", calibration.n_samples, "1"),
        ("points", calibration.n_points, "1"),
        ("SSE", calibration.sse, "N²"),
        ("RMSE", calibration.rmse, "N"),
        ("RMSE over the largest force", calibration.rmse_share, "1"),
        ("noise, found over stated", levels.noise_factor, "1"),
        ("degrees of freedom of the noise", levels.noise_freedom, "1"),
        ("correlation of neighbouring points", levels.correlation, "1"),
        ("scatter of samples, in logarithms of the force", levels.scatter, "1"),
        ("degrees of freedom of the scatter", levels.scatter_freedom, "1"),
        ("uncertainty of the load cell's gain, in logarithms", levels.gain, "1"),
        ("intervals wider, for the family of curves is bent", calibration.widening, "1"),
        ("method", calibration.method, ""),
    ]
    asks = "What does the calibration rest on?"
    return Sheet(FIT, ("number", "value", "unit"), rows, 1, asks=asks)


def _identified(calibration: Calibration) -> Sheet:
    """Correlations, and singular values with the weights of what they belong to."""
    rows: list[tuple[Value, ...]] = [
        (
            "correlation of the logarithms with",
            name,
            *_by_name(dict(zip(PARAMETERS, row, strict=True))),
        )
        for name, row in zip(PARAMETERS, calibration.correlations.tolist(), strict=True)
    ]
    rows += _singular("singular value of the parameters", calibration.separability)
    if calibration.friction_separability is not None:
        rows += _singular("singular value of friction", calibration.friction_separability)
    heads = (
        "what",
        "of",
        *(f"weight or correlation, {name}" for name in (*PARAMETERS, *_FRICTION)),
    )
    asks = (
        "Which combinations of parameters are known? One with singular value s is known to 1 / s in"
        " logarithms; below 1 the tests do not determine it."
    )
    return Sheet(IDENTIFIED, heads, rows, 2, asks=asks)


def _singular(what: str, found: Separability) -> Iterator[tuple[Value, ...]]:
    for value, weights in zip(found.singular_values.tolist(), found.combinations, strict=True):
        named = dict(zip(found.names, weights.tolist(), strict=True))
        yield (what, value, *_by_name(named))
    for name, is_known in found.are_identified.items():
        yield ("told apart", name, *_by_name({name: yes(is_known)}))


def _by_name(values: Mapping[str, Value]) -> tuple[Value, ...]:
    return tuple(values.get(name) for name in (*PARAMETERS, *_FRICTION))


def _agreement(groups: Sequence[ValidationGroup]) -> Sheet:
    heads = (
        "wire", DEFLECTION.label("length"), "samples", "model is", "points", "SSE (N²)",
        FORCE.label("RMSE"), "RMSE over the largest force (%)", "points inside the band (%)",
        "band predicts the mean of (samples)", "reason",
    )  # fmt: skip
    asks = (
        "How far are the samples from the model, of wires that calibrated it and of others? The"
        " band is that of one more sample; SSE grows with the number of points."
    )
    return Sheet(AGREEMENT, heads, [_agreement_row(group) for group in groups], 2, asks=asks)


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


def _curves(calibration: Calibration) -> Sheet:
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
    asks = "How far is each test from the model, without the sample's own factor?"
    return Sheet(CURVES, heads, rows, 1, asks=asks)


def _notes(report: CalibrationReport) -> Sheet:
    """Notes of the calibration and of what it predicts, those of one wording once, worst first."""
    told: dict[tuple[str, str], QualityNote] = {}
    for note in report.calibration.notes:
        told["calibration", note.message] = note
    for group in report.groups:
        for note in group.prediction.notes if group.prediction is not None else ():
            told["prediction", note.message] = note
    for comparison in report.comparisons:
        for note in comparison.notes:
            told[f"external curve '{comparison.curve.name}'", note.message] = note
    rows = [
        (of, note.severity.value, note.where, note.message, note.code)
        for severity in reversed(Severity)
        for (of, _), note in told.items()
        if note.severity is severity
    ]
    found = (report.calibration.friction_separability, report.calibration.separability)
    rows += [
        (
            "calibration",
            Severity.INFO.value,
            ", ".join(finding.names),
            typeset(finding.words),
            "told_apart",
        )
        for finding in found
        if finding is not None
    ]
    asks = "What has to be known about the calibration?"
    heads = ("of", "kind", "where", "what", "code")
    return Sheet(NOTES, heads, rows, 1, asks=asks, wrapped=("what",))


def _forces(groups: Sequence[ValidationGroup]) -> Sheet:
    """Mean, model and samples of all groups below each other, each on its own deflections."""
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
    asks = "What are the forces of samples and model? 'lower' and 'upper' are 95 % bands."
    drawn = [chart for chart in charts if chart.lines]
    return Sheet("forces", heads, rows, 3, asks=asks, charts=drawn)


def _blocks(group: ValidationGroup) -> dict[str, list[Row]]:
    """Rows of the mean, of the model where there is one, and of each sample."""
    band, found = group.band, group.prediction
    mean = _columns(band.displacement, band.mean, band.lower, band.upper)
    model = [] if found is None else _columns(
        found.deflection, found.force, found.lower, found.upper, found.lower_mean, found.upper_mean
    )  # fmt: skip
    samples = {
        test: _columns(sample.displacement, sample.force) for test, sample in group.samples.items()
    }
    return {"mean of the samples": mean, "model": model, **samples}


def _columns(across: Floats, *forces: Floats) -> list[Row]:
    """Deflection and forces in the units of the headings; what is missing at the end is empty."""
    x = (DEFLECTION.factor * across).tolist()
    up = [(FORCE.factor * force).tolist() for force in forces]
    missing = [None] * (_MOST_FORCES - len(up))
    return [(*row, *missing) for row in zip(x, *up, strict=True)]


_MOST_FORCES = 5
_ABOUT = (
    "Calibration of the wire model by first loadings of cantilevers. Cells hold all digits of a"
    " number. An empty cell: no such number. Every table has filters.",
    "Sheet 'summary': lower and upper are the ends of 95 % intervals by profile likelihood; where"
    " one is open, the end of its search stands there. Where it falls into parts, they are named.",
    "Sheet 'solutions': values of the summary are those of the first, intervals and bands those of"
    " all that are in the 95 % set.",
    "Sheet 'forces': lower and upper of the mean are its 95 % band by Student's t with n - 1"
    " degrees of freedom, those of the model hold one more sample; those of the mean sample hold"
    " the mean.",
    "Sheets 'external curves': those that the plan names, compared with the mean of the tests and"
    " with the model, at their own deflections and never beyond either.",
)


def save_calibration_workbook(report: CalibrationReport, path: Path) -> None:
    """Write a calibration as an xlsx file.

    Parameters
    ----------
    report : all of it
    path : of the file

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    title = f"Calibration of {report.calibration.wire}"
    save_book(About(title, _ABOUT), tables_of(report), path, again="calibrate")
