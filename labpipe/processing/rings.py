"""Centres of rings: several markers on one ring stand for the point on the axis between them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from labpipe.processing.tracklets import in_sight
from labpipe.processing.tracks import RepairedTracks
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import PointFlag
from labpipe.records.quality import QualityNote, Severity


def rings_by_body(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Group markers by the part of their name before the colon.

    Parameters
    ----------
    names : of markers, such as ``SA-low:Marker1``

    Returns
    -------
    Names of the markers of each ring; a marker without a colon is a ring of its own.

    Examples
    --------
    >>> rings_by_body(["low:1", "low:2", "tip"])
    {'low': ('low:1', 'low:2'), 'tip': ('tip',)}
    """
    rings: dict[str, tuple[str, ...]] = {}
    for name in names:
        ring = name.rpartition(":")[0] or name
        rings[ring] = (*rings.get(ring, ()), name)
    return rings


def ring_centres(repaired: RepairedTracks, groups: Mapping[str, Sequence[str]]) -> RepairedTracks:
    """Put one point in the middle of every ring of markers.

    Parameters
    ----------
    repaired : tracks of the single markers
    groups : names of the markers of each ring, as `rings_by_body` gives them

    Returns
    -------
    One track per ring: the mean of its markers. Where some are missing the centre is built from the
    others and flagged filled; where all are missing it is NaN. A ring takes the flag of its least
    certain marker.

    Raises
    ------
    ValueError
        If a group names a marker that is not there, or holds none.

    Notes
    -----
    The ring is rigid: with three or more markers in sight their best rigid fit (Kabsch) to the ring
    as it stood in the nearest complete frame carries the centre; with fewer, the vector from their
    mean to the centre is interpolated between the nearest complete frames. A ring that is never
    complete has the mean of the markers it shows.
    """
    known = set(repaired.names)
    tracks, flags, notes = [], [], list(repaired.notes)
    for ring, members in groups.items():
        if not members or not known.issuperset(members):
            message = f"ring {ring}={list(members)}: expected markers out of {repaired.names}"
            raise ValueError(message)
        columns = [repaired.names.index(name) for name in members]
        centre, origin = _centre(repaired.positions[:, columns], repaired.flags[:, columns])
        tracks.append(centre)
        flags.append(origin)
        notes.extend(_notes(ring, members, repaired.flags[:, columns]))
    return RepairedTracks(
        tuple(groups), np.stack(tracks, axis=1), np.stack(flags, axis=1), tuple(notes)
    )


def _centre(positions: Floats, flags: NDArray[np.uint8]) -> tuple[Floats, NDArray[np.uint8]]:
    seen = in_sight(positions)
    whole = seen.all(axis=1)
    centre: Floats = np.full((len(positions), 3), np.nan)
    origin = _least_certain(flags)
    centre[whole] = positions[whole].mean(axis=1)
    for pattern in np.unique(seen[~whole], axis=0):
        frames = np.flatnonzero((seen == pattern).all(axis=1))
        if pattern.any():
            centre[frames] = _carried(positions, pattern, frames, np.flatnonzero(whole))
        origin[frames] = PointFlag.FILLED if pattern.any() else PointFlag.MISSING
    return centre, origin


def _least_certain(flags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Flag of every frame: filled if any marker is, else relabelled if any is."""
    return np.asarray(flags.max(axis=1), dtype=np.uint8)  # values rise from measured to filled


def _carried(positions: Floats, pattern: Flags, frames: Ints, whole: Ints) -> Floats:
    """Centres in `frames`, where only the markers of `pattern` are seen."""
    visible = positions[:, pattern]
    middle = visible[frames].mean(axis=1)
    if not len(whole):
        return np.asarray(middle, dtype=np.float64)
    if pattern.sum() >= 3:
        nearest = _nearest(whole, frames)
        template = visible[nearest] - visible[nearest].mean(axis=1, keepdims=True)
        turn = _rotations(template, visible[frames] - middle[:, None])
        offset = positions[nearest].mean(axis=1) - visible[nearest].mean(axis=1)
        return np.asarray(middle + np.einsum("fij,fj->fi", turn, offset), dtype=np.float64)
    offset = positions[whole].mean(axis=1) - visible[whole].mean(axis=1)
    carried = np.column_stack([np.interp(frames, whole, axis) for axis in offset.T])
    return np.asarray(middle + carried, dtype=np.float64)


def _nearest(whole: Ints, frames: Ints) -> Ints:
    """The frame out of `whole` next to each of `frames`."""
    after = np.clip(np.searchsorted(whole, frames), 0, len(whole) - 1)
    before = np.maximum(after - 1, 0)
    late = np.abs(whole[after] - frames) < np.abs(frames - whole[before])
    return np.asarray(np.where(late, whole[after], whole[before]), dtype=np.int64)


def _rotations(before: Floats, after: Floats) -> Floats:
    """Rotations that best take one set of centred points to another, for every frame (Kabsch)."""
    left, _, right = np.linalg.svd(np.einsum("fmi,fmj->fij", after, before))
    mirror = np.ones((len(before), 3))
    mirror[:, 2] = np.sign(np.linalg.det(left @ right))
    return np.asarray((left * mirror[:, None]) @ right, dtype=np.float64)


def _notes(ring: str, members: Sequence[str], flags: NDArray[np.uint8]) -> Iterator[QualityNote]:
    missing = flags == PointFlag.MISSING
    built = missing.any(axis=1) & ~missing.all(axis=1)
    if built.any():
        who = [name for name, gone in zip(members, missing[built].any(axis=0), strict=True) if gone]
        message = f"{ring}: centre built without {', '.join(who)} in {int(built.sum())} frames"
        yield QualityNote("ring_incomplete", Severity.WARNING, ring, message)
    if not missing.any(axis=1).all():
        return
    message = f"{ring}: never seen whole; its centre is the mean of the markers in sight"
    yield QualityNote("ring_never_whole", Severity.WARNING, ring, message)
