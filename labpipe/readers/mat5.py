"""Read MAT files of version 5: their variables as plain structs, text and arrays.

Used instead of scipy.io.loadmat, which crashes the process (segmentation fault, scipy 1.17) on some
damaged files. Layout: MathWorks, *MAT-File Format*, level 5.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

MatValue = Any
"""Struct array or object as a list of mappings, cell array as a list, text, numeric array, or
None."""

_MATRIX_TYPE, _COMPRESSED_TYPE = 14, 15
_NUMERIC_CLASSES = range(6, 16)
_NUMBER_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_NUMBER_DTYPES |= {12: "i8", 13: "u8"}
_TEXT_ENCODINGS = {1: "latin-1", 2: "latin-1", 16: "utf-8"}
_UTF16_TYPES = {4, 17}


@dataclass(slots=True)
class _Cursor:
    """Position in the elements of a file, with the byte order of the file."""

    data: memoryview
    byte_order: str
    offset: int = 0

    def element(self) -> tuple[int, memoryview]:
        """Return type and bytes of the next element, and advance past its padding."""
        if self.offset + 8 > len(self.data):
            message = f"data end after {len(self.data)} bytes, within the tag of an element"
            raise ValueError(message)
        data_type, size = struct.unpack_from(self.byte_order + "II", self.data, self.offset)
        start, total_size = self.offset + 8, 8
        # small element: one word with size and type, then up to four bytes of data
        if data_type >> 16:
            size, data_type, start = data_type >> 16, data_type & 0xFFFF, self.offset + 4
        elif data_type != _COMPRESSED_TYPE:
            total_size += -(-size // 8) * 8
        else:
            total_size += size
        if start + size > len(self.data):
            available = len(self.data) - start
            message = f"an element needs {size} bytes, but only {available} are left"
            raise ValueError(message)
        self.offset = min(self.offset + total_size, len(self.data))
        return data_type, self.data[start : start + size]

    def numbers(self) -> np.ndarray:
        """Return the numbers of the next element, in the type in which they are stored."""
        data_type, data = self.element()
        if data_type not in _NUMBER_DTYPES:
            message = f"type {data_type} instead of numbers"
            raise ValueError(message)
        array: np.ndarray = np.frombuffer(data, dtype=self.byte_order + _NUMBER_DTYPES[data_type])
        return array

    def nested(self, data: memoryview) -> _Cursor:
        """Return a cursor over the elements nested in an element."""
        return _Cursor(data, self.byte_order)


def parse_mat5(content: bytes) -> dict[str, MatValue]:
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
    byte_order = ">" if content[126:128] == b"MI" else "<"
    cursor = _Cursor(memoryview(content), byte_order, header_bytes)
    variables: dict[str, MatValue] = {}
    while cursor.offset < len(content):
        data_type, data = cursor.element()
        if data_type == _COMPRESSED_TYPE:
            data_type, data = cursor.nested(memoryview(zlib.decompress(data))).element()
        if data_type == _MATRIX_TYPE:
            name, value = _matrix(cursor.nested(data))
            variables[name] = value
    return variables


def _matrix(cursor: _Cursor) -> tuple[str, MatValue]:
    """Return name and value of an array; an element without data is an unnamed empty array."""
    cell, struct_, object_, char = 1, 2, 3, 4
    complex_flag = 0x0800
    if not len(cursor.data):
        return "", np.empty(0)
    flags = int(cursor.numbers()[0])
    count = int(np.prod([int(n) for n in cursor.numbers()], dtype=object))
    _, name = cursor.element()
    array_class = flags & 0xFF
    value: MatValue = None
    if array_class == object_:
        cursor.element()  # its class name
    if array_class in {struct_, object_}:
        value = _structs(cursor, count)
    elif array_class == cell:
        value = [_nested_array(cursor) for _ in range(_checked_count(count, cursor))]
    elif array_class == char:
        value = _text(cursor)
    elif array_class in _NUMERIC_CLASSES and not flags & complex_flag:
        value = _array(cursor, count)
    return bytes(name).decode("latin-1"), value


def _nested_array(cursor: _Cursor) -> MatValue:
    data_type, data = cursor.element()
    if data_type != _MATRIX_TYPE:
        message = f"type {data_type} instead of an array"
        raise ValueError(message)
    return _matrix(cursor.nested(data))[1]


def _structs(cursor: _Cursor, count: int) -> list[dict[str, MatValue]]:
    """Return the elements of a struct array, each with its fields in order."""
    width = int(cursor.numbers()[0])
    _, names = cursor.element()
    packed = bytes(names)
    if not packed or width < 1:
        return []
    keys = [packed[i : i + width].split(b"\0")[0] for i in range(0, len(packed), width)]
    fields = [key.decode("latin-1") for key in keys]
    return [
        {field: _nested_array(cursor) for field in fields}
        for _ in range(_checked_count(count, cursor))
    ]


def _checked_count(count: int, cursor: _Cursor) -> int:
    """Return the count, or raise if the data have fewer than eight bytes per element."""
    if not 0 <= count <= len(cursor.data) // 8:
        message = f"{count} elements in {len(cursor.data)} bytes"
        raise ValueError(message)
    return count


def _text(cursor: _Cursor) -> str:
    data_type, data = cursor.element()
    if data_type in _UTF16_TYPES:
        encoding = "utf-16-le" if cursor.byte_order == "<" else "utf-16-be"
        return bytes(data).decode(encoding, errors="replace")
    return bytes(data).decode(_TEXT_ENCODINGS[data_type], errors="replace")


def _array(cursor: _Cursor, count: int) -> np.ndarray:
    values = cursor.numbers()
    if len(values) != count:
        message = f"{len(values)} numbers instead of {count}"
        raise ValueError(message)
    return values
