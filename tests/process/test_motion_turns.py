"""Where a motion turns: in a corner, after a wait, slowly, or unseen."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.process.motion import Turn, check_turns, turning_points
from labpipe.records.arrays import Floats
from labpipe.records.quality import Findings
from labpipe.records.signals import Signal
from labpipe.signal.turning_points import find_strokes
from tests.builders.doubts import doubted
from tests.builders.dwelling_tests import Dwelling

TIME: Floats = np.arange(0.0, 50.0, 0.02)


def travel(*corners: tuple[float, float], seed: int = 1, noise: float = 1e-5) -> Floats:
    """A motion through (time s, position mm) corners."""
    times, places = zip(*corners, strict=True)
    scatter = np.random.default_rng(seed).normal(0, noise, len(TIME))
    motion: Floats = 1e-3 * np.interp(TIME, times, places) + scatter
    return motion


SHARP = travel((0, 0), (5, 0), (25, 20), (45, 0), (50, 0))


def turns_of(motion: Floats, time: Floats = TIME) -> tuple[Findings, list[Turn]]:
    signal = Signal(time, motion, "m", "markers")
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    turns = turning_points(signal, strokes, window=25.0)
    return Findings() + check_turns(signal, strokes, turns), turns


def test_turns_in_corners() -> None:
    found, turns = turns_of(travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0)))
    assert [turn.stroke for turn in turns] == [0, 1, 2]
    for turn in turns:
        assert turn.middle == pytest.approx(15.0 + 10.0 * turn.stroke, abs=5e-3)
        assert len(turn.corners) == 1
        assert turn.dwell == 0.0
    assert not found.doubts


@pytest.mark.slow
@pytest.mark.parametrize("dwell", [0.1, 0.2, 0.5, 1.0, 2.0, 5.0])
def test_waits_have_two_corners(dwell: float) -> None:
    """Also those that no stroke shows; arrival and departure hold within their errors."""
    pulls = []
    for seed in range(10):
        test = Dwelling(dwell, seed=seed)
        time, motion = test.seen_by_cameras()
        _, turns = turns_of(motion, time)
        assert [turn.stroke for turn in turns] == list(range(5))
        for turn, true in zip(
            turns, np.column_stack([test.corners[:-1, 1], test.corners[1:, 0]]), strict=True
        ):
            assert turn.middle == pytest.approx(float(true.mean()), abs=0.02)
            assert len(turn.corners) == 2
            seen = [(each.time, each.time_error) for each in turn.corners]
            pulls += [(at - real) / error for (at, error), real in zip(seen, true, strict=True)]
    assert np.mean(np.abs(pulls) < 1.96) > 0.85


def test_no_wait_is_made_of_noise() -> None:
    for seed in range(15):
        found, turns = turns_of(SHARP + np.random.default_rng(seed).normal(0, 2e-5, len(TIME)))
        assert [turn.dwell for turn in turns] == [0.0]
        assert not found.doubts
        time, motion = Dwelling(0.0, seed=seed).seen_by_cameras()
        assert not any(turn.dwell for turn in turns_of(motion, time)[1])


def test_one_wait_among_corners() -> None:
    corners = ((0, 0), (5, 0), (12, 7), (14, 7), (21, 0), (28, 7), (35, 0), (50, 0))
    found, turns = turns_of(travel(*corners))
    assert [len(turn.corners) for turn in turns] == [2, 1, 1]
    assert turns[0].arrival.time == pytest.approx(12.0, abs=0.02)
    assert turns[0].dwell == pytest.approx(2.0, abs=0.03)
    assert not found.doubts


def test_a_turn_that_was_not_seen() -> None:
    found, turns = turns_of(np.where((TIME > 24.5) & (TIME < 25.5), np.nan, SHARP))
    assert turns == []
    assert set(doubted(found.found)) == {"displacement", "force", "clock"}
    assert doubted(found.found)["clock"].startswith(
        "turn_not_seen: the motion was not seen to turn near 2"
    )


_EITHER = "turn_rounded: the machine waits for "
"""Or slows down there for longer: the travel does not tell which."""


@pytest.mark.parametrize("slows_for", [0.5, 0.8, 1.2])
def test_a_machine_that_slows_down(slows_for: float) -> None:
    """It comes to a stop evenly and goes back as evenly: no corner, and no wait."""
    fine = np.arange(0.0, 50.0, 1e-3)
    speed = np.interp(
        fine, [5, 5, 25 - slows_for / 2, 25 + slows_for / 2, 45, 45], [0, 1, 1, -1, -1, 0]
    )
    rounded = 1e-6 * np.interp(TIME, fine, np.cumsum(speed))
    noise = np.random.default_rng(0).normal(0.0, 1e-5, len(TIME))
    found, _ = turns_of(rounded + noise)
    assert set(doubted(found.found)) == {"displacement", "clock"}
    assert doubted(found.found)["clock"].startswith(("turn_rounded: the travel turns ", _EITHER))
