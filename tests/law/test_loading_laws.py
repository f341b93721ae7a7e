"""Laws as curvature over moment, what each form of a law loses, and the equivalent material."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize

from labpipe.mechanics.law.loss_card import (
    EquivalentMaterial,
    fit_dahl,
    fit_equivalent_material,
)
from labpipe.mechanics.law.plays import (
    LoadingTable,
    PlayLaw,
    compute_first_curvature,
    make_elastic_law,
)
from labpipe.records.arrays import Floats
from tests.builders.wire_tables import loss_card, wire_table

PLAYS_TABLE = PlayLaw(2.0, np.array([0.5, 1.0, 3.0]), np.array([0.5, 0.25, 1.0]))


MOMENT: Floats = np.linspace(0.0, 6.0, 61)


def test_a_law_of_plays_is_met_exactly_also_beyond_its_last_corner() -> None:
    table = LoadingTable.of_plays(PLAYS_TABLE)
    curvature, slope = table.bend(np.concatenate([MOMENT, -MOMENT]))
    assert curvature[:61] == pytest.approx(compute_first_curvature(PLAYS_TABLE, MOMENT), rel=1e-12)
    assert curvature[61:] == pytest.approx(-curvature[:61], rel=1e-12)
    assert slope[[1, 7, 20, 40]] == pytest.approx([0.5, 1.0, 1.25, 2.25], rel=1e-12)
    assert LoadingTable.of_plays(make_elastic_law(4.0)).bend(MOMENT)[0] == pytest.approx(
        MOMENT / 4.0
    )


@pytest.mark.parametrize("rest", [-2.0, -0.3, 0.0, 1.7])
def test_on_from_a_rest_as_plays_remember_it(rest: float) -> None:
    table, still = LoadingTable.of_plays(PLAYS_TABLE), np.array([rest])
    plays = PLAYS_TABLE.respond(still, PLAYS_TABLE.make_unbent_history(1)).history
    for moment in np.linspace(rest, 5.0, 23):
        response = PLAYS_TABLE.respond(np.array([moment]), plays)
        curvature, slope = table.bend_from_rest(still, np.array([[moment]]))
        assert curvature[0] == pytest.approx(response.curvature, abs=1e-12)
        if abs(moment - rest) > 1e-9:
            assert slope[0] <= response.compliance[0] + 0.5 + 1e-12


def power_law(scale: float) -> LoadingTable:
    """A smooth law of strength `scale` with its derivative by the scale's logarithm."""
    moment: Floats = np.linspace(0.0, 8.0, 4001)
    curvature = moment + (moment / scale) ** 2
    slope = 1.0 + 2.0 * moment / scale**2
    change = (-2.0 * (moment / scale) ** 2)[None]
    return LoadingTable(moment, curvature, slope[:-1], slope[1:], change[:, :-1], change[:, 1:])


def test_derivatives_by_a_parameter_with_those_of_the_rest() -> None:
    step, moment = 1e-4, np.linspace(-1.4, 4.0, 19)[None]

    def rest(scale: float) -> Floats:
        return np.full(19, -1.5 * scale)

    def bent(scale: float) -> Floats:
        return power_law(scale).bend_from_rest(rest(scale), moment)[0]

    difference = (bent(np.exp(step)) - bent(np.exp(-step))) / (2.0 * step)
    result = power_law(1.0).compute_sensitivities_from_rest(rest(1.0), moment, rest(1.0)[None])
    assert result[0] == pytest.approx(difference, rel=1e-5, abs=1e-6)


def test_the_best_dahl_law_against_a_search() -> None:
    table = wire_table("A3")
    use = (table.curvature >= 0.1) & (table.curvature <= 10.0)
    x, y = table.curvature[use], table.moment[use]
    fitted = fit_dahl(x, y)

    def largest(logs: np.ndarray) -> float:
        stiffness, height, decay = np.exp(logs)
        return float(np.max(np.abs((stiffness * x + height * -np.expm1(-x / decay)) / y - 1.0)))

    start = np.log([fitted.stiffness, fitted.moment, fitted.decay])
    assert largest(start) == pytest.approx(fitted.error)
    searched = minimize(largest, start, method="Nelder-Mead", options={"maxiter": 4000})
    assert fitted.error < 1.005 * searched.fun


DIAMETER = 1.6e-3


SECOND_MOMENT = np.pi / 64.0 * DIAMETER**4


def fit_bar(name: str, **options: float) -> tuple[EquivalentMaterial, Floats, Floats]:
    table = wire_table(name)
    curvature, moment = table.curvature[1:], table.moment[1:]
    material = fit_equivalent_material(curvature, moment, 2.0 * table.layout.wire_radius, **options)  # type: ignore[arg-type]
    return material, curvature, moment


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


def find_valid_start(material: EquivalentMaterial, tolerance: float) -> float:
    """Find the curvature, 1/m, from which the error of the bar stays within a tolerance."""
    return float(material.curvature[np.flatnonzero(np.abs(material.error) > tolerance)[-1] + 1])


def test_a_perfectly_plastic_bar_is_found_again() -> None:
    yields = EquivalentMaterial(
        DIAMETER, 1e10, np.array([0.004, 0.1]), np.array([4e7, 4e7]), np.ones(1), np.zeros(1)
    )
    curvature = np.geomspace(0.1, 120.0, 100)
    moment = bar_moment(yields, curvature)
    assert moment[0] == pytest.approx(1e10 * SECOND_MOMENT * 0.1)
    assert moment[-1] == pytest.approx(4e7 * DIAMETER**3 / 6.0, rel=1e-2)
    material = fit_equivalent_material(curvature, moment, DIAMETER, n_knots=60)
    assert material.modulus == pytest.approx(1e10, rel=1e-9)
    assert largest(material.error) < 0.005
    assert material.stress[-1] == pytest.approx(4e7, rel=0.01)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_the_law_of_a_wire_is_held_within_one_percent_where_it_is_bent(name: str) -> None:
    material, curvature, moment = fit_bar(name)
    start = find_valid_start(material, 0.01)
    assert start < 0.01 * curvature[-1]
    assert (np.diff(material.stress, prepend=0.0) >= 0.0).all()
    assert material.plastic_strain[0] == 0.0
    assert (np.diff(material.plastic_strain) > 0.0).all()
    assert material.strain[-1] == pytest.approx(curvature[-1] * 0.5 * material.diameter)
    assert material.elastic_curvature == pytest.approx(0.002 * curvature[-1])
    every_fifth = slice(None, None, 5)
    error = bar_moment(material, curvature[every_fifth]) / moment[every_fifth] - 1.0
    assert largest(error[curvature[every_fifth] >= start]) < 0.01
    np.testing.assert_allclose(material.error[every_fifth], error, atol=1e-6)


def test_a_smaller_elastic_share_follows_the_law_further_down() -> None:
    coarse, fine = fit_bar("A2")[0], fit_bar("A2", elastic_fraction=1e-4, n_knots=40)[0]
    assert largest(fine.error) < 0.05 < 0.5 < largest(coarse.error)
    assert find_valid_start(fine, 0.01) < 0.1 * find_valid_start(coarse, 0.01)


def test_laws_that_are_straight_or_stiffen() -> None:
    curvature = np.geomspace(0.01, 100.0, 60)
    linear = fit_equivalent_material(curvature, 4e-4 * curvature, DIAMETER)
    assert linear.modulus == pytest.approx(4e-4 / SECOND_MOMENT)
    assert largest(linear.error) < 1.1e-3
    stiffening = fit_equivalent_material(curvature, 1e-6 * curvature**2, DIAMETER)
    assert largest(stiffening.error) > 0.5
    assert abs(stiffening.error[-1]) > 0.01


@pytest.mark.parametrize("parts", [(2e-4, 1e-3, 1.3), (2.0, 0.0, 1.0)], ids=["Dahl", "straight"])
def test_a_dahl_law_is_recovered(parts: tuple[float, float, float]) -> None:
    stiffness, height, decay = parts
    bent = np.geomspace(0.05, 20.0, 150)
    dahl = fit_dahl(bent, stiffness * bent + height * (1.0 - np.exp(-bent / decay)))
    assert dahl.error < 1e-3
    assert dahl.stiffness == pytest.approx(stiffness, rel=0.01)
    if height:
        assert (dahl.moment, dahl.decay) == pytest.approx((height, decay), rel=0.05)
    assert fit_dahl(np.array([1.0, 4.0]), np.array([3.0, 6.0])).error < 0.05
    three = np.array([1.0, 2.0, 4.0])
    assert fit_dahl(three, three - 5.0 * np.expm1(-0.5 * three)).error < 1e-3


def test_a_constant_stiffness_by_hand() -> None:
    """Secants from 3 to 1: 1.5 is half too low and half too high; from 1 to 2 1/m from 3 to 2."""
    curvature, moment = np.array([0.0, 1.0, 2.0, 6.0]), np.array([0.0, 3.0, 4.0, 6.0])
    card = loss_card(curvature, moment, counts=(2,))
    assert (card.stiffness, card.stiffness_error) == pytest.approx((1.5, 0.5))
    assert card.slider_errors[0] == pytest.approx((2, 0.0), abs=1e-12)
    part = loss_card(curvature[:3], moment[:3], counts=(2,))
    assert (part.stiffness, part.stiffness_error) == pytest.approx((2.4, 0.2))
