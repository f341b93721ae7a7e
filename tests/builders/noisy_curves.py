"""Curves of which everything is known but the noise, and what they may have been."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.uncertainty.intervals import Measured, measure
from labpipe.uncertainty.readings import Reading, Trace
from labpipe.uncertainty.replicates import Filter, Input, Replicates, replicated

Numbers = Callable[[Trace], tuple[Floats, ...]]


def as_it_is(values: Floats) -> Floats:
    return values


def trace_of(force: Floats, displacement: Floats | None = None, **more: Any) -> Trace:
    """One loading, 100 samples a second and a millimetre a second where nothing else is said."""
    time: Floats = 0.01 * np.arange(float(len(force)))
    way = 1e-3 * time if displacement is None else displacement
    branch = Branch(0, len(time), 1, Direction.LOADING, 0.0, float(time[-1]))
    return Trace(time, way, force, **{"branches": (branch,), **more})


def replicates_of(
    trace: Trace,
    *inputs: Input,
    cuts: Sequence[int] = (),
    filters: tuple[Filter, Filter] = (as_it_is, as_it_is),
    seed: bytes = b"seed",
    compliance: float = 0.0,
) -> Replicates:
    return replicated(trace, trace, cuts, filters, inputs, seed=seed, compliance=compliance)


def measured(
    trace: Trace, numbers: Numbers, *inputs: Input, n: int | None = None, **more: Any
) -> tuple[Measured, ...]:
    """Numbers that are read from a curve the same way whatever it is."""
    reading = Reading(numbers, len(trace.time) if n is None else n)
    found = measure(replicates_of(trace, *inputs, **more), lambda _: reading)
    assert isinstance(found, tuple), found
    return found
