"""A cantilever of a wire that sticks and slips, and its end loads station by station."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.law.plays import PlayLaw, make_stick_slip_law
from labpipe.mechanics.wire.cantilever import (
    CantileverShape,
    bend_to_deflection,
    make_straight,
)
from labpipe.records.arrays import Floats

LENGTH = 0.085
WIRE = make_stick_slip_law(
    stick_stiffness=5e-3,
    stick_moment=0.002,
    slip_stiffness=5e-3,
    reference_moment=0.05,
    hardening=0.5,
    last_moment=0.2,
)


def by_stations(law: PlayLaw, deflections: Floats) -> Floats:
    state, loads = make_straight(law, 64), []
    for deflection in deflections:
        shape = bend_to_deflection(law, state, LENGTH, float(deflection))
        state = shape.state
        loads.append(shape.force[1])
    return np.array(loads)


def hold_level(law: PlayLaw, length: float, self_weight: float) -> CantileverShape:
    """A wire at rest whose tip a normal force holds level: 3 w L / 8 for a small sag."""
    return bend_to_deflection(law, make_straight(law, self_weight=self_weight), length, 0.0)
