"""Check whether cycles, rests, force and displacement of a record agree with each other.

Each check compares one statistic with one threshold. The threshold is above the largest statistic
of all sound records of real and simulated tests (docs/explanations/intervals.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf, sqrt
from typing import Any, Literal, TypeAlias

import numpy as np

from labpipe.records.arrays import (
    Floats,
    average_blocks,
    compute_median_step,
    drop_missing,
    median,
)
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
MIN_ERROR_RATIO, MIN_REST_ERROR_RATIO = 8.0, 6.0
"""Smallest changes of the force that are reported, divided by their standard errors: changes in the
motion or between cycles, and levels at rest."""
TURN_REACH = 3
"""Number of samples on each side of a turn that belong to it."""

Quantity: TypeAlias = Literal["force", "displacement"]
BOTH: tuple[Quantity, Quantity] = ("displacement", "force")
"""Quantities that are doubtful if the displacement is wrong, because it separates the branches."""
Path: TypeAlias = tuple[Floats, Floats]
"""Block means of displacement (m, increasing) and force (N) of a branch."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """A loading and the unloading that follows it.

    Parameters
    ----------
    loading, unloading : branches of the curve
    paths : path of the loading, and path of the unloading
    """

    loading: Branch
    unloading: Branch
    paths: tuple[Path, Path]


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
    def travel_range(self) -> float:
        """Return the difference between the largest and the smallest displacement, m."""
        return float(np.ptp(drop_missing(self.curve.displacement)))

    @cached_property
    def force_noise(self) -> float:
        """Return the standard deviation of the noise of the force, N."""
        return estimate_noise_level(self.curve.force)

    @cached_property
    def loading_sign(self) -> float:
        """Return the sign of the force in the first branch."""
        return self.compute_sign(self.curve.branches[0])

    @cached_property
    def turns(self) -> list[tuple[Branch, Branch, float]]:
        """Return the branches before and after each turn, and the sign of the force's growth.

        The force times this sign increases up to the turn.
        """
        sign = self.loading_sign
        return [
            (first, second, sign if first.direction is Direction.LOADING else -sign)
            for first, second in pairwise(self.curve.branches)
            if first.direction is not second.direction
        ]

    @cached_property
    def cycles(self) -> list[Cycle]:
        """Return the complete cycles with enough samples."""
        cycles = [
            Cycle(first, second, (_make_path(self.curve, first), _make_path(self.curve, second)))
            for first, second in pairwise(self.curve.branches)
            if first.direction is Direction.LOADING and second.cycle == first.cycle
        ]
        return [
            cycle
            for cycle in cycles
            if min(len(force) for _, force in cycle.paths) >= MIN_COMPARED_SAMPLES
        ]

    @cached_property
    def cycle_changes(self) -> list[tuple[str, float, Cycle, Cycle]]:
        """Return the changes between consecutive cycles.

        Each has its kind and size, as in `_find_cycle_change`, and the earlier and later cycle.
        """
        changes = [(_find_cycle_change(self, *pair), pair) for pair in pairwise(self.cycles)]
        return [(*change, *pair) for change, pair in changes if change is not None]

    def compute_sign(self, branch: Branch) -> float:
        """Compute the sign of the force with which the specimen is loaded in a branch."""
        return compute_loading_sign(self.curve.force[branch.start : branch.stop])

    def compute_limit(
        self, fraction: float, error: float, min_error_ratio: float = MIN_ERROR_RATIO
    ) -> float:
        """Compute the smallest change of the force that is reported, N.

        Parameters
        ----------
        fraction : smallest change as a fraction of the largest force
        error : standard error of the change, N
        min_error_ratio : smallest change divided by its standard error
        """
        return max(fraction * self.largest_force, min_error_ratio * error)

    def find_jumps(self, quantity: Quantity) -> list[tuple[int, float]]:
        """Find the sample and the size of each jump of a quantity.

        Jumps at the end of a stretch in which the channel is frozen are left out.
        """
        max_distance = 2  # samples between a jump and the end of a frozen stretch
        time = self.curve.time
        frozen_ends = [
            int(np.searchsorted(time, doubt.period[1]))
            for finding in self.earlier_findings.entries
            for doubt in finding.doubts
            if finding.code == "frozen_channel" and doubt.quantity == quantity and doubt.period
        ]
        return [
            (sample, size)
            for sample, size in find_level_jumps(time, getattr(self.curve, quantity))
            if all(abs(sample - end) > max_distance for end in frozen_ends)
        ]

    def report(
        self,
        name: str,
        *quantities: str,
        channel: Quantity = "force",
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


def _make_path(curve: Curve, branch: Branch) -> Path:
    """Average a branch over at least 400 blocks if it has as many samples, and sort the means."""
    min_blocks = 400
    rows = slice(branch.start, branch.stop)
    samples = np.stack([curve.displacement[rows], curve.force[rows]])
    samples = samples[:, ~np.isnan(samples).any(axis=0)]
    means = np.stack([average_blocks(values, min_blocks) for values in samples])
    displacement, force = means[:, np.argsort(means[0], kind="stable")]
    return displacement, force


def _interpolate_common_forces(*paths: Path) -> list[Floats]:
    """Interpolate the forces of paths over their common range of displacement.

    The result is empty if a path has too few samples, or if the common range is too small compared
    with the combined range.
    """
    min_common_fraction = 0.5  # of the combined range
    if min(len(force) for _, force in paths) < MIN_COMPARED_SAMPLES:
        return []
    starts, ends = [path[0][0] for path in paths], [path[0][-1] for path in paths]
    if not min(ends) - max(starts) > min_common_fraction * (max(ends) - min(starts)):
        return []
    displacements = np.linspace(max(starts), min(ends), COMPARED_POINTS + 2)[1:-1]
    return [np.interp(displacements, *path) for path in paths]


def _check_displacement_jumps(record: CheckedRecord) -> Iterator[Finding]:
    """Report jumps and outliers of the displacement, except a single jump at a break."""
    min_break_drop = 0.3  # drop of the force at a break as a fraction of the largest force
    min_outlier = 0.02  # fraction of the range of the displacement
    displacement, force = record.curve.displacement, np.abs(record.curve.force)
    deviations = displacement - bridge_spikes(displacement, find_spikes(displacement))
    outliers = np.flatnonzero(np.abs(deviations) > min_outlier * record.travel_range)
    jumps = [(sample, float(deviations[sample])) for sample in outliers.tolist()]
    jumps += record.find_jumps("displacement")
    if not jumps:
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    is_break = force[sample - 1] - force[sample] > min_break_drop * record.largest_force
    if len(jumps) > 1 or not is_break:
        facts: dict[str, Any] = {"mm": 1e3 * size, "count": len(jumps)}
        yield record.report("process.zero_jump", *BOTH, channel="displacement", at=sample, **facts)


def _check_rest_levels(record: CheckedRecord) -> Iterator[Finding]:
    """Report force and displacement before the motion if no step zeroes them.

    A force that is zeroed is reported if it leaves its zero before the motion.
    """
    min_samples = 8
    min_force, min_displacement = 1e-4, 0.02  # fractions of the largest force and of the stroke
    signals, curve, start = record.signals, record.curve, record.curve.branches[0].start
    is_zeroed = signals.is_zeroed(signals.force)
    jumps = find_level_jumps(curve.time[:start], curve.force[:start])
    # A zero is taken at the beginning of the rest, so that the force may have left it later.
    first = jumps[-1][0] if jumps else (start // 2 if is_zeroed else 0)
    rest_forces = drop_missing(curve.force[first:start])
    level, count = median(rest_forces), max(1, len(rest_forces))
    ratio, error = abs(level) / record.largest_force, record.force_noise / sqrt(count)
    limit = record.compute_limit(min_force, error, MIN_REST_ERROR_RATIO)
    if count >= min_samples and abs(level) > limit:
        is_small = ratio <= max(
            record.limits.rest_force, 2.0 * signals.raw[signals.force].zero_drift
        )
        facts: dict[str, Any] = {"level": level, "ratio": ratio}
        if is_small and not is_zeroed:
            yield record.report("process.rest_force", **facts)
        elif not is_zeroed:
            yield record.report("process.rest_force_doubtful", "force_zero", **facts)
        elif not is_small:
            yield record.report("process.rest_force_left", "force_zero", at=first, **facts)
    mm, stroke = 1e3 * float(curve.displacement[start]), 1e3 * record.travel_range
    if not signals.is_zeroed(signals.displacement) and abs(mm) > min_displacement * stroke:
        yield record.report("process.rest_displacement", channel="displacement", mm=mm)


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
    error, change = max(spread, record.force_noise / sqrt(size)), float(means[-1] - level)
    if abs(change) > record.compute_limit(min_change, error):
        facts: dict[str, Any] = {"change": change, "ratio": abs(change) / record.largest_force}
        yield record.report("process.force_early", "clock", "force_zero", **facts)


def _check_force_level(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force that a specimen cannot cause; otherwise a drift of its zero.

    Such a jump is a rise in loading, or any jump in unloading. If a converter overflows, the force
    jumps over the whole range of the record. One or two such jumps are an overflow only if they
    lead to the opposite force.
    """
    max_jumps = 2  # more jumps are attributed to the specimen, or are overflows
    min_overflow = 0.9  # fraction of the range of the force
    max_offset = 0.1  # of the forces before and after an overflow as a fraction of the jump
    force, branches = record.curve.force, record.curve.branches
    all_jumps = record.find_jumps("force")
    min_size = min_overflow * np.ptp(drop_missing(force))
    overflows = [(sample, size) for sample, size in all_jumps if abs(size) > min_size]
    if len(overflows) <= max_jumps:
        overflows = [(i, size) for i, size in overflows if abs(force[i] / size - 0.5) < max_offset]
    # Each branch extends to the start of the next one, because it includes the rest after it.
    ends = [*(branch.start for branch in branches[1:]), branches[-1].stop]
    jumps = [
        (sample, size)
        for branch, end in zip(branches, ends, strict=True)
        for sample, size in all_jumps
        if branch.start + TURN_REACH < sample < end - TURN_REACH
        and abs(sample - branch.stop) > TURN_REACH
        and (branch.direction is Direction.UNLOADING or record.loading_sign * size > 0.0)
    ]
    if overflows:
        sample, size = overflows[0]
        yield record.report("process.overflow", "force", "displacement", at=sample, size=size)
    elif 0 < len(jumps) <= max_jumps:
        sample, size = jumps[0]
        segment = sample, -1
        yield record.report("process.force_jump", "force", at=sample, segment=segment, size=size)
    else:
        yield from _check_zero_drift(record)


def _check_zero_drift(record: CheckedRecord) -> Iterator[Finding]:
    """Report a change of the force at rest, if a test returns to its initial position.

    A specimen with friction or permanent set pushes back after unloading. A force against the
    direction of loading is therefore a drift only if the level also changes between cycles.
    """
    max_distance = 0.02  # from the initial position as a fraction of the stroke
    min_rest_samples = 3
    curve, first, last = record.curve, record.curve.branches[0], record.curve.branches[-1]
    rests = [drop_missing(rest) for rest in (curve.force[: first.start], curve.force[last.stop :])]
    count = min(map(len, rests))
    distance = abs(curve.displacement[last.stop - 1] - curve.displacement[first.start])
    has_returned = distance <= max_distance * record.travel_range
    if last.direction is Direction.LOADING or not has_returned or count < min_rest_samples:
        return
    # Only the end of a long rest is used, because specimens relax.
    level, end = median(rests[0]), median(rests[1][-len(rests[0]) :])
    branch_forces = curve.force[first.start : last.stop]
    change = compute_loading_sign(branch_forces) * (end - level)
    if any(kind == "level" for kind, *_ in record.cycle_changes):
        change = abs(change)
    largest_force = float(np.nanmax(np.abs(branch_forces - level)))
    error = record.force_noise * sqrt(2.0 / count)
    if change >= max(record.limits.rest_force_drift * largest_force, MIN_REST_ERROR_RATIO * error):
        facts: dict[str, Any] = {"level": level, "end": end, "ratio": abs(change) / largest_force}
        yield record.report("process.zero_drift", "force", **facts)


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
    force = record.curve.force
    tail = drop_missing(force[failure.sample + 1 :])
    if len(tail) < min_tail_samples:
        return
    level, error = median(tail[len(tail) // 2 :]), record.force_noise * sqrt(2.0 / len(tail))
    reversed_force = -compute_loading_sign(force[: failure.sample + 1]) * level
    limit = record.compute_limit(record.limits.rest_force_drift, error, MIN_REST_ERROR_RATIO)
    if reversed_force >= limit:
        facts: dict[str, Any] = {"level": level, "ratio": reversed_force / record.largest_force}
        yield record.report("process.zero_drift_after_break", "force", **facts)


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
        is_partial &= loss > MIN_ERROR_RATIO * record.force_noise
        samples = np.flatnonzero(is_partial)
        for run in np.split(samples, np.flatnonzero(np.diff(samples) > n) + 1):
            if len(run):
                segment = branch.start + run[0], branch.start + run[-1] + n
                losses.append((segment, relative_loss[run].max()))
    for segment, loss in losses if len(losses) <= max_losses else ():
        # The peak force is not doubtful, because the specimen was whole when it was reached.
        facts: dict[str, Any] = {"at": segment[0], "segment": segment, "loss": loss}
        yield record.report("process.partial_break", "displacement", **facts)


def _check_cycle_changes(record: CheckedRecord) -> Iterator[Finding]:
    """Report changes of scale, level or travel between cycles that an instrument caused.

    Such a change is the same in loading and unloading, whereas conditioning, hardening, fatigue
    and permanent set change the two differently. Unloading is also compared alone, because a first
    loading differs from all others. An offset of the displacement looks like one of the force, but
    it also shifts the turns.
    """
    for kind, size, old_cycle, new_cycle in record.cycle_changes:
        old_travel, new_travel = (cycle.paths[1][0] for cycle in (old_cycle, new_cycle))
        max_shift = record.limits.cycle_change * (old_travel[-1] - old_travel[0])
        is_turn_shifted = abs(new_travel[-1] - old_travel[-1]) > max_shift
        is_force_alone = kind == "level" and not is_turn_shifted
        facts: dict[str, Any] = {"cycle": new_cycle.loading.cycle, "size": size}
        facts |= {"at": new_cycle.loading.start, "segment": (old_cycle.unloading.stop - 1, -1)}
        quantities = ("force",) if is_force_alone else BOTH
        if kind == "level":
            yield record.report("process.cycle_level", *quantities, **facts)
        elif kind == "scale":
            yield record.report("process.cycle_scale", *quantities, **facts)
        else:
            yield record.report("process.cycle_travel", *quantities, **facts)


def _find_cycle_change(
    record: CheckedRecord, old_cycle: Cycle, new_cycle: Cycle
) -> tuple[str, float] | None:
    """Find kind and size of a change between two cycles; None without a change.

    The kind is ``level``, with a size in N, or ``scale`` or ``travel``, with the ratio of the later
    to the earlier cycle as size.
    """
    # Each limit applies to the misfit of the cycles as recorded divided by their misfit after a
    # change of scale or level has been removed. In 246 pairs of real and simulated cycles, in which
    # the material changes the shape of the curve, this ratio is at most 2.0 in complete cycles. In
    # unloading it is at most 4.0 for a scale and 6.2 for a level.
    min_cycle_ratio, min_unloading_scale_ratio, min_unloading_level_ratio = 3.0, 5.5, 8.0
    unloading = slice(COMPARED_POINTS, None)
    comparisons = (
        (slice(None), min_cycle_ratio, min_cycle_ratio),
        (unloading, min_unloading_scale_ratio, min_unloading_level_ratio),
    )
    max_stroke_change = 0.05  # a longer cycle unloads along another path
    max_growth_ratio = 0.25  # growth of the force at the turn divided by that of the travel
    min_change = record.limits.cycle_change
    forces = _interpolate_common_forces(*old_cycle.paths, *new_cycle.paths)
    if not forces:
        return None
    all_old, all_new = np.concatenate(forces[:2]), np.concatenate(forces[2:])
    (old_travel, old_force), (new_travel, new_force) = old_cycle.paths[1], new_cycle.paths[1]
    is_longer = abs(np.ptp(new_travel) / np.ptp(old_travel) - 1.0) > max_stroke_change
    for points, min_scale_ratio, min_level_ratio in () if is_longer else comparisons:
        old, new = all_old[points], all_new[points]
        scale, level = float(old @ new / (old @ old)), float(np.mean(new - old))
        misfit, scale_misfit = compute_rms(new - old), compute_rms(new - scale * old)
        level_misfit = compute_rms(new - level - old)
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
    rescaled_path = new_travel / ratio, new_force
    rescaled_forces = _interpolate_common_forces(old_cycle.paths[1], rescaled_path)
    rescaled_misfit = compute_rms(np.diff(rescaled_forces, axis=0)) if rescaled_forces else inf
    misfit = compute_rms(all_new[unloading] - all_old[unloading])
    return ("travel", ratio) if misfit >= min_cycle_ratio * rescaled_misfit else None


def _check_loading_directions(record: CheckedRecord) -> Iterator[Finding]:
    """Report the first branch of loading in which the force falls from a high to a low level."""
    min_fall, max_opposite_force = 0.5, 0.5  # fractions of the largest force
    force = record.loading_sign * record.curve.force
    if np.nanmin(force) < -max_opposite_force * record.largest_force:
        return
    for previous, branch in pairwise(record.curve.branches):
        branch_force = drop_missing(force[branch.start : branch.stop])
        n_end = max(1, len(branch_force) // 10)
        fall = median(branch_force[:n_end]) - median(branch_force[-n_end:])
        if branch.direction is Direction.LOADING and fall > min_fall * record.largest_force:
            facts: dict[str, Any] = {"cycle": branch.cycle, "ratio": fall / record.largest_force}
            facts |= {"at": branch.start, "segment": (previous.start, -1)}
            yield record.report("process.loading_reversed", *BOTH, channel="displacement", **facts)
            return


def _check_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that still grows after turns of the motion, because it lags or jumps."""
    limits, min_samples = record.limits, 3
    growths = []
    for branch, next_branch, sign in record.turns:
        force_before = sign * record.curve.force[branch.start : branch.stop]
        force_after = sign * record.curve.force[next_branch.start : next_branch.stop]
        last_forces = drop_missing(force_before[-max(min_samples, len(force_before) // 10) :])
        first_forces = drop_missing(force_after[: max(min_samples, len(force_after) // 10)])
        n_samples = min(len(last_forces), len(first_forces))
        if n_samples < min_samples:
            continue
        width = max(1, n_samples // 10)
        largest_before, largest_after = (
            float(np.convolve(forces, np.ones(width) / width, "valid").max())
            for forces in (last_forces, first_forces)
        )
        # The turn lies between two samples, so that the force may grow by its mean step.
        mean_step = max(0.0, float(last_forces[-1] - last_forces[0])) / (len(last_forces) - 1)
        growths.append((largest_after - largest_before - mean_step, next_branch))
    if not growths:
        return
    median_growth = median(np.array([growth for growth, _ in growths]))
    growth, branch = max(growths, key=lambda turn: turn[0])
    if median_growth > record.compute_limit(limits.force_lag, record.force_noise):
        facts: dict[str, Any] = {
            "growth": median_growth,
            "ratio": median_growth / record.largest_force,
        }
        yield record.report("process.force_late", "clock", **facts)
    elif growth > record.compute_limit(limits.turn_jump, record.force_noise):
        facts = {"growth": growth, "branch": branch}
        facts |= {"at": branch.start, "segment": (branch.start, -1)}
        yield record.report("process.turn_jump", "force", **facts)


def _check_skipped_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force at one of several turns, where the recording was interrupted."""
    min_step_ratio = 5.0  # largest step at a turn divided by that at the other turns
    curve, jumps = record.curve, dict(record.find_jumps("force"))
    for direction in Direction:
        turns = [
            range(max(second.start - TURN_REACH, 0), second.start + TURN_REACH + 1)
            for _, second, _ in record.turns
            if second.direction is direction
        ]
        turn_forces = [curve.force[turn.start : turn.stop] for turn in turns]
        steps = [np.fmax.reduce(np.abs(np.diff(force)), initial=0.0) for force in turn_forces]
        for index, turn in enumerate(turns):
            other_steps = [*steps[:index], *steps[index + 1 :]]
            sample = next((sample for sample in turn if sample in jumps), None)
            is_interrupted = steps[index] > min_step_ratio * max(other_steps, default=inf)
            if sample is not None and is_interrupted:
                segment = turn.start, min(turn.stop, len(curve.time)) - 1
                facts: dict[str, Any] = {"at": sample, "size": jumps[sample], "segment": segment}
                yield record.report("process.turn_skipped", *BOTH, channel="displacement", **facts)


def _check_force_clipping(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that is constant, apart from noise, on both sides of a turn.

    A specimen that yields loses force as soon as the motion turns. Two pieces on each side of the
    turn have the same mean force within four standard errors.
    """
    turn_reaches = 0.1, 0.05, 0.03  # displacements on each side as fractions of the stroke
    min_level, max_error = 0.5, 0.1  # fractions of the largest force; the error is over the reach
    n_standard_errors, min_piece_samples = 4.0, 8
    for cycle in record.cycles:
        turn = record.curve.displacement[cycle.unloading.start]
        for reach in turn_reaches:
            pieces = list[Floats]()
            for displacement, force in cycle.paths:
                is_near = np.abs(displacement - turn) < reach * np.ptp(displacement)
                pieces += np.array_split(force[is_near], 2)
            if min(map(len, pieces)) < min_piece_samples:
                break
            error = n_standard_errors * max(piece.std() / sqrt(len(piece)) for piece in pieces)
            levels = [float(piece.mean()) for piece in pieces]
            level, is_level = float(np.mean(levels)), np.ptp(levels) < error
            is_precise = error < max_error * reach * record.largest_force
            if is_level and is_precise and abs(level) > min_level * record.largest_force:
                facts: dict[str, Any] = {"cycle": cycle.loading.cycle, "level": level}
                segment = cycle.loading.start, cycle.unloading.stop - 1
                yield record.report("process.force_limited", "force", segment=segment, **facts)
                break


def _check_held_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that grows and returns while the displacement is constant at a turn."""
    min_growth = 0.05  # fraction of the largest force
    curve = record.curve
    for first, second, _ in record.turns:
        # A damper reverses its force at a turn, so that each branch has a sign of its own.
        sign = record.compute_sign(first) * (1 if first.direction is Direction.LOADING else -1)
        turn = first.stop - 1
        force = drop_missing(sign * curve.force[turn : second.start + 1])
        growth = float(force.max() - max(force[0], force[-1])) if len(force) else 0.0
        if growth > record.compute_limit(min_growth, record.force_noise):
            facts: dict[str, Any] = {"growth": growth, "position": 1e3 * curve.displacement[turn]}
            facts |= {"at": turn, "segment": (first.start, second.stop - 1)}
            doubted: Quantity = "displacement"
            yield record.report("process.displacement_limited", doubted, channel=doubted, **facts)


def _check_saturation(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force or a displacement that is limited at turns, unless a channel is saturated."""
    if not any(finding.code == "saturation" for finding in record.earlier_findings.entries):
        yield from _check_force_clipping(record)
        yield from _check_held_turns(record)


def _check_jump_to_peak(record: CheckedRecord) -> Iterator[Finding]:
    """Report a largest force that is reached by a jump and lost just after it."""
    min_step_ratio = 5.0  # jump divided by the largest step before it
    min_jump, max_remaining = 0.02, 0.5  # fractions of the largest force
    reach = 3  # number of samples before and after the jump
    force = record.loading_sign * record.curve.force
    peak = int(np.nanargmax(force))
    steps = np.diff(force[max(0, peak - 2 * reach) : peak + 1])
    forces_after = force[peak + 1 : peak + 1 + reach]
    if len(steps) < 2 * reach or not len(forces_after):
        return
    jump, largest_step = float(steps[reach:].max()), np.abs(steps[:reach]).max()
    limit = record.compute_limit(min_jump, record.force_noise)
    is_lost = float(np.min(forces_after)) < max_remaining * force[peak]
    if is_lost and jump > max(limit, min_step_ratio * float(largest_step)):
        segment = peak - reach, peak
        yield record.report("process.last_rise", "force", at=peak, segment=segment, size=jump)


def _check_gaps_at_peaks(record: CheckedRecord) -> Iterator[Finding]:
    """Report a gap in the times at a turn or at the largest force, where a peak may be missing."""
    min_step_ratio, step_quantile = 5.0, 0.98  # gap over the usual step, which is a quantile
    # In a time as long as the gap, just before it, the motion must exceed both of these.
    min_travel, min_noise_ratio = 0.005, 6.0  # fraction of the range; multiple of the noise
    peak_reach = 5  # samples between gap and peak, because noise shifts the largest sample
    time, travel = record.curve.time, record.curve.displacement
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > min_step_ratio * np.quantile(steps, step_quantile))
    peaks = [second.start for _, second in pairwise(record.curve.branches)]
    peaks.append(int(np.nanargmax(np.abs(record.curve.force))))
    noise = estimate_noise_level(travel)
    travel_limit = max(min_travel * record.travel_range, min_noise_ratio * noise)
    for gap in gaps.tolist():
        is_at_peak = min(abs(gap - peak) for peak in peaks) <= peak_reach
        travel_before = abs(travel[gap] - travel[np.searchsorted(time, time[gap] - steps[gap])])
        if is_at_peak and travel_before > travel_limit:
            segment = max(gap - peak_reach, 0), min(gap + peak_reach + 1, len(time) - 1)
            facts: dict[str, Any] = {"at": gap, "length": steps[gap], "segment": segment}
            yield record.report("process.peak_in_hole", *BOTH, channel="displacement", **facts)


def _check_energy(record: CheckedRecord) -> Iterator[Finding]:
    """Report cycles in which the specimen returns more energy than it received."""
    gains = []
    for cycle in record.cycles:
        forces = _interpolate_common_forces(*cycle.paths)
        # Mean forces at equidistant displacements are proportional to energies.
        work_in = float(np.mean(np.abs(forces[0]))) if forces else 0.0
        if work_in:
            work_lost = record.compute_sign(cycle.loading) * float(np.mean(forces[0] - forces[1]))
            gains.append((-work_lost / work_in, cycle))
    gains = [(gain, cycle) for gain, cycle in gains if gain > record.limits.energy_gain]
    # If most cycles gain energy, columns may be exchanged, or the record may be reversed.
    affects_most_cycles = len(gains) > len(record.cycles) / 2
    quantities = ("force", "displacement", "clock") if affects_most_cycles else ("force",)
    for gain, cycle in gains[:1] if affects_most_cycles else gains:
        segment = cycle.loading.start + 1, cycle.unloading.stop - 2
        facts: dict[str, Any] = {
            "segment": None if affects_most_cycles else segment,
            "cycle": cycle.loading.cycle,
        }
        yield record.report("process.energy_gained", *quantities, gain=gain, **facts)


def _check_second_specimen(record: CheckedRecord) -> Iterator[Finding]:
    """Report a record that continues with another specimen after the first one broke."""
    force_quantile = 0.8  # a broken specimen carries almost no force in 80 % of the unloading
    limits = record.limits
    for cycle in record.cycles:
        later = [x for x in record.curve.branches if x.start >= cycle.unloading.stop]
        paths = [*cycle.paths, *(_make_path(record.curve, branch) for branch in later[:1])]
        forces = _interpolate_common_forces(*paths) if later else ()
        if not forces:
            continue
        first_force, unloading_force, second_force = (
            float(np.quantile(np.abs(force), force_quantile)) for force in forces
        )
        is_broken = unloading_force < limits.broken_force * first_force
        if is_broken and second_force > limits.second_loading * first_force:
            facts: dict[str, Any] = {"cycle": cycle.loading.cycle, "next_cycle": later[0].cycle}
            facts |= {"unloading_force": unloading_force, "second_force": second_force}
            yield record.report("process.second_specimen", *BOTH, **facts)
            return


_CHECKS = (
    _check_displacement_jumps,
    _check_rest_levels,
    _check_early_force,
    _check_force_level,
    _check_partial_breaks,
    _check_cycle_changes,
    _check_loading_directions,
    _check_turns,
    _check_skipped_turns,
    _check_saturation,
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
