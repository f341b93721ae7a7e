"""Parse YAML text into plain values with their positions, and place faults in it.

Unquoted words remain text: YAML 1.1 would convert the test name ``0333`` to the number 333, and
``no`` to *false*. The key decides the type of a value. Aliases, tags and repeated keys are refused,
because people read protocols.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from labpipe.errors import Fault, KeyPath, ProtocolError, format_error, sort_by_likeness

_LOADER = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
Mark: TypeAlias = tuple[int, int]
"""Line and column, counted from 1."""
PlacedFault: TypeAlias = tuple[str, Mark, str]
"""A fault, ready to be listed with others: file, position and the whole message."""
Values: TypeAlias = Mapping[str, object]
MAX_BYTES = 1_000_000
MAX_DEPTH = 16
_PLAIN_TAGS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map"))
_KINDS = {
    **{f"{kind}_type": "a block of keys with values" for kind in ("model", "dict")},
    **{f"{kind}_type": "a list" for kind in ("list", "tuple")},
    "model_attributes_type": "a block of keys with values",
    "string_type": "text",
    "too_short": "at least one entry",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}
"""What pydantic expected, by the type of its error."""


def block_in(data: object, *path: str) -> Values:
    """Return the block under a path; empty if there is none."""
    for key in path:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data if isinstance(data, Mapping) else {}


def list_in(data: object, *path: str) -> Sequence[Any]:
    """Return the list under a path; empty if there is none."""
    *blocks, key = path
    items = block_in(data, *blocks).get(key)
    return items if isinstance(items, list) else ()


def shown(value: object) -> str:
    """Name a value of a YAML file in a message."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a block of keys" if value else "an empty block"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"a list of {len(value)}" if value else "an empty list"
    text, max_shown = str(value), 200
    return repr(text if len(text) <= max_shown else f"{text[:max_shown]}...")


def one_of(word: str, valid: Iterable[str]) -> str:
    """List at most six valid words, nearest first."""
    valid_words = sorted(set(valid))
    listed = sort_by_likeness(word, valid_words, limit=6)
    return ", ".join([*map(repr, listed), *["..."] * (len(valid_words) > len(listed))])


def did_you_mean(word: str, valid: Iterable[str]) -> str:
    """Suggest the most similar valid word; empty if there is none."""
    best = sort_by_likeness(word, sorted(set(valid)), limit=1)
    return f"Did you mean {best[0]!r}?" if best else ""


def not_among(
    path: KeyPath, word: object, valid: Iterable[str], what: str = "one of", *, remedy: str = ""
) -> Fault:
    """Make the fault of a word that is none of the valid ones.

    Parameters
    ----------
    path : way to the word
    word : the invalid one
    valid : the valid ones
    what : they are, such as ``one of the channels``
    remedy : what to do if there are no valid ones
    """
    words = sorted(set(valid))
    remedy = did_you_mean(str(word), words) or remedy
    return Fault(path, f"{what} {one_of(str(word), words)}", shown(word), remedy)


def same_names(blocks: Sequence[object], key: str, what: str) -> Iterator[Fault]:
    """Find blocks of a list that are called as an earlier one.

    Parameters
    ----------
    blocks : as written
    key : of the list
    what : they are, such as ``boundary``
    """
    names = [block_in(block).get("name") for block in blocks]
    for number, name in enumerate(names):
        if isinstance(name, str) and (first := names.index(name)) < number:
            yield Fault.of(
                "protocol.name_taken", (key, number, "name"), name=name, other=f"{what} {first + 1}"
            )


class FaultsError(ValueError):
    """Faults of a value that its validator found; their paths begin at the value."""

    def __init__(self, *faults: Fault) -> None:
        self.faults = faults
        super().__init__(
            "\n".join(f"expected {x.expected}, found {x.found}. {x.remedy}" for x in faults)
        )


def refused(name: str, /, *, found: object, **facts: Any) -> FaultsError:
    """Make the error of a value that its validator refuses.

    Parameters
    ----------
    name, facts : of a template, see `Fault.of`
    found : the value as written
    """
    return FaultsError(Fault.of(name, found=shown(found), **facts))


def faults_of(error: ValidationError, data: object, keys: Iterable[str] = ()) -> list[Fault]:
    """Convert the errors of a block; those of inner blocks are faults already.

    Parameters
    ----------
    error : what pydantic found
    data : the block as it was validated
    keys : the valid keys of the block
    """
    valid_keys = list(keys)
    faults: list[Fault] = []
    for line in error.errors(include_url=False):
        path, inner = _path_in(data, line["loc"]), line.get("ctx", {}).get("error")
        if isinstance(inner, FaultsError):
            faults += [_moved(fault, path, data) for fault in inner.faults]
        else:
            faults.append(_fault_of(line, path, valid_keys))
    return faults


def _moved(fault: Fault, path: KeyPath, data: Any) -> Fault:
    """Put a fault of a part at its path in the whole, but not into a value in its short form."""
    full = (*path, *fault.path)
    for number, part in enumerate(full):
        if data is not _ABSENT and not isinstance(data, Mapping | list):
            return replace(fault, path=full[:number])
        data = _part_of(data, part)
    return replace(fault, path=full)


def _fault_of(line: ErrorDetails, path: KeyPath, keys: list[str]) -> Fault:
    context = line.get("ctx", {})
    match line["type"]:
        case "missing" | "union_tag_not_found":
            key = _quoted(context["discriminator"])[0] if context else str(line["loc"][-1])
            return Fault.of("protocol.no_key", path, key=key, missing=key)
        case "extra_forbidden":
            return replace(not_among(path, path[-1], keys, "one of the keys"), at="key")
        case "union_tag_invalid":
            path = (*path, _quoted(context["discriminator"])[0])
            return not_among(path, context["tag"], _quoted(context["expected_tags"]))
        case "literal_error":
            fault = not_among(path, line["input"], _quoted(context["expected"]))
            return replace(fault, at="key" if line["loc"][-1] == "[key]" else "value")
        case other:
            remedy = "Fill it in." if line["input"] is None else ""
            return Fault(path, _KINDS.get(other, line["msg"]), shown(line["input"]), remedy)


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _path_in(data: Any, location: tuple[int | str, ...]) -> KeyPath:
    """Strip parts of a pydantic location that are not in the YAML: union tags, missing keys."""
    path: list[str | int] = []
    for part in location:
        if (inner := _part_of(data, part)) is not _ABSENT:
            data = inner
            path.append(part)
    return tuple(path)


_ABSENT = object()


def _part_of(data: Any, part: int | str) -> object:
    is_item = isinstance(data, list) and isinstance(part, int) and part < len(data)
    return data[part] if is_item or (isinstance(data, Mapping) and part in data) else _ABSENT


@dataclass(slots=True)
class Spot:
    """Where a value is written, and everything in it.

    Parameters
    ----------
    file : name of the YAML file
    name : key or number of an item, as written
    key, value : beginning of each
    inner : spots of the keys of a block, or of the items of a list by their number
    """

    file: str
    name: str | int
    key: Mark
    value: Mark
    inner: dict[str | int, Spot] = field(default_factory=dict)


@dataclass(slots=True)
class Document:
    """The content of one YAML file.

    Parameters
    ----------
    spot : of the whole
    data : blocks as dict, lists as list, everything else as text or None
    faults : of the YAML itself
    """

    spot: Spot
    data: Any = None
    faults: list[PlacedFault] = field(default_factory=list)

    @property
    def block(self) -> Values:
        """Return the content; empty if it is no block of keys."""
        return block_in(self.data)

    def at(self, path: KeyPath) -> Any:
        """Find the value under a path of a value that is there."""
        node = self.data
        for part in path:
            node = node[part]
        return node

    def spot_at(self, path: KeyPath) -> tuple[Spot, KeyPath]:
        """Find the spot under a path, or of the innermost block around it; the path as written."""
        spot, written = self.spot, list[str | int]()
        for number, part in enumerate(path):
            if part not in spot.inner:
                return spot, (*written, *path[number:])
            spot = spot.inner[part]
            written.append(spot.name)
        return spot, tuple(written)

    def place(self, fault: Fault, remark: str = "") -> PlacedFault:
        """Add its position to a fault.

        Parameters
        ----------
        fault : a path that is not in the file means the block around it
        remark : added to the end
        """
        spot, path = self.spot_at(fault.path)
        mark = spot.key if fault.at == "key" else spot.value
        return _placed(spot.file, mark, replace(fault, path=path), remark)


def _placed(file: str, mark: Mark, fault: Fault, remark: str = "") -> PlacedFault:
    """Describe a fault with its line, column and dotted key."""
    key = ".".join(str(part) for part in fault.path)
    place = f"line {mark[0]}, column {mark[1]}" + (f" ({key})" if key else "")
    remedy = f"{fault.remedy} {remark}".strip()
    text = format_error(file, place, expected=fault.expected, found=fault.found, remedy=remedy)
    return file, mark, text.rstrip()


def error_of_faults(placed: Iterable[PlacedFault], *, code: str = "") -> ProtocolError:
    """Make one error of all faults of a file, a line each, in the order of the file."""
    return ProtocolError("\n".join(text for _, _, text in sorted(set(placed))), code=code)


def read_text(path: Path) -> str:
    """Read a YAML file as UTF-8 text.

    Parameters
    ----------
    path : the file

    Raises
    ------
    ProtocolError
        If there is no such file, or it is not text of at most 1 MB.
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
        found = (error.strerror or str(error)).lower()
        raise ProtocolError.about("protocol.no_yaml_file", path, found=found) from error


@lru_cache(maxsize=64)
def _composed(text: str) -> yaml.Node | None:
    """Compose the nodes of a text, cached for all tests of a protocol."""
    return yaml.compose(text, Loader=_LOADER)


def parse_yaml(text: str, file: str) -> Document:
    """Parse YAML text into plain values.

    Parameters
    ----------
    text : the content of the file
    file : its name, as in messages

    Returns
    -------
    The document, with faults that leave it readable, such as a repeated key.

    Raises
    ------
    ProtocolError
        If the text is not YAML.
    """
    try:
        node = _composed(text)
    except (yaml.YAMLError, UnicodeError, RecursionError) as error:
        raise _syntax_error(error, text, file) from error
    mark = (1, 1) if node is None else _mark(node)
    document = Document(Spot(file, "", mark, mark))
    if node is not None:
        document.data = _value(node, (), document, document.spot, set())
    return document


def _syntax_error(error: Exception, text: str, file: str) -> ProtocolError:
    """Make the error of what the YAML library refuses."""
    mark = getattr(error, "problem_mark", None)
    if mark is not None:
        line, column = mark.line + 1, mark.column + 1
    else:
        before = text[: getattr(error, "position", 0)]
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
    problem = getattr(error, "problem", None) or getattr(error, "reason", "") or "too many levels"
    context = getattr(error, "context", None) or ""
    place, found = f"line {line}, column {column}", f"{problem} {context}".strip()
    return ProtocolError.about("protocol.no_yaml", file, place, found=found)


def _value(node: yaml.Node, path: KeyPath, document: Document, spot: Spot, seen: set[int]) -> Any:
    """Convert a node to plain values; fill in the spots of everything in it."""
    fault = None
    if id(node) in seen:
        fault = Fault.of("protocol.alias", path)
    elif len(path) >= MAX_DEPTH:
        fault = Fault.of("protocol.too_deep", most=MAX_DEPTH)
    if fault is not None:
        raise error_of_faults([_placed(spot.file, _mark(node), fault)])
    seen.add(id(node))
    if node.tag not in _PLAIN_TAGS:
        fault = Fault.of("protocol.tag", path, tag=node.tag)
        document.faults.append(_placed(spot.file, _mark(node), fault))
    if isinstance(node, yaml.MappingNode):
        return _block(node, path, document, spot, seen)
    if isinstance(node, yaml.SequenceNode):
        for number, item in enumerate(node.value):
            spot.inner[number] = Spot(spot.file, number, _mark(item), _mark(item))
        return [
            _value(item, (*path, number), document, spot.inner[number], seen)
            for number, item in enumerate(node.value)
        ]
    is_quoted = isinstance(node, yaml.ScalarNode) and node.style
    return node.value if is_quoted or node.value not in ("", "~", "null") else None


def _block(
    node: yaml.MappingNode, path: KeyPath, document: Document, spot: Spot, seen: set[int]
) -> dict[str, object]:
    block: dict[str, object] = {}
    for key, value in node.value:
        name, fault = key.value, None
        if not isinstance(key, yaml.ScalarNode):
            fault = Fault.of("protocol.no_word_as_key", path, found=shown(name))
        elif name in block:
            line = spot.inner[name].key[0]
            fault = Fault.of("protocol.key_again", (*path, name), key=name, line=line)
        if fault is not None:
            document.faults.append(_placed(spot.file, _mark(key), fault))
            continue
        spot.inner[name] = Spot(spot.file, name, _mark(key), _mark(value))
        block[name] = _value(value, (*path, name), document, spot.inner[name], seen)
    return block


def _mark(node: yaml.Node) -> Mark:
    start = node.start_mark
    return (start.line + 1, start.column + 1) if start else (1, 1)
