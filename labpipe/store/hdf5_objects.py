"""Datasets and attributes made by the calls of the HDF5 library itself.

h5py makes types, spaces and property lists anew for each of the hundreds of small things in a
result file; here they are made once. What is written is the same, in a third of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import h5py
import numpy as np
from h5py import h5a, h5d, h5p, h5s, h5t
from numpy.typing import NDArray

LEVEL: Final = 3
"""At levels 1 and 2 ISA-L (isal 1.9) now and then packs the same bytes otherwise in a thread."""
_STRING: Final = h5py.string_dtype()
_TEXT: Final = h5t.py_create(_STRING, logical=True)
_SCALAR: Final = h5s.create(h5s.SCALAR)
_IN_MEMORY: Final = h5t.py_create(_STRING)


def make_dataset(group: Any, name: str, values: NDArray[Any], chunk: tuple[int, ...]) -> Any:
    """Make a dataset for an array, without writing the array.

    Parameters
    ----------
    group : open, without anything of this name
    name : of the dataset
    values : any shape and number type; axes of length 0 may grow
    chunk : shape of the chunks, which go through shuffle, gzip and fletcher32

    Returns
    -------
    The dataset, which keeps no times.
    """
    most = tuple(size or h5s.UNLIMITED for size in values.shape)
    space = h5s.create_simple(values.shape, most)
    created = h5d.create(group.id, name.encode(), _type(values.dtype.str), space, _how(chunk))
    return h5py.Dataset(created)


def open_dataset(group: Any, name: str) -> Any:
    """Open a dataset that is there.

    Parameters
    ----------
    group : open
    name : of the dataset, or its path
    """
    return h5py.Dataset(h5d.open(group.id, name.encode()))


@lru_cache(maxsize=256)
def _type(kind: str) -> Any:
    made = h5t.py_create(np.dtype(kind), logical=True)
    if isinstance(made, h5t.TypeStringID):
        made.set_strpad(h5t.STR_NULLTERM)
    return made


@lru_cache(maxsize=256)
def _how(chunk: tuple[int, ...]) -> Any:
    made = h5p.create(h5p.DATASET_CREATE)
    made.set_obj_track_times(False)
    made.set_chunk(chunk)
    made.set_shuffle()
    made.set_deflate(LEVEL)
    made.set_fletcher32()
    return made


def set_text(owner: Any, name: str, text: str) -> None:
    """Write an attribute that is a text.

    Parameters
    ----------
    owner : open group or dataset, without an attribute of this name
    name, text : of the attribute
    """
    made = h5a.create(owner.id, name.encode(), _TEXT, _SCALAR)
    made.write(np.array(text, dtype=_STRING))


def get_text(owner: Any, name: str) -> Any:
    """Read an attribute that should be a text.

    Parameters
    ----------
    owner : open group or dataset
    name : of the attribute

    Returns
    -------
    The text; what h5py makes of it if it is none.

    Raises
    ------
    KeyError
        If there is no such attribute.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    found = h5a.open(owner.id, name.encode())
    kind = found.get_type()
    is_text = isinstance(kind, h5t.TypeStringID) and kind.is_variable_str() and found.shape == ()
    if not is_text:
        return owner.attrs[name]
    text = np.array("", dtype=_STRING)
    found.read(text, mtype=_IN_MEMORY)
    return bytes(text[()]).decode()


def has_attribute(owner: Any, name: str) -> bool:
    """Tell whether a group or dataset has an attribute.

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
        If it is no number.
    """
    found = h5a.open(owner.id, name.encode())
    if found.shape != () or found.get_type() != h5t.NATIVE_DOUBLE:
        return float(owner.attrs[name])
    value = np.empty((), dtype=np.float64)
    found.read(value)
    return float(value)


def is_empty(owner: Any, name: str) -> bool:
    """Tell whether an attribute that should be a list has no entry.

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
