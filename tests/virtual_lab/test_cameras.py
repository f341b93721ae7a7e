"""Markers and clamp: where they are, how noisy, in which frame of reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import NO_MISHAPS, CantileverScenario, MarkerLayout
from labpipe.virtual_lab.observations import Observation, observe

EXACT = MarkerLayout(noise=0.0, pivot_noise=0.0, turn_noise=0.0)


@pytest.fixture(scope="module")
def clean(scenario: CantileverScenario) -> Observation:
    return observe(replace(scenario, mishaps=NO_MISHAPS), 11)


@pytest.fixture(scope="module")
def exact(scenario: CantileverScenario) -> Observation:
    return observe(replace(scenario, mishaps=NO_MISHAPS, markers=EXACT), 11)


def wire(observation: Observation) -> Floats:
    """Positions of the wire markers from the clamp on, turned back into the specimen frame."""
    take, pose = observation.take, observation.scenario.pose
    columns = [take.names.index(label) for label in take.labels]
    turned: Floats = (take.positions[:, columns] - pose.origin) @ pose.rotation()
    return turned


def test_markers_stand_off_the_axis_and_are_spaced_along_it(exact: Observation) -> None:
    straight = wire(exact)[0]
    arc = np.array(exact.scenario.markers.arc_lengths(0.085))
    assert arc[-1] == pytest.approx(0.081)
    # at rest the wire sags a little under the counterweight
    np.testing.assert_allclose(straight[:, 0], arc, atol=3e-5)
    assert straight[0, 1] == pytest.approx(0.0008, abs=5e-5)
    assert np.all(straight[:, 2] == pytest.approx(0.0, abs=1e-12))


def test_stand_off_is_along_the_local_normal_at_the_top(exact: Observation) -> None:
    truth = exact.truth
    shape = max(truth.shapes, key=lambda s: float(s.y[-1]))
    points = wire(exact)[shape.frame]
    points[:, 1] += truth.travel[shape.frame]
    fine = np.linspace(0.0, 0.085, 2000)
    x, y = (np.interp(fine, shape.arc_length, values) for values in (shape.x, shape.y))
    away = np.hypot(points[:, :1] - x, points[:, 1:2] - y).min(axis=1)
    np.testing.assert_allclose(away, 0.0008, atol=2e-5)


def test_clamp_goes_down_with_the_travel(exact: Observation) -> None:
    pose, pivot = exact.scenario.pose, exact.take.body.position
    place = (pivot - pose.origin) @ pose.rotation()
    np.testing.assert_allclose(place[:, 1] + exact.truth.travel, -0.009, atol=1e-12)
    np.testing.assert_allclose(place[:, 0], -0.006, atol=1e-12)
    np.testing.assert_allclose(place[:, 2], 0.012, atol=1e-12)


def test_noise_of_markers_and_clamp(clean: Observation, exact: Observation) -> None:
    columns = [exact.take.names.index(name) for name in clean.take.names]
    noise = clean.take.positions - exact.take.positions[:, columns]
    np.testing.assert_allclose(np.std(noise, axis=0), 3e-5, rtol=0.05)
    pivot = clean.take.body.position - exact.take.body.position
    np.testing.assert_allclose(np.std(pivot, axis=0), 1e-5, rtol=0.05)
    turns = 2.0 * clean.take.body.rotation[:, :3]
    np.testing.assert_allclose(np.std(turns, axis=0), 3e-4, rtol=0.05)


def test_body_is_a_unit_quaternion_with_an_error(clean: Observation) -> None:
    np.testing.assert_allclose(np.linalg.norm(clean.take.body.rotation, axis=1), 1.0)
    assert np.all(clean.take.body.error >= 0.0)
    assert np.median(clean.take.body.error) == pytest.approx(4.5e-5, rel=0.05)


def test_fitted_markers_lie_near_the_measured_ones(clean: Observation) -> None:
    columns = [clean.take.names.index(f"Clamp:Marker{n}") for n in (1, 2, 3, 4)]
    apart = clean.take.fitted - clean.take.positions[:, columns]
    assert np.std(apart) < 5e-5
    assert np.all((clean.take.quality <= 1.0) & (clean.take.quality > 0.9))


def test_names_in_the_order_of_an_export(observation: Observation) -> None:
    clamp = [f"Clamp:Marker{n}" for n in range(1, 5)]
    along = [f"Wire:Marker{n}" for n in range(1, 9)]
    assert list(observation.take.names) == [*clamp, *along, "Unlabeled 1234"]


def test_labels_are_scrambled_unless_told(scenario: CantileverScenario) -> None:
    ordered = tuple(f"Wire:Marker{n}" for n in range(1, 9))
    tidy = replace(scenario, markers=replace(scenario.markers, scrambled=False))
    assert observe(tidy, 11).take.labels == ordered
    scrambled = observe(scenario, 11).take.labels
    assert scrambled != ordered
    assert sorted(scrambled) == list(ordered)


def test_recording_holds_tracks_and_body(observation: Observation) -> None:
    tracks = observation.markers.markers
    assert tracks is not None
    assert tracks.body("Clamp") is not None
    assert tracks.rate == 50.0
    assert tracks.frames[3] == 3.0
