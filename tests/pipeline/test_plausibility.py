"""Tests that did not go as their protocol takes for granted, each said and doubted."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.plausibility import check_rest, check_rig
from labpipe.pipeline.reduction import reduce_recordings
from labpipe.process.reading import name_channels
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Shape
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result, Status
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


def bench(motion: Floats, force: Floats | None = None) -> Bench:
    made = Bench()
    made.displacement = "deflection"
    pull = 20.0 * motion if force is None else force
    for name, values, unit in (
        ("travel", motion, "m"),
        ("deflection", motion, "m"),
        ("force", pull, "N"),
    ):
        made.raw[name] = made.signals[name] = Signal(TIME, values, unit, "markers")
    return made


SHARP = travel((0, 0), (5, 0), (25, 20), (45, 0), (50, 0))


def branches(motion: Floats) -> tuple[Branch, ...]:
    return split_branches(TIME, find_strokes(TIME, motion, min_stroke=5e-3))


def test_all_well(protocol: Protocol) -> None:
    made = bench(SHARP)
    made.zeroed["force"] = (0.0, 2.0)
    check_rig(made, protocol, branches(SHARP))
    check_rest(made, branches(SHARP))
    assert not doubted(made)
    assert not made.notes


def test_stroke_and_cycles(protocol: Protocol) -> None:
    motion = travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0))
    made = bench(motion)
    check_rig(made, protocol, branches(motion))
    cycles, stroke = (note.message for note in made.notes)
    assert cycles == "2 cycles measured, the protocol expects 1"
    assert stroke.startswith("a stroke of 10.0")
    assert stroke.endswith("mm measured, 20 mm expected")
    assert not doubted(made)


def test_a_string_cannot_push(protocol: Protocol) -> None:
    made = bench(SHARP, 20.0 * SHARP - np.where(TIME > 30.0, 0.25, 0.0))
    check_rig(made, protocol, branches(SHARP))
    assert doubted(made)["force"].startswith("force_negative: the force falls to -0.2")
    assert "a string cannot push: the zero is wrong or drifts" in doubted(made)["force"]


def test_what_presses_on_two_supports_cannot_pull(repository: Path) -> None:
    path = repository / "protocols" / "conduit-bundle.yaml"
    text = path.read_text(encoding="utf-8").replace("speed: 0.5 mm/s", "speed: 1 mm/s")
    text = text.replace("specimen: {", "specimen: {span: 152.4 mm, ")
    bending = parse_protocol(text, "conduit-bundle.yaml")
    load = np.clip(200.0 * (SHARP - 0.005), 0.0, None)
    for drift, doubtful in ((-1e-4, False), (-0.01, True)):
        made = bench(SHARP, load + drift * TIME)
        made.raw["displacement"] = made.raw["travel"]
        check_rig(made, bending, branches(SHARP))
        assert ("force" in doubted(made)) is doubtful
    assert re.fullmatch(
        r"force_negative: the force falls to -0\.4\d+ N, but what presses on a specimen between "
        r"supports cannot pull at it: the zero is wrong or drifts",
        doubted(made)["force"],
    )


def test_a_slack_string_may_lose_the_counterweight(protocol: Protocol) -> None:
    made = bench(SHARP, 20.0 * SHARP - np.where(TIME > 46.0, 0.026, 0.0))
    check_rig(made, protocol, branches(SHARP))
    assert "force" not in doubted(made)


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
    made = bench(SHARP)
    made.shape = shape(length)
    check_rig(made, protocol, branches(SHARP))
    assert ("displacement" in doubted(made)) == off
    if off:
        assert doubted(made)["displacement"].startswith("length_unexpected: ")
        assert "the sheet says 85 mm" in doubted(made)["displacement"]


def driven(speed: str, *, scale: float = 1.0) -> Bench:
    """A motion of 20 mm in 20 s, the rig set to a speed, the numbers off by a factor."""
    text = (
        "version: 1\nname: p\nsources: {frame: {reader: dspace-csv, channels:"
        " {displacement: {channel: a}, force: {channel: b}}}}\n"
        f"rig: {{crosshead_speed: {speed}}}\n"
        "curve: {force: force, displacement: displacement}\n"
        "branches: {channel: displacement, min_stroke: 1 um}\n"
    )
    made = Bench()
    made.raw["displacement"] = Signal(TIME, scale * SHARP, "m", "frame")
    made.signals |= made.raw | {"force": Signal(TIME, SHARP, "N", "frame")}
    strokes = find_strokes(TIME, scale * SHARP, min_stroke=5e-3 * scale)
    check_rig(made, parse_protocol(text, "p.yaml"), split_branches(TIME, strokes))
    return made


@pytest.mark.parametrize("speed", ["1 mm/s", "0.9 mm/s", "1.15 mm/s"])
def test_the_speed_of_the_rig(speed: str) -> None:
    assert not driven(speed).doubts


def test_another_speed_than_that_of_the_rig() -> None:
    made = driven("1.3 mm/s")
    assert re.fullmatch(
        r"speed_unexpected: (0\.99|1\.0)\d* mm/s measured over the first branch, 1\.3 mm/s "
        r"expected: look at rig\.crosshead_speed, and at unit and name of the displacement",
        doubted(made)["displacement"],
    )
    assert [(note.code, note.where) for note in made.notes] == [
        ("speed_unexpected", "rig.crosshead_speed")
    ]


@pytest.mark.parametrize("scale", [1e-3, 1 / 25.4, 25.4, 1e3])
def test_another_unit_than_that_of_the_export(scale: float) -> None:
    made = driven("1 mm/s", scale=scale)
    assert doubted(made)["displacement"].startswith("speed_unexpected: ")


def test_rows_without_time_have_no_speed() -> None:
    made = bench(SHARP)
    made.raw["travel"] = replace(made.raw["travel"], time_unit="1")
    text = (
        "version: 1\nname: p\nsources: {frame: {reader: dspace-csv, channels:"
        " {travel: {channel: a}, force: {channel: b}}}}\nrig: {crosshead_speed: 9 m/s}\n"
        "curve: {force: force, displacement: travel}\n"
        "branches: {channel: travel, min_stroke: 1 mm}\n"
    )
    check_rig(made, parse_protocol(text, "p.yaml"), branches(SHARP))
    assert not doubted(made)


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
    _, found = reduce_recordings({"frame": named}, protocol)
    return {each.name: each for each in found}


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
    made = bench(SHARP)
    made.zeroed[name] = (4.0, 6.0)
    check_rest(made, branches(SHARP))
    assert doubted(made)[quantity].startswith(
        "zero_not_at_rest: zeroed from 4.00 s to 6.00 s of the motion's clock, but the clamp moves"
    )


def test_zero_on_another_clock_without_a_fit_is_taken_as_it_stands() -> None:
    made = bench(SHARP)
    made.raw["force"] = replace(made.raw["force"], clock="force")
    made.zeroed["force"] = (4.0, 6.0)
    check_rest(made, branches(SHARP))
    assert "force" in doubted(made)
