"""Write arrays and texts of a result file in compressed chunks, and read them by the layout.

The filters of HDF5 use only one processor core. This module compresses chunks on all cores, in the
format of these filters (shuffle, gzip, fletcher32), which any HDF5 library can read. ISA-L
compresses six to nine times as fast as zlib, to the same size.

h5py creates types, spaces and property lists again for each of the hundreds of small objects in a
result file. This module creates them once, with low-level calls of the HDF5 library. The same
content is then written in a third of the time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import repeat
from math import ceil, prod
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5p, h5s, h5t
from isal import isal_zlib
from numpy.typing import NDArray

from labpipe.errors import LabpipeError, StoreError
from labpipe.records.arrays import AXIS_LABELS, Ints
from labpipe.store import layout
from labpipe.store.layout import DatasetSpec, choose_scales
from labpipe.store.replace import is_unfinished

COMPRESSION_LEVEL, FAST_LEVEL = 3, 0
"""Compression levels of arrays with several axes, and of arrays with one axis.

The fast level takes a third of the time for arrays with one axis. At levels 1 and 2, ISA-L (isal
1.9) in a thread may compress equal bytes to different bytes.
"""
_STRING: Final = h5py.string_dtype()
_TEXT: Final = h5t.py_create(_STRING, logical=True)
_TEXT_IN_MEMORY: Final = h5t.py_create(_STRING)
_SCALAR: Final = h5s.create(h5s.SCALAR)


def make_dataset(group: Any, name: str, values: NDArray[Any], chunk: tuple[int, ...]) -> Any:
    """Create a dataset for an array, but do not write the array.

    Parameters
    ----------
    group : open group, without an object of this name
    name : name of the dataset
    values : array of any shape and number type; axes of length 0 may grow
    chunk : shape of the chunks, which go through shuffle, gzip and fletcher32

    Returns
    -------
    The dataset, without time stamps.
    """
    max_shape = tuple(size or h5s.UNLIMITED for size in values.shape)
    space = h5s.create_simple(values.shape, max_shape)
    data_type, properties = _make_type(values.dtype.str), _make_properties(chunk)
    return h5py.Dataset(h5d.create(group.id, name.encode(), data_type, space, properties))


def open_dataset(group: Any, name: str) -> Any:
    """Open an existing dataset.

    Parameters
    ----------
    group : open group
    name : name or path of the dataset
    """
    return h5py.Dataset(h5d.open(group.id, name.encode()))


@lru_cache(maxsize=256)
def _make_type(dtype_text: str) -> Any:
    """Make the HDF5 type of a NumPy type, which its text defines."""
    hdf5_type = h5t.py_create(np.dtype(dtype_text), logical=True)
    if isinstance(hdf5_type, h5t.TypeStringID):
        hdf5_type.set_strpad(h5t.STR_NULLTERM)
    return hdf5_type


@lru_cache(maxsize=256)
def _make_properties(chunk: tuple[int, ...]) -> Any:
    """Make the property list of datasets with a shape of chunks."""
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    properties.set_chunk(chunk)
    properties.set_shuffle()
    properties.set_deflate(COMPRESSION_LEVEL)
    properties.set_fletcher32()
    return properties


def set_text(owner: Any, name: str, text: str) -> None:
    """Write an attribute that is a text.

    Parameters
    ----------
    owner : open group or dataset, without an attribute of this name
    name, text : name and text of the attribute
    """
    attribute = h5a.create(owner.id, name.encode(), _TEXT, _SCALAR)
    attribute.write(np.array(text, dtype=_STRING))


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
        If it is not a single text of variable length in UTF-8.
    """
    return bytes(_read_attribute(owner, name, _TEXT_IN_MEMORY, object).item()).decode()


def read_texts(owner: Any, name: str) -> tuple[str, ...]:
    """Read an attribute that is a list of texts, as `read_text` does."""
    texts = _read_attribute(owner, name, _TEXT_IN_MEMORY, object).tolist()
    return tuple(bytes(text).decode() for text in texts)


def read_number(owner: Any, name: str) -> float:
    """Read an attribute that is a number, as `read_text` does."""
    return float(_read_attribute(owner, name, h5t.NATIVE_DOUBLE, np.float64).item())


def _read_attribute(owner: Any, name: str, type_in_memory: Any, dtype: Any) -> NDArray[Any]:
    """Read an attribute into an array, converted to an HDF5 type and its NumPy type."""
    attribute = h5a.open(owner.id, name.encode())
    values: NDArray[Any] = np.empty(attribute.shape, dtype)
    if values.size:
        attribute.read(values, mtype=type_in_memory)
    return values


def has_attribute(owner: Any, name: str) -> bool:
    """Return whether a group or dataset has an attribute.

    Parameters
    ----------
    owner : open group or dataset
    name : name of the attribute
    """
    return bool(h5a.exists(owner.id, name.encode()))


def set_texts(owner: Any, name: str, texts: Sequence[str]) -> None:
    """Write an attribute that is a list of texts, as `set_text` does."""
    space = h5s.create_simple((len(texts),))
    h5a.create(owner.id, name.encode(), _TEXT, space).write(np.array(texts, dtype=_STRING))


def set_number(owner: Any, name: str, number: float) -> None:
    """Write an attribute that is a number, int64 or float64, as `set_text` does."""
    value = np.array(number)
    h5a.create(owner.id, name.encode(), _make_type(value.dtype.str), _SCALAR).write(value)


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
    deflated = isal_zlib.compress(np.ascontiguousarray(planes).data, level)
    return deflated + fletcher32(deflated).to_bytes(4, "little")


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
class Target:
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

    def open_group(self, name: str) -> Target:
        """Open a subgroup, or create it if it does not exist."""
        return Target(self.group.require_group(name), self.pool, self.arrays, self.cache)

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
            encoded = [text.encode() for text in values]
            values = np.array(encoded, dtype=f"S{max([1, *map(len, encoded)]) + 1}")
        row_shape = tuple(max(size, 1) for size in values.shape[1:])
        rows = max(CHUNK_BYTES // (values.dtype.itemsize * prod(row_shape)), 1)  # at most all rows
        chunk = (max(min(rows, len(values)), 1), *row_shape)
        dataset = make_dataset(self.group, name, values, chunk)
        set_text(dataset, "unit", spec.unit or unit)
        set_text(dataset, "axes", ", ".join(spec.axes))
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
        opened_scales: dict[str, Any] = {}
        for name, (dataset, spec) in list(self.datasets.items()):
            if name in scales.values():
                continue  # a scale cannot have a scale
            for index, axis in enumerate(spec.axes):
                scale = scales.get(axis, axis)
                n_same = spec.axes[:index].count(axis)
                # xarray requires a unique name for each axis of a dataset.
                unique_name = f"{scale}_{n_same + 1}" if n_same else scale
                if unique_name not in opened_scales:
                    size = dataset.shape[index]
                    opened_scales[unique_name] = self._make_scale(unique_name, scale, axis, size)
                self.attach_scale(dataset, index, opened_scales[unique_name])

    def _make_scale(self, name: str, scale: str, axis: str, size: int) -> Any:
        """Return a dimension scale, or create it if it does not exist."""
        if name in self.group:
            return self.group[name]
        if name != scale:
            scale_dataset, spec = self.datasets[scale]
            return self.write_array(name, self.arrays[scale_dataset.name], spec)
        if axis in AXIS_LABELS:
            return self.write_array(name, AXIS_LABELS[axis], DatasetSpec((axis,), layout.TEXT))
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

    def write_texts(self, name: str, values: tuple[str, ...]) -> None:
        """Write an attribute that is a list of strings."""
        set_texts(self.group, name, values)


@contextmanager
def open_result(path: Path) -> Iterator[Any]:
    """Open a result file of the current schema, and convert all errors to StoreError."""
    try:
        if is_unfinished(path.parent):
            raise StoreError.about("store.cut_off", path, target=path)
        if not h5py.is_hdf5(path):
            raise StoreError.about("store.no_hdf5", path, found=_describe_file(path))
        with h5py.File(path, "r") as root:
            _check_schema(path, root)
            _check_links(path, root)
            yield root
    except LabpipeError:
        raise
    except MemoryError as error:
        raise StoreError.about("store.too_large", path, reason=error) from error
    except Exception as error:
        reason = " ".join(str(error).split())
        raise StoreError.about("store.damaged", path, reason=reason) from error


def _describe_file(path: Path) -> str:
    """Describe the content of a path that is not an HDF5 file."""
    if not path.exists():
        return "nothing"
    with path.open("rb") as file:  # raises if the file is not readable
        start = file.read(1)
    return "a file that is not HDF5" if start else "an empty file"


def _check_schema(path: Path, root: Any) -> None:
    """Raise StoreError if a file has another schema, or no schema."""
    schema, current_schema = root.attrs.get(layout.SCHEMA_ATTRIBUTE), layout.SCHEMA
    if schema is None:
        raise StoreError.about("store.foreign", path, layout.SCHEMA_ATTRIBUTE, known=current_schema)
    if schema != current_schema:
        is_newer = schema > current_schema
        raise StoreError.about(
            "store.newer_schema" if is_newer else "store.other_schema",
            path,
            layout.SCHEMA_ATTRIBUTE,
            known=current_schema,
            schema=schema,
        )


def _check_links(path: Path, root: Any) -> None:
    """Raise StoreError if a file has links to other files, because it must be complete."""

    def find_external(name: bytes, link_info: Any) -> bytes | None:
        return None if link_info.type in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT) else name

    link = root.id.links.visit(find_external, info=True)
    if link is not None:
        raise StoreError.about("store.link", path, link.decode(errors="replace"))


def read_array(group: Any, name: str, spec: DatasetSpec) -> Any:
    """Read an array, or a tuple of texts, after checking unit, axes and type against the layout."""
    dataset = _open_checked_dataset(group, name, spec)
    values: NDArray[Any] = np.empty(dataset.shape, dataset.id.dtype)
    if values.size:
        dataset.id.read(h5s.ALL, h5s.ALL, values)
    return tuple(cell.decode() for cell in values.tolist()) if spec.dtype == layout.TEXT else values


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
    dataset = open_dataset(group, name)
    for label, expected in (("axes", ", ".join(spec.axes)), ("unit", spec.unit)):
        if expected is not None:
            _require_equal(dataset, label, expected, read_text(dataset, label))
    if spec.dtype != layout.TEXT:
        _require_equal(dataset, "number type", spec.dtype, dataset.id.dtype.name)
    _check_storage(dataset)
    return dataset


def _check_storage(dataset: Any) -> None:
    """Raise StoreError for incomplete or external data, before memory is allocated for them."""
    properties = dataset.id.get_create_plist()
    if properties.get_layout() == h5d.CHUNKED:
        sizes = zip(dataset.shape, properties.get_chunk(), strict=True)
        has_all = dataset.id.get_num_chunks() >= prod(ceil(size / chunk) for size, chunk in sizes)
    elif properties.get_layout() == h5d.VIRTUAL or properties.get_external_count():
        raise StoreError.about("store.samples_elsewhere", dataset.file.filename, dataset.name)
    else:
        has_all = dataset.id.get_storage_size() >= dataset.nbytes
    if not has_all:
        file, place, size = dataset.file.filename, dataset.name, dataset.size
        raise StoreError.about("store.part_of_dataset", file, place, size=size)


def _require_equal(dataset: Any, quantity: str, expected: str, actual: str) -> None:
    """Raise StoreError if a property of a dataset differs from the layout."""
    if expected != actual:
        file, place = dataset.file.filename, dataset.name
        raise StoreError.about(
            "store.other_layout", file, place, what=quantity, expected=expected, found=actual
        )
