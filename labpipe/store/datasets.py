"""Arrays and texts of a result file: written in compressed chunks, read as the layout says.

HDF5's own filters run on one processor. The chunks are made here instead, on all of them, byte for
byte in the format of those filters (shuffle, gzip, fletcher32), so that any HDF5 library reads
them. ISA-L deflates six to nine times as fast as zlib at the same size, into the same format.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import repeat
from math import ceil, prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5ds, h5s
from isal import isal_zlib
from numpy.typing import NDArray

from labpipe.errors import StoreError, error_text
from labpipe.records.arrays import Ints
from labpipe.store import layout
from labpipe.store.hdf5_objects import (
    LEVEL,
    get_text,
    has_attribute,
    is_empty,
    make_dataset,
    set_text,
    set_texts,
)
from labpipe.store.layout import Field, Table
from labpipe.store.replace import is_cut_off

CHUNK_BYTES = 1 << 18
_WORTH_A_THREAD = 1 << 15
"""Bytes; fewer are deflated before a thread has woken up."""
_MODULUS = 65535


Packed = dict[tuple[object, ...], list[bytes]]
"""Chunks made so far, by the place of their array."""


def _deflated(array: NDArray[Any], rows: int, pool: Executor, packed: Packed) -> list[bytes]:
    """Chunks of so many rows of an array, made in the pool unless they have been made before."""
    place = place_of(array)
    if place not in packed:
        starts = range(0, len(array) if array.size else 0, rows)
        blocks = (array[start : start + rows] for start in starts)
        every = map if array.nbytes < _WORTH_A_THREAD else pool.map
        packed[place] = list(every(_packed, blocks, repeat(rows)))
    return packed[place]


def place_of(array: NDArray[Any]) -> tuple[object, ...]:
    """Where in memory an array lies and how; two arrays alive with the same place are the same."""
    return (array.ctypes.data, array.shape, array.strides, array.dtype.str)


def chunk_shape(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Shape of a chunk: whole rows, about `CHUNK_BYTES` of them, never more than there are."""
    rest = tuple(max(size, 1) for size in shape[1:])
    rows = max(CHUNK_BYTES // (itemsize * prod(rest)), 1)
    return (max(min(rows, shape[0]), 1), *rest)


def same_content(dataset: Any, array: NDArray[Any]) -> bool:
    """Whether a dataset reads back as exactly this array, NaN patterns included.

    Of a long dataset the first chunk, the last, and every sixteenth are taken through HDF5's
    filters: they show that the chunks are made as HDF5 makes them. That every byte is on the disk
    is for `write_result` to compare.
    """
    if dataset.shape != array.shape or dataset.dtype != array.dtype:
        return False
    rows = dataset.chunks[0]
    if 0 < len(array) <= rows:
        found = np.empty_like(array, order="C")
        dataset.id.read(h5s.ALL, h5s.ALL, found)
        return found.tobytes() == array.tobytes()
    starts = list(range(0, len(array) if array.size else 0, rows))
    return all(
        dataset[start : start + rows].tobytes() == array[start : start + rows].tobytes()
        for start in {*starts[::16], *starts[-1:]}
    )


def _packed(block: NDArray[Any], rows: int) -> bytes:
    """Run one chunk through HDF5's filters shuffle, gzip and fletcher32.

    The last chunk of an array is filled up with zeros to so many rows, as HDF5 wants it.
    """
    missing = np.zeros((rows - len(block), *block.shape[1:]), block.dtype)
    block = np.concatenate([block, missing]) if len(missing) else np.ascontiguousarray(block)
    planes = block.view(np.uint8).reshape(-1, block.dtype.itemsize).T
    deflated = isal_zlib.compress(np.ascontiguousarray(planes).data, LEVEL)
    return deflated + fletcher32(deflated).to_bytes(4, "little")


def fletcher32(data: bytes) -> int:
    """Checksum of some bytes as HDF5 counts it.

    Parameters
    ----------
    data : any number of bytes

    Returns
    -------
    Two sums of 16 bits: the words (big-endian, an odd last byte as the upper half of a word), and
    the running totals of that sum, both modulo 65535.

    Notes
    -----
    H5_checksum_fletcher32 of the HDF5 library folds its sums end around, so that a multiple of
    65535 other than nothing at all is left as 65535 and not as 0.

    Examples
    --------
    >>> hex(fletcher32(bytes([1, 2, 3])))
    '0x5040402'
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), dtype=">u2").astype(np.int64)
    first = int(words.sum())
    # the weights stay below 2**47 for a chunk: no overflow in the sum of products
    second = int(words @ np.arange(len(words), 0, -1))
    first, second = (total % _MODULUS or (_MODULUS if total else 0) for total in (first, second))
    return second << 16 | first


def string_array(texts: tuple[str, ...]) -> NDArray[Any]:
    """Texts as bytes of UTF-8, as wide as the longest, in the one kind that all programs read.

    They are declared ASCII, which Octave reads (see `layout`), and end in a zero, up to
    which h5dump shows them. One byte wide, they would be single characters to the netCDF library.
    """
    encoded = [text.encode() for text in texts]
    longest = max([1, *(len(text) for text in encoded)])
    return np.array(encoded, dtype=f"S{longest + 1}")


@dataclass(frozen=True, slots=True)
class Target:
    """An open group, the threads that deflate, and what has been written so far.

    Parameters
    ----------
    group : open HDF5 group
    pool : threads that deflate the chunks
    written : arrays by dataset, to verify the file by
    packed : chunks of these arrays, which must still be alive: the same time axis is in several
        groups, and is deflated once
    made : datasets of this group, with their axes
    """

    group: Any
    pool: Executor
    written: dict[str, NDArray[Any]] = field(default_factory=dict)
    packed: Packed = field(default_factory=dict)
    made: dict[str, tuple[Any, Field]] = field(default_factory=dict)

    def inside(self, name: str) -> Target:
        """Make a group in this one, if it is not there."""
        return Target(self.group.require_group(name), self.pool, self.written, self.packed)

    def array(self, name: str, values: NDArray[Any], kind: Field, unit: str = "") -> Any:
        """Write an array of numbers as a chunked dataset with its unit and axes.

        Parameters
        ----------
        name : of the dataset, free in this group
        values : any shape and number type, axis 0 is the one that is cut into chunks
        kind : axes and unit, which become attributes
        unit : counts where the layout leaves the unit open

        Returns
        -------
        The dataset.

        Notes
        -----
        NaN and its bit patterns are kept. An array without elements has no chunks to write.
        """
        chunk = chunk_shape(values.shape, values.dtype.itemsize)
        dataset = make_dataset(self.group, name, values, chunk)
        set_text(dataset, "unit", kind.unit or unit)
        set_text(dataset, "axes", ", ".join(kind.axes))
        for number, deflated in enumerate(_deflated(values, chunk[0], self.pool, self.packed)):
            corner = (number * chunk[0],) + (0,) * (len(chunk) - 1)
            dataset.id.write_direct_chunk(corner, deflated)
        self.written[dataset.name] = values
        self.made[name] = dataset, kind
        return dataset

    def strings(self, name: str, texts: tuple[str, ...], axis: str) -> None:
        """Write a dataset of strings."""
        self.array(name, string_array(texts), Field((axis,), layout.TEXT))

    def columns(self, kind: Table, rows: Sequence[Sequence[Any]], unit: str = "") -> None:
        """Write a table into this group.

        Parameters
        ----------
        kind : its columns
        rows : any number, each with a cell per column
        unit : of the columns whose unit the layout leaves open
        """
        for place, (column, each) in enumerate(kind.columns.items()):
            cells = [row[place] for row in rows]
            is_text = each.dtype == "text"
            values = string_array(tuple(cells)) if is_text else np.array(cells, each.dtype)
            self.array(column, values, each, unit)
        self.scaled({kind.axis: kind.scale})

    def scaled(self, scales: Mapping[str, str]) -> None:
        """Give every axis of the arrays of this group its dimension scale, as netCDF-4 wants it.

        Parameters
        ----------
        scales : dataset or link of this group by axis; any other axis gets a dataset of its own
            name, with the words of `layout.COORDINATES` or numbers from 0
        """
        opened_scales: dict[str, Any] = {}
        for name, (dataset, kind) in list(self.made.items()):
            if name in scales.values():
                continue  # a scale has no scales
            for place, axis in enumerate(kind.axes):
                scale = scales.get(axis, axis)
                again = kind.axes[:place].count(axis)
                own = f"{scale}_{again + 1}" if again else scale  # xarray wants each name once
                if own not in opened_scales:
                    opened_scales[own] = self._scale(own, scale, axis, dataset.shape[place])
                self.attach(dataset, place, opened_scales[own])

    def _scale(self, name: str, scale: str, axis: str, size: int) -> Any:
        """Open a dimension scale, or make one."""
        if name in self.group:
            return self.group[name]
        if name != scale:
            same, kind = self.made[scale]
            return self.array(name, self.written[same.name], kind)
        words = layout.COORDINATES.get(axis)
        if words is not None:
            return self.array(name, string_array(words), Field((axis,), layout.TEXT))
        return self.array(name, np.arange(size), Field((axis,), "1"))

    def attach(self, dataset: Any, place: int, scale: Any) -> None:
        """Make a dataset the dimension scale of an axis of another one.

        Parameters
        ----------
        dataset : open
        place : of the axis, from 0
        scale : open dataset with as many values
        """
        if not h5ds.is_scale(scale.id):
            h5ds.set_scale(scale.id, scale.name.rpartition("/")[2].encode())
        h5ds.attach_scale(dataset.id, scale.id, place)

    def fields(self, record: object, kinds: Any) -> None:
        """Write those fields of a record that are arrays, each as the layout says."""
        for name, kind in kinds.items():
            self.array(name, getattr(record, name), kind)

    def texts(self, name: str, values: tuple[str, ...]) -> None:
        """Write an attribute that is a list of strings."""
        set_texts(self.group, name, values)


_AGAIN = "Process the test again from its exports."


_BROKEN = (
    OSError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
)
"""What the HDF5 library, and reading what should be there, raise for damaged files."""


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a result file of a schema that is known here; say every fault of it as StoreError."""
    try:
        if is_cut_off(path.parent):
            found = "one whose files are being replaced, or were when a process was killed"
            remedy = f"Wait until it is done, or finish it: `labpipe process {path}`."
            raise _fault(path, "", "a result with all its files", found, remedy)
        if not h5py.is_hdf5(path):
            raise _fault(path, "", "a result file", _instead_of_hdf5(path), _AGAIN)
        with h5py.File(path, "r") as root:
            _check_schema(path, root)
            _check_links(path, root)
            yield root
    except MemoryError as error:
        found = f"one that needs more ({error})"
        remedy = "Close other programs, or leave it out."
        raise _fault(path, "", "a result file that goes into the memory", found, remedy) from error
    except _BROKEN as error:
        found = f"a damaged one ({' '.join(str(error).split())})"
        raise _fault(path, "", "a whole result file", found, _AGAIN) from error


def _fault(file: object, place: str, expected: str, found: str, remedy: str) -> StoreError:
    message = error_text(file, place, expected=expected, found=found, remedy=remedy)
    return StoreError(message, code="bad_result")


def _instead_of_hdf5(path: Path) -> str:
    if not path.exists():
        return "nothing"
    with path.open("rb") as file:  # a file that may not be read says so here
        start = file.read(1)
    return "a file that is not HDF5" if start else "an empty file"


def _check_schema(path: Path, root: Any) -> None:
    found = root.attrs.get(layout.SCHEMA_ATTRIBUTE)
    place = layout.SCHEMA_ATTRIBUTE
    expected = f"{layout.SCHEMA}, the schema that this version reads"
    if found is None:
        raise _fault(path, place, expected, "an HDF5 file that labpipe did not make", _AGAIN)
    if found > layout.SCHEMA:
        made = f"a file made by a newer labpipe, schema {found}"
        raise _fault(path, place, expected, made, "Update labpipe.")
    if found < 1:
        raise _fault(path, place, expected, f"schema {found}", _AGAIN)


def _check_links(path: Path, root: Any) -> None:
    """Refuse what leads into other files: a result holds all that it is made of."""

    def leaving(name: bytes, about: Any) -> bytes | None:
        return None if about.type in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT) else name

    found = root.id.links.visit(leaving, info=True)
    if found is not None:
        raise _elsewhere(path, found.decode(errors="replace"), "a link into another file")


def _elsewhere(path: object, place: str, found: str) -> StoreError:
    return _fault(path, place, "all of the result in its own file", found, _AGAIN)


def text(group: Any, name: str) -> str:
    """Read an attribute that is one string."""
    return _word(get_text(group, name))


def texts(group: Any, name: str) -> tuple[str, ...]:
    """Read an attribute that is a list of strings."""
    return () if is_empty(group, name) else tuple(_word(word) for word in group.attrs[name])


def _word(value: object) -> str:
    """Take text that any file can hold: bytes that are no UTF-8 raise a ValueError."""
    word = str(value)
    word.encode()
    return word


def strings(group: Any, name: str, axis: str) -> tuple[str, ...]:
    """Read a dataset of strings."""
    encoded = array(group, name, Field((axis,), layout.TEXT, "text"))
    return tuple(bytes(word).decode() for word in encoded)


def rows(parent: Any, name: str, kind: Table, unit: str | None = None) -> list[Mapping[str, Any]]:
    """Read a table, also one from before tables were groups of columns.

    Parameters
    ----------
    parent : open group
    name : of the table in it
    kind : its columns
    unit : of the columns whose unit the layout leaves open; None for any

    Returns
    -------
    Cells by column, texts as bytes; none where there is no such table.
    """
    if name not in parent:
        return []
    found = parent[name]
    if isinstance(found, h5py.Dataset):
        return list(array(parent, name, Field((kind.axis,), None, "table")))
    if all(found[column].shape == (0,) for column in kind.columns):
        return []
    columns = {
        column: array(found, column, each if each.unit else replace(each, unit=unit)).tolist()
        for column, each in kind.columns.items()
    }
    cells = zip(*columns.values(), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in cells]


def arrays(group: Any, kinds: Mapping[str, Field]) -> dict[str, NDArray[Any]]:
    """Read several datasets, by name."""
    return {name: array(group, name, kind) for name, kind in kinds.items()}


def array(group: Any, name: str, kind: Field) -> NDArray[Any]:
    """Read a dataset whose unit, axes and number type are those of the layout."""
    dataset = _checked(group, name, kind)
    values: NDArray[Any] = np.empty(dataset.shape, dataset.dtype)
    if values.size:
        dataset.id.read(h5s.ALL, h5s.ALL, values)
    return values


def array_rows(group: Any, name: str, kind: Field, chosen: Ints) -> NDArray[Any]:
    """Read rows of a dataset, as `array`.

    Parameters
    ----------
    group, name, kind : as for `array`
    chosen : numbers of rows of the first axis, increasing, each once
    """
    values: NDArray[Any] = _checked(group, name, kind)[chosen]
    return values


def _checked(group: Any, name: str, kind: Field) -> Any:
    """A dataset of this file whose unit, axes and number type are those of the layout."""
    dataset = group[name]
    for label, expected in (("axes", ", ".join(kind.axes)), ("unit", kind.unit)):
        if expected is not None:
            _check(dataset, label, expected, _label(dataset, label))
    if kind.dtype not in {"table", "text"}:
        _check(dataset, "number type", kind.dtype, str(dataset.dtype))
    _check_storage(dataset)
    return dataset


def _label(dataset: Any, name: str) -> str:
    return str(get_text(dataset, name)) if has_attribute(dataset, name) else "none"


def _check_storage(dataset: Any) -> None:
    """Refuse a dataset that is not here, or not all of it, before memory is taken for it."""
    kept = dataset.id.get_create_plist()
    if kept.get_layout() == h5d.VIRTUAL or kept.get_external_count():
        found = "samples that are kept in another file"
        raise _elsewhere(dataset.file.filename, dataset.name, found)
    shape, chunks = dataset.shape, dataset.chunks
    if chunks is None:
        has_all = dataset.id.get_storage_size() >= dataset.nbytes
    else:
        sizes = zip(shape, chunks, strict=True)
        has_all = dataset.id.get_num_chunks() >= prod(ceil(all_ / one) for all_, one in sizes)
    if not has_all:
        claimed = f"the {dataset.size} numbers that it claims"
        raise _fault(dataset.file.filename, dataset.name, claimed, "a part of them", _AGAIN)


def _check(dataset: Any, what: str, expected: str, found: str) -> None:
    if expected != found:
        raise _fault(
            dataset.file.filename, dataset.name, f"{what} {expected!r}", repr(found), _AGAIN
        )
