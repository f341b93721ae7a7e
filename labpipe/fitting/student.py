"""Student's t for whole degrees of freedom.

scipy has it too, but importing its special functions takes longer than all fits of a test.
"""

from __future__ import annotations

from functools import cache
from math import lgamma

import numpy as np

from labpipe.records.arrays import Floats

_ROW = 8
_MOST_STEPS = 60


def share_within(t: Floats, freedom: int) -> Floats:
    """Share of Student's distribution between -t and t, negative for a negative t.

    Parameters
    ----------
    t : any shape
    freedom : degrees of freedom, at least 1

    Returns
    -------
    Shape of `t`: the difference of the distribution function at t and at -t. NaN for NaN.

    Raises
    ------
    ValueError
        For less than one degree of freedom.

    Notes
    -----
    The finite series 26.7.3 and 26.7.4 of Abramowitz and Stegun, Handbook of Mathematical
    Functions, 1964, in the angle whose tangent is t / sqrt(freedom). None of its terms is negative,
    so that only rounding is lost: about 1e-15 in absolute terms.

    Examples
    --------
    >>> round(float(share_within(np.array(2.228138851986274), 10)), 12)
    0.95
    """
    if freedom < 1:
        message = f"expected at least one degree of freedom, found {freedom}"
        raise ValueError(message)
    angle = np.arctan(t / np.sqrt(freedom))
    series = _polynomial(_series(freedom), np.cos(angle) ** 2)
    if freedom % 2 == 0:
        return np.asarray(np.sin(angle) * series, dtype=np.float64)
    more = np.sin(angle) * np.cos(angle) * series if freedom > 1 else 0.0
    return np.asarray((angle + more) * (2.0 / np.pi), dtype=np.float64)


@cache
def _series(freedom: int) -> Floats:
    """Coefficients of the series, filled up with zeros to whole rows of `_ROW`."""
    orders = np.arange(2 + freedom % 2, freedom, 2)
    ratios = np.append(1.0, (orders - 1.0) / orders)
    rows = np.zeros((-(-len(ratios) // _ROW), _ROW))
    rows.flat[: len(ratios)] = np.cumprod(ratios)
    return rows


def _polynomial(coefficients: Floats, x: Floats) -> Floats:
    """Horner's scheme in x^8, on rows of eight terms each: an eighth of the passes over x."""
    powers = np.vander(x.ravel(), _ROW + 1, increasing=True).T
    rows = coefficients @ powers[:_ROW]
    total = rows[-1]
    for row in rows[-2::-1]:
        total = total * powers[_ROW] + row
    values: Floats = total.reshape(x.shape)
    return values


def density(t: Floats, freedom: int) -> Floats:
    """Density of Student's distribution.

    Parameters
    ----------
    t : any shape
    freedom : degrees of freedom, at least 1

    Returns
    -------
    Shape of `t`. NaN for NaN.

    Examples
    --------
    >>> round(float(density(np.array(0.0), 1)), 12)
    0.318309886184
    """
    log_top = lgamma(0.5 * (freedom + 1)) - lgamma(0.5 * freedom)
    found: Floats = np.exp(log_top - 0.5 * (freedom + 1) * np.log1p(t * t / freedom))
    found /= np.sqrt(np.pi * freedom)
    return found


@cache
def half_width(share: float, freedom: int) -> float:
    """Half width around zero that holds a share of Student's distribution.

    Parameters
    ----------
    share : between 0 and 1, such as 0.95
    freedom : degrees of freedom, at least 1

    Returns
    -------
    The t whose `share_within` is `share`.

    Notes
    -----
    Newton's steps from zero: the share that a half width holds is concave, so they do not
    overshoot.

    Examples
    --------
    >>> round(half_width(0.95, 10), 12)
    2.228138851986
    """
    t, step = np.zeros(1), np.ones(1)
    for _ in range(_MOST_STEPS):
        if not np.abs(step).max() > 1e-14 * np.abs(t).max():
            break
        step = (share - share_within(t, freedom)) / (2.0 * density(t, freedom))
        t = t + step
    return float(t[0])
