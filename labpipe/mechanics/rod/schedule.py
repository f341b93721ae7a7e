"""Positions and forces that the boundaries impose on a line at any time.

Time is measured in steps: k is step k, and k - 1/2 is halfway to it. From -1 to 0 the line moves
from its shape at rest into its boundaries: held nodes and rings move to row 0 of their paths, and
weight and loads grow to row 0 of theirs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from labpipe.mechanics.rod.assembly import Demands, Shape
from labpipe.mechanics.rod.boundaries import (
    Boundary,
    Gravity,
    Held,
    Load,
    Plane,
    Ring,
    String,
    evaluate_curve,
    find_nearest_place,
)
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.rotations import (
    conjugate,
    from_rotation_vectors,
    multiply,
    to_rotation_vectors,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats

T = TypeVar("T")


class Schedule:
    """Boundaries of a line over time.

    Parameters
    ----------
    line : the line
    boundaries : in the order of the caller
    steps : number
    start : shape before the first step

    Raises
    ------
    ValueError
        If a node is not on the line, a path has a wrong number of rows, two boundaries hold a node
        at the same time, or a line with a ring has a single element.
    """

    def __init__(
        self, line: Line, boundaries: tuple[Boundary, ...], steps: int, start: Shape
    ) -> None:
        self.line, self.boundaries, self.steps, self.start = line, boundaries, steps, start
        self.n = len(line.lengths)
        _require_rows(boundaries, steps)
        self.held = self._of(Held)
        self.strings = self._of(String)
        self.planes = self._of(Plane)
        self.rings = self._of(Ring)
        self.held_nodes = {k: self.node(boundaries[k]) for k in self.held}
        self.string_nodes = np.array([self.node(boundaries[k]) for k in self.strings], dtype=int)
        for k in self._of(Load):
            self.node(boundaries[k])
        self.start_places = np.array([self._ring_start(self._get(Ring, k)) for k in self.rings])
        self._require_one_each()
        start_line = replace(line, positions=start.positions, frames=start.frames)
        self._start_frames = {k: start_line.frame_at(node) for k, node in self.held_nodes.items()}
        halves = 0.5 * line.section.mass_per_length * line.lengths
        self._masses = np.append(halves, 0.0) + np.append(0.0, halves)

    def _of(self, boundary_type: type) -> tuple[int, ...]:
        return tuple(
            k for k, boundary in enumerate(self.boundaries) if isinstance(boundary, boundary_type)
        )

    def node(self, boundary: Boundary) -> int:
        """Return the node of a boundary, from 0."""
        return self._from_zero(boundary, "node")

    def _from_zero(self, boundary: Boundary, name: str) -> int:
        """Return the node in a field of a boundary, counted from the start."""
        node, n = getattr(boundary, name), self.n
        if not -n - 1 <= node <= n:
            which = get_boundary_name(self.boundaries, boundary)
            message = format_sentence(
                "mechanics.rod.not_on_line", boundary=which, name=name, node=node, n=n, nodes=n + 1
            )
            raise ValueError(message)
        return int(node % (n + 1))

    def _ring_start(self, ring: Ring) -> float:
        """Return the place at which the line passes through a ring at the start, in nodes."""
        if self.n < 2:
            name = get_boundary_name(self.boundaries, ring)
            raise ValueError(format_sentence("mechanics.rod.short_for_ring", boundary=name))
        distance = np.linalg.norm(self.start.positions - ring.position[0], axis=1)
        nearest_node = np.argmin(distance) if ring.near is None else self._from_zero(ring, "near")
        return find_nearest_place(self.start.positions, ring.position[0], float(nearest_node))

    def _require_one_each(self) -> None:
        for step in range(self.steps + 1):
            nodes = [self.held_nodes[k] for k in self.grips(step)]
            held_twice = sorted(node for node in set(nodes) if nodes.count(node) > 1)
            if held_twice:
                node = held_twice[0]
                raise ValueError(format_sentence("mechanics.rod.held_twice", step=step, node=node))

    def grips(self, step: int) -> tuple[int, ...]:
        """Return the indices of the boundaries that hold a node in a step."""
        releases = ((k, self._get(Held, k).release) for k in self.held)
        return tuple(k for k, release in releases if release is None or step < release)

    def is_clamp(self, k: int) -> bool:
        """Return whether a boundary holds the frame of its node as well."""
        return self._get(Held, k).frame is not None

    def force_scale(self) -> float:
        """Return the magnitude of the forces on the whole line, N."""
        line = self.line
        size = line.section.law.first_stiffness / line.length**2
        for boundary in self.boundaries:
            if isinstance(boundary, Gravity):
                size += float(np.sum(self._masses)) * _find_largest(boundary.vector)
            elif isinstance(boundary, Load):
                size += _find_largest(boundary.force)
        return size

    def demands(self, time: float, grips: tuple[int, ...]) -> Demands:
        """Return the demands at a time.

        Parameters
        ----------
        time : in steps, from -1
        grips : indices of the boundaries that hold the line
        """
        share = min(1.0, time + 1.0)
        held_positions, clamps = self._places(time, share, grips)
        anchors = np.array(
            [_interpolate_path(self._get(String, k).anchor, time) for k in self.strings]
        )
        rings = self._ring_places(time, share)
        return Demands(
            held_positions, clamps, self._forces(time, share), anchors.reshape(-1, 3), rings
        )

    def _ring_places(self, time: float, share: float) -> Floats:
        """Return the positions of the rings, which at first move from the line to their paths."""
        places = [_interpolate_path(self._get(Ring, k).position, time) for k in self.rings]
        target_positions = np.array(places).reshape(-1, 3)
        if share < 1.0:
            starts = [evaluate_curve(self.start.positions, u) for u in self.start_places]
            target_positions = share * target_positions + (1.0 - share) * np.array(starts).reshape(
                -1, 3
            )
        return target_positions

    def _forces(self, time: float, share: float) -> Floats:
        forces = np.zeros((self.n + 1, 3))
        for boundary in self.boundaries:
            if isinstance(boundary, Gravity):
                forces += share * self._masses[:, None] * _interpolate_path(boundary.vector, time)
            elif isinstance(boundary, Load):
                forces[self.node(boundary)] += share * _interpolate_path(boundary.force, time)
        return forces

    def _places(self, time: float, share: float, grips: tuple[int, ...]) -> tuple[Floats, Floats]:
        held_positions = np.zeros((len(grips), 3))
        clamps = []
        for row, k in enumerate(grips):
            grip, node = self._get(Held, k), self.held_nodes[k]
            target_position = _interpolate_path(grip.position, time)
            held_positions[row] = (
                share * target_position + (1.0 - share) * self.start.positions[node]
            )
            if grip.frame is not None:
                frame = _interpolate_frame_path(grip.frame, time)
                if share < 1.0:
                    frame = _interpolate_frames(self._start_frames[k], frame, share)
                clamps.append(frame)
        return held_positions, np.array(clamps).reshape(-1, 4)

    def _get(self, boundary_type: type[T], k: int) -> T:
        boundary = self.boundaries[k]
        assert isinstance(boundary, boundary_type)
        return boundary


def get_boundary_name(boundaries: tuple[Boundary, ...], boundary: Boundary) -> str:
    """Return the name of a boundary for messages."""
    k = next(i for i, candidate in enumerate(boundaries) if candidate is boundary)
    return boundary.name or f"boundary {k} ({type(boundary).__name__})"


def _find_largest(path: Floats) -> float:
    return float(np.max(np.linalg.norm(path, axis=1)))


def _interpolate_path(path: Floats, time: float) -> Floats:
    """Interpolate a path at a time."""
    if len(path) == 1 or time <= 0.0:
        return np.asarray(path[0])
    k = min(int(time), len(path) - 2)
    return np.asarray(path[k] + (time - k) * (path[k + 1] - path[k]))


def _interpolate_frame_path(path: Floats, time: float) -> Floats:
    if len(path) == 1 or time <= 0.0:
        return np.asarray(path[0])
    k = min(int(time), len(path) - 2)
    return _interpolate_frames(path[k], path[k + 1], time - k)


def _interpolate_frames(first: Floats, second: Floats, share: float) -> Floats:
    turn = to_rotation_vectors(multiply(conjugate(first), second))
    return multiply(first, from_rotation_vectors(share * turn))


def _require_rows(boundaries: tuple[Boundary, ...], steps: int) -> None:
    names = ("position", "frame", "anchor", "force", "vector")
    for boundary in boundaries:
        for name in names:
            path = getattr(boundary, name, None)
            if path is None or path.ndim != 2 or len(path) in (1, steps + 1):
                continue
            which, rows = get_boundary_name(boundaries, boundary), len(path)
            message = format_sentence(
                "mechanics.rod.path_rows", boundary=which, name=name, rows=rows, expected=steps + 1
            )
            raise ValueError(message)
