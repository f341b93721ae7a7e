"""Synthetic takes of a clamped wire with known truth, for tests of the marker steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.recording import MarkerTracks

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
