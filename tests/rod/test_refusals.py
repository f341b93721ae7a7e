"""A line that cannot be followed says the step, the place and why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.sliders import linear_moment_law
from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Gravity, Held, Load, Plane
from labpipe.rod.line import Section
from labpipe.rod.statics import follow
from tests.builders.rods import LENGTH, STIFFNESS, clamp, linear_section, ramp, straight_line


def test_a_line_too_short_for_its_clips_fails_with_step_and_nodes() -> None:
    line = straight_line(LENGTH, 10, linear_section())
    way = line.positions[-1] + ramp((0.04, 0.0, 0.0), 4) + (-0.025, 0.0, 0.0)
    path = follow(line, [clamp(line), Held(-1, way)], steps=4)
    assert path.status == "failed"
    assert len(path.states) == 3
    (reason,) = path.reasons
    assert (reason.code, reason.step, reason.node) == ("too_short", 3, 10)
    assert reason.sentence == (
        "step 3: between nodes 0 and 10 the line is 0.5 m long, and the places that hold them are "
        "0.505 m apart"
    )


@pytest.mark.parametrize("row", [0, 2])
def test_a_taut_line_that_keeps_its_length_cannot_be_pulled(row: int) -> None:
    line = straight_line(LENGTH, 10, linear_section(mass=0.05))
    slack: Floats = np.full((4, 1), 0.02)
    slack[row] = 0.0
    way = line.positions[-1] - slack * np.array([1.0, 0.0, 0.0])
    path = follow(line, [clamp(line), Held(-1, way), Gravity()], steps=3)
    assert (path.status, len(path.states)) == ("failed", row)
    reason = path.reasons[0]
    assert (reason.code, reason.step, reason.node) == ("taut", row, 10)
    assert reason.sentence == (
        f"step {row}: between nodes 0 and 10 the line is taut, 0.5 m long between places just as "
        "far apart, and no tension can be told that balances its weight and loads: bring these on "
        "as the places come together, make the line longer, or give it an axial stiffness"
    )


def test_a_taut_line_may_lie_without_weight_or_stretch() -> None:
    bare = straight_line(LENGTH, 10, linear_section())
    load = Load(0, np.array([0.0, 0.0, -1.0]))
    assert follow(bare, [clamp(bare), clamp(bare, -1), load], steps=1).status == "ok"
    law = linear_moment_law(1e-9, 1e6)
    section = Section(law, 1e-9, axial_stiffness=1e3, mass_per_length=0.05)
    line = straight_line(LENGTH, 40, section)
    path = follow(
        line, [Held(0, line.positions[0]), Held(-1, line.positions[-1]), Gravity()], steps=1
    )
    assert path.status == "ok", path.reasons
    # a parabola: H = (EA w^2 L^2 / 24)^(1/3)
    weight = 0.05 * 9.81
    pull = (1e3 * weight**2 * LENGTH**2 / 24.0) ** (1.0 / 3.0)
    assert path.last.forces[20, 0] == pytest.approx(pull, rel=2e-3)


def test_a_line_with_hardly_any_slack_hangs_as_a_parabola() -> None:
    """Slack of 1e-6: it sags by L sqrt(3 slack / 8), and pulls by w L / (8 sag)."""
    line = straight_line(LENGTH, 40, linear_section(1e-6, torsion=1e-6, mass=0.05))
    way = line.positions[-1] + ramp((-1e-6 * LENGTH, 0.0, 0.0), 1)
    pins = [Held(0, line.positions[0]), Held(-1, way)]
    path = follow(line, [*pins, Gravity(ramp((0.0, 0.0, -9.81), 1))], steps=1)
    assert path.status == "ok", path.reasons
    sag = np.sqrt(3.0 / 8.0 * 1e-6) * LENGTH
    assert -np.min(path.last.positions[:, 2]) == pytest.approx(sag, rel=1e-3)
    pull = 0.05 * 9.81 * LENGTH**2 / (8.0 * sag)
    assert path.last.forces[20, 0] == pytest.approx(pull, rel=1e-3)


def test_a_line_cannot_be_held_in_a_table() -> None:
    section = replace(linear_section(), diameter=6e-3)
    line = straight_line(LENGTH, 10, section, start=(0.0, 0.0, 0.01))
    way = line.positions[-1] + ramp((0.0, 0.0, -0.01), 5)
    down = Held(-1, way, line.frames[-1], name="grip")
    path = follow(line, [down, Plane(np.zeros(3), name="table")], steps=5)
    assert (path.status, len(path.states)) == ("failed", 4)
    reason = path.reasons[0]
    assert (reason.code, reason.step, reason.node) == ("in_plane", 4, 10)
    assert reason.sentence == (
        "step 4: grip holds the axis of the line 2 mm above table; with its diameter it lies 3 mm "
        "above or higher"
    )


def test_a_line_that_stretches_too_far_is_torn() -> None:
    section = Section(linear_moment_law(STIFFNESS, 1e3), 8e-4, axial_stiffness=1e3)
    line = straight_line(LENGTH, 5, section)
    way = line.positions[-1] + ramp((0.08, 0.0, 0.0), 8)
    path = follow(line, [clamp(line), Held(-1, way)], steps=8)
    assert path.status == "failed"
    assert path.reasons[0].code == "torn"
    assert path.reasons[0].step == 3  # 4 % in step 2, 6 % in step 3
    assert path.last.forces[:, 0] == pytest.approx(1e3 * 0.02 / LENGTH, rel=1e-8)
