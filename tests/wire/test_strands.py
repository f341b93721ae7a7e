"""Materials, and the bending of one strand and of the insulation by them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from labpipe.mechanics.wire.cross_section import Insulation, compute_tube_moment
from labpipe.mechanics.wire.materials import (
    ANNEALED_COPPER,
    Material,
    RambergOsgood,
    StressTable,
    compute_elastic_ratio,
    compute_helix_factor,
    compute_strand_moment,
)
from tests.builders.stranded_wires import elastic, perfectly_plastic

SHARP = perfectly_plastic(110e9, 60e6)

TABLE = StressTable((5e-4, 2e-3, 0.02), (55e6, 80e6, 150e6))


@given(st.floats(1e-15, 0.5), st.floats(0.05, 0.95), st.floats(1e7, 1e10))
def test_stress_undoes_strain(strain: float, exponent: float, strength: float) -> None:
    curve = RambergOsgood(110e9, strength, exponent)
    back = curve.compute_strain(curve.compute_stress(np.array([strain, -strain])))
    assert back == pytest.approx([strain, -strain], rel=1e-10)


@pytest.mark.parametrize("material", [ANNEALED_COPPER, elastic(1e9), SHARP, TABLE])
def test_odd_and_starting_with_the_modulus(material: Material) -> None:
    strain = np.array([1e-18, 1e-4, 3e-3, 0.02])
    stress = material.compute_stress(strain)
    assert material.compute_stress(-strain) == pytest.approx(-stress)
    assert material.compute_stress(np.zeros(1))[0] == 0.0
    # The plastic strain falls below the elastic only slowly: strain^1.27 for copper.
    assert stress[0] == pytest.approx(material.modulus * 1e-18, rel=1e-8)
    assert np.all(np.diff(stress) >= 0.0)
    assert np.isnan(material.compute_stress(np.array([np.nan]))[0])


DIAMETER = 0.32e-3


@pytest.mark.parametrize("angle", [0.0, 5.0, 12.0, 15.0, 30.0])
def test_helix_factor_is_an_energy_average(angle: float) -> None:
    """A helix in pure bending: energy of bending about normal and binormal, and of torsion.

    The wire's curvature turns with the strand: the tangent's share twists the strand, the rest
    bends it. The moment is the derivative of the energy per length of wire, averaged over a turn.
    """
    a, nu = np.radians(angle), 0.34
    turn = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    normal = np.cos(turn)
    tangent, binormal = np.sin(turn) * np.sin(a), np.sin(turn) * np.cos(a)
    # Curvatures are per length of strand (cos a of that of the wire), the energy per length of
    # wire (1 / cos a of that of the strand); G J / E I = 1 / (1 + nu).
    squares = (normal**2 + binormal**2 + tangent**2 / (1.0 + nu)) * np.cos(a) ** 2 / np.cos(a)
    assert compute_helix_factor(a, nu) == pytest.approx(float(squares.mean()), rel=1e-12)


STEEPER = StressTable((5e-4, 2e-3, 3e-3, 0.02), (55e6, 80e6, 120e6, 150e6))


@pytest.mark.parametrize("material", [SHARP, TABLE, STEEPER], ids=["sharp", "table", "steeper"])
def test_a_curve_of_straight_lines_is_exact(
    material: StressTable,
) -> None:
    def part(angle: float, rim: float) -> float:
        stress = float(material.compute_stress(np.array([rim * np.sin(angle)]))[0])
        return stress * float(np.sin(angle) * np.cos(angle) ** 2)

    strains, _ = material.corners
    for rim in (1e-4, 5.4e-4, 5.5e-4, 1e-3, 2.5e-3, 5e-3, 0.02):
        ends = [0.0, *np.arcsin(strains[strains < rim] / rim).tolist(), np.pi / 2.0]
        whole = sum(quad(part, a, b, args=(rim,), epsrel=1e-13)[0] for a, b in pairwise(ends))
        share = 16.0 / np.pi * whole / (material.modulus * rim)
        assert compute_elastic_ratio(material, np.array([rim]))[0] == pytest.approx(
            share, rel=1e-13
        )


SOFT = StressTable((0.01, 0.03, 0.1, 0.3), (10e6, 18e6, 24e6, 30e6))

TUBE = Insulation(0.5e-3, 0.3e-3, 1e9, curve=SOFT)


def by_laminae(curvature: float) -> float:
    """Stress times lever over the ring, by its heights alone."""
    y = np.linspace(-0.8e-3, 0.8e-3, 400_001)
    outer = 2.0 * np.sqrt(np.maximum(0.8e-3**2 - y**2, 0.0))
    inner = 2.0 * np.sqrt(np.maximum(0.5e-3**2 - y**2, 0.0))
    stress = np.interp(np.abs(y) * curvature, [0.0, *SOFT.strains], [0.0, *SOFT.stresses])
    return float(np.trapezoid(np.sign(y) * stress * y * (outer - inner), y))


@pytest.mark.parametrize("curvature", [5.0, 125.0])
def test_a_ring_with_a_stress_table(curvature: float) -> None:
    ring = compute_tube_moment(TUBE, np.array([curvature, -curvature]))
    assert ring.moment == pytest.approx([by_laminae(curvature), -by_laminae(curvature)], rel=1e-5)
    straight = compute_tube_moment(replace(TUBE, curve=None), np.array([curvature]))
    assert straight.moment == pytest.approx(TUBE.bending_stiffness * curvature)
    step = 1e-3 * curvature
    slope = (by_laminae(curvature + step) - by_laminae(curvature - step)) / (2.0 * step)
    assert ring.tangent_stiffness[0] == pytest.approx(slope, rel=1e-3)


def test_a_table_is_followed_to_its_last_strain() -> None:
    assert TABLE.modulus == pytest.approx(110e9)
    assert TABLE.largest_strain == 0.02
    assert SHARP.compute_stress(np.array([-0.1, 1e-4, 0.1])) == pytest.approx([-60e6, 11e6, 60e6])
    strain = np.array([1.25e-3, 0.011, 0.02, 0.021])
    stress = [67.5e6, 115e6, 150e6, np.nan]
    assert TABLE.compute_stress(strain) == pytest.approx(stress, nan_ok=True)
    last = 2.0 * 0.02 / DIAMETER
    assert np.isfinite(compute_strand_moment(TABLE, DIAMETER, np.array([last])).moment[0])
    assert np.isnan(compute_elastic_ratio(TABLE, np.array([np.nan, 0.021]))).all()


@pytest.mark.parametrize("material", [SHARP, TABLE, STEEPER, ANNEALED_COPPER])
def test_the_tangent_is_the_slope_and_the_moment_is_odd(material: Material) -> None:
    curvature = np.linspace(0.5, 100.0, 20001)
    strand = compute_strand_moment(material, DIAMETER, curvature)
    slope = np.gradient(strand.moment, curvature)[5:-5]
    is_smooth = material is ANNEALED_COPPER
    close = 1e-5 * slope if is_smooth else 1e-4 * strand.tangent_stiffness[0]
    assert np.all(np.abs(strand.tangent_stiffness[5:-5] - slope) <= close)
    assert compute_strand_moment(material, DIAMETER, -curvature).moment == pytest.approx(
        -strand.moment
    )
    empty = compute_strand_moment(material, DIAMETER, np.array([np.nan]))
    assert np.isnan([empty.moment[0], empty.tangent_stiffness[0]]).all()


def test_limits() -> None:
    stiffness = 110e9 * np.pi * DIAMETER**4 / 64.0
    low = compute_strand_moment(SHARP, DIAMETER, np.array([0.0, 1.0]))
    assert low.moment == pytest.approx([0.0, stiffness])
    assert low.tangent_stiffness == pytest.approx([stiffness, stiffness])
    high = compute_strand_moment(SHARP, DIAMETER, np.array([5000.0]))
    assert high.moment[0] == pytest.approx(60e6 * DIAMETER**3 / 6.0, rel=1e-5)
    straight = compute_strand_moment(elastic(110e9), DIAMETER, np.array([-2.0, 1e3]))
    assert straight.moment == pytest.approx([-2.0 * stiffness, 1e3 * stiffness])
    assert straight.tangent_stiffness == pytest.approx([stiffness, stiffness])


def test_copper_against_adaptive_integration() -> None:
    def part(y: float, curvature: float) -> float:
        stress = float(ANNEALED_COPPER.compute_stress(np.array([y * curvature]))[0])
        return 4.0 * stress * y * float(np.sqrt((DIAMETER / 2.0) ** 2 - y**2))

    for curvature in (0.5, 5.0, 100.0):
        exact = quad(part, 0.0, DIAMETER / 2.0, args=(curvature,), epsrel=1e-9, epsabs=0.0)[0]
        strand = compute_strand_moment(ANNEALED_COPPER, DIAMETER, np.array([curvature]))
        assert strand.moment[0] == pytest.approx(exact, rel=3e-4)
    fine = compute_elastic_ratio(ANNEALED_COPPER, np.geomspace(1e-6, 0.05, 60), n_points=400)
    assert compute_elastic_ratio(ANNEALED_COPPER, np.geomspace(1e-6, 0.05, 60)) == pytest.approx(
        fine
    )
