"""One scenario for most tests: small enough to be quick, solved once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from labpipe.virtual_lab import observe
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.lab_files import Observation


@pytest.fixture(scope="session")
def scenario() -> CantileverScenario:
    """Two cycles at 1 kHz, solved at fewer positions; everything else by default."""
    default = CantileverScenario()
    return replace(
        default,
        mechanics=replace(default.mechanics, cycles=2, steps_per_branch=80),
        clocks=replace(default.clocks, rate=1000.0),
    )


@pytest.fixture(scope="session")
def observation(scenario: CantileverScenario) -> Observation[CantileverScenario]:
    return observe(scenario, 11)
