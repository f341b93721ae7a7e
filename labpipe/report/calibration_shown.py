"""What the report of a calibration shows beside the calibration: other wires, lengths, shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from labpipe.records.agreement import CurveErrors, Prediction
from labpipe.records.arrays import Floats, frozen
from labpipe.records.calibration import Calibration, SourceCalibration
from labpipe.records.comparison import ThirdCurveComparison
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import Reason


@dataclass(frozen=True, slots=True, eq=False)
class ValidationGroup:
    """Samples of one wire at one length, and what the model says of them.

    Parameters
    ----------
    wire : name
    length : free length, m
    is_calibrated : the calibration rests on these samples; else the model foretells them
    samples : first loading of each, by the name of its test
    band : mean of the samples with its 95 % bands; with one sample a mean without bands
    prediction : of the model; None where it has none
    foretold : number of samples of which `lower` and `upper` of the prediction foretell the mean
    errors : of the model against all points of the samples; None without a prediction
    reason : why there is no prediction; else None
    """

    wire: str
    length: float
    is_calibrated: bool
    samples: Mapping[str, SampleCurve]
    band: Band
    prediction: Prediction | None = None
    foretold: int = 1
    errors: CurveErrors | None = None
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BentShape:
    """The shape of a sample at one deflection of its tip; arrays of x and y, m.

    Parameters
    ----------
    deflection : m, of the tip
    markers : shape (markers, 2), as measured; NaN where one was not seen
    fit : shape (n, 2), curve fitted to the markers; empty where none was
    model : shape (m, 2), as the wire model has it; empty where it has none
    """

    deflection: float
    markers: Floats
    fit: Floats
    model: Floats

    def __post_init__(self) -> None:
        for name in ("markers", "fit", "model"):
            object.__setattr__(self, name, frozen(getattr(self, name), shape=(None, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """All that the figures and the workbook of a calibration show.

    Parameters
    ----------
    calibration : of one wire
    groups : wires and lengths that it is compared with, its own among them
    shapes : by what they are of, such as ``A2, 85 mm``
    source : what `method: source` makes of the same tests; None where it was not run
    comparisons : curves from elsewhere, held against tests and model
    """

    calibration: Calibration
    groups: tuple[ValidationGroup, ...] = ()
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    source: SourceCalibration | None = None
    comparisons: tuple[ThirdCurveComparison, ...] = ()

    @property
    def predictions(self) -> dict[float, Prediction]:
        """What the model says of the tests that it was calibrated by, by length."""
        return {
            group.length: group.prediction
            for group in self.groups
            if group.is_calibrated and group.prediction is not None
        }
