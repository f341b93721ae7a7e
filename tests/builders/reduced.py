"""Recordings in memory, reduced by a protocol given as text: one clock, force and displacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from labpipe.process.story import Reduction, reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result
from labpipe.records.signals import Clocks, Filter, Signal, Signals
from labpipe.results.kinds import ReducedTest
from labpipe.signal.filters import filter_pieces

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


def loop(*, cycles: int = 2, noise: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Time, displacement and force: 10 mm up in 10 s along 100 N/m, down along 125 N/m to 2 mm."""
    time: Floats = np.arange(0.0, 4.0 + 20.0 * cycles, 0.02)
    phase = (time - 2.0) % 20.0
    moving = (time > 2.0) & (time < 2.0 + 20.0 * cycles)
    path = np.where(moving, 1e-3 * np.minimum(phase, 20.0 - phase), 0.0)
    force = np.where(phase < 10.0, 100.0 * path, np.maximum(125.0 * (path - 0.002), 0.0))
    random = np.random.default_rng(0)
    force = np.where(moving, force, 0.0) + random.normal(0.0, noise, len(time))
    return time, path + random.normal(0.0, 1e-3 * noise, len(time)), force


def identify_recording(time: Floats, displacement: Floats, force: Floats) -> Recording:
    """An export of the protocol: displacement and force on one clock."""
    channels = (
        Channel("force", "A", force, unit="V"),
        Channel("displacement", "B", displacement, unit="m"),
    )
    return Recording("dspace-mat", clocks=(Clock("time", time),), channels=channels)


def reduction(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    more: str = RESULTS,
    replaced: tuple[str, str] = ("", ""),
) -> Reduction:
    """What a test comes to; `more` and what is `replaced` make the protocol."""
    recording = identify_recording(time, displacement, force)
    text = PROTOCOL.replace(*replaced) if replaced[0] else PROTOCOL
    protocol = parse_protocol(text + more, "p.yaml")
    return reduce_recordings({"force": recording}, protocol)


def reduced(
    time: Floats, displacement: Floats, force: Floats, **options: Any
) -> tuple[ReducedTest, dict[str, Result]]:
    """Evidence and results by name, of the same."""
    done = reduction(time, displacement, force, **options)
    return done.reduced_test, {result.name: result for result in done.results}


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
) -> ReducedTest:
    """Filter two records branch by branch, and put them on one clock: a curve."""
    at = time if force_time is None else force_time
    branches, clocks = branches or one_loading(time), clocks or Clocks("one")
    ends = [time[end - 1] for branch in branches for end in (branch.start, branch.stop) if end]
    signals = Signals()
    for name, clock, unit, made, stamps, values in (
        ("force", "force" if clocks.force_fit else "one", "N", filters, at, force),
        ("displacement", "one", "m", filters_of_displacement, time, displacement),
    ):
        raw = Signal(stamps, values, unit, clock)
        signals = signals.add_signal(name, raw)
        if made:
            cuts = np.searchsorted(stamps, ends, side="right").tolist()
            stride = int(np.prod([size for _, size in made]))
            done = filter_pieces(values, cuts, made)
            filtered = replace(raw, time=stamps[::stride], values=done)
            signals = signals.replace_filtered(name, filtered, *made)
    way = signals.filtered["displacement"]
    pull = clocks.interpolate(signals.filtered["force"], way.time)
    corrected = way.values - compliance * pull if compliance else way.values
    curve = Curve(way.time, corrected, pull, branches)
    more |= {"unfiltered_force": signals.raw["force"]}
    return ReducedTest(signals, clocks, curve=curve, compliance=compliance, **more)
