"""A calibration as plain numbers for other programs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from labpipe import __version__
from labpipe.records.agreement import CurveAgreement
from labpipe.records.arrays import Floats
from labpipe.records.calibration import (
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CalibrationFailure,
    Separability,
    SourceCalibration,
)
from labpipe.report.calibration_shown import ValidationGroup

SCHEMA = 1


def calibration_json(
    calibration: Calibration,
    groups: Sequence[ValidationGroup],
    source: SourceCalibration | CalibrationFailure | None,
    left_out: Mapping[str, str],
) -> dict[str, object]:
    """Lay out a calibration in lists and plain SI numbers; None where there is no number.

    Parameters
    ----------
    calibration : of one wire
    groups : what it was held against
    source : the source's procedure, if it was asked for
    left_out : by file, why a test was not taken
    """
    friction = calibration.friction_separability
    return {
        "schema": SCHEMA,
        "labpipe": __version__,
        "wire": calibration.wire,
        "method": calibration.method,
        "parameters": [_parameter(each) for each in calibration.parameters],
        "correlations": {
            "names": list(PARAMETERS),
            "values": [_numbers(row) for row in calibration.correlations],
        },
        "separability": _separability(calibration.separability),
        "friction_separability": None if friction is None else _separability(friction),
        "levels": {key: _number(value) for key, value in asdict(calibration.levels).items()},
        "n_points": calibration.n_points,
        "n_samples": calibration.n_samples,
        "sse": calibration.sse,
        "rmse": calibration.rmse,
        "rmse_share": calibration.rmse_share,
        "curves": [_curve(each) for each in calibration.curves],
        "groups": [_group(each) for each in groups],
        "source_method": _source(source),
        "left_out": dict(left_out),
        "quality": [asdict(note) for note in calibration.notes],
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Floats) -> list[float | None]:
    return [_number(value) for value in values]


def _parameter(each: CalibratedParameter) -> dict[str, object]:
    interval, profile = each.interval, each.profile
    return {
        "name": each.name,
        "value": _number(each.value),
        "unit": each.unit,
        "lower": None if interval is None or each.is_open_below else _number(interval.lower),
        "upper": None if interval is None or each.is_open_above else _number(interval.upper),
        "level": None if interval is None else interval.level,
        "verdict": str(each.verdict),
        "words": each.words,
        "profile": None
        if profile is None
        else {
            "value": _numbers(profile.value),
            "deviance": _numbers(profile.deviance),
            "threshold_below": _number(profile.threshold_below),
            "threshold_above": _number(profile.threshold_above),
        },
        "prior_conflict": None
        if each.conflict is None
        else {
            "size": _number(each.conflict.size),
            "contradicts": each.conflict.contradicts,
            "message": each.conflict.message,
        },
    }


def _separability(each: Separability) -> dict[str, object]:
    return {
        "names": list(each.names),
        "singular_values": _numbers(each.singular_values),
        "combinations": [_numbers(row) for row in each.combinations],
        "identified": dict(each.are_identified),
        "words": each.words,
    }


def _curve(each: CurveAgreement) -> dict[str, object]:
    names = ("sample_factor", "sse", "rmse", "rmse_share", "lag_one", "runs_p")
    return {
        "test": each.test,
        "sample": each.sample,
        "length": each.length,
        **{name: _number(getattr(each, name)) for name in names},
    }


def _group(each: ValidationGroup) -> dict[str, object]:
    errors, prediction = each.errors, each.prediction
    return {
        "wire": each.wire,
        "length": each.length,
        "calibrating": each.is_calibrated,
        "tests": list(each.samples),
        "n": None if errors is None else errors.n,
        "sse": None if errors is None else _number(errors.sse),
        "rmse": None if errors is None else _number(errors.rmse),
        "rmse_share": None if errors is None else _number(errors.rmse_share),
        "inside_band": None if errors is None else _number(errors.inside),
        "reasons": [] if each.reason is None else [asdict(each.reason)],
        "prediction": None
        if prediction is None
        else {
            name: _numbers(getattr(prediction, name))
            for name in (
                *("deflection", "force", "lower", "upper"),
                *("lower_mean", "upper_mean"),
            )
        },
    }


def _source(source: SourceCalibration | CalibrationFailure | None) -> dict[str, object] | None:
    if source is None:
        return None
    if isinstance(source, CalibrationFailure):
        return {"failed": source.code, "reason": source.message}
    names = (
        *("strand_friction", "insulation_friction", "radial_force", "radial_friction"),
        *("sse", "rmse", "rmse_share"),
    )
    return {
        **{name: _number(getattr(source, name)) for name in names},
        "start": list(source.start),
        "converged": source.converged,
        "singular_values": _numbers(source.singular_values),
    }
