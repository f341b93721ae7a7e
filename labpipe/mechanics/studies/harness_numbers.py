"""Compute and check the numbers of a solved harness: bend radii, forces, residual curvature.

Numbers are computed from *fields*: vectors along the line that depend smoothly on the uncertain
inputs. A norm is not smooth where it vanishes, nor a maximum where its location changes. Therefore
the fields are extrapolated linearly in the inputs, and every number is then computed from the
extrapolated fields in the same way as from a solved line.

Sliders and friction depend on the loading path, which is linear within a step. The error decreases
at least linearly with the size of the steps, so the change from a solution with half as many steps
bounds it. When steps are halved, those at corners of a path are retained; if these are more than
three quarters, twice as many steps are taken instead. The error of the elements decreases with the
square of their length; it is estimated as a third of the change from a solution with half as many
elements.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw, find_current_sliders
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.bands import compute_node_curvature
from labpipe.mechanics.rod.line import Line, format_place
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors, unit
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import Material, PreparedLine
from labpipe.messages import format_sentence
from labpipe.protocol.harness_file import HarnessFile
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status

LOWEST_POINT, RADIUS = "lowest_point", "smallest_bend_radius"
RADIUS_ON_PATH = f"{RADIUS}_on_the_way"
ENERGY_LOST, RESIDUAL = "energy_lost", "kept_curvature"
FORCE, MOMENT, SPRINGBACK = "force.", "moment.", "springback."
POSITIONS, CURVATURES = "positions", "curvature_vectors "
SUPPORTS = rod.Held | rod.Ring | rod.String | rod.Plane
_NUMBER_UNITS = {
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
    path : path of the line

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
        if isinstance(boundary, SUPPORTS):
            yield f"{FORCE}{boundary.name}", path.last.reaction_forces[number]
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield f"{MOMENT}{boundary.name}", path.last.reaction_moments[number]
    for boundary, release in list_releases(path):
        start = path.states[release - 1].positions[boundary.node]
        yield f"{SPRINGBACK}{boundary.name}", path.last.positions[boundary.node] - start


def list_releases(path: RodPath) -> list[tuple[rod.Held, int]]:
    """List the boundaries that release the line, each with the first step after its release."""
    supports = [boundary for boundary in path.boundaries if isinstance(boundary, rod.Held)]
    return [(support, support.release) for support in supports if support.release is not None]


def evaluate_numbers(field: Callable[[str], Floats], path: RodPath) -> dict[str, Floats]:
    """Compute all numbers from fields; the curvature, 1/m, replaces a bend radius.

    Parameters
    ----------
    field : returns a field by its name; leading axes (draws) are kept
    path : path of the line at the best inputs
    """
    # step by step, which limits memory for draws
    step_curvatures = (_find_max(field(f"{CURVATURES}{step}")) for step in range(len(path.states)))
    vectors = [name for name, _ in _collect_boundary_fields(path)]
    return {
        RADIUS: _find_max(field(f"{CURVATURES}{len(path.states) - 1}")),
        RADIUS_ON_PATH: reduce(np.maximum, step_curvatures),
        LOWEST_POINT: np.asarray(compute_heights(field(POSITIONS), path).min(axis=-1)),
        **{name: np.asarray(np.linalg.norm(field(name), axis=-1)) for name in vectors},
        RESIDUAL: _find_max(field(RESIDUAL)),
        ENERGY_LOST: np.maximum(field(ENERGY_LOST), 0.0),
    }


def _find_max(vectors: Floats) -> Floats:
    squares = vectors[..., 0] ** 2 + vectors[..., 1] ** 2
    return np.asarray(np.sqrt(squares.max(axis=(-2, -1))))


def compute_heights(positions: Floats, path: RodPath) -> Floats:
    """Compute heights against gravity, m, shape (..., n + 1); z for a line without weight.

    Parameters
    ----------
    positions : m, shape (..., n + 1, 3)
    path : path of the line
    """
    weights = [
        boundary.vector[-1] for boundary in path.boundaries if isinstance(boundary, rod.Gravity)
    ]
    return np.asarray(positions @ (-unit(weights[0]) if weights else [0.0, 0.0, 1.0]))


def compute_released_curvature(law: SliderLaw, rests: Floats) -> Floats:
    """Compute the curvature of each station after release, 1/m, shape (..., 2).

    Parameters
    ----------
    law : law of every station
    rests : 1/m, shape (..., n, 2): history of the sliders, see `SliderResponse`

    Notes
    -----
    This is the curvature at zero moment; sliders may slide back during release. It solves EI_0
    kappa + sum of w_j (kappa - a_j) = 0 with w_j = K_j min(1, kappa_j / |kappa - a_j|), by
    Weiszfeld's iteration: each iteration takes w_j from the previous one, and decreases a convex
    energy. The first iteration assumes that no slider slides. Without sliders the curvature is 0.
    The limit of a growing slider does not grow during release.
    """
    max_iterations, relative_tolerance = 1000, 1e-9
    curvature = np.zeros((*rests.shape[:-2], 2))
    sliders = find_current_sliders(law, rests)
    stiffnesses, slips = sliders.stiffnesses, sliders.slip_curvatures
    if not len(stiffnesses):
        return curvature
    weights = np.broadcast_to(stiffnesses, slips.shape)
    for _ in range(max_iterations):
        total = law.stiffness + weights.sum(axis=-1)
        previous = curvature
        curvature = np.einsum("...j,...jx->...x", weights, sliders.rests) / total[..., None]
        if np.max(np.abs(curvature - previous)) <= relative_tolerance * np.max(np.abs(curvature)):
            break
        strains = np.linalg.norm(curvature[..., None, :] - sliders.rests, axis=-1)
        weights = stiffnesses * slips / np.maximum(strains, slips)
    return curvature


def compute_residual_curvature(state: RodState, law: SliderLaw) -> Floats:
    """Compute the curvature of the line after a release, 1/m, shape (n + 1,).

    Parameters
    ----------
    state : state of the line, with the history of its sliders
    law : law of the line

    Notes
    -----
    See `compute_released_curvature`. Curvature at rest is not included. If both sides of a node
    differ, at a clip, it is the larger one.
    """
    return compute_node_curvature(compute_released_curvature(law, state.rests))


def compute_curvature(state: RodState) -> Floats:
    """Compute the curvature of the line, 1/m, shape (n + 1,), including that at rest.

    If both sides of a node differ, at a clip, it is the larger one.
    """
    return compute_node_curvature(state.curvature_vectors)


def compute_radius(curvature: Floats) -> Floats:
    """Compute the bend radius, m; infinite up to a curvature of 1e-6 1/m.

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
    source : origin of the radius
    is_assumed : whether the file does not state the radius
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
    step : number of the step
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
    path : path of the line
    steps : at least one
    """
    row, node, curvature = find_largest([compute_curvature(path.states[step]) for step in steps])
    radius = float(compute_radius(np.array(curvature)))
    return Bend(radius, steps[row], float(path.line.stations[node]))


def find_largest(values_by_step: Sequence[Floats]) -> tuple[int, int, float]:
    """Return row and node (or element) of the largest value, and the value."""
    values = np.array(values_by_step)
    row, place = divmod(int(np.argmax(values)), values.shape[1])
    return row, place, float(values[row, place])


def estimate_sizes(line: Line) -> dict[str, float]:
    """Estimate the magnitude of quantities by unit for a line bent to the curvature 1 / length."""
    length, moment = line.length, line.section.law.first_stiffness / line.length
    return {"m": length, "1/m": 1.0 / length, "N": moment / length, "N*m": moment, "J": moment}


def compute_numbers(path: RodPath) -> dict[str, float]:
    """Compute the numbers of a harness at its last step and over the whole path, by name.

    Parameters
    ----------
    path : path of the line, to the last step

    Returns
    -------
    SI, see `find_unit`; the bend radius of a straight line is infinite.
    """
    values = evaluate_numbers(collect_fields(path).__getitem__, path)
    values |= {name: compute_radius(values[name]) for name in (RADIUS, RADIUS_ON_PATH)}
    return {name: float(value) for name, value in values.items()}


def find_unit(name: str) -> str:
    """Return the unit of a number."""
    return next(unit for start, unit in _NUMBER_UNITS.items() if name.startswith(start))


def _describe_numbers(path: RodPath) -> dict[str, str]:
    """Return the remarks of numbers, by name: places and steps."""
    law, stations, steps = path.line.section.law, path.line.stations, range(len(path.states))
    end, overall = (find_sharpest_bend(path, shown) for shown in (steps[-1:], steps))
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
        remark = f"{forces[step, number]:.4g} N at step {step}"
        remarks[f"{FORCE}{boundary.name}"] = f"largest in all steps: {remark}"
    for boundary, release in list_releases(path):
        remark = f"from its place in step {release - 1}, the last one before the release"
        remarks[f"{SPRINGBACK}{boundary.name}"] = remark
    residual = compute_residual_curvature(path.last, law)
    node = int(np.argmax(residual))
    if residual[node]:
        rule = "" if law.growing else ", by Masing's rule"
        remarks[RESIDUAL] = f"{format_place(stations[node])}; if released{rule}"
    return remarks


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reason why some of the numbers are doubtful.

    Parameters
    ----------
    reason : reason of the doubt
    names : names of these numbers, or beginnings of their names
    """

    reason: Reason
    names: tuple[str, ...]

    def concerns(self, name: str) -> bool:
        """Return whether the doubt is about a number."""
        # the name of this number begins with that of another one
        is_named = name != RADIUS_ON_PATH or RADIUS_ON_PATH in self.names
        return name.startswith(self.names) and is_named


def build_results(
    path: RodPath,
    reasons: tuple[Reason, ...],
    intervals: Mapping[str, Interval],
    doubts: Sequence[Doubt] = (),
) -> tuple[Result, ...]:
    """Return the numbers of a harness as results.

    Parameters
    ----------
    path : path of the line, to the last step
    reasons : why all numbers are doubtful
    intervals : intervals of the numbers, by name
    doubts : doubts about some of the numbers
    """
    results, remarks = [], _describe_numbers(path)
    for name, value in compute_numbers(path).items():
        unit = find_unit(name)
        if not math.isfinite(value):
            straight = (Reason.of("mechanics.studies.straight"),)
            results.append(Result(name, None, unit, None, Status.FAILED, straight))
            continue
        own_reasons = (*reasons, *(doubt.reason for doubt in doubts if doubt.concerns(name)))
        status = Status.DOUBTFUL if own_reasons else Status.OK
        number = name, value, unit, intervals.get(name), status, own_reasons
        results.append(Result(*number, remark=remarks.get(name, "")))
    return tuple(results)


MAX_CHANGE = 0.02
"""Largest error of a number over its size."""
MAX_CHANGE_OF_BAND = 0.1
"""Largest error of a number over the width of its band; the larger of both limits is allowed."""
_PATHS = ("position", "frame", "anchor", "force", "vector")
"""Fields of boundaries that may be paths."""
_MIN_CURVATURE = 1e-3
"""1/m; below it a line is straight."""


def find_reasons(path: RodPath, material: Material) -> tuple[Reason, ...]:
    """Return the reasons why all numbers of a harness are doubtful or missing.

    Parameters
    ----------
    path : path of the line
    material : material with the limits of curvature and stretch of its law
    """
    reasons = list(path.reasons)
    if not path.states:
        return path.reasons
    step, node, curvature = find_largest([state.bendings for state in path.states])
    if curvature > material.limit and "beyond_law" not in {reason.code for reason in reasons}:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_backed",
                step=step,
                place=path.line.describe_place(node),
                curvature=curvature,
                limit=material.limit,
                source=material.limit_source,
            )
        )
    step, element, stretch = find_largest([np.abs(state.stretches) for state in path.states])
    if stretch > material.stretch_limit:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_stretch",
                step=step,
                place=path.line.describe_place(element),
                stretch=100.0 * stretch,
                limit=100.0 * material.stretch_limit,
            )
        )
    return tuple(reasons)


def check_path(path: RodPath, half: PreparedLine, intervals: Mapping[str, Interval]) -> list[Doubt]:
    """Return the doubts about some numbers of a complete path.

    Parameters
    ----------
    path : path of the line
    half : the same line with half as many elements
    intervals : intervals of those numbers that have one, by name
    """
    doubts = [check_jumps(path), check_unloading(path)]
    return [*filter(None, doubts), *check_convergence(path, half, intervals)]


def check_jumps(path: RodPath) -> Doubt | None:
    """Doubt history-dependent numbers if much energy was lost in jumps.

    Parameters
    ----------
    path : path of the line

    Notes
    -----
    A line that buckles or is released passes through states that are not in equilibrium. Its motion
    there is unknown, and the state of the sliders depends on it. The shape of a released line
    depends on it as well, because the line may swing. In simulations with MuJoCo and little damping
    the shape differs by 0.5 % of the length where 7 % of the energy is lost in jumps, by 2 % where
    17 % is lost, and by 6 % where 33 % is lost.
    """
    share = float(path.lost_in_jumps[-1] / path.lost[-1]) if path.lost[-1] > 0.0 else 0.0
    if share <= 0.1:  # of the energy lost
        return None
    losses = np.diff(path.lost_in_jumps, prepend=0.0)
    steps = ", ".join(map(str, np.flatnonzero(losses > 0.1 * np.max(losses))))
    names = (ENERGY_LOST, RESIDUAL, MOMENT, *_list_released_numbers(path))
    return Doubt(Reason.of("mechanics.studies.jumped", steps=steps, share=100.0 * share), names)


def check_unloading(path: RodPath) -> Doubt | None:
    """Doubt numbers that depend on unloading if the law unloads by Masing's rule.

    Parameters
    ----------
    path : path of the line

    Notes
    -----
    By Masing's rule copper springs back two to four times as far as standards of annealed wire
    allow. A law with growing sliders does not follow this rule. The rule affects residual
    curvature, lost energy, the shape of a released line, and the forces and moments of a line that
    was unbent and has several supports.
    """
    law = path.line.section.law
    if law.growing:
        return None
    bound = bound_residual_curvature(path, law)
    node = int(np.argmax(bound))
    residual = float(compute_residual_curvature(path.last, law)[node])
    if bound[node] <= max(_MIN_CURVATURE, 1.1 * residual):
        return None
    reason = Reason.of(
        "mechanics.studies.unloading_assumed",
        place=1e3 * path.line.stations[node],
        by_rule=residual,
        without_sliding=bound[node],
    )
    return Doubt(reason, list_unloading_numbers(path))


def bound_residual_curvature(path: RodPath, law: SliderLaw) -> Floats:
    """Return an upper bound of the residual curvature, 1/m, shape (n + 1,).

    Parameters
    ----------
    path : path of the line
    law : law of the line

    Notes
    -----
    The bound assumes that no slider slides on unloading: it is the largest sum of K_j a_j of all
    steps over the first stiffness.
    """
    if not law.history_size:
        return np.zeros(len(path.last.positions))
    sliders = [find_current_sliders(law, state.rests) for state in path.states]
    moments = [np.einsum("j,nsjx->nsx", present.stiffnesses, present.rests) for present in sliders]
    return np.asarray(np.linalg.norm(moments, axis=-1).max(axis=(0, 2)) / law.first_stiffness)


def list_unloading_numbers(path: RodPath) -> tuple[str, ...]:
    """Return the names of numbers that depend on unloading; see `check_unloading`.

    Parameters
    ----------
    path : path of the line
    """
    names = (ENERGY_LOST, RESIDUAL, *_list_released_numbers(path))
    supports = [boundary for boundary in path.boundaries if isinstance(boundary, SUPPORTS)]
    if len(supports) - len(list_releases(path)) > 1 and measure_unbending(path) > 0.1:
        names += (FORCE, MOMENT)
    return names


def measure_unbending(path: RodPath) -> float:
    """Return the largest decrease of curvature at a node over the largest curvature of the line.

    Parameters
    ----------
    path : path of the line
    """
    curvature = np.array([state.bendings for state in path.states])
    largest = curvature.max(axis=0)
    return float(np.max(largest - curvature[-1]) / max(float(largest.max()), _MIN_CURVATURE))


def check_share(
    intervals: Mapping[str, Interval], names: Sequence[str], share_range: tuple[float, float]
) -> Iterator[Doubt]:
    """Doubt numbers with wide intervals if the hardening of the copper is unknown.

    Parameters
    ----------
    intervals : intervals of the numbers, by name
    names : names of numbers that depend on unloading, or beginnings of their names
    share_range : of the isotropic share
    """
    first, last = share_range
    max_ratio = 2.0  # of the ends of an interval; heights and forces may be about zero
    positive = tuple(name for name in names if name in (ENERGY_LOST, RESIDUAL, SPRINGBACK, RADIUS))
    for name, interval in intervals.items():
        if name.startswith(positive) and interval.upper > max_ratio * interval.lower:
            low, high = interval.lower, interval.upper
            reason = Reason.of(
                "mechanics.studies.share_unknown", low=low, high=high, first=first, last=last
            )
            yield Doubt(reason, (name,))


def _list_released_numbers(path: RodPath) -> tuple[str, ...]:
    """Return the names of the numbers that a release of the line changes."""
    return (SPRINGBACK, RADIUS, LOWEST_POINT) if list_releases(path) else ()


def check_convergence(
    path: RodPath, half: PreparedLine, intervals: Mapping[str, Interval]
) -> Iterator[Doubt]:
    """Yield the doubts about numbers that depend on the numbers of steps and elements.

    For a line with a history, half as many steps and elements are tried together first. Each is
    checked separately only if numbers change.

    Parameters
    ----------
    path : path of the line
    half : the same line with half as many elements
    intervals : intervals of those numbers that have one, by name
    """
    steps, has_history = len(path.states) - 1, depends_on_history(path)
    if has_history:
        _, coarse_path = solve_in_other_steps(half, steps)
        if coarse_path.status != "failed" and not _find_excess_changes(
            path, coarse_path, intervals
        ):
            return
    coarse_path = follow(*half, steps=steps)
    other = len(half.line.lengths)
    doubts = [check_change(path, coarse_path, intervals, changed="elements", other=other)]
    if has_history:
        other, other_path = solve_in_other_steps(PreparedLine(path.line, path.boundaries), steps)
        doubts.append(check_change(path, other_path, intervals, changed="steps", other=other))
    yield from filter(None, doubts)


def depends_on_history(line: RodPath | PreparedLine) -> bool:
    """Return whether a line depends on its history, through sliders or friction on a plane.

    Parameters
    ----------
    line : line with its boundaries
    """
    planes = [boundary for boundary in line.boundaries if isinstance(boundary, rod.Plane)]
    has_friction = any(plane.friction > 0.0 for plane in planes)
    return len(line.line.section.law.stiffnesses) > 0 or has_friction


def select_coarse_steps(boundaries: Sequence[rod.Boundary], steps: int) -> Ints:
    """Select every other step, and the steps with a corner of a path or a release.

    Parameters
    ----------
    boundaries : boundaries of the line
    steps : number of steps
    """
    corners = {0, steps}
    for boundary in boundaries:
        release = getattr(boundary, "release", None)
        corners |= set() if release is None else {release - 1, release}
        for name, path in _list_paths(boundary):
            corners |= set(_find_corners(path, is_frame=name == "frame"))
    rows = [0]
    for step in range(1, steps + 1):
        if step in corners or step - rows[-1] == 2:
            rows.append(step)
    return np.array(rows)


def _list_paths(boundary: rod.Boundary) -> Iterator[tuple[str, Floats]]:
    """Yield the paths of a boundary that have a row for each step, by name."""
    for name in _PATHS:
        path = getattr(boundary, name, None)
        if path is not None and path.ndim == 2 and len(path) > 1:
            yield name, path


def _find_corners(path: Floats, *, is_frame: bool) -> list[int]:
    min_corner_share = 0.05  # change of the displacement per step at a corner, over the largest one
    min_move = 1e-9  # m, rad or N; smaller moves are rounding
    moves = np.diff(path, axis=0)
    if is_frame:
        moves = to_rotation_vectors(multiply(conjugate(path[:-1]), path[1:]))
    largest = float(np.max(np.linalg.norm(moves, axis=1)))
    max_change = min_corner_share * max(largest, min_move)
    changes = np.linalg.norm(np.diff(moves, axis=0), axis=1)
    return (np.flatnonzero(changes > max_change) + 1).tolist()


def solve_in_other_steps(prepared: PreparedLine, steps: int) -> tuple[int, RodPath]:
    """Solve a line in about half as many steps, or in twice as many if it has many corners.

    Parameters
    ----------
    prepared : line and boundaries
    steps : number of steps of the first solution

    Returns
    -------
    The number of steps, and the path.
    """
    times = np.asarray(select_coarse_steps(prepared.boundaries, steps), dtype=np.float64)
    if len(times) - 1 > 0.75 * steps:  # hardly coarser
        times = np.linspace(0.0, steps, 2 * steps + 1, dtype=np.float64)
    boundaries = tuple(_resample(boundary, times) for boundary in prepared.boundaries)
    other = len(times) - 1
    return other, follow(prepared.line, boundaries, steps=other)


def _resample(boundary: rod.Boundary, times: Floats) -> rod.Boundary:
    changes: dict[str, object] = {}
    low, high = np.floor(times).astype(int), np.ceil(times).astype(int)
    for name, path in _list_paths(boundary):
        midpoints = 0.5 * (path[low] + path[high])
        changes[name] = unit(midpoints) if name == "frame" else midpoints
    release = getattr(boundary, "release", None)
    if release is not None:
        changes["release"] = int(np.searchsorted(times, release - 1, side="right"))
    return replace(boundary, **changes)  # type: ignore[arg-type]


def check_change(
    path: RodPath,
    other_path: RodPath,
    intervals: Mapping[str, Interval],
    *,
    changed: Literal["steps", "elements"],
    other: int,
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of steps or elements, if any.

    Parameters
    ----------
    path : path of the line
    other_path : path of the same line with another number of steps, or half as many elements
    intervals : intervals of those numbers that have one, by name
    changed : whether steps or elements differ
    other : their number in the other path
    """
    has_other_steps = changed == "steps"
    count = len(path.states) - 1 if has_other_steps else len(path.line.lengths)
    order, error_share = (1, 1.0) if has_other_steps else (2, 1.0 / 3.0)
    all_names = tuple(compute_numbers(path))
    if other_path.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_steps"
            if has_other_steps
            else "mechanics.studies.unsolved_elements",
            failure=other_path.reasons[0].code,
            count=count,
            other=other,
            wanted=2 * count,
        )
        return Doubt(reason, all_names)
    excess = _find_excess_changes(path, other_path, intervals, share=error_share)
    if not excess:
        return None
    worst = max(excess, key=lambda name: excess[name])
    reason = Reason.of(
        "mechanics.studies.too_coarse" if has_other_steps else "mechanics.studies.coarse_elements",
        other=other,
        change=100.0 * MAX_CHANGE / error_share,
        of_band=100.0 * MAX_CHANGE_OF_BAND / error_share,
        worst=worst,
        count=count,
        wanted=max(2 * count, math.ceil(count * excess[worst] ** (1.0 / order))),
    )
    # with other elements, another number may be unchanged by chance
    return Doubt(reason, tuple(excess) if has_other_steps else all_names)


def _find_excess_changes(
    path: RodPath, other_path: RodPath, intervals: Mapping[str, Interval], share: float = 1.0
) -> dict[str, float]:
    """Compute the ratio of error to allowed error of each number; keep ratios above 1.

    The error is a share of the change between both solutions. It is allowed relative to the size of
    the number or to the width of its band. The size has a minimum, which follows from the numbers
    of the same unit.
    """
    min_coordinate_share = 0.05  # of the length of the line
    min_size_share = 1e-3  # of the largest number of the same unit
    numbers, other_numbers = compute_numbers(path), compute_numbers(other_path)
    finite = {name: value for name, value in numbers.items() if math.isfinite(value)}
    unit_sizes = estimate_sizes(path.line)
    for name, value in finite.items():
        unit_sizes[find_unit(name)] = max(unit_sizes[find_unit(name)], abs(value))
    ratios = {}
    for name, value in finite.items():
        size = max(abs(value), min_size_share * unit_sizes[find_unit(name)])
        if name == LOWEST_POINT:  # a coordinate, which may be negative
            size = max(size, min_coordinate_share * path.line.length)
        band = intervals.get(name)
        width = 0.0 if band is None else MAX_CHANGE_OF_BAND * (band.upper - band.lower)
        allowed = max(MAX_CHANGE * size, width) or math.inf
        ratios[name] = share * abs(other_numbers[name] - value) / allowed
    return {name: ratio for name, ratio in ratios.items() if 1.0 < ratio < math.inf}
