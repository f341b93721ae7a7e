from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import moment_curvature
from labpipe.wire.calibration.wire_parts import WireParts, loading_law, loading_table, take_apart
from labpipe.wire.cross_section import Layer, compressed, concentric
from labpipe.wire.first_loading import force_at, load_cantilever
from labpipe.wire.friction import Contacts, insulated
from labpipe.wire.materials import ANNEALED_COPPER, Elastic, StressTable
from tests.builders.loading_tests import MU_P, MU_S, PHI, TRUTH, rig_of, section_of, wire_of
from tests.builders.stranded_wires import tube

LARGEST = 60.0


def parts_of(name: str) -> WireParts:
    wire = wire_of(name)
    return take_apart(wire.section, wire.contacts)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
@pytest.mark.parametrize(
    "factors", [(1.0, 1.0, 1.0), (0.2, 1.0, 1.0), (5.0, 1.0, 1.0), (1.0, 3.0, 0.5), (2.0, 0.3, 1.7)]
)
def test_the_law_at_other_parameters_is_that_of_another_wire(
    name: str, factors: tuple[float, float, float]
) -> None:
    """Scaled tables against the wire made anew with those numbers."""
    values = TRUTH * factors
    law = loading_law(parts_of(name), values, LARGEST)
    section = section_of(name, float(values[1]), float(values[2]))
    radial = values[0] / (MU_S + MU_P)
    rings = len(section.layers) - 1
    contacts = insulated(rings, strand=MU_S, insulation=MU_P, radial_force=float(radial))
    whole = moment_curvature(section, contacts, law.curvature[1:])
    assert law.moment[1:] == pytest.approx(whole.moment, rel=2e-6)


def test_energy_is_the_integral_of_curvature() -> None:
    law = loading_law(parts_of("A3"), TRUTH, LARGEST)
    steps = 0.5 * (law.curvature[1:] + law.curvature[:-1]) * np.diff(law.moment)
    assert law.energy[-1] == pytest.approx(steps.sum(), rel=2e-3)
    assert law.node_weight.sum() == pytest.approx(law.moment[-1], rel=1e-6)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_derivatives_by_the_logarithms(name: str) -> None:
    parts, deflection = parts_of(name), np.linspace(0.001, 0.05, 60)

    def force(values: Floats) -> Floats:
        law = loading_law(parts, values, 40.0)
        return force_at(load_cantilever(law, 0.085, rig_of(0.085)), deflection)[0]

    law = loading_law(parts, TRUTH, 40.0)
    change = force_at(load_cantilever(law, 0.085, rig_of(0.085)), deflection)[1]
    for number in range(3):
        step = np.exp(1e-3 * np.eye(3)[number])
        expected = (force(TRUTH * step) - force(TRUTH / step)) / 2e-3
        assert change[number] == pytest.approx(expected, abs=3e-3 * np.abs(expected).max())


def test_phi_is_all_of_friction_in_one_ring() -> None:
    """Other coefficients with the same phi: the same moment, but for mu_s sin(alpha)."""
    section = section_of("A2")
    curvature = np.geomspace(0.01, 40.0, 30)
    other = insulated(1, strand=0.05, insulation=0.40, radial_force=PHI / 0.45)
    usual = insulated(1, strand=MU_S, insulation=MU_P, radial_force=PHI / 0.31)
    one, two = (moment_curvature(section, contacts, curvature) for contacts in (usual, other))
    assert one.moment == pytest.approx(two.moment, rel=1e-3)


def test_a_single_strand_has_no_friction() -> None:
    strand = concentric((Layer(1, 0.5e-3),), tube(1.2e-3))
    parts = take_apart(strand, Contacts((), ()))
    assert parts.friction is None
    assert parts.has == (False, True, True)
    assert np.isnan(parts.given[0])
    law = loading_law(parts, parts.given, LARGEST)
    assert law.moment[1:] == pytest.approx(
        moment_curvature(strand, Contacts((), ()), law.curvature[1:]).moment, rel=1e-6
    )


def test_what_a_wire_has() -> None:
    layers = tuple(replace(layer, material=Elastic(110e9)) for layer in section_of("A2").layers)
    bare = compressed(layers)
    smooth = insulated(1, strand=0.0, insulation=0.0, radial_force=0.15)
    parts = take_apart(bare, smooth)
    assert parts.has == (False, False, False)
    rough = insulated(1, strand=0.2, insulation=0.1, radial_force=0.0)
    assert take_apart(bare, rough).has == (True, False, False)
    assert take_apart(bare, rough).given[0] == 0.0


def test_copper_is_not_followed_beyond_what_is_known() -> None:
    parts = parts_of("A2")
    values = TRUTH * [1.0, 1.0, 1e-4]
    with pytest.raises(
        ValueError, match=r"curvature=50 1/m: the material is known up to 0\.04\d+ 1/m"
    ):
        loading_law(parts, values, 50.0)
    assert ANNEALED_COPPER.exponent == parts.copper[0].exponent


def test_a_bare_wire_of_two_materials() -> None:
    """Steel inside, copper outside, no insulation: one part for each kind."""
    core, ring = section_of("A2").layers
    bare = compressed((replace(core, material=Elastic(207e9)), ring))
    smooth = insulated(1, strand=0.0, insulation=0.0, radial_force=0.15)
    parts = take_apart(bare, smooth)
    assert [part.exponent for part in parts.copper] == [0.0, 0.44]
    assert parts.has == (False, False, True)
    law = loading_law(parts, np.array([np.nan, np.nan, 1.0]), LARGEST)
    whole = moment_curvature(bare, smooth, law.curvature[1:])
    assert law.moment[1:] == pytest.approx(whole.moment, rel=2e-6)
    assert not law.energy_change[:2].any()


SOFT = StressTable((0.01, 0.03, 0.1, 0.3), (10e6, 18e6, 24e6, 30e6))


def test_an_insulation_with_a_stress_table_scales_by_its_modulus() -> None:
    """The law of a wire whose insulation is half as stiff throughout, and its derivatives."""
    plain = section_of("A2")
    made = [
        replace(tube(1.6e-3, modulus=scale * 1e9), curve=replace(SOFT, stresses=stresses))
        for scale in (1.0, 0.5)
        for stresses in [tuple(scale * each for each in SOFT.stresses)]
    ]
    contacts = insulated(1, strand=MU_S, insulation=MU_P, radial_force=PHI / (MU_S + MU_P))
    whole, half = (replace(plain, insulation=each) for each in made)
    parts, values = take_apart(whole, contacts), TRUTH * (1.0, 0.5, 1.0)
    law = loading_law(parts, values, LARGEST)
    wanted = moment_curvature(half, contacts, law.curvature[1:])
    assert law.moment[1:] == pytest.approx(wanted.moment, rel=5e-5)
    table = loading_table(parts, values, LARGEST)
    assert table.bend(law.moment)[0] == pytest.approx(law.curvature, rel=1e-4, abs=1e-9)
    step, at = 1e-4, law.moment[20:]
    ends = [
        loading_table(parts, values * (1.0, np.exp(sign * step), 1.0), LARGEST).bend(at)[0]
        for sign in (1.0, -1.0)
    ]
    assert table.changes(at)[1] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=2e-3)
