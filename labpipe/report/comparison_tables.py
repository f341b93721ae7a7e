"""The tables of curves from elsewhere: how far they are from tests and model, and their points."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from labpipe.records.comparison import CurveMatch, ThirdCurveComparison
from labpipe.report.calibration_look import DEFLECTION, FORCE
from labpipe.report.sheets import Sheet, Value

THIRD_CURVES, THIRD_POINTS = "third curves", "third curves, points"


def comparison_tables(comparisons: Sequence[ThirdCurveComparison]) -> list[Sheet]:
    """Make the tables of third curves.

    Parameters
    ----------
    comparisons : third curves held against tests and model

    Returns
    -------
    ``third curves``, two rows for each, and ``third curves, points``; none without any.
    """
    if not comparisons:
        return []
    heads = (
        "name", "wire", DEFLECTION.label("length"), "load", "held against", "points compared",
        "points left out", FORCE.label("RMSE"), "RMSE over the largest force (%)",
        "points inside the band (%)", "reason", "file", "from",
    )  # fmt: skip
    rows = [row for each in comparisons for row in _third_agreement(each)]
    points = [row for each in comparisons for row in _points(each)]
    across, up = DEFLECTION.label("deflection"), FORCE.label("force")
    columns = ("name", across, up, FORCE.label("mean of the tests"), FORCE.label("model"))
    return [Sheet(THIRD_CURVES, heads, rows, "B2"), Sheet(THIRD_POINTS, columns, points, "B2")]


def _third_agreement(each: ThirdCurveComparison) -> Iterator[tuple[Value, ...]]:
    curve = each.curve
    load = "normal" if curve.is_normal else "as tested"
    head = (curve.name, curve.wire, DEFLECTION.factor * curve.length, load)
    tail = (curve.file, curve.source)
    if each.tests is None:
        yield (*head, "tests", 0, *[None] * 4, "no tests of this wire and length", *tail)
    else:
        yield (*head, "tests", *_errors(each.tests), *tail)
    yield (*head, "model", *_errors(each.model), *tail)


def _errors(found: CurveMatch) -> tuple[Value, ...]:
    errors = found.errors
    if errors is None:
        return (0, found.left_out, None, None, None, found.words)
    inside = 100.0 * errors.inside if math.isfinite(errors.inside) else None
    rmse = FORCE.factor * errors.rmse
    return (errors.n, found.left_out, rmse, 100.0 * errors.rmse_share, inside, found.words)


def _points(each: ThirdCurveComparison) -> Iterator[tuple[Value, ...]]:
    curve, nothing = each.curve, [math.nan] * len(each.curve.force)
    tests = nothing if each.tests is None else each.tests.reference.tolist()
    columns = (curve.deflection.tolist(), curve.force.tolist(), tests, each.model.reference)
    for across, *forces in zip(*columns, strict=True):
        known = (FORCE.factor * float(v) if math.isfinite(v) else None for v in forces)
        yield (curve.name, DEFLECTION.factor * across, *known)
