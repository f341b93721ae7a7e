"""Vector sliders by scalar ones in a few directions."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.slider_directions import TURNS, in_directions, turned
from labpipe.law.sliders import SliderLaw, fit_sliders, linear_moment_law, slide, slider_moment
from tests.builders.wire_tables import wire_table


@pytest.mark.parametrize("directions", [2, 3, 4, 6])
def test_a_spring_is_alike_in_every_direction(directions: int) -> None:
    found = in_directions(SliderLaw(0.5, np.zeros(0), np.zeros(0), 0.1, 10.0), directions)
    assert found.error < 1e-12
    assert found.sideways < 1e-12
    assert found.stiffness == pytest.approx(2.0 * 0.5 / directions)


def test_one_slider_that_slides_all_along() -> None:
    """Four directions: the moment of sliders that all slide goes from 0.98 to 1.05 of the mean."""
    law = SliderLaw(0.0, np.array([1.0]), np.array([1.0]), 50.0, 100.0)
    found = in_directions(law, 4)
    assert found.error == pytest.approx(0.05, abs=0.02)
    moments = found.stiffnesses * found.slip_curvatures
    assert moments.sum() == pytest.approx(np.pi / 8.0, rel=0.03)  # pi K kappa_j / 2 D


@pytest.mark.parametrize("name", ["A2", "C5"])
def test_errors_by_the_sliders_themselves(name: str) -> None:
    """Each direction by the planar sliders, some curvatures and angles; no more than is stated."""
    table = wire_table(name)
    law = fit_sliders(table.curvature, table.moment, 8)
    found = in_directions(law, 4)
    assert len(found.stiffnesses) <= 16
    assert found.error < 0.06
    one = SliderLaw(found.stiffness, found.stiffnesses, found.slip_curvatures, 0.1, 10.0)
    for angle in (0.0, 0.2, np.pi / 8.0, 1.0):
        towards = np.array([np.cos(angle), np.sin(angle)])
        for size in (0.2, 3.0, 40.0):
            bent = size * found.normals @ towards
            held = slide(one, bent, np.zeros((4, len(one.stiffnesses)))).moment
            moment = held @ found.normals
            wanted = slider_moment(law, np.array([size]))[0]
            assert moment @ towards == pytest.approx(wanted, rel=1.05 * found.error)
            aside = abs(moment[1] * towards[0] - moment[0] * towards[1])
            assert aside <= 1.05 * found.sideways * wanted


def test_more_directions_lose_less() -> None:
    table = wire_table("A2")
    law = fit_sliders(table.curvature, table.moment, 8, first=0.1, last=10.0)
    errors = [in_directions(law, number).error for number in (2, 3, 4, 6)]
    assert errors == sorted(errors, reverse=True)
    assert len(in_directions(law, 4, most=5).stiffnesses) <= 5


@pytest.mark.parametrize("name", ["A2", "C5"])
def test_nodes_that_are_turned_are_more_alike_together(name: str) -> None:
    """The mean of four nodes, each by its own sliders: within what is stated, closer than one."""
    table = wire_table(name)
    law = fit_sliders(table.curvature, table.moment, 8)
    alone = in_directions(law, 4)
    together = turned(law, alone)
    assert together.directions == 16
    assert together.sideways < 0.2 * alone.sideways
    assert together.error < alone.error
    one = SliderLaw(alone.stiffness, alone.stiffnesses, alone.slip_curvatures, 0.1, 10.0)
    for angle in np.linspace(0.0, 1.5, 7):
        towards = np.array([np.cos(angle), np.sin(angle)])
        moment = np.zeros(2)
        for share in TURNS:
            normals = alone.turned_normals(share)
            held = slide(one, 5.0 * normals @ towards, np.zeros((4, len(one.stiffnesses))))
            moment += held.moment @ normals / len(TURNS)
        wanted = slider_moment(law, np.array([5.0]))[0]
        assert moment @ towards == pytest.approx(wanted, rel=1.05 * together.error)
        aside = abs(moment[1] * towards[0] - moment[0] * towards[1])
        assert aside <= 1.1 * together.sideways * wanted + 1e-12


def test_numbers_that_are_too_small() -> None:
    law = linear_moment_law(1.0, 10.0)
    with pytest.raises(ValueError, match=r"^directions=1: allowed are numbers >= 2$"):
        in_directions(law, 1)
    with pytest.raises(ValueError, match=r"^most=0: allowed are numbers >= 1$"):
        in_directions(law, 2, most=0)
