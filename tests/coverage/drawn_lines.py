"""Lines that the study of lines draws, by kind and seed: a wire, what nobody knows of it, a path.

A line is clamped at the origin. At its far end it is loaded, or gripped and taken along a path; it
is looked at there, and again on its way back: without the load, let go, or in an earlier place. Of
each line are drawn: the numbers of the wire, the samples that it is calibrated by, how this
specimen and its spool differ from them, its free curvature, mass and length, and how far the grip
is off its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.judges.foreign import wire_section as foreign

Numbers = NDArray[np.float64]

FIRST_SEED, LINES = 41000, 40
"""Never changed."""
WIRES = {
    **dict.fromkeys(("A1", "A2", "B1", "B2", "C1", "C2"), 85),
    **dict.fromkeys(("A3", "C3", "C4", "C5"), 120),
}
"""mm, of the cantilever that each is calibrated by."""
SPREAD = {
    "friction": 0.2,
    "modulus": 0.15,
    "copper": 0.08,
    "specimen": 0.03,
    "spool": 0.03,
    "free_curvature": 0.15,
    "mass": 0.02,
    "length": 0.003,
    "torsion": 0.1,
    "place": 0.7e-3,
    "turn": 0.02,
}
"""Standard deviations: of logarithms, 1/m, m, rad."""
FREEDOM = {"spool": 4, "free_curvature": 5}
"""Degrees of freedom of those that were found from a few spools, and are not known."""
NODES, LOADING, RETURNING = 20, 8, 4
"""Elements and steps of a prediction."""
LAYING = 3
"""Steps before them, in which a line that is loaded takes its weight."""


@dataclass(frozen=True, slots=True, order=True)
class LineKind:
    """What is drawn again and again.

    Parameters
    ----------
    name : of the path
    is_planar : all of it in the plane of x and z
    is_loaded : by a force of constant direction at the far end; else a grip moves and turns it
    lets_go : the grip opens at the end
    """

    name: str
    is_planar: bool
    is_loaded: bool = False
    lets_go: bool = False

    @property
    def seeds(self) -> range:
        """Of its lines."""
        return range(FIRST_SEED, FIRST_SEED + LINES)


KINDS = (
    LineKind("push", is_planar=True, is_loaded=True),
    LineKind("bow", is_planar=True, lets_go=True),
    LineKind("slack", is_planar=True),
    LineKind("space bow", is_planar=False, lets_go=True),
    LineKind("space push", is_planar=False, is_loaded=True),
)


@dataclass(frozen=True, slots=True)
class Way:
    """Path of the far end, as a share of the line's length.

    Parameters
    ----------
    angle : rad, of the circle that the line is bent along
    first : the same, where it begins: nothing gives way along a straight line
    side : rad, about the x axis: direction in which it is bent; -pi / 2 is down
    shorter : share of the length by which the far end is nearer than on the circle, at the end
    level : share of the way back to a level end, after the circle
    orbit : rad, about the x axis, that the far end goes round on its way
    twist : rad, about the line's own axis
    back : share of the angle that is left before the line is let go
    peak : of a line that is loaded: curvature at the clamp, if its end stayed in place, times the
        length of the cantilever that the wire is calibrated by
    """

    angle: float
    first: float = 0.7
    side: float = -np.pi / 2.0
    shorter: float = 0.0
    level: float = 0.0
    orbit: float = 0.0
    twist: float = 0.0
    back: float = 0.9
    peak: float = 0.0

    def loading(self, steps: int) -> tuple[Numbers, Numbers]:
        """Places over the length, shape (steps + 1, 3), and turns: angle, side, twist.

        The circle closes in the first share of the steps where the end is laid level afterwards.
        """
        share = np.linspace(0.0, 1.0, steps + 1)
        bow = np.minimum(share / (1.0 - 0.5 * np.sign(self.level)), 1.0)
        angle = self.first + (self.angle - self.first) * bow
        side = self.side + self.orbit * share
        nearer = self.shorter * bow**3
        if self.level:
            late = np.clip(2.0 * share - 1.0, 0.0, 1.0)
            turned = angle * (1.0 - self.level * late)
        else:
            turned = angle
        return self._place(angle, side, nearer), np.stack(
            [turned, side, self.twist * share], axis=1
        )

    def returning(self, steps: int) -> tuple[Numbers, Numbers]:
        """The way back, its first row not in it: shape (steps, 3) each."""
        places, turns = self.loading(1)
        left = np.linspace(1.0, 0.0, steps + 1)[1:, None]
        last = np.array([self.back * self.angle])
        side = np.array([self.side + self.orbit])
        goal = self._place(last, side, np.zeros(1))
        end = np.array([[last[0], side[0], self.back * self.twist]])
        return goal + left * (places[-1] - goal), end + left * (turns[-1] - end)

    def _place(self, angle: Numbers, side: Numbers, nearer: Numbers) -> Numbers:
        across = (1.0 - np.cos(angle)) / angle
        along = np.sin(angle) / angle * (1.0 - nearer)
        return np.stack([along, across * np.cos(side), across * np.sin(side)], axis=1)


@dataclass(frozen=True, slots=True)
class Drawn:
    """A line and what nobody knows of it.

    Parameters
    ----------
    wire : name, of `WIRES`
    truth : numbers of the wire
    length : m, nominal
    peak : N, of the load
    way : path of the far end, or of what loads it, nominal
    off : by name, what the line is off by: logarithms, 1/m, m, rad
    stated : by name, standard deviations as they are known
    asked : which node and which component of it is looked at, and which of the force
    """

    wire: str
    truth: foreign.Truth
    length: float
    peak: float
    way: Way
    off: Mapping[str, float]
    stated: Mapping[str, float]
    asked: Mapping[str, int]


def wire_drawn(seed: int) -> tuple[str, foreign.Truth, np.random.Generator]:
    """A wire and its numbers, and where the chances of its samples go on.

    Lines of all kinds with one seed are of one spool and have one calibration; each of them is
    another specimen of another spool, and has its own of everything else.
    """
    chance = np.random.default_rng(seed)
    wire = str(chance.choice(sorted(WIRES)))
    friction, modulus, copper = (
        float(np.exp(SPREAD[name] * chance.normal())) for name in ("friction", "modulus", "copper")
    )
    return wire, foreign.Truth(0.0465 * friction, 1e9 * modulus, copper), chance


def draw(kind: LineKind, seed: int) -> Drawn:
    """A line."""
    chance = np.random.default_rng([seed, *kind.name.encode()])
    wire, truth, _ = wire_drawn(seed)
    length = float(chance.uniform(1.9, 2.8)) * 1e-3 * WIRES[wire]
    way = _way(kind, chance)
    names = _unknown(kind)
    off = {name: SPREAD[_spread(name)] * float(chance.normal()) for name in names}
    stated = {name: SPREAD[_spread(name)] for name in names}
    for name in names:
        if (freedom := FREEDOM.get(_spread(name))) is not None:
            stated[name] *= float(np.sqrt(chance.chisquare(freedom) / freedom))
    axes = (0, 2) if kind.is_planar else (0, 1, 2)
    asked = {
        "node": int(chance.integers(5, NODES - 3)),
        "free node": int(chance.integers(8, NODES + 1)),
        "axis": int(chance.choice(axes)),
        "free axis": int(chance.choice(axes)),
        "moment axis": 1 if kind.is_planar else int(chance.choice((1, 2))),
    }
    bent = way.peak / (1e-3 * WIRES[wire])
    peak = float(np.interp(bent, *foreign.law(wire, foreign.Truth()))) / length
    return Drawn(wire, truth, length, peak, way, off, stated, asked)


def _way(kind: LineKind, chance: np.random.Generator) -> Way:
    side = float(chance.choice([-0.5, 0.5]) * np.pi)
    match kind.name:
        case "push":
            return Way(0.0, side=side, peak=float(chance.uniform(0.4, 1.0)))
        case "bow":
            shorter = float(chance.uniform(0.0, 0.05))
            return Way(float(chance.uniform(1.0, 1.9)), side=side, shorter=shorter)
        case "slack":
            level = float(chance.uniform(0.2, 0.6))
            return Way(float(chance.uniform(1.0, 1.5)), level=level)
        case "space bow":
            return Way(
                float(chance.uniform(1.0, 1.8)),
                side=float(chance.uniform(-np.pi, np.pi)),
                shorter=float(chance.uniform(0.0, 0.04)),
                orbit=float(chance.uniform(-0.6, 0.6)),
                twist=float(chance.uniform(-0.8, 0.8)),
            )
        case _:
            return Way(
                0.0,
                side=float(chance.uniform(-np.pi, np.pi)),
                orbit=float(chance.choice([-1.0, 1.0]) * chance.uniform(0.5, 1.2)),
                peak=float(chance.uniform(0.4, 1.0)),
            )


def _unknown(kind: LineKind) -> tuple[str, ...]:
    """What the line is off by."""
    names = ["specimen", "spool", "mass_factor", "length_factor", "free_curvature_2"]
    if not kind.is_planar:
        names += ["free_curvature_1", "torsion_factor"]
    if not kind.is_loaded:
        names += ["place_x", "place_z", "turn"]
    if not (kind.is_planar or kind.is_loaded):
        names += ["place_y", "twist"]
    return tuple(names)


def _spread(name: str) -> str:
    """Of `SPREAD`."""
    if name == "twist":
        return "turn"
    return name.removesuffix("_factor") if name.endswith("_factor") else _stem(name)


def _stem(name: str) -> str:
    stem, _, last = name.rpartition("_")
    return stem if last in ("1", "2", "x", "y", "z") else name
