"""Zeros: their level at rest, their drift, and records that begin under load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from labpipe.process.motion import Motion
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch, Curve, Direction, Interval
from labpipe.records.declarations import LIMITS, Limits
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, Findings, doubtful, info_note
from labpipe.records.signals import Clocks, Signals, Stretch
from labpipe.results.reduced_test import FailurePoint, sense_of_loading
from labpipe.signal.rests_and_jumps import level_jumps, samples_at_rest
from labpipe.signal.turning_points import noise_level
from labpipe.uncertainty.autocorrelation import long_run_variance, smooth_stretches
from labpipe.uncertainty.linear_fits import fit_linear

MIN_SAMPLES_NOISE_UNKNOWN = 8
"""Samples that a level needs if the rest of the record does not show the noise."""
MIN_SAMPLES_NOISE_KNOWN = 3
"""Samples that a level needs if the rest of the record shows the noise."""
SHORT_STRETCH = 100
"""Samples below which the noise of a stretch is taken from the rest of the record."""


def required_samples(other_values: Floats) -> int:
    """Return the number of samples that a zero needs.

    Parameters
    ----------
    other_values : shape (m,), the rest of the record

    Notes
    -----
    Three samples suffice if the rest of the record has at least 100. With 3 to 6 samples, the 95 %
    intervals of `mean_level` and `end_level` then cover the true value in 94 to 96 % of cases, in
    white noise and in noise with a correlation length of ten samples. If the rest has only 25
    samples, the coverage is the same for a correlation length of two samples and 73 % for one of
    ten, because so short a record does not separate such noise from its curve.
    """
    return MIN_SAMPLES_NOISE_KNOWN if _noise_stretches(other_values) else MIN_SAMPLES_NOISE_UNKNOWN


def mean_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Return the mean of a stretch and its standard error.

    Parameters
    ----------
    values : shape (n,), the stretch, evenly sampled, without NaN
    other_values : shape (m,), the rest of the record, for the correlation of the noise
    """
    stretches = _stretches_beside_short_one(values, other_values)
    if stretches:
        fit = fit_linear(np.ones((len(values), 1)), values, beside=stretches)
        half = float(fit.half_widths[0])
        return float(fit.coefficients[0]), Interval(-half, half).standard_error
    blocks = _blocks(values)
    error = float(np.sqrt(long_run_variance(blocks, parameters=1) / len(blocks)))
    return float(values.mean()), error


def end_level(values: Floats, other_values: Floats) -> tuple[float, float]:
    """Return the first value of a line through a stretch and its standard error.

    Parameters
    ----------
    values, other_values : as for `mean_level`
    """
    blocks = _blocks(values)
    size = len(values) // len(blocks)
    middles = np.arange(len(blocks)) + 0.5 * (size - 1) / size  # in blocks from the first sample
    design = np.column_stack([np.ones(len(blocks)), middles])
    fit = fit_linear(design, blocks, beside=_stretches_beside_short_one(values, other_values))
    # As wide as the interval by Student's t, because a zero has few samples.
    interval = Interval(-float(fit.half_widths[0]), float(fit.half_widths[0]))
    return float(fit.coefficients[0]), interval.standard_error


def line_zero(values: Floats, other_values: Floats) -> tuple[float, float, int]:
    """Return the level before a machine moved, from a stretch in which it moves.

    Parameters
    ----------
    values, other_values : as for `mean_level`; the stretch begins at its outer end

    Returns
    -------
    level, error : of the outer end: the mean of a rest at the beginning of the stretch, or the
        first value of a line if the rest is too short
    rest_samples : number of samples in that rest; 0 if the level is from a line
    """
    rest_samples = samples_at_rest(values)
    if rest_samples >= required_samples(other_values):
        return *mean_level(
            values[:rest_samples], np.concatenate([values[rest_samples:], other_values])
        ), rest_samples
    moving = (
        values[rest_samples:] if len(values) - rest_samples >= MIN_SAMPLES_NOISE_UNKNOWN else values
    )
    return *end_level(moving, other_values), 0


def _stretches_beside_short_one(values: Floats, other_values: Floats) -> Sequence[Floats]:
    return _noise_stretches(other_values) if len(values) < SHORT_STRETCH else ()


def _noise_stretches(other_values: Floats) -> Sequence[Floats]:
    short_width = 25
    return smooth_stretches(
        other_values, width=SHORT_STRETCH if len(other_values) >= SHORT_STRETCH else short_width
    )


def _blocks(values: Floats) -> Floats:
    """Average over at most 1000 blocks, which makes correlations quick."""
    size = max(1, len(values) // 1000)
    means: Floats = values[: len(values) // size * size].reshape(-1, size).mean(axis=1)
    return means


def rezero_at_rest(signals: Signals, motion: Motion) -> tuple[Signals, list[Finding]]:
    """Recompute zeros whose stretch overlaps the motion from the part at rest.

    Parameters
    ----------
    signals : zeroed
    motion : with clocks that are joined

    Returns
    -------
    The signals, shifted, and a note for each.

    Notes
    -----
    The standard error accounts for the shorter stretch. With fewer than `MIN_SAMPLES_NOISE_UNKNOWN`
    at rest the zero is not recomputed, and `check_rest` doubts it.
    """
    findings: list[Finding] = []
    branches = motion.branches
    for name, (start, stop) in signals.zeroed.items() if branches else ():
        begins, ends = (
            motion.clocks.from_curve(end, signals.raw[name].clock)
            for end in (branches[0].start_time, branches[-1].stop_time)
        )
        if start < begins < stop:
            rest = (start, begins)
        elif start < ends < stop:
            rest = (ends, stop)
        else:
            continue
        signals, zero_findings = _zero_again(signals, name, rest, stated_time=stop - start)
        findings += zero_findings
    return signals, findings


def _zero_again(
    signals: Signals, name: str, rest: Stretch, *, stated_time: float
) -> tuple[Signals, list[Finding]]:
    raw = signals.raw[name]
    inside = (raw.time >= rest[0]) & (raw.time <= rest[1])
    rest_values = raw.values[inside & ~np.isnan(raw.values)]
    if len(rest_values) < MIN_SAMPLES_NOISE_UNKNOWN:
        return signals, []
    level, error = mean_level(rest_values, raw.values[~inside])
    duration = rest[1] - rest[0]
    message = (
        f"the machine rests for {duration:.2f} s, less than the {stated_time:g} s of the zero: the "
        f"zero is the mean over these {duration:.2f} s"
    )
    signals = replace(
        signals.without_level(name, level, error), zeroed={**signals.zeroed, name: rest}
    )
    return signals, [info_note("short_rest", name, message)]


REST_ERROR_FACTOR = 6.0
"""Standard errors that a difference of levels must exceed."""
MIN_REST_SAMPLES = 3


def check_zeros(
    signals: Signals, clocks: Clocks, curve: Curve, findings: Findings, limits: Limits = LIMITS
) -> list[Finding]:
    """Report jumps of force or displacement, a force at rest, and drift of the force zero.

    Parameters
    ----------
    signals, clocks : of the test
    curve : of unfiltered force
    findings : so far; the end of a frozen stretch is not a jump
    limits : of the lab
    """
    if not curve.branches:
        return []

    def frozen_ends(quantity: str) -> list[float]:
        return [
            clocks.to_curve(doubt.during[1], doubt.clock)
            for doubt in findings.doubts
            if doubt.reason.code == "frozen_channel" and doubt.quantity == quantity and doubt.during
        ]

    new_findings = list(
        _displacement_jump(signals.displacement, curve, frozen_ends("displacement"))
    )
    jump = list(_force_jump(signals.force, curve, frozen_ends("force")))
    new_findings += _rest_force(signals, curve, limits.rest_force)
    return [*new_findings, *(jump or _drift(signals.force, curve, limits.rest_force_drift))]


def _rest_force(signals: Signals, curve: Curve, share: float) -> Iterator[Finding]:
    """Report the force before the motion if no step zeroes it."""
    min_rest_share = 1e-4  # share of the largest force below which a rest force is not reported
    name = signals.force
    before = _finite(curve.force[: curve.branches[0].start])
    if name in signals.zeroed or name in signals.lined or len(before) < MIN_SAMPLES_NOISE_UNKNOWN:
        return
    level, max_force = median(before), float(np.nanmax(np.abs(curve.force)))
    error = noise_level(curve.force) / sqrt(len(before))
    if abs(level) <= max(REST_ERROR_FACTOR * error, min_rest_share * max_force):
        return
    message = (
        f"at rest before the motion the force is {level:.4g} N, {abs(level) / max_force:.2%} of "
        "the largest, and no step zeroes it: a preload, or the zero of the load cell? If it is the "
        "zero, add the step {step: zero, channel: force, over: 1 s}"
    )
    if abs(level) > max(share, 2.0 * signals.raw[name].zero_drift) * max_force:
        yield doubtful("rest_force", name, message, "force")
    else:
        yield info_note("rest_force", name, message)


def _displacement_jump(
    signal_name: str, curve: Curve, frozen_ends: list[float]
) -> Iterator[Finding]:
    """Report jumps of the displacement that no break explains."""
    break_share = 0.3  # fall of the force at a break, share of the largest force
    largest = float(np.nanmax(np.abs(curve.force)))
    jumps = _jumps(curve, curve.displacement, frozen_ends)
    falls = [abs(curve.force[sample - 1]) - abs(curve.force[sample]) for sample, _ in jumps]
    if not jumps or (len(jumps) == 1 and falls[0] > break_share * largest):
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    count_text = "" if len(jumps) == 1 else f", the largest of {len(jumps)} jumps"
    message = (
        f"the displacement jumps by {1e3 * size:.4g} mm from one sample to the next at "
        f"{_at(curve, sample)}{count_text}: was it zeroed, or did it overflow or drop out during "
        "the test? Branches may be misplaced; export the test without the part before the jump"
    )
    yield doubtful("zero_jump", signal_name, message, "displacement", "force")


def _force_jump(signal_name: str, curve: Curve, frozen_ends: list[float]) -> Iterator[Finding]:
    """Report jumps of the force that no slip or break explains."""
    first = curve.branches[0]
    sense = sense_of_loading(curve.force[first.start : first.stop])
    jumps = _jumps(curve, curve.force, frozen_ends)
    zero_jumps = [jump for jump in jumps if not _is_from_specimen(curve, jump[0], sense * jump[1])]
    max_jumps = 2  # more jumps are of the specimen
    if len(jumps) > max_jumps or not zero_jumps:
        return
    sample, size = zero_jumps[0]
    message = (
        f"the force jumps by {size:.4g} N from one sample to the next at {_at(curve, sample)}, as "
        "no specimen does: check the cable and the tare of the load cell"
    )
    during = (float(curve.time[sample]), float(curve.time[-1]))
    yield doubtful("zero_jump", signal_name, message, "force", during=during)


def _jumps(curve: Curve, values: Floats, frozen_ends: list[float]) -> tuple[tuple[int, float], ...]:
    """Find jumps of a level, except at the end of a frozen stretch."""
    return tuple(
        (sample, size)
        for sample, size in level_jumps(curve.time, values)
        if not any(curve.time[sample - 1] <= end <= curve.time[sample] for end in frozen_ends)
    )


def _is_from_specimen(curve: Curve, sample: int, force_increase: float) -> bool:
    """Check whether a jump may be a break, a slip, or the effect of a turn."""
    # Samples beside a turn, where a steep fall belongs to the specimen.
    turn_reach = 3
    turn_samples = [turn for branch in curve.branches for turn in (branch.start, branch.stop)]
    if any(abs(sample - turn) <= turn_reach for turn in turn_samples):
        return True
    inside = [branch for branch in curve.branches if branch.start <= sample < branch.stop]
    is_loading = bool(inside) and inside[0].direction is Direction.LOADING
    is_held = _held_after_loading(curve, sample)
    return force_increase < 0.0 and (is_loading or is_held)


def _held_after_loading(curve: Curve, sample: int) -> bool:
    """Check whether the specimen is held after loading, where it may also break."""
    before = [branch for branch in curve.branches if branch.stop <= sample]
    resting = all(not branch.start <= sample < branch.stop for branch in curve.branches)
    return bool(before) and resting and before[-1].direction is Direction.LOADING


def _drift(signal_name: str, curve: Curve, share: float) -> Iterator[Finding]:
    """Compare the force at rest before and after the test.

    A specimen with friction or permanent set pushes back after unloading: a force against the
    sense of loading is a drift only if it also grows from cycle to cycle.
    """
    first, last = curve.branches[0], curve.branches[-1]
    before, after = _finite(curve.force[: first.start]), _finite(curve.force[last.stop :])
    if not _has_returned(curve, first, last) or min(len(before), len(after)) < MIN_REST_SAMPLES:
        return
    level = median(before)
    force_change = (
        median(after[-len(before) :]) - level
    )  # the end of a long rest, because specimens relax
    part = curve.force[first.start : last.stop]
    max_force = float(np.nanmax(np.abs(part - level)))
    error = noise_level(curve.force) * sqrt(1.0 / len(before) + 1.0 / len(after))
    limit, sense = max(share * max_force, REST_ERROR_FACTOR * error), sense_of_loading(part)
    if abs(force_change) < limit or (sense * force_change < 0.0 and not _force_grows(curve, limit)):
        return
    message = (
        f"at rest the force is {level:.4g} N before the test and {level + force_change:.4g} N "
        f"after it, {abs(force_change) / max_force:.0%} of the largest force apart: the zero "
        "drifted, or the specimen is held under load"
    )
    yield doubtful("zero_drift", signal_name, message, "force")


def check_break(
    signal_name: str, curve: Curve, failure: FailurePoint | Failure | None, limits: Limits = LIMITS
) -> Iterator[Finding]:
    """Report a force below zero after the specimen broke.

    Parameters
    ----------
    signal_name : name of the force
    curve, failure : of the test. Remains of a specimen may carry a small force, so that a force
        above zero is allowed, and so is a rebound of a few samples
    limits : of the lab
    """
    # Fewer samples may be a rebound.
    min_tail_samples = 10
    if not isinstance(failure, FailurePoint):
        return
    after = _finite(curve.force[failure.sample + 1 :])
    sense = sense_of_loading(curve.force[: failure.sample + 1])
    if len(after) < min_tail_samples:
        return
    level = sense * median(after[len(after) // 2 :])
    max_force = float(np.nanmax(np.abs(curve.force)))
    error = noise_level(curve.force) * sqrt(2.0 / len(after))
    if level > -max(limits.rest_force_drift * max_force, REST_ERROR_FACTOR * error):
        return
    message = (
        f"the force is {sense * level:.4g} N after the specimen broke, "
        f"{-level / max_force:.0%} of its peak below zero: it was zeroed under load, or its zero "
        "drifted"
    )
    yield doubtful("zero_drift", signal_name, message, "force")


def _force_grows(curve: Curve, limit: float) -> bool:
    """Check whether the force at the end of unloading changes from the first cycle to the last."""
    ends = [branch.stop for branch in curve.branches if branch.direction is Direction.UNLOADING]
    levels = [
        _finite(curve.force[max(end - MIN_REST_SAMPLES, 0) : end + MIN_REST_SAMPLES])
        for end in (ends[0], ends[-1])
    ]
    if not all(len(level) for level in levels):
        return False
    # The median of few samples scatters 1.25 times as much as their mean.
    error = 1.25 * noise_level(curve.force) * sqrt(sum(1.0 / len(level) for level in levels))
    return abs(median(levels[1]) - median(levels[0])) > max(limit, REST_ERROR_FACTOR * error)


def _has_returned(curve: Curve, first: Branch, last: Branch) -> bool:
    """Check whether the test ends with an unloading to its first position."""
    return_share = 0.02  # largest distance from the first position, share of the stroke
    if last.direction is not Direction.UNLOADING:
        return False
    began, ended = curve.displacement[first.start], curve.displacement[last.stop - 1]
    return bool(abs(ended - began) <= return_share * float(np.ptp(_finite(curve.displacement))))


def _finite(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _at(curve: Curve, sample: int) -> str:
    return f"{curve.time[sample]:.3f} s" if curve.time_unit == "s" else f"sample {sample + 1}"


MIN_SLOPE_SAMPLES = 4
_CODE = "begins_under_load"


@dataclass(frozen=True, slots=True)
class _Record:
    """Exported force and displacement on the clock of the curve, positive in loading."""

    time: Floats
    force: Floats
    path: Floats


def check_begin(signals: Signals, motion: Motion, *, has_slack: bool) -> Iterator[Finding]:
    """Report a record that begins under load and mark the results that depend on its start.

    Parameters
    ----------
    signals : of the test, with the levels that zeros subtracted
    motion : with clocks that are joined
    has_slack : whether slack was subtracted from the displacement

    Yields
    ------
    Doubts of signals that were zeroed by a line through the first rows, and of the work done before
    (quantity ``start``).

    Notes
    -----
    A record that begins at rest is not doubted, because its load cell may have an offset; nor is a
    test in cycles that return to the load at its beginning.
    """
    min_load_shares = 0.02, 0.01  # shares of the ranges of force and displacement
    slope_factor = 3.0  # ratio up to which force and displacement lie on one line
    min_force_share = 0.1  # from this share on, the displacement is not considered
    noise_factor = 5.0  # force at the start over noise, for a load
    branches = motion.branches
    record = _record(signals, motion.clocks, branches) if branches else None
    if record is None:
        return
    time_step = float(record.time[-1] - record.time[0]) / len(record.time)
    if branches[0].start_time - float(record.time[0]) > 3.0 * time_step:
        return  # the record begins at rest
    during = (float(record.time[0]), max(float(record.time[0]), branches[0].start_time))
    first = (record.time >= branches[0].start_time) & (record.time <= branches[0].stop_time)
    force = float(record.force[first][0])
    share = force / float(np.ptp(record.force))
    if not force > noise_factor * noise_level(record.force):
        return
    if share > 0.5 and float(record.force[first][-1]) < 0.5 * force:
        message = (
            f"the record begins at {force:.4g} N, and the force falls over its first stroke: it "
            "begins under load, with an unloading, so that the cycle numbers are wrong"
        )
        yield doubtful(_CODE, signals.force, message, "force", "displacement", "start")
        return
    if _returns_to(record, branches, force):
        return
    slope = _first_slope(record.path[first], record.force[first], record.path)
    path, travel = float(record.path[0]), float(np.ptp(record.path))
    is_on_one_line = force / slope_factor <= slope * path <= slope_factor * force
    is_loaded = (
        share >= min_load_shares[0] and path >= min_load_shares[1] * travel and is_on_one_line
    )
    if is_loaded or share >= min_force_share:
        yield from _loaded_start(signals, (force, share, path), during, has_slack=has_slack)


def _record(signals: Signals, clocks: Clocks, branches: tuple[Branch, ...]) -> _Record | None:
    time = signals.raw[signals.displacement].time
    force, path = (
        clocks.sampled(signals.raw[name], time) + signals.taken_off.get(name, 0.0)
        for name in (signals.force, signals.displacement)
    )
    is_finite = np.isfinite(force) & np.isfinite(path)
    time, force, path = time[is_finite], force[is_finite], path[is_finite]
    first = (time >= branches[0].start_time) & (time <= branches[0].stop_time)
    if first.sum() < MIN_SLOPE_SAMPLES or not np.ptp(force) > 0.0 or not np.ptp(path) > 0.0:
        return None
    up = float(np.sign(path[first][-1] - path[first][0])) or 1.0
    sense = float(np.sign(force[int(np.argmax(np.abs(force)))]))
    return _Record(time, sense * force, up * path)


def _first_slope(path: Floats, force: Floats, all_path: Floats) -> float:
    """Fit the slope of the beginning of a branch, N/m."""
    first_share = 0.05
    is_near = np.abs(path - path[0]) <= first_share * float(np.ptp(all_path))
    size = max(MIN_SLOPE_SAMPLES, len(is_near) if is_near.all() else int(np.argmin(is_near)))
    d, f = path[:size] - path[:size].mean(), force[:size]
    return float(d @ f) / max(float(d @ d), 1e-300)


def _returns_to(record: _Record, branches: tuple[Branch, ...], begin: float) -> bool:
    """Check whether all unloadings end at about the first force of the record."""
    # Share of the first force.
    max_force_deviation = 0.5
    ends = [branch.stop_time for branch in branches[1::2]]
    forces = np.interp(ends, record.time, record.force)
    return len(ends) > 0 and bool((np.abs(forces - begin) <= max_force_deviation * begin).all())


def _loaded_start(
    signals: Signals, begin: tuple[float, float, float], during: Stretch, *, has_slack: bool
) -> Iterator[Finding]:
    force, share, path = begin
    lined = [name for name in (signals.force, signals.displacement) if name in signals.lined]
    # The slack correction restores the zero of displacement if the zero of the force is correct.
    is_corrected = has_slack and signals.force not in lined
    message = (
        f"the record begins under load and in motion: {force:.4g} N, {1e2 * share:.2g} % of its "
        f"range, at {1e3 * path:.4g} mm in the first sample"
    )
    message += f"; {' and '.join(lined)} zeroed there" if lined else ""
    yield doubtful(_CODE, signals.force, message, "start", during=during)
    quantities = ["force"] if signals.force in lined else []
    quantities += ["displacement"] if signals.displacement in lined and not is_corrected else []
    if quantities:
        yield doubtful(_CODE, signals.force, message, *quantities)
