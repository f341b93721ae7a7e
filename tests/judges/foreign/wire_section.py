"""A second wire: its law strand by strand and its cantilever as a boundary value problem.

It knows nothing of the package: the section is summed up here from the equations of the source
(3.7), (3.14)-(3.17), with sin^2 in (3.18) and friction by arcsin(sin theta), and the wire is bent
by `scipy.integrate.solve_bvp`, with its weight, with what it remembers of its rest (Masing), with
the string that leans and the counterweight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

Numbers = NDArray[np.float64]

MODULUS, STRENGTH, EXPONENT, POISSON = 110e9, 530e6, 0.44, 0.34
"""Copper: E, Pa; K, Pa, and n of eps = s / E + (s / K)^(1 / n); Poisson's ratio."""
COPPER, PVC, GRAVITY = 8960.0, 1400.0, 9.80665
"""kg/m^3, kg/m^3, m/s^2."""
STRING, COUNTERWEIGHT = 0.760, 0.0027 * GRAVITY
"""m, of the string; N, what hangs on it."""
_FIBRES = 400
_CURVATURES = np.concatenate([[0.0], np.geomspace(1e-4, 300.0, 6000)])
_STATIONS = 201
_FINE = 1e-6


@dataclass(frozen=True)
class Build:
    """How a wire is made.

    Parameters
    ----------
    strands : 7, 19 or 37
    strand : m, its diameter; of a compressed one, that of the circle with its area
    diameter, wall : m, over the insulation, and of it
    lays : degrees, of each ring
    is_compressed : pressed into sectors; else a hexagon
    """

    strands: int
    strand: float
    diameter: float
    wall: float
    lays: tuple[float, ...]
    is_compressed: bool = False


def _pressed(area: float) -> float:
    return float(np.sqrt(4.0 * area / 7.0 / np.pi))


_ONE, _TWO, _THREE = (12.0,), (12.0, -15.0), (12.0, -15.0, 12.0)
BUILDS = {
    "A1": Build(7, 0.26e-3, 1.4e-3, 0.3e-3, _ONE),
    "A2": Build(7, 0.32e-3, 1.6e-3, 0.3e-3, _ONE),
    "A3": Build(19, 0.24e-3, 1.8e-3, 0.3e-3, _TWO),
    "B1": Build(7, _pressed(0.35e-6), 1.1e-3, 0.2e-3, _ONE, is_compressed=True),
    "B2": Build(7, _pressed(0.49e-6), 1.25e-3, 0.2e-3, _ONE, is_compressed=True),
    "C1": Build(19, 0.16e-3, 1.4e-3, 0.3e-3, _TWO),
    "C2": Build(19, 0.19e-3, 1.6e-3, 0.3e-3, _TWO),
    "C3": Build(19, 0.23e-3, 1.8e-3, 0.3e-3, _TWO),
    "C4": Build(37, 0.21e-3, 2.1e-3, 0.3e-3, _THREE),
    "C5": Build(37, 0.26e-3, 2.6e-3, 0.3e-3, _THREE),
}
"""Tables 2.1 and 3.4 of the source."""


@dataclass(frozen=True)
class Truth:
    """What a calibration looks for: F_rad (mu_s + mu_p), N; E of the insulation, Pa; factor on K.

    `strand` and `tube` are mu_s and mu_p.
    """

    friction: float = 0.0465
    modulus: float = 1e9
    copper: float = 1.0
    strand: float = 0.21
    tube: float = 0.10


def weight_of(build: Build) -> float:
    """N/m: copper along its lays, and the insulation."""
    rings = [1, *(6 * ring for ring in range(1, len(build.lays) + 1))]
    ways = [1.0, *(1.0 / np.cos(np.radians(lay)) for lay in build.lays)]
    copper = 0.25 * np.pi * build.strand**2 * float(np.dot(rings, ways))
    bore = build.diameter - 2.0 * build.wall
    insulation = 0.25 * np.pi * (build.diameter**2 - bore**2)
    return float(GRAVITY * (COPPER * copper + PVC * insulation))


def _places(build: Build) -> list[tuple[Numbers, Numbers]]:
    """Radius and angle of the strands of each ring; the neutral axis goes through a first one."""
    if build.is_compressed:
        core = 0.5 * build.strand
        middles = core * np.sqrt(1.0 + 6.0 * (np.arange(2000) + 0.5) / 2000)  # of equal areas
        across = np.sin(np.pi / 6.0) / (np.pi / 6.0)  # mean cosine over a sector
        return [(np.full(6, float(middles.mean()) * across), np.pi / 3.0 * np.arange(6.0))]
    found: list[tuple[Numbers, Numbers]] = []
    span = range(-len(build.lays), len(build.lays) + 1)
    lattice = [(i, j) for i in span for j in span]
    for ring in range(1, len(build.lays) + 1):
        own = [(i, j) for i, j in lattice if max(abs(i), abs(j), abs(i + j)) == ring]
        points = np.array([i + 0.5 * j + 1j * np.sqrt(0.75) * j for i, j in own])
        found.append((build.strand * np.abs(points), np.angle(points)))
    return found


def _friction_angle(sine: Numbers, k: float) -> Numbers:
    """How far the friction reaches from the neutral axis, rad."""
    angle = np.arcsin(np.clip(sine, -1.0, 1.0))
    return np.asarray(np.expm1(k * angle) / k)


@cache
def law(name: str, truth: Truth) -> tuple[Numbers, Numbers]:
    """Moments, N m, on first loading at curvatures, 1/m, from zero."""
    build = BUILDS[name]
    moment = _axial(build, truth) + _own(build, truth)
    bore = build.diameter - 2.0 * build.wall
    inertia = np.pi / 64.0 * (build.diameter**4 - bore**4)
    return _CURVATURES, moment + truth.modulus * inertia * _CURVATURES


def _axial(build: Build, truth: Truth) -> Numbers:
    area = 0.25 * np.pi * build.strand**2
    lays = np.radians(np.abs(build.lays))
    places = _places(build)
    counts = [len(radius) for radius, _ in places]
    radial = truth.friction / (truth.strand + truth.tube)
    outermost = len(places) - 1

    def force(ring: int, radius: Numbers, sine: Numbers) -> Numbers:
        """Axial force, shape (curvatures, places), of strands at sines of the angle."""
        pressure = np.full((len(_CURVATURES), len(sine)), radial * counts[-1] / counts[ring])
        for outer in range(ring + 1, len(places)):
            far = np.full(len(sine), np.sqrt(np.mean(places[outer][0] ** 2)))
            pushes = force(outer, far, sine) * np.sin(lays[outer])
            pressure += pushes * counts[outer] / counts[ring]
        pressure = np.maximum(pressure, 0.0)
        outside = truth.tube if ring == outermost else truth.strand
        reach = _friction_angle(sine, truth.strand * np.sin(lays[ring]))
        holds = (truth.strand + outside) * pressure * np.abs(reach)
        stretch = MODULUS * area * np.cos(lays[ring]) ** 2
        sticks = stretch * _CURVATURES[:, None] * radius * np.abs(sine)
        return np.asarray(np.sign(sine) * np.minimum(sticks, holds))

    total = np.zeros_like(_CURVATURES)
    for ring, (radius, angle) in enumerate(places):
        sine = np.where(np.abs(np.sin(angle)) < 1e-9, 0.0, np.sin(angle))
        total += force(ring, radius, sine) @ (radius * sine) * np.cos(lays[ring])
    return total


def _own(build: Build, truth: Truth) -> Numbers:
    """Moment of the strands about their own axes: fibres of a circle, turned by the lay."""
    half = 0.5 * build.strand
    turn = (np.arange(_FIBRES) + 0.5) * np.pi / _FIBRES / 2.0
    height = half * np.sin(turn)
    wide = 2.0 * half * np.cos(turn) * half * np.cos(turn) * (np.pi / _FIBRES / 2.0)
    stress = np.geomspace(1.0, 1e11, 20000)
    strain = stress / MODULUS + (stress / (truth.copper * STRENGTH)) ** (1.0 / EXPONENT)
    asked = _CURVATURES[:, None] * height
    found = np.interp(np.log(np.maximum(asked, 1e-30)), np.log(strain), np.log(stress))
    pulls = np.where(asked > strain[0], np.exp(found), MODULUS * asked)
    straight = 2.0 * pulls @ (height * wide)
    lays = np.radians([0.0, *build.lays])
    counts = [1, *(6 * ring for ring in range(1, len(build.lays) + 1))]
    cosine, sine = np.cos(lays), np.sin(lays)
    share = 0.5 * cosine * (1.0 + cosine**2 + sine**2 / (1.0 + POISSON))
    return np.asarray(straight * float(np.dot(counts, share)))


@dataclass(frozen=True)
class Loading:
    """Deflection, m, and force, N, both counted from rest."""

    deflection: Numbers
    force: Numbers


_GOALS = tuple(0.052 * np.linspace(0.0125, 1.0, 80) ** 1.8)


@cache
def loading(
    name: str,
    length: float,
    truth: Truth,
    *,
    has_weight: bool = True,
    goals: tuple[float, ...] = _GOALS,
) -> Loading:
    """First loading of a wire that lies level, its tip held by the string.

    It is solved at rest and at each of the goals, deflections in m that grow.
    """
    curvature, moment = law(name, truth)
    weight = weight_of(BUILDS[name]) if has_weight else 0.0
    place = np.linspace(0.0, length, _STATIONS)
    state = np.zeros((4, _STATIONS))
    state[1] = place
    tension = COUNTERWEIGHT + 0.375 * weight * length
    ends = np.array([tension, length])
    rests: list[Numbers] = []
    pulls = []

    def bent(at: Numbers, present: Numbers) -> Numbers:
        """Curvature under a moment; back along Masing's loop where rest had bent it down."""
        if not rests:
            return np.asarray(np.sign(present) * np.interp(np.abs(present), moment, curvature))
        before = np.interp(at, place, rests[0])
        half = 0.5 * (present - before)
        began = np.sign(before) * np.interp(np.abs(before), moment, curvature)
        back = began + 2.0 * np.sign(half) * np.interp(np.abs(half), moment, curvature)
        plain = np.sign(present) * np.interp(np.abs(present), moment, curvature)
        turns = (half * before < 0.0) & (np.abs(half) < np.abs(before))
        return np.asarray(np.where(turns, back, plain))

    def slopes(at: Numbers, now: Numbers, two: Numbers) -> Numbers:
        angle, _, _, present = now
        lean = (length - two[1]) / STRING
        along = two[0] * lean
        up = two[0] * np.sqrt(1.0 - lean**2) - COUNTERWEIGHT - weight * (length - at)
        fall = -up * np.cos(angle) + along * np.sin(angle)
        return np.stack([bent(at, present), np.cos(angle), np.sin(angle), fall])

    for goal in (0.0, *goals):

        def missing(clamp: Numbers, tip: Numbers, two: Numbers, goal: float = goal) -> Numbers:
            lacks = [*clamp[:3], tip[1] - two[1], tip[2] - goal, tip[3]]
            return np.array(lacks)

        found = solve_bvp(slopes, missing, place, state, ends, tol=_FINE, max_nodes=20_000)
        if not found.success or found.p is None:
            message = f"{name}, {length} m, {goal} m: {found.message}"
            raise RuntimeError(message)
        state, ends = np.asarray(found.sol(place)), np.asarray(found.p)
        pulls.append(float(ends[0]))
        if not rests:
            rests.append(state[3].copy())
    return Loading(np.array([0.0, *goals]), np.array(pulls) - pulls[0])
