"""End load of the cantilever at successive tip deflections, from rest (PHYSICS 5).

As long as nothing unloads, all points are solved at once, see `wire.first_loading`. From there on
they are solved station by station as in `wire.cantilever`, each extrapolated from those before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from labpipe.mechanics.law.plays import (
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
    AtDeflection,
    CantileverShape,
    WireState,
    compute_shape,
    deflect,
    make_straight,
    settle,
)
from labpipe.mechanics.wire.first_loading import (
    END_OF_FIRST_LOADING,
    LoadingStates,
    find_loading_states,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.wire import WireAtRest, WireSpec, WireTable

PATH_STATIONS = 48
"""Along a wire: loads are within 1e-4 of those of 160 stations."""


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
    rest: CantileverShape | None = None


def compute_end_load_path(
    law: PlayLaw,
    length: float,
    deflections: Floats,
    *,
    n_stations: int = PATH_STATIONS,
    self_weight: float = 0.0,
) -> EndLoadPath:
    """Compute end load and clamp moment at successive tip deflections, from straight or rest.

    Parameters
    ----------
    law : law of the wire
    length : m
    deflections : shape (n,), m, in the order in which they are reached
    n_stations : along the wire
    self_weight : N/m, of the wire; with weight it lies level at rest, its tip held by the load

    Returns
    -------
    Load and clamp moment at each deflection, up to the end of the law.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way.

    Notes
    -----
    The points are solved at once as long as the deflections grow and no part of the wire unloads,
    up to about 0.7 of the length; from there on station by station.
    """
    search_points = 32  # from the last deflection of first loading to where parts unload
    require_positive("length", length)
    require_finite("deflections", deflections)
    require_not_negative("self_weight", self_weight)
    goes_on = np.diff(deflections, prepend=0.0) > 0.0
    goes_on &= deflections <= END_OF_FIRST_LOADING * length
    growing = deflections[: len(goes_on) if goes_on.all() else int(np.argmin(goes_on))]
    by_stations = n_stations if self_weight > 0.0 else None
    cantilever = LoadingTable.of_plays(law), length, None, self_weight
    at = find_loading_states(*cantilever, growing, n_stations=by_stations)
    state_at_rest = make_straight(law, n_stations, self_weight=self_weight)
    if self_weight > 0.0:
        state_at_rest = _state(law, state_at_rest, at, None)
    shape = _shape_at_rest(law, state_at_rest, length) if self_weight > 0.0 else None
    done = at.count_loading()
    outside = [n for n in range(done) if not is_within(law, float(at.moment[n, 0]))]
    further: list[WireState] = []
    if outside:
        done = outside[0]
    elif done < len(deflections):
        way = growing[:done][-2:]
        start, end = np.append(0.0, way)[-1], min(deflections[done], END_OF_FIRST_LOADING * length)
        if end > start:
            search = np.linspace(start, end, search_points + 1)[1:]
            loaded = find_loading_states(
                *cantilever, search, n_stations=by_stations
            ).count_loading()
            way = np.append(way, search[:loaded])[-2:]
        last = find_loading_states(*cantilever, way, n_stations=n_stations)
        states = [
            state_at_rest,
            state_at_rest,
            *(_state(law, state_at_rest, last, row) for row in range(len(way))),
        ][-2:]
        further = list(_continue_path(law, states, length, deflections[done:]))
    load = np.append(at.tension[:done], [state.force[1] for state in further])
    clamp = np.append(at.moment[:done, 0], [state.moment[0] for state in further])
    return EndLoadPath(load - (0.0 if shape is None else shape.force[1]), clamp, shape)


def _state(law: PlayLaw, before: WireState, at: LoadingStates, row: int | None) -> WireState:
    """Return the state with history at one of the deflections, or at rest."""
    at_rest = at.rest, at.rest_tension, 0.0
    moment, load, travel = (
        at_rest if row is None else (at.moment[row], at.tension[row], at.deflection[row])
    )
    plays, force = law.respond(moment, before.plays).plays, np.array([0.0, load])
    return replace(
        before, moment=moment, plays=plays, force=force, load=float(load), travel=float(travel)
    )


def _shape_at_rest(law: PlayLaw, rest: WireState, length: float) -> CantileverShape:
    """Return the shape that the wire's own weight gives it."""
    max_lean = 1.0  # rad: a steeper wire has other equilibria, too
    shape = compute_shape(law, rest, length)
    lean = float(np.max(np.abs(shape.angle)))
    if lean > max_lean:
        degrees = np.degrees(lean)
        raise ValueError(format_sentence("mechanics.wire.leans_by_weight", degrees=degrees))
    return shape


def _continue_path(
    law: PlayLaw, states: list[WireState], length: float, deflections: Floats
) -> Iterator[WireState]:
    """Yield the states at further deflections up to the end of the law, from those before."""
    tolerance = 1e-5  # from a good guess; the next change would be 1e-10
    for deflection in deflections.tolist():
        before, state = states[-1], None
        guess = _extrapolated(states, deflection)
        if guess is not None:
            at = AtDeflection(np.array([deflection]))
            state = settle(
                law, before, length, at, travel=deflection, guess=guess, tolerance=tolerance
            )
        state = deflect(law, before, length, deflection) if state is None else state
        if not is_within(law, float(np.max(np.abs(state.moment)))):
            return
        states = [*states[-2:], state]
        yield state


def _extrapolated(states: list[WireState], travel: float) -> tuple[Floats, float] | None:
    """Extrapolate moments and load to a travel by a parabola; None if it is too far.

    A straight line through two states, and where the last three reverse.
    """
    max_trend_steps = 2.0  # steps ahead over which the last one is extrapolated
    travels = [state.travel for state in states]
    steps = np.diff([*travels, travel])
    if not 0.0 < (travel - travels[-1]) * steps[-2] <= max_trend_steps * steps[-2] ** 2:
        return None
    if steps[0] * steps[-1] <= 0.0:
        states, travels = states[-2:], travels[-2:]
    # Lagrange weights
    shares = [float(np.prod([(travel - b) / (a - b) for b in travels if b != a])) for a in travels]
    moment = np.sum([n * state.moment for n, state in zip(shares, states, strict=True)], axis=0)
    return moment, sum(n * state.load for n, state in zip(shares, states, strict=True))


N_CURVE_POINTS = 49
"""Of the curve, including zero."""
END_DEFLECTION = 0.8
"""Tip deflection at the end of the curve, as a share of the length."""
SPACING_POWER = 3
"""Of its points: the first lies at 1e-5 of the last, before strands slip."""


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
    notes: tuple[QualityNote, ...]

    def deflection_at(self, law: MomentCurve, curvature: float) -> float:
        """Return the deflection at a curvature of the clamp, m; infinite if it is not reached."""
        if curvature >= law.curvature[-1]:
            return float("inf")
        moment = float(np.interp(curvature, law.curvature, law.moment))
        if moment >= self.clamp_moment[-1]:
            return float("inf")
        return float(PchipInterpolator(self.clamp_moment, self.deflection)(moment))


def compute_cantilever(spec: WireSpec, curve: MomentCurve, self_weight: float) -> CantileverCurve:
    """Bend the cantilever of a wire up to the end of its law.

    Parameters
    ----------
    spec : of the wire: its free length
    curve : its law
    self_weight : N/m
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
    wanted_deflection = END_DEFLECTION * spec.length
    if path.deflection[-1] < wanted_deflection:
        last = curve.curvature[-1]
        notes.append(
            QualityNote.of(
                "mechanics.wire.cantilever_cut",
                spec.place,
                length=length,
                reached=1e3 * path.deflection[-1],
                wanted=1e3 * wanted_deflection,
                last=last,
            )
        )
    return replace(path, notes=tuple(notes))


def _bend_to_end(law: PlayLaw, length: float, self_weight: float) -> CantileverCurve:
    """Compute the curve up to its farthest deflection, or to the end of the law."""
    end_share = 0.9999  # of the law's last moment, so that rounding stays within
    endless, end = replace(law, largest_moment=np.inf), END_DEFLECTION * length
    for _ in range(2):
        deflection = end * np.linspace(0.0, 1.0, N_CURVE_POINTS) ** SPACING_POWER
        path = compute_end_load_path(endless, length, deflection[1:], self_weight=self_weight)
        at_rest = None if path.rest is None else _rest_record(path.rest)
        clamp = np.append(at_rest.moment if at_rest else 0.0, path.clamp_moment)
        if clamp[-1] <= law.largest_moment:
            break
        end = float(PchipInterpolator(clamp, deflection)(end_share * law.largest_moment))
    return CantileverCurve(deflection, np.append(0.0, path.load), clamp, at_rest, ())


def _rest_record(shape: CantileverShape) -> WireAtRest:
    rest = float(shape.force[1]), float(shape.moment[0]), float(shape.curvature[0])
    return WireAtRest(*rest, -float(np.min(shape.y)))


def interpolate_end_load(table: WireTable, deflection: float) -> float:
    """Interpolate the end load at a tip deflection, N, in a table.

    Parameters
    ----------
    table : of the wire
    deflection : m

    Returns
    -------
    NaN beyond the end of the curve, and without a curve.

    Notes
    -----
    Monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17 (1980) 238).
    """
    if len(table.tip_deflection) < 2 or deflection > table.tip_deflection[-1]:
        return float("nan")
    return float(PchipInterpolator(table.tip_deflection, table.tip_force)(deflection))
