"""Laws of one wire with other numbers: same slips, stiffnesses that change smoothly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.sliders import slider_moment
from labpipe.records.wire_calibration import COPPER_SCALE, INSULATION_MODULUS, RADIAL_FRICTION
from labpipe.wire.law_family import (
    LAW_FACTOR,
    MASS_FACTOR,
    TORSION_FACTOR,
    LawFamily,
    family_of,
    with_values,
)
from labpipe.wire.wire_table import wire_table
from tests.builders.wire_tables import wire_table as table_of

NAMES = ("A2", "A3", "C5")
BENT = 1.0
"""1/m: below, strands begin to slip, and a moment that is lost there has no weight."""


@pytest.fixture(scope="module", params=NAMES)
def family(request: pytest.FixtureRequest) -> LawFamily:
    return family_of(table_of(request.param).spec)


def test_its_own_numbers_give_the_law_it_was_made_from(family: LawFamily) -> None:
    own, base = family.at({}), family.base
    assert own.law.stiffness == pytest.approx(base.stiffness, rel=1e-9)
    assert own.law.stiffnesses == pytest.approx(base.stiffnesses, rel=1e-6)
    table = wire_table(family.spec)
    assert own.torsional_stiffness == table.torsional_stiffness
    assert own.axial_stiffness == table.axial_stiffness
    assert own.coupling == table.stretch_twist_coupling
    assert own.mass_per_length == table.mass_per_length


@pytest.mark.parametrize(
    "values", [{INSULATION_MODULUS: 0.6e9}, {COPPER_SCALE: 1.3}, {RADIAL_FRICTION: 0.09}]
)
def test_other_numbers_give_the_law_of_the_wire_that_has_them(
    family: LawFamily, values: dict[str, float]
) -> None:
    law = family.at({name: float(np.log(value)) for name, value in values.items()}).law
    assert law.slip_curvatures == pytest.approx(family.base.slip_curvatures, rel=0.0)
    table = wire_table(with_values(family.spec, values))
    inside = table.curvature > BENT
    moment = slider_moment(law, table.curvature[inside])
    assert np.max(np.abs(moment / table.moment[inside] - 1.0)) < 0.015


def test_stiffnesses_change_smoothly(family: LawFamily) -> None:
    """Half a step to either side changes them by half as much, all but a slope's jump."""
    for name, centre in ((INSULATION_MODULUS, 1e9), (COPPER_SCALE, 1.0)):

        def at(log: float, name: str = name, centre: float = centre) -> np.ndarray:
            law = family.at({name: float(np.log(centre)) + log}).law
            return np.append(law.stiffnesses, law.stiffness)

        whole, half = at(0.02) - at(-0.02), at(0.01) - at(-0.01)
        first = family.base.first_stiffness
        assert np.max(np.abs(whole - 2.0 * half)) < 1e-3 * np.max(np.abs(whole)) + 1e-9 * first


def test_factors_multiply_moment_torsion_and_mass(family: LawFamily) -> None:
    plain = family.at({})
    made = family.at({LAW_FACTOR: 0.1, TORSION_FACTOR: -0.2, MASS_FACTOR: 0.05})
    assert made.law.stiffnesses == pytest.approx(np.exp(0.1) * plain.law.stiffnesses)
    assert made.law.stiffness == pytest.approx(np.exp(0.1) * plain.law.stiffness)
    assert made.torsional_stiffness == pytest.approx(np.exp(-0.2) * plain.torsional_stiffness)
    assert made.mass_per_length == pytest.approx(np.exp(0.05) * plain.mass_per_length)


def test_a_table_of_the_insulation_grows_with_its_modulus() -> None:
    spec = replace(table_of("A2").spec, insulation_table=((0.01, 0.1), (10e6, 50e6)))
    made = with_values(spec, {INSULATION_MODULUS: 2e9}).insulation_table
    assert made is not None
    assert np.array(made) == pytest.approx(np.array([[0.01, 0.1], [20e6, 100e6]]))


def test_what_is_not_known_stays() -> None:
    spec = table_of("A2").spec
    assert with_values(spec, {RADIAL_FRICTION: np.nan}) == spec


def test_it_may_look_around_other_values() -> None:
    spec, values = table_of("A2").spec, {COPPER_SCALE: 1.4, INSULATION_MODULUS: 0.7e9}
    family = family_of(spec, values)
    other = wire_table(with_values(spec, values))
    assert slider_moment(family.at({}).law, other.curvature) == pytest.approx(
        other.moment, rel=1.1 * family.base.error
    )
    own = {name: float(np.log(value)) for name, value in values.items()}
    assert family.at(own).law.stiffnesses == pytest.approx(family.at({}).law.stiffnesses)
