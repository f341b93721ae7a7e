"""A line to be laid: section, elements, start shape and shape at rest.

n elements join n + 1 nodes. Each element is straight and carries a frame whose third axis d3 points
along it; the first two are material directions across. The law of bending acts at the nodes, over
the half elements on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.law.sliders import SliderLaw
from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.rod.rotations import (
    conjugate,
    frame_from_axes,
    from_rotation_vectors,
    multiply,
    rotation_vectors,
    shortest_turns,
    unit,
)


@dataclass(frozen=True, slots=True)
class Section:
    """Section of a line, constant along it.

    Parameters
    ----------
    law : moment against curvature with its sliders, isotropic
    torsional_stiffness : GJ at fixed length, N m^2
    axial_stiffness : EA at fixed twist, N; infinite for an inextensible line
    coupling : stretch-twist coupling C, N m, positive for a positive lay (PHYSICS 9); has no effect
        on an inextensible line
    mass_per_length : kg/m
    diameter : outer, m; 0 if unknown

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
            message = (
                "law: found neither a stiffness nor sliders; expected a line that resists bending"
            )
            raise ValueError(message)
        _require("torsional_stiffness", self.torsional_stiffness, self.torsional_stiffness > 0.0)
        if not self.axial_stiffness > 0.0:
            message = f"axial_stiffness={self.axial_stiffness!r}: allowed are numbers > 0"
            raise ValueError(message)
        _require("mass_per_length", self.mass_per_length, self.mass_per_length >= 0.0)
        _require("diameter", self.diameter, self.diameter >= 0.0)
        most = np.sqrt(self.axial_stiffness * self.torsional_stiffness)
        _require("coupling", self.coupling, abs(self.coupling) < most)


def _require(name: str, value: float, is_allowed: bool) -> None:
    if not (np.isfinite(value) and is_allowed):
        bounds = {
            "torsional_stiffness": "> 0",
            "coupling": "of magnitude below sqrt(axial_stiffness * torsional_stiffness)",
        }
        message = f"{name}={value!r}: allowed are finite numbers {bounds.get(name, '>= 0')}"
        raise ValueError(message)


@dataclass(frozen=True, slots=True, eq=False)
class Line(ArrayRecord):
    """A line of n elements before it is laid.

    Parameters
    ----------
    lengths : shape (n,), m, of the elements at rest
    section : of the line
    positions : shape (n + 1, 3), m, of the nodes to start from
    frames : shape (n, 4), unit quaternions (w, x, y, z) to start from; d3 is the direction
    natural : shape (n - 1, 3), 1/m, the curvature at rest of the inner nodes: two bendings and the
        twist, in the mean of the frames on both sides

    Raises
    ------
    ValueError
        If there is no element, a length is not positive, a number not finite, or a frame not of
        length one.
    """

    lengths: Annotated[Floats, "elements"]
    section: Section
    positions: Annotated[Floats, "nodes", 3]
    frames: Annotated[Floats, "elements", 4]
    natural: Annotated[Floats, "joints", 3]

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        n = len(self.lengths)
        if n < 1 or len(self.positions) != n + 1 or len(self.natural) != n - 1:
            message = (
                f"{n} elements, {len(self.positions)} nodes, {len(self.natural)} curvatures at "
                "rest: allowed are n >= 1 elements, n + 1 nodes, n - 1 curvatures"
            )
            raise ValueError(message)
        for name in ("lengths", "positions", "frames", "natural"):
            if not np.all(np.isfinite(getattr(self, name))):
                message = f"{name}: allowed are finite numbers"
                raise ValueError(message)
        if not np.all(self.lengths > 0.0):
            message = f"lengths={self.lengths.tolist()}: allowed are numbers > 0"
            raise ValueError(message)
        if np.max(np.abs(np.linalg.norm(self.frames, axis=1) - 1.0)) > 1e-6:
            message = "frames: allowed are quaternions of length 1"
            raise ValueError(message)

    @property
    def length(self) -> float:
        """Return the length at rest, m."""
        return float(np.sum(self.lengths))

    @property
    def natural_at_nodes(self) -> Floats:
        """Return the curvature at rest of all nodes, 1/m, shape (n + 1, 3); ends as neighbours."""
        if not len(self.natural):
            return np.zeros((len(self.positions), 3))
        return np.concatenate([self.natural[:1], self.natural, self.natural[-1:]])

    def frame_at(self, node: int) -> Floats:
        """Return the frame, shape (4,), of a clamp at a node that leaves the line undeformed.

        Parameters
        ----------
        node : from 0, or negative from the end
        """
        n = len(self.lengths)
        at = node % (n + 1)
        if at == 0:
            back = -0.5 * self.lengths[0] * self.natural_at_nodes[0]
            return multiply(self.frames[0], from_rotation_vectors(back))
        lower = 0.5 * self.lengths[at - 1]
        if at == n:
            turn = lower * self.natural_at_nodes[n]
        else:
            both = lower + 0.5 * self.lengths[at]
            whole = rotation_vectors(multiply(conjugate(self.frames[at - 1]), self.frames[at]))
            turn = lower / both * whole
        return multiply(self.frames[at - 1], from_rotation_vectors(turn))

    @property
    def stations(self) -> Floats:
        """Return the arc length of the nodes at rest, m, shape (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.lengths)])


def line_along(
    positions: Floats,
    section: Section,
    *,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    is_formed: bool = False,
) -> Line:
    """Return a line through points, its nodes, without twist.

    Parameters
    ----------
    positions : shape (n + 1, 3), m
    section : of the line
    up : d1 of the first frame is as near to it as possible; the others follow without twist
    is_formed : whether this is the shape at rest, as of a line with a set from its spool; else the
        line is straight at rest and must be bent to these points

    Raises
    ------
    ValueError
        As `Line`; if two points that follow one another are the same, or `up` is along the first
        element.

    Notes
    -----
    Each frame follows from the one before by the smallest rotation. On a closed curve in
    space, d1 of the last frame therefore differs from d1 of the first by the holonomy angle.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2:
        message = f"positions of shape {points.shape}: allowed is (n + 1, 3), n >= 1"
        raise ValueError(message)
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if not np.all(lengths > 0.0):
        at = int(np.argmin(lengths > 0.0))
        message = f"positions {at} and {at + 1}: allowed are different points"
        raise ValueError(message)
    directions = steps / lengths[:, None]
    turns = shortest_turns(directions[:-1], directions[1:])
    frames = [frame_from_axes(directions[0], np.asarray(up))]
    for turn in turns:
        frames.append(unit(multiply(turn, frames[-1])))
    quaternions = np.array(frames)
    natural = np.zeros((len(lengths) - 1, 3))
    if is_formed:
        between = 0.5 * (lengths[1:] + lengths[:-1])
        turned = multiply(conjugate(quaternions[:-1]), quaternions[1:])
        natural = rotation_vectors(turned) / between[:, None]
    return Line(lengths, section, points, quaternions, natural)
