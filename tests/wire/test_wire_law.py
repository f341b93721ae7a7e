from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.bending_history import bend_along
from labpipe.wire.cantilever import bend_under_force, straight
from labpipe.wire.laws import respond, virgin_plays
from labpipe.wire.moment_curvature import moment_curvature
from labpipe.wire.wire_law import concave_law, play_law, polygon_law
from tests.builders.stranded_wires import contacts_of, wire


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_the_plays_follow_the_first_loading(name: str) -> None:
    section, contacts = wire(name), contacts_of(wire(name))
    law = play_law(section, contacts, largest_curvature=40.0)
    assert len(law.half_widths) > 60
    curvature = np.geomspace(1e-4, 39.9, 500)
    moment = moment_curvature(section, contacts, curvature).moment
    found = np.array(
        [respond(law, np.array([m]), virgin_plays(law, 1)).curvature[0] for m in moment]
    )
    stiffness = moment / found
    assert stiffness == pytest.approx(moment / curvature, rel=3e-3)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_the_plays_unload_as_the_sliders_do(name: str) -> None:
    section, contacts = wire(name), contacts_of(wire(name))
    law = play_law(section, contacts, largest_curvature=40.0)
    down = np.linspace(20.0, -20.0, 81)
    path = bend_along(section, contacts, np.concatenate([np.linspace(0.1, 20.0, 80), down]))
    peak = respond(law, path.moment[79:80], virgin_plays(law, 1))
    back = respond(law, path.moment[120:121], peak.plays)
    # Friction differs by 7 % between the sides: a small part of a small part of the moment.
    assert back.curvature[0] == pytest.approx(path.curvature[120], abs=0.01 * 20.0)


def test_the_cantilever_takes_the_law() -> None:
    section = wire("A2")
    law = play_law(section, contacts_of(section), largest_curvature=60.0)
    shape = bend_under_force(law, straight(law), 0.085, np.array([0.0, 0.1]))
    assert 0.0 < shape.y[-1] < 0.085
    assert 0.0 < shape.curvature.max() < 60.0


def test_laws_that_plays_cannot_follow() -> None:
    kappa = np.array([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"softens before curvature=3 1/m: allowed is a moment"):
        polygon_law(kappa, np.array([1.0, 1.5, 1.4]))
    with pytest.raises(ValueError, match=r"stiffens before curvature=2 1/m: allowed is a slope"):
        polygon_law(kappa, np.array([1.0, 3.0, 3.5]))
    with pytest.raises(ValueError, match=r"largest_curvature=0.0: allowed are finite numbers > 0"):
        play_law(wire("A2"), contacts_of(wire("A2")), largest_curvature=0.0)


def test_a_concave_law_is_its_own_polygon() -> None:
    kappa, moment = np.array([1.0, 2.0, 4.0]), np.array([1.0, 1.8, 3.0])
    found, same = concave_law(kappa, moment), polygon_law(kappa, moment)
    assert found.half_widths == pytest.approx(same.half_widths)
    assert found.compliances == pytest.approx(same.compliances)


def test_a_concave_law_bridges_what_stiffens_a_little() -> None:
    kappa, moment = np.array([1.0, 2.0, 3.0]), np.array([1.0, 1.495, 2.0])
    law = concave_law(kappa, moment)
    assert law.half_widths.tolist() == [1.0]
    assert respond(law, np.array([1.5]), virgin_plays(law, 1)).curvature[0] == pytest.approx(2.0)
    with pytest.raises(
        ValueError, match=r"stiffens at curvature=2 1/m: .* 7.1 % above it, allowed is 1 %"
    ):
        concave_law(kappa, np.array([1.0, 1.4, 2.0]))
    with pytest.raises(ValueError, match=r"softens before curvature=3 1/m"):
        concave_law(kappa, np.array([1.0, 1.5, 1.495]))
