"""Contents of a calibration's report: records, units, styles and sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Flags, Floats, freeze
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import Reason, Severity
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    DISPLAYED,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
    CalibratedParameter,
    Calibration,
    CurveErrors,
    ExternalCurveComparison,
    Prediction,
)
from labpipe.report.wording import SUPERSCRIPTS, Scale, write_count, write_number

DEFLECTION = Scale(1e3, "mm")
FORCE = Scale(1.0, "N")
SMALL_FORCE = Scale(1e3, "mN")
_LETTERS = {"phi": "\u03c6", "mu": "\u03bc"}
_POWER = re.compile(r"(?<=\d)e([+-])0*(\d+)")


class ParameterDisplay(NamedTuple):
    """Name, symbol and unit of a parameter in a report.

    Parameters
    ----------
    name : in words
    symbol : on an axis
    scale : display unit; empty for a ratio
    """

    name: str
    symbol: str
    scale: Scale

    @property
    def label(self) -> str:
        """Label of an axis."""
        return self.scale.label(self.symbol) if self.scale.unit else self.symbol


DISPLAYS: Mapping[str, ParameterDisplay] = {
    key: ParameterDisplay(name, symbol, Scale(*DISPLAYED[key]))
    for key, name, symbol in (
        (RADIAL_FRICTION, "friction phi", "Friction \u03c6"),
        (INSULATION_MODULUS, "modulus of the insulation", "Insulation modulus"),
        (COPPER_SCALE, "factor on the strength of the copper", "Factor on copper strength"),
    )
}
_IN_WORDS: Mapping[str, str] = {
    RADIAL_FRICTION: "phi",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
    "strand_friction": "mu_s",
    "insulation_friction": "mu_p",
    "radial_force": "F_rad",
}


def typeset(sentence: str) -> str:
    """Typeset a sentence of a calibration.

    Parameters
    ----------
    sentence : from its record

    Returns
    -------
    A sentence with a capital, unless it starts with a symbol, with typeset powers of ten, names
    of parameters and Greek letters.

    Examples
    --------
    >>> typeset("the radial_force was held at 2 N")
    'The F_rad was held at 2 N.'
    """
    for name, name_in_text in _IN_WORDS.items():
        sentence = re.sub(rf"\b{name}\b", name_in_text, sentence)
    sentence = _POWER.sub(_power, sentence.strip().rstrip("."))
    is_symbol = sentence.startswith(("phi", "mu_"))
    for name, letter in _LETTERS.items():
        sentence = re.sub(rf"\b{name}(?=\b|_)", letter, sentence)
    return f"{sentence if is_symbol else sentence[:1].upper() + sentence[1:]}."


def _power(match: re.Match[str]) -> str:
    sign = "-" if match[1] == "-" else ""
    return f" \u00d7 10{(sign + match[2]).translate(SUPERSCRIPTS)}"


def write_percent(share: float) -> str:
    """Write a share with at least two digits, such as ``1.9 %``; empty for NaN.

    Examples
    --------
    >>> percent(0.0193), percent(1.0), percent(math.nan)
    ('1.9 %', '100 %', '')
    """
    if not math.isfinite(share):
        return ""
    return f"{100.0 * share:.3g} %" if share >= 0.1 else f"{100.0 * share:.2g} %"


def write_length(length: float) -> str:
    """Write a length, such as ``85 mm``."""
    return f"{DEFLECTION.factor * length:.4g} {DEFLECTION.unit}"


@dataclass(frozen=True, slots=True, eq=False)
class ValidationGroup:
    """Samples of one wire at one length, and the prediction of the model.

    Parameters
    ----------
    wire : name
    length : free length, m
    is_calibrated : the samples were used for the calibration; else the model predicts them
    samples : first loading of each, by the name of its test
    band : mean of the samples with its 95 % bands; with one sample a mean without bands
    prediction : of the model, if any
    mean_of : number of samples whose mean lies between `lower` and `upper` of the prediction
    errors : of the model against all points of the samples; None without a prediction
    reason : why there is no prediction; else None
    doubtful_deflection : m, beyond which the prediction is doubtful, because the rim of the
        insulation leaves its linear range; infinite if it does not
    """

    wire: str
    length: float
    is_calibrated: bool
    samples: Mapping[str, SampleCurve]
    band: Band
    prediction: Prediction | None = None
    mean_of: int = 1
    errors: CurveErrors | None = None
    reason: Reason | None = None
    doubtful_deflection: float = math.inf

    @property
    def is_sure(self) -> Flags:
        """Return whether each point of the prediction is below the doubtful deflection."""
        deflection = np.zeros(0) if self.prediction is None else self.prediction.deflection
        return np.asarray(deflection <= self.doubtful_deflection)


@dataclass(frozen=True, slots=True, eq=False)
class BentShape:
    """The shape of a sample at one deflection of its tip; arrays of x and y, m.

    Parameters
    ----------
    deflection : m, of the tip
    markers : shape (markers, 2), as measured; NaN where a marker was not tracked
    fit : shape (n, 2), curve fitted to the markers; empty without a fit
    model : shape (m, 2), of the wire model; empty without one
    """

    deflection: float
    markers: Floats
    fit: Floats
    model: Floats

    def __post_init__(self) -> None:
        for name in ("markers", "fit", "model"):
            object.__setattr__(self, name, freeze(getattr(self, name), shape=(None, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """Contents of the figures and the workbook of a calibration.

    Parameters
    ----------
    calibration : of one wire
    groups : wires and lengths that it is compared with, including its own
    shapes : by sample and length, such as ``A2, 85 mm``
    comparisons : external curves, compared with tests and model
    """

    calibration: Calibration
    groups: tuple[ValidationGroup, ...] = ()
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    comparisons: tuple[ExternalCurveComparison, ...] = ()

    @property
    def predictions(self) -> dict[float, Prediction]:
        """Return the predictions for the tests that were used for the calibration, by length."""
        return {
            group.length: group.prediction
            for group in self.groups
            if group.is_calibrated and group.prediction is not None
        }


_REPEATED_CODES = frozenset({"at_bound", "not_identified", "prior_contradicts_data"})
"""Codes of notes that repeat the sentences of the parameters."""


def write_parameter(parameter: CalibratedParameter) -> tuple[str, ...]:
    """Write a parameter: its name, value, 95 % interval, unit and verdict.

    Parameters
    ----------
    parameter : an interval open on one side is ``below ...`` or ``above ...``
    """
    display = DISPLAYS[parameter.name]
    factor, is_open = display.scale.factor, parameter.is_open_below or parameter.is_open_above
    interval = next(
        (part for part in parameter.intervals if part.lower <= parameter.value <= part.upper),
        parameter.interval,
    )
    written = write_number(parameter.value, interval, factor)
    value = write_number(parameter.value, None, factor, digits=2) if is_open else written
    interval_text = " or ".join(_interval_parts(parameter, factor))
    unit = display.scale.unit or "1"
    return (
        typeset(display.name).rstrip("."),
        value.value,
        interval_text or "\u2013",
        unit,
        parameter.verdict.value,
    )


def _interval_parts(parameter: CalibratedParameter, factor: float) -> Iterator[str]:
    """Write each part of an interval with the digits that its width allows."""
    last = len(parameter.intervals) - 1
    for number, part in enumerate(parameter.intervals):
        middle = min(max(parameter.value, part.lower), part.upper)
        written = write_number(middle, part, factor)
        ends = {
            (False, False): written.interval,
            (True, False): f"below {written.upper}",
            (False, True): f"above {written.lower}",
            (True, True): "open on both sides",
        }
        is_open = (
            number == 0 and parameter.is_open_below,
            number == last and parameter.is_open_above,
        )
        yield ends[is_open]


def describe_calibration(calibration: Calibration) -> list[str]:
    """Describe the results of a calibration in sentences.

    Parameters
    ----------
    calibration : all of it

    Returns
    -------
    Sentences on each parameter, its prior, agreement with the tests, parameters that cannot be
    identified separately, and notes.
    """
    return [
        *_parameter_sentences(calibration),
        _agreement_sentence(calibration),
        _noise_sentence(calibration),
        *_separability_sentences(calibration),
        *_note_sentences(calibration),
    ]


def _parameter_sentences(calibration: Calibration) -> Iterator[str]:
    for parameter in calibration.parameters:
        yield typeset(parameter.explanation)
        if parameter.conflict is not None:
            yield typeset(parameter.conflict.message)


def _agreement_sentence(calibration: Calibration) -> str:
    rmse = SMALL_FORCE.factor * calibration.rmse
    counts = (
        write_count(calibration.n_points, "point"),
        write_count(len(calibration.curves), "curve"),
        write_count(calibration.n_samples, "sample"),
    )
    return (
        f"Model against all curves: RMSE {rmse:.3g} {SMALL_FORCE.unit}, "
        f"{write_percent(calibration.rmse_share)} of the largest force, over {' of '.join(counts)}."
    )


def _noise_sentence(calibration: Calibration) -> str:
    levels = calibration.levels
    scatter = f"The force scatters by {write_percent(levels.scatter)} between samples"
    if levels.scatter_freedom == 0.0:
        scatter = "The scatter of the samples is not known"
    return (
        f"{scatter}; the gain of the load cell is uncertain by {write_percent(levels.gain)}; "
        f"the noise is {levels.noise_factor:.2f} times the stated noise, and neighbouring points "
        f"have a correlation of {levels.correlation:.2f}."
    )


def _separability_sentences(calibration: Calibration) -> Iterator[str]:
    """Describe the separability of friction and of the parameters where some are not identified."""
    for separability in (calibration.friction_separability, calibration.separability):
        if separability is not None and not all(separability.are_identified.values()):
            yield typeset(separability.explanation)


def _note_sentences(calibration: Calibration) -> Iterator[str]:
    for note in calibration.notes:
        if note.code not in _REPEATED_CODES and note.severity is not Severity.INFO:
            yield f"Note: {typeset(note.message)}"
