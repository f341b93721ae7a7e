"""Where tracks are cut, which poses are stale, how tracklets go on, which marker they are."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.markers.tracklets import (
    ChainAssignment,
    Links,
    Tracklets,
    _compute_distances,
    assign_chains,
    cut_tracklets,
    find_frozen_samples,
    is_in_sight,
    is_unlabelled,
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
    assert not is_in_sight(positions)[9, 1]


def test_tracks_that_are_noise_are_refused() -> None:
    """Of 300 frames, the pieces are still joined; of 3000, they would fill the memory."""
    noise = np.random.default_rng(3).normal(0.0, 0.004, (3000, 3, 3))
    assert len(cuts(noise[:300])) > 600
    with pytest.raises(ValueError, match=r"the tracks break into \d{4} pieces of 1\.\d samples"):
        cuts(noise)


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
    stale = find_frozen_samples(positions, take.tracks.time, min_frozen_time=0.2)
    assert np.argwhere(stale).tolist() == [[frame, 1] for frame in range(41, 51)]


def test_a_take_in_which_nothing_moves_is_not_stale() -> None:
    still = np.ones((100, 3, 3))
    time = np.arange(100) / 50
    assert not find_frozen_samples(still, time, min_frozen_time=0.2).any()
    clamp = np.arange(300.0).reshape(100, 3)
    assert find_frozen_samples(still, time, min_frozen_time=0.2, reference=clamp)[1:].all()
    assert not find_frozen_samples(still[:1], time[:1], min_frozen_time=0.2).any()


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
    assert links(positions).successor.tolist() == [1, -1]


def test_how_far_a_start_is_from_where_an_end_was_heading() -> None:
    """The cube of time: 12^3 - 9^3 less 3 times the mean of (9^3 - 4^3) / 5, (17^3 - 12^3) / 5."""
    time = np.arange(30.0)
    path = np.zeros((30, 1, 3))
    path[:, 0, 1] = time**3
    pieces = Tracklets(np.zeros(2, np.int64), np.array([0, 12]), np.array([10, 30]))
    apart = _compute_distances(pieces, path, time, np.array([0]), np.array([1]))
    assert apart == pytest.approx([3.0 * (133.0 + 637.0) / 2.0 - 999.0])


@pytest.mark.parametrize(("blank", "joined"), [(10, True), (11, False)])
def test_the_longest_gap_that_is_bridged(blank: int, joined: bool) -> None:
    positions = fast_point()
    positions[20 : 20 + blank] = np.nan
    assert (links(positions).successor[0] == 1) == joined


def test_least_total_distance_decides_between_competitors() -> None:
    # both vanish; they come back 3 mm off, so each start lies within reach of both ends
    positions = np.zeros((60, 2, 3))
    positions[:, 0, 0] = 0.0
    positions[:, 1, 0] = 0.0035
    positions[:, :, 1] = np.arange(60)[:, None] * 1e-5
    positions[20:25] = np.nan
    positions[25:] = positions[25:, ::-1]
    chosen_links = links(positions)
    # the crossing is nearer by 3.5 mm, more than the quarter of max_jump that a label weighs
    assert chosen_links.successor.tolist()[:2] == [3, 2]
    assert chosen_links.ambiguous_pairs == ()


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
    chosen_links = links(positions)
    assert chosen_links.successor.tolist() == [-1, -1, -1]
    assert chosen_links.ambiguous_pairs == ((0, 1),)


def test_names_the_program_gave_for_want_of_better() -> None:
    assert all(map(is_unlabelled, ("Unlabeled 12", "Take:unlabelled 4", "Marker-17")))
    assert not any(map(is_unlabelled, ("SA-low:Marker1", "A-Marker 1", "tip (Unlabeled 3)")))


def name(pieces: list[tuple[int, int, int, int]], names: tuple[str, ...]) -> ChainAssignment:
    """Pieces as chain, column, start, stop; 100 frames at 50 per second, columns 0.1 m apart."""
    chain, column, start, stop = np.array(pieces).T
    relative = np.zeros((100, len(names), 3))
    relative[..., 0] = 0.1 * np.arange(len(names))
    later = [np.flatnonzero(chain[i + 1 :] == number) for i, number in enumerate(chain)]
    successor = np.array([i + 1 + x[0] if len(x) else -1 for i, x in enumerate(later)])
    tracks, links, time = Tracklets(column, start, stop), Links(successor, ()), np.arange(100) / 50
    return assign_chains(
        names, tracks, links, relative=relative, time=time, min_label_time=0.2, min_distance=0.004
    )


FIRST = [(0, 0, 0, 20), (1, 1, 0, 30), (0, 1, 30, 100)]
"""A settles first; B is cut where the chain of A goes on under its label."""
NAMED = {
    "the first settled label": ([(0, 0, 0, 5), (0, 1, 5, 30), (0, 2, 30, 100)], {1: [0]}, [], []),
    "the other goes to the only free marker": (
        *([*FIRST, (2, 0, 40, 100)], {0: [0], 1: [0, 40]}, [], []),
    ),
    "two free markers": (
        [*FIRST[:2], (3, 2, 0, 30), FIRST[2], (2, 0, 40, 100)],
        *({0: [0], 1: [0], 2: [0]}, [40], []),
    ),
    "a glitch is no marker": ([*FIRST, (2, 0, 40, 45)], {0: [0], 1: [0]}, [], [40]),
}


@pytest.mark.parametrize("case", NAMED)
def test_which_marker_a_chain_is(case: str) -> None:
    """Starts of the chains of each marker, of doubtful chains and of those left over."""
    pieces, markers, doubtful, leftover = NAMED[case]
    names = ("A", "B", "C")[: 1 + max(column for _, column, _, _ in pieces)]
    naming = name(pieces, names)
    starts = {label: [chain.start for chain in of] for label, of in naming.markers.items()}
    assert starts == markers
    assert [chain.start for chain in naming.doubtful_chains] == doubtful
    assert [chain.start for chain in naming.unassigned_chains] == leftover
    by_elimination = [label for label, _ in naming.eliminations]
    assert by_elimination == ([1] if "only free" in case else [])
