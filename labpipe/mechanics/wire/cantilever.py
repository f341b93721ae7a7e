"""Solve large deflections of a clamped wire, for many loads at once or along a path.

Coordinates are relative to the clamp. x is along the undeformed axis from the clamped end. y is
normal to x, towards the pull. theta is the angle of the tangent from x. With the force (Px, Py) at
the tip, the length L and the weight w per length of the wire along -y, the moment M and the angle
theta at the distance s from the clamp are

    M(s) = integral from s to L of ((Py - w (L - s)) cos theta - Px sin theta),
    theta(s) = integral from 0 to s of kappa(M).

The unknowns are the moments at Chebyshev-Lobatto stations and one load, which a condition at the
tip determines. Newton's method solves many equilibria at once, without a series expansion. The
stiffness of the wire need not be uniform. `wire.first_loading` solves loading curves in this way.

A path with any history is followed in steps. A step is halved if Newton's method fails. The clamp
moves down: relative to the clamp, the anchor of the string moves up. The string is taut or slack,
and the counterweight always hangs at the tip. A wire with weight starts straight and level. It is
first bent under its weight, and the path of the test starts from this state.
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
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector

N_DEFAULT_STATIONS = 64
"""Default number of stations along a wire on a path.

With more than about 100 stations, BLAS starts threads, which is slower.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Stations(ArrayRecord):
    """Stations along a wire from the clamp to the tip, with integration matrices.

    Parameters
    ----------
    position : shape (n,), m, distance of each station from the clamp, from 0 to the length
    clamp_integral : shape (n, n), m, matrix that maps values at the stations to integrals from the
        clamp to each station
    tip_integral : shape (n, n), m, matrix that maps values at the stations to integrals from each
        station to the tip
    """

    position: Vector
    clamp_integral: Annotated[Floats, "n", "n"]
    tip_integral: Annotated[Floats, "n", "n"]

    @property
    def weights(self) -> Floats:
        """Quadrature weights over the whole wire, m, shape (n,)."""
        return np.asarray(self.clamp_integral[-1])

    def bend(self, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the angle (rad) and the coordinates x and y (m) at the stations of a bent wire."""
        angle = self.clamp_integral @ curvature
        return angle, self.clamp_integral @ np.cos(angle), self.clamp_integral @ np.sin(angle)


@lru_cache(maxsize=16)
def make_stations(n_stations: int, length: float = 1.0) -> Stations:
    """Make Chebyshev-Lobatto stations, which integrate polynomials of degree n - 1 exactly.

    Parameters
    ----------
    n_stations : n, number of stations, at least 4
    length : m, length of the wire

    Raises
    ------
    ValueError
        If `n_stations` is less than 4.
    """
    if length != 1.0:
        unit_wire = make_stations(n_stations)
        matrices = (length * unit_wire.clamp_integral, length * unit_wire.tip_integral)
        return Stations(length * unit_wire.position, *matrices)
    require("n_stations", n_stations, ">= 4", holds=n_stations >= 4)
    nodes = -np.cos(np.pi * np.arange(n_stations) / (n_stations - 1))
    basis = chebyshev.chebvander(nodes, n_stations - 1)
    antiderivatives = [chebyshev.chebint(unit, lbnd=-1) for unit in np.eye(n_stations)]
    integrals = np.column_stack([chebyshev.chebval(nodes, series) for series in antiderivatives])
    clamp_integral: Floats = 0.5 * np.linalg.solve(basis.T, integrals.T).T.astype(np.float64)
    tip_integral: Floats = clamp_integral[-1] - clamp_integral
    return Stations(0.5 * (nodes + 1.0), clamp_integral, tip_integral)


def make_interpolation_matrix(n_stations: int, positions: Floats) -> Floats:
    """Make the matrix that maps values at the stations to values at `positions`.

    Parameters
    ----------
    n_stations : number of stations, at least 4
    positions : shape (m,), distances from the clamp relative to the length, from 0 to 1

    Returns
    -------
    Shape (m, stations), read-only.

    Raises
    ------
    ValueError
        If a position is not between 0 and 1, or `n_stations` is less than 4.
    """
    holds = not np.any((positions < 0.0) | (positions > 1.0))
    require("positions", positions.tolist(), "between 0 and 1", holds=holds)
    nodes = 2.0 * make_stations(n_stations).position - 1.0
    basis = chebyshev.chebvander(nodes, n_stations - 1)
    basis_at_positions = chebyshev.chebvander(2.0 * positions - 1.0, n_stations - 1)
    matrix = np.asarray(np.linalg.solve(basis.T, basis_at_positions.T).T, dtype=np.float64)
    matrix.flags.writeable = False
    return matrix


@lru_cache(maxsize=16)
def make_transfer_matrix(n_stations: int, n_target_stations: int) -> Floats:
    """Make the matrix that maps values at stations to values at another number of stations."""
    return make_interpolation_matrix(n_stations, make_stations(n_target_stations).position)


@dataclass(frozen=True, slots=True)
class StringRig:
    """String and counterweight at the tip of a wire.

    Parameters
    ----------
    string_length : m, from the load cell to the tip
    weight : N, weight of the counterweight
    anchor_x : m, position of the load cell along the undeformed axis, above the initial tip
    anchor_height : m, height of the load cell above the undeformed axis at zero travel; less than
        `string_length` if the string is then slack
    """

    string_length: float
    weight: float
    anchor_x: float
    anchor_height: float

    def compute_taut_travel(self, x: float, y: float) -> float:
        """Compute the travel of the clamp, m, at which the string to a tip at x, y becomes taut."""
        rise = np.sqrt(self.string_length**2 - (self.anchor_x - x) ** 2)
        return float(y + rise - self.anchor_height)


class TipForce(NamedTuple):
    """Force at the tip in each of n equilibria, and residual of the condition at the tip.

    Parameters
    ----------
    force : shape (n, 2), N, sum of the force of the string, or of the end load, and the weight of
        the counterweight
    force_by_load : shape (n, 2), derivative of the force with respect to the load
    force_by_x : shape (n, 2), N/m, derivative of the force with respect to x of the tip
    residual : shape (n,), residual of the condition: m, or N under a dead force
    residual_by_tip : shape (n, 2), derivative of the residual with respect to the position of the
        tip
    residual_by_load : derivative of the residual with respect to the load; the same in all
        equilibria
    """

    force: Floats
    force_by_load: Floats
    force_by_x: Floats
    residual: Floats
    residual_by_tip: Floats
    residual_by_load: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TipCondition:
    """Condition at the tips of n equilibria: one of deflection, travel and dead force.

    Parameters
    ----------
    rig : taut string and counterweight; None for a force normal to the undeformed axis
    deflection : shape (n,), m, deflections of the tips; None for another condition
    travel : m, travel of the clamp with a taut string; NaN for another condition
    dead_force : shape (2,), N, force at the tip; the unknown `load` is then zero. None for another
        condition
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
        zero, ones = np.zeros_like(tip), np.ones_like(x)
        if self.dead_force is not None:
            return TipForce(zero + self.dead_force, zero, zero, load, zero, residual_by_load=1.0)
        direction_x, direction_y, force_by_x = np.zeros_like(x), ones, zero
        weight, taut_travel = 0.0, y
        if self.rig is not None:
            weight, length = self.rig.weight, self.rig.string_length
            direction_x = (self.rig.anchor_x - x) / length
            direction_y = np.sqrt(1.0 - direction_x**2)
            slope = np.stack([-ones, direction_x / direction_y], axis=1)
            force_by_x = (load / length)[:, None] * slope
            taut_travel = y + (length * direction_y - self.rig.anchor_height)
        direction = np.stack([direction_x, direction_y], axis=1)
        force = load[:, None] * direction - np.array([0.0, weight])
        if self.deflection is not None:
            residual, residual_by_x = y - self.deflection[rows], np.zeros_like(x)
        else:
            residual, residual_by_x = taut_travel - self.travel, direction_x / direction_y
        residual_by_tip = np.stack([residual_by_x, ones], axis=1)
        return TipForce(force, direction, force_by_x, residual, residual_by_tip)


@dataclass(frozen=True, slots=True, eq=False)
class BentWire:
    """Wire that is bent by n sets of moments; arrays of shape (n, stations).

    Parameters
    ----------
    stations : stations along the wire
    moment : N m, moments at the stations
    load : shape (n,), N, tension of the string, or end load
    curvature : 1/m, curvatures at the stations
    compliance : 1/(N m^2), derivative of the curvature with respect to the moment
    cos, sin : cosine and sine of the angle of the tangent
    lever_arms : shape (n, stations, 2), m, lever arms of forces along x and y at the tip
    tip : shape (n, 2), m, positions of the tip
    outer_weight : shape (stations,), N, weight of the wire from each station to the tip
    tip_force : force at the tip, and residual of the condition at the tip
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
    outer_weight: Floats
    tip_force: TipForce

    @property
    def compression(self) -> Floats:
        """Compressive axial force at the stations, N."""
        force_x, force_y = self.tip_force.force.T[..., None]
        return np.asarray((self.outer_weight - force_y) * self.sin - force_x * self.cos)

    def compute_residual(self) -> Floats:
        """Compute residuals of moments, N m, and of the tip condition, shape (n, stations + 1)."""
        bending = (self.lever_arms @ self.tip_force.force[:, :, None])[:, :, 0]
        bending -= (self.outer_weight * self.cos) @ self.stations.tip_integral.T
        return np.column_stack([self.moment - bending, self.tip_force.residual])

    def compute_jacobian(self) -> Floats:
        """Compute the derivatives of the residual with respect to moments and load.

        The shape is (n, m + 1, m + 1) for m stations.
        """
        stations, force, m = self.stations, self.tip_force, len(self.outer_weight)
        angle_by_moment = stations.clamp_integral * self.compliance[:, None, :]
        tip_by_angle = np.stack([-stations.weights * self.sin, stations.weights * self.cos], axis=1)
        tip_by_moment = tip_by_angle @ angle_by_moment
        jacobian = np.empty((len(self.tip), m + 1, m + 1))
        bending_by_angle = stations.tip_integral * self.compression[:, None, :]
        jacobian[:, :m, :m] = -(bending_by_angle @ angle_by_moment)
        if np.any(force.force_by_x):
            bending_by_x = self.lever_arms @ force.force_by_x[:, :, None]
            jacobian[:, :m, :m] -= bending_by_x * tip_by_moment[:, :1]
        np.einsum("nii->ni", jacobian[:, :m, :m])[...] += 1.0  # a view of the diagonals
        jacobian[:, :m, m] = -(self.lever_arms @ force.force_by_load[:, :, None])[:, :, 0]
        jacobian[:, m, :m] = (force.residual_by_tip[:, None, :] @ tip_by_moment)[:, 0]
        jacobian[:, m, m] = force.residual_by_load
        return jacobian

    def compute_sensitivities(self, curvature_changes: Floats) -> Floats:
        """Compute the derivatives of moments and load, shape (1 + parameters, n, stations + 1).

        The first derivative is with respect to the residual of the tip condition. The others are
        with respect to the parameters of the law.

        Parameters
        ----------
        curvature_changes : shape (parameters, n, stations), derivatives of the curvature with
            respect to the parameters at constant moment
        """
        stations, force, m = self.stations, self.tip_force, len(self.outer_weight)
        angle_changes = curvature_changes @ stations.clamp_integral.T
        tangents = -self.sin, self.cos
        tip_changes = np.stack([(angle_changes * side) @ stations.weights for side in tangents], -1)
        bending_by_x = (self.lever_arms @ force.force_by_x[:, :, None])[:, :, 0]
        bending_changes = (angle_changes * self.compression) @ stations.tip_integral.T
        bending_changes += bending_by_x * tip_changes[..., :1]
        residual = np.zeros((1 + len(curvature_changes), len(self.tip), m + 1))
        residual[0, :, m] = -1.0
        residual[1:, :, :m] = -bending_changes
        residual[1:, :, m] = np.sum(force.residual_by_tip * tip_changes, -1)
        solution = -np.linalg.solve(self.compute_jacobian(), np.moveaxis(residual, 0, 2))
        return np.asarray(np.moveaxis(solution, 2, 0), dtype=np.float64)


BendingLaw: TypeAlias = Callable[[Floats, Ints], CurvatureAndCompliance]
"""Function of the moments of all equilibria, shape (n, stations), and of row indices.

It returns the curvature, and its derivative with respect to the moment, in these rows.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Cantilever:
    """Clamped wire whose n equilibria are solved together.

    Parameters
    ----------
    law : bending law of the wire
    stations : stations along the wire
    self_weight : N/m, weight per length of the wire
    condition : condition at the tip
    coarse_wire : the same wire with fewer stations, on which Newton's steps are computed; None if
        steps are computed on all stations
    """

    law: BendingLaw
    stations: Stations
    self_weight: float
    condition: TipCondition
    coarse_wire: Cantilever | None = None

    @property
    def outer_weight(self) -> Floats:
        """Weight of the wire from each station to the tip, N, shape (stations,)."""
        position = self.stations.position
        return np.asarray(self.self_weight * (position[-1] - position))

    def bend(self, moment: Floats, load: Floats, rows: Ints | None = None) -> BentWire:
        """Bend the wire by moments, and evaluate the tip condition.

        Parameters
        ----------
        moment : shape (n, stations), N m, moments of all equilibria
        load : shape (n,), N, loads of all equilibria
        rows : indices of the equilibria to evaluate; None for all
        """
        rows = np.arange(len(load)) if rows is None else rows
        stations = self.stations
        curvature, compliance = self.law(moment, rows)
        angle = curvature @ stations.clamp_integral.T
        cos, sin = np.cos(angle), np.sin(angle)
        tip_integral = stations.tip_integral.T
        lever_arms = np.stack([-(sin @ tip_integral), cos @ tip_integral], axis=-1)
        tip = np.stack([cos @ stations.weights, sin @ stations.weights], axis=-1)
        tip_force = self.condition.compute_force(tip, load[rows], rows)
        bent = moment[rows], load[rows], curvature, compliance
        return BentWire(stations, *bent, cos, sin, lever_arms, tip, self.outer_weight, tip_force)

    def solve(
        self, moment: Floats, load: Floats, *, tolerance: float, moment_floor: float = 0.0
    ) -> tuple[Floats, Floats] | None:
        """Find the equilibria near a first guess by Newton's method.

        Parameters
        ----------
        moment : shape (n, stations), N m, first guess
        load : shape (n,), N, first guess
        tolerance : largest change of the moments in the last step, relative to the largest moment
            of each equilibrium. Convergence is quadratic. With steps from a coarse wire,
            convergence is linear, and a hundredth of the tolerance is required
        moment_floor : N m, added to the largest moment

        Returns
        -------
        Moments and loads in equilibrium; None if an equilibrium does not converge, or is not
        finite.
        """
        max_iterations = 15  # after more, Newton's method cycles about a corner of the law
        max_rotation = 0.7  # largest rotation of any station in one step, rad
        tolerance *= 1.0 if self.coarse_wire is None else 0.01
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
            scale = np.max(np.abs(moment[unconverged]), axis=1) + moment_floor
            unconverged = unconverged[np.max(np.abs(step[:, :-1]), axis=1) > tolerance * scale]
            if not unconverged.size:
                return moment, load
        return None

    def _compute_step(
        self, bent: BentWire, residual: Floats, moment: Floats, load: Floats, rows: Ints
    ) -> Floats:
        """Compute Newton's step of moments and loads, on the coarse wire if there is one.

        The derivative of the residual is the identity minus a smoothing integral operator. It is
        therefore sufficient to compute the smooth part of a step on the coarse stations (two-grid
        iteration, Atkinson, The Numerical Solution of Integral Equations of the Second Kind, 1997,
        section 6.2).
        """
        if self.coarse_wire is None:
            jacobian = bent.compute_jacobian()
            return np.asarray(-np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0])
        counts = len(self.stations.position), len(self.coarse_wire.stations.position)
        restrict, extend = make_transfer_matrix(*counts), make_transfer_matrix(*counts[::-1])
        coarse_residual = np.column_stack([residual[:, :-1] @ restrict.T, residual[:, -1]])
        coarse_bent = self.coarse_wire.bend(moment @ restrict.T, load, rows)
        jacobian = coarse_bent.compute_jacobian()
        step = -np.linalg.solve(jacobian, coarse_residual[:, :, None])[:, :, 0]
        smooth_step = (step + coarse_residual)[:, :-1] @ extend.T
        return np.column_stack([smooth_step - residual[:, :-1], step[:, -1]])


@dataclass(frozen=True, slots=True, eq=False)
class WireState(ArrayRecord):
    """State of a wire on a path: moments, curvatures and history at the stations, force at the tip.

    Parameters
    ----------
    moment : shape (stations,), N m
    curvature : shape (stations,), 1/m
    history : shape (stations, values), history of the law, as in `Response`
    force : shape (2,), N, total force at the tip
    load : N, tension of the string, or end load; 0 under a dead force
    travel : position on the path: travel of the clamp, m, tip deflection, m, or fraction of a
        change of force
    self_weight : N/m, weight per length of the wire, along -y
    previous_point : moments and load, shape (stations + 1,), and travel before the last step; None
        at the start of a path
    """

    moment: Annotated[Floats, "stations"]
    curvature: Annotated[Floats, "stations"]
    history: Annotated[Floats, "stations", "values"]
    force: Annotated[Floats, 2]
    load: float = 0.0
    travel: float = 0.0
    self_weight: float = 0.0
    previous_point: tuple[Floats, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CantileverShape:
    """Shape of a wire in equilibrium; arrays of shape (stations,) from the clamp to the tip.

    Parameters
    ----------
    arc_length : m, distance from the clamp along the wire
    angle : rad, angle of the tangent from the undeformed axis
    x, y : m, positions of the stations
    state : state from which the next part of a path starts
    """

    arc_length: Floats
    angle: Floats
    x: Floats
    y: Floats
    state: WireState

    @property
    def curvature(self) -> Floats:
        """Curvatures at the stations, 1/m."""
        return self.state.curvature

    @property
    def moment(self) -> Floats:
        """Moments at the stations, N m."""
        return self.state.moment

    @property
    def force(self) -> Floats:
        """Total force at the tip, including the counterweight, shape (2,), N."""
        return self.state.force

    @property
    def tension(self) -> float:
        """Tension of the string, or end load, N; 0 for a slack string or a dead force."""
        return self.state.load


StepFunction: TypeAlias = Callable[[WireState, float], WireState | None]
"""Function of a state and the next travel; it returns the next state, or None if it fails."""


def make_straight(
    law: PlayLaw, n_stations: int = N_DEFAULT_STATIONS, *, self_weight: float = 0.0
) -> WireState:
    """Make the state of a straight wire that has never been bent.

    Parameters
    ----------
    law : law of the wire
    n_stations : number of stations along the wire
    self_weight : N/m, weight per length of the wire; it acts from the first step of the path

    Raises
    ------
    ValueError
        If `self_weight` is negative.
    """
    require_not_negative("self_weight", self_weight)
    zeros, history = np.zeros(n_stations), law.make_unbent_history(n_stations)
    return WireState(zeros, zeros, history, np.zeros(2), self_weight=self_weight)


def bend_under_force(
    law: PlayLaw, state: WireState, length: float, force: Floats
) -> CantileverShape:
    """Bend a wire by changing its end force linearly to another force.

    Parameters
    ----------
    law : law of the wire
    state : state of the wire from which to start
    length : m, length of the wire
    force : shape (2,), N, final end force; its direction does not rotate with the wire

    Raises
    ------
    ValueError
        If `length` is not positive, `force` is not finite, no equilibrium is found on the path, or
        the wire is bent beyond the range of its law (the message states the curvature).
    """
    start_force, end_force = state.force, np.asarray(force, dtype=np.float64)
    state = replace(state, travel=0.0, previous_point=None)
    require_positive("length", length)
    require_finite("force", end_force)

    def step(current: WireState, fraction: float) -> WireState | None:
        condition = TipCondition(dead_force=start_force + fraction * (end_force - start_force))
        return _solve_next(law, current, length, condition, travel=fraction)

    context = f"force={end_force.tolist()}"
    return _finish_path(law, _follow_path(step, state, 1.0, context), length, context)


def bend_to_deflection(
    law: PlayLaw, state: WireState, length: float, deflection: float
) -> CantileverShape:
    """Bend a wire to a tip deflection by an end force normal to the undeformed axis.

    Parameters
    ----------
    law : law of the wire
    state : state of the wire from which to start; `state.travel` is the deflection of its tip
    length : m, length of the wire
    deflection : m, final deflection of the tip

    Returns
    -------
    The shape; ``force[1]`` is the end load.

    Raises
    ------
    ValueError
        If `length` is not positive, `deflection` is not finite, no equilibrium is found on the path
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
    """Bend a wire to a tip deflection without a check of the range of its law.

    Parameters
    ----------
    law, state, length, deflection : law, first state and length of the wire, and final deflection
        of its tip, as for `bend_to_deflection`
    rig : string and counterweight; None for an end force normal to the undeformed axis

    Raises
    ------
    ValueError
        If no equilibrium is found on the path.
    """

    def step(current: WireState, travel: float) -> WireState | None:
        condition = TipCondition(rig, deflection=np.array([travel]))
        return _solve_next(law, current, length, condition, travel=travel)

    return _follow_path(step, state, deflection, f"deflection={deflection!r}")


def bend_to_travel(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, travel: float
) -> CantileverShape:
    """Bend a wire on a string by moving its clamp to `travel`.

    Parameters
    ----------
    law : law of the wire
    state : state of the wire from which to start; `state.travel` is the travel of its clamp
    length : m, length of the wire
    rig : string and counterweight
    travel : m, final travel of the clamp from its initial height, positive downwards

    Returns
    -------
    The shape; its tension is zero if the string is slack.

    Raises
    ------
    ValueError
        If `length` is not positive, `travel` is not finite, no equilibrium is found on the path, or
        the wire is bent beyond the range of its law (the message states the curvature).
    """
    slack_tolerance = 1e-12  # m; a straight string without tension counts as slack

    def solve_taut(current: WireState, travel: float) -> WireState | None:
        condition = TipCondition(rig, travel=travel)
        solution = _solve_next(law, current, length, condition, travel=travel)
        return solution if solution is not None and solution.load >= 0.0 else None

    def solve_slack(current: WireState, travel: float) -> WireState | None:
        condition = TipCondition(dead_force=np.array([0.0, -rig.weight]))
        solution = _solve_next(law, current, length, condition, travel=travel)
        if solution is None:
            return None
        shape = compute_shape(solution, length)
        taut_travel = rig.compute_taut_travel(float(shape.x[-1]), float(shape.y[-1]))
        if taut_travel < travel - slack_tolerance:
            return None
        return replace(solution, load=0.0)  # exactly zero, without rounding

    def step(current: WireState, travel: float) -> WireState | None:
        is_taut = current.load > 0.0
        solvers = (solve_taut, solve_slack) if is_taut else (solve_slack, solve_taut)
        solution = solvers[0](current, travel)
        return solvers[1](current, travel) if solution is None else solution

    require_positive("length", length)
    require_finite("travel", travel)
    context = f"travel={travel!r}"
    return _finish_path(law, _follow_path(step, state, travel, context), length, context)


def _finish_path(law: PlayLaw, state: WireState, length: float, context: str) -> CantileverShape:
    """Compute the shape of a state; raise ValueError if it is beyond the range of the law."""
    require_within(law, state.moment, context)
    return compute_shape(state, length)


def compute_shape(state: WireState, length: float) -> CantileverShape:
    """Compute the shape of a state in equilibrium."""
    stations = make_stations(len(state.moment), length)
    return CantileverShape(stations.position, *stations.bend(state.curvature), state)


def _solve_next(
    law: PlayLaw, state: WireState, length: float, condition: TipCondition, *, travel: float
) -> WireState | None:
    """Find the next equilibrium; None if Newton's method fails or rotates a station too far."""
    max_rotation = 1.0  # rad; after a larger rotation in one step, the wire may be curled
    tolerance = 1e-7  # relative change of the moments in the last step; convergence is quadratic
    max_extrapolation = 4.0  # relative to the last step
    moment_floor = 1e-9 * law.stiffness / length  # EI / L bends the wire by a radian
    stations = make_stations(len(state.moment), length)
    responses: list[Response] = []

    def respond(moment: Floats, _: Ints) -> CurvatureAndCompliance:
        responses.append(law.respond(moment[0], state.history))
        return responses[-1].curvature[None], responses[-1].compliance[None]

    wire = Cantilever(respond, stations, state.self_weight, condition)
    unknowns = np.append(state.moment, state.load)
    last_point = unknowns, state.travel
    previous_unknowns, previous_travel = state.previous_point or (unknowns, -np.inf)
    extrapolation = (travel - state.travel) / ((state.travel - previous_travel) or np.inf)
    if 0.0 < extrapolation <= max_extrapolation:  # the path has not been reversed
        unknowns = unknowns + extrapolation * (unknowns - previous_unknowns)
    guess = unknowns[None, :-1], unknowns[-1:]
    solution = wire.solve(*guess, tolerance=tolerance, moment_floor=moment_floor)
    if solution is None:
        return None
    bent = wire.bend(*solution)
    rotation = stations.clamp_integral @ (bent.curvature[0] - state.curvature)
    if np.max(np.abs(rotation)) > max_rotation:
        return None
    moment, curvature, history = bent.moment[0], bent.curvature[0], responses[-1].history
    force, load, self_weight = bent.tip_force.force[0], bent.load.item(), state.self_weight
    return WireState(moment, curvature, history, force, load, travel, self_weight, last_point)


def _follow_path(step: StepFunction, state: WireState, target: float, context: str) -> WireState:
    """Advance the state to the target travel in steps that are halved if they fail.

    Raises
    ------
    ValueError
        If a step of at most 1/4096 of the distance fails.
    """
    min_step = 2.0**-12
    start_travel, distance = state.travel, target - state.travel
    step_size, fraction = 1.0, 0.0  # relative to the distance
    while fraction < 1.0:
        next_fraction = min(1.0, fraction + step_size)
        travel = target if next_fraction == 1.0 else start_travel + next_fraction * distance
        next_state = step(state, travel)
        if next_state is not None:
            state, fraction, step_size = next_state, next_fraction, min(1.0, 2.0 * step_size)
        elif step_size <= min_step:
            message = f"{context}: no equilibrium beyond {start_travel + fraction * distance:.6g}"
            raise ValueError(message)
        else:
            step_size *= 0.5
    return state
