"""Compare a calibrated model with tests, by wire and length, and with external curves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, UsageError
from labpipe.mechanics.studies.first_loadings import FirstLoading
from labpipe.mechanics.studies.wire_sheets import WireSheet
from labpipe.mechanics.wire.bending_law import fit_play_law
from labpipe.mechanics.wire.calibration.calibrate_wire import (
    Wire,
    compute_calibrated_curve,
    find_tested_curvature,
    predict,
)
from labpipe.mechanics.wire.calibration.measured_curves import (
    MAX_DEFLECTION,
    MeasuredCurve,
    compare_curves,
    compute_curve_errors,
)
from labpipe.mechanics.wire.cantilever import StringRig, compute_shape, deflect, make_straight
from labpipe.messages import format_sentence
from labpipe.protocol.model_files import CalibrationPlan, Comparison
from labpipe.readers.curve_files import CurveColumn, read_curve
from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.curve import PointFlag
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.wire import (
    Calibration,
    CurveMatch,
    ExternalCurve,
    ExternalCurveComparison,
    Prediction,
    WireSpec,
)
from labpipe.report.calibration_report import BentShape, ValidationGroup
from labpipe.statistics.groups import compute_band, interpolate_curves
from labpipe.store.result_files import read_result

N_SHAPES = 6
"""Number of shapes of a sample, at evenly spaced deflections."""


def compare_shapes(
    file: Path, wire: Wire, length: float, rig: StringRig | None, max_deflection: float
) -> tuple[BentShape, ...]:
    """Compute shapes of a sample and of the model at evenly spaced deflections.

    Parameters
    ----------
    file : result.h5 of a test with a shape
    wire : model of the wire with the calibrated parameters
    length : free length, m
    rig : string that applies the load; None for an end load normal to the axis
    max_deflection : largest deflection of the first loading, m

    Returns
    -------
    `N_SHAPES` shapes in the frame of the clamp; empty for a test without a fitted shape. Measured
    markers are on the surface of the sample; the fitted shape and the model are axes.

    Raises
    ------
    ValueError
        If the model has no equilibrium at one of the deflections.
    """
    shape = read_result(file).shape
    if shape is None or not shape.coefficients.size:
        return ()
    tip_height = shape.positions[:, -1, 1] - shape.positions[:, 0, 1]
    deflection = tip_height - tip_height[np.flatnonzero(np.isfinite(tip_height))[0]]
    wire_law = wire.law
    max_curvature, _ = wire_law.find_known_range(wire_law.nominal)
    powers = np.vander(np.linspace(0.0, 1.0, 60), shape.coefficients.shape[2], increasing=True)
    shapes = []
    for target_deflection in max_deflection * np.arange(1, N_SHAPES + 1) / N_SHAPES:
        frames = np.flatnonzero(deflection >= target_deflection)
        if len(frames):
            frame = int(frames[0])
            model = _bend_model(wire, length, rig, float(deflection[frame]), max_curvature)
            is_measured = np.isin(shape.flags[frame], (PointFlag.MEASURED, PointFlag.RELABELLED))
            markers = shape.positions[frame, is_measured, :2]
            axis = powers @ shape.coefficients[frame, :2].T
            shapes.append(BentShape(float(deflection[frame]), markers, axis, model))
    return tuple(shapes)


def _bend_model(
    wire: Wire, length: float, rig: StringRig | None, deflection: float, max_curvature: float
) -> Floats:
    """Bend the model from rest to a deflection of its tip.

    Parameters
    ----------
    wire : model of the wire
    length : free length, m
    rig : string that applies the load; None for an end load normal to the axis
    deflection : deflection of the tip, m
    max_curvature : largest curvature at which the law is known, 1/m

    Returns
    -------
    Positions of the axis, shape (n, 2), m.
    """
    # The law is fitted up to a curvature that is larger than that at the clamp. At the clamp of an
    # elastic wire, it is 3 u / length for a small relative deflection u, and grows faster than u.
    u = min(deflection / length, 0.9)
    law = fit_play_law(
        wire.section,
        wire.contacts,
        largest_curvature=min(max_curvature, 8.0 * u / (1.0 - u**2) / length),
        orientation=wire.orientation,
    )
    state = make_straight(law, self_weight=wire.self_weight)
    for target in (0.0, deflection):
        state = deflect(law, state, length, target, rig)
    shape = compute_shape(state, length)
    return np.column_stack([shape.x, shape.y])


_DEFLECTION_GRID = np.linspace(0.0, 1.0, 200) ** 1.5
"""Deflections of a prediction as fractions of the largest one, denser at the start of the curve."""


def compare_tests(
    calibration: Calibration, wires: Mapping[str, Wire], loadings: Sequence[FirstLoading]
) -> tuple[ValidationGroup, ...]:
    """Compare a calibration with the tests to which it was fitted, and with other tests.

    Parameters
    ----------
    calibration : calibration of one wire
    wires : models of the wires, keyed by name
    loadings : first loadings of all tests

    Returns
    -------
    One group for each wire and length; groups of the calibrated wire come first.
    """
    groups: dict[tuple[bool, str, float], list[MeasuredCurve]] = {}
    for curve in (loading.curve for loading in loadings):
        key = (curve.wire != calibration.wire, curve.wire, round(curve.length, 6))
        groups.setdefault(key, []).append(curve)
    return tuple(_compare_group(calibration, wires[key[1]], groups[key]) for key in sorted(groups))


def _compare_group(
    calibration: Calibration, wire: Wire, curves: Sequence[MeasuredCurve]
) -> ValidationGroup:
    """Compare a calibration with tests of one wire and length."""
    max_deflection = max(float(np.nanmax(curve.deflection)) for curve in curves)
    noise = float(np.mean([curve.point_error for curve in curves]))
    first_curve = curves[0]
    prediction, errors, reason, doubtful_deflection = None, None, None, np.inf
    try:
        deflection = max_deflection * _DEFLECTION_GRID
        wire = replace(wire, self_weight=first_curve.self_weight)
        prediction = predict(
            calibration, wire, first_curve.length, deflection, rig=first_curve.rig, noise=noise
        )
    except ValueError as error:
        reason = Reason("no_prediction", str(error))
    else:
        measured = np.concatenate([curve.deflection for curve in curves])
        model_and_band = (
            np.interp(measured, prediction.deflection, values)
            for values in (prediction.force, prediction.lower, prediction.upper)
        )
        force = np.concatenate([curve.force for curve in curves])
        errors = compute_curve_errors(force, *model_and_band)
        values = calibration.solutions[0].values
        solution = compute_calibrated_curve(
            wire, values, first_curve.length, first_curve.rig, max_deflection
        )
        curvature, deflection = solution.clamp_curvature, solution.deflection
        limit = np.interp(wire.linear_range, curvature, deflection, right=np.inf)
        doubtful_deflection = float(limit)
    return ValidationGroup(
        wire=first_curve.wire,
        length=first_curve.length,
        is_calibrated=first_curve.wire == calibration.wire,
        samples={c.test: SampleCurve(c.deflection, c.force, c.force) for c in curves},
        band=_compute_band(curves, prediction),
        prediction=prediction,
        errors=errors,
        reason=reason,
        doubtful_deflection=doubtful_deflection,
    )


def _compute_band(curves: Sequence[MeasuredCurve], prediction: Prediction | None) -> Band:
    """Compute the mean of curves and its band from block means.

    The mean over a block of a curved line is biased, near its start by 8 % of the force. Therefore
    the prediction, if there is one, is subtracted before averaging and added afterwards.
    """
    n_blocks = 50  # a band of single points would show noise, not the scatter of samples

    def predict_force(deflection: Floats) -> Floats:
        if prediction is None:
            return np.zeros_like(deflection)
        return np.interp(deflection, prediction.deflection, prediction.force)

    block_means = []
    for curve in curves:
        residual_force = average_blocks(curve.force - predict_force(curve.deflection), n_blocks)
        block_means.append((average_blocks(curve.deflection, n_blocks), residual_force))
    residuals = interpolate_curves(block_means, [curve.test for curve in curves])
    force = residuals.force + predict_force(residuals.displacement)
    return compute_band(replace(residuals, force=force))


def note_insulations(
    calibration: Calibration,
    wires: Mapping[str, Wire],
    specs: Mapping[str, WireSpec],
    loadings: Sequence[FirstLoading],
) -> Iterator[QualityNote]:
    """Yield notes on wires that tests bend beyond the linear range of their insulation.

    Parameters
    ----------
    calibration : calibration of one wire
    wires : models of the wires, keyed by name
    specs : specifications of the wires, keyed by name
    loadings : first loadings of all tests

    Yields
    ------
    One note for each wire. A predicted wire without a solution in the range of the tests has no
    note, because its group states the reason.
    """
    values = calibration.solutions[0].values
    for name in sorted({loading.curve.wire for loading in loadings}):
        curves = [loading.curve for loading in loadings if loading.curve.wire == name]
        try:
            tested_curvature = find_tested_curvature(wires[name], values, curves)
        except ValueError:
            continue
        if tested_curvature > wires[name].linear_range:
            yield QualityNote.of(
                "mechanics.studies.soft_insulation_calibrated"
                if name == calibration.wire
                else "mechanics.studies.soft_insulation_predicted",
                name,
                wire=name,
                tested=tested_curvature,
                limit=wires[name].linear_range,
                strain=100.0 * specs[name].insulation_strain,
                calibrated=calibration.wire,
            )


def note_misfits(groups: Sequence[ValidationGroup]) -> tuple[QualityNote, ...]:
    """Return notes on calibrating tests that lie outside the 95 % band of their calibration.

    Parameters
    ----------
    groups : groups from `compare_tests`

    Returns
    -------
    A note for each group with less than 80 % of its points inside the band. With the right wire,
    hardly any campaign of the virtual lab had less than 95 %.
    """
    min_inside_fraction = 0.8
    return tuple(
        QualityNote.of(
            "mechanics.studies.model_misses_tests",
            f"{group.wire}, {1e3 * group.length:.4g} mm",
            share=100.0 * group.errors.coverage,
        )
        for group in groups
        if group.is_calibrated and group.errors and group.errors.coverage < min_inside_fraction
    )


def read_external_curves(
    settings: CalibrationPlan, plan: Path | None, sheet: WireSheet
) -> tuple[ExternalCurve, ...]:
    """Read all external curves of a plan.

    Parameters
    ----------
    settings : content of the plan
    plan : path of the plan, in whose folder the files of the curves are; None without a plan
    sheet : wire sheet

    Raises
    ------
    UsageError
        If curves cannot be read, or are of a wire that is not in the sheet. The message states all
        faults.
    """
    folder = Path() if plan is None else plan.parent
    curves, faults = [], []
    for comparison in settings.comparisons:
        try:
            sheet.find_wire(
                comparison.wire, f"{plan or 'plan'}, comparison '{comparison.name}', wire"
            )
        except UsageError as error:
            faults.append(str(error))
        try:
            curves.append(_read_external_curve(comparison, folder))
        except ReadError as error:
            faults.append(str(error))
    if faults:
        raise UsageError("\n".join(faults))
    return tuple(curves)


def _read_external_curve(comparison: Comparison, folder: Path) -> ExternalCurve:
    """Read the external curve of a comparison in a plan."""
    path = folder / comparison.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ReadError.about("mechanics.studies.curve_outside_plan", path)
    columns = ("deflection", "m", comparison.deflection), ("force", "N", comparison.force)
    deflection, force = read_curve(
        path, *(CurveColumn(name, unit, c.column, c.unit, c.sign) for name, unit, c in columns)
    )
    return ExternalCurve(
        *(comparison.name, comparison.file, comparison.wire, comparison.length),
        *(deflection, force, comparison.load == "normal", comparison.because),
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
    curves : external curves
    calibration : calibration of the model
    wires : models of the wires, keyed by name
    groups : groups of tests of one wire and length
    loadings : first loadings of all tests. If no test has the wire and length of a curve, its rig
        is that of the first loading
    """
    comparisons, tests = [], [loading.curve for loading in loadings]
    for curve in curves:
        matches = (g for g in groups if _has_wire_and_length(curve, g.wire, g.length))
        group = next(matches, None)
        rig = tests[0].rig and replace(tests[0].rig, anchor_x=curve.length)
        rigs = (test.rig for test in tests if _has_wire_and_length(curve, test.wire, test.length))
        rig = next(rigs, rig)
        comparison = _compare_external_curve(curve, calibration, wires[curve.wire], group, rig)
        comparisons.append(comparison)
    return tuple(comparisons)


def _has_wire_and_length(curve: ExternalCurve, wire: str, length: float) -> bool:
    """Return whether an external curve is of a given wire and free length."""
    max_length_difference = 1e-6  # m
    return curve.wire == wire and abs(curve.length - length) < max_length_difference


def _compare_external_curve(
    curve: ExternalCurve,
    calibration: Calibration,
    wire: Wire,
    group: ValidationGroup | None,
    rig: StringRig | None,
) -> ExternalCurveComparison:
    """Compare an external curve with the tests of a group and with the model.

    Parameters
    ----------
    curve : external curve
    calibration : calibration of the model
    wire : model of the wire
    group : tests of the wire and length of the curve; None if there are none
    rig : rig of the tests, which is used unless the load of the curve is normal to the axis
    """
    tests, prediction, max_deflection = None, None, float(curve.deflection[-1])
    if group is not None:
        band = group.band
        max_deflection = max(float(np.max(band.displacement, initial=0.0)), max_deflection)
        bounds = band.lower, band.upper
        tests = compare_curves(curve, band.displacement, band.mean, bounds, "the tests")
    grid = np.linspace(0.0, min(max_deflection, MAX_DEFLECTION * curve.length), 200)
    model_rig = None if curve.is_normal else rig
    try:
        prediction = predict(calibration, wire, curve.length, grid, rig=model_rig)
    except ValueError as error:
        reason = format_sentence("mechanics.studies.no_such_curve", error=error)
        no_force = np.full(len(curve.deflection), np.nan)
        model = CurveMatch(no_force, None, len(no_force), reason)
    else:
        bounds = prediction.lower_mean, prediction.upper_mean
        model = compare_curves(curve, prediction.deflection, prediction.force, bounds, "the model")
    notes = list(_note_comparison(curve, tests, model))
    if model_rig is not rig:
        notes += _note_load_direction(curve, group, prediction)
    return ExternalCurveComparison(curve, tests, model, prediction, tuple(notes))


def _note_load_direction(
    curve: ExternalCurve, group: ValidationGroup | None, prediction: Prediction | None
) -> Iterator[QualityNote]:
    """Yield a note on the forces of the model with the rig of the tests and with a normal load."""
    rig_prediction = None if group is None else group.prediction
    if rig_prediction is None or prediction is None:
        return
    deflections = (curve.deflection, rig_prediction.deflection, prediction.deflection)
    common_deflection = min(float(deflection[-1]) for deflection in deflections)
    rig_force, normal_force = (
        float(np.interp(common_deflection, model.deflection, model.force))
        for model in (rig_prediction, prediction)
    )
    yield QualityNote.of(
        "mechanics.studies.external_curve_load",
        curve.name,
        deflection=1e3 * common_deflection,
        tested=1e3 * rig_force,
        normal=1e3 * normal_force,
    )


def _note_comparison(
    curve: ExternalCurve, tests: CurveMatch | None, model: CurveMatch
) -> Iterator[QualityNote]:
    """Yield notes on an external curve without tests, and on points that were not compared."""
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
