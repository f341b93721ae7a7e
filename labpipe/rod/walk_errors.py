"""Why a line cannot be followed to a step: how it is held, and what became of it there."""

from __future__ import annotations

import numpy as np

from labpipe.rod.assembly import Assembly, Balance, Shape
from labpipe.rod.boundaries import Plane
from labpipe.rod.path import Reason
from labpipe.rod.schedule import Schedule, called

_LENGTH_ROUNDING = 1e-9
"""Of a length: what differs by less is the same."""


def out_of_reach(schedule: Schedule, grips: tuple[int, ...], step: int) -> Reason | None:
    """Places too far apart for a line that keeps its length, or just so far that it is taut.

    Pulled aside, a taut line has no equilibrium; pulled along itself, it has any number of them.

    Parameters
    ----------
    schedule : what is asked of the line
    grips : boundaries that hold it
    step : at which
    """
    # of a length; with less, the tension is over 600 times the weight and mostly rounding
    min_slack = 1e-7
    min_force_share = 1e-9  # of the force on the line
    demands = schedule.demands(float(step), grips)
    nodes = np.array([schedule.held_nodes[k] for k in grips], dtype=np.int64)
    order = np.argsort(nodes)
    nodes = nodes[order]
    apart = np.linalg.norm(np.diff(demands.held[order], axis=0), axis=1)
    lengths = np.diff(schedule.line.stations[nodes])
    pulls = np.linalg.norm(demands.forces, axis=1) > min_force_share * schedule.force_scale()
    for first, second, far, length in zip(nodes[:-1], nodes[1:], apart, lengths, strict=True):
        between = f"step {step}: between nodes {first} and {second} the line is"
        if far > length * (1.0 + _LENGTH_ROUNDING):
            sentence = (
                f"{between} {length:.6g} m long, and the places that hold them are {far:.6g} m "
                "apart"
            )
            return Reason("too_short", sentence, step, int(second))
        if far > length * (1.0 - min_slack) and np.any(pulls[first + 1 : second]):
            sentence = (
                f"{between} taut, {length:.6g} m long between places just as far apart, and no "
                "tension can be told that balances its weight and loads: bring these on as the "
                "places come together, make the line longer, or give it an axial stiffness"
            )
            return Reason("taut", sentence, step, int(second))
    return None


def held_in_plane(schedule: Schedule, grips: tuple[int, ...], step: int) -> Reason | None:
    """A place that holds the axis of the line nearer to a table than its radius.

    Parameters
    ----------
    schedule, grips, step : as in `out_of_reach`
    """
    held = schedule.demands(float(step), grips).held
    line = schedule.line
    least = 0.5 * line.section.diameter
    for plane in (schedule.boundaries[k] for k in schedule.planes if grips):
        assert isinstance(plane, Plane)
        heights = (held - plane.point) @ plane.normal
        low = int(np.argmin(heights))
        if heights[low] < least - _LENGTH_ROUNDING * line.length:
            grip, table = (
                called(schedule.boundaries, boundary)
                for boundary in (schedule.boundaries[grips[low]], plane)
            )
            sentence = (
                f"step {step}: {grip} holds the axis of the line {1e3 * heights[low]:.6g} mm above "
                f"{table}; with its diameter it lies {1e3 * least:.6g} mm above or higher"
            )
            return Reason("in_plane", sentence, step, schedule.held_nodes[grips[low]])
    return None


def broken(
    assembly: Assembly, shape: Shape, balance: Balance, step: int, *, most_stretch: float
) -> Reason | None:
    """A line that is torn or folded.

    Parameters
    ----------
    assembly, shape, balance : the line, where it is, and how far from equilibrium
    step : at which
    most_stretch : strain beyond which it counts as torn
    """
    max_fold = 3.13  # rad, between two elements
    at = int(np.argmax(shape.stretches))
    if shape.stretches[at] > most_stretch:
        sentence = (
            f"step {step}: the line is stretched by {100.0 * shape.stretches[at]:.3g} % behind "
            f"node {at}, allowed are {100.0 * most_stretch:.3g} %"
        )
        return Reason("torn", sentence, step, at)
    turns = np.linalg.norm(balance.cells.turns, axis=1)
    if float(np.max(turns, initial=0.0)) > max_fold:
        cell = int(np.argmax(turns))
        node = int(assembly.supports.nodes[cell])
        sentence = (
            f"step {step}: the line turns by {turns[cell]:.3g} rad at node {node}: take more "
            "elements"
        )
        return Reason("folded", sentence, step, node)
    return None


def ring_left(schedule: Schedule, balance: Balance, step: int) -> Reason | None:
    """A ring that the line slid out of.

    Parameters
    ----------
    schedule : what is asked of the line
    balance : where it goes through the rings
    step : at which
    """
    for k, thread in zip(schedule.rings, balance.threads, strict=True):
        if not 0.0 < thread.place < schedule.n:
            end = 0 if thread.place <= 0.0 else schedule.n
            what = called(schedule.boundaries, schedule.boundaries[k])
            sentence = f"step {step}: the line slid out of {what} with its node {end}"
            return Reason("left_ring", sentence, step, end)
    return None
