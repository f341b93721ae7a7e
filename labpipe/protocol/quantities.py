"""Types of the values in YAML: quantities written with their unit, SI floats inside."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pydantic import GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

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
            raise error_of(
                expected=f"a {self._meaning}",
                found=text,
                remedy=f"Write it such as {self.of.example!r}.",
            )
        too_small = value < self.of.least or (self.of.above is not None and value <= self.of.above)
        if too_small or value > self.of.most:
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
        if self.of.above is not None:
            low = f"above {self.written(self.of.above)}"
        else:
            low = (
                f"from {self.written(self.of.least)} up"
                if math.isfinite(self.of.least)
                else "that is finite"
            )
        high = f", at most {self.written(self.of.most)}" if math.isfinite(self.of.most) else ""
        return f"{low}{high}"

    def __get_pydantic_core_schema__(self, _source: object, _handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            self.parse, serialization=core_schema.plain_serializer_function_ser_schema(self.written)
        )

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
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


@dataclass(frozen=True, slots=True)
class WholeText:
    """How YAML reads a whole number.

    Parameters
    ----------
    of : its range
    """

    of: Whole

    def parse(self, text: object) -> int:
        """Read a whole number.

        Raises
        ------
        PydanticCustomError
            If it is no whole number, or out of range.
        """
        expected = f"a whole number from {self.of.least} to {self.of.most}"
        if isinstance(text, bool) or re.fullmatch(r"[+-]?[0-9]{1,9}", str(text)) is None:
            raise error_of(expected=expected, found=text)
        if not self.of.least <= int(str(text)) <= self.of.most:
            raise error_of(expected=expected, found=text)
        return int(str(text))

    def __get_pydantic_core_schema__(self, _source: object, _handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"type": "integer", "minimum": self.of.least, "maximum": self.of.most}


_SPANS: Final = MappingProxyType(
    {
        "time": QuantityText(Quantity("s", "s", "0.1 s", above=0.0)),
        "travel": QuantityText(Quantity("m", "mm", "2 mm", above=0.0)),
        "branch": QuantityText(Quantity("1", "%", "5 %", least=1e-6, most=1.0)),
    }
)
_SPAN_WORDS = "a span such as '0.1 s', '2 mm' (of travel), '5 %' (of a branch) or '51 samples'"


def _parse_span(text: object) -> Span:
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


def _written_span(span: Span) -> str:
    if span.kind == "samples":
        return f"{span.value:.0f} samples"
    return _SPANS[span.kind].written(span.value)


class SpanText:
    """How YAML reads and writes a `Span`."""

    @classmethod
    def __get_pydantic_core_schema__(cls, _source: object, _handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            _parse_span,
            serialization=core_schema.plain_serializer_function_ser_schema(_written_span),
        )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, _schema: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {
            "type": "string",
            "pattern": rf"^\s*{_NUMBER}\s*\S.*$",
            "description": f"{_SPAN_WORDS[0].upper()}{_SPAN_WORDS[1:]}",
            "examples": ["0.1 s", "2 mm", "5 %", "51 samples"],
        }
