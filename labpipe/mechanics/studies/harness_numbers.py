"""Compute and check the numbers of a solved harness: bend radii, forces, residual curvature.

Numbers are computed from *fields*, which are arrays along the line that depend smoothly on the
uncertain inputs. A norm is not smooth where it vanishes, and a maximum is not smooth where its
location changes. Therefore the fields are extrapolated linearly in the inputs, and each number is
computed from the extrapolated fields in the same way as from a solved line.

Sliders and friction depend on the loading path, which is linear within a step. The error of the
steps decreases at least linearly with their size. This error is therefore bounded by the change
from a solution with half as many steps. When the number of steps is halved, steps at corners of a
path are kept. If more than three quarters of the steps would be kept, the number of steps is
doubled instead. The error of the elements decreases with the square of their length. This error is
estimated as a third of the change from a solution with half as many elements.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw, get_current_sliders
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.bands import collect_step_fields, compute_node_curvature
from labpipe.mechanics.rod.line import Line, format_position
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.rotations import conjugate, multiply, normalise, to_rotation_vectors
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import Material, PreparedLine
from labpipe.messages import format_sentence
from labpipe.protocol.model_files import HarnessFile
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status

LOWEST_POINT, RADIUS = "lowest_point", "smallest_bend_radius"
PATH_RADIUS = f"{RADIUS}_on_the_way"
LOST_ENERGY, RESIDUAL_CURVATURE = "energy_lost", "kept_curvature"
FORCE_PREFIX, MOMENT_PREFIX, SPRINGBACK_PREFIX = "force.", "moment.", "springback."
"""Names of numbers, and beginnings of names that end with the name of a boundary."""
SUPPORT_TYPES = rod.Held | rod.Ring | rod.String | rod.Plane
"""Types of boundaries that exert a reaction force."""
_UNITS_BY_PREFIX = {
    RADIUS: "m",
    LOWEST_POINT: "m",
    FORCE_PREFIX: "N",
    MOMENT_PREFIX: "N*m",
    SPRINGBACK_PREFIX: "m",
    RESIDUAL_CURVATURE: "1/m",
    LOST_ENERGY: "J",
}
"""SI unit of a number, keyed by the beginning of the number's name."""


def collect_fields(path: RodPath) -> dict[str, Floats]:
    """Collect the fields of a complete path, keyed by name.

    Parameters
    ----------
    path : path of the line

    Returns
    -------
    Fields of `collect_step_fields`; under `RESIDUAL_CURVATURE`, the vectors of
    `compute_released_curvature`, 1/m; under `LOST_ENERGY`, the energy lost in bending, J.
    """
    return {
        **collect_step_fields(path),
        RESIDUAL_CURVATURE: compute_released_curvature(
            path.line.section.law, path.last.slider_rests
        ),
        LOST_ENERGY: np.asarray(path.lost_energy[-1]),
    }


def list_releases(path: RodPath) -> list[tuple[rod.Held, int]]:
    """Return the supports that release the line, with the first step after each release."""
    supports = [boundary for boundary in path.boundaries if isinstance(boundary, rod.Held)]
    return [(support, support.release) for support in supports if support.release is not None]


def evaluate_numbers(get_field: Callable[[str], Floats], path: RodPath) -> dict[str, Floats]:
    """Compute all numbers from fields.

    Parameters
    ----------
    get_field : function that returns the field of a name; a field may have leading axes, such as an
        axis of draws
    path : path of the line at the best inputs

    Returns
    -------
    Numbers in SI units, keyed by name, with the leading axes of the fields. A curvature, 1/m,
    replaces each bend radius.
    """
    last_step = len(path.states) - 1
    vectors = {}  # keyed by the names of numbers that are norms
    positions, forces, moments = (
        get_field(f"{name} {last_step}")
        for name in ("positions", "reaction_forces", "reaction_moments")
    )
    for index, boundary in enumerate(path.boundaries):
        if isinstance(boundary, SUPPORT_TYPES):
            vectors[f"{FORCE_PREFIX}{boundary.name}"] = forces[..., index, :]
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            vectors[f"{MOMENT_PREFIX}{boundary.name}"] = moments[..., index, :]
    for support, release_step in list_releases(path):
        displacements = positions - get_field(f"positions {release_step - 1}")
        vectors[f"{SPRINGBACK_PREFIX}{support.name}"] = displacements[..., support.node, :]
    curvatures = [
        _compute_max_norm(get_field(f"curvature_vectors {step}")) for step in range(last_step + 1)
    ]
    return {
        RADIUS: curvatures[-1],
        PATH_RADIUS: np.max(curvatures, axis=0),
        LOWEST_POINT: np.asarray(compute_heights(positions, path).min(axis=-1)),
        **{name: np.asarray(np.linalg.norm(vector, axis=-1)) for name, vector in vectors.items()},
        RESIDUAL_CURVATURE: _compute_max_norm(get_field(RESIDUAL_CURVATURE)),
        LOST_ENERGY: np.maximum(get_field(LOST_ENERGY), 0.0),
    }


def _compute_max_norm(vectors: Floats) -> Floats:
    """Compute the largest norm of curvature vectors along the line, 1/m."""
    squares = vectors[..., 0] ** 2 + vectors[..., 1] ** 2
    return np.asarray(np.sqrt(squares.max(axis=(-2, -1))))


def compute_heights(positions: Floats, path: RodPath) -> Floats:
    """Compute the heights of nodes in the direction opposite to gravity, or along z without it.

    Parameters
    ----------
    positions : shape (..., n + 1, 3), positions of the nodes of n elements, m
    path : path of the line

    Returns
    -------
    Heights, shape (..., n + 1), m.
    """
    vectors = [item.vector[-1] for item in path.boundaries if isinstance(item, rod.Gravity)]
    return np.asarray(positions @ (-normalise(vectors[0]) if vectors else [0.0, 0.0, 1.0]))


def compute_released_curvature(law: SliderLaw, slider_rests: Floats) -> Floats:
    """Compute the curvature of each station at zero moment, after a release.

    Parameters
    ----------
    law : law of all stations
    slider_rests : shape (..., n, 2), history of the sliders, 1/m; see `SliderResponse`

    Returns
    -------
    Curvature vectors, shape (..., 2), 1/m.

    Notes
    -----
    Sliders may slide back during release. The curvature kappa is the solution of
    EI_0 kappa + sum of w_j (kappa - a_j) = 0 with w_j = K_j min(1, kappa_j / |kappa - a_j|). Here
    EI_0 is the stiffness of the spring. K_j, kappa_j and a_j are the stiffness, the slip curvature
    and the history of slider j. In Weiszfeld's iteration, w_j is computed from the curvature of the
    previous iteration. Each iteration decreases a convex energy. The first iteration assumes that
    no slider slides. Without sliders, the curvature is 0. The slip curvature of a growing slider is
    assumed not to grow during release.
    """
    max_iterations, tolerance = 1000, 1e-9  # tolerance relative to the largest curvature
    curvature = np.zeros((*slider_rests.shape[:-2], 2))
    sliders = get_current_sliders(law, slider_rests)
    slip_curvatures, rest_curvatures = sliders.slip_curvatures, sliders.rest_curvatures
    if not len(sliders.stiffnesses):
        return curvature
    weights = np.broadcast_to(sliders.stiffnesses, slip_curvatures.shape)
    for _ in range(max_iterations):
        stiffness = law.spring_stiffness + weights.sum(axis=-1)
        previous_curvature = curvature
        curvature = np.einsum("...j,...jx->...x", weights, rest_curvatures) / stiffness[..., None]
        if np.max(np.abs(curvature - previous_curvature)) <= tolerance * np.max(np.abs(curvature)):
            break
        distances = np.linalg.norm(curvature[..., None, :] - rest_curvatures, axis=-1)
        weights = sliders.stiffnesses * slip_curvatures / np.maximum(distances, slip_curvatures)
    return curvature


def compute_residual_curvature(state: RodState, law: SliderLaw) -> Floats:
    """Compute the curvature of the line after a release, without the curvature at rest.

    Parameters
    ----------
    state : state of the line, with the history of its sliders
    law : law of the line

    Returns
    -------
    Curvature, shape (n + 1,), 1/m; see `compute_released_curvature`. If the curvatures on the two
    sides of a node differ, as at a clip, the larger curvature is returned.
    """
    return compute_node_curvature(compute_released_curvature(law, state.slider_rests))


def compute_curvature(state: RodState) -> Floats:
    """Compute the curvature of the line, shape (n + 1,), 1/m, including the curvature at rest.

    If the curvatures on the two sides of a node differ, as at a clip, the larger one is returned.
    """
    return compute_node_curvature(state.curvature_vectors)


def compute_radius(curvature: Floats) -> Floats:
    """Compute the bend radius, m, which is infinite for a curvature of at most 1e-6 1/m.

    Parameters
    ----------
    curvature : curvature, any shape, 1/m
    """
    min_curvature = 1e-6  # 1/m
    is_bent = curvature > min_curvature
    return np.asarray(np.where(is_bent, 1.0 / np.where(is_bent, curvature, 1.0), np.inf))


@dataclass(frozen=True, slots=True)
class BendLimit:
    """Allowed bend radius.

    Parameters
    ----------
    radius : smallest allowed bend radius, m
    source : source of the radius, for messages
    is_assumed : whether the radius is assumed because the file does not state it
    """

    radius: float
    source: str
    is_assumed: bool


@dataclass(frozen=True, slots=True)
class Bend:
    """Sharpest bend of a line.

    Parameters
    ----------
    radius : bend radius, m; infinite for a straight line
    step : number of the step at which the bend occurs
    arc_length : distance of the bend from the start along the line, m
    """

    radius: float
    step: int
    arc_length: float


def choose_bend_limit(harness: HarnessFile, material: Material) -> BendLimit:
    """Choose the allowed bend radius: that in the file, or else a multiple of the diameter.

    Parameters
    ----------
    harness : harness as described by its file
    material : material of the line
    """
    if harness.allowed_bend_radius is not None:
        return BendLimit(harness.allowed_bend_radius, "stated in the file", is_assumed=False)
    radius_ratio = 5.0  # allowed radius over diameter: an assumption, which `source` states
    values = {"ratio": radius_ratio, "diameter": 1e3 * material.diameter}
    source = format_sentence("mechanics.studies.assumed_radius", **values)
    return BendLimit(radius_ratio * material.diameter, source, is_assumed=True)


def find_sharpest_bend(path: RodPath, steps: Sequence[int]) -> Bend:
    """Find the sharpest bend of a line in given steps. For a failed line, the radius is NaN.

    Parameters
    ----------
    path : path of the line
    steps : numbers of the steps, at least one
    """
    if path.status is Status.FAILED:
        return Bend(math.nan, -1, math.nan)
    row, node, curvature = find_maximum([compute_curvature(path.states[step]) for step in steps])
    radius = float(compute_radius(np.array(curvature)))
    return Bend(radius, steps[row], float(path.line.stations[node]))


def find_maximum(values_by_step: Sequence[Floats]) -> tuple[int, int, float]:
    """Find the largest value in all steps, and return its row, its column and the value.

    Parameters
    ----------
    values_by_step : values along the line, shape (n,), for each step
    """
    values = np.array(values_by_step)
    row, column = divmod(int(np.argmax(values)), values.shape[1])
    return row, column, float(values[row, column])


def estimate_magnitudes(line: Line) -> dict[str, float]:
    """Estimate the magnitudes of quantities of a line that is bent to a curvature of 1 / length.

    Parameters
    ----------
    line : line in its shape at rest

    Returns
    -------
    Magnitudes, keyed by SI unit.
    """
    length, moment = line.length, line.section.law.first_stiffness / line.length
    return {"m": length, "1/m": 1.0 / length, "N": moment / length, "N*m": moment, "J": moment}


def compute_numbers(path: RodPath) -> dict[str, float]:
    """Compute the numbers of a harness at its last step and over the whole path.

    Parameters
    ----------
    path : complete path of the line

    Returns
    -------
    Numbers in the units of `get_unit`, keyed by name. The bend radius of a straight line is
    infinite.
    """
    values = evaluate_numbers(collect_fields(path).__getitem__, path)
    values |= {name: compute_radius(values[name]) for name in (RADIUS, PATH_RADIUS)}
    return {name: float(value) for name, value in values.items()}


def get_unit(name: str) -> str:
    """Return the SI unit of a number.

    Parameters
    ----------
    name : name of the number
    """
    return next(unit for prefix, unit in _UNITS_BY_PREFIX.items() if name.startswith(prefix))


def _describe_numbers(path: RodPath) -> dict[str, str]:
    """Return remarks on the places and steps of numbers, keyed by the names of the numbers."""
    law, stations, steps = path.line.section.law, path.line.stations, range(len(path.states))
    final_bend, sharpest_bend = (find_sharpest_bend(path, part) for part in (steps[-1:], steps))
    lowest_node = int(np.argmin(compute_heights(path.last.positions, path)))
    remarks = {
        RADIUS: format_position(final_bend.arc_length),
        PATH_RADIUS: f"step {sharpest_bend.step}, {format_position(sharpest_bend.arc_length)}",
        LOWEST_POINT: format_position(stations[lowest_node]),
        LOST_ENERGY: "in bending, since the start",
    }
    forces = np.array([np.linalg.norm(state.reaction_forces, axis=1) for state in path.states])
    for index, boundary in enumerate(path.boundaries):
        step = int(np.argmax(forces[:, index]))
        remark = f"largest in all steps: {forces[step, index]:.4g} N at step {step}"
        remarks[f"{FORCE_PREFIX}{boundary.name}"] = remark
    for boundary, release_step in list_releases(path):
        remark = f"from its place in step {release_step - 1}, the last one before the release"
        remarks[f"{SPRINGBACK_PREFIX}{boundary.name}"] = remark
    residual = compute_residual_curvature(path.last, law)
    node = int(np.argmax(residual))
    if residual[node]:
        suffix = "" if law.growing_sliders else ", by Masing's rule"
        remarks[RESIDUAL_CURVATURE] = f"{format_position(stations[node])}; after release{suffix}"
    return remarks


@dataclass(frozen=True, slots=True)
class Doubt:
    """Reason why some of the numbers are doubtful.

    Parameters
    ----------
    reason : reason why the numbers are doubtful
    names : names of these numbers, or beginnings of names
    """

    reason: Reason
    names: tuple[str, ...]

    def concerns(self, name: str) -> bool:
        """Return whether the doubt is about a number."""
        # `PATH_RADIUS` begins with `RADIUS`, which is the name of another number.
        return PATH_RADIUS in self.names if name == PATH_RADIUS else name.startswith(self.names)


def build_results(
    path: RodPath,
    reasons: tuple[Reason, ...],
    intervals: Mapping[str, Interval],
    doubts: Sequence[Doubt] = (),
) -> tuple[Result, ...]:
    """Build the results of a harness from its numbers.

    Parameters
    ----------
    path : complete path of the line
    reasons : reasons why all numbers are doubtful
    intervals : intervals of the numbers, keyed by name
    doubts : doubts about some of the numbers
    """
    results, remarks = [], _describe_numbers(path)
    for name, value in compute_numbers(path).items():
        unit = get_unit(name)
        if not math.isfinite(value):
            straight_reasons = (Reason.of("mechanics.studies.straight"),)
            results.append(Result(name, None, unit, None, Status.FAILED, straight_reasons))
            continue
        all_reasons = (*reasons, *(doubt.reason for doubt in doubts if doubt.concerns(name)))
        status = Status.DOUBTFUL if all_reasons else Status.OK
        interval, remark = intervals.get(name), remarks.get(name, "")
        results.append(Result(name, value, unit, interval, status, all_reasons, remark=remark))
    return tuple(results)


MAX_ERROR = 0.02
"""Largest allowed error of a number, relative to its magnitude."""
MAX_ERROR_OVER_WIDTH = 0.1
"""Largest allowed error of a number, relative to the width of its interval, if that allows more."""
_MIN_BENT_CURVATURE = 1e-3
"""Smallest curvature of a line that is not straight, 1/m."""


def find_reasons(path: RodPath, material: Material) -> tuple[Reason, ...]:
    """Collect the reasons why all numbers of a harness are doubtful or missing.

    Parameters
    ----------
    path : path of the line
    material : material with the limits of curvature and stretch of its law
    """
    reasons = list(path.reasons)
    if not path.states:
        return path.reasons
    step, node, curvature = find_maximum([state.bending_curvatures for state in path.states])
    is_beyond_law = any(reason.code == "beyond_law" for reason in reasons)
    if curvature > material.curvature_limit and not is_beyond_law:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_backed",
                step=step,
                place=path.line.describe_position(node),
                curvature=curvature,
                limit=material.curvature_limit,
                source=material.limit_source,
            )
        )
    step, element, stretch = find_maximum([np.abs(state.stretches) for state in path.states])
    if stretch > material.stretch_limit:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_stretch",
                step=step,
                place=path.line.describe_position(element),
                stretch=100.0 * stretch,
                limit=100.0 * material.stretch_limit,
            )
        )
    return tuple(reasons)


def find_jump_doubt(path: RodPath) -> Doubt | None:
    """Return the doubt about numbers that depend on history, if much energy was lost in jumps.

    Parameters
    ----------
    path : path of the line

    Notes
    -----
    A line that buckles or is released jumps from one equilibrium to another. The motion during the
    jump is unknown, and the state of the sliders depends on this motion. The shape of a released
    line also depends on this motion, because the line may swing. In simulations with MuJoCo and
    little damping, the shape differs by 0.5 % of the length if 7 % of the lost energy is lost in
    jumps, by 2 % if 17 % is lost in jumps, and by 6 % if 33 % is lost in jumps.
    """
    max_jump_fraction = 0.1  # fraction of the lost energy that is lost in jumps
    min_relative_loss = 0.1  # loss of a step that the reason names, relative to the largest loss
    energy, jump_energy = float(path.lost_energy[-1]), float(path.jump_energy[-1])
    if jump_energy <= max_jump_fraction * energy:
        return None
    step_losses = np.diff(path.jump_energy, prepend=0.0)
    steps = ", ".join(
        map(str, np.flatnonzero(step_losses > min_relative_loss * np.max(step_losses)))
    )
    names = (LOST_ENERGY, RESIDUAL_CURVATURE, MOMENT_PREFIX, *_list_released_numbers(path))
    percent = 100.0 * jump_energy / energy
    return Doubt(Reason.of("mechanics.studies.jumped", steps=steps, percent=percent), names)


def find_unloading_doubt(path: RodPath) -> Doubt | None:
    """Return the doubt about numbers that depend on unloading, if the law follows Masing's rule.

    Parameters
    ----------
    path : path of the line

    Notes
    -----
    By Masing's rule, copper springs back two to four times as far as standards for annealed wire
    allow. A law with growing sliders does not follow this rule. The rule affects the residual
    curvature, the lost energy, the shape of a released line, and the forces and moments of a line
    that was unbent and has several supports.
    """
    max_bound_ratio = 1.1  # bound of the residual curvature over the curvature by Masing's rule
    law = path.line.section.law
    if law.growing_sliders:
        return None
    bound = bound_residual_curvature(path, law)
    node = int(np.argmax(bound))
    residual = float(compute_residual_curvature(path.last, law)[node])
    if bound[node] <= max(_MIN_BENT_CURVATURE, max_bound_ratio * residual):
        return None
    values = {"place": 1e3 * path.line.stations[node], "by_rule": residual, "bound": bound[node]}
    reason = Reason.of("mechanics.studies.unloading_assumed", **values)
    return Doubt(reason, list_unloading_numbers(path))


def bound_residual_curvature(path: RodPath, law: SliderLaw) -> Floats:
    """Compute an upper bound of the residual curvature, shape (n + 1,), 1/m.

    Parameters
    ----------
    path : path of the line
    law : law of the line

    Notes
    -----
    The bound assumes that no slider slides on unloading. The bound is the largest magnitude of the
    sum of K_j a_j in all steps, divided by the first stiffness. K_j and a_j are the stiffness and
    the history of slider j.
    """
    if not law.history_size:
        return np.zeros(len(path.last.positions))
    sliders = [get_current_sliders(law, state.slider_rests) for state in path.states]
    moments = [np.einsum("j,nsjx->nsx", x.stiffnesses, x.rest_curvatures) for x in sliders]
    return np.asarray(np.linalg.norm(moments, axis=-1).max(axis=(0, 2)) / law.first_stiffness)


def list_unloading_numbers(path: RodPath) -> tuple[str, ...]:
    """Return the names of the numbers that depend on unloading; see `find_unloading_doubt`.

    Parameters
    ----------
    path : path of the line
    """
    min_unbending = 0.1  # relative decrease of curvature below which forces hardly change
    names = (LOST_ENERGY, RESIDUAL_CURVATURE, *_list_released_numbers(path))
    supports = [boundary for boundary in path.boundaries if isinstance(boundary, SUPPORT_TYPES)]
    has_several_supports = len(supports) - len(list_releases(path)) > 1
    if has_several_supports and compute_unbending(path) > min_unbending:
        names += (FORCE_PREFIX, MOMENT_PREFIX)
    return names


def compute_unbending(path: RodPath) -> float:
    """Compute the largest decrease of curvature from the peak of a station to the last step.

    The decrease is relative to the largest curvature of the line in all steps.

    Parameters
    ----------
    path : path of the line
    """
    curvatures = np.array([state.bending_curvatures for state in path.states])
    peaks = curvatures.max(axis=0)  # of each station over all steps
    return float(np.max(peaks - curvatures[-1]) / max(float(peaks.max()), _MIN_BENT_CURVATURE))


def make_share_doubts(
    intervals: Mapping[str, Interval], names: Sequence[str], share_range: tuple[float, float]
) -> Iterator[Doubt]:
    """Yield doubts about numbers with wide intervals, for an unknown isotropic share.

    Parameters
    ----------
    intervals : intervals of the numbers, keyed by name
    names : names of numbers that depend on unloading, or beginnings of names
    share_range : range of the isotropic share of the hardening of copper
    """
    min_share, max_share = share_range
    max_ratio = 2.0  # of the upper to the lower end of an interval of a positive number
    checked_names = (LOST_ENERGY, RESIDUAL_CURVATURE, SPRINGBACK_PREFIX, RADIUS)
    affected_names = tuple(name for name in names if name in checked_names)
    for name, interval in intervals.items():
        is_affected = name != PATH_RADIUS and name.startswith(affected_names)
        if is_affected and interval.upper > max_ratio * interval.lower:
            values = {"min_share": min_share, "max_share": max_share}
            values |= {"lower": interval.lower, "upper": interval.upper}
            yield Doubt(Reason.of("mechanics.studies.share_unknown", **values), (name,))


def _list_released_numbers(path: RodPath) -> tuple[str, ...]:
    """Return the names of the numbers that a release of the line changes."""
    return (SPRINGBACK_PREFIX, RADIUS, LOWEST_POINT) if list_releases(path) else ()


def make_convergence_doubts(
    path: RodPath, coarse_line: PreparedLine, intervals: Mapping[str, Interval]
) -> Iterator[Doubt]:
    """Yield the doubts about numbers that depend on the number of steps or elements.

    If the line depends on its history, it is first solved with other steps and half as many
    elements. The effects of steps and of elements are checked separately only if this solution
    fails or a number changes too much.

    Parameters
    ----------
    path : path of the line
    coarse_line : the same line with half as many elements
    intervals : intervals of numbers, keyed by name; a number may have no interval
    """
    n_steps, has_history = len(path.states) - 1, depends_on_history(path)
    if has_history:
        _, coarse_path = solve_with_resampled_steps(coarse_line, n_steps)
        is_solved = coarse_path.status is not Status.FAILED
        if is_solved and not _find_excess_errors(path, coarse_path, intervals):
            return
    coarse_path, n_coarse = follow(*coarse_line, steps=n_steps), len(coarse_line.line.lengths)
    doubts = [find_change_doubt(path, coarse_path, intervals, changed="elements", n_other=n_coarse)]
    if has_history:
        line = PreparedLine(path.line, path.boundaries)
        n_new_steps, new_path = solve_with_resampled_steps(line, n_steps)
        doubt = find_change_doubt(path, new_path, intervals, changed="steps", n_other=n_new_steps)
        doubts.append(doubt)
    yield from filter(None, doubts)


def depends_on_history(line: RodPath | PreparedLine) -> bool:
    """Return whether a line depends on its history, because of sliders or friction on a plane.

    Parameters
    ----------
    line : line with its boundaries, or its path
    """
    planes = [boundary for boundary in line.boundaries if isinstance(boundary, rod.Plane)]
    has_friction = any(plane.friction > 0.0 for plane in planes)
    return len(line.line.section.law.slider_stiffnesses) > 0 or has_friction


def select_coarse_steps(boundaries: Sequence[rod.Boundary], n_steps: int) -> Ints:
    """Select every other step, the ends, the corners of paths, and the steps around a release.

    Parameters
    ----------
    boundaries : boundaries of the line
    n_steps : number of steps
    """
    corners = {0, n_steps}
    for boundary in boundaries:
        release = getattr(boundary, "release", None)
        corners |= set() if release is None else {release - 1, release}
        for name, path in rod.list_paths(boundary).items():
            if len(path) > 1:
                corners |= set(_find_corners(path, is_frame=name == "frame"))
    selected_steps = [0]
    for step in range(1, n_steps + 1):
        if step in corners or step - selected_steps[-1] == 2:
            selected_steps.append(step)
    return np.array(selected_steps)


def _find_corners(path: Floats, *, is_frame: bool) -> list[int]:
    """Find the steps at which the movement of a path per step changes."""
    min_relative_change = 0.05  # change at a corner, relative to the largest move in a step
    min_move = 1e-9  # m, rad or N; smaller moves are rounding errors
    moves = np.diff(path, axis=0)
    if is_frame:
        moves = to_rotation_vectors(multiply(conjugate(path[:-1]), path[1:]))
    max_move = float(np.max(np.linalg.norm(moves, axis=1)))
    min_change = min_relative_change * max(max_move, min_move)
    changes = np.linalg.norm(np.diff(moves, axis=0), axis=1)
    return (np.flatnonzero(changes > min_change) + 1).tolist()


def solve_with_resampled_steps(prepared: PreparedLine, n_steps: int) -> tuple[int, RodPath]:
    """Solve a line in about half as many steps, or in twice as many if its paths have many corners.

    Parameters
    ----------
    prepared : line with its boundaries
    n_steps : number of steps of the first solution

    Returns
    -------
    n_other : number of steps of the new solution
    path : path of the line
    """
    max_step_fraction = 0.75  # with a larger fraction of the steps, the path is hardly coarser
    times = np.asarray(select_coarse_steps(prepared.boundaries, n_steps), dtype=np.float64)
    if len(times) - 1 > max_step_fraction * n_steps:
        times = np.linspace(0.0, n_steps, 2 * n_steps + 1, dtype=np.float64)
    boundaries = tuple(rod.resample(boundary, times) for boundary in prepared.boundaries)
    n_other = len(times) - 1
    return n_other, follow(prepared.line, boundaries, steps=n_other)


def find_change_doubt(
    path: RodPath,
    other_path: RodPath,
    intervals: Mapping[str, Interval],
    *,
    changed: Literal["steps", "elements"],
    n_other: int,
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of steps or elements, if any.

    Parameters
    ----------
    path : path of the line
    other_path : path of the same line with another number of steps, or half as many elements
    intervals : intervals of numbers, keyed by name; a number may have no interval
    changed : whether the number of steps or the number of elements differs
    n_other : number of steps or elements of the other path
    """
    has_other_steps = changed == "steps"
    count = len(path.states) - 1 if has_other_steps else len(path.line.lengths)
    order, error_ratio = (1, 1.0) if has_other_steps else (2, 1.0 / 3.0)
    all_names = tuple(compute_numbers(path))
    if other_path.status is Status.FAILED:
        reason = Reason.of(
            "mechanics.studies.unsolved_steps"
            if has_other_steps
            else "mechanics.studies.unsolved_elements",
            failure=other_path.reasons[0].code,
            count=count,
            other=n_other,
            wanted=2 * count,
        )
        return Doubt(reason, all_names)
    ratios = _find_excess_errors(path, other_path, intervals, error_ratio)
    if not ratios:
        return None
    worst_name = max(ratios, key=lambda name: ratios[name])
    reason = Reason.of(
        "mechanics.studies.too_coarse" if has_other_steps else "mechanics.studies.coarse_elements",
        other=n_other,
        change=100.0 * MAX_ERROR / error_ratio,
        of_band=100.0 * MAX_ERROR_OVER_WIDTH / error_ratio,
        worst=worst_name,
        count=count,
        wanted=max(2 * count, math.ceil(count * ratios[worst_name] ** (1.0 / order))),
    )
    # With other elements, a number may be unchanged by chance. Therefore all numbers are doubtful.
    return Doubt(reason, tuple(ratios) if has_other_steps else all_names)


def _find_excess_errors(
    path: RodPath, other_path: RodPath, intervals: Mapping[str, Interval], error_ratio: float = 1.0
) -> dict[str, float]:
    """Return the finite ratios of error to allowed error above 1, keyed by name of the number.

    The error is `error_ratio` times the change between both solutions. The allowed error is a
    fraction of the magnitude of the number, or of the width of its interval if that is more. The
    magnitude has a minimum, which depends on the numbers of the same unit.
    """
    min_height_ratio = 0.05  # smallest magnitude of a height, relative to the length of the line
    min_magnitude_ratio = 1e-3  # relative to the largest number of the same unit
    numbers, other_numbers = compute_numbers(path), compute_numbers(other_path)
    finite_numbers = {name: value for name, value in numbers.items() if math.isfinite(value)}
    unit_magnitudes = estimate_magnitudes(path.line)
    for name, value in finite_numbers.items():
        unit_magnitudes[get_unit(name)] = max(unit_magnitudes[get_unit(name)], abs(value))
    ratios = {}
    for name, value in finite_numbers.items():
        magnitude = max(abs(value), min_magnitude_ratio * unit_magnitudes[get_unit(name)])
        if name == LOWEST_POINT:  # a coordinate, which may be about zero
            magnitude = max(magnitude, min_height_ratio * path.line.length)
        interval = intervals.get(name)
        width = 0.0 if interval is None else interval.upper - interval.lower
        width_error = MAX_ERROR_OVER_WIDTH * width
        allowed_error = max(MAX_ERROR * magnitude, width_error) or math.inf
        ratios[name] = error_ratio * abs(other_numbers[name] - value) / allowed_error
    return {name: ratio for name, ratio in ratios.items() if 1.0 < ratio < math.inf}
