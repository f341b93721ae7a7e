"""Cut marker tracks into tracklets (unbroken stretches), link them to chains, name the chains."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints, compute_median_step, find_runs

_LABEL_CHANGE_COST = 0.25
"""Cost of a change of label, as a fraction of `max_jump`."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracklets:
    """Unbroken stretches of tracks, sorted by their first frame.

    Parameters
    ----------
    column : shape (n,), index of the track of each tracklet
    start, stop : shape (n,), indices of the frames, `stop` excluded
    """

    column: Ints
    start: Ints
    stop: Ints

    def __len__(self) -> int:
        return len(self.column)


def is_in_sight(positions: Floats) -> Flags:
    """Return whether each point of shape (..., 3) has a position, shape (...)."""
    x, y, z = (np.isfinite(positions[..., axis]) for axis in range(3))  # .all() is 15 times slower
    return np.asarray(x & y & z, dtype=np.bool_)


def compute_frame_period(time: Floats) -> float:
    """Compute the median frame period, s, which gaps do not change; 1 s for a single frame."""
    return compute_median_step(time) if len(time) > 1 else 1.0


def find_frozen_samples(
    positions: Floats, time: Floats, *, min_frozen_time: float, reference: Floats | None = None
) -> Flags:
    """Find samples that repeat the last position while other points move.

    Some exports repeat the last position of a lost point instead of leaving it blank.

    Parameters
    ----------
    positions : shape (frames, points, 3), m, exported positions
    time : shape (frames,), s
    min_frozen_time : shortest duration of a run of equal positions, s
    reference : shape (frames, 3), m, another moving point, such as the clamp

    Returns
    -------
    Shape (frames, points), flags of frozen samples. The first sample of a run was measured and is
    not flagged.

    Notes
    -----
    A run counts if another point moves in at least half of its steps. A NaN ends a run.
    """
    is_frozen = np.zeros(positions.shape[:2], dtype=np.bool_)
    if len(positions) < 2:
        return is_frozen
    steps = np.diff(positions, axis=0)
    is_moving = (np.abs(steps) > 0).any(axis=(1, 2))
    if reference is not None:
        is_moving |= (np.abs(np.diff(reference, axis=0)) > 0).any(axis=1)
    moving_steps = np.r_[0, np.cumsum(is_moving)]
    for point, is_repeated in enumerate(np.asarray((steps == 0).all(axis=2)).T):
        for first, last in find_runs(is_repeated):
            is_long = time[last] - time[first] >= min_frozen_time * (1 - 1e-9)
            if is_long and 2 * (moving_steps[last] - moving_steps[first]) >= last - first:
                is_frozen[first + 1 : last + 1, point] = True
    return is_frozen


def cut_tracklets(
    positions: Floats, relative: Floats, time: Floats, *, max_jump: float
) -> Tracklets:
    """Cut every track at gaps, at jumps, and where two tracks exchange their markers.

    Parameters
    ----------
    positions : shape (frames, tracks, 3), m, measured positions; NaN where missing
    relative : shape (frames, tracks, 3), m, positions relative to the clamp
    time : shape (frames,), s
    max_jump : longest step per frame period that is motion, m. A step is a jump only if it is too
        long both as measured and relative to the clamp, so that neither fast travel of the whole
        rig nor an error of the pose of the clamp cuts tracks

    Returns
    -------
    The tracklets.

    Raises
    ------
    ValueError
        If there are thousands of tracklets of fewer than ten samples on average: they are noise,
        whose possible links would need more time and memory than there is.
    """
    max_tracklets, min_mean_samples = 2000, 10
    is_visible = is_in_sight(positions)
    are_consecutive = is_visible[1:] & is_visible[:-1]
    are_consecutive &= ~_find_jumps(positions, relative, time, max_jump)
    joins_previous = np.pad(are_consecutive, ((1, 0), (0, 0)))
    joins_next = np.pad(are_consecutive, ((0, 1), (0, 0)))
    column, start = np.nonzero((is_visible & ~joins_previous).T)
    stop = np.nonzero((is_visible & ~joins_next).T)[1] + 1
    mean_samples = is_visible.sum() / max(1, len(start))
    if len(start) > max_tracklets and mean_samples < min_mean_samples:
        found = {"count": len(start), "samples": mean_samples, "jump": 1e3 * max_jump}
        raise ValueError(format_sentence("markers.tracks_in_pieces", **found))
    order = np.lexsort((column, start))
    return Tracklets(*(values[order].astype(np.int64) for values in (column, start, stop)))


def _find_jumps(positions: Floats, relative: Floats, time: Floats, max_jump: float) -> Flags:
    """Find the steps that are jumps or exchanges of labels, shape (frames - 1, tracks)."""
    n_periods = np.maximum(1.0, np.diff(time) / compute_frame_period(time))
    squared_steps = np.minimum(_compute_squared_steps(positions), _compute_squared_steps(relative))
    is_jump: Flags = np.asarray(squared_steps > (max_jump * n_periods[:, None]) ** 2, np.bool_)
    # Two markers closer than max_jump can exchange labels without a jump.
    frames = np.flatnonzero((squared_steps > (max_jump / 4) ** 2).sum(axis=1) > 1)
    offsets = relative[frames + 1][:, :, None] - relative[frames][:, None]
    distances = np.linalg.norm(offsets, axis=3)
    is_nearer = distances < np.einsum("fii->fi", distances)[:, :, None]
    is_jump[frames] |= (is_nearer & is_nearer.transpose(0, 2, 1)).any(axis=2)
    return is_jump


def _compute_squared_steps(positions: Floats) -> Floats:
    """Compute the squared lengths of steps, shape (frames - 1, tracks), m^2."""
    steps = np.diff(positions, axis=0)
    return np.asarray(np.einsum("fmi,fmi->fm", steps, steps), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Links between tracklets.

    Parameters
    ----------
    successor : shape (tracklets,), index of the next tracklet of the chain, -1 at its end
    ambiguous : indices of both tracklets of each possible link that competes with a link of similar
        distance; no label is changed by it
    """

    successor: Ints
    ambiguous: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Pairs of tracklets that may be linked; arrays of shape (pairs,).

    Parameters
    ----------
    end, start : indices of the tracklets whose end and whose start would be linked
    distance : distance of the start from the expected position, m
    cost : distance plus the cost of a change of label, m
    """

    end: Ints
    start: Ints
    distance: Floats
    cost: Floats


def link_tracklets(
    tracklets: Tracklets, relative: Floats, time: Floats, *, max_gap: float, max_jump: float
) -> Links:
    """Link ends of tracklets to starts of other tracklets near the expected position.

    Parameters
    ----------
    tracklets : tracklets, sorted by their first frame
    relative : shape (frames, tracks, 3), m, positions relative to the clamp
    time : shape (frames,), s
    max_gap : longest time without a sample between linked tracklets, s
    max_jump : largest distance of the start from the expected position, m; for the same label it is
        multiplied by the square root of the gap in frame periods

    Returns
    -------
    The links.

    Notes
    -----
    The expected position is the last position or its extrapolation with the mean of both
    velocities, whichever is nearer. In each group of competing ends and starts, the assignment with
    the smallest total cost is used. The cost is the distance, plus a quarter of `max_jump` for a
    change of label. A change of label is rejected if a rival (a simultaneous tracklet) is as near
    within that margin.
    """
    pairs = _find_candidates(tracklets, relative, time, max_gap=max_gap, max_jump=max_jump)
    successor = np.full(len(tracklets), -1, dtype=np.int64)
    chosen_pairs = _choose_pairs(pairs, unlinked_cost=max_jump * (1 + _LABEL_CHANGE_COST))
    margin = _LABEL_CHANGE_COST * max_jump
    rivals_of_pairs = dict(_find_rivals(pairs, chosen_pairs, tracklets, margin))
    changes_label = tracklets.column[pairs.end] != tracklets.column[pairs.start]
    for index in chosen_pairs:
        if not (changes_label[index] and index in rivals_of_pairs):
            successor[pairs.end[index]] = pairs.start[index]
    ambiguous = tuple(
        (int(pairs.end[index]), int(pairs.start[index if changes_label[index] else rival]))
        for index, rival in rivals_of_pairs.items()
    )
    return Links(successor, ambiguous)


def _find_candidates(
    tracklets: Tracklets, relative: Floats, time: Floats, *, max_gap: float, max_jump: float
) -> _Pairs:
    """Find the pairs of tracklets that may be linked, as `link_tracklets` states."""
    period = compute_frame_period(time)
    starts, ends = time[tracklets.start], time[tracklets.stop - 1]
    first = np.searchsorted(starts, ends, side="right")
    # A tenth of a period is the tolerance for uneven frame times.
    last = np.searchsorted(starts, ends + max_gap + 1.1 * period, side="right")
    counts = np.maximum(last - first, 0)
    end = np.repeat(np.arange(len(tracklets)), counts)
    start = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first[end]
    gap = starts[start] - ends[end]
    distance = _compute_distances(tracklets, relative, time, end, start)
    changes_label = tracklets.column[end] != tracklets.column[start]
    n_periods = np.where(changes_label, 1.0, np.maximum(1.0, gap / period))
    cost = np.minimum(distance, 0.999 * max_jump) + _LABEL_CHANGE_COST * max_jump * changes_label
    is_near = distance <= max_jump * np.sqrt(n_periods)
    return _Pairs(end[is_near], start[is_near], distance[is_near], cost[is_near])


def _compute_distances(
    tracklets: Tracklets, relative: Floats, time: Floats, end: Ints, start: Ints
) -> Floats:
    """Compute the distance of each start from the expected position, shape (pairs,), m."""
    velocity_frames = 5
    column, begin, final = tracklets.column, tracklets.start, tracklets.stop - 1
    inside_end = np.maximum(begin, final - velocity_frames)
    inside_start = np.minimum(final, begin + velocity_frames)

    def compute_velocity(a: Ints, b: Ints) -> Floats:
        duration = np.where(b > a, time[b] - time[a], 1.0)
        return np.asarray((relative[b, column] - relative[a, column]) / duration[:, None])

    end_velocity = compute_velocity(inside_end, final)
    start_velocity = compute_velocity(begin, inside_start)
    gap = relative[begin[start], column[start]] - relative[final[end], column[end]]
    duration = (time[begin[start]] - time[final[end]])[:, None]
    extrapolated_gap = gap - duration * (end_velocity[end] + start_velocity[start]) / 2
    nearest = np.minimum(np.linalg.norm(gap, axis=1), np.linalg.norm(extrapolated_gap, axis=1))
    return np.asarray(nearest, dtype=np.float64)


def _choose_pairs(pairs: _Pairs, *, unlinked_cost: float) -> list[int]:
    """Choose the pairs of the assignment with the smallest total cost; return their indices."""
    if all(len(np.unique(side)) == len(side) for side in (pairs.end, pairs.start)):
        return list(np.argsort(pairs.end).tolist())  # no pair competes with another
    from scipy.sparse import coo_array  # slow import, not needed by tensile tests
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    ends, row = np.unique(pairs.end, return_inverse=True)
    starts, column = np.unique(pairs.start, return_inverse=True)
    # Each end may also be matched with a column of its own, and is then unlinked. The same amount
    # is added to all weights, because a weight of 0 would be no edge.
    own_row = np.arange(len(ends))
    weights = unlinked_cost + np.append(pairs.cost, np.full(len(ends), unlinked_cost))
    places = np.append(row, own_row), np.append(column, len(starts) + own_row)
    graph = coo_array((weights, places), shape=(len(ends), len(starts) + len(ends))).tocsr()
    index = {place: i for i, place in enumerate(zip(row.tolist(), column.tolist(), strict=True))}
    matches = zip(*(x.tolist() for x in min_weight_full_bipartite_matching(graph)), strict=True)
    return [index[match] for match in matches if match in index]


def _find_rivals(
    pairs: _Pairs, chosen: list[int], tracklets: Tracklets, margin: float
) -> Iterable[tuple[int, int]]:
    """Yield the index of each chosen pair with a rival of similar distance, and of the rival."""
    column, first, last = tracklets.column, tracklets.start, tracklets.stop
    pairs_by_end, pairs_by_start = _group_by_value(pairs.end), _group_by_value(pairs.start)
    for index in chosen:
        end, start = int(pairs.end[index]), int(pairs.start[index])
        changes_label = column[end] != column[start]
        max_distance = pairs.distance[index] + (margin if changes_label else 0.0)
        for rival in pairs_by_end[end] + pairs_by_start[start]:
            rival_end, rival_start = int(pairs.end[rival]), int(pairs.start[rival])
            # Two tracklets with a common frame are different points.
            competes = any(
                a != b and max(first[a], first[b]) < min(last[a], last[b])
                for a, b in ((start, rival_start), (end, rival_end))
            )
            is_relevant = changes_label or column[rival_end] != column[rival_start]
            if rival != index and competes and is_relevant and pairs.distance[rival] < max_distance:
                yield index, rival
                break


def _group_by_value(keys: Ints) -> dict[int, list[int]]:
    """Group the indices of equal values, keyed by value."""
    indices_by_value: dict[int, list[int]] = {}
    for index, key in enumerate(keys.tolist()):
        indices_by_value.setdefault(key, []).append(index)
    return indices_by_value


_UNLABELLED = re.compile(r"(?i:(.*:)?unlabell?ed.*)|Marker-\d+")
"""Pattern of the names of unlabelled tracks, such as ``Unlabeled 2379`` (Motive table style 1.23),
``Unlabeled:108`` (1.21), and ``Marker-1718`` (row style 1.1)."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Path of one point, as tracklets in order of time.

    Parameters
    ----------
    tracklets : indices of the tracklets
    start, stop : indices of the first frame, and of the first frame after the chain
    frames : number of frames with a position
    label : column of the marker that the labels state; -1 if the chain has no label
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
    markers : chains of each marker in order of time, keyed by column
    assigned_by_elimination : each chain without a valid label that belongs to the only missing
        marker, after the column of this marker
    doubtful : labelled chains that may belong to several markers, or to none
    unassigned : chains of no marker
    """

    markers: dict[int, tuple[Chain, ...]]
    assigned_by_elimination: tuple[tuple[int, Chain], ...]
    doubtful: tuple[Chain, ...]
    unassigned: tuple[Chain, ...]


def is_unlabelled(name: str) -> bool:
    """Return whether a track has only the automatic name of the motion-capture program."""
    return _UNLABELLED.fullmatch(name) is not None


def name_chains(
    names: Sequence[str],
    tracklets: Tracklets,
    links: Links,
    *,
    relative: Floats,
    time: Floats,
    min_label_time: float,
    min_distance: float,
) -> Naming:
    """Assign each chain to a marker.

    Parameters
    ----------
    names : names of the columns
    tracklets, links : tracklets and their links to chains
    relative : shape (frames, columns, 3), m, positions relative to the clamp
    time : shape (frames,), s
    min_label_time : shortest duration of a valid label, s; shorter stretches are errors
    min_distance : smallest distance between two markers, m; a closer track is a copy

    Returns
    -------
    The naming.

    Notes
    -----
    A chain belongs to the marker of its first label that lasts at least `min_label_time`, since
    labels are assigned at the start of a take and become wrong later. Without such a label, it
    belongs to the marker of its longest label. If two simultaneous chains have the same label, the
    chain with more frames keeps it. The other chain, if it lasts at least `min_label_time`, is
    assigned to the marker that is missing during that time, if there is exactly one. A track that
    begins at the position of another track is a copy, which is used only if no longer track
    has its label. In a take without labels, the columns with at least half the frames of the
    longest column are the markers.
    """
    is_named = [not is_unlabelled(name) for name in names]
    has_no_labels = not any(is_named)
    if has_no_labels:
        is_named = [True] * len(names)
    chains = _collect_chains(tracklets, links, time, is_named, min_label_time)
    copies = [chain for chain in chains if _is_copy(chain, tracklets, relative, min_distance)]
    markers, rejected_chains = _assign_by_label(chains, copies)
    long_chains = [x for x in rejected_chains if time[x.stop - 1] - time[x.start] >= min_label_time]
    candidates = [chain for chain in long_chains if chain not in copies]
    short_chains = [chain for chain in rejected_chains if chain not in candidates]
    eliminated, doubtful = _assign_by_elimination(markers, candidates)
    unassigned = short_chains + [chain for chain in chains if chain.label < 0]
    if has_no_labels:
        unassigned += _remove_short_markers(markers)
    get_start = attrgetter("start")
    chains_of = {label: tuple(sorted(markers[label], key=get_start)) for label in sorted(markers)}
    return Naming(chains_of, tuple(eliminated), tuple(doubtful), tuple(unassigned))


def _collect_chains(
    tracklets: Tracklets, links: Links, time: Floats, is_named: list[bool], min_label_time: float
) -> list[Chain]:
    """Collect the tracklets of each chain, and choose the label of the chain."""
    column, length = tracklets.column, tracklets.stop - tracklets.start
    is_long = time[tracklets.stop - 1] - time[tracklets.start] >= min_label_time
    chains = []
    successor = links.successor.tolist()
    for first in sorted({*range(len(successor))} - {*successor}):
        indices = [first]
        while (following := successor[indices[-1]]) >= 0:
            indices.append(following)
        named_tracklets = [index for index in indices if is_named[column[index]]]
        candidates = [index for index in named_tracklets if is_long[index]]
        candidates = candidates or sorted(named_tracklets, key=lambda index: -length[index])
        label = int(column[candidates[0]]) if candidates else -1
        start, stop = int(tracklets.start[indices[0]]), int(tracklets.stop[indices[-1]])
        chains.append(Chain(tuple(indices), start, stop, int(length[indices].sum()), label))
    return chains


def _assign_by_label(
    chains: list[Chain], copies: list[Chain]
) -> tuple[dict[int, list[Chain]], list[Chain]]:
    """Assign chains by label; reject copies, and chains that overlap longer ones."""
    markers: dict[int, list[Chain]] = {}
    rejected_chains: list[Chain] = []
    labelled_chains = [chain for chain in chains if chain.label >= 0]
    for chain in sorted(labelled_chains, key=lambda chain: (-chain.frames, chain.start)):
        assigned = markers.setdefault(chain.label, [])
        is_rejected = any(map(chain.overlaps, assigned)) or (assigned and chain in copies)
        (rejected_chains if is_rejected else assigned).append(chain)
    return markers, rejected_chains


def _is_copy(chain: Chain, tracklets: Tracklets, relative: Floats, min_distance: float) -> bool:
    """Return whether the chain begins at the position of another track."""
    column = tracklets.column[chain.tracklets[0]]
    distance = np.linalg.norm(relative[chain.start] - relative[chain.start, column], axis=1)
    distance[column] = np.nan
    return bool((distance < min_distance).any())


def _assign_by_elimination(
    markers: dict[int, list[Chain]], rejected_chains: list[Chain]
) -> tuple[list[tuple[int, Chain]], list[Chain]]:
    """Assign rejected chains to the only missing marker, unless two chains compete for it."""
    eliminated: list[tuple[int, Chain]] = []
    doubtful: list[Chain] = []
    for chain in sorted(rejected_chains, key=attrgetter("start")):
        free_labels = [x for x, chains in markers.items() if not any(map(chain.overlaps, chains))]
        rivals = [x for x in rejected_chains if x is not chain and chain.overlaps(x)]
        if len(free_labels) == 1 and not rivals:
            markers[free_labels[0]].append(chain)
            eliminated.append((free_labels[0], chain))
        else:
            doubtful.append(chain)
    return eliminated, doubtful


def _remove_short_markers(markers: dict[int, list[Chain]]) -> list[Chain]:
    """Remove markers with less than half the frames of the longest marker; return their chains."""
    totals = {label: sum(chain.frames for chain in chains) for label, chains in markers.items()}
    longest = max(totals.values(), default=0)
    short_labels = [label for label, frames in totals.items() if 2 * frames < longest]
    return [chain for label in short_labels for chain in markers.pop(label)]
