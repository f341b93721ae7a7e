from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from labpipe.law.equivalent_material import (
    EquivalentMaterial,
    equivalent_material,
)
from labpipe.records.arrays import Floats
from labpipe.wire.wire_table import wire_table as table_of
from tests.builders.wire_tables import spec_of, wire_table

DIAMETER = 1.6e-3
SECOND_MOMENT = np.pi / 64.0 * DIAMETER**4


def of_wire(name: str, **options: float) -> tuple[EquivalentMaterial, Floats, Floats]:
    table = wire_table(name)
    curvature, moment = table.curvature[1:], table.moment[1:]
    found = equivalent_material(curvature, moment, 2.0 * table.layout.wire_radius, **options)  # type: ignore[arg-type]
    return found, curvature, moment


def bar_moment(material: EquivalentMaterial, curvature: Floats) -> Floats:
    """Moments of the bar, by numerical integration over its height."""
    radius = 0.5 * material.diameter
    strain, stress = np.append(0.0, material.strain), np.append(0.0, material.stress)

    def force(y: float, bend: float) -> float:
        return float(4.0 * np.interp(y * bend, strain, stress) * y * np.sqrt(radius**2 - y**2))

    def moment(bend: float) -> float:
        kinks = strain[1:][strain[1:] < bend * radius] / bend
        return float(quad(force, 0.0, radius, args=(bend,), points=kinks, limit=200)[0])

    return np.array([moment(bend) for bend in curvature.tolist()])


def largest(error: Floats) -> float:
    return float(np.abs(error).max())


def test_a_linear_law_has_its_modulus() -> None:
    curvature = np.geomspace(0.01, 100.0, 60)
    material = equivalent_material(curvature, 4e-4 * curvature, DIAMETER)
    assert material.modulus == pytest.approx(4e-4 / SECOND_MOMENT)
    assert largest(material.error) < 1.1e-3
    assert material.holds_from(0.002) == curvature[0]


def test_a_perfectly_plastic_bar_is_found_again() -> None:
    yields = EquivalentMaterial(
        DIAMETER, 1e10, np.array([0.004, 0.1]), np.array([4e7, 4e7]), np.ones(1), np.zeros(1)
    )
    curvature = np.geomspace(0.1, 120.0, 200)
    moment = bar_moment(yields, curvature)
    assert moment[0] == pytest.approx(1e10 * SECOND_MOMENT * 0.1)
    assert moment[-1] == pytest.approx(4e7 * DIAMETER**3 / 6.0, rel=1e-2)
    material = equivalent_material(curvature, moment, DIAMETER, n_knots=60)
    assert material.modulus == pytest.approx(1e10, rel=1e-9)
    assert largest(material.error) < 0.005
    assert material.stress[-1] == pytest.approx(4e7, rel=0.01)


@pytest.mark.parametrize("name", ["A1", "A2", "A3", "C4"])
def test_the_law_of_a_wire_is_held_within_one_percent_where_it_is_bent(name: str) -> None:
    material, curvature, moment = of_wire(name)
    start = material.holds_from(0.01)
    assert start is not None
    assert start < 0.01 * curvature[-1]
    near = curvature >= start
    found = bar_moment(material, curvature)
    assert found[near] == pytest.approx(moment[near], rel=0.01)
    np.testing.assert_allclose(material.error, found / moment - 1.0, atol=1e-6)


def test_a_smaller_elastic_share_follows_the_law_further_down() -> None:
    coarse, fine = of_wire("A2")[0], of_wire("A2", elastic_share=1e-4, n_knots=40)[0]
    assert largest(fine.error) < 0.05 < 0.5 < largest(coarse.error)
    starts = fine.holds_from(0.01), coarse.holds_from(0.01)
    assert None not in starts
    assert starts[0] < 0.1 * starts[1]  # type: ignore[operator]


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_the_stress_never_falls_and_the_plastic_strain_grows(name: str) -> None:
    material, curvature, _ = of_wire(name)
    assert (np.diff(material.stress, prepend=0.0) >= 0.0).all()
    assert material.plastic_strain[0] == 0.0
    assert (np.diff(material.plastic_strain) > 0.0).all()
    assert material.strain[-1] == pytest.approx(curvature[-1] * 0.5 * material.diameter)
    assert material.elastic_curvature == pytest.approx(0.002 * curvature[-1])


def test_a_law_that_stiffens_is_nowhere_near() -> None:
    curvature = np.geomspace(0.1, 100.0, 60)
    material = equivalent_material(curvature, 1e-6 * curvature**2, DIAMETER)
    assert largest(material.error) > 0.5
    assert material.holds_from(0.01) is None


@pytest.mark.parametrize(
    ("curvature", "moment", "options", "message"),
    [
        ([1.0], [1.0], {}, "1 curvatures and 1 moments: allowed are as many of both, at least 2"),
        ([0.0, 1.0], [1.0, 2.0], {}, "allowed are finite, increasing, positive curvatures"),
        ([1.0, np.nan], [1.0, 2.0], {}, "allowed are finite, increasing, positive curvatures"),
        ([1.0, 2.0], [0.0, 2.0], {}, "allowed are finite, increasing, positive curvatures"),
        ([1.0, 2.0], [1.0, 2.0], {"elastic_share": 0.0}, r"elastic_share=0\.0, n_knots=24: "),
        ([1.0, 2.0], [1.0, 2.0], {"n_knots": 1}, r"elastic_share=0\.002, n_knots=1: allowed"),
    ],
)
def test_what_is_no_law_is_refused(
    curvature: list[float], moment: list[float], options: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        equivalent_material(np.array(curvature), np.array(moment), DIAMETER, **options)  # type: ignore[arg-type]


def test_a_search_with_many_turns_is_not_ended_half_way() -> None:
    sticks = replace(
        spec_of("C5", "C5"), layout="packed", copper_n=0.23, friction_insulation=0.003,
        friction_strand=0.274, radial_force=1.0,
    )  # fmt: skip
    table = table_of(sticks)
    curvature, moment = table.curvature[1:], table.moment[1:]
    found = equivalent_material(curvature, moment, 2.0 * table.layout.wire_radius)
    slopes = np.diff(found.stress) / np.diff(found.strain) / found.modulus
    assert np.all((slopes > -1e-12) & (slopes < 1.0))
    above = found.curvature > found.elastic_curvature
    assert np.sum(found.error[above] ** 2) < 0.102  # 0.1031 where it ended half-way
