"""Recordings in memory, reduced by a protocol given as text: one clock, force and displacement."""

from __future__ import annotations

import numpy as np

from labpipe.process.story import Reduced, reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result
from labpipe.results.evidence import Evidence

PROTOCOL = """\
version: 1
name: p
sources:
  force:
    reader: dspace-mat
    channels:
      force: {channel: A, unit: V, calibration: {gain: 1 N/V, gain_uncertainty: 1 %}}
      displacement: {channel: B, unit: mm}
curve: {force: force, displacement: displacement}
branches: {channel: displacement, min_stroke: 1 mm}
"""
RESULTS = """\
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: initial-stiffness, from: 1 mm, to: 4 mm}
  - {result: unloading-stiffness, over: 2 mm}
  - {result: energy}
  - {result: residual-displacement, force_below: 20 mN}
"""


def loop(*, cycles: int = 2, noise: float = 0.0, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Time, displacement and force: 10 mm up in 10 s along 100 N/m, down along 125 N/m to 2 mm."""
    time: Floats = np.arange(0.0, 4.0 + 20.0 * cycles, 0.02)
    phase = (time - 2.0) % 20.0
    moving = (time > 2.0) & (time < 2.0 + 20.0 * cycles)
    path = np.where(moving, 1e-3 * np.minimum(phase, 20.0 - phase), 0.0)
    force = np.where(phase < 10.0, 100.0 * path, np.maximum(125.0 * (path - 0.002), 0.0))
    random = np.random.default_rng(seed)
    force = np.where(moving, force, 0.0) + random.normal(0.0, noise, len(time))
    return time, path + random.normal(0.0, 1e-3 * noise, len(time)), force


def reduction(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    more: str = RESULTS,
    replaced: tuple[str, str] = ("", ""),
) -> Reduced:
    """What a test comes to; `more` and what is `replaced` make the protocol."""
    channels = (
        Channel("force", "A", force, unit="V"),
        Channel("displacement", "B", displacement, unit="m"),
    )
    recording = Recording("dspace-mat", clocks=(Clock("time", time),), channels=channels)
    text = PROTOCOL.replace(*replaced) if replaced[0] else PROTOCOL
    protocol = parse_protocol(text + more, "p.yaml")
    return reduce_recordings({"force": recording}, protocol)


def reduced(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    more: str = RESULTS,
    replaced: tuple[str, str] = ("", ""),
) -> tuple[Evidence, dict[str, Result]]:
    """Evidence and results by name, of the same."""
    done = reduction(time, displacement, force, more=more, replaced=replaced)
    return done.evidence, {each.name: each for each in done.results}
