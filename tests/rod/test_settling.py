"""One step of Newton's method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.rod.assembly import Assembly, Demands, Memory, Shape
from labpipe.rod.settling import settle
from labpipe.rod.supports import supports_of
from tests.builders.rods import LENGTH, STIFFNESS, linear_section, straight_line

N = 10
LINE = straight_line(LENGTH, N, linear_section())
FORCE = STIFFNESS / LENGTH**2
ASSEMBLY = Assembly(
    LINE,
    supports_of(LINE, ((0, True),)),
    (),
    (np.zeros(0, dtype=np.int64), np.zeros(0)),
    n_rings=0,
    force=FORCE,
)
SHAPE = Shape(LINE.positions, LINE.frames, np.zeros(N), np.zeros((N, 3)))
MEMORY = Memory(np.zeros((N, 0, 2)), np.zeros((0, N + 1, 3)), np.zeros(0))


def demands(tip: Floats) -> Demands:
    forces = np.zeros((N + 1, 3))
    forces[-1] = tip
    none = np.zeros((0, 3))
    return Demands(LINE.positions[:1], LINE.frames[:1], forces, np.zeros((N, 3)), none, none)


def test_a_small_load_deflects_as_a_beam() -> None:
    load = np.array([0.0, 1e-3 * FORCE, 0.0])
    found = settle(ASSEMBLY, SHAPE, MEMORY, (demands(np.zeros(3)), demands(load)), force=FORCE)
    assert found is not None
    assert found.iterations <= 3
    assert found.shape.positions[-1, 1] == pytest.approx(1e-3 * LENGTH / 3.0, rel=2e-3)
    np.testing.assert_allclose(found.shape.forces, np.tile(load, (N, 1)), atol=1e-12 * FORCE)


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
