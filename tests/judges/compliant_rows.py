"""Rows of the compliant step (B.1): joints, Darboux vectors, held nodes, and nodes on a plane.

A row is one number that is to vanish, with its derivative by the positions and rotation vectors of
one or two elements. Elements are stiff bodies, see `rod.compliant`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from labpipe.records.arrays import Floats, Ints
from labpipe.rod.boundaries import Held, Plane

_SOFT = 1e-6
"""Of a node's mobility, how far a row gives way within an iteration, and no further in the next."""
_SHARE = 0.25
"""Of the force that would end a node's slip if it moved by itself; twice that may swing."""
_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Rod:
    """What stays: of n elements half lengths, masses, moments of inertia (alike about each axis).

    `rest` has shape (n - 1, 3). Compliances are divided by the square of the step's time: that of
    the joints, and of bending and twist, for a cell of length 1; None for a chain.
    """

    half: Floats
    mass: Floats
    inertia: Floats
    spacing: Floats
    rest: Floats
    stretching: float
    bending: Floats | None
    clamped: Ints

    @property
    def count(self) -> int:
        """Of elements."""
        return len(self.half)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """What moves: centres (n, 3), frames (n, 4), and their velocities, (n, 3) each."""

    centres: Floats
    frames: Floats
    velocity: Floats
    spin: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Constraints.

    Parameters
    ----------
    gap : shape (rows,), what is to vanish
    compliance : shape (rows,)
    elements : shape (rows, 2); one number twice where a row is about one element
    turns : shape (rows, 2, 6), derivatives by position and rotation vector of the two
    """

    gap: Floats
    compliance: Floats
    elements: Ints
    turns: Floats

    def jacobian(self, count: int) -> csr_array:
        """J of so many elements, shape (rows, 6 count)."""
        at = np.repeat(np.arange(len(self.gap)), 12)
        columns = (6 * self.elements[:, :, None] + np.arange(6)).ravel()
        return csr_array((self.turns.ravel(), (at, columns)), shape=(len(self.gap), 6 * count))


def stacked(rows: Sequence[Rows]) -> Rows:
    """Rows below one another."""
    return Rows(
        np.concatenate([each.gap for each in rows]),
        np.concatenate([each.compliance for each in rows]),
        np.concatenate([each.elements for each in rows]),
        np.concatenate([each.turns for each in rows]),
    )


def matrices(frames: Floats) -> Floats:
    """Rotation matrices, shape (n, 3, 3), of unit quaternions (w, x, y, z), shape (n, 4)."""
    return Rotation.from_quat(frames, scalar_first=True).as_matrix()


def turned(frames: Floats, by: Floats) -> Floats:
    """Frames after rotation vectors in space, shape (n, 3)."""
    whole = Rotation.from_rotvec(by) * Rotation.from_quat(frames, scalar_first=True)
    return np.asarray(whole.as_quat(scalar_first=True))


def turn_between(before: Floats, after: Floats) -> Floats:
    """Rotation vectors in space from frames to frames, shape (n, 3)."""
    whole = Rotation.from_quat(after, scalar_first=True)
    return np.asarray((whole * Rotation.from_quat(before, scalar_first=True).inv()).as_rotvec())


def arms(rod: Rod, frames: Floats) -> Floats:
    """From the centre of each element to its far end, p_i, m."""
    return np.asarray(rod.half[:, None] * matrices(frames)[:, :, 2])


def ends(rod: Rod, body: Body) -> tuple[Floats, Floats]:
    """Near and far ends of the elements, m."""
    arm = arms(rod, body.frames)
    return body.centres - arm, body.centres + arm


def joints(rod: Rod, body: Body) -> Rows:
    """First row of (B.2): the gap at each joint."""
    near, far = ends(rod, body)
    arm = arms(rod, body.frames)
    here, there = np.arange(rod.count - 1), np.arange(1, rod.count)
    turns = np.empty((rod.count - 1, 3, 2, 6))
    turns[:, :, 0, :3], turns[:, :, 1, :3] = np.eye(3), -np.eye(3)
    turns[:, :, 0, 3:], turns[:, :, 1, 3:] = -_cross(arm[here]), -_cross(arm[there])
    gap = far[here] - near[there]
    return _rows(gap, np.full(gap.shape, rod.stretching), here, there, turns)


def darboux(rod: Rod, body: Body) -> list[Rows]:
    """Second row of (B.2): the Darboux vector less its value at rest; none for a chain.

    Nor at a joint that is clamped, where each side bends against the clamp.
    """
    if rod.bending is None:
        return []
    here, there = np.arange(rod.count - 1), np.arange(1, rod.count)
    here = here[~np.isin(there, rod.clamped)]
    there = here + 1
    imaginary, turn = _relative(body.frames[here], body.frames[there])
    share = 1.0 / rod.spacing[here]
    turns = np.zeros((len(here), 3, 2, 6))
    turns[:, :, 1, 3:] = share[:, None, None] * turn
    turns[:, :, 0, 3:] = -turns[:, :, 1, 3:]
    gap = 2.0 * share[:, None] * imaginary - rod.rest[here]
    return [_rows(gap, share[:, None] * rod.bending, here, there, turns)]


def _relative(before: Floats, after: Floats) -> tuple[Floats, Floats]:
    """Im(conj(q_1) q_2), and twice its derivative by the rotation vector of the second."""
    first = Rotation.from_quat(before, scalar_first=True)
    between = (first.inv() * Rotation.from_quat(after, scalar_first=True)).as_quat(
        canonical=True, scalar_first=True
    )
    real, imaginary = between[:, :1, None], between[:, 1:]
    turn = (real * np.eye(3) - _cross(imaginary)) @ first.inv().as_matrix()
    return imaginary, turn


def _cross(vectors: Floats) -> Floats:
    """Matrices of the vector product from the left."""
    return np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1)


def _rows(gap: Floats, compliance: Floats, first: Ints, second: Ints, turns: Floats) -> Rows:
    """Rows by threes, (k, 3), one below the other."""
    elements = np.repeat(np.stack([first, second], axis=1), 3, axis=0)
    return Rows(gap.ravel(), compliance.ravel(), elements, turns.reshape(-1, 2, 6))


def element_of(node: int, count: int) -> tuple[int, float]:
    """An element that ends at a node, and whether at its far end (1) or its near one (-1)."""
    return (node, -1.0) if node < count else (count - 1, 1.0)


def held(rod: Rod, body: Body, boundary: Held, when: float) -> list[Rows]:
    """A node on its path, and the elements beside it where it is clamped."""
    node = boundary.node % (rod.count + 1)
    element, side = element_of(node, rod.count)
    arm = side * arms(rod, body.frames)[element]
    gap = body.centres[element] + arm - place_at(boundary.position, when)
    turns = np.zeros((1, 3, 2, 6))
    turns[0, :, 0, :3], turns[0, :, 0, 3:] = np.eye(3), -_cross(arm[None])[0]
    number = np.array([element])
    found = [_rows(gap[None], np.zeros((1, 3)), number, number, turns)]
    if boundary.frame is not None:
        frame = _frame_at(boundary.frame, when)
        found += [_clamp(rod, body, node, each, frame) for each in _beside(node, rod.count)]
    return found


def _beside(node: int, count: int) -> list[int]:
    """Elements that meet at a node."""
    return [each for each in (node - 1, node) if 0 <= each < count]


def _clamp(rod: Rod, body: Body, node: int, element: int, frame: Floats) -> Rows:
    """An element that grows out of a clamp: its half bends against it; that of a chain is held.

    At the ends of the line it is curved at rest as the joint beside it.
    """
    imaginary, turn = _relative(frame, body.frames[element : element + 1])
    way = 1.0 if element == node else -1.0
    share = way / (rod.half[element] if rod.bending is not None else 1.0)
    joint = min(max(node - 1, 0), rod.count - 2)
    rest = rod.rest[joint] if rod.bending is not None and joint >= 0 else 0.0
    compliance = np.zeros(3) if rod.bending is None else way * share * rod.bending
    turns = np.zeros((1, 3, 2, 6))
    turns[0, :, 0, 3:] = share * turn[0]
    number = np.array([element])
    return _rows(2.0 * share * imaginary - rest, compliance[None], number, number, turns)


def place_at(path: Floats, when: float) -> Floats:
    """A path's place between its rows."""
    before = min(int(when), len(path) - 1)
    after = min(before + 1, len(path) - 1)
    return np.asarray(path[before] + (when - before) * (path[after] - path[before]))


def _frame_at(path: Floats, when: float) -> Floats:
    before = min(int(when), len(path) - 1)
    after = min(before + 1, len(path) - 1)
    turn = turn_between(path[before : before + 1], path[after : after + 1])
    return turned(path[before : before + 1], (when - before) * turn)


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Nodes that may touch a plane, and what holds them, kg m, shape (nodes, 3).

    The first of the three is along the normal, the others lie in the plane.
    """

    plane: Plane
    nodes: Ints
    held: Floats

    @property
    def axes(self) -> Floats:
        """Normal and two directions of the plane, shape (3, 3)."""
        normal = self.plane.normal
        aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        aside /= np.linalg.norm(aside)
        return np.array([normal, aside, np.cross(normal, aside)])


def touching(rod: Rod, before: Body, body: Body, contact: Contact) -> tuple[Rows, Contact, Ints]:
    """Rows of the nodes that touch the plane, and of those that friction holds.

    Parameters
    ----------
    rod : the rod
    before, body : at the begin of the step, and now
    contact : what holds the nodes after the last iteration

    Returns
    -------
    Rows along the normal, of the nodes that touch; what holds the nodes now; which nodes touch.

    Notes
    -----
    Which nodes touch is asked of force and gap together (Alart and Curnier, 1991). Friction is a
    known force that grows against the slip of the step, iteration by iteration and step by step,
    until nothing slips or it is as large as it can be. A row for it could not be met where a
    straight chain begins to move.
    """
    count, axes = rod.count, contact.axes
    element = np.minimum(contact.nodes, count - 1)
    side = np.where(contact.nodes < count, -1.0, 1.0)[:, None]
    arm = side * arms(rod, body.frames)[element]
    place = body.centres[element] + arm
    was = before.centres[element] + side * arms(rod, before.frames)[element]
    gap = np.concatenate(
        [(place - contact.plane.point) @ axes[:1].T, (place - was) @ axes[1:].T], axis=1
    )
    mass = rod.mass[element]
    touches = contact.held[:, 0] > mass * gap[:, 0]
    friction = contact.held[:, 1:] - _SHARE * mass[:, None] * gap[:, 1:]
    most = contact.plane.friction * np.maximum(contact.held[:, 0], 0.0)
    size = np.linalg.norm(friction, axis=1)
    friction *= (most / np.maximum(size, np.maximum(most, _TINY)))[:, None]
    now = np.where(touches[:, None], np.column_stack([contact.held[:, 0], friction]), 0.0)
    at = np.flatnonzero(touches)
    turns = np.zeros((len(at), 2, 6))
    turns[:, 0, :3], turns[:, 0, 3:] = axes[0], np.cross(arm[at], axes[0])
    elements = np.stack([element[at]] * 2, axis=1)
    rows = Rows(gap[at, 0], _SOFT / mass[at], elements, turns)
    return rows, Contact(contact.plane, contact.nodes, now), at


def impulse(rod: Rod, body: Body, nodes: Ints, pushes: Floats) -> Floats:
    """What pushes at nodes, shape (nodes, 3), do to the elements: shape (6 n,)."""
    element = np.minimum(nodes, rod.count - 1)
    side = np.where(nodes < rod.count, -1.0, 1.0)[:, None]
    arm = side * arms(rod, body.frames)[element]
    whole = np.zeros((rod.count, 6))
    np.add.at(whole, element, np.hstack([pushes, np.cross(arm, pushes)]))
    return whole.ravel()
