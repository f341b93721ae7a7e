"""What a followed harness says: bend radii, forces of clips and grips, what it keeps, doubts."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.protocol.harness_file import HarnessFile
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.records.result import Result, Status
from labpipe.rod import boundaries as rod
from labpipe.rod.line import Line
from labpipe.rod.path import RodPath, RodState
from labpipe.studies.harness_line import PreparedLine
from labpipe.studies.harness_responses import (
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
)
from labpipe.studies.harness_section import Material
from labpipe.studies.residual_curvature import (
    largest_unbending,
    residual_curvature,
    unloading_reason,
)

DEFAULT_BEND_DIAMETERS = 5.0
"""Outer diameters that the allowed bend radius is assumed to be where it is not stated."""
MAX_JUMP_SHARE = 0.1
"""Of the energy that is lost, above which what remembers the way is doubtful."""
MAX_UNBENDING = 0.1
"""Of its sharpest bend, by which a line may have gone back before forces hang on how it unloads."""
_LET_GO = "what the line would keep, let go (Masing)"
MAX_TURN_PER_ELEMENT, EXCESSIVE_TURN = float(np.radians(30.0)), float(np.radians(90.0))
"""Of one element. The smallest bend radius of a heavy line is then off by 0.3 %, of a chain that is
lifted by 1 %; with 90 degrees by up to 7 %, forces by 1 %, the shape by 0.3 % of the length."""


@dataclass(frozen=True, slots=True)
class BendLimit:
    """The bend radius that is allowed.

    Parameters
    ----------
    radius : m
    source : where it comes from
    is_assumed : whether nobody said it
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
    step : in which
    place : m along the line
    """

    radius: float
    step: int
    place: float


def bend_limit(harness: HarnessFile, material: Material) -> BendLimit:
    """The allowed bend radius, or what is assumed of it.

    Parameters
    ----------
    harness : may say it
    material : of the line, whose diameter it is assumed by
    """
    if harness.allowed_bend_radius is not None:
        return BendLimit(harness.allowed_bend_radius, "stated in the file", is_assumed=False)
    source = (
        f"assumed: {DEFAULT_BEND_DIAMETERS:g} times the outer diameter of {_mm(material.diameter)}"
    )
    return BendLimit(DEFAULT_BEND_DIAMETERS * material.diameter, source, is_assumed=True)


def curvature_of(state: RodState, line: Line) -> Floats:
    """Curvature across the line as it lies, 1/m, shape (n + 1,); what it has at rest included.

    Parameters
    ----------
    state : of the line
    line : that it is a state of

    Notes
    -----
    The larger one where a clip parts both sides of a node.
    """
    return largest_of_sides(curvature_vectors(state, line))


def turns_of(state: RodState, line: Line) -> Floats:
    """By how much the line turns at each node over the longer element beside it, rad, (n + 1,)."""
    lengths = np.maximum(np.append(line.lengths, 0.0), np.append(0.0, line.lengths))
    return np.asarray(lengths * curvature_of(state, line))


def radius_of(curvature: Floats) -> Floats:
    """Bend radius, m; infinite where the line is straight.

    Parameters
    ----------
    curvature : 1/m, any shape
    """
    # 1/m; below it the line counts as straight.
    min_curvature = 1e-6
    is_bent = curvature > min_curvature
    return np.asarray(np.where(is_bent, 1.0 / np.where(is_bent, curvature, 1.0), np.inf))


def sharpest(path: RodPath, line: Line, steps: Sequence[int]) -> Bend:
    """Find the sharpest bend among some steps.

    Parameters
    ----------
    path : of the line
    line : that was followed
    steps : at least one
    """
    curvature = np.array([curvature_of(path.states[step], line) for step in steps])
    row, node = divmod(int(np.argmax(curvature)), curvature.shape[1])
    radius = float(radius_of(curvature[row, node : node + 1])[0])
    return Bend(radius, steps[row], float(line.stations[node]))


def reasons_of(path: RodPath, line: Line, material: Material) -> tuple[Reason, ...]:
    """Why the numbers of a harness are doubtful, or why there are none.

    Parameters
    ----------
    path : as followed
    line : that was followed
    material : with the curvature and the stretch up to which its law is backed
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
            f"{bent[row, node]:.4g} 1/m, its law is backed up to {material.limit:.4g} 1/m by "
            f"{material.limit_source}"
        )
        reasons.append(Reason("beyond_backed", message))
    stretches = np.abs([state.stretches for state in path.states])
    row, element = divmod(int(np.argmax(stretches)), stretches.shape[1])
    if stretches[row, element] > material.stretch_limit:
        message = (
            f"step {row}, {_mm(line.stations[element])} from the start: the line is stretched by "
            f"{100.0 * stretches[row, element]:.2g} %, its axial stiffness is backed up to "
            f"{100.0 * material.stretch_limit:.2g} %, where copper yields"
        )
        reasons.append(Reason("beyond_stretch", message))
    return tuple(reasons)


def _nodes_to_places(sentence: str, line: Line) -> str:
    """A sentence of the rod, which counts nodes, in places along the line."""

    def place(node: str) -> str:
        return _mm(line.stations[int(node)])

    said = re.sub(
        r"between nodes (\d+) and (\d+)",
        lambda each: f"between {place(each[1])} and {place(each[2])} from the start",
        sentence,
    )
    said = re.sub(
        r"with its node (\d+)",
        lambda sentence: (
            f"with its end {place(sentence[1])} from the start: put it further in, or move less"
        ),
        said,
    )
    return re.sub(r"\bnode (\d+)", lambda sentence: f"{place(sentence[1])} from the start", said)


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why some of the numbers are doubtful.

    Parameters
    ----------
    reason : why
    names : how the names of these numbers begin
    """

    reason: Reason
    names: tuple[str, ...]


def jump_doubt(path: RodPath, prepared: PreparedLine) -> Doubt | None:
    """Why numbers that remember the way are doubtful, if they are: much was lost in jumps.

    Parameters
    ----------
    path : as followed
    prepared : that was followed

    Notes
    -----
    A line that buckles, or is let go, comes down through states that are no equilibria. How it does
    so is not known, and sliders remember it. One that was let go may swing, so that its shape hangs
    on it, too: with little damping MuJoCo has it elsewhere by 0.5 % of its length where 7 % of the
    energy is lost on its way, 2 % where it is 17 %, and 6 % where it is 33 %.
    """
    share = float(path.lost_in_jumps[-1] / path.lost[-1]) if path.lost[-1] > 0.0 else 0.0
    if share <= MAX_JUMP_SHARE:
        return None
    fell = np.diff(path.lost_in_jumps, prepend=0.0)
    at = ", ".join(map(str, np.flatnonzero(fell > 0.1 * np.max(fell))))
    message = (
        f"step {at}: the line jumped (it snapped, or was let go), and {100.0 * share:.0f} % of the "
        "energy was lost on its way down; what remembers it depends on how it came down and swung "
        "out, which is not known"
    )
    return Doubt(
        Reason("jumped", message), (ENERGY_LOST, RESIDUAL, MOMENT, *_names_after_release(prepared))
    )


def element_doubt(path: RodPath, line: Line) -> Doubt | None:
    """Why numbers are doubtful, if they are: elements are too long for the bend that they follow.

    Parameters
    ----------
    path : as followed
    line : that was followed
    """
    turns = np.array([turns_of(state, line) for state in path.states])
    row, node = divmod(int(np.argmax(turns)), turns.shape[1])
    turn, count = float(turns[row, node]), len(line.lengths)
    if turn <= MAX_TURN_PER_ELEMENT:
        return None
    message = (
        f"step {row}, {_mm(line.stations[node])} from the start: the line turns by "
        f"{np.degrees(turn):.0f} deg over one of its {count} elements, and its bend is not "
        f"followed within 1 %: take {math.ceil(count * turn / MAX_TURN_PER_ELEMENT)} elements or more"
    )
    has_memory = len(line.section.law.stiffnesses) > 0
    names: tuple[str, ...] = (
        (RADIUS_ON_PATH, RESIDUAL, ENERGY_LOST) if has_memory else (RADIUS_ON_PATH,)
    )
    if turn > EXCESSIVE_TURN:
        names = ("", RADIUS_ON_PATH)
    elif turns[-1].max() > MAX_TURN_PER_ELEMENT:
        names = (RADIUS, MOMENT, *names)
    return Doubt(Reason("coarse_elements", message), names)


def unloading_doubt(path: RodPath, prepared: PreparedLine) -> Doubt | None:
    """Why numbers that hang on the way back are doubtful, if they are.

    Parameters
    ----------
    path : as followed
    prepared : that was followed

    Notes
    -----
    Shape, where the line was let go; forces and moments, where it was unbent and is held by more
    than one thing, so that they hang on its law. See `unloading_reason`.
    """
    reason = unloading_reason(path, prepared.line)
    if reason is None:
        return None
    names = [ENERGY_LOST, RESIDUAL, *_names_after_release(prepared)]
    left = [e for e in prepared.boundaries if isinstance(e, HOLDS) and not _is_released(e)]
    if len(left) > 1 and largest_unbending(path) > MAX_UNBENDING:
        names += [FORCE, MOMENT]
    return Doubt(reason, tuple(names))


def _names_after_release(prepared: PreparedLine) -> tuple[str, ...]:
    """Names of what is its shape where a line was let go."""
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
    remark : where and when
    """

    name: str
    value: float
    unit: str
    remark: str = ""

    @property
    def is_signed(self) -> bool:
        """Whether it may be below zero: a coordinate, not a size."""
        return self.name == LOWEST_POINT


def reference_size(unit: str, line: Line) -> float:
    """What a line bent over its own length has of a unit; far less is nothing.

    Parameters
    ----------
    unit : of a number: m, 1/m, N, N*m or J
    line : its length, and the stiffness that it begins with
    """
    length, stiffness = line.length, line.section.law.first_stiffness
    moment = stiffness / length
    return {"m": length, "1/m": 1.0 / length, "N": moment / length, "N*m": moment, "J": moment}[
        unit
    ]


def numbers_of(path: RodPath, prepared: PreparedLine) -> tuple[Number, ...]:
    """The numbers of a harness at its last step, and of the whole way.

    Parameters
    ----------
    path : as followed, to the last step
    prepared : that was followed
    """
    fields, steps = fields_of(path, prepared), len(path.states) - 1

    def value(name: str) -> float:
        return float(evaluate_number(name, fields.__getitem__, prepared, steps))

    bends = _bend_numbers(path, prepared, value(LOWEST_POINT))
    return (
        *bends,
        *_force_numbers(path, prepared, value),
        *_release_numbers(path, prepared, value),
    )


def results_of(
    numbers: Sequence[Number],
    reasons: tuple[Reason, ...],
    intervals: Mapping[str, Interval],
    doubts: Sequence[Doubt] = (),
) -> tuple[Result, ...]:
    """Numbers as results.

    Parameters
    ----------
    numbers : of a harness
    reasons : why all of them are doubtful; empty where they are not
    intervals : by name, of those that have one
    doubts : why some of them are
    """
    return tuple(
        _result(number, (*reasons, *_reasons_for(number, doubts)), intervals.get(number.name))
        for number in numbers
    )


def _reasons_for(number: Number, doubts: Sequence[Doubt]) -> Iterator[Reason]:
    """Why this number is doubtful, of the doubts that touch some."""
    for doubt in doubts:
        is_meant = number.name != RADIUS_ON_PATH or RADIUS_ON_PATH in doubt.names
        if number.name.startswith(doubt.names) and is_meant:
            yield doubt.reason


def _result(number: Number, reasons: tuple[Reason, ...], interval: Interval | None) -> Result:
    if not np.isfinite(number.value):
        return Result(number.name, None, number.unit, None, Status.FAILED, (_STRAIGHT,))
    status = Status.DOUBTFUL if reasons else Status.OK
    return Result(
        *(number.name, number.value, number.unit, interval, status, reasons), remark=number.remark
    )


_STRAIGHT = Reason("straight", "the line is straight: it has no bend radius")


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
        most = int(np.argmax(sizes[:, number]))
        remark = f"largest on the way: {sizes[most, number]:.4g} N at step {most}"
        yield Number(f"{FORCE}{boundary.name}", value(f"{FORCE}{boundary.name}"), "N", remark)
        if isinstance(boundary, rod.Held) and boundary.frame is not None:
            yield Number(f"{MOMENT}{boundary.name}", value(f"{MOMENT}{boundary.name}"), "N*m", "")


def _release_numbers(
    path: RodPath, prepared: PreparedLine, value: Callable[[str], float]
) -> Iterator[Number]:
    for boundary in prepared.boundaries:
        if isinstance(boundary, rod.Held) and boundary.release is not None:
            remark = (
                f"of its place, from step {boundary.release - 1}, the last in which it was held"
            )
            yield Number(
                f"{SPRINGBACK}{boundary.name}",
                value(f"{SPRINGBACK}{boundary.name}"),
                "m",
                remark,
            )
    residual = residual_curvature(path.last, prepared.line.section.law)
    node = int(np.argmax(residual))
    where = f"{_mm(prepared.line.stations[node])} from the start; {_LET_GO}"
    yield Number(RESIDUAL, value(RESIDUAL), "1/m", where if residual[node] else "")
    yield Number(ENERGY_LOST, value(ENERGY_LOST), "J", "in bending, since the start")


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
