"""Centres of rings of markers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from labpipe.markers.rings import ring_centres, rings_by_body
from labpipe.markers.track_repair import RepairedTracks
from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag

FRAMES = 200


def turning_ring(count: int) -> tuple[Floats, Floats]:
    """A ring that tips over by 60 degrees while it moves: its markers and their mean."""
    angles = np.arange(count) * 2 * np.pi / count + 0.3
    ring = 0.03 * np.column_stack([0 * angles, np.cos(angles), np.sin(angles)])
    ring[:, 0] = 0.002 * np.arange(count)
    turns = Rotation.from_rotvec(np.linspace(0, 1, FRAMES)[:, None] * [0.0, 0.3, 1.0])
    path = np.linspace(0, 0.2, FRAMES)[:, None] * [1.0, 0.5, 0.0]
    markers = np.einsum("fij,mj->fmi", turns.as_matrix(), ring) + path[:, None]
    return markers, markers.mean(axis=1)


def repaired(markers: Floats) -> RepairedTracks:
    flags = np.where(np.isfinite(markers).all(axis=2), 1, 0).astype(np.uint8)
    names = tuple(f"low:{number}" for number in range(markers.shape[1]))
    return RepairedTracks(names, markers, flags, ())


def test_rings_are_named_after_their_body() -> None:
    names = ["SA-low:Marker1", "tip", "SA-low:Marker2"]
    assert rings_by_body(names) == {
        "SA-low": ("SA-low:Marker1", "SA-low:Marker2"),
        "tip": ("tip",),
    }


def test_centre_of_a_whole_ring_is_the_mean() -> None:
    markers, centre = turning_ring(3)
    tracks = repaired(markers)
    rings = ring_centres(tracks, rings_by_body(tracks.names))
    assert rings.names == ("low",)
    np.testing.assert_array_equal(rings.positions[:, 0], centre)
    assert (rings.flags == PointFlag.MEASURED).all()
    assert rings.notes == ()


@pytest.mark.parametrize(("count", "tolerance"), [(3, 1e-4), (4, 1e-12)])
def test_a_missing_marker_does_not_move_the_centre(count: int, tolerance: float) -> None:
    # 4: a rigid fit of the three in sight; 3: interpolated between both ends, 18 degrees apart
    markers, centre = turning_ring(count)
    markers[60:120, 1] = np.nan
    tracks = repaired(markers)
    rings = ring_centres(tracks, {"low": tracks.names})
    assert (rings.flags[60:120, 0] == PointFlag.FILLED).all()
    assert (rings.flags == PointFlag.FILLED).sum() == 60
    np.testing.assert_allclose(rings.positions[:, 0], centre, atol=tolerance * 3)
    assert [note.message for note in rings.notes] == [
        "low: centre built without low:1 in 60 frames"
    ]


def test_a_ring_out_of_sight_has_no_centre() -> None:
    markers, _ = turning_ring(3)
    markers[10:20] = np.nan
    rings = ring_centres(repaired(markers), {"low": ("low:0", "low:1", "low:2")})
    assert np.isnan(rings.positions[10:20]).all()
    assert (rings.flags[10:20] == PointFlag.MISSING).all()
    assert rings.notes == ()


def test_a_ring_never_whole_is_the_mean_of_what_is_seen() -> None:
    markers, _ = turning_ring(3)
    markers[:, 2] = np.nan
    rings = ring_centres(repaired(markers), {"low": ("low:0", "low:1", "low:2")})
    np.testing.assert_array_equal(rings.positions[:, 0], markers[:, :2].mean(axis=1))
    assert "low: never seen whole; its centre is the mean of the markers in sight" in [
        note.message for note in rings.notes
    ]


def test_a_centre_is_as_certain_as_its_least_certain_marker() -> None:
    markers, _ = turning_ring(3)
    flags = np.ones((FRAMES, 3), dtype=np.uint8)
    flags[5, 1], flags[6] = PointFlag.RELABELLED, [1, 2, 3]
    tracks = RepairedTracks(("a", "b", "c"), markers, flags, ())
    rings = ring_centres(tracks, {"ring": ("a", "b", "c")})
    assert rings.flags[4:8, 0].tolist() == [1, PointFlag.RELABELLED, PointFlag.FILLED, 1]


@pytest.mark.parametrize("members", [(), ("low:0", "high:1")])
def test_a_ring_of_unknown_markers_is_refused(members: tuple[str, ...]) -> None:
    tracks = repaired(turning_ring(3)[0])
    with pytest.raises(ValueError, match=r"ring low=\[.*\]: expected markers out of"):
        ring_centres(tracks, {"low": members})
