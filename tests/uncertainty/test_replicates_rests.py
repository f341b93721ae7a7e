"""Replicates of a cyclic test know from its rests how far a camera wanders."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.uncertainty.readings import Trace
from labpipe.uncertainty.replicates import replicated

CUTS = (200, 1500, 2800)
COUNT = 3000


def branch(start: int, stop: int, direction: Direction) -> Branch:
    return Branch(start, stop, 1, direction, float(start), float(stop))


def wandering(seed: int) -> Floats:
    """Noise whose power falls as 1 over the frequency, of a hundredth of the way."""
    waves = np.fft.rfft(np.random.default_rng(seed).normal(size=4 * COUNT))
    waves[1:] /= np.sqrt(np.arange(1.0, len(waves)))
    waves[0] = 0.0
    found = np.fft.irfft(waves, 4 * COUNT)[:COUNT]
    return np.asarray(0.01 * found / found.std(), dtype=np.float64)


def test_rests_of_a_cyclic_test_are_looked_at() -> None:
    """To and fro once between two rests; and the same record as one single loading.

    Of 48 half waves of each rest a mean is taken off before the motion, a parabola behind it.
    """
    time = np.arange(COUNT, dtype=np.float64)
    way = np.interp(time, [0.0, *CUTS, COUNT - 1.0], [0.0, 0.0, 1.0, 0.0, 0.0])
    both = (branch(200, 1500, Direction.LOADING), branch(1500, 2800, Direction.UNLOADING))
    force = way + 1e-3 * np.random.default_rng(2).normal(size=COUNT)
    freedom = list[int]()
    for branches in (both[:1], both):
        trace = Trace(time, way + wandering(1), force, branches)
        made = replicated(trace, trace, CUTS, (lambda x: x, lambda x: x), (), seed=b"one")
        freedom.append(made.noises["displacement"].freedom)
    assert freedom[1] - freedom[0] == 2 * 48 - 1 - 3
    ends = [made.displacement[:, part].mean(axis=1) for part in (slice(0, 200), slice(2800, None))]
    assert float(np.std(ends[1] - ends[0])) > 4e-3
