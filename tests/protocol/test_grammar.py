from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import pytest
from pydantic import Field, TypeAdapter, ValidationError

from labpipe.errors import Fault
from labpipe.protocol.faults import error_of, faults_of
from labpipe.protocol.grammar import Block, block_of, validated
from labpipe.records.declarations import Above, Distance, Key, Length, Snake, Span, Tagged


class Inner(Block):
    kind: Literal["inner"]
    width: str
    depth: str | None = None


class Outer(Block):
    inner: Inner
    words: tuple[str, ...] = Field((), alias="terms")
    nothing: str | None

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        return [Fault(("terms",), "no terms", "some")] if "terms" in dict(data or {}) else []  # type: ignore[call-overload]


def _faults(data: object) -> list[tuple[object, ...]]:
    with pytest.raises(ValidationError) as info:
        Outer.model_validate(data)
    faults = faults_of(info.value, data=data, keys=())
    return [(each.path, each.expected, each.found, each.remedy, each.at) for each in faults]


def test_faults_at_all_levels_come_together_in_our_words() -> None:
    data = {"inner": {"kind": "iner", "withd": "1"}, "terms": ["a"], "nothing": None}

    assert _faults(data) == [
        (("inner", "kind"), "one of 'inner'", "'iner'", "Did you mean 'inner'?", "value"),
        (("inner",), "the key 'width'", "no such key", "Add the key 'width'.", "value"),
        (
            ("inner", "withd"),
            "one of the keys 'width', 'kind', 'depth'",
            "'withd'",
            "Did you mean 'width'?",
            "key",
        ),
        (("terms",), "no terms", "some", "", "value"),
    ]


def test_a_fault_between_parts_is_not_told_where_the_part_itself_is_wrong() -> None:
    data = {"inner": {"kind": "inner", "width": "1"}, "terms": "a", "nothing": None}

    assert _faults(data) == [(("terms",), "a list", "'a'", "", "value")]


def test_a_block_that_is_no_block() -> None:
    assert _faults(None) == [((), "a block of keys with values", "nothing", "Fill it in.", "value")]
    assert _faults(["a"])[0][2] == "a list"


def test_what_nobody_said_is_not_written_but_what_must_be_said_is() -> None:
    outer = Outer.model_validate({"inner": {"kind": "inner", "width": "1"}, "nothing": None})

    assert outer.model_dump(by_alias=True) == {
        "inner": {"kind": "inner", "width": "1"},
        "terms": (),
        "nothing": None,
    }


def test_a_block_is_frozen() -> None:
    inner = Inner(kind="inner", width="1")

    with pytest.raises(ValidationError, match="frozen"):
        inner.width = "2"  # type: ignore[misc]


def test_the_error_of_a_validator_reads_like_a_message() -> None:
    assert error_of(expected="a", found={}, remedy="Do.").message() == (
        "expected a, found an empty block. Do."
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Grip:
    """One grip."""

    jaw: Length | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A straight line."""

    kind: ClassVar = "line"
    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), Above("start"), "Where it ends"]
    name: Snake = "line"
    grip: Grip | None = None
    number: int = field(default=0, compare=False)

    @staticmethod
    def between(entry: Mapping[str, object]) -> Iterator[Fault]:
        """Refuse a line of the name of another kind."""
        if entry.get("name") == "span":
            yield Fault(("name",), "another name", "'span'", "Rename it.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of time."""

    kind: ClassVar = "stretch"
    over: Span


Entry = Annotated[Line | Stretch, Tagged("kind")]
ENTRIES: TypeAdapter[Any] = TypeAdapter(validated(tuple[Entry, ...]))


def _refused(*entries: Mapping[str, object]) -> list[tuple[object, ...]]:
    data = list(entries)
    with pytest.raises(ValidationError) as info:
        ENTRIES.validate_python(data)
    faults = faults_of(info.value, data=data, keys=())
    return [(each.path, each.expected, each.found, each.at) for each in faults]


def test_plain_settings_come_out_of_yaml_and_go_back() -> None:
    line = {"kind": "line", "from": "1 mm", "to": "2 mm", "grip": {"jaw": "5 mm"}}
    found = ENTRIES.validate_python([line, {"kind": "stretch", "over": "51 samples"}])

    assert found == (
        Line(start=0.001, stop=0.002, grip=Grip(jaw=0.005)),
        Stretch(over=Span("samples", 51.0)),
    )
    assert [type(each) for each in found] == [Line, Stretch]
    assert ENTRIES.dump_python(found, mode="json", by_alias=True) == [
        {"kind": "line", "from": "1 mm", "to": "2 mm", "name": "line", "grip": {"jaw": "5 mm"}},
        {"kind": "stretch", "over": "51 samples"},
    ]


def test_all_faults_of_plain_settings_are_told_at_once() -> None:
    line = {"kind": "line", "from": "2 mm", "to": "1 mm", "name": "span", "number": 1}

    assert _refused(line, {"kind": "lien"}, {"kind": "line", "from": "2"}) == [
        ((0, "to"), "more than 'from' (2 mm)", "'1 mm'", "value"),
        ((0, "number"), "one of the keys 'name', 'from', 'grip', 'kind', 'to'", "'number'", "key"),
        ((0, "name"), "another name", "'span'", "value"),
        ((1, "kind"), "one of 'line', 'stretch'", "'lien'", "value"),
        ((2, "from"), "a quantity with a unit such as mm", "'2'", "value"),
        ((2,), "the key 'to'", "no such key", "value"),
    ]


def test_plain_settings_are_described_for_editors() -> None:
    schema = block_of(Line, "kind").model_json_schema()

    assert schema["description"] == "A straight line."
    assert schema["required"] == ["kind", "from", "to"]
    assert schema["properties"]["to"]["description"] == "Where it ends"
    assert schema["properties"]["kind"]["const"] == "line"
    assert "number" not in schema["properties"]
