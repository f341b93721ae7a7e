"""Loops of a rod against Masing's rule, the cantilever of `wire`, and MuJoCo.

`wire` solves the clamped wire with plays at Chebyshev stations: it has neither elements nor frames.
MuJoCo runs labpipe's own deck of the same wire; its chain has 30 hinges and stands within 1 to 2 %
of the wire model (`tests/decks/test_mujoco_sliders.py`).
"""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.mechanics.decks.mujoco_sliders import format_plane_deck, format_space_deck
from labpipe.mechanics.law.loss_card import fit_wire_sliders
from labpipe.mechanics.law.sliders import convert_to_plays
from labpipe.mechanics.rod.boundaries import Load
from labpipe.mechanics.rod.line import Section
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.wire.cantilever import bend_under_force, make_straight
from labpipe.records.arrays import Floats
from tests.builders.rods import (
    LENGTH,
    SLIDING,
    clamp,
    sliding_section,
    straight_line,
    there_and_back,
    walked,
)
from tests.builders.wire_tables import LENGTH as WIRE_LENGTH
from tests.builders.wire_tables import wire_table
from tests.judges.judged_rods import clamped
from tests.judges.rod_references import tips

PLAYS = convert_to_plays(SLIDING)


def test_a_node_there_and_back_follows_masing() -> None:
    steps, peak = 60, 0.6
    forces = there_and_back((0.0, peak, 0.0), steps, cycles=2)
    line = straight_line(0.02, 2, sliding_section())
    path = walked(line, [clamp(line), Load(-1, forces)], steps)
    # d1 is up: a moment about it bends by the first component
    found = np.array([state.curvatures[1, 0, 0] for state in path.states])
    moments = np.array([state.moments[1, 0, 2] for state in path.states])
    plays, expected = PLAYS.make_unbent_history(1), []
    for moment in moments:
        response = PLAYS.respond(np.array([moment]), plays)
        plays = response.history
        expected.append(float(response.curvature[0]))
    assert np.ptp(expected) > 20.0
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.ptp(expected))


def wire_loop(forces: Floats) -> Floats:
    """Deflections of the cantilever of `wire` under forces across it, m, at 96 stations."""
    state, out = make_straight(PLAYS, 96), []
    for force in forces:
        shape = bend_under_force(PLAYS, state, LENGTH, np.array([0.0, force]))
        state = shape.state
        out.append(float(shape.y[-1]))
    return np.array(out)


@pytest.mark.slow
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


ELEMENTS = 60
PARTS = 5
"""Steps of the rod to each load of the chain."""


def rod_tips(
    name: str, loads: Floats, towards: float | Floats = 0.0, *, parts: int = PARTS
) -> Floats:
    """Where the tip of the rod is under each load, shape (loads, 3)."""
    table = wire_table(name)
    section = Section(fit_wire_sliders(table), table.torsional_stiffness)
    line = straight_line(WIRE_LENGTH, ELEMENTS, section)
    angles = np.broadcast_to(towards, loads.shape)
    pulls = np.column_stack([0.0 * loads, loads * np.cos(angles), loads * np.sin(angles)])
    corners = np.vstack([np.zeros(3), pulls])
    at = np.arange(parts * len(loads) + 1) / parts
    force = np.column_stack(
        [np.interp(at, np.arange(len(corners)), corner) for corner in corners.T]
    )
    path = follow(line, [clamped(line), Load(-1, force)], steps=len(force) - 1)
    assert path.status == "ok", path.reasons
    return np.array([state.positions[-1] for state in path.states])[parts::parts]


@pytest.mark.slow
def test_a_load_that_turns() -> None:
    """Pulled up, then round by a quarter turn: vector sliders against scalar ones.

    Within 0.3 % of the deflection; what is left without load within 0.7 % of it.
    """
    towards = np.radians([0.0, 0.0, 30.0, 60.0, 90.0, 90.0])
    loads = np.array([0.4, 0.8, 0.8, 0.8, 0.8, 0.0])
    rod = rod_tips("A2", loads, towards)
    chain = tips(format_space_deck(wire_table("A2")), loads, towards)
    off = np.linalg.norm(rod - chain, axis=1)
    most = np.max(np.linalg.norm(chain[:, 1:], axis=1))
    assert np.max(off[:-1]) < 3e-3 * most
    assert off[-1] < 7e-3 * most


@pytest.mark.slow
def test_there_and_back_and_there_again() -> None:
    """Two cycles: deflections, and what is left without load, within 0.5 %."""
    loads = 0.9 * np.array([0.2, 0.5, 1.0, 0.5, 0.0, -0.5, 0.0, 0.5, 1.0, 0.0])
    rod, chain = rod_tips("A2", loads), tips(format_plane_deck(wire_table("A2")), loads)
    assert float(np.max(np.abs(chain[:, 1]))) > 0.4 * WIRE_LENGTH
    assert rod[:, 1] == pytest.approx(chain[:, 1], rel=5e-3)
    assert rod[:, 2] == pytest.approx(0.0, abs=1e-9)
