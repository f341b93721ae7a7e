from __future__ import annotations

import numpy as np
import pytest

from labpipe.signal.rests_and_jumps import level_jumps

TIME = 0.01 * np.arange(2000.0)
RAMP = np.minimum(TIME, 20.0 - TIME) * 10.0


@pytest.mark.parametrize("size", [10.0, -10.0, 3.0])
def test_a_level_that_moves_from_one_sample_to_the_next(size: float) -> None:
    ((sample, found),) = level_jumps(TIME, RAMP + np.where(TIME > 6.0, size, 0.0))
    assert TIME[sample - 1] <= 6.0 < TIME[sample]
    assert found == pytest.approx(size, abs=0.2)


def test_corners_noise_steps_of_a_converter_and_spikes_are_none() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.5, len(TIME))
    spike = np.where(np.arange(len(TIME)) == 700, 50.0, 0.0)
    for values in (RAMP, RAMP + noise, np.round(RAMP, 0), RAMP + spike, np.full(len(TIME), 2.0)):
        assert level_jumps(TIME, values) == ()


def test_a_hole_in_the_record_is_none() -> None:
    there = (TIME < 5.0) | (TIME > 7.0)
    assert level_jumps(TIME[there], RAMP[there]) == ()
    assert level_jumps(TIME, np.where(there, RAMP, np.nan)) == ()


def test_few_samples() -> None:
    assert level_jumps(TIME[:5], RAMP[:5]) == ()
