"""Lines for tests of the rod: small, with sliders, in general position."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw, make_linear_law
from labpipe.mechanics.rod.boundaries import Boundary, Gravity, Held, Load
from labpipe.mechanics.rod.line import Line, Section, build_line
from labpipe.mechanics.rod.path import RodPath, RodState
from labpipe.mechanics.rod.rotations import (
    build_frame,
    from_rotation_vectors,
    multiply,
    normalise,
    to_matrices,
)
from labpipe.mechanics.rod.statics import follow
from labpipe.records.arrays import Floats

STIFFNESS = 1e-3
SLIDING = SliderLaw(
    0.3e-3, np.array([0.4e-3, 0.2e-3, 0.1e-3]), np.array([0.5, 2.0, 5.0]), 0.0, 80.0
)
"""Of 1e-3 N m^2 before anything slides."""
LENGTH = 0.5


def linear_section(
    stiffness: float = STIFFNESS, *, torsion: float = 0.8e-3, mass: float = 0.0
) -> Section:
    """A section without sliders."""
    return Section(make_linear_law(stiffness, 1e6), torsion, mass_per_length=mass)


def straight_line(
    length: float,
    n: int,
    section: Section,
    *,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0),
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> Line:
    """A line of equal elements that is straight at rest, d1 as near to `up` as can be."""
    frame = build_frame(np.asarray(direction), np.asarray(up))
    along = normalise(np.asarray(direction, dtype=np.float64))
    positions = np.asarray(start) + np.linspace(0.0, length, n + 1)[:, None] * along
    return Line(
        np.full(n, length / n), section, positions, np.tile(frame, (n, 1)), np.zeros((n - 1, 3))
    )


def sliding_section(*, mass: float = 0.0) -> Section:
    """A section with three sliders."""
    return Section(SLIDING, 0.8e-3, mass_per_length=mass)


def clamp(line: Line, node: int = 0) -> Held:
    """Hold an end of a line where it is, with its frame."""
    return Held(node, line.positions[node], line.compute_clamp_frame(node))


def ramp(peak: tuple[float, float, float], steps: int) -> Floats:
    """From nothing to a peak, shape (steps + 1, 3)."""
    return np.asarray(np.linspace(0.0, 1.0, steps + 1)[:, None] * np.array(peak))


def there_and_back(peak: tuple[float, float, float], steps: int, cycles: int = 1) -> Floats:
    """From nothing to a peak, to its opposite and so on: turns at odd quarters of a cycle."""
    turns = np.concatenate([[0.0], np.tile([1.0, -1.0], cycles), [0.0]])
    at = np.linspace(0.0, len(turns) - 1.0, steps + 1)
    return np.asarray(np.interp(at, np.arange(len(turns)), turns)[:, None] * np.array(peak))


def space_case(turn: Floats | None = None, *, steps: int = 6) -> tuple[Line, list[Boundary]]:
    """A curved line with sliders, its ends moved and turned in space, under its weight and a load.

    Its elements are not alike, and it is curved at rest, so that no step snaps.

    Parameters
    ----------
    turn : unit quaternion, shape (4,), that everything is turned by
    steps : of the walk
    """
    angle = np.linspace(0.0, 1.2, 13) ** 1.1
    points = np.stack([np.sin(angle), 1.0 - np.cos(angle), 0.1 * angle], axis=1)
    scale = LENGTH / np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    line = build_line(scale * points, sliding_section(mass=0.02), is_rest_shape=True)
    way = line.positions[-1] + ramp((-0.1, 0.06, 0.03), steps)
    twist = from_rotation_vectors(ramp((0.4, -0.3, 0.9), steps))
    frames = multiply(twist, line.compute_clamp_frame(-1)[None])
    load, weight = ramp((0.0, 0.02, -0.01), steps), ramp((0.0, 0.0, -9.81), steps)
    first = line.compute_clamp_frame(0)
    if turn is not None:
        space = to_matrices(turn)
        line = Line(
            line.lengths,
            line.section,
            line.positions @ space.T,
            multiply(turn, line.frames),
            line.rest_curvature,
        )
        way, load, weight = way @ space.T, load @ space.T, weight @ space.T
        frames, first = multiply(turn, frames), multiply(turn, first)
    return line, [
        Held(0, line.positions[0], first),
        Held(-1, way, frames),
        Load(4, load),
        Gravity(weight),
    ]


def reversed_case(line: Line, boundaries: list[Boundary]) -> tuple[Line, list[Boundary]]:
    """The same line with its nodes counted from the other end.

    Frames turn half round about d1: the line then points the other way.
    """
    half = np.array([0.0, 1.0, 0.0, 0.0])
    flipped = line.rest_curvature[::-1] * np.array([-1.0, 1.0, 1.0])
    other = Line(
        line.lengths[::-1],
        line.section,
        line.positions[::-1],
        multiply(line.frames[::-1], half),
        flipped,
    )
    out: list[Boundary] = []
    for boundary in boundaries:
        if isinstance(boundary, Held):
            frame = None if boundary.frame is None else multiply(boundary.frame, half)
            out.append(Held(-1 - boundary.node, boundary.position, frame, boundary.release))
        elif isinstance(boundary, Load):
            out.append(Load(-1 - boundary.node, boundary.force))
        else:
            out.append(boundary)
    return other, out


def walked(line: Line, boundaries: list[Boundary], steps: int) -> RodPath:
    """A walk that arrives."""
    path = follow(line, boundaries, steps=steps)
    assert path.status == "ok", path.reasons
    assert len(path.states) == steps + 1
    return path


def element_lengths(state: RodState) -> Floats:
    """Of all elements, m."""
    return np.asarray(np.linalg.norm(np.diff(state.positions, axis=0), axis=1))
