"""Two protocols and a test sheet that the tests of this layer break in every way."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import load_test_sheet, resolve_protocol

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
SHEET = """\
test: A2-085-1
protocol: wire
specimen: {type: A2, spool: A2-s1, sample: 01, length: 80 mm}
date: 2026-03-04
files: {force: force.mat, markers: [take.csv]}
"""

Tell: TypeAlias = Callable[[str], list[str]]


@pytest.fixture
def wire() -> str:
    """A protocol that is right."""
    return WIRE


@pytest.fixture
def tube() -> str:
    """A protocol of a tensile test that is right."""
    return TUBE


@pytest.fixture
def lab(tmp_path: Path, wire: str) -> Path:
    """A folder with a protocol and a test."""
    (tmp_path / "protocols").mkdir()
    (tmp_path / "protocols" / "wire.yaml").write_text(wire, encoding="utf-8")
    (tmp_path / "test").mkdir()
    return tmp_path


@pytest.fixture
def write(lab: Path) -> Callable[[str], Path]:
    """Write the test sheet of the lab's test."""

    def write(text: str) -> Path:
        path = lab / "test" / "test.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def tell(lab: Path, write: Callable[[str], Path]) -> Tell:
    """Give the lines of the error of resolving a test sheet, without the folder."""

    def tell(text: str) -> list[str]:
        path = write(text)
        sheet = load_test_sheet(path)
        with pytest.raises(ProtocolError) as info:
            resolve_protocol(sheet, path, lab / "protocols")
        return str(info.value).replace(f"{lab}{os.sep}", "").splitlines()

    return tell
