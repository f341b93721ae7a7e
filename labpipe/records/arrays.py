"""Define array types, records with read-only arrays, and small functions of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Singles: TypeAlias = NDArray[np.float32]
Ints: TypeAlias = NDArray[np.int64]
Flags: TypeAlias = NDArray[np.bool_]
Samples: TypeAlias = slice | Ints
"""Samples along the last axis, in order: a slice if they are consecutive, otherwise indices."""
Vector: TypeAlias = Annotated[Floats, "n"]
"""Array of shape (n,); n is the same for all such arrays of a record."""

AXIS_LABELS: Final[Mapping[str, tuple[str, ...]]] = {
    "xyz": ("x", "y", "z"),
    "xyzw": ("x", "y", "z", "w"),
    "xy": ("x", "y"),
    "specimen": ("x", "y", "z"),
    "lab": ("x", "y", "z"),
}
"""Labels along each axis that has a fixed length, keyed by the name of the axis."""


@dataclass(frozen=True, slots=True)
class Unit:
    """Annotation of a field with its SI unit.

    Parameters
    ----------
    symbol : symbol of the unit; empty if another field has the unit
    unit_field : name of that field, in the same record or in the record that contains it
    """

    symbol: str = ""
    unit_field: str = ""


class ArrayRecord:
    """Base class of frozen records, which checks the shapes of arrays and makes them read-only.

    The type of a field names its axes: ``Annotated[Floats, "frame", "xyz", Unit("m")]``. An axis is
    a length, a key of `AXIS_LABELS`, the name of a tuple field with as many entries, or any other
    word. All arrays and tuples of a record have the same length along axes with the same word. An
    array is converted to the number type of its field; an array of that type is not copied.

    Raises
    ------
    ValueError
        If an array does not have the shape that the type of its field states.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        record_type: Any = type(self)
        arrays, tuples, fixed_lengths = _list_fields_with_axes(record_type)
        lengths = {axis: len(getattr(self, name)) for name, axis in tuples} | fixed_lengths
        for name, dtype, axes in arrays:
            array = np.asarray(getattr(self, name), dtype=dtype).view()
            shape = tuple(map(lengths.get, axes))  # None for a length that is not known yet
            lengths = dict(zip(axes, array.shape, strict=False)) | lengths
            if array.shape != tuple(map(lengths.get, axes)):
                message = f"expected {name} of shape {shape}, found {array.shape}"
                raise ValueError(message)
            array.flags.writeable = False
            object.__setattr__(self, name, array)


def get_number_type(array_type: Any) -> Any:
    """Return the number type of an array type, such as ``numpy.float64`` of `Floats`."""
    return get_args(get_args(array_type)[1])[0]


@cache
def _list_fields_with_axes(
    record_type: Any,
) -> tuple[list[tuple[str, Any, tuple[Any, ...]]], list[tuple[str, Any]], dict[Any, int]]:
    """List name, number type and axes of arrays, name and axis of tuples, and fixed lengths."""
    arrays, tuples = [], []
    fixed_lengths: dict[Any, int] = {name: len(labels) for name, labels in AXIS_LABELS.items()}
    for name, hint in get_type_hints(record_type, include_extras=True).items():
        field_type, *annotations = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        axes = tuple(axis for axis in annotations if isinstance(axis, str | int))
        if axes and get_origin(field_type) is np.ndarray:
            arrays.append((name, get_number_type(field_type), axes))
            fixed_lengths |= {axis: axis for axis in axes if isinstance(axis, int)}
        elif get_origin(field_type) is tuple:
            tuples.append((name, axes[0] if axes else name))
    return arrays, tuples, fixed_lengths


def median(values: Floats) -> float:
    """Return the median of an array.

    Parameters
    ----------
    values : shape (n,)

    Returns
    -------
    Median in the unit of `values`; NaN if a value is NaN, or if there are no values.

    Notes
    -----
    The result equals that of `numpy.median`, which usually takes five times as long or more: it
    partitions at three positions and imports masked arrays.

    Examples
    --------
    >>> median(np.array([4.0, 1.0, 2.0, 9.0]))
    3.0
    """
    if len(values) == 0:
        return float("nan")
    middle = len(values) // 2
    partition = np.partition(values, middle)
    if np.isnan(partition[middle:].max()):
        return float("nan")
    upper = float(partition[middle])
    return upper if len(values) % 2 else 0.5 * (float(partition[:middle].max()) + upper)


def drop_missing(values: Floats) -> Floats:
    """Return the values that are not NaN.

    Parameters
    ----------
    values : shape (n,)

    Returns
    -------
    Shape (m,), in the unit of `values`; to avoid a copy, `values` itself if no value is NaN.
    """
    is_missing = np.isnan(values)
    return values[~is_missing] if is_missing.any() else values


def compute_median_step(time: Floats) -> float:
    """Compute the median time step of a clock.

    Parameters
    ----------
    time : shape (n,), s, n > 1

    Returns
    -------
    Median step, s. For 200 000 samples or more, it is the median of at least 100 000 steps that
    are evenly spread over the record.

    Notes
    -----
    `numpy.median` is used, because for steps with few different values `median` can take ten times
    as long.
    """
    stride = max(1, len(time) // 100_000)
    return float(np.median(time[1::stride] - time[:-1:stride]))


def average_between(values: Floats, starts: Ints) -> Floats:
    """Compute the mean of each block of samples between consecutive starts.

    Parameters
    ----------
    values : shape (n,); a NaN makes the mean of its block NaN
    starts : shape (m,), index of the first sample of each block, strictly increasing from 0

    Returns
    -------
    Shape (m,), in the unit of `values`; the last block ends with the last sample.
    """
    block_sizes = np.diff(np.append(starts, len(values)))
    return np.asarray(np.add.reduceat(values, starts) / block_sizes)


def average_blocks(values: Floats, min_blocks: int, *, has_remainder: bool = True) -> Floats:
    """Average blocks of equal numbers of consecutive samples; decimation would alias.

    Parameters
    ----------
    values : shape (n,); a NaN makes the mean of its block NaN
    min_blocks : minimum number of blocks, if there are as many samples
    has_remainder : whether the last block includes the remaining samples, which do not fill a
        block; without them, the noise of all means is equal

    Returns
    -------
    Shape (m,), means in the unit of `values`; `min_blocks` <= m < 2 `min_blocks` if
    n >= `min_blocks`.
    """
    block_size = max(1, len(values) // min_blocks)
    values = values if has_remainder else values[: len(values) // block_size * block_size]
    starts = np.arange(0, max(len(values) - block_size + 1, 1), block_size)
    return average_between(values, starts) if len(values) else values


def divide(numerator: Floats, denominator: Floats) -> Floats:
    """Divide two arrays; the quotient is NaN where the denominator is zero.

    Parameters
    ----------
    numerator, denominator : arrays of shapes that broadcast
    """
    shape = np.broadcast_shapes(np.shape(numerator), np.shape(denominator))
    quotient: Floats = np.full(shape, np.nan)
    np.divide(numerator, denominator, out=quotient, where=np.not_equal(denominator, 0.0))
    return quotient


def find_runs(flags: Flags) -> list[tuple[int, int]]:
    """Find the runs of flagged samples.

    Parameters
    ----------
    flags : shape (n,), whether each sample is flagged

    Returns
    -------
    For each run, the indices of its first sample and of the first sample after it.
    """
    edges = np.flatnonzero(np.diff(np.pad(flags.astype(np.int8), 1)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def convert_to_slice(indices: Ints) -> Samples:
    """Convert indices of samples to a slice if they are consecutive, to avoid copies.

    Parameters
    ----------
    indices : shape (m,), indices of samples, strictly increasing

    Returns
    -------
    The slice, or `indices` if they are not consecutive.

    Examples
    --------
    >>> convert_to_slice(np.array([3, 4, 5])), convert_to_slice(np.array([3, 5]))
    (slice(3, 6, None), array([3, 5]))
    """
    if not len(indices):
        return slice(0, 0)
    samples = slice(int(indices[0]), int(indices[-1]) + 1)
    return samples if samples.stop - samples.start == len(indices) else indices


def find_run_times(flags: Flags, time: Floats) -> tuple[tuple[float, float], ...]:
    """Find the times of the first and last sample of each run of flagged samples.

    Parameters
    ----------
    flags : shape (n,), whether each sample is flagged
    time : shape (n,), s

    Returns
    -------
    First and last time of each run, s.
    """
    return tuple((float(time[start]), float(time[stop - 1])) for start, stop in find_runs(flags))
