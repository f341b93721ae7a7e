"""Check whether the parts of a record agree: cycles, rests, force and displacement.

Each check compares one statistic with one threshold, which is above the largest statistic of sound
records of real and simulated tests (docs/explanations/intervals.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import hypot, sqrt
from typing import Literal

import numpy as np

from labpipe.records.arrays import Floats, compute_median_step, drop_missing, median
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import Limits
from labpipe.records.quality import Finding, Findings
from labpipe.records.signals import Signals
from labpipe.results.kinds import FailurePoint, compute_loading_sign
from labpipe.signal.bad_samples import bridge_spikes, find_spikes
from labpipe.signal.turning_points import estimate_noise_level, find_level_jumps

COMPARED_POINTS = 40
"""Number of displacements at which the branches of two cycles are compared."""
MIN_COMPARED_SAMPLES = 5
"""Smallest number of samples of a branch that is compared."""
REST_ERROR_FACTOR = 6.0
"""Number of standard errors by which a force at rest must differ from zero or another level."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """A loading and the unloading that follows it.

    Parameters
    ----------
    loading, unloading : branches of the curve
    paths : displacement and force of each branch, from `_make_path`
    """

    loading: Branch
    unloading: Branch
    paths: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """The record of a test, and quantities that several checks use, computed on demand.

    Parameters
    ----------
    signals : of the test, with the stretches in which they are zeroed
    curve : of unfiltered force, or the corrected curve after a break; with branches
    limits : limits of the protocol
    earlier_findings : of all earlier checks, including those of single channels
    """

    signals: Signals
    curve: Curve
    limits: Limits
    earlier_findings: Findings

    @cached_property
    def largest_force(self) -> float:
        """Return the largest force without sign, N."""
        return float(np.nanmax(np.abs(self.curve.force), initial=0.0))

    @cached_property
    def force_noise(self) -> float:
        """Return the noise of the force, N."""
        return estimate_noise_level(self.curve.force)

    @cached_property
    def cycles(self) -> list[Cycle]:
        """Return the whole cycles with enough samples."""
        cycles = [
            Cycle(first, second, (_make_path(self.curve, first), _make_path(self.curve, second)))
            for first, second in pairwise(self.curve.branches)
            if first.direction is Direction.LOADING and second.cycle == first.cycle
        ]
        sizes = [min(len(displacement) for displacement, _ in cycle.paths) for cycle in cycles]
        return [c for c, size in zip(cycles, sizes, strict=True) if size >= MIN_COMPARED_SAMPLES]

    @cached_property
    def instrument_changes(self) -> list[tuple[str, float, Cycle, Cycle]]:
        """Return changes between consecutive cycles: kind and size, and the two cycles."""
        changes = [(_find_instrument_change(self, *pair), pair) for pair in pairwise(self.cycles)]
        return [(*change, *pair) for change, pair in changes if change is not None]

    @cached_property
    def is_saturated(self) -> bool:
        """Return whether samples of a channel are known to be exactly at a limit."""
        return any(finding.code == "saturation" for finding in self.earlier_findings.entries)

    def compute_sign(self, branch: Branch) -> float:
        """Compute the sign in which the force changes in a loading branch."""
        return compute_loading_sign(self.curve.force[branch.start : branch.stop])

    def format_time(self, sample: int) -> str:
        """Format the time of a sample, or its number if the export has no time."""
        time = self.curve.time[sample]
        return f"{time:.3f} s" if self.curve.time_unit == "s" else f"sample {sample + 1}"

    def make_stretch_from(self, sample: int) -> tuple[float, float]:
        """Make the stretch from a sample to the end, in the time unit of the curve."""
        return float(self.curve.time[sample]), float(self.curve.time[-1])


def check_consistency(record: CheckedRecord) -> Iterator[Finding]:
    """Report the parts of a record that do not agree.

    Parameters
    ----------
    record : with a curve

    Yields
    ------
    Findings of failed checks: the cycle, the time, the size, and the doubtful quantities.
    """
    if not record.curve.branches:
        return
    for check in CHECKS if record.largest_force > 0.0 else CHECKS[:1]:
        yield from check(record)


def _make_path(curve: Curve, branch: Branch) -> tuple[Floats, Floats]:
    """Average displacement and force of a branch over blocks, and sort them by displacement."""
    part = slice(branch.start, branch.stop)
    samples = np.stack([curve.displacement[part], curve.force[part]])
    samples = samples[:, ~np.isnan(samples).any(axis=0)]
    min_blocks = 400  # of a branch with at least as many samples
    size = max(1, samples.shape[1] // min_blocks)
    means = samples[:, : samples.shape[1] // size * size].reshape(2, -1, size).mean(axis=2)
    displacement, force = means[:, np.argsort(means[0], kind="stable")]
    return displacement, force


def _interpolate_common_forces(*paths: tuple[Floats, Floats]) -> tuple[Floats, ...]:
    """Interpolate the forces of paths at common displacements; empty if these are too few."""
    min_common_share = 0.5  # common displacements, share of the displacements of all paths
    if min(len(path[0]) for path in paths) < MIN_COMPARED_SAMPLES:
        return ()
    low, high = max(path[0][0] for path in paths), min(path[0][-1] for path in paths)
    span = max(path[0][-1] for path in paths) - min(path[0][0] for path in paths)
    if not high - low > min_common_share * span:
        return ()
    displacements = np.linspace(low, high, COMPARED_POINTS + 2)[1:-1]
    return tuple(np.interp(displacements, *path) for path in paths)


def _find_jumps(
    record: CheckedRecord, quantity: Literal["force", "displacement"]
) -> list[tuple[int, float]]:
    """Find jumps of a quantity: sample and size; those at the end of a frozen run are skipped."""
    max_samples_after_run = 2
    time = record.curve.time
    frozen_ends = [
        int(np.searchsorted(time, doubt.during[1]))
        for finding in record.earlier_findings.entries
        for doubt in finding.doubts
        if finding.code == "frozen_channel" and doubt.quantity == quantity and doubt.during
    ]
    return [
        (sample, size)
        for sample, size in find_level_jumps(time, getattr(record.curve, quantity))
        if all(abs(sample - end) > max_samples_after_run for end in frozen_ends)
    ]


def _check_displacement_jumps(record: CheckedRecord) -> Iterator[Finding]:
    """Report jumps and outliers of the displacement, except for one at a break of the specimen."""
    break_share = 0.3  # fall of the force at a break, share of the largest force
    min_outlier = 0.02  # share of the range of the displacement
    displacement, force = record.curve.displacement, np.abs(record.curve.force)
    deviations = displacement - bridge_spikes(displacement, find_spikes(displacement))
    outliers = np.flatnonzero(np.abs(deviations) > min_outlier * np.ptp(drop_missing(displacement)))
    jumps = [(sample, float(deviations[sample])) for sample in outliers.tolist()]
    jumps += _find_jumps(record, "displacement")
    force_drops = [force[sample - 1] - force[sample] for sample, _ in jumps]
    if not jumps or (len(jumps) == 1 and force_drops[0] > break_share * record.largest_force):
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    name, mm, at = record.signals.displacement, 1e3 * size, record.format_time(sample)
    count = len(jumps)
    yield Finding.of("process.zero_jump", name, "displacement", "force", mm=mm, at=at, count=count)


def _check_rest_force(record: CheckedRecord) -> Iterator[Finding]:
    """Report the force before the motion if no step zeroes it."""
    min_samples, min_share = 8, 1e-4  # share of the largest force
    signals, curve, name = record.signals, record.curve, record.signals.force
    rest_forces = drop_missing(curve.force[: curve.branches[0].start])
    is_zeroed = name in {*signals.zero_stretches, *signals.moving_zero_stretches}
    if is_zeroed or len(rest_forces) < min_samples:
        return
    level, error = median(rest_forces), record.force_noise / sqrt(len(rest_forces))
    share = abs(level) / record.largest_force
    if abs(level) <= max(REST_ERROR_FACTOR * error, min_share * record.largest_force):
        return
    if share > max(record.limits.rest_force, 2.0 * signals.raw[name].zero_drift):
        yield Finding.of(
            "process.rest_force_doubtful", name, "force_zero", level=level, share=share
        )
    else:
        yield Finding.of("process.rest_force", name, level=level, share=share)


def _check_force_level(record: CheckedRecord) -> list[Finding]:
    """Report a jump of the force, or else a drift of its zero."""
    return [*_check_force_jumps(record)] or [*_check_zero_drift(record)]


def _check_force_jumps(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force that no specimen causes: upwards in loading, any in unloading.

    An overflow jumps over the range of the record, to the opposite force or many times.
    """
    turn_reach = 3  # jumps within so many samples of a turn are ignored
    max_jumps = 2  # more jumps are caused by the specimen, or are overflows
    min_range_share, max_uneven = 0.9, 0.1  # of the range of the record; of the jump
    force, sign = record.curve.force, record.compute_sign(record.curve.branches[0])
    all_jumps = _find_jumps(record, "force")
    min_size = min_range_share * np.ptp(drop_missing(force))
    overflows = [(sample, size) for sample, size in all_jumps if abs(size) > min_size]
    if len(overflows) <= max_jumps:
        overflows = [x for x in overflows if abs(force[x[0]] / x[1] - 0.5) < max_uneven]
    jumps = [
        (sample, size)
        for sample, size in all_jumps
        if any(
            branch.start + turn_reach < sample < branch.stop - turn_reach
            for branch in record.curve.branches
            if branch.direction is Direction.UNLOADING or sign * size > 0.0
        )
    ]
    if overflows or 0 < len(jumps) <= max_jumps:
        name, (sample, size) = record.signals.force, (overflows or jumps)[0]
        during = None if overflows else record.make_stretch_from(sample)
        yield Finding.of(
            "process.overflow" if overflows else "process.force_jump",
            name,
            *(("force", "displacement") if overflows else ("force",)),
            during=during,
            size=size,
            at=record.format_time(sample),
        )


def _check_partial_breaks(record: CheckedRecord) -> Iterator[Finding]:
    """Report sudden losses of force in loading that are larger than a slip, but no break."""
    min_loss, min_carried = 0.2, 0.5  # shares of the largest force before
    min_regained = 0.25  # share of the loss; a break regains nothing
    noise_factor, longest_loss = 8.0, 0.05  # s
    max_losses = 2  # more are the behaviour of the specimen
    curve, name = record.curve, record.signals.force
    is_timed, losses = curve.time_unit == "s", []
    n = max(1, int(longest_loss / compute_median_step(curve.time))) if is_timed else 1
    for branch in curve.branches:
        if branch.direction is Direction.UNLOADING:
            continue
        force = record.compute_sign(branch) * curve.force[branch.start : branch.stop]
        largest_before = np.fmax.accumulate(force[:-n])
        largest_after = np.fmax.accumulate(force[: n - 1 : -1])[::-1]
        loss = force[:-n] - force[n:]
        shares = loss / np.fmax(largest_before, 0.5 * record.largest_force)
        is_partial = (shares > min_loss) & (largest_after >= min_carried * largest_before)
        is_partial &= largest_after - force[n:] >= min_regained * loss
        is_partial &= loss > noise_factor * record.force_noise
        places = np.flatnonzero(is_partial)
        runs = np.split(places, np.flatnonzero(np.diff(places) > n) + 1) if len(places) else []
        losses += [
            (branch.start + run[0], branch.start + run[-1] + n, shares[run].max()) for run in runs
        ]
    for first, last, share in losses if len(losses) <= max_losses else ():
        during, at = (float(curve.time[first]), float(curve.time[last])), record.format_time(first)
        # The largest force is still that of the specimen.
        yield Finding.of(
            "process.partial_break", name, "displacement", during=during, loss=share, at=at
        )


def _check_zero_drift(record: CheckedRecord) -> Iterator[Finding]:
    """Report a change of the force at rest, if a test returns to its first position.

    A specimen with friction or permanent set pushes back after unloading. A force against the
    direction of loading is therefore a drift only if the level also changes between cycles.
    """
    return_share = 0.02  # largest distance from the first position, share of the stroke
    min_rest_samples = 3
    curve, first, last = record.curve, record.curve.branches[0], record.curve.branches[-1]
    first_rest = drop_missing(curve.force[: first.start])
    last_rest = drop_missing(curve.force[last.stop :])
    stroke = np.ptp(drop_missing(curve.displacement))
    distance = abs(curve.displacement[last.stop - 1] - curve.displacement[first.start])
    has_returned = last.direction is Direction.UNLOADING and distance <= return_share * stroke
    if not has_returned or min(len(first_rest), len(last_rest)) < min_rest_samples:
        return
    branch_forces, first_level = curve.force[first.start : last.stop], median(first_rest)
    # only the end of a long rest, because specimens relax
    last_level = median(last_rest[-len(first_rest) :])
    largest_force = float(np.nanmax(np.abs(branch_forces - first_level)))
    error = record.force_noise * hypot(len(first_rest) ** -0.5, len(last_rest) ** -0.5)
    change = compute_loading_sign(branch_forces) * (last_level - first_level)
    if any(kind == "level" for kind, *_ in record.instrument_changes):
        change = abs(change)
    if change >= max(record.limits.rest_force_drift * largest_force, REST_ERROR_FACTOR * error):
        name, share = record.signals.force, abs(change) / largest_force
        yield Finding.of(
            "process.zero_drift", name, "force", level=first_level, end=last_level, share=share
        )


def check_force_after_break(record: CheckedRecord, failure: object) -> Iterator[Finding]:
    """Report a force below zero after the specimen broke.

    Parameters
    ----------
    record : with the corrected curve
    failure : failure point of the test; without one there is no finding

    Notes
    -----
    A force above zero is allowed, because the remains of a specimen may carry it; so is a rebound
    of a few samples.
    """
    min_tail_samples = 10  # fewer may be a rebound
    if not isinstance(failure, FailurePoint):
        return
    force, largest = record.curve.force, record.largest_force
    tail = drop_missing(force[failure.sample + 1 :])
    if len(tail) < min_tail_samples:
        return
    level, error = median(tail[len(tail) // 2 :]), record.force_noise * sqrt(2.0 / len(tail))
    reversed_force = -compute_loading_sign(force[: failure.sample + 1]) * level
    if reversed_force >= max(record.limits.rest_force_drift * largest, REST_ERROR_FACTOR * error):
        name, share = record.signals.force, reversed_force / largest
        yield Finding.of("process.zero_drift_after_break", name, "force", level=level, share=share)


def _check_instrument_changes(record: CheckedRecord) -> Iterator[Finding]:
    """Report changes of scale, level or travel between two cycles, which instruments cause.

    Such a change is the same in loading and unloading, whereas conditioning, hardening, fatigue
    and permanent set change the two differently. Unloading is also compared alone, because a first
    loading differs from all others. An offset of the displacement looks like one of the force, but
    it also shifts the turns.
    """
    for kind, size, old_cycle, new_cycle in record.instrument_changes:
        (old_travel, _), (new_travel, _) = old_cycle.paths[1], new_cycle.paths[1]
        max_shift = record.limits.cycle_change * (old_travel[-1] - old_travel[0])
        is_turn_shifted = abs(new_travel[-1] - old_travel[-1]) > max_shift
        is_force_alone = kind == "level" and not is_turn_shifted
        yield Finding.of(
            "process.cycle_level"
            if kind == "level"
            else ("process.cycle_scale" if kind == "scale" else "process.cycle_travel"),
            record.signals.force,
            *(("force",) if is_force_alone else ("force", "displacement")),
            during=record.make_stretch_from(old_cycle.unloading.stop - 1),
            cycle=new_cycle.loading.cycle,
            at=record.format_time(new_cycle.loading.start),
            size=size,
        )


def _find_instrument_change(
    record: CheckedRecord, old_cycle: Cycle, new_cycle: Cycle
) -> tuple[str, float] | None:
    """Find a change between two cycles: kind and size, a level in N, a ratio of scale or travel."""
    # The ratios are the misfit of two cycles as recorded over that after a change of scale or
    # level. In 246 pairs of real and simulated cycles, where the material changes the shape of the
    # curve, they are at most 2.0 in whole cycles, and 4.0 (scale) and 6.2 (level) in unloading.
    min_scale_ratio = 3.0
    unloading_scale_ratio, unloading_level_ratio = 5.5, 8.0
    min_change = record.limits.cycle_change
    forces = _interpolate_common_forces(*old_cycle.paths, *new_cycle.paths)
    if not forces:
        return None
    old_forces, new_forces = np.concatenate(forces[:2]), np.concatenate(forces[2:])
    whole_cycle = slice(None), min_scale_ratio, min_scale_ratio
    unloading = slice(COMPARED_POINTS, None), unloading_scale_ratio, unloading_level_ratio
    for part, scale_ratio, level_ratio in (whole_cycle, unloading):
        old, new = old_forces[part], new_forces[part]
        misfit = _compute_rms(new - old)
        scale, level = float(old @ new / (old @ old)), float(np.mean(new - old))
        scale_misfit = _compute_rms(new - scale * old)
        level_misfit = _compute_rms(new - level - old)
        if (
            scale_misfit < level_misfit
            and abs(scale - 1.0) > min_change
            and misfit > scale_ratio * scale_misfit
        ):
            return "scale", scale
        if abs(level) > min_change * record.largest_force and misfit > level_ratio * level_misfit:
            return "level", level
    (old_travel, old_force), (new_travel, new_force) = old_cycle.paths[1], new_cycle.paths[1]
    ratio = float(new_travel[-1] / old_travel[-1]) if old_travel[-1] > 0.0 else 1.0
    if abs(ratio - 1.0) < min_change or ratio <= 0.0:
        return None
    rescaled = _interpolate_common_forces((old_travel, old_force), (new_travel / ratio, new_force))
    misfit = _compute_rms(new_forces[COMPARED_POINTS:] - old_forces[COMPARED_POINTS:])
    is_stretched = bool(rescaled) and misfit >= min_scale_ratio * _compute_rms(
        rescaled[1] - rescaled[0]
    )
    return ("travel", ratio) if is_stretched else None


def _check_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that still grows after a turn of the motion, because it lags or jumps."""
    noise_factor = 8.0
    curve, name, limits = record.curve, record.signals.force, record.limits
    loading_sign = record.compute_sign(curve.branches[0])
    min_growth = noise_factor * record.force_noise
    growths = []
    for branch, next_branch in pairwise(curve.branches):
        sign = loading_sign if branch.direction is Direction.LOADING else -loading_sign
        force_before = curve.force[branch.start : branch.stop]
        force_after = curve.force[next_branch.start : next_branch.stop]
        last_forces = sign * drop_missing(force_before[-max(3, len(force_before) // 10) :])
        first_forces = sign * drop_missing(force_after[: max(3, len(force_after) // 10)])
        n_samples = min(len(last_forces), len(first_forces))
        if branch.direction is next_branch.direction or n_samples < 3:
            continue
        width = max(1, n_samples // 10)
        averaging = np.ones(width) / width
        largest_before = float(np.convolve(last_forces, averaging, "valid").max())
        largest_after = float(np.convolve(first_forces, averaging, "valid").max())
        # growth in one sampling step, because the turn is between two samples
        step = max(0.0, float(last_forces[-1] - last_forces[0])) / (len(last_forces) - 1)
        growths.append((next_branch, largest_after - largest_before - step))
    if not growths:
        return
    median_growth = median(np.array([growth for _, growth in growths]))
    branch, growth = max(growths, key=lambda turn: turn[1])
    if median_growth > max(limits.force_lag * record.largest_force, min_growth):
        share = median_growth / record.largest_force
        yield Finding.of("process.force_late", name, "clock", growth=median_growth, share=share)
    elif growth > max(limits.turn_jump * record.largest_force, min_growth):
        during, at = record.make_stretch_from(branch.start), record.format_time(branch.start)
        yield Finding.of(
            "process.turn_jump", name, "force", during=during, growth=growth, at=at, branch=branch
        )


def _check_skipped_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force at one turn alone, where the recording was stopped for a while."""
    reach, min_ratio = 3, 5.0  # samples beside a turn; to the largest step at the other turns
    curve, jumps = record.curve, dict(_find_jumps(record, "force"))
    for direction in Direction:
        starts = [
            second.start
            for first, second in pairwise(curve.branches)
            if first.direction is not second.direction is direction
        ]
        samples = range(len(curve.force))
        nearby = [samples[max(start - reach, 0) : start + reach + 1] for start in starts]
        steps = [np.fmax.reduce(np.abs(np.diff(curve.force[near])), initial=0.0) for near in nearby]
        for number, near in enumerate(nearby):
            others = [*steps[:number], *steps[number + 1 :]]
            jump = next((sample for sample in near if sample in jumps), None)
            if jump is not None and others and steps[number] > min_ratio * max(others):
                during = float(curve.time[near[0]]), float(curve.time[near[-1]])
                yield Finding.of(
                    "process.turn_skipped",
                    record.signals.displacement,
                    *("displacement", "force"),
                    during=during,
                    size=jumps[jump],
                    at=record.format_time(jump),
                )


def _check_limits(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that is constant on both sides of a turn but for noise.

    A specimen that yields loses force as soon as the motion turns.
    """
    turn_share, min_level, max_error = 0.1, 0.5, 1e-2  # of the stroke; of the largest force
    error_factor, min_samples = 4.0, 8
    for cycle in () if record.is_saturated else record.cycles:
        parts = list[Floats]()
        for displacement, force in cycle.paths:
            turn = record.curve.displacement[cycle.unloading.start]
            is_near = np.abs(displacement - turn) < turn_share * np.ptp(displacement)
            parts += np.array_split(force[is_near], 2)
        if min(map(len, parts)) < min_samples:
            continue
        levels = np.array([part.mean() for part in parts])
        error = error_factor * max(part.std() / sqrt(len(part)) for part in parts)
        level = float(levels.mean())
        is_limit = np.ptp(levels) < error < max_error * record.largest_force
        if is_limit and abs(level) > min_level * record.largest_force:
            yield Finding.of(
                "process.force_limited",
                record.signals.force,
                "force",
                during=(cycle.loading.start_time, cycle.unloading.stop_time),
                cycle=cycle.loading.cycle,
                level=level,
            )


def _check_held_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that goes on and comes back while the displacement rests at a turn."""
    min_growth, noise_factor = 0.05, 8.0  # of the largest force; of the noise
    curve, limit = record.curve, noise_factor * record.force_noise
    for first, second in () if record.is_saturated else pairwise(curve.branches):
        sign = record.compute_sign(first) * (1 if first.direction is Direction.LOADING else -1)
        held = drop_missing(sign * curve.force[first.stop - 1 : second.start + 1])
        growth = float(held.max() - max(held[0], held[-1])) if len(held) else 0.0
        if growth > max(min_growth * record.largest_force, limit):
            yield Finding.of(
                "process.displacement_limited",
                record.signals.displacement,
                "displacement",
                during=(first.start_time, second.stop_time),
                at=record.format_time(first.stop - 1),
                growth=growth,
                place=1e3 * curve.displacement[first.stop - 1],
            )


def _check_last_rise(record: CheckedRecord) -> Iterator[Finding]:
    """Report a largest force to which the force jumps just before it is lost."""
    reach, jump_factor, noise_factor = 3, 5.0, 8.0  # samples; of the steps before
    min_share, lost_share = 0.02, 0.5  # of the largest force
    curve = record.curve
    force = record.compute_sign(curve.branches[0]) * curve.force
    top = int(np.nanargmax(force))
    steps = np.diff(force[max(0, top - 2 * reach) : top + 1])
    after = force[top + 1 : top + 1 + reach]
    if len(steps) < 2 * reach or not len(after):
        return
    jump, limit = float(np.max(steps[reach:])), jump_factor * float(np.max(np.abs(steps[:reach])))
    limit = max(limit, min_share * record.largest_force, noise_factor * record.force_noise)
    if jump > limit and float(np.min(after)) < lost_share * force[top]:
        during, at = (
            (float(curve.time[top - reach]), float(curve.time[top])),
            record.format_time(top),
        )
        name = record.signals.force
        yield Finding.of("process.last_rise", name, "force", during=during, size=jump, at=at)


def _check_holes(record: CheckedRecord) -> Iterator[Finding]:
    """Report a hole in the times at a turn or at the largest force, which hides the peaks."""
    # A hole is longer than this multiple of most steps. Before it, the motion passes this share of
    # its range, and this multiple of its noise, in the same time. Noise moves the largest sample.
    min_steps, min_share, noise_factor, reach = 5.0, 0.005, 6.0, 5
    curve, name = record.curve, record.signals.displacement
    time, path = curve.time, curve.displacement
    steps = np.diff(time)
    holes = np.flatnonzero(steps > min_steps * np.quantile(steps, 0.98))
    peaks = [second.start for _, second in pairwise(curve.branches)]
    peaks.append(int(np.nanargmax(np.abs(curve.force))))
    travel_limit = min_share * np.ptp(drop_missing(path))
    noise_limit = noise_factor * estimate_noise_level(path)
    for hole in holes.tolist():
        is_at_peak = min(abs(hole - peak) for peak in peaks) <= reach
        passed = abs(path[hole] - path[np.searchsorted(time, time[hole] - steps[hole])])
        if is_at_peak and passed > max(travel_limit, noise_limit):
            first, last = max(hole - reach, 0), min(hole + reach + 1, len(time) - 1)
            yield Finding.of(
                "process.peak_in_hole",
                name,
                *("displacement", "force"),
                during=(float(time[first]), float(time[last])),
                length=steps[hole],
                at=record.format_time(hole),
            )


def _check_energy(record: CheckedRecord) -> Iterator[Finding]:
    """Report cycles in which the specimen returns more energy than was put in."""
    gains = []
    for cycle in record.cycles:
        forces = _interpolate_common_forces(*cycle.paths)
        # at common displacements, mean forces are proportional to energies
        work_in = float(np.mean(np.abs(forces[0]))) if forces else 0.0
        if work_in:
            work_lost = record.compute_sign(cycle.loading) * float(np.mean(forces[0] - forces[1]))
            gain = -work_lost / work_in
            gains += [(cycle, gain)] if gain > record.limits.energy_gain else []
    # If most cycles gain energy, columns may be exchanged, or the record may be reversed.
    affects_most_cycles = len(gains) > len(record.cycles) / 2
    quantities = ("force", "displacement", "clock") if affects_most_cycles else ("force",)
    name, times = record.signals.force, record.curve.time
    for cycle, gain in gains[:1] if affects_most_cycles else gains:
        first, last = cycle.loading.start + 1, cycle.unloading.stop - 2
        inner_stretch = float(times[first]), float(times[last])
        during, number = None if affects_most_cycles else inner_stretch, cycle.loading.cycle
        yield Finding.of(
            "process.energy_gained", name, *quantities, during=during, cycle=number, gain=gain
        )


def _check_second_specimen(record: CheckedRecord) -> Iterator[Finding]:
    """Report a record that continues with another specimen after the first one broke."""
    force_quantile = 0.8  # a broken specimen carries almost no force in this share of an unloading
    branches, limits = record.curve.branches, record.limits
    for cycle in record.cycles:
        next_branch = next((x for x in branches if x.start >= cycle.unloading.stop), None)
        paths = (*cycle.paths, _make_path(record.curve, next_branch)) if next_branch else ()
        forces = _interpolate_common_forces(*paths) if paths else ()
        if next_branch is None or not forces:
            continue
        first, back, second = (float(np.quantile(np.abs(path), force_quantile)) for path in forces)
        if back < limits.broken_force * first and second > limits.second_loading * first:
            yield Finding.of(
                "process.second_specimen",
                record.signals.force,
                *("force", "displacement"),
                cycle=cycle.loading.cycle,
                back=back,
                later=next_branch.cycle,
                second=second,
            )
            return


CHECKS = (
    _check_displacement_jumps,
    _check_rest_force,
    _check_force_level,
    _check_partial_breaks,
    _check_instrument_changes,
    _check_turns,
    _check_skipped_turns,
    _check_limits,
    _check_held_turns,
    _check_last_rise,
    _check_holes,
    _check_energy,
    _check_second_specimen,
)
"""Checks in the order of their findings; those after the first need a force that is not zero."""


def _compute_rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
