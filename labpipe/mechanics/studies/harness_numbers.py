"""Numbers of a solved harness (bend radii, forces, residual curvature), and reasons to doubt them.

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
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.response import Fields, compute_norms
from labpipe.mechanics.rod.rotations import unit
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.mechanics.studies.harness_section import Material
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
POSITIONS, CURVATURES = "positions", "curvature "
HOLDS = rod.Held | rod.Ring | rod.String | rod.Plane


def compute_curvature_vectors(state: RodState, line: Line) -> Floats:
    """Compute the curvature vectors of the line, 1/m, shape (n + 1, 2, 2).

    Natural curvature is included. The second axis is the side of the node, before and behind it;
    the two differ at a clip.

    Parameters
    ----------
    state : of the line
    line : in this state
    """
    return np.asarray(state.node_curvatures[:, :, :2] + line.rest_curvature_at_nodes[:, None, :2])


def compute_node_curvature(vectors: Floats) -> Floats:
    """Compute the curvature at the nodes, 1/m, shape (..., n + 1): the larger one of both sides.

    Parameters
    ----------
    vectors : curvature vectors, shape (..., n + 1, 2, 2)
    """
    return np.asarray(compute_norms(vectors).max(axis=-1))


def compute_heights(positions: Floats, prepared: PreparedLine) -> Floats:
    """Compute heights against gravity, m, shape (..., n + 1); z for a line without weight.

    Parameters
    ----------
    positions : m, shape (..., n + 1, 3)
    prepared : line and boundaries
    """
    weights = [
        boundary.vector[-1] for boundary in prepared.boundaries if isinstance(boundary, rod.Gravity)
    ]
    return np.asarray(positions @ (-unit(weights[0]) if weights else [0.0, 0.0, 1.0]))


def collect_fields(path: RodPath, prepared: PreparedLine) -> dict[str, Floats]:
    """Collect the fields of a complete path, by name.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries

    Returns
    -------
    `POSITIONS` : of the nodes at the last step, m, (n + 1, 3)
    ``curvature 0`` ... : `compute_curvature_vectors` of each step
    force, moment, springback : vectors (3,), by the names of their numbers
    `RESIDUAL` : vectors of `compute_released_curvature`
    `ENERGY_LOST` : J
    """
    last, line = path.last, prepared.line
    curvatures = [compute_curvature_vectors(state, line) for state in path.states]
    return {
        **{f"{CURVATURES}{step}": vectors for step, vectors in enumerate(curvatures)},
        **dict(_collect_boundary_fields(path, prepared)),
        POSITIONS: last.positions,
        RESIDUAL: compute_released_curvature(line.section.law, last.rests),
        ENERGY_LOST: np.asarray(path.lost[-1]),
    }


def _collect_boundary_fields(path: RodPath, prepared: PreparedLine) -> Iterator[tuple[str, Floats]]:
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


def list_numbers(fields: Fields) -> tuple[str, ...]:
    """List the names of the numbers that can be computed from fields.

    Parameters
    ----------
    fields : of a line
    """
    other_fields = [field for field in fields if not field.startswith((POSITIONS, CURVATURES))]
    return (RADIUS, RADIUS_ON_PATH, LOWEST_POINT, *other_fields)


def evaluate_number(
    name: str, field: Callable[[str], Floats], prepared: PreparedLine, steps: int
) -> Floats:
    """Compute a number from fields; for a bend radius, its curvature, 1/m.

    Parameters
    ----------
    name : of the number
    field : returns a field by its name; leading axes (draws) are kept
    prepared : line and boundaries
    steps : number of the last step
    """
    match name:
        case "smallest_bend_radius":
            return _find_max_curvature(field(f"{CURVATURES}{steps}"))
        case "smallest_bend_radius_on_the_way":  # step by step, which limits memory for draws
            names = (f"{CURVATURES}{step}" for step in range(steps + 1))
            return reduce(np.maximum, (_find_max_curvature(field(name)) for name in names))
        case "lowest_point":
            return np.asarray(compute_heights(field(POSITIONS), prepared).min(axis=-1))
        case "kept_curvature":
            return _find_max_curvature(field(RESIDUAL))
        case "energy_lost":
            return np.maximum(field(ENERGY_LOST), 0.0)
    return compute_norms(field(name))


def _find_max_curvature(vectors: Floats) -> Floats:
    return np.asarray(compute_node_curvature(vectors).max(axis=-1))


_MIN_CURVATURE = 1e-3
"""1/m; below it a line is straight."""


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
    return np.asarray(
        np.linalg.norm(compute_released_curvature(law, state.rests), axis=2).max(axis=1)
    )


def bound_residual_curvature(path: RodPath, law: SliderLaw) -> Floats:
    """Return an upper bound of the residual curvature, 1/m, shape (n + 1,).

    Parameters
    ----------
    path : of the line
    law : of the line

    Notes
    -----
    The bound assumes that no slider slides on unloading: it is the largest sum of K_j a_j of all
    steps over the first stiffness.
    """
    if not law.history_size:
        return np.zeros(len(path.last.positions))
    moments = []
    for state in path.states:
        sliders = present_sliders(law, state.rests)
        vectors = np.einsum("j,nsjx->nsx", sliders.stiffnesses, sliders.rests)
        moments.append(np.linalg.norm(vectors, axis=2).max(axis=1))
    return np.asarray(np.max(moments, axis=0) / law.first_stiffness)


def measure_unbending(path: RodPath) -> float:
    """Return the largest decrease of curvature at a node over the largest curvature of the line.

    Parameters
    ----------
    path : of the line
    """
    curvature = np.array([state.bendings for state in path.states])
    largest = curvature.max(axis=0)
    return float(np.max(largest - curvature[-1]) / max(float(largest.max()), _MIN_CURVATURE))


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
    """The find_sharpest_bend bend of a line.

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


def compute_curvature(state: RodState, line: Line) -> Floats:
    """Compute the curvature of the line, 1/m, shape (n + 1,), natural curvature included.

    Parameters
    ----------
    state : of the line
    line : in this state

    Notes
    -----
    Where both sides of a node differ, at a clip, it is the larger one.
    """
    return compute_node_curvature(compute_curvature_vectors(state, line))


def compute_radius(curvature: Floats) -> Floats:
    """Compute the bend radius, m; infinite where the line is straight.

    Parameters
    ----------
    curvature : 1/m, any shape
    """
    min_curvature = 1e-6  # 1/m
    is_bent = curvature > min_curvature
    return np.asarray(np.where(is_bent, 1.0 / np.where(is_bent, curvature, 1.0), np.inf))


def find_sharpest_bend(path: RodPath, line: Line, steps: Sequence[int]) -> Bend:
    """Find the find_sharpest_bend bend among some steps.

    Parameters
    ----------
    path : of the line
    line : of the path
    steps : at least one
    """
    row, node, curvature = _find_largest(
        [compute_curvature(path.states[step], line) for step in steps]
    )
    radius = float(compute_radius(np.array(curvature)))
    return Bend(radius, steps[row], float(line.stations[node]))


def find_reasons(path: RodPath, line: Line, material: Material) -> tuple[Reason, ...]:
    """Return the reasons why all numbers of a harness are doubtful or missing.

    Parameters
    ----------
    path : of the line
    line : of the path
    material : with the limits of curvature and stretch of its law
    """

    def place(node: int) -> str:
        return f"{_format_mm(line.stations[node])} from the start"

    reasons = [Reason(reason.code, reason.at(place)) for reason in path.reasons]
    if not path.states:
        return tuple(reasons)
    row, node, curvature = _find_largest([state.bendings for state in path.states])
    if curvature > material.limit and "beyond_law" not in {reason.code for reason in reasons}:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_backed",
                step=row,
                place=place(node),
                curvature=curvature,
                limit=material.limit,
                source=material.limit_source,
            )
        )
    row, element, stretch = _find_largest([np.abs(state.stretches) for state in path.states])
    if stretch > material.stretch_limit:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_stretch",
                step=row,
                place=place(element),
                stretch=100.0 * stretch,
                limit=100.0 * material.stretch_limit,
            )
        )
    return tuple(reasons)


def _find_largest(values_by_step: Sequence[Floats]) -> tuple[int, int, float]:
    """Return step and node (or element) of the largest value, and the value."""
    values = np.array(values_by_step)
    row, place = divmod(int(np.argmax(values)), values.shape[1])
    return row, place, float(values[row, place])


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


def check_jumps(path: RodPath, prepared: PreparedLine) -> Doubt | None:
    """Doubt history-dependent numbers if much energy was lost in jumps.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries

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
    step_text = ", ".join(map(str, np.flatnonzero(losses > 0.1 * np.max(losses))))
    names = (ENERGY_LOST, RESIDUAL, MOMENT, *_list_released_numbers(prepared))
    return Doubt(Reason.of("mechanics.studies.jumped", steps=step_text, share=100.0 * share), names)


def check_elements(path: RodPath, line: Line) -> Doubt | None:
    """Doubt numbers if elements are too long for the bends of the line.

    Parameters
    ----------
    path : of the line
    line : of the path

    Notes
    -----
    If an element turns by 30 degrees, the error of the smallest bend radius is 0.3 % for a heavy
    line and 1 % for a lifted chain. If it turns by 90 degrees, that error is up to 7 %, that of
    forces 1 %, and that of the shape 0.3 % of the length.
    """
    max_turn, excessive_turn = float(np.radians(30.0)), float(np.radians(90.0))
    lengths = np.maximum(np.append(line.lengths, 0.0), np.append(0.0, line.lengths))
    turns = [
        lengths * compute_curvature(state, line) for state in path.states
    ]  # over longer elements
    row, node, turn = _find_largest(turns)
    count = len(line.lengths)
    if turn <= max_turn:
        return None
    reason = Reason.of(
        "mechanics.studies.long_elements",
        step=row,
        place=1e3 * line.stations[node],
        turn=np.degrees(turn),
        count=count,
        wanted=math.ceil(count * turn / max_turn),
    )
    names: tuple[str, ...] = (RADIUS_ON_PATH,)
    if len(line.section.law.stiffnesses):
        names += (RESIDUAL, ENERGY_LOST)
    if turn > excessive_turn:
        names = ("", RADIUS_ON_PATH)
    elif turns[-1].max() > max_turn:
        names = (RADIUS, MOMENT, *names)
    return Doubt(reason, names)


def check_unloading(path: RodPath, prepared: PreparedLine) -> Doubt | None:
    """Doubt numbers that depend on unloading if the law unloads by Masing's rule.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries

    Notes
    -----
    By Masing's rule copper springs back two to four times as far as standards of annealed wire
    allow. A law with growing sliders does not follow this rule. The numbers are residual curvature,
    lost energy, the shape of a released line, and forces and moments of a line that was unbent and
    has several supports, so that they depend on its law.
    """
    law = prepared.line.section.law
    if law.growing:
        return None
    bound = bound_residual_curvature(path, law)
    node = int(np.argmax(bound))
    residual = float(compute_residual_curvature(path.last, law)[node])
    if bound[node] <= max(_MIN_CURVATURE, 1.1 * residual):
        return None
    reason = Reason.of(
        "mechanics.studies.unloading_assumed",
        place=1e3 * prepared.line.stations[node],
        by_rule=residual,
        without_sliding=bound[node],
    )
    return Doubt(reason, list_unloading_numbers(path, prepared))


def list_unloading_numbers(path: RodPath, prepared: PreparedLine) -> tuple[str, ...]:
    """Return the names of numbers that depend on unloading; see `check_unloading`.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries
    """
    names = [ENERGY_LOST, RESIDUAL, *_list_released_numbers(prepared)]
    supports = [
        boundary
        for boundary in prepared.boundaries
        if isinstance(boundary, HOLDS) and not _is_released(boundary)
    ]
    if len(supports) > 1 and measure_unbending(path) > 0.1:  # of the largest curvature
        names += [FORCE, MOMENT]
    return tuple(names)


def check_share(intervals: Mapping[str, Interval], names: Sequence[str]) -> Iterator[Doubt]:
    """Doubt numbers with wide intervals if the hardening of the copper is unknown.

    Parameters
    ----------
    intervals : of numbers, by name
    names : of numbers that depend on unloading, or the beginnings of their names
    """
    max_ratio = 2.0  # of the ends of an interval; heights and forces may be about zero
    positive = tuple(name for name in names if name in (ENERGY_LOST, RESIDUAL, SPRINGBACK, RADIUS))
    for name, interval in intervals.items():
        if name.startswith(positive) and interval.upper > max_ratio * interval.lower:
            low, high = interval.lower, interval.upper
            reason = Reason.of("mechanics.studies.share_unknown", low=low, high=high)
            yield Doubt(reason, (name,))


def _list_released_numbers(prepared: PreparedLine) -> tuple[str, ...]:
    """Return the names of the numbers that a release of the line changes."""
    return (SPRINGBACK, RADIUS, LOWEST_POINT) if any(map(_is_released, prepared.boundaries)) else ()


def _is_released(boundary: rod.Boundary) -> bool:
    return isinstance(boundary, rod.Held) and boundary.release is not None


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

    @property
    def is_signed(self) -> bool:
        """Return whether it may be negative: a coordinate, not a size."""
        return self.name == LOWEST_POINT


def estimate_size(unit: str, line: Line) -> float:
    """Estimate the magnitude of a quantity for a line bent to the curvature 1 / length.

    Parameters
    ----------
    unit : of a number: m, 1/m, N, N*m or J
    line : with its length and first stiffness
    """
    length, stiffness = line.length, line.section.law.first_stiffness
    moment = stiffness / length
    return {"m": length, "1/m": 1.0 / length, "N": moment / length, "N*m": moment, "J": moment}[
        unit
    ]


def compute_numbers(path: RodPath, prepared: PreparedLine) -> tuple[Number, ...]:
    """Compute the numbers of a harness at its last step and over the whole path.

    Parameters
    ----------
    path : of the line, to the last step
    prepared : line and boundaries
    """
    return tuple(_yield_numbers(path, prepared))


def _yield_numbers(path: RodPath, prepared: PreparedLine) -> Iterator[Number]:
    fields, last, line = collect_fields(path, prepared), len(path.states) - 1, prepared.line

    def number(name: str, unit: str, remark: str = "") -> Number:
        value = float(evaluate_number(name, fields.__getitem__, prepared, last))
        return Number(name, value, unit, remark)

    def place(node: int) -> str:
        return f"{_format_mm(line.stations[node])} from the start"

    end, overall = (
        find_sharpest_bend(path, line, [last]),
        find_sharpest_bend(path, line, range(last + 1)),
    )
    yield Number(RADIUS, end.radius, "m", f"{_format_mm(end.place)} from the start")
    where = f"step {overall.step}, {_format_mm(overall.place)} from the start"
    yield Number(RADIUS_ON_PATH, overall.radius, "m", where)
    lowest = int(np.argmin(compute_heights(path.last.positions, prepared)))
    yield number(LOWEST_POINT, "m", place(lowest))
    forces = np.array([compute_norms(state.reaction_forces) for state in path.states])
    for k, boundary in enumerate(prepared.boundaries):
        if isinstance(boundary, HOLDS):
            step = int(np.argmax(forces[:, k]))
            remark = f"largest in all steps: {forces[step, k]:.4g} N at step {step}"
            yield number(f"{FORCE}{boundary.name}", "N", remark)
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield number(f"{MOMENT}{boundary.name}", "N*m")
    for boundary in prepared.boundaries:
        if isinstance(boundary, rod.Held) and boundary.release is not None:
            remark = (
                f"from its place in step {boundary.release - 1}, the last one before the release"
            )
            yield number(f"{SPRINGBACK}{boundary.name}", "m", remark)
    law = line.section.law
    residual = compute_residual_curvature(path.last, law)
    node = int(np.argmax(residual))
    rule = "" if law.growing else ", by Masing's rule"
    remark = f"{place(node)}; if released{rule}" if residual[node] else ""
    yield number(RESIDUAL, "1/m", remark)
    yield number(ENERGY_LOST, "J", "in bending, since the start")


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
    return tuple(
        _build_result(
            number, (*reasons, *_select_reasons(number, doubts)), intervals.get(number.name)
        )
        for number in numbers
    )


def _select_reasons(number: Number, doubts: Sequence[Doubt]) -> Iterator[Reason]:
    """Yield the reasons of the doubts about this number."""
    for doubt in doubts:
        # the name of this number begins with that of another one
        is_named = number.name != RADIUS_ON_PATH or RADIUS_ON_PATH in doubt.names
        if number.name.startswith(doubt.names) and is_named:
            yield doubt.reason


def _build_result(number: Number, reasons: tuple[Reason, ...], interval: Interval | None) -> Result:
    if not np.isfinite(number.value):
        reason = Reason.of("mechanics.studies.straight")
        return Result(number.name, None, number.unit, None, Status.FAILED, (reason,))
    status = Status.DOUBTFUL if reasons else Status.OK
    return Result(
        *(number.name, number.value, number.unit, interval, status, reasons), remark=number.remark
    )


def _format_mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
