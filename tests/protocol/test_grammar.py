"""Grammar of blocks, and YAML with the places of its values."""

from __future__ import annotations

import os
import re
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
from labpipe.protocol.yaml_text import _quickly_composed, parse_yaml, read_text
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


def test_places_of_values_and_of_faults(tmp_path: Path) -> None:
    """A fault at a path that is not there stands at the block around it."""
    path = tmp_path / "x.yaml"
    path.write_text("a:\n  - b\n  - {c: d}\n", encoding="utf-8-sig")
    document = parse_yaml(read_text(path), "x.yaml")
    spot = document.spots["a", 1, "c"]
    assert (spot.file, spot.key, spot.value) == ("x.yaml", (3, 6), (3, 9))
    assert document.at(("a", 1, "c")) == "d"
    assert document.data == {"a": ["b", {"c": "d"}]}
    placed = document.place(Fault(("a", 1, "z"), "this", "that"), "(Remark.)")
    assert placed.text == "x.yaml, line 3, column 5 (a.1.z): expected this, found that. (Remark.)"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            b"a: 1\nb: \xff\n",
            r", byte 8: expected UTF-8 text, found the byte 0xff\. Save it as UTF",
        ),
        (b"about: " + 3_000_000 * b"x", r": expected a YAML file, found one of 3 megabytes\."),
        pytest.param(
            None,
            ": expected a YAML file, found a pipe or a dev",
            marks=pytest.mark.skipif(os.name == "nt", reason="no pipes among files on Windows"),
        ),
    ],
    ids=["no text", "nobody wrote it by hand", "a pipe"],
)
def test_what_is_no_yaml_file(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "x.yaml"
    if content is None:
        os.mkfifo(path)
    else:
        path.write_bytes(content)
    with pytest.raises(ProtocolError, match=f"^{re.escape(str(path))}{message}"):
        read_text(path)


SHIPPED = Path(__file__).parents[2] / "protocols"
MANY_WAYS = [
    *((SHIPPED / f"{name}.yaml").read_text("utf-8") for name in ("tensile", "wire-cantilever")),
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


def outcome(text: str) -> object:
    try:
        return parse_yaml(text, "p.yaml")
    except ProtocolError as error:
        return str(error)


def assert_both_parsers_agree(text: str) -> None:
    with patch("labpipe.protocol.yaml_text._quickly_composed", lambda _: None):
        slow = outcome(text)
    assert outcome(text) == slow


@pytest.mark.parametrize("text", MANY_WAYS)
def test_libyaml_makes_of_a_text_what_pythons_parser_makes(text: str) -> None:
    assert_both_parsers_agree(text)


@given(st.text(alphabet="ab:-[]{}'\"#&*!|>?,\n\t \r%@`~=1é", max_size=30))
def test_libyaml_makes_of_any_text_what_pythons_parser_makes(text: str) -> None:
    assert_both_parsers_agree(text)


def test_a_protocol_of_labpipe_is_read_by_libyaml() -> None:
    if not yaml.__with_libyaml__:
        pytest.skip("PyYAML without libyaml")
    assert _quickly_composed(MANY_WAYS[0]) is not None
    assert _quickly_composed(MANY_WAYS[0]) is _quickly_composed(MANY_WAYS[0])
