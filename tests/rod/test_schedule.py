"""What boundaries ask at a time."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.rod.assembly import Shape
from labpipe.rod.boundaries import Boundary, Gravity, Held, Load, Moment, Ring, String
from labpipe.rod.rotations import from_rotation_vectors, matrices, multiply
from labpipe.rod.schedule import Schedule
from tests.builders.rods import linear_section, straight_line

LINE = straight_line(1.0, 4, linear_section(mass=0.1))
START = Shape(LINE.positions, LINE.frames, np.zeros(4), np.zeros((4, 3)))


def schedule(*boundaries: Boundary, steps: int = 2) -> Schedule:
    return Schedule(LINE, boundaries, steps, START)


def test_paths_go_straight_between_their_rows() -> None:
    force = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0], [0.0, 2.0, 3.0]])
    plan = schedule(Load(-1, force))
    asked = [plan.demands(time, ()).forces[4] for time in (-1.0, -0.5, 0.0, 0.5, 1.5, 2.0)]
    assert [force[1] for force in asked] == pytest.approx([0.0, 0.0, 0.0, 0.0, 1.0, 2.0])
    assert [force[2] for force in asked] == pytest.approx([0.0, 0.5, 1.0, 2.0, 3.0, 3.0])


def test_weight_is_shared_by_the_nodes() -> None:
    forces = schedule(Gravity(np.array([0.0, 0.0, -10.0]))).demands(0.0, ()).forces
    assert forces[:, 2] == pytest.approx([-0.125, -0.25, -0.25, -0.25, -0.125])


def test_a_line_is_laid_in_gradually() -> None:
    frame = multiply(LINE.frames[0], from_rotation_vectors(np.array([0.0, 0.0, 0.6])))
    plan = schedule(Held(0, np.array([0.0, 0.2, 0.0]), frame))
    half = plan.demands(-0.5, (0,))
    np.testing.assert_allclose(half.held, [[0.0, 0.1, 0.0]])
    turned = matrices(LINE.frames[0]).T @ matrices(half.clamps)[0]
    assert np.arccos((np.trace(turned) - 1.0) / 2.0) == pytest.approx(0.3)
    np.testing.assert_allclose(plan.demands(0.0, (0,)).clamps, [frame])


def test_moments_turn_the_elements_at_their_node() -> None:
    moments = schedule(Moment(1, np.array([0.0, 0.0, 2.0])), Moment(-1, np.array([3.0, 0, 0])))
    asked = moments.demands(0.0, ()).moments
    assert asked[:, 2] == pytest.approx([1.0, 1.0, 0.0, 0.0])
    assert asked[:, 0] == pytest.approx([0.0, 0.0, 0.0, 3.0])


def test_what_lets_go_holds_up_to_its_step() -> None:
    plan = schedule(Held(2, LINE.positions[2], release=2))
    assert [plan.grips(step) for step in (0, 1, 2)] == [(0,), (0,), ()]


def test_anchors_and_rings() -> None:
    anchor = np.linspace([0.0, 0.0, 1.0], [0.0, 0.0, 2.0], 3)
    plan = schedule(String(4, anchor, 0.5), Ring(np.array([0.4, 0.02, 0.0])))
    asked = plan.demands(0.5, ())
    np.testing.assert_allclose(asked.anchors, [[0.0, 0.0, 1.25]])
    np.testing.assert_allclose(asked.rings, [[0.4, 0.02, 0.0]])
    assert plan.start_places == pytest.approx([1.6])
    np.testing.assert_allclose(plan.demands(-0.5, ()).rings, [[0.4, 0.01, 0.0]], atol=1e-12)


def test_rings_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="eye: near=9: allowed are 0 to 4"):
        schedule(Ring(np.zeros(3), near=9, name="eye"))


def test_the_size_of_the_forces() -> None:
    own = 1e-3 / 1.0**2
    assert schedule().force_scale() == pytest.approx(own)
    pulled = schedule(Load(0, np.array([[0.0, 0, 0], [3.0, 4.0, 0], [1.0, 0, 0]])))
    assert pulled.force_scale() == pytest.approx(5.0 + own)
