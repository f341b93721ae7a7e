"""Whether a record begins when the specimen is loaded already, and what that touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.pipeline.bench import Bench, at_times_of_curve
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch
from labpipe.records.estimates import Estimate
from labpipe.signal.turning_points import noise_level

_NEAR = 0.05
"""Share of the travel over which the first slope is read."""
_FEWEST = 4
"""Samples that it is read from at least."""
_LOADED = 0.02, 0.01
"""Shares of the ranges of force and displacement that are no offsets if they go together."""
_TOGETHER = 3.0
"""Times by which the first slope may say otherwise how far they go together."""
_SURELY = 0.1
"""Share of the range of the force that is no offset, whatever the displacement says."""
_SURE = 5.0
"""Standard deviations of its noise by which the first force is not zero."""
_SAME = 0.5
"""Share of the first force by which the force at a lower turn is another one."""
_CODE = "begins_under_load"


@dataclass(frozen=True, slots=True)
class _Record:
    """What was measured, as exported, in the sense of loading, on the clock of the curve."""

    time: Floats
    force: Floats
    path: Floats

    @property
    def force_range(self) -> float:
        return float(np.ptp(self.force))


def check_begin(bench: Bench, branches: tuple[Branch, ...]) -> None:
    """Doubt what the first rows of a record would have told, where they are missing.

    Parameters
    ----------
    bench : with a curve; knows what zeros took off. Gets doubts of what was zeroed by a line
        through the first rows, and of the work done before (quantity ``start``)
    branches : of the motion

    Notes
    -----
    A record that begins at rest is left alone: its load cell may well have an offset. So is a test
    in cycles that come back to the load that it began with.
    """
    record = _record(bench, branches) if branches and not bench.blocked else None
    if record is None:
        return
    apart = float(record.time[-1] - record.time[0]) / len(record.time)
    if branches[0].start_time - float(record.time[0]) > 3.0 * apart:
        return  # it rests
    during = (float(record.time[0]), max(float(record.time[0]), branches[0].start_time))
    first = (record.time >= branches[0].start_time) & (record.time <= branches[0].stop_time)
    force = float(record.force[first][0])
    share = force / record.force_range
    if not force > _SURE * noise_level(record.force):
        return
    if share > 0.5 and float(record.force[first][-1]) < 0.5 * force:
        _doubt_unloading(bench, force)
        return
    if _comes_back(record, branches, force):
        return
    slope = _first_slope(record.path[first], record.force[first], record.path)
    path, travel = float(record.path[0]), float(np.ptp(record.path))
    together = force / _TOGETHER <= slope * path <= _TOGETHER * force
    is_loaded = share >= _LOADED[0] and path >= _LOADED[1] * travel and together
    if is_loaded or share >= _SURELY:
        _doubt(bench, force, share, path, during)


def _record(bench: Bench, branches: tuple[Branch, ...]) -> _Record | None:
    time = bench.raw[bench.displacement].time
    force, path = (
        at_times_of_curve(bench, bench.raw[name], time) + bench.taken_off.get(name, 0.0)
        for name in (bench.force, bench.displacement)
    )
    known = np.isfinite(force) & np.isfinite(path)
    time, force, path = time[known], force[known], path[known]
    first = (time >= branches[0].start_time) & (time <= branches[0].stop_time)
    if first.sum() < _FEWEST or not np.ptp(force) > 0.0 or not np.ptp(path) > 0.0:
        return None
    up = float(np.sign(path[first][-1] - path[first][0])) or 1.0
    sense = float(np.sign(force[int(np.argmax(np.abs(force)))]))
    return _Record(time, sense * force, up * path)


def _first_slope(path: Floats, force: Floats, whole: Floats) -> float:
    """Slope of a straight line through the begin of a branch, N/m."""
    near = np.abs(path - path[0]) <= _NEAR * float(np.ptp(whole))
    size = max(_FEWEST, len(near) if near.all() else int(np.argmin(near)))
    d, f = path[:size] - path[:size].mean(), force[:size]
    return float(d @ f) / max(float(d @ d), 1e-300)


def _comes_back(record: _Record, branches: tuple[Branch, ...], begin: float) -> bool:
    """Whether all unloadings end at about the force that the record begins with."""
    ends = [branch.stop_time for branch in branches[1::2]]
    forces = np.interp(ends, record.time, record.force)
    return len(ends) > 0 and bool((np.abs(forces - begin) <= _SAME * begin).all())


def _doubt_unloading(bench: Bench, force: float) -> None:
    message = (
        f"the record begins at {force:.4g} N, and the force falls over its first stroke: it begins "
        "under load, with an unloading, so that cycles are counted from the wrong turn"
    )
    for quantity in ("force", "displacement", "start"):
        bench.doubt(quantity, _CODE, message, where=bench.force)


def _doubt(
    bench: Bench, force: float, share: float, path: float, during: tuple[float, float]
) -> None:
    lined = [name for name in (bench.force, bench.displacement) if name in bench.lined]
    # A line through the linear region finds zero force again, if that of the force is right.
    found = isinstance(bench.slack, Estimate) and bench.force not in lined
    message = (
        f"the record begins under load and in motion: {force:.4g} N, {1e2 * share:.2g} % of its "
        f"range, at {1e3 * path:.4g} mm in the first sample"
    )
    message += f"; {' and '.join(lined)} zeroed there" if lined else ""
    bench.doubt("start", _CODE, message, where=bench.force, during=during)
    if bench.force in lined:
        bench.doubt("force", _CODE, message, where=bench.force)
    if bench.displacement in lined and not found:
        bench.doubt("displacement", _CODE, message, where=bench.force)
