"""Fields from which the numbers of a harness are computed: vectors that respond smoothly to inputs.

A norm, a minimum or a maximum is not smooth at zero or where its place changes. Therefore the
response is linear in these fields, and each number is computed from them in every draw as from a
solved line.
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


def curvature_vectors(state: RodState, line: Line) -> Floats:
    """Return the curvature vectors of the line, 1/m, shape (n + 1, 2, 2).

    Natural curvature included; on both sides of every node, which differ at a clip.

    Parameters
    ----------
    state : of the line
    line : in this state
    """
    return np.asarray(state.node_curvatures[:, :, :2] + line.rest_curvature_at_nodes[:, None, :2])


def largest_of_sides(bent: Floats) -> Floats:
    """Return the curvature at the nodes, 1/m, shape (..., n + 1): the larger one of both sides.

    Parameters
    ----------
    bent : curvature vectors, shape (..., n + 1, 2, 2)
    """
    return np.asarray(sizes(bent).max(axis=-1))


def heights_of(places: Floats, prepared: PreparedLine) -> Floats:
    """Return heights against gravity, m, shape (..., n + 1); z of a line without weight.

    Parameters
    ----------
    places : positions, shape (..., n + 1, 3)
    prepared : line and boundaries
    """
    weights = [
        boundary.vector[-1] for boundary in prepared.boundaries if isinstance(boundary, rod.Gravity)
    ]
    return np.asarray(places @ (-unit(weights[0]) if weights else [0.0, 0.0, 1.0]))


def fields_of(path: RodPath, prepared: PreparedLine) -> dict[str, Floats]:
    """Return the fields of a complete path, by name.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries

    Returns
    -------
    `POSITIONS` of the nodes at the last step (n + 1, 3); `curvature_vectors` of each step under
    ``bent 0`` and so on; forces, moments and springback as vectors (3,), by the names of the
    numbers; `RESIDUAL`, the vectors of `curvature_after_release`; `ENERGY_LOST`.
    """
    last, line = path.last, prepared.line
    bent = [curvature_vectors(state, line) for state in path.states]
    return {
        **{f"{CURVATURES}{step}": vectors for step, vectors in enumerate(bent)},
        **dict(_boundary_fields(path, prepared)),
        POSITIONS: last.positions,
        RESIDUAL: curvature_after_release(line.section.law, last.rests),
        ENERGY_LOST: np.asarray(path.lost[-1]),
    }


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
    """Return the names of the numbers of fields.

    Parameters
    ----------
    fields : of a line
    """
    shape = (POSITIONS, CURVATURES)
    others = [field for field in fields if not field.startswith(shape)]
    return (RADIUS, RADIUS_ON_PATH, LOWEST_POINT, *others)


def evaluate_number(
    name: str, field: Callable[[str], Floats], prepared: PreparedLine, steps: int
) -> Floats:
    """Compute a number from fields; instead of a bend radius its curvature, 1/m.

    Parameters
    ----------
    name : of the number
    field : returns a field by its name; leading axes, of draws, are kept
    prepared : line and boundaries
    steps : number of the last one
    """
    if name == RADIUS:
        return _max_curvature(field(f"{CURVATURES}{steps}"))
    if name == RADIUS_ON_PATH:  # step by step, to limit the memory for draws
        names = (f"{CURVATURES}{step}" for step in range(steps + 1))
        return reduce(np.maximum, (_max_curvature(field(name)) for name in names))
    if name == LOWEST_POINT:
        return np.asarray(heights_of(field(POSITIONS), prepared).min(axis=-1))
    if name == RESIDUAL:
        return _max_curvature(field(RESIDUAL))
    return np.maximum(field(ENERGY_LOST), 0.0) if name == ENERGY_LOST else sizes(field(name))


def _max_curvature(bent: Floats) -> Floats:
    return np.asarray(largest_of_sides(bent).max(axis=-1))
