"""Compute loading curves of a clamped wire, with all deflections solved together.

At rest the clamp and the tip are level, and the string or an end load holds the tip. The wire is
loaded from rest. Newton's method solves for the moments at all stations and deflections together
(`wire.cantilever`). Masing's rule gives the curvature where the weight has bent the wire in the
opposite direction, and where a station unloads from its largest moment.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Annotated, TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from labpipe.mechanics.law.plays import (
    CurvatureAndCompliance,
    LoadingTable,
    PlayLaw,
    is_within,
    require_finite,
    require_not_negative,
    require_positive,
)
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.wire.bending_law import MomentCurve
from labpipe.mechanics.wire.cantilever import (
    BendingLaw,
    Cantilever,
    StringRig,
    TipCondition,
    WireState,
    compute_shape,
    deflect,
    make_stations,
    make_transfer_matrix,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireAtRest, WireSpec, WireTable

N_LOADING_STATIONS = 24
"""Number of stations along a wire on first loading.

The relative differences from the forces with 160 stations are at most 3e-4, and 6e-5 on average.
"""
N_PATH_STATIONS = 48
"""Number of stations along a wire that may unload.

The relative differences from the loads with 160 stations are at most 1e-4.
"""
_N_COARSE_STATIONS = 12
"""Number of stations of the coarse wire, on which Newton's steps are computed."""
_MOMENT_TOLERANCE = 1e-5
"""Largest change of a moment in the last Newton step, relative to the largest moment."""
_COARSE_MOMENT_TOLERANCE = 1e-3
"""As `_MOMENT_TOLERANCE`, for the coarse wire, whose solution is the first guess for the wire."""
_MAX_LOADING_RATIO = 0.7
"""Largest ratio of deflection to length on a loading curve.

At about this deflection, stations at the tip begin to unload.
"""


@dataclass(frozen=True, slots=True, eq=False)
class LoadingCurve(ArrayRecord):
    """Equilibria of a wire at rest and at increasing deflections; arrays of shape (n,).

    Parameters
    ----------
    deflection : m, deflection of the tip from rest, normal to the undeformed axis, increasing
    moment : shape (n, stations), N m, moments at the stations
    tension : N, tension of the string, as read by a load cell; without a string, the end load
    shear_force : N, force normal to the wire at its tip; where it decreases with deflection, the
        moments near the tip also decrease
    tip_angle : rad, angle of the tangent at the tip from the undeformed axis
    clamp_curvature : 1/m, curvature at the clamp
    stiffness : N/m, derivative of the tension with respect to deflection; at rest, the secant to
        the first deflection. If stations may unload, it is NaN at all other points
    tension_sensitivity : shape (parameters, n), N, derivatives of the tension above that at rest
        with respect to the logarithms of the parameters of the law, at constant deflection. They
        are zero at rest. If stations may unload, they are NaN at all other points
    full_curve : curve up to the last deflection, of which this curve is the first part. It is the
        first guess for a similar law. None for a curve that was not cut
    """

    deflection: Vector
    moment: Annotated[Floats, "n", "stations"]
    tension: Vector
    shear_force: Vector
    tip_angle: Vector
    clamp_curvature: Vector
    stiffness: Vector
    tension_sensitivity: Annotated[Floats, "parameters", "n"]
    full_curve: LoadingCurve | None = None

    @property
    def force(self) -> Floats:
        """Tension above that at rest, N, as read by a load cell that was zeroed at rest."""
        return np.asarray(self.tension - self.tension[0])

    @property
    def clamp_moment(self) -> Floats:
        """Moments at the clamp, N m, shape (n,)."""
        return self.moment[:, 0]

    def require_reached(self, deflection: Floats) -> None:
        """Raise ValueError if a deflection, m, is negative or beyond the end of the curve.

        A wire with weight, or on a string, has other forces if it is deflected away from the pull.
        """
        last_deflection = self.deflection[-1]
        is_outside = (deflection < 0.0) | (deflection > last_deflection)
        if np.any(is_outside):
            message = (
                f"deflection={np.max(deflection[is_outside]):.6g} m: the curve begins at rest and "
                f"ends at {last_deflection:.6g} m, where the tip is inclined by "
                f"{np.degrees(self.tip_angle[-1]):.3g} deg"
            )
            raise ValueError(message)

    def count_loading_points(self) -> int:
        """Count the points, including rest, up to which no station unloads.

        The moments near the tip decrease beyond a deflection of about 0.7 of the length. They may
        decrease earlier in a wire that sags.
        """
        relative_tolerance = 1e-5  # smaller decreases of a moment are errors of the solution
        moment_step = np.diff(self.moment, axis=0)
        change_from_rest = self.moment[:-1] - self.moment[0]
        tolerance = relative_tolerance * np.max(np.abs(self.moment[1:]), axis=1, keepdims=True)
        is_decrease = (moment_step * change_from_rest < 0.0) & (np.abs(moment_step) > tolerance)
        is_unloading = is_decrease.any(axis=1)
        is_unloading[1:] |= np.diff(self.shear_force[1:]) <= 0.0
        return 1 + (int(np.argmax(is_unloading)) if is_unloading.any() else len(is_unloading))


def load_cantilever(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflection: float,
    *,
    guess: LoadingCurve | None = None,
) -> LoadingCurve:
    """Compute the loading curve of a wire from rest to a deflection.

    Parameters
    ----------
    table : law of first loading, with its derivatives with respect to parameters
    length : m, length of the wire
    rig : string and counterweight; its `anchor_height` has no effect. None for an end load normal
        to the undeformed axis. At rest, string or end load hold the tip level
    self_weight : N/m, weight per length of the wire; may be 0
    deflection : m, deflection of the tip from rest
    guess : curve of the same cantilever for the same deflection with a similar law; None if there
        is none

    Returns
    -------
    The curve from rest to the deflection, but at most to 0.7 of the length. It ends earlier if a
    station begins to unload.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    n_points = 64
    spacing_power = 2.75  # points are denser near rest, where strands begin to slip
    last_deflection = min(deflection, _MAX_LOADING_RATIO * length)
    deflections = last_deflection * (np.arange(1, n_points + 1) / n_points) ** spacing_power
    curve = find_equilibria(
        table, length, rig, self_weight, deflections, guess=guess and guess.full_curve
    )
    n_loading = curve.count_loading_points()
    names = [item.name for item in fields(curve) if item.name not in {"moment", "full_curve"}]
    first_points = {name: getattr(curve, name)[..., :n_loading] for name in names}
    return replace(curve, **first_points, moment=curve.moment[:n_loading], full_curve=curve)


def find_equilibria(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflections: Floats,
    *,
    n_stations: int | None = None,
    guess: LoadingCurve | None = None,
) -> LoadingCurve:
    """Find the equilibria of a wire at rest and at increasing deflections.

    Parameters
    ----------
    table, length, rig, self_weight : law, length, rig and weight of the wire, as for
        `load_cantilever`
    deflections : shape (n,), m, deflections from rest in the direction of the pull, increasing
    n_stations : number of stations along a wire whose stations may unload from their largest
        moments. None for first loading, which alone gives the derivatives of the curve
    guess : curve at these deflections with a similar law; None if there is none

    Returns
    -------
    Curve with the state at rest, followed by all deflections.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """

    def bend_from_rest(moment: Floats, rows: Ints) -> CurvatureAndCompliance:
        return table.bend_from_rest(moment[0], moment[rows])

    def bend_from_peak(moment: Floats, rows: Ints) -> CurvatureAndCompliance:
        peak_moment = np.maximum.accumulate(moment, axis=0)
        return table.bend_from_peak(moment[0], peak_moment[rows], moment[rows])

    stations = make_stations(n_stations or N_LOADING_STATIONS, length)
    condition = TipCondition(rig, np.append(0.0, deflections))
    law = bend_from_rest if n_stations is None else bend_from_peak
    coarse = Cantilever(law, make_stations(_N_COARSE_STATIONS, length), self_weight, condition)
    one_grid_wire = replace(coarse, stations=stations)
    wire = replace(one_grid_wire, coarse_wire=coarse)
    solve = partial(_solve_from_linear, table, loading_law=bend_from_rest)
    first_guess = guess and (guess.moment, guess.tension)
    first_guess = first_guess or solve(coarse, tolerance=_COARSE_MOMENT_TOLERANCE)
    solution = first_guess and _solve_from_guess(wire, *first_guess)
    solution = solution or solve(one_grid_wire, tolerance=_MOMENT_TOLERANCE)
    if solution is None:
        level_wire = replace(one_grid_wire, condition=TipCondition(rig, np.zeros(1)))
        has_rest = solve(level_wire, tolerance=_MOMENT_TOLERANCE) is not None
        place = f"up to a deflection of {np.max(deflections):.6g} m" if has_rest else "at rest"
        message = f"length={length:.6g} m: no equilibrium found {place}"
        raise ValueError(message)
    return _make_curve(table, wire, *solution, is_first_loading=n_stations is None)


_Equilibria: TypeAlias = tuple[Floats, Floats]
"""Moments at the stations, shape (n, stations), N m, and loads, shape (n,), N."""


def _solve_from_linear(
    table: LoadingTable, wire: Cantilever, *, loading_law: BendingLaw, tolerance: float
) -> _Equilibria | None:
    """Solve for all deflections without the solution for a similar law; None if this fails.

    The first guess is the solution at rest plus the moments of a linear wire. If Newton's method
    fails from this guess, it starts again from the solution for the law of first loading.
    """
    position, deflection = wire.stations.position, wire.condition.deflection
    assert deflection is not None
    length, rig = float(position[-1]), wire.condition.rig
    # The end load of a linear wire with a level tip is 3 w L / 8.
    tip_force, weight = 0.375 * wire.self_weight * length, 0.0 if rig is None else rig.weight
    moment = (tip_force - 0.5 * wire.outer_weight) * (length - position)
    loading_wire = replace(wire, law=loading_law)
    level_wire = replace(loading_wire, condition=TipCondition(rig, np.zeros(1)))
    rest = level_wire.solve(moment[None], np.array([tip_force + weight]), tolerance=tolerance)
    if rest is None:
        return None
    # The law is extrapolated linearly to the curvatures at the clamp of a linear wire.
    ratio = deflection / length
    curvature = 3.0 * ratio / (1.0 - 0.5 * ratio**2) / length
    clamp_moment = np.interp(curvature, table.curvature, table.moment)
    clamp_moment += np.maximum(curvature - table.curvature[-1], 0.0) / table.end_compliance[-1]
    load_guess = rest[1] + clamp_moment / length
    guess = rest[0] + clamp_moment[:, None] * (1.0 - position / length), load_guess
    solution = wire.solve(*guess, tolerance=tolerance)
    first_solution = solution or loading_wire.solve(*guess, tolerance=tolerance)
    return solution or (first_solution and wire.solve(*first_solution, tolerance=tolerance))


def _solve_from_guess(wire: Cantilever, moment: Floats, load: Floats) -> _Equilibria | None:
    """Solve for all deflections from the solution for a similar law; None if none is near."""
    max_relative_change = 0.3  # of the moments, relative to the largest; beyond, a wire may curl
    moment = moment @ make_transfer_matrix(moment.shape[1], len(wire.stations.position)).T
    solution = wire.solve(moment, load, tolerance=_MOMENT_TOLERANCE)
    if solution is None:
        return None
    change = np.abs(solution[0] - moment).max(axis=1)
    is_near = change <= max_relative_change * np.abs(moment).max(axis=1)
    return solution if np.all(is_near) else None


def _make_curve(
    table: LoadingTable, wire: Cantilever, moment: Floats, load: Floats, *, is_first_loading: bool
) -> LoadingCurve:
    """Make the loading curve of equilibria; if stations may unload, its derivatives are NaN."""
    bent, deflection = wire.bend(moment, load), wire.condition.deflection
    assert deflection is not None
    # Row 0 is the derivative with respect to deflection; the others are those to parameters.
    derivatives = np.full((1 + len(table.start_sensitivity), len(deflection)), np.nan)
    if is_first_loading:
        rest = wire.bend(moment[:1], load[:1])
        at_rest = rest.compute_sensitivities(table.compute_sensitivities(moment[:1]))[1:]
        sensitivity = table.compute_sensitivities_from_rest(moment[0], moment, at_rest[:, 0, :-1])
        derivatives = bent.compute_sensitivities(sensitivity)[:, :, -1]
        derivatives[1:] -= at_rest[:, :, -1]
    derivatives[:, 0] = 0.0
    derivatives[0, 0] = (load[1] - load[0]) / deflection[1] if len(load) > 1 else np.nan
    (force_x, force_y), cos, sin = bent.tip_force.force.T, bent.cos[:, -1], bent.sin[:, -1]
    return LoadingCurve(
        deflection=deflection,
        moment=moment,
        tension=load,
        shear_force=force_y * cos - force_x * sin,
        tip_angle=np.arctan2(sin, cos),
        clamp_curvature=bent.curvature[:, 0],
        stiffness=derivatives[0],
        tension_sensitivity=derivatives[1:],
    )


def interpolate_force(curve: LoadingCurve, deflection: Floats) -> tuple[Floats, Floats]:
    """Interpolate the force above that at rest, and its sensitivities, at given deflections.

    Parameters
    ----------
    curve : loading curve
    deflection : shape (n,), m, in any order

    Returns
    -------
    Force, shape (n,), N, with errors of about 4e-4 of the largest force, and its derivatives with
    respect to the logarithms of the parameters of the law, shape (parameters, n), N. Both are NaN
    where the deflection is NaN.

    Raises
    ------
    ValueError
        If a deflection is outside the curve.
    """
    curve.require_reached(deflection)
    sensitivity = curve.tension_sensitivity
    values = np.vstack([curve.force, sensitivity])
    slopes = np.vstack([curve.stiffness, np.gradient(sensitivity, curve.deflection, axis=1)])
    interpolated = CubicHermiteSpline(curve.deflection, values, slopes, axis=1)(deflection)
    return interpolated[0], interpolated[1:]


@dataclass(frozen=True, slots=True, eq=False)
class EndLoadPath:
    """End load normal to the undeformed axis at successive tip deflections; arrays of shape (n,).

    Parameters
    ----------
    deflection : m, tip deflection from rest
    load : N, end load, minus the load that holds the tip level at rest
    clamp_moment : N m, moment at the clamp
    rest : forces and shape at rest of a wire with weight; None for a wire without weight
    notes : notes on a neglected weight and on a path that ends early
    """

    deflection: Floats
    load: Floats
    clamp_moment: Floats
    rest: WireAtRest | None = None
    notes: tuple[QualityNote, ...] = ()

    def find_deflection(self, curve: MomentCurve, curvature: float) -> float:
        """Find the deflection, m, at which the clamp has a curvature, 1/m.

        The clamp moment must increase along the path.

        Parameters
        ----------
        curve : law of the wire
        curvature : 1/m, curvature at the clamp

        Returns
        -------
        The deflection; infinite if the path does not reach the curvature.
        """
        moment = float(np.interp(curvature, curve.curvature, curve.moment, right=np.inf))
        if moment >= self.clamp_moment[-1]:
            return float("inf")
        return float(PchipInterpolator(self.clamp_moment, self.deflection)(moment))


def compute_end_load_path(
    law: PlayLaw,
    length: float,
    deflections: Floats,
    *,
    n_stations: int = N_PATH_STATIONS,
    self_weight: float = 0.0,
) -> EndLoadPath:
    """Compute end load and clamp moment at successive tip deflections, from rest.

    Parameters
    ----------
    law : law of the wire
    length : m, length of the wire
    deflections : shape (n,), m, tip deflections in the order in which they are reached
    n_stations : number of stations along the wire
    self_weight : N/m, weight per length of the wire; at rest, the load holds the tip level with the
        clamp

    Returns
    -------
    Load and clamp moment at the deflections before the clamp leaves the range of the law, and the
    state at rest of a wire with weight.

    Raises
    ------
    ValueError
        If no equilibrium is found on the path, the weight inclines the wire by more than 1 rad at
        rest, or an argument is outside its range.

    Notes
    -----
    The deflections up to the first that does not increase are solved together, the others one
    after another.
    """
    require_positive("length", length)
    require_finite("deflections", deflections)
    require_not_negative("self_weight", self_weight)
    # Stations near the tip may unload at large deflections. The grid resolves their largest
    # moments.
    unloading_grid = length * np.arange(0.5, 1.0, 0.0125)
    table = LoadingTable.of_plays(law)
    is_rising = np.append(np.diff(deflections, prepend=0.0) > 0.0, False)
    rising_deflections = deflections[: int(np.argmin(is_rising))]
    is_reached = unloading_grid < np.max(rising_deflections, initial=0.0)
    grid = np.union1d(rising_deflections, unloading_grid[is_reached])
    curve = find_equilibria(table, length, None, self_weight, grid, n_stations=n_stations)

    def make_state(row: int, history: Floats) -> WireState:
        """Make the state in a row of the curve, where the law has a history."""
        moment, load = curve.moment[row], float(curve.tension[row])
        response, deflection = law.respond(moment, history), float(curve.deflection[row])
        bent, force = (moment, response.curvature, response.history), np.array([0.0, load])
        return WireState(*bent, force, load, deflection, self_weight)

    rest_state = make_state(0, law.make_unbent_history(n_stations))
    state = make_state(-1, law.respond(curve.moment.max(axis=0), rest_state.history).history)
    rows = np.append(0, 1 + np.searchsorted(grid, rising_deflections))
    load, clamp_moment = curve.tension[rows], curve.clamp_moment[rows]
    for deflection in deflections[len(rising_deflections) :].tolist():
        state = deflect(law, state, length, deflection)
        load, clamp_moment = np.append(load, state.load), np.append(clamp_moment, state.moment[0])
    n_valid = int(np.argmin(np.append(is_within(law, clamp_moment[1:]), False)))
    rest = _describe_rest(rest_state, length) if self_weight > 0.0 else None
    load_above_rest = load[1 : n_valid + 1] - (0.0 if rest is None else rest.force)
    return EndLoadPath(deflections[:n_valid], load_above_rest, clamp_moment[1 : n_valid + 1], rest)


def _describe_rest(state: WireState, length: float) -> WireAtRest:
    """Describe a wire at rest; raise ValueError if it is inclined by more than 1 rad."""
    max_angle = 1.0  # rad; a steeper wire may have several equilibria
    shape = compute_shape(state, length)
    angle = float(np.max(np.abs(shape.angle)))
    if angle > max_angle:
        degrees = np.degrees(angle)
        raise ValueError(format_sentence("mechanics.wire.leans_by_weight", degrees=degrees))
    moment, curvature = float(state.moment[0]), float(state.curvature[0])
    return WireAtRest(float(state.force[1]), moment, curvature, sag=-float(np.min(shape.y)))


_MAX_PATH_RATIO = 0.8
"""Largest ratio of tip deflection to length on the path of a wire."""


def bend_cantilever(spec: WireSpec, curve: MomentCurve, self_weight: float) -> EndLoadPath:
    """Compute the path of a cantilever to 0.8 of its length, or to the end of its law.

    Parameters
    ----------
    spec : row of the wire in its sheet, which states the free length of the wire
    curve : law of the wire
    self_weight : N/m, weight per length of the wire

    Returns
    -------
    The path from rest. It has a note if the weight was left out because the wire does not stay
    level under it, and a note if the law ends before 0.8 of the length. If the law cannot be made
    concave, the path has a single point at zero, and a note.

    Raises
    ------
    ValueError
        If no equilibrium is found without the weight.
    """
    try:
        law = make_concave_law(curve.curvature[1:], curve.moment[1:])
    except ValueError as error:
        note = QualityNote.of("mechanics.wire.no_cantilever", spec.place, error=error)
        return EndLoadPath(np.zeros(1), np.zeros(1), np.zeros(1), notes=(note,))
    notes, length_mm = [], 1e3 * spec.length
    try:
        path = _bend_to_end(law, spec.length, self_weight)
    except ValueError as error:
        note = QualityNote.of(
            "mechanics.wire.weight_left_out",
            spec.place,
            length=length_mm,
            weight=self_weight * length_mm,
            error=error,
        )
        notes.append(note)
        path = _bend_to_end(law, spec.length, 0.0)
    nominal_deflection = _MAX_PATH_RATIO * spec.length
    if path.deflection[-1] < nominal_deflection:
        note = QualityNote.of(
            "mechanics.wire.cantilever_cut",
            spec.place,
            length=length_mm,
            deflection=1e3 * path.deflection[-1],
            nominal_deflection=1e3 * nominal_deflection,
            last_curvature=curve.curvature[-1],
        )
        notes.append(note)
    return replace(path, notes=tuple(notes))


def _bend_to_end(law: PlayLaw, length: float, self_weight: float) -> EndLoadPath:
    """Compute the path from rest to 0.8 of the length, or to the end of the law."""
    n_points = 49  # including zero
    spacing_power = 3  # the first point is at 1e-5 of the last deflection, before strands slip
    last_moment_factor = 0.9999  # last clamp moment relative to the largest moment of the law
    unlimited_law = replace(law, largest_moment=np.inf)
    last_deflection = _MAX_PATH_RATIO * length
    for _ in range(2):
        deflection = last_deflection * np.linspace(0.0, 1.0, n_points) ** spacing_power
        path = compute_end_load_path(unlimited_law, length, deflection[1:], self_weight=self_weight)
        clamp_moment = np.append(path.rest.moment if path.rest else 0.0, path.clamp_moment)
        if clamp_moment[-1] <= law.largest_moment:
            break
        interpolant = PchipInterpolator(clamp_moment, deflection)
        last_deflection = float(interpolant(last_moment_factor * law.largest_moment))
    return EndLoadPath(deflection, np.append(0.0, path.load), clamp_moment, path.rest)


def interpolate_end_load(table: WireTable, deflections: Floats | float) -> Floats:
    """Interpolate end loads at tip deflections in the table of a wire.

    Parameters
    ----------
    table : table of the wire
    deflections : any shape, m, deflections of the tip

    Returns
    -------
    End loads, N, in the shape of the deflections; NaN for negative deflections, beyond the end of
    the curve, and if the table has no curve.

    Notes
    -----
    The interpolant is a monotone cubic (Fritsch and Carlson, SIAM J. Numer. Anal. 17 (1980) 238).
    """
    if len(table.tip_deflection) < 2:
        return np.full_like(deflections, np.nan, dtype=np.float64)
    curve = PchipInterpolator(table.tip_deflection, table.tip_force, extrapolate=False)
    return np.asarray(curve(deflections))
