"""Solve large deflections of a clamped wire, for many loads at once or along a path.

The frame is that of the clamp: x along the undeformed axis from the clamped end, y in the plane of
bending towards the pull. theta is the angle of the tangent from x. With the force (Px, Py) at the
tip and the weight w per length of the wire along -y,

    M(s) = integral from s to L of ((Py - w (L - s)) cos theta - Px sin theta),
    theta(s) = integral from 0 to s of kappa(M).

The unknowns are the moments at Chebyshev-Lobatto stations and one load, which a condition at the
tip determines. Newton's method solves many equilibria at once, without a series expansion and
without a uniform stiffness of the wire. `wire.first_loading` solves loading curves in this way.

A path with any history is followed in steps. A step is halved if Newton's method fails. The clamp
moves down; in the frame of the clamp, the anchor of the string moves up. The string is taut or
slack, and the counterweight always hangs at the tip. A wire with weight is mounted level and bends
under its weight before the test. Its path starts from this equilibrium and its history.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from numpy.polynomial import chebyshev

from labpipe.mechanics.law.plays import (
    CurvatureAndCompliance,
    PlayLaw,
    Response,
    require,
    require_finite,
    require_not_negative,
    require_positive,
    require_within,
)
from labpipe.records.arrays import ArrayRecord, Floats, Ints

DEFAULT_STATIONS = 64  # with more than about 100 stations, BLAS starts threads, which is slower


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations along a wire from the clamp to the tip, with integration matrices.

    Parameters
    ----------
    position : shape (n,), m, distance from the clamp, increasing, ends included
    from_clamp : shape (n, n), m, maps values at the stations to integrals from the clamp to each
        station
    to_tip : shape (n, n), m, maps values at the stations to integrals from each station to the tip
    """

    position: Floats
    from_clamp: Floats
    to_tip: Floats

    @property
    def weights(self) -> Floats:
        """Quadrature weights over the whole wire, shape (n,)."""
        return np.asarray(self.from_clamp[-1])

    def bend(self, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Bend a wire to a curvature; return angle, x and y at all stations, shape (n,) each."""
        angle = self.from_clamp @ curvature
        return angle, self.from_clamp @ np.cos(angle), self.from_clamp @ np.sin(angle)


@lru_cache(maxsize=16)
def make_stations(count: int, length: float = 1.0) -> Stations:
    """Make Chebyshev-Lobatto stations, which are exact for polynomials up to degree count - 1.

    Parameters
    ----------
    count : number of stations
    length : m, length of the wire

    Raises
    ------
    ValueError
        If there are fewer than four stations.
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
    """Make the matrix that maps values at the stations to values at `positions`.

    Parameters
    ----------
    count : number of stations
    positions : shape (m,), distances from the clamp relative to the length, from 0 to 1

    Returns
    -------
    Shape (m, count).

    Raises
    ------
    ValueError
        If a position is not between 0 and 1, or there are fewer than four stations.
    """
    holds = not np.any((positions < 0.0) | (positions > 1.0))
    require("positions", positions.tolist(), "between 0 and 1", holds=holds)
    nodes = 2.0 * make_stations(count).position - 1.0
    basis = chebyshev.chebvander(nodes, count - 1)
    basis_at_positions = chebyshev.chebvander(2.0 * positions - 1.0, count - 1)
    return np.asarray(np.linalg.solve(basis.T, basis_at_positions.T).T, dtype=np.float64)


@lru_cache(maxsize=16)
def make_transfer_matrix(count: int, to_count: int) -> Floats:
    """Make the matrix that maps values at `count` stations to values at `to_count` stations."""
    return make_interpolation_matrix(count, make_stations(to_count).position)


@dataclass(frozen=True, slots=True)
class StringRig:
    """String and counterweight at the tip of a wire.

    Parameters
    ----------
    string_length : m, from the load cell to the tip
    weight : N, weight of the counterweight
    anchor_x : m, position of the load cell along the undeformed axis, above the initial tip
    anchor_height : m, height of the load cell over the undeformed axis at zero travel; less than
        `string_length` if the string is slack there
    """

    string_length: float
    weight: float
    anchor_x: float
    anchor_height: float

    def compute_taut_travel(self, x: float, y: float) -> float:
        """Compute the travel, m, at which the string becomes taut for a tip at (x, y)."""
        rise = np.sqrt(self.string_length**2 - (self.anchor_x - x) ** 2)
        return float(y + rise - self.anchor_height)


class TipForce(NamedTuple):
    """Force at the tip of n equilibria, and residual of the condition at the tip.

    Parameters
    ----------
    force : shape (n, 2), N, force of string or load, and of the counterweight
    by_load : shape (n, 2), derivative of the force with respect to the load
    by_x : shape (n, 2), N/m, derivative of the force with respect to x of the tip
    gap : shape (n,), residual of the condition
    gap_by_tip : shape (n, 2), derivative of the gap with respect to the position of the tip
    gap_by_load : derivative of the gap with respect to the load
    """

    force: Floats
    by_load: Floats
    by_x: Floats
    gap: Floats
    gap_by_tip: Floats
    gap_by_load: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TipCondition:
    """Condition at the tips of n equilibria: deflection, travel or dead force.

    Parameters
    ----------
    rig : taut string and counterweight; None for a force normal to the undeformed axis
    deflection : shape (n,), m, deflections of the tips
    travel : m, travel of the clamp with a taut string
    dead_force : shape (2,), N, force of constant direction; the load is then zero
    """

    rig: StringRig | None = None
    deflection: Floats | None = None
    travel: float = np.nan
    dead_force: Floats | None = None

    def compute_force(self, tip: Floats, load: Floats, rows: Ints) -> TipForce:
        """Compute the force at the tip, and the residual of the condition.

        Parameters
        ----------
        tip : shape (n, 2), m, positions of the tips
        load : shape (n,), N, tension of the string, or end load
        rows : shape (n,), indices of the equilibria
        """
        x, y = tip.T
        zeros, ones = np.zeros_like(tip), np.ones_like(x)
        if self.dead_force is not None:
            return TipForce(zeros + self.dead_force, zeros, zeros, load, zeros, gap_by_load=1.0)
        string_x, string_y, by_x, weight, height = 0.0 * ones, ones, zeros, 0.0, 0.0 * ones
        if self.rig is not None:
            weight, length = self.rig.weight, self.rig.string_length
            string_x = (self.rig.anchor_x - x) / length
            string_y = np.sqrt(1.0 - string_x**2)
            by_x = (load / length)[:, None] * np.stack([-ones, string_x / string_y], axis=1)
            height = length * string_y - self.rig.anchor_height
        direction = np.stack([string_x, string_y], axis=1)
        force = load[:, None] * direction - np.array([0.0, weight])
        if self.deflection is not None:
            gap, gap_by_x = y - self.deflection[rows], 0.0 * ones
        else:
            gap, gap_by_x = y + height - self.travel, string_x / string_y
        return TipForce(force, direction, by_x, gap, np.stack([gap_by_x, ones], axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class BentWire:
    """A wire bent by n sets of moments; arrays of shape (n, stations).

    Parameters
    ----------
    stations : stations along the wire
    moment : N m
    load : shape (n,), N, tension of the string, or end load
    curvature : 1/m
    compliance : 1/(N m^2), derivative of the curvature with respect to the moment
    cos, sin : cosine and sine of the angle of the tangent
    lever_arms : shape (n, stations, 2), m, lever arms of forces along x and y at the tip
    tip : shape (n, 2), m, positions of the tip
    weight_beyond : shape (stations,), N, weight of the wire beyond each station
    tip_force : force at the tip, and residual of the condition there
    """

    stations: Stations
    moment: Floats
    load: Floats
    curvature: Floats
    compliance: Floats
    cos: Floats
    sin: Floats
    lever_arms: Floats
    tip: Floats
    weight_beyond: Floats
    tip_force: TipForce

    @property
    def compression(self) -> Floats:
        """Compressive axial force at the stations, N."""
        force_x, force_y = self.tip_force.force.T[..., None]
        return np.asarray((self.weight_beyond - force_y) * self.sin - force_x * self.cos)

    def compute_residual(self) -> Floats:
        """Compute the residuals of moments, N m, and of the condition, shape (n, stations + 1)."""
        bending = (self.lever_arms @ self.tip_force.force[:, :, None])[:, :, 0]
        bending -= (self.weight_beyond * self.cos) @ self.stations.to_tip.T
        return np.column_stack([self.moment - bending, self.tip_force.gap])

    def compute_jacobian(self) -> Floats:
        """Compute the derivatives of the residual with respect to moments and load.

        The shape is (n, stations + 1, stations + 1).
        """
        stations, end, n = self.stations, self.tip_force, len(self.weight_beyond)
        angle_by_moment = stations.from_clamp * self.compliance[:, None, :]
        tip_by_angle = np.stack([-stations.weights * self.sin, stations.weights * self.cos], axis=1)
        tip_by_moment = tip_by_angle @ angle_by_moment
        jacobian = np.empty((len(self.tip), n + 1, n + 1))
        jacobian[:, :n, :n] = -((stations.to_tip * self.compression[:, None, :]) @ angle_by_moment)
        if np.any(end.by_x):
            jacobian[:, :n, :n] -= (self.lever_arms @ end.by_x[:, :, None]) * tip_by_moment[:, :1]
        jacobian[:, range(n), range(n)] += 1.0
        jacobian[:, :n, n] = -(self.lever_arms @ end.by_load[:, :, None])[:, :, 0]
        jacobian[:, n, :n] = (end.gap_by_tip[:, None, :] @ tip_by_moment)[:, 0]
        jacobian[:, n, n] = end.gap_by_load
        return jacobian

    def compute_sensitivities(self, curvature_changes: Floats) -> Floats:
        """Compute the derivatives of moments and load, shape (1 + parameters, n, stations + 1).

        The first row is with respect to the gap of the condition, the others with respect to the
        parameters of the law.

        Parameters
        ----------
        curvature_changes : shape (parameters, n, stations), derivatives of the curvature with
            respect to the parameters at constant moment
        """
        stations, end, n = self.stations, self.tip_force, len(self.weight_beyond)
        angle = curvature_changes @ stations.from_clamp.T
        tip_x, tip_y = ((angle * side) @ stations.weights for side in (-self.sin, self.cos))
        bending = (angle * self.compression) @ stations.to_tip.T
        bending += (self.lever_arms @ end.by_x[:, :, None])[:, :, 0] * tip_x[:, :, None]
        residual = np.zeros((1 + len(curvature_changes), len(self.tip), n + 1))
        residual[0, :, n] = -1.0
        residual[1:, :, :n] = -bending
        residual[1:, :, n] = end.gap_by_tip[:, 0] * tip_x + end.gap_by_tip[:, 1] * tip_y
        solution = -np.linalg.solve(self.compute_jacobian(), np.moveaxis(residual, 0, 2))
        return np.asarray(np.moveaxis(solution, 2, 0), dtype=np.float64)


BendingLaw: TypeAlias = Callable[[Floats, Ints], CurvatureAndCompliance]
"""Function of the moments of all equilibria, shape (n, stations), and of row indices.

It returns the curvature, and its derivative with respect to the moment, in these rows.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Cantilever:
    """A clamped wire of which n equilibria are sought.

    Parameters
    ----------
    law : bending law of the wire
    stations : stations along the wire
    self_weight : N/m, weight per length
    condition : condition at the tip
    coarse : the same wire with fewer stations, on which Newton's steps are computed; None if they
        are computed on all stations
    """

    law: BendingLaw
    stations: Stations
    self_weight: float
    condition: TipCondition
    coarse: Cantilever | None = None

    @property
    def weight_beyond(self) -> Floats:
        """Weight of the wire beyond each station, N."""
        position = self.stations.position
        return np.asarray(self.self_weight * (position[-1] - position))

    def bend(self, moment: Floats, load: Floats, rows: Ints | None = None) -> BentWire:
        """Bend the wire by moments, and evaluate the condition.

        Parameters
        ----------
        moment : shape (n, stations), N m, moments of all equilibria
        load : shape (n,), N, loads of all equilibria
        rows : indices of the equilibria for which to bend the wire; None for all
        """
        rows = np.arange(len(load)) if rows is None else rows
        stations = self.stations
        curvature, compliance = self.law(moment, rows)
        angle = curvature @ stations.from_clamp.T
        cos, sin = np.cos(angle), np.sin(angle)
        lever_arms = np.stack([-(sin @ stations.to_tip.T), cos @ stations.to_tip.T], axis=-1)
        tip = np.stack([cos @ stations.weights, sin @ stations.weights], axis=-1)
        tip_force = self.condition.compute_force(tip, load[rows], rows)
        bent = moment[rows], load[rows], curvature, compliance
        return BentWire(stations, *bent, cos, sin, lever_arms, tip, self.weight_beyond, tip_force)

    def solve(
        self, moment: Floats, load: Floats, *, tolerance: float, floor: float = 0.0
    ) -> tuple[Floats, Floats] | None:
        """Find the equilibria near a first guess by Newton's method; each converges separately.

        Parameters
        ----------
        moment : shape (n, stations), N m, first guess
        load : shape (n,), N, first guess
        tolerance : last change of the moments, relative to the largest moment; convergence is
            quadratic. A hundredth of it is required with steps from coarse stations, because their
            convergence is linear
        floor : N m, added to the largest moment

        Returns
        -------
        Moments and loads in equilibrium; None if an iteration does not converge, or is not finite.
        """
        max_iterations = 15  # when it needs more, Newton's method cycles at corners of a law
        max_rotation = 0.7  # rad, rotation of any station in one step
        tolerance *= 1.0 if self.coarse is None else 0.01
        moment, load = np.array(moment), np.array(load)
        unconverged, length = np.arange(len(load)), self.stations.position[-1]
        for _ in range(max_iterations):
            bent = self.bend(moment, load, unconverged)
            residual = bent.compute_residual()
            if not np.isfinite(residual).all():
                return None
            step = self._compute_step(bent, residual, moment, load, unconverged)
            rotation = np.max(np.abs(step[:, :-1] * bent.compliance), axis=1) * length
            step *= np.minimum(1.0, max_rotation / np.maximum(rotation, max_rotation))[:, None]
            moment[unconverged] += step[:, :-1]
            load[unconverged] += step[:, -1]
            largest = np.max(np.abs(moment[unconverged]), axis=1) + floor
            unconverged = unconverged[np.max(np.abs(step[:, :-1]), axis=1) > tolerance * largest]
            if not unconverged.size:
                return moment, load
        return None

    def _compute_step(
        self, bent: BentWire, residual: Floats, moment: Floats, load: Floats, rows: Ints
    ) -> Floats:
        """Compute Newton's step of moments and load, from the coarse wire if there is one.

        The derivative of a residual is the identity minus an integral operator, which smooths. Only
        the smooth part of a step is therefore computed on the coarse stations (two-grid iteration,
        Atkinson, The Numerical Solution of Integral Equations of the Second Kind, 1997, section
        6.2).
        """
        if self.coarse is None:
            return np.asarray(
                -np.linalg.solve(bent.compute_jacobian(), residual[..., None])[..., 0]
            )
        counts = len(self.stations.position), len(self.coarse.stations.position)
        restrict, extend = make_transfer_matrix(*counts), make_transfer_matrix(*counts[::-1])
        coarse_residual = np.column_stack([residual[:, :-1] @ restrict.T, residual[:, -1]])
        coarse = self.coarse.bend(moment @ restrict.T, load, rows)
        step = -np.linalg.solve(coarse.compute_jacobian(), coarse_residual[:, :, None])[:, :, 0]
        smooth_step = (step + coarse_residual)[:, :-1] @ extend.T
        return np.column_stack([smooth_step - residual[:, :-1], step[:, -1]])


@dataclass(frozen=True, slots=True, eq=False)
class WireState(ArrayRecord):
    """Moments and history of a wire at its stations.

    Parameters
    ----------
    moment : shape (stations,), N m
    curvature : shape (stations,), 1/m
    plays : shape (stations, plays), N m, history of the law
    force : shape (2,), N, force at the tip
    load : N, tension of the string, or end load; 0 under a dead force
    travel : position on the path: travel of the clamp, m, tip deflection, m, or fraction of a
        change of force
    self_weight : N/m, weight per length of the wire, along -y
    previous : moments and load, shape (stations + 1,), and travel before the last step; None at the
        start of a path
    """

    moment: Annotated[Floats, "stations"]
    curvature: Annotated[Floats, "stations"]
    plays: Annotated[Floats, "stations", "plays"]
    force: Annotated[Floats, 2]
    load: float = 0.0
    travel: float = 0.0
    self_weight: float = 0.0
    previous: tuple[Floats, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CantileverShape:
    """Shape of a wire in equilibrium; arrays of shape (stations,) from the clamp to the tip.

    Parameters
    ----------
    arc_length : m, distance from the clamp along the wire
    angle : rad, angle of the tangent from the undeformed axis
    x, y : m, positions
    state : moments and history, from which the next step starts
    """

    arc_length: Floats
    angle: Floats
    x: Floats
    y: Floats
    state: WireState

    @property
    def curvature(self) -> Floats:
        """Curvatures, 1/m."""
        return self.state.curvature

    @property
    def moment(self) -> Floats:
        """Moments, N m."""
        return self.state.moment

    @property
    def force(self) -> Floats:
        """Total force at the tip, including the counterweight, shape (2,), N."""
        return self.state.force

    @property
    def tension(self) -> float:
        """Tension of the string, N, which is 0 if it is slack; without a string, the end load."""
        return self.state.load


StepFunction: TypeAlias = Callable[[WireState, float], WireState | None]
"""Function of a state and of the next travel that returns the next state, or None."""


def make_straight(
    law: PlayLaw, n_stations: int = DEFAULT_STATIONS, *, self_weight: float = 0.0
) -> WireState:
    """Make the state of a straight wire that was never bent.

    Parameters
    ----------
    law : law of the wire
    n_stations : number of stations along the wire
    self_weight : N/m, weight per length of the wire; it acts from the first step on

    Raises
    ------
    ValueError
        If `self_weight` is negative.
    """
    require_not_negative("self_weight", self_weight)
    straight, unbent = np.zeros(n_stations), law.make_unbent_history(n_stations)
    return WireState(straight, straight, unbent, np.zeros(2), self_weight=self_weight)


def bend_under_force(
    law: PlayLaw, state: WireState, length: float, force: Floats
) -> CantileverShape:
    """Bend a wire by changing its end force linearly to another force.

    Parameters
    ----------
    law : law of the wire
    state : state of the wire from which to start
    length : m, length of the wire
    force : shape (2,), N, end force of constant direction

    Raises
    ------
    ValueError
        If `length` is not positive, `force` is not finite, no equilibrium is found on the way, or
        the wire is bent beyond the range of its law (the message states the curvature).
    """
    start, target = state.force, np.asarray(force, dtype=np.float64)
    state = replace(state, travel=0.0, previous=None)
    require_positive("length", length)
    require_finite("force", target)

    def step(current: WireState, fraction: float) -> WireState | None:
        condition = TipCondition(dead_force=start + fraction * (target - start))
        return _solve_next(law, current, length, condition, travel=fraction)

    context = f"force={target.tolist()}"
    return _finish_path(law, _follow_path(step, state, 1.0, context), length, context)


def bend_to_deflection(
    law: PlayLaw, state: WireState, length: float, deflection: float
) -> CantileverShape:
    """Bend a wire by an end force normal to the undeformed axis to a tip deflection.

    Parameters
    ----------
    law : law of the wire
    state : state of the wire from which to start; `state.travel` is its deflection
    length : m, length of the wire
    deflection : m, deflection of the tip

    Returns
    -------
    The shape; ``force[1]`` is the end load.

    Raises
    ------
    ValueError
        If `length` is not positive, `deflection` is not finite, no equilibrium is found on the way
        (such as for a deflection that exceeds the length), or the wire is bent beyond the range of
        its law (the message states the curvature).
    """
    require_positive("length", length)
    require_finite("deflection", deflection)
    state = deflect(law, state, length, deflection)
    return _finish_path(law, state, length, f"deflection={deflection!r}")


def deflect(
    law: PlayLaw,
    state: WireState,
    length: float,
    deflection: float,
    rig: StringRig | None = None,
) -> WireState:
    """Bend a wire to a deflection without checking the range of its law.

    Parameters
    ----------
    law, state, length, deflection : law, first state and length of the wire, and deflection of its
        tip, as for `bend_to_deflection`
    rig : string and counterweight; None for an end force normal to the undeformed axis

    Raises
    ------
    ValueError
        If no equilibrium is found on the way.
    """

    def step(current: WireState, travel: float) -> WireState | None:
        condition = TipCondition(rig, deflection=np.array([travel]))
        return _solve_next(law, current, length, condition, travel=travel)

    return _follow_path(step, state, deflection, f"deflection={deflection!r}")


def bend_to_travel(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, travel: float
) -> CantileverShape:
    """Bend a wire on the string by moving its clamp to `travel`.

    Parameters
    ----------
    law : law of the wire
    state : state of the wire from which to start; `state.travel` is the travel of its clamp
    length : m, length of the wire
    rig : string and counterweight
    travel : m, travel of the clamp from its initial height, positive downwards

    Returns
    -------
    The shape; its tension is zero if the string is slack.

    Raises
    ------
    ValueError
        If `length` is not positive, `travel` is not finite, no equilibrium is found on the way, or
        the wire is bent beyond the range of its law (the message states the curvature).
    """
    slack_tolerance = 1e-12  # m; a string that is straight without tension counts as slack

    def solve_taut(current: WireState, travel: float) -> WireState | None:
        condition = TipCondition(rig, travel=travel)
        solution = _solve_next(law, current, length, condition, travel=travel)
        return solution if solution is not None and solution.load >= 0.0 else None

    def solve_slack(current: WireState, travel: float) -> WireState | None:
        weight = TipCondition(dead_force=np.array([0.0, -rig.weight]))
        solution = _solve_next(law, current, length, weight, travel=travel)
        if solution is None:
            return None
        shape = compute_shape(solution, length)
        taut_travel = rig.compute_taut_travel(float(shape.x[-1]), float(shape.y[-1]))
        if taut_travel < travel - slack_tolerance:
            return None
        return replace(solution, load=0.0)  # exactly zero, without rounding

    def step(current: WireState, travel: float) -> WireState | None:
        is_taut = current.load > 0.0
        first, second = (solve_taut, solve_slack) if is_taut else (solve_slack, solve_taut)
        solution = first(current, travel)
        return second(current, travel) if solution is None else solution

    require_positive("length", length)
    require_finite("travel", travel)
    context = f"travel={travel!r}"
    return _finish_path(law, _follow_path(step, state, travel, context), length, context)


def _finish_path(law: PlayLaw, state: WireState, length: float, context: str) -> CantileverShape:
    """Compute the shape of a state; refuse one that is bent beyond the range of its law."""
    require_within(law, state.moment, context)
    return compute_shape(state, length)


def compute_shape(state: WireState, length: float) -> CantileverShape:
    """Compute the shape of a state in equilibrium."""
    stations = make_stations(len(state.moment), length)
    return CantileverShape(stations.position, *stations.bend(state.curvature), state)


def _solve_next(
    law: PlayLaw, state: WireState, length: float, condition: TipCondition, *, travel: float
) -> WireState | None:
    """Find the next equilibrium; None if Newton's method fails or ends far away, as in a curl."""
    max_rotation = 1.0  # rad, rotation of any station in one step
    tolerance = 1e-7  # relative last change of the moments; convergence is quadratic
    max_extrapolation = 4.0  # relative to the last step
    floor = 1e-9 * law.stiffness / length  # fraction of the moment that bends the wire by a radian
    stations = make_stations(len(state.moment), length)
    responses: list[Response] = []

    def respond(moment: Floats, _: Ints) -> CurvatureAndCompliance:
        responses.append(law.respond(moment[0], state.plays))
        return responses[-1].curvature[None], responses[-1].compliance[None]

    wire = Cantilever(respond, stations, state.self_weight, condition)
    last = np.append(state.moment, state.load), state.travel
    (unknowns, start), (previous, previous_start) = last, state.previous or (last[0], -np.inf)
    extrapolation = (travel - start) / ((start - previous_start) or np.inf)
    if 0.0 < extrapolation <= max_extrapolation:  # the path has not been reversed
        unknowns = unknowns + extrapolation * (unknowns - previous)
    solution = wire.solve(unknowns[None, :-1], unknowns[-1:], tolerance=tolerance, floor=floor)
    if solution is None:
        return None
    bent = wire.bend(*solution)
    rotation = stations.from_clamp @ (bent.curvature[0] - state.curvature)
    if np.max(np.abs(rotation)) > max_rotation:
        return None
    result = bent.moment[0], bent.curvature[0], responses[-1].history, bent.tip_force.force[0]
    return WireState(*result, bent.load.item(), travel, state.self_weight, last)


def _follow_path(step: StepFunction, state: WireState, target: float, context: str) -> WireState:
    """Advance the state to the target travel in steps that are halved if they fail.

    Raises
    ------
    ValueError
        If a step of at most 1/4096 of the distance fails.
    """
    min_step = 2.0**-12
    start, distance = state.travel, target - state.travel
    step_size, position = 1.0, 0.0  # relative to the distance
    while position < 1.0:
        next_position = min(1.0, position + step_size)
        travel = target if next_position == 1.0 else start + next_position * distance
        next_state = step(state, travel)
        if next_state is not None:
            state, position, step_size = next_state, next_position, min(1.0, 2.0 * step_size)
        elif step_size <= min_step:
            message = f"{context}: no equilibrium beyond {start + position * distance:.6g}"
            raise ValueError(message)
        else:
            step_size *= 0.5
    return state
