"""A law that varies along the wire: first integral, shooting and labpipe, three ways to one curve.

While nothing unloads, W*(M) + P sin(psi) is the same everywhere, W* the integral of the curvature
over the moment. So the length and the deflection are integrals over the moment,

    L = int_0^M0 dM / (P cos psi),   y = int_0^M0 sin(psi) dM / (P cos psi),
    sin(psi) = (W*(M0) - W*(M)) / P,   M0 = moment at the clamp,

taken by Gauss's rule between the corners of the law. Shooting integrates the same wire from its tip
with an initial value solver. Both work out the curvature by themselves.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from labpipe.law.plays import LinearLaw, MomentLaw
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import play_law
from labpipe.wire.cantilever import bend_under_force, straight
from tests.builders.bilinear_laws import bilinear_law
from tests.builders.stranded_wires import contacts_of, wire

LENGTH = 0.085
STIFFNESS, SECOND, BREAK = 5e-3, 1.5e-3, 0.02
BILINEAR = bilinear_law(STIFFNESS, SECOND, BREAK)


def plays(name: str) -> MomentLaw:
    return play_law(wire(name), contacts_of(wire(name)), largest_curvature=60.0)


def curvature(law: MomentLaw, moment: Floats) -> Floats:
    beyond = np.maximum(moment[..., None] - law.half_widths, 0.0)
    return np.asarray(moment / law.stiffness + np.sum(law.compliances * beyond, axis=-1))


def energy(law: MomentLaw, moment: Floats) -> Floats:
    beyond = np.maximum(moment[..., None] - law.half_widths, 0.0)
    return np.asarray(
        moment**2 / (2.0 * law.stiffness) + np.sum(law.compliances * beyond**2, axis=-1) / 2.0
    )


def by_first_integral(law: MomentLaw, load: float) -> tuple[float, float, float]:
    """Deflection, tip angle and clamp's moment of the wire."""
    roots, weights = np.polynomial.legendre.leggauss(20)

    def integrals(clamp: float) -> tuple[float, float]:
        corners = np.append(0.0, law.half_widths[law.half_widths < clamp])
        edges = np.union1d(np.append(corners, clamp), clamp * np.linspace(0.0, 1.0, 40))
        half = np.diff(edges)[:, None] / 2.0
        moment = edges[:-1, None] + half * (roots + 1.0)
        sine = (energy(law, np.array(clamp)) - energy(law, moment)) / load
        share = half * weights / (load * np.sqrt(1.0 - sine**2))
        return float(share.sum()), float((share * sine).sum())

    def left(clamp: float) -> float:
        return float(energy(law, np.array(clamp))) - load

    straight_lever = load * LENGTH
    upright = brentq(left, 0.0, straight_lever) if left(straight_lever) > 0.0 else straight_lever
    most = upright * (1.0 - 1e-9)
    clamp = brentq(lambda m: integrals(m)[0] - LENGTH, 1e-3 * most, most, xtol=1e-16)
    tip = np.arcsin(float(energy(law, np.array(clamp))) / load)
    return integrals(clamp)[1], float(tip), float(clamp)


def by_shooting(law: MomentLaw, load: float) -> tuple[float, float, float]:
    def march(tip_angle: float) -> Floats:
        def rates(_: float, state: Floats) -> list[float]:
            angle, lever, _ = state
            bent = float(curvature(law, np.array(load * lever)))
            return [-bent, float(np.cos(angle)), float(np.sin(angle))]

        start = [tip_angle, 0.0, 0.0]
        way = solve_ivp(rates, (0.0, LENGTH), start, rtol=1e-8, atol=1e-11, max_step=LENGTH / 40)
        return np.asarray(way.y[:, -1])

    tip = brentq(lambda angle: float(march(angle)[0]), 0.0, np.pi / 2.0, xtol=1e-13)
    _, lever, deflection = march(tip)
    return float(deflection), float(tip), float(load * lever)


# At 64 stations a single corner costs 7e-5 (2e-6 at 128), the many small ones of a wire 4e-6.
CASES = [
    (LinearLaw(3e-3), 1.2, 1e-11),
    (BILINEAR, 0.35, 1e-4),
    (BILINEAR, 0.9, 1e-4),
    (plays("A2"), 0.06, 1e-5),
    (plays("A2"), 0.13, 1e-5),
    (plays("C4"), 0.3, 1e-5),
]
IDS = ["linear", "bilinear", "bilinear far", "A2", "A2 far", "C4"]


@pytest.mark.parametrize(("law", "load", "within"), CASES, ids=IDS)
def test_three_ways(law: MomentLaw, load: float, within: float) -> None:
    exact = by_first_integral(law, load)
    assert by_shooting(law, load) == pytest.approx(exact, rel=1e-6)
    shape = bend_under_force(law, straight(law), LENGTH, np.array([0.0, load]))
    found = (shape.y[-1], shape.angle[-1], shape.moment[0])
    assert found == pytest.approx(exact, rel=within)


@pytest.mark.parametrize("clamp", [0.01, 0.02, 0.035, 0.05])
def test_bilinear_small_deflection(clamp: float) -> None:
    """Closed form on a hundredth of the length: beyond the break moment each part has its slope.

    With a from the clamp to where the moment is that of the break,
    y = M0 L^2 / (3 EI0) + (1 / EI1 - 1 / EI0) (M0 - Mb) a (L - a / 3) / 2.
    """
    length = LENGTH / 100.0
    a = length * max(1.0 - BREAK / clamp, 0.0)
    softer = 1.0 / SECOND - 1.0 / STIFFNESS
    first = clamp * length**2 / (3.0 * STIFFNESS)
    second = softer * max(clamp - BREAK, 0.0) * a / 2.0 * (length - a / 3.0)
    force = np.array([0.0, clamp / length])
    shape = bend_under_force(BILINEAR, straight(BILINEAR), length, force)
    assert shape.y[-1] == pytest.approx(first + second, rel=1e-4)
