from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.beam_stiffness import Rollers, path_of_load, stiffness_ratio
from labpipe.records.estimates import Failure


@pytest.mark.parametrize("friction", [0.0, 0.2])
@pytest.mark.parametrize("radius", [0.0, 0.005])
def test_small_deflections_are_those_of_a_straight_beam(radius: float, friction: float) -> None:
    rollers = Rollers(0.1, radius, friction)
    assert stiffness_ratio(rollers, low=0.0, high=1e-5) == pytest.approx(1.0, abs=2e-3)


def test_knife_edges_soften_rollers_and_friction_stiffen() -> None:
    ratios = [
        stiffness_ratio(rollers, low=0.002, high=0.02)
        for rollers in (Rollers(0.1524), Rollers(0.1524, 0.012), Rollers(0.1524, 0.012, 0.2))
    ]
    assert not any(isinstance(each, Failure) for each in ratios)
    knife, round_, rough = (float(each) for each in ratios if not isinstance(each, Failure))
    assert knife < 1.0
    assert knife < round_ < rough


def test_the_load_on_knife_edges_has_a_largest_value() -> None:
    """Beyond it the beam slips through between the supports under a dead load."""
    deflection, load = path_of_load(Rollers(1.0))
    top = int(np.argmax(load))
    assert deflection[top] == pytest.approx(0.238, abs=2e-3)
    assert load[top] == pytest.approx(6.672, abs=2e-3)
    assert (np.diff(deflection) > 0.0).all()


def test_beyond_what_an_elastic_beam_can_do() -> None:
    found = stiffness_ratio(Rollers(0.1), low=0.0, high=0.2)
    assert isinstance(found, Failure)
    assert found.code == "beyond_elastica"
    assert found.message == (
        "an elastic beam on this span slips through at 61.76 mm, the stiffness goes up to 200 mm"
    )


def test_a_stretch_in_which_geometry_decides() -> None:
    found = stiffness_ratio(Rollers(0.1), low=0.01, high=0.03)
    assert isinstance(found, Failure)
    assert found.code == "beyond_elastica"
    assert found.message.startswith("from 10 mm to 30 mm the load on an elastic beam rises 0.2")
    assert found.message.endswith(" times as fast as at first, 0.5 is the least that is corrected")
