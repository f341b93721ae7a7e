"""A virtual test lab: synthetic exports of cantilever tests in vendor formats, with known truth.

It is written from physics and from the vendors' file layouts alone and shares nothing with the
processing that it is there to check.
"""

from labpipe.virtual_lab.campaign import simulate_campaign, simulate_test
from labpipe.virtual_lab.instruments import Observation, observe
from labpipe.virtual_lab.scenario import NO_MISHAPS, CantileverScenario

__all__ = [
    "NO_MISHAPS",
    "CantileverScenario",
    "Observation",
    "observe",
    "simulate_campaign",
    "simulate_test",
]
