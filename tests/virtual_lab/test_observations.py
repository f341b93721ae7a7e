"""Seeds: the same one repeats, another one differs."""

from __future__ import annotations

import time

import numpy as np

from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.observations import Observation, observe


def test_same_seed_same_records(scenario: CantileverScenario, observation: Observation) -> None:
    again = observe(scenario, 11)
    np.testing.assert_array_equal(again.force_record.volts, observation.force_record.volts)
    np.testing.assert_array_equal(again.take.positions, observation.take.positions)
    np.testing.assert_array_equal(again.take.body.rotation, observation.take.body.rotation)
    assert again.take.log == observation.take.log


def test_another_seed_differs(scenario: CantileverScenario, observation: Observation) -> None:
    other = observe(scenario, 12)
    assert np.mean(other.force_record.volts != observation.force_record.volts) > 0.9
    assert other.force_record.true_gain != observation.force_record.true_gain
    assert other.take.labels != observation.take.labels
    assert other.take.log != observation.take.log
    np.testing.assert_array_equal(other.truth.force, observation.truth.force)


def test_a_further_seed_is_cheap(scenario: CantileverScenario, observation: Observation) -> None:
    """Coverage studies run hundreds: without solving again, a fraction of a second each."""
    durations = []
    for seed in (1, 2, 3):
        began = time.process_time()
        observe(scenario, seed)
        durations.append(time.process_time() - began)
    assert min(durations) < 0.5
