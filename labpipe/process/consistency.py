"""Check a record for contradictions: between cycles, rests, and force and displacement.

Each check compares one statistic with one threshold. The thresholds are multiples of the maxima
in real and simulated cyclic tests (docs/explanations/intervals.md), so that a clean record fails
a check in fewer than one case in fifty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import Literal

import numpy as np

from labpipe.records.arrays import Floats, find_runs, median
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import LIMITS, Limits
from labpipe.records.quality import Finding, Findings
from labpipe.records.signals import Signals
from labpipe.results.reduced_test import FailurePoint, compute_loading_sign
from labpipe.signal.rests_and_jumps import find_level_jumps
from labpipe.signal.turning_points import estimate_noise_level

NO_FINDINGS = Findings()
COMPARED_POINTS = 40
"""Displacements of a branch at which cycles are compared."""
MIN_COMPARED_SAMPLES = 5
"""Shorter branches are not compared."""
REST_ERROR_FACTOR = 6.0
"""Standard errors that a difference of levels must exceed."""
MIN_REST_SAMPLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """Force over displacement of a whole cycle, each branch sorted by displacement."""

    loading: Branch
    unloading: Branch
    paths: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


def check_consistency(
    signals: Signals,
    curve: Curve,
    limits: Limits = LIMITS,
    *,
    earlier_findings: Findings = NO_FINDINGS,
) -> Iterator[Finding]:
    """Compare the parts of a record.

    Parameters
    ----------
    signals : of the test, with the stretches of their zeros
    curve : of unfiltered force, with branches
    limits : of the lab
    known : findings about single channels

    Yields
    ------
    A finding for each failed check: which cycle, when, how much, and what is doubtful.
    """
    where, largest = signals.force, float(np.nanmax(np.abs(curve.force), initial=0.0))
    if not curve.branches:
        return
    yield from _check_repetition(where, curve)
    yield from _check_displacement_jumps(signals.displacement, curve, largest, earlier_findings)
    if largest > 0.0:
        cycles = list(_cycles(curve))
        yield from _check_rest_force(signals, curve, largest, limits.rest_force)
        changes = list(_check_cycles(where, curve, cycles, largest, limits.cycle_change))
        jumps = list(_check_force_jumps(where, curve, earlier_findings))
        is_level = any(change.code == "cycle_level" for change in changes)
        yield from jumps or _check_drift(where, curve, limits.rest_force_drift, is_level=is_level)
        yield from changes
        yield from _check_turns(where, curve, largest, limits)
        yield from _check_energy(where, curve, cycles, limits.energy_gain)
        yield from _check_second_specimen(where, curve, cycles, limits)


def _cycles(curve: Curve) -> Iterator[Cycle]:
    for first, second in pairwise(curve.branches):
        if first.direction is not Direction.LOADING or second.cycle != first.cycle:
            continue
        paths = _make_path(curve, first), _make_path(curve, second)
        if min(len(path[0]) for path in paths) >= MIN_COMPARED_SAMPLES:
            yield Cycle(first, second, paths)


def _make_path(curve: Curve, branch: Branch) -> tuple[Floats, Floats]:
    part = slice(branch.start, branch.stop)
    samples = np.stack([curve.displacement[part], curve.force[part]])
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


def _check_repetition(where: str, curve: Curve) -> Iterator[Finding]:
    """Report a record with a long sequence of samples that occurs twice: rows were copied."""
    min_repeated = 40
    max_samples = 200_000  # longer records have not been edited in a spreadsheet
    force, displacement = curve.force, curve.displacement
    if not 4 * min_repeated <= len(force) <= max_samples:
        return
    rows = np.stack([force[:-1], force[1:], displacement[:-1], displacement[1:]])
    keys = np.array([1.0, np.e, np.pi, np.sqrt(2.0)]) @ rows  # equal for equal rows
    order = np.argsort(keys, kind="stable")
    lags = np.diff(order)[np.diff(keys[order]) == 0.0]
    if len(lags) < min_repeated:
        return
    lag = int(np.argmax(np.bincount(np.abs(lags))))
    same = (force[lag:] == force[:-lag]) & (displacement[lag:] == displacement[:-lag])
    for start, stop in find_runs(same):
        if len(np.unique(force[start:stop])) >= min_repeated:
            at, count = _format_time(curve, start), stop - start
            quantities = "force", "displacement"
            yield Finding.of(
                "process.samples_repeated", where, *quantities, count=count, at=at, lag=lag
            )
            return


def _find_jumps(
    curve: Curve, quantity: Literal["force", "displacement"], earlier_findings: Findings
) -> list[tuple[int, float]]:
    """Find jumps of a quantity: sample and size, without jumps at the end of a frozen run."""
    max_samples_after_run = 2
    stuck_until = [
        int(np.searchsorted(curve.time, doubt.during[1]))
        for finding in earlier_findings.entries
        for doubt in finding.doubts
        if finding.code == "frozen_channel" and doubt.quantity == quantity and doubt.during
    ]
    return [
        (sample, size)
        for sample, size in find_level_jumps(curve.time, getattr(curve, quantity))
        if all(abs(sample - end) > max_samples_after_run for end in stuck_until)
    ]


def _check_displacement_jumps(
    where: str, curve: Curve, largest: float, earlier_findings: Findings
) -> Iterator[Finding]:
    """Report jumps of the displacement that no break explains."""
    break_share = 0.3  # fall of the force at a break, share of the largest force
    jumps = _find_jumps(curve, "displacement", earlier_findings)
    falls = [abs(curve.force[sample - 1]) - abs(curve.force[sample]) for sample, _ in jumps]
    if not jumps or (len(jumps) == 1 and falls[0] > break_share * largest):
        return
    sample, size = max(jumps, key=lambda jump: abs(jump[1]))
    mm, at, count = 1e3 * size, _format_time(curve, sample), len(jumps)
    quantities = "displacement", "force"
    yield Finding.of("process.zero_jump", where, *quantities, mm=mm, at=at, count=count)


def _check_force_jumps(where: str, curve: Curve, earlier_findings: Findings) -> Iterator[Finding]:
    """Report a jump of the force that no specimen causes: up in a loading, any in an unloading."""
    turn_reach, max_jumps = 3, 2  # samples beside a turn; more jumps are of the specimen
    sense = _find_sense(curve, curve.branches[0])
    jumps = _find_jumps(curve, "force", earlier_findings)
    for sample, size in jumps if len(jumps) <= max_jumps else ():
        for branch in curve.branches:
            is_odd = branch.direction is Direction.UNLOADING or sense * size > 0.0
            if is_odd and branch.start + turn_reach < sample < branch.stop - turn_reach:
                during, at = (
                    (float(curve.time[sample]), float(curve.time[-1])),
                    _format_time(curve, sample),
                )
                yield Finding.of(
                    "process.force_jump", where, "force", during=during, size=size, at=at
                )
                return


def _check_rest_force(
    signals: Signals, curve: Curve, largest: float, share: float
) -> Iterator[Finding]:
    """Report the force before the motion if no step zeroes it."""
    min_samples, min_share = 8, 1e-4  # share of the largest force
    name, before = signals.force, _drop_missing(curve.force[: curve.branches[0].start])
    if (
        name in signals.zero_stretches
        or name in signals.moving_zero_stretches
        or len(before) < min_samples
    ):
        return
    level, error = median(before), estimate_noise_level(curve.force) / sqrt(len(before))
    if abs(level) <= max(REST_ERROR_FACTOR * error, min_share * largest):
        return
    part = abs(level) / largest
    if part > max(share, 2.0 * signals.raw[name].zero_drift):
        yield Finding.of("process.rest_force_doubtful", name, "force", level=level, share=part)
    else:
        yield Finding.of("process.rest_force", name, level=level, share=part)


def _check_drift(where: str, curve: Curve, share: float, *, is_level: bool) -> Iterator[Finding]:
    """Compare the force at rest before and after a test that returns to its first position.

    A specimen with friction or permanent set pushes back after unloading. A force against the sense
    of loading is therefore a drift only if the level also changes between cycles (`is_level`).
    """
    return_share = 0.02  # largest distance from the first position, share of the stroke
    first, last = curve.branches[0], curve.branches[-1]
    before, after = (
        _drop_missing(curve.force[: first.start]),
        _drop_missing(curve.force[last.stop :]),
    )
    distance = abs(curve.displacement[last.stop - 1] - curve.displacement[first.start])
    has_returned = last.direction is Direction.UNLOADING and distance <= return_share * np.ptp(
        _drop_missing(curve.displacement)
    )
    if not has_returned or min(len(before), len(after)) < MIN_REST_SAMPLES:
        return
    part, level = curve.force[first.start : last.stop], median(before)
    end = median(after[-len(before) :])  # the end of a long rest, because specimens relax
    largest = float(np.nanmax(np.abs(part - level)))
    error = estimate_noise_level(curve.force) * sqrt(1.0 / len(before) + 1.0 / len(after))
    change = compute_loading_sign(part) * (end - level)
    if (abs(change) if is_level else change) >= max(share * largest, REST_ERROR_FACTOR * error):
        yield Finding.of(
            "process.zero_drift", where, "force", level=level, end=end, share=abs(change) / largest
        )


def check_break(
    where: str, curve: Curve, failure: object, limits: Limits = LIMITS
) -> Iterator[Finding]:
    """Report a force below zero after the specimen broke.

    Parameters
    ----------
    where : name of the force
    curve, failure : of the test. A force above zero is allowed, because the remains of a specimen
        may carry it; so is a rebound of a few samples
    limits : of the lab
    """
    min_tail_samples = 10  # fewer may be a rebound
    if not isinstance(failure, FailurePoint):
        return
    after = _drop_missing(curve.force[failure.sample + 1 :])
    if len(after) < min_tail_samples:
        return
    level, largest = median(after[len(after) // 2 :]), float(np.nanmax(np.abs(curve.force)))
    error = estimate_noise_level(curve.force) * sqrt(2.0 / len(after))
    below = -compute_loading_sign(curve.force[: failure.sample + 1]) * level
    if below >= max(limits.rest_force_drift * largest, REST_ERROR_FACTOR * error):
        yield Finding.of(
            "process.zero_drift_after_break", where, "force", level=level, share=below / largest
        )


def _check_cycles(
    where: str, curve: Curve, cycles: list[Cycle], largest: float, least: float
) -> Iterator[Finding]:
    """Report changes of scale or level that are the same over a whole cycle.

    The instruments cause them: conditioning, hardening, fatigue and permanent set change loading
    and unloading differently. Unloading is also compared alone, because a first loading differs
    from all others.
    """
    for before, after in pairwise(cycles):
        change = _find_instrument_change(before, after, largest, least)
        if change is None:
            continue
        kind, size = change
        # An offset of the travel looks like one of the force, but its turns are elsewhere, too.
        is_force_alone = kind == "level" and not _differ_in_turns(before, after, least)
        yield Finding.of(
            "process.cycle_level"
            if kind == "level"
            else "process.cycle_scale"
            if kind == "scale"
            else "process.cycle_travel",
            where,
            *(("force",) if is_force_alone else ("force", "displacement")),
            during=(float(curve.time[before.unloading.stop - 1]), float(curve.time[-1])),
            cycle=after.loading.cycle,
            at=_format_time(curve, after.loading.start),
            size=size,
        )


def _differ_in_turns(before: Cycle, after: Cycle, least: float) -> bool:
    """Check whether the largest displacements of two cycles differ by a share of the travel."""
    (old, _), (new, _) = before.paths[1], after.paths[1]
    return bool(abs(new[-1] - old[-1]) > least * (old[-1] - old[0]))


def _find_instrument_change(
    before: Cycle, after: Cycle, largest: float, least: float
) -> tuple[str, float] | None:
    """Find whether level (N), scale or travel changed between two cycles, and by how much."""
    # Ratio of the misfit of two cycles as recorded to that after a change of scale or level. In 246
    # pairs of real and simulated cycles, where the material changes the shape of the curve, it is
    # at most 2.0 in whole cycles, and 4.0 (scale) and 6.2 (level) in unloading alone.
    min_scale_ratio = 3.0
    unloading_scale_ratio, unloading_level_ratio = 5.5, 8.0
    forces = _interpolate_common_forces(*before.paths, *after.paths)
    if not forces:
        return None
    old, new = np.concatenate(forces[:2]), np.concatenate(forces[2:])
    whole_cycle = slice(None), min_scale_ratio, min_scale_ratio
    unloading = slice(COMPARED_POINTS, None), unloading_scale_ratio, unloading_level_ratio
    for part, scale_ratio, level_ratio in (whole_cycle, unloading):
        first, second = old[part], new[part]
        recorded = _rms(second - first)
        scale, level = float(first @ second / (first @ first)), float(np.mean(second - first))
        misfit, level_misfit = _rms(second - scale * first), _rms(second - level - first)
        if misfit < level_misfit and abs(scale - 1.0) > least and recorded > scale_ratio * misfit:
            return "scale", scale
        if abs(level) > least * largest and recorded > level_ratio * level_misfit:
            return "level", level
    old_unloading, back = before.paths[1], after.paths[1]
    stretch = back[0][-1] / old_unloading[0][-1] if old_unloading[0][-1] > 0.0 else 1.0
    scaled = (
        _interpolate_common_forces(old_unloading, (back[0] / stretch, back[1]))
        if stretch > 0.0
        else ()
    )
    misfit = _rms(scaled[1] - scaled[0]) if scaled else np.inf
    recorded = _rms(new[COMPARED_POINTS:] - old[COMPARED_POINTS:])
    is_stretched = abs(stretch - 1.0) >= least and recorded >= min_scale_ratio * misfit
    return ("travel", float(stretch)) if is_stretched else None


def _check_turns(where: str, curve: Curve, largest: float, limits: Limits) -> Iterator[Finding]:
    """Report a force that still grows after the motion has turned: it is late, or has jumped."""
    noise_factor = 8.0
    sense = _find_sense(curve, curve.branches[0])
    min_growth = noise_factor * estimate_noise_level(curve.force)
    growths = []
    for before, after in pairwise(curve.branches):
        if before.direction is after.direction:
            continue
        up = sense if before.direction is Direction.LOADING else -sense
        tenths = [max(3, (branch.stop - branch.start) // 10) for branch in (before, after)]
        end = up * _drop_missing(
            curve.force[max(before.start, before.stop - tenths[0]) : before.stop]
        )
        begin = up * _drop_missing(
            curve.force[after.start : min(after.stop, after.start + tenths[1])]
        )
        width = max(1, min(len(end), len(begin)) // 10)
        if min(len(end), len(begin)) >= 3:
            last, first = (
                float(np.convolve(part, np.ones(width) / width, "valid").max())
                for part in (end, begin)
            )
            step = max(0.0, float(end[-1] - end[0])) / (len(end) - 1)
            growths.append((after, first - last - step))  # the turn is between two samples
    if not growths:
        return
    median_growth = median(np.array([growth for _, growth in growths]))
    branch, growth = max(growths, key=lambda turn: turn[1])
    if median_growth > max(limits.force_lag * largest, min_growth):
        yield Finding.of(
            "process.force_late",
            where,
            "clock",
            growth=median_growth,
            share=median_growth / largest,
        )
    elif growth > max(limits.turn_jump * largest, min_growth):
        during = float(curve.time[branch.start]), float(curve.time[-1])
        at, cycle = _format_time(curve, branch.start), branch.cycle
        yield Finding.of(
            "process.turn_jump", where, "force", during=during, growth=growth, at=at, cycle=cycle
        )


def _check_energy(where: str, curve: Curve, cycles: list[Cycle], most: float) -> Iterator[Finding]:
    """Report cycles whose specimen gives back more energy than was put into it."""
    gains = []
    for cycle in cycles:
        forces = _interpolate_common_forces(*cycle.paths)
        sense = _find_sense(curve, cycle.loading)
        work_in = float(np.mean(np.abs(forces[0]))) if forces else 0.0
        loss = sense * float(np.mean(forces[0] - forces[1])) / work_in if work_in else 0.0
        if loss < -most:
            gains.append((cycle, -loss))
    # If most cycles gain energy, columns may be exchanged, or the record may be reversed.
    affects_most_cycles = len(gains) > len(cycles) / 2
    quantities = ("force", "displacement", "clock") if affects_most_cycles else ("force",)
    for cycle, gain in gains[:1] if affects_most_cycles else gains:
        inner = curve.time[[cycle.loading.start + 1, cycle.unloading.stop - 2]]
        during = None if affects_most_cycles else (float(inner[0]), float(inner[1]))
        number = cycle.loading.cycle
        yield Finding.of(
            "process.energy_gained", where, *quantities, during=during, cycle=number, gain=gain
        )


def _check_second_specimen(
    where: str, curve: Curve, cycles: list[Cycle], limits: Limits
) -> Iterator[Finding]:
    """Report a record that goes on with another specimen after the first one broke."""
    force_quantile = 0.8  # a broken specimen carries no force over this share of an unloading
    for before in cycles:
        later = [branch for branch in curve.branches if branch.start >= before.unloading.stop][:1]
        forces = (
            _interpolate_common_forces(*before.paths, _make_path(curve, later[0])) if later else ()
        )
        if not forces:
            continue
        first, back, second = (
            float(np.quantile(np.abs(force), force_quantile)) for force in forces
        )
        if back < limits.broken_force * first and second > limits.second_loading * first:
            yield Finding.of(
                "process.second_specimen",
                where,
                "force",
                "displacement",
                cycle=before.loading.cycle,
                back=back,
                later=later[0].cycle,
                second=second,
            )
            return


def _find_sense(curve: Curve, branch: Branch) -> float:
    return compute_loading_sign(curve.force[branch.start : branch.stop])


def _drop_missing(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _format_time(curve: Curve, sample: int) -> str:
    return f"{curve.time[sample]:.3f} s" if curve.time_unit == "s" else f"sample {sample + 1}"
