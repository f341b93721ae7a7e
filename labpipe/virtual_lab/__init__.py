"""A virtual test lab: synthetic exports of bending and tensile tests, with known truth.

The exports are in the vendors' formats. It is written from physics and from the vendors' file
layouts alone and shares nothing with the processing that it is there to check.
"""

from labpipe.virtual_lab.campaign import simulate_campaign, simulate_test
from labpipe.virtual_lab.conduit_bundle import (
    CONDUIT_TYPES,
    ConduitScenario,
    conduit_scenario,
)
from labpipe.virtual_lab.conduit_exports import (
    ConduitObservation,
    observe_conduit,
    simulate_conduit,
)
from labpipe.virtual_lab.harness_campaign import (
    ConduitCampaign,
    conduit_scenarios,
    observe_conduits,
    simulate_harness,
    small_campaigns,
)
from labpipe.virtual_lab.instruments import Observation, observe
from labpipe.virtual_lab.loading import Loading, observe_loading
from labpipe.virtual_lab.scenario import NO_MISHAPS, CantileverScenario
from labpipe.virtual_lab.taped_bundle import (
    TAPED_TYPES,
    TapedCampaign,
    observe_taped,
    simulate_taped,
    taped_scenario,
    taped_scenarios,
)
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
    "CONDUIT_TYPES",
    "NO_MISHAPS",
    "TAPED_TYPES",
    "CantileverScenario",
    "ConduitCampaign",
    "ConduitObservation",
    "ConduitScenario",
    "Loading",
    "Observation",
    "TapedCampaign",
    "TensileObservation",
    "TensileScenario",
    "WireCampaign",
    "WireGroup",
    "conduit_scenario",
    "conduit_scenarios",
    "observe",
    "observe_conduit",
    "observe_conduits",
    "observe_loading",
    "observe_taped",
    "observe_tensile",
    "observe_wires",
    "simulate_campaign",
    "simulate_conduit",
    "simulate_harness",
    "simulate_taped",
    "simulate_tensile",
    "simulate_tensile_campaign",
    "simulate_test",
    "simulate_wires",
    "small_campaigns",
    "taped_scenario",
    "taped_scenarios",
    "tensile_scenarios",
    "wire_campaign",
    "wire_scenarios",
]
