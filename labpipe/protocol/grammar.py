"""Blocks: the pydantic models of YAML files, and the models built from plain settings.

The fields of a `Block`, and of a plain frozen dataclass such as a step, are declared with the
markers of `labpipe.records.declarations`. This module alone converts these markers into pydantic's
validators, serializers and JSON schemas.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache, partial
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    Union,
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
    ModelWrapValidatorHandler,
    PlainSerializer,
    PlainValidator,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    create_model,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from labpipe.errors import Fault
from labpipe.protocol.limit_cards import read_limit_card
from labpipe.protocol.values import (
    QuantityText,
    ShortForm,
    format_span,
    parse_pattern_text,
    parse_span,
    parse_whole_number,
)
from labpipe.protocol.yaml_text import FaultsError, Values, convert_errors, refused
from labpipe.records.declarations import (
    FromCard,
    Key,
    LargerThan,
    PatternText,
    Quantity,
    Span,
    TaggedChoice,
    WholeNumber,
)

_SPAN_SCHEMA = {"type": "string", "examples": ["0.1 s", "2 mm", "5 %", "51 samples"]}


class Block(BaseModel):
    """A frozen model of a YAML block; it refuses unknown keys and reports faults for people."""

    # Pydantic builds a model on first use: most commands use few of them.
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
    def read(cls, data: object) -> Self | list[Fault]:
        """Validate plain values.

        Parameters
        ----------
        data : the content of the YAML block; anything but a block is a fault

        Returns
        -------
        The block, or all faults of its values.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            return convert_errors(error, data)

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterable[Fault]:  # noqa: ARG003 - subclasses use it
        """Find contradictions between keys, even if other keys are invalid.

        Parameters
        ----------
        data : the block as written

        Returns
        -------
        The faults, with their paths in `data`; by default none.
        """
        return ()

    @model_validator(mode="wrap")
    @classmethod
    def _collect_faults(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Raise the faults of single values together with the contradictions.

        A contradiction is omitted where the value itself is invalid. Of an unknown key, only the
        key is reported.
        """
        contradictions = list(cls.find_contradictions(data)) if isinstance(data, Mapping) else []
        faults: list[Fault] = []
        try:
            block = handler(data)
        except ValidationError as error:
            faults = convert_errors(error, data, cls.list_keys())
        else:
            if not contradictions:
                return block
        misspelt = {fault.path for fault in contradictions if fault.at == "key"}
        faults = [fault for fault in faults if fault.path not in misspelt]
        paths = {fault.path for fault in faults}
        raise FaultsError(*faults, *(x for x in contradictions if x.path not in paths))

    @model_serializer(mode="wrap")
    def _without_unset(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit keys with the value None, if None is their default."""
        fields = type(self).model_fields
        unset = {field.alias or name for name, field in fields.items() if field.default is None}
        return {
            key: value
            for key, value in handler(self).items()
            if value is not None or key not in unset
        }


def build_pydantic_type(hint: Any) -> Any:
    """Convert the type of a field into one that pydantic validates.

    Parameters
    ----------
    hint : type with markers; a plain dataclass in it is read from a block of its settings

    Returns
    -------
    The type with validators in place of the markers. Validated values are of the type `hint`.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _replace_markers(parts[0], parts[1:])
    if origin in (Union, UnionType):
        return Union[tuple(build_pydantic_type(part) for part in parts)]  # noqa: UP007 - of a list
    if origin in (tuple, list, dict):
        return origin[tuple(build_pydantic_type(part) for part in parts)]
    if hint is Span:
        serializer = PlainSerializer(format_span)
        return Annotated[Span, PlainValidator(parse_span), serializer, WithJsonSchema(_SPAN_SCHEMA)]
    return Annotated[hint, _ReadAsBlock(hint)] if is_dataclass(hint) else hint


def _replace_markers(inner: Any, markers: tuple[Any, ...]) -> Any:
    """Convert an annotated type into one with validators in place of its markers."""
    for marker in markers:
        if isinstance(marker, TaggedChoice):
            kinds = (Annotated[arg, _ReadAsBlock(arg, marker.key)] for arg in get_args(inner))
            return Annotated[Union[tuple(kinds)], Field(discriminator=marker.key)]  # noqa: UP007
    annotations = [part for marker in markers for part in _convert_marker(marker, markers)]
    return Annotated[(build_pydantic_type(inner), *annotations)]


def _convert_marker(marker: object, markers: tuple[Any, ...]) -> list[Any]:
    """Convert one of the markers of a type for pydantic; a text is the description."""
    match marker:
        case Quantity():
            text = QuantityText(marker)
            serializer = PlainSerializer(text.format)
            return [PlainValidator(text.parse), serializer, WithJsonSchema(text.schema)]
        case WholeNumber():
            schema = {"type": "integer", "minimum": marker.minimum, "maximum": marker.maximum}
            return [PlainValidator(partial(parse_whole_number, marker)), WithJsonSchema(schema)]
        case PatternText():
            converted: Any = BeforeValidator(partial(parse_pattern_text, marker))
        case FromCard():
            converted = ShortForm(read_limit_card, {"type": "string"})
        case LargerThan():
            quantity = next(other for other in markers if isinstance(other, Quantity))
            converted = AfterValidator(partial(_check_larger, marker, QuantityText(quantity)))
        case Key():
            converted = Field(alias=marker.name)
        case str():
            converted = Field(description=marker)
        case _:
            converted = marker
    return [converted]


def _check_larger(
    bound: LargerThan, text: QuantityText, value: float, info: ValidationInfo
) -> float:
    """Refuse a value that is not above that of an earlier field."""
    least = info.data.get(bound.field)
    if least is not None and value <= least:
        least_text, found = text.format(least), text.format(value)
        raise refused("protocol.not_larger", found=found, key=bound.key, least=least_text)
    return value


class _SettingsBlock(Block):
    """A block that `build_block` derives from a plain dataclass."""

    settings_class: ClassVar[Any]

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterable[Fault]:
        """Find contradictions by the static method of the dataclass, if it has one."""
        check = getattr(cls.settings_class, "find_contradictions", None)
        return () if check is None else check(data)


@cache
def build_block(kind: Any, tag: str = "") -> type[Block]:
    """Build the block whose keys are the fields of a plain dataclass.

    Parameters
    ----------
    kind : frozen dataclass; fields with ``compare=False`` are no settings and have no key. It may
        have a static method ``find_contradictions``, as `Block` has.
    tag : key that distinguishes the kinds of a list, and class variable of `kind` with its value

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
    block = create_model(kind.__name__, __base__=_SettingsBlock, __doc__=kind.__doc__, **keys)
    block.settings_class = kind
    return block


@dataclass(frozen=True, slots=True)
class _ReadAsBlock:
    """Annotation of a plain dataclass that is read from a block, and written as one."""

    kind: Any
    tag: str = ""

    def __get_pydantic_core_schema__(
        self, _source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        block = build_block(self.kind, self.tag)
        names = list(block.model_fields)

        def to_settings(validated: Block) -> object:
            return self.kind(
                **{name: getattr(validated, name) for name in names if name != self.tag}
            )

        def to_yaml(settings: object, serialize: SerializerFunctionWrapHandler) -> object:
            values = {name: getattr(settings, name) for name in names}
            return serialize(block.model_construct(**values))

        return core_schema.no_info_after_validator_function(
            to_settings,
            handler.generate_schema(block),
            serialization=core_schema.wrap_serializer_function_ser_schema(to_yaml),
        )
