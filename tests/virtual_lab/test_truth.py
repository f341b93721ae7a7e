"""The truth agrees with itself and with the path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import NO_MISHAPS, CantileverScenario
from labpipe.virtual_lab.observations import Observation, observe


def test_rest_is_zero(observation: Observation) -> None:
    truth = observation.truth
    resting = truth.time < truth.cycles[0].start_time
    assert np.sum(resting) >= 200
    for values in (truth.travel, truth.deflection, truth.force):
        assert np.max(np.abs(values[resting])) < 1e-12


def test_cycles_agree_with_the_arrays(observation: Observation) -> None:
    truth = observation.truth
    for cycle in truth.cycles:
        during = (truth.time >= cycle.start_time) & (truth.time <= cycle.stop_time)
        force, deflection = truth.force[during], truth.deflection[during]
        assert cycle.peak_force == pytest.approx(force.max(), rel=1e-3)
        assert cycle.peak_deflection == pytest.approx(deflection.max(), rel=1e-3)
        assert cycle.energy == pytest.approx(np.trapezoid(force, deflection), rel=1e-3)
        assert cycle.energy > 0.0
        assert cycle.start_time < cycle.top_time < cycle.stop_time


def test_residual_deflection_is_where_the_force_is_gone(observation: Observation) -> None:
    truth = observation.truth
    for cycle in truth.cycles:
        unloading = (truth.time > cycle.top_time) & (truth.time < cycle.stop_time)
        pulling = unloading & (truth.force > 0.0)
        assert cycle.residual_deflection is not None
        assert truth.deflection[pulling].min() == pytest.approx(cycle.residual_deflection, abs=3e-5)
        assert truth.deflection[pulling].min() >= cycle.residual_deflection
        still = unloading & ~pulling
        assert np.ptp(truth.deflection[still]) == 0.0


def test_residual_deflection_with_a_preloaded_string(scenario: CantileverScenario) -> None:
    preloaded = replace(
        scenario, mechanics=replace(scenario.mechanics, slack=None, cycles=1), mishaps=NO_MISHAPS
    )
    truth = observe(preloaded, 1).truth
    (cycle,) = truth.cycles
    unloading = (truth.time > cycle.top_time) & (truth.time < cycle.stop_time)
    order = np.argsort(truth.force[unloading])
    crossing = np.interp(0.0, truth.force[unloading][order], truth.deflection[unloading][order])
    assert cycle.residual_deflection == pytest.approx(crossing, abs=1e-5)
    assert truth.force.min() == pytest.approx(-0.0027 * 9.80665, rel=1e-6)


def test_shapes_start_at_the_clamp_and_end_at_the_pull_point(observation: Observation) -> None:
    truth, rest = observation.truth, solve_path(observation.scenario.mechanics).rest
    assert len(truth.shapes) == 21
    for shape in truth.shapes:
        assert (shape.x[0], shape.y[0]) == pytest.approx((0.0, 0.0), abs=1e-12)
        assert shape.y[-1] - rest.y[-1] == pytest.approx(truth.deflection[shape.frame], abs=1e-9)
        chords = np.hypot(np.diff(shape.x), np.diff(shape.y))
        assert np.sum(chords) == pytest.approx(0.085, rel=2e-4)
