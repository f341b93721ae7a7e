"""What a number is read from, and how: once from the measured curve, then from many like it.

A number is a plain function of a curve. What it is read from (windows, turns, the sample of the
failure) is decided once, on one curve; the numbers are then computed for as many curves as there
are, all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Singles
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
    steps : that each sampling step has been divided into
    noise : shape (..., n), N, of many curves what noise adds to the force before all filters; None
        where it is not known, or filters do nothing
    """

    time: Floats
    displacement: Floats
    force: Floats
    branches: tuple[Branch, ...] = ()
    failed_at: int | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    beyond: float = 0.0
    steps: int = 1
    noise: Floats | Singles | None = None

    def finer(self, times: int) -> Trace:
        """The same curve, with straight lines from sample to sample divided into so many steps.

        Parameters
        ----------
        times : steps, from 1 on
        """
        if times == 1:
            return self
        count = len(self.time)
        at = np.arange((count - 1) * times + 1) / times
        along = np.arange(count)
        time, displacement, force = (
            np.interp(at, along, values) for values in (self.time, self.displacement, self.force)
        )
        branches = tuple(
            replace(branch, start=times * branch.start, stop=max(times * (branch.stop - 1) + 1, 0))
            for branch in self.branches
        )
        failed = None if self.failed_at is None else times * self.failed_at
        return replace(
            self,
            time=time,
            displacement=displacement,
            force=force,
            branches=branches,
            failed_at=failed,
            steps=times * self.steps,
        )


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
    is_cut : whether its windows end at samples, and nothing else of it is counted in samples: finer
        samples of the same curve say then what it would be without them
    feels_corners : whether that is to be read from the measured curve: the smooth one rounds off
        corners that the number rests on
    between : what each number would be more of if samples lay without end, where it says so itself
    """

    numbers: Callable[[Trace], tuple[Floats, ...]]
    n: int
    in_noise: Callable[[Trace], tuple[Floats, ...]] | None = None
    is_cut: bool = False
    feels_corners: bool = False
    between: tuple[float, ...] | None = None

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
            outcome = part(trace)
            if isinstance(outcome, Failure):
                return outcome
            readings.append(outcome)

        def numbers(trace: Trace) -> tuple[Floats]:
            return (how(trace, *(reading.numbers(trace)[0] for reading in readings)),)

        def drawn(trace: Trace) -> tuple[Floats]:
            return (how(trace, *(reading.drawn(trace)[0] for reading in readings)),)

        is_cut = all(reading.is_cut for reading in readings)
        has_noise = any(reading.feels_corners for reading in readings)
        return Reading(numbers, readings[0].n, drawn, is_cut, has_noise)

    return decide
