"""The specimen frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from labpipe.markers.specimen_frame import SpecimenFrame, find_specimen_frame
from labpipe.records.arrays import Floats
from tests.builders.plain_records import NAMES, WireTake, marker_tracks, wire_take

X, Y, Z = np.eye(3)
REST = slice(0, 100)
vectors = st.tuples(*3 * [st.floats(-10, 10)]).map(np.array)


def frame_of(take: WireTake, *, limit: float = 1e-4) -> SpecimenFrame:
    return find_specimen_frame(
        take.clamp,
        take.tracks.positions,
        rest_frames=REST,
        plane_limit=limit,
    )


@given(turn=vectors, shift=vectors, order=st.permutations(range(6)))
def test_the_lab_frame_and_the_columns_do_not_matter(
    turn: Floats, shift: Floats, order: list[int]
) -> None:
    take = wire_take()
    rotation = Rotation.from_rotvec(turn).as_matrix()
    markers = take.tracks.positions[:, order] @ rotation.T + shift
    clamp = take.clamp @ rotation.T + shift
    frame = find_specimen_frame(clamp, markers, rest_frames=REST, plane_limit=1e-4)
    straight = frame_of(take)
    assert np.linalg.det(frame.rotation_lab_to_specimen) == pytest.approx(1.0)
    assert [order[column] for column in frame.marker_order] == list(range(6))
    np.testing.assert_allclose(
        frame.to_specimen(markers[:, frame.marker_order]),
        straight.to_specimen(take.tracks.positions),
        atol=1e-9,
    )


def test_clamp_beside_its_line() -> None:
    """A clamp 0.1 mm to either side of its line deviates by 0.1 mm rms, however long the take."""
    take = wire_take()
    sides = np.resize([1e-4, -1e-4, -1e-4, 1e-4], len(take.clamp))
    frame = frame_of(WireTake(take.tracks, take.clamp + sides[:, None] * [0.0, 0.0, 1.0]))
    assert frame.travel_residual == pytest.approx(1e-4, rel=1e-3)


def test_a_curved_wire_is_ordered_along_itself() -> None:
    # a hook: the last markers come back towards the clamp
    angle = np.linspace(0.3, 4.0, 9)
    hook = 0.02 * np.column_stack([np.sin(angle), 1 - np.cos(angle), 0 * angle])
    lift = np.linspace(0, 0.02, 300)
    clamp = np.column_stack([0 * lift, -lift, 0 * lift])
    order = [4, 0, 7, 2, 8, 1, 6, 3, 5]
    markers = hook[order] + clamp[:, None]
    markers[:, :, 1] += lift[:, None] * hook[order, 1]
    markers[:50, 3] = np.nan  # not seen at rest
    frame = find_specimen_frame(clamp, markers, rest_frames=slice(0, 50), plane_limit=1e-4)
    assert [order[column] for column in frame.marker_order] == list(range(9))


def test_markers_off_their_plane_are_told() -> None:
    take, positions = wire_take(), wire_take().tracks.positions.copy()
    positions[:, ::2, 2] += 0.002
    frame = find_specimen_frame(take.clamp, positions, rest_frames=REST, plane_limit=2e-4)
    assert frame.notes[0].code == "out_of_plane"
    distance = f"{1e3 * frame.out_of_plane_distance:.3f} mm (rms)"
    assert frame.notes[0].message == f"markers leave their plane by {distance}, limit 0.2 mm"


def test_without_a_clamp_the_end_that_moves_less_is_the_origin() -> None:
    take = wire_take()
    hanging = (take.tracks.positions - take.clamp[:, None])[:, [3, 5, 0, 2, 1, 4]]
    turn = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
    frame = find_specimen_frame(None, hanging @ turn.T, rest_frames=REST, plane_limit=1e-4)
    assert frame.marker_order == (2, 4, 3, 0, 5, 1)
    assert np.linalg.det(frame.rotation_lab_to_specimen) == pytest.approx(1.0)
    np.testing.assert_allclose(frame.rotation_lab_to_specimen @ turn, np.eye(3), atol=5e-3)
    assert frame.out_of_plane_distance < 5e-5
    np.testing.assert_allclose(frame.origin_lab, turn @ [0.01, 0, 0], atol=1e-5)


def test_markers_never_seen_together_do_not_break_the_order() -> None:
    take, positions = wire_take(), wire_take().tracks.positions.copy()
    positions[300:, 1] = positions[:300, 4] = np.nan
    frame = frame_of(WireTake(marker_tracks(NAMES, positions), take.clamp))
    hanging = positions - take.clamp[:, None]
    chain = find_specimen_frame(None, hanging, rest_frames=REST, plane_limit=1e-4)
    assert frame.marker_order == chain.marker_order == (0, 1, 2, 3, 4, 5)


def test_frames_that_cannot_be_found() -> None:
    take, nothing = wire_take(), np.full((600, 3, 3), np.nan)
    markers, hidden = take.tracks.positions, take.clamp.copy()
    hidden[REST] = np.nan
    cases: list[tuple[Floats | None, Floats, str]] = [
        (None, np.zeros((350, 3, 3)), "expected a vector of a length above 0"),
        (0 * take.clamp + 1.0, markers, "clamp_lab: expected a clamp that moves, found one"),
        (hidden, markers, "the clamp is not seen in any frame of the stretch at rest: make it"),
        (take.clamp, nothing, "markers_lab: expected markers in some frame"),
        (take.clamp, markers[:, :1], "expected at least 2 markers"),
    ]
    for clamp, seen, message in cases:
        with pytest.raises(ValueError, match=message):
            find_specimen_frame(clamp, seen, rest_frames=REST, plane_limit=1e-4)
