"""Reader of dSPACE ControlDesk recordings saved as MATLAB files.

**Writes this file**: ControlDesk, "export as MAT".

**Recording**: one channel for each measured variable, on the clock of its raster.

**Units**: from the field Unit. No known file has this field, so the protocol states the units.

**Missing data**: the format has no missing values. Infinities become NaN, with a note.

**Clock and frame**: one clock for each raster, with the times of ``X.Data`` exactly as written, or
converted to seconds if the field Unit states another unit.

**File structure**: one struct with the fields X (time axes) and Y (channels), in a MAT v5 file or
in an HDF5 file with a 512-byte user block (v7.3). The format is recognised by its content.

**Known versions**: file format revisions 2.0 (classic ControlDesk) and 2.1 (5.2 to 7.5).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice
from labpipe.readers.controldesk import (
    Axis,
    Export,
    Trace,
    load_export,
    parse_save_date,
    resolve_date,
    to_json,
)
from labpipe.readers.raw_files import map_read_errors, read_head, require
from labpipe.records.quality import QualityNote

if TYPE_CHECKING:
    import h5py

    from labpipe.records.recording import Recording

MatValue = Any
"""Value of a variable: a list of mappings (struct array) or of values (cell array), text, an array,
or None for a type that is not read."""

_MI_MATRIX, _MI_COMPRESSED = 14, 15
_NUMERIC_CLASSES = range(6, 16)
_DTYPE_BY_MI_TYPE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_DTYPE_BY_MI_TYPE |= {12: "i8", 13: "u8"}
_ENCODING_BY_MI_TYPE = {1: "latin-1", 2: "latin-1", 16: "utf-8"}
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_REVISION = re.compile(r"Revision (\d+\.\d+)")
_QUOTED_NAME = re.compile(r'"([^"]*)"$')
_KNOWN_REVISIONS = frozenset({"2.0", "2.1"})
_MAX_EAGER_ELEMENTS = 64
"""Number of elements above which an array of a v7.3 file is loaded only when it is needed."""


def recognise(path: Path) -> bool:
    """Return whether a file is a MAT file of version 5 or 7.3, by its first bytes."""
    head = read_head(path, 1024)
    starts = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")
    return head.startswith(starts) or head[512:520] == _HDF5_SIGNATURE


def read(path: Path, *, channels: Sequence[ChannelChoice] | None = None) -> Recording:
    """Read a ControlDesk MAT file.

    Parameters
    ----------
    path : the export
    channels : names or paths of the wanted channels, None for all; only these are loaded from
        v7.3 files

    Returns
    -------
    The recording.

    Raises
    ------
    ReadError
        If the file is damaged, does not contain exactly one struct with X and Y, has an unknown
        revision, or lacks a wanted channel.
    """
    with _open_variables(path) as (variables, header_text):
        structs = {
            name: items[0]
            for name, items in variables.items()
            if isinstance(items, list)
            and items
            and isinstance(items[0], dict)
            and {"X", "Y"} <= items[0].keys()
        }
        if len(structs) != 1:
            names = ", ".join(list(structs or variables)[:5]) or "nothing"
            raise ReadError.about("readers.no_struct", path, count=len(structs), names=names)
        ((name, tree),) = structs.items()
        export = _parse_struct(name, tree, header_text, path)
        return load_export(export, reader="dspace-mat", path=path, channels=channels)


@contextmanager
def _open_variables(path: Path) -> Iterator[tuple[Mapping[str, MatValue], str]]:
    """Open a v5 or v7.3 file, and yield its variables and its header text.

    The header text contains the date of saving. Large arrays of a v7.3 file can be loaded while the
    file is open.
    """
    head = read_head(path, 1024)
    header_text = head[:116].decode("latin-1").strip(" \0")
    if head[512:520] != _HDF5_SIGNATURE:
        with map_read_errors(path, "a complete MAT v5 file"):
            mat5_variables = parse_mat5(np.fromfile(path, dtype=np.uint8).data)
        yield mat5_variables, header_text
        return
    import h5py

    with map_read_errors(path, "a whole MAT v7.3 file"):
        file = h5py.File(path, "r")
    with file:
        with map_read_errors(path, "a whole MAT v7.3 file"):
            _refuse_links(file)
            size = path.stat().st_size
            variables = {k: _convert_node(file[k], file, size) for k in file if k != "#refs#"}
        yield variables, header_text


def _convert_node(node: Any, file: h5py.File, file_size: int) -> MatValue:
    """Convert a group to a struct array, or a dataset to a value; the file size is in bytes."""
    import h5py

    if not isinstance(node, h5py.Group):
        return _convert_dataset(node, file, file_size)
    _refuse_links(node)
    references = {key: np.ravel(item[()]) for key, item in node.items() if _has_references(item)}
    if not references:
        return [{key: _convert_node(item, file, file_size) for key, item in node.items()}]
    return [
        {key: _convert_node(file[refs[i]], file, file_size) for key, refs in references.items()}
        for i in range(min(map(len, references.values())))
    ]


def _refuse_links(group: h5py.Group) -> None:
    """Raise ValueError if a member of a group is a link to another file."""
    import h5py

    for name in group:
        is_external = isinstance(group.get(name, getlink=True), h5py.ExternalLink)
        require(not is_external, f"{group.name.strip('/')}/{name} is a link into another file")


def _has_references(item: Any) -> bool:
    """Return whether an item of a group is a dataset of references to other objects."""
    import h5py

    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is not None


def _convert_dataset(dataset: h5py.Dataset, file: h5py.File, file_size: int) -> MatValue:
    """Convert a dataset to text, a list or an array; return a large dataset, which loads later."""
    max_deflate_ratio = 1100  # the largest compression ratio of deflate is 1032
    is_text = dataset.attrs.get("MATLAB_class") == b"char"
    if dataset.attrs.get("MATLAB_empty"):
        return "" if is_text else np.empty(0)
    if _has_references(dataset):
        return [_convert_node(file[ref], file, file_size) for ref in np.ravel(dataset[()])]
    is_external = dataset.is_virtual or bool(dataset.external)
    require(not is_external, f"{dataset.name} keeps its samples in another file")
    dimensions = zip(dataset.shape, dataset.chunks or (), strict=dataset.chunks is not None)
    has_all_samples = dataset.size <= _MAX_EAGER_ELEMENTS or (
        dataset.id.get_storage_size() >= dataset.nbytes
        if dataset.chunks is None
        else dataset.id.get_num_chunks() >= prod(ceil(n / chunk) for n, chunk in dimensions)
    )
    is_possible = dataset.nbytes <= max_deflate_ratio * file_size and has_all_samples
    require(is_possible, f"{dataset.name} claims {dataset.nbytes} bytes in a file of {file_size}")
    if is_text:
        code_units = np.asarray(dataset[()]).T.astype("<u2")
        return code_units.tobytes().decode("utf-16-le", errors="replace")
    return dataset if dataset.size > _MAX_EAGER_ELEMENTS else np.asarray(dataset[()])


def _parse_struct(name: str, tree: Mapping[str, MatValue], header_text: str, path: Path) -> Export:
    """Parse the struct of an export, with its time axes X and channels Y."""
    axes, traces = _get_structs(tree, "X", path), _get_structs(tree, "Y", path)
    properties = {key: to_json(item) for key, item in tree.items() if key not in {"X", "Y"}}
    general_date = _find_text(properties, "Description", "General", "DateTime")
    stated_date = general_date or _find_text(properties, "Capture", "DateTime")
    revision = _get_revision(properties, path)
    is_known = revision in _KNOWN_REVISIONS
    note = QualityNote.of("readers.revision_unseen", "file", revision=revision or "not stated")
    return Export(
        axes=[
            Axis(
                _find_text(axis, "Raster"), _find_text(axis, "Unit"), _build_loader(axis, "X", path)
            )
            for axis in axes
        ],
        traces=[_make_trace(item, len(axes), path) for item in traces],
        origin=_find_text(properties, "Description", "General", "Origin"),
        metadata={
            "variable": name,
            "created": header_text,
            "revision": revision,
            "date": resolve_date(stated_date, parse_save_date(header_text)),
            **properties,
        },
        notes=() if is_known else (note,),
    )


def _get_structs(tree: Mapping[str, MatValue], field: str, path: Path) -> list[dict[str, MatValue]]:
    """Get the structs in a field, or raise ReadError if one of them has no samples."""
    items = tree[field]
    if isinstance(items, list) and all(isinstance(item, dict) and "Data" in item for item in items):
        return items
    raise ReadError.about("readers.no_data", path, f"field {field}")


def _make_trace(item: Mapping[str, MatValue], n_axes: int, path: Path) -> Trace:
    """Make the trace of a channel from its struct, or raise ReadError if it has no time axis."""
    properties = {key: to_json(value) for key, value in item.items() if key != "Data"}
    name, folder = _find_text(properties, "Name"), _find_text(properties, "Path")
    quoted_name = _QUOTED_NAME.search(name)  # revision 2.0 has the whole quoted path in Name
    full_path = f"{folder}/{name}" if folder else name
    index = properties.get("XIndex", 1)
    if index not in range(1, n_axes + 1):
        place = f"channel '{full_path}', XIndex"
        raise ReadError.about("readers.no_axis", path, place, count=n_axes, index=index)
    return Trace(
        name=quoted_name.group(1) if quoted_name else name,
        path=full_path,
        unit_in_file=_find_text(properties, "Unit"),
        axis_index=int(float(str(index))) - 1,
        load=_build_loader(item, full_path, path),
        properties=properties,
    )


def _build_loader(item: Mapping[str, MatValue], name: str, path: Path) -> Callable[[], object]:
    """Build a function that loads the samples of an axis or a channel as float64."""

    def load() -> object:
        with map_read_errors(path, f"the samples of {name}"):
            data = np.asarray(item["Data"])
            is_numeric = data.dtype.kind in "biuf"
            require(is_numeric, f"{name} contains {data.dtype} instead of numbers")
            return data.astype(np.float64, copy=False)

    return load


def _find_text(tree: object, *keys: str) -> str:
    """Find the text at nested keys; empty if there is none."""
    for key in keys:
        node = tree[0] if isinstance(tree, list) and tree else tree
        tree = node.get(key) if isinstance(node, Mapping) else None
    return tree if isinstance(tree, str) else ""


def _get_revision(properties: Mapping[str, object], path: Path) -> str:
    """Get the revision of the format, empty if not stated, or raise ReadError if it is not 2.x."""
    info = properties.get("Info")
    numbers = [
        info.get(key) if isinstance(info, Mapping) else None
        for key in ("RevisionMajor", "RevisionMinor")
    ]
    match = _REVISION.search(_find_text(properties, "Description", "GeneratorVersion"))
    revision = match[1] if match else ""
    if all(isinstance(number, int | float) for number in numbers):
        revision = ".".join(f"{number:g}" for number in numbers)
    if revision and not revision.startswith("2."):
        raise ReadError.about("readers.revision", path, "Info", revision=revision)
    return revision


@dataclass(slots=True)
class _Cursor:
    """A position among the elements of a MAT v5 file.

    Parameters
    ----------
    data : bytes of the elements
    byte_order : byte order of the file, ``<`` or ``>``
    position : number of bytes before the next element
    """

    data: memoryview
    byte_order: str
    position: int = 0

    def read_element(self) -> tuple[int, memoryview]:
        """Read the type and the bytes of the next element, and advance beyond its padding."""
        n_left, n_bytes = len(self.data) - self.position, len(self.data)
        require(n_left >= 8, f"ends after {n_bytes} bytes, within the tag of an element")
        mi_type, size = struct.unpack_from(self.byte_order + "II", self.data, self.position)
        start = self.position + 8
        padded_size = size if mi_type == _MI_COMPRESSED else -(-size // 8) * 8
        if mi_type >> 16:  # a small element has size and type in one word, and then its data
            size, mi_type, start, padded_size = mi_type >> 16, mi_type & 0xFFFF, start - 4, 0
        n_left = n_bytes - start
        require(size <= n_left, f"an element of {size} bytes with {n_left} bytes left")
        self.position = min(self.position + 8 + padded_size, len(self.data))
        return mi_type, self.data[start : start + size]

    def read_numbers(self) -> np.ndarray:
        """Read the numbers of the next element, in the type in which they are stored."""
        mi_type, data = self.read_element()
        require(mi_type in _DTYPE_BY_MI_TYPE, f"type {mi_type} instead of numbers")
        array: np.ndarray = np.frombuffer(data, dtype=self.byte_order + _DTYPE_BY_MI_TYPE[mi_type])
        return array


def parse_mat5(content: bytes | memoryview) -> dict[str, MatValue]:
    """Parse the variables of a MAT file of version 5 (MathWorks, *MAT-File Format*, level 5).

    `scipy.io.loadmat` is not used, because it crashes the process (segmentation fault, SciPy 1.17)
    on some damaged files.

    Parameters
    ----------
    content : bytes of the whole file

    Returns
    -------
    Values of the variables, keyed by name. A struct array is a list of mappings, one for each
    element. A cell array is a list of values. A text of one row is a string. Numbers are an array
    of shape (n,) in the type in which they are stored. Sparse, complex, function and opaque
    variables are None.

    Raises
    ------
    ValueError, struct.error, zlib.error, LookupError
        If the file is cut off or damaged.
    """
    header_bytes = 128
    byte_order = ">" if content[126:128] == b"MI" else "<"
    cursor = _Cursor(memoryview(content), byte_order, header_bytes)
    variables: dict[str, MatValue] = {}
    while cursor.position < len(content):
        mi_type, data = cursor.read_element()
        if mi_type == _MI_COMPRESSED:
            mi_type, data = _Cursor(memoryview(zlib.decompress(data)), byte_order).read_element()
        if mi_type == _MI_MATRIX:
            name, value = _parse_matrix(_Cursor(data, cursor.byte_order))
            variables[name] = value
    return variables


def _parse_matrix(cursor: _Cursor) -> tuple[str, MatValue]:
    """Parse the name and the value of one array; the value is empty if the array has no bytes."""
    cell_class, struct_class, object_class, char_class = 1, 2, 3, 4
    complex_flag = 0x0800
    if not len(cursor.data):
        return "", np.empty(0)
    flags = int(cursor.read_numbers()[0])
    n_elements = int(np.prod([int(n) for n in cursor.read_numbers()], dtype=object))
    _, name = cursor.read_element()
    array_class = flags & 0xFF
    value: MatValue = None
    if array_class == object_class:
        cursor.read_element()  # skips the name of the class
    if array_class in {struct_class, object_class}:
        value = _parse_struct_array(cursor, n_elements)
    elif array_class == cell_class:
        value = [_parse_element(cursor) for _ in _make_range(n_elements, cursor)]
    elif array_class == char_class:
        value = _parse_text(cursor)
    elif array_class in _NUMERIC_CLASSES and not flags & complex_flag:
        value = cursor.read_numbers()
        require(len(value) == n_elements, f"{len(value)} numbers instead of {n_elements}")
    return bytes(name).decode("latin-1"), value


def _parse_element(cursor: _Cursor) -> MatValue:
    """Parse the value of the next element, which must be an array."""
    mi_type, data = cursor.read_element()
    require(mi_type == _MI_MATRIX, f"type {mi_type} instead of an array")
    return _parse_matrix(_Cursor(data, cursor.byte_order))[1]


def _parse_struct_array(cursor: _Cursor, n_elements: int) -> list[dict[str, MatValue]]:
    """Parse the elements of a struct array, each of which has the values of all fields in order."""
    width = int(cursor.read_numbers()[0])
    _, padded_names = cursor.read_element()
    text = bytes(padded_names)  # all names of fields, each padded with NUL to the same width
    if not text or width < 1:
        return []
    names = [text[i : i + width].split(b"\0")[0] for i in range(0, len(text), width)]
    fields = [name.decode("latin-1") for name in names]
    elements = _make_range(n_elements, cursor)
    return [{field: _parse_element(cursor) for field in fields} for _ in elements]


def _make_range(n_elements: int, cursor: _Cursor) -> range:
    """Make the range of some elements, or raise ValueError if each has less than eight bytes."""
    is_possible = 0 <= n_elements <= len(cursor.data) // 8
    require(is_possible, f"{n_elements} parts in {len(cursor.data)} bytes")
    return range(n_elements)


def _parse_text(cursor: _Cursor) -> str:
    """Parse the text of the next element, whose type states the encoding."""
    utf16_types = {4, 17}
    mi_type, data = cursor.read_element()
    if mi_type in utf16_types:
        encoding = "utf-16-le" if cursor.byte_order == "<" else "utf-16-be"
        return bytes(data).decode(encoding, errors="replace")
    return bytes(data).decode(_ENCODING_BY_MI_TYPE[mi_type], errors="replace")
