"""Extraction of numbers from a curve and its replicates.

A number is a function of a curve. Its samples (windows, turns, the failure) are chosen once, on one
curve; the number is then computed for all replicates at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Samples
from labpipe.records.curve import Branch


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A curve, or replicates of it, from which numbers are computed.

    Parameters
    ----------
    time : shape (n,), s, or numbers of rows
    displacement, force : shape (..., n), m, N; NaN where unknown
    branches : in samples of the curve
    failed_at : sample of the failure, or None
    sizes : m (an area m^2), of specimen and rig, by key of the protocol
    steps_beyond : time from the last sample before a failure or turn to it, in sampling steps
    steps : number of parts of each original sampling step
    is_smooth : whether it has no noise: limits by the noise are then those of the measured curve
    """

    time: Floats
    displacement: Floats
    force: Floats
    branches: tuple[Branch, ...] = ()
    failed_at: int | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    steps_beyond: float = 0.0
    steps: int = 1
    is_smooth: bool = False

    def refine(self, times: int, *, has_corners: bool = False) -> Trace:
        """Return the curve with each sampling step divided by linear interpolation.

        Parameters
        ----------
        times : parts per step, at least 1
        has_corners : whether, instead, the neighbouring steps are extended to their intersection
            in the divided step
        """
        if times == 1:
            return self
        count = len(self.time)
        places = np.arange((count - 1) * times + 1) / times
        along = np.arange(count)
        time, displacement, force = (
            np.interp(places, along, values)
            for values in (self.time, self.displacement, self.force)
        )
        if has_corners:
            displacement = displacement + _beyond_chords(self.displacement, times)
            force = force + _beyond_chords(self.force, times)
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


def _beyond_chords(values: Floats, times: int) -> Floats:
    """Return what the lines of the neighbouring steps add to each divided step, up to a corner.

    Zero in a step that is not between its neighbours, and in the first and the last one.
    """
    beyond = np.zeros((len(values) - 1, times))
    steps = np.diff(values)
    if len(steps) >= 3:
        share = np.arange(times) / times
        before, after = steps[:-2] - steps[1:-1], steps[1:-1] - steps[2:]
        lines = np.stack([np.outer(before, share), np.outer(after, 1.0 - share)])
        nearer = np.where(before > 0.0, lines.min(axis=0).T, lines.max(axis=0).T).T
        beyond[1:-1] = np.where((before * after > 0.0)[:, None], nearer, 0.0)
    return np.append(beyond.ravel(), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Functions that compute numbers from chosen samples.

    Parameters
    ----------
    numbers : returns each number of a trace with the same samples, shape (...) of the curves; NaN
        for a curve without the number
    n : number of samples used
    noisy_numbers : the same for curves with noise, if noise changes which samples are read, else
        None
    ends_at_samples : whether windows end at samples, and nothing else depends on the sampling:
        finer samples then show the effect of the sampling
    depends_on_corners : whether that effect is taken from the measured curve, because the smooth
        one rounds off corners that the number depends on
    sampling_correction : correction of each number to infinitely fine samples, if the extractor
        knows it
    """

    numbers: Callable[[Trace], tuple[Floats, ...]]
    n: int
    noisy_numbers: Callable[[Trace], tuple[Floats, ...]] | None = None
    ends_at_samples: bool = False
    depends_on_corners: bool = False
    sampling_correction: tuple[float, ...] | None = None

    @property
    def replicate_numbers(self) -> Callable[[Trace], tuple[Floats, ...]]:
        """Return the function that returns the numbers of curves with noise."""
        return self.noisy_numbers or self.numbers


Decide: TypeAlias = Callable[[Trace], Reading]
"""Chooses the samples of numbers on one curve; raises `UnavailableError` if there are none."""


def read_part(
    function: Callable[[Floats, Floats], Floats], part: Samples | tuple[slice, Samples]
) -> Callable[[Trace], tuple[Floats]]:
    """Make a function that computes a number from a part of a trace.

    Parameters
    ----------
    function : of displacement and force, shape (..., m), m, N
    part : samples of the trace, or a stretch of it and samples of that
    """
    parts = part if isinstance(part, tuple) else (part,)

    def numbers(trace: Trace) -> tuple[Floats]:
        displacement, force = trace.displacement, trace.force
        for samples in parts:
            displacement, force = displacement[..., samples], force[..., samples]
        return (function(displacement, force),)

    return numbers


def combine_numbers(function: Callable[..., Floats], *parts: Decide) -> Decide:
    """Combine numbers into one.

    Parameters
    ----------
    function : of a trace and of the first number of each part
    parts : numbers on which it depends
    """

    def decide(trace: Trace) -> Reading:
        readings = [part(trace) for part in parts]

        def numbers(trace: Trace) -> tuple[Floats]:
            return (function(trace, *(reading.numbers(trace)[0] for reading in readings)),)

        def drawn(trace: Trace) -> tuple[Floats]:
            values = (reading.replicate_numbers(trace)[0] for reading in readings)
            return (function(trace, *values),)

        is_cut = all(reading.ends_at_samples for reading in readings)
        has_corners = any(reading.depends_on_corners for reading in readings)
        return Reading(numbers, readings[0].n, drawn, is_cut, has_corners)

    return decide
