"""Label repair and gap filling: truth is known, so it must come back; notes on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.markers.track_repair import RepairedTracks, repair_tracks
from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag
from tests.approved import Approve
from tests.builders.plain_records import (
    NAMES,
    WireTake,
    blank_columns,
    marker_tracks,
    wire_take,
    with_positions,
)

NOISE = 2e-5


def repair(take: WireTake, **changes: float) -> RepairedTracks:
    limits = {"max_gap": 0.5, "max_jump": 0.004, "frozen_time": 0.2} | changes
    return repair_tracks(take.tracks, track_names=take.tracks.names, clamp=take.clamp, **limits)


def codes(repaired: RepairedTracks) -> list[str]:
    return [note.code for note in repaired.notes]


def message(repaired: RepairedTracks, code: str) -> str:
    return next(note.message for note in repaired.notes if note.code == code)


@given(seed=st.integers(0, 1000), noise=st.floats(1e-6, 1e-4))
def test_a_clean_take_is_left_alone(seed: int, noise: float) -> None:
    take = wire_take(frames=200, seed=seed, noise=noise)
    repaired = repair(take)
    assert repaired.names == NAMES
    np.testing.assert_array_equal(repaired.positions, take.tracks.positions)
    assert (repaired.flags == PointFlag.MEASURED).all()
    assert repaired.notes == ()


@given(data=st.data())
def test_any_permutation_of_labels_is_undone(data: st.DataObject) -> None:
    take, mixed = wire_take(), wire_take().tracks.positions.copy()
    truth = take.tracks.positions
    cuts = sorted(data.draw(st.sets(st.integers(40, 590), min_size=1, max_size=5)))
    moved = np.zeros(truth.shape[:2], dtype=bool)
    for start, stop in zip(cuts, [*cuts[1:], 600], strict=True):
        order = data.draw(st.permutations(range(len(NAMES))))
        mixed[start:stop] = truth[start:stop, order]
        moved[start:stop] = np.argsort(order) != np.arange(len(NAMES))
    repaired = repair(with_positions(take, mixed))
    np.testing.assert_array_equal(repaired.positions, truth)
    np.testing.assert_array_equal(repaired.flags == PointFlag.RELABELLED, moved)


@pytest.mark.parametrize(("start", "stop"), [(0, 300), (200, 350), (250, 600)])
def test_an_unlabelled_track_is_given_back_to_its_marker(start: int, stop: int) -> None:
    take, name = wire_take(), "Unlabeled 1364"
    truth = take.tracks.positions
    mixed = blank_columns(truth, 1)
    mixed[start:stop, 6], mixed[start:stop, 4] = truth[start:stop, 4], np.nan
    repaired = repair(with_positions(take, mixed, name))
    assert repaired.names == NAMES
    np.testing.assert_array_equal(repaired.positions, truth)
    assert (repaired.flags[start:stop, 4] == PointFlag.RELABELLED).all()
    assert (repaired.flags == PointFlag.RELABELLED).sum() == stop - start
    assert codes(repaired) == ["unlabelled_merged"]
    assert f"M5 was labelled as {name}, frames {start} to {stop - 1}" in repaired.notes[0].message


def test_a_frozen_pose_is_removed_and_filled() -> None:
    take, stale = wire_take(), wire_take().tracks.positions.copy()
    stale[301:320, 2] = stale[300, 2]
    repaired = repair(with_positions(take, stale))
    assert codes(repaired) == ["pose_frozen", "gap_filled"]
    assert "M3: stale pose removed, 19 frames, frames 301 to 319" in repaired.notes[0].message
    np.testing.assert_allclose(repaired.positions, take.tracks.positions, atol=2e-4)
    assert (repaired.flags[300:321, 2] == [1] + 19 * [PointFlag.FILLED] + [1]).all()


def test_labels_that_move_on_by_one_marker_as_one_is_lost() -> None:
    """The markers are nearer to each other than `max_jump`."""
    truth, mixed = (wire_take().tracks.positions.copy() for _ in range(2))
    mixed[300:, 2:5] = truth[300:, 3:6]
    mixed[300:, 5] = truth[300:, 2] = np.nan
    repaired = repair(with_positions(wire_take(), mixed), max_jump=0.012)
    np.testing.assert_array_equal(repaired.positions, truth)
    assert codes(repaired) == ["label_switch", "gap_left"]


@pytest.mark.parametrize("back", [312, 420])
def test_labels_that_switch_while_one_marker_is_hidden(back: int) -> None:
    # hidden 300 to back, switched at 305 and ever after: in half a second by position, later
    # because only one marker is missing
    take, mixed = wire_take(), wire_take().tracks.positions.copy()
    truth = take.tracks.positions
    mixed[300:back, 3] = np.nan
    mixed[305:, [2, 3]] = mixed[305:, [3, 2]]
    repaired = repair(with_positions(take, mixed))
    visible = np.ones(600, dtype=bool)
    visible[300:back] = False
    np.testing.assert_array_equal(repaired.positions[:, 2], truth[:, 2])
    np.testing.assert_array_equal(repaired.positions[visible, 3], truth[visible, 3])
    assert (repaired.flags[back:, 3] == PointFlag.RELABELLED).all()
    hidden = PointFlag.FILLED if back == 312 else PointFlag.MISSING
    assert (repaired.flags[300:back, 3] == hidden).all()
    assert "label_ambiguous" not in codes(repaired)
    by_elimination = (
        "M4: assigned a track with another label, frames 420 to 599 (8.400 s to 11.980 s), as the "
        "only marker missing"
    )
    assert (by_elimination in [note.message for note in repaired.notes]) == (back == 420)


def test_a_switch_that_cannot_be_told_is_left_and_noted() -> None:
    # two markers 1 mm apart vanish together and come back exchanged, with a jump limit of 4 mm
    take = wire_take(noise=0.0)
    close = take.tracks.positions.copy()
    close[:, 3] = close[:, 2] + [0.0, 0.0, 0.0009]
    close[300:310, [2, 3]] = np.nan
    mixed = close.copy()
    mixed[310:, [2, 3]] = mixed[310:, [3, 2]]
    repaired = repair(with_positions(take, mixed))
    np.testing.assert_array_equal(repaired.positions[310:], mixed[310:])
    assert (repaired.flags[300:310, [2, 3]] == PointFlag.FILLED).all()  # joined as labelled
    assert not (repaired.flags == PointFlag.RELABELLED).any()
    text = message(repaired, "label_ambiguous")
    assert "may have exchanged labels, frames 299 to 310" in text
    assert "left as labelled" in text


def test_a_reflection_is_dropped_and_told() -> None:
    take = wire_take()
    ghost = blank_columns(take.tracks.positions, 1)
    ghost[100:140, 6] = [0.3, 0.2, 0.1]
    ghost[100:140, 6, 0] += np.linspace(0.0, 0.001, 40)
    ghost[400:403, 2] += 0.05
    repaired = repair(with_positions(take, ghost, "Unlabeled 9"))
    assert codes(repaired) == ["gap_filled", "track_dropped", "track_dropped"]
    dropped = [note.message for note in repaired.notes if note.code == "track_dropped"]
    assert dropped[0] == (
        "Unlabeled 9: a track that belongs to no marker was dropped, "
        "frames 100 to 139 (2.000 s to 2.780 s), "
        "within 1.0 mm"
    )
    assert dropped[1].startswith(
        "M3: a track that belongs to no marker was dropped, frames 400 to 402"
    )
    np.testing.assert_allclose(repaired.positions, take.tracks.positions, atol=2e-4)


@pytest.mark.parametrize(("length", "flag"), [(25, PointFlag.FILLED), (26, PointFlag.MISSING)])
def test_gaps_of_half_a_second_are_filled_relative_to_the_clamp(
    length: int, flag: PointFlag
) -> None:
    """The clamp travels 2 mm in this gap; a straight line against it would be 0.1 mm off."""
    take = wire_take(noise=0.0)
    gappy = take.tracks.positions.copy()
    gappy[300 : 300 + length, 5] = np.nan
    repaired = repair(with_positions(take, gappy))
    assert (repaired.flags[300 : 300 + length, 5] == flag).all()
    assert (repaired.flags == flag).sum() == length
    is_filled = flag == PointFlag.FILLED
    assert codes(repaired) == ["gap_filled" if is_filled else "gap_left"]
    whole = take.tracks.positions if is_filled else gappy
    np.testing.assert_allclose(repaired.positions, whole, atol=4e-5)


def short(names: tuple[str, ...] = NAMES, clamp: Floats | None = None) -> WireTake:
    take = wire_take(frames=50)
    tracks = marker_tracks(names, take.tracks.positions[:, : len(names)])
    return WireTake(tracks, take.clamp if clamp is None else clamp)


@pytest.mark.parametrize(
    ("take", "changes", "message"),
    [
        (short(), {"max_gap": 0.0}, "max_gap=0.0: expected a value above 0"),
        (short(), {"max_jump": -1.0}, "max_jump=-1.0: expected a value above 0"),
        (short(), {"frozen_time": float("nan")}, "frozen=nan: expected a value above 0"),
        (short(("M1", "M2")), {}, "markers=2: .* at least 3 markers along the specimen.*M1, M2"),
        (short(("M1", "M1", "M2")), {}, "along=.*: expected different names out of"),
        (short(clamp=np.full((50, 3), np.nan)), {}, "clamp: expected positions of the clamp"),
    ],
)
def test_what_cannot_be_repaired(take: WireTake, changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        repair(take, **changes)


def test_two_orphans_at_once_are_not_given_to_anyone() -> None:
    take, mixed = wire_take(), wire_take().tracks.positions.copy()
    truth = take.tracks.positions
    mixed[300:420, [3, 4]] = np.nan
    mixed[305:] = mixed[305:, [3, 4, 2, 0, 1, 5]]
    mixed[305:, [3, 4]] = truth[305:, [0, 1]]
    repaired = repair(with_positions(take, mixed))
    np.testing.assert_array_equal(repaired.positions[:, [0, 1]], truth[:, [0, 1]])
    assert (repaired.flags[420:, [3, 4]] == PointFlag.MISSING).all()
    assert "a second track under this label, frames 420 to 599" in message(
        repaired, "label_ambiguous"
    )


def test_notes_on_repairs(approved: Approve) -> None:
    take = wire_take()
    truth = take.tracks.positions
    jumped, gappy, missing = (truth.copy() for _ in range(3))
    stand_ins, ghosts = blank_columns(truth, 2), blank_columns(truth, 15)
    jumped[300:, 5] += [0.0, 0.0, 0.008]
    gappy[10:400:20, 2] = np.nan
    stand_ins[200:300, 6], stand_ins[300:380, 7] = truth[200:300, 1], truth[300:380, 1]
    stand_ins[200:380, 1] = stand_ins[240:245, 6] = np.nan
    for ghost in range(15):
        path = np.linspace(1, 1.001, 5)[:, None]
        ghosts[40 * ghost : 40 * ghost + 5, 6 + ghost] = path
    missing[:, 1] = np.nan
    nameless = blank_columns(truth, 2)
    nameless[200:, 6], nameless[200:, 0] = truth[200:, 0], np.nan
    nameless[50:90, 7] = 0.5
    names = tuple(f"Unlabeled {number}" for number in range(15))
    bare = repair(WireTake(marker_tracks(names[:8], nameless), take.clamp), frozen_time=5.0)
    repairs = {
        "a jump that stays": repair(with_positions(take, jumped)),
        "many gaps": repair(with_positions(take, gappy)),
        "two stand-ins": repair(with_positions(take, stand_ins, *names[:2])),
        "fifteen ghosts": repair(with_positions(take, ghosts, *names)),
        "without names": bare,
        "a marker missing throughout": repair(with_positions(take, missing)),
    }
    assert repairs["a marker missing throughout"].names == ("M1", "M3", "M4", "M5", "M6")
    np.testing.assert_array_equal(repairs["a jump that stays"].positions, jumped)
    np.testing.assert_allclose(repairs["two stand-ins"].positions, truth, atol=2e-4)
    assert bare.names == names[:6]
    np.testing.assert_array_equal(bare.positions, truth)
    approved(
        f"{case}: {note.severity} {note.code}: {note.message}"
        for case, repaired in repairs.items()
        for note in repaired.notes
    )
