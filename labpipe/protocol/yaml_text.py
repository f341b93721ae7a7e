"""Read YAML text: plain values with their lines and columns, and faults that name these.

Unquoted words other than ``null`` remain text: YAML 1.1 would convert the test name ``0333`` to the
number 219, and ``no`` to *false*. Validators convert the texts later. Aliases, tags and repeated
keys are refused, because people misread them.
"""

from __future__ import annotations

import difflib
import errno
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial, reduce
from operator import getitem
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from labpipe.errors import Fault, KeyPath, ProtocolError, format_error, sort_by_likeness

_LOADER = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
Mark: TypeAlias = tuple[int, int]
"""Line and column, counted from 1."""
PlacedFault: TypeAlias = tuple[str, Mark, str]
"""A formatted fault: file, position and the whole message."""
Values: TypeAlias = Mapping[str, object]
"""A block of a YAML file as plain values, valid or not."""
MAX_BYTES = 1_000_000
"""Largest size of a YAML file, byte."""
MAX_DEPTH = 15
"""Largest number of levels of keys and lists."""
_PLAIN_TAGS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map"))
_POSSIBLE_ALIAS = re.compile(r"(?<![^\s,:\[{-])\*\S")
"""Begin of an alias, which may also be in a comment or in a text."""
_BLOCK = "a block of keys with values"
_EXPECTED_CONTENT = {
    **dict.fromkeys(("model_type", "dict_type", "model_attributes_type"), _BLOCK),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "text",
}
"""Expected content in messages, keyed by pydantic's type of error."""


def get_block(data: object, *path: str) -> Values:
    """Return the block at a path; an empty one if there is none."""
    for key in path:
        data = data.get(key) if isinstance(data, dict) else None
    return data if isinstance(data, dict) else {}


def describe_value(value: object) -> str:
    """Describe a value of a YAML file for a message; a long text is shortened."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a block of keys" if value else "an empty block"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"a list of {len(value)}" if value else "an empty list"
    text, max_length = str(value), 200
    return repr(text if len(text) <= max_length else f"{text[:max_length]}...")


def format_nearest_words(word: str, choices: Iterable[str]) -> str:
    """Format at most six valid words for a message, the most similar one to a word first."""
    valid_words = sorted(set(choices))
    text = ", ".join(map(repr, sort_by_likeness(word, valid_words, limit=6)))
    return f"{text}, ..." if len(valid_words) > 6 else text


def suggest_word(word: str, choices: Iterable[str]) -> str:
    """Suggest the valid word that is most similar to a word; empty if none is similar."""
    words = {choice.casefold(): choice for choice in sorted(choices, reverse=True)}
    nearest_words = difflib.get_close_matches(word.casefold(), words, n=1, cutoff=0.5)
    return f"Did you mean {words[nearest_words[0]]!r}?" if nearest_words else ""


def build_choice_fault(
    path: KeyPath,
    word: object,
    choices: Iterable[str],
    expected: str = "one of",
    *,
    remedy: str = "",
    is_key: bool = False,
) -> Fault:
    """Build the fault of a word that is not among the valid ones.

    Parameters
    ----------
    path : path of the word
    word : the invalid word
    choices : the valid words
    expected : phrase before the valid words, such as ``one of the channels``
    remedy : remedy if there are no valid words; otherwise, a similar word is suggested
    is_key : whether the word is a key, not a value
    """
    valid_words = sorted(set(choices))
    if isinstance(word, str) and valid_words:
        remedy = suggest_word(word, valid_words)
    expected = f"{expected} {format_nearest_words(str(word), valid_words)}"
    return Fault(path, expected, describe_value(word), remedy, is_key=is_key)


class FaultsError(ValueError):
    """Error of a validator that refuses a value.

    Parameters
    ----------
    faults : faults in the value; their paths begin at the value
    """

    def __init__(self, *faults: Fault) -> None:
        self.faults = faults
        super().__init__(
            "\n".join(f"expected {x.expected}, found {x.found}. {x.remedy}" for x in faults)
        )


def build_refusal(name: str, /, *, found: object, **facts: Any) -> FaultsError:
    """Build the error of a validator that refuses a value.

    Parameters
    ----------
    name, facts : name of a message template and values of its fields, see `Fault.of`
    found : refused value as written
    """
    return FaultsError(Fault.of(name, found=describe_value(found), **facts))


def convert_errors(error: ValidationError, data: object, keys: Iterable[str] = ()) -> list[Fault]:
    """Convert pydantic's errors of a block to faults.

    Parameters
    ----------
    error : error of pydantic; blocks inside this one have already converted theirs
    data : the block as written
    keys : valid keys of the block

    Returns
    -------
    The faults, with their paths in `data`.
    """
    faults: list[Fault] = []
    for details in error.errors(include_url=False):
        # Pydantic's paths also have tags of unions, and keys that are missing.
        path = _find_existing_path(data, details["loc"])
        validator_error = details.get("ctx", {}).get("error")
        if isinstance(validator_error, FaultsError):
            faults += prefix_paths(path, validator_error.faults)
        else:
            faults.append(_convert_error(details, path, keys))
    return faults


def prefix_paths(path: KeyPath, faults: Iterable[Fault]) -> list[Fault]:
    """Prefix the paths of faults with the path of the block that contains them."""
    return [replace(fault, path=(*path, *fault.path)) for fault in faults]


def _convert_error(details: ErrorDetails, path: KeyPath, keys: Iterable[str]) -> Fault:
    """Convert an error of pydantic's own validators to a fault at a path."""
    quoted_words = {
        key: re.findall(r"'([^']*)'", str(text)) for key, text in details.get("ctx", {}).items()
    }
    value = details["input"]
    match details["type"]:
        case "missing" | "union_tag_not_found":
            key = quoted_words["discriminator"][0] if quoted_words else str(details["loc"][-1])
            return Fault.of("protocol.no_key", path, key=key, missing=key)
        case "extra_forbidden":
            return build_choice_fault(path, path[-1], keys, "one of the keys", is_key=True)
        case "union_tag_invalid":
            key = quoted_words["discriminator"][0]
            return build_choice_fault((*path, key), value[key], quoted_words["expected_tags"])
        case "literal_error":
            is_key = details["loc"][-1] == "[key]"
            return build_choice_fault(path, value, quoted_words["expected"], is_key=is_key)
        case "too_short":
            min_length = details["ctx"]["min_length"]
            expected = "at least one entry" if min_length == 1 else f"at least {min_length} entries"
            return Fault(path, expected, describe_value(value))
        case error_type:
            remedy = "Fill it in." if value is None else ""
            expected = _EXPECTED_CONTENT.get(error_type, details["msg"])
            return Fault(path, expected, describe_value(value), remedy)


def _find_existing_path(data: Any, path: Iterable[int | str]) -> KeyPath:
    """Return a path without the keys and indices that do not exist in plain values."""
    existing_path: list[int | str] = []
    for key in path:
        is_item = isinstance(data, list) and isinstance(key, int) and key < len(data)
        if is_item or (isinstance(data, Mapping) and key in data):
            data = data[key]
            existing_path.append(key)
    return tuple(existing_path)


class Location(NamedTuple):
    """Location of a value in a YAML file.

    Parameters
    ----------
    file : name of the YAML file
    name : key of the value, or its index in a list, as written
    key_mark, value_mark : line and column of the key, and of the value
    """

    file: str
    name: str | int
    key_mark: Mark
    value_mark: Mark


class LocatedBlock(dict[str, Any]):
    """Block as written; `locations` has the location of the value of each key."""

    def __init__(self) -> None:
        self.locations: dict[str, Location] = {}


class LocatedList(list[Any]):
    """List as written; `locations` has the location of each item."""

    def __init__(self) -> None:
        self.locations: list[Location] = []


@dataclass(slots=True)
class Document:
    """Content of one YAML file.

    Parameters
    ----------
    location : location of the complete content
    data : content, as blocks and lists with locations; any other value is a text or None
    faults : faults with which the file can still be read, such as a repeated key
    """

    location: Location
    data: Any = None
    faults: list[PlacedFault] = field(default_factory=list)

    def get_value(self, path: KeyPath) -> Any:
        """Return the value at a path that exists."""
        return reduce(getitem, path, self.data)

    def find_location(self, path: KeyPath) -> tuple[Location, KeyPath]:
        """Find the location at a path, or that of the innermost block around it.

        Parameters
        ----------
        path : path in `data`

        Returns
        -------
        The location, and the path with keys and indices as written: an override that removes an
        item of a list changes the indices in `data`, and a text in place of a block has no keys.
        """
        data, location, written_path = self.data, self.location, list[str | int]()
        for depth, key in enumerate(path):
            if not _find_existing_path(data, [key]):
                absent_path = path[depth:] if isinstance(data, Mapping | list) else ()
                return location, (*written_path, *absent_path)
            data, location = data[key], data.locations[key]
            written_path.append(location.name)
        return location, tuple(written_path)

    def place(self, fault: Fault, remark: str = "") -> PlacedFault:
        """Format a fault with its file, line and column.

        Parameters
        ----------
        fault : fault of the file; one at an absent key is placed at the innermost block around it
        remark : sentence that is appended to the message
        """
        location, path = self.find_location(fault.path)
        mark = location.key_mark if fault.is_key else location.value_mark
        return _place_fault(location.file, mark, replace(fault, path=path), remark)


def _place_fault(file: str, mark: Mark, fault: Fault, remark: str = "") -> PlacedFault:
    """Format a fault with its line, column and dotted key."""
    key = ".".join(map(str, fault.path))
    place = f"line {mark[0]}, column {mark[1]}" + (f" ({key})" if key else "")
    remedy = f"{fault.remedy} {remark}".strip()
    text = format_error(file, place, expected=fault.expected, found=fault.found, remedy=remedy)
    return file, mark, text.rstrip()


def build_error(placed_faults: Iterable[PlacedFault], *, code: str = "") -> ProtocolError:
    """Build one error of all faults, one line each, in the order of the file, without repeats.

    Parameters
    ----------
    placed_faults : formatted faults
    code : code of the error; empty for that of its class
    """
    return ProtocolError("\n".join(text for _, _, text in sorted(set(placed_faults))), code=code)


def read_text(path: Path) -> str:
    """Read a YAML file as UTF-8 text.

    Parameters
    ----------
    path : the file

    Raises
    ------
    ProtocolError
        If the file does not exist, is not a plain file of at most 1 MB, or is not UTF-8 text.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise OSError(errno.EINVAL, "a pipe or a device")
        if path.is_file() and (size := path.stat().st_size) > MAX_BYTES:
            raise OSError(errno.EFBIG, f"one of {size / 1e6:.0f} megabytes")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        place, byte = f"byte {error.start}", error.object[error.start]
        raise ProtocolError.about("protocol.no_utf8", path, place, byte=byte) from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ProtocolError.about("protocol.no_yaml_file", path, found=reason) from error


_compose = lru_cache(maxsize=64)(partial(yaml.compose, Loader=_LOADER))
"""Function that composes the nodes of a text, with a cache because many tests share a protocol."""


def parse_yaml(text: str, file: str) -> Document:
    """Parse YAML text into plain values.

    Parameters
    ----------
    text : content of the file
    file : name of the file in messages

    Returns
    -------
    The document; its `faults` are those with which it can still be read, such as a repeated key.

    Raises
    ------
    ProtocolError
        If the text is not YAML, has an alias, or has more than 15 levels of keys and lists.
    """
    try:
        node = _compose(text)
    except (yaml.YAMLError, UnicodeError, RecursionError) as error:
        raise _build_syntax_error(error, text, file) from error
    tokens = yaml.scan(text, Loader=_LOADER) if _POSSIBLE_ALIAS.search(text) else ()
    aliases = [_get_mark(token) for token in tokens if isinstance(token, yaml.AliasToken)]
    if aliases:
        raise build_error(_place_fault(file, x, Fault.of("protocol.alias")) for x in aliases)
    mark = (1, 1) if node is None else _get_mark(node)
    document = Document(Location(file, "", mark, mark))
    if node is not None:
        document.data = _convert_node(node, (), document)
    return document


def _build_syntax_error(error: Exception, text: str, file: str) -> ProtocolError:
    """Build the error of a text that the YAML library refuses."""
    mark = getattr(error, "problem_mark", None)
    if mark is not None:
        line, column = mark.line + 1, mark.column + 1
    else:
        prefix = text[: getattr(error, "position", 0)]
        line, column = prefix.count("\n") + 1, len(prefix) - prefix.rfind("\n")
    problem = getattr(error, "problem", None) or getattr(error, "reason", "") or "too many levels"
    context = getattr(error, "context", None) or ""
    place, reason = f"line {line}, column {column}", f"{problem} {context}".strip()
    return ProtocolError.about("protocol.no_yaml", file, place, found=reason)


def _convert_node(node: yaml.Node, path: KeyPath, document: Document) -> Any:
    """Convert a node at a path to plain values with locations, and add faults to the document."""
    file = document.location.file
    if len(path) > MAX_DEPTH:
        fault = Fault.of("protocol.too_deep", limit=MAX_DEPTH)
        raise build_error([_place_fault(file, _get_mark(node), fault)])
    if node.tag not in _PLAIN_TAGS:
        fault = Fault.of("protocol.tag", path, tag=node.tag)
        document.faults.append(_place_fault(file, _get_mark(node), fault))
    if isinstance(node, yaml.ScalarNode):
        return node.value if node.style or node.value not in ("", "~", "null") else None
    if isinstance(node, yaml.MappingNode):
        return _convert_mapping(node, path, document)
    items = LocatedList()
    for index, item in enumerate(node.value):
        mark = _get_mark(item)
        items.locations.append(Location(file, index, mark, mark))
        items.append(_convert_node(item, (*path, index), document))
    return items


def _convert_mapping(node: yaml.MappingNode, path: KeyPath, document: Document) -> LocatedBlock:
    """Convert a node of keys and values to a block; a key that is no unique word is a fault."""
    file, block = document.location.file, LocatedBlock()
    previous_name, number_end = "", -1  # end of the previous value if this may be a number
    for key, value in node.value:
        name, mark = key.value, _get_mark(key)
        has_text = isinstance(value, yaml.ScalarNode) and not value.style
        is_next = key.start_mark.index == number_end + 1 and str(name)[:1].isdigit()
        if has_text and not value.value and is_next:
            # YAML splits {length: 8,5 mm} into a length and a key.
            block[previous_name] += f",{name}"
            continue
        number_end = -1
        if not isinstance(key, yaml.ScalarNode):
            fault = Fault.of("protocol.no_word_as_key", path, found=describe_value(name))
            document.faults.append(_place_fault(file, mark, fault))
        elif name in block:
            line = block.locations[name].key_mark[0]
            fault = Fault.of("protocol.key_again", (*path, name), key=name, line=line)
            document.faults.append(_place_fault(file, mark, fault))
        else:
            block.locations[name] = Location(file, name, mark, _get_mark(value))
            block[name] = _convert_node(value, (*path, name), document)
            if node.flow_style and has_text and value.value[-1:].isdigit():
                previous_name, number_end = name, value.end_mark.index
    return block


def _get_mark(node: yaml.Node | yaml.Token) -> Mark:
    """Return the line and the column of a node or token."""
    start = node.start_mark
    return (start.line + 1, start.column + 1) if start else (1, 1)
