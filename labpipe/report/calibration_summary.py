"""What the report of a calibration shows: its records, units, looks and sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Flags, Floats, frozen
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
    Separability,
)
from labpipe.report.figure_page import Look, dash_of
from labpipe.report.wording import SUPERSCRIPTS, Scale, count_of, write_number

DEFLECTION = Scale(1e3, "mm")
FORCE = Scale(1.0, "N")
SMALL_FORCE = Scale(1e3, "mN")
MODEL, BAND = "#0072B2", "#a6cbe3"
"""The model and its band; measured samples are black and grey beside it."""

_COLOURS = ("#555555", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#D55E00")
_LETTERS = {"phi": "\u03c6", "mu": "\u03bc"}
_POWER = re.compile(r"(?<=\d)e([+-])0*(\d+)")


class Shown(NamedTuple):
    """How a parameter is shown.

    Parameters
    ----------
    words : its name
    symbol : on an axis
    scale : its display unit; an empty one for a ratio
    """

    words: str
    symbol: str
    scale: Scale

    @property
    def label(self) -> str:
        """Words for an axis."""
        return self.scale.label(self.symbol) if self.scale.unit else self.symbol


SHOWN: Mapping[str, Shown] = {
    name: Shown(words, symbol, Scale(*DISPLAYED[name]))
    for name, words, symbol in (
        (RADIAL_FRICTION, "friction phi", "Friction \u03c6"),
        (INSULATION_MODULUS, "modulus of the insulation", "Insulation modulus"),
        (COPPER_SCALE, "strength of the copper, factor", "Factor on copper's strength"),
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
    """Make a sentence of a calibration fit for print.

    Parameters
    ----------
    sentence : from its record

    Returns
    -------
    A whole sentence: a capital first, unless a symbol is first, powers of ten written as such,
    parameters in words, and Greek letters.

    Examples
    --------
    >>> typeset("the radial_force was held at 2 N")
    'The F_rad was held at 2 N.'
    """
    for name, words in _IN_WORDS.items():
        sentence = re.sub(rf"\b{name}\b", words, sentence)
    sentence = _POWER.sub(_power, sentence.strip().rstrip("."))
    is_symbol = sentence.startswith(("phi", "mu_"))
    for name, letter in _LETTERS.items():
        sentence = re.sub(rf"\b{name}(?=\b|_)", letter, sentence)
    return f"{sentence if is_symbol else sentence[:1].upper() + sentence[1:]}."


def _power(found: re.Match[str]) -> str:
    sign = "-" if found[1] == "-" else ""
    return f" \u00d7 10{(sign + found[2]).translate(SUPERSCRIPTS)}"


def percent(share: float) -> str:
    """A share to two digits or more, such as ``1.9 %``; empty where there is none.

    Examples
    --------
    >>> percent(0.0193), percent(1.0), percent(math.nan)
    ('1.9 %', '100 %', '')
    """
    if not math.isfinite(share):
        return ""
    return f"{100.0 * share:.3g} %" if share >= 0.1 else f"{100.0 * share:.2g} %"


def length_words(length: float) -> str:
    """A length, such as ``85 mm``."""
    return f"{DEFLECTION.factor * length:.4g} {DEFLECTION.unit}"


def length_looks(lengths: Sequence[float]) -> dict[float, Look]:
    """Give the samples of each length a colour and a dash, to be told apart in grey too.

    Parameters
    ----------
    lengths : m, in any order, with repetitions
    """
    return {
        length: Look(_COLOURS[number % len(_COLOURS)], dash_of(number))
        for number, length in enumerate(sorted(set(lengths)))
    }


@dataclass(frozen=True, slots=True, eq=False)
class ValidationGroup:
    """Samples of one wire at one length, and what the model says of them.

    Parameters
    ----------
    wire : name
    length : free length, m
    is_calibrated : the calibration rests on these samples; else the model predicts them
    samples : first loading of each, by the name of its test
    band : mean of the samples with its 95 % bands; with one sample a mean without bands
    prediction : of the model; None where it has none
    mean_of : number of samples whose mean lies between `lower` and `upper` of the prediction
    errors : of the model against all points of the samples; None without a prediction
    reason : why there is no prediction; else None
    doubtful_deflection : m, from which on the prediction is doubtful, as the rim of the insulation
        leaves the range of its straight line; infinite where it does not
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
        """Whether each point of the prediction is none of the doubtful ones; empty without one."""
        deflection = np.zeros(0) if self.prediction is None else self.prediction.deflection
        return np.asarray(deflection <= self.doubtful_deflection)


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
    comparisons : curves from elsewhere, compared with tests and model
    """

    calibration: Calibration
    groups: tuple[ValidationGroup, ...] = ()
    shapes: Mapping[str, tuple[BentShape, ...]] = field(default_factory=dict)
    comparisons: tuple[ExternalCurveComparison, ...] = ()

    @property
    def predictions(self) -> dict[float, Prediction]:
        """What the model says of the tests that it was calibrated by, by length."""
        return {
            group.length: group.prediction
            for group in self.groups
            if group.is_calibrated and group.prediction is not None
        }


HEADS = ("parameter", "value", "95 % interval", "unit", "verdict")
_DIGITS = 2
"""Of a value whose interval is open."""
_TOLD = frozenset({"at_bound", "not_identified", "prior_contradicts_data"})
"""Codes of notes that repeat what the sentences of the parameters say."""


def parameter_row(parameter: CalibratedParameter) -> tuple[str, ...]:
    """Write a parameter as the line of a table, under `HEADS`.

    Parameters
    ----------
    parameter : an interval that is open on a side is ``below ...`` or ``above ...``
    """
    shown = SHOWN[parameter.name]
    factor, is_open = shown.scale.factor, parameter.is_open_below or parameter.is_open_above
    own = next(
        (part for part in parameter.intervals if part.lower <= parameter.value <= part.upper),
        parameter.interval,
    )
    written = write_number(parameter.value, own, factor)
    value = write_number(parameter.value, None, factor, digits=_DIGITS) if is_open else written
    between = " or ".join(_parts(parameter, factor))
    unit = shown.scale.unit or "1"
    return (
        typeset(shown.words).rstrip("."),
        value.value,
        between or "\u2013",
        unit,
        parameter.verdict.value,
    )


def _parts(parameter: CalibratedParameter, factor: float) -> Iterator[str]:
    """Each part of an interval with the digits that its own width allows."""
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


def sentences(calibration: Calibration) -> list[str]:
    """Say what a calibration found, and what it does not know.

    Parameters
    ----------
    calibration : all of it

    Returns
    -------
    Sentences on: each parameter, its prior, agreement with the tests, what cannot be told apart,
    notes.
    """
    return [
        *_parameters(calibration),
        _agreement(calibration),
        _levels(calibration),
        *_separabilities(calibration),
        *_notes(calibration),
    ]


def _parameters(calibration: Calibration) -> Iterator[str]:
    for parameter in calibration.parameters:
        yield typeset(parameter.words)
        if parameter.conflict is not None:
            yield typeset(parameter.conflict.message)


def _agreement(calibration: Calibration) -> str:
    rmse = SMALL_FORCE.factor * calibration.rmse
    counts = (
        count_of(calibration.n_points, "point"),
        count_of(len(calibration.curves), "curve"),
        count_of(calibration.n_samples, "sample"),
    )
    return (
        f"Model against all curves: RMSE {rmse:.3g} {SMALL_FORCE.unit}, "
        f"{percent(calibration.rmse_share)} of the largest force, over {' of '.join(counts)}."
    )


def _levels(calibration: Calibration) -> str:
    levels = calibration.levels
    scatter = f"Samples scatter by {percent(levels.scatter)} in force"
    if levels.scatter_freedom == 0.0:
        scatter = "How samples scatter is not known"
    return (
        f"{scatter}; the gain of the load cell is uncertain by {percent(levels.gain)}; "
        f"the noise is {levels.noise_factor:.2f} times as much as stated, and neighbouring points "
        f"are correlated by {levels.correlation:.2f}."
    )


def _separabilities(calibration: Calibration) -> Iterator[str]:
    """Of friction always; of the parameters where they are not all told apart."""
    for each in (calibration.friction_separability, calibration.separability):
        if each is not None and _is_worth_saying(each):
            yield typeset(each.words)


def _is_worth_saying(separability: Separability) -> bool:
    return not all(separability.are_identified.values())


def _notes(calibration: Calibration) -> Iterator[str]:
    for note in calibration.notes:
        if note.code not in _TOLD and note.severity is not Severity.INFO:
            yield f"Note: {typeset(note.message)}"
