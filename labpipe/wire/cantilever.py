"""The clamped wire in large deflection, each station with its own history (PHYSICS 5).

The frame is that of the clamp: x along the undeformed axis from the clamped end, y in the plane of
bending towards the pull; theta is the angle of the tangent from x. With the force (Px, Py) at the
tip and the wire's own weight w per length,

    M(s) = integral from s to L of ((Py - w (L - s)) cos theta - Px sin theta),
    theta(s) = integral of kappa(M),

at Chebyshev-Lobatto stations, every station with its own history. Newton's method with the exact
Jacobian solves it; the load (an end load or the tension of the string) is one more unknown,
fixed by one more condition. A path is followed in steps that are halved where Newton's method
fails. Unlike the dissertation, it uses neither a series nor a single stiffness for the
whole wire.

The clamp is driven down, which in its own frame lifts the anchor of the string. The string is taut
or slack; the counterweight always hangs at the tip.

A wire with weight is mounted level and bends under its weight before the test. Its path therefore
starts from this equilibrium and its history, not from zero moment (PHYSICS 8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from labpipe.law.plays import (
    MomentLaw,
    require_finite,
    require_not_negative,
    require_positive,
    require_within,
    respond,
    unbent_plays,
)
from labpipe.records.arrays import Floats, frozen
from labpipe.wire.newton import (
    TOLERANCE,
    Condition,
    DeadLoad,
    EndLoad,
    Equilibrium,
    Pull,
    Unknowns,
    chebyshev_stations,
    solve,
)

DEFAULT_STATIONS = 64  # above about 100, BLAS starts threads, which is slower


@dataclass(frozen=True, slots=True, eq=False)
class WireState:
    """Moments and history of a wire, station by station.

    Parameters
    ----------
    moment : shape (stations,), N m
    plays : shape (stations, plays), N m
    force : shape (2,), N, at the tip
    load : the unknown of the last solution, N: the string's tension or the end load
    travel : position on the path: travel of the clamp, m; tip deflection, m; or share of a change
        of force
    self_weight : N/m, of the wire, along -y
    """

    moment: Floats
    plays: Floats
    force: Floats
    load: float = 0.0
    travel: float = 0.0
    self_weight: float = 0.0

    def __post_init__(self) -> None:
        stations = len(self.moment)
        object.__setattr__(self, "moment", frozen(self.moment, shape=(None,)))
        object.__setattr__(self, "plays", frozen(self.plays, shape=(stations, None)))
        object.__setattr__(self, "force", frozen(self.force, shape=(2,)))


@dataclass(frozen=True, slots=True, eq=False)
class CantileverShape:
    """A wire in equilibrium; arrays are of shape (stations,) from the clamp to the tip.

    Parameters
    ----------
    arc_length, x, y : m
    angle : rad
    moment : N m
    curvature : 1/m
    force : shape (2,), N, at the tip: string and counterweight together
    tension : N, of the string, 0 if it is slack; without a string, the load of the state
    state : start of the next step
    """

    arc_length: Floats
    x: Floats
    y: Floats
    angle: Floats
    moment: Floats
    curvature: Floats
    force: Floats
    tension: float
    state: WireState


@dataclass(frozen=True, slots=True)
class StringRig:
    """The string and the counterweight.

    Parameters
    ----------
    string_length : m, from the load cell to the tip
    weight : N, of the counterweight at the tip
    anchor_x : m, position of the load cell along the undeformed axis: above the initial tip
    anchor_height : m, of the load cell over the clamped axis at zero travel; less than
        `string_length` when the string is slack
    """

    string_length: float
    weight: float
    anchor_x: float
    anchor_height: float

    def travel_to_taut_string(self, x: float, y: float) -> float:
        """Return the travel of the clamp at which the string just reaches a tip at (x, y), m."""
        rise = np.sqrt(self.string_length**2 - (self.anchor_x - x) ** 2)
        return float(y + rise - self.anchor_height)


Step: TypeAlias = Callable[[WireState, float], WireState | None]


def straight(
    law: MomentLaw, n_stations: int = DEFAULT_STATIONS, *, self_weight: float = 0.0
) -> WireState:
    """Return the state of a straight wire that was never bent.

    Parameters
    ----------
    law : of the wire
    n_stations : along it
    self_weight : N/m, of the wire; acts from the first step on
    """
    require_not_negative("self_weight", self_weight)
    unbent = unbent_plays(law, n_stations)
    return WireState(np.zeros(n_stations), unbent, np.zeros(2), self_weight=self_weight)


def held_level(law: MomentLaw, length: float, self_weight: float) -> CantileverShape:
    """Find the initial equilibrium of a level wire whose tip a normal force holds.

    Parameters
    ----------
    law : of the wire
    length : m
    self_weight : N/m

    Returns
    -------
    The shape; ``force[1]`` is the holding force P0, which is lost when the load cell is zeroed:
    3 w L / 8 for a small sag of a linear wire, with a moment of - w L^2 / 8 at the clamp.

    Raises
    ------
    ValueError
        As `bend_to_deflection`.
    """
    return bend_to_deflection(law, straight(law, self_weight=self_weight), length, 0.0)


def bend_under_force(
    law: MomentLaw, state: WireState, length: float, force: Floats
) -> CantileverShape:
    """Bend a wire by changing its end force linearly to another.

    Parameters
    ----------
    law, state : law and history of the wire
    length : m
    force : shape (2,), N, fixed in direction

    Returns
    -------
    The shape in equilibrium.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way, or the wire is bent beyond the range of its law (the
        message states the curvature).
    """
    start, goal = state.force, np.asarray(force, dtype=np.float64)
    require_positive("length", length)
    require_finite("force", goal)

    def step(present: WireState, share: float) -> WireState | None:
        condition = DeadLoad(start + share * (goal - start))
        return settle(law, present, length, condition, travel=share)

    context = f"force={goal.tolist()}"
    reached = _walk_to(step, replace(state, travel=0.0), 1.0, context)
    require_within(law, reached.moment, context)
    return shape_of(law, reached, length)


def bend_to_deflection(
    law: MomentLaw, state: WireState, length: float, deflection: float
) -> CantileverShape:
    """Bend a wire by an end force normal to the clamped axis until its tip is at `deflection`.

    Parameters
    ----------
    law, state : law and history of the wire; `state.travel` is its present deflection
    length, deflection : m

    Returns
    -------
    The shape; ``force[1]`` is the end load.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way, as for a deflection that exceeds the length, or the
        wire is bent beyond the range of its law (the message states the curvature).
    """
    require_positive("length", length)
    require_finite("deflection", deflection)
    reached = deflect(law, state, length, deflection)
    require_within(law, reached.moment, f"deflection={deflection!r}")
    return shape_of(law, reached, length)


def deflect(law: MomentLaw, state: WireState, length: float, deflection: float) -> WireState:
    """Bend a wire to a deflection without checking the range of its law."""

    def step(present: WireState, travel: float) -> WireState | None:
        return settle(law, present, length, EndLoad(travel), travel=travel)

    return _walk_to(step, state, deflection, f"deflection={deflection!r}")


def bend_to_travel(
    law: MomentLaw, state: WireState, length: float, rig: StringRig, travel: float
) -> CantileverShape:
    """Bend a wire on the string by moving its clamp to `travel`.

    Parameters
    ----------
    law, state : law and history of the wire; `state.travel` is the present travel
    length : m
    rig : the string
    travel : m, from the initial height of the clamp, positive downwards

    Returns
    -------
    The shape; its tension is zero where the string is slack.

    Raises
    ------
    ValueError
        If no equilibrium is found on the way, or the wire is bent beyond the range of its law (the
        message states the curvature).
    """
    slack_tolerance = 1e-12  # m: a string that is just straight counts as slack

    def taut(present: WireState, travel: float) -> WireState | None:
        anchor = np.array([rig.anchor_x, rig.anchor_height + travel])
        condition = Pull(anchor, rig.string_length, rig.weight)
        bent = settle(law, present, length, condition, travel=travel)
        return bent if bent is not None and bent.load >= 0.0 else None

    def slack(present: WireState, travel: float) -> WireState | None:
        weight = DeadLoad(np.array([0.0, -rig.weight]))
        bent = settle(law, present, length, weight, travel=travel)
        if bent is None:
            return None
        if rig.travel_to_taut_string(*_tip(law, bent, length)) < travel - slack_tolerance:
            return None
        return replace(bent, load=0.0)  # exactly zero, without the rounding error of the solution

    def step(present: WireState, travel: float) -> WireState | None:
        first, second = (taut, slack) if present.load > 0.0 else (slack, taut)
        bent = first(present, travel)
        return second(present, travel) if bent is None else bent

    require_positive("length", length)
    require_finite("travel", travel)
    context = f"travel={travel!r}"
    reached = _walk_to(step, state, travel, context)
    require_within(law, reached.moment, context)
    return shape_of(law, reached, length)


def shape_of(law: MomentLaw, state: WireState, length: float) -> CantileverShape:
    """Compute the shape of a state in equilibrium."""
    stations = chebyshev_stations(len(state.moment))
    curvature = respond(law, state.moment, state.plays).curvature
    angle = length * stations.from_clamp @ curvature
    return CantileverShape(
        arc_length=length * stations.position,
        x=length * stations.from_clamp @ np.cos(angle),
        y=length * stations.from_clamp @ np.sin(angle),
        angle=angle,
        moment=state.moment,
        curvature=curvature,
        force=state.force,
        tension=state.load,
        state=state,
    )


def _tip(law: MomentLaw, state: WireState, length: float) -> tuple[float, float]:
    shape = shape_of(law, state, length)
    return float(shape.x[-1]), float(shape.y[-1])


def settle(
    law: MomentLaw,
    state: WireState,
    length: float,
    condition: Condition,
    *,
    travel: float,
    guess: Unknowns | None = None,
    tolerance: float = TOLERANCE,
) -> WireState | None:
    """Find the equilibrium under a condition; None if Newton's method fails.

    Parameters
    ----------
    law, state : law and history of the wire
    length : m
    condition : fixes the load
    travel : m, of the new state
    guess : start of Newton's method; None for the state itself
    tolerance : of `newton.solve`

    Returns
    -------
    The state; None also for an equilibrium far from the guess, such as a curl.
    """
    near = Unknowns(state.moment, state.load) if guess is None else guess
    weight = state.self_weight
    root = solve(law, state.plays, length, condition, near, tolerance=tolerance, self_weight=weight)
    if root is None or _turns_too_far(root, length):
        return None
    return WireState(root.moment, root.plays, root.force, root.load, travel, weight)


def _turns_too_far(equilibrium: Equilibrium, length: float) -> bool:
    """Return whether any part of the wire turns too far from the guess to the result."""
    max_turn = 1.0  # rad, of any part of the wire in one step
    stations = chebyshev_stations(len(equilibrium.moment))
    turn = length * stations.from_clamp @ (equilibrium.curvature - equilibrium.start_curvature)
    return bool(np.max(np.abs(turn)) > max_turn)


def _walk_to(step: Step, state: WireState, goal: float, context: str) -> WireState:
    """Step the state to the goal; halve a step that fails."""
    min_step_share = 2.0**-12
    distance = goal - state.travel
    step_share, done_share = 1.0, 0.0
    start = state.travel
    while done_share < 1.0:
        next_share = min(1.0, done_share + step_share)
        next_state = step(state, goal if next_share == 1.0 else start + next_share * distance)
        if next_state is not None:
            state, done_share, step_share = next_state, next_share, min(1.0, 2.0 * step_share)
        elif step_share <= min_step_share:
            message = f"{context}: no equilibrium beyond {start + done_share * distance:.6g}"
            raise ValueError(message)
        else:
            step_share *= 0.5
    return state
