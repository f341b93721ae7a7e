"""Results of fits: an estimate with its standard error, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from labpipe.records.curve import Interval
from labpipe.records.quality import Reason


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard error.

    Parameters
    ----------
    value, error : in the same unit
    n : number of samples it rests on
    interval : 95 % interval where it is not the normal one of `error`: few degrees of freedom, or
        a number whose uncertainty is asymmetric
    """

    value: float
    error: float
    n: int
    interval: Interval | None = None


Failure = Reason
"""The reason why an estimate is not available."""


def widened(estimate: Estimate, *errors: float) -> Estimate:
    """Add independent standard errors to an estimate, in quadrature.

    Parameters
    ----------
    estimate : with or without an interval of its own
    errors : standard errors in the unit of the value, such as those of scale and zero

    Returns
    -------
    The estimate; each side of an interval of its own grows by the normal 95 % part of `errors`, in
    quadrature: an asymmetric interval stays so (GUM, JCGM 100:2008, sec. 5.1.3). What an uncertain
    input changes is such an error: compute the number twice, the second time with the input one
    standard uncertainty larger, and take the difference.
    """
    more = hypot(*errors)
    interval = estimate.interval
    if interval is not None and more > 0.0:
        added = Interval.normal_95(0.0, more).upper
        middle = _centre_of(estimate.value, interval)
        lower, upper = hypot(middle - interval.lower, added), hypot(interval.upper - middle, added)
        interval = Interval(middle - lower, middle + upper)
    return Estimate(estimate.value, hypot(estimate.error, more), estimate.n, interval)


def _centre_of(value: float, interval: Interval) -> float:
    """Return the value, or the middle of the interval if it does not contain the value.

    The bias from noise is subtracted from the interval, not from the number.
    """
    is_inside = interval.lower <= value <= interval.upper
    return value if is_inside else 0.5 * (interval.lower + interval.upper)
