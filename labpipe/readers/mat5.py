"""MAT files of version 5: their variables as plain structs, text and arrays.

Used instead of scipy.io.loadmat, which crashes the process (segmentation fault, scipy 1.17) on some
damaged files. Layout: MathWorks, *MAT-File Format*, level 5.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

Node = Any
"""A struct array as a list of mappings, text, an array, or None for unused types."""

_MATRIX, _COMPRESSED = 14, 15
_NUMERIC = range(6, 16)
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_NUMBERS |= {12: "i8", 13: "u8"}
_TEXT = {1: "latin-1", 2: "latin-1", 16: "utf-8"}


@dataclass(slots=True)
class _Cursor:
    """A position in the elements of a file, with the byte order of the file."""

    data: memoryview
    order: str
    at: int = 0

    def element(self) -> tuple[int, memoryview]:
        """Return type and bytes of the next element, and advance past its padding."""
        if self.at + 8 > len(self.data):
            message = f"ends after {len(self.data)} bytes, within the tag of an element"
            raise ValueError(message)
        kind, size = struct.unpack_from(self.order + "II", self.data, self.at)
        start, padded = self.at + 8, 8
        if kind >> 16:  # small element: one word with size and type, then its data
            size, kind, start = kind >> 16, kind & 0xFFFF, self.at + 4
        elif kind != _COMPRESSED:
            padded += -(-size // 8) * 8
        else:
            padded += size
        if start + size > len(self.data):
            message = f"an element of {size} bytes with {len(self.data) - start} bytes left"
            raise ValueError(message)
        self.at = min(self.at + padded, len(self.data))
        return kind, self.data[start : start + size]

    def numbers(self) -> np.ndarray:
        """Return the numbers of the next element, in the type in which they are stored."""
        kind, data = self.element()
        if kind not in _NUMBERS:
            message = f"type {kind} instead of numbers"
            raise ValueError(message)
        array: np.ndarray = np.frombuffer(data, dtype=self.order + _NUMBERS[kind])
        return array

    def inside(self, data: memoryview) -> _Cursor:
        """Return a cursor over the parts of an element."""
        return _Cursor(data, self.order)


def parse_mat5(content: bytes) -> dict[str, Node]:
    """Read the variables of a MAT file of version 5.

    Parameters
    ----------
    content : the whole file

    Returns
    -------
    Variables by name. A struct is a list of mappings (one per element of the struct array), text
    is text (of one row), numbers are an array of shape (n,) in the type in which they are
    stored. Sparse, complex, function and opaque variables are None.

    Raises
    ------
    ValueError, struct.error, zlib.error, LookupError
        If the file is cut off or damaged.
    """
    header_bytes = 128
    order = ">" if content[126:128] == b"MI" else "<"
    cursor = _Cursor(memoryview(content), order, header_bytes)
    variables: dict[str, Node] = {}
    while cursor.at < len(content):
        kind, data = cursor.element()
        if kind == _COMPRESSED:
            kind, data = cursor.inside(memoryview(zlib.decompress(data))).element()
        if kind == _MATRIX:
            name, value = _matrix(cursor.inside(data))
            variables[name] = value
    return variables


def _matrix(cursor: _Cursor) -> tuple[str, Node]:
    """Return name and value of one array; an array of no bytes is empty."""
    cell, struct_, object_, char = 1, 2, 3, 4
    complex_flag = 0x0800
    if not len(cursor.data):
        return "", np.empty(0)
    flags = int(cursor.numbers()[0])
    count = int(np.prod([int(n) for n in cursor.numbers()], dtype=object))
    _, name = cursor.element()
    kind = flags & 0xFF
    value: Node = None
    if kind == object_:
        cursor.element()  # its class name
    if kind in {struct_, object_}:
        value = _structs(cursor, count)
    elif kind == cell:
        value = [_part(cursor) for _ in range(_bounded(count, cursor))]
    elif kind == char:
        value = _text(cursor)
    elif kind in _NUMERIC and not flags & complex_flag:
        value = _array(cursor, count)
    return bytes(name).decode("latin-1"), value


def _part(cursor: _Cursor) -> Node:
    kind, data = cursor.element()
    if kind != _MATRIX:
        message = f"type {kind} instead of an array"
        raise ValueError(message)
    return _matrix(cursor.inside(data))[1]


def _structs(cursor: _Cursor, count: int) -> list[dict[str, Node]]:
    """Return the elements of a struct array, each with its fields in order."""
    width = int(cursor.numbers()[0])
    _, names = cursor.element()
    packed = bytes(names)
    if not packed or width < 1:
        return []
    keys = [packed[i : i + width].split(b"\0")[0] for i in range(0, len(packed), width)]
    fields = [key.decode("latin-1") for key in keys]
    return [{field: _part(cursor) for field in fields} for _ in range(_bounded(count, cursor))]


def _bounded(count: int, cursor: _Cursor) -> int:
    """Return a count of parts if there are eight bytes for each of them."""
    if not 0 <= count <= len(cursor.data) // 8:
        message = f"{count} parts in {len(cursor.data)} bytes"
        raise ValueError(message)
    return count


def _text(cursor: _Cursor) -> str:
    kind, data = cursor.element()
    if kind in {4, 17}:
        name = "utf-16-le" if cursor.order == "<" else "utf-16-be"
        return bytes(data).decode(name, errors="replace")
    return bytes(data).decode(_TEXT[kind], errors="replace")


def _array(cursor: _Cursor, count: int) -> np.ndarray:
    values = cursor.numbers()
    if len(values) != count:
        message = f"{len(values)} numbers instead of {count}"
        raise ValueError(message)
    return values
