"""Comparison of tests by wire and length with the predictions of a calibrated model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.errors import UsageError, sort_by_likeness
from labpipe.mechanics.studies.first_loadings import FirstLoading, note_insulation
from labpipe.mechanics.studies.wire_sheets import build_wire_error
from labpipe.mechanics.wire.bending_law import fit_play_law
from labpipe.mechanics.wire.calibration.calibrate_wire import Wire
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve, compute_curve_errors
from labpipe.mechanics.wire.calibration.prediction import (
    compute_calibrated_curve,
    find_tested_curvature,
    predict,
)
from labpipe.mechanics.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    hold_level,
    make_straight,
)
from labpipe.mechanics.wire.wire_table import build_wire, find_linear_range, mass_per_length
from labpipe.protocol.sheet_grammar import CalibrationPlan
from labpipe.records.arrays import Floats, average_blocks
from labpipe.records.curve import PointFlag, Shape
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.wire import WireSpec
from labpipe.records.wire_calibration import Calibration, CurveErrors, Prediction
from labpipe.report.calibration_summary import BentShape, ValidationGroup
from labpipe.statistics.mean_curves import compute_band, interpolate_curves
from labpipe.store.read import read_result
from labpipe.units import GRAVITY

N_SHAPES = 6
"""Number of shapes at evenly spaced deflections."""


def compare_shapes(
    file: Path, wire: Wire, length: float, rig: StringRig | None, deepest: float
) -> tuple[BentShape, ...]:
    """Return shapes of a sample and of the model at even steps of deflection.

    Parameters
    ----------
    file : result.h5 of a test with a shape
    wire : with the calibrated numbers
    length : free length, m
    rig : the string; None for an end load normal to the axis
    deepest : m, largest deflection of the first loading

    Returns
    -------
    `N_SHAPES` shapes in the frame of the clamp; none for a test without a fitted shape. Markers are
    on the surface, as measured; fit and model are the axis.

    Raises
    ------
    ValueError
        If the model has no equilibrium at one of the deflections.
    """
    shape = read_result(file).shape
    if shape is None or not shape.coefficients.size:
        return ()
    lift = shape.positions[:, -1, 1] - shape.positions[:, 0, 1]
    rise = lift - lift[np.flatnonzero(np.isfinite(lift))[0]]
    parts = wire.parts
    largest_curvature, _ = parts.reach(parts.given)
    shapes = []
    for target_rise in deepest * np.arange(1, N_SHAPES + 1) / N_SHAPES:
        reached = np.flatnonzero(rise >= target_rise)
        if len(reached):
            frame = int(reached[0])
            model = _bend_model(wire, length, rig, float(rise[frame]), largest_curvature)
            measured = np.isin(shape.flags[frame], (PointFlag.MEASURED, PointFlag.RELABELLED))
            markers = shape.positions[frame, measured, :2]
            axis = _evaluate_axis(shape, frame)
            shapes.append(BentShape(float(rise[frame]), markers, axis, model))
    return tuple(shapes)


def _evaluate_axis(shape: Shape, frame: int) -> Floats:
    places = np.linspace(0.0, 1.0, 60)
    powers = np.vander(places, shape.coefficients.shape[2], increasing=True)
    return np.asarray(powers @ shape.coefficients[frame, :2].T, dtype=np.float64)


def _bend_model(
    wire: Wire, length: float, rig: StringRig | None, deflection: float, largest_curvature: float
) -> Floats:
    """Bend the model from rest to a deflection of its tip; return its axis."""
    tip_tolerance, max_iterations = 1e-6, 8
    share = min(deflection / length, 0.9)
    law = fit_play_law(
        wire.section,
        wire.contacts,
        largest_curvature=min(largest_curvature, 8.0 * share / (1.0 - share**2) / length),
        orientation=wire.orientation,
    )
    weight = wire.self_weight
    if rig is None:
        solution = bend_to_deflection(
            law, hold_level(law, length, weight).state, length, deflection
        )
        return np.column_stack([solution.x, solution.y])
    travel, level = deflection, make_straight(law, self_weight=weight)
    state_at_rest = bend_to_travel(law, level, length, rig, 0.0).state
    for _ in range(max_iterations):  # as the string leans, the tip moves less than the clamp
        solution = bend_to_travel(law, state_at_rest, length, rig, travel)
        missing = deflection - float(solution.y[-1])
        if abs(missing) < tip_tolerance:
            break
        travel += missing
    return np.column_stack([solution.x, solution.y])


DEFAULT_SHEETS = ("wires.xlsx", "wires.csv")
"""Names of the wire sheet in the working folder."""


def find_wire_sheet() -> Path:
    """Return the wire sheet of the working folder.

    Raises
    ------
    UsageError
        If there is none.
    """
    for name in DEFAULT_SHEETS:
        if Path(name).is_file():
            return Path(name)
    raise UsageError.about(
        "mechanics.studies.no_wire_sheet", "--wire", names=" or ".join(DEFAULT_SHEETS)
    )


def choose_wire(
    loadings: Sequence[FirstLoading], settings: CalibrationPlan, plan: Path | None
) -> str:
    """Return the wire of the plan, or the only one with tests.

    Parameters
    ----------
    loadings : of all tests
    settings : the plan
    plan : its file, for messages

    Raises
    ------
    UsageError
        If the wire of the plan has no tests, or it names none and several have tests.
    """
    tested = sorted({loading.curve.wire for loading in loadings})
    if settings.wire is None and len(tested) == 1:
        return tested[0]
    if settings.wire in tested:
        return str(settings.wire)
    if settings.wire is None:
        raise UsageError.about(
            "mechanics.studies.several_wires",
            plan or "tests",
            count=len(tested),
            wires=", ".join(tested),
        )
    raise UsageError.about(
        "mechanics.studies.untested_wire",
        plan or "plan",
        "wire",
        wire=settings.wire,
        tested=", ".join(sort_by_likeness(settings.wire, tested)),
    )


def drop_copies(loadings: Sequence[FirstLoading]) -> tuple[list[FirstLoading], dict[str, str]]:
    """Drop copies of first loadings, which would count as further tests.

    Parameters
    ----------
    loadings : of all tests

    Returns
    -------
    The first of all copies each, and by file why a copy was left out.
    """
    first: dict[tuple[bytes, bytes], FirstLoading] = {}
    left_out: dict[str, str] = {}
    for loading in loadings:
        original = first.setdefault(
            (loading.curve.deflection.tobytes(), loading.curve.force.tobytes()), loading
        )
        if original is not loading:
            error = UsageError.about("mechanics.studies.copy", loading.file, original=original.file)
            left_out[str(loading.file)] = str(error)
    return list(first.values()), left_out


def require_wires(
    loadings: Sequence[FirstLoading], specs: Mapping[str, WireSpec], wires: Path
) -> None:
    """Refuse tests of wires that are not in the sheet.

    Parameters
    ----------
    loadings : of all tests
    specs : wires of the sheet, by name
    wires : the sheet, for messages

    Raises
    ------
    UsageError
        If a wire is missing.
    """
    for wire in sorted({loading.curve.wire for loading in loadings} - set(specs)):
        test = next(loading.curve.test for loading in loadings if loading.curve.wire == wire)
        raise UsageError.about(
            "mechanics.studies.type_not_in_sheet",
            wires,
            "column wire",
            wire=wire,
            test=test,
            near=", ".join(sort_by_likeness(wire, list(specs))),
        )


def build_sheet_wire(spec: WireSpec, wires: Path) -> Wire:
    """Build a wire of the sheet.

    Parameters
    ----------
    spec : of the wire
    wires : the sheet, for messages

    Raises
    ------
    ProcessingError
        If its strands do not fit.
    """
    try:
        wire = build_wire(spec)
    except ValueError as error:
        raise build_wire_error(wires, spec, "a wire that can be built", error) from error
    weight = GRAVITY * mass_per_length(spec, wire.section)
    linear_range = find_linear_range(spec)
    return Wire(wire.section, wire.contacts, spec.orientation, weight, linear_range)


_GRID = np.linspace(0.0, 1.0, 200) ** 1.5
"""Deflections of a prediction as shares of the largest, denser at the start of the curve."""


def compare_tests(
    calibration: Calibration, wires: Mapping[str, Wire], loadings: Sequence[FirstLoading]
) -> tuple[ValidationGroup, ...]:
    """Compare a calibration with its own tests and with others.

    Parameters
    ----------
    calibration : of one wire
    wires : by name
    loadings : all tests

    Returns
    -------
    A group per wire and length, those of the calibrated wire first.
    """
    groups: dict[tuple[bool, str, float], list[FirstLoading]] = {}
    for loading in loadings:
        key = (
            loading.curve.wire != calibration.wire,
            loading.curve.wire,
            round(loading.curve.length, 6),
        )
        groups.setdefault(key, []).append(loading)
    return tuple(
        _compare_group(calibration, wires[wire], groups[other, wire, length])
        for other, wire, length in sorted(groups)
    )


def note_insulations(
    calibration: Calibration,
    wires: Mapping[str, Wire],
    specs: Mapping[str, WireSpec],
    loadings: Sequence[FirstLoading],
) -> tuple[QualityNote, ...]:
    """Return notes on wires that tests bend beyond the linear range of their insulation.

    Parameters
    ----------
    calibration : of one wire
    wires, specs : by name
    loadings : all tests

    Returns
    -------
    A note for each of them. A predicted wire for which the model has no solution in the range of
    the tests has no note: the reason is in its group.
    """
    notes, values = [], calibration.solutions[0].values
    for name in sorted({loading.curve.wire for loading in loadings}):
        curves = [loading.curve for loading in loadings if loading.curve.wire == name]
        try:
            tested_curvature = find_tested_curvature(wires[name], values, curves)
        except ValueError:
            continue
        of = "" if name == calibration.wire else calibration.wire
        notes.append(note_insulation(specs[name], tested_curvature, of=of))
    return tuple(note for note in notes if note is not None)


def note_misfits(groups: Sequence[ValidationGroup]) -> tuple[QualityNote, ...]:
    """Return notes on calibrating tests that lie outside the 95 % band of their calibration.

    Parameters
    ----------
    groups : of `compare_tests`

    Returns
    -------
    A note for each group with less than 80 % of its points inside the band. With the right wire,
    hardly any campaign of the virtual lab had less than 95 %.
    """
    return tuple(
        QualityNote.of(
            "mechanics.studies.model_misses_tests",
            f"{group.wire}, {1e3 * group.length:.4g} mm",
            share=100.0 * group.errors.inside,
        )
        for group in groups
        if group.is_calibrated and group.errors is not None and group.errors.inside < 0.8
    )


def _compare_group(
    calibration: Calibration, wire: Wire, loadings: Sequence[FirstLoading]
) -> ValidationGroup:
    curves = [loading.curve for loading in loadings]
    deepest = max(float(np.nanmax(curve.deflection)) for curve in curves)
    noise = float(np.mean([curve.read_error for curve in curves]))
    first = curves[0]
    prediction, errors, reason, doubtful_deflection = None, None, None, np.inf
    try:
        deflection = deepest * _GRID
        wire = replace(wire, self_weight=first.self_weight)
        specimen = wire, first.length
        prediction = predict(calibration, *specimen, deflection, rig=first.rig, noise=noise)
    except ValueError as error:
        reason = Reason("no_prediction", str(error))
    else:
        errors = _compute_errors(curves, prediction)
        values = calibration.solutions[0].values
        solution = compute_calibrated_curve(wire, values, first.length, first.rig, deepest)
        doubtful_deflection = float(
            np.interp(
                wire.linear_range, solution.clamp_curvature, solution.deflection, right=np.inf
            )
        )
    return ValidationGroup(
        wire=first.wire,
        length=first.length,
        is_calibrated=first.wire == calibration.wire,
        samples={c.test: SampleCurve(c.deflection, c.force, c.force) for c in curves},
        band=_compute_band(curves, prediction),
        prediction=prediction,
        errors=errors,
        reason=reason,
        doubtful_deflection=doubtful_deflection,
    )


def _compute_band(curves: Sequence[MeasuredCurve], prediction: Prediction | None) -> Band:
    """Return the mean of curves and its band, from block means.

    The mean over a block of a curved line is biased, near the start by 8 % of the force. Therefore
    the prediction, if there is one, is subtracted before averaging and added afterwards.
    """
    blocks = 50  # a band of single points would show noise, not the scatter of samples

    def shape(deflection: Floats) -> Floats:
        if prediction is None:
            return np.zeros_like(deflection)
        return np.interp(deflection, prediction.deflection, prediction.force)

    means = [
        (
            average_blocks(c.deflection, blocks),
            average_blocks(c.force - shape(c.deflection), blocks),
        )
        for c in curves
    ]
    common = interpolate_curves(means, [curve.test for curve in curves])
    return compute_band(replace(common, force=common.force + shape(common.displacement)))


def _compute_errors(curves: Sequence[MeasuredCurve], prediction: Prediction) -> CurveErrors:
    """Return the errors of all points of curves, and their share inside the band."""
    deflection = np.concatenate([curve.deflection for curve in curves])
    model, lower, upper = (
        np.interp(deflection, prediction.deflection, values)
        for values in (prediction.force, prediction.lower, prediction.upper)
    )
    return compute_curve_errors(
        np.concatenate([curve.force for curve in curves]), model, lower, upper
    )
