"""Rings of markers, sections, and the axis of a bundle on two supports."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from labpipe.markers.three_point_axis import (
    MARKER_DIRECTIONS,
    Sections,
    _find_motion_direction,
    _linearise,
    compute_section_centres,
    compute_twist,
    find_sections,
    fit_bent_axis,
    fit_rest_axis,
    fit_specimen_shape,
)
from labpipe.markers.track_repair import RepairedTracks, compute_ring_centres
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import PointFlag
from labpipe.records.recording import MarkerTracks
from tests.builders.three_point import RADIUS, SPAN, STROKE, BendingRecord, curvature_at, tracks

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


@pytest.mark.parametrize(("count", "tolerance"), [(3, 1e-4), (4, 1e-12)])
def test_a_missing_marker_does_not_move_the_centre(count: int, tolerance: float) -> None:
    # 4: a rigid fit of the three in sight; 3: interpolated between both ends, 18 degrees apart
    markers, centre = turning_ring(count)
    markers[60:120, 1] = np.nan
    tracks = repaired(markers)
    rings = compute_ring_centres(tracks, {"low": tracks.names})
    assert (rings.flags[60:120, 0] == PointFlag.FILLED).all()
    assert (rings.flags == PointFlag.FILLED).sum() == 60
    np.testing.assert_allclose(rings.positions[:, 0], centre, atol=tolerance * 3)
    assert [note.message for note in rings.notes] == [
        "low: centre computed without low:1 in 60 frames"
    ]


def test_a_centre_is_as_certain_as_its_least_certain_marker() -> None:
    markers, _ = turning_ring(3)
    flags = np.ones((FRAMES, 3), dtype=np.uint8)
    flags[5, 1], flags[6] = PointFlag.RELABELLED, [1, 2, 3]
    tracks = RepairedTracks(("a", "b", "c"), markers, flags, ())
    rings = compute_ring_centres(tracks, {"ring": ("a", "b", "c")})
    assert rings.flags[4:8, 0].tolist() == [1, PointFlag.RELABELLED, PointFlag.FILLED, 1]


STILL = (0.0, 0.0, 1e-9)


def take(**more: object) -> tuple[MarkerTracks, Flags]:
    record = BendingRecord(noise=STILL, **more)  # type: ignore[arg-type]
    markers = tracks(record, np.random.default_rng(0))
    return markers, np.asarray(markers.time < 2.0)


def test_frame_and_sections() -> None:
    markers, rest = take()
    sections = find_sections(markers.positions, rest, min_distance=0.004)

    assert sections.n_sections == 15
    assert np.allclose(np.diff(sections.x), 0.0127, atol=1e-6)
    assert np.linalg.det(sections.rotation_lab_to_specimen) == pytest.approx(1.0)
    lab_down = np.array([0.0, -1.0, 0.0])  # mid-span goes down in the frame of the cameras
    assert sections.rotation_lab_to_specimen[1] @ lab_down == pytest.approx(1.0, abs=1e-4)
    assert np.nanmax(sections.markers[..., 1]) > 0.9 * STROKE


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_axis_lies_a_radius_from_every_marker(sign: float) -> None:
    markers, rest = take()
    sections = find_sections(markers.positions, rest, min_distance=0.004)

    axis = fit_rest_axis(sections, radius=RADIUS, direction=(0.0, sign))

    distance = np.linalg.norm(sections.rest_xyz[:, 1:] - axis, axis=1)
    assert np.allclose(distance, RADIUS, atol=1e-6)
    assert -sign * axis[1] > 0.0


def test_rigid_sections_that_tilt_and_turn_have_their_centres_and_twists() -> None:
    """Three markers, one of them hidden in one frame, and a section of a single row."""
    rng = np.random.default_rng(5)
    axis, section = np.array([0.01, -0.02]), np.repeat([0, 1], [3, 2])
    off = rng.normal(scale=0.01, size=(5, 3))
    off[:3] -= [off[:3, 0].mean(), 0.0, 0.0]
    off[3:] = [[0.001, 0.009, 0.002], [-0.001, 0.009, 0.002]]
    at_rest = off + np.column_stack([0.1 * section, np.broadcast_to(axis, (5, 2))])
    slope, twist, centres = (
        rng.normal(size=(4, 2)),
        rng.uniform(-3, 3, 4),
        rng.normal(size=(4, 2, 3)),
    )
    turns = Rotation.from_euler("ZX", np.stack([slope, np.stack([twist] * 2, 1)], -1).reshape(8, 2))
    moved = turns.as_matrix().reshape(4, 2, 3, 3)[:, section] @ off[..., None]
    markers = centres[:, section] + moved[..., 0]
    markers[2, 1] = np.nan
    sections = Sections(markers, at_rest, section, np.arange(5), np.eye(3))
    fitted_twist, lever = compute_twist(sections, slope, radius=0.01)
    np.testing.assert_allclose(fitted_twist[[0, 1, 3], 0], twist[[0, 1, 3]], rtol=1e-9)
    assert lever == pytest.approx([np.linalg.norm(off[:3, 1:] - off[:3, 1:].mean(0)), 0.0])
    assert np.isnan(fitted_twist[:, 1]).all()
    turned = np.column_stack([twist, np.full(4, np.nan)])
    middle = compute_section_centres(sections, axis, slope, turned)
    np.testing.assert_allclose(middle, centres, atol=1e-12)


PLACES = 0.0127 * np.arange(-7.0, 8.0)


def points(bend: float) -> Floats:
    """Points with curvature bend x (1 - 2 |x| / span), small slopes, straight overhangs."""
    u = np.clip(1.0 - 2.0 * np.abs(PLACES) / SPAN, 0.0, None)
    half = 0.5 * SPAN
    y = -bend * half**2 * ((1.0 - u) / 2.0 - (1.0 - u**3) / 6.0)
    y -= bend * half / 2.0 * np.clip(np.abs(PLACES) - half, 0.0, None)
    return np.column_stack([PLACES, y, 0.0 * PLACES])[None]


def test_the_small_bend_of_an_elastic_beam() -> None:
    bent = fit_bent_axis(points(0.01), span=SPAN, terms=3)

    assert bent.mid_span_curvature[0] == pytest.approx(0.01, rel=1e-3)
    # To 1 %: over a span the three powers are nearly alike, only their sum is well known.
    assert bent.coefficients[0] == pytest.approx([0.01, 0.0, 0.0], abs=1e-4)
    assert bent.deflection[0] == pytest.approx(0.01 * SPAN**2 / 12.0, rel=1e-3)
    assert abs(bent.mean_support_gradient[0]) == pytest.approx(0.01 * SPAN / 4.0, rel=1e-2)


def test_a_line_is_no_bend_and_missing_points_are_left_out() -> None:
    straight = np.column_stack([PLACES, 0.1 * PLACES + 0.002])[None]
    bent = fit_bent_axis(straight, span=SPAN, terms=3)
    assert bent.mid_span_curvature[0] == pytest.approx(0.0, abs=1e-9)
    assert bent.height[0] == pytest.approx(0.002)

    gaps = points(0.01)
    gaps[0, 3] = np.nan
    assert fit_bent_axis(gaps, span=SPAN, terms=3).mid_span_curvature[0] == pytest.approx(
        0.01, rel=1e-3
    )
    gaps[0, np.delete(np.arange(15), [0, 4, 6, 8, 10, 14])] = np.nan
    assert np.isfinite(fit_bent_axis(gaps, span=SPAN, terms=3).mid_span_curvature).all()
    gaps[0, 0] = np.nan
    assert np.isnan(fit_bent_axis(gaps, span=SPAN, terms=3).mid_span_curvature).all()


def test_the_stated_noise_is_that_of_the_points() -> None:
    random = np.random.default_rng(3)
    rows = np.repeat(points(5.0)[..., :2], 400, axis=0)
    rows[..., 1] += random.normal(0.0, 2e-5, rows.shape[:2])

    bent = fit_bent_axis(rows, span=SPAN, terms=3)

    assert bent.noise == pytest.approx(2e-5, rel=0.1)


def test_the_axis_behind_a_row_of_markers_is_on_the_far_side() -> None:
    """A row at y = z = 1 mm, towards the load, away from it, and on either side."""
    row = np.column_stack([np.linspace(-0.1, 0.1, 7), np.full((7, 2), 1e-3)])
    numbers = np.arange(7)
    sections = Sections(row[None], row, numbers, numbers, np.eye(3))
    sides = [towards for side in ("load", "away", "side") for towards in MARKER_DIRECTIONS[side]]
    axes = [fit_rest_axis(sections, radius=0.004, direction=towards) for towards in sides]
    expected = [[-3e-3, 1e-3], [5e-3, 1e-3], [1e-3, -3e-3], [1e-3, 5e-3]]
    assert np.array(axes) == pytest.approx(np.array(expected))


@pytest.mark.parametrize("moving", [0, 1, 2])
def test_the_direction_is_that_of_the_section_that_moves_farthest(moving: int) -> None:
    """By 3-4-5: 5 mm; the other sections move by 1 mm along z."""
    section, axis = np.repeat(np.arange(3), 2), np.array([1.0, 0.0, 0.0])
    share = np.linspace(0.0, 1.0, 9)[:, None, None]
    moved = share * np.where((section == moving)[:, None], [0.0, -3e-3, 4e-3], [0.0, 0.0, 1e-3])
    direction = _find_motion_direction(moved, section, axis)
    assert direction == pytest.approx([0.0, -0.6, 0.8])


@pytest.mark.slow
@pytest.mark.parametrize("facing", ["side", "load"])
def test_a_bent_rod_with_two_rows_of_markers(facing: str) -> None:
    """The elastica by another method: curvature at full stroke is moment over EI."""
    angles = np.radians([55.0, 125.0] if facing == "side" else [145.0, 215.0])
    record = BendingRecord(noise=(0.0, 0.0, 1e-7), angles=tuple(float(angle) for angle in angles))
    take = tracks(record, np.random.default_rng(0))
    rest = np.asarray(take.time < 2.0)
    sections = find_sections(take.positions, rest, min_distance=0.004)
    is_bent = np.nanmax(np.abs(sections.markers[..., 1] - sections.rest_xyz[:, 1]), axis=1) > 0.015

    shape = fit_specimen_shape(sections, span=SPAN, radius=RADIUS, side=facing, is_bent=is_bent)

    top = int(np.argmin(np.abs(take.time - record.cameras_early - record.lasts)))
    assert shape.axis.mid_span_curvature[top] == pytest.approx(curvature_at(STROKE), rel=8e-3)
    assert shape.axis.deflection[top] == pytest.approx(STROKE, rel=5e-3)
    assert shape.axis.residual[top] < 3e-6
    # Markers ahead of the axis are carried sideways by the twist, which tilts y by 12 mrad.
    close = 1e-3 if facing == "side" else 2.5e-3
    assert np.abs(shape.twist[top]) == pytest.approx(np.full(15, 0.05), abs=close)
    assert shape.mid_span == pytest.approx(0.0, abs=1e-4)
    assert shape.side_change < 0.02


def test_beyond_its_grid_an_axis_goes_on_straight() -> None:
    """A sine of 0.6 is a slope of 0.75 everywhere."""
    grid = np.linspace(-1.0, 1.0, 11)
    x = np.array([[-1.1, -1.0, 0.0, 0.55, 1.0, 1.2]])
    _, y = _linearise(np.array([[0.6, 0.2]]), np.ones((11, 1)), grid, x)
    assert y == pytest.approx(0.2 + 0.75 * x)


def test_what_makes_no_sections() -> None:
    """Unknown members of a ring, too few markers, none that moves, too few sections."""
    ring = repaired(turning_ring(3)[0])
    for members in ((), ("low:0", "high:1")):
        with pytest.raises(ValueError, match=r"ring low=\[.*\]: expected markers out of"):
            compute_ring_centres(ring, {"low": members})
    made, rest = take()
    with pytest.raises(ValueError, match="2 markers seen at rest: expected at least 3"):
        find_sections(made.positions[:, :2], rest, min_distance=0.004)
    with pytest.raises(ValueError, match="the markers do not move: expected a specimen that is"):
        find_sections(np.repeat(made.positions[:1], 80, axis=0), rest[:80], min_distance=0.004)
    is_bent = np.asarray(np.abs(made.time - 62.0) < 20.0)
    for count, message in (
        (16, r"-80.17 mm to \+8.7.* some 45.72 mm away on both sides, which is 60 % of half"),
        (10, "5 sections with markers: expected at least 6"),
    ):
        sections = find_sections(made.positions[:, :count], rest, min_distance=0.004)
        with pytest.raises(ValueError, match=message):
            fit_specimen_shape(sections, span=SPAN, radius=RADIUS, side="side", is_bent=is_bent)
    sections = find_sections(made.positions, rest, min_distance=0.004)
    with pytest.raises(ValueError, match=r"sections with markers 2 lie between supports 15.24 mm"):
        fit_specimen_shape(sections, span=0.01524, radius=RADIUS, side="side", is_bent=is_bent)
