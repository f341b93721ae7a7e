"""Two example protocols that the tests of this layer break in every way."""

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
TUBE = """\
version: 1
name: tube
sources:
  frame:
    reader: load-frame
    dialect: [mts-testsuite, table]
    part: Specimen 1
    channels:
      force: {channel: [Load, Force], plausible_peak: {from: 20 N, to: 2 kN}}
      displacement: {channel: Crosshead, unit: mm}
specimen: {length: 75 mm, section: {width: 18 mm, thickness: 0.3 mm}}
rig: {crosshead_speed: 5 mm/s}
steps:
  - {step: zero, channel: force, over: 0.1 s, by: line}
curve:
  force: force
  displacement: displacement
  compliance: {value: 0.2 um/N, uncertainty: 5 %}
  failure: {force_below: 50 %}
  slips: {decision: marked, min_drop: 2 N}
  slack: {from: 10 %, to: 30 %}
branches: {channel: displacement, min_stroke: 5 mm}
results:
  - {result: peak-force}
  - {result: stiffness, name: stiffness_first, from: 2 mm, to: 8 mm}
  - {result: two-segments, from: 2 mm, to: 20 mm}
  - {result: normalised-stiffness, of: stiffness_first}
  - {result: modulus, of: segment_stiffness_first, area: rectangle}
  - {result: failure}
  - {result: energy-to-break}
  - {result: slips}
  - {result: slack}
  - {result: compliance, from: 50 N, to: 400 N}
report:
  figures: [stiffness-lines]
groups: {main: [stiffness_first, peak_force.2], scaled: true, min_p: 1 %, margin: 10 %}
"""

Told: TypeAlias = Callable[..., list[str]]


@pytest.fixture
def wire() -> str:
    """A protocol that is right."""
    return WIRE


@pytest.fixture
def tube() -> str:
    """A protocol of a tensile test that is right."""
    return TUBE


@pytest.fixture
def told() -> Told:
    """Give the lines of the error that a protocol with some changes (old, new) leads to."""
    return _teller(WIRE)


@pytest.fixture
def told_of_tube() -> Told:
    """Give the same of the tensile protocol."""
    return _teller(TUBE)


def _teller(protocol: str) -> Told:
    def told(*changes: tuple[str, str]) -> list[str]:
        text = protocol
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        with pytest.raises(ProtocolError) as info:
            parse_protocol(text, "p.yaml")
        return str(info.value).splitlines()

    return told
