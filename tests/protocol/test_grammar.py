"""Grammar of blocks, and YAML with the places of its values."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar
from unittest.mock import patch

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from labpipe.errors import Fault, ProtocolError
from labpipe.protocol.grammar import validated
from labpipe.protocol.yaml_text import YamlPosition, _quickly_composed, parse_yaml, read_text
from labpipe.records.declarations import (
    Distance,
    Key,
    LargerThan,
    Length,
    Snake,
    Span,
    TaggedChoice,
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
    stop: Annotated[Distance, Key("to"), LargerThan("start"), "Where it ends"]
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


Entry = Annotated[Line | Stretch, TaggedChoice("kind")]


ENTRIES: TypeAdapter[Any] = TypeAdapter(validated(tuple[Entry, ...]))


def test_plain_settings_come_out_of_yaml_and_go_back() -> None:
    line = {"kind": "line", "from": "1 mm", "to": "2 mm", "grip": {"jaw": "5 mm"}}
    found = ENTRIES.validate_python([line, {"kind": "stretch", "over": "51 samples"}])

    assert found == (
        Line(start=0.001, stop=0.002, grip=Grip(jaw=0.005)),
        Stretch(over=Span("samples", 51.0)),
    )
    assert [type(finding) for finding in found] == [Line, Stretch]
    assert ENTRIES.dump_python(found, mode="json", by_alias=True) == [
        {"kind": "line", "from": "1 mm", "to": "2 mm", "name": "line", "grip": {"jaw": "5 mm"}},
        {"kind": "stretch", "over": "51 samples"},
    ]


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


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: b\n", encoding="utf-8-sig")

    assert parse_yaml(read_text(path), "x").data == {"a": "b"}


@given(st.text(alphabet="ab:-[]{}'\"#&*!|>?,\n\t \x00%@`", max_size=40))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    try:
        spots = parse_yaml(text, "x").spots
    except ProtocolError:
        spots = {(): YamlPosition("x", (1, 1), (1, 1))}

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
