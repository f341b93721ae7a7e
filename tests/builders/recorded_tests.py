"""A test as it stands behind its corrections, put together from two records by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.signals import Clocks, Filter, Signal, Signals
from labpipe.results.evidence import Evidence
from labpipe.signal.filters import in_pieces

UP, DOWN = Direction.LOADING, Direction.UNLOADING


def one_loading(time: Floats) -> tuple[Branch, ...]:
    return (Branch(0, len(time), 1, UP, float(time[0]), float(time[-1])),)


def recorded(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    force_time: Floats | None = None,
    branches: tuple[Branch, ...] = (),
    filters: Sequence[Filter] = (),
    filters_of_displacement: Sequence[Filter] = (),
    clocks: Clocks | None = None,
    compliance: float = 0.0,
    **more: Any,
) -> Evidence:
    """Filter two records branch by branch, and put them on one clock: a curve."""
    at = time if force_time is None else force_time
    branches, clocks = branches or one_loading(time), clocks or Clocks("one")
    ends = [time[end - 1] for each in branches for end in (each.start, each.stop) if end]
    signals = Signals()
    for name, clock, unit, made, stamps, values in (
        ("force", "force" if clocks.force else "one", "N", filters, at, force),
        ("displacement", "one", "m", filters_of_displacement, time, displacement),
    ):
        raw = Signal(stamps, values, unit, clock)
        signals = signals.with_new(name, raw)
        if made:
            cuts = np.searchsorted(stamps, ends, side="right").tolist()
            stride = int(np.prod([each for _, each in made]))
            done = in_pieces(values, cuts, made)
            filtered = replace(raw, time=stamps[::stride], values=done)
            signals = signals.with_filtered(name, filtered, *made)
    way = signals.filtered["displacement"]
    pull = clocks.sampled(signals.filtered["force"], way.time)
    number = np.zeros(len(way.time), dtype=np.int64)
    corrected = way.values - compliance * pull if compliance else way.values
    curve = Curve(way.time, corrected, pull, number, number + 1, branches)
    unfiltered = signals.raw["force"]
    return Evidence(
        signals, clocks, curve=curve, unfiltered=unfiltered, compliance=compliance, **more
    )
