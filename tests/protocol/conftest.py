"""An example protocol that the tests of this layer break in every way."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol

WIRE = """\
version: 1
name: wire
sources:
  force:
    reader: [dspace-mat, dspace-csv]
    channel: Model Root/Load/Out1
    unit: V
    calibration: {gain: 0.5 N/V, offset: 0 N, gain_uncertainty: 0.2 %}
  markers:
    reader: motive-csv
specimen: {length: 85 mm}
rig: {crosshead_speed: 1 mm/s, cycles: 3, string: {length: 760 mm, counterweight: 2.7 g}}
markers: {clamp: Clamp, along: all, grip_offset: 6 mm}
align: {method: turning-points, channel: force, motion_window: 25 s, force_window: 2 s,
  max_residual: 5 ms, max_drift: 500 ppm}
steps:
  - {step: repair-markers, max_gap: 0.5 s, max_jump: 4 mm, frozen: 0.2 s}
  - {step: specimen-frame, over: 2 s}
  - {step: fit-shape, terms: 7, tip: free}
  - {step: zero, channel: force, over: 2 s}
  - {step: smooth, channel: force, method: moving-average, span: 0.1 s}
curve: {force: force, displacement: deflection}
branches: {channel: travel, min_stroke: 5 mm}
results:
  - {result: clock}
  - {result: peak-force}
  - {result: initial-stiffness, from: 0.5 mm, to: 4 mm}
report:
  display: {displacement: mm, force: N}
  figures: [force-displacement, wire-shapes]
"""

Told: TypeAlias = Callable[..., list[str]]


@pytest.fixture
def wire() -> str:
    """A protocol that is right."""
    return WIRE


@pytest.fixture
def told() -> Told:
    """Give the lines of the error that a protocol with some changes (old, new) leads to."""

    def told(*changes: tuple[str, str]) -> list[str]:
        text = WIRE
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        with pytest.raises(ProtocolError) as info:
            parse_protocol(text, "p.yaml")
        return str(info.value).splitlines()

    return told
