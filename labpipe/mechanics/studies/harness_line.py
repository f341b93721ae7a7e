"""Translation of a harness file to the rod: nodes, shape at rest, and paths of all boundaries.

Every place of the line that the file names becomes a node. A path has a row for the start and one
for each step. At the start all boundaries are at the line in its shape at rest. They move straight
from one pose to the next, their direction turns about the axis normal to both directions, and their
turn about the line is added. A ring starts at the nearest point of the line. The anchor of a string
that is too short starts as near to its goal as the string allows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.line import Line, Section, build_line
from labpipe.mechanics.rod.rotations import (
    find_shortest_turns,
    from_rotation_vectors,
    multiply,
    to_matrices,
    to_rotation_vectors,
    unit,
)
from labpipe.messages import format_sentence
from labpipe.protocol.harness_file import (
    HOLDERS,
    Clip,
    Grip,
    HarnessFile,
    Holder,
    Load,
    Pin,
    Plane,
    Ring,
    Spool,
    String,
    Vector3,
    Waypoint,
    compute_path,
    find_line_start,
)
from labpipe.records.arrays import Floats

LENGTH_FACTOR = "length_factor"
"""Logarithm of the factor on the length of the line."""
FREE_CURVATURES = ("free_curvature_1", "free_curvature_2")
"""Additions to the rest curvature, 1/m: towards the side of the spool, and across it."""
Inputs = Mapping[str, float]


class PreparedLine(NamedTuple):
    """A line with all its boundaries, ready to be solved.

    Parameters
    ----------
    line : in its shape at rest
    boundaries : in the order of the file; the weight, if any, is the last one
    """

    line: Line
    boundaries: tuple[rod.Boundary, ...]


def prepare_line(harness: HarnessFile, section: Section, inputs: Inputs) -> PreparedLine:
    """Prepare the line of a harness.

    Parameters
    ----------
    harness : as read
    section : of the line
    inputs : `LENGTH_FACTOR` and `FREE_CURVATURES`, 0 where missing; others are ignored

    Raises
    ------
    ValueError
        If the section is out of its range, or a spool is in the direction of the line.
    """
    stations = _place_nodes(harness)
    line = _build_line(harness, section, stations * float(np.exp(inputs.get(LENGTH_FACTOR, 0.0))))
    free = np.array([inputs.get(name, 0.0) for name in FREE_CURVATURES])
    if np.any(free):
        rest_curvature = line.rest_curvature.copy()
        rest_curvature[:, :2] += free @ _find_bend_axes(line, harness.line.spool)
        line = replace(line, rest_curvature=rest_curvature)
    return PreparedLine(line, tuple(_build_boundaries(harness, line, stations)))


def _find_bend_axes(line: Line, spool: Spool | None) -> Floats:
    """Return the curvatures about d1 and d2 of unit curls towards the spool and across it, (2, 2).

    A line that curls to a side t turns about d3 x t. Without a spool the side is that of d1.
    """
    axes = to_matrices(line.frames[0])
    side = np.array([1.0, 0.0])
    if spool is not None:
        side = (_find_side(spool, axes[:, 2]) @ axes)[:2]
    return np.array([[-side[1], side[0]], [-side[0], -side[1]]])


def _place_nodes(harness: HarnessFile) -> Floats:
    """Return the nodes, m, with elements of equal length between neighbouring named places."""
    length = harness.line.length
    named = (getattr(boundary, "at", 0.0) for boundary in harness.boundaries)
    marks = sorted({0.0, length, *(min(place, length) for place in named)})
    count = harness.line.elements
    parts = [
        np.linspace(low, high, 1 + max(1, round(count * (high - low) / length)))[1:]
        for low, high in pairwise(marks)
    ]
    return np.concatenate([[0.0], *parts])


def _build_line(harness: HarnessFile, section: Section, stations: Floats) -> Line:
    begin, direction = (np.array(vector) for vector in find_line_start(harness))
    spool = harness.line.spool
    if spool is None:
        positions = begin + stations[:, None] * direction
        is_steep = abs(direction[2]) > 0.9
        up = np.array([1.0, 0.0, 0.0] if is_steep else [0.0, 0.0, 1.0])
        return build_line(positions, section, up=up)
    towards = _find_side(spool, direction)
    middles = 0.5 * spool.curvature * (stations[1:] + stations[:-1])
    steps = np.cos(middles)[:, None] * direction + np.sin(middles)[:, None] * towards
    positions = begin + np.vstack(
        [np.zeros(3), np.cumsum(np.diff(stations)[:, None] * steps, axis=0)]
    )
    return build_line(positions, section, up=towards, is_formed=True)


def _find_side(spool: Spool, direction: Floats) -> Floats:
    """Return the unit vector normal to a direction, on the side of a spool."""
    towards = np.array(spool.towards)
    across = towards - (towards @ direction) * direction
    if np.linalg.norm(across) < 1e-6:
        raise ValueError(format_sentence("mechanics.studies.spool_side", towards=spool.towards))
    return np.asarray(unit(across))


def _build_boundaries(harness: HarnessFile, line: Line, stations: Floats) -> Iterator[rod.Boundary]:
    """Yield the boundaries; stations are those of the nodes by the file."""
    steps = harness.steps
    for boundary in harness.boundaries:
        name = boundary.name
        place = min(getattr(boundary, "at", 0.0), stations[-1])
        node = int(np.argmin(np.abs(stations - place)))
        match boundary:
            case Clip() | Pin() | Grip():
                yield _build_held(boundary, line, node, steps)
            case Ring():
                start = _find_nearest_point(line, boundary)
                path = _build_path(start, boundary.position, boundary.by or steps, steps)
                yield rod.Ring(path, np.array(boundary.direction), name=name)
            case String():
                start = compute_path(boundary, line.positions[node], steps)[0]
                path = _build_path(start, boundary.anchor, boundary.by or steps, steps)
                yield rod.String(node, path, boundary.length, name=name)
            case Load():
                force = _build_ramp(boundary.by or steps, steps)[:, None] * np.array(boundary.force)
                yield rod.Load(node, force, name=name)
            case Plane():
                table = np.array(boundary.point), np.array(boundary.normal)
                yield rod.Plane(*table, boundary.friction, name=name)
    if any(harness.gravity) and line.section.mass_per_length > 0.0:
        yield rod.Gravity(_build_gravity(harness), name="weight")


def _find_nearest_point(line: Line, ring: Ring) -> Floats:
    """Return the point of the line that is nearest to a ring."""
    target = np.array(ring.position)
    node = int(np.argmin(np.linalg.norm(line.positions - target, axis=1)))
    place = rod.find_nearest_place(line.positions, target, float(node))
    return rod.evaluate_curve(line.positions, place)


def _build_path(begin: Floats, goal: Vector3, by: int, steps: int) -> Floats:
    """Return the straight path from the start to a goal, (steps + 1, 3), or the goal, (3,).

    A path without motion is a single point, because its rounding errors would look like corners.
    """
    min_distance = 1e-9  # m
    displacement = np.array(goal) - begin
    if np.linalg.norm(displacement) < min_distance:
        return np.array(goal)
    return np.asarray(begin + _build_ramp(by, steps)[:, None] * displacement)


def _build_gravity(harness: HarnessFile) -> Floats:
    """Return the acceleration; it grows step by step if two places of the line are held.

    An inextensible line that starts taut cannot carry its whole weight at once.
    """
    full = np.array(harness.gravity)
    if sum(isinstance(boundary, HOLDERS) for boundary in harness.boundaries) < 2:
        return full
    share = _build_ramp(max(1, harness.steps // 5), harness.steps)
    return np.asarray(share[:, None] * full)


def _build_ramp(by: int, steps: int) -> Floats:
    """Return a ramp from 0 at the start to 1 at a step, constant after it, shape (steps + 1,)."""
    return np.minimum(1.0, np.arange(steps + 1) / by)


def _build_held(boundary: Holder, line: Line, node: int, steps: int) -> rod.Held:
    position = compute_path(boundary, line.positions[node], steps)
    frame = None
    if isinstance(boundary, Clip) or (isinstance(boundary, Grip) and boundary.holds == "pose"):
        frame = _interpolate_frames(boundary, line.frame_at(node), steps)
    return rod.Held(node, position, frame, boundary.release, boundary.name)


def _interpolate_frames(boundary: Clip | Grip, start: Floats, steps: int) -> Floats:
    """Interpolate the frames of a path: directions without twist, multiplied by the turns."""
    frames, turns = [start], {0: 0.0}
    points = boundary.path if isinstance(boundary, Grip) else (boundary,)
    for point in points:
        step = point.step if isinstance(point, Waypoint) else point.by or steps
        span = step - len(frames) + 1
        start_direction = to_matrices(frames[-1])[:, 2]
        direction = start_direction if point.direction is None else np.array(point.direction)
        full = to_rotation_vectors(find_shortest_turns(start_direction, direction))
        shares = np.arange(1, span + 1) / span
        moved = from_rotation_vectors(shares[:, None] * full)
        frames += list(multiply(moved, np.tile(frames[-1], (span, 1))))
        turns[step] = turns[step - span] if point.turn is None else point.turn
    frames += [frames[-1]] * (steps + 1 - len(frames))
    about = np.zeros((steps + 1, 3))
    about[:, 2] = np.interp(np.arange(steps + 1), list(turns), list(turns.values()))
    return np.asarray(multiply(np.array(frames), from_rotation_vectors(about)))
