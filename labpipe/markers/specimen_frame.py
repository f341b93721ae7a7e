"""Find the specimen frame: x along the specimen, y towards the pull, z out of the plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats
from labpipe.records.quality import QualityNote

Selection: TypeAlias = slice | Flags
"""Some frames: a slice, or a mask of shape (frames,)."""


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenFrame(ArrayRecord):
    """The specimen frame in the lab frame, which is that of the motion-capture system.

    Parameters
    ----------
    rotation_lab_to_specimen : shape (3, 3), proper
    origin_lab : shape (3,), m, pivot of the clamp at rest, or first marker at rest
    marker_order : columns of the markers in order along the specimen
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
    if not (np.isfinite(length) and length > 1e-12):
        raise ValueError(format_sentence("markers.no_direction", name=name, vector=vector.tolist()))
    return vector / length


def find_specimen_frame(
    clamp_lab: Floats | None, markers_lab: Floats, *, rest_frames: Selection, plane_limit: float
) -> SpecimenFrame:
    """Determine the frame of the specimen and the order of its markers.

    Parameters
    ----------
    clamp_lab : shape (frames, 3), m, pivot of the clamp; None for a take without a clamp
    markers_lab : shape (frames, markers, 3), m; NaN is ignored
    rest_frames : frames in which the specimen is at rest, before the first loading
    plane_limit : m, largest distance of the markers from their plane without a note

    Returns
    -------
    The frame.

    Raises
    ------
    ValueError
        If nothing moves, nothing is visible at rest, or there are fewer than two markers.

    Notes
    -----
    With a clamp, y is opposite to the travel of the clamp, a line fitted by total least squares. x
    is the direction perpendicular to y of the largest spread of the markers relative to the clamp,
    away from the clamp, and z = x cross y. The plane of the specimen over the whole take therefore
    determines the rotation about y. Without a clamp, the end that moves less is the origin, x
    points to the other end at rest, and y is the direction perpendicular to x of the largest travel
    of that end.
    """
    if markers_lab.ndim != 3 or markers_lab.shape[1] < 2:
        raise ValueError(format_sentence("markers.single_marker", shape=markers_lab.shape))
    if clamp_lab is None:
        return _find_frame_of_markers(markers_lab, rest_frames, plane_limit)
    relative = markers_lab - clamp_lab[:, None]
    origin = _compute_mean(clamp_lab[rest_frames], "the clamp")
    travel, travel_residual = _fit_travel(clamp_lab, origin)
    normal_part = relative - (relative @ travel)[..., None] * travel
    x, out_of_plane = _find_spread_direction(normal_part.reshape(-1, 3), travel)
    rotation = np.stack([x, -travel, np.cross(x, -travel)])
    clamp_distances = np.array(
        [_compute_median_length(marker, rest_frames) for marker in np.moveaxis(relative, 1, 0)]
    )
    order = _order_markers(_compute_distances(relative, rest_frames), clamp_distances)
    notes = _make_notes(out_of_plane, plane_limit)
    return SpecimenFrame(rotation, origin, order, out_of_plane, travel_residual, notes)


def _find_frame_of_markers(markers: Floats, rest_frames: Selection, limit: float) -> SpecimenFrame:
    """Find the frame from the markers alone, as the notes of `find_specimen_frame` state."""
    distances = _compute_distances(markers, rest_frames)
    ends = np.unravel_index(np.argmax(np.nan_to_num(distances, posinf=0.0)), distances.shape)
    motions = [float(np.nanstd(markers[:, end], axis=0).sum()) for end in ends]
    first_marker = int(ends[int(np.argmin(motions))])
    order = _order_markers(distances, distances[first_marker])
    origin = _compute_mean(markers[rest_frames, order[0]], "the marker nearest the clamped end")
    tip = _compute_mean(markers[rest_frames, order[-1]], "the marker nearest the tip")
    x = _normalise(tip - origin, "line from the first to the last marker at rest")
    tip_motion = markers[:, order[-1]] - tip
    y, _ = _find_spread_direction(tip_motion - (tip_motion @ x)[:, None] * x, x)
    rotation = np.stack([x, y, np.cross(x, y)])
    height = (markers - origin) @ rotation[2]
    out_of_plane = float(np.sqrt(np.nanmean((height - np.nanmean(height)) ** 2)))
    notes = _make_notes(out_of_plane, limit)
    return SpecimenFrame(rotation, origin, order, out_of_plane, 0.0, notes)


def _fit_travel(path: Floats, origin: Floats) -> tuple[Floats, float]:
    """Fit the direction of travel of the clamp from its origin, and the rms deviation, m."""
    measured = path[np.isfinite(path).all(axis=1)]
    centred = measured - measured.mean(axis=0) if len(measured) > 1 else np.zeros((2, 3))
    spread, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    if spread[0] <= 1e-9 * np.sqrt(len(centred)):
        raise ValueError(format_sentence("markers.clamp_at_rest"))
    projection = (measured - origin) @ axes[0]
    sign = np.sign(projection[np.abs(projection).argmax()])
    return sign * axes[0], float(np.sqrt((spread[1:] ** 2).sum() / len(centred)))


def _find_spread_direction(points: Floats, normal: Floats) -> tuple[Floats, float]:
    """Find the direction of largest spread across `normal`, and the rms spread across both, m."""
    measured = points[np.isfinite(points).all(axis=1)]
    if not len(measured):
        raise ValueError(format_sentence("markers.none_with_clamp"))
    centred = measured - measured.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred / len(measured))
    direction = axes[:, 2] - (axes[:, 2] @ normal) * normal
    direction = _normalise(direction, "spread of the markers across the travel")
    normal_direction = np.cross(normal, direction)
    projection = measured @ direction
    sign = np.sign(projection[np.abs(projection).argmax()])
    return sign * direction, float(np.sqrt(np.mean((centred @ normal_direction) ** 2)))


def _compute_distances(positions: Floats, rest_frames: Selection) -> Floats:
    """Compute median distances between markers, m; see `_compute_median_length`."""
    count = positions.shape[1]
    distances = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            offsets = positions[:, i] - positions[:, j]
            distances[i, j] = distances[j, i] = _compute_median_length(offsets, rest_frames)
    return distances


def _compute_median_length(offsets: Floats, rest_frames: Selection) -> float:
    """Compute the median length of offsets (frames, 3), m.

    Frames at rest are used, or all frames if there is no offset at rest. The length is infinite if
    there is no offset at all.
    """
    for selected in (offsets[rest_frames], offsets):
        distance = np.linalg.norm(selected, axis=1)
        measured = distance[np.isfinite(distance)]
        if len(measured):
            return float(np.median(measured))
    return np.inf


def _order_markers(distances: Floats, start_distances: Floats) -> tuple[int, ...]:
    """Order the markers along the specimen: each marker is the nearest to the one before it."""
    order = [int(np.argmin(start_distances))]
    while len(order) < len(distances):
        remaining_markers = [marker for marker in range(len(distances)) if marker not in order]
        order.append(min(remaining_markers, key=lambda marker: distances[order[-1], marker]))
    return tuple(order)


def _compute_mean(points: Floats, name: str) -> Floats:
    """Compute the mean position, m, (3,), without NaN; `name` is that of the point in the error."""
    measured = points[np.isfinite(points).all(axis=-1)]
    if not len(measured):
        raise ValueError(format_sentence("markers.none_at_rest", name=name))
    return np.asarray(measured.mean(axis=0), dtype=np.float64)


def _make_notes(out_of_plane: float, limit: float) -> tuple[QualityNote, ...]:
    """Make a note if the distance of the markers from their plane exceeds its limit."""
    if out_of_plane <= limit:
        return ()
    deviation, limit = 1e3 * out_of_plane, 1e3 * limit
    return (QualityNote.of("markers.out_of_plane", "markers", deviation=deviation, limit=limit),)
