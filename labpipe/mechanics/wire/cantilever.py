"""Solve a clamped wire in large deflection, at many loads at once or along a path.

The frame is that of the clamp: x along the undeformed axis from the clamped end, y in the plane of
bending towards the pull; theta is the angle of the tangent from x. With the force (Px, Py) at the
tip and the wire's own weight w per length along -y,

    M(s) = integral from s to L of ((Py - w (L - s)) cos theta - Px sin theta),
    theta(s) = integral from 0 to s of kappa(M).

The unknowns are the moments at Chebyshev-Lobatto stations and one load, which a condition at the
tip determines; Newton's method solves many equilibria at once. Unlike the dissertation it uses no
series and no single stiffness for the whole wire. `wire.first_loading` solves loading curves in
this way.

A path with any history is followed in steps that are halved where Newton's method fails. The clamp
moves down; in the frame of the clamp, the anchor of the string moves up. The string is taut or
slack; the counterweight always hangs at the tip. A wire with weight is mounted level and bends
under its weight before the test: its path starts from this equilibrium and its history.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from numpy.polynomial import chebyshev

from labpipe.mechanics.law.plays import (
    CurvatureAndSlope,
    PlayLaw,
    Response,
    require,
    require_finite,
    require_not_negative,
    require_positive,
    require_within,
)
from labpipe.records.arrays import ArrayRecord, Floats, Ints

DEFAULT_STATIONS = 64  # above about 100, BLAS starts threads, which is slower


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
        return np.asarray(self.from_clamp[-1])

    def bend(self, curvature: Floats) -> tuple[Floats, Floats, Floats]:
        """Return angle, x and y at all stations of a wire, shape (n,) each."""
        angle = self.from_clamp @ curvature
        return angle, self.from_clamp @ np.cos(angle), self.from_clamp @ np.sin(angle)


@lru_cache(maxsize=16)
def make_stations(count: int, length: float = 1.0) -> Stations:
    """Build `count` Chebyshev-Lobatto stations; exact for polynomials up to degree count - 1.

    Parameters
    ----------
    count : number of stations
    length : of the wire; the positions are from 0 to `length`

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
        If a position lies outside, or there are fewer than four stations.
    """
    holds = not np.any((positions < 0.0) | (positions > 1.0))
    require("positions", positions.tolist(), "between 0 and 1", holds=holds)
    nodes = 2.0 * make_stations(count).position - 1.0
    basis = chebyshev.chebvander(nodes, count - 1)
    basis_at_positions = chebyshev.chebvander(2.0 * positions - 1.0, count - 1)
    return np.asarray(np.linalg.solve(basis.T, basis_at_positions.T).T, dtype=np.float64)


@lru_cache(maxsize=16)
def make_transfer_matrix(count: int, to_count: int) -> Floats:
    """Return the matrix from values at `count` stations to values at `to_count` stations."""
    return make_interpolation_matrix(count, make_stations(to_count).position)


@dataclass(frozen=True, slots=True)
class StringRig:
    """The string and the counterweight.

    Parameters
    ----------
    string_length : m, from the load cell to the tip
    weight : N, of the counterweight at the tip
    anchor_x : m, position of the load cell along the undeformed axis: above the initial tip
    anchor_height : m, of the load cell over the clamped axis at zero travel; less than
        `string_length` when the string is slack
    """

    string_length: float
    weight: float
    anchor_x: float
    anchor_height: float

    def travel_to_taut_string(self, x: float, y: float) -> float:
        """Return the travel of the clamp at which the string just reaches a tip at (x, y), m."""
        rise = np.sqrt(self.string_length**2 - (self.anchor_x - x) ** 2)
        return float(y + rise - self.anchor_height)


class TipForce(NamedTuple):
    """Force of a condition at the tip of n equilibria, and the residual of the condition.

    Parameters
    ----------
    force : shape (n, 2), N
    by_load, by_x : shape (n, 2), its derivatives by the load and by x of the tip
    gap : shape (n,), zero where the condition holds
    gap_by_tip : shape (n, 2), its derivative by the tip's position
    gap_by_load : its derivative by the load
    """

    force: Floats
    by_load: Floats
    by_x: Floats
    gap: Floats
    gap_by_tip: Floats
    gap_by_load: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TipCondition:
    """What fixes the tips of n equilibria: one of deflection, travel and dead force.

    Parameters
    ----------
    rig : string that pulls, with its counterweight; None for a force normal to the clamped axis
    deflection : shape (n,), m, of the tips; the string, if there is one, is taut
    travel : m, of the clamp: the string is taut
    dead_force : shape (2,), N; the load is unused and zero
    """

    rig: StringRig | None = None
    deflection: Floats | None = None
    travel: float = np.nan
    dead_force: Floats | None = None

    def pull(self, tip: Floats, load: Floats, rows: Ints) -> TipForce:
        """Compute the force at the tip, and the residual of the condition.

        Parameters
        ----------
        tip : shape (n, 2), m
        load : shape (n,), N
        rows : shape (n,), indices of these equilibria
        """
        x, y = tip.T
        zeros, ones = np.zeros_like(tip), np.ones_like(x)
        if self.dead_force is not None:
            return TipForce(zeros + self.dead_force, zeros, zeros, load, zeros, gap_by_load=1.0)
        lean, rise, by_x, weight, reach = 0.0 * ones, ones, zeros, 0.0, 0.0 * ones
        if self.rig is not None:
            weight, length = self.rig.weight, self.rig.string_length
            lean = (self.rig.anchor_x - x) / length
            rise = np.sqrt(1.0 - lean**2)
            by_x = (load / length)[:, None] * np.stack([-ones, lean / rise], axis=1)
            reach = length * rise - self.rig.anchor_height
        direction = np.stack([lean, rise], axis=1)
        force = load[:, None] * direction - np.array([0.0, weight])
        if self.deflection is not None:
            gap, gap_by_x = y - self.deflection[rows], 0.0 * ones
        else:
            gap, gap_by_x = y + reach - self.travel, lean / rise
        return TipForce(force, direction, by_x, gap, np.stack([gap_by_x, ones], axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class BentWire:
    """The wire bent by given moments; arrays of shape (n, stations).

    Parameters
    ----------
    stations : along the wire
    moment, curvature, slope : N m, 1/m, 1/(N m^2)
    load : shape (n,), N
    cos, sin : of the angle
    levers : shape (n, stations, 2), m, of forces along x and y at the tip
    tip : shape (n, 2), m
    weight_beyond : shape (stations,), N, weight beyond each station
    tip_force : of the condition at the tip
    """

    stations: Stations
    moment: Floats
    load: Floats
    curvature: Floats
    slope: Floats
    cos: Floats
    sin: Floats
    levers: Floats
    tip: Floats
    weight_beyond: Floats
    tip_force: TipForce

    @property
    def lateral(self) -> Floats:
        """Return the derivative of the force across the wire by its angle, N: the compression."""
        along, up = self.tip_force.force.T[..., None]
        return np.asarray((self.weight_beyond - up) * self.sin - along * self.cos)

    def find_residual(self) -> Floats:
        """Return the residuals of moments, N m, and of the condition, shape (n, stations + 1)."""
        bending = (self.levers @ self.tip_force.force[:, :, None])[:, :, 0]
        bending -= (self.weight_beyond * self.cos) @ self.stations.to_tip.T
        return np.column_stack([self.moment - bending, self.tip_force.gap])

    def find_jacobian(self) -> Floats:
        """Return the derivatives of the residual by moments and load.

        The shape is (n, stations + 1, stations + 1).
        """
        stations, pull, n = self.stations, self.tip_force, len(self.weight_beyond)
        turning = stations.from_clamp * self.slope[:, None, :]
        across = np.stack([-stations.weights * self.sin, stations.weights * self.cos], axis=1)
        tip_by_moment = across @ turning
        derivatives = np.empty((len(self.tip), n + 1, n + 1))
        derivatives[:, :n, :n] = -((stations.to_tip * self.lateral[:, None, :]) @ turning)
        if np.any(pull.by_x):
            derivatives[:, :n, :n] -= (self.levers @ pull.by_x[:, :, None]) * tip_by_moment[:, :1]
        derivatives[:, range(n), range(n)] += 1.0
        derivatives[:, :n, n] = -(self.levers @ pull.by_load[:, :, None])[:, :, 0]
        derivatives[:, n, :n] = (pull.gap_by_tip[:, None, :] @ tip_by_moment)[:, 0]
        derivatives[:, n, n] = pull.gap_by_load
        return derivatives

    def find_sensitivity(self, curvature_changes: Floats) -> Floats:
        """Return the derivatives of moments and load, shape (1 + parameters, n, stations + 1).

        First by the gap of the condition, then by each parameter.

        Parameters
        ----------
        curvature_changes : shape (parameters, n, stations), derivatives of the curvature at
            constant moment
        """
        stations, pull, n = self.stations, self.tip_force, len(self.weight_beyond)
        turn = curvature_changes @ stations.from_clamp.T
        tip_x, tip_y = ((turn * side) @ stations.weights for side in (-self.sin, self.cos))
        bending = (turn * self.lateral) @ stations.to_tip.T
        bending += (self.levers @ pull.by_x[:, :, None])[:, :, 0] * tip_x[:, :, None]
        missing = np.zeros((1 + len(curvature_changes), len(self.tip), n + 1))
        missing[0, :, n] = -1.0
        missing[1:, :, :n] = -bending
        missing[1:, :, n] = pull.gap_by_tip[:, 0] * tip_x + pull.gap_by_tip[:, 1] * tip_y
        solution = -np.linalg.solve(self.find_jacobian(), np.moveaxis(missing, 0, 2))
        return np.asarray(np.moveaxis(solution, 2, 0), dtype=np.float64)


BendingLaw: TypeAlias = Callable[[Floats, Ints], CurvatureAndSlope]
"""Moments of all equilibria, shape (n, stations), and rows -> curvature and slope of the rows."""


@dataclass(frozen=True, slots=True, eq=False)
class Cantilever:
    """A wire of which n equilibria are sought.

    Parameters
    ----------
    law : of the wire
    stations : along the length, m
    self_weight : N/m
    condition : at the tip
    coarse : the same wire with fewer stations, on which Newton's steps are computed; None for its
        own stations
    """

    law: BendingLaw
    stations: Stations
    self_weight: float
    condition: TipCondition
    coarse: Cantilever | None = None

    @property
    def weight_beyond(self) -> Floats:
        """Return the weight beyond each station, N."""
        position = self.stations.position
        return np.asarray(self.self_weight * (position[-1] - position))

    def bend(self, moment: Floats, load: Floats, rows: Ints | None = None) -> BentWire:
        """Bend the wire by given moments, and evaluate the condition.

        Parameters
        ----------
        moment, load : of all equilibria, shape (n, stations), N m, and (n,), N
        rows : which of them to bend; None for all
        """
        rows = np.arange(len(load)) if rows is None else rows
        stations = self.stations
        curvature, slope = self.law(moment, rows)
        angle = curvature @ stations.from_clamp.T
        cos, sin = np.cos(angle), np.sin(angle)
        levers = np.stack([-(sin @ stations.to_tip.T), cos @ stations.to_tip.T], axis=-1)
        tip = np.stack([cos @ stations.weights, sin @ stations.weights], axis=-1)
        tip_force = self.condition.pull(tip, load[rows], rows)
        bent = moment[rows], load[rows], curvature, slope
        return BentWire(stations, *bent, cos, sin, levers, tip, self.weight_beyond, tip_force)

    def solve(
        self, moment: Floats, load: Floats, *, tolerance: float, floor: float = 0.0
    ) -> tuple[Floats, Floats] | None:
        """Find the equilibria near a first guess by Newton's method, each with its own convergence.

        Parameters
        ----------
        moment, load : first guess, shape (n, stations), N m, and (n,), N
        tolerance : last change of the moments, as a share of the largest; convergence is quadratic.
            A hundredth of it with steps from coarse stations, whose convergence is linear
        floor : N m, added to the largest moment

        Returns
        -------
        Moments and loads in equilibrium; None if an iteration does not converge, or is not finite.
        """
        max_iterations = 15  # more have no end: Newton's method cycles at corners of a law
        max_turn = 0.7  # rad, of any part of the wire in one step
        tolerance *= 1.0 if self.coarse is None else 0.01
        moment, load = np.array(moment), np.array(load)
        unconverged, length = np.arange(len(load)), self.stations.position[-1]
        for _ in range(max_iterations):
            bent = self.bend(moment, load, unconverged)
            residual = bent.find_residual()
            if not np.isfinite(residual).all():
                return None
            step = self._find_step(bent, residual, moment, load, unconverged)
            turn = np.max(np.abs(step[:, :-1] * bent.slope), axis=1) * length
            step *= np.minimum(1.0, max_turn / np.maximum(turn, max_turn))[:, None]
            moment[unconverged] += step[:, :-1]
            load[unconverged] += step[:, -1]
            largest = np.max(np.abs(moment[unconverged]), axis=1) + floor
            unconverged = unconverged[np.max(np.abs(step[:, :-1]), axis=1) > tolerance * largest]
            if not unconverged.size:
                return moment, load
        return None

    def _find_step(
        self, bent: BentWire, residual: Floats, moment: Floats, load: Floats, rows: Ints
    ) -> Floats:
        """Return Newton's step of moments and load, from the coarse wire if there is one.

        The derivative of a residual is the identity less an integral operator, which smooths: only
        the smooth part of a step is computed on the coarse stations (two-grid iteration, Atkinson,
        The Numerical Solution of Integral Equations of the Second Kind, 1997, section 6.2).
        """
        if self.coarse is None:
            return np.asarray(-np.linalg.solve(bent.find_jacobian(), residual[:, :, None])[:, :, 0])
        counts = len(self.stations.position), len(self.coarse.stations.position)
        restrict, extend = make_transfer_matrix(*counts), make_transfer_matrix(*counts[::-1])
        known = np.column_stack([residual[:, :-1] @ restrict.T, residual[:, -1]])
        coarse = self.coarse.bend(moment @ restrict.T, load, rows)
        step = -np.linalg.solve(coarse.find_jacobian(), known[:, :, None])[:, :, 0]
        return np.column_stack([(step + known)[:, :-1] @ extend.T - residual[:, :-1], step[:, -1]])


@dataclass(frozen=True, slots=True, eq=False)
class WireState(ArrayRecord):
    """Moments and history of a wire, station by station.

    Parameters
    ----------
    moment : shape (stations,), N m
    curvature : shape (stations,), 1/m
    plays : shape (stations, plays), N m
    force : shape (2,), N, at the tip
    load : the unknown of the last solution, N: the string's tension or the end load; 0 under a dead
        force
    travel : position on the path: travel of the clamp, m; tip deflection, m; or share of a change
        of force
    self_weight : N/m, of the wire, along -y
    earlier : moments and load, shape (stations + 1,), and travel before the last step; None at
        the start of a path
    """

    moment: Annotated[Floats, "stations"]
    curvature: Annotated[Floats, "stations"]
    plays: Annotated[Floats, "stations", "plays"]
    force: Annotated[Floats, 2]
    load: float = 0.0
    travel: float = 0.0
    self_weight: float = 0.0
    earlier: tuple[Floats, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CantileverShape:
    """A wire in equilibrium; arrays are of shape (stations,) from the clamp to the tip.

    Parameters
    ----------
    arc_length, angle, x, y : m, rad, m, m
    state : start of the next step
    """

    arc_length: Floats
    angle: Floats
    x: Floats
    y: Floats
    state: WireState

    @property
    def curvature(self) -> Floats:
        """Return the curvatures, 1/m."""
        return self.state.curvature

    @property
    def moment(self) -> Floats:
        """Return the moments, N m."""
        return self.state.moment

    @property
    def force(self) -> Floats:
        """Return the whole force at the tip, N, shape (2,), such as of string and counterweight."""
        return self.state.force

    @property
    def tension(self) -> float:
        """Return the string's tension, N, 0 if it is slack; without a string, `WireState.load`."""
        return self.state.load


Step: TypeAlias = Callable[[WireState, float], WireState | None]


def make_straight(
    law: PlayLaw, n_stations: int = DEFAULT_STATIONS, *, self_weight: float = 0.0
) -> WireState:
    """Return the state of a straight wire that was never bent.

    Parameters
    ----------
    law : of the wire
    n_stations : along it
    self_weight : N/m, of the wire; acts from the first step on

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
    """Bend a wire by changing its end force linearly to another.

    Parameters
    ----------
    law, state : law and history of the wire
    length : m
    force : shape (2,), N, fixed in direction

    Raises
    ------
    ValueError
        If `length` is not positive, `force` is not finite, no equilibrium is found on the way, or
        the wire is bent beyond the range of its law (the message states the curvature).
    """
    start, target = state.force, np.asarray(force, dtype=np.float64)
    state = replace(state, travel=0.0, earlier=None)
    require_positive("length", length)
    require_finite("force", target)

    def step(present: WireState, share: float) -> WireState | None:
        condition = TipCondition(dead_force=start + share * (target - start))
        return _solve_next(law, present, length, condition, travel=share)

    place = f"force={target.tolist()}"
    return _within_law(law, _step_to(step, state, 1.0, place), length, place)


def bend_to_deflection(
    law: PlayLaw, state: WireState, length: float, deflection: float
) -> CantileverShape:
    """Bend a wire by an end force normal to the clamped axis until its tip is at `deflection`.

    Parameters
    ----------
    law, state : law and history of the wire; `state.travel` is its present deflection
    length, deflection : m

    Returns
    -------
    The shape; ``force[1]`` is the end load.

    Raises
    ------
    ValueError
        If `length` is not positive, `deflection` is not finite, no equilibrium is found on the way,
        as for a deflection that exceeds the length, or the wire is bent beyond the range of its law
        (the message states the curvature).
    """
    require_positive("length", length)
    require_finite("deflection", deflection)
    reached = deflect(law, state, length, deflection)
    return _within_law(law, reached, length, f"deflection={deflection!r}")


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
    law, state, length, deflection : as for `bend_to_deflection`
    rig : string that pulls; None for a force normal to the clamped axis

    Raises
    ------
    ValueError
        If no equilibrium is found on the way.
    """

    def step(present: WireState, travel: float) -> WireState | None:
        condition = TipCondition(rig, deflection=np.array([travel]))
        return _solve_next(law, present, length, condition, travel=travel)

    return _step_to(step, state, deflection, f"deflection={deflection!r}")


def bend_to_travel(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, travel: float
) -> CantileverShape:
    """Bend a wire on the string by moving its clamp to `travel`.

    Parameters
    ----------
    law, state : law and history of the wire; `state.travel` is the present travel
    length : m
    rig : the string
    travel : m, from the initial height of the clamp, positive downwards

    Returns
    -------
    The shape; its tension is zero where the string is slack.

    Raises
    ------
    ValueError
        If `length` is not positive, `travel` is not finite, no equilibrium is found on the way, or
        the wire is bent beyond the range of its law (the message states the curvature).
    """
    slack_tolerance = 1e-12  # m: a string that is just straight counts as slack

    def taut(present: WireState, travel: float) -> WireState | None:
        condition = TipCondition(rig, travel=travel)
        solution = _solve_next(law, present, length, condition, travel=travel)
        return solution if solution is not None and solution.load >= 0.0 else None

    def slack(present: WireState, travel: float) -> WireState | None:
        weight = TipCondition(dead_force=np.array([0.0, -rig.weight]))
        solution = _solve_next(law, present, length, weight, travel=travel)
        if solution is None:
            return None
        tip = compute_shape(solution, length)
        if rig.travel_to_taut_string(float(tip.x[-1]), float(tip.y[-1])) < travel - slack_tolerance:
            return None
        # exactly zero, without rounding
        return replace(solution, load=0.0)

    def step(present: WireState, travel: float) -> WireState | None:
        first, second = (taut, slack) if present.load > 0.0 else (slack, taut)
        solution = first(present, travel)
        return second(present, travel) if solution is None else solution

    require_positive("length", length)
    require_finite("travel", travel)
    place = f"travel={travel!r}"
    return _within_law(law, _step_to(step, state, travel, place), length, place)


def _within_law(law: PlayLaw, state: WireState, length: float, place: str) -> CantileverShape:
    require_within(law, state.moment, place)
    return compute_shape(state, length)


def compute_shape(state: WireState, length: float) -> CantileverShape:
    """Compute the shape of a state in equilibrium."""
    stations = make_stations(len(state.moment), length)
    return CantileverShape(stations.position, *stations.bend(state.curvature), state)


def _solve_next(
    law: PlayLaw, state: WireState, length: float, condition: TipCondition, *, travel: float
) -> WireState | None:
    """Find the next equilibrium; None if Newton's method fails or ends far away (a curl)."""
    max_turn = 1.0  # rad, of any part of the wire in one step
    tolerance = 1e-7  # last change of the moments; convergence is quadratic
    max_share = 4.0  # of the last step, up to which it is continued
    floor = 1e-9 * law.stiffness / length  # of the moment that bends the wire by a radian
    stations = make_stations(len(state.moment), length)
    responses: list[Response] = []

    def respond(moment: Floats, _: Ints) -> CurvatureAndSlope:
        responses.append(law.respond(moment[0], state.plays))
        return responses[-1].curvature[None], responses[-1].compliance[None]

    wire = Cantilever(respond, stations, state.self_weight, condition)
    last = np.append(state.moment, state.load), state.travel
    (unknowns, start), (earlier, before) = last, state.earlier or (last[0], -np.inf)
    share = (travel - start) / ((start - before) or np.inf)
    share = share if 0.0 < share <= max_share else 0.0  # a reversed path is not extrapolated
    guess = unknowns + share * (unknowns - earlier)
    solution = wire.solve(guess[None, :-1], guess[-1:], tolerance=tolerance, floor=floor)
    if solution is None:
        return None
    bent = wire.bend(*solution)
    turn = stations.from_clamp @ (bent.curvature[0] - state.curvature)
    if np.max(np.abs(turn)) > max_turn:
        return None
    present = bent.moment[0], bent.curvature[0], responses[-1].plays, bent.tip_force.force[0]
    return WireState(*present, bent.load.item(), travel, state.self_weight, last)


def _step_to(step: Step, state: WireState, target: float, context: str) -> WireState:
    """Advance the state to the target travel; halve a step that fails, double it after a success.

    Raises
    ------
    ValueError
        If a step of at most 1/4096 of the distance fails.
    """
    min_step_share = 2.0**-12
    start, distance = state.travel, target - state.travel
    step_share, done_share = 1.0, 0.0
    while done_share < 1.0:
        next_share = min(1.0, done_share + step_share)
        next_state = step(state, target if next_share == 1.0 else start + next_share * distance)
        if next_state is not None:
            state, done_share, step_share = next_state, next_share, min(1.0, 2.0 * step_share)
        elif step_share <= min_step_share:
            message = f"{context}: no equilibrium beyond {start + done_share * distance:.6g}"
            raise ValueError(message)
        else:
            step_share *= 0.5
    return state
