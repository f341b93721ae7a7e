"""Extract numbers from a curve and its replicates.

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
    branches : loading and unloading, in samples of the curve
    failed_at : index of the sample of the failure, or None
    sizes : m (an area m^2), of specimen and rig, by key of the protocol
    steps_beyond : sampling steps from the last sample before a failure or turn to that event
    parts_per_step : number of parts into which each original sampling step is divided
    is_smooth : whether the curve has no noise; limits that depend on noise are then taken from the
        measured curve
    """

    time: Floats
    displacement: Floats
    force: Floats
    branches: tuple[Branch, ...] = ()
    failed_at: int | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    steps_beyond: float = 0.0
    parts_per_step: int = 1
    is_smooth: bool = False

    def refine(self, parts: int, *, has_corners: bool = False) -> Trace:
        """Return the curve with each sampling step divided by linear interpolation.

        Parameters
        ----------
        parts : parts per step, at least 1
        has_corners : whether, instead, the neighbouring steps are extended to their intersection
            in the divided step
        """
        if parts == 1:
            return self
        count = len(self.time)
        places = np.arange((count - 1) * parts + 1) / parts
        samples = np.arange(count)
        time, displacement, force = (
            np.interp(places, samples, values)
            for values in (self.time, self.displacement, self.force)
        )
        if has_corners:
            displacement = displacement + _compute_corner_excess(self.displacement, parts)
            force = force + _compute_corner_excess(self.force, parts)
        branches = tuple(
            replace(branch, start=parts * branch.start, stop=max(parts * (branch.stop - 1) + 1, 0))
            for branch in self.branches
        )
        failed = None if self.failed_at is None else parts * self.failed_at
        return replace(
            self,
            time=time,
            displacement=displacement,
            force=force,
            branches=branches,
            failed_at=failed,
            parts_per_step=parts * self.parts_per_step,
        )


def _compute_corner_excess(values: Floats, parts: int) -> Floats:
    """Return the excess of a corner over linear interpolation at each part of the steps.

    The corner is the intersection of the neighbouring steps. The excess is zero in a step without
    such an intersection, and in the first and the last step.
    """
    beyond = np.zeros((len(values) - 1, parts))
    steps = np.diff(values)
    if len(steps) >= 3:
        share = np.arange(parts) / parts
        bends = -np.diff(steps)  # at the start and at the end of a step
        start, end = bends[:-1], bends[1:]
        lines = np.stack([np.outer(start, share), np.outer(end, 1.0 - share)])
        excess = np.where(start > 0.0, lines.min(axis=0).T, lines.max(axis=0).T).T
        beyond[1:-1] = np.where((start * end > 0.0)[:, None], excess, 0.0)
    return np.append(beyond.ravel(), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Functions that compute numbers from chosen samples.

    Parameters
    ----------
    numbers : returns each number of a trace with the same samples, shape (...) of its curves; NaN
        for a curve without the number
    n : number of samples used
    noisy_numbers : the same for curves with noise; None if it is the same function
    ends_at_samples : whether the windows end at samples, and nothing else depends on the sampling.
        The numbers on finer samples then show the effect of the sampling
    depends_on_corners : whether that effect is taken from the measured curve, because the smooth
        one rounds off corners that the number depends on
    sampling_correction : correction of each number to infinitely fine samples; None if unknown
    values : the numbers, if they are measured from more samples than those of the curve
    """

    numbers: Callable[[Trace], tuple[Floats, ...]]
    n: int
    noisy_numbers: Callable[[Trace], tuple[Floats, ...]] | None = None
    ends_at_samples: bool = False
    depends_on_corners: bool = False
    sampling_correction: tuple[float, ...] | None = None
    values: tuple[float, ...] = ()

    @property
    def replicate_numbers(self) -> Callable[[Trace], tuple[Floats, ...]]:
        """Return the function that computes the numbers of curves with noise."""
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
    """Combine several numbers into one number.

    Parameters
    ----------
    function : of a trace and the first number of each part
    parts : choices of the numbers on which it depends
    """

    def decide(trace: Trace) -> Reading:
        readings = [part(trace) for part in parts]

        def numbers(trace: Trace) -> tuple[Floats]:
            return (function(trace, *(reading.numbers(trace)[0] for reading in readings)),)

        def noisy_numbers(trace: Trace) -> tuple[Floats]:
            values = (reading.replicate_numbers(trace)[0] for reading in readings)
            return (function(trace, *values),)

        ends_at_samples = all(reading.ends_at_samples for reading in readings)
        depends_on_corners = any(reading.depends_on_corners for reading in readings)
        return Reading(numbers, readings[0].n, noisy_numbers, ends_at_samples, depends_on_corners)

    return decide
