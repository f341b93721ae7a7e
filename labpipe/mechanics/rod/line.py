"""Define a line, a discrete rod: section, elements, initial shape, and curvature at rest.

n elements connect n + 1 nodes. Each element is straight and has a frame. The third axis d3 of the
frame points along the element, and the other two are material directions normal to the element. The
bending law acts at each inner node, over half an element on each side, and at a clamped end, over
the half element beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from labpipe.mechanics.law.plays import require, require_not_negative, require_positive
from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.rod.rotations import (
    build_frame,
    compute_shortest_rotations,
    conjugate,
    from_rotation_vectors,
    multiply,
    normalise,
    to_rotation_vectors,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats

_Z_AXIS = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Section:
    """Cross-section, constant along the line.

    Parameters
    ----------
    law : bending law, the same in all directions normal to the axis
    torsional_stiffness : N m^2, GJ at fixed length
    axial_stiffness : N, EA at fixed twist; infinite for an inextensible line
    coupling : N m, stretch-twist coupling C, positive for positive lay angles; without effect on an
        inextensible line
    mass_per_length : kg/m
    diameter : m, outer diameter; 0 if unknown

    Raises
    ------
    ValueError
        If the law has no stiffness, the torsional or axial stiffness is not positive, mass or
        diameter is negative or infinite, or the coupling is not below sqrt(EA GJ) in magnitude.
    """

    law: SliderLaw
    torsional_stiffness: float
    axial_stiffness: float = np.inf
    coupling: float = 0.0
    mass_per_length: float = 0.0
    diameter: float = 0.0

    def __post_init__(self) -> None:
        if not self.law.first_stiffness > 0.0:
            raise ValueError(format_sentence("mechanics.rod.no_stiffness"))
        require_positive("torsional_stiffness", self.torsional_stiffness)
        axial_stiffness, coupling = self.axial_stiffness, self.coupling
        require("axial_stiffness", axial_stiffness, "> 0", holds=axial_stiffness > 0.0)
        require_not_negative("mass_per_length", self.mass_per_length)
        require_not_negative("diameter", self.diameter)
        condition = "finite and of magnitude below sqrt(axial_stiffness * torsional_stiffness)"
        is_definite = abs(coupling) < np.sqrt(axial_stiffness * self.torsional_stiffness)
        require("coupling", coupling, condition, holds=np.isfinite(coupling) and is_definite)


@dataclass(frozen=True, slots=True, eq=False)
class Line(ArrayRecord):
    """Line of n elements before boundaries are applied; see `build_line`.

    Parameters
    ----------
    lengths : shape (n,), m, lengths of the elements at rest
    section : section of the line
    positions : shape (n + 1, 3), m, initial positions of the nodes
    frames : shape (n, 4), initial unit quaternions (w, x, y, z), which rotate x, y, z to d1, d2, d3
    rest_curvature : shape (n - 1, 3), 1/m, curvature at rest at the inner nodes: two bending
        components and the twist, in the mean of the two adjacent frames
    """

    lengths: Annotated[Floats, "elements"]
    section: Section
    positions: Annotated[Floats, "nodes", 3]
    frames: Annotated[Floats, "elements", 4]
    rest_curvature: Annotated[Floats, "joints", 3]

    @property
    def length(self) -> float:
        """Return the length at rest, m."""
        return float(np.sum(self.lengths))

    @property
    def rest_curvature_at_nodes(self) -> Floats:
        """Return the curvature at rest at all nodes, 1/m, shape (n + 1, 3).

        At an end, the value is that of the nearest inner node. A line of one element has zeros.
        """
        inner_curvature = self.rest_curvature
        if not len(inner_curvature):
            return np.zeros((len(self.positions), 3))
        return np.concatenate([inner_curvature[:1], inner_curvature, inner_curvature[-1:]])

    def compute_clamp_frame(self, node: int) -> Floats:
        """Compute the frame of a clamp that holds a node of the initial line, shape (4,).

        Such a clamp does not bend or twist the line.

        Parameters
        ----------
        node : index of the node, from 0; -1 is the last node
        """
        index = node % len(self.positions)
        curvature = self.rest_curvature_at_nodes[index]
        if 0 < index < len(self.lengths):
            frame_before, frame_after = self.frames[index - 1 : index + 1]
            centre_distance = 0.5 * float(np.sum(self.lengths[index - 1 : index + 1]))
            rotation = multiply(conjugate(frame_before), frame_after)
            curvature = to_rotation_vectors(rotation) / centre_distance
        element = max(index - 1, 0)
        # Distance along d3 from the middle of the element to the node.
        distance = (0.5 if index else -0.5) * self.lengths[element]
        return multiply(self.frames[element], from_rotation_vectors(distance * curvature))

    @property
    def stations(self) -> Floats:
        """Return the arc length of the nodes at rest, m, shape (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)])

    def describe_position(self, node: int) -> str:
        """Describe the position of a node, counted from 0, for messages."""
        return format_position(float(self.stations[node]))


def format_position(station: float) -> str:
    """Format a position on a line, given as arc length from the start, m."""
    return f"{1e3 * station:.4g} mm from the start"


def build_line(
    positions: Floats, section: Section, *, up: ArrayLike = _Z_AXIS, is_rest_shape: bool = False
) -> Line:
    """Build a line without twist from the positions of its nodes.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, positions of the nodes
    section : section of the line
    up : shape (3,), direction; d1 of the first frame is the nearest normal of the first element
    is_rest_shape : True if the positions are the shape at rest, for example of a line curled by its
        spool; False for a line that is straight at rest and is bent to these positions

    Raises
    ------
    ValueError
        If `positions` is not an array of shape (n + 1, 3) with n >= 1, successive positions
        coincide or are not finite, or `up` is zero or parallel to the first element.

    Notes
    -----
    Each frame is the previous frame after the smallest possible rotation. If the last
    element has the direction of the first, d1 of the last frame therefore differs from d1 of the
    first by the holonomy angle of the directions.
    """
    positions = np.asarray(positions, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1:] != (3,) or len(positions) < 2:
        raise ValueError(format_sentence("mechanics.rod.points_shape", shape=positions.shape))
    edges = np.diff(positions, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    if len(faulty_edges := np.flatnonzero(~((lengths > 0.0) & np.isfinite(lengths)))):
        node = int(faulty_edges[0])
        raise ValueError(format_sentence("mechanics.rod.same_points", first=node, second=node + 1))
    directions = edges / lengths[:, None]
    frame_list = [build_frame(directions[0], np.asarray(up))]
    for rotation in compute_shortest_rotations(directions[:-1], directions[1:]):
        frame_list.append(normalise(multiply(rotation, frame_list[-1])))
    frames = np.array(frame_list)
    rest_curvature = np.zeros((len(lengths) - 1, 3))
    if is_rest_shape:
        centre_distances = 0.5 * (lengths[1:] + lengths[:-1])
        frame_rotations = multiply(conjugate(frames[:-1]), frames[1:])
        rest_curvature = to_rotation_vectors(frame_rotations) / centre_distances[:, None]
    return Line(lengths, section, positions, frames, rest_curvature=rest_curvature)
