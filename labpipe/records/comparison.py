"""External curves: force over deflection from elsewhere, compared with tests and with the model."""

from __future__ import annotations

from dataclasses import dataclass

from labpipe.records.agreement import CurveErrors, Prediction
from labpipe.records.arrays import Floats, frozen
from labpipe.records.quality import QualityNote


@dataclass(frozen=True, slots=True, eq=False)
class ThirdCurve:
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
    deflection: Floats
    force: Floats
    is_normal: bool = False
    source: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "deflection", frozen(self.deflection, shape=(None,)))
        object.__setattr__(self, "force", frozen(self.force, shape=(len(self.deflection),)))


@dataclass(frozen=True, slots=True, eq=False)
class CurveMatch:
    """An external curve beside one other curve, at its own deflections.

    Parameters
    ----------
    reference : shape (n,), N, of the other curve; NaN where that one has no force
    errors : over the points that both have, RMSE over the largest force of the other curve there,
        share of its points inside the 95 % band of the other; None without any
    left_out : number of points that were not compared
    words : which points were left out, or why none was compared; empty if all were
    """

    reference: Floats
    errors: CurveErrors | None
    left_out: int = 0
    words: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "reference", frozen(self.reference, shape=(None,)))


@dataclass(frozen=True, slots=True, eq=False)
class ThirdCurveComparison:
    """An external curve compared with the mean of the tests and with the calibrated model.

    Parameters
    ----------
    curve : from elsewhere
    tests : beside the mean of the tests of that wire and length; None where there are none
    model : beside the model
    prediction : the model as far as the curve and the tests go; None where it has none
    notes : what was not compared, and why
    """

    curve: ThirdCurve
    tests: CurveMatch | None
    model: CurveMatch
    prediction: Prediction | None
    notes: tuple[QualityNote, ...] = ()
