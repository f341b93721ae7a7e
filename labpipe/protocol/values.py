"""Values in YAML: quantities with their unit, whole numbers, spans, texts and names of files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import PurePosixPath, PureWindowsPath
from types import MappingProxyType
from typing import Annotated, Any, Final

from pydantic import (
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    WithJsonSchema,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from labpipe.protocol.yaml_text import refused
from labpipe.records.declarations import PatternText, Quantity, Span, WholeNumber
from labpipe.units import DimensionError, NotFiniteError, parse_quantity, si_factor

SI_UNITS: Final = MappingProxyType(
    {
        "angle": "rad",
        "bending_stiffness": "N*m^2",
        "compliance": "m/N",
        "curvature": "1/m",
        "deflection": "m",
        "displacement": "m",
        "energy": "J",
        "extension": "m",
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
"""The quantities of protocols and their SI units."""

NUMBER: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
"""A number with a decimal point."""
_DIMENSIONS = {si_unit: quantity for quantity, si_unit in SI_UNITS.items()} | {
    "m": "length",
    "rad": "an angle or a ratio",
    "J": "energy or moment",
}
"""Names of dimensions by SI unit."""
_NUMBER_AND_UNIT = re.compile(
    r"([-+]?\d+(?:[.,' \u2019\u00a0\u202f]\d{3}(?!\d))*(?:[.,]\d*)?)\s*+(.*)"
)
"""A number, perhaps with thousands separators or a decimal comma, and what follows it."""
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,(?!\d{3}$)\d+")
"""What cannot be thousands."""
_PURE = re.compile(rf"\s*{NUMBER}\s*(1|%|percent|ppm)?\s*")


def number_remedy(number: str, unit: str = "") -> str:
    """Describe how to write a number that has thousands separators or a decimal comma.

    Parameters
    ----------
    number : as written, without its unit
    unit : of the number

    Returns
    -------
    What to do; empty for a number that has neither.
    """
    if re.fullmatch(NUMBER, number) or not _NUMBER_AND_UNIT.fullmatch(number):
        return ""
    if _DECIMAL_COMMA.fullmatch(number):
        return f"Write it with a decimal point: {number.replace(',', '.')} {unit}".rstrip() + "."
    return "Write it with a decimal point and without thousands separators."


def unit_remedy(unit: str, si_unit: str) -> str:
    """Describe what is wrong with a unit.

    Parameters
    ----------
    unit : as written
    si_unit : of the dimension that is wanted

    Returns
    -------
    Its own dimension, or that it is unknown; empty for a unit of the dimension, and for none.
    """
    try:
        si_factor(unit or si_unit, si_unit)
    except DimensionError:
        own_unit = si_unit_like(unit)
        if (own_unit, si_unit) == ("kg", "N"):
            return f"{unit} is a unit of mass: write mass x 9.81 m/s^2 in N, or kgf for kg."
        return f"{unit} is a unit of {_DIMENSIONS[own_unit]}." if own_unit else ""
    except ValueError:
        return f"labpipe knows no unit {unit!r}."
    return ""


def quantity_remedy(text: object, si_unit: str, example: str) -> str:
    """Describe how to write a quantity that `parse_quantity` refuses.

    Parameters
    ----------
    text : as written
    si_unit : of the dimension that is wanted
    example : how a person writes one
    """
    parts = _NUMBER_AND_UNIT.fullmatch(str(text).strip())
    number, unit = parts.groups() if parts else ("", "")
    such = f"{unit_remedy(unit, si_unit)} Write it with its unit, such as {example!r}.".lstrip()
    return number_remedy(number, unit) or such


def si_unit_like(unit: str) -> str | None:
    """Find the SI unit of the dimension of a unit, such as ``mV``; None if no quantity has it."""
    return next((si for si in SI_UNITS.values() if in_si(f"1 {unit}", si) is not None), None)


def in_si(text: object, si_unit: str) -> float | None:
    """Read a value written with its unit, such as ``53 mm``; None for what is none."""
    try:
        return parse_quantity(text, si_unit)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class QuantityText:
    """How YAML reads and writes a float with its unit.

    Parameters
    ----------
    of : unit and range
    """

    of: Quantity

    def parse(self, text: object) -> float:
        """Read a value written with its unit, such as ``53 mm``, into SI.

        Raises
        ------
        FaultsError
            If the unit is missing or wrong, or the value is out of range.
        """
        unit, example = self.of.unit, self.of.example
        try:
            value = parse_quantity(text, unit)
        except NotFiniteError:
            value = math.inf
        except ValueError as error:
            remedy = quantity_remedy(text, unit, example)
            raise refused(
                "protocol.no_quantity", found=text, kind=self._meaning, remedy=remedy
            ) from error
        if unit == "1" and _PURE.fullmatch(str(text)) is None:  # an angle is no ratio
            raise refused("protocol.no_ratio", found=text, kind=self._meaning, example=example)
        above = -math.inf if self.of.above is None else self.of.above
        in_range = above < value and self.of.minimum <= value <= self.of.maximum
        if not in_range or math.isinf(value):
            kind, valid = self._meaning, self._range
            raise refused("protocol.out_of_range", found=text, kind=kind, range=valid)
        return value

    def written(self, value: float) -> str:
        """Write a value in SI with its unit so that reading it gives the same float."""
        number, unit = value / si_factor(self.of.shown, self.of.unit), self.of.shown
        if not math.isfinite(number):
            number, unit = value, self.of.unit
        return f"{number:.12g} {unit}".removesuffix(" 1")

    @property
    def _meaning(self) -> str:
        if self.of.unit == "1":
            return "pure number (also in % or ppm)"
        return f"quantity with a unit such as {self.of.shown}"

    @property
    def _range(self) -> str:
        low, high = "that is finite", ""
        if self.of.above is not None:
            low = f"above {self.written(self.of.above)}"
        elif math.isfinite(self.of.minimum):
            low = f"from {self.written(self.of.minimum)} up"
        if math.isfinite(self.of.maximum):
            high = f", at most {self.written(self.of.maximum)}"
        return f"{low}{high}"

    @property
    def schema(self) -> JsonSchemaValue:
        """JSON Schema of the text."""
        is_pure = self.of.unit == "1"
        unit = "(%|ppm)?" if is_pure else r"\S.*"
        return {
            "type": ["string", "number"] if is_pure else "string",
            "pattern": rf"^\s*{NUMBER}\s*{unit}\s*$",
            "description": f"A {self._meaning}, {self._range}",
            "examples": [self.of.example],
        }


def parse_whole(of: WholeNumber, text: object) -> int:
    """Read a whole number within a range.

    Raises
    ------
    FaultsError
        If it is no whole number, or out of range.
    """
    is_whole = not isinstance(text, bool) and re.fullmatch(r"[+-]?[0-9]{1,9}", str(text))
    if not is_whole or not of.minimum <= int(str(text)) <= of.maximum:
        raise refused("protocol.no_whole", found=text, low=of.minimum, high=of.maximum)
    return int(str(text))


_SPANS: Final = {
    "time": QuantityText(Quantity("s", "s", "0.1 s", above=0.0)),
    "travel": QuantityText(Quantity("m", "mm", "2 mm", above=0.0)),
    "branch": QuantityText(Quantity("1", "%", "5 %", minimum=1e-6, maximum=1.0)),
}


def parse_span(text: object) -> Span:
    """Read the length of the window of a filter.

    Parameters
    ----------
    text : such as ``0.1 s``, ``2 mm``, ``5 %`` or ``51 samples``

    Raises
    ------
    FaultsError
        If it is none of these, or out of range.
    """
    if isinstance(text, Span):
        return text
    words = str(text).strip()
    if count := re.fullmatch(r"([0-9]{1,9})\s*samples", words):
        if int(count[1]) < 1:
            raise refused("protocol.no_sample", found=text)
        return Span("samples", float(count[1]))
    if words.endswith("%"):
        return Span("branch", _SPANS["branch"].parse(text))
    if in_si(words, "s") is not None:
        return Span("time", _SPANS["time"].parse(text))
    if in_si(words, "m") is not None:
        return Span("travel", _SPANS["travel"].parse(text))
    raise refused("protocol.no_span", found=text, remedy=quantity_remedy(text, "s", "0.1 s"))


def written_span(span: Span) -> str:
    """Write a span so that reading it gives the same."""
    if span.kind == "samples":
        return f"{span.value:.0f} samples"
    return _SPANS[span.kind].written(span.value)


_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
"""Line ends, and characters that pages, workbooks and drawings cannot hold."""
_NAME = re.compile(r"\w[\w.+-]*")
DEVICE: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Names that Windows does not give to files."""
MAX_NAME_BYTES = 120
"""File systems allow 255, and a suffix follows."""


def _text(value: object) -> str:
    """Accept text, and numbers of other YAML readers for unquoted text such as 1."""
    if isinstance(value, bool) or not isinstance(value, str | int | float) or not str(value):
        raise refused("protocol.no_text", found=value)
    return str(value)


def has_control_characters(text: str) -> bool:
    """Check whether a text has line ends, or characters that pages and YAML cannot hold.

    Parameters
    ----------
    text : any, such as the name of a file
    """
    return _CONTROL.search(text) is not None


def _line(value: object) -> str:
    if has_control_characters(text := _text(value)):
        raise refused("protocol.no_line", found=value)
    return text


def is_name_of_a_test(text: str) -> bool:
    """Check whether a text can be the name of a test and of its folder.

    Parameters
    ----------
    text : any

    Returns
    -------
    False for paths (``../x``), and for names that some file system refuses.
    """
    fits = _NAME.fullmatch(text) is not None and len(text.encode()) <= MAX_NAME_BYTES
    return fits and DEVICE.fullmatch(text) is None and not text.endswith(".")


def _day(value: object) -> date:
    """Read a day as ISO 8601 writes it, or take a date that YAML has made of it."""
    if type(value) is date:
        return value
    try:
        return date.fromisoformat(str(value))
    except ValueError as error:
        raise refused("protocol.no_day", found=value) from error


def _file_stem(value: object) -> str:
    text = _text(value)
    if not is_name_of_a_test(text):
        raise refused("protocol.no_file_stem", found=value, most=MAX_NAME_BYTES)
    return text


def parse_word(of: PatternText, value: object) -> str:
    """Accept a text of a given form.

    Raises
    ------
    FaultsError
        If it has another form.
    """
    if re.fullmatch(of.pattern, _text(value)) is None:
        raise refused("protocol.no_such_word", found=value, meaning=of.meaning)
    return str(value)


def file_inside(folder: str, remedy: str) -> BeforeValidator:
    """Accept the name of a file in a folder or below it.

    Parameters
    ----------
    folder : in words, such as ``the folder of the test``
    remedy : what to do about a file elsewhere

    Returns
    -------
    Validator that refuses control characters, absolute paths (of POSIX or Windows, on either
    system), and paths with ``..``.
    """

    def check(value: object) -> str:
        if not isinstance(value, str) or not value.strip() or has_control_characters(value):
            raise refused("protocol.no_file_name", found=value)
        roots = PurePosixPath(value).is_absolute() or PureWindowsPath(value).anchor
        if roots or ".." in PureWindowsPath(value).parts:
            raise refused("protocol.file_elsewhere", found=value, folder=folder, remedy=remedy)
        return value

    return BeforeValidator(check)


@dataclass(frozen=True, slots=True, eq=False)
class OrShort:
    """Annotation of a value that people may also write in a shorter form.

    Parameters
    ----------
    read : turns the short form into the long one; gives back anything else as it is
    schema : JSON Schema of the short form
    """

    read: Callable[[object], object]
    schema: Mapping[str, Any]

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [dict(self.schema), handler(schema)]}


def listed(value: object) -> object:
    """Take one value for a list of one."""
    return value if isinstance(value, list | tuple) else [value]


def row_of(count: int, example: str) -> BeforeValidator:
    """Accept a list of so many quantities.

    Parameters
    ----------
    count : of the quantities
    example : how a person writes the list
    """

    def check(value: object) -> object:
        if not isinstance(value, list | tuple) or len(value) != count:
            raise refused("protocol.no_row", found=value, count=count, example=example)
        return value

    return BeforeValidator(check)


Text = Annotated[str, BeforeValidator(_text), Field(min_length=1)]
Line = Annotated[str, BeforeValidator(_line), Field(min_length=1)]
"""Text for headings, tables and drawings."""
Remark = Annotated[
    str,
    BeforeValidator(lambda value: "" if value is None else value),
    WithJsonSchema({"type": ["string", "null"]}),
]
"""Text that may be empty or left out."""
Day = Annotated[date, BeforeValidator(_day)]
FileStem = Annotated[str, BeforeValidator(_file_stem)]
