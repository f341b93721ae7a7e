from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from labpipe.readers.tracking import blank, is_unlabelled, longest, runs, track_notes, unchanged
from labpipe.records.recording import MarkerTracks, RigidBody


def take(**positions: np.ndarray) -> MarkerTracks:
    frames = len(next(iter(positions.values()))) if positions else 5
    stack = np.stack(list(positions.values()), axis=1) if positions else np.empty((5, 0, 3))
    numbers = np.arange(float(frames))
    names = tuple(name.replace("_", " ") for name in positions)
    return MarkerTracks(numbers / 50.0, numbers, 50.0, names, stack)


def moving(frames: int = 40) -> np.ndarray:
    return np.arange(frames * 3.0).reshape(frames, 3)


def codes(tracks: MarkerTracks) -> dict[str, str]:
    return {f"{note.code} {note.where}": note.message for note in track_notes(tracks)}


@given(st.lists(st.booleans()))
def test_runs_are_the_flags(flags: list[bool]) -> None:
    array = np.array(flags, dtype=np.bool_)
    rebuilt = np.zeros(len(flags), dtype=np.bool_)
    stretches = runs(array)
    for run in stretches:
        assert not rebuilt[max(run.first - 1, 0) : run.last + 1].any()
        rebuilt[run.first : run.last + 1] = True
    np.testing.assert_array_equal(rebuilt, array)
    assert sum(run.length for run in stretches) == sum(flags)
    assert longest(stretches) == max(len(s) for s in "".join("01"[f] for f in flags).split("0"))


def test_blank_and_unchanged() -> None:
    track = moving(6)
    track[2, 1] = np.nan
    track[5] = track[4]
    assert blank(track).tolist() == [False, False, True, False, False, False]
    assert unchanged(track).tolist() == [False, False, False, False, True]


def test_unlabelled_names() -> None:
    assert all(map(is_unlabelled, ["Unlabeled 2379", "Unlabeled:108", "Marker-1718"]))
    assert not any(map(is_unlabelled, ["Clamp:Marker1", "Rigid Body 1-Marker 5"]))


def test_an_ordinary_take_has_no_notes() -> None:
    assert codes(take(tip=moving(), base=moving() + 1.0)) == {}


def test_an_empty_take() -> None:
    assert codes(take()) == {"take_empty take": "the take holds no rigid body and no marker"}


def test_gaps_and_markers_never_seen() -> None:
    track = moving()
    track[[3, 4, 9]] = np.nan
    notes = codes(take(tip=track, base=np.full((40, 3), np.nan)))
    assert notes == {
        "marker_gaps tip": "missing in 3 of 40 frames, gaps: 2, the longest 2 frames",
        "marker_blank markers": "never seen: base",
    }


def test_a_frozen_body() -> None:
    track = moving()
    track[10:30] = track[10]
    body = RigidBody("Clamp", track, np.full((40, 4), np.nan), np.full(40, np.nan))
    tracks = take(tip=moving())
    tracks = MarkerTracks(tracks.time, tracks.frames, 50.0, ("tip",), tracks.positions, (body,))
    assert codes(tracks) == {
        "frozen_pose Clamp": "position unchanged to the last digit in 19 of 39 steps,"
        " up to 19 in a row: lost and kept at its last pose?"
    }


def test_a_label_switch() -> None:
    labelled, spare, passing = moving(), moving(), moving()
    labelled[:12] = np.nan
    spare[12:] = np.nan
    passing[5:] = np.nan
    notes = codes(take(tip=labelled, Unlabeled_7=spare, Unlabeled_8=passing))
    assert notes["label_switch tip"] == (
        "missing in rows 0-11, just where Unlabeled 7 is seen: label switch?"
    )
    assert notes["unlabelled_markers markers"] == "2 of 3 markers have no label of their own"
    assert sum(key.startswith("label_switch") for key in notes) == 1
