from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.play_fits import concave_law, polygon_law
from labpipe.law.plays import respond, virgin_plays
from labpipe.wire.bending_law import moment_curvature, play_law
from labpipe.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    straight,
)
from labpipe.wire.materials import (
    ElasticPerfectlyPlastic,
    Material,
    RambergOsgood,
    StressTable,
)
from tests.builders.stranded_wires import contacts_of, wire
from tests.judges.reference_wires import bend_along


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
    path = np.concatenate([np.linspace(0.1, 20.0, 80), down])
    moment = bend_along(section, contacts, path)
    peak = respond(law, moment[79:80], virgin_plays(law, 1))
    back = respond(law, moment[120:121], peak.plays)
    # Friction differs by 7 % between the sides: a small part of a small part of the moment.
    assert back.curvature[0] == pytest.approx(path[120], abs=0.01 * 20.0)


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


SHARP = ElasticPerfectlyPlastic(110e9, 60e6)
TABLE = StressTable((5e-4, 1e-3, 2e-3, 0.02, 0.3), (55e6, 70e6, 80e6, 100e6, 150e6))


@pytest.mark.parametrize("material", [SHARP, TABLE, RambergOsgood(110e9, 300e6, 0.02)])
@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
@pytest.mark.parametrize("largest", [20.0, 60.0, 150.0])
def test_a_sharp_yield_does_not_stiffen(material: Material, name: str, largest: float) -> None:
    section = wire(name, material)
    law = play_law(section, contacts_of(section), largest_curvature=largest)
    assert (law.compliances >= 0.0).all()


def test_the_law_of_a_wire_ends_where_it_is_told_up_to() -> None:
    section, contacts = wire("A2"), contacts_of(wire("A2"))
    law = play_law(section, contacts, largest_curvature=20.0)
    last = moment_curvature(section, contacts, np.array([20.0])).moment[0]
    assert law.largest_moment == pytest.approx(last, rel=1e-12)


def test_no_wire_is_bent_beyond_its_law() -> None:
    section = wire("A2")
    law = play_law(section, contacts_of(section), largest_curvature=20.0)
    said = r": the wire would be bent to [2-9]\d(\.\d+)? 1/m, and its law ends at 20 1/m$"
    rig = StringRig(0.76, 0.02, 0.085, 0.76)
    with pytest.raises(ValueError, match="^deflection=0.05" + said):
        bend_to_deflection(law, straight(law), 0.085, 0.05)
    with pytest.raises(ValueError, match="^travel=0.05" + said):
        bend_to_travel(law, straight(law), 0.085, rig, 0.05)
    with pytest.raises(ValueError, match=r"^force=\[0.0, 0.5\]" + said):
        bend_under_force(law, straight(law), 0.085, np.array([0.0, 0.5]))


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
