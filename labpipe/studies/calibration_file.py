"""Reader of the solutions in ``calibration.json``, for later predictions."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.errors import ProcessingError, error_text
from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import PARAMETERS, ScatterMixture, Solution


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedFile:
    """A calibration as predictions need it.

    Parameters
    ----------
    wire : name
    solutions : the best first
    widening : of quantiles
    tested_curvature : 1/m, largest that the tests reached
    """

    wire: str
    solutions: tuple[Solution, ...]
    widening: float
    tested_curvature: float

    def values(self, number: int = 0) -> dict[str, float]:
        """Return values of `PARAMETERS` of a solution by name; NaN where the wire has none."""
        return dict(zip(PARAMETERS, self.solutions[number].values.tolist(), strict=True))


def read_calibrated(path: Path) -> CalibratedFile:
    """Read a file of ``labpipe calibrate``.

    Parameters
    ----------
    path : calibration.json

    Raises
    ------
    ProcessingError
        If it cannot be read, or its version has not all that predictions need.
    """
    try:
        return _parse_file(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        fault = error.strerror or "no file"
    except (ValueError, LookupError, TypeError) as error:
        fault = f"something else ({type(error).__name__}: {error})"
    expected = "a calibration.json with solutions, their mixtures and the tested curvature"
    remedy = "Calibrate again with this version of labpipe: labpipe calibrate."
    message = error_text(path, "calibration", expected=expected, found=fault, remedy=remedy)
    raise ProcessingError(message)


def _parse_file(content: dict[str, Any]) -> CalibratedFile:
    solutions = tuple(_parse_solution(entry) for entry in content["solutions"])
    if not solutions:
        message = "no solution"
        raise ValueError(message)
    return CalibratedFile(
        str(content["wire"]),
        solutions,
        float(content["widening"]),
        _float(content["tested_curvature"]),
    )


def _parse_solution(entry: dict[str, Any]) -> Solution:
    mixture = entry["mixture"]
    return Solution(
        values=np.array([_float(entry[name]) for name in PARAMETERS]),
        rise=float(entry["rise"]),
        rmse=float(entry["rmse"]),
        covariance=_array(entry["covariance"]),
        mixture=ScatterMixture(
            chance=_array(mixture["chance"]),
            scatter=_array(mixture["scatter"]),
            shift=_array(mixture["shift"]),
            covariance=_array(mixture["covariance"]),
            freedom=np.inf if mixture["freedom"] is None else float(mixture["freedom"]),
        ),
        limit=float(entry["limit"]),
    )


def _float(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _array(values: object) -> Floats:
    return np.array(values, dtype=np.float64)
