"""What a fitter gives back: an estimate with its standard error, or the reason there is none."""

from __future__ import annotations

from dataclasses import dataclass

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
