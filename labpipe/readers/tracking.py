"""Quality of marker tracks: gaps, frozen poses and label switches."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np

from labpipe.records.arrays import Flags, Floats, stretches_of
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import MarkerTracks

_UNLABELLED = re.compile(r"Unlabeled[ :].*|Marker-\d+")
"""``Unlabeled 2379`` (1.23), ``Unlabeled:108`` (1.21), ``Marker-1718`` (1.1)."""


def blank(positions: Floats) -> Flags:
    """Find the frames in which an object has no position.

    Parameters
    ----------
    positions : shape (frames, 3), m

    Returns
    -------
    shape (frames,).
    """
    return np.asarray(np.isnan(positions).any(axis=1))


def unchanged(positions: Floats) -> Flags:
    """Find the steps over which a position stays the same to the last digit.

    Parameters
    ----------
    positions : shape (frames, 3), m; NaN is never the same as anything

    Returns
    -------
    shape (frames - 1,).
    """
    return np.asarray((np.diff(positions, axis=0) == 0.0).all(axis=1))


def longest(flags: Flags) -> int:
    """Return the length of the longest stretch of flagged samples, 0 if there is none."""
    return max((stop - start for start, stop in stretches_of(flags)), default=0)


def track_notes(tracks: MarkerTracks) -> list[QualityNote]:
    """Return notes on marker tracks.

    Parameters
    ----------
    tracks : the take

    Returns
    -------
    Notes ``take_empty``, ``frame_jumps``, ``marker_blank``, ``marker_gaps``, ``body_gaps``,
    ``frozen_pose``, ``label_switch``, ``unlabelled_markers``.
    """
    if not tracks.names and not tracks.bodies:
        message = "the take holds no rigid body and no marker"
        return [QualityNote("take_empty", Severity.WARNING, "take", message)]
    markers = {name: tracks.positions[:, i] for i, name in enumerate(tracks.names)}
    bodies = {body.name: body.position for body in tracks.bodies}
    never = [name for name, track in markers.items() if len(track) and blank(track).all()]
    notes = []
    if never:
        message = f"never seen: {', '.join(never)}"
        notes.append(QualityNote("marker_blank", Severity.WARNING, "markers", message))
    notes += [*_gap_notes(markers, "marker_gaps"), *_gap_notes(bodies, "body_gaps")]
    notes += [*_frozen_notes(bodies | markers), *_switch_notes(markers)]
    unlabelled = sum(map(_is_unlabelled, tracks.names))
    if unlabelled:
        message = f"{unlabelled} of {len(tracks.names)} markers have no label"
        notes.append(QualityNote("unlabelled_markers", Severity.INFO, "markers", message))
    return notes


def _is_unlabelled(name: str) -> bool:
    return _UNLABELLED.fullmatch(name) is not None


def _gap_notes(objects: Mapping[str, Floats], code: str) -> Iterator[QualityNote]:
    for name, track in objects.items():
        missing = blank(track)
        if missing.any() and not missing.all():
            message = f"missing in {int(missing.sum())} of {len(missing)} frames, gaps:"
            message += f" {len(stretches_of(missing))}, the longest {longest(missing)} frames"
            yield QualityNote(code, Severity.INFO, name, message)


def _frozen_notes(objects: Mapping[str, Floats]) -> Iterator[QualityNote]:
    # Successive unchanged steps from which a pose counts as frozen, not as at rest.
    min_frozen_steps = 10
    for name, track in objects.items():
        still = unchanged(track)
        if longest(still) >= min_frozen_steps:
            message = f"position unchanged to the last digit in {int(still.sum())} of"
            message += f" {len(still)} steps, up to {longest(still)} in a row:"
            message += " lost, with its last pose repeated?"
            yield QualityNote("frozen_pose", Severity.WARNING, name, message)


def _switch_notes(markers: Mapping[str, Floats]) -> Iterator[QualityNote]:
    """Find labelled markers missing in exactly the frames where an unlabelled one is seen."""
    unlabelled = {name: ~blank(track) for name, track in markers.items() if _is_unlabelled(name)}
    for name, track in markers.items():
        missing = blank(track)
        others = [other for other, seen in unlabelled.items() if np.array_equal(seen, missing)]
        if name not in unlabelled and others and missing.any():
            ranges = [f"{start}-{stop - 1}" for start, stop in stretches_of(missing)[:3]]
            message = f"missing in rows {', '.join(ranges)}, exactly where {', '.join(others)} is"
            message += " seen: label switch?"
            yield QualityNote("label_switch", Severity.WARNING, name, message)
