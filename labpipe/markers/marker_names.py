"""Give every chain of tracklets to the marker that it shows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.markers.tracklets import Links, Tracklets
from labpipe.records.arrays import Floats

_UNLABELLED = re.compile(r"unlabell?ed", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Chain:
    """The path of one point: tracklets in order of time.

    Parameters
    ----------
    tracklets : their numbers
    start, stop : frames, `stop` left out
    frames : number of frames in which the point was seen
    label : column of the marker that the chain says it is, -1 if it never had a name
    """

    tracklets: tuple[int, ...]
    start: int
    stop: int
    frames: int
    label: int

    def overlaps(self, other: Chain) -> bool:
        """Whether both exist in some frame, so that they cannot be one marker."""
        return max(self.start, other.start) < min(self.stop, other.stop)


@dataclass(frozen=True, slots=True)
class Naming:
    """Chains of each marker, and what is left over.

    Parameters
    ----------
    markers : by column of the marker, its chains in order of time
    eliminated : chains given to the only marker that was free, by that marker's column
    doubtful : named chains that could be one of several markers, or of none
    leftover : chains that belong to no marker
    """

    markers: dict[int, tuple[Chain, ...]]
    eliminated: tuple[tuple[int, Chain], ...]
    doubtful: tuple[Chain, ...]
    leftover: tuple[Chain, ...]


def is_unlabelled(name: str) -> bool:
    """Whether a track is one that the motion-capture program could not name."""
    return _UNLABELLED.match(name.rpartition(":")[2]) is not None or bool(_UNLABELLED.match(name))


def name_chains(
    names: Sequence[str],
    tracklets: Tracklets,
    links: Links,
    *,
    relative: Floats,
    time: Floats,
    settled: float,
    apart: float,
) -> Naming:
    """Decide which marker each chain is.

    Parameters
    ----------
    names : of the columns
    tracklets, links : the chains
    relative : shape (frames, columns, 3), m, positions relative to the clamp
    time : shape (frames,), s
    settled : s, how long a label must hold to be believed; shorter stretches are glitches
    apart : m, least distance between two markers; a track nearer to another one is its double

    Returns
    -------
    The naming.

    Notes
    -----
    A chain is the marker whose label it bore first for at least `settled` (labels are given at the
    start of a take and go wrong later), else the one it bore longest. Of two simultaneous chains
    with one name the longer keeps it; the other is given to the marker that is missing all that
    time, if there is exactly one. A track that begins where another one is, is a double and only
    believed if it is all that its label has. In a take without any named track the
    long-lived chains (half the longest or more) are the markers.
    """
    named = [not is_unlabelled(name) for name in names]
    anonymous = not any(named)
    chains = _collect(tracklets, links, time, [anonymous or known for known in named], settled)
    doubles = [chain for chain in chains if _is_double(chain, tracklets, relative, apart)]
    markers, rejected = _claim(chains, doubles)
    single = [
        chain
        for chain in rejected
        if time[chain.stop - 1] - time[chain.start] >= settled and chain not in doubles
    ]
    short = [chain for chain in rejected if chain not in single]
    eliminated, doubtful = _eliminate(markers, single)
    leftover = short + [chain for chain in chains if chain.label < 0]
    if anonymous:
        leftover += _short_lived(markers)
    ordered = {
        label: tuple(sorted(markers[label], key=lambda chain: chain.start))
        for label in sorted(markers)
    }
    return Naming(ordered, tuple(eliminated), tuple(doubtful), tuple(leftover))


def _collect(
    tracklets: Tracklets, links: Links, time: Floats, named: list[bool], settled: float
) -> list[Chain]:
    members: dict[int, list[int]] = {}
    for tracklet, chain in enumerate(links.chain.tolist()):
        members.setdefault(chain, []).append(tracklet)
    length = tracklets.stop - tracklets.start
    lasting = time[tracklets.stop - 1] - time[tracklets.start] >= settled
    column = tracklets.column

    def label(pieces: list[int]) -> int:
        known = [piece for piece in pieces if named[column[piece]]]
        first = next((piece for piece in known if lasting[piece]), None)
        best = first if first is not None else max(known, key=lambda p: length[p], default=None)
        return -1 if best is None else int(column[best])

    return [
        Chain(
            tuple(pieces),
            int(tracklets.start[pieces[0]]),
            int(tracklets.stop[pieces[-1]]),
            int(length[pieces].sum()),
            label(pieces),
        )
        for pieces in members.values()
    ]


def _claim(chains: list[Chain], doubles: list[Chain]) -> tuple[dict[int, list[Chain]], list[Chain]]:
    """Chains by the marker they say they are, and those that find it taken or are doubles."""
    markers: dict[int, list[Chain]] = {}
    rejected: list[Chain] = []
    for chain in sorted(chains, key=lambda chain: (-chain.frames, chain.start)):
        if chain.label < 0:
            continue
        held = markers.setdefault(chain.label, [])
        taken = any(chain.overlaps(other) for other in held)
        (rejected if taken or (held and chain in doubles) else held).append(chain)
    return markers, rejected


def _is_double(chain: Chain, tracklets: Tracklets, relative: Floats, apart: float) -> bool:
    """Whether the chain begins where some other track is."""
    own = tracklets.column[chain.tracklets[0]]
    distance = np.linalg.norm(relative[chain.start] - relative[chain.start, own], axis=1)
    distance[own] = np.nan
    return bool((distance < apart).any())


def _eliminate(
    markers: dict[int, list[Chain]], rejected: list[Chain]
) -> tuple[list[tuple[int, Chain]], list[Chain]]:
    """Give a rejected chain to the one marker that is missing all the time it lasts."""
    eliminated: list[tuple[int, Chain]] = []
    doubtful: list[Chain] = []
    for chain in sorted(rejected, key=lambda chain: chain.start):
        free = [
            label
            for label, held in markers.items()
            if not any(chain.overlaps(other) for other in held)
        ]
        rivals = [other for other in rejected if other is not chain and chain.overlaps(other)]
        if len(free) == 1 and not rivals:
            markers[free[0]].append(chain)
            eliminated.append((free[0], chain))
        else:
            doubtful.append(chain)
    return eliminated, doubtful


def _short_lived(markers: dict[int, list[Chain]]) -> list[Chain]:
    """Take the markers out that live less than half as long as the longest."""
    life = {label: sum(chain.frames for chain in held) for label, held in markers.items()}
    longest = max(life.values(), default=0)
    gone = [label for label, frames in life.items() if 2 * frames < longest]
    return [chain for label in gone for chain in markers.pop(label)]
