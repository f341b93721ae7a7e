from __future__ import annotations

import os
from pathlib import Path
from unittest.mock import patch

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from labpipe.errors import Fault, ProtocolError
from labpipe.protocol.yaml_text import Spot, _quickly_composed, parse_yaml, read_text


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "a: 1\nb: 2\na: 3\n",
            "x, line 3, column 1 (a): expected each key once, found 'a' again (first in line 1).",
        ),
        (
            "a: !!python/object/new:os.system [ls]\n",
            "x, line 1, column 4 (a): expected a plain value, found the tag"
            " 'tag:yaml.org,2002:python/object/new:os.system'. Leave the tag out.",
        ),
        (
            "? [a, b]\n: c\n",
            "x, line 1, column 3: expected a word as key, found a list. Write 'key: value'.",
        ),
    ],
)
def test_what_is_yaml_but_not_for_protocols_is_told(text: str, message: str) -> None:
    assert [fault.text for fault in parse_yaml(text, "x").faults] == [message]


LOOK = "Look at this line and the one before it: indentation, ':' and brackets."


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "a: [1, 2\nb: 3\n",
            "x, line 2, column 2: expected YAML, found text that is none (expected ',' or ']',"
            f" but got ':' while parsing a flow sequence). {LOOK}",
        ),
        (
            "a: 1\n  b: 2\n",
            f"x, line 2, column 4: expected YAML, found text that is none (mapping values are"
            f" not allowed here). {LOOK}",
        ),
        (
            "a: 1\n\tb: 2\n",
            "x, line 2, column 1: expected YAML, found text that is none (found character '\\t'"
            f" that cannot start any token while scanning for the next token). {LOOK}",
        ),
        (
            "a: &x 1\nb: *x\n",
            "x, line 2, column 4: expected a value, found the alias '*x'. Write it out.",
        ),
        (
            "a: 1\n---\nb: 2\n",
            "x, line 2, column 1: expected YAML, found text that is none (but found another"
            f" document expected a single document in the stream). {LOOK}",
        ),
        (
            "a: 1\nb: \x00\n",
            f"x, line 2, column 4: expected YAML, found text that is none (special"
            f" characters are not allowed). {LOOK}",
        ),
        (
            "[" * 5000,
            "x, line 1, column 17: expected at most 16 levels, found more."
            " Write it in fewer levels.",
        ),
    ],
)
def test_what_is_no_yaml_is_told_with_its_place(text: str, message: str) -> None:
    with pytest.raises(ProtocolError) as info:
        parse_yaml(text, "x")

    assert str(info.value) == message


def test_an_empty_file_holds_nothing() -> None:
    assert parse_yaml("# a comment\n", "x").data is None


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
