"""What figures and tables of a calibration share: names and units of numbers, looks, wording."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from labpipe.records.calibration import (
    COPPER_SCALE,
    DISPLAYED,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
)
from labpipe.report.numbers import SUPERSCRIPTS
from labpipe.report.page import Look, dash_of
from labpipe.report.wording import Scale

DEFLECTION = Scale(1e3, "mm")
FORCE = Scale(1.0, "N")
SMALL_FORCE = Scale(1e3, "mN")
MODEL, BAND = "#0072B2", "#a6cbe3"
"""The model and its band; measured samples are black and grey beside it."""
SOURCE: Mapping[str, Any] = {
    "color": "#D55E00",
    "linewidth": 0.9,
    "linestyle": (0, (4, 1.4, 1, 1.4)),
}
"""What `method: source` makes of the same tests."""

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
