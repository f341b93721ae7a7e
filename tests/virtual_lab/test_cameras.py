"""Markers and clamp: where they are, how noisy; gaps, swapped labels, frozen markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.virtual_lab import observe
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, MarkerLayout
from labpipe.virtual_lab.instruments import NO_MISHAPS, MarkerInterval
from labpipe.virtual_lab.lab_files import Observation

EXACT = MarkerLayout(noise=0.0, pivot_noise=0.0, turn_noise=0.0)


@pytest.fixture(scope="module")
def clean(scenario: CantileverScenario) -> Observation[CantileverScenario]:
    return observe(replace(scenario, mishaps=NO_MISHAPS), 11)


@pytest.fixture(scope="module")
def exact(scenario: CantileverScenario) -> Observation[CantileverScenario]:
    return observe(replace(scenario, mishaps=NO_MISHAPS, markers=EXACT), 11)


def wire(observation: Observation[CantileverScenario]) -> Floats:
    """Positions of the wire markers from the clamp on, turned back into the specimen frame."""
    take, pose = observation.records["markers"], observation.scenario.pose
    columns = [take.labels.index(label) for label in take.specimen_labels]
    positions: Floats = (take.positions[:, columns] - pose.origin) @ pose.compute_rotation()
    return positions


def test_markers_stand_off_the_axis_and_are_spaced_along_it(
    exact: Observation[CantileverScenario],
) -> None:
    positions = wire(exact)[0]
    arc = np.array(exact.scenario.markers.list_arc_lengths(0.085))
    assert arc[-1] == pytest.approx(0.081)
    # at rest the wire sags a little under the counterweight
    np.testing.assert_allclose(positions[:, 0], arc, atol=3e-5)
    assert positions[0, 1] == pytest.approx(0.0008, abs=5e-5)
    assert np.all(positions[:, 2] == pytest.approx(0.0, abs=1e-12))


def test_clamp_goes_down_with_the_travel(exact: Observation[CantileverScenario]) -> None:
    pose, pivot = exact.scenario.pose, exact.records["markers"].bodies[0].position
    place = (pivot - pose.origin) @ pose.compute_rotation()
    place[:, 1] += exact.truth["travel"]
    np.testing.assert_allclose(place, np.tile([-0.006, -0.009, 0.012], (len(place), 1)), atol=1e-12)


def test_noise_of_markers_and_clamp(
    clean: Observation[CantileverScenario], exact: Observation[CantileverScenario]
) -> None:
    columns = [
        exact.records["markers"].labels.index(name) for name in clean.records["markers"].labels
    ]
    noise = clean.records["markers"].positions - exact.records["markers"].positions[:, columns]
    np.testing.assert_allclose(np.std(noise, axis=0), 3e-5, rtol=0.05)
    pivot = (
        clean.records["markers"].bodies[0].position - exact.records["markers"].bodies[0].position
    )
    np.testing.assert_allclose(np.std(pivot, axis=0), 1e-5, rtol=0.05)
    turns = 2.0 * clean.records["markers"].bodies[0].rotation[:, :3]
    np.testing.assert_allclose(np.std(turns, axis=0), 3e-4, rtol=0.05)


def test_gaps_and_swapped_markers(scenario: CantileverScenario) -> None:
    """Against the same take without mishaps: its noise is the same, so that all else is equal."""
    quick = replace(scenario, clocks=replace(scenario.clocks, rate=50.0))
    clean = observe(replace(quick, mishaps=NO_MISHAPS), 5).records["markers"]
    names = [clean.labels.index(label) for label in clean.specimen_labels]
    for mishaps in (
        replace(NO_MISHAPS, n_gaps=6, long_gap=1.2),
        replace(NO_MISHAPS, switch=MarkerInterval(2, 0.4, 0.6)),
        replace(NO_MISHAPS, switch=MarkerInterval(2, 0.4, 1.0)),
    ):
        take = observe(replace(quick, mishaps=mishaps), 5).records["markers"]
        expected = clean.positions.copy()
        for event in take.mishap_events:
            period, columns = slice(event.start, event.stop), [names[n] for n in event.markers]
            if mishaps.switch:
                assert event.markers == (2, 3)
                assert event.stop == int(mishaps.switch.stop * len(take.time))
                expected[period, columns] = clean.positions[period, columns[::-1]]
            else:
                expected[period, columns] = np.nan
        assert take.mishap_events
        np.testing.assert_array_equal(take.positions, expected)
