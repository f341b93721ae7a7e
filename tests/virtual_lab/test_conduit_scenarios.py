"""The cases of Table 4.2, and what they are made of."""

from __future__ import annotations

import pytest

from labpipe.virtual_lab.conduit_scenarios import (
    CONDUIT_CELL,
    CONDUIT_TYPES,
    CORRUGATED,
    TWIST_TUBE,
    ConduitScenario,
    ThreePointTest,
    conduit_bundle,
    conduit_scenario,
)
from labpipe.virtual_lab.specimens import ElasticModel


def test_table_4_2() -> None:
    found = {name: (b.wires, b.conduit, b.taping) for name, (b, _) in CONDUIT_TYPES.items()}
    b1, b2, tube, twist = (("B1", 19),), (("B2", 19),), "corrugated-tube", "twist-tube"
    assert found == {
        "CWB-1": (b1, tube, "none"),
        "CWB-2a": (b2, tube, "none"),
        "CWB-2b": (b2, tube, "coarse"),
        "CWB-2c": (b2, tube, "half-lap"),
        "CWB-3": ((("B2", 12),), tube, "none"),
        "CWB-4": ((("B1", 10), ("B2", 9)), tube, "none"),
        "CWB-5": (b1, twist, "none"),
        "CWB-6": (b2, twist, "none"),
    }


def test_taping_hardly_matters() -> None:
    plain, coarse, half = (CONDUIT_TYPES[f"CWB-2{x}"][0].law().stiffness for x in "abc")
    assert coarse / plain == pytest.approx(1.01)
    assert half / plain == pytest.approx(1.02)


@pytest.mark.parametrize("name", CONDUIT_TYPES)
def test_wires_fit_into_their_conduit(name: str) -> None:
    bundle, conduit = CONDUIT_TYPES[name]
    assert 2.0 * bundle.radius < conduit.bore < conduit.outer_diameter


def test_rig_of_the_source() -> None:
    scenario = conduit_scenario("CWB-6")
    test = scenario.test
    assert (test.span, test.overhang, test.roller_radius) == (0.1524, 0.0254, 5e-3)
    assert (scenario.speed, test.stroke) == (0.5e-3, 0.0294)
    assert test.outer_radius == 0.5 * TWIST_TUBE.outer_diameter
    assert scenario.markers.centre_offset == pytest.approx(4e-3 + 1.5e-3)
    cell = scenario.load_cell
    assert cell.gain * (0.0 - cell.offset) == pytest.approx(0.002846)
    assert cell == CONDUIT_CELL


def test_only_bundles_have_a_sheet() -> None:
    scenario = ConduitScenario(ThreePointTest(ElasticModel(0.1)))
    with pytest.raises(TypeError, match=r"bundle=ElasticModel: allowed is a BundleModel"):
        _ = scenario.bundle
    assert ConduitScenario(ThreePointTest(conduit_bundle((("B1", 7),), CORRUGATED))).bundle
