"""Contact of a line with planes, strings and rings.

Planes and strings are stiff springs, which yield by a tiny length so that Newton's method has a
solution. Friction has a history, as sliders have: a stiff spring connects a node to a point of the
plane, at which it sticks; when its force exceeds the friction, the point moves with the node.

A ring acts on a smooth curve in place of the elements, so that the line slides smoothly past nodes.
The curve is the quadratic spline that is tangent to every element at its middle. Its parameter u is
measured in nodes: u = 3.5 is the middle of the element behind node 3. A ring is a stiff spring to
the nearest point of the curve; its force is normal to the curve, without friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.rod.boundaries import Plane
from labpipe.records.arrays import Floats, Ints

_EYE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class ContactForces:
    """Forces of one boundary on the nodes.

    Parameters
    ----------
    forces : shape (nodes, 3), N
    stiffness : shape (nodes, 3, 3), N/m, of minus the force by the position
    friction_coupling : shape (nodes, 3, 3), N/m, part of `stiffness` from the increase of friction
        with pressure. It has no potential, and stability is checked without it
    contacts : shape (nodes, 3), m, points at which the nodes stick
    friction_loss : J, lost by friction in this step
    """

    forces: Floats
    stiffness: Floats
    friction_coupling: Floats
    contacts: Floats
    friction_loss: float


def touch_plane(
    plane: Plane, stiffness: float, positions: Floats, contacts: Floats, *, close: float
) -> ContactForces:
    """Compute the forces of a plane on nodes.

    Parameters
    ----------
    plane : with its friction
    stiffness : N/m of a node
    positions : shape (nodes, 3), m
    contacts : shape (nodes, 3), m, points at which the nodes stuck before the step
    close : m, distance below which a node counts as touching, without force
    """
    normal = plane.normal
    depth = -(positions - plane.point) @ normal
    press = stiffness * np.maximum(depth, 0.0)
    is_in = depth >= -close
    tangent = np.where(is_in, stiffness, 0.0)[:, None, None] * np.outer(normal, normal)
    forces = press[:, None] * normal
    flat = _EYE - np.outer(normal, normal)
    offset = (positions - contacts) @ flat
    size = np.linalg.norm(offset, axis=1)
    largest = plane.friction * press / stiffness
    is_sliding = size > largest
    held_share = np.where(is_sliding, largest / np.where(size > 0.0, size, 1.0), 1.0)
    held_share = np.where(is_in, held_share, 0.0)
    held_offset = held_share[:, None] * offset
    friction_coupling = np.zeros_like(tangent)
    if plane.friction > 0.0:
        forces = forces - stiffness * held_offset
        turning = is_sliding & is_in
        heading = np.where(turning, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)[:, None] * offset
        across = flat - heading[:, :, None] * heading[:, None, :]
        tangent = tangent + stiffness * held_share[:, None, None] * across
        friction_coupling = -stiffness * plane.friction * heading[:, :, None] * normal
        tangent = tangent + friction_coupling
    moved = (offset - held_offset) * is_in[:, None]
    friction_loss = float(np.sum(plane.friction * press * np.linalg.norm(moved, axis=1)))
    return ContactForces(forces, tangent, friction_coupling, positions - held_offset, friction_loss)


def pull_strings(
    anchors: Floats, lengths: Floats, stiffness: float, positions: Floats
) -> tuple[Floats, Floats]:
    """Compute the forces of strings, which do not push.

    Parameters
    ----------
    anchors : shape (strings, 3), m
    lengths : shape (strings,), m
    stiffness : N/m
    positions : shape (strings, 3), m, of their nodes

    Returns
    -------
    Forces, shape (strings, 3), N, and the derivatives of minus the forces by the positions, shape
    (strings, 3, 3), N/m.
    """
    offsets = anchors - positions
    distance = np.linalg.norm(offsets, axis=1)
    heading = offsets / np.where(distance > 0.0, distance, 1.0)[:, None]
    tension = stiffness * np.maximum(distance - lengths, 0.0)
    along = heading[:, :, None] * heading[:, None, :]
    turning = tension / np.where(distance > 0.0, distance, 1.0)
    taut = np.where(tension > 0.0, stiffness, 0.0)
    out = taut[:, None, None] * along + turning[:, None, None] * (_EYE - along)
    return tension[:, None] * heading, out


def sum_at_nodes(nodes: Ints, values: Floats, total: int) -> Floats:
    """Sum values at their nodes, shape (total, ...)."""
    out = np.zeros((total, *values.shape[1:]))
    np.add.at(out, nodes, values)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class RingContact:
    """Contact of a line with a ring.

    Parameters
    ----------
    place : u
    first : first of the three loaded nodes
    weights : shape (3,), of these nodes in the point of the curve
    force : shape (3,), N, of the ring on the line
    stiffness : shape (3, 3, 3, 3), N/m, of minus the force on one node (axis 0, 1) by the position
        of another (2, 3)
    """

    place: float
    first: int
    weights: Floats
    force: Floats
    stiffness: Floats


def hold_in_ring(positions: Floats, ring: Floats, near: float, stiffness: float) -> RingContact:
    """Find the place at which a line passes through a ring, and the force of the ring.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, of the nodes; n >= 2
    ring : shape (3,), m
    near : u, previous place in the ring
    stiffness : N/m
    """
    place = find_nearest_place(positions, ring, near)
    first, b, slopes, bends = _compute_weights(place, len(positions))
    points = positions[first : first + 3]
    offset = b @ points - ring
    along, bend = slopes @ points, bends @ points
    mixed = b[:, None] * along + slopes[:, None] * offset
    size = along @ along + max(float(offset @ bend), -0.5 * float(along @ along))
    out = np.einsum("i,j,xy->ixjy", b, b, np.eye(3))
    if 0.0 < place < len(positions) - 1:
        out -= np.einsum("ix,jy->ixjy", mixed, mixed) / size
    return RingContact(place, first, b, -stiffness * offset, stiffness * out)


def evaluate_curve(positions: Floats, place: float) -> Floats:
    """Return the point of the curve at u, m, shape (3,)."""
    first, weights, _, _ = _compute_weights(place, len(positions))
    return np.asarray(weights @ positions[first : first + 3])


def _compute_weights(place: float, n_nodes: int) -> tuple[int, Floats, Floats, Floats]:
    """Return the first node, and the weights of three nodes with both derivatives by u."""
    node = int(np.clip(np.floor(place + 0.5), 1, n_nodes - 2))
    t = place - node + 0.5
    none = np.zeros(3)
    if t < 0.0:  # the first half element: straight
        u = place - (node - 1)
        return node - 1, np.array([1.0 - u, u, 0.0]), np.array([-1.0, 1.0, 0.0]), none
    if t > 1.0:
        u = place - node
        return node - 1, np.array([0.0, 1.0 - u, u]), np.array([0.0, -1.0, 1.0]), none
    b = np.array([0.5 * (1.0 - t) ** 2, 0.5 + t * (1.0 - t), 0.5 * t**2])
    return node - 1, b, np.array([t - 1.0, 1.0 - 2.0 * t, t]), np.array([1.0, -2.0, 1.0])


def find_nearest_place(positions: Floats, ring: Floats, near: float) -> float:
    """Find u of the point nearest to a ring, in the vicinity of the previous place."""
    max_iterations = 30
    search_reach = 1.5  # nodes on both sides of the last place
    last = float(len(positions) - 1)
    low, high = max(near - search_reach, 0.0), min(near + search_reach, last)
    candidates = np.linspace(low, high, 25)
    distances = [float(np.sum((evaluate_curve(positions, u) - ring) ** 2)) for u in candidates]
    place = float(candidates[int(np.argmin(distances))])
    for _ in range(max_iterations):
        first, b, slopes, bends = _compute_weights(place, len(positions))
        points = positions[first : first + 3]
        offset = b @ points - ring
        along = slopes @ points
        size = along @ along + max(float(offset @ (bends @ points)), -0.5 * float(along @ along))
        change = float(np.clip(-(offset @ along) / size, -0.1, 0.1))
        place = float(np.clip(place + change, 0.0, last))
        if abs(change) < 1e-14:
            break
    return place
