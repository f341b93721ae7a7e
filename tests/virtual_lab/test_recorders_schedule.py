"""Rest at both ends of both records, and the two clocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, Clocks
from labpipe.virtual_lab.recorders import plan_cantilever


@pytest.mark.parametrize("offset", [-3.0, 0.0, 1.37, 20.0])
def test_both_records_rest_before_and_after(offset: float) -> None:
    scenario = CantileverScenario(clocks=Clocks(rate=100.0, offset=offset), rest=4.5)
    schedule = plan_cantilever(scenario)
    start, end = schedule.turning_times[[0, -1]]
    for record in (schedule.frame_times, schedule.force_times):
        assert start - record[0] >= 4.5 - 1e-9
        assert record[-1] - end >= 4.5 - 1e-9


def test_force_time_is_offset_and_drift_times_marker_time() -> None:
    schedule = plan_cantilever(
        CantileverScenario(clocks=Clocks(rate=100.0, offset=2.0, drift=1e-3))
    )
    np.testing.assert_allclose(schedule.force_clock, 2.0 + 1.001 * schedule.force_times)


def test_step_of_the_recorder() -> None:
    schedule = plan_cantilever(CantileverScenario(clocks=Clocks(rate=1000.0)))
    np.testing.assert_allclose(np.diff(schedule.force_clock), 0.99985e-3)
    assert schedule.force_clock[0] == 0.0


def test_full_size() -> None:
    schedule = plan_cantilever(CantileverScenario())
    assert len(schedule.force_clock) > 3_180_000
    assert len(schedule.frame_times) > 15_900
    np.testing.assert_allclose(np.diff(schedule.turning_times), 53.0)


def test_dwell_stops_the_clamp_at_every_turn() -> None:
    schedule = plan_cantilever(replace(CantileverScenario(), dwell=2.0))
    first_top = schedule.turning_times[1]
    during = schedule.progress_at(first_top + np.array([-1.0, 0.0, 1.0, 2.0, 3.0]))
    assert during == pytest.approx([0.052, 0.053, 0.053, 0.053, 0.054])
    np.testing.assert_allclose(np.diff(schedule.turning_times), [53.0, *[55.0] * 5])
