"""Turning points of a motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats
from labpipe.records.curve import AT_REST, Direction
from labpipe.signal.turning_points import (
    Stroke,
    branch_numbers,
    find_strokes,
    goes_down,
    noise_level,
    split_branches,
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


@pytest.mark.parametrize(
    ("corners", "down"),
    [
        (((0, 0), (5, 0), (35, 6), (65, 0), (70, 0)), False),
        (((0, 0), (5, 0), (35, -6), (65, 0), (70, 0)), True),
        (((0, 3.7), (15, 6), (45, 0), (70, 0)), False),  # begins under load
        (((0, -3.7), (15, -6), (45, 0), (70, 0)), True),
        (((0, 0), (5, 0), (35, 6)), False),  # breaks off
    ],
    ids=["up", "down", "begins halfway up", "begins halfway down", "ends at the top"],
)
def test_which_way_a_signal_goes(corners: tuple[tuple[float, float], ...], *, down: bool) -> None:
    _, signal = ramps(*corners, noise=1e-5)
    assert goes_down(signal) is down
    signal[::7] = np.nan
    assert goes_down(signal) is down


def test_a_signal_without_values_goes_nowhere() -> None:
    assert not goes_down(np.full(5, np.nan))


def test_noise_makes_no_stroke_that_ends_before_it_begins() -> None:
    """As a column of force makes that was taken for the displacement."""
    time = np.arange(0.0, 120.0, 0.1)
    noise = 1.5e-3 * np.random.default_rng(2).standard_normal(len(time))
    strokes = find_strokes(time, noise, min_stroke=5e-3)
    assert strokes
    assert all(stroke.start < stroke.stop for stroke in strokes)


def test_neighbours_share_their_turning_sample() -> None:
    time, motion = ramps(*triangle(3), noise=1e-5)
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    assert all(a.stop == b.start for a, b in pairwise(strokes))


def test_a_partial_last_cycle_is_a_stroke() -> None:
    time, motion = ramps((0, 0), (20, 20), (40, 0), (52, 12))
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    assert [stroke.sign for stroke in strokes] == [1, -1, 1]
    assert strokes[-1].stop == len(time) - 1


def test_dwell_belongs_to_neither_branch() -> None:
    corners = [(0.0, 0.0), (5.0, 0.0), (25.0, 20.0), (35.0, 20.0), (55.0, 0.0), (60.0, 0.0)]
    time, motion = ramps(*corners, noise=1e-5)
    first, second = find_strokes(time, motion, min_stroke=5e-3)
    assert time[first.stop] == pytest.approx(25.0, abs=0.1)
    assert time[second.start] == pytest.approx(35.0, abs=0.1)


@pytest.mark.parametrize("dwell", [1.0, 3.0])
def test_where_the_largest_sample_of_a_dwell_is_does_not_matter(dwell: float) -> None:
    """It is chance: the dwell is looked at on both of its sides together."""
    times, places = (0.0, 5.0, 45.0, 45.0 + dwell, 85.0 + dwell), (0.0, 0.0, 40.0, 40.0, 0.0)
    time = np.arange(0.0, 90.0, STEP)
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0.0, 1e-5, len(time))
        motion = 1e-3 * np.interp(time, times, places) + noise
        first, second = find_strokes(time, motion, min_stroke=5e-3)
        assert time[first.stop] == pytest.approx(45.0, abs=0.1)
        assert time[second.start] == pytest.approx(45.0 + dwell, abs=0.1)


def test_a_smooth_reversal_is_no_dwell() -> None:
    time = np.arange(0.0, 20.0, 0.002)
    noise = np.random.default_rng(2).normal(0, 2e-5, len(time))
    motion = 4e-3 * np.sin(2 * np.pi * time / 0.6) + noise
    strokes = find_strokes(time, motion, min_stroke=1e-3)
    assert len(strokes) == 67
    assert all(a.stop == b.start for a, b in pairwise(strokes))


def test_a_long_record_is_thinned_but_all_there() -> None:
    time = np.arange(0.0, 318.0, 1e-3)
    motion = 0.053 * np.abs(((time / 53.0) + 1) % 2 - 1)
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    assert len(strokes) == 6
    assert time[strokes[0].stop] == pytest.approx(53.0, abs=0.02)


@given(st.floats(-1.0, 1.0), st.floats(-100.0, 100.0), st.sampled_from([-1.0, 1.0]))
def test_offset_shift_and_direction_do_not_move_the_turns(
    offset: float, shift: float, sign: float
) -> None:
    time, motion = ramps(*triangle(2))
    plain = find_strokes(time, motion, min_stroke=5e-3)
    moved = find_strokes(time + shift, sign * motion + offset, min_stroke=5e-3)
    assert [stroke.sign for stroke in moved] == [int(sign) * stroke.sign for stroke in plain]
    for a, b in zip(plain, moved, strict=True):
        assert abs(a.start - b.start) <= 1
        assert abs(a.stop - b.stop) <= 1


def test_gaps_are_bridged() -> None:
    time, motion = ramps(*triangle(2), noise=1e-5)
    whole = find_strokes(time, motion, min_stroke=5e-3)
    motion[1000:1050] = np.nan
    assert len(find_strokes(time, motion, min_stroke=5e-3)) == len(whole)


def test_nothing_moves() -> None:
    time = np.arange(0.0, 10.0, STEP)
    assert find_strokes(time, np.zeros_like(time), min_stroke=1e-3) == ()
    assert find_strokes(time, np.full_like(time, np.nan), min_stroke=1e-3) == ()


def test_min_stroke_must_be_positive() -> None:
    with pytest.raises(ValueError, match="min_stroke=0: expected a positive length"):
        find_strokes(np.arange(3.0), np.arange(3.0), min_stroke=0)


def test_noise_level_sees_noise_and_not_the_ramp() -> None:
    _, motion = ramps(*triangle(2), noise=1e-5)
    assert noise_level(motion) == pytest.approx(1e-5, rel=0.05)
    assert noise_level(np.arange(4.0)) == 0.0


def test_branches_count_cycles_and_cover_every_stroke() -> None:
    time, motion = ramps(*triangle(2))
    strokes = find_strokes(time, motion, min_stroke=5e-3)
    turns = np.full((4, 2), np.nan)
    turns[0, 1] = turns[1, 0] = 58.0004
    branches = split_branches(time, strokes, turning_times=turns)
    assert [branch.cycle for branch in branches] == [1, 1, 2, 2]
    assert [branch.direction for branch in branches[:2]] == [
        Direction.LOADING,
        Direction.UNLOADING,
    ]
    assert branches[0].stop_time == branches[1].start_time == 58.0004
    branch, cycle = branch_numbers(len(time), branches)
    inside = slice(strokes[0].start, strokes[-1].stop + 1)
    assert (branch[inside] >= 0).all()
    assert (cycle[inside] >= 1).all()
    assert (branch[: strokes[0].start] == AT_REST).all()
    assert (cycle[strokes[-1].stop + 1 :] == 0).all()


def test_a_downward_first_stroke_is_loading() -> None:
    branches = split_branches(np.arange(3.0), (Stroke(0, 1, -1), Stroke(1, 2, 1)))
    assert [branch.direction for branch in branches] == [Direction.LOADING, Direction.UNLOADING]


def test_a_way_back_of_just_the_least_stroke_is_a_stroke() -> None:
    motion = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 3.0, 4.0, 5.0])
    strokes = find_strokes(np.arange(10.0), motion, min_stroke=2.0)
    assert [(stroke.start, stroke.stop) for stroke in strokes] == [(0, 4), (4, 6), (6, 9)]
    assert len(find_strokes(np.arange(10.0), motion, min_stroke=2.1)) == 1
    assert len(find_strokes(np.arange(10.0), motion, min_stroke=5.0)) == 1
    assert not find_strokes(np.arange(10.0), motion, min_stroke=5.1)


@pytest.mark.parametrize(("dwell", "is_one"), [(0.44, False), (0.64, True)])
def test_a_dwell_lasts_more_than_half_a_percent_of_its_strokes(
    dwell: float, *, is_one: bool
) -> None:
    """Strokes of 100 s; a tolerance of 1e-4 of their way takes 0.04 s off a dwell."""
    time, motion = ramps((0.0, 0.0), (100.0, 100.0), (100.0 + dwell, 100.0), (200.0 + dwell, 0.0))
    first, second = find_strokes(time, motion, min_stroke=5e-3)
    assert (first.stop < second.start) is is_one
