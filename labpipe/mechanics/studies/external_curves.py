"""External curves of a calibration plan, compared with tests and model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, UsageError, sort_by_likeness
from labpipe.mechanics.studies.first_loadings import FirstLoading
from labpipe.mechanics.wire.calibration.calibrate_wire import Wire
from labpipe.mechanics.wire.calibration.measured_curves import DEEPEST, compare_curves
from labpipe.mechanics.wire.calibration.prediction import predict
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.messages import format_sentence
from labpipe.protocol.sheet_grammar import CalibrationPlan, Comparison
from labpipe.readers.curve_files import CurveColumn, read_curve
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireSpec
from labpipe.records.wire_calibration import (
    Calibration,
    CurveMatch,
    ExternalCurve,
    ExternalCurveComparison,
    Prediction,
)
from labpipe.report.calibration_summary import ValidationGroup


def read_external_curves(
    settings: CalibrationPlan, plan: Path | None, specs: Mapping[str, WireSpec], wires: Path
) -> tuple[ExternalCurve, ...]:
    """Read all external curves of a plan.

    Parameters
    ----------
    settings : the plan
    plan : its file, whose folder the curves are in
    specs : wires of the sheet, by name
    wires : the sheet, for messages

    Raises
    ------
    UsageError
        If curves cannot be read, or are of a wire that is not in the sheet: all faults in one
        message.
    """
    folder = Path() if plan is None else plan.parent
    external_curves, faults = [], []
    for comparison in settings.comparisons:
        if comparison.wire not in specs:
            nearest = ", ".join(sort_by_likeness(comparison.wire, list(specs)))
            error = UsageError.about(
                "mechanics.studies.curve_of_unknown_wire",
                plan or "plan",
                f"comparison '{comparison.name}', wire",
                sheet=wires,
                near=nearest,
                wire=comparison.wire,
            )
            faults.append(str(error))
        try:
            external_curves.append(_read_external(comparison, folder))
        except ReadError as damaged:
            faults.append(str(damaged))
    if faults:
        raise UsageError("\n".join(faults))
    return tuple(external_curves)


def _read_external(comparison: Comparison, folder: Path) -> ExternalCurve:
    path = folder / comparison.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ReadError.about("mechanics.studies.curve_outside_plan", path)
    across, up = comparison.deflection, comparison.force
    deflection, force = read_curve(
        path,
        CurveColumn("deflection", "m", across.column, across.unit, across.sign),
        CurveColumn("force", "N", up.column, up.unit, up.sign),
    )
    is_normal = comparison.load == "normal"
    return ExternalCurve(
        comparison.name,
        comparison.file,
        comparison.wire,
        comparison.length,
        deflection,
        force,
        is_normal,
        comparison.because,
    )


def compare_external_curves(
    curves: Sequence[ExternalCurve],
    calibration: Calibration,
    wires: Mapping[str, Wire],
    groups: Sequence[ValidationGroup],
    loadings: Sequence[FirstLoading],
) -> tuple[ExternalCurveComparison, ...]:
    """Compare external curves with the mean of the tests and with the model.

    Parameters
    ----------
    curves : external
    calibration : of the model
    wires : by name, those of the curves among them
    groups : tests by wire and length
    loadings : all tests; the rig of the first is used where no test has the wire and length
    """
    return tuple(
        _compare(
            curve,
            calibration,
            wires[curve.wire],
            next(
                (group for group in groups if _is_same_specimen(curve, group.wire, group.length)),
                None,
            ),
            loadings,
        )
        for curve in curves
    )


def _is_same_specimen(curve: ExternalCurve, wire: str, length: float) -> bool:
    max_length_difference = 1e-6  # m
    return curve.wire == wire and abs(curve.length - length) < max_length_difference


def _choose_string(curve: ExternalCurve, loadings: Sequence[FirstLoading]) -> StringRig | None:
    """Return the string of the tests of that wire and length, else of the first test."""
    same_specimen = [
        loading.curve
        for loading in loadings
        if _is_same_specimen(curve, loading.curve.wire, loading.curve.length)
    ]
    if same_specimen:
        return same_specimen[0].rig
    rig = loadings[0].curve.rig
    return None if rig is None else replace(rig, anchor_x=curve.length)


def _compare(
    curve: ExternalCurve,
    calibration: Calibration,
    wire: Wire,
    group: ValidationGroup | None,
    loadings: Sequence[FirstLoading],
) -> ExternalCurveComparison:
    tests, prediction, reason = None, None, ""
    string = _choose_string(curve, loadings)
    rig = None if curve.is_normal else string
    if group is not None:
        band = group.band
        tests = compare_curves(
            curve, band.displacement, band.mean, (band.lower, band.upper), "the tests"
        )
    try:
        tested = 0.0 if group is None else float(np.max(group.band.displacement, initial=0.0))
        deepest = min(max(tested, float(curve.deflection[-1])), DEEPEST * curve.length)
        grid = np.linspace(0.0, deepest, 200)
        prediction = predict(calibration, wire, curve.length, grid, rig=rig)
    except ValueError as error:
        reason = format_sentence("mechanics.studies.no_such_curve", error=error)
    if prediction is None:
        no_force = np.full(len(curve.deflection), np.nan)
        model = CurveMatch(no_force, None, len(no_force), reason)
    else:
        ends = (prediction.lower_mean, prediction.upper_mean)
        model = compare_curves(curve, prediction.deflection, prediction.force, ends, "the model")
    notes = list(_note_comparison(curve, tests, model))
    if rig is not string:
        notes += _note_load_direction(curve, group, prediction)
    return ExternalCurveComparison(curve, tests, model, prediction, tuple(notes))


def _note_load_direction(
    curve: ExternalCurve, group: ValidationGroup | None, prediction: Prediction | None
) -> Iterator[QualityNote]:
    """Note by how much the force depends on the direction of the load, by the model."""
    pulled = None if group is None else group.prediction
    if pulled is None or prediction is None:
        return
    ends = (curve.deflection, pulled.deflection, prediction.deflection)
    end_deflection = min(float(end[-1]) for end in ends)
    as_tested = float(np.interp(end_deflection, pulled.deflection, pulled.force))
    normal = float(np.interp(end_deflection, prediction.deflection, prediction.force))
    yield QualityNote.of(
        "mechanics.studies.external_curve_load",
        curve.name,
        deflection=1e3 * end_deflection,
        tested=1e3 * as_tested,
        normal=1e3 * normal,
    )


def _note_comparison(
    curve: ExternalCurve, tests: CurveMatch | None, model: CurveMatch
) -> Iterator[QualityNote]:
    if tests is None:
        length = 1e3 * curve.length
        yield QualityNote.of(
            "mechanics.studies.external_curve_untested", curve.name, wire=curve.wire, length=length
        )
    for match in (tests, model):
        if match is not None and match.explanation:
            yield QualityNote.of(
                "mechanics.studies.external_curve_not_compared"
                if match.errors is None
                else "mechanics.studies.external_curve_cut",
                curve.name,
                reason=match.explanation,
            )
