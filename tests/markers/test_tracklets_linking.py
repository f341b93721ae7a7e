"""Which tracklet goes on as which."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.tracklets import Links, cut_tracklets, link_tracklets
from labpipe.records.arrays import Floats


def links(positions: Floats, *, max_gap: float = 0.2) -> Links:
    time = np.arange(len(positions)) / 50
    pieces = cut_tracklets(positions, positions, time, max_jump=0.004)
    return link_tracklets(pieces, positions, time, max_gap=max_gap, max_jump=0.004)


def fast_point(frames: int = 60, step: float = 0.003) -> Floats:
    """One point at 3 mm per frame, in the first of two tracks; the other is blank."""
    positions = np.full((frames, 2, 3), np.nan)
    positions[:, 0] = np.arange(frames)[:, None] * [step, 0.0, 0.0]
    return positions


def test_nothing_to_link() -> None:
    found = links(fast_point())
    assert found.chain.tolist() == [0]
    assert found.successor.tolist() == [-1]
    assert found.ambiguous == ()


def test_a_moving_point_is_found_where_it_was_heading() -> None:
    positions = fast_point()
    positions[28:, 1], positions[20:, 0] = positions[28:, 0], np.nan
    assert links(positions).chain.tolist() == [0, 0]


def test_a_point_that_turns_up_elsewhere_is_another() -> None:
    positions = fast_point()
    positions[28:, 1], positions[20:, 0] = positions[28:, 0] + [0.0, 0.03, 0.0], np.nan
    assert links(positions).chain.tolist() == [0, 1]


@pytest.mark.parametrize(("blank", "joined"), [(10, True), (11, False)])
def test_the_longest_gap_that_is_bridged(blank: int, joined: bool) -> None:
    positions = fast_point()
    positions[20 : 20 + blank] = np.nan
    assert (links(positions).chain.tolist() == [0, 0]) is joined


def test_flicker_is_one_chain() -> None:
    positions = fast_point(step=0.001)
    positions[20:40:2, 0] = np.nan
    positions[25, 1], positions[25, 0] = positions[25, 0], np.nan
    assert set(links(positions).chain.tolist()) == {0}


def test_least_total_distance_decides_between_competitors() -> None:
    # both vanish; they come back 3 mm off, so each start lies within reach of both ends
    positions = np.zeros((60, 2, 3))
    positions[:, 0, 0] = 0.0
    positions[:, 1, 0] = 0.0035
    positions[:, :, 1] = np.arange(60)[:, None] * 1e-5
    positions[20:25] = np.nan
    positions[25:] = positions[25:, ::-1]
    found = links(positions)
    # the crossing is nearer by 3.5 mm, more than the quarter of max_jump that a label weighs
    assert found.successor.tolist()[:2] == [3, 2]
    assert found.ambiguous == ()


def test_a_link_is_worth_making_up_to_the_longest_jump() -> None:
    """Both come back 3.8 mm on, the first 3.2 mm short of where the second was."""
    positions = np.zeros((60, 2, 3))
    positions[:, 1, 0] = 0.007
    positions[20:25] = np.nan
    positions[25:, :, 0] += 0.0038
    assert links(positions).successor.tolist() == [2, 3, -1, -1]


def test_of_two_images_equally_near_neither_is_taken() -> None:
    positions = np.full((60, 3, 3), np.nan)
    positions[:20, 0] = 0.0
    positions[25:, 1] = [0.0, 0.0003, 0.0]
    positions[25:, 2] = [0.0, -0.0004, 0.0]
    found = links(positions)
    assert found.successor.tolist() == [-1, -1, -1]
    assert found.ambiguous == ((0, 1),)
