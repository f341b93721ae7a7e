"""Parse YAML text into plain values with their positions.

Unquoted words remain text: YAML 1.1 would convert the test name ``0333`` to the number 333, and
``no`` to *false*. The key decides the type of a value. Aliases, tags and repeated keys are refused,
because people read protocols.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import yaml
from yaml.composer import Composer

from labpipe.errors import Fault, KeyPath, ProtocolError, error_text
from labpipe.protocol.faults import shown

if TYPE_CHECKING:
    from yaml import BaseLoader as _Parser
else:
    _Parser = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader

Mark: TypeAlias = tuple[int, int]
"""Line and column, counted from 1."""
PlacedFault: TypeAlias = tuple[str, Mark, str]
"""A fault, ready to be listed with others: file, position and the whole message."""
_PLAIN_TAGS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map"))
_NOTHING = ("", "~", "null")


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

    def at(self, path: KeyPath) -> Any:
        """Find the value under a path.

        Parameters
        ----------
        path : of a value that is there
        """
        node = self.data
        for part in path:
            node = node[part]
        return node

    def spot_at(self, path: KeyPath) -> tuple[Spot, KeyPath]:
        """Find the spot under a path, or of the innermost block around it; the path as written.

        Parameters
        ----------
        path : perhaps of a value that is not in the file
        """
        spot, written = self.spot, list[str | int]()
        for number, part in enumerate(path):
            inner = spot.inner.get(part)
            if inner is None:
                return spot, (*written, *path[number:])
            spot = inner
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
        return place_fault(spot.file, mark, replace(fault, path=path), remark)


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
    remedy = f"{fault.remedy} {remark}".strip()
    text = error_text(file, place, expected=fault.expected, found=fault.found, remedy=remedy)
    return file, mark, text.rstrip()


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
    max_bytes = 1_000_000
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise OSError(errno.EINVAL, "a pipe or a device")
        if path.is_file() and (size := path.stat().st_size) > max_bytes:
            raise OSError(errno.EFBIG, f"one of {size / 1e6:.0f} megabytes")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        place, found = f"byte {error.start}", f"the byte 0x{error.object[error.start]:02x}"
        remedy = "Save it as UTF-8."
        text = error_text(path, place, expected="UTF-8 text", found=found, remedy=remedy)
        raise ProtocolError(text) from error
    except OSError as error:
        found, remedy = (error.strerror or str(error)).lower(), "Check the name and the folder."
        text = error_text(path, "", expected="a YAML file", found=found, remedy=remedy)
        raise ProtocolError(text) from error


class _HardToReadError(Exception):
    """Valid YAML that is refused because it is hard to read: its event and the fault."""


class _StrictComposer(Composer):
    """Refuses aliases and deep nesting."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        max_depth = 16
        event: yaml.Event = self.peek_event()  # type: ignore[attr-defined]
        if isinstance(event, yaml.AliasEvent):
            found = f"the alias '*{event.anchor}'"
            raise _HardToReadError(event, Fault((), "a value", found, "Write it out."))
        if self.depth >= max_depth:
            fault = Fault((), f"at most {max_depth} levels", "more", "Write it in fewer levels.")
            raise _HardToReadError(event, fault)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Loader(_StrictComposer, _Parser):
    """Composes the nodes of a text."""

    def __init__(self, text: str) -> None:
        _Parser.__init__(self, text)
        Composer.__init__(self)


@lru_cache(maxsize=64)
def _composed(text: str) -> yaml.Node | None:
    """Compose the nodes of a text, cached for all tests of a protocol."""
    return yaml.compose(text, Loader=_Loader)


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
    except _HardToReadError as error:
        event, fault = error.args
        raise ProtocolError(place_fault(file, _mark(event), fault)[2]) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise ProtocolError(_syntax(error, text, file)) from error
    mark = (1, 1) if node is None else _mark(node)
    document = Document(Spot(file, "", mark, mark))
    if node is not None:
        document.data = _value(node, (), document.spot, document.faults)
    return document


def _syntax(error: Exception, text: str, file: str) -> str:
    """Describe an error of the YAML library."""
    mark = getattr(error, "problem_mark", None)
    if mark is not None:
        place = f"line {mark.line + 1}, column {mark.column + 1}"
    else:
        before = text[: getattr(error, "position", 0)]
        place = f"line {before.count(chr(10)) + 1}, column {len(before) - before.rfind(chr(10))}"
    problem = getattr(error, "problem", None) or getattr(error, "reason", "") or "something else"
    context = getattr(error, "context", None)
    found = f"text that is none ({problem}{f' {context}' if context else ''})"
    remedy = "Look at this line and the one before it: indentation, ':' and brackets."
    return error_text(file, place, expected="YAML", found=found, remedy=remedy)


def _value(node: yaml.Node, path: KeyPath, spot: Spot, faults: list[PlacedFault]) -> object:
    """Convert a node to plain values; fill in the spots of everything in it."""

    def refuse(place: yaml.Node, fault: Fault) -> None:
        faults.append(place_fault(spot.file, _mark(place), fault))

    if node.tag not in _PLAIN_TAGS:
        found = f"the tag {node.tag!r}"
        refuse(node, Fault(path, "a plain value", found, "Leave the tag out."))
    if isinstance(node, yaml.SequenceNode):
        marks = [_mark(item) for item in node.value]
        spot.inner = {i: Spot(spot.file, i, mark, mark) for i, mark in enumerate(marks)}
        items = enumerate(node.value)
        return [_value(item, (*path, i), spot.inner[i], faults) for i, item in items]
    if not isinstance(node, yaml.MappingNode):
        is_plain = isinstance(node, yaml.ScalarNode) and not node.style
        return None if is_plain and node.value in _NOTHING else node.value
    block: dict[str, object] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            refuse(key, Fault(path, "a word as key", shown(key.value), "Write 'key: value'."))
            continue
        name, here = key.value, (*path, key.value)
        if name in block:
            found = f"{name!r} again (first in line {spot.inner[name].key[0]})"
            refuse(key, Fault(here, "each key once", found))
            continue
        spot.inner[name] = Spot(spot.file, name, _mark(key), _mark(value))
        block[name] = _value(value, here, spot.inner[name], faults)
    return block


def _mark(place: yaml.Node | yaml.Event) -> Mark:
    start = place.start_mark
    return (start.line + 1, start.column + 1) if start else (1, 1)
