"""The cantilever against elliptic integrals and what must hold for any law (PHYSICS 5).

Constant stiffness: Bisshopp and Drucker (1945) in scipy's elliptic integrals, with p^2 = (1 +
sin(tip angle)) / 2 and sin(phi) = 1 / (p sqrt 2): sqrt(P L^2 / EI) = K(p) - F(p, phi), deflection /
L = 1 - 2 (E(p) - E(p, phi)) / sqrt(P L^2 / EI); itself compared with Mattiasson (1981), Table 1.

A law that varies along the wire: while nothing unloads, W*(M) + P sin(psi) is the same everywhere,
W* the integral of the curvature over the moment; length and deflection are integrals over the
moment, taken by Gauss's rule between the corners of the law. On two rollers:
Love (1927), secs. 260-263, by shooting from the roller to mid-span.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from labpipe.fits.beam_stiffness import Rollers, path_of_load
from labpipe.law.plays import LinearLaw, MomentLaw
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import play_law
from labpipe.wire.cantilever import (
    StringRig,
    bend_to_travel,
    bend_under_force,
    straight,
)
from labpipe.wire.end_load_path import end_load_path
from tests.builders.bilinear_laws import bilinear_law
from tests.builders.cantilevers import LENGTH, WIRE
from tests.builders.stranded_wires import contacts_of, wire

STRING = 0.760

WEIGHT = 0.0027 * 9.80665

BILINEAR = bilinear_law(5e-3, 1.5e-3, 0.02)


def test_closed_loop_dissipates_the_loop_area() -> None:
    """Work of the string's lift over a closed loop = moments' work on curvatures, positive."""
    rig = StringRig(STRING, WEIGHT, LENGTH, STRING)
    legs = [np.linspace(0, 0.053, 120), np.linspace(0.053, 0, 120), np.linspace(0, 0.053, 120)]
    state, shapes = straight(WIRE), []
    for travel in np.concatenate(legs):
        shapes.append(bend_to_travel(WIRE, state, LENGTH, rig, float(travel)))
        state = shapes[-1].state
    loop = shapes[119:]  # from the top down and up to it again
    moment = np.array([shape.moment for shape in loop])
    curvature = np.array([shape.curvature for shape in loop])
    per_length = np.sum(0.5 * (moment[1:] + moment[:-1]) * np.diff(curvature, axis=0), axis=0)
    dissipated = np.trapezoid(per_length, loop[0].arc_length)
    lift = np.array([shape.force[1] + WEIGHT for shape in loop])
    work = np.trapezoid(lift, [shape.state.travel for shape in loop])
    assert dissipated > 1e-3
    assert work == pytest.approx(dissipated, rel=5e-3)


def _lean(law: MomentLaw, at: float) -> tuple[float, float]:
    """How much the string's lean adds to the force when the clamp has travelled `at`.

    The counterweight's own tension is taken off. First against a vertical load at the same
    deflection, then against the vertical load at a deflection equal to the travel.
    """
    rig = StringRig(STRING, WEIGHT, LENGTH, STRING)
    shape = bend_to_travel(law, straight(law), LENGTH, rig, at)
    relative = end_load_path(law, LENGTH, np.array([shape.y[-1]])).load[0]
    travelled = end_load_path(law, LENGTH, np.array([at])).load[0]
    force = shape.tension - WEIGHT
    return 100 * (force / relative - 1), 100 * (force / travelled - 1)


# How much depends on the law: the softer the wire against the counterweight, the more.
@pytest.mark.parametrize(
    ("law", "told"),
    [
        (LinearLaw(3e-3), (2.79, 4.12)),
        (BILINEAR, (2.55, 3.47)),
        (WIRE, (2.55, 3.47)),
        (play_law(wire("A2"), contacts_of(wire("A2")), largest_curvature=80.0), (3.2, 4.4)),
    ],
    ids=["linear", "bilinear", "plays", "A2"],
)
def test_lean_of_the_string(law: MomentLaw, told: tuple[float, float]) -> None:
    """50 mm of travel on 85 mm, in per cent, without the counterweight's own pull (PHYSICS 5)."""
    assert _lean(law, 0.050) == pytest.approx(told, abs=0.06 if told[0] > 3.0 else 0.02)


def closed_form(tip_angle: float) -> tuple[float, float, float]:
    """P L^2 / EI, deflection / L and shortening / L at a tip angle."""
    m = (1.0 + np.sin(tip_angle)) / 2.0
    phi = np.arcsin(np.sqrt(0.5 / m))
    root = float(ellipk(m) - ellipkinc(phi, m))
    deflection = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(phi, m)) / root
    return root**2, deflection, 1.0 - float(np.sqrt(2.0 * np.sin(tip_angle))) / root


@given(st.floats(0.01, 1.5))
@example(1.43029)
def test_shapes_at_any_load(tip_angle: float) -> None:
    """The angle of the example is that of P L^2 / EI = 10 in the printed table."""
    load, deflection, shortening = closed_form(tip_angle)
    if tip_angle == 1.43029:
        assert (load, deflection, shortening) == pytest.approx((10.0, 0.81061, 0.555), rel=1e-4)
    law, length = LinearLaw(3e-3), 0.085
    force = np.array([0.0, load * law.stiffness / length**2])
    shape = bend_under_force(law, straight(law), length, force)
    numbers = (shape.y[-1] / length, 1.0 - shape.x[-1] / length, shape.angle[-1])
    assert numbers == pytest.approx((deflection, shortening, tip_angle), abs=1e-9)


def plays(name: str) -> MomentLaw:
    return play_law(wire(name), contacts_of(wire(name)), largest_curvature=60.0)


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


# At 64 stations a single corner costs 7e-5 (2e-6 at 128), the many small ones of a wire 4e-6.
@pytest.mark.parametrize(
    ("law", "load", "within"),
    [
        (LinearLaw(3e-3), 1.2, 1e-11),
        (BILINEAR, 0.9, 1e-4),
        (plays("A2"), 0.13, 1e-5),
        (plays("C4"), 0.3, 1e-5),
    ],
    ids=["linear", "bilinear", "A2", "C4"],
)
def test_the_first_integral(law: MomentLaw, load: float, within: float) -> None:
    shape = bend_under_force(law, straight(law), LENGTH, np.array([0.0, load]))
    numbers = (shape.y[-1], shape.angle[-1], shape.moment[0])
    assert numbers == pytest.approx(by_first_integral(law, load), rel=within)


def load_by_shooting(rollers: Rollers, deflection: float) -> float:
    span, radius, friction = rollers.span, rollers.radius, rollers.friction

    def missed(unknown: Floats) -> list[float]:
        slope, push, length = (float(floats) for floats in unknown)
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


@pytest.mark.parametrize("deflection", [0.02, 0.2])
@pytest.mark.parametrize("rollers", [Rollers(1.0), Rollers(1.0, 0.05), Rollers(1.0, 0.07, 0.3)])
def test_load_at_a_deflection(rollers: Rollers, deflection: float) -> None:
    known, loads = path_of_load(rollers)
    found = float(np.interp(deflection, known, loads))
    # 600 slopes joined by straight lines: 1e-5 of the load at the most.
    assert found == pytest.approx(load_by_shooting(rollers, deflection), rel=1e-5)
