"""Cyclic tests of a machine that waits at every turn, written without labpipe.

The clamp goes up and down at constant speed and stands still for a while at each turn. The force is
that of a softening spring beside sliders of several reaches, so that it falls steeply behind a turn
and bends at once; it may relax while the clamp waits, and the string goes slack where it would have
to push. Two recorders with clocks of their own see it: force time = offset + (1 + drift) x marker
time.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SLIDERS = ((0.1e-3, 0.10), (0.3e-3, 0.06), (1.0e-3, 0.05), (3.0e-3, 0.04))
"""Reach, m, and force, as a share of the peak of the spring, of each slider."""


@dataclass(frozen=True)
class Dwelling:
    """One test.

    Parameters
    ----------
    dwell : s, at every turn
    relaxes : share of the force at the top that is lost in the first second of waiting there
    offset, drift : of the clock of the force
    peak : N, of the spring
    cycles, stroke, speed, rest : 1, m, m/s, s
    fps, rate : Hz
    motion_noise, force_noise : m, N
    seed : of the noise
    """

    dwell: float
    relaxes: float = 0.0
    offset: float = 1.3
    drift: float = 40e-6
    peak: float = 0.8
    cycles: int = 3
    stroke: float = 0.025
    speed: float = 1e-3
    rest: float = 6.0
    fps: float = 50.0
    rate: float = 500.0
    motion_noise: float = 1e-5
    force_noise: float = 2e-3
    seed: int = 0

    @property
    def corners(self) -> Array:
        """Marker times at which the clamp starts and stops, s, shape (strokes, 2)."""
        lasts = self.stroke / self.speed
        begin = self.rest + max(0.0, -self.offset)
        starts = begin + np.arange(2 * self.cycles) * (lasts + self.dwell)
        return np.stack([starts, starts + lasts], axis=1)

    @property
    def stops(self) -> float:
        """Marker time at which both recorders stop, s."""
        return float(self.corners[-1, 1]) + self.rest

    def travel(self, time: Array) -> Array:
        """Place of the clamp, m, at marker times."""
        ups = np.tile([0.0, self.stroke, self.stroke, 0.0], self.cycles)
        return np.asarray(np.interp(time, self.corners.ravel(), ups), dtype=np.float64)

    def force(self, time: Array) -> Array:
        """Force, N, at marker times."""
        place = self.travel(time)
        pull = self.peak * np.tanh(place / self.stroke) / np.tanh(1.0)
        for reach, share in _SLIDERS:
            pull = pull + self._slider(time, place, reach, share * self.peak)
        return np.asarray(np.maximum(pull - self._lost(time), -0.01), dtype=np.float64)

    def _slider(self, time: Array, place: Array, reach: float, most: float) -> Array:
        force, held, turned = np.zeros(len(time)), 0.0, 0.0
        edges = [*self.corners[:, 0].tolist(), np.inf]
        for number, (start, stop) in enumerate(pairwise(edges)):
            during = (time >= start) & (time < stop)
            moved = place[during] - turned
            force[during] = np.clip(held + most / reach * moved, -most, most)
            turned = self.stroke if number % 2 == 0 else 0.0
            way = self.stroke if number % 2 == 0 else -self.stroke
            held = float(np.clip(held + most / reach * way, -most, most))
        return force

    def _lost(self, time: Array) -> Array:
        """Force lost by waiting at the top: fast at first, and slowly won back afterwards."""
        lost = np.zeros(len(time))
        for arrival, departure in zip(self.corners[::2, 1], self.corners[1::2, 0], strict=True):
            waited = np.clip(time - arrival, 0.0, departure - arrival)
            since = np.maximum(time - departure, 0.0)
            lost += np.log1p(waited / 0.1) / np.log1p(10.0) * np.exp(-since / 15.0)
        return self.relaxes * self.peak * lost

    def seen_by_cameras(self) -> tuple[Array, Array]:
        """Marker times, s, and travel with its noise, m."""
        time = np.arange(0.0, self.stops, 1.0 / self.fps)
        noise = np.random.default_rng([self.seed, 1]).normal(0.0, self.motion_noise, len(time))
        return time, self.travel(time) + noise

    def seen_by_load_cell(self) -> tuple[Array, Array]:
        """Times of the recorder, s, and force with its noise, N."""
        lasts = self.offset + (1.0 + self.drift) * self.stops
        time = np.arange(0.0, lasts, 1.0 / self.rate)
        noise = np.random.default_rng([self.seed, 2]).normal(0.0, self.force_noise, len(time))
        return time, self.force((time - self.offset) / (1.0 + self.drift)) + noise
