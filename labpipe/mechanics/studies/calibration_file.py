"""Build the content of ``calibration.json``, and read the part that predictions need."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labpipe import __version__
from labpipe.errors import ProcessingError
from labpipe.mechanics.studies.wire_sheets import StressCurve
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.wire import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CurveErrors,
    CurveMatch,
    ExternalCurveComparison,
    ScatterMixture,
    Solution,
)
from labpipe.report.calibration_report import BentShape, ValidationGroup
from labpipe.store.summaries import replace_non_finite, select_json, to_json

SCHEMA = 2
"""Version of the format of ``calibration.json``."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationStudy:
    """Calibration with its comparisons and the files that were written.

    Parameters
    ----------
    folder : folder of the results
    calibration : calibration of the wire
    groups : groups of samples of one wire and length; groups of the calibrated wire come first
    left_out : reason why a test was not used, keyed by the path of its file
    files : paths of the files that were written
    comparisons : comparisons of external curves with the tests and with the model
    tested_curvature : largest curvature in the tests of the calibrated wire, 1/m; NaN if unknown
    shapes : shapes of one sample of the calibrated wire and of the model, keyed by the name of the
        test
    stress_tables : stress tables of the calibrated wire, keyed by column of the sheet
    """

    folder: Path
    calibration: Calibration
    groups: tuple[ValidationGroup, ...]
    left_out: Mapping[str, str]
    files: tuple[Path, ...]
    comparisons: tuple[ExternalCurveComparison, ...] = ()
    tested_curvature: float = math.nan
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    stress_tables: Mapping[str, StressCurve] = field(default_factory=dict)


def build_json(study: CalibrationStudy) -> dict[str, object]:
    """Build the content of ``calibration.json``, with values in SI units.

    Parameters
    ----------
    study : calibration with its comparisons; a missing value becomes None
    """
    calibration, share = study.calibration, study.calibration.isotropic_share
    error_names = ("sse", "rmse", "rmse_share")
    names = ("widening", "levels", "n_points", "n_samples", *error_names)
    solution_names = ("rise", "likelihood", "rmse", "limit", "covariance", "mixture")
    curve_names = ("test", "sample", "length", "sample_factor", *error_names, "runs_p")
    return {
        "schema": SCHEMA,
        "labpipe": __version__,
        **select_json(calibration, "wire", "method", *names, quality="notes"),
        "parameters": [_build_parameter(parameter) for parameter in calibration.parameters],
        "solutions": [
            dict(zip(PARAMETERS, to_json(solution.values), strict=True))
            | select_json(solution, *solution_names, in_95_percent_set="is_allowed")
            for solution in calibration.solutions
        ],
        "isotropic_share": share
        and {
            **select_json(share, "value", "n_tests", "is_creep"),
            **select_json(share.interval, "lower", "upper", "level"),
            "by_number": {
                name: [bounds.lower, bounds.upper] for name, bounds in share.intervals.items()
            },
        },
        "tested_curvature": replace_non_finite(study.tested_curvature),
        "correlations": {"names": list(PARAMETERS), "values": to_json(calibration.correlations)},
        "separability": select_json(
            calibration.separability,
            *("names", "singular_values", "combinations"),
            words="explanation",
            identified="are_identified",
        ),
        "curves": [
            select_json(curve, *curve_names, lag_one="lag_one_correlation")
            for curve in calibration.curves
        ],
        "groups": [_build_group(group) for group in study.groups],
        "left_out": dict(study.left_out),
        "comparisons": [build_comparison_json(comparison) for comparison in study.comparisons],
        "stress_tables": {name: curve.build_json() for name, curve in study.stress_tables.items()},
    }


def _build_parameter(parameter: CalibratedParameter) -> dict[str, object]:
    """Build the entry of a parameter; an open end of an interval is None."""
    interval, conflict = parameter.interval, parameter.conflict
    bounds = [[to_json(item.lower), to_json(item.upper)] for item in parameter.intervals]
    if bounds and parameter.is_open_below:
        bounds[0][0] = None
    if bounds and parameter.is_open_above:
        bounds[-1][1] = None
    names = ("name", "value", "unit", "verdict", "profiles", "source")
    prior_names = ("factor", "source", "size", "contradicts", "message")
    return {
        **select_json(parameter, *names, words="explanation"),
        "lower": bounds[0][0] if bounds else None,
        "upper": bounds[-1][1] if bounds else None,
        "level": interval and interval.level,
        "intervals": bounds,
        "prior": conflict
        and select_json(conflict, *prior_names, value="centre", without="estimate"),
    }


def _build_group(group: ValidationGroup) -> dict[str, object]:
    """Build the entry of a group of samples; a missing prediction is None."""
    errors, prediction = group.errors, group.prediction
    curve_names = ("deflection", "force", "lower", "upper", "lower_mean", "upper_mean")
    return {
        **select_json(group, "wire", "length", calibrating="is_calibrated"),
        "tests": list(group.samples),
        "n": errors and errors.n,
        "sse": errors and replace_non_finite(errors.sse),
        **_build_errors(errors),
        "reasons": [] if group.reason is None else [to_json(group.reason)],
        "prediction": prediction and select_json(prediction, *curve_names),
    }


def _build_errors(errors: CurveErrors | None) -> dict[str, float | None]:
    """Build the entries of errors; each entry is None if there are no errors."""
    names = {"rmse": "rmse", "rmse_share": "rmse_share", "inside_band": "coverage"}
    return dict.fromkeys(names) if errors is None else select_json(errors, **names)


def build_comparison_json(comparison: ExternalCurveComparison) -> dict[str, object]:
    """Build the entry of the comparison of an external curve, with values in SI units.

    Parameters
    ----------
    comparison : comparison of the curve; a missing value becomes None
    """
    curve = comparison.curve
    return {
        **select_json(curve, "name", "file", "source", "wire", "length", "deflection", "force"),
        "load": "normal" if curve.is_normal else "as tested",
        "tests": comparison.tests and _build_match(comparison.tests),
        "model": _build_match(comparison.model),
        "quality": to_json(comparison.notes),
    }


def _build_match(match: CurveMatch) -> dict[str, object]:
    """Build the entry of the comparison of an external curve with another curve."""
    n_points = 0 if match.errors is None else match.errors.n
    entries = select_json(match, left_out="n_excluded", force="reference", reason="explanation")
    return {"n": n_points, **entries, **_build_errors(match.errors)}


@dataclass(frozen=True, slots=True, eq=False)
class StoredCalibration:
    """Part of a stored calibration that predictions need.

    Parameters
    ----------
    wire : name of the wire
    solutions : solutions of the calibration; the best solution is first
    widening : factor by which the standard deviations of the parameters are multiplied
    tested_curvature : largest curvature in the tests, 1/m; NaN if unknown
    share : isotropic share of the hardening and its standard error; None if it is not calibrated or
        if the tests show creep
    """

    wire: str
    solutions: tuple[Solution, ...]
    widening: float
    tested_curvature: float
    share: tuple[float, float] | None = None


def read_calibration(path: Path) -> StoredCalibration:
    """Read ``calibration.json``.

    Parameters
    ----------
    path : path of the file

    Raises
    ------
    ProcessingError
        If the file cannot be read, or it does not contain the values that predictions need.
    """
    try:
        return _parse_calibration(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        fault = error.strerror or "no file"
    except (ValueError, LookupError, TypeError) as error:
        fault = f"a file of another kind ({type(error).__name__}: {error})"
    raise ProcessingError.about(
        "mechanics.studies.no_calibration", path, "calibration", fault=fault
    )


def _parse_calibration(content: dict[str, Any]) -> StoredCalibration:
    """Parse the content of ``calibration.json``."""
    solutions = tuple(_parse_solution(entry) for entry in content["solutions"])
    share, share_entry = None, content.get("isotropic_share")
    if share_entry is not None and not share_entry["is_creep"]:
        interval = Interval(float(share_entry["lower"]), float(share_entry["upper"]))
        share = float(share_entry["value"]), interval.standard_error
    if not solutions:
        message = "no solution"
        raise ValueError(message)
    return StoredCalibration(
        wire=str(content["wire"]),
        solutions=solutions,
        widening=float(content["widening"]),
        tested_curvature=float(_make_array(content["tested_curvature"])),
        share=share,
    )


def _parse_solution(entry: dict[str, Any]) -> Solution:
    """Parse the entry of a solution."""
    mixture_arrays = ("chance", "scatter", "shift", "covariance")
    mixture = {name: _make_array(entry["mixture"][name]) for name in mixture_arrays}
    freedom = entry["mixture"]["freedom"]
    return Solution(
        values=_make_array([entry[name] for name in PARAMETERS]),
        rise=float(entry["rise"]),
        rmse=float(entry["rmse"]),
        covariance=_make_array(entry["covariance"]),
        mixture=ScatterMixture(**mixture, freedom=np.inf if freedom is None else float(freedom)),
        limit=float(entry["limit"]),
    )


def _make_array(values: object) -> Floats:
    """Make an array from values of JSON; None becomes NaN."""
    return np.array(values, dtype=np.float64)
