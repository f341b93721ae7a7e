"""Grammar of YAML files: quantities with units, whole numbers, texts, and blocks of keys.

The fields of a `Block`, and of a plain frozen dataclass such as a step, are declared with the
markers of `labpipe.records.declarations`. This module alone converts these markers into pydantic's
validators, serializers and JSON schemas.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from datetime import date
from functools import cache, partial
from importlib.resources import files
from pathlib import PurePosixPath, PureWindowsPath
from types import MappingProxyType, UnionType
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    Self,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PlainSerializer,
    PlainValidator,
    SerializationInfo,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    create_model,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.yaml_text import (
    FaultsError,
    Values,
    build_choice_fault,
    build_refusal,
    convert_errors,
    parse_yaml,
    prefix_paths,
)
from labpipe.records.declarations import (
    Key,
    LargerThan,
    PatternText,
    Quantity,
    ShippedCard,
    Span,
    TaggedChoice,
    WholeNumber,
)
from labpipe.units import DimensionError, NotFiniteError, get_conversion_factor, parse_quantity

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
"""SI unit of each quantity that a protocol can name."""


@dataclass(frozen=True, slots=True)
class OneOf:
    """Annotation of a text that is one of the given words.

    Parameters
    ----------
    words : the valid words
    """

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(self, _source: object, _handler: object) -> CoreSchema:
        return core_schema.literal_schema([*self.words])


QuantityName = Annotated[str, OneOf(tuple(SI_UNITS))]
"""Name of a quantity."""

NUMBER_PATTERN: Final = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
"""Pattern of a number, which may have a decimal point and an exponent."""
_DIMENSION_NAMES = {si_unit: quantity for quantity, si_unit in SI_UNITS.items()} | {
    "m": "length",
    "rad": "an angle or a ratio",
    "J": "energy or moment",
}
"""Name of each dimension in messages, keyed by SI unit."""
_NUMBER_AND_UNIT = re.compile(
    r"([-+]?(?:\d+(?:[.,' \u2019\u00a0\u202f]\d{3}(?!\d))*(?:[.,]\d*+)?+|\.\d+)(?:[eE][-+]?\d+)?)"
    r"\s*+(?![.,'\u2019])(.*)"
)
"""A number, which may have thousands separators or a decimal comma, and the text after it."""
_DECIMAL_COMMA = re.compile(r"[-+]?(?:0,\d+|\d+,(?!\d{3}$)\d+)(?:[eE][-+]?\d+)?")
"""A number whose comma cannot separate thousands."""
_RATIO_TEXT = re.compile(rf"\s*{NUMBER_PATTERN}\s*(1|%|percent|ppm)?\s*")
"""A pure number, which may be in % or ppm."""


def suggest_number(number: str, unit: str = "") -> str:
    """Suggest how to write a number that has thousands separators or a decimal comma.

    Parameters
    ----------
    number : number as written, without its unit
    unit : unit of the number; may be empty

    Returns
    -------
    The remedy; empty if `number` needs no change, or is no number.
    """
    match = _NUMBER_AND_UNIT.fullmatch(number)
    if re.fullmatch(NUMBER_PATTERN, number) or not match or match[2]:
        return ""
    if _DECIMAL_COMMA.fullmatch(number):
        return f"Write it with a decimal point: {number.replace(',', '.')} {unit}".rstrip() + "."
    return "Write it with a decimal point and without thousands separators."


def explain_unit(unit: str, si_unit: str) -> str:
    """Explain why a unit does not fit a dimension.

    Parameters
    ----------
    unit : unit as written; may be empty
    si_unit : SI unit of the expected dimension

    Returns
    -------
    A sentence that names the dimension of the unit, or says that the unit is unknown. Empty if the
    unit fits, if there is none, or if no quantity of `SI_UNITS` has its dimension.
    """
    try:
        get_conversion_factor(unit or si_unit, si_unit)
    except DimensionError:
        actual_si_unit = find_si_unit(unit)
        if (actual_si_unit, si_unit) == ("kg", "N"):
            return f"{unit} is a unit of mass: write mass x 9.81 m/s^2 in N, or kgf for kg."
        return f"{unit} is a unit of {_DIMENSION_NAMES[actual_si_unit]}." if actual_si_unit else ""
    except ValueError:
        return f"labpipe knows no unit {unit!r}."
    return ""


def find_si_unit(unit: str) -> str | None:
    """Find the SI unit for a unit such as ``mV``; None if no quantity of `SI_UNITS` fits."""
    units = SI_UNITS.values()
    return next((si for si in units if try_parse_quantity(f"1 {unit}", si) is not None), None)


def try_parse_quantity(text: object, si_unit: str) -> float | None:
    """Parse a value with its unit, such as ``53 mm``, into SI.

    Parameters
    ----------
    text : quantity as written
    si_unit : SI unit of the expected dimension

    Returns
    -------
    The value, infinite if it is too large for a float; None if the text is no such quantity.
    """
    if si_unit == "1" and _RATIO_TEXT.fullmatch(str(text)) is None:  # pint converts deg to a ratio
        return None
    try:
        return parse_quantity(text, si_unit)
    except NotFiniteError:
        return math.inf
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class QuantityText:
    """Parser and formatter of a float that a YAML file states with its unit.

    Parameters
    ----------
    quantity : units, example and valid range of the float
    """

    quantity: Quantity

    def parse(self, text: object) -> float:
        """Parse a value with its unit, such as ``53 mm``, into SI.

        Parameters
        ----------
        text : quantity as written

        Raises
        ------
        FaultsError
            If the text is no quantity of this dimension, or the value is out of range or not
            finite.
        """
        value = try_parse_quantity(text, self.quantity.unit)
        if value is None:
            remedy = self._suggest(text)
            raise build_refusal("protocol.no_quantity", found=text, kind=self._kind, remedy=remedy)
        is_above_bound = self.quantity.lower_bound is None or value > self.quantity.lower_bound
        is_in_range = is_above_bound and self.quantity.minimum <= value <= self.quantity.maximum
        if not is_in_range or math.isinf(value):
            kind, range_text = self._kind, self._range_text
            raise build_refusal("protocol.out_of_range", found=text, kind=kind, range=range_text)
        return value

    def _suggest(self, text: object) -> str:
        """Suggest how to write a text that is no quantity of this dimension."""
        match = _NUMBER_AND_UNIT.fullmatch(str(text).strip())
        number, unit = match.groups() if match else ("", "")
        remedy = suggest_number(number, unit)
        if remedy and try_parse_quantity(f"1 {unit}", self.quantity.unit) is not None:
            return remedy
        separator = "a decimal point, and with " if remedy else ""
        how = "like" if self.quantity.unit == "1" else f"with {separator}its unit, such as"
        explanation = explain_unit(unit, self.quantity.unit)
        return f"{explanation} Write it {how} {self.quantity.example!r}.".lstrip()

    def format(self, value: float) -> str:
        """Format an SI value to 12 digits in the display unit, or in SI if that overflows."""
        unit = self.quantity.display_unit
        number = value / get_conversion_factor(unit, self.quantity.unit)
        if not math.isfinite(number):
            number, unit = value, self.quantity.unit
        return f"{number:.12g} {unit}".removesuffix(" 1")

    @property
    def _kind(self) -> str:
        """Return a phrase for the kind of quantity, for messages."""
        if self.quantity.unit == "1":
            return "pure number (also in % or ppm)"
        return f"quantity with a unit such as {self.quantity.display_unit}"

    @property
    def _range_text(self) -> str:
        """Return a phrase for the valid range, for messages."""
        quantity, lower_text, upper_text = self.quantity, "that is finite", ""
        if quantity.lower_bound is not None:
            lower_text = f"above {self.format(quantity.lower_bound)}"
        elif math.isfinite(quantity.minimum):
            lower_text = f"from {self.format(quantity.minimum)} up"
        if math.isfinite(quantity.maximum):
            upper_text = f", at most {self.format(quantity.maximum)}"
        return f"{lower_text}{upper_text}"

    @property
    def schema(self) -> JsonSchemaValue:
        """Return the JSON schema of the text in YAML."""
        is_ratio = self.quantity.unit == "1"
        unit_pattern = "(%|ppm)?" if is_ratio else r"\S.*"
        return {
            "type": ["string", "number"] if is_ratio else "string",
            "pattern": rf"^\s*{NUMBER_PATTERN}\s*{unit_pattern}\s*$",
            "description": f"A {self._kind}, {self._range_text}",
            "examples": [self.quantity.example],
        }


def parse_whole_number(bounds: WholeNumber, text: object) -> int:
    """Parse a whole number within bounds.

    Parameters
    ----------
    bounds : smallest and largest valid number
    text : number as written

    Raises
    ------
    FaultsError
        If the text is no whole number of at most nine digits, or the number is out of range.
    """
    is_whole = not isinstance(text, bool) and re.fullmatch(r"[+-]?[0-9]{1,9}", str(text))
    if not is_whole or not bounds.minimum <= int(str(text)) <= bounds.maximum:
        raise build_refusal(
            "protocol.no_whole", found=text, low=bounds.minimum, high=bounds.maximum
        )
    return int(str(text))


_SPAN_TEXTS: Final[Mapping[Any, QuantityText]] = {
    "time": QuantityText(Quantity("s", "s", "0.1 s", lower_bound=0.0)),
    "travel": QuantityText(Quantity("m", "mm", "2 mm", lower_bound=0.0)),
    "branch": QuantityText(Quantity("1", "%", "5 %", minimum=1e-6, maximum=1.0)),
}
"""Parser and formatter of a filter's window, keyed by kind of `Span`; ``samples`` has no unit."""


def _parse_span(text: object) -> Span:
    """Parse the length of a filter's window: ``0.1 s``, ``2 mm``, ``5 %`` or ``51 samples``."""
    if isinstance(text, Span):
        return text
    match = _NUMBER_AND_UNIT.fullmatch(str(text).strip())
    number, unit = match.groups() if match else ("", "")
    if unit == "samples" and re.fullmatch(r"[0-9]{1,9}", number):
        if int(number) < 1:
            raise build_refusal("protocol.no_sample", found=text)
        return Span("samples", float(number))
    si_unit = "1" if unit == "%" else find_si_unit(unit)
    for kind, quantity_text in _SPAN_TEXTS.items():
        if si_unit == quantity_text.quantity.unit and unit:
            return Span(kind, quantity_text.parse(text))
    remedy = explain_unit(unit, "s") if si_unit else ""
    raise build_refusal("protocol.no_span", found=text, remedy=remedy)


def format_span(span: Span) -> str:
    """Format the length of a filter's window for YAML."""
    quantity_text = _SPAN_TEXTS.get(span.kind)
    return quantity_text.format(span.value) if quantity_text else f"{span.value:.0f} samples"


_CONTROL_CHARACTER = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
"""A control character (such as a line end or a tab), a surrogate, U+FFFE or U+FFFF."""
_TEST_NAME = re.compile(r"\w[\w.+-]*")
"""Name of a test that all file systems accept, except for its length and device names."""
WINDOWS_DEVICE_NAME: Final = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Pattern of the file names that Windows reserves for devices, with any suffix."""
MAX_NAME_BYTES = 120
"""Largest length of a test's name, byte: file systems allow 255, and labpipe appends suffixes."""


def _parse_text(value: object) -> str:
    """Parse text; accept numbers, because other YAML readers convert an unquoted 1."""
    if isinstance(value, bool) or not isinstance(value, str | int | float) or not str(value):
        raise build_refusal("protocol.no_text", found=value)
    return str(value)


def has_control_characters(text: str) -> bool:
    """Return whether a text has control characters, such as line ends, or invalid code points."""
    return _CONTROL_CHARACTER.search(text) is not None


def _parse_line(value: object) -> str:
    text = _parse_text(value)
    if has_control_characters(text):
        raise build_refusal("protocol.no_line", found=value)
    return text


def is_test_name(text: str) -> bool:
    """Return whether a text can name a test and its folder.

    Paths such as ``../x``, and names that a file system could refuse, are not valid.
    """
    is_plain = _TEST_NAME.fullmatch(text) is not None and len(text.encode()) <= MAX_NAME_BYTES
    return is_plain and WINDOWS_DEVICE_NAME.fullmatch(text) is None and not text.endswith(".")


def _parse_day(value: object) -> date:
    """Parse an ISO 8601 date; accept a date that another YAML reader has parsed."""
    if type(value) is date:
        return value
    try:
        return date.fromisoformat(str(value))
    except ValueError as error:
        raise build_refusal("protocol.no_day", found=value) from error


def _parse_file_stem(value: object) -> str:
    text = _parse_text(value)
    if not is_test_name(text):
        raise build_refusal("protocol.no_file_stem", found=value, limit=MAX_NAME_BYTES)
    return text


def _parse_pattern_text(pattern_text: PatternText, value: object) -> str:
    """Parse a text that must match a pattern."""
    if re.fullmatch(pattern_text.pattern, _parse_text(value)) is None:
        raise build_refusal("protocol.no_such_word", found=value, meaning=pattern_text.meaning)
    return str(value)


def build_path_validator(folder: str, noun: str) -> BeforeValidator:
    """Build the validator of a file name in a folder or below it.

    Parameters
    ----------
    folder : name of the folder in messages, such as ``the folder of the test``
    noun : kind of file, such as ``export``

    Returns
    -------
    Validator that refuses empty names, control characters, absolute paths (of POSIX and of Windows,
    on both systems), and paths with ``..``.
    """

    def check_path(value: object) -> str:
        if not isinstance(value, str) or not value.strip() or has_control_characters(value):
            raise build_refusal("protocol.no_file_name", found=value)
        is_absolute = PurePosixPath(value).is_absolute() or PureWindowsPath(value).anchor
        if is_absolute or ".." in PureWindowsPath(value).parts:
            raise build_refusal("protocol.file_elsewhere", found=value, folder=folder, noun=noun)
        return value

    return BeforeValidator(check_path)


def wrap_in_list(value: object) -> object:
    """Wrap a single value in a list; a list or tuple is returned unchanged."""
    return value if isinstance(value, list | tuple) else [value]


def build_count_validator(count: int, example: str) -> BeforeValidator:
    """Build the validator of the number of quantities in a list.

    Parameters
    ----------
    count : number of quantities
    example : a correct list, for messages
    """

    def check_count(value: object) -> object:
        if not isinstance(value, list | tuple) or len(value) != count:
            raise build_refusal("protocol.no_row", found=value, count=count, example=example)
        return value

    return BeforeValidator(check_count)


Text = Annotated[str, BeforeValidator(_parse_text), Field(min_length=1)]
"""Text that is not empty."""
SingleLine = Annotated[str, BeforeValidator(_parse_line), Field(min_length=1)]
"""Text of one line that is not empty, for headings, tables and figures."""
Remark = Annotated[
    str,
    BeforeValidator(lambda value: "" if value is None else value),
    WithJsonSchema({"type": ["string", "null"]}),
]
"""Text that may be empty or null."""
Day = Annotated[date, BeforeValidator(_parse_day)]
"""Date in ISO 8601."""
FileStem = Annotated[str, BeforeValidator(_parse_file_stem)]
"""Name of a file without its suffix, see `is_test_name`."""


class Block(BaseModel):
    """Frozen model of a YAML block, which refuses unknown keys and reports faults in sentences.

    A block may have the method ``find_key_faults``, which finds contradictions between keys even if
    values have faults, and the method ``find_value_faults``, which finds contradictions between
    values and is called only if all values are valid. The methods return faults with their paths in
    the block.
    """

    # Pydantic builds the validator of a model when it is first used, because most commands use few
    # models. Default blocks are made by `model_construct`, which does not build a validator.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    def __init_subclass__(cls, **options: Any) -> None:
        """Replace the markers of the fields before pydantic reads their types."""
        super().__init_subclass__(**options)
        hints = inspect.get_annotations(cls, eval_str=True)
        cls.__annotations__ = {name: build_pydantic_type(hint) for name, hint in hints.items()}

    @classmethod
    def list_keys(cls) -> list[str]:
        """List the keys of the block as written in YAML."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def read(cls, data: object) -> tuple[Self | None, list[Fault]]:
        """Validate plain values, and check the valid ones even if others have faults.

        Parameters
        ----------
        data : the content of the YAML block

        Returns
        -------
        The block and all faults. With faults, the block is a draft: an invalid mapping keeps its
        valid entries, see `_validate_draft`. In place of any other invalid value, the draft has the
        default of its key if this is a block or a mapping, a list of one None if it is a list, and
        None otherwise, also for blocks of several kinds. The block is None if the content is no
        block.
        """
        faults: list[Fault] = []
        try:
            block = cls.model_validate(data)
        except ValidationError as error:
            faults = convert_errors(error, data)
            if not isinstance(data, Mapping):
                return None, faults
            block = cls.model_validate(data, context=_DRAFT)
        invalid_paths = {(*x.path, x.missing) if x.missing else x.path for x in faults}
        contradictions: list[Fault] = []
        for path, value in reversed([*list_blocks(block)]):  # inner blocks before outer ones
            fault_paths = invalid_paths.union(fault.path for fault in contradictions)
            if hasattr(value, "find_key_faults"):
                contradictions += prefix_paths(path, value.find_key_faults())
            is_valid = not any(fault_path[: len(path)] == path for fault_path in fault_paths)
            if is_valid and hasattr(value, "find_value_faults"):
                contradictions += prefix_paths(path, value.find_value_faults())
        # If a key must not be there, a fault of its value is omitted.
        refused_keys = {fault.path for fault in contradictions if fault.is_key}
        faults = [fault for fault in faults if fault.path not in refused_keys]
        invalid_paths -= refused_keys
        return block, faults + [x for x in contradictions if x.path not in invalid_paths]

    @model_validator(mode="wrap")
    @classmethod
    def _convert_errors(
        cls, data: object, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo
    ) -> Self:
        """Raise faults in place of pydantic's errors, or build a draft."""
        try:
            return handler(data)
        except ValidationError as error:
            if info.context is _DRAFT and isinstance(data, Mapping):
                return _build_draft(cls, data)
            raise FaultsError(*convert_errors(error, data, cls.list_keys())) from error

    @model_serializer(mode="wrap")
    def _omit_unset_keys(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit keys with the value None, if None is their default."""
        fields = type(self).model_fields.items()
        optional_keys = {field.alias or name for name, field in fields if field.default is None}
        return {
            key: value
            for key, value in handler(self).items()
            if value is not None or key not in optional_keys
        }


_B = TypeVar("_B", bound=Block)
_DRAFT = "draft"
"""Context of a validation in which a block with faults becomes a draft, see `Block.read`."""


def _build_draft(block: type[_B], data: Values) -> _B:
    """Build a draft of a block, see `Block.read`; values of unknown keys are kept as written."""
    names_by_key = {field.alias or name: name for name, field in block.model_fields.items()}
    values = {key: value for key, value in data.items() if key not in names_by_key}
    for key, name in names_by_key.items():
        field = block.model_fields[name]
        default = None if field.is_required() else field.get_default()
        values[name] = default
        if key in data:
            has_default = isinstance(default, Block | dict) and not field.discriminator
            substitute = default if has_default else (None,) if isinstance(default, tuple) else None
            values[name] = _validate_draft(_build_adapter(block, name), data[key], substitute)
    stated_names = {name for key, name in names_by_key.items() if key in data}
    return cast("_B", block.model_construct(stated_names, **values))


def _validate_draft(adapter: TypeAdapter[Any], value: object, default: Any) -> Any:
    """Validate the value of a key of a draft, or the entries of a mapping one by one.

    An entry that is not valid is replaced by an empty block if it must be a block, and is omitted
    otherwise.
    """
    with suppress(ValidationError):  # the fault is already reported
        return adapter.validate_python(value, context=_DRAFT)
    entries: dict[Any, Any] = {}
    for key, content in value.items() if isinstance(value, Mapping) else ():
        for entry_content in (dict[str, Any](), content):
            with suppress(ValidationError):
                entry = adapter.validate_python({key: entry_content}, context=_DRAFT)
                entries |= entry if isinstance(entry, dict) else {}
    return entries or default


@cache
def _build_adapter(block: type[Block], name: str) -> TypeAdapter[Any]:
    """Build the validator of one field of a block."""
    field = block.model_fields[name]
    markers = (*field.metadata, Field(discriminator=field.discriminator))
    field_type: Any = Annotated[(field.annotation, *markers)]
    return TypeAdapter(field_type)


def list_blocks(node: object, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the path and value of a block, list or mapping, and of all blocks and lists in it.

    Parameters
    ----------
    node : validated block, list or mapping
    path : path of `node`; the paths of its values begin with it
    """
    yield path, node
    for key, value in list_items(node):
        if not isinstance(value, str | float | int | date | None):
            yield from list_blocks(value, (*path, key))


def list_items(node: object) -> Iterable[tuple[Any, Any]]:
    """List keys and values of a block or mapping, or indices and items of a list.

    The keys of a block are the names of its fields. These differ from the keys in YAML only for
    fields of texts and numbers.
    """
    if isinstance(node, Block):
        return (vars(node) | (node.__pydantic_extra__ or {})).items()
    if isinstance(node, dict):
        return node.items()
    return enumerate(node) if isinstance(node, tuple) else ()


def build_pydantic_type(hint: Any) -> Any:
    """Convert the type of a field to one that pydantic validates.

    Parameters
    ----------
    hint : type with markers; a block of settings is read as a plain dataclass that the type names

    Returns
    -------
    The type with validators in place of the markers; a validated value has the type `hint`.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _replace_markers(arguments[0], arguments[1:])
    if origin in (Union, UnionType):
        members = tuple(build_pydantic_type(argument) for argument in arguments)
        return Union[members]  # noqa: UP007 - the members are computed
    if origin in (tuple, list, dict):
        return origin[tuple(build_pydantic_type(argument) for argument in arguments)]
    if hint is Span:
        serializer = PlainSerializer(format_span)
        schema = {"type": "string", "examples": ["0.1 s", "2 mm", "5 %", "51 samples"]}
        return Annotated[Span, PlainValidator(_parse_span), serializer, WithJsonSchema(schema)]
    return Annotated[hint, _BlockAnnotation(hint)] if is_dataclass(hint) else hint


def _replace_markers(inner_type: Any, markers: tuple[Any, ...]) -> Any:
    """Convert an annotated type to one with validators in place of its markers."""
    for marker in markers:
        if isinstance(marker, TaggedChoice):
            choice = _ChoiceAnnotation(get_args(inner_type), marker.key)
            return Annotated[inner_type, choice, WrapValidator(_validate_choice)]
    inner_type = build_pydantic_type(inner_type)
    annotations: list[Any] = []
    for marker in markers:
        annotations += _convert_marker(marker, inner_type, markers)
    return Annotated[(inner_type, *annotations)]


def _convert_marker(marker: object, inner_type: Any, markers: tuple[Any, ...]) -> list[Any]:
    """Convert a marker to annotations for pydantic; a text becomes the description of the field."""
    match marker:
        case Quantity():
            text = QuantityText(marker)
            serializer = PlainSerializer(text.format)
            return [PlainValidator(text.parse), serializer, WithJsonSchema(text.schema)]
        case WholeNumber():
            schema = {"type": "integer", "minimum": marker.minimum, "maximum": marker.maximum}
            return [PlainValidator(partial(parse_whole_number, marker)), WithJsonSchema(schema)]
        case PatternText():
            annotation: Any = BeforeValidator(partial(_parse_pattern_text, marker))
        case ShippedCard():
            annotation = BeforeValidator(read_limit_card, json_schema_input_type=inner_type | str)
        case LargerThan():
            quantity = next(item for item in markers if isinstance(item, Quantity))
            annotation = AfterValidator(partial(_check_larger, marker, QuantityText(quantity)))
        case Key():
            annotation = Field(alias=marker.name)
        case str():
            annotation = Field(description=marker)
        case _:
            annotation = marker
    return [annotation]


def _check_larger(
    marker: LargerThan, quantity_text: QuantityText, value: float, info: ValidationInfo
) -> float:
    """Return a value; refuse it if it is not larger than that of an earlier field."""
    bound = (info.data or {}).get(marker.field)
    if bound is not None and value <= bound:
        text, bound_text = map(quantity_text.format, (value, bound))
        raise build_refusal("protocol.not_larger", found=text, key=marker.key, bound=bound_text)
    return value


def read_limit_card(name: object) -> object:
    """Read a shipped card with the smallest allowed forces.

    Parameters
    ----------
    name : name of the card, such as ``crimp-pull``; any value but a text is returned unchanged

    Returns
    -------
    The content of the card as plain values.

    Raises
    ------
    FaultsError
        If labpipe has no card of this name.
    """
    if not isinstance(name, str):
        return name
    folder = files("labpipe.protocol") / "limit_cards"
    cards = {path.name.removesuffix(".yaml"): path for path in folder.iterdir()}
    if name not in cards:
        raise FaultsError(build_choice_fault((), name, cards, "a card or one of"))
    return parse_yaml(cards[name].read_text(encoding="utf-8"), name).data


@cache
def build_block(kind: Any, tag: str = "") -> type[Block]:
    """Build the block whose keys are the fields of a plain dataclass.

    Parameters
    ----------
    kind : frozen dataclass of settings. A field with ``compare=False`` has no key. The dataclass
        may have a method ``find_value_faults``, as `Block` has
    tag : key that distinguishes the kinds of items in a list; a class variable of this name in
        `kind` has the value of the key. Empty if the block is no item of such a list

    Returns
    -------
    The class of the block, with the name and docstring of `kind`.
    """
    hints = get_type_hints(kind, include_extras=True)
    keys: dict[str, Any] = {tag: (Literal[getattr(kind, tag)], ...)} if tag else {}
    for field in fields(kind):
        if field.compare:
            default = ... if field.default is MISSING else field.default
            keys[field.name] = (hints[field.name], default)
    return create_model(kind.__name__, __base__=Block, __doc__=kind.__doc__, **keys)


@dataclass(frozen=True, slots=True)
class _BlockAnnotation:
    """Annotation of a plain dataclass that is read from a block, and written as a block.

    The class of the block is built at its first use, because a file has few kinds of blocks.

    Parameters
    ----------
    kind, tag : dataclass, and key that distinguishes it from others, see `build_block`
    """

    kind: Any
    tag: str = ""

    def __get_pydantic_core_schema__(
        self, _source: object, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        serialization = core_schema.plain_serializer_function_ser_schema(self._write, info_arg=True)
        return core_schema.with_info_plain_validator_function(
            self._read, serialization=serialization
        )

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        block = build_block(self.kind, self.tag)
        block.model_rebuild()
        # The schema of the file can refer to a definition many times.
        return handler(core_schema.definitions_schema(block.__pydantic_core_schema__, []))

    def _read(self, data: object, info: ValidationInfo) -> object:
        block = build_block(self.kind, self.tag)
        try:
            model = block.model_validate(data, context=info.context)
        except ValidationError as error:
            raise FaultsError(*convert_errors(error, data)) from error
        names = (name for name in block.model_fields if name != self.tag)
        return self.kind(**{name: getattr(model, name) for name in names})

    def _write(self, settings: object, info: SerializationInfo) -> dict[str, Any]:
        block = build_block(self.kind, self.tag)
        values = {name: getattr(settings, name) for name in block.model_fields}
        return block.model_construct(**values).model_dump(mode=info.mode, by_alias=info.by_alias)


@dataclass(frozen=True, slots=True)
class _ChoiceAnnotation:
    """Annotation of a union of plain dataclasses, which a key of their blocks distinguishes.

    Parameters
    ----------
    kinds : dataclasses of the union
    tag : key whose value distinguishes the dataclasses
    """

    kinds: tuple[Any, ...]
    tag: str

    def __get_pydantic_core_schema__(
        self, _source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        blocks = {
            getattr(kind, self.tag): handler.generate_schema(
                Annotated[kind, _BlockAnnotation(kind, self.tag)]
            )
            for kind in self.kinds
        }
        return core_schema.tagged_union_schema(blocks, self.tag)


def _validate_choice(
    data: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo
) -> object:
    """Validate settings of one of several kinds; in a draft, None stands for an unknown kind."""
    try:
        return handler(data)
    except ValidationError:
        if info.context is _DRAFT:
            return None
        raise
