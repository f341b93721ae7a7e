"""Grammar of blocks, and YAML with the places of its values."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal
from unittest.mock import patch

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, TypeAdapter, ValidationError

from labpipe.errors import Fault, ProtocolError
from labpipe.protocol.faults import faults_of, one_of
from labpipe.protocol.grammar import Block, block_of, validated
from labpipe.protocol.yaml_text import Spot, _quickly_composed, parse_yaml, read_text
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


def test_what_nobody_said_is_not_written_but_what_must_be_said_is() -> None:
    outer = Outer.model_validate({"inner": {"kind": "inner", "width": "1"}, "nothing": None})

    assert outer.model_dump(by_alias=True) == {
        "inner": {"kind": "inner", "width": "1"},
        "terms": (),
        "nothing": None,
    }


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


def test_valid_words_come_nearest_first_and_not_all_of_many() -> None:
    assert one_of("bet", ["alpha", "beta"]) == "'beta', 'alpha'"
    assert one_of("c3", [f"c{i}" for i in range(9)]).startswith("'c3', ")
    assert one_of("c3", [f"c{i}" for i in range(9)]).endswith(", ...")


def test_unquoted_words_stay_text() -> None:
    text = "a: 0103_3_3\nb: no\nc: 12:30\nd: 1e3\ne: 2026-03-04\nf: ~\ng: null\nh:\ni: 'null'\n"

    assert parse_yaml(text, "x").data == {
        "a": "0103_3_3",
        "b": "no",
        "c": "12:30",
        "d": "1e3",
        "e": "2026-03-04",
        "f": None,
        "g": None,
        "h": None,
        "i": "null",
    }


def test_every_value_has_its_place() -> None:
    document = parse_yaml("a:\n  - b\n  - {c: d}\n", "x.yaml")

    spot = document.spots["a", 1, "c"]
    assert (spot.file, spot.key, spot.value) == ("x.yaml", (3, 6), (3, 9))
    assert document.at(("a", 1, "c")) == "d"


def test_a_fault_at_a_path_that_is_not_there_stands_at_the_block_around_it() -> None:
    document = parse_yaml("a:\n  b: c\n", "x.yaml")

    told = document.place(Fault(("a", "z"), "this", "that"), "(Remark.)")

    assert told.text == "x.yaml, line 2, column 3 (a.z): expected this, found that. (Remark.)"


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(b"a: 1\nb: \xff\n")

    with pytest.raises(ProtocolError) as info:
        read_text(path)
    assert str(info.value) == (
        f"{path}, byte 8: expected UTF-8 text, found the byte 0xff. Save it as UTF-8."
    )


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError) as info:
        read_text(tmp_path / "x.yaml")
    assert str(info.value) == (
        f"{tmp_path / 'x.yaml'}: expected a YAML file, found no such file or directory."
        " Check the name and the folder."
    )


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: b\n", encoding="utf-8-sig")

    assert parse_yaml(read_text(path), "x").data == {"a": "b"}


@given(st.text(alphabet="ab:-[]{}'\"#&*!|>?,\n\t \x00%@`", max_size=40))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    try:
        spots = parse_yaml(text, "x").spots
    except ProtocolError:
        spots = {(): Spot("x", (1, 1), (1, 1))}

    assert () in spots


@pytest.mark.skipif(os.name == "nt", reason="no pipes among files on Windows")
def test_a_pipe_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.yaml")
    with pytest.raises(
        ProtocolError, match=r"x\.yaml: expected a YAML file, found a pipe or a dev"
    ):
        read_text(tmp_path / "x.yaml")


def test_what_nobody_wrote_by_hand(tmp_path: Path) -> None:
    (tmp_path / "x.yaml").write_text("about: " + 3_000_000 * "x", encoding="utf-8")
    with pytest.raises(
        ProtocolError, match=r"x\.yaml: expected a YAML file, found one of 3 megabytes\."
    ):
        read_text(tmp_path / "x.yaml")


MANY_WAYS = [
    *(
        path.read_text(encoding="utf-8")
        for path in sorted((Path(__file__).parents[2] / "protocols").glob("*.yaml"))
    ),
    "",
    "# a comment alone\n",
    "a: 1\nb:\n  - {c: 2, d: ~}\n  - 'quoted: é'\n",
    "a: |\n  two\n  lines\nb: null\n",
    "a: {b: }\n",
    "a: [b,\tc]\n",
    "a: {b: 0.?5}\n",
    "a: wh\u2028at\nb: 1\n",
    "a: b\ufeffc\nd: [e, f]\n",
    "a: [!x , b]\n",
]


def outcomes(text: str) -> list[object]:
    """What comes of a text by either parser."""

    def outcome() -> object:
        try:
            return parse_yaml(text, "p.yaml")
        except ProtocolError as error:
            return str(error)

    with patch("labpipe.protocol.yaml_text._quickly_composed", lambda _: None):
        slow = outcome()
    return [outcome(), slow]


@pytest.mark.parametrize("text", MANY_WAYS)
def test_libyaml_makes_of_a_text_what_pythons_parser_makes(text: str) -> None:
    quick, slow = outcomes(text)
    assert quick == slow


@given(st.text(alphabet="ab:-[]{}'\"#&*!|>?,\n\t \r%@`~=1é", max_size=30))
def test_libyaml_makes_of_any_text_what_pythons_parser_makes(text: str) -> None:
    quick, slow = outcomes(text)
    assert quick == slow


def test_a_protocol_of_labpipe_is_read_by_libyaml() -> None:
    if not yaml.__with_libyaml__:
        pytest.skip("PyYAML without libyaml")
    assert _quickly_composed(MANY_WAYS[0]) is not None
    assert _quickly_composed(MANY_WAYS[0]) is _quickly_composed(MANY_WAYS[0])
