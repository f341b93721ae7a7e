from __future__ import annotations

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.cycle_numbers import unloading_stiffness_of
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.estimates import Estimate


def test_unloading_begins_where_the_wait_ends_and_not_where_its_samples_do() -> None:
    """The branch holds 3 s of the wait; noise of cameras must not be carried over them."""
    time: Floats = np.arange(0.0, 26.0, 0.02)
    path = 1e-3 * np.clip(np.minimum(time, 23.0 - time), 0.0, 10.0)
    off = 0.010 - path
    force = 1.0 - 200.0 * off + 2e4 * off**2
    waits, turns, ends = (int(np.searchsorted(time, at)) for at in (10.0, 13.0, 23.0))
    up = Branch(0, waits, 1, Direction.LOADING, 0.0, 10.0)
    down = Branch(waits, ends, 1, Direction.UNLOADING, 13.0, 23.0)
    numbers = np.zeros(len(time), dtype=np.int64)
    bench = Bench(curve=Curve(time, path, force, numbers, numbers + 1, (up, down)))
    for name, values, unit in (("force", force, "N"), ("displacement", path, "m")):
        bench.raw[name] = bench.signals[name] = Signal(time, values, unit, "force")
    seen = path + np.random.default_rng(1).normal(0.0, 15e-6, len(time))
    found = unloading_stiffness_of(bench, [up, down], seen, 0.0003, 0.003)
    assert isinstance(found, Estimate)
    inside = slice(turns, ends)
    window = (off[inside] >= 0.0003) & (off[inside] <= 0.003)
    slope = np.polyfit(path[inside][window], force[inside][window], 1)[0]
    assert found.value == pytest.approx(slope, rel=0.01)
