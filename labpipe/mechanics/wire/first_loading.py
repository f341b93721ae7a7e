"""Compute loading curves of a clamped wire, all deflections at once.

At rest the wire is level, its tip held by the string or by an end load; from there it is loaded.
Newton's method solves for the moments at the stations of all deflections together
(`wire.cantilever`); where the weight bent the wire the other way, and behind the largest moment of
each station, the law returns by Masing's rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from labpipe.mechanics.law.plays import (
    CurvatureAndSlope,
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
    make_straight,
    make_transfer_matrix,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Floats, Ints, Vector
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireAtRest, WireSpec, WireTable

N_LOADING_STATIONS = 24
"""Along a wire that is loaded: forces are within 3e-4 of those of 160 stations, 6e-5 on average."""
PATH_STATIONS = 48
"""Along a wire that may unload: loads are within 1e-4 of those of 160 stations."""
_N_COARSE_STATIONS = 12
"""Number of stations on which Newton's steps of a wire with more stations are computed."""
_MOMENT_TOLERANCE = 1e-5
"""Last change of moments, as a share of the largest; convergence is quadratic."""
_START_TOLERANCE = 1e-3
"""The same for the solution on coarse stations, which is a start."""
END_OF_FIRST_LOADING = 0.7
"""Approximate deflection over length at which parts near the tip begin to unload."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadingCurve(ArrayRecord):
    """A wire at rest and at deflections of its loading; arrays of shape (n,), the first at rest.

    Parameters
    ----------
    deflection : m, of the tip across the undeformed axis, from rest, increasing
    moment : shape (n, stations), N m
    tension : N, of the string, which is what the load cell reads; the end load where there is none
    across : N, force across the wire at its tip; where it falls, so do the moments near the tip
    x : m, position of the tip along the undeformed axis
    tip_angle : rad, of the tangent at the tip from the undeformed axis
    clamp_curvature : 1/m
    stiffness : N/m, slope of tension against deflection; at rest, to the first deflection.
        NaN beyond rest if parts may unload
    tension_change : shape (parameters, n), N, derivative of the tension above that at rest, at
        constant deflection, by each of the law's parameters; NaN beyond rest if parts may unload
    whole : the curve of which this is the first part; the solution of a similar law starts from it
    """

    deflection: Vector
    moment: Annotated[Floats, "n", "stations"]
    tension: Vector
    across: Vector
    x: Vector
    tip_angle: Vector
    clamp_curvature: Vector
    stiffness: Vector
    tension_change: Annotated[Floats, "parameters", "n"]
    whole: LoadingCurve | None = None

    @property
    def force(self) -> Floats:
        """Return the tension above that at rest, N, as a zeroed load cell reads it."""
        return np.asarray(self.tension - self.tension[0])

    @property
    def clamp_moment(self) -> Floats:
        """Return the moments at the clamp, N m."""
        return self.moment[:, 0]

    def count_loading(self) -> int:
        """Count the points, rest included, up to which no part of the wire unloads.

        At deflections beyond about 0.7 of the length the moments near the tip fall; those of a
        sagging wire may fall earlier.
        """
        rounding_share = 1e-5  # of the largest moment
        step = np.diff(self.moment, axis=0)
        since_rest = self.moment[:-1] - self.moment[0]
        small = rounding_share * np.max(np.abs(self.moment[1:]), axis=1, keepdims=True)
        turns = ((step * since_rest < 0.0) & (np.abs(step) > small)).any(axis=1)
        turns[1:] |= np.diff(self.across[1:]) <= 0.0
        return 1 + (int(np.argmax(turns)) if turns.any() else len(turns))


def load_cantilever(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflection: float,
    *,
    similar: LoadingCurve | None = None,
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
    similar : curve of this function for the same cantilever and deflection with a similar law, to
        start from

    Returns
    -------
    The curve: rest, then points up to the deflection, but at most to 0.7 of the length, and only
    until a part of the wire unloads.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """
    n_points = 64
    spacing_power = 2.75  # points are denser towards rest, where strands begin to slip
    farthest = min(deflection, END_OF_FIRST_LOADING * length)
    deflections = farthest * (np.arange(1, n_points + 1) / n_points) ** spacing_power
    similar = None if similar is None else similar.whole
    curve = load_to(table, length, rig, self_weight, deflections, similar=similar)
    count = curve.count_loading()
    names = "deflection tension across x tip_angle clamp_curvature stiffness tension_change"
    first_points = {name: getattr(curve, name)[..., :count] for name in names.split()}
    return replace(curve, **first_points, moment=curve.moment[:count], whole=curve)


def load_to(
    table: LoadingTable,
    length: float,
    rig: StringRig | None,
    self_weight: float,
    deflections: Floats,
    *,
    n_stations: int | None = None,
    similar: LoadingCurve | None = None,
) -> LoadingCurve:
    """Find the equilibria of a wire at rest and at given deflections.

    Parameters
    ----------
    table, length, rig, self_weight : as for `load_cantilever`
    deflections : shape (n,), m, from rest, in the direction of the pull, increasing
    n_stations : along the wire; parts near the tip may then unload, which follows from the largest
        moment at the deflections so far, and there are no derivatives. None for first loading
        alone
    similar : curve at these deflections of a similar law, to start from

    Returns
    -------
    The curve: rest, then all deflections.

    Raises
    ------
    ValueError
        If no equilibrium is found.
    """

    def bend_on(moment: Floats, rows: Ints) -> CurvatureAndSlope:
        return table.bend_on(moment[0], moment[rows])

    def bend_back(moment: Floats, rows: Ints) -> CurvatureAndSlope:
        peaks = np.maximum.accumulate(moment, axis=0)
        return table.bend_back(moment[0], peaks[rows], moment[rows])

    stations = make_stations(n_stations or N_LOADING_STATIONS, length)
    condition = TipCondition(rig, np.append(0.0, deflections))
    law = bend_on if n_stations is None else bend_back
    coarse = Cantilever(law, make_stations(_N_COARSE_STATIONS, length), self_weight, condition)
    wire, plain = (replace(coarse, stations=stations, coarse=few) for few in (coarse, None))
    start = None if similar is None else (similar.moment, similar.tension)
    start = start or _solve_from_linear(table, coarse, bend_on, tolerance=_START_TOLERANCE)
    solution = start and _solve_from_similar(wire, *start)
    solution = solution or _solve_from_linear(table, plain, bend_on, tolerance=_MOMENT_TOLERANCE)
    if solution is None:
        level = replace(plain, condition=TipCondition(rig, np.zeros(1)))
        rests = _solve_from_linear(table, level, bend_on, tolerance=_MOMENT_TOLERANCE) is not None
        where = f"up to a deflection of {np.max(deflections):.6g} m" if rests else "at rest"
        message = f"length={length:.6g} m: no equilibrium found {where}"
        raise ValueError(message)
    return _make_curve(table, wire, *solution, is_first_loading=n_stations is None)


_Equilibria: TypeAlias = tuple[Floats, Floats]
"""Moments at the stations, N m, and loads, N."""


def _solve_from_linear(
    table: LoadingTable, wire: Cantilever, first_loading: BendingLaw, *, tolerance: float
) -> _Equilibria | None:
    """Solve from rest and a linear wire; if parts unload, by way of first loading if need be."""
    position, deflection = wire.stations.position, wire.condition.deflection
    assert deflection is not None
    length, rig = float(position[-1]), wire.condition.rig
    tip_force, weight = 0.375 * wire.self_weight * length, 0.0 if rig is None else rig.weight
    moment = (tip_force - 0.5 * wire.weight_beyond) * (length - position)
    loaded = replace(wire, law=first_loading)
    level = replace(loaded, condition=TipCondition(rig, np.zeros(1)))
    rest = level.solve(moment[None], np.array([tip_force + weight]), tolerance=tolerance)
    if rest is None:
        return None
    clamp, _ = _guess_clamp(table, length, deflection)
    start = rest[0] + clamp[:, None] * (1.0 - position / length), rest[1] + clamp / length
    solution = wire.solve(*start, tolerance=tolerance)
    detour = solution or loaded.solve(*start, tolerance=tolerance)
    return solution or (detour and wire.solve(*detour, tolerance=tolerance))


def _solve_from_similar(wire: Cantilever, moment: Floats, load: Floats) -> _Equilibria | None:
    """Solve from a similar law; None if that ends nowhere or far away, such as in a curl."""
    max_change_share = 0.3  # of the largest moment
    moment = moment @ make_transfer_matrix(moment.shape[1], len(wire.stations.position)).T
    solution = wire.solve(moment, load, tolerance=_MOMENT_TOLERANCE)
    if solution is None:
        return None
    change, size = (np.abs(part).max(axis=1) for part in (solution[0] - moment, moment))
    return solution if np.all(change <= max_change_share * size) else None


def _make_curve(
    table: LoadingTable, wire: Cantilever, moment: Floats, load: Floats, *, is_first_loading: bool
) -> LoadingCurve:
    """Make the curve of equilibria; its derivatives are NaN unless for first loading."""
    bent, deflection = wire.bend(moment, load), wire.condition.deflection
    assert deflection is not None
    change = np.full((1 + len(table.first_change), len(deflection)), np.nan)
    if is_first_loading:
        at_rest = wire.bend(moment[:1], load[:1])
        rest_change = at_rest.compute_sensitivities(table.changes(moment[:1]))
        changes = table.changes_on(moment[0], moment, rest_change[1:, 0, :-1])
        change = bent.compute_sensitivities(changes)[:, :, -1]
        change[1:] -= rest_change[1:, :, -1]
    change[:, 0] = 0.0
    change[0, 0] = (load[1] - load[0]) / deflection[1] if len(load) > 1 else np.nan  # before slip
    (pull_x, pull_y), cos, sin = bent.tip_force.force.T, bent.cos[:, -1], bent.sin[:, -1]
    return LoadingCurve(
        deflection=deflection,
        moment=moment,
        tension=load,
        across=pull_y * cos - pull_x * sin,
        x=bent.tip[:, 0],
        tip_angle=np.arctan2(sin, cos),
        clamp_curvature=bent.curvature[:, 0],
        stiffness=change[0],
        tension_change=change[1:],
    )


def _guess_clamp(table: LoadingTable, length: float, deflections: Floats) -> tuple[Floats, Floats]:
    """Guess moments at the clamp, N m, and x of the tip, m, from those of a linear wire."""
    share = deflections / length
    turn = 3.0 * share / (1.0 - 0.5 * share**2)  # curvature at the clamp times length
    return _find_moments(table, turn / length), length / (1.0 + turn**2 / 15.0)


def _find_moments(table: LoadingTable, curvature: Floats) -> Floats:
    """Return the moments at curvatures, N m, on straight lines between and beyond the knots."""
    beyond = np.maximum(curvature - table.curvature[-1], 0.0) / table.last[-1]
    return np.asarray(np.interp(curvature, table.curvature, table.moment) + beyond)


def interpolate_force(curve: LoadingCurve, deflection: Floats) -> tuple[Floats, Floats]:
    """Interpolate force above that at rest, and its derivatives, at given deflections.

    Parameters
    ----------
    curve : the loading curve
    deflection : shape (n,), m, any order and sign: the law is odd

    Returns
    -------
    Force, shape (n,), N, to about 4e-4 of the largest, and its derivative with respect to each
    parameter of the law, shape (parameters, n). NaN where the deflection is NaN.

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
class EndLoadPath:
    """End load at successive tip deflections; arrays of shape (n,).

    Parameters
    ----------
    load : N, normal to the clamped axis, less that which holds the tip level at rest
    clamp_moment : N m
    rest : of a wire with weight; None without
    """

    load: Floats
    clamp_moment: Floats
    rest: WireAtRest | None = None


def compute_end_load_path(
    law: PlayLaw,
    length: float,
    deflections: Floats,
    *,
    n_stations: int = PATH_STATIONS,
    self_weight: float = 0.0,
) -> EndLoadPath:
    """Compute end load and clamp moment at successive tip deflections, from rest.

    Parameters
    ----------
    law : law of the wire
    length : m
    deflections : shape (n,), m, in the order in which they are reached
    n_stations : along the wire
    self_weight : N/m, of the wire; with weight it lies level at rest, its tip held by the load

    Returns
    -------
    Load and clamp moment at each deflection, up to the end of the law, and the rest of a wire with
    weight.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way, the weight bends the wire by more than 1 rad at
        rest, or an argument is out of range.

    Notes
    -----
    The first increasing deflections are solved together, later ones one by one.
    """
    require_positive("length", length)
    require_finite("deflections", deflections)
    require_not_negative("self_weight", self_weight)
    grid_spacing, grid_start = 0.0125, 0.5  # of the length: parts near the tip unload on this grid
    table = LoadingTable.of_plays(law)
    rises = np.append(np.diff(deflections, prepend=0.0) > 0.0, False)
    growing = deflections[: int(np.argmin(rises))]
    between = length * np.arange(grid_start, 1.0, grid_spacing)
    grid = np.union1d(growing, between[between < np.max(growing, initial=0.0)])
    curve = load_to(table, length, None, self_weight, grid, n_stations=n_stations)
    rows = np.append(0, 1 + np.searchsorted(grid, growing))
    load, clamp = curve.tension[rows], curve.clamp_moment[rows]
    state = make_straight(law, n_stations, self_weight=self_weight)
    state = _make_state(law, state, curve.moment[0], float(curve.tension[0]), 0.0)
    rest = _describe_rest(state, length) if self_weight > 0.0 else None
    state = replace(state, plays=law.respond(curve.moment.max(axis=0), state.plays).plays)
    end = float(curve.tension[-1]), float(curve.deflection[-1])
    state = _make_state(law, state, curve.moment[-1], *end)
    for deflection in deflections[len(growing) :].tolist():
        state = deflect(law, state, length, deflection)
        load, clamp = np.append(load, state.load), np.append(clamp, state.moment[0])
    outside = [not is_within(law, float(moment)) for moment in clamp]
    count = outside.index(True) if any(outside) else len(clamp)
    at_rest = 0.0 if rest is None else rest.force
    return EndLoadPath(load[1:count] - at_rest, clamp[1:count], rest)


def _make_state(
    law: PlayLaw, state: WireState, moment: Floats, load: float, deflection: float
) -> WireState:
    """Make the state of a wire from the moments of a loading curve."""
    response, force = law.respond(moment, state.plays), np.array([0.0, load])
    present = moment, response.curvature, response.plays, force
    return WireState(*present, load, deflection, state.self_weight)


def _describe_rest(state: WireState, length: float) -> WireAtRest:
    """Describe a wire at rest under its own weight; ValueError if it leans by more than 1 rad."""
    max_lean = 1.0  # rad: a steeper wire has several equilibria
    shape = compute_shape(state, length)
    lean = float(np.max(np.abs(shape.angle)))
    if lean > max_lean:
        degrees = np.degrees(lean)
        raise ValueError(format_sentence("mechanics.wire.leans_by_weight", degrees=degrees))
    clamp = float(state.moment[0]), float(state.curvature[0])
    return WireAtRest(float(state.force[1]), *clamp, sag=-float(np.min(shape.y)))


END_DEFLECTION = 0.8
"""Tip deflection at the end of a wire's curve, as a share of the length."""


@dataclass(frozen=True, slots=True, eq=False)
class CantileverCurve:
    """The cantilever of a wire.

    Parameters
    ----------
    deflection, force : shape (n,), m and N, of the tip, from rest
    clamp_moment : shape (n,), N m
    rest : None where the wire's weight is left out
    notes : reasons of an early end, neglected effects
    """

    deflection: Floats
    force: Floats
    clamp_moment: Floats
    rest: WireAtRest | None
    notes: tuple[QualityNote, ...] = ()

    def deflection_at(self, law: MomentCurve, curvature: float) -> float:
        """Return the deflection at a curvature of the clamp, m; infinite if it is not reached."""
        moment = float(np.interp(curvature, law.curvature, law.moment, right=np.inf))
        if moment >= self.clamp_moment[-1]:
            return float("inf")
        return float(PchipInterpolator(self.clamp_moment, self.deflection)(moment))


def compute_cantilever(spec: WireSpec, curve: MomentCurve, self_weight: float) -> CantileverCurve:
    """Bend the cantilever of a wire to 0.8 of its length, or to the end of its law.

    Parameters
    ----------
    spec : of the wire: its free length
    curve : its law
    self_weight : N/m

    Returns
    -------
    The curve, with a note if the weight had to be left out, and one if the law ends before 0.8 of
    the length. Zeros and a note if the law cannot be made concave.

    Raises
    ------
    ValueError
        If no equilibrium is found without the weight either.
    """
    try:
        law = make_concave_law(curve.curvature[1:], curve.moment[1:])
    except ValueError as error:
        note = QualityNote.of("mechanics.wire.no_cantilever", spec.place, error=error)
        return CantileverCurve(np.zeros(1), np.zeros(1), np.zeros(1), None, (note,))
    notes, length = [], 1e3 * spec.length
    try:
        path = _bend_to_end(law, spec.length, self_weight)
    except ValueError as error:
        note = QualityNote.of(
            "mechanics.wire.weight_left_out",
            spec.place,
            length=length,
            weight=self_weight * length,
            error=error,
        )
        notes.append(note)
        path = _bend_to_end(law, spec.length, 0.0)
    target_deflection = END_DEFLECTION * spec.length
    if path.deflection[-1] < target_deflection:
        note = QualityNote.of(
            "mechanics.wire.cantilever_cut",
            spec.place,
            length=length,
            reached=1e3 * path.deflection[-1],
            wanted=1e3 * target_deflection,
            last=curve.curvature[-1],
        )
        notes.append(note)
    return replace(path, notes=tuple(notes))


def _bend_to_end(law: PlayLaw, length: float, self_weight: float) -> CantileverCurve:
    """Compute the curve up to its farthest deflection, or to the end of the law."""
    n_points = 49  # including zero
    spacing_power = 3  # the first point lies at 1e-5 of the last, before strands slip
    end_share = 0.9999  # of the law's last moment, so that rounding stays within
    endless, end = replace(law, largest_moment=np.inf), END_DEFLECTION * length
    for _ in range(2):
        deflection = end * np.linspace(0.0, 1.0, n_points) ** spacing_power
        path = compute_end_load_path(endless, length, deflection[1:], self_weight=self_weight)
        clamp = np.append(path.rest.moment if path.rest else 0.0, path.clamp_moment)
        if clamp[-1] <= law.largest_moment:
            break
        end = float(PchipInterpolator(clamp, deflection)(end_share * law.largest_moment))
    return CantileverCurve(deflection, np.append(0.0, path.load), clamp, path.rest)


def interpolate_end_load(table: WireTable, deflections: Floats | float) -> Floats:
    """Interpolate the end loads at tip deflections, N, in a table.

    Parameters
    ----------
    table : of the wire
    deflections : m, of any shape

    Returns
    -------
    NaN beyond the end of the curve, and without a curve.

    Notes
    -----
    Monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17 (1980) 238).
    """
    if len(table.tip_deflection) < 2:
        return np.full_like(deflections, np.nan, dtype=np.float64)
    curve = PchipInterpolator(table.tip_deflection, table.tip_force, extrapolate=False)
    return np.asarray(curve(deflections))
