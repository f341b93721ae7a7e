"""Forces on nodes that depend on their position: planes with friction, and strings.

Both are stiff springs: planes and strings yield by a tiny length, so that Newton's method has a
solution. Friction has a history as sliders do: a node sticks to a point of the plane by a stiff
spring until its force reaches the friction, then drags the point along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.rod.boundaries import Plane

_EYE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class ContactForces:
    """Forces of one boundary on the nodes.

    Parameters
    ----------
    forces : shape (nodes, 3), N
    stiffness : shape (nodes, 3, 3), N/m, of minus the force by the position
    pressing : shape (nodes, 3, 3), N/m, its part by the growth of friction with pressure, which has
        no energy, so that stability is judged without it
    contacts : shape (nodes, 3), m, where the nodes stick
    rubbed : J, lost to friction in this step
    """

    forces: Floats
    stiffness: Floats
    pressing: Floats
    contacts: Floats
    rubbed: float


def touch_plane(
    plane: Plane, stiffness: float, positions: Floats, contacts: Floats, *, close: float
) -> ContactForces:
    """Support nodes by a plane.

    Parameters
    ----------
    plane : with its friction
    stiffness : N/m of a node
    positions : shape (nodes, 3), m
    contacts : shape (nodes, 3), m, where the nodes stuck before the step
    close : m, a nearer node counts as touching, without force
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
    pressing = np.zeros_like(tangent)
    if plane.friction > 0.0:
        forces = forces - stiffness * held_offset
        turning = is_sliding & is_in
        heading = np.where(turning, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)[:, None] * offset
        across = flat - heading[:, :, None] * heading[:, None, :]
        tangent = tangent + stiffness * held_share[:, None, None] * across
        pressing = -stiffness * plane.friction * heading[:, :, None] * normal
        tangent = tangent + pressing
    moved = (offset - held_offset) * is_in[:, None]
    rubbed = float(np.sum(plane.friction * press * np.linalg.norm(moved, axis=1)))
    return ContactForces(forces, tangent, pressing, positions - held_offset, rubbed)


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
    Forces, shape (strings, 3), N, and N/m of minus the forces by the position, (strings, 3, 3).
    """
    reach = anchors - positions
    distance = np.linalg.norm(reach, axis=1)
    heading = reach / np.where(distance > 0.0, distance, 1.0)[:, None]
    tension = stiffness * np.maximum(distance - lengths, 0.0)
    along = heading[:, :, None] * heading[:, None, :]
    turning = tension / np.where(distance > 0.0, distance, 1.0)
    taut = np.where(tension > 0.0, stiffness, 0.0)
    out = taut[:, None, None] * along + turning[:, None, None] * (_EYE - along)
    return tension[:, None] * heading, out


def added_at(nodes: Ints, values: Floats, total: int) -> Floats:
    """Sum values at their nodes, shape (total, ...)."""
    out = np.zeros((total, *values.shape[1:]))
    np.add.at(out, nodes, values)
    return out
