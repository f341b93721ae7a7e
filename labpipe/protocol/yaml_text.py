"""Parse YAML text into plain values with their positions.

Unquoted words remain text: YAML 1.1 would convert the test name ``0333`` to the number 333, and
``no`` to *false*. The key decides the type of a value. Aliases, tags and repeated keys are refused,
because people read protocols.
"""

from __future__ import annotations

import errno
import re
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import yaml
from yaml.composer import Composer

from labpipe.errors import Fault, KeyPath, ProtocolError, error_text
from labpipe.protocol.faults import shown

Mark: TypeAlias = tuple[int, int]
"""Line and column, counted from 1."""
_PLAIN_TAGS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map"))
_NOTHING = ("", "~", "null")
_AMBIGUOUS_YAML = re.compile(r"[!?\t\r\x85\u2028\u2029\ufeff]|:\s*[]},]|[|>][-+\d]*#|---\s*\Z")
"""Text that libyaml and the Python parser read differently: some characters, a key without a value
in brackets, a comment directly after a block indicator, nothing after three dashes."""


@dataclass(frozen=True, slots=True)
class YamlPosition:
    """The position of a key and its value.

    Parameters
    ----------
    file : name of the YAML file
    key, value : beginning of each
    """

    file: str
    key: Mark
    value: Mark


@dataclass(frozen=True, slots=True)
class PlacedFault:
    """One fault, placed, ready to be listed with others.

    Parameters
    ----------
    file : name of the YAML file
    mark : line and column
    text : the whole message
    """

    file: str
    mark: Mark
    text: str


@dataclass(slots=True)
class Document:
    """The content of one YAML file.

    Parameters
    ----------
    file : its name, as in messages
    data : blocks as dict, lists as list, everything else as text or None
    spots : position of each value
    faults : of the YAML itself
    numbers : by path of a list from which items were removed, the original numbers of the others
    """

    file: str
    data: object = None
    spots: dict[KeyPath, YamlPosition] = field(default_factory=dict)
    faults: list[PlacedFault] = field(default_factory=list)
    numbers: dict[KeyPath, tuple[int, ...]] = field(default_factory=dict)

    def at(self, path: KeyPath) -> object:
        """Find the value under a path.

        Parameters
        ----------
        path : of a value that is there
        """
        node: Any = self.data
        for part in path:
            node = node[part]
        return node

    def place(self, fault: Fault, remark: str = "") -> PlacedFault:
        """Add its position to a fault.

        Parameters
        ----------
        fault : a path that is not in the file means the block around it
        remark : added to the end
        """
        path = fault.path
        while path not in self.spots:
            path = path[:-1]
        spot = self.spots[path]
        mark = spot.key if fault.at == "key" else spot.value
        return place_fault(
            spot.file, mark, replace(fault, path=self._as_written(fault.path)), remark
        )

    def _as_written(self, path: KeyPath) -> KeyPath:
        """Replace numbers of list items by those in the file."""
        numbers = ((part, self.numbers.get(path[:i])) for i, part in enumerate(path))
        return tuple(
            written[part] if written is not None and isinstance(part, int) else part
            for part, written in numbers
        )


def place_fault(file: str, mark: Mark, fault: Fault, remark: str = "") -> PlacedFault:
    """Describe a fault with its line, column and dotted key.

    Parameters
    ----------
    file : name of the YAML file
    mark : line and column
    fault : what is wrong
    remark : added to the end
    """
    key = ".".join(str(part) for part in fault.path)
    place = f"line {mark[0]}, column {mark[1]}" + (f" ({key})" if key else "")
    remedy = " ".join(part for part in (fault.remedy, remark) if part)
    text = error_text(file, place, expected=fault.expected, found=fault.found, remedy=remedy)
    return PlacedFault(file, mark, text.rstrip())


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
        _require_readable(path)
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        actual = f"the byte 0x{error.object[error.start]:02x}"
        remedy = "Save it as UTF-8."
        text = error_text(
            path, f"byte {error.start}", expected="UTF-8 text", found=actual, remedy=remedy
        )
        raise ProtocolError(text) from error
    except OSError as error:
        actual = (error.strerror or str(error)).lower()
        remedy = "Check the name and the folder."
        text = error_text(path, "", expected="a YAML file", found=actual, remedy=remedy)
        raise ProtocolError(text) from error


def _require_readable(path: Path) -> None:
    """Refuse devices, and files that are too large."""
    max_bytes = 1_000_000
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(errno.EINVAL, "a pipe or a device")
    if path.is_file() and path.stat().st_size > max_bytes:
        raise OSError(errno.EFBIG, f"one of {path.stat().st_size / 1e6:.0f} megabytes")


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
    document = Document(file)
    node = _compose(text, file)
    if node is None:
        document.spots[()] = YamlPosition(file, (1, 1), (1, 1))
    else:
        document.spots[()] = YamlPosition(file, _mark(node), _mark(node))
        document.data = _value(node, (), document)
    return document


class _Composer(Composer):
    """Refuses aliases and deep nesting."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        max_depth = 16
        event: yaml.Event = self.peek_event()  # type: ignore[attr-defined]
        if isinstance(event, yaml.AliasEvent):
            actual = f"the alias '*{event.anchor}'"
            raise _AmbiguousYamlError(event, Fault((), "a value", actual, "Write it out."))
        if self.depth >= max_depth:
            remedy = "Write it in fewer levels."
            raise _AmbiguousYamlError(
                event, Fault((), f"at most {max_depth} levels", "more", remedy)
            )
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _AmbiguousYamlError(Exception):
    """Valid YAML that is refused because it is hard to read."""


class _Loader(_Composer, yaml.BaseLoader):
    """The Python parser, which describes syntax errors."""


_QuickLoader: type[yaml.BaseLoader] | type[yaml.CBaseLoader] = _Loader
if yaml.__with_libyaml__:

    class _LibyamlLoader(_Composer, yaml.CBaseLoader):
        """The libyaml parser, seven times as fast."""

        def __init__(self, text: str) -> None:
            yaml.CBaseLoader.__init__(self, text)
            Composer.__init__(self)

    _QuickLoader = _LibyamlLoader


@lru_cache(maxsize=64)
def _quickly_composed(text: str) -> tuple[yaml.Node | None] | None:
    """Compose the nodes of a text, cached for all tests of a protocol; None if it has faults."""
    if _AMBIGUOUS_YAML.search(text):
        return None
    try:
        return (yaml.compose(text, Loader=_QuickLoader),)
    except (yaml.YAMLError, _AmbiguousYamlError, UnicodeError):
        return None


def _compose(text: str, file: str) -> yaml.Node | None:
    if quick := _quickly_composed(text):
        return quick[0]
    try:
        return yaml.compose(text, Loader=_Loader)
    except _AmbiguousYamlError as error:
        event, fault = error.args
        raise ProtocolError(place_fault(file, _mark(event), fault).text) from error
    except yaml.YAMLError as error:
        raise ProtocolError(_syntax(error, text, file)) from error


def _syntax(error: yaml.YAMLError, text: str, file: str) -> str:
    """Describe an error of the YAML library."""
    mark = getattr(error, "problem_mark", None)
    if mark is not None:
        place = f"line {mark.line + 1}, column {mark.column + 1}"
    else:
        before = text[: getattr(error, "position", 0)]
        place = f"line {before.count(chr(10)) + 1}, column {len(before) - before.rfind(chr(10))}"
    problem = getattr(error, "problem", None) or getattr(error, "reason", "") or "something else"
    context = getattr(error, "context", None)
    actual = f"text that is none ({problem}{f' {context}' if context else ''})"
    remedy = "Look at this line and the one before it: indentation, ':' and brackets."
    return error_text(file, place, expected="YAML", found=actual, remedy=remedy)


def _value(node: yaml.Node, path: KeyPath, document: Document) -> object:
    if node.tag not in _PLAIN_TAGS:
        fault = Fault(path, "a plain value", f"the tag {node.tag!r}", "Leave the tag out.")
        document.faults.append(place_fault(document.file, _mark(node), fault))
    if isinstance(node, yaml.MappingNode):
        return _block(node, path, document)
    if isinstance(node, yaml.SequenceNode):
        items = []
        for number, item in enumerate(node.value):
            item_path = (*path, number)
            document.spots[item_path] = YamlPosition(document.file, _mark(item), _mark(item))
            items.append(_value(item, item_path, document))
        return items
    is_plain = isinstance(node, yaml.ScalarNode) and not node.style
    return None if is_plain and node.value in _NOTHING else node.value


def _block(node: yaml.MappingNode, path: KeyPath, document: Document) -> dict[str, object]:
    block: dict[str, object] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            fault = Fault(path, "a word as key", shown(key.value), "Write 'key: value'.")
            document.faults.append(place_fault(document.file, _mark(key), fault))
            continue
        key_path = (*path, key.value)
        if key.value in block:
            first = document.spots[key_path].key[0]
            fault = Fault(key_path, "each key once", f"{key.value!r} again (first in line {first})")
            document.faults.append(place_fault(document.file, _mark(key), fault))
            continue
        document.spots[key_path] = YamlPosition(document.file, _mark(key), _mark(value))
        block[key.value] = _value(value, key_path, document)
    return block


def _mark(place: yaml.Node | yaml.Event) -> Mark:
    start = place.start_mark
    return (start.line + 1, start.column + 1) if start else (1, 1)
