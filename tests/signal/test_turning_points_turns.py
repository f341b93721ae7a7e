from __future__ import annotations

import numpy as np
import pytest

from labpipe.signal.turning_points import sharpest_turn, turn_near


def test_the_corner_and_not_the_largest_value() -> None:
    time = np.arange(0.0, 100.0, 0.01)
    rise = np.sin(np.pi * np.clip(time, 0.0, 60.0) / 90.0)  # largest at 45 s, turns at 60 s
    force = np.where(time < 60.0, rise, rise[6000] - 0.1 * (time - 60.0))

    assert sharpest_turn(time, force, width=1.0) == pytest.approx(60.0, abs=0.2)


def test_blanks_and_noise_do_not_matter() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    force = 20.0 - np.abs(time - 20.0) + np.random.default_rng(1).normal(0.0, 0.05, len(time))
    force[1500:1520] = np.nan

    assert sharpest_turn(time, force, width=1.0) == pytest.approx(20.0, abs=0.2)


def test_a_record_that_ends_under_load_has_no_turn() -> None:
    """The head of a load frame touches at 2 s, which is no turn, nor is the noise at rest."""
    time = np.arange(0.0, 40.0, 0.01)
    force = np.clip(time - 5.0, 0.0, None) + 0.5 * np.exp(-(((time - 2.0) / 0.3) ** 2))
    force += np.random.default_rng(1).normal(0.0, 0.02, len(time))

    assert sharpest_turn(time, force, width=1.0) is None


def test_noise_has_no_turn() -> None:
    time = np.arange(0.0, 40.0, 0.01)
    noise = np.random.default_rng(1).normal(0.0, 1.0, len(time))

    assert sharpest_turn(time, noise, width=1.0) is None


def test_nothing_that_turns() -> None:
    time = np.arange(0.0, 10.0, 0.01)

    assert sharpest_turn(time, time, width=1.0) is None
    assert sharpest_turn(time[:100], -np.abs(time[:100] - 0.5), width=1.0) is None


@pytest.mark.parametrize("dwell", [0.0, 0.2, 1.0, 5.0])
@pytest.mark.parametrize("seen_at", [0.0, 1.0])
def test_a_turn_with_a_wait_is_found_by_both_corners(dwell: float, seen_at: float) -> None:
    """The steep corner is the second one: seen near either, the first one is found."""
    time = np.arange(0.0, 60.0, 0.002)
    past = time - 30.0
    force = 0.02 * np.minimum(past, 0.0) - 0.6 * np.clip(past - dwell, 0.0, 0.2)
    force -= 0.1 * np.maximum(past - dwell - 0.2, 0.0)
    force += np.random.default_rng(4).normal(0.0, 2e-3, len(time))
    force[1000:1050] = np.nan
    near = 30.0 + seen_at * dwell

    found = turn_near(time, force, near=near, reach=dwell + 1.0, width=1.0, dwell=dwell)
    assert found == pytest.approx(30.0, abs=0.1)


def test_a_record_too_short_for_a_turn_with_a_wait() -> None:
    time = np.arange(0.0, 3.0, 0.01)
    assert turn_near(time, -np.abs(time - 1.5), near=1.5, reach=1.0, width=2.0, dwell=0.0) is None
    assert turn_near(time, np.full(300, np.nan), near=1.5, reach=1.0, width=0.2, dwell=0.1) is None
    assert turn_near(time, time, near=1.5, reach=1.0, width=0.5, dwell=9.0) is None
