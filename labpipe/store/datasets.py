"""Write and read arrays and records as datasets, attributes and tables of a result file.

The annotations of most records define how they are stored, see `layout`.

The filters of HDF5 use only one processor core. This module compresses chunks on all cores, in the
format of these filters (shuffle, gzip, fletcher32), which any HDF5 library can read. ISA-L
compresses six to nine times as fast as zlib, to the same size.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from datetime import date
from itertools import repeat
from math import ceil, isnan, nan, prod
from typing import Any, Final, TypeVar

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5s, h5t
from isal import isal_zlib
from numpy.typing import NDArray

from labpipe.errors import StoreError
from labpipe.records.arrays import AXIS_LABELS, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.store.layout import (
    TEXT,
    AttributeSpec,
    DatasetSpec,
    choose_scales,
    list_attributes,
    list_columns,
    list_datasets,
    make_bound_prefix,
)

_R = TypeVar("_R")

COMPRESSION_LEVEL, FAST_LEVEL = 3, 0
"""Compression levels of arrays with several axes, and of arrays with one axis.

The fast level takes a third of the time for arrays with one axis. At levels 1 and 2, ISA-L (isal
1.9) in a thread may compress equal bytes to different bytes.
"""
_STRING: Final = h5py.string_dtype()
_STRING_IN_MEMORY: Final = h5t.py_create(_STRING)


def read_text(owner: Any, name: str) -> str:
    """Read an attribute that is a text.

    Parameters
    ----------
    owner : open group or dataset
    name : name of the attribute

    Raises
    ------
    KeyError
        If there is no such attribute.
    OSError, TypeError, ValueError
        If the attribute is not a single text of variable length in UTF-8.
    """
    return bytes(_read_attribute_values(owner, name, _STRING_IN_MEMORY, object).item()).decode()


def read_texts(owner: Any, name: str) -> tuple[str, ...]:
    """Read an attribute that is a list of texts, as `read_text` does."""
    texts = _read_attribute_values(owner, name, _STRING_IN_MEMORY, object).tolist()
    return tuple(bytes(text).decode() for text in texts)


def read_number(owner: Any, name: str) -> float:
    """Read an attribute that is a number, as `read_text` does."""
    return float(_read_attribute_values(owner, name, h5t.NATIVE_DOUBLE, np.float64).item())


def _read_attribute_values(owner: Any, name: str, type_in_memory: Any, dtype: Any) -> NDArray[Any]:
    """Read an attribute into an array, converted to an HDF5 type and its NumPy type.

    The low-level call takes half the time of `owner.attrs`. A report reads many attributes.
    """
    attribute = h5a.open(owner.id, name.encode())
    values: NDArray[Any] = np.empty(attribute.shape, dtype)
    if values.size:
        attribute.read(values, mtype=type_in_memory)
    return values


CHUNK_BYTES = 1 << 18
"""Largest size of a chunk before compression."""
ChunkCache = dict[tuple[object, ...], list[bytes]]
"""Compressed chunks, keyed by the memory location of their array (`locate_array`)."""


def _make_chunks(array: NDArray[Any], rows: int, pool: Executor, cache: ChunkCache) -> list[bytes]:
    """Return the compressed chunks of an array, from the cache or computed in the pool."""
    min_pool_bytes = 1 << 15  # smaller arrays are compressed faster without threads
    location = locate_array(array)
    if location not in cache:
        starts = range(0, len(array) if array.size else 0, rows)
        blocks = (array[start : start + rows] for start in starts)
        map_blocks = map if array.nbytes < min_pool_bytes else pool.map
        cache[location] = list(map_blocks(_compress_chunk, blocks, repeat(rows)))
    return cache[location]


def locate_array(array: NDArray[Any]) -> tuple[object, ...]:
    """Return the memory location and layout of an array, which identify it while it exists."""
    return (array.ctypes.data, array.shape, array.strides, array.dtype.str)


def has_same_content(dataset: Any, array: NDArray[Any]) -> bool:
    """Return whether a dataset has exactly the content of an array, including bits of NaN.

    Of a long dataset, only the first and the last chunk are read through the filters of HDF5, to
    check the format of the chunks. `write_result` compares all bytes on the disk.
    """
    if dataset.shape != array.shape or dataset.dtype != array.dtype:
        return False
    rows = dataset.chunks[0]
    if 0 < len(array) <= rows:
        values = np.empty_like(array, order="C")
        dataset.id.read(h5s.ALL, h5s.ALL, values)
        return values.tobytes() == array.tobytes()
    last_start = (len(array) - 1) // rows * rows
    return not array.size or all(
        dataset[start : start + rows].tobytes() == array[start : start + rows].tobytes()
        for start in (0, last_start)
    )


def _compress_chunk(block: NDArray[Any], rows: int) -> bytes:
    """Apply the HDF5 filters shuffle, gzip and fletcher32 to one chunk.

    The last chunk of an array is padded with zeros to the full number of rows, as HDF5 requires.
    """
    padding = np.zeros((rows - len(block), *block.shape[1:]), block.dtype)
    block = np.concatenate([block, padding]) if len(padding) else np.ascontiguousarray(block)
    planes = block.view(np.uint8).reshape(-1, block.dtype.itemsize).T
    level = FAST_LEVEL if block.ndim == 1 else COMPRESSION_LEVEL
    compressed = isal_zlib.compress(np.ascontiguousarray(planes).data, level)
    return compressed + fletcher32(compressed).to_bytes(4, "little")


def fletcher32(data: bytes) -> int:
    """Compute the checksum that HDF5 uses.

    Parameters
    ----------
    data : bytes of a chunk

    Returns
    -------
    The checksum. Its lower 16 bits are the sum of the words modulo 65535, its upper 16 bits are the
    sum of the running totals of the words modulo 65535. Words are big-endian; an odd last byte is
    the upper half of a word.

    Notes
    -----
    As in H5_checksum_fletcher32 of the HDF5 library, a sum that is a multiple of 65535 other than
    zero gives 65535 and not 0.

    Examples
    --------
    >>> hex(fletcher32(bytes([1, 2, 3])))
    '0x5040402'
    """
    modulus, width, count = 65535, 256, -(-len(data) // 2)
    # The sums are computed over rows and columns of a table, because a copy of the words in int64
    # would take five times as long.
    words = np.frombuffer(data + bytes(-len(data) % (2 * width)), dtype=">u2").reshape(-1, width)
    row_sums, column_sums = (words.sum(axis=axis, dtype=np.int64) for axis in (1, 0))
    # The running totals contain word i `count` - i times. Their sum is below 2**47 for a chunk.
    repeats = count - width * np.arange(len(row_sums))
    totals = row_sums.sum(), row_sums @ repeats - column_sums @ np.arange(width)
    word_sum, running_sum = (int(x % modulus or (modulus if x else 0)) for x in totals)
    return running_sum << 16 | word_sum


@dataclass(frozen=True, slots=True)
class GroupWriter:
    """Group that is being written, with threads for compression and the data written so far.

    Parameters
    ----------
    group : open HDF5 group
    pool : threads for compression
    arrays : arrays written so far, keyed by path of the dataset, for verification
    cache : chunks of these arrays, so that a time axis in several groups is compressed only once
    datasets : datasets of this group with their definitions, keyed by name
    """

    group: Any
    pool: Executor
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    cache: ChunkCache = field(default_factory=dict)
    datasets: dict[str, tuple[Any, DatasetSpec]] = field(default_factory=dict)

    def open_group(self, name: str) -> GroupWriter:
        """Open a subgroup, or create it if it does not exist."""
        return GroupWriter(self.group.require_group(name), self.pool, self.arrays, self.cache)

    def write_array(
        self, name: str, values: NDArray[Any] | tuple[str, ...], spec: DatasetSpec, unit: str = ""
    ) -> Any:
        """Write numbers or texts as a chunked dataset with its unit and axes.

        Parameters
        ----------
        name : name of the dataset, unused in this group
        values : texts, or an array of any shape and number type; axis 0 is divided into chunks
        spec : axes and unit, which become attributes
        unit : unit if the layout does not define it

        Returns
        -------
        The dataset.

        Notes
        -----
        The bit patterns of NaN are preserved. An empty array has no chunks.
        """
        if isinstance(values, tuple):
            # All programs read UTF-8 of fixed width, but Octave only if it is declared as ASCII.
            # h5dump requires a final zero. Texts of one byte would be characters for netCDF.
            encoded_texts = [text.encode() for text in values]
            values = np.array(encoded_texts, dtype=f"S{max([1, *map(len, encoded_texts)]) + 1}")
        data_type = h5t.py_create(values.dtype)
        if isinstance(data_type, h5t.TypeStringID):
            data_type.set_strpad(h5t.STR_NULLTERM)
        row_shape = tuple(max(size, 1) for size in values.shape[1:])
        rows = max(CHUNK_BYTES // (values.dtype.itemsize * prod(row_shape)), 1)  # at most all rows
        chunk = (max(min(rows, len(values)), 1), *row_shape)
        dataset = self.group.create_dataset(
            name,
            values.shape,
            h5py.Datatype(data_type),
            maxshape=tuple(size or None for size in values.shape),
            chunks=chunk,
            shuffle=True,
            compression=COMPRESSION_LEVEL,
            fletcher32=True,
            track_times=False,
        )
        dataset.attrs.update({"unit": spec.unit or unit, "axes": ", ".join(spec.axes)})
        chunks = _make_chunks(values, chunk[0], self.pool, self.cache)
        for index, chunk_bytes in enumerate(chunks):
            corner = (index * chunk[0],) + (0,) * (len(chunk) - 1)
            dataset.id.write_direct_chunk(corner, chunk_bytes)
        self.arrays[dataset.name] = values
        self.datasets[name] = dataset, spec
        return dataset

    def link_dataset(self, name: str, dataset: Any, spec: DatasetSpec) -> None:
        """Add a dataset of another group to this group, as a hard link."""
        self.group[name] = dataset
        self.datasets[name] = self.group[name], spec

    def attach_scales(self) -> None:
        """Attach dimension scales to all axes of the arrays of this group, as netCDF-4 requires.

        An axis without a dataset of its own (`layout.choose_scales`) gets a dataset with its name,
        which contains the labels of `AXIS_LABELS`, or indices from 0.
        """
        scales = choose_scales({name: spec for name, (_, spec) in self.datasets.items()})
        scale_datasets: dict[str, Any] = {}
        for name, (dataset, spec) in list(self.datasets.items()):
            if name in scales.values():
                continue  # a scale cannot have a scale
            for index, axis in enumerate(spec.axes):
                scale = scales.get(axis, axis)
                n_same = spec.axes[:index].count(axis)
                # xarray requires a unique name for each axis of a dataset.
                unique_name = f"{scale}_{n_same + 1}" if n_same else scale
                if unique_name not in scale_datasets:
                    size = dataset.shape[index]
                    scale_datasets[unique_name] = self._make_scale(unique_name, scale, axis, size)
                self.attach_scale(dataset, index, scale_datasets[unique_name])

    def _make_scale(self, name: str, scale: str, axis: str, size: int) -> Any:
        """Return a dimension scale, or create it if it does not exist."""
        if name in self.group:
            return self.group[name]
        if name != scale:
            scale_dataset, spec = self.datasets[scale]
            return self.write_array(name, self.arrays[scale_dataset.name], spec)
        if axis in AXIS_LABELS:
            return self.write_array(name, AXIS_LABELS[axis], DatasetSpec((axis,), TEXT))
        return self.write_array(name, np.arange(size), DatasetSpec((axis,), "1"))

    def attach_scale(self, dataset: Any, axis: int, scale: Any) -> None:
        """Make a dataset the dimension scale of an axis of another dataset.

        Parameters
        ----------
        dataset : open dataset
        axis : index of the axis
        scale : open dataset with as many values as the axis
        """
        if not h5ds.is_scale(scale.id):
            h5ds.set_scale(scale.id, scale.name.rpartition("/")[2].encode())
        h5ds.attach_scale(dataset.id, scale.id, axis)

    def write_texts(self, name: str, values: Sequence[str]) -> None:
        """Write an attribute that is a list of strings."""
        self.group.attrs.create(name, np.array(values, dtype=_STRING))


def read_array(group: Any, name: str, spec: DatasetSpec) -> Any:
    """Read an array, or a tuple of texts, after checking unit, axes and type against the layout."""
    dataset = _open_checked_dataset(group, name, spec)
    values: NDArray[Any] = np.empty(dataset.shape, dataset.id.dtype)
    if values.size:
        dataset.id.read(h5s.ALL, h5s.ALL, values)
    return tuple(cell.decode() for cell in values.tolist()) if spec.dtype == TEXT else values


def read_array_rows(group: Any, name: str, spec: DatasetSpec, rows: Ints) -> NDArray[Any]:
    """Read rows of a dataset, as `read_array` does.

    Parameters
    ----------
    group, name, spec : see `read_array`
    rows : indices along the first axis, strictly increasing
    """
    values: NDArray[Any] = _open_checked_dataset(group, name, spec)[rows]
    return values


def _open_checked_dataset(group: Any, name: str, spec: DatasetSpec) -> Any:
    """Open a dataset, and check its unit, axes, number type and storage."""
    dataset = group[name]
    for label, expected in (("axes", ", ".join(spec.axes)), ("unit", spec.unit)):
        if expected is not None:
            _require_equal(dataset, label, expected, read_text(dataset, label))
    if spec.dtype != TEXT:
        _require_equal(dataset, "number type", spec.dtype, dataset.id.dtype.name)
    _check_storage(dataset)
    return dataset


def _check_storage(dataset: Any) -> None:
    """Raise StoreError for incomplete or external data, before memory is allocated for them."""
    properties = dataset.id.get_create_plist()
    if properties.get_layout() == h5d.CHUNKED:
        sizes = zip(dataset.shape, properties.get_chunk(), strict=True)
        n_chunks = prod(ceil(size / chunk) for size, chunk in sizes)
        is_complete = dataset.id.get_num_chunks() >= n_chunks
    elif properties.get_layout() == h5d.VIRTUAL or properties.get_external_count():
        raise StoreError.about("store.samples_elsewhere", dataset.file.filename, dataset.name)
    else:
        is_complete = dataset.id.get_storage_size() >= dataset.nbytes
    if not is_complete:
        file, place, size = dataset.file.filename, dataset.name, dataset.size
        raise StoreError.about("store.part_of_dataset", file, place, size=size)


def _require_equal(dataset: Any, quantity: str, expected: str, actual: str) -> None:
    """Raise StoreError if a property of a dataset differs from the layout."""
    if expected != actual:
        file, place = dataset.file.filename, dataset.name
        facts = {"what": quantity, "expected": expected, "found": actual}
        raise StoreError.about("store.other_layout", file, place, **facts)


_INTERVAL_FIELDS = ("lower", "upper", "level")
_REASON_TYPES = Reason, tuple[Reason, ...]
"""Types of fields that contain reasons."""
_CODES, _MESSAGES = "reason_codes", "reason_messages"
"""Names of the attributes that contain the codes and the messages of reasons."""


def write_record(target: GroupWriter, record: object) -> None:
    """Write the arrays and attributes of a record.

    Parameters
    ----------
    target : group of the record
    record : record of a type whose annotations define the layout
    """
    write_arrays(target, record)
    write_attributes(target, record)


def read_record(group: Any, kind: type[_R], **extra: object) -> _R:
    """Read a record that `write_record` wrote.

    Parameters
    ----------
    group : group of the record
    kind : type of the record
    extra : values of fields that are stored elsewhere, keyed by name of the field
    """
    return kind(**read_arrays(group, kind), **read_attributes(group, kind, skip=extra), **extra)


def write_arrays(target: GroupWriter, record: Any) -> None:
    """Write the arrays of a record as datasets with dimension scales.

    Parameters
    ----------
    target : group of the record
    record : record of a type whose annotations define the layout
    """
    for name, spec in list_datasets(type(record)).items():
        values = getattr(record, name)
        if spec.dtype == "uint8":
            values = values.astype(np.uint8)
        target.write_array(name, values, spec, getattr(record, spec.unit_field, ""))
    target.attach_scales()


def read_arrays(group: Any, kind: Any, names: Iterable[str] = ()) -> dict[str, Any]:
    """Read the arrays of a record, and the texts that state their units.

    Parameters
    ----------
    group : group of the record
    kind : type of the record
    names : names of the arrays to be read; all if empty

    Returns
    -------
    Arrays and texts, keyed by name of the field.
    """
    arrays: dict[str, Any] = {}
    for name, spec in list_datasets(kind).items():
        if not names or name in names:
            arrays[name] = read_array(group, name, spec)
            if spec.unit_field:
                arrays[spec.unit_field] = read_text(group[name], "unit")
    return arrays


def write_attributes(target: GroupWriter, record: Any, *, skip: Container[str] = ()) -> None:
    """Write the numbers, texts, intervals and reasons of a record.

    A number or interval that is None is not written. A text or reason that is None is written
    empty.

    Parameters
    ----------
    target : group of the record
    record : record of a type whose annotations define the layout
    skip : names of fields that are stored elsewhere
    """
    for name, attribute in list_attributes(type(record)).items():
        if name not in skip:
            _write_attribute(target, name, attribute, getattr(record, name))


def _write_attribute(target: GroupWriter, name: str, attribute: AttributeSpec, value: Any) -> None:
    """Write the value of one field of a record as attributes of a group."""
    field_type, unit, _ = attribute
    attributes = target.group.attrs
    if field_type in _REASON_TYPES:
        reasons = value if isinstance(value, tuple) else (value,) if value else ()
        target.write_texts(_CODES, [reason.code for reason in reasons])
        target.write_texts(_MESSAGES, [reason.message for reason in reasons])
    elif isinstance(value, Interval):
        for bound in _INTERVAL_FIELDS:
            attributes[make_bound_prefix(name) + bound] = float(getattr(value, bound))
    elif isinstance(value, tuple):
        target.write_texts(name, value)
    elif field_type not in (int, float, Interval):
        attributes[name] = _format_cell(value)
    elif value is not None:
        attributes[name] = field_type(value)
        if unit is not None:
            attributes[f"{name}_unit"] = unit.symbol


def read_attributes(group: Any, kind: Any, *, skip: Container[str] = ()) -> dict[str, Any]:
    """Read the attributes that `write_attributes` wrote.

    Parameters
    ----------
    group : group of the record
    kind : type of the record
    skip : names of fields that are stored elsewhere

    Returns
    -------
    Values, keyed by name of the field.
    """
    attributes = {name: spec for name, spec in list_attributes(kind).items() if name not in skip}
    return {name: _read_attribute(group, name, spec) for name, spec in attributes.items()}


def _read_attribute(group: Any, name: str, attribute: AttributeSpec) -> Any:
    """Read the value of one field of a record from attributes of a group."""
    field_type, _, is_optional = attribute
    if field_type in _REASON_TYPES:
        pairs = zip(read_texts(group, _CODES), read_texts(group, _MESSAGES), strict=True)
        reasons = tuple(Reason(*pair) for pair in pairs)
        return next(iter(reasons), None) if field_type is Reason else reasons
    if field_type == tuple[str, ...]:
        return read_texts(group, name)
    if field_type not in (int, float, Interval):
        return _parse_cell({name: read_text(group, name)}, name, attribute)
    names = [name]
    if field_type is Interval:
        names = [make_bound_prefix(name) + bound for bound in _INTERVAL_FIELDS]
    if is_optional and names[0] not in group.attrs:
        return None
    return field_type(*(read_number(group, name) for name in names))


def write_table(
    target: GroupWriter, name: str, kind: type[_R], rows: Sequence[_R], unit: str = ""
) -> None:
    """Write records as a table, which is a group of columns.

    Parameters
    ----------
    target : group in which the table is created
    name : name of the table
    kind : type of the records, a key of `layout.ROW_AXES`
    rows : records, one for each row
    unit : unit of the columns without a unit in the layout
    """
    table = target.open_group(name)
    for column, (field_name, bound, spec) in list_columns(kind).items():
        cells = [getattr(row, field_name) for row in rows]
        if bound:
            cells = [getattr(interval, bound) for interval in cells]
        values: Any = tuple(map(_format_cell, cells))
        if spec.dtype != TEXT:
            values = np.array([nan if cell is None else cell for cell in cells], spec.dtype)
        table.write_array(column, values, spec, unit)
    table.attach_scales()


def _format_cell(value: Any) -> str:
    """Format a value of a record as text; None gives an empty text."""
    return ", ".join(value) if isinstance(value, tuple) else "" if value is None else str(value)


def read_table(parent: Any, name: str, kind: type[_R], unit: str | None = None) -> tuple[_R, ...]:
    """Read a table that `write_table` wrote.

    Parameters
    ----------
    parent : group that contains the table
    name : name of the table
    kind : type of the records
    unit : unit that columns without a unit in the layout must have; None for any unit

    Returns
    -------
    The records. Their intervals have the level 0.95, which is not stored.
    """
    names = list_columns(kind)
    columns = read_columns(parent[name], kind, names, unit)
    rows = (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))
    fields = list_attributes(kind).items()
    return tuple(
        kind(**{field: _parse_cell(row, field, attribute) for field, attribute in fields})
        for row in rows
    )


def read_columns(
    table: Any, kind: type, names: Iterable[str], unit: str | None = None
) -> list[Sequence[Any]]:
    """Read columns of a table that `write_table` wrote.

    Parameters
    ----------
    table : group of the columns
    kind : type of the records
    names : names of the columns to be read
    unit : unit that columns without a unit in the layout must have; None for any unit

    Returns
    -------
    The cells of each column, in the order of `names`.
    """
    columns: list[Sequence[Any]] = []
    for name in names:
        spec = list_columns(kind)[name].dataset
        cells = read_array(table, name, spec if spec.unit else replace(spec, unit=unit))
        columns.append(cells if isinstance(cells, tuple) else cells.tolist())
    return columns


def _parse_cell(row: Mapping[str, Any], name: str, attribute: AttributeSpec) -> Any:
    """Parse one field of a record from the cells of a row."""
    field_type, _, is_optional = attribute
    if field_type is Interval:
        return Interval(*(row[make_bound_prefix(name) + bound] for bound in ("lower", "upper")))
    cell = row[name]
    if is_optional and (cell == "" or (field_type is float and isnan(cell))):
        return None
    if field_type is date:
        return date.fromisoformat(cell)
    return tuple(cell.split(", ")) if field_type == tuple[str, ...] else field_type(cell)
