from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from labpipe.mechanics.law.sliders import SliderLaw, make_linear_law
from labpipe.mechanics.rod.assembly import Shape
from labpipe.mechanics.rod.boundaries import (
    Boundary,
    Gravity,
    Held,
    Load,
    Plane,
    String,
)
from labpipe.mechanics.rod.line import Line, Section, build_line
from labpipe.mechanics.rod.rotations import (
    build_frame,
    compute_shortest_rotations,
    conjugate,
    cross,
    from_rotation_vectors,
    multiply,
    normalise,
    skew,
    to_matrices,
    to_rotation_vectors,
)
from labpipe.mechanics.rod.schedule import Schedule
from labpipe.mechanics.rod.supports import CLAMP_WEIGHT, split_cells_at_clamps
from labpipe.records.arrays import Floats
from tests.approved import Approve
from tests.builders.rods import linear_section, straight_line

SECTION = linear_section()


def test_a_line_along_points_is_not_twisted() -> None:
    t = np.linspace(0.0, 6.0, 61)
    helix = np.stack([np.cos(t), np.sin(t), 0.3 * t], axis=1)
    line = build_line(helix, SECTION, is_rest_shape=True)
    np.testing.assert_allclose(line.rest_curvature[:, 2], 0.0, atol=1e-12)
    bends = np.linalg.norm(line.rest_curvature, axis=1)
    np.testing.assert_allclose(bends, 1.0 / (1.0 + 0.3**2), rtol=1e-3)
    steps = np.diff(helix, axis=0)
    along = to_matrices(line.frames)[:, :, 2]
    np.testing.assert_allclose(along, steps / np.linalg.norm(steps, axis=1)[:, None], atol=1e-14)
    assert not np.any(build_line(helix, SECTION).rest_curvature)


def test_a_line_knows_its_frames_at_the_nodes() -> None:
    """Of an arc its tangents, at the ends as well; between unequal elements by their lengths."""
    angles = np.linspace(0.0, 1.2, 7)
    line = build_line(ARC, SECTION, is_rest_shape=True)
    for node, angle in enumerate(angles):
        direction = to_matrices(line.compute_clamp_frame(node))[:, 2]
        np.testing.assert_allclose(direction, [np.cos(angle), np.sin(angle), 0.0], atol=1e-12)
    np.testing.assert_array_equal(line.compute_clamp_frame(-1), line.compute_clamp_frame(6))
    line = build_line(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.5, 0.0]]), SECTION)
    start = conjugate(line.frames[0])
    frames = np.array([line.frames[1], line.compute_clamp_frame(1)])
    turn, half_turn = to_rotation_vectors(multiply(start, frames))
    np.testing.assert_allclose(half_turn, line.lengths[0] / line.length * turn, atol=1e-14)


LAW = make_linear_law(1e-3, 10.0)


REFUSED: list[Callable[[], object]] = [
    lambda: Section(SliderLaw(0.0, np.zeros(0), np.zeros(0), 0.0, 1.0), 1e-3),
    lambda: Section(LAW, 0.0),
    lambda: Section(LAW, 1e-3, axial_stiffness=-1.0),
    lambda: Section(LAW, 1e-3, axial_stiffness=100.0, coupling=1.0),
    lambda: Section(LAW, 1e-3, mass_per_length=np.nan),
    lambda: build_line(np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]]), SECTION),
    lambda: build_line(np.zeros((1, 3)), SECTION),
    lambda: build_line(np.array([[0.0, 0, 0], [np.nan, 0, 0]]), SECTION),
    lambda: build_line(np.array([[0.0, 0, 0], [np.inf, 0, 0]]), SECTION),
    lambda: Held(0, np.zeros((2, 2))),
    lambda: Held(0, np.zeros(3), np.array([2.0, 0.0, 0.0, 0.0])),
    lambda: Held(0, np.zeros(3), release=0),
    lambda: Load(0, np.array([[0.0, 0, 0], [np.nan, 0, 0]])),
    lambda: String(0, np.zeros(3), 0.0),
    lambda: Plane(np.zeros(3), friction=-0.1),
    lambda: Plane(np.zeros(3), np.zeros(3)),
    lambda: schedule(Load(9, np.zeros(3), name="eye")),
    lambda: build_frame(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -1.0])),
]


def test_what_is_refused(approved: Approve) -> None:
    messages = []
    for call in REFUSED:
        with pytest.raises(ValueError) as refusal:  # noqa: PT011
            call()
        messages.append(refusal.value)
    approved(messages)


def test_weight_is_shared_by_nodes() -> None:
    """What lets go holds up to its step."""
    forces = schedule(Gravity(np.array([0.0, 0.0, -10.0]))).compute_imposed_values(0.0, ()).forces
    assert forces[:, 2] == pytest.approx([-0.125, -0.25, -0.25, -0.25, -0.125])
    plan = schedule(Held(2, LINE.positions[2], release=2))
    assert [plan.list_grips(step) for step in (0, 1, 2)] == [(0,), (0,), ()]


LINE = straight_line(1.0, 4, linear_section(mass=0.1))

START = Shape(LINE.positions, LINE.frames, np.zeros(4), np.zeros((4, 3)))


def schedule(*boundaries: Boundary, steps: int = 2) -> Schedule:
    return Schedule(LINE, boundaries, steps, START)


def test_paths_go_straight_between_their_rows() -> None:
    force = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0], [0.0, 2.0, 3.0]])
    plan = schedule(Load(-1, force))
    times = (-1.0, -0.5, 0.0, 0.5, 1.5, 2.0)
    asked = [plan.compute_imposed_values(time, ()).forces[4] for time in times]
    assert [force[1] for force in asked] == pytest.approx([0.0, 0.0, 0.0, 0.0, 1.0, 2.0])
    assert [force[2] for force in asked] == pytest.approx([0.0, 0.5, 1.0, 2.0, 3.0, 3.0])


def test_a_line_is_laid_in_gradually() -> None:
    frame = multiply(LINE.frames[0], from_rotation_vectors(np.array([0.0, 0.0, 0.6])))
    plan = schedule(Held(0, np.array([0.0, 0.2, 0.0]), frame))
    half = plan.compute_imposed_values(-0.5, (0,))
    np.testing.assert_allclose(half.held_positions, [[0.0, 0.1, 0.0]])
    rotation = to_matrices(LINE.frames[0]).T @ to_matrices(half.clamp_frames)[0]
    assert np.arccos((np.trace(rotation) - 1.0) / 2.0) == pytest.approx(0.3)
    np.testing.assert_allclose(plan.compute_imposed_values(0.0, (0,)).clamp_frames, [frame])


def uneven() -> Line:
    line = straight_line(1.0, 4, linear_section())
    lengths = np.array([0.1, 0.2, 0.3, 0.4])
    return Line(lengths, line.section, line.positions, line.frames, np.arange(9.0).reshape(3, 3))


def test_clamps_part_cells() -> None:
    free = split_cells_at_clamps(uneven(), ((0, False), (4, False)))
    assert free.nodes.tolist() == [1, 2, 3]
    assert free.lengths == pytest.approx([0.15, 0.25, 0.35])
    assert free.side_weights[0] == pytest.approx([0.05 / 0.15, 0.1 / 0.15])
    assert free.held_nodes.tolist() == [0, 4]
    assert len(free.clamp_pairs) == 0
    supports = split_cells_at_clamps(uneven(), ((2, True), (0, True)))
    assert supports.nodes.tolist() == [0, 1, 2, 2, 3]
    assert supports.sides.tolist() == [[5, 0], [0, 1], [1, 4], [4, 2], [2, 3]]
    assert supports.lengths == pytest.approx([0.05, 0.15, 0.1, 0.15, 0.35])
    assert supports.rest_curvature[0].tolist() == [0.0, 1.0, 2.0]  # of its neighbour
    assert sorted(supports.clamp_pairs[:, 0].tolist()) == [0, 1, 2]
    assert supports.own_weights == pytest.approx([1.0 - CLAMP_WEIGHT] * 3 + [1.0])


def test_an_element_between_two_clamps_has_a_share_of_both() -> None:
    supports = split_cells_at_clamps(uneven(), ((1, True), (2, True)))
    assert supports.own_weights[1] == pytest.approx(1.0 - 2.0 * CLAMP_WEIGHT)
    assert sorted(supports.clamp_pairs[supports.clamp_pairs[:, 0] == 1, 1].tolist()) == [0, 1]


def draw_vectors(number: int = 40) -> Floats:
    """Rotation vectors from nothing to nearly a half turn, rad."""
    random = np.random.default_rng(3)
    directions = normalise(random.normal(size=(number, 3)))
    return np.asarray(np.linspace(0.0, 3.1, number)[:, None] * directions)


def to_scipy(frames: Floats) -> Rotation:
    return Rotation.from_quat(np.roll(frames, -1, axis=1))


def test_rotations_are_those_of_scipy() -> None:
    u, v = draw_vectors(), draw_vectors()[::-1]
    first, second = from_rotation_vectors(u), from_rotation_vectors(v)
    np.testing.assert_allclose(to_scipy(first).as_rotvec(), u, atol=1e-14)
    np.testing.assert_allclose(to_rotation_vectors(first), u, atol=1e-14)
    np.testing.assert_allclose(to_rotation_vectors(-first), u, atol=1e-14)
    expected = (to_scipy(first) * to_scipy(second).inv()).as_matrix()
    np.testing.assert_allclose(
        to_matrices(multiply(first, conjugate(second))), expected, atol=1e-14
    )
    np.testing.assert_allclose(cross(u, v), np.cross(u, v), atol=1e-15)
    np.testing.assert_allclose(np.einsum("nxy,ny->nx", skew(u), v), np.cross(u, v), atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_a_frame_points_along_and_its_first_axis_up(seed: int) -> None:
    direction, up = np.random.default_rng(seed).normal(size=(2, 3))
    axes = to_matrices(build_frame(direction, up))
    np.testing.assert_allclose(axes[:, 2], normalise(direction), atol=1e-14)
    assert axes[:, 0] @ up > 0.0
    assert axes[:, 1] @ up == pytest.approx(0.0, abs=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_shortest_turns_turn_one_into_the_other_opposites_too() -> None:
    start = normalise(np.random.default_rng(1).normal(size=(5, 3)))
    end = np.concatenate([normalise(np.random.default_rng(2).normal(size=(4, 3))), -start[4:]])
    turns = compute_shortest_rotations(start, end)
    turned = np.einsum("nxy,ny->nx", to_matrices(turns), start)
    np.testing.assert_allclose(turned, end, atol=1e-14)
    along = np.einsum("nk,nk->n", to_rotation_vectors(turns), start)
    np.testing.assert_allclose(along, 0.0, atol=1e-14)


ANGLES = np.linspace(0.0, 1.2, 7)

ARC = np.stack([np.sin(ANGLES), 1.0 - np.cos(ANGLES), 0.0 * ANGLES], axis=1)
