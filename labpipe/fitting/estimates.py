"""What a fitter gives back: an estimate with its standard error, or the reason there is none."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from labpipe.records.curve import Interval


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard error.

    Parameters
    ----------
    value, error : in the same unit
    n : number of samples it rests on
    interval : 95 % interval where it is not the normal one of `error`: few degrees of freedom, or
        a number whose uncertainty is lopsided
    """

    value: float
    error: float
    n: int
    interval: Interval | None = None


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a number could not be had.

    Parameters
    ----------
    code : stable, snake case
    message : one sentence with the numbers
    """

    code: str
    message: str


def widened(estimate: Estimate, *errors: float) -> Estimate:
    """Add independent standard errors to an estimate, in quadrature.

    Parameters
    ----------
    estimate : with or without an interval of its own
    errors : standard errors in the unit of the value, such as those of scale and zero

    Returns
    -------
    The estimate; each side of an interval of its own grows by the normal 95 % part of `errors`.
    """
    more = hypot(*errors)
    interval = estimate.interval
    if interval is not None and more > 0.0:
        added = Interval.normal_95(0.0, more).upper
        below, above = estimate.value - interval.lower, interval.upper - estimate.value
        lower, upper = hypot(below, added), hypot(above, added)
        interval = Interval(estimate.value - lower, estimate.value + upper)
    return Estimate(estimate.value, hypot(estimate.error, more), estimate.n, interval)
