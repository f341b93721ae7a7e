from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.law.sliders import make_linear_law
from labpipe.mechanics.rod import bands
from labpipe.mechanics.rod.assembly import (
    ArtificialDrag,
    Assembly,
    ImposedValues,
    LineHistory,
    Shape,
)
from labpipe.mechanics.rod.banded import BandedMatrix
from labpipe.mechanics.rod.boundaries import Gravity, Held, Load, Plane, Ring, String
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.rotations import from_rotation_vectors, multiply, skew
from labpipe.mechanics.rod.supports import split_cells_at_clamps
from labpipe.records.arrays import Floats
from tests.builders.rods import (
    LENGTH,
    SLIDING,
    clamp,
    linear_section,
    ramp,
    sliding_section,
    straight_line,
    walked,
)

N, STEP = 6, 1e-7


def bent_line(section: Section) -> Line:
    """A line in general position that is curved at rest."""
    random = np.random.default_rng(5)
    undeformed = straight_line(0.3, N, section)
    positions = undeformed.positions + 0.01 * random.normal(size=(N + 1, 3))
    frames = multiply(undeformed.frames, from_rotation_vectors(0.3 * random.normal(size=(N, 3))))
    lengths = undeformed.lengths * random.uniform(0.7, 1.3, N)
    return Line(lengths, section, positions, frames, random.normal(size=(N - 1, 3)))


class Case:
    """A line clamped at both ends, with a pin, a string, a ring, a rough plane and loads."""

    def __init__(self, section: Section) -> None:
        random = np.random.default_rng(6)
        self.line = bent_line(section)
        grips = ((0, True), (3, False), (N, True))
        supports = split_cells_at_clamps(self.line, grips)
        # every node is in, and half of them slide
        plane = Plane(np.array([0.0, 0.0, 0.1]), np.array([0.1, 0.2, 1.0]), 0.4)
        strings = (np.array([2]), np.array([0.05]))
        self.assembly = Assembly(self.line, supports, (plane,), strings, n_rings=1, force=1e-4)
        contacts = self.line.positions + 0.02 * random.normal(size=(N + 1, 3))
        self.history = LineHistory(
            0.5 * random.normal(size=(len(supports.nodes), 3, 2)), contacts[None], np.array([4.2])
        )
        self.imposed = ImposedValues(
            held_positions=self.line.positions[supports.held_nodes],
            clamp_frames=multiply(
                self.line.frames[[0, -1]], from_rotation_vectors(0.1 * random.normal(size=(2, 3)))
            ),
            forces=0.01 * random.normal(size=(N + 1, 3)),
            anchors=self.line.positions[[2]] + (0.0, 0.0, 0.07),
            rings=self.line.positions[[4]] + (1e-3, 2e-3, 1e-3),
            time=0.0,
        )
        stretches = np.zeros(N) if self.assembly.is_rigid else 0.01 * random.normal(size=N)
        self.shape = Shape(
            self.line.positions, self.line.frames, stretches, 0.05 * random.normal(size=(N, 3))
        )

    def residual(self, change: Floats, drag: ArtificialDrag | None = None) -> Floats:
        shape = self.assembly.apply_change(self.shape, change)
        return self.assembly.compute_balance(shape, self.imposed, self.history, drag).residual

    def matrix(self, drag: ArtificialDrag | None = None) -> Floats:
        balance = self.assembly.compute_balance(self.shape, self.imposed, self.history, drag)
        total = self.assembly.indices.n_unknowns
        out = np.zeros((total, total))
        np.add.at(out, self.assembly.pattern, balance.tangent_values)
        return out

    def differences(self, drag: ArtificialDrag | None = None) -> Floats:
        total = self.assembly.indices.n_unknowns
        scale = self.assembly.matrix.scale / np.max(self.assembly.matrix.scale)
        columns = []
        for k in range(total):
            change = np.zeros(total)
            change[k] = STEP * scale[k]
            ahead, back = self.residual(change, drag), self.residual(-change, drag)
            columns.append((ahead - back) / (2.0 * STEP * scale[k]))
        return np.stack(columns, axis=1)

    def without_skew(self, matrix: Floats, drag: ArtificialDrag | None = None) -> Floats:
        """Take off the part of a gradient's derivative that vanishes where it is in balance."""
        residual = self.residual(np.zeros(self.assembly.indices.n_unknowns), drag)
        out = matrix.copy()
        for first in self.assembly.indices.turns:
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
        drag = ArtificialDrag(10.0, place, np.full((len(case.assembly.supports.nodes), 3), 0.05))
    free = ~case.assembly.matrix.is_fixed
    free = np.ones_like(free) if not case.assembly.is_rigid else free
    weigh = (case.assembly.matrix.scale[:, None] * case.assembly.matrix.scale)[np.ix_(free, free)]
    exact = case.matrix(drag)[np.ix_(free, free)] * weigh
    expected = case.without_skew(case.differences(drag), drag)[np.ix_(free, free)] * weigh
    np.testing.assert_allclose(exact, expected, atol=3e-7 * np.max(np.abs(expected)))


def test_solutions_are_those_of_the_dense_matrix() -> None:
    random = np.random.default_rng(0)
    rows = np.concatenate([np.arange(12), np.arange(10), np.arange(2, 12), np.array([4, 4])])
    columns = np.concatenate([np.arange(12), np.arange(2, 12), np.arange(10), np.array([4, 5])])
    values = random.normal(size=len(rows)) + 3.0 * (rows == columns)
    fixed, dense = np.isin(np.arange(12), [3, 7]), np.zeros((12, 12))
    np.add.at(dense, (rows, columns), values)
    dense[fixed] = np.eye(12)[fixed]
    scale, right = 10.0 ** random.uniform(-2, 2, 12), np.arange(12.0)
    band = BandedMatrix(rows, columns, scale, fixed)
    solution = band.solve(values, right)
    assert solution is not None
    np.testing.assert_allclose(solution, np.linalg.solve(dense, right), rtol=1e-10)
    assert band.solve(np.zeros_like(values), np.ones(12)) is None


def test_an_end_that_is_free_to_turn_lengthens_more() -> None:
    section = Section(make_linear_law(1e-3, 10.0), 8e-4, axial_stiffness=40.0, coupling=0.1)
    line = straight_line(LENGTH, 8, section)
    path = walked(line, [clamp(line), Load(-1, ramp((0.4, 0.0, 0.0), 3))], 3)
    # the end is free to turn: it lengthens by EA less C^2 / GJ
    free = 40.0 - 0.1**2 / 8e-4
    assert path.last.stretches[3] == pytest.approx(0.4 / free, rel=1e-2)
    assert path.last.curvatures[4, 0, 2] == pytest.approx(-0.1 / 8e-4 * 0.4 / free, rel=1e-2)


def test_held_ends_feel_stretch_and_twist_as_a_pair() -> None:
    section = Section(make_linear_law(1e-3, 10.0), 8e-4, axial_stiffness=40.0, coupling=0.1)
    line = straight_line(LENGTH, 8, section)
    positions = line.positions[-1] + ramp((0.01, 0.0, 0.0), 2)
    frames = multiply(line.frames[-1:], from_rotation_vectors(ramp((0.0, 0.0, 0.3), 2)))
    state = walked(line, [clamp(line), Held(-1, positions, frames)], 2).last
    strain, twist = 0.01 / LENGTH, 0.3 / LENGTH
    assert state.reaction_forces[1, 0] == pytest.approx(40.0 * strain + 0.1 * twist, rel=1e-6)
    assert state.reaction_moments[1, 0] == pytest.approx(0.1 * strain + 8e-4 * twist, rel=1e-6)


def test_a_cell_that_slides_loses_what_its_sliders_carry() -> None:
    """The half cell at the clamp of a single element, bent by a force across its end."""
    line = straight_line(0.02, 1, sliding_section())
    path = walked(line, [clamp(line), Load(-1, ramp((0.0, 0.3, 0.0), 12))], 12)
    curvature = float(path.last.bending_curvatures[0])
    ring_stations = np.maximum(curvature - SLIDING.slip_curvatures, 0.0)
    assert np.all(ring_stations > 0.0)
    lost = SLIDING.slider_stiffnesses * SLIDING.slip_curvatures @ ring_stations
    assert path.lost_energy[-1] == pytest.approx(0.01 * lost, rel=1e-9)


BELIEF = bands.join_distributions(
    [
        bands.build_t_distribution("a", 0.3, n_draws=16_384),
        bands.build_t_distribution("b", 0.4, n_draws=16_384),
    ]
)


def linear_fields(inputs: Mapping[str, float]) -> bands.Fields:
    a, b = inputs["a"], inputs["b"]
    return {"sum": np.array([a + b, 2.0 * a]), "one": np.array(5.0 + b)}


def test_a_straight_line_has_the_band_of_its_inputs() -> None:
    response = bands.compute_response(linear_fields, BELIEF)
    assert response is not None
    band = bands.compute_band([response], "sum")
    assert band.value.tolist() == [0.0, 0.0]
    assert band.upper == pytest.approx([1.96 * 0.5, 1.96 * 0.6], rel=0.04)
    assert band.lower == pytest.approx([-1.96 * 0.5, -1.96 * 0.6], rel=0.04)
    assert response.compute_variance_fractions("one") == pytest.approx({"a": 0.0, "b": 1.0})
    fractions = response.compute_variance_fractions("sum")
    assert fractions["a"] == pytest.approx(5 * 0.09 / (5 * 0.09 + 0.16), rel=0.05)
    assert bands.compute_response(lambda _: None, BELIEF) is None


@pytest.mark.parametrize(
    ("answer", "ends"),
    [
        (lambda a: 3.0 * a if a > 0.0 else a, (-1.96 * 0.3, 3.0 * 1.96 * 0.3)),
        (lambda a: a + 0.5 * a**2, (-0.588 + 0.5 * 0.588**2, 0.588 + 0.5 * 0.588**2)),
        (np.exp, (np.exp(-1.96 * 0.3), np.exp(1.96 * 0.3))),
    ],
    ids=["kinked", "bent", "steep"],
)
def test_a_cause_that_makes_most_of_a_band_is_exact_where_the_band_ends(
    answer: Callable[[float], float], ends: tuple[float, float]
) -> None:
    """The line is solved there."""
    response = bands.compute_response(
        lambda inputs: {"y": np.array(answer(inputs["a"]))},
        bands.build_t_distribution("a", 0.3),
    )
    assert response is not None
    band = bands.compute_band([response], "y")
    assert (float(band.lower), float(band.upper)) == pytest.approx(ends, rel=2e-3)


def test_a_parabola_is_met_and_goes_on_straight() -> None:
    belief = bands.build_t_distribution("a", 1.0, freedom=4.0)
    response = bands.compute_response(
        lambda inputs: {"y": np.array((1.0 + inputs["a"]) ** 2)}, belief
    )
    assert response is not None
    assert response.max_amounts.tolist() == [2.0]
    amounts = belief.amounts[:, 0]
    beyond = np.abs(amounts) > 2.0
    drawn = response.compute_draws("y")
    assert drawn[~beyond] == pytest.approx((1.0 + amounts[~beyond]) ** 2)
    line = np.where(amounts > 0.0, 9.0 + 6.0 * (amounts - 2.0), 1.0 - 2.0 * (amounts + 2.0))
    assert drawn[beyond] == pytest.approx(line[beyond])


def test_a_side_without_equilibrium_borrows_the_other() -> None:
    def partly(inputs: Mapping[str, float]) -> bands.Fields | None:
        return None if inputs["a"] > 0.1 or abs(inputs["b"]) > 0.1 else linear_fields(inputs)

    response = bands.compute_response(partly, BELIEF)
    assert response is not None
    assert [response.list_unsolved_causes(n_signs) for n_signs in (1, 2)] == [("a",), ("b",)]
    assert bands.compute_band([response], "sum").upper[1] == pytest.approx(1.96 * 0.6, rel=0.04)
    assert np.ptp(bands.compute_band([response], "one").upper) == 0.0


def test_a_clamp_in_the_middle_takes_the_jump_of_the_moment() -> None:
    line = straight_line(LENGTH, 10, linear_section())
    load = Load(-1, ramp((0.0, 1e-4, 0.0), 2))
    state = walked(line, [Held(5, line.positions[5], line.frames[5]), load], 2).last
    before, after = state.moments[5]
    np.testing.assert_allclose(before, 0.0, atol=1e-12)
    np.testing.assert_allclose(after, -state.reaction_moments[0], atol=1e-12)
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
    assert state.positions[-1, 2] == pytest.approx(0.05, rel=0.1)


def test_the_bend_at_a_clamp_is_of_second_order() -> None:
    """Against the moment that the clamp must give, over the bending stiffness."""
    section, errors = linear_section(mass=0.05), []
    for elements in (10, 20, 40):
        line = straight_line(LENGTH, elements, section)
        state = walked(line, [clamp(line), Gravity()], 1).last
        curvature = np.linalg.norm(state.reaction_moments[0]) / section.law.spring_stiffness
        assert int(np.argmax(state.bending_curvatures)) == 0
        errors.append(abs(state.bending_curvatures[0] / curvature - 1.0))
    assert errors[0] < 0.01
    assert errors[0] > 4.0 * errors[1] > 16.0 * errors[2]
