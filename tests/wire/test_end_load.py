"""End loads: the elastica, the first integral, and the path that turns back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from labpipe.mechanics.law.plays import PlayLaw, make_elastic_law
from labpipe.mechanics.wire.bending_law import fit_play_law
from labpipe.mechanics.wire.cantilever import bend_to_deflection, bend_under_force, make_straight
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from tests.builders.bilinear_laws import bilinear_law
from tests.builders.cantilevers import LENGTH, WIRE, by_stations
from tests.builders.stranded_wires import contacts_of, wire
from tests.judges.first_integral import by_first_integral, closed_form


def stranded(name: str, largest: float) -> PlayLaw:
    return fit_play_law(wire(name), contacts_of(wire(name)), largest_curvature=largest)


STRANDED, C4 = stranded("A2", 125.0), stranded("C4", 95.0)


@given(st.floats(1e-3, 1.5))
@example(1e-3)
@example(1.43029)
@example(1.5)
def test_the_elastica(tip_angle: float) -> None:
    """The second example is P L^2 / EI = 10 in the table of Mattiasson (1981)."""
    load, rise, shortening = closed_form(tip_angle)
    if tip_angle == 1.43029:
        assert (load, rise, shortening) == pytest.approx((10.0, 0.81061, 0.555), rel=1e-4)
    law = make_elastic_law(2e-3)
    force = np.array([0.0, load * law.stiffness / LENGTH**2])
    shape = bend_under_force(law, make_straight(law), LENGTH, force)
    numbers = (shape.y[-1] / LENGTH, 1.0 - shape.x[-1] / LENGTH, shape.angle[-1])
    assert numbers == pytest.approx((rise, shortening, tip_angle), abs=1e-9)
    path = compute_end_load_path(law, LENGTH, np.array([rise * LENGTH]))
    clamp = np.sqrt(2.0 * load * np.sin(tip_angle)) * law.stiffness / LENGTH
    assert (path.load[0], path.clamp_moment[0]) == pytest.approx((force[1], clamp), rel=1e-8)


# At 64 stations a single corner costs 7e-5 (2e-6 at 128), the many small ones of a wire 4e-6.
@pytest.mark.parametrize(
    ("law", "load", "within"),
    [
        (make_elastic_law(3e-3), 1.2, 1e-11),
        (bilinear_law(5e-3, 1.5e-3, 0.02), 0.9, 1e-4),
        (STRANDED, 0.13, 1e-5),
        (C4, 0.3, 1e-5),
    ],
    ids=["linear", "bilinear", "A2", "C4"],
)
def test_the_first_integral(law: PlayLaw, load: float, within: float) -> None:
    deflection, tip, clamp = by_first_integral(law, LENGTH, load)
    shape = bend_under_force(law, make_straight(law), LENGTH, np.array([0.0, load]))
    numbers = (shape.y[-1], shape.angle[-1], shape.moment[0])
    assert numbers == pytest.approx((deflection, tip, clamp), rel=within)
    path = compute_end_load_path(law, LENGTH, np.array([deflection]))
    found = path.load[0], path.clamp_moment[0]
    assert found == pytest.approx((load, clamp), rel=max(within, 1e-7))


def test_a_curve_that_turns_back_goes_on_from_its_first_loading() -> None:
    deflections = np.array([0.0, 0.02, 0.04, 0.03, 0.02, -0.01, 0.0])
    loads = compute_end_load_path(WIRE, LENGTH, deflections).load
    wanted = by_stations(WIRE, deflections[1:])
    assert loads == pytest.approx(np.append(0.0, wanted), abs=5e-5 * loads.max())
    assert loads[4] < 0.7 * loads[1]
    down = compute_end_load_path(WIRE, LENGTH, -deflections[1:3]).load
    assert down == pytest.approx(-loads[1:3], rel=1e-4)
    assert compute_end_load_path(WIRE, LENGTH, np.zeros(0)).load.shape == (0,)


def test_the_curve_is_that_of_the_stations_also_where_the_tip_unloads() -> None:
    law, deflections = C4, np.linspace(0.0, 0.8 * LENGTH, 41)[1:]
    state, shapes = make_straight(law, 64), []
    for deflection in deflections.tolist():
        shapes.append(bend_to_deflection(law, state, LENGTH, deflection))
        state = shapes[-1].state
    loads, moments = zip(*((shape.force[1], shape.moment[0]) for shape in shapes), strict=True)
    for step in (40, 4, 1):
        path = compute_end_load_path(law, LENGTH, deflections[step - 1 :: step])
        assert path.load == pytest.approx(loads[step - 1 :: step], rel=1e-4)
        assert path.clamp_moment == pytest.approx(moments[step - 1 :: step], rel=1e-4)


def test_a_path_ends_where_the_law_does() -> None:
    short, long = stranded("A2", 20.0), stranded("A2", 60.0)
    deflections = np.linspace(0.0, 0.05, 26)[1:]
    path = compute_end_load_path(short, LENGTH, deflections)
    assert 5 < len(path.load) < 25
    beyond = compute_end_load_path(long, LENGTH, deflections).clamp_moment
    assert beyond[len(path.load) - 1] < short.largest_moment < beyond[len(path.load)]
    back = compute_end_load_path(short, LENGTH, np.array([0.01, 0.005, 0.012, 0.05, 0.01]))
    assert len(back.load) == 3
