"""Pulls in memory on one clock, reduced by a protocol whose curve block and results are given."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from typing import Any

import numpy as np
import pytest

from labpipe.process.story import Reduction, reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result, Status
from labpipe.results.kinds import ReducedTest

NOISE = 0.02
STEP = 2e-5
"""m per sample."""
LINE = "stiffness, from: 2 mm, to: 10 mm"
SECTION = "{length: 100 mm, section: {width: 10 mm, thickness: 2 mm, outer_diameter: 10 mm, "
SECTION += "inner_diameter: 8 mm, wall: 0.5 mm, area: 5 mm**2}}"
BREAK = "failure: {force_below: 50 %}"
MARKED = "slips: {decision: marked, min_drop: 0.5 N}"


def pull(
    *, length: float = 0.02, stiffness: float = 5e3, slack: float = 0.0, seed: int = 0
) -> tuple[Floats, Floats]:
    """Displacement (m) and force (N) of a straight pull to a length; white noise of 20 mN."""
    travel: Floats = np.arange(0.0, length, STEP)
    force = stiffness * np.maximum(travel - slack, 0.0)
    return travel, force + np.random.default_rng(seed).normal(0.0, NOISE, len(travel))


def broken(travel: Floats, force: Floats, *, at: float) -> Floats:
    """The force, lost but for a hundredth from a displacement on."""
    return np.where(travel <= at, force, 0.01 * force)


def slipped(travel: Floats, force: Floats, *slips: tuple[float, float]) -> Floats:
    """The force, lower from each displacement on by a drop."""
    lower = force.copy()
    for at, drop in slips:
        lower[travel > at] -= drop
    return lower


def reduction(
    travel: Floats,
    force: Floats,
    *,
    curve: str = "",
    results: Sequence[str] = (),
    specimen: str = "{length: 100 mm}",
    time: bool = True,
    scale: str = "0 %",
    more: str = "",
    tested: date | None = None,
) -> Reduction:
    """What a pull sampled at 10 Hz comes to, or its rows without times; more keys of the force."""
    listed = "".join(f"  - {{result: {result}}}\n" for result in results)
    text = (
        "version: 1\nname: p\nsources:\n  frame:\n    reader: load-frame\n    channels:\n"
        f"      force: {{channel: F, scale_uncertainty: {scale}{more and ', '}{more}}}\n"
        "      displacement: {channel: D}\n"
        f"specimen: {specimen}\n"
        f"curve: {{force: force, displacement: displacement{curve and ', '}{curve}}}\n"
        "branches: {channel: displacement, min_stroke: 1 mm}\n"
    )
    text += f"results:\n{listed}" if listed else ""
    count = np.arange(len(travel), dtype=np.float64)
    clock = Clock("time", 0.1 * count) if time else Clock("rows", count, unit="1")
    channels = (
        Channel("force", "F", force, unit="N", clock=clock.name),
        Channel("displacement", "D", travel, unit="m", clock=clock.name),
    )
    recording = Recording("load-frame", clocks=(clock,), channels=channels)
    return reduce_recordings({"frame": recording}, parse_protocol(text, "p.yaml"), test_date=tested)


def pulled(travel: Floats, force: Floats, **options: Any) -> tuple[ReducedTest, dict[str, Result]]:
    """Evidence and results of a pull, asked for as `reduction` has it."""
    done = reduction(travel, force, **options)
    return done.reduced_test, {result.name: result for result in done.results}


def codes(test: ReducedTest) -> dict[str, str]:
    """Messages of the notes, by code."""
    return {note.code: note.message for note in test.findings.notes}


def holds(result: Result, true: float, unit: str) -> None:
    assert result.status is Status.OK
    assert result.unit == unit
    assert result.interval is not None
    assert result.value is not None
    half = 0.5 * (result.interval.upper - result.interval.lower)
    assert result.value == pytest.approx(true, abs=2.0 * half)
    assert result.value == pytest.approx(true, rel=0.01)
    assert result.method
    assert result.n >= 1
