"""Markers and clamp: where they are, how noisy; gaps, swapped labels, frozen markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cameras import MishapEvent
from labpipe.virtual_lab.cantilever_scenarios import (
    NO_MISHAPS,
    CantileverScenario,
    MarkerLayout,
    Mishaps,
    Stretch,
)
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


def with_mishaps(scenario: CantileverScenario, mishaps: Mishaps) -> tuple[Observation, Observation]:
    """The same take with and without mishaps: noise is the same."""
    quick = replace(scenario, clocks=replace(scenario.clocks, rate=50.0))
    return (
        observe(replace(quick, mishaps=mishaps), 5),
        observe(replace(quick, mishaps=NO_MISHAPS), 5),
    )


def column(observation: Observation, marker: int) -> int:
    return observation.take.names.index(observation.take.labels[marker])


def only(observation: Observation) -> MishapEvent:
    (event,) = observation.take.log
    return event


def test_gaps_are_blank_and_nothing_else_is(scenario: CantileverScenario) -> None:
    seen, clean = with_mishaps(scenario, replace(NO_MISHAPS, n_gaps=6, long_gap=1.2))
    blank = np.zeros(seen.take.positions.shape[:2], dtype=bool)
    for event in seen.take.log:
        blank[event.start : event.stop, column(seen, event.markers[0])] = True
    np.testing.assert_array_equal(np.isnan(seen.take.positions).all(axis=2), blank)
    np.testing.assert_array_equal(seen.take.positions[~blank], clean.take.positions[~blank])


@pytest.mark.parametrize("stop", [0.6, 1.0])
def test_two_neighbours_swap_labels(scenario: CantileverScenario, stop: float) -> None:
    seen, clean = with_mishaps(scenario, replace(NO_MISHAPS, switch=Stretch(2, 0.4, stop)))
    event, frames = only(seen), len(seen.take.time)
    assert (event.markers, event.stop) == ((2, 3), int(stop * frames))
    one, other = column(seen, 2), column(seen, 3)
    during = slice(event.start, event.stop)
    np.testing.assert_array_equal(
        seen.take.positions[during, one], clean.take.positions[during, other]
    )
    np.testing.assert_array_equal(
        seen.take.positions[during, other], clean.take.positions[during, one]
    )
    np.testing.assert_array_equal(
        seen.take.positions[: event.start], clean.take.positions[: event.start]
    )


def test_frozen_marker_stands_still(scenario: CantileverScenario) -> None:
    seen, _ = with_mishaps(scenario, replace(NO_MISHAPS, frozen=Stretch(7, 0.2, 0.25)))
    event = only(seen)
    assert np.all(np.ptp(seen.take.positions[event.start : event.stop, column(seen, 7)], 0) == 0)
    assert np.ptp(seen.take.positions[event.stop : event.stop + 50, column(seen, 7)]) > 0
