"""First loading of a clamped wire with weight, all points at once (PHYSICS 8).

At rest the wire is level, its tip held by the string or by an end load; from there it is loaded.
With the weight w per length dM/ds depends on s, and there is no first integral
(`wire.first_loading`); here Newton's method solves for the moments at Chebyshev-Lobatto stations of
all wanted deflections together. The law is one of first loading; where the weight bent the wire the
other way, it returns by Masing's rule. `wire.cantilever` follows the same path step by step with a
history at each station, and also unloading, cycles and a slack string.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.law.loading_table import LoadingTable
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import LoadingCurve
from labpipe.wire.newton import Stations, chebyshev_stations

N_STATIONS = 24
"""Along the wire: forces are within 3e-4 of those of 160 stations, 6e-5 on average."""
N_LOADING_POINTS = 32
"""Of a loading curve."""


@dataclass(frozen=True, slots=True, eq=False)
class HeavyStates:
    """A wire at rest and at deflections of its first loading.

    Parameters
    ----------
    rest : shape (stations,), N m, moments at rest
    rest_tension : N
    deflection : shape (n,), m
    moment : shape (n, stations), N m
    tension : shape (n,), N
    across : shape (n,), N, force across the wire at its tip; where it falls, so do the moments
        near the tip
    x, tip_angle : shape (n,), m, rad
    curvature : shape (n,), 1/m, at the clamp
    tension_change : shape (1 + parameters, n), derivative of tension less that at rest by the
        deflection, N/m, and by each of the law's parameters, N; shape (0, n) if not computed
    """

    rest: Floats
    rest_tension: float
    deflection: Floats
    moment: Floats
    tension: Floats
    across: Floats
    x: Floats
    tip_angle: Floats
    curvature: Floats
    tension_change: Floats

    def count_loading(self) -> int:
        """Count the deflections, from rest on, up to which no part of the wire unloads.

        Beyond about 0.7 of the length the moments near the tip fall; those of a sagging wire
        may fall earlier.
        """
        rounding_share = 1e-5  # of the largest moment
        before = np.vstack([self.rest, self.moment[:-1]])
        step, way = self.moment - before, before - self.rest
        small = rounding_share * np.max(np.abs(self.moment), axis=1, keepdims=True)
        turns = ((step * way < 0.0) & (np.abs(step) > small)).any(axis=1)
        turns[1:] |= np.diff(self.across) <= 0.0
        return int(np.argmax(turns)) if turns.any() else len(turns)


@dataclass(frozen=True, slots=True, eq=False)
class _Wire:
    """The law, the stations along the length, the weight beyond each, and the rig."""

    table: LoadingTable
    stations: Stations
    beyond: Floats
    rig: StringRig | None


@dataclass(frozen=True, slots=True, eq=False)
class _Bent:
    """The wire bent by given moments, and the pull; arrays of shape (n, stations), or (n,).

    Parameters
    ----------
    curvature, slope : 1/m, 1/(N m^2)
    cos, sin : of the angle
    lever_x, lever_y : m, of forces along x and y at the tip
    pull : shape (2, n), N, at the tip
    by_tension : shape (2, n), derivative of the pull by the tension
    by_x : shape (2, n), N/m, its derivative by the tip's position
    x, y : m, of the tip
    """

    curvature: Floats
    slope: Floats
    cos: Floats
    sin: Floats
    lever_x: Floats
    lever_y: Floats
    pull: Floats
    by_tension: Floats
    by_x: Floats
    x: Floats
    y: Floats

    def lateral(self, beyond: Floats) -> Floats:
        """Return the derivative of the moments by a turn of the wire, N: the force along it."""
        along, up = self.pull[..., None]
        return np.asarray((beyond - up) * self.sin - along * self.cos)

    @property
    def across(self) -> Floats:
        """Return the force across the wire at its tip, N."""
        return np.asarray(self.pull[1] * self.cos[:, -1] - self.pull[0] * self.sin[:, -1])


def load_heavy(
    table: LoadingTable, length: float, rig: StringRig | None, self_weight: float, deflection: float
) -> LoadingCurve:
    """Load a wire with weight from rest to a deflection.

    Parameters
    ----------
    table : law of first loading, with its derivatives by parameters
    length : m
    rig : string and counterweight; the string just reaches the straight wire. None for an end
        load normal to the clamped axis that holds the tip level at rest
    self_weight : N/m
    deflection : m, of the tip from rest

    Returns
    -------
    The curve: rest, then `N_LOADING_POINTS` points up to the deflection, or until a part of the
    wire unloads. Its derivatives by parameters are those of the force above that at rest.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    crowding = 2.75  # power by which they are denser towards rest, where strands begin to slip
    wanted = deflection * (np.arange(1, N_LOADING_POINTS + 1) / N_LOADING_POINTS) ** crowding
    states = heavy_states(table, length, rig, self_weight, wanted)
    stop = states.count_loading()
    rise = states.tension[0] - states.rest_tension
    rest_slope = float(rise / states.deflection[0])  # before slip

    def from_rest(rest: float, values: Floats) -> Floats:
        return np.concatenate([[rest], values[:stop]])

    bent, _ = table.bend(states.rest)
    change = states.tension_change[1:, :stop]
    return LoadingCurve(
        deflection=from_rest(0.0, states.deflection),
        tension=from_rest(states.rest_tension, states.tension),
        x=from_rest(length, states.x),
        tip_angle=from_rest(0.0, states.tip_angle),
        clamp_curvature=from_rest(float(bent[0]), states.curvature),
        clamp_moment=from_rest(float(states.rest[0]), states.moment[:, 0]),
        stiffness=from_rest(rest_slope, states.tension_change[0]),
        tension_change=np.hstack([np.zeros((len(change), 1)), change]),
    )


def heavy_states(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflections: Floats,
    *,
    n_stations: int = N_STATIONS,
    with_changes: bool = True,
) -> HeavyStates:
    """Find the equilibria of a wire with weight at rest and at given deflections.

    Parameters
    ----------
    table, length, rig, self_weight : as for `load_heavy`
    deflections : shape (n,), m, from rest, in the direction of the pull, increasing
    n_stations : along the wire
    with_changes : whether to compute `tension_change`

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    unit = chebyshev_stations(n_stations)
    stations = Stations(*(length * part for part in (unit.position, unit.from_clamp, unit.to_tip)))
    from_tip = length - stations.position
    wire = _Wire(table, stations, self_weight * from_tip, rig)
    tip_force = 0.375 * self_weight * length
    weight = 0.0 if rig is None else rig.weight
    start = (tip_force - 0.5 * wire.beyond) * from_tip
    level = np.zeros(1)
    first = _solve(wire, None, (start[None], np.array([tip_force + weight])), level)
    rest, tension = first[0][0], float(first[1][0])
    clamp = _clamp_moments(table, length, deflections)
    guess = rest + clamp[:, None] * from_tip / length, tension + clamp / length
    moment, tensions = _solve_all(wire, (rest, tension), guess, deflections)
    bent = _bend(wire, rest, moment, tensions)
    tension_change = np.zeros((0, len(deflections)))
    if with_changes:
        rest_change = _sensitivity(wire, _bend(wire, None, *first), table.changes(first[0]))
        curvature_changes = table.changes_on(rest, moment, rest_change[1:, 0, :-1])
        tension_change = _sensitivity(wire, bent, curvature_changes)[:, :, -1]
        tension_change[1:] -= rest_change[1:, :, -1]
    angle = np.arctan2(bent.sin[:, -1], bent.cos[:, -1])
    return HeavyStates(
        *(rest, tension, deflections, moment, tensions, bent.across, bent.x, angle),
        curvature=bent.curvature[:, 0],
        tension_change=tension_change,
    )


def _clamp_moments(table: LoadingTable, length: float, deflections: Floats) -> Floats:
    """Estimate the clamp moments at deflections, N m, for a curvature that falls linearly."""
    share = np.minimum(deflections / length, 0.9)
    bent = 3.0 * share / (1.0 - share**2) / length
    return np.interp(bent, table.curvature, table.moment)


def _bend(wire: _Wire, rest: Floats | None, moment: Floats, tension: Floats) -> _Bent:
    table, stations, rig = wire.table, wire.stations, wire.rig
    curvature, slope = table.bend(moment) if rest is None else table.bend_on(rest, moment)
    angle = curvature @ stations.from_clamp.T
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = cos @ stations.weights, sin @ stations.weights
    if rig is None:
        none, one = np.zeros_like(tension), np.ones_like(tension)
        pull, by_tension, by_x = [none, tension], [none, one], [none, none]
    else:
        lean = (rig.anchor_x - x) / rig.string_length
        rise = np.sqrt(1.0 - lean**2)
        per_length = tension / rig.string_length
        pull, by_tension = [tension * lean, tension * rise - rig.weight], [lean, rise]
        by_x = [-per_length, per_length * lean / rise]
    return _Bent(
        *(curvature, slope, cos, sin),
        lever_x=-(sin @ stations.to_tip.T),
        lever_y=cos @ stations.to_tip.T,
        pull=np.stack(pull),
        by_tension=np.stack(by_tension),
        by_x=np.stack(by_x),
        x=x,
        y=y,
    )


def _solve_all(
    wire: _Wire, rest: tuple[Floats, float], start: tuple[Floats, Floats], deflections: Floats
) -> tuple[Floats, Floats]:
    """Solve for moments and tensions, first at some deflections, then between them."""
    min_deflections = 60  # for fewer, solving every fourth first costs more
    stride = 4
    if len(deflections) < min_deflections:
        return _solve(wire, rest[0], start, deflections)
    coarse = np.append(np.arange(0, len(deflections) - 1, stride), len(deflections) - 1)
    solved = _solve(wire, rest[0], (start[0][coarse], start[1][coarse]), deflections[coarse])
    solved_columns = np.column_stack(solved)
    fine = np.setdiff1d(np.arange(len(deflections)), coarse)
    spline = CubicSpline(
        np.append(0.0, deflections[coarse]), np.vstack([np.append(*rest), solved_columns]), axis=0
    )
    guess = spline(deflections[fine])
    moment, tension = np.empty_like(start[0]), np.empty_like(start[1])
    moment[coarse], tension[coarse] = solved
    moment[fine], tension[fine] = _solve(
        wire, rest[0], (guess[:, :-1], guess[:, -1]), deflections[fine]
    )
    return moment, tension


def _solve(
    wire: _Wire, rest: Floats | None, start: tuple[Floats, Floats], deflections: Floats
) -> tuple[Floats, Floats]:
    """Solve for moments and tensions by Newton's method; the tip's height fixes the tension.

    Each deflection converges on its own.
    """
    moment_tolerance = 1e-5  # of the largest moment; the next change would be 1e-9
    max_iterations = 40
    max_turn = 0.7  # rad, of any part of the wire in one step of Newton's method
    moment, tension = (np.array(part) for part in start)
    active = np.arange(len(moment))
    to_tip, length = wire.stations.to_tip, wire.stations.position[-1]
    for _ in range(max_iterations):
        bent = _bend(wire, rest, moment[active], tension[active])
        bending = bent.lever_x * bent.pull[0][:, None] + bent.lever_y * bent.pull[1][:, None]
        bending -= (wire.beyond * bent.cos) @ to_tip.T
        missing = np.column_stack([moment[active] - bending, bent.y - deflections[active]])
        if not np.isfinite(missing).all():
            break
        step = -np.linalg.solve(_jacobian(wire, bent), missing[:, :, None])[:, :, 0]
        turn = np.max(np.abs(step[:, :-1] * bent.slope), axis=1) * length
        step *= np.minimum(1.0, max_turn / np.maximum(turn, max_turn))[:, None]
        moment[active] += step[:, :-1]
        tension[active] += step[:, -1]
        largest = np.max(np.abs(moment[active]), axis=1)
        active = active[np.max(np.abs(step[:, :-1]), axis=1) > moment_tolerance * largest]
        if not active.size:
            return moment, tension
    where = "at rest" if rest is None else f"up to a deflection of {deflections[-1]:.6g} m"
    message = f"length={length:.6g} m: no equilibrium found {where}"
    raise ValueError(message)


def _jacobian(wire: _Wire, bent: _Bent) -> Floats:
    """Return the derivatives of the residuals by moments and tension."""
    from_clamp, to_tip = wire.stations.from_clamp, wire.stations.to_tip
    weights, n = wire.stations.weights, len(wire.beyond)
    turning = from_clamp * bent.slope[:, None, :]
    x_by = -((weights * bent.sin)[:, None, :] @ turning)[:, 0]
    y_by = ((weights * bent.cos)[:, None, :] @ turning)[:, 0]
    jacobian = np.zeros((len(bent.x), n + 1, n + 1))
    jacobian[:, :n, :n] = -((to_tip * bent.lateral(wire.beyond)[:, None, :]) @ turning)
    if wire.rig is not None:
        leans = bent.lever_x * bent.by_x[0][:, None] + bent.lever_y * bent.by_x[1][:, None]
        jacobian[:, :n, :n] -= leans[:, :, None] * x_by[:, None, :]
    diagonal = np.arange(n)
    jacobian[:, diagonal, diagonal] += 1.0
    by_x, by_y = bent.by_tension[:, :, None]
    jacobian[:, :n, n] = -(bent.lever_x * by_x + bent.lever_y * by_y)
    jacobian[:, n, :n] = y_by
    return jacobian


def _sensitivity(wire: _Wire, bent: _Bent, curvature_changes: Floats) -> Floats:
    """Return the derivatives of moments and tension, shape (1 + parameters, n, stations + 1).

    First by the deflection, then by each parameter, `curvature_changes` are the derivatives of the
    curvature at constant moment, shape (parameters, n, stations).
    """
    stations, n = wire.stations, len(wire.beyond)
    turn = curvature_changes @ stations.from_clamp.T
    x = -(turn * bent.sin) @ stations.weights
    leans = bent.lever_x * bent.by_x[0][:, None] + bent.lever_y * bent.by_x[1][:, None]
    bending = (turn * bent.lateral(wire.beyond)) @ stations.to_tip.T + leans * x[..., None]
    missing = np.zeros((1 + len(curvature_changes), len(bent.x), n + 1))
    missing[0, :, n] = -1.0
    missing[1:, :, :n] = -bending
    missing[1:, :, n] = (turn * bent.cos) @ stations.weights
    columns = np.moveaxis(missing, 0, 2)
    sensitivity = -np.linalg.solve(_jacobian(wire, bent), columns)
    return np.asarray(np.moveaxis(sensitivity, 2, 0), dtype=np.float64)
