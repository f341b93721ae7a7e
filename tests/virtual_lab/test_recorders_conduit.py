"""What the instruments of a three-point test see, without their noise and with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.cameras import cylinder_markers, film_conduit, marker_places
from labpipe.virtual_lab.conduit_scenarios import ConduitScenario, conduit_scenario
from labpipe.virtual_lab.recorders import plan_conduit, record_conduit_force, record_crosshead
from labpipe.virtual_lab.three_point_path import ThreePointPath, solve_three_point


@pytest.fixture(scope="module")
def scenario() -> ConduitScenario:
    usual = conduit_scenario("CWB-1")
    return replace(
        usual,
        load_cell=replace(usual.load_cell, noise=0.0, gain_error=0.0),
        markers=replace(usual.markers, noise=0.0, twist=0.1),
        factor=1.1,
    )


@pytest.fixture(scope="module")
def path(scenario: ConduitScenario) -> ThreePointPath:
    return solve_three_point(scenario.test)


def random() -> np.random.Generator:
    return np.random.default_rng(1)


def test_motion_is_that_of_the_source(scenario: ConduitScenario) -> None:
    plan = plan_conduit(scenario)
    _, top, stop = plan.turning_times
    assert np.diff(plan.turning_times) == pytest.approx(58.8)
    progress = plan.progress_at(np.array([0.0, top, stop, 1e3]))
    assert progress == pytest.approx([0.0, 0.0294, 0.0588, 0.0588])


def test_volts_are_force_by_the_calibration(
    scenario: ConduitScenario, path: ThreePointPath
) -> None:
    plan = plan_conduit(scenario)
    record = record_conduit_force(path, scenario, plan, random())
    force = -0.21082 * record.volts + 0.002846
    times = record.clock / (1.0 + 20e-6) + 6e-3
    wanted = 1.1 * path.force(plan.progress_at(times))
    assert force == pytest.approx(wanted, abs=0.21082 * 200.0 / 2**16)
    assert np.max(record.volts) < 1.0
    assert np.min(record.volts) < -20.0
    assert list(record.signals) == ["Model Root/Load Cell", "Model Root/Trigger"]


def test_the_frame_says_where_its_crosshead_is(
    scenario: ConduitScenario, path: ThreePointPath
) -> None:
    plan = plan_conduit(scenario)
    record = record_crosshead(path, scenario, plan, random())
    assert np.max(record.displacement) == pytest.approx(0.0294, abs=5e-5)
    assert record.time[np.argmax(record.displacement)] == pytest.approx(
        plan.turning_times[1], abs=0.1
    )
    assert np.std(record.force - 1.1 * path.force(plan.progress_at(record.time))) > 1.0


def test_markers_stand_on_a_cylinder_and_turn(
    scenario: ConduitScenario, path: ThreePointPath
) -> None:
    markers = scenario.markers
    progress = np.array([0.0, 0.0147, 0.0294])
    seen = cylinder_markers(path, markers, progress)
    places, angles = marker_places(markers)
    middle = np.flatnonzero(places == 0.0)
    x, y, _ = path.points(progress, np.array([0.0]))
    off = seen[:, middle] - np.stack([x, y, 0.0 * x], axis=2)
    radius = np.linalg.norm(off, axis=2)
    assert radius == pytest.approx(markers.centre_offset, abs=1e-12)
    around = np.arctan2(off[:, :, 2], off[:, :, 1])  # right-handed about x: from y to z
    turned = around - around[0]
    assert turned == pytest.approx(np.outer([0.0, 0.05, 0.1], [1.0, 1.0]), abs=1e-12)
    assert np.degrees(angles[middle]) == pytest.approx([35.0, -35.0])


def test_takes_have_labels_in_disorder_and_their_own_clock(
    scenario: ConduitScenario, path: ThreePointPath
) -> None:
    plan = plan_conduit(scenario)
    take = film_conduit(path, scenario, plan, random())
    assert take.bodies == ()
    assert take.positions.shape[1:] == (22, 3)
    assert list(take.names) == [f"Bundle:Marker{n}" for n in range(1, 23)]
    assert set(take.labels) == set(take.names)
    assert list(take.labels) != list(take.names)
    middle = take.names.index(take.labels[int(np.flatnonzero(take.arc_lengths == 0.0)[0])])
    height = take.positions[:, middle, 1]
    lowest = take.time[np.argmin(height)]
    assert lowest == pytest.approx(plan.turning_times[1] + scenario.clocks.camera_lead, abs=0.1)
