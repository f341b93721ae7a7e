"""The machines: noise, chance, load frames, a clamp on its way, clocks, what goes wrong.

A machine is off by as much as a shipped protocol says that its inputs are uncertain by; that is
read from the YAML as it stands, without labpipe.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from tests.judges.foreign.specimens import Specimen

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
    low, high = (2.0 * np.pi * wave for wave in WAVES)
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


PROTOCOLS = Path(__file__).resolve().parents[3] / "protocols"
UNITS = {"": 1.0, "%": 0.01, "mm": 1e-3, "um": 1e-6, "m": 1.0}


@cache
def _said(protocol: str) -> dict[str, Any]:
    text = (PROTOCOLS / f"{protocol}.yaml").read_text(encoding="utf-8")
    made: dict[str, Any] = yaml.safe_load(text)
    return made


def stated(protocol: str, *path: str) -> float:
    """A standard uncertainty, SI; 0 where the protocol does not state it.

    Parameters
    ----------
    protocol : name of a shipped one
    path : keys, such as ``markers``, ``centre_uncertainty``
    """
    found: Any = _said(protocol)
    for key in path:
        found = found.get(key, {}) if isinstance(found, dict) else {}
    if isinstance(found, dict):
        return 0.0
    matched = re.fullmatch(r"([\d.]+) ?(%|[a-z]*)", str(found))
    assert matched is not None, (protocol, path, found)
    return float(matched[1]) * UNITS[matched[2]]


def force_channel(protocol: str) -> tuple[str, ...]:
    """Keys of the channel that the force comes from."""
    sources = _said(protocol)["sources"]
    if "channel" in sources.get("force", {}):
        return "sources", "force"
    role = "force" if "force" in sources else "frame"
    return "sources", role, "channels", "force"


def zero_drift(protocol: str) -> float:
    """How far the zero of the force moves in a test, a share of the largest force."""
    return stated(protocol, *force_channel(protocol), "zero_drift")


def scale(protocol: str, role: str, channel: str = "") -> float:
    """Of a channel's scale, a ratio.

    Parameters
    ----------
    protocol : name of a shipped one
    role : of the source
    channel : of the source; empty where it has one
    """
    where = ("sources", role, *(("channels", channel) if channel else ()))
    gain = stated(protocol, *where, "calibration", "gain_uncertainty")
    return float((gain**2 + stated(protocol, *where, "scale_uncertainty") ** 2) ** 0.5)


FRAME_FAULTS = ("counts-down", "begins-under-load", "cut")
PULL_FAULTS = (*FRAME_FAULTS, "slip")
RECORDER_FAULTS = ("begins-under-load", "cut")
CAMERA_FAULTS = ("begins-under-load", "cut", "short-rest")


@dataclass(frozen=True)
class Made:
    """A test on disk and what is true of it, by the names of results, SI."""

    folder: Path
    truth: dict[str, float]


@dataclass(frozen=True)
class Chance:
    """All that differs from test to test.

    Parameters
    ----------
    kind, seed : which test
    noise : word of `noise.MAKERS`
    fault : what goes wrong at the rig, or nothing
    exact : load cell, offsets and lengths are as stated, and noise is a fifth
    loud : times the usual noise; 0 for none at all
    samples : of a load frame while it pulls; as many as its rate makes if 0
    rest : s, that a cantilever stands still first and last
    """

    kind: str
    seed: int
    noise: str = "white"
    fault: str = ""
    exact: bool = False
    loud: float = 1.0
    samples: int = 0
    rest: float = 4.0

    @cached_property
    def rng(self) -> np.random.Generator:
        """Chance of this test."""
        return np.random.default_rng([self.seed, zlib.crc32(self.kind.encode())])

    def error(self, size: float) -> float:
        """What a stated quantity is off by; none where all is exact."""
        drawn = float(self.rng.normal(0.0, size))
        return 0.0 if self.exact else drawn

    def off(self, name: str, size: float) -> float:
        """What something else is off by, in chance of its own."""
        return 0.0 if self.exact else size * float(self.own(name).standard_normal())

    def own(self, name: str) -> np.random.Generator:
        """Chance of something of this test alone, that moves no other."""
        return np.random.default_rng(
            [self.seed, *(zlib.crc32(x.encode()) for x in (self.kind, name))]
        )

    def length(self, name: str) -> float:
        """What a length or a measure of the section is off by in truth, m."""
        return self.off(name, stated(self.kind, "specimen", "uncertainty", name))

    def size(self, peak: float) -> float:
        """Noise of a force, N."""
        return self.loud * (0.0003 if self.exact else 0.0015) * peak

    @property
    def variety(self) -> int:
        """Which of three specimens."""
        return self.seed // 18 % 3

    @property
    def dwell(self) -> float:
        """How long the machine stands at a turn, s."""
        return (0.0, 1.0, 5.0)[self.seed // 6 % 3]

    def rate(self, usual: float) -> float:
        """Of a load frame, Hz: many write ten samples a second, which they average."""
        return 10.0 if self.seed // 108 % 2 else usual

    def rate_over(self, lasts: float, usual: float) -> float:
        """The same, of a pull that lasts so many seconds; a few samples may be all there are."""
        if not self.samples:
            return self.rate(usual)
        return (self.samples + (0.618 * self.seed) % 1.0) / lasts

    def noisy(self, force: Array, dt: float) -> Array:
        """The force as the instrument gives it."""
        peak = float(np.abs(force).max())
        kind = "white" if self.noise == "hum" and dt > 0.05 else self.noise
        far = 0.0 if self.exact else min(self.loud, 1.0) * zero_drift(self.kind) * peak
        force = force + far * wander(len(force), dt, self.own("zero"))
        return noisy(force, kind, self.size(peak), dt, self.rng)

    @property
    def drifts(self) -> float:
        """How far a zero moves that drifts more than the protocol states, a share of the peak."""
        return float(np.hypot(zero_drift(self.kind), self.size(1.0) * drifted()))

    def seen(self, places: Array) -> Array:
        """Places as cameras see them: white noise of 15 um, or pink of 6."""
        kind, size = ("white", 15e-6) if self.seed // 54 % 2 == 0 else ("pink", 6e-6)
        size *= min(self.loud, 1.0) * (0.3 if self.exact else 1.0)
        places = places * (1.0 + self.off("cameras", scale(self.kind, "markers")))
        flat = places.reshape(len(places), -1).T
        made = [noisy(row, kind, size, 0.02, self.rng) for row in flat]
        return np.asarray(np.array(made).T.reshape(places.shape), dtype=np.float64)


def pulled(
    chance: Chance, specimen: Specimen, *, speed: float, rate: float, tare: float
) -> tuple[Array, Array, Array]:
    """Time, travel and force of a load frame that moves from its first sample on.

    A specimen that breaks is followed for half a second; at the end of its stroke the frame stands.
    """
    lasts = specimen.ends / speed
    rate = chance.rate_over(lasts, rate)
    after = 0.5 if specimen.breaks else 0.3 + chance.dwell
    after = max(after, 2.0 / rate if chance.samples else 0.0)
    time = np.arange(int((lasts + after) * rate)) / rate
    travel = speed * time if specimen.breaks else np.minimum(speed * time, specimen.ends)
    force = specimen.force(travel)
    off = chance.error(scale(chance.kind, "frame", "force"))
    force = chance.noisy(force, 1.0 / rate) * (1.0 + off)
    force = force + tare * float(chance.rng.uniform(-0.02, 0.02) * np.abs(force).max())
    travel = noisy(travel, "white", min(chance.loud, 1.0) * 1e-4 * speed, 1.0 / rate, chance.rng)
    travel = travel * (1.0 + chance.off("travel", scale(chance.kind, "frame", "displacement")))
    first, last = kept(chance.fault, int(lasts * rate), len(time))
    if chance.fault == "counts-down":
        travel = -travel
    return (time + 0.1)[first:last], travel[first:last], force[first:last]


def kept(fault: str, loading: int, count: int) -> tuple[int, int]:
    """Samples that are left of a record."""
    if fault == "begins-under-load":
        return loading // 8, count
    return 0, (6 * loading // 10 if fault == "cut" else count)


@dataclass(frozen=True)
class Way:
    """A machine that goes to and fro at constant speed, and stands at each turn.

    Parameters
    ----------
    stroke, speed : m, m/s
    cycles : how many
    rest, dwell : s, before the first stroke and after the last, and at each turn
    """

    stroke: float
    speed: float
    cycles: int
    rest: float
    dwell: float

    @cached_property
    def corners(self) -> tuple[Array, Array]:
        """Times and places at which the speed changes."""
        times, places = [0.0, self.rest], [0.0, 0.0]
        for number in range(2 * self.cycles):
            place = self.stroke * ((number + 1) % 2)
            times += [times[-1] + self.stroke / self.speed]
            times += [times[-1] + self.dwell]
            places += [place, place]
        times[-1] += self.rest
        return np.array(times), np.array(places)

    @property
    def lasts(self) -> float:
        """s."""
        return float(self.corners[0][-1])

    def travel(self, time: Array) -> Array:
        """Place at some times, m."""
        return np.asarray(np.interp(time, *self.corners), dtype=np.float64)

    def stroke_at(self, time: Array) -> NDArray[np.int64]:
        """Which stroke, from 0; a dwell still belongs to the stroke before."""
        ends = self.corners[0][3::2][:-1]
        return np.searchsorted(ends, time).astype(np.int64)

    def kept(self, fault: str) -> tuple[float, float]:
        """From when to when it is recorded: all, or without the first or the last part."""
        stroke = self.stroke / self.speed
        if fault == "begins-under-load":
            return self.rest + 0.15 * stroke, self.lasts
        if fault == "cut":
            return 0.0, self.lasts - self.rest - self.dwell - 0.6 * stroke
        return (self.rest - 0.7 if fault == "short-rest" else 0.0), self.lasts


@dataclass(frozen=True)
class Clocks:
    """Force time = offset + (1 + drift) x camera time; the force begins at 0 of its own."""

    offset: float
    drift: float

    def cameras(self, force_time: Array) -> Array:
        """Camera time of the force's samples."""
        return np.asarray((force_time - self.offset) / (1.0 + self.drift), dtype=np.float64)

    def samples(self, rate: float, lasts: float) -> Array:
        """Times of the force's samples, until shortly before the cameras stop."""
        until = self.offset + (1.0 + self.drift) * lasts
        return np.asarray(np.arange(0.0, until, 1.0 / rate), dtype=np.float64)
