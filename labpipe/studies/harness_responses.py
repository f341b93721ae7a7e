"""What the numbers of a harness are made of: vectors that answer smoothly to what moves a line.

A norm, a least or a largest value has corners where what it is of goes through nothing or changes
its place. So bands respond in these fields, and each number is taken of them draw by draw, by the
function that takes it of a line that was solved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import reduce

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.rod import boundaries as rod
from labpipe.rod.line import Line
from labpipe.rod.path import RodPath, RodState
from labpipe.rod.response import Fields, sizes
from labpipe.rod.rotations import unit
from labpipe.studies.harness_line import PreparedLine
from labpipe.studies.residual_curvature import curvature_after_release

LOWEST_POINT, RADIUS = "lowest_point", "smallest_bend_radius"
RADIUS_ON_PATH = f"{RADIUS}_on_the_way"
ENERGY_LOST, RESIDUAL = "energy_lost", "kept_curvature"
FORCE, MOMENT, SPRINGBACK = "force.", "moment.", "springback."
POSITIONS, CURVATURES = "places", "bent "
HOLDS = rod.Held | rod.Ring | rod.String | rod.Plane
_UP = np.array([0.0, 0.0, 1.0])


def curvature_vectors(state: RodState, line: Line) -> Floats:
    """Curvature vectors across the line as it lies, 1/m, shape (n + 1, 2, 2).

    What it has at rest included; before and behind every node, which a clip may part.

    Parameters
    ----------
    state : of the line
    line : that it is a state of
    """
    return np.asarray(state.node_curvatures[:, :, :2] + line.natural_at_nodes[:, None, :2])


def largest_of_sides(bent: Floats) -> Floats:
    """Curvature at the nodes, 1/m, shape (..., n + 1): the larger one of both sides.

    Parameters
    ----------
    bent : curvature vectors, shape (..., n + 1, 2, 2)
    """
    return np.asarray(sizes(bent).max(axis=-1))


def heights_of(places: Floats, prepared: PreparedLine) -> Floats:
    """Heights above the origin, against gravity, m, shape (..., n + 1); z of a line without weight.

    Parameters
    ----------
    places : positions, shape (..., n + 1, 3)
    prepared : line and what pulls it
    """
    weights = [
        boundary.vector[-1] for boundary in prepared.boundaries if isinstance(boundary, rod.Gravity)
    ]
    return np.asarray(places @ (-unit(weights[0]) if weights else _UP))


def fields_of(path: RodPath, prepared: PreparedLine) -> dict[str, Floats]:
    """Fields of a path that came to its end, by name.

    Parameters
    ----------
    path : as followed
    prepared : that was followed

    Returns
    -------
    `POSITIONS` of the nodes at the last step (n + 1, 3); ``bent 0`` and so on, one for each step, as
    of `curvature_vectors`; forces, moments and springback as vectors (3,), by the names of the numbers;
    `RESIDUAL`, curvature vectors as `curvature_after_release` has them; `ENERGY_LOST`.
    """
    last, line = path.last, prepared.line
    bent = {
        f"{CURVATURES}{step}": curvature_vectors(state, line)
        for step, state in enumerate(path.states)
    }
    return (
        bent
        | dict(_boundary_fields(path, prepared))
        | {
            POSITIONS: last.positions,
            RESIDUAL: curvature_after_release(line.section.law, last.rests),
            ENERGY_LOST: np.asarray(path.lost[-1]),
        }
    )


def _boundary_fields(path: RodPath, prepared: PreparedLine) -> Iterator[tuple[str, Floats]]:
    last = path.last
    for number, boundary in enumerate(prepared.boundaries):
        if isinstance(boundary, HOLDS):
            yield f"{FORCE}{boundary.name}", last.reaction_forces[number]
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield f"{MOMENT}{boundary.name}", last.reaction_moments[number]
        if isinstance(boundary, rod.Held) and boundary.release is not None:
            node = prepared.nodes[boundary.name]
            before = path.states[boundary.release - 1].positions[node]
            yield f"{SPRINGBACK}{boundary.name}", last.positions[node] - before


def number_names(fields: Fields) -> tuple[str, ...]:
    """Names of the numbers that fields give.

    Parameters
    ----------
    fields : of a line
    """
    at_boundaries = [
        field for field in fields if field != POSITIONS and not field.startswith(CURVATURES)
    ]
    return (RADIUS, RADIUS_ON_PATH, LOWEST_POINT, *at_boundaries)


def evaluate_number(
    name: str, field: Callable[[str], Floats], prepared: PreparedLine, steps: int
) -> Floats:
    """A number of some fields; of a bend radius, its curvature, 1/m, which a straight line has.

    Parameters
    ----------
    name : of the number
    field : gives a field by its name; with leading axes where it is drawn, which the number keeps
    prepared : line and what pulls it
    steps : the last of them
    """
    if name == RADIUS:
        return _max_curvature(field(f"{CURVATURES}{steps}"))
    if (
        name == RADIUS_ON_PATH
    ):  # one step after the other: draws of all at once would fill the memory
        return reduce(
            np.maximum, (_max_curvature(field(f"{CURVATURES}{step}")) for step in range(steps + 1))
        )
    if name == LOWEST_POINT:
        return np.asarray(heights_of(field(POSITIONS), prepared).min(axis=-1))
    if name == RESIDUAL:
        return _max_curvature(field(RESIDUAL))
    return np.maximum(field(ENERGY_LOST), 0.0) if name == ENERGY_LOST else sizes(field(name))


def _max_curvature(bent: Floats) -> Floats:
    return np.asarray(largest_of_sides(bent).max(axis=-1))
