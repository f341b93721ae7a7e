"""Two wires that others hung as loops and posed by a robot, and the rod with fixed stiffnesses.

Nothing is fitted here: bending stiffnesses are those of the hangs, torsional ones those of a clamp
that was turned until the loop left its plane (`docs/explanations/rod.md`). The files are in
the folder of real exports (`rods`). In a pose the wire starts straight, 0.40 m long, between a
clamp and the hand of the robot, which goes to its place, turns, and twists the wire.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.rod.boundaries import Boundary, Gravity, Held
from labpipe.mechanics.rod.line import Line, Section, build_line
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import (
    compute_shortest_rotations,
    from_rotation_vectors,
    multiply,
    to_matrices,
)
from labpipe.mechanics.rod.statics import follow
from labpipe.records.arrays import Floats
from tests.builders.rods import straight_line

pytestmark = [pytest.mark.slow, pytest.mark.realdata]

LEVEL = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
WIRES = {"white": (0.793e-4, 0.793e-4, 0.087 / 5.0), "black": (0.827e-3, 1.17e-3, 0.081 / 2.98)}
"""Bending and torsional stiffness, N m^2, and mass, kg/m."""
SLOPES = {"white": 0.0, "black": 4.5}
"""1/m, free curvature at the end of a hung wire less that in its middle."""
POSES = (
    ((0.0, 40.0, -30.0), 360.0),
    ((0.0, 0.0, 0.0), -720.0),
    ((0.0, -10.0, -50.0), 360.0),
    ((10.0, -20.0, -50.0), -720.0),
)
"""Rotation vector of the hand, and twist about the wire, degrees."""


def section_of(wire: str) -> Section:
    stiffness, torsion, mass = WIRES[wire]
    law = SliderLaw(stiffness, np.zeros(0), np.zeros(0), 0.0, 1e6)
    return Section(law, torsion, mass_per_length=mass)


def hung(points: Floats, wire: str, *, elements: int = 200) -> Floats:
    """Places of a wire of 1.5 m that hangs between the level clamps of a photograph."""
    shares = np.linspace(0.0, 1.0, elements + 1)
    seen = np.linspace(0.0, 1.0, len(points))
    nodes = np.column_stack([np.interp(shares, seen, point) for point in points.T])
    normal = np.sign(np.sum(np.cross(points[:-1], points[1:]), axis=0)[1])
    along = build_line(nodes, section_of(wire), up=(0.0, float(normal), 0.0))
    free = np.zeros((elements - 1, 3))
    free[:, 0] = SLOPES[wire] * (2.0 * shares[1:-1] - 1.0)
    free[:, 0] *= normal * to_matrices(along.frames[:1])[0, 1, 0]
    lengths = np.full(elements, 1.5 / elements)
    line = Line(lengths, section_of(wire), along.positions, along.frames, free)
    ends = along.frames[[0, -1]]
    frames = multiply(compute_shortest_rotations(to_matrices(ends)[:, :, 2], LEVEL), ends)
    held = [Held(0, nodes[0], frames[0]), Held(-1, nodes[-1], frames[1])]
    path = follow(line, [*held, Gravity(np.array([0.0, 0.0, -9.81]))], steps=0)
    assert path.status != "failed", path.reasons
    places = path.last.positions.T
    return np.column_stack([np.interp(seen, shares, place) for place in places])


@pytest.mark.parametrize(("wire", "bound"), [("white", 6e-3), ("black", 15e-3)])
def test_hanging_loops(wire: str, bound: float, realdata: Path) -> None:
    """Five photographs of each wire; the mean distance from its places to them."""
    rows = np.genfromtxt(
        realdata / "rods" / f"adapteddlo_{wire}_hangs.csv", delimiter=",", skip_header=1
    )
    off = []
    for across, up in np.moveaxis(rows[:, 1:].reshape(len(rows), -1, 2), 2, 1):
        points = np.column_stack([across, 0.0 * across, up])
        off.append(np.linalg.norm(hung(points, wire) - points, axis=1).mean())
    assert len(off) == 5
    assert max(off) < bound


def posed(wire: str, turned: tuple[float, float, float], twist: float, hand: Floats) -> RodPath:
    """Follow the wire into a pose: 30 steps of the way, 36 of the twist, 5 for the weight."""
    line = straight_line(0.40, 50, section_of(wire))
    at = np.arange(67)[:, None]
    way, turn = np.clip(at / 30, 0.0, 1.0), np.clip((at - 30) / 36, 0.0, 1.0)
    moved = multiply(from_rotation_vectors(way * np.radians(turned)), line.frames[-1])
    along = to_matrices(moved[-1:])[0, :, 2]
    frames = multiply(from_rotation_vectors(turn * np.radians(twist) * along), moved)
    places = (1 - way) * line.positions[-1] + way * hand
    lifted = np.clip(at / 5, 0.0, 1.0)
    held: list[Boundary] = [
        Held(0, line.positions[0], line.frames[0]),
        Held(-1, places, frames),
        Gravity(lifted * np.array([0.0, 0.0, -9.81])),
    ]
    return follow(line, held, steps=66)


def distance(points: Floats, path: RodPath) -> float:
    """Mean distance from points to the line, m: points have no mark on the wire."""
    nodes = path.last.positions
    start, way = nodes[:-1], np.diff(nodes, axis=0)
    off = points[:, None] - start
    share = np.clip(np.sum(off * way, axis=2) / np.sum(way**2, axis=1), 0.0, 1.0)
    return float(np.linalg.norm(off - share[..., None] * way, axis=2).min(axis=1).mean())


@pytest.mark.parametrize(("wire", "bounds"), [("white", [7e-3] * 4), ("black", [11e-3] * 3)])
def test_poses_in_space(wire: str, bounds: list[float], realdata: Path) -> None:
    """In its last pose the black wire snapped over, and lies on itself in the picture."""
    file = realdata / "rods" / f"adapteddlo_{wire}_arm3d.csv"
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    for number, (pose, bound) in enumerate(zip(POSES, bounds, strict=False)):
        points = rows[rows[:, 0] == number, 5:]
        points = points - points[0]
        path = posed(wire, *pose, points[-1])
        assert path.status != "failed", path.reasons
        assert distance(points, path) < bound
        if (wire, number) == ("white", 1):
            other_way = posed(wire, pose[0], -pose[1], points[-1])
            assert distance(points, other_way) > 3.0 * bound
