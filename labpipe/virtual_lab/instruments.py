"""A virtual test as its instruments see it: in memory, reproducible, with its truth beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.recording import Recording
from labpipe.virtual_lab.cameras import Take, record_take
from labpipe.virtual_lab.load_cell import ForceRecord, record_force
from labpipe.virtual_lab.mechanics import solve_path
from labpipe.virtual_lab.scenario import CantileverScenario
from labpipe.virtual_lab.schedule import plan
from labpipe.virtual_lab.truth import Truth, tell_truth


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """One virtual test: what the instruments recorded, and what really happened.

    Parameters
    ----------
    scenario, seed : what it was made from
    force_record, take : what the exports are written from
    truth : what really happened
    """

    scenario: CantileverScenario
    seed: int
    force_record: ForceRecord
    take: Take
    truth: Truth

    @property
    def force(self) -> Recording:
        """The force recording as a reader would give it: volts, no unit known."""
        return self.force_record.recording()

    @property
    def markers(self) -> Recording:
        """The motion-capture recording as a reader would give it."""
        return self.take.recording()


def observe(scenario: CantileverScenario, seed: int) -> Observation:
    """Run a virtual test without writing files.

    Parameters
    ----------
    scenario : the test
    seed : the same seed gives the same noise, gain and mishaps; mechanics do not depend on it

    Returns
    -------
    The observation. Tests that share their mechanics share one solution, so that only the first
    takes seconds.

    Raises
    ------
    ValueError
        If the mechanics have no solution or a mishap names no marker.
    """
    path, schedule = solve_path(scenario.mechanics), plan(scenario)
    force_seed, marker_seed = np.random.SeedSequence(seed).spawn(2)
    return Observation(
        scenario=scenario,
        seed=seed,
        force_record=record_force(path, scenario, schedule, np.random.default_rng(force_seed)),
        take=record_take(path, scenario, schedule, np.random.default_rng(marker_seed)),
        truth=tell_truth(path, schedule),
    )
