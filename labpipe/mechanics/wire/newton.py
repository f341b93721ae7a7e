"""Newton's method for clamped wires at Chebyshev-Lobatto stations, many equilibria at once.

With the force (Px, Py) at the tip and the wire's own weight w per length along -y, the wire
transmits (Px, Py - w (L - s)) at s, so that

    M(s) = integral from s to L of ((Py - w (L - s)) cos theta - Px sin theta),
    theta(s) = integral of kappa(M).

Unknown are the moments at the stations and one load, which a condition at the tip fixes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.polynomial import chebyshev

from labpipe.mechanics.law.plays import CurvatureAndSlope, require
from labpipe.records.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """Demand of a condition at tip positions and loads of n equilibria.

    Parameters
    ----------
    force : shape (n, 2), N, at the tip
    force_by_load : shape (n, 2), its derivative by the load
    gap : shape (n,), m, zero where the condition holds
    gap_by_tip : shape (n, 2), its derivative by the tip's position
    force_by_tip : shape (n, 2, 2), N/m, derivative of the force by the tip's position; None for 0
    gap_by_load : m/N, derivative of the gap by the load
    """

    force: Floats
    force_by_load: Floats
    gap: Floats
    gap_by_tip: Floats
    force_by_tip: Floats | None = None
    gap_by_load: float = 0.0


class Condition(Protocol):
    """Condition that fixes the force at the tip."""

    def demand(self, tip: Floats, load: Floats, rows: Ints) -> Demand:
        """Compute force, gap and their derivatives.

        Parameters
        ----------
        tip : shape (n, 2), m
        load : shape (n,), N
        rows : shape (n,), which of the equilibria these are
        """


@dataclass(frozen=True, slots=True, eq=False)
class Wire:
    """A wire in search of equilibria.

    Parameters
    ----------
    bend : curvature and its slope at moments of shape (n, stations)
    stations : along the length, m
    self_weight : N/m
    condition : at the tip
    """

    bend: Callable[[Floats], CurvatureAndSlope]
    stations: Stations
    self_weight: float
    condition: Condition

    @property
    def beyond(self) -> Floats:
        """Return the weight beyond each station, N."""
        position = self.stations.position
        return np.asarray(self.self_weight * (position[-1] - position))


@dataclass(frozen=True, slots=True, eq=False)
class BentWire:
    """The wire bent by given moments; arrays of shape (n, stations).

    Parameters
    ----------
    curvature, slope : 1/m, 1/(N m^2)
    cos, sin : of the angle
    levers : shape (n, stations, 2), m, of forces along x and y at the tip
    tip : shape (n, 2), m
    wanted : by the condition
    """

    curvature: Floats
    slope: Floats
    cos: Floats
    sin: Floats
    levers: Floats
    tip: Floats
    wanted: Demand

    def lateral(self, beyond: Floats) -> Floats:
        """Return the derivative of the moments by a turn of the wire, N: the force along it."""
        along, up = self.wanted.force.T[..., None]
        return np.asarray((beyond - up) * self.sin - along * self.cos)


def bend_wire(wire: Wire, moment: Floats, load: Floats, rows: Ints | None = None) -> BentWire:
    """Bend the wire by given moments, and evaluate the condition.

    Parameters
    ----------
    wire : the wire
    moment, load : shape (n, stations), N m, and (n,), N
    rows : which of the equilibria these are; None for all
    """
    stations = wire.stations
    curvature, slope = wire.bend(moment)
    angle = curvature @ stations.from_clamp.T
    cos, sin = np.cos(angle), np.sin(angle)
    levers = np.stack([-(sin @ stations.to_tip.T), cos @ stations.to_tip.T], axis=-1)
    tip = np.stack([cos @ stations.weights, sin @ stations.weights], axis=-1)
    demand = wire.condition.demand(tip, load, np.arange(len(load)) if rows is None else rows)
    return BentWire(curvature, slope, cos, sin, levers, tip, demand)


def solve(
    wire: Wire, moment: Floats, load: Floats, *, tolerance: float, floor: float = 0.0
) -> tuple[Floats, Floats] | None:
    """Find the equilibria next to a start, each of which converges on its own.

    Parameters
    ----------
    wire : the wire
    moment, load : first guess, shape (n, stations), N m, and (n,), N
    tolerance : last change of the moments, as a share of the largest; the next is of its square
    floor : N m, added to the largest moment

    Returns
    -------
    Moments and loads; None if one of the iterations does not converge.
    """
    max_iterations = 40
    max_turn = 0.7  # rad, of any part of the wire in one step
    moment, load = np.array(moment), np.array(load)
    left, length = np.arange(len(load)), wire.stations.position[-1]
    for _ in range(max_iterations):
        bent_wire = bend_wire(wire, moment[left], load[left], left)
        missing = compute_residual(wire, bent_wire, moment[left])
        if not np.isfinite(missing).all():
            return None
        step = -np.linalg.solve(compute_jacobian(wire, bent_wire), missing[:, :, None])[:, :, 0]
        turn = np.max(np.abs(step[:, :-1] * bent_wire.slope), axis=1) * length
        step *= np.minimum(1.0, max_turn / np.maximum(turn, max_turn))[:, None]
        moment[left] += step[:, :-1]
        load[left] += step[:, -1]
        largest = np.max(np.abs(moment[left]), axis=1) + floor
        left = left[np.max(np.abs(step[:, :-1]), axis=1) > tolerance * largest]
        if not left.size:
            return moment, load
    return None


def compute_residual(wire: Wire, bent: BentWire, moment: Floats) -> Floats:
    """Return what the moments, N m, and the condition, m, miss: shape (n, stations + 1)."""
    bending = (bent.levers @ bent.wanted.force[:, :, None])[:, :, 0]
    bending -= (wire.beyond * bent.cos) @ wire.stations.to_tip.T
    return np.column_stack([moment - bending, bent.wanted.gap])


def compute_jacobian(wire: Wire, bent: BentWire) -> Floats:
    """Return the derivatives of `compute_residual`, shape (n, stations + 1, stations + 1)."""
    stations, demand, n = wire.stations, bent.wanted, len(wire.stations.position)
    turning = stations.from_clamp * bent.slope[:, None, :]
    across = np.stack([-stations.weights * bent.sin, stations.weights * bent.cos], axis=1)
    tip_by_moment = across @ turning
    derivatives = np.empty((len(bent.tip), n + 1, n + 1))
    lateral = bent.lateral(wire.beyond)
    derivatives[:, :n, :n] = -((stations.to_tip * lateral[:, None, :]) @ turning)
    if demand.force_by_tip is not None:
        derivatives[:, :n, :n] -= bent.levers @ (demand.force_by_tip @ tip_by_moment)
    derivatives[:, range(n), range(n)] += 1.0
    derivatives[:, :n, n] = -(bent.levers @ demand.force_by_load[:, :, None])[:, :, 0]
    derivatives[:, n, :n] = (demand.gap_by_tip[:, None, :] @ tip_by_moment)[:, 0]
    derivatives[:, n, n] = demand.gap_by_load
    return derivatives


def compute_sensitivity(wire: Wire, bent: BentWire, curvature_changes: Floats) -> Floats:
    """Return the derivatives of moments and load, shape (1 + parameters, n, stations + 1).

    First by the gap of the condition, then by each parameter.

    Parameters
    ----------
    wire, bent : in equilibrium
    curvature_changes : shape (parameters, n, stations), derivatives of the curvature at constant
        moment
    """
    stations, demand, n = wire.stations, bent.wanted, len(wire.stations.position)
    turn = curvature_changes @ stations.from_clamp.T
    across = [-(turn * bent.sin) @ stations.weights, (turn * bent.cos) @ stations.weights]
    tip = np.stack(across, axis=-1)
    bending = (turn * bent.lateral(wire.beyond)) @ stations.to_tip.T
    if demand.force_by_tip is not None:
        bending += np.einsum("nsk,nkj,pnj->pns", bent.levers, demand.force_by_tip, tip)
    missing = np.zeros((1 + len(curvature_changes), len(bent.tip), n + 1))
    missing[0, :, n] = -1.0
    missing[1:, :, :n] = -bending
    missing[1:, :, n] = np.sum(demand.gap_by_tip * tip, axis=-1)
    solution = -np.linalg.solve(compute_jacobian(wire, bent), np.moveaxis(missing, 0, 2))
    return np.asarray(np.moveaxis(solution, 2, 0), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations along a wire from the clamp to the tip, with integration matrices.

    Parameters
    ----------
    position : shape (n,), increasing, ends included
    from_clamp : shape (n, n), values at the stations -> integral from the clamp to each station
    to_tip : shape (n, n), values at the stations -> integral from each station to the tip
    """

    position: Floats
    from_clamp: Floats
    to_tip: Floats

    @property
    def weights(self) -> Floats:
        """Return quadrature weights over the whole wire, shape (n,)."""
        weights: Floats = self.from_clamp[-1]
        return weights


@lru_cache(maxsize=16)
def make_stations(count: int, length: float = 1.0) -> Stations:
    """Build `count` Chebyshev-Lobatto stations; exact for polynomials of degree count - 1.

    Raises
    ------
    ValueError
        If there are fewer than four.
    """
    if length != 1.0:
        unit = make_stations(count)
        return Stations(length * unit.position, length * unit.from_clamp, length * unit.to_tip)
    require("count", count, ">= 4", holds=count >= 4)
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


def make_interpolation_matrix(count: int, positions: Floats) -> Floats:
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
    nodes = 2.0 * make_stations(count).position - 1.0
    basis = chebyshev.chebvander(nodes, count - 1)
    basis_at_positions = chebyshev.chebvander(2.0 * positions - 1.0, count - 1)
    matrix: Floats = np.linalg.solve(basis.T, basis_at_positions.T).T.astype(np.float64)
    return matrix
