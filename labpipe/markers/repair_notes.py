"""Quality notes on the repair of marker tracks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from labpipe.markers.marker_names import Chain, Naming, is_unlabelled
from labpipe.markers.tracklets import Links, Tracklets, in_sight
from labpipe.records.arrays import Flags, Floats, stretches_of
from labpipe.records.curve import PointFlag
from labpipe.records.quality import QualityNote, Severity

_MAX_NOTES = 10
"""Most stretches of one marker with a note each; more get a common note."""
_FROZEN = ("pose_frozen", Severity.WARNING, "stale pose removed")
_FILLED = ("gap_filled", Severity.INFO, "gap filled between its ends, relative to the clamp")
_LEFT = ("gap_left", Severity.WARNING, "no position, gap too long or open to fill")


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """Data of a take for the notes: column names, frame numbers, times, tracklets."""

    names: tuple[str, ...]
    frames: Floats
    time: Floats
    pieces: Tracklets

    def span(self, start: int, stop: int) -> str:
        """Describe a stretch of frames, `stop` excluded."""
        first, last = f"{self.frames[start]:.0f}", f"{self.frames[stop - 1]:.0f}"
        frames = f"frame {first}" if stop - start == 1 else f"frames {first} to {last}"
        return f"{frames} ({self.time[start]:.3f} s to {self.time[stop - 1]:.3f} s)"


def describe(
    take: Take,
    links: Links,
    naming: Naming,
    *,
    stale: Flags,
    flags: NDArray[np.uint8],
    measured: Floats,
) -> tuple[QualityNote, ...]:
    """Return notes on all repairs and on unresolved faults.

    Parameters
    ----------
    take : names, frame numbers, times and tracklets
    links, naming : how the tracklets were joined and named
    stale : shape (frames, columns), samples removed as frozen
    flags : shape (frames, markers), after filling
    measured : shape (frames, columns, 3), m, for the extent of dropped tracks

    Returns
    -------
    The notes, by kind, then in order of time.
    """
    markers = [take.names[label] for label in naming.markers]
    return (
        *_missing_notes(take, naming, measured),
        *_stretch_notes(take, stale, list(take.names), _FROZEN),
        *_relabel_notes(take, naming, measured),
        *_elimination_notes(take, naming),
        *_jump_notes(take, links, naming),
        *_stretch_notes(take, np.equal(flags, PointFlag.FILLED), markers, _FILLED),
        *_stretch_notes(take, np.equal(flags, PointFlag.MISSING), markers, _LEFT),
        *_ambiguity_notes(take, links, naming),
        *_dropped_notes(take, naming, measured),
    )


def _warning(
    code: str, name: str, span: str, message: str, *when: tuple[float, float]
) -> QualityNote:
    return QualityNote(code, Severity.WARNING, f"{name}, {span}", message, when)


def _missing_notes(take: Take, naming: Naming, measured: Floats) -> Iterator[QualityNote]:
    seen = np.flatnonzero(in_sight(measured).any(axis=0)).tolist()
    named = [column for column, name in enumerate(take.names) if not is_unlabelled(name)]
    for column in named:
        if column not in naming.markers:
            marker = take.names[column]
            yield QualityNote.of(
                "markers.marker_under_another_label"
                if column in seen
                else "markers.marker_missing",
                marker,
                marker=marker,
            )


def _stretch_notes(
    take: Take, mask: Flags, names: list[str], note_kind: tuple[str, Severity, str]
) -> Iterator[QualityNote]:
    code, severity, text = note_kind
    for name, flags in zip(names, mask.T, strict=True):
        stretches = stretches_of(flags)
        if len(stretches) > _MAX_NOTES:
            longest = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
            message = f"{name}: {text}, {len(stretches)} times, {int(flags.sum())} frames, longest"
            where = f"{name}, {take.span(stretches[0][0], stretches[-1][1])}"
            yield QualityNote(code, severity, where, f"{message} {take.span(*longest)}")
            continue
        for start, stop in stretches:
            span = take.span(start, stop)
            message = f"{name}: {text}, {stop - start} frames, {span}"
            yield QualityNote(code, severity, f"{name}, {span}", message)


def _relabel_notes(take: Take, naming: Naming, measured: Floats) -> Iterator[QualityNote]:
    """Yield a note per exchange of labels, and per stretch without a label."""
    exchanges: dict[tuple[int, int], list[tuple[str, str]]] = {}
    for label, chains in naming.markers.items():
        for column, start, stop in _stretches_under_other_labels(take.pieces, label, chains):
            name, other = take.names[label], take.names[column]
            text, span = f"{name} was labelled as {other}", take.span(start, stop)
            if is_unlabelled(other):
                apart = _distance_text(
                    measured[:, label], measured[start:stop, column], start, stop
                )
                yield _warning("unlabelled_merged", name, span, f"{text}, {span}; merged{apart}")
            else:
                exchanges.setdefault((start, stop), []).append((name, text))
    for (start, stop), markers in sorted(exchanges.items()):
        names, texts = (", ".join(parts) for parts in zip(*markers, strict=True))
        span = take.span(start, stop)
        yield _warning("label_switch", names, span, f"{texts}, {span}; label switch corrected")


def _distance_text(own: Floats, other: Floats, start: int, stop: int) -> str:
    """Describe the distance of two tracks where one continues the other, if both are present."""
    seams = [
        float(np.linalg.norm(own[frame] - end))
        for frame, end in ((start - 1, other[0]), (stop, other[-1]))
        if 0 <= frame < len(own)
    ]
    distances = [seam for seam in seams if np.isfinite(seam)]
    return f", {1e3 * max(distances):.2f} mm apart where they meet" if distances else ""


def _stretches_under_other_labels(
    pieces: Tracklets, label: int, chains: tuple[Chain, ...]
) -> Iterator[tuple[int, int, int]]:
    """Yield column, start and stop of the stretches of a marker under another label."""
    members = (piece for chain in chains for piece in chain.tracklets)
    for column, group in groupby(members, key=lambda piece: int(pieces.column[piece])):
        run = list(group)
        if column != label:
            yield column, int(pieces.start[run[0]]), int(pieces.stop[run[-1]])


def _elimination_notes(take: Take, naming: Naming) -> Iterator[QualityNote]:
    for label, chain in naming.eliminated:
        name, span = take.names[label], take.span(chain.start, chain.stop)
        message = f"{name}: assigned a track with another label, {span}, as the only marker missing"
        yield _warning("label_by_elimination", name, span, message)


def _jump_notes(take: Take, links: Links, naming: Naming) -> Iterator[QualityNote]:
    """Yield a note per jump between successive tracklets of one label."""
    for label, chains in naming.markers.items():
        for before, after in pairwise(chains):
            if after.start == before.stop and links.successor[before.tracklets[-1]] < 0:
                name, span = take.names[label], take.span(after.start, after.start + 1)
                message = f"{name}: jumps at {span}; its label was kept"
                yield _warning("marker_jump", name, span, message)


def _ambiguity_notes(take: Take, links: Links, naming: Naming) -> Iterator[QualityNote]:
    pieces = take.pieces
    for one, two in links.ambiguous[:_MAX_NOTES]:
        last = int(pieces.stop[one]) - 1
        span = take.span(last, int(pieces.start[two]) + 1)
        names = f"{take.names[pieces.column[one]]}, {take.names[pieces.column[two]]}"
        message = f"{names}: may have exchanged labels, {span}; too close, left as labelled"
        after = float(take.time[last]), float(take.time[-1])  # the two may be exchanged there
        yield _warning("label_ambiguous", names, span, message, after)
    for chain in naming.doubtful:
        name, span = take.names[chain.label], take.span(chain.start, chain.stop)
        message = f"{name}: a second track under this label, {span}, could not be given to a marker"
        when = float(take.time[chain.start]), float(take.time[chain.stop - 1])
        yield _warning("label_ambiguous", name, span, message, when)


def _dropped_notes(take: Take, naming: Naming, measured: Floats) -> Iterator[QualityNote]:
    chains = sorted(naming.leftover, key=lambda chain: (chain.start, chain.stop))
    for chain in chains[:_MAX_NOTES]:
        columns = take.pieces.column[list(chain.tracklets)]
        names = ", ".join(dict.fromkeys(take.names[column] for column in columns))
        span, extent = take.span(chain.start, chain.stop), _extent(take.pieces, chain, measured)
        message = f"{names}: track of no marker dropped, {span}, within {extent * 1e3:.1f} mm"
        yield _warning("track_dropped", names, span, message)
    rest = chains[_MAX_NOTES:]
    if rest:
        frames = sum(chain.frames for chain in rest)
        message = f"{len(rest)} more tracks of no marker dropped, {frames} samples in all"
        yield QualityNote("track_dropped", Severity.WARNING, "markers", message)


def _extent(pieces: Tracklets, chain: Chain, measured: Floats) -> float:
    """Return the diagonal of the bounding box of a track, m."""
    points = np.concatenate(
        [
            measured[pieces.start[piece] : pieces.stop[piece], pieces.column[piece]]
            for piece in chain.tracklets
        ]
    )
    return float(np.linalg.norm(np.ptp(points, axis=0)))
