"""Means of a few values with t-based intervals."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import special

from labpipe.records.curve import Interval
from labpipe.records.group import MeanInterval
from labpipe.records.quality import Reason

LEVEL = 0.95
"""Level of every interval: two-sided."""


def t_quantile(degrees: float, outside: float = 1.0 - LEVEL) -> float:
    """Quantile of Student's t that leaves a share outside, half of it on each side.

    Parameters
    ----------
    degrees : degrees of freedom, above 0
    outside : share outside; 0.05 for a 95 % interval

    Notes
    -----
    12.706, 4.303, 2.776 and 2.571 for 1, 2, 4 and 5 degrees of freedom, which is n = 2, 3, 5, 6.
    Equation (2.1) of the source prints another quantile; this is the one that covers.
    """
    return float(special.stdtrit(degrees, 1.0 - 0.5 * outside))


def mean_interval(values: Iterable[float], what: str = "value") -> MeanInterval:
    """Mean of independent values with its 95 % interval.

    Parameters
    ----------
    values : in any unit; NaN count as absent
    what : what one value is, for the sentence that says why there is no interval

    Returns
    -------
    mean -+ t s / sqrt(n) with n - 1 degrees of freedom. Without values the mean is NaN and the
    reason ``no_samples``; with one value there is no interval and the reason is ``one_sample``.
    """
    given = np.array(list(values), dtype=np.float64)
    known = given[~np.isnan(given)]
    n = len(known)
    if n == 0:
        reason = Reason("no_samples", f"there is no {what} to average")
        return MeanInterval(np.nan, None, np.nan, 0, reason)
    mean = float(known.mean())
    if n == 1:
        message = f"an interval needs the scatter of two values, there is one {what}"
        return MeanInterval(mean, None, np.nan, 1, Reason("one_sample", message))
    deviation = float(known.std(ddof=1))
    half = t_quantile(n - 1) * deviation / np.sqrt(n)
    return MeanInterval(mean, Interval(float(mean - half), float(mean + half)), deviation, n)
