"""Bisshopp and Drucker (1945): the cantilever of constant stiffness in elliptic integrals.

With p^2 = (1 + sin(tip angle)) / 2 and sin(phi) = 1 / (p sqrt 2),

    sqrt(P L^2 / EI) = K(p) - F(p, phi)
    deflection / L = 1 - 2 (E(p) - E(p, phi)) / sqrt(P L^2 / EI)
    1 - shortening / L = sqrt(2 sin(tip angle) / (P L^2 / EI)).

The closed form is taken from scipy's elliptic integrals, and itself compared with a printed table:
Mattiasson (1981), Table 1.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from labpipe.law.plays import LinearLaw
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import bend_under_force, straight
from labpipe.wire.end_load_path import end_load_path

PRINTED = {1.0: (0.30172, 0.05643, 0.46135), 2.0: (0.49346, 0.16064, 0.78175)}
PRINTED |= {5.0: (0.71379, 0.38763, 1.21537), 10.0: (0.81061, 0.55500, 1.43029)}
"""P L^2 / EI: deflection / L, shortening / L, tip angle (rad)."""


def closed_form(tip_angle: float) -> tuple[float, float, float]:
    """P L^2 / EI, deflection / L and shortening / L at a tip angle."""
    m = (1.0 + np.sin(tip_angle)) / 2.0
    phi = np.arcsin(np.sqrt(0.5 / m))
    root = float(ellipk(m) - ellipkinc(phi, m))
    deflection = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(phi, m)) / root
    return root**2, deflection, 1.0 - float(np.sqrt(2.0 * np.sin(tip_angle))) / root


@pytest.mark.parametrize("load", sorted(PRINTED))
def test_the_closed_form_is_the_printed_table(load: float) -> None:
    angle = brentq(lambda angle: closed_form(angle)[0] - load, 0.01, 1.57)
    assert (*closed_form(angle)[1:], angle) == pytest.approx(PRINTED[load], abs=5.1e-6)


@given(st.floats(0.01, 1.5))
def test_shapes_at_any_load(tip_angle: float) -> None:
    load, deflection, shortening = closed_form(tip_angle)
    law, length = LinearLaw(3e-3), 0.085
    force = np.array([0.0, load * law.stiffness / length**2])
    shape = bend_under_force(law, straight(law), length, force)
    found = (shape.y[-1] / length, 1.0 - shape.x[-1] / length, shape.angle[-1])
    assert found == pytest.approx((deflection, shortening, tip_angle), abs=1e-9)


def test_loads_of_a_whole_curve() -> None:
    """Up to a deflection of 0.85 of the length, where the tip stands at 87 degrees."""
    rows: Floats = np.array([closed_form(angle) for angle in np.linspace(0.05, 1.52, 30)])
    law, length = LinearLaw(3e-3), 0.085
    found = end_load_path(law, length, rows[:, 1] * length).load
    # A curve stops at changes of 1e-6; 1.2e-8 is what it was off by.
    assert found * length**2 / law.stiffness == pytest.approx(rows[:, 0], rel=1e-7)
