"""Reasons why a line cannot be followed to a step."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.rod.assembly import Assembly, Balance, Shape
from labpipe.mechanics.rod.boundaries import Plane
from labpipe.mechanics.rod.path import Reason
from labpipe.mechanics.rod.schedule import Schedule, boundary_name

_LENGTH_ROUNDING = 1e-9  # relative


def out_of_reach(schedule: Schedule, grips: tuple[int, ...], step: int) -> Reason | None:
    """Check for held nodes too far apart, or so far that an inextensible line is taut.

    A taut line has no equilibrium under transverse loads, and many under axial ones.

    Parameters
    ----------
    schedule : of the boundaries
    grips : boundaries that hold it
    step : its number
    """
    # of a length; with less, the tension is over 600 times the weight and mostly rounding
    min_slack = 1e-7
    min_force_share = 1e-9  # of the force on the line
    demands = schedule.demands(float(step), grips)
    nodes = np.array([schedule.held_nodes[k] for k in grips], dtype=np.int64)
    order = np.argsort(nodes)
    nodes = nodes[order]
    distances = np.linalg.norm(np.diff(demands.held[order], axis=0), axis=1)
    lengths = np.diff(schedule.line.stations[nodes])
    pulls = np.linalg.norm(demands.forces, axis=1) > min_force_share * schedule.force_scale()
    for first, second, distance, length in zip(
        nodes[:-1], nodes[1:], distances, lengths, strict=True
    ):
        place_text = f"step {step}: between nodes {first} and {second} the line is"
        if distance > length * (1.0 + _LENGTH_ROUNDING):
            sentence = (
                f"{place_text} {length:.6g} m long, and these are held {distance:.6g} m apart"
            )
            return Reason("too_short", sentence, step, int(second))
        if distance > length * (1.0 - min_slack) and np.any(pulls[first + 1 : second]):
            sentence = (
                f"{place_text} taut, {length:.6g} m long and held as far apart, so that its "
                "tension is not determined: apply weight and loads while the grips approach, make "
                "the line longer, or give it an axial stiffness"
            )
            return Reason("taut", sentence, step, int(second))
    return None


def held_in_plane(schedule: Schedule, grips: tuple[int, ...], step: int) -> Reason | None:
    """Check for a grip that holds the axis of the line nearer to a table than its radius.

    Parameters
    ----------
    schedule, grips, step : as in `out_of_reach`
    """
    held = schedule.demands(float(step), grips).held
    line = schedule.line
    clearance = 0.5 * line.section.diameter
    for plane in (schedule.boundaries[k] for k in schedule.planes if grips):
        assert isinstance(plane, Plane)
        heights = (held - plane.point) @ plane.normal
        lowest = int(np.argmin(heights))
        if heights[lowest] < clearance - _LENGTH_ROUNDING * line.length:
            grip, table = (
                boundary_name(schedule.boundaries, boundary)
                for boundary in (schedule.boundaries[grips[lowest]], plane)
            )
            sentence = (
                f"step {step}: {grip} holds the axis of the line {1e3 * heights[lowest]:.6g} mm "
                f"above {table}; its radius needs at least {1e3 * clearance:.6g} mm"
            )
            return Reason("in_plane", sentence, step, schedule.held_nodes[grips[lowest]])
    return None


def torn_or_folded(
    assembly: Assembly, shape: Shape, balance: Balance, step: int, *, most_stretch: float
) -> Reason | None:
    """Check for a line that is torn or folded.

    Parameters
    ----------
    assembly, shape, balance : of the line
    step : its number
    most_stretch : strain beyond which it counts as torn
    """
    max_fold = 3.13  # rad, between two elements
    element = int(np.argmax(shape.stretches))
    if shape.stretches[element] > most_stretch:
        sentence = (
            f"step {step}: the line is stretched by {100.0 * shape.stretches[element]:.3g} % "
            f"behind node {element}; expected at most {100.0 * most_stretch:.3g} %"
        )
        return Reason("torn", sentence, step, element)
    turns = np.linalg.norm(balance.cells.turns, axis=1)
    if float(np.max(turns, initial=0.0)) > max_fold:
        cell = int(np.argmax(turns))
        node = int(assembly.supports.nodes[cell])
        sentence = (
            f"step {step}: the line turns by {turns[cell]:.3g} rad at node {node}: use more "
            "elements"
        )
        return Reason("folded", sentence, step, node)
    return None


def ring_left(schedule: Schedule, balance: Balance, step: int) -> Reason | None:
    """Check for a ring that the line slid out of.

    Parameters
    ----------
    schedule : of the boundaries
    balance : of the line
    step : its number
    """
    for k, thread in zip(schedule.rings, balance.threads, strict=True):
        if not 0.0 < thread.place < schedule.n:
            end = 0 if thread.place <= 0.0 else schedule.n
            name = boundary_name(schedule.boundaries, schedule.boundaries[k])
            sentence = f"step {step}: the line slid out of {name} with its node {end}"
            return Reason("left_ring", sentence, step, end)
    return None
