"""Boundaries of a line: grips, rings, strings, loads, planes and weight, with their paths.

A path has a row for the start and one for each step, shape (steps + 1, ...). A single row, or a
vector, is constant. Between two steps positions and forces are interpolated linearly, and frames
turn at a constant rate. Forces keep their direction in space.

Planes and strings are stiff springs, which deform slightly so that Newton's method has a solution.
Friction depends on the history, as in sliders: a stiff spring connects a node to the point of the
plane at which it sticks; when its force exceeds the friction, the point moves with the node.

A ring acts on a smooth curve in place of the elements, so that the line slides smoothly past nodes.
The curve is the quadratic spline that is tangent to every element at its middle; the two half
elements at the ends are straight. Its parameter u is measured in nodes: u = 3.5 is the middle of
the element after node 3. A ring is a stiff spring to the nearest point of the curve; its force is
normal to the curve, without friction.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from labpipe.mechanics.law.plays import require, require_not_negative, require_positive
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.units import GRAVITY

EARTH = (0.0, 0.0, -GRAVITY)
"""Gravitational acceleration, m/s^2."""


def _check_path(name: str, values: object, width: int) -> Floats:
    """Return a path as read-only rows.

    Raises
    ------
    ValueError
        If it has another width or is not finite.
    """
    path: Floats = np.array(values, dtype=np.float64)
    path = path[None] if path.ndim == 1 else path
    if path.ndim != 2 or path.shape[1] != width or not len(path):
        shape = path.shape
        raise ValueError(
            format_sentence("mechanics.rod.path_shape", name=name, shape=shape, width=width)
        )
    is_finite = np.all(np.isfinite(path), axis=1)
    if not np.all(is_finite):
        row = f"{name}, row {int(np.argmin(is_finite))}"
        raise ValueError(format_sentence("mechanics.rod.not_finite", name=row))
    path.flags.writeable = False
    return path


def _check_direction(name: str, values: object) -> Floats:
    vector = _check_path(name, values, 3)
    size = float(np.linalg.norm(vector[0]))
    is_direction = len(vector) == 1 and size > 0.0
    require(name, np.asarray(values).tolist(), "a direction, not zero", holds=is_direction)
    unit: Floats = vector[0] / size
    unit.flags.writeable = False
    return unit


def _set_fields(record: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(record, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """A clamp or a pin at a node, which may move and may release the line.

    Parameters
    ----------
    node : from 0; negative numbers count from the end of the line, as in Python
    position : path, m, shape (steps + 1, 3)
    frame : path, unit quaternions, shape (steps + 1, 4), of the frame to which the elements at the
        node are clamped, with d3 along the line; None for a pin, which lets the line turn
    release : first step without it; None if it never releases. Its reaction is removed in one step
    name : for messages

    Raises
    ------
    ValueError
        If a path has another shape or is not finite, a frame is not of length one, or `release` is
        below 1.
    """

    node: int
    position: Floats
    frame: Floats | None = None
    release: int | None = None
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, position=_check_path("position", self.position, 3))
        if self.frame is not None:
            frame = _check_path("frame", self.frame, 4)
            if np.max(np.abs(np.linalg.norm(frame, axis=1) - 1.0)) > 1e-6:
                raise ValueError(format_sentence("mechanics.rod.not_unit", name="frame"))
            _set_fields(self, frame=frame)
        require("release", self.release, ">= 1", holds=self.release is None or self.release >= 1)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A frictionless ring through which the line slides.

    Parameters
    ----------
    position : path, m, shape (steps + 1, 3)
    direction : shape (3,), of its opening, for figures only
    name : for messages

    Raises
    ------
    ValueError
        If a vector has another shape or is not finite.
    """

    position: Floats
    direction: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    name: str = ""

    def __post_init__(self) -> None:
        position = _check_path("position", self.position, 3)
        _set_fields(
            self, position=position, direction=_check_direction("direction", self.direction)
        )


@dataclass(frozen=True, slots=True, eq=False)
class String:
    """A weightless string from a node to an anchor; it pulls or is slack.

    Parameters
    ----------
    node : from 0, or negative from the end
    anchor : path, m, shape (steps + 1, 3)
    length : m, constant
    name : for messages

    Raises
    ------
    ValueError
        If the path has another shape or is not finite, or the length is not positive.
    """

    node: int
    anchor: Floats
    length: float
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, anchor=_check_path("anchor", self.anchor, 3))
        require_positive("length", self.length)


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """A force on a node, N, with its direction in space; a path of shape (steps + 1, 3)."""

    node: int
    force: Floats
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, force=_check_path("force", self.force, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane with Coulomb friction, on one side of which the line stays.

    The axis of the line stays half a diameter above it; friction acts on the axis.

    Parameters
    ----------
    point : shape (3,), m, on the plane
    normal : shape (3,), towards the side of the line
    friction : coefficient, >= 0
    name : for messages

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    point: Floats
    normal: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    friction: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        point = _check_path("point", self.point, 3)[0]
        _set_fields(self, point=point, normal=_check_direction("normal", self.normal))
        require_not_negative("friction", self.friction)

    def raised(self, height: float) -> Plane:
        """Return the plane raised by a height, m."""
        return replace(self, point=self.point + height * self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """Gravity: acceleration, m/s^2, a path of shape (steps + 1, 3); by default the earth's."""

    vector: Floats = field(default_factory=lambda: np.array(EARTH))
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, vector=_check_path("vector", self.vector, 3))


Boundary: TypeAlias = Held | Ring | String | Load | Plane | Gravity


_EYE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class ContactForces:
    """Forces of one boundary on the nodes.

    Parameters
    ----------
    forces : shape (nodes, 3), N
    stiffness : shape (nodes, 3, 3), N/m, derivative of minus the force by the position
    friction_coupling : shape (nodes, 3, 3), N/m, part of `stiffness` from the increase of friction
        with pressure. It has no potential, and stability is checked without it
    contacts : shape (nodes, 3), m, points at which the nodes stick
    """

    forces: Floats
    stiffness: Floats
    friction_coupling: Floats
    contacts: Floats


def touch_plane(
    plane: Plane, stiffness: float, positions: Floats, contacts: Floats, *, max_gap: float
) -> ContactForces:
    """Compute the forces of a plane on nodes.

    Parameters
    ----------
    plane : plane that the nodes touch
    stiffness : N/m, of the contact of a node
    positions : shape (nodes, 3), m
    contacts : shape (nodes, 3), m, points at which the nodes stuck before the step
    max_gap : m, gap up to which a node counts as touching, without force
    """
    normal = plane.normal
    depth = -(positions - plane.point) @ normal
    press = stiffness * np.maximum(depth, 0.0)
    is_touching = depth >= -max_gap
    tangent = np.where(is_touching, stiffness, 0.0)[:, None, None] * np.outer(normal, normal)
    forces = press[:, None] * normal
    projection = _EYE - np.outer(normal, normal)
    offset = (positions - contacts) @ projection
    distance = np.linalg.norm(offset, axis=1)
    max_offset = plane.friction * press / stiffness
    is_sliding = distance > max_offset
    divisor = np.where(distance > 0.0, distance, 1.0)
    sticking_share = np.where(is_sliding, max_offset / divisor, 1.0)
    sticking_share = np.where(is_touching, sticking_share, 0.0)
    sticking_offset = sticking_share[:, None] * offset
    friction_coupling = np.zeros_like(tangent)
    if plane.friction > 0.0:
        forces = forces - stiffness * sticking_offset
        is_slipping_contact = is_sliding & is_touching
        slip_direction = np.where(is_slipping_contact, 1.0 / divisor, 0.0)[:, None] * offset
        across = projection - slip_direction[:, :, None] * slip_direction[:, None, :]
        tangent = tangent + stiffness * sticking_share[:, None, None] * across
        friction_coupling = -stiffness * plane.friction * slip_direction[:, :, None] * normal
        tangent = tangent + friction_coupling
    return ContactForces(forces, tangent, friction_coupling, positions - sticking_offset)


def pull_strings(
    anchors: Floats, lengths: Floats, stiffness: float, positions: Floats
) -> tuple[Floats, Floats]:
    """Compute the forces of strings, which pull or are slack.

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
    place : u of the point of the curve nearest to the ring
    first : first of the three loaded nodes
    weights : shape (3,), weights of these nodes in the position of that point
    force : shape (3,), N, of the ring on the line
    stiffness : shape (3, 3, 3, 3), N/m, derivative of minus the force on a node (axes 0 and 1) by
        the position of a node (axes 2 and 3)
    """

    place: float
    first: int
    weights: Floats
    force: Floats
    stiffness: Floats


def hold_in_ring(
    positions: Floats, ring: Floats, previous_place: float, stiffness: float
) -> RingContact:
    """Find the place at which a line passes through a ring, and the force of the ring.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, of the nodes; n >= 2
    ring : shape (3,), m, position of the ring
    previous_place : u at which the line passed through the ring before
    stiffness : N/m
    """
    place = find_nearest_place(positions, ring, previous_place)
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
    """Return the point of the curve at u = `place`, m, shape (3,)."""
    first, weights, _, _ = _compute_weights(place, len(positions))
    return np.asarray(weights @ positions[first : first + 3])


def _compute_weights(place: float, n_nodes: int) -> tuple[int, Floats, Floats, Floats]:
    """Return the first node, and the weights of three nodes with both derivatives by u."""
    node = int(np.clip(np.floor(place + 0.5), 1, n_nodes - 2))
    t = place - node + 0.5
    zeros = np.zeros(3)
    if t < 0.0:  # the first half element: straight
        u = place - (node - 1)
        return node - 1, np.array([1.0 - u, u, 0.0]), np.array([-1.0, 1.0, 0.0]), zeros
    if t > 1.0:
        u = place - node
        return node - 1, np.array([0.0, 1.0 - u, u]), np.array([0.0, -1.0, 1.0]), zeros
    b = np.array([0.5 * (1.0 - t) ** 2, 0.5 + t * (1.0 - t), 0.5 * t**2])
    return node - 1, b, np.array([t - 1.0, 1.0 - 2.0 * t, t]), np.array([1.0, -2.0, 1.0])


def find_nearest_place(positions: Floats, ring: Floats, previous_place: float) -> float:
    """Find u of the point nearest to a ring, in the vicinity of the previous place."""
    max_iterations = 30
    search_reach = 1.5  # nodes on both sides of the last place
    end_place = float(len(positions) - 1)
    low, high = (
        max(previous_place - search_reach, 0.0),
        min(previous_place + search_reach, end_place),
    )
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
        place = float(np.clip(place + change, 0.0, end_place))
        if abs(change) < 1e-14:
            break
    return place
