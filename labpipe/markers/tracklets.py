"""Cut marker tracks into tracklets (unbroken stretches), and assign chains of them to markers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints, compute_median_step, find_runs

VELOCITY_FRAMES = 5
"""Largest number of steps over which the velocity at the end of a tracklet is computed."""
_LABEL_CHANGE_COST = 0.25
"""Cost of a change of label, as a fraction of `max_jump`."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracklets:
    """Unbroken stretches of tracks, sorted by their first frame.

    Parameters
    ----------
    column : shape (n,), index of the track of each tracklet
    start, stop : shape (n,), indices of the first frame, and of the first frame after the tracklet
    """

    column: Ints
    start: Ints
    stop: Ints

    def __len__(self) -> int:
        return len(self.column)


def is_in_sight(positions: Floats) -> Flags:
    """Return whether each position of shape (..., 3) is known, shape (...)."""
    # np.isfinite(positions).all(axis=-1) is 15 times slower.
    has_x, has_y, has_z = (np.isfinite(positions[..., axis]) for axis in range(3))
    return np.asarray(has_x & has_y & has_z, dtype=np.bool_)


def compute_frame_period(time: Floats) -> float:
    """Compute the median frame period, s; 1 s for a single frame."""
    return compute_median_step(time) if len(time) > 1 else 1.0


def find_frozen_samples(
    positions: Floats, time: Floats, *, min_frozen_time: float, reference: Floats | None = None
) -> Flags:
    """Find the samples that repeat the last position of a point while other points move.

    Some exports repeat the last position of a lost point instead of blank cells.

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
    The samples of a run are frozen if another point moves in at least half of the steps of the run.
    A NaN ends a run.
    """
    is_frozen = np.zeros(positions.shape[:2], dtype=np.bool_)
    if len(positions) < 2:
        return is_frozen
    steps = np.diff(positions, axis=0)
    is_moving = (np.abs(steps) > 0).any(axis=(1, 2))
    if reference is not None:
        is_moving |= (np.abs(np.diff(reference, axis=0)) > 0).any(axis=1)
    n_moving_steps = np.r_[0, np.cumsum(is_moving)]
    for point, is_repeated in enumerate(np.asarray((steps == 0).all(axis=2)).T):
        for first, last in find_runs(is_repeated):
            is_long = time[last] - time[first] >= min_frozen_time * (1 - 1e-9)
            if is_long and 2 * (n_moving_steps[last] - n_moving_steps[first]) >= last - first:
                is_frozen[first + 1 : last + 1, point] = True
    return is_frozen


def cut_tracklets(
    positions: Floats, relative: Floats, time: Floats, *, max_jump: float
) -> Tracklets:
    """Cut every track at gaps, at jumps, and where it steps to the place of another marker.

    Parameters
    ----------
    positions : shape (frames, tracks, 3), m, measured positions; NaN where missing
    relative : shape (frames, tracks, 3), m, positions relative to the clamp
    time : shape (frames,), s
    max_jump : longest step per frame period that is motion, m. A step is a jump only if it is
        longer both as measured and relative to the clamp. Neither fast travel of the whole rig nor
        an error of the pose of the clamp therefore cuts tracks

    Returns
    -------
    The tracklets.

    Raises
    ------
    ValueError
        If there are thousands of tracklets with fewer than ten samples on average. Such tracklets
        are noise, and computing the possible links would need too much time and memory.
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
        facts = {"count": len(start), "samples": mean_samples, "jump": 1e3 * max_jump}
        raise ValueError(format_sentence("markers.tracks_in_pieces", **facts))
    order = np.lexsort((column, start))
    return Tracklets(*(values[order].astype(np.int64) for values in (column, start, stop)))


def _find_jumps(positions: Floats, relative: Floats, time: Floats, max_jump: float) -> Flags:
    """Find the steps that are jumps or changes of label, shape (frames - 1, tracks)."""
    min_step = 0.25 * max_jump  # m, shortest step at a change of label
    n_periods = np.maximum(1.0, np.diff(time) / compute_frame_period(time))
    squared_steps = np.minimum(_compute_squared_steps(positions), _compute_squared_steps(relative))
    is_jump: Flags = np.asarray(squared_steps > (max_jump * n_periods[:, None]) ** 2, np.bool_)
    # Markers closer than max_jump can change labels without a jump: a track steps to the place of
    # another marker, whose track steps away or ends.
    has_stepped, has_left = squared_steps > min_step**2, ~(squared_steps <= min_step**2)
    frames = np.flatnonzero(has_stepped.any(axis=1))
    offsets = relative[frames + 1][:, :, None] - relative[frames][:, None]
    distances = np.linalg.norm(offsets, axis=3)
    is_nearer = distances < np.einsum("fii->fi", distances)[:, :, None]
    is_jump[frames] |= (is_nearer & has_left[frames, None]).any(axis=2) & has_stepped[frames]
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
    successor : shape (tracklets,), index of the next tracklet of the chain; -1 at the end of a
        chain
    ambiguous_pairs : indices of both tracklets of each possible link that competes with a link of
        similar distance; such a link changes no label
    """

    successor: Ints
    ambiguous_pairs: tuple[tuple[int, int], ...]


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
    """Link the ends of tracklets to the starts of other tracklets near the expected position.

    Parameters
    ----------
    tracklets : tracklets, sorted by their first frame
    relative : shape (frames, tracks, 3), m, positions relative to the clamp
    time : shape (frames,), s
    max_gap : longest time without a sample between linked tracklets, s
    max_jump : largest distance of a start from the expected position, m. For the same label, it is
        multiplied by the square root of the gap in frame periods

    Returns
    -------
    The links.

    Notes
    -----
    The expected position is the last position or its extrapolation with the mean of both
    velocities, whichever is nearer to the start. In each group of competing ends and starts, the
    assignment with the smallest total cost is used. The cost is the distance, plus a quarter of
    `max_jump` for a change of label. A change of label is rejected if the distance of a rival (a
    simultaneous tracklet) is not larger by this quarter of `max_jump`.
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
    ambiguous_pairs = tuple(
        (int(pairs.end[index]), int(pairs.start[index if changes_label[index] else rival]))
        for index, rival in rivals_of_pairs.items()
    )
    return Links(successor, ambiguous_pairs)


def _find_candidates(
    tracklets: Tracklets, relative: Floats, time: Floats, *, max_gap: float, max_jump: float
) -> _Pairs:
    """Find the pairs of tracklets that may be linked, as `link_tracklets` states."""
    period = compute_frame_period(time)
    start_times, end_times = time[tracklets.start], time[tracklets.stop - 1]
    first = np.searchsorted(start_times, end_times, side="right")
    # A tenth of a period is the tolerance for uneven frame times.
    stop = np.searchsorted(start_times, end_times + max_gap + 1.1 * period, side="right")
    counts = np.maximum(stop - first, 0)  # number of possible successors, from `first` on
    end = np.repeat(np.arange(len(tracklets)), counts)
    start = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first[end]
    gap = start_times[start] - end_times[end]
    distance = _compute_distances(tracklets, relative, time, end, start)
    changes_label = tracklets.column[end] != tracklets.column[start]
    n_periods = np.where(changes_label, 1.0, np.maximum(1.0, gap / period))
    cost = np.minimum(distance, 0.999 * max_jump) + _LABEL_CHANGE_COST * max_jump * changes_label
    is_near = distance <= max_jump * np.sqrt(n_periods)
    return _Pairs(end[is_near], start[is_near], distance[is_near], cost[is_near])


def _compute_distances(
    tracklets: Tracklets, relative: Floats, time: Floats, end: Ints, start: Ints
) -> Floats:
    """Compute the distance of each start from the expected position, shape (pairs,), m.

    The tracklets with the indices `end` end before the tracklets with the indices `start` start.
    """
    column, first, last = tracklets.column, tracklets.start, tracklets.stop - 1
    inside_end = np.maximum(first, last - VELOCITY_FRAMES)
    inside_start = np.minimum(last, first + VELOCITY_FRAMES)
    end_velocity = compute_velocity(time, relative, (inside_end, column), (last, column))
    start_velocity = compute_velocity(time, relative, (first, column), (inside_start, column))
    gap = relative[first[start], column[start]] - relative[last[end], column[end]]
    duration = (time[first[start]] - time[last[end]])[:, None]
    extrapolated_gap = gap - duration * (end_velocity[end] + start_velocity[start]) / 2
    distance = np.minimum(np.linalg.norm(gap, axis=1), np.linalg.norm(extrapolated_gap, axis=1))
    return np.asarray(distance, dtype=np.float64)


def compute_velocity(
    time: Floats, positions: Floats, start: tuple[Ints, ...], stop: tuple[Ints, ...]
) -> Floats:
    """Compute mean velocities between two frames, m/s; 0 if both are the same frame.

    Parameters
    ----------
    time : shape (frames,), s
    positions : shape (frames, ..., 3), m
    start, stop : indices of `positions`; the first ones are those of the frames, shape (n,)

    Returns
    -------
    Shape (n, 3), m/s.
    """
    duration = np.where(stop[0] > start[0], time[stop[0]] - time[start[0]], 1.0)
    return np.asarray((positions[stop] - positions[start]) / duration[:, None], dtype=np.float64)


def _choose_pairs(pairs: _Pairs, *, unlinked_cost: float) -> list[int]:
    """Choose the pairs of the assignment with the smallest total cost; return their indices."""
    if all(len(np.unique(side)) == len(side) for side in (pairs.end, pairs.start)):
        return list(np.argsort(pairs.end).tolist())  # no pair competes with another
    from scipy.sparse import coo_array  # slow import, not needed by tensile tests
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    ends, row = np.unique(pairs.end, return_inverse=True)
    starts, column = np.unique(pairs.start, return_inverse=True)
    # Each end may also be matched with a column of its own, and is then unlinked. The same amount
    # is added to all weights, because an edge cannot have the weight 0.
    unlinked_row = np.arange(len(ends))
    weights = unlinked_cost + np.append(pairs.cost, np.full(len(ends), unlinked_cost))
    cells = np.append(row, unlinked_row), np.append(column, len(starts) + unlinked_row)
    graph = coo_array((weights, cells), shape=(len(ends), len(starts) + len(ends))).tocsr()
    pair_by_cell = {x: i for i, x in enumerate(zip(row.tolist(), column.tolist(), strict=True))}
    matches = zip(*(x.tolist() for x in min_weight_full_bipartite_matching(graph)), strict=True)
    return [pair_by_cell[cell] for cell in matches if cell in pair_by_cell]


def _find_rivals(
    pairs: _Pairs, chosen_pairs: list[int], tracklets: Tracklets, margin: float
) -> Iterable[tuple[int, int]]:
    """Find rivals of similar distance: yield the index of each chosen pair and of its rival.

    A chosen pair without a rival is omitted. A distance is similar within the margin, m, if the
    chosen pair changes the label, and otherwise if it is smaller.
    """
    column, first, stop = tracklets.column, tracklets.start, tracklets.stop
    pairs_by_end, pairs_by_start = _group_by_value(pairs.end), _group_by_value(pairs.start)
    for index in chosen_pairs:
        end, start = int(pairs.end[index]), int(pairs.start[index])
        changes_label = column[end] != column[start]
        max_distance = pairs.distance[index] + (margin if changes_label else 0.0)
        for rival in pairs_by_end[end] + pairs_by_start[start]:
            rival_end, rival_start = int(pairs.end[rival]), int(pairs.start[rival])
            # Two tracklets with a common frame are different points.
            competes = any(
                a != b and max(first[a], first[b]) < min(stop[a], stop[b])
                for a, b in ((start, rival_start), (end, rival_end))
            )
            is_relevant = changes_label or column[rival_end] != column[rival_start]
            if rival != index and competes and is_relevant and pairs.distance[rival] < max_distance:
                yield index, rival
                break


def _group_by_value(values: Ints) -> dict[int, list[int]]:
    """Group the indices of equal values, keyed by value."""
    indices_by_value: dict[int, list[int]] = {}
    for index, value in enumerate(values.tolist()):
        indices_by_value.setdefault(value, []).append(index)
    return indices_by_value


_UNLABELLED = re.compile(r"(?i:(.*:)?unlabell?ed.*)|Marker-\d+")
"""Pattern of the names of unlabelled tracks, such as ``Unlabeled 2379`` (Motive table style 1.23),
``Unlabeled:108`` (1.21), and ``Marker-1718`` (row style 1.1)."""


@dataclass(frozen=True, slots=True)
class Chain:
    """Linked tracklets of one point, in order of time.

    Parameters
    ----------
    tracklets : indices of the tracklets
    start, stop : indices of the first frame, and of the first frame after the chain
    n_frames : number of frames with a position
    label : index of the track whose marker the labels state; -1 if the chain has no label
    """

    tracklets: tuple[int, ...]
    start: int
    stop: int
    n_frames: int
    label: int

    def overlaps(self, other: Chain) -> bool:
        """Return whether the chains have a common frame, so that they belong to two markers."""
        return max(self.start, other.start) < min(self.stop, other.stop)


@dataclass(frozen=True, slots=True)
class ChainAssignment:
    """Assignment of chains to markers.

    Parameters
    ----------
    markers : chains of each marker in order of time, keyed by label
    eliminations : label of the only missing marker, and the chain that was assigned to this marker
        because its own label is that of another chain
    doubtful_chains : labelled chains that may belong to several markers, or to none
    unassigned_chains : chains of no marker
    """

    markers: dict[int, tuple[Chain, ...]]
    eliminations: tuple[tuple[int, Chain], ...]
    doubtful_chains: tuple[Chain, ...]
    unassigned_chains: tuple[Chain, ...]


def is_unlabelled(name: str) -> bool:
    """Return whether a track has only the automatic name of the motion-capture program."""
    return _UNLABELLED.fullmatch(name) is not None


def assign_chains(
    names: Sequence[str],
    tracklets: Tracklets,
    links: Links,
    *,
    relative: Floats,
    time: Floats,
    min_label_time: float,
    min_distance: float,
) -> ChainAssignment:
    """Assign chains to markers.

    Parameters
    ----------
    names : names of the tracks; the index of a track is the label of a marker
    tracklets, links : tracklets and their links to chains
    relative : shape (frames, tracks, 3), m, positions relative to the clamp
    time : shape (frames,), s
    min_label_time : shortest duration of a valid label, s; a shorter label is an error
    min_distance : smallest distance between two markers, m; a closer track is a copy

    Returns
    -------
    The assignment of the chains.

    Notes
    -----
    A chain belongs to the marker of the first label that lasts at least `min_label_time`, since
    labels are assigned at the start of a take and become wrong later. Without such a label, the
    chain belongs to the marker of the longest label. If two simultaneous chains have the same
    label, the chain with more frames keeps the label. If the other chain lasts at least
    `min_label_time`, and exactly one marker is missing during that time, it is assigned to this
    marker. A chain that begins at the position of another track is a copy, which is used only if
    no longer chain has the same label. In a take without labels, the markers are the tracks with at
    least half the frames of the longest track.
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
    unassigned = [chain for chain in rejected_chains if chain not in candidates]
    eliminations, doubtful_chains = _assign_by_elimination(markers, candidates)
    unassigned += [chain for chain in chains if chain.label < 0]
    if has_no_labels:
        unassigned += _remove_short_markers(markers)
    get_start = attrgetter("start")
    by_label = {label: tuple(sorted(markers[label], key=get_start)) for label in sorted(markers)}
    return ChainAssignment(by_label, tuple(eliminations), tuple(doubtful_chains), tuple(unassigned))


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
        while (next_index := successor[indices[-1]]) >= 0:
            indices.append(next_index)
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
    for chain in sorted(labelled_chains, key=lambda chain: (-chain.n_frames, chain.start)):
        marker_chains = markers.setdefault(chain.label, [])
        is_rejected = any(map(chain.overlaps, marker_chains)) or (marker_chains and chain in copies)
        (rejected_chains if is_rejected else marker_chains).append(chain)
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
    """Assign rejected chains to the only missing marker, unless two chains compete for it.

    Return the label of this marker with each assigned chain, and the other chains.
    """
    eliminations: list[tuple[int, Chain]] = []
    doubtful_chains: list[Chain] = []
    for chain in sorted(rejected_chains, key=attrgetter("start")):
        free_labels = [x for x, chains in markers.items() if not any(map(chain.overlaps, chains))]
        rivals = [x for x in rejected_chains if x is not chain and chain.overlaps(x)]
        if len(free_labels) == 1 and not rivals:
            markers[free_labels[0]].append(chain)
            eliminations.append((free_labels[0], chain))
        else:
            doubtful_chains.append(chain)
    return eliminations, doubtful_chains


def _remove_short_markers(markers: dict[int, list[Chain]]) -> list[Chain]:
    """Remove markers with less than half the frames of the longest marker; return their chains."""
    n_frames = {label: sum(chain.n_frames for chain in chains) for label, chains in markers.items()}
    max_frames = max(n_frames.values(), default=0)
    short_labels = [label for label, count in n_frames.items() if 2 * count < max_frames]
    return [chain for label in short_labels for chain in markers.pop(label)]
