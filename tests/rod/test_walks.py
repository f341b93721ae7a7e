from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from labpipe.mechanics.law.sliders import get_current_sliders, make_linear_law
from labpipe.mechanics.rod.assembly import Assembly, Balance, ImposedValues, LineHistory, Shape
from labpipe.mechanics.rod.boundaries import (
    Boundary,
    Gravity,
    Held,
    Load,
    Plane,
    compute_plane_contact,
    compute_ring_contact,
    evaluate_curve,
    find_nearest_parameter,
)
from labpipe.mechanics.rod.equilibrium import StabilityCheck
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    multiply,
    to_matrices,
    to_rotation_vectors,
)
from labpipe.mechanics.rod.statics import RodSettings, follow
from labpipe.mechanics.rod.supports import Grip, split_cells_at_clamps
from labpipe.mechanics.studies.harness_numbers import compute_residual_curvature
from tests.approved import Approve
from tests.builders.rods import (
    LENGTH,
    STIFFNESS,
    clamp,
    element_lengths,
    linear_section,
    ramp,
    reversed_case,
    sliding_section,
    space_case,
    straight_line,
    walked,
)

TURN = from_rotation_vectors(np.array([0.7, -1.1, 2.0]))


def test_nothing_depends_on_the_frame_of_space() -> None:
    path, spun = (walked(*space_case(turn), 6) for turn in (None, TURN))
    space = to_matrices(TURN)
    for state, image in zip(path.states, spun.states, strict=True):
        np.testing.assert_allclose(image.positions, state.positions @ space.T, atol=1e-9 * LENGTH)
        np.testing.assert_allclose(image.slider_rests, state.slider_rests, atol=1e-9 * 5.0)
        np.testing.assert_allclose(image.forces, state.forces @ space.T, atol=1e-9)
        turns = to_rotation_vectors(multiply(conjugate(multiply(TURN, state.frames)), image.frames))
        np.testing.assert_allclose(turns, 0.0, atol=1e-9)
    np.testing.assert_allclose(spun.lost_energy, path.lost_energy, atol=1e-9 * path.lost_energy[-1])


def test_nothing_depends_on_the_order_of_the_nodes() -> None:
    line, boundaries = space_case()
    path = walked(line, boundaries, 6)
    twin = walked(*reversed_case(line, boundaries), 6)
    assert path.lost_energy[-1] > 0.0
    for state, image in zip(path.states, twin.states, strict=True):
        np.testing.assert_allclose(image.positions[::-1], state.positions, atol=1e-9 * LENGTH)
        np.testing.assert_allclose(image.forces[::-1], -state.forces, atol=1e-9)
        size, turned = (np.linalg.norm(x.slider_rests, axis=3) for x in (state, image))
        np.testing.assert_allclose(turned[::-1, ::-1], size, atol=1e-9 * 5.0)
        np.testing.assert_allclose(image.reaction_forces, state.reaction_forces, atol=1e-9)
    np.testing.assert_allclose(twin.lost_energy, path.lost_energy, atol=1e-9 * path.lost_energy[-1])


def test_forces_and_moments_balance_and_lengths_are_kept() -> None:
    """Over the line as a whole, and over each element about its first node."""
    line, boundaries = space_case()
    state = walked(line, boundaries, 6).last
    np.testing.assert_allclose(element_lengths(state), line.lengths, rtol=1e-8)
    across = np.hypot(state.node_curvatures[..., 0], state.node_curvatures[..., 1])
    np.testing.assert_allclose(state.bending_curvatures, across.max(axis=1))
    loads = np.zeros((13, 3))
    loads[4] = (0.0, 0.02, -0.01)
    loads[1:, 2] -= 0.02 * 9.81 * line.lengths / 2.0
    loads[:-1, 2] -= 0.02 * 9.81 * line.lengths / 2.0
    total = loads.sum(axis=0) + state.reaction_forces[:2].sum(axis=0)
    np.testing.assert_allclose(total, 0.0, atol=1e-9)
    arms = np.cross(state.positions, loads).sum(axis=0)
    ends = np.cross(state.positions[[0, -1]], state.reaction_forces[:2]).sum(axis=0)
    np.testing.assert_allclose(arms + ends + state.reaction_moments[:2].sum(axis=0), 0.0, atol=1e-9)
    inner = np.diff(state.moments[1:-1, 0], axis=0)
    force_moments = np.cross(np.diff(state.positions, axis=0), state.forces)[1:-1]
    np.testing.assert_allclose(inner + force_moments, 0.0, atol=1e-9)


def work_and_energy(path: RodPath) -> tuple[float, float]:
    """Work of the boundaries of `space_case`, by their mean forces in each step; elastic energy."""
    line, section, work = path.line, path.line.section, 0.0
    sides = 0.5 * np.stack([np.append(0.0, line.lengths), np.append(line.lengths, 0.0)], axis=1)
    _, grip, _, weight = path.boundaries
    assert isinstance(grip, Held)
    assert isinstance(weight, Gravity)
    frames = np.array(grip.frame)
    turns = to_rotation_vectors(multiply(frames[1:], conjugate(frames[:-1])))
    for step, (old, new) in enumerate(pairwise(path.states)):
        moves = new.positions - old.positions
        forces = 0.5 * (old.reaction_forces + new.reaction_forces)
        work += np.sum(forces[:3] * moves[[0, -1, 4]])
        work += 0.5 * (old.reaction_moments + new.reaction_moments)[1] @ turns[step]
        gravity = section.mass_per_length * weight.vector[[step, step + 1]].mean(axis=0)
        work += sides.sum(axis=1) @ moves @ gravity
    curvatures, sliders = new.curvatures, get_current_sliders(section.law, new.slider_rests)
    strained = np.sum((curvatures[:, :, None, :2] - sliders.rest_curvatures) ** 2, axis=3)
    moduli = np.array([*2 * [section.law.spring_stiffness], section.torsional_stiffness])
    density = strained @ sliders.stiffnesses + curvatures**2 @ moduli
    return float(work), 0.5 * float(np.sum(sides * density))


def test_work_is_stored_or_lost() -> None:
    """To third order in the steps, which the mean of forces at both ends of a step is good for."""
    errors = []
    for steps in (20, 40):
        path = walked(*space_case(steps=steps), steps)
        work, energy = work_and_energy(path)
        errors.append(abs(work - energy - path.lost_energy[-1]) / work)
        assert path.lost_energy[-1] > 0.2 * work
    assert errors[0] < 1e-3
    assert errors[1] < 0.35 * errors[0]


def test_a_curled_wire_held_at_one_end_is_a_circle_to_second_order() -> None:
    """Straight at the start, without weight; its half cell at the clamp is curled as well."""
    curl, errors = 3.0 / LENGTH, []
    for n in (10, 20, 40):
        straight = straight_line(LENGTH, n, linear_section())
        line = replace(straight, rest_curvature=np.tile([0.0, curl, 0.0], (n - 1, 1)))
        state = walked(line, [Held(0, line.positions[0], line.frames[0])], 1).last
        angle = curl * line.stations
        circle = np.stack([np.sin(angle), 0.0 * angle, 1.0 - np.cos(angle)], axis=1) / curl
        errors.append(np.max(np.linalg.norm(state.positions - circle, axis=1)) / LENGTH)
    assert errors[0] < 3e-3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=0.01)


@pytest.mark.slow
def test_what_stays_unstable_is_said_once_and_walked_on() -> None:
    """Clamped taut it cannot leave its line; it is not looked at in ever smaller parts."""
    line = straight_line(LENGTH, 10, linear_section())
    twist = ramp((9.4 * STIFFNESS / line.section.torsional_stiffness, 0.0, 0.0), 10)
    frames = multiply(from_rotation_vectors(twist), line.frames[-1:])
    path = follow(line, [clamp(line), Held(-1, line.positions[-1], frames)], steps=10)
    assert (path.status, len(path.states), path.jump_steps) == ("doubtful", 11, (10,))
    assert [(reason.code, reason.message[:7]) for reason in path.reasons] == [
        ("unstable", "step 10")
    ]


@pytest.mark.parametrize("node", [-1, 5])
def test_what_is_let_go_springs_back_in_part(node: int) -> None:
    line = straight_line(LENGTH, 10, sliding_section())
    reach = line.positions[node, 0]
    angle = np.linspace(0.0, 0.5, 6)[:, None]
    positions = 0.9 * reach * np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    grip = Held(node, np.concatenate([positions, positions[-1:]]), release=6)
    path = walked(line, [clamp(line), grip], 6)
    held, released = path.states[5], path.states[6]
    np.testing.assert_allclose(released.forces, 0.0, atol=1e-9)
    np.testing.assert_allclose(released.moments, 0.0, atol=1e-9)
    np.testing.assert_allclose(released.reaction_forces[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(released.reaction_moments[0], 0.0, atol=1e-9)
    assert 0.02 * reach < released.positions[node, 1] < 0.9 * held.positions[node, 1]


@pytest.mark.slow
@pytest.mark.parametrize("max_turn", [0.5, 0.02])
def test_each_cell_of_what_falls_springs_back_by_what_it_carries(max_turn: float) -> None:
    """Without weight: by its own law, however long the way, and nothing bends the free end."""
    line = straight_line(LENGTH, 20, sliding_section())
    angle = np.linspace(0.0, 0.8, 41)[:, None]
    size = 0.6 * (1.0 - 0.2 * angle**2) * LENGTH
    positions = size * np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    grip = Held(12, np.concatenate([positions, positions[-1:]]), release=41)
    settings = RodSettings(max_turn=max_turn)
    path = follow(line, [clamp(line), grip], steps=41, settings=settings)
    held, free = path.states[40:]
    expected = compute_residual_curvature(held, line.section.law)
    assert np.max(held.bending_curvatures) > 8.0
    curvature = np.linalg.norm(free.curvatures[:, :, :2], axis=2).max(axis=1)
    np.testing.assert_allclose(curvature, expected, atol=1e-6)
    assert not np.any(free.slider_rests[13:])
    assert path.jump_energy[41] == pytest.approx(path.lost_energy[41] - path.lost_energy[40])


def test_a_heavy_line_lies_on_a_table_with_its_axis_a_radius_above() -> None:
    """Drawn along it, it pulls by 0.4 of its weight, as a line without thickness would."""
    section = replace(linear_section(mass=0.2), diameter=6e-3)
    line = straight_line(LENGTH, 20, section)
    drawn = Held(0, np.array([0.0, 0.0, 3e-3]) + ramp((-0.05, 0.0, 0.0), 4))
    path = walked(
        line, [Plane(np.zeros(3), friction=0.4), Gravity(np.array([0.0, 0.0, -9.81])), drawn], 4
    )
    weight = 0.2 * LENGTH * 9.81 * 39.0 / 40.0  # the grip carries that of half an element
    for state in path.states:
        assert state.positions[:, 2] == pytest.approx(3e-3, abs=1e-8)
        assert state.reaction_forces[0, 2] == pytest.approx(weight)
    assert path.last.reaction_forces[2, 0] == pytest.approx(-0.4 * weight)
    assert path.last.positions[-1, 0] == pytest.approx(LENGTH - 0.05)


def test_faults_of_boundaries_are_said() -> None:
    line = straight_line(LENGTH, 10, linear_section())
    with pytest.raises(ValueError, match=r"boundary 1 \(Load\): node=11: expected 0 to 10"):
        follow(line, [clamp(line), Load(11, np.zeros(3))], steps=2)
    with pytest.raises(ValueError, match=r"tip: force has 4 rows; expected 1 or steps \+ 1 = 3"):
        follow(line, [clamp(line), Load(-1, np.zeros((4, 3)), name="tip")], steps=2)
    with pytest.raises(ValueError, match=r"point of shape \(1, 3, 3\): expected"):
        Plane(ramp((0.0, 0.0, 0.1), 2))
    with pytest.raises(ValueError, match="step 0: node 0 is held twice"):
        follow(line, [clamp(line), Held(0, line.positions[0])], steps=2)


def test_a_taut_line_may_lie_without_weight_or_stretch() -> None:
    """With a stretch or a slack of 1e-6 it hangs as a parabola."""
    light = straight_line(LENGTH, 10, linear_section())
    load = Load(0, np.array([0.0, 0.0, -1.0]))
    walked(light, [clamp(light), clamp(light, -1), load], 1)
    weight = 0.05 * 9.81
    section = Section(make_linear_law(1e-9, 1e6), 1e-9, axial_stiffness=1e3, mass_per_length=0.05)
    line = straight_line(LENGTH, 40, section)
    pins = [Held(node, line.positions[node]) for node in (0, -1)]
    hung = walked(line, [*pins, Gravity()], 1).last
    pull = (1e3 * weight**2 * LENGTH**2 / 24.0) ** (1.0 / 3.0)
    assert hung.forces[20, 0] == pytest.approx(pull, rel=2e-3)
    line = straight_line(LENGTH, 40, linear_section(1e-6, torsion=1e-6, mass=0.05))
    nearer = Held(-1, line.positions[-1] + ramp((-1e-6 * LENGTH, 0.0, 0.0), 1))
    hung = walked(line, [pins[0], nearer, Gravity(ramp((0.0, 0.0, -9.81), 1))], 1).last
    sag = np.sqrt(3.0 / 8.0 * 1e-6) * LENGTH
    assert -np.min(hung.positions[:, 2]) == pytest.approx(sag, rel=1e-3)
    assert hung.forces[20, 0] == pytest.approx(weight * LENGTH**2 / (8.0 * sag), rel=1e-3)


N = 40

LINE = straight_line(LENGTH, N, linear_section())


def column(grips: tuple[Grip, ...], *, load: float) -> tuple[StabilityCheck, Balance, Shape]:
    """A straight line pressed along itself."""
    supports = split_cells_at_clamps(LINE, grips)
    strings = (np.zeros(0, dtype=np.int64), np.zeros(0))
    assembly = Assembly(LINE, supports, (), strings, n_rings=0, force=STIFFNESS / LENGTH**2)
    forces, none = np.zeros((N + 1, 3)), np.zeros((0, 3))
    forces[-1, 0] = -load
    clamps = LINE.frames[-np.arange(len(supports.clamps))]
    asked = ImposedValues(LINE.positions[supports.held_nodes], clamps, forces, none, none, 0.0)
    history = LineHistory(
        np.zeros((len(supports.nodes), 0, 2)), np.zeros((0, N + 1, 3)), np.zeros(0)
    )
    shape = Shape(LINE.positions, LINE.frames, np.zeros(N), np.tile([-load, 0.0, 0.0], (N, 1)))
    return StabilityCheck(assembly), assembly.compute_balance(shape, asked, history), shape


FREE: tuple[Grip, ...] = ((0, True),)


@pytest.mark.parametrize(
    ("grips", "factor"),
    [
        (FREE, 0.25),
        (((0, False), (N, False)), 1.0),
        (((0, True), (N, False)), 2.0457),
        (((0, True), (N, True)), 4.0),
    ],
    ids=["free", "pinned", "clamped-pinned", "clamped"],
)
def test_critical_loads_of_columns(grips: tuple[Grip, ...], factor: float) -> None:
    critical = factor * np.pi**2 * STIFFNESS / LENGTH**2
    below, above = (column(grips, load=factor * critical) for factor in (0.996, 1.004))
    assert below[0].is_stable(*below[1:])
    assert not above[0].is_stable(*above[1:])


def test_a_column_gives_way_to_the_side_it_is_pushed_to() -> None:
    critical = np.pi**2 * STIFFNESS / (4.0 * LENGTH**2)
    check, balance, shape = column(FREE, load=1.01 * critical)
    push = np.eye(10 * N + 3)[10 * N + 2]
    mode = check.find_softest_mode(balance, shape, push)
    assert mode is not None
    moves = mode[10 * np.arange(N + 1)[:, None] + np.arange(3)]
    expected = 1.0 - np.cos(np.pi / 2.0 * LINE.stations / LENGTH)
    np.testing.assert_allclose(moves[:, 2] / moves[-1, 2], expected, atol=2e-3)
    assert moves[-1, 2] > 0.0
    assert np.max(np.abs(moves[:, 1])) < 0.05 * moves[-1, 2]


@pytest.mark.parametrize("place", [0.2, 7.5, 19.8])
def test_a_ring_pulls_across_at_the_nearest_place_of_a_smooth_curve(place: float) -> None:
    turn = np.linspace(0.0, 2.0, 21)
    nodes = np.stack([np.cos(turn), np.sin(turn), 0.2 * turn], axis=1)
    middle = 0.5 * (nodes[7] + nodes[8])
    np.testing.assert_allclose(evaluate_curve(nodes, 7.5), middle, atol=1e-15)
    np.testing.assert_array_equal(evaluate_curve(nodes, 20.0), nodes[-1])
    along = evaluate_curve(nodes, place + 1e-6) - evaluate_curve(nodes, place - 1e-6)
    across = np.cross(along, [0.3, 0.1, 1.0])
    ring = evaluate_curve(nodes, place) + 0.02 * across / np.linalg.norm(across)
    assert find_nearest_parameter(nodes, ring, place + 0.9) == pytest.approx(place, abs=1e-6)
    threaded = compute_ring_contact(nodes, ring, place, 50.0)
    assert threaded.force @ along == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(threaded.force) == pytest.approx(50.0 * 0.02)
    assert threaded.weights.sum() == pytest.approx(1.0)


def test_a_node_sticks_until_friction_is_reached_and_drags_its_contact_along() -> None:
    plane, start = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.5), np.zeros((1, 3))
    above = compute_plane_contact(plane, 1e4, np.array([[1.0, 2.0, 1e-6]]), start, max_gap=1e-9)
    assert not np.any(above.forces)
    np.testing.assert_array_equal(above.points, [[1.0, 2.0, 1e-6]])
    sticking = compute_plane_contact(plane, 1e4, np.array([[4e-4, 0.0, -1e-3]]), start, max_gap=0.0)
    np.testing.assert_allclose(sticking.forces, [[-4.0, 0.0, 10.0]])
    sliding = compute_plane_contact(plane, 1e4, np.array([[9e-4, 0.0, -1e-3]]), start, max_gap=0.0)
    np.testing.assert_allclose(sliding.forces, [[-5.0, 0.0, 10.0]])
    np.testing.assert_allclose(sliding.points[:, :2], [[4e-4, 0.0]])
    end = compute_plane_contact(plane, 1e4, np.array([[8e-4, 0, -1e-3]]), sliding.points, max_gap=0)
    np.testing.assert_allclose(end.forces, [[-4.0, 0.0, 10.0]])


def ended(line: Line, steps: int, *boundaries: Boundary) -> tuple[str, tuple[object, ...]]:
    """Sentence of the only reason of a path; its status, number of states, code, step and node."""
    path = follow(line, boundaries, steps=steps)
    (reason,) = path.reasons
    step = int(reason.message.removeprefix("step ").partition(":")[0])
    places = re.findall(r"(\S+) mm from the start", reason.message)
    node = int(np.argmin(np.abs(line.stations - 1e-3 * float(places[-1]))))
    facts = (path.status, len(path.states), reason.code, step, node)
    return reason.message, facts


def test_what_ends_a_walk_or_makes_it_doubtful(approved: Approve) -> None:
    """Bends beyond the law; clips too far apart, without slack, in a table; a line that is torn."""
    ends = []
    line = straight_line(LENGTH, 10, Section(make_linear_law(STIFFNESS, 2.0), 8e-4))
    bent = ended(line, 5, clamp(line), Load(-1, ramp((0.0, 0.02, 0.0), 5)))
    ends.append((bent, ("doubtful", 6, "beyond_law", 2, 0)))
    line = straight_line(LENGTH, 10, linear_section(mass=0.05))
    positions = line.positions[-1] + ramp((0.04, 0.0, 0.0), 4) - (0.025, 0.0, 0.0)
    outcome = ended(line, 4, clamp(line), Held(-1, positions))
    ends.append((outcome, ("failed", 3, "too_short", 3, 10)))
    for row in (0, 2):
        slack = 0.02 * (np.arange(4) != row)[:, None] * np.array([1.0, 0.0, 0.0])
        end = Held(-1, line.positions[-1] - slack)
        ends.append((ended(line, 3, clamp(line), end, Gravity()), ("failed", row, "taut", row, 10)))
    line = straight_line(LENGTH, 10, replace(linear_section(), diameter=6e-3), start=(0, 0, 0.01))
    lowered = line.positions[-1] + ramp((0.0, 0.0, -0.01), 5)
    grip, table = Held(-1, lowered, line.frames[-1], name="grip"), Plane(np.zeros(3), name="table")
    ends.append((ended(line, 5, grip, table), ("failed", 4, "in_plane", 4, 10)))
    section = Section(make_linear_law(STIFFNESS, 1e3), 8e-4, axial_stiffness=1e3)
    line = straight_line(LENGTH, 5, section)
    pulled = Held(-1, line.positions[-1] + ramp((0.08, 0.0, 0.0), 8))
    # 4 % in step 2, 6 % in step 3
    ends.append((ended(line, 8, clamp(line), pulled), ("failed", 3, "torn", 3, 0)))
    assert [facts for (_, facts), _ in ends] == [expected for _, expected in ends]
    approved(sentence for (sentence, _), _ in ends)


@pytest.mark.slow
def test_a_line_that_nothing_holds_falls() -> None:
    path = follow(straight_line(LENGTH, 5, linear_section(mass=0.1)), [Gravity()], steps=1)
    assert path.status == "failed"
    with pytest.raises(ValueError, match="no state was reached: step 0: no equilibrium was found"):
        _ = path.last
