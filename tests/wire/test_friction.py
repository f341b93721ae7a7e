from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labpipe.wire.friction import (
    Contacts,
    arrange,
    axial_forces,
    axial_strain,
    friction_angle,
    insulated,
    sines,
    slip_onsets,
)
from tests.builders.stranded_wires import cardinal, contacts_of, wire


def test_slip_limit_solves_the_equilibrium_of_a_strand() -> None:
    """dF / d(theta) = (mu_o + mu_i) H + mu_i |sin alpha| F from the neutral axis (3.13)."""
    k, c = 0.21 * np.sin(0.2), 0.31 * 0.15
    exact = solve_ivp(lambda _, f: c + k * f, (0.0, 1.2), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert c * friction_angle(k, np.array([1.2]))[0] == pytest.approx(exact, rel=1e-8)
    assert friction_angle(0.0, np.array([1.2]))[0] == 1.2
    assert friction_angle(1e-12, np.array([1.2]))[0] == pytest.approx(1.2)


def test_strands_with_the_same_sine_have_the_same_friction() -> None:
    section = wire("A2")
    onset = slip_onsets(section, contacts_of(section))
    assert onset[1] == pytest.approx(onset[2], rel=1e-9)
    assert onset[4] == pytest.approx(onset[5], rel=1e-9)


def test_one_ring_slips_where_demand_meets_the_limit() -> None:
    section, contacts = wire("A2"), contacts_of(wire("A2"))
    ring = section.layers[1]
    k = 0.21 * np.sin(ring.lay_angle)
    theta = np.pi / 3.0
    hold = 0.31 * 0.15 * np.expm1(k * theta) / k
    demand = 110e9 * ring.area * 0.32e-3 * np.sin(theta) * np.cos(ring.lay_angle) ** 2
    onset = slip_onsets(section, contacts)
    assert onset[1] == pytest.approx(hold / demand, rel=1e-12)
    # The limit next to the neutral axis, where slip begins.
    first = 0.31 * 0.15 / (demand / np.sin(theta))
    assert onset[0] == pytest.approx(first, rel=1e-8)
    assert onset[0] == onset.min()


def test_no_friction_slips_at_once() -> None:
    section = wire("A3")
    free = insulated(2, strand=0.0, insulation=0.0, radial_force=0.15)
    assert np.all(slip_onsets(section, free) < 1e-9)


def test_stuck_below_the_onset_and_slipping_above() -> None:
    section = wire("C4")
    contacts = contacts_of(section)
    onset = slip_onsets(section, contacts)
    sine = sines(section, 0.0)
    bundle = arrange(section, contacts, sine)
    for factor, sticks in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        stuck = axial_forces(bundle, factor * onset[None]).stuck[0]
        assert np.all(stuck[sine != 0.0] == sticks)


def test_pressure_from_outer_rings_is_never_negative() -> None:
    """With little radial force the outer ring lifts off on the side in compression."""
    section = wire("A3")
    weak = Contacts((0.9, 0.9), (0.9, 0.9), 1e-6)
    bundle = arrange(section, weak, sines(section, 0.0))
    found = axial_forces(bundle, np.linspace(0.0, 30.0, 400)[:, None])
    assert np.all(found.force * bundle.sign >= 0.0)
    tension, compression = found.force[-1, 1], found.force[-1, 4]
    assert abs(compression) < tension


def test_slope_is_the_derivative() -> None:
    section = wire("C4")
    bundle = arrange(section, contacts_of(section), sines(section, 0.1), tension=3.0)
    kappa = np.linspace(0.0, 0.5, 20001)[:, None]
    found = axial_forces(bundle, kappa)
    numeric = np.gradient(found.force, kappa[:, 0], axis=0)
    off = np.abs(numeric - found.slope) > 1e-6 * np.abs(found.slope).max()
    assert off.mean() < 2e-3  # only next to corners


def test_tension_is_shared_by_stiffness() -> None:
    section = cardinal()
    strain = axial_strain(section, 40e3)
    pull = sum(
        lay.count * lay.material.modulus * lay.area * strain * np.cos(lay.lay_angle) ** 3
        for lay in section.layers
    )
    assert pull == pytest.approx(40e3)
    with pytest.raises(ValueError, match=r"tension=-1.0: allowed are finite numbers >= 0"):
        axial_strain(section, -1.0)


def test_lay_lengths_weigh_the_pressure() -> None:
    section = cardinal()
    plain = Contacts((0.7,) * 4, (0.35,) * 4)
    weighed = Contacts((0.7,) * 4, (0.35,) * 4, lay_lengths=True)
    sine = sines(section, 0.0)
    of = [
        arrange(section, each, sine, tension=40e3).rings[2].shares[3] for each in (plain, weighed)
    ]
    radius = np.unique(section.radius.round(7))
    lay = radius[3:] / np.tan(np.radians([11.708, 13.103]))
    assert of[0] == pytest.approx(np.sin(np.radians(13.103)) * 24 / 18)
    assert of[1] / of[0] == pytest.approx(lay[0] / lay[1], rel=1e-6)


def test_bad_contacts() -> None:
    with pytest.raises(ValueError, match="1 inner and 2 outer coefficients: allowed is one of"):
        Contacts((0.1,), (0.1, 0.2))
    with pytest.raises(ValueError, match=r"inner=\(-0.1,\), outer=\(0.1,\), radial_force=0.0"):
        Contacts((-0.1,), (0.1,))
    section = wire("A2")
    with pytest.raises(ValueError, match="2 coefficients: the wire has 1 rings"):
        arrange(section, Contacts((0.1, 0.1), (0.1, 0.1)), sines(section, 0.0))
