"""Love (1927), secs. 260-263: the elastica, here on two rollers, by shooting with an ODE solver.

The solver integrates d slope / ds = M and dM / ds = -V cos slope + H sin slope from the roller to
mid-span and shares nothing with the quadrature of the first integral.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from labpipe.fits.beam_stiffness import Rollers, path_of_load
from labpipe.records.arrays import Floats


def load_by_shooting(rollers: Rollers, deflection: float) -> float:
    span, radius, friction = rollers.span, rollers.radius, rollers.friction

    def missed(unknown: Floats) -> list[float]:
        slope, push, length = (float(each) for each in unknown)
        up = push * (np.cos(slope) + friction * np.sin(slope))
        out = push * (-np.sin(slope) + friction * np.cos(slope))

        def path(_: float, state: Floats) -> list[float]:
            angle, bend, _, _ = state
            turn = up * np.cos(angle) - out * np.sin(angle)
            return [-bend, turn, -np.cos(angle), -np.sin(angle)]

        start = [slope, 0.0, 0.5 * span - radius * np.sin(slope), 0.0]
        end = solve_ivp(path, [0.0, length], start, rtol=1e-10, atol=1e-12).y[:, -1]
        return [end[0], end[2], -end[3] + radius * (1.0 - np.cos(slope)) - deflection]

    guess = 3.0 * deflection / span
    first = [guess, 24.0 * deflection / span**3, 0.5 * span * (1.0 + guess**2 / 6.0)]
    slope, push, _ = fsolve(missed, first, xtol=1e-12)
    return float(2.0 * push * (np.cos(slope) + friction * np.sin(slope)))


@pytest.mark.parametrize("deflection", [0.02, 0.1, 0.2])
@pytest.mark.parametrize(
    "rollers", [Rollers(1.0), Rollers(1.0, 0.05), Rollers(1.0, 0.0, 0.2), Rollers(1.0, 0.07, 0.3)]
)
def test_load_at_a_deflection(rollers: Rollers, deflection: float) -> None:
    known, loads = path_of_load(rollers)
    found = float(np.interp(deflection, known, loads))
    # 600 slopes joined by straight lines: 1e-5 of the load at the most.
    assert found == pytest.approx(load_by_shooting(rollers, deflection), rel=1e-5)
