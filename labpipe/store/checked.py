"""The way into a result file: opened, its schema known, every dataset as the layout wants it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import ceil, prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labpipe.errors import StoreError, complaint
from labpipe.store import layout
from labpipe.store.layout import Field
from labpipe.store.replace import is_cut_off

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
    return StoreError(complaint(file, place, expected=expected, found=found, remedy=remedy))


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
    return _word(group.attrs[name])


def texts(group: Any, name: str) -> tuple[str, ...]:
    """Read an attribute that is a list of strings."""
    return tuple(_word(word) for word in group.attrs[name])


def _word(value: object) -> str:
    """Take text that any file can hold: bytes that are no UTF-8 raise a ValueError."""
    word = str(value)
    word.encode()
    return word


def strings(group: Any, name: str, axis: str) -> tuple[str, ...]:
    """Read a dataset of strings."""
    encoded = array(group, name, Field((axis,), layout.TEXT, "text"))
    return tuple(bytes(word).decode() for word in encoded)


def arrays(group: Any, kinds: Mapping[str, Field]) -> dict[str, NDArray[Any]]:
    """Read several datasets, by name."""
    return {name: array(group, name, kind) for name, kind in kinds.items()}


def array(group: Any, name: str, kind: Field) -> NDArray[Any]:
    """Read a dataset whose unit, axes and number type are those of the layout."""
    dataset = group[name]
    _check(dataset, "axes", ", ".join(kind.axes), dataset.attrs.get("axes", "none"))
    if kind.unit is not None:
        _check(dataset, "unit", kind.unit, dataset.attrs.get("unit", "none"))
    if kind.dtype not in {"table", "text"}:
        _check(dataset, "number type", kind.dtype, str(dataset.dtype))
    _check_storage(dataset)
    values: NDArray[Any] = np.empty(dataset.shape, dataset.dtype)
    if values.size:
        dataset.read_direct(values)
    return values


def _check_storage(dataset: Any) -> None:
    """Refuse a dataset that is not here, or not all of it, before memory is taken for it."""
    file, name = dataset.file.filename, dataset.name
    if dataset.is_virtual or dataset.external:
        raise _elsewhere(file, name, "samples that are kept in another file")
    if dataset.chunks is None:
        has_all = dataset.id.get_storage_size() >= dataset.nbytes
    else:
        sizes = zip(dataset.shape, dataset.chunks, strict=True)
        has_all = dataset.id.get_num_chunks() >= prod(ceil(all_ / one) for all_, one in sizes)
    if not has_all:
        found = "a part of them"
        raise _fault(file, name, f"the {dataset.size} numbers that it claims", found, _AGAIN)


def _check(dataset: Any, what: str, expected: str, found: str) -> None:
    if expected != found:
        raise _fault(
            dataset.file.filename, dataset.name, f"{what} {expected!r}", repr(found), _AGAIN
        )
