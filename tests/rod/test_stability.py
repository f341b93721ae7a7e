"""Critical loads of columns, which linear theory knows."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Balance, Demands, Memory, Shape
from labpipe.rod.rotations import from_rotation_vectors, multiply
from labpipe.rod.stability import StabilityCheck
from labpipe.rod.supports import Grip, supports_of
from tests.builders.rods import LENGTH, STIFFNESS, linear_section, straight_line

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
    memory = Memory(np.zeros((len(supports.nodes), 0, 2)), np.zeros((0, N + 1, 3)), np.zeros(0))
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
    memory = Memory(np.zeros((len(supports.nodes), 0, 2)), np.zeros((0, N + 1, 3)), np.zeros(0))
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
