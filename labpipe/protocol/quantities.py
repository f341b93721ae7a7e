"""Types of the values in YAML: quantities written with their unit, SI floats inside."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pydantic.json_schema import JsonSchemaValue

from labpipe.protocol.faults import error_of
from labpipe.records.setting_types import Quantity, Span, Whole
from labpipe.units import NotFiniteError, parse_quantity, si_factor

SI_UNITS: Final = MappingProxyType(
    {
        "angle": "rad",
        "bending_stiffness": "N*m^2",
        "compliance": "m/N",
        "curvature": "1/m",
        "deflection": "m",
        "displacement": "m",
        "energy": "J",
        "force": "N",
        "frequency": "Hz",
        "length": "m",
        "mass": "kg",
        "moment": "N*m",
        "pressure": "Pa",
        "speed": "m/s",
        "stiffness": "N/m",
        "strain": "1",
        "temperature": "K",
        "time": "s",
        "travel": "m",
        "voltage": "V",
    }
)
"""The quantities that protocols speak of, and the SI unit of each."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PURE = re.compile(rf"\s*{_NUMBER}\s*(1|%|percent|ppm)?\s*")


@dataclass(frozen=True, slots=True)
class QuantityText:
    """How YAML reads and writes a float with its unit.

    Parameters
    ----------
    of : unit and range
    """

    of: Quantity

    def parse(self, text: object) -> float:
        """Read a value written with its unit into SI.

        Parameters
        ----------
        text : such as ``53 mm``

        Raises
        ------
        PydanticCustomError
            If the unit is missing or wrong, or the value is out of range.
        """
        try:
            value = parse_quantity(text, self.of.unit)
        except NotFiniteError as error:
            raise error_of(expected=f"a {self._meaning} {self._range}", found=text) from error
        except ValueError as error:
            remedy = f"Write it with its unit, such as {self.of.example!r}."
            raise error_of(expected=f"a {self._meaning}", found=text, remedy=remedy) from error
        if self.of.unit == "1" and _PURE.fullmatch(str(text)) is None:  # an angle is no ratio
            remedy = f"Write it such as {self.of.example!r}."
            raise error_of(expected=f"a {self._meaning}", found=text, remedy=remedy)
        above = -math.inf if self.of.above is None else self.of.above
        if not (above < value and self.of.least <= value <= self.of.most):
            raise error_of(expected=f"a {self._meaning} {self._range}", found=text)
        return value

    def written(self, value: float) -> str:
        """Write a value with its unit so that reading it gives the same float.

        Parameters
        ----------
        value : in SI
        """
        if math.isfinite(shown := value / si_factor(self.of.shown, self.of.unit)):
            return _with_unit(shown, self.of.shown)
        return _with_unit(value, self.of.unit)

    @property
    def _meaning(self) -> str:
        if self.of.unit == "1":
            return "pure number (also in % or ppm)"
        return f"quantity with a unit such as {self.of.shown}"

    @property
    def _range(self) -> str:
        low = "that is finite"
        if self.of.above is not None:
            low = f"above {self.written(self.of.above)}"
        elif math.isfinite(self.of.least):
            low = f"from {self.written(self.of.least)} up"
        high = f", at most {self.written(self.of.most)}" if math.isfinite(self.of.most) else ""
        return f"{low}{high}"

    @property
    def schema(self) -> JsonSchemaValue:
        """JSON Schema of the text."""
        texts: JsonSchemaValue = {
            "type": "string",
            "pattern": rf"^\s*{_NUMBER}\s*\S.*$",
            "description": f"A {self._meaning}, {self._range}",
            "examples": [self.of.example],
        }
        if self.of.unit != "1":
            return texts
        return texts | {"type": ["string", "number"], "pattern": rf"^\s*{_NUMBER}\s*(%|ppm)?\s*$"}


def _with_unit(value: float, unit: str) -> str:
    number = f"{value:.12g}"
    return number if unit == "1" else f"{number} {unit}"


def parse_whole(of: Whole, text: object) -> int:
    """Read a whole number.

    Parameters
    ----------
    of : its range
    text : such as ``3``

    Raises
    ------
    PydanticCustomError
        If it is no whole number, or out of range.
    """
    is_whole = not isinstance(text, bool) and re.fullmatch(r"[+-]?[0-9]{1,9}", str(text))
    if not is_whole or not of.least <= int(str(text)) <= of.most:
        expected = f"a whole number from {of.least} to {of.most}"
        raise error_of(expected=expected, found=text)
    return int(str(text))


_SPANS: Final = MappingProxyType(
    {
        "time": QuantityText(Quantity("s", "s", "0.1 s", above=0.0)),
        "travel": QuantityText(Quantity("m", "mm", "2 mm", above=0.0)),
        "branch": QuantityText(Quantity("1", "%", "5 %", least=1e-6, most=1.0)),
    }
)
_SPAN_WORDS = "a span such as '0.1 s', '2 mm' (of travel), '5 %' (of a branch) or '51 samples'"


def parse_span(text: object) -> Span:
    """Read the length of a stretch that a filter looks at.

    Parameters
    ----------
    text : such as ``0.1 s``, ``2 mm``, ``5 %`` or ``51 samples``

    Raises
    ------
    PydanticCustomError
        If it is none of these, or out of range.
    """
    if isinstance(text, Span):
        return text
    words = str(text)
    if count := re.fullmatch(r"\s*([0-9]{1,9})\s*samples\s*", words):
        if int(count[1]) < 1:
            raise error_of(expected="a span of at least 1 sample", found=text)
        return Span("samples", float(count[1]))
    if words.strip().endswith("%"):
        return Span("branch", _SPANS["branch"].parse(text))
    for kind in ("time", "travel"):
        try:
            parse_quantity(words, _SPANS[kind].of.unit)
        except ValueError:
            continue
        return Span("time" if kind == "time" else "travel", _SPANS[kind].parse(text))
    raise error_of(expected=_SPAN_WORDS, found=text, remedy="Write it with its unit.")


def written_span(span: Span) -> str:
    """Write a span so that reading it gives the same."""
    if span.kind == "samples":
        return f"{span.value:.0f} samples"
    return _SPANS[span.kind].written(span.value)


SPAN_SCHEMA: Final[JsonSchemaValue] = {
    "type": "string",
    "pattern": rf"^\s*{_NUMBER}\s*\S.*$",
    "description": f"{_SPAN_WORDS[0].upper()}{_SPAN_WORDS[1:]}",
    "examples": ["0.1 s", "2 mm", "5 %", "51 samples"],
}
"""JSON Schema of a span."""
