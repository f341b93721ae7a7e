"""A virtual test lab: synthetic exports of cantilever and tensile tests, with known truth.

The exports are in the vendors' formats. It is written from physics and from the vendors' file
layouts alone and shares nothing with the processing that it is there to check.
"""

from labpipe.virtual_lab.campaign import simulate_campaign, simulate_test
from labpipe.virtual_lab.instruments import Observation, observe
from labpipe.virtual_lab.loading import Loading, observe_loading
from labpipe.virtual_lab.scenario import NO_MISHAPS, CantileverScenario
from labpipe.virtual_lab.tensile_campaign import simulate_tensile_campaign, tensile_scenarios
from labpipe.virtual_lab.tensile_exports import (
    TensileObservation,
    observe_tensile,
    simulate_tensile,
)
from labpipe.virtual_lab.tensile_scenario import TensileScenario
from labpipe.virtual_lab.wire_campaign import (
    WireCampaign,
    WireGroup,
    observe_wires,
    simulate_wires,
    wire_campaign,
    wire_scenarios,
)

__all__ = [
    "NO_MISHAPS",
    "CantileverScenario",
    "Loading",
    "Observation",
    "TensileObservation",
    "TensileScenario",
    "WireCampaign",
    "WireGroup",
    "observe",
    "observe_loading",
    "observe_tensile",
    "observe_wires",
    "simulate_campaign",
    "simulate_tensile",
    "simulate_tensile_campaign",
    "simulate_test",
    "simulate_wires",
    "tensile_scenarios",
    "wire_campaign",
    "wire_scenarios",
]
