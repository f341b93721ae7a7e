"""A virtual test lab: synthetic exports of cantilever and tensile tests, with known truth.

The exports are in the vendors' formats. It is written from physics and from the vendors' file
layouts alone and shares nothing with the processing that it is there to check.
"""

from labpipe.virtual_lab.campaign import simulate_campaign, simulate_test
from labpipe.virtual_lab.instruments import Observation, observe
from labpipe.virtual_lab.scenario import NO_MISHAPS, CantileverScenario
from labpipe.virtual_lab.tensile_campaign import simulate_tensile_campaign, tensile_scenarios
from labpipe.virtual_lab.tensile_exports import (
    TensileObservation,
    observe_tensile,
    simulate_tensile,
)
from labpipe.virtual_lab.tensile_scenario import TensileScenario

__all__ = [
    "NO_MISHAPS",
    "CantileverScenario",
    "Observation",
    "TensileObservation",
    "TensileScenario",
    "observe",
    "observe_tensile",
    "simulate_campaign",
    "simulate_tensile",
    "simulate_tensile_campaign",
    "simulate_test",
    "tensile_scenarios",
]
