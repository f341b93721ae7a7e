"""Stiffnesses of every cycle: at the start of loading, of unloading, and how they change."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from labpipe.fits.loops import secant_stiffness
from labpipe.fits.slack import find_branch_slack
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch
from labpipe.records.declarations import CURVE, Length, Output
from labpipe.records.estimates import Estimate, Failure, scaled, widened
from labpipe.results.cycles import NO_UNLOADING, CycleNumber, other_shape, per_cycle
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import (
    NO_LOADING,
    Computed,
    Errors,
    Kind,
    Outcome,
    blocked_or,
    force_scale,
)
from labpipe.signal.filters import moving_average


@dataclass(frozen=True, slots=True, kw_only=True)
class UnloadingStiffness(Kind):
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    outputs: ClassVar = (
        Output("unloading_stiffness", "N/m", "Unloading stiffness", CURVE, first=1),
    )
    over: Length

    def compute(self, test: Evidence) -> Computed:
        """Slope over the first stretch of the unloading branch, but for its first tenth."""
        method = f"line from {0.1 * self.over:g} m to {self.over:g} m off the peak, time as"
        how = CycleNumber(self._value, _scale, f"{method} instrument", reads=(1, 2))
        return per_cycle(self, test, how)

    def _value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        if len(branches) < 2:
            return NO_UNLOADING
        sense = test.sense_of(displacement)
        turn = _value_at_start(test.known_curve.time, sense * displacement, branches[1])
        off = turn - sense * displacement
        found = stiffness_over(test, branches[1], off, 0.1 * self.over, self.over)
        if isinstance(found, Failure):
            return found
        return Estimate(-sense * found.value, found.error, found.n)


def _scale(test: Evidence, branches: list[Branch], value: float) -> Errors:
    del branches
    return force_scale(test, value)


def _value_at_start(time: Floats, values: Floats, part: Branch) -> float:
    """Value at the turning point a branch starts from, by a parabola through its beginning.

    The samples from that moment on: a branch may hold some of the wait before it.
    """
    first = max(part.start, int(np.searchsorted(time, part.start_time)))
    begin = slice(first, first + min(50, (part.stop - first) // 10))
    known = ~np.isnan(values[begin])
    t, y = time[begin][known] - part.start_time, values[begin][known]
    if len(y) < 8:
        return float(values[part.start])
    return float(np.polynomial.Polynomial.fit(t, y, 2)(0.0))


def stiffness_over(
    test: Evidence, part: Branch, path_of_all: Floats, low: float, high: float
) -> Outcome:
    """Stiffness over the part of a branch whose path lies between two lengths.

    Parameters
    ----------
    test : with a curve
    part : the branch, or a stretch of it
    path_of_all : shape (n,), m, on the clock of the curve, growing along the branch
    low, high : m

    Returns
    -------
    N/m, without the uncertainty of the scale of the force; a failure ``not_reached``,
    ``too_few_samples`` or ``no_travel``.
    """
    curve, branch = test.known_curve, slice(part.start, part.stop)
    time, force, path = curve.time[branch], curve.force[branch], path_of_all[branch]
    travelled = moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    inside = (travelled >= low) & (travelled <= high)
    if not (travelled > high).any():
        reached = float(np.nanmax(travelled))
        return Failure("not_reached", f"the branch reaches {reached:.4g} m, {high:.4g} m is asked")
    inside[int(np.argmax(travelled > high)) :] = False
    found = secant_stiffness(time, path, force, inside)
    # Where the force bends over the window, a shift of the clocks changes its slope.
    shifted = np.interp(time + test.clocks.error, time, force)
    moved = secant_stiffness(time, path, shifted, inside)
    if isinstance(found, Failure) or isinstance(moved, Failure):
        return found
    return widened(found, moved.value - found.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadingStiffness(Kind):
    """``loading_stiffness.<cycle>`` (N/m): slope just after the force takes up."""

    result: ClassVar = "loading-stiffness"
    outputs: ClassVar = (Output("loading_stiffness", "N/m", "Loading stiffness", CURVE, first=1),)
    over: Length

    def compute(self, test: Evidence) -> Computed:
        """Slope over the first stretch behind the take-up of each cycle."""
        method = f"line over {1e3 * self.over:g} mm from where the force takes up, time as"
        how = CycleNumber(self._value, _scale, f"{method} instrument", reads=(0, 1))
        return per_cycle(self, test, how)

    def _value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        return _taut_stiffness(test, branches, displacement, self.over)


def _taut_stiffness(
    test: Evidence, branches: list[Branch], displacement: Floats, over: float
) -> Outcome:
    """Stiffness over the first stretch behind the take-up, N/m, scale taken as exact."""
    part = slice(branches[0].start, branches[0].stop)
    zero = test.raw_force.zero_error
    start = find_branch_slack(displacement[part], test.known_curve.force[part], zero_error=zero)
    if isinstance(start, Failure):
        return start
    taut = replace(branches[0], start=branches[0].start + start.sample)
    found, later = (
        stiffness_over(test, taut, displacement, low, low + over)
        for low in (start.displacement.value, start.displacement.value + start.displacement.error)
    )
    if isinstance(found, Failure) or isinstance(later, Failure):
        return found
    return widened(found, later.value - found.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardening(Kind):
    """``hardening.<cycle>`` (1) of later cycles: ``loading_stiffness`` over that of the first."""

    result: ClassVar = "hardening"
    outputs: ClassVar = (Output("hardening", "1", "Hardening", CURVE, first=2),)
    over: Length

    def compute(self, test: Evidence) -> Computed:
        """Ratio to the first cycle; the scale cancels."""
        method = f"slope over {1e3 * self.over:g} mm from the take-up / that of cycle 1, scale"
        method += " cancelled"
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        numbers = []
        for later in test.cycles[1:]:
            found = self._value(test, later, test.displacement.values)
            numbers.append(
                self.number(
                    self.outputs[0],
                    found,
                    method,
                    other_shape(test, later, self._value, found),
                    during=(test.cycles[0][0].start_time, later[0].stop_time),
                    part=f".{later[0].cycle}",
                )
            )
        return Computed(tuple(numbers))

    def _value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        before = _taut_stiffness(test, test.cycles[0], displacement, self.over)
        after = _taut_stiffness(test, branches, displacement, self.over)
        if isinstance(after, Failure):
            return after
        if isinstance(before, Failure):
            message = f"that of cycle 1 is not available: {before.message}"
            return Failure("no_stiffness", message)
        if before.value <= 3.0 * before.error:
            message = f"{before.value:.4g} N/m in cycle 1 is no more than noise"
            return Failure("no_stiffness", message)
        more = abs(after.value) * before.error / before.value
        return scaled(after, 1.0 / before.value, more=more)


KINDS = (UnloadingStiffness, LoadingStiffness, Hardening)
