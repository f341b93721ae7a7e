"""Repair marker tracks (undo label switches, merge tracks, fill gaps); compute centres of rings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.tracklets import (
    VELOCITY_FRAMES,
    Chain,
    ChainAssignment,
    Links,
    Tracklets,
    assign_chains,
    compute_velocity,
    cut_tracklets,
    find_frozen_samples,
    is_in_sight,
    is_unlabelled,
    link_tracklets,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, find_runs
from labpipe.records.curve import PointFlag
from labpipe.records.quality import QualityNote
from labpipe.records.recording import MarkerTracks

MIN_MARKERS = 3
"""Smallest number of markers along a specimen."""


@dataclass(frozen=True, slots=True, eq=False)
class RepairedTracks(ArrayRecord):
    """Repaired tracks of the markers along the specimen, with a flag for every sample.

    Parameters
    ----------
    names : name of each marker
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
    track_names: Sequence[str],
    max_gap: float,
    max_jump: float,
    frozen_time: float,
    clamp: Floats | None,
) -> RepairedTracks:
    """Undo label switches, merge unlabelled tracks into the tracks of markers, fill short gaps.

    Parameters
    ----------
    tracks : tracks of the take
    track_names : names of all tracks of the specimen, labelled or not, without those of the clamp
    max_gap : longest gap that is filled, s
    max_jump : largest displacement from one frame to the next that is accepted as motion, m
    frozen_time : shortest duration of a run of identical positions that is removed as frozen, s
    clamp : shape (frames, 3), m, positions of the clamp, whose gaps are filled linearly. Tracks are
        linked, and their gaps filled, relative to the clamp. None for a take without a clamp

    Returns
    -------
    The markers in the order of `track_names`. Measured positions are unchanged, and frozen
    positions are removed. Gaps longer than `max_gap` remain NaN and are flagged as missing.

    Raises
    ------
    ValueError
        If a limit is not positive, a name is unknown or repeated, `clamp` has no position, or
        fewer than three markers have a track.

    Notes
    -----
    Tracks are cut into tracklets (`cut_tracklets`). These are joined to chains across gaps and
    jumps by expected positions (`link_tracklets`), and the chains are assigned to markers
    (`assign_chains`). Gaps inside a chain are filled by Hermite cubics in the positions relative to
    the clamp. The velocity at each end of a gap is the mean over up to five measured steps outside
    the gap.
    """
    for name, limit in {"max_gap": max_gap, "max_jump": max_jump, "frozen": frozen_time}.items():
        if not limit > 0:
            raise ValueError(format_sentence("markers.not_positive", name=name, value=limit))
    measured, names, time = _copy_tracks(tracks, track_names), tuple(track_names), tracks.time
    origin = np.zeros((len(measured), 3)) if clamp is None else _fill_linearly(clamp, time)
    is_frozen = find_frozen_samples(measured, time, min_frozen_time=frozen_time, reference=clamp)
    measured[is_frozen] = np.nan
    relative = measured - origin[:, None]
    tracklets = cut_tracklets(measured, relative, time, max_jump=max_jump)
    links = link_tracklets(tracklets, relative, time, max_gap=max_gap, max_jump=max_jump)
    # A track that begins within a quarter of `max_jump` of another track duplicates it.
    limits = {"min_label_time": max_gap, "min_distance": 0.25 * max_jump}
    assignment = assign_chains(names, tracklets, links, relative=relative, time=time, **limits)
    marker_names = tuple(names[label] for label in assignment.markers)
    if (count := len(marker_names)) < MIN_MARKERS:
        facts = {"count": count, "needed": MIN_MARKERS, "names": ", ".join(marker_names) or "none"}
        raise ValueError(format_sentence("markers.few_markers", **facts))
    positions, flags = _assemble_markers(measured, tracklets, links, assignment)
    _fill_gaps(positions, flags, origin, time)
    repair = Repair(
        measured=measured,
        is_frozen=is_frozen,
        tracklets=tracklets,
        assignment=assignment,
        flags=flags,
        names=names,
        take=tracks,
        links=links,
    )
    return RepairedTracks(marker_names, positions, flags, tuple(repair.make_notes()))


def _copy_tracks(tracks: MarkerTracks, names: Sequence[str]) -> Floats:
    """Copy the positions of the named tracks; a sample with a missing coordinate becomes NaN."""
    unknown_names = [name for name in names if name not in tracks.names]
    if unknown_names or len(set(names)) < len(names):
        message = f"along={list(names)}: expected different names out of {list(tracks.names)}"
        raise ValueError(message)
    columns = [tracks.names.index(name) for name in names]
    measured: Floats = np.array(tracks.positions[:, columns])
    measured[~np.isfinite(measured).all(axis=2)] = np.nan
    return measured


def _fill_linearly(path: Floats, time: Floats) -> Floats:
    """Interpolate gaps in the path of the clamp linearly, and hold the first and last position."""
    is_visible = np.isfinite(path).all(axis=1)
    if not is_visible.any():
        raise ValueError(format_sentence("markers.no_clamp"))
    if is_visible.all():
        return path
    return np.column_stack([np.interp(time, time[is_visible], x[is_visible]) for x in path.T])


def _assemble_markers(
    measured: Floats, tracklets: Tracklets, links: Links, assignment: ChainAssignment
) -> tuple[Floats, NDArray[np.uint8]]:
    """Assemble the measured positions, m, and the flags of each marker from its tracklets.

    Frames between joined tracklets are flagged as filled; their positions are still NaN.
    """
    shape = (len(measured), len(assignment.markers))
    positions = np.full((*shape, 3), np.nan)
    flags = np.full(shape, PointFlag.MISSING, dtype=np.uint8)
    for marker, (label, chains) in enumerate(assignment.markers.items()):
        for tracklet in _list_tracklets(chains):
            column, successor = tracklets.column[tracklet], links.successor[tracklet]
            frames = slice(tracklets.start[tracklet], tracklets.stop[tracklet])
            positions[frames, marker] = measured[frames, column]
            flags[frames, marker] = PointFlag.MEASURED if column == label else PointFlag.RELABELLED
            if successor >= 0:
                flags[frames.stop : tracklets.start[successor], marker] = PointFlag.FILLED
    return positions, flags


def _list_tracklets(chains: tuple[Chain, ...]) -> list[int]:
    """List the indices of the tracklets of chains, in order of time."""
    return [tracklet for chain in chains for tracklet in chain.tracklets]


def _fill_gaps(positions: Floats, flags: NDArray[np.uint8], origin: Floats, time: Floats) -> None:
    """Fill the gaps in place by cubics in the positions relative to `origin`."""
    is_gap = flags == PointFlag.FILLED
    for marker in np.flatnonzero(is_gap.any(axis=0)):
        is_measured = ~is_gap[:, marker] & (flags[:, marker] != PointFlag.MISSING)
        gap_frames = np.flatnonzero(is_gap[:, marker])
        path = positions[is_measured, marker] - origin[is_measured]
        relative = _bridge_path(time[is_measured], path, time[gap_frames])
        positions[gap_frames, marker] = origin[gap_frames] + relative


def _bridge_path(time: Floats, path: Floats, gap_times: Floats) -> Floats:
    """Compute positions in the gaps of a path by cubics that continue the velocities outside.

    The path has the shape (samples, 3), and the result has the shape (gap times, 3), in m.
    """
    after = np.searchsorted(time, gap_times)  # sample after the gap
    before = after - 1
    first = np.maximum(before - VELOCITY_FRAMES, 0)
    last = np.minimum(after + VELOCITY_FRAMES, len(time) - 1)
    gap_duration = (time[after] - time[before])[:, None]
    # Tangents of a cubic in u, which increases from 0 to 1 across a gap.
    start_tangent = compute_velocity(time, path, (first,), (before,)) * gap_duration
    stop_tangent = compute_velocity(time, path, (after,), (last,)) * gap_duration
    u = (gap_times - time[before])[:, None] / gap_duration
    v = 1.0 - u
    cubic: Floats = path[before] * v**2 * (1.0 + 2.0 * u) + path[after] * u**2 * (1.0 + 2.0 * v)
    return cubic + u * v * (start_tangent * v - stop_tangent * u)


_MAX_NOTES = 10
"""Largest number of notes on stretches of one marker, on ambiguous links, or on dropped tracks."""


@dataclass(frozen=True, slots=True, eq=False)
class Repair:
    """Repair of a take, from which notes on repairs and on remaining faults are made.

    Parameters
    ----------
    measured : shape (frames, tracks, 3), m, positions; NaN where missing or frozen
    is_frozen : shape (frames, tracks), flags of samples that were removed as frozen
    tracklets : tracklets of the tracks of the specimen
    assignment : assignment of the chains of tracklets to markers
    flags : shape (frames, markers), values of `PointFlag` after filling
    names : names of the tracks of the specimen
    take : all tracks of the take, with numbers and times of the frames
    links : links between the tracklets
    """

    measured: Floats
    is_frozen: Flags
    tracklets: Tracklets
    assignment: ChainAssignment
    flags: NDArray[np.uint8]
    names: tuple[str, ...]
    take: MarkerTracks
    links: Links

    def make_notes(self) -> Iterator[QualityNote]:
        """Make notes on repairs and on remaining faults, one kind after the other."""
        markers = [self.names[label] for label in self.assignment.markers]
        yield from self._make_missing_notes()
        yield from self._make_stretch_notes("markers.pose_frozen", self.is_frozen, self.names)
        yield from self._make_relabel_notes()
        for label, chain in self.assignment.eliminations:
            span = chain.start, chain.stop
            yield self._make_span_note("markers.label_by_elimination", label, *span)
        yield from self._make_jump_notes()
        is_filled, is_missing = self.flags == PointFlag.FILLED, self.flags == PointFlag.MISSING
        yield from self._make_stretch_notes("markers.gap_filled", is_filled, markers)
        yield from self._make_stretch_notes("markers.gap_left", is_missing, markers)
        yield from self._make_ambiguity_notes()
        yield from self._make_dropped_notes()

    def _describe_frames(self, start: int, stop: int) -> str:
        """Describe the frames from `start` to `stop`, which is excluded, for a note."""
        first, last = f"{self.take.frames[start]:.0f}", f"{self.take.frames[stop - 1]:.0f}"
        frames = f"frame {first}" if stop - start == 1 else f"frames {first} to {last}"
        return f"{frames} ({self.take.time[start]:.3f} s to {self.take.time[stop - 1]:.3f} s)"

    def _make_span_note(
        self, message: str, label: int, start: int, stop: int, *times: tuple[float, float]
    ) -> QualityNote:
        """Make a note on a track in the frames from `start` to `stop`, which is excluded."""
        name, span = self.names[label], self._describe_frames(start, stop)
        return QualityNote.of(message, f"{name}, {span}", *times, name=name, span=span)

    def _make_missing_notes(self) -> Iterator[QualityNote]:
        """Make a note on each labelled track that is not the track of a marker."""
        is_visible = np.asarray(is_in_sight(self.measured).any(axis=0))
        for column, name in enumerate(self.names):
            if column not in self.assignment.markers and not is_unlabelled(name):
                yield QualityNote.of(
                    "markers.marker_under_another_label"
                    if is_visible[column]
                    else "markers.marker_missing",
                    name,
                    marker=name,
                )

    def _make_stretch_notes(
        self, message: str, mask: Flags, names: Sequence[str]
    ) -> Iterator[QualityNote]:
        """Make a note on each flagged stretch of a marker, or a common note on many stretches."""
        for name, flags in zip(names, mask.T, strict=True):
            stretches = find_runs(flags)
            spans = [self._describe_frames(*stretch) for stretch in stretches]
            counts = [f"{stop - start} frames" for start, stop in stretches]
            texts = [f"{count}, {span}" for count, span in zip(counts, spans, strict=True)]
            if len(stretches) > _MAX_NOTES:
                longest = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
                count = f"{len(stretches)} times, {int(flags.sum())} frames"
                spans = [self._describe_frames(stretches[0][0], stretches[-1][1])]
                texts = [f"{count}, longest {self._describe_frames(*longest)}"]
            for span, text in zip(spans, texts, strict=True):
                yield QualityNote.of(message, f"{name}, {span}", name=name, span=text)

    def _make_relabel_notes(self) -> Iterator[QualityNote]:
        """Make a note on each exchange of labels, and on each stretch without a label."""
        exchanges: dict[tuple[int, int], list[tuple[str, str]]] = {}
        columns, tracklets = self.tracklets.column, self.tracklets
        for label, chains in self.assignment.markers.items():
            indices = _list_tracklets(chains)
            for column, group in groupby(indices, key=lambda index: int(columns[index])):
                if column == label:
                    continue
                members = list(group)
                start, stop = int(tracklets.start[members[0]]), int(tracklets.stop[members[-1]])
                name, other_label = self.names[label], self.names[column]
                text = f"{name} was labelled as {other_label}"
                span = self._describe_frames(start, stop)
                if not is_unlabelled(other_label):
                    exchanges.setdefault((start, stop), []).append((name, text))
                    continue
                merged_track = self.measured[start:stop, column]
                gap = _describe_distance(self.measured[:, label], merged_track, start, stop)
                facts = {"text": text, "span": span, "gap": gap}
                yield QualityNote.of("markers.unlabelled_merged", f"{name}, {span}", **facts)
        for (start, stop), markers in sorted(exchanges.items()):
            names, texts = (", ".join(items) for items in zip(*markers, strict=True))
            span = self._describe_frames(start, stop)
            yield QualityNote.of("markers.label_switch", f"{names}, {span}", texts=texts, span=span)

    def _make_jump_notes(self) -> Iterator[QualityNote]:
        """Make a note on each jump between successive chains of a marker."""
        for label, chains in self.assignment.markers.items():
            for previous, following in pairwise(chains):
                is_linked = self.links.successor[previous.tracklets[-1]] >= 0
                if (frame := following.start) == previous.stop and not is_linked:
                    yield self._make_span_note("markers.marker_jump", label, frame, frame + 1)

    def _make_ambiguity_notes(self) -> Iterator[QualityNote]:
        """Make a note on each ambiguous link, and on each doubtful chain."""
        tracklets = self.tracklets
        for first, second in self.links.ambiguous_pairs[:_MAX_NOTES]:
            last_frame = int(tracklets.stop[first]) - 1
            span = self._describe_frames(last_frame, int(tracklets.start[second]) + 1)
            names = ", ".join(self.names[tracklets.column[index]] for index in (first, second))
            where = f"{names}, {span}"
            period = float(self.take.time[last_frame]), float(self.take.time[-1])
            yield QualityNote.of("markers.label_ambiguous", where, period, names=names, span=span)
        for chain in self.assignment.doubtful_chains:
            start, stop = chain.start, chain.stop
            period = float(self.take.time[start]), float(self.take.time[stop - 1])
            yield self._make_span_note("markers.second_track", chain.label, start, stop, period)

    def _make_dropped_notes(self) -> Iterator[QualityNote]:
        """Make a note on each of the first chains of no marker, and a common one on the others."""
        tracklets = self.tracklets
        chains = sorted(self.assignment.unassigned_chains, key=lambda x: (x.start, x.stop))
        for chain in chains[:_MAX_NOTES]:
            columns = tracklets.column[list(chain.tracklets)]
            names = ", ".join(dict.fromkeys(self.names[column] for column in columns))
            span = self._describe_frames(chain.start, chain.stop)
            points = [
                self.measured[tracklets.start[i] : tracklets.stop[i], tracklets.column[i]]
                for i in chain.tracklets
            ]
            # The size is the diagonal of the bounding box of the track, mm.
            size = 1e3 * float(np.linalg.norm(np.ptp(np.concatenate(points), axis=0)))
            where = f"{names}, {span}"
            yield QualityNote.of("markers.track_dropped", where, names=names, span=span, size=size)
        if count := len(other_chains := chains[_MAX_NOTES:]):
            frames = sum(chain.n_frames for chain in other_chains)
            yield QualityNote.of("markers.tracks_dropped", "markers", count=count, frames=frames)


def _describe_distance(track: Floats, merged_track: Floats, start: int, stop: int) -> str:
    """Describe the larger distance between a track and the ends of a track merged into it.

    The merged track replaces the frames from `start` to `stop`, which is excluded. The text is
    empty if no distance is known.
    """
    ends = (start - 1, merged_track[0]), (stop, merged_track[-1])
    gaps = [np.linalg.norm(track[frame] - end) for frame, end in ends if 0 <= frame < len(track)]
    largest = float(np.fmax.reduce(gaps, initial=-np.inf))
    return f", {1e3 * largest:.2f} mm apart at the joint" if np.isfinite(largest) else ""


def group_rings(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Group markers by the part of the name before the last colon, the name of a ring.

    Parameters
    ----------
    names : names of markers, such as ``SA-low:Marker1``

    Returns
    -------
    Names of the markers, keyed by name of the ring; a marker without a colon is a separate ring.

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
    One track for each ring: the mean position of the markers, with the flag of the least certain
    marker. If some markers are missing, the centre is computed from the others and flagged as
    filled. If all are missing, the centre is NaN.

    Raises
    ------
    ValueError
        If a group names an unknown marker, or is empty.

    Notes
    -----
    Rings are assumed to be rigid. If three or more markers are visible, the centre follows from the
    best rigid fit (Kabsch) of the ring in the nearest complete frame to these markers. If fewer are
    visible, the vector from the mean of these markers to the centre is interpolated between the
    nearest complete frames. For a ring that is never complete, the centre is the mean of the
    visible markers.
    """
    tracks, flags, notes = [], [], list(repaired.notes)
    for ring, members in groups.items():
        if not members or not set(repaired.names).issuperset(members):
            message = f"ring {ring}={list(members)}: expected markers out of {repaired.names}"
            raise ValueError(message)
        columns = [repaired.names.index(name) for name in members]
        ring_flags = repaired.flags[:, columns]
        centre, centre_flags = _compute_centre(repaired.positions[:, columns], ring_flags)
        tracks.append(centre)
        flags.append(centre_flags)
        notes.extend(_make_ring_notes(ring, members, ring_flags))
    return RepairedTracks(
        tuple(groups), np.stack(tracks, axis=1), np.stack(flags, axis=1), tuple(notes)
    )


def _compute_centre(
    positions: Floats, flags: NDArray[np.uint8]
) -> tuple[Floats, NDArray[np.uint8]]:
    """Compute the centre of one ring, shape (frames, 3), m, and the flags, shape (frames,)."""
    is_visible = is_in_sight(positions)
    is_complete = is_visible.all(axis=1)
    centre: Floats = np.full((len(positions), 3), np.nan)
    centre_flags = flags.max(axis=1)  # values increase from measured to filled
    centre[is_complete] = positions[is_complete].mean(axis=1)
    complete_frames = np.flatnonzero(is_complete)
    for pattern in np.unique(is_visible[~is_complete], axis=0):
        frames = np.flatnonzero((is_visible == pattern).all(axis=1))
        if pattern.any():
            visible = positions[:, pattern]
            centre[frames] = _compute_visible_centre(positions, visible, frames, complete_frames)
        centre_flags[frames] = PointFlag.FILLED if pattern.any() else PointFlag.MISSING
    return centre, centre_flags


def _compute_visible_centre(
    positions: Floats, visible: Floats, frames: Ints, complete_frames: Ints
) -> Floats:
    """Compute the centre of a ring in frames in which the same markers are in sight.

    Parameters
    ----------
    positions : shape (all frames, markers, 3), m, positions of all markers of the ring
    visible : shape (all frames, visible markers, 3), m, positions of the markers in sight
    frames : indices of the frames
    complete_frames : indices of the frames in which all markers are in sight
    """
    mean = visible[frames].mean(axis=1)
    if not len(complete_frames):
        return np.asarray(mean, dtype=np.float64)
    if visible.shape[1] >= 3:
        row = np.clip(np.searchsorted(complete_frames, frames), 0, len(complete_frames) - 1)
        frame_after, frame_before = complete_frames[row], complete_frames[np.maximum(row - 1, 0)]
        is_after_nearer = np.abs(frame_after - frames) < np.abs(frames - frame_before)
        nearest = np.where(is_after_nearer, frame_after, frame_before)
        template = visible[nearest] - visible[nearest].mean(axis=1, keepdims=True)
        rotation = _fit_rotations(template, visible[frames] - mean[:, None])
        offset = positions[nearest].mean(axis=1) - visible[nearest].mean(axis=1)
        return np.asarray(mean + np.einsum("fij,fj->fi", rotation, offset), dtype=np.float64)
    offsets = positions[complete_frames].mean(axis=1) - visible[complete_frames].mean(axis=1)
    offset = np.column_stack([np.interp(frames, complete_frames, axis) for axis in offsets.T])
    return np.asarray(mean + offset, dtype=np.float64)


def _fit_rotations(template: Floats, points: Floats) -> Floats:
    """Fit the rotation of the centred template to the centred points of each frame (Kabsch)."""
    u, _, vt = np.linalg.svd(np.einsum("fmi,fmj->fij", points, template))
    signs = np.ones((len(template), 3))  # a sign of -1 prevents a reflection
    signs[:, 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * signs[:, None]) @ vt, dtype=np.float64)


def _make_ring_notes(
    ring: str, members: Sequence[str], flags: NDArray[np.uint8]
) -> Iterator[QualityNote]:
    """Make notes on a ring with missing markers, and on a ring that is never complete."""
    is_missing = flags == PointFlag.MISSING
    is_partial = is_missing.any(axis=1) & ~is_missing.all(axis=1)
    if is_partial.any():
        columns = np.flatnonzero(is_missing[is_partial].any(axis=0)).tolist()
        names, frames = ", ".join(members[i] for i in columns), int(is_partial.sum())
        yield QualityNote.of("markers.ring_incomplete", ring, ring=ring, names=names, frames=frames)
    if is_missing.any(axis=1).all():
        yield QualityNote.of("markers.ring_never_whole", ring, ring=ring)
