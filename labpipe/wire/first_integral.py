"""The first integral of the clamped wire under a tip force, as sums over panels (PHYSICS 5).

With a tip force of magnitude P that leans by beta towards the clamp, dM/ds = -P cos(theta - beta)
and d(theta)/ds = kappa(M) have the first integral W*(M) + P sin(theta - beta) = const, where W* is
the complementary energy. With Q(M) = W*(M0) - W*(M) - P sin(beta), M0 the moment at the clamp, and
R = sqrt(P^2 - Q^2),

    L = integral of dM / R,    A = M0 / P,    B = integral of Q / (P R) dM,    from 0 to M0,

A and B being the tip's place along and across the direction of beta: x = A cos(beta) - B sin(beta),
y = A sin(beta) + B cos(beta). Here are these sums at given P and beta, and how they change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.wire.cantilever import StringRig
from labpipe.wire.loading_law import LoadingLaw


@dataclass(frozen=True, slots=True, eq=False)
class Rule:
    """The rule of every point, one after the other: the nodes from zero to the point's edge.

    Parameters
    ----------
    moment, energy : shape (points,), N m, N, at the clamp
    starts, counts : shape (points,), where a point's nodes begin, and how many they are
    nodes : shape (all,), which of the law's
    weight : shape (all,), N m
    rise : shape (all,), N, energy at the clamp less that at the node
    """

    moment: Floats
    energy: Floats
    starts: Ints
    counts: Ints
    nodes: Ints
    weight: Floats
    rise: Floats

    def total(self, values: Floats) -> Floats:
        """Sum over the nodes of each point, shape (..., points)."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=-1))

    def spread(self, values: Floats) -> Floats:
        """The point's value at each of its nodes, shape (..., all)."""
        return np.repeat(values, self.counts, axis=-1)


def rule_of(law: LoadingLaw) -> Rule:
    """Lay out the nodes of all points of a law."""
    counts = law.points * law.node_weight.shape[1]
    starts = np.cumsum(counts) - counts
    nodes = np.arange(counts.sum()) - np.repeat(starts, counts)
    energy = law.energy[law.points]
    rise = np.repeat(energy, counts) - law.node_energy.ravel()[nodes]
    weight = law.node_weight.ravel()[nodes]
    return Rule(law.moment[law.points], energy, starts, counts, nodes, weight, rise)


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """The integrals of each point for given forces and leans.

    Parameters
    ----------
    force, lean : shape (points,), P, N, and beta, rad
    sine, cosine : shape (points,), of the lean
    arm, across : shape (points,), A and B, m
    x, y : shape (points,), m, place of the tip along and across the undeformed axis
    arc_length : shape (points,), m
    cube, cube_q : shape (points,), integrals of 1 / R^3 and Q / R^3
    cubes, cubes_q : shape (all nodes,), what these are sums of
    """

    force: Floats
    lean: Floats
    sine: Floats
    cosine: Floats
    arm: Floats
    across: Floats
    x: Floats
    y: Floats
    arc_length: Floats
    cube: Floats
    cube_q: Floats
    cubes: Floats
    cubes_q: Floats


def balance_of(rule: Rule, force: Floats, lean: Floats) -> Balance:
    """Sum up at given forces, N, and leans, rad, shape (points,) each."""
    sine, cosine = np.sin(lean), np.cos(lean)
    q = rule.rise - rule.spread(force * sine)
    square = rule.spread(force * force) - q * q
    plain = rule.weight / np.sqrt(square)
    cubes = plain / square
    cubes_q = cubes * q
    across, arm = rule.total(plain * q) / force, rule.moment / force
    x, y = arm * cosine - across * sine, arm * sine + across * cosine
    sums = rule.total(plain), rule.total(cubes), rule.total(cubes_q)
    return Balance(force, lean, sine, cosine, arm, across, x, y, *sums, cubes, cubes_q)


Pair: TypeAlias = tuple[Floats, Floats]
"""Two numbers for each point, shape (points,)."""


def _across_slopes(at: Balance) -> Pair:
    """Derivatives of B by force and lean."""
    pressed = at.force * at.cube
    by_force = -at.across / at.force - at.sine * pressed - at.cube_q
    return by_force, -at.force * at.cosine * pressed


def misfit(at: Balance, rig: StringRig | None) -> Floats:
    """What the string's direction lacks of that of force and weight, N; the lean without one."""
    if rig is None:
        return at.lean
    slant = (rig.anchor_x - at.x) / rig.string_length
    pull = at.force * at.cosine + rig.weight
    return at.force * at.sine * np.sqrt(1.0 - slant**2) + pull * slant


def _misfit_by_x(at: Balance, rig: StringRig) -> Floats:
    slant = (rig.anchor_x - at.x) / rig.string_length
    pull = at.force * at.cosine + rig.weight
    return (at.force * at.sine * slant / np.sqrt(1.0 - slant**2) - pull) / rig.string_length


def slopes(at: Balance, rig: StringRig | None) -> tuple[Pair, Pair]:
    """Derivatives of arc length and misfit by force and lean."""
    arc = (-at.force * at.cube - at.sine * at.cube_q, -at.force * at.cosine * at.cube_q)
    if rig is None:
        return arc, (np.zeros_like(at.lean), np.ones_like(at.lean))
    slant = (rig.anchor_x - at.x) / rig.string_length
    rise = np.sqrt(1.0 - slant**2)
    across_by_force, across_by_lean = _across_slopes(at)
    x_by_force = -at.arm / at.force * at.cosine - across_by_force * at.sine
    x_by_lean = -at.y - across_by_lean * at.sine
    by_x = _misfit_by_x(at, rig)
    by_force = at.sine * rise + at.cosine * slant + by_x * x_by_force
    by_lean = at.force * (at.cosine * rise - at.sine * slant) + by_x * x_by_lean
    return arc, (by_force, by_lean)


def solve_pair(matrix: tuple[Pair, Pair], first: Floats, second: Floats) -> Pair:
    """Solve two equations for two unknowns at every point."""
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return (d * first - b * second) / determinant, (a * second - c * first) / determinant


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """How deflection, m, and tension, N, change, shape (..., points)."""

    deflection: Floats
    tension: Floats


def respond_to(
    at: Balance, rig: StringRig | None, arc: Floats, across: Floats, arm: Floats
) -> Response:
    """What follows from changes of arc length, B and A at constant force and lean."""
    by_x = 0.0 if rig is None else _misfit_by_x(at, rig)
    misfit = by_x * (arm * at.cosine - across * at.sine)
    force, lean = solve_pair(slopes(at, rig), -arc, -misfit)
    across_by_force, across_by_lean = _across_slopes(at)
    by_force = -at.arm / at.force * at.sine + across_by_force * at.cosine
    by_lean = at.x + across_by_lean * at.cosine
    weight = weight_of(rig)
    pull = (at.force + weight * at.cosine) * force - at.force * weight * at.sine * lean
    return Response(
        arm * at.sine + across * at.cosine + by_force * force + by_lean * lean,
        pull / tension_of(at, rig),
    )


def weight_of(rig: StringRig | None) -> float:
    """Weight at the tip, N; 0 without a string."""
    return 0.0 if rig is None else rig.weight


def tension_of(at: Balance, rig: StringRig | None) -> Floats:
    """Tension of the string, N; the end load without one."""
    return np.hypot(at.force * at.sine, at.force * at.cosine + weight_of(rig))
