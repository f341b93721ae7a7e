"""Newton's method for the clamped wire at Chebyshev-Lobatto stations along it.

The wire's own weight w per length acts along -y, so that at s the force (Px, Py - w (L - s)) is
transmitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.polynomial import chebyshev

from labpipe.law.plays import MomentLaw, Response, respond
from labpipe.records.arrays import Floats

TOLERANCE = 1e-7
"""Last change of the moments, of the largest; the next would be below 1e-14."""


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """Demand of a condition at a tip position and a load.

    Parameters
    ----------
    force : shape (2,), N, at the tip
    force_by_tip : shape (2, 2), N/m, its derivative by the tip's position
    force_by_load : shape (2,), its derivative by the load
    gap : m, zero where the condition holds
    gap_by_tip : shape (2,), its derivative by the tip's position
    gap_by_load : m/N, its derivative by the load
    """

    force: Floats
    force_by_tip: Floats
    force_by_load: Floats
    gap: float
    gap_by_tip: Floats
    gap_by_load: float = 0.0


class Condition(Protocol):
    """Condition that fixes the force at the tip."""

    def demand(self, tip: Floats, load: float) -> Demand:
        """Compute force, gap and their derivatives at a tip position and a load."""


@dataclass(frozen=True, slots=True, eq=False)
class DeadLoad:
    """A given force, N, shape (2,); the load is unused and zero."""

    force: Floats

    def demand(self, tip: Floats, load: float) -> Demand:
        """Return the force itself."""
        return Demand(self.force, np.zeros((2, 2)), np.zeros(2), load, np.zeros_like(tip), 1.0)


@dataclass(frozen=True, slots=True)
class EndLoad:
    """A force normal to the clamped axis that brings the tip to `deflection`, m."""

    deflection: float

    def demand(self, tip: Floats, load: float) -> Demand:
        """Return the load along y, and the gap to the deflection."""
        along_y = np.array([0.0, 1.0])
        return Demand(
            load * along_y, np.zeros((2, 2)), along_y, float(tip[1]) - self.deflection, along_y
        )


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """A taut string from `anchor` (shape (2,), m) of `length`, and a `weight` (N) at the tip."""

    anchor: Floats
    length: float
    weight: float

    def demand(self, tip: Floats, load: float) -> Demand:
        """Return tension and weight; the gap is the string's stretch."""
        reach = self.anchor - tip
        distance = float(np.hypot(*reach))
        force = load / self.length * reach - np.array([0.0, self.weight])
        return Demand(
            force,
            -load / self.length * np.eye(2),
            reach / self.length,
            distance - self.length,
            -reach / distance,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Unknowns of Newton's method: moments, shape (stations,), N m, and the load, N."""

    moment: Floats
    load: float


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """Solution: moments, history, tip force, load, curvatures of it and of the start."""

    moment: Floats
    plays: Floats
    force: Floats
    load: float
    curvature: Floats
    start_curvature: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Input of `solve`: stations along the length, m; `beyond` is the weight beyond each, N."""

    law: MomentLaw
    plays: Floats
    condition: Condition
    stations: Stations
    beyond: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    residual: Floats
    jacobian: Floats
    response: Response


@dataclass(frozen=True, slots=True, eq=False)
class _Bent:
    response: Response
    cos: Floats
    sin: Floats
    wanted: Demand


def solve(
    law: MomentLaw,
    plays: Floats,
    length: float,
    condition: Condition,
    start: Unknowns,
    *,
    tolerance: float = TOLERANCE,
    self_weight: float = 0.0,
) -> Equilibrium | None:
    """Find the equilibrium next to a start, or None if the iteration does not converge.

    Parameters
    ----------
    law : law of every station
    plays : shape (stations, plays), N m, history before the step
    length : m
    condition : what fixes the end force
    start : first guess
    tolerance : last change of the moments, as a share of the largest; the next is of its square
    self_weight : N/m, of the wire
    """
    max_iterations = 40
    unit = chebyshev_stations(len(start.moment))
    stations = Stations(*(length * part for part in (unit.position, unit.from_clamp, unit.to_tip)))
    beyond = self_weight * (length - stations.position)
    problem = _Problem(law, plays, condition, stations, beyond)
    moment, load = start.moment, start.load
    first = None
    for _ in range(max_iterations):
        system = _linearise(problem, moment, load)
        first = system.response.curvature if first is None else first
        if not np.all(np.isfinite(system.residual)):
            return None
        change: Floats = -np.linalg.solve(system.jacobian, system.residual).astype(np.float64)
        change *= _damping(change[:-1], system.response.compliance, length)
        moment, load = moment + change[:-1], load + change[-1]
        largest = np.max(np.abs(moment)) + 1e-9 * law.stiffness / length
        if np.max(np.abs(change[:-1])) <= tolerance * largest:
            last = _bend(problem, moment, load)
            response, force = last.response, last.wanted.force
            return Equilibrium(
                moment, response.plays, force, float(load), response.curvature, first
            )
    return None


def _damping(change: Floats, compliance: Floats, length: float) -> float:
    """Return the share of a step that turns no part of the wire too far."""
    max_turn = 0.7  # rad, of any part of the wire
    turn = float(np.max(np.abs(change * compliance))) * length
    return min(1.0, max_turn / turn) if turn > 0.0 else 1.0


def _bend(problem: _Problem, moment: Floats, load: float) -> _Bent:
    """Bend the wire by given moments, and evaluate the condition."""
    stations = problem.stations
    response = respond(problem.law, moment, problem.plays)
    angle = stations.from_clamp @ response.curvature
    cos, sin = np.cos(angle), np.sin(angle)
    tip = np.array([stations.weights @ cos, stations.weights @ sin])
    wanted = problem.condition.demand(tip, load)
    return _Bent(response, cos, sin, wanted)


def _linearise(problem: _Problem, moment: Floats, load: float) -> _Linearised:
    """Return the residual, and its exact Jacobian by moments (first n columns) and load (last)."""
    bent_wire = _bend(problem, moment, load)
    cos, sin, wanted = bent_wire.cos, bent_wire.sin, bent_wire.wanted
    angle_by_moment = problem.stations.from_clamp * bent_wire.response.compliance
    to_tip, weights = problem.stations.to_tip, problem.stations.weights
    tip_by_moment = np.stack([-weights * sin, weights * cos]) @ angle_by_moment
    levers = np.stack([-to_tip @ sin, to_tip @ cos], axis=1)
    lateral = (problem.beyond - wanted.force[1]) * sin - wanted.force[0] * cos
    n = len(moment)
    jacobian = np.empty((n + 1, n + 1))
    jacobian[:n, :n] = -((to_tip * lateral) @ angle_by_moment)
    if wanted.force_by_tip.any():
        jacobian[:n, :n] -= levers @ (wanted.force_by_tip @ tip_by_moment)
    jacobian.flat[: n * (n + 1) : n + 2] += 1.0
    jacobian[:n, n] = -levers @ wanted.force_by_load
    jacobian[n, :n] = wanted.gap_by_tip @ tip_by_moment
    jacobian[n, n] = wanted.gap_by_load
    bending = levers @ wanted.force - to_tip @ (problem.beyond * cos)
    residual = np.append(moment - bending, wanted.gap)
    return _Linearised(residual, jacobian, bent_wire.response)


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations on the unit interval, the clamp at 0 and the tip at 1, with integration matrices.

    Parameters
    ----------
    position : shape (n,), increasing, ends included
    from_clamp : shape (n, n), values at the stations -> integral from 0 to each station
    to_tip : shape (n, n), values at the stations -> integral from each station to 1
    """

    position: Floats
    from_clamp: Floats
    to_tip: Floats

    @property
    def weights(self) -> Floats:
        """Return quadrature weights over the whole interval, shape (n,)."""
        weights: Floats = self.from_clamp[-1]
        return weights


@lru_cache(maxsize=16)
def chebyshev_stations(count: int) -> Stations:
    """Build `count` Chebyshev-Lobatto stations; exact for polynomials of degree count - 1.

    Raises
    ------
    ValueError
        If there are fewer than four.
    """
    if count < 4:
        message = f"count={count!r}: must be >= 4"
        raise ValueError(message)
    nodes = -np.cos(np.pi * np.arange(count) / (count - 1))
    basis = chebyshev.chebvander(nodes, count - 1)
    integrals = np.column_stack(
        [chebyshev.chebval(nodes, chebyshev.chebint(unit, lbnd=-1)) for unit in np.eye(count)]
    )
    from_clamp: Floats = 0.5 * np.linalg.solve(basis.T, integrals.T).T.astype(np.float64)
    to_tip: Floats = from_clamp[-1] - from_clamp
    for matrix in (nodes, from_clamp, to_tip):
        matrix.flags.writeable = False
    return Stations(0.5 * (nodes + 1.0), from_clamp, to_tip)


def interpolation_matrix(count: int, positions: Floats) -> Floats:
    """Return the matrix from values at the stations to values at `positions` in [0, 1].

    Parameters
    ----------
    count : number of stations
    positions : shape (m,), within [0, 1]

    Returns
    -------
    Shape (m, count).

    Raises
    ------
    ValueError
        If a position lies outside.
    """
    if np.any((positions < 0.0) | (positions > 1.0)):
        message = f"positions={positions}: must be between 0 and 1"
        raise ValueError(message)
    nodes = 2.0 * chebyshev_stations(count).position - 1.0
    basis = chebyshev.chebvander(nodes, count - 1)
    wanted = chebyshev.chebvander(2.0 * positions - 1.0, count - 1)
    matrix: Floats = np.linalg.solve(basis.T, wanted.T).T.astype(np.float64)
    return matrix
