"""Types of the values in YAML: quantities written with their unit, SI floats inside."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import GetJsonSchemaHandler, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from labpipe.protocol.faults import error_of
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
class Quantity:
    """Annotation of a float that YAML writes with its unit.

    Parameters
    ----------
    unit : SI unit of the float, ``1`` for a pure number
    shown : unit in which a resolved protocol writes it
    example : how a person writes it
    above : in `unit`, the value must be larger; None for no such bound
    least, most : in `unit`, smallest and largest valid value
    """

    unit: str
    shown: str
    example: str
    above: float | None = None
    least: float = -math.inf
    most: float = math.inf

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
            value = parse_quantity(text, self.unit)
        except NotFiniteError as error:
            raise error_of(expected=f"a {self._meaning} {self._range}", found=text) from error
        except ValueError as error:
            remedy = f"Write it with its unit, such as {self.example!r}."
            raise error_of(expected=f"a {self._meaning}", found=text, remedy=remedy) from error
        if self.unit == "1" and _PURE.fullmatch(str(text)) is None:  # an angle is no ratio
            raise error_of(
                expected=f"a {self._meaning}",
                found=text,
                remedy=f"Write it such as {self.example!r}.",
            )
        too_small = value < self.least or (self.above is not None and value <= self.above)
        if too_small or value > self.most:
            raise error_of(expected=f"a {self._meaning} {self._range}", found=text)
        return value

    def written(self, value: float) -> str:
        """Write a value with its unit so that reading it gives the same float.

        Parameters
        ----------
        value : in SI
        """
        if math.isfinite(shown := value / si_factor(self.shown, self.unit)):
            return _with_unit(shown, self.shown)
        return _with_unit(value, self.unit)

    @property
    def _meaning(self) -> str:
        if self.unit == "1":
            return "pure number (also in % or ppm)"
        return f"quantity with a unit such as {self.shown}"

    @property
    def _range(self) -> str:
        if self.above is not None:
            low = f"above {self.written(self.above)}"
        else:
            low = (
                f"from {self.written(self.least)} up"
                if math.isfinite(self.least)
                else "that is finite"
            )
        high = f", at most {self.written(self.most)}" if math.isfinite(self.most) else ""
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
            "examples": [self.example],
        }
        if self.unit != "1":
            return texts
        return texts | {"type": ["string", "number"], "pattern": rf"^\s*{_NUMBER}\s*(%|ppm)?\s*$"}


def _with_unit(value: float, unit: str) -> str:
    number = f"{value:.12g}"
    return number if unit == "1" else f"{number} {unit}"


Length = Annotated[float, Quantity("m", "mm", "53 mm", above=0.0)]
Offset = Annotated[float, Quantity("m", "mm", "0.8 mm")]
"""A length that may also be zero or negative."""
Distance = Annotated[float, Quantity("m", "mm", "4 mm", least=0.0)]
Area = Annotated[float, Quantity("m^2", "mm^2", "5.26 mm^2", above=0.0)]
Moment = Annotated[float, Quantity("s", "s", "1.234 s")]
"""A time that may also be zero or negative."""
Drift = Annotated[float, Quantity("1", "ppm", "40 ppm", least=-0.01, most=0.01)]
"""By how much one clock runs faster than another."""
Duration = Annotated[float, Quantity("s", "s", "0.5 s", above=0.0)]
Force = Annotated[float, Quantity("N", "N", "5 mN", least=0.0)]
Compliance = Annotated[float, Quantity("m/N", "um/N", "0.2 um/N", above=0.0)]
Mass = Annotated[float, Quantity("kg", "g", "2.7 g", least=0.0)]
Speed = Annotated[float, Quantity("m/s", "mm/s", "1 mm/s", above=0.0)]
Curvature = Annotated[float, Quantity("1/m", "1/m", "20 1/m", above=0.0)]
Frequency = Annotated[float, Quantity("Hz", "Hz", "10 Hz", above=0.0)]
Ratio = Annotated[float, Quantity("1", "%", "0.2 %", least=0.0)]
Share = Annotated[float, Quantity("1", "%", "10 %", above=0.0, most=1.0)]
"""A part of a whole."""


def behind_start(kind: Any) -> Callable[[float, ValidationInfo], float]:
    """Make the validator of a block's `stop`: the stretch that begins at `start` has a length.

    Parameters
    ----------
    kind : type of both ends, such as `Distance`

    Returns
    -------
    A function for pydantic's ``field_validator``. In YAML the ends are called ``from`` and ``to``.
    """
    written = get_args(kind)[1].written

    def checked(stop: float, info: ValidationInfo) -> float:
        start = info.data.get("start")
        if start is not None and stop <= start:
            raise error_of(expected=f"more than 'from' ({written(start)})", found=written(stop))
        return stop

    return checked


@dataclass(frozen=True, slots=True)
class Whole:
    """Annotation of a whole number within a range.

    Parameters
    ----------
    least, most : smallest and largest valid value
    """

    least: int
    most: int

    def parse(self, text: object) -> int:
        """Read a whole number.

        Raises
        ------
        PydanticCustomError
            If it is no whole number, or out of range.
        """
        expected = f"a whole number from {self.least} to {self.most}"
        if isinstance(text, bool) or re.fullmatch(r"[+-]?[0-9]{1,9}", str(text)) is None:
            raise error_of(expected=expected, found=text)
        if not self.least <= int(str(text)) <= self.most:
            raise error_of(expected=expected, found=text)
        return int(str(text))

    def __get_pydantic_core_schema__(self, _source: object, _handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"type": "integer", "minimum": self.least, "maximum": self.most}


@dataclass(frozen=True, slots=True)
class Span:
    """Length of a stretch of a channel that a filter looks at.

    Parameters
    ----------
    kind : what the length is measured in
    value : s for ``time``, m for ``travel``, a ratio for ``branch``, a count for ``samples``
    """

    kind: Literal["time", "travel", "branch", "samples"]
    value: float


_SPANS: Final = MappingProxyType(
    {
        "time": Quantity("s", "s", "0.1 s", above=0.0),
        "travel": Quantity("m", "mm", "2 mm", above=0.0),
        "branch": Quantity("1", "%", "5 %", least=1e-6, most=1.0),
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
            parse_quantity(words, _SPANS[kind].unit)
        except ValueError:
            continue
        return Span("time" if kind == "time" else "travel", _SPANS[kind].parse(text))
    raise error_of(expected=_SPAN_WORDS, found=text, remedy="Write it with its unit.")


def _written_span(span: Span) -> str:
    if span.kind == "samples":
        return f"{span.value:.0f} samples"
    return _SPANS[span.kind].written(span.value)


class SpanText:
    """Annotation that reads and writes a `Span`."""

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


SpanOf = Annotated[Span, SpanText]
