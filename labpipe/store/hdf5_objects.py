"""Datasets and attributes written with low-level calls of the HDF5 library.

h5py creates types, spaces and property lists again for each of the hundreds of small objects in a
result file; here they are created once. The content is the same, in a third of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import h5py
import numpy as np
from h5py import h5a, h5d, h5p, h5s, h5t
from numpy.typing import NDArray

COMPRESSION_LEVEL: Final = 3
"""At levels 1 and 2 ISA-L (isal 1.9) sometimes compresses equal bytes differently in a thread."""
_STRING: Final = h5py.string_dtype()
_TEXT: Final = h5t.py_create(_STRING, logical=True)
_SCALAR: Final = h5s.create(h5s.SCALAR)
_IN_MEMORY: Final = h5t.py_create(_STRING)


def make_dataset(group: Any, name: str, values: NDArray[Any], chunk: tuple[int, ...]) -> Any:
    """Create a dataset for an array, without writing the array.

    Parameters
    ----------
    group : open, without an object of this name
    name : of the dataset
    values : any shape and number type; axes of length 0 may grow
    chunk : shape of the chunks, which go through shuffle, gzip and fletcher32

    Returns
    -------
    The dataset, without time stamps.
    """
    max_shape = tuple(size or h5s.UNLIMITED for size in values.shape)
    space = h5s.create_simple(values.shape, max_shape)
    data_type, properties = _type(values.dtype.str), _properties(chunk)
    return h5py.Dataset(h5d.create(group.id, name.encode(), data_type, space, properties))


def open_dataset(group: Any, name: str) -> Any:
    """Open an existing dataset.

    Parameters
    ----------
    group : open
    name : of the dataset, or its path
    """
    return h5py.Dataset(h5d.open(group.id, name.encode()))


@lru_cache(maxsize=256)
def _type(dtype_text: str) -> Any:
    hdf5_type = h5t.py_create(np.dtype(dtype_text), logical=True)
    if isinstance(hdf5_type, h5t.TypeStringID):
        hdf5_type.set_strpad(h5t.STR_NULLTERM)
    return hdf5_type


@lru_cache(maxsize=256)
def _properties(chunk: tuple[int, ...]) -> Any:
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
    name, text : of the attribute
    """
    attribute = h5a.create(owner.id, name.encode(), _TEXT, _SCALAR)
    attribute.write(np.array(text, dtype=_STRING))


def get_text(owner: Any, name: str) -> Any:
    """Read an attribute that should be a text.

    Parameters
    ----------
    owner : open group or dataset
    name : of the attribute

    Returns
    -------
    The text; the value of h5py if it is not a text.

    Raises
    ------
    KeyError
        If there is no such attribute.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    attribute = h5a.open(owner.id, name.encode())
    data_type = attribute.get_type()
    is_variable = isinstance(data_type, h5t.TypeStringID) and data_type.is_variable_str()
    if not is_variable or attribute.shape != ():
        return owner.attrs[name]
    text = np.array("", dtype=_STRING)
    attribute.read(text, mtype=_IN_MEMORY)
    return bytes(text[()]).decode()


def has_attribute(owner: Any, name: str) -> bool:
    """Return whether a group or dataset has an attribute.

    Parameters
    ----------
    owner : open group or dataset
    name : of the attribute
    """
    return bool(h5a.exists(owner.id, name.encode()))


def get_number(owner: Any, name: str) -> float:
    """Read an attribute that should be a number.

    Parameters
    ----------
    owner : open group or dataset
    name : of the attribute

    Raises
    ------
    KeyError
        If there is no such attribute.
    TypeError, ValueError
        If it is not a number.
    """
    attribute = h5a.open(owner.id, name.encode())
    if attribute.shape != () or attribute.get_type() != h5t.NATIVE_DOUBLE:
        return float(owner.attrs[name])
    value = np.empty((), dtype=np.float64)
    attribute.read(value)
    return float(value)


def is_empty(owner: Any, name: str) -> bool:
    """Return whether an attribute that should be a list is empty.

    Parameters
    ----------
    owner : open group or dataset
    name : of the attribute

    Raises
    ------
    KeyError
        If there is no such attribute.
    """
    return bool(h5a.open(owner.id, name.encode()).shape == (0,))


def set_texts(owner: Any, name: str, texts: Sequence[str]) -> None:
    """Write an attribute that is a list of texts, as `set_text`."""
    space = h5s.create_simple((len(texts),))
    h5a.create(owner.id, name.encode(), _TEXT, space).write(np.array(texts, dtype=_STRING))


def set_number(owner: Any, name: str, number: float) -> None:
    """Write an attribute that is a number, int64 or float64, as `set_text`."""
    value = np.array(number)
    h5a.create(owner.id, name.encode(), _type(value.dtype.str), _SCALAR).write(value)
