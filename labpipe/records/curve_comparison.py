"""Models and external curves compared with measured curves: agreement, predictions, errors."""

from __future__ import annotations

from dataclasses import dataclass

from labpipe.records.arrays import ArrayRecord, Vector
from labpipe.records.quality import QualityNote


@dataclass(frozen=True, slots=True, eq=False)
class CurveAgreement(ArrayRecord):
    """One measured curve against the model.

    Parameters
    ----------
    test, sample : names
    length : m
    deflection, force, model : shape (n,), m, N, N; the model without the sample's own factor
    sample_factor : of this sample on the force of the model, load cell included
    sse, rmse, rmse_share : of force - model: N^2, N, and RMSE over the largest force
    lag_one : correlation of neighbouring residuals, the sample's factor taken out
    runs_p : p-value of the runs test of the same residuals: small where their signs stay
    """

    test: str
    sample: str
    length: float
    deflection: Vector
    force: Vector
    model: Vector
    sample_factor: float
    sse: float
    rmse: float
    rmse_share: float
    lag_one: float
    runs_p: float


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(ArrayRecord):
    """A predicted loading curve, with 95 % bands; arrays of shape (n,).

    Parameters
    ----------
    deflection, force : m, N
    lower, upper : N, band of the curve of one more sample, point by point, noise included
    lower_mean, upper_mean : N, band of the curve of the mean sample, without noise
    notes : what the bands leave out
    """

    deflection: Vector
    force: Vector
    lower: Vector
    upper: Vector
    lower_mean: Vector
    upper_mean: Vector
    notes: tuple[QualityNote, ...] = ()


@dataclass(frozen=True, slots=True)
class CurveErrors:
    """A model against measured forces: a row of the source's Table 3.3.

    Parameters
    ----------
    n : points
    sse : N^2
    rmse : N
    rmse_share : RMSE over the largest measured force
    inside : share of the points inside the band; NaN without one
    """

    n: int
    sse: float
    rmse: float
    rmse_share: float
    inside: float


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurve(ArrayRecord):
    """A loading curve that is neither test nor model: finite elements, a paper, another lab.

    Parameters
    ----------
    name : as the plan calls it
    file : as the plan names it
    wire : name of the wire
    length : free length, m
    deflection : shape (n,), m, of the tip, rising
    force : shape (n,), N
    is_normal : its load stays normal to the undeformed axis; else it is pulled as the tests are
    source : where it comes from, in words
    """

    name: str
    file: str
    wire: str
    length: float
    deflection: Vector
    force: Vector
    is_normal: bool = False
    source: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CurveMatch(ArrayRecord):
    """An external curve beside one other curve, at its own deflections.

    Parameters
    ----------
    reference : shape (n,), N, of the other curve; NaN where that one has no force
    errors : over the points that both have, RMSE over the largest force of the other curve there,
        share of its points inside the 95 % band of the other; None without any
    left_out : number of points that were not compared
    words : which points were left out, or why none was compared; empty if all were
    """

    reference: Vector
    errors: CurveErrors | None
    left_out: int = 0
    words: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ExternalCurveComparison:
    """An external curve compared with the mean of the tests and with the calibrated model.

    Parameters
    ----------
    curve : from elsewhere
    tests : beside the mean of the tests of that wire and length; None where there are none
    model : beside the model
    prediction : the model as far as the curve and the tests go; None where it has none
    notes : what was not compared, and why
    """

    curve: ExternalCurve
    tests: CurveMatch | None
    model: CurveMatch
    prediction: Prediction | None
    notes: tuple[QualityNote, ...] = ()
