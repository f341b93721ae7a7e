"""Noise as instruments make it, of a standard deviation of about 1."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Random = np.random.Generator
Maker = Callable[[int, float, Random], Array]

HUM = 49.93
"""Hz; mains are never at 50 exactly. The rates of the rig do not fold it to slow waves."""
MEMORY = 0.3
"""s, of a load cell that remembers."""
LAG = 60.0
"""s, by which a load cell of some hundred grams follows the air around it."""
WAVES = (0.4, 1.0)
"""That a drifting zero goes along in a record, from the one to the other with the same chance."""


def white(n: int, _: float, rng: Random) -> Array:
    """Independent from sample to sample."""
    return rng.standard_normal(n)


def remembering(n: int, dt: float, rng: Random, memory: float = MEMORY) -> Array:
    """First-order autoregressive, by halves of its past."""
    keep = np.exp(-dt / memory)
    kicks = rng.standard_normal(n)
    kicks[1:] *= np.sqrt(1.0 - keep**2)
    # out_i = sum keep^(i-j) kick_j, doubling the reach in every round.
    out, reach = kicks, 1
    while reach < n and keep**reach > 1e-17:
        out = out + keep**reach * np.concatenate([np.zeros(reach), out[:-reach]])
        reach *= 2
    return out


def pink(n: int, _: float, rng: Random) -> Array:
    """Power 1/f from one wave in four records on."""
    long = 4 * n
    waves = np.fft.rfft(rng.standard_normal(long))
    waves[1:] /= np.sqrt(np.arange(1.0, len(waves)))
    waves[0] = 0.0
    made = np.fft.irfft(waves, long)
    return np.asarray(made[:n] / made.std(), dtype=np.float64)


def hum(n: int, dt: float, rng: Random) -> Array:
    """Mains and their third harmonic over a little white noise."""
    time = dt * np.arange(n) + rng.uniform(0.0, 1.0)
    wave = np.sin(2.0 * np.pi * HUM * time) + 0.3 * np.sin(6.0 * np.pi * HUM * time)
    return np.asarray(1.3 * wave + 0.3 * rng.standard_normal(n), dtype=np.float64)


def quiet(n: int, _: float, rng: Random) -> Array:
    """A third of the usual noise, for a converter whose steps are coarse."""
    return rng.standard_normal(n) / 3.0


def drifting(n: int, _: float, rng: Random) -> Array:
    """White, and a zero that wanders along half a wave or so from where it was."""
    phase = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.linspace(0.0, rng.uniform(*WAVES), n)
    wander = np.sin(phase) - np.sin(phase[0])
    return np.asarray(0.5 * rng.standard_normal(n) + DRIFT * wander, dtype=np.float64)


DRIFT = 1.5
"""Height of the wave that a drifting zero goes along."""


def drifted() -> float:
    """How far a drifting zero has moved by the end, root of the mean square over all records.

    The square of sin(a + d) - sin(a) is 1 - cos(d) in the mean over a; that over d, in between.
    """
    low, high = (2.0 * np.pi * each for each in WAVES)
    return float(DRIFT * np.sqrt(1.0 - (np.sin(high) - np.sin(low)) / (high - low)))


def wander(n: int, dt: float, rng: Random) -> Array:
    """A zero that moves from 0 on, with a variance of 1 at the end.

    The air pushes at random, and the cell follows with a lag, as it did before the record: over
    minutes a random walk, over seconds a straight line.
    """
    speed, steps = remembering(n, dt, rng, LAG), np.arange(1.0, n - 1.0)
    speed[0] = 0.0
    last = n - 1.0 + 2.0 * float(np.sum((n - 1.0 - steps) * np.exp(-steps * dt / LAG)))
    return np.asarray(np.cumsum(speed) / np.sqrt(max(last, 1.0)), dtype=np.float64)


def periodic(n: int, dt: float, rng: Random) -> Array:
    """A pump: one wave of some seconds, and little else."""
    time, period = dt * np.arange(n), rng.uniform(1.5, 4.0)
    wave = np.sin(2.0 * np.pi * (time / period + rng.uniform()))
    return np.asarray(1.4 * wave + 0.2 * rng.standard_normal(n), dtype=np.float64)


def louder(n: int, _: float, rng: Random) -> Array:
    """White, and six times as large from somewhere in the record on."""
    size = np.where(np.arange(n) < rng.uniform(0.2, 0.8) * n, 0.3, 1.8)
    return np.asarray(size * rng.standard_normal(n), dtype=np.float64)


def jumping(n: int, _: float, rng: Random) -> Array:
    """White, and a zero that jumps once, by eight times as much."""
    jump = 4.0 * (np.arange(n) > rng.uniform(0.2, 0.8) * n)
    return np.asarray(0.5 * rng.standard_normal(n) + jump, dtype=np.float64)


def slow(n: int, _: float, rng: Random) -> Array:
    """First-order autoregressive with a memory of a tenth of the record."""
    return remembering(n, 10.0 * MEMORY / n, rng)


KINDS = ("white", "memory", "pink", "hum", "steps", "drift")
"""Of the study."""
ATTACKS = ("periodic", "louder", "jump", "slow", "coarse")
"""Worse than an interval can be asked to hold: it is to be wider, or doubtful."""
MAKERS: dict[str, Maker] = {
    "white": white,
    "memory": remembering,
    "pink": pink,
    "hum": hum,
    "steps": quiet,
    "drift": drifting,
    "periodic": periodic,
    "louder": louder,
    "jump": jumping,
    "slow": slow,
    "coarse": quiet,
}
STEPS = {"steps": 7.0, "coarse": 60.0}
"""Of a converter, in sizes of the noise that there is: a third of the usual."""


def noisy(values: Array, kind: str, size: float, dt: float, rng: Random) -> Array:
    """Values with noise of one kind, rounded where that has steps."""
    out = values + size * MAKERS[kind](len(values), dt, rng)
    if step := STEPS.get(kind, 0.0) * size / 3.0:
        out = step * np.round(out / step)
    return np.asarray(out, dtype=np.float64)
