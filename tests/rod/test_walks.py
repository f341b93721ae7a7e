from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.sliders import linear_moment_law
from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Demands, LineMemory, Shape
from labpipe.rod.boundaries import Gravity, Held, Load, Moment, Plane
from labpipe.rod.line import Section
from labpipe.rod.plane_contact import added_at, pull_strings, touch_plane
from labpipe.rod.ring_contact import nearest_place, point_at, thread
from labpipe.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    matrices,
    multiply,
    rotation_vectors,
)
from labpipe.rod.stability import StabilityCheck
from labpipe.rod.statics import RodSettings, follow
from labpipe.rod.supports import Grip, supports_of
from labpipe.studies.residual_curvature import kept_curvature
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
    there_and_back,
    walked,
)

TURN = from_rotation_vectors(np.array([0.7, -1.1, 2.0]))


def test_nothing_depends_on_the_frame_of_space() -> None:
    plain, turned = (walked(*space_case(turn), 6) for turn in (None, TURN))
    space = matrices(TURN)
    for before, behind in zip(plain.states, turned.states, strict=True):
        np.testing.assert_allclose(behind.positions, before.positions @ space.T, atol=1e-9 * LENGTH)
        np.testing.assert_allclose(behind.rests, before.rests, atol=1e-9 * 5.0)
        np.testing.assert_allclose(behind.forces, before.forces @ space.T, atol=1e-9)
        off = rotation_vectors(multiply(conjugate(multiply(TURN, before.frames)), behind.frames))
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
    np.testing.assert_allclose(turned.lost, plain.lost, atol=1e-9 * plain.lost[-1])


def test_nothing_depends_on_the_order_of_the_nodes() -> None:
    line, boundaries = space_case()
    plain = walked(line, boundaries, 6)
    other = walked(*reversed_case(line, boundaries), 6)
    assert plain.lost[-1] > 0.0
    for before, behind in zip(plain.states, other.states, strict=True):
        np.testing.assert_allclose(behind.positions[::-1], before.positions, atol=1e-9 * LENGTH)
        np.testing.assert_allclose(behind.forces[::-1], -before.forces, atol=1e-9)
        np.testing.assert_allclose(
            np.linalg.norm(behind.rests[::-1, ::-1], axis=3),
            np.linalg.norm(before.rests, axis=3),
            atol=1e-9 * 5.0,
        )
        np.testing.assert_allclose(behind.reaction_forces, before.reaction_forces, atol=1e-9)
    np.testing.assert_allclose(other.lost, plain.lost, atol=1e-9 * plain.lost[-1])


def test_a_line_that_does_not_stretch_keeps_its_length() -> None:
    line, boundaries = space_case()
    path = walked(line, boundaries, 6)
    for state in path.states:
        np.testing.assert_allclose(element_lengths(state), line.lengths, rtol=1e-8)


def test_forces_and_moments_balance() -> None:
    """Over the line as a whole, and over each element about its first node."""
    line, boundaries = space_case()
    state = walked(line, boundaries, 6).last
    loads = np.zeros((13, 3))
    loads[4] = (0.0, 0.02, -0.01)
    loads[1:, 2] -= 0.02 * 9.81 * line.lengths / 2.0
    loads[:-1, 2] -= 0.02 * 9.81 * line.lengths / 2.0
    np.testing.assert_allclose(
        loads.sum(axis=0) + state.reaction_forces[:2].sum(axis=0), 0.0, atol=1e-9
    )
    arms = np.cross(state.positions, loads).sum(axis=0)
    ends = np.cross(state.positions[[0, -1]], state.reaction_forces[:2]).sum(axis=0)
    np.testing.assert_allclose(arms + ends + state.reaction_moments[:2].sum(axis=0), 0.0, atol=1e-9)
    inner = np.diff(state.moments[1:-1, 0], axis=0)
    turned = np.cross(np.diff(state.positions, axis=0), state.forces)[1:-1]
    np.testing.assert_allclose(inner + turned, 0.0, atol=1e-9)


def test_work_is_stored_or_lost() -> None:
    """To third order in the steps, which the mean of forces at both ends of a step is good for."""
    off = []
    for steps in (20, 40):
        path = walked(*space_case(steps=steps), steps)
        off.append(abs(path.work - path.stored - path.lost)[-1] / path.work[-1])
        assert path.lost[-1] > 0.2 * path.work[-1]
        assert (path.work - path.stored)[0] == pytest.approx(0.0, abs=1e-12)
    assert off[0] < 1e-3
    assert off[1] < 0.35 * off[0]


def test_a_plane_that_is_turned_has_the_same_loop() -> None:
    line = straight_line(LENGTH, 10, sliding_section())
    peak = 0.01
    tips = []
    for angle in (0.0, 1.0, 2.5):
        force = there_and_back((0.0, peak * np.cos(angle), peak * np.sin(angle)), 30)
        path = walked(line, [clamp(line), Load(-1, force)], 30)
        along = np.array([0.0, np.cos(angle), np.sin(angle)])
        tips.append([state.positions[-1] @ along for state in path.states])
    np.testing.assert_allclose(tips[1], tips[0], atol=1e-9)
    np.testing.assert_allclose(tips[2], tips[0], atol=1e-9)
    assert abs(tips[0][-1]) > 0.01 * max(tips[0])  # it has come to rest elsewhere


def test_a_moment_rolls_a_circle_to_second_order() -> None:
    gaps = []
    for n in (20, 40):
        line = straight_line(LENGTH, n, linear_section())
        moment = ramp((0.0, 2.0 * np.pi * STIFFNESS / LENGTH, 0.0), 10)
        free = RodSettings(checks_stability=False)  # beyond half a circle it would whirl in space
        state = follow(line, [clamp(line), Moment(-1, moment)], steps=10, settings=free).last
        gaps.append(np.linalg.norm(state.positions[-1] - state.positions[0]) / LENGTH)
        # a moment is the same all along, and so is the curvature, to rounding
        np.testing.assert_allclose(
            np.abs(state.curvatures[1:-1, :, 1]), 2.0 * np.pi / LENGTH, rtol=1e-8
        )
    assert gaps[0] < 2e-3
    assert gaps[1] == pytest.approx(gaps[0] / 4.0, rel=0.05)


def test_a_curled_wire_held_at_one_end_is_a_circle_to_second_order() -> None:
    """Straight at the start, without weight; its half cell at the clamp is curled as well."""
    curl, errors = 3.0 / LENGTH, []
    for n in (10, 20, 40, 80):
        straight = straight_line(LENGTH, n, linear_section())
        line = replace(straight, natural=np.tile([0.0, curl, 0.0], (n - 1, 1)))
        state = walked(line, [Held(0, line.positions[0], line.frames[0])], 1).last
        angle = curl * line.stations
        circle = np.stack([np.sin(angle), 0.0 * angle, 1.0 - np.cos(angle)], axis=1) / curl
        errors.append(np.max(np.linalg.norm(state.positions - circle, axis=1)) / LENGTH)
    assert errors[0] < 3e-3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=0.01)


@pytest.mark.parametrize(
    ("torsion", "first"), [(0.3, 9), (0.8, 12), (3.0, 18)], ids=["soft", "middle", "stiff"]
)
def test_a_circle_rolled_by_a_moment_of_constant_direction_would_whirl(
    torsion: float, first: int
) -> None:
    """In space; the rates of the dense matrix turn negative in that twentieth of a circle."""
    line = straight_line(LENGTH, 20, linear_section(torsion=torsion * STIFFNESS))
    moment = ramp((0.0, 2.0 * np.pi * STIFFNESS / LENGTH, 0.0), 20)
    path = follow(line, [clamp(line), Moment(-1, moment)], steps=20)
    assert path.status == "doubtful"
    assert [(reason.code, reason.step) for reason in path.reasons] == [("whirls", first)]
    assert path.reasons[0].sentence == (
        f"step {first}: the equilibrium is not stable, and moments of constant direction set the "
        "line whirling; it gives way most at node 20"
    )
    assert path.snapped == ()


def test_a_walk_goes_on_from_a_state_as_if_it_had_not_stopped() -> None:
    line, boundaries = space_case()
    whole = walked(line, boundaries, 6)
    held = boundaries[1]
    assert isinstance(held, Held)
    assert held.frame is not None
    load, weight = boundaries[2], boundaries[3]
    assert isinstance(load, Load)
    assert isinstance(weight, Gravity)
    rest = [
        boundaries[0],
        Held(-1, held.position[3:], held.frame[3:]),
        Load(load.node, load.force[3:]),
        Gravity(weight.vector[3:]),
    ]
    again = follow(line, rest, steps=3, start=whole.states[3])
    np.testing.assert_allclose(again.last.positions, whole.last.positions, atol=1e-9)
    np.testing.assert_allclose(again.last.rests, whole.last.rests, atol=1e-7)


@pytest.mark.slow
def test_a_column_buckles_beyond_its_critical_load_only() -> None:
    line = straight_line(LENGTH, 30, linear_section())
    critical = np.pi**2 * STIFFNESS / (4.0 * LENGTH**2)
    straight = walked(line, [clamp(line), Load(-1, ramp((-0.998 * critical, 0.0, 0.0), 3))], 3)
    assert straight.snapped == ()
    assert straight.last.positions[-1] == pytest.approx([LENGTH, 0.0, 0.0], abs=1e-9)
    # Timoshenko and Gere, Theory of Elastic Stability, table 2-4: at 1.063 of it, 40 degrees
    bent = walked(line, [clamp(line), Load(-1, ramp((-1.063 * critical, 0.0, 0.0), 3))], 3)
    assert bent.snapped == (3,)
    assert bent.last.positions[-1, 0] / LENGTH == pytest.approx(0.881, abs=2e-3)
    assert np.linalg.norm(bent.last.positions[-1, 1:]) / LENGTH == pytest.approx(0.422, abs=3e-3)


@pytest.mark.slow
def test_what_stays_unstable_is_said_once_and_walked_on() -> None:
    """Pinned taut it cannot leave its line; it is not looked at in ever smaller parts."""
    line = straight_line(LENGTH, 10, linear_section())
    moments = ramp((2.2 * np.pi * STIFFNESS / LENGTH, 0.0, 0.0), 10)
    pins = [Held(node, line.positions[node]) for node in (0, -1)]
    path = follow(line, [*pins, Moment(0, -moments), Moment(-1, moments)], steps=10)
    assert (path.status, len(path.states), path.snapped) == ("doubtful", 11, (10,))
    assert [(reason.code, reason.step) for reason in path.reasons] == [("unstable", 10)]


def test_an_equilibrium_that_is_not_checked_may_be_unstable() -> None:
    line = straight_line(LENGTH, 10, linear_section())
    load = Load(-1, ramp((-2.0 * np.pi**2 * STIFFNESS / (4.0 * LENGTH**2), 0.0, 0.0), 3))
    settings = RodSettings(checks_stability=False)
    path = follow(line, [clamp(line), load], steps=3, settings=settings)
    assert path.last.positions[-1] == pytest.approx([LENGTH, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("node", [-1, 5])
def test_what_is_let_go_springs_back_in_part(node: int) -> None:
    line = straight_line(LENGTH, 10, sliding_section())
    reach = line.positions[node, 0]
    angle = np.linspace(0.0, 0.5, 6)[:, None]
    way = 0.9 * reach * np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    grip = Held(node, np.concatenate([way, way[-1:]]), release=6)
    path = walked(line, [clamp(line), grip], 6)
    before, behind = path.states[5], path.states[6]
    np.testing.assert_allclose(behind.reaction_forces[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(behind.reaction_moments[0], 0.0, atol=1e-9)
    assert 0.02 * reach < behind.positions[node, 1] < 0.9 * before.positions[node, 1]
    assert path.lost[-1] > path.lost[-2] or path.snapped == ()


@pytest.mark.slow
@pytest.mark.parametrize("most_turn", [0.5, 0.02])
def test_each_cell_of_what_falls_springs_back_by_what_it_carries(most_turn: float) -> None:
    """Without weight: by its own law, however long the way, and nothing bends the free end."""
    line = straight_line(LENGTH, 20, sliding_section())
    angle = np.linspace(0.0, 0.8, 41)[:, None]
    size = 0.6 * (1.0 - 0.2 * angle**2) * LENGTH
    way = size * np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    grip = Held(12, np.concatenate([way, way[-1:]]), release=41)
    settings = RodSettings(most_turn=most_turn)
    path = follow(line, [clamp(line), grip], steps=41, settings=settings)
    held, free = path.states[40:]
    kept = kept_curvature(held, line.section.law)
    assert np.max(held.bendings) > 8.0
    left = np.linalg.norm(free.curvatures[:, :, :2], axis=2).max(axis=1)
    np.testing.assert_allclose(left, kept, atol=1e-6)
    assert not np.any(free.rests[13:])
    set_free = path.stored[40] - path.stored[41] - (path.lost[41] - path.lost[40])
    assert path.jumped[41] - path.jumped[40] == pytest.approx(set_free)


@pytest.mark.slow
def test_what_a_line_keeps_that_is_let_go_does_not_hang_on_the_steps() -> None:
    """Bent over in a plane and in space; it is followed down in stable states only."""
    for aside in (0.0, 0.3):
        ends = []
        for steps in (16, 64):
            line = straight_line(LENGTH, 14, sliding_section())
            angle = np.linspace(0.0, 1.9, steps + 1)[:, None]
            size = (1.0 - 0.25 * angle) * LENGTH
            turned = np.concatenate([np.cos(angle), np.sin(angle), aside * angle**2], axis=1)
            way = size * turned / np.linalg.norm(turned, axis=1)[:, None]
            grip = Held(-1, np.concatenate([way, way[-1:]]), release=steps + 1)
            path = walked(line, [clamp(line), grip], steps + 1)
            ends.append((path.lost[-1], path.last.positions))
        (coarse, there), (fine, here) = ends
        assert coarse == pytest.approx(fine, rel=0.01)
        np.testing.assert_allclose(there, here, atol=0.01 * LENGTH)


def test_a_clamp_that_lets_go_leaves_no_moment() -> None:
    line = straight_line(LENGTH, 10, sliding_section())
    frames = multiply(from_rotation_vectors(ramp((0.0, 0.0, 0.8), 5)), line.frames[-1:])
    way = line.positions[-1] + ramp((-0.05, 0.15, 0.0), 5)
    grip = Held(-1, np.append(way, way[-1:], 0), np.append(frames, frames[-1:], 0), release=6)
    path = walked(line, [clamp(line), grip], 6)
    np.testing.assert_allclose(path.last.forces, 0.0, atol=1e-9)
    np.testing.assert_allclose(path.last.moments, 0.0, atol=1e-9)
    assert np.max(path.last.bendings) > 0.05


@pytest.mark.parametrize("start", [0.0, 3e-3])
def test_a_heavy_line_lies_on_a_table_with_its_axis_a_radius_above(start: float) -> None:
    """Drawn along it, it pulls by 0.4 of its weight, as a line without thickness would."""
    section = replace(linear_section(mass=0.2), diameter=6e-3)
    line = straight_line(LENGTH, 20, section, start=(0.0, 0.0, start))
    drawn = Held(0, np.array([0.0, 0.0, 3e-3]) + ramp((-0.05, 0.0, 0.0), 4))
    path = walked(line, [Plane(np.zeros(3), friction=0.4), Gravity(), drawn], 4)
    weight = 0.2 * LENGTH * 9.81 * 39.0 / 40.0  # the grip carries that of half an element
    for state in path.states:
        assert state.positions[:, 2] == pytest.approx(3e-3, abs=1e-8)
        assert state.reaction_forces[0, 2] == pytest.approx(weight)
    assert path.last.reaction_forces[2, 0] == pytest.approx(-0.4 * weight)
    assert path.last.positions[-1, 0] == pytest.approx(LENGTH - 0.05)


def test_bends_beyond_the_law_are_doubtful_and_said_once() -> None:
    line = straight_line(LENGTH, 10, Section(linear_moment_law(STIFFNESS, 2.0), 8e-4))
    load = Load(-1, ramp((0.0, 0.02, 0.0), 5))
    path = follow(line, [clamp(line), load], steps=5)
    assert path.status == "doubtful"
    assert [reason.code for reason in path.reasons] == ["beyond_law"]
    assert path.reasons[0].node == 0
    assert len(path.states) == 6


def test_faults_of_boundaries_are_said() -> None:
    line = straight_line(LENGTH, 10, linear_section())
    with pytest.raises(ValueError, match=r"boundary 1 \(Load\): node=11: allowed are 0 to 10"):
        follow(line, [clamp(line), Load(11, np.zeros(3))], steps=2)
    with pytest.raises(ValueError, match=r"tip: force has 4 rows; allowed are 1 or steps \+ 1 = 3"):
        follow(line, [clamp(line), Load(-1, np.zeros((4, 3)), name="tip")], steps=2)
    with pytest.raises(ValueError, match="step 0: node 0 is held twice"):
        follow(line, [clamp(line), Held(0, line.positions[0])], steps=2)


def test_a_path_ends_with_its_last_state() -> None:
    path = walked(*space_case(steps=2), 2)
    assert path.last is path.states[-1]
    assert len(path.work) == len(path.states) == 3


@pytest.mark.slow
def test_a_walk_without_a_state_has_no_last_one() -> None:
    """A line that nothing holds falls."""
    line = straight_line(LENGTH, 5, linear_section(mass=0.1))
    path = follow(line, [Gravity()], steps=1)
    assert path.status == "failed"
    with pytest.raises(ValueError, match="no state was reached: step 0: no equilibrium follows"):
        _ = path.last


def test_bendings_are_the_larger_of_both_sides_without_the_twist() -> None:
    state = walked(*space_case(steps=2), 2).last
    across = np.hypot(state.node_curvatures[..., 0], state.node_curvatures[..., 1])
    np.testing.assert_allclose(state.bendings, across.max(axis=1))
    assert state.bendings.shape == (13,)


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


N = 40


LINE = straight_line(LENGTH, N, linear_section())


def column(grips: tuple[Grip, ...], load: float) -> tuple[StabilityCheck, Balance, Shape]:
    """A straight column under a pressure, N."""
    supports = supports_of(LINE, grips)
    none = (np.zeros(0, dtype=np.int64), np.zeros(0))
    assembly = Assembly(LINE, supports, (), none, n_rings=0, force=STIFFNESS / LENGTH**2)
    forces: Floats = np.zeros((N + 1, 3))
    forces[-1, 0] = -load
    asked = Demands(
        LINE.positions[supports.held],
        LINE.frames[-np.arange(len(supports.clamps))],
        forces,
        np.zeros((N, 3)),
        np.zeros((0, 3)),
        np.zeros((0, 3)),
    )
    memory = LineMemory(np.zeros((len(supports.nodes), 0, 2)), np.zeros((0, N + 1, 3)), np.zeros(0))
    pressed = np.tile([-load, 0.0, 0.0], (N, 1))
    shape = Shape(LINE.positions, LINE.frames, np.zeros(N), pressed)
    return StabilityCheck(assembly), assembly.balance(shape, asked, memory), shape


@pytest.mark.parametrize(
    ("grips", "factor"),
    [
        (((0, True),), 0.25),
        (((0, False), (N, False)), 1.0),
        (((0, True), (N, False)), 2.0457),
        (((0, True), (N, True)), 4.0),
    ],
    ids=["free", "pinned", "clamped-pinned", "clamped"],
)
def test_critical_loads_of_columns(grips: tuple[Grip, ...], factor: float) -> None:
    critical = factor * np.pi**2 * STIFFNESS / LENGTH**2
    below, above = column(grips, 0.996 * critical), column(grips, 1.004 * critical)
    assert below[0].is_stable(*below[1:])
    assert not above[0].is_stable(*above[1:])


def test_rates_are_those_of_the_whole_matrix() -> None:
    """A cantilever under a moment of constant direction along it; eigenvalues by numpy."""
    check, balance, _ = turned_cantilever(0.5 * np.pi * STIFFNESS / LENGTH)
    assembly = check._assembly
    rows, columns = assembly.pattern
    whole = np.zeros((assembly.places.total,) * 2)
    np.add.at(whole, (rows, columns), balance.even)
    fixed = assembly.band.fixed
    whole[fixed, :] = np.eye(len(whole))[fixed]
    own = np.flatnonzero((assembly.drag > 0.0) & ~fixed)
    root = np.sqrt(assembly.drag[own])
    gives = np.linalg.inv(whole)[np.ix_(own, own)] * np.outer(root, root)
    rates = 1.0 / np.linalg.eigvals(gives)
    expected = rates[np.argmin(rates.real)]
    rate, change = check.slowest_return(balance)
    assert rate.real == pytest.approx(expected.real, rel=1e-6)
    assert abs(rate.imag) == pytest.approx(abs(expected.imag), rel=1e-6)
    assert abs(rate.imag) > 0.1
    assert not np.any(change[fixed])


def test_a_cantilever_turned_about_itself_whirls() -> None:
    for share, is_stable in ((0.6, True), (0.75, False)):
        check, balance, shape = turned_cantilever(share * 2.0 * np.pi * STIFFNESS / LENGTH)
        assert check.is_stable(balance, shape) is is_stable
        assert check.whirls(balance) is not is_stable


def turned_cantilever(moment: float) -> tuple[StabilityCheck, Balance, Shape]:
    """A straight cantilever, its free end turned by a moment along it, N m."""
    supports = supports_of(LINE, ((0, True),))
    none = (np.zeros(0, dtype=np.int64), np.zeros(0))
    assembly = Assembly(LINE, supports, (), none, n_rings=0, force=STIFFNESS / LENGTH**2)
    moments: Floats = np.zeros((N, 3))
    moments[-1, 0] = moment
    nothing = np.zeros((0, 3))
    asked = Demands(
        *(LINE.positions[:1], LINE.frames[:1], np.zeros((N + 1, 3)), moments, nothing, nothing)
    )
    twist = moment / LINE.section.torsional_stiffness * (LINE.stations[1:] + LINE.stations[:-1])
    frames = multiply(LINE.frames, from_rotation_vectors(np.outer(0.5 * twist, [0.0, 0.0, 1.0])))
    memory = LineMemory(np.zeros((len(supports.nodes), 0, 2)), np.zeros((0, N + 1, 3)), np.zeros(0))
    shape = Shape(LINE.positions, frames, np.zeros(N), np.zeros((N, 3)))
    check = StabilityCheck(assembly, is_turned=True)
    return check, assembly.balance(shape, asked, memory), shape


def test_a_column_gives_way_to_the_side_it_is_pushed_to() -> None:
    critical = np.pi**2 * STIFFNESS / (4.0 * LENGTH**2)
    check, balance, shape = column(((0, True),), 1.01 * critical)
    total = 10 * N + 3
    push = np.zeros(total)
    push[10 * N + 2] = 1.0
    mode = check.lowest_mode(balance, shape, push)
    assert mode is not None
    moved = mode[10 * np.arange(N + 1)[:, None] + np.arange(3)]
    expected = 1.0 - np.cos(np.pi / 2.0 * LINE.stations / LENGTH)
    np.testing.assert_allclose(moved[:, 2] / moved[-1, 2], expected, atol=2e-3)
    assert moved[-1, 2] > 0.0
    assert np.max(np.abs(moved[:, 1])) < 0.05 * moved[-1, 2]


ANGLES = np.linspace(0.0, 2.0, 21)


NODES = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0.2 * ANGLES], axis=1)


def test_the_curve_touches_every_element_in_its_middle() -> None:
    for element in range(20):
        middle = 0.5 * (NODES[element] + NODES[element + 1])
        np.testing.assert_allclose(point_at(NODES, element + 0.5), middle, atol=1e-15)
        ahead, back = (point_at(NODES, element + 0.5 + d) for d in (1e-6, -1e-6))
        along = (ahead - back) / 2e-6
        np.testing.assert_allclose(along, NODES[element + 1] - NODES[element], atol=1e-6)
    np.testing.assert_array_equal(point_at(NODES, 0.0), NODES[0])
    np.testing.assert_array_equal(point_at(NODES, 20.0), NODES[-1])


@pytest.mark.parametrize("place", [0.2, 3.3, 7.5, 12.0, 19.8])
def test_the_nearest_place_is_found_across_the_curve(place: float) -> None:
    along = point_at(NODES, place + 1e-6) - point_at(NODES, place - 1e-6)
    across = np.cross(along, [0.3, 0.1, 1.0])
    ring = point_at(NODES, place) + 0.02 * across / np.linalg.norm(across)
    assert nearest_place(NODES, ring, place + 0.9) == pytest.approx(place, abs=1e-6)


@pytest.mark.parametrize("place", [0.2, 3.3, 7.6, 19.8])
def test_a_ring_pulls_across_and_its_stiffness_is_that_of_differences(place: float) -> None:
    ring = point_at(NODES, place) + np.array([1e-3, -2e-3, 1.5e-3])
    plain = thread(NODES, ring, place, 50.0)
    along = point_at(NODES, plain.place + 1e-6) - point_at(NODES, plain.place - 1e-6)
    assert plain.force @ along == pytest.approx(0.0, abs=1e-12)
    assert plain.weights.sum() == pytest.approx(1.0)
    step = 1e-6
    for j in range(3):
        for k in range(3):
            forces = []
            for sign in (1.0, -1.0):
                moved = NODES.copy()
                moved[plain.first + j, k] += sign * step
                near = thread(moved, ring, place, 50.0)
                forces.append(near.weights[:, None] * near.force)
            found = -(forces[0] - forces[1]) / (2.0 * step)
            np.testing.assert_allclose(plain.stiffness[:, :, j, k], found, atol=2e-4)


PLANE = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.5)


STIFF = 1e4


START = np.array([[0.0, 0.0, 0.0]])


def test_a_node_above_the_plane_feels_nothing() -> None:
    touch = touch_plane(PLANE, STIFF, np.array([[1.0, 2.0, 1e-6]]), START, close=1e-9)
    assert not np.any(touch.forces)
    assert not np.any(touch.stiffness)
    np.testing.assert_array_equal(touch.contacts, [[1.0, 2.0, 1e-6]])


def test_a_node_sticks_until_friction_is_reached_and_drags_its_contact_along() -> None:
    sticking = touch_plane(PLANE, STIFF, np.array([[4e-4, 0.0, -1e-3]]), START, close=0.0)
    np.testing.assert_allclose(sticking.forces, [[-4.0, 0.0, 10.0]])
    assert sticking.rubbed == 0.0
    sliding = touch_plane(PLANE, STIFF, np.array([[9e-4, 0.0, -1e-3]]), START, close=0.0)
    np.testing.assert_allclose(sliding.forces, [[-5.0, 0.0, 10.0]])
    np.testing.assert_allclose(sliding.contacts[:, :2], [[4e-4, 0.0]])
    assert sliding.rubbed == pytest.approx(5.0 * 4e-4)
    back = touch_plane(PLANE, STIFF, np.array([[8e-4, 0.0, -1e-3]]), sliding.contacts, close=0.0)
    np.testing.assert_allclose(back.forces, [[-4.0, 0.0, 10.0]])


@pytest.mark.parametrize("aside", [3e-4, 9e-4])
def test_stiffness_of_a_plane_is_that_of_differences(aside: float) -> None:
    plane = Plane(np.zeros(3), np.array([0.2, -0.1, 1.0]), 0.5)
    at = np.array([[aside, 0.5 * aside, -1.2e-3]])
    touch = touch_plane(plane, STIFF, at, START, close=0.0)
    for k in range(3):
        step = 1e-9 * np.eye(3)[k]
        ahead = touch_plane(plane, STIFF, at + step, START, close=0.0).forces
        back = touch_plane(plane, STIFF, at - step, START, close=0.0).forces
        np.testing.assert_allclose(touch.stiffness[0, :, k], -(ahead - back)[0] / 2e-9, atol=1e-2)
    even = touch.stiffness - touch.pressing
    np.testing.assert_allclose(even, np.swapaxes(even, 1, 2), atol=1e-9)


def test_strings_pull_and_do_not_push() -> None:
    anchors = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    nodes = np.array([[0.0, 0.0, -0.01], [0.0, 0.0, 0.01]])
    forces, stiffness = pull_strings(anchors, np.ones(2), 100.0, nodes)
    np.testing.assert_allclose(forces, [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(stiffness[0], np.diag([1.0 / 1.01, 1.0 / 1.01, 100.0]), atol=1e-9)
    assert not np.any(stiffness[1])


def test_values_add_up_at_their_nodes() -> None:
    out = added_at(np.array([1, 1, 2]), np.array([1.0, 2.0, 4.0]), 4)
    assert out.tolist() == [0.0, 3.0, 4.0, 0.0]
