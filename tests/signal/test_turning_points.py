"""Turning points of a motion: strokes, corners, reversals, rests and jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import AT_REST, Curve, Direction
from labpipe.signal.turning_points import (
    _average_blocks_of_width,
    _compute_dwell_times,
    _ExtremeSide,
    count_rest_samples,
    find_dwell_turn,
    find_level_jumps,
    find_sharpest_turn,
    find_strokes,
    goes_down,
    make_branches,
    moves_at_end,
)

STEP = 0.02


def ramps(*corners: tuple[float, float], noise: float = 0.0) -> tuple[Floats, Floats]:
    """A motion through (time s, position mm) corners at 50 frames per second."""
    times, places = zip(*corners, strict=True)
    time = np.arange(times[0], times[-1], STEP)
    motion = 1e-3 * np.interp(time, times, places)
    return time, motion + np.random.default_rng(0).normal(0.0, noise, len(time))


def triangle(cycles: int) -> list[tuple[float, float]]:
    """Rest of 5 s, then cycles of 53 mm at 1 mm/s, then rest."""
    turns = [(5.0 + 53.0 * i, 53.0 * (i % 2)) for i in range(2 * cycles + 1)]
    return [(0.0, 0.0), *turns, (turns[-1][0] + 5.0, turns[-1][1])]


@pytest.mark.parametrize("cycles", [1, 2, 3, 7])
def test_any_number_of_cycles(cycles: int) -> None:
    time, motion = ramps(*triangle(cycles), noise=1e-5)
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    assert [stroke.sign for stroke in strokes] == [1, -1] * cycles
    starts = [float(time[stroke.start]) for stroke in strokes]
    assert starts == pytest.approx([5.0 + 53.0 * i for i in range(2 * cycles)], abs=0.1)
    assert time[strokes[-1].stop] == pytest.approx(5.0 + 106.0 * cycles, abs=0.1)
    part = time < 5.0 + 106.0 * cycles - 40.0
    strokes = find_strokes(time[part], motion[part], min_stroke=5e-3)
    assert [stroke.sign for stroke in strokes] == [1, -1] * cycles
    assert strokes[-1].stop == np.sum(part) - 1


def test_a_smooth_reversal_is_no_dwell() -> None:
    time = np.arange(0.0, 20.0, 0.002)
    noise = np.random.default_rng(2).normal(0, 2e-5, len(time))
    motion = 4e-3 * np.sin(2 * np.pi * time / 0.6) + noise
    strokes = find_strokes(time, motion, min_stroke=1e-3)
    assert len(strokes) == 67
    assert all(a.stop == b.start for a, b in pairwise(strokes))


def test_branches_count_cycles_and_cover_every_stroke() -> None:
    time, motion = ramps(*triangle(2))
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    turns = np.full((4, 2), np.nan)
    turns[0, 1] = turns[1, 0] = 58.0004
    branches = make_branches(time, strokes, turning_times=turns)
    assert [branch.cycle for branch in branches] == [1, 1, 2, 2]
    assert [branch.direction for branch in branches[:2]] == [
        Direction.LOADING,
        Direction.UNLOADING,
    ]
    assert branches[0].stop_time == branches[1].start_time == 58.0004
    branch, cycle = Curve(time, motion, motion, branches).assign_samples()
    inside = slice(strokes[0].start, strokes[-1].stop + 1)
    assert (branch[inside] >= 0).all()
    assert (cycle[inside] >= 1).all()
    assert (branch[: strokes[0].start] == AT_REST).all()
    assert (cycle[strokes[-1].stop + 1 :] == 0).all()


def test_a_way_back_of_just_the_least_stroke_is_a_stroke() -> None:
    motion = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 3.0, 4.0, 5.0])
    strokes = find_strokes(np.arange(10.0), motion, min_stroke=2.0)
    assert [(stroke.start, stroke.stop) for stroke in strokes] == [(0, 4), (4, 6), (6, 9)]
    assert len(find_strokes(np.arange(10.0), motion, min_stroke=2.1)) == 1
    assert len(find_strokes(np.arange(10.0), motion, min_stroke=5.0)) == 1
    for still in (motion, np.zeros(10), np.full(10, np.nan)):
        assert not find_strokes(np.arange(10.0), still, min_stroke=5.1)
    with pytest.raises(ValueError, match="min_stroke=0: expected a positive length"):
        find_strokes(np.arange(10.0), motion, min_stroke=0)


@pytest.mark.parametrize(("dwell", "is_one"), [(0.44, False), (0.64, True)])
def test_a_dwell_lasts_more_than_half_a_percent_of_its_strokes(
    dwell: float, *, is_one: bool
) -> None:
    """Strokes of 100 s; a tolerance of 1e-4 of their way takes 0.04 s off a dwell."""
    time, motion = ramps((0.0, 0.0), (100.0, 100.0), (100.0 + dwell, 100.0), (200.0 + dwell, 0.0))
    first, second = find_strokes(time, motion, min_stroke=5e-3)
    assert (first.stop < second.start) is is_one


def test_the_corner_and_not_the_largest_value() -> None:
    time = np.arange(0.0, 100.0, 0.01)
    rise = np.sin(np.pi * np.clip(time, 0.0, 60.0) / 90.0)  # largest at 45 s, turns at 60 s
    force = np.where(time < 60.0, rise, rise[6000] - 0.1 * (time - 60.0))

    assert find_sharpest_turn(time, force, width=1.0) == pytest.approx(60.0, abs=0.2)


def test_a_record_that_ends_under_load_has_no_turn() -> None:
    """The head of a load frame touches at 2 s, which is no turn, nor is the noise at rest."""
    time = np.arange(0.0, 40.0, 0.01)
    force = np.clip(time - 5.0, 0.0, None) + 0.5 * np.exp(-(((time - 2.0) / 0.3) ** 2))
    force += np.random.default_rng(1).normal(0.0, 0.02, len(time))

    assert find_sharpest_turn(time, force, width=1.0) is None


@pytest.mark.parametrize(("dwell", "seen_at"), [(0.0, 0.0), (0.2, 1.0), (1.0, 0.0), (5.0, 1.0)])
def test_a_turn_with_a_wait_is_found_by_both_corners(dwell: float, seen_at: float) -> None:
    """The steep corner is the second one: seen near either, the first one is turn."""
    time = np.arange(0.0, 60.0, 0.002)
    since = time - 30.0
    force = 0.02 * np.minimum(since, 0.0) - 0.6 * np.clip(since - dwell, 0.0, 0.2)
    force -= 0.1 * np.maximum(since - dwell - 0.2, 0.0)
    force += np.random.default_rng(4).normal(0.0, 2e-3, len(time))
    force[1000:1050] = np.nan
    near = 30.0 + seen_at * dwell

    turn = find_dwell_turn(time, force, middle=near, reach=dwell + 1.0, width=1.0, dwell=dwell)
    assert turn == pytest.approx(30.0, abs=0.1)


def test_a_record_too_short_for_a_turn_with_a_wait() -> None:
    time = np.arange(0.0, 3.0, 0.01)
    assert (
        find_dwell_turn(time, -np.abs(time - 1.5), middle=1.5, reach=1.0, width=2.0, dwell=0.0)
        is None
    )
    assert (
        find_dwell_turn(time, np.full(300, np.nan), middle=1.5, reach=1.0, width=0.2, dwell=0.1)
        is None
    )
    assert find_dwell_turn(time, time, middle=1.5, reach=1.0, width=0.5, dwell=9.0) is None


TIME = np.arange(0.0, 5.0, 0.02)


def path(shape: Floats, noise: float = 0.0) -> Floats:
    values: Floats = shape + np.random.default_rng(3).normal(0.0, noise, len(shape))
    return values


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_a_motion_goes_on_or_rests_at_its_end(noise: float) -> None:
    for sense in (1.0, -1.0):
        assert moves_at_end(TIME, path(sense * TIME / 5.0, noise))
    assert not moves_at_end(TIME, path(np.minimum(TIME, 4.0) / 5.0, noise))


def test_a_motion_that_slows_down_to_its_turn_and_one_of_few_samples() -> None:
    slows = 0.5 - 0.5 * np.cos(np.pi * TIME / 5.0)
    moves = [
        *(moves_at_end(TIME, slows), moves_at_end(TIME[:200], slows[:200])),
        *(moves_at_end(TIME[:2], TIME[:2]), moves_at_end(TIME[:3], TIME[:3])),
        moves_at_end(TIME[:5], np.zeros(5)),
    ]
    assert moves == [False, True, False, True, False]


def stretch(rest: int, noise: float, *, count: int = 60, seed: int = 0) -> Floats:
    """A level of 5 that a line leaves, of slope 1 per sample."""
    line = 5.0 + np.clip(np.arange(float(count)) - rest, 0.0, None)
    values: Floats = line + np.random.default_rng(seed).normal(0.0, noise, count)
    return values


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("rest", [5, 15, 30, 50])
def test_where_a_motion_begins(noise: float, rest: int) -> None:
    assert count_rest_samples(stretch(rest, noise)) == pytest.approx(rest, abs=2)
    assert count_rest_samples(-stretch(rest, noise)) == pytest.approx(rest, abs=2)


def test_all_rest_or_all_motion() -> None:
    for seed in range(100):
        assert count_rest_samples(stretch(60, 1.0, seed=seed)) == 0
        assert count_rest_samples(stretch(0, 1.0, seed=seed)) == 0
    assert count_rest_samples(np.ones(60)) == count_rest_samples(np.ones(3)) == 0


JUMP_TIME = 0.01 * np.arange(2000.0)
RAMP = np.minimum(JUMP_TIME, 20.0 - JUMP_TIME) * 10.0


@pytest.mark.parametrize("size", [10.0, -10.0, 3.0])
def test_a_level_that_moves_from_one_sample_to_the_next(size: float) -> None:
    ((sample, height),) = find_level_jumps(
        JUMP_TIME,
        RAMP + np.where(JUMP_TIME > 6.0, size, 0.0),
    )
    assert JUMP_TIME[sample - 1] <= 6.0 < JUMP_TIME[sample]
    assert height == pytest.approx(size, abs=0.2)


def test_a_hole_in_the_record_is_none() -> None:
    recorded = (JUMP_TIME < 5.0) | (JUMP_TIME > 7.0)
    assert find_level_jumps(JUMP_TIME[recorded], RAMP[recorded]) == ()
    assert find_level_jumps(JUMP_TIME, np.where(recorded, RAMP, np.nan)) == ()
    assert find_level_jumps(JUMP_TIME[:5], RAMP[:5]) == ()
    at = np.arange(40.0)  # more than three times as far as the steps beside it
    for step, count in ((2.9, 0), (3.1, 1)):
        assert len(find_level_jumps(at, at + (step - 1.0) * (at >= 20.0))) == count


def test_which_way_a_signal_goes() -> None:
    """From rest, from half way up under load, and up to where the record breaks off."""
    for corners in (
        ((0, 0), (5, 0), (35, 6), (65, 0), (70, 0)),
        ((0, 3.7), (15, 6), (45, 0), (70, 0)),
        ((0, 0), (5, 0), (35, 6)),
    ):
        _, up = ramps(*corners, noise=1e-5)
        gaps = np.where(np.arange(len(up)) % 7 == 0, np.nan, up)
        for signal in (up, gaps):
            assert not goes_down(signal)
            assert goes_down(-signal) or corners[-1][1]


def test_a_nearly_smooth_reversal_has_no_dwell() -> None:
    """By t4 < 1.5 t1, which a parabola (2 t1) does not reach."""
    for wide, is_dwell in ((0.7, True), (0.8, False), (0.9, False)):
        side = _ExtremeSide(near_time=0.5, wide_time=wide, shortest_dwell=0.05)
        assert (_compute_dwell_times(side, side) != (0.0, 0.0)) == is_dwell


def test_blocks_need_two_widths_and_two_blocks() -> None:
    for duration, is_found in ((2.03, False), (2.07, True)):
        time = np.linspace(0.0, duration, 300)
        assert (_average_blocks_of_width(time, time, 1.0) is not None) == is_found
