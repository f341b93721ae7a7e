"""Repair marker tracks: undo label switches, merge unlabelled tracks, fill gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.marker_names import Chain, Naming, name_chains
from labpipe.markers.repair_notes import TrackletTake, make_repair_notes
from labpipe.markers.tracklets import (
    Links,
    Tracklets,
    cut_tracklets,
    find_frozen_samples,
    link_tracklets,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints
from labpipe.records.curve import PointFlag
from labpipe.records.quality import QualityNote
from labpipe.records.recording import MarkerTracks

MIN_MARKERS = 3
"""Smallest number of markers along a specimen."""


@dataclass(frozen=True, slots=True, eq=False)
class RepairedTracks(ArrayRecord):
    """Tracks of the markers along the specimen, with a flag for every sample.

    Parameters
    ----------
    names : one per marker
    positions : shape (frames, markers, 3), m, in the frame of the motion-capture system; NaN where
        missing
    flags : shape (frames, markers), values of `PointFlag`
    notes : quality notes on repairs and remaining faults
    """

    names: tuple[str, ...]
    positions: Annotated[Floats, "frames", "names", 3]
    flags: Annotated[NDArray[np.uint8], "frames", "names"]
    notes: tuple[QualityNote, ...]


def repair_tracks(
    tracks: MarkerTracks,
    *,
    along: Sequence[str],
    max_gap: float,
    max_jump: float,
    frozen: float,
    reference: Floats | None,
) -> RepairedTracks:
    """Undo label switches, merge unlabelled tracks into their markers, fill short gaps.

    Parameters
    ----------
    tracks : the take
    along : names of the tracks, labelled and unlabelled markers; not those of the clamp
    max_gap : s, longest time without a sample that is bridged and filled
    max_jump : m, longest displacement from one frame to the next that counts as motion
    frozen : s, shortest run of identical positions that is removed as stale
    reference : shape (frames, 3), m, position of the clamp: continuity and filling are relative to
        it; its gaps are bridged linearly. None for a take without a clamp.

    Returns
    -------
    The markers in the order of `along`. Measured positions are unchanged, stale ones removed;
    longer gaps stay NaN and are flagged missing.

    Raises
    ------
    ValueError
        If a parameter is not positive, a name is unknown or repeated, `reference` has no position,
        or fewer than three markers have a track.

    Notes
    -----
    Tracks are cut into tracklets (`cut_tracklets`), joined across gaps and jumps by expected
    position (`link_tracklets`) and named (`name_chains`). Gaps inside a joined chain are filled
    by cubics (Hermite) in the positions relative to `reference`, whose velocity at each end is the
    mean over up to five measured steps outside the gap.
    """
    # share of `max_jump`: a track that begins within this distance of another one duplicates it
    duplicate_share = 0.25
    for name, value in {"max_gap": max_gap, "max_jump": max_jump, "frozen": frozen}.items():
        if not value > 0:
            raise ValueError(format_sentence("markers.not_positive", name=name, value=value))
    measured, names = _copy_tracks(tracks, along), tuple(along)
    origin = np.zeros((len(measured), 3))
    if reference is not None:
        origin = _fill_linearly(reference, tracks.time)
    stale = find_frozen_samples(measured, tracks.time, frozen=frozen, reference=reference)
    measured[stale] = np.nan
    relative = measured - origin[:, None]
    tracklets = cut_tracklets(measured, relative, tracks.time, max_jump=max_jump)
    links = link_tracklets(tracklets, relative, tracks.time, max_gap=max_gap, max_jump=max_jump)
    naming = name_chains(
        names,
        tracklets,
        links,
        relative=relative,
        time=tracks.time,
        settled=max_gap,
        min_distance=duplicate_share * max_jump,
    )
    kept_names = tuple(names[label] for label in naming.markers)
    if (count := len(kept_names)) < MIN_MARKERS:
        needed, listed = MIN_MARKERS, ", ".join(kept_names) or "none"
        text = format_sentence("markers.few_markers", count=count, needed=needed, names=listed)
        raise ValueError(text)
    take = TrackletTake(names, tracks.frames, tracks.time, tracklets)
    positions, flags = _assemble(measured, tracklets, naming)
    gaps = _find_gaps(tracklets, links, naming, len(measured))
    _fill_gaps(positions, flags, origin, tracks.time, gaps)
    notes = make_repair_notes(take, links, naming, stale=stale, flags=flags, measured=measured)
    return RepairedTracks(kept_names, positions, flags, notes)


def _copy_tracks(tracks: MarkerTracks, along: Sequence[str]) -> Floats:
    """Copy the tracks of the names; a sample with one missing coordinate is missing."""
    unknown = [name for name in along if name not in tracks.names]
    if unknown or len(set(along)) < len(along):
        message = f"along={list(along)}: expected different names out of {list(tracks.names)}"
        raise ValueError(message)
    columns = [tracks.names.index(name) for name in along]
    measured: Floats = np.array(tracks.positions[:, columns])
    measured[~np.isfinite(measured).all(axis=2)] = np.nan
    return measured


def _fill_linearly(reference: Floats, time: Floats) -> Floats:
    """Fill gaps of the clamp's path linearly; hold its first and last position."""
    present = np.isfinite(reference).all(axis=1)
    if not present.any():
        raise ValueError(format_sentence("markers.no_clamp"))
    if present.all():
        return reference
    return np.column_stack([np.interp(time, time[present], axis[present]) for axis in reference.T])


def _assemble(
    measured: Floats, tracklets: Tracklets, naming: Naming
) -> tuple[Floats, NDArray[np.uint8]]:
    """Return the measured positions, m, and the flags of each marker, with gaps."""
    shape = (len(measured), len(naming.markers))
    positions = np.full((*shape, 3), np.nan)
    flags = np.full(shape, PointFlag.MISSING, dtype=np.uint8)
    for marker, (label, chains) in enumerate(naming.markers.items()):
        for tracklet in _list_tracklets(chains):
            column = tracklets.column[tracklet]
            frames = slice(tracklets.start[tracklet], tracklets.stop[tracklet])
            positions[frames, marker] = measured[frames, column]
            has_own_label = column == label
            flags[frames, marker] = PointFlag.MEASURED if has_own_label else PointFlag.RELABELLED
    return positions, flags


def _list_tracklets(chains: tuple[Chain, ...]) -> list[int]:
    return [tracklet for chain in chains for tracklet in chain.tracklets]


def _find_gaps(tracklets: Tracklets, links: Links, naming: Naming, n_frames: int) -> Flags:
    """Return whether a frame is between joined tracklets of a marker, shape (frames, markers)."""
    is_gap = np.zeros((n_frames, len(naming.markers)), dtype=np.bool_)
    for marker, chains in enumerate(naming.markers.values()):
        for tracklet in _list_tracklets(chains):
            following = links.successor[tracklet]
            if following >= 0:
                is_gap[tracklets.stop[tracklet] : tracklets.start[following], marker] = True
    return is_gap


def _fill_gaps(
    positions: Floats, flags: NDArray[np.uint8], origin: Floats, time: Floats, is_gap: Flags
) -> None:
    """Fill the gaps in place, by cubics in the positions relative to `origin`, and flag them."""
    for marker in np.flatnonzero(is_gap.any(axis=0)):
        present = np.flatnonzero(flags[:, marker] != PointFlag.MISSING)
        path = positions[present, marker] - origin[present]
        gap = np.flatnonzero(is_gap[:, marker])
        positions[gap, marker] = origin[gap] + _bridge_path(time[present], path, time[gap])
        flags[gap, marker] = PointFlag.FILLED


def _bridge_path(time: Floats, path: Floats, gap_times: Floats) -> Floats:
    """Return cubics across the gaps of a path at times in them, with its velocity at both ends.

    The path has the shape (samples, 3), the result the shape (gap times, 3), in m.
    """
    velocity_frames = 5
    following = np.searchsorted(time, gap_times)
    previous = following - 1
    first = np.maximum(previous - velocity_frames, 0)
    last = np.minimum(following + velocity_frames, len(time) - 1)
    span = (time[following] - time[previous])[:, None]
    start_slope = _compute_velocity(time, path, first, previous) * span
    stop_slope = _compute_velocity(time, path, following, last) * span
    start, stop = path[previous], path[following]
    u = (gap_times - time[previous])[:, None] / span  # from 0 to 1 across a gap
    v = 1.0 - u
    bridge: Floats = start * v**2 * (1.0 + 2.0 * u) + stop * u**2 * (1.0 + 2.0 * v)
    return bridge + u * v * (start_slope * v - stop_slope * u)


def _compute_velocity(time: Floats, path: Floats, start: Ints, stop: Ints) -> Floats:
    """Return the mean velocities between samples, m/s, (gap times, 3); 0 for a single sample."""
    duration = np.where(stop > start, time[stop] - time[start], 1.0)
    velocity: Floats = (path[stop] - path[start]) / duration[:, None]
    return velocity
