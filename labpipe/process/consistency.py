"""Check whether the parts of a record agree: cycles, rests, force and displacement.

Each check compares one statistic with one threshold. The thresholds are multiples of the maxima
in real and simulated cyclic tests (docs/explanations/intervals.md), so that a clean record fails
a check in fewer than one case in fifty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import hypot, sqrt
from typing import Literal

import numpy as np

from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import Limits
from labpipe.records.quality import Finding, Findings
from labpipe.records.signals import Signals
from labpipe.results.kinds import FailurePoint, compute_loading_sign
from labpipe.signal.rests_and_jumps import find_level_jumps
from labpipe.signal.turning_points import estimate_noise_level

COMPARED_POINTS = 40
"""Displacements of a branch at which cycles are compared."""
MIN_COMPARED_SAMPLES = 5
"""Shorter branches are not compared."""
REST_ERROR_FACTOR = 6.0
"""Standard errors that a difference of levels must exceed."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """A loading and the unloading that follows it.

    Parameters
    ----------
    loading, unloading : branches of the curve
    paths : displacement and force of each branch, sorted by displacement
    """

    loading: Branch
    unloading: Branch
    paths: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, eq=False)
class Record:
    """A record, and quantities that several checks use, computed on demand.

    Parameters
    ----------
    signals : of the test, with the stretches of their zeros
    curve : of unfiltered force, with branches
    limits : of the lab
    earlier_findings : about single channels
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
        pairs = [
            (first, second, (_make_path(self.curve, first), _make_path(self.curve, second)))
            for first, second in pairwise(self.curve.branches)
            if first.direction is Direction.LOADING and second.cycle == first.cycle
        ]
        is_long = [min(len(path[0]) for path in x[2]) >= MIN_COMPARED_SAMPLES for x in pairs]
        return [Cycle(*pair) for pair, keep in zip(pairs, is_long, strict=True) if keep]

    @cached_property
    def changes(self) -> list[tuple[str, float, Cycle, Cycle]]:
        """Return changes of instruments: kind and size, the cycle before and the one after."""
        changes = [(_find_instrument_change(self, *pair), pair) for pair in pairwise(self.cycles)]
        return [(*change, *pair) for change, pair in changes if change is not None]

    def loading_sign(self, branch: Branch) -> float:
        """Return the sign in which the force changes in a branch."""
        return compute_loading_sign(self.curve.force[branch.start : branch.stop])

    def format_time(self, sample: int) -> str:
        """Return the time of a sample as text."""
        time = self.curve.time[sample]
        return f"{time:.3f} s" if self.curve.time_unit == "s" else f"sample {sample + 1}"

    def stretch_from(self, sample: int) -> tuple[float, float]:
        """Return the stretch from a sample to the end, s."""
        return float(self.curve.time[sample]), float(self.curve.time[-1])


def check_consistency(record: Record) -> Iterator[Finding]:
    """Compare the parts of a record.

    Parameters
    ----------
    record : with a curve

    Yields
    ------
    A finding for each failed check: which cycle, when, how much, and what is doubtful.
    """
    if not record.curve.branches:
        return
    for check in CHECKS if record.largest_force > 0.0 else CHECKS[:1]:
        yield from check(record)


def _make_path(curve: Curve, branch: Branch) -> tuple[Floats, Floats]:
    inside = slice(branch.start, branch.stop)
    samples = np.stack([curve.displacement[inside], curve.force[inside]])
    samples = samples[:, ~np.isnan(samples).any(axis=0)]
    max_means = 400
    size = max(1, samples.shape[1] // max_means)
    means = samples[:, : samples.shape[1] // size * size].reshape(2, -1, size).mean(axis=2)
    displacement, force = means[:, np.argsort(means[0], kind="stable")]
    return displacement, force


def _interpolate_common_forces(*paths: tuple[Floats, Floats]) -> tuple[Floats, ...]:
    """Interpolate the forces of paths at common displacements; empty if they hardly overlap."""
    min_common_share = 0.5
    if min(len(path[0]) for path in paths) < MIN_COMPARED_SAMPLES:
        return ()
    low, high = max(path[0][0] for path in paths), min(path[0][-1] for path in paths)
    span = max(path[0][-1] for path in paths) - min(path[0][0] for path in paths)
    if not high - low > min_common_share * span:
        return ()
    displacements = np.linspace(low, high, COMPARED_POINTS + 2)[1:-1]
    return tuple(np.interp(displacements, *path) for path in paths)


def _find_jumps(
    record: Record, quantity: Literal["force", "displacement"]
) -> list[tuple[int, float]]:
    """Find jumps of a quantity: sample and size, without jumps at the end of a frozen run."""
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


def _check_displacement_jumps(record: Record) -> Iterator[Finding]:
    """Report jumps of the displacement that no break explains."""
    break_share = 0.3  # fall of the force at a break, share of the largest force
    jumps, force = _find_jumps(record, "displacement"), np.abs(record.curve.force)
    force_drops = [force[sample - 1] - force[sample] for sample, _ in jumps]
    if not jumps or (len(jumps) == 1 and force_drops[0] > break_share * record.largest_force):
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    where, mm, at = record.signals.displacement, 1e3 * size, record.format_time(sample)
    count = len(jumps)
    yield Finding.of("process.zero_jump", where, "displacement", "force", mm=mm, at=at, count=count)


def _check_rest_force(record: Record) -> Iterator[Finding]:
    """Report the force before the motion if no step zeroes it."""
    min_samples, min_share = 8, 1e-4  # share of the largest force
    signals, curve, name = record.signals, record.curve, record.signals.force
    rest_forces = _drop_missing(curve.force[: curve.branches[0].start])
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


def _check_level(record: Record) -> list[Finding]:
    """Report a jump of the force, or else a drift of its zero."""
    return [*_check_force_jumps(record)] or [*_check_drift(record)]


def _check_force_jumps(record: Record) -> Iterator[Finding]:
    """Report a jump of the force that no specimen causes: up in a loading, any in an unloading."""
    turn_reach = 3  # samples beside a turn
    max_jumps = 2  # more jumps are caused by the specimen
    sense = record.loading_sign(record.curve.branches[0])
    jumps = [
        (sample, size)
        for sample, size in _find_jumps(record, "force")
        if any(
            branch.start + turn_reach < sample < branch.stop - turn_reach
            for branch in record.curve.branches
            if branch.direction is Direction.UNLOADING or sense * size > 0.0
        )
    ]
    if 0 < len(jumps) <= max_jumps:
        where, (sample, size) = record.signals.force, jumps[0]
        during, at = record.stretch_from(sample), record.format_time(sample)
        yield Finding.of("process.force_jump", where, "force", during=during, size=size, at=at)


def _check_drift(record: Record) -> Iterator[Finding]:
    """Compare the force at rest before and after a test that returns to its first position.

    A specimen with friction or permanent set pushes back after unloading. A force against the sense
    of loading is therefore a drift only if the level also changes between cycles.
    """
    return_share = 0.02  # largest distance from the first position, share of the stroke
    min_rest_samples = 3
    curve, first, last = record.curve, record.curve.branches[0], record.curve.branches[-1]
    first_rest, last_rest = map(
        _drop_missing, (curve.force[: first.start], curve.force[last.stop :])
    )
    stroke = np.ptp(_drop_missing(curve.displacement))
    distance = abs(curve.displacement[last.stop - 1] - curve.displacement[first.start])
    has_returned = last.direction is Direction.UNLOADING and distance <= return_share * stroke
    if not has_returned or min(len(first_rest), len(last_rest)) < min_rest_samples:
        return
    branch_forces, level = curve.force[first.start : last.stop], median(first_rest)
    end = median(last_rest[-len(first_rest) :])  # the end of a long rest, because specimens relax
    largest = float(np.nanmax(np.abs(branch_forces - level)))
    error = record.force_noise * hypot(len(first_rest) ** -0.5, len(last_rest) ** -0.5)
    change = compute_loading_sign(branch_forces) * (end - level)
    if any(kind == "level" for kind, *_ in record.changes):
        change = abs(change)
    if change >= max(record.limits.rest_force_drift * largest, REST_ERROR_FACTOR * error):
        where, share = record.signals.force, abs(change) / largest
        yield Finding.of("process.zero_drift", where, "force", level=level, end=end, share=share)


def check_break(record: Record, failure: object) -> Iterator[Finding]:
    """Report a force below zero after the specimen broke.

    Parameters
    ----------
    record : with the corrected curve
    failure : of the test. A force above zero is allowed, because the remains of a specimen may
        carry it; so is a rebound of a few samples
    """
    min_tail_samples = 10  # fewer may be a rebound
    if not isinstance(failure, FailurePoint):
        return
    force, largest = record.curve.force, record.largest_force
    tail = _drop_missing(force[failure.sample + 1 :])
    if len(tail) < min_tail_samples:
        return
    level, error = median(tail[len(tail) // 2 :]), record.force_noise * sqrt(2.0 / len(tail))
    below = -compute_loading_sign(force[: failure.sample + 1]) * level
    if below >= max(record.limits.rest_force_drift * largest, REST_ERROR_FACTOR * error):
        where, share = record.signals.force, below / largest
        yield Finding.of("process.zero_drift_after_break", where, "force", level=level, share=share)


def _check_cycles(record: Record) -> Iterator[Finding]:
    """Report changes of scale or level that are the same over a whole cycle.

    The instruments cause them: conditioning, hardening, fatigue and permanent set change loading
    and unloading differently. Unloading is also compared alone, because a first loading differs
    from all others. An offset of the displacement looks like one of the force, but also shifts
    the turns.
    """
    for kind, size, before, after in record.changes:
        (old_path, _), (new_path, _) = before.paths[1], after.paths[1]
        max_shift = record.limits.cycle_change * (old_path[-1] - old_path[0])
        differs_in_turns = abs(new_path[-1] - old_path[-1]) > max_shift
        is_force_alone = kind == "level" and not differs_in_turns
        yield Finding.of(
            "process.cycle_level"
            if kind == "level"
            else ("process.cycle_scale" if kind == "scale" else "process.cycle_travel"),
            record.signals.force,
            *(("force",) if is_force_alone else ("force", "displacement")),
            during=record.stretch_from(before.unloading.stop - 1),
            cycle=after.loading.cycle,
            at=record.format_time(after.loading.start),
            size=size,
        )


def _find_instrument_change(
    record: Record, before: Cycle, after: Cycle
) -> tuple[str, float] | None:
    """Find whether level (N), scale or travel changed between two cycles, and by how much."""
    # Ratio of the misfit of two cycles as recorded to that after a change of scale or level. In 246
    # pairs of real and simulated cycles, where the material changes the shape of the curve, it is
    # at most 2.0 in whole cycles, and 4.0 (scale) and 6.2 (level) in unloading alone.
    min_scale_ratio = 3.0
    unloading_scale_ratio, unloading_level_ratio = 5.5, 8.0
    min_change = record.limits.cycle_change
    forces = _interpolate_common_forces(*before.paths, *after.paths)
    if not forces:
        return None
    old, new = np.concatenate(forces[:2]), np.concatenate(forces[2:])
    whole_cycle = slice(None), min_scale_ratio, min_scale_ratio
    unloading = slice(COMPARED_POINTS, None), unloading_scale_ratio, unloading_level_ratio
    for part, scale_ratio, level_ratio in (whole_cycle, unloading):
        first, second = old[part], new[part]
        recorded = _compute_rms(second - first)
        scale, level = float(first @ second / (first @ first)), float(np.mean(second - first))
        misfit, level_misfit = (
            _compute_rms(second - scale * first),
            _compute_rms(second - level - first),
        )
        if (
            misfit < level_misfit
            and abs(scale - 1.0) > min_change
            and recorded > scale_ratio * misfit
        ):
            return "scale", scale
        if abs(level) > min_change * record.largest_force and recorded > level_ratio * level_misfit:
            return "level", level
    (old_path, old_force), (new_path, new_force) = before.paths[1], after.paths[1]
    ratio = float(new_path[-1] / old_path[-1]) if old_path[-1] > 0.0 else 1.0
    if abs(ratio - 1.0) < min_change or ratio <= 0.0:
        return None
    rescaled = _interpolate_common_forces((old_path, old_force), (new_path / ratio, new_force))
    recorded = _compute_rms(new[COMPARED_POINTS:] - old[COMPARED_POINTS:])
    is_stretched = bool(rescaled) and recorded >= min_scale_ratio * _compute_rms(
        rescaled[1] - rescaled[0]
    )
    return ("travel", ratio) if is_stretched else None


def _check_turns(record: Record) -> Iterator[Finding]:
    """Report a force that still grows after a turn of the motion: it lags, or has jumped."""
    noise_factor = 8.0
    curve, where, limits = record.curve, record.signals.force, record.limits
    sense, min_growth = record.loading_sign(curve.branches[0]), noise_factor * record.force_noise
    growths = []
    for before, after in pairwise(curve.branches):
        sign = sense if before.direction is Direction.LOADING else -sense
        force_before, force_after = (
            curve.force[branch.start : branch.stop] for branch in (before, after)
        )
        ends = sign * _drop_missing(force_before[-max(3, len(force_before) // 10) :])
        starts = sign * _drop_missing(force_after[: max(3, len(force_after) // 10)])
        n_samples = min(len(ends), len(starts))
        if before.direction is after.direction or n_samples < 3:
            continue
        width = max(1, n_samples // 10)
        averaging = np.ones(width) / width
        last, first = (float(np.convolve(x, averaging, "valid").max()) for x in (ends, starts))
        step = max(0.0, float(ends[-1] - ends[0])) / (len(ends) - 1)
        growths.append((after, first - last - step))  # the turn is between two samples
    if not growths:
        return
    median_growth = median(np.array([growth for _, growth in growths]))
    branch, growth = max(growths, key=lambda turn: turn[1])
    if median_growth > max(limits.force_lag * record.largest_force, min_growth):
        share = median_growth / record.largest_force
        yield Finding.of("process.force_late", where, "clock", growth=median_growth, share=share)
    elif growth > max(limits.turn_jump * record.largest_force, min_growth):
        during, at = record.stretch_from(branch.start), record.format_time(branch.start)
        yield Finding.of(
            "process.turn_jump",
            where,
            "force",
            during=during,
            growth=growth,
            at=at,
            cycle=branch.cycle,
        )


def _check_energy(record: Record) -> Iterator[Finding]:
    """Report cycles whose specimen gives back more energy than was put into it."""
    gains = []
    for cycle in record.cycles:
        forces = _interpolate_common_forces(*cycle.paths)
        work_in = float(np.mean(np.abs(forces[0]))) if forces else 0.0
        if work_in:
            work_lost = record.loading_sign(cycle.loading) * float(np.mean(forces[0] - forces[1]))
            gain = -work_lost / work_in
            gains += [(cycle, gain)] if gain > record.limits.energy_gain else []
    # If most cycles gain energy, columns may be exchanged, or the record may be reversed.
    affects_most_cycles = len(gains) > len(record.cycles) / 2
    quantities = ("force", "displacement", "clock") if affects_most_cycles else ("force",)
    where, times = record.signals.force, record.curve.time
    for cycle, gain in gains[:1] if affects_most_cycles else gains:
        first, last = cycle.loading.start + 1, cycle.unloading.stop - 2
        inner_stretch = float(times[first]), float(times[last])
        during, number = None if affects_most_cycles else inner_stretch, cycle.loading.cycle
        yield Finding.of(
            "process.energy_gained", where, *quantities, during=during, cycle=number, gain=gain
        )


def _check_second_specimen(record: Record) -> Iterator[Finding]:
    """Report a record that continues with another specimen after the first one broke."""
    force_quantile = 0.8  # a broken specimen carries no force over this share of an unloading
    branches, limits = record.curve.branches, record.limits
    for cycle in record.cycles:
        next_branch = next((x for x in branches if x.start >= cycle.unloading.stop), None)
        paths = (*cycle.paths, _make_path(record.curve, next_branch)) if next_branch else ()
        forces = _interpolate_common_forces(*paths) if paths else ()
        if next_branch is None or not forces:
            continue
        first, back, second = (float(np.quantile(np.abs(x), force_quantile)) for x in forces)
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
    _check_level,
    _check_cycles,
    _check_turns,
    _check_energy,
    _check_second_specimen,
)
"""Checks in the order of their findings; those after the first need a force."""


def _drop_missing(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _compute_rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
