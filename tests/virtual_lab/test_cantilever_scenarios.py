"""Settings of the cantilever rig: its pose, its markers, and how finely tests are solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import (
    CantileverScenario,
    taped_scenario,
    wire_scenario,
)
from labpipe.virtual_lab.specimens import WIRES


def test_rotation_is_proper_and_general(scenario: CantileverScenario) -> None:
    turn = scenario.pose.rotation()
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert turn[1, 1] > 0.99
    assert np.min(np.abs(turn - np.eye(3))) > 1e-4


def test_markers_every_half_inch() -> None:
    scenario = taped_scenario("TWB-B1-19-PVC")
    places = scenario.markers.arc_lengths(scenario.mechanics.length)
    assert np.diff(places) == pytest.approx(0.0127, abs=1e-12)
    assert scenario.markers.centre_offset == pytest.approx(2.75e-3)


def test_stepping_finer_changes_little() -> None:
    """But for the corner where the tape begins to slide, about the noise of the load cell, 3 mN."""
    test = taped_scenario("TWB-B1-19-PVC", cycles=1).mechanics
    path, finer = solve_path(test), solve_path(replace(test, steps_per_branch=150))
    progress = np.linspace(0.0, test.stroke, 500)
    off = np.abs(path.tension(progress) - finer.tension(progress))
    assert np.max(off) < 12e-3
    assert np.quantile(off, 0.95) < 3e-3


@pytest.mark.slow
def test_looking_up_between_crowded_positions_is_exact_enough() -> None:
    """Far below the noise of the load cell, 0.5 mN, and of the markers, 30 um."""
    test = wire_scenario(WIRES["A3"], 0.085, cycles=1).mechanics
    path, finer = solve_path(test), solve_path(replace(test, steps_per_branch=240))
    progress = np.concatenate([np.linspace(0.0, 0.003, 300), 0.053 + np.linspace(0.0, 0.053, 900)])
    assert path.tension(progress) == pytest.approx(finer.tension(progress), abs=6e-5)
    assert path.deflection(progress) == pytest.approx(finer.deflection(progress), abs=1e-7)
