"""Exact shapes of a clamped wire under an end load, by integrating the bending law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.optimize import brentq

from labpipe.records.arrays import Floats

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
