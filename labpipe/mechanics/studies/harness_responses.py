"""Fields from which the numbers of a harness are computed: vectors that respond smoothly to inputs.

A norm, a minimum or a maximum is not smooth at zero or where its place changes. Therefore the
response is linear in these fields, and each number is computed from them in every draw as from a
solved line. Residual curvature of a released line is that by Masing's rule, and at most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import reduce

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.response import Fields, sizes
from labpipe.mechanics.rod.rotations import unit
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.records.arrays import Floats
from labpipe.records.quality import Reason

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


_MIN_CURVATURE = 1e-3
"""1/m; below it a line is straight."""


def curvature_after_release(law: SliderLaw, rests: Floats) -> Floats:
    """Return the curvature of each station after release, 1/m, shape (..., 2).

    Parameters
    ----------
    law : of every station
    rests : 1/m, shape (..., sliders, 2): rest curvatures of its sliders

    Notes
    -----
    The curvature at zero moment, where sliders slide in the other direction: EI_0 kappa + sum of
    w_j (kappa - a_j) = 0 with w_j = K_j min(1, kappa_j / |kappa - a_j|), solved for kappa with the
    w_j of the step before (Weiszfeld's iteration, which descends on a convex energy). It starts
    at the curvature reached if no slider slides. Without sliders it is 0.
    """
    max_iterations, relative_tolerance = 1000, 1e-9
    curvature = np.zeros((*rests.shape[:-2], 2))
    if not len(law.stiffnesses):
        return curvature
    weights = np.broadcast_to(law.stiffnesses, rests.shape[:-1])
    for _ in range(max_iterations):
        total = law.stiffness + weights.sum(axis=-1)
        previous, curvature = (
            curvature,
            np.einsum("...j,...jx->...x", weights, rests) / total[..., None],
        )
        if np.max(np.abs(curvature - previous)) <= relative_tolerance * np.max(np.abs(curvature)):
            break
        bent = np.linalg.norm(curvature[..., None, :] - rests, axis=-1)
        weights = law.stiffnesses * law.slip_curvatures / np.maximum(bent, law.slip_curvatures)
    return curvature


def residual_curvature(state: RodState, law: SliderLaw) -> Floats:
    """Return the curvature of the line if it were released, 1/m, shape (n + 1,).

    Parameters
    ----------
    state : with the state of its sliders
    law : of the line

    Notes
    -----
    Without natural curvature. See `curvature_after_release`; the larger one where both sides of a
    node differ at a clip.
    """
    return np.asarray(np.linalg.norm(curvature_after_release(law, state.rests), axis=2).max(axis=1))


def max_residual_curvature(path: RodPath, law: SliderLaw) -> Floats:
    """Return the residual curvature if no slider slid on unloading, 1/m, shape (n + 1,).

    Parameters
    ----------
    path : of the line
    law : of the line

    Notes
    -----
    From the largest bend of each node: sum of K_j a_j over the first stiffness.
    """
    if not len(law.stiffnesses):
        return np.zeros(len(path.last.positions))
    sizes = [
        np.linalg.norm(np.einsum("j,nsjx->nsx", law.stiffnesses, state.rests), axis=2).max(axis=1)
        for state in path.states
    ]
    return np.asarray(np.max(sizes, axis=0) / law.first_stiffness)


def largest_unbending(path: RodPath) -> float:
    """Return the largest decrease of curvature at a node over the sharpest bend of the line.

    Parameters
    ----------
    path : of the line
    """
    bent = np.array([state.bendings for state in path.states])
    most = bent.max(axis=0)
    return float(np.max(most - bent[-1]) / max(float(most.max()), _MIN_CURVATURE))


def unloading_reason(path: RodPath, line: Line) -> Reason | None:
    """Return the reason why numbers that depend on unloading are doubtful, if they are.

    Parameters
    ----------
    path : of the line
    line : of the path

    Notes
    -----
    The law of a wire is that of first loading; on unloading it follows Masing's rule, by which
    copper springs back two to four times as far as standards of annealed wire allow.
    """
    law = line.section.law
    largest = max_residual_curvature(path, law)
    node = int(np.argmax(largest))
    residual = float(residual_curvature(path.last, law)[node])
    if largest[node] <= max(_MIN_CURVATURE, 1.1 * residual):
        return None
    message = (
        "unloading is computed from the first loading by Masing's rule, which overestimates the "
        f"springback of copper: {1e3 * line.stations[node]:.4g} mm from the start the residual "
        f"curvature is {residual:.3g} 1/m by the rule and {largest[node]:.3g} 1/m without sliding "
        "on unloading"
    )
    return Reason("unloading_assumed", message)
