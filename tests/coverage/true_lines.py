"""What the drawn lines do: planar ones by the second rod, others by the package's own, finer.

The law is that of the second simulator in both. The package's rod in space shares its statics with
the prediction, and nothing of its mesh, its steps and its law.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.rod.boundaries import Gravity, Held, Load
from labpipe.mechanics.rod.line import Line, Section
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import from_rotation_vectors, multiply, to_matrices
from labpipe.mechanics.rod.statics import follow
from tests.builders.rods import straight_line
from tests.coverage.drawn_lines import (
    LAYING,
    LOADING,
    NODES,
    RETURNING,
    Drawn,
    LineKind,
    Numbers,
)
from tests.judges.foreign import wire_section as foreign
from tests.judges.foreign.planar_rod import PlanarRod, Stops, stops_through

EARTH = np.array([0.0, 0.0, -9.81])
FINER = 3
"""Elements, and steps, of the truth over those of the prediction."""
_KNOTS = np.concatenate([[0.0], np.geomspace(0.02, 100.0, 48)])


@dataclass(frozen=True, slots=True)
class TrueLine:
    """What a line does.

    Parameters
    ----------
    held, back : m, nodes of the prediction at the end of the way there, and of the way back, shape
        (nodes, 3)
    force, moment : N, N m, of the near clamp on the line, held
    bend_radius : m, the smallest, held
    """

    held: Numbers
    back: Numbers
    force: Numbers
    moment: Numbers
    bend_radius: float


@dataclass(frozen=True, slots=True, eq=False)
class PreparedLine:
    """A line of the package, with what holds it.

    Parameters
    ----------
    law, torsional_stiffness, mass_per_length : of the wire
    length : m
    free_curvature : 1/m, towards y and z
    off : what the grip is off by
    elements, loading, returning : how fine
    """

    law: SliderLaw
    torsional_stiffness: float
    mass_per_length: float
    length: float
    free_curvature: tuple[float, float]
    off: Mapping[str, float]
    elements: int = NODES
    loading: int = LOADING
    returning: int = RETURNING

    def follow(self, kind: LineKind, drawn: Drawn) -> RodPath:
        """Take it along its path; `held_at` is the state at the end of its way there."""
        section = Section(self.law, self.torsional_stiffness, mass_per_length=self.mass_per_length)
        base = straight_line(self.length, self.elements, section)
        aside, up = self.free_curvature
        turns = np.array([0.0, -up, aside]) @ to_matrices(base.frames[0])  # in the line's own axes
        rest_curvature = np.tile(turns, (self.elements - 1, 1))
        near = Held(0, np.zeros(3), base.frames[0])
        steps = self.loading + self.returning + kind.lets_go
        if kind.is_loaded:
            line = Line(base.lengths, section, base.positions, base.frames, rest_curvature)
            forces = loads(drawn, self.loading, self.returning)
            shares = np.minimum(np.arange(LAYING + len(forces)) / LAYING, 1.0)
            weight = Gravity(shares[:, None] * EARTH)
            pull = Load(-1, np.concatenate([np.zeros((LAYING, 3)), forces]))
            return follow(line, (near, pull, weight), steps=LAYING + steps)
        weight = Gravity(np.array(EARTH))
        places, turns = far_end(drawn, self.off, self.loading, self.returning)
        release = steps if kind.lets_go else None
        frames = frames_of(turns, base.frames[0])
        line = Line(base.lengths, section, *_circle(base, drawn), rest_curvature)
        far = Held(-1, places[: steps + 1], frames[: steps + 1], release=release)
        return follow(line, (near, far, weight), steps=steps)


def held_at(kind: LineKind, returning: int = RETURNING) -> int:
    """Number of the state at the end of the way there, from the last one."""
    return -1 - returning - kind.lets_go


def loads(drawn: Drawn, loading: int, returning: int) -> Numbers:
    """Forces on the far end, N, a row for each step and one before."""
    there = np.linspace(0.0, 1.0, loading + 1)
    share = np.concatenate([there, np.linspace(1.0, 0.0, returning + 1)[1:]])
    side = drawn.way.side + drawn.way.orbit * np.concatenate([there, np.ones(returning)])
    across = np.stack([np.zeros_like(side), np.cos(side), np.sin(side)], axis=1)
    return np.asarray(drawn.peak * share[:, None] * across)


def far_end(
    drawn: Drawn, off: Mapping[str, float], loading: int, returning: int
) -> tuple[Numbers, Numbers]:
    """Places, m, and turns of the grip, a row for each step and one before; the last stays."""
    there, back = drawn.way.loading(loading), drawn.way.returning(returning)
    places, turns = (
        np.concatenate([one, other, other[-1:]]) for one, other in zip(there, back, strict=True)
    )
    away = np.array([off.get(f"place_{axis}", 0.0) for axis in "xyz"])
    tilted = np.array([off.get("turn", 0.0), 0.0, off.get("twist", 0.0)])
    return drawn.length * places + away, turns + tilted


def _circle(base: Line, drawn: Drawn) -> tuple[Numbers, Numbers]:
    """Positions and frames of a line on the circle along which its path begins."""
    share = (np.arange(len(base.lengths)) + 0.5) / len(base.lengths)
    turns = np.stack([share * drawn.way.first, np.full_like(share, drawn.way.side), 0.0 * share])
    frames = frames_of(turns.T, base.frames[0])
    steps = base.lengths[:, None] * to_matrices(frames)[:, :, 2]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), frames


def frames_of(turns: Numbers, base: Numbers) -> Numbers:
    """Frames bent by an angle towards a side, then twisted: shape (rows, 4) of turns (rows, 3)."""
    angle, side, twist = turns.T
    zero = np.zeros_like(angle)
    axis = np.stack([zero, -np.sin(side), np.cos(side)], axis=1)  # x turned towards the side
    spin = np.stack([np.cos(0.5 * twist), zero, zero, np.sin(0.5 * twist)], axis=1)
    turned = multiply(from_rotation_vectors(angle[:, None] * axis), np.tile(base, (len(turns), 1)))
    return np.asarray(multiply(turned, spin))


def true_stops(drawn: Drawn) -> Stops:
    """Law of this specimen."""
    curvature, moment = foreign.law(drawn.wire, drawn.truth)
    own = stops_through(_KNOTS, np.interp(_KNOTS, curvature, moment))
    return own.times(float(np.exp(drawn.off["specimen"] + drawn.off["spool"])))


def true_line(kind: LineKind, drawn: Drawn, torsional_stiffness: float) -> TrueLine:
    """Solve a line as it is.

    Parameters
    ----------
    kind, drawn : the line
    torsional_stiffness : N m^2, before the factor that nobody knows
    """
    length = drawn.length * float(np.exp(drawn.off["length_factor"]))
    own_weight = foreign.weight_of(foreign.BUILDS[drawn.wire])
    weight = own_weight * float(np.exp(drawn.off["mass_factor"]))
    if kind.is_planar:
        return _in_plane(kind, drawn, length, weight)
    torsion = torsional_stiffness * float(np.exp(drawn.off["torsion_factor"]))
    return _in_space(kind, drawn, length, weight / foreign.GRAVITY, torsion)


def _in_plane(kind: LineKind, drawn: Drawn, length: float, weight: float) -> TrueLine:
    rod = PlanarRod(
        *(length, FINER * NODES, true_stops(drawn)),
        weight=weight * -EARTH[2] / foreign.GRAVITY,
        natural=drawn.off["free_curvature_2"],
        has_far_clamp=not kind.is_loaded,
    )
    fine = FINER * LOADING, FINER * RETURNING
    shapes = [rod.shape() for _ in _walk(rod, kind, drawn, fine)]
    if kind.lets_go:
        rod.curvature_after_release()
    held, back = shapes[fine[0]], rod.shape()
    return TrueLine(
        _spatial(held.places[::FINER]),
        _spatial(back.places[::FINER]),
        _spatial(held.start_force),
        np.array([0.0, held.start_moment, 0.0]),
        1.0 / float(np.abs(held.curvature).max()),
    )


def _walk(rod: PlanarRod, kind: LineKind, drawn: Drawn, fine: tuple[int, int]) -> Iterator[None]:
    if kind.is_loaded:
        for force in loads(drawn, *fine):
            rod.load(force[[0, 2]])
            yield
        return
    places, turns = far_end(drawn, drawn.off, *fine)
    for place, turn in zip(places[:-1], turns[:-1], strict=True):
        rod.hold(place[[0, 2]], float(turn[0] * np.sin(turn[1])))
        yield


def _spatial(plane: Numbers) -> Numbers:
    return np.stack([plane[..., 0], np.zeros_like(plane[..., 0]), plane[..., 1]], axis=-1)


def _in_space(kind: LineKind, drawn: Drawn, length: float, mass: float, torsion: float) -> TrueLine:
    stops, off = true_stops(drawn), drawn.off
    kept = stops.stiffness > 0.0
    law = SliderLaw(stops.spring, stops.stiffness[kept], stops.width[kept], 0.0, float(_KNOTS[-1]))
    free = (off["free_curvature_1"], off["free_curvature_2"])
    laid = PreparedLine(
        *(law, torsion, mass, length, free, off),
        *(FINER * NODES, FINER * LOADING, FINER * RETURNING),
    )
    path = laid.follow(kind, drawn)
    if path.status == "failed":
        message = f"the truth fails: {path.reasons}"
        raise RuntimeError(message)
    held, last = path.states[held_at(kind, laid.returning)], path.last
    most = float(np.linalg.norm(held.curvature_vectors, axis=-1).max())
    return TrueLine(
        held.positions[::FINER],
        last.positions[::FINER],
        held.reaction_forces[0],
        held.reaction_moments[0],
        1.0 / most,
    )
