"""A third curve beside tests and model as plain numbers for other programs."""

from __future__ import annotations

import math
from dataclasses import asdict

from labpipe.records.arrays import Floats
from labpipe.records.comparison import CurveMatch, ThirdCurveComparison


def comparison_json(each: ThirdCurveComparison) -> dict[str, object]:
    """Lay out a comparison in lists and plain SI numbers; None where there is no number.

    Parameters
    ----------
    each : a third curve with what it was held against
    """
    curve = each.curve
    return {
        "name": curve.name,
        "file": curve.file,
        "source": curve.source,
        "wire": curve.wire,
        "length": curve.length,
        "load": "normal" if curve.is_normal else "as tested",
        "deflection": curve.deflection.tolist(),
        "force": curve.force.tolist(),
        "tests": None if each.tests is None else _match(each.tests),
        "model": _match(each.model),
        "quality": [asdict(note) for note in each.notes],
    }


def _match(found: CurveMatch) -> dict[str, object]:
    errors = found.errors
    return {
        "n": 0 if errors is None else errors.n,
        "left_out": found.left_out,
        "rmse": None if errors is None else _number(errors.rmse),
        "rmse_share": None if errors is None else _number(errors.rmse_share),
        "inside_band": None if errors is None else _number(errors.inside),
        "force": _numbers(found.reference),
        "reason": found.words,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Floats) -> list[float | None]:
    return [_number(value) for value in values]
