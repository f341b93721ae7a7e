"""Volts: gain, offset, noise, converter, and the motor's signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, LoadCell
from labpipe.virtual_lab.observations import Observation, observe
from labpipe.virtual_lab.recorders import (
    DIRECTION_PATH,
    FREQUENCY_PATH,
    plan_cantilever,
    record_cantilever_force,
)


def test_volts_times_true_gain_are_the_tension_and_white_noise(observation: Observation) -> None:
    record, scenario = observation.force_record, observation.scenario
    path, schedule = solve_path(scenario.mechanics), plan_cantilever(scenario)
    tension = path.tension(schedule.progress_at(schedule.force_times))
    noise = (record.volts - scenario.load_cell.offset) * record.true_gain - tension
    assert np.std(noise) == pytest.approx(4e-3, rel=0.01)
    assert abs(np.mean(noise)) < 5e-5
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.01


def test_force_recording_agrees_with_the_truth_across_the_clocks(observation: Observation) -> None:
    record, truth, clocks = observation.force_record, observation.truth, observation.scenario.clocks
    marker_time = (record.clock - clocks.offset) / (1 + clocks.drift)
    force = (record.volts - observation.scenario.load_cell.offset) * record.true_gain
    inside = (marker_time > 0.0) & (marker_time < truth.time[-1])
    wanted = np.interp(marker_time[inside], truth.time, truth.force)
    assert np.std(force[inside] - wanted) == pytest.approx(4e-3, rel=0.01)


def test_converter_steps() -> None:
    scenario = CantileverScenario()
    counts = observe(_quick(scenario), 1).force_record.volts / (20.0 / 2**16)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)


def test_converter_saturates() -> None:
    scenario = _quick(replace(CantileverScenario(), load_cell=LoadCell(gain=0.05)))
    assert observe(scenario, 1).force_record.volts.max() == 10.0 - 20.0 / 2**16


def test_true_gain_scatters_as_stated() -> None:
    scenario = _quick(CantileverScenario())
    path, schedule = solve_path(scenario.mechanics), plan_cantilever(scenario)
    gains = [
        record_cantilever_force(path, scenario, schedule, np.random.default_rng(seed)).true_gain
        for seed in range(400)
    ]
    assert np.std(gains) / 0.5 == pytest.approx(0.002, rel=0.1)
    assert np.mean(gains) == pytest.approx(0.5, abs=2e-4)


def test_a_shared_gain_error_is_not_drawn() -> None:
    scenario = _quick(CantileverScenario())
    path, schedule = solve_path(scenario.mechanics), plan_cantilever(scenario)
    shared = replace(scenario, load_cell=LoadCell(gain_error=0.01))
    drawn, given = (
        record_cantilever_force(path, each, schedule, np.random.default_rng(3))
        for each in (scenario, shared)
    )
    assert given.true_gain == pytest.approx(0.505)
    assert given.volts * given.true_gain == pytest.approx(drawn.volts * drawn.true_gain, abs=4e-4)


def test_motor_signals(observation: Observation) -> None:
    signals = observation.force_record.signals
    frequency = signals[FREQUENCY_PATH]
    assert set(frequency) == {0.0, 8000.0}
    down = signals[DIRECTION_PATH] == 1.0
    assert np.sum(down) * 0.99985e-3 == pytest.approx(2 * 53.0, abs=0.02)
    assert np.all(frequency[down] == 8000.0)
    assert np.sum(frequency > 0) * 0.99985e-3 == pytest.approx(4 * 53.0, abs=0.02)


def test_recording_knows_no_unit(observation: Observation) -> None:
    channels = observation.force.channels
    assert [channel.path for channel in channels] == [
        "Model Root/Load Cell/Out1",
        "Model Root/Motor/Direction/Out1",
        "Model Root/Motor/Frequency/Out1",
    ]
    assert {channel.unit for channel in channels} == {None}
    assert len(observation.force.clock(channels[0].clock).time) == len(channels[0].values)


def _quick(scenario: CantileverScenario) -> CantileverScenario:
    return replace(
        scenario,
        mechanics=replace(scenario.mechanics, cycles=1, steps_per_branch=40),
        clocks=replace(scenario.clocks, rate=50.0),
    )
