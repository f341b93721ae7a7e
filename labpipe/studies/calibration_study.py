"""Calibration of a wire model by processed cantilever tests, with its predictions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from labpipe import __version__
from labpipe.decks import write_decks
from labpipe.errors import ProcessingError
from labpipe.process.output_paths import find_results, refuse_repeated, shared_folder
from labpipe.protocol.load import load_calibration_plan
from labpipe.protocol.plans import CalibrationPlan
from labpipe.records.wire import WireSpec
from labpipe.records.wire_calibration import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CalibrationFailure,
    CurveAgreement,
    CurveErrors,
    CurveMatch,
    ExternalCurveComparison,
    ParameterChoice,
    Separability,
    Solution,
)
from labpipe.report.calibration_figures import calibration_drawings
from labpipe.report.calibration_summary import BentShape, CalibrationReport, ValidationGroup
from labpipe.report.calibration_workbook import save_calibration_workbook
from labpipe.report.saving import pngs_of, save_pages
from labpipe.store.replace import locked, replacing_together
from labpipe.store.summaries import finite_or_none
from labpipe.studies.external_curves import compare_external_curves, read_external_curves
from labpipe.studies.first_loadings import (
    FirstLoading,
    read_first_loadings,
    weight_note,
    with_self_weight,
)
from labpipe.studies.stress_tables import StatedCurve
from labpipe.studies.validation import (
    bent_shapes,
    built_wire,
    compare,
    default_sheet,
    drop_copies,
    insulation_notes,
    mark_doubtful_parts,
    misfit_notes,
    require_wires,
    wire_to_calibrate,
)
from labpipe.studies.wire_specs import read_wires
from labpipe.wire.calibration.calibrate_wire import Settings, Wire, calibrate
from labpipe.wire.law_family import with_values
from labpipe.wire.tested_curvature import tested_curvature
from labpipe.wire.wire_table import wire_table


def comparison_json(comparison: ExternalCurveComparison) -> dict[str, object]:
    """Return a comparison as lists and SI numbers; None where there is no number.

    Parameters
    ----------
    comparison : of an external curve
    """
    curve = comparison.curve
    return {
        "name": curve.name,
        "file": curve.file,
        "source": curve.source,
        "wire": curve.wire,
        "length": curve.length,
        "load": "normal" if curve.is_normal else "as tested",
        "deflection": curve.deflection.tolist(),
        "force": curve.force.tolist(),
        "tests": None if comparison.tests is None else _match_json(comparison.tests),
        "model": _match_json(comparison.model),
        "quality": [asdict(note) for note in comparison.notes],
    }


def _match_json(match: CurveMatch) -> dict[str, object]:
    errors = match.errors
    return {
        "n": 0 if errors is None else errors.n,
        "left_out": match.left_out,
        **_errors_json(errors),
        "force": _numbers(match.reference),
        "reason": match.explanation,
    }


def _errors_json(errors: CurveErrors | None) -> dict[str, float | None]:
    names = {"rmse": "rmse", "rmse_share": "rmse_share", "inside_band": "inside"}
    return {
        key: None if errors is None else finite_or_none(getattr(errors, name))
        for key, name in names.items()
    }


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [finite_or_none(value) for value in values]


SCHEMA = 2


def calibration_json(
    calibration: Calibration,
    groups: Sequence[ValidationGroup],
    left_out: Mapping[str, str],
    tested: float = math.nan,
) -> dict[str, object]:
    """Return a calibration as lists and SI numbers; None where there is no number.

    Parameters
    ----------
    calibration : of one wire
    groups : tests that it is compared with
    left_out : by file, why a test was not used
    tested : 1/m, largest curvature in the tests
    """
    friction = calibration.friction_separability
    return {
        "schema": SCHEMA,
        "labpipe": __version__,
        "wire": calibration.wire,
        "method": calibration.method,
        "parameters": [_parameter_json(parameter) for parameter in calibration.parameters],
        "solutions": [_solution_json(solution) for solution in calibration.solutions],
        "widening": calibration.widening,
        "tested_curvature": finite_or_none(tested),
        "correlations": {
            "names": list(PARAMETERS),
            "values": [_numbers(row) for row in calibration.correlations],
        },
        "separability": _separability_json(calibration.separability),
        "friction_separability": None if friction is None else _separability_json(friction),
        "levels": {key: finite_or_none(value) for key, value in asdict(calibration.levels).items()},
        "n_points": calibration.n_points,
        "n_samples": calibration.n_samples,
        "sse": calibration.sse,
        "rmse": calibration.rmse,
        "rmse_share": calibration.rmse_share,
        "curves": [_curve_json(curve) for curve in calibration.curves],
        "groups": [_group_json(group) for group in groups],
        "left_out": dict(left_out),
        "quality": [asdict(note) for note in calibration.notes],
    }


def _parameter_json(parameter: CalibratedParameter) -> dict[str, object]:
    interval, conflict = parameter.interval, parameter.conflict
    lower, upper = (None, None) if interval is None else _numbers([interval.lower, interval.upper])
    return {
        "name": parameter.name,
        "value": finite_or_none(parameter.value),
        "unit": parameter.unit,
        "lower": None if parameter.is_open_below else lower,
        "upper": None if parameter.is_open_above else upper,
        "level": None if interval is None else interval.level,
        "intervals": _intervals(parameter),
        "verdict": str(parameter.verdict),
        "words": parameter.explanation,
        "profiles": [
            {
                "value": _numbers(profile.value),
                "deviance": _numbers(profile.deviance),
                "threshold_below": finite_or_none(profile.threshold_below),
                "threshold_above": finite_or_none(profile.threshold_above),
            }
            for profile in parameter.profiles
        ],
        "prior": None
        if conflict is None
        else {
            "value": finite_or_none(conflict.centre),
            "factor": finite_or_none(conflict.factor),
            "source": conflict.source,
            "without": finite_or_none(conflict.alone),
            "size": finite_or_none(conflict.size),
            "contradicts": conflict.contradicts,
            "message": conflict.message,
        },
        "source": parameter.source,
    }


def _intervals(parameter: CalibratedParameter) -> list[list[float | None]]:
    """Return the parts of the interval; None for an open end."""
    ends = [
        [finite_or_none(part.lower), finite_or_none(part.upper)] for part in parameter.intervals
    ]
    if ends and parameter.is_open_below:
        ends[0][0] = None
    if ends and parameter.is_open_above:
        ends[-1][1] = None
    return ends


def _solution_json(solution: Solution) -> dict[str, object]:
    return {
        **dict(zip(PARAMETERS, _numbers(solution.values), strict=True)),
        "rise": solution.rise,
        "likelihood": solution.likelihood,
        "in_95_percent_set": solution.is_allowed,
        "rmse": solution.rmse,
        "limit": solution.limit,
        "covariance": solution.covariance.tolist(),
        "mixture": {
            "chance": solution.mixture.chance.tolist(),
            "scatter": solution.mixture.scatter.tolist(),
            "shift": solution.mixture.shift.tolist(),
            "covariance": solution.mixture.covariance.tolist(),
            "freedom": finite_or_none(solution.mixture.freedom),
        },
    }


def _separability_json(separability: Separability) -> dict[str, object]:
    return {
        "names": list(separability.names),
        "singular_values": _numbers(separability.singular_values),
        "combinations": [_numbers(row) for row in separability.combinations],
        "identified": dict(separability.are_identified),
        "words": separability.explanation,
    }


def _curve_json(curve: CurveAgreement) -> dict[str, object]:
    names = ("sample_factor", "sse", "rmse", "rmse_share", "runs_p")
    return {
        "test": curve.test,
        "sample": curve.sample,
        "length": curve.length,
        **{name: finite_or_none(getattr(curve, name)) for name in names},
        "lag_one": finite_or_none(curve.lag_one_correlation),
    }


def _group_json(group: ValidationGroup) -> dict[str, object]:
    errors, prediction = group.errors, group.prediction
    return {
        "wire": group.wire,
        "length": group.length,
        "calibrating": group.is_calibrated,
        "tests": list(group.samples),
        "n": None if errors is None else errors.n,
        "sse": None if errors is None else finite_or_none(errors.sse),
        **_errors_json(errors),
        "reasons": [] if group.reason is None else [asdict(group.reason)],
        "prediction": None
        if prediction is None
        else {
            name: _numbers(getattr(prediction, name))
            for name in ("deflection", "force", "lower", "upper", "lower_mean", "upper_mean")
        },
    }


MODEL_FILE = "calibration.json"
WORKBOOK_FILE = "calibration.xlsx"
FIGURES_FOLDER = "figures"
_REMEDY = (
    "Check the values and units of fixed and prior values in the plan, and the row of the wire."
)


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibration with its comparisons.

    Parameters
    ----------
    folder : of the results
    calibration : of the wire that was calibrated
    groups : samples of one wire and length each, those of the calibrated wire first
    left_out : by file, why a test was not used
    files : all that were written
    comparisons : external curves, compared with tests and model
    tested_curvature : 1/m, largest in the tests of the calibrated wire
    shapes : of one sample of the calibrated wire and of the model, by test
    stress_tables : of the calibrated wire in the sheet, by column
    """

    folder: Path
    calibration: Calibration
    groups: tuple[ValidationGroup, ...]
    left_out: Mapping[str, str]
    files: tuple[Path, ...]
    comparisons: tuple[ExternalCurveComparison, ...] = ()
    tested_curvature: float = math.nan
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    stress_tables: Mapping[str, StatedCurve] = field(default_factory=dict)


def calibrate_tests(
    targets: Sequence[Path],
    *,
    wires: Path | None = None,
    plan: Path | None = None,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Calibrated:
    """Calibrate one wire by its tests and predict the tests of other wires.

    Parameters
    ----------
    targets : result.h5 files, or folders that hold some
    wires : the wire sheet that has the specimen types as its wires; None for ``wires.xlsx`` or
        ``wires.csv`` in the working folder
    plan : calibration YAML; None for all parameters free
    out : folder of the results; None for ``calibration`` in the common folder of all tests
    figures : whether to draw
    png : figures as PNG, too; without it those of an earlier run are removed
    say : called with the name of each test as it is read, then with each stage

    Returns
    -------
    The calibration and its files.

    Raises
    ------
    LabpipeError
        If a file has faults, no test can be used, two have the same name, the wire to calibrate is
        ambiguous, or the calibration fails; earlier results are then unchanged.
    """
    settings = load_calibration_plan(plan) if plan is not None else CalibrationPlan(version=1)
    wires = default_sheet() if wires is None else wires
    sheet = read_wires(wires)
    specs = {spec.name: spec for spec in sheet.specs}
    curves = read_external_curves(settings, plan, specs, wires)
    files = find_results(targets)
    loadings, left_out = read_first_loadings(
        files, points=settings.points, up_to=settings.up_to, say=say
    )
    if not loadings:
        raise ProcessingError("\n".join(left_out.values()))
    refuse_repeated([(loading.curve.test, loading.file) for loading in loadings], "name")
    loadings, copies = drop_copies(loadings)
    name = wire_to_calibrate(loadings, settings, plan)
    require_wires(loadings, specs, wires)
    tested = {loading.curve.wire for loading in loadings}
    wires_needed = sorted(tested | {curve.wire for curve in curves})
    built = {wire: built_wire(specs[wire], wires) for wire in wires_needed}
    unweighted = [loading for loading in loadings if loading.curve.wire == name]
    weight = weight_note(unweighted, built[name].self_weight)
    loadings = [
        with_self_weight(loading, built[loading.curve.wire].self_weight) for loading in loadings
    ]
    calibrating = [loading for loading in loadings if loading.curve.wire == name]
    say("calibration")
    tables = [curve.table for curve in sheet.curves[name].values()]
    calibration = _calibration(built[name], calibrating, settings, tables)
    measured = [loading.curve for loading in calibrating]
    reach = tested_curvature(built[name], calibration.solutions[0].values, measured)
    notes = (weight, *insulation_notes(calibration, built, specs, loadings))
    groups = compare(calibration, built, loadings)
    notes = (*notes, *misfit_notes(groups))
    calibration = replace(calibration, notes=(*calibration.notes, *filter(None, notes)))
    groups = mark_doubtful_parts(groups, calibration, built, specs, loadings)
    done = Calibrated(
        folder=shared_folder(files) / "calibration" if out is None else out,
        calibration=calibration,
        groups=groups,
        left_out=left_out | copies,
        files=(),
        comparisons=compare_external_curves(
            curves, calibration, built, groups, calibrating + loadings
        ),
        tested_curvature=reach,
        stress_tables=sheet.curves[name],
    )
    if figures:
        wire = built_wire(calibrated_spec(specs[name], calibration), wires)
        done = replace(done, shapes=_shapes(calibrating[0], wire))
    calibrated = [calibrated_spec(specs[test], calibration) for test in sorted(tested)]
    return replace(done, files=_write(done, calibrated, say, figures=figures, png=png))


def calibrated_spec(spec: WireSpec, calibration: Calibration) -> WireSpec:
    """Return a wire with the parameters of a calibration instead of those of its sheet.

    Parameters
    ----------
    spec : of the calibrated wire, or of another of the same make
    calibration : a parameter without effect is left unchanged

    Returns
    -------
    The wire; its radial force belongs to its friction coefficients.
    """
    return with_values(
        spec, {parameter.name: parameter.value for parameter in calibration.parameters}
    )


def _calibration(
    wire: Wire, loadings: Sequence[FirstLoading], plan: CalibrationPlan, tables: Sequence[str]
) -> Calibration:
    settings = Settings(
        choices=_choices(plan), gain=max(loading.gain for loading in loadings), scatter=plan.scatter
    )
    outcome = calibrate(wire, [loading.curve for loading in loadings], settings)
    if isinstance(outcome, CalibrationFailure):
        message = (
            f"the calibration of {loadings[0].curve.wire} failed ({outcome.code}): "
            f"{outcome.message}. {_REMEDY}"
        )
        if tables and outcome.code == "model_cannot_follow":
            message += (
                f" If a stress table ends too early ({', '.join(tables)}), add the missing points "
                f"to it, or a smaller up_to to the plan."
            )
        raise ProcessingError(message)
    notes = (*outcome.notes, *(note for loading in loadings for note in loading.notes))
    return replace(outcome, notes=notes)


def _shapes(loading: FirstLoading, wire: Wire) -> dict[str, tuple[BentShape, ...]]:
    """Return the shapes of the first test of the calibrated wire."""
    curve = loading.curve
    deepest = float(np.max(curve.deflection))
    shapes = bent_shapes(loading.file, wire, curve.length, curve.rig, deepest)
    return {curve.test: shapes} if shapes else {}


def _choices(plan: CalibrationPlan) -> dict[str, ParameterChoice]:
    """Return the choices of the plan; a parameter without one is free if it has an effect."""
    settings = {
        name: getattr(plan.parameters, name)
        for name in PARAMETERS
        if name in plan.parameters.model_fields_set
    }
    return {
        name: ParameterChoice(
            value=setting.value,
            is_fixed=setting.enters == "fixed",
            factor=setting.factor,
            source=setting.because,
        )
        for name, setting in settings.items()
    }


def _write(
    done: Calibrated,
    calibrated: Sequence[WireSpec],
    say: Callable[[str], None],
    *,
    figures: bool,
    png: bool,
) -> tuple[Path, ...]:
    """Write all files of a calibration together."""
    folder = done.folder
    report = CalibrationReport(done.calibration, done.groups, done.shapes, done.comparisons)
    owned = pngs_of(calibration_drawings(report), FIGURES_FOLDER) if figures else []
    with locked(folder), replacing_together(folder, owned=owned) as stage:
        say("tables and decks")
        model, workbook = stage / MODEL_FILE, stage / WORKBOOK_FILE
        model.write_text(json.dumps(as_json(done), allow_nan=False), encoding="utf-8")
        save_calibration_workbook(report, workbook)
        written = [model, workbook]
        written += write_decks([wire_table(spec) for spec in calibrated], stage)
        if figures:
            drawings = calibration_drawings(report)
            written += save_pages(drawings, stage / FIGURES_FOLDER, say=say, png=png)
        return tuple(folder / path.relative_to(stage) for path in written)


def as_json(done: Calibrated) -> dict[str, object]:
    """Return the content of ``labpipe calibrate --json``: lists and numbers in SI units.

    Parameters
    ----------
    done : the calibration
    """
    content = calibration_json(
        *(done.calibration, done.groups, done.left_out), done.tested_curvature
    )
    stated = {column: curve.as_json() for column, curve in done.stress_tables.items()}
    compared = [comparison_json(comparison) for comparison in done.comparisons]
    return content | {"comparisons": compared, "stress_tables": stated}
