"""Compute points on the axis of a specimen from rings and sections of several markers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.track_repair import RepairedTracks
from labpipe.markers.tracklets import is_in_sight
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints
from labpipe.records.curve import PointFlag
from labpipe.records.quality import QualityNote

SIDES = {"load": ((1.0, 0.0),), "away": ((-1.0, 0.0),), "side": ((0.0, 1.0), (0.0, -1.0))}
"""Possible directions (y, z) from the axis to the markers, by the side they face."""


def group_rings(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Group markers by the part of their name before the last colon.

    Parameters
    ----------
    names : of markers, such as ``SA-low:Marker1``

    Returns
    -------
    Names of the markers of each ring; a marker without a colon is a separate ring.

    Examples
    --------
    >>> group_rings(["low:1", "low:2", "tip"])
    {'low': ('low:1', 'low:2'), 'tip': ('tip',)}
    """
    rings: dict[str, tuple[str, ...]] = {}
    for name in names:
        ring = name.rpartition(":")[0] or name
        rings[ring] = (*rings.get(ring, ()), name)
    return rings


def compute_ring_centres(
    repaired: RepairedTracks, groups: Mapping[str, Sequence[str]]
) -> RepairedTracks:
    """Compute the centre of every ring of markers.

    Parameters
    ----------
    repaired : tracks of the single markers
    groups : names of the markers of each ring, from `group_rings`

    Returns
    -------
    One track per ring: the mean of its markers, with the flag of the least certain one. If some
    are missing, the centre is computed from the others and flagged as filled; if all are missing,
    it is NaN.

    Raises
    ------
    ValueError
        If a group names an unknown marker, or is empty.

    Notes
    -----
    The ring is rigid. With three or more markers, the centre follows from their best rigid fit
    (Kabsch) to the ring in the nearest complete frame. With fewer, the vector from their mean to
    the centre is interpolated between the nearest complete frames. For a ring that is never
    complete, the centre is the mean of the visible markers.
    """
    known_names = set(repaired.names)
    tracks, flags, notes = [], [], list(repaired.notes)
    for ring, members in groups.items():
        if not members or not known_names.issuperset(members):
            message = f"ring {ring}={list(members)}: expected markers out of {repaired.names}"
            raise ValueError(message)
        columns = [repaired.names.index(name) for name in members]
        centre, origin = _compute_centre(repaired.positions[:, columns], repaired.flags[:, columns])
        tracks.append(centre)
        flags.append(origin)
        notes.extend(_make_notes(ring, members, repaired.flags[:, columns]))
    return RepairedTracks(
        tuple(groups), np.stack(tracks, axis=1), np.stack(flags, axis=1), tuple(notes)
    )


def _compute_centre(
    positions: Floats, flags: NDArray[np.uint8]
) -> tuple[Floats, NDArray[np.uint8]]:
    is_visible = is_in_sight(positions)
    complete = is_visible.all(axis=1)
    centre: Floats = np.full((len(positions), 3), np.nan)
    origin = flags.max(axis=1)  # the least certain: values increase from measured to filled
    centre[complete] = positions[complete].mean(axis=1)
    whole = np.flatnonzero(complete)
    for pattern in np.unique(is_visible[~complete], axis=0):
        frames = np.flatnonzero((is_visible == pattern).all(axis=1))
        if pattern.any():
            centre[frames] = _compute_centre_from_visible(positions, pattern, frames, whole)
        origin[frames] = PointFlag.FILLED if pattern.any() else PointFlag.MISSING
    return centre, origin


def _compute_centre_from_visible(
    positions: Floats, pattern: Flags, frames: Ints, complete: Ints
) -> Floats:
    """Return centres in `frames`, where only the markers of `pattern` are in sight."""
    visible = positions[:, pattern]
    middle = visible[frames].mean(axis=1)
    if not len(complete):
        return np.asarray(middle, dtype=np.float64)
    if pattern.sum() >= 3:
        number = np.clip(np.searchsorted(complete, frames), 0, len(complete) - 1)
        following, previous = complete[number], complete[np.maximum(number - 1, 0)]
        is_later = np.abs(following - frames) < np.abs(frames - previous)
        nearest = np.where(is_later, following, previous)
        template = visible[nearest] - visible[nearest].mean(axis=1, keepdims=True)
        rotation = _fit_rotations(template, visible[frames] - middle[:, None])
        offset = positions[nearest].mean(axis=1) - visible[nearest].mean(axis=1)
        return np.asarray(middle + np.einsum("fij,fj->fi", rotation, offset), dtype=np.float64)
    offset = positions[complete].mean(axis=1) - visible[complete].mean(axis=1)
    interpolated = np.column_stack([np.interp(frames, complete, axis) for axis in offset.T])
    return np.asarray(middle + interpolated, dtype=np.float64)


def _fit_rotations(template: Floats, points: Floats) -> Floats:
    """Return the best rotations of the centred template to centred points, per frame (Kabsch)."""
    u, _, vt = np.linalg.svd(np.einsum("fmi,fmj->fij", points, template))
    mirror = np.ones((len(template), 3))
    mirror[:, 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * mirror[:, None]) @ vt, dtype=np.float64)


def _make_notes(
    ring: str, members: Sequence[str], flags: NDArray[np.uint8]
) -> Iterator[QualityNote]:
    missing = flags == PointFlag.MISSING
    is_partial = missing.any(axis=1) & ~missing.all(axis=1)
    if is_partial.any():
        absent = [members[i] for i in np.flatnonzero(missing[is_partial].any(axis=0)).tolist()]
        names, frames = ", ".join(absent), int(is_partial.sum())
        yield QualityNote.of("markers.ring_incomplete", ring, ring=ring, names=names, frames=frames)
    if missing.any(axis=1).all():
        yield QualityNote.of("markers.ring_never_whole", ring, ring=ring)


@dataclass(frozen=True, slots=True, eq=False)
class Sections(ArrayRecord):
    """Markers in the frame of the specimen, and which of them share a section.

    The frame: x along the specimen at rest, y along the motion, z out of the plane of bending;
    origin at the mean of the markers at rest.

    Parameters
    ----------
    markers : shape (frames, markers, 3), m; NaN where missing
    at_rest : shape (markers, 3), m, means over the frames at rest
    section : shape (markers,), number of the section, counted along x from 0
    columns : shape (markers,), their indices among the given markers
    rotation_lab_to_specimen : shape (3, 3)
    """

    markers: Annotated[Floats, "frames", "markers", 3]
    at_rest: Annotated[Floats, "markers", 3]
    section: Annotated[Ints, "markers"]
    columns: Annotated[Ints, "markers"]
    rotation_lab_to_specimen: Annotated[Floats, 3, 3]

    @property
    def count(self) -> int:
        """Return the number of sections."""
        return int(self.section.max()) + 1 if len(self.section) else 0

    @property
    def x(self) -> Floats:
        """Return x of each section at rest, shape (sections,), m."""
        return np.array([self.at_rest[self.section == k, 0].mean() for k in range(self.count)])


def find_sections(markers_lab: Floats, *, rest: Flags, min_distance: float) -> Sections:
    """Determine frame and sections of a specimen on two supports.

    Parameters
    ----------
    markers_lab : shape (frames, markers, 3), m; NaN where missing
    rest : shape (frames,), frames in which the specimen is straight and at rest
    min_distance : m, along the axis; closer markers share a section

    Returns
    -------
    The sections, without markers that are visible in fewer than three frames at rest.

    Raises
    ------
    ValueError
        If fewer than three markers are visible at rest, or no section moves by more than 1 um.

    Notes
    -----
    x is the direction of the largest spread of the markers at rest. y is perpendicular to x, along
    the mean path of the markers of the section that moves farthest (the mean is not affected by a
    rotation about the axis).
    """
    min_frames_at_rest = 3
    is_measured = np.isfinite(markers_lab[rest]).all(axis=2).sum(axis=0) >= min_frames_at_rest
    markers = markers_lab[:, is_measured]
    if markers.shape[1] < 3:
        raise ValueError(format_sentence("markers.few_section_markers", count=markers.shape[1]))
    at_rest = np.nanmean(markers[rest], axis=0)
    centre = at_rest.mean(axis=0)
    x = np.linalg.svd(at_rest - centre, full_matrices=False)[2][0]
    station = (at_rest - centre) @ x
    section: Ints = np.empty(len(station), dtype=np.int64)
    order = np.argsort(station)
    section[order] = np.append(0, np.cumsum(np.diff(station[order]) > min_distance))
    y = _find_motion_direction(markers - at_rest, section, x)
    rotation = np.stack([x, y, np.cross(x, y)])
    return Sections(
        markers=(markers - centre) @ rotation.T,
        at_rest=(at_rest - centre) @ rotation.T,
        section=section,
        columns=np.flatnonzero(is_measured),
        rotation_lab_to_specimen=rotation,
    )


def _find_motion_direction(moved: Floats, section: Ints, x: Floats) -> Floats:
    # In m: below the resolution of cameras.
    min_motion = 1e-6
    across = moved - (moved @ x)[..., None] * x
    paths = np.stack([across[:, section == k].mean(axis=1) for k in range(section.max() + 1)])
    max_distances = np.nanmax(np.nan_to_num(np.linalg.norm(paths, axis=2)), axis=1)
    path = paths[int(np.argmax(max_distances))]
    path = path[np.isfinite(path).all(axis=1)]
    if not max_distances.max() > min_motion or not len(path):
        raise ValueError(format_sentence("markers.not_bent"))
    main = np.linalg.svd(path, full_matrices=False)[2][0]  # a unit vector perpendicular to x
    sign = np.sign(float(path[np.argmax(np.abs(path @ main))] @ main))
    return np.asarray(sign * main, dtype=np.float64)


def fit_rest_axis(sections: Sections, *, radius: float, towards: tuple[float, float]) -> Floats:
    """Fit the position of the axis of the cylinder in the plane normal to it.

    Parameters
    ----------
    sections : of the specimen
    radius : m, from the axis to the centre of a marker
    towards : approximate direction (y, z) from the axis to the markers

    Returns
    -------
    shape (2,), m, y and z of the axis.

    Notes
    -----
    Least squares of the distances from the axis minus `radius`, by Gauss-Newton with steps of
    minimum norm. Markers in one row do not determine the direction to the axis, which then
    follows from `towards`. For `radius` 0 the axis is at the mean of the markers.
    """
    max_steps = 20
    points, direction = sections.at_rest[:, 1:], np.asarray(towards)
    axis = points.mean(axis=0) - radius * direction
    for _ in range(max_steps if radius > 0.0 else 0):
        offsets = points - axis
        distances = np.linalg.norm(offsets, axis=1)
        step = np.linalg.lstsq(-offsets / distances[:, None], radius - distances, rcond=0.05)[0]
        axis = axis + step
    return np.asarray(axis, dtype=np.float64)


def compute_twist(sections: Sections, slope: Floats, *, radius: float) -> tuple[Floats, Floats]:
    """Compute the twist of every section about the axis relative to rest.

    Parameters
    ----------
    sections : of the specimen
    slope : shape (frames, sections), rad, angle of the axis in the plane of bending
    radius : m, from the axis to the centre of a marker

    Returns
    -------
    twist : shape (frames, sections), rad, from y towards z; NaN where a marker of the section is
        missing, or where `lever` is 0
    lever : shape (sections,), m; noise of standard deviation s gives a twist of s / lever. 0 for a
        section with one marker, or with markers too close to show the twist

    Notes
    -----
    The best rotation of the markers of a section from rest about their mean, in the plane across
    the present axis; it does not depend on the radius or the position of the axis. Angle of
    sum(conj(a) b) with a, b the positions as complex numbers (Kabsch in two dimensions).
    """
    # In radii: closer markers do not show the twist.
    min_spread = 0.3
    frames = len(sections.markers)
    twist = np.full((frames, sections.count), np.nan)
    lever = np.zeros(sections.count)
    for number in range(sections.count):
        in_section = sections.section == number
        position_at_rest = sections.at_rest[in_section, 1] + 1j * sections.at_rest[in_section, 2]
        position_at_rest = position_at_rest - position_at_rest.mean()
        spread = float(np.sqrt(np.sum(np.abs(position_at_rest) ** 2)))
        if in_section.sum() < 2 or spread < min_spread * max(radius, 1e-9):
            continue
        lever[number] = spread
        angle = slope[:, number, None]
        section_markers = sections.markers[:, in_section]
        across = -np.sin(angle) * section_markers[..., 0] + np.cos(angle) * section_markers[..., 1]
        position = across + 1j * section_markers[..., 2]
        position = position - position.mean(axis=1, keepdims=True)
        twist[:, number] = np.angle(np.sum(np.conj(position_at_rest) * position, axis=1))
    return twist, lever


def compute_section_centres(
    sections: Sections, axis: Floats, slope: Floats, twist: Floats
) -> Floats:
    """Compute the point on the axis of every section.

    Parameters
    ----------
    sections : of the specimen
    axis : shape (2,), m, position of the axis at rest
    slope : shape (frames, sections), rad, angle of the axis in the plane of bending
    twist : shape (frames, sections), rad; NaN is interpolated from neighbours, or 0

    Returns
    -------
    shape (frames, sections, 3), m; NaN where no marker of a section is in sight.

    Notes
    -----
    A marker is rigidly joined to its section, which rotates by `twist` about the axis and by
    `slope` in the plane of bending. The offset of a marker from the axis is subtracted, and the
    markers of a section are averaged.
    """
    frames, x = len(sections.markers), sections.x
    filled_twist = _fill_twist(twist)
    centres = np.full((frames, sections.count, 3), np.nan)
    for number in range(sections.count):
        in_section = sections.section == number
        offset = sections.at_rest[in_section] - np.array([x[number], *axis])
        phi, angle = filled_twist[:, number, None], slope[:, number, None]
        across = np.cos(phi) * offset[:, 1] - np.sin(phi) * offset[:, 2]
        offset_z = np.sin(phi) * offset[:, 1] + np.cos(phi) * offset[:, 2]
        turned_x = np.cos(angle) * offset[:, 0] - np.sin(angle) * across
        turned_y = np.sin(angle) * offset[:, 0] + np.cos(angle) * across
        points = sections.markers[:, in_section] - np.stack([turned_x, turned_y, offset_z], axis=2)
        is_measured = np.isfinite(points).all(axis=2)
        total = np.where(is_measured[..., None], points, 0.0).sum(axis=1)
        has_points = is_measured.any(axis=1)
        count = is_measured.sum(axis=1)[has_points, None]
        centres[has_points, number] = total[has_points] / count
    return centres


def _fill_twist(twist: Floats) -> Floats:
    """Return the twist with NaN interpolated between sections; 0 in frames without a twist."""
    numbers = np.arange(twist.shape[1])
    has_twist = np.isfinite(twist)
    filled = np.zeros_like(twist)
    for pattern in np.unique(has_twist, axis=0):
        frames = (has_twist == pattern).all(axis=1)
        if pattern.any():
            rows = twist[frames][:, pattern]
            filled[frames] = [np.interp(numbers, numbers[pattern], row) for row in rows]
    return filled
