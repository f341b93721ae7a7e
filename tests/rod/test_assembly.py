"""The tangent of a line is the derivative of its residual, with everything that acts on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Demands, Drag, Memory, Shape
from labpipe.rod.boundaries import Plane
from labpipe.rod.line import Line, Section
from labpipe.rod.rotations import from_rotation_vectors, multiply, skew, unit
from labpipe.rod.supports import supports_of
from tests.builders.rods import SLIDING, straight_line

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
        self.memory = Memory(
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

    def residual(self, change: Floats, drag: Drag | None = None) -> Floats:
        shape = self.assembly.changed(self.shape, change)
        return self.assembly.balance(shape, self.demands, self.memory, drag).residual

    def matrix(self, drag: Drag | None = None) -> Floats:
        values = self.assembly.balance(self.shape, self.demands, self.memory, drag).values
        total = self.assembly.places.total
        out = np.zeros((total, total))
        np.add.at(out, self.assembly.pattern, values)
        return out

    def differences(self, drag: Drag | None = None) -> Floats:
        total = self.assembly.places.total
        scale = self.assembly.band.scale / np.max(self.assembly.band.scale)
        columns = []
        for k in range(total):
            change = np.zeros(total)
            change[k] = STEP * scale[k]
            ahead, back = self.residual(change, drag), self.residual(-change, drag)
            columns.append((ahead - back) / (2.0 * STEP * scale[k]))
        return np.stack(columns, axis=1)

    def without_skew(self, matrix: Floats, drag: Drag | None = None) -> Floats:
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
        drag = Drag(10.0, place, before)
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
