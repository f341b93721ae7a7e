"""What a number is read from, and how: once from the measured curve, then from many like it.

A number is a plain function of a curve. What it is read from (windows, turns, the sample of the
failure) is decided once, on one curve; the numbers are then computed for as many curves as there
are, all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch
from labpipe.records.estimates import Failure


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A curve that numbers are read from, or many curves that it may have been.

    Parameters
    ----------
    time : shape (n,), s, or numbers of rows
    displacement, force : shape (..., n), m, N; NaN where not known
    branches : in samples of the curve
    failed_at : sample of the failure; None without one
    sizes : m (an area m^2), of specimen and rig by the keys of the protocol
    beyond : share of a sampling step by which the specimen failed, or turned, behind the last
        sample before it
    """

    time: Floats
    displacement: Floats
    force: Floats
    branches: tuple[Branch, ...] = ()
    failed_at: int | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    beyond: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """How numbers are read, once it is decided from where.

    Parameters
    ----------
    numbers : of a trace with the samples that it was decided on: each number, shape (...) of the
        curves; NaN where a curve has none
    n : samples that the numbers rest on
    in_noise : the same of curves with noise, where that moves the samples that are read; None
        where they are the same
    """

    numbers: Callable[[Trace], tuple[Floats, ...]]
    n: int
    in_noise: Callable[[Trace], tuple[Floats, ...]] | None = None

    @property
    def drawn(self) -> Callable[[Trace], tuple[Floats, ...]]:
        """What gives the numbers of curves with noise."""
        return self.in_noise or self.numbers


Decide: TypeAlias = Callable[[Trace], Reading | Failure]
"""Decides on one curve what numbers are read from, or why they cannot be."""


def combined(how: Callable[..., Floats], *parts: Decide) -> Decide:
    """Decide on a number that is made of others.

    Parameters
    ----------
    how : of a trace, and of the first number of each part
    parts : what it is made of

    Returns
    -------
    A failure where a part is one: the first.
    """

    def decide(trace: Trace) -> Reading | Failure:
        readings = list[Reading]()
        for part in parts:
            found = part(trace)
            if isinstance(found, Failure):
                return found
            readings.append(found)

        def numbers(trace: Trace) -> tuple[Floats]:
            return (how(trace, *(each.numbers(trace)[0] for each in readings)),)

        def drawn(trace: Trace) -> tuple[Floats]:
            return (how(trace, *(each.drawn(trace)[0] for each in readings)),)

        return Reading(numbers, readings[0].n, drawn)

    return decide
