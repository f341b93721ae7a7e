"""The normal distribution. scipy has it too, but importing that takes longer than all fits."""

from __future__ import annotations

from math import erfc, log, pi, sqrt

import numpy as np

from labpipe.records.arrays import Floats

_FAR = -30.0
"""Below this the share itself comes near the least number there is, and its series is exact."""
_SERIES = (-945.0, 105.0, -15.0, 3.0, -1.0, 1.0)


def log_share_below(x: Floats) -> Floats:
    """Logarithm of the share of the standard normal distribution that lies below x.

    Parameters
    ----------
    x : any shape; a few hundred numbers, not a record

    Returns
    -------
    Shape of `x`. NaN for NaN.

    Notes
    -----
    From the complementary error function; far down its asymptotic series, 26.2.12 of Abramowitz and
    Stegun, Handbook of Mathematical Functions, 1964.

    Examples
    --------
    >>> log_share_below(np.array([0.0, -40.0])).round(6).tolist()
    [-0.693147, -804.608442]
    """
    logs = [_log_share(each) for each in np.ravel(x).tolist()]
    return np.array(logs, dtype=np.float64).reshape(np.shape(x))


def _log_share(x: float) -> float:
    if x >= _FAR or x != x:  # noqa: PLR0124  NaN is the only number that is not itself
        return log(0.5 * erfc(-x / sqrt(2.0)))
    square = x * x
    series = float(np.polyval(_SERIES, 1.0 / square))
    return -0.5 * square - log(-x * sqrt(2.0 * pi)) + log(series)
