"""Cut marker tracks into tracklets: stretches that certainly belong to one marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Tracklets:
    """Unbroken stretches of tracks, sorted by their first frame.

    Parameters
    ----------
    column : shape (n,), the track that holds it
    start, stop : shape (n,), frames, `stop` left out
    """

    column: Ints
    start: Ints
    stop: Ints

    def __len__(self) -> int:
        return len(self.column)


def in_sight(positions: Floats) -> Flags:
    """Which points have a position; shape (..., 3) of floats to shape (...) of flags."""
    x, y, z = (np.isfinite(positions[..., axis]) for axis in range(3))  # .all() is 15 x slower
    return np.asarray(x & y & z, dtype=np.bool_)


def frame_period(time: Floats) -> float:
    """Time from one frame to the next, s: the median, so that holes in a cut take do not count."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 1.0


def frozen_samples(
    positions: Floats, time: Floats, *, frozen: float, reference: Floats | None = None
) -> Flags:
    """Mark samples that repeat the last pose while other points move.

    Some exports hold the last position of a lost point instead of leaving it blank.

    Parameters
    ----------
    positions : shape (frames, points, 3), m, as exported
    time : shape (frames,), s
    frozen : s, shortest run of identical positions that counts
    reference : shape (frames, 3), m, one more point that shows movement, such as the clamp

    Returns
    -------
    shape (frames, points); True where the sample is stale. The first sample of a run was measured
    and is not marked.

    Notes
    -----
    A run counts if another point changed in at least half of its steps. NaN is never equal, so a
    blank ends a run.
    """
    stale = np.zeros(positions.shape[:2], dtype=np.bool_)
    if len(positions) < 2:
        return stale
    everything = (
        positions if reference is None else np.concatenate([positions, reference[:, None]], axis=1)
    )
    steps = np.diff(everything, axis=0)
    same = np.asarray((steps == 0).all(axis=2), dtype=np.bool_)
    movers = (np.abs(steps) > 0).any(axis=2).sum(axis=1)
    edges = np.diff(np.pad(same[:, : positions.shape[1]].T.astype(np.int8), ((0, 0), (1, 1))))
    points, first = np.nonzero(edges == 1)
    last = np.nonzero(edges == -1)[1]
    busy = np.r_[0, np.cumsum(movers > 0)]
    counts = (time[last] - time[first] >= frozen * (1 - 1e-9)) & (
        2 * (busy[last] - busy[first]) >= last - first
    )
    for point, begin, end in zip(points[counts], first[counts], last[counts], strict=True):
        stale[begin + 1 : end + 1, point] = True
    return stale


def cut_tracklets(
    positions: Floats, relative: Floats, time: Floats, *, max_jump: float
) -> Tracklets:
    """Cut every track at blanks, at jumps, and where two tracks exchange their points.

    Parameters
    ----------
    positions : shape (frames, tracks, 3), m, as measured; NaN where not seen
    relative : shape (frames, tracks, 3), m, the same relative to the clamp
    time : shape (frames,), s
    max_jump : m, longest step from one frame to the next that is motion. A step is a jump only if
        it is too long both as measured and relative to the clamp, so neither fast travel of the
        whole rig nor a slip of the clamp's own pose cuts anything.

    Returns
    -------
    The tracklets.
    """
    seen = in_sight(positions)
    joined = seen[1:] & seen[:-1]
    joined &= ~_jumps(positions, relative, time, max_jump)
    before = np.pad(joined, ((1, 0), (0, 0)))
    after = np.pad(joined, ((0, 1), (0, 0)))
    column, start = np.nonzero((seen & ~before).T)
    stop = np.nonzero((seen & ~after).T)[1] + 1
    order = np.lexsort((column, start))
    return Tracklets(
        column[order].astype(np.int64), start[order].astype(np.int64), stop[order].astype(np.int64)
    )


def _jumps(positions: Floats, relative: Floats, time: Floats, max_jump: float) -> Flags:
    steps = np.maximum(1.0, np.diff(time) / frame_period(time))
    moved = np.minimum(_squared_steps(positions), _squared_steps(relative))
    jumps: Flags = np.asarray(moved > (max_jump * steps[:, None]) ** 2, dtype=np.bool_)
    # Two neighbours closer than max_jump can exchange labels without a jump.
    suspects = np.flatnonzero((moved > (max_jump / 4) ** 2).sum(axis=1) > 1)
    jumps[suspects] |= _exchanges(relative[suspects], relative[suspects + 1])
    return jumps


def _squared_steps(positions: Floats) -> Floats:
    steps = np.diff(positions, axis=0)
    return np.asarray(np.einsum("fmi,fmi->fm", steps, steps), dtype=np.float64)


def _exchanges(earlier: Floats, later: Floats) -> Flags:
    """Tracks that change places with another one from `earlier` to `later`."""
    apart = np.linalg.norm(later[:, :, None] - earlier[:, None], axis=3)
    own = np.einsum("fii->fi", apart)
    nearer = apart < own[:, :, None]
    return np.asarray((nearer & nearer.transpose(0, 2, 1)).any(axis=2), dtype=np.bool_)
