"""Workbook of a calibration of the wire model: one sheet per question."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire_calibration import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CurveAgreement,
    CurveMatch,
    ExternalCurveComparison,
)
from labpipe.report.calibration_summary import (
    DEFLECTION,
    DISPLAYS,
    FORCE,
    CalibrationReport,
    ValidationGroup,
    typeset,
    write_length,
    write_parameter,
)
from labpipe.report.workbook_file import (
    About,
    Chart,
    Line,
    Record,
    Sheet,
    Value,
    how_to_read,
    make_records,
    make_sheet,
    save_book,
    stack_blocks,
)

BOOK = "calibration"
"""Name of the workbook in ``workbooks.toml``."""
_LENGTH = DEFLECTION.label("length")


def make_sheets(report: CalibrationReport) -> list[Sheet]:
    """Make all sheets of a calibration.

    Parameters
    ----------
    report : of a calibration

    Returns
    -------
    ``summary``, ``solutions``, ``fit``, ``identified``, ``agreement`` (Table 3.3 of the
    dissertation), those of external curves, ``curves``, ``forces`` and ``notes``.
    """
    calibration = report.calibration
    curves = (row for comparison in report.comparisons for row in _external_records(comparison))
    return [
        make_sheet(BOOK, "summary", map(_parameter_record, calibration.parameters)),
        make_sheet(BOOK, "solutions", _solution_records(calibration)),
        make_sheet(BOOK, "fit", _fit_records(calibration)),
        make_sheet(BOOK, "agreement", map(_agreement_record, report.groups)),
        *([make_sheet(BOOK, "external curves", curves)] if report.comparisons else []),
        make_sheet(BOOK, "curves", map(_curve_record, calibration.curves)),
        _forces_sheet(report.groups),
        make_sheet(BOOK, "notes", _note_records(report)),
    ]


def _external_records(comparison: ExternalCurveComparison) -> Iterator[Record]:
    curve = comparison.curve
    for other, match in (("tests", comparison.tests), ("model", comparison.model)):
        yield {
            "name": curve.name,
            "wire": curve.wire,
            _LENGTH: DEFLECTION.factor * curve.length,
            "load": "normal" if curve.is_normal else "as tested",
            "compared with": other,
            **_match_record(match),
            "file": curve.file,
            "from": curve.source,
        }


def _match_record(match: CurveMatch | None) -> Record:
    errors = None if match is None else match.errors
    return {
        "points compared": 0 if errors is None else errors.n,
        "points left out": None if match is None else match.left_out,
        FORCE.label("RMSE"): None if errors is None else FORCE.factor * errors.rmse,
        "RMSE over the largest force (%)": None if errors is None else 100.0 * errors.rmse_share,
        "points inside the band (%)": None if errors is None else 100.0 * errors.inside,
        "reason": "no tests of this wire and length" if match is None else match.explanation,
    }


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _parameter_record(parameter: CalibratedParameter) -> Record:
    display, interval, conflict = DISPLAYS[parameter.name], parameter.interval, parameter.conflict
    factor, has_ends = display.scale.factor, interval is not None
    return {
        "parameter": typeset(display.name).rstrip("."),
        "name": parameter.name,
        "unit": display.scale.unit or "1",
        "value": factor * parameter.value,
        "lower": None if interval is None else factor * interval.lower,
        "upper": None if interval is None else factor * interval.upper,
        "parts of the interval": write_parameter(parameter)[2] if has_ends else "",
        "open below": _yes(parameter.is_open_below) if has_ends else "",
        "open above": _yes(parameter.is_open_above) if has_ends else "",
        "standard error of its logarithm": parameter.log_error if has_ends else None,
        "degrees of freedom": parameter.freedom if has_ends else None,
        "verdict": parameter.verdict.value,
        "at bound": parameter.at_bound,
        "prior, centre": None if conflict is None else factor * conflict.centre,
        "prior, factor": None if conflict is None else conflict.factor,
        "without the prior": None if conflict is None else factor * conflict.alone,
        "conflict (standard errors)": None if conflict is None else conflict.size,
        "contradicts": "" if conflict is None else _yes(conflict.contradicts),
        "source of prior or fixed value": (conflict or parameter).source,
        "in words": typeset(parameter.explanation),
        "prior in words": "" if conflict is None else typeset(conflict.message),
    }


def _solution_records(calibration: Calibration) -> Iterator[Record]:
    """Yield the solutions, which are local minima of the objective; the best first."""
    for number, solution in enumerate(calibration.solutions, start=1):
        values = {
            f"{DISPLAYS[name].name} ({DISPLAYS[name].scale.unit or '1'})": (
                DISPLAYS[name].scale.factor * value
            )
            for name, value in zip(PARAMETERS, solution.values.tolist(), strict=True)
        }
        yield {
            "solution": number,
            **values,
            "RMSE (N)": solution.rmse,
            "rise of the objective": solution.rise,
            "likelihood relative to the best": solution.likelihood,
            "in the 95 % set": _yes(solution.is_allowed),
        }


def _fit_records(calibration: Calibration) -> list[Record]:
    levels = calibration.levels
    rows: tuple[tuple[str, Value, str], ...] = (
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


def _agreement_record(group: ValidationGroup) -> Record:
    errors, why = group.errors, group.reason
    if errors is not None:
        why = None if np.isfinite(group.band.lower).any() else group.band.reason
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
        "band predicts the mean of (samples)": None if errors is None else group.mean_of,
        "reason": str(why or ""),
    }


def _curve_record(curve: CurveAgreement) -> Record:
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


def _note_records(report: CalibrationReport) -> list[Record]:
    """Make the records of all notes, the most severe first, and of what is identified separately.

    A message that several predictions repeat is listed once.
    """
    notes: dict[tuple[str, str], QualityNote] = {}
    for note in report.calibration.notes:
        notes["calibration", note.message] = note
    for group in report.groups:
        for note in group.prediction.notes if group.prediction is not None else ():
            notes["prediction", note.message] = note
    for comparison in report.comparisons:
        for note in comparison.notes:
            notes[f"external curve '{comparison.curve.name}'", note.message] = note
    order = list(reversed(Severity))
    rows = [
        (of, note.severity, note.where, note.message, note.code)
        for (of, _), note in sorted(notes.items(), key=lambda item: order.index(item[1].severity))
    ]
    for separability in (report.calibration.friction_separability, report.calibration.separability):
        if separability is not None:
            names, text = ", ".join(separability.names), typeset(separability.explanation)
            rows.append(("calibration", Severity.INFO, names, text, "told_apart"))
    return [
        {"of": of, "kind": kind.value, "where": where, "what": what, "code": code}
        for of, kind, where, what, code in rows
    ]


def _forces_sheet(groups: Sequence[ValidationGroup]) -> Sheet:
    """Make the sheet of mean, model and samples of all groups, each at its own deflections."""
    curves = list(map(_force_blocks, groups))
    rows, ends = stack_blocks(
        {f"{number} {name}": block
         for number, blocks in enumerate(curves) for name, block in blocks.items()}
    )  # fmt: skip
    charts = []
    for number, (group, blocks) in enumerate(zip(groups, curves, strict=True)):
        lines = [Line(name, ends[f"{number} {name}"], 3, 4) for name in blocks if blocks[name]]
        title = f"{group.wire}, {write_length(group.length)}"
        if lines:
            labels = DEFLECTION.label("Deflection"), FORCE.label("Force")
            charts.append(Chart(title, *labels, lines))
    return make_sheet(BOOK, "forces", rows, charts=charts)


def _force_blocks(group: ValidationGroup) -> dict[str, list[Record]]:
    """Make the records of the mean, of the model, if any, and of each sample, by name."""
    heads = [
        *(FORCE.label(f"force{end}") for end in ("", ", lower", ", upper")),
        *(FORCE.label(f"mean sample, {end}") for end in ("lower", "upper")),
    ]
    band, model = group.band, group.prediction
    curves: dict[str, tuple[Floats, ...]] = {
        "mean of the samples": (band.displacement, band.mean, band.lower, band.upper)
    }
    if model is not None:
        edges = (model.lower, model.upper, model.lower_mean, model.upper_mean)
        curves["model"] = (model.deflection, model.force, *edges)
    for test, sample in group.samples.items():
        curves[test] = (sample.displacement, sample.force)
    blocks = {}
    for name, (x, *forces) in curves.items():
        head: Record = {
            "wire": group.wire, _LENGTH: DEFLECTION.factor * group.length, "what": name
        }  # fmt: skip
        columns = {DEFLECTION.label("deflection"): DEFLECTION.factor * x}
        columns |= {name: FORCE.factor * force for name, force in zip(heads, forces, strict=False)}
        blocks[name] = make_records(head, columns)
    return blocks


def save_calibration_workbook(report: CalibrationReport, path: Path) -> None:
    """Write the workbook of a calibration as an xlsx file.

    Parameters
    ----------
    report : of the calibration
    path : of the file

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    title = f"Calibration of {report.calibration.wire}"
    save_book(About(title, how_to_read(BOOK)), make_sheets(report), path)
