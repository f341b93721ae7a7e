"""Rods bent by `labpipe.mechanics.rod.statics` in cases whose answers are known.

Each case gives its error: found less wanted, the wanted numbers from `rod_references` or formulas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from labpipe.mechanics.law.sliders import SliderLaw, make_linear_law
from labpipe.mechanics.rod.boundaries import Gravity, Held, Load, Plane
from labpipe.mechanics.rod.line import Line, Section, build_line
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import build_frame
from labpipe.mechanics.rod.statics import RodSettings, follow
from labpipe.records.arrays import Floats
from tests.builders.rods import straight_line
from tests.judges.rod_references import (
    LEVEL,
    Kirchhoff,
    bend_of_45_degrees,
    buckled_column,
    critical_torque,
    heavy_cantilever,
)

FAR = 1e6
"""1/m, end of the laws' range: no case gets there."""
GRAVITY = 9.81
STRETCH = 1e5
"""N, of rods whose both ends are held."""


def section(
    bending: float = 1.0, torsion: float = 0.8, *, weight: float = 0.0, stretch: float = np.inf
) -> Section:
    """An elastic section; stiffnesses in N m^2 and N, weight in N/m."""
    law = make_linear_law(bending, FAR)
    return Section(law, torsion, axial_stiffness=stretch, mass_per_length=weight / GRAVITY)


def grown(vector: tuple[float, float, float], steps: int) -> Floats:
    """A path from zero to a vector in equal steps."""
    return np.asarray(np.linspace(0.0, 1.0, steps + 1)[:, None] * np.array(vector))


def tip(path: RodPath) -> Floats:
    """Last node of the last state, m, of a path that is all right."""
    assert path.status == "ok", path.reasons
    return np.asarray(path.last.positions[-1])


def clamped(line: Line) -> Held:
    """The first node, in the frame of the first element."""
    return Held(0, line.positions[0], line.frames[0])


def heavy_cantilever_error(elements: int, weight: float) -> Floats:
    """Of drop and shortening of the tip, of the length; weight is w L^3 / EI."""
    line = straight_line(1.0, elements, section(weight=weight))
    steps = 1 + int(weight**0.5)
    x, _, z = tip(
        follow(line, [clamped(line), Gravity(grown((0, 0, -GRAVITY), steps))], steps=steps)
    )
    drop, shortening, _ = heavy_cantilever(weight)
    return np.array([-z - drop, 1.0 - x - shortening])


def buckled_column_error(elements: int, degrees: float, *, steps: int = 8) -> Floats:
    """Of height and offset of the top of a column clamped at its foot, of the length."""
    line = straight_line(1.0, elements, section(), direction=(0, 0, 1), up=(1, 0, 0))
    load, height, offset = buckled_column(np.radians(degrees))
    force = grown((0.0, 0.0, -load * np.pi**2 / 4.0), steps)
    x, y, z = tip(follow(line, [clamped(line), Load(-1, force)], steps=steps))
    return np.array([z - height, np.hypot(x, y) - offset])


def torque_that_buckles(elements: int, *, torsion: float = 0.8, step: float = 1e-3) -> float:
    """M L / B at which a clamped straight rod leaves its line, over the least that theory has.

    One clamp is turned by shares of the twist that buckles it in theory, in the end in small steps.
    """
    shares = np.append(np.linspace(0.0, 0.9, 19)[:-1], np.arange(0.9, 1.06 + 0.5 * step, step))
    line = straight_line(1.0, elements, section(torsion=torsion, stretch=STRETCH))
    twist = Rotation.from_rotvec(np.outer(shares * critical_torque() / torsion, [1.0, 0.0, 0.0]))
    frames = (twist * Rotation.from_quat(line.frames[-1], scalar_first=True)).as_quat(
        scalar_first=True
    )
    grips = [clamped(line), Held(-1, line.positions[-1], frames)]
    path = follow(line, grips, steps=len(shares) - 1)
    aside = [float(np.max(np.abs(state.positions[:, 1:]))) for state in path.states]
    at = int(np.argmax(np.array(aside) > 1e-6))
    assert at > 0
    return float(0.5 * (shares[at - 1] + shares[at]))


def pressed_column_path(
    elements: int, steps: int, law: SliderLaw | None = None, *, stretch: float = 1e6
) -> RodPath:
    """A column of length 1, both ends clamped, pressed along itself by a fifth of its length.

    Parameters
    ----------
    elements, steps : of the line and of its walk
    law : of its bending; None for a stiffness of 1
    stretch : axial stiffness, of the bending stiffness over the square of the length
    """
    own = Section(law, 1.0, axial_stiffness=stretch) if law else section(stretch=stretch)
    line = straight_line(1.0, elements, own)
    way = line.positions[-1] - grown((0.2, 0.0, 0.0), steps)
    return follow(line, [clamped(line), Held(-1, way, line.compute_clamp_frame(-1))], steps=steps)


def arch_path(loads: Floats | None = None, ways: Floats | None = None) -> RodPath:
    """A flat arch, both ends clamped, pushed down in its middle; it stays in its plane.

    Parameters
    ----------
    loads : N, step by step, of a force; or
    ways : m, step by step, by which the node is brought down

    Notes
    -----
    Length and stiffness are 1, and it leans so little that it snaps through as a whole. Sideways it
    would buckle first, so that stability is not checked.
    """
    angle = np.linspace(-0.3, 0.3, 17)
    points = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1) / 0.6
    own = section(stretch=1.2e4)
    line = build_line(points, own, up=(0.0, 1.0, 0.0), is_rest_shape=True)
    ends = [Held(node, line.positions[node], line.compute_clamp_frame(node)) for node in (0, -1)]
    down, rows = np.array([0.0, 0.0, -1.0]), loads if ways is None else ways
    assert rows is not None
    push = rows[:, None] * down
    drive = Load(8, push) if ways is None else Held(8, line.positions[8] + push)
    settings = RodSettings(checks_stability=False)
    return follow(line, [*ends, drive], steps=len(rows) - 1, settings=settings)


def bend_path(elements: int, *, load: float = 600.0, torsion: float = 1.0 / 6.0) -> RodPath:
    """The bend of 45 degrees, as `bend_of_45_degrees` puts it, its load grown in six steps."""
    angle = np.linspace(0.0, 0.25 * np.pi, elements + 1)
    points = 100.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle), np.zeros_like(angle)], axis=1)
    line = build_line(points, section(1e7 / 12.0, 5e6 * torsion), is_rest_shape=True)
    frame = build_frame(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    force = Load(-1, grown((0.0, 0.0, load), 6))
    return follow(line, [Held(0, np.zeros(3), frame), force], steps=6)


def bend_tip(elements: int, *, load: float = 600.0, torsion: float = 1.0 / 6.0) -> Floats:
    """Tip of the bend of 45 degrees, m."""
    return tip(bend_path(elements, load=load, torsion=torsion))


def bend_error(elements: int, *, load: float = 600.0) -> Floats:
    """Of the tip of the bend of 45 degrees, m."""
    return bend_tip(elements, load=load) - bend_of_45_degrees(load)


POSED = Kirchhoff((1.0, 1.0, 0.7), 1.0, frame=LEVEL)
"""Of the rod posed in space; its weight is 3 N/m."""


def posed_rod() -> tuple[Floats, Floats, Floats, Floats]:
    """Both ends clamped in space: places, frames, moments, and the far clamp's force."""
    weight = np.array([0.0, 0.0, -3.0])
    start = POSED.under(np.array([1.0, 4.0, 5.0]), weight)
    return POSED.to(start[0][-1] * 0.85, start[1][-1], weight, start=start, stations=81)


def posed_rod_error(elements: int) -> tuple[float, float]:
    """Largest distance of a node, of the length, and error of the far clamp's force, of the force.

    The walk: level and straight, then by a path of the far clamp that nobody else takes.
    """
    places, frames, _, force = posed_rod()
    line = straight_line(1.0, elements, section(torsion=0.7, weight=3.0))
    first = Rotation.from_quat(line.frames[0], scalar_first=True)
    to_own = Rotation.from_quat(np.array(POSED.frame), scalar_first=True).inv() * first
    end = (Rotation.from_quat(frames[-1], scalar_first=True) * to_own).as_rotvec()
    share = np.linspace(0.0, 1.0, 21)
    turn = Rotation.from_rotvec(
        share[:, None] * (Rotation.from_rotvec(end) * first.inv()).as_rotvec()
    )
    grip = (turn * first).as_quat(scalar_first=True)
    way = line.positions[-1] + share[:, None] * (places[-1] - line.positions[-1])
    weight = Gravity(grown((0.0, 0.0, -GRAVITY), 20))
    path = follow(line, [clamped(line), Held(-1, way, grip), weight], steps=20)
    tip(path)
    stations = np.linspace(0, len(places) - 1, elements + 1).astype(int)
    off = np.linalg.norm(path.last.positions - places[stations], axis=1)
    pull = path.last.reaction_forces[1] - force
    return float(np.max(off)), float(np.linalg.norm(pull) / np.linalg.norm(force))


@dataclass(frozen=True)
class LiftedChain:
    """A chain on a table with friction, its middle lifted, slowly.

    Parameters
    ----------
    length, height : m, of the whole chain, and by which the middle is lifted
    friction : coefficient
    weight : N/m
    """

    length: float = 1.0
    height: float = 0.25
    friction: float = 0.5
    weight: float = 1.0

    @property
    def lying(self) -> float:
        """Length that still lies on the table on one side, m.

        What hangs is a catenary that leaves the table level, of parameter a = H / w = friction
        times what lies; its length s and height h have s^2 = h^2 + 2 a h.
        """
        half, most = 0.5 * self.length, 0.5 * self.length + self.friction * self.height
        return float(most - np.sqrt(most**2 - (half**2 - self.height**2)))

    @property
    def pull(self) -> float:
        """Horizontal force, the same in all that hangs, N: friction of what lies."""
        return self.friction * self.weight * self.lying

    def half_shape(self, arc: Floats) -> tuple[Floats, Floats]:
        """Distance from the middle and height, m, at arc lengths from the middle."""
        hanging = 0.5 * self.length - self.lying
        above = np.clip(hanging - arc, 0.0, None)
        if self.friction == 0.0:
            return np.clip(arc - hanging, 0.0, None), above
        a = self.friction * self.lying
        across = a * (np.arcsinh(hanging / a) - np.arcsinh(above / a))
        return across + np.clip(arc - hanging, 0.0, None), np.hypot(a, above) - a


def lifted_half(chain: LiftedChain, elements: int, soft: float, *, steps: int = 20) -> RodPath:
    """Half of it, held where its middle is: links that resist bending by EI = GJ = soft, N m^2."""
    line = straight_line(0.5 * chain.length, elements, section(soft, soft, weight=chain.weight))
    way = np.zeros((steps + 1, 3))
    way[:, 2] = np.linspace(0.0, chain.height, steps + 1)
    table = Plane(np.zeros(3), friction=chain.friction)
    return follow(line, [Held(0, way), Gravity(np.array([0.0, 0.0, -GRAVITY])), table], steps=steps)
