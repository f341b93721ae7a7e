"""The results of a calibration as a workbook, in display units with all digits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire_calibration import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CurveMatch,
    ExternalCurveComparison,
    Separability,
    SourceCalibration,
)
from labpipe.report.calibration_shown import (
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
from labpipe.report.report_workbook import (
    FREE,
    Column,
    Sheet,
    Value,
    column,
    save_sheets,
    sheet_name,
    sheet_of_columns,
    yes,
)

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
    rows = [row for each in comparisons for row in _external_agreement(each)]
    points = [row for each in comparisons for row in _points(each)]
    across, up = DEFLECTION.label("deflection"), FORCE.label("force")
    columns = ("name", across, up, FORCE.label("mean of the tests"), FORCE.label("model"))
    return [
        Sheet(EXTERNAL_CURVES, heads, rows, "B2"),
        Sheet(EXTERNAL_POINTS, columns, points, "B2"),
    ]


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


SUMMARY, SOLUTIONS, FIT = "summary", "solutions", "fit"
IDENTIFIED, CURVES = "identified", "curves"
AGREEMENT, NOTES = "agreement", "notes"
_FRICTION = ("strand_friction", "insulation_friction", "radial_force")


def tables_of(report: CalibrationReport, taken: Sequence[str] = ()) -> list[Sheet]:
    """Make all tables of a calibration.

    Parameters
    ----------
    report : what they hold
    taken : names of sheets that are there already

    Returns
    -------
    ``summary``, ``solutions``, ``fit``, ``identified``, ``agreement`` (Table 3.3 of the source),
    those of external curves, ``curves``, ``notes``, and one sheet for each wire and length.
    """
    calibration = report.calibration
    sheets = [
        _summary(calibration),
        _solutions(calibration),
        _fit(calibration, report.source),
        _identified(calibration, report.source),
        _agreement(report.groups),
        *comparison_tables(report.comparisons),
        _curves(calibration),
        _notes(report),
    ]
    names = [*taken, *(sheet.name for sheet in sheets)]
    for group in report.groups:
        names.append(sheet_name(f"{group.wire}, {length_words(group.length)}", names))
        sheets.append(_group(group, names[-1]))
    return sheets


def _summary(calibration: Calibration) -> Sheet:
    heads = (
        "parameter", "name", "unit", "value", "lower", "upper", "parts of the interval",
        "open below", "open above",
        "standard error of its logarithm", "degrees of freedom", "verdict", "at bound",
        "prior, centre", "prior, factor", "without the prior", "conflict (standard errors)",
        "contradicts", "source of prior or fixed value", "in words", "prior in words",
    )  # fmt: skip
    return Sheet(SUMMARY, heads, [_parameter(each) for each in calibration.parameters], "C2")


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
    return Sheet(SOLUTIONS, heads, rows)


def _scaled(shown: Shown, value: float) -> float | None:
    return shown.scale.factor * value if math.isfinite(value) else None


def _fit(calibration: Calibration, source: SourceCalibration | None) -> Sheet:
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
        ("method", calibration.method, ""),
    ]
    return Sheet(FIT, ("number", "value", "unit"), [*rows, *_source(source)])


def _source(source: SourceCalibration | None) -> Iterator[tuple[Value, ...]]:
    if source is None:
        return
    head = "method: source, "
    yield (f"{head}F_rad (mu_s + mu_p)", source.radial_friction, "N")
    yield (f"{head}mu_s", source.strand_friction, "1")
    yield (f"{head}mu_p", source.insulation_friction, "1")
    yield (f"{head}F_rad", source.radial_force, "N")
    yield (f"{head}start", ", ".join(f"{value:g}" for value in source.start), "")
    yield (f"{head}converged", yes(source.converged), "")
    yield (f"{head}iterations", source.iterations, "1")
    yield (f"{head}SSE", source.sse, "N²")
    yield (f"{head}RMSE", source.rmse, "N")
    yield (f"{head}RMSE over the largest force", source.rmse_share, "1")


def _identified(calibration: Calibration, source: SourceCalibration | None) -> Sheet:
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
    if source is not None:
        values = source.singular_values.tolist()
        rows += [("singular value, method: source", value, *_by_name({})) for value in values]
    heads = (
        "what",
        "of",
        *(f"weight or correlation, {name}" for name in (*PARAMETERS, *_FRICTION)),
    )
    return Sheet(IDENTIFIED, heads, rows)


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
    return Sheet(AGREEMENT, heads, [_agreement_row(group) for group in groups], "C2")


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
            each.test, each.sample, DEFLECTION.factor * each.length, len(each.force),
            each.sample_factor, each.sse, FORCE.factor * each.rmse, 100.0 * each.rmse_share,
            each.lag_one, each.runs_p,
        )
        for each in calibration.curves
    ]  # fmt: skip
    return Sheet(CURVES, heads, rows, "B2")


def _notes(report: CalibrationReport) -> Sheet:
    """Notes of the calibration and of what it predicts, those of one wording once, worst first."""
    told: dict[tuple[str, str], QualityNote] = {}
    for note in report.calibration.notes:
        told["calibration", note.message] = note
    for group in report.groups:
        for note in group.prediction.notes if group.prediction is not None else ():
            told["prediction", note.message] = note
    for each in report.comparisons:
        for note in each.notes:
            told[f"external curve '{each.curve.name}'", note.message] = note
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
            ", ".join(each.names),
            typeset(each.words),
            "told_apart",
        )
        for each in found
        if each is not None
    ]
    return Sheet(NOTES, ("of", "kind", "where", "what", "code"), rows)


def _group(group: ValidationGroup, name: str) -> Sheet:
    """Mean, prediction and samples beside each other, each on its own deflections."""
    blocks = [*_mean(group), *_prediction(group)]
    for test, sample in group.samples.items():
        blocks += [
            FREE,
            column(f"{test}, deflection", DEFLECTION, sample.displacement),
            column(f"{test}, force", FORCE, sample.force),
        ]
    return sheet_of_columns(name, blocks)


def _mean(group: ValidationGroup) -> Iterator[Column]:
    yield column("deflection", DEFLECTION, group.band.displacement)
    yield column("mean", FORCE, group.band.mean)
    yield column("mean, lower", FORCE, group.band.lower)
    yield column("mean, upper", FORCE, group.band.upper)


def _prediction(group: ValidationGroup) -> Iterator[Column]:
    found = group.prediction
    if found is None:
        return
    yield FREE
    yield column("deflection of the model", DEFLECTION, found.deflection)
    yield column("model", FORCE, found.force)
    for name, values in (
        ("model, lower", found.lower),
        ("model, upper", found.upper),
        ("model of the mean sample, lower", found.lower_mean),
        ("model of the mean sample, upper", found.upper_mean),
    ):
        yield column(name, FORCE, values)


_READ_ME = "read me"
_ABOUT = (
    "Calibration of the wire model by first loadings of cantilevers. Numbers are in the units of"
    " their row or heading, with all digits. An empty cell: no such number.",
    "Sheet 'summary': the parameters. Lower and upper are the ends of 95 % intervals by profile"
    " likelihood; where one is open, the end of its search stands there. Where it falls into parts,"
    " they are named.",
    "Sheet 'solutions': what else fits the tests. Values are those of the first, intervals and"
    " bands of all that are in the 95 % set.",
    "Sheet 'fit': what the calibration rests on, and what 'method: source' makes of the tests.",
    "Sheet 'identified': a combination with singular value s is known to 1 / s in logarithms; below"
    " 1 the tests do not determine it.",
    "Sheet 'agreement': model against all points of the samples, for wires and lengths that it was"
    " calibrated by and for others that it predicts. SSE grows with the number of points; the band"
    " is that of one more sample.",
    "Sheet 'curves': each test against the model without the sample's own factor. A sheet for each"
    " wire and length holds mean, model and samples; 'lower' and 'upper' of the mean are its 95 %"
    " band by Student's t with n - 1 degrees of freedom.",
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
    save_sheets(_sheets(report), path, again="calibrate", active=1)


def _sheets(report: CalibrationReport) -> Iterator[Sheet]:
    yield Sheet(_READ_ME, ("About",), [(line,) for line in _ABOUT])
    yield from tables_of(report, [_READ_ME])
