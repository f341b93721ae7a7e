"""End load of the cantilever at successive tip deflections, from straight (PHYSICS 5).

As long as nothing unloads, all points are solved at once: by the first integral of `wire.end_load`,
or with the wire's own weight as in `wire.heavy_loading`. From there on they are solved station by
station as in `wire.cantilever`, each extrapolated from those before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from labpipe.mechanics.law.loading_table import LoadingTable
from labpipe.mechanics.law.plays import (
    MomentLaw,
    PlayLaw,
    concave_law,
    is_within,
    require_finite,
    require_not_negative,
    require_positive,
    respond,
)
from labpipe.mechanics.wire.bending_law import MomentCurve
from labpipe.mechanics.wire.cantilever import (
    DEFAULT_STATIONS,
    AtDeflection,
    CantileverShape,
    WireState,
    deflect,
    settle,
    shape_of,
    straight,
)
from labpipe.mechanics.wire.end_load import deflection_at, end_loads
from labpipe.mechanics.wire.heavy_loading import heavy_states
from labpipe.mechanics.wire.newton import chebyshev_stations
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireAtRest, WireSpec, WireTable

HEAVY_STATIONS = 48
"""Along a wire with weight: loads are within 3e-5 of those of 160 stations."""


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


def end_load_path(
    law: MomentLaw,
    length: float,
    deflections: Floats,
    *,
    n_stations: int = DEFAULT_STATIONS,
    self_weight: float = 0.0,
) -> EndLoadPath:
    """Compute end load and clamp moment at successive tip deflections, from straight or rest.

    Parameters
    ----------
    law : law of the wire
    length : m
    deflections : shape (n,), m, in the order in which they are reached
    n_stations : along the wire, where it is solved station by station
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
    require_positive("length", length)
    require_finite("deflections", deflections)
    require_not_negative("self_weight", self_weight)
    unloading_share = 0.7  # of the length: about where something begins to unload
    goes_on = np.diff(deflections, prepend=0.0) > 0.0
    if self_weight > 0.0:
        goes_on &= deflections <= unloading_share * length
    growing = deflections[: len(goes_on) if goes_on.all() else int(np.argmin(goes_on))]
    if self_weight > 0.0:
        first = _from_rest(law, length, growing, self_weight)
    else:
        first = _from_straight(law, length, growing, n_stations)
    load, clamp = np.empty((2, len(deflections)))
    done = len(first.load)
    load[:done], clamp[:done] = first.load, first.clamp_moment[:done]
    is_outside = [not is_within(law, moment) for moment in first.clamp_moment.tolist()]
    if any(is_outside):
        done = min(is_outside.index(True), done)
    elif done < len(deflections):
        ahead = EndLoadPath(load[done:], clamp[done:])
        done += _continue_path(law, first.states(), length, deflections[done:], ahead)
    if first.rest is not None:
        load -= first.rest.force[1]
    return EndLoadPath(load[:done], clamp[:done], first.rest)


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """The first loading of a path.

    Parameters
    ----------
    load, clamp_moment : at its deflections, N, N m; the latter also where something begins to
        unload
    states : returns the last two states, from which the path goes on
    rest : of a wire with weight
    """

    load: Floats
    clamp_moment: Floats
    states: Callable[[], list[WireState]]
    rest: CantileverShape | None = None


def _from_straight(law: MomentLaw, length: float, deflections: Floats, n_stations: int) -> _Loaded:
    unbent = straight(law, n_stations)
    if not len(deflections):
        return _Loaded(np.zeros(0), np.zeros(0), lambda: [unbent, unbent])
    first = end_loads(law, length, deflections)
    from_tip = length * (1.0 - chebyshev_stations(n_stations).position)

    def state(row: int) -> WireState:
        """Return an approximate state, at the stations of the straight wire."""
        moment, load = first.moment_at(row, from_tip), float(first.load[row])
        return replace(unbent, moment=moment, load=load, travel=float(first.deflection[row]))

    def last_states() -> list[WireState]:
        before, last = state(max(len(first.load) - 3, 0)), state(-1)
        guess = last.moment, last.load
        return [before, _bend_one(law, unbent, length, last.travel, guess)]

    return _Loaded(first.load[:-1], first.clamp_moment, last_states)


def _from_rest(law: MomentLaw, length: float, deflections: Floats, self_weight: float) -> _Loaded:
    """Load a wire with weight from rest."""
    max_lean = 1.0  # rad: a steeper wire has other equilibria, too
    at = heavy_states(
        *(LoadingTable.of_plays(law), length, None, self_weight, deflections),
        n_stations=HEAVY_STATIONS,
        with_changes=False,
    )
    unbent = straight(law, HEAVY_STATIONS, self_weight=self_weight)

    def state(before: WireState, moment: Floats, load: float, travel: float) -> WireState:
        plays = respond(law, moment, before.plays).plays
        return WireState(moment, plays, np.array([0.0, load]), load, travel, self_weight)

    rest = state(unbent, at.rest, at.rest_tension, 0.0)
    shape = shape_of(law, rest, length)
    lean = float(np.max(np.abs(shape.angle)))
    if lean > max_lean:
        where = "deg between clamp and tip"
        message = f"by its weight the wire is inclined by {np.degrees(lean):.3g} {where}"
        raise ValueError(message)
    done = at.count_loading()

    def last_states() -> list[WireState]:
        rows = range(max(done - 2, 0), done)
        loaded = [
            state(rest, at.moment[row], float(at.tension[row]), float(deflections[row]))
            for row in rows
        ]
        return [rest, rest, *loaded][-2:]

    return _Loaded(at.tension[:done], at.moment[:done, 0], last_states, shape)


def _bend_one(
    law: MomentLaw,
    state: WireState,
    length: float,
    deflection: float,
    guess: tuple[Floats, float] | None,
) -> WireState:
    """Bend a wire to a deflection, in one step if a guess allows."""
    tolerance = 1e-5  # from a good guess; the next change would be 1e-10
    bent = None
    if guess is not None:
        at = AtDeflection(np.array([deflection]))
        bent = settle(law, state, length, at, travel=deflection, guess=guess, tolerance=tolerance)
    return deflect(law, state, length, deflection) if bent is None else bent


def _continue_path(
    law: MomentLaw,
    states: list[WireState],
    length: float,
    deflections: Floats,
    path: EndLoadPath,
) -> int:
    """Fill in a path, extrapolating from the states before; return the number of points."""
    for number, deflection in enumerate(deflections.tolist()):
        state = _bend_one(law, states[-1], length, deflection, _extrapolated(states, deflection))
        if not is_within(law, float(np.max(np.abs(state.moment)))):
            return number
        states = [*states[-2:], state]
        path.load[number], path.clamp_moment[number] = state.force[1], state.moment[0]
    return len(deflections)


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


DEFLECTIONS = 49
"""Points of the curve, including zero."""
FARTHEST = 0.8
"""Tip deflection at its end, as a share of the length."""


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


def cantilever_of(spec: WireSpec, curve: MomentCurve, self_weight: float) -> CantileverCurve:
    """Bend the cantilever of a wire up to the end of its law.

    Parameters
    ----------
    spec : of the wire: its free length
    curve : its law
    self_weight : N/m
    """
    try:
        law = concave_law(curve.curvature[1:], curve.moment[1:])
    except ValueError as error:
        message = f"no curve of the cantilever: {error}"
        note = QualityNote("cantilever_cut", Severity.WARNING, spec.place, message)
        return CantileverCurve(np.zeros(1), np.zeros(1), np.zeros(1), None, (note,))
    wanted = FARTHEST * spec.length
    end = min(wanted, deflection_at(law, spec.length, float(curve.moment[-1])))
    notes = []
    try:
        bent = _bend_to(law, spec.length, end, self_weight)
    except ValueError as error:
        message = (
            f"the curve of the cantilever of {spec.length * 1e3:.4g} mm is without the wire's own "
            f"weight, {1e3 * self_weight * spec.length:.4g} mN: {error}"
        )
        notes.append(QualityNote("weight_left_out", Severity.WARNING, spec.place, message))
        bent = _bend_to(law, spec.length, end, 0.0)
    if bent.deflection[-1] < wanted:
        message = (
            f"the cantilever of {spec.length * 1e3:.4g} mm is reported up to a tip deflection of "
            f"{bent.deflection[-1] * 1e3:.4g} mm, not {wanted * 1e3:.4g} mm: beyond, the curvature "
            f"at the clamp leaves the range of the law, {curve.curvature[-1]:.4g} 1/m"
        )
        notes.append(QualityNote("cantilever_cut", Severity.WARNING, spec.place, message))
    return replace(bent, notes=tuple(notes))


def _bend_to(law: PlayLaw, length: float, end: float, self_weight: float) -> CantileverCurve:
    """Compute the curve up to a deflection, or to the end of the law.

    With weight the clamp reaches the end of the law at a slightly different deflection than
    without, for which `end` holds; a curve that is cut ends there.
    """
    end_share = 0.97  # of the way to the end of the law, which is extrapolated linearly
    deflection = _deflections(end)
    path = end_load_path(law, length, deflection[1:], self_weight=self_weight)
    last = len(path.load)
    if last > 1 and end < FARTHEST * length and path.rest is not None:
        clamp = np.append(path.rest.moment[0], path.clamp_moment)
        slope = (clamp[-1] - clamp[-2]) / (deflection[last] - deflection[last - 1])
        ahead = (law.largest_moment - clamp[-1]) / slope
        deflection = _deflections(deflection[last] + end_share * ahead)
        path = end_load_path(law, length, deflection[1:], self_weight=self_weight)
        last = len(path.load)
    force = np.append(0.0, path.load)
    rest = _rest_record(path.rest)
    clamp = np.append(0.0 if rest is None else rest.moment, path.clamp_moment)
    return CantileverCurve(deflection[: last + 1], force, clamp, rest, ())


def _deflections(end: float) -> Floats:
    """Return the deflections of the curve, m, dense near zero."""
    spacing_power = 3  # the first point lies at 1e-5 of the last, before strands slip
    return np.asarray(end * np.linspace(0.0, 1.0, DEFLECTIONS) ** spacing_power)


def force_at(table: WireTable, deflection: float) -> float:
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


def _rest_record(shape: CantileverShape | None) -> WireAtRest | None:
    if shape is None:
        return None
    sag = -float(np.min(shape.y))
    rest = float(shape.force[1]), float(shape.moment[0]), float(shape.curvature[0])
    return WireAtRest(*rest, sag)
