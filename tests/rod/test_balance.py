from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labpipe.law.sliders import SliderLaw, linear_moment_law
from labpipe.records.arrays import Floats
from labpipe.rod.assembly import ArtificialDrag, Assembly, Demands, LineMemory, Shape
from labpipe.rod.banded import Band, entries, places_of
from labpipe.rod.boundaries import Gravity, Held, Load, Moment, Plane, Ring, String
from labpipe.rod.cells import BentCells, bend_cells
from labpipe.rod.equilibrium import settle
from labpipe.rod.input_distributions import joined, known
from labpipe.rod.line import Line, Section
from labpipe.rod.response import Fields, band_of, field_band, respond
from labpipe.rod.rotations import from_rotation_vectors, multiply, skew, unit
from labpipe.rod.states import merged_rests, parted_rests
from labpipe.rod.supports import supports_of
from tests.builders.rods import (
    LENGTH,
    SLIDING,
    STIFFNESS,
    clamp,
    linear_section,
    ramp,
    sliding_section,
    straight_line,
    walked,
)

N = 6


STEP = 1e-7


def bent_line(section: Section) -> Line:
    """A line in general position that is curved at rest."""
    random = np.random.default_rng(5)
    plain = straight_line(0.3, N, section)
    positions = plain.positions + 0.01 * random.normal(size=(N + 1, 3))
    frames = multiply(plain.frames, from_rotation_vectors(0.3 * random.normal(size=(N, 3))))
    lengths = plain.lengths * random.uniform(0.7, 1.3, N)
    return Line(lengths, section, positions, frames, random.normal(size=(N - 1, 3)))


class Case:
    """A line clamped at both ends, with a pin, a string, a ring, a rough plane and loads."""

    def __init__(self, section: Section) -> None:
        random = np.random.default_rng(6)
        self.line = bent_line(section)
        grips = ((0, True), (3, False), (N, True))
        supports = supports_of(self.line, grips)
        # every node is in, and half of them slide
        plane = Plane(np.array([0.0, 0.0, 0.1]), np.array([0.1, 0.2, 1.0]), 0.4)
        strings = (np.array([2]), np.array([0.05]))
        self.assembly = Assembly(self.line, supports, (plane,), strings, n_rings=1, force=1e-4)
        contacts = self.line.positions + 0.02 * random.normal(size=(N + 1, 3))
        self.memory = LineMemory(
            0.5 * random.normal(size=(len(supports.nodes), 3, 2)), contacts[None], np.array([4.2])
        )
        self.demands = Demands(
            held=self.line.positions[supports.held],
            clamps=multiply(
                self.line.frames[[0, -1]], from_rotation_vectors(0.1 * random.normal(size=(2, 3)))
            ),
            forces=0.01 * random.normal(size=(N + 1, 3)),
            moments=1e-3 * random.normal(size=(N, 3)),
            anchors=self.line.positions[[2]] + (0.0, 0.0, 0.07),
            rings=self.line.positions[[4]] + (1e-3, 2e-3, 1e-3),
        )
        stretches = np.zeros(N) if self.assembly.is_rigid else 0.01 * random.normal(size=N)
        self.shape = Shape(
            self.line.positions, self.line.frames, stretches, 0.05 * random.normal(size=(N, 3))
        )

    def residual(self, change: Floats, drag: ArtificialDrag | None = None) -> Floats:
        shape = self.assembly.changed(self.shape, change)
        return self.assembly.balance(shape, self.demands, self.memory, drag).residual

    def matrix(self, drag: ArtificialDrag | None = None) -> Floats:
        values = self.assembly.balance(self.shape, self.demands, self.memory, drag).values
        total = self.assembly.places.total
        out = np.zeros((total, total))
        np.add.at(out, self.assembly.pattern, values)
        return out

    def differences(self, drag: ArtificialDrag | None = None) -> Floats:
        total = self.assembly.places.total
        scale = self.assembly.band.scale / np.max(self.assembly.band.scale)
        columns = []
        for k in range(total):
            change = np.zeros(total)
            change[k] = STEP * scale[k]
            ahead, back = self.residual(change, drag), self.residual(-change, drag)
            columns.append((ahead - back) / (2.0 * STEP * scale[k]))
        return np.stack(columns, axis=1)

    def without_skew(self, matrix: Floats, drag: ArtificialDrag | None = None) -> Floats:
        """Take off the part of a gradient's derivative that vanishes where it is in balance."""
        residual = self.residual(np.zeros(self.assembly.places.total), drag)
        out = matrix.copy()
        for first in self.assembly.places.turns:
            at = slice(first, first + 3)
            out[at, at] -= 0.5 * skew(residual[at])
        return out


STRETCHING = Section(SLIDING, 0.8e-3, axial_stiffness=40.0, coupling=0.05)


RIGID = Section(SLIDING, 0.8e-3)


@pytest.mark.parametrize("section", [STRETCHING, RIGID], ids=["stretching", "rigid"])
@pytest.mark.parametrize("dragged", [False, True])
def test_the_tangent_is_that_of_differences(section: Section, dragged: bool) -> None:
    case = Case(section)
    drag = None
    if dragged:
        place = replace(case.shape, positions=case.shape.positions + 0.01)
        before = case.assembly.turns(case.shape, case.demands) - 0.02
        drag = ArtificialDrag(10.0, place, before)
    free = ~case.assembly.band.fixed
    free = np.ones_like(free) if not case.assembly.is_rigid else free
    scale = case.assembly.band.scale
    weigh = scale[:, None] * scale
    found = (case.matrix(drag) * weigh)[np.ix_(free, free)]
    expected = (case.without_skew(case.differences(drag), drag) * weigh)[np.ix_(free, free)]
    np.testing.assert_allclose(found, expected, atol=3e-7 * np.max(np.abs(expected)))


def test_the_tangent_is_symmetric_but_for_friction_and_dead_moments() -> None:
    case = Case(STRETCHING)
    balance = case.assembly.balance(
        case.shape, replace(case.demands, moments=np.zeros((N, 3))), case.memory
    )
    total = case.assembly.places.total
    even = np.zeros((total, total))
    np.add.at(even, case.assembly.pattern, balance.even)
    np.testing.assert_allclose(even, even.T, atol=1e-12 * np.max(np.abs(even)))
    full = np.zeros((total, total))
    np.add.at(full, case.assembly.pattern, balance.values)
    assert np.max(np.abs(full - full.T)) > 1e-3 * np.max(np.abs(full))


@pytest.mark.parametrize("section", [STRETCHING, RIGID], ids=["stretching", "rigid"])
def test_a_newton_step_follows_what_moves(section: Section) -> None:
    """Moves of held nodes and turns of clamps count to first order in the right side."""
    case = Case(section)
    assembly, random = case.assembly, np.random.default_rng(8)
    held, turns = 1e-6 * random.normal(size=(3, 3)), 1e-6 * random.normal(size=(2, 3))
    balance = assembly.balance(case.shape, case.demands, case.memory)
    plain = assembly.right_side(balance, case.shape, case.demands, 0.0 * held, 0.0 * turns)
    right = assembly.right_side(balance, case.shape, case.demands, held, turns)
    turned = replace(
        case.demands, clamps=multiply(case.demands.clamps, from_rotation_vectors(turns))
    )
    moved = assembly.balance(case.shape, turned, case.memory)
    expected = -(moved.residual - balance.residual)
    expected[assembly.band.fixed] = 0.0
    found = right - plain
    places = assembly.places.positions[assembly.supports.held][:, None] + np.arange(3)
    np.testing.assert_allclose(found[places], held, atol=1e-20)
    found[places] = 0.0
    rows = np.ones(assembly.places.total, dtype=bool)
    # what a clamp lends to a direction changes the pull on frame and stretch: left to the next step
    lent = assembly.places.turns[assembly.supports.ends][:, None] + np.arange(3)
    rows[lent] = False
    rows[assembly.places.stretches] = False
    size = np.max(np.abs(expected[rows]))
    np.testing.assert_allclose(found[rows], expected[rows], atol=1e-5 * size)


def test_changes_are_undone_by_their_opposites() -> None:
    case = Case(STRETCHING)
    change = np.random.default_rng(2).normal(size=case.assembly.places.total)
    there = case.assembly.changed(case.shape, change)
    back = case.assembly.changed(there, -change)
    np.testing.assert_allclose(back.positions, case.shape.positions, atol=1e-14)
    np.testing.assert_allclose(unit(back.frames), unit(case.shape.frames), atol=1e-14)
    moved = case.assembly.moved(case.shape, there)
    turns = case.assembly.places.turns[:, None] + np.arange(3)
    small = np.linalg.norm(change[turns], axis=1) < np.pi
    np.testing.assert_allclose(moved[turns][small], change[turns][small], atol=1e-12)


def test_reactions_are_what_is_missing() -> None:
    case = Case(RIGID)
    balance = case.assembly.balance(case.shape, case.demands, case.memory)
    forces, moments = case.assembly.reactions(balance, case.demands)
    assert forces.shape == (3, 3)
    at = case.assembly.places.positions[3] + np.arange(3)
    np.testing.assert_allclose(forces[1], balance.residual[at])
    # turning the first clamp in space costs its moment: the energy's derivative
    step = 1e-6 * np.array([0.3, -0.5, 0.8])
    gains = []
    for sign in (1.0, -1.0):
        turned = case.demands.clamps.copy()
        turned[0] = multiply(from_rotation_vectors(sign * step), turned[0])
        demands = replace(case.demands, clamps=turned)
        gains.append(energy(case, demands))
    assert (gains[0] - gains[1]) / 2.0 == pytest.approx(float(step @ moments[0]), rel=1e-6)


def energy(case: Case, demands: Demands) -> float:
    """What clamps have a part in: bending, twist, and the stretch row times its force."""
    balance = case.assembly.balance(case.shape, demands, case.memory)
    cells, law = balance.cells, SLIDING
    # sliders from their rests: the energy of a step, stored and lost
    bent = cells.curvatures[:, None, :2] - case.memory.rests
    size = np.linalg.norm(bent, axis=2)
    held = np.minimum(size, law.slip_curvatures)
    of_sliders = (0.5 * held**2 + law.slip_curvatures * (size - held)) @ law.stiffnesses
    of_spring = 0.5 * law.stiffness * np.sum(cells.curvatures[:, :2] ** 2, axis=1)
    of_twist = 0.5 * 0.8e-3 * cells.curvatures[:, 2] ** 2
    rows = balance.residual[case.assembly.places.forces[:, None] + np.arange(3)]
    total = case.assembly.supports.lengths @ (of_sliders + of_spring + of_twist)
    return float(total + np.sum(rows * case.shape.forces))


def test_places_follow_one_another() -> None:
    places = places_of(3)
    assert places.positions.tolist() == [0, 10, 20, 30]
    assert places.total == 33
    every = np.concatenate(
        [
            *(places.positions + k for k in range(3)),
            places.stretches,
            *(places.turns + k for k in range(3)),
            *(places.forces + k for k in range(3)),
        ]
    )
    assert sorted(every.tolist()) == list(range(33))


def test_entries_are_in_the_order_of_the_blocks() -> None:
    rows, columns = entries(np.array([0, 5]), 2, np.array([3, 7]), 1)
    assert rows.tolist() == [0, 1, 5, 6]
    assert columns.tolist() == [3, 3, 7, 7]


def some_band() -> tuple[Band, np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    rows = np.concatenate([np.arange(12), np.arange(10), np.arange(2, 12), np.array([4, 4])])
    columns = np.concatenate([np.arange(12), np.arange(2, 12), np.arange(10), np.array([4, 5])])
    values = random.normal(size=len(rows)) + 3.0 * (rows == columns)
    fixed = np.zeros(12, dtype=bool)
    fixed[[3, 7]] = True
    scale = 10.0 ** random.uniform(-2, 2, 12)
    dense = np.zeros((12, 12))
    np.add.at(dense, (rows, columns), values)
    dense[fixed] = np.eye(12)[fixed]
    return Band(rows, columns, scale, fixed), values, dense


def test_solutions_are_those_of_the_dense_matrix() -> None:
    band, values, dense = some_band()
    right = np.random.default_rng(1).normal(size=12)
    found = band.solve(values, right)
    assert found is not None
    np.testing.assert_allclose(found, np.linalg.solve(dense, right), rtol=1e-10)
    assert found[3] == pytest.approx(right[3])


def test_a_singular_matrix_has_no_solution() -> None:
    band, values, _ = some_band()
    assert band.solve(np.zeros_like(values), np.ones(12)) is None


LAW = SliderLaw(1e-3, np.array([2e-3, 1e-3]), np.array([1.0, 3.0]), 0.0, 50.0)


SECTION = Section(LAW, 8e-4)


ANGLES = np.array([0.01, 0.25, 1.0, 2.0])


STEP_CELLS = 1e-6


def bent(before: Floats, behind: Floats) -> BentCells:
    """Cells of some frames, turned by a little more, rad, shape (4, 3)."""
    random = np.random.default_rng(1)
    first = from_rotation_vectors(random.normal(size=(4, 3)))
    turn = ANGLES[:, None] * unit(random.normal(size=(4, 3)))
    second = multiply(first, from_rotation_vectors(turn))
    return bend_cells(
        SECTION,
        (
            multiply(first, from_rotation_vectors(before)),
            multiply(second, from_rotation_vectors(behind)),
        ),
        random.uniform(0.05, 0.1, 4),
        random.normal(size=(4, 3)),
        rests=random.normal(size=(4, 2, 2)),
        torques=np.zeros(4),
    )


def numbers(side: int) -> tuple[Floats, Floats]:
    """Derivatives of `before` and `behind` by the turns of one side."""
    columns = []
    for axis in STEP_CELLS * np.eye(3):
        turn, still = np.tile(axis, (4, 1)), np.zeros((4, 3))
        ahead = bent(turn, still) if side == 0 else bent(still, turn)
        back = bent(-turn, still) if side == 0 else bent(still, -turn)
        columns.append(
            (
                (ahead.before - back.before) / (2 * STEP_CELLS),
                (ahead.behind - back.behind) / (2 * STEP_CELLS),
            )
        )
    first, second = (np.stack(column, axis=2) for column in zip(*columns, strict=True))
    return first, second


def test_tangents_are_those_of_differences() -> None:
    cells = bent(np.zeros((4, 3)), np.zeros((4, 3)))
    own, other = numbers(0)
    size = np.max(np.abs(own))
    # the derivative of a gradient along turns has a part that is not symmetric and vanishes in sum
    np.testing.assert_allclose(cells.by_before + 0.5 * skew(cells.before), own, atol=1e-8 * size)
    np.testing.assert_allclose(cells.across, other, atol=1e-8 * size)
    other, own = numbers(1)
    np.testing.assert_allclose(cells.by_behind + 0.5 * skew(cells.behind), own, atol=1e-8 * size)
    np.testing.assert_allclose(np.swapaxes(cells.across, 1, 2), other, atol=1e-8 * size)


def test_both_frames_feel_the_same_moment_in_space() -> None:
    cells = bent(np.zeros((4, 3)), np.zeros((4, 3)))
    assert np.linalg.norm(cells.before, axis=1) == pytest.approx(
        np.linalg.norm(cells.behind, axis=1), rel=1e-12
    )


def test_a_cell_bent_in_one_plane_carries_the_moment_of_the_law() -> None:
    turn = from_rotation_vectors(np.array([[0.0, 0.2, 0.0]]))
    start = np.array([[1.0, 0.0, 0.0, 0.0]])
    cells = bend_cells(
        SECTION,
        (start, turn),
        np.array([0.1]),
        np.zeros((1, 3)),
        rests=np.zeros((1, 2, 2)),
        torques=np.zeros(1),
    )
    expected = 1e-3 * 2.0 + 2e-3 * 1.0 + 1e-3 * 2.0
    np.testing.assert_allclose(cells.behind, [[0.0, expected, 0.0]], atol=1e-15)
    np.testing.assert_allclose(cells.before, [[0.0, -expected, 0.0]], atol=1e-15)


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


BELIEF = joined([known("a", 0.3, draws=16_384), known("b", 0.4, draws=16_384)])


def straight(inputs: Mapping[str, float]) -> Fields:
    a, b = inputs["a"], inputs["b"]
    return {"sum": np.array([a + b, 2.0 * a]), "one": np.array(5.0 + b)}


def test_a_straight_line_has_the_band_of_its_inputs() -> None:
    response = respond(straight, BELIEF)
    assert response is not None
    band = field_band([response], "sum")
    assert band.value.tolist() == [0.0, 0.0]
    assert band.upper == pytest.approx([1.96 * 0.5, 1.96 * 0.6], rel=0.04)
    assert band.lower == pytest.approx([-1.96 * 0.5, -1.96 * 0.6], rel=0.04)
    assert response.shares("one") == pytest.approx({"a": 0.0, "b": 1.0})
    assert response.shares("sum")["a"] == pytest.approx(5 * 0.09 / (5 * 0.09 + 0.16), rel=0.05)


def answered(answer: Callable[[float], float], inputs: Mapping[str, float]) -> Fields:
    return {"y": np.array(answer(inputs["a"]))}


def test_a_cause_that_makes_most_of_a_band_is_exact_where_the_band_ends() -> None:
    """Kinked, bent or steep: the line is solved there."""
    steep = np.exp(1.96 * 0.3)
    for answer, ends in (
        (lambda a: 3.0 * a if a > 0.0 else a, (-1.96 * 0.3, 3.0 * 1.96 * 0.3)),
        (lambda a: a + 0.5 * a**2, (-0.588 + 0.5 * 0.588**2, 0.588 + 0.5 * 0.588**2)),
        (np.exp, (1.0 / steep, steep)),
    ):
        response = respond(partial(answered, answer), known("a", 0.3))
        assert response is not None
        band = field_band([response], "y")
        assert (float(band.lower), float(band.upper)) == pytest.approx(ends, rel=2e-3)


def test_a_parabola_is_met_and_goes_on_straight() -> None:
    belief = known("a", 1.0, freedom=4.0)
    response = respond(lambda inputs: {"y": np.array((1.0 + inputs["a"]) ** 2)}, belief)
    assert response is not None
    assert response.reach.tolist() == [2.0]
    at = belief.amounts[:, 0]
    beyond = np.abs(at) > 2.0
    drawn = response.drawn("y")
    assert drawn[~beyond] == pytest.approx((1.0 + at[~beyond]) ** 2)
    line = np.where(at > 0.0, 9.0 + 6.0 * (at - 2.0), 1.0 - 2.0 * (at + 2.0))
    assert drawn[beyond] == pytest.approx(line[beyond])


def test_a_least_value_is_taken_in_every_draw() -> None:
    response = respond(straight, BELIEF)
    assert response is not None

    def smaller(values: np.ndarray) -> np.ndarray:
        return np.asarray(values.min(axis=-1))

    band = band_of(
        [response], lambda each: (smaller(each.value["sum"]), smaller(each.drawn("sum")))
    )
    chance = np.random.default_rng(5)
    a, b = 0.3 * chance.normal(size=200_000), 0.4 * chance.normal(size=200_000)
    want = np.quantile(np.minimum(a + b, 2.0 * a), [0.025, 0.975])
    assert [float(band.lower), float(band.upper)] == pytest.approx(want, rel=0.05)


def test_bands_of_several_beliefs_are_joined() -> None:
    other = joined([known("a", 0.3, centre=2.0), known("b", 0.4)])
    responses = [respond(straight, BELIEF), respond(straight, other)]
    band = field_band([response for response in responses if response is not None], "sum")
    assert band.value[1] == 0.0
    assert band.lower[1] == pytest.approx(-1.96 * 0.6, rel=0.06)
    assert band.upper[1] == pytest.approx(4.0 + 1.96 * 0.6, rel=0.06)


def test_a_side_without_equilibrium_borrows_the_other() -> None:
    def partly(inputs: Mapping[str, float]) -> Fields | None:
        return None if inputs["a"] > 0.1 or abs(inputs["b"]) > 0.1 else straight(inputs)

    response = respond(partly, BELIEF)
    assert response is not None
    assert (response.one_sided, response.silent) == (("a",), ("b",))
    assert field_band([response], "sum").upper[1] == pytest.approx(1.96 * 0.6, rel=0.04)
    assert np.ptp(field_band([response], "one").upper) == 0.0


def test_no_equilibrium_at_the_best_inputs_is_no_response() -> None:
    assert respond(lambda _: None, BELIEF) is None


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


N_SETTLING = 10


LINE = straight_line(LENGTH, N_SETTLING, linear_section())


FORCE = STIFFNESS / LENGTH**2


ASSEMBLY = Assembly(
    LINE,
    supports_of(LINE, ((0, True),)),
    (),
    (np.zeros(0, dtype=np.int64), np.zeros(0)),
    n_rings=0,
    force=FORCE,
)


SHAPE = Shape(LINE.positions, LINE.frames, np.zeros(N_SETTLING), np.zeros((N_SETTLING, 3)))


MEMORY = LineMemory(np.zeros((N_SETTLING, 0, 2)), np.zeros((0, N_SETTLING + 1, 3)), np.zeros(0))


def demands(tip: Floats) -> Demands:
    forces = np.zeros((N_SETTLING + 1, 3))
    forces[-1] = tip
    none = np.zeros((0, 3))
    return Demands(
        LINE.positions[:1], LINE.frames[:1], forces, np.zeros((N_SETTLING, 3)), none, none
    )


def test_a_small_load_deflects_as_a_beam() -> None:
    load = np.array([0.0, 1e-3 * FORCE, 0.0])
    found = settle(ASSEMBLY, SHAPE, MEMORY, (demands(np.zeros(3)), demands(load)), force=FORCE)
    assert found is not None
    assert found.iterations <= 3
    assert found.shape.positions[-1, 1] == pytest.approx(1e-3 * LENGTH / 3.0, rel=2e-3)
    np.testing.assert_allclose(
        found.shape.forces, np.tile(load, (N_SETTLING, 1)), atol=1e-12 * FORCE
    )


def test_clamps_take_the_line_along() -> None:
    here = demands(np.zeros(3))
    there = replace(here, held=here.held + np.array([0.0, 0.01, 0.02]))
    found = settle(ASSEMBLY, SHAPE, MEMORY, (here, there), force=FORCE)
    assert found is not None
    np.testing.assert_allclose(
        found.shape.positions, LINE.positions + np.array([0.0, 0.01, 0.02]), atol=1e-12
    )


def test_a_step_too_far_finds_nothing() -> None:
    far = demands(np.array([-100.0 * FORCE, 50.0 * FORCE, 0.0]))
    assert settle(ASSEMBLY, SHAPE, MEMORY, (demands(np.zeros(3)), far), force=FORCE) is None
