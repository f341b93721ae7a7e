"""Record the quasi-static path of a line and its lost energy; check whether it can continue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from labpipe.mechanics.law.sliders import get_current_sliders
from labpipe.mechanics.rod.assembly import Assembly, Balance, Shape
from labpipe.mechanics.rod.boundaries import Boundary
from labpipe.mechanics.rod.equilibrium import Equilibrium
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.rotations import to_matrices
from labpipe.mechanics.rod.schedule import Schedule, format_boundary
from labpipe.mechanics.rod.supports import CLAMP_WEIGHT, Supports
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats
from labpipe.records.quality import Reason
from labpipe.records.result import Status


@dataclass(frozen=True, slots=True, eq=False)
class RodState(ArrayRecord):
    """Line in equilibrium, with its history.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, positions of the nodes
    frames : shape (n, 4), unit quaternions of the elements
    stretches : shape (n,), axial strains of the elements
    forces : shape (n, 3), N, in space axes, force that the line after an element exerts on the line
        before it; a tension is along d3
    moments : shape (n + 1, 2, 3), N m, in space axes, moment that the line after a cell exerts on
        the line before it. The second axis is the side of the node, before and after it; the sides
        differ at a clamp. The moment is zero before the first and after the last node
    curvatures : shape (n + 1, 2, 3), 1/m, curvatures minus those at rest, on both sides of every
        node: two bending components and the twist in the mean frame. At a clamp they are means over
        half an element
    node_curvatures : shape (n + 1, 2, 3), 1/m, as `curvatures`, but extrapolated to the node at
        clamps
    curvature_vectors : shape (n + 1, 2, 2), 1/m, bending components of `node_curvatures` plus those
        at rest
    slider_rests : shape (n + 1, 2, sliders, 2), 1/m, rest curvatures of the sliders, which are the
        history
    reaction_forces : shape (boundaries, 3), N, total force of each boundary on the line, loads
        included; zero for gravity
    reaction_moments : shape (boundaries, 3), N m, moments of clamps about their node; zero for
        other boundaries
    """

    positions: Annotated[Floats, "nodes", 3]
    frames: Annotated[Floats, "elements", 4]
    stretches: Annotated[Floats, "elements"]
    forces: Annotated[Floats, "elements", 3]
    moments: Annotated[Floats, "nodes", 2, 3]
    curvatures: Annotated[Floats, "nodes", 2, 3]
    node_curvatures: Annotated[Floats, "nodes", 2, 3]
    curvature_vectors: Annotated[Floats, "nodes", 2, 2]
    slider_rests: Annotated[Floats, "nodes", 2, "sliders", 2]
    reaction_forces: Annotated[Floats, "boundaries", 3]
    reaction_moments: Annotated[Floats, "boundaries", 3]

    @property
    def bending_curvatures(self) -> Floats:
        """Return the bending curvature at the nodes minus that at rest, 1/m, shape (n + 1,).

        At a clamp, it is the larger of the curvatures on both sides.
        """
        bending = self.node_curvatures[:, :, :2]
        return np.asarray(np.max(np.linalg.norm(bending, axis=2), axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class RodPath(ArrayRecord):
    """Path of a line; lost energies are totals since the start.

    Parameters
    ----------
    line : line in its initial shape
    boundaries : boundaries of the line, in the order of the caller
    states : states of steps 0, 1, ...; fewer than requested if the path failed
    status : `failed` if a step has no equilibrium; `doubtful` if there is another reason, such as a
        curvature beyond the range of the law; otherwise `ok`
    reasons : reasons of the status, the most important first; empty if `ok`
    jump_steps : steps in which the line jumped, because it snapped or was released
    lost_energy : shape (states,), J, energy lost in the sliders
    jump_energy : shape (states,), J, part of `lost_energy` that is lost in jumps
    """

    line: Line
    boundaries: tuple[Boundary, ...]
    states: tuple[RodState, ...]
    status: Status
    reasons: tuple[Reason, ...]
    jump_steps: tuple[int, ...]
    lost_energy: Annotated[Floats, "states"]
    jump_energy: Annotated[Floats, "states"]

    @property
    def last(self) -> RodState:
        """Return the last state that was reached.

        Raises
        ------
        ValueError
            If step 0 failed, so that there is no state.
        """
        if not self.states:
            raise ValueError(
                format_sentence("mechanics.rod.no_state", reason=self.reasons[0].message)
            )
        return self.states[-1]


def split_sides(supports: Supports, values: Floats) -> Floats:
    """Assign the values of cells to both sides of their nodes.

    Parameters
    ----------
    supports : cells of the line
    values : shape (cells, ...), values of any quantity

    Returns
    -------
    Shape (nodes, 2, ...); zero on sides without a cell.
    """
    sides = np.zeros((supports.n_nodes, 2, *values.shape[1:]))
    for side in (0, 1):
        has_side = supports.side_weights[:, side] > 0.0
        sides[supports.nodes[has_side], side] = values[has_side]
    return sides


def build_state(
    assembly: Assembly, schedule: Schedule, grips: tuple[int, ...], solution: Equilibrium, step: int
) -> RodState:
    """Build the state of a step, with all forces and moments in space axes.

    Parameters
    ----------
    assembly : line and supports
    schedule : paths of the boundaries
    grips : indices of the boundaries that hold the line
    solution : equilibrium at the end of the step
    step : number of the step
    """
    supports, balance, shape = assembly.supports, solution.balance, solution.shape
    grip_forces, clamp_moments = assembly.compute_reactions(balance, solution.imposed)
    reaction_forces, reaction_moments = np.zeros((2, len(schedule.boundaries), 3))
    reaction_forces[list(grips)] = grip_forces
    for k, load in schedule.loads.items():
        reaction_forces[k] = load.force[min(step, len(load.force) - 1)]
    reaction_moments[[grips[int(row)] for row in supports.clamps]] = clamp_moments
    for k, contact in zip(schedule.planes, balance.plane_contacts, strict=True):
        reaction_forces[k] = contact.forces.sum(axis=0)
    reaction_forces[list(schedule.strings)] = balance.string_forces
    for k, ring_contact in zip(schedule.rings, balance.ring_contacts, strict=True):
        reaction_forces[k] = ring_contact.force
    cells = balance.cells
    node_curvatures = split_sides(supports, _extrapolate_to_clamps(supports, cells.curvatures))
    rest_curvature = assembly.line.rest_curvature_at_nodes[:, None, :2]
    return RodState(
        positions=shape.positions,
        frames=shape.frames,
        stretches=shape.stretches,
        forces=shape.forces,
        moments=split_sides(supports, _compute_moments(assembly, solution)),
        curvatures=split_sides(supports, cells.curvatures),
        node_curvatures=node_curvatures,
        curvature_vectors=node_curvatures[:, :, :2] + rest_curvature,
        slider_rests=split_sides(supports, balance.history.slider_rests),
        reaction_forces=reaction_forces,
        reaction_moments=reaction_moments,
    )


def _extrapolate_to_clamps(supports: Supports, curvatures: Floats) -> Floats:
    """Extrapolate the curvatures of the cells, shape (cells, 3), 1/m, to the clamps.

    The curvature of a half cell at a clamp is that of the line at the distance `CLAMP_WEIGHT` times
    the length of its element from the clamp. The extrapolation is linear through that point and the
    next cell.
    """
    node_curvatures, lengths = curvatures.copy(), supports.lengths
    n = supports.n_nodes - 1
    for frame_indices, offset in zip(supports.sides.T[::-1], (-1, 1), strict=True):
        cells = np.flatnonzero(frame_indices >= n)  # half cells with a clamp on that side
        cells = cells[(cells + offset >= 0) & (cells + offset < len(lengths))]
        distance = CLAMP_WEIGHT * 2.0 * lengths[cells]
        factor = distance / (lengths[cells] + 0.5 * lengths[cells + offset] - distance)
        node_curvatures[cells] += factor[:, None] * (curvatures[cells] - curvatures[cells + offset])
    return node_curvatures


def _compute_moments(assembly: Assembly, equilibrium: Equilibrium) -> Floats:
    """Compute the moments of the line after each cell on the line before it, N m, (cells, 3).

    In a half cell at a clamp, it is the moment at the node, not at the middle of the half cell.
    """
    supports, balance = assembly.supports, equilibrium.balance
    frames_after = assembly.select_frames(equilibrium.shape, equilibrium.imposed)[:, 1]
    moments = np.asarray(np.matvec(to_matrices(frames_after), balance.cells.gradients[:, 3:]))
    clamp_moments = balance.directions.clamp_moments
    for (element, clamp), moment in zip(supports.clamp_pairs, clamp_moments, strict=True):
        sides = np.array([assembly.n + clamp, element])
        moments[np.all(supports.sides == sides, axis=1)] -= moment
        moments[np.all(supports.sides == sides[::-1], axis=1)] += moment
    return moments


def compute_lost_energy(assembly: Assembly, start_rests: Floats, end_rests: Floats) -> float:
    """Compute the energy lost in the sliders in a step or in a fraction of a step, J.

    The moment of a sliding slider is K_j kappa_j while its rest curvature changes. The moment of a
    slider whose limit grows is the mean of those at the start and at the end.

    Parameters
    ----------
    assembly : line with its supports
    start_rests, end_rests : shape (cells, sliders, 2), 1/m, rest curvatures of the sliders at the
        start and at the end
    """
    law = assembly.line.section.law
    start, end = (get_current_sliders(law, rests) for rests in (start_rests, end_rests))
    distances = np.linalg.norm(end.rest_curvatures - start.rest_curvatures, axis=2)
    slip_curvatures = 0.5 * (start.slip_curvatures + end.slip_curvatures)
    return float(assembly.supports.lengths @ (distances * slip_curvatures) @ start.stiffnesses)


_LENGTH_ROUNDING = 1e-9
"""Rounding tolerance of lengths, relative to the length."""


class NoEquilibriumError(Exception):
    """Error that the path of a line cannot be continued.

    Parameters
    ----------
    reason : reason why the path cannot be continued
    """

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.message)
        self.reason = reason

    @classmethod
    def of(cls, template: str, /, **facts: object) -> NoEquilibriumError:
        """Build the error from a template of a reason and its facts; see `Reason.of`."""
        return cls(Reason.of(template, **facts))


def check_reach(schedule: Schedule, grips: tuple[int, ...], step: int) -> None:
    """Refuse held nodes too far apart for an inextensible line, or that make it taut under loads.

    A taut line has no equilibrium under transverse loads, and its tension under axial loads is not
    determined.

    Parameters
    ----------
    schedule : paths of the boundaries
    grips : indices of the boundaries that hold the line
    step : number of the step

    Raises
    ------
    NoEquilibriumError
        If the distance of two held nodes is larger than the length between them or, under loads,
        too close to it.
    """
    # The slack is relative to the length. With less slack, the tension exceeds 600 times the load
    # and is dominated by rounding errors.
    min_slack = 1e-7
    min_relative_force = 1e-9  # of a load, relative to the forces on the line
    imposed = schedule.compute_imposed_values(float(step), grips)
    nodes = np.array([schedule.held_nodes[k] for k in grips], dtype=np.int64)
    order = np.argsort(nodes)
    nodes = nodes[order]
    distances = np.linalg.norm(np.diff(imposed.held_positions[order], axis=0), axis=1)
    lengths = np.diff(schedule.line.stations[nodes])
    min_force = min_relative_force * schedule.estimate_force()
    is_loaded = np.linalg.norm(imposed.forces, axis=1) > min_force
    for node, next_node, distance, length in zip(
        nodes, nodes[1:], distances, lengths, strict=False
    ):
        slack = min_slack if np.any(is_loaded[node + 1 : next_node]) else 0.0
        if distance <= length * (1.0 + _LENGTH_ROUNDING - slack):
            continue
        is_too_short = distance > length * (1.0 + _LENGTH_ROUNDING)
        raise NoEquilibriumError.of(
            "mechanics.rod.too_short" if is_too_short else "mechanics.rod.taut",
            step=step,
            place=schedule.line.describe_position(node),
            other=schedule.line.describe_position(next_node),
            length=length,
            distance=distance,
        )


def check_planes(schedule: Schedule, grips: tuple[int, ...], step: int) -> None:
    """Refuse a grip that holds the axis of the line nearer to a plane than the line's radius.

    Parameters
    ----------
    schedule, grips, step : as for `check_reach`

    Raises
    ------
    NoEquilibriumError
        If a held node is too near to a plane.
    """
    held_positions = schedule.compute_imposed_values(float(step), grips).held_positions
    line = schedule.line
    clearance = 0.5 * line.section.diameter
    for plane in schedule.planes.values() if grips else ():
        heights = (held_positions - plane.point) @ plane.normal
        row = int(np.argmin(heights))
        if heights[row] < clearance - _LENGTH_ROUNDING * line.length:
            k = grips[row]
            raise NoEquilibriumError.of(
                "mechanics.rod.in_plane",
                step=step,
                place=line.describe_position(schedule.held_nodes[k]),
                grip=format_boundary(schedule.boundaries, schedule.grips[k]),
                table=format_boundary(schedule.boundaries, plane),
                height=1e3 * heights[row],
                clearance=1e3 * clearance,
            )


def check_line(
    assembly: Assembly, shape: Shape, balance: Balance, step: int, *, max_strain: float
) -> None:
    """Refuse a line that is torn or folded.

    Parameters
    ----------
    assembly : line with its supports
    shape : shape of the line
    balance : balance of the shape
    step : number of the step
    max_strain : strain beyond which the line counts as torn

    Raises
    ------
    NoEquilibriumError
        If an element is stretched too far, or two elements are folded onto each other.
    """
    max_turn = 3.13  # rad, between two elements
    element = int(np.argmax(shape.stretches))
    stretch, max_stretch = 100.0 * shape.stretches[element], 100.0 * max_strain
    if stretch > max_stretch:
        raise NoEquilibriumError.of(
            "mechanics.rod.torn",
            step=step,
            place=assembly.line.describe_position(element),
            stretch=stretch,
            max_stretch=max_stretch,
        )
    turns = np.linalg.norm(balance.cells.rotation_vectors, axis=1)
    if float(np.max(turns, initial=0.0)) > max_turn:
        cell = int(np.argmax(turns))
        place = assembly.line.describe_position(assembly.supports.nodes[cell])
        raise NoEquilibriumError.of(
            "mechanics.rod.folded", step=step, place=place, turn=turns[cell]
        )


def check_rings(schedule: Schedule, balance: Balance, step: int) -> None:
    """Refuse a line that has slid out of a ring.

    Parameters
    ----------
    schedule : paths of the boundaries
    balance : balance of the line, with the contacts of the rings
    step : number of the step

    Raises
    ------
    NoEquilibriumError
        If a ring is at an end of the line.
    """
    for ring, contact in zip(schedule.rings.values(), balance.ring_contacts, strict=True):
        if not 0.0 < contact.parameter < schedule.n:
            end = schedule.line.describe_position(0 if contact.parameter <= 0.0 else schedule.n)
            name = format_boundary(schedule.boundaries, ring)
            raise NoEquilibriumError.of("mechanics.rod.left_ring", step=step, place=end, ring=name)
