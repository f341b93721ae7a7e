"""What can be seen in a recording, by numbers alone."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.rests_and_jumps import (
    moves_at_end,
    samples_at_rest,
    standing_stretches,
)

TIME = np.arange(0.0, 5.0, 0.02)


def path(shape: Floats, noise: float = 0.0) -> Floats:
    values: Floats = shape + np.random.default_rng(3).normal(0.0, noise, len(shape))
    return values


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_motion_that_goes_on(noise: float, sense: float) -> None:
    assert moves_at_end(TIME, path(sense * TIME / 5.0, noise))


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_a_motion_that_rests_at_its_end(noise: float) -> None:
    assert not moves_at_end(TIME, path(np.minimum(TIME, 4.0) / 5.0, noise))


def test_a_motion_that_slows_down_to_its_turn() -> None:
    assert not moves_at_end(TIME, 0.5 - 0.5 * np.cos(np.pi * TIME / 5.0))
    assert moves_at_end(TIME[:200], (0.5 - 0.5 * np.cos(np.pi * TIME / 5.0))[:200])


def test_a_motion_that_has_turned() -> None:
    assert not moves_at_end(TIME, np.minimum(TIME, 9.8 - TIME))


def test_few_samples() -> None:
    assert moves_at_end(TIME[:3], TIME[:3])
    assert not moves_at_end(TIME[:2], TIME[:2])
    assert not moves_at_end(TIME[:5], np.zeros(5))


def stretch(rest: int, noise: float, *, count: int = 60, seed: int = 0) -> Floats:
    """A level of 5 that a line leaves, of slope 1 per sample."""
    line = 5.0 + np.clip(np.arange(float(count)) - rest, 0.0, None)
    values: Floats = line + np.random.default_rng(seed).normal(0.0, noise, count)
    return values


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("rest", [5, 15, 30, 50])
def test_where_a_motion_begins(noise: float, rest: int) -> None:
    assert samples_at_rest(stretch(rest, noise)) == pytest.approx(rest, abs=2)
    assert samples_at_rest(-stretch(rest, noise)) == pytest.approx(rest, abs=2)


def test_all_rest_or_all_motion() -> None:
    for seed in range(200):
        assert samples_at_rest(stretch(60, 1.0, seed=seed)) == 0
        assert samples_at_rest(stretch(0, 1.0, seed=seed)) == 0
    assert samples_at_rest(np.ones(60)) == 0
    assert samples_at_rest(np.ones(3)) == 0


def test_a_noise_that_remembers_seldom_looks_like_a_corner() -> None:
    found = 0
    for seed in range(200):
        white = np.random.default_rng(seed).normal(size=200)
        slow = np.convolve(white, np.exp(-np.arange(40) / 5.0), mode="valid")[:100]
        found += samples_at_rest(slow) > 0
        assert samples_at_rest(slow + 2.0 * np.arange(100.0)) == 0
    assert found < 20


def test_where_a_motion_stands() -> None:
    walk = np.interp(TIME, [0.0, 1.0, 3.0, 5.0], [0.0, 1.0, 1.0, 3.0])
    ((start, stop),) = standing_stretches(TIME, walk, size=5, speed=1.0)
    assert TIME[start] == pytest.approx(1.0, abs=0.2)
    assert TIME[stop] == pytest.approx(3.0, abs=0.2)
    shaken = path(walk, 1.0)
    assert standing_stretches(TIME, shaken, size=5, speed=1.0) == []  # nobody can tell
    assert standing_stretches(TIME[:8], walk[:8], size=2, speed=1.0) == []
    turns = 1.0 - np.cos(np.pi * TIME / 5.0)
    assert standing_stretches(TIME, turns, size=5, speed=1.0) == []
    ((start, stop),) = standing_stretches(TIME, np.minimum(TIME, 1.0), size=1, speed=1.0)
    assert start == pytest.approx(50, abs=2)
    assert stop == 250
