"""Check whether cycles, rests, force and displacement of a record agree with each other.

Each check compares one statistic with one threshold. The threshold is above the largest statistic
of all sound records of real and simulated tests (docs/explanations/intervals.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import compress, pairwise
from math import hypot, sqrt
from typing import Any, Literal

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
MIN_NOISE_RATIO = 8.0
"""Smallest change of the force that is reported, divided by the noise of the force."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """A loading and the unloading that follows it.

    Parameters
    ----------
    loading, unloading : branches of the curve
    paths : displacements (m, increasing) and forces (N) of the loading, then of the unloading
    """

    loading: Branch
    unloading: Branch
    paths: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """Record of a test with the quantities that several checks use.

    Parameters
    ----------
    signals : signals of the test, with the stretches in which they are zeroed
    curve : curve of the unfiltered force with its branches; for checks of the force after a break,
        the corrected curve
    limits : limits of the protocol
    earlier_findings : findings of the checks of single channels, which precede these
    """

    signals: Signals
    curve: Curve
    limits: Limits
    earlier_findings: Findings

    @cached_property
    def largest_force(self) -> float:
        """Return the largest absolute force, N."""
        return float(np.nanmax(np.abs(self.curve.force), initial=0.0))

    @cached_property
    def force_noise(self) -> float:
        """Return the standard deviation of the noise of the force, N."""
        return estimate_noise_level(self.curve.force)

    @cached_property
    def cycles(self) -> list[Cycle]:
        """Return the complete cycles with enough samples."""
        cycles = [
            Cycle(first, second, (_make_path(self.curve, first), _make_path(self.curve, second)))
            for first, second in pairwise(self.curve.branches)
            if first.direction is Direction.LOADING and second.cycle == first.cycle
        ]
        sizes = [min(len(path[0]) for path in cycle.paths) for cycle in cycles]
        return [*compress(cycles, [size >= MIN_COMPARED_SAMPLES for size in sizes])]

    @cached_property
    def cycle_changes(self) -> list[tuple[str, float, Cycle, Cycle]]:
        """Return the changes between consecutive cycles.

        Each has its kind and size, as in `_find_cycle_change`, and the earlier and later cycle.
        """
        return [
            (*change, *pair)
            for pair in pairwise(self.cycles)
            if (change := _find_cycle_change(self, *pair)) is not None
        ]

    @cached_property
    def is_saturated(self) -> bool:
        """Return whether an earlier check found samples at the limit of a channel."""
        return any(finding.code == "saturation" for finding in self.earlier_findings.entries)

    def compute_sign(self, branch: Branch) -> float:
        """Compute the sign of the force with which the specimen is loaded in a branch."""
        return compute_loading_sign(self.curve.force[branch.start : branch.stop])

    def report(
        self,
        name: str,
        *quantities: str,
        channel: Literal["force", "displacement"] = "force",
        at: int | None = None,
        segment: tuple[int, int] | None = None,
        **facts: Any,
    ) -> Finding:
        """Make a finding about the force or the displacement.

        Parameters
        ----------
        name, facts : see `labpipe.messages.format_sentence`
        quantities : doubtful quantities
        channel : quantity whose channel the note names
        at : index of the sample that the message names by its time, or by its number if the export
            has no time; None if the message names no sample
        segment : indices of the first and last doubtful sample; None for all samples
        """
        time = self.curve.time
        if at is not None:
            is_timed = self.curve.time_unit == "s"
            facts["at"] = f"{time[at]:.3f} s" if is_timed else f"sample {at + 1}"
        period = None if segment is None else (float(time[segment[0]]), float(time[segment[1]]))
        where = getattr(self.signals, channel)
        return Finding.of(name, where, *quantities, period=period, **facts)


def check_consistency(record: CheckedRecord) -> Iterator[Finding]:
    """Report the parts of a record that do not agree.

    Parameters
    ----------
    record : record of a test

    Yields
    ------
    A finding for each contradiction, with its cycle or time, its size and the doubtful quantities.
    """
    if not record.curve.branches:
        return
    for check in _CHECKS if record.largest_force > 0.0 else _CHECKS[:1]:
        yield from check(record)


def _make_path(curve: Curve, branch: Branch) -> tuple[Floats, Floats]:
    """Return block means of displacement and force of a branch, sorted by displacement."""
    rows = slice(branch.start, branch.stop)
    samples = np.stack([curve.displacement[rows], curve.force[rows]])
    samples = samples[:, ~np.isnan(samples).any(axis=0)]
    min_blocks = 400  # a branch with fewer samples is not averaged
    block_size = max(1, samples.shape[1] // min_blocks)
    n_blocks = samples.shape[1] // block_size
    means = samples[:, : n_blocks * block_size].reshape(2, n_blocks, block_size).mean(axis=2)
    displacement, force = means[:, np.argsort(means[0], kind="stable")]
    return displacement, force


def _interpolate_common_forces(*paths: tuple[Floats, Floats]) -> tuple[Floats, ...]:
    """Interpolate the forces of paths over their common range of displacement.

    The result is empty if a path has too few samples, or if the common range is too small compared
    with the combined range.
    """
    min_common_fraction = 0.5  # of the combined range
    if min(len(path[0]) for path in paths) < MIN_COMPARED_SAMPLES:
        return ()
    starts, ends = [path[0][0] for path in paths], [path[0][-1] for path in paths]
    if not min(ends) - max(starts) > min_common_fraction * (max(ends) - min(starts)):
        return ()
    displacements = np.linspace(max(starts), min(ends), COMPARED_POINTS + 2)[1:-1]
    return tuple(np.interp(displacements, *path) for path in paths)


def _find_jumps(
    record: CheckedRecord, quantity: Literal["force", "displacement"]
) -> list[tuple[int, float]]:
    """Find the sample and the size of each jump of a quantity.

    Jumps at the end of a stretch in which the channel is frozen are ignored.
    """
    max_distance = 2  # samples between a jump and the end of a frozen stretch
    time = record.curve.time
    frozen_ends = [
        int(np.searchsorted(time, doubt.period[1]))
        for finding in record.earlier_findings.entries
        for doubt in finding.doubts
        if finding.code == "frozen_channel" and doubt.quantity == quantity and doubt.period
    ]
    return [
        (sample, size)
        for sample, size in find_level_jumps(time, getattr(record.curve, quantity))
        if all(abs(sample - end) > max_distance for end in frozen_ends)
    ]


def _check_displacement_jumps(record: CheckedRecord) -> Iterator[Finding]:
    """Report jumps and outliers of the displacement, except a single jump at a break."""
    min_break_drop = 0.3  # drop of the force at a break as a fraction of the largest force
    min_outlier = 0.02  # fraction of the range of the displacement
    displacement, force = record.curve.displacement, np.abs(record.curve.force)
    deviations = displacement - bridge_spikes(displacement, find_spikes(displacement))
    outliers = np.flatnonzero(np.abs(deviations) > min_outlier * np.ptp(drop_missing(displacement)))
    jumps = [(sample, float(deviations[sample])) for sample in outliers.tolist()]
    jumps += _find_jumps(record, "displacement")
    force_drops = [force[sample - 1] - force[sample] for sample, _ in jumps]
    if not jumps or (len(jumps) == 1 and force_drops[0] > min_break_drop * record.largest_force):
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    yield record.report(
        "process.zero_jump",
        *("displacement", "force"),
        channel="displacement",
        at=sample,
        mm=1e3 * size,
        count=len(jumps),
    )


def _check_rest_force(record: CheckedRecord) -> Iterator[Finding]:
    """Report the force before the motion if no step zeroes it, or if it leaves its zero."""
    min_samples = 8
    min_level = 1e-4  # fraction of the largest force
    signals, curve, name = record.signals, record.curve, record.signals.force
    start = curve.branches[0].start
    is_zeroed = name in {*signals.zero_stretches, *signals.moving_zero_stretches}
    jumps = find_level_jumps(curve.time[:start], curve.force[:start])
    # A zero is taken at the beginning of the rest, so that the force may have left it later.
    first = jumps[-1][0] if jumps else (start // 2 if is_zeroed else 0)
    rest_forces = drop_missing(curve.force[first:start])
    if len(rest_forces) < min_samples:
        return
    level, error = median(rest_forces), record.force_noise / sqrt(len(rest_forces))
    ratio = abs(level) / record.largest_force
    if abs(level) <= max(REST_ERROR_FACTOR * error, min_level * record.largest_force):
        return
    if ratio <= max(record.limits.rest_force, 2.0 * signals.raw[name].zero_drift):
        if not is_zeroed:
            yield record.report("process.rest_force", level=level, ratio=ratio)
    elif is_zeroed:
        yield record.report(
            "process.rest_force_left", "force_zero", at=first, level=level, ratio=ratio
        )
    else:
        yield record.report("process.rest_force_doubtful", "force_zero", level=level, ratio=ratio)


def _check_early_force(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that changes before the motion: its clock does not agree, or its zero jumps.

    The mean force of the last 0.2 s before the motion is compared with earlier means.
    """
    duration, min_change = 0.2, 2e-3  # s; fraction of the largest force
    min_means = 5
    signals, curve = record.signals, record.curve
    start = curve.branches[0].start
    size = start - int(np.searchsorted(curve.time, curve.time[start] - duration))
    has_one_clock = signals.raw[signals.force].clock == signals.raw[signals.displacement].clock
    if has_one_clock or start < (min_means + 1) * size or not size:
        return
    means = drop_missing(curve.force[start % size : start].reshape(-1, size).mean(axis=1))
    if len(means) <= min_means:
        return
    level = median(means[:-1])
    spread = 1.4826 * median(np.abs(means[:-1] - level))
    error = max(spread, record.force_noise / sqrt(size))
    change = float(means[-1] - level)
    if abs(change) > max(MIN_NOISE_RATIO * error, min_change * record.largest_force):
        ratio = abs(change) / record.largest_force
        yield record.report(
            "process.force_early", "clock", "force_zero", change=change, ratio=ratio
        )


def _check_rest_displacement(record: CheckedRecord) -> Iterator[Finding]:
    """Report the displacement before the motion if no step zeroes it."""
    min_level = 0.02  # fraction of the stroke
    signals, curve, name = record.signals, record.curve, record.signals.displacement
    level = float(curve.displacement[curve.branches[0].start])
    is_zeroed = name in {*signals.zero_stretches, *signals.moving_zero_stretches}
    if not is_zeroed and abs(level) > min_level * np.ptp(drop_missing(curve.displacement)):
        yield record.report("process.rest_displacement", channel="displacement", mm=1e3 * level)


def _check_force_level(record: CheckedRecord) -> list[Finding]:
    """Report a jump of the force or, without a jump, a drift of its zero."""
    return [*_check_force_jumps(record)] or [*_check_zero_drift(record)]


def _check_force_jumps(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force that a specimen cannot cause.

    Such a jump is a rise in loading, or any jump in unloading. If a converter overflows, the force
    jumps over the whole range of the record. One or two such jumps are an overflow only if they
    lead to the opposite force.
    """
    turn_reach = 3  # jumps within this many samples of a turn are ignored
    max_jumps = 2  # more jumps are attributed to the specimen, or are overflows
    min_overflow = 0.9  # fraction of the range of the force
    max_offset = 0.1  # of the forces before and after an overflow as a fraction of the jump
    force, sign = record.curve.force, record.compute_sign(record.curve.branches[0])
    all_jumps = _find_jumps(record, "force")
    min_size = min_overflow * np.ptp(drop_missing(force))
    overflows = [(sample, size) for sample, size in all_jumps if abs(size) > min_size]
    if len(overflows) <= max_jumps:
        overflows = [(i, size) for i, size in overflows if abs(force[i] / size - 0.5) < max_offset]
    # Each branch extends to the start of the next one, because it includes the rest after it.
    branches = record.curve.branches
    ends = [*(branch.start for branch in branches[1:]), branches[-1].stop]
    jumps = [
        (sample, size)
        for sample, size in all_jumps
        if any(
            branch.start + turn_reach < sample < end - turn_reach
            and abs(sample - branch.stop) > turn_reach
            for branch, end in zip(branches, ends, strict=True)
            if branch.direction is Direction.UNLOADING or sign * size > 0.0
        )
    ]
    if overflows:
        sample, size = overflows[0]
        yield record.report("process.overflow", "force", "displacement", at=sample, size=size)
    elif 0 < len(jumps) <= max_jumps:
        sample, size = jumps[0]
        segment = sample, -1
        yield record.report("process.force_jump", "force", at=sample, segment=segment, size=size)


def _check_partial_breaks(record: CheckedRecord) -> Iterator[Finding]:
    """Report sudden losses of force in loading that are larger than slips but are no breaks."""
    min_loss = 0.2  # fraction of the largest force before the loss
    min_carried = 0.5  # largest force after the loss as a fraction of the largest force before it
    min_regained = 0.25  # fraction of the loss; after a break the specimen regains nothing
    max_duration = 0.05  # s
    max_losses = 2  # more losses are attributed to the specimen
    curve, losses = record.curve, []
    n = 1  # number of steps between the samples from which a loss is computed
    if curve.time_unit == "s":
        n = max(1, int(max_duration / compute_median_step(curve.time)))
    for branch in curve.branches:
        if branch.direction is Direction.UNLOADING:
            continue
        force = record.compute_sign(branch) * curve.force[branch.start : branch.stop]
        largest_before = np.fmax.accumulate(force[:-n])
        largest_after = np.fmax.accumulate(force[: n - 1 : -1])[::-1]
        loss = force[:-n] - force[n:]
        relative_loss = loss / np.fmax(largest_before, 0.5 * record.largest_force)
        is_partial = (relative_loss > min_loss) & (largest_after >= min_carried * largest_before)
        is_partial &= largest_after - force[n:] >= min_regained * loss
        is_partial &= loss > MIN_NOISE_RATIO * record.force_noise
        samples = np.flatnonzero(is_partial)
        runs = np.split(samples, np.flatnonzero(np.diff(samples) > n) + 1) if len(samples) else []
        losses += [
            (branch.start + run[0], branch.start + run[-1] + n, relative_loss[run].max())
            for run in runs
        ]
    for first, last, largest_loss in losses if len(losses) <= max_losses else ():
        # The peak force is not doubtful, because the specimen was whole when it was reached.
        segment = first, last
        yield record.report(
            "process.partial_break", "displacement", at=first, segment=segment, loss=largest_loss
        )


def _check_zero_drift(record: CheckedRecord) -> Iterator[Finding]:
    """Report a change of the force at rest, if a test returns to its initial position.

    A specimen with friction or permanent set pushes back after unloading. A force against the
    direction of loading is therefore a drift only if the level also changes between cycles.
    """
    max_distance = 0.02  # from the initial position as a fraction of the stroke
    min_rest_samples = 3
    curve, first, last = record.curve, record.curve.branches[0], record.curve.branches[-1]
    first_rest = drop_missing(curve.force[: first.start])
    last_rest = drop_missing(curve.force[last.stop :])
    stroke = np.ptp(drop_missing(curve.displacement))
    distance = abs(curve.displacement[last.stop - 1] - curve.displacement[first.start])
    has_returned = last.direction is Direction.UNLOADING and distance <= max_distance * stroke
    if not has_returned or min(len(first_rest), len(last_rest)) < min_rest_samples:
        return
    branch_forces, first_level = curve.force[first.start : last.stop], median(first_rest)
    # Only the end of a long rest is used, because specimens relax.
    last_level = median(last_rest[-len(first_rest) :])
    largest_force = float(np.nanmax(np.abs(branch_forces - first_level)))
    error = record.force_noise * hypot(len(first_rest) ** -0.5, len(last_rest) ** -0.5)
    change = compute_loading_sign(branch_forces) * (last_level - first_level)
    if any(kind == "level" for kind, *_ in record.cycle_changes):
        change = abs(change)
    if change >= max(record.limits.rest_force_drift * largest_force, REST_ERROR_FACTOR * error):
        ratio = abs(change) / largest_force
        yield record.report(
            "process.zero_drift", "force", level=first_level, end=last_level, ratio=ratio
        )


def check_force_after_break(record: CheckedRecord, failure: object) -> Iterator[Finding]:
    """Report a force below zero after the specimen broke.

    Parameters
    ----------
    record : record of a test with its corrected curve
    failure : failure point of the test; there is no finding if it is of another type

    Notes
    -----
    A force above zero is allowed, because unbroken wires may still carry a load. A rebound of a few
    samples is also allowed.
    """
    min_tail_samples = 10  # fewer samples may be a rebound
    if not isinstance(failure, FailurePoint):
        return
    force, largest = record.curve.force, record.largest_force
    tail = drop_missing(force[failure.sample + 1 :])
    if len(tail) < min_tail_samples:
        return
    level, error = median(tail[len(tail) // 2 :]), record.force_noise * sqrt(2.0 / len(tail))
    reversed_force = -compute_loading_sign(force[: failure.sample + 1]) * level
    if reversed_force >= max(record.limits.rest_force_drift * largest, REST_ERROR_FACTOR * error):
        ratio = reversed_force / largest
        yield record.report("process.zero_drift_after_break", "force", level=level, ratio=ratio)


def _check_cycle_changes(record: CheckedRecord) -> Iterator[Finding]:
    """Report changes of scale, level or travel between cycles that an instrument caused.

    Such a change is the same in loading and unloading, whereas conditioning, hardening, fatigue
    and permanent set change the two differently. Unloading is also compared alone, because a first
    loading differs from all others. An offset of the displacement looks like one of the force, but
    it also shifts the turns.
    """
    for kind, size, old_cycle, new_cycle in record.cycle_changes:
        (old_travel, _), (new_travel, _) = old_cycle.paths[1], new_cycle.paths[1]
        max_shift = record.limits.cycle_change * (old_travel[-1] - old_travel[0])
        is_turn_shifted = abs(new_travel[-1] - old_travel[-1]) > max_shift
        is_force_alone = kind == "level" and not is_turn_shifted
        yield record.report(
            "process.cycle_level"
            if kind == "level"
            else ("process.cycle_scale" if kind == "scale" else "process.cycle_travel"),
            *(("force",) if is_force_alone else ("force", "displacement")),
            at=new_cycle.loading.start,
            segment=(old_cycle.unloading.stop - 1, -1),
            cycle=new_cycle.loading.cycle,
            size=size,
        )


def _find_cycle_change(
    record: CheckedRecord, old_cycle: Cycle, new_cycle: Cycle
) -> tuple[str, float] | None:
    """Find kind and size of a change between two cycles; None without a change.

    The kind is ``level``, with a size in N, or ``scale`` or ``travel``, with a ratio as size.
    """
    # Each limit applies to the misfit of the cycles as recorded divided by their misfit after a
    # change of scale or level has been removed. In 246 pairs of real and simulated cycles, in which
    # the material changes the shape of the curve, this ratio is at most 2.0 in complete cycles. In
    # unloading it is at most 4.0 for a scale and 6.2 for a level.
    min_cycle_ratio = 3.0
    cycle_limits = slice(None), min_cycle_ratio, min_cycle_ratio
    unloading_limits = slice(COMPARED_POINTS, None), 5.5, 8.0
    max_stroke_change = 0.05  # a longer cycle unloads along another path
    max_growth_ratio = 0.25  # growth of the force at the turn divided by that of the travel
    min_change = record.limits.cycle_change
    forces = _interpolate_common_forces(*old_cycle.paths, *new_cycle.paths)
    if not forces:
        return None
    old_forces, new_forces = np.concatenate(forces[:2]), np.concatenate(forces[2:])
    (old_travel, old_force), (new_travel, new_force) = old_cycle.paths[1], new_cycle.paths[1]
    is_longer = abs(np.ptp(new_travel) / np.ptp(old_travel) - 1.0) > max_stroke_change
    for points, min_scale_ratio, min_level_ratio in (
        () if is_longer else (cycle_limits, unloading_limits)
    ):
        old_values, new_values = old_forces[points], new_forces[points]
        misfit = compute_rms(new_values - old_values)
        scale = float(old_values @ new_values / (old_values @ old_values))
        level = float(np.mean(new_values - old_values))
        scale_misfit = compute_rms(new_values - scale * old_values)
        level_misfit = compute_rms(new_values - level - old_values)
        is_scaled = scale_misfit < level_misfit and abs(scale - 1.0) > min_change
        if is_scaled and misfit > min_scale_ratio * scale_misfit:
            return "scale", scale
        is_shifted = abs(level) > min_change * record.largest_force
        if is_shifted and misfit > min_level_ratio * level_misfit:
            return "level", level
    ratio = float(new_travel[-1] / old_travel[-1]) if old_travel[-1] > 0.0 else 1.0
    # Another scale of the travel does not change the force at the turn; a longer stroke does.
    growth = abs(float(new_force[-1] / old_force[-1]) - 1.0)
    is_longer_stroke = growth > max(min_change, max_growth_ratio * abs(ratio - 1.0))
    if abs(ratio - 1.0) < min_change or ratio <= 0.0 or is_longer_stroke:
        return None
    rescaled = _interpolate_common_forces((old_travel, old_force), (new_travel / ratio, new_force))
    if not rescaled:
        return None
    misfit = compute_rms(new_forces[COMPARED_POINTS:] - old_forces[COMPARED_POINTS:])
    rescaled_misfit = compute_rms(rescaled[1] - rescaled[0])
    return ("travel", ratio) if misfit >= min_cycle_ratio * rescaled_misfit else None


def _check_loading_directions(record: CheckedRecord) -> Iterator[Finding]:
    """Report the first branch of loading in which the force falls from a high to a low level."""
    min_fall, max_opposite_force = 0.5, 0.5  # fractions of the largest force
    curve = record.curve
    sign = record.compute_sign(curve.branches[0])
    if np.nanmin(sign * curve.force) < -max_opposite_force * record.largest_force:
        return
    for previous, branch in pairwise(curve.branches):
        force = sign * drop_missing(curve.force[branch.start : branch.stop])
        n_end = max(1, len(force) // 10)
        fall = median(force[:n_end]) - median(force[-n_end:]) if len(force) else 0.0
        if branch.direction is Direction.LOADING and fall > min_fall * record.largest_force:
            yield record.report(
                "process.loading_reversed",
                *("displacement", "force"),
                channel="displacement",
                at=branch.start,
                segment=(previous.start, -1),
                cycle=branch.cycle,
                ratio=fall / record.largest_force,
            )
            return


def _check_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that still grows after turns of the motion, because it lags or jumps."""
    curve, limits = record.curve, record.limits
    loading_sign = record.compute_sign(curve.branches[0])
    min_growth = MIN_NOISE_RATIO * record.force_noise
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
        # The turn lies between two samples, so that the force may grow by its mean step.
        mean_step = max(0.0, float(last_forces[-1] - last_forces[0])) / (len(last_forces) - 1)
        growths.append((next_branch, largest_after - largest_before - mean_step))
    if not growths:
        return
    median_growth = median(np.array([growth for _, growth in growths]))
    branch, growth = max(growths, key=lambda turn: turn[1])
    if median_growth > max(limits.force_lag * record.largest_force, min_growth):
        ratio = median_growth / record.largest_force
        yield record.report("process.force_late", "clock", growth=median_growth, ratio=ratio)
    elif growth > max(limits.turn_jump * record.largest_force, min_growth):
        yield record.report(
            "process.turn_jump",
            "force",
            at=branch.start,
            segment=(branch.start, -1),
            growth=growth,
            branch=branch,
        )


def _check_skipped_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force at one of several turns, where the recording was interrupted."""
    turn_reach = 3  # samples on each side of a turn
    min_step_ratio = 5.0  # largest step at a turn divided by that at the other turns
    curve, jumps = record.curve, dict(_find_jumps(record, "force"))
    for direction in Direction:
        turns = [
            range(max(second.start - turn_reach, 0), second.start + turn_reach + 1)
            for first, second in pairwise(curve.branches)
            if second.direction is direction and first.direction is not direction
        ]
        turn_forces = [curve.force[turn.start : turn.stop] for turn in turns]
        steps = [np.fmax.reduce(np.abs(np.diff(force)), initial=0.0) for force in turn_forces]
        for index, turn in enumerate(turns):
            other_steps = [*steps[:index], *steps[index + 1 :]]
            sample = next((sample for sample in turn if sample in jumps), None)
            if sample is None or not other_steps:
                continue
            if steps[index] > min_step_ratio * max(other_steps):
                yield record.report(
                    "process.turn_skipped",
                    *("displacement", "force"),
                    channel="displacement",
                    at=sample,
                    segment=(turn.start, min(turn.stop, len(curve.time)) - 1),
                    size=jumps[sample],
                )


def _check_force_clipping(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that is constant, apart from noise, on both sides of a turn.

    A specimen that yields loses force as soon as the motion turns.
    """
    turn_reaches = 0.1, 0.05, 0.03  # displacements on each side as fractions of the stroke
    min_level, max_error = 0.5, 0.1  # fractions of the largest force; the error is over the reach
    for cycle in () if record.is_saturated else record.cycles:
        for reach in turn_reaches:
            levels, error = _compare_levels(record, cycle, reach)
            level = float(levels.mean())
            is_limit = np.ptp(levels) < error < max_error * reach * record.largest_force
            if is_limit and abs(level) > min_level * record.largest_force:
                yield record.report(
                    "process.force_limited",
                    "force",
                    segment=(cycle.loading.start, cycle.unloading.stop - 1),
                    cycle=cycle.loading.cycle,
                    level=level,
                )
                break


def _compare_levels(record: CheckedRecord, cycle: Cycle, reach: float) -> tuple[Floats, float]:
    """Compute the mean forces of two pieces on each side of a turn, N, and their error, N.

    The error is four standard errors; it is infinite if a piece has fewer than 8 samples.
    """
    n_standard_errors, min_samples = 4.0, 8
    turn = record.curve.displacement[cycle.unloading.start]
    pieces = list[Floats]()
    for displacement, force in cycle.paths:
        is_near = np.abs(displacement - turn) < reach * np.ptp(displacement)
        pieces += np.array_split(force[is_near], 2)
    if min(map(len, pieces)) < min_samples:
        return np.zeros(len(pieces)), np.inf
    error = n_standard_errors * max(piece.std() / sqrt(len(piece)) for piece in pieces)
    return np.array([piece.mean() for piece in pieces]), error


def _check_held_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that grows and returns while the displacement is constant at a turn."""
    min_growth = 0.05  # fraction of the largest force
    curve = record.curve
    limit = max(min_growth * record.largest_force, MIN_NOISE_RATIO * record.force_noise)
    for first, second in () if record.is_saturated else pairwise(curve.branches):
        sign = record.compute_sign(first) * (1 if first.direction is Direction.LOADING else -1)
        turn_force = drop_missing(sign * curve.force[first.stop - 1 : second.start + 1])
        if not len(turn_force):
            continue
        growth = float(turn_force.max() - max(turn_force[0], turn_force[-1]))
        if growth > limit:
            turn = first.stop - 1
            yield record.report(
                "process.displacement_limited",
                "displacement",
                channel="displacement",
                at=turn,
                segment=(first.start, second.stop - 1),
                growth=growth,
                position=1e3 * curve.displacement[turn],
            )


def _check_jump_to_peak(record: CheckedRecord) -> Iterator[Finding]:
    """Report a largest force that is reached by a jump and lost just after it."""
    reach = 3  # samples of the jump, of the steps before it, and of the loss after it
    min_step_ratio = 5.0  # jump divided by the largest step before it
    min_jump, max_remaining = 0.02, 0.5  # fractions of the largest force
    curve = record.curve
    force = record.compute_sign(curve.branches[0]) * curve.force
    peak = int(np.nanargmax(force))
    steps = np.diff(force[max(0, peak - 2 * reach) : peak + 1])
    forces_after = force[peak + 1 : peak + 1 + reach]
    if len(steps) < 2 * reach or not len(forces_after):
        return
    jump = float(np.max(steps[reach:]))
    limit = max(
        min_step_ratio * float(np.max(np.abs(steps[:reach]))),
        min_jump * record.largest_force,
        MIN_NOISE_RATIO * record.force_noise,
    )
    if jump > limit and float(np.min(forces_after)) < max_remaining * force[peak]:
        segment = peak - reach, peak
        yield record.report("process.last_rise", "force", at=peak, segment=segment, size=jump)


def _check_gaps_at_peaks(record: CheckedRecord) -> Iterator[Finding]:
    """Report a gap in the times at a turn or at the largest force, where a peak may be missing."""
    min_step_ratio, step_quantile = 5.0, 0.98  # gap over the usual step, which is a quantile
    # In a time as long as the gap, just before it, the motion must exceed both of these.
    min_travel, min_noise_ratio = 0.005, 6.0  # fraction of the range; multiple of the noise
    peak_reach = 5  # samples between gap and peak, because noise shifts the largest sample
    curve = record.curve
    time, travel = curve.time, curve.displacement
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > min_step_ratio * np.quantile(steps, step_quantile))
    peaks = [second.start for _, second in pairwise(curve.branches)]
    peaks.append(int(np.nanargmax(np.abs(curve.force))))
    travel_limit = min_travel * np.ptp(drop_missing(travel))
    noise_limit = min_noise_ratio * estimate_noise_level(travel)
    for gap in gaps.tolist():
        is_at_peak = min(abs(gap - peak) for peak in peaks) <= peak_reach
        travel_before = abs(travel[gap] - travel[np.searchsorted(time, time[gap] - steps[gap])])
        if is_at_peak and travel_before > max(travel_limit, noise_limit):
            first, last = max(gap - peak_reach, 0), min(gap + peak_reach + 1, len(time) - 1)
            yield record.report(
                "process.peak_in_hole",
                *("displacement", "force"),
                channel="displacement",
                at=gap,
                segment=(first, last),
                length=steps[gap],
            )


def _check_energy(record: CheckedRecord) -> Iterator[Finding]:
    """Report cycles in which the specimen returns more energy than it received."""
    gains = []
    for cycle in record.cycles:
        forces = _interpolate_common_forces(*cycle.paths)
        # Mean forces at equidistant displacements are proportional to energies.
        work_in = float(np.mean(np.abs(forces[0]))) if forces else 0.0
        if work_in:
            work_lost = record.compute_sign(cycle.loading) * float(np.mean(forces[0] - forces[1]))
            gain = -work_lost / work_in
            gains += [(cycle, gain)] if gain > record.limits.energy_gain else []
    # If most cycles gain energy, columns may be exchanged, or the record may be reversed.
    affects_most_cycles = len(gains) > len(record.cycles) / 2
    quantities = ("force", "displacement", "clock") if affects_most_cycles else ("force",)
    for cycle, gain in gains[:1] if affects_most_cycles else gains:
        segment = cycle.loading.start + 1, cycle.unloading.stop - 2
        yield record.report(
            "process.energy_gained",
            *quantities,
            segment=None if affects_most_cycles else segment,
            cycle=cycle.loading.cycle,
            gain=gain,
        )


def _check_second_specimen(record: CheckedRecord) -> Iterator[Finding]:
    """Report a record that continues with another specimen after the first one broke."""
    force_quantile = 0.8  # a broken specimen carries almost no force in 80 % of the unloading
    branches, limits = record.curve.branches, record.limits
    for cycle in record.cycles:
        next_branch = next((x for x in branches if x.start >= cycle.unloading.stop), None)
        paths = (*cycle.paths, _make_path(record.curve, next_branch)) if next_branch else ()
        forces = _interpolate_common_forces(*paths) if paths else ()
        if next_branch is None or not forces:
            continue
        first_force, unloading_force, second_force = (
            float(np.quantile(np.abs(force), force_quantile)) for force in forces
        )
        is_broken = unloading_force < limits.broken_force * first_force
        if is_broken and second_force > limits.second_loading * first_force:
            yield record.report(
                "process.second_specimen",
                *("force", "displacement"),
                cycle=cycle.loading.cycle,
                unloading_force=unloading_force,
                next_cycle=next_branch.cycle,
                second_force=second_force,
            )
            return


_CHECKS = (
    _check_displacement_jumps,
    _check_rest_force,
    _check_early_force,
    _check_rest_displacement,
    _check_force_level,
    _check_partial_breaks,
    _check_cycle_changes,
    _check_loading_directions,
    _check_turns,
    _check_skipped_turns,
    _check_force_clipping,
    _check_held_turns,
    _check_jump_to_peak,
    _check_gaps_at_peaks,
    _check_energy,
    _check_second_specimen,
)
"""Checks in the order of their findings; all but the first need a force that is not zero."""


def compute_rms(values: Floats) -> float:
    """Compute the root mean square of the values that are not NaN; NaN if there are none."""
    valid = drop_missing(values)
    return float(np.sqrt(np.mean(valid**2))) if len(valid) else float("nan")
