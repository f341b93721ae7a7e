"""The row of end loads against the path station by station, and where it ends."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.plays import LinearLaw, PlayLaw
from labpipe.wire.bending_law import play_law
from labpipe.wire.cantilever import bend_to_deflection, straight
from labpipe.wire.end_load import deflection_at
from labpipe.wire.end_load_path import end_load_path
from tests.builders.cantilevers import LENGTH, WIRE, by_stations
from tests.builders.stranded_wires import contacts_of, wire


@pytest.mark.parametrize("n_deflections", [1, 10, 40])
def test_the_curve_is_that_of_the_stations_also_where_the_tip_unloads(n_deflections: int) -> None:
    section = wire("C4")
    law = play_law(section, contacts_of(section), largest_curvature=95.0)
    fine = np.linspace(0.0, 0.8 * LENGTH, 41)[1:]
    deflections = np.linspace(0.0, 0.8 * LENGTH, n_deflections + 1)[1:]
    loads = end_load_path(law, LENGTH, deflections).load
    expected = np.interp(deflections, fine, by_stations(law, fine))
    assert loads == pytest.approx(expected, rel=1e-4)  # of the stations: see the test of doubling


def test_a_curve_that_turns_back_goes_on_from_its_first_loading() -> None:
    deflections = np.array([0.02, 0.04, 0.03, 0.02, -0.01, 0.0])
    loads = end_load_path(WIRE, LENGTH, deflections).load
    assert loads == pytest.approx(by_stations(WIRE, deflections), abs=5e-5 * loads.max())
    assert loads[3] < 0.7 * loads[0]


def test_a_curve_from_zero_and_one_to_the_other_side() -> None:
    assert end_load_path(WIRE, LENGTH, np.array([0.0, 0.02])).load[0] == pytest.approx(
        0.0, abs=1e-15
    )
    up, down = (
        end_load_path(WIRE, LENGTH, side * np.array([0.02, 0.04])).load for side in (1.0, -1.0)
    )
    assert down == pytest.approx(-up, rel=1e-4)
    assert end_load_path(WIRE, LENGTH, np.zeros(0)).load.shape == (0,)


def law_to(largest_curvature: float) -> PlayLaw:
    section = wire("A2")
    return play_law(section, contacts_of(section), largest_curvature=largest_curvature)


def test_a_path_ends_where_the_law_does() -> None:
    law = law_to(20.0)
    deflections = np.linspace(0.0, 0.05, 26)[1:]
    path = end_load_path(law, LENGTH, deflections)
    assert 5 < len(path.load) < 25
    beyond = end_load_path(law_to(60.0), LENGTH, deflections).clamp_moment
    assert beyond[len(path.load) - 1] < law.largest_moment < beyond[len(path.load)]


def test_a_path_that_comes_back_ends_where_the_law_does() -> None:
    path = end_load_path(law_to(20.0), LENGTH, np.array([0.01, 0.005, 0.012, 0.05, 0.01]))
    assert len(path.load) == 3


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(number: float) -> None:
    said = rf"^deflections=\[?(0.0, )?{number}\]?: allowed are finite numbers$"
    with pytest.raises(ValueError, match=said):
        end_load_path(LinearLaw(3e-3), LENGTH, np.array([0.0, number]))


@pytest.mark.parametrize("length", [0.0, -0.085, np.nan, np.inf])
def test_lengths_are_positive(length: float) -> None:
    with pytest.raises(ValueError, match=rf"^length={length}: allowed are finite numbers > 0$"):
        end_load_path(LinearLaw(3e-3), length, np.array([0.01]))


def test_clamp_moments_are_those_of_the_stations_also_where_the_tip_unloads() -> None:
    section = wire("C4")
    law = play_law(section, contacts_of(section), largest_curvature=95.0)
    deflections = np.linspace(0.0, 0.8 * LENGTH, 41)[1:]
    state, expected = straight(law, 64), []
    for deflection in deflections.tolist():
        shape = bend_to_deflection(law, state, LENGTH, deflection)
        state = shape.state
        expected.append(shape.moment[0])
    found = end_load_path(law, LENGTH, deflections).clamp_moment
    assert found == pytest.approx(expected, rel=1e-4)


def test_clamp_moments_are_those_of_the_deflections() -> None:
    law, deflections = LinearLaw(2e-3), np.linspace(0.0, 0.85 * LENGTH, 18)[1:]
    path = end_load_path(law, LENGTH, deflections)
    found = [deflection_at(law, LENGTH, float(each)) for each in path.clamp_moment]
    assert found == pytest.approx(deflections, rel=1e-6)
