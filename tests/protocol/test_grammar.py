"""Grammar of blocks, and YAML with the places of its values."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest
from pydantic import TypeAdapter

from labpipe.errors import Fault, ProtocolError
from labpipe.protocol.grammar import build_pydantic_type
from labpipe.protocol.yaml_text import parse_yaml, read_text
from labpipe.records.declarations import (
    Distance,
    Key,
    LargerThan,
    Length,
    SnakeName,
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
    stop: Annotated[Distance, Key("to"), LargerThan("start", "from"), "Where it ends"]
    name: SnakeName = "line"
    grip: Grip | None = None
    number: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """A stretch of time."""

    kind: ClassVar = "stretch"
    over: Span


Entry = Annotated[Line | Stretch, TaggedChoice("kind")]


ENTRIES: TypeAdapter[Any] = TypeAdapter(build_pydantic_type(tuple[Entry, ...]))


def test_plain_settings_come_out_of_yaml_and_go_back() -> None:
    line = {"kind": "line", "from": "1 mm", "to": "2 mm", "grip": {"jaw": "5 mm"}}
    entries = ENTRIES.validate_python([line, {"kind": "stretch", "over": "51 samples"}])

    assert entries == (
        Line(start=0.001, stop=0.002, grip=Grip(jaw=0.005)),
        Stretch(over=Span("samples", 51.0)),
    )
    assert [type(entry) for entry in entries] == [Line, Stretch]
    assert ENTRIES.dump_python(entries, mode="json", by_alias=True) == [
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
    location, _ = document.find_location(("a", 1, "c"))
    assert (location.file, location.key_mark, location.value_mark) == ("x.yaml", (3, 6), (3, 9))
    assert document.get_value(("a", 1, "c")) == "d"
    assert document.data == {"a": ["b", {"c": "d"}]}
    *_, text = document.place(Fault(("a", 1, "z"), "this", "that"), "(Remark.)")
    assert text == "x.yaml, line 3, column 5 (a.1.z): expected this, found that. (Remark.)"


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
