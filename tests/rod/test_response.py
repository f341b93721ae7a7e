"""The response of a line: parabolas within reach, bands, shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pytest

from labpipe.rod.beliefs import joined, known
from labpipe.rod.response import Fields, band_of, field_band, respond

BELIEF = joined([known("a", 0.3, draws=16_384), known("b", 0.4, draws=16_384)])


def straight(inputs: Mapping[str, float]) -> Fields:
    a, b = inputs["a"], inputs["b"]
    return {"sum": np.array([a + b, 2.0 * a]), "one": np.array(5.0 + b)}


def test_a_straight_line_has_the_band_of_its_inputs() -> None:
    response = respond(straight, BELIEF)
    assert response is not None
    band = field_band([response], "sum")
    assert band.value.tolist() == [0.0, 0.0]
    assert band.upper == pytest.approx([1.96 * 0.5, 1.96 * 0.6], rel=0.04)
    assert band.lower == pytest.approx([-1.96 * 0.5, -1.96 * 0.6], rel=0.04)
    assert response.shares("one") == pytest.approx({"a": 0.0, "b": 1.0})
    assert response.shares("sum")["a"] == pytest.approx(5 * 0.09 / (5 * 0.09 + 0.16), rel=0.05)


def answered(answer: Callable[[float], float], inputs: Mapping[str, float]) -> Fields:
    return {"y": np.array(answer(inputs["a"]))}


def test_a_cause_that_makes_most_of_a_band_is_exact_where_the_band_ends() -> None:
    """Kinked, bent or steep: the line is solved there."""
    steep = np.exp(1.96 * 0.3)
    for answer, ends in (
        (lambda a: 3.0 * a if a > 0.0 else a, (-1.96 * 0.3, 3.0 * 1.96 * 0.3)),
        (lambda a: a + 0.5 * a**2, (-0.588 + 0.5 * 0.588**2, 0.588 + 0.5 * 0.588**2)),
        (np.exp, (1.0 / steep, steep)),
    ):
        response = respond(partial(answered, answer), known("a", 0.3))
        assert response is not None
        band = field_band([response], "y")
        assert (float(band.lower), float(band.upper)) == pytest.approx(ends, rel=2e-3)


def test_a_parabola_is_met_and_goes_on_straight() -> None:
    belief = known("a", 1.0, freedom=4.0)
    response = respond(lambda inputs: {"y": np.array((1.0 + inputs["a"]) ** 2)}, belief)
    assert response is not None
    assert response.reach.tolist() == [2.0]
    at = belief.amounts[:, 0]
    beyond = np.abs(at) > 2.0
    drawn = response.drawn("y")
    assert drawn[~beyond] == pytest.approx((1.0 + at[~beyond]) ** 2)
    line = np.where(at > 0.0, 9.0 + 6.0 * (at - 2.0), 1.0 - 2.0 * (at + 2.0))
    assert drawn[beyond] == pytest.approx(line[beyond])


def test_a_least_value_is_taken_in_every_draw() -> None:
    response = respond(straight, BELIEF)
    assert response is not None

    def smaller(values: np.ndarray) -> np.ndarray:
        return np.asarray(values.min(axis=-1))

    band = band_of(
        [response], lambda each: (smaller(each.value["sum"]), smaller(each.drawn("sum")))
    )
    chance = np.random.default_rng(5)
    a, b = 0.3 * chance.normal(size=200_000), 0.4 * chance.normal(size=200_000)
    want = np.quantile(np.minimum(a + b, 2.0 * a), [0.025, 0.975])
    assert [float(band.lower), float(band.upper)] == pytest.approx(want, rel=0.05)


def test_bands_of_several_beliefs_are_joined() -> None:
    other = joined([known("a", 0.3, centre=2.0), known("b", 0.4)])
    responses = [respond(straight, BELIEF), respond(straight, other)]
    band = field_band([each for each in responses if each is not None], "sum")
    assert band.value[1] == 0.0
    assert band.lower[1] == pytest.approx(-1.96 * 0.6, rel=0.06)
    assert band.upper[1] == pytest.approx(4.0 + 1.96 * 0.6, rel=0.06)


def test_a_side_without_equilibrium_borrows_the_other() -> None:
    def partly(inputs: Mapping[str, float]) -> Fields | None:
        return None if inputs["a"] > 0.1 or abs(inputs["b"]) > 0.1 else straight(inputs)

    response = respond(partly, BELIEF)
    assert response is not None
    assert (response.one_sided, response.silent) == (("a",), ("b",))
    assert field_band([response], "sum").upper[1] == pytest.approx(1.96 * 0.6, rel=0.04)
    assert np.ptp(field_band([response], "one").upper) == 0.0


def test_no_equilibrium_at_the_best_inputs_is_no_response() -> None:
    assert respond(lambda _: None, BELIEF) is None
