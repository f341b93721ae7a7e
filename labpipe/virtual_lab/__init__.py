"""Simulate a test lab: synthetic exports of bending and tensile tests, with known true values.

The exports are in the vendors' formats. The simulation shares no code with the processing of
exports that it checks; wires and their laws are those of `labpipe.mechanics`.
"""

from labpipe.virtual_lab.campaigns import (
    SMALL_HARNESS,
    Campaign,
    ChosenTests,
    TensileCampaign,
    WireCampaign,
    simulate_campaigns,
)
from labpipe.virtual_lab.lab_files import observe, simulate_test, write_wire_sheet

__all__ = [
    "SMALL_HARNESS",
    "Campaign",
    "ChosenTests",
    "TensileCampaign",
    "WireCampaign",
    "observe",
    "simulate_campaigns",
    "simulate_test",
    "write_wire_sheet",
]
