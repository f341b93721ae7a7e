"""What the notes on a repair say; their texts are tested with the repairs in test_tracks."""

from __future__ import annotations

import numpy as np

from labpipe.markers.repair_notes import Take
from labpipe.markers.track_repair import repair_tracks
from labpipe.markers.tracklets import Tracklets
from labpipe.records.quality import Severity
from tests.builders.marker_takes import blank_columns, wire_take, with_positions

NONE = Tracklets(*(np.zeros(0, dtype=np.int64) for _ in range(3)))


def test_stretches_are_named_by_the_frames_of_the_export() -> None:
    take = Take(("A",), np.arange(10.0) + 500, np.arange(10) / 50 + 10, NONE)
    assert take.span(2, 5) == "frames 502 to 504 (10.040 s to 10.080 s)"
    assert take.span(3, 4) == "frame 503 (10.060 s to 10.060 s)"


def test_many_dropped_tracks_are_summed_up() -> None:
    take = wire_take()
    ghosts = blank_columns(take.tracks.positions, 15)
    for ghost in range(15):
        stretch = slice(40 * ghost, 40 * ghost + 5)
        ghosts[stretch, 6 + ghost] = np.linspace(1, 1.001, 5)[:, None]
    broken = with_positions(take, ghosts, *(f"Unlabeled {number}" for number in range(15)))
    repaired = repair_tracks(
        broken.tracks,
        along=broken.tracks.names,
        max_gap=0.5,
        max_jump=0.004,
        frozen=0.2,
        reference=take.clamp,
    )
    assert len(repaired.notes) == 11
    assert all(note.severity is Severity.WARNING for note in repaired.notes)
    assert repaired.notes[-1].message == "5 more tracks of no marker dropped, 25 samples in all"


def test_a_marker_with_two_stand_ins_gets_a_note_for_each() -> None:
    take = wire_take()
    truth = take.tracks.positions
    mixed = blank_columns(truth, 2)
    mixed[200:300, 6], mixed[300:380, 7] = truth[200:300, 1], truth[300:380, 1]
    mixed[200:380, 1] = np.nan
    mixed[240:245, 6] = np.nan
    broken = with_positions(take, mixed, "Unlabeled 1", "Unlabeled 2")
    repaired = repair_tracks(
        broken.tracks,
        along=broken.tracks.names,
        max_gap=0.5,
        max_jump=0.004,
        frozen=0.2,
        reference=take.clamp,
    )
    steps = 1e3 * np.linalg.norm(np.diff(truth[:, 1], axis=0), axis=1)  # mm, from frame to frame
    assert [note.message for note in repaired.notes] == [
        "M2 was labelled as Unlabeled 1, frames 200 to 299 (4.000 s to 5.980 s); merged, "
        f"{steps[199]:.2f} mm apart where they meet",
        "M2 was labelled as Unlabeled 2, frames 300 to 379 (6.000 s to 7.580 s); merged, "
        f"{steps[379]:.2f} mm apart where they meet",
        "M2: gap filled between its ends, relative to the clamp, 5 frames, "
        "frames 240 to 244 (4.800 s to 4.880 s)",
    ]
    np.testing.assert_allclose(repaired.positions, truth, atol=2e-4)
