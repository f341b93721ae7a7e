"""The clamped wire in large deflection, each station with its own history (PHYSICS 5).

The frame is that of the clamp: x along the undeformed axis from the clamped end, y in the plane of
bending towards the pull; theta is the angle of the tangent from x. With the force (Px, Py) at the
tip and the wire's own weight w per length,

    M(s) = integral from s to L of ((Py - w (L - s)) cos theta - Px sin theta),
    theta(s) = integral of kappa(M),

at the stations of `wire.newton`; the load (an end load or the tension of the string) is one more
unknown, fixed by one more condition. A path is followed in steps that are halved where Newton's
method fails. Unlike the dissertation it uses no series and no single stiffness for the whole wire.

The clamp is driven down, which in its own frame lifts the anchor of the string. The string is taut
or slack; the counterweight always hangs at the tip.

A wire with weight is mounted level and bends under its weight before the test. Its path therefore
starts from this equilibrium and its history, not from zero moment (PHYSICS 8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, TypeAlias

import numpy as np

from labpipe.mechanics.law.plays import (
    CurvatureAndSlope,
    PlayLaw,
    require_finite,
    require_not_negative,
    require_positive,
    require_within,
)
from labpipe.mechanics.wire.newton import (
    Condition,
    Demand,
    Wire,
    bend_wire,
    make_stations,
    solve,
)
from labpipe.records.arrays import ArrayRecord, Floats, Ints

DEFAULT_STATIONS = 64  # above about 100, BLAS starts threads, which is slower


@dataclass(frozen=True, slots=True, eq=False)
class WireState(ArrayRecord):
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

    moment: Annotated[Floats, "stations"]
    plays: Annotated[Floats, "stations", "plays"]
    force: Annotated[Floats, 2]
    load: float = 0.0
    travel: float = 0.0
    self_weight: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CantileverShape:
    """A wire in equilibrium; arrays are of shape (stations,) from the clamp to the tip.

    Parameters
    ----------
    arc_length, x, y : m
    angle : rad
    curvature : 1/m
    state : start of the next step
    """

    arc_length: Floats
    x: Floats
    y: Floats
    angle: Floats
    curvature: Floats
    state: WireState

    @property
    def moment(self) -> Floats:
        """Return the moments, N m."""
        return self.state.moment

    @property
    def force(self) -> Floats:
        """Return the force at the tip, N, shape (2,): string and counterweight together."""
        return self.state.force

    @property
    def tension(self) -> float:
        """Return the tension of the string, N; 0 where there is none or it is slack."""
        return self.state.load


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


@dataclass(frozen=True, slots=True, eq=False)
class DeadLoad:
    """A given force, N, shape (2,); the load is unused and zero."""

    force: Floats

    def demand(self, tip: Floats, load: Floats, rows: Ints) -> Demand:  # noqa: ARG002
        """Return the force itself."""
        nothing = np.zeros_like(tip)
        return Demand(nothing + self.force, nothing, load, nothing, gap_by_load=1.0)


@dataclass(frozen=True, slots=True, eq=False)
class AtDeflection:
    """A pull that brings the tip to `deflection`, m, shape (equilibria,).

    The load is the tension of a string that just reaches the tip; without a rig, a force normal to
    the clamped axis.
    """

    deflection: Floats
    rig: StringRig | None = None

    def demand(self, tip: Floats, load: Floats, rows: Ints) -> Demand:
        """Return the pull, and the gap to the deflection."""
        upwards = np.zeros_like(tip)
        upwards[:, 1] = 1.0
        gap = tip[:, 1] - self.deflection[rows]
        if self.rig is None:
            return Demand(load[:, None] * upwards, upwards, gap, upwards)
        lean = (self.rig.anchor_x - tip[:, 0]) / self.rig.string_length
        rise = np.sqrt(1.0 - lean**2)
        direction = np.stack([lean, rise], axis=1)
        force = load[:, None] * direction - self.rig.weight * upwards
        by_tip = np.zeros((*tip.shape, 2))
        by_tip[:, :, 0] = (load / self.rig.string_length)[:, None] * np.stack(
            [-np.ones_like(lean), lean / rise], axis=1
        )
        return Demand(force, direction, gap, upwards, by_tip)


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """A taut string from `anchor` (shape (2,), m) of `length`, and a `weight` (N) at the tip."""

    anchor: Floats
    length: float
    weight: float

    def demand(self, tip: Floats, load: Floats, rows: Ints) -> Demand:  # noqa: ARG002
        """Return tension and weight; the gap is the string's stretch."""
        to_anchor = self.anchor - tip
        distance = np.hypot(*to_anchor.T)
        by_load = to_anchor / self.length
        force = load[:, None] * by_load - np.array([0.0, self.weight])
        by_tip = -(load / self.length)[:, None, None] * np.eye(2)
        return Demand(
            force, by_load, distance - self.length, -to_anchor / distance[:, None], by_tip
        )


Step: TypeAlias = Callable[[WireState, float], WireState | None]


def make_straight(
    law: PlayLaw, n_stations: int = DEFAULT_STATIONS, *, self_weight: float = 0.0
) -> WireState:
    """Return the state of a straight wire that was never bent.

    Parameters
    ----------
    law : of the wire
    n_stations : along it
    self_weight : N/m, of the wire; acts from the first step on
    """
    require_not_negative("self_weight", self_weight)
    unbent = law.make_unbent_history(n_stations)
    return WireState(np.zeros(n_stations), unbent, np.zeros(2), self_weight=self_weight)


def hold_level(law: PlayLaw, length: float, self_weight: float) -> CantileverShape:
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
    return bend_to_deflection(law, make_straight(law, self_weight=self_weight), length, 0.0)


def bend_under_force(
    law: PlayLaw, state: WireState, length: float, force: Floats
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
    start, target = state.force, np.asarray(force, dtype=np.float64)
    require_positive("length", length)
    require_finite("force", target)

    def step(present: WireState, share: float) -> WireState | None:
        condition = DeadLoad(start + share * (target - start))
        return settle(law, present, length, condition, travel=share)

    place = f"force={target.tolist()}"
    return _within_law(law, _walk_to(step, replace(state, travel=0.0), 1.0, place), length, place)


def bend_to_deflection(
    law: PlayLaw, state: WireState, length: float, deflection: float
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
    return _within_law(law, reached, length, f"deflection={deflection!r}")


def deflect(
    law: PlayLaw,
    state: WireState,
    length: float,
    deflection: float,
    rig: StringRig | None = None,
) -> WireState:
    """Bend a wire to a deflection without checking the range of its law.

    Parameters
    ----------
    law, state, length, deflection : as for `bend_to_deflection`
    rig : string that pulls; None for a force normal to the clamped axis
    """

    def step(present: WireState, travel: float) -> WireState | None:
        return settle(law, present, length, AtDeflection(np.array([travel]), rig), travel=travel)

    return _walk_to(step, state, deflection, f"deflection={deflection!r}")


def bend_to_travel(
    law: PlayLaw, state: WireState, length: float, rig: StringRig, travel: float
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
        solution = settle(law, present, length, condition, travel=travel)
        return solution if solution is not None and solution.load >= 0.0 else None

    def slack(present: WireState, travel: float) -> WireState | None:
        weight = DeadLoad(np.array([0.0, -rig.weight]))
        solution = settle(law, present, length, weight, travel=travel)
        if solution is None:
            return None
        tip = compute_shape(law, solution, length)
        if rig.travel_to_taut_string(float(tip.x[-1]), float(tip.y[-1])) < travel - slack_tolerance:
            return None
        # exactly zero, without the rounding error of the solution
        return replace(solution, load=0.0)

    def step(present: WireState, travel: float) -> WireState | None:
        first, second = (taut, slack) if present.load > 0.0 else (slack, taut)
        solution = first(present, travel)
        return second(present, travel) if solution is None else solution

    require_positive("length", length)
    require_finite("travel", travel)
    place = f"travel={travel!r}"
    return _within_law(law, _walk_to(step, state, travel, place), length, place)


def _within_law(law: PlayLaw, state: WireState, length: float, place: str) -> CantileverShape:
    require_within(law, state.moment, place)
    return compute_shape(law, state, length)


def compute_shape(law: PlayLaw, state: WireState, length: float) -> CantileverShape:
    """Compute the shape of a state in equilibrium."""
    stations = make_stations(len(state.moment), length)
    curvature = law.respond(state.moment, state.plays).curvature
    angle = stations.from_clamp @ curvature
    x, y = (stations.from_clamp @ part for part in (np.cos(angle), np.sin(angle)))
    return CantileverShape(stations.position, x, y, angle, curvature, state)


def settle(
    law: PlayLaw,
    state: WireState,
    length: float,
    condition: Condition,
    *,
    travel: float,
    guess: tuple[Floats, float] | None = None,
    tolerance: float = 1e-7,
) -> WireState | None:
    """Find the equilibrium under a condition; None if Newton's method fails.

    Parameters
    ----------
    law, state : law and history of the wire
    length : m
    condition : fixes the load
    travel : m, of the new state
    guess : moments and load to start from; None for those of the state
    tolerance : of `newton.solve`; the next change is of its square

    Returns
    -------
    The state; None also for an equilibrium far from the guess, such as a curl.
    """
    max_turn = 1.0  # rad, of any part of the wire in one step
    floor_share = 1e-9  # of the moment that bends the wire by a radian
    moment, load = (state.moment, state.load) if guess is None else guess
    stations = make_stations(len(moment), length)
    bend = partial(_bend_plays, law, state.plays)
    wire = Wire(bend, stations, state.self_weight, condition)
    floor = floor_share * law.stiffness / length
    solved = solve(wire, moment[None], np.array([load]), tolerance=tolerance, floor=floor)
    if solved is None:
        return None
    bent_wire = bend_wire(wire, *solved)
    turn = stations.from_clamp @ (bent_wire.curvature - bend(moment[None])[0])[0]
    if np.max(np.abs(turn)) > max_turn:
        return None
    plays = law.respond(solved[0][0], state.plays).plays
    force, load = bent_wire.wanted.force[0], float(solved[1][0])
    return WireState(solved[0][0], plays, force, load, travel, state.self_weight)


def _bend_plays(law: PlayLaw, plays: Floats, moment: Floats) -> CurvatureAndSlope:
    response = law.respond(moment[0], plays)
    return response.curvature[None], response.compliance[None]


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
