"""Loops of a rod against Masing's rule, and against the cantilever of `wire` (PHYSICS 7).

`wire` solves the clamped wire with the dual of the sliders, plays, at Chebyshev stations: it has
neither elements nor frames.
"""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.plays import respond, virgin_plays
from labpipe.law.sliders import as_plays
from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Load, Moment
from labpipe.wire.cantilever import bend_under_force, straight
from tests.builders.rods import (
    LENGTH,
    SLIDING,
    clamp,
    sliding_section,
    straight_line,
    there_and_back,
    walked,
)

PLAYS = as_plays(SLIDING)


def test_a_node_there_and_back_follows_masing() -> None:
    steps, peak = 60, 6e-3
    moments = there_and_back((0.0, 0.0, peak), steps, cycles=2)
    line = straight_line(0.02, 1, sliding_section())
    path = walked(line, [clamp(line), Moment(-1, moments)], steps)
    # d1 is up: a moment about it bends by the first component
    found = np.array([state.curvatures[0, 1, 0] for state in path.states])
    plays, expected = virgin_plays(PLAYS, 1), []
    for moment in moments[:, 2]:
        response = respond(PLAYS, np.array([moment]), plays)
        plays = response.plays
        expected.append(float(response.curvature[0]))
    assert np.ptp(expected) > 20.0
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.ptp(expected))


def wire_loop(forces: Floats) -> Floats:
    """Deflections of the cantilever of `wire` under forces across it, m, at 96 stations."""
    state, out = straight(PLAYS, 96), []
    for force in forces:
        shape = bend_under_force(PLAYS, state, LENGTH, np.array([0.0, force]))
        state = shape.state
        out.append(float(shape.y[-1]))
    return np.array(out)


def test_the_loop_of_a_cantilever_is_that_of_wire() -> None:
    steps, peak = 48, 0.028
    forces = there_and_back((0.0, peak, 0.0), steps, cycles=2)
    expected = wire_loop(forces[:, 1])
    assert np.max(expected) > 0.6 * LENGTH
    off = []
    for n in (20, 40):
        line = straight_line(LENGTH, n, sliding_section())
        path = walked(line, [clamp(line), Load(-1, forces)], steps)
        found = np.array([state.positions[-1, 1] for state in path.states])
        off.append(np.max(np.abs(found - expected)) / np.max(expected))
    assert off[1] < 3e-3 / 5.0
    assert off[1] < 0.5 * off[0]


@pytest.mark.slow
def test_what_a_closed_path_loses_is_the_sum_over_its_nodes() -> None:
    """The area of every cell's own loop, times its length."""
    line = straight_line(LENGTH, 10, sliding_section())
    lost = []
    for steps in (60, 120, 240):
        forces = there_and_back((0.0, 0.02, 0.01), steps, cycles=2)
        path = walked(line, [clamp(line), Load(-1, forces)], steps)
        bent = np.array([state.curvatures for state in path.states])[..., :2]
        sides = 0.5 * line.lengths[0] * np.ones((11, 2))
        sides[0, 0] = sides[-1] = 0.0
        rests = np.array([state.rests for state in path.states])
        law = SLIDING
        held = (bent[..., None, :] - rests) * law.stiffnesses[:, None]
        moment = law.stiffness * bent + np.sum(held, axis=3)
        areas = 0.5 * np.sum((moment[1:] + moment[:-1]) * np.diff(bent, axis=0), axis=(0, 3))
        stored = path.stored[-1]
        lost.append((path.lost[-1], float(np.sum(sides * areas)) - stored))
    exact, sums = np.array(lost).T
    assert exact[-1] == pytest.approx(exact[0], rel=1e-3)
    off = np.abs(sums / exact - 1.0)
    assert off[-1] < 2.5e-3
    assert off[-1] < 0.15 * off[0]
