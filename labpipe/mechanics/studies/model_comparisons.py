"""Compare a calibrated model with tests, grouped by wire and length, and with external curves."""

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
    MAX_DEFLECTION_RATIO,
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
"""Number of evenly spaced deflections at which shapes are compared."""


def compare_shapes(
    result_file: Path, wire: Wire, length: float, rig: StringRig | None, max_deflection: float
) -> tuple[BentShape, ...]:
    """Compare the shapes of a sample and of the model at evenly spaced deflections.

    Parameters
    ----------
    result_file : path of the result.h5 of a test
    wire : model of the wire with the calibrated parameters
    length : free length, m
    rig : string that applies the load; None for an end load normal to the axis
    max_deflection : largest deflection of the first loading, m

    Returns
    -------
    At most `N_SHAPES` shapes, in the coordinates of the clamp. A deflection that no video frame
    reaches has no shape. A test without a fitted shape has none. Measured markers are on the
    surface of the sample. The fitted shape and the model are axes.

    Raises
    ------
    ValueError
        If the model has no equilibrium at one of the deflections.
    """
    shape = read_result(result_file).shape
    if shape is None or not shape.coefficients.size:
        return ()
    tip_height = shape.positions[:, -1, 1] - shape.positions[:, 0, 1]  # above the first marker
    deflection = tip_height - tip_height[np.flatnonzero(np.isfinite(tip_height))[0]]
    max_curvature, _ = wire.law.find_known_range(wire.law.nominal)
    relative_arc_length = np.linspace(0.0, 1.0, 60)
    powers = np.vander(relative_arc_length, shape.coefficients.shape[2], increasing=True)
    shapes = []
    for target_deflection in max_deflection * np.arange(1, N_SHAPES + 1) / N_SHAPES:
        frames = np.flatnonzero(deflection >= target_deflection)
        if len(frames):
            frame = int(frames[0])
            model_axis = _bend_model(wire, length, rig, float(deflection[frame]), max_curvature)
            is_measured = np.isin(shape.flags[frame], (PointFlag.MEASURED, PointFlag.RELABELLED))
            markers = shape.positions[frame, is_measured, :2]
            fitted_axis = powers @ shape.coefficients[frame, :2].T
            shapes.append(BentShape(float(deflection[frame]), markers, fitted_axis, model_axis))
    return tuple(shapes)


def _bend_model(
    wire: Wire, length: float, rig: StringRig | None, deflection: float, max_curvature: float
) -> Floats:
    """Compute the axis of the model at a tip deflection, starting from rest.

    Parameters
    ----------
    wire : model of the wire
    length : free length, m
    rig : string that applies the load; None for an end load normal to the axis
    deflection : deflection of the tip, m
    max_curvature : largest curvature at which the law of the wire is defined, 1/m

    Returns
    -------
    Positions of the axis, shape (n, 2), m.
    """
    # The law is fitted up to a curvature that is larger than the curvature at the clamp. For a
    # small relative deflection u, the curvature at the clamp of a linear elastic wire is 3 u /
    # length. For larger u, it grows faster than u.
    u = min(deflection / length, 0.9)  # at 1, the curvature below would be infinite
    law = fit_play_law(
        wire.section,
        wire.contacts,
        largest_curvature=min(max_curvature, 8.0 * u / (1.0 - u**2) / length),
        orientation=wire.orientation,
    )
    state = make_straight(law, self_weight=wire.self_weight)
    for target in (0.0, deflection):  # the deflection 0 applies the self-weight
        state = deflect(law, state, length, target, rig)
    shape = compute_shape(state, length)
    return np.column_stack([shape.x, shape.y])


_DEFLECTION_GRID = np.linspace(0.0, 1.0, 200) ** 1.5
"""Deflections of a prediction, relative to the largest deflection, densest at the start."""


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
    One group for each wire and length. Groups of the calibrated wire come first.
    """
    # Each key states whether the wire is not the calibrated wire, its name, and the free length, m.
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
    force_noise = float(np.mean([curve.point_error for curve in curves]))
    first_curve, doubtful_deflection = curves[0], np.inf
    prediction, errors, reason = None, None, None
    grid = max_deflection * _DEFLECTION_GRID
    try:
        wire = replace(wire, self_weight=first_curve.self_weight)
        prediction = predict(
            calibration, wire, first_curve.length, grid, rig=first_curve.rig, noise=force_noise
        )
    except ValueError as error:
        reason = Reason("no_prediction", str(error))
    else:
        measured_deflection = np.concatenate([curve.deflection for curve in curves])
        force_and_band = (
            np.interp(measured_deflection, prediction.deflection, force)
            for force in (prediction.force, prediction.lower, prediction.upper)
        )
        measured_force = np.concatenate([curve.force for curve in curves])
        errors = compute_curve_errors(measured_force, *force_and_band)
        parameters = calibration.solutions[0].values
        path = compute_calibrated_curve(
            wire, parameters, first_curve.length, first_curve.rig, max_deflection
        )
        curvature, deflection = path.clamp_curvature, path.deflection
        limit_deflection = np.interp(wire.linear_range, curvature, deflection, right=np.inf)
        doubtful_deflection = float(limit_deflection)
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

    The block mean of a nonlinear curve is biased. Near the start of the curve, the bias is 8 % of
    the force. Therefore the prediction, if there is one, is subtracted before averaging and added
    afterwards.
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


def make_insulation_notes(
    calibration: Calibration,
    wires: Mapping[str, Wire],
    specs: Mapping[str, WireSpec],
    loadings: Sequence[FirstLoading],
) -> Iterator[QualityNote]:
    """Yield notes on wires that the tests bend beyond the linear range of the insulation.

    Parameters
    ----------
    calibration : calibration of one wire
    wires : models of the wires, keyed by name
    specs : specifications of the wires, keyed by name
    loadings : first loadings of all tests

    Yields
    ------
    One note for each such wire. A wire for which the model has no solution in the range of the
    tests has no note, because its group states the reason.
    """
    parameters = calibration.solutions[0].values
    for name in sorted({loading.curve.wire for loading in loadings}):
        curves = [loading.curve for loading in loadings if loading.curve.wire == name]
        try:
            tested_curvature = find_tested_curvature(wires[name], parameters, curves)
        except ValueError:
            continue
        if tested_curvature > wires[name].linear_range:
            yield QualityNote.of(
                "mechanics.studies.soft_insulation_calibrated"
                if name == calibration.wire
                else "mechanics.studies.soft_insulation_predicted",
                name,
                wire=name,
                tested_curvature=tested_curvature,
                limit_curvature=wires[name].linear_range,
                strain_percent=100.0 * specs[name].insulation_strain,
                calibrated_wire=calibration.wire,
            )


def make_misfit_notes(groups: Sequence[ValidationGroup]) -> tuple[QualityNote, ...]:
    """Return notes on tests that lie outside the 95 % band of the calibration that used them.

    Parameters
    ----------
    groups : groups from `compare_tests`

    Returns
    -------
    A note for each group with less than 80 % of its points inside the band. In simulated campaigns
    with the correct wire specification, the fraction was rarely below 95 %.
    """
    min_inside_fraction = 0.8
    return tuple(
        QualityNote.of(
            "mechanics.studies.model_misses_tests",
            f"{group.wire}, {1e3 * group.length:.4g} mm",
            inside_percent=100.0 * group.errors.coverage,
        )
        for group in groups
        if group.is_calibrated and group.errors and group.errors.coverage < min_inside_fraction
    )


def read_external_curves(
    plan: CalibrationPlan, plan_path: Path | None, sheet: WireSheet
) -> tuple[ExternalCurve, ...]:
    """Read all external curves of a plan.

    Parameters
    ----------
    plan : calibration plan
    plan_path : path of the plan, whose folder contains the files of the curves; None for the
        working folder
    sheet : wire sheet

    Returns
    -------
    The curves, in the order of the plan.

    Raises
    ------
    UsageError
        If a curve cannot be read, or its wire is not in the sheet. The message lists all errors.
    """
    folder = Path() if plan_path is None else plan_path.parent
    curves, messages = [], []
    for comparison in plan.comparisons:
        try:
            place = f"{plan_path or 'plan'}, comparison '{comparison.name}', wire"
            sheet.find_wire(comparison.wire, place)
        except UsageError as error:
            messages.append(str(error))
        try:
            curves.append(_read_external_curve(comparison, folder))
        except ReadError as error:
            messages.append(str(error))
    if messages:
        raise UsageError("\n".join(messages))
    return tuple(curves)


def _read_external_curve(comparison: Comparison, folder: Path) -> ExternalCurve:
    """Read the external curve to which a comparison of a plan refers."""
    path = folder / comparison.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ReadError.about("mechanics.studies.curve_outside_plan", path)
    deflection, force = read_curve(
        path,
        CurveColumn("deflection", "m", **dict(comparison.deflection)),
        CurveColumn("force", "N", **dict(comparison.force)),
    )
    return ExternalCurve(
        name=comparison.name,
        file=comparison.file,
        wire=comparison.wire,
        length=comparison.length,
        deflection=deflection,
        force=force,
        is_normal=comparison.load == "normal",
        source=comparison.because,
    )


def compare_external_curves(
    curves: Sequence[ExternalCurve],
    calibration: Calibration,
    wires: Mapping[str, Wire],
    groups: Sequence[ValidationGroup],
    loadings: Sequence[FirstLoading],
) -> Iterator[ExternalCurveComparison]:
    """Compare external curves with the mean of the tests and with the model.

    Parameters
    ----------
    curves : external curves
    calibration : calibration of the model
    wires : models of the wires, keyed by name
    groups : groups of tests of one wire and length
    loadings : first loadings of all tests. If no test has the wire and length of a curve, the rig
        of the first loading is used, with the anchor of the string at the free length of the curve

    Yields
    ------
    One comparison for each curve.
    """
    test_curves = [loading.curve for loading in loadings]
    for curve in curves:
        matching_groups = (g for g in groups if _has_wire_and_length(curve, g.wire, g.length))
        group = next(matching_groups, None)
        default_rig = test_curves[0].rig and replace(test_curves[0].rig, anchor_x=curve.length)
        rigs = (c.rig for c in test_curves if _has_wire_and_length(curve, c.wire, c.length))
        rig = next(rigs, default_rig)
        yield _compare_external_curve(curve, calibration, wires[curve.wire], group, rig)


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
    rig : string that applies the load in the tests; not used if the load of the curve is normal to
        the axis
    """
    test_match, prediction, max_deflection = None, None, float(curve.deflection[-1])
    if group is not None:
        band = group.band
        max_deflection = max(float(np.max(band.displacement, initial=0.0)), max_deflection)
        bounds = band.lower, band.upper
        test_match = compare_curves(curve, band.displacement, band.mean, bounds, "the tests")
    grid = np.linspace(0.0, min(max_deflection, MAX_DEFLECTION_RATIO * curve.length), 200)
    model_rig = None if curve.is_normal else rig
    try:
        prediction = predict(calibration, wire, curve.length, grid, rig=model_rig)
    except ValueError as error:
        reason = format_sentence("mechanics.studies.no_such_curve", error=error)
        no_force = np.full(len(curve.deflection), np.nan)
        model_match = CurveMatch(no_force, None, n_excluded=len(no_force), explanation=reason)
    else:
        bounds = prediction.lower_mean, prediction.upper_mean
        deflection, force = prediction.deflection, prediction.force
        model_match = compare_curves(curve, deflection, force, bounds, "the model")
    notes = list(_make_comparison_notes(curve, test_match, model_match))
    if curve.is_normal and rig is not None:
        notes += _make_load_direction_notes(curve, group, prediction)
    return ExternalCurveComparison(curve, test_match, model_match, prediction, tuple(notes))


def _make_load_direction_notes(
    curve: ExternalCurve, group: ValidationGroup | None, prediction: Prediction | None
) -> Iterator[QualityNote]:
    """Yield a note on the forces of the model with the rig of the tests and with a normal load.

    There is no note if one of the two predictions is missing.
    """
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
        rig_force=1e3 * rig_force,
        normal_force=1e3 * normal_force,
    )


def _make_comparison_notes(
    curve: ExternalCurve, test_match: CurveMatch | None, model_match: CurveMatch
) -> Iterator[QualityNote]:
    """Yield notes on an external curve without tests, and on points that were not compared."""
    if test_match is None:
        values = {"wire": curve.wire, "length": 1e3 * curve.length}
        yield QualityNote.of("mechanics.studies.external_curve_untested", curve.name, **values)
    for match in (test_match, model_match):
        if match is not None and match.explanation:
            yield QualityNote.of(
                "mechanics.studies.external_curve_not_compared"
                if match.errors is None
                else "mechanics.studies.external_curve_cut",
                curve.name,
                reason=match.explanation,
            )
