"""First loading curve of the clamped wire, by the first integral (PHYSICS 5).

Every point of the curve is two equations for the tip's force P and its lean beta (see below):
the arc length is the wire's, and the string points from the tip to its
anchor. All points are solved at once, without stations or history. This holds on first loading from
straight, while the moment grows everywhere. The path of `wire.cantilever` is independent of it and
also follows cycles.

With a tip force of magnitude P that leans by beta towards the clamp, dM/ds = -P cos(theta - beta)
and d(theta)/ds = kappa(M) have the first integral W*(M) + P sin(theta - beta) = const, where W* is
the complementary energy. With Q(M) = W*(M0) - W*(M) - P sin(beta), M0 the moment at the clamp, and
R = sqrt(P^2 - Q^2),

    L = integral of dM / R,    A = M0 / P,    B = integral of Q / (P R) dM,    from 0 to M0,

with A and B the tip's position along and across the direction of beta:
x = A cos(beta) - B sin(beta), y = A sin(beta) + B cos(beta).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from labpipe.mechanics.law.loading_table import LoadingLaw
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector


@dataclass(frozen=True, slots=True, eq=False)
class LoadingCurve(ArrayRecord):
    """The curve of a cantilever on first loading; arrays of shape (n,), the first point at rest.

    Parameters
    ----------
    deflection : m, of the tip across the undeformed axis, increasing
    tension : N, of the string, which is what the load cell reads; the end load where there is none
    x : m, position of the tip along the undeformed axis
    tip_angle : rad, of the tangent at the tip from the undeformed axis
    clamp_curvature, clamp_moment : 1/m, N m
    stiffness : N/m, slope of tension against deflection
    tension_change : shape (parameters, n), N, derivative at constant deflection by each of the
        law's parameters
    """

    deflection: Vector
    tension: Vector
    x: Vector
    tip_angle: Vector
    clamp_curvature: Vector
    clamp_moment: Vector
    stiffness: Vector
    tension_change: Annotated[Floats, "parameters", "n"]

    @property
    def force(self) -> Floats:
        """Return the tension above that at rest, N, as a zeroed load cell reads it."""
        return np.asarray(self.tension - self.tension[0])


def load_cantilever(
    law: LoadingLaw, length: float, rig: StringRig | None = None, *, has_memory: bool = True
) -> LoadingCurve:
    """Load a straight cantilever until the moment at its clamp is the last of the law.

    Parameters
    ----------
    law : law of first loading
    length : m
    rig : string and counterweight; the string just reaches the straight wire, so that its tension
        at rest is the weight. None for an end load normal to the axis
    has_memory : whether unloading differs from loading

    Returns
    -------
    The curve: rest, then a point for each of the law's. With memory it ends where the force across
    the wire at the tip is largest (at about 0.7 of the length): beyond, the moment near the tip
    falls and first loading ends.

    Raises
    ------
    ValueError
        If no equilibrium is found.

    Notes
    -----
    Newton's method for P and beta of all points at once; the unknown is the logarithm of P above
    the least force that can hold the moment, W*(M0) / (1 + sin(beta)).
    """
    max_iterations = 60
    force_tolerance = 1e-11
    max_step = 3.0  # of the logarithm of the excess of the force
    max_lean_step = 0.2
    rule = rule_of(law)
    excess, lean = _guess(law, rule, length, rig)
    for _ in range(max_iterations):
        sine = np.sin(lean)
        growth = np.exp(excess)
        balance = balance_of(rule, rule.energy / (1.0 + sine) + growth, lean)
        shift = -rule.energy * balance.cosine / (1.0 + sine) ** 2
        (a, b), (c, d) = slopes(balance, rig)
        matrix = ((a * growth, b + a * shift), (c * growth, d + c * shift))
        excess_step, turn = solve_pair(matrix, balance.arc_length - length, misfit(balance, rig))
        error = np.abs(excess_step * growth) / balance.force + np.abs(turn)
        if error.max() <= force_tolerance:
            return _curve(law, rule, balance, rig, has_memory=has_memory)
        excess = excess - np.minimum(np.maximum(excess_step, -max_step), max_step)
        lean = lean - np.minimum(np.maximum(turn, -max_lean_step), max_lean_step)
    count = int(np.sum(error > force_tolerance))
    message = f"length={length!r}: no equilibrium found at {count} of {len(lean)} loads"
    raise ValueError(message)


def _guess(law: LoadingLaw, rule: Rule, length: float, rig: StringRig | None) -> Pair:
    """Guess the logarithm of the excess force, and the lean, for x = L / (1 + (kappa L)^2 / 15)."""
    x = length / (1.0 + (law.curvature[law.points] * length) ** 2 / 15.0)
    excess = np.maximum(rule.moment / x - rule.energy, 0.05 * rule.energy)
    lean = np.zeros_like(x) if rig is None else (x - rig.anchor_x) / rig.string_length
    return np.log(excess), lean


def _curve(
    law: LoadingLaw, rule: Rule, state: Balance, rig: StringRig | None, *, has_memory: bool
) -> LoadingCurve:
    curvature = law.curvature[law.points]
    slope = _slope(state, rig, curvature)
    change = _changes(law, rule, state, rig, slope)
    sine = rule.energy / state.force - state.sine
    falls = np.flatnonzero(np.diff(state.force * np.sqrt(1.0 - sine**2)) <= 0.0)
    stop = int(falls[0]) + 1 if has_memory and len(falls) else len(sine)
    weight, tension = weight_of(rig), tension_of(state, rig)

    def from_rest(rest: float, values: Floats) -> Floats:
        return np.concatenate([[rest], values[:stop]])

    return LoadingCurve(
        from_rest(0.0, state.y),
        from_rest(weight, tension),
        from_rest(float(state.arc_length[0]), state.x),
        from_rest(0.0, np.arcsin(sine) + state.lean),
        from_rest(0.0, curvature),
        from_rest(0.0, rule.moment),
        from_rest(float((tension[0] - weight) / state.y[0]), slope),
        np.hstack([np.zeros((len(change), 1)), change[:, :stop]]),
    )


def _slope(state: Balance, rig: StringRig | None, curvature: Floats) -> Floats:
    """Return the slope of tension against deflection, N/m, as the moment at the clamp grows.

    The integrals change with their upper end, where Q = -P sin(beta), and with W*(M0).
    """
    arc = curvature * state.cube_q + 1.0 / (state.force * state.cosine)
    across = curvature * state.force * state.cube - state.sine / state.cosine / state.force
    deflection, tension = respond_to(state, rig, arc, across, 1.0 / state.force)
    return tension / deflection


def _changes(
    law: LoadingLaw, rule: Rule, state: Balance, rig: StringRig | None, slope: Floats
) -> Floats:
    """Return the derivatives of the tension at constant deflection by the law's parameters."""
    end = law.energy_change[:, law.points]
    inside = law.node_energy_change.reshape(len(end), law.node_energy.size)[:, rule.nodes]
    arc = end * state.cube_q - rule.total(inside * state.cubes_q)
    across = state.force * (end * state.cube - rule.total(inside * state.cubes))
    deflection, tension = respond_to(state, rig, arc, across, np.zeros_like(end))
    return tension - slope * deflection


def force_at(curve: LoadingCurve, deflection: Floats) -> tuple[Floats, Floats]:
    """Interpolate force above that at rest, and its derivatives, at given deflections.

    Parameters
    ----------
    curve : the loading curve
    deflection : shape (n,), m, any order and sign: the law is odd

    Returns
    -------
    Force, shape (n,), N, to about 3e-5 of itself, and its derivative by each of the law's
    parameters, shape (parameters, n). NaN where the deflection is NaN.

    Raises
    ------
    ValueError
        Beyond the end of the curve.
    """
    size = np.abs(deflection)
    if np.any(size > curve.deflection[-1]):
        message = (
            f"deflection={np.nanmax(size):.6g} m: the curve ends at {curve.deflection[-1]:.6g} m, "
            f"where the tip is inclined by {np.degrees(curve.tip_angle[-1]):.3g} deg"
        )
        raise ValueError(message)
    change = curve.tension_change
    values = np.vstack([curve.force, change])
    rises = np.vstack([curve.stiffness, np.gradient(change, curve.deflection, axis=1)])
    result = CubicHermiteSpline(curve.deflection, values, rises, axis=1)(size)
    result *= np.sign(deflection)
    return result[0], result[1:]


@dataclass(frozen=True, slots=True, eq=False)
class Rule:
    """Quadrature of all points in one array: the nodes from zero to each point's moment.

    Parameters
    ----------
    moment, energy : shape (points,), N m, N, at the clamp
    starts, counts : shape (points,), first node and number of nodes of a point
    nodes : shape (all,), indices into the law's nodes
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
        """Return the sum over the nodes of each point, to shape (..., points)."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=-1))

    def spread(self, values: Floats) -> Floats:
        """Repeat each point's value at its nodes, to shape (..., all)."""
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
    """Integrals of each point for given forces and leans.

    Parameters
    ----------
    force, lean : shape (points,), P, N, and beta, rad
    sine, cosine : shape (points,), of the lean
    arm, across : shape (points,), A and B, m
    x, y : shape (points,), m, position of the tip along and across the undeformed axis
    arc_length : shape (points,), m
    cube, cube_q : shape (points,), integrals of 1 / R^3 and Q / R^3
    cubes, cubes_q : shape (all nodes,), their summands
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
    """Compute the integrals at given forces, N, and leans, rad, shape (points,) each."""
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


def _across_slopes(state: Balance) -> Pair:
    """Return the derivatives of B by force and lean."""
    pressed = state.force * state.cube
    by_force = -state.across / state.force - state.sine * pressed - state.cube_q
    return by_force, -state.force * state.cosine * pressed


def misfit(state: Balance, rig: StringRig | None) -> Floats:
    """Return the force across the string that remains unbalanced, N; the lean without a string."""
    if rig is None:
        return state.lean
    slant = (rig.anchor_x - state.x) / rig.string_length
    pull = state.force * state.cosine + rig.weight
    return state.force * state.sine * np.sqrt(1.0 - slant**2) + pull * slant


def _misfit_slope(state: Balance, rig: StringRig) -> Floats:
    slant = (rig.anchor_x - state.x) / rig.string_length
    pull = state.force * state.cosine + rig.weight
    return (state.force * state.sine * slant / np.sqrt(1.0 - slant**2) - pull) / rig.string_length


def slopes(state: Balance, rig: StringRig | None) -> tuple[Pair, Pair]:
    """Return the derivatives of arc length and misfit by force and lean."""
    arc = (
        -state.force * state.cube - state.sine * state.cube_q,
        -state.force * state.cosine * state.cube_q,
    )
    if rig is None:
        return arc, (np.zeros_like(state.lean), np.ones_like(state.lean))
    slant = (rig.anchor_x - state.x) / rig.string_length
    rise = np.sqrt(1.0 - slant**2)
    across_by_force, across_by_lean = _across_slopes(state)
    x_by_force = -state.arm / state.force * state.cosine - across_by_force * state.sine
    x_by_lean = -state.y - across_by_lean * state.sine
    by_x = _misfit_slope(state, rig)
    by_force = state.sine * rise + state.cosine * slant + by_x * x_by_force
    by_lean = state.force * (state.cosine * rise - state.sine * slant) + by_x * x_by_lean
    return arc, (by_force, by_lean)


def solve_pair(matrix: tuple[Pair, Pair], first: Floats, second: Floats) -> Pair:
    """Solve two equations for two unknowns at every point."""
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return (d * first - b * second) / determinant, (a * second - c * first) / determinant


def respond_to(
    state: Balance, rig: StringRig | None, arc: Floats, across: Floats, arm: Floats
) -> Pair:
    """Compute the changes of deflection, m, and tension, N, shape (..., points).

    They respond to changes of arc length, B and A at constant force and lean.
    """
    by_x = 0.0 if rig is None else _misfit_slope(state, rig)
    misfit = by_x * (arm * state.cosine - across * state.sine)
    force, lean = solve_pair(slopes(state, rig), -arc, -misfit)
    across_by_force, across_by_lean = _across_slopes(state)
    by_force = -state.arm / state.force * state.sine + across_by_force * state.cosine
    by_lean = state.x + across_by_lean * state.cosine
    weight = weight_of(rig)
    pull = (state.force + weight * state.cosine) * force - state.force * weight * state.sine * lean
    rise = arm * state.sine + across * state.cosine
    return rise + by_force * force + by_lean * lean, pull / tension_of(state, rig)


def weight_of(rig: StringRig | None) -> float:
    """Weight at the tip, N; 0 without a string."""
    return 0.0 if rig is None else rig.weight


def tension_of(state: Balance, rig: StringRig | None) -> Floats:
    """Return the tension of the string, N; the end load without a string."""
    return np.hypot(state.force * state.sine, state.force * state.cosine + weight_of(rig))
