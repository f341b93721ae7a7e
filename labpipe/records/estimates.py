"""Define results of fits: an estimate with its standard error, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from math import hypot
from typing import ParamSpec, Self, TypeVar

from labpipe.records.curve import Interval
from labpipe.records.quality import Reason


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimated value with its standard error.

    Parameters
    ----------
    value, error : value and its standard error, in the same unit
    n : number of samples from which the value is estimated
    interval : 95 % interval, in the unit of `value`; None for the normal interval of `error`, which
        does not hold for few degrees of freedom or an asymmetric uncertainty
    """

    value: float
    error: float
    n: int
    interval: Interval | None = None


Failure = Reason
"""Reason why an estimate is not available."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


class UnavailableError(Exception):
    """Error of a result that cannot be computed from a test.

    Parameters
    ----------
    failure : reason why the result is not available
    """

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure

    @classmethod
    def of(cls, name: str, /, **facts: object) -> Self:
        """Make the error from a message template, see `labpipe.records.quality.Reason.of`."""
        return cls(Failure.of(name, **facts))


def return_failure(function: Callable[_P, _R]) -> Callable[_P, _R | Failure]:
    """Decorate a function so that it returns the reason of a failure instead of raising it.

    Parameters
    ----------
    function : function that may raise `UnavailableError`
    """

    @wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _R | Failure:
        try:
            return function(*args, **kwargs)
        except UnavailableError as error:
            return error.failure

    return call


def add_errors(estimate: Estimate, *errors: float) -> Estimate:
    """Add independent standard errors to an estimate, in quadrature.

    Parameters
    ----------
    estimate : estimate with or without an interval of its own
    errors : standard errors in the unit of the value, such as those of scale and zero

    Returns
    -------
    The estimate with the combined error. If the estimate has its own interval, the normal 95 %
    half-width of `errors` is added to each side of this interval in quadrature, so that an
    asymmetric interval stays asymmetric.

    Notes
    -----
    The standard error from an uncertain input is the change of the result if the input is larger by
    one standard uncertainty (GUM, JCGM 100:2008, sec. 5.1.3).
    """
    added_error, interval = hypot(*errors), estimate.interval
    if interval is not None and added_error > 0.0:
        added_half_width = Interval.make_normal(0.0, added_error).upper
        # The value may lie outside the interval, because only the interval is corrected for the
        # bias from noise.
        is_inside = interval.lower <= estimate.value <= interval.upper
        centre = estimate.value if is_inside else 0.5 * (interval.lower + interval.upper)
        lower_width = hypot(centre - interval.lower, added_half_width)
        upper_width = hypot(interval.upper - centre, added_half_width)
        interval = Interval(centre - lower_width, centre + upper_width)
    return Estimate(estimate.value, hypot(estimate.error, added_error), estimate.n, interval)
