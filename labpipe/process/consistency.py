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

from labpipe.records.arrays import Floats, average_blocks, compute_median_step, drop_missing, median
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import Limits
from labpipe.records.quality import Finding, Findings
from labpipe.records.signals import Signals
from labpipe.results.kinds import FailurePoint, compute_loading_sign
from labpipe.signal.bad_samples import bridge_spikes, find_spikes
from labpipe.signal.turning_points import estimate_noise_level, find_level_jumps

N_COMPARED_DISPLACEMENTS = 40
"""Number of displacements at which the forces of two or more branches are compared."""
MIN_PATH_POINTS = 5
"""Smallest number of points of a branch path that is compared."""
MIN_CHANGE_ERROR_RATIO, MIN_REST_ERROR_RATIO = 8.0, 6.0
"""Smallest reported change of the force divided by its standard error.

The first applies in the motion and between cycles, the second to levels and changes at rest."""
TURN_REACH = 3
"""Number of samples on each side of a turn that belong to the turn."""

Quantity: TypeAlias = Literal["force", "displacement"]
QUANTITIES: tuple[Quantity, Quantity] = ("displacement", "force")
"""Quantities of a curve. Both are doubtful if the displacement is wrong, because the displacement
separates the branches."""
BranchPath: TypeAlias = tuple[Floats, Floats]
"""Block means of displacement (m, increasing) and force (N) of a branch."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """A loading and the unloading that follows it.

    Parameters
    ----------
    loading, unloading : branches of the curve
    paths : paths of the loading and of the unloading
    """

    loading: Branch
    unloading: Branch
    paths: tuple[BranchPath, BranchPath]


@dataclass(frozen=True, eq=False)
class CheckedRecord:
    """Record of a test with the quantities that several checks use.

    Parameters
    ----------
    signals : signals of the test, with the stretches in which they are zeroed
    curve : curve of the unfiltered force with its branches; for checks of the force after a break,
        the corrected curve
    limits : limits of the protocol
    earlier_findings : findings of the checks of single channels
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
    def displacement_range(self) -> float:
        """Return the difference between the largest and the smallest displacement, m."""
        return float(np.ptp(drop_missing(self.curve.displacement)))

    @cached_property
    def force_noise(self) -> float:
        """Return the standard deviation of the noise of the force, N."""
        return estimate_noise_level(self.curve.force)

    @cached_property
    def loading_sign(self) -> float:
        """Return the sign of the force that loads the specimen in the first branch."""
        return self.compute_sign(self.curve.branches[0])

    @cached_property
    def turns(self) -> list[tuple[Branch, Branch, float]]:
        """Return the branches before and after each turn, and the sign of the force.

        The product of force and sign increases up to the turn.
        """
        sign = self.loading_sign
        return [
            (first, second, sign if first.direction is Direction.LOADING else -sign)
            for first, second in pairwise(self.curve.branches)
            if first.direction is not second.direction
        ]

    @cached_property
    def cycles(self) -> list[Cycle]:
        """Return the complete cycles whose branches have at least `MIN_PATH_POINTS` points."""
        cycles = [
            Cycle(first, second, (_make_path(self.curve, first), _make_path(self.curve, second)))
            for first, second in pairwise(self.curve.branches)
            if first.direction is Direction.LOADING and second.cycle == first.cycle
        ]
        return [x for x in cycles if all(len(path[0]) >= MIN_PATH_POINTS for path in x.paths)]

    @cached_property
    def cycle_changes(self) -> list[tuple[str, float, Cycle, Cycle]]:
        """Return the changes between consecutive cycles.

        An entry consists of the kind and the size of the change (see `_find_cycle_change`), the
        earlier cycle and the later cycle.
        """
        changes = [(_find_cycle_change(self, *pair), pair) for pair in pairwise(self.cycles)]
        return [(*change, *pair) for change, pair in changes if change is not None]

    @cached_property
    def jumps(self) -> dict[Quantity, list[tuple[int, float]]]:
        """Return the jumps of each quantity.

        Each entry has the index of the first sample after the jump, and its size (m or N). Jumps at
        the end of a stretch in which the channel is frozen are left out.
        """
        max_distance = 2  # samples between such a jump and the end of the frozen stretch
        time = self.curve.time
        frozen_ends = [
            (doubt.quantity, int(np.searchsorted(time, doubt.period[1])))
            for finding in self.earlier_findings.entries
            for doubt in finding.doubts
            if finding.code == "frozen_channel" and doubt.period
        ]
        return {
            quantity: [
                (sample, size)
                for sample, size in find_level_jumps(time, getattr(self.curve, quantity))
                if all(abs(sample - end) > max_distance for x, end in frozen_ends if x == quantity)
            ]
            for quantity in QUANTITIES
        }

    def compute_sign(self, branch: Branch) -> float:
        """Compute the sign of the force that loads the specimen in a branch."""
        return compute_loading_sign(self.curve.force[branch.start : branch.stop])

    def compute_min_change(
        self, min_fraction: float, error: float, min_error_ratio: float = MIN_CHANGE_ERROR_RATIO
    ) -> float:
        """Compute the smallest change of the force (N) that is reported.

        Parameters
        ----------
        min_fraction : smallest change as a fraction of the largest force
        error : standard error of the change, N
        min_error_ratio : smallest change divided by its standard error
        """
        return max(min_fraction * self.largest_force, min_error_ratio * error)

    def report(
        self,
        template: str,
        *quantities: str,
        channel: Quantity = "force",
        at: int | None = None,
        segment: tuple[int, int] | None = None,
        **facts: Any,
    ) -> Finding:
        """Report a contradiction in the force or the displacement as a finding.

        Parameters
        ----------
        template, facts : name of the message template, and values of its fields, see
            `labpipe.messages.format_sentence`
        quantities : doubtful quantities
        channel : quantity whose channel the note names
        at : index of the sample of the fact ``at``, which is its time, or its number if the export
            has no time; None if the message has no such fact
        segment : indices of the first and last doubtful sample; -1 is the last sample of the
            record; None for all samples
        """
        time = self.curve.time
        if at is not None:
            is_timed = self.curve.time_unit == "s"
            facts["at"] = f"{time[at]:.3f} s" if is_timed else f"sample {at + 1}"
        period = None if segment is None else (float(time[segment[0]]), float(time[segment[1]]))
        channel_name = getattr(self.signals, channel)
        return Finding.of(template, channel_name, *quantities, period=period, **facts)


def check_consistency(record: CheckedRecord) -> Iterator[Finding]:
    """Report contradictions between cycles, rests, force and displacement of a record.

    Parameters
    ----------
    record : record of a test

    Yields
    ------
    The findings. Each has the doubtful quantities, and a note with the size of a contradiction and,
    in most checks, its cycle or time.
    """
    if not record.curve.branches:
        return
    for check in _CHECKS if record.largest_force > 0.0 else _CHECKS[:1]:
        yield from check(record)


def _make_path(curve: Curve, branch: Branch) -> BranchPath:
    """Average a branch over at least 400 blocks, and sort the means by displacement.

    A branch with fewer samples is only sorted. Samples with a NaN are left out.
    """
    min_blocks = 400
    rows = slice(branch.start, branch.stop)
    samples = np.stack([curve.displacement[rows], curve.force[rows]])
    samples = samples[:, ~np.isnan(samples).any(axis=0)]
    means = np.stack([average_blocks(values, min_blocks) for values in samples])
    displacement, force = means[:, np.argsort(means[0], kind="stable")]
    return displacement, force


def _interpolate_common_forces(*paths: BranchPath) -> list[Floats]:
    """Interpolate the force of each path at equidistant displacements in their common range.

    The list is empty if a path has fewer than `MIN_PATH_POINTS` points, or if the common range is
    not longer than half of the combined range.
    """
    min_common_fraction = 0.5  # common range as a fraction of the combined range
    if min(len(force) for _, force in paths) < MIN_PATH_POINTS:
        return []
    lowest, highest = [path[0][0] for path in paths], [path[0][-1] for path in paths]
    if not min(highest) - max(lowest) > min_common_fraction * (max(highest) - min(lowest)):
        return []
    displacements = np.linspace(max(lowest), min(highest), N_COMPARED_DISPLACEMENTS + 2)[1:-1]
    return [np.interp(displacements, *path) for path in paths]


def _check_displacement_jumps(record: CheckedRecord) -> Iterator[Finding]:
    """Report the largest jump or outlier of the displacement, except a single one at a break."""
    min_break_drop = 0.3  # drop of the force at a break as a fraction of the largest force
    min_outlier = 0.02  # smallest outlier as a fraction of the range of the displacement
    displacement, force = record.curve.displacement, record.curve.force
    deviations = displacement - bridge_spikes(displacement, find_spikes(displacement))
    outliers = np.flatnonzero(np.abs(deviations) > min_outlier * record.displacement_range)
    jumps = [(sample, float(deviations[sample])) for sample in outliers.tolist()]
    jumps += record.jumps["displacement"]
    if not jumps:
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    drop = abs(force[sample - 1]) - abs(force[sample])
    is_break = drop > min_break_drop * record.largest_force
    if len(jumps) > 1 or not is_break:
        facts: dict[str, Any] = {"at": sample, "size": 1e3 * size, "count": len(jumps)}
        yield record.report("process.zero_jump", *QUANTITIES, channel="displacement", **facts)


def _check_rest_levels(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force or a displacement that differs from zero before the motion.

    A displacement that a step zeroes is not checked. A force that a step zeroes is reported if it
    differs from this zero before the motion.
    """
    min_samples = 8
    # Fractions of the largest force and of the range of the displacement.
    min_force_fraction, min_displacement_fraction = 1e-4, 0.02
    signals, curve, start = record.signals, record.curve, record.curve.branches[0].start
    is_zeroed = signals.is_zeroed(signals.force)
    jumps = find_level_jumps(curve.time[:start], curve.force[:start])
    # A zero is taken at the beginning of the rest, and the force may change after it.
    rest_start = jumps[-1][0] if jumps else (start // 2 if is_zeroed else 0)
    rest_forces = drop_missing(curve.force[rest_start:start])
    rest_force, count = median(rest_forces), max(1, len(rest_forces))
    ratio, error = abs(rest_force) / record.largest_force, record.force_noise / sqrt(count)
    min_force = record.compute_min_change(min_force_fraction, error, MIN_REST_ERROR_RATIO)
    if count >= min_samples and abs(rest_force) > min_force:
        max_zero_error = 2.0 * signals.raw[signals.force].zero_drift
        is_small = ratio <= max(record.limits.rest_force, max_zero_error)
        facts: dict[str, Any] = {"level": rest_force, "ratio": ratio}
        if is_small and not is_zeroed:
            yield record.report("process.rest_force", **facts)
        elif not is_zeroed:
            yield record.report("process.rest_force_doubtful", "force_zero", **facts)
        elif not is_small:
            yield record.report("process.rest_force_left", "force_zero", at=rest_start, **facts)
    displacement = float(curve.displacement[start])
    is_displaced = abs(displacement) > min_displacement_fraction * record.displacement_range
    if is_displaced and not signals.is_zeroed(signals.displacement):
        facts = {"level": 1e3 * displacement, "channel": "displacement"}
        yield record.report("process.rest_displacement", **facts)


def _check_early_force(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that changes before the motion, as with a wrong clock or a jump of its zero.

    The mean force of the last 0.2 s before the motion is compared with earlier means. Nothing is
    reported if force and displacement have one clock.
    """
    duration, min_change_fraction = 0.2, 2e-3  # s; fraction of the largest force
    min_means = 5  # number of earlier means
    signals, curve = record.signals, record.curve
    start = curve.branches[0].start
    n_samples = start - int(np.searchsorted(curve.time, curve.time[start] - duration))
    has_one_clock = signals.raw[signals.force].clock == signals.raw[signals.displacement].clock
    if has_one_clock or start < (min_means + 1) * n_samples or not n_samples:
        return
    blocks = curve.force[start % n_samples : start].reshape(-1, n_samples)
    mean_forces = drop_missing(blocks.mean(axis=1))
    if len(mean_forces) <= min_means:
        return
    rest_force = median(mean_forces[:-1])
    spread = 1.4826 * median(np.abs(mean_forces[:-1] - rest_force))  # standard deviation
    error = max(spread, record.force_noise / sqrt(n_samples))
    change = float(mean_forces[-1] - rest_force)
    if abs(change) > record.compute_min_change(min_change_fraction, error):
        facts: dict[str, Any] = {"change": change, "ratio": abs(change) / record.largest_force}
        yield record.report("process.force_early", "clock", "force_zero", **facts)


def _check_force_level(record: CheckedRecord) -> Iterator[Finding]:
    """Report a jump of the force that no specimen causes; without such a jump, a drift of the zero.

    Such a jump is a rise in loading, a fall in loading to zero from which the force rises again, or
    any jump in unloading. If a converter overflows, the force jumps over the whole range of the
    record. One or two jumps over the whole range are an overflow only if they lead to the opposite
    force.
    """
    max_jumps = 2  # more jumps are attributed to the specimen, or are overflows
    min_overflow_fraction = 0.9  # jump divided by the range of the force
    max_asymmetry = 0.1  # difference of the final force and half the jump, divided by the jump
    force, branches = record.curve.force, record.curve.branches
    all_jumps = record.jumps["force"]
    min_overflow = min_overflow_fraction * np.ptp(drop_missing(force))
    overflows = [jump for jump in all_jumps if abs(jump[1]) > min_overflow]
    if len(overflows) <= max_jumps:
        overflows = [x for x in overflows if abs(force[x[0]] / x[1] - 0.5) < max_asymmetry]
    # Each branch is extended to the start of the next one, and then includes the rest after it.
    rest_ends = [*(branch.start for branch in branches[1:]), branches[-1].stop]
    jumps = [
        (sample, size)
        for branch, rest_end in zip(branches, rest_ends, strict=True)
        for sample, size in all_jumps
        if branch.start + TURN_REACH < sample < rest_end - TURN_REACH
        and abs(sample - branch.stop) > TURN_REACH
        and (
            branch.direction is Direction.UNLOADING
            or record.loading_sign * size > 0.0
            or _is_zeroed(force[sample:rest_end], size, record.force_noise)
        )
    ]
    if overflows:
        sample, size = overflows[0]
        yield record.report("process.overflow", "force", "displacement", at=sample, size=size)
    elif 0 < len(jumps) <= max_jumps:
        sample, size = jumps[0]
        facts: dict[str, Any] = {"at": sample, "segment": (sample, -1), "size": size}
        yield record.report("process.force_jump", "force", **facts)
    else:
        yield from _check_zero_drift(record)


def _is_zeroed(forces: Floats, fall: float, noise: float) -> bool:
    """Return whether the force after a fall is zero within its noise and a step, and rises again.

    The force of a broken specimen stays at zero.
    """
    min_rise = 0.25  # fraction of the fall
    max_level = MIN_REST_ERROR_RATIO * noise + abs(forces[1] - forces[0])
    return bool(abs(forces[0]) <= max_level and np.nanmax(np.abs(forces)) > min_rise * abs(fall))


def _check_zero_drift(record: CheckedRecord) -> Iterator[Finding]:
    """Report a change of the force at rest if the motion returns to its initial position.

    A specimen with friction or permanent set pushes back after unloading. A force against the
    direction of loading is therefore a drift only if the level also changes between cycles, or if
    the force has jumped by as much.
    """
    # Distance from the initial position, as a fraction of the range of the displacement; samples.
    max_distance, min_rest_samples = 0.02, 3
    curve, first, last = record.curve, record.curve.branches[0], record.curve.branches[-1]
    rests = curve.force[: first.start], curve.force[last.stop :]
    initial_forces, final_forces = map(drop_missing, rests)
    count = min(len(initial_forces), len(final_forces))
    distance = abs(curve.displacement[last.stop - 1] - curve.displacement[first.start])
    has_returned = distance <= max_distance * record.displacement_range
    if last.direction is Direction.LOADING or not has_returned or count < min_rest_samples:
        return
    # Only the last samples of a long final rest are used, because specimens relax.
    initial_force = median(initial_forces)
    final_force = median(final_forces[-len(initial_forces) :])
    moving_forces = curve.force[first.start : last.stop]
    change = compute_loading_sign(moving_forces) * (final_force - initial_force)
    error = record.force_noise * sqrt(2.0 / count)
    # The size of a jump has the error of two samples.
    max_misfit = MIN_REST_ERROR_RATIO * record.force_noise * sqrt(2.0 / count + 2.0)
    jump = sum(size for _, size in record.jumps["force"])
    has_jumped = abs(final_force - initial_force - jump) < max_misfit < abs(jump)
    if has_jumped or any(kind == "level" for kind, *_ in record.cycle_changes):
        change = abs(change)
    largest_force = float(np.nanmax(np.abs(moving_forces - initial_force)))
    if change >= max(record.limits.rest_force_drift * largest_force, MIN_REST_ERROR_RATIO * error):
        facts: dict[str, Any] = {"initial": initial_force, "final": final_force}
        facts |= {"ratio": abs(change) / largest_force}
        yield record.report("process.zero_drift", "force", **facts)


def check_force_after_break(record: CheckedRecord, failure: object) -> Iterator[Finding]:
    """Report a force opposite to the loading after the specimen broke.

    Parameters
    ----------
    record : record of a test with its corrected curve
    failure : failure point of the test; without a failure point nothing is reported

    Notes
    -----
    A force in the direction of the loading is allowed, because unbroken wires may still carry a
    load. A rebound of a few samples is also allowed.
    """
    min_samples = 10  # after the break; fewer samples may be a rebound
    if not isinstance(failure, FailurePoint):
        return
    force, first_sample = record.curve.force, failure.sample + 1
    later_force = drop_missing(force[first_sample:])
    count = len(later_force)
    if count < min_samples:
        return
    level, error = median(later_force[count // 2 :]), record.force_noise * sqrt(2.0 / count)
    reversed_force = -compute_loading_sign(force[:first_sample]) * level
    min_drift = record.limits.rest_force_drift
    if reversed_force >= record.compute_min_change(min_drift, error, MIN_REST_ERROR_RATIO):
        facts: dict[str, Any] = {"level": level, "ratio": reversed_force / record.largest_force}
        yield record.report("process.zero_drift_after_break", "force", **facts)


def _check_partial_breaks(record: CheckedRecord) -> Iterator[Finding]:
    """Report sudden losses of force in loading that are larger than slips but are no breaks."""
    min_loss = 0.2  # fraction of the reference force
    # The reference force is the largest force before the loss, but at least this fraction of the
    # largest force of the record.
    min_reference_force = 0.5
    min_later = 0.5  # largest force after the loss as a fraction of that before it
    min_recovery = 0.25  # fraction of the loss; after a break the force does not recover
    max_duration = 0.05  # s
    max_losses = 2  # more losses are attributed to the specimen
    curve, losses = record.curve, []
    n_steps = 1  # between the samples from which a loss is computed
    if curve.time_unit == "s":
        n_steps = max(1, int(max_duration / compute_median_step(curve.time)))
    for branch in curve.branches:
        if branch.direction is Direction.UNLOADING:
            continue
        force = record.compute_sign(branch) * curve.force[branch.start : branch.stop]
        largest_before = np.fmax.accumulate(force[:-n_steps])
        largest_after = np.fmax.accumulate(force[: n_steps - 1 : -1])[::-1]
        loss = force[:-n_steps] - force[n_steps:]
        reference_force = np.fmax(largest_before, min_reference_force * record.largest_force)
        relative_loss = loss / reference_force
        is_partial = (relative_loss > min_loss) & (largest_after >= min_later * largest_before)
        is_partial &= largest_after - force[n_steps:] >= min_recovery * loss
        is_partial &= loss > MIN_CHANGE_ERROR_RATIO * record.force_noise
        samples = np.flatnonzero(is_partial)
        for run in np.split(samples, np.flatnonzero(np.diff(samples) > n_steps) + 1):
            if len(run):
                segment = branch.start + run[0], branch.start + run[-1] + n_steps
                losses.append((segment, relative_loss[run].max()))
    for segment, loss in losses if len(losses) <= max_losses else ():
        # The peak force is not doubtful, because the specimen was whole when it was reached.
        facts: dict[str, Any] = {"at": segment[0], "segment": segment, "loss": loss}
        yield record.report("process.partial_break", "displacement", **facts)


def _check_cycle_changes(record: CheckedRecord) -> Iterator[Finding]:
    """Report changes of scale, level or travel between cycles that an instrument caused.

    Such a change is the same in loading and unloading, whereas conditioning, hardening, fatigue
    and permanent set change the two differently. Unloading is also compared alone, because the
    first loading differs from all later ones. An offset of the displacement changes the forces like
    an offset of the force, but it also shifts the turns.
    """
    for kind, size, old_cycle, new_cycle in record.cycle_changes:
        old_travel, new_travel = (cycle.paths[1][0] for cycle in (old_cycle, new_cycle))
        max_shift = record.limits.cycle_change * (old_travel[-1] - old_travel[0])
        is_turn_shifted = abs(new_travel[-1] - old_travel[-1]) > max_shift
        only_force_changes = kind == "level" and not is_turn_shifted
        facts: dict[str, Any] = {"cycle": new_cycle.loading.cycle, "size": size}
        facts |= {"at": new_cycle.loading.start, "segment": (old_cycle.unloading.stop - 1, -1)}
        quantities = ("force",) if only_force_changes else QUANTITIES
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

    The size of a change of ``level`` is the difference of the forces, N. The size of a change of
    ``scale`` is the ratio of the later force to the earlier one. The size of a change of ``travel``
    is the ratio of the displacements at the turns.
    """
    # Each limit applies to the misfit of the cycles as recorded divided by their misfit after a
    # change of scale or level has been removed. In 246 pairs of real and simulated cycles, in which
    # the material changes the shape of the curve, this ratio is at most 2.0 in complete cycles. In
    # unloading it is at most 4.0 for a scale and 6.2 for a level.
    min_cycle_ratio, min_unloading_scale_ratio, min_unloading_level_ratio = 3.0, 5.5, 8.0
    unloading = slice(N_COMPARED_DISPLACEMENTS, None)
    comparisons = (
        (slice(None), min_cycle_ratio, min_cycle_ratio),
        (unloading, min_unloading_scale_ratio, min_unloading_level_ratio),
    )
    max_stroke_change = 0.05  # relative; a cycle of another stroke unloads along another path
    max_change_ratio = 0.25  # relative change of the force at the turn over that of the travel
    min_change = record.limits.cycle_change
    forces = _interpolate_common_forces(*old_cycle.paths, *new_cycle.paths)
    if not forces:
        return None
    old_curve, new_curve = np.concatenate(forces[:2]), np.concatenate(forces[2:])
    (old_travel, old_force), (new_travel, new_force) = old_cycle.paths[1], new_cycle.paths[1]
    is_stroke_changed = abs(np.ptp(new_travel) / np.ptp(old_travel) - 1.0) > max_stroke_change
    for points, min_scale_ratio, min_level_ratio in () if is_stroke_changed else comparisons:
        old, new = old_curve[points], new_curve[points]
        scale, level = float(old @ new / (old @ old)), float(np.mean(new - old))
        misfit, scale_misfit = compute_rms(new - old), compute_rms(new - scale * old)
        level_misfit = compute_rms(new - level - old)
        is_scaled = scale_misfit < level_misfit and abs(scale - 1.0) > min_change
        if is_scaled and misfit > min_scale_ratio * scale_misfit:
            return "scale", scale
        is_shifted = abs(level) > min_change * record.largest_force
        if is_shifted and misfit > min_level_ratio * level_misfit:
            return "level", level
    travel_ratio = float(new_travel[-1] / old_travel[-1]) if old_travel[-1] > 0.0 else 1.0
    # A change of the scale of the travel does not change the force at the turn; a change of the
    # stroke does.
    travel_change = abs(travel_ratio - 1.0)
    force_change = abs(float(new_force[-1] / old_force[-1]) - 1.0)
    is_force_changed = force_change > max(min_change, max_change_ratio * travel_change)
    if travel_change < min_change or travel_ratio <= 0.0 or is_force_changed:
        return None
    rescaled_path = new_travel / travel_ratio, new_force
    rescaled_forces = _interpolate_common_forces(old_cycle.paths[1], rescaled_path)
    rescaled_misfit = compute_rms(np.diff(rescaled_forces, axis=0)) if rescaled_forces else inf
    misfit = compute_rms(new_curve[unloading] - old_curve[unloading])
    return ("travel", travel_ratio) if misfit >= min_cycle_ratio * rescaled_misfit else None


def _check_loading_directions(record: CheckedRecord) -> Iterator[Finding]:
    """Report the first loading branch in which the force falls by half of the largest force.

    A record with large forces of both signs is not checked.
    """
    min_fall, max_opposite_force = 0.5, 0.5  # fractions of the largest force
    force = record.loading_sign * record.curve.force
    if np.nanmin(force) < -max_opposite_force * record.largest_force:
        return
    for previous, branch in pairwise(record.curve.branches):
        branch_force = drop_missing(force[branch.start : branch.stop])
        n_end_samples = max(1, len(branch_force) // 10)
        fall = median(branch_force[:n_end_samples]) - median(branch_force[-n_end_samples:])
        if branch.direction is Direction.LOADING and fall > min_fall * record.largest_force:
            facts: dict[str, Any] = {"cycle": branch.cycle, "ratio": fall / record.largest_force}
            facts |= {"at": branch.start, "segment": (previous.start, -1)}
            facts |= {"channel": "displacement"}
            yield record.report("process.loading_reversed", *QUANTITIES, **facts)
            return


def _check_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that still grows after turns of the motion, as if it is late or jumps."""
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
        n_averaged = max(1, n_samples // 10)
        largest_before, largest_after = (
            float(np.convolve(forces, np.ones(n_averaged) / n_averaged, "valid").max())
            for forces in (last_forces, first_forces)
        )
        # The turn is between two samples. The force may therefore grow by its mean step.
        mean_step = max(0.0, float(last_forces[-1] - last_forces[0])) / (len(last_forces) - 1)
        growths.append((largest_after - largest_before - mean_step, next_branch))
    if not growths:
        return
    median_growth = median(np.array([growth for growth, _ in growths]))
    largest_growth, branch = max(growths, key=lambda entry: entry[0])
    if median_growth > record.compute_min_change(limits.force_lag, record.force_noise):
        ratio = median_growth / record.largest_force
        facts: dict[str, Any] = {"growth": median_growth, "ratio": ratio}
        yield record.report("process.force_late", "clock", **facts)
    elif largest_growth > record.compute_min_change(limits.turn_jump, record.force_noise):
        facts = {"growth": largest_growth, "branch": branch}
        facts |= {"at": branch.start, "segment": (branch.start, -1)}
        yield record.report("process.turn_jump", "force", **facts)


def _check_skipped_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report turns at which alone the force jumps, as after an interrupted recording."""
    min_step_ratio = 5.0  # largest step of the force at a turn divided by that at the other turns
    curve, jumps = record.curve, dict(record.jumps["force"])
    for direction in Direction:
        ranges = [
            range(max(second.start - TURN_REACH, 0), second.start + TURN_REACH + 1)
            for _, second, _ in record.turns
            if second.direction is direction
        ]
        turn_forces = [curve.force[samples.start : samples.stop] for samples in ranges]
        steps = [np.fmax.reduce(np.abs(np.diff(force)), initial=0.0) for force in turn_forces]
        for index, samples in enumerate(ranges):
            other_steps = [*steps[:index], *steps[index + 1 :]]
            sample = next((sample for sample in samples if sample in jumps), None)
            is_interrupted = steps[index] > min_step_ratio * max(other_steps, default=inf)
            if sample is not None and is_interrupted:
                segment = samples.start, min(samples.stop, len(curve.time)) - 1
                facts: dict[str, Any] = {"at": sample, "size": jumps[sample]}
                facts |= {"segment": segment, "channel": "displacement"}
                yield record.report("process.turn_skipped", *QUANTITIES, **facts)


def _check_force_clipping(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that is constant, apart from noise, on both sides of a turn.

    The force is constant if two pieces on each side of the turn have the same mean force within
    four standard errors. The force of a yielding specimen, in contrast, falls as soon as the motion
    turns.
    """
    turn_reaches = 0.1, 0.05, 0.03  # displacements on each side as fractions of that of the branch
    # Smallest constant force as a fraction of the largest force; largest error as a fraction of the
    # largest force, divided by the reach.
    min_level_fraction, max_error_ratio = 0.5, 0.1
    n_standard_errors, min_piece_samples = 4.0, 8
    for cycle in record.cycles:
        turn_position = record.curve.displacement[cycle.unloading.start]
        for reach in turn_reaches:
            pieces = list[Floats]()
            for displacement, force in cycle.paths:
                is_near = np.abs(displacement - turn_position) < reach * np.ptp(displacement)
                pieces += np.array_split(force[is_near], 2)
            if min(map(len, pieces)) < min_piece_samples:
                break
            error = n_standard_errors * max(piece.std() / sqrt(len(piece)) for piece in pieces)
            levels = [float(piece.mean()) for piece in pieces]
            level, is_level = float(np.mean(levels)), np.ptp(levels) < error
            min_level = min_level_fraction * record.largest_force
            is_precise = error < max_error_ratio * reach * record.largest_force
            if is_level and is_precise and abs(level) > min_level:
                facts: dict[str, Any] = {"cycle": cycle.loading.cycle, "level": level}
                segment = cycle.loading.start, cycle.unloading.stop - 1
                yield record.report("process.force_limited", "force", segment=segment, **facts)
                break


def _check_held_turns(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force that grows and returns while the displacement is constant at a turn."""
    min_growth = 0.05  # fraction of the largest force
    curve = record.curve
    for first, second, _ in record.turns:
        # The force of a damper reverses at a turn. The sign is therefore that of one branch alone.
        sign = record.compute_sign(first) * (1 if first.direction is Direction.LOADING else -1)
        turn_sample = first.stop - 1
        force = drop_missing(sign * curve.force[turn_sample : second.start + 1])
        growth = float(force.max() - max(force[0], force[-1])) if len(force) else 0.0
        if growth > record.compute_min_change(min_growth, record.force_noise):
            position = 1e3 * curve.displacement[turn_sample]  # mm
            facts: dict[str, Any] = {"growth": growth, "position": position, "at": turn_sample}
            facts |= {"segment": (first.start, second.stop - 1)}
            quantity: Quantity = "displacement"
            yield record.report("process.displacement_limited", quantity, channel=quantity, **facts)


def _check_saturation(record: CheckedRecord) -> Iterator[Finding]:
    """Report a force or a displacement that is limited at turns, unless a channel is saturated."""
    if not any(finding.code == "saturation" for finding in record.earlier_findings.entries):
        yield from _check_force_clipping(record)
        yield from _check_held_turns(record)


def _check_jump_to_peak(record: CheckedRecord) -> Iterator[Finding]:
    """Report a largest force to which the force jumps just before it falls."""
    min_step_ratio = 5.0  # jump divided by the largest of the steps before it
    min_jump, max_remaining_force = 0.02, 0.5  # fractions of the largest force
    reach = 3  # number of steps before the peak that may be the jump, and of samples after the peak
    force = record.loading_sign * record.curve.force
    peak = int(np.nanargmax(force))
    steps = np.diff(force[max(0, peak - 2 * reach) : peak + 1])
    forces_after = force[peak + 1 : peak + 1 + reach]
    if len(steps) < 2 * reach or not len(forces_after):
        return
    jump, largest_step = float(steps[reach:].max()), np.abs(steps[:reach]).max()
    min_change = record.compute_min_change(min_jump, record.force_noise)
    is_lost = float(np.min(forces_after)) < max_remaining_force * force[peak]
    if is_lost and jump > max(min_change, min_step_ratio * float(largest_step)):
        segment = peak - reach, peak
        yield record.report("process.last_rise", "force", at=peak, segment=segment, size=jump)


def _check_gaps_at_peaks(record: CheckedRecord) -> Iterator[Finding]:
    """Report a gap in the times at a turn or at the largest force, where a peak may be missing."""
    min_step_ratio, step_quantile = 5.0, 0.98  # gap over this quantile of the time steps
    # In a time as long as the gap, just before it, the displacement must change by more than this
    # fraction of its range, and by more than this multiple of its noise.
    min_travel, min_noise_ratio = 0.005, 6.0
    peak_reach = 5  # samples between gap and peak, because noise shifts the largest sample
    time, displacement = record.curve.time, record.curve.displacement
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > min_step_ratio * np.quantile(steps, step_quantile))
    peaks = [second.start for _, second in pairwise(record.curve.branches)]
    peaks.append(int(np.nanargmax(np.abs(record.curve.force))))
    noise = estimate_noise_level(displacement)
    travel_limit = max(min_travel * record.displacement_range, min_noise_ratio * noise)  # m
    for gap in gaps.tolist():
        is_at_peak = min(abs(gap - peak) for peak in peaks) <= peak_reach
        earlier_sample = np.searchsorted(time, time[gap] - steps[gap])
        travel_before = abs(displacement[gap] - displacement[earlier_sample])
        if is_at_peak and travel_before > travel_limit:
            segment = max(gap - peak_reach, 0), min(gap + peak_reach + 1, len(time) - 1)
            facts: dict[str, Any] = {"at": gap, "length": steps[gap], "segment": segment}
            facts |= {"channel": "displacement"}
            yield record.report("process.peak_in_hole", *QUANTITIES, **facts)


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
        facts: dict[str, Any] = {"gain": gain, "cycle": cycle.loading.cycle}
        facts |= {"segment": None if affects_most_cycles else segment}
        yield record.report("process.energy_gained", *quantities, **facts)


def _check_second_specimen(record: CheckedRecord) -> Iterator[Finding]:
    """Report a record that continues with another specimen after the first one broke."""
    force_quantile = 0.8  # a broken specimen carries almost no force in 80 % of the unloading
    limits = record.limits
    for cycle in record.cycles:
        next_branches = [x for x in record.curve.branches if x.start >= cycle.unloading.stop]
        next_paths = [_make_path(record.curve, branch) for branch in next_branches[:1]]
        forces = _interpolate_common_forces(*cycle.paths, *next_paths)
        if not (next_paths and forces):
            continue
        first_force, unloading_force, second_force = (
            float(np.quantile(np.abs(force), force_quantile)) for force in forces
        )
        is_broken = unloading_force < limits.broken_force * first_force
        if is_broken and second_force > limits.second_loading * first_force:
            next_cycle = next_branches[0].cycle
            facts: dict[str, Any] = {"cycle": cycle.loading.cycle, "next_cycle": next_cycle}
            facts |= {"unloading_force": unloading_force, "second_force": second_force}
            yield record.report("process.second_specimen", *QUANTITIES, **facts)
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
"""Checks in the order of their findings; all but the first need a force other than zero."""


def compute_rms(values: Floats) -> float:
    """Compute the root mean square of the values that are not NaN; NaN if there are none."""
    valid = drop_missing(values)
    return float(np.sqrt(np.mean(valid**2))) if len(valid) else float("nan")
