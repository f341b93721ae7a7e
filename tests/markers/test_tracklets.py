"""Where tracks are cut, which poses are stale, how tracklets go on, which marker they are."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.marker_names import Naming, is_unlabelled, name_chains
from labpipe.markers.tracklets import (
    Links,
    Tracklets,
    cut_tracklets,
    frozen_samples,
    in_sight,
    link_tracklets,
)
from labpipe.records.arrays import Floats
from tests.builders.plain_records import wire_take


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


def links(positions: Floats, *, max_gap: float = 0.2) -> Links:
    time = np.arange(len(positions)) / 50
    pieces = cut_tracklets(positions, positions, time, max_jump=0.004)
    return link_tracklets(pieces, positions, time, max_gap=max_gap, max_jump=0.004)


def fast_point(frames: int = 60, step: float = 0.003) -> Floats:
    """One point at 3 mm per frame, in the first of two tracks; the other is blank."""
    positions = np.full((frames, 2, 3), np.nan)
    positions[:, 0] = np.arange(frames)[:, None] * [step, 0.0, 0.0]
    return positions


def test_a_moving_point_is_found_where_it_was_heading() -> None:
    positions = fast_point()
    positions[28:, 1], positions[20:, 0] = positions[28:, 0], np.nan
    assert links(positions).chain.tolist() == [0, 0]


@pytest.mark.parametrize(("blank", "joined"), [(10, True), (11, False)])
def test_the_longest_gap_that_is_bridged(blank: int, joined: bool) -> None:
    positions = fast_point()
    positions[20 : 20 + blank] = np.nan
    assert (links(positions).chain.tolist() == [0, 0]) is joined


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


@pytest.mark.parametrize(
    "name", ["Unlabeled 12", "Unlabeled:108", "unlabelled", "Take:Unlabeled 4"]
)
def test_names_the_program_gave_for_want_of_better(name: str) -> None:
    assert is_unlabelled(name)


@pytest.mark.parametrize("name", ["M1", "SA-low:Marker1", "tip (Unlabeled 3)"])
def test_names_that_mean_something(name: str) -> None:
    assert not is_unlabelled(name)


def name(pieces: list[tuple[int, int, int, int]], names: tuple[str, ...]) -> Naming:
    """Pieces as chain, column, start, stop; 100 frames at 50 per second, columns 0.1 m apart."""
    chain, column, start, stop = np.array(pieces).T
    relative = np.zeros((100, len(names), 3))
    relative[..., 0] = 0.1 * np.arange(len(names))
    tracklets = Tracklets(column, start, stop)
    links = Links(chain, np.full(len(chain), -1), ())
    time = np.arange(100) / 50
    return name_chains(
        names, tracklets, links, relative=relative, time=time, settled=0.2, apart=0.004
    )


def test_the_first_settled_label_names_the_chain() -> None:
    found = name([(0, 0, 0, 5), (0, 1, 5, 30), (0, 2, 30, 100)], ("A", "B", "C"))
    assert list(found.markers) == [1]


def test_the_longer_of_two_keeps_the_name_and_the_other_goes_to_the_free_marker() -> None:
    pieces = [(0, 0, 0, 20), (1, 1, 0, 30), (0, 1, 30, 100), (2, 0, 40, 100)]
    found = name(pieces, ("A", "B"))
    assert [chain.start for chain in found.markers[1]] == [0, 40]
    assert [label for label, _ in found.eliminated] == [1]


def test_with_two_free_markers_nothing_is_decided() -> None:
    pieces = [(0, 0, 0, 20), (1, 1, 0, 30), (3, 2, 0, 30), (0, 1, 30, 100), (2, 0, 40, 100)]
    found = name(pieces, ("A", "B", "C"))
    assert found.eliminated == ()
    assert [chain.start for chain in found.doubtful] == [40]


def test_a_glitch_is_no_marker() -> None:
    pieces = [(0, 0, 0, 20), (1, 1, 0, 30), (0, 1, 30, 100), (2, 0, 40, 45)]
    found = name(pieces, ("A", "B"))
    assert found.eliminated == ()
    assert found.doubtful == ()
    assert [chain.start for chain in found.leftover] == [40]
