"""Make quality notes on the repair of marker tracks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.marker_names import Chain, Naming, is_unlabelled
from labpipe.markers.tracklets import Links, Tracklets, is_in_sight
from labpipe.records.arrays import Flags, Floats, find_runs
from labpipe.records.curve import PointFlag
from labpipe.records.quality import QualityNote

_MAX_NOTES = 10
"""Largest number of notes on stretches of one marker, ambiguous links, or dropped tracks."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackletTake:
    """Column names, frame numbers, times and tracklets of a take."""

    names: tuple[str, ...]
    frames: Floats
    time: Floats
    tracklets: Tracklets

    def span(self, start: int, stop: int) -> str:
        """Describe a stretch of frames, `stop` excluded."""
        first, last = f"{self.frames[start]:.0f}", f"{self.frames[stop - 1]:.0f}"
        frames = f"frame {first}" if stop - start == 1 else f"frames {first} to {last}"
        return f"{frames} ({self.time[start]:.3f} s to {self.time[stop - 1]:.3f} s)"


def make_repair_notes(
    take: TrackletTake,
    links: Links,
    naming: Naming,
    *,
    stale: Flags,
    flags: NDArray[np.uint8],
    measured: Floats,
) -> tuple[QualityNote, ...]:
    """Make notes on repairs and on remaining faults.

    Parameters
    ----------
    take : names, frame numbers, times and tracklets
    links, naming : links between the tracklets, and their markers
    stale : shape (frames, columns), samples removed as frozen
    flags : shape (frames, markers), after filling
    measured : shape (frames, columns, 3), m, positions; NaN where missing or frozen

    Returns
    -------
    The notes, by kind.
    """
    markers = [take.names[label] for label in naming.markers]
    return (
        *_make_missing_notes(take, naming, measured),
        *_make_stretch_notes(take, stale, take.names, "stale"),
        *_make_relabel_notes(take, naming, measured),
        *_make_elimination_notes(take, naming),
        *_make_jump_notes(take, links, naming),
        *_make_stretch_notes(take, np.equal(flags, PointFlag.FILLED), markers, "filled"),
        *_make_stretch_notes(take, np.equal(flags, PointFlag.MISSING), markers, "open"),
        *_make_ambiguity_notes(take, links, naming),
        *_make_dropped_notes(take, naming, measured),
    )


def _make_missing_notes(
    take: TrackletTake, naming: Naming, measured: Floats
) -> Iterator[QualityNote]:
    visible_columns = np.flatnonzero(is_in_sight(measured).any(axis=0)).tolist()
    named = [column for column, name in enumerate(take.names) if not is_unlabelled(name)]
    for column in named:
        if column not in naming.markers:
            marker = take.names[column]
            yield QualityNote.of(
                "markers.marker_under_another_label"
                if column in visible_columns
                else "markers.marker_missing",
                marker,
                marker=marker,
            )


def _make_stretch_notes(
    take: TrackletTake, mask: Flags, names: Sequence[str], kind: Literal["stale", "filled", "open"]
) -> Iterator[QualityNote]:
    """Yield a note per flagged stretch of a marker; many stretches have a common note."""
    for name, flags in zip(names, mask.T, strict=True):
        stretches = find_runs(flags)
        spans = [
            (span := take.span(*ends), f"{ends[1] - ends[0]} frames, {span}") for ends in stretches
        ]
        if len(stretches) > _MAX_NOTES:
            longest = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
            count = f"{len(stretches)} times, {int(flags.sum())} frames"
            whole_span = take.span(stretches[0][0], stretches[-1][1])
            spans = [(whole_span, f"{count}, longest {take.span(*longest)}")]
        for span, text in spans:
            yield QualityNote.of(
                {
                    "stale": "markers.pose_frozen",
                    "filled": "markers.gap_filled",
                    "open": "markers.gap_left",
                }[kind],
                f"{name}, {span}",
                name=name,
                span=text,
            )


def _make_relabel_notes(
    take: TrackletTake, naming: Naming, measured: Floats
) -> Iterator[QualityNote]:
    """Yield a note per exchange of labels, and per stretch without a label."""
    exchanges: dict[tuple[int, int], list[tuple[str, str]]] = {}
    for label, chains in naming.markers.items():
        for column, start, stop in _list_relabelled_stretches(take.tracklets, label, chains):
            name, other_label = take.names[label], take.names[column]
            text, span = f"{name} was labelled as {other_label}", take.span(start, stop)
            if is_unlabelled(other_label):
                track = measured[start:stop, column]
                gap = _describe_distance(measured[:, label], track, start, stop)
                where = f"{name}, {span}"
                yield QualityNote.of(
                    "markers.unlabelled_merged", where, text=text, span=span, gap=gap
                )
            else:
                exchanges.setdefault((start, stop), []).append((name, text))
    for (start, stop), markers in sorted(exchanges.items()):
        names, texts = (", ".join(items) for items in zip(*markers, strict=True))
        span = take.span(start, stop)
        yield QualityNote.of("markers.label_switch", f"{names}, {span}", texts=texts, span=span)


def _describe_distance(track: Floats, continuation: Floats, start: int, stop: int) -> str:
    """Describe the largest distance of two tracks where one continues the other, if known."""
    ends = (start - 1, continuation[0]), (stop, continuation[-1])
    gaps = [np.linalg.norm(track[frame] - end) for frame, end in ends if 0 <= frame < len(track)]
    largest = float(np.fmax.reduce(gaps, initial=-np.inf))
    return f", {1e3 * largest:.2f} mm apart where they meet" if np.isfinite(largest) else ""


def _list_relabelled_stretches(
    pieces: Tracklets, label: int, chains: tuple[Chain, ...]
) -> Iterator[tuple[int, int, int]]:
    """Yield column, start and stop of the stretches of a marker under another label."""
    members = (piece for chain in chains for piece in chain.tracklets)
    for column, group in groupby(members, key=lambda piece: int(pieces.column[piece])):
        run = list(group)
        if column != label:
            yield column, int(pieces.start[run[0]]), int(pieces.stop[run[-1]])


def _make_elimination_notes(take: TrackletTake, naming: Naming) -> Iterator[QualityNote]:
    for label, chain in naming.eliminated:
        name, span = take.names[label], take.span(chain.start, chain.stop)
        where = f"{name}, {span}"
        yield QualityNote.of("markers.label_by_elimination", where, name=name, span=span)


def _make_jump_notes(take: TrackletTake, links: Links, naming: Naming) -> Iterator[QualityNote]:
    """Yield a note per jump between successive chains of a marker."""
    for label, chains in naming.markers.items():
        for previous, following in pairwise(chains):
            if following.start == previous.stop and links.successor[previous.tracklets[-1]] < 0:
                name, span = take.names[label], take.span(following.start, following.start + 1)
                yield QualityNote.of("markers.marker_jump", f"{name}, {span}", name=name, span=span)


def _make_ambiguity_notes(
    take: TrackletTake, links: Links, naming: Naming
) -> Iterator[QualityNote]:
    pieces = take.tracklets
    for first, second in links.ambiguous[:_MAX_NOTES]:
        last_frame = int(pieces.stop[first]) - 1
        span = take.span(last_frame, int(pieces.start[second]) + 1)
        names = f"{take.names[pieces.column[first]]}, {take.names[pieces.column[second]]}"
        where, time_range = f"{names}, {span}", (float(take.time[last_frame]), float(take.time[-1]))
        yield QualityNote.of("markers.label_ambiguous", where, time_range, names=names, span=span)
    for chain in naming.doubtful:
        name, span = take.names[chain.label], take.span(chain.start, chain.stop)
        time_range = float(take.time[chain.start]), float(take.time[chain.stop - 1])
        where = f"{name}, {span}"
        yield QualityNote.of("markers.second_track", where, time_range, name=name, span=span)


def _make_dropped_notes(
    take: TrackletTake, naming: Naming, measured: Floats
) -> Iterator[QualityNote]:
    chains = sorted(naming.leftover, key=lambda chain: (chain.start, chain.stop))
    for chain in chains[:_MAX_NOTES]:
        columns = take.tracklets.column[list(chain.tracklets)]
        names = ", ".join(dict.fromkeys(take.names[column] for column in columns))
        span = take.span(chain.start, chain.stop)
        size, where = 1e3 * _compute_extent(take.tracklets, chain, measured), f"{names}, {span}"
        yield QualityNote.of("markers.track_dropped", where, names=names, span=span, size=size)
    if count := len(unlisted := chains[_MAX_NOTES:]):
        frames = sum(chain.frames for chain in unlisted)
        yield QualityNote.of("markers.tracks_dropped", "markers", count=count, frames=frames)


def _compute_extent(pieces: Tracklets, chain: Chain, measured: Floats) -> float:
    """Return the diagonal of the bounding box of a track, m."""
    rows = pieces.start, pieces.stop, pieces.column
    parts = [measured[start:stop, x] for start, stop, x in zip(*rows, strict=True)]
    points = np.concatenate([parts[piece] for piece in chain.tracklets])
    return float(np.linalg.norm(np.ptp(points, axis=0)))
