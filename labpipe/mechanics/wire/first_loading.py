"""First loading of a clamped wire, with or without weight, all points at once (PHYSICS 5, 8).

At rest the wire is level, its tip held by the string or by an end load; from there it is loaded.
Without weight `wire.first_integral` gives every deflection; with weight Newton's method solves for
the moments at Chebyshev-Lobatto stations of all wanted deflections together. The law is one of
first loading; where the weight bent the wire the other way, it returns by Masing's rule.
`wire.cantilever` follows the same path step by step with a history at each station, and also
unloading, cycles and a slack string.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from labpipe.mechanics.law.plays import LoadingTable
from labpipe.mechanics.wire.cantilever import AtDeflection, StringRig
from labpipe.mechanics.wire.first_integral import solve_weightless
from labpipe.mechanics.wire.newton import Wire, bend_wire, compute_sensitivity, make_stations, solve
from labpipe.records.arrays import ArrayRecord, Floats, Vector

N_LOADING_STATIONS = 24
"""Along a wire with weight: forces are within 3e-4 of those of 160 stations, 6e-5 on average."""
MOMENT_TOLERANCE = 1e-5
"""Last change of the moments, as a share of the largest; the next would be 1e-9."""
END_OF_FIRST_LOADING = 0.7
"""Deflection over length at which parts near the tip begin to unload, about."""


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
    states : along the wire, from which a similar law is solved faster
    """

    deflection: Vector
    tension: Vector
    x: Vector
    tip_angle: Vector
    clamp_curvature: Vector
    clamp_moment: Vector
    stiffness: Vector
    tension_change: Annotated[Floats, "parameters", "n"]
    states: LoadingStates | None = None

    @property
    def force(self) -> Floats:
        """Return the tension above that at rest, N, as a zeroed load cell reads it."""
        return np.asarray(self.tension - self.tension[0])


@dataclass(frozen=True, slots=True, eq=False)
class LoadingStates:
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
        deflection, N/m, and by each of the law's parameters, N
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


def load_cantilever(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflection: float,
    *,
    near: LoadingStates | None = None,
) -> LoadingCurve:
    """Load a wire from rest to a deflection.

    Parameters
    ----------
    table : law of first loading, with its derivatives by parameters
    length : m
    rig : string and counterweight; the string just reaches the straight wire. None for an end
        load normal to the clamped axis that holds the tip level at rest
    self_weight : N/m, may be 0
    deflection : m, of the tip from rest
    near : of a similar law, otherwise the same, to start from

    Returns
    -------
    The curve: rest, then points up to the deflection, or until a part of the
    wire unloads. Its derivatives by parameters are those of the force above that at rest.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    n_points = 32 if self_weight > 0.0 else 44
    crowding = 2.75  # power by which they are denser towards rest, where strands begin to slip
    farthest = min(deflection, END_OF_FIRST_LOADING * length)
    deflections = farthest * (np.arange(1, n_points + 1) / n_points) ** crowding
    states = find_loading_states(table, length, rig, self_weight, deflections, near=near)
    stop = states.count_loading()
    rise = states.tension[0] - states.rest_tension
    rest_slope = float(rise / states.deflection[0])  # before slip

    def from_rest(rest: float, values: Floats) -> Floats:
        return np.concatenate([[rest], values[:stop]])

    rest_curvature, _ = table.bend(states.rest)
    change = states.tension_change[1:, :stop]
    return LoadingCurve(
        deflection=from_rest(0.0, states.deflection),
        tension=from_rest(states.rest_tension, states.tension),
        x=from_rest(length, states.x),
        tip_angle=from_rest(0.0, states.tip_angle),
        clamp_curvature=from_rest(float(rest_curvature[0]), states.curvature),
        clamp_moment=from_rest(float(states.rest[0]), states.moment[:, 0]),
        stiffness=from_rest(rest_slope, states.tension_change[0]),
        tension_change=np.hstack([np.zeros((len(change), 1)), change]),
        states=states,
    )


def find_loading_states(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflections: Floats,
    *,
    n_stations: int | None = None,
    near: LoadingStates | None = None,
) -> LoadingStates:
    """Find the equilibria of a wire at rest and at given deflections.

    Parameters
    ----------
    table, length, rig, self_weight, near : as for `load_cantilever`
    deflections : shape (n,), m, from rest, in the direction of the pull, increasing
    n_stations : along the wire. None for 24 with weight and for the first integral without, where
        the only moments are those at the clamp

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    at_rest, at = AtDeflection(np.zeros(1), rig), AtDeflection(deflections, rig)
    if n_stations is None and self_weight == 0.0 and len(deflections):
        states = _weightless_states(table, length, at, near)
        if states is not None:
            return states
        near = None
    stations = make_stations(n_stations or N_LOADING_STATIONS, length)
    from_tip = length - stations.position
    tip_force = 0.375 * self_weight * length
    level = Wire(table.bend, stations, self_weight, at_rest)
    begin = tip_force + (0.0 if rig is None else rig.weight)
    start = (tip_force - 0.5 * level.beyond) * from_tip
    first = _solve(level, at_rest, start[None], np.array([begin]))
    rest_moment, tension = first[0][0], float(first[1][0])
    loaded = replace(level, bend=partial(table.bend_on, rest_moment), condition=at)
    solution = None if near is None else _solve_near(loaded, near)
    if solution is None:
        clamp = _guess_clamp(table, length, deflections)[0]
        guess = rest_moment + clamp[:, None] * from_tip / length, tension + clamp / length
        solution = _solve_all(loaded, at, np.append(rest_moment, tension), guess)
    moment, tensions = solution
    bent_wire = bend_wire(loaded, moment, tensions)
    rest_change = compute_sensitivity(level, bend_wire(level, *first), table.changes(first[0]))
    changes = table.changes_on(rest_moment, moment, rest_change[1:, 0, :-1])
    tension_change = compute_sensitivity(loaded, bent_wire, changes)[:, :, -1]
    tension_change[1:] -= rest_change[1:, :, -1]
    cos, sin, pull = bent_wire.cos[:, -1], bent_wire.sin[:, -1], bent_wire.wanted.force
    return LoadingStates(
        *(rest_moment, tension, deflections, moment, tensions),
        across=pull[:, 1] * cos - pull[:, 0] * sin,
        x=bent_wire.tip[:, 0],
        tip_angle=np.arctan2(sin, cos),
        curvature=bent_wire.curvature[:, 0],
        tension_change=tension_change,
    )


def _weightless_states(
    table: LoadingTable, length: float, at: AtDeflection, near: LoadingStates | None
) -> LoadingStates | None:
    """Find the equilibria of a wire without weight, with the moments at its clamp alone.

    None where there is no convergence, such as where parts near the tip unload.
    """
    min_excess = 0.1  # of the force over the smallest that can hold the moment
    weight, solution = 0.0 if at.rig is None else at.rig.weight, None
    if near is not None:
        clamp = _moments_at(table, near.curvature)
        load = weight + (near.tension - weight) * clamp / near.moment[:, 0]
        solution = solve_weightless(table, length, at, np.array([clamp, near.x, load]))
    if solution is None:
        clamp, x = _guess_clamp(table, length, at.deflection)
        load = np.maximum(clamp / x, (1.0 + min_excess) * table.energy(clamp)[:, 0])
        solution = solve_weightless(table, length, at, np.array([clamp, x, weight + load]))
    if solution is None:
        return None
    (clamp, x, tension), tension_change = solution
    force = at.demand(np.column_stack([x, at.deflection]), tension, np.arange(len(x))).force
    size, along = np.linalg.norm(force, axis=1), table.energy(clamp)[:, 0] + force[:, 0]
    return LoadingStates(
        *(np.zeros(1), weight, at.deflection, clamp[:, None], tension),
        across=np.sqrt(size**2 - along**2),
        x=x,
        tip_angle=np.arctan2(force[:, 1], force[:, 0]) - np.arccos(along / size),
        curvature=table.curve(clamp)[:, 0],
        tension_change=tension_change,
    )


def _solve_near(wire: Wire, near: LoadingStates) -> tuple[Floats, Floats] | None:
    """Solve from states of a similar law; None where that leads far away, such as to a curl."""
    max_change_share = 0.3  # of the largest moment
    solution = solve(wire, near.moment, near.tension, tolerance=MOMENT_TOLERANCE)
    if solution is None:
        return None
    change = np.abs(solution[0] - near.moment).max(axis=1)
    is_near = change <= max_change_share * np.abs(near.moment).max(axis=1)
    return solution if is_near.all() else None


def _guess_clamp(table: LoadingTable, length: float, deflections: Floats) -> tuple[Floats, Floats]:
    """Guess moments at the clamp, N m, and x of the tip, m, from those of a linear wire."""
    share = deflections / length
    turn = 3.0 * share / (1.0 - 0.5 * share**2)  # curvature at the clamp times length
    return _moments_at(table, turn / length), length / (1.0 + turn**2 / 15.0)


def _moments_at(table: LoadingTable, curvature: Floats) -> Floats:
    """Return the moments at curvatures, N m, on straight lines between and beyond the knots."""
    beyond = np.maximum(curvature - table.curvature[-1], 0.0) / table.last[-1]
    return np.asarray(np.interp(curvature, table.curvature, table.moment) + beyond)


def _solve_all(
    wire: Wire, at: AtDeflection, rest: Floats, start: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Solve for moments and tensions, first at some deflections, then between them."""
    min_deflections = 60  # for fewer, solving every fourth first costs more
    stride = 4
    deflections, solution = at.deflection, np.column_stack(start)
    if len(deflections) < min_deflections:
        return _solve(wire, at, *start)
    coarse = np.append(np.arange(0, len(deflections) - 1, stride), len(deflections) - 1)
    fine = np.setdiff1d(np.arange(len(deflections)), coarse)
    for rows in (coarse, fine):
        if rows is fine:
            states = np.vstack([rest, solution[coarse]])
            spline = CubicSpline(np.append(0.0, deflections[coarse]), states)
            solution[fine] = spline(deflections[fine])
        part = replace(at, deflection=deflections[rows])
        part_solution = _solve(wire, part, solution[rows, :-1], solution[rows, -1])
        solution[rows] = np.column_stack(part_solution)
    return solution[:, :-1], solution[:, -1]


def _solve(wire: Wire, at: AtDeflection, moment: Floats, tension: Floats) -> tuple[Floats, Floats]:
    wire = replace(wire, condition=at)
    solution = solve(wire, moment, tension, tolerance=MOMENT_TOLERANCE)
    if solution is None:
        farthest = at.deflection[-1]
        where = f"up to a deflection of {farthest:.6g} m" if farthest else "at rest"
        message = f"length={wire.stations.position[-1]:.6g} m: no equilibrium found {where}"
        raise ValueError(message)
    return solution


def interpolate_force(curve: LoadingCurve, deflection: Floats) -> tuple[Floats, Floats]:
    """Interpolate force above that at rest, and its derivatives, at given deflections.

    Parameters
    ----------
    curve : the loading curve
    deflection : shape (n,), m, any order and sign: the law is odd

    Returns
    -------
    Force, shape (n,), N, to about 3e-5 of the largest, and its derivative by each of the law's
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
