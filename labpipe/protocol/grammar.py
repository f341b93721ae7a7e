"""Blocks of keys in protocols and test sheets, and how settings declared as plain data become them.

Types with the markers of `labpipe.records.declarations` mean the same in a `Block` and in a plain
frozen dataclass: here, and only here, they turn into what pydantic validates, writes and describes.
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
    OrShort,
    QuantityText,
    parse_span,
    parse_whole,
    parse_word,
    written_span,
)
from labpipe.protocol.yaml_text import FaultsError, Values, faults_of, refused
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

_SPAN = {"type": "string", "examples": ["0.1 s", "2 mm", "5 %", "51 samples"]}


class Block(BaseModel):
    """A frozen block of keys that refuses unknown keys, with faults in plain language."""

    # Built when first used: a test uses a protocol and a sheet, not each block on its own.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    def __init_subclass__(cls, **options: Any) -> None:
        """Replace the markers by validators before pydantic reads the types."""
        super().__init_subclass__(**options)
        hints = inspect.get_annotations(cls, eval_str=True)
        cls.__annotations__ = {name: validated(hint) for name, hint in hints.items()}

    @classmethod
    def keys(cls) -> list[str]:
        """List the keys as YAML writes them."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def read(cls, data: object) -> Self | list[Fault]:
        """Validate plain values, or find all that is wrong with them."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            return faults_of(error, data)

    @classmethod
    def between(cls, data: Values) -> Iterable[Fault]:  # noqa: ARG003 - blocks that check use it
        """Check one part of the block against another, whether or not each part is valid.

        Parameters
        ----------
        data : the block as written

        Returns
        -------
        The faults, with their paths in `data`.
        """
        return ()

    @model_validator(mode="wrap")
    @classmethod
    def _collect_faults(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Collect the faults of the parts and between them; the first at a place is reported.

        Of an unknown key, only the key is reported, not its value.
        """
        cross_faults = list(cls.between(data)) if isinstance(data, Mapping) else []
        within: list[Fault] = []
        try:
            block = handler(data)
        except ValidationError as error:
            within = faults_of(error, data, cls.keys())
        else:
            if not cross_faults:
                return block
        misspelt = {fault.path for fault in cross_faults if fault.at == "key"}
        within = [fault for fault in within if fault.path not in misspelt]
        places = {fault.path for fault in within}
        raise FaultsError(*within, *(x for x in cross_faults if x.path not in places))

    @model_serializer(mode="wrap")
    def _without_unset(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit keys that are None by default."""
        fields = type(self).model_fields
        unset = {field.alias or name for name, field in fields.items() if field.default is None}
        return {
            key: value
            for key, value in handler(self).items()
            if value is not None or key not in unset
        }


def validated(hint: Any) -> Any:
    """Replace the markers in a type by what pydantic validates with.

    Parameters
    ----------
    hint : type of a field; a plain dataclass in it is read as a block of its settings

    Returns
    -------
    The type for pydantic, whose values are those of `hint`.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _annotated(parts[0], parts[1:])
    if origin in (Union, UnionType):
        return Union[tuple(validated(part) for part in parts)]  # noqa: UP007 - of a list
    if origin in (tuple, list, dict):
        return origin[tuple(validated(part) for part in parts)]
    if hint is Span:
        write = PlainSerializer(written_span)
        return Annotated[Span, PlainValidator(parse_span), write, WithJsonSchema(_SPAN)]
    return Annotated[hint, _Settings(hint)] if is_dataclass(hint) else hint


def _annotated(inner: Any, markers: tuple[Any, ...]) -> Any:
    """Return a type with validators in place of its markers."""
    for marker in markers:
        if isinstance(marker, TaggedChoice):
            kinds = (Annotated[arg, _Settings(arg, marker.key)] for arg in get_args(inner))
            return Annotated[Union[tuple(kinds)], Field(discriminator=marker.key)]  # noqa: UP007
    annotations = [part for marker in markers for part in _annotations_of(marker, markers)]
    return Annotated[(validated(inner), *annotations)]


def _annotations_of(marker: object, markers: tuple[Any, ...]) -> list[Any]:
    """Return what pydantic takes for one of several markers; a text is the description."""
    part: Any = marker
    match marker:
        case Quantity():
            text = QuantityText(marker)
            written = PlainSerializer(text.written)
            return [PlainValidator(text.parse), written, WithJsonSchema(text.schema)]
        case WholeNumber():
            schema = {"type": "integer", "minimum": marker.minimum, "maximum": marker.maximum}
            return [PlainValidator(partial(parse_whole, marker)), WithJsonSchema(schema)]
        case PatternText():
            return [BeforeValidator(partial(parse_word, marker))]
        case FromCard():
            return [OrShort(read_limit_card, {"type": "string"})]
        case LargerThan():
            quantity = next(other for other in markers if isinstance(other, Quantity))
            return [AfterValidator(partial(_larger, marker, QuantityText(quantity)))]
        case Key():
            part = Field(alias=marker.name)
        case str():
            part = Field(description=marker)
    return [part]


def _larger(than: LargerThan, text: QuantityText, value: float, info: ValidationInfo) -> float:
    """Refuse a value that is not above that of a field before it."""
    least = info.data.get(than.field)
    if least is not None and value <= least:
        least_text, found = text.written(least), text.written(value)
        raise refused("protocol.not_larger", found=found, key=than.key, least=least_text)
    return value


class _SettingsBlock(Block):
    """A block that is generated from plain settings."""

    settings_kind: ClassVar[Any]

    @classmethod
    def between(cls, data: Values) -> Iterable[Fault]:
        """Check one setting against another, if the settings define a check."""
        check = getattr(cls.settings_kind, "between", None)
        return () if check is None else check(data)


@cache
def block_of(kind: Any, tag: str = "") -> type[Block]:
    """Make the block that reads a plain dataclass.

    Parameters
    ----------
    kind : frozen dataclass; its fields are the keys, except those with ``compare=False``, which are
        not settings. A static method ``between`` finds faults between them in the block as written.
    tag : key that distinguishes the kind from others of its list, and class variable with its value

    Returns
    -------
    The block, of the same name and docstring.
    """
    hints = get_type_hints(kind, include_extras=True)
    keys: dict[str, Any] = {tag: (Literal[getattr(kind, tag)], ...)} if tag else {}
    for field in fields(kind):
        if field.compare:
            default = ... if field.default is MISSING else field.default
            keys[field.name] = (hints[field.name], default)
    block = create_model(kind.__name__, __base__=_SettingsBlock, __doc__=kind.__doc__, **keys)
    block.settings_kind = kind
    return block


@dataclass(frozen=True, slots=True)
class _Settings:
    """Annotation of a plain dataclass that YAML writes as a block."""

    kind: Any
    tag: str = ""

    def __get_pydantic_core_schema__(
        self, _source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        block = block_of(self.kind, self.tag)
        names = list(block.model_fields)

        def plain(block_value: Block) -> object:
            return self.kind(
                **{name: getattr(block_value, name) for name in names if name != self.tag}
            )

        def written(settings: object, write: SerializerFunctionWrapHandler) -> object:
            values = {name: getattr(settings, name) for name in names}
            return write(block.model_construct(**values))

        return core_schema.no_info_after_validator_function(
            plain,
            handler.generate_schema(block),
            serialization=core_schema.wrap_serializer_function_ser_schema(written),
        )
