"""Records, noisy curves and takes of markers in memory, with known truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Branch, Direction
from labpipe.records.recording import MarkerTracks
from labpipe.uncertainty.intervals import MeasuredNumber, measure_numbers
from labpipe.uncertainty.replicates import Extractor, Input, Replicates, Trace, draw_replicates

STIFFNESS = 100.0
"""N/m"""


STROKE = 0.010
"""m"""


@dataclass(frozen=True, slots=True, eq=False)
class PlainRecord:
    """Time (s), displacement (m) and force (N), sample by sample."""

    time: Floats
    displacement: Floats
    force: Floats

    def where(self, kept: Flags) -> Self:
        """Some of the samples; the time stays as it was."""
        return type(self)(*(values[kept] for values in self.arrays()))

    def up_to(self, end: float) -> Self:
        """The record cut off at a time."""
        return self.where(self.time <= end)

    def arrays(self) -> tuple[Floats, Floats, Floats]:
        """Time, displacement, force."""
        return self.time, self.displacement, self.force


def up_and_down(
    *,
    cycles: int = 2,
    rate: float = 50.0,
    rest: float = 2.0,
    is_round: bool = False,
    noise: float = 1e-3,
) -> PlainRecord:
    """Pull a spring of 100 N/m by 10 mm and let it back.

    Parameters
    ----------
    cycles, rate, rest : how often, 5 s up and 5 s down; samples per second; s before and behind
    is_round : a cosine in place of straight strokes
    noise : of force and displacement, as a share of their ranges
    """
    time: Floats = np.arange(0.0, 2.0 * rest + 10.0 * cycles, 1.0 / rate)
    phase = np.clip((time - rest) / 5.0, 0.0, 2.0 * cycles)
    share = 0.5 - 0.5 * np.cos(np.pi * phase) if is_round else 1.0 - np.abs(phase % 2.0 - 1.0)
    random = np.random.default_rng(0)
    path = STROKE * (share + noise * random.normal(size=len(time)))
    peak = STIFFNESS * STROKE
    return PlainRecord(time, path, peak * (share + noise * random.normal(size=len(time))))


Filter = Callable[[Floats], Floats]
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
    return draw_replicates(trace, trace, cuts, filters, inputs, seed=seed, compliance=compliance)


def measured(
    trace: Trace, numbers: Numbers, *inputs: Input, n: int | None = None, **more: Any
) -> tuple[MeasuredNumber, ...]:
    """Numbers that are read from a curve the same way whatever it is."""
    extractor = Extractor(numbers, len(trace.time) if n is None else n)
    return measure_numbers(replicates_of(trace, *inputs, **more), lambda _: extractor)


RATE = 50.0


NAMES = ("M1", "M2", "M3", "M4", "M5", "M6")


@dataclass(frozen=True)
class WireTake:
    """A take, and the path of its clamp."""

    tracks: MarkerTracks
    clamp: Floats


def wire_take(*, frames: int = 600, noise: float = 2e-5, seed: int = 0) -> WireTake:
    """Six markers 10 mm apart on a wire whose clamp goes down and up again, after 2 s of rest."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / RATE
    lift = 0.012 * (1 - np.cos(np.clip(time - 2, 0, None) * 0.6))
    along = np.linspace(0.01, 0.06, len(NAMES))
    clamp = np.column_stack([0 * time, -lift, 0 * time])
    rise = lift[:, None] * (along / 0.07) ** 2
    positions = np.stack([along - 5 * rise**2, rise, 0 * rise], axis=2) + clamp[:, None]
    positions += noise * rng.standard_normal(positions.shape)
    return WireTake(marker_tracks(NAMES, positions), clamp)


def marker_tracks(names: tuple[str, ...], positions: Floats) -> MarkerTracks:
    """Wrap positions as a take at 50 frames per second."""
    frames = np.arange(len(positions), dtype=np.float64)
    return MarkerTracks(frames / RATE, frames, RATE, names, positions)


def with_positions(take: WireTake, positions: Floats, *more: str) -> WireTake:
    """The same take with other positions, and further tracks on the right."""
    return WireTake(marker_tracks((*take.tracks.names, *more), positions), take.clamp)


def blank_columns(positions: Floats, count: int) -> Floats:
    """Append tracks that are blank from beginning to end."""
    return np.concatenate([positions, np.full((len(positions), count, 3), np.nan)], axis=1)
