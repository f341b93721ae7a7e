"""The path of a wire on a string, its truth and its observation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.wire.cantilever import bend_to_travel
from labpipe.virtual_lab import simulate_test
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, MechanicalTest, solve_path
from labpipe.virtual_lab.lab_files import Observation


def test_segments_join_without_a_jump_and_the_string_keeps_its_length() -> None:
    path = solve_path(MechanicalTest())
    for earlier, later in zip(path.segments[:-1], path.segments[1:], strict=True):
        assert earlier.progress[-1] == pytest.approx(later.progress[0], abs=1e-12)
        assert earlier.travel[-1] == pytest.approx(later.travel[0], abs=1e-12)
        assert earlier.tension[-1] == pytest.approx(later.tension[0], abs=1e-9)
        np.testing.assert_allclose(earlier.y[-1], later.y[0], atol=1e-10)
    for segment in path.segments:
        rise = path.rig.anchor_height + segment.travel - segment.y[:, -1]
        span = np.hypot(path.rig.anchor_x - segment.x[:, -1], rise)
        np.testing.assert_allclose(span[segment.tension > 0.0], 0.76, atol=1e-10)
        assert np.all(span <= 0.76 + 1e-10)
    assert not solve_path(MechanicalTest(slack=None, steps_per_branch=1)).segments[0].is_slack


def test_repeated_cycles_equal_solved_ones() -> None:
    """The third cycle is a copy of the second; solving it says the same."""
    test = MechanicalTest(cycles=3, steps_per_branch=40)
    path, law = solve_path(test), test.wire.build_law()
    shape = path.rest_shape
    for segment in path.segments:
        for travel, tension, tip in zip(
            segment.travel, segment.tension, segment.y[:, -1], strict=True
        ):
            shape = bend_to_travel(law, shape.state, test.length, path.rig, float(travel))
            assert tension == pytest.approx(shape.tension, abs=1e-8)
            assert tip == pytest.approx(shape.y[-1], abs=1e-10)


def test_cycles_agree_with_the_arrays(observation: Observation[CantileverScenario]) -> None:
    truth = observation.truth
    for cycle in truth["cycles"]:
        period = (truth["time"] >= cycle["start_time"]) & (truth["time"] <= cycle["stop_time"])
        force, deflection = truth["force"][period], truth["deflection"][period]
        assert cycle["peak_force"] == pytest.approx(force.max(), rel=1e-3)
        assert cycle["peak_deflection"] == pytest.approx(deflection.max(), rel=1e-3)
        assert cycle["energy"] == pytest.approx(np.trapezoid(force, deflection), rel=1e-3)
        assert cycle["energy"] > 0.0
        assert cycle["start_time"] < cycle["top_time"] < cycle["stop_time"]


def test_shapes_start_at_the_clamp_and_end_at_the_pull_point(
    observation: Observation[CantileverScenario],
) -> None:
    truth, rest = observation.truth, solve_path(observation.scenario.mechanics).rest_shape
    assert len(truth["shapes"]) == 21
    for shape in truth["shapes"]:
        assert (shape["x"][0], shape["y"][0]) == pytest.approx((0.0, 0.0), abs=1e-12)
        assert shape["y"][-1] - rest.y[-1] == pytest.approx(
            truth["deflection"][shape["frame"]], abs=1e-9
        )
        chords = np.hypot(np.diff(shape["x"]), np.diff(shape["y"]))
        assert np.sum(chords) == pytest.approx(0.085, rel=2e-4)


def test_truth(observation: Observation[CantileverScenario], tmp_path: Path) -> None:
    folder = simulate_test(observation.scenario, tmp_path / "A2-085-1", 11)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert truth["synthetic"] is True
    assert truth["seed"] == 11
    assert truth["clock"] == {"offset": 1.37, "drift": 40e-6}
    assert truth["true_gain"] == observation.records["force"].true_gain
    for name in ("time", "travel", "deflection", "force"):
        expected = observation.truth[name]
        np.testing.assert_allclose(truth[name], expected, rtol=0, atol=1e-11)
    turn = np.array(truth["rotation_specimen_to_lab"])
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-10)
    assert [cycle["cycle"] for cycle in truth["cycles"]] == [1, 2]
    assert truth["cycles"][0]["peak_force"] == observation.truth["cycles"][0]["peak_force"]
    assert {event["kind"] for event in truth["mishaps"]} == {"gap", "switch", "unlabelled"}
    assert [marker["label"] for marker in truth["markers"]] == list(
        observation.records["markers"].specimen_labels
    )
    law = truth["first_loading"]
    assert np.interp(1e-3, law["moment"], law["curvature"]) == pytest.approx(1e-3 / 5e-3)


def test_dwell_stops_the_clamp_at_every_turn() -> None:
    schedule = replace(CantileverScenario(), dwell=2.0).plan_schedule()
    first_top = schedule.turning_times[1]
    period = schedule.compute_progress(first_top + np.array([-1.0, 0.0, 1.0, 2.0, 3.0]))
    assert period == pytest.approx([0.052, 0.053, 0.053, 0.053, 0.054])
    np.testing.assert_allclose(np.diff(schedule.turning_times), [53.0, *[55.0] * 5])
