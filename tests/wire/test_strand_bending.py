from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from labpipe.wire.materials import (
    ANNEALED_COPPER,
    Elastic,
    ElasticPerfectlyPlastic,
    Material,
    StressTable,
)
from labpipe.wire.strand_bending import elastic_share, helix_factor, strand_moment

DIAMETER = 0.32e-3
SHARP = ElasticPerfectlyPlastic(110e9, 60e6)
TABLE = StressTable((5e-4, 2e-3, 0.02), (55e6, 80e6, 150e6))


def test_helix_factor_of_the_source_put_right() -> None:
    found = [helix_factor(np.radians(a), 0.34) for a in (0.0, 12.0, 15.0)]
    assert found == pytest.approx([1.0, 0.9728, 0.9577], abs=5e-5)
    assert helix_factor(-0.2, 0.34) == helix_factor(0.2, 0.34)


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
    assert helix_factor(a, nu) == pytest.approx(float(squares.mean()), rel=1e-12)


@pytest.mark.parametrize("material", [ANNEALED_COPPER, SHARP, TABLE])
def test_against_adaptive_integration(material: Material) -> None:
    radius = DIAMETER / 2.0
    for curvature in (0.5, 5.0, 35.0, 100.0):

        def moment(y: float, kappa: float = curvature) -> float:
            stress = float(material.stress(np.array([y * kappa]))[0])
            return 4.0 * stress * y * float(np.sqrt(radius**2 - y**2))

        exact = quad(moment, 0.0, radius, limit=400, epsrel=1e-9, epsabs=0.0)[0]
        found = strand_moment(material, DIAMETER, np.array([curvature])).moment[0]
        assert found == pytest.approx(exact, rel=3e-4)


def test_laminae_converge() -> None:
    """0.2 % is asked for; a smooth curve is met far closer. The source's 11 are 4.6 % low."""
    rim = np.geomspace(1e-6, 0.05, 60)
    fine = elastic_share(ANNEALED_COPPER, rim, laminae=400)
    assert elastic_share(ANNEALED_COPPER, rim) == pytest.approx(fine, rel=1e-6)
    height = np.linspace(0.0, 1.0, 11)
    eleven = 4.0 * np.sum(np.sqrt(1.0 - height**2) * height**2) * 0.1 / (np.pi / 4.0)
    assert eleven == pytest.approx(1.0 - 0.046, abs=5e-4)


STEEPER = StressTable((5e-4, 2e-3, 3e-3, 0.02), (55e6, 80e6, 120e6, 150e6))


@pytest.mark.parametrize("material", [SHARP, TABLE, STEEPER], ids=["sharp", "table", "steeper"])
@pytest.mark.parametrize("rim", [1e-4, 5.4e-4, 5.5e-4, 6e-4, 1e-3, 2.5e-3, 5e-3, 0.02])
def test_a_curve_of_straight_lines_is_exact(
    material: ElasticPerfectlyPlastic | StressTable, rim: float
) -> None:
    def part(angle: float) -> float:
        stress = float(material.stress(np.array([rim * np.sin(angle)]))[0])
        return stress * float(np.sin(angle) * np.cos(angle) ** 2)

    strains, _ = material.corners
    ends = [0.0, *np.arcsin(strains[strains < rim] / rim).tolist(), np.pi / 2.0]
    whole = sum(quad(part, a, b, epsrel=1e-13)[0] for a, b in pairwise(ends))
    share = 16.0 / np.pi * whole / (material.modulus * rim)
    assert elastic_share(material, np.array([rim]))[0] == pytest.approx(share, rel=1e-13)


def test_the_tangent_of_a_curve_of_straight_lines_is_its_slope() -> None:
    curvature = np.linspace(0.5, 120.0, 24001)
    for material in (SHARP, TABLE, STEEPER):
        found = strand_moment(material, DIAMETER, curvature)
        slope = np.gradient(found.moment, curvature)[5:-5]
        assert found.tangent[5:-5] == pytest.approx(slope, abs=1e-4 * found.tangent[0])
    assert np.isnan(elastic_share(TABLE, np.array([np.nan, 0.021]))).all()
    assert np.isnan(strand_moment(SHARP, DIAMETER, np.array([np.nan])).tangent[0])


def test_limits() -> None:
    stiffness = 110e9 * np.pi * DIAMETER**4 / 64.0
    low = strand_moment(SHARP, DIAMETER, np.array([0.0, 1.0]))
    assert low.moment == pytest.approx([0.0, stiffness])
    assert low.tangent == pytest.approx([stiffness, stiffness])
    high = strand_moment(SHARP, DIAMETER, np.array([5000.0]))
    assert high.moment[0] == pytest.approx(60e6 * DIAMETER**3 / 6.0, rel=1e-5)
    elastic = strand_moment(Elastic(110e9), DIAMETER, np.array([-2.0, 1e3]))
    assert elastic.moment == pytest.approx([-2.0 * stiffness, 1e3 * stiffness])
    assert elastic.tangent == pytest.approx([stiffness, stiffness])


def test_tangent_is_the_slope_and_moment_is_odd() -> None:
    curvature = np.linspace(0.5, 100.0, 20001)
    found = strand_moment(ANNEALED_COPPER, DIAMETER, curvature)
    slope = np.gradient(found.moment, curvature)[5:-5]
    assert found.tangent[5:-5] == pytest.approx(slope, rel=1e-5)
    assert strand_moment(ANNEALED_COPPER, DIAMETER, -curvature).moment == pytest.approx(
        -found.moment
    )
    assert np.isnan(strand_moment(ANNEALED_COPPER, DIAMETER, np.array([np.nan])).moment[0])


def test_not_beyond_the_material() -> None:
    last = 2.0 * 0.02 / DIAMETER
    assert np.isfinite(strand_moment(TABLE, DIAMETER, np.array([last])).moment[0])
    said = (
        r"curvature=250 1/m strains a strand of diameter=0.00032 m by 0.04: the material is "
        r"known up to 0.02, which is 125 1/m"
    )
    with pytest.raises(ValueError, match=said):
        strand_moment(TABLE, DIAMETER, np.array([1.0, 250.0]))
