"""Numbers of a solved harness: bend radii, forces, springback, residual curvature, lost energy.

Numbers are computed from *fields*: vectors along the line that depend smoothly on the uncertain
inputs. A norm, a minimum or a maximum is not smooth where it is zero or where its place changes.
Therefore the fields are extrapolated linearly in the inputs, and every number is then computed from
the extrapolated fields in the same way as from a solved line.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw, present_sliders
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.bands import compute_node_curvature
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.rotations import unit
from labpipe.mechanics.studies.harness_material import Material
from labpipe.messages import format_sentence
from labpipe.protocol.harness_file import HarnessFile
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status

LOWEST_POINT, RADIUS = "lowest_point", "smallest_bend_radius"
RADIUS_ON_PATH = f"{RADIUS}_on_the_way"
ENERGY_LOST, RESIDUAL = "energy_lost", "kept_curvature"
FORCE, MOMENT, SPRINGBACK = "force.", "moment.", "springback."
POSITIONS, CURVATURES = "positions", "curvature_vectors "
HOLDS = rod.Held | rod.Ring | rod.String | rod.Plane
_UNITS = {
    RADIUS: "m",
    LOWEST_POINT: "m",
    FORCE: "N",
    MOMENT: "N*m",
    SPRINGBACK: "m",
    RESIDUAL: "1/m",
    ENERGY_LOST: "J",
}
"""SI unit of a number, by the beginning of its name."""


def collect_fields(path: RodPath) -> dict[str, Floats]:
    """Collect the fields of a complete path, by name.

    Parameters
    ----------
    path : of the line

    Returns
    -------
    `POSITIONS` : of the nodes at the last step, m, (n + 1, 3)
    ``curvature_vectors 0`` ... : of each step, 1/m, (n + 1, 2, 2)
    force, moment, springback : vectors (3,), by the names of their numbers
    `RESIDUAL` : vectors of `compute_released_curvature`
    `ENERGY_LOST` : J
    """
    curvatures = {
        f"{CURVATURES}{step}": state.curvature_vectors for step, state in enumerate(path.states)
    }
    return {
        **curvatures,
        **dict(_collect_boundary_fields(path)),
        POSITIONS: path.last.positions,
        RESIDUAL: compute_released_curvature(path.line.section.law, path.last.rests),
        ENERGY_LOST: np.asarray(path.lost[-1]),
    }


def _collect_boundary_fields(path: RodPath) -> Iterator[tuple[str, Floats]]:
    """Yield forces and moments of the boundaries, then the springback of the released ones."""
    for number, boundary in enumerate(path.boundaries):
        if isinstance(boundary, HOLDS):
            yield f"{FORCE}{boundary.name}", path.last.reaction_forces[number]
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield f"{MOMENT}{boundary.name}", path.last.reaction_moments[number]
    for boundary, release in list_releases(path):
        start = path.states[release - 1].positions[boundary.node]
        yield f"{SPRINGBACK}{boundary.name}", path.last.positions[boundary.node] - start


def list_releases(path: RodPath) -> list[tuple[rod.Held, int]]:
    """List the boundaries that release the line, and the first step without each."""
    held = [boundary for boundary in path.boundaries if isinstance(boundary, rod.Held)]
    return [(edge, edge.release) for edge in held if edge.release is not None]


def evaluate_numbers(field: Callable[[str], Floats], path: RodPath) -> dict[str, Floats]:
    """Compute all numbers from fields; for a bend radius, its curvature, 1/m.

    Parameters
    ----------
    field : returns a field by its name; leading axes (draws) are kept
    path : of the line, at the best inputs
    """
    # step by step, which limits memory for draws
    sharpest = (_find_max(field(f"{CURVATURES}{step}")) for step in range(len(path.states)))
    vectors = [name for name, _ in _collect_boundary_fields(path)]
    return {
        RADIUS: _find_max(field(f"{CURVATURES}{len(path.states) - 1}")),
        RADIUS_ON_PATH: reduce(np.maximum, sharpest),
        LOWEST_POINT: np.asarray(compute_heights(field(POSITIONS), path).min(axis=-1)),
        **{name: np.asarray(np.linalg.norm(field(name), axis=-1)) for name in vectors},
        RESIDUAL: _find_max(field(RESIDUAL)),
        ENERGY_LOST: np.maximum(field(ENERGY_LOST), 0.0),
    }


def _find_max(vectors: Floats) -> Floats:
    return np.asarray(compute_node_curvature(vectors).max(axis=-1))


def compute_heights(positions: Floats, path: RodPath) -> Floats:
    """Compute heights against gravity, m, shape (..., n + 1); z for a line without weight.

    Parameters
    ----------
    positions : m, shape (..., n + 1, 3)
    path : of the line
    """
    weights = [edge.vector[-1] for edge in path.boundaries if isinstance(edge, rod.Gravity)]
    return np.asarray(positions @ (-unit(weights[0]) if weights else [0.0, 0.0, 1.0]))


def compute_released_curvature(law: SliderLaw, rests: Floats) -> Floats:
    """Compute the curvature of each station after release, 1/m, shape (..., 2).

    Parameters
    ----------
    law : of every station
    rests : 1/m, shape (..., sliders, 2): rest curvatures of its sliders

    Notes
    -----
    This is the curvature at zero moment, on the way to which sliders slide back. It solves EI_0
    kappa + sum of w_j (kappa - a_j) = 0 with w_j = K_j min(1, kappa_j / |kappa - a_j|), by
    Weiszfeld's iteration: each iteration takes the w_j of the one before, and descends on a convex
    energy. The first one assumes that no slider slides. Without sliders the curvature is 0. The
    limit of a growing slider remains, as it does not slide on release.
    """
    max_iterations, relative_tolerance = 1000, 1e-9
    curvature = np.zeros((*rests.shape[:-2], 2))
    sliders = present_sliders(law, rests)
    stiffnesses, slips = sliders.stiffnesses, sliders.slip_curvatures
    if not len(stiffnesses):
        return curvature
    weights = np.broadcast_to(stiffnesses, slips.shape)
    for _ in range(max_iterations):
        total = law.stiffness + weights.sum(axis=-1)
        previous, curvature = (
            curvature,
            np.einsum("...j,...jx->...x", weights, sliders.rests) / total[..., None],
        )
        if np.max(np.abs(curvature - previous)) <= relative_tolerance * np.max(np.abs(curvature)):
            break
        strains = np.linalg.norm(curvature[..., None, :] - sliders.rests, axis=-1)
        weights = stiffnesses * slips / np.maximum(strains, slips)
    return curvature


def compute_residual_curvature(state: RodState, law: SliderLaw) -> Floats:
    """Compute the curvature of the line after a release, 1/m, shape (n + 1,).

    Parameters
    ----------
    state : with the state of its sliders
    law : of the line

    Notes
    -----
    See `compute_released_curvature`. Natural curvature is not included. Where both sides of a node
    differ, at a clip, it is the larger one.
    """
    return compute_node_curvature(compute_released_curvature(law, state.rests))


def compute_curvature(state: RodState) -> Floats:
    """Compute the curvature of the line, 1/m, shape (n + 1,), natural curvature included.

    Where both sides of a node differ, at a clip, it is the larger one.
    """
    return compute_node_curvature(state.curvature_vectors)


def compute_radius(curvature: Floats) -> Floats:
    """Compute the bend radius, m; infinite where the line is straight.

    Parameters
    ----------
    curvature : 1/m, any shape
    """
    min_curvature = 1e-6  # 1/m
    is_bent = curvature > min_curvature
    return np.asarray(np.where(is_bent, 1.0 / np.where(is_bent, curvature, 1.0), np.inf))


@dataclass(frozen=True, slots=True)
class BendLimit:
    """The allowed bend radius.

    Parameters
    ----------
    radius : m
    source : of the number
    is_assumed : whether the file does not state it
    """

    radius: float
    source: str
    is_assumed: bool


@dataclass(frozen=True, slots=True)
class Bend:
    """The sharpest bend of a line.

    Parameters
    ----------
    radius : m; infinite for a straight line
    step : number
    place : m along the line
    """

    radius: float
    step: int
    place: float


def find_bend_limit(harness: HarnessFile, material: Material) -> BendLimit:
    """Return the allowed bend radius, stated or assumed.

    Parameters
    ----------
    harness : may state it
    material : of the line, with its diameter
    """
    if harness.allowed_bend_radius is not None:
        return BendLimit(harness.allowed_bend_radius, "stated in the file", is_assumed=False)
    diameters = 5.0
    source = format_sentence(
        "mechanics.studies.assumed_radius", times=diameters, diameter=1e3 * material.diameter
    )
    return BendLimit(diameters * material.diameter, source, is_assumed=True)


def find_sharpest_bend(path: RodPath, steps: Sequence[int]) -> Bend:
    """Find the sharpest bend among some steps.

    Parameters
    ----------
    path : of the line
    steps : at least one
    """
    row, node, curvature = find_largest([compute_curvature(path.states[step]) for step in steps])
    radius = float(compute_radius(np.array(curvature)))
    return Bend(radius, steps[row], float(path.line.stations[node]))


def find_largest(values_by_step: Sequence[Floats]) -> tuple[int, int, float]:
    """Return step and node (or element) of the largest value, and the value."""
    values = np.array(values_by_step)
    row, place = divmod(int(np.argmax(values)), values.shape[1])
    return row, place, float(values[row, place])


@dataclass(frozen=True, slots=True)
class Number:
    """A number of a harness.

    Parameters
    ----------
    name : of the result
    value : in `unit`; infinite for the bend radius of a straight line
    unit : SI
    remark : place and step
    """

    name: str
    value: float
    unit: str
    remark: str = ""


def estimate_sizes(line: Line) -> dict[str, float]:
    """Estimate the magnitude of quantities by unit for a line bent to the curvature 1 / length."""
    length, moment = line.length, line.section.law.first_stiffness / line.length
    return {"m": length, "1/m": 1.0 / length, "N": moment / length, "N*m": moment, "J": moment}


def compute_numbers(path: RodPath) -> tuple[Number, ...]:
    """Compute the numbers of a harness at its last step and over the whole path.

    Parameters
    ----------
    path : of the line, to the last step
    """
    last = len(path.states) - 1
    values = evaluate_numbers(collect_fields(path).__getitem__, path)
    end, overall = find_sharpest_bend(path, [last]), find_sharpest_bend(path, range(last + 1))
    values |= {RADIUS: np.array(end.radius), RADIUS_ON_PATH: np.array(overall.radius)}
    remarks = _describe_numbers(path, end, overall)
    return tuple(
        Number(name, float(value), find_unit(name), remarks.get(name, ""))
        for name, value in values.items()
    )


def find_unit(name: str) -> str:
    """Return the unit of a number."""
    return next(unit for start, unit in _UNITS.items() if name.startswith(start))


def _describe_numbers(path: RodPath, end: Bend, overall: Bend) -> dict[str, str]:
    """Return the remarks of numbers, by name: places and steps."""
    law, stations = path.line.section.law, path.line.stations
    lowest = int(np.argmin(compute_heights(path.last.positions, path)))
    remarks = {
        RADIUS: format_place(end.place),
        RADIUS_ON_PATH: f"step {overall.step}, {format_place(overall.place)}",
        LOWEST_POINT: format_place(stations[lowest]),
        ENERGY_LOST: "in bending, since the start",
    }
    forces = np.array([np.linalg.norm(state.reaction_forces, axis=1) for state in path.states])
    for number, boundary in enumerate(path.boundaries):
        step = int(np.argmax(forces[:, number]))
        place = f"{forces[step, number]:.4g} N at step {step}"
        remarks[f"{FORCE}{boundary.name}"] = f"largest in all steps: {place}"
    for boundary, release in list_releases(path):
        place = f"from its place in step {release - 1}, the last one before the release"
        remarks[f"{SPRINGBACK}{boundary.name}"] = place
    residual = compute_residual_curvature(path.last, law)
    node = int(np.argmax(residual))
    if residual[node]:
        rule = "" if law.growing else ", by Masing's rule"
        remarks[RESIDUAL] = f"{format_place(stations[node])}; if released{rule}"
    return remarks


def format_place(station: float) -> str:
    """Format a place on the line, m."""
    return f"{1e3 * station:.4g} mm from the start"


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reason why some of the numbers are doubtful.

    Parameters
    ----------
    reason : of the doubt
    names : of these numbers, or the beginnings of their names
    """

    reason: Reason
    names: tuple[str, ...]

    def concerns(self, name: str) -> bool:
        """Return whether the doubt is about a number."""
        # the name of this number begins with that of another one
        is_named = name != RADIUS_ON_PATH or RADIUS_ON_PATH in self.names
        return name.startswith(self.names) and is_named


def build_results(
    numbers: Sequence[Number],
    reasons: tuple[Reason, ...],
    intervals: Mapping[str, Interval],
    doubts: Sequence[Doubt] = (),
) -> tuple[Result, ...]:
    """Return numbers as results.

    Parameters
    ----------
    numbers : of a harness
    reasons : why all of them are doubtful
    intervals : by name, of the numbers that have one
    doubts : about some of the numbers
    """
    results = []
    for number in numbers:
        name, own = number.name, [doubt.reason for doubt in doubts if doubt.concerns(number.name)]
        if not math.isfinite(number.value):
            straight = (Reason.of("mechanics.studies.straight"),)
            results.append(Result(name, None, number.unit, None, Status.FAILED, straight))
            continue
        status = Status.DOUBTFUL if reasons or own else Status.OK
        results.append(
            Result(
                *(name, number.value, number.unit, intervals.get(name), status, (*reasons, *own)),
                remark=number.remark,
            )
        )
    return tuple(results)
