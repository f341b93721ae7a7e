"""The first loading of a clamped wire that has weight, all points at once (PHYSICS 8).

The wire lies level, its tip held by the string or by an end load: rest, from which it is loaded.
With the weight w per length dM/ds depends on s, and there is no first integral
(`wire.first_loading`); here Newton's method solves for the moments at Chebyshev-Lobatto stations of
all wanted deflections together. The law is one of first loading; where the weight had bent the wire
the other way, it goes back by Masing's rule. `wire.cantilever` goes the same way step by step with
a history of its own, and further: unloading, cycles, a string that is slack.
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
"""Along the wire: forces are within 3e-4 of those of 160 stations, 6e-5 on the average."""
POINTS, CROWDING = 32, 2.75
"""Of a loading curve, and how they are crowded towards rest, where strands begin to slip."""
_ITERATIONS = 40
_TOLERANCE = 1e-5  # of the largest moment, the last change: the next would be 1e-9
_TURNS = 1e-5  # of the largest moment: less is rounding
_MANY, _STRIDE = 60, 4
"""From so many deflections on every fourth goes first: for fewer the second round costs more."""
_LARGEST_TURN = 0.7  # rad, of any part of the wire in one step of Newton's method


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
    across : shape (n,), N, force across the wire at its tip: where it falls, the moments near the
        tip fall, too
    x, tip_angle : shape (n,), m, rad
    curvature : shape (n,), 1/m, at the clamp
    tension_change : shape (1 + parameters, n), derivative of tension less that at rest by the
        deflection, N/m, and by each of the law's parameters, N; shape (0, n) if not asked for
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
        """Number of deflections, from rest on, up to which no part of the wire turns back.

        Beyond about 0.7 of the length the moments near the tip fall; those of a limp wire that
        sags may do so before.
        """
        before = np.vstack([self.rest, self.moment[:-1]])
        step, way = self.moment - before, before - self.rest
        small = _TURNS * np.max(np.abs(self.moment), axis=1, keepdims=True)
        turns = ((step * way < 0.0) & (np.abs(step) > small)).any(axis=1)
        turns[1:] |= np.diff(self.across) <= 0.0
        return int(np.argmax(turns)) if turns.any() else len(turns)


@dataclass(frozen=True, slots=True, eq=False)
class _Wire:
    """What is loaded: the law, the stations of its length, the weight beyond each, and the rig."""

    table: LoadingTable
    stations: Stations
    beyond: Floats
    rig: StringRig | None


@dataclass(frozen=True, slots=True, eq=False)
class _Bent:
    """The wire as moments bend it, and what pulls; arrays of shape (n, stations), or (n,).

    Parameters
    ----------
    curvature, slope : 1/m, 1/(N m^2)
    cos, sin : of the angle
    lever_x, lever_y : m, of forces along x and y at the tip
    pull : shape (2, n), N, at the tip
    by_tension : shape (2, n), derivative of the pull by the tension
    by_x : shape (2, n), N/m, its derivative by the tip's place
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
        """How a turn of the wire changes the moments, N: force along it, towards the clamp."""
        along, up = self.pull[..., None]
        return np.asarray((beyond - up) * self.sin - along * self.cos)

    @property
    def across(self) -> Floats:
        """Force across the wire at its tip, N."""
        return np.asarray(self.pull[1] * self.cos[:, -1] - self.pull[0] * self.sin[:, -1])


def load_heavy(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflection: float,
) -> LoadingCurve:
    """Load a wire that has weight from its rest to a deflection.

    Parameters
    ----------
    table : law of first loading, with its derivatives by parameters
    length : m
    rig : string and counterweight; the string just spans to the straight wire. None for an end load
        normal to the clamped axis that holds the tip level at rest
    self_weight : N/m
    deflection : m, of the tip from its place at rest

    Returns
    -------
    The curve: rest, then `POINTS` points up to the deflection, or until a part of the wire turns
    back, where this is no longer a first loading. Its derivatives by parameters
    are those of the force above that at rest.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    wanted = deflection * (np.arange(1, POINTS + 1) / POINTS) ** CROWDING
    at = heavy_states(table, length, rig, self_weight, wanted)
    stop = at.count_loading()
    at_rest = _rest_slope(at)

    def from_rest(rest: float, values: Floats) -> Floats:
        return np.concatenate([[rest], values[:stop]])

    bent, _ = table.bend(at.rest)
    change = at.tension_change[1:, :stop]
    return LoadingCurve(
        deflection=from_rest(0.0, at.deflection),
        tension=from_rest(at.rest_tension, at.tension),
        x=from_rest(length, at.x),
        tip_angle=from_rest(0.0, at.tip_angle),
        clamp_curvature=from_rest(float(bent[0]), at.curvature),
        clamp_moment=from_rest(float(at.rest[0]), at.moment[:, 0]),
        stiffness=from_rest(at_rest, at.tension_change[0]),
        tension_change=np.hstack([np.zeros((len(change), 1)), change]),
    )


def _rest_slope(at: HeavyStates) -> float:
    """Slope of tension against deflection at rest, N/m: where nothing slips yet, that so far."""
    return float((at.tension[0] - at.rest_tension) / at.deflection[0])


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
    """Find the equilibria of a wire that has weight at rest and at given deflections.

    Parameters
    ----------
    table, length, rig, self_weight : as for `load_heavy`
    deflections : shape (n,), m, from rest, in the way of the pull, increasing; all are gone to
        without a turn
    n_stations : along the wire
    with_changes : whether to work out `tension_change`

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    unit = chebyshev_stations(n_stations)
    stations = Stations(*(length * part for part in (unit.position, unit.from_clamp, unit.to_tip)))
    from_tip = length - stations.position
    wire = _Wire(table, stations, self_weight * from_tip, rig)
    held = 0.375 * self_weight * length
    weight = 0.0 if rig is None else rig.weight
    start = (held - 0.5 * wire.beyond) * from_tip
    level = np.zeros(1)
    first = _settle(wire, None, (start[None], np.array([held + weight])), level)
    rest, tension = first[0][0], float(first[1][0])
    clamp = _clamp_moments(table, length, deflections)
    guess = rest + clamp[:, None] * from_tip / length, tension + clamp / length
    moment, pulled = _settle_all(wire, (rest, tension), guess, deflections)
    bent = _bend(wire, rest, moment, pulled)
    change = np.zeros((0, len(deflections)))
    if with_changes:
        rest_change = _sensitivity(wire, _bend(wire, None, *first), table.changes(first[0]))
        own = table.changes_on(rest, moment, rest_change[1:, 0, :-1])
        change = _sensitivity(wire, bent, own)[:, :, -1]
        change[1:] -= rest_change[1:, :, -1]
    angle = np.arctan2(bent.sin[:, -1], bent.cos[:, -1])
    return HeavyStates(
        *(rest, tension, deflections, moment, pulled, bent.across, bent.x, angle),
        curvature=bent.curvature[:, 0],
        tension_change=change,
    )


def _clamp_moments(table: LoadingTable, length: float, deflections: Floats) -> Floats:
    """Moments at the clamp at deflections, N m, about: of a wire that tapers in curvature."""
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


def _settle_all(
    wire: _Wire, rest: tuple[Floats, float], start: tuple[Floats, Floats], deflections: Floats
) -> tuple[Floats, Floats]:
    """Moments and tensions at many deflections: some first, which guide to those between them."""
    if len(deflections) < _MANY:
        return _settle(wire, rest[0], start, deflections)
    some = np.append(np.arange(0, len(deflections) - 1, _STRIDE), len(deflections) - 1)
    found = _settle(wire, rest[0], (start[0][some], start[1][some]), deflections[some])
    known = np.column_stack(found)
    between = np.setdiff1d(np.arange(len(deflections)), some)
    way = CubicSpline(
        np.append(0.0, deflections[some]), np.vstack([np.append(*rest), known]), axis=0
    )
    guess = way(deflections[between])
    moment, tension = np.empty_like(start[0]), np.empty_like(start[1])
    moment[some], tension[some] = found
    moment[between], tension[between] = _settle(
        wire, rest[0], (guess[:, :-1], guess[:, -1]), deflections[between]
    )
    return moment, tension


def _settle(
    wire: _Wire, rest: Floats | None, start: tuple[Floats, Floats], deflections: Floats
) -> tuple[Floats, Floats]:
    """Newton's method for moments and tensions; the tip's height fixes the tension.

    Each deflection is done when its own last step was small.
    """
    moment, tension = (np.array(part) for part in start)
    left = np.arange(len(moment))
    to_tip, length = wire.stations.to_tip, wire.stations.position[-1]
    for _ in range(_ITERATIONS):
        bent = _bend(wire, rest, moment[left], tension[left])
        bending = bent.lever_x * bent.pull[0][:, None] + bent.lever_y * bent.pull[1][:, None]
        bending -= (wire.beyond * bent.cos) @ to_tip.T
        missing = np.column_stack([moment[left] - bending, bent.y - deflections[left]])
        if not np.isfinite(missing).all():
            break
        step = -np.linalg.solve(_jacobian(wire, bent), missing[:, :, None])[:, :, 0]
        turn = np.max(np.abs(step[:, :-1] * bent.slope), axis=1) * length
        step *= np.minimum(1.0, _LARGEST_TURN / np.maximum(turn, _LARGEST_TURN))[:, None]
        moment[left] += step[:, :-1]
        tension[left] += step[:, -1]
        largest = np.max(np.abs(moment[left]), axis=1)
        left = left[np.max(np.abs(step[:, :-1]), axis=1) > _TOLERANCE * largest]
        if not left.size:
            return moment, tension
    where = "at rest" if rest is None else f"up to a deflection of {deflections[-1]:.6g} m"
    message = f"length={length:.6g} m: no equilibrium found {where}"
    raise ValueError(message)


def _jacobian(wire: _Wire, bent: _Bent) -> Floats:
    """Derivatives of what is missing by moments and tension, shape (n, stations + 1, ...)."""
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
    at = np.arange(n)
    jacobian[:, at, at] += 1.0
    jacobian[:, :n, n] = -_pulled(bent)
    jacobian[:, n, :n] = y_by
    return jacobian


def _pulled(bent: _Bent) -> Floats:
    """Derivative of the moments by the tension, m, shape (n, stations)."""
    by = bent.by_tension
    return np.asarray(bent.lever_x * by[0][:, None] + bent.lever_y * by[1][:, None])


def _sensitivity(wire: _Wire, bent: _Bent, own: Floats) -> Floats:
    """Derivatives of moments and tension, shape (1 + parameters, n, stations + 1).

    First by the deflection, then by each parameter, of which `own` are the derivatives of the
    curvature at constant moment, shape (parameters, n, stations).
    """
    stations, n = wire.stations, len(wire.beyond)
    turn = own @ stations.from_clamp.T
    x = -(turn * bent.sin) @ stations.weights
    leans = bent.lever_x * bent.by_x[0][:, None] + bent.lever_y * bent.by_x[1][:, None]
    bending = (turn * bent.lateral(wire.beyond)) @ stations.to_tip.T + leans * x[..., None]
    missing = np.zeros((1 + len(own), len(bent.x), n + 1))
    missing[0, :, n] = -1.0
    missing[1:, :, :n] = -bending
    missing[1:, :, n] = (turn * bent.cos) @ stations.weights
    columns = np.moveaxis(missing, 0, 2)
    found = -np.linalg.solve(_jacobian(wire, bent), columns)
    return np.asarray(np.moveaxis(found, 2, 0), dtype=np.float64)
