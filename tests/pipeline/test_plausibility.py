"""Tests that did not go as their protocol takes for granted, each said and doubted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.clocks import turning_points
from labpipe.pipeline.plausibility import check_rest, check_rig, check_turns
from labpipe.processing.strokes import find_strokes, split_branches
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Shape

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


def turned(motion: Floats) -> Bench:
    made = bench(motion)
    strokes = find_strokes(TIME, motion, min_stroke=5e-3)
    turns = turning_points(made.raw["travel"], strokes, window=25.0)
    check_turns(made, made.raw["travel"], strokes, turns)
    return made


def test_all_well(protocol: Protocol) -> None:
    made = turned(SHARP)
    made.zeroed["force"] = (0.0, 2.0)
    check_rig(made, protocol, branches(SHARP))
    check_rest(made, branches(SHARP))
    assert not made.doubts
    assert not made.notes


def test_stroke_and_cycles(protocol: Protocol) -> None:
    motion = travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0))
    made = bench(motion)
    check_rig(made, protocol, branches(motion))
    cycles, stroke = (note.message for note in made.notes)
    assert cycles == "2 cycles measured, the protocol expects 1"
    assert stroke.startswith("a stroke of 10.0")
    assert stroke.endswith("mm measured, 20 mm expected")
    assert not made.doubts


def test_a_string_cannot_push(protocol: Protocol) -> None:
    made = bench(SHARP, 20.0 * SHARP - np.where(TIME > 30.0, 0.25, 0.0))
    check_rig(made, protocol, branches(SHARP))
    assert made.doubts["force"].startswith("force_negative: the force falls to -0.2")
    assert "a string cannot push: the zero is wrong or drifts" in made.doubts["force"]


def test_a_slack_string_may_lose_the_counterweight(protocol: Protocol) -> None:
    made = bench(SHARP, 20.0 * SHARP - np.where(TIME > 46.0, 0.026, 0.0))
    check_rig(made, protocol, branches(SHARP))
    assert "force" not in made.doubts


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


@pytest.mark.parametrize(("length", "doubted"), [(0.0851, False), (0.1, True), (0.075, True)])
def test_length_of_the_specimen(protocol: Protocol, length: float, doubted: bool) -> None:
    made = bench(SHARP)
    made.shape = shape(length)
    check_rig(made, protocol, branches(SHARP))
    assert ("displacement" in made.doubts) == doubted
    if doubted:
        assert made.doubts["displacement"].startswith("length_unexpected: ")
        assert "the sheet says 85 mm" in made.doubts["displacement"]


@pytest.mark.parametrize(("name", "quantity"), [("force", "force"), ("deflection", "displacement")])
def test_a_zero_taken_in_motion(name: str, quantity: str) -> None:
    made = bench(SHARP)
    made.zeroed[name] = (4.0, 6.0)
    check_rest(made, branches(SHARP))
    assert made.doubts[quantity].startswith(
        "zero_not_at_rest: zeroed from 4.00 s to 6.00 s of the motion's clock, but the clamp moves"
    )


def test_zero_on_another_clock_without_a_fit_is_taken_as_it_stands() -> None:
    made = bench(SHARP)
    made.raw["force"] = replace(made.raw["force"], clock="force")
    made.zeroed["force"] = (4.0, 6.0)
    check_rest(made, branches(SHARP))
    assert "force" in made.doubts


def test_a_turn_that_was_not_seen() -> None:
    made = turned(np.where((TIME > 24.5) & (TIME < 25.5), np.nan, SHARP))
    assert set(made.doubts) == {"displacement", "force", "clock"}
    assert made.doubts["clock"].startswith("turn_not_seen: the motion was not seen to turn near 2")


@pytest.mark.parametrize("wait", [0.15, 0.2])
def test_a_turn_that_is_no_corner(wait: float) -> None:
    half = wait / 2
    made = turned(travel((0, 0), (5, 0), (25 - half, 20), (25 + half, 20), (45 + half, 0), (50, 0)))
    assert set(made.doubts) == {"displacement", "clock"}
    assert made.doubts["clock"].startswith("turn_rounded: the travel turns ")


def test_noise_alone_rounds_no_turn() -> None:
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 2e-5, len(TIME))
        assert not turned(SHARP + noise).doubts
