"""Energies of simple states."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.sliders import linear_moment_law
from labpipe.rod.boundaries import Held, Load, Moment
from labpipe.rod.line import Section
from labpipe.rod.rotations import from_rotation_vectors, multiply
from tests.builders.rods import LENGTH, SLIDING, clamp, ramp, sliding_section, straight_line, walked


def test_a_twisted_line_stores_half_the_torque_times_the_turn() -> None:
    line = straight_line(LENGTH, 8, sliding_section())
    frames = multiply(line.frames[-1:], from_rotation_vectors(ramp((0.0, 0.0, 0.4), 4)))
    path = walked(line, [clamp(line), Held(-1, line.positions[-1], frames)], 4)
    assert path.stored[-1] == pytest.approx(0.5 * 0.8e-3 / LENGTH * 0.4**2, rel=1e-9)
    assert path.work[-1] == pytest.approx(path.stored[-1], rel=1e-7)
    assert path.lost[-1] == 0.0


def test_stretch_and_twist_share_energy() -> None:
    section = Section(linear_moment_law(1e-3, 10.0), 8e-4, axial_stiffness=40.0, coupling=0.1)
    line = straight_line(LENGTH, 8, section)
    path = walked(line, [clamp(line), Load(-1, ramp((0.4, 0.0, 0.0), 3))], 3)
    # the end is free to turn: it lengthens by EA less C^2 / GJ
    free = 40.0 - 0.1**2 / 8e-4
    assert path.last.stretches[3] == pytest.approx(0.4 / free, rel=1e-2)
    assert path.last.curvatures[4, 0, 2] == pytest.approx(-0.1 / 8e-4 * 0.4 / free, rel=1e-2)
    assert path.work[-1] == pytest.approx(path.stored[-1], rel=1e-7)


def test_held_ends_feel_stretch_and_twist_as_a_pair() -> None:
    section = Section(linear_moment_law(1e-3, 10.0), 8e-4, axial_stiffness=40.0, coupling=0.1)
    line = straight_line(LENGTH, 8, section)
    way = line.positions[-1] + ramp((0.01, 0.0, 0.0), 2)
    frames = multiply(line.frames[-1:], from_rotation_vectors(ramp((0.0, 0.0, 0.3), 2)))
    state = walked(line, [clamp(line), Held(-1, way, frames)], 2).last
    strain, twist = 0.01 / LENGTH, 0.3 / LENGTH
    assert state.reaction_forces[1, 0] == pytest.approx(40.0 * strain + 0.1 * twist, rel=1e-6)
    assert state.reaction_moments[1, 0] == pytest.approx(0.1 * strain + 8e-4 * twist, rel=1e-6)


def test_a_cell_that_slides_loses_what_its_sliders_carry() -> None:
    """The half cell at the clamp of a single element, bent by a moment."""
    line = straight_line(0.02, 1, sliding_section())
    path = walked(line, [clamp(line), Moment(-1, ramp((0.0, 0.0, 6e-3), 12))], 12)
    curvature = float(path.last.bendings[0])
    slid = np.maximum(curvature - SLIDING.slip_curvatures, 0.0)
    assert np.all(slid > 0.0)
    lost = SLIDING.stiffnesses * SLIDING.slip_curvatures @ slid
    assert path.lost[-1] == pytest.approx(0.01 * lost, rel=1e-9)
    assert path.work[-1] == pytest.approx(path.stored[-1] + path.lost[-1], rel=2e-3)
