"""Stiffnesses of the first loading and of every cycle, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np

from labpipe.fits.least_squares import slope_of_line
from labpipe.fits.loops import secant_stiffness
from labpipe.fits.slack import find_branch_slack
from labpipe.fits.straight_lines import (
    LEAST_OF_LINE,
    annulus_area,
    fit_compliance,
    rectangle_area,
    thin_wall_area,
    timed_slope,
)
from labpipe.fits.two_segments import fit_two_segments
from labpipe.records.arrays import Floats, Ints, samples_of
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.declarations import (
    CURVE,
    Above,
    Distance,
    Force,
    Key,
    Length,
    Needs,
    Output,
    Snake,
    StiffnessName,
)
from labpipe.records.estimates import Estimate, Failure, scaled, widened
from labpipe.records.quality import Reason
from labpipe.results.cycles import (
    NO_UNLOADING,
    PerCycle,
    cut_short,
    other_shape,
    peak_of,
)
from labpipe.results.evidence import Evidence, Stiffness
from labpipe.results.kinds import (
    NO_CYCLE,
    NO_LOADING,
    Computed,
    Found,
    Kind,
    Outcome,
    blocked_or,
    force_scale,
    marked_slips,
)
from labpipe.results.likely_curves import loading_of, traced
from labpipe.signal.filters import moving_average
from labpipe.uncertainty.readings import Reading, Trace, combined


@dataclass(frozen=True, slots=True, kw_only=True)
class UnloadingStiffness(PerCycle):
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    outputs: ClassVar = (
        Output("unloading_stiffness", "N/m", "Unloading stiffness", CURVE, first=1),
    )
    over: Length
    reads: ClassVar = (1.0, 2.0)

    @property
    def method(self) -> str:
        """With the stretch that it is read from."""
        return (
            f"line from {0.1 * self.over:g} m to {self.over:g} m off the peak, time as instrument"
        )

    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Slope over the first stretch of the unloading branch, but for its first tenth."""
        if len(branches) < 2:
            return NO_UNLOADING
        sense = test.sense_of(displacement)
        turn = _value_at_start(test.known_curve.time, sense * displacement, branches[1])
        off = turn - sense * displacement
        found = stiffness_over(test, branches[1], off, 0.1 * self.over, self.over)
        if isinstance(found, Failure):
            return found
        return Estimate(-sense * found.value, found.error, found.n)


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
class LoadingStiffness(PerCycle):
    """``loading_stiffness.<cycle>`` (N/m): slope just after the force takes up."""

    result: ClassVar = "loading-stiffness"
    outputs: ClassVar = (Output("loading_stiffness", "N/m", "Loading stiffness", CURVE, first=1),)
    over: Length
    reads: ClassVar = (0.0, 1.0)

    @property
    def method(self) -> str:
        """With the stretch that it is read from."""
        return f"line over {1e3 * self.over:g} mm from where the force takes up, time as instrument"

    def value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        """Slope over the first stretch behind the take-up, the scale of the force as exact."""
        part = slice(branches[0].start, branches[0].stop)
        zero = test.raw_force.zero_error
        start = find_branch_slack(displacement[part], test.known_curve.force[part], zero_error=zero)
        if isinstance(start, Failure):
            return start
        begin = start.displacement
        taut = replace(branches[0], start=branches[0].start + start.sample)
        found, later = (
            stiffness_over(test, taut, displacement, low, low + self.over)
            for low in (begin.value, begin.value + begin.error)
        )
        if isinstance(found, Failure) or isinstance(later, Failure):
            return found
        return widened(found, later.value - found.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardening(Kind):
    """``hardening.<cycle>`` (1): ``loading_stiffness`` of a later cycle over that of the first."""

    result: ClassVar = "hardening"
    outputs: ClassVar = (Output("hardening", "1", "Hardening", CURVE, first=2),)
    over: Length

    def compute(self, test: Evidence) -> Computed:
        """Ratio to the first cycle; the scale cancels."""
        method = (
            f"slope over {1e3 * self.over:g} mm from the take-up / that of cycle 1, scale cancelled"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        numbers = []
        for later in test.cycles[1:]:
            found = self._value(test, later, test.displacement.values)
            numbers.append(
                self.number(
                    found,
                    method,
                    other_shape(test, later, self._value, found),
                    during=(test.cycles[0][0].start_time, later[0].stop_time),
                    part=f".{later[0].cycle}",
                )
            )
        return Computed(tuple(numbers))

    def _value(self, test: Evidence, branches: list[Branch], displacement: Floats) -> Outcome:
        stiffness = LoadingStiffness(over=self.over)
        before = stiffness.value(test, test.cycles[0], displacement)
        after = stiffness.value(test, branches, displacement)
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


_Found = TypeVar("_Found")


def in_first_loading(
    test: Evidence, fit: Callable[[Floats, Floats], _Found | Failure], other: Floats | None = None
) -> _Found | Failure:
    """Fit displacement and force of the first loading, up to the failure.

    Parameters
    ----------
    test : with its curve, or without
    fit : of displacement and force
    other : shape (n,), m, a displacement under another assumption; None for that of the curve
    """
    if not test.cycles:
        return blocked_or(test, NO_LOADING)
    curve, stretch = test.known_curve, test.loading_stretch
    displacement = curve.displacement if other is None else other
    return fit(displacement[stretch], curve.force[stretch])


@dataclass(frozen=True, slots=True, kw_only=True)
class Window(Kind):
    """A kind of result that is read from a stretch of displacement."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), Above("start")]

    @property
    def in_words(self) -> str:
        """The stretch in millimetres."""
        return f"from {1e3 * self.start:g} mm to {1e3 * self.stop:g} mm"

    def inside(self, displacement: Floats) -> slice | Failure:
        """Samples from the first one at the begin to the last one before the end, in time order.

        Parameters
        ----------
        displacement : shape (n,), m, of a loading branch

        Returns
        -------
        Where they are, or a failure ``not_reached``.
        """
        low, high = self.start, self.stop
        known = displacement[~np.isnan(displacement)]
        if not len(known) or known.max() < high:
            reached = float(known.max()) if len(known) else float("nan")
            found = f"the branch reaches {1e3 * reached:.4g} mm, {1e3 * high:.4g} mm is asked"
            return Failure("not_reached", found)
        if known[0] > low + 0.02 * (high - low):
            found = f"the branch begins at {1e3 * known[0]:.4g} mm, {1e3 * low:.4g} mm is asked"
            return Failure("not_reached", found)
        stop = int(np.argmax(displacement > high)) or None
        return slice(int(np.argmax(displacement >= low)), stop)

    def fitted(
        self,
        test: Evidence,
        fit: Callable[[Floats, Floats], _Found | Failure],
        other: Floats | None = None,
    ) -> _Found | Failure:
        """Fit displacement and force of the first loading within the stretch.

        Parameters
        ----------
        test, fit, other : as for `in_first_loading`
        """

        def inside(displacement: Floats, force: Floats) -> _Found | Failure:
            window = self.inside(displacement)
            if isinstance(window, Failure):
                return window
            return fit(displacement[window], force[window])

        return in_first_loading(test, inside, other)


def _seen_by_cameras(kind: Window, test: Evidence, name: str) -> Computed:
    """Slope between two displacements that come from a shape, time as instrument."""
    method = (
        f"line from {kind.start:g} m to {kind.stop:g} m of the first loading, time as instrument"
    )
    if not test.cycles:
        return kind.not_available(blocked_or(test, NO_CYCLE), method)

    def decide(trace: Trace) -> Reading | Failure:
        branch, path = trace.branches[0], trace.displacement
        return slope_over(trace, slice(branch.start, branch.stop), path, kind.start, kind.stop)

    found = test.measure(decide)
    if isinstance(found, Failure):
        return kind.not_available(found, method)
    during, window = test.while_loading(kind.start, kind.stop), (kind.start, kind.stop)
    number = kind.number(found[0], method, during=during)
    return Computed((number,), {name: Stiffness(decide, found[0].as_estimate, during, window)})


def slope_over(
    trace: Trace, branch: slice, path_of_all: Floats, low: float, high: float
) -> Reading | Failure:
    """Decide on the stiffness over the part of a branch whose path lies between two lengths.

    Parameters
    ----------
    trace : one curve
    branch : samples of the branch, or of a stretch of it
    path_of_all : shape (n,), m, growing along the branch
    low, high : m

    Returns
    -------
    N/m, force over displacement with time as instrument; a failure ``not_reached``,
    ``too_few_samples`` or ``no_travel``.
    """
    path = path_of_all[branch]
    travelled = moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    inside = (travelled >= low) & (travelled <= high)
    if not (travelled > high).any():
        reached = float(np.nanmax(travelled))
        return Failure("not_reached", f"the branch reaches {reached:.4g} m, {high:.4g} m is asked")
    inside[int(np.argmax(travelled > high)) :] = False
    inside &= ~np.isnan(path) & ~np.isnan(trace.force[branch])
    chosen = branch.start + np.flatnonzero(inside)
    if len(chosen) < LEAST_OF_LINE:
        message = f"{len(chosen)} samples in the stretch, {LEAST_OF_LINE} are needed"
        return Failure("too_few_samples", message)
    return slope_of(chosen, by_time=True)


def slope_of(chosen: Ints, *, by_time: bool) -> Reading:
    """Read the slope of force against displacement over chosen samples.

    Parameters
    ----------
    chosen : shape (n,), numbers of samples in order
    by_time : with time as instrument, for a displacement that is noisy itself
    """
    part = samples_of(chosen)

    def numbers(trace: Trace) -> tuple[Floats]:
        displacement, force = trace.displacement[..., part], trace.force[..., part]
        if by_time:
            return (timed_slope(trace.time[part], displacement, force),)
        return (slope_of_line(displacement, force),)

    return Reading(numbers, len(chosen))


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialStiffness(Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"
    outputs: ClassVar = (Output("initial_stiffness", "N/m", "Initial stiffness"),)

    def compute(self, test: Evidence) -> Computed:
        """Slope between two displacements, time as instrument."""
        return _seen_by_cameras(self, test, "initial_stiffness")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStiffness(Window):
    """``<name>`` (N/m): straight line over a window of the first loading."""

    result: ClassVar = "stiffness"
    outputs: ClassVar = (Output("{name}", "N/m"),)
    name: Annotated[Snake, "Such as stiffness_first"] = "stiffness"

    def compute(self, test: Evidence) -> Computed:
        """Straight line by least squares, its interval for correlated noise."""
        if test.shape is not None:
            return _seen_by_cameras(self, test, self.name)
        method = (
            f"straight line {self.in_words} of the first loading, interval for correlated noise"
        )
        if not test.cycles:
            return self.not_available(blocked_or(test, NO_LOADING), method)
        found, curve = test.measure(self.decide), traced(test)
        window = self.samples(curve)
        if isinstance(found, Failure):
            return self.not_available(found, method)
        if isinstance(window, Failure):
            return self.not_available(window, method)
        slope, d = found[0], curve.displacement[window]
        low, high = float(d.min()), float(d.max())
        level = float(curve.force[window].mean()) + slope.value * (low - float(d.mean()))
        during, doubts = test.while_loading(low, high), marked_slips(test, (low, high))
        if slope.value <= 0.0:
            falls = Reason("negative_slope", "the force falls where the frame pulls")
            doubts = (falls, *doubts)
        number = self.number(slope, method, during=during, doubts=doubts)
        made_of = Stiffness(
            self.decide, slope.as_estimate, during, (max(low, 0.0), high), (low, high)
        )
        drawn = FittedLine(self.name, slope.value, level, low, high)
        return Computed((number,), {self.name: made_of}, (drawn,))

    def samples(self, trace: Trace) -> Ints | Failure:
        """Numbers of the samples in the window of the first loading, up to the failure.

        Parameters
        ----------
        trace : one curve
        """
        stretch = loading_of(trace)
        window = self.inside(trace.displacement[stretch])
        if isinstance(window, Failure):
            return window
        part = np.arange(stretch.start, stretch.stop)[window]
        known = ~np.isnan(trace.displacement[part]) & ~np.isnan(trace.force[part])
        return part[known]

    def decide(self, trace: Trace) -> Reading | Failure:
        """Decide on the slope of the straight line over the window.

        Parameters
        ----------
        trace : one curve
        """
        chosen = self.samples(trace)
        if isinstance(chosen, Failure):
            return chosen
        if len(chosen) < LEAST_OF_LINE:
            message = f"{len(chosen)} samples in the stretch, {LEAST_OF_LINE} are needed"
            return Failure("too_few_samples", message)
        if np.ptp(trace.displacement[chosen]) == 0.0:
            return Failure("no_travel", "the displacement does not change over the stretch")
        return slope_of(chosen, by_time=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSegments(Window):
    """``segment_stiffness_first``, ``segment_stiffness_second``, ``break_point``: two lines."""

    result: ClassVar = "two-segments"
    outputs: ClassVar = (
        Output("segment_stiffness_first", "N/m", "Stiffness, first fitted segment"),
        Output("segment_stiffness_second", "N/m", "Stiffness, second fitted segment"),
        Output("break_point", "m", "Break point of the two segments"),
    )

    def compute(self, test: Evidence) -> Computed:
        """Best two segments that meet."""
        method = f"two segments that meet, {self.in_words}, all breaks tried"
        fit = self.fitted(test, fit_two_segments)
        if isinstance(fit, Failure):
            return self.not_available(fit, method)
        first, second, at = fit.first, fit.second, fit.break_point
        read = (fit.start, fit.stop)
        during, doubts = test.while_loading(*read), marked_slips(test, read)  # one bends both
        zero = {"zero of the displacement": test.displacement.zero_error, "slack": test.slack_error}
        errors = (force_scale(test, first), force_scale(test, second), zero)
        one, other = (each.name for each in self.outputs[:2])
        left = fit.level - first.value * (at.value - fit.start)
        return Computed(
            tuple(
                self.number(outcome, method, error, output=place, during=during, doubts=doubts)
                for place, (outcome, error) in enumerate(
                    zip((first, second, at), errors, strict=True)
                )
            ),
            {
                one: Stiffness(
                    partial(self._side, side=1),
                    first,
                    during,
                    (max(fit.start, 0.0), at.value),
                    read,
                ),
                other: Stiffness(
                    partial(self._side, side=2),
                    second,
                    during,
                    (max(at.value, 0.0), fit.stop),
                    read,
                ),
            },
            (
                FittedLine(one, first.value, left, fit.start, at.value),
                FittedLine(other, second.value, fit.level, at.value, fit.stop),
            ),
        )

    def _side(self, trace: Trace, *, side: int) -> Reading | Failure:
        """Decide on the slope on one side of the break, the break held."""
        stretch = loading_of(trace)
        window = self.inside(trace.displacement[stretch])
        if isinstance(window, Failure):
            return window
        part = np.arange(stretch.start, stretch.stop)[window]
        part = part[~np.isnan(trace.displacement[part]) & ~np.isnan(trace.force[part])]
        d = trace.displacement[part]
        fit = fit_two_segments(d, trace.force[part])
        if isinstance(fit, Failure):
            return fit
        ahead = d - fit.break_point.value
        design = np.column_stack([np.ones_like(d), np.minimum(ahead, 0.0), np.maximum(ahead, 0.0)])
        row = np.linalg.pinv(design)[side]
        return Reading(lambda trace: (trace.force[..., part] @ row,), len(part))


@dataclass(frozen=True, slots=True, kw_only=True)
class OfStiffness(Kind):
    """A kind of result that is made of a stiffness above it in the list."""

    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]

    def missing(self, test: Evidence) -> Failure:
        """Why there is no number where there is no stiffness."""
        return blocked_or(test, Failure("no_stiffness", f"{self.of} is not available"))


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedStiffness(OfStiffness):
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: ClassVar = "normalised-stiffness"
    outputs: ClassVar = (Output("{of}_per_peak_force", "1/m"),)
    needs: ClassVar = Needs()

    def compute(self, test: Evidence) -> Computed:
        """A gain error cancels."""
        method = (
            f"{self.of} / peak force of the same sample, errors independent, scale error cancelled"
        )
        stiffness, cycles = test.stiffnesses.get(self.of), test.cycles
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        window = stiffness.during
        during = (window[0], max(window[1], cycles[-1][0].stop_time)) if window else None
        doubts = marked_slips(test, stiffness.bends_with) + cut_short(test, cycles[-1][:1])
        found = _per_peak(test, stiffness)
        return Computed((self.number(found, method, during=during, doubts=doubts),))


def _per_peak(test: Evidence, stiffness: Stiffness) -> Found:
    """A stiffness over the largest force of all cycles."""
    trace = traced(test)
    peaks = {each[0].cycle: peak_of(test, trace, each[0].cycle) for each in test.cycles}
    known = {key: each for key, each in peaks.items() if isinstance(each, Reading)}
    if not known:
        return next(each for each in peaks.values() if isinstance(each, Failure))
    values = {key: float(each.numbers(trace)[0]) for key, each in known.items()}
    largest = max(values, key=lambda key: values[key])
    found = test.measure(lambda trace: peak_of(test, trace, largest))
    peak = found if isinstance(found, Failure) else found[0]
    if isinstance(peak, Failure):
        return peak
    if peak.value <= 3.0 * peak.error:
        return Failure("no_peak_force", f"a peak of {peak.value:.3g} N is no more than its noise")
    share = combined(_quotient, stiffness.decide, lambda trace: peak_of(test, trace, largest))
    ratio = test.measure(share)
    return ratio if isinstance(ratio, Failure) else ratio[0]


def _quotient(trace: Trace, one: Floats, other: Floats) -> Floats:
    del trace
    return np.asarray(one / other, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulus(OfStiffness):
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    needs: ClassVar = Needs()
    area: Annotated[
        Literal["stated", "rectangle", "annulus", "thin-wall"],
        "Which area of specimen.section it refers to",
    ]
    name: Annotated[Snake, "Such as modulus_annulus"] = "modulus"

    def compute(self, test: Evidence) -> Computed:
        """Stiffness, gauge length and area with their uncertainties."""
        method = f"{self.of} x specimen.length / area ({self.area})"
        stiffness, area = test.stiffnesses.get(self.of), _area(self.area, test.setup.section)
        if stiffness is None:
            return self.not_available(self.missing(test), method)
        outcome: Found
        if test.setup.length is None:
            outcome = Failure("no_length", "specimen.length, the gauge length, is not given")
        elif isinstance(area, Failure):
            outcome = area
        else:
            found = test.measure(combined(self._modulus, stiffness.decide))
            outcome = found if isinstance(found, Failure) else found[0]
        doubts = marked_slips(test, stiffness.bends_with)
        return Computed((self.number(outcome, method, during=stiffness.during, doubts=doubts),))

    def _modulus(self, trace: Trace, stiffness: Floats) -> Floats:
        area = _area(self.area, trace.sizes)
        area = np.nan if isinstance(area, Failure) else area
        return np.asarray(stiffness * trace.sizes["length"] / area, dtype=np.float64)


def _area(kind: str, section: Mapping[str, float]) -> float | Failure:
    """Area of a name from the sizes that it takes."""
    needs = {
        "stated": ("area",),
        "rectangle": ("width", "thickness"),
        "annulus": ("outer_diameter", "inner_diameter"),
        "thin-wall": ("outer_diameter", "wall"),
    }[kind]
    sizes = [section[name] for name in needs if name in section]
    if len(sizes) < len(needs):
        wanted = " and ".join(f"specimen.section.{name}" for name in needs)
        return Failure("no_area", f"{wanted} not given")
    areas = {"rectangle": rectangle_area, "annulus": annulus_area, "thin-wall": thin_wall_area}
    area = sizes[0] if kind == "stated" else areas[kind](*sizes)
    if not area > 0.0:
        return Failure("no_area", f"the {kind} area comes out as {area:.4g} m^2")
    return area


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceResult(Kind):
    """``compliance`` (m/N): of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    outputs: ClassVar = (Output("compliance", "m/N", "Compliance of frame and grips"),)
    start: Annotated[Force, Key("from")]
    stop: Annotated[Force, Key("to"), Above("start")]

    def compute(self, test: Evidence) -> Computed:
        """Displacement against force, the bar taken for rigid."""
        method = (
            f"displacement against force from {self.start:g} N to {self.stop:g} N, the bar taken "
            "for rigid"
        )
        found = in_first_loading(test, partial(fit_compliance, start=self.start, stop=self.stop))
        number = self.number(found, method, force_scale(test, found), during=test.while_loading())
        return Computed((number,))


KINDS = (
    UnloadingStiffness,
    LoadingStiffness,
    Hardening,
    InitialStiffness,
    LineStiffness,
    TwoSegments,
    NormalisedStiffness,
    Modulus,
    ComplianceResult,
)
