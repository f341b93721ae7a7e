"""Tests that did not go as their protocol takes for granted, each said and doubted."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.process.motion import Motion
from labpipe.process.plausibility import check_rest, check_rig
from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Shape
from labpipe.records.quality import Finding
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result, Status
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal.turning_points import find_strokes, split_branches
from tests.builders.doubts import doubted

TIME = np.arange(0.0, 50.0, 0.02)


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    path = repository / "protocols" / "wire-cantilever.yaml"
    text = path.read_text(encoding="utf-8")
    text = text.replace("stroke: 53 mm", "stroke: 20 mm").replace("cycles: 3", "cycles: 1")
    return parse_protocol(text, "wire-cantilever.yaml")


def travel(*corners: tuple[float, float]) -> Floats:
    """A motion through (time s, position mm) corners."""
    times, places = zip(*corners, strict=True)
    noise = np.random.default_rng(1).normal(0, 1e-5, len(TIME))
    motion: Floats = 1e-3 * np.interp(TIME, times, places) + noise
    return motion


def seen(motion: Floats, force: Floats | None = None) -> Signals:
    made = Signals(displacement="deflection")
    pull = 20.0 * motion if force is None else force
    for name, values, unit in (
        ("travel", motion, "m"),
        ("deflection", motion, "m"),
        ("force", pull, "N"),
    ):
        made = made.with_new(name, Signal(TIME, values, unit, "markers"))
    return made


def looked_at(
    signals: Signals, protocol: Protocol, motion: Floats, shape: Shape | None = None
) -> list[Finding]:
    return list(check_rig(signals, shape, protocol, branches(motion), is_blocked=False))


def rest_looked_at(signals: Signals, stretches: dict[str, tuple[float, float]]) -> list[Finding]:
    zeroed = replace(signals, zeroed=stretches)
    motion = Motion(signals.raw["travel"], branches(SHARP), Clocks("markers"))
    return list(check_rest(zeroed, motion))


SHARP = travel((0, 0), (5, 0), (25, 20), (45, 0), (50, 0))


def branches(motion: Floats) -> tuple[Branch, ...]:
    return split_branches(TIME, find_strokes(TIME, motion, min_stroke=5e-3))


def test_no_faults_found(protocol: Protocol) -> None:
    assert not looked_at(seen(SHARP), protocol, SHARP)
    assert not rest_looked_at(seen(SHARP), {"force": (0.0, 2.0)})


def test_stroke_and_cycles(protocol: Protocol) -> None:
    motion = travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0))
    found = looked_at(seen(motion), protocol, motion)
    cycles, stroke = (each.note.message for each in found)
    assert cycles == "2 cycles measured, the protocol expects 1"
    assert stroke.startswith("a stroke of 10.0")
    assert stroke.endswith("mm measured, 20 mm expected")
    assert not doubted(found)


def test_a_string_cannot_push(protocol: Protocol) -> None:
    pull = 20.0 * SHARP - np.where(TIME > 30.0, 0.25, 0.0)
    why = doubted(looked_at(seen(SHARP, pull), protocol, SHARP))["force"]
    assert why.startswith("force_negative: the force falls to -0.2")
    assert "a string cannot push: the zero is wrong or drifts" in why


def test_what_presses_on_two_supports_cannot_pull(repository: Path) -> None:
    path = repository / "protocols" / "conduit-bundle.yaml"
    text = path.read_text(encoding="utf-8").replace("speed: 0.5 mm/s", "speed: 1 mm/s")
    text = text.replace("  section:", "  span: 152.4 mm\n  section:")
    bending = parse_protocol(text, "conduit-bundle.yaml")
    load = np.clip(200.0 * (SHARP - 0.005), 0.0, None)
    for drift, doubtful in ((-1e-4, False), (-0.01, True)):
        made = seen(SHARP, load + drift * TIME)
        made = made.with_new("displacement", made.raw["travel"])
        why = doubted(looked_at(made, bending, SHARP))
        assert ("force" in why) is doubtful
    assert re.fullmatch(
        r"force_negative: the force falls to -0\.4\d+ N, but what presses on a specimen between "
        r"supports cannot pull at it: the zero is wrong or drifts",
        why["force"],
    )


def test_a_slack_string_may_lose_the_counterweight(protocol: Protocol) -> None:
    pull = 20.0 * SHARP - np.where(TIME > 46.0, 0.026, 0.0)
    assert "force" not in doubted(looked_at(seen(SHARP, pull), protocol, SHARP))


def shape(length: float) -> Shape:
    return Shape(
        time=TIME[:1],
        positions=np.zeros((1, 2, 3)),
        names=("clamped end", "pull point"),
        flags=np.ones((1, 2), dtype=np.uint8),
        arc_length=np.array([0.0, length]),
        coefficients=np.zeros((1, 3, 0)),
        length=length,
        rotation_lab_to_specimen=np.eye(3),
    )


@pytest.mark.parametrize(("length", "off"), [(0.0851, False), (0.1, True), (0.075, True)])
def test_length_of_the_specimen(protocol: Protocol, length: float, off: bool) -> None:
    why = doubted(looked_at(seen(SHARP), protocol, SHARP, shape(length)))
    assert ("displacement" in why) == off
    if off:
        assert why["displacement"].startswith("length_unexpected: ")
        assert "the sheet says 85 mm" in why["displacement"]


def driven(speed: str, *, scale: float = 1.0) -> list[Finding]:
    """A motion of 20 mm in 20 s, the rig set to a speed, the numbers off by a factor."""
    text = (
        "version: 1\nname: p\nsources: {frame: {reader: dspace-csv, channels:"
        " {displacement: {channel: a}, force: {channel: b}}}}\n"
        f"rig: {{crosshead_speed: {speed}}}\n"
        "curve: {force: force, displacement: displacement}\n"
        "branches: {channel: displacement, min_stroke: 1 um}\n"
    )
    made = Signals().with_new("displacement", Signal(TIME, scale * SHARP, "m", "frame"))
    made = made.with_new("force", Signal(TIME, SHARP, "N", "frame"))
    parts = split_branches(TIME, find_strokes(TIME, scale * SHARP, min_stroke=5e-3 * scale))
    return list(check_rig(made, None, parse_protocol(text, "p.yaml"), parts, is_blocked=False))


@pytest.mark.parametrize("speed", ["1 mm/s", "0.9 mm/s", "1.15 mm/s"])
def test_the_speed_of_the_rig(speed: str) -> None:
    assert not driven(speed)


def test_another_speed_than_that_of_the_rig() -> None:
    found = driven("1.3 mm/s")
    assert re.fullmatch(
        r"speed_unexpected: (0\.99|1\.0)\d* mm/s measured over the first branch, 1\.3 mm/s "
        r"expected: look at rig\.crosshead_speed, and at unit and name of the displacement",
        doubted(found)["displacement"],
    )
    assert [(each.code, each.note.where) for each in found] == [
        ("speed_unexpected", "rig.crosshead_speed")
    ]


@pytest.mark.parametrize("scale", [1e-3, 1 / 25.4, 25.4, 1e3])
def test_another_unit_than_that_of_the_export(scale: float) -> None:
    assert doubted(driven("1 mm/s", scale=scale))["displacement"].startswith("speed_unexpected: ")


def test_rows_without_time_have_no_speed() -> None:
    made = seen(SHARP)
    made = made.with_new("travel", replace(made.raw["travel"], time_unit="1"))
    text = (
        "version: 1\nname: p\nsources: {frame: {reader: dspace-csv, channels:"
        " {travel: {channel: a}, force: {channel: b}}}}\nrig: {crosshead_speed: 0.9 m/s}\n"
        "curve: {force: force, displacement: travel}\n"
        "branches: {channel: travel, min_stroke: 1 mm}\n"
    )
    assert not doubted(looked_at(made, parse_protocol(text, "p.yaml"), SHARP))


FRAME = """\
version: 1
name: p
sources:
  frame:
    reader: load-frame
    channels:
      force: {channel: Load, plausible_peak: {from: 20 N, to: 2 kN}}
      displacement: {channel: Crosshead}
rig: {crosshead_speed: 1 mm/s}
curve: {force: force, displacement: displacement}
branches: {channel: displacement, min_stroke: 1 mm}
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: stiffness, from: 1 mm, to: 4 mm}
"""


def exported(*, units: tuple[str, str], swapped: bool = False, scale: float = 1.0) -> Recording:
    """What a load frame writes of 20 mm in 20 s along 10 N/mm: the numbers as in the file."""
    random = np.random.default_rng(2)
    mm = np.interp(TIME, (0, 5, 25, 50), (0, 0, 20, 20)) + random.normal(0, 0.01, len(TIME))
    newton = 10.0 * mm + random.normal(0, 0.02, len(TIME))
    columns = (mm, newton) if swapped else (scale * newton, mm)
    channels = tuple(
        Channel(name, name, values, unit_in_file=unit)
        for name, values, unit in zip(("Load", "Crosshead"), columns, units, strict=True)
    )
    return Recording("load-frame", clocks=(Clock("time", TIME),), channels=channels)


def results(recording: Recording, text: str = FRAME) -> dict[str, Result]:
    protocol = parse_protocol(text, "p.yaml")
    named = name_channels(recording, protocol.sources["frame"], Path("frame.csv"))
    found = reduce_recordings({"frame": named}, protocol)
    return {each.name: each for each in found.results}


def test_a_tensile_test_as_it_should_be() -> None:
    found = results(exported(units=("N", "mm")))
    assert {each.status for each in found.values()} == {Status.OK}
    assert found["stiffness"].value == pytest.approx(1e4, rel=0.01)


def test_kilonewtons_taken_for_newtons() -> None:
    found = results(exported(units=("N", "mm"), scale=1e-3))
    for name in ("peak_force.1", "stiffness"):
        assert found[name].status is Status.DOUBTFUL
        assert found[name].why.startswith("implausible_peak: the largest value is 0.20")
    assert found["peak_displacement.1"].status is Status.OK


@pytest.mark.parametrize("name", ["force", "displacement"])
def test_swapped_columns_that_say_their_units_are_refused(name: str) -> None:
    recording = exported(units=("mm", "N"), swapped=True)
    text = FRAME if name == "force" else FRAME.replace("Load,", "Crosshead,")
    protocol = parse_protocol(text, "p.yaml")
    column, si_unit, unit = {
        "force": ("Load", "N", "mm"),
        "displacement": ("Crosshead", "m", "N"),
    }[name]
    said = (
        rf"^frame\.csv, channel '{column}': expected a unit of the dimension of {si_unit}, found"
        rf" '{unit}'\. Name another channel with 'sources\.frame\.channels\.{name}\.channel: "
        r"\{value: \.\.\., because: \.\.\.\}' under 'overrides' in test\.yaml, or give "
        rf"'sources\.frame\.channels\.{name}\.calibration'\.$"
    )
    with pytest.raises(ReadError, match=said):
        name_channels(recording, protocol.sources["frame"], Path("frame.csv"))


def test_swapped_columns_without_units_are_doubted() -> None:
    text = FRAME.replace("channel: Load,", "channel: Load, unit: N,")
    text = text.replace("channel: Crosshead}", "channel: Crosshead, unit: mm}")
    found = results(exported(units=("", ""), swapped=True), text)
    for name in ("peak_displacement.1", "stiffness"):
        assert found[name].status is Status.DOUBTFUL
    assert found["peak_displacement.1"].why.startswith("speed_unexpected: ")
    assert "mm/s measured over the first branch, 1 mm/s expected" in found["stiffness"].why
    assert "implausible_peak: " not in found["peak_displacement.1"].why


def test_columns_without_units_are_refused() -> None:
    with pytest.raises(ReadError, match="channel 'Load': expected a unit, found none in the file"):
        results(exported(units=("", "")))


@pytest.mark.parametrize(("name", "quantity"), [("force", "force"), ("deflection", "displacement")])
def test_a_zero_taken_in_motion(name: str, quantity: str) -> None:
    assert doubted(rest_looked_at(seen(SHARP), {name: (4.0, 6.0)}))[quantity].startswith(
        "zero_not_at_rest: zeroed from 4.00 s to 6.00 s of the motion's clock, but the clamp moves"
    )


def test_zero_on_another_clock_without_a_fit_is_taken_as_it_stands() -> None:
    made = seen(SHARP)
    made = made.with_new("force", replace(made.raw["force"], clock="force"))
    assert "force" in doubted(rest_looked_at(made, {"force": (4.0, 6.0)}))
