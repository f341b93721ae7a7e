"""A wire between a clamp and the hand of a robot, in four poses: what was done, seen and computed.

The frame is that of the pictures: x to the right, y away from the camera, z up. The clamp is on the
left, and the wire leaves it to the right; it starts straight, 0.40 m long. The hand goes to its
place, turns, and then the clamp is turned about the wire (here the hand, the other way: the same).

Places of the hand are taken as seen, since they differ from those asked for by up to 20 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.law.sliders import SliderLaw
from labpipe.records.arrays import Floats
from labpipe.rod.boundaries import Boundary, Gravity, Held
from labpipe.rod.line import Section
from labpipe.rod.path import RodPath
from labpipe.rod.rotations import from_rotation_vectors, matrices, multiply
from labpipe.rod.statics import follow
from tests.builders.real_wires import RealWire
from tests.builders.rods import straight_line

LENGTH = 0.40
"""m, between clamp and hand."""
_MOVING, _TURNING, _LIFTED = 30, 36, 5
"""Steps: of the way, of the twist, and in which the weight comes on."""
_ELEMENTS = 50


@dataclass(frozen=True, slots=True)
class Pose:
    """What the hand does.

    Parameters
    ----------
    turned : rotation vector, degrees
    twist : about the wire, away from the clamp, degrees
    """

    turned: tuple[float, float, float]
    twist: float


POSES = (
    Pose((0.0, 40.0, -30.0), 360.0),
    Pose((0.0, 0.0, 0.0), -720.0),
    Pose((0.0, -10.0, -50.0), 360.0),
    Pose((10.0, -20.0, -50.0), -720.0),
)
"""Of both wires. The authors' scripts give them in the frame of the tool, which points along the
wire, away from the robot: its (x, y, z) is (-z, -y, -x) here."""


def seen(wire: RealWire, folder: Path) -> list[Floats]:
    """Points picked in the pictures of the four poses, from the clamp on, shape (points, 3), m."""
    file = folder / "rods" / f"adapteddlo_{wire.name}_arm3d.csv"
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    poses = [rows[rows[:, 0] == number, 5:] for number in range(len(POSES))]
    return [each - each[0] for each in poses]


def posed(
    wire: RealWire,
    pose: Pose,
    hand: Floats,
    stiffness: float,
    torsion: float,
    *,
    twist: float = 1.0,
) -> RodPath:
    """Follow the wire into a pose.

    Parameters
    ----------
    wire : for its mass
    pose : what the hand does
    hand : shape (3,), m, where it ends
    stiffness, torsion : of bending and torsion, N m^2
    twist : share of the pose's twist
    """
    law = SliderLaw(stiffness, np.zeros(0), np.zeros(0), 0.0, 1e6)
    section = Section(law, torsion, mass_per_length=wire.mass)
    line = straight_line(LENGTH, _ELEMENTS, section)
    way = np.clip(np.arange(_MOVING + _TURNING + 1) / _MOVING, 0.0, 1.0)[:, None]
    turn = np.clip((np.arange(_MOVING + _TURNING + 1) - _MOVING) / _TURNING, 0.0, 1.0)[:, None]
    moved = multiply(from_rotation_vectors(way * np.radians(pose.turned)), line.frames[-1])
    along = matrices(moved[-1:])[0, :, 2]
    frames = multiply(from_rotation_vectors(turn * twist * np.radians(pose.twist) * along), moved)
    places = (1 - way) * line.positions[-1] + way * hand
    lifted = np.clip(np.arange(len(way)) / _LIFTED, 0.0, 1.0)[:, None]
    held: list[Boundary] = [
        Held(0, line.positions[0], line.frames[0]),
        Held(-1, places, frames),
        Gravity(lifted * np.array([0.0, 0.0, -9.81])),
    ]
    return follow(line, held, steps=len(way) - 1)


def distances(points: Floats, path: RodPath) -> Floats:
    """From each point to the nearest place of the line, m: points have no mark on the wire."""
    nodes = path.last.positions
    start, way = nodes[:-1], np.diff(nodes, axis=0)
    off = points[:, None] - start
    share = np.clip(np.sum(off * way, axis=2) / np.sum(way**2, axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(off - share[..., None] * way, axis=2).min(axis=1))
