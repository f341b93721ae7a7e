"""Zeros: the level at rest they are taken from, whether they stay, and records that begin late."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.fits.loops import sense_of_loading
from labpipe.process.motion import Motion
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch, Curve, Direction, Interval
from labpipe.records.estimates import Failure
from labpipe.records.limits import LIMITS, Limits
from labpipe.records.quality import Finding, Findings, doubtful, info_note
from labpipe.records.signals import Clocks, Signals, Stretch
from labpipe.signal.rests_and_jumps import level_jumps, samples_at_rest
from labpipe.signal.turning_points import noise_level
from labpipe.uncertainty.autocorrelation import long_run_variance, smooth_stretches
from labpipe.uncertainty.linear_fits import fit_linear

LEAST = 8
"""Samples below which a stretch alone says nothing of its level."""
FEWEST = 3
"""Samples that do where the rest of the record says what the noise is like."""
SHORT = 100
"""Samples of a stretch below which the rest of the record says what its noise is like."""


_QUARTER = 25
"""Samples of the stretches that a record of fewer than `SHORT` is cut into."""


def needed(beside: Floats) -> int:
    """Samples that a stretch to zero on must hold.

    Parameters
    ----------
    beside : shape (m,), the rest of the record

    Notes
    -----
    Beside a hundred more samples, three are enough: with 3 to 6 of them the intervals of
    `mean_level` and `end_level` hold 94 to 96 of 100 true values, in white noise and in noise that
    remembers ten samples. Beside 25 they hold as many in noise that remembers up to two samples,
    and 73 in noise that remembers ten, which so short a record cannot tell from its curve.
    """
    return FEWEST if _cut(beside) else LEAST


def mean_level(values: Floats, beside: Floats) -> tuple[float, float]:
    """Mean of a stretch, with its standard error.

    Parameters
    ----------
    values : shape (n,), the stretch, evenly sampled, without NaN
    beside : shape (m,), the rest of the record: a stretch of a few samples cannot tell how far its
        noise remembers
    """
    stretches = _stretches(values, beside)
    if stretches:
        fit = fit_linear(np.ones((len(values), 1)), values, beside=stretches)
        half = float(fit.half_widths[0])
        return float(fit.coefficients[0]), Interval(-half, half).standard_error
    blocks = _blocks(values)
    error = float(np.sqrt(long_run_variance(blocks, parameters=1) / len(blocks)))
    return float(values.mean()), error


def end_level(values: Floats, beside: Floats) -> tuple[float, float]:
    """First value of a straight line through a stretch, with its standard error.

    Parameters
    ----------
    values, beside : as for `mean_level`
    """
    blocks = _blocks(values)
    size = len(values) // len(blocks)
    middles = np.arange(len(blocks)) + 0.5 * (size - 1) / size  # in blocks from the first sample
    design = np.column_stack([np.ones(len(blocks)), middles])
    fit = fit_linear(design, blocks, beside=_stretches(values, beside))
    # As wide as the t-based interval: a stretch for a zero holds few samples.
    interval = Interval(-float(fit.half_widths[0]), float(fit.half_widths[0]))
    return float(fit.coefficients[0]), interval.standard_error


def line_zero(values: Floats, beside: Floats) -> tuple[float, float, int]:
    """Level where a machine stood before it moved, from a stretch in which it moves.

    Parameters
    ----------
    values, beside : as for `mean_level`; the stretch begins at its outer end

    Returns
    -------
    level, error : of the outer end. Where the stretch begins with a rest, the mean over that; of a
        rest of too few samples, what a line through the motion says of its begin
    rested : samples of that rest; 0 where the motion begins with the stretch, or before
    """
    rested = samples_at_rest(values)
    if rested >= needed(beside):
        return *mean_level(values[:rested], np.concatenate([values[rested:], beside])), rested
    moving = values[rested:] if len(values) - rested >= LEAST else values
    return *end_level(moving, beside), 0


def _stretches(values: Floats, beside: Floats) -> Sequence[Floats]:
    return _cut(beside) if len(values) < SHORT else ()


def _cut(beside: Floats) -> Sequence[Floats]:
    return smooth_stretches(beside, width=SHORT if len(beside) >= SHORT else _QUARTER)


def _blocks(values: Floats) -> Floats:
    """Averages over at most 1000 blocks: as good for a mean, and quick to correlate."""
    size = max(1, len(values) // 1000)
    means: Floats = values[: len(values) // size * size].reshape(-1, size).mean(axis=1)
    return means


def use_rest_there_is(signals: Signals, motion: Motion) -> tuple[Signals, list[Finding]]:
    """Take zeros again whose stretch reaches into the motion: from its part at rest.

    Parameters
    ----------
    signals : zeroed
    motion : with clocks that are joined

    Returns
    -------
    The signals, shifted, and a note for each.

    Notes
    -----
    What is known of a zero from a shorter stretch is in its standard error. A part at rest of
    fewer than `LEAST` samples says nothing: then the zero stays, to be doubted.
    """
    found: list[Finding] = []
    branches = motion.branches
    for name, (start, stop) in signals.zeroed.items() if branches else ():
        begins, ends = (
            motion.clocks.from_curve(at, signals.raw[name].clock)
            for at in (branches[0].start_time, branches[-1].stop_time)
        )
        if start < begins < stop:
            rest = (start, begins)
        elif start < ends < stop:
            rest = (ends, stop)
        else:
            continue
        signals, more = _zero_again(signals, name, rest, wanted=stop - start)
        found += more
    return signals, found


def _zero_again(
    signals: Signals, name: str, rest: Stretch, *, wanted: float
) -> tuple[Signals, list[Finding]]:
    raw = signals.raw[name]
    inside = (raw.time >= rest[0]) & (raw.time <= rest[1])
    known = raw.values[inside & ~np.isnan(raw.values)]
    if len(known) < LEAST:
        return signals, []
    level, error = mean_level(known, raw.values[~inside])
    lasts = rest[1] - rest[0]
    message = (
        f"the machine rests for {lasts:.2f} s, less than the {wanted:g} s to zero on: the zero is "
        f"the mean over these {lasts:.2f} s"
    )
    signals = replace(
        signals.without_level(name, level, error), zeroed={**signals.zeroed, name: rest}
    )
    return signals, [info_note("short_rest", name, message)]


_MOST = 2
"""Jumps of a force; what jumps again and again is the specimen."""
_BREAKS = 0.3
"""Of the largest force: a fall in the step in which a displacement jumps as the specimen breaks."""
_TURN = 3
"""Samples beside a turn at which a steep fall belongs to the specimen."""
_RETURNED = 0.02
"""Share of the stroke within which the motion has come back to where it began."""
_SURE = 6.0
"""Standard errors below which a difference may be noise."""
_FEWEST = 3
"""Samples of a rest."""
_TAIL = 10
"""Samples behind a break that are more than a rebound."""


_REST_DUST = 1e-4
"""Share of the largest force: a force at rest that is nothing."""


def check_zeros(
    signals: Signals, clocks: Clocks, curve: Curve, findings: Findings, limits: Limits = LIMITS
) -> list[Finding]:
    """Doubt what follows a jump of force or displacement, and forces whose zero drifted.

    Parameters
    ----------
    signals, clocks : of the test
    curve : of unfiltered force
    findings : so far; a channel that stood still and goes on does not jump
    limits : of the lab
    """
    if not curve.branches:
        return []

    def thawed(quantity: str) -> list[float]:
        return [
            clocks.to_curve(doubt.during[1], doubt.clock)
            for doubt in findings.doubts
            if doubt.reason.code == "frozen_channel" and doubt.quantity == quantity and doubt.during
        ]

    found = list(_displacement_jump(signals.displacement, curve, thawed("displacement")))
    jump = list(_force_jump(signals.force, curve, thawed("force")))
    found += _rest_force(signals, curve, limits.rest_force)
    return [*found, *(jump or _drift(signals.force, curve, limits.rest_force_drift))]


def _rest_force(signals: Signals, curve: Curve, share: float) -> Iterator[Finding]:
    """State the force before the motion where no step takes it for zero."""
    name = signals.force
    before = _known(curve.force[: curve.branches[0].start])
    if name in signals.zeroed or name in signals.lined or len(before) < LEAST:
        return
    level, most = median(before), float(np.nanmax(np.abs(curve.force)))
    error = noise_level(curve.force) / sqrt(len(before))
    if abs(level) <= max(_SURE * error, _REST_DUST * most):
        return
    message = (
        f"at rest before the motion the force is {level:.4g} N, {abs(level) / most:.2%} of the "
        "largest, and no step takes it for zero: a preload, or the zero of the load cell? If it "
        "is the zero, add the step {step: zero, channel: force, over: 1 s}"
    )
    if abs(level) > max(share, 2.0 * signals.raw[name].zero_drift) * most:
        yield doubtful("rest_force", name, message, "force")
    else:
        yield info_note("rest_force", name, message)


def _displacement_jump(where: str, curve: Curve, thawed: list[float]) -> Iterator[Finding]:
    """A machine moves steadily: what jumps is its zero, its encoder, the record, or a break."""
    largest = float(np.nanmax(np.abs(curve.force)))
    jumps = _jumps(curve, curve.displacement, thawed)
    falls = [abs(curve.force[sample - 1]) - abs(curve.force[sample]) for sample, _ in jumps]
    if not jumps or (len(jumps) == 1 and falls[0] > _BREAKS * largest):
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    often = "" if len(jumps) == 1 else f", the largest of {len(jumps)} jumps"
    message = (
        f"the displacement jumps by {1e3 * size:.4g} mm from one sample to the next at "
        f"{_at(curve, sample)}{often}: zeroed, wrapped round or lost in mid-record? Branches may "
        "not be where they seem to be; export the test without what came before"
    )
    yield doubtful("zero_jump", where, message, "displacement", "force")


def _force_jump(where: str, curve: Curve, thawed: list[float]) -> Iterator[Finding]:
    """A force that jumps as no specimen lets it; what falls in loading may be a slip."""
    first = curve.branches[0]
    sense = sense_of_loading(curve.force[first.start : first.stop])
    jumps = _jumps(curve, curve.force, thawed)
    found = [jump for jump in jumps if not _is_of_the_specimen(curve, jump[0], sense * jump[1])]
    if len(jumps) > _MOST or not found:
        return
    sample, size = found[0]
    message = (
        f"the force jumps by {size:.4g} N from one sample to the next at {_at(curve, sample)}, as "
        "a zero does and no specimen: look at the cable and at the tare of the load cell"
    )
    during = (float(curve.time[sample]), float(curve.time[-1]))
    yield doubtful("zero_jump", where, message, "force", during=during)


def _jumps(curve: Curve, values: Floats, thawed: list[float]) -> tuple[tuple[int, float], ...]:
    """Jumps of a level that do not end a stretch in which the channel stood still."""
    return tuple(
        (sample, size)
        for sample, size in level_jumps(curve.time, values)
        if not any(curve.time[sample - 1] <= end <= curve.time[sample] for end in thawed)
    )


def _is_of_the_specimen(curve: Curve, sample: int, grows: float) -> bool:
    """Whether a step may be a break, a slip, or what follows a turn at once."""
    near = [at for branch in curve.branches for at in (branch.start, branch.stop)]
    if any(abs(sample - at) <= _TURN for at in near):
        return True
    inside = [branch for branch in curve.branches if branch.start <= sample < branch.stop]
    is_loading = bool(inside) and inside[0].direction is Direction.LOADING
    held = _held_after_loading(curve, sample)
    return grows < 0.0 and (is_loading or held)


def _held_after_loading(curve: Curve, sample: int) -> bool:
    """Whether the specimen is held at the end of a loading: it may break there as well."""
    before = [branch for branch in curve.branches if branch.stop <= sample]
    resting = all(not branch.start <= sample < branch.stop for branch in curve.branches)
    return bool(before) and resting and before[-1].direction is Direction.LOADING


def _drift(where: str, curve: Curve, share: float) -> Iterator[Finding]:
    """Compare the force at rest before and after.

    A specimen with friction, or one that stays longer, pushes back when it is home again: a force
    against the sense of loading is a drift if it grows from cycle to cycle, too.
    """
    first, last = curve.branches[0], curve.branches[-1]
    before, after = _known(curve.force[: first.start]), _known(curve.force[last.stop :])
    if not _came_back(curve, first, last) or min(len(before), len(after)) < _FEWEST:
        return
    level = median(before)
    change = median(after[-len(before) :]) - level  # the end of a long rest: a specimen relaxes
    part = curve.force[first.start : last.stop]
    most = float(np.nanmax(np.abs(part - level)))
    error = noise_level(curve.force) * sqrt(1.0 / len(before) + 1.0 / len(after))
    limit, sense = max(share * most, _SURE * error), sense_of_loading(part)
    if abs(change) < limit or (sense * change < 0.0 and not _grows(curve, limit)):
        return
    message = (
        f"at rest the force is {level:.4g} N before the test and {level + change:.4g} N after it, "
        f"{abs(change) / most:.0%} of the largest force apart: the zero drifted, or the specimen "
        "is held under load"
    )
    yield doubtful("zero_drift", where, message, "force")


def check_break(
    where: str, curve: Curve, failure: FailurePoint | Failure | None, limits: Limits = LIMITS
) -> Iterator[Finding]:
    """Doubt a force that stands below zero once the specimen is broken.

    Parameters
    ----------
    where : name of the force
    curve, failure : of the test. What is left of a specimen may still pull a little, so that a
        force above zero is left alone, and so is a rebound of a few samples
    limits : of the lab
    """
    if not isinstance(failure, FailurePoint):
        return
    after = _known(curve.force[failure.sample + 1 :])
    sense = sense_of_loading(curve.force[: failure.sample + 1])
    if len(after) < _TAIL:
        return
    level, most = sense * median(after[len(after) // 2 :]), float(np.nanmax(np.abs(curve.force)))
    error = noise_level(curve.force) * sqrt(2.0 / len(after))
    if level > -max(limits.rest_force_drift * most, _SURE * error):
        return
    message = (
        f"the force stands at {sense * level:.4g} N once the specimen is broken, "
        f"{-level / most:.0%} of its peak below zero: its zero was taken under load, or drifted"
    )
    yield doubtful("zero_drift", where, message, "force")


def _grows(curve: Curve, limit: float) -> bool:
    """Whether the force at the end of unloading changes from the first cycle to the last."""
    ends = [branch.stop for branch in curve.branches if branch.direction is Direction.UNLOADING]
    levels = [
        _known(curve.force[max(end - _FEWEST, 0) : end + _FEWEST]) for end in (ends[0], ends[-1])
    ]
    if not all(len(level) for level in levels):
        return False
    # The median of few samples scatters 1.25 times as much as their mean.
    error = 1.25 * noise_level(curve.force) * sqrt(sum(1.0 / len(level) for level in levels))
    return abs(median(levels[1]) - median(levels[0])) > max(limit, _SURE * error)


def _came_back(curve: Curve, first: Branch, last: Branch) -> bool:
    """Whether the test ends with an unloading, and where it began."""
    if last.direction is not Direction.UNLOADING:
        return False
    began, ended = curve.displacement[first.start], curve.displacement[last.stop - 1]
    return bool(abs(ended - began) <= _RETURNED * float(np.ptp(_known(curve.displacement))))


def _known(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _at(curve: Curve, sample: int) -> str:
    return f"{curve.time[sample]:.3f} s" if curve.time_unit == "s" else f"sample {sample + 1}"


_NEAR = 0.05
"""Share of the travel over which the first slope is read."""
_FEWEST_ROWS = 4
"""Samples that it is read from at least."""
_LOADED = 0.02, 0.01
"""Shares of the ranges of force and displacement that are no offsets if they go together."""
_TOGETHER = 3.0
"""Times by which the first slope may say otherwise how far they go together."""
_SURELY = 0.1
"""Share of the range of the force that is no offset, whatever the displacement says."""
_SURE_OF_LOAD = 5.0
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


def check_begin(signals: Signals, motion: Motion, *, has_slack: bool) -> Iterator[Finding]:
    """Doubt what the first rows of a record would have said, where they are missing.

    Parameters
    ----------
    signals : of the test, with what zeros took off
    motion : with clocks that are joined
    has_slack : whether the displacement counts from where a line meets zero force

    Returns
    -------
    Doubts of what was zeroed by a line through the first rows, and of the work done before
    (quantity ``start``).

    Notes
    -----
    A record that begins at rest is left alone: its load cell may well have an offset. So is a test
    in cycles that come back to the load that it began with.
    """
    branches = motion.branches
    record = _record(signals, motion.clocks, branches) if branches else None
    if record is None:
        return
    apart = float(record.time[-1] - record.time[0]) / len(record.time)
    if branches[0].start_time - float(record.time[0]) > 3.0 * apart:
        return  # it rests
    during = (float(record.time[0]), max(float(record.time[0]), branches[0].start_time))
    first = (record.time >= branches[0].start_time) & (record.time <= branches[0].stop_time)
    force = float(record.force[first][0])
    share = force / float(np.ptp(record.force))
    if not force > _SURE_OF_LOAD * noise_level(record.force):
        return
    if share > 0.5 and float(record.force[first][-1]) < 0.5 * force:
        message = (
            f"the record begins at {force:.4g} N, and the force falls over its first stroke: it "
            "begins under load, with an unloading, so that cycles are counted from the wrong turn"
        )
        yield doubtful(_CODE, signals.force, message, "force", "displacement", "start")
        return
    if _comes_back(record, branches, force):
        return
    slope = _first_slope(record.path[first], record.force[first], record.path)
    path, travel = float(record.path[0]), float(np.ptp(record.path))
    together = force / _TOGETHER <= slope * path <= _TOGETHER * force
    is_loaded = share >= _LOADED[0] and path >= _LOADED[1] * travel and together
    if is_loaded or share >= _SURELY:
        yield from _loaded(signals, (force, share, path), during, has_slack=has_slack)


def _record(signals: Signals, clocks: Clocks, branches: tuple[Branch, ...]) -> _Record | None:
    time = signals.raw[signals.displacement].time
    force, path = (
        clocks.sampled(signals.raw[name], time) + signals.taken_off.get(name, 0.0)
        for name in (signals.force, signals.displacement)
    )
    known = np.isfinite(force) & np.isfinite(path)
    time, force, path = time[known], force[known], path[known]
    first = (time >= branches[0].start_time) & (time <= branches[0].stop_time)
    if first.sum() < _FEWEST_ROWS or not np.ptp(force) > 0.0 or not np.ptp(path) > 0.0:
        return None
    up = float(np.sign(path[first][-1] - path[first][0])) or 1.0
    sense = float(np.sign(force[int(np.argmax(np.abs(force)))]))
    return _Record(time, sense * force, up * path)


def _first_slope(path: Floats, force: Floats, whole: Floats) -> float:
    """Slope of a straight line through the begin of a branch, N/m."""
    near = np.abs(path - path[0]) <= _NEAR * float(np.ptp(whole))
    size = max(_FEWEST_ROWS, len(near) if near.all() else int(np.argmin(near)))
    d, f = path[:size] - path[:size].mean(), force[:size]
    return float(d @ f) / max(float(d @ d), 1e-300)


def _comes_back(record: _Record, branches: tuple[Branch, ...], begin: float) -> bool:
    """Whether all unloadings end at about the force that the record begins with."""
    ends = [branch.stop_time for branch in branches[1::2]]
    forces = np.interp(ends, record.time, record.force)
    return len(ends) > 0 and bool((np.abs(forces - begin) <= _SAME * begin).all())


def _loaded(
    signals: Signals, begin: tuple[float, float, float], during: Stretch, *, has_slack: bool
) -> Iterator[Finding]:
    force, share, path = begin
    lined = [name for name in (signals.force, signals.displacement) if name in signals.lined]
    # A line through the linear region finds zero force again, if that of the force is right.
    found = has_slack and signals.force not in lined
    message = (
        f"the record begins under load and in motion: {force:.4g} N, {1e2 * share:.2g} % of its "
        f"range, at {1e3 * path:.4g} mm in the first sample"
    )
    message += f"; {' and '.join(lined)} zeroed there" if lined else ""
    yield doubtful(_CODE, signals.force, message, "start", during=during)
    touched = ["force"] if signals.force in lined else []
    touched += ["displacement"] if signals.displacement in lined and not found else []
    if touched:
        yield doubtful(_CODE, signals.force, message, *touched)
