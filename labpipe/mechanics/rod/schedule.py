"""Compute the positions and forces that the boundaries impose on a line at any time.

Time is measured in steps: time k is step k, and time k - 1/2 is halfway to step k. From time -1 to
time 0, the line moves from its initial shape into its boundaries. Held nodes and rings move to row
0 of their paths, and weight and loads increase from zero to row 0 of their paths. Anchors of
strings are at row 0 from the start.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from labpipe.mechanics.rod.assembly import ImposedValues, Shape
from labpipe.mechanics.rod.boundaries import (
    Boundary,
    Gravity,
    Held,
    Load,
    Plane,
    Ring,
    String,
    evaluate_curve,
    find_nearest_parameter,
    list_paths,
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
    line : line with its elements
    boundaries : boundaries in the order of the caller
    n_steps : number of steps
    start_shape : initial shape

    Attributes
    ----------
    grips, strings, planes, rings, loads : boundaries of each type, keyed by their index
    held_nodes : node of each grip, from 0, keyed by the index of the boundary
    string_nodes : shape (strings,), nodes of the strings, from 0
    ring_parameters : shape (rings,), curve parameters u at which the initial line passes the rings

    Raises
    ------
    ValueError
        If a node is not on the line, a path has a wrong number of rows, two boundaries hold a node
        at the same time, or a line with a ring has a single element.
    """

    def __init__(
        self, line: Line, boundaries: tuple[Boundary, ...], n_steps: int, start_shape: Shape
    ) -> None:
        self.line, self.boundaries = line, boundaries
        self.n_steps, self.start_shape = n_steps, start_shape
        self.n = len(line.lengths)
        _require_rows(boundaries, n_steps)
        self.grips = _select(boundaries, Held)
        self.strings = _select(boundaries, String)
        self.planes = _select(boundaries, Plane)
        self.rings = _select(boundaries, Ring)
        self.loads = _select(boundaries, Load)
        self.held_nodes = {k: self._find_node(grip) for k, grip in self.grips.items()}
        string_nodes = [self._find_node(string) for string in self.strings.values()]
        self.string_nodes = np.array(string_nodes, dtype=int)
        parameters = [self._find_ring_parameter(ring) for ring in self.rings.values()]
        self.ring_parameters = np.array(parameters)
        self._require_single_grip()
        half_masses = 0.5 * line.section.mass_per_length * line.lengths
        self._masses = np.append(half_masses, 0.0) + np.append(0.0, half_masses)
        # All paths have a further first row for the initial shape, in which there are no forces.
        positions = start_shape.positions
        start_line = replace(line, positions=positions, frames=start_shape.frames)
        self._positions, self._frames = {}, {}
        for k, node in self.held_nodes.items():
            self._positions[k] = np.vstack([positions[node], self.grips[k].position])
            if (frames := self.grips[k].frame) is not None:
                self._frames[k] = np.vstack([start_line.compute_clamp_frame(node), frames])
        self._rings = [
            np.vstack([evaluate_curve(positions, parameter), ring.position])
            for ring, parameter in zip(self.rings.values(), self.ring_parameters, strict=True)
        ]
        self._anchors = [
            np.vstack([string.anchor[0], string.anchor]) for string in self.strings.values()
        ]
        # A force is the product of factors, shape (n + 1,), and a path: masses and gravity, or a
        # factor of 1 at the loaded node and its load.
        self._forces: list[tuple[Floats, Floats]] = []
        for gravity in _select(boundaries, Gravity).values():
            self._forces.append((self._masses, np.vstack([np.zeros(3), gravity.vector])))
        for load in self.loads.values():
            is_loaded = np.arange(self.n + 1) == self._find_node(load)
            self._forces.append((is_loaded.astype(float), np.vstack([np.zeros(3), load.force])))

    def _find_node(self, boundary: Held | String | Load) -> int:
        """Return the node of a boundary, counted from the start of the line."""
        node, n = boundary.node, self.n
        if not -n - 1 <= node <= n:
            label = format_boundary(self.boundaries, boundary)
            facts = {"boundary": label, "node": node, "n": n, "nodes": n + 1}
            raise ValueError(format_sentence("mechanics.rod.not_on_line", **facts))
        return int(node % (n + 1))

    def _find_ring_parameter(self, ring: Ring) -> float:
        """Find the curve parameter u at which the initial line passes through a ring."""
        if self.n < 2:
            name = format_boundary(self.boundaries, ring)
            raise ValueError(format_sentence("mechanics.rod.short_for_ring", boundary=name))
        positions, position = self.start_shape.positions, ring.position[0]
        nearest_node = float(np.argmin(np.linalg.norm(positions - position, axis=1)))
        return find_nearest_parameter(positions, position, nearest_node)

    def _require_single_grip(self) -> None:
        """Refuse two boundaries that hold a node at the same time."""
        for step in range(self.n_steps + 1):
            nodes = [self.held_nodes[k] for k in self.list_grips(step)]
            repeated_nodes = sorted(node for node in set(nodes) if nodes.count(node) > 1)
            if repeated_nodes:
                node = repeated_nodes[0]
                raise ValueError(format_sentence("mechanics.rod.held_twice", step=step, node=node))

    def list_grips(self, step: int) -> tuple[int, ...]:
        """List the indices of the boundaries that hold a node in a step."""
        return tuple(
            k for k, grip in self.grips.items() if grip.release is None or step < grip.release
        )

    def estimate_force(self) -> float:
        """Estimate the forces on the line by the sum of EI / L^2, weight and loads, N."""
        accelerations = [gravity.vector for gravity in _select(self.boundaries, Gravity).values()]
        mass = float(np.sum(self._masses))
        return (
            self.line.section.law.first_stiffness / self.line.length**2
            + sum(mass * _compute_max_magnitude(path) for path in accelerations)
            + sum(_compute_max_magnitude(load.force) for load in self.loads.values())
        )

    def compute_imposed_values(self, time: float, grips: tuple[int, ...]) -> ImposedValues:
        """Compute the imposed values at a time.

        Parameters
        ----------
        time : time in steps, from -1
        grips : indices of the boundaries that hold the line
        """
        forces = np.zeros((self.n + 1, 3))
        for node_factors, path in self._forces:
            forces += node_factors[:, None] * _interpolate(path, time)
        frames = [
            _interpolate(self._frames[k], time, is_frame=True) for k in grips if k in self._frames
        ]
        held_positions, anchors, rings = (
            np.array([_interpolate(path, time) for path in paths]).reshape(-1, 3)
            for paths in ([self._positions[k] for k in grips], self._anchors, self._rings)
        )
        clamp_frames = np.array(frames).reshape(-1, 4)
        return ImposedValues(held_positions, clamp_frames, forces, anchors, rings=rings, time=time)


def _select(boundaries: tuple[Boundary, ...], kind: type[T]) -> dict[int, T]:
    """Select the boundaries of a type, keyed by their index."""
    return {k: boundary for k, boundary in enumerate(boundaries) if isinstance(boundary, kind)}


def format_boundary(boundaries: tuple[Boundary, ...], boundary: Boundary) -> str:
    """Format the name of a boundary for messages."""
    k = next(i for i, candidate in enumerate(boundaries) if candidate is boundary)
    return boundary.name or f"boundary {k} ({type(boundary).__name__})"


def _compute_max_magnitude(path: Floats) -> float:
    """Compute the largest magnitude of the vectors of a path."""
    return float(np.max(np.linalg.norm(path, axis=1)))


def _interpolate(path: Floats, time: float, *, is_frame: bool = False) -> Floats:
    """Interpolate a path, whose first row is at time -1, with constant values after the end."""
    k = min(int(time + 1.0), len(path) - 1)
    start, end, fraction = path[k], path[min(k + 1, len(path) - 1)], time + 1.0 - k
    if not is_frame:
        return np.asarray(start + fraction * (end - start))
    turn = to_rotation_vectors(multiply(conjugate(start), end))
    return multiply(start, from_rotation_vectors(fraction * turn))


def _require_rows(boundaries: tuple[Boundary, ...], n_steps: int) -> None:
    """Refuse paths whose number of rows is neither one nor the number of steps plus one."""
    n_rows = n_steps + 1
    for boundary in boundaries:
        for name, path in list_paths(boundary).items():
            if len(path) not in (1, n_rows):
                label = format_boundary(boundaries, boundary)
                facts = {"boundary": label, "name": name, "rows": len(path), "expected": n_rows}
                raise ValueError(format_sentence("mechanics.rod.path_rows", **facts))
