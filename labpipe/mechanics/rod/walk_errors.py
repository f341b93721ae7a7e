"""Checks of a step of a line; a failed check raises the reason why the path ends."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.rod.assembly import Assembly, Balance, Shape
from labpipe.mechanics.rod.boundaries import Plane
from labpipe.mechanics.rod.path import Reason
from labpipe.mechanics.rod.schedule import Schedule, get_boundary_name

_LENGTH_ROUNDING = 1e-9  # relative


class NoEquilibriumError(Exception):
    """The path of a line ends, for a reason."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.sentence)
        self.reason = reason


def check_reach(schedule: Schedule, grips: tuple[int, ...], step: int) -> None:
    """Refuse held nodes that are too far apart, or that stretch an inextensible line taut.

    A taut line has no equilibrium under transverse loads, and its tension is not determined under
    axial loads.

    Parameters
    ----------
    schedule : of the boundaries
    grips : indices of the boundaries that hold the line
    step : number

    Raises
    ------
    NoEquilibriumError
        If the distance is too large.
    """
    # of a length; with less slack the tension exceeds 600 times the weight, and is mostly rounding
    min_slack = 1e-7
    min_force_share = 1e-9  # of the force on the line
    demands = schedule.demands(float(step), grips)
    nodes = np.array([schedule.held_nodes[k] for k in grips], dtype=np.int64)
    order = np.argsort(nodes)
    nodes = nodes[order]
    distances = np.linalg.norm(np.diff(demands.held[order], axis=0), axis=1)
    lengths = np.diff(schedule.line.stations[nodes])
    pulls = np.linalg.norm(demands.forces, axis=1) > min_force_share * schedule.force_scale()
    for place, other, distance, length in zip(nodes, nodes[1:], distances, lengths, strict=False):
        is_pulled = bool(np.any(pulls[place + 1 : other]))
        if distance <= length * (1.0 + _LENGTH_ROUNDING - (min_slack if is_pulled else 0.0)):
            continue
        is_short = distance > length * (1.0 + _LENGTH_ROUNDING)
        reason = Reason.of(
            "mechanics.rod.too_short" if is_short else "mechanics.rod.taut",
            step=step,
            place=place,
            other=other,
            length=length,
            distance=distance,
        )
        raise NoEquilibriumError(reason)


def check_planes(schedule: Schedule, grips: tuple[int, ...], step: int) -> None:
    """Refuse a grip that holds the axis of the line nearer to a plane than its radius.

    Parameters
    ----------
    schedule, grips, step : as in `check_reach`
    """
    held_positions = schedule.demands(float(step), grips).held
    line = schedule.line
    clearance = 0.5 * line.section.diameter
    for plane in (schedule.boundaries[k] for k in schedule.planes if grips):
        assert isinstance(plane, Plane)
        heights = (held_positions - plane.point) @ plane.normal
        lowest = int(np.argmin(heights))
        if heights[lowest] < clearance - _LENGTH_ROUNDING * line.length:
            grip = get_boundary_name(schedule.boundaries, schedule.boundaries[grips[lowest]])
            reason = Reason.of(
                "mechanics.rod.in_plane",
                step=step,
                place=schedule.held_nodes[grips[lowest]],
                grip=grip,
                table=get_boundary_name(schedule.boundaries, plane),
                height=1e3 * heights[lowest],
                clearance=1e3 * clearance,
            )
            raise NoEquilibriumError(reason)


def check_line(
    assembly: Assembly, shape: Shape, balance: Balance, step: int, *, max_strain: float
) -> None:
    """Refuse a line that is torn or folded.

    Parameters
    ----------
    assembly, shape, balance : of the line
    step : number
    max_strain : strain beyond which the line counts as torn
    """
    max_fold = 3.13  # rad, between two elements
    element = int(np.argmax(shape.stretches))
    stretch = 100.0 * shape.stretches[element]
    if stretch > 100.0 * max_strain:
        most = 100.0 * max_strain
        raise NoEquilibriumError(
            Reason.of("mechanics.rod.torn", step=step, place=element, stretch=stretch, most=most)
        )
    turns = np.linalg.norm(balance.cells.turns, axis=1)
    if float(np.max(turns, initial=0.0)) > max_fold:
        cell = int(np.argmax(turns))
        node = assembly.supports.nodes[cell]
        raise NoEquilibriumError(
            Reason.of("mechanics.rod.folded", step=step, place=node, turn=turns[cell])
        )


def check_rings(schedule: Schedule, balance: Balance, step: int) -> None:
    """Refuse a line that slid out of a ring.

    Parameters
    ----------
    schedule : of the boundaries
    balance : of the line
    step : number
    """
    for k, thread in zip(schedule.rings, balance.ring_contacts, strict=True):
        if not 0.0 < thread.place < schedule.n:
            end = 0 if thread.place <= 0.0 else schedule.n
            ring = get_boundary_name(schedule.boundaries, schedule.boundaries[k])
            raise NoEquilibriumError(
                Reason.of("mechanics.rod.left_ring", step=step, place=end, ring=ring)
            )
