"""A virtual test lab: synthetic exports of bending and tensile tests, with known truth.

The exports are in the vendors' formats. The lab is written from physics and the vendors' file
layouts alone and shares no code with the processing that it checks.
"""

from labpipe.virtual_lab.campaigns import (
    SMALL_HARNESS,
    Campaign,
    ChosenTests,
    ConduitCampaign,
    CrimpCampaign,
    CrimpLot,
    TapedCampaign,
    TensileCampaign,
    WireCampaign,
    WireGroup,
    simulate_campaigns,
)
from labpipe.virtual_lab.cantilever_scenarios import (
    NO_MISHAPS,
    CantileverScenario,
    build_taped_scenario,
    build_wire_scenario,
)
from labpipe.virtual_lab.metal_tension import MetalTension, simulate_tension
from labpipe.virtual_lab.observations import (
    ConduitObservation,
    Observation,
    TensileObservation,
    observe,
    simulate_test,
    write_wire_sheet,
)
from labpipe.virtual_lab.specimens import TAPED_TYPES
from labpipe.virtual_lab.tensile import TensileScenario
from labpipe.virtual_lab.three_point import CONDUIT_TYPES, ConduitScenario, build_conduit_scenario

__all__ = [
    "CONDUIT_TYPES",
    "NO_MISHAPS",
    "SMALL_HARNESS",
    "TAPED_TYPES",
    "Campaign",
    "CantileverScenario",
    "ChosenTests",
    "ConduitCampaign",
    "ConduitObservation",
    "ConduitScenario",
    "CrimpCampaign",
    "CrimpLot",
    "MetalTension",
    "Observation",
    "TapedCampaign",
    "TensileCampaign",
    "TensileObservation",
    "TensileScenario",
    "WireCampaign",
    "WireGroup",
    "build_conduit_scenario",
    "build_taped_scenario",
    "build_wire_scenario",
    "observe",
    "simulate_campaigns",
    "simulate_tension",
    "simulate_test",
    "write_wire_sheet",
]
