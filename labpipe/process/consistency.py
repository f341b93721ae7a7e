"""Check a record for contradictions: cycle against cycle, force against displacement.

Each check compares one statistic with one threshold. The thresholds are multiples of the maxima
in real and simulated cyclic tests (docs/explanations/consistency.md), so that a clean record fails
a check in fewer than one case in fifty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labpipe.records.arrays import Floats, median, stretches_of
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import LIMITS, Limits
from labpipe.records.quality import Finding, doubtful
from labpipe.results.reduced_test import sense_of_loading
from labpipe.signal.turning_points import noise_level

COMPARED_POINTS = 40
"""Displacements of a branch at which cycles are compared."""
MIN_BRANCH_SAMPLES = 5
"""Shorter branches are not compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """Force over displacement of a whole cycle, each branch sorted by displacement."""

    loading: Branch
    unloading: Branch
    paths: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]


def check_consistency(where: str, curve: Curve, limits: Limits = LIMITS) -> Iterator[Finding]:
    """Compare the parts of a record.

    Parameters
    ----------
    where : name of the force
    curve : of unfiltered force, with branches
    limits : of the lab

    Yields
    ------
    A finding for each failed check: which cycle, when, how much, and what is doubtful.
    """
    if not curve.branches:
        return
    largest = float(np.nanmax(np.abs(curve.force), initial=0.0))
    cycles = list(_cycles(curve))
    yield from _check_repetition(where, curve)
    if largest > 0.0:
        yield from _check_cycles(where, curve, cycles, largest, limits)
        yield from _check_turns(where, curve, largest, limits)
        yield from _check_energy(where, curve, cycles, limits)
        yield from _check_second_specimen(where, curve, cycles, limits)


def _cycles(curve: Curve) -> Iterator[Cycle]:
    for first, second in pairwise(curve.branches):
        if first.direction is not Direction.LOADING or second.cycle != first.cycle:
            continue
        paths = _path(curve, first), _path(curve, second)
        if min(len(path[0]) for path in paths) >= MIN_BRANCH_SAMPLES:
            yield Cycle(first, second, paths)


def _path(curve: Curve, branch: Branch) -> tuple[Floats, Floats]:
    part = slice(branch.start, branch.stop)
    both = np.stack([curve.displacement[part], curve.force[part]])
    both = both[:, ~np.isnan(both).any(axis=0)]
    max_means = 400
    size = max(1, both.shape[1] // max_means)
    means = both[:, : both.shape[1] // size * size].reshape(2, -1, size).mean(axis=2)
    displacement, force = means[:, np.argsort(means[0], kind="stable")]
    return displacement, force


def _common(*paths: tuple[Floats, Floats]) -> tuple[Floats, ...]:
    """Return the forces of several paths at common displacements; empty if they hardly overlap."""
    min_common_share = 0.5
    if min(len(path[0]) for path in paths) < MIN_BRANCH_SAMPLES:
        return ()
    low, high = max(path[0][0] for path in paths), min(path[0][-1] for path in paths)
    span = max(path[0][-1] for path in paths) - min(path[0][0] for path in paths)
    if not high - low > min_common_share * span:
        return ()
    places = np.linspace(low, high, COMPARED_POINTS + 2)[1:-1]
    return tuple(np.interp(places, *path) for path in paths)


def _check_cycles(
    where: str, curve: Curve, cycles: list[Cycle], largest: float, limits: Limits
) -> Iterator[Finding]:
    """Report changes of scale or level that are the same over a whole cycle.

    The instruments cause them: conditioning, hardening, fatigue and permanent set change loading
    and unloading differently. Unloading is also compared alone, because a first loading differs
    from all others.
    """
    for before, after in pairwise(cycles):
        change = _instrument_change(before, after, largest, limits.cycle_change)
        if change is None:
            continue
        is_level, what, remedy = change
        message = (
            f"from cycle {after.loading.cycle} on ({_at(curve, after.loading.start)}) {what}, in "
            f"loading and unloading alike, which no specimen causes: {remedy}"
        )
        during = (float(curve.time[before.unloading.stop - 1]), float(curve.time[-1]))
        if is_level:
            yield doubtful("cycle_level", where, message, "force", during=during)
        else:
            yield doubtful("cycle_scale", where, message, "force", "displacement", during=during)


def _instrument_change(
    before: Cycle, after: Cycle, largest: float, least: float
) -> tuple[bool, str, str] | None:
    """Return whether the level (or else the scale) changed, a description, and a remedy."""
    # Misfit of two cycles as recorded, over the misfit after a change of scale or level. It is at
    # most 2.0 in 246 pairs of real and simulated cycles, where the material changes the shape of
    # the curve.
    min_scale_ratio = 3.0
    # The ratios of unloading alone are at most 4.0 and 6.2 in the same pairs.
    unloading_scale_ratio, unloading_level_ratio = 5.5, 8.0
    forces = _common(*before.paths, *after.paths)
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
            description = (
                f"the force over displacement is {scale:.4g} times that of the cycle before"
            )
            return False, description, "check for a change of range, gain or encoder"
        if abs(level) > least * largest and recorded > level_ratio * level_misfit:
            description = f"the force is {level:+.4g} N off that of the cycle before"
            return True, description, "check for a new zero of the load cell"
    first_back, back = before.paths[1], after.paths[1]
    stretch = back[0][-1] / first_back[0][-1] if first_back[0][-1] > 0.0 else 1.0
    scaled = _common(first_back, (back[0] / stretch, back[1])) if stretch > 0.0 else ()
    misfit = _rms(scaled[1] - scaled[0]) if scaled else np.inf
    recorded = _rms(new[COMPARED_POINTS:] - old[COMPARED_POINTS:])
    if abs(stretch - 1.0) < least or recorded < min_scale_ratio * misfit:
        return None
    description = f"the travel is {stretch:.4g} times that of the cycle before at equal forces"
    return False, description, "check for a change of the encoder or its scale"


def _check_turns(where: str, curve: Curve, largest: float, limits: Limits) -> Iterator[Finding]:
    """Report a force that still grows after the motion has turned: it is late, or has jumped."""
    noise_factor = 8.0
    sense = sense_of_loading(curve.force[curve.branches[0].start : curve.branches[0].stop])
    min_growth = noise_factor * noise_level(curve.force)
    growths = []
    for before, after in pairwise(curve.branches):
        if before.direction is after.direction:
            continue
        sense_of_branch = sense if before.direction is Direction.LOADING else -sense
        ends = [_tenth(curve, before, at_end=True), _tenth(curve, after, at_end=False)]
        width = max(1, min(map(len, ends)) // 10)
        if min(map(len, ends)) >= 3:
            last, first = (float(_means(sense_of_branch * end, width).max()) for end in ends)
            step = max(0.0, sense_of_branch * float(ends[0][-1] - ends[0][0])) / (len(ends[0]) - 1)
            growths.append((after, first - last - step))  # the turn is between two samples
    if not growths:
        return
    usual_growth = median(np.array([growth for _, growth in growths]))
    if usual_growth > max(limits.force_lag * largest, min_growth):
        message = (
            f"the force grows by {usual_growth:.3g} N ({usual_growth / largest:.1%} of the peak) "
            "after the turns of the motion: force and displacement are not synchronous"
        )
        yield doubtful("force_late", where, message, "clock")
        return
    branch, growth = max(growths, key=lambda turn: turn[1])
    if growth > max(limits.turn_jump * largest, min_growth):
        message = (
            f"the force jumps by {growth:.4g} N where the motion turns at "
            f"{_at(curve, branch.start)} (cycle {branch.cycle}), in the wrong direction: check the "
            "cable and the tare of the load cell"
        )
        during = (float(curve.time[branch.start]), float(curve.time[-1]))
        yield doubtful("turn_jump", where, message, "force", during=during)


def _check_energy(
    where: str, curve: Curve, cycles: list[Cycle], limits: Limits
) -> Iterator[Finding]:
    """Report cycles whose specimen gives back more energy than was put into it."""
    gains = []
    for cycle in cycles:
        forces = _common(*cycle.paths)
        sense = sense_of_loading(curve.force[cycle.loading.start : cycle.loading.stop])
        put_in = float(np.mean(np.abs(forces[0]))) if forces else 0.0
        loss = sense * float(np.mean(forces[0] - forces[1])) / put_in if put_in else 0.0
        if loss < -limits.energy_gain:
            gains.append((cycle, -loss))
    # in most cycles: the columns may be exchanged, or the record reversed
    touches_all = len(gains) > len(cycles) / 2
    for cycle, gain in gains[:1] if touches_all else gains:
        message = (
            f"in cycle {cycle.loading.cycle} the specimen gives back {gain:.0%} more energy than "
            "was put into it: the record runs backwards, columns are exchanged, or the force is "
            "late or frozen"
        )
        quantities = ("force", "displacement", "clock") if touches_all else ("force",)
        inner = curve.time[[cycle.loading.start + 1, cycle.unloading.stop - 2]]
        during = None if touches_all else (float(inner[0]), float(inner[1]))
        yield doubtful("energy_gained", where, message, *quantities, during=during)


def _check_second_specimen(
    where: str, curve: Curve, cycles: list[Cycle], limits: Limits
) -> Iterator[Finding]:
    """Report a record that goes on with another specimen after the first one broke."""
    unloading_quantile = 0.8  # below it, a broken specimen carries no force on the way back
    for before in cycles:
        later = [branch for branch in curve.branches if branch.start >= before.unloading.stop]
        if not later or later[0].stop - later[0].start < MIN_BRANCH_SAMPLES:
            continue
        forces = _common(*before.paths, _path(curve, later[0]))
        if not forces:
            continue
        first, back, second = (
            float(np.quantile(np.abs(force), unloading_quantile)) for force in forces
        )
        if back < limits.broken_force * first and second > limits.second_loading * first:
            message = (
                f"the specimen is broken at the end of cycle {before.loading.cycle} (it carries "
                f"{back:.3g} N in unloading), but cycle {later[0].cycle} carries "
                f"{second:.4g} N: a second specimen in one record? Export them separately"
            )
            yield doubtful("second_specimen", where, message, "force", "displacement")
            return


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
    runs = [run for run in stretches_of(same) if len(np.unique(force[slice(*run)])) >= min_repeated]
    if runs:
        start, stop = runs[0]
        message = (
            f"{stop - start} samples from {_at(curve, start)} on occur again, {lag} samples later: "
            "were rows copied? Export the recording again"
        )
        yield doubtful("samples_repeated", where, message, "force", "displacement")


def _tenth(curve: Curve, branch: Branch, *, at_end: bool) -> Floats:
    size = max(3, (branch.stop - branch.start) // 10)
    part = slice(max(branch.start, branch.stop - size), branch.stop)
    if not at_end:
        part = slice(branch.start, min(branch.stop, branch.start + size))
    values = curve.force[part]
    return values[~np.isnan(values)]


def _means(values: Floats, width: int) -> Floats:
    return np.convolve(values, np.ones(width) / width, "valid")


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _at(curve: Curve, sample: int) -> str:
    return f"{curve.time[sample]:.3f} s" if curve.time_unit == "s" else f"sample {sample + 1}"
