"""Boundaries of a line: grips, rings, strings, loads, planes and weight, with their paths.

A path has a row for the start and one for each step, shape (steps + 1, ...). A single row, or a
vector, is constant. Between two steps positions and forces are interpolated linearly, and frames
rotate at a constant rate. Forces keep their direction in space.

Planes and strings are modelled as stiff springs, which deform slightly so that Newton's method has
a solution. Friction depends on the history, as in sliders. A stiff spring connects a node to the
point of the plane at which the node sticks. If the force of this spring exceeds the friction limit,
the point moves with the node.

A ring acts on a smooth curve instead of the elements, so that the line slides smoothly past nodes.
The curve is the quadratic spline that is tangent to every element at its middle. The two half
elements at the ends are straight. The curve parameter u is measured in nodes: u = 3.5 is the middle
of the element after node 3. A ring is a stiff spring to the nearest point of the curve. The force
of the ring is normal to the curve, without friction.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from labpipe.mechanics.law.plays import require, require_not_negative, require_positive
from labpipe.mechanics.law.sliders import SLIP_TOLERANCE
from labpipe.mechanics.rod import rotations
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, Ints
from labpipe.units import GRAVITY

EARTH = (0.0, 0.0, -GRAVITY)
"""Gravitational acceleration of the earth, m/s^2."""


def _read_path(name: str, values: object, width: int) -> Floats:
    """Return a path as a read-only array of rows; refuse another width and non-finite numbers."""
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


def _read_direction(name: str, values: object) -> Floats:
    """Return a constant vector as a read-only unit vector; refuse a path and a zero vector."""
    vector = _read_path(name, values, 3)
    norm = float(np.linalg.norm(vector[0]))
    is_direction = len(vector) == 1 and norm > 0.0
    require(name, np.asarray(values).tolist(), "a direction, not zero", holds=is_direction)
    unit_vector: Floats = vector[0] / norm
    unit_vector.flags.writeable = False
    return unit_vector


def _set_fields(record: object, **values: object) -> None:
    """Set fields of a frozen record."""
    for name, value in values.items():
        object.__setattr__(record, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """Clamp or pin at a node, which may move and may release the line.

    Parameters
    ----------
    node : node from 0; negative numbers count from the end of the line, as in Python
    position : shape (steps + 1, 3), m, path of the node
    frame : shape (steps + 1, 4), unit quaternions, path of the frame to which the elements at the
        node are clamped, with d3 along the line; None for a pin, at which the line rotates freely
    release : first step without the boundary, which is removed in one step; None if it never
        releases the line
    name : name in messages

    Raises
    ------
    ValueError
        If a path has another shape or is not finite, a quaternion is not of length one, or
        `release` is below 1.
    """

    node: int
    position: Floats
    frame: Floats | None = None
    release: int | None = None
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, position=_read_path("position", self.position, 3))
        if self.frame is not None:
            frame, max_error = _read_path("frame", self.frame, 4), 1e-6
            if np.max(np.abs(np.linalg.norm(frame, axis=1) - 1.0)) > max_error:
                raise ValueError(format_sentence("mechanics.rod.not_unit", name="frame"))
            _set_fields(self, frame=frame)
        require("release", self.release, ">= 1", holds=self.release is None or self.release >= 1)


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """Frictionless ring through which the line slides.

    Parameters
    ----------
    position : shape (steps + 1, 3), m, path of the centre
    direction : shape (3,), axis of the ring, for figures only
    name : name in messages

    Raises
    ------
    ValueError
        If a vector has another shape or is not finite, or the direction is zero.
    """

    position: Floats
    direction: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    name: str = ""

    def __post_init__(self) -> None:
        position = _read_path("position", self.position, 3)
        _set_fields(self, position=position, direction=_read_direction("direction", self.direction))


@dataclass(frozen=True, slots=True, eq=False)
class String:
    """Weightless string from a node to an anchor, which is taut or slack.

    Parameters
    ----------
    node : node from 0, or negative from the end of the line
    anchor : shape (steps + 1, 3), m, path of the anchor
    length : m, constant length of the string
    name : name in messages

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
        _set_fields(self, anchor=_read_path("anchor", self.anchor, 3))
        require_positive("length", self.length)


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """Force on a node. The force keeps its direction in space when the line moves.

    Parameters
    ----------
    node : node from 0, or negative from the end of the line
    force : shape (steps + 1, 3), N, path of the force
    name : name in messages
    """

    node: int
    force: Floats
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, force=_read_path("force", self.force, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Plane with Coulomb friction, on one side of which the line stays.

    The axis of the line stays half a diameter above the plane. Friction acts on the axis.

    Parameters
    ----------
    point : shape (3,), m, a point of the plane
    normal : shape (3,), normal towards the side of the line
    friction : friction coefficient, >= 0
    name : name in messages

    Raises
    ------
    ValueError
        If a vector has another shape or is not finite, the normal is zero, or the friction is
        negative.
    """

    point: Floats
    normal: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    friction: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        point = _read_path("point", [self.point], 3)[0]  # a path of points has another shape
        _set_fields(self, point=point, normal=_read_direction("normal", self.normal))
        require_not_negative("friction", self.friction)

    def shift(self, height: float) -> Plane:
        """Return the plane shifted along its normal by a height, m."""
        return replace(self, point=self.point + height * self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class Gravity:
    """Gravity, which acts on the mass of the whole line.

    Parameters
    ----------
    vector : shape (steps + 1, 3), m/s^2, path of the acceleration; by default that of the earth
    name : name in messages
    """

    vector: Floats = field(default_factory=lambda: np.array(EARTH))
    name: str = ""

    def __post_init__(self) -> None:
        _set_fields(self, vector=_read_path("vector", self.vector, 3))


Boundary: TypeAlias = Held | Ring | String | Load | Plane | Gravity
"""Boundary of a line."""


def list_paths(boundary: Boundary) -> dict[str, Floats]:
    """List the paths of a boundary, keyed by the names of their fields.

    Parameters
    ----------
    boundary : boundary of a line
    """
    names = "position", "frame", "anchor", "force", "vector"
    paths = ((name, getattr(boundary, name, None)) for name in names)
    return {name: path for name, path in paths if path is not None}


def resample(boundary: Boundary, times: Floats) -> Boundary:
    """Resample the paths of a boundary.

    Parameters
    ----------
    boundary : boundary of a line
    times : shape (new steps + 1,), times of the new steps, counted in old steps; multiples of 1/2
    """
    changes: dict[str, object] = {}
    rows_before, rows_after = np.floor(times).astype(int), np.ceil(times).astype(int)
    for name, path in list_paths(boundary).items():
        if len(path) > 1:
            new_path = 0.5 * (path[rows_before] + path[rows_after])
            changes[name] = rotations.normalise(new_path) if name == "frame" else new_path
    if isinstance(boundary, Held) and boundary.release is not None:
        changes["release"] = int(np.searchsorted(times, boundary.release - 1, side="right"))
    return replace(boundary, **changes)  # type: ignore[arg-type]


_IDENTITY = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneContact:
    """Contact of the nodes of a line with a plane.

    Parameters
    ----------
    forces : shape (nodes, 3), N, forces of the plane on the nodes
    stiffness : shape (nodes, 3, 3), N/m, derivative of minus the force with respect to the position
    friction_coupling : shape (nodes, 3, 3), N/m, part of `stiffness` from the increase of friction
        with pressure. It has no potential, and stability is checked without it
    points : shape (nodes, 3), m, points of the plane at which the nodes stick
    """

    forces: Floats
    stiffness: Floats
    friction_coupling: Floats
    points: Floats


def compute_plane_contact(
    plane: Plane, stiffness: float, positions: Floats, previous_points: Floats, *, max_gap: float
) -> PlaneContact:
    """Compute the contact of nodes with a plane.

    Parameters
    ----------
    plane : plane that the nodes may touch
    stiffness : N/m, stiffness of the contact of a node
    positions : shape (nodes, 3), m, positions of the nodes
    previous_points : shape (nodes, 3), m, points at which the nodes stuck before the step
    max_gap : m, gap up to which a node counts as touching, without force
    """
    normal = plane.normal
    indentation = -(positions - plane.point) @ normal
    pressure = stiffness * np.maximum(indentation, 0.0)
    is_touching = indentation >= -max_gap
    tangent = np.where(is_touching, stiffness, 0.0)[:, None, None] * np.outer(normal, normal)
    forces = pressure[:, None] * normal
    projection = _IDENTITY - np.outer(normal, normal)
    offset = (positions - previous_points) @ projection
    distance = np.linalg.norm(offset, axis=1)
    max_offset = plane.friction * pressure / stiffness
    is_sliding = distance > (1.0 + SLIP_TOLERANCE) * max_offset
    divisor = np.where(distance > 0.0, distance, 1.0)
    elastic_fraction = np.where(is_sliding, max_offset / divisor, 1.0)
    elastic_fraction = np.where(is_touching, elastic_fraction, 0.0)
    elastic_offset = elastic_fraction[:, None] * offset
    friction_coupling = np.zeros_like(tangent)
    if plane.friction > 0.0:
        forces = forces - stiffness * elastic_offset
        inverse_distance = np.where(is_sliding & is_touching, 1.0 / divisor, 0.0)
        slip_direction = inverse_distance[:, None] * offset  # zero at a node that sticks
        elastic_projection = projection - slip_direction[:, :, None] * slip_direction[:, None, :]
        tangent = tangent + stiffness * elastic_fraction[:, None, None] * elastic_projection
        friction_coupling = -stiffness * plane.friction * slip_direction[:, :, None] * normal
        tangent = tangent + friction_coupling
    return PlaneContact(forces, tangent, friction_coupling, positions - elastic_offset)


def compute_string_forces(
    anchors: Floats, lengths: Floats, stiffness: float, positions: Floats
) -> tuple[Floats, Floats]:
    """Compute the forces of strings on their nodes.

    Parameters
    ----------
    anchors : shape (strings, 3), m, positions of the anchors
    lengths : shape (strings,), m, lengths of the strings
    stiffness : N/m, stiffness of a taut string
    positions : shape (strings, 3), m, positions of the nodes

    Returns
    -------
    Forces, shape (strings, 3), N, and the derivatives of minus the forces with respect to the
    positions, shape (strings, 3, 3), N/m.
    """
    offsets = anchors - positions
    distance = np.linalg.norm(offsets, axis=1)
    divisor = np.where(distance > 0.0, distance, 1.0)
    direction = offsets / divisor[:, None]
    tension = stiffness * np.maximum(distance - lengths, 0.0)
    projection = direction[:, :, None] * direction[:, None, :]
    axial_stiffness = np.where(tension > 0.0, stiffness, 0.0)[:, None, None]
    lateral_stiffness = (tension / divisor)[:, None, None]
    tangent = axial_stiffness * projection + lateral_stiffness * (_IDENTITY - projection)
    return tension[:, None] * direction, tangent


def sum_at_nodes(nodes: Ints, values: Floats, n_nodes: int) -> Floats:
    """Sum the values, shape (n, ...), of each node or element, shape (n_nodes, ...)."""
    sums = np.zeros((n_nodes, *values.shape[1:]))
    np.add.at(sums, nodes, values)
    return sums


@dataclass(frozen=True, slots=True, eq=False)
class RingContact:
    """Contact of a line with a ring.

    Parameters
    ----------
    parameter : curve parameter u of the point nearest to the ring
    first_node : first of the three successive nodes that carry the force
    weights : shape (3,), weights of these nodes in the position of that point
    force : shape (3,), N, force of the ring on the line
    stiffness : shape (3, 3, 3, 3), N/m, derivative of minus the force on a node (axes 0 and 1) with
        respect to the position of a node (axes 2 and 3)
    """

    parameter: float
    first_node: int
    weights: Floats
    force: Floats
    stiffness: Floats


def compute_ring_contact(
    positions: Floats, ring: Floats, previous_u: float, stiffness: float
) -> RingContact:
    """Compute the point at which a line passes through a ring, and the force of the ring.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, positions of the nodes; n >= 2
    ring : shape (3,), m, position of the ring
    previous_u : previous curve parameter u of the point
    stiffness : N/m, stiffness of the contact
    """
    u = find_nearest_parameter(positions, ring, previous_u)
    first_node, weights, first_derivatives, _ = _compute_weights(u, len(positions))
    offset, slope, convexity = _expand_distance(positions, ring, u)
    mixed = weights[:, None] * slope + first_derivatives[:, None] * offset
    tangent = np.einsum("i,j,xy->ixjy", weights, weights, _IDENTITY)
    if 0.0 < u < len(positions) - 1:
        tangent -= np.einsum("ix,jy->ixjy", mixed, mixed) / convexity
    return RingContact(u, first_node, weights, -stiffness * offset, stiffness=stiffness * tangent)


def evaluate_curve(positions: Floats, u: float) -> Floats:
    """Evaluate the curve at the parameter u, shape (3,), m."""
    first_node, weights, _, _ = _compute_weights(u, len(positions))
    return np.asarray(weights @ positions[first_node : first_node + 3])


def _expand_distance(positions: Floats, ring: Floats, u: float) -> tuple[Floats, Floats, float]:
    """Compute the offset of a curve point from a ring, m, the slope of the curve, and a convexity.

    The convexity is the second derivative of half the squared distance with respect to u, kept
    positive.
    """
    first_node, weights, first_derivatives, second_derivatives = _compute_weights(u, len(positions))
    nodes = positions[first_node : first_node + 3]
    offset = weights @ nodes - ring
    slope, slope_change = first_derivatives @ nodes, second_derivatives @ nodes
    squared_slope = float(slope @ slope)
    return offset, slope, squared_slope + max(float(offset @ slope_change), -0.5 * squared_slope)


def _compute_weights(u: float, n_nodes: int) -> tuple[int, Floats, Floats, Floats]:
    """Compute the first of three nodes, their weights, and the derivatives of the weights."""
    node = int(np.clip(np.floor(u + 0.5), 1, n_nodes - 2))
    t = u - node + 0.5
    zeros = np.zeros(3)
    if t < 0.0:  # the first half element is straight
        v = u - (node - 1)
        return node - 1, np.array([1.0 - v, v, 0.0]), np.array([-1.0, 1.0, 0.0]), zeros
    if t > 1.0:
        v = u - node
        return node - 1, np.array([0.0, 1.0 - v, v]), np.array([0.0, -1.0, 1.0]), zeros
    weights = np.array([0.5 * (1.0 - t) ** 2, 0.5 + t * (1.0 - t), 0.5 * t**2])
    return node - 1, weights, np.array([t - 1.0, 1.0 - 2.0 * t, t]), np.array([1.0, -2.0, 1.0])


def find_nearest_parameter(positions: Floats, ring: Floats, previous_u: float) -> float:
    """Find the curve parameter u of the point nearest to a ring, near the previous parameter."""
    n_candidates, max_iterations = 25, 30
    max_distance = 1.5  # from the previous parameter, nodes
    max_change, tolerance = 0.1, 1e-14  # of the parameter in an iteration, and at convergence
    last_u = float(len(positions) - 1)
    lower, upper = max(previous_u - max_distance, 0.0), min(previous_u + max_distance, last_u)
    candidates = np.linspace(lower, upper, n_candidates)
    distances = [float(np.sum((evaluate_curve(positions, u) - ring) ** 2)) for u in candidates]
    u = float(candidates[int(np.argmin(distances))])
    for _ in range(max_iterations):
        offset, slope, convexity = _expand_distance(positions, ring, u)
        change = float(np.clip(-(offset @ slope) / convexity, -max_change, max_change))
        u = float(np.clip(u + change, 0.0, last_u))
        if abs(change) < tolerance:
            break
    return u
