"""Assemble residual and tangent of the equilibrium equations of a line, for Newton's method.

In equilibrium the sum over elements, cells and nodes

    sum f . (x_(e+1) - x_e - l (1 + eps) d) + l (EA eps^2 / 2 + C eps tau) + h W(kappa) - F . x

is stationary. An element of length l from x_e to x_(e+1) has the direction d, the stretch eps and
the force f. A cell, the two half elements beside a node, has the length h. F is the force at a
node. The first term is the stretch condition; its multiplier f is the force in the element. EA is
the axial stiffness, and C is the coupling of stretch and twist tau. W is the energy of bending and
twist per length; kappa has two bending components and the twist. If EA is infinite, eps is 0.
Frames q are updated by rotation vectors phi in body axes, q exp(phi / 2), so that the result does
not depend on the axes of space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.rod.banded import (
    BandedMatrix,
    UnknownIndices,
    join_unknowns,
    list_block_entries,
    split_unknowns,
)
from labpipe.mechanics.rod.boundaries import (
    Plane,
    PlaneContact,
    RingContact,
    compute_plane_contact,
    compute_ring_contact,
    compute_string_forces,
    sum_at_nodes,
)
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.rotations import (
    conjugate,
    cross,
    from_rotation_vectors,
    multiply,
    normalise,
    to_matrices,
    to_rotation_vectors,
)
from labpipe.mechanics.rod.supports import (
    BentCells,
    Directions,
    Supports,
    bend_cells,
    compute_clamp_directions,
    compute_directions,
)
from labpipe.records.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Shape of a line: the unknowns of Newton's method.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, positions of the nodes
    frames : shape (n, 4), unit quaternions of the elements
    stretches : shape (n,), axial strains of the elements
    forces : shape (n, 3), N, forces in the elements, in space axes
    """

    positions: Floats
    frames: Floats
    stretches: Floats
    forces: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LineHistory:
    """History of the line and its supports.

    Parameters
    ----------
    slider_rests : shape (cells, sliders, 2), 1/m, rest curvatures of the sliders
    contact_points : shape (planes, n + 1, 3), m, points at which nodes stick to planes
    ring_parameters : shape (rings,), curve parameters u at which the line passes through the rings
    """

    slider_rests: Floats
    contact_points: Floats
    ring_parameters: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ImposedValues:
    """Positions and forces imposed by the boundaries at a time.

    Parameters
    ----------
    held_positions : shape (grips, 3), m, positions of the held nodes
    clamp_frames : shape (clamps, 4), unit quaternions of the clamps
    forces : shape (n + 1, 3), N, loads and weight at the nodes
    anchors : shape (strings, 3), m, positions of the anchors of strings
    rings : shape (rings, 3), m, positions of the rings
    time : time in steps, with fractions; -1 for the initial shape, 0 for the first state
    """

    held_positions: Floats
    clamp_frames: Floats
    forces: Floats
    anchors: Floats
    rings: Floats
    time: float


@dataclass(frozen=True, slots=True, eq=False)
class ArtificialDrag:
    """Artificial drag that resists changes from an earlier shape.

    Each cell resists a change of its bending and twist, as with internal damping. In addition, each
    node resists displacement and each element resists rotation, with a hundredth of `ratio` times
    `Assembly.unit_drag`. This drag determines the position of a line that is free to move.

    Parameters
    ----------
    ratio : moment of a cell per change of its rotation vector, relative to its initial stiffness
    shape : earlier shape
    rotation_vectors : shape (cells, 3), rad, rotation vectors of the cells in the earlier shape
    """

    ratio: float
    shape: Shape
    rotation_vectors: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Residual and tangent of a shape.

    Parameters
    ----------
    residual : shape (unknowns,), in N for positions, N m for stretches and turns, m for forces
    tangent_values : shape (entries,), entries of the tangent in the order of `Assembly.pattern`
    inputs : history before the step, and drag; None without drag
    symmetric_values : shape (entries,), entries of the tangent without the increase of friction
        with pressure
    cells : response of the cells
    directions : directions of the elements
    history : history after the step
    plane_contacts : contacts with the planes
    string_forces : shape (strings, 3), N, forces of the strings on their nodes
    ring_contacts : contacts with the rings
    """

    residual: Floats
    tangent_values: Floats
    inputs: tuple[LineHistory, ArtificialDrag | None]
    symmetric_values: Floats
    cells: BentCells
    directions: Directions
    history: LineHistory
    plane_contacts: tuple[PlaneContact, ...]
    string_forces: Floats
    ring_contacts: tuple[RingContact, ...]


class Assembly:
    """Equilibrium equations of a line with its supports.

    Parameters
    ----------
    line : line with its elements
    supports : cells and held nodes of the line
    planes : planes that the axis of the line may touch
    strings : nodes and lengths, m, of the strings, shape (strings,) each
    n_rings : number of rings
    force : N, magnitude of the forces on the whole line

    Attributes
    ----------
    n : number of elements
    is_rigid : whether the line is inextensible
    indices : indices of the unknowns
    matrix : tangent, as a banded matrix
    rounding : N, rounding error of the forces of planes, strings and rings
    unit_drag : shape (unknowns,), drag coefficient of each unknown. The sum over the line is
        `force` / length against motion (N/m), and `force` times length against turns (N m)
    pattern : rows and columns of the entries of the tangent, shape (entries,) each
    """

    def __init__(
        self,
        line: Line,
        supports: Supports,
        planes: tuple[Plane, ...],
        strings: tuple[Ints, Floats],
        *,
        n_rings: int,
        force: float,
    ) -> None:
        # The indentation under the total force is relative to the length of the shortest
        # element. Stiffer contacts amplify rounding errors.
        contact_indentation = 1e-6
        position_rounding = 2e-15  # relative to the length of the line
        # In the tangent, an element stretches by this fraction under the total force. The tangent
        # is then regular even for a straight line between two supports.
        min_stretch = 1e-10
        self.line, self.supports, self.planes, self.strings = line, supports, planes, strings
        self.force = force
        self.n = len(line.lengths)
        self._has_rings = n_rings > 0
        self.indices = UnknownIndices(self.n)
        section = line.section
        self.is_rigid = not np.isfinite(section.axial_stiffness)
        self._is_coupled = section.coupling != 0.0 and not self.is_rigid
        is_element = supports.sides < self.n  # the other sides are clamps
        self._inner_cells = np.flatnonzero(is_element.all(axis=1))
        # A cell has an element on each side. At a clamp, its only element is listed twice.
        self._elements = np.where(is_element, supports.sides, supports.sides[:, ::-1])
        # The coupling of an element is divided among its cells. A clamp has no coupling.
        n_cells = supports.sum_at_frames(np.ones(supports.sides.shape))[: self.n]
        couplings = section.coupling * line.lengths / np.maximum(n_cells, 1.0)
        self._couplings = is_element * couplings[self._elements]
        self._coupled_turns = is_element / supports.lengths[:, None]
        self._min_length = float(np.min(line.lengths))
        self._contact_stiffness = force / (contact_indentation * self._min_length)
        has_contacts = bool(planes or len(strings[0]) or n_rings)
        self.rounding = position_rounding * self._contact_stiffness * line.length * has_contacts
        fractions = line.lengths / line.length
        node_fractions = 0.5 * (np.append(fractions, 0.0) + np.append(0.0, fractions))
        node_drag, turn_drag = node_fractions * force / line.length, fractions * force * line.length
        self._node_drag, self._turn_drag = (
            drag[:, None, None] * np.eye(3) for drag in (node_drag, turn_drag)
        )
        zeros = np.zeros((self.n, 3))
        self.unit_drag = join_unknowns(node_drag[:, None], zeros[:, 0], turn_drag[:, None], zeros)
        self.pattern = self._build_pattern()
        is_fixed = np.zeros(self.indices.n_unknowns, dtype=np.bool_)
        is_fixed[self.indices.positions[supports.held_nodes][:, None] + _AXIS_NUMBERS] = True
        is_fixed[self.indices.stretches] = self.is_rigid
        self.matrix = BandedMatrix(*self.pattern, self._compute_scale(), is_fixed)
        self._chord_signs = np.repeat([-1.0, 1.0], 3 * self.n)
        self._compliance = np.repeat(-min_stretch / force * line.lengths, 3)

    def compute_balance(
        self,
        shape: Shape,
        imposed: ImposedValues,
        history: LineHistory,
        drag: ArtificialDrag | None = None,
    ) -> Balance:
        """Compute the residual and the tangent of a shape.

        Parameters
        ----------
        shape : shape of the line
        imposed : positions and forces imposed by the boundaries
        history : history before the step
        drag : artificial drag; None without drag
        """
        # A small drag makes the tangent regular even if the line is free to move.
        min_drag = 1e-10  # relative to `unit_drag`, in the tangent only
        motion_drag_ratio = 1e-2  # drag against motion in space / drag against bending
        lengths = self.line.lengths * (1.0 + shape.stretches)
        cells = self._bend_cells(shape, imposed, history, drag)
        rotations = to_matrices(shape.frames)
        scaled_forces = lengths[:, None] * shape.forces
        clamp_directions = compute_clamp_directions(self.supports, imposed.clamp_frames)
        directions = compute_directions(self.supports, rotations, clamp_directions, scaled_forces)
        turn_residual = self._sum_at_elements(cells.gradients.reshape(-1, 2, 3))
        turn_residual += directions.moments
        stiffnesses = np.stack([cells.stiffnesses[:, :3, :3], cells.stiffnesses[:, 3:, 3:]], axis=1)
        turn_stiffness = directions.stiffness + self._sum_at_elements(stiffnesses)
        position_residual, position_stiffness, plane_contacts, string_forces = self._sum_forces(
            shape, imposed, history
        )
        ring_contacts = tuple(
            compute_ring_contact(shape.positions, ring, float(parameter), self._contact_stiffness)
            for ring, parameter in zip(imposed.rings, history.ring_parameters, strict=True)
        )
        ring_blocks = self._add_ring_forces(ring_contacts, position_residual, position_stiffness)
        chords = shape.positions[1:] - shape.positions[:-1]
        gaps = chords - lengths[:, None] * directions.unit_vectors
        stretch_residual, stretch_stiffness, force_derivatives = self._compute_stretch_residuals(
            shape, directions, cells
        )
        residual = join_unknowns(position_residual, stretch_residual, turn_residual, gaps)
        drag_factor = min_drag if drag is None else motion_drag_ratio * drag.ratio
        turn_stiffness += drag_factor * self._turn_drag
        position_stiffness += drag_factor * self._node_drag
        if drag is not None:
            residual += drag_factor * self.unit_drag * self.compute_change(drag.shape, shape)
        mirrored_blocks = [
            self._chord_signs,
            force_derivatives.ravel(),
            (-lengths[:, None, None] * directions.turn_derivatives).ravel(),
            (directions.moments / (1.0 + shape.stretches)[:, None]).ravel(),
            cells.stiffnesses[self._inner_cells, 3:, :3].ravel(),
            self._compute_coupling_values(cells),
            *ring_blocks,
        ]
        blocks = [*mirrored_blocks, *mirrored_blocks]
        blocks += [self._compliance, stretch_stiffness, turn_stiffness.ravel()]
        values = symmetric_values = np.concatenate([*blocks, position_stiffness.ravel()])
        if any(plane.friction > 0.0 for plane in self.planes):
            position_stiffness -= sum(contact.friction_coupling for contact in plane_contacts)
            symmetric_values = np.concatenate([*blocks, position_stiffness.ravel()])
        contact_points = np.array([contact.points for contact in plane_contacts])
        new_history = LineHistory(
            cells.slider_rests,
            contact_points.reshape(-1, self.n + 1, 3),
            np.array([contact.parameter for contact in ring_contacts]),
        )
        return Balance(
            residual=residual,
            tangent_values=values,
            inputs=(history, drag),
            symmetric_values=symmetric_values,
            cells=cells,
            directions=directions,
            history=new_history,
            plane_contacts=plane_contacts,
            string_forces=string_forces,
            ring_contacts=ring_contacts,
        )

    def compute_change(self, start_shape: Shape, end_shape: Shape) -> Floats:
        """Compute the change of positions and turns between two shapes, as change of all unknowns.

        The change of stretches and forces is set to zero.
        """
        turns = to_rotation_vectors(multiply(conjugate(start_shape.frames), end_shape.frames))
        zeros = np.zeros(self.n)
        return join_unknowns(end_shape.positions - start_shape.positions, zeros, turns, 0.0 * turns)

    def apply_change(self, shape: Shape, change: Floats) -> Shape:
        """Add a change of the unknowns to a shape."""
        positions, stretches, turns, forces = split_unknowns(change)
        return Shape(
            shape.positions + positions,
            normalise(multiply(shape.frames, from_rotation_vectors(turns))),
            shape.stretches + stretches,
            shape.forces + forces,
        )

    def compute_right_side(
        self,
        balance: Balance,
        shape: Shape,
        imposed: ImposedValues,
        held_moves: Floats,
        clamp_turns: Floats,
    ) -> Floats:
        """Compute the right-hand side of a Newton step in which held nodes and clamps also move.

        Parameters
        ----------
        balance, shape, imposed : balance, shape and imposed values before the step
        held_moves : shape (grips, 3), m, displacements of the held nodes
        clamp_turns : shape (clamps, 3), rad, rotation vectors of the clamps, in the body frame
        """
        indices, supports = self.indices, self.supports
        right_side = -balance.residual
        right_side[indices.positions[supports.held_nodes][:, None] + _AXIS_NUMBERS] = held_moves
        if self.is_rigid:
            right_side[indices.stretches] = -shape.stretches
        if np.any(clamp_turns):
            frame_turns = np.concatenate([np.zeros((self.n, 3)), clamp_turns])[supports.sides]
            moments = np.matvec(balance.cells.stiffnesses, frame_turns.reshape(-1, 6))
            elements, clamps = supports.clamp_pairs.T
            space_turns = np.matvec(to_matrices(imposed.clamp_frames), clamp_turns)[clamps]
            clamp_directions = compute_clamp_directions(supports, imposed.clamp_frames)
            clamp_changes = sum_at_nodes(elements, cross(space_turns, clamp_directions), self.n)
            changes = np.matvec(balance.directions.clamp_derivatives, clamp_changes)
            _, _, turns, forces = split_unknowns(right_side)  # views of `right_side`
            turns -= self._sum_at_elements(moments.reshape(-1, 2, 3))
            forces += (self.line.lengths * (1.0 + shape.stretches))[:, None] * changes
        return right_side

    def _sum_at_elements(self, values: Floats) -> Floats:
        """Sum values of both sides of the cells, shape (cells, 2, ...), at the elements."""
        return self.supports.sum_at_frames(values)[: self.n]

    def compute_reactions(self, balance: Balance, imposed: ImposedValues) -> tuple[Floats, Floats]:
        """Compute the reactions of the grips.

        Forces are in N, shape (grips, 3), and moments in space axes, N m, shape (clamps, 3).
        """
        supports, clamp_moments = self.supports, balance.directions.clamp_moments
        moments = sum_at_nodes(supports.clamp_pairs[:, 1], clamp_moments, len(supports.clamps))
        gradients = supports.sum_at_frames(balance.cells.gradients.reshape(-1, 2, 3))[self.n :]
        moments += np.matvec(to_matrices(imposed.clamp_frames), gradients)
        held_unknowns = self.indices.positions[supports.held_nodes][:, None] + _AXIS_NUMBERS
        return balance.residual[held_unknowns], moments

    def select_frames(self, shape: Shape, imposed: ImposedValues) -> Floats:
        """Select the frames before and after each cell, shape (cells, 2, 4)."""
        return np.concatenate([shape.frames, imposed.clamp_frames])[self.supports.sides]

    def _bend_cells(
        self,
        shape: Shape,
        imposed: ImposedValues,
        history: LineHistory,
        drag: ArtificialDrag | None,
    ) -> BentCells:
        """Compute the moments and the tangents of all cells."""
        supports = self.supports
        torques = np.vecdot(self._couplings, shape.stretches[self._elements]) / supports.lengths
        return bend_cells(
            self.line.section,
            self.select_frames(shape, imposed),
            supports.lengths,
            supports.rest_curvature,
            slider_rests=history.slider_rests,
            torques=torques,
            artificial_stiffness=None if drag is None else (drag.ratio, drag.rotation_vectors),
        )

    def _sum_forces(
        self, shape: Shape, imposed: ImposedValues, history: LineHistory
    ) -> tuple[Floats, Floats, tuple[PlaneContact, ...], Floats]:
        """Sum the forces at the nodes, except those of rings.

        The results are the residuals and the diagonal blocks of the tangent for the positions, the
        contacts of the planes, and the forces of the strings.
        """
        max_relative_gap = 1e-9  # largest gap of a touching node / length of the shortest element
        residual = -imposed.forces
        residual[:-1] -= shape.forces
        residual[1:] += shape.forces
        tangent = np.zeros((self.n + 1, 3, 3))
        plane_contacts = tuple(
            compute_plane_contact(
                plane,
                self._contact_stiffness,
                shape.positions,
                points,
                max_gap=max_relative_gap * self._min_length,
            )
            for plane, points in zip(self.planes, history.contact_points, strict=True)
        )
        for contact in plane_contacts:
            residual -= contact.forces
            tangent += contact.stiffness
        nodes, lengths = self.strings
        string_forces = np.zeros((len(nodes), 3))
        if len(nodes):
            string_forces, stiffness = compute_string_forces(
                imposed.anchors, lengths, self._contact_stiffness, shape.positions[nodes]
            )
            np.subtract.at(residual, nodes, string_forces)
            np.add.at(tangent, nodes, stiffness)
        return residual, tangent, plane_contacts, string_forces

    def _add_ring_forces(
        self, ring_contacts: tuple[RingContact, ...], residual: Floats, tangent: Floats
    ) -> list[Floats]:
        """Add ring forces to the nodes in place; return tangent blocks between different nodes.

        The blocks connect nodes at a distance of one and of two elements.
        """
        if not self._has_rings:
            return []
        distances = (1, 2)
        ring_blocks = [np.zeros((self.n + 1 - distance, 3, 3)) for distance in distances]
        for contact in ring_contacts:
            first_node = contact.first_node
            residual[first_node : first_node + 3] -= contact.weights[:, None] * contact.force
            for i in range(3):
                tangent[first_node + i] += contact.stiffness[i, :, i, :]
                for blocks, distance in zip(ring_blocks, distances, strict=True):
                    if i + distance < 3:
                        blocks[first_node + i] += contact.stiffness[i, :, i + distance, :]
        return [blocks.ravel() for blocks in ring_blocks]

    def _compute_stretch_residuals(
        self, shape: Shape, directions: Directions, cells: BentCells
    ) -> tuple[Floats, Floats, Floats]:
        """Compute residuals of stretches, and derivatives with respect to stretches and forces."""
        lengths = self.line.lengths
        if self.is_rigid:
            return np.zeros(self.n), np.zeros(self.n), np.zeros((self.n, 3))
        stiffness = self.line.section.axial_stiffness * lengths
        residual = stiffness * shape.stretches
        residual -= lengths * np.vecdot(shape.forces, directions.unit_vectors)
        if self._is_coupled:
            residual += self._sum_at_elements(self._couplings * cells.curvatures[:, 2:])
        return residual, stiffness, -lengths[:, None] * directions.unit_vectors

    def _compute_coupling_values(self, cells: BentCells) -> Floats:
        """Compute the entries of the tangent that couple stretches and turns."""
        if not self._is_coupled:
            return np.zeros(0)
        twists = self._coupled_turns[:, :, None] * cells.turn_maps[:, :, 2].reshape(-1, 2, 3)
        return (self._couplings[:, :, None, None] * twists[:, None]).ravel()

    def _build_pattern(self) -> tuple[Ints, Ints]:
        """List rows and columns of the tangent: blocks, their mirror images, diagonal blocks."""
        positions, stretches = self.indices.positions, self.indices.stretches
        turns, forces = self.indices.turns, self.indices.forces
        turns_before, turns_after = turns[self.supports.sides[self._inner_cells]].T
        mirrored_blocks = [
            _list_identity_entries(positions[:-1], forces),
            _list_identity_entries(positions[1:], forces),
            list_block_entries(stretches, 1, forces, 3),
            list_block_entries(forces, 3, turns, 3),
            list_block_entries(stretches, 1, turns, 3),
            list_block_entries(turns_after, 3, turns_before, 3),
        ]
        if self._is_coupled:  # each stretch is coupled with the turns on both sides of the cell
            rows = stretches[np.repeat(self._elements, 2, axis=1)].ravel()
            columns = turns[np.tile(self._elements, 2)].ravel()
            mirrored_blocks.append(list_block_entries(rows, 1, columns, 3))
        for distance in (1, 2) if self._has_rings else ():
            rows, columns = positions[:-distance], positions[distance:]
            mirrored_blocks.append(list_block_entries(rows, 3, columns, 3))
        diagonal_blocks = [
            _list_identity_entries(forces, forces),
            list_block_entries(stretches, 1, stretches, 1),
            list_block_entries(turns, 3, turns, 3),
            list_block_entries(positions, 3, positions, 3),
        ]
        blocks = [
            *mirrored_blocks,
            *((columns, rows) for rows, columns in mirrored_blocks),
            *diagonal_blocks,
        ]
        rows, columns = (np.concatenate(entries) for entries in zip(*blocks, strict=True))
        return rows, columns

    def _compute_scale(self) -> Floats:
        """Return the factors of rows and columns of the matrix, shape (unknowns,).

        A factor is the magnitude of the unknown over the square root of the energy EI / l.
        """
        length = float(np.mean(self.line.lengths))
        stiffness = self.line.section.law.first_stiffness
        ones = np.ones((self.n, 3))
        positions = np.full((self.n + 1, 3), length)
        scale = join_unknowns(positions, ones[:, 0], ones, stiffness / length**2 * ones)
        return np.asarray(scale * np.sqrt(length / stiffness))


_AXIS_NUMBERS = np.arange(3)


def _list_identity_entries(rows: Ints, columns: Ints) -> tuple[Ints, Ints]:
    """List rows and columns of the three entries, one on each axis, for each pair of indices."""
    return (rows[:, None] + _AXIS_NUMBERS).ravel(), (columns[:, None] + _AXIS_NUMBERS).ravel()
