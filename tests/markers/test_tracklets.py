"""Where tracks are cut, and which poses are stale."""

from __future__ import annotations

import numpy as np

from labpipe.markers.tracklets import cut_tracklets, frame_period, frozen_samples, in_sight
from labpipe.records.arrays import Floats
from tests.builders.marker_takes import wire_take


def cuts(positions: Floats, *, relative: Floats | None = None) -> list[tuple[int, int, int]]:
    time = np.arange(len(positions)) / 50
    pieces = cut_tracklets(
        positions, positions if relative is None else relative, time, max_jump=0.004
    )
    return list(
        zip(pieces.column.tolist(), pieces.start.tolist(), pieces.stop.tolist(), strict=True)
    )


def walk(columns: int, frames: int = 20) -> Floats:
    start = np.arange(columns) * 0.1
    drift = np.arange(frames)[:, None] * 1e-4 + start
    return np.stack([drift, 0 * drift, 0 * drift], axis=2)


def test_unbroken_tracks_are_one_piece_each() -> None:
    assert cuts(walk(2)) == [(0, 0, 20), (1, 0, 20)]


def test_a_blank_cuts_and_a_half_blank_is_blank() -> None:
    positions = walk(2)
    positions[5:7, 0] = np.nan
    positions[9, 1, 2] = np.nan
    assert cuts(positions) == [(0, 0, 5), (1, 0, 9), (0, 7, 20), (1, 10, 20)]
    assert not in_sight(positions)[9, 1]


def test_a_jump_cuts_only_if_seen_both_ways() -> None:
    positions = walk(2)
    positions[8:, 0] += 0.005
    assert cuts(positions) == [(0, 0, 8), (1, 0, 20), (0, 8, 20)]
    assert cuts(positions, relative=walk(2)) == [(0, 0, 20), (1, 0, 20)]
    assert cuts(walk(2), relative=positions) == [(0, 0, 20), (1, 0, 20)]


def test_an_exchange_of_near_neighbours_cuts() -> None:
    positions = walk(2)
    positions[:, 1] = positions[:, 0] + [0.0, 0.002, 0.0]
    positions[6:] = positions[6:, ::-1]
    assert cuts(positions) == [(0, 0, 6), (1, 0, 6), (0, 6, 20), (1, 6, 20)]


def test_a_take_with_frames_left_out_may_move_further() -> None:
    positions = walk(2)
    positions[10:, :, 0] += 0.006
    time = np.arange(20) / 50
    time[10:] += 0.02
    pieces = cut_tracklets(positions, positions, time, max_jump=0.004)
    assert len(pieces) == 2


def test_period_is_the_median_step() -> None:
    assert frame_period(np.array([0.0, 0.02, 0.04, 5.0])) == 0.02
    assert frame_period(np.array([3.0])) == 1.0


def test_stale_samples_are_those_after_the_first() -> None:
    take = wire_take(frames=100)
    positions = take.tracks.positions.copy()
    positions[40:51, 1] = positions[40, 1]
    positions[60:70, 2] = positions[60, 2]
    stale = frozen_samples(positions, take.tracks.time, frozen=0.2)
    assert np.argwhere(stale).tolist() == [[frame, 1] for frame in range(41, 51)]


def test_a_take_in_which_nothing_moves_is_not_stale() -> None:
    still = np.ones((100, 3, 3))
    time = np.arange(100) / 50
    assert not frozen_samples(still, time, frozen=0.2).any()
    clamp = np.arange(300.0).reshape(100, 3)
    assert frozen_samples(still, time, frozen=0.2, reference=clamp)[1:].all()
    assert not frozen_samples(still[:1], time[:1], frozen=0.2).any()
