"""The end load of the cantilever at a row of tip deflections, from straight (PHYSICS 5).

As long as nothing unloads by the first integral of `wire.end_load`, all at once, or with the wire's
own weight as in `wire.heavy_loading`; from there on station by station as in `wire.cantilever`,
each point from the trend of those before.
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

HEAVY_STATIONS = 48
"""Along a wire with weight: loads are within 3e-5 of those of 160 stations."""
_STEEPEST = 1.0  # rad, at rest: a wire that hangs so does not lie level, and has other equilibria
_AT_ONCE = 0.7  # of the length: about where something begins to unload
_FARTHEST_TREND = 2.0  # steps ahead that the last one is taken to go on
_TOLERANCE = 1e-5  # of Newton's method from a good guess: its next change would be 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class EndLoadPath:
    """What it takes to bring the tip to a row of deflections; arrays of shape (n,).

    Parameters
    ----------
    load : N, normal to the clamped axis, above that which holds the tip level at rest
    clamp_moment : N m
    rest : of a wire with weight; None without
    """

    load: Floats
    clamp_moment: Floats
    rest: CantileverShape | None = None

    def part(self, start: int, stop: int | None = None) -> EndLoadPath:
        """The path from a point on, up to another, with the same arrays."""
        return replace(self, load=self.load[start:stop], clamp_moment=self.clamp_moment[start:stop])


def end_load_path(
    law: MomentLaw,
    length: float,
    deflections: Floats,
    *,
    n_stations: int = DEFAULT_STATIONS,
    self_weight: float = 0.0,
) -> EndLoadPath:
    """End load and clamp moment at each of a row of tip deflections, from straight, or from rest.

    Parameters
    ----------
    law : law of the wire
    length : m
    deflections : shape (n,), m, in the order in which they are reached
    n_stations : along the wire, where it is gone through station by station
    self_weight : N/m, of the wire; with weight it lies level at rest, its tip held by the load

    Returns
    -------
    Load and clamp moment at each deflection, as far as the law goes: fewer where it ends before.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way.

    Notes
    -----
    As long as the deflections grow and no part of the wire unloads, to about 0.7 of the length, by
    the first integral of `wire.end_load`, all at once; from there on station by station.
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
        inside = [is_within(law, moment) for moment in first.clamp_moment.tolist()]
        if not all(inside):
            return path.part(0, min(inside.index(False), done))
        if done < len(path.load):
            before = _guess(before, length, first, max(done - 2, 0))
            state = _last_state(law, state, length, first)
    rest = _go_on(law, (before, state), length, deflections[done:], path.part(done))
    return path.part(0, done + rest)


def _from_rest(
    law: MomentLaw, length: float, deflections: Floats, self_weight: float
) -> EndLoadPath:
    """The same of a wire with weight: all at once from rest, then station by station."""
    goes_on = (np.diff(deflections, prepend=0.0) > 0.0) & (deflections <= _AT_ONCE * length)
    count = len(goes_on) if goes_on.all() else int(np.argmin(goes_on))
    table, wanted = LoadingTable.of_plays(law), deflections[:count]
    at = heavy_states(
        *(table, length, None, self_weight, wanted),
        n_stations=HEAVY_STATIONS,
        with_changes=False,
    )
    done = at.count_loading()
    plays = respond(law, at.rest, unbent_plays(law, len(at.rest))).plays
    force = np.array([0.0, at.rest_tension])
    rest = WireState(at.rest, plays, force, at.rest_tension, self_weight=self_weight)
    still = shape_of(law, rest, length)
    hangs = float(np.max(np.abs(still.angle)))
    if hangs > _STEEPEST:
        message = f"by its weight it hangs at {np.degrees(hangs):.3g} deg between clamp and tip"
        raise ValueError(message)
    load, clamp = np.empty((2, len(deflections)))
    load[:done], clamp[:done] = at.tension[:done], at.moment[:done, 0]
    path = EndLoadPath(load, clamp, still)
    outside = [not is_within(law, moment) for moment in clamp[:done].tolist()]
    if any(outside):
        done = outside.index(True)
    elif done < len(deflections):
        states = [rest]
        for row in range(max(done - 2, 0), done):
            bent, tension = at.moment[row], float(at.tension[row])
            plays = respond(law, bent, rest.plays).plays
            force, travel = np.array([0.0, tension]), float(wanted[row])
            states.append(WireState(bent, plays, force, tension, travel, self_weight))
        first = (states[-2] if done else rest, states[-1])
        done += _go_on(law, first, length, deflections[done:], path.part(done))
    load -= at.rest_tension
    return path.part(0, done)


def _guess(virgin: WireState, length: float, first: EndLoads, row: int) -> WireState:
    """Nearly the state at one row of a first loading, at the stations of the straight wire."""
    from_tip = length * (1.0 - chebyshev_stations(len(virgin.moment)).position)
    moment, load = first.moment_at(row, from_tip), float(first.load[row])
    return replace(virgin, moment=moment, load=load, travel=float(first.deflection[row]))


def _last_state(law: MomentLaw, virgin: WireState, length: float, first: EndLoads) -> WireState:
    """State at the end of a first loading."""
    guess = _guess(virgin, length, first, -1)
    near = Unknowns(guess.moment, guess.load)
    return _settle(law, virgin, length, guess.travel, near)


def _settle(
    law: MomentLaw, state: WireState, length: float, deflection: float, guess: Unknowns | None
) -> WireState:
    """Bend a wire to a deflection, in one step where there is a guess from which that goes."""
    found = None
    if guess is not None:
        condition = EndLoad(deflection)
        found = settle(
            law, state, length, condition, travel=deflection, guess=guess, tolerance=_TOLERANCE
        )
    return deflect(law, state, length, deflection) if found is None else found


def _go_on(
    law: MomentLaw,
    first: tuple[WireState, WireState],
    length: float,
    deflections: Floats,
    path: EndLoadPath,
) -> int:
    """Fill in a path, each point from the trend of the states before; give how many, to its end."""
    states = list(first)
    for number, deflection in enumerate(deflections.tolist()):
        found = _settle(law, states[-1], length, deflection, _trend(states, deflection))
        if not is_within(law, float(np.max(np.abs(found.moment)))):
            return number
        states = [*states[-2:], found]
        path.load[number], path.clamp_moment[number] = found.force[1], found.moment[0]
    return len(deflections)


def _trend(states: list[WireState], travel: float) -> Unknowns | None:
    """Moments and load at a travel on the parabola through the last states; None where it cannot.

    A straight line for two states, and where the last three did not go one way.
    """
    at = [state.travel for state in states]
    steps = np.diff([*at, travel])
    if not 0.0 < (travel - at[-1]) * steps[-2] <= _FARTHEST_TREND * steps[-2] ** 2:
        return None
    if steps[0] * steps[-1] <= 0.0:
        states, at = states[-2:], at[-2:]
    shares = [
        float(np.prod([(travel - b) / (a - b) for b in at if b != a])) for a in at
    ]  # Lagrange's
    moment = np.sum([n * state.moment for n, state in zip(shares, states, strict=True)], axis=0)
    return Unknowns(moment, sum(n * state.load for n, state in zip(shares, states, strict=True)))
