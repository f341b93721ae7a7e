"""End load of the cantilever at successive tip deflections, from straight (PHYSICS 5).

As long as nothing unloads, all points are solved at once: by the first integral of `wire.end_load`,
or with the wire's own weight as in `wire.heavy_loading`. From there on they are solved station by
station as in `wire.cantilever`, each extrapolated from those before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.law.loading_table import LoadingTable
from labpipe.law.plays import (
    MomentLaw,
    is_within,
    require_finite,
    require_not_negative,
    require_positive,
    respond,
    unbent_plays,
)
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import (
    DEFAULT_STATIONS,
    CantileverShape,
    WireState,
    deflect,
    settle,
    shape_of,
    straight,
)
from labpipe.wire.end_load import EndLoads, end_loads
from labpipe.wire.heavy_loading import heavy_states
from labpipe.wire.newton import EndLoad, Unknowns, chebyshev_stations


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

    def part(self, start: int, stop: int | None = None) -> EndLoadPath:
        """Return the path between two points, as views."""
        return replace(self, load=self.load[start:stop], clamp_moment=self.clamp_moment[start:stop])


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
    if self_weight > 0.0:
        return _from_rest(law, length, deflections, self_weight)
    grows = np.diff(deflections, prepend=0.0) > 0.0
    n_growing = len(grows) if grows.all() else int(np.argmin(grows))
    path = EndLoadPath(*np.empty((2, len(deflections))))
    before = state = straight(law, n_stations)
    done = 0
    if n_growing:
        first = end_loads(law, length, deflections[:n_growing])
        done = len(first.load) - 1
        path.load[:done], path.clamp_moment[:done] = first.load[:-1], first.clamp_moment[:-1]
        is_inside = [is_within(law, moment) for moment in first.clamp_moment.tolist()]
        if not all(is_inside):
            return path.part(0, min(is_inside.index(False), done))
        if done < len(path.load):
            before = _guessed_state(before, length, first, max(done - 2, 0))
            state = _last_loading_state(law, state, length, first)
    rest = _continue_path(law, (before, state), length, deflections[done:], path.part(done))
    return path.part(0, done + rest)


def _from_rest(
    law: MomentLaw, length: float, deflections: Floats, self_weight: float
) -> EndLoadPath:
    """Compute the path of a wire with weight, from rest."""
    n_stations = 48  # along a wire with weight: loads are within 3e-5 of those of 160 stations
    max_lean = 1.0  # rad: a steeper wire has other equilibria, too
    unloading_share = 0.7  # of the length: about where something begins to unload
    goes_on = (np.diff(deflections, prepend=0.0) > 0.0) & (deflections <= unloading_share * length)
    count = len(goes_on) if goes_on.all() else int(np.argmin(goes_on))
    table, wanted = LoadingTable.of_plays(law), deflections[:count]
    states_at = heavy_states(
        *(table, length, None, self_weight, wanted), n_stations=n_stations, with_changes=False
    )
    done = states_at.count_loading()
    plays = respond(law, states_at.rest, unbent_plays(law, len(states_at.rest))).plays
    force = np.array([0.0, states_at.rest_tension])
    rest = WireState(states_at.rest, plays, force, states_at.rest_tension, self_weight=self_weight)
    shape = shape_of(law, rest, length)
    lean = float(np.max(np.abs(shape.angle)))
    if lean > max_lean:
        where = "deg between clamp and tip"
        message = f"by its weight the wire is inclined by {np.degrees(lean):.3g} {where}"
        raise ValueError(message)
    load, clamp = np.empty((2, len(deflections)))
    load[:done], clamp[:done] = states_at.tension[:done], states_at.moment[:done, 0]
    path = EndLoadPath(load, clamp, shape)
    is_outside = [not is_within(law, moment) for moment in clamp[:done].tolist()]
    if any(is_outside):
        done = is_outside.index(True)
    elif done < len(deflections):
        states = [rest]
        for row in range(max(done - 2, 0), done):
            bent, tension = states_at.moment[row], float(states_at.tension[row])
            plays = respond(law, bent, rest.plays).plays
            force, travel = np.array([0.0, tension]), float(wanted[row])
            states.append(WireState(bent, plays, force, tension, travel, self_weight))
        first = (states[-2] if done else rest, states[-1])
        done += _continue_path(law, first, length, deflections[done:], path.part(done))
    load -= states_at.rest_tension
    return path.part(0, done)


def _guessed_state(virgin: WireState, length: float, first: EndLoads, row: int) -> WireState:
    """Return an approximate state of a first loading, at the stations of the straight wire."""
    from_tip = length * (1.0 - chebyshev_stations(len(virgin.moment)).position)
    moment, load = first.moment_at(row, from_tip), float(first.load[row])
    return replace(virgin, moment=moment, load=load, travel=float(first.deflection[row]))


def _last_loading_state(
    law: MomentLaw, virgin: WireState, length: float, first: EndLoads
) -> WireState:
    """Return the state at the end of a first loading."""
    guess = _guessed_state(virgin, length, first, -1)
    near = Unknowns(guess.moment, guess.load)
    return _bend_one(law, virgin, length, guess.travel, near)


def _bend_one(
    law: MomentLaw, state: WireState, length: float, deflection: float, guess: Unknowns | None
) -> WireState:
    """Bend a wire to a deflection, in one step if a guess allows."""
    tolerance = 1e-5  # from a good guess; the next change would be 1e-10
    state_ = None
    if guess is not None:
        condition = EndLoad(deflection)
        state_ = settle(
            law, state, length, condition, travel=deflection, guess=guess, tolerance=tolerance
        )
    return deflect(law, state, length, deflection) if state_ is None else state_


def _continue_path(
    law: MomentLaw,
    first: tuple[WireState, WireState],
    length: float,
    deflections: Floats,
    path: EndLoadPath,
) -> int:
    """Fill in a path, extrapolating from the states before; return the number of points."""
    states = list(first)
    for number, deflection in enumerate(deflections.tolist()):
        state = _bend_one(law, states[-1], length, deflection, _extrapolated(states, deflection))
        if not is_within(law, float(np.max(np.abs(state.moment)))):
            return number
        states = [*states[-2:], state]
        path.load[number], path.clamp_moment[number] = state.force[1], state.moment[0]
    return len(deflections)


def _extrapolated(states: list[WireState], travel: float) -> Unknowns | None:
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
    return Unknowns(moment, sum(n * state.load for n, state in zip(shares, states, strict=True)))
