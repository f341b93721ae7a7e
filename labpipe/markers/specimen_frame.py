"""Find the specimen frame: x along the specimen, y towards the pull, z out of the plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats
from labpipe.records.quality import QualityNote

Selection: TypeAlias = slice | Flags
"""Selection of frames: a slice, or a mask of shape (frames,)."""


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenFrame(ArrayRecord):
    """The coordinate system of the specimen in the lab frame, that of the motion-capture system.

    Parameters
    ----------
    rotation_lab_to_specimen : shape (3, 3), rotation matrix with determinant +1
    origin_lab : shape (3,), m, pivot of the clamp at rest, or first marker at rest
    marker_order : indices of the markers in order along the specimen
    out_of_plane_distance : m, root mean square distance of the markers from their plane
    travel_residual : m, root mean square distance of the clamp from its straight path; 0 without a
        clamp
    notes : quality notes
    """

    rotation_lab_to_specimen: Annotated[Floats, 3, 3]
    origin_lab: Annotated[Floats, 3]
    marker_order: tuple[int, ...]
    out_of_plane_distance: float
    travel_residual: float
    notes: tuple[QualityNote, ...] = ()

    def to_specimen(self, positions_lab: Floats) -> Floats:
        """Transform positions of shape (..., 3) from the lab to the specimen frame; NaN is kept."""
        positions = (positions_lab - self.origin_lab) @ self.rotation_lab_to_specimen.T
        return np.asarray(positions, dtype=np.float64)


def _normalise(vector: Floats, name: str) -> Floats:
    """Normalise a vector to the length 1; `name` describes the vector in the error."""
    length = float(np.linalg.norm(vector))
    if not (np.isfinite(length) and length > 1e-12):  # a shorter vector has no direction
        raise ValueError(format_sentence("markers.no_direction", name=name, vector=vector.tolist()))
    return vector / length


def find_specimen_frame(
    clamp_lab: Floats | None, markers_lab: Floats, *, rest_frames: Selection, plane_limit: float
) -> SpecimenFrame:
    """Find the specimen frame and the order of the markers along the specimen.

    Parameters
    ----------
    clamp_lab : shape (frames, 3), m, pivot of the clamp; None for a take without a clamp
    markers_lab : shape (frames, markers, 3), m, positions of the markers; NaN is ignored
    rest_frames : frames in which the specimen is at rest, before the first loading
    plane_limit : m, largest root mean square distance of the markers from their plane without a
        note

    Returns
    -------
    The specimen frame.

    Raises
    ------
    ValueError
        If nothing moves, nothing is visible at rest, or there are fewer than two markers.

    Notes
    -----
    With a clamp, a line is fitted to the path of the clamp by total least squares, and y is
    opposite to the travel along this line. Perpendicular to y, x is the direction in which the
    positions of the markers relative to the clamp spread most. It points away from the clamp, and
    z = x cross y. The rotation about y thus follows from the plane of the specimen over the whole
    take. Without a clamp, the origin is the end of the specimen that moves less, and x points to
    the other end at rest. Perpendicular to x, y is the direction of the largest travel of the
    other end.
    """
    if markers_lab.ndim != 3 or markers_lab.shape[1] < 2:
        raise ValueError(format_sentence("markers.single_marker", shape=markers_lab.shape))
    if clamp_lab is None:
        return _find_marker_frame(markers_lab, rest_frames, plane_limit)
    offsets = markers_lab - clamp_lab[:, None]
    origin = _compute_mean(clamp_lab[rest_frames], "the clamp")
    travel, residual = _fit_travel(clamp_lab, origin)
    transverse_offsets = offsets - (offsets @ travel)[..., None] * travel
    x, out_of_plane = _find_spread_direction(transverse_offsets.reshape(-1, 3), travel)
    rotation = np.stack([x, -travel, np.cross(x, -travel)])
    clamp_distances = np.array(
        [_compute_median_length(marker, rest_frames) for marker in np.moveaxis(offsets, 1, 0)]
    )
    order = _order_markers(_compute_distances(offsets, rest_frames), clamp_distances)
    notes = _make_notes(out_of_plane, plane_limit)
    return SpecimenFrame(
        rotation, origin, order, out_of_plane, travel_residual=residual, notes=notes
    )


def _find_marker_frame(markers: Floats, rest_frames: Selection, limit: float) -> SpecimenFrame:
    """Find the frame without a clamp, as the notes of `find_specimen_frame` state."""
    distances = _compute_distances(markers, rest_frames)
    ends = np.unravel_index(np.argmax(np.nan_to_num(distances, posinf=0.0)), distances.shape)
    travels = [float(np.nanstd(markers[:, end], axis=0).sum()) for end in ends]
    first_marker = int(ends[int(np.argmin(travels))])
    order = _order_markers(distances, distances[first_marker])
    origin = _compute_mean(markers[rest_frames, order[0]], "the marker nearest the clamped end")
    tip = _compute_mean(markers[rest_frames, order[-1]], "the marker nearest the tip")
    x = _normalise(tip - origin, "line from the first to the last marker at rest")
    tip_motion = markers[:, order[-1]] - tip
    y, _ = _find_spread_direction(tip_motion - (tip_motion @ x)[:, None] * x, x)
    rotation = np.stack([x, y, np.cross(x, y)])
    z = (markers - origin) @ rotation[2]
    out_of_plane = float(np.sqrt(np.nanmean((z - np.nanmean(z)) ** 2)))
    notes = _make_notes(out_of_plane, limit)
    return SpecimenFrame(rotation, origin, order, out_of_plane, travel_residual=0.0, notes=notes)


def _fit_travel(path: Floats, origin: Floats) -> tuple[Floats, float]:
    """Fit a line to the path of the clamp; return its direction and the rms distance from it, m.

    The direction is that from `origin` to the most distant point of the path.
    """
    min_rms_travel = 1e-9  # m; a clamp that moves less is at rest
    points = path[np.isfinite(path).all(axis=1)]
    centred_points = points - points.mean(axis=0) if len(points) > 1 else np.zeros((2, 3))
    spread, axes = np.linalg.svd(centred_points, full_matrices=False)[1:]
    if spread[0] <= min_rms_travel * np.sqrt(len(centred_points)):
        raise ValueError(format_sentence("markers.clamp_at_rest"))
    projection = (points - origin) @ axes[0]
    sign = np.sign(projection[np.abs(projection).argmax()])
    return sign * axes[0], float(np.sqrt((spread[1:] ** 2).sum() / len(centred_points)))


def _find_spread_direction(positions: Floats, normal: Floats) -> tuple[Floats, float]:
    """Find the direction of largest spread perpendicular to `normal`, a unit vector.

    The second result is the rms spread perpendicular to `normal` and to this direction, m.
    """
    points = positions[np.isfinite(positions).all(axis=1)]
    if not len(points):
        raise ValueError(format_sentence("markers.none_with_clamp"))
    centred_points = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(centred_points.T @ centred_points / len(points))
    direction = axes[:, 2] - (axes[:, 2] @ normal) * normal
    direction = _normalise(direction, "spread of the markers across the travel")
    out_of_plane_offsets = centred_points @ np.cross(normal, direction)
    projection = points @ direction
    sign = np.sign(projection[np.abs(projection).argmax()])
    return sign * direction, float(np.sqrt(np.mean(out_of_plane_offsets**2)))


def _compute_distances(positions: Floats, rest_frames: Selection) -> Floats:
    """Compute the median distances between markers, (markers, markers), m.

    See `_compute_median_length` for the frames that are used.
    """
    n_markers = positions.shape[1]
    distances = np.zeros((n_markers, n_markers))
    for i in range(n_markers):
        for j in range(i):
            offsets = positions[:, i] - positions[:, j]
            distances[i, j] = distances[j, i] = _compute_median_length(offsets, rest_frames)
    return distances


def _compute_median_length(offsets: Floats, rest_frames: Selection) -> float:
    """Compute the median length of offsets (frames, 3), m.

    Frames at rest are used, or all frames if no offset at rest is known. The length is infinite if
    no offset is known.
    """
    for frame_offsets in (offsets[rest_frames], offsets):
        lengths = np.linalg.norm(frame_offsets, axis=1)
        finite_lengths = lengths[np.isfinite(lengths)]
        if len(finite_lengths):
            return float(np.median(finite_lengths))
    return np.inf


def _order_markers(distances: Floats, start_distances: Floats) -> tuple[int, ...]:
    """Order the markers along the specimen: each marker is followed by the nearest remaining one.

    The first marker is that with the smallest start distance.
    """
    order = [int(np.argmin(start_distances))]
    while len(order) < len(distances):
        remaining_markers = [marker for marker in range(len(distances)) if marker not in order]
        order.append(min(remaining_markers, key=lambda marker: distances[order[-1], marker]))
    return tuple(order)


def _compute_mean(positions: Floats, name: str) -> Floats:
    """Compute the mean position of a point, shape (3,), m; `name` names the point in the error."""
    known_positions = positions[np.isfinite(positions).all(axis=-1)]
    if not len(known_positions):
        raise ValueError(format_sentence("markers.none_at_rest", name=name))
    return np.asarray(known_positions.mean(axis=0), dtype=np.float64)


def _make_notes(out_of_plane: float, plane_limit: float) -> tuple[QualityNote, ...]:
    """Make a note if the distance of the markers from their plane exceeds the limit."""
    if out_of_plane <= plane_limit:
        return ()
    facts = {"deviation": 1e3 * out_of_plane, "limit": 1e3 * plane_limit}
    return (QualityNote.of("markers.out_of_plane", "markers", **facts),)
