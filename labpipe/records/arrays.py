"""Array types, the freezing of the arrays that records hold, medians, and runs of flags."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Flags: TypeAlias = NDArray[np.bool_]


def frozen(values: object, *, shape: tuple[int | None, ...]) -> Floats:
    """Give back `values` as a read-only float64 array of the stated shape.

    Parameters
    ----------
    values : anything numpy turns into an array; an array that is float64 already is not copied
    shape : the length wanted on each axis, None where any length will do

    Returns
    -------
    A read-only view.

    Raises
    ------
    ValueError
        If the shape is another one.
    """
    array: Floats = np.asarray(values, dtype=np.float64).view()
    fits = array.ndim == len(shape) and all(
        want in (None, got) for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        message = f"expected an array of shape {shape}, found {array.shape}"
        raise ValueError(message)
    array.flags.writeable = False
    return array


def median(values: Floats) -> float:
    """Median of some numbers.

    Parameters
    ----------
    values : shape (n,)

    Returns
    -------
    As `numpy.median`, in a fifth of its time: that one asks for three places of the order at once,
    which numpy has no quick way to find, and loads masked arrays. NaN if a value is NaN, or there
    is none.

    Examples
    --------
    >>> median(np.array([4.0, 1.0, 2.0, 9.0]))
    3.0
    """
    if len(values) == 0:
        return float("nan")
    half = len(values) // 2
    ordered = np.partition(values, half)
    if np.isnan(ordered[half:].max()):
        return float("nan")
    upper = float(ordered[half])
    return upper if len(values) % 2 else 0.5 * (float(ordered[:half].max()) + upper)


def stretches_of(flags: Flags) -> list[tuple[int, int]]:
    """Find the runs of flagged samples.

    Parameters
    ----------
    flags : shape (n,)

    Returns
    -------
    First sample of each run, and the first one behind it.
    """
    edges = np.flatnonzero(np.diff(np.pad(flags.astype(np.int8), 1)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def times_of(flags: Flags, time: Floats) -> tuple[tuple[float, float], ...]:
    """Tell when samples are flagged.

    Parameters
    ----------
    flags, time : shape (n,)

    Returns
    -------
    First and last time of each run, s.
    """
    return tuple((float(time[start]), float(time[end - 1])) for start, end in stretches_of(flags))
