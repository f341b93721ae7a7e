"""Wires by other ways than the package's: exact shapes, bending there and back, weight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import cumulative_simpson, solve_bvp, solve_ivp
from scipy.optimize import brentq

from labpipe.mechanics.wire.bending_law import (
    Contacts,
    RingModel,
    compute_ring_pressure,
    compute_sines,
    make_ring_model,
)
from labpipe.mechanics.wire.cross_section import CrossSection
from labpipe.mechanics.wire.materials import compute_helix_factor, compute_strand_moment
from labpipe.records.arrays import Floats, Ints

LENGTH = 0.085
MARKERS = np.linspace(0.008, 0.081, 8)
CENTRE_OFFSET = 0.0008
STIFFNESS = 2e-3
Law = Callable[[Floats], Floats]
"""Curvature (1/m) of a moment (N m), for moments above 0."""


def elastic(moment: Floats) -> Floats:
    """Straight line."""
    return np.asarray(moment / STIFFNESS)


def hardening(moment: Floats) -> Floats:
    """Power law, as of soft copper."""
    return moment / STIFFNESS * (1 + (moment / (20 * STIFFNESS)) ** 1.3)


def kinked(moment: Floats) -> Floats:
    """A fifth of the stiffness beyond a curvature of 8 per metre."""
    curvature: Floats = moment / STIFFNESS
    return np.asarray(curvature + 4 * np.maximum(curvature - 8, 0), dtype=np.float64)


LAWS: dict[str, Law] = {"elastic": elastic, "hardening": hardening, "kinked": kinked}


@dataclass(frozen=True)
class BentWire:
    """Axis of a wire at fine arc lengths, in the plane, from the clamped end."""

    arc_length: Floats
    angle: Floats
    x: Floats
    y: Floats

    def markers(self) -> Floats:
        """Centres of the eight markers, shape (8, 3)."""
        x, y, angle = (np.interp(MARKERS, self.arc_length, v) for v in (self.x, self.y, self.angle))
        across = CENTRE_OFFSET
        return np.column_stack([x - across * np.sin(angle), y + across * np.cos(angle), 0 * x])


def straight_wire() -> BentWire:
    """The wire at rest."""
    arc_length = np.linspace(0, LENGTH, 2001)
    return BentWire(arc_length, 0 * arc_length, arc_length, 0 * arc_length)


def _from_curvature(arc_length: Floats, curvature: Floats) -> BentWire:
    angle = cumulative_simpson(curvature, x=arc_length, initial=0)
    x = cumulative_simpson(np.cos(angle), x=arc_length, initial=0)
    y = cumulative_simpson(np.sin(angle), x=arc_length, initial=0)
    return BentWire(arc_length, angle, x, y)


def bent_wire(law: Law, tip_angle: float, *, unloaded: bool = False) -> BentWire:
    """Bend the wire by a load across the clamped axis to a tip angle (rad); let go if unloaded.

    Integrated backwards from the tip: angle' = -law(P lever), lever' = cos(angle). The load P is
    the one for which the clamped end is level.
    """
    back = np.linspace(0, LENGTH, 2001)

    def arc(load: float) -> Floats:
        def rates(_: float, state: Floats) -> list[float]:
            angle, lever = state
            return [-float(law(np.asarray(load * max(lever, 0.0)))), float(np.cos(angle))]

        solution = solve_ivp(
            rates, (0, LENGTH), [tip_angle, 0.0], t_eval=back, rtol=1e-9, atol=1e-12, max_step=2e-3
        )
        return np.asarray(solution.y)

    most = 0.1
    while arc(most)[0, -1] > 0:
        most *= 1.5
    load = brentq(lambda load: float(arc(load)[0, -1]), 0.0, most, xtol=1e-10)
    moment = load * arc(load)[1, ::-1]
    curvature = law(moment) - (moment / STIFFNESS if unloaded else 0.0)
    return _from_curvature(back, curvature)


STICK, SOFTENING, YIELD = 1.2e-3, 4000.0, 2e-4
"""N m^2, 1/(N m^2), N m: of `yielding`."""


def yielding(moment: Floats) -> Floats:
    """A law that softens from the start, without a corner."""
    size = np.abs(moment) / YIELD
    return np.asarray(
        moment / STICK + np.sign(moment) * SOFTENING * YIELD * (size - np.log1p(size))
    )


@dataclass(frozen=True)
class HeavyWire:
    """A wire of some law, length (m) and weight (N/m); the string's length (m), None for none."""

    law: Law
    length: float
    self_weight: float
    string: float | None = None
    counterweight: float = 0.0

    def rest(self) -> Any:
        """Held level at its tip: states theta, M, x, y over s, and the pull."""
        return self._solve(lambda _, moment: self.law(moment), 0.0, None)

    def loaded(self, rest: Any, deflection: float, guess: Any = None) -> Any:
        """From rest to a deflection that grows; every place turned back by Masing's rule."""
        return self._solve(
            lambda s, moment: self._from(rest.sol(s)[1], moment), deflection, guess or rest
        )

    def pull(self, found: Any) -> float:
        """Tension of the string, or the end load, N."""
        return float(found.p[0])

    def _from(self, before: Floats, moment: Floats) -> Floats:
        back = self.law(before) + 2.0 * self.law((moment - before) / 2.0)
        is_back = (before * (moment - before) < 0.0) & (np.abs(moment) < np.abs(before))
        return np.where(is_back, back, self.law(moment))

    def _solve(self, curvature: Callable[[Floats, Floats], Floats], tip: float, guess: Any) -> Any:
        def pulls(x_tip: float, tension: float) -> tuple[float, float]:
            if self.string is None:
                return 0.0, tension
            lean = (self.length - x_tip) / self.string
            return tension * lean, tension * np.sqrt(1.0 - lean**2) - self.counterweight

        def slopes(s: Floats, state: Floats, parameters: Floats) -> Floats:
            theta, moment = state[0], state[1]
            along, across = pulls(parameters[1], parameters[0])
            shear = across - self.self_weight * (self.length - s)
            bent = along * np.sin(theta) - shear * np.cos(theta)
            return np.array([curvature(s, moment), bent, np.cos(theta), np.sin(theta)])

        def ends(first: Floats, last: Floats, parameters: Floats) -> Floats:
            at_clamp = [first[0], first[2], first[3]]
            return np.array([*at_clamp, last[1], last[3] - tip, last[2] - parameters[1]])

        mesh = np.linspace(0.0, self.length, 401) if guess is None else guess.x
        start = np.zeros((4, 401)) if guess is None else guess.y
        if guess is None:
            start[2] = mesh
        parameters = [self.counterweight, self.length] if guess is None else guess.p
        found = solve_bvp(slopes, ends, mesh, start, p=parameters, tol=1e-5, max_nodes=20_000)
        if not found.success:
            raise ValueError(found.message)
        return found


def bend_along(
    section: CrossSection, contacts: Contacts, path: Floats, *, orientation: float = 0.0
) -> Floats:
    """Moments of a straight wire, never bent before, along a path of curvatures, N m.

    On the first loading the points are exact however far apart they are. After a turn they are
    exact for a single ring, whose pressure does not change; with more rings the limits are those at
    the end of each step.
    """
    sine = compute_sines(section, orientation)
    forward, backward = (make_ring_model(section, contacts, s) for s in (sine, -sine))
    tube = section.insulation.bending_stiffness if section.insulation else 0.0
    return _axial(forward, backward, path) + _own(section, path) + tube * path


def _axial(forward: RingModel, backward: RingModel, path: Floats) -> Floats:
    """Moment of the axial forces along a path, shape (n,)."""
    state = [np.zeros((1, ring.end_index)) for ring in forward.rings]
    moment = np.zeros(len(path))
    for i, step in enumerate(np.diff(path, prepend=0.0)):
        own = _slide(forward, backward, state, float(step))
        moment[i] = own @ forward.lever_arm
    return moment


def _slide(forward: RingModel, backward: RingModel, state: list[Floats], step: float) -> Floats:
    """Move the sliders by a step, in place; give the strands' own forces, shape (strands,)."""
    own = np.zeros(len(forward.sign))
    outer: list[Floats] = []
    for q in reversed(range(len(forward.rings))):
        there, back = forward.rings[q], backward.rings[q]
        pressure = compute_ring_pressure(forward, q, outer)
        most = pressure * there.slip_per_pressure + there.tension_slip_force
        least = -(pressure * back.slip_per_pressure + back.tension_slip_force)
        state[q] = np.clip(state[q] + step * there.stick_stiffness, least, most)
        force = state[q] * forward.sign[: there.end_index]
        own[there.start_index : there.end_index] = force[0, there.start_index :]
        outer.insert(0, force)
    return own


def _own(section: CrossSection, path: Floats) -> Floats:
    """Moment of the strands about their own axes along a path, shape (n,)."""
    point, weight, half = _remembered(path)
    moment = np.zeros(len(path))
    for layer in section.layers:
        straight = compute_strand_moment(layer.material, layer.diameter, half).moment
        share = layer.count * compute_helix_factor(layer.lay_angle, layer.poisson)
        moment += share * np.bincount(point, weight * straight, minlength=len(path))
    return moment


def _remembered(path: Floats) -> tuple[Ints, Floats, Floats]:
    """Terms of the moment at every point: which point, weight, and argument of f."""
    turns: list[float] = []
    point, weight, argument = [], [], []
    present = 0.0
    for i, target in enumerate(path.tolist()):
        if turns or present:
            _turn(turns, present, target)
        chain = [*turns, target]
        point += [i] * len(chain)
        weight += [1.0] + [2.0] * len(turns)
        argument += [chain[0], *((b - a) / 2.0 for a, b in pairwise(chain))]
        present = target
    return np.array(point, dtype=np.int64), np.array(weight), np.array(argument)


def _turn(turns: list[float], present: float, target: float) -> None:
    """Remember the turn at the present curvature if there is one; forget the loops closed."""
    came_from = turns[-1] if turns else 0.0
    if _way(present, target) == -_way(came_from, present) != 0:
        turns.append(present)
    while len(turns) > 1 and _way(turns[-2], target) in {0, _way(turns[-1], turns[-2])}:
        del turns[-2:]
    if turns and abs(target) >= abs(turns[0]):
        turns.clear()


def _way(begin: float, end: float) -> int:
    """1 up, -1 down, 0 nowhere: the product of two steps could be too small to have a sign."""
    return (end > begin) - (end < begin)
