"""Numbers of a solved harness and their doubts: bend radii, forces, curvature after release."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.line import Line
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.mechanics.studies.harness_responses import (
    ENERGY_LOST,
    FORCE,
    HOLDS,
    LOWEST_POINT,
    MOMENT,
    RADIUS,
    RADIUS_ON_PATH,
    RESIDUAL,
    SPRINGBACK,
    curvature_vectors,
    evaluate_number,
    fields_of,
    heights_of,
    largest_of_sides,
    largest_unbending,
    residual_curvature,
    unloading_reason,
)
from labpipe.mechanics.studies.harness_section import Material
from labpipe.protocol.harness_file import HarnessFile
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status


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
    source = f"assumed: {diameters:g} times the outer diameter of {_mm(material.diameter)}"
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


def turns_of(state: RodState, line: Line) -> Floats:
    """Return the turn at each node over its longer element, rad, shape (n + 1,)."""
    lengths = np.maximum(np.append(line.lengths, 0.0), np.append(0.0, line.lengths))
    return np.asarray(lengths * curvature_of(state, line))


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
    curvature = np.array([curvature_of(path.states[step], line) for step in steps])
    row, node = divmod(int(np.argmax(curvature)), curvature.shape[1])
    radius = float(radius_of(curvature[row, node : node + 1])[0])
    return Bend(radius, steps[row], float(line.stations[node]))


def reasons_of(path: RodPath, line: Line, material: Material) -> tuple[Reason, ...]:
    """Return the reasons why all numbers of a harness are doubtful or missing.

    Parameters
    ----------
    path : of the line
    line : of the path
    material : with the limits of curvature and stretch of its law
    """
    reasons = [
        Reason(reason.code, _nodes_to_places(reason.sentence, line)) for reason in path.reasons
    ]
    if not path.states:
        return tuple(reasons)
    bent = np.array([state.bendings for state in path.states])
    row, node = divmod(int(np.argmax(bent)), bent.shape[1])
    codes = {reason.code for reason in reasons}
    if bent[row, node] > material.limit and "beyond_law" not in codes:
        message = (
            f"step {row}, {_mm(line.stations[node])} from the start: the line is bent to "
            f"{bent[row, node]:.4g} 1/m, its law is supported up to {material.limit:.4g} 1/m by "
            f"{material.limit_source}"
        )
        reasons.append(Reason("beyond_backed", message))
    stretches = np.abs([state.stretches for state in path.states])
    row, element = divmod(int(np.argmax(stretches)), stretches.shape[1])
    if stretches[row, element] > material.stretch_limit:
        message = (
            f"step {row}, {_mm(line.stations[element])} from the start: the line is stretched by "
            f"{100.0 * stretches[row, element]:.2g} %, its axial stiffness is supported up to "
            f"{100.0 * material.stretch_limit:.2g} %, where copper yields"
        )
        reasons.append(Reason("beyond_stretch", message))
    return tuple(reasons)


def _nodes_to_places(sentence: str, line: Line) -> str:
    """Replace numbers of nodes in a sentence of the rod by places along the line."""

    def place(node: str) -> str:
        return _mm(line.stations[int(node)])

    def at_nodes(match: re.Match[str]) -> str:
        return f"between {place(match[1])} and {place(match[2])} from the start"

    def with_end(match: re.Match[str]) -> str:
        return f"with its end {place(match[1])} from the start: put it further in, or move less"

    sentence = re.sub(r"between nodes (\d+) and (\d+)", at_nodes, sentence)
    sentence = re.sub(r"with its node (\d+)", with_end, sentence)
    return re.sub(r"\bnode (\d+)", lambda match: f"{place(match[1])} from the start", sentence)


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
    message = (
        f"step {step_text}: the line jumped (it snapped or was released) and lost "
        f"{100.0 * share:.0f} % of the energy; history-dependent results depend on its motion, "
        "which is unknown"
    )
    names = (ENERGY_LOST, RESIDUAL, MOMENT, *_names_after_release(prepared))
    return Doubt(Reason("jumped", message), names)


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
    turns = np.array([turns_of(state, line) for state in path.states])
    row, node = divmod(int(np.argmax(turns)), turns.shape[1])
    turn, count = float(turns[row, node]), len(line.lengths)
    if turn <= max_turn:
        return None
    message = (
        f"step {row}, {_mm(line.stations[node])} from the start: the line turns by "
        f"{np.degrees(turn):.0f} deg over one of its {count} elements; the error of its bend "
        f"exceeds 1 %: take {math.ceil(count * turn / max_turn)} elements or more"
    )
    names: tuple[str, ...] = (RADIUS_ON_PATH,)
    if len(line.section.law.stiffnesses):
        names += (RESIDUAL, ENERGY_LOST)
    if turn > excessive_turn:
        names = ("", RADIUS_ON_PATH)
    elif turns[-1].max() > max_turn:
        names = (RADIUS, MOMENT, *names)
    return Doubt(Reason("coarse_elements", message), names)


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
    if reason is None:
        return None
    names = [ENERGY_LOST, RESIDUAL, *_names_after_release(prepared)]
    holding = [e for e in prepared.boundaries if isinstance(e, HOLDS) and not _is_released(e)]
    if len(holding) > 1 and largest_unbending(path) > 0.1:  # of the sharpest bend
        names += [FORCE, MOMENT]
    return Doubt(reason, tuple(names))


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
    """Return the order of magnitude of a unit for a line bent over its length.

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
    fields, steps = fields_of(path, prepared), len(path.states) - 1

    def value(name: str) -> float:
        return float(evaluate_number(name, fields.__getitem__, prepared, steps))

    bends = _bend_numbers(path, prepared, value(LOWEST_POINT))
    forces = _force_numbers(path, prepared, value)
    return (*bends, *forces, *_release_numbers(path, prepared, value))


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
        reason = Reason("straight", "the line is straight and has no bend radius")
        return Result(number.name, None, number.unit, None, Status.FAILED, (reason,))
    status = Status.DOUBTFUL if reasons else Status.OK
    return Result(
        *(number.name, number.value, number.unit, interval, status, reasons), remark=number.remark
    )


def _bend_numbers(path: RodPath, prepared: PreparedLine, lowest: float) -> Iterator[Number]:
    last, line = len(path.states) - 1, prepared.line
    end, overall = sharpest(path, line, [last]), sharpest(path, line, range(last + 1))
    yield Number(RADIUS, end.radius, "m", f"{_mm(end.place)} from the start")
    where = f"step {overall.step}, {_mm(overall.place)} from the start"
    yield Number(RADIUS_ON_PATH, overall.radius, "m", where)
    node = int(np.argmin(heights_of(path.last.positions, prepared)))
    yield Number(LOWEST_POINT, lowest, "m", f"{_mm(line.stations[node])} from the start")


def _force_numbers(
    path: RodPath, prepared: PreparedLine, value: Callable[[str], float]
) -> Iterator[Number]:
    sizes = np.array([np.linalg.norm(state.reaction_forces, axis=1) for state in path.states])
    for number, boundary in enumerate(prepared.boundaries):
        if not isinstance(boundary, HOLDS):
            continue
        largest = int(np.argmax(sizes[:, number]))
        remark = f"largest on the way: {sizes[largest, number]:.4g} N at step {largest}"
        yield Number(f"{FORCE}{boundary.name}", value(f"{FORCE}{boundary.name}"), "N", remark)
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield Number(f"{MOMENT}{boundary.name}", value(f"{MOMENT}{boundary.name}"), "N*m", "")


def _release_numbers(
    path: RodPath, prepared: PreparedLine, value: Callable[[str], float]
) -> Iterator[Number]:
    for boundary in prepared.boundaries:
        if isinstance(boundary, rod.Held) and boundary.release is not None:
            remark = f"against step {boundary.release - 1}, the last one before its release"
            name = f"{SPRINGBACK}{boundary.name}"
            yield Number(name, value(name), "m", remark)
    residual = residual_curvature(path.last, prepared.line.section.law)
    node = int(np.argmax(residual))
    where = f"{_mm(prepared.line.stations[node])} from the start; if released, by Masing's rule"
    yield Number(RESIDUAL, value(RESIDUAL), "1/m", where if residual[node] else "")
    yield Number(ENERGY_LOST, value(ENERGY_LOST), "J", "in bending, since the start")


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
