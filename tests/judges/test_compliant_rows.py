"""Rows of the source's step against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Held, Plane
from tests.judges.compliant_rows import (
    Body,
    Contact,
    Rod,
    Rows,
    darboux,
    held,
    impulse,
    joints,
    place_at,
    stacked,
    touching,
    turn_between,
    turned,
)

COUNT = 4
RNG = np.random.default_rng(5)
STILL = np.zeros((COUNT, 3))


def frames(count: int) -> Floats:
    values = np.random.default_rng(count).normal(size=(count, 4))
    return np.asarray(values / np.linalg.norm(values, axis=1)[:, None])


ROD = Rod(
    half=np.array([0.5, 0.7, 0.6, 0.9]),
    mass=np.array([1.0, 1.3, 1.1, 1.7]),
    inertia=np.array([0.3, 0.5, 0.4, 0.8]),
    spacing=np.array([1.2, 1.3, 1.5]),
    rest=np.array([[0.1, 0.2, 0.3], [0.0, -0.4, 0.1], [0.5, 0.0, 0.0]]),
    stretching=0.0,
    bending=np.array([0.5, 0.5, 0.8]),
    clamped=np.array([2]),
)
BODY = Body(np.random.default_rng(1).normal(size=(COUNT, 3)), frames(COUNT), STILL, STILL)
CLAMPS = [Held(node, np.ones(3), frames(node + 1)[-1]) for node in (0, 2, COUNT)]
TABLE = Contact(
    Plane(np.zeros(3), np.array([0.3, 0.1, 1.0]), 0.5),
    np.array([1, 3]),
    np.tile([9.0, 0.0, 0.0], (2, 1)),
)


def everything(body: Body) -> Rows:
    rows = [joints(ROD, body), *darboux(ROD, body)]
    rows += [row for clamp in CLAMPS for row in held(ROD, body, clamp, 0.3)]
    return stacked([*rows, touching(ROD, BODY, body, TABLE)[0]])


def moved(body: Body, by: Floats) -> Body:
    return replace(body, centres=body.centres + by[:, :3], frames=turned(body.frames, by[:, 3:]))


def test_derivatives_of_every_row() -> None:
    rows = everything(BODY)
    # Gaps of 3 joints, Darboux vectors of 2, places of 3 clamps, turns of 4 sides, 2 contacts.
    assert len(rows.gap) == 3 * 3 + 3 * 2 + 3 * 3 + 3 * 4 + 2
    found = rows.jacobian(COUNT).toarray()
    for column in range(6 * COUNT):
        by = np.zeros(6 * COUNT)
        by[column] = 1e-6
        there, back = (everything(moved(BODY, way * by.reshape(-1, 6))).gap for way in (1.0, -1.0))
        assert found[:, column] == pytest.approx((there - back) / 2e-6, abs=1e-7)


def test_rows_of_a_chain_neither_bend_nor_twist() -> None:
    chain = replace(ROD, bending=None)
    assert darboux(chain, BODY) == []
    clamp = stacked(held(chain, BODY, CLAMPS[0], 0.0))
    assert np.all(clamp.compliance == 0.0)


def test_a_straight_rod_fits_a_clamp_along_it() -> None:
    along = np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1))
    centres = np.zeros((COUNT, 3))
    centres[:, 2] = np.cumsum(2.0 * ROD.half) - ROD.half
    body = Body(centres, along, STILL, STILL)
    straight = replace(ROD, rest=np.zeros((3, 3)))
    rows = [joints(straight, body), *darboux(straight, body)]
    rows += held(straight, body, Held(0, np.zeros(3), along[0]), 0.0)
    rows += held(straight, body, Held(-1, np.array([0.0, 0.0, 5.4]), along[0]), 0.0)
    assert stacked(rows).gap == pytest.approx(0.0, abs=1e-15)


def test_nodes_above_the_plane_are_let_go() -> None:
    high = replace(BODY, centres=BODY.centres + np.array([0.0, 0.0, 100.0]))
    rows, contact, at = touching(ROD, high, high, TABLE)
    assert len(rows.gap) == len(at) == 0
    assert np.all(contact.held == 0.0)


def test_friction_is_against_the_slip_and_no_larger_than_it_can_be() -> None:
    low = replace(BODY, centres=BODY.centres - np.array([0.0, 0.0, 5.0]))
    slip = TABLE.axes[1] * 100.0
    after = replace(low, centres=low.centres + slip)
    contact = touching(ROD, low, after, TABLE)[1]
    assert contact.held == pytest.approx(np.tile([9.0, -4.5, 0.0], (2, 1)))


def test_a_push_at_a_node_turns_its_element() -> None:
    """Force and moment about the centre, seen from the first element's near end."""
    along = np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1))
    body = Body(STILL, along, STILL, STILL)
    whole = impulse(ROD, body, np.array([0]), np.array([[2.0, 0.0, 0.0]])).reshape(-1, 6)
    assert whole[0] == pytest.approx([2.0, 0.0, 0.0, 0.0, -1.0, 0.0])
    assert np.all(whole[1:] == 0.0)


def test_paths_go_straight_between_their_rows() -> None:
    path = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    assert place_at(path, 0.5) == pytest.approx([0.5, 1.0, 1.5])
    assert place_at(path, 7.0) == pytest.approx([1.0, 2.0, 3.0])


def test_turns_there_and_back() -> None:
    by = np.array([[0.1, -0.2, 0.3]])
    after = turned(BODY.frames[:1], by)
    assert turn_between(BODY.frames[:1], after) == pytest.approx(by)
