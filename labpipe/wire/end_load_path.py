"""The end load of the cantilever at a row of tip deflections, from straight (PHYSICS 5).

As long as nothing unloads by the first integral of `wire.end_load`, all at once; from there on
station by station as in `wire.cantilever`, each point from the trend of those before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.law.plays import (
    MomentLaw,
    is_within,
    require_finite,
    require_positive,
)
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import DEFAULT_STATIONS, WireState, deflect, settle, straight
from labpipe.wire.end_load import EndLoads, end_loads
from labpipe.wire.newton import EndLoad, Unknowns, chebyshev_stations

_FARTHEST_TREND = 2.0  # steps ahead that the last one is taken to go on
_TOLERANCE = 1e-5  # of Newton's method from a good guess: its next change would be 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class EndLoadPath:
    """What it takes to bring the tip to a row of deflections; arrays of shape (n,).

    Parameters
    ----------
    load : N, normal to the clamped axis
    clamp_moment : N m
    """

    load: Floats
    clamp_moment: Floats

    def part(self, start: int, stop: int | None = None) -> EndLoadPath:
        """The path from a point on, up to another, with the same arrays."""
        return EndLoadPath(self.load[start:stop], self.clamp_moment[start:stop])


def end_load_path(
    law: MomentLaw, length: float, deflections: Floats, *, n_stations: int = DEFAULT_STATIONS
) -> EndLoadPath:
    """End load and clamp moment at each of a row of tip deflections, from straight.

    Parameters
    ----------
    law : law of the wire
    length : m
    deflections : shape (n,), m, in the order in which they are reached
    n_stations : along the wire, where it is gone through station by station

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
