"""The helix factor (3.18) against the energy of a helix drawn as a curve and bent.

The wire's sections turn about the neutral axis by kappa per length of wire. A strand that lies on a
helix is carried along: per length of strand it turns by that rate times the cosine of its lay. What
of that turn lies along its tangent twists it (G J), the rest bends it (E I). Tangents are taken
from the points of the curve, not from the lay angle.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.wire.strand_bending import helix_factor


def energy_ratio(lay_angle: float, poisson: float, points: int = 2000) -> float:
    """Energy of one lay of a bent helix over that of a straight strand of the wire's length."""
    turn = np.linspace(0.0, 2.0 * np.pi, points + 1)
    radius, hand = 1.0, np.sign(lay_angle)
    lay_length = 2.0 * np.pi * radius / abs(np.tan(lay_angle))
    curve = np.stack(
        [radius * np.cos(turn), hand * radius * np.sin(turn), lay_length * turn / (2.0 * np.pi)]
    )
    steps = np.diff(curve, axis=1)
    length = np.linalg.norm(steps, axis=0)
    tangent = steps / length
    # Turn of a strand's section about x, for a wire of curvature 1, per length of strand.
    rate = np.zeros_like(tangent)
    rate[0] = steps[2] / length
    twist = np.sum(rate * tangent, axis=0)
    bend = np.sum(rate**2, axis=0) - twist**2
    torsion_to_bending = 1.0 / (1.0 + poisson)  # G J / E I of a round strand
    return float(np.sum((bend + torsion_to_bending * twist**2) * length) / lay_length)


@pytest.mark.parametrize("degrees", [3.0, 12.0, -15.0, 30.0, 45.0, 70.0])
def test_factor_of_lay_angles(degrees: float) -> None:
    found = helix_factor(np.radians(degrees), 0.34)
    assert found == pytest.approx(energy_ratio(np.radians(degrees), 0.34), rel=1e-5)


@given(st.floats(0.02, 1.4), st.floats(-0.5, 0.5))
def test_any_lay_and_any_poisson(lay_angle: float, poisson: float) -> None:
    found = helix_factor(lay_angle, poisson)
    assert found == pytest.approx(energy_ratio(lay_angle, poisson), rel=1e-4)
    assert helix_factor(-lay_angle, poisson) == found


def test_the_misprint_is_no_energy() -> None:
    """(3.18) as printed, with sin for sin^2, is 6.2 % above at 12 degrees, and not even."""
    a = np.radians(12.0)
    hands = np.array([1.0, -1.0])
    printed = np.cos(a) / 2 * (1 + np.cos(a) ** 2 + hands * np.sin(a) / 1.34)
    assert printed / energy_ratio(a, 0.34) - 1.0 == pytest.approx([0.0616, -0.0944], abs=5e-4)
