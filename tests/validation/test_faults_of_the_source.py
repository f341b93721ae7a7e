"""Effects of the source's faults, computed: the numbers of docs/explanations/wire-model.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from labpipe.law.plays import LinearLaw
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import MomentCurve, moment_curvature, play_law
from labpipe.wire.cantilever import (
    StringRig,
    bend_to_travel,
    bend_under_force,
    straight,
)
from labpipe.wire.end_load_path import end_load_path
from labpipe.wire.friction import arrange, sines, slip_onsets
from labpipe.wire.materials import RambergOsgood
from labpipe.wire.strand_bending import helix_factor
from tests.builders.stranded_wires import contacts_of, wire

KAPPA = np.array([1.0, 5.0, 20.0])


def law(name: str) -> MomentCurve:
    return moment_curvature(wire(name), contacts_of(wire(name)), KAPPA)


def per_cent(change: Floats, name: str) -> Floats:
    return 100.0 * change / law(name).moment


@pytest.mark.parametrize(("name", "told"), [("A2", 1.8), ("A3", 3.0), ("C4", 2.3)])
def test_moment_of_axial_forces_without_the_cosine(name: str, told: float) -> None:
    section = wire(name)
    first = section.layers[0].count
    bundle = arrange(section, contacts_of(section), sines(section, 0.0))
    lays = np.array([layer.lay_angle for layer in section.layers])[section.layer[first:]]
    stick = np.concatenate([ring.demand[ring.start :] for ring in bundle.rings])
    extra = float(stick @ np.abs(bundle.lever / np.cos(lays) - bundle.lever))
    assert 100.0 * extra / law(name).stick_stiffness == pytest.approx(told, abs=0.05)


@pytest.mark.parametrize(("name", "told"), [("A2", 5.3), ("A3", 6.5)])
def test_sine_for_its_square(name: str, told: float) -> None:
    printed = right = 0.0
    for layer in wire(name).layers:
        a = abs(layer.lay_angle)
        printed += layer.count * np.cos(a) / 2 * (1 + np.cos(a) ** 2 + np.sin(a) / 1.34)
        right += layer.count * helix_factor(a, 0.34)
    share = 100.0 * (printed / right - 1.0)
    assert share == pytest.approx(told, abs=0.05)
    if name == "A2":
        own = law(name).bending + law(name).plastic
        assert per_cent(share / 100.0 * own, name) == pytest.approx([2.1, 1.5, 0.9], abs=0.05)


def axial_moment(angle: Floats, *, by_size: bool) -> Floats:
    """A2's moment of axial forces with the friction limit at given angles of its six strands."""
    ring = wire("A2").layers[1]
    turn = np.arange(6) * np.pi / 3.0
    arm = 0.32e-3 * np.sin(turn)
    k = 0.21 * np.sin(ring.lay_angle)
    hold = 0.31 * 0.15 * np.expm1(k * angle) / k
    demand = KAPPA[:, None] * 110e9 * ring.area * np.cos(ring.lay_angle) ** 2 * arm
    smaller = np.where(np.abs(demand) < np.abs(hold), demand, hold)
    force = smaller if by_size else np.minimum(demand, hold)
    return np.asarray(force @ (arm * np.cos(ring.lay_angle)))


def test_raw_angle_and_signed_switch() -> None:
    turn = np.arange(6) * np.pi / 3.0
    right = np.arcsin(np.sin(turn))
    found = law("A2").stick + law("A2").slip
    assert axial_moment(right, by_size=True) == pytest.approx(found, rel=1e-9)
    raw = axial_moment(np.array([0, 1, 2, 3, -2, -1]) * np.pi / 3.0, by_size=True)
    assert raw / found == pytest.approx([1.5] * 3, abs=0.005)
    assert per_cent(raw - found, "A2") == pytest.approx([4.8, 1.3, 0.4], abs=0.06)
    signed = axial_moment(right, by_size=False)
    assert per_cent(signed - found, "A2") == pytest.approx([228, 320, 383], abs=0.5)


def test_slip_begins_next_to_the_neutral_axis() -> None:
    onset = slip_onsets(wire("A2"), contacts_of(wire("A2")))
    assert onset[[0, 1]] == pytest.approx([0.0172, 0.0212], abs=5e-5)


def test_stiffness_that_is_neither() -> None:
    found = law("A2")
    mixed = (found.bending + found.plastic + found.insulation) / KAPPA  # all slips: dF = 0
    tangent = 100.0 * (mixed / found.tangent_stiffness - 1.0)
    assert tangent == pytest.approx([18, 16, 10], abs=0.5)
    secant = 100.0 * (mixed / found.secant_stiffness - 1.0)
    assert secant == pytest.approx([-9.7, -2.7, -0.8], abs=0.05)


FIRMER_COPPER = RambergOsgood(110e9, 455e6, 0.343, "annealed copper, alternative handbook value")
"""Proof stress 54 MPa: how much the choice of a handbook matters."""


@pytest.mark.parametrize(
    ("name", "told"), [("A2", [20, 19, 9]), ("A3", [10, 12, 7]), ("C4", [6, 9, 5])]
)
def test_the_firmer_copper(name: str, told: list[float]) -> None:
    section = wire(name)
    layers = tuple(replace(layer, material=FIRMER_COPPER) for layer in section.layers)
    firmer = moment_curvature(replace(section, layers=layers), contacts_of(section), KAPPA)
    assert per_cent(firmer.moment, name) - 100.0 == pytest.approx(told, abs=0.5)


LENGTH, TIP = 0.085, 0.050
UNIT = LinearLaw(1.0)


def load_by_series(coefficients: list[float]) -> float:
    """P / EI at the tip's deflection, from dy/dx as a sum of odd powers of P x (2 l - x) / 2 EI.

    The projected length l is that whose arc is the wire's length, as in appendix A.4.
    """

    def slope(x: float, half_load: float, projected: float) -> float:
        u = half_load * x * (2.0 * projected - x)
        return sum(c * u ** (2 * i + 1) for i, c in enumerate(coefficients))

    def arc(projected: float, half_load: float) -> float:
        return float(
            quad(lambda x: np.hypot(1.0, slope(x, half_load, projected)), 0.0, projected)[0]
        )

    def gap(half_load: float) -> float:
        projected = brentq(lambda way: arc(way, half_load) - LENGTH, 0.2 * LENGTH, LENGTH)
        return float(quad(slope, 0.0, projected, args=(half_load, projected))[0]) - TIP

    return 2.0 * float(brentq(gap, 1.0, 2000.0))


def test_load_by_series() -> None:
    """At 50 mm on 85 mm with constant stiffness: appendix A.4, its last term put right, (3.26)."""
    exact = float(end_load_path(UNIT, LENGTH, np.array([TIP])).load[0])
    sums = [[1.0, 1 / 2, 3 / 8, 51 / 280], [1.0, 1 / 2, 3 / 8, 5 / 16], [1.0, 1 / 2]]
    off = [100.0 * (load_by_series(terms) / exact - 1.0) for terms in sums]
    assert off == pytest.approx([2.0, 1.4, 7.9], abs=0.05)


def load_with_the_stiffness_at_the_clamp(name: str, length: float, deflection: float) -> float:
    """End load of the elastica with the secant stiffness that the clamp's moment has."""
    kappa = np.append(0.0, np.geomspace(1e-4, 80.0, 4000))
    moment = moment_curvature(wire(name), contacts_of(wire(name)), kappa).moment
    per_stiffness = float(end_load_path(UNIT, length, np.array([deflection])).load[0])
    force = np.array([0.0, per_stiffness])
    lever = float(bend_under_force(UNIT, straight(UNIT), length, force).x[-1])

    def gap(load: float) -> float:
        at_clamp = load * lever
        return per_stiffness * at_clamp / float(np.interp(at_clamp, moment, kappa)) - load

    return float(brentq(gap, 1e-3, 1.0))


@pytest.mark.parametrize(
    ("name", "length", "told"),
    [
        ("A2", 0.085, [-6.9, -5.9, -3.1]),
        ("A3", 0.120, [-12.7, -9.9, -4.6]),
        ("C4", 0.085, [-12.3, -9.0, -2.9]),
    ],
)
def test_one_stiffness_for_the_whole_wire(name: str, length: float, told: list[float]) -> None:
    deflections = np.array([0.005, 0.010, 0.050])
    # Plays cut corners: 240 of them, for the difference is to be that of the stiffness.
    law = play_law(wire(name), contacts_of(wire(name)), largest_curvature=80.0, n_plays=240)
    exact = end_load_path(law, length, deflections).load
    found = [load_with_the_stiffness_at_the_clamp(name, length, at) for at in deflections]
    assert 100.0 * (found / exact - 1.0) == pytest.approx(told, abs=0.06)


@pytest.mark.parametrize(
    ("name", "length", "told"),
    [("A2", 0.085, (3.2, 4.4)), ("C4", 0.085, (2.9, 4.1)), ("A3", 0.120, (1.5, 1.8))],
)
def test_lean_of_the_string(name: str, length: float, told: tuple[float, float]) -> None:
    """At 50 mm of travel, without the counterweight's own pull: see also `test_elastica`."""
    weight, travel = 0.0027 * 9.80665, 0.050
    law = play_law(wire(name), contacts_of(wire(name)), largest_curvature=80.0)
    rig, state = StringRig(0.760, weight, length, 0.760), straight(law)
    for step in travel * np.linspace(0.0, 1.0, 11):
        shape = bend_to_travel(law, state, length, rig, float(step))
        state = shape.state
    tip = float(shape.y[-1])
    upright = end_load_path(law, length, np.array([travel, tip])).load
    force = shape.tension - weight
    assert 100.0 * (force / upright[1] - 1.0) == pytest.approx(told[0], abs=0.06)
    assert 100.0 * (force / upright[0] - 1.0) == pytest.approx(told[1], abs=0.06)
