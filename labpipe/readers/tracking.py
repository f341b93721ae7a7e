"""Quality of marker tracks: gaps, frozen poses and label switches."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats, stretches_of
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import MarkerTracks

_UNLABELLED = re.compile(r"Unlabeled[ :].*|Marker-\d+")


@dataclass(frozen=True, slots=True)
class Run:
    """A stretch of samples from `first` to `last`, inclusive, counted from 0."""

    first: int
    last: int

    @property
    def length(self) -> int:
        """Return the number of samples."""
        return self.last - self.first + 1


def runs(flags: Flags) -> list[Run]:
    """Find the stretches in which a flag is set.

    Parameters
    ----------
    flags : shape (n,)

    Returns
    -------
    The stretches in order.

    Examples
    --------
    >>> runs(np.array([True, True, False, True]))
    [Run(first=0, last=1), Run(first=3, last=3)]
    """
    return [Run(start, stop - 1) for start, stop in stretches_of(flags)]


def blank(positions: Floats) -> Flags:
    """Find the frames in which an object has no position.

    Parameters
    ----------
    positions : shape (frames, 3), m

    Returns
    -------
    Extent (frames,).
    """
    return np.asarray(np.isnan(positions).any(axis=1))


def unchanged(positions: Floats) -> Flags:
    """Find the steps over which a position stays the same to the last digit.

    Parameters
    ----------
    positions : shape (frames, 3), m; NaN is never the same as anything

    Returns
    -------
    Extent (frames - 1,).
    """
    return np.asarray((np.diff(positions, axis=0) == 0.0).all(axis=1))


def longest(stretches: list[Run]) -> int:
    """Return the length of the longest stretch, 0 if there is none."""
    return max((run.length for run in stretches), default=0)


def is_unlabelled(name: str) -> bool:
    """Return whether a marker has no label.

    Such markers are ``Unlabeled 2379`` (1.23), ``Unlabeled:108`` (1.21), ``Marker-1718`` (1.1).
    """
    return _UNLABELLED.fullmatch(name) is not None


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
    return [
        *_blank_notes(markers),
        *_gap_notes(markers, "marker_gaps"),
        *_gap_notes(bodies, "body_gaps"),
        *_frozen_notes(bodies | markers),
        *_switch_notes(markers),
        *_unlabelled_note(tracks.names),
    ]


def _blank_notes(markers: dict[str, Floats]) -> list[QualityNote]:
    never = [name for name, track in markers.items() if len(track) and blank(track).all()]
    if not never:
        return []
    message = f"never seen: {', '.join(never)}"
    return [QualityNote("marker_blank", Severity.WARNING, "markers", message)]


def _gap_notes(objects: dict[str, Floats], code: str) -> list[QualityNote]:
    notes = []
    for name, track in objects.items():
        missing = blank(track)
        if not missing.any() or missing.all():
            continue
        gaps = runs(missing)
        message = f"missing in {int(missing.sum())} of {len(missing)} frames, gaps: {len(gaps)},"
        message += f" the longest {longest(gaps)} frames"
        notes.append(QualityNote(code, Severity.INFO, name, message))
    return notes


def _frozen_notes(objects: dict[str, Floats]) -> list[QualityNote]:
    # Successive unchanged steps from which a pose counts as frozen, not as at rest.
    min_frozen_steps = 10
    notes = []
    for name, track in objects.items():
        still = unchanged(track)
        stretches = runs(still)
        if longest(stretches) < min_frozen_steps:
            continue
        message = f"position unchanged to the last digit in {int(still.sum())} of"
        message += f" {len(still)} steps, up to {longest(stretches)} in a row:"
        message += " lost, with its last pose repeated?"
        notes.append(QualityNote("frozen_pose", Severity.WARNING, name, message))
    return notes


def _switch_notes(markers: dict[str, Floats]) -> list[QualityNote]:
    """Find labelled markers missing in exactly the frames where an unlabelled one is seen."""
    unlabelled = {name: ~blank(track) for name, track in markers.items() if is_unlabelled(name)}
    notes = []
    for name, track in markers.items():
        missing = blank(track)
        others = [other for other, seen in unlabelled.items() if np.array_equal(seen, missing)]
        if is_unlabelled(name) or not others or not missing.any():
            continue
        where = ", ".join(f"{run.first}-{run.last}" for run in runs(missing)[:3])
        seen = ", ".join(others)
        message = f"missing in rows {where}, exactly where {seen} is seen: label switch?"
        notes.append(QualityNote("label_switch", Severity.WARNING, name, message))
    return notes


def _unlabelled_note(names: tuple[str, ...]) -> list[QualityNote]:
    count = sum(is_unlabelled(name) for name in names)
    if not count:
        return []
    message = f"{count} of {len(names)} markers have no label"
    return [QualityNote("unlabelled_markers", Severity.INFO, "markers", message)]
