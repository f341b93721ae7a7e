"""Reasons to doubt numbers of a harness: range of its law, jumps, unloading, steps and elements.

The state of sliders and friction depends on the path, which is straight within a step. The error
decreases at least linearly with the size of the steps; therefore it is at most the change between
the solution and one with half as many steps. Steps at corners of a path are kept; if most steps are
at corners, twice as many steps are taken instead. The error of the elements decreases with the
square of their length; it is a third of the change between the solution and one with half as many.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw, present_sliders
from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors, unit
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.mechanics.studies.harness_material import Material
from labpipe.mechanics.studies.harness_numbers import (
    ENERGY_LOST,
    FORCE,
    HOLDS,
    LOWEST_POINT,
    MOMENT,
    RADIUS,
    RADIUS_ON_PATH,
    RESIDUAL,
    SPRINGBACK,
    Doubt,
    compute_curvature,
    compute_numbers,
    compute_residual_curvature,
    estimate_sizes,
    find_largest,
    format_place,
    list_releases,
)
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason

MAX_CHANGE = 0.02
"""Largest relative change of a number between both solutions."""
MAX_CHANGE_OF_BAND = 0.1
"""Largest change over the width of the number's band; the larger of both limits is allowed."""
_PATHS = ("position", "frame", "anchor", "force", "moment", "vector")
_MIN_CURVATURE = 1e-3
"""1/m; below it a line is straight."""


def find_reasons(path: RodPath, material: Material) -> tuple[Reason, ...]:
    """Return the reasons why all numbers of a harness are doubtful or missing.

    Parameters
    ----------
    path : of the line
    material : with the limits of curvature and stretch of its law
    """
    places = [format_place(station) for station in path.line.stations]
    reasons = [Reason(reason.code, reason.at(places.__getitem__)) for reason in path.reasons]
    if not path.states:
        return tuple(reasons)
    step, node, curvature = find_largest([state.bendings for state in path.states])
    if curvature > material.limit and "beyond_law" not in {reason.code for reason in reasons}:
        reasons.append(
            Reason.of(
                "mechanics.studies.beyond_backed",
                step=step,
                place=places[node],
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
                place=places[element],
                stretch=100.0 * stretch,
                limit=100.0 * material.stretch_limit,
            )
        )
    return tuple(reasons)


def check_path(path: RodPath, half: PreparedLine, intervals: Mapping[str, Interval]) -> list[Doubt]:
    """Return the doubts about some numbers of a complete path.

    Parameters
    ----------
    path : of the line
    half : the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    doubts = [check_elements(path), check_jumps(path), check_unloading(path)]
    return [*filter(None, doubts), *check_convergence(path, half, intervals)]


def check_jumps(path: RodPath) -> Doubt | None:
    """Doubt history-dependent numbers if much energy was lost in jumps.

    Parameters
    ----------
    path : of the line

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


def check_elements(path: RodPath) -> Doubt | None:
    """Doubt numbers if elements are too long for the bends of the line.

    Parameters
    ----------
    path : of the line

    Notes
    -----
    If an element turns by 30 degrees, the error of the smallest bend radius is 0.3 % for a heavy
    line and 1 % for a lifted chain. If it turns by 90 degrees, that error is up to 7 %, that of
    forces 1 %, and that of the shape 0.3 % of the length.
    """
    max_turn, excessive_turn = float(np.radians(30.0)), float(np.radians(90.0))
    line = path.line
    # the longer element at each node
    lengths = np.maximum(np.append(line.lengths, 0.0), np.append(0.0, line.lengths))
    turns = [lengths * compute_curvature(state) for state in path.states]
    step, node, turn = find_largest(turns)
    count = len(line.lengths)
    if turn <= max_turn:
        return None
    reason = Reason.of(
        "mechanics.studies.long_elements",
        step=step,
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


def check_unloading(path: RodPath) -> Doubt | None:
    """Doubt numbers that depend on unloading if the law unloads by Masing's rule.

    Parameters
    ----------
    path : of the line

    Notes
    -----
    By Masing's rule copper springs back two to four times as far as standards of annealed wire
    allow. A law with growing sliders does not follow this rule. The numbers are residual curvature,
    lost energy, the shape of a released line, and forces and moments of a line that was unbent and
    has several supports, so that they depend on its law.
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
    path : of the line
    law : of the line

    Notes
    -----
    The bound assumes that no slider slides on unloading: it is the largest sum of K_j a_j of all
    steps over the first stiffness.
    """
    if not law.history_size:
        return np.zeros(len(path.last.positions))
    sliders = [present_sliders(law, state.rests) for state in path.states]
    moments = [np.einsum("j,nsjx->nsx", part.stiffnesses, part.rests) for part in sliders]
    return np.asarray(np.linalg.norm(moments, axis=-1).max(axis=(0, 2)) / law.first_stiffness)


def list_unloading_numbers(path: RodPath) -> tuple[str, ...]:
    """Return the names of numbers that depend on unloading; see `check_unloading`.

    Parameters
    ----------
    path : of the line
    """
    names = (ENERGY_LOST, RESIDUAL, *_list_released_numbers(path))
    supports = [edge for edge in path.boundaries if isinstance(edge, HOLDS)]
    if len(supports) - len(list_releases(path)) > 1 and measure_unbending(path) > 0.1:
        names += (FORCE, MOMENT)
    return names


def measure_unbending(path: RodPath) -> float:
    """Return the largest decrease of curvature at a node over the largest curvature of the line.

    Parameters
    ----------
    path : of the line
    """
    curvature = np.array([state.bendings for state in path.states])
    largest = curvature.max(axis=0)
    return float(np.max(largest - curvature[-1]) / max(float(largest.max()), _MIN_CURVATURE))


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


def _list_released_numbers(path: RodPath) -> tuple[str, ...]:
    """Return the names of the numbers that a release of the line changes."""
    return (SPRINGBACK, RADIUS, LOWEST_POINT) if list_releases(path) else ()


def check_convergence(
    path: RodPath, half: PreparedLine, intervals: Mapping[str, Interval]
) -> Iterator[Doubt]:
    """Yield the doubts about numbers that depend on the numbers of steps and elements.

    For a line with a history, half as many of both are tried at once. Steps and elements are
    checked separately only if numbers change then.

    Parameters
    ----------
    path : of the line
    half : the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    steps, has_history = len(path.states) - 1, depends_on_history(path)
    if has_history:
        _, other = solve_in_other_steps(half, steps)
        if other.status != "failed" and not _find_excess_changes(path, other, intervals):
            return
    doubts = [check_element_count(path, follow(*half, steps=steps), intervals)]
    if has_history:
        own = PreparedLine(path.line, path.boundaries)
        doubts.append(check_steps(path, *solve_in_other_steps(own, steps), intervals))
    yield from filter(None, doubts)


def depends_on_history(line: RodPath | PreparedLine) -> bool:
    """Return whether a line depends on its history, through sliders or friction on a plane.

    Parameters
    ----------
    line : with its boundaries
    """
    rough = (edge.friction > 0.0 for edge in line.boundaries if isinstance(edge, rod.Plane))
    return len(line.line.section.law.stiffnesses) > 0 or any(rough)


def select_coarse_steps(boundaries: Sequence[rod.Boundary], steps: int) -> Ints:
    """Select every other step, and the steps with a corner of a path or a release.

    Parameters
    ----------
    boundaries : of the line
    steps : their number
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
    moves = np.diff(path, axis=0)
    if is_frame:
        moves = to_rotation_vectors(multiply(conjugate(path[:-1]), path[1:]))
    max_change = min_corner_share * float(np.max(np.linalg.norm(moves, axis=1)))
    changes = np.linalg.norm(np.diff(moves, axis=0), axis=1)
    return (np.flatnonzero(changes > max_change) + 1).tolist()


def solve_in_other_steps(prepared: PreparedLine, steps: int) -> tuple[Floats, RodPath]:
    """Solve a line in about half as many steps, or in twice as many if it has many corners.

    Parameters
    ----------
    prepared : line and boundaries
    steps : of its first solution

    Returns
    -------
    The times of the steps, where step k of the first solution is at time k; and the path.
    """
    times = np.asarray(select_coarse_steps(prepared.boundaries, steps), dtype=np.float64)
    if len(times) - 1 > 0.75 * steps:  # hardly coarser
        times = np.linspace(0.0, steps, 2 * steps + 1, dtype=np.float64)
    boundaries = tuple(_resample(boundary, times) for boundary in prepared.boundaries)
    return times, follow(prepared.line, boundaries, steps=len(times) - 1)


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


def check_steps(
    path: RodPath, times: Floats, other: RodPath, intervals: Mapping[str, Interval]
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of steps, if any.

    Parameters
    ----------
    path : of the line
    times, other : of `solve_in_other_steps`
    intervals : by name, of those numbers that have one
    """
    steps = len(path.states) - 1
    steps_text = "twice as many" if np.any(times % 1.0 > 0.0) else "half as many"
    if other.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_steps",
            steps=steps_text,
            failure=other.reasons[0].code,
            count=steps,
            wanted=2 * steps,
        )
        return _doubt_all(reason, path)
    excess = _find_excess_changes(path, other, intervals)
    if not excess:
        return None
    reason = Reason.of(
        "mechanics.studies.too_coarse",
        steps=steps_text,
        change=100.0 * MAX_CHANGE,
        of_band=100.0 * MAX_CHANGE_OF_BAND,
        place=_find_worst_place(path, times, other),
        count=steps,
        wanted=steps * math.ceil(max(excess.values())),
    )
    return Doubt(reason, tuple(excess))


def check_element_count(
    path: RodPath, other: RodPath, intervals: Mapping[str, Interval]
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of elements, if any.

    Parameters
    ----------
    path : of the line
    other : of the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    error_share = 1.0 / 3.0  # of the change by half as many elements: a method of second order
    count = len(path.line.lengths)
    if other.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_elements",
            failure=other.reasons[0].code,
            count=count,
            wanted=2 * count,
        )
        return _doubt_all(reason, path)
    excess = _find_excess_changes(path, other, intervals, share=error_share)
    if not excess:
        return None
    reason = Reason.of(
        "mechanics.studies.few_elements",
        change=100.0 * MAX_CHANGE / error_share,
        of_band=100.0 * MAX_CHANGE_OF_BAND / error_share,
        worst=max(excess, key=lambda name: excess[name]),
        count=count,
        wanted=max(2 * count, math.ceil(count * math.sqrt(max(excess.values())))),
    )
    return _doubt_all(reason, path)  # another number may be unchanged by chance


def _doubt_all(reason: Reason, path: RodPath) -> Doubt:
    return Doubt(reason, tuple(number.name for number in compute_numbers(path)))


def _find_excess_changes(
    path: RodPath, other: RodPath, intervals: Mapping[str, Interval], share: float = 1.0
) -> dict[str, float]:
    """Return the ratio of error to allowed error of numbers where it exceeds 1.

    The error is a share of the change between both solutions. It is allowed relative to the size of
    the number or to the width of its band. The size has a minimum, which follows from the numbers
    of the same unit.
    """
    min_coordinate_share = 0.05  # of the length of the line
    min_size_share = 1e-3  # of the largest number of the same unit
    numbers = [number for number in compute_numbers(path) if math.isfinite(number.value)]
    others = {number.name: number.value for number in compute_numbers(other)}
    largest = estimate_sizes(path.line)
    for number in numbers:
        largest[number.unit] = max(largest[number.unit], abs(number.value))
    ratios = {}
    for number in numbers:
        size = max(abs(number.value), min_size_share * largest[number.unit])
        if number.name == LOWEST_POINT:  # a coordinate, which may be negative
            size = max(size, min_coordinate_share * path.line.length)
        band = intervals.get(number.name)
        width = 0.0 if band is None else MAX_CHANGE_OF_BAND * (band.upper - band.lower)
        allowed = max(MAX_CHANGE * size, width) or math.inf
        ratios[number.name] = share * abs(others[number.name] - number.value) / allowed
    return {name: ratio for name, ratio in ratios.items() if 1.0 < ratio < math.inf}


def _find_worst_place(path: RodPath, times: Floats, other: RodPath) -> str:
    """Describe the step and the place in which the difference of the moments increases most."""
    whole_steps = np.flatnonzero(times % 1.0 == 0.0)
    steps = times[whole_steps].astype(int)
    first = np.array([path.states[step].moments for step in steps])
    second = np.array([other.states[row].moments for row in whole_steps])
    distance = np.linalg.norm(second - first, axis=3).max(axis=2)
    row, node = divmod(int(np.argmax(np.diff(distance, axis=0, prepend=0.0))), distance.shape[1])
    return f"step {steps[row]}, {format_place(path.line.stations[node])}"
