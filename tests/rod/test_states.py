"""From cells to the nodes of a state, and back."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.boundaries import Gravity, Held, Load, Plane, Ring, String
from labpipe.rod.states import merged_rests, parted_rests
from labpipe.rod.supports import supports_of
from tests.builders.rods import (
    LENGTH,
    clamp,
    linear_section,
    ramp,
    sliding_section,
    straight_line,
    walked,
)


def test_rests_go_to_both_sides_and_back() -> None:
    line = straight_line(LENGTH, 5, sliding_section())
    supports = supports_of(line, ((0, True), (2, True)))
    rests = np.random.default_rng(0).normal(size=(len(supports.nodes), 3, 2))
    parted = parted_rests(supports, rests)
    assert parted.shape == (6, 2, 3, 2)
    assert not np.any(parted[0, 0])
    assert not np.any(parted[5])
    np.testing.assert_array_equal(parted[1, 0], parted[1, 1])
    assert np.all(parted[2, 0] != parted[2, 1])
    np.testing.assert_allclose(merged_rests(supports, parted), rests)


def test_a_clamp_that_is_gone_leaves_the_mean_of_both_sides() -> None:
    line = straight_line(LENGTH, 4, sliding_section())
    clamped, free = supports_of(line, ((2, True),)), supports_of(line, ())
    rests = np.random.default_rng(0).normal(size=(len(clamped.nodes), 3, 2))
    merged = merged_rests(free, parted_rests(clamped, rests))
    np.testing.assert_allclose(merged[1], 0.5 * (rests[1] + rests[2]))


def test_a_clamp_in_the_middle_takes_the_jump_of_the_moment() -> None:
    line = straight_line(LENGTH, 10, linear_section())
    load = Load(-1, ramp((0.0, 1e-4, 0.0), 2))
    state = walked(line, [Held(5, line.positions[5], line.frames[5]), load], 2).last
    before, behind = state.moments[5]
    np.testing.assert_allclose(before, 0.0, atol=1e-12)
    np.testing.assert_allclose(behind, -state.reaction_moments[0], atol=1e-12)
    assert state.reaction_moments[0, 2] == pytest.approx(-1e-4 * LENGTH / 2.0, rel=1e-3)
    np.testing.assert_allclose(state.forces[:5], 0.0, atol=1e-12)
    assert state.reaction_forces[1].tolist() == [0.0, 1e-4, 0.0]


def test_strings_rings_and_planes_have_their_reactions() -> None:
    line = straight_line(LENGTH, 10, linear_section(mass=0.05))
    string = String(-1, line.positions[-1] + (0.0, 0.0, 0.3) + ramp((0.0, 0.0, 0.05), 3), 0.3)
    ring = Ring(line.positions[5])
    floor = Plane(np.array([0.0, 0.0, -1.0]))
    path = walked(line, [clamp(line), string, ring, floor], 3)
    state = path.last
    assert state.reaction_forces[1, 2] > 1e-3
    assert state.reaction_forces[2, 2] < -1e-3
    np.testing.assert_allclose(state.reaction_forces.sum(axis=0), 0.0, atol=1e-10)
    assert np.isfinite(state.slid).tolist() == [False, False, True, False]
    assert state.slid[2] == pytest.approx(LENGTH / 2.0, abs=5e-3)
    assert state.contact_forces.shape == (1, 11, 3)
    assert state.positions[-1, 2] == pytest.approx(0.05, rel=0.1)


def test_the_bend_at_a_clamp_is_of_second_order() -> None:
    """Against the moment that the clamp must give, over the bending stiffness."""
    section, errors = linear_section(mass=0.05), []
    for elements in (10, 20, 40):
        line = straight_line(LENGTH, elements, section)
        state = walked(line, [clamp(line), Gravity()], 1).last
        wanted = np.linalg.norm(state.reaction_moments[0]) / section.law.stiffness
        assert int(np.argmax(state.bendings)) == 0
        errors.append(abs(state.bendings[0] / wanted - 1.0))
    assert errors[0] < 0.01
    assert errors[0] > 4.0 * errors[1] > 16.0 * errors[2]


def test_both_sides_of_a_clamp_are_carried_on_to_it() -> None:
    """Straight moments: exact, and nothing else is changed."""
    line = straight_line(LENGTH, 10, linear_section())
    held = Held(5, line.positions[5], line.frames[5])
    loads = [Load(node, ramp((0.0, 1e-5, 0.0), 1)) for node in (0, -1)]
    state = walked(line, [held, *loads], 1).last
    inner = state.node_curvatures[5, :, :2]
    next_ones, after = state.curvatures[[4, 6], 0, :2], state.curvatures[[3, 7], 0, :2]
    np.testing.assert_allclose(inner, 2.0 * next_ones - after, rtol=1e-6, atol=1e-12)
    others = np.delete(np.arange(11), 5)
    np.testing.assert_array_equal(state.node_curvatures[others], state.curvatures[others])
