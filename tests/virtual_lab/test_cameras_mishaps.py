"""Gaps, swapped labels, other names, frozen markers: as asked for, and as logged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.cameras import UNLABELLED, MishapEvent
from labpipe.virtual_lab.cantilever_scenarios import (
    NO_MISHAPS,
    CantileverScenario,
    Mishaps,
    Stretch,
)
from labpipe.virtual_lab.observations import Observation, observe


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


def test_gaps_are_short_but_one_and_fall_into_the_motion(scenario: CantileverScenario) -> None:
    seen, _ = with_mishaps(scenario, replace(NO_MISHAPS, n_gaps=30, long_gap=1.2))
    lengths = [event.stop - event.start for event in seen.take.log]
    assert lengths[-1] == 60
    assert all(2 <= length <= 15 for length in lengths[:-1])
    first, last = seen.truth.cycles[0].start_time, seen.truth.cycles[-1].stop_time
    assert all(first * 50 <= e.start and e.stop <= last * 50 + 1 for e in seen.take.log)
    assert len({event.markers for event in seen.take.log}) > 3


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


def test_marker_goes_on_without_its_label(scenario: CantileverScenario) -> None:
    seen, clean = with_mishaps(scenario, replace(NO_MISHAPS, unlabelled=Stretch(5, 0.5, 0.6)))
    event = only(seen)
    during, other = slice(event.start, event.stop), seen.take.names.index(UNLABELLED)
    np.testing.assert_array_equal(
        seen.take.positions[during, other], clean.take.positions[during, column(seen, 5)]
    )
    assert np.all(np.isnan(seen.take.positions[during, column(seen, 5)]))
    assert np.all(np.isnan(seen.take.positions[: event.start, other]))


def test_frozen_marker_stands_still(scenario: CantileverScenario) -> None:
    seen, _ = with_mishaps(scenario, replace(NO_MISHAPS, frozen=Stretch(7, 0.2, 0.25)))
    event = only(seen)
    assert np.all(np.ptp(seen.take.positions[event.start : event.stop, column(seen, 7)], 0) == 0)
    assert np.ptp(seen.take.positions[event.stop : event.stop + 50, column(seen, 7)]) > 0


def test_no_mishaps(scenario: CantileverScenario) -> None:
    seen, _ = with_mishaps(scenario, NO_MISHAPS)
    assert seen.take.log == ()
    assert not np.isnan(seen.take.positions).any()
    assert UNLABELLED not in seen.take.names


@pytest.mark.parametrize(
    "mishaps",
    [
        replace(NO_MISHAPS, switch=Stretch(7, 0.1, 0.2)),
        replace(NO_MISHAPS, frozen=Stretch(-1, 0.1, 0.2)),
        replace(NO_MISHAPS, unlabelled=Stretch(1, 0.2, 0.2)),
    ],
)
def test_a_mishap_to_no_marker_is_refused(scenario: CantileverScenario, mishaps: Mishaps) -> None:
    with pytest.raises(ValueError, match=r"=Stretch\(.*: allowed are markers 0 to [67] and"):
        with_mishaps(scenario, mishaps)
