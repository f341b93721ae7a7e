"""Results of a solved harness, and reasons to doubt them: bend radii, forces, residual curvature.

They are computed from fields: vectors that respond smoothly to inputs. A norm, a minimum or a
maximum is not smooth at zero or where its place changes. Therefore the response is linear in the
fields, and each number is computed from them in every draw as from a solved line. Residual
curvature of a released line is that of its law.
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
from labpipe.mechanics.rod.response import Fields, sizes
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
    weights = [each.vector[-1] for each in prepared.boundaries if isinstance(each, rod.Gravity)]
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
    match name:
        case "smallest_bend_radius":
            return _max_curvature(field(f"{CURVATURES}{steps}"))
        case "smallest_bend_radius_on_the_way":  # step by step, to limit the memory for draws
            names = (f"{CURVATURES}{step}" for step in range(steps + 1))
            return reduce(np.maximum, (_max_curvature(field(name)) for name in names))
        case "lowest_point":
            return np.asarray(heights_of(field(POSITIONS), prepared).min(axis=-1))
        case "kept_curvature":
            return _max_curvature(field(RESIDUAL))
        case "energy_lost":
            return np.maximum(field(ENERGY_LOST), 0.0)
    return sizes(field(name))


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
    at the curvature reached if no slider slides. Without sliders it is 0. The limit of a growing
    slider stays: released, it does not slide.
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
        bent = np.linalg.norm(curvature[..., None, :] - sliders.rests, axis=-1)
        weights = stiffnesses * slips / np.maximum(bent, slips)
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
    if not law.history_size:
        return np.zeros(len(path.last.positions))
    sizes = []
    for state in path.states:
        sliders = present_sliders(law, state.rests)
        kept = np.einsum("j,nsjx->nsx", sliders.stiffnesses, sliders.rests)
        sizes.append(np.linalg.norm(kept, axis=2).max(axis=1))
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
    if law.growing:
        return None
    largest = max_residual_curvature(path, law)
    node = int(np.argmax(largest))
    residual = float(residual_curvature(path.last, law)[node])
    if largest[node] <= max(_MIN_CURVATURE, 1.1 * residual):
        return None
    return Reason.of(
        "mechanics.studies.unloading_assumed",
        place=1e3 * line.stations[node],
        by_rule=residual,
        without_sliding=largest[node],
    )


@dataclass(frozen=True, slots=True)
class BendLimit:
    """The allowed bend radius.

    Parameters
    ----------
    radius : m
    source : of the number
    is_assumed : whether it is not stated
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


def bend_limit(harness: HarnessFile, material: Material) -> BendLimit:
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


def curvature_of(state: RodState, line: Line) -> Floats:
    """Return the curvature of the line, 1/m, shape (n + 1,), rest curvature included.

    Parameters
    ----------
    state : of the line
    line : in this state

    Notes
    -----
    The larger one where both sides of a node differ at a clip.
    """
    return largest_of_sides(curvature_vectors(state, line))


def radius_of(curvature: Floats) -> Floats:
    """Return the bend radius, m; infinite where the line is straight.

    Parameters
    ----------
    curvature : 1/m, any shape
    """
    min_curvature = 1e-6  # 1/m
    is_bent = curvature > min_curvature
    return np.asarray(np.where(is_bent, 1.0 / np.where(is_bent, curvature, 1.0), np.inf))


def sharpest(path: RodPath, line: Line, steps: Sequence[int]) -> Bend:
    """Find the sharpest bend among some steps.

    Parameters
    ----------
    path : of the line
    line : of the path
    steps : at least one
    """
    row, node, curvature = _largest([curvature_of(path.states[step], line) for step in steps])
    radius = float(radius_of(np.array(curvature)))
    return Bend(radius, steps[row], float(line.stations[node]))


def reasons_of(path: RodPath, line: Line, material: Material) -> tuple[Reason, ...]:
    """Return the reasons why all numbers of a harness are doubtful or missing.

    Parameters
    ----------
    path : of the line
    line : of the path
    material : with the limits of curvature and stretch of its law
    """

    def place(node: int) -> str:
        return f"{_mm(line.stations[node])} from the start"

    reasons = [Reason(reason.code, reason.at(place)) for reason in path.reasons]
    if not path.states:
        return tuple(reasons)
    row, node, bent = _largest([state.bendings for state in path.states])
    if bent > material.limit and "beyond_law" not in {reason.code for reason in reasons}:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_backed",
                step=row,
                place=place(node),
                curvature=bent,
                limit=material.limit,
                source=material.limit_source,
            )
        )
    row, element, stretch = _largest([np.abs(state.stretches) for state in path.states])
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


def _largest(values_by_step: Sequence[Floats]) -> tuple[int, int, float]:
    """Return step and place of the largest number, and the number."""
    values = np.array(values_by_step)
    row, place = divmod(int(np.argmax(values)), values.shape[1])
    return row, place, float(values[row, place])


@dataclass(frozen=True, slots=True)
class Doubt:
    """The reason why some of the numbers are doubtful.

    Parameters
    ----------
    reason : of the doubt
    names : beginnings of the names of these numbers
    """

    reason: Reason
    names: tuple[str, ...]


def jump_doubt(path: RodPath, prepared: PreparedLine) -> Doubt | None:
    """Return the doubt about history-dependent numbers if much energy was lost in jumps.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries

    Notes
    -----
    A line that buckles or is released passes through states that are no equilibria. Its motion
    there is unknown, and the state of the sliders depends on it. A released line may swing, so
    that its shape depends on it, too: with little damping the shape in MuJoCo differs by 0.5 % of
    the length where 7 % of the energy is lost in jumps, 2 % where it is 17 %, and 6 % where it is
    33 %.
    """
    share = float(path.lost_in_jumps[-1] / path.lost[-1]) if path.lost[-1] > 0.0 else 0.0
    if share <= 0.1:  # of the energy lost
        return None
    fell = np.diff(path.lost_in_jumps, prepend=0.0)
    step_text = ", ".join(map(str, np.flatnonzero(fell > 0.1 * np.max(fell))))
    names = (ENERGY_LOST, RESIDUAL, MOMENT, *_names_after_release(prepared))
    return Doubt(Reason.of("mechanics.studies.jumped", steps=step_text, share=100.0 * share), names)


def element_doubt(path: RodPath, line: Line) -> Doubt | None:
    """Return the doubt about numbers if elements are too long for the bends of the line.

    Parameters
    ----------
    path : of the line
    line : of the path

    Notes
    -----
    With turns of 30 degrees over an element the error of the smallest bend radius is 0.3 % for a
    heavy line and 1 % for a lifted chain. With 90 degrees it is up to 7 %, that of forces 1 %, and
    that of the shape 0.3 % of the length.
    """
    max_turn, excessive_turn = float(np.radians(30.0)), float(np.radians(90.0))
    lengths = np.maximum(np.append(line.lengths, 0.0), np.append(0.0, line.lengths))
    turns = [lengths * curvature_of(state, line) for state in path.states]  # over longer elements
    row, node, turn = _largest(turns)
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


def unloading_doubt(path: RodPath, prepared: PreparedLine) -> Doubt | None:
    """Return the doubt about numbers that depend on unloading, if any.

    Parameters
    ----------
    path : of the line
    prepared : line and boundaries

    Notes
    -----
    These are the shape of a released line, and forces and moments of a line that was unbent and has
    more than one support, so that they depend on its law. See `unloading_reason`.
    """
    reason = unloading_reason(path, prepared.line)
    return None if reason is None else Doubt(reason, unloading_names(path, prepared))


def unloading_names(path: RodPath, prepared: PreparedLine) -> tuple[str, ...]:
    """Return the names of numbers that depend on unloading: see `unloading_doubt`."""
    names = [ENERGY_LOST, RESIDUAL, *_names_after_release(prepared)]
    holding = [e for e in prepared.boundaries if isinstance(e, HOLDS) and not _is_released(e)]
    if len(holding) > 1 and largest_unbending(path) > 0.1:  # of the sharpest bend
        names += [FORCE, MOMENT]
    return tuple(names)


def share_doubts(intervals: Mapping[str, Interval], names: Sequence[str]) -> Iterator[Doubt]:
    """Yield doubts about numbers with wide intervals, as the hardening of the copper is not known.

    Parameters
    ----------
    intervals : of numbers, by name
    names : of numbers that depend on unloading, or their beginnings
    """
    max_ratio = 2.0  # of the ends of an interval; heights and forces may be about zero
    sized = tuple(name for name in names if name in (ENERGY_LOST, RESIDUAL, SPRINGBACK, RADIUS))
    for name, interval in intervals.items():
        if name.startswith(sized) and interval.upper > max_ratio * interval.lower:
            facts = interval.lower, interval.upper
            reason = Reason.of("mechanics.studies.share_unknown", low=facts[0], high=facts[1])
            yield Doubt(reason, (name,))


def _names_after_release(prepared: PreparedLine) -> tuple[str, ...]:
    """Return the names of numbers of the shape of a released line."""
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


def reference_size(unit: str, line: Line) -> float:
    """Return the typical magnitude of a quantity in this unit, for a line bent to 1 / length.

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


def numbers_of(path: RodPath, prepared: PreparedLine) -> tuple[Number, ...]:
    """Return the numbers of a harness at its last step and over the whole path.

    Parameters
    ----------
    path : of the line, to the last step
    prepared : line and boundaries
    """
    return tuple(_numbers(path, prepared))


def _numbers(path: RodPath, prepared: PreparedLine) -> Iterator[Number]:
    fields, last, line = fields_of(path, prepared), len(path.states) - 1, prepared.line

    def number(name: str, unit: str, remark: str = "") -> Number:
        value = float(evaluate_number(name, fields.__getitem__, prepared, last))
        return Number(name, value, unit, remark)

    def place(node: int) -> str:
        return f"{_mm(line.stations[node])} from the start"

    end, overall = sharpest(path, line, [last]), sharpest(path, line, range(last + 1))
    yield Number(RADIUS, end.radius, "m", f"{_mm(end.place)} from the start")
    where = f"step {overall.step}, {_mm(overall.place)} from the start"
    yield Number(RADIUS_ON_PATH, overall.radius, "m", where)
    lowest = int(np.argmin(heights_of(path.last.positions, prepared)))
    yield number(LOWEST_POINT, "m", place(lowest))
    forces = np.array([sizes(state.reaction_forces) for state in path.states])
    for k, boundary in enumerate(prepared.boundaries):
        if isinstance(boundary, HOLDS):
            step = int(np.argmax(forces[:, k]))
            remark = f"largest on the way: {forces[step, k]:.4g} N at step {step}"
            yield number(f"{FORCE}{boundary.name}", "N", remark)
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield number(f"{MOMENT}{boundary.name}", "N*m")
    for boundary in prepared.boundaries:
        if isinstance(boundary, rod.Held) and boundary.release is not None:
            remark = f"against step {boundary.release - 1}, the last one before its release"
            yield number(f"{SPRINGBACK}{boundary.name}", "m", remark)
    law = line.section.law
    residual = residual_curvature(path.last, law)
    node = int(np.argmax(residual))
    rule = "" if law.growing else ", by Masing's rule"
    remark = f"{place(node)}; if released{rule}" if residual[node] else ""
    yield number(RESIDUAL, "1/m", remark)
    yield number(ENERGY_LOST, "J", "in bending, since the start")


def results_of(
    numbers: Sequence[Number],
    reasons: tuple[Reason, ...],
    intervals: Mapping[str, Interval],
    doubts: Sequence[Doubt] = (),
) -> tuple[Result, ...]:
    """Return numbers as results.

    Parameters
    ----------
    numbers : of a harness
    reasons : of a doubt about all of them
    intervals : by name, of those that have one
    doubts : about some of them
    """
    return tuple(
        _result(number, (*reasons, *_reasons_for(number, doubts)), intervals.get(number.name))
        for number in numbers
    )


def _reasons_for(number: Number, doubts: Sequence[Doubt]) -> Iterator[Reason]:
    """Yield the reasons of the doubts about this number."""
    for doubt in doubts:
        # its name begins with that of another number
        is_named = number.name != RADIUS_ON_PATH or RADIUS_ON_PATH in doubt.names
        if number.name.startswith(doubt.names) and is_named:
            yield doubt.reason


def _result(number: Number, reasons: tuple[Reason, ...], interval: Interval | None) -> Result:
    if not np.isfinite(number.value):
        reason = Reason.of("mechanics.studies.straight")
        return Result(number.name, None, number.unit, None, Status.FAILED, (reason,))
    status = Status.DOUBTFUL if reasons else Status.OK
    return Result(
        *(number.name, number.value, number.unit, interval, status, reasons), remark=number.remark
    )


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
