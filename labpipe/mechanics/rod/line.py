"""Define a discrete line: section, elements, initial shape, and curvature at rest.

n elements connect n + 1 nodes. Each element is straight and has a frame. The third axis d3 of the
frame points along the element, and the other two are material directions normal to it. The law of
bending acts at the nodes, over the half elements on both sides.
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
    conjugate,
    find_shortest_turns,
    from_rotation_vectors,
    multiply,
    to_rotation_vectors,
    unit,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats


@dataclass(frozen=True, slots=True)
class Section:
    """Section of a line, constant along it.

    Parameters
    ----------
    law : isotropic bending law
    torsional_stiffness : N m^2, GJ at fixed length
    axial_stiffness : N, EA at fixed twist; infinite for an inextensible line
    coupling : N m, stretch-twist coupling C, positive for positive lay angles; without effect on an
        inextensible line
    mass_per_length : kg/m
    diameter : m, outer diameter; 0 if unknown

    Raises
    ------
    ValueError
        If a number is out of its range, or the line has no stiffness.
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
        axial, coupling = self.axial_stiffness, self.coupling
        require("axial_stiffness", axial, "> 0", holds=axial > 0.0)
        require_not_negative("mass_per_length", self.mass_per_length)
        require_not_negative("diameter", self.diameter)
        bound = "finite and of magnitude below sqrt(axial_stiffness * torsional_stiffness)"
        is_small = abs(coupling) < np.sqrt(axial * self.torsional_stiffness)
        require("coupling", coupling, bound, holds=np.isfinite(coupling) and is_small)


@dataclass(frozen=True, slots=True, eq=False)
class Line(ArrayRecord):
    """A line of n elements before it is bent by its boundaries; see `build_line`.

    Parameters
    ----------
    lengths : shape (n,), m, lengths of the elements at rest
    section : section of the line
    positions : shape (n + 1, 3), m, initial positions of the nodes
    frames : shape (n, 4), initial unit quaternions (w, x, y, z), which rotate x, y, z to d1, d2, d3
    rest_curvature : shape (n - 1, 3), 1/m, curvature at rest at the inner nodes: two bending
        components and the twist, in the mean of the frames on both sides
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
        """Return the curvature at rest of all nodes, 1/m, shape (n + 1, 3).

        The curvature at an end is that of the neighbouring node. It is zero for a line of one
        element.
        """
        if not len(self.rest_curvature):
            return np.zeros((len(self.positions), 3))
        return np.concatenate(
            [self.rest_curvature[:1], self.rest_curvature, self.rest_curvature[-1:]]
        )

    def get_frame(self, node: int) -> Floats:
        """Return the frame with which a clamp at a node leaves the line unchanged, shape (4,).

        Parameters
        ----------
        node : node from 0, or negative from the end of the line
        """
        index = node % len(self.positions)
        curvature = self.rest_curvature_at_nodes[index]
        if 0 < index < len(self.lengths):
            before, after = self.frames[index - 1 : index + 1]
            centre_distance = 0.5 * float(np.sum(self.lengths[index - 1 : index + 1]))
            curvature = to_rotation_vectors(multiply(conjugate(before), after)) / centre_distance
        element = max(index - 1, 0)
        distance = (0.5 if index else -0.5) * self.lengths[element]  # from its middle to the node
        return multiply(self.frames[element], from_rotation_vectors(distance * curvature))

    @property
    def stations(self) -> Floats:
        """Return the arc length of the nodes at rest, m, shape (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)])

    def describe_place(self, node: int) -> str:
        """Describe the position of a node, counted from 0, for messages."""
        return format_place(float(self.stations[node]))


def format_place(station: float) -> str:
    """Format a position on a line, given as arc length from the start, m."""
    return f"{1e3 * station:.4g} mm from the start"


def build_line(
    positions: Floats, section: Section, *, up: ArrayLike = (0.0, 0.0, 1.0), is_formed: bool = False
) -> Line:
    """Build a line without twist from the positions of its nodes.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, positions of the nodes
    section : section of the line
    up : shape (3,), direction that d1 of the first frame approaches as closely as possible
    is_formed : True if the points are the shape at rest, for example of a line curled by its spool;
        False for a line that is straight at rest and is bent to these points

    Raises
    ------
    ValueError
        If there are fewer than two points, successive points coincide or are not finite, or `up` is
        parallel to the first element.

    Notes
    -----
    Each frame is the previous frame after the smallest possible rotation. On a closed curve in
    space, d1 of the last frame therefore differs from d1 of the first frame by the holonomy angle
    of the curve.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2:
        raise ValueError(format_sentence("mechanics.rod.points_shape", shape=points.shape))
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if not np.all(lengths > 0.0):
        index = int(np.argmin(lengths > 0.0))
        raise ValueError(
            format_sentence("mechanics.rod.same_points", first=index, second=index + 1)
        )
    directions = steps / lengths[:, None]
    turns = find_shortest_turns(directions[:-1], directions[1:])
    frames = [build_frame(directions[0], np.asarray(up))]
    for turn in turns:
        frames.append(unit(multiply(turn, frames[-1])))
    quaternions = np.array(frames)
    rest_curvature = np.zeros((len(lengths) - 1, 3))
    if is_formed:
        centre_distances = 0.5 * (lengths[1:] + lengths[:-1])
        frame_rotations = multiply(conjugate(quaternions[:-1]), quaternions[1:])
        rest_curvature = to_rotation_vectors(frame_rotations) / centre_distances[:, None]
    return Line(lengths, section, points, quaternions, rest_curvature)
