"""Assign chains of tracklets to markers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from labpipe.markers.tracklets import Links, Tracklets
from labpipe.records.arrays import Floats

_UNLABELLED = re.compile(r"unlabell?ed", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Chain:
    """The path of one point: tracklets in order of time.

    Parameters
    ----------
    tracklets : numbers of the tracklets
    start, stop : frames, `stop` excluded
    frames : number of frames with a position
    label : column of the marker according to the labels; -1 if the chain has no label
    """

    tracklets: tuple[int, ...]
    start: int
    stop: int
    frames: int
    label: int

    def overlaps(self, other: Chain) -> bool:
        """Return whether the chains have a common frame, so that they belong to two markers."""
        return max(self.start, other.start) < min(self.stop, other.stop)


@dataclass(frozen=True, slots=True)
class Naming:
    """Chains of each marker, and chains of no marker.

    Parameters
    ----------
    markers : by column of the marker, its chains in order of time
    eliminated : chains assigned to the only missing marker, with its column
    doubtful : labelled chains that could belong to several markers, or to none
    leftover : chains of no marker
    """

    markers: dict[int, tuple[Chain, ...]]
    eliminated: tuple[tuple[int, Chain], ...]
    doubtful: tuple[Chain, ...]
    leftover: tuple[Chain, ...]


def is_unlabelled(name: str) -> bool:
    """Return whether the motion-capture program did not name a track."""
    return _UNLABELLED.match(name.rpartition(":")[2]) is not None or bool(_UNLABELLED.match(name))


def name_chains(
    names: Sequence[str],
    tracklets: Tracklets,
    links: Links,
    *,
    relative: Floats,
    time: Floats,
    settled: float,
    min_distance: float,
) -> Naming:
    """Assign each chain to a marker.

    Parameters
    ----------
    names : of the columns
    tracklets, links : the chains
    relative : shape (frames, columns, 3), m, positions relative to the clamp
    time : shape (frames,), s
    settled : s, shortest duration of a valid label; shorter stretches are errors
    min_distance : m, smallest distance between two markers; a closer track is a double

    Returns
    -------
    The naming.

    Notes
    -----
    A chain belongs to the marker of its first label that lasts at least `settled`, since labels are
    assigned at the start of a take and become wrong later; without one, to that of its longest
    label. Of two simultaneous chains with one label, the one with more frames keeps it; the other,
    if it lasts at least `settled`, is assigned to the marker that is missing during that time, if
    there is exactly one. A track that begins at the position of another one is a double, which is
    used only if no longer track has its label. In a take without labels, the columns with at least
    half the frames of the longest one are the markers.
    """
    is_named = [not is_unlabelled(name) for name in names]
    has_no_labels = not any(is_named)
    if has_no_labels:
        is_named = [True] * len(names)
    chains = _collect_chains(tracklets, links, time, is_named, settled)
    doubles = [chain for chain in chains if _is_double(chain, tracklets, relative, min_distance)]
    markers, rejected = _assign_by_label(chains, doubles)
    lasting = [x for x in rejected if time[x.stop - 1] - time[x.start] >= settled]
    candidates = [chain for chain in lasting if chain not in doubles]
    short_chains = [chain for chain in rejected if chain not in candidates]
    eliminated, doubtful = _eliminate(markers, candidates)
    leftover = short_chains + [chain for chain in chains if chain.label < 0]
    if has_no_labels:
        leftover += _remove_short(markers)
    by_start = attrgetter("start")
    ordered = {label: tuple(sorted(markers[label], key=by_start)) for label in sorted(markers)}
    return Naming(ordered, tuple(eliminated), tuple(doubtful), tuple(leftover))


def _collect_chains(
    tracklets: Tracklets, links: Links, time: Floats, named: list[bool], settled: float
) -> list[Chain]:
    members: dict[int, list[int]] = {}
    for tracklet, chain in enumerate(links.chain.tolist()):
        members.setdefault(chain, []).append(tracklet)
    column, length = tracklets.column, tracklets.stop - tracklets.start
    is_lasting = time[tracklets.stop - 1] - time[tracklets.start] >= settled
    chains = []
    for pieces in members.values():
        with_name = [piece for piece in pieces if named[column[piece]]]
        best = [piece for piece in with_name if is_lasting[piece]]
        best = best or sorted(with_name, key=lambda piece: -length[piece])
        label = int(column[best[0]]) if best else -1
        start, stop = int(tracklets.start[pieces[0]]), int(tracklets.stop[pieces[-1]])
        chains.append(Chain(tuple(pieces), start, stop, int(length[pieces].sum()), label))
    return chains


def _assign_by_label(
    chains: list[Chain], doubles: list[Chain]
) -> tuple[dict[int, list[Chain]], list[Chain]]:
    """Return the chains of each marker, and those that are doubles or overlap a longer chain."""
    markers: dict[int, list[Chain]] = {}
    rejected: list[Chain] = []
    labelled = [chain for chain in chains if chain.label >= 0]
    for chain in sorted(labelled, key=lambda chain: (-chain.frames, chain.start)):
        own = markers.setdefault(chain.label, [])
        is_taken = any(map(chain.overlaps, own)) or (len(own) > 0 and chain in doubles)
        (rejected if is_taken else own).append(chain)
    return markers, rejected


def _is_double(chain: Chain, tracklets: Tracklets, relative: Floats, min_distance: float) -> bool:
    """Return whether the chain begins at the position of another track."""
    column = tracklets.column[chain.tracklets[0]]
    distance = np.linalg.norm(relative[chain.start] - relative[chain.start, column], axis=1)
    distance[column] = np.nan
    return bool((distance < min_distance).any())


def _eliminate(
    markers: dict[int, list[Chain]], rejected: list[Chain]
) -> tuple[list[tuple[int, Chain]], list[Chain]]:
    """Assign rejected chains to the only missing marker, unless two chains compete for it."""
    eliminated: list[tuple[int, Chain]] = []
    doubtful: list[Chain] = []
    for chain in sorted(rejected, key=attrgetter("start")):
        free_labels = [x for x, own in markers.items() if not any(map(chain.overlaps, own))]
        rivals = [x for x in rejected if x is not chain and chain.overlaps(x)]
        if len(free_labels) == 1 and not rivals:
            markers[free_labels[0]].append(chain)
            eliminated.append((free_labels[0], chain))
        else:
            doubtful.append(chain)
    return eliminated, doubtful


def _remove_short(markers: dict[int, list[Chain]]) -> list[Chain]:
    """Remove markers with less than half the frames of the longest one; return their chains."""
    totals = {label: sum(chain.frames for chain in own) for label, own in markers.items()}
    longest = max(totals.values(), default=0)
    short_labels = [label for label, frames in totals.items() if 2 * frames < longest]
    return [chain for label in short_labels for chain in markers.pop(label)]
