"""Build the content of ``calibration.json``, and read from it what predictions need."""

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
from labpipe.mechanics.studies.wire_sheets import StatedCurve
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
    Separability,
    Solution,
)
from labpipe.report.calibration_summary import BentShape, ValidationGroup
from labpipe.store.summaries import replace_non_finite, select_json, to_json

SCHEMA = 2
"""Version of the file."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibration with its comparisons.

    Parameters
    ----------
    folder : folder of the results
    calibration : calibration of the wire
    groups : samples of one wire and length each, those of the calibrated wire first
    left_out : reason why a test was not used, by its file
    files : files that were written
    comparisons : external curves, compared with tests and model
    tested_curvature : 1/m, largest in the tests of the calibrated wire; NaN if unknown
    shapes : shapes of one sample of the calibrated wire and of the model, by test
    stress_tables : stress tables of the calibrated wire, by column of the sheet
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


def build_json(calibrated: Calibrated) -> dict[str, object]:
    """Return the content of ``labpipe calibrate --json``: lists and numbers in SI units.

    Parameters
    ----------
    calibrated : calibration with its comparisons; a missing number becomes None
    """
    calibration, share = calibrated.calibration, calibrated.calibration.isotropic_share
    numbers = ("widening", "levels", "n_points", "n_samples", "sse", "rmse", "rmse_share")
    curve_numbers = (
        *("test", "sample", "length", "sample_factor"),
        *("sse", "rmse", "rmse_share", "runs_p"),
    )
    return {
        "schema": SCHEMA,
        "labpipe": __version__,
        **select_json(calibration, "wire", "method", *numbers, quality="notes"),
        "parameters": [_build_parameter(parameter) for parameter in calibration.parameters],
        "solutions": [_build_solution(solution) for solution in calibration.solutions],
        "isotropic_share": share
        and {
            **select_json(share, "value", "n_tests", "is_creep"),
            **select_json(share.interval, "lower", "upper", "level"),
            "by_number": {
                name: [bounds.lower, bounds.upper] for name, bounds in share.intervals.items()
            },
        },
        "tested_curvature": replace_non_finite(calibrated.tested_curvature),
        "correlations": {"names": list(PARAMETERS), "values": to_json(calibration.correlations)},
        "separability": _build_separability(calibration.separability),
        "curves": [
            select_json(curve, *curve_numbers, lag_one="lag_one_correlation")
            for curve in calibration.curves
        ],
        "groups": [_build_group(group) for group in calibrated.groups],
        "left_out": dict(calibrated.left_out),
        "comparisons": [build_comparison_json(comparison) for comparison in calibrated.comparisons],
        "stress_tables": {
            name: curve.build_json() for name, curve in calibrated.stress_tables.items()
        },
    }


def _build_parameter(parameter: CalibratedParameter) -> dict[str, object]:
    interval, conflict = parameter.interval, parameter.conflict
    ends = [[to_json(piece.lower), to_json(piece.upper)] for piece in parameter.intervals]
    if ends and parameter.is_open_below:
        ends[0][0] = None
    if ends and parameter.is_open_above:
        ends[-1][1] = None
    names = ("name", "value", "unit", "verdict", "profiles", "source")
    fields = ("factor", "source", "size", "contradicts", "message")
    return {
        **select_json(parameter, *names, words="explanation"),
        "lower": ends[0][0] if ends else None,
        "upper": ends[-1][1] if ends else None,
        "level": interval and interval.level,
        "intervals": ends,
        "prior": conflict and select_json(conflict, *fields, value="centre", without="estimate"),
    }


def _build_solution(solution: Solution) -> dict[str, object]:
    names = ("rise", "likelihood", "rmse", "limit", "covariance", "mixture")
    values = zip(PARAMETERS, to_json(solution.values), strict=True)
    return dict(values) | select_json(solution, *names, in_95_percent_set="is_allowed")


def _build_separability(separability: Separability) -> dict[str, object]:
    names = ("names", "singular_values", "combinations")
    return select_json(separability, *names, words="explanation", identified="are_identified")


def _build_group(group: ValidationGroup) -> dict[str, object]:
    errors, prediction = group.errors, group.prediction
    curves = ("deflection", "force", "lower", "upper", "lower_mean", "upper_mean")
    return {
        **select_json(group, "wire", "length", calibrating="is_calibrated"),
        "tests": list(group.samples),
        "n": errors and errors.n,
        "sse": errors and replace_non_finite(errors.sse),
        **_build_errors(errors),
        "reasons": [] if group.reason is None else [to_json(group.reason)],
        "prediction": prediction and select_json(prediction, *curves),
    }


def _build_errors(errors: CurveErrors | None) -> dict[str, float | None]:
    names = {"rmse": "rmse", "rmse_share": "rmse_share", "inside_band": "inside"}
    return dict.fromkeys(names) if errors is None else select_json(errors, **names)


def build_comparison_json(comparison: ExternalCurveComparison) -> dict[str, object]:
    """Return a comparison as lists and SI numbers; None where there is no number.

    Parameters
    ----------
    comparison : comparison of an external curve
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
    count = 0 if match.errors is None else match.errors.n
    numbers = select_json(match, "left_out", force="reference", reason="explanation")
    return {"n": count, **numbers, **_build_errors(match.errors)}


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedFile:
    """A calibration as predictions need it.

    Parameters
    ----------
    wire : name of the wire
    solutions : solutions, the best first
    widening : factor on the spread of the parameters
    tested_curvature : 1/m, largest that the tests reached; NaN if unknown
    share : isotropic share of the hardening with its standard error; None if it is not calibrated
        or if the tests show creep
    """

    wire: str
    solutions: tuple[Solution, ...]
    widening: float
    tested_curvature: float
    share: tuple[float, float] | None = None

    def values(self, number: int = 0) -> dict[str, float]:
        """Return values of `PARAMETERS` of a solution by name; NaN where the wire has none."""
        return dict(zip(PARAMETERS, self.solutions[number].values.tolist(), strict=True))


def read_calibrated(path: Path) -> CalibratedFile:
    """Read a file of ``labpipe calibrate``.

    Parameters
    ----------
    path : path of the file

    Raises
    ------
    ProcessingError
        If the file cannot be read, or does not contain the numbers that predictions need.
    """
    try:
        return _parse_file(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        fault = error.strerror or "no file"
    except (ValueError, LookupError, TypeError) as error:
        fault = f"a file of another kind ({type(error).__name__}: {error})"
    raise ProcessingError.about(
        "mechanics.studies.no_calibration", path, "calibration", fault=fault
    )


def _parse_file(content: dict[str, Any]) -> CalibratedFile:
    solutions = tuple(_parse_solution(entry) for entry in content["solutions"])
    share, entry = None, content.get("isotropic_share")
    if entry is not None and not entry["is_creep"]:
        interval = Interval(float(entry["lower"]), float(entry["upper"]))
        share = float(entry["value"]), interval.standard_error
    if not solutions:
        message = "no solution"
        raise ValueError(message)
    return CalibratedFile(
        str(content["wire"]),
        solutions,
        float(content["widening"]),
        float(_floats(content["tested_curvature"])),
        share,
    )


def _parse_solution(entry: dict[str, Any]) -> Solution:
    mixture = {name: _floats(entry["mixture"][name]) for name in _MIXTURE}
    freedom = entry["mixture"]["freedom"]
    return Solution(
        values=_floats([entry[name] for name in PARAMETERS]),
        rise=float(entry["rise"]),
        rmse=float(entry["rmse"]),
        covariance=_floats(entry["covariance"]),
        mixture=ScatterMixture(**mixture, freedom=np.inf if freedom is None else float(freedom)),
        limit=float(entry["limit"]),
    )


_MIXTURE = ("chance", "scatter", "shift", "covariance")


def _floats(values: object) -> Floats:
    """Return numbers as an array; NaN for None."""
    return np.array(values, dtype=np.float64)
