"""Numbers whose decimal sign a spreadsheet took for a sign between thousands, and then left out.

From 1.063, 1.110797 and 1.162 become 1063, 1110797 and 1162: whole numbers of which those with
more decimals are a thousand times too large. The digits cannot be given back their places.
"""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from labpipe.errors import complaint
from labpipe.records.arrays import Flags, Floats

LOST = (
    "A spreadsheet took the decimal sign for a sign between thousands and the digits are lost:"
    " export the test again and do not save it from a spreadsheet."
)

_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3}){2,}|[+-]?\d{1,3}(\.\d{3}){2,}")
_FACTORS = (1e3, 1e6)
_NEAR = 1.5
"""Two jumps count as of one thousand if both are so up to this factor."""
_WITHIN = 10
"""Samples between the jump and the one back."""
_LEAST = 100.0
"""Smaller whole numbers are counters and codes."""
_SPREAD = 0.01
"""Beside the step between the two neighbours, a number may lie so far from them."""
_LOOK = 1000


def is_grouped(cell: str) -> bool:
    """Tell whether a cell has two signs between thousands: no number is written so."""
    return _GROUPED.fullmatch(cell) is not None


def lost_signs(path: object, place: str, before: str, after: str) -> str:
    """Word the error for a column that jumps a thousandfold and back.

    Parameters
    ----------
    path, place : of the first number behind the jump
    before, after : the numbers on both sides of it
    """
    return complaint(
        path,
        place,
        expected="numbers that do not jump a thousandfold and back",
        found=f"'{after}' after '{before}'",
        remedy=LOST,
    )


def regrouped_at(values: Floats) -> tuple[int, int] | None:
    """Find where a column of whole numbers jumps a thousandfold and back.

    Parameters
    ----------
    values : one column, shape (rows,); NaN is passed over

    Returns
    -------
    Rows of the numbers before and behind the first such jump; None for a column of which more than
    half of the numbers have decimals, and for whole numbers without such jumps.

    Notes
    -----
    A jump counts if what lies between it and the one back, divided (or multiplied) by the thousand,
    falls among the two numbers beside it, as it does for a curve that lost its decimal signs. A
    spike or an overflow of a counter lies anywhere, and a multiple of a thousand lost no sign.
    Numbers with decimals in between are passed over: 0.5 and 1.25 have no group of three digits,
    and a spreadsheet leaves them as they are.
    """
    if not _are_mostly_whole(values[:_LOOK]) or not _are_mostly_whole(values):
        return None
    rows = np.flatnonzero(values == np.rint(values))
    found = (_first_jump(values[rows], factor) for factor in _FACTORS)
    firsts = [at for at in found if at is not None]
    return (int(rows[min(firsts)]), int(rows[min(firsts) + 1])) if firsts else None


def _are_mostly_whole(values: Floats) -> bool:
    whole = int(np.count_nonzero(values == np.rint(values)))
    return whole > 0 and 2 * whole >= int(np.count_nonzero(~np.isnan(values)))


def _first_jump(values: Floats, factor: float) -> int | None:
    size = np.abs(values)
    smaller, larger = np.minimum(size[:-1], size[1:]), np.maximum(size[:-1], size[1:])
    same_sign = values[:-1] * values[1:] > 0.0
    ratio = larger / np.maximum(smaller, _LEAST)
    near: Flags = (ratio > factor / _NEAR) & (ratio < factor * _NEAR) & (smaller >= _LEAST)
    jumps = np.flatnonzero(near & same_sign & (larger % 1000.0 != 0.0))
    for up, down in pairwise(jumps):
        if down - up <= _WITHIN and _returns(size[up : down + 2], factor):
            return int(up)
    return None


def _returns(run: Floats, factor: float) -> bool:
    """Tell whether the inner numbers, once scaled, fall among the first and the last one."""
    ends, inner = run[[0, -1]], run[1:-1]
    scaled = inner / factor if inner[0] > ends[0] else inner * factor
    spread = abs(ends[1] - ends[0]) + _SPREAD * ends.max()
    return bool(np.all((scaled >= ends.min() - spread) & (scaled <= ends.max() + spread)))
